"""Reading the CSV file of a record: columns in SI on an even clock."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

import numpy as np

from valvesim.errors import InputError, nearest, unknown_name
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import UNITS
from valvesim.io import MOST_BYTES, check_file, read_columns, split_heading
from valvesim.units import convert


def read_values(path: Path, *, options: IdentificationOptions) -> dict[str, np.ndarray]:
    """All columns of a record in SI, NaN where one has no reading: in bulk, and by `read_columns` where anything is odd."""
    line, header = _header(path)
    for name in header:
        if name not in UNITS:
            raise unknown_name("column", name, UNITS).at(file=path, line=line)
    for one in (("time",), ("current", "voltage")):
        if not any(name in header for name in one):
            problem = f"no column {' or '.join(map(repr, one))}{nearest(one[0], header)}"
            raise InputError(problem, file=path, line=line)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no data: said below
            table = np.loadtxt(
                path, delimiter=",", comments=None, quotechar='"', skiprows=line, ndmin=2, encoding="utf-8-sig"
            )
    except ValueError:
        table = np.empty((0, 0))
    if table.shape[1] != len(header) or not np.isfinite(table).all():
        values = read_columns(path, {name: UNITS[name] for name in header}, gaps=set(header) - {"time"})
    else:
        try:
            values = {
                name: convert(table[:, k], unit, UNITS[name], f"column {name!r}")
                for k, (name, unit) in enumerate(header.items())
            }
        except InputError as error:
            raise error.at(file=path, line=line) from None
    if len(values["time"]) < options.audit.least_samples:
        problem = f"{len(values['time'])} samples; a record needs {options.audit.least_samples} or more"
        raise InputError(problem, file=path)
    return values


def _header(path: Path) -> tuple[int, dict[str, str]]:
    """The line of the header and its units by name; InputError from `read_columns` where it cannot be read."""
    check_file(path, MOST_BYTES)
    line, cells = 0, []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            line, text = next(((n, text) for n, text in enumerate(file, start=1) if text.strip()), (0, ""))
        cells = [split_heading(cell) for cell in next(csv.reader([text]), [])]
    except (OSError, ValueError, csv.Error):
        pass  # told below
    header = {cell[0]: cell[1] for cell in cells if cell is not None}
    if not cells or len(header) < len(cells):
        read_columns(path, {"time": "s"})
        raise InputError("the header must be one line, such as time [s],current [mA]", file=path, line=line)
    return line, header


def file_line(path: Path, row: int) -> int:
    """The line of a row of data (from 0) in its file."""
    with open(path, encoding="utf-8-sig") as file:
        return [n for n, text in enumerate(file, start=1) if text.strip()][row + 1]


def even_clock(path: Path, time: np.ndarray, *, options: IdentificationOptions) -> np.ndarray:
    """The even clock from 0 that the times keep to; InputError where they fall, leave a gap or drift."""
    steps, clock = np.diff(time), time - time[0]
    usual = float(np.median(steps))
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        raise InputError(
            f"times must rise, but {time[k + 1]:.9g} s follows {time[k]:.9g} s",
            file=path,
            line=file_line(path, k + 1),
        )
    uneven = np.abs(steps - usual) > options.audit.clock_jitter * usual
    if uneven.any():
        k = int(
            np.argmax(np.where(steps > options.audit.gap * usual, np.inf, uneven))
        )  # the first gap before any lesser jitter
        what = "gap" if steps[k] > options.audit.gap * usual else "uneven clock: a step"
        raise InputError(
            f"{what} of {steps[k]:.4g} s at {time[k]:.6g} s, where samples come every {usual:.4g} s "
            f"(to {options.audit.clock_jitter:.0%}; write the time with enough digits)",
            file=path,
            line=file_line(path, k + 1),
        )
    even = np.linspace(0.0, clock[-1], len(clock))
    off = np.abs(clock - even) / usual
    if (k := int(np.argmax(off))) and off[k] > 0.5:
        where = f"{time[k]:.6g} s is {off[k]:.3g} steps off an even one"
        raise InputError(f"the clock drifts: {where}", file=path, line=file_line(path, k))
    return even
