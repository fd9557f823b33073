"""A table of measured columns, as every reader of a file format gives it, and the bounds of what is read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

MOST_MEASURED_BYTES = 2_000_000_000  # of a measurement file
MOST_MEASURED_SAMPLES = 20_000_000  # rows of a table
MOST_COLUMNS = 4_000
MOST_MEMORY = 8_000_000_000  # bytes of address space of the process that reads a binary format


@dataclass(frozen=True)
class Heading:
    """What a file says of a column: its `name` and, "" where it tells none, its `unit`."""

    name: str
    unit: str = ""


Choice = Callable[[Sequence[Heading]], Collection[int]]
"""Which columns of a table are wanted, by index: what nobody wants is not read."""


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file: its `place` among the headings, and `values` (n,) in the heading's unit, NaN where nothing
    was measured."""

    place: int
    heading: Heading
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class MeasuredTable:
    """Columns of one length: a CSV file, a sheet, or a group of channels with one clock.

    `headings` are those of all columns of the table, `columns` those that were chosen. Times of day are columns in "s"
    from the first row, and `start` says when that was, in s of an absolute clock. `header_line` and `line_of(row)`
    are lines of a text file, None elsewhere. `notes` say in words what was left out, `form` how the
    file is written.
    """

    name: str
    headings: tuple[Heading, ...]
    columns: tuple[Column, ...]
    start: float | None = None
    header_line: int | None = None
    line_of: Callable[[int], int | None] = lambda row: None
    notes: tuple[str, ...] = ()
    form: str = ""
