"""Given measured data: what the simulation gets wrong, its cause, the extended model and the gain on hold-out
records.

The order of work: fit the nominal model with its parameters inside their tolerances; test every candidate and every
free term against what is left; refit the few that could explain it, alone and in pairs; look again at what those
leave. A cause is named only where nothing else explains the data nearly as well and nothing is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from valvesim.diagnosis.advice import advice_on_causes, advice_on_unknown
from valvesim.diagnosis.answer_tables import (
    CHANNEL_UNITS,
    candidate_answers,
    detection_limits,
    error_table,
    parameter_shifts,
    score_table,
)
from valvesim.diagnosis.apart import odd_test
from valvesim.diagnosis.coarse_to_fine import fit_coarse_to_fine
from valvesim.diagnosis.detection import beyond_noise, is_certain, is_inadequate
from valvesim.diagnosis.experiment_design import design
from valvesim.diagnosis.extended_model import effect_files, scenario_text
from valvesim.diagnosis.holdout_gain import holdout_gain, traces_of
from valvesim.diagnosis.intervals import confidence_intervals
from valvesim.diagnosis.isolation import Isolation, isolate
from valvesim.diagnosis.missing_term import RecoveredTerm, recover_term
from valvesim.diagnosis.model_selection import FittedHypothesis, answer_set_width, null_hypothesis_beside
from valvesim.diagnosis.one_parameter_term import one_parameter_term
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS, DiagnosisOptions
from valvesim.diagnosis.result import (
    AMBIGUOUS,
    BENCH,
    CAUSE,
    MISREAD,
    NO_DISCREPANCY,
    OTHER_VALVE,
    RECORDS_APART,
    UNKNOWN,
    Diagnosis,
    NextTest,
    NoiseFound,
    Term,
    WhatToDo,
)
from valvesim.diagnosis.term_entry import as_catalogue_entry
from valvesim.diagnosis.wording import location_text, summary_text
from valvesim.identification.channel_check import MisreadChannels, misread_channels
from valvesim.identification.fit import Fit
from valvesim.identification.nominal_fit import NominalFit, within_tolerance
from valvesim.identification.self_oscillation import SelfOscillation, self_oscillation
from valvesim.identification.session import Session
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import Study, prepare_session


def diagnose(
    session: Session | str | Path,
    *,
    progress: Callable[[str, float], None] | None = None,
    options: DiagnosisOptions = DEFAULT_DIAGNOSIS,
) -> Diagnosis:
    """Diagnose a session, or the folder of one. `progress(stage, share)` is called with what is being done.

    The same session and seed give the same answer. Raises InputError for a session that cannot be used and SolveError
    where the nominal valve cannot be simulated under the session's inputs.
    """
    progress = progress or (lambda stage, share: None)
    progress("reading", 0.0)
    session = session if isinstance(session, Session) else load_session(session, options=options.identification)
    prepared = prepare_session(session, options=options.identification)
    if (oscillates := self_oscillation(prepared)) is not None:
        return _before_any_fit(oscillates, OTHER_VALVE, _oscillates(oscillates), options=options)
    if (misread := misread_channels(prepared)) is not None:
        return _before_any_fit(misread, MISREAD, "; ".join(misread.words), options=options)
    nominal, known = fit_coarse_to_fine(
        prepared, lambda stage, share: progress(stage, 0.05 + 0.25 * share), options=options
    )
    isolation = isolate(nominal, lambda stage, share: progress(stage, 0.3 + 0.6 * share), known, options=options)
    progress("measuring the gain", 0.9)
    return _answer(isolation)


FAR_OFF = "what fits these records best is not the stated valve nor a part that could take its place"
INADEQUATE = "the base model cannot come near these records: are they of this valve, with these units and signs?"


def _answer(isolation: Isolation) -> Diagnosis:
    nominal, scores, level, options = isolation.nominal, isolation.scores, isolation.level, isolation.scores.options
    study, session = nominal.study, nominal.study.session
    best, chosen, in_set, unknown_reason = _hypotheses(isolation, options=options)
    inadequate = is_inadequate(nominal, chosen, options=options)
    recovered: RecoveredTerm | None = None
    odd = ""
    if isolation.alarm and not (inadequate or isolation.is_other_valve) and (unknown_reason or not in_set):
        borne_out = bool(isolation.found) or is_certain(scores, level)
        excess = beyond_noise(nominal.fit, study, options=options) > 0.0
        odd = odd_test(nominal, options=options) if excess and not in_set else ""
        recovered = None if odd else recover_term(nominal, scores)
        slight = one_parameter_term(nominal, scores) if recovered is None and not odd else None
        if recovered is slight is None and not borne_out:  # no cause and no term explains what the score tests showed
            isolation = replace(isolation, alarm=False)
        if recovered is not None and (entry := as_catalogue_entry(isolation, recovered)) is not isolation:
            isolation, recovered = entry, None
            best, chosen, in_set, unknown_reason = _hypotheses(isolation, options=options)
        recovered = recovered or slight
    found = isolation.found
    if _none_stands(nominal, in_set, found, recovered, inadequate, options=options):
        in_set, unknown_reason = [], ""
    far = ""
    if isolation.alarm and not in_set:
        far = _far_off(study, recovered.point if recovered is not None else chosen.point)
        recovered = None if far else recovered
    errors = isolation.joint_errors
    doubt = unknown_reason
    if errors is not None and in_set:
        as_well = f"errors of the instruments explain it as well ({errors.words})"
        doubt = f"{unknown_reason}; {as_well}" if unknown_reason else as_well
    answers = candidate_answers(nominal, found, in_set, level, doubt, options=isolation.scores.options)
    verdict = verdict_of(isolation.alarm, in_set, doubt)
    term: Term | None = None
    notes = list(session.notes)
    if any(not noise.verified for noise in study.noise.values()):
        notes.append(
            "noise unverified: no repeats, so it was taken from what the model leaves; small effects may hide in it"
        )
    reason, because, bench = "", "", tuple(one.label for one in isolation.bench)
    if inadequate or (verdict == UNKNOWN and far):
        verdict, reason, because = UNKNOWN, OTHER_VALVE, INADEQUATE if inadequate else f"{FAR_OFF} ({far})"
    elif odd:
        reason, because = RECORDS_APART, f"these records do not belong together: {odd} alone is not as the others say"
    elif verdict == NO_DISCREPANCY and bench:
        reason, because = BENCH, "; ".join(bench)
    notes[:0] = [because] if because else []
    notes += [f"the bench, not the valve: {fault}" for fault in bench if fault not in because]
    if errors is not None and not in_set:
        notes.append(
            f"errors of the instruments explain {errors.explained:.0f} of the chi-square together, and none of them by "
            f"itself; with the fewest figures: {errors.words}; a cause may act like them: repeat a record with other "
            "instruments"
        )
    named = best if verdict in (CAUSE, AMBIGUOUS) else None
    unextended = nominal.fit.variant(study.nominal)
    variant, readings, point = unextended, nominal.fit.readings, nominal.fit.point
    if named is not None:
        variant, readings, point = chosen.variant(study.nominal), chosen.readings, chosen.point
        if unknown_reason and recovered is not None and _gain_of_term(recovered, found) > 0.0:
            term = recovered.term
    elif verdict == UNKNOWN and recovered is not None:
        term, variant, readings, point = recovered.term, recovered.variant, recovered.readings, recovered.point
    causes = tuple(c.name for c in best.candidates) if verdict == CAUSE and best is not None else ()
    estimates = confidence_intervals(nominal, isolation.final) if named is not None else ()
    before = nominal.fit if variant is unextended else within_tolerance(nominal)
    gain, claimed, offered, traces, failed = holdout_gain(
        nominal, before, variant, readings, options=isolation.scores.options
    )
    notes += failed
    if not offered and variant is not unextended:
        variant = before.variant(study.nominal)
        notes.append(
            "the locked records do not show that the extension helps: the scenario is that of the refitted base model"
        )
    todo: tuple[WhatToDo, ...] = ()
    if verdict in (CAUSE, AMBIGUOUS):
        todo = advice_on_causes(in_set, unknown_reason, or_instruments=errors is not None)
    elif verdict == UNKNOWN:
        todo = advice_on_unknown(reason, odd, term)
    next_test = None
    if verdict == AMBIGUOUS:
        others = [(other.label, other.fit) for other in in_set[1:]]
        if not others and term is not None and recovered is not None:
            others = [("none of the known causes", recovered.as_fit(study))]
        next_test = _propose_experiment(nominal, in_set[0], others, options=options)
    return Diagnosis(
        title=session.title,
        verdict=verdict,
        causes=causes,
        summary=summary_text(verdict, in_set, term, because, doubt),
        location=location_text(verdict, in_set),
        candidates=tuple(answers),
        parameters=estimates,
        gain=gain,
        gain_claimed=claimed,
        extension_offered=offered and variant is not unextended,
        detection_limits=detection_limits(scores, level),
        next_test=next_test,
        term=term,
        shifts=parameter_shifts(study, point),
        noise=_noise_found(study),
        scores=score_table(scores),
        alarm_level=level,
        errors=error_table(study, before),
        notes=tuple(notes),
        traces=traces,
        extended_scenario=scenario_text(session, variant, options=isolation.scores.options),
        extended_effects=effect_files(session, variant),
        extended_variant=variant,
        reason=reason,
        bench=bench,
        what_to_do=(*todo, *isolation.bench),
    )


def _oscillates(found: SelfOscillation) -> str:
    return (
        f"the stated valve oscillates by itself, at {found.frequency:.3g} Hz from rest, and the readings do not: are "
        "its figures right?"
    )


def _before_any_fit(
    found: SelfOscillation | MisreadChannels, reason: str, because: str, *, options: DiagnosisOptions
) -> Diagnosis:
    """What the stated valve tells by itself: nothing is fitted to the records."""
    study, stated, session = found.study, found.stated, found.study.session
    variant = stated.variant(study.nominal)
    reads = zip(study.predictors, stated.readings, strict=True)
    return Diagnosis(
        title=session.title,
        verdict=UNKNOWN,
        causes=(),
        summary=summary_text(UNKNOWN, (), None, because),
        location="",
        candidates=(),
        parameters=(),
        gain=(),
        gain_claimed=False,
        extension_offered=False,
        detection_limits=(),
        next_test=None,
        term=None,
        shifts=(),
        noise=_noise_found(study),
        scores=(),
        alarm_level=float("nan"),
        errors={},  # they are of a fit, and none was made
        notes=(because, *session.notes),
        traces=tuple(trace for one, read in reads for trace in traces_of(study, one.record, (read, read))),
        extended_scenario=scenario_text(session, variant, options=options),
        extended_effects=effect_files(session, variant),
        extended_variant=variant,
        reason=reason,
        what_to_do=advice_on_unknown(reason, "", None),
    )


def _noise_found(study: Study) -> tuple[NoiseFound, ...]:
    return tuple(
        NoiseFound(channel=channel, rate=rate, deviation=n.deviation, unit=CHANNEL_UNITS[channel],
                   order=len(n.lags), verified=n.verified, source=n.source)
        for (channel, rate), n in study.noise.items()
    )  # fmt: skip


def _hypotheses(
    isolation: Isolation, *, options: DiagnosisOptions
) -> tuple[FittedHypothesis | None, Fit, list[FittedHypothesis], str]:
    """The best hypothesis and its fit (the nominal one where there is none), the answer set, and why an unknown cause
    may be the cause too.
    """
    nominal, best = isolation.nominal, isolation.found[0] if isolation.found else None
    answer_set = [
        *isolation.answer_set,
        *null_hypothesis_beside(nominal, isolation.answer_set, isolation.level, options=options),
    ]
    return best, best.fit if best is not None else nominal.fit, answer_set, isolation.unknown_reason


def _far_off(study: Study, point: np.ndarray) -> str:
    """The figures that a point (p,) has off by as much as they may be, in words; "" where there are none."""
    limit, end = study.options.prior.reach, study.options.fit.tolerance_deviations
    far = [p.name for p, t in zip(study.nominal.parameters, point, strict=True) if abs(t) > (1.0 - 1e-6) * limit]
    return ", ".join(f"{name} {limit / end:.0f} tolerances off" for name in far[:3])


def verdict_of(alarm: bool, in_set: Sequence[FittedHypothesis], unknown_reason: str = "") -> str:
    if not alarm:
        return NO_DISCREPANCY
    if not in_set:
        return UNKNOWN
    return CAUSE if len(in_set) == 1 and not unknown_reason else AMBIGUOUS


def _none_stands(
    nominal: NominalFit,
    in_set: Sequence[FittedHypothesis],
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
        recovered is not None and bool(in_set) and _term_explains_more(nominal, recovered, found, options=options)
    )


def _term_explains_more(
    nominal: NominalFit, recovered: RecoveredTerm, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> bool:
    """Whether a term that nobody has listed explains more than the likeliest cause, and than its law may be off."""
    best = _least_left(found)
    law_error = best.law_error * (nominal.fit.chi_square - best.fit.chi_square)
    return _gain_of_term(recovered, found) > max(options.selection.answer_ratio, law_error)


def _gain_of_term(recovered: RecoveredTerm, found: Sequence[FittedHypothesis]) -> float:
    """What a term explains more than the likeliest cause, each for the penalty of its figures."""
    best = _least_left(found)
    penalty = recovered.freedom * np.log(best.fit.rows)
    return best.least_chi_square + best.fit.occam_factor - recovered.chi_square - float(penalty)


def _least_left(found: Sequence[FittedHypothesis]) -> FittedHypothesis:
    return min(found, key=lambda one: one.least_chi_square + one.fit.occam_factor)


def _propose_experiment(
    nominal: NominalFit, first: FittedHypothesis, others: Sequence[tuple[str, Fit]], *, options: DiagnosisOptions
) -> NextTest | None:
    """The test that tells the likeliest from the next of the others, by label, or where none does so surely, from the
    one after it.
    """
    tests = (
        design(
            nominal,
            first.fit,
            other,
            (first.label, label),
            lambda more: answer_set_width(nominal, first, more),
            options=options,
        )
        for label, other in others[: options.design.alternatives]
    )
    best: NextTest | None = None
    for test in tests:
        if test is not None and (best is None or test.power > best.power):
            best = test
        if best is not None and best.power >= options.design.least_power:
            break
    return best
