"""What the records tell, concluded from what was isolated: the verdict with its reason, the answer set, and the term
that is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.apart import odd_test
from valvesim.diagnosis.detection import beyond_noise, beyond_reach, is_certain, is_inadequate
from valvesim.diagnosis.isolation import Isolation
from valvesim.diagnosis.known_faults import told_faults
from valvesim.diagnosis.missing_term import RecoveredTerm, recover_term
from valvesim.diagnosis.model_selection import FittedHypothesis, null_hypothesis_beside
from valvesim.diagnosis.one_parameter_term import one_parameter_term
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import (
    AMBIGUOUS,
    BENCH,
    CAUSE,
    CHANNEL_APART,
    NO_DISCREPANCY,
    OTHER_VALVE,
    RECORDS_APART,
    UNKNOWN,
    WhatToDo,
)
from valvesim.diagnosis.score_test import term_score_test
from valvesim.diagnosis.term_entry import as_catalogue_entry
from valvesim.diagnosis.wording import candidate_words
from valvesim.identification.fit import Fit
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.study import Study

FAR_OFF = "what fits these records best is not the stated valve nor a part that could take its place"
OTHER_INPUTS = "the commands went another way between their samples (sample faster)"
INADEQUATE = "the base model cannot come near these records: are they of this valve, with these units and signs?"


@dataclass(frozen=True, eq=False)
class Conclusion:
    """What an `isolation` comes to.

    `answer_set` holds the hypotheses that may be the cause, `best` is the likeliest of all that were fitted.
    `unknown_reason` tells why the cause may be none of them, `doubt` what it may be besides, in words, of which errors
    of instruments are one, and `recovered` is the term that would then be missing. `reason` is the verdict's where the
    answer is about something else than a cause in the valve, `because` the same in words, and `odd` the test or the
    channel that does not go with the others.
    """

    isolation: Isolation
    verdict: str
    answer_set: tuple[FittedHypothesis, ...]
    best: FittedHypothesis | None
    unknown_reason: str
    doubt: str
    recovered: RecoveredTerm | None
    reason: str
    because: str
    odd: str

    @property
    def fit(self) -> Fit:
        """The fit of the likeliest hypothesis, the nominal one where there is none."""
        return _fit_of(self.isolation, self.best)

    @property
    def nominal(self) -> NominalFit:
        """The nominal fit that explains the records best: without the channel that does not go with the others."""
        channel = self.isolation.channel
        return channel.nominal if channel is not None and self.reason == CHANNEL_APART else self.isolation.nominal

    @property
    def is_named(self) -> bool:
        """Whether known causes are named, one or several."""
        return self.best is not None and self.verdict in (CAUSE, AMBIGUOUS)


def conclude(isolation: Isolation) -> Conclusion:
    """The verdict on what was isolated. What no known cause explains is looked for as a missing term."""
    nominal, options = isolation.nominal, isolation.scores.options
    best, answer_set, unknown_reason = _hypotheses(isolation)
    inadequate = is_inadequate(nominal, _fit_of(isolation, best), options=options)
    recovered, odd, channel = None, "", isolation.channel
    explained = channel is not None and bool(channel.response)
    sought = isolation.alarm and not (inadequate or isolation.is_other_valve or explained)
    if sought and (unknown_reason or not answer_set):
        isolation, recovered, odd = _with_missing_term(isolation, answer_set)
        best, answer_set, unknown_reason = _hypotheses(isolation)
    if _none_stands(nominal, answer_set, isolation.found, recovered, inadequate, options=options):
        answer_set, unknown_reason = (), ""
    far = ""
    if isolation.alarm and not answer_set:
        point = recovered.point if recovered is not None else _fit_of(isolation, best).point
        far = figures_at_limit(nominal.study, point)
        recovered = None if far else recovered
        if recovered is not None and isolation.bench:
            isolation = replace(isolation, bench=_faults_beside_term(nominal, recovered, options=options))
    doubts = [unknown_reason] if unknown_reason else []
    if isolation.joint_errors is not None and answer_set:
        what = "it" if len(answer_set[0].candidates) == 1 else "a part of it"
        doubts.append(f"errors of the instruments explain {what} as well ({isolation.joint_errors.words})")
    doubt = f"none of the known causes: {'; '.join(doubts)}" if doubts else ""
    if isolation.under_other_inputs is not None and answer_set:
        other = f"{candidate_words(isolation.under_other_inputs)}, if {OTHER_INPUTS}"
        doubt = f"{other}, or {doubt}" if doubt else other
    verdict, reason, because = verdict_of(isolation.alarm, answer_set, doubt), "", ""
    if verdict == UNKNOWN and recovered is None and not odd and channel is not None:
        reason, because, odd = CHANNEL_APART, channel.words, channel.name
    elif inadequate or (verdict == UNKNOWN and far):
        verdict, reason, because = UNKNOWN, OTHER_VALVE, INADEQUATE if inadequate else f"{FAR_OFF} ({far})"
        isolation = replace(isolation, bench=())  # a fit that is rejected tells nothing of it
    elif odd:
        reason, because = RECORDS_APART, f"these records do not belong together: {odd} alone is not as the others say"
    elif verdict == NO_DISCREPANCY and isolation.bench:
        reason, because = BENCH, "; ".join(one.label for one in isolation.bench)
    return Conclusion(isolation, verdict, answer_set, best, unknown_reason, doubt, recovered, reason, because, odd)


def _faults_beside_term(
    nominal: NominalFit, recovered: RecoveredTerm, *, options: DiagnosisOptions
) -> tuple[WhatToDo, ...]:
    """What the bench did beside a term: without it, errors of the instruments had made up for some of the term."""
    beside = term_score_test(nominal, recovered.as_fit(nominal.study), options=options)
    return told_faults(beside, options=options)


def _hypotheses(isolation: Isolation) -> tuple[FittedHypothesis | None, tuple[FittedHypothesis, ...], str]:
    """The best hypothesis, the answer set, and why an unknown cause may be the cause too."""
    beside = null_hypothesis_beside(
        isolation.nominal, isolation.answer_set, isolation.level, options=isolation.scores.options
    )
    best = isolation.found[0] if isolation.found else None
    return best, (*isolation.answer_set, *beside), isolation.unknown_reason


def _fit_of(isolation: Isolation, best: FittedHypothesis | None) -> Fit:
    return best.fit if best is not None else isolation.nominal.fit


def _with_missing_term(
    isolation: Isolation, answer_set: Sequence[FittedHypothesis]
) -> tuple[Isolation, RecoveredTerm | None, str]:
    """What was isolated with a term looked for that no known cause explains; the term, if there is one that is no
    entry of the catalogue, and the test that alone is not as the others say, instead of one.

    Without an alarm where no cause and no term bears out what score tests alone have shown.
    """
    nominal, scores = isolation.nominal, isolation.scores
    borne_out = bool(isolation.found) or is_certain(scores, isolation.level)
    excess = beyond_noise(nominal.fit, nominal.study, options=scores.options) > 0.0
    odd = odd_test(nominal, options=scores.options) if excess and not answer_set else ""
    recovered = None if odd else recover_term(nominal, scores)
    if recovered is None:
        slight = None if odd else one_parameter_term(nominal, scores)
        return replace(isolation, alarm=isolation.alarm and (borne_out or slight is not None)), slight, odd
    entry = as_catalogue_entry(isolation, recovered)
    return (isolation, recovered, "") if entry is isolation else (entry, None, "")


def figures_at_limit(study: Study, point: np.ndarray) -> str:
    """The figures that a point (p,) has off by as much as they may be, in words; "" where there are none."""
    limit, end = study.options.prior.reach, study.options.fit.tolerance_deviations
    far = [study.nominal.parameters[k].name for k in np.flatnonzero(beyond_reach(study, point))]
    return ", ".join(f"{name} {limit / end:.0f} tolerances off" for name in far[:3])


def verdict_of(alarm: bool, answer_set: Sequence[FittedHypothesis], doubt: str = "") -> str:
    """The verdict on an answer set; `doubt` is why its cause may be another."""
    if not alarm:
        return NO_DISCREPANCY
    if not answer_set:
        return UNKNOWN
    return CAUSE if len(answer_set) == 1 and not doubt else AMBIGUOUS


def _none_stands(
    nominal: NominalFit,
    answer_set: Sequence[FittedHypothesis],
    found: Sequence[FittedHypothesis],
    recovered: RecoveredTerm | None,
    inadequate: bool,
    *,
    options: DiagnosisOptions,
) -> bool:
    """Whether none of an answer set stands: no fit comes near the records, or a term that nobody has listed explains
    more.
    """
    return inadequate or (
        recovered is not None and bool(answer_set) and term_explains_more(nominal, recovered, found, options=options)
    )


def term_explains_more(
    nominal: NominalFit, recovered: RecoveredTerm, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> bool:
    """Whether a term that nobody has listed explains more than the likeliest cause, and than its law may be off: so
    much that this is ruled out, rather than doubtful.
    """
    best = _least_left(found)
    may_err = best.law_may_leave(nominal.fit)
    bearable = best.bearable_share(nominal.fit) * (nominal.fit.chi_square - best.fit.chi_square)
    return gain_of_term(recovered, found) > max(options.selection.answer_ratio, may_err, bearable)


def gain_of_term(recovered: RecoveredTerm, found: Sequence[FittedHypothesis]) -> float:
    """What a term explains more than the likeliest cause, each for the penalty of its figures."""
    best = _least_left(found)
    penalty = recovered.freedom * np.log(best.fit.rows)
    return best.least_chi_square + best.occam_factor - recovered.chi_square - float(penalty)


def _least_left(found: Sequence[FittedHypothesis]) -> FittedHypothesis:
    return min(found, key=lambda one: one.least_chi_square + one.occam_factor)
