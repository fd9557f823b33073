"""The cheapest further test that tells two fitted hypotheses apart, designed within the valve's limits.

Both hypotheses are run under each test of a small library. What they differ by there counts only as far as refitting
one of them to the records of the session and of the new test together could not make it up.

Symbols
    delta whitened difference of the two predictions in the new test, A its sensitivities to what a refit moves (base
    parameters, amplitude, shapes), P the precision that the session has on these; n how often the test is repeated;
    m what A misses of the answer to the step of that refit: where answers are not linear, at a stop or a turn, they
    hang on what no model has right, and repeats do not tell it better; W = 1/(1/n + m^2) of each row
    d^2 = delta'W delta - delta'W A (P + A'W A)^-1 A'W delta: by so much the chi-square of the wrong one of the two will
    rise more than that of the true one, with deviation 2 d; of a test that is to be proposed no more than a refit by
    the simulation leaves (`joint_distance`). The first is ahead by b in the session already, by the chi-square and by
    the evidence, of which the one that helps less counts; w is what the answer set will ask for, no model is the plant:
    the more the first explains beyond the nominal model the more (of a test that is to be proposed by refits of that,
    too), and n e^2 s's besides, which the plant will do otherwise than any model of it; s what the readings move, e
    `DesignOptions.model_error`
    power = p Phi((d^2 + b - w)/(2 d)) + (1 - p) Phi((d^2 - b - w)/(2 d)), p the probability of the first by what it is
    ahead, tempered as the answer set is; of two of which one holds the other see `nested_power`: it can follow the
    other in any test, so that d is what the smaller of them leaves
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from valvesim.diagnosis.experiments import Experiment, experiment_values, library
from valvesim.diagnosis.joint_refit import joint_distance
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.power import nested_power, separation_power
from valvesim.diagnosis.result import NextTest
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit, moved_fit, predict_readings
from valvesim.identification.fit_jacobian import perturbed_fits, step_sizes
from valvesim.identification.jacobian import parameter_sensitivities, perturbed_variants
from valvesim.identification.linearised_record import linearise_record
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import RecordPredictor, prepare_record
from valvesim.identification.prior import measured_channels
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import Record, Session
from valvesim.identification.study import Study, each


@dataclass(frozen=True, eq=False)
class LinearisedRefit:
    """A fit in a new record: what it reads there, whitened sensitivities A (rows, k) to `Fit.vector`, and the precision
    (k, k) that the session has on that.
    """

    fit: Fit
    readings: dict[str, np.ndarray]
    A: np.ndarray
    known: np.ndarray

    def step(self, delta: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """The step (k,) of `Fit.vector` that explains most of a difference (rows,), at weights (rows,) of the rows."""
        weighted = self.A * weights[:, None]
        return inverse_of(self.known + weighted.T @ self.A) @ (weighted.T @ delta)

    def left(self, delta: np.ndarray, weights: np.ndarray) -> float:
        """The chi-square of a difference that such a step leaves."""
        weighted = weights * delta
        return max(float(weighted @ (delta - self.A @ self.step(delta, weights))), 0.0)


@dataclass(frozen=True, eq=False)
class SimulatedExperiment:
    """A trial of a fit on its predictor, beside the nominal one: what it reads there, and the chi-square `error` that
    the plant will leave of any model there.

    `known` are the precisions that the session has on the fit and on the nominal one.
    """

    study: Study
    trial: Experiment
    predictor: RecordPredictor
    fit: Fit
    readings: dict[str, np.ndarray]
    nominal: Fit
    error: float
    known: tuple[np.ndarray, np.ndarray]

    @cached_property
    def refit(self) -> LinearisedRefit:
        return _linearised_refit(self.study, self.predictor, self.fit, self.known[0])

    @cached_property
    def base_refit(self) -> LinearisedRefit:
        """That of the nominal model, by the sensitivities of the fit."""
        readings = _readings(self.study, self.predictor, self.nominal)
        return LinearisedRefit(self.nominal, readings, self.refit.A[:, : len(self.fit.point)], self.known[1])

    def explained(self, repeats: int) -> float:
        """By how much more the fit explains than the nominal model, fitted again by linear answers."""
        distance = _distance(self, self.base_refit, -self.beyond_nominal, repeats)
        return min(distance**2, self.most_explained(repeats))

    def most_explained(self, repeats: int) -> float:
        """The most that counts of it: what noise has in session and experiment together, less what the fit explains of
        the session, for a fall beyond that is no measure.
        """
        left_of_session = self.fit.rows - (self.nominal.chi_square - self.fit.chi_square)
        return float(repeats * len(self.beyond_nominal) + max(left_of_session, 0.0))

    @cached_property
    def beyond_nominal(self) -> np.ndarray:
        """What the nominal model reads there more, white (rows,)."""
        return self.beyond(self.nominal)

    def beyond(self, fit: Fit) -> np.ndarray:
        """What another fit reads there more, white (rows,)."""
        return _difference(self.study, self.predictor, _readings(self.study, self.predictor, fit), self.readings)


@dataclass(frozen=True, eq=False)
class ExperimentPower:
    """A trial replicated: the distance that a refit leaves, and what `more` the likeliest explains then; `is_refitted`
    where that is by simulation and not by linear answers.
    """

    trial: Experiment
    repeats: int
    distance: float
    power: float
    more: float = 0.0
    is_refitted: bool = False

    @property
    def duration(self) -> float:
        return self.repeats * float(self.trial.time[-1])


Explained = Callable[[SimulatedExperiment, int], float]


def explained_by_refits(nominal: NominalFit) -> Explained:
    """`SimulatedExperiment.explained` of a trial and a number of repeats, once the nominal model is refitted to session
    and experiment together; the most that counts where that cannot be simulated. It is worked out once of each.
    """

    @cache
    def explained(tried: SimulatedExperiment, repeats: int) -> float:
        most = tried.most_explained(repeats)
        with suppress(SolveError, InputError):
            left = joint_distance(nominal, tried.predictor, tried.fit, tried.nominal, repeats, most=np.sqrt(most))
            most = min(left**2, most)
        return most

    return explained


def simulate_library(
    nominal: NominalFit, first: Fit, *, options: DiagnosisOptions
) -> tuple[SimulatedExperiment, ...]:
    """The tests of the library that can be run, under a fit."""
    study = nominal.study
    known = _known(nominal, first), _known(nominal, nominal.fit)

    def simulate(trial: Experiment) -> SimulatedExperiment | None:
        try:
            return _simulated(nominal, trial, first, known, options=options)
        except (SolveError, InputError):
            return None

    return tuple(one for one in each(simulate, library(study.session, options=options)) if one is not None)


@dataclass(frozen=True, eq=False)
class Rival:
    """A hypothesis to be told from the likeliest: `power` by distance, by what the likeliest explains more in a test,
    and by what any model errs there; `refitted` tells which of both may follow the other, the likeliest first.
    """

    label: str
    fit: Fit
    power: Callable[[float, float, float], float]
    refitted: tuple[bool, bool] = (True, True)


def rival_beside(
    first: Fit,
    label: str,
    second: Fit,
    asked: Callable[[float], float],
    ahead: float | None = None,
    both: float = 0.0,
    *,
    options: DiagnosisOptions,
) -> Rival:
    """A rival of another cause than the first's. `asked(more)` is the difference of chi-squares that tells them apart
    where the first explains so much more than in this session, and asked of the evidence likewise, in which the first
    is `ahead` by so much (if it is not given, as in the chi-square). `both` is the probability that the two causes act
    together, of which no experiment leaves one.
    """
    from scipy.special import expit

    by_fit = second.chi_square - first.chi_square
    lead = sorted((by_fit, by_fit if ahead is None else ahead))
    temperature = asked(0.0) / options.selection.answer_ratio
    probability = float(expit(by_fit / (2.0 * temperature)))

    def power(distance: float, more: float, error: float) -> float:
        return (1.0 - both) * separation_power(distance, asked(more) + error, (lead[0], lead[1]), probability)

    return Rival(label, second, power)


def nested_rival(
    first: Fit, label: str, second: Fit, levels: Callable[[float], tuple[float, float, float]], *, is_larger: bool
) -> Rival:
    """A rival that has all that the first has and more, or the other way about. `levels(more)` is what the larger must
    explain beyond the smaller to stand alone, to be as likely, and to stand at all.
    """
    from scipy.special import expit

    gain = (first.chi_square - second.chi_square) * (1.0 if is_larger else -1.0)
    probability = float(expit((gain - levels(0.0)[1]) / 2.0))

    def power(distance: float, more: float, error: float) -> float:
        alone, _, beside = levels(more)
        return nested_power(distance, gain, alone + error, beside, probability)

    return Rival(label, second, power, (is_larger, not is_larger))


def design(
    nominal: NominalFit,
    trials: Sequence[SimulatedExperiment],
    label: str,
    rival: Rival,
    explained: Explained | None = None,
    *,
    options: DiagnosisOptions,
) -> NextTest | None:
    """The shortest of the `trials` of a fit, by its label, that tells it from a rival with a power of 0.95, else the
    most powerful, whatever its power. What they explain (`explained_by_refits`) may be shared with other rivals.

    None where no test can be run.
    """
    study, explained = nominal.study, explained or explained_by_refits(nominal)
    run = [pair for pair in each(lambda one: _beyond(one, rival.fit), trials) if pair is not None]
    if not run:
        return None
    run = _most_promising(run, rival.power, options=options)
    known = _known(nominal, rival.fit)
    shortest = min(float(one.trial.time[-1]) for one, _ in run)
    chosen, tried = list[ExperimentPower](), [one for one, _ in run]

    def is_found() -> bool:
        return any(each.power >= options.design.power and each.duration <= shortest for each in chosen)

    for one, delta in run:
        chosen += _judge(one, delta, rival, known, options=options)
        if is_found():
            chosen = _with_best_refitted(nominal, tried, chosen, rival, explained, options=options)
            if is_found():
                break  # none is shorter
    chosen = _with_best_refitted(nominal, tried, chosen, rival, explained, options=options)
    best = _chosen([one for one in chosen if one.is_refitted] or chosen, options=options)
    best = best or ExperimentPower(run[0][0].trial, 1, 0.0, 0.0)
    others = dict.fromkeys(
        one.trial.description for one in sorted(chosen, key=lambda one: -one.power)
        if one.trial is not best.trial and one.power >= min(options.design.power, best.power)
    )  # fmt: skip
    return NextTest(
        description=best.trial.description + (f", {best.repeats} times" if best.repeats > 1 else ""),
        settings=_settings(study.session, best),
        duration=best.duration,
        separates=(label, rival.label),
        distance=best.distance,
        power=best.power,
        alternatives=tuple(others),
        inputs=experiment_inputs(study.session, best),
        uninformative=best.power < options.design.uninformative_power,
    )


def experiment_inputs(session: Session, judged: ExperimentPower) -> dict[str, np.ndarray]:
    """Columns of the whole test, (n,) each, in SI and °C: time, command, oil temperature, pressures."""
    trial, n = judged.trial, judged.repeats
    values = experiment_values(session, trial)
    step = float(trial.time[1])
    tiled = {name: np.concatenate([*([column[:-1]] * (n - 1)), column]) for name, column in values.items()}
    return {"time": step * np.arange(n * (len(trial.time) - 1) + 1), **tiled}


def experiment_record(session: Session, trial: Experiment) -> Record:
    channels = measured_channels(session)
    n = len(trial.time)
    values = {**{name: np.zeros(n) for name in channels}, **experiment_values(session, trial)}
    return Record(trial.description, trial.time, values, {name: np.ones(n, dtype=bool) for name in channels})


def _beyond(tried: SimulatedExperiment, second: Fit) -> tuple[SimulatedExperiment, np.ndarray] | None:
    """A trial and what the second fit reads there more, white (rows,); None where that cannot be run."""
    try:
        return tried, tried.beyond(second)
    except (SolveError, InputError):
        return None


def _most_promising(
    run: Sequence[tuple[SimulatedExperiment, np.ndarray]],
    power: Callable[[float, float, float], float],
    *,
    options: DiagnosisOptions,
) -> list[tuple[SimulatedExperiment, np.ndarray]]:
    """The trials that are worth examining: those that would do if nothing were refitted, largest differences first; or
    else the one that shows most.
    """

    def most(one: SimulatedExperiment, delta: np.ndarray) -> float:
        plain = float(np.linalg.norm(delta))
        return max(power(np.sqrt(n) * plain, 0.0, n * one.error) for n in options.design.replicates)

    run = sorted(run, key=lambda pair: -float(pair[1] @ pair[1]))
    return [pair for pair in run if most(*pair) >= options.design.least_power][: options.design.examined] or run[:1]


def _chosen(judged: Sequence[ExperimentPower], *, options: DiagnosisOptions) -> ExperimentPower | None:
    """The shortest whose power is enough, or else hardly less than the best's."""
    enough = min(options.design.power, max((one.power for one in judged), default=0.0) - options.design.power_margin)
    able = [one for one in judged if one.power >= enough]
    return min(able, key=lambda one: (one.duration, -one.power), default=None)


