"""A stated valve that oscillates by itself where the measured one rests: told before anything is fitted."""

import datetime
from dataclasses import replace

import numpy as np
import pytest
from bench_plant import draw_bench, write_bench_session

import valvesim as vs
from valvesim.errors import SolveError
from valvesim.identification import self_oscillation as module
from valvesim.identification.fit import predict_readings
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION
from valvesim.identification.self_oscillation import _band_rms, self_oscillation
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session, with_records
from valvesim.reports.diagnosis.page import draw, write_report


@pytest.fixture(scope="module")
def session_of_soft_tube(tmp_path_factory):
    """The folder of a healthy valve's session that states a flexure tube half as stiff as the measured one's."""
    folder = tmp_path_factory.mktemp("soft_tube")
    case, bench = draw_bench(2946369, "none", imperfections=("skew",), duration=0.3)
    write_bench_session(case, bench, folder)
    session = folder / "session.toml"
    stated = '[valve]\nspring_tube_stiffness = "5 N*m/rad"\n\n[[records]]'
    session.write_text(session.read_text().replace("[[records]]", stated, 1))
    return folder


def test_records_at_rest_are_not_of_a_valve_that_oscillates_by_itself(session_of_soft_tube, monkeypatch, tmp_path):
    monkeypatch.setattr("valvesim.diagnosis.diagnose.fit_coarse_to_fine", None)  # nothing is fitted
    found = vs.diagnose(session_of_soft_tube)
    assert (found.verdict, found.reason) == ("unknown", "other_valve") and not found.extension_offered
    assert "the stated valve oscillates by itself, at 2" in found.summary and "are its figures right?" in found.summary
    assert found.what_to_do[0].label == "the stated valve" and list(draw(found)) == ["traces"]
    write_report(found, tmp_path, valve="-", date=datetime.date(2026, 1, 1))
    page = (tmp_path / "report.html").read_text()
    assert "stated model" in page and "refitted model" not in page and "Gain of the extended model" not in page
    assert "spring_tube_stiffness" in found.extended_scenario and found.to_dict()["alarm_level"] is None


def test_the_frequency_is_that_of_the_run_and_a_valve_that_is_measured_so_is_none_other(session_of_soft_tube):
    prepared = prepare_session(load_session(session_of_soft_tube))
    found = self_oscillation(prepared)
    own = predict_readings(prepared, prepared.nominal.at(np.zeros(len(prepared.nominal.parameters))))
    spool, rate = own[0]["spool_position"], prepared.predictors[0].record.pace
    spectrum = np.abs(np.fft.rfft(spool - spool.mean()))
    spectrum[:4] = 0.0  # the command's
    assert abs(np.log2(np.argmax(spectrum) * rate / len(spool) / found.frequency)) < 0.5
    records = [
        replace(one.record, values={**one.record.values, **read})
        for one, read in zip(prepared.predictors, own, strict=True)
    ]
    assert self_oscillation(with_records(prepared, records, ())) is None


@pytest.mark.parametrize("steady_from, last", [(0, 0.0), (1, IDENTIFICATION.self_oscillation.reach)])
def test_a_stated_valve_that_rests_or_whose_neighbours_do_is_fitted(
    session_of_soft_tube, monkeypatch, steady_from, last
):
    prepared = prepare_session(load_session(session_of_soft_tube))
    departs, asked = module._least_stable_mode, []

    def departure(prepared, point):
        asked.append(float(np.linalg.norm(point)))
        growth, frequency = departs(prepared, point)
        return growth - 1e3 * (len(asked) > steady_from), frequency

    monkeypatch.setattr(module, "_least_stable_mode", departure)
    assert self_oscillation(prepared) is None and asked[-1] == pytest.approx(last)


def test_where_a_valve_near_it_has_no_state_at_rest_the_stated_one_is_fitted(session_of_soft_tube, monkeypatch):
    prepared = prepare_session(load_session(session_of_soft_tube))
    own = module._least_stable_mode

    def mode(prepared, point):
        if point.any():
            raise SolveError("no stable null")
        return own(prepared, point)

    monkeypatch.setattr(module, "_least_stable_mode", mode)
    assert self_oscillation(prepared) is None


def test_the_rms_about_a_frequency_is_that_of_the_wave_there():
    t = np.arange(500) / 1e3
    values = 3.0 + 2.0 * np.sin(2.0 * np.pi * 100.0 * t) + 5.0 * np.sin(2.0 * np.pi * 20.0 * t)
    assert _band_rms(values, 1e3, 110.0) == pytest.approx(np.sqrt(2.0), rel=1e-6)
    assert _band_rms(values, 1e3, 300.0) == pytest.approx(0.0, abs=1e-9)
