"""A batch of valves under one scenario, shared out among threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from valvesim.errors import SolveError
from valvesim.simulation.run import integrate_members, prepare
from valvesim.simulation.scenario import Scenario
from valvesim.solver.codegen import LANES


def simulate_batch(scenario: Scenario, *, workers: int | None = None) -> dict[str, np.ndarray]:
    """Run one scenario for a batch of valves: quantities of `scenario.valve` that are arrays (k,) hold one valve each.

    Returns the states by name, each (k, n_t), with "time" (n_t,). Members run on `workers` threads (all cores); they
    share command, oil and pressures. Raises as `simulate` does.
    """
    problem = prepare(scenario)
    members, shape = len(problem.knots), (len(problem.times), len(problem.compiled.scale))
    states = np.empty((members, *shape))

    def run(share: np.ndarray) -> None:
        for k, answer in zip(share, integrate_members(problem, share.tolist()), strict=True):
            if isinstance(answer, SolveError):
                raise answer
            states[k] = answer

    threads = workers or cores()
    shares = np.array_split(np.arange(members), np.arange(LANES, members, LANES))  # the same lanes on any cores
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, shares))
    names = [channel.name for channel in scenario.model.state_channels]
    return {"time": problem.times, **{name: states[:, :, k] for k, name in enumerate(names)}}


def cores() -> int:
    """How many cores this process may use: fewer than there are where it is held to some of them."""
    allowed = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(allowed(0)) if allowed else os.cpu_count() or 1
