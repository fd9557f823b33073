"""A batch of valves under one scenario, shared out among threads."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from valvesim.errors import SolveError
from valvesim.simulation.run import Problem, integrate_batch, prepare
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.temperature_knots import array_quantities
from valvesim.solver.codegen import LANES

KNOT_BYTES = 2e7  # of the coefficients that are held at a time; what they are made of takes some ten times as much


def simulate_batch(scenario: Scenario, *, workers: int | None = None) -> dict[str, np.ndarray]:
    """Run one scenario for a batch of valves: quantities of `scenario.valve` that are arrays (k,) hold one valve each.

    Returns the states by name, each (k, n_t), with "time" (n_t,); what it holds besides does not grow with the batch.
    Members run on `workers` threads (all cores); they share command, oil and pressures. Raises as `simulate` does.
    """
    states: list[np.ndarray] = []
    with ThreadPoolExecutor(workers or cores()) as pool:
        for problem in _problems(scenario):
            members = np.arange(len(problem.knots))
            shares = np.array_split(members, members[LANES::LANES])  # the same lanes on any cores
            for some in pool.map(functools.partial(_states, problem), shares):
                states += some
            times = problem.times
    channels = scenario.model.state_channels
    return {"time": times, **{c.name: np.array([own[:, k] for own in states]) for k, c in enumerate(channels)}}


def _problems(scenario: Scenario) -> Iterator[Problem]:
    """The members some at a time; the first few tell where the temperatures of all have their knots."""
    arrays = {name: np.asarray(getattr(scenario.valve, name)) for name in array_quantities(scenario.valve)}
    members = max((len(values) for values in arrays.values()), default=1)

    def some(first: int, last: int, knot_times: np.ndarray | None) -> Problem:
        own: Any = {name: np.broadcast_to(values, members)[first:last] for name, values in arrays.items()}
        part = replace(scenario, valve=replace(scenario.valve, **own))
        return prepare(part, knot_times=knot_times, first_member=first)

    problem = some(0, LANES, None)
    yield problem
    knot_times, size = problem.path.times, problem.knots[0].nbytes
    at_once = max(int(KNOT_BYTES / size) // LANES, 1) * LANES
    for first in range(LANES, members, at_once):
        yield some(first, min(first + at_once, members), knot_times)


def _states(problem: Problem, members: np.ndarray) -> list[np.ndarray]:
    """States (n_t, states) of each of some members. Raises SolveError where one fails."""
    answers = list(integrate_batch(problem, members.tolist()))
    for answer in answers:
        if isinstance(answer, SolveError):
            raise answer
    return [answer for answer in answers if not isinstance(answer, SolveError)]


def cores() -> int:
    """How many cores this process may use: fewer than there are where it is held to some of them."""
    allowed = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(allowed(0)) if allowed else os.cpu_count() or 1
