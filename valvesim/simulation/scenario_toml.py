"""A scenario file: read strictly from TOML, and written so that reading it back gives an equal scenario.

Every figure in a file is text with its unit. Whatever is unknown, misspelled, of the wrong dimension or out of range is
an InputError with file, line and key.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.inputs import Command
from valvesim.io import DEEPEST, MOST_TEXT, located, read_toml
from valvesim.simulation.command_toml import TABLE, check_known, command_entries, read_command, read_switch
from valvesim.simulation.scenario import Scenario, Thermal, check_listed_once
from valvesim.units import change, exact_text, parse, quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import ROUTES, check_routes
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.effect_files import load_effects_files
from valvesim.valve.equations import DRIVES
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.fluid import Oil
from valvesim.valve.oils import OILS, own_columns, read_oil
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import NODES, ThermalNetwork

PRESSURES = ("supply", "return", "load")
SECTIONS = ("valve", "oil", "thermal", "command", "pressures", "effects", "outputs", "solver")
_OPTIONS = {"duration": "duration", "output_rate": "outputs.rate", "tolerance": "solver.tolerance"}
"""Quantities of `Scenario` -> their keys in a file."""
_THERMAL_KEYS = (
    "routes", "isothermal", "throttling_heat", "initial_temperature", "ambient_temperature", "oil_temperature",
)  # fmt: skip


# ---------------------------------------------------------------- reading


def load_scenario(path: str | Path, *, settings: Sequence[str] = ()) -> Scenario:
    """Read a scenario file; `settings` such as `valve.null_gap=0.03 mm` override or add keys.

    Raises InputError for a missing file, broken TOML, or any key or figure that makes no sense.
    """
    path = Path(path)
    text, table = read_toml(path)
    for setting in settings:
        _override(table, setting)
    with located(path, text, document="scenario", settings=settings):
        return Reader(path.parent).scenario(table)


def read_tables(settings: Sequence[str]) -> tuple[Valve, Oil]:
    """The reference valve and oil with settings such as `valve.null_gap=0.03 mm`; nothing else may be set."""
    table: dict[str, Any] = {}
    for setting in settings:
        _override(table, setting)
    check_known(table, ("valve", "oil"), "--set")
    return read_valve(table.get("valve", {})), Reader(Path()).oil(table.get("oil", {}))


def read_valve(table: Mapping[str, Any]) -> Valve:
    """The reference valve with figures from a table; `flow_law` names the law of the pilot's flow coefficients."""
    figures = dict(table)
    law = figures.pop("flow_law", "yan_2019")
    if law not in FLOW_LAWS:
        raise unknown_name("flow law", str(law), FLOW_LAWS, "valve.flow_law")
    return dataclasses.replace(change(Valve(), figures, "valve"), flow_coefficients=FLOW_LAWS[law])


def check_tables(table: Mapping[str, Any], names: Sequence[str]) -> None:
    """InputError for a section that is no table; the effects may be a list of tables."""
    for name in names:
        given = table.get(name, {})
        if not isinstance(given, dict) and not (name == "effects" and isinstance(given, list)):
            raise InputError(f"expected a table, got {given!r}", key=name)


def read_names(given: Any, where: str, what: str) -> tuple[str, ...]:
    """InputError unless `given` is a list of text; `what` they are the names of."""
    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise InputError(f"expected a list of {what} names, got {given!r}", key=where)
    return tuple(given)


