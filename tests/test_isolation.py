"""The steps of an isolation among each other: whose score tests, whose noise, what is fitted and how often."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import conclusion, detection, first_hypotheses, isolation, refits, second_cause
from valvesim.diagnosis.answer_tables import candidate_answers
from valvesim.diagnosis.detection import beyond_noise, verified_chi_square
from valvesim.diagnosis.joint_errors import JointErrors
from valvesim.diagnosis.model_selection import FittedHypothesis, answer_set_width, distinct
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.result import AMBIGUOUS, CAUSE
from valvesim.diagnosis.wording import summary_text
from valvesim.errors import SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.noise_model import NoiseModel
from valvesim.valve.catalogue import CATALOGUE


def fitted(*names):
    """Catalogue effects at their typical strength."""
    candidates = [Candidate(name, CATALOGUE[name]) for name in names]
    return tuple(FittedCandidate(candidate, candidate.typical) for candidate in candidates)


def hypothesis(chi_square, *names):
    """A hypothesis of catalogue effects, fitted."""
    fit = Fit(np.zeros(1), fitted(*names), chi_square, (), np.zeros(1), 5000.0)
    return FittedHypothesis(fit, options=DIAGNOSIS)


def nominal(chi_square, weights=()):
    """A nominal fit that leaves so much, under a study with those weights."""
    model = SimpleNamespace(parameters=())
    study = SimpleNamespace(
        candidates=(), weights=dict.fromkeys(weights), options=DIAGNOSIS.identification, noise={}, nominal=model,
        discrepancy={},
    )  # fmt: skip
    return SimpleNamespace(study=study, fit=Fit(np.zeros(1), (), chi_square, (), np.zeros(1), 5000.0))


@pytest.mark.parametrize("left", [90_000.0, 5_100.0])  # far from the records, or near them but for peaks
def test_where_the_nominal_fit_is_exchanged_its_own_score_test_takes_the_place_of_the_old(monkeypatch, left):
    weighted, full = nominal(left, ["leakage"]), nominal(95_000.0)
    best = hypothesis(5000.0, "spool_lap")

    def score_test(nominal, fit, *, options):
        return SimpleNamespace(nominal=nominal, fit=fit, options=options)

    monkeypatch.setattr(isolation, "score_test", score_test)
    monkeypatch.setattr(isolation, "with_second_cause", lambda nominal, final, found: (found, final))
    monkeypatch.setattr(isolation, "with_other_pairs", lambda nominal, found, final: (found, final))
    no_starts = frozenset()
    monkeypatch.setattr(
        isolation, "effects_for_parameters", lambda nominal, scores, found, final: (found, final, no_starts)
    )
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (full, found, final))
    before = score_test(weighted, weighted.fit, options=DIAGNOSIS)
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is full and scores.nominal is full and scores.fit is full.fit and found == [best]
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (nominal, found, final))
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is weighted and scores is before


def score_test_of(nominal, fit, *, options=DIAGNOSIS):
    """The score test of a fit in which nothing shows."""
    return SimpleNamespace(
        nominal=nominal,
        study=nominal.study,
        fit=fit,
        options=options,
        z=lambda: np.zeros(1),
        level=lambda probability: 4.0,
    )


def score_test_that_shows(z):
    """A stub of `score_test` whose largest z is known."""

    def score_test(nominal, fit, *, options):
        scores = score_test_of(nominal, fit)
        scores.z = lambda: np.array([z])
        return scores

    return score_test


def beside_none(nominal, scores, cause, known, *, options):
    return nominal, scores, None


@pytest.fixture(autouse=True)
def inputs_are_all_measured(monkeypatch):
    monkeypatch.setattr(isolation, "with_assumed_inputs", lambda nominal, scores, options: (nominal, scores))
    monkeypatch.setattr(isolation, "cause_under_other_inputs", lambda nominal, best, options: None)
    monkeypatch.setattr(isolation, "instrument_errors_are_insignificant", lambda scores, least_gain, options: False)
    monkeypatch.setattr(isolation, "all_instrument_errors", lambda scores, least_gain: None)


@pytest.mark.parametrize("beside, alarm", [(100.0, True), (1e8, False)])
def test_what_is_little_beside_what_the_bench_explains_is_the_bench(monkeypatch, beside, alarm):
    base, found = nominal(9000.0), []
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "with_bench_faults", lambda nominal, scores, options: (nominal, scores))
    monkeypatch.setattr(isolation, "likeliest_cause", lambda nominal, scores, known, options: None)
    monkeypatch.setattr(isolation, "with_faults_beside_cause", beside_none)
    monkeypatch.setattr(isolation, "channel_apart", lambda nominal, scores, options: None)
    monkeypatch.setattr(isolation, "told_faults", lambda scores, options: ("a ripple",))
    monkeypatch.setattr(isolation, "joint_instrument_errors", lambda scores, options: None)
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    for module in (isolation, detection):
        monkeypatch.setattr(module, "explained_by_bench", lambda scores: beside)

    def isolated(nominal, scores, progress, known, beside, *, options):
        return isolation.Isolation(nominal, scores, scores, found, [], "", True, 4.0)

    monkeypatch.setattr(isolation, "_isolated", isolated)
    ended = isolation.isolate(base, lambda stage, share: None, options=DIAGNOSIS)
    assert ended.alarm is alarm and ended.bench == ("a ripple",)


@pytest.mark.parametrize("other", ["", "any", "edges"])
@pytest.mark.parametrize("again, taken", [(4000.0, True), (4990.0, False)])
def test_a_nominal_fit_with_figures_far_off_is_made_again_from_within_tolerance(monkeypatch, again, taken, other):
    base, asked = nominal(5000.0), []
    base.fit = replace(base.fit, point=np.array([4.0]))
    renewed = nominal(again)
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "with_bench_faults", lambda nominal, scores, options: (nominal, scores))
    monkeypatch.setattr(isolation, "detect", lambda scores: (scores.fit.chi_square > 4500.0, 4.0))
    monkeypatch.setattr(isolation, "is_certain", lambda scores, level: True)
    monkeypatch.setattr(isolation, "rescored", lambda study, fit: fit)
    monkeypatch.setattr(isolation, "evaluate_fit", lambda study, point, fitted, near=(): replace(base.fit, point=point))

    def refit(nominal, start, within, remaining_share):
        asked.append(start.point.tolist())
        return renewed

    def under_others(nominal):  # and under other ways of its commands
        assert nominal is (renewed if taken else base)
        return under_other if other == "any" else nominal

    def with_edges(nominal):  # and with edges, or otherwise between them
        assert nominal is (under_other if other == "any" else renewed if taken else base)
        return under_other if other == "edges" else nominal

    under_other = nominal(4600.0)
    monkeypatch.setattr(isolation, "refit_nominal", refit)
    monkeypatch.setattr(isolation, "with_inputs_tried", under_others)
    monkeypatch.setattr(isolation, "with_edges_tried", with_edges)
    ended, scores, _ = isolation._with_bench(base, score_test_of(base, base.fit), (), options=DIAGNOSIS)
    best = renewed if taken else base
    assert asked == [[2.0]] and ended is (under_other if other else best) and scores.fit is ended.fit
    known = (hypothesis(4400.0, "spool_lap").fit,)  # the records' beginnings have asked
    assert isolation._with_bench(base, score_test_of(base, base.fit), known, options=DIAGNOSIS)[0] is base
    assert asked == [[2.0]]


@pytest.mark.parametrize("moved, scored", [(0.0, 0), (1e-3, 1)])
def test_a_nominal_fit_that_refinement_does_not_move_is_not_scored_again(monkeypatch, moved, scored):
    base, finer, asked = nominal(5000.0), nominal(4990.0), []
    base.J = np.eye(1)

    def refined(study, fit, known):
        assert known is base.J
        return replace(finer.fit, point=base.fit.point + moved)

    def scored_of(one, fit, *, options):
        asked.append(one)
        return score_test_of(one, fit)

    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "is_certain", lambda scores, level: False)
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "with_edges_tried", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "with_bench_faults", lambda nominal, scores, options: (nominal, scores))
    monkeypatch.setattr(isolation, "refined", refined)
    monkeypatch.setattr(isolation, "linearise_nominal", lambda study, fit: finer)
    monkeypatch.setattr(isolation, "score_test", scored_of)
    ended, scores, _ = isolation._with_bench(base, score_test_of(base, base.fit), (), options=DIAGNOSIS)
    assert asked == [finer] * scored and ended is (finer if scored else base) and scores.fit is ended.fit


@pytest.mark.parametrize(
    "chi_square, jumps, taken",
    [(7000.0, True, True), (5050.0, True, False), (9e6, True, False), (7000.0, False, False)],
)
def test_edges_are_tried_where_an_adequate_fit_leaves_more_than_noise(monkeypatch, chi_square, jumps, taken):
    base, tried = nominal(chi_square), nominal(4990.0)
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (False, 4.0))
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "with_edges_tried", lambda nominal: tried if jumps else nominal)
    monkeypatch.setattr(isolation, "likeliest_cause", lambda nominal, scores, known, options: None)
    monkeypatch.setattr(isolation, "with_faults_beside_cause", beside_none)
    ended, scores, _ = isolation._with_bench(base, score_test_of(base, base.fit), (), options=DIAGNOSIS)
    assert ended is (tried if taken else base) and scores.fit is ended.fit


def test_where_a_better_nominal_fit_needs_no_cause_the_search_is_made_again_and_may_end_with_none(monkeypatch):
    base, better = nominal(9000.0), nominal(5000.0)
    searched = []

    def first(nominal, scores, known, beside, progress):
        searched.append((nominal, scores.nominal))
        return [hypothesis(4990.0, "spool_lap")], "spool_lap"

    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "first_hypotheses", first)
    again = {id(base): better}
    monkeypatch.setattr(isolation, "with_inputs_of_cause", lambda nominal, cause, options: None)
    monkeypatch.setattr(isolation, "better_nominal", lambda nominal, found, options: again.get(id(nominal)))
    monkeypatch.setattr(isolation, "restarted", lambda nominal, found, likeliest, options: [])
    monkeypatch.setattr(isolation, "refined_hypotheses", lambda nominal, found, options: found)
    ended = isolation._isolated(
        base, score_test_of(base, base.fit), lambda stage, share: None, (), (), options=DIAGNOSIS
    )
    assert searched == [(base, base), (better, better)] and ended.nominal is better
    assert ended.alarm and not ended.found and not ended.answer_set  # 10 are no gain at a level of 4


def test_where_the_best_cause_asks_for_another_way_of_the_commands_causes_are_sought_under_that(monkeypatch):
    base, other, asked = nominal(9000.0), nominal(8000.0), []
    stribeck, air = hypothesis(5000.0, "spool_stribeck_friction"), hypothesis(6000.0, "entrained_air")
    again = hypothesis(4900.0, "spool_stribeck_friction")

    def first(nominal, scores, known, beside, progress):
        asked.append((nominal, scores.nominal, list(beside)))
        return [air, stribeck], "entrained_air"

    def under(nominal, cause, *, options):
        assert cause is stribeck.fit
        return (other, again.fit) if nominal is base else None

    def ended(nominal, found, *, options):
        raise StopIteration

    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "first_hypotheses", first)
    monkeypatch.setattr(isolation, "without_corrections_of_laws", lambda nominal, found, options: found)
    monkeypatch.setattr(isolation, "with_inputs_of_cause", under)
    monkeypatch.setattr(isolation, "better_nominal", ended)
    with pytest.raises(StopIteration):
        isolation._isolated(base, score_test_of(base, base.fit), lambda *_: None, (), (), options=DIAGNOSIS)
    assert asked == [(base, base, []), (other, other, [again.fit])]


@pytest.mark.parametrize("pair, stands", [(True, True), (True, False), (False, True)])
def test_before_two_causes_are_told_one_is_tried_under_the_other_ways_of_the_commands(monkeypatch, pair, stands):
    base, other, asked = nominal(9000.0), nominal(8000.0), []
    eddy, inertia = hypothesis(5050.0, "eddy_current_lag"), hypothesis(5040.0, "spool_lap")
    both = hypothesis(5000.0, "spool_lap", "eddy_current_lag")
    found = [both, inertia, eddy] if pair else [inertia, eddy]
    again = hypothesis(4990.0, "eddy_current_lag")
    scores = score_test_of(base, base.fit)
    first = isolation.Isolation(base, scores, scores, found, found[:1], "", True, 4.0)
    under = replace(first, nominal=other, found=[again], answer_set=[again] if stands else [])

    def of_one(nominal, best, alone, *, options):
        assert (nominal, best, alone) == (base, both.fit, [inertia.fit, eddy.fit])
        return other, again.fit

    def sought(nominal, scores, progress, known, beside, *, options):
        asked.append((nominal, scores.nominal, list(known), list(beside)))
        return under

    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "with_inputs_of_one_cause", of_one)
    monkeypatch.setattr(isolation, "_isolated", sought)
    ended = isolation._or_one_cause_under_other_inputs(first, lambda *_: None, options=DIAGNOSIS)
    assert ended is (under if pair and stands else first)
    assert asked == ([(other, other, [], [again.fit])] if pair else [])


@pytest.mark.parametrize("causes, doubt, tried", [
    (2, "", False), (2, "an unknown cause may be", True), (1, "an unknown cause may be", False), (0, "", True),
])  # fmt: skip
def test_where_an_unknown_cause_may_stand_beside_two_each_is_tried_under_other_ways(monkeypatch, causes, doubt, tried):
    """The lag of a current loop had been an eddy current with a damping, under commands taken as held (1310100)."""
    base, asked = nominal(9000.0), []
    best = hypothesis(5000.0, *("spool_lap", "entrained_air")[: max(causes, 1)])
    scores = score_test_of(base, base.fit)
    first = isolation.Isolation(base, scores, scores, [best], [best] if causes else [], doubt, True, 4.0)
    for name in ("one", "likeliest"):
        monkeypatch.setattr(isolation, f"with_inputs_of_{name}_cause", lambda *given, options: None)
    monkeypatch.setattr(isolation, "with_inputs_of_any_cause", lambda *given, options: asked.append(given))
    assert isolation._or_one_cause_under_other_inputs(first, lambda *_: None, options=DIAGNOSIS) is first
    assert asked == ([(base, best.fit, [best.fit])] if tried else [])


@pytest.mark.parametrize("left, asked", [(100.0, []), (900.0, ["bench"])])
def test_the_bench_is_not_sought_without_a_cause_that_explains_nearly_all(monkeypatch, left, asked):
    """Beside a backlash the bench was known; without it others were found, and ways of the commands that were not
    (1170212, in twice the time).
    """
    base, called, rows = nominal(1e4), [], nominal(1e4).fit.rows
    cause = replace(base.fit, chi_square=rows + left / 1e4 * (base.fit.chi_square - rows))
    monkeypatch.setattr(isolation, "is_adequate", lambda fit, options: False)
    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "is_certain", lambda scores, level: True)
    monkeypatch.setattr(isolation, "is_other_valve", lambda nominal, fit, options: False)
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "with_model_discrepancy", lambda nominal, likely, options: None)
    monkeypatch.setattr(isolation, "likeliest_cause", lambda nominal, scores, known, options: cause)
    monkeypatch.setattr(
        isolation, "with_faults_beside_cause", lambda nominal, scores, *given, options: (nominal, scores, cause)
    )

    def sought(nominal, scores, *, options):
        called.append("bench")
        return nominal, scores

    monkeypatch.setattr(isolation, "with_bench_faults", sought)
    _, _, beside = isolation._with_bench(base, score_test_of(base, base.fit), (), options=DIAGNOSIS)
    assert beside == [cause] and called == asked


@pytest.mark.parametrize("pair, stands", [(True, True), (True, False), (False, True)])
def test_a_cause_that_shows_under_another_way_of_the_commands_is_tried_against_a_pair_or_none(
    monkeypatch, pair, stands
):
    base, other, again = nominal(9000.0), nominal(9100.0), hypothesis(4990.0, "eddy_current_lag")
    both = hypothesis(5000.0, "spool_lap", "entrained_air")
    scores = score_test_of(base, base.fit)
    first = isolation.Isolation(base, scores, scores, [both], [both] if pair else [], "", True, 4.0)
    under = replace(first, nominal=other, found=[again], answer_set=[again] if stands else [])
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    for name in ("one", "any"):
        monkeypatch.setattr(isolation, f"with_inputs_of_{name}_cause", lambda *given, options: None)
    monkeypatch.setattr(
        isolation, "with_inputs_of_likeliest_cause", lambda nominal, best, *, options: (other, again.fit)
    )
    monkeypatch.setattr(isolation, "_isolated", lambda *given, options: under)
    ended = isolation._or_one_cause_under_other_inputs(first, lambda *_: None, options=DIAGNOSIS)
    assert ended is (under if stands else first)


def test_a_cause_that_another_one_equals_under_another_way_of_the_commands_is_in_doubt(monkeypatch):
    best, base = hypothesis(4900.0, "spool_lap"), nominal(9000.0)
    scores, other = SimpleNamespace(options=DIAGNOSIS), hypothesis(4900.0, "eddy_current_lag").candidates[0]
    monkeypatch.setattr(conclusion, "is_inadequate", lambda nominal, fit, options: False)
    sure = isolation.Isolation(base, scores, scores, [best], [best], "", True, 4.0)
    assert (conclusion.conclude(sure).verdict, conclusion.conclude(sure).doubt) == (CAUSE, "")
    doubted = conclusion.conclude(replace(sure, under_other_inputs=other))
    way = "eddy current lag, if the commands went another way between their samples (sample faster)"
    assert (doubted.verdict, doubted.doubt) == (AMBIGUOUS, way)
    errors = JointErrors(100.0, ("a meter is off",), 5080.0)
    both = conclusion.conclude(replace(sure, under_other_inputs=other, joint_errors=errors)).doubt
    beside = "none of the known causes: errors of the instruments explain it as well (a meter is off)"
    assert both == f"{way}, or {beside}"
    assert summary_text(AMBIGUOUS, [best], None, doubt=way) == f"Something is wrong, perhaps spool lap, or {way}."


@pytest.mark.parametrize("joins", [True, False])
def test_what_the_bench_did_that_a_cause_leaves_joins_before_a_second_cause_is_sought(monkeypatch, joins):
    base, wider, asked = nominal(9000.0), nominal(8000.0), []
    lap, behind = hypothesis(5000.0, "spool_lap"), hypothesis(6000.0, "entrained_air")

    def first(nominal, scores, known, beside, progress):
        asked.append((nominal, list(known)))
        return [lap, behind], "spool_lap"

    def verified(nominal, scores, level, found, known):
        assert [one.fit for one in known] == [lap.fit]
        return nominal, scores, found, scores

    same = lambda nominal, found, *more, options, of_fitted=False: []  # noqa: E731
    alike = ("unfitted_plainer_hypotheses", "plainer_hypotheses", "alike_hypotheses", "hypotheses_at_other_shapes")
    for name in ("restarted", *alike):
        monkeypatch.setattr(isolation, name, same)
    for name in ("refined_hypotheses", "without_corrections_of_laws", "reduced_hypotheses"):
        monkeypatch.setattr(isolation, name, lambda nominal, found, options: found)
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (True, 4.0))
    monkeypatch.setattr(isolation, "first_hypotheses", first)
    monkeypatch.setattr(isolation, "with_inputs_of_cause", lambda nominal, cause, options: None)
    monkeypatch.setattr(isolation, "better_nominal", lambda nominal, found, options: None)
    monkeypatch.setattr(isolation, "bearable_beside_bench", lambda scores: 0.0)
    monkeypatch.setattr(isolation, "_verified", verified)
    monkeypatch.setattr(isolation, "judged", lambda one: one)
    monkeypatch.setattr(isolation, "answer_set_of", lambda nominal, found, options: found[:1])
    monkeypatch.setattr(isolation, "with_fault_left", lambda nominal, left, options: wider if joins else None)
    ended = isolation._isolated(
        base, score_test_of(base, base.fit), lambda stage, share: None, (), (), options=DIAGNOSIS
    )
    assert asked == [(base, []), (wider, [lap.fit])] if joins else [(base, [])]
    assert ended.nominal is (wider if joins else base) and ended.found[0] is lap


def test_beside_a_fault_of_the_bench_single_causes_go_on_though_a_pair_had_explained_as_much():
    """A weak magnet and a cavitation: a meter's zeros that move explain the second, and the magnet was not tried."""
    base = nominal(9000.0)
    pair = hypothesis(5000.0, "magnet_demagnetization", "flapper_cavitation")
    magnet = hypothesis(5060.0, "magnet_demagnetization")
    far = hypothesis(8000.0, "entrained_air")
    known = isolation._likely_beside_fault(base, [pair, magnet, far], options=DIAGNOSIS)
    assert [one.chi_square for one in known] == [5000.0, 5060.0]
    assert isolation._likely_beside_fault(base, [pair], options=DIAGNOSIS) == [pair.fit]


