"""Given measured data: what the simulation gets wrong, its cause, the extended model and the gain on hold-out
records.

The order of work: fit the nominal model with its parameters inside their tolerances; test every candidate and every
free term against what is left; refit the few that could explain it, alone and in pairs; look again at what those
leave. A cause is named only where nothing else explains the data nearly as well and nothing is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from valvesim.diagnosis.advice import advice_on_causes, advice_on_oscillation, advice_on_unknown
from valvesim.diagnosis.answer_tables import (
    CHANNEL_UNITS,
    candidate_answers,
    candidates_by_prior,
    detection_limits,
    error_table,
    parameter_shifts,
    probability_of_both,
    score_table,
)
from valvesim.diagnosis.coarse_to_fine import fit_coarse_to_fine
from valvesim.diagnosis.conclusion import Conclusion, conclude, gain_of_term
from valvesim.diagnosis.experiment_design import (
    Rival,
    design,
    explained_by_refits,
    nested_rival,
    rival_beside,
    simulate_library,
)
from valvesim.diagnosis.extended_model import effect_files, scenario_text
from valvesim.diagnosis.holdout_gain import holdout_gain, traces_of
from valvesim.diagnosis.intervals import confidence_intervals
from valvesim.diagnosis.isolation import Isolation, isolate
from valvesim.diagnosis.model_selection import (
    FittedHypothesis,
    answer_set_width,
    nested_levels,
    temperature_of,
    width_beside,
)
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS, DiagnosisOptions
from valvesim.diagnosis.result import (
    AMBIGUOUS,
    CAUSE,
    CHANNEL_APART,
    MISREAD,
    OSCILLATES,
    OTHER_VALVE,
    UNKNOWN,
    CandidateAnswer,
    Diagnosis,
    Gain,
    NextTest,
    NoiseFound,
    Term,
    Trace,
    WhatToDo,
)
from valvesim.diagnosis.wording import location_text, oscillation_words, summary_text
from valvesim.identification.channel_check import MisreadChannels, misread_channels
from valvesim.identification.fit import Fit
from valvesim.identification.measured_oscillation import MeasuredOscillation, measured_oscillation
from valvesim.identification.nominal_fit import NominalFit, within_tolerance
from valvesim.identification.predictor import ModelVariant
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
    if (measured := measured_oscillation(prepared, progress)) is not None:
        return _oscillating(measured, options=options)
    if (misread := misread_channels(prepared)) is not None:
        return _before_any_fit(misread, MISREAD, "; ".join(misread.words), options=options)
    nominal, known = fit_coarse_to_fine(
        prepared, lambda stage, share: progress(stage, 0.05 + 0.25 * share), options=options
    )
    isolation = isolate(nominal, lambda stage, share: progress(stage, 0.3 + 0.6 * share), known, options=options)
    progress("measuring the gain", 0.9)
    return _answer(isolation)


@dataclass(frozen=True, eq=False)
class _Extension:
    """What a conclusion makes of the model: the `variant` that is offered or else the nominal one, its `point` and the
    missing `term` in it, and its gain on the hold-out records over the nominal model's readings `before`; `notes` tell
    what went wrong with it.
    """

    variant: ModelVariant
    point: np.ndarray
    term: Term | None
    before: Fit
    gain: tuple[Gain, ...]
    is_claimed: bool
    is_offered: bool
    traces: tuple[Trace, ...]
    notes: tuple[str, ...]


def _answer(isolation: Isolation) -> Diagnosis:
    conclusion = conclude(isolation)
    isolation, level = conclusion.isolation, conclusion.isolation.level
    study, options = conclusion.nominal.study, isolation.scores.options
    session, verdict = study.session, conclusion.verdict
    extension = _extended(conclusion)
    best, answer_set, bench = conclusion.best, conclusion.answer_set, isolation.bench
    errors = isolation.joint_errors.words if isolation.joint_errors is not None else ""
    second = isolation.second_level
    candidates = candidate_answers(
        isolation.nominal, isolation.found, answer_set, level, conclusion.doubt, second, options=options
    )
    return Diagnosis(
        title=session.title,
        verdict=verdict,
        causes=tuple(c.name for c in best.candidates) if verdict == CAUSE and best is not None else (),
        summary=summary_text(verdict, answer_set, extension.term, conclusion.because, conclusion.doubt, errors),
        location=location_text(verdict, answer_set),
        candidates=tuple(candidates),
        parameters=confidence_intervals(isolation.nominal, isolation.final) if conclusion.is_named else (),
        gain=extension.gain,
        gain_claimed=extension.is_claimed,
        extension_offered=extension.is_offered,
        detection_limits=detection_limits(isolation.scores, level),
        next_test=_next_test(conclusion, candidates, extension.term),
        term=extension.term,
        shifts=parameter_shifts(study, extension.point),
        noise=_noise_found(study),
        scores=score_table(isolation.scores),
        alarm_level=level,
        errors=error_table(study, extension.before),
        notes=(*_notes(conclusion), *extension.notes),
        traces=extension.traces,
        extended_scenario=scenario_text(session, extension.variant, options=options),
        extended_effects=effect_files(session, extension.variant),
        extended_variant=extension.variant,
        reason=conclusion.reason,
        bench=tuple(one.label for one in bench),
        what_to_do=(*_what_to_do(conclusion, extension.term), *bench),
    )


def _extended(conclusion: Conclusion) -> _Extension:
    """The model that a conclusion extends, tried on the hold-out records."""
    isolation, recovered = conclusion.isolation, conclusion.recovered
    nominal, study = conclusion.nominal, conclusion.nominal.study
    unextended, term = nominal.fit.variant(study.nominal), None
    variant, readings, point = unextended, nominal.fit.readings, nominal.fit.point
    if conclusion.is_named:
        fit = conclusion.fit
        variant, readings, point = fit.variant(study.nominal), fit.readings, fit.point
        if conclusion.unknown_reason and recovered is not None and gain_of_term(recovered, isolation.found) > 0.0:
            term = recovered.term
    elif conclusion.verdict == UNKNOWN and recovered is not None:
        term, variant, readings, point = recovered.term, recovered.variant, recovered.readings, recovered.point
    before = nominal.fit if variant is unextended else within_tolerance(nominal)
    gain, claimed, offered, traces, failed = holdout_gain(
        nominal, before, variant, readings, options=isolation.scores.options
    )
    notes, why = list(failed), ""
    if conclusion.is_named and not all(one.candidates for one in conclusion.answer_set):
        offered, why = False, "noise alone may show it"
    elif not offered:
        why = "the locked records do not show that the extension helps"
    if why and variant is not unextended:
        variant = before.variant(study.nominal)
        notes.append(f"{why}: the scenario is that of the refitted base model")
    offered = offered and variant is not unextended
    return _Extension(variant, point, term, before, gain, claimed, offered, traces, tuple(notes))


def _notes(conclusion: Conclusion) -> list[str]:
    """What to know beside the answer: of the records, the noise, the bench and its instruments."""
    isolation, because = conclusion.isolation, conclusion.because
    study = conclusion.nominal.study
    notes = [because] if because else []
    if conclusion.verdict == UNKNOWN and isolation.channel is not None and conclusion.reason != CHANNEL_APART:
        notes.append(isolation.channel.words)
    notes += study.session.notes
    if any(not noise.verified for noise in study.noise.values()):
        notes.append(
            "noise unverified: no repeats, so it was taken from what the model leaves; small effects may hide in it"
        )
    notes += _notes_on_noise(study, isolation.scores.options)
    notes += [f"the bench, not the valve: {one.label}" for one in isolation.bench if one.label not in because]
    errors = isolation.joint_errors
    if errors is not None and not conclusion.answer_set:
        notes.append(
            f"errors of the instruments explain {errors.explained:.0f} of the chi-square together, and none of them by "
            f"itself; with the fewest figures: {errors.words}; a cause may act like them: repeat a record with other "
            "instruments"
        )
    return notes


def _what_to_do(conclusion: Conclusion, term: Term | None) -> tuple[WhatToDo, ...]:
    if conclusion.is_named:
        errors = conclusion.isolation.joint_errors
        return advice_on_causes(conclusion.answer_set, conclusion.unknown_reason, or_instruments=errors is not None)
    if conclusion.verdict == UNKNOWN:
        return advice_on_unknown(conclusion.reason, conclusion.odd, term)
    return ()


def _next_test(
    conclusion: Conclusion, candidates: Sequence[CandidateAnswer], term: Term | None
) -> NextTest | None:
    """The test that tells the answer set apart, or its one cause from the term that may stand in its place; the
    `candidates` are its answers, with their probabilities.
    """
    if conclusion.verdict != AMBIGUOUS:
        return None
    nominal, recovered = conclusion.isolation.nominal, conclusion.recovered
    options = conclusion.isolation.scores.options
    first, *rest = conclusion.answer_set
    rivals = [_rival(conclusion, candidates, first, other) for other in rest]
    if not rivals and term is not None and recovered is not None:
        fit = recovered.as_fit(nominal.study)

        def asked(more: float) -> float:
            return answer_set_width(nominal, first, more)

        rivals = [rival_beside(first.fit, "none of the known causes", fit, asked, options=options)]
    return _propose_experiment(nominal, first, rivals, options=options)


def _rival(
    conclusion: Conclusion,
    candidates: Sequence[CandidateAnswer],
    first: FittedHypothesis,
    other: FittedHypothesis,
) -> Rival:
    """Another hypothesis of the answer set as a rival of the likeliest."""
    isolation = conclusion.isolation
    nominal = isolation.nominal
    is_larger, temperature = other.holds(first), temperature_of(nominal, first)
    if not is_larger and not first.holds(other):
        return rival_beside(
            first.fit,
            other.label,
            other.fit,
            lambda more: width_beside(nominal, first, other, more),
            other.tempered(temperature) - first.tempered(temperature),
            probability_of_both(candidates, conclusion.answer_set, first, other),
            options=isolation.scores.options,
        )
    smaller, larger = (first, other) if is_larger else (other, first)
    return nested_rival(
        first.fit,
        other.label,
        other.fit,
        lambda more: nested_levels(nominal, smaller, larger, isolation.level, isolation.second_level, more),
        is_larger=is_larger,
    )


def _oscillates(found: SelfOscillation) -> str:
    return (
        f"the stated valve oscillates by itself, at {found.frequency:.3g} Hz from rest, and the readings do not: are "
        "its figures right?"
    )


def _oscillating(found: MeasuredOscillation, *, options: DiagnosisOptions) -> Diagnosis:
    """What may have a measured valve oscillate by itself: an answer set of causes, none of which was fitted."""
    causes = [onset.candidate for onset in found.onsets]
    because, *more = oscillation_words(found)
    answer = _before_any_fit(found, OSCILLATES, because, more, advice_on_oscillation(causes), options=options)
    if not causes:
        return answer
    candidates = candidates_by_prior(causes, options=options)
    return replace(
        answer,
        verdict=AMBIGUOUS,
        summary=f"{because[0].upper()}{because[1:]}.",
        location=" or ".join(dict.fromkeys(one.location for one in candidates if one.location)),
        candidates=tuple(candidates),
    )


def _before_any_fit(
    found: SelfOscillation | MeasuredOscillation | MisreadChannels,
    reason: str,
    because: str,
    more: Sequence[str] = (),
    advice: tuple[WhatToDo, ...] = (),
    *,
    options: DiagnosisOptions,
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
        notes=(because, *more, *session.notes),
        traces=tuple(trace for one, read in reads for trace in traces_of(study, one.record, (read, read))),
        extended_scenario=scenario_text(session, variant, options=options),
        extended_effects=effect_files(session, variant),
        extended_variant=variant,
        reason=reason,
        what_to_do=advice or advice_on_unknown(reason, "", None),
    )


def _notes_on_noise(study: Study, options: DiagnosisOptions) -> list[str]:
    """On the channels whose noise no repeats tell, and which leave far more than is stated of them."""
    notes = []
    for (channel, _), noise in study.noise.items():
        stated = study.session.sensors[channel].noise if channel in study.session.sensors else None
        if not noise.verified and stated and noise.deviation > options.detection.stated_ratio * stated:
            notes.append(
                f"{channel}: what the model leaves is {noise.deviation / stated:.2g} times the stated noise, and "
                "without repeats it counts as noise all the same: what is wrong may hide in it; repeat a test"
            )
    return notes


def _noise_found(study: Study) -> tuple[NoiseFound, ...]:
    return tuple(
        NoiseFound(channel=channel, rate=rate, deviation=n.deviation, unit=CHANNEL_UNITS[channel],
                   order=len(n.lags), verified=n.verified, source=n.source)
        for (channel, rate), n in study.noise.items()
    )  # fmt: skip


def _propose_experiment(
    nominal: NominalFit, first: FittedHypothesis, rivals: Sequence[Rival], *, options: DiagnosisOptions
) -> NextTest | None:
    """The test that tells the likeliest from the next of its rivals, or where none does so surely, from the one after
    it.
    """
    trials, explained = simulate_library(nominal, first.fit, options=options), explained_by_refits(nominal)
    best: NextTest | None = None
    for rival in rivals[: options.design.alternatives]:
        test = design(nominal, trials, first.label, rival, explained, options=options)
        if test is not None and (best is None or test.power > best.power):
            best = test
        if best is not None and best.power >= options.design.least_power:
            break
    return best
