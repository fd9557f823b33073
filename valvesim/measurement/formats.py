"""The formats of measurement files by extension, each with its reader and the extra that its library comes with."""

from __future__ import annotations

import gc
import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from valvesim.errors import InputError
from valvesim.io import check_file
from valvesim.measurement.csv_file import read_csv
from valvesim.measurement.dialect import NO_DIALECT, Dialect
from valvesim.measurement.mat_file import read_mat
from valvesim.measurement.mdf_file import read_mdf
from valvesim.measurement.netcdf_file import read_netcdf
from valvesim.measurement.parquet_file import read_parquet
from valvesim.measurement.table import MOST_BYTES, MOST_SAMPLES, Choice, MeasuredTable
from valvesim.measurement.tdms_file import read_tdms
from valvesim.measurement.xlsx_file import read_xlsx


@dataclass(frozen=True)
class Format:
    """A format: its reader, the libraries that it needs, and the extra of this package that brings them."""

    name: str
    read: Callable[[Path, Choice], tuple[MeasuredTable, ...]]
    libraries: tuple[str, ...]
    extra: str = ""


_MAT = Format("MATLAB", read_mat, ("h5py",), "mat")
_MDF = Format("MDF", read_mdf, ("asammdf",), "mdf")
FORMATS = {
    ".nc": Format("netCDF", read_netcdf, ()),
    ".mat": _MAT,
    ".tdms": Format("TDMS", read_tdms, ("nptdms",), "tdms"),
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".parquet": Format("Parquet", read_parquet, ("pyarrow",), "parquet"),
    ".xlsx": Format("xlsx", read_xlsx, ("openpyxl",), "xlsx"),
}
"""Formats that are no text, by extension."""
TEXT = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm")
"""Extensions of text files of columns."""
LISTED = (".csv", ".tsv", *FORMATS)
"""Extensions that are taken for measurements where none is named."""


def read_tables(path: Path, choice: Choice, stated: Dialect = NO_DIALECT) -> tuple[MeasuredTable, ...]:
    """The tables of a measurement file of any format, with the columns that `choice` picks of each.

    Raises InputError for a file that is missing, broken, of no known format, or whose format's extra is not installed.
    """
    path = Path(path)
    suffix = path.suffix.casefold()
    check_file(path, MOST_BYTES)
    if suffix in TEXT or suffix not in FORMATS:
        return read_csv(path, choice, stated)
    form = FORMATS[suffix]
    for library in form.libraries:
        _check_installed(path, form, library)
    tables, problem = _read(path, form, choice)
    if problem is not None:
        raise problem
    for table in tables:
        for column in table.columns:
            if len(column.values) > MOST_SAMPLES:
                raise InputError(f"{len(column.values)} samples are more than {MOST_SAMPLES}", file=path)
    return tables


def _read(path: Path, form: Format, choice: Choice) -> tuple[tuple[MeasuredTable, ...], InputError | None]:
    """The tables of a file, or why it has none; what the libraries say of a broken one otherwise is kept quiet."""
    with _quiet((*form.libraries, "scipy", "netCDF4")):
        try:
            return form.read(path, choice), None
        except InputError as error:
            return (), error if error.file else error.at(file=path)
        except MemoryError:  # what is broken may claim any size
            told = "it asks for more memory than there is"
        except Exception as error:  # libraries raise errors of many kinds on a broken file
            told = " ".join(str(error).split())[:200] or type(error).__name__
        gc.collect()  # what is half made complains as it goes: now
        return (), InputError(f"is no {form.name} file that can be read ({told})", file=path)


@contextmanager
def _quiet(libraries: tuple[str, ...]) -> Iterator[None]:
    """Libraries that log nothing, warn of nothing, and whose half-made objects go without a word."""
    loggers = [logging.getLogger(name) for name in list(logging.root.manager.loggerDict)
               if name.partition(".")[0] in libraries]  # fmt: skip
    before, hook = [logger.disabled for logger in loggers], sys.unraisablehook
    for logger in loggers:
        logger.disabled = True
    sys.unraisablehook = lambda *given: None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        sys.unraisablehook = hook
        for logger, disabled in zip(loggers, before, strict=True):
            logger.disabled = disabled


def _check_installed(path: Path, form: Format, library: str) -> Any:
    try:
        return import_module(library)
    except ImportError:
        advice = f"{form.name} files need {library}: pip install 'valvesim[{form.extra}]'"
        raise InputError(advice, file=path) from None
