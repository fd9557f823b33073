"""What could explain the data: the alarm, the hypotheses that are fitted, and those of them that stay.

Every candidate and every free term is tested against what the nominal fit leaves; the few that could explain it are
refitted, alone and in pairs, and fits that may have stopped short taken up again; what the best leaves is looked at
once more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.bench_faults import (
    explains_nearly_all,
    likeliest_cause,
    with_assumed_inputs,
    with_bench_faults,
    with_fault_left,
    with_faults_beside_cause,
)
from valvesim.diagnosis.channel_apart import ChannelApart, channel_apart
from valvesim.diagnosis.detection import (
    bearable_beside_bench,
    beyond_noise,
    detect,
    explained_by_bench,
    is_certain,
    is_other_valve,
    leaves_noise,
    nuisance_occam_factor,
    unexplained_share,
)
from valvesim.diagnosis.first_hypotheses import better_nominal, first_hypotheses
from valvesim.diagnosis.input_alternatives import (
    cause_under_other_inputs,
    with_inputs_of_any_cause,
    with_inputs_of_cause,
    with_inputs_of_likeliest_cause,
    with_inputs_of_one_cause,
)
from valvesim.diagnosis.joint_errors import (
    JointErrors,
    all_instrument_errors,
    error_places,
    instrument_errors_are_insignificant,
    joint_instrument_errors,
    without_instrument_errors,
)
from valvesim.diagnosis.known_faults import told_faults
from valvesim.diagnosis.model_discrepancy import with_model_discrepancy
from valvesim.diagnosis.model_selection import (
    FittedHypothesis,
    answer_set_of,
    answer_set_width,
    distinct,
    ranked,
    with_minimum_gain,
)
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.refits import (
    alike_hypotheses,
    far_off,
    fit_starts,
    hypotheses_at_other_shapes,
    largest_shift,
    plainer_hypotheses,
    reduced_hypotheses,
    refined_hypotheses,
    restarted,
    unfitted_plainer_hypotheses,
    with_fits_at_ends,
    with_fuller_laws,
    with_indistinguishable,
)
from valvesim.diagnosis.result import WhatToDo
from valvesim.diagnosis.rival_term import rival_terms
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.diagnosis.second_cause import (
    at_full_weight,
    effects_for_parameters,
    with_fits_from_prior,
    with_other_pairs,
    with_second_cause,
    without_corrections_of_laws,
)
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, evaluate_fit, is_adequate, rescored
from valvesim.identification.nominal_fit import (
    NominalFit,
    clipped_to_tolerance,
    has_uncertain_inputs,
    linearise_nominal,
    refit_nominal,
    unweighted,
    with_edges_tried,
    with_inputs_reviewed,
    with_inputs_tried,
)
from valvesim.identification.refinement import refined
from valvesim.identification.study import Study


@dataclass(frozen=True, eq=False)
class Isolation:
    """Where an isolation ended: `nominal` the nominal fit in the end, `scores` what it leaves, `final` what the best
    of the hypotheses `found` (best first) leaves; `answer_set` among them, and why an unknown cause is in it too,
    if it is; whether there is an alarm, and the `level` that the candidates' z had to pass; `bench` what the bench did,
    in words, and what to do about it; `nearest` the cause that comes nearest where these are records of another valve
    than the stated one, so that none was sought; `joint_errors` errors of the instruments that explain it together,
    instead of causes or as well as those of the answer set; `second_level` the z that a second cause had to pass;
    `channel` the channel that does not go with the others, where that was asked: no cause was sought where its response
    explains it; `under_other_inputs` another cause that explains as much as the one that was found, where the commands
    go otherwise between their samples.
    """

    nominal: NominalFit
    scores: ScoreTest
    final: ScoreTest
    found: Sequence[FittedHypothesis]
    answer_set: Sequence[FittedHypothesis]
    unknown_reason: str
    alarm: bool
    level: float
    bench: tuple[WhatToDo, ...] = ()
    nearest: Fit | None = None
    joint_errors: JointErrors | None = None
    second_level: float = np.inf
    channel: ChannelApart | None = None
    under_other_inputs: Candidate | None = None

    @property
    def is_other_valve(self) -> bool:
        """Whether these are records of another valve than the stated one."""
        return self.nearest is not None


def isolate(
    nominal: NominalFit, progress: Callable[[str, float], None], known: Sequence[Fit] = (), *, options: DiagnosisOptions
) -> Isolation:
    """The hypotheses of one and of two causes that explain what a nominal fit leaves, if that is an alarm.

    The nominal fit is made anew where they show that it had stopped short. Hypotheses `known` from elsewhere are the
    only ones to begin with. `progress(stage, share)` is called with what is being done.
    """
    progress("looking for causes", 0.0)
    scores, beside = score_test(nominal, nominal.fit, options=options), list[Fit]()
    begun, adequate = (nominal, scores), is_adequate(nominal.fit, options=options.identification)
    channel = None if adequate or known else channel_apart(*begun, options=options)
    if channel is not None and channel.response:
        level = scores.level(options.detection.false_alarm)
        return Isolation(nominal, scores, scores, [], [], "", True, level, channel=channel)
    if channel is not None and (isolation := _beside_other_channels(channel, progress, options=options)).answer_set:
        return isolation
    if detect(scores)[0]:
        nominal, scores = with_assumed_inputs(nominal, scores, options=options)
    if detect(scores)[0]:
        nominal, scores, beside = _with_bench(nominal, scores, known, options=options)
    level = scores.level(options.detection.false_alarm)
    if beside and is_other_valve(nominal, beside[0], options=options):
        return Isolation(nominal, scores, scores, [], [], "", True, level, nearest=beside[0])
    bench = told_faults(scores, options=options)
    if bench and detect(scores)[0] and _may_be_bench(nominal, scores, options=options):
        return Isolation(nominal, scores, scores, [], [], "", False, level, bench)
    isolation = _isolated(nominal, scores, progress, known, beside, options=options)
    if not known:
        isolation = _or_one_cause_under_other_inputs(isolation, progress, options=options)
    if [len(one.candidates) for one in isolation.answer_set] == [1]:
        best = isolation.answer_set[0].fit
        rival = cause_under_other_inputs(isolation.nominal, best, options=options)
        isolation = replace(isolation, under_other_inputs=rival)
    errors = None if isolation.answer_set else joint_instrument_errors(isolation.scores, options=options)
    if errors is not None and not isolation.alarm:
        isolation = _or_causes_like_errors(isolation, errors, progress, options=options)
    elif errors is None:
        isolation, errors = _with_second_like_errors(isolation, progress, options=options)
        if errors is None:
            isolation = _or_second_without_insignificant_errors(isolation, progress, options=options)
    if adequate and isolation.alarm and not isolation.answer_set:
        channel = channel_apart(*begun, options=options)
    bench = told_faults(isolation.final, options=options)
    return replace(isolation, bench=bench, joint_errors=errors, channel=channel)


def _beside_other_channels(
    channel: ChannelApart, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> Isolation:
    """The isolation that begins where the other channels say that the valve is: one that is far off has dragged the fit
    to all of them along.
    """
    nominal = channel.nominal
    isolation = _isolated(
        nominal, score_test(nominal, nominal.fit, options=options), progress, (), [], options=options
    )
    return replace(isolation, bench=told_faults(isolation.final, options=options))


def _or_one_cause_under_other_inputs(
    isolation: Isolation, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> Isolation:
    """The isolation whose likeliest are two causes, or none, under another way of the commands, where one of the two
    explains as much alone by that, or any does far more; else as it was. A way that is as plain is likelier than a
    second cause. Where an unknown one is possible beside two, each that was fitted alone is tried.
    """
    best = isolation.found[0].fit if isolation.found else isolation.nominal.fit
    members, under = [(member.candidate.label,) for member in best.fitted], None
    if len(members) > 1:
        alone = [one.fit for one in isolation.found if tuple(c.label for c in one.candidates) in members]
        under = with_inputs_of_one_cause(isolation.nominal, best, alone, options=options)
    doubtful = not isolation.answer_set or (len(members) > 1 and isolation.unknown_reason)
    if under is None and isolation.found and doubtful:
        causes = [one.fit for one in isolation.found]
        under = with_inputs_of_any_cause(isolation.nominal, best, causes, options=options)
    if under is None and isolation.found and (len(members) > 1 or not isolation.answer_set):
        under = with_inputs_of_likeliest_cause(isolation.nominal, best, options=options)
    if under is None:
        return isolation
    nominal, fit = under
    scores = score_test(nominal, nominal.fit, options=options)
    other = _isolated(nominal, scores, progress, (), [fit], options=options)
    return other if other.answer_set else isolation


def _or_causes_like_errors(
    isolation: Isolation, errors: JointErrors, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> Isolation:
    """The isolation without errors of the instruments, which explain together what none of them does by itself, where
    causes explain it by so few figures that they are likelier; else as it was.
    """
    nominal = without_instrument_errors(isolation.nominal)
    alone = _without_faults(options)
    scores = score_test(nominal, nominal.fit, options=alone)
    study, most = isolation.nominal.study, errors.evidence - options.selection.answer_ratio
    promised = options.isolation.most_causes * float(np.max(scores.z(), initial=0.0)) ** 2
    if rescored(study, nominal.fit).chi_square - promised + nuisance_occam_factor(scores) > most:
        return isolation
    other = _isolated(nominal, scores, progress, (), [], options=alone)
    if not other.answer_set:
        return isolation
    return other if _evidence_under(study, other.answer_set[0], other.scores) < most else isolation


def _with_second_like_errors(
    isolation: Isolation, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> tuple[Isolation, JointErrors | None]:
    """An isolation beside one cause without errors of the instruments, and these errors, where a second cause is
    likelier than they are: it may act like several of them, or like one where other readings hardly show it. Else the
    isolation as it was, its answer set with what explains nearly as much without errors, and None.
    """
    if not isolation.answer_set or len(isolation.found[0].candidates) > 1:
        return isolation, None
    best, nominal, ratio = isolation.found[0], isolation.nominal, options.selection.answer_ratio
    errors = all_instrument_errors(isolation.final, isolation.second_level**2)
    own = np.inf if errors is None else errors.evidence + best.evidence - best.fit.chi_square
    other = None if errors is None else _second_without_errors(isolation, own + ratio, progress, options=options)
    if other is None:
        return isolation, None
    likeliest = min(other.answer_set, key=other.evidence, default=None)
    if likeliest is not None and len(likeliest.candidates) > 1 and other.evidence(likeliest) < own - ratio:
        return other.isolation, errors
    most = own + answer_set_width(nominal, best)
    rivals = [
        _with_errors_at_zero(nominal, other, one, best.evidence + max(other.evidence(one) - own, 0.0))
        for one in other.answer_set
        if len(one.candidates) > 1
        and other.evidence(one) < most
        and other.positions.keys() <= {p.name for p in nominal.study.nominal.parameters}
        and any(alone.is_within(one) for alone in isolation.answer_set)
    ]
    found = _with_likelier(isolation.found, rivals)
    stays = [*isolation.answer_set, *rivals]
    answer_set = [one for one in found if any(map(one.has_same_causes, stays))]
    return replace(isolation, found=found, answer_set=answer_set), None


def _with_likelier(found: Sequence[FittedHypothesis], rivals: Sequence[FittedHypothesis]) -> list[FittedHypothesis]:
    """The found with rivals of them behind; of the same causes the likelier."""
    together = [*found, *rivals]

    def likeliest(causes: FittedHypothesis) -> FittedHypothesis:
        return min(filter(causes.has_same_causes, together), key=lambda one: one.evidence)

    return [one for one in together if one is likeliest(one)]


@dataclass(frozen=True, eq=False)
class _WithoutErrors:
    """An isolation without errors of the instruments, and the score test of its nominal fit; `study` the one with them,
    by which hypotheses are weighed.
    """

    isolation: Isolation
    scores: ScoreTest
    study: Study

    @property
    def answer_set(self) -> Sequence[FittedHypothesis]:
        """The answer set without errors."""
        return self.isolation.answer_set

    @property
    def positions(self) -> dict[str, int]:
        """The nuisance parameters of its model by name, and where they are."""
        return {p.name: k for k, p in enumerate(self.isolation.nominal.study.nominal.parameters)}

    def evidence(self, one: FittedHypothesis) -> float:
        """That of a hypothesis without errors, weighted as with them."""
        return _evidence_under(self.study, one, self.scores)


def _second_without_errors(
    isolation: Isolation, most: float, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> _WithoutErrors | None:
    """The isolation beside its one cause without errors of the instruments; None where what shows there promises no
    second cause of less than a value `most` of minus twice the log evidence.
    """
    best, study = isolation.found[0], isolation.nominal.study
    if not _promises_second(isolation, most, options=options):
        return None
    plain, known = _without_errors(isolation)
    alone = _without_faults(options)
    scores = score_test(plain, plain.fit, options=alone)
    one = fit_starts(plain, [best.fit.fitted], known[0].point, options=alone)[:1]
    shows = [float(np.max(score_test(plain, each.fit, options=alone).z(), initial=0.0)) for each in one]
    if not one or shows[0] < isolation.second_level:
        return None
    if _evidence_under(study, one[0], scores) - shows[0] ** 2 > most:
        return None
    return _WithoutErrors(_isolated(plain, scores, progress, known, [], options=alone), scores, study)


def _promises_second(isolation: Isolation, most: float, *, options: DiagnosisOptions) -> bool:
    """Whether a second cause may reach a value `most` of minus twice the log evidence without errors of the
    instruments, by equations linear at the best fit: none is made again for that.
    """
    best, final = isolation.found[0], isolation.final
    if final.fit is not best.fit:
        return True
    errors = error_places(final.study)
    chi_square, z = final.without_parameters(errors)
    alone = best.evidence - best.fit.chi_square + chi_square + nuisance_occam_factor(final, errors)
    return alone - options.isolation.promised * float(np.max(z, initial=0.0)) ** 2 < most


def _with_errors_at_zero(
    nominal: NominalFit, other: _WithoutErrors, one: FittedHypothesis, evidence: float
) -> FittedHypothesis:
    """A hypothesis without errors of the instruments in the model that has them, where its evidence is to be so much:
    it does without the figures of these.
    """
    at = other.positions
    point = np.array([
        one.fit.point[at[p.name]] if p.name in at else 0.0 for p in nominal.study.nominal.parameters
    ])  # fmt: skip
    fit = evaluate_fit(nominal.study, point, one.fit.fitted, nominal.fit.trajectories).with_posterior_of(one.fit)
    within = replace(one, fit=fit)
    return replace(one, fit=replace(fit, occam_factor=fit.occam_factor + evidence - within.evidence))


def _or_second_without_insignificant_errors(
    isolation: Isolation, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> Isolation:
    """The isolation without errors of the instruments that show nothing beside its one cause, where a second cause does
    without them and is likelier than they are with all samples at full weight; else as it was.

    While inputs may be late, samples next to peaks count less, and what shows there alone is not seen.
    """
    nominal, level = isolation.nominal, isolation.second_level
    one_cause = [len(one.candidates) for one in isolation.answer_set[:1]] == [1]
    insignificant = one_cause and instrument_errors_are_insignificant(isolation.final, level**2, options=options)
    if not insignificant or not has_uncertain_inputs(nominal.study):
        return isolation
    plain, known = _without_errors(isolation)
    start, within, full = known[0].fitted, unweighted(nominal), unweighted(plain)
    with_errors = fit_starts(within, [start], isolation.answer_set[0].fit.point, options=options)[:1]
    without = fit_starts(full, [start], known[0].point, options=options)[:1]
    if not with_errors or not without or not is_adequate(without[0].fit, options=options.identification):
        return isolation
    beside, left = (score_test(*one, options=options) for one in ((within, with_errors[0].fit), (full, without[0].fit)))
    shows = float(np.max(left.z(), initial=0.0))
    most = _evidence_under(within.study, with_errors[0], beside) - options.selection.answer_ratio
    if shows < level or _evidence_under(within.study, without[0], left) - shows**2 > most:
        return isolation
    alone = _without_faults(options)
    other = _isolated(plain, score_test(plain, plain.fit, options=alone), progress, known, [], options=alone)
    second = next((one for one in other.answer_set[:1] if len(one.candidates) > 1), None)
    is_likelier = second is not None and _evidence_under(within.study, second, other.final) < most
    return other if is_likelier else isolation


def _evidence_under(study: Study, one: FittedHypothesis, scores: ScoreTest) -> float:
    """Minus twice the log evidence of a hypothesis by a study's noise and weights, with the Occam factor of the
    nuisance parameters of a fit, to weigh it against one with other nuisance parameters.
    """
    reweighted = rescored(study, one.fit).chi_square - one.fit.chi_square
    return one.evidence + reweighted + nuisance_occam_factor(scores)


def _without_faults(options: DiagnosisOptions) -> DiagnosisOptions:
    """Options by which no fault of the bench is looked for."""
    return replace(options, bench=replace(options.bench, most_faults=0))


def _without_errors(isolation: Isolation) -> tuple[NominalFit, list[Fit]]:
    """The nominal fit of an isolation without errors of the instruments, and the fits of its answer set likewise."""
    plain = without_instrument_errors(isolation.nominal)
    names = [p.name for p in isolation.nominal.study.nominal.parameters]
    kept = [names.index(p.name) for p in plain.study.nominal.parameters]
    return plain, [replace(one.fit, point=one.fit.point[kept]) for one in isolation.answer_set]


def _with_bench(
    nominal: NominalFit, scores: ScoreTest, known: Sequence[Fit], *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest, list[Fit]]:
    """The nominal fit with what the bench did; fitted again from within tolerance where that leaves an alarm and
    figures that are off, for it may have stopped short; and refined where there still is one by score tests alone.
    What it leaves, and the fits of causes beside which the bench was looked at: of the hypotheses `known` from
    elsewhere, where there are any; how the commands go, and from where the fit ends elsewhere, has been asked there.
    """
    beside, reviewed, settled = list[Fit](), nominal, None
    if not known:
        reviewed = with_inputs_reviewed(nominal)
        adequate = is_adequate(nominal.fit, options=options.identification)
        if reviewed is nominal and adequate and not leaves_noise(nominal.fit, nominal.study, options=options):
            reviewed = with_edges_tried(nominal)
            settled = nominal if reviewed is nominal else None  # no way with edges is better
    if reviewed is not nominal:
        nominal, scores = reviewed, score_test(reviewed, reviewed.fit, options=options)
    if not is_adequate(nominal.fit, options=options.identification):
        cause = likeliest_cause(nominal, scores, known, options=options)
        likeliest = [FittedHypothesis(cause, options=options)] if cause is not None and not known else []
        if (wider := with_model_discrepancy(nominal, likeliest, options=options)) is not None:
            return _with_bench(wider, score_test(wider, wider.fit, options=options), known, options=options)
        nominal, scores, fit = with_faults_beside_cause(nominal, scores, cause, bool(known), options=options)
        beside = [fit] if fit is not None else []
    if beside and is_other_valve(nominal, beside[0], options=options):
        return nominal, scores, beside
    names = [p.name for p in nominal.study.nominal.parameters]
    explained = bool(beside) and explains_nearly_all(beside[0], nominal.fit, options=options)
    if detect(scores)[0] and not explained:  # what the bench did beside it has been asked
        nominal, scores = with_bench_faults(nominal, scores, options=options)
    adequate = is_adequate(nominal.fit, options=options.identification)
    if not known and detect(scores)[0] and adequate and largest_shift(nominal.fit) > options.isolation.shifted:
        within = evaluate_fit(nominal.study, clipped_to_tolerance(nominal), (), nominal.fit.trajectories)
        again = refit_nominal(nominal, within, options.isolation.same_end, options.isolation.same_start)
        if rescored(nominal.study, again.fit).chi_square >= nominal.fit.chi_square - options.isolation.slight_gain:
            again = nominal
        again = with_inputs_tried(again)
        again = again if again is settled else with_edges_tried(again)
        if again is not nominal:
            nominal, scores = again, score_test(again, again.fit, options=options)
    alarm, level = detect(scores)
    if alarm and not is_certain(scores, level):
        finer = refined(nominal.study, nominal.fit, nominal.J)
        if not np.array_equal(finer.point, nominal.fit.point):
            nominal = linearise_nominal(nominal.study, finer)
            scores = score_test(nominal, nominal.fit, options=options)
    if [p.name for p in nominal.study.nominal.parameters[: len(names)]] != names:
        beside = []  # of other edges: those fits are not of this model
    return nominal, scores, beside


def _may_be_bench(nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions) -> bool:
    """Whether what shows is little beside what the bench explains: no model is the plant."""
    left = beyond_noise(nominal.fit, nominal.study, options=options)
    shows = float(np.max(scores.z(), initial=0.0)) ** 2
    return shows < bearable_beside_bench(scores) and left <= options.bench.excess_share * explained_by_bench(scores)


def _isolated(
    nominal: NominalFit,
    scores: ScoreTest,
    progress: Callable[[str, float], None],
    known: Sequence[Fit],
    beside: Sequence[Fit],
    left_out: Set[str] = frozenset(),
    *,
    options: DiagnosisOptions,
) -> Isolation:
    for again in reversed(range(options.isolation.restarts + 1)):
        alarm, level = detect(scores)
        if not alarm:
            return Isolation(nominal, scores, scores, [], [], "", alarm, level)
        found, likeliest = first_hypotheses(
            nominal, scores, known, beside, lambda share: progress("refitting", 0.15 + 0.6 * share)
        )
        found = without_corrections_of_laws(nominal, found, options=options)
        wider = with_model_discrepancy(nominal, _likely(found, options=options), options=options)
        if wider is not None:
            break
        best, under = distinct(found, options=options)[:1], None
        if best and not known and again and not _is_of_same_causes(best[0].fit, beside):
            under = with_inputs_of_cause(nominal, best[0].fit, options=options)
        if under is not None:
            nominal, beside = under[0], [under[1]]
            scores = score_test(nominal, nominal.fit, options=options)
            continue
        better = better_nominal(nominal, found, options=options) if again else None
        if better is None:
            break
        nominal, scores = better, score_test(better, better.fit, options=options)
    if wider is None:
        found = _fitted_further(nominal, found, likeliest, left_out, options=options)
        wider = with_model_discrepancy(nominal, found, options=options)
    if wider is not None:
        scores = score_test(wider, wider.fit, options=options)
        nominal, scores, beside = _with_bench(wider, scores, known, options=options)
        return _isolated(nominal, scores, progress, known, beside, options=options)
    found = without_corrections_of_laws(nominal, found, options=options)
    found = with_minimum_gain(nominal, found, level, bearable_beside_bench(scores), options=options)
    progress("checking", 0.75)
    alone = [one for one in (found[:1] if known else found) if len(one.candidates) == 1][:1]
    left = [score_test(nominal, one.fit, options=options) for one in alone]
    if left and not known and (wider := with_fault_left(nominal, left[0], options=options)) is not None:
        anew = score_test(wider, wider.fit, options=options)
        known = _likely_beside_fault(nominal, found, options=options)
        return _isolated(wider, anew, progress, known, [], far_off(found, options=options), options=options)
    nominal, scores, found, final = _verified(nominal, scores, level, found, left)
    level = scores.level(options.detection.false_alarm)
    found = with_fuller_laws(nominal, found, options=options)
    found = with_fits_at_ends(nominal, found, options=options)
    found = with_indistinguishable(nominal, found, options=options)
    if not found:
        return Isolation(nominal, scores, final, [], [], "", alarm, level)
    if found[0].fit is not final.fit:
        final = score_test(nominal, found[0].fit, options=options)
    return judged(Isolation(nominal, scores, final, found, [], "", alarm, level))


def _likely_beside_fault(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> list[Fit]:
    """The fits of the answer set, and of that of single causes: beside a fault of the bench a second cause may go."""
    single = [one for one in found if len(one.candidates) == 1]
    alike = [each for among in (found, single) for each in answer_set_of(nominal, among, options=options)]
    return [one.fit for one in distinct(alike, options=options)]


def _is_of_same_causes(fit: Fit, others: Sequence[Fit]) -> bool:
    """Whether a fit has the causes of one of the others: how the commands go has been asked beside these."""
    labels = [member.candidate.label for member in fit.fitted]
    return any(labels == [member.candidate.label for member in other.fitted] for other in others)


def _likely(found: Sequence[FittedHypothesis], *, options: DiagnosisOptions) -> list[FittedHypothesis]:
    """The best of those found, and single causes that explain nearly as much as the best of these."""
    single = [one for one in found if len(one.candidates) == 1]
    least = min((one.fit.chi_square for one in single), default=0.0)
    near = [one for one in single if one.fit.chi_square < options.isolation.nearly_as_much * least]
    return [*distinct(found, options=options)[:1], *near]


def _fitted_further(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    likeliest: str,
    left_out: Set[str] = frozenset(),
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The found, best first, with fits that may have stopped short taken up again, alike effects in the places of the
    best's, the best refined, and its candidates tried one fewer. Labels `left_out` are known to come nowhere near.
    Other shapes of what is found are tried first: one comes near at once where another crawls.
    """
    found = [*found, *hypotheses_at_other_shapes(nominal, found, left_out, of_fitted=True, options=options)]
    found += restarted(nominal, found, likeliest, options=options)
    found += unfitted_plainer_hypotheses(nominal, found, left_out, options=options)
    found += plainer_hypotheses(nominal, found, left_out, options=options)
    found += alike_hypotheses(nominal, found, left_out, options=options)
    found += hypotheses_at_other_shapes(nominal, found, left_out, options=options)
    left_out = left_out | far_off(found, options=options)
    found = refined_hypotheses(nominal, found, options=options)
    plainer = plainer_hypotheses(nominal, found, left_out, options=options)
    found += refined_hypotheses(nominal, plainer, options=options)
    return reduced_hypotheses(nominal, distinct(found, options=options), options=options)


