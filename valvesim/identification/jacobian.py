"""Sensitivities of the readings of a record to nuisance parameters and to candidates."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.prior import NominalModel, NuisanceParameter
from valvesim.identification.sensor_errors import ToleratedTimeError, reads_channel
from valvesim.valve.effect import Effect
from valvesim.valve.parameters import Valve


def is_simulated(effect: Effect, *, options: IdentificationOptions) -> bool:
    """Whether an effect acts within a few steps of the trajectory's grid: it is simulated, at its size."""
    return effect.time_scale < options.sensitivity.simulated_below


def is_held(parameter: NuisanceParameter, linear: LinearisedRecord) -> bool:
    """Whether a parameter is too fast for the grid of a preliminary fit: a fit that followed it ends in a wrong
    resonance.
    """
    return linear.predictor.preliminary and parameter.time_scale < linear.predictor.options.sensitivity.fast


@dataclass(frozen=True, eq=False)
class PerturbedVariants:
    """A variant with each nuisance parameter but the sensors' moved a little, by `steps` prior deviations, by name.

    `valves` holds those of the quantities `of_valve` side by side, (k, 1); `others` are the rest, by name.
    """

    steps: dict[str, float]
    of_valve: tuple[str, ...]
    valves: Valve
    others: dict[str, ModelVariant]


def perturbed_variants(nominal: NominalModel, variant: ModelVariant) -> PerturbedVariants:
    """The variant with each nuisance parameter but the sensors' moved by a little, see `_prior_step`."""
    plant = [p for p in nominal.parameters if p.sensor is None]
    steps = {p.name: _prior_step(p, variant, options=nominal.options) for p in plant}
    own = [p for p in plant if p.is_of_valve]
    values: dict[str, Any] = {p.name: np.full((len(own), 1), p.value_in(variant)) for p in own}
    for k, p in enumerate(own):
        values[p.name][k] = p.more_of(variant, steps[p.name] * p.deviation)
    others = {p.name: p.moved(variant, steps[p.name]) for p in plant if not p.is_of_valve}
    return PerturbedVariants(steps, tuple(values), replace(variant.valve, **values), others)


def _prior_step(parameter: NuisanceParameter, variant: ModelVariant, *, options: IdentificationOptions) -> float:
    """The step of a parameter in prior standard deviations: downwards where it is at its upper bound."""
    return _inward_step(parameter, variant, options.sensitivity.step)


def _inward_step(parameter: NuisanceParameter, variant: ModelVariant, size: float) -> float:
    """A step of a size in prior standard deviations, downwards where it would leave the upper bound."""
    return size if parameter.more_of(variant, size * parameter.deviation) <= parameter.bounds[1] else -size


def parameter_sensitivities(
    linear: LinearisedRecord, nominal: NominalModel, perturbed: PerturbedVariants
) -> dict[str, np.ndarray]:
    """Sensitivities (n_samples, p) to one prior standard deviation of each nuisance parameter, see
    `perturbed_variants`.

    None of what is held, see `is_held`.
    """
    plant, own = [p for p in nominal.parameters if p.sensor is None], linear.predictor.record.name
    held = {p.name for p in plant if is_held(p, linear)}
    held |= {p.name for p in plant if p.input is not None and p.input.record != own}
    of_valve = [k for k, name in enumerate(perturbed.of_valve) if name not in held]
    others = [name for name in perturbed.others if name not in held]
    free = {p.name: p for p in plant}
    order = [*(perturbed.of_valve[k] for k in of_valve), *others]
    changes = linear.changes_of_valves(perturbed.valves, len(perturbed.of_valve))[of_valve] if of_valve else None
    slopes = linear.small_difference([perturbed.others[name] for name in others], changes)
    for columns in slopes.values():
        columns /= [perturbed.steps[one] for one in order]
    for j in linear.diverging(slopes):
        p = free[order[j]]
        step = _inward_step(p, linear.variant, linear.predictor.options.sensitivity.simulated_step)
        for name, answer in _run_or_nothing(linear, p.moved(linear.variant, step)).items():
            slopes[name][:, j] = answer / step
    places = {p.name: k for k, p in enumerate(nominal.parameters)}
    sensors = [(p, p.sensor) for p in nominal.parameters if p.sensor is not None]
    out = {}
    for name, read in linear.readings.items():
        out[name] = np.zeros((len(read), len(places)))
        out[name][:, [places[one] for one in order]] = slopes[name]
        for p, sensor in sensors:
            if reads_channel(sensor, name, own):
                out[name][:, places[p.name]] = _sensor_slope(linear, p, name) * p.deviation
    return out


def _run_or_nothing(linear: LinearisedRecord, variant: ModelVariant) -> dict[str, np.ndarray]:
    """`simulated_difference`, or no answer where the variant cannot be run."""
    try:
        return linear.simulated_difference(variant)
    except (SolveError, InputError):
        return {name: np.zeros_like(read) for name, read in linear.readings.items()}


def _sensor_slope(linear: LinearisedRecord, parameter: NuisanceParameter, channel: str) -> np.ndarray:
    """Slope (n_samples,) of a reading over a sensor's small error, by a step much shorter than its deviation; to both
    sides for an error of when it reads: lines between points have a corner where a reading without it is.
    """
    assert parameter.sensor is not None  # noqa: S101 - the caller has chosen those with a sensor
    sensor, step, name = parameter.sensor, 0.1 * parameter.deviation, parameter.sensor.amplitude.name

    def read(by: float) -> np.ndarray:
        return linear.read_beside(sensor(**{name: by}))

    if isinstance(sensor, ToleratedTimeError):
        return (read(step) - read(-step)) / (2.0 * step)
    return (read(step) - linear.readings[channel]) / step


def candidate_sensitivities(
    linear: LinearisedRecord,
    candidates: Sequence[Candidate],
    changed: Sequence[ModelVariant],
    nominal: NominalModel,
    known: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Sensitivities (n_samples, q) to each candidate, whose variant at its size is `changed`.

    What a nuisance parameter does within its tolerance it does beyond it, and so does an effect that is the same thing:
    their sensitivities are a share of the `known` ones, see `parameter_sensitivities`.
    """
    out = {name: np.zeros((len(linear.predictor.record.time), len(candidates))) for name in linear.readings}
    quick, places = [], {p.name: j for j, p in enumerate(nominal.parameters)}
    for k, (candidate, variant) in enumerate(zip(candidates, changed, strict=True)):
        effect = candidate.effect
        if (shared := candidate.share(variant, linear.variant)) is not None:
            p, share = shared
            for name in out:
                out[name][:, k] = share * known[name][:, places[p.name]]
        elif effect is None or effect.reading is None:
            quick.append(k)
        elif effect.channel in out:
            name = effect.channel
            out[name][:, k] = (
                linear.predictor.apply_sensors({name: linear.trajectory.at_valve[name]}, linear.trajectory, variant)[
                    name
                ]
                - linear.readings[name]
            )
    options = linear.predictor.options
    run = dict[int, dict[str, np.ndarray]]()
    for k in quick:
        fast = candidates[k].effect
        if fast is not None and is_simulated(fast, options=options):
            with suppress(SolveError, InputError):  # linear where it cannot be run
                run[k] = linear.simulated_difference(changed[k])
    slow = [k for k in quick if k not in run]
    moved = linear.linear_difference([changed[k] for k in slow])
    run |= {slow[j]: _run_or_nothing(linear, changed[slow[j]]) for j in linear.diverging(moved)}
    for name in out:
        out[name][:, slow] = moved[name]
        for k, read in run.items():
            out[name][:, k] = read[name]
    return out
