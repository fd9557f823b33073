"""A formula for a recovered term, from a short library, fitted inside the simulation and held against the spline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.term_estimation import (
    TermEstimate,
    TermFit,
    TermProblem,
    _linearised_at,
    shortened_step,
    term_normal_equations,
)
from valvesim.errors import InputError, SolveError
from valvesim.identification.projection import inverse_of
from valvesim.valve.additive_term import LAG, NONE, PATH, TermHypothesis

PLAIN_FORMS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "{x}": lambda u: u,
    "{x}^2": np.square,
    "{x} |{x}|": lambda u: u * np.abs(u),
    "{x}^3": lambda u: u**3,
    "|{x}|": np.abs,
    "sign({x})": np.sign,
}
"""Forms of one parameter as they are written, of a variable (k,)."""

SYMBOLS = {
    "current": "i", "armature_angle": "theta", "pilot_differential_pressure": "p", "spool_position": "x",
    "spool_velocity": "v",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class FittedFormula:
    """A sum of shapes at the knots: `F` (k, m) at `coefficients` (m,); `write(coefficients)` says it in words.

    It has so many free `figures`, those within its shapes among them.
    """

    F: np.ndarray
    write: Callable[[np.ndarray], str]
    coefficients: np.ndarray
    free_parameters: int
    cost: float
    pure: bool


@dataclass(frozen=True, eq=False)
class LibraryFunction:
    """A shape over the knots: `columns(b)` (k, 1 or 2), how it is written, and where its figure b is looked for."""

    columns: Callable[[float], np.ndarray]
    write: Callable[[float, np.ndarray], str]
    free_parameters: np.ndarray | None = None


def formula_library(u: np.ndarray, x: str) -> list[LibraryFunction]:
    """The shapes that a formula may have, over knots u (k,), but for a jump evenly spaced."""
    reach, spacing = float(np.max(np.abs(u))), float(np.median(np.diff(u)))
    widths = reach * np.geomspace(0.02, 1.0, 25)
    periods = np.geomspace(3.0 * spacing, 1.5 * float(np.ptp(u)), 80)

    def power(shape: np.ndarray, text: str) -> LibraryFunction:
        return LibraryFunction(lambda b: shape[:, None], lambda b, a: f"{a[0]:.3g} {text}")

    return [
        power(np.ones_like(u), ""), *(power(form(u), text.format(x=x)) for text, form in PLAIN_FORMS.items()),
        LibraryFunction(lambda b: np.tanh(u / b)[:, None], lambda b, a: f"{a[0]:.3g} tanh({x}/{b:.3g})", widths),
        LibraryFunction(lambda b: (-np.sign(u) * np.expm1(-np.abs(u) / b))[:, None],
               lambda b, a: f"{a[0]:.3g} sign({x}) (1 - exp(-|{x}|/{b:.3g}))", widths),
        LibraryFunction(lambda b: np.column_stack([np.sin(2.0 * np.pi * u / b), np.cos(2.0 * np.pi * u / b)]),
               lambda b, a: f"{np.hypot(*a):.3g} sin(2 pi {x}/{b:.4g} {np.arctan2(a[1], a[0]):+.2f})", periods),
    ]  # fmt: skip


def _fitted_formulas(problem: TermProblem, values: np.ndarray, W: np.ndarray, price: float) -> list[FittedFormula]:
    """Formulas upon the values (k,) that the records ask for, best first: by misfit in their metric, and by penalty.

    One of each shape, alone and with offset and slope; where it has a figure, at the best.
    """
    from scipy.optimize import minimize_scalar

    u, k = problem.knots, len(problem.knots)
    between = (0.02 * float(np.max(np.abs(values)))) ** 2  # what straight lines miss of a curve
    W = np.linalg.solve(np.eye(k) + between * W, W)
    x = SYMBOLS[problem.hypothesis.variable.name]
    extra = {"": np.empty((k, 0)), "c": np.ones((k, 1)), "l": u[:, None], "cl": np.column_stack([np.ones(k), u])}

    def at(shape: LibraryFunction, kind: str, b: float) -> FittedFormula | None:
        own = shape.columns(b)
        F = np.column_stack([own, extra[kind]])
        scale = np.max(np.abs(F), axis=0)
        if np.linalg.cond(F / scale) > 1e6:
            return None
        normal = (F / scale).T @ W @ (F / scale)
        if np.linalg.cond(normal) > problem.options.missing_term.formula_condition:
            return None
        a = np.linalg.solve(normal, (F / scale).T @ W @ values) / scale
        left = values - F @ a
        free_parameters = len(a) + (shape.free_parameters is not None)
        cost = float(left @ W @ left) + price * free_parameters
        return FittedFormula(F, _formula_text(shape, b, kind, own.shape[1], x), a, free_parameters, cost, not kind)

    def cost(b: float, shape: LibraryFunction, kind: str) -> float:
        formula = at(shape, kind, b)
        return np.inf if formula is None else formula.cost

    def best(shape: LibraryFunction, kind: str) -> FittedFormula | None:
        if (tried := shape.free_parameters) is None:
            return at(shape, kind, 1.0)
        costs = [cost(b, shape, kind) for b in tried]
        j = int(np.argmin(costs))
        around = (tried[max(j - 1, 0)], tried[min(j + 1, len(tried) - 1)])
        nearer = minimize_scalar(
            cost, bounds=around, args=(shape, kind), method="bounded", options={"xatol": 1e-4 * tried[j]}
        )
        return at(shape, kind, float(nearer.x if nearer.fun < costs[j] else tried[j]))

    found = [formula for shape in formula_library(u, x) for kind in extra if (formula := best(shape, kind)) is not None]
    return sorted(found, key=lambda one: one.cost)


def _formula_text(shape: LibraryFunction, b: float, kind: str, own: int, x: str) -> Callable[[np.ndarray], str]:
    names = {"": [], "c": [""], "l": [f" {x}"], "cl": ["", f" {x}"]}[kind]

    def text(a: np.ndarray) -> str:
        more = "".join(f" {'-' if v < 0 else '+'} {abs(v):.3g}{name}" for v, name in zip(a[own:], names, strict=True))
        return shape.write(b, a[:own]).strip() + more

    return text


def with_formula(
    problem: TermProblem, solution: TermEstimate, gained: float, price: float
) -> tuple[TermEstimate, str, int] | None:
    """The term held to a formula and fitted with it, where the records do not object; the formula, its figures.

    They may object by as much as the figures that it saves would cost, at a `price` each, where it stays near the term.
    """
    from scipy.stats import chi2

    # a formula takes the place of the curve's priors: they are left out of its fit, and the misfit is the records' own
    bending, problem = problem.penalty(), replace(problem, free=True)
    state, p, k = solution.state, len(solution.state.point), len(problem.knots)
    state = replace(state, chi_square=state.chi_square - float(state.values @ bending @ state.values))
    H, gradient = term_normal_equations(problem, state, solution.J, solution.V)
    at, rest = np.arange(p, p + k), np.r_[:p, p + k : len(H)]
    back = np.linalg.solve(H[np.ix_(rest, rest)], np.column_stack([gradient[rest], H[np.ix_(rest, at)]]))
    W = H[np.ix_(at, at)] - H[np.ix_(at, rest)] @ back[:, 1:]
    push = gradient[at] - H[np.ix_(at, rest)] @ back[:, 0]
    asked = state.values + np.linalg.pinv(W, rcond=1e-9, hermitian=True) @ push
    formulas = _fitted_formulas(problem, asked, W, max(12.0, problem.options.missing_term.mixed_share * gained))
    pure = next((formula for formula in formulas if formula.pure), None)
    if pure is None:
        return None
    for formula in dict.fromkeys((pure, *formulas[: problem.options.missing_term.formulas])):
        values = formula.F @ formula.coefficients
        others = back[:, 0] - back[:, 1:] @ (values - state.values)
        memory_log = state.memory_log + float(others[p:].sum())
        try:
            held = problem.evaluate(state.point + others[:p], values, memory_log)
        except (SolveError, InputError):
            continue
        held, covariance = _fit_formula(problem, replace(solution, state=state), held, formula.F)
        share = (
            problem.options.missing_term.pure_share if formula.pure else problem.options.missing_term.mixed_share
        )  # offsets and slopes are what the nominal model has tolerances for
        rise, saved = held.chi_square - state.chi_square, price * (k - formula.free_parameters)
        chance = float(chi2.isf(1e-3, k - formula.F.shape[1]))
        far = (
            relative_difference(problem, held.values, state.values) > problem.options.missing_term.formula_error
        )  # though the records may hardly know
        if rise > max(chance, share * gained, 0.0 if far else saved):
            continue
        if far and rise > chance + problem.options.missing_term.formula_error**2 * gained:
            continue
        scale = np.max(np.abs(formula.F), axis=0)
        a = np.linalg.lstsq(formula.F / scale, held.values, rcond=None)[0] / scale
        solution = replace(solution, state=held, covariance=covariance)
        return solution, formula_words(problem.hypothesis, formula.write(a), held.memory_log), formula.free_parameters
    return None


def _fit_formula(
    problem: TermProblem, solution: TermEstimate, held: TermFit, F: np.ndarray
) -> tuple[TermFit, np.ndarray]:
    """The best state near one whose values are a sum of the columns F (k, m), and its covariance of [t, v, s]."""
    p, (k, m), more = len(held.point), F.shape, solution.V.shape[1] - len(F)
    scale = np.max(np.abs(F), axis=0)
    T = np.zeros((p + k + more, p + m + more))
    T[:p, :p], T[p : p + k, p : p + m], T[p + k :, p + m :] = np.eye(p), F / scale, np.eye(more)
    J, V = solution.J, solution.V
    for _ in range(problem.options.missing_term.formula_steps):
        H, gradient = term_normal_equations(problem, held, J, V)
        inverse = T @ inverse_of(T.T @ H @ T) @ T.T
        new = shortened_step(problem, held, inverse @ gradient, p)
        if new is None:
            break
        small, held = (
            held.chi_square - new.chi_square
            < problem.options.missing_term.formula_ftol * (held.chi_square - solution.state.chi_square),
            new,
        )
        if small or held.chi_square < solution.state.chi_square:
            break
        J, V = _linearised_at(problem, held)
    return held, inverse


def relative_difference(problem: TermProblem, new: np.ndarray, old: np.ndarray) -> float:
    """Relative root mean square difference of values where the records went, but for offset and slope in the nominal
    model.
    """
    weight = np.sqrt(problem.visits)
    A, change = problem.taken_up() * weight[:, None], (new - old) * weight
    left = change - A @ np.linalg.lstsq(A, change, rcond=None)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(new * weight))


def formula_words(hypothesis: TermHypothesis, formula: str, memory_log: float = 0.0) -> str:
    """A formula of a term with its units and its memory, at a multiple exp(memory_log) of the hypothesis's."""
    x, by = SYMBOLS[hypothesis.variable.name], float(np.exp(memory_log))
    memory = {
        NONE: "",
        LAG: f" lagged by {hypothesis.time_constant * by * 1e3:.3g} ms",
        PATH: ", times the direction of its path, which turns over "
        f"{hypothesis.width * by:.2g} {hypothesis.variable.unit}",
    }[hypothesis.memory]
    return f"{formula} {hypothesis.port.unit}, {x} = {hypothesis.variable.name} in {hypothesis.variable.unit}{memory}"
