"""The package as people get it: scenarios by name, its own papers, a wheel and a source archive that work elsewhere."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import valvesim as vs
from valvesim.cli.main import COMMAND_NAMES
from valvesim.simulation.scenario_files import bundled_scenarios, scenario_file

ROOT = Path(vs.__file__).parents[1]


def test_a_scenario_that_comes_along_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert {"launch_shock", "cold_start", "step", "sine_sweep", "static_map"} <= set(bundled_scenarios())
    assert vs.load_scenario("step") == vs.load_scenario(bundled_scenarios()["step"]) == vs.load_scenario("step.toml")
    for name in bundled_scenarios():
        assert vs.load_scenario(name).title
    with pytest.raises(vs.InputError, match="launch_shok: no such file.*did you mean 'launch_shock'"):
        vs.load_scenario("launch_shok")
    with pytest.raises(vs.InputError, match="no such file"):
        vs.load_scenario("folder/step.toml")
    (tmp_path / "step").write_text("title = 1\n")
    assert scenario_file("step") == Path("step")  # one's own goes first


def test_the_command_lists_and_copies_scenarios(call, tmp_path):
    code, out, _ = call("scenarios")
    assert code == 0 and "Launch temperature shock" in out
    assert call("scenarios", "static_map", "-o", tmp_path / "own.toml")[0] == 0
    assert vs.load_scenario(tmp_path / "own.toml") == vs.load_scenario("static_map")
    for words, told in ((("stp",), "did you mean 'step'"), (("-o", "x.toml"), "needs the NAME")):
        code, _, err = call("scenarios", *words)
        assert code == 2 and told in err and err.count("\n") == 1


def test_a_run_leaves_the_scenario_that_ran_and_says_who_ran_it(call, tmp_path):
    import xarray

    code, *_ = call("run", "step", "-o", tmp_path, "--set", "valve.null_gap=0.03 mm", "--no-pictures", "--set",
                    "outputs.rate=1 kHz")  # fmt: skip
    assert code == 0
    text = (tmp_path / "scenario.toml").read_text(encoding="utf-8")
    assert re.match(rf"# Run by valvesim {re.escape(vs.__version__)} on \d{{4}}-\d\d-\d\d, from step\n", text)
    assert "# with --set valve.null_gap=0.03 mm" in text
    again = vs.load_scenario(tmp_path / "scenario.toml")
    assert again.valve.null_gap == 3e-5 and again.output_rate == 1000.0
    with xarray.open_dataset(tmp_path / "result.nc") as data:
        told = data.attrs
    assert told["source"] == f"valvesim {vs.__version__}" and told["tolerance"] == "5e-05"
    assert told["valve"] == "reference valve with null gap 0.03 mm" and re.fullmatch(r"\d{4}-\d\d-\d\d", told["date"])
    (tmp_path / "of_the_file.toml").write_text(told["scenario"], encoding="utf-8")
    assert vs.load_scenario(tmp_path / "of_the_file.toml") == again


def test_the_papers_of_the_package_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {project['version']}\n" in citation and f"license: {project['license']}" in citation
    assert "BSD 3-Clause" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").startswith("# Changes")
    assert (ROOT / "valvesim" / "py.typed").exists()


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_each_command_has_help_and_an_unknown_option_is_one_line(call, name):
    code, out, _ = call(name, "--help")
    assert code == 0 and out.startswith("Usage: ") and len(out.splitlines()) > 4
    code, _, err = call(name, "--no-such-option")
    assert code == 2 and err.count("\n") == 1 and f"{name} --help tells more" in err


def test_a_misspelled_command_is_told_the_nearest(call):
    code, _, err = call("rum", "step")
    assert code == 2 and err.startswith("error: no command 'rum'; did you mean 'run'? ") and err.count("\n") == 1


def test_the_types_of_the_top_are_those_of_the_names_that_it_gives():
    """The stub, which type checkers read, lists what `valvesim.__getattr__` finds: write the text below to it."""
    renamed: list[str] = []
    lines = ['"""What the package gives, for type checkers: made of `_HOMES` of `__init__.py`, and held equal to it by a test."""', ""]  # fmt: skip  # noqa: E501
    for module, names in vs._HOMES.items():
        for given, _, own in (name.partition(":") for name in names.split()):
            lines.append(f"from valvesim.{module} import {own or given} as {f'_{own}' if own else given}")
            renamed += [f"{given} = _{own}"] if own else []
    text = "\n".join([*lines, "", "__version__: str", *renamed, ""])
    stub = ROOT / "valvesim" / "__init__.pyi"
    assert stub.read_text(encoding="utf-8") == text, text


USER = """
import valvesim as vs

