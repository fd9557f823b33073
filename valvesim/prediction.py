"""What a valve is predicted to do in a measured record: many variants of one valve under the same inputs.

Everything that variants share (inputs, breaks, times) is prepared once a record; a variant then costs one integration.
Several effects with a balance run in one compiled model that holds them all (`Bench.universe`), each at its neutral
value unless the variant says otherwise, so that no combination of effects is ever compiled for itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from .catalogue import CATALOGUE
from .channels import STATE_CHANNELS, Inputs
from .commands import evaluate, merge
from .compiled import CompiledModel, compile_model
from .effects import ActiveEffect, Effect, Reading
from .errors import InputError, SolveError
from .model import Model
from .parameters import Coefficients, Valve
from .scenario import Scenario
from .session import Record, Session, record_scenario
from .simulate import between, brackets, on_lines, temperature_knots
from .static import solve_rest
from .thermal import TemperaturePath

FINEST = 2.5e-4  # s: a course is kept at this spacing or finer where the record is fast enough to need it
MOST_POINTS = 20_000  # of the courses of all training records: where there are more, they are kept at wider spacing
SLOW = 5e-3  # s: a record sampled more slowly than this is quasi-static between its samples, and kept as it is
TOLERANCE = 3e-5  # errs by 1e-7 of the span, and a deviance by a tenth; with ten times as much a fit gets lost in that
MAX_STEPS = 50_000_000
SENSOR_STEP = 1e-4  # s: sensors are read on a grid this fine, since a fast lag sees the corners between samples
NEXT_TO = 3  # steps of the sensors' grid
LONG = 20.0  # s: of longer records the sensors' grid is no finer than half the course's


@dataclass(frozen=True)
class Variant:
    """A valve with its active effects: one hypothesis about what was measured."""

    valve: Valve
    effects: tuple[ActiveEffect, ...] = ()

    def with_effect(self, active: ActiveEffect) -> Variant:
        """The same valve with one effect more."""
        return replace(self, effects=(*self.effects, active))


@dataclass(frozen=True)
class Course:
    """A variant's run on the grid of its bench: states (n, n_x) of `model`, in SI; its flat coefficients (n or 1, n_c).

    `fine` (n_f, n_x) are the states on the finer grid that sensors are read on, `oil` (n_f,) its temperature there, and
    `at_valve` the record's output channels (n_f,) before their sensors; `knots` (m, n_c) are the coefficients at the
    `knot_times` (m,) of its temperatures.
    """

    model: Model
    states: np.ndarray
    coefficients: np.ndarray
    fine: np.ndarray
    oil: np.ndarray
    at_valve: dict[str, np.ndarray]
    knot_times: np.ndarray
    knots: np.ndarray


@dataclass(frozen=True)
class Bench:
    """One record, prepared: `times` (n,) is the grid, every `refinement`-th of its points a sample of the record.

    `rough` where that grid is meant for the way to a fit alone, see `coarse`.
    """

    record: Record
    scenario: Scenario
    universe: tuple[Effect, ...]
    lags: dict[str, float]
    path: TemperaturePath
    times: np.ndarray
    refinement: int
    finer: int
    fine_times: np.ndarray
    fine_inputs: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    inputs: np.ndarray  # (n, inputs): command, its rate, pressures
    rough: bool = False

    def coarse(self) -> Bench:
        """The same bench with its grid at the samples alone: it reads the same, and is seen in less time."""
        times = self.times[:: self.refinement]
        return replace(
            self,
            times=times,
            inputs=_inputs(self.scenario, times),
            refinement=1,
            finer=self.refinement * self.finer,
            rough=True,
        )

    def runs_like(self, other: Bench) -> bool:
        """Whether any variant reads the same on both: they are of a record and its repeat, say."""
        mine, others = self._inputs_of_a_run(), other._inputs_of_a_run()
        return self.record.outputs == other.record.outputs and all(map(np.array_equal, mine, others))

    def _inputs_of_a_run(self) -> tuple[np.ndarray, ...]:
        path = (self.path.times, *(np.asarray(value) for _, value in _parts(self.path)))
        return self.times, self.fine_times, self.fine_inputs, self.starts, self.rows, *path

    def model(self, effects: Sequence[ActiveEffect]) -> Model:
        """The equations with the one effect that has a balance; for several those with the universe, if they are in it.

        A model with its own effect alone runs twice as fast as the universe does.
        """
        own = tuple(active.effect for active in effects if active.effect.balance is not None)
        if len(own) < 2:
            return Model(self.scenario.drive, own)
        names = {effect.name for effect in self.universe}
        return Model(self.scenario.drive, self.universe if all(e.name in names for e in own) else own)

    def run(self, variant: Variant) -> Course:
        """The course of a variant from rest. Raises InputError for impossible dimensions, SolveError where it fails."""
        path, knots, model = self._coefficients(variant)
        compiled = compile_model(model)
        stacked = np.stack(np.broadcast_arrays(*knots), axis=-1).astype(float)
        flat = np.array(np.broadcast_to(stacked, (len(path.times), stacked.shape[-1])))
        fine = _integrate(self, compiled, path, flat, self.switched_off(model, variant.effects))
        oil = between(self.fine_times, path.times, _column(path.parts.oil, path))[0]
        return self.gridded(Course(model, fine, flat, fine, oil, self._outputs(model, fine, variant), path.times, flat))

    def gridded(self, course: Course) -> Course:
        """A course of this bench, or of the same at another spacing, on the grid of this one: nothing is integrated."""
        one = len(course.knot_times) == 1
        along = course.knots if one else between(self.times, course.knot_times, course.knots).T
        return replace(course, states=np.ascontiguousarray(course.fine[:: self.finer]), coefficients=along)

    def _coefficients(self, variant: Variant, model: Model | None = None) -> tuple[TemperaturePath, tuple, Model]:
        """Temperature path, flat coefficients at its knots, (), (m,) or (batch, m) each, and the model of both."""
        path = self.path
        if any(active.effect.temperatures is not None for active in variant.effects):
            path, _ = temperature_knots(replace(self.scenario, effects=variant.effects))
        with _speaking_of(self.record):
            c = variant.valve.at(path.parts, oil=self.scenario.oil, routes=self.scenario.thermal.routes)
        model = self.model(variant.effects) if model is None else model
        return path, model.flat_coefficients(c, _padded(model, variant.effects), path.parts), model

    def coefficients_along(self, variant: Variant, model: Model, times: np.ndarray | None = None) -> tuple:
        """Flat coefficients of a model for a variant on the grid (or at `times`), (n,) each, (1,) where constant.

        Of a variant whose valve is a batch, quantities (batch, 1), they are (n, batch), with ones where constant.
        """
        path, knots, _ = self._coefficients(variant, model)
        dimensions = max(np.ndim(value) for value in knots)
        columns = [np.array(value, dtype=float, ndmin=max(dimensions, 1)).T for value in knots]
        if len(path.times) == 1:
            return tuple(columns)
        k, share = brackets(self.times if times is None else times, path.times)
        share = share.reshape(-1, *(1,) * (columns[0].ndim - 1))
        return tuple(column[:1] if np.all(column == column[0]) else on_lines(column, k, share) for column in columns)

    def switched_off(self, model: Model, active: Sequence[ActiveEffect]) -> np.ndarray:
        """True for each state of the model that is the memory of an effect which is not active."""
        given = {a.effect.name for a in active}
        off = [False] * (len(STATE_CHANNELS) + len(model.drive.memory))
        return np.array([*off, *(e.name not in given for e in model.effects for _ in e.memory)])

    def reduced(self, model: Model, variant: Variant) -> tuple[Model, np.ndarray]:
        """The model with a variant's own effects alone, and the indices of its states in those of a fuller one."""
        active = {a.effect.name for a in variant.effects}
        own = Model(model.drive, tuple(e for e in model.effects if e.name in active))
        return own, np.flatnonzero(~self.switched_off(model, variant.effects))

    def readings(self, course: Course, variant: Variant) -> dict[str, np.ndarray]:
        """What the record's sensors would have read, (n_samples,) by channel, before noise and resolution."""
        return self.sensed(course.at_valve, course, variant)

    def _outputs(self, model: Model, fine: np.ndarray, variant: Variant) -> dict[str, np.ndarray]:
        """The record's output channels on the fine grid, (n_f,) each, as they are at the valve."""
        names = self.record.outputs
        values = {channel.name: fine[:, k] for k, channel in enumerate(model.state_channels) if channel.name in names}
        if set(names) - set(values):
            model, own = self.reduced(model, variant)
            along = self.coefficients_along(variant, model, self.fine_times)
            signals = model.signals(tuple(fine[:, own].T), Inputs(*self.fine_inputs.T), along)
            for name in names:
                if name not in values:
                    values[name] = np.broadcast_to(getattr(signals, name), self.fine_times.shape)
        return values

    def sensed(self, values: dict[str, np.ndarray], course: Course, variant: Variant) -> dict[str, np.ndarray]:
        """Channels on either grid, (n,) or columns (n, k), as their sensors give them at the samples."""
        every = {True: self.refinement * self.finer, False: self.refinement}
        acted = {name: self._acted(name, column, course, variant) for name, column in values.items()}
        return {name: column[:: every[len(column) == len(self.fine_times)]] for name, column in acted.items()}

    def _acted(self, name: str, column: np.ndarray, course: Course, variant: Variant) -> np.ndarray:
        """A channel on either grid as its sensor gives it there."""
        fine = len(column) == len(self.fine_times)
        times, oil = (self.fine_times, course.oil) if fine else (self.times, course.oil[:: self.finer])
        acting = [a for a in variant.effects if a.effect.reading is not None and a.effect.channel == name]
        if self.lags.get(name, 0.0) > 0.0:
            acting.append(CATALOGUE["sensor_lag"].on(name)(time_constant=self.lags[name]))
        for active in acting:
            column = _read(active, times, column, oil)
        return column

    def bends(self, course: Course, variant: Variant) -> dict[str, np.ndarray]:
        """By how much each reading, on the fine grid, bends next to a sample (n_samples,): half its second difference.

        Zero where the grid is that of the samples.
        """
        from scipy.ndimage import maximum_filter1d

        step, bends = self.refinement * self.finer, {}
        for name, column in course.at_valve.items():
            bend = np.zeros(len(column))
            if step > 1:
                bend[1:-1] = np.abs(np.diff(self._acted(name, column, course, variant), 2)) / 2.0
            bends[name] = maximum_filter1d(bend, 2 * NEXT_TO + 1)[::step]
        return bends


