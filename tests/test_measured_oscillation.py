"""A measured valve that oscillates by itself where the stated one rests: told before anything is fitted, with what may
have it do so.
"""

import datetime
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_plant import draw_bench, write_bench_session

import valvesim as vs
from valvesim.diagnosis.wording import oscillation_words
from valvesim.identification import measured_oscillation as module
from valvesim.identification import study
from valvesim.identification.candidates import Candidate, candidates_of
from valvesim.identification.measured_oscillation import MeasuredOscillation, Onset, measured_oscillation
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session, with_records
from valvesim.reports.diagnosis.page import write_report
from valvesim.valve.catalogue import CATALOGUE

OF_PLANT = 0.5  # of the flexures' stiffness is lost; the plant begins to oscillate at 0.4


@pytest.fixture(scope="module")
def squealing(tmp_path_factory):
    """The folder of a session of a valve with cracked flexures, on a bench that ripples and warms."""
    folder = tmp_path_factory.mktemp("squealing")
    case, bench = draw_bench(
        7104, "effect", name="flexure_stiffness_loss", imperfections=("ripple", "warming", "skew"), duration=0.3
    )
    (loss,) = (figures["loss"] for _, figures in case.hidden)
    write_bench_session(case, bench, folder, OF_PLANT / loss)
    return folder


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("healthy")
    case, bench = draw_bench(2946369, "none", imperfections=("ripple",), duration=0.3)
    write_bench_session(case, bench, folder)
    return prepare_session(load_session(folder))


def with_candidates(monkeypatch, *names):
    monkeypatch.setattr(study, "candidates_of", lambda *args: tuple(c for c in candidates_of(*args) if c.name in names))


def with_few_candidates(monkeypatch):
    with_candidates(
        monkeypatch, "flexure_stiffness_loss", "coil_turns_loss", "parameter:armature_damping", "sensor_bias"
    )


def test_a_valve_that_oscillates_by_itself_is_told_with_what_may_cause_it(squealing, monkeypatch, tmp_path):
    with_few_candidates(monkeypatch)
    monkeypatch.setattr("valvesim.diagnosis.diagnose.fit_coarse_to_fine", None)  # nothing is fitted
    stages = []
    found = vs.diagnose(squealing, progress=lambda stage, share: stages.append(stage))
    assert (found.verdict, found.reason) == ("ambiguous", "oscillates") and not found.extension_offered
    flexure, figure, unknown = found.candidates
    assert flexure.label == "flexure_stiffness_loss" and flexure.location in found.location
    assert figure.label == "parameter:armature_damping" and unknown.names == ("unknown",)
    assert flexure.probability > figure.probability > unknown.probability
    assert sum(one.probability for one in found.candidates) == pytest.approx(1.0)
    assert "supply pressure" in found.no_test and found.next_test is None
    assert found.summary.startswith("The measured valve oscillates by itself, at 1")
    assert "% of flexure stiffness loss on" in found.summary
    assert "less armature damping on" in found.notes[1] and "coil" not in found.summary + found.notes[1]
    labels = [one.label for one in found.what_to_do]
    assert labels == ["the oscillation", "flexure_stiffness_loss", "parameter:armature_damping"]
    assert "what may have the valve oscillate" in stages
    write_report(found, tmp_path, valve="-", date=datetime.date(2026, 1, 1))
    page = (tmp_path / "report.html").read_text()
    assert found.to_dict()["candidates"][0]["deviance_fall"] is None and found.no_test in page
    assert "before any record" in page and "Deviance" not in page
    assert "The valve oscillates by itself" in page and "stated model" in page and "refitted model" not in page


def test_where_nothing_known_has_it_oscillate_none_is_named(squealing, monkeypatch):
    with_candidates(monkeypatch)
    found = vs.diagnose(squealing)
    assert (found.verdict, found.reason, found.candidates) == ("unknown", "oscillates", ())
    assert "no known effect would have it do so, nor any figure" in found.summary and len(found.what_to_do) == 1


def test_it_begins_where_the_plant_does(squealing, monkeypatch):
    with_few_candidates(monkeypatch)
    found = measured_oscillation(prepare_session(load_session(squealing)))
    onsets = {one.candidate.label: one for one in found.onsets}
    flexure = onsets["flexure_stiffness_loss"]
    assert 0.35 < flexure.above_neutral < OF_PLANT and flexure.frequency > found.frequency  # it falls with the loss
    assert found.records >= 3 and set(onsets) == {"flexure_stiffness_loss", "parameter:armature_damping"}


def hum(t, y, k):
    return y + 0.3 * y.std() * np.sqrt(2.0) * np.sin(2.0 * np.pi * 50.0 * t)


