"""Causes beside the best and in its place: a second one, other pairs, effects in place of parameters."""

from __future__ import annotations

from collections.abc import Sequence, Set

import numpy as np

from valvesim.diagnosis.detection import bearable_beside_bench, beyond_noise
from valvesim.diagnosis.model_selection import (
    FittedHypothesis,
    answer_set_of,
    distinct,
    least_gain_of_second,
    rarity_penalty,
    with_minimum_gain,
)
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.refits import (
    and_without_negligible,
    comes_near,
    fit_starts,
    from_other_sought_shapes,
    largest_worthwhile_beside,
    pairs_from_members,
    reduced_hypotheses,
    refined_hypotheses,
)
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.diagnosis.starts import at_typical, best_of_labels, linear_amplitude, single_starts, typical_starts
from valvesim.identification.fit import Fit, FittedCandidate, is_adequate, rescored
from valvesim.identification.hypothesis_fit import fit_from_prior, fit_hypothesis, reductions_from_prior
from valvesim.identification.nominal_fit import NominalFit, has_uncertain_inputs, linearised_at, unweighted


def with_second_cause(
    nominal: NominalFit, final: ScoreTest, found: list[FittedHypothesis]
) -> tuple[list[FittedHypothesis], ScoreTest]:
    """The found with a second effect where one shows in what the best leaves.

    A third is not looked for: what two leave over tells that one of them is not it, rather than of three at once.
    """
    while len(final.fit.fitted) < final.options.isolation.most_causes:
        z, level = final.z(), final.level(final.options.detection.second_false_alarm)
        best = found[0]
        least = max(least_gain_of_second(nominal, best, level), bearable_beside_bench(final))
        if beyond_noise(final.fit, nominal.study, options=final.options) > 0.0:  # another law of it may do better
            least = max(least, best.law_may_leave(nominal.fit))
        if z.max(initial=0.0) ** 2 < least:
            break
        starts = [(*best.fit.fitted, linear_amplitude(final, k)) for k in _second_candidates(final)]
        more = fit_starts(nominal, starts, best.fit.point, others=found, options=final.options)
        more += pairs_from_members(nominal, [best, *more], options=final.options)
        more += from_other_sought_shapes(nominal, [best, *more], options=final.options)
        more = refined_hypotheses(nominal, more, options=final.options)  # as the first has been
        merged = distinct([*found, *more], options=final.options)
        if merged[0] is best:  # what a second one explains is too little to be sure of, but may be there
            found = merged
            break
        found = reduced_hypotheses(nominal, merged, options=final.options)
        final = score_test(nominal, found[0].fit, options=final.options)
    return found, final


def _second_candidates(scores: ScoreTest, tried: Set[str] = frozenset()) -> list[int]:
    """The candidates to try beside those of a fit, without labels that were `tried`: the few that promise most, and
    with them all that promise nearly as much as the first: figures that act alike would else be in an effect's way.
    """
    options = scores.options.isolation
    promised = scores.z() ** 2 - [rarity_penalty(candidate, options=scores.options) for candidate in scores.candidates]
    most = promised.max()
    likely = best_of_labels(scores, promised, options.second_share**2 * most)
    first = [member.candidate for member in scores.fit.fitted]  # a second name of it is no second cause
    new = [
        k
        for k in likely
        if scores.candidates[k].label not in tried and not any(map(scores.candidates[k].is_equivalent_to, first))
    ]
    nearly = most - scores.options.selection.answer_ratio
    return [k for j, k in enumerate(new) if j < options.seconds or promised[k] > nearly]


