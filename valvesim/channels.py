"""Every state, input and signal: name, unit, scale and meaning. The only list of them."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass


@dataclass(frozen=True)
class Channel:
    """A named quantity over time. `scale` is its usual size in the reference valve; tolerances are relative to it."""

    name: str
    unit: str
    doc: str
    scale: float = 1.0


STATE_CHANNELS = (
    Channel("armature_angle", "rad", "armature and flapper, positive towards nozzle 1", 4e-4),
    Channel("armature_rate", "rad/s", "its rate", 1.0),
    Channel("nozzle_pressure_1", "Pa", "chamber of nozzle 1 and spool end 1", 1e7),
    Channel("nozzle_pressure_2", "Pa", "chamber of nozzle 2 and spool end 2", 1e7),
    Channel("spool_position", "m", "spool, positive opens supply to port A", 4e-4),
    Channel("spool_velocity", "m/s", "its velocity", 0.1),
)
INPUT_CHANNELS = (
    Channel("command", "A", "coil current, or voltage where the coil is driven by voltage", 1e-2),
    Channel("command_rate", "A/s", "its rate", 1.0),
    Channel("supply_pressure", "Pa", "supply", 2e7),
    Channel("return_pressure", "Pa", "behind the nozzles", 1e6),
    Channel("load_pressure", "Pa", "port A minus port B", 1e7),
)
SIGNAL_CHANNELS = (
    Channel("current", "A", "current in the coils", 1e-2),
    Channel("drive_torque", "N*m", "torque of the four gap forces", 1e-2),
    Channel("flapper_position", "m", "flapper at the nozzles, positive towards nozzle 1", 1e-5),
    Channel("feedback_force", "N", "of the feedback rod on the spool, against positive position", 1.0),
    Channel("flow_force", "N", "steady flow force on the spool", 10.0),
    Channel("load_differential_pressure", "Pa", "nozzle pressure 1 minus 2, across the spool", 1e6),
    Channel("pilot_flow", "m^3/s", "through both fixed orifices", 1e-5),
    Channel("nozzle_flow_1", "m^3/s", "out of nozzle 1", 5e-6),
    Channel("nozzle_flow_2", "m^3/s", "out of nozzle 2", 5e-6),
    Channel("load_flow", "m^3/s", "out of port A", 3e-4),
    Channel("internal_leakage", "m^3/s", "supply to return: pilot stage and lands", 1e-5),
)

State = namedtuple("State", [c.name for c in STATE_CHANNELS])
Inputs = namedtuple("Inputs", [c.name for c in INPUT_CHANNELS])
Signals = namedtuple("Signals", [c.name for c in SIGNAL_CHANNELS])
