"""A measured test session: a folder with `session.toml` and CSV records, read strictly and audited before it is used.

What makes no sense is an InputError with file and line or key. What merely carries no information (a record that never
moves, a stuck or saturated sensor) is left out, and `Session.notes` says so in words.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from .channels import INPUT_CHANNELS, SIGNAL_CHANNELS, STATE_CHANNELS
from .commands import Command, Constant, Table
from .effects import ActiveEffect, Effect
from .errors import InputError, nearest, unknown_name
from .files import _HEADER, read_columns
from .fluid import COMPUTED_RANGE, Oil
from .model import CurrentDrive, VoltageDrive
from .parameters import REFERENCE_TEMPERATURE, Valve
from .scenario import Reader, Scenario, Thermal, located, read_toml, read_valve
from .units import DISPLAY, convert, parse, quantities, symbol
from .user_effects import load_effects_files

INPUTS = (
    "current", "voltage", "oil_temperature", "supply_pressure", "return_pressure", "load_pressure", "body_temperature",
)  # fmt: skip
"""Columns that say what acts on the valve."""
OUTPUTS = (
    "spool_position", "armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "load_flow", "internal_leakage",
    "current",
)  # fmt: skip
"""Columns that the model is held against; `current` only where the drive is a voltage."""

_MODEL_UNITS = {channel.name: channel.unit for channel in (*STATE_CHANNELS, *INPUT_CHANNELS, *SIGNAL_CHANNELS)}
UNITS = {"time": "s", "voltage": "V", "oil_temperature": "degC", "body_temperature": "degC"} | {
    name: _MODEL_UNITS[name] for name in (*INPUTS, *OUTPUTS) if name in _MODEL_UNITS
}
# Where the output goes when the command goes up, so that a flat top can be told from rest; leakage goes down both ways.
_SIGN = {name: 1.0 for name in OUTPUTS} | {"nozzle_pressure_2": -1.0, "internal_leakage": 0.0}

LEAST_SAMPLES = 50  # of a record
CLOCK_JITTER, GAP = 0.02, 1.5  # of the median step: what a step may differ, and where a longer one is a gap
REPEAT_MISMATCH = 0.05  # of the input's span: rms difference of inputs between repeats
LEAST_MOTION, NOISE_MOTION = 1e-3, 5e-3  # of an input's scale: a span at rest; white noise, rms, of a sensor at rest
FLAT_SAMPLES = 10  # equal readings in a row at the extreme that make a flat top
FLAT_REACH = 0.05  # of the output's span: what the command must ask for beyond a flat top
FINEST_GRID = 1e-4  # of the channel's span: a finer grid is the writing of the file, not the sensor
OVERSHOOT = 0.02  # of the supply: by so much a measured load pressure may exceed it
LOCKED_SHARE = 0.25  # of the tests, locked away where the session names none
OIL_INTERVALS, OIL_RESOLUTION = 400, 0.05  # most straight lines, and K to which they follow a record's oil temperature


@dataclass(frozen=True)
class Sensor:
    """What is known of a sensor, in the channel's SI unit: noise (standard deviation, None if unknown), resolution
    (0 if unknown), first-order lag s, and the range outside which it saturates.
    """  # fmt: skip

    channel: str
    unit: str
    noise: float | None = None
    resolution: float = 0.0
    lag: float = 0.0
    range: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Record:
    """One measured record on an even clock: `time` (n,) s from 0, `values[column]` (n,) in SI, temperatures in °C.

    `usable[channel]` (n,) is False where the sensor is saturated. An input that carries nothing but noise is held at
    its mean. `role` is "train" or "test"; records with one label `repeats` are repeats of one test. `path` is its file.
    """

    name: str
    time: np.ndarray
    values: dict[str, np.ndarray]
    usable: dict[str, np.ndarray]
    role: str = "train"
    repeats: str | None = None
    path: Path | None = None

    @property
    def duration(self) -> float:
        """From the first to the last sample, s."""
        return float(self.time[-1])

    @property
    def rate(self) -> float:
        """Samples per second, Hz."""
        return (len(self.time) - 1) / self.duration

    @property
    def pace(self) -> float:
        """The rate to four digits: records of one pace share their noise, whatever their clocks' last digits."""
        return float(f"{self.rate:.4g}")

    @property
    def command(self) -> str:
        """The column that drives the valve: `voltage` where there is one, else `current`."""
        return "voltage" if "voltage" in self.values else "current"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns that act on the valve: the command, temperatures and pressures."""
        return (self.command, *(name for name in INPUTS[2:] if name in self.values))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the output channels that can be used."""
        return tuple(self.usable)

    @property
    def test(self) -> str:
        """The test that this record belongs to: its repeats' label, else its own name."""
        return self.name if self.repeats is None else f"repeats {self.repeats!r}"

    def moves(self, *names: str) -> bool:
        """Whether any of these inputs moves; without names, any at all but the body's temperature."""
        names = names or tuple(name for name in self.inputs if name != "body_temperature")
        return any(np.ptp(self.values[name]) > 0.0 for name in names)


