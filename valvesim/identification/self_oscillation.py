"""Whether the stated valve oscillates by itself where the records begin, and the measured one does not: then these are
not of the stated valve, and a fit would only tell so in minutes.

Symbols
    A Jacobian of the scaled rates at rest, s its eigenvalues (1/s): a mode whose real part is above zero grows, at a
    frequency of |Im s| / 2 pi
    g gradient of the growth rate with respect to the valve's figures in prior deviations
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit
from valvesim.identification.noise_estimation import evaluated_under_own_noise
from valvesim.identification.predictor import ModelVariant, RecordPredictor, at_rest_together
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

    Raises SolveError where the valve cannot be run.
    """
    nominal = np.zeros(len(prepared.nominal.parameters))
    growth, frequency = _least_stable_mode(prepared, nominal)
    if growth <= 0.0 or frequency <= 0.0:
        return None
    try:
        rests = _growth_of_most_stable(prepared) <= 0.0
    except (SolveError, InputError):  # a valve near it has no state at rest: the fit may tell
        return None
    if rests:
        return None
    study, stated = evaluated_under_own_noise(prepared, nominal)
    return None if _is_measured(study, stated, frequency) else SelfOscillation(frequency, study, stated)


def _growth_of_most_stable(prepared: PreparedSession) -> float:
    """The growth rate (1/s) of the least stable mode of the most stable valve near the stated one, by a gradient."""
    options = prepared.options.self_oscillation
    g = np.zeros(len(prepared.nominal.parameters))
    for k in np.flatnonzero([p.is_of_valve for p in prepared.nominal.parameters]):
        beside = np.where(np.arange(len(g)) == k, options.step, 0.0)
        g[k] = _least_stable_mode(prepared, beside)[0] - _least_stable_mode(prepared, -beside)[0]
    most_stable = -options.reach * g / max(float(np.linalg.norm(g)), 1e-30)
    return _least_stable_mode(prepared, most_stable)[0]


def _least_stable_mode(prepared: PreparedSession, point: np.ndarray) -> tuple[float, float]:
    return least_stable_mode(prepared.predictors, prepared.nominal.at(point))


def least_stable_mode(predictors: Sequence[RecordPredictor], variant: ModelVariant) -> tuple[float, float]:
    """The growth rate (1/s) and the frequency (Hz) of the least stable mode of a variant at rest where records begin.

    Raises SolveError, InputError where it has no state at rest, or its equations make no sense there.
    """
    least = (-np.inf, 0.0)
    posed = [predictor.posed(variant) for predictor in predictors]
    for one, rest in zip(posed, at_rest_together(posed), strict=True):
        A = np.zeros((len(rest), len(rest)))
        one.compiled.jacobian(rest, one.under.first_inputs, one.knots[0], A)
        if not np.isfinite(A).all():
            raise SolveError("the equations at rest have no derivatives")
        s = max(np.linalg.eigvals(A), key=lambda each: each.real)
        least = max(least, (float(s.real), float(abs(s.imag)) / (2.0 * np.pi)))
    return least


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
                    _band_rms(np.interp(record.time, record.time[good], one[good]), record.pace, frequency)
                    for one in (record.values[name], predicted)
                )
                shares.append(measured / max(expected, 1e-30))
    return not shares or float(np.median(shares)) > options.share


def _band_rms(values: np.ndarray, rate: float, frequency: float) -> float:
    """The root mean square of what values (n,) at a rate (Hz) do within half an octave of a frequency."""
    spectrum = np.abs(np.fft.rfft(values - values.mean()))
    octaves = np.log2(np.maximum(np.fft.rfftfreq(len(values), 1.0 / rate), 1e-9) / frequency)
    return float(np.sqrt(2.0 * np.sum(spectrum[np.abs(octaves) < 0.5] ** 2)) / len(values))
