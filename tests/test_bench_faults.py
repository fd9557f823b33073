"""The bench, not the valve; records that do not belong together; another valve: each told as what it is."""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_plant import CALIBRATION, IMPERFECTIONS, READINGS, draw_bench, write_bench_session
from hidden_plant import draw, noisy, responses, truth, write_files, write_session
from hypothesis import given, settings
from hypothesis import strategies as st

import valvesim as vs
from valvesim.diagnosis import apart, bench_faults, detection
from valvesim.diagnosis.advice import BY_FIGURE, BY_PORT, advice_on_causes, advice_on_unknown
from valvesim.diagnosis.bench_faults import BenchHypothesis, _likeliest
from valvesim.diagnosis.conclusion import figures_at_limit
from valvesim.diagnosis.detection import _is_stretched, is_other_valve
from valvesim.diagnosis.holdout_gain import _change_interval
from valvesim.diagnosis.joint_errors import error_places, without_instrument_errors
from valvesim.diagnosis.known_faults import BenchFault
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.result import AMBIGUOUS, CAUSE, NO_DISCREPANCY, OTHER_VALVE, RECORDS_APART
from valvesim.diagnosis.score_test import score_test
from valvesim.diagnosis.wording import summary_text
from valvesim.errors import SolveError
from valvesim.identification import input_choice
from valvesim.identification.between_samples import EdgeTime
from valvesim.identification.fit import evaluate_fit, predict_readings
from valvesim.identification.fit_jacobian import jacobian_of, linearise_fit
from valvesim.identification.input_choice import excess_after_jumps, searched_edges
from valvesim.identification.input_waves import (
    MODULATED,
    _powers,
    fitted_waves,
    linear_reductions,
    outstanding_frequencies,
    tuned_waves,
    wave_parameters,
    with_parameters,
)
from valvesim.identification.instrument_errors import (
    CLOCK_RATE,
    METER_DRIFT,
    METER_ZERO,
    contrasts,
    input_shifts,
    instrument_errors,
    meter_drifts,
    meter_linearity,
)
from valvesim.identification.nominal_fit import _retuned, linearise_nominal
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION
from valvesim.identification.prior import largest_reading
from valvesim.identification.refinement import refined
from valvesim.identification.session import Record
from valvesim.identification.study import prepare_session, with_records
from valvesim.units import quantities
from valvesim.valve.additive_term import PORTS
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import Reading

TIME = np.arange(1000) / 1e3
RECORDS = tuple(Record(name, TIME, {"spool_position": 0.0 * TIME, "current": TIME}, {"spool_position": TIME >= 0.0})
                for name in ("a", "b"))  # fmt: skip


def test_the_frequency_of_a_ripple_is_found_to_a_fraction_of_a_turn():
    noise = np.random.default_rng(0).normal(size=(2, len(TIME)))
    predictors, readings = [], []
    for record, own in zip(RECORDS, noise, strict=True):
        values = {**record.values, "spool_position": own + 1.5 * np.sin(2.0 * np.pi * 104.37 * TIME + own[0])}
        predictors.append(SimpleNamespace(record=replace(record, values=values)))
        readings.append({"spool_position": 0.0 * TIME})
    found = outstanding_frequencies(SimpleNamespace(predictors=predictors, options=IDENTIFICATION), readings, 15.0)
    assert found[0] == pytest.approx(104.37, abs=0.05) and len(found) == 1
    quiet = [SimpleNamespace(record=replace(p.record, values={**p.record.values, "spool_position": own}))
             for p, own in zip(predictors, noise, strict=True)]  # fmt: skip
    assert outstanding_frequencies(SimpleNamespace(predictors=quiet, options=IDENTIFICATION), readings, 15.0) == []


@pytest.mark.parametrize("levels", [[0, 1, 0, -1], [0, 1, 2, 1, 0, -1, -2, -1], [1, -1]])
def test_what_goes_with_the_commands_is_no_wave_and_a_ripple_beside_it_is_one(levels):
    """What a cause leaves of steps had been told as a hum at the steps' own frequency, in four of 300 sessions."""
    rng, predictors, readings, hold = np.random.default_rng(4), [], [], int(len(TIME) / 4.0 / len(levels))
    steps = np.resize(np.repeat(np.array(levels, dtype=float), hold), len(TIME))
    for record in RECORDS:
        for ripple in (0.0, 0.8):
            left = 1.5 * steps + ripple * np.sin(2.0 * np.pi * 94.6 * TIME) + rng.normal(size=len(TIME))
            values = {name: np.zeros(len(TIME)) for name in record.values}
            values |= {record.command: 2e-3 * steps, "spool_position": left}
            record_ = replace(record, values=values, usable={"spool_position": TIME >= 0.0})
            predictors.append((ripple, SimpleNamespace(record=record_)))
            readings.append((ripple, {"spool_position": 0.0 * TIME}))

    def found(amplitude):
        own = [predictor for ripple, predictor in predictors if ripple == amplitude]
        study = SimpleNamespace(predictors=own, options=IDENTIFICATION)
        return outstanding_frequencies(study, [read for ripple, read in readings if ripple == amplitude], 15.0)

    assert found(0.0) == [] and found(0.8) == [pytest.approx(94.6, abs=0.3)]


@settings(max_examples=30)
@given(st.integers(0, 9), st.floats(20.0, 300.0), st.sampled_from(["sine", "nothing", "constant", "chirp", "noise"]))
def test_a_ripple_is_found_whatever_the_command_has_elsewhere(seed, frequency, command):
    rng = np.random.default_rng(seed)
    of = {
        "sine": np.sin(2.0 * np.pi * 5.0 * TIME), "nothing": 0.0 * TIME, "constant": 0.0 * TIME + 3.0,
        "chirp": np.sin(2.0 * np.pi * (2.0 + 100.0 * TIME) * TIME),
        "noise": np.cumsum(rng.normal(size=len(TIME))),
    }  # fmt: skip
    predictors = []
    for record in RECORDS:
        left = 0.8 * np.sin(2.0 * np.pi * frequency * TIME + rng.uniform(0.0, 6.0)) + rng.normal(size=len(TIME))
        values = {name: np.zeros(len(TIME)) for name in record.values}
        values |= {record.command: 1e-3 * of[command], "spool_position": left}
        predictors.append(SimpleNamespace(record=replace(record, values=values)))
    study = SimpleNamespace(predictors=predictors, options=IDENTIFICATION)
    found = outstanding_frequencies(study, [{"spool_position": 0.0 * TIME}] * len(predictors), 15.0)
    assert any(abs(one - frequency) < 0.3 for one in found)


@pytest.mark.parametrize("channel", ["load_flow", "spool_position"])
def test_a_ripple_that_an_output_modulates_is_found_at_its_own_frequency(channel):
    rng, predictors, readings = np.random.default_rng(3), [], []
    for record in RECORDS:
        flow = np.sin(2.0 * np.pi * 4.0 * TIME) + np.sin(2.0 * np.pi * 11.0 * TIME)
        ripple = np.sin(2.0 * np.pi * 94.6 * TIME + rng.uniform(0.0, 6.0))
        measured = {channel: flow * (1.0 + ripple) + rng.normal(size=len(TIME)), "current": TIME}
        predictors.append(SimpleNamespace(record=replace(record, values=measured, usable={channel: TIME >= 0.0})))
        readings.append({channel: flow})
    found = outstanding_frequencies(SimpleNamespace(predictors=predictors, options=IDENTIFICATION), readings, 15.0)
    assert any(abs(frequency - 94.6) < 0.05 for frequency in found)


