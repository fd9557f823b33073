"""What no known cause explains, recovered as a function: where it acts, of what, with memory or without.

The families of free terms are ranked by what they would explain of the base fit's residual, each drawn by straight
lines; the best are then estimated inside the simulation, together with the base parameters, and the one whose
deviance is lowest for its freedom stays. Last, a formula is tried on what was found.

Symbols
    t base parameters in prior deviations, v values of the term at its knots, s logarithms of its memory's figure
    D = r'r + t't + |B v|^2 + (s - s_0)^2: deviance with the priors; B second differences, offset and slope over their
    priors' widths
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .answer import Term
from .effects import ActiveEffect
from .errors import InputError, SolveError
from .evidence import inverse_of
from .hypotheses import View
from .prediction import Variant
from .scene import Scene, argument, look
from .study import BaseFit, Study, predict, see, whitened_residual
from .terms import LAG, NONE, PATH, Family, hats, term_effect

NAME = "recovered_term"
KNOTS, FINE_KNOTS, FEW_KNOTS = 11, 47, 6  # of a term's function, where its shape asks for more, and where the term ...
SLIGHT = 3.0  # ... explains less than so many times what KNOTS of them cost
FINE_LOOK = 24  # knots of the functions by which that is found out
WORTH = 15.0  # fall of the deviance, beyond the price of its freedom, that a term must bring to be told
ODD_MARGIN, ODD_SHARE = 10.0, 0.02  # deviance, or share of the fall, that memory or a strange variable must bring
TRIED, NEAR = 2, 0.75  # families estimated inside the simulation: so many, whose score is this share of the best's
STEPS = 5
SETTLED, SETTLED_SHARE, SMALL_SHARE = 1.0, 3e-3, 0.05  # fall of the deviance, and shares of it, not worth another step
LONGEST_STEP = 3.0  # of a base parameter at once, in prior deviations
EDGE = 0.002  # share of the samples beyond the outermost knots, at either end
LINE = 0.25  # prior deviation of offset and of slope over half the range, in units of the term's own size
BEND = 1.0  # prior deviation of a second difference, in units of the term's own size
MEMORY_DEVIATION = 1.0  # of the logarithm of a time constant or width
STEP = 0.1  # of such a logarithm, in differences
FORMULA_ERROR, FORMULAS = 0.1, 2  # relative error up to which a formula is offered, and how many are tried
PURE_SHARE, MIXED_SHARE = 0.04, 0.02  # of what the term explains, that a formula may leave: no model is the plant
HELD_STEPS, HELD_SHARE = 3, 0.1  # steps of a fit held to a formula; and a fall, as a share of the lack, that ends them
SYMBOLS = {
    "current": "i", "armature_angle": "theta", "load_differential_pressure": "p", "spool_position": "x",
    "spool_velocity": "v",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Recovered:
    """A term found: `term` for the answer, `active` the effect that has it, and the fit: point (p,) of the base
    parameters, deviance, how many figures of the term are free, readings of each training record, the variant that ran.
    """  # fmt: skip

    term: Term
    active: ActiveEffect
    point: np.ndarray
    deviance: float
    freedom: int
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
class _Solution:
    """Where a search ended: the posterior `covariance` of [t, v, s], and the answers `J`, `V` that it was seen with."""

    state: _State
    covariance: np.ndarray
    J: np.ndarray
    V: np.ndarray


@dataclass(frozen=True, eq=False)
class _Problem:
    """A family on its knots (k,), in a study. `size` is the term's own; `visits` (k,) the samples near each knot.

    `free` where the values come from a formula, which needs no prior to be smooth.
    """

    study: Study
    family: Family
    knots: np.ndarray
    visits: np.ndarray
    size: float
    free: bool = False

    def active(self, values: np.ndarray, figure: float) -> ActiveEffect:
        """The term at values (k,) and at a multiple exp(figure) of the family's memory."""
        family, by = self.family, float(np.exp(figure))
        figures = {LAG: {"time_constant": family.time_constant * by}, PATH: {"width": family.width * by}}
        effect = term_effect(
            family.port.name, family.variable.name, tuple(self.knots), (self.size,) * len(self.knots),
            memory=family.memory, time_constant=family.time_constant, width=family.width, name=NAME,
        )  # fmt: skip
        heights = {f"value_{k + 1}": float(v) for k, v in enumerate(values)}
        return effect(share=1.0, **heights, **figures.get(family.memory, {}))

    def variant(self, point: np.ndarray, values: np.ndarray, figure: float) -> Variant:
        return self.study.base.at(point).with_effect(self.active(values, figure))

    def penalty(self) -> np.ndarray:
        """(k, k) precision of the values: second differences, each value a hundred sizes wide; offset and slope.

        Offset and slope can nearly always be had from the base parameters too, and these have tolerances: a term that
        took them for nothing would show the unit's scatter.
        """
        k = len(self.knots)
        if self.free:
            return np.zeros((k, k))
        B = np.diff(np.eye(k), 2, axis=0) / (BEND * self.size)
        precision = B.T @ B + np.eye(k) / (100.0 * self.size) ** 2
        line = np.linalg.pinv(self.taken_up()) / (LINE * self.size)
        return precision + line.T @ line

    def taken_up(self) -> np.ndarray:
        """(k, 0 to 2) shapes that the base parameters can bring too: offset, and slope of what is not remembered.

        The direction of a path turns its sign, so that nothing takes its offset up.
        """
        u = np.linspace(-1.0, 1.0, len(self.knots))
        return np.column_stack([np.ones_like(u), u])[:, : {NONE: 2, LAG: 1, PATH: 0}[self.family.memory]]

    def evaluate(self, point: np.ndarray, values: np.ndarray, figure: float) -> _State:
        """By running every training record. Raises SolveError, InputError where that fails."""
        study, variant = self.study, self.variant(point, values, figure)
        readings = predict(study, variant)
        residual = whitened_residual(study, readings)
        deviance = float(
            residual @ residual + point @ point + values @ self.penalty() @ values + (figure / MEMORY_DEVIATION) ** 2
        )
        if not np.isfinite(deviance):
            raise SolveError("the readings of this term are beyond all sense")
        return _State(point, values, figure, deviance, readings, residual)


