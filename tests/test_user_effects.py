"""A user's own effects: loaded from a file as it stands, refused with its line, and at work in a scenario."""

import os
from dataclasses import replace
from functools import partial

import pytest

import valvesim as vs
from valvesim.valve.effect_files import load_effects, load_effects_files

EFFECT = """
import valvesim as vs

own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0),),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""
SCENARIO = """\
duration = "20 ms"
effects_files = ["own.py"]
[thermal]
isothermal = true
[command.current]
constant = "1 mA"
[effects.side_load]
force = "5 N"
"""


def refused(function, *arguments):
    """What an InputError says."""
    with pytest.raises(vs.InputError) as told:
        function(*arguments)
    return str(told.value)


@pytest.fixture
def case(tmp_path):
    """Writes a scenario and own.py beside it; the scenario's path."""

    def case(text=SCENARIO, effect=EFFECT):
        (tmp_path / "own.py").write_text(effect, encoding="utf-8")
        (tmp_path / "case.toml").write_text(text, encoding="utf-8")
        return tmp_path / "case.toml"

    return case


def test_a_scenario_runs_with_a_users_effect(case):
    scenario = vs.load_scenario(case(), trust=True)
    (active,) = scenario.effects
    assert (active.effect.name, active.values.force) == ("side_load", 5.0)
    results = [vs.simulate(replace(scenario, effects=(active.effect(force=force),))) for force in (5.0, 0.0)]
    ends = [float(result["spool_position"].values[-1]) for result in results]
    assert abs(ends[0] - ends[1]) > 1e-7  # m: the side load moves the spool


def test_settings_reach_a_users_effect(case):
    scenario = vs.load_scenario(case(), trust=True, settings=["effects.side_load.force=7 N"])
    assert scenario.effects[0].values.force == 7.0


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('["own.py"]', '["owm.py"]', ", line 2: effects_files: "),
        ('["own.py"]', '"own.py"', ", line 2: effects_files: expected a list of file names, got 'own.py'"),
        ("side_load", "side_laod", ", line 7: effects: unknown effect 'side_laod'; did you mean 'side_load'?"),
        ("force =", "forze =", ", line 8: effects.side_load: unknown parameter of effect side_load 'forze'"),
        ("5 N", "5 bar", ", line 8: effects.side_load.force: 'bar' has the wrong dimension"),
        ("5 N", "60 N", ", line 8: effects.side_load.force = 60.0 N is outside [-50, 50] N"),
        ("effects_files", "effect_files", ", line 2: scenario: unknown key 'effect_files'; did you mean"),
    ],
)
def test_a_wrong_line_about_a_users_effect_is_refused(case, old, new, message):
    path = case(SCENARIO.replace(old, new))
    assert refused(partial(vs.load_scenario, trust=True), path).startswith(f"{path}{message}")


def test_without_its_file_a_users_effect_is_unknown(case):
    path = case(SCENARIO.replace('effects_files = ["own.py"]\n', ""))
    assert "line 6: effects: unknown effect 'side_load'" in refused(vs.load_scenario, path)


def test_files_are_found_from_their_folder_or_by_absolute_path(tmp_path):
    (tmp_path / "one.py").write_text(EFFECT, encoding="utf-8")
    (tmp_path / "two.py").write_text(EFFECT.replace("side_load", "other"), encoding="utf-8")
    found = load_effects_files(tmp_path, [], given=["one.py", tmp_path.absolute() / "two.py"])
    assert [effect.name for effect in found] == ["side_load", "other"]
    assert load_effects_files(tmp_path, []) == ()


def test_one_name_in_two_files_is_refused(tmp_path):
    for name in ("one", "two"):
        (tmp_path / f"{name}.py").write_text(EFFECT, encoding="utf-8")
    told = refused(partial(load_effects_files, given=["one.py", "two.py"]), tmp_path, [])
    assert told == "effects_files: 'two.py' declares 'side_load', which another file did already"


def test_a_file_that_is_not_there_is_refused(tmp_path):
    assert refused(load_effects_files, tmp_path, ["no.py"]) == f"effects_files: {tmp_path / 'no.py'}: no such file"
    assert os.listdir(tmp_path) == []


