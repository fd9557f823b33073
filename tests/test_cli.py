"""The command line as a user or a script meets it: tables, files, exit codes and one line for every error."""

import csv
import io
import json
import multiprocessing
import subprocess
import sys
from datetime import date
from importlib import import_module

import numpy as np
import pytest

import valvesim as vs
from valvesim.cli import main as cli
from valvesim.cli.drawing_processes import drawing_processes
from valvesim.units import quantities
from valvesim.valve.thermal_network import ThermalNetwork

SCENARIO = """\
title = "Small"
duration = "20 ms"
[thermal]
isothermal = true
[command.current]
step = { before = "0 mA", after = "5 mA", time = "5 ms" }
[outputs]
rate = "10 kHz"
"""
# model.md 5: at 20 °C and 1 mA; at 270 °C -1.429 % and +2.296 %
ANGLE, SPOOL = 5.0416154e-5, 3.9378931e-5
KEYS = [
    "current_A", "oil_temperature_degC", "armature_angle_rad", "spool_position_m", "pilot_differential_pressure_Pa",
]  # fmt: skip


@pytest.fixture
def case(tmp_path):
    """A small scenario file."""
    path = tmp_path / "small.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


@pytest.fixture
def refused(call):
    """The one line with which a command line is refused."""

    def refused(*words, code=2):
        found, out, err = call(*words)
        assert (found, out) == (code, "")
        assert err.startswith("error: ") and err.endswith("\n") and err.count("\n") == 1
        return err.removeprefix("error: ").rstrip("\n")

    return refused


# --- static ----------------------------------------------------------------------------------------------------------


def static(call, *words):
    code, out, _ = call("static", "--format", "json", *words)
    assert code == 0
    return json.loads(out)


def test_static_gives_the_figures_of_an_independent_program(call):
    (row,) = static(call, "--current", "1 mA", "--oil-temperature", "20 degC")
    assert list(row) == KEYS
    assert row["current_A"] == 1e-3 and row["oil_temperature_degC"] == 20.0
    assert row["armature_angle_rad"] == pytest.approx(ANGLE, rel=1e-7)
    assert row["spool_position_m"] == pytest.approx(SPOOL, rel=1e-7)


def test_static_drifts_as_published_at_270_degrees(call):
    cold, warm, hot = static(call, "--current", "1 mA", "--oil-temperature", "20,100,270 degC")
    assert [row["oil_temperature_degC"] for row in (cold, warm, hot)] == [20.0, 100.0, 270.0]
    assert hot["armature_angle_rad"] / cold["armature_angle_rad"] - 1 == pytest.approx(-0.01429, abs=6e-6)
    assert hot["spool_position_m"] / cold["spool_position_m"] - 1 == pytest.approx(0.02296, abs=6e-6)
    rest = vs.static_solution(vs.Valve(), current=1e-3, temperature=100.0)
    assert warm["spool_position_m"] == pytest.approx(float(rest.spool_position), rel=1e-12)
    assert warm["pilot_differential_pressure_Pa"] == pytest.approx(float(rest.pilot_differential_pressure), rel=1e-12)


def test_static_gives_every_current_at_every_temperature(call):
    rows = static(call, "--current", "-1, 0, 1 mA", "--oil-temperature", "20, 100 degC")
    assert [(row["current_A"], row["oil_temperature_degC"]) for row in rows] == [
        (i, t) for i in (-1e-3, 0.0, 1e-3) for t in (20.0, 100.0)
    ]
    assert rows[0]["spool_position_m"] == pytest.approx(-rows[4]["spool_position_m"], rel=1e-12)
    assert rows[2]["spool_position_m"] == 0.0


def test_csv_and_json_hold_the_same_figures(call):
    words = ("--current", "1,2 mA", "--oil-temperature", "20,270 degC")
    _, out, _ = call("static", "--format", "csv", *words)
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [{key: float(text) for key, text in row.items()} for row in rows] == static(call, *words)


def test_the_table_shows_the_figures_in_readable_units(call):
    code, out, _ = call("static", "--current", "1 mA", "--oil-temperature", "20 degC")
    figures = [float(word) for word in out.splitlines()[-2].replace("│", " ").split()]
    assert code == 0 and "current [mA]" in out and "spool [mm]" in out and "angle [mrad]" in out
    assert figures[:2] == [1.0, 20.0]
    assert figures[2:4] == pytest.approx([ANGLE * 1e3, SPOOL * 1e3], rel=1e-6)


