"""A record linearised about the trajectory of one model: sensitivities of its readings by tangent equations."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d

from valvesim.identification.between_samples import acting_on
from valvesim.identification.predictor import (
    MEASURED_SIGNALS,
    ModelVariant,
    RecordPredictor,
    Trajectory,
    apply_reading,
    coefficient_course,
    side_by_side,
)
from valvesim.identification.sensor_errors import ToleratedSensorError, ToleratedTimeError, active_in, reads_between
from valvesim.identification.tangent_linear import (
    ChangedCoefficients,
    Course,
    Forcing,
    Sampling,
    ScaledForcing,
    TangentLinear,
    change_of_jacobian,
    linearise_along,
    memory_response,
    sampled_at,
)
from valvesim.solver.partial_derivatives import CoefficientCourse, CompiledDerivatives, compile_derivatives
from valvesim.valve.effect import ActiveEffect, Reading, Situation
from valvesim.valve.equations import INERTIAS, Model, valve_equations
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import TemperaturePath


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """A record linearised about the trajectory of one variant: its readings, and the tangent equations.

    `seen` (n_f,) is what the sensors read on the fine grid, `readings` (n_samples,) the same at the samples.
    `model` has the effects of the variant alone, in the order of the trajectory's. Along the `course` (n points) of the
    trajectory, where its coefficients are `coefficients`, stand the `values` (targets, n) of `compiled`, and its
    derivatives `partials` (entries, n).
    """

    predictor: RecordPredictor
    variant: ModelVariant
    trajectory: Trajectory
    tangent: TangentLinear
    model: Model
    seen: dict[str, np.ndarray]
    readings: dict[str, np.ndarray]
    compiled: CompiledDerivatives
    course: Course
    coefficients: CoefficientCourse
    values: np.ndarray
    partials: np.ndarray

    def residual(self) -> dict[str, np.ndarray]:
        """Measured minus predicted, (n_samples,) by channel."""
        return {name: self.predictor.record.values[name] - read for name, read in self.readings.items()}

    def simulated_difference(self, variant: ModelVariant) -> dict[str, np.ndarray]:
        """Readings of a variant less those of this one, (n_samples,) by channel, by simulation."""
        read = self.predictor.readings(self.predictor.run(variant, self.trajectory), variant)
        return {name: read[name] - own for name, own in self.readings.items()}

    def read_beside(self, error: ActiveEffect) -> np.ndarray:
        """The reading (n_samples,) of the channel that a further error of its sensor is of, with it."""
        own = active_in(error, self.predictor.record.name)
        seen = Reading(self.predictor.fine_times, self.seen[str(error.effect.channel)], self.trajectory.oil)
        if reads_between(error.effect):
            return self.predictor.at_samples(apply_reading(own, seen))
        return apply_reading(own, Reading(*map(self.predictor.at_samples, seen)))

    def linear_difference(self, variants: Sequence[ModelVariant]) -> dict[str, np.ndarray]:
        """The same for several variants by the linearised equations, (n_samples, k): to first order in what they add
        to the rates.

        A variant has this linearised record's effects, then at most one more.
        """
        points = len(self.course.times) * (len(self.tangent.active) + len(self.trajectory.at_valve))
        few = max(int(self.predictor.options.sensitivity.forcing_bytes / (8 * points)), 1)
        parts = [
            self.forced_response([self.forcing(variant) for variant in variants[start : start + few]])
            for start in range(0, max(len(variants), 1), few)
        ]
        return {name: np.column_stack([part[name] for part in parts]) for name in self.readings}

    def input_difference(self, variants: Sequence[ModelVariant], beside: ModelVariant) -> dict[str, np.ndarray]:
        """The same less that of one `beside` them, of variants that differ from it by their command and pressures."""
        states, coefficients, inputs = self.course.states, self._coefficients_of(beside), self.course.inputs
        if (added := self.predictor.added_inputs(beside.deviations, self.variant.deviations)) is not None:
            inputs = inputs + self.course.between(added)
        own, forcings = self.compiled.values(states, inputs, coefficients), []
        for variant in variants:
            if (added := self.predictor.added_inputs(variant.deviations, beside.deviations)) is None:
                added = np.zeros_like(self.predictor.inputs)
            added = self.course.between(added)
            rows = _moved_rows(added)
            new = self.compiled.values(states[rows], inputs[rows] + added[rows], coefficients.at(rows))
            forcings.append(self._forcing_of(new - own[:, rows], rows.start))
        return self.forced_response(forcings)

    def small_difference(
        self, variants: Sequence[ModelVariant], of_valves: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """The same where what the variants change is small: to first order in their coefficients and inputs too.
        `of_valves` are the `changes_of_valves` that come before them.
        """
        given = [] if of_valves is None else list(of_valves)
        few = dict(enumerate(given)) | {
            len(given) + k: change for k, change in self._changes_by_temperature(variants).items()
        }
        forced = {k: own for k, change in few.items() if (own := self._forcing_of_inertia(change)) is not None}
        for k, variant in enumerate(variants, len(given)):
            if k not in few:
                own = self._forcing_of_inputs(variant)
                forced[k] = self.forcing(variant) if own is None else own
        few = {k: change for k, change in few.items() if k not in forced}
        changed = None
        if few:
            changes = np.stack(list(few.values()), axis=-1)
            changed = ChangedCoefficients(changes, self.coefficients, self.compiled, self.partials)
        order = np.argsort([*few, *forced])
        return {name: moved[:, order] for name, moved in self.forced_response([*forced.values()], changed).items()}

    def diverging(self, moved: Mapping[str, np.ndarray]) -> list[int]:
        """The columns of responses (n_samples, k) that are far larger than all that was measured and is read (of a test
        that is planned nothing is measured): there the linearised equations are unstable, and the valve is not. What
        overflows (`DIVERGED`) is zero already and not among them.
        """
        record, within = self.predictor.record, []
        for name, columns in moved.items():
            seen = np.append(record.values[name][record.usable[name]], self.readings[name])
            largest = max(np.ptp(seen), np.abs(seen).max())
            most = self.predictor.options.sensitivity.most_spans * largest
            within.append(np.max(np.abs(columns), axis=0, initial=0.0) <= most)
        return [int(k) for k in np.flatnonzero(~np.all(within, axis=0))]

    def forced_response(
        self,
        forcings: Sequence[Forcing],
        changed: ChangedCoefficients | None = None,
        scaled: ScaledForcing | None = None,
    ) -> dict[str, np.ndarray]:
        """The response (n_samples, k) of the readings to changed coefficients, then to forcings, then to a scaled one.
        """
        times, out = self.course.times, {}
        if not forcings and changed is None and scaled is None:
            return {name: np.empty((len(self.predictor.record.time), 0)) for name in self.trajectory.at_valve}
        reads, late = dict[str, Sampling](), dict[str, list[ActiveEffect]]()
        for name in self.trajectory.at_valve:
            late[name] = self._time_errors(name)
            if self._altered(name):
                reads[name] = sampled_at(times, self.predictor.times)
                continue
            at = self._read_times(late[name])[:: self.predictor.oversampling]
            reads[name] = sampled_at(times, at, self.predictor.lags.get(name, 0.0))
        for name, moved in self.tangent.read_responses(reads, forcings, changed, scaled).items():
            out[name] = self._through_sensor(name, moved, late[name]) if self._altered(name) else moved
        return out

    def _through_sensor(self, name: str, moved: np.ndarray, late: Sequence[ActiveEffect]) -> np.ndarray:
        """A channel's response (n_samples, k) as its sensor shows it, from that at the valve on the grid (n, k)."""
        faults = tuple(a for a in self.variant.effects if not isinstance(a.effect, ToleratedSensorError))
        variant = replace(self.variant, effects=(*faults, *late))
        own = self.trajectory.at_valve[name]
        own = own[:: self.predictor.sensor_oversampling]  # coarse for the sensor's corners: in both, they cancel
        nominal = self.predictor.apply_sensors({name: own}, self.trajectory, variant)[name]
        shown = self.predictor.apply_sensors({name: own[:, None] + moved}, self.trajectory, variant)[name]
        return shown - nominal[:, None]

    def _altered(self, channel: str) -> bool:
        """Whether a sensor fault changes the response of a channel; errors within tolerance do not matter."""
        return any(
            a.effect.channel == channel and not isinstance(a.effect, ToleratedSensorError) for a in self.variant.effects
        )

    def _time_errors(self, channel: str) -> list[ActiveEffect]:
        """The errors within tolerance of when a channel is read."""
        acting = [a for a in self.variant.effects if isinstance(a.effect, ToleratedTimeError)]
        return [a for a in acting if a.effect.channel == channel]

    def _read_times(self, late: Sequence[ActiveEffect]) -> np.ndarray:
        """The times (n,) at which a channel with such errors is read: what it would read of a clock."""
        times = self.predictor.times
        clock, oil = times, self.trajectory.oil[:: self.predictor.sensor_oversampling]
        for active in late:
            assert active.effect.reading is not None  # noqa: S101 - it errs in what it reads
            clock = active.effect.reading(Reading(times, clock, oil), active.values)
        return clock

    def argument(self, variable: Any, states: tuple) -> np.ndarray:
        """A variable of a term (n,) along the trajectory."""
        return np.asarray(variable.along(self.model, states, tuple(self.course.inputs.T)))

    def changes_of_valves(self, valves: Valve, count: int = 1) -> np.ndarray:
        """By how much the coefficients change with the valve, (count, m, n_c) at the knots of the trajectory's path,
        of a batch of so many valves.
        """
        return self._changes(replace(self.variant, valve=valves), self.trajectory.path, count)

    def _changes_by_temperature(self, variants: Sequence[ModelVariant]) -> dict[int, np.ndarray]:
        """The same of those variants, by their places, in which temperatures alone are others: together, but one by one
        those beside an effect on the temperatures: on its knots, less this one's there, for while knots were sought it
        acted on straight lines between others.
        """
        own, knots = self.variant, self.trajectory.path.times
        of_network = [k for k, one in enumerate(variants) if replace(one, network=own.network) == own != one]
        of_oil = [k for k, one in enumerate(variants) if self._is_of_oil(one)]
        if self.predictor.has_own_knots(own):
            beside = [*of_network, *of_oil]
            if len(knots) == 1 or not beside:
                return {}
            plain, *moved = (self._changes(own, self.predictor.temperatures_at(one, knots))[0]
                             for one in (own, *(variants[k] for k in beside)))  # fmt: skip
            return {k: each - plain for k, each in zip(beside, moved, strict=True)}
        of_oil = [k for k in of_oil if not self.predictor.has_own_knots(variants[k])]
        paths = [self.predictor.temperatures(variants[k]) for k in of_oil]
        networks = [variants[k].network or self.predictor.scenario.thermal.network for k in of_network]
        if None in networks:
            of_network = []
        if of_network:
            paths.append(self.predictor.temperatures_of(own, [one for one in networks if one]))
        places = [*of_oil, *of_network]
        return dict(zip(places, self._changes(own, side_by_side(paths), len(places)), strict=True)) if places else {}

    def _changes(self, variant: ModelVariant, along: TemperaturePath, count: int = 1) -> np.ndarray:
        """The coefficients of so many variants along temperatures less those of this one, (count, m, n_c)."""
        _, knots = self.predictor.coefficients_at_knots(variant, self.trajectory.model, along)
        changes = np.empty((count, len(along.times), len(knots)))
        for k, column in enumerate(knots):
            changes[..., k] = column
        return changes - self.trajectory.knots

    def _is_of_oil(self, variant: ModelVariant) -> bool:
        """Whether of a variant the oil's temperature alone differs."""
        if not replace(variant, deviations=self.variant.deviations) == self.variant != variant:
            return False
        ways = [acting_on(one.deviations, self.predictor.record.name) for one in (variant, self.variant)]
        new, old = ([each for each in way if each[0].column != "oil_temperature"] for way in ways)
        return new == old

    def _forcing_of_inertia(self, change: np.ndarray) -> Forcing | None:
        """The forcing of a change (m, n_c) of one of `INERTIAS` alone, of one share at all knots; None of another.

        Of a velocity x' = F/c the answer is d = s - (dc/c) x with s' = A s - (dc/c) A x, and x = 0 at rest: x is smooth
        where the steps of the course do not follow its rate.
        """
        moved = np.flatnonzero(change.any(axis=0))
        names = self.trajectory.model.coefficient_names
        if len(moved) != 1 or names[moved[0]] not in INERTIAS:
            return None
        share = change[0, moved[0]] / self.trajectory.knots[0, moved[0]]
        k = [channel.name for channel in self.model.state_channels].index(INERTIAS[names[moved[0]]])
        added = -share * self.active_states[k] / self.tangent.scale[k]
        direct = {name: slopes[:, k] * added for name, slopes in self.tangent.slopes.items()}
        return Forcing(0, self.tangent.A[:, :, k] * added[:, None], direct)

    def _forcing_of_inputs(self, variant: ModelVariant) -> Forcing | None:
        """The forcing of a variant whose inputs differ by little and nothing else does, by the derivatives of the
        equations with respect to these; None of another.
        """
        same = replace(variant, deviations=self.variant.deviations) == self.variant
        if not same or not self.predictor.same_temperatures(variant, self.variant):
            return None
        added = self.predictor.added_inputs(variant.deviations, self.variant.deviations)
        if added is None:
            return None
        columns = [k for k, by in enumerate(added.T) if by.any()]
        added = self.course.between(added[:, columns])
        rows = _moved_rows(added)
        change = np.zeros((self.compiled.states.stop + len(self.compiled.signals), rows.stop - rows.start))
        for k, by in zip(columns, added[rows].T, strict=True):
            own = self.compiled.inputs.start + k
            for e in self.compiled.entries(slice(0, len(change)), slice(own, own + 1)):
                change[self.compiled.targets[e]] += self.partials[e, rows] * by
        return self._forcing_of(change, rows.start)

    def _forcing_of(self, change: np.ndarray, start: int) -> Forcing:
        """The forcing of a change of the rates and signals (targets, rows) of `compiled`."""
        s = self.compiled.states.stop
        rates = (change[:s][self.tangent.active] / self.tangent.scale[:, None]).T
        return Forcing(start, rates, dict(zip(self.compiled.signals, change[s:], strict=True)))

    def forcing(self, variant: ModelVariant) -> Forcing:
        """What a variant adds to the scaled rates and to the signals along this trajectory."""
        own = {effect.name for effect in self.model.effects}
        more = [a for a in variant.effects if a.effect.balance is not None and a.effect.name not in own]
        added = self.predictor.added_inputs(variant.deviations, self.variant.deviations)
        added = None if added is None else self.course.between(added)
        if more:
            return self._forcing_of_effects(variant, more, added)
        rows, coefficients = slice(None), self._coefficients_of(variant)
        if coefficients is self.coefficients:
            if added is None:
                return Forcing(0, np.zeros((0, len(self.tangent.active))), {})
            rows = _moved_rows(added)
        inputs = self.course.inputs[rows] if added is None else (self.course.inputs + added)[rows]
        new = self.compiled.values(self.course.states[rows], inputs, coefficients.at(rows))
        return self._forcing_of(new - self.values[:, rows], rows.start or 0)

    def _coefficients_of(self, variant: ModelVariant) -> CoefficientCourse:
        """The coefficients of a variant of the trajectory's model along it."""
        known = self.trajectory.path if self.predictor.same_temperatures(variant, self.variant) else None
        if known is not None and replace(variant, deviations=self.variant.deviations) == self.variant:
            return self.coefficients
        path, knots = self.predictor.coefficients_at_knots(variant, self.trajectory.model, known)
        stacked = np.stack(np.broadcast_arrays(*knots, path.times)[:-1], axis=-1).astype(float)
        return coefficient_course(path, stacked, self.course.times)

    def _forcing_of_effects(
        self, variant: ModelVariant, more: Sequence[ActiveEffect], added: np.ndarray | None
    ) -> Forcing:
        """`forcing` of a variant with effects that this one's model does not have."""
        model = self.model.with_effects((*self.model.effects, *(a.effect for a in more)))
        path = self.trajectory.path if self.predictor.same_temperatures(variant, self.variant) else None
        inputs = tuple((self.course.inputs if added is None else self.course.inputs + added).T)
        others = tuple(active for active in variant.effects if active not in more)
        same_situation = replace(variant, effects=others, deviations=self.variant.deviations) == self.variant
        same_situation &= path is not None and added is None
        same_situation &= all(active.effect.coefficients is None for active in more)
        if same_situation:
            middle = self.middle_situation
            along = (*self.coefficients_along, *(np.atleast_1d(n) for active in more for n in active.numbers))
        else:
            along = self.predictor.coefficients_along(variant, model, path, self.course.times)
            middle = self._middle_situation(along)
        states = list(self.active_states)
        for active in more:
            states += self._memory_trajectories(active, middle)
        if same_situation:
            at = self.situation
            ports, _ = model.effects_on(at, states, along)
            rates, signals = valve_equations(at.state, at.inputs, at.coil_current, at.coefficients, ports)
        else:
            rates, signals = model.evaluate(states, inputs, along)
        own_rates, own_signals = self.evaluated
        g = np.zeros((len(self.course.times), len(self.tangent.active)))
        for k, (new, old) in enumerate(zip(rates, own_rates, strict=False)):
            g[:, k] = (new - old) / self.tangent.scale[k]
        return Forcing(0, g, {
            name: np.broadcast_to(getattr(signals, name) - getattr(own_signals, name), len(g))
            for name in self.compiled.signals
        })  # fmt: skip

    @property
    def active_states(self) -> tuple[np.ndarray, ...]:
        """The states (n,) that take part."""
        return tuple(self.course.states[:, k] for k in self.tangent.active)

    @functools.cached_property
    def coefficients_along(self) -> tuple:
        """The flat coefficients of `model` along the course, (n,) each, (1,) where constant."""
        path = self.trajectory.path
        return self.predictor.coefficients_along(self.variant, self.model, path, self.course.times)

    @functools.cached_property
    def evaluated(self) -> tuple[tuple, Any]:
        """Rates and signals as `Model.evaluate` has them: beside an effect that does nothing, these and no rounding."""
        return self.model.evaluate(self.active_states, tuple(self.course.inputs.T), self.coefficients_along)

    @functools.cached_property
    def situation(self) -> Situation:
        """What effects see along the course."""
        return self.model.situation(self.active_states, tuple(self.course.inputs.T), self.coefficients_along)

    @functools.cached_property
    def middle_situation(self) -> Situation:
        """What effects see at rest, and then in the middles of the steps."""
        return self._middle_situation(self.coefficients_along)

    def _middle_situation(self, along: tuple) -> Situation:
        """The same with other coefficients `along` the course."""

        def middle(values: np.ndarray, rest: float | None = None) -> np.ndarray:
            return np.concatenate([[values[0] if rest is None else rest], (values[1:] + values[:-1]) / 2.0])

        states = tuple(middle(x) for x in self.active_states[: self.model.memory_states.start])
        inputs = tuple(middle(u, 0.0 if k == 1 else None) for k, u in enumerate(self.course.inputs.T))
        c = tuple(middle(v) if len(v) > 1 else v for v in self.model.valve_coefficients(along))
        return self.model.situation(states, inputs, c)

    def _memory_trajectories(self, active: ActiveEffect, middle: Situation) -> list[np.ndarray]:
        """The memories (n,) of an effect along the trajectory, by what it sees in the `middle` of the steps: linear in
        themselves, so exact for a trajectory that rests.

        z' = a - B z with a and B of the trajectory alone; they follow from the rates at z = 0 and at each z = 1.
        """
        count, n = len(active.effect.memory), len(self.course.times)
        if not count:
            return []
        assert active.effect.balance is not None  # noqa: S101 - it has a memory
        p, balance = active.effect.values(active.numbers), active.effect.balance

        def rates(*z: float) -> np.ndarray:
            """Those of the memories z, (n, count)."""
            own = balance(middle, p, tuple(np.full(n, each) for each in z))[1]
            return np.stack([np.broadcast_to(each, n) for each in own], axis=-1)

        a = rates(*(0.0,) * count)
        B = np.stack([a - rates(*unit) for unit in np.eye(count)], axis=-1)
        return list(memory_response(a, B, self.course.steps).T)


