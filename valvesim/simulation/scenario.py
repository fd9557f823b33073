"""A scenario: valve, oil, temperatures, commands, effects and outputs; read strictly from TOML.

Every figure in a file is text with its unit. Whatever is unknown, misspelled, of the wrong dimension or out of range is
an InputError with file, line and key.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name, warn_once
from valvesim.inputs import (
    COMMANDS,
    PIECE_WIDTH,
    VALUE,
    Command,
    Constant,
    Scaled,
    Sum,
    Table,
    evaluate,
    extremes,
    read_table,
    turns,
)  # fmt: skip
from valvesim.io import DEEPEST, MOST_TEXT, check_printable, keys_of, line_of_key, read_toml
from valvesim.units import POSITIVE, change, check_bounds, parse, parse_list, quantities, quantity
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import ROUTES, check_routes
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.effect_files import load_effects_files
from valvesim.valve.equations import CurrentDrive, Model, VoltageDrive
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.fluid import COMPUTED_RANGE, MIL_PRF_5606, Oil
from valvesim.valve.oils import read_oil
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import (
    NODES,
    TemperaturePath,
    ThermalNetwork,
    temperature_path,
    throttling_rise,
)

MOST_SAMPLES = 2e7  # of a result: 5 GB
MOST_OIL_PIECES, MOST_OIL_TURNS = 100_000, 20_000  # of the oil temperature: each takes knots of every coefficient


@dataclass(frozen=True, kw_only=True)
class Thermal:
    """How the parts follow the oil. `network` None is isothermal; `routes` are the temperature routes that act.

    `initial_temperature` is where the parts start, °C: one for all, or by part (names of `NODES`); a part that is left
    out, or all of them with None, starts with the oil.
    """

    network: ThermalNetwork | None = ThermalNetwork()
    routes: tuple[str, ...] = ROUTES
    throttling_heat: bool = False
    ambient_temperature: float = quantity(20.0, "degC", "air around the valve", (-100.0, 400.0), "")
    initial_temperature: float | Mapping[str, float] | None = None

    def __post_init__(self):
        check_bounds(self)
        check_routes(self.routes)
        low, high = quantities(self)["ambient_temperature"].metadata["bounds"]
        given = self.initial_temperature
        for name, value in given.items() if isinstance(given, Mapping) else (("every part", given),):
            if name not in NODES and name != "every part":
                raise unknown_name("part", name, NODES, "thermal.initial_temperature")
            if value is not None and not low <= value <= high:
                key = f".{name}" if name in NODES else ""
                raise InputError(
                    f"thermal.initial_temperature{key} = {value:.6g} °C is outside [{low:g}, {high:g}] °C "
                    f"({name.replace('_', ' ')} at the start)"
                )


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Everything that a run needs, in SI; temperatures in °C. Pressures default to the valve's own."""

    title: str = "valve"
    duration: float = quantity(1.0, "s", "duration of the run", (POSITIVE, 1e5), "")
    valve: Valve = field(default_factory=Valve)
    oil: Oil = MIL_PRF_5606
    thermal: Thermal = field(default_factory=Thermal)
    oil_temperature: Command = Constant(value=20.0)
    command: Command = Constant(value=0.0)
    drive: CurrentDrive | VoltageDrive = CurrentDrive()
    supply_pressure: Command | None = None
    return_pressure: Command | None = None
    load_pressure: Command | None = None
    effects: tuple[ActiveEffect, ...] = ()
    output_rate: float = quantity(1000.0, "Hz", "output samples per second", (POSITIVE, 1e7), "")
    channels: tuple[str, ...] = ()
    tolerance: float = quantity(5e-5, "1", "relative tolerance of the integration", (1e-10, 1e-2), "")

    def __post_init__(self):
        check_bounds(self)
        check_printable(self.title, "title")
        check_listed_once(self.effects)
        for name in ("supply", "return", "load"):
            if np.ndim(getattr(self.valve, f"{name}_pressure")):
                raise InputError(f"valve.{name}_pressure is an array: the valves of a batch run at one {name} pressure")
        self._check_sizes()
        self._check_pressures()
        self._check_oil_temperature()

    def _check_sizes(self) -> None:
        """Bounds on what a run holds in memory, before any of it is made."""
        end = self.duration
        if end * self.output_rate > MOST_SAMPLES:
            raise InputError(
                f"outputs.rate: {self.output_rate:g} Hz over {end:g} s makes more than {MOST_SAMPLES:g} samples; "
                "lower the rate or the duration"
            )
        drive = "voltage" if isinstance(self.drive, VoltageDrive) else "current"
        oil, pressures = self.oil_temperature, zip(("supply", "return", "load"), self.pressures(), strict=True)
        given = {f"command.{drive}": self.command, "thermal.oil_temperature": oil}
        for where, command in (given | {f"pressures.{name}": pressure for name, pressure in pressures}).items():
            try:
                rows = command.pieces(end)
            except InputError as error:
                raise InputError(f"{where}.{error}") from None
            if command is oil:
                count = np.count_nonzero(rows[:, 0] < end)
                if count > MOST_OIL_PIECES:
                    raise InputError(f"{where}: {count} pieces are more than {MOST_OIL_PIECES}")
                if rows.shape[1] > PIECE_WIDTH and (waves := turns(rows, end)) > MOST_OIL_TURNS:
                    raise InputError(f"{where}: {waves:.4g} periods within {end:g} s are more than {MOST_OIL_TURNS}")

    def _check_pressures(self) -> None:
        """None may ever be negative, the return never above the supply, nor the load beyond it; at each instant."""
        end, (supply, back, load) = self.duration, self.pressures()
        commands = {"supply": supply, "return": back, "load": load}
        reach = {name: extremes(command, end) for name, command in commands.items()}
        for name in ("supply", "return"):
            if not reach[name].lowest >= 0.0:
                raise InputError(
                    f"pressures.{name}: {reach[name].lowest / 1e5:.4g} bar at t = {reach[name].lowest_at:.6g} s is "
                    "negative; it is absolute"
                )
        try:
            _ = self.valve_at_start
        except InputError as error:
            raise InputError(f"pressures: at the start of the run, {error}") from None
        least = reach["supply"].lowest
        if least > reach["return"].highest and least >= max(reach["load"].highest, -reach["load"].lowest):
            return  # never near each other, whatever the instant
        drop = extremes(Sum((supply, Scaled(back, -1.0))), end)
        if not drop.lowest > 0.0:
            above = f"{-drop.lowest / 1e5:.4g} bar above" if drop.lowest < 0.0 else "at"
            raise InputError(f"pressures.return: {above} the supply pressure at t = {drop.lowest_at:.6g} s")
        room = 1e-9 * float(np.max(np.abs(supply.pieces(end)[:, 1])))  # rounding
        for side in (-1.0, 1.0):
            left = extremes(Sum((supply, Scaled(load, side))), end)
            if not left.lowest >= -room:
                raise InputError(
                    f"pressures.load: {-left.lowest / 1e5:.4g} bar beyond the supply pressure at "
                    f"t = {left.lowest_at:.6g} s"
                )

    def _check_oil_temperature(self) -> None:
        """It may never leave what the laws of the oil are computed for."""
        reach, (low, high) = extremes(self.oil_temperature, self.duration), COMPUTED_RANGE
        for value, when in ((reach.highest, reach.highest_at), (reach.lowest, reach.lowest_at)):
            if not low <= value <= high:
                raise InputError(
                    f"thermal.oil_temperature: oil {self.oil.name}: {value:.4g} °C at t = {when:.6g} s is outside "
                    f"{low:g} to {high:g} °C, beyond which no law of the oil is computed"
                )

    @property
    def valve_at_start(self) -> Valve:
        """The valve at the pressures that are commanded at the start, for what is static."""
        supply, back, load = (float(evaluate(pressure, 0.0)) for pressure in self.pressures())
        return dataclasses.replace(self.valve, supply_pressure=supply, return_pressure=back, load_pressure=load)

    @property
    def model(self) -> Model:
        """The equations that this scenario integrates: effects without a balance act before them or after."""
        acting = [active.effect for active in self.effects]
        return Model(self.drive, tuple(effect for effect in acting if effect.balance is not None))

    def pressures(self) -> tuple[Command, Command, Command]:
        """Supply, return and load pressure over time."""
        given = (self.supply_pressure, self.return_pressure, self.load_pressure)
        own = (self.valve.supply_pressure, self.valve.return_pressure, self.valve.load_pressure)
        return tuple(  # type: ignore[return-value]
            Constant(value=value) if command is None else command for command, value in zip(given, own, strict=True)
        )

    def throttling(self):
        """The oil's temperature rise by throttling as a function of °C, or None where it is off; drop of the start."""
        valve = self.valve_at_start
        drop = valve.supply_pressure - valve.return_pressure
        return throttling_rise(self.oil, drop) if self.thermal.throttling_heat else None

    def temperatures(self, *, spacing: float = 0.1, knots: np.ndarray | None = None) -> TemperaturePath:
        """Oil and part temperatures of the run on `knots`, or on some at most `spacing` s apart."""
        thermal = self.thermal
        path = temperature_path(
            self.oil_temperature,
            self.duration,
            network=thermal.network,
            initial=thermal.initial_temperature,
            ambient=thermal.ambient_temperature,
            throttling=self.throttling(),
            spacing=spacing,
            knots=knots,
        )
        for active in self.effects:
            if active.effect.temperatures is not None:
                parts = active.effect.temperatures(path.times, path.parts, active.values)
                path = dataclasses.replace(path, parts=parts)
        return path

    def warn_of_large_command(self) -> None:
        """Warn once where the command goes beyond the rated current."""
        reach, rated = extremes(self.command, self.duration), self.valve.rated_current
        top, when = max((-reach.lowest, reach.lowest_at), (reach.highest, reach.highest_at))
        top = self.drive.current_for_command(top, np.min(self.valve.coil_resistance))
        if top > np.min(rated) * (1 + 1e-9):
            warn_once(
                f"command: up to {top * 1e3:.4g} mA (t = {when:.4g} s) is beyond the rated current of "
                f"{np.min(rated) * 1e3:.4g} mA; spool and flapper may reach their stops"
            )