def test_a_ripple_in_one_output_is_not_lost_beside_outputs_that_show_none():
    rng, predictors, readings = np.random.default_rng(5), [], []
    others = ("spool_position", "nozzle_pressure_1", "nozzle_pressure_2", "armature_angle")
    for record in RECORDS:
        read = {name: np.sin(2.0 * np.pi * (4.0 + k) * TIME) for k, name in enumerate(("load_flow", *others))}
        measured = {name: values + rng.normal(size=len(TIME)) for name, values in read.items()}
        measured["load_flow"] += 0.3 * read["load_flow"] * np.sin(2.0 * np.pi * 94.6 * TIME + rng.uniform(0.0, 6.0))
        usable = {name: TIME >= 0.0 for name in read}
        predictors.append(SimpleNamespace(record=replace(record, values=measured | {"current": TIME}, usable=usable)))
        readings.append(read)
    study = SimpleNamespace(predictors=predictors, options=IDENTIFICATION)
    power = _powers(study, readings, np.arange(5.0, 400.0, 0.5))
    together, flow = power[-1], power[1 + MODULATED.index("load_flow")]
    assert flow.max() / np.median(flow) > 7.0 > together.max() / np.median(together)
    assert outstanding_frequencies(study, readings, 7.0) == [pytest.approx(94.6, abs=0.3)]


