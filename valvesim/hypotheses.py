"""What may be wrong: the candidates, the base parameters with their tolerances, and what each shows in each record.

A candidate is a catalogue effect (on either side, on each sensor, with its shape parameters at a few values), a user's
effect, or a nominal parameter beyond its tolerance. The base parameters are all quantities of the valve that have a
tolerance, as normal about their nominal value with the tolerance at two standard deviations, and each sensor's small
offset and gain error. They are refitted silently; what they can explain is no evidence for anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from .catalogue import CATALOGUE
from .channels import STATE_CHANNELS, Signals, State
from .effects import ActiveEffect, Effect
from .errors import InputError
from .model import AT_20, Model
from .parameters import Coefficients, Valve
from .prediction import Bench, Course, Variant
from .sensitivity import Linearised, linearise, relax
from .session import Session
from .units import quantities

SENSOR_BIAS, SENSOR_GAIN = 2e-3, 4e-3  # tolerances that every sensor has: shares of its channel's span, and of gain,
SENSOR_DELAY = 1e-4  # and s of its electronics and the logger's clock
SHORT_LAG = 5e-5  # s: that of an amplifier of 3 kHz, such as a sensor may have: a shorter one is hardly a fault
NEAR = 0.01  # prior deviations by which a parameter is moved: where many trade off, answers must hold to a thousandth
FAST = ("armature_inertia", "armature_damping")  # they act within a rough grid's step: on the way they are held
RUN = ("armature_inertia",)  # it acts within a fine grid's step too: it is run, moved by more
FAR = 0.3
LEAST = 0.01  # of its nominal value a quantity that cannot be negative keeps: the equations divide by some
LARGEST = 1.5e8  # bytes of forcings that are solved for at once
AT_ONCE = 65_536  # values of one quantity along a course for a batch of valves: they stay in the cache
SIGNAL_NAMES = Signals._fields
SHAPES: dict[str, dict[str, tuple[float, ...]]] = {  # shape parameters at which an effect is looked for
    "fixed_orifice_clogging": {"side": (1.0, 2.0)},
    "nozzle_erosion": {"side": (1.0, 2.0)},
    "eddy_current_lag": {"time_constant": (5e-4, 2e-3, 2e-2)},
    "magnetic_hysteresis": {"turning_current": (1e-3, 4e-3)},
}
BEYOND = 5.0  # times the longest record: a time that is typical of what hardly moves in it
WHOLE = ("side",)  # shape parameters that are not fitted


@dataclass(frozen=True)
class BaseParameter:
    """A quantity that is uncertain within a tolerance: of the valve, or the offset or gain of a sensor."""

    name: str
    unit: str
    nominal: float
    deviation: float
    bounds: tuple[float, float]
    sensor: Effect | None = None


@dataclass(frozen=True)
class Base:
    """The model of session.toml with its base parameters; a point is given in prior standard deviations (p,)."""

    variant: Variant
    parameters: tuple[BaseParameter, ...]

    def at(self, point: np.ndarray) -> Variant:
        """The variant at a point, held within the bounds of each quantity, and off zero where it is positive."""
        figures: dict[str, Any] = {}
        sensors = []
        for parameter, where in zip(self.parameters, point, strict=True):
            low, high = parameter.bounds
            low = max(low, LEAST * parameter.nominal) if low >= 0.0 else low
            value = float(np.clip(parameter.nominal + where * parameter.deviation, low, high))
            if parameter.sensor is None:
                figures[parameter.name] = value
            elif where != 0.0:
                sensors.append(parameter.sensor(**{parameter.sensor.amplitude.name: value}))
        return Variant(replace(self.variant.valve, **figures), (*self.variant.effects, *sensors))


def base_of(session: Session) -> Base:
    """The base of a session: quantities of its valve with a tolerance, and the sensors' small errors."""
    parameters = []
    for name, declared in quantities(Valve).items():
        nominal, tolerance = float(getattr(session.valve, name)), float(declared.metadata["tolerance"])
        width = session.tolerances.get(name, tolerance * abs(nominal) if declared.default != 0.0 else tolerance)
        if width > 0.0:
            low, high = declared.metadata["bounds"]
            parameters.append(BaseParameter(name, declared.metadata["unit"], nominal, width / 2.0, (low, high)))
    for channel in measured(session):
        span = _span(session, channel)
        for name, tolerance in (
            ("sensor_bias", SENSOR_BIAS * span), ("sensor_gain", SENSOR_GAIN), ("sensor_delay", SENSOR_DELAY)
        ):  # fmt: skip
            effect = _either_way(CATALOGUE[name].on(channel))
            amplitude = effect.amplitude
            parameters.append(
                BaseParameter(f"{name}@{channel}", amplitude.unit, 0.0, tolerance / 2.0, amplitude.bounds, effect)
            )
    return Base(Variant(session.valve, session.effects), tuple(parameters))