@pytest.mark.parametrize(
    "routes, angle, spool",  # model.md 5, percent at 270 °C
    [("flow", 0.551, -0.047), ("mmf", -6.065, -6.065), ("rod", 6.737, 6.936), ("", 0.0, 0.0)],
)
def test_routes_let_only_the_named_ones_act(call, routes, angle, spool):
    (row,) = static(call, "--current", "1 mA", "--oil-temperature", "270 degC", "--routes", routes)
    assert 100 * (row["armature_angle_rad"] / ANGLE - 1) == pytest.approx(angle, abs=6e-4)
    assert 100 * (row["spool_position_m"] / SPOOL - 1) == pytest.approx(spool, abs=6e-4)


def test_all_routes_by_name_are_the_default(call):
    words = ("--current", "1 mA", "--oil-temperature", "270 degC")
    assert static(call, *words, "--routes", ", ".join(vs.ROUTES)) == static(call, *words)


def test_static_with_settings_is_another_valve(call):
    words = ("--current", "1 mA", "--oil-temperature", "20 degC", "--set", "valve.null_gap=0.03 mm")
    (row,) = static(call, *words)
    rest = vs.static_solution(vs.Valve(null_gap=30e-6), current=1e-3)
    assert row["armature_angle_rad"] == pytest.approx(float(rest.armature_angle), rel=1e-12)
    assert abs(row["armature_angle_rad"] / ANGLE - 1) > 0.01


@pytest.mark.filterwarnings("always::valvesim.errors.ValidityWarning")
def test_a_warning_is_one_line_on_standard_error_and_the_table_stays_clean(call):
    code, out, err = call("static", "--format", "csv", "--current", "1 mA", "--oil-temperature", "200,270 degC")
    assert code == 0 and err.count("\n") == 1
    assert err.startswith("warning: oil mil_prf_5606: up to 270 °C is above its rated 135 °C")
    assert out.startswith(",".join(KEYS)) and out.count("\n") == 3


@pytest.mark.parametrize(
    "words, message",
    [
        (("--current", "1", "--oil-temperature", "20 degC"), "--current: '1' has no unit"),
        (("--current", "1 bar", "--oil-temperature", "20 degC"), "--current: 'bar' has the wrong dimension"),
        (("--current", "x", "--oil-temperature", "20 degC"), "--current: cannot read 'x' as a number with a unit"),
        (("--current", "", "--oil-temperature", "20 degC"), "--current: cannot read ''"),
        (("--current", "nan mA", "--oil-temperature", "20 degC"), "--current: 'nan mA' is not a finite number"),
        (("--current", "1 mA", "--oil-temperature", "20 mA"), "--oil-temperature: 'mA' has the wrong dimension"),
        (("--current", "1 mA", "--oil-temperature", "-300 degC"), "oil mil_prf_5606: -300 °C is outside -100 to 400"),
        (
            # 3 um of clearance close on a spool that grows by 1e-5/K more than its sleeve, on half of 4.625 mm
            ("--current", "1 mA", "--oil-temperature", "200 degC", "--set", "valve.spool_expansion=22e-6 1/K"),
            "radial clearance closes when the spool reaches 149.7 °C",
        ),
        (
            ("--current", "1 mA", "--oil-temperature", "20 degC", "--routes", "flw"),
            "unknown temperature route 'flw'; did you mean 'flow'?",
        ),
        (
            ("--current", "1 mA", "--oil-temperature", "20 degC", "--set", "valve.nul_gap=1 mm"),
            "valve: unknown parameter of Valve 'nul_gap'; did you mean 'null_gap'?",
        ),
        (("--current", "1 mA", "--oil-temperature", "20 degC", "--set", "valve.null_gap=0 mm"), "valve.null_gap = 0 m"),
        (("--current", "1 mA", "--oil-temperature", "20 degC", "--set", "x"), "--set 'x': expected KEY=VALUE"),
        (("--current", "1 mA"), "Missing option '--oil-temperature'"),
        (("--current", "1 mA", "--oil-temperature", "20 degC", "--format", "yaml"), "'yaml' is not one of"),
        (("--curent", "1 mA"), "No such option"),
    ],
)
def test_wrong_words_for_static_are_refused_in_one_line(refused, words, message):
    assert message in refused("static", *words)


def test_a_static_solution_that_cannot_be_found_exits_with_1(refused):
    weak = ("--set", "valve.spring_tube_stiffness=1 N*m/rad", "--set", "valve.feedback_rod_stiffness=100 N/m")
    message = refused("static", "--current", "1 mA", "--oil-temperature", "20 degC", *weak, code=1)
    assert message.startswith("static solution: no stable null")