valve: vs.Valve = vs.reference_valve()
result: vs.Result = vs.simulate("step")
rest = vs.static_solution(valve, current=1e-3)
reveal_type(vs.simulate(vs.Scenario(duration=0.1)))
vs.simulate(3.0)
"""


@pytest.mark.slow
def test_the_public_api_is_typed_for_those_outside(tmp_path):
    """mypy on a user's file: a wrong argument is an error there, the right ones are not."""
    pytest.importorskip("mypy", reason="mypy is not installed")
    (tmp_path / "user.py").write_text(USER)
    told = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), "user.py"],
        cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"MYPYPATH": str(ROOT), "PYTHONPATH": str(ROOT)},
    ).stdout  # fmt: skip
    assert 'Revealed type is "valvesim.simulation.result.Result"' in told, told
    assert re.search(r"user.py:8: error: Argument 1 to \"simulate\" has incompatible type", told), told
    assert told.count("error:") == 1, told


@pytest.mark.slow
def test_wheel_and_source_archive_hold_all_that_runs_and_run_elsewhere(tmp_path):
    source, built, place = tmp_path / "source", tmp_path / "built", tmp_path / "place"
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    for name in listed.stdout.split("\n"):
        if name and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    built.mkdir()
    for kind in ("sdist", "wheel"):
        code = f"import setuptools.build_meta as build; build.build_{kind}({str(built)!r})"
        done = subprocess.run([sys.executable, "-c", code], cwd=source, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        if kind == "sdist":  # the wheel is made of what the archive holds
            (archive,) = built.glob("*.tar.gz")
            shutil.unpack_archive(archive, tmp_path)
            source = tmp_path / archive.name.removesuffix(".tar.gz")
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    folders = ("scenarios/*", "valvesim/valve/presets/*", "valvesim/reports/templates/**/*")
    for path in (path for folder in folders for path in ROOT.glob(folder) if path.is_file()):
        inside = path.relative_to(ROOT).as_posix()
        assert inside in names or f"valvesim/{inside}" in names, inside
    assert "valvesim/py.typed" in names and not any(name.startswith(("tests/", "scenarios/")) for name in names)
    zipfile.ZipFile(wheel).extractall(place)
    environment = os.environ | {"PYTHONPATH": str(place), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    code = "import valvesim, sys; sys.argv[0] = 'valvesim'; print(valvesim.__file__); "
    code += "from valvesim.cli.main import main; main()"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for words in (("run", "step", "-o", "out"), ("scenarios",), ("response", "--help")):
        done = subprocess.run(
            [sys.executable, "-P", "-c", code, *words], cwd=elsewhere, capture_output=True, text=True, env=environment
        )
        assert done.returncode == 0 and done.stdout.startswith(str(place)), done.stderr
    left = {path.name for path in (elsewhere / "out").iterdir()}
    assert left >= {"result.nc", "run.html", "run.png", "scenario.toml"}


def test_open_names_the_page_of_a_folder_and_makes_one_of_measured_files(call, tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr("webbrowser.open", lambda address: shown.append(address) or True)
    assert call("run", "step", "-o", tmp_path / "out", "--set", "outputs.rate=2 kHz")[0] == 0
    assert call("open", tmp_path / "out")[:2] == (0, "") and shown == [(tmp_path / "out" / "run.html").as_uri()]
    code, out, _ = call("open", tmp_path / "out", "--no-browser")
    assert (code, out.strip()) == (0, str(tmp_path / "out" / "run.html")) and len(shown) == 1
    record = tmp_path / "bench <1>.csv"
    rows = "".join(f"{k / 100},{k},{2 * k}\n" for k in range(200))
    record.write_text(f"time [s],current [mA],load_flow [L/min]\n{rows}")
    page = tmp_path / "both.html"
    code, out, err = call("open", tmp_path / "out" / "result.nc", record, "-o", page, "--no-browser")
    assert code == 0 and f"wrote {page}" in out.replace("\n", ""), err
    text = page.read_text(encoding="utf-8")
    assert text.count('<figure class="chart">') >= 4 and "bench &lt;1&gt;.csv" in text
    assert "load flow, result.nc" in text
    (tmp_path / "empty").mkdir()
    for words, told in (
        ((tmp_path / "empty",), "holds no page and no result.nc"),
        ((tmp_path / "nothing.csv",), "no such file or folder"),
        ((tmp_path / "out", record), "not both"),
        ((tmp_path / "out", "-o", page), "-o is for the page of measured files"),
    ):
        code, _, err = call("open", *words)
        assert code == 2 and told in err and err.count("\n") == 1
