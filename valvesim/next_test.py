"""The cheapest further test that tells two fitted hypotheses apart, designed within the valve's limits.

Both hypotheses are run under each test of a small library. What they differ by there counts only as far as refitting
one of them to the records of the session and of the new test together could not make it up.

Symbols
    delta whitened difference of the two predictions in the new test, A its answers to what a refit moves (base
    parameters, amplitude, shapes), P the precision that the session has on these; n how often the test is repeated
    d^2 = n delta'delta - n delta'A (P/n + A'A)^-1 A'delta;  power = Phi((d^2 - w)/(2 d)): the likelihood ratio of
    two hypotheses d apart is normal with mean d^2 and deviation 2 d, and w is what the answer set will ask for: no
    model is the plant, so the more there is to explain, the more
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .answer import NextTest
from .errors import InputError, SolveError
from .evidence import inverse_of
from .hypotheses import measured, neighbours, parameter_columns, view
from .noise import Noise
from .prediction import Bench, Variant, prepare
from .session import Record, Session
from .study import SHAPE_DEVIATION, SHAPE_STEP, BaseFit, Fit, Study, each, own_steps, predict

RATE = 1000.0  # Hz
ENOUGH, LEAST = 0.95, 0.8  # power that a test should have, and below which it is not worth a day on the rig
REPEATS = (1, 2, 4, 8, 16)
LOOKED_AT = 3  # tests of which refits are thought through: those whose plain differences are largest
FULL, CHIRP, SMALL = 0.9, 0.45, 0.06  # of the rated current
LOW_SUPPLY, LOAD = 0.4, 0.35  # of the nominal supply pressure
WIDER = 10.0  # K by which the oil may leave the range of the session ...
COLDEST, HOTTEST = 0.0, 90.0  # ... inside these


@dataclass(frozen=True, eq=False)
class Trial:
    """A test: `shape` (n,) of the command in shares of the rated one, `oil` (n,) °C, pressures Pa, `time` (n,) s."""

    description: str
    time: np.ndarray
    shape: np.ndarray
    oil: np.ndarray
    supply: float
    load: float


@dataclass(frozen=True, eq=False)
class _Tried:
    """A trial on its bench, and what the second fit and the base read there less what the first does, white (rows,)."""

    trial: Trial
    bench: Bench
    second: np.ndarray
    base: np.ndarray


@dataclass(frozen=True, eq=False)
class _Judged:
    trial: Trial
    repeats: int
    distance: float
    power: float

    @property
    def duration(self) -> float:
        return self.repeats * float(self.trial.time[-1])


def design(
    base: BaseFit, first: Fit, second: Fit, labels: tuple[str, str], asked: Callable[[float], float]
) -> NextTest | None:
    """The shortest test that tells two fits apart with a power of 0.95, else the most powerful; None below 0.8.

    `labels` are the names of the two hypotheses, as the answer has them; `asked(more)` the difference of deviances that
    tells them apart where the first explains so much more than in this session.
    """
    study = base.study
    trials = library(study.session)
    variants = [fit.variant(study.base) for fit in (first, second, base.fit)]
    universe = study.benches[0].universe
    run = [one for one in each(lambda t: _differ(study, t, universe, variants), trials) if one is not None]
    run.sort(key=lambda one: -float(one.second @ one.second))
    furthest = np.sqrt(max(REPEATS))
    run = [one for one in run[:LOOKED_AT] if _power(furthest * float(np.linalg.norm(one.second)), asked(0.0)) >= LEAST]
    if not run:  # not even where nothing is refitted
        return None
    fits = (first, second, base.fit)
    known = [_known(base, fit) for fit in fits]
    chosen = [judged for one in run for judged in _judge(study, one, fits, known, asked)]
    enough = [one for one in chosen if one.power >= ENOUGH]
    if enough:
        best = min(enough, key=lambda one: (one.duration, -one.power))
    else:
        best = max(chosen, key=lambda one: (one.power, -one.duration), default=_Judged(run[0].trial, 1, 0.0, 0.0))
    if best.power < LEAST:
        return None
    others = dict.fromkeys(
        one.trial.description for one in sorted(chosen, key=lambda one: -one.power)
        if one.trial is not best.trial and one.power >= min(ENOUGH, best.power)
    )  # fmt: skip
    return NextTest(
        description=best.trial.description + (f", {best.repeats} times" if best.repeats > 1 else ""),
        settings=_settings(study.session, best),
        duration=best.duration,
        separates=labels,
        distance=best.distance,
        power=best.power,
        alternatives=tuple(others),
        inputs=_inputs(study.session, best),
    )


# ---------------------------------------------------------------- the library


def library(session: Session) -> tuple[Trial, ...]:
    """The tests that are thought of for a session: commands within the rated current, supply at most nominal."""
    lowest, usual, highest = _oil_range(session)
    supply = float(session.valve.supply_pressure)
    rng = np.random.default_rng(session.seed)
    found = []

    def add(description: str, duration: float, shape: Callable[[np.ndarray], np.ndarray], *, supply: float = supply,
            load: float = 0.0, oil: tuple[float, float] = (usual, usual)) -> None:  # fmt: skip
        time = np.linspace(0.0, duration, int(round(duration * RATE)) + 1)
        warm = np.interp(time, [0.0, 0.8 * duration], oil)
        found.append(Trial(description, time, shape(time), warm, supply, load))

    def full(t: np.ndarray) -> np.ndarray:
        return FULL * _triangle(t, 0.5)

    chirp, steps = _chirp(CHIRP), _random_steps(rng)
    add("fast chirp of medium size, 2 to 150 Hz", 1.0, chirp)
    add("slow full triangle", 2.0, full)
    add("slow small triangle about null", 2.0, lambda t: SMALL * _triangle(t, 1.0))
    add("filtered random steps", 1.0, steps)
    add("fast chirp at low supply pressure", 1.0, chirp, supply=LOW_SUPPLY * supply)
    add("slow full triangle at low supply pressure", 2.0, full, supply=LOW_SUPPLY * supply)
    add("slow full triangle under load pressure", 2.0, full, load=LOAD * supply)
    add("holds with small releases", 2.0, _holds)
    add("filtered random steps in cold oil", 1.0, steps, oil=(lowest, lowest))
    add("filtered random steps in hot oil", 1.0, steps, oil=(highest, highest))
    if session.thermal.network is not None:
        add("sine while the oil warms up", 4.0, lambda t: CHIRP * np.sin(2.0 * np.pi * 5.0 * t), oil=(lowest, highest))
    return tuple(found)


def _oil_range(session: Session) -> tuple[float, float, float]:
    """The coldest, the usual and the hottest oil that a test may ask for, °C."""
    oils = [r.values["oil_temperature"] for r in session.records if "oil_temperature" in r.values]
    seen = np.concatenate(oils) if oils else np.array([20.0])
    low, high = float(seen.min()), float(seen.max())
    return min(max(low - WIDER, COLDEST), low), float(np.median(seen)), max(min(high + WIDER, HOTTEST), high)


def _triangle(t: np.ndarray, frequency: float) -> np.ndarray:
    return 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * frequency * t))


def _chirp(size: float, low: float = 2.0, high: float = 150.0) -> Callable[[np.ndarray], np.ndarray]:
    def shape(t: np.ndarray) -> np.ndarray:
        end = t[-1]
        phase = 2.0 * np.pi * low * end / np.log(high / low) * ((high / low) ** (t / end) - 1.0)
        return size * np.sin(phase) * np.minimum(1.0, (end - t) / (0.02 * end))

    return shape


def _random_steps(rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    levels = rng.uniform(-0.7, 0.7, 25)
    levels[[0, -1]] = 0.0

    def shape(t: np.ndarray) -> np.ndarray:
        from scipy.ndimage import gaussian_filter1d

        own = levels[np.minimum((t / t[-1] * len(levels)).astype(int), len(levels) - 1)]
        return gaussian_filter1d(own, 0.003 * RATE, mode="nearest")

    return shape


def _holds(t: np.ndarray) -> np.ndarray:
    """Level for a while, then a small step and back: what sticks shows as it lets go."""
    edges = [0.0, 0.5, 0.55, 1.0, 1.05, 1.5, 1.55, 1.95, 2.0]
    levels = np.interp(t, edges, [0.0, 0.0, 0.3, 0.3, -0.3, -0.3, 0.1, 0.1, 0.0])
    released = np.where(np.mod(t, 0.25) > 0.2, 0.02, 0.0)
    return levels + released * (t < t[-1] - 0.03)


# ---------------------------------------------------------------- how far apart


def _inputs(session: Session, judged: _Judged) -> dict[str, np.ndarray]:
    """Columns of the whole test, (n,) each, in SI and °C: time, command, oil temperature, pressures."""
    trial, n = judged.trial, judged.repeats
    values = _values(session, trial)
    step = float(trial.time[1])
    tiled = {name: np.concatenate([*([column[:-1]] * (n - 1)), column]) for name, column in values.items()}
    return {"time": step * np.arange(n * (len(trial.time) - 1) + 1), **tiled}


def _values(session: Session, trial: Trial) -> dict[str, np.ndarray]:
    voltage = session.records[0].command == "voltage"
    rated = session.valve.rated_current * (session.valve.coil_resistance if voltage else 1.0)
    ones = np.ones(len(trial.time))
    return {
        "voltage" if voltage else "current": rated * trial.shape, "oil_temperature": trial.oil,
        "supply_pressure": trial.supply * ones, "load_pressure": trial.load * ones,
    }  # fmt: skip


def _record(session: Session, trial: Trial) -> Record:
    channels = measured(session)
    n = len(trial.time)
    values = {**{name: np.zeros(n) for name in channels}, **_values(session, trial)}
    return Record(trial.description, trial.time, values, {name: np.ones(n, dtype=bool) for name in channels})


def _differ(study: Study, trial: Trial, universe: Sequence, variants: Sequence[Variant]) -> _Tried | None:
    """A trial of the first variant, and how the second and the third differ there; None where it cannot be run."""
    try:
        bench = prepare(study.session, _record(study.session, trial), universe)
        one, *others = (bench.readings(bench.run(variant), variant) for variant in variants)
    except (SolveError, InputError):
        return None
    second, third = (
        _white(study, bench, {name: (other[name] - one[name])[:, None] for name in one})[:, 0] for other in others
    )
    return _Tried(trial, bench, second, third)


def _white(study: Study, bench: Bench, columns: dict[str, np.ndarray]) -> np.ndarray:
    """Whitened columns (rows, k) of a new record, by the noise of each channel at the nearest rate that it was seen."""
    record = bench.record

    def noise(channel: str) -> Noise:
        own = {rate: found for (name, rate), found in study.noise.items() if name == channel}
        return own[min(own, key=lambda rate: abs(float(np.log(rate / record.rate))))]

    known = {name for name, _ in study.noise}
    return np.concatenate([
        noise(name).whiten(columns[name], record.usable[name]) for name in record.outputs if name in known
    ])  # fmt: skip


def _known(base: BaseFit, fit: Fit) -> np.ndarray:
    """The precision that the session has on what a refit moves: base parameters, then each step of `own_steps`."""
    study = base.study
    columns = [base.J]
    for _, moved in own_steps(fit):
        pairs = zip(predict(study, moved.variant(study.base)), fit.readings, strict=True)
        columns.append(study.stack([{name: (new[name] - old[name])[:, None] for name in new} for new, old in pairs]))
    A = np.column_stack(columns)
    return A.T @ A + np.diag(np.concatenate([np.ones(base.J.shape[1]), _shape_prior(fit)]))


def _shape_prior(fit: Fit) -> np.ndarray:
    """The prior's precision on each step of `own_steps`: none on an excess, that of its logarithm on a shape."""
    return np.array([(np.log(SHAPE_STEP) / SHAPE_DEVIATION) ** 2 if shape else 0.0 for _, shape in fit.kinds])


