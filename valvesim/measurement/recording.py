"""A recording: channels in SI on one even clock, whatever files, columns and rates they were written in.

The fastest of the chosen tables gives the clock. What was measured more slowly stands at the samples nearest to its
own times, and is NaN between them: what to make of that is for those who use it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from valvesim.errors import InputError, nearest
from valvesim.measurement.clock import FARTHEST, SHORTEST, EvenClock, even_clock
from valvesim.measurement.columns_table import NOTHING_STATED, ColumnStatement, Statements
from valvesim.measurement.formats import read_measured_tables
from valvesim.measurement.headings import MEASURED_UNITS, channel_of, fits, is_own_name, spelled
from valvesim.measurement.table import MOST_MEASURED_SAMPLES, Column, Heading, MeasuredTable
from valvesim.units import convert


def no_line(sample: int) -> None:
    """Of a file that has no lines."""


_PART = 1 << 20  # readings at once
_MISSPELLED = 0.85  # likeness to a channel's name from which another name is taken for a misspelling


@dataclass(frozen=True, eq=False)
class ChannelSource:
    """Where a channel comes from: file, table, and what was understood of its column; `rate` Hz as it was measured."""

    path: Path
    table: str
    statement: ColumnStatement
    rate: float


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels on one even clock: `time` (n,) s from the first sample, `values[channel]` (n,) in the unit of
    `headings.MEASURED_UNITS`, NaN where nothing was measured.

    `sources` say where each channel comes from, `left_out` which columns were not understood, and `notes`, in words,
    what was done to times and rows. `line_of(sample)` is the line of a sample in the one text file that there is,
    `forms` say how files of text are written, `times` what is known of the columns of times.
    """

    paths: tuple[Path, ...]
    time: np.ndarray
    values: dict[str, np.ndarray]
    sources: dict[str, ChannelSource]
    left_out: tuple[str, ...]
    notes: tuple[str, ...]
    forms: tuple[str, ...] = ()
    times: tuple[ColumnStatement, ...] = ()
    line_of: Callable[[int], int | None] = no_line


def read_recording(
    paths: Sequence[Path], wanted: Collection[str], *, stated: Statements = NOTHING_STATED, strict: bool = True
) -> Recording:
    """The wanted channels of one or more files that were written together.

    `strict` refuses a column whose name is nearly that of a wanted channel. Raises InputError for what cannot be read
    or is told in two ways, and where the files have no time in common.
    """
    laid: list[tuple[EvenClock, float | None, dict[str, np.ndarray]]] = []
    sources: dict[str, ChannelSource] = {}
    left_out: list[str] = []
    notes: list[str] = []
    tables = [(path, table, chosen) for path in paths for table, chosen in _tables(path, wanted, stated)]
    _check_stated(paths, tables, stated)
    for path, table, chosen in tables:
        used = {_place(table.headings, statement) for statement in chosen.values()}
        left_out += [h.name for k, h in enumerate(table.headings) if h.name and k not in used]
        channels = {name: statement for name, statement in chosen.items() if name != "time"}
        if not channels:
            continue
        columns = {name: _si(path, table, name, statement) for name, statement in channels.items()}
        clock = _clock(path, table, chosen, stated)
        if not SHORTEST <= clock.step <= FARTHEST:
            told = f"samples {clock.step:g} s apart are outside [{SHORTEST:g}, {FARTHEST:g}] s"
            raise InputError(told, file=path, line=table.header_line)
        notes += [f"{path.name}: {note}" for note in (*table.notes, *clock.notes)]
        values = {}
        for name, statement in channels.items():
            if name in sources:
                both = f"{name} stands in {sources[name].path.name} and {path.name}"
                raise InputError(f"{both}: state which in [columns]", file=path)
            values[name] = clock.lay(columns[name])
            sources[name] = ChannelSource(path, table.name, statement, 1.0 / clock.step)
        laid.append((clock, table.start, values))
    if strict:
        _check_spelling(paths[0], tables, wanted, sources)
    if not laid:
        have = sorted({h.name for _, table, _ in tables for h in table.headings})
        sought = ", ".join(wanted) if len(wanted) < 15 else "the channels that are known"
        told = f"no column is one of {sought}; there are {', '.join(have[:20]) or 'none'}"
        raise InputError(f"{told}. State which is which in [columns]: `valvesim records` writes one", file=paths[0])
    time, joined = _joined(paths[0], laid)
    line_of = partial(_line_of, tables[0][1].line_of, laid[0][0]) if len(tables) == 1 else no_line
    return Recording(
        paths=tuple(paths), time=time, values=joined, sources=sources, left_out=tuple(dict.fromkeys(left_out)),
        notes=tuple(notes), forms=tuple(f"{path.name}: {table.form}" for path, table, _ in tables if table.form),
        times=tuple(dict.fromkeys(chosen["time"] for _, _, chosen in tables if "time" in chosen)), line_of=line_of,
    )  # fmt: skip