@pytest.mark.parametrize("seed", range(10))
def test_what_may_be_left_over_is_little_and_no_more_than_a_plant_does_otherwise(seed):
    """Of a hypothesis that explains nothing too, where a product of the two shares had turned the comparison around."""
    dice, detection = np.random.default_rng(seed), DIAGNOSIS.detection
    for _ in range(300):
        one = hypothesis(5000.0, *dice.choice(["spool_lap", "magnetic_hysteresis"], 1))
        explained, left = float(dice.normal() * 10.0 ** dice.uniform(-3.0, 6.0)), float(10.0 ** dice.uniform(-4.0, 1.0))
        base = nominal(5000.0 + explained)
        explained = base.fit.chi_square - one.fit.chi_square
        is_little = left <= detection.little_share and left * explained <= DIAGNOSIS.selection.second_gain
        may_leave = isolation._may_leave(base, one, left)
        assert may_leave == (is_little or left <= max(detection.doubtful_share, one.law_error))


def test_a_hypothesis_found_with_errors_and_without_stands_once_as_the_likelier():
    """A gap and a cavitation stood twice in one table, with errors of the instruments and without (pair 221501)."""
    gap, pair = hypothesis(5100.0, "null_gap_asymmetry"), ("null_gap_asymmetry", "flapper_cavitation")
    other = hypothesis(5020.0, "null_gap_asymmetry", "spool_lap")
    for own, rival in ((5000.0, 5010.0), (5010.0, 5000.0)):
        with_errors, without = hypothesis(own, *pair), hypothesis(rival, *reversed(pair))
        likelier = min(with_errors, without, key=lambda one: one.evidence)
        found = isolation._with_likelier([gap, with_errors], [without, other])
        assert found[0] is gap and len(found) == 3
        assert [one for one in found if one.has_same_causes(with_errors)] == [likelier]


