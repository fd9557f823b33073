"""What could explain the data: the alarm, the hypotheses that are fitted, and those of them that stay.

Every candidate and every free term is tested against what the base fit leaves; the few that could explain it are
refitted, alone and in pairs, and fits that may have stopped short taken up again; what the best leaves is looked at
once more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from .errors import InputError, SolveError
from .evidence import Projected
from .scene import NOISE_ERROR, Scene, look
from .study import (
    ASTRAY,
    EDGE,
    UNSETTLED,
    BaseFit,
    Extra,
    Fit,
    Study,
    evaluate,
    falls_afresh,
    fit_base_from,
    in_full,
    refit,
    refit_afresh,
    refit_from,
    refit_on,
    unstretched,
)
from .weighing import ANSWER_RATIO, Explained, is_nothing, ran, ranked, rivals_of, settled, width_of, worth

ALARM, TERM_ALARM = 0.005, 0.002  # probability of an alarm where nothing is hidden: of candidates, of free terms
NOT_QUIET = 0.01  # of a free term's being chance in what the best hypothesis leaves: naming asks for more than an alarm
SINGLES, PAIRS = 5, 3  # how many are refitted ...
LINEAR = 0.5  # ... of those that explain so large a share of what the best does: far off, linear answers err by so much
SLIGHT = 0.002  # of what is typical: where leakage peaks are measured a thousandth may show
STRETCHED = 3.0  # prior deviations: a base parameter so far out may stand in a cause's way
MOST_AT_ONCE = 2  # causes
SECONDS, NEAR = 3, 0.8  # how many are tried beside a first cause, of those whose z is so large a share of the largest
PAIR_PRICE = 20.0  # fall of the deviance that a second effect must bring to be looked at
LEFT_SHARE = 0.005  # of what the best explains may stay behind for free terms to explain, since no model is the plant
DOUBT_SHARE = 0.02  # up to here, or up to the error of its law, the best is possible still, and so is what has no name
AS_GOOD = 0.1  # of the answer set's width: one that is so near is in it, and need not be fitted for that
AGAIN = 3  # times that what may be best, or the base, is fitted again where it may have stopped short


@dataclass(frozen=True, eq=False)
class Searched:
    """Where a search ended: `base` what it was for in the end, `scene` what that leaves, `final` what the best of the
    hypotheses `found` (best first) leaves; `rivals` the answer set among them, and why `none_listed` is in it too, if
    it is; whether anything shows at all, and the `level` that the candidates' z had to pass.
    """  # fmt: skip

    base: BaseFit
    scene: Scene
    final: Scene
    found: Sequence[Explained]
    rivals: Sequence[Explained]
    none_listed: str
    alarm: bool
    level: float


def search(base: BaseFit, tell: Callable[[str, float], None], known: Sequence[Fit] = ()) -> Searched:
    """Look for what explains what a base fit leaves: hypotheses of one and of two candidates if that is an alarm.

    Again where these show that the base fit had stopped short. Those `known` from elsewhere are the only ones to begin
    with, each from where it was fitted. `tell(stage, share)` is told what is being done.
    """
    tell("looking for causes", 0.0)
    scene = look(base, base.fit)
    for again in reversed(range(AGAIN + 1)):
        alarm, level = _alarm(scene)
        if not alarm:
            return Searched(base, scene, scene, [], [], "", alarm, level)
        found, likeliest = _begun(base, scene, known, lambda share: tell("refitting", 0.15 + 0.6 * share))
        better = _better_base(base, found) if again else None
        if better is None:
            break
        base, scene = better, look(better, better.fit)
    found += _taken_up(base, found, likeliest)
    found = worth(base, _with_fewer(base, settled(found)), level)
    tell("checking", 0.75)
    base, found, final = _checked(base, scene, level, found)
    if not found:
        return Searched(base, scene, final, [], [], "", alarm, level)
    left, bearable = _left(base, final), max(DOUBT_SHARE, found[0].law_error)
    found, plainest = ranked(base, found), left
    if found[0].fit is not final.fit:  # the plainer may leave what the fuller does not
        final = look(base, found[0].fit)
        plainest = _left(base, final)
    if left > bearable:  # where even the best leaves so much, none of them is the answer
        return Searched(base, scene, final, found, [], "", alarm, level)
    rivals = rivals_of(base, found, whole=plainest <= LEFT_SHARE)
    return Searched(base, scene, final, found, rivals, _none_listed(rivals[0], min(left, plainest)), alarm, level)


def _checked(
    base: BaseFit, scene: Scene, level: float, found: list[Explained]
) -> tuple[BaseFit, list[Explained], Scene]:
    """The base in the end, hypotheses best first, and what the best leaves."""
    final = scene
    if found:
        found, final = _with_more(base, look(base, found[0].fit), found)
        found, final = _in_place_of_figures(base, scene, found, final)
        found, final = _with_others(base, found, final)
        if base.study.weights and base.fit.deviance > ASTRAY * base.fit.rows:
            base, found, final = _with_peaks(base, found, final)
    if _stretch(base.fit) > STRETCHED and (not found or _left(base, final) > DOUBT_SHARE):
        found, final = _afresh(base, scene, level, found, final)
    return base, found, final


def _none_listed(best: Explained, left: float) -> str:
    """Why what is in no catalogue may be the cause as well as the best, which leaves a share; "" where it may not."""
    if left > LEFT_SHARE:
        return "what the likeliest leaves over, none of them explains"
    faults = [c.effect.name for c in best.candidates if c.effect is not None and c.effect.reading is not None]
    if len(set(faults)) < len(faults):
        return "sensors that err alike may show one thing that reaches them all"
    if any(extra.candidate.is_common(extra.excess) for extra in best.fit.extras):
        return "a sensor may be so late without a fault"
    return ""


# ---------------------------------------------------------------- alarm


def _alarm(scene: Scene) -> tuple[bool, float]:
    """Whether anything shows, and the level that the candidates' z had to pass."""
    level = scene.level(ALARM)
    shows = scene.z().max(initial=0.0) > level or _worst_family(scene) < TERM_ALARM
    stretched = _stretch(scene.fit) > level  # such as a clock that is early, which has no name
    return bool(shows or stretched or _leftover(scene.fit, scene.study)), level