@pytest.mark.parametrize(
    "left, known, fitted",
    [
        ((0.03e6, 0.9e6), (), ["a"]),  # the first explains nearly all
        ((0.5e6, 0.04e6, 0.01e6), (), ["a", "b"]),
        ((0.5e6, 0.4e6, 0.3e6), (), ["a", "b", "c"]),
        ((0.9e6, 0.8e6, 0.7e6, 0.6e6, 0.4e6), (), ["a", "b", "c", "d", "e"]),  # few, until one explains much
        ((0.5e6, 0.4e6, 0.3e6), ("k",), ["k"]),  # what is known from elsewhere is gone on with, and nothing sought
    ],
)
def test_the_bench_is_sought_beside_the_first_cause_that_explains_nearly_all(monkeypatch, left, known, fitted):
    rows, asked = 1e4, []
    base = SimpleNamespace(fit=SimpleNamespace(chi_square=1e6 + rows, rows=rows), study=None)

    def start_of(name):
        return (SimpleNamespace(candidate=SimpleNamespace(name=name, plainest=name)),)

    def fit_from(nominal, start, few=None, worthwhile=None):
        own = start_of(start) if known else start
        asked.append(own[0].candidate.name)
        return SimpleNamespace(chi_square=left[len(asked) - 1] + rows, rows=rows, point=None, fitted=own)

    for name, stub in {
        "has_implausible_delays": lambda study, point: False,
        "is_adequate": lambda fit, *, options: False,
        "is_other_valve": lambda nominal, fit, *, options: False,
        "_tells_as_much": lambda fit, start, *, options: False,
        "likeliest_starts": lambda nominal, scores: map(start_of, "abc" if len(left) < 5 else "abcdef"),
        "fit_from_prior": fit_from,
        "continue_fit": fit_from,
        "score_test": lambda *_, **__: SimpleNamespace(linearised=(), columns=()),
        "term_score_test": lambda *_, **__: None,
        "assembled": lambda *_: None,
        "_tuned_beside": lambda *_: None,
        "_likeliest": lambda *_, options: None,
        "with_inputs_beside": lambda at, beside: at,
        "best_inputs": lambda at, fit, few: (at, fit),
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    cause = bench_faults.likeliest_cause(base, "scores", known, options=DIAGNOSIS)
    at, scores, fit = bench_faults.with_faults_beside_cause(base, "scores", cause, bool(known), options=DIAGNOSIS)
    assert (at, scores, asked) == (base, "scores", fitted)
    assert fit.chi_square == min(left[: len(asked)]) + rows


@pytest.mark.parametrize(
    "late, left, asked",
    [
        ((False,), [1e4], ["linear"]),
        ((True, False), [1e4, 1e4], ["run", "linear"]),
        ((True, True), [1e4, 2e3], ["run", "linear"]),  # they are run once
        ((True, True), [1e4, 9e2, 5e2], ["run", "run", "linear"]),  # unless the cause left far more then
        ((True, True), [-1e2, -2e2], ["run", "linear"]),  # no more than noise
    ],
)
def test_where_sensors_seem_late_beside_a_cause_the_ways_of_the_commands_are_run(monkeypatch, late, left, asked):
    tried, delays = [], iter(late)
    base = SimpleNamespace(fit=SimpleNamespace(chi_square=1e6, rows=1e4), study=None)
    fits = [SimpleNamespace(chi_square=1e4 + one, rows=1e4, point=None, fitted=()) for one in left]
    fit = fits[0]
    for name, stub in {
        "has_implausible_delays": lambda study, point: next(delays),
        "is_other_valve": lambda nominal, fit, *, options: False,
        "leaves_noise": lambda fit, study, *, options: True,
        "score_test": lambda *_, **__: SimpleNamespace(linearised=(), columns=()),
        "term_score_test": lambda *_, **__: None,
        "assembled": lambda *_: None,
        "_tuned_beside": lambda *_: None,
        "_likeliest": lambda *_, options: None,
        "with_inputs_beside": lambda at, beside: tried.append("linear") or at,
        "best_inputs": lambda at, fit, few: tried.append("run") or (at, fits[len(tried)]),
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    bench_faults.with_faults_beside_cause(base, "scores", fit, False, options=DIAGNOSIS)
    assert tried == asked


@pytest.mark.parametrize(
    "left, promised, taken",
    [
        (1.9e4, 0.0, True),
        (9e4, 8e4, True),  # it is on its way there
        (2e6, 1e6, False),  # begun from a nominal fit that is lost, it is lost too
        (None, 0.0, False),
    ],
)
def test_another_way_is_taken_where_the_cause_leaves_no_more_under_it(monkeypatch, left, promised, taken):
    rows, fit = 1e4, SimpleNamespace(chi_square=2e4, rows=1e4, point=None, fitted=())
    base, other = (SimpleNamespace(fit=SimpleNamespace(chi_square=9e8, rows=rows), study=None) for _ in range(2))
    under = None if left is None else SimpleNamespace(
        chi_square=left, predicted_reduction=promised, rows=rows, point=None, fitted=()
    )  # fmt: skip
    for name, stub in {
        "has_implausible_delays": lambda study, point: False,
        "is_other_valve": lambda nominal, fit, *, options: False,
        "leaves_noise": lambda fit, study, *, options: True,
        "fit_hypothesis": lambda nominal, start, point, linearisations: under if nominal is other else fit,
        "point_under": lambda other, nominal, point: point,
        "score_test": lambda *_, **__: SimpleNamespace(linearised=(), columns=()),
        "term_score_test": lambda *_, **__: None,
        "assembled": lambda *_: None,
        "_tuned_beside": lambda *_: None,
        "_likeliest": lambda *_, options: None,
        "with_inputs_beside": lambda at, beside: other,
        "fitted_under": lambda nominal, at: at,
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    at, _, found = bench_faults.with_faults_beside_cause(base, "scores", fit, False, options=DIAGNOSIS)
    assert (at, found) == ((other, under) if taken else (base, fit))


@pytest.mark.parametrize(
    "name, other, left, more",
    [
        ("spool_lap", "spool_coulomb_friction", 0.9, True),
        ("spool_lap", "spool_coulomb_friction", 1.1, False),
        ("spool_thermal_pinch", "spool_coulomb_friction", 0.9, False),  # the same law with a feature more
        ("spool_thermal_pinch", "spool_coulomb_friction", 0.4, True),
        ("spool_coulomb_friction", "spool_thermal_pinch", 0.9, True),
    ],
)
def test_the_plainer_of_two_alike_laws_stands_unless_the_other_leaves_far_less(name, other, left, more):
    rows = 1e4

    def fit_of(name, excess):
        candidate = SimpleNamespace(name=name, plainest=CATALOGUE[name].plainer or name)
        return SimpleNamespace(chi_square=rows + excess, rows=rows, fitted=[SimpleNamespace(candidate=candidate)])

    most = bench_faults._excess_to_beat(fit_of(name, 0.0).fitted, fit_of(other, 1e4), options=DIAGNOSIS)
    assert (left * 1e4 < most) is more


@pytest.mark.parametrize("ends, told", [(8e4, False), (4e6, True), (None, True)])
def test_a_cause_is_fitted_to_its_end_before_records_are_those_of_another_valve(monkeypatch, ends, told):
    rows, started = 1e4, SimpleNamespace(chi_square=4e6, rows=1e4, point=None, fitted=())
    base = SimpleNamespace(fit=SimpleNamespace(chi_square=5e4, rows=rows), study=None)
    ended = None if ends is None else SimpleNamespace(chi_square=ends, rows=rows, point=None, fitted=())
    looked = []
    for name, stub in {
        "is_other_valve": lambda nominal, fit, *, options: fit.chi_square > 1e6,
        "leaves_noise": lambda fit, study, *, options: True,
        "continue_from": lambda nominal, fit, worthwhile: ended if worthwhile == np.inf else None,
        "has_implausible_delays": lambda study, point: False,
        "score_test": lambda *_, **__: looked.append(1) or SimpleNamespace(linearised=(), columns=()),
        "term_score_test": lambda *_, **__: None,
        "assembled": lambda *_: None,
        "_tuned_beside": lambda *_: None,
        "_likeliest": lambda *_, options: None,
        "with_inputs_beside": lambda at, beside: at,
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    _, _, fit = bench_faults.with_faults_beside_cause(base, "scores", started, False, options=DIAGNOSIS)
    assert bool(looked) is not told and fit is (ended or started)


@pytest.mark.parametrize(
    "at, left, beside, other",
    [
        ((10.0, -10.0, 10.0, 3.0, 40.0), 3e3, 1e6, True),
        ((10.0, -10.0, 9.0, 3.0, 10.0), 3e3, 1e6, False),  # the third is of a sensor: a cause may carry two there
        ((10.0, -10.0, 10.0, 3.0, 40.0), 2e4, 1.9e5, False),  # they do not explain so much more
        ((10.0, -10.0, 10.0, 3.0, 40.0), 10.0, 1e4, False),  # the cause comes near
        ((10.0, -10.0, 10.0, 3.0, 40.0), 4e5, 2.1e5, True),  # it is a hundred variances off, as they are
        ((10.0, -10.0, 10.0, 3.0, 40.0), 4e8, 1.9e5, False),
        ((10.0, -10.0, 9.0, 3.0, 40.0), 4e5, 2.1e5, False),
    ],
)
def test_figures_at_their_limits_that_no_cause_could_stand_for_are_another_valve(monkeypatch, at, left, beside, other):
    rows, reach = 2e3, IDENTIFICATION.prior.reach
    assert reach == 10.0 and DIAGNOSIS.detection.other_valve_left == 100.0
    parameters = [SimpleNamespace(is_of_valve=k < 4, sensor=None) for k in range(5)]
    study = SimpleNamespace(nominal=SimpleNamespace(parameters=parameters), options=IDENTIFICATION)
    fit = SimpleNamespace(point=np.array(at), chi_square=left + rows, rows=rows)
    likeliest = SimpleNamespace(chi_square=beside + rows, rows=rows)
    monkeypatch.setattr(detection, "is_inadequate", lambda nominal, fit, *, options: False)
    assert is_other_valve(SimpleNamespace(study=study, fit=fit), likeliest, options=DIAGNOSIS) is other


@pytest.mark.parametrize("near, other", [((), True), (("nominal",), False), (("cause",), False)])
def test_records_that_neither_the_valve_nor_a_likely_cause_comes_near_are_of_another_valve(monkeypatch, near, other):
    fit, likeliest = (SimpleNamespace(name=name, chi_square=2e4, rows=1e4) for name in ("nominal", "cause"))
    fit.point = np.zeros(1)
    study = SimpleNamespace(
        nominal=SimpleNamespace(parameters=[SimpleNamespace(is_of_valve=True, sensor=None)]), options=IDENTIFICATION
    )
    monkeypatch.setattr(detection, "is_inadequate", lambda nominal, fit, *, options: fit.name not in near)
    assert is_other_valve(SimpleNamespace(study=study, fit=fit), likeliest, options=DIAGNOSIS) is other


def test_power_is_that_of_the_fourier_sum_and_a_long_record_takes_little_memory():
    series, frequencies = np.random.default_rng(4).normal(size=len(TIME)), np.linspace(7.3, 8.1, 5)
    record = replace(RECORDS[0], values={**RECORDS[0].values, "spool_position": series})
    study = SimpleNamespace(predictors=[SimpleNamespace(record=record)], options=IDENTIFICATION)
    power = _powers(study, [{"spool_position": 0.0 * TIME}], frequencies)[0]
    left = series - np.median(series)
    most = IDENTIFICATION.wave.clipped * 1.4826 * np.median(np.abs(left))
    left = np.clip(left, -most, most)
    plain = [abs(np.sum(left * np.exp(-2j * np.pi * f * TIME))) ** 2 / (left @ left) for f in frequencies]
    np.testing.assert_allclose(power, plain, rtol=1e-9)
    time = np.arange(60_001) / 1e3
    shown = np.sin(200.0 * np.pi * time) + np.random.default_rng(6).normal(size=len(time))
    values = {name: np.zeros(len(time)) for name in record.values} | {"spool_position": shown}
    long = replace(record, time=time, values=values, usable={"spool_position": time >= 0.0})
    study = SimpleNamespace(predictors=[SimpleNamespace(record=long)], options=IDENTIFICATION)
    tracemalloc.start()
    found = outstanding_frequencies(study, [{"spool_position": 0.0 * time}], 15.0)
    most_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found[0] == pytest.approx(100.0, abs=0.01) and most_bytes < 1e8


def test_a_meter_that_drifts_far_is_no_alarm_and_any_other_figure_that_is_far_off_is():
    drift, curve = SimpleNamespace(sensor=METER_DRIFT), SimpleNamespace(sensor=METER_ZERO)
    clock, mass = SimpleNamespace(sensor=CLOCK_RATE), SimpleNamespace(sensor=None)
    for parameters, point, expected in (
        ((drift, mass), (4.0, 1.0), False), ((drift, mass), (0.0, -4.0), True), ((drift, clock), (4.0, 4.0), True),
        ((drift, curve), (4.0, -4.0), False), ((), (), False),
    ):  # fmt: skip
        study = SimpleNamespace(nominal=SimpleNamespace(parameters=parameters))
        assert _is_stretched(SimpleNamespace(study=study, fit=SimpleNamespace(point=np.array(point))), 3.8) == expected


def with_readings(session, channel, of):
    """A session of which each training record reads `of(values)` on a channel."""
    records = [replace(r, values={**r.values, channel: of(r.values[channel])}) for r in session.records]
    return replace(session, records=tuple(records))


TWO_WAY_BENDS = ["meter_linearity", "meter_cubic", "meter_symmetry"]


BENDS = [(1.0, 0, False), (2.0, 1, False), (-2.5, 2, False), (0.3, 0, True), (0.0, 0, True)]


@pytest.mark.parametrize("times, which, one_way", BENDS)
def test_a_meter_that_is_not_linear_departs_from_the_line_through_its_readings(biased_session, times, which, one_way):
    channel = "spool_position"
    session = with_readings(biased_session, channel, np.abs) if one_way else biased_session
    bends = meter_linearity(session, channel, IDENTIFICATION)
    assert [p.sensor.name for p in bends] == (["meter_bow"] if one_way else TWO_WAY_BENDS)
    bend, largest = bends[0 if one_way else which], largest_reading(session, channel)
    assert bend.deviation == IDENTIFICATION.instrument.meter_linearity * largest
    read = np.concatenate([r.values[channel] for r in session.training])
    active = bend.sensor(departure=times * bend.deviation)
    off = active.effect.reading(Reading(read, read, read), active.values) - read
    assert np.max(np.abs(off)) == pytest.approx(abs(times) * bend.deviation, abs=1e-9 * largest)
    np.testing.assert_allclose(np.polyfit(read / largest, off, 1), 0.0, atol=1e-9 * largest)


def test_a_meter_that_reads_next_to_nothing_else_has_no_bend(biased_session):
    for still in (np.zeros_like, lambda values: 5e-4 + 1e-6 * values, lambda values: 1e-4 * (values > 0.0)):
        session = with_readings(biased_session, "spool_position", still)
        assert meter_linearity(session, "spool_position", IDENTIFICATION) == ()


@given(st.integers(1, 12))
def test_contrasts_are_orthonormal_and_to_what_all_have_in_common(count):
    ways = contrasts(count)
    assert ways.shape == (count, count - 1)
    np.testing.assert_allclose(ways.T @ ways, np.eye(count - 1), atol=1e-12)
    np.testing.assert_allclose(np.ones(count) @ ways, 0.0, atol=1e-12)


def test_a_sensor_beyond_its_tolerance_is_told_and_not_given_to_its_meter(biased_fit):
    scores = score_test(biased_fit, biased_fit.fit, options=DIAGNOSIS)
    likeliest = scores.candidates[int(np.argmax(scores.z()))]
    assert likeliest.effect.name == "sensor_bias"
    assert bench_faults._meter_beyond_tolerance(scores) == likeliest.effect.channel != ""


def test_the_channel_that_drifts_with_the_oil_is_known_where_that_explains_most():
    """One of d' 8 had been zeros of its meter, one for each record of another temperature."""
    drift, bias = (CATALOGUE[name].on("armature_angle") for name in ("sensor_temperature_drift", "sensor_bias"))
    candidates = [SimpleNamespace(effect=one, equivalent=None) for one in (drift, bias, None)]
    for z, channel in (([5.0, 4.0, 1.0], "armature_angle"), ([4.0, 5.0, 1.0], None), ([1.0, 4.0, 5.0], None)):
        scores = SimpleNamespace(z=lambda z=z: np.array(z), candidates=candidates)
        assert bench_faults._drifting_meter(scores) == channel
    assert bench_faults._drifting_meter(SimpleNamespace(z=lambda: np.empty(0), candidates=[])) is None


def test_beside_a_wave_the_ends_of_each_record_do_not_count(biased_session):
    prepared = prepare_session(biased_session)
    wave = wave_parameters(prepared.session.training, "supply_pressure", 37.0, 1e6)
    drift = meter_drifts(prepared.session, prepared.options)
    plain, waving = with_parameters(prepared, drift), with_parameters(prepared, (*drift, *wave))
    assert waving.nominal.parameters == (*prepared.nominal.parameters, *drift, *wave)
    for before, one, other in zip(prepared.predictors, plain.predictors, waving.predictors, strict=True):
        late = before.record.time - before.record.time[0] >= prepared.options.wave.settling
        assert not late.all()
        late[-1] = False  # a clock that is early reads it when the run has ended
        for name, usable in before.record.usable.items():
            assert np.array_equal(one.record.usable[name], usable)
            assert np.array_equal(other.record.usable[name], usable & late)


def read_with(study, parameters, point):
    """A study measured by a plant of other nuisance parameters at a point, without noise."""
    plant = study.with_nominal(replace(study.nominal, parameters=tuple(parameters)))
    readings = predict_readings(plant, plant.nominal.at(point))
    pairs = zip(study.predictors, readings, strict=True)
    return with_records(study, [replace(one.record, values={**one.record.values, **read}) for one, read in pairs], ())


def test_a_wave_is_tuned_to_the_frequency_that_a_fit_asks_for(biased_fit):
    nominal, size = biased_fit.study.nominal, 1e6
    wave = wave_parameters(biased_fit.study.session.training, "supply_pressure", 37.0, size)
    study = with_parameters(biased_fit.study.unweighted(), wave)
    point = np.concatenate([biased_fit.fit.point, 0.3 + 0.1 * np.arange(len(wave))])
    longest = max(record.duration for record in study.session.training)
    for off in (0.004, -0.012):  # turns in the longest record
        true = [replace(p, input=replace(p.input, frequency=37.0 + off / longest)) for p in wave]
        measured = read_with(study, (*nominal.parameters, *true), point)
        before = evaluate_fit(measured, point, ())
        for start in (point, np.where(np.arange(len(point)) < len(nominal.parameters), point, 0.0)):
            fit = evaluate_fit(measured, start, ())
            parameters, turned, promised = tuned_waves(measured, fit, *linearise_fit(measured, fit))
            assert parameters[: len(nominal.parameters)] == nominal.parameters
            found = {p.input.frequency for p in parameters[len(nominal.parameters) :]}
            assert len(found) == 1 and abs(found.pop() - 37.0 - off / longest) < 0.1 * abs(off) / longest
        tuned = measured.with_nominal(replace(measured.nominal, parameters=parameters))
        at = np.concatenate([turned[: len(nominal.parameters)], point[len(nominal.parameters) :]])
        left = evaluate_fit(tuned, at, ()).chi_square - float(at @ at)
        assert promised > 0.0
        assert left < 0.05 * (before.chi_square - float(point @ point))
    fit = evaluate_fit(measured, point, ())
    _, turned, _ = tuned_waves(measured, fit, *linearise_fit(measured, fit))
    length = np.hypot(*turned[len(nominal.parameters) :].reshape(-1, 2).T)
    np.testing.assert_allclose(length, np.hypot(*point[len(nominal.parameters) :].reshape(-1, 2).T))


def test_a_wave_further_off_than_a_step_of_its_tuning_is_tuned_on(biased_fit):
    """A ripple of 1.7 bar was off by a fiftieth of a turn in each record, as the base under straight lines had asked: a
    cavitation of d' 14 was unknown for what that left (970205).
    """
    nominal, size = biased_fit.study.nominal, 1e5
    wave = wave_parameters(biased_fit.study.session.training, "supply_pressure", 37.0, size)
    study = with_parameters(biased_fit.study.unweighted(), wave)
    point = np.concatenate([biased_fit.fit.point, 0.3 + 0.1 * np.arange(len(wave))])
    longest = max(record.duration for record in study.session.training)
    off = 2.5 * study.options.wave.tuning_step / longest
    true = [replace(p, input=replace(p.input, frequency=37.0 + off)) for p in wave]
    measured = read_with(study, (*nominal.parameters, *true), point)
    afar = linearise_nominal(measured, evaluate_fit(measured, point, ()))
    ended = _retuned(afar)
    found = {p.input.frequency for p in ended.study.nominal.parameters[len(nominal.parameters) :]}
    assert len(found) == 1 and abs(found.pop() - 37.0 - off) < 0.1 * off
    left, before = (one.fit.residual @ one.fit.residual for one in (ended, afar))
    assert left < 0.01 * before


def test_samples_next_to_peaks_count_less_where_an_input_is_fitted_and_fully_again_without(biased_fit):
    """Else a healthy valve, the inputs and meters of whose bench were off a little, was "unknown": of 24 000 of
    chi-square, peaks of the leakage at wrong microseconds had 70 000.
    """
    study = biased_fit.study
    meters, errors = (of(study.session, options=study.options) for of in (meter_drifts, instrument_errors))
    assert not study.weights and not bench_faults._extended(biased_fit, meters).study.weights
    extended = bench_faults._extended(biased_fit, errors)
    assert extended.study.weights
    names = [p.name for p in extended.study.nominal.parameters]
    assert names == [p.name for p in (*study.nominal.parameters, *errors)]
    without = without_instrument_errors(extended)
    assert without.study.nominal.parameters == study.nominal.parameters and without.study.weights


def test_what_shows_without_errors_of_instruments_is_known_from_the_fit_that_has_them(biased_fit):
    study = biased_fit.study
    extended = bench_faults._extended(biased_fit, instrument_errors(study.session, options=study.options))
    scores, without = (score_test(one, one.fit, options=DIAGNOSIS)
                       for one in (extended, without_instrument_errors(extended)))  # fmt: skip
    chi_square, z = scores.without_parameters(error_places(extended.study))
    assert chi_square == pytest.approx(without.fit.chi_square, rel=0.02)
    assert np.argmax(z) == np.argmax(without.z()) and z.max() == pytest.approx(without.z().max(), rel=0.05)
    nothing, same = scores.without_parameters([])
    assert nothing <= extended.fit.chi_square and same == pytest.approx(scores.z(), abs=1e-6)


@pytest.mark.parametrize("weights, left, joins", [((), 0.0, True), (("a",), 990.0, False), (("a",), 1500.0, True)])
@pytest.mark.parametrize("z, shows", [(4.1, True), (2.7, False)])
def test_a_fault_beside_which_peaks_count_less_has_not_explained_what_shows_at_peaks_alone(
    monkeypatch, weights, left, joins, z, shows
):
    """A quadratic torque of d' 39 that shows at peaks of the leakage alone: without any fault they count less too. Nor
    may a cause go with them: eddy currents of z 18 beside an error of the leakage's meter were "no discrepancy", and a
    hysteresis of z 15 where errors of the instruments explained 87.
    """

    def fit(chi_square, weights):
        study = SimpleNamespace(weights=dict.fromkeys(weights), unweighted=lambda: None)
        return SimpleNamespace(fit=SimpleNamespace(chi_square=chi_square, point=None), study=study)

    nominal, better = fit(5000.0, ()), fit(980.0, weights)
    for name, stub in {
        "_likeliest": lambda *_, **__: BenchHypothesis((), 300.0),
        "_extended": lambda nominal, parameters: better,
        "fit_nominal_near": lambda study, point, full_weight: fit(left, weights),
        "rescored": lambda study, fit: fit,
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    cause, other = (SimpleNamespace(label=label) for label in ("cause", "other"))
    scores = SimpleNamespace(candidates=(cause, other), z=lambda: [z, 9.0], level=lambda probability: 4.0)
    monkeypatch.setattr(bench_faults, "score_test", lambda *_, **__: scores)
    of_cause = SimpleNamespace(fit=SimpleNamespace(fitted=(SimpleNamespace(candidate=cause),)))
    left_to_peaks = bool(weights) and not shows
    expected = better if joins and not left_to_peaks else None
    assert bench_faults.with_fault_left(nominal, of_cause, options=DIAGNOSIS) is expected
    monkeypatch.setattr(bench_faults, "with_inputs_reviewed", lambda nominal: nominal)
    options = replace(DIAGNOSIS, bench=replace(DIAGNOSIS.bench, most_faults=1))
    scores = SimpleNamespace(candidates=(cause,), z=lambda: [z], level=lambda probability: 4.0)
    for before, hides in ((30.0, False), (40.0, left_to_peaks)):
        shown = SimpleNamespace(candidates=(cause,), z=lambda before=before: [before])
        found, after = bench_faults.with_bench_faults(nominal, shown, options=options)
        assert (found, after) == ((better, scores) if joins and not hides else (nominal, shown))


def study_of_edges(after, right, runs=None):
    """A study of one record, whose reading is off in the few samples after an edge that is not between its `right`
    places, and no less so a little nearer.
    """
    samples = max(after) + 17
    edges = [EdgeTime("a", "current", k) for k in after]

    def run(point, near=None):
        if runs is not None:
            runs.append(point)
        read = np.zeros(samples)
        for k, (low, high), t in zip(after, right, point[1:], strict=True):
            read[k + 1 : k + 5] = 0.0 if low < t < high else 9.0
        return {"spool_position": read}

    record = SimpleNamespace(
        name="a",
        pace=1.0,
        time=np.arange(samples),
        outputs=("spool_position",),
        values={"spool_position": np.zeros(samples)},
        usable={"spool_position": np.ones(samples, dtype=bool)},
    )
    predictor = SimpleNamespace(record=record, run=run, readings=lambda trajectory, variant: trajectory)
    model = SimpleNamespace(
        parameters=(SimpleNamespace(input=None), *(SimpleNamespace(input=edge) for edge in edges)),
        limits=np.array([[-9.0, *(-1.7 for _ in edges)], [9.0, *(1.7 for _ in edges)]]),
        at=lambda point: point,
    )
    noise = SimpleNamespace(deviation=1.0, kept=lambda usable: usable)
    return SimpleNamespace(
        nominal=model,
        options=IDENTIFICATION,
        predictors=(predictor,),
        noise={("spool_position", 1.0): noise},
        stride=1,
        whiten=lambda predictor, columns: list(columns.values()),
    )


def test_an_edge_is_looked_for_where_more_than_noise_follows_it():
    runs = []
    study = study_of_edges([3], [(0.5, np.inf)], runs)  # it comes early
    start = np.array([5.0, -0.3])
    fit = SimpleNamespace(trajectories=(), point=start, readings=(study.predictors[0].run(start),))
    found = searched_edges(study, fit)
    assert found[0] == 5.0 and 0.5 < found[1] < 1.0  # the place next to the middle of all that leave nothing
    runs.clear()
    point = np.array([5.0, 1.0])
    read = study.predictors[0].run(point)
    assert np.array_equal(searched_edges(study, SimpleNamespace(trajectories=(), point=point, readings=(read,))), point)
    assert len(runs) == 1  # nothing is left there


@settings(max_examples=50, deadline=None)
@given(
    after=st.lists(st.integers(1, 150), unique=True, min_size=0, max_size=4),
    gap=st.tuples(st.integers(0, 200), st.integers(0, 40)),
    seed=st.integers(0, 1000),
)
def test_what_a_fit_leaves_after_jumps_is_of_the_samples_there(after, gap, seed):
    """Against plain loops; samples that are not usable have no row."""
    rng, samples = np.random.default_rng(seed), 200
    edges = [EdgeTime("a", "current", k) for k in after]
    usable = {"spool_position": np.ones(samples, dtype=bool), "load_flow": np.ones(samples, dtype=bool)}
    usable["load_flow"][gap[0] : sum(gap)] = False
    values = {name: rng.normal(size=samples) for name in usable}
    record = SimpleNamespace(
        name="a", pace=1.0, time=np.arange(samples), outputs=tuple(usable), values=values, usable=usable
    )
    noise = SimpleNamespace(deviation=1.0, kept=lambda usable: usable)
    study = SimpleNamespace(
        options=IDENTIFICATION, predictors=(SimpleNamespace(record=record),), stride=1,
        noise={(name, 1.0): noise for name in usable},
        whiten=lambda predictor, columns: [columns[name][usable[name]] for name in usable],
        expected_squares=lambda record, name: np.full(np.count_nonzero(usable[name]), 0.8),
    )  # fmt: skip
    read = {name: np.zeros(samples) for name in usable}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(input_choice, "_jumps_of", lambda record, options: edges)
        left = excess_after_jumps(study, SimpleNamespace(readings=(read,)))
    expected = 0.0
    for name, own in values.items():
        for k in range(samples):
            if usable[name][k] and any(0 < k - jump <= IDENTIFICATION.input.settling_samples for jump in after):
                expected += own[k] ** 2 - 0.8
    assert left == pytest.approx(expected, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(5, 40), st.floats(-1.6, 1.6), st.floats(-1.7, 1.7)), min_size=2, max_size=6))
def test_edges_of_a_record_are_looked_for_at_once_as_they_would_be_one_by_one(drawn):
    apart, places, now = map(list, zip(*drawn, strict=True))
    after, right, runs = np.cumsum(apart).tolist(), [(place - 0.3, place + 0.3) for place in places], []
    study = study_of_edges(after, right, runs)
    point = np.array([0.0, *now])
    fit = SimpleNamespace(trajectories=(), point=point, readings=(study.predictors[0].run(point),))
    runs.clear()
    found = searched_edges(study, fit)
    assert len(runs) in (0, IDENTIFICATION.input.edge_places + 1)
    for k in range(len(after)):
        alone = study_of_edges([after[k]], [right[k]])
        at = point[[0, k + 1]]
        fit = SimpleNamespace(trajectories=(), point=at, readings=(alone.predictors[0].run(at),))
        assert found[k + 1] == searched_edges(alone, fit)[1]


def test_a_fit_is_refined_towards_its_best_and_a_long_one_left(biased_fit):
    study, best = biased_fit.study, biased_fit.fit
    k = [p.name for p in study.nominal.parameters].index("nozzle_diameter")
    off = evaluate_fit(study, best.point + 0.5 * np.eye(len(best.point))[k], ())
    near = refined(study, off)
    again = refined(study, off, jacobian_of(study, off, *linearise_fit(study, off)))
    assert np.array_equal(again.point, near.point) and again.chi_square == near.chi_square
    assert off.chi_square - near.chi_square > 0.9 * (off.chi_square - best.chi_square) > 100.0
    assert refined(replace(study, is_long=True), off) is off


def test_what_a_cause_explains_as_well_is_no_gain_of_the_bench():
    rng = np.random.default_rng(1)
    J, cause, wave = rng.normal(size=(500, 3)), rng.normal(size=(500, 1)), rng.normal(size=(500, 2))
    noise = rng.normal(size=500)

    def gain(residual, S):
        fit = SimpleNamespace(point=np.zeros(3), residual=residual)
        predicted = linear_reductions(J, fit, np.column_stack([cause, S]))
        return [predicted.gain(range(1, 1 + S.shape[1]), range(k)) for k in (0, 1)]

    assert min(gain(wave @ [0.5, 0.5] + noise, wave)) > DIAGNOSIS.bench.minimum_gain
    like_the_cause = cause + 0.02 * wave[:, :1]
    alone, beside = gain(cause[:, 0] + noise, like_the_cause)
    assert alone > DIAGNOSIS.bench.minimum_gain > 20.0 > beside
    assert max(gain(noise, wave)) < 20.0


@pytest.mark.parametrize("hidden, fitted, causes, expected", [
    ((1.0, 0.6, 0.0), 0, 2, True), ((1.0, 0.6, 0.0), 1, 2, False), ((1.0, 0.6, 0.0), 0, 1, False),
    ((1.0, 0.0, 0.6), 0, 2, False), ((0.0, 0.0, 1.0), 0, 2, False), ((0.0, 0.0, 0.0), 0, 2, False),
])  # fmt: skip
def test_two_causes_that_explain_more_than_one_beside_an_error_of_the_bench_are_no_such_error(
    hidden, fitted, causes, expected
):
    """A return pressure beside air was told as air and a load pressure that is off (pair 204501)."""
    rng = np.random.default_rng(2)
    J, shown = rng.normal(size=(500, 3)), rng.normal(size=(500, 3))
    error = shown[:, 2] + 0.7 * shown[:, 0]  # which acts a little like the first cause
    columns = np.column_stack([shown[:, :2], error])
    residual = columns @ hidden + rng.normal(size=500)
    predicted = linear_reductions(J, SimpleNamespace(point=np.zeros(3), residual=residual), columns)
    more = bench_faults._two_causes_explain_more(predicted, fitted, range(causes), [2], options=DIAGNOSIS)
    assert more is expected


@pytest.mark.parametrize("shows, joint, alone, beyond, feature, joins", [
    (45.0, 30.0, 41.0, "", "", ["a", "b"]), (45.0, 30.0, 39.0, "", "", []),  # as good as a cause, at odds of 20 to 1
    (10.0, 0.0, 12.0, "", "", []), (500.0, 30.0, 505.0, "", "", ["a", "b"]),  # no alarm; however strong
    (45.0, 70.0, 80.0, "", "", ["a", "b"]),
    (45.0, 30.0, 41.0, "flow", "", []), (45.0, 30.0, 41.0, "spool", "", ["a", "b"]),  # beyond its tolerance, or another
    (45.0, 30.0, 51.0, "flow", "oil_temperature", []),  # one figure does as well: the drift of that meter
    (45.0, 30.0, 57.0, "flow", "oil_temperature", ["a", "b"]),
    (45.0, 30.0, 41.0, "spool", "oil_temperature", ["a", "b"]),
])  # fmt: skip
def test_what_the_bench_does_that_explains_an_alarm_as_well_as_a_cause_takes_its_place(
    monkeypatch, shows, joint, alone, beyond, feature, joins
):
    drifts = tuple(SimpleNamespace(name=name, sensor=SimpleNamespace(channel="flow")) for name in "ab")
    effect = SimpleNamespace(channel=beyond, feature=feature)
    gains = {(2, 0): 90.0, (2, 1): joint + 2.0, (1, 0): alone + 1.0, (1, 1): 0.0}  # by its columns, causes beside
    monkeypatch.setattr(bench_faults, "_hypotheses", lambda study, scores: [drifts])
    monkeypatch.setattr(bench_faults, "all_known_faults", lambda study: [BenchFault((p,), str, None) for p in drifts])
    monkeypatch.setattr(bench_faults, "added_jacobian_of", lambda study, linearised, added: np.array([[1.0, 2.0]]))
    monkeypatch.setattr(bench_faults, "_likeliest_causes", lambda study, scores, options: np.ones((1, 1)))
    predicted = SimpleNamespace(gain=lambda own, beside: gains[len(own), len(beside)] - 5.0 * (own == [2]))
    monkeypatch.setattr(bench_faults, "linear_reductions", lambda J, fit, more: predicted)
    study = SimpleNamespace(nominal=SimpleNamespace(parameters=[]), stack=lambda columns: np.empty((1, 0)))
    scores = SimpleNamespace(
        columns=(), own_columns=(), linearised=(), own=(), fit=SimpleNamespace(chi_square=1050.0, rows=1000.0),
        z=lambda: np.array([np.sqrt(shows)]), level=lambda false_alarm: 4.0,
        candidates=[SimpleNamespace(effect=effect, equivalent=None if feature else beyond or None)],
    )  # fmt: skip
    found = _likeliest(SimpleNamespace(study=study), scores, options=DIAGNOSIS)
    assert [p.name for p in (found.parameters if found is not None else ())] == joins


def test_a_wave_among_the_parameters_is_told_with_its_amplitude():
    waves = wave_parameters(RECORDS, "supply_pressure", 37.0, 1e6)
    model = SimpleNamespace(parameters=(SimpleNamespace(input=None), *waves))
    ((name, own),) = fitted_waves(model).items()
    assert own == waves and name == "supply_pressure at 37 Hz"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [700_000, 700_001, 800_090, 800_174])
def test_a_healthy_valve_raises_no_alarm_on_a_bench_with_all_imperfections(tmp_path, seed):
    """In 800090 coarse sensitivities next to peaks took the armature's inertia nine deviations off; in 800174 a meter
    drifts that little that a thermal gradient explained it as well.
    """
    rest = tuple(each for each in IMPERFECTIONS if each not in ("edges", "hold"))
    case, bench = draw_bench(seed, "none", imperfections=(("edges", "hold")[seed % 2], *rest))
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.verdict == NO_DISCREPANCY and found.reason == "bench" and not found.gain_claimed


def test_a_figure_far_off_is_told_with_its_tolerances():
    figures = [SimpleNamespace(name=name, sensor=None) for name in ("null_gap", "mass")]
    figures.append(SimpleNamespace(name="a zero that was set anew", sensor=METER_ZERO))
    study = SimpleNamespace(nominal=SimpleNamespace(parameters=figures), options=IDENTIFICATION)
    limit = IDENTIFICATION.prior.reach
    assert figures_at_limit(study, np.array([0.9 * limit, -0.9 * limit, 2.0 * limit])) == ""
    assert figures_at_limit(study, np.array([1.0, -limit, limit])) == "mass 5 tolerances off"


@pytest.mark.parametrize("excess, alarm, odd", [((900.0, 20.0, 20.0), False, "a"), ((900.0, 20.0, 20.0), True, ""),
                                               ((500.0, 400.0, 20.0), False, ""),
                                               ((900.0, 20.0), False, "")])  # fmt: skip
def test_a_record_that_carries_what_is_left_does_not_belong_where_the_others_are_explained(
    monkeypatch, excess, alarm, odd
):
    names = "abc"[: len(excess)]
    predictors = [SimpleNamespace(record=SimpleNamespace(test=name)) for name in names]
    sizes = dict(zip(names, excess, strict=True))
    white = {name: [np.full((100, 1), np.sqrt(1.0 + more / 100.0))] for name, more in sizes.items()}
    study = SimpleNamespace(predictors=predictors, weights={}, nominal=SimpleNamespace(parameters=[]))
    study.whiten = lambda predictor, residual: white[predictor.record.test]
    study.unweighted = lambda: study
    nominal = SimpleNamespace(study=study, fit=SimpleNamespace(readings=[{}] * len(names), point=np.zeros(0)))
    left_out = []
    monkeypatch.setattr(apart, "residual_of", lambda record, read: {})
    monkeypatch.setattr(apart, "without_test", lambda study, test: left_out.append(test) or study)
    monkeypatch.setattr(apart, "fit_nominal_near", lambda study, point, full_weight: nominal)
    monkeypatch.setattr(apart, "score_test", lambda nominal, fit, options: None)
    monkeypatch.setattr(apart, "detect", lambda scores: (alarm, 4.0))
    assert apart.odd_test(nominal, options=DIAGNOSIS) == odd and set(left_out) <= {"a"}


def test_no_error_falls_by_more_than_all_of_it():
    squares = np.column_stack([np.random.default_rng(2).chisquare(1, 900) * 50.0, np.full(900, 0.5)])
    low, high = _change_interval(squares, 0, options=DIAGNOSIS)
    assert -squares[:, 0].mean() <= low < high < 0.0


def test_a_healthy_valve_on_a_bad_bench_is_told_so():
    said = summary_text(NO_DISCREPANCY, [], None, "the supply pressure ripples by 3 bar at 37 Hz")
    assert said.startswith("The bench, not the valve: the supply pressure ripples by 3 bar at 37 Hz")


def test_every_effect_says_what_to_do():
    for name, effect in CATALOGUE.items():
        advice = effect.advice
        assert advice is not None and all((advice.part, advice.inspect, advice.confirm, advice.remedy)), name


def test_every_figure_with_a_tolerance_and_every_port_of_a_term_say_what_to_do():
    tolerated = {name for name, figure in quantities(vs.Valve).items() if figure.metadata["tolerance"] > 0.0}
    assert tolerated <= set(BY_FIGURE) and set(PORTS) == set(BY_PORT)
    assert all(
        all((one.part, one.inspect, one.confirm, one.remedy)) for one in (*BY_FIGURE.values(), *BY_PORT.values())
    )


def test_an_answer_without_a_cause_says_what_to_do_too():
    (apart_,), (other,), (nothing,) = (
        advice_on_unknown(*of, None) for of in ((RECORDS_APART, "chirp_2"), (OTHER_VALVE, ""), ("", ""))
    )
    assert apart_.label == "the test chirp_2" and "repeat that test" in apart_.confirm
    assert "units, sign and wiring" in other.inspect and nothing.part == "not located"
    noise = SimpleNamespace(candidates=(), label="nothing but noise")
    assert [one.label for one in advice_on_causes([noise], "a reason")] == [noise.label, "none of the known causes"]
    told = advice_on_causes([noise], "", or_instruments=True)
    assert [one.label for one in told] == [noise.label, "errors of the instruments"] and "calibrate" in told[1].remedy


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed, hidden",
    [
        (800_011, "null_gap_asymmetry"),
        (800_025, "spool_lap"),
        (800_106, "spool_lap"),
        (820_016, "flapper_cavitation"),
    ],
)
def test_a_cause_on_a_bench_with_all_imperfections_is_named(tmp_path, seed, hidden):
    """Held commands at 500 Hz or steps between samples, a ripple of 3 bar that starts with the record, and the rest.

    In 800106 the nominal valve takes up the lap by figures at their limits, beside which an effect of nothing was
    named with it; in 820016 a meter's drift that the cause had hidden was told as a thermal gradient beside it.
    """
    rest = tuple(each for each in IMPERFECTIONS if each not in ("edges", "hold"))
    case, bench = draw_bench(seed, "effect", name=hidden, imperfections=(("edges", "hold")[seed % 2], *rest))
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.causes == (hidden,) and any("ripples" in f or "drifts" in f for f in found.bench)
    figures = truth(case)["parameters"][hidden]
    told = {e.name: e for e in found.parameters}
    assert figures.keys() <= told.keys() and all(told[n].low <= value <= told[n].high for n, value in figures.items())


@pytest.mark.slow
@pytest.mark.parametrize("seed, hidden", [(800_163, "spool_coulomb_friction"), (800_220, "magnetic_hysteresis")])
def test_a_strong_cause_on_such_a_bench_is_the_likeliest(tmp_path, seed, hidden):
    """The plainer friction had stopped short beside fuller ones; a free term did better than the law of the loop."""
    rest = tuple(each for each in IMPERFECTIONS if each not in ("edges", "hold"))
    case, bench = draw_bench(seed, "effect", name=hidden, imperfections=(("edges", "hold")[seed % 2], *rest))
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.verdict in (CAUSE, AMBIGUOUS) and found.candidates[0].label == hidden


@pytest.mark.slow
@pytest.mark.parametrize("imperfection", (*IMPERFECTIONS, *READINGS))
def test_a_healthy_valve_raises_no_alarm_on_a_bench_with_an_imperfection(tmp_path, imperfection):
    case, bench = draw_bench(701_000, "none", imperfections=(imperfection,))
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.verdict == NO_DISCREPANCY and not found.gain_claimed
    if imperfection == "ripple":
        (fault,) = found.bench
        assert found.reason == "bench" and "the supply pressure ripples" in fault


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2_500_001, 2_500_002, 2_500_024])
def test_a_healthy_valve_raises_no_alarm_where_all_instruments_are_off_a_little(tmp_path, seed):
    """On such benches one healthy valve in twenty was "unknown", by leakage peaks at wrong microseconds, and where
    errors of the instruments explain only together what they explain, causes must be likelier by far.
    """
    case, bench = draw_bench(seed, "none", imperfections=(CALIBRATION, "skew"))
    write_bench_session(case, bench, tmp_path)
    assert vs.diagnose(tmp_path).verdict == NO_DISCREPANCY