def test_what_another_law_of_an_effect_does_better_is_no_second_cause(monkeypatch):
    base = nominal(105_000.0)
    single, pair = hypothesis(30_000.0, "magnetic_hysteresis"), ("magnetic_hysteresis", "spool_lap")
    assert single.law_error == 0.2
    corrected, second = hypothesis(16_000.0, *pair), hypothesis(14_000.0, *pair)
    other = hypothesis(16_000.0, "spool_lap", "entrained_air")
    monkeypatch.setattr(second_cause, "beyond_noise", lambda fit, study, *, options: max(fit.chi_square - 5000.0, 0.0))
    kept = second_cause.without_corrections_of_laws(base, [corrected, other, single], options=DIAGNOSIS)
    assert kept == [other, single]
    for more in (second, hypothesis(5000.0, *pair)):  # more than a law errs by
        assert second_cause.without_corrections_of_laws(base, [more, single], options=DIAGNOSIS) == [more, single]
    near = hypothesis(6000.0, "magnetic_hysteresis")
    whole = hypothesis(5000.0, *pair)  # leaves no more than noise
    assert second_cause.without_corrections_of_laws(base, [whole, near], options=DIAGNOSIS) == [whole, near]
    starts = [(*near.fit.fitted, *other.fit.fitted[:1]), other.fit.fitted]
    assert second_cause.without_corrections_begun(base, starts, [near]) == starts
    base.study.discrepancy = {("record_1", "load_flow"): np.ones(1)}  # what the law errs by is noise there
    assert second_cause.without_corrections_of_laws(base, [whole, near], options=DIAGNOSIS) == [near]
    assert second_cause.without_corrections_begun(base, starts, [near, other]) == starts[1:]
    assert second_cause.without_corrections_begun(base, starts, [single, other]) == starts  # it leaves more than that


