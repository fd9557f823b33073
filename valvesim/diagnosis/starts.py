"""Where refits start: the likeliest candidates alone and in pairs, by the score test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from itertools import zip_longest

import numpy as np

from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import FittedCandidate, with_shapes
from valvesim.identification.hypothesis_fit import reductions_from_prior
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.projection import ProjectedScores


def start_points(scores: ScoreTest, failed: Set[str]) -> list[tuple[FittedCandidate, ...]]:
    """Where to start refits: the best single candidates, the same lag or delay of all sensors, and the best pairs where
    two explain much more than one.

    Families that have `failed` are left out.
    """
    fall = np.where([c.label in failed for c in scores.candidates], 0.0, scores.z() ** 2)
    singles = single_starts(scores, fall, scores.options.isolation.single_share)
    if not singles:
        return []
    common = _common_starts(scores, fall, failed)
    pairs = [one for one in _pair_starts(scores, fall, failed) if _labels(one) not in map(_labels, common)]
    return [*singles, *common, *pairs]


def _labels(start: Sequence[FittedCandidate]) -> list[str]:
    return sorted(member.candidate.label for member in start)


def single_starts(scores: ScoreTest, fall: np.ndarray, share: float) -> list[tuple[FittedCandidate, ...]]:
    """The best single candidates by the fall (q,) of the chi-square, those near that share of the largest."""
    likeliest = best_of_labels(scores, fall, share * fall.max(initial=0.0) - 10.0)[: scores.options.isolation.singles]
    return [(linear_amplitude(scores, k),) for k in likeliest]


def best_of_labels(scores: ScoreTest, value: np.ndarray, least: float) -> list[int]:
    """The candidates, one of each label, whose value (q,) is positive and no lower than `least_chi_square`; largest
    first.
    """
    best: dict[str, int] = {}
    for k in map(int, np.argsort(-value, kind="stable")):
        if value[k] > 0.0 and value[k] >= least:
            best.setdefault(scores.candidates[k].label, k)
    return list(best.values())


def _common_starts(scores: ScoreTest, fall: np.ndarray, failed: Set[str]) -> list[tuple[FittedCandidate, ...]]:
    """The same lag, and the same delay, of the sensors of all channels, as a recorder's filters make it: those whose
    reduction of the chi-square is near the largest of one candidate, by the fall (q,).
    """
    starts, projected = [], scores.projected
    late = [k for k, c in enumerate(scores.candidates) if c.makes_sensor_late and c.label not in failed]
    for name in dict.fromkeys(scores.candidates[k].name for k in late):
        of = list({scores.candidates[k].label: k for k in late if scores.candidates[k].name == name}.values())
        together = 1.0 / scores.sizes[of]
        score, overlap = together @ projected.score[of], together @ projected.overlap[np.ix_(of, of)] @ together
        if len(of) > 1 and score > 0.0 and score**2 >= scores.options.isolation.single_share * fall.max() * overlap:
            starts.append(tuple(at_amplitude(scores, k, score / overlap * each)
                                for k, each in zip(of, together, strict=True)))  # fmt: skip
    return starts


def is_of_one_effect(start: Sequence[FittedCandidate]) -> bool:
    """Whether a start is of one effect: a single candidate, or the same fault of several sensors."""
    return len({member.candidate.name for member in start}) == 1


def _pair_starts(scores: ScoreTest, fall: np.ndarray, failed: Set[str]) -> list[tuple[FittedCandidate, ...]]:
    """The best pairs whose reduction of the chi-square is much larger than that of the best alone (q,)."""
    z, projected, best = scores.z(), scores.projected, fall.max()
    enough = best + max(scores.options.isolation.pair_reduction, 0.1 * best)
    barred = [
        c.label in failed or (not z[k] and any(map(c.is_equivalent_to, scores.candidates)))
        for k, c in enumerate(scores.candidates)
    ]
    pairs = []
    of = np.flatnonzero(scores.visible() & ~np.array(barred))
    for i, j in _joint_reductions(projected, of, 0.999 * enough):  # but for rounding, which the solution below decides
        first, second = scores.candidates[i], scores.candidates[j]
        if first.excludes(second) or first.is_equivalent_to(second):
            continue
        a = np.linalg.solve(projected.overlap[np.ix_([i, j], [i, j])], projected.score[[i, j]])
        if any(scores.candidates[k].one_sided and v < 0.0 for k, v in zip((i, j), a, strict=True)):
            continue
        pairs.append((float(a @ projected.score[[i, j]]), i, j, a))
    pairs.sort(key=lambda pair: (-pair[0], pair[1], pair[2]))
    used: dict[str, tuple[FittedCandidate, ...]] = {}
    for value, i, j, a in pairs:
        if value < enough or len(used) >= scores.options.isolation.pairs:
            break
        label = " + ".join(sorted((scores.candidates[i].label, scores.candidates[j].label)))
        used.setdefault(label, tuple(at_amplitude(scores, k, v) for k, v in zip((i, j), a, strict=True)))
    return list(used.values())


def _joint_reductions(projected: ProjectedScores, of: np.ndarray, least: float) -> list[tuple[int, int]]:
    """The pairs of some candidates that are not all but one, and whose joint reduction of the chi-square is no less."""
    H, s = projected.overlap[np.ix_(of, of)], projected.score[of]
    size, square = np.outer(np.diag(H), np.diag(H)), np.outer(np.diag(H), s**2)
    apart = np.triu(np.abs(H) <= 0.97 * np.sqrt(size), 1)
    fall = (square + square.T - 2.0 * np.outer(s, s) * H) / np.where(apart, size - H**2, 1.0)
    return [(int(of[i]), int(of[j])) for i, j in np.argwhere(apart & (fall >= least))]


def linear_amplitude(scores: ScoreTest, k: int) -> FittedCandidate:
    """A candidate in the amount by which the linearised equations explain most with it alone."""
    return at_amplitude(scores, k, scores.projected.score[k] / scores.projected.overlap[k, k])


def at_amplitude(scores: ScoreTest, k: int, amount: float) -> FittedCandidate:
    """A candidate at an amount of its column, inside its limits, with its shapes where they were looked for."""
    candidate = scores.candidates[k]
    low, high = (scores.options.identification.fit.interior * end for end in candidate.limits)
    return with_shapes(candidate, float(np.clip(amount * scores.sizes[k], low, high)))


def at_typical(scores: ScoreTest, k: int, sign: float = 1.0) -> FittedCandidate:
    """A candidate at its typical amplitude."""
    return at_amplitude(scores, k, sign * scores.candidates[k].typical / scores.sizes[k])


def typical_starts(nominal: NominalFit, scores: ScoreTest) -> list[tuple[FittedCandidate, ...]]:
    """The best few effects at their typical amplitudes: where a nominal fit is far from nominal, linearised
    predictions may miss them all.
    """
    starts = _at_typical_either_way(scores)
    return _best_in_turn(starts, reductions_from_prior(nominal, starts))[: scores.options.isolation.seconds]


def likeliest_starts(nominal: NominalFit, scores: ScoreTest) -> Iterator[tuple[FittedCandidate, ...]]:
    """Single starts, likeliest first: by linear answers the plainest of the best, which is fitted with few figures;
    then, for far off these answers may miss it, what explains most when it is simulated, of the linear starts and of
    the effects of the valve at their typical amplitudes. After the first of these comes the plainer effect that it may
    be. Faults of sensors are linear in what they read: they are not simulated otherwise.
    """
    linear, given = [start for start in start_points(scores, frozenset()) if len(start) == 1], set[str]()
    if linear:
        likeliest = (*_of_name(linear, linear[0][0].candidate.plainest), linear[0])[0]
        given.add(likeliest[0].candidate.name)
        yield likeliest
    typical = [start for start in _at_typical_either_way(scores) if not _is_of_sensor(start[0].candidate)]
    starts = [*linear, *typical]
    simulated = _best_in_turn(starts, reductions_from_prior(nominal, starts))
    plainer = _of_name(simulated, simulated[0][0].candidate.plainest) if simulated else []
    for start in (*simulated[:1], *plainer, *simulated[1:]):
        if start[0].candidate.name not in given and len(given) < scores.options.isolation.most_starts:
            given.add(start[0].candidate.name)
            yield start


def _best_in_turn(
    starts: Sequence[tuple[FittedCandidate, ...]], falls: np.ndarray
) -> list[tuple[FittedCandidate, ...]]:
    """The starts that reduce the chi-square, the best of all samples in full and the best with samples far off down-
    weighted in turn: a strong cause moves those samples most. `falls` (2, n) are of `reductions_from_prior`.
    """
    orders = [[int(k) for k in np.argsort(-fall, kind="stable") if fall[k] > 0.0] for fall in falls[::-1]]
    in_turn = (k for best in zip_longest(*orders) for k in best if k is not None)
    return [starts[k] for k in dict.fromkeys(in_turn)]


def _of_name(starts: Sequence[tuple[FittedCandidate, ...]], name: str) -> list[tuple[FittedCandidate, ...]]:
    """The single starts of an effect."""
    return [start for start in starts if start[0].candidate.name == name]


def _is_of_sensor(candidate: Candidate) -> bool:
    return candidate.effect is not None and candidate.effect.reading is not None


def _at_typical_either_way(scores: ScoreTest) -> list[tuple[FittedCandidate, ...]]:
    """The effects at their typical amplitudes, those of either sign both ways."""
    return [
        (at_typical(scores, k, sign),)
        for k, candidate in enumerate(scores.candidates)
        if candidate.effect is not None
        for sign in ((1.0,) if candidate.one_sided else (1.0, -1.0))
    ]
