"""The dialect of a text file of columns, found in its beginning: encoding, separator, decimal sign, header, units.

What can be read in two ways that give other numbers is refused, with what to state in `[csv]`.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import functools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from valvesim.errors import InputError
from valvesim.measurement.headings import channel_of, heading_of, is_unit, spelled
from valvesim.measurement.table import Heading

SEPARATORS = {";": ";", "tab": "\t", ",": ",", "|": "|", "space": " "}
"""Separators by the name that `[csv]` gives them, likelier ones first where two read the same."""
MISSING = frozenset({
    "", "nan", "-nan", "+nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "1.#qnan", "-1.#ind", "#num!",
    "inf", "+inf", "-inf", "infinity", "-infinity", "+infinity", "1.#inf", "-1.#inf", "ovld", "over", "under",
})  # fmt: skip
"""Cells, in small letters, that stand for what was not measured; an infinite reading is an overload."""

SAMPLE_BYTES = 262_144
_SAMPLE_LINES = 400
_POINT = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?(?:\d+(?:,\d*)?|,\d+)(?:[eE][+-]?\d+)?")
_COMMENT = re.compile(r"^\s*[#%]+\s*")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
_CLOCK = re.compile(
    r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]?\s*)?\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?"
    r"\s*(?:[AaPp][Mm])?(?:Z|[+-]\d{2}:?\d{2})?"
)


@dataclass(frozen=True, kw_only=True)
class Dialect:
    """What is stated of a text file; None where it is to be found. `header_line` is that of the names, 0 for none."""

    separator: str | None = None
    decimal: str | None = None
    encoding: str | None = None
    header_line: int | None = None


NO_DIALECT = Dialect()


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A dialect that was found: `kinds` of the columns are "number", "clock" and "text"; lines count from 1."""

    separator: str
    decimal: str
    encoding: str
    header_line: int | None
    data_line: int
    headings: tuple[Heading, ...]
    kinds: tuple[str, ...]

    @property
    def in_words(self) -> str:
        """Separator, decimal sign, encoding and header."""
        separator = next(name for name, sign in SEPARATORS.items() if sign == self.separator)
        names = f"names in line {self.header_line}" if self.header_line is not None else "no names"
        decimal = "comma" if self.decimal == "," else "point"
        return f"separator {separator}, decimal {decimal}, {self.encoding}, {names}, data from line {self.data_line}"


def is_numeric(cell: str, decimal: str) -> bool:
    """Whether a cell is a number with this decimal sign."""
    return (_COMMA if decimal == "," else _POINT).fullmatch(cell.strip()) is not None


def is_begun(cell: str, decimal: str) -> bool:
    """Whether a cell may be the beginning of a number or of a time."""
    return is_numeric(cell, decimal) or is_missing(cell) or _CLOCK.fullmatch(cell.strip()) is not None


def is_missing(cell: str) -> bool:
    """Whether a cell stands for what was not measured."""
    return cell.strip().casefold() in MISSING