def _with_best_refitted(
    nominal: NominalFit,
    tried: Sequence[SimulatedExperiment],
    judged: Sequence[ExperimentPower],
    rival: Rival,
    explained: Explained,
    *,
    options: DiagnosisOptions,
) -> list[ExperimentPower]:
    """The judged with the best of them by refits of session and experiment together, so far as that is worth the time;
    others of its trial are taken to keep the same share of their distances.
    """
    known = list(judged)
    while sum(one.is_refitted for one in known) < options.design.refitted and not nominal.study.is_long:
        best = _chosen(known, options=options)
        if best is None or best.is_refitted or best.power < options.design.uninformative_power:
            break
        of_trial = next(one for one in tried if one.trial is best.trial)
        found = _refitted(nominal, of_trial, best, rival, explained, options=options)
        share, grows = found.distance / best.distance, found.more / best.more if best.more > 0.0 else 1.0
        for k, one in enumerate(known):
            if one is best:
                known[k] = found
            elif one.trial is best.trial and not one.is_refitted:
                known[k] = _experiment_power(of_trial, one.repeats, share * one.distance, grows * one.more, rival)
    return known


def _refitted(
    nominal: NominalFit,
    tried: SimulatedExperiment,
    judged: ExperimentPower,
    rival: Rival,
    explained: Explained,
    *,
    options: DiagnosisOptions,
) -> ExperimentPower:
    """A judged trial by refits of session and experiment together, of the nominal model and of whichever of the two may
    follow the other, while any power is left; none where one of the two cannot be refitted.
    """
    n, fits = judged.repeats, (tried.fit, rival.fit)

    def refitted(distance: float, more: float) -> ExperimentPower:
        return replace(_experiment_power(tried, n, distance, more, rival), is_refitted=True)

    found = refitted(judged.distance, explained(tried, n))
    for wrong, true, may_follow in zip(fits, reversed(fits), rival.refitted, strict=True):
        if not may_follow or found.power < options.design.uninformative_power:
            continue
        try:
            left = joint_distance(nominal, tried.predictor, true, wrong, n, most=found.distance)
            distance = min(found.distance, left)
        except (SolveError, InputError):
            return replace(found, distance=0.0, power=0.0)
        found = refitted(distance, found.more)
    return found


