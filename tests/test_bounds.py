"""Bounds: what is too large, too deep, endless or unprintable is refused in one line, before it is held in memory."""

import os
import tracemalloc

import numpy as np
import pytest

import valvesim as vs
from valvesim.errors import LONGEST_MESSAGE, InputError, one_line
from valvesim.identification.session import UNITS
from valvesim.identification.session_toml import load_session
from valvesim.inputs import MOST_PIECES, Pulse, Scaled, Staircase, Step, Sum, Table, evaluate, read_table
from valvesim.io import DEEPEST, MOST_TEXT, check_file, read_columns, split_heading
from valvesim.measurement.recording import read_recording
from valvesim.simulation.scenario import MOST_OIL_PIECES
from valvesim.simulation.scenario_toml import load_scenario
from valvesim.simulation.temperature_knots import temperature_knots
from valvesim.units import parse, parse_list
from valvesim.valve.effect_files import load_effects

BASE = 'duration = "20 ms"\n[command.current]\nconstant = "1 mA"\n'  # 3 lines; what a test adds starts in line 4
LONG = 'duration = "1e5 s"\n[outputs]\nrate = "1 Hz"\n'


@pytest.fixture
def refused(tmp_path):
    """The message with which a text is refused, of one printable line and in less than 100 MB."""

    def refused(text):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        tracemalloc.start()
        try:
            with pytest.raises(InputError) as caught:
                load_scenario(path)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        message = str(caught.value).replace(f"{tmp_path}/", "")
        assert peak < 100e6 and message.isprintable() and len(message) <= LONGEST_MESSAGE + 100
        return message

    return refused


# --- how much --------------------------------------------------------------------------------------------------------

TOO_MUCH = {
    "samples": (
        'duration = "1e5 s"\n[outputs]\nrate = "1e7 Hz"\n[command.current]\nconstant = "1 mA"\n',
        "case.toml, line 3: outputs.rate: 1e+07 Hz over 100000 s makes more than 2e+07 samples",
    ),
    "pulses": (
        LONG + '[command.current]\npulse = { height = "1 mA", width = "1e-10 s", period = "1e-9 s" }\n',
        "line 5: command.current.pulse.period = 1e-09 s makes 1e+14 pulses within 100000 s, more than 500000",
    ),
    "pulses beside others": (
        LONG + '[command.current]\nconstant = "1 mA"\npulse = { width = "1e-321 s", period = "1e-320 s" }\n',
        "line 6: command.current.pulse.period = 9.99989e-321 s makes inf pulses",
    ),
    "pulses of pressure": (
        LONG + '[command.current]\nconstant = "1 mA"\n[pressures]\n'
        'load = { pulse = { width = "1 us", period = "1 ms" } }\n',
        "line 7: pressures.load.pulse.period = 0.001 s makes 1e+08 pulses",
    ),
    "periods of the oil": (
        LONG + '[command.current]\nconstant = "1 mA"\n[thermal.oil_temperature]\n'
        'sine = { amplitude = "1 K", offset = "20 degC", frequency = "1e5 Hz" }\n',
        "line 6: thermal.oil_temperature: 1e+10 periods within 100000 s are more than 2000",
    ),
    "pieces of the oil": (
        LONG + '[command.current]\nconstant = "1 mA"\n[thermal.oil_temperature]\n'
        'pulse = { base = "20 degC", height = "1 K", width = "0.1 s", period = "1 s" }\n',
        f"line 6: thermal.oil_temperature: 200001 pieces are more than {MOST_OIL_PIECES}",
    ),
    "an effect with states twice": (
        BASE + '[[effects.spool_silting]]\nfriction_force = "1 N"\n[[effects.spool_silting]]\nfriction_force = "2 N"\n',
        "line 4: effects.spool_silting: acts twice; give it once",
    ),
    "an effect 300 times": (
        BASE + '[[effects.sensor_gain]]\nchannel = "load_flow"\ngain_error = 0.01\n' * 300,
        "line 4: effects.sensor_gain: acts more than 8 times on load_flow",
    ),
    "one side twice": (
        BASE + "[[effects.nozzle_erosion]]\nshare = 0.01\nside = 2\n" * 2,
        "line 4: effects.nozzle_erosion: acts twice on side 2; give it once",
    ),
    "terms of a sum": (
        f'duration = "1 s"\n[command.current]\nsum = [{", ".join(["{ constant = 1 }"] * 501)}]\n',
        "case.toml, line 3: command.current.sum: 501 commands are more than 500",
    ),
    "digits": (BASE + f"[valve]\nnull_gap = {'9' * 5000}\n", "not valid TOML: a whole number of thousands of digits"),
    "digits of a hexadecimal": (
        BASE + f"[valve]\nnull_gap = 0x{'f' * 5000}\n",
        "valve.null_gap: a whole number of 20000 bits; 64 are read",
    ),
    "lists in lists": (
        BASE + f"[outputs]\nchannels = {'[' * 900}{']' * 900}\n",
        "not valid TOML: lists or tables nested more",
    ),
    "lists in lists that still parse": (
        BASE + f"[outputs]\nchannels = {'[' * 60}{']' * 60}\n",
        f"outputs: nested more than {DEEPEST} deep",
    ),
    "parts of a key": (BASE + "a." * 3000 + "a = 1\n", f"line 4: a key of more than {DEEPEST} parts"),
    "quoted parts of a key": (BASE + "[" + '"a" . ' * 3000 + "a]\n", f"line 4: a key of more than {DEEPEST} parts"),
    "a text of words": (BASE + f'[valve]\nnull_gap = "{"a" * 40_000}"\n', "line 5: valve.null_gap: cannot read 'aaa"),
    "a text of spaces": (
        BASE + f'[valve]\nnull_gap = "1{" " * 40_000}x"\n',
        "line 5: valve.null_gap: unknown unit 'x'",
    ),
    "a text of digits": (
        BASE + f'[valve]\nnull_gap = "{"1" * 40_000}\\n x"\n',
        "line 5: valve.null_gap: cannot read '111",
    ),
    "a key of words": (BASE + f'[valve]\n{"a" * 40_000} = "1 mm"\n', "valve: unknown parameter of Valve 'aaa"),
    "a file": (BASE + "#" * MOST_TEXT, "case.toml: 0.5001 MB are more than the 0.5 MB that are read"),
}


