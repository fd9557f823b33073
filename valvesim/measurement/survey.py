"""A survey of measurement files: everything that is understood of them, and the table `[columns]` that says so."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from valvesim.errors import InputError
from valvesim.measurement.columns_table import (
    NOTHING_STATED,
    ColumnStatement,
    Statements,
    read_statements,
    statements_text,
)
from valvesim.measurement.formats import read_measured_tables
from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.measurement.recording import Recording, read_recording
from valvesim.measurement.table import Heading
from valvesim.units import parse


@dataclass(frozen=True, eq=False)
class Survey:
    """What a survey found: the `recording`, or None with the `problem`; all `headings` of the files."""

    paths: tuple[Path, ...]
    headings: tuple[Heading, ...]
    recording: Recording | None
    problem: InputError | None
    stated: Statements

    @property
    def columns(self) -> list[tuple[str, str]]:
        """(name, unit) of every column, as it stands in the files."""
        return [(heading.name, heading.unit or "-") for heading in self.headings]


def survey_stated(columns: Path | None, rate: str | None) -> Statements:
    """What is stated by a file of `[columns]`, and by a rate for what has no times."""
    stated = NOTHING_STATED if columns is None else read_statements(columns)
    if rate is None:
        return stated
    value = parse(rate, "Hz", "--rate")
    if value <= 0.0:
        raise InputError(f"{rate!r} must be positive", key="--rate")
    return replace(stated, columns={**stated.columns, "time": ColumnStatement(rate=value)})


def all_channels(paths: Sequence[Path], stated: Statements = NOTHING_STATED) -> Survey:
    """Every channel that files have. Raises InputError where not even their columns can be read."""
    headings = tuple(
        heading
        for path in paths
        for table in read_measured_tables(path, lambda headings: (), stated.dialect)
        for heading in table.headings
    )
    wanted = tuple(name for name in MEASURED_UNITS if name != "time")
    try:
        recording = read_recording(paths, wanted, stated=stated, strict=False)
    except InputError as error:
        return Survey(tuple(paths), headings, None, error, stated)
    return Survey(tuple(paths), headings, recording, None, stated)


def columns_text(surveys: Sequence[Survey]) -> str:
    """The table `[columns]` of surveyed files: what was understood, and what was not as comments to fill in."""
    understood: dict[str, ColumnStatement] = {}
    unknown: dict[str, Heading] = {}
    for survey in surveys:
        known = survey.recording.sources if survey.recording is not None else {}
        understood |= {channel: source.statement for channel, source in known.items()}
        times = () if survey.recording is None else survey.recording.times
        if "time" in survey.stated.columns:
            understood = {"time": survey.stated.columns["time"]} | understood
        elif len(times) == 1:
            understood = {"time": times[0]} | understood
        used = {statement.column for statement in (*understood.values(), *times)}
        unknown |= {h.name: h for h in survey.headings if h.name not in used}
    comments = [
        "What each channel is: sign * (scale * reading + offset), in the unit.",
        *textwrap.wrap("Channels: " + ", ".join(MEASURED_UNITS) + ".", 110),
        *(f"No channel yet: {h.name!r}" + (f" [{h.unit}]" if h.unit else "") for h in unknown.values()),
    ]
    return statements_text(understood, comments)
