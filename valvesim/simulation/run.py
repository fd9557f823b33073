"""A scenario in, a result out: temperatures first, then the valve, piece by piece between the command's breaks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.channels import Inputs
from valvesim.errors import InputError, SolveError, check_kind
from valvesim.inputs import evaluate, merge, piece_value
from valvesim.simulation import driver
from valvesim.simulation.fmu_valve import FmuValve
from valvesim.simulation.result import Result, output_channels
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.start import state_at_rest
from valvesim.simulation.temperature_knots import array_quantities, between, temperature_knots
from valvesim.solver.codegen import CompiledModel, absent_coefficients, compile_model
from valvesim.valve.coefficients import PART_NAMES
from valvesim.valve.effect import Reading
from valvesim.valve.thermal_network import TemperaturePath

MAX_STEPS = 50_000_000  # of a slice
SLICES = 64  # at most, of a run, between which progress is told: none shorter than a second
ADVICE = "Try a larger valve.transition_pressure or effect width, a smaller command, or a looser solver.tolerance"
JUMP_TIME = 1e-9  # s over which a jump of the command runs for the effects that feel its rate


@dataclass(frozen=True)
class Problem:
    """What the integrator needs, made from a scenario; the first axis of `knots` is the member of a batch."""

    scenario: Scenario
    compiled: CompiledModel
    path: TemperaturePath
    knots: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    times: np.ndarray
    initial: np.ndarray
    first_member: int = 0  # what messages call the first of them


def simulate(
    scenario: Scenario | str | Path, *, progress: Callable[[float], None] | None = None, signals: bool = True
) -> Result:
    """Run a scenario, or the file of one, from rest.

    `progress` is told the share that is done; without `signals` the states come alone.
    Raises InputError for input that makes no sense, SolveError (when, in which state, what to try) where it fails.
    """
    check_kind(scenario, (Scenario, str, Path), "simulate", "a Scenario, or the name of a scenario file")
    if not isinstance(scenario, Scenario):
        from valvesim.simulation.scenario_toml import load_scenario

        scenario = load_scenario(scenario)
    if isinstance(scenario.valve, FmuValve):
        return scenario.valve.simulate(scenario, progress)
    if arrays := array_quantities(scenario.valve):
        raise InputError("is an array, a batch of valves: use simulate_batch", key=f"valve.{arrays[0]}", joint=" ")
    problem = prepare(scenario)
    begin = time.perf_counter()
    states, count = integrate_member(problem, 0, progress)
    seconds = time.perf_counter() - begin
    statistics = {"accepted_steps": float(count[0]), "rejected_steps": float(count[1]), "solver_seconds": seconds}
    if signals:
        return Result(scenario, problem.times, output_channels(scenario), channel_values(problem, states), statistics)
    channels = scenario.model.state_channels
    values = {channel.name: column for channel, column in zip(channels, states.T, strict=True)}
    return Result(scenario, problem.times, channels, values, statistics)


def prepare(scenario: Scenario, *, knot_times: np.ndarray | None = None, first_member: int = 0) -> Problem:
    """Temperatures, coefficients, commands, compiled equations and the state at rest of every member.

    `knot_times` (m,) are those of the temperatures, where it is known which will do. Messages count members from
    `first_member` on.
    """
    scenario.warn_of_large_command()
    model, end = scenario.model, scenario.duration
    path, c = temperature_knots(scenario, knot_times=knot_times)
    flat = model.flat_coefficients(c, scenario.effects, path.parts)
    knots = np.stack(np.broadcast_arrays(*flat), axis=-1).astype(float)
    knots = np.array(np.broadcast_to(knots, (*knots.shape[:-2], len(path.times), knots.shape[-1])))
    knots = knots.reshape(-1, *knots.shape[-2:])
    commands = (scenario.command, *scenario.pressures())
    starts, intervals = merge(commands, end)
    rows = intervals.rows
    if any(effect.memory for effect in model.effects):
        starts, rows = _soften_jumps(starts, rows)
    compiled = compile_model(model, absent_coefficients(model, knots))
    first, *pressures = (evaluate(command, 0.0) for command in commands)
    held = np.array([first, 0.0, *pressures], dtype=float)
    initial = state_at_rest(compiled, held, knots[:, 0], first_member=first_member)
    return Problem(scenario, compiled, path, knots, starts, rows, output_times(scenario), initial, first_member)


def output_times(scenario: Scenario) -> np.ndarray:
    """The times (n_t,) of the output samples, s."""
    end, rate = scenario.duration, scenario.output_rate
    times = np.arange(int(np.floor(end * rate * (1 + 1e-12))) + 1) / rate
    return np.minimum(times, end)  # rounding may carry the last sample past the end


def _soften_jumps(starts: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Run every jump of an input as a ramp of `JUMP_TIME`, so that effects driven by its rate pass through it."""
    new_starts, new_rows = [starts[0]], [rows[0]]
    ends = np.append(starts[1:], np.inf)
    for k in range(1, len(starts)):
        before = np.array([piece_value(row, starts[k])[0] for row in rows[k - 1]])
        after = np.array([piece_value(row, starts[k])[0] for row in rows[k]])
        if np.any(np.abs(after - before) > 1e-6 * (np.abs(after) + np.abs(before))):
            stop = starts[k] + min(JUMP_TIME, (ends[k] - starts[k]) / 2.0)
            after = np.array([piece_value(row, stop)[0] for row in rows[k]])
            ramp = np.zeros_like(rows[k])
            ramp[:, 0], ramp[:, 1], ramp[:, 2] = starts[k], before, (after - before) / (stop - starts[k])
            new_starts += [starts[k], stop]
            new_rows += [ramp, rows[k]]
        else:
            new_starts.append(starts[k])
            new_rows.append(rows[k])
    return np.array(new_starts), np.array(new_rows)