def test_a_users_effects_are_loaded_in_order_and_leave_nothing_behind(tmp_path):
    more = EFFECT + "\nfriction = vs.effect('spool_coulomb_friction')\nalias = own\n"
    more += "import dataclasses\nother = dataclasses.replace(friction, name='other')\n"
    (tmp_path / "own.py").write_text(more, encoding="utf-8")
    assert [effect.name for effect in load_effects(tmp_path / "own.py")] == ["side_load", "other"]
    assert os.listdir(tmp_path) == ["own.py"]


@pytest.mark.parametrize(
    "content, message",
    [
        ("a = 1\nb = (\n", ", line 2: fails with SyntaxError"),
        ("a = 1\n\nb = a / 0\n", ", line 3: fails with ZeroDivisionError: division by zero"),
        ("def f():\n    raise SystemExit(3)\nf()", ", line 2: fails with SystemExit: 3"),
        ("\nopen('/no/such/file')", ", line 2: fails with FileNotFoundError"),
        ("import no_such_module", ", line 1: fails with ModuleNotFoundError"),
        ("import valvesim as vs\na = vs.effect('spool_coulomb_friction')", ": declares no effect; expected"),
        (EFFECT.replace("side_load", "entrained_air"), ": effect 'entrained_air' is in the catalogue already"),
        (EFFECT + EFFECT.replace("own", "other"), ": two effects are called 'side_load'"),
        (
            EFFECT.replace('name="side_load"', 'name="side_load", plainer="spool_coulomb_frictoin"'),
            ": effect 'side_load': plainer: unknown effect 'spool_coulomb_frictoin'; did you mean",
        ),
        (
            EFFECT.replace('"side_load"', '"side_load", indistinguishable_from=("spool_lap", "nothing_known")'),
            ": effect 'side_load': indistinguishable_from: unknown effect 'nothing_known'",
        ),
        (
            EFFECT.replace('"side_load"', '"side_load", indistinguishable_from="spool_lap"'),
            ": effect 'side_load': indistinguishable_from must be a tuple of names of effects",
        ),
        (
            EFFECT.replace('"side_load"', '"side_load", plainer="side_load"'),
            ": effect 'side_load': plainer: unknown effect 'side_load'",
        ),
        (EFFECT.replace(", neutral=0.0", ""), ": effect side_load has no parameter with a neutral value"),
    ],
)
def test_a_users_file_that_fails_is_refused_with_its_line(tmp_path, content, message):
    path = tmp_path / "own.py"
    path.write_text(content, encoding="utf-8")
    assert refused(load_effects, path).startswith(f"{path}{message}")


def test_an_effect_may_be_held_against_the_catalogue_and_others_of_its_file(tmp_path):
    path = tmp_path / "own.py"
    twin = EFFECT.replace("own", "twin").replace('"side_load"', '"twin_load", plainer="side_load"')
    path.write_text(EFFECT.replace('"side_load"', '"side_load", indistinguishable_from=("spool_lap",)') + twin, "utf-8")
    side, other = load_effects(path)
    assert side.indistinguishable_from == ("spool_lap",) and other.plainer == "side_load"


def test_a_users_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "own.py").write_bytes(b"\xff\xfe")
    assert "fails with UnicodeDecodeError" in refused(load_effects, tmp_path / "own.py")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"side_load"', '"side load"', "effect 'side load': the name 'side load' may hold letters, digits and _ alone"),
        ('unit="N"', 'unit=""', "effect 'side_load': force has no unit; one without a dimension has '1'"),
        ('unit="N"', 'unit="Newtn"', "effect 'side_load': force: unknown unit 'Newtn'"),
        ("(vs.Ports(spool_force=p.force), ())", "vs.Ports(spool_force=p.force)",
         "effect 'side_load': its balance must give (vs.Ports(...), rates) with a tuple of 0 rates, got Ports("),
        ("(vs.Ports(spool_force=p.force), ())", "(vs.Ports(spool_force=p.force), (0.0,))", "with a tuple of 0 rates"),
        ("p.force)", "p.froce)", "line 7: fails with AttributeError"),
    ],
)  # fmt: skip
def test_an_effect_that_could_not_be_run_or_written_is_refused_when_it_is_read(tmp_path, old, new, message):
    (tmp_path / "own.py").write_text(EFFECT.replace(old, new), encoding="utf-8")
    told = refused(load_effects, tmp_path / "own.py")
    assert told.startswith(str(tmp_path / "own.py")) and message in told