def _experiment_power(
    tried: SimulatedExperiment, repeats: int, distance: float, more: float, rival: Rival
) -> ExperimentPower:
    power = rival.power(distance, more, repeats * tried.error)
    return ExperimentPower(tried.trial, repeats, distance, power, more)


def _simulated(
    nominal: NominalFit,
    trial: Experiment,
    first: Fit,
    known: tuple[np.ndarray, np.ndarray],
    *,
    options: DiagnosisOptions,
) -> SimulatedExperiment:
    """A trial of a fit, with a command so small that the flapper keeps off the nozzles: these are not to be struck, and
    no model has that right. Raises SolveError, InputError where it cannot be run.
    """
    study, variant, most = nominal.study, first.variant(nominal.study.nominal), options.design.flapper_reach
    predictor = _prepared(study, trial, options=options)
    trajectory = predictor.run(variant)
    for _ in range(options.design.scalings):
        if trajectory.flapper_reach <= most:
            break
        trial = trial.scaled(min(most / trajectory.flapper_reach, options.design.scaling))
        predictor = _prepared(study, trial, options=options)
        trajectory = predictor.run(variant)
    readings = predictor.readings(trajectory, variant)
    still = {name: np.full_like(column, column.mean()) for name, column in readings.items()}
    motion = _difference(study, predictor, readings, still)
    error = options.design.model_error**2 * float(motion @ motion)
    return SimulatedExperiment(study, trial, predictor, first, readings, nominal.fit, error, known)


