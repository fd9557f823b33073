"""Checks of the records and arguments of dynamic tests: gaps, clipped channels, frequencies, amplitudes."""

from __future__ import annotations

import numpy as np

from valvesim.errors import InputError


def checked_record(time, command, output) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three arrays (n_t,) of a record that has no gap."""
    t, u, y = (np.asarray(values, dtype=float) for values in (time, command, output))
    if t.ndim != 1 or t.shape != u.shape or t.shape != y.shape:
        raise InputError(f"record: time {t.shape}, command {u.shape} and output {y.shape} must be rows of one length")
    if len(t) < 3:
        raise InputError(f"record: {len(t)} samples are too few")
    for name, values in (("time", t), ("command", u), ("output", y)):
        if (bad := ~np.isfinite(values)).any():
            raise InputError(f"record: gap in the {name}: sample {int(np.argmax(bad)) + 1} is not a finite number")
    intervals = np.diff(t)
    if (falls := intervals <= 0.0).any():
        k = int(np.argmax(falls)) + 1
        raise InputError(f"record: times must rise, but sample {k + 1} ({t[k]:.6g} s) does not follow {t[k - 1]:.6g} s")
    usual = float(np.median(intervals))
    if (wide := intervals > 1.5 * usual).any():
        k = int(np.argmax(wide))
        raise InputError(
            f"record: gap of {intervals[k]:.4g} s after {t[k]:.6g} s, where samples are {usual:.4g} s apart"
        )
    return t, u, y


def check_frequencies(f: np.ndarray) -> np.ndarray:
    if f.ndim != 1 or not len(f):
        raise InputError("frequencies: a row of numbers in hertz is needed")
    bad = ~((f > 0.0) & (f <= 1e5))
    if bad.any():
        raise InputError(f"frequencies: {f[bad][0]:g} Hz is outside (0, 1e+05] Hz")
    return f


def check_amplitude(amplitude: float) -> None:
    if not 0.0 < amplitude < np.inf:
        raise InputError(f"amplitude = {amplitude:g} must be positive: the peak of the sine, from its mean")


def flat_share(y: np.ndarray, *extremes: float) -> float:
    """The largest share of samples that follow another one at exactly the same extreme value."""
    if len(y) < 2:
        return 0.0
    return max(float(np.mean((y[1:] == extreme) & (y[:-1] == extreme))) for extreme in extremes)


def flat_share_of_a_sine(y: np.ndarray) -> float:
    """The flat share that a clean sine of this range and resolution may have, with a margin."""
    levels = np.unique(y)
    if len(levels) < 3:
        return 0.02
    steps = float(np.median(np.diff(levels))), float(np.ptp(y)) / 2.0
    return 0.02 + 3.0 * float(np.arccos(max(1.0 - 1.5 * steps[0] / steps[1], -1.0))) / np.pi