def _leftover(fit: Fit, study: Study) -> bool:
    """Whether a fit leaves more than the noise, beyond what the noise's own estimate may be off."""
    if not all(noise.verified for noise in study.noise.values()):
        return False  # there the noise is what a fit leaves
    rows = fit.rows
    return bool(fit.deviance - rows > NOISE_ERROR * rows + 5.0 * np.sqrt(2.0 * rows))


def _worst_family(scene: Scene) -> float:
    """The probability that the most telling free term is chance, for as many as were tried."""
    from scipy.stats import chi2

    tests = [(value, freedom) for value, freedom in scene.family_tests() if freedom]
    if not tests:
        return 1.0
    least = min(float(chi2.sf(value, freedom)) for value, freedom in tests)
    return float(-np.expm1(len(tests) * np.log1p(-min(least, 1.0 - 1e-12))))


# ---------------------------------------------------------------- explaining


def _begun(
    base: BaseFit, scene: Scene, known: Sequence[Fit], tell: Callable[[float], None]
) -> tuple[list[Explained], str]:
    """Hypotheses of one and of two candidates, refitted, and the likeliest of them before."""
    found, likeliest, failed = _taken_along(base, known, tell), "", set[str]()
    if found:
        return found, likeliest
    while starts := _starts(scene, failed):
        found, likeliest = _refitted(base, starts, tell=tell), starts[0][0].candidate.family
        if any(likeliest == candidate.family for one in found for candidate in one.candidates):
            break
        failed.add(likeliest)  # no valve runs with it: what it promised is no measure for the others
    return found, likeliest


