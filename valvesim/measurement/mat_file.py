"""MATLAB files: version 5 by scipy, version 7.3 (HDF5) by h5py.

Read are vectors, the fields of structures (`data.current`), and tables of a structure with `Time` and `Data`
(exported timeseries). A unit stands in the name, in a variable `units` (a structure of texts by name), or in
`[columns]`.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.measurement.headings import heading_of, spelled
from valvesim.measurement.numbers import as_numbers, is_real
from valvesim.measurement.table import MOST_COLUMNS, Choice, Column, Heading, MeasuredTable

_DEEPEST = 4
_LONGEST_TEXT = 1000  # characters of what may be a unit
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_mat(path: Path, choice: Choice) -> tuple[MeasuredTable, ...]:
    """A table for the vectors of each length, and one for each structure that has its own time."""
    with open(path, "rb") as file:
        start = file.read(1024)
    if start[512:520] == _HDF5 or start[:8] == _HDF5:
        import h5py

        with h5py.File(path, "r") as file:
            leaves = list(islice(_in_hdf5(file, "", 0), MOST_COLUMNS + 1))
            if len(leaves) > MOST_COLUMNS:
                raise InputError(f"holds more than {MOST_COLUMNS} variables")
            return _tables(leaves, choice)
    from scipy.io import loadmat

    loaded = loadmat(path, squeeze_me=True, struct_as_record=False, verify_compressed_data_integrity=True)
    return _tables([leaf for name, value in loaded.items() if not name.startswith("__")
                    for leaf in _in_structure(name, value, 0)], choice)  # fmt: skip


def _in_structure(name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """(dotted name, vector or text) of all that a variable of version 5 holds."""
    if hasattr(value, "_fieldnames") and depth < _DEEPEST:
        for inner in value._fieldnames:
            yield from _in_structure(f"{name}.{inner}", getattr(value, inner), depth + 1)
    else:
        yield name, value


def _in_hdf5(group: Any, name: str, depth: int) -> Iterator[tuple[str, Any]]:
    """The same of a file of version 7.3; vectors stay on the disk until they are chosen."""
    import h5py

    for key in group:
        if key.startswith("#"):
            continue
        link = group.get(key, getlink=True)
        value = None if isinstance(link, h5py.ExternalLink) else group[key]
        if value is None or (isinstance(value, h5py.Dataset) and (value.external or value.is_virtual)):
            raise InputError(f"{key!r} stands in another file, which is not read")
        inner = f"{name}.{key}" if name else key
        if isinstance(value, h5py.Group) and depth < _DEEPEST:
            yield from _in_hdf5(value, inner, depth + 1)
        elif isinstance(value, h5py.Dataset):
            if value.attrs.get("MATLAB_class", b"") != b"char":
                yield inner, value
            elif value.size <= _LONGEST_TEXT:
                yield inner, "".join(map(chr, np.ravel(value[()])))


def _tables(leaves: list[tuple[str, Any]], choice: Choice) -> tuple[MeasuredTable, ...]:
    """Vectors by what they stand in and how long they are."""
    units = {name.rpartition(".")[2]: value for name, value in leaves
             if isinstance(value, str) and name.rpartition(".")[0].rpartition(".")[2] in ("units", "unit")}  # fmt: skip
    groups: dict[tuple[str, int], list[tuple[str, Any]]] = {}
    for name, value in leaves:
        if not isinstance(value, str) and hasattr(value, "dtype") and is_real(value) and _is_vector(value):
            groups.setdefault((name.rpartition(".")[0], int(np.prod(value.shape))), []).append((name, value))
    tables = []
    for (owner, _), members in groups.items():
        headings = tuple(_heading(name, units) for name, _ in members)
        wanted = sorted(choice(headings))
        columns = tuple(Column(k, headings[k], as_numbers(members[k][1][()])) for k in wanted)
        tables.append(MeasuredTable(owner or "variables", headings, columns))
    if not tables:
        raise InputError("holds no vector of numbers")
    return tuple(tables)


def _is_vector(value: Any) -> bool:
    return sum(length > 1 for length in value.shape) == 1


def _heading(name: str, units: dict[str, str]) -> Heading:
    owner, _, own = name.rpartition(".")
    if own.casefold() in ("data", "values", "value") and owner:
        own = owner.rpartition(".")[2]
    heading = heading_of(own)
    return Heading(heading.name, spelled(units[own]) if own in units else heading.unit)