def _line_of(line_of: Callable[[int], int | None], clock: EvenClock, sample: int) -> int | None:
    return line_of(clock.row_of(sample))


def _tables(
    path: Path, wanted: Collection[str], stated: Statements
) -> list[tuple[MeasuredTable, dict[str, ColumnStatement]]]:
    """The tables of a file, each with what its columns are, by channel."""

    def choice(headings: Sequence[Heading]) -> list[int]:
        return [_place(headings, s) for s in understood(path, headings, wanted, stated, line=None).values()]

    tables = read_measured_tables(path, choice, stated.dialect)
    return [(table, understood(path, table.headings, wanted, stated, line=table.header_line)) for table in tables]


def understood(
    path: Path, headings: Sequence[Heading], wanted: Collection[str], stated: Statements, line: int | None = None
) -> dict[str, ColumnStatement]:
    """What the columns of a table are, by channel: as stated, else by their own names, else by other names in use.

    InputError where two columns are the same channel.
    """
    found: dict[str, ColumnStatement] = {}
    taken = set()
    for channel, statement in stated.columns.items():
        if statement.column is not None and channel in (*wanted, "time"):
            places = [k for k, h in enumerate(headings) if _is_column(k, h, statement.column)]
            if len(places) > 1:
                told = f"there are {len(places)} columns {statement.column!r}: give its number, such as {places[1] + 1}"
                raise InputError(told, key=f"columns.{channel}.column")
            if places:
                found[channel] = _taken(statement, headings, places[0])
                taken.add(places[0])
    for own in (True, False):
        for channel in (*wanted, "time"):
            statement = stated.columns.get(channel, ColumnStatement())
            if channel in found or statement.absent or statement.column is not None or statement.rate is not None:
                continue
            places = [k for k, h in enumerate(headings) if k not in taken and channel_of(h.name) == channel
                      and is_own_name(h.name, channel) == own
                      and (own or fits(statement.unit or h.unit, channel))]  # fmt: skip
            if len(places) > 1:
                names = " and ".join(repr(_shown(headings[k])) for k in places[:2])
                told = f"column {headings[places[0]].name!r} stands there twice: {names}"
                told = told if own else f"{names} may both be {channel}: state which in [columns]"
                raise InputError(told, file=path, line=line)
            if places:
                found[channel] = _taken(statement, headings, places[0])
                taken.add(places[0])
    return found


def _taken(statement: ColumnStatement, headings: Sequence[Heading], place: int) -> ColumnStatement:
    """A statement with the column that it is: by name, or by number where two have that name."""
    name, unit = headings[place].name, headings[place].unit
    column = name if name and [heading.name for heading in headings].count(name) == 1 else place + 1
    return replace(statement, column=column, unit=statement.unit or unit)


def _shown(heading: Heading) -> str:
    return f"{heading.name} [{heading.unit}]" if heading.unit else heading.name


def _is_column(k: int, heading: Heading, column: str | int) -> bool:
    if isinstance(column, int):
        return k == column - 1
    return heading.name == column or _shown(heading) == column


def _place(headings: Sequence[Heading], statement: ColumnStatement) -> int:
    column = statement.column
    return next(k for k, heading in enumerate(headings) if column is not None and _is_column(k, heading, column))


def _check_stated(paths: Sequence[Path], tables: Sequence[tuple], stated: Statements) -> None:
    """InputError for a column that is stated and stands in none of the files."""
    headings = [heading for _, table, _ in tables for heading in table.headings]
    for channel, statement in stated.columns.items():
        column = statement.column
        if column is None or any(_is_column(k, h, column) for _, t, _ in tables for k, h in enumerate(t.headings)):
            continue
        names = [heading.name for heading in headings]
        told = nearest(str(column), names) if isinstance(column, str) else f"; there are {len(names)}"
        raise InputError(f"no column {column!r} in {paths[0].name}{told}", key=f"columns.{channel}.column")


