"""A measured session: read strictly, audited, split into training and locked records, made into scenarios."""

import dataclasses
import re

import numpy as np
import pytest

from valvesim.errors import InputError
from valvesim.identification.options import DEFAULT_IDENTIFICATION
from valvesim.identification.prior import nominal_model_of
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.session import INPUTS, OUTPUTS, PART_TEMPERATURES, Record, Sensor
from valvesim.identification.session_toml import load_session
from valvesim.inputs import Constant, Table, evaluate
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Thermal
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import CurrentDrive, VoltageDrive

TIME = np.arange(200) / 1e3
WAVE = np.sin(2 * np.pi * 10.0 * TIME)
CURRENT, SPOOL = "current [mA]", "spool_position [mm]"

EFFECT = """
import valvesim as vs

own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0),),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""


def columns(seed=0, **changed):
    """Columns of a good record: 10 Hz at 5 mA with a noisy spool; `current__mA=` and the like are for the tests."""
    noise = np.random.default_rng(seed).normal(size=TIME.size)
    nominal = {"time [s]": TIME, CURRENT: 5.0 * WAVE, "oil_temperature [degC]": 30.0 + 0.0 * TIME,
            SPOOL: 0.2 * WAVE + 1e-3 * noise}  # fmt: skip
    return nominal | changed


def text(table):
    """A CSV file from columns; None leaves one out."""
    table = {name: values for name, values in table.items() if values is not None}
    rows = np.column_stack(list(table.values()))
    return "\n".join([",".join(table), *(",".join(f"{v:.12g}" for v in row) for row in rows)]) + "\n"


@pytest.fixture
def session(tmp_path):
    """Writes `session.toml` and records (columns or text, by name) and loads them."""

    def load(toml="", **records):
        (tmp_path / "session.toml").write_text(toml, encoding="utf-8")
        for name, record in (records or {"a": columns()}).items():
            content = record if isinstance(record, str) else text(record)
            (tmp_path / f"{name}.csv").write_text(content, encoding="utf-8")
        return load_session(tmp_path, trust=True)

    return load


def refused(load, *arguments, **records):
    with pytest.raises(InputError) as caught:
        load(*arguments, **records)
    assert type(caught.value) is InputError
    return str(caught.value)


def listed(*files, **keys):
    """[[records]] for these files, all with the same keys."""
    lines = "".join(f"{key} = {value!r}\n" for key, value in keys.items())
    return "".join(f"[[records]]\nfile = '{file}.csv'\n{lines}" for file in files)


# ---------------------------------------------------------------- a good session


def test_a_full_session_is_read_in_si(session, tmp_path):
    (tmp_path / "own.py").write_text(EFFECT, encoding="utf-8")
    loaded = session(
        """
        title = "bench 3"
        seed = 7
        effects_files = ["own.py"]
        [valve]
        null_gap = "0.03 mm"
        [oil]
        name = "yh12_paper"
        [thermal]
        isothermal = true
        [effects.spool_coulomb_friction]
        friction_force = "2 N"
        [tolerances]
        feedback_rod_stiffness = "5 %"
        null_gap_difference = "0.5 um"
        flux_share = "0.02"
        [sensors.spool_position]
        noise = "1 um"
        resolution = "0.5 um"
        lag = "1 ms"
        range = ["-0.5 mm", "0.5 mm"]
        [[records]]
        file = "a.csv"
        repeats = "sine"
        [[records]]
        file = "b.csv"
        repeats = "sine"
        [[records]]
        file = "c.csv"
        role = "test"
        """,
        a=columns(1), b=columns(2), c=columns(3),
    )  # fmt: skip
    assert (loaded.title, loaded.seed, loaded.folder) == ("bench 3", 7, tmp_path)
    assert loaded.valve.null_gap == pytest.approx(0.03e-3) and loaded.oil.name == "yh12_paper"
    assert loaded.thermal.network is None
    assert [active.effect.name for active in loaded.effects] == ["spool_coulomb_friction"]
    assert loaded.effects[0].values.friction_force == 2.0
    assert [effect.name for effect in loaded.user_effects] == ["side_load"]
    assert loaded.tolerances == pytest.approx(
        {"feedback_rod_stiffness": 139.0, "null_gap_difference": 0.5e-6, "flux_share": 0.02}
    )
    sensor = loaded.sensors["spool_position"]
    assert (sensor.channel, sensor.unit) == ("spool_position", "m")
    assert [sensor.noise, sensor.resolution, sensor.lag] == pytest.approx([1e-6, 0.5e-6, 1e-3])
    assert sensor.range == pytest.approx((-0.5e-3, 0.5e-3))
    assert [record.name for record in loaded.training] == ["a", "b"]
    assert [record.name for record in loaded.locked] == ["c"]
    assert [record.repeats for record in loaded.records] == ["sine", "sine", None]
    assert loaded.drive == CurrentDrive()
    assert loaded.notes == tuple(f"{name}: no supply pressure was measured; 210 bar is assumed" for name in "abc")
    first = loaded.records[0]
    assert first.values["current"] == pytest.approx(5e-3 * WAVE) and "time" not in first.values
    assert first.values["spool_position"] == pytest.approx(1e-3 * columns(1)[SPOOL])
    assert first.usable["spool_position"].all() and first.outputs == ("spool_position",)
    assert first.time == pytest.approx(TIME) and first.rate == pytest.approx(1000.0)
    assert first.duration == pytest.approx(0.199) and first.command == "current"
    assert first.inputs == ("current", "oil_temperature")


def test_an_empty_file_is_a_session_of_every_csv_in_name_order(session, tmp_path):
    loaded = session("", b=columns(), a=columns())
    assert [record.name for record in loaded.records] == ["a", "b"]
    assert loaded.title == tmp_path.name and loaded.seed == 0 and loaded.user_effects == () and loaded.tolerances == {}
    assert loaded.sensors == {"spool_position": Sensor("spool_position", "m")}
    assert loaded.thermal == Thermal()


def test_every_column_and_any_unit_is_read(session):
    more = {
        "time [s]": None, "time [ms]": 1e3 * TIME + 50.0, "voltage [mV]": 3e3 * WAVE,
        "oil_temperature [degC]": None, "oil_temperature [degF]": 32.0 + 180.0 * TIME,
        **{f"{part} [degC]": 20.0 + 50.0 * TIME for part in PART_TEMPERATURES}, "supply_pressure [MPa]": 20.0 + WAVE,
        "return_pressure [Pa]": 5e5 + 1e5 * WAVE, "load_pressure [psi]": 100.0 * WAVE, "armature_angle [mrad]": WAVE,
        "nozzle_pressure_1 [bar]": 100.0 + WAVE, "nozzle_pressure_2 [bar]": 100.0 - WAVE,
        "load_flow [L/min]": WAVE, "internal_leakage [L/min]": 1.0 + WAVE,
    }  # fmt: skip
    loaded = session("", a=columns(**more))
    (record,) = loaded.records
    assert set(record.values) == {*INPUTS, *OUTPUTS}
    assert set(record.outputs) == set(OUTPUTS)  # with a voltage, the current is measured
    assert loaded.drive == VoltageDrive() and record.command == "voltage"
    assert record.time[0] == 0.0 and record.time[-1] == pytest.approx(0.199)
    assert record.values["voltage"] == pytest.approx(3.0 * WAVE)
    assert record.values["oil_temperature"] == pytest.approx(100.0 * TIME, abs=1e-9)
    assert record.values["supply_pressure"] == pytest.approx((20.0 + WAVE) * 1e6)
    assert record.values["load_flow"] == pytest.approx(WAVE / 6e4)
    assert loaded.sensors["current"].unit == "A"


def test_without_oil_temperature_20_degrees_are_assumed_and_said(session):
    loaded = session("", a=columns(**{"oil_temperature [degC]": None}))
    assert np.all(loaded.records[0].values["oil_temperature"] == 20.0)
    assert "a: no oil temperature was measured; 20 °C is assumed" in loaded.notes


def test_measured_parts_go_where_they_were_measured_and_the_others_follow_them(session):
    still = {"oil_temperature [degC]": np.full_like(TIME, 40.0)}
    warm = {"body_temperature [degC]": 20.0 + 300.0 * TIME, "pilot temperature [C]": np.full_like(TIME, 35.0)}
    loaded, without = (session("", a=columns(**still, **more)) for more in (warm, {}))
    measured, assumed = (record_scenario(one, one.records[0]).temperatures() for one in (loaded, without))
    assert measured.parts.body == pytest.approx(20.0 + 300.0 * measured.times, abs=0.2)
    assert measured.parts.pilot_metal == pytest.approx(35.0)
    assert measured.parts.sleeve[-1] > 40.5  # it hears the body, which has come to be warmer
    assert assumed.parts.sleeve == pytest.approx(40.0, abs=0.1)
    named = {p.name for p in nominal_model_of(loaded, options=DEFAULT_IDENTIFICATION).parameters}
    assert "thermal.oil_to_sleeve" in named


def test_odd_but_clear_csv_is_read_too(session):
    lines = text(columns()).splitlines()
    odd = "\n\n" + ",".join(f'"{name}"' for name in lines[0].split(",")) + "\r\n\n  \n" + " \n".join(lines[1:])
    expected = session("", a=columns()).records[0]
    record = session("", a=odd).records[0]
    assert all(np.array_equal(record.values[name], expected.values[name]) for name in expected.values)


# ---------------------------------------------------------------- session.toml refused


def test_a_folder_without_session_toml_is_refused(tmp_path):
    assert refused(load_session, tmp_path).startswith(
        f"{tmp_path / 'session.toml'}: no such file; a session is a folder"
    )


def test_a_session_file_that_cannot_be_read_is_refused(session, tmp_path):
    assert "not valid TOML" in refused(session, "title = ")
    (tmp_path / "session.toml").write_bytes(b"title = '\xff'")
    assert "cannot be read" in refused(load_session, tmp_path)


@pytest.mark.parametrize(
    "toml, message",
    [
        ("\nsed = 1", ", line 2: session: unknown key 'sed'; did you mean 'seed'?"),
        ("valve = 1", ", line 1: valve: expected a table, got 1"),
        ("title = 1", ", line 1: title: expected text, got 1"),
        ("seed = 1.5", ", line 1: seed: expected a whole number, 0 or more, got 1.5"),
        ("seed = true", ", line 1: seed: expected a whole number"),
        ("seed = -1", ", line 1: seed: expected a whole number"),
        ("[valve]\nnull_gap = '3'", ", line 2: valve.null_gap: '3' has no unit"),
        ("[valve]\nnull_gap = '-3 mm'", ", line 2: valve.null_gap = -0.003 m is outside"),
        ("[valve]\nnul_gap = '3 mm'", "did you mean 'null_gap'?"),
        ("[oil]\nname = 'yh13'", ", line 2: oil.name: unknown oil 'yh13'"),
        ("[thermal]\noil_temperature = '20 degC'", ", line 2: thermal.oil_temperature: comes from the records"),
        ("[thermal]\nisotherm = true", ", line 2: thermal: unknown key 'isotherm'; did you mean 'isothermal'?"),
        ("[effects.spool_friction]\nf = 1", ", line 1: effects: unknown effect 'spool_friction'"),
        ("effects_files = 'own.py'", ", line 1: effects_files: expected a list of file names"),
        ("effects_files = ['no.py']", "no.py: no such file"),
        ("[tolerances]\nnull_gp = '5 %'",
         ", line 2: tolerances: unknown valve parameter 'null_gp'; did you mean 'null_gap'?"),
        ("[tolerances]\nnull_gap = '5 bar'", ", line 2: tolerances.null_gap: 'bar' has the wrong dimension"),
        ("[tolerances]\nnull_gap = '0 %'", ", line 2: tolerances.null_gap: '0 %' must be positive"),
        ("[tolerances]\nnull_gap = 5", ", line 2: tolerances.null_gap: 5 has no unit"),
        ("[tolerances]\nnull_gap_difference = '5 %'",
         ", line 2: tolerances.null_gap_difference: null_gap_difference is zero, so a share of it is nothing; "
         "give an absolute one in m"),
        ("[sensors.spool]", ", line 1: sensors: unknown output channel 'spool'; did you mean 'spool_position'?"),
        ("[sensors.oil_temperature]", ", line 1: sensors: unknown output channel 'oil_temperature'"),
        ("[sensors]\nspool_position = '1 um'", ", line 2: sensors.spool_position: expected a table"),
        ("[sensors.spool_position]\nnoize = '1 um'",
         ", line 2: sensors.spool_position: unknown key 'noize'; did you mean 'noise'?"),
        ("[sensors.spool_position]\nnoise = '1 bar'",
         ", line 2: sensors.spool_position.noise: 'bar' has the wrong dimension"),
        ("[sensors.spool_position]\nnoise = '0 um'", ", line 2: sensors.spool_position.noise: '0 um' must be positive"),
        ("[sensors.spool_position]\nlag = '-1 ms'",
         ", line 2: sensors.spool_position.lag: '-1 ms' must not be negative"),
        ("[sensors.spool_position]\nrange = '1 mm'",
         ", line 2: sensors.spool_position.range: expected [lowest, highest]"),
        ("[sensors.spool_position]\nrange = ['1 mm']",
         ", line 2: sensors.spool_position.range: expected [lowest, highest]"),
        ("[sensors.spool_position]\nrange = ['1 mm', '-1 mm']",
         ", line 2: sensors.spool_position.range: '1 mm' must be below '-1 mm'"),
        ("[sensors.load_flow]\nnoise = '1 L/min'",
         ", line 1: sensors.load_flow: no record has this output channel; they have spool_position"),
        ("[sensors.current]\nnoise = '1 mA'", ", line 1: sensors.current: no record has this output channel"),
        ("records = 'a.csv'", ", line 1: records: expected [[records]], one for each file"),
        ("records = []", ", line 1: records: the list is empty"),
        ("\n[[records]]\nfile = 'a.csv'\n\n[[records]]\nfle = 'a.csv'",
         ", line 6: records.2: unknown key 'fle'; did you mean 'file'?"),
        ("[[records]]\nrole = 'train'", ", line 1: records.1.file: expected the name of a CSV file, got None"),
        ("[[records]]\nfile = 'aa.csv'",
         ", line 2: records.1.file: 'aa.csv' is not in the folder; did you mean 'a.csv'?"),
        (listed("a", "a"), ", line 4: records.2.file: 'a.csv' is listed twice"),
        ("[[records]]\nfile = 'a.csv'\n[[records]]\nfile = './a.csv'",
         ", line 4: records.2.file: './a.csv' and 'a.csv' are both called 'a'"),
        (listed("a", role="tst"), ", line 3: records.1.role: unknown role 'tst'; did you mean 'test'?"),
        (listed("a", role=1), ", line 3: records.1.role: unknown role '1'"),
        (listed("a", repeats=1), ", line 3: records.1.repeats: expected a label in quotes, got 1"),
    ],
)  # fmt: skip
def test_a_key_that_makes_no_sense_is_refused_with_its_line(session, tmp_path, toml, message):
    told = refused(session, toml)
    assert told.startswith(str(tmp_path / "session.toml")) and message in told


def test_a_folder_without_records_is_refused(tmp_path):
    (tmp_path / "session.toml").touch()
    told = refused(load_session, tmp_path)
    assert told.endswith("session.toml: no record: the folder holds no CSV file, nor one of another format")


def test_a_session_of_test_records_alone_is_refused(session):
    assert "none is left to learn from" in refused(session, listed("a", role="test"))


# ---------------------------------------------------------------- a user's effects


def test_two_files_with_one_effect_are_refused(session, tmp_path):
    for name in ("one", "two"):
        (tmp_path / f"{name}.py").write_text(EFFECT, encoding="utf-8")
    told = refused(session, "effects_files = ['one.py', 'two.py']")
    assert "line 1: effects_files: 'two.py' declares 'side_load', which another file did already" in told


# ---------------------------------------------------------------- records refused


@pytest.mark.parametrize(
    "changed, message",
    [
        ({SPOOL: None, "spool_positon [mm]": WAVE},
         ", line 1: unknown column 'spool_positon'; did you mean 'spool_position'?"),
        ({"time [s]": None}, ", line 1: no column 'time'"),
        ({CURRENT: None}, ": no column 'current' or 'voltage'"),
        ({SPOOL: None}, ": no output channel; expected one or more of spool_position, "),
        ({SPOOL: None, "spool_position": WAVE}, ", line 1: column 'spool_position' needs a name and a unit"),
        ({SPOOL: None, "spool_position [bar]": WAVE}, ", line 1: column 'spool_position': 'bar' has the wrong dim"),
        ({"current [A]": WAVE}, ", line 1: column 'current' stands there twice"),
        ({SPOOL: np.full(len(TIME), np.nan)}, ": column 'spool_position' has no reading at all"),
        ({CURRENT: np.where((TIME > TIME[8]) & (TIME < TIME[20]), np.nan, WAVE)},
         ", line 11: no reading of current for 11 samples; an input may miss at most 10 in a row"),
        ({CURRENT: 21.0 * WAVE}, ", line 27: current of 21 mA is beyond 2 times the rated 10 mA"),
        ({CURRENT: None, "voltage [V]": 13.0 * WAVE}, "voltage of 13 V is beyond 2 times the rated 6 V"),
        ({"oil_temperature [degC]": 20.0 + 2000.0 * TIME}, "oil_temperature of 402 °C is outside [-100 °C, 400 °C]"),
        ({"supply_pressure [bar]": 210.0 - 2000.0 * TIME}, "supply_pressure of 0 bar is outside"),
        ({"return_pressure [bar]": 0.0 * TIME - 1.0},
         ", line 2: return_pressure of -1 bar is outside [0 bar, 1000 bar]"),
        ({"return_pressure [bar]": 0.0 * TIME + 220.0}, ", line 2: return_pressure of 220 bar leaves no pressure"),
        ({"supply_pressure [bar]": 0.0 * TIME + 3.0}, ", line 2: supply_pressure of 3 bar leaves no pressure"),
        ({"load_pressure [bar]": 2000.0 * TIME}, "load_pressure of 216 bar is beyond the supply pressure"),
    ],
)  # fmt: skip
def test_a_record_that_makes_no_sense_is_refused_with_file_and_line(session, tmp_path, changed, message):
    told = refused(session, a=columns(**changed))
    assert told.startswith(str(tmp_path / "a.csv")) and message in told


DRIFTING = np.concatenate([[0.0], np.cumsum(np.where(np.arange(199) < 100, 0.991e-3, 1.009e-3))])


@pytest.mark.parametrize("content, note", [
    (lambda: replaced(10, ",1,30,0.1"), "1 rows have no time and are left out"),
    (lambda: "\n\n" + replaced(10, None), "1 gaps, 1 samples in all, the longest of 1"),
    (lambda: replaced(10, "0.01005,1,30,0.1"), "times are off an even clock of 0.001 s"),
    (lambda: text(columns(**{"time [s]": DRIFTING})), "times are off an even clock of 0.0009999 s"),
    (lambda: text(columns()) + text(columns()).splitlines()[-1] + "\n", "1 rows stand there twice"),
])  # fmt: skip
def test_times_that_are_nearly_a_clock_are_laid_on_one_and_told(session, content, note):
    loaded = session("", a=content())
    assert any(note in one for one in loaded.notes) and len(loaded.records[0].time) == 200
    assert np.ptp(np.diff(loaded.records[0].time)) < 1e-12


def replaced(row, cells):
    """A good record with another line at a row of data; None takes it out."""
    lines = text(columns()).splitlines()
    lines[row + 1 : row + 2] = [] if cells is None else [cells]
    return "\n".join(lines)


@pytest.mark.parametrize(
    "content, message",
    [
        (replaced(10, "0.010,x,30,0.1"), ", line 12: 'x' in column 'current' is not a number"),
        (replaced(10, "0.010,1,30,0.1,5"), ", line 12: 5 cells under 4 columns"),
        (replaced(10, "0.008,1,30,0.1"), ", line 12: times must rise, but 0.008 s follows 0.009 s"),
        (replaced(10, "0.009,1,30,0.1"), ", line 12: times must rise: two readings at one time, 0.009 s, and none"),
        ("\n".join(text(columns()).splitlines()[:50]), ": 49 samples; a record needs 50 or more"),
        ("time [s],current [mA],spool_position [mm]\n", ": holds no data"),
        ("", ": holds no data"),
        ('"time\n [s]","current [mA]"\n0,1\n', ": 0 rows were read of 1: it is no plain table of columns"),
    ],
)
def test_a_broken_record_is_refused_with_its_line(session, tmp_path, content, message):
    told = refused(session, a=content)
    assert told.startswith(str(tmp_path / "a.csv")) and message in told


@pytest.mark.parametrize("content", [text(columns()).encode() + b"\xff", text(columns()).encode() + b"\0", None])
def test_a_record_that_is_no_text_file_is_refused(tmp_path, content):
    (tmp_path / "session.toml").touch()
    if content is None:
        (tmp_path / "a.csv").mkdir()
    else:
        (tmp_path / "a.csv").write_bytes(content)
    assert refused(load_session, tmp_path).startswith(f"{tmp_path / 'a.csv'}")


def test_records_of_two_drives_are_refused(session):
    told = refused(session, a=columns(), b=columns(**{"voltage [V]": WAVE}))
    assert told == "a is driven by current, b by voltage: a session has one drive"


SHORT = {name: values[:-3] for name, values in columns().items()}


@pytest.mark.parametrize(
    "other, message",
    [
        (SHORT, "lengths differ: 200 and 197 samples"),
        (columns(**{"time [s]": TIME * 1.004}), "clocks disagree: they end at 0.199 s and 0.199796 s"),
        (columns(**{CURRENT: 4.0 * WAVE}), "inputs differ: current by 0.7071 mA rms, more than 5% of 10 mA"),
        (columns(**{"oil_temperature [degC]": 40.0 + 0.0 * TIME}), "inputs differ: oil_temperature by 10 °C rms"),
        (columns(**{"load_pressure [bar]": 10.0 * WAVE}), "columns differ: only one has 'load_pressure'"),
    ],
)
def test_repeats_that_are_none_are_refused(session, other, message):
    told = refused(session, listed("a", "b", repeats="r"), a=columns(), b=other)
    assert told == f"a and b are called repeats 'r', but their {message}" or told.startswith(
        f"a and b are called repeats 'r', but their {message}, more"
    )


def test_repeats_that_end_a_sample_apart_are_cut_to_what_all_have(session):
    shorter = {name: values[:-1] for name, values in columns(3).items()}
    found = session(listed("a", "b", repeats="r"), a=columns(), b=shorter)
    assert [len(record.time) for record in found.records] == [199, 199]
    assert {len(column) for record in found.records for column in record.values.values()} == {199}
    assert any("cut by 1 of 200 samples, to the shortest of the repeats 'r'" in note for note in found.notes)


def test_repeats_may_differ_by_noise_and_in_their_resting_inputs(session):
    noisy = columns(5, **{CURRENT: 5.0 * WAVE + 0.05 * columns(6)[SPOOL], "oil_temperature [degC]": 31.0 + 0.0 * TIME})
    assert len(session(listed("a", "b", repeats="r"), a=columns(), b=noisy).records) == 2
    still, almost = (
        columns(**{CURRENT: offset + 0.0 * TIME, "load_pressure [bar]": 50.0 * WAVE}) for offset in (0.0, 2e-4)
    )
    assert len(session(listed("a", "b", repeats="r"), a=still, b=almost).records) == 2


@pytest.mark.parametrize("still", [0.0 * TIME + 1.0, 0.04 * np.random.default_rng(0).normal(size=200)])
def test_a_record_that_never_moves_is_left_out_and_alone_refused(session, still):
    dead = columns(**{CURRENT: still})
    loaded = session("", a=columns(), b=dead)
    assert [record.name for record in loaded.records] == ["a"]
    assert "b: never moves (no input changes) and is left out" in loaded.notes
    assert "no record is left that moves" in refused(session, listed("b"), b=dead)


@pytest.mark.parametrize(
    "moving",
    [
        {CURRENT: 0.02 * WAVE},  # little, but a signal
        {CURRENT: 0.0 * TIME, "oil_temperature [degC]": 20.0 + 10.0 * TIME},
        {CURRENT: 0.0 * TIME, "load_pressure [bar]": 50.0 * WAVE},
        {CURRENT: np.where(np.arange(200) % 2 == 0, 1.0, -1.0)},  # white, but no noise is as large
    ],
)
def test_a_record_moves_with_any_of_its_inputs(session, moving):
    assert len(session("", a=columns(**moving)).records) == 1


# ---------------------------------------------------------------- what is noted


def test_a_command_beyond_rated_is_noted(session):
    loaded = session("", a=columns(**{CURRENT: -12.0 * WAVE}))
    assert any(re.match(r"a: current of -?12 mA is beyond the rated 10 mA", note) for note in loaded.notes)


def test_noise_on_an_input_at_rest_is_taken_away(session):
    noise = np.random.default_rng(1).normal(size=TIME.size)
    loaded = session("", a=columns(**{"supply_pressure [bar]": 208.0 + 0.3 * noise, "load_pressure [bar]": 50 * WAVE}))
    values = loaded.records[0].values
    assert np.ptp(values["supply_pressure"]) == 0.0
    assert values["supply_pressure"][0] == pytest.approx(1e5 * np.mean(208.0 + 0.3 * noise))
    assert np.ptp(values["load_pressure"]) == pytest.approx(100e5, rel=1e-2)


def test_white_noise_on_an_input_that_moves_is_taken_away_and_told(session):
    noise = np.random.default_rng(1).normal(size=TIME.size)
    load = 50.0 * WAVE + 0.3 * noise
    loaded = session("", a=columns(**{CURRENT: 5.0 * WAVE + 0.02 * noise, "load_pressure [bar]": load}))
    values = loaded.records[0].values
    assert np.std(values["current"] - 5e-3 * WAVE) < 0.7 * 0.02e-3
    assert np.std(values["load_pressure"] - 50e5 * WAVE) < 0.7 * 0.3e5
    told = [note for note in loaded.notes if "white noise" in note]
    assert [note.split(" has ")[0] for note in told] == ["a: current", "a: load_pressure"]


def test_an_excitation_that_is_noise_itself_stays(session):
    noise = 2.0 * np.random.default_rng(1).normal(size=TIME.size)
    loaded = session("", a=columns(**{CURRENT: noise}))
    assert loaded.records[0].values["current"] == pytest.approx(1e-3 * noise)
    assert not any("white noise" in note for note in loaded.notes)


def test_readings_of_repeats_that_differ_by_more_than_noise_are_told(session):
    repeats = listed("a", "b", repeats="sine")
    alike = session(repeats, a=columns(1), b=columns(2))
    assert not any("repeat one test" in note for note in alike.notes)
    other = columns(2)
    apart = session(repeats, a=columns(1), b=other | {SPOOL: 1.05 * other[SPOOL]})
    assert any("a and b repeat one test, but spool_position differs by 0.0" in note for note in apart.notes)


def test_a_load_a_little_beyond_the_supply_is_held_at_it(session):
    loaded = session("", a=columns(**{"load_pressure [bar]": 212.0 * WAVE}))
    record = loaded.records[0]
    assert np.max(record.values["load_pressure"]) == 21e6
    assert "a: load_pressure is a little beyond the supply pressure and held at it" in loaded.notes
    assert record_scenario(loaded, record).load_pressure is not None


def test_a_stuck_channel_is_left_out_with_a_note(session):
    flow = {"load_flow [L/min]": WAVE}
    loaded = session("", a=columns(**flow), b=columns(**{"load_flow [L/min]": 0.0 * TIME + 1.5}))
    assert loaded.records[0].outputs == ("spool_position", "load_flow")
    assert loaded.records[1].outputs == ("spool_position",)
    assert "b: load_flow is stuck at 1.5 L/min while the current moves, and is left out" in loaded.notes


def test_a_channel_that_dies_within_a_record_is_left_out_from_there(session):
    dead = columns()
    dead[SPOOL] = np.where(TIME < 0.15, dead[SPOOL], dead[SPOOL][150])
    loaded = session("", a=dead)
    assert loaded.records[0].usable["spool_position"].tolist() == [True] * 150 + [False] * 50
    told = "a, line 152: spool_position stands at one reading for 50 samples while the current moves; they are left out"
    assert told in loaded.notes


FAST = np.sin(2.0 * np.pi * 40.0 * TIME)
"""A motion that leaves no noise to be seen between its samples."""


@pytest.mark.parametrize("start", [30, 77, 140])
def test_a_reading_that_is_held_for_some_samples_is_left_out_of_a_fast_record(session, start):
    """Fifteen samples of a logger that missed some were an entrained air for sure."""
    noise = 1e-3 * np.random.default_rng(start).normal(size=(2, len(TIME)))
    fast, slow = np.round(0.2 * FAST + noise[0], 6), np.round(0.2 * WAVE + noise[1], 6)
    held = np.where((np.arange(len(TIME)) >= start) & (np.arange(len(TIME)) < start + 9), fast[start], fast)
    loaded = session("", a=columns(**{CURRENT: FAST, SPOOL: held}), b=columns(**{SPOOL: slow}))
    usable = loaded.records[0].usable["spool_position"]
    assert np.flatnonzero(~usable).tolist() == list(range(start, start + 9))
    assert loaded.records[1].usable["spool_position"].all()


def test_a_reading_that_is_held_is_left_out_beside_crests_that_are_cut_off(session):
    """Fifteen held readings of a chirp whose crests were saturated made an erosion of the nozzles `unknown`."""
    noise = 1e-3 * np.random.default_rng(1).normal(size=(2, len(TIME)))
    chirp = np.sin(2.0 * np.pi * (80.0 + 50.0 * TIME) * TIME)
    fast, slow = (np.minimum(np.round(one, 6), 0.09) for one in (0.2 * chirp + noise[0], 0.2 * WAVE + noise[1]))
    held = np.where((np.arange(len(TIME)) >= 127) & (np.arange(len(TIME)) < 142), fast[127], fast)
    assert held[127] < 0.09 and 0.15 < np.mean(np.diff(fast) == 0.0) < 0.4
    loaded = session("", a=columns(**{CURRENT: chirp, SPOOL: held}), b=columns(**{SPOOL: slow}))
    usable = loaded.records[0].usable["spool_position"]
    held_at = (np.arange(len(TIME)) >= 127) & (np.arange(len(TIME)) < 142)
    assert np.array_equal(usable, (held < 0.09) & ~held_at)


def test_a_spool_that_sticks_and_starts_slowly_stays_where_no_channel_shows_noise(session):
    since = np.mod(TIME, 0.05) - 0.02  # stands for 20 ms, starts, and moves on to another place
    stuck = 0.2 * np.cumsum(np.where(since > 0.0, since * np.cos(17.0 * np.pi * TIME), 0.0))
    assert session("", a=columns(**{CURRENT: FAST, SPOOL: stuck})).records[0].usable["spool_position"].all()
    missed = np.where((TIME >= 0.1) & (TIME < 0.108), 0.2 * FAST[100], 0.2 * FAST)
    usable = session("", a=columns(**{CURRENT: FAST, SPOOL: missed})).records[0].usable["spool_position"]
    assert np.flatnonzero(~usable).tolist() == list(range(100, 108))


def test_a_channel_without_noise_that_stands_once_while_the_command_goes_far_is_held(session):
    """Twenty held readings of a pilot pressure under a sine made a spool lap `unknown` after 369 s."""
    turning = np.sin(2.0 * np.pi * 90.0 * TIME)
    held = np.where((np.arange(len(TIME)) >= 60) & (np.arange(len(TIME)) < 75), 0.2 * turning[60], 0.2 * turning)
    usable = session("", a=columns(**{CURRENT: turning, SPOOL: held})).records[0].usable["spool_position"]
    assert np.flatnonzero(~usable).tolist() == list(range(60, 75))
    for command in (turning, np.sin(2.0 * np.pi * 20.0 * TIME)):  # what sticks does so in each turn
        sticking, at = np.empty(len(TIME)), 0.0
        for k, asked in enumerate(command):
            at = asked - np.clip(asked - at, -0.3, 0.3)
            sticking[k] = 0.2 * at
        for stopped in (sticking, np.minimum(0.2 * command, 0.1)):
            (record,) = session("", a=columns(**{CURRENT: command, SPOOL: stopped})).records
            assert record.usable["spool_position"][stopped < np.max(stopped)].all()


def test_a_coarse_channel_that_stands_still_stays(session):
    coarse = columns(**{SPOOL: 0.2 * np.round(2.0 * WAVE)})
    assert session("", a=coarse).records[0].usable["spool_position"].all()


def test_a_record_whose_channels_are_all_stuck_is_left_out(session):
    stuck = columns(**{SPOOL: 0.0 * TIME})
    loaded = session("", a=columns(), b=stuck)
    assert [record.name for record in loaded.records] == ["a"]
    assert "b: has no output channel left and is left out" in loaded.notes
    told = refused(session, listed("b"), b=stuck)
    assert (
        "no record is left that moves and has a usable output channel" in told and "b: spool_position is stuck" in told
    )


def test_a_channel_at_rest_under_a_resting_command_is_not_stuck(session):
    still = {CURRENT: 0.0 * TIME, "load_pressure [bar]": 50.0 * WAVE, SPOOL: 0.0 * TIME + 0.01}
    assert session("", a=columns(**still)).records[0].outputs == ("spool_position",)


def test_a_channel_that_stops_at_one_reading_under_different_steps_is_saturated_and_so_in_all_records(session):
    levels = np.repeat(np.resize([0.1, 0.9, 0.4, 0.75, -0.8], len(TIME) // 50 + 1), 50)[: len(TIME)]
    noise = 1e-3 * np.random.default_rng(0).normal(size=(2, len(TIME)))
    first, other = (np.minimum(0.2 * wave, 0.13) for wave in (levels + noise[0], WAVE + noise[1]))
    loaded = session("", a=columns(**{CURRENT: levels, SPOOL: first}), b=columns(**{SPOOL: other}))
    for record, values in zip(loaded.records, (first, other), strict=True):
        assert np.array_equal(record.usable["spool_position"], values < 0.13)


def test_a_channel_that_stops_under_one_level_alone_may_stand_at_a_stop(session):
    levels = np.repeat([0.9, 0.1, 0.9, 0.4], 50)
    stopped = np.where(levels > 0.8, 0.13, 0.2 * levels) + 0.0 * TIME
    loaded = session("", a=columns(**{CURRENT: levels, SPOOL: stopped}))
    assert loaded.records[0].usable["spool_position"].all()


@pytest.mark.parametrize("top, saturated", [(0.13, True), (1.0, False)])
def test_crests_that_are_cut_for_a_few_samples_each_are_saturated(session, top, saturated):
    fast = np.sin(2.0 * np.pi * 11.0 * TIME / TIME[-1])  # a dozen samples to a turn
    read = np.round(np.minimum(0.2 * fast, top) / 1e-3) * 1e-3
    loaded = session("[sensors.spool_position]\nresolution = '1 um'", a=columns(**{CURRENT: fast, SPOOL: read}))
    assert np.array_equal(loaded.records[0].usable["spool_position"], read < (top - 5e-4 if saturated else 1.0))


@pytest.mark.parametrize("peaks, saturated", [((0.2, 0.18, 0.16, 0.19), True), ((0.2, 0.18, 0.16), False)])
def test_peaks_of_steps_that_end_alike_are_saturated(session, peaks, saturated):
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(TIME))
    read = 0.02 * WAVE + noise
    read[20 + 30 * np.arange(len(peaks))] = peaks
    read = np.minimum(read, 0.13)
    loaded = session("", a=columns(**{SPOOL: read}))
    assert np.array_equal(loaded.records[0].usable["spool_position"], (read < 0.13) | (not saturated))


def test_peaks_of_one_step_repeated_without_noise_are_not_saturated(session):
    step, k = np.where(np.arange(len(TIME)) // 40 % 2 == 0, 1.0, -1.0), np.arange(len(TIME)) % 40
    overshooting = 0.2 * step * (1.0 + 0.4 * np.exp(-k / 3.0) * np.sin(k / 2.0))
    step, overshooting = np.tile(step[:80], 5)[: len(TIME)], np.tile(overshooting[:80], 5)[: len(TIME)]
    alike = {name: columns(**{CURRENT: step, SPOOL: overshooting}) for name in "abc"}
    for record in session("", **alike).records:
        assert record.usable["spool_position"].all()


@pytest.mark.parametrize("noise, top, saturated", [(1e-3, 0.226, True), (1e-3, 1.0, False), (0.0, 0.226, False)])
def test_peaks_of_one_step_that_end_alike_though_the_channel_has_noise_are_saturated(session, noise, top, saturated):
    """An armature's angle at 30 bar, cut in two overshoots of three samples each, had a healthy valve `unknown`."""
    k = np.arange(len(TIME)) % 80
    step = np.where(k < 40, 1.0, -1.0)
    overshooting = 0.2 * step * (1.0 + 0.3 * np.exp(-np.mod(k, 40) / 4.0) * np.sin(np.mod(k, 40) / 2.0))
    scatter = noise * np.random.default_rng(5).normal(size=len(TIME))
    read = np.minimum(np.round((overshooting + scatter) / 2e-4) * 2e-4, top)
    (record,) = session("", a=columns(**{CURRENT: step, SPOOL: read})).records
    assert np.array_equal(record.usable["spool_position"], (read < top) | (not saturated))
    assert not saturated or 4 <= np.count_nonzero(read >= top) < 10


