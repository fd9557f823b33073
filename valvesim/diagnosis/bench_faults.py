"""The bench, not the valve: what a test bench does that no record tells, each tried as a hypothesis of its own.

A supply or an oil temperature that wanders or ripples, a mains hum upon the current, clocks of channels that run apart,
a meter that drifts. Each is a few nuisance parameters. One that explains what is left by much more than chance, and
beside the likeliest causes too, joins the nominal model: it is then the bench's fault, and no cause is sought for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.advice import CLOCKS, HUM, METER, OF_INPUT, OF_WAVE, what_to_do
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import WhatToDo
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.identification.between_samples import InputShift, Wave
from valvesim.identification.fit import evaluate_fit, rescored
from valvesim.identification.fit_jacobian import all_candidate_sensitivities
from valvesim.identification.input_waves import (
    fitted_waves,
    linear_reduction,
    outstanding_frequencies,
    wave_columns,
    wave_parameters,
    wave_size,
    wave_words,
)
from valvesim.identification.jacobian import parameter_sensitivities, perturbed_variants
from valvesim.identification.nominal_fit import NominalFit, fit_nominal_near, with_inputs_reviewed
from valvesim.identification.prior import NuisanceParameter, ToleratedSensorError, measured_channels
from valvesim.identification.session import value_text
from valvesim.identification.study import Study
from valvesim.valve.effect import Advice, Parameter


@dataclass(frozen=True, eq=False)
class BenchFault:
    """Something that the bench may do: the parameters that say how much, their size in words, and
    what to do about it.

    `gain` is the reduction of the chi-square that the linear answers promise.
    """

    parameters: tuple[NuisanceParameter, ...]
    words: Callable[[np.ndarray], str]
    advice: Advice
    gain: float = 0.0


def with_bench_faults(
    nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest]:
    """The nominal fit with the bench faults that the readings show, and what that leaves."""
    for _ in range(options.bench.most_faults):
        fault = _likeliest(nominal, scores, options=options)
        if fault is None:
            break
        study = nominal.study
        extended = study.nominal.extended(fault.parameters)
        prepared = study.unweighted().with_nominal(extended)
        point = np.append(nominal.fit.point, np.zeros(len(fault.parameters)))
        better = fit_nominal_near(prepared, point, full_weight=not study.weights)
        if nominal.fit.chi_square - rescored(study, better.fit).chi_square < 0.5 * fault.gain:
            break  # the linear answers were wrong: it is something else
        better = with_inputs_reviewed(better)  # which the fault may have hidden
        nominal, scores = better, score_test(better, better.fit, options=options)
    return nominal, scores


def fitted_faults(nominal: NominalFit, *, options: DiagnosisOptions) -> tuple[WhatToDo, ...]:
    """The bench faults that a nominal fit has among its parameters, with what to do about them."""
    model = nominal.study.nominal
    values = {p.name: p.at(t) for p, t in zip(model.parameters, nominal.fit.point, strict=True)}
    waves = [_wave(parameters) for parameters in fitted_waves(model).values()]
    others = [fault for fault in steady_faults(nominal.study, options=options) if fault.parameters[0].name in values]
    return tuple(
        what_to_do(fault.words(np.array([values[p.name] for p in fault.parameters])), fault.advice)
        for fault in (*waves, *others)
    )


def explained_by_faults(nominal: NominalFit, *, options: DiagnosisOptions) -> float:
    """By how much the chi-square of a nominal fit is larger where the bench faults that it has are taken off it."""
    model = nominal.study.nominal
    own = {p.name for wave in fitted_waves(model).values() for p in wave}
    own |= {p.name for fault in steady_faults(nominal.study, options=options) for p in fault.parameters}
    without = [0.0 if p.name in own else t for p, t in zip(model.parameters, nominal.fit.point, strict=True)]
    return evaluate_fit(nominal.study, np.array(without), ()).chi_square - nominal.fit.chi_square


def _likeliest(nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions) -> BenchFault | None:
    """The bench fault that explains most of what is left, beside the likeliest causes too; None where none does."""
    fit, taken = nominal.fit, {p.name for p in nominal.study.nominal.parameters}
    faults = [f for f in bench_faults(nominal, options=options) if f.parameters[0].name not in taken]
    if not faults:
        return None
    parameters = [p for fault in faults for p in fault.parameters]
    columns = _columns(nominal, parameters)
    causes = _likeliest_causes(nominal, scores, options=options)
    gains = []
    start = 0
    for fault in faults:
        S = columns[:, start : start + len(fault.parameters)]
        start += len(fault.parameters)
        gains.append(min(_gain(nominal, S, causes[:, :k]) for k in range(causes.shape[1] + 1)))
    most = max(float(np.max(scores.z(), initial=0.0)) ** 2, fit.chi_square - fit.rows)
    least = max(options.bench.minimum_gain, options.bench.gain_share * most)
    best = int(np.argmax(gains))
    return replace(faults[best], gain=gains[best]) if gains[best] > least else None


def _gain(nominal: NominalFit, S: np.ndarray, beside: np.ndarray) -> float:
    """The reduction of the chi-square by columns S (rows, k), with their priors, beyond that by those `beside`."""

    J, fit = nominal.J, nominal.fit
    together = linear_reduction(J, fit, np.column_stack([beside, S]), beside.shape[1])
    return together - linear_reduction(J, fit, beside, beside.shape[1])


def _likeliest_causes(nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions) -> np.ndarray:
    """Whitened columns (rows, k) of the few candidates that explain most on their own."""
    z = scores.z()
    few = [int(k) for k in np.argsort(-z, kind="stable")[: options.bench.causes_beside] if z[k] > 0.0]
    if not few:
        return np.empty((len(nominal.fit.residual), 0))
    candidates = [scores.candidates[k] for k in few]
    variant = nominal.fit.variant(nominal.study.nominal)
    changed = [c.apply_to(variant, scores.sizes[k]) for c, k in zip(candidates, few, strict=True)]
    study = nominal.study
    return study.stack(all_candidate_sensitivities(study, nominal.linearised, nominal.columns, candidates, changed))


def _columns(nominal: NominalFit, parameters: Sequence[NuisanceParameter]) -> np.ndarray:
    """Whitened sensitivities (rows, k) to one prior deviation of each parameter, about the nominal fit."""
    study = nominal.study
    base = study.nominal.variant
    own = replace(study.nominal, parameters=tuple(parameters), variant=base)

    def columns_of(linear) -> dict[str, np.ndarray]:
        return parameter_sensitivities(linear, own, perturbed_variants(own, linear.variant))

    return study.stack([columns_of(linear) for linear in nominal.linearised])


# ---------------------------------------------------------------- what a bench may do


def bench_faults(nominal: NominalFit, *, options: DiagnosisOptions) -> list[BenchFault]:
    """What the bench of a session may do, by what a nominal fit leaves."""
    study, records = nominal.study, nominal.study.session.training
    waves = [
        _wave(wave_parameters(records, column, frequency, wave_size(study.nominal, records, column)))
        for frequency in outstanding_frequencies(study, nominal.fit.readings)
        for column in wave_columns(records)
    ]
    return [*waves, *steady_faults(study, options=options)]


def steady_faults(study: Study, *, options: DiagnosisOptions) -> list[BenchFault]:
    """What a bench may do that has no frequency: inputs that are off or wander, clocks and meters that drift."""
    supply, records = float(study.session.valve.supply_pressure), study.session.training
    faults = []
    for column, words, size, unit in (
        ("oil_temperature", "the oil temperature is off", options.bench.oil_temperature, "delta_degC"),
        ("supply_pressure", "the supply pressure is off", options.bench.supply_pressure * supply, "Pa"),
    ):
        for growing in (False, True):
            faults.append(_shift(records, column, words, size, unit, growing))
    channels = measured_channels(study.session)
    faults.append(_of_sensors("clocks of the channels run apart", CLOCK_RATE, channels, options.bench.clock_rate))
    faults += [_drifting(channel, study, options=options) for channel in channels]
    return faults


def _wave(parameters: tuple[NuisanceParameter, ...]) -> BenchFault:
    """A wave on an input, see `wave_parameters`."""
    wave = parameters[0].input
    advice = OF_WAVE.get(wave.column, HUM) if isinstance(wave, Wave) else HUM
    return BenchFault(parameters, lambda values: wave_words(parameters, values), advice)


def _shift(records, column: str, words: str, size: float, unit: str, growing: bool) -> BenchFault:
    """An input that is off, or wanders off, in each record."""
    parameters = tuple(
        NuisanceParameter(f"shift@{record.name}:{column}:{growing}", unit, 0.0, size, (-4.0 * size, 4.0 * size),
                          input=InputShift(record.name, column, growing))
        for record in records
    )  # fmt: skip

    def said(values: np.ndarray) -> str:
        within = " within a record" if growing else ""
        return f"{words} by up to {value_text(float(np.abs(values).max()), unit)}{within}"

    return BenchFault(parameters, said, OF_INPUT[column])


def _of_sensors(words: str, effect: ToleratedSensorError, channels: Sequence[str], size: float) -> BenchFault:
    parameters = tuple(
        NuisanceParameter(f"{effect.name}@{channel}", "1", 0.0, size, effect.amplitude.bounds, effect.on(channel))
        for channel in channels
    )
    return BenchFault(parameters, lambda values: f"{words} by up to {np.abs(values).max() * 1e6:.3g} ppm", CLOCKS)


def _drifting(channel: str, study: Study, *, options: DiagnosisOptions) -> BenchFault:
    """A meter that drifts within each record at one rate."""
    span = max(float(np.ptp(r.values[channel])) for r in study.session.training if channel in r.outputs)
    longest = max(r.duration for r in study.session.training)
    effect = METER_DRIFT.on(channel)
    size = options.bench.meter_drift * span / longest
    parameter = NuisanceParameter(
        f"meter_drift@{channel}", effect.amplitude.unit, 0.0, size, (-4.0 * size, 4.0 * size), effect
    )
    return BenchFault(
        (parameter,),
        lambda values: f"{channel} as read drifts by {abs(values[0]) * longest / span:.2g} of its span in a record",
        METER,
    )


def _apart(reading, p):
    return np.interp(reading.time * (1.0 - p.rate), reading.time, reading.values)


CLOCK_RATE = ToleratedSensorError(
    name="clock_rate",
    doc="the channel's clock runs fast or slow",
    location="sensor",
    signature="a delay that grows",
    parameters=(
        Parameter(name="rate", unit="1", doc="rate", default=0.0, bounds=(-0.01, 0.01), neutral=0.0, typical=1e-4),
    ),
    reading=_apart,
)

METER_DRIFT = ToleratedSensorError(
    name="meter_drift",
    doc="the reading drifts within a record",
    location="sensor",
    signature="an offset that grows",
    parameters=(
        Parameter(
            name="rate", unit="channel/s", doc="rate", default=0.0, bounds=(-10.0, 10.0), neutral=0.0, typical=0.01
        ),
    ),
    reading=lambda reading, p: reading.values + p.rate * (reading.time - reading.time[0]),
)
