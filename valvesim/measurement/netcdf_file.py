"""netCDF files: variables over one dimension each, with `units` as the CF conventions have them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.measurement.headings import heading_of, spelled
from valvesim.measurement.numbers import as_numbers
from valvesim.measurement.table import Choice, Column, Heading, MeasuredTable


def read_netcdf(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """A table for each dimension that variables run over."""
    from netCDF4 import Dataset

    tables = []
    with _opening_at_most(1):
        file = Dataset(path)
    with file:
        along: dict[str, list[Any]] = {name: [] for name in file.dimensions}
        for variable in file.variables.values():
            if len(variable.dimensions) == 1:
                along[variable.dimensions[0]].append(variable)
        for name, variables in along.items():
            headings = tuple(_heading(variable) for variable in variables)
            wanted = sorted(choice(headings))
            columns, start = [], None
            for k in wanted:
                values, own = _values(variables[k])
                columns.append(Column(k, headings[k] if own is None else Heading(headings[k].name, "s"), values))
                start = own if own is not None else start
            tables.append(MeasuredTable(name, headings, tuple(columns), start=start))
    return tuple(tables)


@contextmanager
def _opening_at_most(files: int) -> Iterator[None]:
    """Inside, no more files can be opened at a time: HDF5 would follow names in a file to others that nobody gave."""
    try:
        import resource
    except ImportError:  # Windows
        yield
        return
    free = os.open(os.devnull, os.O_RDONLY)
    os.close(free)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free + files, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def _heading(variable: Any) -> Heading:
    unit = str(getattr(variable, "units", ""))
    heading = heading_of(variable.name)
    return Heading(heading.name, "s" if " since " in unit else spelled(unit) or heading.unit)


def _values(variable: Any) -> tuple[np.ndarray, float | None]:
    """The values of a variable, and when its first was where its unit counts from a date."""
    from netCDF4 import num2date

    with _opening_at_most(0):
        raw = variable[:]
    values = as_numbers(np.ma.filled(raw.astype(float), np.nan))
    unit = str(getattr(variable, "units", ""))
    if " since " not in unit or not len(values):
        return values, None
    seconds = {"days": 86_400.0, "hours": 3_600.0, "minutes": 60.0, "seconds": 1.0, "milliseconds": 1e-3,
               "microseconds": 1e-6, "nanoseconds": 1e-9}.get(unit.split()[0].rstrip("s") + "s", 1.0)  # fmt: skip
    first: Any = num2date(values[0], unit, only_use_cftime_datetimes=False, only_use_python_datetimes=True)
    return (values - values[0]) * seconds, float(first.timestamp())
