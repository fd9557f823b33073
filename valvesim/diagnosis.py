"""Given measured data: what the simulation gets wrong, its cause, the extended model and the gain on locked records.

The order of work: fit the base model with its parameters inside their tolerances; test every candidate and every free
term against what is left; refit the few that could explain it, alone and in pairs; look again at what those leave.
A cause is named only where nothing else explains the data nearly as well and nothing is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from .answer import (
    AMBIGUOUS,
    CAUSE,
    NO_DISCREPANCY,
    UNKNOWN,
    CandidateAnswer,
    DetectionLimit,
    Diagnosis,
    Estimate,
    Gain,
    NextTest,
    NoiseFound,
    Score,
    Shift,
    Term,
    Trace,
)
from .channels import SIGNAL_CHANNELS, STATE_CHANNELS
from .errors import InputError, SolveError
from .evidence import inverse_of
from .extension import effect_files, scenario_text
from .hypotheses import Candidate
from .next_test import design
from .prediction import Variant, prepare
from .recovery import recover
from .scene import NOISE_ERROR, Scene, look
from .session import Record, Session, load_session
from .study import (
    ASTRAY,
    EDGE,
    FLOOR,
    SHAPE_STEP,
    UNSETTLED,
    BaseFit,
    Extra,
    Fit,
    Study,
    evaluate,
    falls_afresh,
    fit_base,
    fit_base_from,
    in_full,
    own_step,
    prepare_study,
    refit,
    refit_afresh,
    refit_from,
    residual_of,
    unstretched,
    within_tolerance,
)

ALARM, TERM_ALARM = 0.005, 0.002  # probability of an alarm where nothing is hidden: of candidates, of free terms
NOT_QUIET = 0.01  # of a free term's being chance in what the best hypothesis leaves: naming asks for more than an alarm
SINGLES, PAIRS = 5, 3  # how many are refitted ...
LINEAR = 0.5  # ... of those that explain so large a share of what the best does: far off, linear answers err by so much
SLIGHT, NOTHING = 0.002, 2.0 * FLOOR  # of what is typical: where leakage peaks are measured a thousandth may show
STRETCHED = 3.0  # prior deviations: a base parameter so far out may stand in a cause's way
MOST_AT_ONCE = 2  # causes
SECONDS, NEAR = 3, 0.8  # how many are tried beside a first cause, of those whose z is so large a share of the largest
PAIR_PRICE = 20.0  # fall of the deviance that a second effect must bring to be looked at
ANSWER_RATIO = 6.0  # difference of deviance up to which candidates stay in the answer set ...
ANSWER_SHARE = 0.04  # ... and this share of what the best explains, since no model is the plant
LEFT_SHARE = 0.02  # of what the best explains may stay behind as a free term, for the same reason
AGAIN = 3  # times that what may be best, or the base, is fitted again where it may have stopped short
WORTH = 0.8  # of the squared alarm level: what a hypothesis must explain to be one at all
PARAMETER_PRICE = 3.0  # deviance: a figure beyond its tolerance is rarer than an effect of the catalogue
REFINED_PRICE = 1.0  # the same for an effect that is another, plainer one where its own feature does not show
UNKNOWN_PRICE = 6.0  # the same for a cause that nobody has listed
HOPELESS = 0.35  # share of the signal that stays unexplained where the records are not of this valve
LIKELY = 0.9  # chance that the locked records get better, below which no extended model is offered
INTERVAL = (0.025, 0.975)
STAGES = ("reading", "fitting the nominal model", "looking for causes", "refitting", "checking", "measuring the gain")


@dataclass(frozen=True, eq=False)
class Explained:
    """A hypothesis fitted."""

    fit: Fit

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        return tuple(extra.candidate for extra in self.fit.extras)

    @property
    def least(self) -> float:
        """The deviance, with what is still promised taken off."""
        return self.fit.deviance - min(self.fit.promised, UNSETTLED)

    @property
    def price(self) -> float:
        """What it costs to hold these candidates at all, whatever the data say."""
        return sum(2.0 * np.log(10.0) + _rarity(candidate) for candidate in self.candidates)

    @property
    def evidence(self) -> float:
        """`least` with the price of its freedom."""
        strength = sum((e.excess / (5.0 * e.candidate.typical)) ** 2 for e in self.fit.extras)
        return float(self.least + self.fit.occam + self.price + strength)

    def weighed(self, heat: float) -> float:
        """`evidence` where differences of deviance count so many times less, and prices do not, see `_heat`."""
        return self.evidence + (heat - 1.0) * self.price

    @property
    def label(self) -> str:
        """The candidates' families."""
        return " + ".join(c.family for c in self.candidates) or "nothing but noise"

    def is_within(self, other: Explained) -> bool:
        """Whether another hypothesis has all these candidates, by whatever name."""
        return all(
            any(mine.family == c.family or mine.is_same_as(c) for c in other.candidates) for mine in self.candidates
        )

    def means(self, other: Explained) -> bool:
        """Whether another hypothesis has just these candidates."""
        return len(self.candidates) == len(other.candidates) and self.is_within(other)


