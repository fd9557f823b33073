"""What no known cause explains, recovered as a function: where it acts, of what, with memory or without.

The families of free terms are ranked by what they would explain of the base fit's residual, each drawn by straight
lines; the best are then estimated inside the simulation, together with the base parameters, and the one whose
deviance is lowest for its freedom stays. Last, a formula is tried on what was found.

Symbols
    t base parameters in prior deviations, v values of the term at its knots, s logarithms of its memory's figure
    D = r'r + t't + |B v|^2 + (s - s_0)^2: deviance with the priors; B second differences over their prior's width
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .answer import Term
from .effects import ActiveEffect
from .errors import InputError, SolveError
from .evidence import block_statistic, project
from .hypotheses import View, neighbours, parameter_columns, view
from .prediction import Variant
from .scene import Scene, argument
from .study import BaseFit, Study, each, gram_of, residual_of
from .terms import LAG, NONE, PATH, Family, families, hats, term_effect

KNOTS = 11
WORTH = 15.0  # fall of the deviance, beyond the price of its freedom, that a term must bring to be told
MEMORY_MARGIN, MEMORY_SHARE = 10.0, 0.02  # deviance, or share of the fall, that memory must bring
TRIED = 2  # families that are estimated inside the simulation
STEPS, SETTLED = 5, 1.0
LONGEST_STEP = 3.0  # of a base parameter at once, in prior deviations
EDGE = 0.002  # share of the samples beyond the outermost knots, at either end
BEND = 1.0  # prior deviation of a second difference, in units of the term's own size
MEMORY_DEVIATION = 1.0  # of the logarithm of a time constant or width
STEP = 0.1  # of such a logarithm, in differences
FORMULA_ERROR = 0.1


@dataclass(frozen=True, eq=False)
class Recovered:
    """A term found: `term` for the answer, `active` the effect that has it, and the fit: point (p,) of the base
    parameters, deviance, readings of each training record, the variant that ran.
    """  # fmt: skip

    term: Term
    active: ActiveEffect
    family: Family
    point: np.ndarray
    deviance: float
    readings: tuple[dict[str, np.ndarray], ...]
    variant: Variant


@dataclass(frozen=True, eq=False)
class _State:
    """A point of the search: base point, values at the knots, logarithm of the memory's figure, and what was run."""

    point: np.ndarray
    values: np.ndarray
    figure: float
    deviance: float
    readings: tuple[dict[str, np.ndarray], ...]
    residual: np.ndarray


@dataclass(frozen=True, eq=False)
class _Problem:
    """A family on its knots (k,), in a study; `bend` is the prior deviation of second differences."""

    study: Study
    family: Family
    knots: np.ndarray
    size: float

    def active(self, values: np.ndarray, figure: float) -> ActiveEffect:
        """The term at values (k,) and at a multiple exp(figure) of the family's memory."""
        family, by = self.family, float(np.exp(figure))
        ranged = np.linspace(-self.size, self.size, len(values))  # the bounds follow from the size, not from the values
        effect = term_effect(
            family.port.name, family.variable.name, self.knots, ranged, memory=family.memory,
            time_constant=family.time_constant * by, width=family.width * by,
        )  # fmt: skip
        return effect(share=1.0, **{f"value_{k + 1}": float(v) for k, v in enumerate(values)})

    def variant(self, point: np.ndarray, values: np.ndarray, figure: float) -> Variant:
        return self.study.base.at(point).with_effect(self.active(values, figure))

    def penalty(self) -> np.ndarray:
        """(k, k) precision of the values: second differences, and each value a hundred sizes wide."""
        k = len(self.knots)
        B = np.diff(np.eye(k), 2, axis=0) / (BEND * self.size)
        return B.T @ B + np.eye(k) / (100.0 * self.size) ** 2

    def evaluate(self, point: np.ndarray, values: np.ndarray, figure: float) -> _State:
        """By running every training record. Raises SolveError, InputError where that fails."""
        study, variant = self.study, self.variant(point, values, figure)
        readings = each(lambda bench: bench.readings(bench.run(variant), variant), study.benches)
        pairs = zip(study.benches, readings, strict=True)
        residual = study.stack([residual_of(bench.record, read) for bench, read in pairs])[:, 0]
        deviance = float(
            residual @ residual + point @ point + values @ self.penalty() @ values + (figure / MEMORY_DEVIATION) ** 2
        )
        if not np.isfinite(deviance):
            raise SolveError("the readings of this term are beyond all sense")
        return _State(point, values, figure, deviance, tuple(readings), residual)


