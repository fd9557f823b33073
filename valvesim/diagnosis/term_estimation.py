"""A free term estimated inside the simulation, together with the nuisance parameters, by Gauss-Newton.

Symbols
    t nuisance parameters in prior deviations, v values of the term at its knots, s logarithms of its memory's figure
    D = r'r + t't + |B v|^2 + (s - s_0)^2: penalised chi-square; B second differences, offset and slope over their
    priors' widths (a penalised B-spline: Eilers and Marx 1996)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.term_sensitivities import visited_values
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import predict_readings, whitened_residual
from valvesim.identification.fit_jacobian import linearise_study
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.projection import inverse_of
from valvesim.identification.study import Study
from valvesim.valve.additive_term import LAG, NONE, PATH, TermHypothesis, linear_b_splines, term_effect
from valvesim.valve.effect import ActiveEffect

RECOVERED_TERM = "recovered_term"


@dataclass(frozen=True, eq=False)
class TermFit:
    """A point of the search: nuisance parameters, values at the knots, logarithm of the memory's figure, and what
    was run.
    """

    point: np.ndarray
    values: np.ndarray
    memory_log: float
    chi_square: float
    readings: tuple[dict[str, np.ndarray], ...]
    residual: np.ndarray


@dataclass(frozen=True, eq=False)
class TermEstimate:
    """Where a search ended: the posterior `covariance` of [t, v, s], and the answers `J`, `V` that it was seen with."""

    state: TermFit
    covariance: np.ndarray
    J: np.ndarray
    V: np.ndarray


@dataclass(frozen=True, eq=False)
class TermProblem:
    """A term hypothesis on its knots (k,), in a study. `size` is the term's own; `visits` (k,) the samples near each
    knot.

    `free` where the values come from a formula, which needs no prior to be smooth.
    """

    study: Study
    hypothesis: TermHypothesis
    knots: np.ndarray
    visits: np.ndarray
    size: float
    options: DiagnosisOptions
    free: bool = False

    def active(self, values: np.ndarray, memory_log: float) -> ActiveEffect:
        """The term at values (k,) and at a multiple exp(figure) of the hypothesis's memory."""
        hypothesis, by = self.hypothesis, float(np.exp(memory_log))
        figures = {LAG: {"time_constant": hypothesis.time_constant * by}, PATH: {"width": hypothesis.width * by}}
        effect = term_effect(
            hypothesis.port.name, hypothesis.variable.name, tuple(self.knots), (self.size,) * len(self.knots),
            memory=hypothesis.memory, time_constant=hypothesis.time_constant, width=hypothesis.width,
            name=RECOVERED_TERM,
        )  # fmt: skip
        heights = {f"value_{k + 1}": float(v) for k, v in enumerate(values)}
        return effect(share=1.0, **heights, **figures.get(hypothesis.memory, {}))

    def variant(self, point: np.ndarray, values: np.ndarray, memory_log: float) -> ModelVariant:
        return self.study.nominal.at(point).with_effect(self.active(values, memory_log))

    def penalty(self) -> np.ndarray:
        """(k, k) precision of the values: second differences, each value a hundred sizes wide; offset and slope.

        Offset and slope can nearly always be had from the nuisance parameters too, and these have tolerances: a term
        that took them for nothing would show the unit's scatter.
        """
        k = len(self.knots)
        if self.free:
            return np.zeros((k, k))
        B = np.diff(np.eye(k), 2, axis=0) / (self.options.missing_term.bend_deviation * self.size)
        precision = B.T @ B + np.eye(k) / (100.0 * self.size) ** 2
        line = np.linalg.pinv(self.taken_up()) / (self.options.missing_term.line_deviation * self.size)
        return precision + line.T @ line

    def taken_up(self) -> np.ndarray:
        """(k, 0 to 2) shapes that the nuisance parameters can bring too: offset, and slope of what is not remembered.

        The direction of a path turns its sign, so that nothing takes its offset up.
        """
        u = np.interp(self.knots, self.knots[[0, -1]], [-1.0, 1.0])
        return np.column_stack([np.ones_like(u), u])[:, : {NONE: 2, LAG: 1, PATH: 0}[self.hypothesis.memory]]

    def evaluate(self, point: np.ndarray, values: np.ndarray, memory_log: float) -> TermFit:
        """By running every training record. Raises SolveError, InputError where that fails."""
        study, variant = self.study, self.variant(point, values, memory_log)
        readings = predict_readings(study, variant)
        residual = whitened_residual(study, readings)
        chi_square = float(
            residual @ residual
            + point @ point
            + values @ self.penalty() @ values
            + (memory_log / self.options.missing_term.memory_deviation) ** 2
        )
        if not np.isfinite(chi_square):
            raise SolveError("the readings of this term are beyond all sense")
        return TermFit(point, values, memory_log, chi_square, readings, residual)