def _moved_rows(added: np.ndarray) -> slice:
    """The rows of what is added (n, k) from the first to the last in which there is something."""
    moved = np.flatnonzero(added.any(axis=1))
    return slice(moved[0], moved[-1] + 1) if len(moved) else slice(0, 0)


def linearise_record(
    predictor: RecordPredictor, variant: ModelVariant, trajectory: Trajectory | None = None
) -> LinearisedRecord:
    """A record linearised about a variant, along its trajectory where that is known already."""
    trajectory = predictor.run(variant) if trajectory is None else predictor.on_grid(trajectory)
    predictor = predictor.under_inputs_of(trajectory, variant.deviations)
    model, own = predictor.reduced(trajectory.model, variant)
    compiled = compile_derivatives(trajectory.model, MEASURED_SIGNALS)
    course = _course_of(predictor, variant, trajectory, own, compiled)
    coefficients = coefficient_course(trajectory.path, trajectory.knots, course.times)
    at = course.states, course.inputs, coefficients
    values, partials = compiled.values(*at), compiled.derivatives(*at)
    tangent = linearise_along(predictor, trajectory, course, own, compiled, partials)
    columns = trajectory.at_valve.items()
    seen = {name: predictor.apply_sensor(name, column, trajectory, variant) for name, column in columns}
    readings = {name: predictor.at_samples(column) for name, column in seen.items()}
    return LinearisedRecord(
        predictor, variant, trajectory, tangent, model, seen, readings, compiled, course, coefficients, values, partials
    )


