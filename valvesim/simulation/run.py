"""A scenario in, a result out: temperatures first, then the valve, piece by piece between the command's breaks."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, Channel, Inputs
from valvesim.errors import InputError, SolveError, unknown_name
from valvesim.inputs import evaluate, merge, piece_value
from valvesim.io import write_atomically
from valvesim.simulation.scenario import Scenario
from valvesim.solver.codegen import CompiledModel, absent_coefficients, compile_model
from valvesim.solver.rodas5p import STEP_TOO_SMALL, TOO_MANY_STEPS
from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.coefficients import PART_NAMES, Coefficients, PartTemperatures
from valvesim.valve.effect import Reading
from valvesim.valve.equilibrium import settle, solve_rest
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import TemperaturePath, first_knots

MAX_STEPS = 50_000_000  # of a slice
SLICES = 64  # at most, of a run, between which progress is told: none shorter than a second
JUMP_TIME = 1e-9  # s over which a jump of the command runs for the effects that feel its rate
KNOT_ERROR = 1e-6  # relative error of the coefficients between the knots of the temperature path
MOST_HALVINGS = 16  # of the time between two knots


@dataclass(frozen=True)
class Result:
    """What a run gave: `result["spool_position"]` is an xarray.DataArray over time, with its unit in `attrs["units"]`.

    Names: every state, every signal, the inputs, and `<part>_temperature` of oil and parts (°C). SI throughout.
    `values[name]` is the bare array (n_t,), `time` the samples' times in s.
    """

    scenario: Scenario
    time: np.ndarray
    channels: tuple[Channel, ...]
    values: dict[str, np.ndarray]
    statistics: dict[str, float]

    def __getitem__(self, name: str) -> Any:
        return self.select((name,)).dataset[name]

    @property
    def names(self) -> tuple[str, ...]:
        """All channels, in order."""
        return tuple(channel.name for channel in self.channels)

    @property
    def dataset(self) -> Any:
        """All channels as one xarray.Dataset with units."""
        import xarray

        return xarray.Dataset(
            {
                channel.name: ("time", self.values[channel.name], {"units": channel.unit, "long_name": channel.doc})
                for channel in self.channels
            },
            coords={"time": ("time", self.time, {"units": "s", "long_name": "time"})},
            attrs=self._attributes(),
        )

    def display(self, name: str) -> tuple[np.ndarray, str]:
        """(values, unit) of a channel as people read it: mm, bar, mA, L/min."""
        (channel,) = self.select((name,)).channels
        unit, factor = DISPLAY.get(channel.unit, (channel.unit, 1.0))
        return self.values[name] * factor, unit

    def select(self, names: Sequence[str]) -> Result:
        """The result with these channels alone; all of them if none is named. InputError for an unknown name."""
        for name in names:
            if name not in self.values:
                raise unknown_name("channel", name, self.names)
        return replace(self, channels=tuple(c for c in self.channels if c.name in names)) if names else self

    def to_csv(self, path: str | Path) -> Path:
        """Write all channels, one column each with its unit in the header (mm, bar, mA, L/min). Returns the path."""
        columns, header = [self.time], ["time [s]"]
        for name in self.names:
            values, unit = self.display(name)
            header.append(f"{name} [{unit}]")
            columns.append(values)

        def write(temporary: Path) -> None:
            np.savetxt(
                temporary, np.column_stack(columns), "%.9g", ",", header=",".join(header), comments="", encoding="utf-8"
            )  # fmt: skip

        return write_atomically(Path(path), write)

    def to_netcdf(self, path: str | Path) -> Path:
        """Write all channels as netCDF-4 (HDF5): labelled arrays with units that Python, MATLAB and others open."""

        def write(temporary: Path) -> None:
            from netCDF4 import Dataset

            with Dataset(temporary, "w") as file:
                file.setncatts(self._attributes())
                file.createDimension("time", len(self.time))
                for channel in (Channel("time", "s", "time"), *self.channels):
                    variable = file.createVariable(channel.name, "f8", ("time",))
                    variable.setncatts({"units": channel.unit, "long_name": channel.doc})
                    variable[:] = self.time if channel.name == "time" else self.values[channel.name]

        return write_atomically(Path(path), write)

    def _attributes(self) -> dict[str, str]:
        return {"title": self.scenario.title, "source": "valvesim", "oil": self.scenario.oil.name}


@dataclass(frozen=True)
class _Problem:
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
    if _array_figures(scenario):
        raise InputError(f"valve.{_array_figures(scenario)[0]} is an array, a batch of valves: use simulate_batch")
    problem = _prepare(scenario)
    begin = time.perf_counter()
    states, count = _integrate(problem, 0, progress)
    seconds = time.perf_counter() - begin
    statistics = {"accepted_steps": float(count[0]), "rejected_steps": float(count[1]), "solver_seconds": seconds}
    if signals:
        return Result(scenario, problem.times, output_channels(scenario), _values(problem, states), statistics)
    channels = scenario.model.state_channels
    values = {channel.name: column for channel, column in zip(channels, states.T, strict=True)}
    return Result(scenario, problem.times, channels, values, statistics)


def simulate_batch(scenario: Scenario, *, workers: int | None = None) -> dict[str, np.ndarray]:
    """Run one scenario for a batch of valves: quantities of `scenario.valve` that are arrays (k,) hold one valve each.

    Returns the states by name, each (k, n_t), with "time" (n_t,). Members run on `workers` threads (all cores); they
    share command, oil and pressures. Raises as `simulate` does.
    """
    problem = _prepare(scenario)
    members, shape = len(problem.knots), (len(problem.times), len(problem.compiled.scale))
    states = np.empty((members, *shape))

    def run(share: np.ndarray) -> None:
        for k in share:
            states[k] = _integrate(problem, int(k), None)[0]

    threads = workers or cores()
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, np.array_split(np.arange(members), min(threads, members))))
    names = [channel.name for channel in scenario.model.state_channels]
    return {"time": problem.times, **{name: states[:, :, k] for k, name in enumerate(names)}}


def cores() -> int:
    """How many cores this process may use: fewer than there are where it is held to some of them."""
    allowed = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def _array_figures(scenario: Scenario) -> list[str]:
    return [name for name in quantities(scenario.valve) if np.ndim(getattr(scenario.valve, name))]


def _prepare(scenario: Scenario) -> _Problem:
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
    initial = _rest(scenario, compiled, first, knots[:, 0])
    return _Problem(scenario, compiled, path, knots, starts, rows, times, initial)


def temperature_knots(scenario: Scenario) -> tuple[TemperaturePath, Coefficients]:
    """The temperature path on knots close enough that straight lines between them hold the coefficients."""
    valve = scenario.valve
    batch: Any = {name: np.asarray(getattr(valve, name))[:, None] for name in _array_figures(scenario)}
    valve = replace(valve, **batch)
    knots = first_knots(scenario.oil_temperature, scenario.duration, min(0.5, scenario.duration / 16.0))
    for _ in range(MOST_HALVINGS):
        apart = np.flatnonzero(np.diff(knots) > 0.0)
        middles = (knots[apart] + knots[apart + 1]) / 2.0
        tried = np.insert(knots, apart + 1, middles)
        path = scenario.temperatures(knots=tried)
        if all(np.ptp(getattr(path.parts, name)) <= 1e-12 for name in PART_NAMES):
            return _at_knots(path, [0], scenario, valve)
        c = valve.at(path.parts, oil=scenario.oil, routes=scenario.thermal.routes)
        at = apart + 1 + np.arange(len(apart))  # where `tried` holds the middles
        bent = _bend(c, at) > KNOT_ERROR
        if not bent.any():
            break
        knots = np.insert(knots, apart[bent] + 1, middles[bent])
    return _at_knots(path, np.delete(np.arange(len(tried)), at[~bent]), scenario, valve)


def _at_knots(
    path: TemperaturePath, keep: np.ndarray | list[int], scenario: Scenario, valve: Valve
) -> tuple[TemperaturePath, Coefficients]:
    """The path at some of its knots, and the coefficients there."""
    parts = PartTemperatures(**{name: np.asarray(getattr(path.parts, name))[keep] for name in PART_NAMES})
    c = valve.at(parts, oil=scenario.oil, routes=scenario.thermal.routes)
    return TemperaturePath(times=path.times[keep], parts=parts), c


def _bend(c: Coefficients, at: np.ndarray) -> np.ndarray:
    """Relative error of the coefficients at the knots `at` on a line between their neighbours: the worst of all."""
    worst = np.zeros(len(at))
    for values in c:
        v = np.asarray(values, dtype=float)
        if v.ndim and v.shape[-1] > 1:
            bend = np.abs(v[..., at] - (v[..., at - 1] + v[..., at + 1]) / 2.0) / max(float(np.max(np.abs(v))), 1e-300)
            worst = np.maximum(worst, bend.reshape(-1, len(at)).max(axis=0))
    return worst


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


def _rest(scenario: Scenario, compiled: CompiledModel, c: Coefficients, flat: np.ndarray) -> np.ndarray:
    """The scaled state at rest at time zero, (members, states): the static solution, and Newton where effects act."""
    model = scenario.model
    value = [evaluate(command, 0.0) for command in (scenario.command, *scenario.pressures())]
    memory = model.drive.rest(value[0], c)
    current = memory[0] if memory else value[0]
    rest = solve_rest(c, current, 0.0, *value[1:])
    pressures = (rest.nozzle_pressure_1, rest.nozzle_pressure_2)
    columns: list[Any] = [rest.armature_angle, 0.0, *pressures, rest.spool_position, 0.0, *memory]
    columns += [0.0 for effect in model.effects for _ in effect.memory]
    y = np.column_stack([np.broadcast_to(column, rest.armature_angle.shape or (1,)) for column in columns])
    y = np.ascontiguousarray(y / compiled.scale)
    if not any(effect.balance for effect in model.effects):
        return y
    u = np.array([value[0], 0.0, *value[1:]], dtype=float)
    for k in range(len(y)):
        member = f"member {k}: " if len(y) > 1 else ""
        y[k] = settle(
            functools.partial(_into, compiled.derivative, u, flat[k]),
            functools.partial(_into, compiled.jacobian, u, flat[k]),
            y[k], model.state_channels, where=member,
        )  # fmt: skip
    return y


def _into(compiled: Any, u: np.ndarray, flat: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """A compiled function of the scaled states alone."""
    compiled(y, u, flat, out)


def _integrate(problem: _Problem, member: int, progress: Callable[[float], None] | None) -> tuple[np.ndarray, Any]:
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


def _failure(problem: _Problem, member: int, status: int, y: np.ndarray, t: float) -> SolveError:
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


def output_channels(scenario: Scenario) -> tuple[Channel, ...]:
    """The channels of a result, in order."""
    return (
        *scenario.drive.command_channels,
        *(Channel(f"{name}_temperature", "degC", name.replace("_", " ")) for name in PART_NAMES),
        *INPUT_CHANNELS[2:],
        *scenario.model.state_channels,
        *SIGNAL_CHANNELS,
    )


def check_channels(scenario: Scenario) -> None:
    """InputError for a name in `scenario.channels` that no result has."""
    names = [channel.name for channel in output_channels(scenario)]
    for name in scenario.channels:
        if name not in names:
            raise unknown_name("channel", name, names, "outputs.channels")


def _values(problem: _Problem, states: np.ndarray) -> dict[str, np.ndarray]:
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


def between(times: np.ndarray, at: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Straight lines between knots for columns (m, n_columns), as (n_columns, n_t); after a jump the later value."""
    if len(at) == 1:
        return np.repeat(columns.T, len(times), axis=1)
    k, share = brackets(times, at)
    return np.array([on_lines(column, k, share) for column in columns.T])


def on_lines(column: np.ndarray, k: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Values (n_t, ...) of a column (m, ...) at a share of the way from knot k to the next, see `brackets`."""
    return column.take(k, 0) + share * np.diff(column, axis=0).take(k, 0)


def brackets(times: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each time the knot (n_t,) that it follows, of two or more, and the share (n_t,) of the way to the next."""
    k = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    width = at[k + 1] - at[k]
    share = np.clip(np.divide(times - at[k], width, out=np.ones_like(times), where=width > 0.0), 0.0, 1.0)
    return k, share