def encoding_of(path: Path, start: bytes) -> str:
    """The encoding of a file: its mark, else UTF-8 where all of it is, else cp1252."""
    for mark, name in (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if start.startswith(mark):
            return name
    for name, parity in (("utf-16-le", 1), ("utf-16-be", 0)):
        zeros = start[parity:1000:2]
        if len(zeros) > 4 and zeros.count(0) > 0.8 * len(zeros):
            return name
    if b"\0" in start:
        raise InputError(
            "holds zero bytes: it is no text (of a binary file, the extension tells the format)", file=path
        )
    for name in ("utf-8", "cp1252"):
        decoder = codecs.getincrementaldecoder(name)()
        try:
            with open(path, "rb") as file:
                while block := file.read(1 << 22):
                    decoder.decode(block)
                decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            continue
        return name
    raise InputError("is neither UTF-8 nor cp1252 text; state the encoding in [csv]", file=path)


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of a line."""
    if separator == " ":
        return re.split(r"\s+(?![\[({])", line.strip())
    if '"' in line:
        with contextlib.suppress(csv.Error):  # a carriage return within, a cell of more than 128 kB
            return next(csv.reader([line], delimiter=separator), [])
    return line.split(separator)


@dataclass(frozen=True)
class _Reading:
    """One way to read the beginning of a file, and how well it fits."""

    separator: str
    decimal: str
    first: int  # index of the first row of data among the lines
    rows: tuple[list[str], ...]
    kinds: tuple[str, ...]
    header: tuple[int, ...]  # indices of the lines of names and, where there is one, units

    @functools.cached_property
    def rank(self) -> tuple[bool, float, int, float]:
        """Whether a header fits, the share of columns that are no text, how many these are, and the share of their
        cells that are none."""
        numbers = self.kinds.count("number") + self.kinds.count("clock")
        places = [j for j, kind in enumerate(self.kinds) if kind == "number"]
        clean = [is_numeric(row[j], self.decimal) or is_missing(row[j]) for row in self.rows for j in places]
        return bool(self.header), numbers / len(self.kinds), numbers, float(sum(clean)) / max(len(clean), 1)


def _as_stated(stated: Dialect) -> str:
    """How a file was to be read, in words, where that was stated."""
    separators = {separator: name for name, separator in SEPARATORS.items()}
    told = [f"separator {separators[stated.separator]}"] if stated.separator is not None else []
    told += [f"decimal {stated.decimal!r}"] if stated.decimal is not None else []
    told += [f"header in line {stated.header_line}"] if stated.header_line is not None else []
    return f" with the stated {', '.join(told)}" if told else ""


def layout_of(path: Path, text: str, encoding: str, stated: Dialect) -> Layout:
    """The layout of a file by the `text` of its beginning. Raises InputError where there is none, or more than one."""
    every = enumerate(text.split("\n" if "\n" in text else "\r"), start=1)
    lines = [(n, _COMMENT.sub("", line.rstrip("\r"))) for n, line in every if line.strip()][:_SAMPLE_LINES]
    expected = "a header line and rows of numbers are expected"
    if not lines:
        raise InputError(f"holds no data ({expected})", file=path)
    readings = [
        reading
        for separator in (_separators_of(text) if stated.separator is None else (stated.separator,))
        for decimal in ((".", ",") if stated.decimal is None else (stated.decimal,))
        if (separator != decimal or '"' in text)
        and (reading := _reading(lines, separator, decimal, stated.header_line)) is not None
    ]
    if not readings:
        raise InputError(f"holds no data{_as_stated(stated)} ({expected})", file=path)
    if any(one.separator != " " and one.header and one.rank[1] == 1.0 for one in readings):
        readings = [one for one in readings if one.separator != " "]
    readings.sort(key=lambda reading: reading.rank, reverse=True)
    best = readings[0]
    for other in readings[1:]:
        unsure = other.rank == best.rank or (not best.header and other.rank[1::2] == best.rank[1::2] == (1.0, 1.0))
        if unsure and not _alike(best, other):
            raise _two_ways(path, lines, best)
    if not best.header and stated.header_line is None and lines[best.first][0] > 1:
        raise _unmatched(path, lines, best)
    if best.decimal == "," and stated.decimal is None:
        commas = [c.strip() for row in best.rows for c, kind in zip(row, best.kinds, strict=True)
                  if kind == "number" and "," in c]  # fmt: skip
        if commas and all(_THOUSANDS.fullmatch(cell) for cell in commas):
            raise InputError(
                f"{commas[0]!r} may be {commas[0].replace(',', '.')} or {commas[0].replace(',', '')}: state [csv] "
                "decimal = ',' or write numbers without separators of thousands",
                file=path, line=lines[best.first][0],
            )  # fmt: skip
    headings = _headings(path, lines, best)
    return Layout(
        separator=best.separator, decimal=best.decimal, encoding=encoding,
        header_line=lines[best.header[0]][0] if best.header else None, data_line=lines[best.first][0],
        headings=headings, kinds=best.kinds,
    )  # fmt: skip


def _separators_of(text: str) -> list[str]:
    """The separators that a text may have, likelier ones first: of those that are nowhere in it the first alone, for
    all of them give the same one column.
    """
    nowhere = [sign for sign in SEPARATORS.values() if sign != " " and sign not in text]
    return [sign for sign in SEPARATORS.values() if sign not in nowhere[1:]]


def _two_ways(path: Path, lines: Sequence[tuple[int, str]], best: _Reading) -> InputError:
    line = lines[best.first]
    told = f"{line[1].strip()[:60]!r} can be read in two ways: state [csv] separator and decimal"
    return InputError(f"{told}, such as separator = ';' and decimal = ','", file=path, line=line[0])


def _unmatched(path: Path, lines: Sequence[tuple[int, str]], best: _Reading) -> InputError:
    """The error where no line above the data has as many cells as the data."""
    number, above = lines[best.first - 1] if best.first else lines[best.first]
    count, own = len(best.kinds), len(cells_of(above, best.separator))
    told = f"{count} cells under {own} columns; is a comma a point?"
    return InputError(f"{told} (or state [csv] separator and decimal)", file=path, line=lines[best.first][0])


def _reading(
    lines: Sequence[tuple[int, str]], separator: str, decimal: str, header_line: int | None
) -> _Reading | None:
    """The lines read with a separator and a decimal sign; None where that gives no columns of numbers."""
    split = [cells_of(line, separator) for _, line in lines]
    numeric = [[is_numeric(cell, decimal) for cell in row] for row in split]
    counts = [len(row) for row, numbers in zip(split, numeric, strict=True) if any(numbers)]
    if not counts:
        return None
    count = max(set(counts), key=counts.count)
    clock = [
        [not number and _CLOCK.fullmatch(cell.strip()) is not None for cell, number in zip(row, numbers, strict=True)]
        for row, numbers in zip(split, numeric, strict=True)
    ]
    later = [k for k in range(len(lines) // 2, len(lines)) if len(split[k]) == count] or [
        k for k in range(len(lines)) if len(split[k]) == count and any(numeric[k])
    ]
    kinds = tuple(_kind([split[k][j] for k in later], [numeric[k][j] for k in later], [clock[k][j] for k in later])
                  for j in range(count))  # fmt: skip
    if "number" not in kinds:
        return None

    def is_data(k: int) -> bool:
        row = split[k]
        if len(row) != count or not any(numeric[k]):
            return False
        return all(
            kind == "text" or (n if kind == "number" else t) or is_missing(cell)
            for cell, kind, n, t in zip(row, kinds, numeric[k], clock[k], strict=True)
        )

    start = 0 if header_line is None else next((k for k, (n, _) in enumerate(lines) if n > header_line), len(lines))
    first = next((k for k in range(start, len(lines)) if is_data(k)), None)
    if first is None:
        return None
    for k in range(first + 1, min(first + 4, len(lines))):  # rows of numbers in a preamble, then the header
        if len(split[k]) == count and not any(numeric[k]) and any(channel_of(heading_of(c).name) for c in split[k]):
            first = next((j for j in range(k + 1, len(lines)) if is_data(j)), first)
    rows = [split[k] for k in range(first, len(lines))]
    if sum(map(is_data, range(first, len(lines)))) < 0.5 * len(rows):
        return None
    header = _header(split, numeric, first, count, [n for n, _ in lines], header_line)
    if header or header_line is not None:  # a row below the names that holds numbers is data, even where it is wrong
        below = header[-1] + 1 if header else start
        first = next(k for k in range(below, first + 1) if k == first or any(numeric[k]))
    whole = tuple(row for row in rows if len(row) == count)
    return _Reading(separator, decimal, first, whole, kinds, header)


def _kind(cells: Sequence[str], numeric: Sequence[bool], clock: Sequence[bool]) -> str:
    """What a column holds, by its cells in the later half of the sample: one that is wrong is told when it is read."""
    there = [k for k, cell in enumerate(cells) if not is_missing(cell)]
    if not there:
        return "number"
    share = sum(numeric[k] for k in there) / len(there)
    if sum(clock[k] for k in there) >= 0.5 * len(there) and share < 0.5:
        return "clock"
    return "number" if share >= 0.5 else "text"


def _header(
    split: Sequence[list[str]], numeric: Sequence[list[bool]], first: int, count: int, numbers: Sequence[int],
    stated: int | None,
) -> tuple[int, ...]:  # fmt: skip
    """Indices of the line of names above the data and of that of units, where there is one; () without a header."""
    if stated is not None:
        names = [k for k, n in enumerate(numbers) if n == stated]
        if not names:
            return ()
        under = names[0] + 1
        return (names[0], under) if under < first and _is_units(split[under]) else (names[0],)

    def is_names(k: int) -> bool:
        row = split[k]
        full = len(row) == count or (len(row) == count + 1 and not row[-1].strip())
        full = full or (
            len(row) == count - 1 and not any(r[count - 1].strip() for r in split[first:] if len(r) == count)
        )
        return full and not any(numeric[k]) and any(cell.strip() for cell in row)

    above = [k for k in range(first - 1, max(first - 4, -1), -1) if is_names(k)]
    if not above:
        return ()
    if len(above) > 1 and above[1] == above[0] - 1 and _is_units(split[above[0]]) and not _is_units(split[above[1]]):
        return above[1], above[0]
    return (above[0],)


def _is_units(row: Sequence[str]) -> bool:
    return all(map(is_unit, row)) and any(cell.strip() for cell in row)


def _headings(path: Path, lines: Sequence[tuple[int, str]], best: _Reading) -> tuple[Heading, ...]:
    """The headings of the columns; numbers from 1 on where the file has none."""
    count = len(best.kinds)
    if not best.header:
        return tuple(Heading(str(k)) for k in range(1, count + 1))
    names = [*cells_of(lines[best.header[0]][1], best.separator), ""][:count]
    found = [heading_of(name) for name in names]
    if len(best.header) > 1:
        units = [*cells_of(lines[best.header[1]][1], best.separator), *[""] * count][:count]
        found = [Heading(heading.name, heading.unit or spelled(unit).strip("- "))
                 for heading, unit in zip(found, units, strict=True)]  # fmt: skip
    return tuple(found)


def _alike(one: _Reading, other: _Reading) -> bool:
    """Whether two readings give the same numbers in the same columns."""
    return one.kinds == other.kinds and list(_numbers(one)) == list(_numbers(other))


def _numbers(reading: _Reading) -> Iterator[list[str]]:
    for row in reading.rows:
        yield [cell.strip().replace(reading.decimal, ".") if kind == "number" else cell.strip()
               for cell, kind in zip(row, reading.kinds, strict=True)]  # fmt: skip
