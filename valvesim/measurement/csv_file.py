"""Text files of columns (CSV, TSV, TXT, DAT): numbers by pandas, cells counted line by line, so that none is shifted.

pandas rounds every number correctly. It lets a row of too many cells pass where not all columns are wanted, and fills
one of too few: both are refused here, with the line.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.io import check_file, reason
from valvesim.measurement.clock_text import clock_seconds
from valvesim.measurement.dialect import (
    MISSING,
    SAMPLE_BYTES,
    Dialect,
    Layout,
    cells_of,
    encoding_of,
    is_begun,
    is_missing,
    is_numeric,
    layout_of,
)
from valvesim.measurement.table import (
    MOST_COLUMNS,
    MOST_MEASURED_BYTES,
    MOST_MEASURED_SAMPLES,
    Choice,
    Column,
    MeasuredTable,
)

_CHUNK_ROWS = 500_000
_CHUNK_BYTES = 1 << 23
_MISSING = sorted({spelling for word in MISSING for spelling in (word, word.upper(), word.capitalize(), word.title())}
                  | {"NaN", "-NaN", "1.#QNAN", "-1.#IND"})  # fmt: skip
_SPACES = np.frombuffer(b" \t\r\f\v", dtype=np.uint8)
_NEWLINE, _RETURN, _QUOTE = (ord(c) for c in '\n\r"')


def read_csv(path: Path, choice: Choice, stated: Dialect) -> tuple[MeasuredTable, ...]:
    """The one table of a text file. Raises InputError with the line of what makes no sense."""
    check_file(path, MOST_MEASURED_BYTES)
    try:
        raw, encoding = _bytes_of(path, stated)
        layout = layout_of(path, _sample(path, raw, encoding), encoding, stated)
        if len(layout.kinds) > MOST_COLUMNS:
            raise InputError(f"{len(layout.kinds)} columns are more than {MOST_COLUMNS}", file=path)
        rows, end, notes = _count_rows(path, raw, layout)
        raw = raw.until(end)
        try:
            wanted = sorted(choice(layout.headings))
        except InputError as error:
            raise error.at(file=path, line=layout.header_line) from None
        columns, start = _columns(path, raw, layout, wanted, rows)
    except InputError as error:
        raise error if error.file else error.at(file=path) from None
    except (OSError, UnicodeError) as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None
    return (
        MeasuredTable(
            name=path.name, headings=layout.headings, columns=columns, start=start, header_line=layout.header_line,
            line_of=partial(_line_in_file, path, layout), notes=notes, form=layout.in_words,
        ),
    )  # fmt: skip


def _bytes_of(path: Path, stated: Dialect) -> tuple[FileBytes, str]:
    """The bytes of a file and their encoding; of UTF-16 those of the same text in UTF-8."""
    with open(path, "rb") as file:
        start = file.read(4096)
    if not start:
        raise InputError("holds no data (a header line and rows of numbers are expected)", file=path)
    encoding = stated.encoding or encoding_of(path, start)
    return _mapped(path, encoding), "utf-8" if encoding.startswith("utf-16") else encoding


def _mapped(path: Path, encoding: str) -> FileBytes:
    if encoding.startswith("utf-16"):
        return FileBytes(path, path.read_text(encoding=encoding).lstrip("\ufeff").encode("utf-8"))
    return FileBytes(path)


class FileBytes:
    """The bytes of a file, of which only what is asked for is held; or those of its text in another encoding."""

    def __init__(self, path: Path, held: bytes | None = None, end: int | None = None):
        self.path, self.held = path, held
        self.end = end if end is not None else path.stat().st_size if held is None else len(held)

    def __len__(self) -> int:
        return self.end

    def until(self, end: int) -> FileBytes:
        """The same without what comes after `end`."""
        return FileBytes(self.path, self.held, end)

    def part(self, start: int, stop: int) -> bytes:
        """The bytes from `start` to `stop`."""
        stop = min(stop, self.end)
        if self.held is not None:
            return self.held[start:stop]
        with open(self.path, "rb") as file:
            file.seek(start)
            return file.read(max(stop - start, 0))


def _sample(path: Path, raw: FileBytes, encoding: str) -> str:
    """The text of the beginning of a file, in whole lines."""
    start = raw.part(0, SAMPLE_BYTES)
    if 0 in start:
        raise InputError("holds zero bytes: it is no text", file=path)
    if len(raw) > SAMPLE_BYTES:
        start = start[: max(start.rfind(b"\n"), start.rfind(b"\r")) + 1] or start
    return start.decode(encoding, errors="replace" if len(raw) > SAMPLE_BYTES and b"\n" not in start else "strict")


def _lines(raw: FileBytes) -> Iterator[np.ndarray]:
    """Blocks of whole lines, (n,) bytes each; lines end with line feeds, or with carriage returns alone."""
    ends = bytes([_line_end(raw)])
    start = 0
    while start < len(raw):
        block = raw.part(start, start + _CHUNK_BYTES)
        if start + len(block) < len(raw):
            block = block[: block.rfind(ends) + 1]
        if not block:
            raise InputError(f"a line of more than {_CHUNK_BYTES} bytes", file=raw.path)
        yield np.frombuffer(block, dtype=np.uint8)
        start += len(block)


def _line_end(raw: FileBytes) -> int:
    return _NEWLINE if b"\n" in raw.part(0, _CHUNK_BYTES) else _RETURN


def _count_rows(path: Path, raw: FileBytes, layout: Layout) -> tuple[int, int, tuple[str, ...]]:
    """(rows of data, bytes that hold them, notes); InputError for a row of other than all columns, and for too many.

    A last line without an end may have been cut off: it is left out where cells are missing, and told in any case.
    """
    count, line, rows, used = len(layout.kinds), 1, 0, len(raw)
    notes: list[str] = []
    end = _line_end(raw)
    for block in _lines(raw):
        if (block == 0).any():
            raise InputError("holds zero bytes: it is no text", file=path)
        if end == _NEWLINE:
            _check_returns(path, block, line)
        stops = np.flatnonzero(block == end)
        last = not len(stops) or stops[-1] != len(block) - 1
        if last:
            stops = np.append(stops, len(block))
        starts = np.concatenate([[0], stops[:-1] + 1])
        cells = _cells(block, starts, stops, layout.separator)
        blank = np.flatnonzero(
            (cells == 1) & ((stops - starts < 2) | np.isin(block[np.minimum(starts, len(block) - 1)], _SPACES))
        )
        cells[[k for k in blank if not block[starts[k] : stops[k]].tobytes().strip()]] = 0
        numbers = line + np.arange(len(stops))
        data = (numbers >= layout.data_line) & (cells > 0)
        if last and data[-1]:
            notes.append("the file ends without an end of its last line, which may be cut off")
            begun_bytes = block[starts[-1] : stops[-1]].tobytes()
            begun = begun_bytes.decode(layout.encoding, errors="replace")
            if 0 < cells[-1] < count and is_begun(cells_of(begun, layout.separator)[0], layout.decimal):
                notes[-1] += ": its row is left out"
                data[-1], used = False, len(raw) - len(begun_bytes)
        wrong = np.flatnonzero(data & (cells != count)) if layout.separator != " " else np.array([], dtype=int)
        if len(wrong):
            k = int(wrong[0])
            told = f"{cells[k]} cells under {count} columns"
            raise InputError(told + ("; is a comma a point?" if layout.separator == "," else ""), file=path,
                             line=int(numbers[k]))  # fmt: skip
        rows, line = rows + int(np.count_nonzero(data)), line + len(stops)
        if rows > MOST_MEASURED_SAMPLES:
            raise InputError(f"more than {MOST_MEASURED_SAMPLES} rows", file=path)
    if rows == 0:
        raise InputError("holds no data (a header line and rows of numbers are expected)", file=path)
    return rows, used, tuple(notes)


def _check_returns(path: Path, block: np.ndarray, line: int) -> None:
    """InputError for a carriage return within a line, which some take for its end; `line` is the block's first."""
    returns = np.flatnonzero(block == _RETURN)
    if not len(returns):
        return
    within = returns[(returns + 1 < len(block)) & (block[np.minimum(returns + 1, len(block) - 1)] != _NEWLINE)]
    if len(within):
        number = line + int(np.count_nonzero(block[: within[0]] == _NEWLINE))
        raise InputError("a carriage return in the middle of a line", file=path, line=number)