MOST_ON_A_CHANNEL = 8  # sensor effects of one name: a stated error, what a diagnosis adds, and some more


def check_listed_once(effects: Sequence[ActiveEffect]) -> None:
    """InputError for an effect that acts twice in one place, where its figures (and states) would be lost or mixed.

    The place is its `side` where it has one. Effects on a sensor act one after the other, as one that a diagnosis finds
    beside a stated one does: up to `MOST_ON_A_CHANNEL` of a name on a channel.
    """
    seen: Counter[tuple[Any, ...]] = Counter()
    for active in effects:
        one, side = active.effect, getattr(active.values, "side", None)
        place = (one.name, one.channel, None if side is None else np.asarray(side, dtype=float).tobytes())
        seen[place] += 1
        if one.reading is not None and seen[place] > MOST_ON_A_CHANNEL:
            raise InputError(f"effects.{one.name}: acts more than {MOST_ON_A_CHANNEL} times on {one.channel}")
        if one.reading is None and seen[place] > 1:
            where = "" if side is None else f" on side {side:g}"
            raise InputError(f"effects.{one.name}: acts twice{where}; give it once")


def load_scenario(path: str | Path, *, settings: Sequence[str] = ()) -> Scenario:
    """Read a scenario file; `settings` such as `valve.null_gap=0.03 mm` override or add keys.

    Raises InputError for a missing file, broken TOML, or any key or figure that makes no sense.
    """
    path = Path(path)
    text, table = read_toml(path)
    for setting in settings:
        _override(table, setting)
    with located(path, text, settings):
        return Reader(path.parent).scenario(table)