@dataclass(frozen=True, eq=False)
class Session:
    """A session that passed the audit. `effects` are known and in the base model, `user_effects` join the search and
    come from `effects_files`.

    `tolerances` are half-widths in SI of valve parameters, where the session overrides them; `sensors` has one entry
    for each output channel that any record has; `notes` say in words what was found, left out and cannot be claimed.
    """

    folder: Path
    title: str
    seed: int
    valve: Valve
    oil: Oil
    thermal: Thermal
    effects: tuple[ActiveEffect, ...]
    user_effects: tuple[Effect, ...]
    tolerances: dict[str, float]
    sensors: dict[str, Sensor]
    records: tuple[Record, ...]
    notes: tuple[str, ...]
    effects_files: tuple[Path, ...] = ()

    @property
    def training(self) -> tuple[Record, ...]:
        """The records that the search may see."""
        return tuple(record for record in self.records if record.role == "train")

    @property
    def locked(self) -> tuple[Record, ...]:
        """The records that are locked away until the gain is told."""
        return tuple(record for record in self.records if record.role == "test")

    @property
    def drive(self) -> CurrentDrive | VoltageDrive:
        """How the coils are driven, the same in every record."""
        return VoltageDrive() if self.records[0].command == "voltage" else CurrentDrive()


def load_session(folder: str | Path, *, seed: int | None = None, effects: Sequence[str | Path] = ()) -> Session:
    """Read a session folder and audit it.

    `seed` takes the place of the session's own; `effects` are further files of a user's own effects.

    Raises InputError (file, line, key) for a missing or broken `session.toml`, unknown keys, and records that make no
    sense: see the module's tests for every case.
    """
    folder = Path(folder)
    path = folder / "session.toml"
    text, table = read_toml(path, "a session is a folder with session.toml and CSV records")
    text = _numbered(text)
    with located(path, text):
        session = _settings(folder, table, tuple(Path(file).absolute() for file in effects))
        if seed is not None:
            session = replace(session, seed=_seed(seed))
        listed = _listed(folder, table.get("records"))
        stated = _stated_sensors(table.get("sensors", {}))
    notes: list[str] = []
    records = [_read_record(folder, session, notes, *each) for each in listed]
    _check_drive(records)
    _check_repeats(records, session.valve)
    with located(path, text):
        sensors = _sensors(stated, records, notes)
    records = [usable for record in records if (usable := _usable(record, sensors, notes)) is not None]
    if not any(record.moves() for record in records):
        raise InputError(f"{folder}: no record is left that moves and has a usable output channel: {'; '.join(notes)}")
    records = _lock_away(records, session.seed, notes)
    if all(record.role == "test" for record in records):
        raise InputError(f"{folder}: every record has role = 'test', so none is left to learn from")
    return replace(session, sensors=sensors, records=tuple(records), notes=tuple(notes))


