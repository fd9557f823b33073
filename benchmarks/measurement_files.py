"""Measurement files as their home libraries write them: read to the last digit; mutated: never a silent wrong number.

    python benchmarks/measurement_files.py [MUTATIONS] [--rows 10000000]

Each of the files is written by the library or program that is its format's home. What was written is compared with
what is read, by `==`, after the same rounding that the file itself has (openpyxl writes sixteen digits; formats of so
many digits are compared with the number that stands in the file). A mutation changes, removes, adds or swaps bytes, or
cuts the file off. A mutated text file may be refused, or read: then each number must stand in a cell of the file, as
an independent reader finds them that is told the dialect. A mutated binary file may be refused or read: a flipped bit
of a number can be seen only where the format has checksums (xlsx, compressed MAT and Parquet).
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pandas

from valvesim.errors import InputError
from valvesim.measurement.columns_table import statements_of
from valvesim.measurement.recording import read_recording

COUNT = 400
RNG = np.random.default_rng(7)
TIME = np.arange(COUNT) / 1e3
CURRENT = 5e-3 * np.sin(2 * np.pi * 10.0 * TIME) + 1e-6 * RNG.normal(size=COUNT)
SPOOL = 2e-4 * np.sin(2 * np.pi * 10.0 * TIME - 0.1) + 1e-7 * RNG.normal(size=COUNT)
OIL = 35.0 + 0.5 * TIME
CHANNELS = ("current", "spool_position", "oil_temperature")
SI = {"current": CURRENT, "spool_position": SPOOL, "oil_temperature": OIL}
FRAME = pandas.DataFrame({"time [s]": TIME, "current [A]": CURRENT, "spool_position [m]": SPOOL,
                          "oil_temperature [degC]": OIL})  # fmt: skip


def renamed(*names: str) -> pandas.DataFrame:
    return FRAME.set_axis(list(names), axis=1)


# ---------------------------------------------------------------- text


def pandas_csv(frame=FRAME, **options):
    return lambda path: frame.to_csv(path, index=False, **options)


def with_preamble(text: str, encoding: str, frame=FRAME, **options):
    def write(path):
        body = frame.to_csv(index=False, **options)
        path.write_bytes((text + body).encode(encoding))

    return write


def numpy_savetxt(path):
    np.savetxt(path, FRAME.to_numpy(), fmt="%.18e", header=" ".join(FRAME.columns))


def numpy_savetxt_commas(path):
    np.savetxt(path, FRAME.to_numpy(), fmt="%.17g", delimiter=",", comments="",
               header="time [s],current [A],spool_position [m],oil_temperature [degC]")  # fmt: skip


def labview_lvm(path):
    head = "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\n***End_of_Header***\t\n\n"
    head += "Channels\t3\t\nSamples\t400\t\n"
    head += "***End_of_Header***\t\t\t\n"
    frame = renamed("X_Value [s]", "current [A]", "spool_position [m]", "oil_temperature [degC]")
    path.write_text(head + frame.to_csv(index=False, sep="\t"), encoding="utf-8")


def units_row(separator: str, decimal: str, encoding: str, brackets: bool):
    def write(path):
        units = ["s", "A", "m", "°C"]
        units = [f"[{unit}]" for unit in units] if brackets else units
        body = FRAME.to_csv(index=False, sep=separator, decimal=decimal, header=False)
        names = separator.join(["Time", "Current", "Spool position", "Oil temperature"])
        path.write_bytes("\r\n".join([names, separator.join(units), *body.splitlines(), ""]).encode(encoding))

    return write


def clock(form: str):
    def write(path):
        stamps = pandas.Timestamp("2026-11-24 09:59:59.8") + pandas.to_timedelta(TIME, unit="s")
        frame = renamed("Time", *FRAME.columns[1:])
        frame["Time"] = stamps.strftime(form)
        frame.to_csv(path, index=False, sep=";")

    return write


def spreadsheet(filter_code: str):
    """A CSV that LibreOffice itself writes of a workbook."""

    def write(path):
        with tempfile.TemporaryDirectory() as folder:
            book = Path(folder) / "a.xlsx"
            FRAME.to_excel(book, index=False)
            subprocess.run(
                ["soffice", "--headless", "--convert-to", f"csv:Text - txt - csv (StarCalc):{filter_code}", "--outdir",
                 folder, str(book)], check=True, capture_output=True, timeout=300,
            )  # fmt: skip
            shutil.copy(Path(folder) / "a.csv", path)

    return write


GAPPED = FRAME.copy()
GAPPED.loc[np.arange(COUNT) % 50 == 7, FRAME.columns[1:]] = np.nan
GERMAN = renamed("Zeit (ms)", "Strom (mA)", "Schieberweg (mm)", "Öltemperatur (°C)") * [1e3, 1e3, 1e3, 1.0]
TEXT = {
    "pandas.csv": (pandas_csv(), ",", "."),
    "pandas_semicolon_comma.csv": (pandas_csv(sep=";", decimal=","), ";", ","),
    "pandas_tab_comma.tsv": (pandas_csv(sep="\t", decimal=","), "\t", ","),
    "pandas_bar.csv": (pandas_csv(sep="|"), "|", "."),
    "pandas_bom.csv": (pandas_csv(encoding="utf-8-sig"), ",", "."),
    "pandas_utf16.csv": (pandas_csv(encoding="utf-16", sep="\t"), "\t", "."),
    "pandas_utf16_le.csv": (pandas_csv(encoding="utf-16-le", sep=";", decimal=","), ";", ","),
    "pandas_cp1252.csv": (pandas_csv(GERMAN, encoding="cp1252", sep=";", decimal=","), ";", ","),
    "pandas_quoted.csv": (pandas_csv(quoting=1), ",", "."),
    "pandas_quoted_comma.csv": (pandas_csv(quoting=1, decimal=","), ",", ","),
    "pandas_returns.csv": (pandas_csv(lineterminator="\r\n"), ",", "."),
    "pandas_old_returns.csv": (pandas_csv(lineterminator="\r"), ",", "."),
    "pandas_six_digits.csv": (pandas_csv(float_format="%.6g"), ",", "."),
    "pandas_exponent_comma.txt": (pandas_csv(float_format="%.10E", sep=";", decimal=","), ";", ","),
    "pandas_missing.csv": (pandas_csv(GAPPED, na_rep="NaN"), ",", "."),
    "preamble.csv": (with_preamble("Rig 7\nOperator: Müller\n\n", "utf-8"), ",", "."),
    "preamble_cells.csv": (
        with_preamble("Rig;7;;\nDatum;24.11.2026;;\n;;;\n", "cp1252", GERMAN, sep=";", decimal=","), ";", ","
    ),
    "units_row.csv": (units_row(";", ",", "cp1252", False), ";", ","),
    "units_row_brackets.txt": (units_row("\t", ".", "utf-8", True), "\t", "."),
    "clock.csv": (clock("%H:%M:%S.%f"), ";", "."),
    "dates.csv": (clock("%Y-%m-%d %H:%M:%S.%f"), ";", "."),
    "german_dates.csv": (clock("%d.%m.%Y %H:%M:%S.%f"), ";", "."),
    "numpy_savetxt.dat": (numpy_savetxt, " ", "."),
    "numpy_savetxt.csv": (numpy_savetxt_commas, ",", "."),
    "labview.lvm": (labview_lvm, "\t", "."),
}  # fmt: skip
if shutil.which("soffice"):
    TEXT["libreoffice.csv"] = (spreadsheet("44,34,76,1,,1033,false,true,false"), ",", ".")
    TEXT["libreoffice_semicolon.csv"] = (spreadsheet("59,34,ANSI,1,,1031,false,true,false"), ";", ".")


# ---------------------------------------------------------------- other formats


def xarray_netcdf(path):
    import xarray

    data = {n: ("time", v, {"units": {"current": "A", "spool_position": "m"}.get(n, "degC")}) for n, v in SI.items()}
    xarray.Dataset(data, coords={"time": ("time", TIME, {"units": "s"})}).to_netcdf(path)


def netcdf_classic(path):
    import xarray

    data = {n: ("time", v, {"units": {"current": "A", "spool_position": "m"}.get(n, "degC")}) for n, v in SI.items()}
    xarray.Dataset(data, coords={"time": ("time", TIME, {"units": "s"})}).to_netcdf(path, format="NETCDF3_64BIT")


def scipy_mat(compressed: bool, nested: bool):
    def write(path):
        from scipy.io import savemat

        columns = {"t_s": TIME, "current_A": CURRENT, "spool_position_m": SPOOL, "oil_temperature_degC": OIL}
        savemat(path, {"bench": columns} if nested else columns, do_compression=compressed)

    return write


def scipy_mat_units(path):
    from scipy.io import savemat

    savemat(path, {"time": TIME, **SI, "units": {"time": "s", "current": "A", "spool_position": "m",
                                                 "oil_temperature": "degC"}})  # fmt: skip


def h5py_mat(path):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        columns = {"t_s": TIME, "current_A": CURRENT, "spool_position_m": SPOOL, "oil_temperature_degC": OIL}
        for name, value in columns.items():
            file.create_dataset(name, data=value[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def nptdms_waveform(path):
    import nptdms

    units = {"current": "A", "spool_position": "m", "oil_temperature": "degC"}
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("rig", n, v, {"wf_increment": 1e-3, "unit_string": units[n]})
                            for n, v in SI.items()])  # fmt: skip


def nptdms_times(path):
    import nptdms

    with nptdms.TdmsWriter(path) as file:
        for part in (slice(0, 150), slice(150, COUNT)):
            file.write_segment([nptdms.ChannelObject("rig", name, column[part])
                                for name, column in (("t_s", TIME), ("current_A", CURRENT), ("spool_position_m", SPOOL),
                                                     ("oil_temperature_degC", OIL))])  # fmt: skip


def asammdf_file(version: str, suffix: str, rates: bool):
    def write(path):
        import asammdf

        with asammdf.MDF(version=version) as file:
            fast = [asammdf.Signal(CURRENT, TIME, unit="A", name="current"),
                    asammdf.Signal(SPOOL, TIME, unit="m", name="spool_position")]  # fmt: skip
            file.append(fast)
            every = 10 if rates else 1
            file.append([asammdf.Signal(OIL[::every], TIME[::every], unit="°C", name="oil_temperature")])
            file.save(path, overwrite=True)

    return write


def pyarrow_parquet(compression: str):
    return lambda path: FRAME.to_parquet(path, compression=compression)


def pyarrow_metadata(path):
    import pyarrow
    import pyarrow.parquet

    units = {"time": "s", "current": "A", "spool_position": "m", "oil_temperature": "degC"}
    schema = pyarrow.schema([pyarrow.field(n, pyarrow.float64(), metadata={"units": u}) for n, u in units.items()])
    pyarrow.parquet.write_table(pyarrow.table([TIME, CURRENT, SPOOL, OIL], schema=schema), path)


def openpyxl_sheet(preamble: bool):
    def write(path):
        import openpyxl

        book = openpyxl.Workbook()
        sheet = book.active
        for row in (["Rig 7"], []) if preamble else ():
            sheet.append(row)
        sheet.append(list(FRAME.columns))
        for row in FRAME.itertuples(index=False):
            sheet.append([float(value) for value in row])
        book.save(path)

    return write


BINARY = {
    "xarray.nc": xarray_netcdf, "classic.nc": netcdf_classic, "v5.mat": scipy_mat(False, False),
    "v5_compressed.mat": scipy_mat(True, False), "v5_structure.mat": scipy_mat(True, True),
    "v5_units.mat": scipy_mat_units, "v73.mat": h5py_mat, "waveform.tdms": nptdms_waveform, "times.tdms": nptdms_times,
    "v410.mf4": asammdf_file("4.10", ".mf4", False), "two_rates.mf4": asammdf_file("4.10", ".mf4", True),
    "v330.mdf": asammdf_file("3.30", ".mdf", False), "snappy.parquet": pyarrow_parquet("snappy"),
    "zstd.parquet": pyarrow_parquet("zstd"), "metadata.parquet": pyarrow_metadata,
    "sheet.xlsx": openpyxl_sheet(False), "sheet_preamble.xlsx": openpyxl_sheet(True),
}  # fmt: skip
STATED = {"labview.lvm": statements_of({"time": {"column": "X_Value"}}, {})}


# ---------------------------------------------------------------- reading them


def expected(name: str, path: Path) -> dict[str, np.ndarray]:
    """What stands in a file: of few digits the rounded numbers, of cells that miss NaN."""
    if name == "pandas_six_digits.csv":
        return {n: np.array([float(f"{v:.6g}") for v in values]) for n, values in SI.items()}
    if name == "pandas_exponent_comma.txt":
        return {n: np.array([float(f"{v:.10E}") for v in values]) for n, values in SI.items()}
    if name == "pandas_missing.csv":
        lost = np.arange(COUNT) % 50 == 7
        return {n: np.where(lost, np.nan, values) for n, values in SI.items()}
    if name == "two_rates.mf4":
        return {**SI, "oil_temperature": np.where(np.arange(COUNT) % 10 == 0, OIL, np.nan)}
    if name.startswith("libreoffice"):  # its own view of the numbers: fifteen decimal places
        _, separator, decimal = TEXT[name]
        frame = pandas.read_csv(path, sep=separator, decimal=decimal)
        return {n: frame.iloc[:, k].to_numpy(dtype=float) for k, n in enumerate(SI, start=1)}
    return SI


def tolerance(name: str) -> float:
    """Relative difference that is the writer's own: one rounding of scaled units, sixteen digits of sheets."""
    if "cp1252" in name or name == "preamble_cells.csv":
        return 5e-16
    return 1e-15 if name.endswith("xlsx") else 0.0


