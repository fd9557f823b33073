"""Terms that no catalogue entry has: found, estimated inside the simulation, and given a formula where one holds up."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import conclusion, symbolic_form, term_entry, term_estimation
from valvesim.diagnosis import diagnose as diagnosing
from valvesim.diagnosis import isolation as isolating
from valvesim.diagnosis import score_test as score_testing
from valvesim.diagnosis.answer_tables import error_table, parameter_shifts
from valvesim.diagnosis.channel_apart import ChannelApart
from valvesim.diagnosis.isolation import Isolation
from valvesim.diagnosis.joint_errors import JointErrors
from valvesim.diagnosis.missing_term import recover_term
from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.one_parameter_term import one_parameter_term
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.result import (
    AMBIGUOUS,
    BENCH,
    CHANNEL_APART,
    NO_DISCREPANCY,
    OTHER_VALVE,
    RECORDS_APART,
    UNKNOWN,
    WhatToDo,
)
from valvesim.diagnosis.score_test import score_test
from valvesim.diagnosis.symbolic_form import _fitted_formulas, formula_words, with_formula
from valvesim.diagnosis.term_estimation import (
    TermEstimate,
    TermFit,
    TermProblem,
    estimate_term,
    shortened_step,
    term_normal_equations,
)
from valvesim.errors import InputError, SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import evaluate_fit, with_shapes
from valvesim.identification.nominal_fit import fit_nominal
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.predictor import ModelVariant, prepare_record
from valvesim.identification.session import Record, Sensor, Session
from valvesim.identification.study import prepare_session, residual_of
from valvesim.simulation.scenario import Thermal
from valvesim.valve.additive_term import LAG, NONE, PATH, PORTS, VARIABLES, TermHypothesis, term_effect, term_hypotheses
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import Model
from valvesim.valve.fluid import MIL_PRF_5606
from valvesim.valve.parameters import Valve

CHANNELS = {"spool_position": 2e-6, "armature_angle": 8e-6, "load_flow": 2e-6}  # with their noise
KNOTS = np.linspace(-3e-4, 3e-4, 11)
CUBIC = -3e11  # N/m^3
TOLERANCES = dict.fromkeys(("spool_area", "feedback_rod_stiffness", "null_gap"), 0.0)


def session_of(*actives, duration=0.5, seed=1):
    """A session that a valve with these effects would have given: three records, two of them repeats."""
    t = np.linspace(0.0, duration, int(duration * 1000) + 1)
    chirp = 6e-3 * np.sin(2 * np.pi * (2.0 * t + 25.0 * t**2))
    ramp = 7e-3 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 2.0 * t))
    usable = {name: np.ones(len(t), dtype=bool) for name in CHANNELS}
    rng = np.random.default_rng(seed)

    def record(name, current, repeats=None):
        values = {"current": current, "oil_temperature": np.full(len(t), 40.0),
                  "supply_pressure": np.full(len(t), 21e6), "load_pressure": np.zeros(len(t))}  # fmt: skip
        return Record(name, t, {**values, **{c: np.zeros(len(t)) for c in CHANNELS}}, usable, repeats=repeats)

    records = [record("chirp", chirp, "a"), record("again", chirp, "a"), record("ramp", ramp)]
    sensors = {name: Sensor(name, "", noise=noise) for name, noise in CHANNELS.items()}
    session = Session(Path(), "made", 1, Valve(), MIL_PRF_5606, Thermal(network=None), (), (), {}, sensors,
                      tuple(records), ())  # fmt: skip
    variant, measured_channels = ModelVariant(session.valve, actives), []
    for one in records:
        predictor = prepare_record(session, one, (), options=OPTIONS)
        read = predictor.readings(predictor.run(variant), variant)
        noisy = {name: read[name] + rng.normal(0.0, CHANNELS[name], len(t)) for name in CHANNELS}
        measured_channels.append(replace(one, values={**one.values, **noisy}))
    return replace(session, records=tuple(measured_channels))


def cubic(size=1.0):
    return term_effect("spool_force", "spool_position", KNOTS, CUBIC * KNOTS**3, name="hidden")(
        share=1.0, **{f"value_{k + 1}": v for k, v in enumerate(size * CUBIC * KNOTS**3)}
    )


@pytest.fixture(scope="module")
def nominal():
    return fit_nominal(prepare_session(session_of(cubic())))


@pytest.fixture(scope="module")
def found(nominal):
    return recover_term(nominal, score_test(nominal, nominal.fit, options=DIAGNOSIS))


# ---------------------------------------------------------------- the whole


def test_a_hidden_cubic_spring_is_recovered_where_it_acts(found):
    assert (found.term.port, found.term.variable, found.term.memory) == ("spool_force", "spool_position", NONE)
    at, value = np.array(found.term.at), np.array(found.term.value)
    true = CUBIC * at**3
    assert np.linalg.norm(value - true) < 0.1 * np.linalg.norm(true)
    assert np.all(np.array(found.term.deviation) > 0.0) and len(found.term.deviation) == len(at)


def test_its_formula_is_offered_with_its_units_and_error(found):
    assert "x^3 N, x = spool_position in m" in found.term.formula
    assert float(found.term.formula.split()[0]) == pytest.approx(CUBIC, rel=0.1)
    assert 0.0 <= found.term.formula_error <= 0.1
    assert 1 <= found.freedom <= 3  # a coefficient, and what stands beside it


def test_the_fit_explains_the_records_and_is_what_its_variant_reads(nominal, found):
    rows = len(nominal.fit.residual)
    assert found.chi_square < nominal.fit.chi_square - 100.0 and found.chi_square < 1.3 * rows
    assert found.variant.effects[-1] == found.active and found.point.shape == nominal.fit.point.shape
    for predictor, read in zip(nominal.study.predictors, found.readings, strict=True):
        again = predictor.readings(predictor.run(found.variant), found.variant)
        for name in read:  # it starts from rest found anew
            assert again[name] == pytest.approx(read[name], rel=1e-6, abs=1e-7 * np.ptp(read[name]))
    residual = nominal.study.stack(
        [residual_of(b.record, r) for b, r in zip(nominal.study.predictors, found.readings, strict=True)]
    )
    assert found.chi_square >= float(residual[:, 0] @ residual[:, 0]) + float(found.point @ found.point)
    fit = found.as_fit(nominal.study)
    assert fit.variant(nominal.study.nominal).effects[-1] == found.active and fit.readings is found.readings
    np.testing.assert_array_equal(fit.residual, residual[:, 0])


@pytest.mark.slow
def test_a_detent_is_finer_than_the_first_look_and_found_all_the_same():
    u = np.linspace(-3e-4, 3e-4, 121)
    pull = -2.0 * np.sin(2 * np.pi * u / 75e-6)  # N
    detent = term_effect("spool_force", "spool_position", u, pull, name="hidden")(share=1.0)
    with_detent = fit_nominal(prepare_session(session_of(detent)))
    term = recover_term(with_detent, score_test(with_detent, with_detent.fit, options=DIAGNOSIS)).term
    assert (term.port, term.variable, term.memory) == ("spool_force", "spool_position", NONE)
    period = float(term.formula.partition("sin(2 pi x/")[2].split(" ")[0])
    assert period == pytest.approx(75e-6, rel=0.02)
    true = np.interp(term.at, u, pull)
    assert np.linalg.norm(np.array(term.value) - true) < 0.1 * np.linalg.norm(true)


def test_a_dead_band_of_the_torque_is_found_as_a_jump_at_no_current():
    u = np.array([-1e-2, -2e-6, 2e-6, 1e-2])
    dead_band = term_effect("armature_torque", "current", u, 2e-4 * np.array([1.0, 1.0, -1.0, -1.0]), name="hidden")
    nominal = fit_nominal(prepare_session(session_of(dead_band(share=1.0))))
    found = recover_term(nominal, score_test(nominal, nominal.fit, options=DIAGNOSIS))
    term = found.term
    assert (term.port, term.variable, term.memory) == ("armature_torque", "current", NONE)
    amplitude, _, form = term.formula.partition(" ")
    assert form == "sign(i) N*m, i = current in A" and found.freedom == 1
    assert float(amplitude) == pytest.approx(-2e-4, rel=0.1)
    np.testing.assert_allclose(np.abs(term.value), 2e-4, rtol=0.1)
    variant = found.variant  # and so it runs, and is written
    assert variant.effects[-1].effect.name == "recovered_term"


@pytest.mark.slow
def test_a_slight_term_gets_few_knots():
    nominal = fit_nominal(prepare_session(session_of(cubic(0.2))))
    found = recover_term(nominal, score_test(nominal, nominal.fit, options=DIAGNOSIS))
    assert (found.term.port, found.term.variable) == ("spool_force", "spool_position")
    assert len(found.term.at) == DIAGNOSIS.missing_term.few_knots
    assert nominal.fit.chi_square - found.chi_square < 11.0 * np.log(
        found.chi_square
    )  # no more than eleven would have cost


def test_a_term_too_slight_for_knots_is_told_by_its_shape():
    nominal = fit_nominal(prepare_session(session_of(cubic(0.13))))
    scores = score_test(nominal, nominal.fit, options=DIAGNOSIS)
    assert recover_term(nominal, scores) is None
    found = one_parameter_term(nominal, scores)
    assert (found.term.port, found.term.variable, found.term.memory) == ("spool_force", "spool_position", NONE)
    assert found.term.formula.endswith("x^3 N, x = spool_position in m") and found.freedom == 1
    assert float(found.term.formula.split()[0]) == pytest.approx(0.13 * CUBIC, rel=0.3)
    at, value = np.array(found.term.at), np.array(found.term.value)
    np.testing.assert_allclose(value, float(found.term.formula.split()[0]) * at**3, rtol=1e-2, atol=1e-9)
    assert np.all(np.abs(np.array(found.term.deviation)) <= np.abs(value)) and found.term.alike
    assert nominal.fit.chi_square - found.chi_square > DIAGNOSIS.missing_term.minimum_gain
    for predictor, read in zip(nominal.study.predictors, found.readings, strict=True):
        again = predictor.readings(predictor.run(found.variant), found.variant)
        for name in read:  # it starts from rest found anew
            assert again[name] == pytest.approx(read[name], rel=1e-6, abs=1e-7 * np.ptp(read[name]))


def test_where_nothing_is_hidden_no_shape_explains_more_than_it_costs():
    plain = fit_nominal(prepare_session(session_of()))
    assert one_parameter_term(plain, score_test(plain, plain.fit, options=DIAGNOSIS)) is None


def test_where_else_a_term_would_do_is_said_in_words(found):
    assert not any(label.startswith("spool force as a function of spool position") for label in found.term.alike)
    assert set(found.term.alike) <= {hypothesis.label for hypothesis in term_hypotheses()}
    assert len(set(found.term.alike)) == len(found.term.alike)


def test_what_a_term_remembers_is_said_in_words(found):
    lagged, path = (replace(found.term, memory=memory).in_words() for memory in (LAG, PATH))
    assert found.term.in_words() == "a term in the spool force that depends on the spool position"
    assert lagged == "a term in the spool force that depends on the lagged spool position"
    assert path == "a term in the spool force that depends on the direction of the spool position"


def test_nothing_is_recovered_where_nothing_is_hidden():
    plain = fit_nominal(prepare_session(session_of()))
    assert recover_term(plain, score_test(plain, plain.fit, options=DIAGNOSIS)) is None


def test_nothing_is_recovered_from_a_scene_without_families(nominal):
    assert recover_term(nominal, score_test(nominal, nominal.fit, terms=(), options=DIAGNOSIS)) is None


# ---------------------------------------------------------------- the answer where no candidate explains the records


@pytest.fixture(scope="module")
def scores(nominal):
    return score_test(nominal, nominal.fit, options=DIAGNOSIS)


def test_a_fit_that_is_tested_again_is_not_linearised_again(nominal, scores, monkeypatch):
    fit = replace(nominal.fit)  # the same, and not the nominal one
    first = score_test(nominal, fit, terms=(), options=DIAGNOSIS)
    monkeypatch.setattr(score_testing, "linearise_fit", lambda study, fit: pytest.fail("linearised again"))
    again = score_test(nominal, fit, terms=(), known=first, options=DIAGNOSIS)
    np.testing.assert_array_equal(again.projected.score, first.projected.score)
    assert again.linearised is first.linearised and again.columns is first.columns
    with pytest.raises(pytest.fail.Exception):
        score_test(nominal, replace(fit), terms=(), known=first, options=DIAGNOSIS)


@pytest.fixture
def answer(nominal, scores, found, monkeypatch):
    """The answer of a search that has ended without a cause, but for what is changed of it; the term was recovered."""

    def answer(alarm=True, bench=(), **named):
        monkeypatch.setattr(conclusion, "odd_test", lambda nominal, options: named.get("odd", ""))
        monkeypatch.setattr(conclusion, "recover_term", lambda nominal, scores: named.get("recovered", found))
        monkeypatch.setattr(conclusion, "one_parameter_term", lambda nominal, scores: named.get("slight"))
        monkeypatch.setattr(conclusion, "as_catalogue_entry", lambda isolation, recovered: isolation)
        monkeypatch.setattr(conclusion, "is_inadequate", lambda nominal, fit, options: named.get("inadequate", False))
        own = {name: named.get(name) for name in ("joint_errors", "channel")}
        ended = Isolation(nominal, scores, scores, [], [], "", alarm, 4.0, bench, **own)
        return diagnosing._answer(ended)

    return answer


def test_what_no_candidate_explains_is_unknown_with_its_term_in_the_scenario(answer, found):
    told = answer()
    assert told.verdict == UNKNOWN and told.term is found.term and not told.causes and not told.reason
    assert "it acts like a term in the spool force that depends on the spool position" in told.summary
    assert told.extension_offered and told.extended_variant is found.variant  # nothing was locked away to object
    assert "recovered_term" in told.extended_scenario and told.what_to_do[0].label.startswith("a term in the spool")
    assert all(noise.verified for noise in told.noise) and not any("unverified" in note for note in told.notes)


@pytest.mark.parametrize("gain, told", [(30.0, True), (-30.0, False)])
def test_a_term_that_explains_more_than_a_doubtful_cause_stands_beside_it_with_the_test_that_tells(
    nominal, found, monkeypatch, gain, told
):
    """By less than another law of hysteresis might: 30 of what it explains. The cause is doubtful by another reason."""
    loop = Candidate("magnetic_hysteresis", CATALOGUE["magnetic_hysteresis"])
    fit = evaluate_fit(nominal.study, nominal.fit.point, (with_shapes(loop, loop.typical),))
    penalty = found.freedom * float(np.log(fit.rows))
    best = FittedHypothesis(replace(fit, chi_square=found.chi_square + penalty + gain), options=DIAGNOSIS)
    final = score_test(nominal, best.fit, options=DIAGNOSIS)
    monkeypatch.setattr(conclusion, "recover_term", lambda nominal, scores: found)
    monkeypatch.setattr(conclusion, "as_catalogue_entry", lambda isolation, recovered: isolation)
    monkeypatch.setattr(conclusion, "null_hypothesis_beside", lambda *_, **__: [])
    isolation = Isolation(nominal, final, final, [best], [best], "a plain term does as well", True, 4.0)
    isolation = replace(isolation, joint_errors=JointErrors(397.0, ("a clock runs fast",), 1000.0))
    answer = diagnosing._answer(isolation)
    assert "; errors of the instruments explain it as well (a clock runs fast)" in answer.summary
    assert "errors of the instruments" in [one.label for one in answer.what_to_do]
    assert answer.verdict == AMBIGUOUS and answer.term is (found.term if told else None)
    assert ("if none of them, it acts like a term in the spool force" in answer.summary) is told
    assert "magnetic_hysteresis" in answer.extended_scenario or not answer.extension_offered
    if told:
        assert answer.next_test.separates == ("magnetic_hysteresis", "none of the known causes")
    else:
        assert answer.next_test is None


def test_a_term_of_one_parameter_is_told_where_none_on_knots_explains_what_shows(answer, found):
    told = answer(recovered=None, slight=found)
    assert told.verdict == UNKNOWN and told.term is found.term and told.extension_offered


def test_an_unknown_cause_without_a_term_is_told_with_the_nominal_valve(answer):
    told = answer(recovered=None)
    assert told.verdict == UNKNOWN and told.term is None and not told.extension_offered
    assert told.summary == "Something is wrong that none of the known causes explains."


def test_records_that_do_not_belong_together_are_told_by_the_test_that_is_apart(answer):
    told = answer(odd="ramp")
    assert (told.verdict, told.reason, told.term) == (UNKNOWN, RECORDS_APART, None)
    assert "ramp alone is not as the others say" in told.summary and told.what_to_do[0].label == "the test ramp"


def test_a_channel_that_does_not_go_with_the_others_is_told_beside_a_term_or_instead(answer, found, nominal):
    """Instead of one, all that is shown is of the fit to the other channels."""
    readings = tuple({name: read + 1e-3 for name, read in one.items()} for one in nominal.fit.readings)
    others = replace(nominal, fit=replace(nominal.fit, readings=readings, point=nominal.fit.point + 0.1))
    channel = ChannelApart("load_flow", "", others)
    told = answer(channel=channel, recovered=None)
    assert (told.verdict, told.reason) == (UNKNOWN, CHANNEL_APART) and "load_flow does not go" in told.summary
    first = nominal.study.predictors[0].record.name
    (shown,) = [trace for trace in told.traces if (trace.record, trace.channel) == (first, "load_flow")]
    np.testing.assert_array_equal(shown.base, readings[0]["load_flow"])
    assert told.errors == error_table(nominal.study, others.fit)
    assert told.extended_variant == others.fit.variant(nominal.study.nominal)
    assert told.shifts == parameter_shifts(nominal.study, others.fit.point)
    told = answer(channel=channel)
    assert told.reason == "" and told.term is found.term and channel.words in told.notes
    assert told.errors != error_table(nominal.study, others.fit)


def test_no_cause_is_sought_where_the_response_of_one_channel_explains_what_shows(nominal, monkeypatch):
    slow = ChannelApart("load_flow", "a response of second order (60 Hz, damping ratio 0.50) explains it", nominal)
    monkeypatch.setattr(isolating, "is_adequate", lambda fit, options: False)
    monkeypatch.setattr(isolating, "channel_apart", lambda nominal, scores, options: slow)
    monkeypatch.setattr(isolating, "_isolated", None)
    monkeypatch.setattr(conclusion, "recover_term", None)
    told = diagnosing._answer(isolating.isolate(nominal, lambda stage, share: None, options=DIAGNOSIS))
    assert (told.verdict, told.reason, told.extension_offered) == (UNKNOWN, CHANNEL_APART, False)
    assert slow.words in told.summary and told.what_to_do[0].label == "the channel load_flow"


def test_records_that_no_fit_comes_near_are_told_to_be_of_another_valve(answer):
    told = answer(inadequate=True)
    assert (told.verdict, told.reason, told.term) == (UNKNOWN, OTHER_VALVE, None)
    assert "are they of this valve" in told.summary and not told.extension_offered


def test_a_term_that_moves_figures_by_more_than_any_part_can_be_off_tells_another_valve(answer, found):
    far = replace(found, point=np.eye(len(found.point))[0] * OPTIONS.prior.reach)
    told = answer(recovered=far)
    assert (told.verdict, told.reason, told.term) == (UNKNOWN, OTHER_VALVE, None) and "tolerances off" in told.summary


def test_without_an_alarm_the_bench_is_told_and_not_the_valve(answer):
    ripple = WhatToDo(label="the supply ripples by 3 bar", part="pump", inspect="-", confirm="-", remedy="-")
    told = answer(alarm=False, bench=(ripple,))
    assert (told.verdict, told.reason, told.bench) == (NO_DISCREPANCY, BENCH, (ripple.label,))
    assert told.summary.startswith(f"The bench, not the valve: {ripple.label}") and ripple in told.what_to_do
    unknown = answer(bench=(ripple,), recovered=None)
    assert any(ripple.label in note for note in unknown.notes)  # beside an unknown cause it is a note


def test_the_bench_is_told_beside_a_term_by_what_it_does_beside_the_term(answer, found, monkeypatch):
    ripple = WhatToDo(label="the supply ripples by 3 bar", part="pump", inspect="-", confirm="-", remedy="-")
    asked = []

    def told_faults(scores, options):
        asked.append(scores.fit)
        return (ripple,) if len(asked) == 1 else ()

    monkeypatch.setattr(conclusion, "told_faults", told_faults)
    assert answer(bench=(ripple,)).bench == (ripple.label,)
    gone = answer(bench=(ripple,))  # errors had made up for some of the term
    assert gone.verdict == UNKNOWN and gone.term is found.term and not gone.bench
    assert not any(ripple.label in note for note in gone.notes)
    assert all(fit.chi_square == pytest.approx(found.chi_square, rel=1e-3) for fit in asked)
    assert not answer().bench and len(asked) == 2  # nothing had been told


def test_errors_of_instruments_that_explain_it_together_are_told_with_the_fewest(answer):
    few = JointErrors(397.0, ("the oil temperature is off by up to 0.7 K",), 1000.0)
    told = answer(alarm=False, joint_errors=few)
    assert told.verdict == NO_DISCREPANCY and "397 of the chi-square together" in told.notes[-1]
    assert "with the fewest figures: the oil temperature is off by up to 0.7 K" in told.notes[-1]
    assert told.summary == (
        "No discrepancy beyond what errors of the instruments explain together (the oil temperature is off by up to "
        "0.7 K); a cause may act so too."
    )
    assert JointErrors(397.0, (), 1000.0).words == "a little of each"


def test_entries_of_the_catalogue_that_act_where_a_term_does_are_fitted_from_where_it_was(
    nominal, scores, found, monkeypatch
):
    begun = []

    def fit_hypothesis(nominal, start, point, worthwhile):
        assert worthwhile >= found.chi_square
        begun.append(start[0].candidate.name)
        assert np.array_equal(point, np.clip(found.point, *nominal.study.nominal.limits))
        ends = {"spool_coulomb_friction": found.chi_square, "spool_silting": nominal.fit.chi_square}
        end = ends.get(start[0].candidate.name)
        return None if end is None else replace(nominal.fit, fitted=start, chi_square=end)

    before = Isolation(nominal, scores, scores, [], [], "", True, 4.0)
    monkeypatch.setattr(term_entry, "fit_hypothesis", fit_hypothesis)
    monkeypatch.setattr(term_entry, "score_test", lambda nominal, fit, options: scores)
    monkeypatch.setattr(term_entry, "judged", lambda isolation: isolation)
    entries = term_entry.as_catalogue_entry(before, found).found
    assert [one.label for one in entries] == ["spool_coulomb_friction"]  # the other explains nothing
    acts = {effect.name: effect.location for effect in CATALOGUE.values()}
    assert len(begun) == len(set(begun)) and {"spool_coulomb_friction", "spool_silting"} <= set(begun)
    through_the_flow_force = {"supply pressure, in every balance", "load pressure, in every balance"}
    assert {acts[name] for name in begun} <= {"spool force balance"} | through_the_flow_force
    near = replace(nominal.fit, chi_square=found.chi_square + 1.0)
    erring = SimpleNamespace(fit=near, law_may_leave=lambda fit: 0.2 * (fit.chi_square - near.chi_square))
    explained = nominal.fit.chi_square - found.chi_square
    assert explained > 10.0  # so that a fifth of it is more than the one by which the entry leaves less
    assert term_entry.as_catalogue_entry(replace(before, answer_set=[erring]), found).found == []
    monkeypatch.setattr(term_entry, "fit_hypothesis", lambda nominal, start, point, worthwhile: None)
    assert term_entry.as_catalogue_entry(before, found) is before


# ---------------------------------------------------------------- formulas


def problem(memory=NONE, **figures):
    hypothesis = TermHypothesis(PORTS["spool_force"], VARIABLES["spool_position"], memory, **figures)
    return TermProblem(None, hypothesis, KNOTS, np.ones(len(KNOTS)), 1.0, options=DIAGNOSIS)


@pytest.mark.parametrize(
    "true, text",
    [
        (lambda x: 2e7 * x * x, "2e+07 x^2"),
        (lambda x: -3e11 * x**3, "-3e+11 x^3"),
        (lambda x: 4e7 * x * np.abs(x), "4e+07 x |x|"),
        (lambda x: 5e3 * np.abs(x), "5e+03 |x|"),
        (lambda x: 1.5 * np.tanh(x / 6e-5), "tanh(x/"),
        (lambda x: 0.7 * np.sin(2 * np.pi * x / 2.49e-4 + 0.5), "sin(2 pi x/0.000249 +0.5"),
        (lambda x: 2e7 * x * x + 3e3 * x, "2e+07 x^2 + 3e+03 x"),
    ],
)
def test_a_formula_is_found_by_its_shape(true, text):
    values = true(KNOTS)
    C = (0.01 * np.abs(values).max()) ** 2 * np.eye(len(KNOTS))
    best = _fitted_formulas(problem(), values, np.linalg.inv(C), 12.0)[0]
    assert text in best.write(best.coefficients)
    assert best.F @ best.coefficients == pytest.approx(values, abs=0.05 * np.abs(values).max())


@pytest.mark.parametrize("told", [0, 1])
def test_records_that_tell_fewer_figures_than_a_formula_has_give_it_none(told):
    """A real valve's sweeps told nothing of a term in one direction, and that ended in an error of the algebra."""
    values, W = 1e7 * KNOTS**2, np.zeros((len(KNOTS), len(KNOTS)))
    W[:told, :told] = 1e6 * np.eye(told)
    found = _fitted_formulas(problem(), values, W, 12.0)
    assert all(formula.F.shape[1] <= told for formula in found)


