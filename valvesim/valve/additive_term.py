"""Terms that no catalogue entry has: a free function of one variable at one port of the equations.

A term is a function drawn by straight lines between knots. Its families (port, variable, memory) are searched in what
a fitted model leaves; the best is then estimated inside the simulation, as an effect like any other.

Symbols
    u the variable, w(u) what is added at the port, hat_k(u) the basis: one at knot k, zero at its neighbours
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.channels import Channel, State
from valvesim.errors import InputError, unknown_name
from valvesim.valve.effect import Effect, Parameter, Ports, Situation
from valvesim.valve.laws import dahl_rate


@dataclass(frozen=True)
class Port:
    """A place where a term may act: its unit, what a term w adds there, and its element's `own` variables.

    A spring answers its deflection, a damper its rate, a leak its pressure, and the pressures of the nozzles push the
    flapper: a function of another variable is rarer.
    """

    name: str
    unit: str
    doc: str
    own: tuple[str, ...]

    def ports(self, w: Any) -> Ports:
        """What w adds."""
        if self.name == "pilot_flow":
            return Ports(chamber_flow_1=w, chamber_flow_2=-w)
        return Ports(**{self.name: w})


@dataclass(frozen=True)
class Variable:
    """What a term may be a function of; `rate` is the state that is its rate of change, where its path is followed."""

    name: str
    unit: str
    scale: float
    rate: str = ""

    def of(self, state: State, current: Any) -> Any:
        """Its value, in SI."""
        if self.name == "pilot_differential_pressure":
            return state.nozzle_pressure_1 - state.nozzle_pressure_2
        return current if self.name == "current" else getattr(state, self.name)

    def along(self, model: Any, states: Sequence, inputs: Sequence) -> Any:
        """Its value (n,) along a trajectory of an `equations.Model`: states and inputs (n,) each, SI."""
        memory = states[model.drive_states]
        return self.of(State(*states[model.valve_states]), memory[0] if memory else inputs[0])


PORTS = {
    port.name: port
    for port in (
        Port(
            "armature_torque",
            "N*m",
            "armature torque balance",
            ("current", "armature_angle", "pilot_differential_pressure"),
        ),
        Port(
            "pilot_flow",
            "m^3/s",
            "volume balances of the two chambers, into one and out of the other",
            ("pilot_differential_pressure",),
        ),
        Port("spool_force", "N", "spool force balance", ("spool_position", "spool_velocity")),
        Port("load_flow", "m^3/s", "load flow of the main stage", ("spool_position",)),
        Port("internal_leakage", "m^3/s", "internal leakage", ("spool_position",)),
    )
}
VARIABLES = {
    variable.name: variable
    for variable in (
        Variable("current", "A", 1e-2),
        Variable("armature_angle", "rad", 4e-4, rate="armature_rate"),
        Variable("pilot_differential_pressure", "Pa", 1e6),
        Variable("spool_position", "m", 4e-4, rate="spool_velocity"),
        Variable("spool_velocity", "m/s", 0.1),
    )
}
NONE, LAG, PATH = "none", "lag", "path"  # what a term remembers: nothing, the variable of a while ago, its direction
MEMORIES = (NONE, LAG, PATH)
LAG_TIMES = (3e-3, 3e-2)  # s, at which lagged variables are looked for
JUMP_SHARE = 5e-3  # of the range on either side of zero over which a term jumps: what a sharp edge is rounded by


@dataclass(frozen=True)
class TermHypothesis:
    """Where a term acts and what it is a function of. `time_constant` (s) of a lag; `width` of a path's memory.

    A function that `jumps` does so at zero, as a dead band or a preload does.
    """

    port: Port
    variable: Variable
    memory: str = NONE
    time_constant: float = 0.0
    width: float = 0.0
    jumps: bool = False

    @property
    def complexity(self) -> int:
        """In how many ways it is rarer than a continuous function of the port's own variable, without memory."""
        return (self.memory != NONE) + (self.variable.name not in self.port.own) + self.jumps

    def knots(self, low: float, high: float, count: int) -> np.ndarray:
        """So many knots (count,) from low to high, evenly; where it jumps between them, two lie close beside zero."""
        if not self.jumps or count < 4 or not low < 0.0 < high:
            return np.linspace(low, high, count)
        below = min(max(round(-low / (high - low) * count), 2), count - 2)
        below_zero = np.linspace(low, JUMP_SHARE * low, below)
        return np.concatenate([below_zero, np.linspace(JUMP_SHARE * high, high, count - below)])

    @property
    def label(self) -> str:
        """In words."""
        what = self.variable.name.replace("_", " ")
        if self.memory == LAG:
            what += f" lagged by {self.time_constant * 1e3:.3g} ms"
        if self.memory == PATH:
            what = f"direction of {what}"
        if self.jumps:
            what += " with a jump at zero"
        return f"{self.port.name.replace('_', ' ')} as a function of {what}"


def term_hypotheses() -> tuple[TermHypothesis, ...]:
    """All continuous ones that are looked for."""
    found = []
    for port in PORTS.values():
        for variable in VARIABLES.values():
            found.append(TermHypothesis(port, variable))
            if variable.name in ("current", "spool_position", "pilot_differential_pressure"):
                found += [TermHypothesis(port, variable, LAG, time) for time in LAG_TIMES]
            if variable.rate:
                found.append(TermHypothesis(port, variable, PATH, width=0.1 * variable.scale))
    return tuple(found)