def recover(base: BaseFit, scene: Scene) -> Recovered | None:
    """The term that explains most, for its freedom, of what the base fit leaves; None where none explains anything.

    `scene` is the base fit looked at with its families (`scene.look`).
    """
    if not scene.families:
        return None
    found = []
    for family in _ranked(scene)[:TRIED]:
        estimated = _estimate(base, family)
        if estimated is not None:
            found.append(estimated)
    price = np.log(max(len(base.fit.residual), 2))
    worth = [(state.deviance + price * _freedom(problem), problem, state, C) for problem, state, C in found]
    if not worth:
        return None
    least, problem, state, C = min(worth, key=lambda one: one[0])
    if base.fit.deviance - least < WORTH:
        return None
    term = _term(problem, state, C)
    active = problem.active(state.values, state.figure)
    variant = problem.variant(state.point, state.values, state.figure)
    return Recovered(term, active, problem.family, state.point, state.deviance, state.readings, variant)


def _freedom(problem: _Problem) -> int:
    return len(problem.knots) + (problem.family.memory != NONE)


# ---------------------------------------------------------------- which family


def _ranked(scene: Scene) -> list[Family]:
    """Families worth estimating, best first: by what they explain less what their freedom costs, the simpler first."""
    price = np.log(max(sum(scene.gram.rows), 2))
    tests = scene.family_tests()
    gains = [value - price * freedom for value, freedom in tests]
    most = max((gain for gain, family in zip(gains, scene.families, strict=True) if family.memory == NONE), default=0.0)
    margin = max(MEMORY_MARGIN, MEMORY_SHARE * most)
    score = [gain - (margin if family.memory != NONE else 0.0) for gain, family in zip(gains, scene.families, strict=True)]
    order = [int(k) for k in np.argsort(-np.array(score), kind="stable") if score[k] > 0.0]
    ranked: list[Family] = []
    for k in order:
        family = scene.families[k]
        if all((f.port, f.variable, f.memory) != (family.port, family.variable, family.memory) for f in ranked):
            ranked.append(family)
    return ranked


# ---------------------------------------------------------------- inside the simulation


def _estimate(base: BaseFit, family: Family) -> tuple[_Problem, _State, np.ndarray] | None:
    """A family's term by Gauss-Newton upon true runs; the posterior covariance of [t, v, s] too. None where it fails."""
    study = base.study
    visited = np.concatenate([argument(seen, replace(family, memory=NONE)) for seen in base.views])
    low, high = (float(u) for u in np.quantile(visited, [EDGE, 1.0 - EDGE]))
    if not high > low:
        return None
    knots = np.linspace(low, high, KNOTS)
    problem = _Problem(study, family, knots, 1.0)
    p = len(base.fit.point)
    V = _columns(problem, base.views, None)
    size = _size(base, V)
    if size is None:
        return None
    problem = replace(problem, size=size)
    state = _State(base.fit.point, np.zeros(KNOTS), 0.0, base.fit.deviance, base.fit.readings, base.fit.residual)
    J, views = base.J, base.views
    for k in range(STEPS + 1):
        H, gradient = _normal(problem, state, J, V)
        inverse = _inverse(H)
        step = inverse @ gradient
        if k == STEPS or float(gradient @ step) < SETTLED:
            break
        longest = float(np.max(np.abs(step[:p])))
        new = _stepped(problem, state, step * min(1.0, LONGEST_STEP / max(longest, 1e-9)), p)
        if new is None:
            break
        state = new
        variant = problem.variant(state.point, state.values, state.figure)
        views = tuple(each(lambda bench, variant=variant: view(bench, variant), study.benches))
        beside = neighbours(study.base, variant)
        J = study.stack(each(lambda seen, beside=beside: parameter_columns(seen, study.base, beside), views))
        V = _columns(problem, views, state)
    return (problem, state, inverse) if np.any(state.values) else None


