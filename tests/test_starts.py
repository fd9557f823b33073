"""Where refits start by what the linearised equations promise, and what is looked for beside the best and in it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import refits, second_cause, starts
from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.refits import (
    alike_hypotheses,
    fit_starts,
    from_other_sought_shapes,
    hypotheses_at_other_shapes,
    plainer_hypotheses,
    reduced_hypotheses,
    restarted,
    unfitted_plainer_hypotheses,
)
from valvesim.diagnosis.score_test import ScoreTest, search_size
from valvesim.diagnosis.second_cause import at_full_weight, with_other_pairs, with_second_cause
from valvesim.diagnosis.starts import is_of_one_effect, likeliest_starts, start_points, typical_starts
from valvesim.errors import SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, largest_adequate
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.projection import ProjectedScores
from valvesim.valve.catalogue import CATALOGUE

BIAS = Candidate("sensor_bias", CATALOGUE["sensor_bias"].on("load_flow"))
AIR, LAP, FRICTION = (Candidate(n, CATALOGUE[n]) for n in ("entrained_air", "spool_lap", "spool_coulomb_friction"))
SIDES = tuple(Candidate("nozzle_erosion", CATALOGUE["nozzle_erosion"], (("side", side),)) for side in (1.0, 2.0))
COLUMNS = 10.0 * np.linalg.qr(np.random.default_rng(5).normal(size=(400, 4)))[0]
"""What four candidates show at the amplitudes at which they are tested: at right angles, d' = 10 each."""


def hypothesis(chi_square, *candidates):
    """Candidates fitted at their typical amplitudes."""
    fitted = tuple(FittedCandidate(one, one.typical) for one in candidates)
    return FittedHypothesis(Fit(np.zeros(1), fitted, chi_square, (), np.zeros(1), 5000.0), options=DIAGNOSIS)


def scores(hidden, fit=None, options=DIAGNOSIS):
    """The score test of records in which so much of each candidate is hidden, in the amplitudes of their columns."""
    candidates, amounts = tuple(hidden), np.array(list(hidden.values()))
    S = COLUMNS[:, : len(candidates)]
    projected = ProjectedScores(S.T @ (S @ amounts), S.T @ S, 0.0)
    study = SimpleNamespace(
        session=SimpleNamespace(seed=1), noise={}, options=OPTIONS, nominal=SimpleNamespace(parameters=())
    )
    sizes = np.array([search_size(one, options=OPTIONS) for one in candidates])
    fit = hypothesis(1000.0).fit if fit is None else fit
    return ScoreTest(study, fit, (), (), (), None, candidates, sizes, (), (), (), projected, options=options)


def at(candidate):
    return FittedCandidate(candidate, candidate.typical)


def labels(starts):
    return [" + ".join(sorted(member.candidate.key for member in start)) for start in starts]


# ---------------------------------------------------------------- starts


def test_two_causes_that_explain_much_more_than_one_start_together_in_the_amounts_that_are_there():
    found = start_points(scores({LAP: 2.0, AIR: 3.0, FRICTION: 0.0}), frozenset())
    assert labels(found) == ["entrained_air", "entrained_air + spool_lap"]
    pair = {member.candidate: member.above_neutral for member in found[-1]}
    lap, air = (search_size(one, options=OPTIONS) for one in (LAP, AIR))
    assert air == 0.05 * AIR.typical and lap == 0.2 * LAP.typical  # smaller where it is simulated
    assert pair == pytest.approx({LAP: 2.0 * lap, AIR: 3.0 * air})
    little = 0.9 * np.sqrt(DIAGNOSIS.isolation.pair_reduction) / 10.0
    assert labels(start_points(scores({LAP: little, AIR: 1.0}), frozenset())) == ["entrained_air"]


def test_a_pair_of_which_one_would_have_the_sign_that_it_cannot_have_is_no_start():
    assert FRICTION.one_sided and not BIAS.one_sided
    assert labels(start_points(scores({BIAS: 3.0, FRICTION: -2.0}), frozenset())) == ["sensor_bias@load_flow"]
    assert labels(start_points(scores({BIAS: -3.0, FRICTION: 2.0}), frozenset()))[-1] == (
        "sensor_bias@load_flow + spool_coulomb_friction"
    )


def test_the_same_lag_of_all_sensors_is_a_start_of_one_effect_and_no_pair_besides():
    spool, flow = (Candidate("sensor_lag", CATALOGUE["sensor_lag"].on(c)) for c in ("spool_position", "load_flow"))
    found = start_points(scores({spool: 1.5, AIR: 1.0, flow: 1.5}), frozenset())
    assert labels(found).count("sensor_lag@load_flow~0.001 s + sensor_lag@spool_position~0.001 s") == 1
    common = next(start for start in found if len(start) == 2 and is_of_one_effect(start))
    own = 1.5 * search_size(spool, options=OPTIONS)
    assert [member.above_neutral for member in common] == pytest.approx([own, own])
    assert not any(map(is_of_one_effect, start_points(scores({spool: 1.5, flow: -1.5, AIR: 3.0}), frozenset())[1:]))
    pair = hypothesis(900.0, spool, flow)
    pair = replace(pair, fit=replace(pair.fit, occam_factor=20.0))
    assert pair.occam_factor == 10.0 and pair.prior_penalty == hypothesis(900.0, spool).prior_penalty
    assert hypothesis(900.0, spool, AIR).prior_penalty == 2.0 * pair.prior_penalty