def _judge(
    study: Study,
    tried: _Tried,
    fits: tuple[Fit, Fit, Fit],
    known: Sequence[np.ndarray],
    asked: Callable[[float], float],
) -> list[_Judged]:
    """A trial at each number of repeats: the smaller of the distances that remain when either fit is refitted.

    What remains when the third, the base, is refitted is what the first explains there.
    """
    bench, differences = tried.bench, (tried.second, tried.second, tried.base)
    try:
        variant = fits[0].variant(study.base)
        seen = view(bench, variant)
        J = _white(study, bench, parameter_columns(seen, study.base, neighbours(study.base, variant)))
        products = [_products(study, bench, fit, J, d) for fit, d in zip(fits, differences, strict=True)]
    except (SolveError, InputError):
        return []

    def left(n: int, k: int) -> float:
        (G, g), d = products[k], differences[k]
        return max(n * float(d @ d) - n * n * float(g @ inverse_of(known[k] + n * G) @ g), 0.0)

    found = []
    for n in REPEATS:
        distance = float(np.sqrt(min(left(n, 0), left(n, 1))))
        more = min(left(n, 2), float(n * len(tried.base)))  # a fall beyond the noise itself is no measure
        found.append(_Judged(tried.trial, n, distance, _power(distance, asked(more))))
    return found