def plateaus(noise, grid):
    """Levels of a step record, each with a sensor's noise on its grid, and the highest of them cut off."""
    levels = np.repeat([0.9, 0.1, 0.965, 0.4], len(TIME) // 4)
    read = 0.2 * levels + noise * np.random.default_rng(3).normal(size=len(levels))
    return levels, np.minimum(np.round(read / grid) * grid, 0.186)


@pytest.mark.parametrize("noise", [2e-3, 2e-4])
def test_a_plateau_without_the_noise_of_the_others_is_saturated(session, noise):
    levels, read = plateaus(noise, 5e-4)
    (record,) = session("", a=columns(**{CURRENT: levels, SPOOL: read})).records
    assert np.array_equal(record.usable["spool_position"], read < 0.186)
    assert 0.2 < np.mean(read >= 0.186) < 0.5


@pytest.mark.parametrize("noise, grid", [(0.0, 5e-4), (5e-5, 5e-4), (2e-6, 1e-7)])
def test_a_plateau_where_the_others_show_no_noise_either_is_not_told_to_be_saturated(session, noise, grid):
    levels, read = plateaus(noise, grid)
    (record,) = session("", a=columns(**{CURRENT: levels, SPOOL: read})).records
    assert record.usable["spool_position"].all()


@pytest.mark.parametrize(
    "noise, top, saturated",
    [(1.0, 0.18, True), (0.6, 0.18, True), (1.0, 1.0, False), (0.0, 0.18, False), (0.2, 1.0, False)],
)
def test_a_plateau_whose_noise_would_be_of_the_sensors_resolution_is_saturated(session, noise, top, saturated):
    levels, grid = np.repeat([0.5, 0.1, 0.965, 0.4, -0.3, 0.2], len(TIME) // 6 + 1)[: len(TIME)], 5e-4
    read = 0.2 * levels + noise * grid * np.random.default_rng(3).normal(size=len(levels))
    read = np.minimum(np.round(read / grid) * grid, top)
    (record,) = session("", a=columns(**{CURRENT: levels, SPOOL: read})).records
    assert np.array_equal(record.usable["spool_position"], (read < top) | (not saturated))


@pytest.mark.parametrize("noise, saturated", [(1.0, True), (0.6, True), (0.2, False)])
def test_a_plateau_longer_than_all_other_rests_is_saturated_by_the_noise_of_these(session, noise, saturated):
    """A load flow cut off once in a record, for 189 samples, had a lap told as `unknown`."""
    grid, dice = 5e-4, np.random.default_rng(4)
    records = {}
    for name, levels in {"a": [0.965, 0.1], "b": [0.4, -0.3, 0.2]}.items():
        steps = np.repeat(levels, len(TIME) // len(levels) + 1)[: len(TIME)]
        read = 0.2 * steps + noise * grid * dice.normal(size=len(steps))
        records[name] = columns(**{CURRENT: steps, SPOOL: np.minimum(np.round(read / grid) * grid, 0.18)})
    for record in session("", **records).records:
        values = records[record.name][SPOOL]
        assert np.array_equal(record.usable["spool_position"], (values < 0.18) | (not saturated))


def test_levels_that_a_coarse_sensor_rounds_alike_are_no_flat_top(session):
    levels = np.repeat([0.9, 0.1, 0.965, 0.4], 50)
    coarse = np.round(0.2 * levels / 0.03) * 0.03
    loaded = session("[sensors.spool_position]\nresolution = '30 um'", a=columns(**{CURRENT: levels, SPOOL: coarse}))
    assert loaded.records[0].usable["spool_position"].all()


RANGE = "[sensors.spool_position]\nresolution = '10 um'\nrange = ['-0.15 mm', '0.3 mm']"


def test_samples_at_the_ends_of_the_range_are_not_usable(session):
    loaded = session(RANGE, a=columns(**{SPOOL: np.where(0.2 * WAVE > -0.145, 0.2 * WAVE, -0.146 - 1e-5 * TIME)}))
    usable = loaded.records[0].usable["spool_position"]
    assert np.array_equal(usable, 0.2 * WAVE > -0.145)
    share = 1.0 - np.mean(usable)
    assert f"a: spool_position is saturated in {share:.2%} of the samples" in loaded.notes and 0.1 < share < 0.4


def test_a_channel_less_than_half_usable_is_left_out(session):
    spool = np.clip(0.9 * WAVE, -0.15, 0.3)
    loaded = session(RANGE, a=columns(**{SPOOL: spool, "load_flow [L/min]": WAVE}))
    assert loaded.records[0].outputs == ("load_flow",)
    assert any(
        re.fullmatch(r"a: spool_position is saturated in \S+ of the samples and is left out", n) for n in loaded.notes
    )


@pytest.mark.parametrize(
    "channel, sign", [("spool_position [mm]", 1.0), ("nozzle_pressure_2 [bar]", -1.0), ("armature_angle [mrad]", 1.0)]
)
def test_a_flat_top_is_not_usable(session, channel, sign):
    smooth = 100.0 + 0.2 * sign * WAVE + 1e-4 * columns()[SPOOL]
    clipped = np.clip(smooth, None, 100.1)
    loaded = session("", a=columns(**{SPOOL: None, channel: clipped}))
    (usable,) = loaded.records[0].usable.values()
    assert np.array_equal(usable, smooth < 100.1)


def lagged(command, lag=5e-3):
    """A first-order lag, as a valve that settles."""
    share, out = 1e-3 / lag, np.zeros_like(command)
    for k in range(1, len(command)):
        out[k] = out[k - 1] + share * (command[k] - out[k - 1])
    return out


STEP, RAMP = np.where(TIME < 0.05, 0.0, 5.0), 5.0 * (1.0 - np.abs(TIME / 0.1 - 1.0))
SLOW = 5.0 * np.sin(2 * np.pi * 5.0 * TIME)


def with_friction(command, band):
    """What stays behind the command by a band, as with dry friction: flat where the command turns."""
    out = np.zeros_like(command)
    for k in range(1, len(command)):
        out[k] = min(max(out[k - 1], command[k] - band), command[k] + band)
    return out


@pytest.mark.parametrize(
    "command, spool",
    [
        (STEP, np.round(lagged(STEP) * 0.04, 3)),  # settles without noise
        (STEP, np.roll(np.round(lagged(STEP) * 0.04, 3), 2)),  # and with a delay
        (RAMP, with_friction(RAMP, 0.5) * 0.04),  # stays where the command turns
        (5.0 * WAVE, np.round(0.2 * WAVE, 2)),  # a coarse sensor at the crest of a sine
        (5.0 * WAVE, 0.2 * WAVE),  # no noise at all
        (SLOW, 0.04 * np.minimum(SLOW, 4.85)),  # too little is cut off to tell
    ],
)
def test_rest_friction_and_a_coarse_sensor_are_no_flat_top(session, command, spool):
    loaded = session("", a=columns(**{CURRENT: command, SPOOL: spool}))
    assert loaded.records[0].usable["spool_position"].all()


def test_a_flat_leakage_is_no_flat_top(session):
    leakage = np.maximum(1.0 - np.abs(WAVE), 0.3)
    loaded = session("", a=columns(**{"internal_leakage [L/min]": leakage}))
    assert loaded.records[0].usable["internal_leakage"].all()


def test_the_resolution_is_found_in_the_data(session):
    spool = np.round(columns()[SPOOL] / 0.004) * 0.004
    loaded = session(
        "[sensors.spool_position]\nnoise = '1 um'", a=columns(**{SPOOL: spool}), b=columns(**{SPOOL: spool})
    )
    assert loaded.sensors["spool_position"].resolution == pytest.approx(4e-6, rel=1e-9)
    assert loaded.sensors["spool_position"].noise == pytest.approx(1e-6)
    assert "spool_position: readings sit on a grid of 0.004 mm, taken as the resolution" in loaded.notes
    stated = session("[sensors.spool_position]\nresolution = '3 um'", a=columns(**{SPOOL: spool}))
    assert stated.sensors["spool_position"].resolution == pytest.approx(3e-6)


def test_the_grid_of_a_converter_is_found_through_the_rounding_of_the_file(session):
    spool = np.round(np.round(columns()[SPOOL] / 0.0123456) * 0.0123456, 4)
    assert session("", a=columns(**{SPOOL: spool})).sensors["spool_position"].resolution == pytest.approx(
        0.0123456e-3, rel=1e-3
    )


def test_levels_at_odd_distances_are_no_grid(session):
    spool = np.array([0.0, 0.05, 0.12, 0.165, 0.3])[np.arange(200) % 5]
    assert session("", a=columns(**{SPOOL: spool})).sensors["spool_position"].resolution == 0.0


@pytest.mark.parametrize("digits", [7, 12])
def test_the_digits_of_the_file_are_no_resolution(session, digits):
    assert (
        session("", a=columns(**{SPOOL: np.round(columns()[SPOOL], digits)})).sensors["spool_position"].resolution
        == 0.0
    )


# ---------------------------------------------------------------- what is locked away


MANY = {name: columns(k) for k, name in enumerate("abcdefgh")}


def test_a_quarter_of_the_tests_is_locked_away_by_the_seed(session):
    draws = {tuple(r.name for r in session(f"seed = {seed}", **MANY).locked) for seed in range(6)}
    assert all(len(draw) == 2 for draw in draws) and len(draws) > 1
    loaded, again = session("seed = 3", **MANY), session("seed = 3", **MANY)
    assert [r.name for r in loaded.locked] == [r.name for r in again.locked]
    assert {r.name for r in loaded.training} | {r.name for r in loaded.locked} == set(MANY)
    names = ", ".join(record.name for record in loaded.locked)
    assert f"locked away until the end (drawn with seed 3): {names}" in loaded.notes
    assert "no test was repeated: the noise is unverified" in loaded.notes


def test_the_order_of_the_list_does_not_change_what_is_locked(session):
    one = session(listed(*MANY), **MANY)
    other = session(listed(*reversed(MANY)), **MANY)
    assert {r.name for r in one.locked} == {r.name for r in other.locked}


@pytest.mark.parametrize("seed", range(5))
def test_repeats_stay_together_and_the_only_repeats_stay_in_training(session, seed):
    only = session(f"seed = {seed}\n" + listed("a", "b", repeats="r") + listed("c", "d"), **MANY)
    assert len(only.locked) == 1 and only.locked[0].name in "cd"
    assert not any("unverified" in note for note in only.notes)
    pairs = session(f"seed = {seed}\n" + "".join(listed(*pair, repeats=pair) for pair in ("ab", "cd", "ef")), **MANY)
    assert len(pairs.locked) == 2 and len({record.repeats for record in pairs.locked}) == 1


def test_where_roles_are_given_nothing_else_is_locked(session):
    loaded = session(listed("a", role="test") + listed(*"bcdefgh"), **MANY)
    assert [record.name for record in loaded.locked] == ["a"]


def test_repeats_on_both_sides_are_noted(session):
    loaded = session(listed("a", role="test", repeats="r") + listed("b", repeats="r"), **MANY)
    assert "repeats 'r': some are locked away and others not; they tell of the same test" in loaded.notes


@pytest.mark.parametrize(
    "files, note",
    [
        (listed("a"), "one record only: no record can be locked away, so the gain cannot be claimed"),
        (listed("a", "b"), "fewer than three different tests: none is locked away, so the gain cannot be claimed"),
        (
            listed("a", "b", repeats="r"),
            "fewer than three different tests: none is locked away, so the gain cannot be claimed",
        ),
    ],
)
def test_too_few_records_lock_none_and_say_what_cannot_be_claimed(session, files, note):
    loaded = session(files, **MANY)
    assert loaded.locked == () and note in loaded.notes


# ---------------------------------------------------------------- the scenario of a record


def test_the_scenario_of_a_record_is_driven_by_what_was_measured(session):
    more = {"supply_pressure [bar]": 200.0 + 0.0 * TIME, "load_pressure [bar]": 30.0 * WAVE}
    loaded = session("[thermal]\nisothermal = true", a=columns(**more))
    (record,) = loaded.records
    scenario = record_scenario(loaded, record)
    assert evaluate(scenario.command, TIME) == pytest.approx(5e-3 * WAVE, abs=1e-12)
    assert evaluate(scenario.load_pressure, TIME) == pytest.approx(3e6 * WAVE, abs=1e-3)
    assert scenario.supply_pressure == Constant(value=20e6) and scenario.return_pressure is None
    assert scenario.oil_temperature == Constant(value=30.0)
    assert scenario.thermal == loaded.thermal and scenario.valve == loaded.valve and scenario.oil == loaded.oil
    assert scenario.tolerance == 1e-5 and scenario.drive == CurrentDrive() and scenario.effects == ()


def test_valve_effects_and_tolerance_of_a_scenario_can_be_others(session):
    loaded = session("[effects.spool_coulomb_friction]\nfriction_force = '2 N'")
    (record,) = loaded.records
    assert record_scenario(loaded, record).effects == loaded.effects
    valve = dataclasses.replace(loaded.valve, null_gap=0.03e-3)
    air = (CATALOGUE["entrained_air"](air_fraction=0.01),)
    scenario = record_scenario(loaded, record, valve=valve, effects=air, tolerance=1e-4)
    assert scenario.valve == valve and scenario.effects == air and scenario.tolerance == 1e-4
    assert record_scenario(loaded, record, effects=()).effects == ()


@pytest.mark.parametrize("voltage", [False, True])
def test_a_simulated_record_has_the_times_and_channels_of_the_measured_one(session, voltage):
    drive = {"voltage [V]": 3.0 * WAVE} if voltage else {}
    loaded = session("", a=columns(**{"time [s]": TIME * 0.993 + 4.0}, **drive))
    (record,) = loaded.records
    result = simulate(record_scenario(loaded, record, tolerance=1e-3))
    assert result.time == pytest.approx(record.time, abs=1e-9)
    assert set(record.outputs) <= set(result.values)
    assert np.corrcoef(result.values["spool_position"], record.values["spool_position"])[0, 1] > 0.9


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_ramp_of_oil_temperature_becomes_few_points(session, noise):
    time = np.arange(5000) / 1e3
    oil = 20.0 + 10.0 * np.clip(time - 1.0, 0.0, 3.0) + noise * np.random.default_rng(0).normal(size=time.size)
    wave = np.sin(20 * time)
    table = {"time [s]": time, CURRENT: 5 * wave, "oil_temperature [degC]": oil, SPOOL: 0.2 * wave}
    loaded = session("", a=table)
    command = record_scenario(loaded, loaded.records[0]).oil_temperature
    assert isinstance(command, Table) and len(command.times) < 20
    truth = 20.0 + 10.0 * np.clip(time - 1.0, 0.0, 3.0)
    assert np.max(np.abs(evaluate(command, time) - truth)) < 0.15 + noise


def test_a_curved_oil_temperature_is_followed(session):
    oil = 30.0 + 5.0 * np.sin(2 * np.pi * 5.0 * TIME)
    loaded = session("", a=columns(**{"oil_temperature [degC]": oil}))
    command = record_scenario(loaded, loaded.records[0]).oil_temperature
    assert np.max(np.abs(evaluate(command, TIME) - oil)) < 0.2


def test_a_record_can_be_made_by_hand():
    record = Record("r", TIME, {"current": WAVE, "spool_position": WAVE}, {"spool_position": WAVE > 0})
    assert record.test == "r" and record.moves() and record.moves("current") and record.role == "train"


def test_records_of_nearly_one_rate_have_one_pace():
    time = np.arange(101.0)
    records = [Record(name="a", time=time / rate, values={}, usable={}) for rate in (5.0368005, 5.0368002, 5.2)]
    assert [record.pace for record in records] == [5.037, 5.037, 5.2]