def test_what_is_far_behind_the_best_is_not_refined(monkeypatch):
    asked = []

    def refined(study, fit):
        asked.append(fit.chi_square)
        return replace(fit, chi_square=fit.chi_square - 2.0)

    monkeypatch.setattr(refits, "refined", refined)
    best, near, far = (
        hypothesis(chi_square, name)
        for chi_square, name in ((4900.0, "spool_lap"), (4910.0, "entrained_air"), (4990.0, "spool_coulomb_friction"))
    )
    ended = refits.refined_hypotheses(nominal(9000.0), [far, near, best], options=DIAGNOSIS)
    assert asked == [4900.0, 4910.0]
    assert [one.fit.chi_square for one in ended] == [4898.0, 4908.0, 4990.0] and ended[-1] is far
    asked.clear()  # a friction that promised 465 more stood 294 behind another law of it, and was the cause (960128)
    unsettled = replace(far, fit=replace(far.fit, predicted_reduction=100.0))
    refits.refined_hypotheses(nominal(9000.0), [unsettled, near, best], options=DIAGNOSIS)
    assert asked == [4900.0, 4910.0, 4990.0]


def test_what_may_come_near_and_laws_as_common_are_fitted_to_their_ends_before_they_are_weighed(monkeypatch):
    asked = []

    def refined(study, fit, enough=None):
        asked.append((fit.fitted[0].candidate.name, enough))
        return replace(fit, chi_square=fit.chi_square - 2.0)

    monkeypatch.setattr(refits, "refined", refined)
    coulomb, stribeck, far, lap = (
        hypothesis(chi_square, name)
        for chi_square, name in (
            (4900.0, "spool_coulomb_friction"), (4899.0, "spool_stribeck_friction"),
            (8000.0, "spool_stribeck_friction"), (4901.0, "spool_lap"),
        )
    )  # fmt: skip
    ended = refits.with_fits_at_ends(nominal(9000.0), [stribeck, coulomb, lap], options=DIAGNOSIS)
    enough = DIAGNOSIS.identification.fit.law_ftol
    assert asked == [("spool_stribeck_friction", enough), ("spool_coulomb_friction", enough)]
    assert [one.fit.chi_square for one in ended] == [4897.0, 4898.0, 4901.0] and ended[-1] is lap
    asked.clear()
    for found in ([coulomb, lap], [coulomb, lap, far], []):  # none is weighed by so little
        assert refits.with_fits_at_ends(nominal(9000.0), found, options=DIAGNOSIS) == found and not asked
    # a hysteresis that still promised 25 stood 18 behind an eddy current, which was told for sure (pair 225009)
    behind = hypothesis(4900.0 + answer_set_width(nominal(9000.0), lap) + 18.0, "magnetic_hysteresis")
    short = replace(behind, fit=replace(behind.fit, predicted_reduction=25.0))
    assert len(refits.with_fits_at_ends(nominal(9000.0), [lap, short], options=DIAGNOSIS)) == 2
    assert asked == [("magnetic_hysteresis", None)]
    refits.with_fits_at_ends(nominal(9000.0), [lap, behind], options=DIAGNOSIS)
    assert len(asked) == 1


def test_a_pair_near_the_best_is_fitted_with_the_fuller_law_of_one_of_the_two_too(monkeypatch):
    """A second cause is begun beside the likelier of two friction laws alone: Stribeck friction beside a drift of the
    null gap was never fitted, and not in the set (pair 227500).
    """
    laws = [hypothesis(5000.0, name).candidates[0] for name in ("spool_coulomb_friction", "spool_stribeck_friction")]
    base = nominal(9000.0)
    base.study.candidates = [*laws, *hypothesis(5000.0, "entrained_air", "spool_silting").candidates]
    asked = []

    def fitted(nominal, starts, best, *, options):
        asked.extend([[one.candidate.name for one in start] for start in starts])
        return [hypothesis(best.fit.chi_square - 1.0, *(one.candidate.name for one in start)) for start in starts]

    monkeypatch.setattr(refits, "_fitted_in_place", fitted)
    alone = hypothesis(4990.0, "spool_coulomb_friction")
    best = hypothesis(4900.0, "entrained_air", "spool_lap")
    near = hypothesis(4903.0, "spool_coulomb_friction", "entrained_air")
    far = hypothesis(8000.0, "spool_coulomb_friction", "spool_lap")
    found = refits.with_fuller_laws(base, [best, near, alone, far], options=DIAGNOSIS)
    assert asked == [["spool_stribeck_friction", "entrained_air"]]
    assert [one.label for one in found[:3]] == [best.label, "spool_stribeck_friction + entrained_air", near.label]
    assert refits.with_fuller_laws(base, found, options=DIAGNOSIS) == found and len(asked) == 1  # it was fitted
    for none in ([], [alone]):
        assert refits.with_fuller_laws(base, none, options=DIAGNOSIS) == none and len(asked) == 1