def record_scenario(
    session: Session,
    record: Record,
    *,
    valve: Valve | None = None,
    effects: tuple[ActiveEffect, ...] | None = None,
    tolerance: float = 1e-5,
) -> Scenario:
    """The base scenario of a record: its measured inputs drive the valve, its sample times are the result's.

    `valve` and `effects` take the place of the session's. The oil temperature is smoothed and followed to 0.1 K.
    """
    commands = {name: _input(record, name) for name in record.inputs if name != "body_temperature"}
    return Scenario(
        title=f"{session.title}: {record.name}",
        duration=record.duration,
        valve=session.valve if valve is None else valve,
        oil=session.oil,
        thermal=session.thermal,
        drive=session.drive,
        command=commands.pop(record.command),
        effects=session.effects if effects is None else effects,
        output_rate=record.rate,
        tolerance=tolerance,
        **commands,  # type: ignore[arg-type]  # oil temperature and pressures, by the scenario's own names
    )


# ---------------------------------------------------------------- session.toml


_TABLES = ("valve", "oil", "thermal", "effects", "tolerances", "sensors")
_ROLES = ("train", "test")


def _numbered(text: str) -> str:
    """The text with each [[records]] numbered from 1, as the messages name them."""
    numbers = count(1)
    return re.sub(r"(?m)^[ \t]*\[\[\s*records\s*\]\]", lambda _: f"[records.{next(numbers)}]", text)


def _settings(folder: Path, table: dict[str, Any], more_effects: tuple[Path, ...]) -> Session:
    """Everything in `session.toml` but sensors and records, with more files of effects."""
    reader = Reader(folder)
    reader.known(table, ("title", "seed", "effects_files", "records", *_TABLES), "session")
    for name in _TABLES:
        if not isinstance(table.get(name, {}), dict):
            raise InputError(f"{name}: expected a table, got {table[name]!r}")
    title = table.get("title", folder.resolve().name)
    if not isinstance(title, str):
        raise InputError(f"title: expected text, got {title!r}")
    if "oil_temperature" in table.get("thermal", {}):
        raise InputError("thermal.oil_temperature: comes from the records (column 'oil_temperature [degC]')")
    valve = read_valve(table.get("valve", {}))
    named = reader.names(table.get("effects_files", []), "effects_files", "file")
    files: tuple[str | Path, ...] = (*named, *more_effects)
    own = load_effects_files(folder, files)
    return Session(
        folder=folder,
        title=title,
        seed=_seed(table.get("seed", 0)),
        valve=valve,
        oil=reader.oil(table.get("oil", {})),
        thermal=reader.thermal(table.get("thermal", {})),
        effects=reader.effects(table.get("effects", {}), own),
        user_effects=own,
        effects_files=tuple(folder.absolute() / file for file in files),
        tolerances={name: _tolerance(valve, name, text) for name, text in table.get("tolerances", {}).items()},
        sensors={},
        records=(),
        notes=(),
    )


def _seed(given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, int) or given < 0:
        raise InputError(f"seed: expected a whole number, 0 or more, got {given!r}")
    return given


def _tolerance(valve: Valve, name: str, text: Any) -> float:
    """The half-width of a valve parameter in SI, from a share of its value or a quantity."""
    declared, where = quantities(valve), f"tolerances.{name}"
    if name not in declared:
        raise unknown_name("valve parameter", name, declared, "tolerances")
    if isinstance(text, str) and text.rstrip().endswith("%"):
        size = abs(getattr(valve, name))
        if size == 0.0:
            unit = declared[name].metadata["unit"]
            raise InputError(f"{where}: {name} is zero, so a share of it is nothing; give an absolute one in {unit}")
        half_width = parse(text, "1", where) * size
    else:
        half_width = parse(text, declared[name].metadata["unit"], where)
    if half_width <= 0.0:
        raise InputError(f"{where}: {text!r} must be positive")
    return half_width


