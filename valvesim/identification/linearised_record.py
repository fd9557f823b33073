"""A record linearised about the trajectory of one model: sensitivities of its readings by tangent equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.channels import Signals
from valvesim.identification.predictor import ModelVariant, RecordPredictor, Trajectory, batch_of
from valvesim.identification.prior import ToleratedSensorError, ToleratedTimeError
from valvesim.identification.tangent_linear import TangentLinear, first_order_response, linearise_along
from valvesim.valve.effect import ActiveEffect, Reading
from valvesim.valve.thermal_network import TemperaturePath, joint_path
from valvesim.valve.valve_model import ValveModel

SIGNAL_NAMES = Signals._fields


@dataclass(frozen=True)
class LinearisedRecord:
    """A record linearised about the trajectory of one variant: its readings, and the tangent equations.

    `model` has the effects of the variant alone, in the order of the trajectory's; `along` (n or 1,) each are its flat
    coefficients on the grid, `rates` and `signals` its own.
    """

    predictor: RecordPredictor
    variant: ModelVariant
    trajectory: Trajectory
    tangent: TangentLinear
    model: ValveModel
    readings: dict[str, np.ndarray]
    along: tuple
    rates: tuple
    signals: Any

    def residual(self) -> dict[str, np.ndarray]:
        """Measured minus predicted, (n_samples,) by channel."""
        return {name: self.predictor.record.values[name] - read for name, read in self.readings.items()}

    def simulated_difference(self, variant: ModelVariant) -> dict[str, np.ndarray]:
        """Readings of a variant less those of this one, (n_samples,) by channel, by simulation."""
        read = self.predictor.readings(self.predictor.run(variant), variant)
        return {name: read[name] - own for name, own in self.readings.items()}

    def linear_difference(self, variants: Sequence[ModelVariant]) -> dict[str, np.ndarray]:
        """The same for several variants by the linearised equations, (n_samples, k): to first order in what they
        change.

        A variant has this linearised record's effects, then at most one more.
        """
        samples = len(self.predictor.record.time)
        out = {name: np.empty((samples, len(variants))) for name in self.readings}
        chunk = max(int(self.predictor.options.sensitivity.forcing_bytes / self.tangent.A[:, 0].nbytes), 1)
        for start in range(0, len(variants), chunk):
            moved = self.forced_response(*self._forcings(variants[start : start + chunk]))
            for name, columns in moved.items():
                out[name][:, start : start + chunk] = columns
        return out

    def forced_response(self, forcing: np.ndarray, direct: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The response (n_samples, k) of the readings to forcings (n, s, k) of the scaled rates and direct parts (n,
        k).
        """
        response = self.tangent.response(forcing)
        out = {}
        for name, own in self.trajectory.at_valve.items():
            plain, late = self.predictor.lags.get(name, 0.0) <= 0.0 and not self._altered(name), self._time_errors(name)
            if plain and not late:
                out[name] = self.tangent.channel(name, response, direct.get(name), self.predictor.oversampling)
                continue
            moved = self.tangent.channel(name, response, direct.get(name))
            if plain:
                out[name] = _read_at(self.predictor.times, moved, self._read_times(late))
                continue
            faults = tuple(a for a in self.variant.effects if not isinstance(a.effect, ToleratedSensorError))
            variant = replace(self.variant, effects=(*faults, *late))
            own = own[
                :: self.predictor.sensor_oversampling
            ]  # coarse for the sensor's corners: they are in both and cancel
            nominal = self.predictor.apply_sensors({name: own}, self.trajectory, variant)[name]
            out[name] = (
                self.predictor.apply_sensors({name: own[:, None] + moved}, self.trajectory, variant)[name]
                - nominal[:, None]
            )
        return out

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
        """The times (n_samples,) at which a channel with such errors is read: what it would read of a clock."""
        times = self.predictor.times
        clock, oil = times, self.trajectory.oil[:: self.predictor.sensor_oversampling]
        for active in late:
            assert active.effect.reading is not None  # noqa: S101 - it errs in what it reads
            clock = active.effect.reading(Reading(times, clock, oil), active.values)
        return clock[:: self.predictor.oversampling]

    def argument(self, variable: Any, states: tuple) -> np.ndarray:
        """A variable of a term (n,) along the trajectory."""
        return np.asarray(variable.along(self.model, states, tuple(self.predictor.inputs.T)))

    def _forcings(self, variants: Sequence[ModelVariant]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """`forcing` of several variants, (n, s, k) and (n, k) by signal; those of other valves go together."""
        n, k = len(self.predictor.times), len(variants)
        g = np.empty((n, len(self.tangent.scale), k))
        direct = {name: np.empty((n, k)) for name in self.trajectory.at_valve if name in SIGNAL_NAMES}
        for group in self._batches(variants):
            batch = variants[group[0]] if len(group) == 1 else batch_of([variants[j] for j in group])
            path = None if len(group) == 1 else self._joint_path([variants[j] for j in group])
            rates, signals = self.forcing(batch, path)
            together = group[-1] - group[0] == len(group) - 1
            at = slice(group[0], group[-1] + 1) if together else group  # a list takes six times as long
            g[:, :, at] = rates.reshape(n, len(self.tangent.scale), -1)  # one where none of them acts
            for name, part in signals.items():
                direct[name][:, at] = part.reshape(n, -1)
        return g, direct

    def _batches(self, variants: Sequence[ModelVariant]) -> list[list[int]]:
        """The indices of variants that are worked out together: of valves or of networks that differ alone."""
        own, batches = self.variant, list[list[int]]()
        own_knots = any(active.effect.temperatures is not None for active in own.effects)
        size = max(self.predictor.options.sensitivity.batch_values // len(self.predictor.times), 1)
        alone = set(range(len(variants)))
        for alike in (
            [j for j, one in enumerate(variants) if replace(one, valve=own.valve) == own],
            [j for j, one in enumerate(variants) if not own_knots and replace(one, network=own.network) == own != one],
        ):
            alone -= set(alike)
            batches += [alike[start : start + size] for start in range(0, len(alike), size)]
        return [*batches, *([j] for j in sorted(alone))]

    def _joint_path(self, variants: Sequence[ModelVariant]) -> TemperaturePath | None:
        """The temperatures (batch, m) of variants whose networks differ; None where these are the trajectory's."""
        if all(one.network == self.variant.network for one in variants):
            return None
        return joint_path([self.predictor.temperatures(one) for one in variants])

    def forcing(
        self, variant: ModelVariant, path: TemperaturePath | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(scaled rates (n, s), direct parts (n,) by signal) that a variant adds along this trajectory.

        A variant whose valve is a batch (batch, 1), or with a `path` of temperatures (batch, m), adds (n, s, batch) and
        (n, batch).
        """
        if self._has_other_inputs_alone(variant):
            return self._forcing_of_inputs(variant)
        added = self.predictor.added_inputs(variant.deviations, self.variant.deviations)
        inputs = tuple((self.predictor.inputs if added is None else self.predictor.inputs + added).T)
        n = len(self.predictor.times)
        own = {effect.name for effect in self.model.effects}
        more = [a for a in variant.effects if a.effect.balance is not None and a.effect.name not in own]
        model = self.model.with_effects((*self.model.effects, *(a.effect for a in more)))
        if path is None and self.predictor.same_temperatures(variant, self.variant):
            path = self.trajectory.path
        along = self.predictor.coefficients_along(variant, model, path=path)
        states = [self.trajectory.states[:, k] for k in self.tangent.active]
        for active in more:
            states += self._memory_trajectories(active, tuple(states), along)
        dimensions = along[0].ndim

        def column(values: Any) -> np.ndarray:
            """(n,), or (n, 1) beside a batch."""
            return np.asarray(values).reshape(-1, *(1,) * (dimensions - 1))

        rates, signals = model.evaluate(tuple(map(column, states)), tuple(map(column, inputs)), along)
        shape = (n, *np.broadcast_shapes(*(part.shape[1:] for part in along)))
        g = np.empty((n, len(self.rates), *shape[1:]))
        for k, (new, old) in enumerate(zip(rates, self.rates, strict=False)):
            g[:, k] = (new - column(old)) / self.tangent.scale[k]
        direct = {
            name: np.broadcast_to(getattr(signals, name) - column(getattr(self.signals, name)), shape)
            for name in self.trajectory.at_valve
            if name in SIGNAL_NAMES
        }
        return g, direct

    def _has_other_inputs_alone(self, variant: ModelVariant) -> bool:
        if variant.deviations == self.variant.deviations:  # as those of a batch of valves are
            return False
        same = replace(variant, deviations=self.variant.deviations) == self.variant
        return same and self.predictor.same_temperatures(variant, self.variant)

    def _forcing_of_inputs(self, variant: ModelVariant) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """`forcing` of a variant that differs in its command and pressures alone, worked out where these differ."""
        n = len(self.predictor.times)
        g = np.zeros((n, len(self.rates)))
        direct = {name: np.zeros(n) for name in self.trajectory.at_valve if name in SIGNAL_NAMES}
        added = self.predictor.added_inputs(variant.deviations, self.variant.deviations)
        if added is None:
            return g, direct
        rows = np.flatnonzero(added.any(axis=1))
        along = tuple(column if len(column) == 1 else column[rows] for column in self.along)
        states = self.trajectory.states[np.ix_(rows, self.tangent.active)]
        inputs = self.predictor.inputs[rows] + added[rows]
        rates, signals = self.model.evaluate(tuple(states.T), tuple(inputs.T), along)
        for k, (new, old) in enumerate(zip(rates, self.rates, strict=True)):
            g[rows, k] = (new - _at(old, rows)) / self.tangent.scale[k]
        for name, column in direct.items():
            column[rows] = getattr(signals, name) - _at(getattr(self.signals, name), rows)
        return g, direct

    def _memory_trajectories(self, active: ActiveEffect, states: tuple, along: tuple) -> list[np.ndarray]:
        """The memories (n,) of an effect along the trajectory: each linear in itself, so exact for a trajectory that
        rests.

        z' = a - b z with a and b of the trajectory alone; both follow from the rates at z = 0 and z = 1.
        """
        count = len(active.effect.memory)
        if not count:
            return []
        first = slice(0, self.model.memory_states.start)

        def middle(values: np.ndarray, rest: float | None = None) -> np.ndarray:
            """The value at rest, then those in the middle of the steps."""
            return np.concatenate([[values[0] if rest is None else rest], (values[1:] + values[:-1]) / 2.0])

        mid = tuple(middle(x) for x in states[first])
        inputs = tuple(middle(u, 0.0 if k == 1 else None) for k, u in enumerate(self.predictor.inputs.T))
        c = tuple(middle(v) if len(v) > 1 else v for v in self.model.valve_coefficients(along))
        model = self.model.with_effects((active.effect,))
        flat = (*c, *active.numbers)
        at_0, at_1 = (model.rhs((*mid, *(np.full(len(mid[0]), z),) * count), inputs, flat)[-count:] for z in (0.0, 1.0))
        h = float(self.predictor.times[1] - self.predictor.times[0])
        memories = []
        for zero, one in zip(at_0, at_1, strict=True):
            a, b = np.broadcast_to(zero, mid[0].shape), np.broadcast_to(zero - one, mid[0].shape)
            memories.append(first_order_response(a, b, h))
        return memories


def _read_at(times: np.ndarray, columns: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Columns (n, k) on an even grid at other times (m,), by cubics through the four points about each (Lagrange)."""
    first = np.clip(np.searchsorted(times, at, "right") - 2, 0, len(times) - 4)
    s = (at - times[first]) / (times[1] - times[0])
    found = np.zeros((len(at), columns.shape[1]))
    for j in range(4):
        others = [i for i in range(4) if i != j]
        weight = np.prod([(s - i) / (j - i) for i in others], axis=0)
        found += weight[:, None] * columns[first + j]
    return found


def _at(values: Any, rows: np.ndarray) -> Any:
    """A quantity along the trajectory at some rows of the grid; a constant as it is."""
    return values[rows] if np.ndim(values) and len(values) > 1 else values


def linearise_record(
    predictor: RecordPredictor, variant: ModelVariant, trajectory: Trajectory | None = None
) -> LinearisedRecord:
    """A record linearised about a variant, along its trajectory where that is known already."""
    trajectory = predictor.run(variant) if trajectory is None else predictor.on_grid(trajectory)
    predictor = predictor.under(variant.deviations)
    model, own = predictor.reduced(trajectory.model, variant)
    along = predictor.coefficients_along(variant, model, path=trajectory.path)
    tangent = linearise_along(predictor, trajectory, own, model, along)
    rates, signals = model.evaluate(tuple(trajectory.states[:, own].T), tuple(predictor.inputs.T), along)
    readings = predictor.readings(trajectory, variant)
    return LinearisedRecord(predictor, variant, trajectory, tangent, model, readings, along, rates, signals)