def _prepared(study: Study, trial: Experiment, *, options: DiagnosisOptions) -> RecordPredictor:
    record, universe = experiment_record(study.session, trial), study.predictors[0].universe
    return prepare_record(study.session, record, universe, options=options.identification)


def _difference(
    study: Study, predictor: RecordPredictor, readings: dict[str, np.ndarray], other: dict[str, np.ndarray]
) -> np.ndarray:
    """What a new record's readings differ from others, white (rows,)."""
    columns = {name: (readings[name] - other[name])[:, None] for name in readings}
    return study.whiten_other(predictor.record, columns)[:, 0]


def _known(nominal: NominalFit, fit: Fit) -> np.ndarray:
    """The precision that the session has on `Fit.vector`."""
    study, columns = nominal.study, []
    for _, moved in perturbed_fits(fit, options=study.options):
        pairs = zip(predict_readings(study, moved.variant(study.nominal)), fit.readings, strict=True)
        columns.append(study.stack([{name: (new[name] - old[name])[:, None] for name in new} for new, old in pairs]))
    A = _with_fitted(nominal.J, columns, fit, options=study.options)
    shape_prior = [study.options.fit.shape_deviation**-2 if shape else 0.0 for _, shape in fit.layout]
    return A.T @ A + np.diag([*np.ones(nominal.J.shape[1]), *shape_prior])


