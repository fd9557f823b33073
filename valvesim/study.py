"""The fits behind a diagnosis: the base model first, then the base with candidates, and what their residuals hold.

Symbols
    y readings, r whitened residual, J whitened answers to the base parameters, t their point in prior deviations
    D = r'r + t't deviance;  H = J'J + I
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from .catalogue import CATALOGUE
from .errors import InputError, SolveError
from .evidence import Gram
from .hypotheses import (
    Base,
    Candidate,
    View,
    base_of,
    candidate_columns,
    candidates_of,
    neighbours,
    parameter_columns,
    view,
)
from .noise import Noise, fit_noise, rounding
from .prediction import Bench, Course, Variant, prepare
from .session import Record, Session
from .simulate import cores

MOST_ROWS = 300_000  # whitened rows that are kept: of longer sessions every second, third ... one
SEGMENTS = 2  # of a record, for the test that an amplitude is the same everywhere
SHAPE_STEP = 1.1  # by which a shape parameter is moved to see what it shows
SHAPE_STRIDE = 4.5  # times, by which a step may change it
SHAPE_DEVIATION = 1.0  # prior of the logarithm of a shape parameter about its default
ASTRAY = 1.5  # times the rows: a refit that leaves so much is led nearer first, as the base is
LONG, HARDLY = 60_000, 0.02  # points of all courses make a session long; share of its deviance not worth a look there
BASE_LOOKS, LOOKS, MORE_LOOKS = 24, 4, 12  # how often answers may be taken anew: in the base fit, a refit, a good one
PATIENCE = 2  # in a long session, steps that bring less than they promise: answers taken anew cost as much as six
STEPS, FAILURES = 20, 4  # with the same answers: all, and those that bring much less than they promise
FAR_OFF, ROUGH, ROBUST_LOOKS = 3.0, 0.1, 8  # times the median misfit; share of the deviance not worth a look; looks
LEAST_COMMON = 0.2  # share of the samples of repeats that none has lost: of fewer their noise is not taken
EDGE = 0.98  # share of its limits that an excess keeps to while it is fitted
FLOOR = 1e-4  # of what is typical: to so little an excess of one sign may come while it is fitted
PEAKS_WORSE = 3.0  # times what is left between peaks: where they leave more, the model cannot follow them
PEAK = 0.3  # of a reading's bend within a tenth of a millisecond may be wrong
LEARNED = 3.0  # deviance that a step must change for the answers to learn from it: below is the solver's noise
ABSURD = 1e30  # deviance
TOLERANCE = 2.0  # prior deviations at which a tolerance ends
FAR_AWAY = 3.0  # prior deviations from where answers were taken, and they are taken anew
LONGEST_STEP = 3.0  # of a base parameter at once, in prior deviations
NEARLY = 10.0  # fall of the deviance that is not worth a step on the way to the base fit ...
SETTLED = 1.0  # ... nor at its end ...
ENOUGH = 2.0  # ... nor of a candidate's refit: the answer set goes by several, and the rest is reckoned with
UNSETTLED = 2.0 * ENOUGH  # what a refit still promises where it has not settled


@dataclass(frozen=True, eq=False)
class Study:
    """A session with everything that its fits share."""

    session: Session
    base: Base
    candidates: tuple[Candidate, ...]
    benches: tuple[Bench, ...]
    firsts: tuple[int, ...]  # of each bench, the first that runs like it
    noise: dict[tuple[str, float], Noise] = field(default_factory=dict)
    weights: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)  # (record, channel): of its whitened rows
    is_long: bool = False  # a look takes long, and what hardly helps is left

    @property
    def stride(self) -> int:
        """Every how many of the whitened rows is kept: they are independent, so none is missed but for its weight."""
        rows = sum(len(b.record.time) * len(b.record.outputs) for b in self.benches)
        return int(np.ceil(rows / MOST_ROWS))

    def hardly(self, fit: Fit) -> float:
        """The fall of the base's deviance that is not worth a look: in a long session, a share of what a fit leaves."""
        return HARDLY * max(fit.deviance - ASTRAY * fit.rows, 0.0) if self.is_long else 0.0

    def coarse(self) -> Study:
        """The study with its views at the samples alone: the same readings, and answers that will do on the way."""
        return replace(self, benches=tuple(bench.coarse() for bench in self.benches))

    def each(self, function: Callable, *over: Sequence) -> list:
        """The function over the benches or what belongs to them, on threads; what runs alike is worked out once."""
        own = sorted(set(self.firsts))
        found = dict(zip(own, each(function, *([one[k] for k in own] for one in over)), strict=True))
        return [found[k] for k in self.firsts]

    def whiten(self, bench: Bench, columns: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Whitened columns (n, k) of a record, channel by channel."""
        record = bench.record
        white = []
        for name in record.outputs:
            noise = self.noise[name, record.pace]
            rows = noise.whiten(columns[name], record.usable[name])[:: self.stride]
            weights = self.weights.get((record.name, name))
            white.append(rows if weights is None else rows * weights[:, None])
        return white

    def weighed(self, weights: Sequence[np.ndarray]) -> Study:
        """The study with weights (rows,) of each channel of each training record, in their order."""
        keys = [(bench.record.name, name) for bench in self.benches for name in bench.record.outputs]
        return replace(self, weights=dict(zip(keys, weights, strict=True)))

    def stack(self, columns: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
        """Whitened columns of all training records, (rows, k)."""
        return np.concatenate(
            [one for bench, each in zip(self.benches, columns, strict=True) for one in self.whiten(bench, each)]
        )


def each(function: Callable, *over: Sequence) -> list:
    """The function over sequences, on threads where there are cores for them: the integration lets others work."""
    threads = min(cores(), len(over[0]))
    if threads < 2:
        return list(map(function, *over))
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, *over))


def prepare_study(session: Session, more: Sequence = ()) -> Study:
    """The study of a session, noise not yet known; `more` are effects that its fits may use beside the catalogue's."""
    base = base_of(session)
    universe = (*CATALOGUE.values(), *session.user_effects, *more)
    benches = tuple(prepare(session, record, universe) for record in session.training)
    is_long = sum(len(bench.times) for bench in benches) > LONG
    return Study(session, base, candidates_of(session, base), benches, _firsts(benches), is_long=is_long)


def _firsts(benches: Sequence[Bench]) -> tuple[int, ...]:
    return tuple(next(k for k, first in enumerate(benches) if first.runs_like(bench)) for bench in benches)


def restricted(study: Study, records: Sequence[Record]) -> Study:
    """The study of parts of its training records, in their order: the same base parameters, the same candidates."""
    session = replace(study.session, records=(*records, *study.session.locked))
    benches = tuple(prepare(session, r, b.universe) for r, b in zip(records, study.benches, strict=True))
    return replace(study, session=session, benches=benches, firsts=_firsts(benches), noise={}, weights={})


# ---------------------------------------------------------------- noise


def residual_of(record: Record, readings: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Measured minus read, by channel, as columns (n, 1)."""
    return {name: (record.values[name] - readings[name])[:, None] for name in record.outputs}


def find_noise(study: Study, readings: Sequence[dict[str, np.ndarray]]) -> dict[tuple[str, float], Noise]:
    """The noise of each channel at each rate: from repeats where there are any, else from what the model leaves."""
    session, found = study.session, {}
    records = [bench.record for bench in study.benches]
    keys = dict.fromkeys((name, record.pace) for record in records for name in record.outputs)
    for name, rate in keys:
        own = [
            (record, np.where(record.usable[name], record.values[name] - read[name], np.nan))
            for record, read in zip(records, readings, strict=True)
            if name in record.outputs and record.pace == rate
        ]
        sensor = session.sensors.get(name)
        resolution = sensor.resolution if sensor is not None else 0.0
        stated = sensor.noise if sensor is not None else None
        series = _differences(own)
        verified = bool(series)
        if not verified:
            series = [left for record, left in own]
        floor = max(resolution / np.sqrt(12.0), 1e-9 * _size(own, name), stated or 0.0 if not verified else 0.0)
        noise = fit_noise(series, verified=verified, source="repeats" if verified else "residual", floor=floor)
        if resolution > 2.0 * noise.deviation:  # too coarse to be dithered by the noise: rounding repeats itself
            coarse = [
                rounding(read[name], noise.deviation, resolution, session.seed)
                for record, read in zip(records, readings, strict=True)
                if name in record.outputs and record.pace == rate
            ]
            noise = fit_noise(coarse, verified=verified, source=noise.source + ", resolution", floor=floor)
        found[name, rate] = noise
    return found


def _size(own: Sequence[tuple[Record, np.ndarray]], name: str) -> float:
    return max(float(np.max(np.abs(record.values[name]))) for record, _ in own)


def _differences(own: Sequence[tuple[Record, np.ndarray]]) -> list[np.ndarray]:
    """Noise alone, from records that repeat each other: what the model gets wrong is the same in each.

    NaN where one of them has lost its sample.
    """
    groups: dict[str, list[np.ndarray]] = {}
    for record, left in own:
        if record.repeats:
            groups.setdefault(record.repeats, []).append(left)
    series = []
    for members in groups.values():
        count = len(members)
        if count < 2:
            continue
        length = min(map(len, members))
        stack = np.array([m[:length] for m in members])
        if np.mean(np.isfinite(stack).all(axis=0)) < LEAST_COMMON:
            continue
        apart = (stack - stack.mean(axis=0)) * np.sqrt(count / (count - 1.0))
        series += list(apart[:-1] if count == 2 else apart)
    return series


def first_noise(study: Study) -> dict[tuple[str, float], Noise]:
    """White noise of the size of what a straight line through three samples leaves: to start the first fit with."""
    found = {}
    for bench in study.benches:
        record = bench.record
        for name in record.outputs:
            bend = np.diff(record.values[name], 2)
            size = float(np.sqrt(np.mean(bend**2) / 6.0))
            sensor = study.session.sensors.get(name)
            floor = max(
                (sensor.resolution if sensor else 0.0) / np.sqrt(12.0), 2e-3 * float(np.ptp(record.values[name]))
            )
            found[name, record.pace] = Noise(max(size, floor, 1e-30), (), False, "first guess")
    return found


# ---------------------------------------------------------------- fits


@dataclass(frozen=True, eq=False)
class Extra:
    """A candidate in a fit: its excess over neutral, and its shape parameters."""

    candidate: Candidate
    excess: float
    shapes: tuple[tuple[str, float], ...] = ()

    def add_to(self, variant: Variant) -> Variant:
        return self.candidate.add_to(variant, self.excess, **dict(self.shapes))


@dataclass(frozen=True, eq=False)
class Fit:
    """A point of the base parameters with extras, its deviance and the readings that it predicts.

    `rows` is what the deviance would be of noise alone, `promised` by how much the linear equations would still lower
    it, `occam` the price of the freedom. `courses` are kept while it may be looked at from, see `see_from`.
    """

    point: np.ndarray
    extras: tuple[Extra, ...]
    deviance: float
    readings: tuple[dict[str, np.ndarray], ...]
    residual: np.ndarray
    rows: float
    promised: float = 0.0
    occam: float = 0.0
    courses: tuple[Course, ...] = ()

    @property
    def kinds(self) -> tuple[tuple[Extra, str], ...]:
        """What is fitted of the extras, in order: each extra's excess (""), then each of its shapes by name."""
        return tuple((extra, shape) for extra in self.extras for shape in ("", *(name for name, _ in extra.shapes)))

    @property
    def place(self) -> np.ndarray:
        """What is fitted as one vector: the base point, then `kinds`, shapes as logarithms."""
        own = [np.log(dict(extra.shapes)[shape]) if shape else extra.excess for extra, shape in self.kinds]
        return np.array([*self.point, *own])

    def with_extras(self, extras: Sequence[Extra]) -> Fit:
        """The same point with other extras: the courses were run with these ones, and are left behind."""
        return replace(self, extras=tuple(extras), courses=())

    def variant(self, base: Base) -> Variant:
        """The valve and effects of this fit."""
        variant = base.at(self.point)
        for extra in self.extras:
            variant = extra.add_to(variant)
        return variant


def evaluate(study: Study, point: np.ndarray, extras: tuple[Extra, ...]) -> Fit:
    """The fit at a point, by running every training record. Raises SolveError, InputError where it cannot be run."""
    fit = Fit(point, extras, 0.0, (), np.zeros(0), 0.0)
    ran = _run(study, fit.variant(study.base))
    fit = _weighed(study, replace(fit, readings=tuple(readings for _, readings in ran)))
    return fit if study.is_long else replace(fit, courses=tuple(course for course, _ in ran))


def predict(study: Study, variant: Variant) -> tuple[dict[str, np.ndarray], ...]:
    """What each training record's sensors would read of a variant, by running it."""
    return tuple(readings for _, readings in _run(study, variant))


def _run(study: Study, variant: Variant) -> list[tuple[Course, dict[str, np.ndarray]]]:
    """The course of each training record and what its sensors would read."""

    def run(bench: Bench) -> tuple[Course, dict[str, np.ndarray]]:
        course = bench.run(variant)
        return course, bench.readings(course, variant)

    return study.each(run, study.benches)


def whitened_residual(study: Study, readings: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
    """(rows,) of all training records."""
    return study.stack([residual_of(b.record, r) for b, r in zip(study.benches, readings, strict=True)])[:, 0]


def _weighed(study: Study, fit: Fit) -> Fit:
    """The same point and readings by a study's noise and weights."""
    residual = whitened_residual(study, fit.readings)
    shape_prior = sum(
        (np.log(value / default) / SHAPE_DEVIATION) ** 2
        for extra in fit.extras
        for value, default in _against_default(extra)
    )
    deviance = float(residual @ residual + fit.point @ fit.point + shape_prior)
    if not deviance < ABSURD:
        raise SolveError("the readings of this variant are beyond all sense")
    rows = len(residual) - sum(float(np.sum(1.0 - weights**2)) for weights in study.weights.values())
    return replace(fit, deviance=deviance, residual=residual, rows=rows, promised=0.0, occam=0.0)


def _against_default(extra: Extra) -> list[tuple[float, float]]:
    fixed = dict(extra.candidate.fixed)
    defaults = {p.name: fixed.get(p.name, p.default) for p in extra.candidate.shapes()}
    return [(value, defaults[name]) for name, value in extra.shapes]


@dataclass(frozen=True, eq=False)
class BaseFit:
    """The base model at its best, seen from there: `columns` are its answers to the base parameters, see `see`.

    `J` (rows, p) are the same, whitened.
    """

    study: Study
    fit: Fit
    views: tuple[View, ...]
    columns: tuple[dict[str, np.ndarray], ...]
    J: np.ndarray


def fit_base(study: Study, tell: Callable[[float], None] = lambda share: None) -> BaseFit:
    """Fit the base parameters, and find the noise on the way. Raises SolveError where the valve cannot be run."""
    reached = 0.0

    def ahead(share: float) -> None:
        nonlocal reached
        reached = max(reached, share)
        tell(reached)

    study = replace(study, noise=first_noise(study))
    fit = evaluate(study, np.zeros(len(study.base.parameters)), ())
    labels = [bench.record.repeats for bench in study.benches if bench.record.repeats]
    noise = find_noise(study, fit.readings) if len(labels) > len(set(labels)) else {}
    if noise and all(one.verified for one in noise.values()):
        return fit_from(replace(study, noise=noise), fit, ahead)
    base = _afar(study, fit, ahead)
    for _ in range(2):  # the noise is what the best fit leaves: again with its colour
        noise = find_noise(study, base.fit.readings)
        base = _without_peaks(replace(base, study=replace(base.study, noise=noise)), ahead)
    return _with_peaks(study, base, ahead)


def fit_from(study: Study, fit: Fit, tell: Callable[[float], None] = lambda share: None) -> BaseFit:
    """The base fitted under a study's noise, from a fit: from afar, then near, at last in full."""
    return _with_peaks(study, _afar(study, fit, tell), tell)


def fit_base_near(study: Study, point: np.ndarray, *, peaks: bool) -> BaseFit:
    """The base fitted from a point (p,) near its best, and the noise on the way; all samples in full with `peaks`."""
    fit = evaluate(replace(study, noise=first_noise(study)), point, ())
    study = replace(study, noise=find_noise(study, fit.readings))
    base = seen_at(study, _weighed(study, fit))
    for last in (False, True):
        weighed = base.study if peaks else _less_peaks(base.study, base.views)
        base = _settle(_under(weighed, base), SETTLED)
        if last or all(noise.verified for noise in base.study.noise.values()):
            break
        base = _under(replace(study, noise=find_noise(study, base.fit.readings)), base)
    return base


def fit_base_from(base: BaseFit, fit: Fit) -> BaseFit:
    """The base fitted, all samples in full, from where a fit without extras is: by its own answers, or from afar."""
    study = replace(base.study, weights={})
    start = _weighed(study, fit)
    if start.deviance > ASTRAY * start.rows:
        return fit_from(study, fit)
    return _settle(seen_at(study, start), SETTLED)


def _afar(study: Study, fit: Fit, tell: Callable[[float], None]) -> BaseFit:
    """A coarse base from a fit, without peaks."""
    coarse = study.coarse()
    return _without_peaks(_seen(coarse, *_approach(coarse, fit, tell)), tell)


def _with_peaks(study: Study, base: BaseFit, tell: Callable[[float], None]) -> BaseFit:
    """A coarse base that was fitted without peaks fitted with them too; without where the model cannot follow them."""
    study = replace(study, noise=base.study.noise)
    near = seen_at(study, _weighed(study, base.fit))
    full = _settle(near, SETTLED, tell)
    left, left_between = full.fit.deviance - full.fit.rows, base.fit.deviance - base.fit.rows
    follows = left <= PEAKS_WORSE * max(left_between, 0.0) + 0.1 * full.fit.rows
    if follows and full.fit.deviance < ASTRAY * full.fit.rows:
        return full
    return _settle(_under(replace(study, weights=base.study.weights), near), SETTLED, tell)


def in_full(base: BaseFit) -> BaseFit:
    """The same base with all samples counting in full."""
    return _under(replace(base.study, weights={}), base)


def _under(study: Study, base: BaseFit) -> BaseFit:
    """The same base under a study's noise and weights."""
    return _seen(study, _weighed(study, base.fit), base.views, base.columns)


def seen_at(study: Study, fit: Fit) -> BaseFit:
    """A fit without extras as a base, seen from where it is."""
    return _seen(study, fit, *see_from(study, fit))


def _seen(study: Study, fit: Fit, views: Sequence[View], columns: Sequence[dict[str, np.ndarray]]) -> BaseFit:
    return BaseFit(study, fit, tuple(views), tuple(columns), study.stack(columns))


def _approach(
    study: Study, fit: Fit, tell: Callable[[float], None] = lambda share: None
) -> tuple[Fit, list[View], list[dict[str, np.ndarray]]]:
    """From afar: samples that are far off count less, for as long as that lowers the deviance by a good part.

    Given back are the fit and what is seen from it, see `see`.

    A leakage peak in the wrong place does not tell which way it should move; the rest of the record does.
    """
    views, columns = see_from(study, fit)
    for look in range(ROBUST_LOOKS):
        tell(0.5 * look / ROBUST_LOOKS)
        robust = _robust(study, fit.readings)
        start = _weighed(robust, fit)
        near, _ = _descend(robust, start, _answers(robust, fit, views, columns), ROUGH * start.deviance)
        if near.deviance > (1.0 - ROUGH) * start.deviance:
            break
        fit = _weighed(study, near)
        views, columns = see_from(study, fit)
    return fit, views, columns


def _robust(study: Study, readings: Sequence[dict[str, np.ndarray]]) -> Study:
    """The study with samples that are far off the readings counting less."""
    study = replace(study, weights={})
    pairs = zip(study.benches, readings, strict=True)
    white = [r[:, 0] for bench, read in pairs for r in study.whiten(bench, residual_of(bench.record, read))]
    return study.weighed([1.0 / np.hypot(1.0, r / (FAR_OFF * max(float(np.median(np.abs(r))), 1.0))) for r in white])


def _settle(base: BaseFit, enough: float, tell: Callable[[float], None] = lambda share: None) -> BaseFit:
    """The base fitted under its study's noise, from where it is, until the deviance falls by no more than enough."""
    for look in range(BASE_LOOKS):
        tell(0.5 + 0.5 * look / BASE_LOOKS)
        fit, _ = _descend(base.study, base.fit, base.J, enough)
        if base.fit.deviance - fit.deviance < max(enough, base.study.hardly(base.fit)):
            break
        base = seen_at(base.study, fit)
    return base


def _without_peaks(base: BaseFit, tell: Callable[[float], None]) -> BaseFit:
    """The base fitted with samples next to a sharp peak of a reading counting less."""
    return _settle(_under(_less_peaks(base.study, base.views), base), NEARLY, tell)


def _less_peaks(study: Study, views: Sequence[View]) -> Study:
    """The study with samples next to a sharp peak of a reading counting less.

    Where a closing land passes null, leakage rises and falls within a tenth of a millisecond: there a sample tells more
    of sensor and solver than of the valve, and it says nothing of where the peak should be.
    """
    weights = []
    for seen in views:
        record = seen.bench.record
        bends = seen.bench.bends(seen.course, seen.variant)
        for name in record.outputs:
            noise = study.noise[name, record.pace]
            row = 1.0 / np.hypot(1.0, PEAK * bends[name] / noise.innovation)
            for _ in noise.lags:  # a row holds samples before its own
                row[1:] = np.minimum(row[1:], row[:-1])
            weights.append(row[noise.kept(record.usable[name])][:: study.stride])
    return study.weighed(weights)


def _descend(study: Study, fit: Fit, answers: np.ndarray, enough: float) -> tuple[Fit, np.ndarray]:
    """Levenberg-Marquardt, damped in the metric of the priors, until little is promised or promises are not kept.

    The answers (rows, p and extras) learn from each step what it has changed (Broyden), and are given back.
    """
    metric = np.array([1.0] * len(fit.point) + [1.0 if shape else e.candidate.typical**-2 for e, shape in fit.kinds])
    damping, failures, start, best = 0.0, 0, fit, fit  # away from its best a fit is on its one step uphill
    for _ in range(STEPS):
        H, gradient = _normal(fit, answers)
        room = _room(fit)
        if fit is best:
            best = fit = replace(fit, promised=_promise(H, gradient, room))
            lasting = PATIENCE if study.is_long else 0
            stale = best.deviance < start.deviance and (failures > lasting or _far(start, best))
            if best.promised < enough or stale or failures == FAILURES:
                break
        step, held = _step(H + damping * np.diag(metric), gradient, room), damping
        while np.max(np.abs(step[: len(fit.point)])) > LONGEST_STEP:
            held = max(2.0 * held, 0.01)
            step = _step(H + held * np.diag(metric), gradient, room)
        try:
            new = evaluate(study, fit.point + step[: len(fit.point)], _moved(fit, step[len(fit.point) :]))
        except (SolveError, InputError):  # no valve can have these figures
            fit, damping, failures = best, max(10.0 * damping, 0.1), failures + 1
            continue
        moved, changed = new.place - fit.place, fit.residual - new.residual
        if (length := float(moved @ (metric * moved))) > 0.0 and float(changed @ changed) > LEARNED:
            answers = answers + np.outer((changed - answers @ moved) / length, metric * moved)
        gained = best.deviance - new.deviance
        if gained > 0.0:
            failures = 0 if gained > 0.5 * best.promised else failures + 1
            damping = 0.0 if damping <= 0.1 or gained > 0.5 * best.promised else damping / 10.0
            best = fit = new
        elif fit is best and failures == 0:
            fit = new  # a bent valley: the next step may lead back into it, further down
        else:
            fit, damping, failures = best, max(10.0 * damping, 0.1), failures + 1
    return best, answers


def _promise(H: np.ndarray, gradient: np.ndarray, room: np.ndarray) -> float:
    """By how much the linear equations would lower the deviance."""
    step = _step(H, gradient, room)
    return max(float((2.0 * gradient - H @ step) @ step), 0.0)


def _far(start: Fit, fit: Fit) -> bool:
    """Whether the answers taken at `start` are of a valve too far from where the fit is now."""
    far = float(np.max(np.abs(fit.point - start.point)))
    return start.deviance - fit.deviance > 50.0 and far > FAR_AWAY


def see_from(study: Study, fit: Fit) -> tuple[list[View], list[dict[str, np.ndarray]]]:
    """Each training record seen from a fit to them, see `see`; what it has run for that is not run again."""
    return see(study, fit.variant(study.base), fit.courses)


def see(
    study: Study, variant: Variant, courses: Sequence[Course] = ()
) -> tuple[list[View], list[dict[str, np.ndarray]]]:
    """Each training record seen from a variant, and its answers (n_samples, p) to the base parameters by channel.

    With the variant's courses of the records, where they are known.
    """
    known: Sequence[Course | None] = courses or [None] * len(study.benches)
    views = study.each(lambda bench, course: view(bench, variant, course), study.benches, known)
    beside = neighbours(study.base, variant)
    columns = study.each(lambda seen: parameter_columns(seen, study.base, beside), views)
    return [replace(seen, bench=bench) for seen, bench in zip(views, study.benches, strict=True)], columns


def within_tolerance(base: BaseFit) -> Fit:
    """The base fit with no parameter beyond its tolerance: what the model can do without an extension."""
    if not np.any(np.abs(base.fit.point) > TOLERANCE):
        return base.fit
    room = np.outer((-TOLERANCE, TOLERANCE), np.ones_like(base.fit.point)) - base.fit.point
    return evaluate(base.study, base.fit.point + _step(*_normal(base.fit, base.J), room), ())


def refit(base: BaseFit, start: Sequence[Extra], point: np.ndarray | None = None, looks: int = MORE_LOOKS) -> Fit:
    """The base with candidates, all fitted together, from `start`; its deviance is infinite where that cannot be run.

    The answers are those of the base first.
    """
    tried = list[Fit]()
    for shrink in (1.0, 0.3, 0.1):
        try:
            extras = tuple(replace(e, excess=e.excess * shrink) for e in start)
            tried.append(evaluate(base.study, base.fit.point if point is None else point, extras))
        except (SolveError, InputError):
            continue
        if tried[-1].deviance < _good(base):
            break
    if not tried:
        return _not_run(base, start)
    near = min(tried, key=lambda one: one.deviance)
    fit = _refitted(base, near, start, looks)
    if near is tried[0] or (fit.promised < UNSETTLED and fit.deviance < _good(base)):
        return fit
    afar = _led_near(base, tried[0], looks)  # small beginnings may crawl along a bent valley: the great one jumps it
    return min(fit, afar, key=lambda one: one.deviance)


def _refitted(base: BaseFit, fit: Fit, start: Sequence[Extra], looks: int) -> Fit:
    """A refit from a fit that runs, or from where the linear equations put it, whichever promises to end lower."""
    leapt = _leap(base, tuple(start)) or _leap(base, fit.extras)
    begun = [pair for at in (fit, leapt) if at and (pair := _with_added(base, at))]
    if not begun:
        return _not_run(base, start)
    # promises are half kept
    fit, answers = min(begun, key=lambda pair: pair[0].deviance - 0.5 * _promise(*_normal(*pair), _room(pair[0])))
    if fit.deviance > ASTRAY * fit.rows:
        return _led_near(base, fit, looks)
    return _descended(base.study, fit, answers, ENOUGH, looks, _good(base))


def refit_afresh(base: BaseFit, start: Sequence[Extra]) -> Fit:
    """The same from where no base parameter is beyond its tolerance, with nothing of what the base fit has found.

    Where it has stretched parameters to where no valve runs, or none that has the cause besides, there is no way back
    from there.
    """
    try:
        return _led_near(base, evaluate(base.study, unstretched(base), tuple(start)), MORE_LOOKS)
    except (SolveError, InputError):
        return _not_run(base, start)


def refit_from(base: BaseFit, fit: Fit) -> Fit:
    """A fit fitted further from where it is, by answers of its own; its deviance is infinite where it cannot be run."""
    try:
        return refit_on(base, evaluate(base.study, fit.point, fit.extras))
    except (SolveError, InputError):
        return _not_run(base, fit.extras)


def refit_on(base: BaseFit, fit: Fit) -> Fit:
    """The same for a fit that has been run in the base's study."""
    study = base.study
    try:
        answers = _answers(study, fit, *see_from(study, fit))
    except (SolveError, InputError):
        return _not_run(base, fit.extras)
    return _descended(study, fit, answers, ENOUGH, MORE_LOOKS, _good(base))


def falls_afresh(base: BaseFit, starts: Sequence[tuple[Extra, ...]]) -> np.ndarray:
    """(len(starts),) fall of the deviance by each start, from the same point; -inf where it cannot be run.

    Each is run, and the base parameters follow by the linear equations; samples that are far off count less.
    """
    study = base.study.coarse()
    fit = evaluate(study, unstretched(base), ())
    robust = _robust(study, fit.readings)
    J = robust.stack(see_from(study, fit)[1])
    H = J.T @ J + np.eye(len(fit.point))

    def left(fit: Fit) -> float:
        gradient = J.T @ fit.residual - fit.point
        return float(fit.deviance - gradient @ _solve(H, gradient))

    before = left(_weighed(robust, fit))

    def fall(start: tuple[Extra, ...]) -> float:
        try:
            return before - left(evaluate(robust, fit.point, start))
        except (SolveError, InputError):
            return -np.inf

    return np.array([fall(start) for start in starts])


def unstretched(base: BaseFit) -> np.ndarray:
    """The base's point (p,) with each parameter that is beyond its tolerance back at the end of it."""
    return np.clip(base.fit.point, -TOLERANCE, TOLERANCE)


def _not_run(base: BaseFit, start: Sequence[Extra]) -> Fit:
    """In place of a fit that no valve could be run for."""
    return replace(base.fit.with_extras([replace(e, excess=0.0) for e in start]), deviance=np.inf)


def _led_near(base: BaseFit, fit: Fit, looks: int) -> Fit:
    """A fit from afar fitted as the base was: coarsely, see `_approach`, then without peaks, then as the base is."""
    study, coarse = base.study, base.study.coarse()
    fit, views, columns = _approach(coarse, fit)
    if not study.weights:
        between = _less_peaks(coarse, views)
        start = _weighed(between, fit)
        near = _descended(between, start, _answers(between, fit, views, columns), NEARLY, looks, np.inf)
        fit = _weighed(study, near)
        views, columns = see_from(study, fit)
    return _descended(study, fit, _answers(study, fit, views, columns), ENOUGH, looks, _good(base))


def _good(base: BaseFit) -> float:
    """The deviance of a refit that is worth more looks."""
    return max(base.fit.deviance, ASTRAY * base.fit.rows)


def _descended(study: Study, fit: Fit, answers: np.ndarray, enough: float, looks: int, good: float) -> Fit:
    """A fit fitted by its answers; where they no longer hold, they are taken anew from the fit itself."""
    for look in range(1, looks + 1):
        new, answers = _descend(study, fit, answers, enough)
        stuck, fit = look > 1 and new.deviance > fit.deviance - enough, new
        if fit.promised < enough or stuck or look == looks or (look >= LOOKS and fit.deviance > good):
            break
        answers = _answers(study, fit, *see_from(study, fit))
    return replace(fit, occam=_occam(_normal(fit, answers)[0], fit), courses=())


def _leap(base: BaseFit, start: tuple[Extra, ...]) -> Fit | None:
    """Where the linear equations put everything at once: a base parameter stretched by the cause goes back at once."""
    p = base.J.shape[1]
    absent = base.fit.with_extras(start)  # its residual is that without the extras
    try:
        S = _added_columns(base, absent)
        own = [k for k, (_, shape) in enumerate(absent.kinds) if not shape]
        plain = base.fit.with_extras([replace(e, shapes=()) for e in start])
        H, gradient = _normal(plain, np.column_stack([base.J, S[:, own]]))
        room = np.transpose([(-np.inf, np.inf)] * p + [_inside(e.candidate) for e in start])
        step = _step(H, gradient, room)
        extras = tuple(replace(e, excess=float(a)) for e, a in zip(start, step[p:], strict=True))
        return evaluate(base.study, base.fit.point + step[:p], extras)
    except (SolveError, InputError):
        return None


def _with_added(base: BaseFit, fit: Fit) -> tuple[Fit, np.ndarray] | None:
    """A fit with the base's answers to what it fits; None where no valve has its extras at the base's own figures."""
    try:
        return fit, np.column_stack([base.J, _added_columns(base, fit)])
    except InputError:
        return None


def _inside(candidate: Candidate) -> tuple[float, float]:
    """The limits of an excess while it is fitted: never quite off, for there a step would not see where to go."""
    low, high = candidate.limits
    return (FLOOR * candidate.typical if candidate.one_sided else EDGE * low), EDGE * high


def _bounds(extra: Extra, shape: str) -> tuple[float, float]:
    """Of a shape parameter."""
    return next(p.bounds for p in extra.candidate.shapes() if p.name == shape)


def _room(fit: Fit) -> np.ndarray:
    """(2, n): how far down and up each of a fit's `place` may go, base parameters freely."""
    room = [(-np.inf, np.inf)] * len(fit.point)
    for extra, shape in fit.kinds:
        if shape:
            times = np.clip(
                np.array(_bounds(extra, shape)) / dict(extra.shapes)[shape], 1.0 / SHAPE_STRIDE, SHAPE_STRIDE
            )
            room.append(tuple(np.log(times)))
        else:
            low, high = _inside(extra.candidate)
            room.append((low - extra.excess, high - extra.excess))
    return np.transpose(room)


def _step(H: np.ndarray, gradient: np.ndarray, room: np.ndarray) -> np.ndarray:
    """The step that lowers the deviance most inside the room: what would leave it goes to its limit, the rest along."""
    step, held = _solve(H, gradient), np.zeros(len(gradient), dtype=bool)
    while (beyond := ~held & ((step < room[0]) | (step > room[1]))).any():
        held |= beyond
        step = np.where(held, np.clip(step, *room), 0.0)
        step[~held] = _solve(H[np.ix_(~held, ~held)], (gradient - H @ step)[~held])
    return step


def _solve(H: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    scale = np.sqrt(np.where(np.diag(H) > 0.0, np.diag(H), 1.0))
    return np.linalg.lstsq(H / np.outer(scale, scale), gradient / scale, rcond=1e-12)[0] / scale


def _normal(fit: Fit, answers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, gradient) of base parameters, then of extras, with their priors."""
    p = len(fit.point)
    H = answers.T @ answers
    prior = np.array([1.0] * p + [0.0 if not shape else SHAPE_DEVIATION**-2 for _, shape in fit.kinds])
    gradient = answers.T @ fit.residual
    gradient[:p] -= fit.point
    for at, (extra, shape) in enumerate(fit.kinds):
        if shape:
            value, default = dict(zip((n for n, _ in extra.shapes), _against_default(extra), strict=True))[shape]
            gradient[p + at] -= np.log(value / default) / SHAPE_DEVIATION**2
    H[np.diag_indices_from(H)] += prior
    return H, gradient


def _occam(H: np.ndarray, fit: Fit) -> float:
    """Occam factor: ln det of the extras' posterior precision in units of their priors, base parameters out."""
    p, kinds = len(fit.point), fit.kinds
    scale = np.array([3.0 * e.candidate.typical if not shape else SHAPE_DEVIATION for e, shape in kinds])
    left = H[p:, p:] - H[p:, :p] @ np.linalg.solve(H[:p, :p], H[:p, p:])
    amplitude = np.array([1.0 if not shape else 0.0 for _, shape in kinds])
    scaled = left * np.outer(scale, scale) + np.diag(amplitude)
    sign, value = np.linalg.slogdet(scaled)
    return float(value) if sign > 0 else 0.0


def _moved(fit: Fit, step: np.ndarray) -> tuple[Extra, ...]:
    """The extras after a step of amplitudes and of logarithms of shapes."""
    excesses = {id(extra): extra.excess for extra in fit.extras}
    shapes = {id(extra): dict(extra.shapes) for extra in fit.extras}
    for (extra, shape), by in zip(fit.kinds, step, strict=True):
        if shape:
            value = shapes[id(extra)][shape] * np.exp(by)
            shapes[id(extra)][shape] = float(np.clip(value, *_bounds(extra, shape)))
        else:
            excesses[id(extra)] = float(np.clip(extra.excess + by, *_inside(extra.candidate)))
    return tuple(replace(e, excess=excesses[id(e)], shapes=tuple(shapes[id(e)].items())) for e in fit.extras)


def _added_columns(base: BaseFit, fit: Fit) -> np.ndarray:
    """Whitened answers (rows, kinds) of the base to each extra of a fit, a unit of its excess, and to its shapes."""
    study, origin = base.study, base.views[0].variant
    candidates, changed, divide = [], [], []
    for extra in fit.extras:
        size = extra.excess if abs(extra.excess) > 1e-3 * extra.candidate.typical else 1e-3 * extra.candidate.typical
        for name, value in (("", 0.0), *extra.shapes):
            shapes = dict(extra.shapes) | ({name: value * SHAPE_STEP} if name else {})
            candidates.append(extra.candidate)
            changed.append(extra.candidate.add_to(origin, size, **shapes))
            divide.append(0.0 if name else size)
    columns = study.stack(shown(study, base.views, base.columns, candidates, changed))
    out = np.empty_like(columns)
    own = 0
    for k, by in enumerate(divide):
        if by != 0.0:
            own = k
            out[:, k] = columns[:, k] / by
        else:
            out[:, k] = (columns[:, k] - columns[:, own]) / np.log(SHAPE_STEP)
    if len(fit.extras) == 1 and abs(fit.extras[0].excess) > 0.05 * fit.extras[0].candidate.typical:
        # what the fit has really gained by its one effect, over what the linear equations say of the base
        moved = base.fit.residual - base.J @ (fit.point - base.fit.point) - fit.residual
        secant = moved / fit.extras[0].excess
        if float(secant @ out[:, 0]) > 0.25 * float(out[:, 0] @ out[:, 0]):
            out[:, 0] = secant
    return out


def _answers(study: Study, fit: Fit, views: Sequence[View], columns: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
    """Whitened answers (rows, p and kinds) of a fit seen from itself, to all that is fitted of it (`Fit.place`)."""
    J = study.stack(columns)
    if not fit.extras:
        return J
    own = study.stack(own_columns(study, fit, views, columns))
    sizes = [np.log(SHAPE_STEP) if shape else own_step(extra) for extra, shape in fit.kinds]
    return np.column_stack([J, own / sizes])


def shown(
    study: Study, views: Sequence[View], columns: Sequence[dict[str, np.ndarray]],
    candidates: Sequence[Candidate], changed: Sequence[Variant],
) -> list[dict[str, np.ndarray]]:  # fmt: skip
    """The `candidate_columns` of all views; `columns` are those of the base parameters."""

    def columns_of(seen: View, known: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return candidate_columns(seen, candidates, changed, study.base, known)

    return study.each(columns_of, views, columns)


def own_columns(
    study: Study, fit: Fit, views: Sequence[View], columns: Sequence[dict[str, np.ndarray]]
) -> list[dict[str, np.ndarray]]:
    """What the `own_steps` of a fit show in views from it, each (n_samples, kinds) by channel."""
    steps = own_steps(fit)
    moved = [other.variant(study.base) for _, other in steps]
    return shown(study, views, columns, [candidate for candidate, _ in steps], moved)


def own_steps(fit: Fit) -> list[tuple[Candidate, Fit]]:
    """The fit with each of its extras moved a little: excess by `own_step`, then each shape by a tenth."""
    steps = []
    for k, extra in enumerate(fit.extras):
        moved = [replace(extra, excess=extra.excess + own_step(extra))]
        for j, (name, value) in enumerate(extra.shapes):
            shapes = (*extra.shapes[:j], (name, value * SHAPE_STEP), *extra.shapes[j + 1 :])
            moved.append(replace(extra, shapes=shapes))
        steps += [(extra.candidate, fit.with_extras((*fit.extras[:k], m, *fit.extras[k + 1 :]))) for m in moved]
    return steps


def own_step(extra: Extra) -> float:
    """The step of an excess: inwards, so that it stays inside its limits."""
    return (
        -0.05 * extra.excess if abs(extra.excess) > 1e-3 * extra.candidate.typical else 0.01 * extra.candidate.typical
    )


def gram_of(
    study: Study, views: Sequence[View], blocks: Sequence[Sequence[dict[str, np.ndarray]]], point: np.ndarray
) -> Gram:
    """The Gram of all views, two segments a record: `blocks[k]` are the columns of view k, beside its residual."""
    products, rows = [], []
    for seen, own in zip(views, blocks, strict=True):
        residual = residual_of(seen.bench.record, seen.readings)
        joined = {name: np.column_stack([residual[name], *(block[name] for block in own)]) for name in residual}
        parts = [np.array_split(white, SEGMENTS) for white in study.whiten(seen.bench, joined)]
        for k in range(SEGMENTS):
            products.append(sum(part[k].T @ part[k] for part in parts))
            rows.append(sum(len(part[k]) for part in parts))
    return Gram(np.array(products), np.asarray(point, dtype=float), tuple(rows))
