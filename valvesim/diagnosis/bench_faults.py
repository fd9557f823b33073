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
from valvesim.identification.fit import rescored
from valvesim.identification.fit_jacobian import all_candidate_sensitivities
from valvesim.identification.jacobian import parameter_sensitivities, perturbed_variants
from valvesim.identification.nominal_fit import NominalFit, fit_nominal_near
from valvesim.identification.prior import NuisanceParameter, ToleratedSensorError, measured_channels
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import UNITS, value_text
from valvesim.identification.study import Study, residual_of
from valvesim.valve.effect import Advice, Parameter


@dataclass(frozen=True, eq=False)
class BenchFault:
    """Something that the bench may do: what it is called, the parameters that say how much, their size in words, and
    what to do about it.

    `gain` is the reduction of the chi-square that the linear answers promise.
    """

    name: str
    parameters: tuple[NuisanceParameter, ...]
    words: Callable[[np.ndarray], str]
    advice: Advice
    gain: float = 0.0


def with_bench_faults(
    nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest, tuple[WhatToDo, ...]]:
    """The nominal fit with the bench faults that the readings show, what that leaves, and what to do about them."""
    found: list[BenchFault] = []
    for _ in range(options.bench.most_faults):
        fault = _likeliest(nominal, scores, [one.name for one in found], options=options)
        if fault is None:
            break
        study = nominal.study
        extended = study.nominal.extended(fault.parameters)
        prepared = study.unweighted().with_nominal(extended)
        point = np.append(nominal.fit.point, np.zeros(len(fault.parameters)))
        better = fit_nominal_near(prepared, point, full_weight=not study.weights)
        if nominal.fit.chi_square - rescored(study, better.fit).chi_square < 0.5 * fault.gain:
            break  # the linear answers were wrong: it is something else
        nominal, scores = better, score_test(better, better.fit, options=options)
        found.append(fault)
    return nominal, scores, tuple(what_to_do(_words(nominal, fault), fault.advice) for fault in found)


def _words(nominal: NominalFit, fault: BenchFault) -> str:
    places = {p.name: k for k, p in enumerate(nominal.study.nominal.parameters)}
    values = [p.at(nominal.fit.point[places[p.name]]) for p in fault.parameters]
    return fault.words(np.array(values))


def _likeliest(
    nominal: NominalFit, scores: ScoreTest, taken: Sequence[str], *, options: DiagnosisOptions
) -> BenchFault | None:
    """The bench fault that explains most of what is left, beside the likeliest causes too; None where none does."""
    study, fit = nominal.study, nominal.fit
    faults = [fault for fault in bench_faults(study, nominal, options=options) if fault.name not in taken]
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

    def reduction(columns: np.ndarray, priors: int) -> float:
        A = np.column_stack([nominal.J, columns])
        p = nominal.J.shape[1]
        H, gradient = A.T @ A, A.T @ nominal.fit.residual
        prior = np.concatenate([np.ones(p), np.zeros(columns.shape[1] - priors), np.ones(priors)])
        gradient[:p] -= nominal.fit.point
        return float(gradient @ inverse_of(H + np.diag(prior)) @ gradient)

    return reduction(np.column_stack([beside, S]), S.shape[1]) - reduction(beside, 0)


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


def bench_faults(study: Study, nominal: NominalFit, *, options: DiagnosisOptions) -> list[BenchFault]:
    """What the bench of a session may do."""
    valve, records = study.session.valve, study.session.training
    supply = float(valve.supply_pressure)
    faults = []
    for frequency in _frequencies(study, nominal, options=options):
        faults.append(_wave(records, "supply_pressure", "the supply pressure ripples", frequency,
                            options.bench.ripple * supply, "Pa"))  # fmt: skip
        command = records[0].command
        size = options.bench.hum * float(np.max([np.ptp(r.values[command]) for r in records]))
        faults.append(_wave(records, command, f"the {command} hums", frequency, size, UNITS[command]))
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


def _frequencies(study: Study, nominal: NominalFit, *, options: DiagnosisOptions) -> list[float]:
    """The few frequencies (Hz) at which what is left stands furthest above what is left beside them."""
    longest = max(predictor.record.duration for predictor in study.predictors)
    highest = min(predictor.record.rate for predictor in study.predictors) / 2.0
    grid = np.arange(options.bench.turns / longest, options.bench.highest_share * highest, 0.5 / longest)
    if len(grid) < options.bench.beside_bins:
        return []
    from scipy.ndimage import median_filter

    power = _power(study, nominal, grid)
    over = power / np.maximum(median_filter(power, options.bench.beside_bins), 1e-300)
    found: list[float] = []
    for k in np.argsort(-over, kind="stable"):
        if over[k] < options.bench.peak or len(found) == options.bench.frequencies:
            break
        if all(abs(grid[k] - other) > 3.0 / longest for other in found):
            best = float(grid[k])
            for reach in (0.5, 0.025):  # a thousandth of a turn counts where the ripple stands far above the noise
                fine = best + reach * np.linspace(-1.0, 1.0, 41) / longest
                best = float(fine[int(np.argmax(_power(study, nominal, fine)))])
            found.append(best)
    return found


def _power(study: Study, nominal: NominalFit, frequencies: np.ndarray) -> np.ndarray:
    """The power (n,) of what is left at frequencies (n,) Hz, over all channels and records, each of power one."""
    power = np.zeros(len(frequencies))
    for predictor, read in zip(study.predictors, nominal.fit.readings, strict=True):
        record = predictor.record
        residual = residual_of(record, read)
        waves = np.exp(-2j * np.pi * np.outer(frequencies, record.time))
        for name in record.outputs:
            left = np.where(record.usable[name], residual[name][:, 0], 0.0)
            power += np.abs(waves @ left) ** 2 / max(float(left @ left), 1e-300)
    return power


def _wave(records, column: str, words: str, frequency: float, size: float, unit: str) -> BenchFault:
    """A wave of one frequency on an input, of any amplitude and phase in each record."""
    parameters = tuple(
        NuisanceParameter(f"wave@{record.name}:{column}:{frequency:.4g}:{phase:.3g}", unit, 0.0, size,
                          (-4.0 * size, 4.0 * size), input=Wave(record.name, column, frequency, phase))
        for record in records
        for phase in (0.0, 0.5 * np.pi)
    )  # fmt: skip

    def said(values: np.ndarray) -> str:
        amplitude = float(np.median(np.hypot(values[::2], values[1::2])))
        return f"{words} by {value_text(amplitude, unit)} at {frequency:.4g} Hz"

    return BenchFault(f"{column} at {frequency:.4g} Hz", parameters, said, OF_WAVE.get(column, HUM))


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

    return BenchFault(f"{column} {'drift' if growing else 'offset'}", parameters, said, OF_INPUT[column])


def _of_sensors(words: str, effect: ToleratedSensorError, channels: Sequence[str], size: float) -> BenchFault:
    parameters = tuple(
        NuisanceParameter(f"{effect.name}@{channel}", "1", 0.0, size, effect.amplitude.bounds, effect.on(channel))
        for channel in channels
    )
    return BenchFault(
        effect.name, parameters, lambda values: f"{words} by up to {np.abs(values).max() * 1e6:.3g} ppm", CLOCKS
    )


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
        f"meter_drift@{channel}",
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