def _stated_sensors(table: dict[str, Any]) -> dict[str, Sensor]:
    sensors = {}
    for name, figures in table.items():
        where = f"sensors.{name}"
        if name not in OUTPUTS:
            raise unknown_name("output channel", name, OUTPUTS, "sensors")
        if not isinstance(figures, dict):
            raise InputError(f"{where}: expected a table, got {figures!r}")
        Reader.known(figures, ("noise", "resolution", "lag", "range"), where)
        units = {"noise": UNITS[name], "resolution": UNITS[name], "lag": "s"}
        known: dict[str, Any] = {}
        for key in units:
            if key not in figures:
                continue
            known[key] = parse(figures[key], units[key], f"{where}.{key}")
            if known[key] < 0.0 or (key == "noise" and known[key] == 0.0):
                least = "be positive" if key == "noise" else "not be negative"
                raise InputError(f"{where}.{key}: {figures[key]!r} must {least}")
        if "range" in figures:
            known["range"] = _range(figures["range"], UNITS[name], f"{where}.range")
        sensors[name] = Sensor(name, UNITS[name], **known)
    return sensors


def _range(given: Any, unit: str, where: str) -> tuple[float, float]:
    if not isinstance(given, list) or len(given) != 2:
        raise InputError(f"{where}: expected [lowest, highest], such as ['-1 {unit}', '1 {unit}'], got {given!r}")
    low, high = (parse(text, unit, where) for text in given)
    if low >= high:
        raise InputError(f"{where}: {given[0]!r} must be below {given[1]!r}")
    return low, high


def _listed(folder: Path, records: Any) -> list[tuple[str, str, str | None]]:
    """(file, role, repeats) of each record; without a list, every CSV file in name order."""
    have = sorted(path.name for path in folder.glob("*.csv"))
    if records is None:
        if not have:
            raise InputError("no record: the folder holds no CSV file")
        return [(name, "train", None) for name in have]
    if not isinstance(records, list) or not all(isinstance(entry, dict) for entry in records):
        raise InputError("records: expected [[records]], one for each file")
    if not records:
        raise InputError("records: the list is empty")
    listed: list[tuple[str, str, str | None]] = []
    for k, entry in enumerate(records, start=1):
        where = f"records.{k}"
        Reader.known(entry, ("file", "repeats", "role"), where)
        file, role, repeats = entry.get("file"), entry.get("role", "train"), entry.get("repeats")
        if not isinstance(file, str):
            raise InputError(f"{where}.file: expected the name of a CSV file, got {file!r}")
        if not (folder / file).is_file():
            raise InputError(f"{where}.file: {file!r} is not in the folder{nearest(file, have)}")
        for other, _, _ in listed:
            if _called(file) == _called(other):
                raise InputError(f"{where}.file: {file!r} is listed twice" if file == other else
                                 f"{where}.file: {file!r} and {other!r} are both called {_called(file)!r}")  # fmt: skip
        if not isinstance(role, str) or role not in _ROLES:
            raise unknown_name("role", str(role), _ROLES, f"{where}.role")
        if repeats is not None and not isinstance(repeats, str):
            raise InputError(f"{where}.repeats: expected a label in quotes, got {repeats!r}")
        listed.append((file, role, repeats))
    return listed


# ---------------------------------------------------------------- records


def _called(file: str) -> str:
    """The name of the record in a file."""
    return str(Path(file).with_suffix(""))


def _read_record(folder: Path, session: Session, notes: list[str], file: str, role: str, repeats: str | None) -> Record:
    """One record, audited on its own; every output channel still counts as usable throughout."""
    path, name = folder / file, _called(file)
    values = _read_values(path)
    time = _even_clock(path, values.pop("time"))
    if "oil_temperature" not in values:
        values["oil_temperature"] = np.full(len(time), REFERENCE_TEMPERATURE)
        notes.append(f"{name}: no oil temperature was measured; {REFERENCE_TEMPERATURE:g} °C is assumed")
    outputs = [n for n in OUTPUTS if n in values and (n != "current" or "voltage" in values)]
    if not outputs:
        raise InputError(f"{path}: no output channel; expected one or more of {', '.join(OUTPUTS[:-1])}")
    if "body_temperature" in values:
        notes.append(f"{name}: body_temperature is not used: the parts follow the oil as [thermal] says")
    record = Record(name, time, values, {n: np.ones(len(time), dtype=bool) for n in outputs}, role, repeats, path)
    for column in record.inputs:
        if _rests(values[column], _scale(column, session.valve)):
            values[column] = np.full(len(time), np.mean(values[column]))
    _check_command(path, record, session.valve, notes)
    _check_conditions(path, record, session.valve, notes)
    return record