def _taken_along(base: BaseFit, known: Sequence[Fit], tell: Callable[[float], None]) -> list[Explained]:
    """Hypotheses that were fitted elsewhere, refitted where they do not yet explain nearly as much as the likeliest."""
    begun = list[Fit]()
    for one in known:
        try:
            begun.append(replace(evaluate(base.study, one.point, one.extras), occam=one.occam))
        except (SolveError, InputError):
            continue
    found = list[Explained]()
    for k, fit in enumerate(sorted(begun, key=lambda fit: fit.deviance)):
        tell(k / len(begun))
        near = found and fit.deviance < found[0].fit.deviance + AS_GOOD * width_of(base, found[0])
        refitted = fit if near else refit_on(base, fit)
        found += [Explained(refitted)] if ran(refitted) else []
    return found


def _better_base(base: BaseFit, found: Sequence[Explained]) -> BaseFit | None:
    """The base fitted from where a hypothesis has gone, if that is better without its causes too.

    Then most of what this explains is that the base fit had stopped short.
    """
    for one in sorted((one.fit for one in found), key=lambda fit: fit.deviance):
        try:
            fit = evaluate(base.study, one.point, ())
            if fit.deviance > 0.5 * (base.fit.deviance + one.deviance):
                continue
            better = fit_base_from(base, fit)
        except (SolveError, InputError):
            continue
        if in_full(better).fit.deviance < in_full(base).fit.deviance:
            return better
    return None


def _taken_up(base: BaseFit, found: Sequence[Explained], likeliest: str) -> list[Explained]:
    """Fits that may have stopped short, taken up again from elsewhere."""
    if not found:
        return []
    more = _beside_members(base, found)
    least = min((one.fit for one in (*found, *more)), key=lambda fit: fit.deviance)
    more += _left_behind(base, [*found, *more], least)
    renewed = AGAIN if least.deviance < ASTRAY * least.rows else 0  # times that a promise may be; far off none holds
    for one in [*found, *more]:
        if one.label == likeliest or one.fit.deviance - renewed * one.fit.promised < least.deviance + ANSWER_RATIO:
            more += _from_within(base, one.fit)
    return more


def _beside_members(base: BaseFit, found: Sequence[Explained]) -> list[Explained]:
    """Pairs that have ended above one of their own two fitted again from it: two can explain no less than one."""
    alone = {one.label: one.fit for one in found if len(one.candidates) == 1}
    again = []
    for pair in (one.fit for one in found if len(one.candidates) == 2):
        first, second = pair.extras
        for member, other in ((first, second), (second, first)):
            fit = alone.get(member.candidate.family)
            if fit is not None and fit.deviance < pair.deviance:
                again.append(refit_from(base, fit.with_extras((*fit.extras, replace(other, excess=0.0)))))
    return [Explained(fit) for fit in again if ran(fit)]


def _left_behind(base: BaseFit, found: Sequence[Explained], least: Fit) -> list[Explained]:
    """Those that keep a base parameter stretched where the one that explains most does not, fitted from its figures."""
    if not _stretch(least) < STRETCHED < _stretch(base.fit):
        return []
    return _refitted(base, [one.fit.extras for one in found if _stretch(one.fit) > STRETCHED], least.point)


def _stretch(fit: Fit) -> float:
    """How far out the furthest base parameter is, in prior deviations."""
    return float(np.abs(fit.point).max(initial=0.0))


def _from_within(base: BaseFit, fit: Fit) -> list[Explained]:
    """A fit that has not settled, fitted again from where no base parameter is stretched: its valley may be bent."""
    tried, reached = [fit], np.inf
    for _ in range(AGAIN):
        best = min(tried, key=lambda one: one.deviance)
        if best.promised < UNSETTLED or best.deviance > reached - UNSETTLED:
            break
        reached = best.deviance
        tried += [refit(base, best.extras, unstretched(base)), refit_afresh(base, best.extras)]
    return [Explained(one) for one in tried[1:] if ran(one)]


