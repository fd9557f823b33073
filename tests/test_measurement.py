"""Measurement files of any format and dialect: read to the last digit, or refused with what to state."""

import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import valvesim as vs
from valvesim.characterisation.acceptance.acceptance_tests import record_figures
from valvesim.characterisation.acceptance.record import read_record
from valvesim.errors import InputError
from valvesim.identification.session_toml import load_session
from valvesim.measurement import dialect
from valvesim.measurement.clock import even_clock
from valvesim.measurement.columns_table import NOTHING_STATED, read_statements, statements_of, statements_text
from valvesim.measurement.formats import FORMATS, read_measured_tables
from valvesim.measurement.headings import MEASURED_UNITS, channel_of, heading_of
from valvesim.measurement.quality import channel_qualities, grid_step, saturated_share
from valvesim.measurement.recording import read_recording

COUNT = 300
TIME = np.arange(COUNT) / 1e3
CURRENT = np.round(5e-3 * np.sin(2 * np.pi * 10.0 * TIME), 9)
SPOOL = np.random.default_rng(0).normal(size=COUNT) * 1e-4
CHANNELS = ("current", "spool_position", "oil_temperature", "supply_pressure", "load_flow")


def read(tmp_path, content, name="a.csv", stated=NOTHING_STATED, encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return read_recording([path], CHANNELS, stated=stated)


def refused(*arguments, **options):
    with pytest.raises(InputError) as caught:
        read(*arguments, **options)
    return str(caught.value)


def table(time, *columns, head="time [s],current [A],spool_position [m]", separator=",", end="\n", decimal="."):
    rows = [separator.join("" if np.isnan(v) else repr(float(v)).replace(".", decimal) for v in row)
            for row in zip(time, *columns, strict=True)]  # fmt: skip
    return end.join([head.replace(",", separator), *rows, ""])


# ---------------------------------------------------------------- text


DIALECTS = {
    "plain": {},
    "semicolon and decimal comma": {"separator": ";", "decimal": ","},
    "tab and decimal comma": {"separator": "\t", "decimal": ","},
    "bar": {"separator": "|"},
    "parentheses": {"head": "Time (s),Current (A),Spool Position (m)"},
    "other names": {"head": "Zeit [s],Strom [A],Schieberweg [m]", "separator": ";", "decimal": ","},
    "units in a second row": {"head": "time,current,spool_position\ns,A,m"},
    "units in a second row of brackets": {"head": "t,I,xv\n[s],[A],[m]", "separator": "\t"},
    "plain names": {"head": "t_s,current_A,spool_position_m"},
    "comment sign": {"head": "# time [s],current [A],spool_position [m]"},
    "preamble": {"head": "Bench 7\nDate: 2026-11-24\n\n***\ntime [s],current [A],spool_position [m]"},
    "preamble of cells": {"head": "Rig,7,\nSamples,300,\n,,\ntime [s],current [A],spool_position [m]"},
    "quoted": {"head": '"time [s]","current [A]","spool_position [m]"'},
    "returns": {"end": "\r\n"},
    "old returns": {"end": "\r"},
}


@pytest.mark.parametrize(
    "name, encoding",
    [
        *((name, "utf-8") for name in DIALECTS),
        *(("semicolon and decimal comma", encoding) for encoding in ("utf-8-sig", "utf-16", "utf-16-be", "cp1252")),
    ],
)
def test_a_dialect_is_read_to_the_last_digit(tmp_path, name, encoding):
    recording = read(tmp_path, table(TIME, CURRENT, SPOOL, **DIALECTS[name]), encoding=encoding)
    assert np.array_equal(recording.values["current"], CURRENT)
    assert np.array_equal(recording.values["spool_position"], SPOOL)
    assert recording.time == pytest.approx(TIME, abs=1e-12) and recording.notes == ()


def test_a_degree_sign_of_an_old_encoding_is_a_degree(tmp_path):
    content = table(TIME, CURRENT, 30.0 + TIME, head="Zeit (s);Strom (A);Öltemperatur (°C)", separator=";", decimal=",")
    recording = read(tmp_path, content, encoding="cp1252")
    assert np.array_equal(recording.values["oil_temperature"], 30.0 + TIME)


@pytest.mark.parametrize(
    "content, message",
    [
        ("t [s];p [bar]\n1,234;2,345\n2,345;3,456\n", "line 2: '1,234' may be 1.234 or 1234: state [csv] dec"),
        ("1,5\n2,5\n3,5\n", "line 1: '1,5' can be read in two ways: state [csv] separator and decimal"),
        ("time [s],current [mA]\n0,1,5,0\n0,2,5,0\n", "line 2: 4 cells under 2 columns; is a comma a point?"),
        ("time [s],current [mA]\n0,1\n1,2,5\n2,3\n3,4\n", "line 3: 3 cells under 2 columns; is a comma a point?"),
        ("time [s];current [mA]\n0;1\n1;2.5\n2;1.000,5\n3;4\n", "line 4: '1.000,5' in column 'current' is not"),
        ("time [s];current [mA]\n0;1,5\n1;2.5\n2;1,5\n3;4,5\n", "line 3: '2.5' in column 'current' is not a number"),
        ("time [s],current [mA]\n0,1\n1,x\n2,3\n4,5\n5,6\n", "line 3: 'x' in column 'current' is not a number"),
        ("time [s],current [mA]\n0,x\n1,2\n2,3\n4,5\n5,6\n", "line 2: 'x' in column 'current' is not a number"),
        ("time [s],current [mA]\n0,1,2\n1,2\n2,3\n4,5\n", "line 2: 3 cells under 2 columns"),
        ("time [s],current [mA]\n0,1\n1,True\n2,3\n", "line 3: 'True' in column 'current' is not a number"),
        ("time [s],current [mA]\n0,1\n1\n2,3\n", "line 3: 1 cells under 2 columns"),
        ("time [s],current [mA]\n0,1\n1,\0\n2,3\n", "zero bytes"),
        ("time [s],current\n0,1\n1,2\n2,3\n", "line 1: column 'current' needs a name and a unit"),
        ("time [s],current [bar]\n0,1\n1,2\n2,3\n", "line 1: column 'current': 'bar' has the wrong dimension"),
        ("time [s],i [mA],strom [mA]\n0,1,1\n1,2,2\n2,3,3\n", "'i [mA]' and 'strom [mA]' may both be current"),
        ("time [s],a,b\n0,1,1\n1,2,2\n2,3,3\n", "no column is one of current, "),
        ("x [s],current [mA]\n0,1\n1,2\n2,3\n", "no column 'time'"),
        ("time [s],current [mA]\n0,1\n0,2\n0,3\n", "all times are the same"),
        ("", "holds no data"),
    ],
)  # fmt: skip
def test_what_is_told_in_two_ways_or_none_is_refused(tmp_path, content, message):
    assert message in refused(tmp_path, content)


def test_an_ambiguous_file_is_read_as_stated(tmp_path):
    content = "time [s];current [A]\n1,234;2,345\n2,345;3,456\n3,456;4,567\n"
    stated = statements_of({}, {"separator": ";", "decimal": ","})
    assert read(tmp_path, content, stated=stated).values["current"].tolist() == [2.345, 3.456, 4.567]


def test_where_nothing_is_read_the_message_says_what_was_stated(tmp_path):
    stated = statements_of({}, {"separator": ";", "decimal": ","})
    told = refused(tmp_path, "time [s],current [A]\n0.0,1.5\n0.1,2.5\n0.2,3.5\n", stated=stated)
    assert "holds no data with the stated separator ;, decimal ','" in told


def test_a_last_row_that_was_cut_off_is_left_out_and_told(tmp_path):
    recording = read(tmp_path, table(TIME, CURRENT, SPOOL) + "0.3,0.00")
    assert len(recording.time) == COUNT
    assert recording.notes == (
        "a.csv: the file ends without an end of its last line, which may be cut off: its row is left out",
    )


NUMBERS = st.lists(
    st.tuples(st.floats(-1e300, 1e300), st.sampled_from(["", "nan", "NaN", "-", "n/a", "inf", "1e400"])),
    min_size=4, max_size=12,
)  # fmt: skip


@given(NUMBERS, st.sampled_from([(",", "."), (";", ","), ("\t", "."), ("|", ",")]))
@settings(max_examples=30, deadline=None)
def test_any_number_survives_and_what_is_missing_is_nan(tmp_path_factory, cells, marks):
    separator, decimal = marks
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    rows = [f"{k}{separator}{repr(v).replace('.', decimal)}{separator}{m}" for k, (v, m) in enumerate(cells)]
    path.write_text("\n".join([separator.join(["time [s]", "current [A]", "spool [m]"]), *rows, ""]), encoding="utf-8")
    (found,) = read_measured_tables(path, lambda headings: range(len(headings)))
    assert found.columns[1].values.tolist() == [v for v, _ in cells]
    assert np.isnan(found.columns[2].values).all()


@given(
    st.lists(
        st.lists(st.sampled_from(["1", "2.5", "1,5", "a", "", "1.000", "12:30", "x y", "-"]), min_size=1, max_size=4),
        min_size=1, max_size=6,
    ),
    st.sampled_from([",", ";", "\t", "|", " "]), st.sampled_from(["", "t,x\n", "t;x [m]\n", "t x y\n"]),
)  # fmt: skip
@settings(max_examples=200, deadline=None)
def test_separators_that_are_nowhere_in_a_file_change_nothing(rows, separator, head):
    """All of them read, against the one that stands for them."""
    text = head + "\n".join(separator.join(row) for row in rows) + "\n"

    def told():
        try:
            return dialect.layout_of(Path("a.csv"), text, "utf-8", dialect.NO_DIALECT)
        except InputError as error:
            return str(error)

    few = told()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dialect, "_separators_of", lambda text: list(dialect.SEPARATORS.values()))
        assert told() == few


