"""Every state, input and signal: name, unit, meaning and scale. The only list of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, get_type_hints


@dataclass(frozen=True)
class Channel:
    """A named quantity over time. `scale` is its usual size in the reference valve; tolerances are relative to it."""

    name: str
    unit: str
    doc: str
    scale: float = 1.0


class State(NamedTuple):
    """The six states of the valve. Each field: unit, meaning, scale."""

    armature_angle: Annotated[Any, "rad", "armature and flapper, positive towards nozzle 1", 4e-4]
    armature_rate: Annotated[Any, "rad/s", "its rate", 1.0]
    nozzle_pressure_1: Annotated[Any, "Pa", "chamber of nozzle 1 and spool end 1", 1e7]
    nozzle_pressure_2: Annotated[Any, "Pa", "chamber of nozzle 2 and spool end 2", 1e7]
    spool_position: Annotated[Any, "m", "spool, positive opens supply to port A", 4e-4]
    spool_velocity: Annotated[Any, "m/s", "its velocity", 0.1]


class Inputs(NamedTuple):
    """What acts on the valve from outside."""

    command: Annotated[Any, "A", "coil current, or voltage (V) where the coil is driven by voltage", 1e-2]
    command_rate: Annotated[Any, "A/s", "its rate", 1.0]
    supply_pressure: Annotated[Any, "Pa", "supply", 2e7]
    return_pressure: Annotated[Any, "Pa", "behind the nozzles", 1e6]
    load_pressure: Annotated[Any, "Pa", "port A minus port B", 1e7]


class Signals(NamedTuple):
    """What the equations give besides the derivatives."""

    current: Annotated[Any, "A", "current in the coils", 1e-2]
    drive_torque: Annotated[Any, "N*m", "torque of the four gap forces", 1e-2]
    flapper_position: Annotated[Any, "m", "flapper at the nozzles, positive towards nozzle 1", 1e-5]
    feedback_force: Annotated[Any, "N", "of the feedback rod on the spool, against positive position", 1.0]
    flow_force: Annotated[Any, "N", "steady flow force on the spool", 10.0]
    pilot_differential_pressure: Annotated[Any, "Pa", "nozzle pressure 1 minus 2, across the spool", 1e6]
    pilot_flow: Annotated[Any, "m^3/s", "through both fixed orifices", 1e-5]
    nozzle_flow_1: Annotated[Any, "m^3/s", "out of nozzle 1", 5e-6]
    nozzle_flow_2: Annotated[Any, "m^3/s", "out of nozzle 2", 5e-6]
    load_flow: Annotated[Any, "m^3/s", "out of port A", 3e-4]
    internal_leakage: Annotated[Any, "m^3/s", "supply to return: pilot stage and lands", 1e-5]


def _channels(names: Any) -> tuple[Channel, ...]:
    hints = get_type_hints(names, include_extras=True)
    return tuple(Channel(name, *hint.__metadata__) for name, hint in hints.items())


STATE_CHANNELS, INPUT_CHANNELS, SIGNAL_CHANNELS = _channels(State), _channels(Inputs), _channels(Signals)