def _rarity(candidate: Candidate) -> float:
    """The price of what is rarer than an effect of the catalogue."""
    if candidate.effect is None:
        return PARAMETER_PRICE
    return REFINED_PRICE if candidate.effect.plainer else 0.0


def diagnose(session: Session | str | Path, *, progress: Callable[[str, float], None] | None = None) -> Diagnosis:
    """Diagnose a session, or the folder of one. `progress(stage, share)` is told what is being done.

    The same session and seed give the same answer. Raises InputError for a session that cannot be used and SolveError
    where the nominal valve cannot be simulated under the session's inputs.
    """
    tell = progress or (lambda stage, share: None)
    tell(STAGES[0], 0.0)
    session = session if isinstance(session, Session) else load_session(session)
    study = prepare_study(session)
    tell(STAGES[1], 0.05)
    base = fit_base(study, lambda share: tell(STAGES[1], 0.05 + 0.25 * share))
    tell(STAGES[2], 0.3)
    base, scene, found = _explained(base, look(base, base.fit), lambda share: tell(STAGES[3], 0.4 + 0.35 * share))
    alarm, level = _alarm(scene)
    rivals, final = list[Explained](), scene
    if alarm:
        base, found, rivals, final = _search(base, scene, level, found, tell)
    tell(STAGES[5], 0.9)
    return _answer(base, scene, final, found, rivals, alarm, level)


def _explained(base: BaseFit, scene: Scene, tell: Callable[[float], None]) -> tuple[BaseFit, Scene, list[Explained]]:
    """The base, what it leaves, and hypotheses of one and of two candidates if this is an alarm, best evidence first.

    Again where these show that the base fit had stopped short.
    """
    for left in reversed(range(AGAIN + 1)):
        alarm, level = _alarm(scene)
        found, likeliest = _begun(base, scene, tell) if alarm else ([], "")
        better = _better_base(base, found) if left else None
        if better is None:
            break
        base, scene = better, look(better, better.fit)
    found += _taken_up(base, found, likeliest)
    return base, scene, _worth(base, _with_fewer(base, _settled(found)), level)


def _search(
    base: BaseFit, scene: Scene, level: float, found: list[Explained], tell: Callable[[str, float], None]
) -> tuple[BaseFit, list[Explained], list[Explained], Scene]:
    """The base in the end, hypotheses best first, the answer set among them, and what the best leaves."""
    final = scene
    tell(STAGES[4], 0.75)
    if found:
        found, final = _with_more(base, look(base, found[0].fit), found)
        found, final = _with_others(base, found, final)
        if base.study.weights and base.fit.deviance > ASTRAY * base.fit.rows:
            base, found, final = _with_peaks(base, found, final)
    quiet = bool(found) and _quiet(base, final)
    if not quiet and _stretch(base.fit) > STRETCHED:
        found, final = _afresh(base, scene, level, found, final)
        quiet = bool(found) and _quiet(base, final)
    if not found:
        return base, [], [], final
    found, whole = _ranked(base, found), True
    if found[0].fit is not final.fit:  # the plainer may leave what the fuller does not
        final = look(base, found[0].fit)
        whole = _quiet(base, final)
    # where even the best leaves something over, none of them is the answer
    return base, found, _rivals(base, found, whole) if quiet else [], final


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


def _begun(base: BaseFit, scene: Scene, tell: Callable[[float], None]) -> tuple[list[Explained], str]:
    """Hypotheses of one and of two candidates, refitted, and the likeliest of them before."""
    found, likeliest, failed = list[Explained](), "", set[str]()
    while starts := _starts(scene, failed):
        found, likeliest = _refitted(base, starts, tell=tell), starts[0][0].candidate.family
        if any(likeliest == candidate.family for one in found for candidate in one.candidates):
            break
        failed.add(likeliest)  # no valve runs with it: what it promised is no measure for the others
    return found, likeliest


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
                again.append(refit_from(base, replace(fit, extras=(*fit.extras, replace(other, excess=0.0)))))
    return [Explained(fit) for fit in again if _ran(fit)]


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
    return [Explained(one) for one in tried[1:] if _ran(one)]