CLOCKS = {
    "09:59:59.{:03d}": "10:00:00.{:03d}", "23:59:59,{:03d}": "00:00:00,{:03d}",
    "2026-11-24 23:59:59.{:03d}": "2026-11-25T00:00:00.{:03d}",
    "24.11.2026 09:59:59,{:03d}": "24.11.2026 10:00:00,{:03d}",
    "11/24/2026 11:59:59.{:03d} AM": "11/24/2026 12:00:00.{:03d} PM",
}  # fmt: skip


@pytest.mark.parametrize("before", CLOCKS)
def test_times_of_day_are_seconds_past_midnight_too(tmp_path, before):
    stamps = [before.format(k) for k in range(700, 1000)] + [CLOCKS[before].format(k) for k in range(300)]
    rows = [f"{stamp};{k}" for k, stamp in enumerate(stamps)]
    recording = read(tmp_path, "\n".join(["Time;current [mA]", *rows, ""]))
    assert recording.time == pytest.approx(np.arange(600) * 1e-3, abs=1e-6) and recording.notes == ()


def test_a_date_that_changes_and_cannot_be_told_is_refused(tmp_path):
    rows = "11/12/2026 23:59:59;1\n12/12/2026 00:00:00;2\n12/12/2026 00:00:01;2\n"
    assert "write dates as 2026-11-24" in refused(tmp_path, "Time;current [mA]\n" + rows)