def _cells(block: np.ndarray, starts: np.ndarray, stops: np.ndarray, separator: str) -> np.ndarray:
    """How many cells each line of a block has."""
    if (block == _QUOTE).any():
        text = [block[a:b].tobytes().decode("latin-1") for a, b in zip(starts, stops, strict=True)]
        return np.array([len(cells_of(line, separator)) for line in text])
    before = np.searchsorted(np.flatnonzero(block == ord(separator)), stops)
    return np.diff(before, prepend=0) + 1


def _columns(
    path: Path, raw: FileBytes, layout: Layout, wanted: Sequence[int], rows: int
) -> tuple[tuple[Column, ...], float | None]:
    """The wanted columns (rows,) of numbers and times, and when the first row of times of day was."""
    numbers = [k for k in wanted if layout.kinds[k] == "number"]
    values = _numbers(path, raw, layout, numbers, rows)
    start = None
    for k in wanted:
        if layout.kinds[k] == "clock":
            texts = np.concatenate([chunk[k].to_numpy() for chunk in _chunks(raw, layout, [k], str)])
            _check_count(path, len(texts), rows, whole=True)
            values[k], start = clock_seconds(texts, path, lambda row: _line_of(raw, layout, row))
    headings = layout.headings
    return tuple(
        Column(k, type(headings[k])(headings[k].name, "s") if layout.kinds[k] == "clock" else headings[k], values[k])
        for k in wanted if k in values
    ), start  # fmt: skip