def _worth(base: BaseFit, found: Sequence[Explained], level: float) -> list[Explained]:
    """Those that explain enough to be hypotheses at all."""
    return [one for one in found if base.fit.deviance - one.fit.deviance > WORTH * level**2]


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
        more = tuple(extra for extra in fits[0].extras if not _is_nothing(extra, SLIGHT))
        if 0 < len(more) < len(start):  # from there, one alone may get where it could not before
            fits.append(refit(base, more, fits[0].point))
        found += [Explained(fit) for fit in fits if _ran(fit)]
    return found


def _with_fewer(base: BaseFit, found: list[Explained]) -> list[Explained]:
    """The found with the best's candidates one fewer each time that this is better still."""
    while found and len(found[0].candidates) > 1:
        best = found[0].fit
        starts = [tuple(extra for extra in best.extras if extra is not left_out) for left_out in best.extras]
        merged = _settled([*found, *_refitted(base, starts, best.point)])
        if merged[0] is found[0]:
            return merged
        found = merged
    return found


def _settled(found: Sequence[Explained]) -> list[Explained]:
    """Best evidence first: one of each meaning, without pairs that hold an effect which has come to nothing."""
    kept: list[Explained] = []
    for one in sorted(found, key=lambda one: one.evidence):
        nothing = len(one.fit.extras) > 1 and any(map(_is_nothing, one.fit.extras))
        if not nothing and not any(map(one.means, kept)):
            kept.append(one)
    return kept


def _ran(fit: Fit) -> bool:
    return bool(np.isfinite(fit.deviance))


def _is_nothing(extra: Extra, share: float = NOTHING) -> bool:
    """Whether an amplitude has come to less than a share of what is typical."""
    return abs(extra.excess) < share * extra.candidate.typical


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
    pairs = []
    barred = [
        c.family in failed or (any(map(c.is_same_as, scene.candidates)) and not z[k])
        for k, c in enumerate(scene.candidates)
    ]
    for i, j in combinations(map(int, np.flatnonzero(scene.visible() & ~np.array(barred))), 2):
        first, second = scene.candidates[i], scene.candidates[j]
        if first.excludes(second) or first.is_same_as(second):
            continue
        both = projected.overlap[np.ix_([i, j], [i, j])]
        if abs(both[0, 1]) > 0.97 * np.sqrt(both[0, 0] * both[1, 1]):
            continue
        a = np.linalg.solve(both, projected.score[[i, j]])
        if any(scene.candidates[k].one_sided and v < 0.0 for k, v in zip((i, j), a, strict=True)):
            continue
        pairs.append((float(a @ projected.score[[i, j]]), i, j, a))
    pairs.sort(key=lambda pair: (-pair[0], pair[1], pair[2]))
    used: dict[str, tuple[Extra, ...]] = {}
    for value, i, j, a in pairs:
        if value < best + max(PAIR_PRICE, 0.1 * best) or len(used) >= PAIRS:
            break
        label = " + ".join(sorted((scene.candidates[i].family, scene.candidates[j].family)))
        used.setdefault(label, tuple(_extra(scene, k, v) for k, v in zip((i, j), a, strict=True)))
    return list(used.values())


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


def _with_more(base: BaseFit, final: Scene, found: list[Explained]) -> tuple[list[Explained], Scene]:
    """The found with a second effect where one shows in what the best leaves.

    A third is not looked for: what two leave over tells that one of them is not it, rather than of three at once.
    """
    while len(final.fit.extras) < MOST_AT_ONCE:
        z, level = final.z(), final.level(ALARM)
        best = found[0]
        share = 0.0 if _leftover(final.fit, base.study) else LEFT_SHARE
        if z.max(initial=0.0) ** 2 < max(level**2, share * (base.fit.deviance - best.fit.deviance)):
            break
        near = _best_of_families(final, z, NEAR * z.max())[:SECONDS]
        starts = [(*best.fit.extras, _alone(final, k)) for k in near]
        more = _settled(_refitted(base, starts, best.fit.point))
        merged = _settled([*found, *more])
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
        if not _ran(alone):
            continue
        scene = look(base, alone)
        z = scene.z()
        pairs = [(extra, _alone(scene, k)) for k in _best_of_families(scene, z, NEAR * z.max())]
        tried = {frozenset(c.family for c in one.candidates) for one in found}
        new = [pair for pair in pairs if frozenset(e.candidate.family for e in pair) not in tried]
        more += _refitted(base, new[:SECONDS], best.point)
    merged = _settled([*found, *more])
    return merged, final if merged[0] is found[0] else look(base, merged[0].fit)