def recover(base: BaseFit, scene: Scene) -> Recovered | None:
    """The term that explains most, for its freedom, of what the base fit leaves; None where none explains anything.

    `scene` is the base fit looked at with its families (`scene.look`).
    """
    if not scene.families:
        return None
    price = float(np.log(len(base.fit.residual)))
    least, best = base.fit.deviance - WORTH, None
    for_terms = replace(base, study=replace(base.study, candidates=()))  # `scene` has tested the candidates already
    fine = look(for_terms, base.fit, searched=[f for f in scene.families if f.memory == NONE], knots=FINE_LOOK)
    looks = {KNOTS: scene, FINE_KNOTS: fine}
    ranked, margin = _ranked(looks)
    for family, count in ranked[:TRIED]:
        cost = price * (count + (family.memory != NONE)) + family.oddities * margin
        found = _estimate(base, family, count, least - cost)
        if found is not None and found[1].state.deviance + cost < least:
            least, best = found[1].state.deviance + cost, found
    if best is None:
        return None
    problem, solution = best
    formula, error, remembers = "", float("nan"), problem.family.memory != NONE
    freedom = len(problem.knots) + remembers
    held = _with_formula(problem, solution, base.fit.deviance - solution.state.deviance)
    if held is not None:
        (new, formula, figures), old = held, solution.state.values
        freedom = figures + remembers
        error = _difference(problem, new.state.values, old)
        solution = new
    state = solution.state
    term = _term(
        problem, solution, formula, error, _alike(looks.get(len(problem.knots), scene), problem.family, margin)
    )
    return Recovered(
        term, problem.active(state.values, state.figure), state.point, state.deviance, freedom,
        state.readings, problem.variant(state.point, state.values, state.figure),
    )  # fmt: skip


# ---------------------------------------------------------------- which family


def _ranked(looks: dict[int, Scene]) -> tuple[list[tuple[Family, int]], float]:
    """Families worth estimating, best first, each with its knots; and the price of an oddity.

    `looks` are by the knots that a term gets which shows there; what counts is what a family explains less what its
    freedom costs.
    """
    gains, found = [], []
    for count, scene in looks.items():
        price = np.log(max(sum(scene.gram.rows), 2))
        for family, (value, freedom) in zip(scene.families, scene.family_tests(), strict=True):
            gains.append(value - price * freedom)
            slight = count == KNOTS and value < SLIGHT * price * KNOTS
            found.append((family, FEW_KNOTS if slight else count))
    margin = max(ODD_MARGIN, ODD_SHARE * max(gains, default=0.0))
    score = np.array(gains) - margin * np.array([family.oddities for family, _ in found])
    order = [int(k) for k in np.argsort(-score, kind="stable") if score[k] > 0.0]
    ranked: list[tuple[Family, int]] = []
    for k in order:
        if score[k] < NEAR * score[order[0]]:
            break
        family, count = found[k]
        if all((_place(f), f.memory) != (_place(family), family.memory) for f, _ in ranked):
            ranked.append((family, count))
    return ranked, margin


