"""A second cause: what it must explain beside the first, which are tried, and what becomes of it in the answer."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import refits, second_cause
from valvesim.diagnosis.answer_tables import candidate_answers
from valvesim.diagnosis.model_selection import (
    FittedHypothesis,
    answer_set_of,
    answer_set_width,
    least_gain_of_second,
    nested_levels,
    odds_of_second,
    ranked,
    width_beside,
    with_minimum_gain,
)
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, with_shapes
from valvesim.identification.prior import NuisanceParameter
from valvesim.valve.catalogue import CATALOGUE

FIGURE = Candidate("figure", parameter=NuisanceParameter("spool_area", "m2", 1e-4, 1e-6, (1e-5, 1e-3)))
ROWS, LEVEL = 5000.0, 4.0


def effect(name):
    return Candidate(name, CATALOGUE[name])


def hypothesis(chi_square, *names, **of_fit):
    """A hypothesis of catalogue effects at their typical strength, fitted."""
    fitted = tuple(FittedCandidate(effect(name), effect(name).typical) for name in names)
    fit = Fit(np.zeros(1), fitted, chi_square, (), np.zeros(1), ROWS)
    return FittedHypothesis(replace(fit, **of_fit), options=DIAGNOSIS)


def leaving(chi_square):
    return SimpleNamespace(fit=SimpleNamespace(chi_square=chi_square), study=None)


def in_set(nominal, *found):
    return [one.label for one in answer_set_of(nominal, found, True, LEVEL, options=DIAGNOSIS)]


@pytest.mark.parametrize(
    "explained, first, least",
    [(400.0, "spool_lap", LEVEL**2), (1e6, "spool_lap", LEVEL**2), (400.0, "magnetic_hysteresis", LEVEL**2),
     (4000.0, "magnetic_hysteresis", 80.0), (1e6, "magnetic_hysteresis", 100.0)],
)  # fmt: skip
def test_a_second_cause_must_explain_more_than_chance_and_than_the_law_of_the_first_may_err_by(explained, first, least):
    best = hypothesis(5000.0, first)
    assert least_gain_of_second(leaving(5000.0 + explained), best, LEVEL) == pytest.approx(least)


@pytest.mark.parametrize("gain, told", [(15.0, False), (17.0, True)])
@pytest.mark.parametrize("first, explained", [("spool_lap", 300.0), ("spool_lap", 1e5), ("magnetic_hysteresis", 300.0)])
def test_a_second_cause_however_small_stands_beside_the_first_where_it_passes_the_level(first, explained, gain, told):
    """A pinch of two thousandths of a typical one has an Occam factor of 25, more than it explains (130030)."""
    alone = hypothesis(5000.0, first)
    pair = hypothesis(5000.0 - gain, first, "entrained_air", occam_factor=40.0)
    assert in_set(leaving(5000.0 + explained), alone, pair) == [alone.label, pair.label][: 1 + told]


def test_where_a_second_cause_passes_others_that_explain_nearly_as_much_stand_with_it():
    """A land's length had stood alone beside the first, where the oil's grade explained but 6 less (130008)."""
    alone, passes = hypothesis(5000.0, "spool_lap"), hypothesis(4982.0, "spool_lap", "entrained_air", occam_factor=20.0)
    near, far = (
        hypothesis(5000.0 - gain, "spool_lap", name, occam_factor=20.0)
        for gain, name in ((13.0, "magnetic_hysteresis"), (11.0, "eddy_current_lag"))
    )
    assert in_set(leaving(5300.0), alone, passes, near, far) == [alone.label, passes.label, near.label]
    assert in_set(leaving(5300.0), alone, near, far) == [alone.label]


@pytest.mark.parametrize("left, gain", [(0.0, 10.0), (3.0, 13.0), (15.0, 25.0), (500.0, 30.0)])
def test_what_the_first_would_explain_if_it_were_fitted_further_is_none_of_a_second(left, gain):
    """In a long session fits of a lap end 100 above their least, five times what a second cause explains (130003)."""
    alone = hypothesis(5000.0, "spool_lap", predicted_reduction=20.0)
    pair = hypothesis(4970.0, "spool_lap", "entrained_air", occam_factor=40.0, predicted_reduction=left)
    assert pair.gain_beyond(alone) == pytest.approx(gain)
    assert in_set(leaving(5300.0), alone, pair) == [alone.label, pair.label][: 1 + (gain > LEVEL**2)]


@pytest.mark.parametrize("stretched, kept", [(0.0, False), (6.0, True)])
def test_what_a_figure_beyond_its_tolerance_explains_is_no_doing_of_the_bench(stretched, kept):
    """A null gap off by 6.5 deviations was unknown (960065): all that a cause explained was that, and the bench might
    leave as much in the readings.
    """
    base = SimpleNamespace(fit=replace(hypothesis(5036.0).fit, point=np.array([stretched])))
    cause = hypothesis(5000.0, "spool_lap")
    assert with_minimum_gain(base, [cause], 4.0, 40.0, options=DIAGNOSIS) == [cause][:kept]
    assert with_minimum_gain(base, [cause], 4.0, options=DIAGNOSIS) == [cause]
    assert with_minimum_gain(base, [cause], 8.0, options=DIAGNOSIS) == []


PRIOR = 2.0 * np.log(10.0)


@pytest.mark.parametrize("gain, likelier", [(PRIOR - 0.2, False), (PRIOR + 0.2, True)])
@pytest.mark.parametrize(
    "first, explained, least",
    [("spool_lap", 300.0, LEVEL**2), ("spool_lap", 2800.0, LEVEL**2), ("magnetic_hysteresis", 60.0, LEVEL**2),
     ("magnetic_hysteresis", 300.0, 60.0), ("spool_lap", 1e5, 50.0)],
)  # fmt: skip
def test_a_pair_goes_before_its_first_where_the_second_is_likelier_than_chance(first, explained, least, gain, likelier):
    """4 % of what a coil's resistance explained were more than an eddy current of z 6.2 did (130009). What the law of
    the first may err by is no second cause, a hysteresis' (960058) or that of a friction of d' 1000 (960047).
    """
    alone = hypothesis(5000.0, first)
    pair = hypothesis(5000.0 - least - gain, first, "entrained_air", occam_factor=60.0)
    nominal = SimpleNamespace(fit=replace(alone.fit, chi_square=5000.0 + explained, fitted=()), study=None)
    by_evidence = sorted([alone, pair], key=lambda one: one.evidence)
    assert ranked(nominal, by_evidence)[0] is alone  # no level is known
    best_first = ranked(nominal, by_evidence, LEVEL)
    assert (best_first[0] is pair) == likelier
    in_set = answer_set_of(nominal, best_first, True, LEVEL, options=DIAGNOSIS)
    assert set(in_set) == {alone, pair}  # the order alone is another
    answers = candidate_answers(nominal, best_first, in_set, LEVEL, "", LEVEL, options=DIAGNOSIS)
    chances = {answer.label: answer.probability for answer in answers}
    odds = odds_of_second(nominal, pair, alone, LEVEL)
    assert odds == pytest.approx(gain - PRIOR)
    assert 2.0 * np.log(chances[pair.label] / chances[alone.label]) == pytest.approx(odds)


@pytest.mark.parametrize("more, first", [(0.0, "coulomb"), (0.9, "coulomb"), (1.9, "stribeck"), (30.0, "stribeck")])
@pytest.mark.parametrize("beside", [(), ("spool_lap",)])
def test_a_law_that_holds_a_plainer_one_as_common_goes_first_where_it_explains_more_than_by_chance(more, first, beside):
    """Of 14 sessions with Coulomb friction two explain 1 more by Stribeck's, of 11 with Stribeck's seven do."""
    plainer = hypothesis(5000.0, *beside, "spool_coulomb_friction", occam_factor=19.7)
    finer = hypothesis(5000.0 - more, *beside, "spool_stribeck_friction", occam_factor=22.6)
    nominal = SimpleNamespace(fit=replace(plainer.fit, chi_square=5400.0, fitted=()), study=None)
    found = sorted([plainer, finer], key=lambda one: one.evidence)
    best_first = ranked(nominal, found, LEVEL)
    assert f"spool_{first}_friction" in best_first[0].label
    answers = candidate_answers(nominal, best_first, found, LEVEL, "", LEVEL, options=DIAGNOSIS)
    assert answers[0].label == best_first[0].label and {answer.label for answer in answers if answer.in_set} == {
        plainer.label, finer.label,
    }  # fmt: skip


@pytest.mark.parametrize("of_shapes, more, first", [(9.0, 7.0, "flapper_cavitation"), (9.0, 0.5, "null_gap_asymmetry"),
                                                    (0.4, 0.5, "flapper_cavitation")])  # fmt: skip
def test_how_wide_the_prior_of_a_shape_is_tells_no_causes_apart(of_shapes, more, first):
    """A cavitation explained 4 to 11 more than a pressure sensor's bias and stood behind it, for the width of the prior
    of its critical ratio (222027, 224023, 229003, 233003).
    """
    plain = hypothesis(5000.0, "null_gap_asymmetry", occam_factor=11.0)
    shaped = hypothesis(
        5000.0 - more, "flapper_cavitation", occam_factor=11.0 + of_shapes, shape_occam_factor=of_shapes
    )
    shaped = replace(shaped, fit=replace(shaped.fit, fitted=(with_shapes(effect("flapper_cavitation"), 0.1),)))
    nominal = SimpleNamespace(fit=replace(plain.fit, chi_square=5400.0, fitted=()), study=None)
    found = sorted([plain, shaped], key=lambda one: one.evidence)
    assert ranked(nominal, found, LEVEL)[0].label == first


TOGETHER = ("magnet_demagnetization", "flexure_stiffness_loss")


@pytest.mark.parametrize("behind, stands", [(0.0, True), (10.0, True), (40.0, False)])
def test_effects_that_together_do_what_one_does_stand_beside_it_where_they_explain_nearly_as_much(behind, stands):
    """A magnet with a flexure as weak was told for sure as lost turns (222012, 227030, 229006, 234510)."""
    turns, pair = hypothesis(5000.0, "coil_turns_loss"), hypothesis(5000.0 + behind, *TOGETHER, occam_factor=20.0)
    other = hypothesis(5000.0 + behind, "magnet_demagnetization", "entrained_air", occam_factor=20.0)
    assert pair.is_indistinguishable_from(turns) and not turns.is_indistinguishable_from(pair)
    assert not other.is_indistinguishable_from(turns) and not pair.is_indistinguishable_from(other)
    told = in_set(leaving(5400.0), turns, pair, other)
    assert told == ([turns.label, pair.label] if stands else [turns.label])
    figure = NuisanceParameter("coil_turns", "1", 2000.0, 20.0, (10.0, 1e5))
    of_figure = replace(turns.fit, fitted=(FittedCandidate(Candidate("coil_turns", parameter=figure), -200.0),))
    assert pair.is_indistinguishable_from(replace(turns, fit=of_figure))


def test_what_together_does_as_one_is_fitted_beside_that_alone(monkeypatch):
    asked, turns = [], hypothesis(5000.0, "coil_turns_loss")
    candidates = tuple(effect(name) for name in ("coil_turns_loss", *TOGETHER))
    nominal = SimpleNamespace(study=SimpleNamespace(candidates=candidates), fit=turns.fit)

    def fits(nominal, starts, point, *, others, options):
        asked.extend(tuple(member.candidate.name for member in start) for start in starts)
        return [hypothesis(5001.0, *TOGETHER, occam_factor=20.0)]

    monkeypatch.setattr(refits, "fit_starts", fits)
    found = refits.with_indistinguishable(nominal, [turns], options=DIAGNOSIS)
    assert [one.label for one in found] == ["coil_turns_loss", " + ".join(TOGETHER)] and asked == [TOGETHER]
    assert refits.with_indistinguishable(nominal, found, options=DIAGNOSIS) == found and len(asked) == 1  # it is there
    for other in ([], [hypothesis(5000.0, "spool_lap")], [hypothesis(5000.0, "coil_turns_loss", "spool_lap")]):
        assert refits.with_indistinguishable(nominal, other, options=DIAGNOSIS) == other and len(asked) == 1
    nominal.study.candidates = candidates[:2]  # the session has no flexure to look at
    assert refits.with_indistinguishable(nominal, [turns], options=DIAGNOSIS) == [turns] and len(asked) == 1


def test_of_two_hypotheses_one_nests_the_other_by_one_law_as_common():
    laws = ("spool_coulomb_friction", "spool_stribeck_friction", "spool_silting")
    coulomb, stribeck, silting = (hypothesis(5000.0, name) for name in laws)
    assert stribeck.nests_law_of(coulomb) and not coulomb.nests_law_of(stribeck) and not stribeck.nests_law_of(stribeck)
    assert not silting.nests_law_of(coulomb)  # it is rarer
    beside = hypothesis(5000.0, "spool_stribeck_friction", "spool_lap")
    assert beside.nests_law_of(hypothesis(5000.0, "spool_lap", "spool_coulomb_friction"))
    assert not beside.nests_law_of(coulomb)
    assert not beside.nests_law_of(hypothesis(5000.0, "entrained_air", "spool_coulomb_friction"))
    figure = replace(beside, fit=replace(beside.fit, fitted=(FittedCandidate(FIGURE, 1e-6), beside.fit.fitted[1])))
    assert not figure.nests_law_of(hypothesis(5000.0, "spool_coulomb_friction", "spool_lap"))
    assert stribeck.holds(coulomb) and beside.holds(stribeck) and not coulomb.holds(stribeck)


def test_a_fuller_law_is_told_from_the_plainer_by_what_it_explains_more_and_always_stands_beside_it():
    """A test of power 0.94 was to tell Stribeck's friction from Coulomb's as if they were no laws of one (227512)."""
    plainer, fuller = hypothesis(5000.0, "spool_coulomb_friction"), hypothesis(4995.0, "spool_stribeck_friction")
    base = leaving(9000.0)
    alone, as_likely, beside = nested_levels(base, plainer, fuller, 4.0, LEVEL)
    assert alone == width_beside(base, fuller, plainer) and beside == 0.0
    assert as_likely == DIAGNOSIS.selection.law_gain
    assert nested_levels(base, plainer, fuller, 4.0, LEVEL, 1e4)[0] > alone


def test_a_pair_goes_before_its_first_by_no_more_than_the_odds_of_an_answer_set():
    alone, pair = hypothesis(5000.0, "spool_lap"), hypothesis(4940.0, "spool_lap", "entrained_air")
    nominal = SimpleNamespace(fit=replace(alone.fit, chi_square=9000.0, fitted=()), study=None)
    best, second = candidate_answers(nominal, [pair, alone], [pair, alone], LEVEL, "", LEVEL, options=DIAGNOSIS)[:2]
    assert [best.label, second.label] == [pair.label, alone.label]
    ratio = DIAGNOSIS.selection.answer_ratio
    assert 2.0 * np.log(best.probability / second.probability) == pytest.approx(ratio)


def test_how_wide_the_prior_of_a_second_amplitude_is_does_not_count_but_its_shapes_do():
    alone = hypothesis(5000.0, "spool_lap")
    wide = hypothesis(4950.0, "spool_lap", "entrained_air", occam_factor=30.0)
    narrow = hypothesis(4952.0, "spool_lap", "spool_coulomb_friction", occam_factor=10.0)
    nominal = leaving(9000.0)
    by_evidence = sorted([alone, wide, narrow], key=lambda one: one.evidence)
    assert by_evidence[0] is narrow and ranked(nominal, by_evidence, LEVEL) == [wide, narrow, alone]
    (lap, air) = wide.fit.fitted
    shaped = replace(air, shapes=(("one", 1.0), ("two", 1.0), ("three", 1.0)))
    wide = FittedHypothesis(wide.fit.with_fitted((lap, shaped)), options=DIAGNOSIS)
    wide = replace(wide, fit=replace(wide.fit, chi_square=4950.0))
    by_evidence = sorted([alone, wide, narrow], key=lambda one: one.evidence)
    assert ranked(nominal, by_evidence, LEVEL) == [narrow, wide, alone]


@pytest.mark.parametrize("wald, err", [((400.0, 200.0), 40.0), ((), 200.0), ((400.0, 5000.0), 200.0)])
def test_of_two_causes_the_law_of_each_may_err_by_what_it_explains_beside_the_other(wald, err):
    """A weak magnet beside a hysteresis of d' 13 was told alone: a fifth of all that both explain had not counted (pair
    222510).
    """
    pair = hypothesis(4000.0, "magnet_demagnetization", "magnetic_hysteresis", wald_statistics=wald)
    nominal = SimpleNamespace(fit=SimpleNamespace(chi_square=5000.0))
    law_error = CATALOGUE["magnetic_hysteresis"].law_error
    assert law_error == 0.2 == pair.law_error and pair.law_may_leave(nominal.fit) == pytest.approx(err)
    assert answer_set_width(nominal, pair) == pytest.approx(max(err, DIAGNOSIS.selection.answer_share * 1000.0))
    alone = hypothesis(4200.0, "magnetic_hysteresis", wald_statistics=(100.0,))
    assert alone.law_may_leave(nominal.fit) == pytest.approx(0.2 * 800.0)


def test_of_two_seconds_the_likelier_goes_first_whether_or_not_the_temperature_has_put_it_behind_the_first():
    """A chamber's volume had gone before air in the oil, which explains 54 more (130029)."""
    alone = hypothesis(5000.0, "spool_lap")
    air = hypothesis(4924.0, "spool_lap", "entrained_air", occam_factor=20.0)
    other = hypothesis(4974.0, "spool_lap", "spool_coulomb_friction", occam_factor=4.0)
    nominal = leaving(6700.0)
    by_evidence = sorted([alone, air, other], key=lambda one: one.evidence)
    assert [one for one in ranked(nominal, by_evidence) if one is not other] == [air, alone]
    assert ranked(nominal, by_evidence, LEVEL) == [air, alone, other]


