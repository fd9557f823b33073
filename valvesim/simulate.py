"""A scenario in, a result out: temperatures first, then the valve, piece by piece between the command's breaks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .channels import INPUT_CHANNELS, SIGNAL_CHANNELS, Channel, Inputs
from .commands import evaluate, merge, piece_value
from .compiled import CompiledModel, compile_model
from .effects import Reading
from .errors import InputError, SolveError, unknown_name
from .files import write_atomically
from .model import VoltageDrive
from .parameters import PART_NAMES, Coefficients, PartTemperatures
from .rosenbrock import STEP_TOO_SMALL, TOO_MANY_STEPS
from .scenario import Scenario
from .static import solve_rest
from .thermal import TemperaturePath
from .units import DISPLAY, quantities, symbol

MAX_STEPS = 50_000_000  # of a slice
MOST_SAMPLES = 2e7  # of a result: 5 GB
SLICES = 64  # at most, of a run, between which progress is told: none shorter than a second
JUMP_TIME = 1e-9  # s over which a jump of the command runs for the effects that feel its rate
KNOT_ERROR = 3e-5  # relative error of the coefficients between the knots of the temperature path


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
    if end * scenario.output_rate > MOST_SAMPLES:
        raise InputError(
            f"outputs.rate: {scenario.output_rate:g} Hz over {end:g} s makes more than {MOST_SAMPLES:g} samples; "
            "lower the rate or the duration"
        )
    times = np.arange(int(np.floor(end * scenario.output_rate * (1 + 1e-12))) + 1) / scenario.output_rate
    times = np.minimum(times, end)  # rounding may carry the last sample past the end
    compiled = compile_model(model)
    first = Coefficients(*(knots[:, 0, k] for k in range(len(Coefficients._fields))))
    initial = _rest(scenario, compiled, first, knots[:, 0])
    return _Problem(scenario, compiled, path, knots, starts, rows, times, initial)


def temperature_knots(scenario: Scenario) -> tuple[TemperaturePath, Coefficients]:
    """The temperature path on knots close enough that straight lines between them hold the coefficients."""
    thermal, valve = scenario.thermal, scenario.valve
    batch: Any = {name: np.asarray(getattr(valve, name))[:, None] for name in _array_figures(scenario)}
    valve = replace(valve, **batch)
    spacing = min(0.5, scenario.duration / 16.0)
    for _ in range(5):
        path = scenario.temperatures(spacing=spacing)
        if all(np.ptp(getattr(path.parts, name)) <= 1e-12 for name in PART_NAMES):
            held = PartTemperatures(**{name: getattr(path.parts, name)[:1] for name in PART_NAMES})
            path = TemperaturePath(times=path.times[:1], parts=held)
        c = valve.at(path.parts, oil=scenario.oil, routes=thermal.routes)
        if _bend(path.times, c) <= KNOT_ERROR:
            break
        spacing /= 4.0
    return path, c


def _bend(times: np.ndarray, c: Coefficients) -> float:
    """Largest relative error of a straight line between knots, from second differences; jumps aside."""
    worst = 0.0
    for values in c:
        v = np.asarray(values, dtype=float)
        if v.ndim == 0 or v.shape[-1] < 3 or len(times) < 3:
            continue
        steps = np.diff(times)
        smooth = (steps[1:] > 0.0) & (steps[:-1] > 0.0)
        bend = np.abs(np.diff(v, 2, axis=-1))[..., smooth] / 8.0
        worst = max(worst, float(np.max(bend, initial=0.0) / np.max(np.abs(v))))
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
    on_stop = np.any(np.abs(rest.spool_position) > c.spool_stroke)
    if not on_stop and not any(effect.balance for effect in model.effects):
        return y
    u = np.array([value[0], 0.0, *value[1:]], dtype=float)
    f, J = np.empty(y.shape[1]), np.empty((y.shape[1], y.shape[1]))
    for k in range(len(y)):
        for _ in range(30):
            compiled.derivative(y[k], u, flat[k], f)
            compiled.jacobian(y[k], u, flat[k], J)
            step = np.linalg.lstsq(J, -f, rcond=1e-13)[0]
            y[k] += step
            if np.max(np.abs(step)) < 1e-12:
                break
    return y


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
            rtol, np.full(len(y), 0.01 * rtol), MAX_STEPS, count,
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
    voltage = Channel("voltage", "V", "command: over coils and amplifier")
    return (
        *((voltage,) if isinstance(scenario.drive, VoltageDrive) else ()),
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
    voltage = [command] if isinstance(scenario.drive, VoltageDrive) else []
    columns = (*voltage, *between(times, at, parts), *pressures, *states.T, *signals)
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