# --- run -------------------------------------------------------------------------------------------------------------


def test_run_writes_result_and_pictures_and_names_them(call, case, tmp_path):
    folder = tmp_path / "out"
    code, out, err = call("run", case, "-o", folder)
    assert code == 0 and "Small" in out and "Traceback" not in err
    names = ["characteristic.png", "manifest.json", "result.nc", "run.html", "run.png", "scenario.toml"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert all(f"wrote {folder / name}" in out.replace("\n", "") for name in names if name != "manifest.json")


def test_run_shows_the_figures_of_its_result(call, case, tmp_path):
    _, out, _ = call("run", case, "-o", tmp_path / "out", "--no-pictures")
    table = {}
    for line in out.splitlines():
        cells = [cell.strip() for cell in line.split("│")]
        if len(cells) > 5:
            table[cells[1]] = (cells[2], *map(float, cells[3:6]))
    result = vs.simulate(vs.load_scenario(case))
    x = result.values["spool_position"] * 1e3
    assert table["spool position"][0] == "mm"
    assert table["spool position"][1:] == pytest.approx((x.min(), x.max(), x[-1]), rel=1e-4, abs=1e-12)
    assert table["current"] == ("mA", 0.0, 5.0, 5.0)
    assert table["oil temperature"] == ("°C", 20.0, 20.0, 20.0)


def test_run_writes_what_the_library_gives(call, case, tmp_path):
    import xarray

    assert call("run", case, "-o", tmp_path / "out", "--no-pictures")[0] == 0
    with xarray.open_dataset(tmp_path / "out" / "result.nc") as back:
        assert back.identical(vs.simulate(vs.load_scenario(case)).dataset)


def test_run_writes_only_the_asked_channels(call, case, tmp_path):
    words = ("--set", "outputs.channels=['spool_position', 'current']", "--csv", "--no-pictures")
    assert call("run", case, "-o", tmp_path / "out", *words)[0] == 0
    lines = (tmp_path / "out" / "result.csv").read_text().splitlines()
    assert sorted(lines[0].split(",")) == ["current [mA]", "spool_position [mm]", "time [s]"]
    assert len(lines) == 1 + 201  # 20 ms at 10 kHz, both ends


def test_a_setting_overrides_the_file(call, case, tmp_path):
    assert call("run", case, "-o", tmp_path / "out", "--no-pictures", "--csv", "--set", "duration=1 ms")[0] == 0
    assert len((tmp_path / "out" / "result.csv").read_text().splitlines()) == 1 + 11


def test_a_run_away_from_20_degrees_tells_and_draws_its_drift(call, case, tmp_path):
    words = ("--set", "thermal.oil_temperature=100 degC", "--set", "command.current.step.after=1 mA")
    code, out, _ = call("run", case, "-o", tmp_path / "out", *words)
    assert code == 0 and (tmp_path / "out" / "drift.png").stat().st_size > 10_000
    rest = [vs.static_solution(vs.Valve(), current=1e-3, temperature=each) for each in (20.0, 100.0)]
    angle, spool = (
        100 * float(getattr(rest[1], n) / getattr(rest[0], n) - 1) for n in ("armature_angle", "spool_position")
    )
    assert f"at 1 mA: armature angle {angle:+.2f} %, spool position {spool:+.2f} %" in out.replace("\n", " ")


def test_signs_in_title_and_folder_are_shown_as_they_are(call, case, tmp_path):
    title, folder = r"Step [5 mA] [/x] $\frac{1$", tmp_path / "out[bold]"
    code, out, _ = call("run", case, "-o", folder, "--set", f"title={title}")
    assert code == 0 and title in out
    assert f"wrote {folder / 'run.png'}" in out.replace("\n", "")


def test_results_go_to_a_folder_of_the_scenarios_name(call, case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("run", "small.toml", "--no-pictures")[0] == 0
    assert [path.name for path in (tmp_path / "results" / "small").glob("*.nc")] == ["result.nc"]


@pytest.mark.parametrize(
    "text, words, message",
    [
        (None, (), "none.toml: no such file"),
        ("duration = \n", (), "case.toml: not valid TOML"),
        (
            SCENARIO + '[valve]\nnul_gap = "1 mm"\n',
            (),
            "case.toml, line 10: valve: unknown parameter of Valve 'nul_gap'",
        ),
        (SCENARIO, ("--set", "valve.null_gap=3"), "--set 'valve.null_gap=3': valve.null_gap: 3 has no unit"),
        (SCENARIO, ("--set", "nonsense"), "--set 'nonsense': expected KEY=VALUE"),
        (
            SCENARIO + 'channels = ["spol_position"]\n',
            (),
            "unknown channel 'spol_position'; did you mean 'spool_position'?",
        ),
        (SCENARIO, ("--set", "thermal.oil_temperature=-300 degC"), "-300 °C at t = 0 s is outside -100 to 400"),
        (
            SCENARIO.replace("isothermal = true", 'isothermal = true\noil_temperature = "100 degC"'),
            ("--set", "valve.spool_expansion=6e-5 1/K"),
            "radial clearance closes when the spool reaches",
        ),
        (SCENARIO, ("--sett", "x=1"), "No such option"),
    ],
)
def test_a_wrong_scenario_is_refused_in_one_line_and_leaves_no_file(refused, tmp_path, text, words, message):
    path = tmp_path / ("none.toml" if text is None else "case.toml")
    if text is not None:
        path.write_text(text)
    assert message in refused("run", path, "-o", tmp_path / "out", *words)
    assert not [each for each in tmp_path.rglob("*") if each.is_file() and each != path]


def test_run_needs_a_scenario(refused):
    assert "Missing argument 'SCENARIO'" in refused("run")


@pytest.mark.parametrize("below", ["file", "file/out", "file/out/deep"])
def test_an_output_folder_that_cannot_be_is_refused_before_the_run(refused, case, tmp_path, below, monkeypatch):
    (tmp_path / "file").write_text("kept")
    monkeypatch.setattr("valvesim.solver.codegen.compile_model", None)  # whoever calls it fails otherwise than refused
    message = refused("run", case, "-o", tmp_path / below)
    assert message.startswith(str(tmp_path / below)) and "cannot be written" in message
    assert (tmp_path / "file").read_text() == "kept"


def test_a_run_that_fails_exits_with_1_and_leaves_no_file(refused, case, tmp_path):
    words = (
        "--set",
        "command.current=60 mA",
        "--set",
        "valve.spring_tube_stiffness=1 N*m/rad",
        "--set",
        "valve.feedback_rod_stiffness=100 N/m",
        "--set",
        "valve.rated_current=60 mA",
    )
    message = refused("run", case, "-o", tmp_path / "out", *words, code=1)
    assert message.startswith("static solution: no stable null")
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


def test_an_integration_that_fails_exits_with_1(refused, case, tmp_path, monkeypatch):
    monkeypatch.setattr(import_module("valvesim.simulation.run"), "MAX_STEPS", 2)
    message = refused("run", case, "-o", tmp_path / "out", code=1)
    assert message.startswith("the integration failed at t = ") and "Try a larger" in message


def test_an_interrupted_run_exits_with_130_and_leaves_no_file(call, case, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("valvesim.simulation.result"), "write_atomically", interrupt)
    code, out, err = call("run", case, "-o", tmp_path / "out")
    assert (code, out, err.strip()) == (130, "", "error: interrupted; nothing half-written is left")
    assert [path.name for path in tmp_path.iterdir()] == ["small.toml"]


# --- effects and parameters ------------------------------------------------------------------------------------------


def test_effects_lists_the_whole_catalogue(call):
    code, out, _ = call("effects")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines() if line and not line.startswith(" ")] == list(vs.CATALOGUE)


@pytest.mark.parametrize("name", sorted(vs.CATALOGUE))
def test_an_effect_is_shown_in_full(call, name):
    code, out, _ = call("effects", name)
    shown, entry = " ".join(out.split()), vs.effect(name)
    assert code == 0
    for text in (name, entry.doc, entry.location, entry.signature, *(p.name for p in entry.parameters)):
        assert " ".join(text.split()) in shown
    for p in entry.parameters:
        assert p.doc in shown


def test_an_unknown_effect_is_refused_with_the_nearest(refused):
    assert refused("effects", "backlash") == "unknown effect 'backlash'; did you mean 'feedback_ball_backlash'?"


def test_parameters_lists_every_figure_with_value_unit_range_and_source(call):
    code, out, _ = call("parameters", "--format", "csv")
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(out))}
    declared = {
        f"{where}.{name}": getattr(instance, name)
        for where, instance in (("valve", vs.Valve()), ("oil", vs.MIL_PRF_5606), ("thermal", ThermalNetwork()))
        for name in quantities(instance)
    }
    law = rows.pop("valve.flow_law")
    assert law["value"] == "yan_2019" and "reynolds_number" in law["range"]
    assert code == 0 and list(rows) == list(declared)
    assert [float(row["value"]) for row in rows.values()] == pytest.approx(list(declared.values()), rel=1e-5)
    assert all(row["unit"] and row["range"] and row["meaning"] and row["source"] for row in rows.values())
    assert rows["valve.null_gap"]["range"] == "(0, 0.001]" and rows["valve.null_gap"]["unit"] == "m"
    assert rows["thermal.body_capacity"]["tolerance"] == "±50 %"  # model.md 5


