"""Reading a session folder, `session.toml` and records of any format, strictly: what makes no sense is an InputError
with file and line or key.

What merely carries no information (a record that never moves, a stuck or saturated sensor) is left out by the audit,
and `Session.notes` says so in words.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, nearest, unknown_name
from valvesim.identification.bad_samples import measured_samples
from valvesim.identification.holdout import hold_out
from valvesim.identification.input_noise import input_noise, without_noise, without_rounding
from valvesim.identification.options import DEFAULT_IDENTIFICATION, IdentificationOptions
from valvesim.identification.record_audit import (
    audited_resolutions,
    audited_sensors,
    check_command,
    check_conditions,
    check_drive,
    check_replicates,
    input_scale,
    is_at_rest,
    note_disagreement,
    usable_records,
    with_common_lengths,
)
from valvesim.identification.session import OUTPUTS, UNITS, Record, Sensor, Session, value_text
from valvesim.io import check_known, check_printable, check_tables, located, read_toml
from valvesim.measurement.columns_table import NOTHING_STATED, Statements, statements_of, statements_of_record
from valvesim.measurement.formats import LISTED
from valvesim.measurement.recording import Recording, read_recording
from valvesim.simulation.scenario_toml import ScenarioReader, valve_argument
from valvesim.units import parse
from valvesim.valve.effect_trust import check_inside
from valvesim.valve.parameters import REFERENCE_TEMPERATURE
from valvesim.valve.permission import permitting
from valvesim.valve.valve_toml import read_tolerance

_TABLES = ("valve", "oil", "thermal", "effects", "tolerances", "sensors")
_ROLES = ("train", "test")
RECORDED = tuple(name for name in UNITS if name != "time")
"""Channels that a record may have."""


def load_session(
    folder: str | Path,
    *,
    seed: int | None = None,
    effects: Sequence[str | Path] = (),
    valve: str | Path | None = None,
    trust: bool = False,
    outside: bool = False,
    options: IdentificationOptions = DEFAULT_IDENTIFICATION,
) -> Session:
    """Read a session folder and audit it.

    `seed` and `valve` (a valve file or a preset's name) take the place of the session's own; `effects` are further
    files of a user's own effects. With `trust` the Python files of effects that the session names are run, with
    `outside` they and its records may stand outside the folder (`valve/effect_trust`).

    Raises InputError (file, line, key) for a missing or broken `session.toml`, unknown keys, and records that make no
    sense: see the module's tests for every case.
    """
    with permitting(trust=trust, outside=outside):
        return _load(Path(folder), seed, effects, valve, options)


def _load(
    folder: Path,
    seed: int | None,
    effects: Sequence[str | Path],
    valve: str | Path | None,
    options: IdentificationOptions,
) -> Session:
    path = folder / "session.toml"
    text, table = read_toml(path, "a session is a folder with session.toml and records")
    if valve is not None:
        table["valve"] = valve_argument(valve)
    with located(path, text, document="session"):
        session = session_settings(folder, table, tuple(Path(file).absolute() for file in effects))
        if seed is not None:
            session = replace(session, seed=_seed(seed))
        columns = statements_of(table.get("columns", {}), table.get("csv", {}))
        listed = _listed(folder, table.get("records"), columns)
        stated = stated_sensors(table.get("sensors", {}))
    notes: list[str] = []
    recordings = []
    for entry in listed:
        try:
            paths = [folder / file for file in entry.files]
            recordings.append(read_recording(paths, RECORDED, stated=entry.columns))
        except InputError as error:
            with contextlib.nullcontext() if error.file else located(path, text, document="session"):
                raise error from None
    resolutions = audited_resolutions([one.values for one in recordings], session.valve, notes, options=options)
    records = [
        _read_record(recording, entry, session, resolutions, notes, options=options)
        for recording, entry in zip(recordings, listed, strict=True)
    ]
    check_drive(records)
    records = with_common_lengths(records, notes, options=options)
    check_replicates(records, session.valve, options=options)
    with located(path, text, document="session"):
        sensors = audited_sensors(stated, records, notes, options=options)
    records = usable_records(records, sensors, notes, options=options)
    note_disagreement(records, notes, options=options)
    if not any(record.moves() for record in records):
        raise InputError(
            f"no record is left that moves and has a usable output channel: {'; '.join(notes)}", file=folder
        )
    records = hold_out(records, session.seed, notes, options=options)
    if all(record.role == "test" for record in records):
        raise InputError("every record has role = 'test', so none is left to learn from", file=folder)
    return replace(session, sensors=sensors, records=tuple(records), notes=tuple(notes))


def session_settings(
    folder: Path, table: dict[str, Any], more_effects: tuple[Path, ...], more: Sequence[str] = ()
) -> Session:
    """Everything in `session.toml` but sensors and records, with more files of effects; `more` are further keys."""
    reader = ScenarioReader(folder)
    check_known(table, ("title", "seed", "effects_files", "records", "columns", "csv", *_TABLES, *more), "session")
    check_tables(table, _TABLES[1:])
    title = table.get("title", folder.resolve().name)
    check_printable(title, "title")
    if "oil_temperature" in table.get("thermal", {}):
        problem = "comes from the records (column 'oil_temperature [degC]')"
        raise InputError(problem, key="thermal.oil_temperature")
    described = reader.valve(table, more_effects)
    listed = table.get("tolerances", {})
    stated = {n: read_tolerance(described.valve, n, text, f"tolerances.{n}") for n, text in listed.items()}
    return Session(
        folder=folder,
        title=title,
        seed=_seed(table.get("seed", 0)),
        valve=described.valve,
        oil=described.oil,
        thermal=reader.thermal(table.get("thermal", {})),
        effects=described.effects,
        user_effects=described.own,
        effects_files=described.effects_files,
        tolerances=dict(described.tolerances) | stated,
        sensors={},
        records=(),
        notes=(),
    )


def _seed(given: Any) -> int:
    if isinstance(given, bool) or not isinstance(given, int) or given < 0:
        raise InputError(f"expected a whole number, 0 or more, got {given!r}", key="seed")
    return given


def stated_sensors(table: dict[str, Any]) -> dict[str, Sensor]:
    """What `[sensors]` says, by output channel. Raises InputError with the key."""
    sensors = {}
    for name, figures in table.items():
        where = f"sensors.{name}"
        if name not in OUTPUTS:
            raise unknown_name("output channel", name, OUTPUTS, "sensors")
        if not isinstance(figures, dict):
            raise InputError(f"expected a table, got {figures!r}", key=where)
        check_known(figures, ("noise", "resolution", "lag", "range"), where)
        units = {"noise": UNITS[name], "resolution": UNITS[name], "lag": "s"}
        known: dict[str, Any] = {}
        for key in units:
            if key not in figures:
                continue
            known[key] = parse(figures[key], units[key], f"{where}.{key}")
            if known[key] < 0.0 or (key == "noise" and known[key] == 0.0):
                least = "be positive" if key == "noise" else "not be negative"
                raise InputError(f"{figures[key]!r} must {least}", key=f"{where}.{key}")
        if "range" in figures:
            known["range"] = _range(figures["range"], UNITS[name], f"{where}.range")
        sensors[name] = Sensor(name, UNITS[name], **known)
    return sensors


def _range(given: Any, unit: str, where: str) -> tuple[float, float]:
    if not isinstance(given, list) or len(given) != 2:
        raise InputError(f"expected [lowest, highest], such as ['-1 {unit}', '1 {unit}'], got {given!r}", key=where)
    low, high = (parse(text, unit, where) for text in given)
    if low >= high:
        raise InputError(f"{given[0]!r} must be below {given[1]!r}", key=where)
    return low, high


@dataclass(frozen=True, kw_only=True)
class ListedRecord:
    """A record as `session.toml` lists it: files, role, label of its repeats, and what is stated of its columns."""

    files: tuple[str, ...]
    role: str = "train"
    repeats: str | None = None
    columns: Statements = NOTHING_STATED

    @property
    def name(self) -> str:
        """The name of its first file."""
        return _called(self.files[0])


def _listed(folder: Path, records: Any, columns: Statements) -> list[ListedRecord]:
    """The records of the list; without one, every measurement file in name order."""
    have = sorted(path.name for path in folder.glob("*") if path.suffix.casefold() in LISTED)
    if records is None:
        if not have:
            raise InputError("no record: the folder holds no CSV file, nor one of another format")
        return [ListedRecord(files=(_inside(name, folder, "records"),), columns=columns) for name in have]
    if not isinstance(records, list) or not all(isinstance(entry, dict) for entry in records):
        raise InputError("expected [[records]], one for each file", key="records")
    if not records:
        raise InputError("the list is empty", key="records")
    listed: list[ListedRecord] = []
    for k, entry in enumerate(records, start=1):
        where = f"records.{k}"
        check_known(entry, ("file", "files", "repeats", "role", "columns", "csv"), where)
        files, role, repeats = _files(folder, entry, where, have), entry.get("role", "train"), entry.get("repeats")
        for other in listed:
            if other.name == _called(files[0]):
                both = f"{files[0]!r} and {other.files[0]!r} are both called {other.name!r}"
                raise InputError(f"{files[0]!r} is listed twice" if files == other.files else both, key=f"{where}.file")
        if not isinstance(role, str) or role not in _ROLES:
            raise unknown_name("role", str(role), _ROLES, f"{where}.role")
        if repeats is not None and not isinstance(repeats, str):
            raise InputError(f"expected a label in quotes, got {repeats!r}", key=f"{where}.repeats")
        own = statements_of_record(entry, columns, where)
        listed.append(ListedRecord(files=files, role=role, repeats=repeats, columns=own))
    return listed


def _files(folder: Path, entry: dict[str, Any], where: str, have: Sequence[str]) -> tuple[str, ...]:
    """The file or the files of a record."""
    if "files" in entry and "file" in entry:
        raise InputError("a record has a `file`, or `files` that were written together", key=f"{where}.files")
    key = "files" if "files" in entry else "file"
    given = entry.get(key)
    files = given if key == "files" and isinstance(given, list) else [given]
    for file in files:
        if not isinstance(file, str):
            raise InputError(f"expected the name of a CSV file, got {file!r}", key=f"{where}.{key}")
        if not os.path.isfile(folder / file):  # not of a path: it raises for a name that is too long
            raise InputError(f"{file!r} is not in the folder{nearest(file, have)}", key=f"{where}.{key}")
        _inside(file, folder, f"{where}.{key}")
    if not files or len(set(files)) < len(files):
        raise InputError("expected different files", key=f"{where}.{key}")
    return tuple(files)


def _inside(file: str, folder: Path, where: str) -> str:
    """The name of a record's file; InputError where it stands elsewhere and nobody said that it may."""
    check_inside(file, folder, where)
    return file


def _called(file: str) -> str:
    """The name of the record in a file."""
    return str(Path(file).with_suffix(""))


def _read_record(
    recording: Recording, entry: ListedRecord, session: Session, resolutions: dict[str, float], notes: list[str],
    *, options: IdentificationOptions,
) -> Record:  # fmt: skip
    """One record, audited on its own, with the resolutions of its inputs; every reading of an output channel still
    counts as usable.
    """
    path, name, time, values = recording.paths[0], entry.name, recording.time, dict(recording.values)
    if "current" not in values and "voltage" not in values:
        raise InputError(f"no column 'current' or 'voltage'{nearest('current', recording.left_out)}", file=path)
    if len(time) < options.audit.least_samples:
        problem = f"{len(time)} samples; a record needs {options.audit.least_samples} or more"
        raise InputError(problem, file=path)
    notes += recording.notes
    if recording.left_out:
        notes.append(f"{name}: columns that are no channel are left out: {', '.join(recording.left_out)}")
    assumed = tuple(column for column in ("oil_temperature", "supply_pressure") if column not in values)
    if "oil_temperature" in assumed:
        values["oil_temperature"] = np.full(len(time), REFERENCE_TEMPERATURE)
        notes.append(f"{name}: no oil temperature was measured; {REFERENCE_TEMPERATURE:g} °C is assumed")
    if "supply_pressure" in assumed:
        stated = value_text(float(session.valve.supply_pressure), UNITS["supply_pressure"])
        notes.append(f"{name}: no supply pressure was measured; {stated} is assumed")
    outputs = [n for n in OUTPUTS if n in values and (n != "current" or "voltage" in values)]
    if not outputs:
        raise InputError(f"no output channel; expected one or more of {', '.join(OUTPUTS[:-1])}", file=path)
    command = "voltage" if "voltage" in values else "current"
    rated = (command, input_scale(command, session.valve))
    read_at, shares = _between_slow_samples(recording, values, name, notes)
    usable = measured_samples(path, name, values, outputs, rated, recording.line_of, time, notes, options=options)
    usable = {channel: good & read_at[channel] if channel in read_at else good for channel, good in usable.items()}
    record = Record(
        name, time, values, usable, entry.role, entry.repeats, path, recording.line_of, shares, assumed=assumed
    )
    for column in record.inputs:
        scale = input_scale(column, session.valve)
        if column in resolutions:
            record.input_resolution[column] = resolutions[column]
        if is_at_rest(values[column], scale, options=options):
            values[column] = np.full(len(time), np.mean(values[column]))
            continue
        if column in resolutions:
            values[column] = without_rounding(values[column], resolutions[column])
        if not column.endswith("_temperature"):  # these are smoothed where they drive the model
            noise = input_noise(values[column], options=options.input_noise)
            if options.input_noise.least * scale < noise < options.audit.noise_motion * scale:
                values[column] = without_noise(values[column], noise, options=options.input_noise)
                record.input_noise[column] = noise
                told = value_text(noise, UNITS[column])
                notes.append(f"{name}: {column} has white noise of {told} (standard deviation); it is taken away, as "
                             "the instrument's and not the valve's")  # fmt: skip
    check_command(path, record, session.valve, notes, options=options)
    check_conditions(path, record, session.valve, notes, options=options)
    return record


def _between_slow_samples(
    recording: Recording, values: dict[str, np.ndarray], name: str, notes: list[str]
) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """({channel: True where it was read (n,)}, {channel: share of the samples}) of what is slower than the clock.

    In `values`, in place, straight lines go from one of its samples to the next; where one is missing, it stays NaN.
    """
    rate = (len(recording.time) - 1) / float(recording.time[-1])
    read_at: dict[str, np.ndarray] = {}
    shares: dict[str, float] = {}
    for channel, source in recording.sources.items():
        if source.rate > 0.9 * rate:
            continue
        there = np.isfinite(values[channel])
        k = np.flatnonzero(there)
        if len(k) < 2:
            continue
        line = np.interp(np.arange(len(there)), k, values[channel][k])
        apart = np.diff(k) > 1.5 * rate / source.rate + 1.0
        for a, b in zip(k[:-1][apart], k[1:][apart], strict=True):
            line[a + 1 : b] = np.nan
        values[channel], read_at[channel], shares[channel] = line, there, source.rate / rate
        notes.append(f"{name}: {channel} was read at {source.rate:.4g} Hz, the record's clock has {rate:.4g} Hz")
    return read_at, shares
