"""`valvesim diagnose` as a user meets it: files all together or none, a few lines of answer, exit codes."""

import json
import os
from dataclasses import replace
from types import SimpleNamespace

import hidden_plant
import numpy as np
import pytest
from matplotlib.figure import Figure
from test_answer import answer

import valvesim as vs
from valvesim.diagnosis import diagnose as diagnosis
from valvesim.diagnosis.result import AMBIGUOUS, CAUSE, NO_DISCREPANCY, NO_TEST, UNKNOWN
from valvesim.io import read_columns
from valvesim.reports.diagnosis import page as report_diagnosis
from valvesim.valve.effect_files import load_effects

EFFECT = """
import valvesim as vs

own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(
        vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0, typical=2.0),
    ),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""
PLAIN = answer(next_test=None, term=None)
INPUTS = {"time": np.array([0.0, 1e-3]), "current": np.array([0.0, 2e-3]), "supply_pressure": np.array([2e7, 2.1e7])}
TESTED = answer(verdict=AMBIGUOUS, term=None, next_test=replace(answer().next_test, inputs=INPUTS, distance=9.0))
ALWAYS = {"diagnosis.json", "report.html", "extended.toml"}
PICTURES = {"errors.png", "traces.png", "scores.png", "gain.png", "term.png"}


@pytest.fixture
def call(call):
    """Run `valvesim diagnose` in this process, see conftest."""
    return lambda *words: call("diagnose", *words)


@pytest.fixture
def session(tmp_path):
    """A session folder of one moving record."""
    time = np.arange(100) / 1e3
    rows = (f"{t:.3f},{5 * np.sin(60 * t):.6f},{0.2 * np.sin(60 * t):.6f}" for t in time)
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / "a.csv").write_text("\n".join(["time [s],current [mA],spool_position [mm]", *rows]), encoding="utf-8")
    (folder / "session.toml").write_text("seed = 3\n", encoding="utf-8")
    return folder


@pytest.fixture
def found(monkeypatch):
    """Let the diagnosis find an answer, or raise an error; `.session` is what it was given. Pictures only if asked."""

    def found(result, *, pictures=False):
        seen = SimpleNamespace(session=None)
        if not pictures:
            monkeypatch.setattr(report_diagnosis, "draw", lambda diagnosis: {"errors": Figure()})

        def diagnose(session, *, progress):
            seen.session = session
            progress("refitting", 0.5)
            if isinstance(result, BaseException):
                raise result
            return result

        monkeypatch.setattr(diagnosis, "diagnose", diagnose)
        return seen

    return found


def test_the_answer_is_written_and_said(call, found, session, tmp_path):
    found(PLAIN, pictures=True)
    code, out, err = call(session, "-o", tmp_path / "deep" / "out")
    assert (code, err) == (0, "")
    folder = tmp_path / "deep" / "out"
    names = set(os.listdir(folder)) - {"manifest.json"}
    assert ALWAYS <= names <= ALWAYS | PICTURES
    assert json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] == "cause"
    assert (folder / "extended.toml").read_text(encoding="utf-8") == PLAIN.extended_scenario
    assert out.startswith("cause: Reibung: 2 N ± 0.1 N\n") and "where: spool force balance" in out
    assert "spool_coulomb_friction: friction_force = 2 N (95 %: 1.9 to 2.1)" in out
    assert "gain on c: error 5 -> 1.1 (noise 1)\n" in out and "next test" not in out
    assert {line.removeprefix("wrote ") for line in out.splitlines() if line.startswith("wrote ")} == {
        str(folder / name) for name in names
    }
    assert os.listdir(folder.parent) == ["out"]  # the folder beside it is gone


def test_code_that_a_diagnosis_wrote_itself_is_trusted_at_once(call, found, session, tmp_path):
    named = 'duration = "1 ms"\neffects_files = ["recovered_term.py"]\n[command]\ncurrent = "1 mA"\n'
    found(replace(PLAIN, extended_scenario=named, extended_effects={"recovered_term.py": EFFECT + f"# {tmp_path}"}))
    assert call(session, "-o", tmp_path / "out")[0] == 0
    assert vs.load_scenario(tmp_path / "out" / "extended.toml").duration == 1e-3
    (tmp_path / "out" / "recovered_term.py").write_text(EFFECT + "# another's")
    with pytest.raises(vs.InputError, match="was not trusted before"):
        vs.load_scenario(tmp_path / "out" / "extended.toml")


@pytest.mark.parametrize("verdict", [NO_DISCREPANCY, AMBIGUOUS, UNKNOWN])
def test_any_verdict_is_a_success(call, found, session, tmp_path, verdict):
    found(replace(PLAIN, verdict=verdict))
    code, out, _ = call(session, "-o", tmp_path / "out")
    assert code == 0 and out.startswith(verdict.replace("_", " ") + ": ")


def test_figures_are_said_in_the_units_of_people(call, found, session, tmp_path):
    estimate = replace(PLAIN.parameters[0], name="half_play", value=5e-6, low=4e-6, high=6e-6, unit="m")
    found(replace(PLAIN, parameters=(estimate,)))
    assert "half_play = 5 µm (95 %: 4 to 6)" in call(session, "-o", tmp_path / "out")[1]


def test_a_next_test_that_tells_nothing_says_so(call, found, session, tmp_path):
    found(replace(TESTED, next_test=replace(TESTED.next_test, power=0.002, uninformative=True)))
    out = call(session, "-o", tmp_path / "out")[1]
    told = "next test, 4 s: a slow triangle; tells a from b with a probability of 0%, and no other test does better"
    assert told in " ".join(out.split())


def test_what_is_ambiguous_comes_with_the_next_test(call, found, session, tmp_path):
    other = replace(TESTED.candidates[0], label="silting", probability=0.02)
    found(replace(TESTED, candidates=(*TESTED.candidates, other)))
    code, out, _ = call(session, "-o", tmp_path / "out")
    assert code == 0 and "candidates: friction 98%, silting 2%" in out
    assert "next test, 4 s: a slow triangle; tells a from b with a probability of 99%" in out
    assert (
        (tmp_path / "out" / "next_test.csv")
        .read_text(encoding="utf-8")
        .startswith("time [s],current [mA],supply_pressure [bar]\n0,0,200\n")
    )
    wanted = {"time": "s", "current": "A", "supply_pressure": "Pa"}
    read = read_columns(tmp_path / "out" / "next_test.csv", wanted)
    assert all(np.allclose(read[name], INPUTS[name]) for name in wanted)


def test_what_no_test_tells_apart_says_so(call, found, session, tmp_path):
    other = replace(TESTED.candidates[0], names=("spool_silting",), label="spool_silting")
    found(replace(TESTED, next_test=None, candidates=(*TESTED.candidates, other)))
    out = " ".join(call(session, "-o", tmp_path / "out")[1].split())
    assert NO_TEST in out and "next test" not in out


def test_a_gain_that_is_not_claimed_says_so(call, found, session, tmp_path):
    found(replace(PLAIN, gain=(replace(PLAIN.gain[0], claimed=False),)))
    assert "(noise 1), not claimed" in call(session, "-o", tmp_path / "out")[1]


def test_a_missing_term_is_said_with_its_formula(call, found, session, tmp_path):
    found(answer(verdict=UNKNOWN, next_test=None, term=replace(answer().term, deviation=(0.1, 0.1))))
    out = call(session, "-o", tmp_path / "out")[1]
    assert "missing term: spool force as a function of spool velocity: k v" in out


def test_the_answer_before_goes_whole(call, found, session, tmp_path):
    folder = tmp_path / "out"
    found(TESTED)
    call(session, "-o", folder)
    (folder / "notes.txt").write_text("mine", encoding="utf-8")
    found(PLAIN)
    assert call(session, "-o", folder)[0] == 0
    names = set(os.listdir(folder))
    assert "next_test.csv" not in names and "notes.txt" in names and names >= ALWAYS


FAILURES = [(vs.InputError("bad"), 2), (vs.SolveError("no rest"), 1), (KeyboardInterrupt(), 130)]


@pytest.mark.parametrize("error, code", FAILURES, ids=["input", "solve", "interrupted"])
def test_whatever_fails_leaves_nothing(call, found, session, tmp_path, error, code):
    found(error)
    told = call(session, "-o", tmp_path / "deep" / "out")
    assert told[:2] == (code, "")  # click begins a line of its own after an interruption
    assert told[2].lstrip("\n").startswith("error: ") and told[2].strip("\n").count("\n") == 0
    assert sorted(os.listdir(tmp_path)) == ["session"]


@pytest.mark.parametrize("error, code", FAILURES, ids=["input", "solve", "interrupted"])
def test_whatever_fails_leaves_the_answer_before(call, found, session, tmp_path, error, code):
    found(PLAIN)
    call(session, "-o", tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    found(error)
    assert call(session, "-o", tmp_path / "out")[0] == code
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before
    assert sorted(os.listdir(tmp_path)) == ["out", "session"]


def test_interrupted_while_writing_leaves_nothing(call, found, session, tmp_path, monkeypatch):
    def write_report(diagnosis, folder, **marks):
        raise KeyboardInterrupt

    found(PLAIN)
    monkeypatch.setattr(report_diagnosis, "write_report", write_report)
    assert call(session, "-o", tmp_path / "out")[0] == 130 and sorted(os.listdir(tmp_path)) == ["session"]


def test_seed_and_effects_reach_the_session(call, found, session, tmp_path):
    (tmp_path / "own.py").write_text(EFFECT, encoding="utf-8")
    seen = found(PLAIN)
    call(session, "-o", tmp_path / "out")
    assert (seen.session.seed, seen.session.user_effects) == (3, ())
    call(session, "-o", tmp_path / "out", "--seed", 7, "--effects", tmp_path / "own.py")
    assert seen.session.seed == 7 and [effect.name for effect in seen.session.user_effects] == ["side_load"]
    assert seen.session.effects_files == ((tmp_path / "own.py").absolute(),)
    assert load_effects(seen.session.effects_files[0])


@pytest.mark.parametrize(
    "words, message",
    [
        (("nowhere",), "session.toml: no such file; a session is a folder"),
        (("session", "--seed", "-1"), "-1"),
        (("session", "--effects", "no.py"), "no.py: no such file"),
        (("session", "-o", "session/session.toml"), "session.toml: cannot be written (it is a file)"),
    ],
)
def test_bad_input_is_one_line(call, session, monkeypatch, words, message):
    monkeypatch.chdir(session.parent)
    code, out, err = call(*words)
    assert (code, out) == (2, "") and err.startswith("error: ") and message in err and err.count("\n") == 1
    assert os.listdir(session.parent) == ["session"]


def test_the_package_hands_out_the_diagnosis():
    assert vs.diagnose is diagnosis.diagnose and vs.Diagnosis is type(PLAIN) and vs.load_session is not None
    with pytest.raises(AttributeError, match="no attribute 'diagnos'"):
        _ = vs.diagnos


def test_friction_of_the_hidden_plant_is_found_by_the_command(call, tmp_path):
    """A real run, at a strength where friction is clear (d' some tens) and the plant's own ways do not matter yet."""
    case = hidden_plant.draw(3, "effect", name="spool_coulomb_friction")
    strength = min(1.0, 60.0 / hidden_plant.distance(case))
    hidden_plant.write_session(hidden_plant.shortened(case, 501), tmp_path / "s", strength)
    code, out, err = call(tmp_path / "s", "-o", tmp_path / "out")
    assert code == 0, err
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert out.startswith(told["verdict"].replace("_", " "))
    assert told["verdict"] in (CAUSE, AMBIGUOUS)
    assert any("friction" in name for entry in told["candidates"] if entry["in_set"] for name in entry["names"])
    extended = vs.load_scenario(tmp_path / "out" / "extended.toml")
    assert {active.effect.name for active in extended.effects} >= set(told["causes"])