def test_a_pair_goes_not_before_another_cause_that_does_as_well_alone():
    alone = hypothesis(5000.0, "spool_lap")
    pair = hypothesis(4970.0, "spool_lap", "entrained_air", occam_factor=40.0)
    rival = hypothesis(4975.0, "spool_coulomb_friction", occam_factor=26.0)
    nominal = leaving(5300.0)
    by_evidence = sorted([alone, pair, rival], key=lambda one: one.evidence)
    assert ranked(nominal, by_evidence, LEVEL) == [alone, rival, pair]
    assert ranked(nominal, sorted([alone, pair], key=lambda one: one.evidence), LEVEL) == [pair, alone]


def final_of(best, z, candidates):
    """The score test of the best."""
    candidates = tuple(candidates)
    return SimpleNamespace(
        fit=best.fit, options=DIAGNOSIS, z=lambda: np.array(z), level=lambda probability: LEVEL, candidates=candidates,
        projected=SimpleNamespace(score=np.ones(len(z)), overlap=np.eye(len(z))), sizes=np.ones(len(z)),
    )  # fmt: skip


@pytest.fixture
def seconds(monkeypatch):
    """(what is fitted beside the best, what is fitted again): no fit is made."""
    asked, again = [], []

    def fit_starts(nominal, starts, point, *, others, options):
        asked.extend([tuple(one.candidate.label for one in start) for start in starts])
        return []

    def pairs_from_members(nominal, found, *, options):
        again.append(list(found))
        return []

    monkeypatch.setattr(second_cause, "bearable_beside_bench", lambda final: 0.0)
    monkeypatch.setattr(second_cause, "beyond_noise", lambda fit, study, *, options: 0.0)
    monkeypatch.setattr(second_cause, "linear_amplitude", lambda final, k: FittedCandidate(final.candidates[k], 1.0))
    monkeypatch.setattr(second_cause, "fit_starts", fit_starts)
    monkeypatch.setattr(second_cause, "pairs_from_members", pairs_from_members)
    monkeypatch.setattr(second_cause, "from_other_sought_shapes", lambda nominal, found, *, options: [])
    return asked, again