def _course_of(
    predictor: RecordPredictor,
    variant: ModelVariant,
    trajectory: Trajectory,
    active: np.ndarray,
    compiled: CompiledDerivatives,
) -> Course:
    """The course of a trajectory: the points of the predictor's grid, but for every second one between samples where
    motion is smooth, and more in the steps over which the Jacobian of the `active` states changes much, where a flapper
    touches a nozzle, say, or friction turns.
    """
    grid, every = predictor.times, predictor.oversampling
    plain = Course(grid, predictor.inputs, trajectory.states, grid, np.arange(0, len(grid), every))
    options, steps = predictor.options.sensitivity, plain.steps
    most = int(options.most_divided * len(steps))
    if predictor.preliminary or steps[0] > 2.0 * predictor.options.predictor.grid_spacing or not most:
        return plain
    change = _changes_over_steps(plain, trajectory, active, compiled)
    fast = change > max(options.most_change, float(np.partition(change, -most - 1)[-most - 1]))
    left_out = _smooth_between_samples(predictor, plain, change)
    if not fast.any() and not left_out.any():
        return plain
    parts = np.ones(len(steps), dtype=int)
    parts[fast] = np.clip(np.ceil(change[fast] / options.most_change), 1, options.most_parts)
    on_grid = np.concatenate([[0], np.cumsum(parts)])
    times = np.interp(np.arange(on_grid[-1] + 1), on_grid, grid)  # even within each step
    new, kept = np.ones((2, len(times)), dtype=bool)
    new[on_grid], kept[on_grid[left_out]] = False, False
    states = np.empty((len(times), trajectory.states.shape[1]))
    states[on_grid] = trajectory.states
    if fast.any():
        ends = np.diff(np.concatenate([[False], fast, [False]]).astype(int))
        first, last = np.flatnonzero(ends == 1), np.flatnonzero(ends == -1)
        states[new] = predictor.states_between(trajectory, variant, first, last, times[new])
    samples = (np.cumsum(kept) - 1)[on_grid[plain.samples]]
    course = Course(times[kept], predictor.inputs, states[kept], grid, samples)
    return replace(course, inputs=course.between(predictor.inputs))


