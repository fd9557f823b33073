"""Reading TOML and CSV columns with units within bounds, and writing CSV and any file so that none is half-written."""

from __future__ import annotations

import contextlib
import csv
import os
import re
import stat
import tempfile
import tomllib
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from valvesim.errors import InputError, nearest, unknown_name
from valvesim.temporary_files import made_folder, temporary_path
from valvesim.units import convert

MOST_BYTES = 256_000_000  # of a file of columns
MOST_ROWS = 5_000_000  # of a file of columns, a number of 8 bytes each
MOST_TEXT = 500_000  # bytes of a TOML file
DEEPEST = 16  # tables and lists in one another, and parts of a key, of a TOML file
_NAME = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w.\"'-]){_NAME}(?:[ \t]*+\.[ \t]*+{_NAME}){{{DEEPEST}}}")


def check_file(path: Path, most: int, expected: str = "") -> None:
    """InputError unless `path` is a regular file of at most `most` bytes: no folder, pipe or device."""
    try:
        status = os.stat(path)
    except FileNotFoundError:
        raise InputError(f"no such file{'; ' if expected else ''}{expected}", file=path) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise InputError(f"cannot be read (it is {kind}, not a file{'; ' if expected else ''}{expected})", file=path)
    if status.st_size > most:
        raise InputError(f"{status.st_size / 1e6:.4g} MB are more than the {most / 1e6:g} MB that are read", file=path)


def read_toml(path: Path, expected: str = "") -> tuple[str, dict[str, Any]]:
    """(text, table) of a TOML file; InputError where it cannot be read, and what was `expected` where there is none.

    What a file may hold is bounded (`MOST_TEXT`, `DEEPEST`, whole numbers of 64 bits): a bad one is refused at once.
    """
    check_file(path, MOST_TEXT, expected)
    try:
        text = path.read_text(encoding="utf-8-sig")
        if (long := _LONG_KEY.search(text)) is not None:
            line = text.count("\n", 0, long.start()) + 1
            raise InputError(f"a key of more than {DEEPEST} parts", file=path, line=line)
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    except RecursionError:
        raise InputError(f"not valid TOML: lists or tables nested more than {DEEPEST} deep", file=path) from None
    except InputError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None
    except ValueError:
        raise InputError("not valid TOML: a whole number of thousands of digits", file=path) from None
    _check_nesting(table, path)
    return text, table


def _check_nesting(table: dict[str, Any], path: Path) -> None:
    """InputError for what is nested too deep to be shown, and for whole numbers beyond 64 bits, with the key."""
    level: list[tuple[str, Any]] = [("", table)]
    for _ in range(DEEPEST + 1):
        deeper: list[tuple[str, Any]] = []
        for key, value in level:
            if isinstance(value, dict):
                deeper += [(f"{key}.{name}" if key else name, inner) for name, inner in value.items()]
            elif isinstance(value, list):
                deeper += [(key, inner) for inner in value]
            elif isinstance(value, int) and abs(value) >= 2**63:
                raise InputError(f"a whole number of {value.bit_length()} bits; 64 are read", file=path, key=key)
        if not deeper:
            return
        level = deeper
    raise InputError(f"nested more than {DEEPEST} deep", file=path, key=level[0][0].partition(".")[0])


