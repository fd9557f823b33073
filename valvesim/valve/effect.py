"""What an effect is that a nominal valve lacks; the entries themselves stand in `valve/effects/`.

An effect acts in one or more of four places: on the temperatures of the parts, on the coefficients, in the balances
(what it adds at which port, with states of its own as memory), or on what a sensor reads. It declares its parameters,
their bounds, and the neutral value at which it vanishes. A user's effect is an `Effect` too: pass it to `Model` or
`Scenario` like one from the catalogue.
"""

from __future__ import annotations

import functools
from collections import Counter, namedtuple
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS, STATE_CHANNELS, Channel, Inputs, State
from valvesim.errors import InputError, unknown_name
from valvesim.shown import Shown
from valvesim.units import has_unit, in_si, parse, symbol
from valvesim.valve.coefficients import Coefficients, PartTemperatures

CHANNEL = "channel"  # the unit of such a parameter is that of the channel that a sensor reads; bounds are in its scale
READABLE = {
    channel.name: channel
    for channel in (*STATE_CHANNELS, *SIGNAL_CHANNELS, Channel("body_temperature", "degC", "body", 100.0))
}
"""What a sensor can read, by name."""


class Ports(NamedTuple):
    """Where an effect may add to the equations: each is a term of the balance that its comment names."""

    coil_current: Any = 0.0  # A, magnetic circuit: added to the current that magnetises
    armature_torque: Any = 0.0  # N m, armature torque balance
    rod_deflection: Any = 0.0  # m, deflection of the feedback rod at the ball
    spool_force: Any = 0.0  # N, spool force balance
    compliance_1: Any = 0.0  # 1/Pa, chamber 1 volume balance: added to 1/bulk modulus
    compliance_2: Any = 0.0  # 1/Pa, chamber 2
    supply_pressure: Any = 0.0  # Pa, at the valve: added to the supply's in every equation
    return_pressure: Any = 0.0  # Pa, behind the nozzles: added to the return's
    load_pressure: Any = 0.0  # Pa, between the ports: added to the load's in every equation
    chamber_flow_1: Any = 0.0  # m^3/s, into chamber 1
    chamber_flow_2: Any = 0.0  # m^3/s, into chamber 2
    load_flow: Any = 0.0  # m^3/s, out of port A
    internal_leakage: Any = 0.0  # m^3/s, supply to return


class Situation(NamedTuple):
    """What an effect sees of the valve at one instant; the flows are those at the pressures of `inputs`."""

    state: State
    inputs: Inputs
    coil_current: Any
    coil_current_rate: Any
    load_flow: Any
    nozzle_flow_1: Any
    nozzle_flow_2: Any
    coefficients: Coefficients


