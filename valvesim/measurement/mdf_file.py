"""MDF files (ASAM MDF 3 and 4) by asammdf: a table for each channel group, with its master channel as time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from valvesim.measurement.headings import heading_of, spelled
from valvesim.measurement.numbers import as_numbers
from valvesim.measurement.table import Choice, Column, Heading, MeasuredTable


def read_mdf(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """Physical values of all channels of each group."""
    from asammdf import MDF

    tables = []
    with MDF(path) as file:
        for index, group in enumerate[Any](file.groups):
            master = file.masters_db.get(index)
            channels = [k for k in range(len(group.channels)) if k != master]
            headings = [_heading(group.channels[k].name, file.get_channel_unit(group=index, index=k)) for k in channels]
            headings.append(Heading("time", "s"))
            wanted = sorted(choice(headings))
            columns = []
            times: np.ndarray | None = None
            for k in wanted:
                if k == len(channels):
                    continue
                signal = file.get(group=index, index=channels[k], ignore_invalidation_bits=False)
                if np.issubdtype(signal.samples.dtype, np.number) and signal.samples.ndim == 1:
                    invalid = signal.invalidation_bits
                    values = as_numbers(signal.samples)
                    if invalid is not None:
                        values = np.where(np.asarray(invalid, dtype=bool), np.nan, values)
                    columns.append(Column(k, headings[k], values))
                    times = signal.timestamps
            if times is not None:
                columns.append(Column(len(channels), headings[-1], as_numbers(times)))
                columns = [column for column in columns if len(column.values) == len(times)]
            tables.append(MeasuredTable(f"group {index + 1}", tuple(headings), tuple(columns)))
    return tuple(tables)


def _heading(name: str, unit: str | None) -> Heading:
    heading = heading_of(name)
    return Heading(heading.name, spelled(unit or "") or heading.unit)
