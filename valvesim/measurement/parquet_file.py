"""Parquet files by pyarrow: one table; units in the names or in the metadata `units` of the fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from valvesim.errors import InputError
from valvesim.measurement.headings import heading_of, spelled
from valvesim.measurement.numbers import as_numbers, from_stamps
from valvesim.measurement.table import MOST_MEASURED_SAMPLES, Choice, Column, Heading, MeasuredTable


def read_parquet(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """The one table of a file."""
    import pyarrow
    import pyarrow.parquet

    file = pyarrow.parquet.ParquetFile(path)
    if file.metadata.num_rows > MOST_MEASURED_SAMPLES:
        raise InputError(f"{file.metadata.num_rows} rows are more than {MOST_MEASURED_SAMPLES}")
    schema = file.schema_arrow
    headings = tuple(_heading(field) for field in schema)
    columns, start = [], None
    for k in sorted(choice(headings)):
        kind = schema.field(k).type
        column = file.read(columns=[schema.field(k).name]).column(0)
        if pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind):
            seconds, start = from_stamps(column.to_numpy())
            columns.append(Column(k, Heading(headings[k].name, "s"), seconds))
        elif pyarrow.types.is_floating(kind) or pyarrow.types.is_integer(kind) or pyarrow.types.is_decimal(kind):
            columns.append(Column(k, headings[k], as_numbers(column.cast(pyarrow.float64()).to_numpy())))
    return (MeasuredTable(path.name, headings, tuple(columns), start=start),)


def _heading(field: Any) -> Heading:
    heading, metadata = heading_of(field.name), field.metadata or {}
    unit = next((metadata[key].decode() for key in (b"units", b"unit") if key in metadata), "")
    return Heading(heading.name, spelled(unit) or heading.unit)