def jump_hypotheses() -> tuple[TermHypothesis, ...]:
    """Those that jump at zero: of each port's own variables."""
    return tuple(TermHypothesis(port, VARIABLES[name], jumps=True) for port in PORTS.values() for name in port.own)


def linear_b_splines(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """(n, k): each column one at its knot, zero at the others, straight between, constant beyond the ends."""
    inside = np.clip(values, knots[0], knots[-1])
    return np.column_stack([np.interp(inside, knots, unit) for unit in np.eye(len(knots))])


def term_effect(
    port: str, variable: str, knots: Sequence[float], values: Sequence[float], *, memory: str = NONE,
    time_constant: float = 0.0, width: float = 0.0, name: str = "recovered_term",
) -> Effect:  # fmt: skip
    """An effect that adds w(variable) at a port, w given by `values` at `knots` (SI, rising), straight in between.

    `memory` is NONE, LAG (the variable through a first-order lag of `time_constant` s) or PATH (w times the direction
    of the variable's path, which turns over `width`, in the variable's unit). Knots and values, time constant and
    width are parameters of the effect (at_1 .., value_1 .., time_constant, width), and these are their defaults: terms
    that differ in figures alone are one compiled model.

    Raises InputError for an unknown port, variable or memory, knots that do not rise or do not match the values, a lag
    without its time, a path without its width, or the path of a variable that has none.
    """
    for what, given, known in (("port", port, PORTS), ("variable", variable, VARIABLES), ("memory", memory, MEMORIES)):
        if given not in known:
            raise unknown_name(what, given, known)
    place, argument = PORTS[port], VARIABLES[variable]
    if memory == PATH and not argument.rate:
        paths = ", ".join(v.name for v in VARIABLES.values() if v.rate)
        raise InputError(f"term {name}: the path of {variable} has no memory here; choose one of {paths}")
    at, w = np.asarray(knots, dtype=float), np.asarray(values, dtype=float)
    if len(at) < 2 or len(at) != len(w) or not np.all(np.diff(at) > 0.0) or not np.all(np.isfinite([*at, *w])):
        raise InputError(
            f"term {name}: expected at least two knots, rising, with one finite value each, got {len(at)} knots "
            f"{at.tolist()} and {len(w)} values {w.tolist()}"
        )
    for own_name, value, needed in (("time_constant", time_constant, memory == LAG), ("width", width, memory == PATH)):
        if needed != (value > 0.0):
            raise InputError(
                f"term {name}: {own_name} = {value:g} with memory = {memory!r}; a {LAG} needs its time_constant and a "
                f"{PATH} its width, above zero, and no other has one"
            )
    reach, largest = 1e3 * float(np.max(np.abs(at))), 1e6 * max(float(np.max(np.abs(w))), 1e-30)

    def figure(name: str, unit: str, doc: str, value: float, bounds: tuple[float, float]) -> Parameter:
        return Parameter(name=name, unit=unit, doc=doc, default=float(value), bounds=bounds)

    places = [figure(f"at_{k + 1}", argument.unit, f"{variable} at knot {k + 1}", u, (-reach, reach))
              for k, u in enumerate(at)]  # fmt: skip
    heights = [figure(f"value_{k + 1}", place.unit, f"added at knot {k + 1}", v, (-largest, largest))
               for k, v in enumerate(w)]  # fmt: skip
    own = {
        NONE: (),
        LAG: (figure("time_constant", "s", f"of the lag of {variable}", time_constant, (1e-5, 1e3)),),
        PATH: (figure("width", argument.unit, f"of the turning of {variable}'s path", width, (1e-9 * reach, reach)),),
    }[memory]
    share = Parameter(
        name="share", unit="1", doc="of the term", default=0.0, bounds=(0.0, 10.0), neutral=0.0, typical=1.0
    )
    states = {NONE: (), LAG: (Channel(f"{name}_lagged", argument.unit, f"{variable} lagged", argument.scale),),
              PATH: (Channel(f"{name}_direction", "1", f"direction of {variable}", 1.0),)}  # fmt: skip
    return Effect(
        name=name,
        doc=f"a term recovered from measurements: w({variable}), straight between {len(at)} knots",
        location=place.doc,
        signature="none of the known causes",
        parameters=(share, *places, *heights, *own),
        memory=states[memory],
        balance=_balance(port, variable, memory, len(at)),
    )


@functools.cache
def _balance(port: str, variable: str, memory: str, count: int) -> Any:
    """What the effects of all terms of one kind add: one function, so that they are one compiled model."""
    place, argument = PORTS[port], VARIABLES[variable]

    def balance(s: Situation, p: Any, state: tuple) -> tuple[Ports, tuple]:
        u: Any = argument.of(s.state, s.coil_current)
        rates: tuple = ()
        direction: Any = 1.0
        if memory == LAG:
            (lagged,) = state
            rates = ((u - lagged) / p.time_constant,)
            u = lagged
        if memory == PATH:
            (direction,) = state
            rates = (dahl_rate(getattr(s.state, argument.rate), direction, p.width),)
        at = [getattr(p, f"at_{k + 1}") for k in range(count)]
        height = [getattr(p, f"value_{k + 1}") for k in range(count)]
        w: Any = height[0]
        for k in range(count - 1):  # each piece adds its rise
            piece = np.minimum(np.maximum(u, at[k]), at[k + 1]) - at[k]
            w = w + (height[k + 1] - height[k]) / (at[k + 1] - at[k]) * piece
        return place.ports(p.share * direction * w), rates

    return balance