def _read_values(path: Path) -> dict[str, np.ndarray]:
    """All columns of a record in SI: numbers in bulk, and `read_columns` where anything is odd, for its messages."""
    line, header = _header(path)
    for name in header:
        if name not in UNITS:
            raise unknown_name("column", name, UNITS, f"{path}, line {line}")
    for one in (("time",), ("current", "voltage")):
        if not any(name in header for name in one):
            raise InputError(f"{path}, line {line}: no column {' or '.join(map(repr, one))}{nearest(one[0], header)}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no data: said below
            table = np.loadtxt(
                path, delimiter=",", comments=None, quotechar='"', skiprows=line, ndmin=2, encoding="utf-8-sig"
            )
    except ValueError:
        table = np.empty((0, 0))
    if table.shape[1] != len(header) or not np.isfinite(table).all():
        values = read_columns(path, {name: UNITS[name] for name in header})
    else:
        values = {
            name: convert(table[:, k], unit, UNITS[name], f"{path}, column {name!r}")
            for k, (name, unit) in enumerate(header.items())
        }
    if len(values["time"]) < LEAST_SAMPLES:
        raise InputError(f"{path}: {len(values['time'])} samples; a record needs {LEAST_SAMPLES} or more")
    return values


def _header(path: Path) -> tuple[int, dict[str, str]]:
    """The line of the header and its units by name; InputError from `read_columns` where it cannot be read."""
    line, cells = 0, []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            line, text = next(((n, text) for n, text in enumerate(file, start=1) if text.strip()), (0, ""))
        cells = [_HEADER.fullmatch(cell) for cell in next(csv.reader([text]), [])]
    except (OSError, ValueError, csv.Error):
        pass  # told below
    header = {cell[1]: cell[2] for cell in cells if cell is not None}
    if not cells or len(header) < len(cells):
        read_columns(path, {"time": "s"})
        raise InputError(f"{path}, line {line}: the header must be one line, such as time [s],current [mA]")
    return line, header


def _line(path: Path, row: int) -> int:
    """The line of a row of data (from 0) in its file."""
    with open(path, encoding="utf-8-sig") as file:
        return [n for n, text in enumerate(file, start=1) if text.strip()][row + 1]


def _even_clock(path: Path, time: np.ndarray) -> np.ndarray:
    """The even clock from 0 that the times keep to; InputError where they fall, leave a gap or drift."""
    steps, clock = np.diff(time), time - time[0]
    usual = float(np.median(steps))
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise InputError(
            f"{path}, line {_line(path, k + 1)}: times must rise, but {time[k + 1]:.9g} s follows {time[k]:.9g} s"
        )
    uneven = np.abs(steps - usual) > CLOCK_JITTER * usual
    if uneven.any():
        k = int(np.argmax(np.where(steps > GAP * usual, np.inf, uneven)))  # the first gap before any lesser jitter
        what = "gap" if steps[k] > GAP * usual else "uneven clock: a step"
        raise InputError(
            f"{path}, line {_line(path, k + 1)}: {what} of {steps[k]:.4g} s at {time[k]:.6g} s, where samples come "
            f"every {usual:.4g} s (to {CLOCK_JITTER:.0%}; write the time with enough digits)"
        )
    even = np.linspace(0.0, clock[-1], len(clock))
    off = np.abs(clock - even) / usual
    if (k := int(np.argmax(off))) and off[k] > 0.5:
        where = f"{time[k]:.6g} s is {off[k]:.3g} steps off an even one"
        raise InputError(f"{path}, line {_line(path, k)}: the clock drifts: {where}")
    return even


def _scale(name: str, valve: Valve) -> float:
    """The size against which an input's motion is judged: rated command, 100 K, supply pressure."""
    if name == "current":
        return valve.rated_current
    if name == "voltage":
        return valve.rated_current * valve.coil_resistance
    return 100.0 if UNITS[name] == "degC" else valve.supply_pressure


def _rests(values: np.ndarray, scale: float) -> bool:
    """Whether an input is at rest: constant, or no more than white noise of a sensor."""
    if np.ptp(values) <= LEAST_MOTION * scale:
        return True
    white = np.var(np.diff(values)) > 1.4 * np.var(values)  # 2 where neighbours know nothing of each other
    return bool(white and np.std(values) <= NOISE_MOTION * scale)


def _check_command(path: Path, record: Record, valve: Valve, notes: list[str]) -> None:
    command, rated = record.values[record.command], _scale(record.command, valve)
    unit, factor = DISPLAY.get(UNITS[record.command], (UNITS[record.command], 1.0))
    k = int(np.argmax(np.abs(command)))
    told = f"{record.command} of {command[k] * factor:.4g} {unit}"
    limit = f"the rated {rated * factor:.4g} {unit}"
    if abs(command[k]) > 2.0 * rated:
        raise InputError(f"{path}, line {_line(path, k)}: {told} is beyond twice {limit}")
    if abs(command[k]) > rated * (1 + 1e-9):
        notes.append(f"{record.name}: {told} is beyond {limit}; spool and flapper may reach their stops")


def _check_conditions(path: Path, record: Record, valve: Valve, notes: list[str]) -> None:
    """Temperatures and pressures must be ones that the valve can be in."""
    bounds = {name: field.metadata["bounds"] for name, field in quantities(valve).items()}
    bounds |= {"oil_temperature": COMPUTED_RANGE, "body_temperature": COMPUTED_RANGE}

    def refuse(wrong: np.ndarray, name: str, why: str) -> None:
        if wrong.any():
            k = int(np.argmax(wrong))
            value = _shown(record.values[name][k], UNITS[name])
            raise InputError(f"{path}, line {_line(path, k)}: {name} of {value} {why}")

    for name in record.inputs[1:]:
        (low, high), values = bounds[name], record.values[name]
        span = f"[{_shown(low, UNITS[name])}, {_shown(high, UNITS[name])}]"
        refuse((values < low) | (values > high), name, f"is outside {span}")
    pressure = {f"{n}_pressure": record.values.get(f"{n}_pressure", getattr(valve, f"{n}_pressure")) for n in
                ("supply", "return", "load")}  # fmt: skip
    supply = np.broadcast_to(pressure["supply_pressure"], record.time.shape)
    measured = next((n for n in ("return_pressure", "supply_pressure") if n in record.values), "")
    if measured:
        refuse(pressure["return_pressure"] >= supply, measured, "leaves no pressure between supply and return")
    if "load_pressure" in record.values:
        load = record.values["load_pressure"]
        refuse(np.abs(load) > (1.0 + OVERSHOOT) * supply, "load_pressure", "is beyond the supply pressure")
        if (np.abs(load) > supply).any():
            record.values["load_pressure"] = np.clip(load, -supply, supply)
            notes.append(f"{record.name}: load_pressure is a little beyond the supply pressure and held at it")


def _shown(value: float, unit: str) -> str:
    """A figure as people read it."""
    unit, factor = DISPLAY.get(unit, (unit, 1.0))
    return f"{value * factor:.4g} {symbol(unit)}"


def _check_drive(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records:
        if record.command != first.command:
            raise InputError(
                f"{first.name} is driven by {first.command}, {record.name} by {record.command}: a session has one drive"
            )


def _check_repeats(records: Sequence[Record], valve: Valve) -> None:
    """Repeats of one test must have one clock and the same inputs."""
    first: dict[str, Record] = {}
    for record in records:
        if record.repeats is None or (other := first.setdefault(record.repeats, record)) is record:
            continue
        pair = f"{other.name} and {record.name} are called repeats {record.repeats!r}, but their"
        if len(record.time) != len(other.time):
            raise InputError(f"{pair} lengths differ: {len(other.time)} and {len(record.time)} samples")
        if abs(record.duration - other.duration) * record.rate > 0.5:
            raise InputError(f"{pair} clocks disagree: they end at {other.duration:.6g} s and {record.duration:.6g} s")
        for name in dict.fromkeys((*other.inputs, *record.inputs)):
            if name not in other.values or name not in record.values:
                raise InputError(f"{pair} columns differ: only one has {name!r}")
            a, b = other.values[name], record.values[name]
            span = max(np.ptp(a), np.ptp(b))
            if name != record.command:  # a temperature or pressure that rests has no span of its own
                span = max(span, _scale(name, valve))
            off = float(np.sqrt(np.mean((a - b) ** 2)))
            if off > REPEAT_MISMATCH * max(span, LEAST_MOTION * _scale(name, valve)):
                raise InputError(f"{pair} inputs differ: {name} by {_shown(off, UNITS[name])} rms, more than "
                                 f"{REPEAT_MISMATCH:.0%} of {_shown(span, UNITS[name])}")  # fmt: skip


# ---------------------------------------------------------------- sensors


def _sensors(stated: dict[str, Sensor], records: Sequence[Record], notes: list[str]) -> dict[str, Sensor]:
    """One for each output channel that was measured; a resolution that is not stated is looked for in the data."""
    measured = [name for name in OUTPUTS if any(name in record.outputs for record in records)]
    for name in stated:
        if name not in measured:
            raise InputError(f"sensors.{name}: no record has this output channel; they have {', '.join(measured)}")
    sensors = {}
    for name in measured:
        sensor = stated.get(name, Sensor(name, UNITS[name]))
        if sensor.resolution == 0.0:
            step = _grid([record.values[name] for record in records if name in record.outputs])
            if step > 0.0:
                notes.append(f"{name}: readings sit on a grid of {_shown(step, sensor.unit)}, taken as the resolution")
            sensor = replace(sensor, resolution=step)
        sensors[name] = sensor
    return sensors


def _grid(readings: Sequence[np.ndarray]) -> float:
    """The step of the grid on which all readings sit, or 0 where they sit on none that is coarse enough to matter."""
    levels = np.unique(np.concatenate(readings))
    span = levels[-1] - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(levels))]  # equal readings that the conversion of units has parted
    if len(gaps) < 2 or np.min(gaps) < FINEST_GRID * span:
        return 0.0
    step = float(span / np.round(span / np.min(gaps)))  # the smallest gap alone is rounded; the whole span is not
    turns = (levels - levels[0]) / step
    return step if np.max(np.abs(turns - np.round(turns))) < 0.02 else 0.0


