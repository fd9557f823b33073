"""The catalogue of effects that a nominal valve lacks; an entry stands in the module of its place in `valve/effects`.

Simulation, diagnosis, documentation and reports read it.
"""

from __future__ import annotations

from valvesim.errors import unknown_name
from valvesim.valve.effect import Effect
from valvesim.valve.effects.motor import MOTOR
from valvesim.valve.effects.pilot import PILOT
from valvesim.valve.effects.sensors import SENSORS
from valvesim.valve.effects.spool import SPOOL
from valvesim.valve.effects.supply import SUPPLY
from valvesim.valve.effects.thermal import THERMAL

CATALOGUE: dict[str, Effect] = {entry.name: entry for entry in (*MOTOR, *PILOT, *SUPPLY, *SPOOL, *THERMAL, *SENSORS)}


def effect(name: str) -> Effect:
    """The catalogue entry of that name; InputError with the nearest name otherwise."""
    if name not in CATALOGUE:
        raise unknown_name("effect", name, CATALOGUE)
    return CATALOGUE[name]