def judged(isolation: Isolation) -> Isolation:
    """An isolation with its hypotheses ranked, and their answer set: empty where even the best leaves too much."""
    nominal, final, found, options = isolation.nominal, isolation.final, isolation.found, isolation.scores.options
    left, best = unexplained_share(nominal, final), found[0]
    second = final.level(options.detection.second_false_alarm)
    lone = ranked(nominal, found)[0]  # a second cause may stand beside it, or before it
    found, plainest = ranked(nominal, found, second), left
    if found[0].fit is not final.fit:  # the plainer may leave what the fuller does not
        final = score_test(nominal, found[0].fit, options=options)
        plainest = unexplained_share(nominal, final)
    isolation = replace(isolation, final=final, found=found, second_level=second)
    if not _may_leave(nominal, best, left):  # where even the best leaves so much, it is not the answer
        return _with_one_within_law_error(isolation)
    whole = plainest <= options.isolation.unexplained_share
    answer_set = answer_set_of(nominal, found, whole, second, options=options)
    reason = unknown_reason_of(answer_set[0], min(left, plainest))
    beside = [one for one in answer_set if not one.is_indistinguishable_from(lone)]
    if not reason and len(lone.candidates) == 1 and all(map(lone.is_within, beside)):
        own = final if lone.fit is final.fit else score_test(nominal, lone.fit, options=options)
        rivals = [f"the {term.label}" for term in rival_terms(nominal, own)[:2]]
        reason = f"a plain term does as well, {' or '.join(rivals)}" if rivals else ""
    return replace(isolation, answer_set=answer_set, unknown_reason=reason)


