"""A scenario in, a result out: temperatures first, then the valve, piece by piece between the command's breaks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.channels import Inputs
from valvesim.errors import InputError, SolveError
from valvesim.inputs import evaluate, merge, piece_value
from valvesim.simulation.result import Result, output_channels
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.start import state_at_rest
from valvesim.simulation.temperature_knots import array_quantities, between, temperature_knots
from valvesim.solver.codegen import CompiledModel, absent_coefficients, compile_model
from valvesim.solver.rodas5p import STEP_TOO_SMALL, TOO_MANY_STEPS
from valvesim.units import symbol
from valvesim.valve.coefficients import PART_NAMES, Coefficients
from valvesim.valve.effect import Reading
from valvesim.valve.thermal_network import TemperaturePath

MAX_STEPS = 50_000_000  # of a slice
SLICES = 64  # at most, of a run, between which progress is told: none shorter than a second
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


def simulate(scenario: Scenario, *, progress: Callable[[float], None] | None = None, signals: bool = True) -> Result:
    """Run a scenario from rest. `progress` is told the share that is done; without `signals` the states come alone.

    Raises InputError for input that makes no sense, SolveError (when, in which state, what to try) where it fails.
    """
    if arrays := array_quantities(scenario.valve):
        raise InputError("is an array, a batch of valves: use simulate_batch", key=f"valve.{arrays[0]}", joint=" ")
    problem = prepare(scenario)
    begin = time.perf_counter()
    states, count = integrate(problem, 0, progress)
    seconds = time.perf_counter() - begin
    statistics = {"accepted_steps": float(count[0]), "rejected_steps": float(count[1]), "solver_seconds": seconds}
    if signals:
        return Result(scenario, problem.times, output_channels(scenario), _values(problem, states), statistics)
    channels = scenario.model.state_channels
    values = {channel.name: column for channel, column in zip(channels, states.T, strict=True)}
    return Result(scenario, problem.times, channels, values, statistics)


def prepare(scenario: Scenario) -> Problem:
    """Temperatures, coefficients, commands, compiled equations and the state at rest of every member."""
    scenario.warn_of_large_command()
    model, end = scenario.model, scenario.duration
    path, c = temperature_knots(scenario)
    flat = model.flat_coefficients(c, scenario.effects, path.parts)
    knots = np.stack(np.broadcast_arrays(*flat), axis=-1).astype(float)
    knots = np.array(np.broadcast_to(knots, (*knots.shape[:-2], len(path.times), knots.shape[-1])))
    knots = knots.reshape(-1, *knots.shape[-2:])
    commands = (scenario.command, *scenario.pressures())
    starts, intervals = merge(commands, end)
    rows = intervals.rows
    if any(effect.memory for effect in model.effects):
        starts, rows = _soften_jumps(starts, rows)
    times = np.arange(int(np.floor(end * scenario.output_rate * (1 + 1e-12))) + 1) / scenario.output_rate
    times = np.minimum(times, end)  # rounding may carry the last sample past the end
    compiled = compile_model(model, absent_coefficients(model, knots))
    first = Coefficients(*(knots[:, 0, k] for k in range(len(Coefficients._fields))))
    initial = state_at_rest(scenario, compiled, first, knots[:, 0])
    return Problem(scenario, compiled, path, knots, starts, rows, times, initial)


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


def integrate(problem: Problem, member: int, progress: Callable[[float], None] | None) -> tuple[np.ndarray, Any]:
    """States (n_t, states) in SI of one member, and the counts of accepted and rejected steps."""
    scenario, compiled = problem.scenario, problem.compiled
    y, count = problem.initial[member].copy(), np.zeros(2, dtype=np.int64)
    out = np.full((len(problem.times), len(y)), np.nan)
    clock = np.array([0.0, min(1e-5, scenario.duration), 0.0])
    rtol = scenario.tolerance
    slices = int(np.clip(scenario.duration, 1, SLICES))
    for k in range(1, slices + 1):
        end = scenario.duration * k / slices if k < slices else scenario.duration
        status = compiled.run(
            y, clock, end, problem.starts, problem.rows, problem.path.times, problem.knots[member], problem.times, out,
            rtol, np.full(len(y), 0.01 * rtol), problem.initial[member], MAX_STEPS, count,
        )  # fmt: skip
        if status:
            raise _failure(problem, member, status, y, float(clock[0]))
        if progress is not None:
            progress(k / slices)
    return out * compiled.scale, count


_REASONS = {
    TOO_MANY_STEPS: f"more than {MAX_STEPS} steps were needed",
    STEP_TOO_SMALL: "the step became too small",
}


def _failure(problem: Problem, member: int, status: int, y: np.ndarray, t: float) -> SolveError:
    """When it failed, in which state (the one that moves fastest), and what to try."""
    scenario = problem.scenario
    u = np.array([evaluate(command, t) for command in (scenario.command, *scenario.pressures())], dtype=float)
    f = np.empty(len(y))
    problem.compiled.derivative(y, np.insert(u, 1, 0.0), problem.knots[member, 0], f)
    fastest = int(np.argmax(np.where(np.isfinite(f), np.abs(f), np.inf)))
    channel = scenario.model.state_channels[fastest]
    batch = f" of member {member}" if len(problem.knots) > 1 else ""
    return SolveError(
        f"the integration{batch} failed at t = {t:.6g} s in {channel.name} "
        f"({y[fastest] * channel.scale:.4g} {symbol(channel.unit)}): {_REASONS[status]}. Try a larger "
        "valve.transition_pressure or effect width, a smaller command, or a looser solver.tolerance"
    )


def _values(problem: Problem, states: np.ndarray) -> dict[str, np.ndarray]:
    """All channels over time by name; signals from the same lines as the derivatives."""
    scenario, times, at = problem.scenario, problem.times, problem.path.times
    command, *pressures = (evaluate(each, times) for each in (scenario.command, *scenario.pressures()))
    c = tuple(between(times, at, problem.knots[0]))
    signals = scenario.model.signals(tuple(states.T), Inputs(command, np.zeros_like(times), *pressures), c)
    parts = np.column_stack([np.broadcast_to(getattr(problem.path.parts, name), at.shape) for name in PART_NAMES])
    own = [command for _ in scenario.drive.command_channels]
    columns = (*own, *between(times, at, parts), *pressures, *states.T, *signals)
    values = {
        channel.name: np.broadcast_to(column, times.shape)
        for channel, column in zip(output_channels(scenario), columns, strict=True)
    }
    for active in scenario.effects:
        if active.effect.reading is not None:
            seen = Reading(times, values[active.effect.channel], values["oil_temperature"])
            values[active.effect.channel] = active.effect.reading(seen, active.values)
    return values