def _usable(record: Record, sensors: dict[str, Sensor], notes: list[str]) -> Record | None:
    """The record with the output channels that can be used, or None where nothing moves or none can."""
    if not record.moves():
        notes.append(f"{record.name}: never moves (no input changes) and is left out")
        return None
    usable = {}
    for name in record.outputs:
        values = record.values[name]
        if record.moves(record.command) and np.ptp(values) == 0.0:
            notes.append(f"{record.name}: {name} is stuck at {_shown(values[0], UNITS[name])} while the "
                         f"{record.command} moves, and is left out")  # fmt: skip
            continue
        good = ~_saturated(record, sensors[name])
        bad = 1.0 - float(np.mean(good))
        if bad > 0.0:
            left_out = " and is left out" if bad > 0.5 else ""
            notes.append(f"{record.name}: {name} is saturated in {bad:.2%} of the samples{left_out}")
        if bad <= 0.5:
            usable[name] = good
    if not usable:
        notes.append(f"{record.name}: has no output channel left and is left out")
        return None
    return replace(record, usable=usable)


def _saturated(record: Record, sensor: Sensor) -> np.ndarray:
    """Where a channel stands at an end of its sensor's range, or at a flat top of its own while the command goes on."""
    values, command = record.values[sensor.channel], record.values[record.command]
    (low, high), half = sensor.range, 0.5 * sensor.resolution
    saturated = (values <= low + half) | (values >= high - half)
    span, asked = np.ptp(values), np.ptp(command)
    if asked == 0.0:
        return saturated
    for side in (1.0, -1.0):
        at_extreme = side * values == np.max(side * values)
        outward = side * _SIGN[sensor.channel] * command * span / asked  # what the command asks for, as an output
        runs = np.flatnonzero(np.diff(at_extreme.astype(int), prepend=0, append=0)).reshape(-1, 2)
        for a, b in runs[np.diff(runs)[:, 0] >= FLAT_SAMPLES]:
            # Rest and friction are flat too, but there the command goes no further out than where the reading stopped.
            if np.max(outward[a:b]) - max(outward[a], outward[b - 1]) > max(3.0 * sensor.resolution, FLAT_REACH * span):
                saturated[a:b] = True
    return saturated


