"""The cheapest further test that tells two fitted hypotheses apart, designed within the valve's limits.

Both hypotheses are run under each test of a small library. What they differ by there counts only as far as refitting
one of them to the records of the session and of the new test together could not make it up.

Symbols
    delta whitened difference of the two predictions in the new test, A its sensitivities to what a refit moves (base
    parameters, amplitude, shapes), P the precision that the session has on these; n how often the test is repeated
    d^2 = n delta'delta - n delta'A (P/n + A'A)^-1 A'delta: by so much the chi-square of the wrong one of the two will
    rise more than that of the true one, with deviation 2 d. The first is ahead by b in the session already; w is what
    the answer set will ask for: no model is the plant, so the more there is to explain, the more
    power = p Phi((d^2 + b - w)/(2 d)) + (1 - p) Phi((d^2 - b - w)/(2 d)), p the probability of the first by what it is
    ahead, tempered as the answer set is
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.experiments import Experiment, experiment_values, library
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.power import separation_power
from valvesim.diagnosis.result import NextTest
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit, predict_readings
from valvesim.identification.fit_jacobian import perturbed_fits
from valvesim.identification.jacobian import parameter_sensitivities, perturbed_variants
from valvesim.identification.linearised_record import linearise_record
from valvesim.identification.noise_model import NoiseModel
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import ModelVariant, RecordPredictor, prepare_record
from valvesim.identification.prior import measured_channels
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import Record, Session
from valvesim.identification.study import Study, each


@dataclass(frozen=True, eq=False)
class SimulatedExperiment:
    """A trial on its predictor, and what the second fit and the nominal model read there less what the first does,
    white (rows,).
    """

    trial: Experiment
    predictor: RecordPredictor
    second: np.ndarray
    nominal: np.ndarray


@dataclass(frozen=True, eq=False)
class ExperimentPower:
    trial: Experiment
    repeats: int
    distance: float
    power: float

    @property
    def duration(self) -> float:
        return self.repeats * float(self.trial.time[-1])


def design(
    nominal: NominalFit,
    first: Fit,
    second: Fit,
    labels: tuple[str, str],
    asked: Callable[[float], float],
    *,
    options: DiagnosisOptions,
) -> NextTest | None:
    """The shortest test that tells two fits apart with a power of 0.95, else the most powerful, whatever its power.

    None where no test can be run.

    `labels` are the names of the two hypotheses, as the answer has them; `asked(more)` the difference of chi-squares
    that tells them apart where the first explains so much more than in this session.
    """
    study = nominal.study
    trials = library(study.session, options=options)
    variants = [fit.variant(study.nominal) for fit in (first, second, nominal.fit)]
    universe = study.predictors[0].universe
    run = [
        one for one in each(lambda t: _differ(study, t, universe, variants, options=options), trials) if one is not None
    ]
    run.sort(key=lambda one: -float(one.second @ one.second))
    furthest = np.sqrt(max(options.design.replicates))
    if not run:
        return None
    power = _power_of(first, second, asked, options=options)
    run = [
        one
        for one in run[: options.design.examined]
        if power(furthest * float(np.linalg.norm(one.second)), 0.0) >= options.design.least_power
    ] or run[:1]  # not even where nothing is refitted: then the one that shows most
    fits = (first, second, nominal.fit)
    known = [_known(nominal, fit, options=options) for fit in fits]
    chosen = [judged for one in run for judged in _judge(study, one, fits, known, power, options=options)]
    enough = [one for one in chosen if one.power >= options.design.power]
    if enough:
        best = min(enough, key=lambda one: (one.duration, -one.power))
    else:
        best = max(
            chosen, key=lambda one: (one.power, -one.duration), default=ExperimentPower(run[0].trial, 1, 0.0, 0.0)
        )
    others = dict.fromkeys(
        one.trial.description for one in sorted(chosen, key=lambda one: -one.power)
        if one.trial is not best.trial and one.power >= min(options.design.power, best.power)
    )  # fmt: skip
    return NextTest(
        description=best.trial.description + (f", {best.repeats} times" if best.repeats > 1 else ""),
        settings=_settings(study.session, best),
        duration=best.duration,
        separates=labels,
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


def _power_of(
    first: Fit, second: Fit, asked: Callable[[float], float], *, options: DiagnosisOptions
) -> Callable[[float, float], float]:
    """The power by distance and by what the first explains more there."""
    from scipy.special import expit

    ahead = second.chi_square - first.chi_square
    temperature = asked(0.0) / options.selection.answer_ratio
    probability = float(expit(ahead / (2.0 * temperature)))
    return lambda distance, more: separation_power(distance, asked(more), ahead, probability)


def _differ(
    study: Study, trial: Experiment, universe: Sequence, variants: Sequence[ModelVariant], *, options: DiagnosisOptions
) -> SimulatedExperiment | None:
    """A trial of the first variant, and how the second and the third differ there; None where it cannot be run."""
    try:
        predictor = prepare_record(
            study.session, experiment_record(study.session, trial), universe, options=options.identification
        )
        one, *others = (predictor.readings(predictor.run(variant), variant) for variant in variants)
    except (SolveError, InputError):
        return None
    second, third = (
        _white(study, predictor, {name: (other[name] - one[name])[:, None] for name in one})[:, 0] for other in others
    )
    return SimulatedExperiment(trial, predictor, second, third)


def _white(study: Study, predictor: RecordPredictor, columns: dict[str, np.ndarray]) -> np.ndarray:
    """Whitened columns (rows, k) of a new record, by the noise of each channel at the nearest rate that it was seen."""
    record = predictor.record

    def noise(channel: str) -> NoiseModel:
        own = {rate: found for (name, rate), found in study.noise.items() if name == channel}
        return own[min(own, key=lambda rate: abs(float(np.log(rate / record.rate))))]

    known = {name for name, _ in study.noise}
    return np.concatenate([
        noise(name).whiten(columns[name], record.usable[name]) for name in record.outputs if name in known
    ])  # fmt: skip


def _known(nominal: NominalFit, fit: Fit, *, options: DiagnosisOptions) -> np.ndarray:
    """The precision that the session has on what a refit moves: nuisance parameters, then each step of
    `perturbed_fits`.
    """
    study = nominal.study
    columns = [nominal.J]
    for _, moved in perturbed_fits(fit, options=options.identification):
        pairs = zip(predict_readings(study, moved.variant(study.nominal)), fit.readings, strict=True)
        columns.append(study.stack([{name: (new[name] - old[name])[:, None] for name in new} for new, old in pairs]))
    A = np.column_stack(columns)
    return A.T @ A + np.diag(np.concatenate([np.ones(nominal.J.shape[1]), _shape_prior(fit, options=options)]))


def _shape_prior(fit: Fit, *, options: DiagnosisOptions) -> np.ndarray:
    """The prior's precision on each step of `perturbed_fits`: none on an amplitude above neutral, that of its
    logarithm on a shape.
    """
    return np.array(
        [
            (np.log(options.identification.sensitivity.shape_ratio) / options.identification.fit.shape_deviation) ** 2
            if shape
            else 0.0
            for _, shape in fit.layout
        ]
    )


def _judge(
    study: Study,
    tried: SimulatedExperiment,
    fits: tuple[Fit, Fit, Fit],
    known: Sequence[np.ndarray],
    power: Callable[[float, float], float],
    *,
    options: DiagnosisOptions,
) -> list[ExperimentPower]:
    """A trial at each number of repeats: the smaller of the distances that remain when either fit is refitted.

    What remains when the third, the nominal model, is refitted is what the first explains there.
    """
    predictor, differences = tried.predictor, (tried.second, tried.second, tried.nominal)
    try:
        variant = fits[0].variant(study.nominal)
        linear = linearise_record(predictor, variant)
        J = _white(
            study, predictor, parameter_sensitivities(linear, study.nominal, perturbed_variants(study.nominal, variant))
        )
        products = [
            _products(study, predictor, fit, J, d, options=options) for fit, d in zip(fits, differences, strict=True)
        ]
    except (SolveError, InputError):
        return []

    def left(n: int, k: int) -> float:
        (G, g), d = products[k], differences[k]
        return max(n * float(d @ d) - n * n * float(g @ inverse_of(known[k] + n * G) @ g), 0.0)

    found = []
    for n in options.design.replicates:
        distance = float(np.sqrt(min(left(n, 0), left(n, 1))))
        more = min(left(n, 2), float(n * len(tried.nominal)))  # a fall beyond the noise itself is no measure
        found.append(ExperimentPower(tried.trial, n, distance, power(distance, more)))
    return found


def _products(
    study: Study, predictor: RecordPredictor, fit: Fit, J: np.ndarray, delta: np.ndarray, *, options: DiagnosisOptions
) -> tuple[np.ndarray, np.ndarray]:
    """(A'A, A'delta) of a new record's sensitivities to what a refit moves."""
    variant = fit.variant(study.nominal)
    read = predictor.readings(predictor.run(variant), variant)
    columns = [J]
    for _, moved in perturbed_fits(fit, options=options.identification):
        other = moved.variant(study.nominal)
        new = predictor.readings(predictor.run(other), other)
        columns.append(_white(study, predictor, {name: (new[name] - read[name])[:, None] for name in read}))
    A = np.column_stack(columns)
    return A.T @ A, A.T @ delta


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
