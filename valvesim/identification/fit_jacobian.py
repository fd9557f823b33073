"""The Jacobian of a fit: sensitivities of all training records to what is fitted, whitened and stacked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.jacobian import candidate_sensitivities, parameter_sensitivities, perturbed_variants
from valvesim.identification.linearised_record import LinearisedRecord, linearise_record
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant, Trajectory
from valvesim.identification.prior import NuisanceParameter
from valvesim.identification.projection import GramMatrix
from valvesim.identification.study import Study, residual_of


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
    return np.column_stack([J, own / step_sizes(fit, options=study.options)])


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


def step_sizes(fit: Fit, *, options: IdentificationOptions) -> list[float]:
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