@contextmanager
def located(path: Path, text: str, settings: Sequence[str] = ()) -> Iterator[None]:
    """An InputError from inside gets the file and line of the key that it speaks of, or the setting that it does."""
    try:
        yield
    except InputError as error:
        message = str(error)
        for own, key in _KEYS.items():
            message = message.replace(own, key)
        for setting in settings:
            if _speaks_of(_dotted(message), setting.partition("=")[0].strip()):
                raise InputError(f"--set {setting!r}: {message}") from None
        line = line_of_key(text, keys_of(_dotted(message)))
        raise InputError(f"{path}{f', line {line}' if line else ''}: {message}") from None


_KEYS = {
    "scenario.duration": "duration", "scenario.output_rate": "outputs.rate", "scenario.tolerance": "solver.tolerance",
    "valve: valve.": "valve.", "oil: oil.": "oil.", "thermal: thermalnetwork.": "thermal.",
}  # fmt: skip
"""How a message names a figure -> its key in a scenario file."""


def _dotted(message: str) -> str:
    """The message with an unknown name written as a dotted key: `valve: unknown key 'x'` as `valve.x`."""
    dotted = re.sub(r"([\w.]+): unknown [\w ]+ '([^']+)'", r"\1.\2", message)
    return dotted.removeprefix("scenario.").removeprefix("session.")