@pytest.mark.parametrize("text, message", TOO_MUCH.values(), ids=TOO_MUCH.keys())
def test_too_much_is_refused_before_it_is_made(refused, text, message):
    assert message in refused(text)


def test_many_pulses_are_made_and_one_more_than_the_most_is_not():
    train = Pulse(width=0.5, period=1.0, height=1.0)
    assert len(train.pieces(MOST_PIECES / 2 - 1.0)) == MOST_PIECES + 1
    with pytest.raises(InputError, match=r"pulse\.period = 1 s makes 500001 pulses"):
        train.pieces(MOST_PIECES / 2)


def test_a_staircase_and_a_table_of_too_many_points_are_refused(tmp_path):
    assert len(Staircase(steps=1e6, hold=1.0).pieces(10.0)) == 1_000_001
    times = np.arange(MOST_PIECES, dtype=float)
    with pytest.raises(InputError, match="table: 1000000 points are more than 999999"):
        Table(times=tuple(times), values=tuple(times))
    path = tmp_path / "long.csv"
    path.write_bytes(b"time [s],current [A]\n" + b"0,0\n" * MOST_PIECES)
    with pytest.raises(InputError, match=r"long\.csv: 1000000 rows are more than 999999"):
        read_table(path, "current", "A")


def test_an_oil_that_would_take_too_many_knots_is_refused_before_they_are_made():
    hot = vs.Sine(amplitude=20.0, frequency=15.0, offset=60.0)
    told = r"oil_temperature: changes so often .* knots would be needed, more than 500000"
    with pytest.raises(InputError, match=told):
        temperature_knots(vs.Scenario(duration=100.0, oil_temperature=hot))
    mild = vs.Sine(amplitude=20.0, frequency=0.1, offset=60.0)
    assert len(temperature_knots(vs.Scenario(duration=10.0, oil_temperature=mild))[0].times) < 10_000


