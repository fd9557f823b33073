"""Whether the stated valve oscillates by itself where the records begin, and the measured one does not: then these are
not of the stated valve, and a fit would only tell so in minutes.

Symbols
    A Jacobian of the scaled rates at rest, s its eigenvalues (1/s): where the real part of one is above zero, what is
    at rest departs from it, at |Im s| / 2 pi
    g gradient of the largest real part with respect to the valve's figures in prior deviations
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.identification.fit import Fit, evaluate_fit, rescored
from valvesim.identification.noise_estimation import identify_noise, initial_noise
from valvesim.identification.predictor import at_rest_together
from valvesim.identification.study import PreparedSession, Study


@dataclass(frozen=True, eq=False)
class SelfOscillation:
    """The frequency (Hz) at which a stated valve oscillates by itself, and its fit at nominal in a study."""

    frequency: float
    study: Study
    stated: Fit


def self_oscillation(prepared: PreparedSession) -> SelfOscillation | None:
    """How the stated valve oscillates by itself, and every one near it; None where it rests, or where the readings move
    about that frequency too, or cannot tell.

    Of the valves near it the steadiest is looked at, by a gradient. Raises SolveError where the valve cannot be run.
    """
    nominal = np.zeros(len(prepared.nominal.parameters))
    growth, frequency = _fastest_departure(prepared, nominal)
    if growth <= 0.0 or frequency <= 0.0:
        return None
    g, step = np.zeros_like(nominal), prepared.options.self_oscillation.step
    for k in np.flatnonzero([p.is_of_valve for p in prepared.nominal.parameters]):
        beside = np.where(np.arange(len(g)) == k, step, 0.0)
        g[k] = _fastest_departure(prepared, beside)[0] - _fastest_departure(prepared, -beside)[0]
    steadiest = -prepared.options.self_oscillation.reach * g / max(float(np.linalg.norm(g)), 1e-30)
    if _fastest_departure(prepared, steadiest)[0] <= 0.0:
        return None
    first = evaluate_fit(prepared.with_noise(initial_noise(prepared)), nominal, ())
    study = prepared.with_noise(identify_noise(prepared, first.readings))
    stated = rescored(study, first)
    return None if _is_measured(study, stated, frequency) else SelfOscillation(frequency, study, stated)


def _fastest_departure(prepared: PreparedSession, point: np.ndarray) -> tuple[float, float]:
    """The largest real part (1/s) of the eigenvalues at rest where the records begin, and its frequency (Hz)."""
    variant, fastest = prepared.nominal.at(point), (-np.inf, 0.0)
    posed = [predictor.posed(variant) for predictor in prepared.predictors]
    for one, rest in zip(posed, at_rest_together(posed), strict=True):
        A = np.zeros((len(rest), len(rest)))
        one.compiled.jacobian(rest, one.under.first_inputs, one.knots[0], A)
        s = max(np.linalg.eigvals(A), key=lambda each: each.real)
        fastest = max(fastest, (float(s.real), float(abs(s.imag)) / (2.0 * np.pi)))
    return fastest


def _is_measured(study: Study, stated: Fit, frequency: float) -> bool:
    """Whether the readings move about a frequency by a good part of what the stated valve's do, or cannot tell."""
    options, shares = study.options.self_oscillation, []
    for predictor, read in zip(study.predictors, stated.readings, strict=True):
        record = predictor.record
        if record.pace < options.samples * frequency:
            continue
        for name, predicted in read.items():
            good = record.usable[name] & np.isfinite(predicted)
            if good.any():
                measured, expected = (
                    _motion_about(np.interp(record.time, record.time[good], one[good]), record.pace, frequency)
                    for one in (record.values[name], predicted)
                )
                shares.append(measured / max(expected, 1e-30))
    return not shares or float(np.median(shares)) > options.share


def _motion_about(values: np.ndarray, rate: float, frequency: float) -> float:
    """The root mean square of what values (n,) at a rate (Hz) do within half an octave of a frequency."""
    spectrum = np.abs(np.fft.rfft(values - values.mean()))
    octaves = np.log2(np.maximum(np.fft.rfftfreq(len(values), 1.0 / rate), 1e-9) / frequency)
    return float(np.sqrt(2.0 * np.sum(spectrum[np.abs(octaves) < 0.5] ** 2)) / len(values))