def _read(active: ActiveEffect, times: np.ndarray, columns: np.ndarray, oil: np.ndarray) -> np.ndarray:
    reading = active.effect.reading
    assert reading is not None  # noqa: S101 - the caller has chosen effects with one
    if columns.ndim == 1 or active.effect.name == "sensor_lag":
        return reading(Reading(times, columns, oil), active.values)
    return np.column_stack([reading(Reading(times, column, oil), active.values) for column in columns.T])


def prepare(session: Session, record: Record, universe: Sequence[Effect]) -> Bench:
    """A record ready to be predicted with any variant whose effects with a balance are among `universe`."""
    with _speaking_of(record):
        scenario = record_scenario(session, record, tolerance=TOLERANCE)
        path, _ = temperature_knots(scenario)
    step = 1.0 / record.rate
    refinement = int(np.ceil(step / _finest(session) - 1e-6)) if step <= SLOW else 1
    count = (len(record.time) - 1) * refinement + 1
    times = np.linspace(0.0, float(record.time[-1]), count)
    finer = 1
    if step <= SLOW:
        finer = int(np.ceil(step / refinement / SENSOR_STEP - 1e-6)) if record.duration <= LONG else 2
    fine_times = np.linspace(0.0, float(record.time[-1]), (count - 1) * finer + 1)
    starts, intervals = merge((scenario.command, *scenario.pressures()), scenario.duration)
    sensors = session.sensors
    return Bench(
        record=record,
        scenario=scenario,
        universe=tuple(effect for effect in universe if effect.balance is not None),
        lags={name: sensors[name].lag for name in record.outputs if name in sensors},
        path=path,
        times=times,
        refinement=refinement,
        finer=finer,
        fine_times=fine_times,
        fine_inputs=_inputs(scenario, fine_times),
        starts=starts,
        rows=intervals.rows,
        inputs=_inputs(scenario, times),
    )