def test_a_sum_of_too_many_pieces_is_refused():
    trains = tuple(Pulse(width=1e-6 * (k + 1), period=1e-3, height=1.0) for k in range(3))
    with pytest.raises(InputError, match="sum: the commands have more than 2000000 pieces together"):
        Sum(trains).pieces(499.0)


LONG_CELLS = {
    "digits": "9" * 100_000,
    "digits and a letter": "9" * 100_000 + "x",
    "spaces": " " * 100_000 + "x",
    "brackets": "[" * 50_000 + "(" * 50_000,
    "commas of a heading": "a, " * 40_000,
    "slashes": "a / " * 30_000,
}


@pytest.mark.parametrize("cell", LONG_CELLS.values(), ids=LONG_CELLS.keys())
@pytest.mark.parametrize("line", [0, 3])
def test_no_cell_of_a_record_takes_longer_than_its_length(tmp_path, cell, line):
    """A quadratic expression would take minutes here."""
    lines = ["time [s],current [mA],x", *(f"{k}.0,1.0,2.0" for k in range(40))]
    lines[line] = lines[line].rpartition(",")[0] + "," + cell
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines) + "\n")
    try:
        read_recording([path], UNITS)
    except InputError as error:
        assert str(path) in str(error)


@pytest.mark.parametrize(
    "text", ['time [s],current [mA]\n0,1\n1,"2\n2,3\n3,4\n', 'time [s],current [mA]\n0,"1\r2"\n1,2\n2,3\n']
)
def test_a_record_with_quotes_where_none_belong_is_refused(tmp_path, text):
    (tmp_path / "a.csv").write_bytes(text.encode())
    with pytest.raises(InputError, match=r"a\.csv"):
        read_recording([tmp_path / "a.csv"], UNITS)


