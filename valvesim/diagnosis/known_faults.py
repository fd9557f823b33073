"""Faults of a bench that no record tells: their parameters, their words, and which are significant in a fit.

That goes by a Wald statistic, beside the cause that is named (Wald 1943).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.advice import CLOCKS, HUM, LINEARITY, METER, OF_INPUT, OF_WAVE, TRANSDUCER, what_to_do
from valvesim.diagnosis.detection import nuisance_covariance, wald_statistic
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import WhatToDo
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.between_samples import Wave
from valvesim.identification.input_waves import fitted_waves, wave_words
from valvesim.identification.instrument_errors import (
    DELAYED,
    SHIFTED,
    clock_rates,
    contrasts,
    fastest_drift,
    input_delays,
    input_shifts,
    meter_drifts,
    meter_gains,
    meter_linearity,
    meter_zeros,
    shift_ways,
)
from valvesim.identification.prior import NuisanceParameter, largest_reading, measured_channels
from valvesim.identification.session import UNITS, Session, value_text
from valvesim.identification.study import Study
from valvesim.valve.effect import Advice


@dataclass(frozen=True, eq=False)
class BenchFault:
    """Something that the bench did: the parameters that say how much, their size in words, and what to do about it."""

    parameters: tuple[NuisanceParameter, ...]
    words: Callable[[np.ndarray], str]
    advice: Advice


def told_faults(scores: ScoreTest, *, options: DiagnosisOptions) -> tuple[WhatToDo, ...]:
    """What the bench did by a fit, with what to do about it: what the readings would miss by more than chance."""
    return tuple(
        what_to_do(fault_words(scores, fault, own, scores.fit.point), fault.advice)
        for fault, own in significant_faults(scores, options=options)
    )


def fault_words(scores: ScoreTest, fault: BenchFault, own: Sequence[int], point: np.ndarray) -> str:
    """A fault of the bench in words, by its parameters in the model at a point (p,)."""
    return fault.words(np.array([scores.study.nominal.parameters[k].at(point[k]) for k in own]))


def significant_faults(scores: ScoreTest, *, options: DiagnosisOptions) -> list[tuple[BenchFault, list[int]]]:
    """What the bench did that the readings would miss by more than chance, each with its parameters in the model."""
    at = {p.name: k for k, p in enumerate(scores.study.nominal.parameters)}
    covariance = nuisance_covariance(scores)
    faults = [(f, [at[p.name] for p in f.parameters if p.name in at]) for f in all_known_faults(scores.study)]
    return [(f, own) for f, own in faults if wald_statistic(scores, own, covariance) > options.bench.minimum_gain]


def all_known_faults(study: Study) -> list[BenchFault]:
    """What a bench may do, as it is told; the waves are those of the study."""
    session, options = study.session, study.options
    waves = [BenchFault(wave, _wave_words(wave), _wave_advice(wave)) for wave in _waves_apart(study)]
    shifts = [
        BenchFault(input_shifts(session, column, growing, options), _shift_words(column, growing), OF_INPUT[column])
        for column, growing in shift_ways()
    ]
    late = [
        BenchFault(delays, _delay_words(column), TRANSDUCER)
        for column in DELAYED
        if (delays := input_delays(session, column, options))
    ]
    drifts = [BenchFault((p,), _drift_words(p, session), METER) for p in meter_drifts(session, options)]
    of_meters = (
        (meter_zeros, _zero_words, METER),
        (meter_gains, _gain_words, LINEARITY),
        (meter_linearity, lambda channel: _linearity_words(channel, session), LINEARITY),
    )
    meters = [
        BenchFault(own, words(channel), advice)
        for errors, words, advice in of_meters
        for channel in measured_channels(session)
        if (own := errors(session, channel, options))
    ]
    clocks = BenchFault(clock_rates(session, options), _clock_words, CLOCKS)
    return [*waves, *shifts, *late, clocks, *drifts, *meters]


def _waves_apart(study: Study) -> list[tuple[NuisanceParameter, ...]]:
    """The waves of a study, of those too close to be told apart in its longest record the one that was found first."""
    longest = max(record.duration for record in study.session.training)
    found: list[tuple[Wave, tuple[NuisanceParameter, ...]]] = []
    for parameters in fitted_waves(study.nominal).values():
        wave = parameters[0].input
        if isinstance(wave, Wave) and not any(
            wave.column == other.column and abs(wave.frequency - other.frequency) * longest < 1.0 for other, _ in found
        ):
            found.append((wave, parameters))
    return [parameters for _, parameters in found]


def _wave_words(wave: Sequence[NuisanceParameter]) -> Callable[[np.ndarray], str]:
    return lambda values: wave_words(wave, values)


def _wave_advice(wave: Sequence[NuisanceParameter]) -> Advice:
    deviation = wave[0].input
    return OF_WAVE.get(deviation.column, HUM) if deviation is not None else HUM


def _shift_words(column: str, growing: bool) -> Callable[[np.ndarray], str]:
    what, within = column.replace("_", " "), " within a record" if growing else ""
    unit = SHIFTED[column]
    return lambda values: f"the {what} is off by up to {value_text(float(np.abs(values).max()), unit)}{within}"


def _delay_words(column: str) -> Callable[[np.ndarray], str]:
    what = column.replace("_", " ")
    return lambda values: f"the {what} is read up to {float(np.abs(values).max()) * 1e3:.2g} ms late or early"


def _clock_words(values: np.ndarray) -> str:
    return f"clocks of the channels run apart by up to {float(f'{np.abs(values).max() * 1e6:.3g}'):g} ppm"


def _drift_words(parameter: NuisanceParameter, session: Session) -> Callable[[np.ndarray], str]:
    channel = parameter.sensor.channel if parameter.sensor is not None else ""
    whole = fastest_drift(session, channel)
    return lambda values: f"{channel} as read drifts by {100.0 * abs(values[0]) / whole:.2g} % of its span in a record"


def _zero_words(channel: str) -> Callable[[np.ndarray], str]:
    def words(values: np.ndarray) -> str:
        zeros = contrasts(len(values) + 1) @ values
        by = value_text(float(np.ptp(zeros)), UNITS[channel])
        return f"the zero of {channel} moves by up to {by} between records"

    return words


def _gain_words(channel: str) -> Callable[[np.ndarray], str]:
    def words(values: np.ndarray) -> str:
        gains = contrasts(len(values) + 1) @ values
        return f"the gain of {channel} moves by up to {100.0 * float(np.ptp(gains)):.2g} % between records"

    return words


def _linearity_words(channel: str, session: Session) -> Callable[[np.ndarray], str]:
    largest = largest_reading(session, channel)

    def words(values: np.ndarray) -> str:
        by = 100.0 * float(np.abs(values).max()) / largest
        return f"{channel} as read is off a straight line by up to {by:.2g} % of its largest reading"

    return words