# ---------------------------------------------------------------- times


def test_a_gap_is_nan_and_told(tmp_path):
    keep = (np.arange(COUNT) < 100) | (np.arange(COUNT) >= 120)
    recording = read(tmp_path, table(TIME[keep], CURRENT[keep], SPOOL[keep]))
    assert len(recording.time) == COUNT
    assert np.array_equal(np.isnan(recording.values["current"]), ~keep)
    assert np.array_equal(recording.values["spool_position"][keep], SPOOL[keep])
    assert recording.notes == ("a.csv: 1 gaps, 20 samples in all, the longest of 20",)
    assert recording.line_of(99) == 101 and recording.line_of(120) == 102


def test_one_channel_may_miss_readings(tmp_path):
    spool = np.where(np.arange(COUNT) % 7 == 3, np.nan, SPOOL)
    recording = read(tmp_path, table(TIME, CURRENT, spool))
    assert np.array_equal(recording.values["current"], CURRENT)
    assert np.array_equal(recording.values["spool_position"], spool, equal_nan=True)


def test_jittered_times_are_believed_and_readings_laid_on_an_even_clock(tmp_path):
    time = TIME + 2e-4 * np.random.default_rng(1).uniform(-1.0, 1.0, COUNT)
    wave = np.sin(2.0 * np.pi * 5.0 * time)
    recording = read(tmp_path, table(time, wave, wave))
    at = time[0] + recording.time
    assert np.max(np.abs(recording.values["current"] - np.sin(2.0 * np.pi * 5.0 * at))) < 5e-4
    assert "readings are laid on it by straight lines" in recording.notes[0]


