"""The answer as JSON: everything but the traces, in plain types, whole or not at all."""

import dataclasses
import json

import numpy as np
import pytest

from valvesim.diagnosis.result import (
    CAUSE,
    CandidateAnswer,
    DetectionLimit,
    Diagnosis,
    Estimate,
    Gain,
    NextTest,
    NoiseFound,
    Score,
    Shift,
    Term,
    Trace,
)

TIME = np.arange(3) / 1e3


def answer(**changed):
    """A diagnosis with one of everything."""
    fields = dict(
        title="Prüfstand 3",
        verdict=CAUSE,
        causes=("spool_coulomb_friction",),
        summary="Reibung: 2 N ± 0.1 N",
        location="spool force balance",
        candidates=(
            CandidateAnswer(
                names=("spool_coulomb_friction",), label="friction", location="spool force balance",
                probability=np.float64(0.98), deviance_fall=400.0, in_set=np.bool_(True),
            ),
        ),
        parameters=(
            Estimate(name="friction_force", cause="spool_coulomb_friction", value=2.0, low=1.9, high=2.1, unit="N"),
        ),
        gain=(
            Gain(record="c", before=5.0, after=1.1, floor=1.0, change=-24.0, low=-30.0, high=-20.0, claimed=True),
        ),
        gain_claimed=True,
        extension_offered=True,
        detection_limits=(
            DetectionLimit(name="thermal_lag", label="lag", parameter="time_constant", amplitude=None, unit="s"),
        ),
        next_test=NextTest(
            description="a slow triangle", settings={"amplitude": "2 mA"}, duration=4.0, separates=("a", "b"),
            distance=np.inf, power=0.99,
        ),
        term=Term(
            port="spool_force", port_unit="N", variable="spool_velocity", variable_unit="m/s", memory="none",
            at=(0.0, 0.1), value=(0.0, 1.0), deviation=(0.1, np.nan), formula="k v", formula_error=0.02,
        ),
        shifts=(Shift(name="null_gap", unit="m", nominal=3e-5, value=3.1e-5, share_of_tolerance=0.5),),
        noise=(
            NoiseFound(
                channel="spool_position", rate=1000.0, deviation=1e-6, unit="m", order=np.int64(2), verified=False,
                source="residuals",
            ),
        ),
        scores=(Score(label="friction", z=20.0),),
        alarm_level=np.float32(3.5),
        errors={"a": {"spool_position": 4.0}},
        notes=("one record",),
        traces=(
            Trace(
                record="a", channel="spool_position", unit="m", role="train", time=TIME, measured=TIME, base=TIME,
                extended=TIME, noise=1e-6,
            ),
        ),
        extended_scenario="title = 'x'\n",
    )  # fmt: skip
    return Diagnosis(**fields | changed)


def strict(text):
    """JSON as the standard has it: NaN and Infinity are refused."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_the_file_holds_what_the_dictionary_does(tmp_path):
    path = answer().to_json(tmp_path / "diagnosis.json")
    assert path == tmp_path / "diagnosis.json"
    text = path.read_text(encoding="utf-8")
    assert strict(text) == answer().to_dict()
    assert "Prüfstand 3" in text and text.endswith("}\n")


def test_the_dictionary_has_every_field_but_traces_and_what_only_python_can_use():
    table = answer(extended_variant=object()).to_dict()
    assert set(table) == {f.name for f in dataclasses.fields(Diagnosis)} - {
        "traces",
        "extended_variant",
        "extended_effects",
    }
    assert set(table["next_test"]) == {f.name for f in dataclasses.fields(NextTest)} - {"inputs"}
    assert table["verdict"] == "cause" and table["causes"] == ["spool_coulomb_friction"]
    assert table["candidates"][0]["in_set"] is True
    assert table["parameters"][0] == {
        "name": "friction_force", "cause": "spool_coulomb_friction", "value": 2.0, "low": 1.9, "high": 2.1,
        "unit": "N", "doc": "",
    }  # fmt: skip
    assert table["next_test"]["settings"] == {"amplitude": "2 mA"}
    assert table["errors"] == {"a": {"spool_position": 4.0}}


def test_the_scenario_is_named_not_copied():
    assert answer().to_dict()["extended_scenario"] == "extended.toml"


def test_numbers_of_numpy_become_plain_ones():
    table = answer().to_dict()
    assert type(table["candidates"][0]["probability"]) is float
    assert type(table["candidates"][0]["in_set"]) is bool
    assert type(table["noise"][0]["order"]) is int
    assert type(table["alarm_level"]) is float
    own = answer(errors={"a": {"spool_position": np.array([1.0, np.nan])}}).to_dict()
    assert own["errors"]["a"]["spool_position"] == [1.0, None]


def test_what_is_absent_or_not_finite_is_null(tmp_path):
    table = strict(answer(alarm_level=np.inf).to_json(tmp_path / "d.json").read_text(encoding="utf-8"))
    assert table["alarm_level"] is None
    assert table["next_test"]["distance"] is None
    assert table["term"]["deviation"] == [0.1, None]
    assert table["detection_limits"][0]["amplitude"] is None
    empty = answer(next_test=None, term=None).to_dict()
    assert empty["next_test"] is None and empty["term"] is None


def test_a_failure_leaves_the_old_answer_whole_and_nothing_beside_it(tmp_path):
    path = answer().to_json(tmp_path / "diagnosis.json")
    before = path.read_bytes()
    with pytest.raises(TypeError):
        answer(notes=(object(),)).to_json(path)
    with pytest.raises(UnicodeEncodeError):  # while the file is being written
        answer(title="\ud800").to_json(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
