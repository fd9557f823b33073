"""What a choice of tests and sensors would show: detection limits, isolability, and how well parameters are known.

The tests of the diagnosis itself at a residual of zero: the same projection off the nuisance parameters, the same
alarm level, the same difference that tells two hypotheses apart.

Symbols
    J, S whitened sensitivities (`projection`), H = J'J + I;  covariance of the parameters H^-1 (prior deviation 1)
    d' of cause i: |s~_i|;  of i beside its rival j: |s~_i off s~_j|
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.power import (
    NINETEEN_IN_TWENTY,
    asked_difference,
    detected_amplitude,
    detection_power,
    naming_level,
    separated_share,
    separation_power,
)
from valvesim.identification.candidates import Candidate
from valvesim.identification.projection import (
    GramMatrix,
    ProjectedScores,
    alarm_level,
    inverse_of,
    largest_by_chance,
    project,
)
from valvesim.planning.bench import Aim
from valvesim.planning.options import DEFAULT_PLANNING, OutlookOptions, PlanningOptions
from valvesim.planning.sensitivities import PlannedSensitivities


@dataclass(frozen=True, kw_only=True)
class CauseOutlook:
    """What is to be expected of a cause, in SI above neutral.

    `limit` is the amplitude that passes the alarm nine times in ten (None where none within reach does), `power` how
    surely `size` does; `isolated` the amplitude from which it is named nine times in ten, and neither another cause of
    the aim nor noise beside it, `rival` the hardest of these; `nearest` the hardest of all that a diagnosis looks for,
    told from it from `nearest_isolated` on. `shape` are the shape parameters at which it shows most, and for which all
    this holds.
    """

    label: str
    shape: tuple[tuple[str, float], ...]
    location: str
    parameter: str
    unit: str
    size: float
    limit: float | None
    power: float
    isolated: float | None
    rival: str
    nearest: str
    nearest_isolated: float | None


@dataclass(frozen=True, kw_only=True)
class ParameterOutlook:
    """How well a parameter of the valve would be known: `prior` and `posterior` standard deviation, SI.

    `verdict` is "known" (to half its prior), "partly", "together" (only together with `partners`), "hardly"
    (practically unidentifiable: its prior is all that is known), or, structurally unidentifiable whatever the noise,
    "combination" (others together do the same to every reading, so that priors alone tell them apart) and "unseen" (it
    changes no reading).
    """

    name: str
    unit: str
    nominal: float
    prior: float
    posterior: float
    verdict: str
    partners: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outlook:
    """What a choice of tests and sensors would show: `powers` (k, k) is how surely cause k (row) at its size is told
    from another (column), NaN where they are two names of one thing; `level` is the z of the alarm.
    """

    causes: tuple[CauseOutlook, ...]
    powers: np.ndarray
    parameters: tuple[ParameterOutlook, ...]
    level: float


def outlook(
    planned: PlannedSensitivities,
    aim: Aim,
    repeats: Sequence[int],
    channels: Sequence[str],
    *,
    options: PlanningOptions = DEFAULT_PLANNING,
    seed: int = 0,
) -> Outlook:
    """What so many repeats of each test, read on these channels, would show."""
    gram = planned.gram(repeats, channels)
    scores = project(gram, 0, len(planned.candidates))
    level = level_of(planned, scores, options=options.diagnosis, seed=seed)
    groups = cause_groups(planned.candidates)
    sought = sought_causes(planned, aim)
    judged = CandidateScores(planned, scores, level, options)
    members = [min(groups[label], key=judged.limit) for label in sought]
    sizes = [cause_size(planned.candidates[k], aim) for k in members]
    powers = np.array([
        [judged.separation(k, groups[other], size) if other != label else np.nan for other in sought]
        for label, k, size in zip(sought, members, sizes, strict=True)
    ]).reshape(len(sought), len(sought))  # fmt: skip
    causes = tuple(
        _cause(judged, groups, sought, label, k, size) for label, k, size in zip(sought, members, sizes, strict=True)
    )
    parameters = parameter_outlooks(planned, gram, options=options.outlook)
    return Outlook(causes=causes, powers=powers, parameters=parameters, level=level)


@dataclass(frozen=True, eq=False)
class CandidateScores:
    """The candidates off the nuisance parameters under one choice, by index."""

    planned: PlannedSensitivities
    scores: ProjectedScores
    level: float
    options: PlanningOptions

    def limit(self, k: int) -> float:
        """The amplitude of a candidate that is detected nine times in ten, SI; infinite beyond its reach."""
        candidate = self.planned.candidates[k]
        limit = detected_amplitude(float(self.scores.distance[k]), float(self.planned.sizes[k]), self.level)
        reach = min(self.options.diagnosis.detection.reach * candidate.typical, max(map(abs, candidate.limits)))
        return limit if limit <= reach else np.inf

    def power(self, k: int, size: float) -> float:
        """How surely a candidate of that size passes the alarm."""
        return detection_power(self._distance(k, size), self.level)

    def separation(self, k: int, rivals: Sequence[int], size: float) -> float:
        """How surely candidate k of that size is told from a rival in all its shapes; NaN for two names of one."""
        if self._same(k, rivals):
            return np.nan
        distance, left = self._distance(k, size), self._left(k, rivals) * size / abs(float(self.planned.sizes[k]))
        asked = asked_difference(distance**2, self._law_error(k), options=self.options.diagnosis.selection)
        return separation_power(left, asked)

    def named(self, k: int) -> float:
        """The amplitude of a candidate from which noise alone does not explain it nineteen times in twenty, SI."""
        level = naming_level(self.level, options=self.options.diagnosis.selection)
        size, distance = float(self.planned.sizes[k]), float(self.scores.distance[k])
        return detected_amplitude(distance, size, level, NINETEEN_IN_TWENTY)

    def isolated(self, k: int, rivals: Sequence[int]) -> float:
        """The amplitude from which candidate k is told from a rival nineteen times in twenty, SI."""
        whole, left = float(self.scores.distance[k]), self._left(k, rivals)
        selection = self.options.diagnosis.selection
        share = separated_share(whole, left, self._law_error(k), NINETEEN_IN_TWENTY, options=selection)
        return share * abs(float(self.planned.sizes[k]))

    def _same(self, k: int, rivals: Sequence[int]) -> bool:
        own = self.planned.candidates[k]
        return any(own.is_equivalent_to(self.planned.candidates[j]) for j in rivals)

    def _distance(self, k: int, size: float) -> float:
        return float(self.scores.distance[k]) * size / abs(float(self.planned.sizes[k]))

    def _left(self, k: int, rivals: Sequence[int]) -> float:
        """The distance of candidate k at its own size that a rival leaves, free in amplitude and among its shapes."""
        S, J = self.scores.overlap, list(rivals)
        own = self.planned.candidates[k]
        if len(J) == 1 and own.one_sided and self.planned.candidates[J[0]].one_sided and S[k, J[0]] < 0.0:
            return float(self.scores.distance[k])
        inverse = np.linalg.pinv(S[np.ix_(J, J)], rcond=1e-9, hermitian=True)
        left = float(S[k, k] - S[k, J] @ inverse @ S[J, k])
        return float(np.sqrt(left)) if left > self.options.outlook.combination_share**2 * S[k, k] else 0.0

    def _law_error(self, k: int) -> float:
        effect = self.planned.candidates[k].effect
        return effect.law_error if effect is not None else 0.0


def level_of(
    planned: PlannedSensitivities, scores: ProjectedScores, *, options: DiagnosisOptions, seed: int = 0
) -> float:
    """The z of the alarm: what the best of all visible candidates passes by chance as rarely as the diagnosis asks."""
    q = len(planned.candidates)
    reach = np.array([min(options.detection.reach * c.typical, max(map(abs, c.limits))) for c in planned.candidates])
    seen = np.flatnonzero(scores.distance[:q] * reach / np.abs(planned.sizes) > 4.0)
    some = ProjectedScores(scores.score[seen], scores.overlap[np.ix_(seen, seen)], 0.0)
    one_sided = np.array([planned.candidates[k].one_sided for k in seen], dtype=bool)
    largest = largest_by_chance(some, one_sided, seed, options.detection.draws)
    level = alarm_level(largest, options.detection.false_alarm)
    return level if np.isfinite(level) else 4.0


def cause_groups(candidates: Sequence[Candidate]) -> dict[str, list[int]]:
    """The candidates of each label: one cause in the shapes in which it is looked for."""
    groups: dict[str, list[int]] = {}
    for k, candidate in enumerate(candidates):
        groups.setdefault(candidate.label, []).append(k)
    return groups


def sought_causes(planned: PlannedSensitivities, aim: Aim) -> tuple[str, ...]:
    """The labels that an aim asks for: by name or label; all effects on the valve where it names none."""
    every = dict.fromkeys(c.label for c in planned.candidates if c.effect is not None)
    if not aim.causes:
        on_valve = (c.label for c in planned.candidates if c.effect is not None and not c.effect.channel)
        return tuple(dict.fromkeys(on_valve))
    names = {c.label: c.name for c in planned.candidates}
    return tuple(label for label in every if label in aim.causes or names[label] in aim.causes)


def cause_size(candidate: Candidate, aim: Aim) -> float:
    """The size at which a cause is to be found, above neutral, SI."""
    return aim.sizes.get(candidate.label, aim.sizes.get(candidate.name, candidate.typical))


def _cause(
    judged: CandidateScores, groups: dict[str, list[int]], sought: Sequence[str], label: str, k: int, size: float
) -> CauseOutlook:
    candidate = judged.planned.candidates[k]
    others = {other: judged.isolated(k, groups[other]) for other in groups
              if other != label and not judged._same(k, groups[other])}  # fmt: skip
    aimed = {other: value for other, value in others.items() if other in sought}
    rival = max(aimed, key=lambda other: aimed[other], default="")
    nearest = max(others, key=lambda other: others[other], default="")
    limit, named, reach = judged.limit(k), judged.named(k), max(map(abs, candidate.limits))

    def within(value: float) -> float | None:
        """None beyond what the cause may have."""
        return value if value <= reach else None

    assert candidate.effect is not None  # noqa: S101 - causes of an aim are effects
    fitted = {p.name for p in candidate.shapes()}
    return CauseOutlook(
        label=label, shape=tuple((name, value) for name, value in candidate.fixed if name in fitted),
        location=candidate.location(), parameter=candidate.effect.amplitude.name, unit=candidate.unit,
        size=size, limit=limit if np.isfinite(limit) else None, power=judged.power(k, size),
        isolated=within(max(aimed[rival], named)) if rival else within(named), rival=rival, nearest=nearest,
        nearest_isolated=within(max(others[nearest], named)) if nearest else within(named),
    )  # fmt: skip


def parameter_outlooks(
    planned: PlannedSensitivities, gram: GramMatrix, *, options: OutlookOptions
) -> tuple[ParameterOutlook, ...]:
    """How well each parameter of the valve would be known, by the Fisher information with the priors."""
    p = gram.parameters
    G = gram.total[1 : 1 + p, 1 : 1 + p]
    covariance = inverse_of(G + np.eye(p))
    deviation = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    correlation = covariance / np.outer(deviation, deviation)
    names = [parameter.name for parameter in planned.nominal.parameters]
    alone = _left_alone(G, options.combination_share)
    found = []
    for k, parameter in enumerate(planned.nominal.parameters):
        if parameter.sensor is not None:
            continue
        partners = tuple(
            names[j] for j in np.argsort(-np.abs(correlation[k])) if j != k and abs(correlation[k, j]) > options.partner
        )
        verdict = "known"
        if G[k, k] < options.unseen_distance**2:
            verdict = "unseen"
        elif alone[k] <= options.combination_share:
            verdict = "combination"
        elif deviation[k] > options.hardly:
            verdict = "hardly"
        elif deviation[k] > options.known:
            verdict = "together" if partners else "partly"
        found.append(
            ParameterOutlook(
                name=parameter.name, unit=parameter.unit, nominal=parameter.nominal, prior=parameter.deviation,
                posterior=float(min(deviation[k], 1.0) * parameter.deviation), verdict=verdict, partners=partners[:3],
            )
        )  # fmt: skip
    return tuple(found)


def _left_alone(G: np.ndarray, combination_share: float) -> np.ndarray:
    """The share of each column's size that all others leave of it, without priors (p,); 0 for a column of zeros."""
    size = np.sqrt(np.maximum(np.diag(G), 0.0))
    seen = size > 0.0
    left = np.zeros(len(G))
    C = G[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    least = 0.01 * combination_share**2  # so that columns that are combinations of others leave next to nothing
    left[seen] = np.sqrt(1.0 / np.diag(np.linalg.inv(C + least * np.eye(len(C)))))
    return left