def estimate_term(
    nominal: NominalFit, hypothesis: TermHypothesis, count: int, below: float, *, options: DiagnosisOptions
) -> tuple[TermProblem, TermEstimate] | None:
    """A hypothesis's term on `count` knots by Gauss-Newton upon true runs; None where that will not come `below`."""
    study = nominal.study
    visited = visited_values(nominal.linearised, hypothesis)
    low, high = (float(u) for u in np.quantile(visited, [options.missing_term.tail, 1.0 - options.missing_term.tail]))
    if not high > low:
        return None
    knots = hypothesis.knots(low, high, count)
    problem = TermProblem(study, hypothesis, knots, linear_b_splines(visited, knots).sum(axis=0), 1.0, options=options)
    p = len(nominal.fit.point)
    V = term_columns(problem, nominal.linearised, None)
    size = _term_size(nominal, V)
    if size is None:
        return None
    problem = replace(problem, size=size)
    state = TermFit(
        nominal.fit.point, np.zeros(count), 0.0, nominal.fit.chi_square, nominal.fit.readings, nominal.fit.residual
    )
    J = nominal.J
    for _ in range(options.missing_term.steps):
        H, gradient = term_normal_equations(problem, state, J, V)
        inverse = inverse_of(H)
        step = inverse @ gradient
        predicted_reduction, gained = float(gradient @ step), nominal.fit.chi_square - state.chi_square
        if state.chi_square - 2.0 * predicted_reduction > below:
            return None
        if predicted_reduction < max(options.missing_term.ftol, options.missing_term.relative_ftol * gained):
            break
        longest = float(np.max(np.abs(step[:p])))
        new = shortened_step(problem, state, step * min(1.0, options.missing_term.longest_step / max(longest, 1e-9)), p)
        if new is None:
            break
        small, state = state.chi_square - new.chi_square < options.missing_term.last_share * gained, new
        if small:  # seen from near enough
            break
        J, V = _linearised_at(problem, state)
    return (problem, TermEstimate(state, inverse, J, V)) if np.any(state.values) else None


def _linearised_at(problem: TermProblem, state: TermFit) -> tuple[np.ndarray, np.ndarray]:
    """The answers J (rows, p) and V (rows, k [+ 1]) from where a state is."""
    linearised, columns = linearise_study(problem.study, problem.variant(state.point, state.values, state.memory_log))
    return problem.study.stack(columns), term_columns(problem, linearised, state)


def term_columns(problem: TermProblem, linearised: Sequence[LinearisedRecord], state: TermFit | None) -> np.ndarray:
    """Whitened sensitivities (rows, k [+ 1]) to each value at a knot and to the memory's figure, from where the
    linearised records stand.

    Without a state the linearised records have no term: its memory's figure then shows nothing, and has no column of
    its own yet.
    """
    count = len(problem.knots)
    values = np.zeros(count) if state is None else state.values
    memory_log = 0.0 if state is None else state.memory_log
    step = 1e-2 * problem.size
    moves = [(values + step * unit, memory_log) for unit in np.eye(count)]
    by = [step] * count
    if problem.hypothesis.memory != NONE:
        moves.append((values, memory_log + problem.options.missing_term.memory_step))
        by.append(problem.options.missing_term.memory_step)

    def columns_of(linear: LinearisedRecord) -> dict[str, np.ndarray]:
        own = tuple(a for a in linear.variant.effects if state is None or a.effect.name != RECOVERED_TERM)
        bare = replace(linear.variant, effects=own)
        moved = linear.linear_difference([bare.with_effect(problem.active(v, f)) for v, f in moves])
        return {name: columns / np.array(by) for name, columns in moved.items()}

    return problem.study.stack(problem.study.each(columns_of, linearised))


def _term_size(nominal: NominalFit, V: np.ndarray) -> float | None:
    """The size of a term (largest value) by the linearised equations, V (rows, k); None where the data do not see
    it.
    """
    p = nominal.J.shape[1]
    columns = np.column_stack([nominal.J, V])
    H = columns.T @ columns
    H[:p, :p] += np.eye(p)
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(scale, scale) + 1e-6 * np.eye(len(scale))
    gradient = columns.T @ nominal.fit.residual
    gradient[:p] -= nominal.fit.point
    values = (np.linalg.solve(H, gradient / scale) / scale)[p:]
    size = float(np.ptp(values) / 2.0)
    return size if np.isfinite(size) and size > 0.0 else None


def term_normal_equations(
    problem: TermProblem, state: TermFit, J: np.ndarray, V: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(H, gradient) of [t, v, s], with their priors."""
    p, k = J.shape[1], len(problem.knots)
    columns = np.column_stack([J, V])
    prior = np.zeros((columns.shape[1],) * 2)
    prior[:p, :p] = np.eye(p)
    prior[p : p + k, p : p + k] = problem.penalty()
    prior[p + k :, p + k :] = problem.options.missing_term.memory_deviation**-2
    at = np.concatenate([state.point, state.values, [state.memory_log] * (columns.shape[1] - p - k)])
    return columns.T @ columns + prior, columns.T @ state.residual - prior @ at


def shortened_step(problem: TermProblem, state: TermFit, step: np.ndarray, p: int) -> TermFit | None:
    """The first of shorter and shorter steps whose chi-square is lower; None where none is."""
    k, limits = len(problem.knots), problem.study.nominal.limits
    for share in (1.0, 0.5, 0.2, 0.05):
        by = share * step
        memory_log = state.memory_log + float(np.clip(by[p + k :].sum(), -1.0, 1.0))
        try:
            new = problem.evaluate(np.clip(state.point + by[:p], *limits), state.values + by[p : p + k], memory_log)
        except (SolveError, InputError):  # a figure that no valve can have: a shorter step
            continue
        if new.chi_square < state.chi_square:
            return new
    return None
