"""Bandwidth of a linear system and its reduced forms of order 2 and 3.

Symbols
    H(s) spool position over current, K = H(0)
    K/(s^2/w^2 + 2 z s/w + 1)                    reduced form of order 2
    K/((1 + s/a) (s^2/w^2 + 2 z s/w + 1))        reduced form of order 3"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, ReductionOptions
from valvesim.errors import InputError, SolveError, unknown_name


@dataclass(frozen=True, kw_only=True)
class Bandwidth:
    """Frequencies in Hz where the gain first falls 3 dB below that at rest, and where the phase first lags 90°.

    nan where it does not between 0.1 Hz and 10 kHz.
    """

    gain_frequency: float
    phase_frequency: float


def bandwidth(
    system: Any, *, output: str = "spool_position", source: str = "current",
    options: ReductionOptions = DEFAULT_CHARACTERISATION.reduction,
) -> Bandwidth:  # fmt: skip
    """-3 dB and -90° frequencies of one output over one input (-3 dB is 10^(-3/20)); figures of ISO 10770-1.

    `system` is a linear system of python-control; the names are not looked at where it has but one input and output.
    Raises InputError for an unknown name, a system with poles in the right half plane, or no gain at rest.
    """
    from scipy.optimize import brentq

    H = _response(system, output, source)
    log_f = np.linspace(np.log(options.lowest_frequency), np.log(options.highest_frequency), 2001)
    values = H(np.exp(log_f))

    def first(measure: Callable) -> float:
        m = measure(values)
        below = np.flatnonzero(m <= 0.0)
        if not len(below) or below[0] == 0:
            return float("nan")
        k = below[0]
        root = brentq(lambda z: float(measure(H(np.exp([z])))[0]), log_f[k - 1], log_f[k], xtol=1e-12)
        return float(np.exp(root))

    return Bandwidth(
        gain_frequency=first(lambda h: np.abs(h) - 10.0 ** (-3.0 / 20.0)),
        phase_frequency=first(lambda h: h.real),
    )


def _single(system: Any, output: str, source: str) -> Any:
    """The part of a system from one input to one output."""
    if system.ninputs == 1 and system.noutputs == 1:
        return system
    for name, names in ((output, system.output_labels), (source, system.input_labels)):
        if name not in names:
            raise unknown_name("signal", name, names, "linear system")
    return system[output, source]


def _response(system: Any, output: str, source: str) -> Callable[[np.ndarray], np.ndarray]:
    """H(j 2 pi f)/H(0) as a function of frequencies (n,) in Hz."""
    part = _single(system, output, source)
    if np.any(np.asarray(part.poles()).real >= 0.0):
        raise InputError(f"frequency response: the system is not stable (poles {np.asarray(part.poles())} rad/s)")
    gain = complex(part(0.0)).real
    if not np.isfinite(gain) or gain == 0.0:
        raise InputError(f"frequency response: {output} does not follow {source} at rest (gain {gain})")
    return lambda f: np.atleast_1d(part(2j * np.pi * np.asarray(f))) / gain


@dataclass(frozen=True, kw_only=True)
class ReducedModel:
    """A reduced form: K `gain`, w `angular_frequency` rad/s, z `damping_ratio`, a `real_pole` rad/s (None, order 2).

    `system` is the `control.TransferFunction`. Fitted from `lowest_frequency` to `highest_frequency` (Hz), within which
    it is off by at most `gain_error` dB and `phase_error` degrees.
    """

    system: Any
    gain: float
    angular_frequency: float
    damping_ratio: float
    real_pole: float | None
    lowest_frequency: float
    highest_frequency: float
    gain_error: float
    phase_error: float

    @property
    def natural_frequency(self) -> float:
        """w/(2 pi), Hz."""
        return self.angular_frequency / (2.0 * np.pi)


def reduced(
    system: Any, order: int, *, highest_frequency: float | None = None, output: str = "spool_position",
    source: str = "current", options: ReductionOptions = DEFAULT_CHARACTERISATION.reduction,
) -> ReducedModel:  # fmt: skip
    """The usual second- or third-order form of a transfer function, fitted to its frequency response.

    K is the exact gain at rest; w, z (and a) minimise the relative complex error |H_r/H - 1| over 200 frequencies even
    in log frequency, over two decades up to `highest_frequency` (Hz; by default twice the -90° frequency). z > 1 is two
    real poles. Valid within the band alone: the phase of the full model goes on falling beyond it.
    Raises InputError for another order, a band that is not positive, and as `bandwidth` does; SolveError where no start
    of the fit ends well.
    """
    import control
    from scipy.optimize import least_squares

    if order not in (2, 3):
        raise InputError(f"reduced: order = {order} must be 2 or 3")
    lag = bandwidth(system, output=output, source=source, options=options).phase_frequency
    top = 2.0 * lag if highest_frequency is None else float(highest_frequency)
    if not (np.isfinite(top) and top > 0.0):
        raise InputError(f"reduced: highest_frequency = {top} Hz must be positive (the -90° frequency is {lag} Hz)")
    frequencies = np.geomspace(top / 10.0**options.decades, top, options.points)
    H = _response(system, output, source)(frequencies)
    s = 2j * np.pi * frequencies

    def form(logs: np.ndarray) -> np.ndarray:
        w, z, *a = np.exp(logs)
        return 1.0 / ((s**2 / w**2 + 2.0 * z * s / w + 1.0) * (1.0 + s / a[0] if a else 1.0))

    def error(logs: np.ndarray) -> np.ndarray:
        e = form(logs) / H - 1.0
        return np.concatenate([e.real, e.imag])

    w_lag = 2.0 * np.pi * (lag if np.isfinite(lag) else top)
    tails: list[list[float]] = [[]] if order == 2 else [[w_lag * r] for r in (0.3, 1.0, 3.0)]
    starts = [np.log([w_lag * r, z, *a]) for r in (1.0, 3.0) for z in (0.3, 1.0) for a in tails]
    fits = [least_squares(error, start, x_scale="jac", xtol=1e-12, ftol=1e-12) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    if not (best.success and np.all(np.isfinite(best.x))):
        raise SolveError(f"reduced: no fit of order {order} up to {top:.6g} Hz ({best.message}); lower the band")
    w, z, *a = (float(value) for value in np.exp(best.x))
    part = _single(system, output, source)
    gain = float(complex(part(0.0)).real)
    off = form(best.x) / H
    denominator = np.array([1.0 / w**2, 2.0 * z / w, 1.0])
    return ReducedModel(
        system=control.tf(
            [gain], np.polymul(denominator, [1.0 / a[0], 1.0]) if a else denominator,
            inputs=part.input_labels, outputs=part.output_labels,
        ),
        gain=gain,
        angular_frequency=w,
        damping_ratio=z,
        real_pole=a[0] if a else None,
        lowest_frequency=float(frequencies[0]),
        highest_frequency=top,
        gain_error=float(np.max(np.abs(20.0 * np.log10(np.abs(off))))),
        phase_error=float(np.max(np.abs(np.degrees(np.angle(off))))),
    )  # fmt: skip