def test_a_name_that_no_system_can_hold_is_refused(tmp_path):
    (tmp_path / "session.toml").write_text(f"[[records]]\nfile = '{'x' * 5000}'\n")
    with pytest.raises(InputError, match=r"line 2: records\.1\.file: .* is not in the folder"):
        load_session(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        load_scenario("x" * 5000)
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    (tmp_path / "session.toml").write_text("[[records]]\nfile = 'loop.csv'\n")
    with pytest.raises(InputError, match="is not in the folder"):
        load_session(tmp_path)


NAMED = {  # a place where a file gives a name, in a scenario
    "flow law": BASE + "[valve]\nflow_law = %s\n",
    "oil": BASE + "[oil]\nname = %s\n",
    "route": BASE + "[thermal]\nroutes = [%s]\n",
    "effect": BASE + "[[effects]]\nname = %s\n",
    "channel of an effect": BASE + "[[effects.sensor_bias]]\nchannel = %s\n",
    "channel": BASE + "[outputs]\nchannels = [%s]\n",
}


@pytest.mark.parametrize("text", NAMED.values(), ids=NAMED.keys())
def test_what_is_no_name_is_refused_where_a_name_is_expected(refused, text):
    for value in ("{}", "[]", "[1]", "1", "true", "{ a = 1 }", "1979-05-27"):
        refused(text % value)


# --- what is no file -------------------------------------------------------------------------------------------------


def test_devices_pipes_and_folders_are_no_files(tmp_path, refused):
    os.mkfifo(tmp_path / "pipe")
    device = "a pipe or a device"
    for path, kind in (("/dev/zero", device), (tmp_path / "pipe", device), (tmp_path, "a folder")):
        for read in (load_scenario, load_effects, lambda path: read_columns(path, {"time": "s"})):
            with pytest.raises(InputError, match=f"cannot be read .it is {kind}, not a file"):
                read(path)
    table = 'duration = "1 s"\n[command.current]\ntable = { file = "%s" }\n'
    for name in ("pipe", "/dev/zero", "."):
        assert "line 3: command.current.table: " in refused(table % name)
    assert "effects_files: " in refused('effects_files = ["/dev/zero"]\n' + BASE)


def test_a_large_file_is_refused_by_its_size(tmp_path):
    with open(tmp_path / "big", "wb") as file:
        file.truncate(300_000_000)  # sparse
    with pytest.raises(InputError, match="big: 300 MB are more than the 256 MB that are read"):
        read_columns(tmp_path / "big", {"time": "s"})
    with pytest.raises(InputError, match="a\\\\x00b: cannot be read"):
        check_file(tmp_path / "a\0b", 1)


# --- what reaches a terminal -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("escape", ["\\u001b[31mred", "a\\nb", "\\u202eabc", "\\u0007", "a\\tb"])
def test_no_control_character_stands_in_a_title_or_a_message(refused, escape):
    assert refused(f'title = "{escape}"\n{BASE}').startswith(
        "case.toml, line 1: title: holds the control character '\\"
    )
    for text in (
        f'[command.current]\ntable = {{ file = "{escape}.csv" }}\n',
        f'"{escape}" = 1\n',
        f'[valve]\nnull_gap = "{escape}"\n',
    ):
        refused('duration = "1 s"\n' + text)


def test_a_title_is_a_line_of_text(refused):
    assert refused("title = 5\n" + BASE) == "case.toml, line 1: title: expected text, got 5"
    assert "title: 201 characters are more than 200" in refused(f'title = "{"x" * 201}"\n' + BASE)
    assert vs.Scenario(title="Prüfstand 3: 5 µm ± 1 %").title == "Prüfstand 3: 5 µm ± 1 %"


def test_a_message_is_one_printable_line_of_bounded_length():
    assert one_line("a\x1b[1m\nb\u202e é°") == "a\\x1b[1m\\nb\\u202e é°"
    assert len(one_line("x" * 10**6)) == LONGEST_MESSAGE + 5
    assert str(InputError("a\nb")) == "a\\nb"


# --- where it stands -------------------------------------------------------------------------------------------------


def test_a_misspelled_key_is_found_in_its_own_line(refused):
    text = 'duration = "1 s"\nduraton = "2 s"\n[command]\ncurrent = "1 mA"\n'
    assert refused(text).startswith("case.toml, line 2: scenario: unknown key 'duraton'; did you mean 'duration'?")


@pytest.mark.parametrize("heading", ["[comand.current]", "[[comand]]", "[comand.current.sine]"])
def test_a_misspelled_section_is_found(refused, heading):
    assert refused(f'duration = "1 s"\n{heading}\n').startswith("case.toml, line 2: scenario: unknown key 'comand'")


@pytest.mark.parametrize(
    "text, heading",
    [
        ("time [s]", ("time", "s")),
        (" spool position [ mm ] ", ("spool position", "mm")),
        ("time", None),
        ("[s]", None),
        ("time []", None),
        ("time [s] x", None),
        ("a [b] [c]", None),
        ("a ] [s]", None),
        ("a" + " " * 50_000 + "b", None),
    ],
)
def test_a_heading_is_a_name_and_a_unit(text, heading):
    assert split_heading(text) == heading


def test_a_long_list_is_read_at_once_and_as_each_of_its_numbers():
    numbers = np.linspace(-1.0, 1.0, 20_001)
    text = ", ".join(map(repr, numbers.tolist()))
    assert parse_list(f"{text} mA", "A") == pytest.approx(1e-3 * numbers, rel=1e-12, abs=1e-18)
    assert parse_list("20, 68 degF", "delta_degC").tolist() == [
        parse("20 degF", "delta_degC"),
        parse("68 degF", "delta_degC"),
    ]


def test_a_scaled_command_is_its_command_times_the_factor():
    both = Sum((Step(before=1.0, after=2.0, time=0.5), Scaled(vs.Sine(amplitude=1.0, frequency=3.0), 2.0)))
    times = np.linspace(0.0, 1.0, 57)
    assert evaluate(Scaled(both, -3.0), times) == pytest.approx(-3.0 * evaluate(both, times), abs=1e-12)