@pytest.mark.slow
def test_readings_the_other_way_round_are_told_without_a_search(tmp_path, monkeypatch):
    case, bench = draw_bench(505, "none", duration=0.5)
    write_bench_session(case, bench, tmp_path)
    for path in tmp_path.glob("*.csv"):
        header, *rows = path.read_text().splitlines()
        table = np.array([[float(v) for v in row.split(",")] for row in rows])
        table[:, [k for k, name in enumerate(header.split(",")) if name.split()[0] in case.channels]] *= -1.0
        np.savetxt(path, table, "%.10g", ",", header=header, comments="")
    monkeypatch.setattr("valvesim.diagnosis.isolation.first_hypotheses", None)
    found = vs.diagnose(tmp_path)
    assert found.reason == "misread_channels" and not found.extension_offered


@pytest.mark.slow
@pytest.mark.xfail(strict=True, raises=TypeError, reason="a nozzle's figure comes near at first: 108 s of search")
def test_a_valve_far_from_the_stated_one_is_told_without_a_search(tmp_path, monkeypatch):
    """Of a tube twice as stiff as stated, another feedback rod and other nozzles."""
    case, bench = draw_bench(840003, "none", imperfections=("edges", "ripple", "skew"), duration=0.5)
    write_bench_session(case, bench, tmp_path)
    session = tmp_path / "session.toml"
    stated = 'spring_tube_stiffness = "20 N*m/rad"\nfeedback_rod_stiffness = "6000 N/m"\nnozzle_diameter = "0.5 mm"'
    session.write_text(session.read_text().replace("[[records]]", f"[valve]\n{stated}\n\n[[records]]", 1))
    monkeypatch.setattr("valvesim.diagnosis.isolation.first_hypotheses", None)
    found = vs.diagnose(tmp_path)
    assert (found.verdict, found.reason) == ("unknown", OTHER_VALVE) and not found.extension_offered
    assert "tolerances off" in found.summary and not found.gain_claimed