def _alike(scene: Scene, family: Family, margin: float) -> tuple[str, ...]:
    """Labels of the other families that explain nearly as much, best first: of each port and variable the best."""
    gains = [value for value, _ in scene.family_tests()]
    least = max(g for g, f in zip(gains, scene.families, strict=True) if _place(f) == _place(family)) - margin
    near = [scene.families[k] for k in np.argsort(gains, kind="stable")[::-1] if gains[k] > least]
    places = dict.fromkeys(map(_place, near))
    return tuple(next(f.label for f in near if _place(f) == place) for place in places if place != _place(family))


def _place(family: Family) -> tuple[str, str]:
    return family.port.name, family.variable.name


# ---------------------------------------------------------------- inside the simulation


def _estimate(base: BaseFit, family: Family, count: int, below: float) -> tuple[_Problem, _Solution] | None:
    """A family's term on `count` knots by Gauss-Newton upon true runs; None where that will not come `below`."""
    study = base.study
    visited = np.concatenate([argument(seen, replace(family, memory=NONE)) for seen in base.views])
    low, high = (float(u) for u in np.quantile(visited, [EDGE, 1.0 - EDGE]))
    if not high > low:
        return None
    knots = np.linspace(low, high, count)
    problem = _Problem(study, family, knots, hats(visited, knots).sum(axis=0), 1.0)
    p = len(base.fit.point)
    V = _columns(problem, base.views, None)
    size = _size(base, V)
    if size is None:
        return None
    problem = replace(problem, size=size)
    state = _State(base.fit.point, np.zeros(count), 0.0, base.fit.deviance, base.fit.readings, base.fit.residual)
    J = base.J
    for _ in range(STEPS):
        H, gradient = _normal(problem, state, J, V)
        inverse = inverse_of(H)
        step = inverse @ gradient
        promised, gained = float(gradient @ step), base.fit.deviance - state.deviance
        if state.deviance - 2.0 * promised > below:
            return None
        if promised < max(SETTLED, SETTLED_SHARE * gained):
            break
        longest = float(np.max(np.abs(step[:p])))
        new = _stepped(problem, state, step * min(1.0, LONGEST_STEP / max(longest, 1e-9)), p)
        if new is None:
            break
        small, state = state.deviance - new.deviance < SMALL_SHARE * gained, new
        if small:  # seen from near enough
            break
        J, V = _seen_from(problem, state)
    return (problem, _Solution(state, inverse, J, V)) if np.any(state.values) else None


def _seen_from(problem: _Problem, state: _State) -> tuple[np.ndarray, np.ndarray]:
    """The answers J (rows, p) and V (rows, k [+ 1]) from where a state is."""
    views, columns = see(problem.study, problem.variant(state.point, state.values, state.figure))
    return problem.study.stack(columns), _columns(problem, views, state)


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
        own = tuple(a for a in seen.variant.effects if state is None or a.effect.name != NAME)
        bare = replace(seen.variant, effects=own)
        moved = seen.by_answer([bare.with_effect(problem.active(v, f)) for v, f in moves])
        return {name: columns / np.array(by) for name, columns in moved.items()}

    return problem.study.stack(problem.study.each(answers, views))


def _size(base: BaseFit, V: np.ndarray) -> float | None:
    """The size of a term (largest value) by the linear equations, V (rows, k); None where the data do not see it."""
    p = base.J.shape[1]
    columns = np.column_stack([base.J, V])
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


# ---------------------------------------------------------------- a formula


@dataclass(frozen=True, eq=False)
class _Formula:
    """A sum of shapes at the knots: `F` (k, m) at `coefficients` (m,); `write(coefficients)` says it in words.

    It has so many free `figures`, those within its shapes among them.
    """

    F: np.ndarray
    write: Callable[[np.ndarray], str]
    coefficients: np.ndarray
    figures: int
    cost: float
    pure: bool


@dataclass(frozen=True, eq=False)
class _Shape:
    """A shape over the knots: `columns(b)` (k, 1 or 2), how it is written, and where its figure b is looked for."""

    columns: Callable[[float], np.ndarray]
    write: Callable[[float, np.ndarray], str]
    figures: np.ndarray | None = None


