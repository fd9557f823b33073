"""Long sessions: what is searched first, and what is then fitted to the whole."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_plant import draw, write_session

from valvesim import beginnings, diagnose, search, study
from valvesim.beginnings import BEFORE, begin
from valvesim.beginnings import beginnings as beginnings_of
from valvesim.errors import SolveError
from valvesim.session import load_session
from valvesim.study import SETTLED, prepare_study, restricted


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A session in which the load flow sensor is far off."""
    folder = tmp_path_factory.mktemp("biased")
    write_session(draw(9, "sensor", name="sensor_bias"), folder)
    return load_session(folder)


@pytest.fixture
def long(monkeypatch):
    """Any session counts as long; of each of its records a good half is searched first."""
    monkeypatch.setattr(study, "LONG", 0)
    monkeypatch.setattr(beginnings, "SAMPLES", 0)
    monkeypatch.setattr(beginnings, "FEWEST", 600)


def late(record, samples, label=None):
    """The record after so many samples at rest."""

    def rested(values):
        return np.concatenate([np.full(samples, values[0]), values])

    return replace(
        record,
        time=np.arange(samples + len(record.time)) / record.rate,
        values={name: rested(values) for name, values in record.values.items()},
        usable={name: rested(usable) for name, usable in record.usable.items()},
        repeats=label,
    )


def test_a_beginning_is_kept_from_just_before_the_inputs_move(session):
    record = next(r for r in session.training if not np.ptp(r.values[r.command][:3]) == 0.0)
    (part,) = beginnings_of([late(record, 3000)], 40)
    before = round(BEFORE * record.rate)
    assert len(part.time) == 500
    assert part.time[0] == 0.0
    assert part.rate == pytest.approx(record.rate)
    moved = np.abs(part.values[record.command] - part.values[record.command][0])
    assert not moved[:before].any()
    assert moved[before : before + 20].any()
    np.testing.assert_array_equal(part.usable["load_flow"], np.ones(500, dtype=bool))


def test_a_record_shorter_than_a_beginning_is_kept_whole(session):
    parts = beginnings_of(session.training, len(session.training))
    for part, record in zip(parts, session.training, strict=True):
        np.testing.assert_array_equal(part.time, record.time)
        for name, values in record.values.items():
            np.testing.assert_array_equal(part.values[name], values)


def test_repeats_keep_in_step(session):
    record = session.training[0]
    early, later = beginnings_of([late(record, 3000, "a"), late(record, 3010, "a")], 40)
    np.testing.assert_array_equal(early.values[record.command][:-10], later.values[record.command][10:])


def test_beginnings_read_what_the_whole_reads_there(session):
    whole = prepare_study(session)
    most = 400
    parts = [beginnings._part(bench.record, slice(0, most)) for bench in whole.benches]
    short = restricted(whole, parts)
    assert short.base is whole.base
    assert short.candidates is whole.candidates
    variant = whole.base.at(np.zeros(len(whole.base.parameters)))
    for mine, own in zip(study.predict(short, variant), study.predict(whole, variant), strict=True):
        for name, read in mine.items():
            np.testing.assert_allclose(read, own[name][:most], atol=1e-4 * np.ptp(own[name]))


def test_a_short_session_is_searched_as_a_whole(session):
    base, known = begin(prepare_study(session), lambda stage, share: None)
    assert known == ()
    assert len(base.fit.readings[0]["load_flow"]) == len(session.training[0].time)


def test_in_a_long_session_what_its_beginnings_show_is_fitted_to_the_whole(session, long, monkeypatch):
    searched_in, stages = [], []

    def starts(scene, failed):
        searched_in.append(len(scene.fit.readings[0]["load_flow"]))
        return own(scene, failed)

    own = search._starts
    monkeypatch.setattr(search, "_starts", starts)
    found = diagnose(session, progress=lambda stage, share: stages.append((stage, share)))
    assert found.causes == ("sensor_bias",)
    hidden = dict(draw(9, "sensor", name="sensor_bias").hidden)["sensor_bias"]["bias"]
    assert found.parameters[0].low < hidden < found.parameters[0].high
    assert searched_in == [600]  # the whole is not searched where its beginnings have shown something
    assert any("in the first seconds" in stage for stage, _ in stages)
    assert [share for _, share in stages] == sorted(share for _, share in stages)


def test_where_beginnings_cannot_be_fitted_the_whole_is_searched(session, long, monkeypatch):
    def not_run(*given):
        raise SolveError("no valve")

    monkeypatch.setattr(beginnings, "_search_beginnings", not_run)
    monkeypatch.setattr(beginnings, "fit_base", lambda study, tell: study)
    whole = prepare_study(session)
    assert begin(whole, lambda stage, share: None) == (whole, ())


def test_the_base_fitted_near_its_best_is_the_base_fitted_from_afar(session):
    afar = study.fit_base(prepare_study(session))
    assert not afar.study.weights
    for peaks in (True, False):
        near = study.fit_base_near(prepare_study(session), afar.fit.point, peaks=peaks)
        assert bool(near.study.weights) is not peaks
        if peaks:
            assert near.fit.deviance < afar.fit.deviance + 2.0 * SETTLED


def test_what_hardly_helps_is_left_in_a_long_session_alone(session):
    whole = prepare_study(session)
    fit = study.Fit(np.zeros(1), (), 1e6, (), np.zeros(0), 1e3)
    assert whole.hardly(fit) == 0.0
    assert replace(whole, is_long=True).hardly(fit) == pytest.approx(study.HARDLY * (1e6 - study.ASTRAY * 1e3))
    assert replace(whole, is_long=True).hardly(replace(fit, deviance=1e3)) == 0.0