@pytest.mark.parametrize("name, left, told", [
    ("spool_stribeck_friction", 1.0, True), ("spool_coulomb_friction", 1.0, True), ("spool_silting", 1e3, False),
    ("magnetic_hysteresis", 1.0, False),
])  # fmt: skip
def test_the_bench_is_looked_at_beside_one_of_the_laws_that_are_alike(name, left, told):
    def member(effect):
        return SimpleNamespace(candidate=SimpleNamespace(plainest=CATALOGUE[effect].plainer or effect))

    rows = 5000.0
    fit = SimpleNamespace(fitted=(member("spool_coulomb_friction"),), chi_square=left * rows, rows=rows)
    assert bench_faults._tells_as_much(fit, (member(name),), options=DIAGNOSIS) is told


def test_an_input_that_nobody_measured_may_be_off_by_far_more_and_by_as_much_in_every_record(biased_session):
    """What all records are off by costs as much of the prior as one that is."""
    options, column = IDENTIFICATION.instrument, "supply_pressure"
    pressure = float(biased_session.valve.supply_pressure)
    records = [replace(one, assumed=(column,)) for one in biased_session.records]
    guessed = replace(biased_session, records=tuple(records))
    measured, assumed = (input_shifts(one, column, False, IDENTIFICATION) for one in (biased_session, guessed))
    assert {p.deviation for p in measured} == {options.supply_pressure * pressure}
    prior = sum((options.assumed_supply_pressure * pressure / p.deviation) ** 2 for p in assumed)
    assert prior == pytest.approx(1.0) and len(assumed) > 1
    assert {p.bounds[1] for p in assumed} == {4.0 * options.assumed_supply_pressure * pressure}
    oil = input_shifts(replace(guessed, records=tuple(replace(r, assumed=("oil_temperature",)) for r in records)),
                       "oil_temperature", False, IDENTIFICATION)  # fmt: skip
    assert {p.bounds[1] for p in oil} == {4.0 * options.assumed_oil_temperature}