def test_times_of_too_few_digits_are_taken_as_even(tmp_path):
    recording = read(tmp_path, table(np.round(TIME, 2), CURRENT, SPOOL))
    assert np.array_equal(recording.values["current"], CURRENT)
    assert recording.time[-1] == pytest.approx(TIME[-1], rel=0.01)
    assert "times are written to 0.01 s only" in recording.notes[0]


def test_a_rate_takes_the_place_of_times(tmp_path):
    content = table(CURRENT, SPOOL, head="current [A],spool_position [m]")
    recording = read(tmp_path, content, stated=statements_of({"time": {"rate": "2 kHz"}}, {}))
    assert recording.time == pytest.approx(np.arange(COUNT) / 2e3)


def test_channels_of_several_files_and_rates_stand_on_the_fastest_clock(tmp_path):
    slow = np.arange(0.0, 0.3, 0.01)
    (tmp_path / "slow.csv").write_text(table(slow, 20.0 + slow, head="time [s],oil temperature [degC]"))
    (tmp_path / "fast.csv").write_text(table(TIME, CURRENT, SPOOL))
    recording = read_recording([tmp_path / "slow.csv", tmp_path / "fast.csv"], CHANNELS)
    assert np.array_equal(recording.values["current"], CURRENT)
    there = np.isfinite(recording.values["oil_temperature"])
    assert np.flatnonzero(there).tolist() == list(range(0, COUNT, 10))
    assert recording.values["oil_temperature"][there] == pytest.approx(20.0 + slow)
    assert recording.sources["oil_temperature"].rate == pytest.approx(100.0)


def test_an_uneven_clock_is_refused(tmp_path):
    time = np.sort(np.random.default_rng(2).uniform(0.0, 1.0, COUNT))
    assert "uneven clock: a step of" in refused(tmp_path, table(time, CURRENT, SPOOL))


# ---------------------------------------------------------------- [columns]


def test_columns_are_what_is_stated(tmp_path):
    (tmp_path / "columns.toml").write_text(
        """
        [columns]
        time = { column = "x", unit = "ms" }
        current = { column = "AI 0", unit = "mA", scale = 2.5, offset = -0.5, sign = -1 }
        spool_position = { column = 3, unit = "um" }
        load_flow = false
        """,
        encoding="utf-8",
    )
    stated = read_statements(tmp_path / "columns.toml")
    content = table(1e3 * TIME, CURRENT, SPOOL, SPOOL, head="x,AI 0,AI 1,load_flow")
    recording = read(tmp_path, content, stated=stated)
    assert recording.values["current"] == pytest.approx(-1e-3 * (2.5 * CURRENT - 0.5), rel=1e-12)
    assert recording.values["spool_position"] == pytest.approx(1e-6 * SPOOL, rel=1e-12)
    assert recording.left_out == ("load_flow",) and recording.time == pytest.approx(TIME)