def check(name: str, path: Path) -> str:
    """"" where a file was read to the last digit, else what was wrong."""
    try:
        found = read_recording([path], CHANNELS, stated=STATED.get(name, statements_of({}, {})))
    except InputError as error:
        return str(error)
    wanted = expected(name, path)
    lost = np.isnan(wanted["current"]) if name == "pandas_missing.csv" else np.zeros(COUNT, dtype=bool)
    for channel, values in wanted.items():
        read = found.values.get(channel)
        if read is None:
            return f"{channel} was not found"
        if len(read) != COUNT:
            return f"{len(read)} samples"
        same = np.isclose(read, values, rtol=tolerance(name), atol=0.0, equal_nan=True)
        if not same[~lost].all():
            return f"{channel} differs by {np.nanmax(np.abs(read - values)[~lost]):.3g}"
    if np.max(np.abs(found.time - (found.time[0] + TIME))) > 2e-9:
        return f"times differ by {np.max(np.abs(found.time - TIME)):.3g} s"
    return ""


# ---------------------------------------------------------------- mutations


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to four changes: bytes flipped, removed, doubled or swapped, a line moved, an end cut off."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        if len(data) < 4:
            break
        k, n = int(rng.integers(len(data))), int(rng.integers(1, 12))
        kind = rng.integers(7)
        if kind == 0:
            data[k] = int(rng.integers(256))
        elif kind == 1:
            data[k] = int(rng.choice(list(b"0123456789.,;\t -eEn\"\r\n")))
        elif kind == 2:
            del data[k : k + n]
        elif kind == 3:
            data[k:k] = data[k : k + n]
        elif kind == 4:
            data[k:k] = bytes(rng.choice(list(b"0123456789.,;\t -\n"), n).astype(np.uint8))
        elif kind == 5:
            j = int(rng.integers(len(data)))
            data[k], data[j] = data[j], data[k]
        else:
            del data[k:]
    return bytes(data)