def _afresh(
    base: BaseFit, scene: Scene, level: float, found: list[Explained], final: Scene
) -> tuple[list[Explained], Scene]:
    """The found with single candidates fitted from where no base parameter is stretched, if one of these is better."""
    starts: dict[str, tuple[Extra, ...]] = {}
    for start in [*_typical(base, scene), *_singles(scene, scene.z() ** 2, 0.5 * LINEAR)]:
        starts.setdefault(start[0].candidate.family, start)
    fits = [fit for start in list(starts.values())[:SINGLES] if _ran(fit := refit_afresh(base, start))]
    merged = _settled([*found, *_worth(base, list(map(Explained, fits)), level)])
    if merged[:1] == found[:1]:
        return found, final
    return _with_more(base, look(base, merged[0].fit), merged)


def _typical(base: BaseFit, scene: Scene) -> list[tuple[Extra, ...]]:
    """The best few effects at their typical amplitudes: where a base is stretched, linear answers may miss them all."""
    typical = [
        _extra(scene, k, sign * candidate.typical / scene.sizes[k])
        for k, candidate in enumerate(scene.candidates)
        if candidate.effect is not None
        for sign in ((1.0,) if candidate.one_sided else (1.0, -1.0))
    ]
    falls = falls_afresh(base, typical)
    return [(typical[k],) for k in np.argsort(-falls, kind="stable")[:SECONDS] if falls[k] > 0.0]


def _with_peaks(base: BaseFit, found: list[Explained], final: Scene) -> tuple[BaseFit, list[Explained], Scene]:
    """The answer set refitted with all samples in full, where its best can follow the peaks that a base far off cannot.

    What tells a second cause from none may be in them.
    """
    full, near = in_full(base), _rivals(base, found)
    again = _settled([each for one in near for each in _refitted(full, [one.fit.extras], one.fit.point)])
    if not again or again[0].fit.deviance > ASTRAY * again[0].fit.rows:
        return base, found, final
    found = _with_fewer(full, again)
    found, final = _with_more(full, look(full, found[0].fit), found)
    return full, found, final


def _quiet(base: BaseFit, final: Scene) -> bool:
    """Whether the best hypothesis leaves nothing that a free term, an amplitude that wanders or, beside two causes, a
    third one would explain."""
    from scipy.stats import chi2

    gained = max(base.fit.deviance - final.fit.deviance, 0.0)
    allowance = LEFT_SHARE * gained
    tests = [(value - allowance, freedom) for value, freedom in final.family_tests() if freedom]
    least = min((float(chi2.sf(max(value, 0.0), freedom)) for value, freedom in tests), default=1.0)
    families_quiet = least * max(len(tests), 1) > NOT_QUIET
    wander, freedom = final.constancy()
    constant = freedom == 0 or float(chi2.sf(max(wander - allowance, 0.0), freedom)) > 1e-3
    full = len(final.fit.extras) == MOST_AT_ONCE
    third = full and final.z().max(initial=0.0) ** 2 > max(final.level(ALARM) ** 2, allowance)
    return families_quiet and constant and not third and not _leftover(final.fit, base.study)


# ---------------------------------------------------------------- the answer


