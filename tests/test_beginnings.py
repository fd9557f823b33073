"""Long sessions: what is searched first, and what is then fitted to the whole."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plant import draw

from valvesim import diagnose
from valvesim.diagnosis import coarse_to_fine as leading_segments  # noqa: E402
from valvesim.diagnosis import first_hypotheses
from valvesim.diagnosis.coarse_to_fine import fit_coarse_to_fine
from valvesim.diagnosis.coarse_to_fine import leading_segments as beginnings_of
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.options import CoarseToFineOptions, DiagnosisOptions
from valvesim.errors import SolveError
from valvesim.identification.fit import predict_readings
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.options import FitOptions, IdentificationOptions
from valvesim.identification.study import prepare_session, restricted_session


@pytest.fixture
def session(biased_session):
    return biased_session


LONG = DiagnosisOptions(
    identification=IdentificationOptions(fit=FitOptions(long_session=0)),
    coarse_to_fine=CoarseToFineOptions(samples=0, least_samples=300),
)
"""Any session counts as long; of each of its records a good half is searched first."""


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
    (part,) = beginnings_of([late(record, 3000)], 40, options=DIAGNOSIS)
    before = round(DIAGNOSIS.coarse_to_fine.lead * record.rate)
    assert len(part.time) == 500
    assert part.time[0] == 0.0
    assert part.rate == pytest.approx(record.rate)
    moved = np.abs(part.values[record.command] - part.values[record.command][0])
    assert not moved[:before].any()
    assert moved[before : before + 20].any()
    np.testing.assert_array_equal(part.usable["load_flow"], np.ones(500, dtype=bool))


def test_a_record_shorter_than_a_beginning_is_kept_whole(session):
    parts = beginnings_of(session.training, len(session.training), options=DIAGNOSIS)
    for part, record in zip(parts, session.training, strict=True):
        np.testing.assert_array_equal(part.time, record.time)
        for name, values in record.values.items():
            np.testing.assert_array_equal(part.values[name], values)


def test_repeats_keep_in_step(session):
    record = session.training[0]
    early, later = beginnings_of([late(record, 3000, "a"), late(record, 3010, "a")], 40, options=DIAGNOSIS)
    np.testing.assert_array_equal(early.values[record.command][:-10], later.values[record.command][10:])


def test_beginnings_read_what_the_whole_reads_there(session):
    whole = prepare_session(session)
    most = 200
    parts = [leading_segments._part(predictor.record, slice(0, most)) for predictor in whole.predictors]
    short = restricted_session(whole, parts)
    assert short.nominal is whole.nominal
    assert short.candidates is whole.candidates
    variant = whole.nominal.at(np.zeros(len(whole.nominal.parameters)))
    for mine, own in zip(predict_readings(short, variant), predict_readings(whole, variant), strict=True):
        for name, read in mine.items():
            np.testing.assert_allclose(read, own[name][:most], atol=1e-4 * np.ptp(own[name]))


def test_the_beginnings_of_a_long_session_are_long_only_where_they_are_so_themselves(session):
    points = sum(len(predictor.times) for predictor in prepare_session(session).predictors)
    options = replace(OPTIONS, fit=replace(OPTIONS.fit, long_session=points - 1))
    whole = prepare_session(session, options=options)
    assert whole.is_long
    records = [predictor.record for predictor in whole.predictors]
    for most, is_long in ((100, False), (None, True)):
        parts = [leading_segments._part(record, slice(0, most)) for record in records]
        assert restricted_session(whole, parts).is_long is is_long


@pytest.mark.slow
def test_a_short_session_is_searched_as_a_whole(session):
    nominal, known = fit_coarse_to_fine(prepare_session(session), lambda stage, share: None, options=DIAGNOSIS)
    assert known == ()
    assert len(nominal.fit.readings[0]["load_flow"]) == len(session.training[0].time)


def test_in_a_long_session_what_its_beginnings_show_is_fitted_to_the_whole(session, monkeypatch):
    searched_in, stages = [], []

    def starts(scores, failed):
        searched_in.append(len(scores.fit.readings[0]["load_flow"]))
        return own(scores, failed)

    own = first_hypotheses.start_points
    monkeypatch.setattr(first_hypotheses, "start_points", starts)
    found = diagnose(session, progress=lambda stage, share: stages.append((stage, share)), options=LONG)
    assert found.causes == ("sensor_bias",)
    hidden = dict(draw(9, "sensor", name="sensor_bias").hidden)["sensor_bias"]["bias"]
    assert found.parameters[0].low < hidden < found.parameters[0].high
    assert searched_in == [300]  # the whole is not searched where its beginnings have shown something
    assert any("in the first seconds" in stage for stage, _ in stages)
    assert [share for _, share in stages] == sorted(share for _, share in stages)


def test_where_beginnings_cannot_be_fitted_the_whole_is_searched(session, monkeypatch):
    def not_run(*given, options):
        raise SolveError("no valve")

    def fitted(study, tell):
        fits.append(study)
        return SimpleNamespace(study=study, fit=study, linearised=())

    fits, cleaned, quiet = [], object(), SimpleNamespace(options=LONG.identification)
    monkeypatch.setattr(leading_segments, "_isolate_in_segments", not_run)
    monkeypatch.setattr(leading_segments, "fit_nominal", fitted)
    monkeypatch.setattr(leading_segments, "_without_outliers", lambda nominal: nominal)
    monkeypatch.setattr(leading_segments, "is_adequate", lambda fit, options: fit is cleaned)
    whole = prepare_session(session, options=LONG.identification)
    for calm, left, expected in (
        (whole, whole, [whole]), (whole, cleaned, [whole, cleaned]), (quiet, quiet, [whole, quiet])
    ):  # again without bursts of noise, or what is saturated
        fits.clear()
        monkeypatch.setattr(leading_segments, "without_beginnings", lambda prepared, _: prepared)
        monkeypatch.setattr(leading_segments, "without_bursts", lambda *_, calm=calm: calm)
        monkeypatch.setattr(leading_segments, "without_saturation", lambda *_, left=left: left)
        nominal, known = fit_coarse_to_fine(whole, lambda stage, share: None, options=LONG)
        assert nominal.study is left and known == () and fits == expected


def test_what_hardly_helps_is_left_and_more_so_far_from_the_records(session):
    whole = prepare_session(session)
    assert whole.negligible_reduction(1.4e3, 1e3) == pytest.approx(OPTIONS.fit.relative_ftol * 400.0)
    assert whole.negligible_reduction(1e6, 1e3) == pytest.approx(
        OPTIONS.fit.negligible_share * (1e6 - OPTIONS.fit.inadequate_ratio * 1e3)
    )
    assert whole.negligible_reduction(1e3, 1e3) == whole.negligible_reduction(0.9e3, 1e3) == 0.0


@pytest.mark.parametrize("in_set, taken", [(["a"], ["a", "b", "c"]), (["a", "b"], ["a", "b", "c"]), ([], ["a", "b"])])
def test_what_is_little_behind_the_answer_set_of_the_beginnings_is_taken_along(monkeypatch, in_set, taken):
    """Half a deviation in evidence had left the truth behind, and the whole session named its rival for sure."""
    behind = {"a": 0.0, "b": 6.5, "c": 17.0, "d": 19.0}
    found = [SimpleNamespace(label=label, evidence=by, fit=label) for label, by in behind.items()]
    alike = [one for one in found if one.label in in_set]
    isolation = SimpleNamespace(nominal=None, found=found, answer_set=alike, nearest=None)
    monkeypatch.setattr(leading_segments, "answer_set_width", lambda nominal, best: 6.0)
    assert leading_segments._taken_along(isolation, options=DIAGNOSIS) == taken
    isolation.nearest = "far"  # another valve's: the whole is asked for that cause alone
    assert leading_segments._taken_along(isolation, options=DIAGNOSIS) == ["far"]