def test_effects_are_tried_before_figures_that_show_hardly_more(seconds):
    """Three figures that act on the torque motor as its magnets do had kept these from being tried (130027)."""
    best, names = hypothesis(5000.0, "spool_lap"), ("entrained_air", "spool_edge_wear")
    final = final_of(best, (4.3, 4.2, 2.0), [FIGURE, *map(effect, names)])
    found, _ = second_cause.with_second_cause(leaving(5400.0), final, [best])
    assert seconds[0] == [("spool_lap", "entrained_air"), ("spool_lap", FIGURE.label)]
    assert found == [best] and seconds[1] == [[best]]


def test_what_promises_nearly_as_much_as_the_first_is_tried_however_many_there_are(seconds):
    """Three figures that act alike stood before the magnets that were weak, and were all in the answer (200012)."""
    best = hypothesis(5000.0, "spool_lap")
    figures = [replace(FIGURE, name=f"figure_{k}") for k in range(DIAGNOSIS.isolation.seconds)]
    names = ("magnet_demagnetization", "entrained_air")
    final = final_of(best, [10.9] * len(figures) + [10.58, 10.3], [*figures, *map(effect, names)])
    second_cause.with_second_cause(leaving(5400.0), final, [best])
    labels = [second for _, second in seconds[0]]
    assert labels == [*(one.label for one in figures), names[0]]  # the other promises 10 less than the first