def without_corrections_of_laws(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found without those that leave more than noise and add no more to another one than its law may err by: what
    another law of the same effect does better is no second cause. Where that counts as noise (`model_discrepancy`) they
    leave no more than that either.
    """

    def corrects(one: FittedHypothesis, alone: FittedHypothesis) -> bool:
        fuller = len(alone.candidates) < len(one.candidates) and alone.is_within(one)
        return fuller and alone.fit.chi_square - one.fit.chi_square < alone.law_may_leave(nominal.fit)

    return [
        one
        for one in found
        if (not nominal.study.discrepancy and beyond_noise(one.fit, nominal.study, options=options) == 0.0)
        or not any(corrects(one, alone) for alone in found)
    ]


def without_corrections_begun(
    nominal: NominalFit, starts: Sequence[tuple[FittedCandidate, ...]], found: Sequence[FittedHypothesis]
) -> list[tuple[FittedCandidate, ...]]:
    """The starts of pairs without those that are left out by `without_corrections_of_laws` wherever they end: beside
    one that was found alone, the law of which may err by more than it leaves.
    """
    corrected = {
        one.label
        for one in found
        if nominal.study.discrepancy
        and len(one.candidates) == 1
        and one.fit.chi_square < one.law_may_leave(nominal.fit)
    }
    return [start for start in starts if not any(member.candidate.label in corrected for member in start)]


def with_other_pairs(
    nominal: NominalFit, found: list[FittedHypothesis], final: ScoreTest
) -> tuple[list[FittedHypothesis], ScoreTest]:
    """The found where the best has two causes, with what else would go well beside each of these; a pair that is better
    so is tried with one cause fewer.
    """
    best, more = found[0].fit, list[FittedHypothesis]()
    if len(best.fitted) < 2:
        return found, final
    near = is_adequate(best, options=final.options.identification)
    for member in best.fitted:
        alone = _alone(member, found)
        if alone is None or not is_adequate(alone, options=final.options.identification):
            if near and not comes_near(nominal, best, (member,), options=final.options):
                continue
            alone = fit_hypothesis(nominal, (member,), best.point)
        if alone is None:
            continue
        more.append(FittedHypothesis(alone, options=final.options))
        scores = score_test(nominal, alone, options=final.options)
        starts = [
            (member, linear_amplitude(scores, k))
            for k in _second_candidates(scores, _beside(member.candidate.label, found))
        ]
        more += fit_starts(nominal, starts, best.point, others=found, options=final.options)
    merged = distinct([*found, *more], options=final.options)
    if merged[0] is found[0]:
        return merged, final
    merged = reduced_hypotheses(nominal, merged, options=final.options)
    return merged, score_test(nominal, merged[0].fit, options=final.options)


def _alone(member: FittedCandidate, found: Sequence[FittedHypothesis]) -> Fit | None:
    """The best of the fits found with a candidate alone."""
    fits = [one.fit for one in found if [c.label for c in one.candidates] == [member.candidate.label]]
    return min(fits, key=lambda fit: fit.chi_square, default=None)


def _beside(label: str, found: Sequence[FittedHypothesis]) -> frozenset[str]:
    """The labels of what was found beside a candidate in a pair."""
    pairs = [{c.label for c in one.candidates} for one in found if len(one.candidates) > 1]
    return frozenset[str]().union(*(pair for pair in pairs if label in pair))


def with_fits_from_prior(
    nominal: NominalFit,
    scores: ScoreTest,
    level: float,
    found: list[FittedHypothesis],
    final: ScoreTest,
    tried: Set[tuple] = frozenset(),
) -> tuple[list[FittedHypothesis], ScoreTest]:
    """The found with single candidates, and the best if it is a pair, fitted from where no nuisance parameter is far
    from nominal, if one of these is better: a pair may have begun where there is no way back, too.

    Starts that were `tried` from there under the same nominal fit (`start_keys`) are not fitted again: what they have
    come to is among the found.
    """
    starts: dict[str, tuple[FittedCandidate, ...]] = {}
    for start in [
        *typical_starts(nominal, scores),
        *single_starts(scores, scores.z() ** 2, 0.5 * scores.options.isolation.single_share),
    ]:
        starts.setdefault(start[0].candidate.label, start)
    chosen = list(starts.values())[: scores.options.isolation.singles]
    new = [start for start in chosen if not start_keys([start]) <= tried]
    new += [one.fit.fitted for one in found[:1] if len(one.candidates) > 1]
    fits = [fit for start in new if (fit := fit_from_prior(nominal, start)) is not None]
    merged = distinct(
        [
            *found,
            *with_minimum_gain(
                nominal,
                [FittedHypothesis(fit, options=scores.options) for fit in fits],
                level,
                bearable_beside_bench(scores),
                options=scores.options,
            ),
        ],
        options=scores.options,
    )
    if merged[:1] == found[:1]:
        return found, final
    return with_second_cause(nominal, score_test(nominal, merged[0].fit, options=scores.options), merged)


def start_keys(starts: Sequence[tuple[FittedCandidate, ...]]) -> frozenset[tuple]:
    """What tells starts from each other: of each start its candidates, amplitudes and shapes."""
    return frozenset(tuple((one.candidate.key, one.above_neutral, one.shapes) for one in start) for start in starts)


def effects_for_parameters(
    nominal: NominalFit, scores: ScoreTest, found: list[FittedHypothesis], final: ScoreTest
) -> tuple[list[FittedHypothesis], ScoreTest, frozenset[tuple]]:
    """The found where the best has a figure beyond its tolerance, with effects in the place of that; and the
    `start_keys` of what was fitted.

    They are those of one sign whose linearised predictions have the other one, and that explain something at their
    typical amplitudes: what such an effect shows there may be something else, and a figure that many others follow may
    have taken its place.
    """
    best = found[0].fit
    rest = tuple(member for member in best.fitted if member.candidate.effect is not None)
    if len(rest) == len(best.fitted):
        return found, final, frozenset()
    z = scores.z()
    beside = [
        k
        for k, c in enumerate(scores.candidates)
        if c.effect is not None and c.effect.reading is None and c.one_sided and z[k] == 0.0
        and not any(c.excludes(member.candidate) for member in rest)
    ]  # fmt: skip
    starts = [(*rest, at_typical(scores, k)) for k in beside]
    without, *falls = reductions_from_prior(nominal, [rest, *starts])[0]
    order = np.argsort(-np.array(falls), kind="stable")[: scores.options.isolation.seconds]
    likeliest = [starts[k] for k in order if falls[k] > without]
    worthwhile = largest_worthwhile_beside(nominal, best, options=scores.options)
    fits = [fit_from_prior(nominal, start, worthwhile=worthwhile) for start in likeliest]
    more = [one for fit in fits for one in and_without_negligible(nominal, fit, worthwhile, options=scores.options)]
    merged = distinct([*found, *more], options=scores.options)
    if merged[0] is not found[0]:  # what was beside the figure may do without either
        merged = reduced_hypotheses(nominal, merged, options=scores.options)
    final = final if merged[0] is found[0] else score_test(nominal, merged[0].fit, options=scores.options)
    return merged, final, start_keys(likeliest)


def _refitted_from(nominal: NominalFit, point: np.ndarray) -> NominalFit:
    """The nominal fit, or the nominal model fitted from the point (p,) of a hypothesis where that leaves less: a fit at
    its end with samples down-weighted is not so at full weight, and what hypotheses explain is counted from it.
    """
    fit = fit_hypothesis(nominal, (), point)
    if fit is None or fit.chi_square >= nominal.fit.chi_square:
        return nominal
    return linearised_at(nominal.study, fit.point, full_weight=True)


def at_full_weight(
    nominal: NominalFit, found: list[FittedHypothesis], final: ScoreTest
) -> tuple[NominalFit, list[FittedHypothesis], ScoreTest]:
    """The answer set refitted with all samples at full weight, where its best can follow the peaks that the nominal
    fit cannot, and where what the inputs do is known to the microseconds that a peak takes.

    What tells a second cause from none may be in them.
    """
    if has_uncertain_inputs(nominal.study):
        return nominal, found, final
    full, near = unweighted(nominal), answer_set_of(nominal, found, options=final.options)
    limits = final.options.identification.fit
    best = rescored(full.study, found[0].fit)
    if best.chi_square > limits.peak_ratio * limits.inadequate_ratio * best.rows:  # no step follows peaks so far off
        return nominal, found, final
    full = _refitted_from(full, best.point)
    again = distinct(
        [each for one in near for each in fit_starts(full, [one.fit.fitted], one.fit.point, options=final.options)],
        options=final.options,
    )
    if not again or not is_adequate(again[0].fit, options=final.options.identification):
        return nominal, found, final
    found = reduced_hypotheses(full, again, options=final.options)
    causes = len(found[0].candidates)
    found, final = with_second_cause(full, score_test(full, found[0].fit, options=final.options), found)
    if len(found[0].candidates) > causes:  # beside one of several alike, where the others may be likelier
        found, final = with_other_pairs(full, found, final)
    return _refitted_from(full, found[0].fit.point), found, final
