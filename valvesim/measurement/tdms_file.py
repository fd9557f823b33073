"""TDMS files of LabVIEW by npTDMS: a table for each group of channels that share their waveform's clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from valvesim.measurement.headings import heading_of, spelled
from valvesim.measurement.numbers import as_numbers, from_stamps
from valvesim.measurement.table import Choice, Column, Heading, MeasuredTable

_UNITS = ("unit_string", "NI_UnitDescription", "unit", "Unit", "Units", "units")


def read_tdms(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """Channels by group, increment, offset and length; a column of times is made of the increment."""
    from nptdms import TdmsFile

    tables = []
    with TdmsFile.open(path) as file:
        cut = file.file_status.incomplete_final_segment
        notes = ("the file ends in the middle of its last segment: what is there of it is used",) if cut else ()
        for group in file.groups():
            clocks: dict[tuple[Any, ...], list[Any]] = {}
            for channel in group.channels():
                if len(channel) and channel.data_type is not None and channel.dtype is not None:
                    clocks.setdefault(_clock(channel), []).append(channel)
            tables += [_table(group.name, clock, members, choice, notes) for clock, members in clocks.items()]
    return tuple(tables)


def _clock(channel: Any) -> tuple[Any, ...]:
    """(increment or None, offset, start or None, length) of a channel."""
    own = channel.properties
    increment = own.get("wf_increment")
    known = isinstance(increment, int | float | np.number) and float(increment) > 0.0
    return (
        float(increment) if known else None,
        float(own.get("wf_start_offset", 0.0)) if known else 0.0,
        own.get("wf_start_time") if known else None,
        len(channel),
    )


def _table(name: str, clock: tuple[Any, ...], members: list[Any], choice: Choice, notes: tuple[str, ...]
) -> MeasuredTable:
    increment, offset, begun, length = clock
    headings = [_heading(channel) for channel in members]
    if increment is not None:
        headings.append(Heading("time", "s"))
    columns, start = [], None
    for k in sorted(choice(headings)):
        if k == len(members):
            columns.append(Column(k, headings[k], offset + increment * np.arange(length)))
            start = None if begun is None else from_stamps(np.array([begun], dtype="datetime64[us]"))[1]
            continue
        values = members[k][:]
        if np.issubdtype(values.dtype, np.datetime64):
            seconds, start = from_stamps(values)
            columns.append(Column(k, Heading(headings[k].name, "s"), seconds))
        elif np.issubdtype(values.dtype, np.number) and not np.iscomplexobj(values):
            columns.append(Column(k, headings[k], as_numbers(values)))
    return MeasuredTable(name, tuple(headings), tuple(columns), start=start, notes=notes)


def _heading(channel: Any) -> Heading:
    heading = heading_of(channel.name)
    unit = next((str(channel.properties[name]) for name in _UNITS if channel.properties.get(name)), "")
    return Heading(heading.name, spelled(unit) or heading.unit)