@pytest.mark.parametrize("columns, left, taken", [
    ((), None, None), (("supply_pressure",), (7e3, 6e3), 1), (("supply_pressure",), (6e3, 7e3), 0),
    (("supply_pressure",), (9.95e3, 9.96e3), None),  # less than half of what a cause explains
    (("supply_pressure",), (None, 6e3), 1), (("supply_pressure",), (None, None), None),  # it cannot be run
])  # fmt: skip
def test_what_nobody_measured_is_asked_first(monkeypatch, columns, left, taken):
    record, begun = SimpleNamespace(assumed=columns), []
    study = SimpleNamespace(session=SimpleNamespace(training=[record]), unweighted=lambda: study, weights={})
    nominal = SimpleNamespace(study=study, fit=SimpleNamespace(point=np.ones(2), chi_square=1e4, rows=5e3))

    def fit(prepared, point, full_weight):
        begun.append(point.tolist())
        if left[len(begun) - 1] is None:
            raise SolveError("no valve runs there")
        return SimpleNamespace(fit=SimpleNamespace(chi_square=left[len(begun) - 1], rows=5e3), way=len(begun) - 1)

    for name, stub in {
        "input_shifts": lambda session, column, growing, options: [column] * 4,
        "with_parameters": lambda study, shifts: study,
        "is_at_full_weight": lambda study, extended: False,
        "fit_nominal_near": fit,
        "_at_weight_of": lambda nominal, better: nominal,
        "_gain_by_fault": lambda without, better: without.fit.chi_square - better.fit.chi_square,
        "score_test": lambda nominal, fit, options: "anew",
    }.items():
        monkeypatch.setattr(bench_faults, name, stub)
    before = SimpleNamespace(z=lambda: np.array([20.0]))  # half of 400
    ended, scores = bench_faults.with_assumed_inputs(nominal, before, options=DIAGNOSIS)
    if taken is None:
        assert (ended, scores) == (nominal, before)
    else:
        assert (ended.way, scores) == (taken, "anew")
    assert begun == ([[0.0, 0.0, *[by] * 4] for by in (-0.5, 0.5)] if columns else [])