def _answer(
    base: BaseFit,
    scene: Scene,
    final: Scene,
    found: Sequence[Explained],
    rivals: Sequence[Explained],
    alarm: bool,
    level: float,
) -> Diagnosis:
    study, session = base.study, base.study.session
    best = found[0] if found else None
    chosen = best.fit if best is not None else base.fit
    in_set = [*rivals, *_chance(base, rivals, level)]
    answers = _candidate_answers(base, found, in_set, level)
    verdict = _verdict(alarm, in_set)
    hopeless = _hopeless(base, chosen)
    term: Term | None = None
    notes = list(session.notes)
    if any(not noise.verified for noise in study.noise.values()):
        notes.append(
            "noise unverified: no repeats, so it was taken from what the model leaves; small effects may hide in it"
        )
    if hopeless:
        verdict, in_set = UNKNOWN, []
        notes.insert(
            0, "the base model cannot come near these records: are they of this valve, with these units and signs?"
        )
    named = best if verdict in (CAUSE, AMBIGUOUS) else None
    unextended = base.fit.variant(study.base)
    variant, readings, point = unextended, base.fit.readings, base.fit.point
    if named is not None:
        variant, readings, point = chosen.variant(study.base), chosen.readings, chosen.point
    elif verdict == UNKNOWN and not hopeless and (recovered := recover(base, scene)) is not None:
        term, variant, readings, point = recovered.term, recovered.variant, recovered.readings, recovered.point
    causes = tuple(c.name for c in best.candidates) if verdict == CAUSE and best is not None else ()
    estimates = _estimates(base, final) if named is not None else ()
    before = base.fit if variant is unextended else within_tolerance(base)
    gain, claimed, offered, traces = _gain(base, before, variant, readings)
    if not offered and variant is not unextended:
        variant = before.variant(study.base)
        notes.append(
            "the locked records do not show that the extension helps: the scenario is that of the refitted base model"
        )
    return Diagnosis(
        title=session.title,
        verdict=verdict,
        causes=causes,
        summary=_summary(verdict, in_set, term, notes),
        location=_location(verdict, in_set),
        candidates=tuple(answers),
        parameters=estimates,
        gain=gain,
        gain_claimed=claimed,
        extension_offered=offered and variant is not unextended,
        detection_limits=_limits(scene, level),
        next_test=_next(base, in_set) if verdict == AMBIGUOUS else None,
        term=term,
        shifts=_shifts(study, point),
        noise=tuple(
            NoiseFound(channel=channel, rate=rate, deviation=n.deviation, unit=UNITS[channel], order=len(n.lags),
                       verified=n.verified, source=n.source)
            for (channel, rate), n in study.noise.items()
        ),
        scores=_scores(scene),
        alarm_level=level,
        errors=_errors(study, before),
        notes=tuple(notes),
        traces=traces,
        extended_scenario=scenario_text(session, variant),
        extended_effects=effect_files(session, variant),
        extended_variant=variant,
    )  # fmt: skip


UNITS = {channel.name: channel.unit for channel in (*STATE_CHANNELS, *SIGNAL_CHANNELS)}


def _width(base: BaseFit, best: Explained) -> float:
    """The difference of evidence up to which another explains the data nearly as well as the best does.

    A fall beyond the noise itself tells how far astray the base was, not how much the best explains.
    """
    fall = min(base.fit.deviance - best.fit.deviance, best.fit.rows)
    share = max([ANSWER_SHARE, *(c.effect.law_error for c in best.candidates if c.effect is not None)])
    return max(ANSWER_RATIO, share * fall)


def _heat(base: BaseFit, best: Explained) -> float:
    """By how much less a difference of deviance counts than it would if the model were the plant."""
    return _width(base, best) / ANSWER_RATIO


def _ranked(base: BaseFit, found: Sequence[Explained]) -> list[Explained]:
    """The found with those that explain the data nearly as well as the best in the order of their probabilities.

    Of two that fit alike for a model that is not the plant, the plainer goes first.
    """
    best = found[0]
    heat, width = _heat(base, best), _width(base, best)
    near = sorted((one for one in found if one.evidence - best.evidence < width), key=lambda one: one.weighed(heat))
    return [*near, *(one for one in found if one not in near)]


def _rivals(base: BaseFit, found: Sequence[Explained], whole: bool = True) -> list[Explained]:
    """The best, and those that explain the data nearly as well; `whole` tells that the best leaves nothing over."""
    if not found:
        return []
    best, width, heat = found[0], _width(base, found[0]), _heat(base, found[0])
    most = len(best.candidates)  # how wide a prior is does not tell two apart that fit alike
    near = [
        one
        for one in found
        if one.weighed(heat) - best.weighed(heat) < width
        or (len(one.candidates) <= most and one.least - best.least < width)
    ]
    # what a better one says already, and something more besides, is no rival of it, unless there must be something more
    return [one for k, one in enumerate(near) if not whole or not any(better.is_within(one) for better in near[:k])]


def _doubt(base: BaseFit, best: Explained, level: float) -> float:
    """The difference of evidence between noise alone and the best: at the alarm level the two are as likely."""
    return base.fit.deviance - best.fit.deviance - level**2


def _chance(base: BaseFit, rivals: Sequence[Explained], level: float) -> list[Explained]:
    """The model as it is, where what the best explains is so little that it may be chance."""
    return [Explained(base.fit)] if rivals and _doubt(base, rivals[0], level) < ANSWER_RATIO else []