def test_a_second_name_of_the_first_is_no_second_cause(seconds):
    """Lost turns beside the figure of the turns stood where a coil's resistance was the second (pair 229516)."""
    best = hypothesis(5000.0, "coil_turns_loss")
    turns = Candidate("parameter:coil_turns", parameter=replace(FIGURE.parameter, name="coil_turns"))
    final = final_of(best, (9.0, 8.0), [turns, effect("coil_resistance_drift")])
    assert turns.is_equivalent_to(best.candidates[0])
    second_cause.with_second_cause(leaving(5400.0), final, [best])
    assert seconds[0] == [("coil_turns_loss", "coil_resistance_drift")]


@pytest.mark.parametrize(
    "z, first, tried",
    [(3.9, "spool_lap", 0), (4.1, "spool_lap", 1), (9.0, "magnetic_hysteresis", 0), (11.0, "magnetic_hysteresis", 1)],
)
def test_a_second_cause_is_tried_beside_a_strong_first_one_too(seconds, z, first, tried):
    best = hypothesis(5000.0, first)
    second_cause.with_second_cause(leaving(1e6), final_of(best, [z], [effect("entrained_air")]), [best])
    assert len(seconds[0]) == tried


def test_beside_more_than_noise_another_law_of_the_first_may_explain_as_much(seconds, monkeypatch):
    best = hypothesis(5000.0, "magnetic_hysteresis")
    monkeypatch.setattr(second_cause, "beyond_noise", lambda fit, study, *, options: 1.0)
    second_cause.with_second_cause(leaving(9000.0), final_of(best, [20.0], [effect("entrained_air")]), [best])
    assert not seconds[0]