def test_both_sides_of_one_effect_are_no_pair():
    assert labels(start_points(scores(dict(zip(SIDES, (2.0, 3.0), strict=True))), frozenset())) == [SIDES[1].key]


def test_of_many_pairs_the_best_few_are_started():
    four = {BIAS: 3.0, LAP: 2.9, AIR: 2.8, FRICTION: 2.7}
    pairs = [one for one in labels(start_points(scores(four), frozenset())) if "+" in one]
    assert len(pairs) == DIAGNOSIS.isolation.pairs == 3
    assert pairs[0] == "sensor_bias@load_flow + spool_lap"
    options = replace(DIAGNOSIS, isolation=replace(DIAGNOSIS.isolation, pairs=1))
    assert [one for one in labels(start_points(scores(four, options=options), frozenset())) if "+" in one] == pairs[:1]


def test_what_has_failed_is_started_neither_alone_nor_in_a_pair():
    assert labels(start_points(scores({LAP: 2.0, AIR: 3.0, BIAS: 1.9}), {"entrained_air"})) == [
        "spool_lap", "sensor_bias@load_flow", "sensor_bias@load_flow + spool_lap",
    ]  # fmt: skip
    assert start_points(scores({LAP: 2.0, AIR: 3.0}), {"entrained_air", "spool_lap"}) == []


def test_typical_amplitudes_are_tried_in_either_direction_and_the_best_of_those_that_explain_anything_are_given(
    monkeypatch,
):
    tried = []

    def falls(nominal, starts):
        tried[:] = [(one.candidate, np.sign(one.above_neutral)) for (one,) in starts]
        return np.array([[{(BIAS, -1.0): 50.0, (FRICTION, 1.0): 80.0}.get(each, -1.0) for each in tried]] * 2)

    monkeypatch.setattr(starts, "reductions_from_prior", falls)
    found = typical_starts(None, scores({BIAS: 0.0, FRICTION: 0.0}))
    assert tried == [(BIAS, 1.0), (BIAS, -1.0), (FRICTION, 1.0)]
    assert [(one.candidate, one.above_neutral) for (one,) in found] == [
        (FRICTION, pytest.approx(FRICTION.typical)), (BIAS, pytest.approx(-BIAS.typical)),
    ]  # fmt: skip


def test_effects_that_linear_answers_miss_are_begun_by_simulation(monkeypatch):
    stribeck = Candidate("spool_stribeck_friction", CATALOGUE["spool_stribeck_friction"])
    falls = {FRICTION: 60.0, stribeck: 90.0, LAP: 80.0, AIR: 0.0, BIAS: 30.0}
    simulated = []

    def reductions(nominal, starts):
        simulated[:] = [one.candidate for (one,) in starts]
        return np.array([[falls[one] for one in simulated]] * 2)

    monkeypatch.setattr(starts, "reductions_from_prior", reductions)
    seen = scores({BIAS: 8.0, stribeck: 0.0, LAP: 0.0, FRICTION: 0.0})

    def found():
        return [one.candidate for (one,) in likeliest_starts(None, seen)]

    assert found() == [BIAS, stribeck, FRICTION, LAP]  # linear, the best simulated, its plainer one, the next
    assert simulated[0] is BIAS and BIAS not in simulated[1:]  # a sensor's fault is begun by linear answers alone
    simulated.clear()
    assert next(likeliest_starts(None, seen))[0].candidate is BIAS and not simulated  # that may be enough
    seen = scores({stribeck: 9.0, FRICTION: 8.5, LAP: 0.0})
    assert found() == [FRICTION, stribeck, LAP]  # the plainest of the likeliest, if it is among them
    seen = scores({LAP: 0.0, FRICTION: 0.0})
    falls |= {LAP: -1.0, FRICTION: 0.0}
    assert found() == []  # nothing shows, and nothing explains anything


def test_of_samples_in_full_and_down_weighted_the_best_starts_come_in_turn(monkeypatch):
    # a strong lap moves just those samples that are far off, which count less, by more than the fit can (231518)
    falls = {LAP: (-8e5, 4e5), FRICTION: (6e4, 0.0), AIR: (5e4, 1e3), BIAS: (-1.0, -1.0)}
    seen = scores(dict.fromkeys(falls, 0.0))

    def reductions(nominal, begun):
        of_sign = [(one.candidate, one.above_neutral > 0.0) for (one,) in begun]
        return np.array([falls[one] if up else (-1.0, -1.0) for one, up in of_sign]).T

    monkeypatch.setattr(starts, "reductions_from_prior", reductions)
    assert [one.candidate for (one,) in typical_starts(None, seen)] == [LAP, FRICTION, AIR]
    assert [one.candidate for (one,) in likeliest_starts(None, seen)] == [LAP, FRICTION, AIR]


# ---------------------------------------------------------------- a second cause


