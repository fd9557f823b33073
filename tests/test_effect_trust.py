"""Code that a file names is run where it was trusted before or is now; files elsewhere are read where that is said."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import valvesim as vs
from valvesim.identification.session_toml import load_session
from valvesim.studies.study_toml import load_study
from valvesim.valve.effect_files import load_effects_files
from valvesim.valve.effect_trust import TRUST_LIST, hash_of, remember
from valvesim.valve.permission import permitting
from valvesim.valve.valve_file import load_valve

EFFECT = """
import os
import valvesim as vs
open(os.path.join({folder!r}, "was_run"), "w").close()
own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0),),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""
SCENARIO = 'duration = "1 ms"\neffects_files = [{file!r}]\n[command]\ncurrent = "1 mA"\n'


@pytest.fixture(autouse=True)
def data(tmp_path, monkeypatch):
    """The user's data folder."""
    monkeypatch.setenv("VALVESIM_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def own(tmp_path):
    """A file of effects, which leaves `was_run` in its folder where it is run."""
    (tmp_path / "case").mkdir()
    path = tmp_path / "case" / "own.py"
    path.write_text(EFFECT.format(folder=str(tmp_path)), encoding="utf-8")
    return path


@pytest.fixture
def ran(tmp_path):
    """Whether code was run since it was asked last."""

    def ran():
        was = (tmp_path / "was_run").exists()
        (tmp_path / "was_run").unlink(missing_ok=True)
        return was

    return ran


def scenario(folder, file="own.py"):
    (folder / "case.toml").write_text(SCENARIO.format(file=file), encoding="utf-8")
    return folder / "case.toml"


def refused(load, *arguments, **options):
    with pytest.raises(vs.InputError) as caught:
        load(*arguments, **options)
    return str(caught.value)


def test_code_that_a_scenario_names_is_run_only_where_it_is_said(own, ran):
    path = scenario(own.parent)
    told = refused(vs.load_scenario, path)
    assert told.startswith(f"{path}, line 2: effects_files: '{own}' is Python code that would run with your rights")
    assert "--trust (in Python: trust=True)" in told and not ran()
    assert vs.load_scenario(path, trust=True) and ran()
    assert "was not trusted before" in refused(vs.load_scenario, path) and not ran()


def test_what_was_trusted_runs_by_its_content_alone(own, ran, tmp_path):
    remember(own, own.read_bytes())
    assert vs.load_scenario(scenario(own.parent)) and ran()
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "same.py").write_bytes(own.read_bytes())
    assert vs.load_scenario(scenario(tmp_path / "copy", "same.py")) and ran()
    own.write_bytes(own.read_bytes() + b"\n# another")
    assert "was not trusted before" in refused(vs.load_scenario, scenario(own.parent)) and not ran()


def test_a_session_and_a_valve_file_ask_as_a_scenario_does(own, ran):
    folder = own.parent
    (folder / "valve.toml").write_text('title = "a"\neffects_files = ["own.py"]\n')
    assert "was not trusted before" in refused(load_valve, folder / "valve.toml") and not ran()
    assert load_valve(folder / "valve.toml", trust=True).own and ran()
    (folder / "named.toml").write_text('duration = "1 ms"\nvalve = "valve.toml"\n[command]\ncurrent = "1 mA"\n')
    assert "was not trusted before" in refused(vs.load_scenario, folder / "named.toml") and not ran()
    assert vs.load_scenario(folder / "named.toml", trust=True) and ran()
    _write_record(folder / "a.csv")
    (folder / "session.toml").write_text('effects_files = ["own.py"]\n')
    assert "was not trusted before" in refused(load_session, folder) and not ran()
    assert load_session(folder, trust=True).user_effects and ran()


def test_a_study_asks_before_it_runs_figures_of_ones_own(tmp_path, ran):
    mine = tmp_path / "mine.py"
    runs = f"open({str(tmp_path / 'was_run')!r}, 'w').close()\n"
    mine.write_text(f"{runs}def figures(case):\n    return {{'one': 1.0}}\n")
    study = tmp_path / "study.toml"
    study.write_text(
        '[scenario]\nduration = "1 ms"\n[scenario.command]\ncurrent = "1 mA"\n[design]\nmembers = 4\n'
        '[vary]\ntolerances = true\n[figures]\nkeep = ["own.*"]\nfunctions = ["mine.py"]\n'
    )
    told = refused(load_study, study)
    assert f"figures.functions: '{mine}' is Python code that would run with your rights" in told and not ran()
    assert load_study(study, trust=True).options.functions and ran()
    mine.write_text("raise SystemExit(3)")
    assert "SystemExit: 3" in refused(load_study, study, trust=True)


def _write_record(path):
    t = np.arange(200) / 1e3
    rows = (f"{a:.3f},{5 * np.sin(60 * a):.6f},{0.2 * np.sin(60 * a):.6f}" for a in t)
    path.write_text("\n".join(["time [s],current [mA],spool_position [mm]", *rows]))