def test_the_parameter_table_names_every_figure(call):
    code, out, _ = call("parameters")
    assert code == 0 and all(f"valve.{name}" in out for name in quantities(vs.Valve()))


# --- the program -----------------------------------------------------------------------------------------------------


def test_the_program_alone_shows_its_help_with_every_command(call):
    code, out, err = call()
    assert (code, err) == (0, "") and out == call("--help")[1]
    rows = out.partition("Simulate:")[2].splitlines()
    named = [line.split()[0] for line in rows if line[:2] == "  " and line[2:3].strip()]
    assert sorted(named) == list(cli.COMMAND_NAMES) and len(set(named)) == len(named)
    assert not any("..." in line for line in rows)


@pytest.mark.parametrize(
    "words, told",
    [
        (("run", "."), ".: cannot be read (it is a folder, not a file; `valvesim scenarios` lists"),
        (("static", "--current", "1 mA", "--oil-temperature", "20 C"), "did you mean 'degC'?"),
        (("bench", "--set", "valve.null_gap=0,03 mm"), "has a decimal comma; write a point, such as '0.03 mm'"),
        (("datasheet", "--set", "valve.supply_pressure=3000 psig"), "pressures are absolute: add 14.696 psi"),
        (("diagnose", __file__), "(Not a directory: "),
    ],
)
def test_what_people_write_wrong_is_answered_with_advice(refused, words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    message = refused(*words)
    assert told in message and "Errno" not in message


def test_an_unknown_command_is_refused_in_one_line(refused):
    assert "no command 'rum'; did you mean 'run'?" in refused("rum")


@pytest.mark.parametrize("words", [(), ("--help",), ("run", "-h"), ("static", "--help"), ("--version",)])
def test_help_and_version_are_shown(call, words):
    code, out, err = call(*words)
    assert (code, err) == (0, "") and ("Usage" in out or "version" in out)


def test_the_program_runs_as_a_module_without_loading_what_it_does_not_need():
    words = [sys.executable, "-X", "importtime", "-m", "valvesim.cli.main"]
    words += ["static", "--current=1 mA", "--oil-temperature=20 degC", "--format=csv"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    header, row = done.stdout.splitlines()
    assert header.split(",") == KEYS
    assert float(row.split(",")[3]) == pytest.approx(SPOOL, rel=1e-7)
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "numpy" in loaded and not loaded & {"matplotlib", "casadi", "numba", "pint", "xarray", "control"}


def test_an_error_of_the_module_is_one_line_without_a_traceback(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "valvesim.cli.main", "run", str(tmp_path / "none.toml")], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    told = "`valvesim scenarios` lists those that come along"
    assert done.stderr == f"error: {tmp_path / 'none.toml'}: no such file; {told}\n"


def test_figures_are_finite_at_every_current_and_temperature_in_use(call):
    rows = static(call, "--current", "-10,-5,-1,-0.1,0,0.1,1,5,10 mA", "--oil-temperature", "-40,20,100,200,270 degC")
    assert len(rows) == 45 and all(np.all(np.isfinite(list(row.values()))) for row in rows)


# --- pictures in processes of their own -------------------------------------------------------------------------------


def test_pictures_that_are_not_waited_for_end_with_the_block(tmp_path):
    with pytest.raises(KeyError, match="what went wrong"), drawing_processes() as draw:
        for name in ("one", "two", "three"):
            draw("write_picture", "no figure", None, tmp_path / f"{name}.png")
        raise KeyError("what went wrong")
    assert not [process for process in multiprocessing.active_children() if process.name.startswith("ForkServer")]
    assert not list(tmp_path.iterdir())


def test_an_error_of_a_picture_reaches_whoever_waits_for_it(tmp_path):
    with drawing_processes() as draw:
        waiting = draw("page_run", *[vs.Scenario()] * 2, date.today(), tmp_path / "none" / "run.html")
        with pytest.raises(AttributeError, match="no attribute 'scenario'"):
            waiting()


def test_the_package_runs_as_the_command_does():
    words = [sys.executable, "-m", "valvesim", "scenarios"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "launch_shock" in done.stdout and not done.stderr