class SmallError(Effect):
    """A sensor's error within its tolerance: a base parameter, not a fault."""


def _either_way(effect: Effect) -> Effect:
    """The effect with an amplitude that may go below neutral as far as above: a clock may also be early."""
    amplitude = effect.amplitude
    wide = replace(amplitude, bounds=(-amplitude.bounds[1], amplitude.bounds[1]))
    parameters = tuple(wide if p is amplitude else p for p in effect.parameters)
    return SmallError(**{**{f.name: getattr(effect, f.name) for f in fields(effect)}, "parameters": parameters})


def measured(session: Session) -> tuple[str, ...]:
    """The output channels of the session, in order of appearance."""
    return tuple(dict.fromkeys(name for record in session.records for name in record.outputs))


def _span(session: Session, channel: str) -> float:
    values = [record.values[channel] for record in session.records if channel in record.outputs]
    return float(max(np.ptp(v) for v in values))


@dataclass(frozen=True)
class Candidate:
    """One thing that may be wrong. `fixed` are the shape parameters at which it is looked for.

    `twin` is the base parameter that an effect moves, all but alone, see `rate_at`: the base fit stretches it where the
    effect is there.
    """

    name: str
    effect: Effect | None = None
    fixed: tuple[tuple[str, float], ...] = ()
    parameter: BaseParameter | None = None
    twin: BaseParameter | None = None

    @property
    def key(self) -> str:
        """A text that no other candidate has."""
        at = f"@{self.effect.channel}" if self.effect is not None and self.effect.channel else ""
        pace = f"~{self.typical:g} s" if self.effect is not None and self.unit == "s" else ""
        return self.name + at + "".join(f"[{name}={value:g}]" for name, value in self.fixed) + pace

    @property
    def family(self) -> str:
        """The key without what is fitted anyway: candidates of one family are one answer."""
        at = f"@{self.effect.channel}" if self.effect is not None and self.effect.channel else ""
        return self.name + at + "".join(f"[{name}={value:g}]" for name, value in self.fixed if name in WHOLE)

    @property
    def one_sided(self) -> bool:
        """True where only amplitudes above neutral make sense."""
        if self.effect is None:
            return False
        return self.effect.amplitude.bounds[0] >= (self.effect.amplitude.neutral or 0.0)

    def excludes(self, other: Candidate) -> bool:
        """True for another shape or side of the same effect: its name may stand in a model only once."""
        return (
            self.effect is not None
            and other.effect is not None
            and (self.effect.name, self.effect.channel) == (other.effect.name, other.effect.channel)
        )

    def is_same_as(self, other: Candidate) -> bool:
        """True for an effect and the quantity of the valve that it changes: two names of one thing."""
        figures = {each.effect.figure for each in (self, other) if each.effect is not None}
        return any(each.parameter is not None and each.parameter.name in figures for each in (self, other))

    @property
    def unit(self) -> str:
        """Of the amplitude."""
        return self.effect.amplitude.unit if self.effect is not None else self._parameter.unit

    @property
    def typical(self) -> float:
        """An amplitude that makes sense, above neutral (SI): where the search starts, and the width of its prior."""
        if self.effect is None:
            return 4.0 * self._parameter.deviation
        amplitude = self.effect.amplitude
        if amplitude.typical is None:  # a user's effect may leave it out
            return 0.05 * max(map(abs, self.limits))
        return abs(float(amplitude.typical) - float(amplitude.neutral or 0.0))

    @property
    def limits(self) -> tuple[float, float]:
        """Of the excess over neutral."""
        if self.effect is None:
            p = self._parameter
            return p.bounds[0] - p.nominal, p.bounds[1] - p.nominal
        neutral = self.effect.amplitude.neutral or 0.0
        return self.effect.amplitude.bounds[0] - neutral, self.effect.amplitude.bounds[1] - neutral

    @property
    def _parameter(self) -> BaseParameter:
        if self.parameter is None:
            raise InputError(f"candidate {self.name} is neither an effect nor a parameter")
        return self.parameter

    def is_common(self, excess: float) -> bool:
        """Whether a sensor that nobody would call faulty may have so little of this fault."""
        return self.effect is not None and bool(self.effect.channel) and self.unit == "s" and excess < SHORT_LAG

    def location(self) -> str:
        """The balance or sensor where it acts."""
        if self.effect is None:
            return "valve parameter"
        return f"sensor of {self.effect.channel}" if self.effect.channel else self.effect.location

    def active(self, excess: float, **shapes: float) -> ActiveEffect:
        """The effect at an amplitude of neutral + excess. For a parameter there is none (InputError)."""
        if self.effect is None:
            raise InputError(f"candidate {self.name} is a parameter, not an effect")
        amplitude = self.effect.amplitude
        numbers = {**dict(self.fixed), **shapes, amplitude.name: (amplitude.neutral or 0.0) + excess}
        bounds = {p.name: p.bounds for p in self.effect.parameters}
        return self.effect(**{name: float(np.clip(value, *bounds[name])) for name, value in numbers.items()})

    def add_to(self, variant: Variant, excess: float, **shapes: float) -> Variant:
        """The variant with this candidate at an excess over neutral, within its bounds."""
        if self.effect is not None:
            return variant.with_effect(self.active(excess, **shapes))
        p = self._parameter
        value: Any = float(np.clip(getattr(variant.valve, p.name) + excess, *p.bounds))
        return replace(variant, valve=replace(variant.valve, **{p.name: value}))

    def share(self, variant: Variant, other: Variant) -> tuple[BaseParameter, float] | None:
        """The base parameter that tells a variant from another, but for this candidate alike, and by how many prior
        deviations; None where no single one does."""
        if self.parameter is not None:
            p = self.parameter
            return p, (getattr(variant.valve, p.name) - getattr(other.valve, p.name)) / p.deviation
        rate = self.rate_at(other)
        if self.twin is None or not rate:
            return None
        return self.twin, rate * (self._amplitude_in(variant) - self._amplitude_in(other))

    def rate_at(self, variant: Variant) -> float:
        """By how many prior deviations of its twin a unit more of this effect moves a variant; 0 where it moves it
        otherwise, or has no twin."""
        effect, twin, small = self.effect, self.twin, 1e-4
        if effect is None or twin is None:
            return 0.0
        if effect.channel:
            return 1.0 / twin.deviation
        if (change := effect.coefficients) is None:
            return 0.0
        valve, more = variant.valve, small * self.typical
        excess = self._amplitude_in(variant) - (effect.amplitude.neutral or 0.0)
        figure: dict[str, Any] = {twin.name: getattr(valve, twin.name) + small * twin.deviation}

        def coefficients(valve: Valve, excess: float) -> np.ndarray:
            return np.array(change(valve.at(AT_20), self.active(excess).values, AT_20), dtype=float)

        before = coefficients(valve, excess)
        by_effect = coefficients(valve, excess + more) - before
        by_figure = coefficients(replace(valve, **figure), excess) - before
        acts = by_figure != 0.0
        if not acts.any():
            return 0.0
        ratio = float(np.median(by_effect[acts] / by_figure[acts]))
        alike = np.abs(by_effect - ratio * by_figure) <= 0.01 * np.abs(ratio * by_figure)
        return ratio * small / more if alike.all() else 0.0

    def _amplitude_in(self, variant: Variant) -> float:
        assert self.effect is not None  # noqa: S101 - only effects have twins
        amplitude = self.effect.amplitude
        own = [
            float(getattr(active.values, amplitude.name))
            for active in variant.effects
            if (active.effect.name, active.effect.channel) == (self.effect.name, self.effect.channel)
            and not isinstance(active.effect, SmallError)
        ]
        # a sensor's error that the session states may have more of the same beside it
        return sum(own) - (len(own) - 1) * float(amplitude.neutral or 0.0)

    def shapes(self) -> tuple[Any, ...]:
        """The shape parameters that can be fitted."""
        if self.effect is None:
            return ()
        return tuple(p for p in self.effect.parameters if p.neutral is None and p.name not in WHOLE)