def _library(u: np.ndarray, x: str) -> list[_Shape]:
    """The shapes that a formula may have, over knots u (k,)."""
    reach, spacing = float(np.max(np.abs(u))), float(np.min(np.diff(u)))
    widths = reach * np.geomspace(0.02, 1.0, 25)
    periods = np.geomspace(3.0 * spacing, 1.5 * float(np.ptp(u)), 80)

    def power(shape: np.ndarray, text: str) -> _Shape:
        return _Shape(lambda b: shape[:, None], lambda b, a: f"{a[0]:.3g} {text}")

    return [
        power(np.ones_like(u), ""), power(u, x), power(u * u, f"{x}^2"), power(u * np.abs(u), f"{x} |{x}|"),
        power(u**3, f"{x}^3"), power(np.abs(u), f"|{x}|"),
        _Shape(lambda b: np.tanh(u / b)[:, None], lambda b, a: f"{a[0]:.3g} tanh({x}/{b:.3g})", widths),
        _Shape(lambda b: (-np.sign(u) * np.expm1(-np.abs(u) / b))[:, None],
               lambda b, a: f"{a[0]:.3g} sign({x}) (1 - exp(-|{x}|/{b:.3g}))", widths),
        _Shape(lambda b: np.column_stack([np.sin(2.0 * np.pi * u / b), np.cos(2.0 * np.pi * u / b)]),
               lambda b, a: f"{np.hypot(*a):.3g} sin(2 pi {x}/{b:.4g} {np.arctan2(a[1], a[0]):+.2f})", periods),
    ]  # fmt: skip


def _formulas(problem: _Problem, values: np.ndarray, W: np.ndarray, price: float) -> list[_Formula]:
    """Formulas upon the values (k,) that the records ask for, best first: by misfit in their metric, and by price.

    One of each shape, alone and with offset and slope; where it has a figure, at the best.
    """
    from scipy.optimize import minimize_scalar

    u, k = problem.knots, len(problem.knots)
    between = (0.02 * float(np.max(np.abs(values)))) ** 2  # what straight lines miss of a curve
    W = np.linalg.solve(np.eye(k) + between * W, W)
    x = SYMBOLS[problem.family.variable.name]
    extra = {"": np.empty((k, 0)), "c": np.ones((k, 1)), "l": u[:, None], "cl": np.column_stack([np.ones(k), u])}

    def at(shape: _Shape, kind: str, b: float) -> _Formula | None:
        own = shape.columns(b)
        F = np.column_stack([own, extra[kind]])
        scale = np.max(np.abs(F), axis=0)
        if np.linalg.cond(F / scale) > 1e6:
            return None
        normal = (F / scale).T @ W @ (F / scale)
        a = np.linalg.solve(normal, (F / scale).T @ W @ values) / scale
        left = values - F @ a
        figures = len(a) + (shape.figures is not None)
        cost = float(left @ W @ left) + price * figures
        return _Formula(F, _written(shape, b, kind, own.shape[1], x), a, figures, cost, not kind)

    def cost(b: float, shape: _Shape, kind: str) -> float:
        formula = at(shape, kind, b)
        return np.inf if formula is None else formula.cost

    def best(shape: _Shape, kind: str) -> _Formula | None:
        if (tried := shape.figures) is None:
            return at(shape, kind, 1.0)
        costs = [cost(b, shape, kind) for b in tried]
        j = int(np.argmin(costs))
        around = (tried[max(j - 1, 0)], tried[min(j + 1, len(tried) - 1)])
        finer = minimize_scalar(
            cost, bounds=around, args=(shape, kind), method="bounded", options={"xatol": 1e-4 * tried[j]}
        )
        return at(shape, kind, float(finer.x if finer.fun < costs[j] else tried[j]))

    found = [formula for shape in _library(u, x) for kind in extra if (formula := best(shape, kind)) is not None]
    return sorted(found, key=lambda one: one.cost)


def _written(shape: _Shape, b: float, kind: str, own: int, x: str) -> Callable[[np.ndarray], str]:
    names = {"": [], "c": [""], "l": [f" {x}"], "cl": ["", f" {x}"]}[kind]

    def text(a: np.ndarray) -> str:
        more = "".join(f" {'-' if v < 0 else '+'} {abs(v):.3g}{name}" for v, name in zip(a[own:], names, strict=True))
        return shape.write(b, a[:own]).strip() + more

    return text