def test_a_pair_of_which_one_comes_to_nothing_is_what_it_is_without_it(monkeypatch):
    """Known from a search with another bench, it was the only hypothesis, and none was left (880128)."""
    pair, asked = hypothesis(4900.0, "spool_lap", "entrained_air"), []
    kept, gone = pair.fit.fitted

    def fitted(nominal, start, point, *, worthwhile):
        asked.append(start)
        return replace(pair.fit, fitted=tuple(start))

    nothing = replace(pair.fit, fitted=(kept, replace(gone, above_neutral=0.0)))
    monkeypatch.setattr(refits, "refined", lambda study, fit: nothing)
    monkeypatch.setattr(refits, "fit_hypothesis", fitted)
    ended = refits.refined_hypotheses(nominal(9000.0), [pair], options=DIAGNOSIS)
    assert asked == [(kept,)]
    assert [one.label for one in distinct(ended, options=DIAGNOSIS)] == ["spool_lap"]
    short = replace(pair, fit=replace(pair.fit, predicted_reduction=25.0))
    (alone,) = refits.with_fits_at_ends(nominal(9000.0), [short], options=DIAGNOSIS)
    assert alone.label == "spool_lap" and asked == [(kept,), (kept,)]


@pytest.mark.parametrize("left, named", [(0.0, ["spool_lap"]), (0.5, [])])
def test_where_even_the_best_leaves_much_over_none_is_the_answer(monkeypatch, left, named):
    base, best = nominal(9000.0), hypothesis(4900.0, "spool_lap")
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "unexplained_share", lambda nominal, final: left)
    monkeypatch.setattr(isolation, "rival_terms", lambda nominal, final: [])
    scores, final = score_test_of(base, base.fit), score_test_of(base, best.fit)
    judged = isolation.judged(isolation.Isolation(base, scores, final, [best], [], "", True, 4.0))
    assert [one.label for one in judged.answer_set] == named and judged.found == [best]


@pytest.mark.parametrize(
    "explained, left, named",
    [(130.0, 17.0, True), (130.0, 27.0, False), (400.0, 29.0, True), (400.0, 31.0, False), (4100.0, 31.0, True)],
)
def test_what_leaves_no_more_than_a_plant_does_otherwise_is_possible_beside_an_unknown_cause(
    monkeypatch, explained, left, named
):
    """A flexure's loss of d' 11 left 17 of 124 by an amplitude that wanders, and was no answer (231504, 307005)."""
    base, best = nominal(4900.0 + explained), hypothesis(4900.0, "flexure_stiffness_loss")
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "unexplained_share", lambda nominal, final: left / explained)
    scores, final = score_test_of(base, base.fit), score_test_of(base, best.fit)
    judged = isolation.judged(isolation.Isolation(base, scores, final, [best], [], "", True, 4.0))
    assert [one.label for one in judged.answer_set] == ["flexure_stiffness_loss"] * named
    assert ("none of them explains" in judged.unknown_reason) is named


def test_what_the_plainer_of_two_leaves_that_fit_alike_is_looked_at_too(monkeypatch):
    base, plain = nominal(9000.0), hypothesis(4905.0, "spool_coulomb_friction")
    fuller = hypothesis(4900.0, "spool_silting")
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "rival_terms", lambda nominal, final: [])
    monkeypatch.setattr(isolation, "unexplained_share", lambda nominal, final: 0.01 * (final.fit is plain.fit))
    scores, final = score_test_of(base, base.fit), score_test_of(base, fuller.fit)
    judged = isolation.judged(isolation.Isolation(base, scores, final, [fuller, plain], [], "", True, 4.0))
    assert judged.found[0] is plain and judged.final.fit is plain.fit
    assert [one.label for one in judged.answer_set] == ["spool_coulomb_friction", "spool_silting"]


@pytest.mark.parametrize("other, asked", [("spool_lap + entrained_air", True), ("spool_coulomb_friction", False)])
def test_plain_terms_are_held_against_a_cause_that_all_of_an_answer_name(monkeypatch, other, asked):
    base, best, beside = nominal(9000.0), hypothesis(4900.0, "spool_lap"), hypothesis(4895.0, *other.split(" + "))
    monkeypatch.setattr(isolation, "unexplained_share", lambda nominal, final: 0.0)
    monkeypatch.setattr(isolation, "ranked", lambda nominal, found, level=0.0: list(found))
    monkeypatch.setattr(isolation, "answer_set_of", lambda *_, **__: [best, beside])
    monkeypatch.setattr(isolation, "rival_terms", lambda nominal, final: [SimpleNamespace(label="pilot flow")])
    scores, final = score_test_of(base, base.fit), score_test_of(base, best.fit)
    judged = isolation.judged(isolation.Isolation(base, scores, final, [best, beside], [], "", True, 4.0))
    assert judged.unknown_reason == ("a plain term does as well, the pilot flow" if asked else "")


@pytest.mark.parametrize(
    "together, shows, left, searches, causes",
    [(None, 20.0, 4400.0, 1, False), (JointErrors(300.0, (), 5100.0), 5.0, 4400.0, 1, False),
     (JointErrors(300.0, (), 5100.0), 20.0, 5000.0, 2, False), (JointErrors(300.0, (), 5100.0), 20.0, 4900.0, 2, True)],
)  # fmt: skip
def test_causes_are_sought_without_errors_of_instruments_that_explain_only_together(
    monkeypatch, together, shows, left, searches, causes
):
    base, plain, best = nominal(4900.0), nominal(5100.0), hypothesis(left, "spool_lap")
    by_errors = isolation.Isolation(base, score_test_of(base, base.fit), None, [], [], "", False, 4.0)
    by_cause = isolation.Isolation(plain, score_test_of(plain, plain.fit), None, [best], [best], "", True, 4.0)
    sought = []

    def isolated(at, scores, progress, known, beside, *, options):
        sought.append((at, options.bench.most_faults))
        return by_errors if at is base else by_cause

    for name, stub in {
        "score_test": score_test_that_shows(shows),
        "detect": lambda scores: (False, 4.0),
        "told_faults": lambda scores, options: (),
        "_isolated": isolated,
        "joint_instrument_errors": lambda scores, options: together,
        "without_instrument_errors": lambda nominal: plain,
        "nuisance_occam_factor": lambda scores: 100.0,
        "rescored": lambda study, fit: fit,
    }.items():
        monkeypatch.setattr(isolation, name, stub)
    found = isolation.isolate(base, lambda stage, share: None, options=DIAGNOSIS)
    assert found.alarm == causes and found.joint_errors is together
    assert sought == [(base, DIAGNOSIS.bench.most_faults), (plain, 0)][:searches]