def candidates_of(session: Session, base: Base) -> tuple[Candidate, ...]:
    """Everything that is looked for in a session."""
    known = {active.effect.name for active in session.effects}
    found = []
    for effect in (*CATALOGUE.values(), *session.user_effects):
        if effect.reading is not None:
            for channel in measured(session):
                found += [Candidate(effect.name, one) for one in _paced(effect.on(channel), session)]
            continue
        if effect.name in known:
            continue
        shapes = SHAPES.get(effect.name, {})
        combinations: list[tuple[tuple[str, float], ...]] = [()]
        for name, values in shapes.items():
            combinations = [(*one, (name, value)) for one in combinations for value in values]
        found += [Candidate(effect.name, one, fixed) for fixed in combinations for one in _paced(effect, session)]
    found = [_with_twin(candidate, base) for candidate in found]
    found += [Candidate(f"parameter:{p.name}", parameter=p) for p in base.parameters if p.sensor is None]
    return tuple(found)


def _with_twin(candidate: Candidate, base: Base) -> Candidate:
    """The candidate with the base parameter that does the same: a sensor's small error, or the figure of an effect."""
    effect = candidate.effect
    assert effect is not None  # noqa: S101 - the caller has chosen effects
    name = f"{effect.name}@{effect.channel}" if effect.channel else effect.figure
    paired = replace(candidate, twin=next((p for p in base.parameters if p.name == name), None))
    return paired if paired.rate_at(base.variant) else candidate


