"""The scenario that a response test starts from: temperatures and pressures held, and the unit of its command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valvesim.errors import InputError, check_kind, unknown_name
from valvesim.inputs import Command, Constant, evaluate
from valvesim.simulation.result import Result, output_channels
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.units import quantities
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import ThermalNetwork

Source = Valve | Scenario


def held(
    source: Source, *, oil_temperature: float | None = None, part_temperature: float | None = None
) -> Scenario:  # fmt: skip
    """The scenario that a response test starts from: temperatures and pressures held as they are at its time zero.

    A valve alone is isothermal. A scenario keeps its oil, drive, routes and effects; its parts stay where its
    `thermal` has them at the start (its `initial_temperature`, or the oil's), since a test is over before they follow.
    `oil_temperature` and `part_temperature` (all parts, °C) replace what the source has.
    Raises InputError for a batch of valves.
    """
    check_kind(source, (Valve, Scenario), "source", "a Valve or a Scenario (load_valve, load_scenario read files)")
    base = source if isinstance(source, Scenario) else Scenario(valve=source, thermal=Thermal(network=None))
    if any(np.ndim(getattr(base.valve, name)) for name in quantities(base.valve)):
        raise InputError("response: the valve holds arrays (a batch); give one valve at a time")
    oil = float(evaluate(base.oil_temperature, 0.0)) if oil_temperature is None else float(oil_temperature)
    thermal = base.thermal
    if part_temperature is not None:
        thermal = replace(thermal, network=_STILL, initial_temperature=part_temperature)
    elif thermal.network is not None:
        thermal = replace(thermal, network=_STILL)
    measured = {} if part_temperature is not None else base.part_temperatures
    supply, back, load = (_first(command) for command in base.pressures())
    return replace(
        base, thermal=thermal, oil_temperature=Constant(value=oil), supply_pressure=supply, return_pressure=back,
        load_pressure=load, channels=(), part_temperatures={part: _first(each) for part, each in measured.items()},
    )  # fmt: skip


_STILL = ThermalNetwork(**{name: 0.0 for name in quantities(ThermalNetwork) if "_to_" in name})
"""No conductance: every part stays at the temperature it starts with."""


def _first(command: Command) -> Constant:
    return Constant(value=float(evaluate(command, 0.0)))


def rated_command(base: Scenario) -> float:
    """The rated current, A; of a drive by voltage the voltage that holds it at 20 °C, V."""
    rated = float(base.valve.rated_current)
    return base.drive.command_for_current(rated, float(base.valve.coil_resistance))


def held_oil_temperature(base: Scenario) -> float:
    return float(evaluate(base.oil_temperature, 0.0))


def command_of(result: Result) -> np.ndarray:
    return result.values[result.scenario.drive.command_name]


def output_of(result: Result, output: str) -> np.ndarray:
    """A channel (n_t,) of a run; InputError where it has none by that name, as of an FMU that does not tell it."""
    if output not in result.values:
        raise unknown_name("channel", output, result.names, "output")
    return result.values[output]


def output_unit(base: Scenario, output: str) -> str:
    units = {channel.name: channel.unit for channel in output_channels(base)}
    if output not in units:
        raise unknown_name("channel", output, units, "output")
    return units[output]