def _power(distance: float, asked: float) -> float:
    """How surely two hypotheses that far apart are told apart where a difference of deviances is asked."""
    from scipy.stats import norm

    return float(norm.cdf((distance**2 - asked) / (2.0 * distance))) if distance > 0.0 else 0.0


def _products(study: Study, bench: Bench, fit: Fit, J: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(A'A, A'delta) of a new record's answers to what a refit moves."""
    variant = fit.variant(study.base)
    read = bench.readings(bench.run(variant), variant)
    columns = [J]
    for _, moved in own_steps(fit):
        other = moved.variant(study.base)
        new = bench.readings(bench.run(other), other)
        columns.append(_white(study, bench, {name: (new[name] - read[name])[:, None] for name in read}))
    A = np.column_stack(columns)
    return A.T @ A, A.T @ delta


# ---------------------------------------------------------------- in words


def _settings(session: Session, judged: _Judged) -> dict[str, str]:
    trial = judged.trial
    values = _values(session, trial)
    command, unit, by = ("voltage", "V", 1.0) if "voltage" in values else ("current", "mA", 1e3)
    low, high = float(values[command].min()) * by, float(values[command].max()) * by
    cold, hot = float(trial.oil[0]), float(trial.oil[-1])
    settings = {
        command: f"{low:.3g} to {high:.3g} {unit}",
        "oil_temperature": f"{cold:.0f} °C" if cold == hot else f"{cold:.0f} to {hot:.0f} °C",
        "supply_pressure": f"{trial.supply / 1e5:.0f} bar",
        "load_pressure": f"{trial.load / 1e5:.0f} bar",
    }
    return {**settings, "repeats": str(judged.repeats)} if judged.repeats > 1 else settings
