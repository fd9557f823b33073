"""Refits of hypotheses from their starts, and again from elsewhere where they may have stopped short."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from contextlib import suppress
from dataclasses import replace

import numpy as np

from valvesim.diagnosis.model_selection import FittedHypothesis, answer_set_width, distinct, is_negligible
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.errors import InputError, SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit, is_adequate, largest_adequate, with_shapes
from valvesim.identification.fit_jacobian import linearise_fit
from valvesim.identification.hypothesis_fit import (
    continue_fit,
    fit_from_prior,
    fit_hypothesis,
    reductions_from_prior,
    unconverged,
)
from valvesim.identification.least_squares import predict_reduction
from valvesim.identification.nominal_fit import NominalFit, clipped_to_tolerance
from valvesim.identification.refinement import refined


def restarted(
    nominal: NominalFit, found: Sequence[FittedHypothesis], likeliest: str, *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Fits that may have stopped short, taken up again from elsewhere; not those that `alike_hypotheses` takes up from
    the figures of the best.
    """
    if not found:
        return []
    more = pairs_from_members(nominal, found, options=options)
    more += _from_usual_shapes(nominal, [*found, *more], options=options)
    more += from_other_sought_shapes(nominal, [*found, *more], options=options)
    least = min((one.fit for one in (*found, *more)), key=lambda fit: fit.chi_square)
    more += _from_best_point(nominal, [*found, *more], least, options=options)
    near = is_adequate(least, options=options.identification)
    renewed = options.isolation.restarts if near else 0  # times that a promise may be; far off none holds
    left_to_alike = [known for known, _ in _alike_in_place(nominal, [*found, *more], options=options)]
    for one in [*found, *more]:
        if any(one.fit is known for known in left_to_alike) or _is_of_same_and_worse(one, found):
            continue
        if near and not is_adequate(one.fit, options=options.identification):
            continue
        if (
            one.label == likeliest
            or one.fit.chi_square - renewed * one.fit.predicted_reduction
            < least.chi_square + options.selection.answer_ratio
        ):
            more += _restarted_within_tolerance(nominal, one.fit, options=options)
    return more


def _is_of_same_and_worse(one: FittedHypothesis, found: Sequence[FittedHypothesis]) -> bool:
    """Whether one of those found has the same causes and explains more."""
    return any(one.has_same_causes(other) and other.fit.chi_square < one.fit.chi_square for other in found)