def sine(t, y, k):
    return y.mean() + 3.0 * y.std() * np.sin(2.0 * np.pi * 110.0 * t)


@pytest.mark.parametrize("read, is_driven, tells", [
    (lambda t, y, k: y, False, False),
    (hum, False, False),
    (lambda t, y, k: 10.0 * y, False, False),
    (lambda t, y, k: y + y.std() * np.random.default_rng(k).normal(size=len(t)), False, False),
    (sine, True, False),
    (sine, False, True),
])  # fmt: skip
def test_what_hums_is_noisy_or_driven_does_not_oscillate_by_itself(healthy, read, is_driven, tells):
    records, known = [], replace(healthy, candidates=())
    for k, predictor in enumerate(healthy.predictors):
        record = predictor.record
        names = (*record.outputs, record.command) if is_driven else record.outputs
        values = record.values | {name: read(record.time, record.values[name], k) for name in names}
        records.append(replace(record, values=values))
    assert (measured_oscillation(with_records(known, records, ())) is not None) == tells


def test_a_pump_whose_ripple_goes_to_the_pilot_pressures_is_no_valve_that_oscillates(tmp_path):
    """One of 20 bar was told as the valve's oscillation, for half of two channels was one pressure."""
    case, bench = draw_bench(8202, "none", imperfections=("ripple",), duration=0.3)
    assert case.channels == ("spool_position", "nozzle_pressure_1")
    runs = tuple(replace(run, ripple=(2e6, 200.0, run.ripple[2])) for run in case.runs)
    write_bench_session(replace(case, runs=runs), bench, tmp_path)
    assert measured_oscillation(prepare_session(load_session(tmp_path))) is None


def part_of(record, samples):
    values, usable = ({name: each[samples] for name, each in of.items()} for of in (record.values, record.usable))
    return replace(record, time=record.time[samples] - record.time[samples][0], values=values, usable=usable)


@pytest.mark.parametrize("least_periods, tells", [(10.0, False), (4.0, True)])
def test_few_periods_tell_no_oscillation(squealing, monkeypatch, least_periods, tells):
    with_few_candidates(monkeypatch)
    own = replace(IDENTIFICATION.self_oscillation, least_periods=least_periods)
    session = load_session(squealing)
    records = [part_of(record, slice(0, 45)) for record in session.training]  # some eight periods
    short = prepare_session(
        replace(session, records=tuple(records)), options=replace(IDENTIFICATION, self_oscillation=own)
    )
    assert (measured_oscillation(short) is not None) == tells


def of_readings(prepared, read, command=lambda t, values, k: values):
    """A session of the same records with other readings and commands, of (time, values, which record)."""
    records = []
    for k, one in enumerate(prepared.predictors):
        record, t = one.record, one.record.time
        values = {name: read(t, record.values[name], k) for name in record.outputs}
        drive = {record.command: command(t, record.values[record.command], k)}
        records.append(replace(record, values=record.values | values | drive))
    return with_records(prepared, records, ())


def test_a_meter_that_hums_while_the_valve_rests_tells_no_oscillation(healthy):
    """Of a spool that stands still a hum of 1.5 um was the whole motion."""
    assert "spool_position" in healthy.predictors[0].record.outputs
    rest = of_readings(
        healthy,
        lambda t, y, k: y.mean() + 4e-3 * abs(y).max() * np.sin(2.0 * np.pi * 50.0 * t),
        lambda t, i, k: np.full(len(t), 1e-3),
    )
    assert measured_oscillation(rest) is None


def test_a_small_sine_about_a_bias_drives_the_valve(healthy):
    """It was no part of the bias, and readings of a wrong unit were an oscillation whatever the inputs do."""
    turn, known = 2.0 * np.pi * 110.0, replace(healthy, candidates=())

    def told(command):
        return measured_oscillation(of_readings(known, sine, command)) is not None

    assert not told(lambda t, i, k: 5e-3 + 3e-4 * np.sin(turn * t)) and told(lambda t, i, k: np.full(len(t), 5e-3))


def test_a_load_pressure_that_answers_hides_no_oscillation_and_a_slow_record_neither(squealing, monkeypatch):
    with_few_candidates(monkeypatch)
    session = load_session(squealing)
    channel = next(name for name in session.training[0].outputs if name in ("spool_position", "load_flow"))

    def with_load(record):
        y = record.values[channel]
        load = record.values["load_pressure"] + 1.2e6 * (y - y.mean()) / y.std()
        return replace(record, values=record.values | {"load_pressure": load})

    def slow(record):
        return replace(part_of(record, slice(None, None, 100)), name=f"slow_{record.name}")

    loaded = [with_load(record) for record in session.training]
    found = measured_oscillation(prepare_session(replace(session, records=(*map(slow, loaded), *loaded))))
    assert found.records == len(loaded) and found.rate == 1000.0