def _candidate_answers(
    base: BaseFit, found: Sequence[Explained], in_set: Sequence[Explained], level: float
) -> list[CandidateAnswer]:
    """All hypotheses with their probabilities, likeliest first; beside them what is in no catalogue, and chance."""
    if not found:
        return []
    gained = max(base.fit.deviance - found[0].fit.deviance, 0.0)
    width, heat = _width(base, found[0]), _heat(base, found[0])
    known = [one.weighed(heat) for one in found]
    unknown = known[0] + UNKNOWN_PRICE + 0.25 * gained if in_set else known[0] - 2.0 * width
    values = np.array([*known, known[0] + _doubt(base, found[0], level), unknown])
    weights = np.exp(-0.5 * (values - values.min()) / heat)
    weights /= weights.sum()
    members = {one.label for one in in_set}
    answers = [
        CandidateAnswer(
            names=tuple(c.name for c in one.candidates),
            label=one.label,
            location=" and ".join(dict.fromkeys(c.location() for c in one.candidates)),
            probability=float(weight),
            deviance_fall=float(base.fit.deviance - one.fit.deviance),
            in_set=one.label in members,
        )
        for one, weight in zip([*found, Explained(base.fit)], weights[:-1], strict=True)
    ]
    nothing = CandidateAnswer(names=("unknown",), label="none of the known causes", location="", deviance_fall=0.0,
                              probability=float(weights[-1]), in_set=not in_set)  # fmt: skip
    ranked = sorted([*answers, nothing], key=lambda a: -a.probability)
    return [a for a in ranked if a.in_set or a.probability > 1e-3]


def _verdict(alarm: bool, in_set: Sequence[Explained]) -> str:
    if not alarm:
        return NO_DISCREPANCY
    if not in_set:
        return UNKNOWN
    return CAUSE if len(in_set) == 1 else AMBIGUOUS


def _hopeless(base: BaseFit, fit: Fit) -> bool:
    """True where most of the signal stays unexplained in most channels: these records are not of this valve."""
    shares = []
    for bench, read in zip(base.study.benches, fit.readings, strict=True):
        for name, column in read.items():
            measured = bench.record.values[name]
            noise = base.study.noise[name, bench.record.pace].deviation
            signal = float(np.std(measured))
            if signal > 5.0 * noise:
                shares.append(float(np.sqrt(np.mean((measured - column) ** 2))) / signal)
    return bool(shares) and float(np.median(shares)) > HOPELESS


def _estimates(base: BaseFit, final: Scene) -> tuple[Estimate, ...]:
    """Amplitudes and shapes of the fit's extras with 95 % intervals, from the curvature at the fit."""
    from scipy.stats import t as student_t

    fit, gram = final.fit, final.gram
    p, total = gram.parameters, gram.total
    own = [1 + p + k for k in final.own]
    at = [*range(1, 1 + p), *own]
    H = total[np.ix_(at, at)].copy()
    for k, (_, shape) in enumerate(fit.kinds):
        H[p + k, p + k] += np.log(SHAPE_STEP) ** 2 if shape else 0.0
    H[np.arange(p), np.arange(p)] += 1.0
    C = inverse_of(H)
    # parts of records that disagree widen the interval: no model is the plant (a sandwich over the parts)
    pushes = C @ np.array([part[at, 0] for part in gram.products]).T
    parts = len(gram.products)
    others = max(parts - 1, 1)
    few = float(student_t.ppf(0.975, others))

    def half_width(combine: np.ndarray) -> float:
        among = float(np.sum((combine @ pushes) ** 2)) * parts / others
        return float(max(1.96 * np.sqrt(combine @ C @ combine), few * np.sqrt(among)))

    names = [parameter.name for parameter in base.study.base.parameters]
    found = []
    for k, (extra, shape) in enumerate(fit.kinds):
        candidate = extra.candidate
        if candidate.effect is None:
            j = names.index(candidate.name.removeprefix("parameter:"))
            parameter = base.study.base.parameters[j]
            combine = np.zeros(len(at))
            combine[j], combine[p + k] = parameter.deviation, own_step(extra)
            value = parameter.nominal + fit.point[j] * parameter.deviation + extra.excess
            half = half_width(combine)
            low, high = value - half, value + half
            found.append(
                Estimate(
                    name=parameter.name, cause=candidate.name, value=value, low=low, high=high, unit=parameter.unit
                )
            )
            continue
        effect = candidate.effect
        if shape:
            declared = next(q for q in effect.parameters if q.name == shape)
            value = dict(extra.shapes)[shape]
            half = np.log(SHAPE_STEP) * half_width(np.eye(len(at))[p + k])
            low, high = value * np.exp(-half), value * np.exp(half)
        else:
            declared = effect.amplitude
            value = (declared.neutral or 0.0) + extra.excess
            combine = own_step(extra) * np.eye(len(at))[p + k]
            if candidate.family in names:  # the sensor's error within tolerance is the same error: their sum is known
                j = names.index(candidate.family)
                combine[j] = base.study.base.parameters[j].deviation
                value += fit.point[j] * combine[j]
            half = half_width(combine)
            low, high = value - half, value + half
        low, high = max(low, declared.bounds[0]), min(high, declared.bounds[1])
        found.append(
            Estimate(name=declared.name, cause=candidate.family, value=float(value), low=float(low), high=float(high),
                     unit=declared.unit, doc=declared.doc)
        )  # fmt: skip
        if not shape:
            found += [
                Estimate(name=name, cause=candidate.family, value=v, low=v, high=v, unit="1", doc="as found")
                for name, v in candidate.fixed
                if name not in dict(extra.shapes)
            ]
    return tuple(found)