@pytest.fixture
def fitted(monkeypatch):
    """Refits that end at the chi-squares set here, by the names of their causes; score tests in which nothing shows."""
    ends, begun = {}, []

    def fits(nominal, starts, point=None, *, others=(), options):
        begun.extend(labels(starts))
        ran = [(start, ends[label]) for start, label in zip(starts, labels(starts), strict=True) if label in ends]
        return [FittedHypothesis(replace(hypothesis(0.0).fit, fitted=s, chi_square=c), options=options) for s, c in ran]

    def evaluated(study, point, start, near=()):
        """A fit with candidates, not fitted again: it leaves what is set for it, far from all where nothing is."""
        left = ends.get(" + ".join(sorted(member.candidate.name for member in start)), np.inf)
        return replace(hypothesis(left).fit, fitted=start)

    def stuck(study, fit):
        raise SolveError("nothing is linearised here")

    monkeypatch.setattr(refits, "fit_starts", fits)
    monkeypatch.setattr(refits, "evaluate_fit", evaluated)
    monkeypatch.setattr(refits, "linearise_fit", stuck)
    monkeypatch.setattr(second_cause, "fit_starts", fits)
    monkeypatch.setattr(second_cause, "refined_hypotheses", lambda nominal, found, options: list(found))
    monkeypatch.setattr(second_cause, "score_test", lambda nominal, fit, **_: scores({BIAS: 0.0}, fit))
    return SimpleNamespace(ends=ends, begun=begun)


NOMINAL = SimpleNamespace(fit=hypothesis(3000.0).fit, study=SimpleNamespace(noise={}, weights={}))
BOTH = "entrained_air + spool_lap"


def test_a_second_cause_that_shows_in_what_the_first_leaves_is_fitted_beside_it(fitted):
    fitted.ends |= {BOTH: 1000.0, "spool_lap": 1900.0, "entrained_air": 2500.0}
    first = hypothesis(1900.0, LAP)
    found, final = with_second_cause(NOMINAL, scores({AIR: 3.0, BIAS: 0.1}, first.fit), [first])
    assert [c.name for c in found[0].candidates] == ["spool_lap", "entrained_air"] and final.fit is found[0].fit
    assert fitted.begun[0] == BOTH and first in found
    assert BOTH not in fitted.begun[1:]  # and no third beside the two


def test_a_second_cause_that_explains_too_little_stands_behind_the_first(fitted):
    fitted.ends |= {BOTH: 1899.0}
    first = hypothesis(1900.0, LAP)
    before = scores({AIR: 3.0}, first.fit)
    found, final = with_second_cause(NOMINAL, before, [first])
    assert found[0] is first and [one.label for one in found[1:]] == ["spool_lap + entrained_air"] and final is before


def test_all_that_promise_nearly_as_much_are_tried_beside_a_cause_however_many(fitted, monkeypatch):
    """Figures that act alike were the only ones to be tried beside a cause, and an effect the fourth (pair 200012)."""
    likely = {AIR: 0.8, BIAS: 0.79, FRICTION: 0.78, SIDES[0]: 0.77}
    first = hypothesis(1900.0, LAP)
    with_second_cause(NOMINAL, scores(likely, first.fit), [first])
    assert len(likely) > DIAGNOSIS.isolation.seconds and fitted.begun == labels([(at(LAP), at(c)) for c in likely])
    fitted.begun.clear()
    monkeypatch.setattr(second_cause, "comes_near", lambda *_, **__: True)
    monkeypatch.setattr(second_cause, "fit_hypothesis", lambda nominal, start, point: replace(first.fit, fitted=start))
    monkeypatch.setattr(second_cause, "score_test", lambda nominal, fit, **_: scores(likely, fit))
    pair = hypothesis(1000.0, LAP, AIR)
    with_other_pairs(NOMINAL, [pair], scores({BIAS: 0.0}, pair.fit))
    assert fitted.begun[:3] == labels([(at(LAP), at(c)) for c in (BIAS, FRICTION, SIDES[0])])  # not AIR again


def test_where_nothing_shows_no_second_cause_is_fitted(fitted):
    first = hypothesis(1900.0, LAP)
    before = scores({AIR: 0.1}, first.fit)
    assert with_second_cause(NOMINAL, before, [first]) == ([first], before) and not fitted.begun


def test_the_plainer_effect_is_fitted_in_the_place_of_one_that_may_be_it(fitted):
    silting = Candidate("spool_silting", CATALOGUE["spool_silting"])
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(LAP, FRICTION, silting)))
    fitted.ends |= {"spool_coulomb_friction": 990.0}
    best = hypothesis(1000.0, silting)
    (plainer,) = plainer_hypotheses(nominal, [best, hypothesis(1500.0, LAP)], options=DIAGNOSIS)
    assert plainer.label == "spool_coulomb_friction" and plainer.fit.chi_square == 990.0
    (member,) = plainer.fit.fitted
    assert member.above_neutral == pytest.approx(FRICTION.typical)
    assert plainer_hypotheses(nominal, [best, plainer], options=DIAGNOSIS) == []  # it is the best
    stopped = replace(hypothesis(1100.0).fit, fitted=(FittedCandidate(FRICTION, 0.7),))
    short = FittedHypothesis(stopped, options=DIAGNOSIS)
    (again,) = plainer_hypotheses(nominal, [best, short], options=DIAGNOSIS)  # from its own amplitude
    assert again.fit.chi_square == 990.0 and again.fit.fitted[0].above_neutral == 0.7