def test_where_the_first_record_rests_the_others_tell_the_onset(squealing, monkeypatch):
    """At a low supply pressure nothing oscillates: the onset was looked for in the first record alone."""
    with_few_candidates(monkeypatch)
    session = load_session(squealing)
    at_rest = session.training[0]
    supply = np.full(len(at_rest.time), 1.5e6)
    means = {name: np.full(len(at_rest.time), at_rest.values[name].mean()) for name in at_rest.outputs}
    low = replace(at_rest, name="low", values=at_rest.values | means | {"supply_pressure": supply})
    found = measured_oscillation(prepare_session(replace(session, records=(low, *session.training))))
    assert "flexure_stiffness_loss" in {one.candidate.label for one in found.onsets}


@pytest.mark.parametrize("damping", [
    lambda c, p: c.armature_damping / (0.5 - p.loss),  # none at its bound
    lambda c, p: c.armature_damping * np.nan,
])  # fmt: skip
def test_an_effect_of_a_user_that_makes_no_sense_at_its_bound_ends_no_diagnosis(squealing, damping):
    flexure = CATALOGUE["flexure_stiffness_loss"]
    effect = replace(flexure, coefficients=lambda c, p, parts: c._replace(armature_damping=damping(c, p)))
    prepared = prepare_session(load_session(squealing))
    assert module._onset(prepared, prepared.predictors[:1], Candidate(effect.name, effect), 1.0) is None


def test_a_stated_valve_that_oscillates_too_is_fitted(squealing, monkeypatch):
    monkeypatch.setattr(module, "least_stable_mode", lambda predictors, variant: (1.0, 200.0))
    assert measured_oscillation(prepare_session(load_session(squealing))) is None


def test_a_stated_valve_whose_readings_have_that_line_is_fitted(squealing):
    prepared = prepare_session(load_session(squealing))
    reads = {predictor.record.name: predictor.record.values for predictor in prepared.predictors}
    options, record = prepared.options.self_oscillation, prepared.predictors[0].record
    line = module._strongest_line(record, record.outputs[0], options=options)
    assert not module._is_its_own(line, reads, options=options)


@pytest.mark.parametrize("onset, rate, seen", [(200.0, 1000.0, 200.0), (790.0, 1000.0, 210.0), (1300.0, 1000.0, 300.0)])
def test_a_frequency_is_compared_as_samples_show_it(onset, rate, seen):
    assert module._octaves(onset, seen, rate) == pytest.approx(0.0, abs=1e-12)
    assert module._octaves(onset, 2.0 * seen, rate) == pytest.approx(1.0)


def oscillating(*onsets, records=2):
    return MeasuredOscillation(220.0, 1000.0, records, onsets, None, None)


def test_what_may_cause_it_is_told_with_its_size_and_frequency():
    def of_figure(name, nominal, above_neutral, *, logarithmic=False, unit="m"):
        figure = SimpleNamespace(name=name, nominal=nominal, logarithmic=logarithmic, unit=unit, of_network=False)
        return Onset(Candidate(f"parameter:{name}", parameter=figure), above_neutral, 750.0)

    figure_alone = of_figure("armature_arm", 0.02, 0.005)
    told, figures = oscillation_words(oscillating(
        Onset(Candidate("flexure_stiffness_loss", CATALOGUE["flexure_stiffness_loss"]), 0.39, 261.0),
        Onset(Candidate("spool_lap", CATALOGUE["spool_lap"]), 2e-5, 261.0),
        figure_alone, of_figure("null_gap_difference", 0.0, -2e-5),
        of_figure("armature_damping", 1e-3, np.log(0.5), logarithmic=True),
    ))  # fmt: skip
    assert "at 220 Hz in 2 records" in told and "from 39 % of flexure stiffness loss on (at 261 Hz)" in told
    assert "0.02 mm of spool lap" in told and "are in the notes" in told
    viscosity = Onset(Candidate("oil_viscosity_grade", CATALOGUE["oil_viscosity_grade"]), -0.7, 261.0)
    assert "from 30 % of oil viscosity grade down" in oscillation_words(oscillating(viscosity))[0]
    assert "no known effect would have it do so; figures" in oscillation_words(oscillating(figure_alone))[0]
    assert "25 % more armature arm on (at 750 Hz, which samples at 1000 Hz show lower)" in figures
    assert "less null gap difference" in figures and "50 % less armature damping" in figures
    (alone,) = oscillation_words(oscillating(records=1))
    assert "in one record" in alone and alone.endswith("no known effect would have it do so, nor any figure")