@contextmanager
def _speaking_of(record: Record) -> Iterator[None]:
    """An InputError from inside gets the record's name."""
    try:
        yield
    except InputError as error:
        raise InputError(f"record {record.name}: {error}") from None


def _finest(session: Session) -> float:
    """The spacing (s) of courses in a session: wider where its training records are long."""
    return max(FINEST, sum(r.duration for r in session.training if r.rate * SLOW >= 1.0) / MOST_POINTS)


def _inputs(scenario: Scenario, times: np.ndarray) -> np.ndarray:
    """(n, inputs): command, its rate, pressures."""
    values = [evaluate(command, times) for command in (scenario.command, *scenario.pressures())]
    rate = np.gradient(values[0], times)
    rate[0] = 0.0  # a record starts at rest
    return np.column_stack([values[0], rate, *values[1:]])


def neutral(effect: Effect) -> ActiveEffect:
    """The effect switched off."""
    amplitude = effect.amplitude
    return effect(**{amplitude.name: amplitude.neutral or 0.0})


def _padded(model: Model, active: Sequence[ActiveEffect]) -> list[ActiveEffect]:
    """The active effects, with those of the model that are not among them switched off, in the model's order."""
    given = {a.effect.name: a for a in active if a.effect.balance is not None}
    in_model = [given.get(effect.name) or neutral(effect) for effect in model.effects]
    return [*in_model, *(a for a in active if a.effect.balance is None)]