def test_the_plainer_effect_of_any_single_cause_is_fitted_if_it_was_not(monkeypatch):
    """An amplifier's lag that explains 172 had shown by 4.7 where eddy currents did by 8.5, and these were named for
    sure (`amplifier_lag` 1310103).
    """
    names = ("amplifier_lag", "amplifier_second_order_lag", "eddy_current_lag")
    lag, second_order, eddy = (Candidate(name, CATALOGUE[name]) for name in names)
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(lag, second_order, eddy)))
    begun = []

    def from_prior(nominal, start, worthwhile):
        assert worthwhile == largest_adequate(NOMINAL.fit, options=DIAGNOSIS.identification)  # as the eddy current is
        begun.append(start)
        return replace(hypothesis(900.0).fit, fitted=start)

    monkeypatch.setattr(refits, "fit_from_prior", from_prior)
    found = [hypothesis(1000.0, eddy), hypothesis(1500.0, second_order)]
    (plainer,) = unfitted_plainer_hypotheses(nominal, found, options=DIAGNOSIS)
    ((member,),) = begun
    assert plainer.label == "amplifier_lag" and member.candidate is lag and member.above_neutral == lag.typical
    known = [*found, hypothesis(1600.0, lag)]
    is_best = [hypothesis(1000.0, second_order), hypothesis(1500.0, eddy)]
    for others, left_out in ((known, set()), (found, {"amplifier_lag"}), (found[:1], set()), (is_best, set())):
        assert unfitted_plainer_hypotheses(nominal, others, left_out, options=DIAGNOSIS) == []
    assert unfitted_plainer_hypotheses(nominal, [hypothesis(1500.0, second_order, eddy)], options=DIAGNOSIS) == []


def test_an_effect_alike_that_stopped_short_is_fitted_from_the_figures_of_the_best(fitted):
    silting, stribeck = (Candidate(n, CATALOGUE[n]) for n in ("spool_silting", "spool_stribeck_friction"))
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(LAP, FRICTION, silting, stribeck)))
    fitted.ends |= {"spool_stribeck_friction": 900.0}

    def ended(chi_square, candidate, amplitude, **shapes):
        fit = replace(
            hypothesis(chi_square).fit, fitted=(FittedCandidate(candidate, amplitude, tuple(shapes.items())),)
        )
        return FittedHypothesis(fit, options=DIAGNOSIS)

    best = ended(1000.0, silting, 5.0, dwell_time=0.1, break_distance=1e-5, presliding_distance=2e-6)
    plain = ended(1500.0, FRICTION, 4.0, presliding_distance=3e-6)
    near, short = (
        ended(least, stribeck, 4.5, kinetic_share=0.5, stribeck_velocity=1e-3, presliding_distance=1e-7)
        for least in (1001.0, 1500.0)
    )
    (again,) = alike_hypotheses(nominal, [best, plain, short], options=DIAGNOSIS)
    (member,) = again.fit.fitted
    assert again.fit.chi_square == 900.0 and member.above_neutral == 4.5
    assert dict(member.shapes) == {"kinetic_share": 0.5, "stribeck_velocity": 1e-3, "presliding_distance": 2e-6}
    assert alike_hypotheses(nominal, [best, plain, near], options=DIAGNOSIS) == []  # it is in the answer set
    both = hypothesis(1000.0, silting, FRICTION)  # beside it there is the plainer one already
    assert plainer_hypotheses(nominal, [both], options=DIAGNOSIS) == []
    fitted.begun.clear()
    coulomb = ended(1000.0, FRICTION, 4.0, presliding_distance=2e-6)
    assert alike_hypotheses(nominal, [coulomb, short], options=DIAGNOSIS)
    assert fitted.begun == [stribeck.label, silting.label]  # the one that nobody has fitted yet as well
    fitted.begun.clear()
    alike_hypotheses(nominal, [coulomb, short], {silting.label}, options=DIAGNOSIS)
    assert fitted.begun == [stribeck.label]  # but not what has been fitted from there