@pytest.mark.slow
def test_an_input_that_nobody_measured_is_no_fault_of_the_valve(tmp_path):
    """Supplies of 180 and 210 bar, of which the session states 210: a supply of 180 was nozzle and port, at 93 %."""
    case = draw(1350000, "none", noise=0.003)
    write_session(case, tmp_path)
    for path in tmp_path.glob("*.csv"):
        header, *rows = path.read_text().splitlines()
        kept = [k for k, name in enumerate(header.split(",")) if name.split()[0] != "supply_pressure"]
        lines = [",".join(line.split(",")[k] for k in kept) for line in (header, *rows)]
        path.write_text("\n".join(lines) + "\n")
    found = vs.diagnose(tmp_path)
    assert found.verdict == NO_DISCREPANCY, found.summary
    assert any("supply pressure is off" in one.label for one in found.what_to_do) or "supply pressure" in found.summary


@pytest.mark.parametrize("lost, gain, again, kept", [
    (False, 60.0, None, True), (False, 40.0, None, False),
    (True, 40.0, None, False), (True, 40.0, 70.0, True), (True, 40.0, 90.0, False), (True, 60.0, 0.0, True),
])  # fmt: skip
def test_what_the_bench_did_is_held_against_what_it_promises_at_the_same_weights(monkeypatch, lost, gain, again, kept):
    """An error of the load pressure had promised 457 at full weight, and explained 140 of the 90 promised without
    peaks: a healthy valve was `unknown`.
    """
    nominal, better, without = SimpleNamespace(fit="with peaks"), SimpleNamespace(), SimpleNamespace(fit="without")
    stubs = {
        "_at_weight_of": lambda nominal, better: without if lost else nominal,
        "_gain_by_fault": lambda without, better: gain,
        "score_test": lambda nominal, fit, options: fit,
        "_likeliest": lambda nominal, left, options: BenchHypothesis((), again) if again is not None else None,
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(bench_faults, name, stub)
    promised, shown = BenchHypothesis((), 100.0), SimpleNamespace(candidates=(), z=lambda: [5.0])
    assert bench_faults._keeps_promise(nominal, shown, better, promised, options=DIAGNOSIS) is kept


@pytest.mark.slow
def test_a_load_pressure_that_is_read_off_is_no_fault_of_the_valve(tmp_path):
    """By 3 bar of 210 in every record: a term in the load flow, or none of the known causes, in 26 s."""
    case = draw(1300004, "none", noise=0.003)
    records = [record | {"load_pressure": record["load_pressure"] + 3e5} for record in responses(case)]
    write_files(case, noisy(case, clean=records), tmp_path)
    assert vs.diagnose(tmp_path).verdict == NO_DISCREPANCY


@pytest.mark.slow
@pytest.mark.parametrize("seed, name, others", [
    (1310103, "amplifier_lag", {"amplifier_second_order_lag", "eddy_current_lag"}),  # which leaves as little
    (1310101, "amplifier_second_order_lag", set()),
    (1310100, "amplifier_second_order_lag", set()),
])  # fmt: skip
def test_an_amplifier_between_the_recorded_command_and_the_coil_is_named(tmp_path, seed, name, others):
    """Of first order it was `cause`: eddy currents, for the fit of its lag had stopped far from nominal."""
    case = draw(seed, "effect", name=name, noise=0.004)
    write_session(case, tmp_path)
    found = vs.diagnose(tmp_path)
    in_set = [answer.label for answer in found.candidates if answer.in_set]
    assert in_set[0] == name and set(in_set[1:]) <= others
