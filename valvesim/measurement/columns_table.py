"""What a user states of a file's columns: the tables `[columns]` and `[csv]`, read strictly and written to keep.

    [columns]
    time = { column = "Zeit", unit = "ms" }          # or { rate = "2 kHz" }: no times, but a rate
    current = { column = "AI 0", unit = "mA", scale = 2.5, offset = -0.1, sign = -1 }
    spool_position = "LVDT [mm]"                     # the column alone
    load_flow = false                                # not what its name says: leave it out

A channel is sign * (scale * reading + offset) in `unit`. A column may be given by its number, from 1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from valvesim.errors import InputError, unknown_name
from valvesim.io import located, read_toml
from valvesim.measurement.dialect import SEPARATORS, Dialect
from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.units import parse


@dataclass(frozen=True, kw_only=True)
class ColumnStatement:
    """What is stated of a channel: its column by name or number, unit, scale, offset and sign; `rate` (Hz) of times.

    `absent` where the file does not have the channel, whatever its headings say.
    """

    column: str | int | None = None
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    sign: float = 1.0
    rate: float | None = None
    absent: bool = False


@dataclass(frozen=True, kw_only=True)
class Statements:
    """All that is stated of files: their columns by channel, and the dialect of text."""

    columns: Mapping[str, ColumnStatement] = field(default_factory=dict)
    dialect: Dialect = Dialect()


NOTHING_STATED = Statements()
_KEYS = ("column", "unit", "scale", "offset", "sign")


def read_statements(path: Path) -> Statements:
    """The tables `[columns]` and `[csv]` of a TOML file. Raises InputError with its line."""
    text, table = read_toml(path, "a table [columns], as `valvesim records` writes it")
    with located(path, text):
        for key in table:
            if key not in ("columns", "csv"):
                raise unknown_name("table", key, ("columns", "csv"))
        return statements_of(table.get("columns", {}), table.get("csv", {}))


def statements_of(columns: Any, csv: Any) -> Statements:
    """The statements of the two tables. Raises InputError with the key of what makes no sense."""
    for name, table in (("columns", columns), ("csv", csv)):
        if not isinstance(table, dict):
            raise InputError(f"expected a table, got {table!r}", key=name)
    for channel in columns:
        if channel not in MEASURED_UNITS:
            raise unknown_name("channel", channel, MEASURED_UNITS, "columns")
    return Statements(
        columns={channel: _statement(channel, given) for channel, given in columns.items()}, dialect=_dialect(csv)
    )


def statements_of_record(entry: Mapping[str, Any], common: Statements, where: str) -> Statements:
    """The statements of one of `[[records]]`, at `where`: its own tables upon the `common` ones."""
    try:
        own = statements_of(entry.get("columns", {}), entry.get("csv", {}))
    except InputError as error:
        raise error.at(key=f"{where}.{error.key}") from None
    return Statements(
        columns={**common.columns, **own.columns}, dialect=own.dialect if "csv" in entry else common.dialect
    )  # fmt: skip


def _statement(channel: str, given: Any) -> ColumnStatement:
    where = f"columns.{channel}"
    if given is False:
        return ColumnStatement(absent=True)
    if isinstance(given, str) or (isinstance(given, int) and not isinstance(given, bool)):
        given = {"column": given}
    if not isinstance(given, dict):
        raise InputError(f"expected a column, a table or false, got {given!r}", key=where)
    keys = ("column", "unit", "rate") if channel == "time" else _KEYS
    for key in given:
        if key not in keys:
            raise InputError(f"unknown key {key!r}; valid names: {', '.join(keys)}", key=where, name=key)
    column, unit = given.get("column"), given.get("unit")
    if column is not None and (isinstance(column, bool) or not isinstance(column, str | int) or column == ""):
        raise InputError(f"expected the name or number of a column, got {column!r}", key=f"{where}.column")
    if isinstance(column, int) and column < 1:
        raise InputError(f"columns count from 1, got {column}", key=f"{where}.column")
    if unit is not None:
        parse(f"1 {unit}", MEASURED_UNITS[channel], f"{where}.unit")
    rate = parse(given["rate"], "Hz", f"{where}.rate") if "rate" in given else None
    if rate is not None and rate <= 0.0:
        raise InputError(f"{given['rate']!r} must be positive", key=f"{where}.rate")
    if rate is not None and (column is not None or unit is not None):
        raise InputError("a rate takes the place of a column of times", key=f"{where}.rate")
    scale, offset, sign = (
        _number(given.get(name, default), f"{where}.{name}")
        for name, default in (("scale", 1.0), ("offset", 0.0), ("sign", 1.0))
    )
    if scale == 0.0:
        raise InputError("a scale of zero leaves nothing", key=f"{where}.scale")
    if abs(sign) != 1.0:
        raise InputError(f"expected 1 or -1, got {given['sign']!r}", key=f"{where}.sign")
    return ColumnStatement(column=column, unit=unit, scale=scale, offset=offset, sign=sign, rate=rate)


def _number(given: Any, where: str) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given):
        raise InputError(f"expected a number, got {given!r}", key=where)
    return float(given)


def _dialect(given: Mapping[str, Any]) -> Dialect:
    known = {"separator": tuple(SEPARATORS), "decimal": (".", ","), "encoding": None, "header_line": None}
    for key, value in given.items():
        where = f"csv.{key}"
        if key not in known:
            raise unknown_name("key", key, known, "csv")
        if (allowed := known[key]) is not None and value not in (*allowed, *(SEPARATORS[a] for a in allowed
                                                                            if a in SEPARATORS)):  # fmt: skip
            raise InputError(f"expected one of {', '.join(map(repr, allowed))}, got {value!r}", key=where)
        if key == "header_line" and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
            raise InputError(f"expected a line, or 0 for none, got {value!r}", key=where)
        if key == "encoding":
            _check_encoding(value, where)
    separator = given.get("separator")
    return Dialect(
        separator=SEPARATORS.get(separator, separator) if separator is not None else None,
        decimal=given.get("decimal"), encoding=given.get("encoding"), header_line=given.get("header_line"),
    )  # fmt: skip


def _check_encoding(value: Any, where: str) -> None:
    import codecs

    try:
        if not isinstance(value, str) or not codecs.lookup(value)._is_text_encoding:  # type: ignore[attr-defined]
            raise LookupError
    except (LookupError, ValueError):
        raise InputError(f"expected an encoding, such as 'cp1252' or 'utf-16', got {value!r}", key=where) from None


def statements_text(statements: Mapping[str, ColumnStatement], comments: Sequence[str] = ()) -> str:
    """The text of a file with a table `[columns]`, as `read_statements` reads it."""
    import tomlkit

    document = tomlkit.document()
    for comment in comments:
        document.add(tomlkit.comment(comment))
    columns = tomlkit.table()
    for channel, stated in statements.items():
        row = tomlkit.inline_table()
        if stated.rate is not None:
            row["rate"] = f"{stated.rate!r} Hz"
        else:
            row["column"] = stated.column
            if stated.unit:
                row["unit"] = stated.unit
            for name, default in (("scale", 1.0), ("offset", 0.0), ("sign", 1.0)):
                if getattr(stated, name) != default:
                    row[name] = getattr(stated, name)
        columns[channel] = row
    document["columns"] = columns
    return tomlkit.dumps(document)