@pytest.mark.parametrize(
    "together, shows, left, taken, beside",
    [
        (None, 9.0, 4840.0, False, False),  # they explain no more than chance
        (JointErrors(100.0, (), 5080.0), 3.0, 4840.0, False, False),  # no second cause shows without them
        (JointErrors(100.0, (), 5080.0), 9.0, 5200.0, False, False),  # one is found, and they are likelier
        (JointErrors(100.0, (), 5080.0), 9.0, 4958.0, False, True),  # they are as likely
        (JointErrors(100.0, (), 5080.0), 9.0, 4900.0, False, True),
        (JointErrors(100.0, (), 5080.0), 9.0, 4840.0, True, False),
    ],
)
def test_a_second_cause_may_act_like_errors_of_instruments(monkeypatch, together, shows, left, taken, beside):
    """Oil that was off by some tenths of a kelvin in four records had taken a cavitation up (130015, 130026); a meter
    off a straight line by 0.26 % did what a saturation does, and the cause beside it was told for sure (pair 223017).
    """
    base, plain = nominal(9000.0), nominal(9100.0)
    alone, pair = hypothesis(4900.0, "spool_lap"), hypothesis(left, "spool_lap", "flapper_cavitation")
    scores = score_test_of(base, base.fit)
    beside_errors = isolation.Isolation(base, scores, scores, [alone], [alone], "", True, 4.0, second_level=3.5)
    without = isolation.Isolation(plain, scores, scores, [pair, alone], [pair, alone], "", True, 4.0)
    seen = []

    def isolated(at, scores, progress, known, beside, *, options):
        seen.append((at, [fit.fitted for fit in known], options.bench.most_faults))
        return beside_errors if at is base else without

    for name, stub in {
        "score_test": score_test_that_shows(shows),
        "detect": lambda scores: (False, 4.0),
        "told_faults": lambda scores, options: (),
        "channel_apart": lambda nominal, scores, options: None,
        "_isolated": isolated,
        "all_instrument_errors": lambda final, least: together,
        "evaluate_fit": lambda study, point, fitted, near: hypothesis(left, "spool_lap", "flapper_cavitation").fit,
        "without_instrument_errors": lambda nominal: plain,
        "fit_starts": lambda nominal, starts, point, *, options: [hypothesis(4990.0, "spool_lap")],
        "nuisance_occam_factor": lambda scores: 120.0,
        "rescored": lambda study, fit: fit,
    }.items():
        monkeypatch.setattr(isolation, name, stub)
    found = isolation.isolate(base, lambda stage, share: None, options=DIAGNOSIS)
    rivals = found.found[1:] if beside else []
    assert found.found == (without.found if taken else [*beside_errors.found, *rivals])
    assert found.answer_set == (without.answer_set if taken else [*beside_errors.answer_set, *rivals])
    if beside:
        (rival,) = rivals
        assert rival.label == pair.label and alone.evidence <= rival.evidence < alone.evidence + 6.0
    assert found.joint_errors is (together if taken else None)
    assert seen[1:] == ([(plain, [alone.fit.fitted], 0)] if together is not None and shows > 3.5 else [])


@pytest.mark.parametrize(
    "shows, own, asked",
    [
        (9.0, True, True),  # 4900 + 40 + 120 without errors, less twice 81
        (7.0, True, True),
        (5.0, True, False),  # no second cause may make 160 up
        (0.0, False, True),  # it is not of the best fit: nothing is known
    ],
)
def test_what_no_second_cause_can_make_up_is_not_fitted_without_errors(monkeypatch, shows, own, asked):
    base, alone = nominal(9000.0), hypothesis(4900.0, "spool_lap")
    final = score_test_of(base, alone.fit if own else base.fit)
    final.without_parameters = lambda which: (alone.fit.chi_square + 40.0, np.array([1.0, shows]))
    beside = isolation.Isolation(base, final, final, [alone], [alone], "", True, 4.0)
    monkeypatch.setattr(isolation, "error_places", lambda study: [0])
    monkeypatch.setattr(isolation, "nuisance_occam_factor", lambda scores, without=(): 120.0)
    most = alone.evidence + 160.0 - 2.0 * 40.0
    assert isolation._promises_second(beside, most, options=DIAGNOSIS) is asked


@pytest.mark.parametrize(
    "idle, shows, by_errors, left, taken",
    [
        (False, 9.0, 4990.0, 4840.0, False),  # the bench is told something by itself, or all it did together shows
        (True, 3.0, 4990.0, 4840.0, False),  # no second cause shows at full weight
        (True, 9.0, 4830.0, 4840.0, False),  # errors of the instruments explain as much of the peaks
        (True, 9.0, 4990.0, 4990.0, False),  # a second cause is found that explains too little
        (True, 9.0, 4990.0, 4840.0, True),
    ],
)
def test_errors_of_instruments_that_show_nothing_hide_no_second_cause(monkeypatch, idle, shows, by_errors, left, taken):
    """A pinch beside a lag explains 14 where samples next to peaks count less, and 146 at full weight (pair 221517)."""
    base, plain = nominal(9000.0, ["leakage"]), nominal(9100.0, ["leakage"])
    alone, pair = hypothesis(4900.0, "spool_lap"), hypothesis(left, "spool_lap", "spool_thermal_pinch")
    scores = score_test_of(base, base.fit)
    beside_errors = isolation.Isolation(base, scores, scores, [alone], [alone], "", True, 4.0, second_level=3.5)
    without = isolation.Isolation(plain, scores, scores, [pair, alone], [pair, alone], "", True, 4.0)
    within, full = nominal(9000.0), nominal(9100.0)
    for name, stub in {
        "instrument_errors_are_insignificant": lambda scores, least_gain, options: idle,
        "has_uncertain_inputs": lambda study: True,
        "without_instrument_errors": lambda nominal: plain,
        "unweighted": lambda one: within if one is base else full,
        "fit_starts": lambda at, starts, point, *, options: [
            hypothesis(by_errors if at is within else 4990.0, "spool_lap")
        ],
        "is_adequate": lambda fit, *, options: True,
        "score_test": score_test_that_shows(shows),
        "nuisance_occam_factor": lambda scores: 120.0,
        "rescored": lambda study, fit: fit,
        "_isolated": lambda *args, options: without,
    }.items():
        monkeypatch.setattr(isolation, name, stub)
    progress = lambda stage, share: None  # noqa: E731
    found = isolation._or_second_without_insignificant_errors(beside_errors, progress, options=DIAGNOSIS)
    assert found is (without if taken else beside_errors)


