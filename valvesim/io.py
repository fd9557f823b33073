"""Reading TOML and CSV columns with units within bounds, and writing files so that nothing is ever half-written."""

from __future__ import annotations

import csv
import os
import re
import stat
import tempfile
import tomllib
from array import array
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, nearest
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
        raise InputError(f"{path}: no such file{'; ' if expected else ''}{expected}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise InputError(f"{path}: cannot be read (it is {kind}, not a file{'; ' if expected else ''}{expected})")
    if status.st_size > most:
        raise InputError(f"{path}: {status.st_size / 1e6:.4g} MB are more than the {most / 1e6:g} MB that are read")


def read_toml(path: Path, expected: str = "") -> tuple[str, dict[str, Any]]:
    """(text, table) of a TOML file; InputError where it cannot be read, and what was `expected` where there is none.

    What a file may hold is bounded (`MOST_TEXT`, `DEEPEST`, whole numbers of 64 bits): a bad one is refused at once.
    """
    check_file(path, MOST_TEXT, expected)
    try:
        text = path.read_text(encoding="utf-8-sig")
        if (long := _LONG_KEY.search(text)) is not None:
            line = text.count("\n", 0, long.start()) + 1
            raise InputError(f"{path}, line {line}: a key of more than {DEEPEST} parts")
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: lists or tables nested more than {DEEPEST} deep") from None
    except InputError:
        raise
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    except ValueError:
        raise InputError(f"{path}: not valid TOML: a whole number of thousands of digits") from None
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
                raise InputError(f"{path}: {key}: a whole number of {value.bit_length()} bits; 64 are read")
        if not deeper:
            return
        level = deeper
    raise InputError(f"{path}: {level[0][0].partition('.')[0]}: nested more than {DEEPEST} deep")


def check_printable(text: Any, where: str) -> None:
    """InputError unless `text` is text without control characters, which would reach a terminal or a document."""
    if not isinstance(text, str):
        raise InputError(f"{where}: expected text, got {text!r}")
    if len(text) > 200:
        raise InputError(f"{where}: {len(text)} characters are more than 200")
    for character in text:
        if not character.isprintable():
            raise InputError(f"{where}: holds the control character {character!r}; {text!r}")


def keys_of(message: str) -> set[str]:
    """Every dotted key that a message may speak of, and the tables that hold it; not what it suggests instead."""
    words = re.findall(r"[\w.-]++", re.split(r"; (?:did you mean|valid names)", message, maxsplit=1)[0])
    keys = set()
    for parts in (word.strip(".").split(".") for word in words):
        keys |= {".".join(parts[: k + 1]) for k in range(min(len(parts), DEEPEST))}
    return keys


def line_of_key(text: str, spoken: set[str]) -> int | None:
    """The first line of a TOML text that holds the longest of the keys `spoken` of; None without one."""
    section, found, best = "", None, 0
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*+\[++([^\]]+)\]", line):
            section = header[1].strip()
            keys = _with_tables(section)
        elif match := re.match(r"\s*+([\w.-]+)\s*+=", line):
            dotted = f"{section}.{match[1]}" if section else match[1]
            inner = re.findall(r"(?<![\w-])([\w-]++)\s*+=", line.partition("=")[2])
            keys = [*_with_tables(dotted), *(f"{dotted}.{name}" for name in inner)]
        else:
            continue
        for key in keys:
            if len(key) > best and key in spoken:
                found, best = number, len(key)
    return found


def _with_tables(key: str) -> list[str]:
    """A dotted key and the tables that it stands in."""
    parts = key.split(".")[:DEEPEST]
    return [".".join(parts[: k + 1]) for k in range(len(parts))]


def split_heading(text: str) -> tuple[str, str] | None:
    """(name, unit) of a heading `name [unit]`, or None where it is none."""
    name, bracket, rest = text.strip().partition("[")
    unit = rest[:-1].strip()
    if not bracket or not rest.endswith("]") or not name.strip() or not unit or set(name + unit) & set("[]"):
        return None
    return name.strip(), unit


def read_columns(path: Path, wanted: dict[str, str], *, most_rows: int = MOST_ROWS) -> dict[str, np.ndarray]:
    """Columns of a CSV file whose header reads `name [unit], ...`, converted to the wanted units.

    Blank lines are skipped. Raises InputError for a missing file, column, unit or value, with the line, and for a file
    of more than `most_rows` lines or `MOST_BYTES`, before it is held.
    """
    check_file(path, MOST_BYTES)
    _check_rows(path, most_rows)
    lines = _lines(path)
    top, names = next(lines, (0, []))
    first = next(lines, None)
    if first is None:
        raise InputError(f"{path}: holds no data (a header line and rows of numbers are expected)")
    header: dict[str, tuple[int, str]] = {}
    for k, text in enumerate(names):
        heading = split_heading(text)
        if heading is None:
            raise InputError(f"{path}, line {top}: column {text.strip()!r} needs a name and a unit, such as 'time [s]'")
        if heading[0] in header:
            raise InputError(f"{path}, line {top}: column {heading[0]!r} stands there twice")
        header[heading[0]] = (k, heading[1])
    for name in wanted:
        if name not in header:
            raise InputError(f"{path}, line {top}: no column {name!r}{nearest(name, header)}")
    numbers = {name: array("d") for name in wanted}
    for line, row in chain([first], lines):
        if len(row) > len(names):
            raise InputError(f"{path}, line {line}: {len(row)} cells under {len(names)} columns; is a comma a point?")
        for name, column in numbers.items():
            column.append(_number(path, line, row, header[name][0], name))
    columns = {}
    for name, column in numbers.items():
        converted = convert(np.array(column), header[name][1], wanted[name], f"{path}, column {name!r}")
        columns[name] = np.asarray(converted, dtype=float)
    return columns


def _check_rows(path: Path, most: int) -> None:
    """InputError for a file of more lines than `most`, counted without holding them."""
    try:
        with open(path, "rb") as file:
            rows = sum(part.count(b"\n") for part in iter(lambda: file.read(1 << 20), b""))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if rows > most + 1:
        raise InputError(f"{path}: {rows - 1} rows are more than {most}")


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The rows of a CSV file that are not blank, each with its line number."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            for row in reader:
                if len(row) > 1 or "".join(row).strip():
                    yield reader.line_num, row
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def _number(path: Path, line: int, row: list[str], at: int, name: str) -> float:
    if at >= len(row) or not row[at].strip():
        raise InputError(f"{path}, line {line}: gap in column {name!r}")
    try:
        number = float(row[at])
    except ValueError:
        raise InputError(f"{path}, line {line}: {row[at]!r} in column {name!r} is not a number") from None
    if not np.isfinite(number):
        raise InputError(f"{path}, line {line}: {row[at].strip()} in column {name!r} is not a finite number")
    return number


def check_folder(folder: Path) -> None:
    """Make a folder for results; InputError where it cannot be made or written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be written ({error})") from None


def write_atomically(path: Path, write: Callable[[Path], None]) -> Path:
    """Let `write` fill a temporary file beside `path`, then move it into place. InputError where that cannot be.

    Missing folders are made. Whatever happens, `path` is either as before or complete.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({error})") from None
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None
    finally:
        temporary.unlink(missing_ok=True)
    return path