def _refitted(
    base: BaseFit,
    starts: Sequence[tuple[Extra, ...]],
    point: np.ndarray | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> list[Explained]:
    """The hypotheses of starts that can be run, each refitted from a point of the base parameters."""
    found = []
    for k, start in enumerate(starts):
        tell(k / len(starts))
        fits = [refit(base, start, point)]
        more = tuple(extra for extra in fits[0].extras if not is_nothing(extra, SLIGHT))
        if 0 < len(more) < len(start):  # from there, one alone may get where it could not before
            fits.append(refit(base, more, fits[0].point))
        found += [Explained(fit) for fit in fits if ran(fit)]
    return found


def _with_fewer(base: BaseFit, found: list[Explained]) -> list[Explained]:
    """The found with the best's candidates one fewer each time that this is better still."""
    while found and len(found[0].candidates) > 1:
        best = found[0].fit
        starts = [tuple(extra for extra in best.extras if extra is not left_out) for left_out in best.extras]
        merged = settled([*found, *_refitted(base, starts, best.point)])
        if merged[0] is found[0]:
            return merged
        found = merged
    return found


# ---------------------------------------------------------------- where to start


def _starts(scene: Scene, failed: Set[str]) -> list[tuple[Extra, ...]]:
    """Where to start refits: the best single candidates, and the best pairs where two explain much more than one.

    Families that have `failed` are left out.
    """
    fall = np.where([c.family in failed for c in scene.candidates], 0.0, scene.z() ** 2)
    singles = _singles(scene, fall, LINEAR)
    return [*singles, *_pairs(scene, fall, failed)] if singles else []


def _singles(scene: Scene, fall: np.ndarray, share: float) -> list[tuple[Extra, ...]]:
    """The best single candidates by the fall (q,) of the deviance, those near that share of the largest."""
    likeliest = _best_of_families(scene, fall, share * fall.max(initial=0.0) - 10.0)[:SINGLES]
    return [(_alone(scene, k),) for k in likeliest]


def _best_of_families(scene: Scene, value: np.ndarray, least: float) -> list[int]:
    """The candidates, one of each family, whose value (q,) is positive and no lower than `least`; largest first."""
    best: dict[str, int] = {}
    for k in map(int, np.argsort(-value, kind="stable")):
        if value[k] > 0.0 and value[k] >= least:
            best.setdefault(scene.candidates[k].family, k)
    return list(best.values())


def _pairs(scene: Scene, fall: np.ndarray, failed: Set[str]) -> list[tuple[Extra, ...]]:
    """The best pairs whose fall of the deviance is much larger than that of the best alone (q,)."""
    z, projected, best = scene.z(), scene.projected, fall.max()
    enough = best + max(PAIR_PRICE, 0.1 * best)
    barred = [
        c.family in failed or (not z[k] and any(map(c.is_same_as, scene.candidates)))
        for k, c in enumerate(scene.candidates)
    ]
    pairs = []
    of = np.flatnonzero(scene.visible() & ~np.array(barred))
    for i, j in _joint(projected, of, 0.999 * enough):  # but for rounding, which the solution below decides
        first, second = scene.candidates[i], scene.candidates[j]
        if first.excludes(second) or first.is_same_as(second):
            continue
        a = np.linalg.solve(projected.overlap[np.ix_([i, j], [i, j])], projected.score[[i, j]])
        if any(scene.candidates[k].one_sided and v < 0.0 for k, v in zip((i, j), a, strict=True)):
            continue
        pairs.append((float(a @ projected.score[[i, j]]), i, j, a))
    pairs.sort(key=lambda pair: (-pair[0], pair[1], pair[2]))
    used: dict[str, tuple[Extra, ...]] = {}
    for value, i, j, a in pairs:
        if value < enough or len(used) >= PAIRS:
            break
        label = " + ".join(sorted((scene.candidates[i].family, scene.candidates[j].family)))
        used.setdefault(label, tuple(_extra(scene, k, v) for k, v in zip((i, j), a, strict=True)))
    return list(used.values())


def _joint(projected: Projected, of: np.ndarray, least: float) -> list[tuple[int, int]]:
    """The pairs of some candidates that are not all but one, and whose joint fall of the deviance is no less."""
    H, s = projected.overlap[np.ix_(of, of)], projected.score[of]
    size, square = np.outer(np.diag(H), np.diag(H)), np.outer(np.diag(H), s**2)
    apart = np.triu(np.abs(H) <= 0.97 * np.sqrt(size), 1)
    fall = (square + square.T - 2.0 * np.outer(s, s) * H) / np.where(apart, size - H**2, 1.0)
    return [(int(of[i]), int(of[j])) for i, j in np.argwhere(apart & (fall >= least))]


def _alone(scene: Scene, k: int) -> Extra:
    """A candidate in the amount by which the linear equations explain most with it alone."""
    return _extra(scene, k, scene.projected.score[k] / scene.projected.overlap[k, k])


def _extra(scene: Scene, k: int, amount: float) -> Extra:
    """A candidate at an amount of its column, inside its limits, with its shapes where they were looked for."""
    candidate = scene.candidates[k]
    low, high = candidate.limits
    fixed = dict(candidate.fixed)
    shapes = tuple((p.name, fixed.get(p.name, p.default)) for p in candidate.shapes())
    return Extra(candidate, float(np.clip(amount * scene.sizes[k], EDGE * low, EDGE * high)), shapes)


# ---------------------------------------------------------------- looking at what the best leaves


def _with_more(base: BaseFit, final: Scene, found: list[Explained]) -> tuple[list[Explained], Scene]:
    """The found with a second effect where one shows in what the best leaves.

    A third is not looked for: what two leave over tells that one of them is not it, rather than of three at once.
    """
    while len(final.fit.extras) < MOST_AT_ONCE:
        z, level = final.z(), final.level(ALARM)
        best = found[0]
        share = 0.0 if _leftover(final.fit, base.study) else DOUBT_SHARE
        if z.max(initial=0.0) ** 2 < max(level**2, share * (base.fit.deviance - best.fit.deviance)):
            break
        near = _best_of_families(final, z, NEAR * z.max())[:SECONDS]
        starts = [(*best.fit.extras, _alone(final, k)) for k in near]
        more = settled(_refitted(base, starts, best.fit.point))
        merged = settled([*found, *more])
        if not more or merged[0] is best or merged[0].evidence > best.evidence - 6.0:
            break
        found = _with_fewer(base, merged)
        final = look(base, found[0].fit)
    return found, final


def _with_others(base: BaseFit, found: list[Explained], final: Scene) -> tuple[list[Explained], Scene]:
    """The found where the best has two causes, with what else would go well beside each of these."""
    best, more = found[0].fit, list[Explained]()
    if len(best.extras) < 2:
        return found, final
    for extra in best.extras:
        alone = refit(base, (extra,), best.point)
        if not ran(alone):
            continue
        scene = look(base, alone)
        z = scene.z()
        pairs = [(extra, _alone(scene, k)) for k in _best_of_families(scene, z, NEAR * z.max())]
        tried = {frozenset(c.family for c in one.candidates) for one in found}
        new = [pair for pair in pairs if frozenset(e.candidate.family for e in pair) not in tried]
        more += _refitted(base, new[:SECONDS], best.point)
    merged = settled([*found, *more])
    return merged, final if merged[0] is found[0] else look(base, merged[0].fit)


def _afresh(
    base: BaseFit, scene: Scene, level: float, found: list[Explained], final: Scene
) -> tuple[list[Explained], Scene]:
    """The found with single candidates fitted from where no base parameter is stretched, if one of these is better."""
    starts: dict[str, tuple[Extra, ...]] = {}
    for start in [*_typical(base, scene), *_singles(scene, scene.z() ** 2, 0.5 * LINEAR)]:
        starts.setdefault(start[0].candidate.family, start)
    fits = [fit for start in list(starts.values())[:SINGLES] if ran(fit := refit_afresh(base, start))]
    merged = settled([*found, *worth(base, list(map(Explained, fits)), level)])
    if merged[:1] == found[:1]:
        return found, final
    return _with_more(base, look(base, merged[0].fit), merged)


def _typical(base: BaseFit, scene: Scene) -> list[tuple[Extra, ...]]:
    """The best few effects at their typical amplitudes: where a base is stretched, linear answers may miss them all."""
    starts = [
        (_at_typical(scene, k, sign),)
        for k, candidate in enumerate(scene.candidates)
        if candidate.effect is not None
        for sign in ((1.0,) if candidate.one_sided else (1.0, -1.0))
    ]
    falls = falls_afresh(base, starts)
    return [starts[k] for k in np.argsort(-falls, kind="stable")[:SECONDS] if falls[k] > 0.0]


def _at_typical(scene: Scene, k: int, sign: float = 1.0) -> Extra:
    """A candidate at its typical amplitude."""
    return _extra(scene, k, sign * scene.candidates[k].typical / scene.sizes[k])


def _in_place_of_figures(
    base: BaseFit, scene: Scene, found: list[Explained], final: Scene
) -> tuple[list[Explained], Scene]:
    """The found where the best has a figure beyond its tolerance, with effects in the place of that.

    They are those of one sign whose linear answers have the other one: what such an effect shows at its typical
    amplitude may be something else, and a figure that many others follow may have taken its place.
    """
    best = found[0].fit
    rest = tuple(extra for extra in best.extras if extra.candidate.effect is not None)
    if len(rest) == len(best.extras):
        return found, final
    z = scene.z()
    beside = [
        k
        for k, c in enumerate(scene.candidates)
        if c.effect is not None and c.effect.reading is None and c.one_sided and z[k] == 0.0
        and not any(c.excludes(extra.candidate) for extra in rest)
    ]  # fmt: skip
    starts = [(*rest, _at_typical(scene, k)) for k in beside]
    likeliest = np.argsort(-falls_afresh(base, starts), kind="stable")[:SECONDS]
    fits = [fit for k in likeliest if ran(fit := refit_afresh(base, starts[k]))]
    merged = settled([*found, *map(Explained, fits)])
    return merged, final if merged[0] is found[0] else look(base, merged[0].fit)


def _with_peaks(base: BaseFit, found: list[Explained], final: Scene) -> tuple[BaseFit, list[Explained], Scene]:
    """The answer set refitted with all samples in full, where its best can follow the peaks that a base far off cannot.

    What tells a second cause from none may be in them.
    """
    full, near = in_full(base), rivals_of(base, found)
    again = settled([each for one in near for each in _refitted(full, [one.fit.extras], one.fit.point)])
    if not again or again[0].fit.deviance > ASTRAY * again[0].fit.rows:
        return base, found, final
    found = _with_fewer(full, again)
    found, final = _with_more(full, look(full, found[0].fit), found)
    return full, found, final


def _left(base: BaseFit, final: Scene) -> float:
    """The share of what the best explains that it leaves, beyond chance, for others to explain: a free term, an
    amplitude that wanders or, beside two causes, a third one. Infinite where more than the noise is left.
    """  # fmt: skip
    from scipy.stats import chi2

    if _leftover(final.fit, base.study):
        return float("inf")
    tests = [(value, freedom) for value, freedom in final.family_tests() if freedom]
    over = [value - float(chi2.isf(NOT_QUIET / len(tests), freedom)) for value, freedom in tests]
    wander, freedom = final.constancy()
    if freedom:
        over.append(wander - float(chi2.isf(1e-3, freedom)))
    if len(final.fit.extras) == MOST_AT_ONCE and (third := final.z().max(initial=0.0)) > final.level(ALARM):
        over.append(third**2)
    gained = max(base.fit.deviance - final.fit.deviance, 1.0)
    return max([0.0, *over]) / gained