class Reading(NamedTuple):
    """What a sensor sees: one channel over time, all arrays (n_t,)."""

    time: Any  # s
    values: Any  # in the channel's unit
    oil_temperature: Any  # °C


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A figure of an effect. The amplitude has a `neutral` value; a shape parameter (neutral None) has none.

    `typical` is an amplitude seen in service, in the same unit and within the bounds; every amplitude of the catalogue
    has one. An amplitude nearer to neutral than `ordinary` nobody would call a fault. A shape parameter is looked for
    at the values `sought` (at its default where there are none), and from there fitted, unless it is `discrete`: a
    choice of a place, such as the side.
    """

    name: str
    unit: str
    doc: str
    default: float
    bounds: tuple[float, float]
    neutral: float | None = None
    typical: float | None = None
    ordinary: float = 0.0
    sought: tuple[float, ...] = ()
    discrete: bool = False


@functools.cache
def _record(names: tuple[str, ...]) -> Any:
    return namedtuple("Values", names)  # type: ignore[misc]


@dataclass(frozen=True, kw_only=True)
class Advice:
    """What to do about an effect that was found: the part, what to inspect, how to confirm it, and the remedy."""

    part: str
    inspect: str
    confirm: str
    remedy: str


@dataclass(frozen=True, kw_only=True, repr=False)
class Effect(Shown):
    """An effect: where it acts, its parameters, and the figures at which it vanishes.

    `temperatures(times, parts, p) -> PartTemperatures` changes the temperatures of the parts over the times (m,);
    `coefficients(c, p, parts) -> Coefficients` changes coefficients;
    `balance(situation, p, memory) -> (Ports, memory rates)` adds terms;
    `reading(reading, p) -> values` changes what the sensor of `channel` gives (see `on`).
    `lag(p)` is the time constant (s) where `temperatures` or `reading` is a first-order lag of what comes in, for those
    that carry it as a state; `reads_columns` says that `reading` takes many series at once, values (n_t, k).
    All see `p`, the parameters by name in SI, and must vanish at the neutral value. At least one is given.
    `figure` names the valve's quantity that the effect changes, all but alone: that quantity off is this effect.
    `plainer` names the effect that this one is where its own feature does not show; of the two that is told first, but
    where this one is `as_common`: then what the readings say alone decides.
    `indistinguishable_from` names effects that together, in proportion, do to the readings what this one does; what it
    does besides tells them apart (to the coil's resistance, as lost turns do).
    `feature` names the coefficient, or of a sensor's effect the part of the `Reading`, whose changes are that feature:
    while it stands still, it is the plainer one.
    `advice` is what to do where it is found.
    `law_error` is the share of what the effect explains by which another law of the same thing may do better, and
    `figure_error` the share of its figures by which those of another law are other, where that is known by itself.
    `time_scale` (s) tells of what acts in the dynamics alone how soon it has done so, as `units.quantity` has it.
    """

    name: str
    doc: str
    location: str
    signature: str
    parameters: tuple[Parameter, ...]
    memory: tuple[Channel, ...] = ()
    temperatures: Callable[[Any, PartTemperatures, Any], PartTemperatures] | None = None
    coefficients: Callable[[Coefficients, Any, PartTemperatures], Coefficients] | None = None
    balance: Callable[[Situation, Any, tuple], tuple[Ports, tuple]] | None = None
    reading: Callable[[Reading, Any], Any] | None = None
    lag: Callable[[Any], Any] | None = None
    reads_columns: bool = False
    channel: str = ""
    figure: str = ""
    plainer: str = ""
    as_common: bool = False
    indistinguishable_from: tuple[str, ...] = ()
    feature: str = ""
    law_error: float = 0.0
    figure_error: float = 0.0
    time_scale: float = float("inf")
    advice: Advice | None = None

    def in_words(self) -> str:
        """Name and what it is."""
        return f"{self.name}, {self.doc}"

    def on(self, channel: str) -> Effect:
        """This sensor effect on one channel, its parameters in that channel's unit. InputError for a wrong name."""
        if self.reading is None:
            raise InputError(f"effect {self.name} does not act on a sensor, so it takes no channel")
        if channel not in READABLE:
            raise unknown_name("channel", channel, READABLE, f"effects.{self.name}.channel")
        target = READABLE[channel]

        def bound(p: Parameter) -> Parameter:
            if CHANNEL not in p.unit:
                return p
            unit, (low, high) = "delta_degC" if target.unit == "degC" else target.unit, p.bounds
            return replace(
                p,
                unit=p.unit.replace(CHANNEL, unit),
                default=p.default * target.scale,
                bounds=(low * target.scale, high * target.scale),
                typical=None if p.typical is None else p.typical * target.scale,
                ordinary=p.ordinary * target.scale,
            )

        return replace(self, channel=channel, parameters=tuple(bound(p) for p in self.parameters))

    @property
    def amplitude(self) -> Parameter:
        """The parameter whose neutral value switches the effect off."""
        for parameter in self.parameters:
            if parameter.neutral is not None:
                return parameter
        raise InputError(f"effect {self.name} has no parameter with a neutral value, so nothing switches it off")

    def values(self, numbers) -> Any:
        """The parameters by name from a sequence in their order."""
        return _record(tuple(p.name for p in self.parameters))(*numbers)

    def __call__(self, **numbers: float) -> ActiveEffect:
        """The effect at given parameters, in SI or as text with a unit: `effect("sensor_bias").on(...)(bias="1 mA")`.

        Raises InputError for an unknown parameter, one outside its bounds, a missing amplitude, or a sensor effect
        without its channel.
        """
        self._check_channel()
        known = {p.name: p for p in self.parameters}
        for name, value in numbers.items():
            if name not in known:
                raise unknown_name(
                    f"parameter of effect {self.name}", name, known
                )  # of Python alone: `read` has looked
            if has_unit(value):
                value = numbers[name] = in_si(value, known[name].unit, f"effects.{self.name}.{name}")
            (low, high), values = known[name].bounds, np.asarray(value)
            if not (low <= value <= high if isinstance(value, float) else np.all((values >= low) & (values <= high))):
                unit = symbol(known[name].unit)
                raise InputError(
                    f"{value} {unit} is outside [{low:g}, {high:g}] {unit} ({known[name].doc})",
                    key=f"effects.{self.name}.{name}", joint=" = ",
                )  # fmt: skip
        if self.amplitude.name not in numbers:
            problem = f"needs {self.amplitude.name} ({self.amplitude.doc})"
            raise InputError(problem, key=f"effects.{self.name}", joint=" ")
        return ActiveEffect(self, tuple(numbers.get(p.name, p.default) for p in self.parameters))

    def read(self, table: dict[str, Any], where: str = "") -> ActiveEffect:
        """The effect from text with units, as the table `where` of a scenario file has it; raises InputError."""
        where = where or f"effects.{self.name}"
        if self.reading is not None and not self.channel and "channel" in table:
            rest = {name: text for name, text in table.items() if name != "channel"}
            with self._as(where):
                bound = self.on(str(table["channel"]))
            return bound.read(rest, where)
        known = {p.name: p for p in self.parameters}
        with self._as(where):
            self._check_channel()
        for name in table:
            if name not in known:
                raise unknown_name(f"parameter of effect {self.name}", name, known, where)
        numbers = {name: parse(text, known[name].unit, f"{where}.{name}") for name, text in table.items()}
        with self._as(where):
            return self(**numbers)

    @contextmanager
    def _as(self, where: str) -> Iterator[None]:
        """An InputError from inside speaks of the table `where` in place of the effect's own name."""
        try:
            yield
        except InputError as error:
            raise error.moved(f"effects.{self.name}", where) from None

    def _check_channel(self) -> None:
        if self.reading is not None and not self.channel:
            raise InputError("needs a channel, such as spool_position", key=f"effects.{self.name}", joint=" ")


@dataclass(frozen=True, repr=False)
class ActiveEffect(Shown):
    """An effect with its figures, in the order of its parameters."""

    effect: Effect
    numbers: tuple[Any, ...]

    def in_words(self) -> str:
        """The name of the effect and its figures."""
        figures = zip(self.effect.parameters, self.numbers, strict=True)
        return f"{self.effect.name}, {', '.join(f'{p.name} {value} {symbol(p.unit)}' for p, value in figures)}"

    @property
    def values(self) -> Any:
        """The parameters by name."""
        return self.effect.values(self.numbers)


MOST_ON_A_CHANNEL = 8  # sensor effects of one name: a stated error, what a diagnosis adds, and some more


def check_listed_once(effects: Sequence[ActiveEffect]) -> None:
    """InputError for an effect that acts twice in one place, where its figures (and states) would be lost or mixed.

    The place is told by its discrete parameters. Effects on a sensor act one after the other, as one that a diagnosis
    finds beside a stated one does: up to `MOST_ON_A_CHANNEL` of a name on a channel.
    """
    seen: Counter[tuple[Any, ...]] = Counter()
    for active in effects:
        one = active.effect
        at = [(p.name, number) for p, number in zip(one.parameters, active.numbers, strict=True) if p.discrete]
        place = (one.name, one.channel, *(np.asarray(number, dtype=float).tobytes() for _, number in at))
        seen[place] += 1
        if one.reading is not None and seen[place] > MOST_ON_A_CHANNEL:
            problem = f"acts more than {MOST_ON_A_CHANNEL} times on {one.channel}"
            raise InputError(problem, key=f"effects.{one.name}")
        if one.reading is None and seen[place] > 1:
            where = "".join(f" on {name} {number:g}" for name, number in at)
            raise InputError(f"acts twice{where}; give it once", key=f"effects.{one.name}")
