"""The Jacobian of a fit: sensitivities of all training records to what is fitted, whitened and stacked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import EdgeTime, InputDeviation
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import (
    Fit,
    FittedCandidate,
    predict_readings,
    predict_together,
    step_limits,
    whitened_residual,
)
from valvesim.identification.jacobian import candidate_sensitivities, parameter_sensitivities, perturbed_variants
from valvesim.identification.linearised_record import LinearisedRecord, linearise_record
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant, Trajectory
from valvesim.identification.prior import NuisanceParameter
from valvesim.identification.projection import GramMatrix
from valvesim.identification.study import Study, residual_of
from valvesim.solver.codegen import LANES


def linearise_fit(study: Study, fit: Fit) -> tuple[list[LinearisedRecord], list[dict[str, np.ndarray]]]:
    """Each training record linearised about a fit, see `linearise_study`; its own trajectories are not run again."""
    return linearise_study(study, fit.variant(study.nominal), fit.trajectories)


def linearise_study(
    study: Study, variant: ModelVariant, trajectories: Sequence[Trajectory] = ()
) -> tuple[list[LinearisedRecord], list[dict[str, np.ndarray]]]:
    """Each training record linearised about a variant, and its sensitivities (n_samples, p) to the nuisance parameters.

    `trajectories` are the variant's, where they are known.
    """
    known: Sequence[Trajectory | None] = trajectories or [None] * len(study.predictors)
    linearised = study.each(
        lambda predictor, trajectory: linearise_record(predictor, variant, trajectory), study.predictors, known
    )
    perturbed = perturbed_variants(study.nominal, variant)
    columns = study.each(lambda linear: parameter_sensitivities(linear, study.nominal, perturbed), linearised)
    others = [first != k for k, first in enumerate(study.representatives)]  # which run as another record does
    return [
        replace(linear, predictor=predictor.under(variant.deviations)) if other else linear
        for linear, predictor, other in zip(linearised, study.predictors, others, strict=True)
    ], columns


def jacobian_of(
    study: Study, fit: Fit, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]]
) -> np.ndarray:
    """The whitened Jacobian (rows, n) of a fit linearised at itself, with respect to `Fit.vector`."""
    J = study.stack(columns)
    if not fit.fitted:
        return J
    own = study.stack(fitted_sensitivities(study, fit, linearised, columns))
    return np.column_stack([J, own / _step_sizes(fit, options=study.options)])


def simulated_jacobian(
    study: Study, fit: Fit, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]]
) -> np.ndarray:
    """`jacobian_of` with differences of runs where the linearised equations err by some hundredths: for the valve's
    quantities, the times of edges, and the fitted candidates.

    What errs in a column meets the noise in the gradient, and moves what the records hardly see by deviations.
    """
    J, p = jacobian_of(study, fit, linearised, columns), len(fit.point)
    low, high = step_limits(fit, study.nominal, options=study.options)
    steps = {}
    for k, parameter in enumerate(study.nominal.parameters):
        if parameter.is_of_valve or isinstance(parameter.input, EdgeTime):
            by = study.options.sensitivity.refined_step * (1.0 if high[k] > -low[k] else -1.0)
            steps[k] = by, replace(fit, point=fit.point + by * np.eye(p)[k])
    changes = _changes_together(study, fit, {k: steps[k][1] for k in steps if study.nominal.parameters[k].is_of_valve})
    for k, (by, moved) in steps.items():
        with suppress(SolveError, InputError):
            change = changes.get(k)
            if change is None:
                change = _moved_residual(study, fit, moved, study.nominal.parameters[k].input) - fit.residual
            J[:, k] = -change / by
    sizes = _step_sizes(fit, options=study.options)
    for k, (size, (_, moved)) in enumerate(zip(sizes, perturbed_fits(fit, options=study.options), strict=True)):
        with suppress(SolveError, InputError):
            J[:, p + k] = (fit.residual - _moved_residual(study, fit, moved, None)) / size
    return J


def _changes_together(study: Study, fit: Fit, moved: Mapping[int, Fit]) -> dict[int, np.ndarray]:
    """By how much the whitened residual (rows,) of a fit changes with others whose valves alone are moved; of those
    that can be run, in a session that takes longer than to compile what runs them together.

    Each batch has the fit itself beside it: steps of the integrator that both take do not differ.
    """
    changes, keys = dict[int, np.ndarray](), list(moved)
    points = sum(len(predictor.fine_times) for predictor in study.predictors)
    if len(moved) * points < study.options.sensitivity.together_points:
        return changes
    for first in range(0, len(keys), LANES - 1):
        batch = keys[first : first + LANES - 1]
        with suppress(SolveError, InputError):
            together = predict_together(
                study, [one.variant(study.nominal) for one in (fit, *(moved[k] for k in batch))]
            )
            if together is not None:
                own, *others = (whitened_residual(study, readings) for readings in together)
                changes |= {k: other - own for k, other in zip(batch, others, strict=True)}
    return changes


def _moved_residual(study: Study, fit: Fit, moved: Fit, own: InputDeviation | None) -> np.ndarray:
    """The whitened residual (rows,) of a fit moved, by running its records: of an input, its `own` alone."""
    variant, readings = moved.variant(study.nominal), list(fit.readings)
    if own is None:
        return whitened_residual(study, predict_readings(study, variant))
    for k, predictor in enumerate(study.predictors):
        if predictor.record.name == own.record:
            readings[k] = predictor.readings(predictor.run(variant), variant)
    return whitened_residual(study, readings)


def added_jacobian_of(
    study: Study, linearised: Sequence[LinearisedRecord], parameters: Sequence[NuisanceParameter]
) -> np.ndarray:
    """Whitened sensitivities (rows, k) to one prior deviation of more parameters than a study has, about a fit."""
    own = replace(study.nominal, parameters=tuple(parameters))

    def columns_of(linear: LinearisedRecord) -> dict[str, np.ndarray]:
        return parameter_sensitivities(linear, own, perturbed_variants(own, linear.variant))

    return study.stack([columns_of(linear) for linear in linearised])


def all_candidate_sensitivities(
    study: Study, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]],
    candidates: Sequence[Candidate], changed: Sequence[ModelVariant],
) -> list[dict[str, np.ndarray]]:  # fmt: skip
    """The `candidate_sensitivities` of all records; `columns` are those of the nuisance parameters."""

    def columns_of(linear: LinearisedRecord, known: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return candidate_sensitivities(linear, candidates, changed, study.nominal, known)

    return study.each(columns_of, linearised, columns)


def fitted_sensitivities(
    study: Study, fit: Fit, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]]
) -> list[dict[str, np.ndarray]]:
    """Responses (n_samples, n) to the `perturbed_fits` of a fit, by channel, of each record."""
    steps = perturbed_fits(fit, options=study.options)
    moved = [other.variant(study.nominal) for _, other in steps]
    return all_candidate_sensitivities(study, linearised, columns, [candidate for candidate, _ in steps], moved)


def perturbed_fits(fit: Fit, *, options: IdentificationOptions) -> list[tuple[Candidate, Fit]]:
    """The fit with each fitted candidate moved a little: amplitude by `perturbation`, then each shape."""
    steps = []
    for k, member in enumerate(fit.fitted):
        moved = [replace(member, above_neutral=member.above_neutral + perturbation(member))]
        for j, (name, value) in enumerate(member.shapes):
            shapes = (*member.shapes[:j], (name, value * options.sensitivity.shape_ratio), *member.shapes[j + 1 :])
            moved.append(replace(member, shapes=shapes))
        steps += [(member.candidate, fit.with_fitted((*fit.fitted[:k], m, *fit.fitted[k + 1 :]))) for m in moved]
    return steps


def _step_sizes(fit: Fit, *, options: IdentificationOptions) -> list[float]:
    """By how much each of `perturbed_fits` moves its component of `Fit.vector`."""
    by = float(np.log(options.sensitivity.shape_ratio))
    return [by if shape else perturbation(member) for member, shape in fit.layout]


def perturbation(member: FittedCandidate) -> float:
    """The step of an amplitude: inwards, so that it stays inside its limits."""
    return (
        -0.05 * member.above_neutral
        if abs(member.above_neutral) > 1e-3 * member.candidate.typical
        else 0.01 * member.candidate.typical
    )


def gram_matrix(
    study: Study,
    linearised: Sequence[LinearisedRecord],
    blocks: Sequence[Sequence[dict[str, np.ndarray]]],
    point: np.ndarray,
) -> GramMatrix:
    """The Gram matrix of all records, by segment: `blocks[k]` are the columns of record k, beside its residual."""
    products, rows = [], []
    for linear, own in zip(linearised, blocks, strict=True):
        residual = residual_of(linear.predictor.record, linear.readings)
        joined = {name: np.column_stack([residual[name], *(block[name] for block in own)]) for name in residual}
        parts = [
            np.array_split(white, study.options.sensitivity.segments)
            for white in study.whiten(linear.predictor, joined)
        ]
        for k in range(study.options.sensitivity.segments):
            products.append(sum(part[k].T @ part[k] for part in parts))
            rows.append(sum(len(part[k]) for part in parts))
    return GramMatrix(np.array(products), np.asarray(point, dtype=float), tuple(rows))