def test_what_is_looked_for_at_several_shapes_is_fitted_at_each_in_the_place_of_the_best(monkeypatch):
    near, far = (
        Candidate("spool_thermal_pinch", CATALOGUE["spool_thermal_pinch"], (("free_clearance", at),))
        for at in (3e-6, 5e-6)
    )
    fast, slow = (
        Candidate("eddy_current_lag", CATALOGUE["eddy_current_lag"], (("time_constant", at),)) for at in (5e-4, 2e-2)
    )
    study = SimpleNamespace(candidates=(LAP, FRICTION, near, far, *SIDES, fast, slow))
    nominal, begun = SimpleNamespace(fit=NOMINAL.fit, study=study), []

    def from_prior(nominal, start, worthwhile):
        assert worthwhile is None  # alike laws crawl
        begun.extend(start)
        return replace(hypothesis(900.0).fit, fitted=start)

    monkeypatch.setattr(refits, "fit_from_prior", from_prior)
    best = FittedHypothesis(
        replace(hypothesis(1000.0).fit, fitted=(FittedCandidate(FRICTION, 0.5, (("presliding_distance", 2e-6),)),)),
        options=DIAGNOSIS,
    )
    known = hypothesis(1001.0, far)
    (other,) = hypotheses_at_other_shapes(nominal, [best, known], options=DIAGNOSIS)
    (member,) = begun
    assert other.candidates == (near,) and member.above_neutral == pytest.approx(0.5 * near.typical)
    assert dict(member.shapes) == {"free_clearance": 3e-6, "presliding_distance": 2e-6}
    assert hypotheses_at_other_shapes(nominal, [best, known, hypothesis(1002.0, near)], options=DIAGNOSIS) == []
    assert hypotheses_at_other_shapes(nominal, [best, known], {near.label}, options=DIAGNOSIS) == []
    assert hypotheses_at_other_shapes(nominal, [hypothesis(1000.0, fast)], options=DIAGNOSIS) == []  # none is plainer
    assert hypotheses_at_other_shapes(nominal, [hypothesis(1e6, FRICTION)], options=DIAGNOSIS) == []  # far off
    assert hypotheses_at_other_shapes(nominal, [], options=DIAGNOSIS) == []
    (same,) = hypotheses_at_other_shapes(nominal, [best, known], of_fitted=True, options=DIAGNOSIS)
    assert same.candidates == (near,)
    assert hypotheses_at_other_shapes(nominal, [best], of_fitted=True, options=DIAGNOSIS) == []  # nor at any
    begun.clear()
    stopped = FittedCandidate(far, 0.1 * far.typical, (("free_clearance", 4.9e-6), ("presliding_distance", 1e-6)))
    pinch = FittedHypothesis(replace(hypothesis(1000.0).fit, fitted=(stopped,)), options=DIAGNOSIS)
    hypotheses_at_other_shapes(nominal, [pinch], options=DIAGNOSIS)
    assert [dict(one.shapes)["free_clearance"] for one in begun] == [3e-6]  # not where the other one has gone


def test_a_likely_one_is_fitted_from_the_other_shapes_at_which_it_is_looked_for(monkeypatch):
    """A loop had ended at a turning current of 3.6 mA, 9 above what it leaves at the true one of 2 mA (200001)."""
    hysteresis = CATALOGUE["magnetic_hysteresis"]
    first, other = (Candidate(hysteresis.name, hysteresis, (("turning_current", at),)) for at in (4e-3, 1e-3))
    pinch, other_pinch = (
        Candidate("spool_thermal_pinch", CATALOGUE["spool_thermal_pinch"], (("free_clearance", at),))
        for at in (3e-6, 5e-6)
    )
    study = SimpleNamespace(candidates=(AIR, LAP, first, other, *SIDES, pinch, other_pinch))
    nominal, begun = SimpleNamespace(fit=NOMINAL.fit, study=study), []
    best, hopeless = hypothesis(1000.0, LAP, first), hypothesis(2900.0, first)

    def fit(nominal, start, point, *, worthwhile):
        assert point is best.fit.point and worthwhile == best.fit.chi_square  # given up where it comes no lower
        begun.append(start)
        return replace(best.fit, fitted=start, chi_square=991.0)

    monkeypatch.setattr(refits, "fit_hypothesis", fit)
    found = [hopeless, best, hypothesis(1001.0, SIDES[0])]
    (better,) = from_other_sought_shapes(nominal, found, options=DIAGNOSIS)
    assert better.fit.chi_square == 991.0 and better.candidates == (LAP, other)
    ((lap, loop),) = begun
    assert lap is best.fit.fitted[0] and loop.candidate is other
    assert loop.above_neutral == best.fit.fitted[1].above_neutral and dict(loop.shapes) == {"turning_current": 1e-3}
    begun.clear()
    from_other_sought_shapes(nominal, [hypothesis(1000.0, pinch)], options=DIAGNOSIS)  # a plainer one's: elsewhere
    from_other_sought_shapes(nominal, [hypothesis(1e6, first)], options=DIAGNOSIS)  # far off
    assert not begun


@pytest.mark.parametrize(
    "ends, promised, begun",
    [
        (1000.0, -1e4, [3e-6]),  # one is near, and the other begins further off than the valve without a cause
        (1000.0, -1e3, [3e-6, 5e-6]),
        (9e5, -1e4, [3e-6, 5e-6]),  # the first does not come near
    ],
)
def test_a_shape_that_begins_far_off_is_not_fitted_where_another_comes_near(monkeypatch, ends, promised, begun):
    tried = []

    def from_prior(nominal, start, worthwhile):
        tried.append(dict(start[0].candidate.fixed)["free_clearance"])
        return replace(hypothesis(ends).fit, fitted=start)

    monkeypatch.setattr(refits, "fit_from_prior", from_prior)
    monkeypatch.setattr(refits, "reductions_from_prior", lambda nominal, starts: np.array([[promised, 50.0]] * 2))
    candidates = [
        Candidate("spool_thermal_pinch", CATALOGUE["spool_thermal_pinch"], (("free_clearance", at),))
        for at in (5e-6, 3e-6)
    ]
    starts = [(FittedCandidate(one, one.typical),) for one in candidates]
    found = refits._fitted_from_prior(NOMINAL, starts, options=DIAGNOSIS)
    assert tried == begun and [len(one.candidates) for one in found] == [1] * len(begun)