def _columns(problem: _Problem, views: Sequence[View], state: _State | None) -> np.ndarray:
    """Whitened answers (rows, k [+ 1]) to each value at a knot and to the memory's figure, from where the views stand.

    Without a state the views have no term: its memory's figure then shows nothing, and has no column of its own yet.
    """
    count = len(problem.knots)
    values = np.zeros(count) if state is None else state.values
    figure = 0.0 if state is None else state.figure
    step = 1e-2 * problem.size
    moves = [(values + step * unit, figure) for unit in np.eye(count)]
    by = [step] * count
    if problem.family.memory != NONE:
        moves.append((values, figure + STEP))
        by.append(STEP)

    def answers(seen: View) -> dict[str, np.ndarray]:
        own = tuple(a for a in seen.variant.effects if state is None or a.effect.name != "recovered_term")
        bare = replace(seen.variant, effects=own)
        moved = seen.by_answer([bare.with_effect(problem.active(v, f)) for v, f in moves])
        return {name: columns / np.array(by) for name, columns in moved.items()}

    return problem.study.stack(each(answers, views))


def _size(base: BaseFit, V: np.ndarray) -> float | None:
    """The size of a term (largest value) by the linear equations, little smoothed; None where the data do not see it."""
    p = base.J.shape[1]
    columns = np.column_stack([base.J, V[:, :KNOTS]])
    H = columns.T @ columns
    H[:p, :p] += np.eye(p)
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    H = H / np.outer(scale, scale) + 1e-6 * np.eye(len(scale))
    gradient = columns.T @ base.fit.residual
    gradient[:p] -= base.fit.point
    values = (np.linalg.solve(H, gradient / scale) / scale)[p:]
    size = float(np.ptp(values) / 2.0)
    return size if np.isfinite(size) and size > 0.0 else None


def _normal(problem: _Problem, state: _State, J: np.ndarray, V: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, gradient) of [t, v, s], with their priors."""
    p, k = J.shape[1], len(problem.knots)
    columns = np.column_stack([J, V])
    prior = np.zeros((columns.shape[1],) * 2)
    prior[:p, :p] = np.eye(p)
    prior[p : p + k, p : p + k] = problem.penalty()
    prior[p + k :, p + k :] = MEMORY_DEVIATION**-2
    at = np.concatenate([state.point, state.values, [state.figure] * (columns.shape[1] - p - k)])
    return columns.T @ columns + prior, columns.T @ state.residual - prior @ at


def _inverse(H: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.diag(H))
    return np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(scale, scale)


def _stepped(problem: _Problem, state: _State, step: np.ndarray, p: int) -> _State | None:
    """The first of shorter and shorter steps whose deviance is lower; None where none is."""
    k = len(problem.knots)
    for share in (1.0, 0.5, 0.2, 0.05):
        by = share * step
        figure = state.figure + float(np.clip(by[p + k :].sum(), -1.0, 1.0))
        try:
            new = problem.evaluate(state.point + by[:p], state.values + by[p : p + k], figure)
        except (SolveError, InputError):  # a figure that no valve can have: a shorter step
            continue
        if new.deviance < state.deviance:
            return new
    return None


# ---------------------------------------------------------------- the answer


def _term(problem: _Problem, state: _State, C: np.ndarray) -> Term:
    p, k = len(state.point), len(problem.knots)
    covariance = C[p : p + k, p : p + k]
    family = problem.family
    return Term(
        port=family.port.name, port_unit=family.port.unit, variable=family.variable.name,
        variable_unit=family.variable.unit, memory=family.memory, at=tuple(map(float, problem.knots)),
        value=tuple(map(float, state.values)), deviation=tuple(float(v) for v in np.sqrt(np.maximum(np.diag(covariance), 0.0))),
        formula="", formula_error=float("nan"),
    )  # fmt: skip
