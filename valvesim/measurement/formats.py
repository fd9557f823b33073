"""The formats of measurement files by extension, each with its reader and the extra that its library comes with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from valvesim.errors import InputError
from valvesim.io import check_file, reason
from valvesim.measurement.csv_file import read_csv
from valvesim.measurement.dialect import NO_DIALECT, Dialect
from valvesim.measurement.mat_file import read_mat
from valvesim.measurement.mdf_file import read_mdf
from valvesim.measurement.netcdf_file import read_netcdf
from valvesim.measurement.parquet_file import read_parquet
from valvesim.measurement.reader_process import read_apart
from valvesim.measurement.table import MOST_MEASURED_BYTES, Choice, MeasuredTable
from valvesim.measurement.tdms_file import read_tdms
from valvesim.measurement.xlsx_file import read_xlsx


@dataclass(frozen=True)
class Format:
    """A format: its reader, the libraries that it needs, and the extra of this package that brings them.

    `marks` are the bytes one of which its files begin with (or, of HDF5, have after a block of the user's own).
    """

    name: str
    read: Callable[[Path, Choice], tuple[MeasuredTable, ...]]
    libraries: tuple[str, ...]
    extra: str = ""
    marks: tuple[bytes, ...] = (b"",)


_MAT = Format("MATLAB", read_mat, ("h5py", "scipy.io"), "mat")  # version 4 has no mark
_MDF = Format("MDF", read_mdf, ("asammdf",), "mdf", (b"MDF", b"UnFinMF"))
FORMATS = {
    ".nc": Format("netCDF", read_netcdf, ("netCDF4",), "", (b"CDF", b"\x89HDF\r\n\x1a\n", b"\x0e\x03\x13\x01")),
    ".mat": _MAT,
    ".tdms": Format("TDMS", read_tdms, ("nptdms",), "tdms", (b"TDSm",)),
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".parquet": Format("Parquet", read_parquet, ("pyarrow",), "parquet", (b"PAR1",)),
    ".xlsx": Format("xlsx", read_xlsx, ("openpyxl",), "xlsx", (b"PK",)),
}
"""Formats that are no text, by extension."""
TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm")
"""Extensions of text files of columns."""
LISTED = (".csv", ".tsv", *FORMATS)
"""Extensions that are taken for measurements where none is named."""


def read_measured_tables(path: Path, choice: Choice, stated: Dialect = NO_DIALECT) -> tuple[MeasuredTable, ...]:
    """The tables of a measurement file of any format, with the columns that `choice` picks of each.

    Raises InputError for a file that is missing, broken, of no known format, or whose format's extra is not installed.
    """
    path = Path(path)
    suffix = path.suffix.casefold()
    check_file(path, MOST_MEASURED_BYTES)
    if suffix in TEXT or suffix not in FORMATS:
        return read_csv(path, choice, stated)
    form = FORMATS[suffix]
    try:
        with open(path, "rb") as file:
            start = file.read(5000)
    except OSError as error:
        raise InputError(f"cannot be read ({reason(error)})", file=path) from None
    if not any(start.startswith(mark, at) for mark in form.marks for at in (0, 512, 1024, 2048, 4096)):
        raise InputError(f"is no {form.name} file: it does not begin as one does", file=path)
    return read_apart(path, form.name, choice)
