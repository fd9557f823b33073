"""The driver of the integrator: the states over time from an initial value problem, whoever poses it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.errors import SolveError
from valvesim.solver.codegen import LANES, CompiledModel, compile_lanes
from valvesim.solver.rodas5p import STEP_TOO_SMALL, TOO_MANY_STEPS, set_inputs
from valvesim.units import symbol

FIRST_STEP = 1e-5  # s
FEWEST_TOGETHER = 3  # members that take more time alone than in lanes of which the others are idle
ABSOLUTE_SHARE = (
    0.003  # absolute tolerance of the scaled states over the relative one: at 0.01, 10 bar of supply gave 5e-4
)


@dataclass(frozen=True, kw_only=True)
class InitialValueProblem:
    """What the integrator needs.

    `initial` (n,) are the scaled states at time zero, at rest; `starts` and `rows` the input pieces between breaks
    (`inputs.merge`); `knots` (m, n_c) the flat coefficients at `knot_times` (m,), straight in between. States are asked
    for at `times` (n_t,), none beyond `end` (s). `ignored` (n,) is true for states whose error does not matter.
    """

    compiled: CompiledModel
    initial: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    knot_times: np.ndarray
    knots: np.ndarray
    times: np.ndarray
    end: float
    tolerance: float
    most_steps: int
    ignored: np.ndarray | None = None


def integrate(
    problem: InitialValueProblem,
    *,
    slices: int = 1,
    progress: Callable[[float], None] | None = None,
    what: str = "the integration",
    advice: str = "",
) -> tuple[np.ndarray, np.ndarray]:
    """(states (n_t, n) in SI, counts (2,) of accepted and rejected steps).

    `progress` is told the share that is done after each of so many slices of time; `most_steps` are those of a slice.
    Raises SolveError, which says `what` has failed, when, in which state, why, and gives the `advice`.
    """
    run = _run_of_one(problem)
    for k in range(1, slices + 1):
        status = run.go_on(problem.compiled.run, problem.end * k / slices if k < slices else problem.end)
        if status:
            raise _failure(problem, status, run.y[:, 0], float(run.clock[0]), what, advice)
        if progress is not None:
            progress(k / slices)
    if not np.isfinite(run.out[-1:]).all():
        raise SolveError(f"{what} failed: its last states are no numbers. {advice}".rstrip())
    return run.out[:, :, 0] * problem.compiled.scale, run.count


def integrate_parts(
    problem: InitialValueProblem, begins: np.ndarray, ends: np.ndarray, states: np.ndarray, *, what: str
) -> np.ndarray:
    """States (n_t, n) in SI at the times of a problem, which lie in parts of it one after the other: each from a begin
    (k,) on, where the scaled states are `states` (k, n), to an end (k,). Raises SolveError as `integrate` does.
    """
    run = _run_of_one(problem)
    for begin, end, first, y in zip(begins, ends, np.searchsorted(problem.times, begins, "right"), states, strict=True):
        run.y[:, 0], run.clock[:] = y, (begin, min(FIRST_STEP, end - begin), first)
        if status := run.go_on(problem.compiled.run, float(end)):
            raise _failure(problem, status, run.y[:, 0], float(run.clock[0]), what, "")
    return run.out[:, :, 0] * problem.compiled.scale


def integrate_together(problem: InitialValueProblem, initial: np.ndarray, knots: np.ndarray) -> np.ndarray | None:
    """States (k, n_t, n) in SI of k valves, at most `codegen.LANES`, that take their steps together.

    `initial` (k, n) and `knots` (k, m, n_c) stand for those of the problem. Each valve is as exact as alone, for the
    steps are those that the most demanding one needs. None where one of them fails.
    """
    lanes = np.minimum(np.arange(LANES), len(initial) - 1)  # the last valve fills what is left
    rest = np.ascontiguousarray(initial[lanes].T)
    run = _Run(problem, rest, np.ascontiguousarray(np.moveaxis(knots[lanes], 0, -1)))
    if run.go_on(compile_lanes(problem.compiled), problem.end) or not np.isfinite(run.out[-1:]).all():
        return None
    return np.moveaxis(run.out, -1, 0)[: len(initial)] * problem.compiled.scale


def integrate_members(
    problem_of: Callable[[int], InitialValueProblem],
    alone: Callable[[int], np.ndarray],
    initial: np.ndarray,
    knots: np.ndarray,
    members: Sequence[int],
) -> Iterator[np.ndarray | SolveError]:
    """States (n_t, n) in SI of some members of a batch, in order, or why one fails.

    `problem_of` and `alone` give a member's problem and its states by itself; `initial` (k, n) and `knots` (k, m, n_c)
    are those of the batch. Members take their steps together, `codegen.LANES` at a time, at a third to a seventh of the
    time that they take alone. An answer may differ from that alone within the tolerance, with its neighbours among
    `members`.
    """
    for first in range(0, len(members), LANES):
        some = list(members[first : first + LANES])
        states = None
        if len(knots) >= LANES and len(some) >= FEWEST_TOGETHER:
            states = integrate_together(problem_of(some[0]), initial[some], knots[some])
        if states is not None:
            yield from states
            continue
        for member in some:
            try:
                yield alone(member)
            except SolveError as error:
                yield error


class _Run:
    """A run of the compiled integrator and where it stands: `rest` (n, lanes), `knots` (m, n_c, lanes)."""

    def __init__(self, problem: InitialValueProblem, rest: np.ndarray, knots: np.ndarray):
        self.problem, self.rest, self.knots, self.y = problem, rest, knots, rest.copy()
        self.out = np.full((len(problem.times), *rest.shape), np.nan)
        self.clock, self.count = np.array([0.0, min(FIRST_STEP, problem.end), 0.0]), np.zeros(2, dtype=np.int64)
        self.atol = np.full(len(rest), ABSOLUTE_SHARE * problem.tolerance)
        if problem.ignored is not None:
            self.atol[problem.ignored] = np.inf

    def go_on(self, run: Any, end: float) -> int:
        """Advance to a time; the status of `rodas5p.integrate`."""
        problem = self.problem
        return run(
            self.y, self.clock, end, problem.starts, problem.rows, problem.knot_times, self.knots, problem.times,
            self.out, problem.tolerance, self.atol, self.rest, problem.most_steps, self.count,
        )  # fmt: skip


def _run_of_one(problem: InitialValueProblem) -> _Run:
    """The run of one valve: it is one lane."""
    return _Run(problem, problem.initial[:, None].copy(), problem.knots[:, :, None].copy())


def _failure(problem: InitialValueProblem, status: int, y: np.ndarray, t: float, what: str, advice: str) -> SolveError:
    """When it failed, in which state (the one that moves fastest), why, and what to try."""
    reasons = {
        TOO_MANY_STEPS: f"more than {problem.most_steps} steps were needed",
        STEP_TOO_SMALL: "the step became too small",
    }
    u, u_t, f = np.empty(problem.rows.shape[1] + 1), np.empty(problem.rows.shape[1] + 1), np.empty(len(y))
    set_inputs(problem.rows, max(int(np.searchsorted(problem.starts, t, side="right")) - 1, 0), t, u, u_t)
    problem.compiled.derivative(np.ascontiguousarray(y), u, problem.knots[0], f)
    fastest = int(np.argmax(np.where(np.isfinite(f), np.abs(f), np.inf)))
    channel = problem.compiled.model.state_channels[fastest]
    return SolveError(
        f"{what} failed at t = {t:.6g} s in {channel.name} ({y[fastest] * channel.scale:.4g} {symbol(channel.unit)}): "
        f"{reasons[status]}. {advice}".rstrip()
    )