def _numbers(path: Path, raw: FileBytes, layout: Layout, wanted: Sequence[int], rows: int) -> dict[int, np.ndarray]:
    """Columns of numbers by index; where anything is odd, cell by cell, for the line of what makes no sense."""
    values = {k: np.full(rows, np.nan) for k in wanted}
    if not values:
        return values
    at = 0
    try:
        for chunk in _chunks(raw, layout, wanted, float):
            _check_count(path, at + len(chunk), rows, whole=False)
            for k, column in values.items():
                column[at : at + len(chunk)] = chunk[k].to_numpy()
            at += len(chunk)
    except ValueError:  # text among the numbers
        at = 0
        for chunk in _chunks(raw, layout, wanted, str):
            _check_count(path, at + len(chunk), rows, whole=False)
            for k, column in values.items():
                for j, cell in enumerate(chunk[k].tolist(), start=at):
                    column[j] = _number(path, raw, layout, cell, k, j)
            at += len(chunk)
    _check_count(path, at, rows, whole=True)
    for column in values.values():
        column[np.isinf(column)] = np.nan
    return values


def _check_count(path: Path, found: int, rows: int, *, whole: bool) -> None:
    """InputError where the parser finds other rows than there are lines: quotes that go over lines."""
    if found > rows or (whole and found < rows):
        raise InputError(f"{found} rows were read of {rows}: it is no plain table of columns", file=path)


def _number(path: Path, raw: FileBytes, layout: Layout, cell: str, k: int, row: int) -> float:
    if is_numeric(cell, layout.decimal):
        return float(cell.strip().replace(",", "."))
    if is_missing(cell):
        return np.nan
    told = f"{cell!r} in column {layout.headings[k].name!r} is not a number"
    if layout.decimal == "." and is_numeric(cell, ","):
        told += " (a decimal comma? then all of the column must have it)"
    raise InputError(told, file=path, line=_line_of(raw, layout, row))


def _chunks(raw: FileBytes, layout: Layout, wanted: Sequence[int], kind: type) -> Iterator[Any]:
    """Data frames of the rows of data, a part at a time."""
    import pandas

    options: dict[str, Any] = (
        {"dtype": float, "keep_default_na": False, "na_values": _MISSING} if kind is float
        else {"dtype": str, "keep_default_na": False, "na_filter": False}
    )  # fmt: skip
    spaced = layout.separator == " "
    file = io.BufferedReader(_Bytes(raw), 1 << 20)
    with _no_table(pandas.errors.ParserError), pandas.read_csv(
        file, sep=r"\s+" if spaced else layout.separator, decimal=layout.decimal, header=None,
        names=None if spaced else range(len(layout.kinds)), usecols=None if spaced else list(wanted),
        skiprows=layout.data_line - 1,
        encoding=layout.encoding, skip_blank_lines=True,
        skipinitialspace=not spaced and layout.separator != "\t", index_col=False, engine="c", chunksize=_CHUNK_ROWS,
        **options,
    ) as chunks:  # fmt: skip
        for chunk in chunks:
            if spaced and kind is float and chunk.isna().any(axis=None):
                raise ValueError("a row of too few cells, or a cell of text")
            yield chunk


@contextlib.contextmanager
def _no_table(error_of_pandas: type[Exception]) -> Iterator[None]:
    """InputError for what pandas cannot parse, such as quotes that are never closed."""
    try:
        yield
    except error_of_pandas as error:
        raise InputError(f"is no plain table of columns ({str(error).strip()})") from None


class _Bytes(io.RawIOBase):
    """Mapped bytes as a file, of which only what is being read is held."""

    def __init__(self, raw: FileBytes):
        self.raw, self.at = raw, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        part = self.raw.part(self.at, self.at + len(buffer))
        buffer[: len(part)] = part
        self.at += len(part)
        return len(part)


def _line_in_file(path: Path, layout: Layout, row: int) -> int | None:
    """The line of a row of data in a file as it is now; None where it cannot be read any more."""
    try:
        with open(path, "rb") as file:
            return _line_of(_mapped(path, encoding_of(path, file.read(4096))), layout, row)
    except (OSError, ValueError):
        return None


def _line_of(raw: FileBytes, layout: Layout, row: int) -> int:
    """The line of a row of data, counted from 0."""
    line, seen, end = 0, -1, bytes([_line_end(raw)])
    for block in _lines(raw):
        for text in block.tobytes().split(end)[: None if block[-1] != end[0] else -1]:
            line += 1
            seen += line >= layout.data_line and bool(text.strip())
            if seen == row:
                return line
    return line