def test_where_no_valve_runs_with_the_likeliest_the_search_begins_with_the_others(monkeypatch):
    base, asked = nominal(9000.0), []

    def starts(scores, failed):
        asked.append(set(failed))
        return [fitted(name) for name in ("spool_lap", "entrained_air") if name not in failed]

    def fits(nominal, starts, point, progress, others, options):
        return [hypothesis(5000.0, "entrained_air") for (one,) in starts if one.candidate.name == "entrained_air"]

    monkeypatch.setattr(first_hypotheses, "start_points", starts)
    monkeypatch.setattr(first_hypotheses, "fit_starts", fits)
    scores = score_test_of(base, base.fit)
    found, likeliest = first_hypotheses.first_hypotheses(base, scores, (), (), lambda share: None)
    assert [one.label for one in found] == ["entrained_air"] and likeliest == "entrained_air"
    assert asked == [set(), {"spool_lap"}]
    monkeypatch.setattr(first_hypotheses, "fit_starts", lambda nominal, starts, point, progress, others, options: [])
    assert first_hypotheses.first_hypotheses(base, scores, (), (), lambda share: None)[0] == []


@pytest.mark.parametrize(
    "left, verified, shift, pairs",
    [
        (4000.0, True, 0.0, False),
        (9000.0, True, 0.0, True),
        (4000.0, False, 0.0, True),
        (4000.0, True, -7.8, True),  # lost turns by figures of the coil that are stretched (pair 229516)
    ],
)
def test_pairs_are_fitted_unless_one_alone_explains_all_but_verified_noise(monkeypatch, left, verified, shift, pairs):
    base, asked = nominal(9000.0), []
    base.study.noise["spool_position", 1e-3] = SimpleNamespace(verified=verified)
    base.study.predictors = ()
    lap, air = fitted("spool_lap")[0], fitted("entrained_air")[0]

    def fits(nominal, starts, point, progress, others, options):
        asked.extend(len(start) for start in starts)
        one = hypothesis(left, "spool_lap")
        return [replace(one, fit=replace(one.fit, point=np.array([shift])))]

    monkeypatch.setattr(first_hypotheses, "start_points", lambda scores, failed: [(lap,), (lap, air)])
    monkeypatch.setattr(first_hypotheses, "fit_starts", fits)
    first_hypotheses.first_hypotheses(base, score_test_of(base, base.fit), (), (), lambda share: None)
    assert asked == ([1, 2] if pairs else [1])


def test_a_hypothesis_that_cannot_be_simulated_here_is_no_better_place_for_a_fit(monkeypatch):
    def not_run(*_):
        raise SolveError("no valve")

    base, lap = nominal(9000.0), hypothesis(5000.0, "spool_lap")
    monkeypatch.setattr(first_hypotheses, "evaluate_fit", not_run)
    monkeypatch.setattr(first_hypotheses, "evaluated_beside", not_run)
    assert first_hypotheses._known_hypotheses(base, [lap.fit], lambda share: None, options=DIAGNOSIS) == []
    assert first_hypotheses.better_nominal(base, [lap], options=DIAGNOSIS) is None


@pytest.mark.parametrize(
    "ends, without, reaches, better",
    [
        (5000.0, 6000.0, 5500.0, True),  # most of what it explains it explains without its cause
        (5000.0, 8500.0, 5500.0, False),  # without its cause it is lost: no fit is made
        (8960.0, 9500.0, 8962.0, True),  # it is slight: a fit is made, and is as good without the cause
        (8960.0, 9500.0, 8995.0, False),  # the same, and the cause was needed
        (9011.0, 9001.0, 9000.0, False),  # it explains nothing, and no nominal fit is better
    ],
)
def test_a_nominal_fit_that_stopped_short_is_made_anew_from_a_hypothesis(monkeypatch, ends, without, reaches, better):
    base, lap, end = nominal(9000.0), hypothesis(ends, "spool_lap"), nominal(reaches)
    monkeypatch.setattr(first_hypotheses, "evaluate_fit", lambda study, point, fitted, near=(): nominal(without).fit)
    monkeypatch.setattr(first_hypotheses, "refit_nominal", lambda nominal, fit, within: end)
    monkeypatch.setattr(first_hypotheses, "rescored", lambda study, fit: fit)
    assert first_hypotheses.better_nominal(base, [lap], options=DIAGNOSIS) is (end if better else None)


@pytest.mark.parametrize("apart, fits", [(0.0, 1), (0.04, 1), (0.06, 2), (5.0, 2)])
def test_a_nominal_fit_is_begun_once_of_hypotheses_that_have_gone_to_one_point(monkeypatch, apart, fits):
    base, begun = nominal(9000.0), []
    base.J = np.array([[3.0], [4.0]])
    first, second = hypothesis(8960.0, "spool_lap"), hypothesis(8970.0, "null_gap_asymmetry")
    first.fit.point[:], second.fit.point[:] = 1.0, 1.0 + apart

    def refit(nominal, fit, within):
        begun.append(fit.point)
        return SimpleNamespace(study=nominal.study, fit=replace(fit, chi_square=8998.0 - 17.0 * len(begun)))

    def evaluated(study, point, fitted, near=()):
        return replace(first.fit, point=point)

    monkeypatch.setattr(first_hypotheses, "evaluate_fit", evaluated)
    monkeypatch.setattr(first_hypotheses, "refit_nominal", refit)
    monkeypatch.setattr(first_hypotheses, "rescored", lambda study, fit: fit)
    # the first ends 19 better, for 20 that are asked; half of what the second explains is 15
    better = first_hypotheses.better_nominal(base, [second, first], options=DIAGNOSIS)
    assert better.fit.chi_square == 8998.0 - 17.0 * fits and len(begun) == fits


def test_a_nominal_fit_is_not_begun_of_a_hypothesis_that_explains_little_beside_the_best(monkeypatch):
    """Of five figures that act like a flexure's loss each took two seconds (bench 1170170)."""
    base, asked = nominal(9000.0), []
    found = [hypothesis(9000.0 - gain, name) for gain, name in
             ((20.0, "spool_lap"), (12.0, "null_gap_asymmetry"), (9.0, "entrained_air"))]  # fmt: skip
    monkeypatch.setattr(first_hypotheses, "evaluate_fit", lambda study, point, fitted, near=(): nominal(9500.0).fit)
    monkeypatch.setattr(first_hypotheses, "_lie_together", lambda *_, options: False)
    monkeypatch.setattr(first_hypotheses, "refit_nominal", lambda nominal, fit, within: asked.append(within) or base)
    monkeypatch.setattr(first_hypotheses, "rescored", lambda study, fit: fit)
    assert first_hypotheses.better_nominal(base, found, options=DIAGNOSIS) is None
    assert asked == [10.0, 6.0]


def test_where_nothing_is_found_about_a_nominal_fit_far_out_single_causes_are_fitted_from_within(monkeypatch):
    lap = hypothesis(5000.0, "spool_lap")
    base = nominal(9000.0)
    far = SimpleNamespace(study=base.study, fit=replace(base.fit, point=np.full(1, DIAGNOSIS.isolation.shifted + 1.0)))

    def singles(nominal, scores, level, found, final, tried):
        return [lap], score_test_of(nominal, lap.fit)

    monkeypatch.setattr(isolation, "with_fits_from_prior", singles)
    for one, found in ((far, [lap]), (base, [])):
        assert isolation._verified(one, score_test_of(one, one.fit), 4.0, [])[2] == found


ROWS, CHANNELS = 400, ("spool_position", "load_flow")


