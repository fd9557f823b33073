"""What every test would show of every parameter and cause on every sensor: products of whitened sensitivities.

The products of a choice of tests, repeats and sensors are sums of these, so that any choice is judged without another
simulation. Sensitivities, whitening and projection are those of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.experiments import Experiment, experiment_values
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS, DiagnosisOptions
from valvesim.diagnosis.score_test import search_size
from valvesim.errors import InputError, SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit_jacobian import all_candidate_sensitivities, linearise_study
from valvesim.identification.noise_model import NoiseModel
from valvesim.identification.prior import NominalModel
from valvesim.identification.projection import GramMatrix
from valvesim.identification.session import Record, Sensor, Session
from valvesim.identification.study import Study, prepare_session
from valvesim.planning.bench import BenchPlan
from valvesim.simulation.temperature_knots import between


@dataclass(frozen=True, eq=False)
class PlannedSensitivities:
    """Products of all tests: `products[test][channel]` (m, m) of [J (p), S (q)], J in prior standard deviations and S
    at the candidates' `sizes` (q,).

    `left_out` says which tests cannot be run, and why. `spans[channel]` is how far a channel goes in any test, and
    `readings[test]` (n,) by channel what the nominal valve would read.
    """

    nominal: NominalModel
    candidates: tuple[Candidate, ...]
    sizes: np.ndarray
    experiments: tuple[Experiment, ...]
    products: tuple[dict[str, np.ndarray], ...]
    spans: dict[str, float]
    left_out: tuple[str, ...]

    def gram(self, repeats: Sequence[int], channels: Sequence[str]) -> GramMatrix:
        """The products of so many repeats of each test on these channels, beside a residual of zero."""
        p, q = len(self.nominal.parameters), len(self.candidates)
        total = np.zeros((1 + p + q, 1 + p + q))
        for count, by_channel in zip(repeats, self.products, strict=True):
            if count:
                for name in channels:
                    total[1:, 1:] += count * by_channel[name]
        return GramMatrix(total[None], np.zeros(p), (1,))


def planned_sensitivities(
    plan: BenchPlan,
    progress: Callable[[float], None] = lambda share: None,
    *,
    options: DiagnosisOptions = DEFAULT_DIAGNOSIS,
) -> PlannedSensitivities:
    """Linearise every test about the nominal valve. Raises InputError where none can be run."""
    sensors = {s.channel: s for s in (*plan.sensors, *(one.sensor for one in plan.added))}
    session = replace(plan.session, sensors=sensors)
    runs, left_out = [], []
    for k, experiment in enumerate(plan.experiments):
        progress(0.3 * k / len(plan.experiments))
        try:
            record = planned_record(session, experiment, tuple(sensors), plan.thermometers, options=options)
            runs.append((experiment, record))
        except (SolveError, InputError) as error:
            left_out.append(f"{experiment.description}: {error}")
    if not runs:
        raise InputError(f"none of the tests can be run: {left_out[0]}", key="tests")
    session = replace(session, records=tuple(record for _, record in runs))
    prepared = prepare_session(session, options=options.identification)
    study = prepared.with_noise(
        {(name, record.pace): white_noise(sensors[name]) for record in session.records for name in sensors}
    )
    variant = study.nominal.variant
    linearised, J = linearise_study(study, variant)
    progress(0.6)
    candidates = study.candidates
    sizes = np.array([search_size(c, options=options.identification) for c in candidates])
    changed = [c.apply_to(variant, size) for c, size in zip(candidates, sizes, strict=True)]
    S = all_candidate_sensitivities(study, linearised, J, candidates, changed)
    progress(0.95)
    products = tuple(_products(study, record, j, s) for record, j, s in zip(session.records, J, S, strict=True))
    spans = {name: max(float(np.ptp(record.values[name])) for record in session.records) for name in sensors}
    experiments = tuple(experiment for experiment, _ in runs)
    return PlannedSensitivities(study.nominal, candidates, sizes, experiments, products, spans, tuple(left_out))


def white_noise(sensor: Sensor) -> NoiseModel:
    """White noise as it is stated, with the rounding of the resolution."""
    deviation = float(np.hypot(sensor.noise or 0.0, sensor.resolution / np.sqrt(12.0)))
    return NoiseModel(deviation, (), True, "stated")


def planned_record(
    session: Session,
    experiment: Experiment,
    channels: Sequence[str],
    thermometers: Sequence[str] = (),
    *,
    options: DiagnosisOptions,
) -> Record:
    """The record that a test would give of the nominal valve, without noise, parts with thermometers included."""
    from valvesim.identification.predictor import ModelVariant, prepare_record

    n = len(experiment.time)
    usable = {name: np.ones(n, dtype=bool) for name in channels}
    values = {**{name: np.zeros(n) for name in channels}, **experiment_values(session, experiment)}
    record = Record(experiment.description, experiment.time, values, usable)
    alone = replace(session, records=(record,))
    predictor = prepare_record(alone, record, (), options=options.identification)
    variant = ModelVariant(session.valve, session.effects)
    readings = predictor.readings(predictor.run(variant), variant)
    at = predictor.path.times
    courses = {part: np.broadcast_to(getattr(predictor.path.parts, part), at.shape) for part in thermometers}
    parts = {f"{part}_temperature": between(record.time, at, own[:, None])[0] for part, own in courses.items()}
    return replace(record, values={**values, **parts, **{name: np.asarray(readings[name]) for name in channels}})


def _products(
    study: Study, record: Record, J: Mapping[str, np.ndarray], S: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Products of the whitened columns of one test, by channel."""
    found = {}
    for name in record.outputs:
        white = study.noise[name, record.pace].whiten(np.column_stack([J[name], S[name]]), record.usable[name])
        found[name] = white.T @ white
    return found