def _parts(path: TemperaturePath) -> list[tuple[str, np.ndarray]]:
    return [(name, getattr(path.parts, name)) for name in path.parts.__dataclass_fields__]


def _column(value: np.ndarray, path: TemperaturePath) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, dtype=float), path.times.shape)[:, None]


def _integrate(
    bench: Bench, compiled: CompiledModel, path: TemperaturePath, flat: np.ndarray, off: np.ndarray
) -> np.ndarray:
    """States (n_f, n_x) in SI on the bench's fine grid."""
    y = _rest(bench, compiled, flat[0], off)
    out = np.empty((len(bench.fine_times), len(y)))
    clock, count = np.array([0.0, 1e-5, 0.0]), np.zeros(2, dtype=np.int64)
    atol = np.where(off, np.inf, 1e-2 * TOLERANCE)
    end = float(bench.times[-1])
    status = compiled.run(
        y,
        clock,
        end,
        bench.starts,
        bench.rows,
        path.times,
        flat,
        bench.fine_times,
        out,
        TOLERANCE,
        atol,
        MAX_STEPS,
        count,
    )
    if status or not np.isfinite(out[-1]).all():
        raise SolveError(
            f"record {bench.record.name}: the simulation failed at t = {clock[0]:.6g} s; is the valve of session.toml "
            "the one that was measured?"
        )
    return out * compiled.scale


def _rest(bench: Bench, compiled: CompiledModel, flat: np.ndarray, off: np.ndarray) -> np.ndarray:
    """The scaled state at rest under the first inputs: the static solution, then Newton on the model itself."""
    c = Coefficients(*flat[: len(Coefficients._fields)])
    first = bench.inputs[0].copy()
    first[1] = 0.0
    memory = compiled.model.drive.rest(first[0], c)
    rest = solve_rest(c, memory[0] if memory else first[0], 0.0, *first[2:])
    y = np.zeros(len(compiled.scale))
    y[:6] = [float(v) for v in (rest.armature_angle, 0.0, rest.nozzle_pressure_1, rest.nozzle_pressure_2,
                                rest.spool_position, 0.0)]  # fmt: skip
    y[6 : 6 + len(memory)] = memory
    y /= compiled.scale
    on_stop = np.any(np.abs(rest.spool_position) > c.spool_stroke)  # the static solution knows no stops
    if not on_stop and not any(e.balance for e in compiled.model.effects):
        return y
    f, J = np.empty(len(y)), np.empty((len(y), len(y)))
    for _ in range(20):
        compiled.derivative(y, first, flat, f)
        compiled.jacobian(y, first, flat, J)
        f[off], J[off], J[:, off] = 0.0, 0.0, 0.0
        if not np.isfinite(J).all() or not np.isfinite(f).all():
            raise SolveError(f"record {bench.record.name}: the valve finds no rest under the first inputs")
        step = np.linalg.lstsq(J, -f, rcond=1e-13)[0]
        y += step
        if np.max(np.abs(step)) < 1e-12:
            break
    return y