def _summary(verdict: str, in_set: Sequence[Explained], term: Term | None, notes: Sequence[str]) -> str:
    if verdict == NO_DISCREPANCY:
        return "No discrepancy: the model explains the records within their noise and its own tolerances."
    if verdict == CAUSE:
        return f"The cause is {_said(in_set[0])}."
    if verdict == AMBIGUOUS:
        causes = [*(_said(one) for one in in_set if one.candidates)]
        if in_set[-1].candidates:
            return f"Something is wrong, and these cannot be told apart: {'; '.join(causes)}."
        return f"Something may be wrong, or noise alone shows it; it would be {' or '.join(causes)}."
    if notes and notes[0].startswith("the base model cannot"):
        return f"Nothing is named: {notes[0]}"
    if term is None:
        return "Something is wrong that none of the known causes explains."
    return (
        "Something is wrong that none of the known causes explains; it acts like a term in the "
        f"{term.port.replace('_', ' ')} that depends on the {term.variable.replace('_', ' ')}"
        + (f", and nearly as well like {_some(term.alike)}." if term.alike else ".")
    )


def _some(labels: Sequence[str], most: int = 2) -> str:
    """A few labels in words, and how many more there are."""
    more = len(labels) - most
    return " or ".join(labels[:most]) + (f" (and {more} more)" if more > 0 else "")


def _said(one: Explained) -> str:
    """A hypothesis in words: `sensor_bias@load_flow` as "sensor bias of load flow"."""
    return " together with ".join(
        c.family.replace("parameter:", "the figure of ").replace("@", " of ").replace("_", " ") for c in one.candidates
    )


def _location(verdict: str, in_set: Sequence[Explained]) -> str:
    if verdict not in (CAUSE, AMBIGUOUS):
        return ""
    return " or ".join(dict.fromkeys(c.location() for one in in_set for c in one.candidates))


def _limits(scene: Scene, level: float) -> tuple[DetectionLimit, ...]:
    """For each candidate, the amplitude that would pass the alarm nine times in ten."""
    best: dict[str, DetectionLimit] = {}
    distance = scene.projected.distance
    visible = scene.visible()
    for k, candidate in enumerate(scene.candidates):
        name = candidate.effect.amplitude.name if candidate.effect is not None else candidate.name.partition(":")[2]
        amplitude = None
        if visible[k]:
            amplitude = float((level + 1.2816) / distance[k] * abs(scene.sizes[k]))
        one = DetectionLimit(
            name=candidate.name, label=candidate.family, parameter=name, amplitude=amplitude, unit=candidate.unit
        )
        old = best.get(candidate.family)
        if old is None or old.amplitude is None or (amplitude is not None and amplitude < old.amplitude):
            best[candidate.family] = one
    return tuple(best.values())


def _shifts(study: Study, point: np.ndarray) -> tuple[Shift, ...]:
    shifts = [
        Shift(
            name=p.name,
            unit=p.unit,
            nominal=p.nominal,
            value=float(p.nominal + t * p.deviation),
            share_of_tolerance=float(t / 2.0),
        )
        for p, t in zip(study.base.parameters, point, strict=True)
    ]
    return tuple(sorted(shifts, key=lambda s: -abs(s.share_of_tolerance)))