def white_study(verified, excess, seed=0):
    """A study of one record of white noise of unit size, and a fit that leaves (1 + excess) times it."""
    rng = np.random.default_rng(seed)
    values = {name: rng.normal(size=ROWS) * np.sqrt(1.0 + by) for name, by in zip(CHANNELS, excess, strict=True)}
    record = SimpleNamespace(name="one", outputs=CHANNELS, pace=1e3, values=values)
    noise = {
        (name, 1e3): NoiseModel(1.0, (), known, "repeats" if known else "residual")
        for name, known in zip(CHANNELS, verified, strict=True)
    }
    study = SimpleNamespace(
        predictors=[SimpleNamespace(record=record)],
        noise=noise,
        weights={},
        whiten=lambda predictor, left: [left[name] for name in CHANNELS],
        expected_squares=lambda record, name: np.ones(ROWS),
    )
    residual, zero = np.concatenate(list(values.values())), {name: np.zeros(ROWS) for name in CHANNELS}
    return study, Fit(np.ones(2), (), float(residual @ residual) + 2.0, (zero,), residual, 2.0 * ROWS)


@pytest.mark.parametrize(
    "verified, excess, exceeds",
    [
        ((True, True), (0.0, 0.0), False),
        ((True, True), (1.0, 0.0), True),
        ((True, False), (1.0, 0.0), True),  # the other channel's noise says nothing of this one
        ((False, True), (1.0, 0.0), False),  # what it leaves is its noise
        ((False, True), (0.0, 1.0), True),
        ((False, False), (5.0, 5.0), False),
    ],
)
def test_more_than_the_noise_is_looked_for_in_every_channel_whose_noise_is_verified(verified, excess, exceeds):
    study, fit = white_study(verified, excess)
    assert (beyond_noise(fit, study, options=DIAGNOSIS) > 0.0) is exceeds


def test_the_parts_of_channels_add_up_to_the_chi_square():
    whole, first, second, none = (
        np.array(verified_chi_square(*reversed(white_study(verified, (0.3, 0.0)))))
        for verified in ((True, True), (True, False), (False, True), (False, False))
    )
    assert first + second == pytest.approx(whole) and not none.any()
    assert whole[1] == 2 * ROWS


@pytest.mark.parametrize("inadequate", [True, False])
def test_of_an_answer_set_that_was_emptied_no_candidate_is_told_to_be_in_it(inadequate, monkeypatch):
    best, base = hypothesis(4900.0, "spool_lap"), nominal(9000.0)
    scores = SimpleNamespace(options=DIAGNOSIS)
    ended = isolation.Isolation(base, scores, scores, [best], [best], "", True, 4.0)
    monkeypatch.setattr(conclusion, "is_inadequate", lambda nominal, fit, options: inadequate)
    monkeypatch.setattr(conclusion, "figures_at_limit", lambda study, point: "")
    concluded = conclusion.conclude(ended)
    answers = candidate_answers(base, ended.found, concluded.answer_set, 4.0, concluded.doubt, options=DIAGNOSIS)
    in_set = {answer.label for answer in answers if answer.in_set}
    assert in_set == ({"none of the known causes"} if inadequate else {"spool_lap"})


@pytest.mark.parametrize("response, answer", [("", ["sensor_lag"]), ("", []), ("60 Hz", ["never asked"])])
def test_a_channel_that_is_far_off_is_fitted_beside_the_figures_of_the_others(monkeypatch, response, answer):
    """A flow meter of 20 ms had dragged the fit to all channels along: the records were of another valve."""
    base, others = nominal(5e6), nominal(6e6)
    channel = SimpleNamespace(nominal=others, response=response, words="a channel")
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (False, 4.0))
    monkeypatch.setattr(isolation, "channel_apart", lambda nominal, scores, options: channel)
    monkeypatch.setattr(isolation, "told_faults", lambda scores, options: ())
    monkeypatch.setattr(isolation, "joint_instrument_errors", lambda scores, options: None)
    begun = []

    def isolated(nominal, scores, progress, known, beside, *, options):
        begun.append(nominal)
        in_set = [hypothesis(5000.0, "spool_lap")] if nominal is others and answer else []
        return isolation.Isolation(nominal, scores, scores, in_set, in_set, "", nominal is others, 4.0)

    monkeypatch.setattr(isolation, "_isolated", isolated)
    ended = isolation.isolate(base, lambda stage, share: None, options=DIAGNOSIS)
    if response:
        assert begun == [] and ended.channel is channel
    else:
        assert begun == ([others] if answer else [others, base]) and ended.nominal is begun[-1]


@pytest.mark.parametrize(
    "left, behind, named",
    [
        (0.1, 10_000.0, ["magnetic_hysteresis"]),  # of 80 000 that it explains its law may err by 16 000
        (0.25, 10_000.0, []),  # it leaves more than that itself
        (0.1, 20_000.0, []),  # the best explains more than that besides
    ],
)
def test_where_the_best_leaves_too_much_a_cause_stands_whose_law_may_err_by_it(monkeypatch, left, behind, named):
    base, best = nominal(110_000.0), hypothesis(20_000.0, "spool_silting")
    erring, lag = hypothesis(20_000.0 + behind, "magnetic_hysteresis"), hypothesis(21_000.0, "eddy_current_lag")
    worse = hypothesis(90_000.0, "entrained_air")
    shares = {id(best.fit): 0.03, id(erring.fit): left, id(lag.fit): 0.04}
    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "unexplained_share", lambda nominal, final: shares[id(final.fit)])
    scores, final = (score_test_of(base, one) for one in (base.fit, best.fit))
    found = [best, lag, erring, worse]
    judged = isolation.judged(isolation.Isolation(base, scores, final, found, [], "", True, 4.0))
    assert [one.label for one in judged.answer_set] == named
    assert judged.found == ([erring, worse] if named else found)  # of the others none stands
    if named:
        assert judged.final.fit is erring.fit and "none of them explains" in judged.unknown_reason


def test_a_cause_whose_law_may_err_has_that_counted_before_the_bench_is_sought_beside_it(monkeypatch):
    base, wider, looked = nominal(900_000.0), nominal(50_000.0), []
    cause = hypothesis(60_000.0, "magnetic_hysteresis").fit

    def discrepancy(nominal, found, *, options):
        looked.append((nominal, [one.fit for one in found]))
        return wider if nominal is base else None

    monkeypatch.setattr(isolation, "score_test", score_test_of)
    monkeypatch.setattr(isolation, "detect", lambda scores: (False, 4.0))
    monkeypatch.setattr(isolation, "with_inputs_reviewed", lambda nominal: nominal)
    monkeypatch.setattr(isolation, "is_other_valve", lambda nominal, fit, options: False)
    monkeypatch.setattr(isolation, "likeliest_cause", lambda nominal, scores, known, options: cause)
    monkeypatch.setattr(isolation, "with_model_discrepancy", discrepancy)
    monkeypatch.setattr(
        isolation, "with_faults_beside_cause", lambda nominal, scores, cause, known, options: (nominal, scores, cause)
    )
    ended, scores, beside = isolation._with_bench(base, score_test_of(base, base.fit), (), options=DIAGNOSIS)
    assert looked == [(base, [cause]), (wider, [cause])]
    assert ended is wider and scores.fit is wider.fit and beside == [cause]
    looked.clear()
    isolation._with_bench(base, score_test_of(base, base.fit), (cause,), options=DIAGNOSIS)
    assert looked[0] == (base, [])  # of what is known from elsewhere that was counted there
