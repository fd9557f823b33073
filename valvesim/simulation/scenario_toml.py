"""A scenario file: read strictly from TOML, and written so that reading it back gives an equal scenario.

Every figure in a file is text with its unit. Whatever is unknown, misspelled, of the wrong dimension or out of range is
an InputError with file, line and key.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from valvesim.errors import InputError
from valvesim.inputs import Command
from valvesim.io import DEEPEST, MOST_TEXT, check_known, check_tables, located, read_names, read_toml
from valvesim.simulation.command_toml import TABLE, command_entries, read_command, read_switch
from valvesim.simulation.fmu_valve import FmuValve
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.simulation.scenario_files import scenario_file
from valvesim.units import change, exact_text, parse, quantities
from valvesim.valve.coefficients import ROUTES, check_routes
from valvesim.valve.effect import Effect, check_listed_once
from valvesim.valve.effect_files import load_effects_files
from valvesim.valve.equations import DRIVES
from valvesim.valve.permission import permitting
from valvesim.valve.thermal_network import THERMAL_NODES, ThermalNetwork
from valvesim.valve.valve_file import PRESETS, ValveFile, read_valve_entry
from valvesim.valve.valve_toml import (
    add_effects,
    add_section,
    differing,
    oil_lines,
    on_lines,
    on_one_line,
    read_effects,
    read_oil_table,
    valve_lines,
)

PRESSURES = ("supply", "return", "load")
SECTIONS = ("valve", "oil", "thermal", "command", "pressures", "effects", "outputs", "solver")
_OPTIONS = {"duration": "duration", "output_rate": "outputs.rate", "tolerance": "solver.tolerance"}
"""Quantities of `Scenario` -> their keys in a file."""
_THERMAL_KEYS = (
    "routes", "isothermal", "throttling_heat", "initial_temperature", "ambient_temperature", "oil_temperature",
    "part_temperatures",
)  # fmt: skip
_PARTS = "part_temperatures"


# ---------------------------------------------------------------- reading


def load_scenario(
    path: str | Path, *, settings: Sequence[str] = (), valve: str | Path | None = None, trust: bool = False,
    outside: bool = False,
) -> Scenario:  # fmt: skip
    """Read a scenario file, or the scenario of that name that comes along (`launch_shock`).

    `settings` such as `valve.null_gap=0.03 mm` override or add keys; `valve` (a valve file or a preset's name) takes
    the place of the file's own. With `trust` the Python files of effects that it names are run, with `outside` also
    those outside its folder (`valve/effect_trust`). Raises InputError for a missing file, broken TOML, or any key or
    figure that makes no sense.
    """
    with permitting(trust=trust, outside=outside):
        return _load(scenario_file(path), settings, valve)


def _load(path: Path, settings: Sequence[str], valve: str | Path | None) -> Scenario:
    text, table = read_toml(path, "`valvesim scenarios` lists those that come along")
    if valve is not None:
        table["valve"] = valve_argument(valve)
    for setting in settings:
        override(table, setting)
    with located(path, text, document="scenario", settings=settings):
        return ScenarioReader(path.parent).scenario(table)


def read_tables(settings: Sequence[str], *, valve: str | Path | None = None) -> ValveFile:
    """The reference valve, or that of a valve file or preset, with settings such as `valve.null_gap=0.03 mm`.

    A file `*.fmu` is a valve too (`FmuValve`); settings of `valve` are then rated current and pressures of the tests.
    Settings are of `valve`, `oil` and `effects`; nothing else may be set.
    """
    if valve is not None and Path(valve).suffix.lower() == ".fmu":
        own = read_tables(settings)
        figures = {name: getattr(own.valve, name) for name in quantities(own.valve)}
        return replace(own, title=Path(valve).stem, valve=FmuValve(path=valve, **figures))
    table: dict[str, Any] = {} if valve is None else {"valve": valve_argument(valve)}
    for setting in settings:
        override(table, setting)
    check_known(table, ("valve", "oil", "effects"), "--set")
    check_tables(table, ("oil", "effects"))
    return ScenarioReader(Path()).valve(table)


def valve_argument(valve: str | Path) -> dict[str, str]:
    """The table `valve` for a valve file or preset that a caller names, whatever folder its document is in."""
    return {"file": str(valve) if str(valve) in PRESETS else str(Path(valve).absolute())}


def override(table: dict[str, Any], setting: str) -> None:
    """Put a setting `KEY=VALUE` into the tables of a file. InputError where it cannot be."""
    key, equals, text = setting.partition("=")
    names = [name.strip() for name in key.split(".")]
    if not equals or not all(names):
        raise InputError("expected KEY=VALUE, such as valve.null_gap='0.03 mm'", setting=setting)
    if names[0] == "valve" and len(names) > 1 and isinstance(table.get("valve"), str):
        table["valve"] = {"file": table["valve"]}
    for name in names[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"{name!r} is a value, not a table", setting=setting)
    if len(names) > DEEPEST or len(text) > MOST_TEXT:
        raise InputError("is too long", setting=setting)
    try:
        table[names[-1]] = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        table[names[-1]] = text.strip()


@dataclass(frozen=True)
class ScenarioReader:
    """Turns TOML tables into a scenario; `folder` is where relative file names start."""

    folder: Path

    def scenario(self, table: dict[str, Any]) -> Scenario:
        """The scenario of a whole file."""
        check_known(table, ("title", "duration", "effects_files", *SECTIONS), "scenario")
        check_tables(table, SECTIONS[1:])
        if "duration" not in table:
            raise InputError("duration is missing, such as duration = '1 s'")
        thermal = dict(table.get("thermal", {}))
        oil_temperature, parts = thermal.pop("oil_temperature", None), thermal.pop(_PARTS, {})
        commands, pressures = table.get("command", {}), table.get("pressures", {})
        outputs, solver = table.get("outputs", {}), table.get("solver", {})
        check_known(commands, tuple(DRIVES), "command")
        if len(commands) != 1:
            raise InputError("give either [command.current] or [command.voltage]", key="command")
        ((drive, command),) = commands.items()
        check_known(pressures, PRESSURES, "pressures")
        valve = self.valve(table)
        check_known(outputs, ("rate", "channels"), "outputs")
        check_known(solver, ("tolerance",), "solver")
        options: dict[str, Any] = {}
        for name, where in _OPTIONS.items():
            section, _, key = where.rpartition(".")
            source = table.get(section, {}) if section else table
            if key in source:
                options[name] = parse(source[key], quantities(Scenario)[name].metadata["unit"], where)
        for name in PRESSURES:
            if name in pressures:
                column = f"{name}_pressure"
                options[column] = self.command(pressures[name], "Pa", f"pressures.{name}", column)
        if oil_temperature is not None:
            where = "thermal.oil_temperature"
            options["oil_temperature"] = self.command(oil_temperature, "degC", where, "oil_temperature")
        if not isinstance(parts, dict):
            raise InputError(f"expected a table, got {parts!r}", key=f"thermal.{_PARTS}")
        check_known(parts, THERMAL_NODES, f"thermal.{_PARTS}")
        options["part_temperatures"] = {
            part: self.command(given, "degC", f"thermal.{_PARTS}.{part}", f"{part}_temperature")
            for part, given in parts.items()
        }
        try:
            return Scenario(
                title=table.get("title", "valve"),
                valve=valve.valve,
                oil=valve.oil,
                thermal=self.thermal(thermal),
                command=self.command(command, DRIVES[drive].command_unit, f"command.{drive}", drive),
                drive=DRIVES[drive],
                effects=valve.effects,
                channels=read_names(outputs.get("channels", []), "outputs.channels", "channel"),
                **options,
            )
        except InputError as error:
            for name, key in _OPTIONS.items():
                error = error.moved(f"scenario.{name}", key)
            raise error from None

    def command(self, given: Any, unit: str, where: str, column: str) -> Command:
        """A command of this file, see `read_command`."""
        return read_command(given, unit, where, column=column, folder=self.folder)

    def valve(self, table: Mapping[str, Any], more_effects: Sequence[Path] = ()) -> ValveFile:
        """The valve of a document, with its oil and effects: of a valve file that it names, and of its own sections.

        An oil of the document takes the place of the valve file's; its effects act beside that file's. `more_effects`
        are further files of a user's own effects.
        """
        named = read_valve_entry(table.get("valve", {}), self.folder)
        files = read_names(table.get("effects_files", []), "effects_files", "file")
        paths = (*named.effects_files, *map(Path, files), *more_effects)
        own = load_effects_files(self.folder, files, given=(*named.effects_files, *more_effects))
        absolute = tuple(self.folder.absolute() / path for path in paths)
        effects = (*named.effects, *read_effects(table.get("effects", {}), own))
        check_listed_once(effects)
        oil = read_oil_table(table["oil"], self.folder) if "oil" in table else named.oil
        return dataclasses.replace(named, oil=oil, effects=effects, effects_files=absolute, own=own)

    def thermal(self, table: dict[str, Any]) -> Thermal:
        """How the parts follow the oil; the temperature of the oil itself has been taken out of the table."""
        figures = dict(table)
        check_known(figures, (*quantities(ThermalNetwork), *_THERMAL_KEYS), "thermal")
        routes = read_names(figures.pop("routes", list(ROUTES)), "thermal.routes", "route")
        isothermal, heat = (
            read_switch(figures.pop(name, False), f"thermal.{name}") for name in ("isothermal", "throttling_heat")
        )
        initial = figures.pop("initial_temperature", None)
        ambient = figures.pop("ambient_temperature", None)
        network = change(ThermalNetwork(), figures, "thermal")
        routes = tuple(sorted(check_routes(routes, "thermal.routes"), key=ROUTES.index))
        options = {} if ambient is None else {
            "ambient_temperature": parse(ambient, "degC", "thermal.ambient_temperature")
        }  # fmt: skip
        return Thermal(
            network=None if isothermal else network,
            routes=routes,
            throttling_heat=heat,
            initial_temperature=self._initial(initial, "thermal.initial_temperature"),
            **options,
        )

    @staticmethod
    def _initial(given: Any, where: str) -> float | dict[str, float] | None:
        """Where the parts start, °C: one figure for all, a table by part, or none."""
        if isinstance(given, dict):
            check_known(given, THERMAL_NODES, where)
            return {name: parse(text, "degC", f"{where}.{name}") for name, text in given.items()}
        return None if given is None else parse(given, "degC", where)


# ---------------------------------------------------------------- writing


def scenario_to_toml(scenario: Scenario, *, effects_files: Sequence[str] = (), own: Sequence[Effect] = ()) -> str:
    """The text of a scenario file that reads back as an equal scenario (routes in the order of `ROUTES`).

    Every figure has as many digits as it takes; a comment tells how far one is from its default. Points of a table
    stand in the text itself. `own` are the effects that the Python files `effects_files` declare.

    Raises InputError for what no file can say: a batch of valves, a law, oil, drive, command or effect without a name
    there, and more text than is read.
    """
    import tomlkit

    text = tomlkit.dumps(scenario_document(scenario, effects_files=effects_files, own=own))
    if len(text.encode()) > MOST_TEXT:
        raise InputError(f"scenario: its tables make more than the {MOST_TEXT} bytes of text that are read")
    return text


def scenario_document(
    scenario: Scenario,
    *,
    effects_files: Sequence[str] = (),
    own: Sequence[Effect] = (),
    files: Mapping[str, Mapping[str, str]] | None = None,
) -> Any:
    """`scenario_to_toml` as a tomlkit document, which the caller may change.

    `files` has, by the key of a command (`command.current`), the entries of a `table` that is read from a file, in
    place of its points.
    """
    import tomlkit

    def write(command: Command, unit: str, where: str) -> dict[str, Any]:
        named = (files or {}).get(where)
        return command_entries(command, unit, where) if named is None else {TABLE: dict(named)}

    drive = scenario.drive
    if drive not in DRIVES.values():
        raise InputError(f"{type(drive).__name__} is no drive of a scenario file", key="command")
    defaults = {name: field.default for name, field in quantities(Scenario).items()}
    document = tomlkit.document()
    document.add("title", scenario.title)
    document.add("duration", exact_text(scenario.duration, "s"))
    if effects_files:
        document.add("effects_files", list(effects_files))
    add_section(document, "valve", valve_lines(scenario.valve))
    add_section(document, "oil", oil_lines(scenario.oil))
    thermal = add_section(document, "thermal", _thermal_lines(scenario.thermal), always=True)
    oil_temperature = write(scenario.oil_temperature, "degC", "thermal.oil_temperature")
    add_section(thermal, "oil_temperature", on_lines(oil_temperature))
    parts = {part: write(each, "degC", f"thermal.{_PARTS}.{part}") for part, each in scenario.part_temperatures.items()}
    add_section(thermal, _PARTS, on_lines(parts))
    commands = tomlkit.table(is_super_table=True)
    where = f"command.{drive.command_name}"
    add_section(commands, drive.command_name, on_lines(write(scenario.command, drive.command_unit, where)))
    document.add(tomlkit.nl())
    document.add("command", commands)
    given = {name: getattr(scenario, f"{name}_pressure") for name in PRESSURES}
    pressures = {name: write(each, "Pa", f"pressures.{name}") for name, each in given.items() if each is not None}
    add_section(document, "pressures", on_lines(pressures))
    add_effects(document, scenario.effects, own)
    outputs: dict[str, Any] = {"rate": exact_text(scenario.output_rate, "Hz")}
    add_section(document, "outputs", outputs | ({"channels": list(scenario.channels)} if scenario.channels else {}))
    if scenario.tolerance != defaults["tolerance"]:
        add_section(document, "solver", {"tolerance": float(scenario.tolerance)})
    return document


def _thermal_lines(thermal: Thermal) -> dict[str, Any]:
    lines: dict[str, Any] = {"isothermal": True} if thermal.network is None else {}
    if thermal.routes != ROUTES:
        lines["routes"] = list(thermal.routes)
    if thermal.throttling_heat:
        lines["throttling_heat"] = True
    initial = thermal.initial_temperature
    if isinstance(initial, Mapping):
        lines["initial_temperature"] = on_one_line({name: exact_text(t, "degC") for name, t in initial.items()})
    elif initial is not None:
        lines["initial_temperature"] = exact_text(initial, "degC")
    lines |= differing(thermal, Thermal(), "thermal")
    return lines if thermal.network is None else lines | differing(thermal.network, ThermalNetwork(), "thermal")