def _smooth_between_samples(predictor: RecordPredictor, course: Course, change: np.ndarray) -> np.ndarray:
    """Every second point of a course on the grid (n,), True, that lies between samples where motion is smooth from one
    of them to the next: the Jacobian `change`s little over steps (n-1,), and states and inputs are nearly straight from
    neighbour to neighbour. Steps of twice the length tell as much there; none of a grid that is coarser than asked for.
    """
    options, every = predictor.options.sensitivity, predictor.oversampling
    if course.times[1] > predictor.options.predictor.grid_spacing:
        return np.zeros(len(course.times), dtype=bool)
    second = np.arange(len(course.times)) % every % 2 == 1
    rough = np.zeros(len(course.times), dtype=bool)
    rough[1:-1] = np.maximum(change[1:], change[:-1]) > options.smooth_change
    for moved in (course.states, np.delete(course.inputs, 1, axis=1)):  # the rate of a command jumps at its corners
        off_chord = np.abs(moved[1:-1] - (moved[2:] + moved[:-2]) / 2.0)
        rough[1:-1] |= np.any(off_chord > options.smooth_chord_deviation * np.ptp(moved, axis=0), axis=1)
    return second & ~maximum_filter1d(rough & second, 2 * every + 1)


def _changes_over_steps(
    course: Course, trajectory: Trajectory, active: np.ndarray, compiled: CompiledDerivatives
) -> np.ndarray:
    """How much the Jacobian of the `active` states changes over the steps (n-1,) of a trajectory's course, times these:
    from its ends to its middle.
    """

    def at(points: Course) -> tuple[np.ndarray, np.ndarray, CoefficientCourse]:
        return points.states, points.inputs, coefficient_course(trajectory.path, trajectory.knots, points.times)

    middle = course.midpoints(compiled.values(*at(course))[compiled.states].T)
    ends, between = compiled.jacobian(*at(course)), compiled.jacobian(*at(middle))
    changes = [change_of_jacobian(trajectory, compiled, active, end, between) for end in (ends[:, :-1], ends[:, 1:])]
    return course.steps * np.maximum(*changes)