def _speaks_of(message: str, key: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(key)}(?![\w])", message) is not None


def read_tables(settings: Sequence[str]) -> tuple[Valve, Oil]:
    """The reference valve and oil with settings such as `valve.null_gap=0.03 mm`; nothing else may be set."""
    table: dict[str, Any] = {}
    for setting in settings:
        _override(table, setting)
    reader = Reader(Path())
    reader.known(table, ("valve", "oil"), "--set")
    return read_valve(table.get("valve", {})), reader.oil(table.get("oil", {}))


def read_valve(table: dict[str, Any]) -> Valve:
    """The reference valve with figures from a table; `flow_law` names the law of the pilot's flow coefficients."""
    figures = dict(table)
    law = figures.pop("flow_law", "yan_2019")
    if law not in FLOW_LAWS:
        raise unknown_name("flow law", str(law), FLOW_LAWS, "valve.flow_law")
    return dataclasses.replace(change(Valve(), figures, "valve"), flow_coefficients=FLOW_LAWS[law])


def _override(table: dict[str, Any], setting: str) -> None:
    key, equals, text = setting.partition("=")
    names = [name.strip() for name in key.split(".")]
    if not equals or not all(names):
        raise InputError(f"--set {setting!r}: expected KEY=VALUE, such as valve.null_gap='0.03 mm'")
    for name in names[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise InputError(f"--set {setting!r}: {name!r} is a value, not a table")
    if len(names) > DEEPEST or len(text) > MOST_TEXT:
        raise InputError(f"--set {setting!r}: is too long")
    try:
        table[names[-1]] = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        table[names[-1]] = text.strip()


def check_sum_of_temperatures(table: dict[str, Any], where: str) -> None:
    """In a sum of commands 80 K may be a temperature or a difference: InputError unless levels are given in °C."""
    for kind, figures in table.items():
        levels = {f.name for f in dataclasses.fields(COMMANDS[kind]) if f.metadata.get("unit") == VALUE} if (
            kind in COMMANDS
        ) else {"values"}  # fmt: skip
        given = figures if isinstance(figures, dict) else {"value": figures}
        for name, text in given.items():
            if name in levels and not str(text).rstrip().endswith(("degC", "°C")):
                raise InputError(
                    f"{where}.{kind}.{name}: {text!r} in a sum of commands may be a temperature or a difference; "
                    "write it in degC"
                )


@dataclass(frozen=True)
class Reader:
    """Turns TOML tables into a scenario; `folder` is where relative file names start."""

    folder: Path

    def scenario(self, table: dict[str, Any]) -> Scenario:
        self.known(table, ("title", "duration", "effects_files", *self._SECTIONS), "scenario")
        for name in self._SECTIONS:
            if not isinstance(table.get(name, {}), dict):
                raise InputError(f"{name}: expected a table, got {table[name]!r}")
        if "duration" not in table:
            raise InputError("duration is missing, such as duration = '1 s'")
        thermal = dict(table.get("thermal", {}))
        oil_temperature = thermal.pop("oil_temperature", None)
        commands = table.get("command", {})
        self.known(commands, ("current", "voltage"), "command")
        if len(commands) != 1:
            raise InputError("command: give either [command.current] or [command.voltage]")
        kind, command = next(iter(commands.items()))
        pressures = table.get("pressures", {})
        self.known(pressures, ("supply", "return", "load"), "pressures")
        valve = read_valve(table.get("valve", {}))
        outputs, solver = table.get("outputs", {}), table.get("solver", {})
        self.known(outputs, ("rate", "channels"), "outputs")
        self.known(solver, ("tolerance",), "solver")
        fields = quantities(Scenario)
        options: dict[str, Any] = {}
        for key, source, name in (
            ("duration", table, "duration"), ("output_rate", outputs, "rate"), ("tolerance", solver, "tolerance")
        ):  # fmt: skip
            if name in source:
                where = name if source is table else f"{'outputs' if source is outputs else 'solver'}.{name}"
                options[key] = parse(source[name], fields[key].metadata["unit"], where)
        for name in ("supply", "return", "load"):
            if name in pressures:
                key = f"{name}_pressure"
                options[key] = self.command(pressures[name], "Pa", f"pressures.{name}", key)
        if oil_temperature is not None:
            options["oil_temperature"] = self.command(
                oil_temperature, "degC", "thermal.oil_temperature", "oil_temperature"
            )
        return Scenario(
            title=table.get("title", "valve"),
            valve=valve,
            oil=self.oil(table.get("oil", {})),
            thermal=self.thermal(thermal),
            command=self.command(command, "A" if kind == "current" else "V", f"command.{kind}", kind),
            drive=CurrentDrive() if kind == "current" else VoltageDrive(),
            effects=self.effects(table.get("effects", {}), self.own_effects(table)),
            channels=self.names(outputs.get("channels", []), "outputs.channels", "channel"),
            **options,
        )

    _SECTIONS = ("valve", "oil", "thermal", "command", "pressures", "effects", "outputs", "solver")

    _THERMAL_KEYS = (
        "routes", "isothermal", "throttling_heat", "initial_temperature", "ambient_temperature", "oil_temperature",
    )  # fmt: skip

    def oil(self, table: dict[str, Any]) -> Oil:
        """The oil of a table, or of the file that it names; keys beside `file` take the place of the file's."""
        if "file" not in table:
            return read_oil(table)
        name = table["file"]
        if not isinstance(name, str) or not name:
            raise InputError(f"oil.file: expected the name of a TOML file, got {name!r}")
        path = self.folder / name
        text, own = read_toml(path, "oil.file names it")
        whole = set(own) == {"oil"} and isinstance(own["oil"], dict)
        with located(path, text):
            read_oil(own["oil"] if whole else own, "oil" if whole else "")
        return read_oil((own["oil"] if whole else own) | {key: table[key] for key in table if key != "file"})

    def thermal(self, table: dict[str, Any]) -> Thermal:
        figures = dict(table)
        routes = figures.pop("routes", list(ROUTES))
        self.names(routes, "thermal.routes", "route")
        isothermal, heat = (self._switch(figures, name) for name in ("isothermal", "throttling_heat"))
        initial = figures.pop("initial_temperature", None)
        ambient = figures.pop("ambient_temperature", None)
        try:
            network = change(ThermalNetwork(), figures, "thermal")
        except InputError as error:
            if "unknown parameter" not in str(error):
                raise
            wrong = next(name for name in figures if name not in quantities(ThermalNetwork))
            raise unknown_name("key", wrong, (*quantities(ThermalNetwork), *self._THERMAL_KEYS), "thermal") from None
        try:
            routes = tuple(sorted(check_routes(routes), key=ROUTES.index))
        except InputError as error:
            raise InputError(f"thermal.routes: {error}") from None
        options = {} if ambient is None else {
            "ambient_temperature": parse(ambient, "degC", "thermal.ambient_temperature")
        }  # fmt: skip
        return Thermal(
            network=None if isothermal else network,
            routes=routes,
            throttling_heat=heat,
            initial_temperature=self.initial(initial, "thermal.initial_temperature"),
            **options,
        )

    def initial(self, given: Any, where: str) -> float | dict[str, float] | None:
        """Where the parts start, °C: one figure for all, a table by part, or none."""
        if isinstance(given, dict):
            self.known(given, NODES, where)
            return {name: parse(text, "degC", f"{where}.{name}") for name, text in given.items()}
        return None if given is None else parse(given, "degC", where)

    def own_effects(self, table: dict[str, Any]) -> tuple[Effect, ...]:
        """The user's own effects, of the files that the top-level key `effects_files` names."""
        files = self.names(table.get("effects_files", []), "effects_files", "file")
        return load_effects_files(self.folder, files)

    def effects(self, table: dict[str, Any], own: Sequence[Effect] = ()) -> tuple[ActiveEffect, ...]:
        """The active effects: of the catalogue, or the user's own."""
        active, known = [], CATALOGUE | {effect.name: effect for effect in own}
        for name, figures in table.items():
            if name not in known:
                raise unknown_name("effect", name, known, "effects")
            several = figures if isinstance(figures, list) else [figures]  # [[effects.sensor_bias]]: one a channel
            for one in several:
                if not isinstance(one, dict):
                    raise InputError(f"effects.{name}: expected a table of its parameters, got {one!r}")
                active.append(known[name].read(one, f"effects.{name}"))
        check_listed_once(active)
        return tuple(active)

    def command(self, table: Any, unit: str, where: str, column: str) -> Command:
        """One command, or the sum of several that stand in one table; text alone is a constant."""
        if not isinstance(table, dict):
            return Constant(value=parse(table, unit, where))
        if not table:
            raise InputError(f"{where}: needs a command, one of {', '.join((*COMMANDS, 'table'))}")
        terms = []
        for name, figures in table.items():
            if name == "table":
                terms.append(self._table(figures, unit, f"{where}.table", column))
                continue
            if name not in COMMANDS:
                raise unknown_name("command", name, (*COMMANDS, "table"), where)
            if name == "constant" and not isinstance(figures, dict):
                figures = {"value": figures}
            if not isinstance(figures, dict):
                raise InputError(f"{where}.{name}: expected a table such as {{ ... }}, got {figures!r}")
            terms.append(self._one(COMMANDS[name], dict(figures), unit, f"{where}.{name}"))
        if unit == "degC" and len(terms) > 1:
            check_sum_of_temperatures(table, where)
        return terms[0] if len(terms) == 1 else Sum(tuple(terms))

    def _one(self, kind: Any, figures: dict[str, Any], unit: str, where: str) -> Command:
        names = {f.name: f for f in dataclasses.fields(kind)}
        difference = "delta_degC" if unit == "degC" else unit
        values: dict[str, Any] = {}
        for name, given in figures.items():
            if name not in names:
                raise unknown_name("key", name, names, where)
            if "unit" not in names[name].metadata:
                values[name] = self._switch(figures.copy(), name, where)
                continue
            own = names[name].metadata["unit"]
            own = {VALUE: unit, VALUE + "_difference": difference, VALUE + "/s": f"{difference}/s"}.get(own, own)
            values[name] = parse(given, own, f"{where}.{name}")
        try:
            return kind(**values)
        except InputError as error:
            message = str(error).replace("value/s", f"{difference}/s").replace("value_difference", difference)
            raise InputError(f"{where.rpartition('.')[0]}.{message}") from None

    def _table(self, figures: Any, unit: str, where: str, column: str) -> Command:
        """Points of a CSV file (`start`: the file's time that is the run's zero), or of two lists in the text."""
        if isinstance(figures, dict) and figures.keys() >= {"times", "values"}:
            self.known(figures, ("times", "values"), where)
            times = parse_list(figures["times"], "s", f"{where}.times")
            values = parse_list(figures["values"], unit, f"{where}.values")
            return Table(times=tuple(times.tolist()), values=tuple(values.tolist()), where=where)
        if not isinstance(figures, dict) or not isinstance(figures.get("file"), str):
            raise InputError(f"{where}: expected {{ file = 'name.csv' }}, got {figures!r} (or lists: times, values)")
        self.known(figures, ("file", "column", "start"), where)
        start = parse(figures.get("start", "0 s"), "s", f"{where}.start")
        try:
            read = read_table(self.folder / figures["file"], str(figures.get("column", column)), unit)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        return dataclasses.replace(read, times=tuple((np.asarray(read.times) - start).tolist())) if start else read

    @staticmethod
    def names(given: Any, where: str, what: str) -> tuple[str, ...]:
        if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
            raise InputError(f"{where}: expected a list of {what} names, got {given!r}")
        return tuple(given)

    @staticmethod
    def _switch(table: dict[str, Any], name: str, where: str = "thermal") -> bool:
        value = table.pop(name, False)
        if not isinstance(value, bool):
            raise InputError(f"{where}.{name}: expected true or false, got {value!r}")
        return value

    @staticmethod
    def known(table: dict[str, Any], names: Sequence[str], where: str) -> None:
        for name in table:
            if name not in names:
                raise unknown_name("key", name, names, where)