def _paced(effect: Effect, session: Session) -> tuple[Effect, ...]:
    """An effect whose amplitude is a time: looked for at one that the records can tell from none and from endless.

    That is no shorter than a sample of the slowest record, and no longer than a quarter of the longest. Where it is
    usually longer than that record, it is looked for beyond its end as well: there it shows something else.
    """
    amplitude = effect.amplitude
    if amplitude.unit != "s" or amplitude.typical is None:
        return (effect,)
    slowest = max(1.0 / record.rate for record in session.records)
    longest = max(float(record.time[-1] - record.time[0]) for record in session.records)
    times = [min(max(amplitude.typical, slowest), max(0.25 * longest, slowest))]
    if amplitude.typical > longest:
        times.append(BEYOND * longest)

    def at(time: float) -> Effect:
        paced = replace(amplitude, typical=min(time, amplitude.bounds[1]))
        return replace(effect, parameters=tuple(paced if p is amplitude else p for p in effect.parameters))

    return tuple(map(at, times))


# ---------------------------------------------------------------- what each shows


@dataclass(frozen=True)
class View:
    """A record seen from one variant: what its sensors read, and the linear equations about its course.

    `model` has the effects of the variant alone, in the order of the course's; `rates` and `signals` are its own.
    """

    bench: Bench
    variant: Variant
    course: Course
    linear: Linearised
    model: Model
    readings: dict[str, np.ndarray]
    rates: tuple
    signals: Any

    def residual(self) -> dict[str, np.ndarray]:
        """Measured minus predicted, (n_samples,) by channel."""
        return {name: self.bench.record.values[name] - read for name, read in self.readings.items()}

    def by_run(self, variant: Variant) -> dict[str, np.ndarray]:
        """What a variant reads more than this view's does, (n_samples,) by channel, by running it."""
        read = self.bench.readings(self.bench.run(variant), variant)
        return {name: read[name] - own for name, own in self.readings.items()}

    def by_answer(self, variants: Sequence[Variant]) -> dict[str, np.ndarray]:
        """The same for several variants by the linear equations, (n_samples, k): to first order in what they change.

        A variant has this view's effects, then at most one more.
        """
        samples = len(self.bench.record.time)
        out = {name: np.empty((samples, len(variants))) for name in self.readings}
        chunk = max(int(LARGEST / self.linear.A[:, 0].nbytes), 1)
        for start in range(0, len(variants), chunk):
            moved = self.by_forcing(*self._forcings(variants[start : start + chunk]))
            for name, columns in moved.items():
                out[name][:, start : start + chunk] = columns
        return out

    def by_forcing(self, forcing: np.ndarray, direct: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The readings' answer (n_samples, k) to forcings (n, s, k) of the scaled rates and to direct parts (n, k)."""
        answers = self.linear.respond(forcing)
        out = {}
        for name, own in self.course.at_valve.items():
            if self.bench.lags.get(name, 0.0) <= 0.0 and not self._altered(name):
                out[name] = self.linear.channel(name, answers, direct.get(name), self.bench.refinement)
                continue
            moved = self.linear.channel(name, answers, direct.get(name))
            faults = tuple(a for a in self.variant.effects if not isinstance(a.effect, SmallError))
            variant = replace(self.variant, effects=faults)
            own = own[:: self.bench.finer]  # coarse for the sensor's corners: they are in both and cancel
            base = self.bench.sensed({name: own}, self.course, variant)[name]
            out[name] = self.bench.sensed({name: own[:, None] + moved}, self.course, variant)[name] - base[:, None]
        return out

    def _altered(self, channel: str) -> bool:
        """Whether a sensor fault changes answers of a channel; its small errors within tolerance do not matter."""
        return any(a.effect.channel == channel and not isinstance(a.effect, SmallError) for a in self.variant.effects)

    def argument(self, variable: Any, states: tuple) -> np.ndarray:
        """A variable of a term (n,) along the course."""
        memory = self.model.drive.memory
        current = states[len(STATE_CHANNELS)] if memory else self.bench.inputs[:, 0]
        return np.asarray(variable.of(State(*states[: len(STATE_CHANNELS)]), current))

    def _forcings(self, variants: Sequence[Variant]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """`forcing` of several variants, (n, s, k) and (n, k) by signal; those of other valves go together."""
        n, k = len(self.bench.times), len(variants)
        alike = [j for j, variant in enumerate(variants) if variant.effects == self.variant.effects]
        g = np.empty((n, len(self.linear.scale), k))
        direct = {name: np.empty((n, k)) for name in self.course.at_valve if name in SIGNAL_NAMES}
        size = max(AT_ONCE // n, 1)
        for group in [
            *(alike[start : start + size] for start in range(0, len(alike), size)),
            *([j] for j in range(k) if j not in alike),
        ]:
            first = variants[group[0]]
            batch = first if len(group) == 1 else replace(first, valve=_batch([variants[j].valve for j in group]))
            rates, signals = self.forcing(batch)
            together = group[-1] - group[0] == len(group) - 1
            at = slice(group[0], group[-1] + 1) if together else group  # a list takes six times as long
            g[:, :, at] = rates.reshape(n, -1, len(group))
            for name, part in signals.items():
                direct[name][:, at] = part.reshape(n, -1)
        return g, direct

    def forcing(self, variant: Variant) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(scaled rates (n, s), direct parts (n,) by signal) that a variant adds along this course.

        A variant whose valve is a batch (batch, 1) adds (n, s, batch) and (n, batch).
        """
        n, inputs = len(self.bench.times), tuple(self.bench.inputs.T)
        own = {effect.name for effect in self.model.effects}
        more = [a for a in variant.effects if a.effect.balance is not None and a.effect.name not in own]
        model = Model(self.model.drive, (*self.model.effects, *(a.effect for a in more)))
        along = self.bench.coefficients_along(variant, model)
        states = [self.course.states[:, k] for k in self.linear.active]
        for active in more:
            states += self._remembered(active, tuple(states), along)
        dimensions = along[0].ndim

        def column(values: Any) -> np.ndarray:
            """(n,), or (n, 1) beside a batch."""
            return np.asarray(values).reshape(-1, *(1,) * (dimensions - 1))

        rates, signals = model.evaluate(tuple(map(column, states)), tuple(map(column, inputs)), along)
        shape = (n, *np.broadcast_shapes(*(part.shape[1:] for part in along)))
        g = np.empty((n, len(self.rates), *shape[1:]))
        for k, (new, old) in enumerate(zip(rates, self.rates, strict=False)):
            g[:, k] = (new - column(old)) / self.linear.scale[k]
        direct = {
            name: np.broadcast_to(getattr(signals, name) - column(getattr(self.signals, name)), shape)
            for name in self.course.at_valve
            if name in SIGNAL_NAMES
        }
        return g, direct

    def _remembered(self, active: ActiveEffect, states: tuple, along: tuple) -> list[np.ndarray]:
        """The memories (n,) of an effect along the course: each linear in itself, so exact for a course that rests.

        z' = a - b z with a and b of the course alone; both follow from the rates at z = 0 and z = 1.
        """
        count = len(active.effect.memory)
        if not count:
            return []
        first = slice(0, len(STATE_CHANNELS) + len(self.model.drive.memory))

        def middle(values: np.ndarray, rest: float | None = None) -> np.ndarray:
            """The value at rest, then those in the middle of the steps."""
            return np.concatenate([[values[0] if rest is None else rest], (values[1:] + values[:-1]) / 2.0])

        mid = tuple(middle(x) for x in states[first])
        inputs = tuple(middle(u, 0.0 if k == 1 else None) for k, u in enumerate(self.bench.inputs.T))
        c = tuple(middle(v) if len(v) > 1 else v for v in along[: len(Coefficients._fields)])
        model = Model(self.model.drive, (active.effect,))
        flat = (*c, *active.numbers)
        at_0, at_1 = (model.rhs((*mid, *(np.full(len(mid[0]), z),) * count), inputs, flat)[-count:] for z in (0.0, 1.0))
        h = float(self.bench.times[1] - self.bench.times[0])
        memories = []
        for zero, one in zip(at_0, at_1, strict=True):
            a, b = np.broadcast_to(zero, mid[0].shape), np.broadcast_to(zero - one, mid[0].shape)
            memories.append(relax(a, b, h))
        return memories


def _batch(valves: Sequence[Valve]) -> Valve:
    """One valve whose quantities are (k, 1) where those of the valves differ."""
    first, differing = valves[0], dict[str, Any]()
    for name in quantities(Valve):
        values = [getattr(valve, name) for valve in valves]
        if any(value != values[0] for value in values):
            differing[name] = np.array(values)[:, None]
    return replace(first, **differing)


def view(bench: Bench, variant: Variant, course: Course | None = None) -> View:
    """A record seen from a variant, by its course where the bench, or the same at another spacing, has run it."""
    course = bench.run(variant) if course is None else bench.gridded(course)
    model, own = bench.reduced(course.model, variant)
    along = bench.coefficients_along(variant, model)
    linear = linearise(bench, course, own, model, along)
    rates, signals = model.evaluate(tuple(course.states[:, own].T), tuple(bench.inputs.T), along)
    readings = bench.readings(course, variant)
    return View(bench, variant, course, linear, model, readings, rates, signals)


def neighbours(base: Base, variant: Variant) -> list[Variant]:
    """The variant with each base parameter of the valve moved by a little, see `_step`."""
    valve = variant.valve
    return [
        replace(variant, valve=replace(valve, **{p.name: getattr(valve, p.name) + _step(p, valve) * p.deviation}))
        for p in base.parameters
        if p.sensor is None
    ]


def _step(parameter: BaseParameter, valve: Valve) -> float:
    """By how many prior standard deviations a parameter is moved to see what it shows: down where it is at its most."""
    size = FAR if parameter.name in RUN else NEAR
    most = parameter.bounds[1]
    return size if getattr(valve, parameter.name) + size * parameter.deviation <= most else -size


def parameter_columns(seen: View, base: Base, neighbouring: Sequence[Variant]) -> dict[str, np.ndarray]:
    """Answers (n_samples, p) to one prior standard deviation of each base parameter, see `neighbours`.

    None where the bench is rough and the parameter fast: a fit that followed such answers ends in a wrong resonance.
    """
    plant, valve = [p for p in base.parameters if p.sensor is None], seen.variant.valve
    held = FAST if seen.bench.rough else ()
    slow = [k for k, p in enumerate(plant) if p.name not in (*RUN, *held)]
    moved = seen.by_answer([neighbouring[k] for k in slow])
    pairs = zip(plant, neighbouring, strict=True)
    run = {p.name: seen.by_run(variant) for p, variant in pairs if p.name in RUN and p.name not in held}
    out = {}
    for name, read in seen.readings.items():
        answered = dict(zip((plant[k].name for k in slow), moved[name].T, strict=True))
        columns = []
        for p in base.parameters:
            if p.name in held or (p.sensor is not None and p.sensor.channel != name):
                columns.append(np.zeros_like(read))
            elif p.sensor is None:
                columns.append((run[p.name][name] if p.name in run else answered[p.name]) / _step(p, valve))
            else:
                columns.append(_sensor_slope(seen, p, name) * p.deviation)
        out[name] = np.column_stack(columns)
    return out


def _sensor_slope(seen: View, parameter: BaseParameter, channel: str) -> np.ndarray:
    """Slope (n_samples,) of a reading over a sensor's small error, by a step much shorter than its deviation."""
    assert parameter.sensor is not None  # noqa: S101 - the caller has chosen those with a sensor
    step, name = 0.1 * parameter.deviation, parameter.sensor.amplitude.name
    at_valve = {channel: seen.course.at_valve[channel]}
    high, low = (
        seen.bench.sensed(at_valve, seen.course, seen.variant.with_effect(parameter.sensor(**{name: by})))[channel]
        for by in (step, -step)
    )
    return (high - low) / (2.0 * step)


def candidate_columns(
    seen: View,
    candidates: Sequence[Candidate],
    changed: Sequence[Variant],
    base: Base,
    known: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Answers (n_samples, q) to each candidate, whose variant at its size is `changed`.

    What a base parameter does within its tolerance it does beyond it, and so does an effect that is the same thing:
    their answers are a share of the `known` ones, see `parameter_columns`.
    """
    out = {name: np.zeros((len(seen.bench.record.time), len(candidates))) for name in seen.readings}
    quick, places = [], {p.name: j for j, p in enumerate(base.parameters)}
    for k, (candidate, variant) in enumerate(zip(candidates, changed, strict=True)):
        effect = candidate.effect
        if (shared := candidate.share(variant, seen.variant)) is not None:
            p, share = shared
            for name in out:
                out[name][:, k] = share * known[name][:, places[p.name]]
        elif effect is None or effect.reading is None:
            quick.append(k)
        elif effect.channel in out:
            name = effect.channel
            out[name][:, k] = (
                seen.bench.sensed({name: seen.course.at_valve[name]}, seen.course, variant)[name] - seen.readings[name]
            )
    moved = seen.by_answer([changed[k] for k in quick])
    for name in out:
        out[name][:, quick] = moved[name]
    return out
