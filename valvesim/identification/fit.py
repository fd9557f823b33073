"""A point of a fit: nuisance parameters and fitted candidates, what they predict, and the penalised chi-square.

Symbols
    r whitened residual, t nuisance parameters in prior standard deviations, s logarithms of shape parameters
    D = r'r + t't + |s - s0|^2: penalised chi-square, minus twice the log posterior but for a constant
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from valvesim.errors import SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant, PosedRun, Trajectory, at_rest_together
from valvesim.identification.prior import NominalModel
from valvesim.identification.study import PreparedSession, Study, residual_of


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """A candidate in a fit: its amplitude above neutral, in the unit of the amplitude, and its shape parameters."""

    candidate: Candidate
    above_neutral: float
    shapes: tuple[tuple[str, float], ...] = ()

    def apply_to(self, variant: ModelVariant) -> ModelVariant:
        """The variant with this candidate in it."""
        return self.candidate.apply_to(variant, self.above_neutral, **dict(self.shapes))


def with_shapes(
    candidate: Candidate, above_neutral: float, known: Mapping[str, float] | None = None
) -> FittedCandidate:
    """A candidate to be fitted from an amplitude, its shapes as `known` by name, or else where they are looked for."""
    sought = dict(candidate.fixed) | dict(known or {})
    return FittedCandidate(
        candidate, above_neutral, tuple((p.name, sought.get(p.name, p.default)) for p in candidate.shapes())
    )


@dataclass(frozen=True, eq=False)
class Fit:
    """A point of a fit: nuisance parameters (p,) and fitted candidates, the readings that they predict, and the
    penalised chi-square.

    `rows` is the chi-square that noise alone would leave, `predicted_reduction` what the linearised equations still
    promise, `occam_factor` twice the log ratio of prior to posterior width (MacKay 1992), `shape_occam_factor` what of
    it the shapes add to the amplitudes' own, `wald_statistics` by how much the chi-square would be larger without each
    candidate by the linearised equations (Wald 1943), none where that is not known. `trajectories` are kept for
    `linearise_fit`.
    """

    point: np.ndarray
    fitted: tuple[FittedCandidate, ...]
    chi_square: float
    readings: tuple[dict[str, np.ndarray], ...]
    residual: np.ndarray
    rows: float
    predicted_reduction: float = 0.0
    occam_factor: float = 0.0
    shape_occam_factor: float = 0.0
    wald_statistics: tuple[float, ...] = ()
    trajectories: tuple[Trajectory, ...] = ()

    @cached_property
    def layout(self) -> tuple[tuple[FittedCandidate, str], ...]:
        """The layout of the fitted candidates in `vector`: of each its amplitude (""), then its shapes by name."""
        return tuple((member, shape) for member in self.fitted for shape in ("", *(name for name, _ in member.shapes)))

    @property
    def fitted_shapes(self) -> int:
        """How many shapes are fitted, of all candidates together."""
        return len(self.layout) - len(self.fitted)

    @property
    def vector(self) -> np.ndarray:
        """The parameter vector: nuisance parameters, then `layout`, shapes as logarithms."""
        own = [np.log(dict(member.shapes)[shape]) if shape else member.above_neutral for member, shape in self.layout]
        return np.array([*self.point, *own])

    def with_fitted(self, fitted: Sequence[FittedCandidate]) -> Fit:
        """The same nuisance parameters with other candidates; the trajectories are not theirs and are left."""
        return replace(self, fitted=tuple(fitted), wald_statistics=(), trajectories=())

    def with_posterior_of(self, other: Fit) -> Fit:
        """The same with what the normal equations of another fit of its candidates tell of them."""
        return replace(
            self,
            occam_factor=other.occam_factor,
            shape_occam_factor=other.shape_occam_factor,
            wald_statistics=other.wald_statistics,
        )

    def variant(self, nominal: NominalModel) -> ModelVariant:
        """The valve and effects of this fit."""
        variant = nominal.at(self.point)
        for member in self.fitted:
            variant = member.apply_to(variant)
        return variant


def evaluate_fit(
    study: Study, point: np.ndarray, fitted: tuple[FittedCandidate, ...], near: Sequence[Trajectory] = ()
) -> Fit:
    """The fit at a point, by simulating every training record, from where trajectories of all of them `near` it rest if
    there are any. Raises SolveError, InputError where that fails.
    """
    fit = Fit(point, fitted, 0.0, (), np.zeros(0), 0.0)
    did_run = _run(study, fit.variant(study.nominal), near)
    fit = rescored(study, replace(fit, readings=tuple(readings for _, readings in did_run)))
    return fit if study.is_long else replace(fit, trajectories=tuple(trajectory for trajectory, _ in did_run))


def predict_readings(study: PreparedSession, variant: ModelVariant) -> tuple[dict[str, np.ndarray], ...]:
    """What each training record's sensors would read of a variant, by running it."""
    return tuple(readings for _, readings in _run(study, variant))