def text_cells(data: bytes, separator: str, decimal: str, encoding: str) -> Counter | None:
    """Every number that stands in a cell of a text, by an independent reading in the known dialect."""
    import csv
    import re

    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    number = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?")
    cells: Counter = Counter()
    for line in re.split(r"\r\n|\n|\r", text.lstrip("\ufeff")):
        row = line.split() if separator == " " else next(csv.reader([line], delimiter=separator), [])
        for cell in row:
            if number.fullmatch(cell.strip()):
                if "," in cell and decimal != "," or "." in cell and decimal == ",":
                    continue
                cells[float(cell.strip().replace(",", "."))] += 1
    return cells


def wrong_numbers(name: str, path: Path, found, separator: str, decimal: str) -> str:
    """A number that was read and stands in no cell of the text, "" where there is none."""
    encoding = "utf-16" if "utf16" in name else "cp1252" if "cp1252" in name or "cells" in name else "utf-8"
    encoding = "utf-16-le" if "utf16_le" in name else encoding
    cells = text_cells(path.read_bytes(), separator, decimal, encoding)
    keys = np.array(sorted(cells))
    scaled = 1e-3 if "cp1252" in name or name == "preamble_cells.csv" else 1.0
    if any("straight lines" in note for note in found.notes):
        return ""  # readings were laid on an even clock, and that is told
    for channel, values in found.values.items():
        by = 1.0 if channel == "oil_temperature" else scaled
        for value in values[np.isfinite(values)]:
            k = np.searchsorted(keys, value / by)
            near = keys[max(k - 1, 0) : k + 2]
            if not np.isclose(near, value / by, rtol=1e-12, atol=0.0).any():
                return f"{channel}: {value!r} stands nowhere in the file"
    return ""