def integrate_member(problem: Problem, member: int, progress: Callable[[float], None] | None) -> tuple[np.ndarray, Any]:
    """States (n_t, states) in SI of one member, and the counts of accepted and rejected steps."""
    number = problem.first_member + member
    batch = f" of member {number}" if number or len(problem.knots) > 1 else ""
    return driver.integrate(
        _of_member(problem, member),
        slices=int(np.clip(problem.scenario.duration, 1, SLICES)),
        progress=progress,
        what=f"the integration{batch}",
        advice=ADVICE,
    )


def integrate_batch(problem: Problem, members: Sequence[int]) -> Iterator[np.ndarray | SolveError]:
    """States (n_t, states) in SI of some members, in order, or why one fails.

    They take their steps together, see `driver.integrate_members`.
    """
    return driver.integrate_members(
        lambda member: _of_member(problem, member), lambda member: integrate_member(problem, member, None)[0],
        problem.initial, problem.knots, members,
    )  # fmt: skip


def _of_member(problem: Problem, member: int) -> driver.InitialValueProblem:
    scenario = problem.scenario
    return driver.InitialValueProblem(
        compiled=problem.compiled, initial=problem.initial[member], starts=problem.starts, rows=problem.rows,
        knot_times=problem.path.times, knots=problem.knots[member], times=problem.times, end=scenario.duration,
        tolerance=scenario.tolerance, most_steps=MAX_STEPS,
    )  # fmt: skip


def channel_values(problem: Problem, states: np.ndarray, member: int = 0) -> dict[str, np.ndarray]:
    """All channels (n_t,) of a member by name; signals from the same lines as the derivatives."""
    scenario, times, at = problem.scenario, problem.times, problem.path.times
    command, *pressures = (evaluate(each, times) for each in (scenario.command, *scenario.pressures()))
    c = tuple(between(times, at, problem.knots[member]))
    signals = scenario.model.signals(tuple(states.T), Inputs(command, np.zeros_like(times), *pressures), c)
    parts = np.column_stack([np.broadcast_to(getattr(problem.path.parts, name), at.shape) for name in PART_NAMES])
    commanded = [command for _ in scenario.drive.command_channels]
    columns = (*commanded, *between(times, at, parts), *pressures, *states.T, *signals)
    values = {
        channel.name: np.broadcast_to(column, times.shape)
        for channel, column in zip(output_channels(scenario), columns, strict=True)
    }
    for active in scenario.effects:
        if active.effect.reading is not None:
            seen = Reading(times, values[active.effect.channel], values["oil_temperature"])
            own = active.effect.values(one[member, 0] if np.ndim(one) else one for one in active.numbers)
            values[active.effect.channel] = active.effect.reading(seen, own)
    return values