def test_code_outside_the_folder_needs_to_be_said_too(own, ran, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "link.py").symlink_to(own)
    for file in ("../case/own.py", str(own), "link.py"):
        path = scenario(tmp_path / "other", file)
        assert "stands outside the folder" in refused(vs.load_scenario, path, trust=True) and not ran()
        assert "was not trusted before" in refused(vs.load_scenario, path, outside=True) and not ran()
        assert vs.load_scenario(path, trust=True, outside=True) and ran()
    remember(own, own.read_bytes())  # at its place, wherever it is named from
    assert vs.load_scenario(scenario(tmp_path / "other", str(own))) and ran()
    (tmp_path / "copy.py").write_bytes(own.read_bytes())
    assert "outside the folder" in refused(vs.load_scenario, scenario(tmp_path / "other", "../copy.py"))


def test_what_runs_is_what_was_asked_about(own, ran):
    def ask(file, content):
        assert content == file.read_bytes()
        file.write_text("raise RuntimeError('exchanged')")
        return True

    with permitting(ask=ask):
        assert load_effects_files(own.parent, ["own.py"]) and ran()


@pytest.mark.parametrize("mode", [0o777, 0o620])
def test_a_list_that_others_could_write_trusts_nothing(own, ran, data, mode):
    remember(own, own.read_bytes())
    (data / TRUST_LIST).chmod(mode)
    assert "was not trusted before" in refused(vs.load_scenario, scenario(own.parent)) and not ran()
    (data / TRUST_LIST).chmod(0o600)
    data.chmod(mode | 0o100)
    assert "was not trusted before" in refused(vs.load_scenario, scenario(own.parent)) and not ran()


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\n\n \n", b"x" * 10_000, "é 1\n".encode()])
def test_a_damaged_list_trusts_nothing(own, ran, data, content):
    data.mkdir(mode=0o700)
    (data / TRUST_LIST).write_bytes(content)
    (data / TRUST_LIST).chmod(0o600)
    assert "was not trusted before" in refused(vs.load_scenario, scenario(own.parent)) and not ran()


def test_a_list_in_no_folder_and_a_path_of_control_characters_trust_nothing(own, data):
    data.write_text("a file")
    with pytest.raises(OSError):
        remember(own, own.read_bytes())
    data.unlink()
    remember(own.parent / f"a\n{hash_of(b'planted')} x", b"a")
    assert not data.exists()


def test_records_outside_the_sessions_folder_are_read_where_it_is_said(tmp_path):
    folder = tmp_path / "session"
    folder.mkdir()
    _write_record(tmp_path / "a.csv")
    (folder / "session.toml").write_text('[[records]]\nfile = "../a.csv"\n')
    told = refused(load_session, folder)
    assert told.startswith(
        f"{folder / 'session.toml'}, line 2: records.1.file: '../a.csv' stands outside the folder"
    )
    assert len(load_session(folder, outside=True).records) == 1
    (folder / "session.toml").write_text("")
    (folder / "b.csv").symlink_to(tmp_path / "a.csv")
    assert "'b.csv' stands outside the folder" in refused(load_session, folder)
    assert len(load_session(folder, outside=True).records) == 1


def test_the_command_line_refuses_remembers_and_forgets_with_the_content(call, own, ran, data):
    words = ("run", scenario(own.parent), "-o", own.parent.parent / "out", "--set", "duration=x")  # ends after reading
    code, _, err = call(*words)
    assert code == 2 and "was not trusted before" in err and not ran() and not data.exists()
    assert "duration" in call(*words, "--trust")[2] and ran()
    assert (data / TRUST_LIST).read_text() == f"{hash_of(own.read_bytes())} {own}\n"
    assert (data / TRUST_LIST).stat().st_mode & 0o777 == 0o600
    assert "duration" in call(*words)[2] and ran()
    with own.open("a") as file:
        file.write("# changed")
    assert "was not trusted before" in call(*words)[2] and not ran()


def test_every_command_that_reads_files_knows_both_options(call):
    for name in ("run", "diagnose", "response", "bench", "datasheet", "static"):
        out = call(name, "--help")[1]
        assert "--trust" in out and "--outside" in out
    assert "--trust" not in call("effects", "--help")[1]


@pytest.mark.parametrize("answer, runs", [(b"y\n", True), (b"n\n", False), (b"\n", False)])
def test_on_a_terminal_the_user_is_asked(own, ran, data, answer, runs):
    """A process with a terminal for standard input and error, which answers the question."""
    here, there = pty.openpty()
    words = [sys.executable, "-m", "valvesim.cli.main", "run", str(scenario(own.parent)), "--set", "duration=x"]
    process = subprocess.Popen(words, stdin=there, stdout=subprocess.DEVNULL, stderr=there, cwd=own.parent)
    os.close(there)
    os.write(here, answer)
    said = b""
    try:
        while part := os.read(here, 1000):
            said += part
    except OSError:  # the other end is closed
        pass
    os.close(here)
    assert process.wait() == 2
    assert b"is Python code that runs with your rights" in said and b"Run it, now and later? [y/N]" in said
    assert ran() == runs and data.exists() == runs and (b"was not trusted before" in said) != runs
    assert not list(Path(own.parent).glob("results"))
