"""What a valve is predicted to do in a measured record: many variants of one valve under the same inputs.

Everything that variants share (inputs, breaks, times) is prepared once a record; a variant then costs one integration.
Several effects with a balance run in one compiled model that holds them all (`Bench.universe`), each at its neutral
value unless the variant says otherwise, so that no combination of effects is ever compiled for itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np

from valvesim.channels import Inputs, Signals, State
from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import (
    Deviations,
    acting_on,
    added_input,
    deviating_command,
)
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.sensor_errors import active_in, reads_between, reads_channel
from valvesim.identification.session import OUTPUTS, Record, Session
from valvesim.inputs import Command, Constant, evaluate, merge
from valvesim.simulation.driver import InitialValueProblem, integrate, integrate_parts
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.start import settled_from, state_at_rest
from valvesim.simulation.temperature_knots import between, brackets, linear_interpolation, temperature_knots
from valvesim.solver.codegen import CompiledModel, absent_coefficients, compile_model
from valvesim.solver.partial_derivatives import CoefficientCourse, compile_derivatives
from valvesim.valve.coefficients import Coefficients
from valvesim.valve.effect import ActiveEffect, Effect, Reading
from valvesim.valve.effects.sensors import sensor_lag
from valvesim.valve.equations import Model
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import TemperaturePath, ThermalNetwork, temperature_path
from valvesim.valve.valve_model import ValveModel

MEASURED_SIGNALS = tuple(name for name in Signals._fields if name in OUTPUTS)
"""The signals that a record may have; its other outputs are states."""


@dataclass(frozen=True)
class ModelVariant:
    """A valve with its active effects: one hypothesis about what was measured.

    `network` takes the place of the session's; `deviations` are what inputs did beside what their samples say.
    """

    valve: Valve
    effects: tuple[ActiveEffect, ...] = ()
    network: ThermalNetwork | None = None
    deviations: Deviations = ()

    def with_effect(self, active: ActiveEffect) -> ModelVariant:
        """The same valve with one effect more."""
        return replace(self, effects=(*self.effects, active))


@dataclass(frozen=True)
class Trajectory:
    """A variant's run on the grid of its predictor: states (n, n_x) of `model`, in SI.

    `fine` (n_f, n_x) are the states on the finer grid that sensors are read on, `oil` (n_f,) its temperature there,
    and `at_valve` the record's output channels (n_f,) before their sensors; `knots` (m, n_c) are the coefficients at
    the knots of the temperature `path`. `under` is the predictor under the variant's inputs.
    """

    model: Model
    states: np.ndarray
    fine: np.ndarray
    oil: np.ndarray
    at_valve: dict[str, np.ndarray]
    path: TemperaturePath
    knots: np.ndarray
    under: RecordPredictor

    @property
    def flapper_reach(self) -> float:
        """The largest share of its gap by which the flapper moves towards a nozzle; 1 where it touches."""
        c = Coefficients(*self.knots.T[: len(Coefficients._fields)])
        x_f = State(*self.fine.T[: len(State._fields)]).armature_angle * float(np.max(c.nozzle_arm))
        return max(float(np.max(x_f) / np.min(c.null_gap_1)), float(np.max(-x_f) / np.min(c.null_gap_2)))


@dataclass(frozen=True)
class RecordPredictor:
    """One record, prepared: `times` (n,) is the grid, every `oversampling`-th of its points a sample of the record.

    `preliminary` where that grid is meant for the way to a fit alone, see `without_oversampling`; its inputs are those
    under `deviations`.
    """

    record: Record
    scenario: Scenario
    universe: tuple[Effect, ...]
    lags: dict[str, float]
    path: TemperaturePath
    times: np.ndarray
    oversampling: int
    sensor_oversampling: int
    fine_times: np.ndarray
    fine_inputs: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    inputs: np.ndarray  # (n, inputs): command, its rate, pressures
    throttling: Callable | None  # of the scenario
    options: IdentificationOptions
    preliminary: bool = False
    deviations: Deviations = ()

    def without_oversampling(self) -> RecordPredictor:
        """The same predictor with its grid at the samples alone: it reads the same, and is seen in less time."""
        times = self.times[:: self.oversampling]
        return replace(
            self,
            times=times,
            inputs=_inputs((self.scenario.command, *self.scenario.pressures()), times),
            oversampling=1,
            sensor_oversampling=self.oversampling * self.sensor_oversampling,
            preliminary=True,
        )

    def under(self, deviations: Deviations) -> RecordPredictor:
        """The same predictor where its command and pressures deviate so; a temperature is left to `temperatures`."""
        acting = acting_on(deviations, self.record.name)
        own = tuple(each for each in acting if each[0].column != "oil_temperature")
        if own == self.deviations:
            return self
        commands = [self._deviating(column, command, own) for column, command in self._commands()]
        changed = {
            k: commands[k]
            for k, (column, _) in enumerate(self._commands())
            if acting_on(own, self.record.name, column) != acting_on(self.deviations, self.record.name, column)
        }
        starts, intervals = merge(commands, self.scenario.duration)
        fine = _with_inputs(self.fine_inputs, changed, self.fine_times)
        coarse = fine if self.sensor_oversampling == 1 else _with_inputs(self.inputs, changed, self.times)
        return replace(self, starts=starts, rows=intervals.rows, inputs=coarse, fine_inputs=fine, deviations=own)

    def under_inputs_of(self, trajectory: Trajectory, deviations: Deviations) -> RecordPredictor:
        """`under` the deviations of a trajectory, which has been so already if it is of this predictor."""
        known = trajectory.under
        own = all(getattr(known, name) is getattr(self, name) for name in ("record", "scenario", "times", "options"))
        return (known if own else self).under(deviations)

    def _deviating(self, column: str, command: Command, deviations: Deviations) -> Command:
        """An input with what deviates of its column."""
        return deviating_command(command, self.scenario.duration, acting_on(deviations, self.record.name, column))

    def _commands(self) -> list[tuple[str, Command]]:
        """The inputs of the equations by their columns, in the order of `Inputs` without the rate."""
        names = (self.record.command, "supply_pressure", "return_pressure", "load_pressure")
        return list(zip(names, (self.scenario.command, *self.scenario.pressures()), strict=True))

    def added_inputs(self, deviations: Deviations, before: Deviations) -> np.ndarray | None:
        """What deviations add to the inputs (n, inputs) on the grid beyond others before; None where nothing."""
        new, old = acting_on(deviations, self.record.name), acting_on(before, self.record.name)
        if new == old:
            return None
        added = np.zeros_like(self.inputs)
        for k, (column, command) in enumerate(self._commands()):
            mine, others = (acting_on(one, self.record.name, column) for one in (new, old))
            if mine == others:
                continue
            by = added_input(command, self.scenario.duration, mine, others, self.times)
            added[:, k + (k > 0)] = by
            if k == 0:
                added[1:, 1] = np.gradient(by, self.times)[1:]
        return added

    def runs_as(self, other: RecordPredictor) -> bool:
        """Whether any variant reads the same on both: they are of a record and its repeat, say."""
        mine, others = self._inputs_of_run(), other._inputs_of_run()
        return self.record.outputs == other.record.outputs and all(map(np.array_equal, mine, others))

    def _inputs_of_run(self) -> tuple[np.ndarray, ...]:
        return self.times, self.fine_times, self.fine_inputs, self.starts, self.rows, *_values_of(self.path)

    def model(self, effects: Sequence[ActiveEffect]) -> Model:
        """The equations with the one effect that has a balance; for several those with the universe, if they are in it.

        A model with its own effect alone runs twice as fast as the universe does.
        """
        own = tuple(active.effect for active in effects if active.effect.balance is not None)
        if len(own) < 2:
            return self.scenario.model.with_effects(own)
        names = {effect.name for effect in self.universe}
        return self.scenario.model.with_effects(self.universe if all(e.name in names for e in own) else own)

    def run(self, variant: ModelVariant, near: Trajectory | None = None) -> Trajectory:
        """The trajectory of a variant from rest, from where one `near` it rests if that is known. Raises InputError for
        impossible dimensions, SolveError where it fails.
        """
        posed = self.posed(variant, near)
        return posed.trajectory(posed.at_rest() if near is None else posed.at_rest_near(near))

    def posed(self, variant: ModelVariant, near: Trajectory | None = None) -> PosedRun:
        """The run of a variant, posed; inputs that a trajectory `near` it has too are taken from there. Raises
        InputError for impossible dimensions.
        """
        model = self.model(variant.effects)
        path, knots = self.coefficients_at_knots(variant, model)
        stacked = np.stack(np.broadcast_arrays(*knots), axis=-1).astype(float)
        flat = np.array(np.broadcast_to(stacked, (len(path.times), stacked.shape[-1])))
        compiled = compile_model(model, absent_coefficients(model, flat))
        off = self.switched_off(model, variant.effects)
        under = self.under(variant.deviations) if near is None else self.under_inputs_of(near, variant.deviations)
        return PosedRun(self, under, compiled, path, flat, off)

    def oil_along(self, path: TemperaturePath) -> np.ndarray:
        """The oil's temperature (n_f,) of a path on the fine grid."""
        return between(self.fine_times, path.times, _column(path.parts.oil, path))[0]

    @property
    def first_inputs(self) -> np.ndarray:
        """The inputs (n_u,) that a run starts at rest under."""
        return np.array(Inputs(*self.inputs[0])._replace(command_rate=0.0))

    @property
    def where(self) -> str:
        """How a message about this record begins."""
        return f"record {self.record.name}: "

    def on_grid(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory of this predictor, or of the same at another spacing, on the grid of this one: nothing is
        integrated.
        """
        return replace(trajectory, states=np.ascontiguousarray(trajectory.fine[:: self.sensor_oversampling]))

    def coefficients_at_knots(
        self, variant: ModelVariant, model: ValveModel, path: TemperaturePath | None = None
    ) -> tuple[TemperaturePath, tuple]:
        """Temperature path, and flat coefficients of a model at its knots, (), (m,) or (batch, m) each."""
        path = self.temperatures(variant) if path is None else path
        with _naming_record(self.record):
            c = variant.valve.at(path.parts, oil=self.scenario.oil, routes=self.scenario.thermal.routes)
        return path, model.flat_coefficients(c, _with_neutral(model, variant.effects), path.parts)

    def same_temperatures(self, variant: ModelVariant, other: ModelVariant) -> bool:
        """Whether the parts of two variants have the same temperatures throughout."""

        def of(one: ModelVariant) -> tuple:
            acting = tuple(a for a in one.effects if a.effect.temperatures is not None)
            return acting, one.network, self._oil_deviations(one)

        return of(variant) == of(other)

    def _oil_deviations(self, variant: ModelVariant) -> Deviations:
        return acting_on(variant.deviations, self.record.name, "oil_temperature")

    def temperatures(self, variant: ModelVariant) -> TemperaturePath:
        """The temperatures of a variant: on knots of their own where an effect acts on them."""
        network = variant.network or self.scenario.thermal.network
        acts = any(active.effect.temperatures is not None for active in variant.effects)
        if not acts and not self._oil_deviations(variant) and network == self.scenario.thermal.network:
            return self.path
        if self.has_own_knots(variant):
            known = self.path.times if len(self.path.times) > 1 and not self._oil_deviations(variant) else None
            return temperature_knots(self._thermal_scenario(variant), first=known)[0]
        return self.temperatures_of(variant, network)

    def temperatures_at(self, variant: ModelVariant, knots: np.ndarray) -> TemperaturePath:
        """The temperatures of a variant on given knots (m,), with the effects on them."""
        return self._thermal_scenario(variant).temperatures(knots=knots)

    def _thermal_scenario(self, variant: ModelVariant) -> Scenario:
        """The record's scenario with the effects, the network and the oil temperature of a variant."""
        thermal = replace(self.scenario.thermal, network=variant.network or self.scenario.thermal.network)
        oil = self._oil_temperature(variant)
        return replace(self.scenario, effects=variant.effects, thermal=thermal, oil_temperature=oil)

    def has_own_knots(self, variant: ModelVariant) -> bool:
        """Whether the temperatures of a variant are on other knots than those of the record."""
        acts = any(active.effect.temperatures is not None for active in variant.effects)
        return acts or (len(self.path.times) == 1 and not isinstance(self._oil_temperature(variant), Constant))

    def temperatures_of(
        self, variant: ModelVariant, network: ThermalNetwork | Sequence[ThermalNetwork] | None
    ) -> TemperaturePath:
        """The temperatures of a variant with another network, or with each of several, on the record's knots."""
        thermal = self.scenario.thermal
        return temperature_path(
            self._oil_temperature(variant), self.scenario.duration, network=network,
            initial=thermal.initial_temperature, ambient=thermal.ambient_temperature, throttling=self.throttling,
            knots=self.path.times, prescribed=self.scenario.part_temperatures,
        )  # fmt: skip

    def _oil_temperature(self, variant: ModelVariant) -> Command:
        deviations, oil = self._oil_deviations(variant), self.scenario.oil_temperature
        return self._deviating("oil_temperature", oil, deviations) if deviations else oil

    def states_between(
        self, trajectory: Trajectory, variant: ModelVariant, first: np.ndarray, last: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """The states (n_t, n_x) of a variant's trajectory at times that lie between points `first` (k,) and `last`
        (k,) of the grid, one pair after the other. This predictor is that under the variant's inputs.
        """
        compiled = compile_model(trajectory.model, absent_coefficients(trajectory.model, trajectory.knots))
        off, scaled = self.switched_off(trajectory.model, variant.effects), trajectory.states / compiled.scale
        problem = _problem(self, compiled, trajectory.path, trajectory.knots, scaled[0], off)
        what = f"{self.where}the simulation"
        return integrate_parts(
            replace(problem, times=times), self.times[first], self.times[last], scaled[first], what=what
        )

    def coefficients_along(
        self,
        variant: ModelVariant,
        model: ValveModel,
        path: TemperaturePath | None = None,
        times: np.ndarray | None = None,
    ) -> tuple:
        """Flat coefficients of a model for a variant on the grid, or at times, (n,) each, (1,) where constant; `path`
        is that of the variant, where it is known.
        """
        path, knots = self.coefficients_at_knots(variant, model, path)
        columns = [np.atleast_1d(np.asarray(value, dtype=float)) for value in knots]
        if len(path.times) == 1:
            return tuple(columns)
        k, share = brackets(self.times if times is None else times, path.times)
        return tuple(
            column[:1] if np.all(column == column[0]) else linear_interpolation(column, k, share) for column in columns
        )

    def switched_off(self, model: ValveModel, active: Sequence[ActiveEffect]) -> np.ndarray:
        """True for each state of the model that is the memory of an effect which is not active."""
        given = {a.effect.name for a in active}
        off = [False] * model.memory_states.start
        return np.array([*off, *(e.name not in given for e in model.effects for _ in e.memory)])

    def reduced(self, model: Model, variant: ModelVariant) -> tuple[Model, np.ndarray]:
        """The model with a variant's own effects alone, and the indices of its states in those of a fuller one."""
        active = {a.effect.name for a in variant.effects}
        own = model.with_effects([e for e in model.effects if e.name in active])
        return own, np.flatnonzero(~self.switched_off(model, variant.effects))

    def readings(self, trajectory: Trajectory, variant: ModelVariant) -> dict[str, np.ndarray]:
        """What the record's sensors would have read, (n_samples,) by channel, before noise and resolution."""
        return self.apply_sensors(trajectory.at_valve, trajectory, variant)

    def _outputs(
        self, model: Model, fine: np.ndarray, path: TemperaturePath, knots: np.ndarray
    ) -> dict[str, np.ndarray]:
        """The record's output channels on the fine grid, (n_f,) each, as they are at the valve; `knots` (m, n_c) are
        the coefficients at those of the path.
        """
        names = self.record.outputs
        values = {channel.name: fine[:, k] for k, channel in enumerate(model.state_channels) if channel.name in names}
        if set(names) - set(values):
            found = compile_derivatives(model, MEASURED_SIGNALS).values(
                fine, self.fine_inputs, coefficient_course(path, knots, self.fine_times)
            )
            at = len(model.state_channels)
            values |= {name: found[at + k] for k, name in enumerate(MEASURED_SIGNALS) if name in names}
        return values

    def apply_sensors(
        self, values: dict[str, np.ndarray], trajectory: Trajectory, variant: ModelVariant
    ) -> dict[str, np.ndarray]:
        """Channels on either grid, (n,) or columns (n, k), as their sensors give them at the samples: the errors after
        the last that reads between these act on what is read at them.
        """
        found = {}
        for name, column in values.items():
            acting, seen = self._acting_on(name, variant), self._before_sensor(column, trajectory)
            on_grid = max((k for k, active in enumerate(acting, 1) if reads_between(active.effect)), default=0)
            seen = _read_through(acting[:on_grid], seen)
            found[name] = _read_through(acting[on_grid:], Reading(*map(self.at_samples, seen))).values
        return found

    def at_samples(self, column: np.ndarray) -> np.ndarray:
        """A column on either grid, (n,) or columns (n, k), at the samples."""
        fine = len(column) == len(self.fine_times)
        return column[:: self.oversampling * (self.sensor_oversampling if fine else 1)]

    def apply_sensor(self, name: str, column: np.ndarray, trajectory: Trajectory, variant: ModelVariant) -> np.ndarray:
        """A channel on either grid as its sensor gives it there."""
        return _read_through(self._acting_on(name, variant), self._before_sensor(column, trajectory)).values

    def _before_sensor(self, column: np.ndarray, trajectory: Trajectory) -> Reading:
        """A channel on either grid as its sensor has it to read."""
        if len(column) == len(self.fine_times):
            return Reading(self.fine_times, column, trajectory.oil)
        return Reading(self.times, column, trajectory.oil[:: self.sensor_oversampling])

    def _acting_on(self, name: str, variant: ModelVariant) -> list[ActiveEffect]:
        """What acts on the sensor of a channel, in its order."""
        readings = [a for a in variant.effects if a.effect.reading is not None]
        acting = [active_in(a, self.record.name) for a in readings if reads_channel(a.effect, name, self.record.name)]
        return [*acting, sensor_lag(name, self.lags[name])] if self.lags.get(name, 0.0) > 0.0 else acting

    def curvatures(self, trajectory: Trajectory, variant: ModelVariant) -> dict[str, np.ndarray]:
        """By how much each reading, on the fine grid, bends next to a sample (n_samples,): half its second difference.

        Zero where the grid is that of the samples.
        """
        from scipy.ndimage import maximum_filter1d

        step, curvatures = self.oversampling * self.sensor_oversampling, {}
        for name, column in trajectory.at_valve.items():
            bend = np.zeros(len(column))
            if step > 1:
                bend[1:-1] = np.abs(np.diff(self.apply_sensor(name, column, trajectory, variant), 2)) / 2.0
            curvatures[name] = maximum_filter1d(bend, 2 * self.options.predictor.curvature_reach + 1)[::step]
        return curvatures


@dataclass(frozen=True, eq=False)
class PosedRun:
    """A variant's run of a record, posed: `under` is the record's predictor under the variant's inputs, `knots`
    (m, n_c) are its coefficients at those of the `path`, `off` (n_x,) is true for memories of absent effects.
    """

    predictor: RecordPredictor
    under: RecordPredictor
    compiled: CompiledModel
    path: TemperaturePath
    knots: np.ndarray
    off: np.ndarray

    def at_rest(self) -> np.ndarray:
        """The scaled states (n_x,) that it starts from."""
        first = self.under.first_inputs
        return state_at_rest(self.compiled, first, self.knots[:1], held=self.off, where=self.under.where)[0]

    def rests_near(self, trajectory: Trajectory) -> bool:
        """Whether its states at rest are those near a trajectory's, by balances alone: a memory (hysteresis, friction)
        rests where it was left on the way from zero current.
        """
        model = self.compiled.model
        same_states = trajectory.model.state_channels == model.state_channels
        return same_states and bool(self.off[model.memory_states].all())

    def is_run_of(self, trajectory: Trajectory) -> bool:
        """Whether a trajectory is this very run."""
        same = trajectory.model == self.compiled.model and np.array_equal(trajectory.knots, self.knots)
        same = same and all(map(np.array_equal, _values_of(trajectory.path), _values_of(self.path)))
        return same and (self.under is trajectory.under or self.under.runs_as(trajectory.under))

    def at_rest_near(self, trajectory: Trajectory) -> np.ndarray:
        """The same states, by Newton's method from those that a trajectory near it starts from, where that ends."""
        if self.rests_near(trajectory):
            first, near = self.under.first_inputs, trajectory.fine[0] / self.compiled.scale
            with suppress(SolveError):  # it is looked for from zero current then
                return settled_from(self.compiled, near, first, self.knots[0], held=self.off)
        return self.at_rest()

    def trajectory(self, initial: np.ndarray) -> Trajectory:
        """The trajectory from scaled states (n_x,) at rest."""
        under, model, path = self.under, self.compiled.model, self.path
        problem = _problem(under, self.compiled, path, self.knots, initial, self.off)
        advice = "Is the valve of session.toml the one that was measured?"
        fine = integrate(problem, what=f"{under.where}the simulation", advice=advice)[0]
        at_valve = under._outputs(model, fine, path, self.knots)
        oil = self.predictor.oil_along(path)
        return self.predictor.on_grid(Trajectory(model, fine, fine, oil, at_valve, path, self.knots, under))


def at_rest_together(posed: Sequence[PosedRun], near: Sequence[Trajectory] = ()) -> list[np.ndarray]:
    """The scaled states (n_x,) that runs of one variant start from: records are members of one batch, or each starts
    from where a trajectory of the same model `near` it rests. Raises as `PosedRun.at_rest` does.
    """
    first = posed[0]
    pairs = list(zip(posed, near, strict=True)) if near else []
    if pairs and all(one.rests_near(trajectory) for one, trajectory in pairs):
        return [one.at_rest_near(trajectory) for one, trajectory in pairs]
    if all(one.compiled is first.compiled for one in posed):
        inputs = np.stack([one.under.first_inputs for one in posed])
        with suppress(SolveError):  # which is told of its record below
            return [*state_at_rest(first.compiled, inputs, np.stack([one.knots[0] for one in posed]), held=first.off)]
    return [one.at_rest() for one in posed]


def coefficient_course(path: TemperaturePath, knots: np.ndarray, times: np.ndarray) -> CoefficientCourse:
    """Coefficients (m, n_c) at the knots of a path along a course of times (n,)."""
    if len(path.times) == 1:
        return CoefficientCourse(knots, np.zeros(len(times), dtype=np.int64), np.zeros(len(times)))
    return CoefficientCourse(knots, *brackets(times, path.times))


def _read_through(acting: Sequence[ActiveEffect], seen: Reading) -> Reading:
    """What a sensor reads with effects that act one after the other."""
    for active in acting:
        seen = seen._replace(values=apply_reading(active, seen))
    return seen


def apply_reading(active: ActiveEffect, seen: Reading) -> np.ndarray:
    """What a sensor with an effect reads of one channel (n,), or of columns (n, k) of it."""
    reading = active.effect.reading
    assert reading is not None  # noqa: S101 - the caller has chosen effects with one
    if seen.values.ndim == 1 or active.effect.reads_columns:
        return reading(seen, active.values)
    return np.column_stack([reading(seen._replace(values=column), active.values) for column in seen.values.T])


def is_quasi_static(record: Record, *, options: IdentificationOptions) -> bool:
    """Whether a record is sampled too slowly to show the valve's motion between two samples."""
    return record.rate * options.predictor.quasi_static_step < 1.0


def prepare_record(
    session: Session, record: Record, universe: Sequence[Effect], *, options: IdentificationOptions
) -> RecordPredictor:
    """A record ready to be predicted with any variant whose effects with a balance are among `universe`."""
    with _naming_record(record):
        scenario = record_scenario(session, record, tolerance=options.predictor.tolerance, options=options)
        path, _ = temperature_knots(scenario)
    step = 1.0 / record.rate
    oversampling = (
        int(np.ceil(step / _grid_spacing(session, options=options) - 1e-6))
        if not is_quasi_static(record, options=options)
        else 1
    )
    count = (len(record.time) - 1) * oversampling + 1
    times = np.linspace(0.0, float(record.time[-1]), count)
    sensor_oversampling = 1
    if not is_quasi_static(record, options=options):
        sensor_oversampling = (
            int(np.ceil(step / oversampling / options.predictor.sensor_spacing - 1e-6))
            if record.duration <= options.predictor.long_record
            else 2
        )
    fine_times = np.linspace(0.0, float(record.time[-1]), (count - 1) * sensor_oversampling + 1)
    starts, intervals = merge((scenario.command, *scenario.pressures()), scenario.duration)
    sensors = session.sensors
    return RecordPredictor(
        record=record,
        scenario=scenario,
        universe=tuple(effect for effect in universe if effect.balance is not None),
        lags={name: sensors[name].lag for name in record.outputs if name in sensors},
        path=path,
        times=times,
        oversampling=oversampling,
        sensor_oversampling=sensor_oversampling,
        fine_times=fine_times,
        fine_inputs=_inputs((scenario.command, *scenario.pressures()), fine_times),
        starts=starts,
        rows=intervals.rows,
        inputs=_inputs((scenario.command, *scenario.pressures()), times),
        throttling=scenario.throttling(),
        options=options,
    )


@contextmanager
def _naming_record(record: Record) -> Iterator[None]:
    """An InputError from inside gets the record's name."""
    try:
        yield
    except InputError as error:
        raise InputError(f"record {record.name}: {error}") from None


def _grid_spacing(session: Session, *, options: IdentificationOptions) -> float:
    """The spacing (s) of trajectories in a session: wider where its training records are long."""
    return max(
        options.predictor.grid_spacing,
        sum(record.duration for record in session.training if not is_quasi_static(record, options=options))
        / options.predictor.most_points,
    )


def _inputs(commands: Sequence[Command], times: np.ndarray) -> np.ndarray:
    """(n, inputs): command, its rate, pressures; `commands` are command and pressures."""
    return _with_inputs(np.empty((len(times), len(commands) + 1)), dict(enumerate(commands)), times)


def _with_inputs(inputs: np.ndarray, changed: Mapping[int, Command], times: np.ndarray) -> np.ndarray:
    """Inputs (n, inputs) with others in the place of some commands, by their place in `_inputs`."""
    inputs = inputs.copy()
    for k, command in changed.items():
        inputs[:, k + (k > 0)] = evaluate(command, times)
        if k == 0:
            inputs[:, 1] = np.gradient(inputs[:, 0], times)
            inputs[0, 1] = 0.0  # a record starts at rest
    return inputs


def neutral(effect: Effect) -> ActiveEffect:
    """The effect switched off."""
    amplitude = effect.amplitude
    return effect(**{amplitude.name: amplitude.neutral or 0.0})


def _with_neutral(model: ValveModel, active: Sequence[ActiveEffect]) -> list[ActiveEffect]:
    """The active effects, with those of the model that are not among them switched off, in the model's order."""
    given = {a.effect.name: a for a in active if a.effect.balance is not None}
    in_model = [given.get(effect.name) or neutral(effect) for effect in model.effects]
    return [*in_model, *(a for a in active if a.effect.balance is None)]


def side_by_side(paths: Sequence[TemperaturePath]) -> TemperaturePath:
    """Temperature paths on the same knots (m,) as one, whose parts are (k, m): one may hold several already."""
    names, like = tuple(paths[0].parts.__dataclass_fields__), paths[0].times
    rows = [np.broadcast_arrays(np.zeros((1, len(like))), *(getattr(one.parts, n) for n in names))[1:] for one in paths]
    parts = {name: np.concatenate(one) for name, one in zip(names, zip(*rows, strict=True), strict=True)}
    return replace(paths[0], parts=replace(paths[0].parts, **parts))


def _values_of(path: TemperaturePath) -> tuple[np.ndarray, ...]:
    return path.times, *(np.asarray(getattr(path.parts, name)) for name in path.parts.__dataclass_fields__)


def _column(value: np.ndarray, path: TemperaturePath) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, dtype=float), path.times.shape)[:, None]


def _problem(
    predictor: RecordPredictor,
    compiled: CompiledModel,
    path: TemperaturePath,
    flat: np.ndarray,
    initial: np.ndarray,
    off: np.ndarray,
) -> InitialValueProblem:
    """A run from scaled states (n_x,) at rest, with flat coefficients (m, n_c) at the knots of a path."""
    options = predictor.options.predictor
    return InitialValueProblem(
        compiled=compiled,
        initial=initial,
        starts=predictor.starts,
        rows=predictor.rows,
        knot_times=path.times,
        knots=flat,
        times=predictor.fine_times,
        end=float(predictor.times[-1]),
        tolerance=options.tolerance,
        most_steps=options.most_steps + options.steps_per_point * len(predictor.fine_times),
        ignored=off,
    )