def test_another_law_is_begun_in_the_amount_that_leaves_least(fitted, monkeypatch):
    begun = list[tuple[FittedCandidate, ...]]()
    monkeypatch.setattr(refits, "is_adequate", lambda fit, options: False)
    monkeypatch.setattr(refits, "fit_starts", lambda nominal, starts, point, **_: begun.extend(starts) or [])
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(LAP, FRICTION)))
    own = FittedCandidate(FRICTION, 4.0)
    best = FittedHypothesis(replace(hypothesis(1000.0).fit, fitted=(own,)), options=DIAGNOSIS)
    beside = FittedCandidate(LAP, LAP.typical)

    def evaluated(study, point, start, near=()):
        *_, friction = start
        if friction.above_neutral > 4.0:
            raise SolveError("the spool stands still")
        return replace(hypothesis(abs(friction.above_neutral - 1.5)).fit, fitted=start)

    monkeypatch.setattr(refits, "evaluate_fit", evaluated)
    start = (beside, FittedCandidate(AIR, 4.0))
    refits._fitted_in_place(nominal, [start], best, options=DIAGNOSIS)
    lap, other = begun.pop()
    assert [lap.above_neutral, other.above_neutral] == pytest.approx([0.35 * LAP.typical, 0.35 * 4.0])
    best = FittedHypothesis(replace(best.fit, fitted=(beside, own)), options=DIAGNOSIS)
    much = (FittedCandidate(AIR, 400.0),)
    refits._fitted_in_place(nominal, [start, much], best, options=DIAGNOSIS)
    assert begun.pop() is much  # that runs in no amount
    lap, other = begun.pop()
    assert lap == beside and other.above_neutral == pytest.approx(0.35 * 4.0)  # what both have stays


def test_where_one_of_the_laws_comes_near_the_records_the_others_are_fitted_from_its_figures(monkeypatch):
    """The best does not, and what its figures say of the others is of another valve."""
    asked = []

    def within_reach(nominal, starts, best, *, options):
        asked.append(("reach", best.chi_square, [start[0].candidate.name for start in starts]))
        ends = {"spool_lap": 7e5, AIR.name: 8e5}
        return [(start, [replace(hypothesis(ends[start[0].candidate.name]).fit, fitted=start)]) for start in starts]

    def fits(nominal, starts, point, *, others, options):
        ((one,),) = starts
        asked.append(("fit", others[0].fit.chi_square, one.candidate.name))
        return [FittedHypothesis(replace(hypothesis(950.0).fit, fitted=(one,)), options=options)]

    monkeypatch.setattr(refits, "_within_reach", within_reach)
    monkeypatch.setattr(refits, "fit_starts", fits)
    monkeypatch.setattr(refits, "is_adequate", lambda fit, *, options: fit.chi_square < 1e3)
    best = FittedHypothesis(replace(hypothesis(9e5).fit, fitted=(FittedCandidate(FRICTION, 4.0),)), options=DIAGNOSIS)
    starts = [(FittedCandidate(one, one.typical),) for one in (AIR, LAP)]
    found = refits._fitted_in_place(NOMINAL, starts, best, options=DIAGNOSIS)
    assert len(found) == 2 and asked == [
        ("reach", 9e5, [AIR.name, "spool_lap"]), ("fit", 9e5, "spool_lap"),  # the one that leaves least
        ("reach", 950.0, [AIR.name]), ("fit", 950.0, AIR.name),
    ]  # fmt: skip


@pytest.mark.parametrize("other, again", [(1990.0, False), (2010.0, True)])
def test_what_the_same_causes_explain_better_elsewhere_is_not_taken_up_again(fitted, monkeypatch, other, again):
    taken = []
    monkeypatch.setattr(refits, "is_adequate", lambda fit, *, options: True)
    monkeypatch.setattr(
        refits, "_restarted_within_tolerance", lambda nominal, fit, options: taken.append(fit.chi_square) or []
    )
    short = hypothesis(2000.0, AIR)
    short = FittedHypothesis(replace(short.fit, predicted_reduction=1e3), options=DIAGNOSIS)
    elsewhere = FittedHypothesis(replace(hypothesis(other, AIR).fit, predicted_reduction=1e3), options=DIAGNOSIS)
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(AIR,), options=OPTIONS))
    refits.restarted(nominal, [short, elsewhere], "", options=DIAGNOSIS)
    assert (2000.0 in taken) is again