@pytest.mark.parametrize(
    "columns, message",
    [
        ({"spool_positon": "a"}, "columns: unknown channel 'spool_positon'; did you mean 'spool_position'?"),
        ({"current": 1.5}, "columns.current: expected a column, a table or false, got 1.5"),
        ({"current": 0}, "columns.current.column: columns count from 1, got 0"),
        ({"current": {"col": 1}}, "columns.current: unknown key 'col'"),
        ({"current": {"unit": "bar"}}, "columns.current.unit: 'bar' has the wrong dimension"),
        ({"current": {"scale": 0}}, "columns.current.scale: a scale of zero leaves nothing"),
        ({"current": {"sign": 2}}, "columns.current.sign: expected 1 or -1, got 2"),
        ({"current": {"scale": "2"}}, "columns.current.scale: expected a number, got '2'"),
        ({"time": {"rate": "-1 Hz"}}, "columns.time.rate: '-1 Hz' must be positive"),
        ({"time": {"rate": "1 Hz", "unit": "s"}}, "columns.time.rate: a rate takes the place of a column of times"),
    ],
)
def test_a_statement_that_makes_no_sense_is_refused(columns, message):
    with pytest.raises(InputError) as caught:
        statements_of(columns, {})
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    "csv, message",
    [
        ({"separator": "x"}, "csv.separator: expected one of ';', 'tab', ',', '|', 'space', got 'x'"),
        ({"decimal": ":"}, "csv.decimal: expected one of"),
        ({"header_line": -1}, "csv.header_line: expected a line"),
        ({"encoding": "utf-99"}, "csv.encoding: expected an encoding"),
        ({"seperator": ";"}, "csv: unknown key 'seperator'; did you mean 'separator'?"),
    ],
)
def test_a_dialect_that_makes_no_sense_is_refused(csv, message):
    with pytest.raises(InputError) as caught:
        statements_of({}, csv)
    assert str(caught.value).startswith(message)


def test_statements_are_written_as_they_are_read(tmp_path):
    stated = statements_of({"time": {"rate": "2 kHz"}, "current": {"column": "AI \"0\"", "unit": "mA", "sign": -1}}, {})
    (tmp_path / "c.toml").write_text(statements_text(stated.columns, ["a\nb"[:1]]), encoding="utf-8")
    assert read_statements(tmp_path / "c.toml").columns == stated.columns


def test_a_stated_column_that_is_not_there_is_named(tmp_path):
    stated = statements_of({"current": "AI 0"}, {})
    assert "no column 'AI 0' in a.csv" in refused(tmp_path, table(TIME, CURRENT, SPOOL), stated=stated)


# ---------------------------------------------------------------- headings


@pytest.mark.parametrize(
    "text, name, unit",
    [
        ("current [mA]", "current", "mA"), ("Current (mA)", "Current", "mA"), ("current / mA", "current", "mA"),
        ("current in mA", "current", "mA"), ("current, mA", "current", "mA"), ("current_mA", "current", "mA"),
        ("leak_flow_m3s", "leak_flow", "m^3/s"), ("oil temp (°C)", "oil temp", "degC"),
        ("supply_pressure", "supply_pressure", ""),
        ("p_supply_bar", "p_supply", "bar"), ("velocity / factor", "velocity / factor", ""),
        ("I (rms) [A]", "I (rms)", "A"),
    ],
)  # fmt: skip
def test_a_heading_is_a_name_and_a_unit(text, name, unit):
    heading = heading_of(text)
    assert (heading.name, heading.unit) == (name, unit)


def test_every_channel_is_known_by_its_own_name_in_any_letters():
    for name in MEASURED_UNITS:
        for spelling in (name, name.upper(), name.replace("_", " ").title(), name.replace("_", "-")):
            assert channel_of(spelling) == name
    assert channel_of("T") is None and channel_of("t") == "time"


# ---------------------------------------------------------------- other formats


def in_netcdf(path):
    import xarray

    units = {"current": "A", "spool_position": "m"}
    values = {"current": CURRENT, "spool_position": SPOOL}
    xarray.Dataset(
        {name: ("time", value, {"units": units[name]}) for name, value in values.items()},
        coords={"time": ("time", TIME, {"units": "s"})},
    ).to_netcdf(path)


def in_mat5(path):
    from scipy.io import savemat

    savemat(path, {"data": {"time": TIME, "current": CURRENT[:, None], "spool_position": SPOOL},
                   "units": {"time": "s", "current": "A", "spool_position": "m"}})  # fmt: skip