def _with_fitted(
    J: np.ndarray, columns: Sequence[np.ndarray], fit: Fit, *, options: IdentificationOptions
) -> np.ndarray:
    """Sensitivities (rows, k) to `Fit.vector`: those to nuisance parameters, and by the answers to `perturbed_fits`."""
    if not columns:
        return J
    return np.column_stack([J, np.column_stack(columns) / step_sizes(fit, options=options)])


def _judge(
    tried: SimulatedExperiment, delta: np.ndarray, rival: Rival, known: np.ndarray, *, options: DiagnosisOptions
) -> list[ExperimentPower]:
    """A trial repeated: the smaller of the distances that remain of a difference (rows,) when either fit is refitted.
    The rival is not, where the first leaves too little already. Of the numbers of repeats the least and the most, and
    where either tells something those between up to the first that is enough.
    """
    useful = options.design.uninformative_power

    @cache
    def refit_of_rival() -> LinearisedRefit:
        return _linearised_refit(tried.study, tried.predictor, rival.fit, known)

    def repeated(n: int) -> ExperimentPower:
        more, distance = tried.explained(n), np.inf
        if rival.refitted[0]:
            distance = _distance(tried, tried.refit, delta, n)
        if rival.refitted[1] and (
            np.isinf(distance) or _experiment_power(tried, n, distance, more, rival).power >= useful
        ):
            distance = min(distance, _distance(tried, refit_of_rival(), -delta, n))
        return _experiment_power(tried, n, distance, more, rival)

    least, *more = options.design.replicates
    try:
        found = [repeated(least)]
        if found[0].power >= options.design.power or not more:
            return found
        last = repeated(more[-1])
        if max(found[0].power, last.power) >= useful:
            for n in more[:-1]:
                found.append(repeated(n))
                if found[-1].power >= options.design.power:
                    break
    except (SolveError, InputError):
        return []
    return [*found, last]


def _linearised_refit(
    study: Study, predictor: RecordPredictor, fit: Fit, known: np.ndarray
) -> LinearisedRefit:
    variant = fit.variant(study.nominal)
    linear = linearise_record(predictor, variant)
    perturbed = perturbed_variants(study.nominal, variant)
    J = study.whiten_other(predictor.record, parameter_sensitivities(linear, study.nominal, perturbed))
    readings, columns = _readings(study, predictor, fit), []
    for _, moved in perturbed_fits(fit, options=study.options):
        columns.append(_difference(study, predictor, _readings(study, predictor, moved), readings))
    return LinearisedRefit(fit, readings, _with_fitted(J, columns, fit, options=study.options), known)


def _readings(study: Study, predictor: RecordPredictor, fit: Fit) -> dict[str, np.ndarray]:
    variant = fit.variant(study.nominal)
    return predictor.readings(predictor.run(variant), variant)


def _distance(
    tried: SimulatedExperiment, refit: LinearisedRefit, delta: np.ndarray, repeats: int
) -> float:
    """d of a difference (rows,) in a test that is repeated, once a fit is refitted."""
    step = refit.step(delta, np.full(len(delta), float(repeats)))
    try:
        moved = moved_fit(refit.fit, step, options=tried.study.options)
        readings = _readings(tried.study, tried.predictor, moved)
    except (SolveError, InputError):  # no valve has these figures: linear answers tell nothing
        return 0.0
    missed = _difference(tried.study, tried.predictor, readings, refit.readings) - refit.A @ step
    return float(np.sqrt(refit.left(delta, 1.0 / (1.0 / repeats + missed**2))))


def _settings(session: Session, judged: ExperimentPower) -> dict[str, str]:
    trial = judged.trial
    values = experiment_values(session, trial)
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
