"""What is exported: the scenario of a file, or a valve file with all else at its default; effects switched off."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from valvesim.errors import InputError, unknown_name
from valvesim.io import read_toml
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.scenario_files import scenario_file
from valvesim.simulation.scenario_toml import load_scenario, read_tables
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.valve_file import PRESETS

OF_SCENARIOS = ("duration", "command", "thermal", "pressures", "outputs", "solver")  # tables that no valve file has


def load_source(
    source: str | Path, *, settings: Sequence[str] = (), valve: str | None = None, effects: Sequence[str] = ()
) -> Scenario:
    """The scenario of a scenario file, or of a valve file or preset with everything else at its default.

    `effects` are names of the catalogue (`sensor_bias.spool_position` on a sensor), added at their neutral value.
    Raises InputError as the readers do, and for an effect that nobody knows.
    """
    case = _load(source, settings, valve)
    return replace(case, effects=(*case.effects, *(switched_off(name) for name in effects)))


def _load(source: str | Path, settings: Sequence[str], valve: str | None) -> Scenario:
    path = Path(source)
    if not os.path.exists(path) and str(source) in PRESETS:
        is_valve = True
    else:
        _, table = read_toml(scenario_file(source))
        is_valve = "valve" in table and not any(name in table for name in OF_SCENARIOS)
    if not is_valve:
        return load_scenario(source, settings=settings, valve=valve)
    if valve is not None:
        raise InputError(f"{source} is a valve already", key="--valve")
    described = read_tables(settings, valve=source)
    title = " ".join(filter(None, (described.title, described.serial_number))) or path.stem
    return Scenario(title=title, valve=described.valve, oil=described.oil, effects=described.effects)


def switched_off(name: str) -> ActiveEffect:
    """An effect of the catalogue at its neutral value, its shape at the defaults; InputError for an unknown one."""
    known, _, channel = name.partition(".")
    if known not in CATALOGUE:
        raise unknown_name("effect", known, CATALOGUE, "--effect")
    effect = CATALOGUE[known].on(channel) if channel else CATALOGUE[known]
    return effect(**{effect.amplitude.name: effect.amplitude.neutral or 0.0})