def in_mat73(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in {"t_s": TIME, "current_A": CURRENT, "spool_position_m": SPOOL}.items():
            file.create_dataset(name, data=value[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def in_tdms(path):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([
            nptdms.ChannelObject("bench", name, value, {"wf_increment": 1e-3, "unit_string": unit})
            for name, value, unit in (("current", CURRENT, "A"), ("spool_position", SPOOL, "m"))
        ])  # fmt: skip


def in_mdf(path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(CURRENT, TIME, unit="A", name="current"),
                     asammdf.Signal(SPOOL, TIME, unit="m", name="spool_position")])  # fmt: skip
        file.save(path)


def in_parquet(path):
    pytest.importorskip("pyarrow")
    import pandas

    frame = pandas.DataFrame({"time [s]": TIME, "current [A]": CURRENT, "spool_position [m]": SPOOL})
    frame.to_parquet(path)


def in_xlsx(path):
    pytest.importorskip("openpyxl")
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    for row in (["Bench 7"], [], ["Time", "Current", "Spool position"], ["s", "A", "m"]):
        sheet.append(row)
    for row in zip(TIME, CURRENT, SPOOL, strict=True):
        sheet.append([float(value) for value in row])
    book.save(path)


WRITERS = {"a.nc": in_netcdf, "5.mat": in_mat5, "73.mat": in_mat73, "a.tdms": in_tdms, "a.mf4": in_mdf,
           "a.parquet": in_parquet, "a.xlsx": in_xlsx}  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WRITERS)
def test_a_format_is_read_to_the_last_digit(tmp_path, name):
    WRITERS[name](tmp_path / name)
    recording = read_recording([tmp_path / name], CHANNELS)
    digits = 0.0 if name != "a.xlsx" else 1e-15  # openpyxl writes sixteen digits
    assert recording.values["current"] == pytest.approx(CURRENT, rel=digits, abs=0.0)
    assert recording.values["spool_position"] == pytest.approx(SPOOL, rel=digits, abs=0.0)
    assert recording.time == pytest.approx(TIME, abs=1e-9) and recording.notes == ()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    "content", [b"", b"nonsense", b"\x89HDF\r\n\x1a\n" + 600 * b"x", b"PK\3\4", b"TDSm" + 60 * b"\xff"]
)
def test_a_broken_file_is_refused_in_one_line(tmp_path, suffix, content):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_recording([path], CHANNELS)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_dates_of_a_sheet_are_seconds(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Time", "current [mA]"])
    first = datetime.datetime(2026, 11, 24, 23, 59, 59)
    for k in range(60):
        book.active.append([first + datetime.timedelta(milliseconds=100 * k), k])
    book.save(tmp_path / "a.xlsx")
    assert read_recording([tmp_path / "a.xlsx"], CHANNELS).time == pytest.approx(np.arange(60) * 0.1, abs=1e-6)


def test_the_bench_reads_any_format(tmp_path):
    in_netcdf(tmp_path / "a.nc")
    record = read_record(tmp_path / "a.nc")
    assert np.array_equal(record.values["current"], CURRENT)


# ---------------------------------------------------------------- valvesim records


def test_records_shows_what_was_understood_and_writes_the_columns_to_keep(tmp_path, call):
    spool = np.where(np.arange(COUNT) % 50 == 3, np.nan, np.clip(SPOOL, -1e-4, 1e-4))
    path = tmp_path / "a.csv"
    path.write_text(table(TIME, CURRENT, spool, CURRENT, head="time [s],Strom [A],spool [m],force [N]"))
    code, out, _ = call("records", path, "-o", tmp_path / "out")
    assert code == 0 and "300 samples at 1000 Hz" in out and "no channel: force" in out
    assert "separator ,, decimal point, utf-8, names in line 1, data from line 2" in out
    assert (tmp_path / "out" / "a.png").stat().st_size > 10_000
    kept = read_statements(tmp_path / "out" / "columns.toml").columns
    assert {name: stated.column for name, stated in kept.items()} == {
        "time": "time", "current": "Strom", "spool_position": "spool",
    }  # fmt: skip


def test_records_lists_the_columns_of_a_file_that_nobody_understands(tmp_path, call):
    path = tmp_path / "a.csv"
    path.write_text("a,b\n0,1\n1,2\n2,3\n")
    code, out, err = call("records", path, "-o", tmp_path / "out")
    assert code == 2 and "no column is one of" in err and "columns as they stand" in " ".join(out.split())
    assert "# No channel yet: 'a'" in (tmp_path / "out" / "columns.toml").read_text()


def test_the_quality_of_a_channel_is_seen(tmp_path):
    noise = np.random.default_rng(3).normal(size=COUNT)
    coarse = np.round(np.sin(2.0 * np.pi * 5.0 * TIME), 1)
    flat = np.clip(np.sin(2.0 * np.pi * 5.0 * TIME), -0.9, 0.9)
    path = tmp_path / "a.csv"
    path.write_text(table(TIME, 1e-3 * noise, coarse, flat, head="time [s],current [A],spool [m],load_flow [m^3/s]"))
    found = {one.channel: one for one in channel_qualities(read_recording([path], CHANNELS))}
    assert found["current"].noise == pytest.approx(1e-3, rel=0.15)
    assert found["spool_position"].resolution == pytest.approx(0.1)
    assert found["load_flow"].saturated == pytest.approx(np.mean(np.abs(flat) >= 0.9), abs=1e-9)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_rounded_crest_is_not_cut_off_and_a_ramp_has_no_resolution(noise):
    """A sine to four digits was 3.4 % saturated, with a noise of 6e-18 mm; a triangle had a resolution of 0.032 mA."""
    time, dice = np.arange(2000) / 1e3, np.random.default_rng(3)
    sine = np.round(0.04 * np.sin(2.0 * np.pi * 2.0 * time) + noise * dice.normal(size=2000), 4)
    assert saturated_share(sine) == 0.0 and saturated_share(np.clip(sine, -0.03, 0.03)) > 0.3
    assert grid_step([sine]) == pytest.approx(1e-4)
    triangle = 8.0 - 0.032 * np.abs(np.arange(2000) % 1000 - 500.0)
    assert grid_step([triangle]) == 0.0
    assert grid_step([np.round(triangle / 0.5) * 0.5]) == pytest.approx(0.5)  # so a converter leaves it


# ---------------------------------------------------------------- what `run` writes is read


@pytest.mark.parametrize("form", ["netcdf", "csv", "parquet", "mat"])
def test_what_a_run_writes_is_a_record_of_a_session_and_of_the_bench(tmp_path, form):
    triangle = vs.Table(times=(0.0, 0.5, 1.5, 2.0), values=(0.0, 8e-3, -8e-3, 0.0))
    held = vs.Thermal(network=None)
    result = vs.simulate(vs.Scenario(duration=2.0, thermal=held, command=triangle, output_rate=500.0))
    suffix = {"netcdf": "nc"}.get(form, form)
    path = getattr(result, f"to_{form}")(tmp_path / f"a.{suffix}")
    (tmp_path / "session.toml").touch()
    (record,) = load_session(tmp_path).records
    digits = 1e-8 if form == "csv" else 0.0
    for name in ("current", "spool_position", "load_flow"):
        assert record.values[name] == pytest.approx(result.values[name], rel=digits, abs=0.0)
    figures = {figure.name: figure for figure in record_figures(read_record(path), "flow")}
    assert figures["flow_gain_positive"].value == pytest.approx(0.0452, rel=1e-2)  # m^3/s/A: a full cycle from null on


def test_a_session_takes_columns_and_several_files_of_a_record(tmp_path):
    slow = np.arange(0.0, 0.3, 0.01)
    (tmp_path / "slow.csv").write_text(table(slow, 20.0 + 10.0 * slow, slow, head="time [s],T,q [L/min]"))
    spool = np.where(np.arange(COUNT) == 50, np.nan, 1e-4 * np.sin(60.0 * TIME))
    (tmp_path / "fast.csv").write_text(table(TIME, 1e3 * CURRENT, spool, head="time [s],AI0,spool_position [m]"))
    (tmp_path / "session.toml").write_text(
        """
        [columns]
        oil_temperature = { column = "T", unit = "degC" }
        [[records]]
        files = ["fast.csv", "slow.csv"]
        columns.current = { column = "AI0", unit = "mA", sign = -1 }
        """,
        encoding="utf-8",
    )
    session = load_session(tmp_path)
    (record,) = session.records
    assert record.name == "fast" and record.values["current"] == pytest.approx(-CURRENT, abs=1e-15)
    assert record.values["oil_temperature"][:291] == pytest.approx(20.0 + 10.0 * TIME[:291])  # straight between
    assert np.flatnonzero(record.usable["load_flow"]).tolist() == list(range(0, COUNT, 10))
    assert np.flatnonzero(~record.usable["spool_position"]).tolist() == [50]
    assert any("load_flow was read at 100 Hz, the record's clock has 1000 Hz" in note for note in session.notes)


@pytest.mark.parametrize(
    "content, message",
    [
        ("time [s],current [mA]\n0,1\n1,2\n2,\r3\n", "line 4: a carriage return in the middle of a line"),
        ("time [s],current [mA]\r\r\n0,1\r\r\n1,2\r\r\n", "line 1: a carriage return in the middle of a line"),
        ('time [s],current [mA]\n"0,1\n1,2\n2,3\n', "0 rows were read of 2: it is no plain table of columns"),
    ],
)
def test_line_ends_and_quotes_that_others_read_otherwise_are_refused(tmp_path, content, message):
    assert message in refused(tmp_path, content)


def test_readings_that_no_axis_can_show_are_not_drawn(tmp_path, call):
    path = tmp_path / "a.csv"
    path.write_text(table(TIME, 1e305 * SPOOL, SPOOL))
    assert call("records", path, "-o", tmp_path / "out")[0] == 0


def test_a_wrong_first_row_is_told_where_the_names_stand_by_statement_too(tmp_path):
    columns = {"time": {"column": 1, "unit": "s"}, "current": {"column": 2, "unit": "mA"}}
    stated = statements_of(columns, {"header_line": 0, "separator": ",", "decimal": "."})
    assert "line 1: 'x' in column '2'" in refused(tmp_path, "0,x\n1,2\n2,3\n3,4\n", stated=stated)


def test_a_scenario_is_driven_by_a_record_of_another_format(tmp_path):
    in_netcdf(tmp_path / "a.nc")
    (tmp_path / "s.toml").write_text(
        "duration = '0.2 s'\n[command.current]\ntable = { file = 'a.nc' }\n", encoding="utf-8"
    )
    command = vs.load_scenario(tmp_path / "s.toml").command
    assert command.values == tuple(CURRENT) and command.times == pytest.approx(TIME)
    (tmp_path / "s.toml").write_text(
        "duration = '0.2 s'\n[command.current]\ntable = { file = 'a.nc', column = 'amps' }\n", encoding="utf-8"
    )
    with pytest.raises(InputError) as caught:
        vs.load_scenario(tmp_path / "s.toml")
    assert "unknown channel 'amps'" in str(caught.value)


def test_times_of_single_precision_are_taken_as_even(tmp_path):
    time = (300.0 + np.arange(3000) / 1e4).astype(np.float32).astype(float)
    clock = even_clock(time, tmp_path, lambda row: None, lambda row, other: False)
    assert not clock.interpolated and clock.count == 3000 and clock.step == pytest.approx(1e-4, rel=1e-4)
    assert "times are written to 3.05e-05 s only" in clock.notes[0]


@pytest.mark.parametrize("step", [1e-320, 1e-15, 1e300])
def test_samples_closer_or_farther_apart_than_any_are_refused(tmp_path, step):
    with pytest.raises(InputError, match=r"samples .* s apart are outside \[1e-12, 1e\+12\] s"):
        read(tmp_path, table(np.arange(200) * step, CURRENT[:200], head="time [s],current [A]"))


def test_a_time_beyond_all_reckoning_is_refused_with_its_line(tmp_path):
    time = np.concatenate([[-1e308], np.arange(1, 200) / 1e3])
    with pytest.raises(InputError) as caught:
        even_clock(time, tmp_path, lambda row: row + 2, lambda row, other: False)
    assert caught.value.line == 2 and "-1e+308 s is beyond" in str(caught.value)


def test_columns_of_one_name_are_told_by_number(tmp_path):
    content = table(TIME, CURRENT, SPOOL, CURRENT, head="time [s],Untitled,Untitled,Untitled")
    stated = {"current": {"column": 2, "unit": "A"}, "spool_position": {"column": 3, "unit": "m"}}
    recording = read(tmp_path, content, stated=statements_of(stated, {}))
    assert np.array_equal(recording.values["spool_position"], SPOOL) and recording.left_out == ("Untitled",)
    assert recording.sources["spool_position"].statement.column == 3
    stated["spool_position"]["column"] = "Untitled"
    told = refused(tmp_path, content, stated=statements_of(stated, {}))
    assert "line 1: columns.spool_position.column: there are 3 columns 'Untitled': give its number" in told