# ---------------------------------------------------------------- what is locked away


def _lock_away(records: Sequence[Record], seed: int, notes: list[str]) -> list[Record]:
    """The records with their final roles, and notes on what cannot be claimed."""
    tests: dict[str, list[Record]] = {}
    for record in records:
        tests.setdefault(record.test, []).append(record)
    repeated = [test for test, members in tests.items() if len(members) > 1]
    if not repeated:
        notes.append("no test was repeated: the noise is unverified")
    for test in repeated:
        if len({record.role for record in tests[test]}) > 1:
            notes.append(f"{test}: some are locked away and others not; they tell of the same test")
    if any(record.role == "test" for record in records):
        return list(records)
    if len(records) == 1:
        notes.append("one record only: no record can be locked away, so the gain cannot be claimed")
    elif len(tests) < 3:
        notes.append("fewer than three different tests: none is locked away, so the gain cannot be claimed")
    if len(tests) < 3:
        return list(records)
    order = [str(test) for test in np.random.default_rng(seed).permutation(sorted(tests))]
    if len(repeated) == 1:  # the noise is learnt from it
        order.remove(repeated[0])
    locked = order[: max(1, round(LOCKED_SHARE * len(tests)))]
    names = [record.name for record in records if record.test in locked]
    notes.append(f"locked away until the end (drawn with seed {seed}): {', '.join(names)}")
    return [replace(record, role="test") if record.test in locked else record for record in records]