def _scores(scene: Scene, most: int = 15) -> tuple[Score, ...]:
    z = scene.z()
    best: dict[str, float] = {}
    for candidate, value in zip(scene.candidates, z, strict=True):
        best[candidate.family] = max(best.get(candidate.family, 0.0), float(value))
    ranked = sorted(best.items(), key=lambda pair: -pair[1])
    return tuple(Score(label=label, z=value) for label, value in ranked[:most])


def _errors(study: Study, before: Fit) -> dict[str, dict[str, float]]:
    table: dict[str, dict[str, float]] = {}
    for bench, read in zip(study.benches, before.readings, strict=True):
        record = bench.record
        table[record.name] = {}
        for name in record.outputs:
            left = (record.values[name] - read[name])[record.usable[name]]
            deviation = study.noise[name, record.pace].deviation
            table[record.name][name] = float(np.sqrt(np.mean(left**2)) / deviation)
    return table


# ---------------------------------------------------------------- gain


def _gain(
    base: BaseFit, before: Fit, extended: Variant, readings: Sequence[dict[str, np.ndarray]]
) -> tuple[tuple[Gain, ...], bool, bool, tuple[Trace, ...]]:
    """Errors of base and extended model on the locked records, opened here and once; and traces of all records.

    The first flag tells whether a gain is claimed, the second whether the extended model is offered: where it most
    likely does better on what it has not seen, or where nobody can tell.
    """
    study, session = base.study, base.study.session
    universe = study.benches[0].universe
    variants = (before.variant(study.base), extended)
    gains, traces, pooled = [], [], []
    for bench, *reads in zip(study.benches, before.readings, readings, strict=True):
        traces += _traces(study, bench.record, reads)
    for record in session.locked:
        bench = prepare(session, record, universe)
        reads = [bench.readings(bench.run(variant), variant) for variant in variants]
        traces += _traces(study, record, reads)
        white = []
        for name in record.outputs:
            key = _nearest_noise(study, name, record.pace)
            if key is None:
                continue
            columns = np.column_stack([residual_of(record, read)[name][:, 0] for read in reads])
            white.append(study.noise[key].whiten(columns, record.usable[name]))
        if not white:
            continue
        squares = np.concatenate([w**2 for w in white])
        change = squares[:, 1] - squares[:, 0]
        pooled.append(change)
        low, high = np.quantile(_block_means(change, session.seed), INTERVAL)
        error, extended_error = np.sqrt(squares.mean(axis=0))
        gains.append(
            Gain(record=record.name, before=float(error), after=float(extended_error), floor=1.0,
                 change=float(change.mean()), low=float(low), high=float(high), claimed=bool(high < 0.0))
        )  # fmt: skip
    claimed, offered = False, True
    if pooled:
        means = _block_means(np.concatenate(pooled), session.seed)
        claimed, offered = bool(np.quantile(means, INTERVAL[1]) < 0.0), bool(np.mean(means < 0.0) >= LIKELY)
    return tuple(gains), claimed, offered, tuple(traces)


def _nearest_noise(study: Study, channel: str, rate: float) -> tuple[str, float] | None:
    """The key of the noise of a channel at the nearest rate; None where training has not seen the channel."""
    rates = [r for name, r in study.noise if name == channel]
    return (channel, min(rates, key=lambda r: abs(np.log(r / rate)))) if rates else None


def _block_means(change: np.ndarray, seed: int, draws: int = 1000) -> np.ndarray:
    """(draws,) means as they would have come out, by drawing blocks: neighbours are alike."""
    size = max(int(np.sqrt(len(change))), 1)
    count = max(len(change) // size, 1)
    blocks = change[: count * size].reshape(count, size).mean(axis=1)
    rng = np.random.default_rng(seed)
    return blocks[rng.integers(0, count, (draws, count))].mean(axis=1)


def _traces(study: Study, record: Record, reads: Sequence[dict[str, np.ndarray]]) -> list[Trace]:
    found = []
    for name in record.outputs:
        key = _nearest_noise(study, name, record.pace)
        found.append(
            Trace(record=record.name, channel=name, unit=UNITS[name], role=record.role, time=record.time,
                  measured=record.values[name], base=reads[0][name], extended=reads[1][name],
                  noise=study.noise[key].deviation if key is not None else 0.0)
        )  # fmt: skip
    return found


def _next(base: BaseFit, in_set: Sequence[Explained]) -> NextTest | None:
    """The test that tells the two likeliest apart."""
    first, second = in_set[:2]
    return design(base, first.fit, second.fit, (first.label, second.label))
