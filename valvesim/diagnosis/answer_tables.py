"""The tables of an answer: hypotheses with probabilities, detection limits, shifts, scores, errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS, STATE_CHANNELS
from valvesim.diagnosis.model_selection import (
    FittedHypothesis,
    answer_set_width,
    odds_against_noise,
    rarity_penalty,
    temperature_of,
    tempered_deviances,
)
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.power import detected_amplitude
from valvesim.diagnosis.result import CandidateAnswer, DetectionLimit, Score, Shift
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.study import Study

CHANNEL_UNITS = {channel.name: channel.unit for channel in (*STATE_CHANNELS, *SIGNAL_CHANNELS)}


def candidate_answers(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    in_set: Sequence[FittedHypothesis],
    level: float,
    unknown_reason: str = "",
    second_level: float = np.inf,
    *,
    options: DiagnosisOptions,
) -> list[CandidateAnswer]:
    """All hypotheses with their probabilities, likeliest first; beside them what is in no catalogue, and chance.

    `unknown_reason` tells why what is in no catalogue belongs to the answer set, if it does; `second_level` is the z
    that a second cause must pass.
    """
    if not found:
        return []
    width, temperature = answer_set_width(nominal, found[0]), temperature_of(nominal, found[0])
    known = tempered_deviances(nominal, found, second_level)
    unknown = known[0] + (options.selection.unknown_penalty * temperature if in_set else -2.0 * width)
    if unknown_reason:
        unknown = known[0] + 2.0 * temperature
    values = np.array([*known, known[0] + odds_against_noise(nominal, found[0], level), unknown])
    weights = np.exp(-0.5 * (values - values.min()) / temperature)
    weights /= weights.sum()
    members = {one.label for one in in_set}
    answers = [
        CandidateAnswer(
            names=tuple(c.name for c in one.candidates),
            label=one.label,
            location=" and ".join(dict.fromkeys(c.location() for c in one.candidates)),
            probability=float(weight),
            deviance_fall=float(nominal.fit.chi_square - one.fit.chi_square),
            in_set=one.label in members,
        )
        for one, weight in zip([*found, FittedHypothesis(nominal.fit, options=options)], weights[:-1], strict=True)
    ]
    nothing = _unknown(float(weights[-1]), not in_set or bool(unknown_reason))
    ranked = sorted([*answers, nothing], key=lambda a: -a.probability)
    return [a for a in ranked if a.in_set or a.probability > 1e-3]


def probability_of_both(
    answers: Sequence[CandidateAnswer],
    in_set: Sequence[FittedHypothesis],
    first: FittedHypothesis,
    other: FittedHypothesis,
) -> float:
    """The probability by the `answers` that two hypotheses of a set are true together, where one of them is or both
    are: that of what holds the two.
    """
    held = {one.label for one in in_set if first.is_within(one) and other.is_within(one)}
    both = sum(answer.probability for answer in answers if answer.label in held)
    either = sum(answer.probability for answer in answers if answer.label in (first.label, other.label))
    return both / (both + either)


def candidates_by_prior(candidates: Sequence[Candidate], *, options: DiagnosisOptions) -> list[CandidateAnswer]:
    """Candidates that may be the cause, none of them fitted: their probabilities are those before any record, likeliest
    first, beside what is in no catalogue.
    """
    penalties = np.array([*(rarity_penalty(c, options=options) for c in candidates), options.selection.unknown_penalty])
    weights = np.exp(-0.5 * penalties) / np.exp(-0.5 * penalties).sum()
    answers = [
        CandidateAnswer(
            names=(c.name,), label=c.label, location=c.location(), probability=float(weight), deviance_fall=np.nan
        )
        for c, weight in zip(candidates, weights[:-1], strict=True)
    ]
    return sorted([*answers, _unknown(float(weights[-1]), True)], key=lambda answer: -answer.probability)


def _unknown(probability: float, in_set: bool) -> CandidateAnswer:
    """What is in no catalogue, as an answer."""
    return CandidateAnswer(
        names=("unknown",),
        label="none of the known causes",
        location="",
        deviance_fall=0.0,
        probability=probability,
        in_set=in_set,
    )


def detection_limits(scores: ScoreTest, level: float) -> tuple[DetectionLimit, ...]:
    """For each candidate, the amplitude that would pass the alarm nine times in ten."""
    best: dict[str, DetectionLimit] = {}
    distance = scores.projected.distance
    visible = scores.visible()
    for k, candidate in enumerate(scores.candidates):
        name = candidate.effect.amplitude.name if candidate.effect is not None else candidate.name.partition(":")[2]
        amplitude = None
        if visible[k]:
            amplitude = detected_amplitude(float(distance[k]), float(scores.sizes[k]), level)
        one = DetectionLimit(
            name=candidate.name, label=candidate.label, parameter=name, amplitude=amplitude, unit=candidate.unit
        )
        old = best.get(candidate.label)
        if old is None or old.amplitude is None or (amplitude is not None and amplitude < old.amplitude):
            best[candidate.label] = one
    return tuple(best.values())


def parameter_shifts(study: Study, point: np.ndarray) -> tuple[Shift, ...]:
    shifts = [
        Shift(
            name=p.name,
            unit=p.unit,
            nominal=p.nominal,
            value=p.at(t),
            share_of_tolerance=float(t / 2.0),
        )
        for p, t in zip(study.nominal.parameters, point, strict=True)
    ]
    return tuple(sorted(shifts, key=lambda s: -abs(s.share_of_tolerance)))


def score_table(scores: ScoreTest, most: int = 15) -> tuple[Score, ...]:
    z = scores.z()
    best: dict[str, float] = {}
    for candidate, value in zip(scores.candidates, z, strict=True):
        best[candidate.label] = max(best.get(candidate.label, 0.0), float(value))
    ranked = sorted(best.items(), key=lambda pair: -pair[1])
    return tuple(Score(label=label, z=value) for label, value in ranked[:most])


def error_table(study: Study, before: Fit) -> dict[str, dict[str, float]]:
    table: dict[str, dict[str, float]] = {}
    for predictor, read in zip(study.predictors, before.readings, strict=True):
        record = predictor.record
        table[record.name] = {}
        for name in record.outputs:
            left = (record.values[name] - read[name])[record.usable[name]]
            deviation = study.noise[name, record.pace].deviation
            table[record.name][name] = float(np.sqrt(np.mean(left**2)) / deviation)
    return table