def test_what_the_base_could_make_up_is_not_held_against_a_formula():
    u = KNOTS / KNOTS[-1]
    values = 2.0 * u**2 + 0.5 * u  # the slope is uncertain by far more than itself
    C = 1e-4 * np.eye(len(u)) + np.outer(u, u)
    best = _fitted_formulas(problem(), values, np.linalg.inv(C), 12.0)[0]
    assert best.write(best.coefficients).endswith("x^2")


def test_a_formula_is_told_with_its_memory():
    assert "lagged by 10 ms" in formula_words(problem(LAG, time_constant=5e-3).hypothesis, "2 x", np.log(2.0))
    assert "turns over 2e-05 m" in formula_words(problem(PATH, width=1e-5).hypothesis, "2", np.log(2.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearProblem(TermProblem):
    """A term whose readings are linear in its values: `y` (rows,) is measured, `V` (rows, k) what each value shows."""

    y: np.ndarray
    V: np.ndarray
    error: str = ""

    def evaluate(self, point, values, memory_log):
        if self.error:
            raise SolveError(self.error)
        residual = self.y - self.V @ values
        chi_square = float(residual @ residual + point @ point + values @ self.penalty() @ values)
        return TermFit(point, values, memory_log, chi_square, (), residual)


@pytest.fixture
def solved(monkeypatch):
    """(problem, estimate) of records that show these values at the knots, each to a fiftieth of their size."""

    def solved(true):
        k, size = len(KNOTS), float(np.ptp(true) / 2.0)
        V = np.tile(np.eye(k) * 10.0 / size, (20, 1))
        J, noise = np.zeros((20 * k, 1)), np.random.default_rng(6).normal(size=20 * k)
        study = SimpleNamespace(nominal=SimpleNamespace(limits=np.array([[-9.0], [9.0]])))
        hypothesis = TermHypothesis(PORTS["spool_force"], VARIABLES["spool_position"])
        problem = LinearProblem(study, hypothesis, KNOTS, np.ones(k), size, options=DIAGNOSIS, y=V @ true + noise, V=V)
        H, gradient = term_normal_equations(problem, problem.evaluate(np.zeros(1), np.zeros(k), 0.0), J, V)
        state = problem.evaluate(np.zeros(1), np.linalg.solve(H, gradient)[1:], 0.0)
        monkeypatch.setattr(symbolic_form, "_linearised_at", lambda problem, held: (J, V))
        return problem, TermEstimate(state, np.linalg.inv(H), J, V)

    return solved


GAINED, PRICE = 2000.0, 10.0  # by the term, of the chi-square; of a figure


def test_a_curve_that_a_formula_follows_is_held_to_it(solved):
    problem, solution = solved(CUBIC * KNOTS**3)
    held, text, free_parameters = with_formula(problem, solution, GAINED, PRICE)
    assert text.endswith("x^3 N, x = spool_position in m") and free_parameters == 1
    assert held.state.values == pytest.approx(CUBIC * KNOTS**3, abs=0.03 * problem.size)
    assert with_formula(replace(problem, error="no valve runs with it"), solution, GAINED, PRICE) is None


def test_a_formula_near_the_curve_may_cost_what_its_figures_save(solved):
    """A plant is no formula: of a thousand records the smallest bend shows."""
    bent = CUBIC * KNOTS**3
    bent += 0.02 * np.ptp(bent) * (-1.0) ** np.arange(len(KNOTS))
    assert with_formula(*solved(bent), 100.0, PRICE)[1].endswith("x^3 N, x = spool_position in m")
    assert with_formula(*solved(bent), 100.0, 0.0) is None


def test_a_curve_that_no_formula_follows_stays_one(solved):
    rough = np.array([1.0, -0.7, 0.2, 0.9, -1.0, 0.4, 0.8, -0.3, -0.9, 0.6, 0.1])
    assert with_formula(*solved(rough), GAINED, PRICE) is None


def test_a_step_of_a_term_is_shortened_until_it_lowers_the_chi_square_and_given_up_where_none_does(solved):
    problem, solution = solved(CUBIC * KNOTS**3)
    best = solution.state.values
    start, step = problem.evaluate(np.zeros(1), np.zeros(len(KNOTS)), 0.0), np.append(0.0, best)
    assert shortened_step(problem, start, step, 1).values == pytest.approx(best)
    assert shortened_step(problem, start, 3.0 * step, 1).values == pytest.approx(1.5 * best)
    assert shortened_step(problem, start, -step, 1) is None
    assert shortened_step(replace(problem, error="no valve runs with it"), start, step, 1) is None


def test_a_term_of_a_variable_that_the_records_hold_still_cannot_be_estimated(nominal, monkeypatch):
    monkeypatch.setattr(term_estimation, "visited_values", lambda linearised, hypothesis: np.full(100, 2e-3))
    hypothesis = TermHypothesis(PORTS["spool_force"], VARIABLES["current"])
    assert estimate_term(nominal, hypothesis, 6, np.inf, options=DIAGNOSIS) is None


def test_a_term_that_no_reading_shows_has_no_size(nominal, monkeypatch):
    def nothing(problem, linearised, state):
        return np.zeros((len(nominal.fit.residual), len(problem.knots)))

    monkeypatch.setattr(term_estimation, "term_columns", nothing)
    hypothesis = TermHypothesis(PORTS["spool_force"], VARIABLES["spool_position"])
    assert estimate_term(nominal, hypothesis, 6, np.inf, options=DIAGNOSIS) is None


# ---------------------------------------------------------------- the effect behind a term


def evaluated(effect, position, memory=()):
    from valvesim.channels import State
    from valvesim.valve.effect import Situation

    state = State(0.0, 0.0, 1e6, 1e6, position, 0.1)
    active = effect(share=1.0)
    situation = Situation(state, None, 0.0, 0.0, 0.0, 0.0, 0.0, None)
    return effect.balance(situation, active.values, memory)


def test_a_term_is_straight_between_its_knots_and_constant_beyond():
    effect = term_effect("spool_force", "spool_position", (-1.0, 0.0, 2.0), (5.0, 1.0, 3.0))
    for x, w in ((-9.0, 5.0), (-0.5, 3.0), (0.0, 1.0), (1.0, 2.0), (7.0, 3.0)):
        assert evaluated(effect, x)[0].spool_force == pytest.approx(w)


def test_a_lag_reads_its_memory_and_follows_the_variable():
    effect = term_effect("spool_force", "spool_position", (0.0, 1.0), (0.0, 2.0), memory=LAG, time_constant=0.5)
    ports, rates = evaluated(effect, 1.0, (0.25,))
    assert ports.spool_force == pytest.approx(0.5) and rates == pytest.approx((1.5,))


def test_a_path_multiplies_by_its_direction_and_turns_it_with_the_speed():
    effect = term_effect("spool_force", "spool_position", (0.0, 1.0), (2.0, 2.0), memory=PATH, width=0.01)
    ports, rates = evaluated(effect, 0.5, (-0.5,))
    assert ports.spool_force == pytest.approx(-1.0) and rates[0] > 0.0


def test_terms_that_differ_in_figures_alone_are_one_function():
    one = term_effect("spool_force", "spool_position", (0.0, 1.0), (0.0, 2.0), memory=LAG, time_constant=0.5)
    other = term_effect("spool_force", "spool_position", (0.0, 3.0), (1.0, 5.0), memory=LAG, time_constant=0.1)
    assert one.balance is other.balance
    assert one.balance is not term_effect("spool_force", "current", (0.0, 1.0), (0.0, 2.0)).balance


@pytest.mark.parametrize("hypothesis", term_hypotheses(), ids=lambda f: f.label)
def test_every_family_can_be_an_effect_of_the_model(hypothesis):
    effect = term_effect(
        hypothesis.port.name, hypothesis.variable.name, (0.0, 1.0), (0.0, 1.0), memory=hypothesis.memory,
        time_constant=hypothesis.time_constant, width=hypothesis.width,
    )  # fmt: skip
    assert len(Model(effects=(effect,)).state_channels) == len(Model().state_channels) + (hypothesis.memory != NONE)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"port": "spool_forse"}, "spool_force"),
        ({"variable": "spool_positon"}, "spool_position"),
        ({"memory": "lagg"}, "lag"),
        ({"knots": (0.0,), "values": (1.0,)}, "at least two knots"),
        ({"knots": (1.0, 0.0)}, "rising"),
        ({"knots": (0.0, 1.0, 2.0)}, "3 knots"),
        ({"values": (0.0, np.nan)}, "nan"),
        ({"memory": LAG}, "time_constant"),
        ({"memory": PATH}, "width"),
        ({"time_constant": 0.1}, "time_constant = 0.1"),
        ({"memory": PATH, "width": 1.0, "variable": "current"}, "the path of current"),
    ],
)
def test_a_term_that_makes_no_sense_is_refused(change, words):
    given = {"port": "spool_force", "variable": "spool_position", "knots": (0.0, 1.0), "values": (0.0, 1.0), **change}
    with pytest.raises(InputError, match=words):
        term_effect(**given)