def _run(
    study: PreparedSession, variant: ModelVariant, near: Sequence[Trajectory] = ()
) -> list[tuple[Trajectory, dict[str, np.ndarray]]]:
    """The trajectory of each training record and what its sensors would read; `near` are trajectories of another
    variant of all records, or none: what one of them is the very run of is not run again.
    """
    known: Sequence[Trajectory | None] = near or [None] * len(study.predictors)

    def run(posed: PosedRun, initial: np.ndarray, one: Trajectory | None) -> tuple[Trajectory, dict[str, np.ndarray]]:
        ran = None if one is None or not posed.is_run_of(one) else posed.predictor.on_grid(one)
        trajectory = ran or posed.trajectory(initial)
        return trajectory, posed.predictor.readings(trajectory, variant)

    posed = study.each(lambda predictor, one: predictor.posed(variant, one), study.predictors, known)
    return study.each(run, posed, at_rest_together(posed, near), known)


def is_adequate(fit: Fit, *, options: IdentificationOptions) -> bool:
    """Whether a fit leaves little more than noise: linear answers about another one are worth little."""
    return fit.chi_square <= largest_adequate(fit, options=options)


def largest_adequate(fit: Fit, *, options: IdentificationOptions) -> float:
    """The chi-square up to which a fit of as many rows is adequate."""
    return options.fit.inadequate_ratio * fit.rows


def whitened_residual(study: Study, readings: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
    """(rows,) of all training records."""
    return study.stack([residual_of(b.record, r) for b, r in zip(study.predictors, readings, strict=True)])[:, 0]


def rescored(study: Study, fit: Fit) -> Fit:
    """The same point and readings under a study's noise and weights."""
    residual = whitened_residual(study, fit.readings)
    shape_prior = sum(
        (np.log(value / default) / study.options.fit.shape_deviation) ** 2
        for member in fit.fitted
        for value, default in shapes_and_defaults(member)
    )
    chi_square = float(residual @ residual + fit.point @ fit.point + shape_prior)
    if not chi_square < study.options.fit.largest_chi_square:
        raise SolveError("the readings of this variant are beyond all sense")
    rows = study.expected_rows
    scored = replace(fit, chi_square=chi_square, residual=residual, rows=rows)
    return replace(
        scored, predicted_reduction=0.0, occam_factor=0.0, shape_occam_factor=0.0, wald_statistics=()
    )


def shapes_and_defaults(member: FittedCandidate) -> list[tuple[float, float]]:
    """(value, prior median) of each fitted shape parameter."""
    fixed = dict(member.candidate.fixed)
    defaults = {p.name: fixed.get(p.name, p.default) for p in member.candidate.shapes()}
    return [(value, defaults[name]) for name, value in member.shapes]


def amplitude_limits(candidate: Candidate, *, options: IdentificationOptions) -> tuple[float, float]:
    """The box of an amplitude while it is fitted: at zero itself a step would not see its direction."""
    low, high = candidate.limits
    return (
        options.fit.least_amplitude * candidate.typical if candidate.one_sided else options.fit.interior * low
    ), options.fit.interior * high


def shape_bounds(member: FittedCandidate, shape: str) -> tuple[float, float]:
    """The bounds of a shape parameter."""
    return next(p.bounds for p in member.candidate.shapes() if p.name == shape)


def step_limits(fit: Fit, nominal: NominalModel, *, options: IdentificationOptions) -> np.ndarray:
    """(2, n): how far down and up each component of `Fit.vector` may go; nuisance parameters within their bounds.

    One beyond its bounds comes back by no more than the longest step.
    """
    low, high = nominal.limits - fit.point
    longest = options.fit.longest_step
    limits = list(zip(np.minimum(low, longest), np.maximum(high, -longest), strict=True))
    for member, shape in fit.layout:
        if shape:
            times = np.clip(
                np.array(shape_bounds(member, shape)) / dict(member.shapes)[shape],
                1.0 / options.fit.shape_stride,
                options.fit.shape_stride,
            )
            limits.append(tuple(np.log(times)))
        else:
            least, most = amplitude_limits(member.candidate, options=options)
            limits.append((least - member.above_neutral, most - member.above_neutral))
    return np.transpose(limits)


def moved_candidates(fit: Fit, step: np.ndarray, *, options: IdentificationOptions) -> tuple[FittedCandidate, ...]:
    """The fitted candidates after a step of their amplitudes and of the logarithms of their shapes."""
    above_neutral_by_id = {id(member): member.above_neutral for member in fit.fitted}
    shapes = {id(member): dict(member.shapes) for member in fit.fitted}
    for (member, shape), by in zip(fit.layout, step, strict=True):
        if shape:
            value = shapes[id(member)][shape] * np.exp(by)
            shapes[id(member)][shape] = float(np.clip(value, *shape_bounds(member, shape)))
        else:
            above_neutral_by_id[id(member)] = float(
                np.clip(member.above_neutral + by, *amplitude_limits(member.candidate, options=options))
            )
    return tuple(
        replace(e, above_neutral=above_neutral_by_id[id(e)], shapes=tuple(shapes[id(e)].items())) for e in fit.fitted
    )


def moved_fit(fit: Fit, step: np.ndarray, *, options: IdentificationOptions) -> Fit:
    """Nuisance parameters and fitted candidates after a step of `Fit.vector`; nothing is simulated there."""
    p = len(fit.point)
    moved = fit.with_fitted(moved_candidates(fit, step[p:], options=options))
    return replace(moved, point=fit.point + step[:p])
