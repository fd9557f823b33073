"""Sheets of xlsx workbooks by openpyxl: a table for each sheet that has one; formulas by their last values."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any
from zipfile import ZipFile

from valvesim.errors import InputError
from valvesim.measurement.headings import heading_of, is_unit, spelled
from valvesim.measurement.numbers import from_cells
from valvesim.measurement.table import Choice, Column, Heading, MeasuredTable

_MOST_UNPACKED, _MOST_RATIO = 20_000_000, 100  # bytes, and times of the file's size: sheets of numbers take some ten


def read_xlsx(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """The tables of a workbook: names in the row above the first numbers, or in that above a row of units."""
    from openpyxl import load_workbook

    with ZipFile(path) as archive:
        unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > max(_MOST_UNPACKED, _MOST_RATIO * path.stat().st_size):
        raise InputError(f"unpacks to {unpacked / 1e6:.0f} MB, more than {_MOST_RATIO} times its size")
    book = load_workbook(path, read_only=True, data_only=True)
    try:
        tables = [_table(sheet.title, [_cells(row) for row in sheet.iter_rows(values_only=True)], choice)
                  for sheet in book.worksheets]  # fmt: skip
    finally:
        book.close()
    return tuple(table for table in tables if table is not None)


def _table(name: str, rows: list[list[Any]], choice: Choice) -> MeasuredTable | None:
    first = next((k for k in range(len(rows)) if _is_data(rows[k]) and _goes_on(rows, k)), None)
    if first is None:
        return None
    headings = _headings(rows, first)
    if headings is None:
        return None
    columns, start = [], None
    body = [row for row in rows[first:] if any(cell is not None for cell in row)]
    for k in sorted(choice(headings)):
        found = from_cells([row[k] if k < len(row) else None for row in body])
        if found is None:
            continue
        values, own = found
        columns.append(Column(k, headings[k] if own is None else Heading(headings[k].name, "s"), values))
        start = own if own is not None else start
    return MeasuredTable(
        name, headings, tuple(columns), start=start, header_line=first, line_of=lambda row: first + 1 + row
    )


def _cells(row: Sequence[Any]) -> list[Any]:
    """The cells of a row up to its last that holds something: a sheet may claim any width."""
    width = next((k for k in range(len(row), 0, -1) if row[k - 1] is not None), 0)
    return list(row[:width])


def _is_data(row: Sequence[Any]) -> bool:
    return any(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in row)


def _goes_on(rows: Sequence[Sequence[Any]], k: int) -> bool:
    """Whether the rows after this one hold numbers where it does, and names stand above."""
    places = [j for j, cell in enumerate(rows[k]) if isinstance(cell, int | float | datetime | time | timedelta)]
    return all(not any(isinstance(row[j], str) for j in places if j < len(row)) for row in rows[k + 1 : k + 4])


def _headings(rows: Sequence[Sequence[Any]], first: int) -> tuple[Heading, ...] | None:
    width = max(len(row) for row in rows[first : first + 100])

    def texts(k: int) -> list[str]:
        row = [*rows[k], *[None] * width][:width] if 0 <= k < len(rows) else [None] * width
        return ["" if cell is None else str(cell) for cell in row]

    names, units = texts(first - 1), [""] * width
    above = texts(first - 2)
    if all(map(is_unit, names)) and any(above) and not all(map(is_unit, above)):
        names, units = above, names
    if not any(names):
        return tuple(Heading(str(k)) for k in range(1, width + 1)) if first == 0 else None
    found = map(heading_of, names)
    return tuple(Heading(h.name, h.unit or spelled(u).strip("- ")) for h, u in zip(found, units, strict=True))