def _may_leave(nominal: NominalFit, best: FittedHypothesis, left: float) -> bool:
    """Whether a hypothesis that leaves such a share of what it explains is still possible, beside an unknown cause: by
    its law, or because that is little.
    """
    return left <= max(best.options.detection.doubtful_share, best.law_error, best.bearable_share(nominal.fit))


def _one_within_law_error(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> ScoreTest | None:
    """The score test of the likeliest of those found, but for the best, whose law may err by what it leaves and by what
    the best explains more; None where there is none.
    """
    for one in found[1:]:
        behind = one.least_chi_square - found[0].least_chi_square
        if one.law_error <= options.detection.doubtful_share or behind > one.law_may_leave(nominal.fit):
            continue
        final = score_test(nominal, one.fit, options=options)
        if unexplained_share(nominal, final) <= one.law_error:
            return final
    return None


def _with_one_within_law_error(isolation: Isolation) -> Isolation:
    """The isolation whose best is no answer, with the one instead whose law may err by as much, an unknown cause beside
    it, and without what explains more and leaves too much; as it was where there is none.
    """
    nominal, found = isolation.nominal, isolation.found
    final = _one_within_law_error(nominal, found, options=isolation.scores.options)
    if final is None:
        return isolation
    found = found[next(k for k, one in enumerate(found) if one.fit is final.fit) :]
    reason = unknown_reason_of(found[0], unexplained_share(nominal, final))
    return replace(isolation, final=final, found=found, answer_set=found[:1], unknown_reason=reason)


def _verified(
    nominal: NominalFit,
    scores: ScoreTest,
    level: float,
    found: list[FittedHypothesis],
    known: Sequence[ScoreTest] = (),
) -> tuple[NominalFit, ScoreTest, list[FittedHypothesis], ScoreTest]:
    """The nominal fit in the end and its score test, hypotheses best first, and the score test of the best; `known` are
    score tests that may be needed.
    """
    final, tried = scores, frozenset[tuple]()
    if found:
        own = next((one for one in known if one.fit is found[0].fit), None)
        own = score_test(nominal, found[0].fit, options=scores.options) if own is None else own
        found, final = with_second_cause(nominal, own, found)
        found, final, tried = effects_for_parameters(nominal, scores, found, final)
        found, final = with_other_pairs(nominal, found, final)
        kept = without_corrections_of_laws(nominal, found, options=scores.options)
        final = final if kept[0] is found[0] else score_test(nominal, kept[0].fit, options=scores.options)
        found = kept
        if nominal.study.weights:
            full, found, final = at_full_weight(nominal, found, final)
            if full is not nominal:  # what is told of scores, limits and terms is of the fit that stands
                nominal, scores = full, score_test(full, full.fit, options=scores.options)
                tried = frozenset()
    bearable = max(scores.options.detection.doubtful_share, found[0].law_error if found else 0.0)
    if (
        largest_shift(nominal.fit) > scores.options.isolation.shifted
        and (not found or unexplained_share(nominal, final) > bearable)
        and _one_within_law_error(nominal, found, options=scores.options) is None
    ):
        found, final = with_fits_from_prior(nominal, scores, level, found, final, tried)
    return nominal, scores, found, final


def unknown_reason_of(best: FittedHypothesis, left: float) -> str:
    """Why what is in no catalogue may be the cause as well as the best, which leaves a share; "" where it may not."""
    if left > best.options.isolation.unexplained_share:
        return "what the likeliest leaves over, none of them explains"
    faults = [c.effect.name for c in best.candidates if c.effect is not None and c.effect.reading is not None]
    if len(set(faults)) < len(faults):
        return "sensors that err alike may show one thing that reaches them all"
    if any(member.candidate.is_ordinary(member.above_neutral) for member in best.fit.fitted):
        return "there may be so little of it without a fault"
    for member in best.fit.fitted:
        figure, most = member.candidate.parameter, best.options.isolation.largest_ratio
        if figure is None or not figure.is_of_valve or not figure.nominal:
            continue
        ratio = 1.0 + member.above_neutral / figure.nominal
        far = abs(member.above_neutral) > best.options.isolation.far_figure * figure.deviation
        if far and not 1.0 / most < ratio < most:
            return f"{ratio:.2g} times the stated figure: is the valve's file right, and what its command reads?"
    return ""