def pairs_from_members(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Pairs that have ended above one of their own two fitted again from it: two can explain no less than one."""
    alone = {one.label: one.fit for one in found if len(one.candidates) == 1}
    again = []
    for pair in (one.fit for one in found if len(one.candidates) == 2):
        first, second = pair.fitted
        for member, other in ((first, second), (second, first)):
            fit = alone.get(member.candidate.label)
            if fit is not None and fit.chi_square < pair.chi_square:
                again.append(continue_fit(nominal, fit.with_fitted((*fit.fitted, replace(other, above_neutral=0.0)))))
    return [FittedHypothesis(fit, options=options) for fit in again if fit is not None]


def _from_usual_shapes(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The best fitted again where one of its shapes has ended at a bound: from its figures, with the shapes where they
    are looked for. At a bound it may be in the wrong one of several valleys.
    """
    best = distinct(found, options=options)[0].fit
    start = tuple(with_shapes(one.candidate, one.above_neutral) if _is_at_bound(one) else one for one in best.fitted)
    if start == best.fitted or not is_adequate(best, options=options.identification):
        return []
    return fit_starts(nominal, [start], best.point, others=found, options=options)


def from_other_sought_shapes(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Those that explain nearly as much as the best fitted again from the other values at which a shape of theirs is
    looked for: they may be in the wrong one of several valleys. Not of an effect that is a plainer one with a feature
    of its own, see `hypotheses_at_other_shapes`.
    """
    likely = distinct(found, options=options)
    best = likely[0]
    if not is_adequate(best.fit, options=options.identification):
        return []
    most = best.fit.chi_square + answer_set_width(nominal, best)
    fits = [
        fit_hypothesis(nominal, start, one.fit.point, worthwhile=one.fit.chi_square)
        for one in likely
        if one.fit.chi_square <= most
        for start in _at_other_sought_shapes(nominal, one)
    ]
    return [FittedHypothesis(fit, options=options) for fit in fits if fit is not None]


def _at_other_sought_shapes(nominal: NominalFit, one: FittedHypothesis) -> list[tuple[FittedCandidate, ...]]:
    """The starts of a hypothesis with one of its shapes at each other value at which it is looked for."""
    return [
        _in_place(one, k, with_shapes(candidate, member.above_neutral))
        for k, member in enumerate(one.fit.fitted)
        if not _plainer(member.candidate) and any(p.sought for p in member.candidate.shapes())
        for candidate in nominal.study.candidates
        if candidate.label == member.candidate.label and candidate.key != member.candidate.key
    ]


def _is_at_bound(member: FittedCandidate) -> bool:
    """Whether a shape is as small or as large as it may be."""
    shapes = dict(member.shapes)
    return any(shapes.get(p.name, p.default) in p.bounds for p in member.candidate.shapes())


def _from_best_point(
    nominal: NominalFit, found: Sequence[FittedHypothesis], least: Fit, *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Those that keep a nuisance parameter far from nominal where the one that explains most does not, fitted from
    its figures, but for those that `alike_hypotheses` begins there; single causes from within tolerance too: the
    nominal fit may have gone where there is no way back. Where what explains most keeps one far too, it alone is fitted
    from there.
    """
    if largest_shift(nominal.fit) <= options.isolation.shifted:
        return []
    if largest_shift(least) >= options.isolation.shifted:
        own = fit_from_prior(nominal, least.fitted, worthwhile=least.chi_square) if len(least.fitted) == 1 else None
        return [] if own is None else [FittedHypothesis(own, options=options)]
    shifted = [one.fit.fitted for one in found if largest_shift(one.fit) > options.isolation.shifted]
    if is_adequate(least, options=options.identification):
        shifted = [start for start, _ in _within_reach(nominal, shifted, least, options=options)]
    left_to_alike = [known.fitted for known, _ in _alike_in_place(nominal, found, options=options) if known is not None]
    begun = [start for start in shifted if not any(start is other for other in left_to_alike)]
    more = fit_starts(nominal, begun, least.point, others=found, options=options)
    worthwhile = largest_worthwhile_beside(nominal, least, options=options)
    anew = [fit_from_prior(nominal, fitted, worthwhile=worthwhile) for fitted in shifted if len(fitted) == 1]
    return [*more, *(FittedHypothesis(fit, options=options) for fit in anew if fit is not None)]


def largest_shift(fit: Fit) -> float:
    """How far out the furthest nuisance parameter is, in prior deviations."""
    return float(np.abs(fit.point).max(initial=0.0))


def _restarted_within_tolerance(nominal: NominalFit, fit: Fit, *, options: DiagnosisOptions) -> list[FittedHypothesis]:
    """A fit that has not settled, fitted again from where no nuisance parameter is far from nominal: its valley may
    be bent.
    """
    tried, reached = [fit], np.inf
    for _ in range(options.isolation.restarts):
        best = min(tried, key=lambda one: one.chi_square)
        if best.predicted_reduction < unconverged(nominal, best) or best.chi_square > reached - unconverged(
            nominal, best
        ):
            break
        reached = best.chi_square
        near = is_adequate(nominal.fit, options=options.identification)
        again = fit_hypothesis(nominal, best.fitted, clipped_to_tolerance(nominal)) if near else None
        tried += [again] if again is not None else []
        if again is None or again.predicted_reduction >= unconverged(nominal, again):
            again = fit_from_prior(nominal, best.fitted)
            tried += [again] if again is not None else []
    return [FittedHypothesis(one, options=options) for one in tried[1:]]


def fit_starts(
    nominal: NominalFit,
    starts: Sequence[tuple[FittedCandidate, ...]],
    point: np.ndarray | None = None,
    progress: Callable[[float], None] = lambda share: None,
    *,
    others: Sequence[FittedHypothesis] = (),
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The hypotheses of starts that can be run, each refitted from a point of the nuisance parameters; those that do
    not come near the records are given up early where one does, of these or of the `others`.
    """
    found = list[FittedHypothesis]()
    for k, start in enumerate(starts):
        progress(k / len(starts))
        worthwhile = _largest_adequate_beside(nominal, [*others, *found], options=options)
        fit = fit_hypothesis(nominal, start, point, worthwhile=worthwhile)
        found += and_without_negligible(nominal, fit, worthwhile, options=options)
    return found


def and_without_negligible(
    nominal: NominalFit, fit: Fit | None, worthwhile: float | None, *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The hypothesis of a fit, if there is one, and where some of its candidates came to nothing, that of the others
    fitted from there: one alone may get where it could not before.
    """
    if fit is None:
        return []
    more = _without_negligible(fit, options.isolation.slight_share)
    alone = fit_hypothesis(nominal, more, fit.point, worthwhile=worthwhile) if more else None
    return [FittedHypothesis(one, options=options) for one in (fit, alone) if one is not None]


def _largest_adequate_beside(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> float | None:
    """The largest chi-square of a fit that comes near the records, where one of those found does; None else."""
    near = any(is_adequate(one.fit, options=options.identification) for one in found)
    return largest_adequate(nominal.fit, options=options.identification) if near else None


def largest_worthwhile_beside(nominal: NominalFit, best: Fit, *, options: DiagnosisOptions) -> float | None:
    """The chi-square above which a fit from the prior is not continued beside a best that comes near the records: what
    an adequate fit may leave, or halfway from the best to the nominal fit where that is less; more than a slight gain
    above the best in any case, for such a fit has not ended yet. None where the best does not come near.
    """
    if not is_adequate(best, options=options.identification):
        return None
    halfway = 0.5 * (best.chi_square + nominal.fit.chi_square)
    most = min(halfway, largest_adequate(nominal.fit, options=options.identification))
    return max(most, best.chi_square + options.isolation.slight_gain)


def _without_negligible(fit: Fit, share: float) -> tuple[FittedCandidate, ...]:
    """What a fit has besides candidates that came to less than a share of what is typical; () where all or none did."""
    more = tuple(member for member in fit.fitted if not is_negligible(member, share))
    return more if len(more) < len(fit.fitted) else ()


def far_off(found: Sequence[FittedHypothesis], *, options: DiagnosisOptions) -> frozenset[str]:
    """The labels of those that do not come near the records where the best does."""
    near = {one.label for one in found if is_adequate(one.fit, options=options.identification)}
    return frozenset(one.label for one in found if near) - near


def plainer_hypotheses(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    left_out: Set[str] = frozenset(),
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The best with the plainer effect in the place of each that is one without its own feature, fitted from the best's
    figures: what a search has met first need not be what there is, and the plainer may have stopped short. Labels
    `left_out` have been fitted from there.
    """
    if not found:
        return []
    best = distinct(found, options=options)[0]
    starts = []
    for k, member in enumerate(best.fit.fitted):
        plainer, taken = _plainer(member.candidate), _others(best, k)
        for candidate in [c for c in nominal.study.candidates if c.name == plainer and plainer not in taken][:1]:
            known = _known_in_place(best, k, candidate, found)
            starts.append(_in_its_place(best, k, candidate) if known is None else _from_best(best, k, known))
    return _fitted_in_place(nominal, _without(left_out, starts), best, options=options)


def unfitted_plainer_hypotheses(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    left_out: Set[str] = frozenset(),
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The plainer effects of the single causes found that were not fitted themselves, from within the tolerances at
    what is typical of them: linear answers about an effect that is far off may show too little of it to begin with.
    Those of the best are left to `plainer_hypotheses`, and labels `left_out` have been fitted.
    """
    alone = [one.candidates[0] for one in found if len(one.candidates) == 1]
    of_best = {_plainer(c) for one in distinct(found, options=options)[:1] for c in one.candidates}
    unfitted = {_plainer(candidate) for candidate in alone} - {candidate.name for candidate in alone} - of_best
    plainer = {c.name: c for c in nominal.study.candidates if c.name in unfitted}
    starts = [(with_shapes(candidate, candidate.typical),) for candidate in plainer.values()]
    worthwhile = _largest_adequate_beside(nominal, found, options=options)
    return _fitted_from_prior(nominal, _without(left_out, starts), worthwhile, options=options)


def with_fuller_laws(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found, best first, with the pairs near the best fitted again with a law as common that holds the law of one
    of the two in its place, where they were not: of single causes both have been tried, but what stands beside them was
    begun with the likelier alone.
    """
    most = found[0].evidence + answer_set_width(nominal, found[0]) if found else 0.0
    more = list[FittedHypothesis]()
    for pair in [one for one in found if len(one.candidates) > 1 and one.evidence < most]:
        starts = [
            _in_its_place(pair, k, candidate)
            for k, member in enumerate(pair.fit.fitted)
            for candidate in {c.name: c for c in nominal.study.candidates}.values()
            if candidate.effect is not None
            and candidate.effect.as_common
            and candidate.effect.plainer == member.candidate.name
            and _known_in_place(pair, k, candidate, found) is None
        ]
        more += _fitted_in_place(nominal, starts, pair, options=options)
    return distinct([*found, *more], options=options) if more else list(found)


def with_indistinguishable(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found, best first, with the effects that together cannot be told from a single likeliest one."""
    if not found or len(found[0].candidates) > 1:
        return list(found)
    best, (member,) = found[0], found[0].fit.fitted
    named = {candidate.name: candidate for candidate in nominal.study.candidates if candidate.effect is not None}
    others = member.candidate.indistinguishable_from
    if not others or not named.keys() >= set(others) or any(one.is_indistinguishable_from(best) for one in found):
        return list(found)
    share = options.isolation.indistinguishable_start
    start = tuple(with_shapes(named[name], share * named[name].typical) for name in others)
    together = fit_starts(nominal, [start], best.fit.point, others=found, options=options)
    return distinct([*found, *together], options=options)


def alike_hypotheses(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    left_out: Set[str] = frozenset(),
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The best with an effect alike in the place of each, one that is the same plainer one with another feature, from
    the best's figures: those not fitted before, and those that explain much less. They may have stopped short. Labels
    `left_out` have been fitted from there.
    """
    if not found:
        return []
    starts = _without(left_out, [start for _, start in _alike_in_place(nominal, found, options=options)])
    return _fitted_in_place(nominal, starts, distinct(found, options=options)[0], options=options)


def hypotheses_at_other_shapes(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    left_out: Set[str] = frozenset(),
    *,
    of_fitted: bool = False,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The best with an effect in the place of each that is the same plainer one with a feature of its own, from the
    values of a shape at which it is looked for and from which it was not fitted: elsewhere it may have ended as the
    plainer one. From within the tolerances, for the best's figures make up for the feature. Labels `left_out` have been
    fitted from there. Only of effects that have been fitted at another of these values, where that is asked for.
    """
    best = distinct(found, options=options)[0] if found else None
    if best is None or not is_adequate(best.fit, options=options.identification):
        return []
    starts = list[tuple[FittedCandidate, ...]]()
    names = {candidate.name for one in found for candidate in one.candidates}
    for k, member in enumerate(best.fit.fitted):
        others = _others(best, k)
        begun = {c.key for one in found for j, c in enumerate(one.candidates) if _others(one, j) == others}
        starts += [
            _in_its_place(best, k, candidate)
            for candidate in nominal.study.candidates
            if _plainer(candidate) == member.candidate.plainest
            and any(p.sought for p in candidate.shapes())
            and candidate.key not in begun
            and candidate.name not in others
            and (candidate.name in names or not of_fitted)
        ]
    return _fitted_from_prior(nominal, _without(left_out, starts), options=options)


def _fitted_from_prior(
    nominal: NominalFit,
    starts: Sequence[tuple[FittedCandidate, ...]],
    worthwhile: float | None = None,
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The hypotheses of starts that can be run, each fitted from the prior, first the one that promises most;
    `worthwhile` as in `fit_hypothesis`. Where one comes near the records, those of the same effects at other shapes are
    not fitted that begin further off than without a cause.
    """
    promised = reductions_from_prior(nominal, starts)[0] if len(starts) > 1 else np.zeros(len(starts))
    found, near = list[FittedHypothesis](), set[tuple[str, ...]]()
    for k in np.argsort(-promised, kind="stable"):
        names = tuple(member.candidate.name for member in starts[k])
        if names in near and promised[k] < -nominal.fit.chi_square:
            continue
        if (fit := fit_from_prior(nominal, starts[k], worthwhile=worthwhile)) is None:
            continue
        found.append(FittedHypothesis(fit, options=options))
        if is_adequate(fit, options=options.identification):
            near.add(names)
    return found


def _fitted_in_place(
    nominal: NominalFit,
    starts: Sequence[tuple[FittedCandidate, ...]],
    best: FittedHypothesis,
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """Starts refitted from the best's figures, what is new in them in the amount that leaves least there: amounts of
    two laws of one thing do not compare. First the one that leaves least; where that comes near the records and the
    best did not, the others are refitted from its figures.
    """
    near = _within_reach(nominal, starts, best.fit, options=options)
    begun = [(min(tried, key=lambda fit: fit.chi_square) if tried else None, start) for start, tried in near]
    begun.sort(key=lambda one: one[0].chi_square if one[0] is not None else np.inf)
    best_is_far, found = not is_adequate(best.fit, options=options.identification), list[FittedHypothesis]()
    for k, (fit, start) in enumerate(begun, 1):
        scaled = fit.fitted if fit is not None else start
        found += fit_starts(nominal, [scaled], best.fit.point, others=[best, *found], options=options)
        least = distinct([best, *found], options=options)[0]
        if best_is_far and is_adequate(least.fit, options=options.identification):
            left = [start for _, start in begun[k:]]
            return [*found, *_fitted_in_place(nominal, left, least, options=options)]
    return found


def _in_amounts(
    nominal: NominalFit, start: tuple[FittedCandidate, ...], best: Fit, *, options: DiagnosisOptions
) -> list[Fit]:
    """A start at the figures of the best, not fitted, what the best does not have in several amounts; where the largest
    or the smallest of these leaves least, in more beyond it while they leave ever less.
    """
    own, amounts = {member.candidate.label for member in best.fitted}, sorted(options.isolation.amounts)
    tried = list[Fit]()

    def chi_square_in(times: float) -> float:
        scaled = tuple(
            one if one.candidate.label in own else replace(one, above_neutral=times * one.above_neutral)
            for one in start
        )
        with suppress(SolveError, InputError):
            tried.append(evaluate_fit(nominal.study, best.point, scaled, best.trajectories))
            return tried[-1].chi_square
        return np.inf

    left = {times: chi_square_in(times) for times in options.isolation.amounts}
    for end, ratio in ((amounts[0], amounts[0] / amounts[1]), (amounts[-1], amounts[-1] / amounts[-2])):
        times = end
        while min(left, key=left.__getitem__) == times:
            left[times * ratio] = chi_square_in(times * ratio)
            if not left[times * ratio] < options.isolation.further_amount * left[times]:
                break
            times *= ratio
    return tried


def _within_reach(
    nominal: NominalFit, starts: Sequence[tuple[FittedCandidate, ...]], best: Fit, *, options: DiagnosisOptions
) -> list[tuple[tuple[FittedCandidate, ...], list[Fit]]]:
    """The starts, each in several amounts at the figures of the best; where that comes near the records, those that
    nuisance parameters bring near them from there, by the linearised equations.
    """
    tried = [(start, _in_amounts(nominal, start, best, options=options)) for start in starts]
    if not tried or not is_adequate(best, options=options.identification):
        return tried
    study = nominal.study
    try:
        own = evaluate_fit(study, best.point, best.fitted, nominal.fit.trajectories)
        _, columns = linearise_fit(study, own)
    except (SolveError, InputError):
        return tried
    J = study.stack(columns)
    H, most = J.T @ J + np.eye(J.shape[1]), options.isolation.reach * largest_adequate(best, options=study.options)

    def left(fit: Fit) -> float:
        gradient = J.T @ fit.residual - fit.point
        return fit.chi_square - predict_reduction(H, gradient, study.nominal.limits - fit.point)

    return [(start, fits) for start, fits in tried if not fits or min(map(left, fits)) < most]


def _without(labels: Set[str], starts: Sequence[tuple[FittedCandidate, ...]]) -> list[tuple[FittedCandidate, ...]]:
    """The starts of other hypotheses than those of some labels."""
    return [start for start in starts if " + ".join(one.candidate.label for one in start) not in labels]


def _alike_in_place(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[tuple[Fit | None, tuple[FittedCandidate, ...]]]:
    """Fits of those found with an effect alike in the place of one of the best's that explain much less, each with its
    start from the best's figures; and starts of those that were not fitted, with None.
    """
    best = distinct(found, options=options)[0]
    most = best.fit.chi_square + answer_set_width(nominal, best)
    starts = list[tuple[Fit | None, tuple[FittedCandidate, ...]]]()
    for k, member in enumerate(best.fit.fitted):
        plainest = member.candidate.plainest
        taken = [member.candidate.name, *_others(best, k)]
        alike = {c.name: c for c in nominal.study.candidates if _plainer(c) == plainest and c.name not in taken}
        for candidate in alike.values():
            known = _known_in_place(best, k, candidate, found)
            if known is None:
                starts.append((None, _in_its_place(best, k, candidate)))
            elif known.chi_square > most:
                starts.append((known, _from_best(best, k, known)))
    return starts


def _in_its_place(best: FittedHypothesis, k: int, candidate: Candidate) -> tuple[FittedCandidate, ...]:
    """The start of a candidate in the place of the best's k-th, in the same amount, with the shapes that both have but
    for those at which it is looked for.
    """
    member = best.fit.fitted[k]
    share, shapes = member.above_neutral / member.candidate.typical, dict(member.shapes) | dict(candidate.fixed)
    return _in_place(best, k, with_shapes(candidate, share * candidate.typical, shapes))


def _plainer(candidate: Candidate) -> str:
    return candidate.effect.plainer if candidate.effect is not None else ""


def _others(best: FittedHypothesis, k: int) -> list[str]:
    """The names of the best's candidates but its k-th."""
    return [one.candidate.name for j, one in enumerate(best.fit.fitted) if j != k]


def _in_place(best: FittedHypothesis, k: int, other: FittedCandidate) -> tuple[FittedCandidate, ...]:
    return (*best.fit.fitted[:k], other, *best.fit.fitted[k + 1 :])


def _known_in_place(
    best: FittedHypothesis, k: int, candidate: Candidate, found: Sequence[FittedHypothesis]
) -> Fit | None:
    """The best fit of those found with a candidate, by its name, in the place of the best's k-th."""
    names = sorted([candidate.name, *_others(best, k)])
    known = [one.fit for one in found if sorted(c.name for c in one.candidates) == names]
    return min(known, key=lambda fit: fit.chi_square, default=None)


def _from_best(best: FittedHypothesis, k: int, known: Fit) -> tuple[FittedCandidate, ...]:
    """The start of a known fit's candidate in the place of the best's k-th, which gives the shapes that both have."""
    own = next(one for one in known.fitted if one.candidate.name not in _others(best, k))
    shapes = {**dict(own.shapes), **dict(best.fit.fitted[k].shapes)}
    return _in_place(best, k, with_shapes(own.candidate, own.above_neutral, shapes))


def refined_hypotheses(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found, the best that come near the records refined, as far as they may still be the best then; and without
    what has come to nothing by that.
    """
    best = distinct(found, options=options)[: options.isolation.refined]
    near, better = list[FittedHypothesis](), list[FittedHypothesis]()
    for one in best:
        least = min((other.evidence for other in better), default=np.inf)
        promised = one.evidence - one.fit.predicted_reduction  # it may have stopped far short of that
        if promised < least + options.isolation.refined_gain and is_adequate(one.fit, options=options.identification):
            near.append(one)
            better.append(FittedHypothesis(refined(nominal.study, one.fit), options=options))
    better += _those_without_negligible(nominal, better, options=options)
    return [*better, *(one for one in found if not any(one is other for other in near))]


def _those_without_negligible(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Of the found in which a candidate has come to nothing, the others fitted without it."""
    share = options.selection.negligible_amplitude
    starts = [(more, one.fit.point) for one in found if (more := _without_negligible(one.fit, share))]
    return [one for more, point in starts for one in fit_starts(nominal, [more], point, options=options)]


def with_fits_at_ends(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found, best first, with those fitted to their ends that may come near the best by what their fits still
    promise, and those near it that differ by laws as common: these are weighed by less than fits stop short of.
    """
    most = found[0].evidence + answer_set_width(nominal, found[0]) if found else 0.0
    limits = options.identification.fit
    near = [one for one in found if one.promised_evidence < most]
    laws = [one for one in near if any(one.nests_law_of(other) or other.nests_law_of(one) for other in near)]
    short = [one for one in near if one.fit.predicted_reduction > 2.0 * limits.hypothesis_ftol and one not in laws]
    fits = [_at_end_of_law(nominal, one.fit, limits.law_ftol) for one in laws]
    fits += [refined(nominal.study, one.fit) for one in short]
    if not fits:
        return list(found)
    ends = [FittedHypothesis(fit, options=options) for fit in fits]
    ends += _those_without_negligible(nominal, ends, options=options)
    kept = [one for one in found if one not in laws and one not in short]
    return distinct([*ends, *kept], options=options)


def _at_end_of_law(nominal: NominalFit, fit: Fit, enough: float) -> Fit:
    """A fit at its end; as it is where it has been there but for `enough` of the chi-square, and not tested again."""
    end = refined(nominal.study, fit, enough=enough)
    return end if fit.chi_square - end.chi_square > enough else fit


def reduced_hypotheses(
    nominal: NominalFit, found: list[FittedHypothesis], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The found with the best's candidates one fewer each time that this is better still.

    Each is fitted, however far off it begins: figures of the valve may have moved to make room for what is left out.
    """
    while found and len(found[0].candidates) > 1:
        best = found[0].fit
        starts = [tuple(member for member in best.fitted if member is not left_out) for left_out in best.fitted]
        fewer = fit_starts(nominal, starts, best.point, others=found, options=options)
        merged = distinct([*found, *fewer], options=options)
        if merged[0] is found[0]:
            return merged
        found = merged
    return found


def comes_near(
    nominal: NominalFit, best: Fit, start: tuple[FittedCandidate, ...], *, options: DiagnosisOptions
) -> bool:
    """Whether candidates come near the records, not fitted again, where the best has them with others."""
    try:
        return is_adequate(evaluate_fit(nominal.study, best.point, start), options=options.identification)
    except (SolveError, InputError):
        return False