def _override(table: dict[str, Any], setting: str) -> None:
    key, equals, text = setting.partition("=")
    names = [name.strip() for name in key.split(".")]
    if not equals or not all(names):
        raise InputError("expected KEY=VALUE, such as valve.null_gap='0.03 mm'", setting=setting)
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
class Reader:
    """Turns TOML tables into a scenario; `folder` is where relative file names start."""

    folder: Path

    def scenario(self, table: dict[str, Any]) -> Scenario:
        """The scenario of a whole file."""
        check_known(table, ("title", "duration", "effects_files", *SECTIONS), "scenario")
        check_tables(table, SECTIONS)
        if "duration" not in table:
            raise InputError("duration is missing, such as duration = '1 s'")
        thermal = dict(table.get("thermal", {}))
        oil_temperature = thermal.pop("oil_temperature", None)
        commands, pressures = table.get("command", {}), table.get("pressures", {})
        outputs, solver = table.get("outputs", {}), table.get("solver", {})
        check_known(commands, tuple(DRIVES), "command")
        if len(commands) != 1:
            raise InputError("give either [command.current] or [command.voltage]", key="command")
        ((drive, command),) = commands.items()
        check_known(pressures, PRESSURES, "pressures")
        valve = read_valve(table.get("valve", {}))
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
        try:
            return Scenario(
                title=table.get("title", "valve"),
                valve=valve,
                oil=self.oil(table.get("oil", {})),
                thermal=self.thermal(thermal),
                command=self.command(command, DRIVES[drive].command_unit, f"command.{drive}", drive),
                drive=DRIVES[drive],
                effects=self.effects(table.get("effects", {}), self.own_effects(table)),
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

    def oil(self, table: dict[str, Any]) -> Oil:
        """The oil of a table, or of the file that it names; keys beside `file` take the place of the file's."""
        if "file" not in table:
            return read_oil(table)
        name = table["file"]
        if not isinstance(name, str) or not name:
            raise InputError(f"expected the name of a TOML file, got {name!r}", key="oil.file")
        path = self.folder / name
        try:
            text, own = read_toml(path, "oil.file names it")
            whole = set(own) == {"oil"} and isinstance(own["oil"], dict)
            with located(path, text):
                read_oil(own["oil"] if whole else own, "oil" if whole else "")
        except InputError as error:
            raise InputError(str(error), key="oil.file") from None
        return read_oil((own["oil"] if whole else own) | {key: table[key] for key in table if key != "file"})

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
            check_known(given, NODES, where)
            return {name: parse(text, "degC", f"{where}.{name}") for name, text in given.items()}
        return None if given is None else parse(given, "degC", where)

    def own_effects(self, table: dict[str, Any]) -> tuple[Effect, ...]:
        """The user's own effects, of the files that the top-level key `effects_files` names."""
        files = read_names(table.get("effects_files", []), "effects_files", "file")
        return load_effects_files(self.folder, files)

    def effects(self, given: Any, own: Sequence[Effect] = ()) -> tuple[ActiveEffect, ...]:
        """The active effects, of the catalogue or the user's own: a table by name, or a list of tables with `name`.

        A table by name holds one of them or, as [[effects.sensor_bias]], several; a list keeps any order.
        """
        active, known = [], CATALOGUE | {effect.name: effect for effect in own}
        for name, figures, where, key in _listed_effects(given):
            if name not in known:
                raise unknown_name("effect", name, known, key)
            if not isinstance(figures, dict):
                raise InputError(f"expected a table of its parameters, got {figures!r}", key=where)
            active.append(known[name].read(figures, where))
        check_listed_once(active)
        return tuple(active)


def _listed_effects(given: Any) -> list[tuple[str, Any, str, str]]:
    """(name, figures, key, key of the name) of each effect of the section."""
    if isinstance(given, dict):
        return [
            (name, one, f"effects.{name}.{k}" if isinstance(figures, list) and len(figures) > 1 else f"effects.{name}",
             "effects")
            for name, figures in given.items()
            for k, one in enumerate(figures if isinstance(figures, list) else [figures], start=1)
        ]  # fmt: skip
    listed = []
    for k, one in enumerate(given, start=1):
        where = f"effects.{k}"
        if not isinstance(one, dict) or not isinstance(one.get("name"), str):
            raise InputError(f"expected a table with the name of an effect, got {one!r}", key=where)
        listed.append((one["name"], {key: one[key] for key in one if key != "name"}, where, f"{where}.name"))
    return listed


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
    _add(document, "valve", _valve_lines(scenario.valve))
    _add(document, "oil", _oil_lines(scenario.oil))
    thermal = _add(document, "thermal", _thermal_lines(scenario.thermal), always=True)
    _add(thermal, "oil_temperature", _inline(write(scenario.oil_temperature, "degC", "thermal.oil_temperature")))
    commands = tomlkit.table(is_super_table=True)
    where = f"command.{drive.command_name}"
    _add(commands, drive.command_name, _inline(write(scenario.command, drive.command_unit, where)))
    document.add(tomlkit.nl())
    document.add("command", commands)
    given = {name: getattr(scenario, f"{name}_pressure") for name in PRESSURES}
    pressures = {name: write(each, "Pa", f"pressures.{name}") for name, each in given.items() if each is not None}
    _add(document, "pressures", _inline(pressures))
    _add_effects(document, scenario.effects, own)
    outputs: dict[str, Any] = {"rate": exact_text(scenario.output_rate, "Hz")}
    _add(document, "outputs", outputs | ({"channels": list(scenario.channels)} if scenario.channels else {}))
    if scenario.tolerance != defaults["tolerance"]:
        _add(document, "solver", {"tolerance": float(scenario.tolerance)})
    return document


def _add(parent: Any, name: str, lines: Mapping[str, Any], *, always: bool = False) -> Any:
    """A section with its lines, of which a pair is a value with its comment; none where there is nothing to say."""
    import tomlkit

    section = tomlkit.table()
    for key, value in lines.items():
        value, comment = value if isinstance(value, tuple) else (value, "")
        section.add(key, value)
        if comment:
            section[key].comment(comment)
    if lines or always:
        if len(parent):
            parent.add(tomlkit.nl())
        parent.add(name, section)
    return section


def _inline(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Tables within a section, each on a line of its own."""
    return {key: _on_one_line(value) for key, value in entries.items()}


def _on_one_line(value: Any) -> Any:
    import tomlkit

    if isinstance(value, dict):
        line = tomlkit.inline_table()
        for key, inner in value.items():
            line.append(key, _on_one_line(inner))
        return line
    if isinstance(value, list):
        several = tomlkit.array()
        for inner in value:
            several.append(_on_one_line(inner))
        return several
    return value


def _differing(instance: Any, reference: Any, where: str) -> dict[str, Any]:
    """Each quantity that differs from the reference, with how far it does."""
    lines: dict[str, Any] = {}
    for name, declared in quantities(reference).items():
        if np.ndim(getattr(instance, name)):
            raise InputError(
                "is an array, a batch of valves: a scenario file holds one", key=f"{where}.{name}", joint=" "
            )
        value, usual = float(getattr(instance, name)), float(getattr(reference, name))
        if value != usual:
            unit = declared.metadata["unit"]
            by = f"{100.0 * (value / usual - 1.0):+.3g} %" if usual and unit != "degC" else ""
            lines[name] = (exact_text(value, unit), by)
    return lines


def _valve_lines(valve: Valve) -> dict[str, Any]:
    law = next((name for name, law in FLOW_LAWS.items() if law is valve.flow_coefficients), None)
    if law is None:
        problem = f"the valve has a law of its own; a scenario knows {', '.join(FLOW_LAWS)}"
        raise InputError(problem, key="valve.flow_law")
    named = {} if FLOW_LAWS[law] is Valve().flow_coefficients else {"flow_law": law}
    return named | _differing(valve, Valve(), "valve")


def _oil_lines(oil: Oil) -> dict[str, Any]:
    own = OILS.get(oil.name)
    columns: dict[str, Any] = {"name": oil.name}
    if own is None or own.viscosity_law != oil.viscosity_law:
        columns |= dict(own_columns(oil))
    read = read_oil(columns)
    lines = columns | _differing(oil, read, "oil")
    figures = {name: getattr(oil, name) for name in quantities(oil)}
    if dataclasses.replace(read, **figures) != oil:
        raise InputError(
            f"{oil.name!r} has laws that no table holds; a scenario knows {', '.join(OILS)}", key="oil.name"
        )
    return lines


def _thermal_lines(thermal: Thermal) -> dict[str, Any]:
    lines: dict[str, Any] = {"isothermal": True} if thermal.network is None else {}
    if thermal.routes != ROUTES:
        lines["routes"] = list(thermal.routes)
    if thermal.throttling_heat:
        lines["throttling_heat"] = True
    initial = thermal.initial_temperature
    if isinstance(initial, Mapping):
        lines["initial_temperature"] = _on_one_line({name: exact_text(t, "degC") for name, t in initial.items()})
    elif initial is not None:
        lines["initial_temperature"] = exact_text(initial, "degC")
    lines |= _differing(thermal, Thermal(), "thermal")
    return lines if thermal.network is None else lines | _differing(thermal.network, ThermalNetwork(), "thermal")


def _add_effects(document: Any, effects: Sequence[ActiveEffect], own: Sequence[Effect]) -> None:
    """The effects: by name where that keeps their order, else as a list."""
    import tomlkit

    known = CATALOGUE | {effect.name: effect for effect in own}
    for active in effects:
        effect, channel = known.get(active.effect.name), active.effect.channel
        if effect is None or (effect.on(channel) if channel and effect.reading else effect) != active.effect:
            problem = "comes from no file that a scenario could name (effects_files)"
            raise InputError(problem, key=f"effects.{active.effect.name}")
    names = [active.effect.name for active in effects]
    if sorted(names, key=names.index) != names:
        listed = tomlkit.aot()
        for active in effects:
            listed.append(_table({"name": active.effect.name} | _effect_lines(active)))
        document.add(tomlkit.nl())
        document.add("effects", listed)
        return
    section = tomlkit.table(is_super_table=True)
    for name in dict.fromkeys(names):
        several = [active for active in effects if active.effect.name == name]
        if len(several) == 1 and not several[0].effect.channel:
            _add(section, name, _effect_lines(several[0]))
            continue
        listed = tomlkit.aot()
        for active in several:
            listed.append(_table(_effect_lines(active)))
        if len(section):
            section.add(tomlkit.nl())
        section.add(name, listed)
    if effects:
        document.add(tomlkit.nl())
        document.add("effects", section)


def _table(lines: Mapping[str, Any]) -> Any:
    import tomlkit

    table = tomlkit.table()
    for key, value in lines.items():
        table.add(key, value)
    return table


def _effect_lines(active: ActiveEffect) -> dict[str, Any]:
    effect = active.effect
    figures = zip(effect.parameters, active.numbers, strict=True)
    lines = {parameter.name: exact_text(value, parameter.unit) for parameter, value in figures}
    return ({"channel": effect.channel} if effect.channel else {}) | lines
