"""Reading CSV columns with units, and writing files so that nothing is ever half-written."""

from __future__ import annotations

import csv
import os
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .errors import InputError, nearest
from .units import convert

_HEADER = re.compile(r"\s*([^\[\]]*[^\[\]\s])\s*\[\s*([^\[\]]*[^\[\]\s])\s*\]\s*")


def read_columns(path: Path, wanted: dict[str, str]) -> dict[str, np.ndarray]:
    """Columns of a CSV file whose header reads `name [unit], ...`, converted to the wanted units.

    Blank lines are skipped. Raises InputError for a missing file, column, unit or value, with the line.
    """
    (top, names), *lines = _lines(path)
    header: dict[str, tuple[int, str]] = {}
    for k, text in enumerate(names):
        match = _HEADER.fullmatch(text)
        if match is None:
            raise InputError(f"{path}, line {top}: column {text.strip()!r} needs a name and a unit, such as 'time [s]'")
        if match[1] in header:
            raise InputError(f"{path}, line {top}: column {match[1]!r} stands there twice")
        header[match[1]] = (k, match[2])
    for line, row in lines:
        if len(row) > len(names):
            raise InputError(f"{path}, line {line}: {len(row)} cells under {len(names)} columns; is a comma a point?")
    columns = {}
    for name, unit in wanted.items():
        if name not in header:
            raise InputError(f"{path}, line {top}: no column {name!r}{nearest(name, header)}")
        at, source = header[name]
        numbers = [_number(path, line, row, at, name) for line, row in lines]
        columns[name] = np.asarray(convert(np.array(numbers), source, unit, f"{path}, column {name!r}"), dtype=float)
    return columns


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """The rows of a CSV file that are not blank, each with its line number."""
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            lines = [(reader.line_num, row) for row in reader if len(row) > 1 or "".join(row).strip()]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if len(lines) < 2:
        raise InputError(f"{path}: holds no data (a header line and rows of numbers are expected)")
    return lines


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