@pytest.mark.parametrize("amount, most", [(0.02, 0.1), (1.5, 3.0), (52.0, 120.0)])
def test_another_law_is_tried_in_ever_larger_or_smaller_amounts_while_they_leave_less(monkeypatch, amount, most):
    def evaluated(study, point, start, near=()):
        (one,) = start
        if one.above_neutral > most:
            raise SolveError("the spool stands still")
        return Fit(point, tuple(start), 100.0 + 1e4 * np.log(one.above_neutral / amount) ** 2, (), point, 100.0)

    monkeypatch.setattr(refits, "evaluate_fit", evaluated)
    tried = refits._in_amounts(
        SimpleNamespace(study=None), (FittedCandidate(LAP, 1.0),), NOMINAL.fit, options=DIAGNOSIS
    )
    best = min(tried, key=lambda fit: fit.chi_square)
    assert best.fitted[0].above_neutral == pytest.approx(amount, rel=0.4)
    assert len(tried) <= len(DIAGNOSIS.isolation.amounts) + 8


def test_what_no_nuisance_parameter_brings_near_is_not_fitted_from_the_best(monkeypatch):
    """One parameter moves one row, by as much as it pleases; where the best does not come near, all are fitted."""
    runs = {"spool_coulomb_friction": np.zeros(100), "spool_lap": np.zeros(100), "entrained_air": np.ones(100)}
    runs["spool_lap"][0], sides = 1e3, []

    def evaluated(study, point, start, near=()):
        if not start:
            raise SolveError("nothing runs")
        sides.append(start[0].above_neutral)
        left = runs[start[0].candidate.label] * 30.0
        return Fit(np.zeros(1), tuple(start), float(left @ left), (), left, 100.0)

    column = np.zeros((100, 1))
    column[0] = 1e4
    study = SimpleNamespace(nominal=SimpleNamespace(limits=np.array([[-1e3], [1e3]])), options=DIAGNOSIS.identification,
                            stack=lambda columns: column)  # fmt: skip
    nominal = SimpleNamespace(study=study, fit=SimpleNamespace(trajectories=()))
    monkeypatch.setattr(refits, "evaluate_fit", evaluated)
    monkeypatch.setattr(refits, "linearise_fit", lambda study, fit: ((), ()))
    best = Fit(np.zeros(1), (FittedCandidate(FRICTION, 4.0),), 100.0, (), np.zeros(100), 100.0)
    starts = [(FittedCandidate(LAP, 1.0),), (FittedCandidate(AIR, 1.0),)]
    near = refits._within_reach(nominal, starts, best, options=DIAGNOSIS)
    assert [start for start, _ in near] == starts[:1] and len(near[0][1]) == len(DIAGNOSIS.isolation.amounts)
    assert sorted(sides[: len(DIAGNOSIS.isolation.amounts)]) == sorted(DIAGNOSIS.isolation.amounts)
    far = replace(best, chi_square=1e4)
    assert [start for start, _ in refits._within_reach(nominal, starts, far, options=DIAGNOSIS)] == starts
    stuck = replace(best, fitted=())
    assert [start for start, _ in refits._within_reach(nominal, starts, stuck, options=DIAGNOSIS)] == starts
    assert refits._within_reach(nominal, [], best, options=DIAGNOSIS) == []


def test_those_far_off_are_told_only_where_the_best_comes_near():
    near, far = hypothesis(1000.0, LAP), hypothesis(50_000.0, AIR)
    assert refits.far_off([near, far], options=DIAGNOSIS) == {"entrained_air"}
    assert refits.far_off([far], options=DIAGNOSIS) == refits.far_off([], options=DIAGNOSIS) == frozenset()


def test_the_plainer_effect_is_fitted_in_no_place_but_of_one_that_may_be_it(fitted):
    nominal = SimpleNamespace(fit=NOMINAL.fit, study=SimpleNamespace(candidates=(LAP, FRICTION)))
    assert plainer_hypotheses(nominal, [hypothesis(1000.0, LAP)], options=DIAGNOSIS) == []
    assert plainer_hypotheses(nominal, [], options=DIAGNOSIS) == []


def test_of_a_pair_that_one_explains_as_well_the_one_is_left(fitted):
    fitted.ends |= {"spool_lap": 1001.0, "entrained_air": 2500.0}
    pair = hypothesis(1000.0, LAP, AIR)
    assert reduced_hypotheses(NOMINAL, [pair], options=DIAGNOSIS)[0].label == "spool_lap"
    fitted.ends["spool_lap"] = 2000.0
    found = reduced_hypotheses(NOMINAL, [pair], options=DIAGNOSIS)
    assert found[0] is pair and {one.label for one in found[1:]} == {"spool_lap", "entrained_air"}
    assert reduced_hypotheses(NOMINAL, [], options=DIAGNOSIS) == []
    fitted.begun.clear()
    fitted.ends["entrained_air"] = 1e6  # it begins far off, and is fitted: a hysteresis so stood at 48207 of 16801
    reduced_hypotheses(NOMINAL, [pair], options=DIAGNOSIS)
    assert sorted(fitted.begun) == ["entrained_air", "spool_lap"]