def _with_formula(problem: _Problem, solution: _Solution, gained: float) -> tuple[_Solution, str, int] | None:
    """The term held to a formula and fitted with it, where the records do not object; the formula, its figures."""
    from scipy.stats import chi2

    # a formula takes the place of the curve's priors: they are left out of its fit, and the misfit is the records' own
    bending, problem = problem.penalty(), replace(problem, free=True)
    state, p, k = solution.state, len(solution.state.point), len(problem.knots)
    state = replace(state, deviance=state.deviance - float(state.values @ bending @ state.values))
    H, gradient = _normal(problem, state, solution.J, solution.V)
    at, rest = np.arange(p, p + k), np.r_[:p, p + k : len(H)]
    back = np.linalg.solve(H[np.ix_(rest, rest)], np.column_stack([gradient[rest], H[np.ix_(rest, at)]]))
    W = H[np.ix_(at, at)] - H[np.ix_(at, rest)] @ back[:, 1:]
    push = gradient[at] - H[np.ix_(at, rest)] @ back[:, 0]
    asked = state.values + np.linalg.pinv(W, rcond=1e-9, hermitian=True) @ push
    formulas = _formulas(problem, asked, W, max(12.0, MIXED_SHARE * gained))
    pure = next(formula for formula in formulas if formula.pure)
    for formula in dict.fromkeys((pure, *formulas[:FORMULAS])):
        values = formula.F @ formula.coefficients
        others = back[:, 0] - back[:, 1:] @ (values - state.values)
        figure = state.figure + float(others[p:].sum())
        try:
            held = problem.evaluate(state.point + others[:p], values, figure)
        except (SolveError, InputError):
            continue
        held, covariance = _held(problem, replace(solution, state=state), held, formula.F)
        share = PURE_SHARE if formula.pure else MIXED_SHARE  # offsets and slopes are what the base has tolerances for
        rise = held.deviance - state.deviance
        chance = float(chi2.isf(1e-3, k - formula.F.shape[1]))
        if rise > max(chance, share * gained):
            continue
        far = _difference(problem, held.values, state.values) > FORMULA_ERROR  # though the records may hardly know
        if far and rise > chance + FORMULA_ERROR**2 * gained:
            continue
        scale = np.max(np.abs(formula.F), axis=0)
        a = np.linalg.lstsq(formula.F / scale, held.values, rcond=None)[0] / scale
        solution = replace(solution, state=held, covariance=covariance)
        return solution, _sentence(problem, formula.write(a), held.figure), formula.figures
    return None


def _held(problem: _Problem, solution: _Solution, held: _State, F: np.ndarray) -> tuple[_State, np.ndarray]:
    """The best state near one whose values are a sum of the columns F (k, m), and its covariance of [t, v, s]."""
    p, (k, m), more = len(held.point), F.shape, solution.V.shape[1] - len(F)
    scale = np.max(np.abs(F), axis=0)
    T = np.zeros((p + k + more, p + m + more))
    T[:p, :p], T[p : p + k, p : p + m], T[p + k :, p + m :] = np.eye(p), F / scale, np.eye(more)
    J, V = solution.J, solution.V
    for _ in range(HELD_STEPS):
        H, gradient = _normal(problem, held, J, V)
        inverse = T @ inverse_of(T.T @ H @ T) @ T.T
        new = _stepped(problem, held, inverse @ gradient, p)
        if new is None:
            break
        small, held = held.deviance - new.deviance < HELD_SHARE * (held.deviance - solution.state.deviance), new
        if small or held.deviance < solution.state.deviance:
            break
        J, V = _seen_from(problem, held)
    return held, inverse


def _difference(problem: _Problem, new: np.ndarray, old: np.ndarray) -> float:
    """Relative root mean square difference of values where the records went, but for offset and slope in the base."""
    weight = np.sqrt(problem.visits)
    A, change = problem.taken_up() * weight[:, None], (new - old) * weight
    left = change - A @ np.linalg.lstsq(A, change, rcond=None)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(new * weight))


def _sentence(problem: _Problem, formula: str, figure: float) -> str:
    family = problem.family
    x, by = SYMBOLS[family.variable.name], float(np.exp(figure))
    memory = {
        NONE: "",
        LAG: f" lagged by {family.time_constant * by * 1e3:.3g} ms",
        PATH: f", times the direction of its path, which turns over {family.width * by:.2g} {family.variable.unit}",
    }[family.memory]
    return f"{formula} {family.port.unit}, {x} = {family.variable.name} in {family.variable.unit}{memory}"


# ---------------------------------------------------------------- the answer


def _term(problem: _Problem, solution: _Solution, formula: str, error: float, alike: tuple[str, ...]) -> Term:
    p, k = len(solution.state.point), len(problem.knots)
    variance = np.diag(solution.covariance)[p : p + k]
    family = problem.family
    return Term(
        port=family.port.name, port_unit=family.port.unit, variable=family.variable.name,
        variable_unit=family.variable.unit, memory=family.memory, at=tuple(map(float, problem.knots)),
        value=tuple(map(float, solution.state.values)), deviation=tuple(map(float, np.sqrt(np.maximum(variance, 0.0)))),
        formula=formula, formula_error=error, alike=alike,
    )  # fmt: skip