class Hang(Exception):
    """A file took longer than ten seconds."""


def attempt(name: str, path: Path) -> tuple[str, str]:
    """("refused" | "read" | "WRONG" | "TRACEBACK" | "HANG", what)."""

    def stop(number, frame):
        raise Hang

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(20)
    try:
        found = read_recording([path], CHANNELS, stated=STATED.get(name, statements_of({}, {})))
    except InputError as error:
        return ("refused", str(error)) if "\n" not in str(error) else ("TRACEBACK", str(error))
    except Hang:
        return "HANG", ""
    except Exception as error:  # noqa: BLE001 - what must not happen
        return "TRACEBACK", f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
    if name in TEXT:
        problem = wrong_numbers(name, path, found, *TEXT[name][1:])
        return ("WRONG", problem) if problem else ("read", "")
    return "read", ""


def main() -> None:
    warnings.simplefilter("ignore")
    mutations = int(sys.argv[1]) if len(sys.argv) > 1 and sys.argv[1].isdigit() else 2000
    folder = Path(tempfile.mkdtemp())
    writers = {**{name: writer for name, (writer, *_) in TEXT.items()}, **BINARY}
    good = {}
    for name, write in writers.items():
        path = folder / name
        write(path)
        problem = check(name, path)
        print(f"{name:28s} {path.stat().st_size:8d} bytes  {problem or 'to the last digit'}")
        if not problem:
            good[name] = path.read_bytes()
    print(f"{len(good)} of {len(writers)} files are read to the last digit")
    counts: Counter = Counter()
    rng = np.random.default_rng(11)
    names = list(good)
    for k in range(mutations):
        name = names[k % len(names)]
        path = folder / f"m{Path(name).suffix}"
        path.write_bytes(mutated(good[name], rng))
        kind, what = attempt(name, path)
        counts[kind] += 1
        if kind.isupper():
            print(f"mutation {k} of {name}: {kind} {what[:160]}")
            shutil.copy(path, folder / f"bad_{k}_{name}")
    print(f"{mutations} mutations: {dict(counts)}; kept in {folder}" if counts else "")
    if "--rows" in sys.argv:
        many_rows(folder, int(sys.argv[sys.argv.index("--rows") + 1]))


def many_rows(folder: Path, rows: int) -> None:
    """Time and memory of a long text file, in a process of its own."""
    path = folder / "long.csv"
    with open(path, "w", encoding="utf-8") as file:
        file.write("time [s],current [mA],spool_position [mm],load_flow [L/min]\n")
        for start in range(0, rows, 200_000):
            k = np.arange(start, min(rows, start + 200_000))
            cells = zip(k.tolist(), RNG.normal(size=(len(k), 3)).tolist(), strict=True)
            file.write("".join(f"{i / 1e4:.4f},{a:.6g},{b:.6g},{c:.6g}\n" for i, (a, b, c) in cells))
    code = ("import time, resource; a = time.process_time(); from pathlib import Path; "
            "from valvesim.measurement.recording import read_recording; "
            f"r = read_recording([Path({str(path)!r})], ('current', 'spool_position', 'load_flow')); "
            "print(f'{len(r.time)} rows in {time.process_time() - a:.1f} s of processor, "
            "{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB at most')")  # fmt: skip
    subprocess.run([sys.executable, "-c", code], check=True)
    path.unlink()


if __name__ == "__main__":
    main()