def test_causes_that_cannot_be_simulated_are_none(monkeypatch):
    monkeypatch.setattr(refits, "fit_hypothesis", lambda nominal, start, point, **_: None)
    monkeypatch.setattr(second_cause, "fit_hypothesis", lambda nominal, start, point, **_: None)
    monkeypatch.setattr(second_cause, "comes_near", lambda *_, **__: True)
    pair = hypothesis(1000.0, LAP, AIR)
    assert fit_starts(NOMINAL, [pair.fit.fitted], options=DIAGNOSIS) == []
    before = scores({AIR: 3.0}, pair.fit)
    assert with_other_pairs(NOMINAL, [pair], before) == ([pair], before)
    assert restarted(NOMINAL, [], "", options=DIAGNOSIS) == []


@pytest.mark.parametrize(
    "ends, peaks, uncertain, stands",
    [
        (1000.0, 4000.0, False, "full"), (1e9, 4000.0, False, "weighted"), (None, 4000.0, False, "weighted"),
        (1000.0, 1e6, False, "weighted"), (1000.0, 4000.0, True, "weighted"),
    ],
)  # fmt: skip
def test_samples_count_in_full_where_the_best_can_follow_their_peaks_and_the_inputs_are_known(
    fitted, monkeypatch, ends, peaks, uncertain, stands
):
    monkeypatch.setattr(second_cause, "has_uncertain_inputs", lambda study: uncertain)
    weighted = SimpleNamespace(**vars(NOMINAL), name="weighted")
    full = SimpleNamespace(**vars(NOMINAL), name="full")
    monkeypatch.setattr(second_cause, "unweighted", lambda nominal: full)
    monkeypatch.setattr(second_cause, "rescored", lambda study, fit: replace(fit, chi_square=peaks))
    monkeypatch.setattr(second_cause, "_refitted_from", lambda nominal, point: nominal)
    fitted.ends |= {} if ends is None else {"spool_lap": ends}
    found = [hypothesis(1900.0, LAP)]
    before = scores({AIR: 0.1}, found[0].fit)
    nominal, again, final = at_full_weight(weighted, found, before)
    assert nominal.name == stands and [one.label for one in again] == ["spool_lap"]
    if stands == "weighted":
        assert again is found and final is before
    else:
        assert again[0].fit.chi_square == ends and final.fit is again[0].fit


@pytest.mark.parametrize("left, stands", [(2000.0, "anew"), (3000.0, "full"), (None, "full")])
def test_at_full_weight_what_is_explained_is_counted_from_a_nominal_fit_at_its_end(fitted, monkeypatch, left, stands):
    """Where it ended with samples down-weighted it left 6.1 million of which 96,898 were left by the end: half a
    thousandth of that hid a true second cause (pair 223534).
    """
    full, anew = (SimpleNamespace(**vars(NOMINAL), name=name) for name in ("full", "anew"))
    monkeypatch.setattr(second_cause, "has_uncertain_inputs", lambda study: False)
    monkeypatch.setattr(second_cause, "unweighted", lambda nominal: full)
    monkeypatch.setattr(second_cause, "rescored", lambda study, fit: replace(fit, chi_square=1000.0))
    monkeypatch.setattr(second_cause, "linearised_at", lambda *_, full_weight: anew if full_weight else None)
    begun = []

    def without_causes(nominal, start, point):
        begun.append((nominal, start, point))
        return None if left is None else hypothesis(left).fit

    monkeypatch.setattr(second_cause, "fit_hypothesis", without_causes)
    fitted.ends |= {"spool_lap": 1000.0}
    found = [hypothesis(1900.0, LAP)]
    nominal, again, final = at_full_weight(NOMINAL, found, scores({AIR: 0.1}, found[0].fit))
    assert nominal.name == stands and again[0].fit.chi_square == 1000.0
    assert begun[0] == (full, (), found[0].fit.point) and begun[1] == (nominal, (), again[0].fit.point)


def test_at_full_weight_a_second_cause_is_looked_for_beside_others_than_the_one_that_it_was_found_with(
    fitted, monkeypatch
):
    """A hysteresis that only peaks of the leakage show was found beside the figure that does nearly as well as the
    magnet (pair 222510).
    """
    full, asked = SimpleNamespace(**vars(NOMINAL), name="full"), []
    pair, other = hypothesis(900.0, LAP, AIR), hypothesis(890.0, FRICTION, AIR)
    monkeypatch.setattr(second_cause, "has_uncertain_inputs", lambda study: False)
    monkeypatch.setattr(second_cause, "unweighted", lambda nominal: full)
    monkeypatch.setattr(second_cause, "rescored", lambda study, fit: replace(fit, chi_square=1000.0))
    monkeypatch.setattr(second_cause, "_refitted_from", lambda nominal, point: nominal)
    monkeypatch.setattr(second_cause, "with_second_cause", lambda nominal, final, found: (found_with, final))
    monkeypatch.setattr(
        second_cause, "with_other_pairs", lambda nominal, found, final: asked.append(found) or ([other, *found], final)
    )
    fitted.ends |= {"spool_lap": 1000.0}
    found = [hypothesis(1900.0, LAP)]
    found_with = [pair, *found]
    assert at_full_weight(NOMINAL, found, scores({AIR: 0.1}, found[0].fit))[1] == [other, pair, *found]
    assert asked == [found_with]
    found_with = found
    assert at_full_weight(NOMINAL, found, scores({AIR: 0.1}, found[0].fit))[1] == found and len(asked) == 1