# ---------------------------------------------------------------- inputs of a scenario


def _input(record: Record, name: str) -> Command:
    """A measured input as a command."""
    time, values = record.time, record.values[name]
    if np.ptp(values) == 0.0:
        return Constant(value=float(values[0]))
    if name == "oil_temperature":  # each of its points costs a matrix product, and a sensor's noise is not the oil's
        time, values = _smoothed(time, values)
        keep = _corners(time, values, OIL_RESOLUTION)
        time, values = time[keep], values[keep]
    return Table(times=tuple(time.tolist()), values=tuple(values.tolist()), where=f"{record.name}, {name}")


def _smoothed(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(time, values) of joined straight lines by least squares, long enough to bring the noise below the resolution."""
    from scipy.interpolate import make_lsq_spline

    noise = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)  # a ramp, however steep, has none
    if 2.0 * noise < OIL_RESOLUTION:
        return time, values
    samples = max(4.0, len(time) / OIL_INTERVALS, (2.0 * noise / OIL_RESOLUTION) ** 2)
    edges = np.linspace(time[0], time[-1], max(int(len(time) / samples), 1) + 1)
    return edges, make_lsq_spline(time, values, np.concatenate([edges[:1], edges, edges[-1:]]), k=1)(edges)


def _corners(time: np.ndarray, values: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of points whose straight lines stay within a tolerance of all (Ramer, Douglas and Peucker)."""
    keep, open_parts = {0, len(time) - 1}, [(0, len(time) - 1)]
    while open_parts:
        a, b = open_parts.pop()
        line = np.interp(time[a : b + 1], time[[a, b]], values[[a, b]])
        off = np.abs(values[a : b + 1] - line)
        k = a + int(np.argmax(off))
        if off[k - a] > tolerance:
            keep.add(k)
            open_parts += [(a, k), (k, b)]
    return np.array(sorted(keep))
