"""Gain and distortion of one steady sine, from a simulated or a measured record.

Symbols
    u command, y output, f frequency Hz, THD harmonic distortion: root of the summed squares of harmonics 2 to 5 over
    the fundamental

Amplitudes are peak, from the mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.record_checks import check_frequencies, checked_record, flat_share, flat_share_of_a_sine
from valvesim.errors import InputError

HARMONICS = 5  # the highest in the distortion
FEWEST_A_CYCLE = 6  # samples, for the fundamental; the harmonics need more than twice their number


@dataclass(frozen=True, kw_only=True)
class SinePoint:
    """One steady sine: `gain` is the complex ratio of the fundamentals of output and input.

    `distortion` is THD of the output as a share (NaN with too few samples a cycle), `residual` what neither the
    fundamental nor harmonics 2 to 5 explain (noise, drift, an unsteady state), rms over that of the fundamental.
    """

    frequency: float
    gain: complex
    distortion: float
    residual: float
    input_amplitude: float
    output_amplitude: float


def sine_point(
    time, command, output, *, frequency: float | None = None, allow_flat: bool = False
) -> SinePoint:  # fmt: skip
    """Gain and distortion from the record of one steady sine, arrays (n_t,): time s, command and output.

    Least squares of offset, sine and cosine of the fundamental and of harmonics 2 to 5 on the last whole cycles, of
    command and output alike. `frequency` (Hz) is found from the command where it is not given. Sampling need not be
    even. Cut off the part in which the sine settles.
    Raises InputError for lengths that differ, NaN, gaps, no complete cycle, fewer than 6 samples a cycle, a command
    that is no sine of that frequency, and an output that rests at its extremes (clipped, saturated or stuck; let it
    pass with `allow_flat`).
    """
    t, u, y = checked_record(time, command, output)
    if frequency is None:
        frequency = _find_frequency(t, u)
    check_frequencies(np.array([frequency]))
    if not allow_flat and (share := flat_share(y, float(np.max(y)), float(np.min(y)))) > flat_share_of_a_sine(y):
        raise InputError(
            f"sine record: the output rests at its extreme for {100 * share:.3g} % of the record: clipped by the "
            "measuring channel, saturated or stuck; lower the amplitude or widen the range"
        )
    return fit_sine(t, u, y, frequency)


def fit_sine(t: np.ndarray, u: np.ndarray, y: np.ndarray, frequency: float, *, dither: float = 0.0) -> SinePoint:
    """As `sine_point`, without its checks of the record; a dither of that frequency (Hz) is fitted beside."""
    interval = float(np.median(np.diff(t)))
    span = t[-1] - t[0] + interval
    cycles, per_cycle = int(np.floor(span * frequency * (1.0 + 1e-6))), 1.0 / (frequency * interval)
    if cycles < 1:
        raise InputError(
            f"sine record: no complete cycle: {span:.4g} s hold {span * frequency:.2g} of a cycle at {frequency:.4g} Hz"
        )
    if per_cycle < FEWEST_A_CYCLE * (1.0 - 1e-6):
        raise InputError(
            f"sine record: {per_cycle:.3g} samples a cycle at {frequency:.4g} Hz are too few: {FEWEST_A_CYCLE} for the "
            f"fundamental, more than {2 * HARMONICS} for the distortion; sample faster than "
            f"{FEWEST_A_CYCLE * frequency:.4g} Hz"
        )
    count = HARMONICS if per_cycle > 2 * HARMONICS else 1
    keep = t > t[-1] + interval / 2.0 - cycles / frequency
    angle = 2.0 * np.pi * frequency * np.outer(t[keep], np.arange(1, count + 1))
    basis = np.column_stack([np.ones(int(keep.sum())), np.cos(angle), np.sin(angle)])
    if dither:
        upon = 2.0 * np.pi * dither * t[keep]
        basis = np.column_stack([basis, np.cos(upon), np.sin(upon)])
    weights, *_ = np.linalg.lstsq(basis, np.column_stack([u[keep], y[keep]]), rcond=None)
    cosine, sine = weights[1 : count + 1], weights[count + 1 : 2 * count + 1]
    phasors = cosine - 1j * sine  # (harmonics, 2): y = Re sum Y_k exp(j k w t)
    left = np.std(np.column_stack([u[keep], y[keep]]) - basis @ weights, axis=0) * np.sqrt(2.0)
    first = np.abs(phasors[0])
    if first[0] <= 1e-12 * max(float(np.max(np.abs(u))), 1e-300) or _harmonic_share(phasors[:, 0]) > 0.1:
        raise InputError(f"sine record: the command is no sine at {frequency:.4g} Hz (constant, clipped or another)")
    if left[0] > 0.3 * first[0]:
        raise InputError(f"sine record: the command is no steady sine at {frequency:.4g} Hz alone")
    moves = first[1] > 0.0
    return SinePoint(
        frequency=float(frequency),
        gain=complex(phasors[0, 1] / phasors[0, 0]),
        distortion=_harmonic_share(phasors[:, 1]) if count > 1 and moves else float("nan"),
        residual=float(left[1] / first[1]) if moves else float("nan"),
        input_amplitude=float(first[0]),
        output_amplitude=float(first[1]),
    )


def _harmonic_share(phasors: np.ndarray) -> float:
    return float(np.linalg.norm(phasors[1:]) / np.abs(phasors[0])) if len(phasors) > 1 else 0.0


def _find_frequency(t: np.ndarray, u: np.ndarray) -> float:
    """The frequency of a sine, Hz: the strongest line of its spectrum, then least squares around that."""
    from scipy.optimize import minimize_scalar

    even = np.linspace(t[0], t[-1], len(t))
    x = np.interp(even, t, u - u.mean())
    if np.ptp(x) <= 1e-9 * float(np.max(np.abs(u))):
        raise InputError("sine record: the command does not move")
    spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x)), 4 * len(x)))
    line, width = 1.0 / (t[-1] - t[0]), 0.75
    guess = (1 + int(np.argmax(spectrum[1:]))) * line * (len(t) - 1) / (4 * len(t))

    def misfit(f: float) -> float:
        angle = 2.0 * np.pi * f * (t - t[0])
        basis = np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)])
        return float(np.sum((u - basis @ np.linalg.lstsq(basis, u, rcond=None)[0]) ** 2))

    low, high = max(guess - width * line, 0.05 * line), guess + width * line
    return float(minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-7 * high}).x)