def check_known(table: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    """InputError for the first key of a table that is not one of `names`."""
    for name in table:
        if name not in names:
            raise unknown_name("key", name, names, where)


def check_tables(table: Mapping[str, Any], names: Sequence[str]) -> None:
    """InputError for a section that is no table; the effects may be a list of tables."""
    for name in names:
        given = table.get(name, {})
        if not isinstance(given, dict) and not (name == "effects" and isinstance(given, list)):
            raise InputError(f"expected a table, got {given!r}", key=name)


def read_names(given: Any, where: str, what: str) -> tuple[str, ...]:
    """InputError unless `given` is a list of text; `what` they are the names of."""
    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise InputError(f"expected a list of {what} names, got {given!r}", key=where)
    return tuple(given)


def check_printable(text: Any, where: str) -> None:
    """InputError unless `text` is text without control characters, which would reach a terminal or a document."""
    if not isinstance(text, str):
        raise InputError(f"expected text, got {text!r}", key=where)
    if len(text) > 200:
        raise InputError(f"{len(text)} characters are more than 200", key=where)
    for character in text:
        if not character.isprintable():
            raise InputError(f"holds the control character {character!r}; {text!r}", key=where)


@contextmanager
def located(path: Path, text: str, *, document: str = "", settings: Sequence[str] = ()) -> Iterator[None]:
    """An InputError from inside gets the file and line of the key that it speaks of, or the setting that it does.

    `document` is the table in which errors name the top of the file, `settings` are `KEY=VALUE` texts that took the
    place of what stands in it.
    """
    try:
        yield
    except InputError as error:
        keys = [key.removeprefix(f"{document}.") for key in error.keys]
        for setting in settings:
            own = setting.partition("=")[0].strip()
            if any(key == own or key.startswith(f"{own}.") for key in keys):
                raise error.at(setting=setting) from None
        line = line_of_key(text, keys)
        if error.file:  # it speaks of another file, which this one names
            raise InputError(str(error), file=path, line=line) from None
        raise error.at(file=path, line=line) from None


def line_of_key(text: str, keys: Sequence[str]) -> int | None:
    """The first line of a TOML text that holds one of the dotted `keys`, or of the tables that they stand in.

    What lies deepest is taken; None where nothing of them stands there. An entry of a list of tables may be named by
    its number, from 1: `records.2.file`.
    """
    spoken = {key for name in keys for key in _with_tables(name)}
    sections, found, best = [""], None, 0
    counts: Counter[str] = Counter()
    for number, line in enumerate(text.split("\n"), start=1):
        told = _keys_of_line(line)
        if told and line.lstrip().startswith("["):
            name = told[-1]
            counts[name] += 1
            sections = [f"{name}.{counts[name]}.", f"{name}."] if line.lstrip().startswith("[[") else [f"{name}."]
            held = [*_with_tables(name), sections[0].rstrip(".")]
        else:
            held = [f"{section}{key}" for section in sections for key in told]
        for key in held:
            if key in spoken and key.count(".") + 1 > best:
                found, best = number, key.count(".") + 1
    return found


def _keys_of_line(line: str) -> list[str]:
    """Every dotted key that a line of TOML gives, the deepest of a heading last; of a value over lines only its own."""
    for whole in (line, f"{line.partition('=')[0]}= 0"):
        with contextlib.suppress(ValueError, RecursionError):
            return list(_keys_of_table(tomllib.loads(whole)))
    return []


def _keys_of_table(table: dict[str, Any]) -> Iterator[str]:
    for name, value in table.items():
        yield name
        for k, inner in enumerate(value if isinstance(value, list) else [value], start=1):
            if isinstance(inner, dict):
                for key in _keys_of_table(inner):
                    yield f"{name}.{key}"
                    if isinstance(value, list):
                        yield f"{name}.{k}.{key}"


def _with_tables(key: str) -> list[str]:
    """A dotted key and the tables that it stands in."""
    parts = key.split(".")[:DEEPEST] if key else []
    return [".".join(parts[: k + 1]) for k in range(len(parts))]


def split_heading(text: str) -> tuple[str, str] | None:
    """(name, unit) of a heading `name [unit]`, or None where it is none."""
    name, bracket, rest = text.strip().partition("[")
    unit = rest[:-1].strip()
    if not bracket or not rest.endswith("]") or not name.strip() or not unit or set(name + unit) & set("[]"):
        return None
    return name.strip(), unit


def read_columns(path: Path, wanted: dict[str, str], *, most_rows: int = MOST_ROWS) -> dict[str, np.ndarray]:
    """Columns of a plain CSV file whose header reads `name [unit], ...`, converted to the wanted units.

    For tables that belong to a scenario or a study; what was measured comes by `valvesim.measurement`. Blank lines are
    skipped. Raises InputError for a missing file, column, unit or value, with the line, and for a file of more than
    `most_rows` lines or `MOST_BYTES`, before it is held.
    """
    check_file(path, MOST_BYTES)
    _check_rows(path, most_rows)
    lines = _lines(path)
    top, names = next(lines, (0, []))
    first = next(lines, None)
    if first is None:
        raise InputError("holds no data (a header line and rows of numbers are expected)", file=path)
    header: dict[str, tuple[int, str]] = {}
    for k, text in enumerate(names):
        heading = split_heading(text)
        if heading is None:
            raise InputError(
                f"column {text.strip()!r} needs a name and a unit, such as 'time [s]'", file=path, line=top
            )
        if heading[0] in header:
            raise InputError(f"column {heading[0]!r} stands there twice", file=path, line=top)
        header[heading[0]] = (k, heading[1])
    for name in wanted:
        if name not in header:
            raise InputError(f"no column {name!r}{nearest(name, header)}", file=path, line=top)
    numbers = {name: array("d") for name in wanted}
    for line, row in chain([first], lines):
        if len(row) > len(names):
            raise InputError(f"{len(row)} cells under {len(names)} columns; is a comma a point?", file=path, line=line)
        for name, column in numbers.items():
            column.append(_number(path, line, row, header[name][0], name))
    columns = {}
    for name, column in numbers.items():
        try:
            converted = convert(np.array(column), header[name][1], wanted[name], f"column {name!r}")
        except InputError as error:
            raise error.at(file=path, line=top) from None
        columns[name] = np.asarray(converted, dtype=float)
    return columns


def _check_rows(path: Path, most: int) -> None:
    """InputError for a file of more lines than `most`, counted without holding them."""
    try:
        with open(path, "rb") as file:
            rows = sum(part.count(b"\n") for part in iter(lambda: file.read(1 << 20), b""))
    except OSError as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None
    if rows > most + 1:
        raise InputError(f"{rows - 1} rows are more than {most}", file=path)


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The rows of a CSV file that are not blank, each with its line number."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            for row in reader:
                if len(row) > 1 or "".join(row).strip():
                    yield reader.line_num, row
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None


def _number(path: Path, line: int, row: list[str], at: int, name: str) -> float:
    if at >= len(row) or not row[at].strip():
        raise InputError(f"gap in column {name!r}", file=path, line=line)
    try:
        number = float(row[at])
    except ValueError:
        raise InputError(f"{row[at]!r} in column {name!r} is not a number", file=path, line=line) from None
    if not np.isfinite(number):
        raise InputError(f"{row[at].strip()} in column {name!r} is not a finite number", file=path, line=line)
    return number


def csv_text(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """A CSV: the header, and a line a row."""
    text = StringIO()
    _write_csv(text, header, rows)
    return text.getvalue()


def columns_rows(columns: Iterable[np.ndarray], digits: int = 9) -> Iterator[tuple[str, ...]]:
    """The rows of columns (n,) of numbers, each as text of so many digits."""
    return (tuple(f"{value:.{digits}g}" for value in row) for row in zip(*columns, strict=True))


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    """Write columns (n,) by their headings `name [unit]`, as `read_columns` reads them. Returns the path."""

    def write(temporary: Path) -> None:
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            _write_csv(file, columns, columns_rows(columns.values()))

    return write_atomically(path, write)


def _write_csv(file: TextIO, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)


def reason(error: Exception) -> str:
    """Why something cannot be read or written, in the system's words without its number of the error."""
    if not isinstance(error, OSError) or not error.strerror:
        return str(error)
    return f"{error.strerror}: {error.filename!r}" if error.filename else error.strerror


def check_folder(folder: Path) -> None:
    """Make a folder for results; InputError where it cannot be made or written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be written ({reason(error)})", file=folder) from None


def write_text(path: Path, text: str) -> None:
    """Fill a file with text, UTF-8."""
    path.write_text(text, encoding="utf-8")


def write_atomically(path: Path, write: Callable[[Path], None]) -> Path:
    """Let `write` fill a temporary file beside `path`, then move it into place. InputError where that cannot be.

    Missing folders are made. Whatever happens, a power cut included, `path` is either as before or complete.
    """
    path = Path(path)
    if "\0" in str(path):
        raise InputError("cannot be written (embedded null byte)", file=path)
    try:
        with (
            made_folder(path.parent),
            temporary_path(path.parent, f".{path.stem[:100]}-", path.suffix) as temporary,
        ):
            temporary.touch()
            write(temporary)
            to_disc(temporary)
            os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"cannot be written ({reason(error)})", file=path) from None
    return path


class UnsafeFile(Exception):
    """A file or folder in which somebody else can put what the user then trusts."""


def check_own(path: Path) -> None:
    """UnsafeFile unless a file or folder belongs to the user and nobody else may write to it."""
    status = os.stat(path)
    if hasattr(os, "getuid") and status.st_uid != os.getuid():
        raise UnsafeFile(f"{path} belongs to another user")
    if os.name == "posix" and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UnsafeFile(f"{path} can be written by other users")


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path leads to a place below a folder, once its links are followed."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):  # a name that is too long, links in a circle
        return False


def to_disc(path: Path) -> None:
    """Have the system write a file to its disc now: a rename may reach it before what the file holds."""
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