def _check_spelling(
    path: Path, tables: Sequence[tuple], wanted: Collection[str], sources: dict[str, ChannelSource]
) -> None:
    """InputError for a column whose name is nearly that of a wanted channel that no column is."""
    import difflib

    for file, table, chosen in tables:
        used = {statement.column for statement in chosen.values()}
        for heading in table.headings:
            if heading.name in used or heading.name in MEASURED_UNITS or channel_of(heading.name):
                continue
            missing = [name for name in wanted if name not in sources]
            close = difflib.get_close_matches(heading.name.casefold(), missing, n=1, cutoff=_MISSPELLED)
            if close:
                told = f"unknown column {heading.name!r}; did you mean {close[0]!r}?"
                raise InputError(told, name=heading.name, file=file, line=table.header_line)


def _column(table: MeasuredTable, statement: ColumnStatement) -> Column | None:
    place = _place(table.headings, statement)
    return next((column for column in table.columns if column.place == place), None)


def _si(path: Path, table: MeasuredTable, channel: str, statement: ColumnStatement) -> np.ndarray:
    """A channel (rows,) in SI."""
    column = _column(table, statement)
    where = f"column {statement.column!r}"
    if column is None:
        raise InputError(f"{where} ({channel}) holds no numbers", file=path, line=table.header_line)
    if not statement.unit:
        example = f"{channel} [{MEASURED_UNITS[channel]}]"
        told = f"{where} needs a name and a unit, such as '{example}', or its unit in [columns]"
        raise InputError(told, file=path, line=table.header_line)
    values = np.empty(len(column.values))
    scaled = (statement.scale, statement.offset, statement.sign) != (1.0, 0.0, 1.0)
    try:
        for k in range(0, len(values), _PART):  # of many readings a part at once
            part = column.values[k : k + _PART]
            part = statement.sign * (statement.scale * part + statement.offset) if scaled else part
            values[k : k + _PART] = convert(part, spelled(statement.unit), MEASURED_UNITS[channel], where)
    except InputError as error:
        raise error.at(file=path, line=table.header_line) from None
    return values


def _clock(path: Path, table: MeasuredTable, chosen: dict[str, ColumnStatement], stated: Statements) -> EvenClock:
    """The even clock of a table."""
    time = stated.columns.get("time", ColumnStatement())
    if "time" in chosen:
        column = _column(table, chosen["time"])
        clocked = column is not None and column.heading.unit == "s" and table.start is not None
        statement = replace(chosen["time"], unit="s") if clocked else chosen["time"]
        times = _si(path, table, "time", statement)

        def same(row: int, other: int) -> bool:
            pairs = ((column.values[row], column.values[other]) for column in table.columns)
            return all(a == b or (np.isnan(a) and np.isnan(b)) for a, b in pairs)

        return even_clock(times, path, table.line_of, same)
    if time.rate is not None:
        count = len(table.columns[0].values)
        return EvenClock(0.0, 1.0 / time.rate, count)
    names = [heading.name for heading in table.headings]
    advice = f"no column 'time'{nearest('time', names)}; state its column, or a rate, in [columns]"
    raise InputError(advice, file=path, line=table.header_line)


def _joined(
    path: Path, laid: Sequence[tuple[EvenClock, float | None, dict[str, np.ndarray]]]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """All channels on the clock of the fastest, where it has been running."""
    absolute = [start is not None for _, start, _ in laid]
    if any(absolute) and not all(absolute):
        raise InputError("some tables have times of day and others do not: what was when is not known", file=path)
    zero = min((start for _, start, _ in laid if start is not None), default=0.0)
    fastest, begun, _ = min(laid, key=lambda one: one[0].step)
    if fastest.count > MOST_MEASURED_SAMPLES:
        raise InputError(f"{fastest.count} samples are more than {MOST_MEASURED_SAMPLES}", file=path)
    first = fastest.start + ((begun or 0.0) - zero)
    values: dict[str, np.ndarray] = {}
    for clock, start, columns in laid:
        if clock is fastest or (clock.count == fastest.count and clock.step == fastest.step
                                and clock.start + (start or 0.0) == fastest.start + (begun or 0.0)):  # fmt: skip
            values |= columns
            continue
        places = (clock.times + ((start or 0.0) - zero) - first) / fastest.step
        inside = (places > -0.5) & (places < fastest.count - 0.5)
        if not inside.any():
            raise InputError(f"{', '.join(columns)} was not measured at the times of the other channels", file=path)
        at = np.round(places[inside]).astype(np.int64)
        for name, column in columns.items():
            values[name] = np.full(fastest.count, np.nan)
            values[name][at] = column[inside]
    return fastest.step * np.arange(fastest.count), values
