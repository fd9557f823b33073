"""The gain on the hold-out records, opened once: errors of nominal and extended model, with bootstrap intervals.

Blocks of neighbouring samples are drawn, for these are alike (block bootstrap: Kuensch 1989).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.diagnosis.answer_tables import CHANNEL_UNITS
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import Gain, Trace
from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import EdgeDuration, EdgeTime, Wave
from valvesim.identification.fit import Fit
from valvesim.identification.input_choice import edge_parameter, edges_fitted
from valvesim.identification.input_waves import fitted_waves, settled, wave_parameters
from valvesim.identification.instrument_errors import errors_of_records, has_instrument_errors
from valvesim.identification.jacobian import parameter_sensitivities, perturbed_variants
from valvesim.identification.least_squares import bounded_step
from valvesim.identification.linearised_record import linearise_record
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import ModelVariant, RecordPredictor, Trajectory, prepare_record
from valvesim.identification.prior import NominalModel, NuisanceParameter
from valvesim.identification.session import Record
from valvesim.identification.study import Study, residual_of


def holdout_gain(
    nominal: NominalFit,
    before: Fit,
    extended: ModelVariant,
    readings: Sequence[dict[str, np.ndarray]],
    *,
    options: DiagnosisOptions,
) -> tuple[tuple[Gain, ...], bool, bool, tuple[Trace, ...], list[str]]:
    """Errors of nominal and extended model on the hold-out records, opened here and once; and traces of all records.

    The first flag tells whether a gain is claimed, the second whether the extended model is offered: where one is, or
    where nothing was held out. Last what could not be simulated, in words: then it is not offered.
    """
    study, session = nominal.study, nominal.study.session
    universe = study.predictors[0].universe
    variants = (before.variant(study.nominal), extended)
    gains, traces, pooled, failed = [], [], [], []
    for predictor, *reads in zip(study.predictors, before.readings, readings, strict=True):
        traces += traces_of(study, predictor.record, reads)
    for record in session.locked:
        record = settled(record, options=study.options) if fitted_waves(study.nominal) else record
        try:
            predictor = prepare_record(session, record, universe, options=options.identification)
            read, near = _read_with_inputs(study, predictor, variants[0])
            same = variants[1] == variants[0]  # without a cause nothing is extended
            reads = [read, read if same else _read_with_inputs(study, predictor, variants[1], near)[0]]
        except (InputError, SolveError) as reason:  # what was found in the others stands all the same
            failed.append(f"no gain is measured on a locked record that cannot be simulated: {reason}")
            continue
        traces += traces_of(study, record, reads)
        left = [residual_of(record, read) for read in reads]
        white = study.whiten_other(record, {name: np.column_stack([one[name] for one in left]) for name in left[0]})
        if not len(white):
            continue
        squares = white**2
        change = squares[:, 1] - squares[:, 0]
        pooled.append(change)
        error, extended_error = np.sqrt(squares.mean(axis=0))
        low, high = _change_interval(squares, session.seed, options=options)
        gains.append(
            Gain(record=record.name, before=float(error), after=float(extended_error), floor=1.0,
                 change=float(change.mean()), low=float(low), high=float(high), claimed=bool(high < 0.0))
        )  # fmt: skip
    means = _block_means(np.concatenate(pooled), session.seed) if pooled else None
    claimed = means is not None and bool(np.quantile(means, options.hold_out.interval[1]) < 0.0)
    offered = (claimed or means is None) and not failed
    return tuple(gains), claimed, offered, tuple(traces), failed


def _read_with_inputs(
    study: Study, predictor: RecordPredictor, variant: ModelVariant, near: np.ndarray | None = None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """What a variant reads in a locked record, its inputs fitted as those of the training records were: when its
    command jumped, or how its supply rippled, is nothing that a model of the valve could know. And these inputs (k,) in
    prior deviations; the fit begins `near` those of another variant, if they are known.
    """
    inputs, record = _own_parameters(study, predictor.record), predictor.record
    own = NominalModel(variant, inputs, options=study.options)
    point = np.zeros(len(inputs)) if near is None else near

    def left(
        point: np.ndarray, beside: Trajectory | None = None
    ) -> tuple[Trajectory, dict[str, np.ndarray], np.ndarray, float]:
        """The trajectory at a point, run `beside` another one, its readings, their whitened residual (rows,), and the
        penalised chi-square.
        """
        at = own.at(point)
        trajectory = predictor.run(at, beside)
        readings = predictor.readings(trajectory, at)
        r = study.whiten_other(record, residual_of(record, readings))[:, 0]
        return trajectory, readings, r, float(r @ r + point @ point)

    trajectory, readings, r, chi_square = left(point)
    for _ in range(study.options.input.holdout_steps if inputs else 0):
        now, before = own.at(point), chi_square
        linear = linearise_record(predictor, now, trajectory)
        J = study.whiten_other(record, parameter_sensitivities(linear, own, perturbed_variants(own, now)))
        step = bounded_step(J.T @ J + np.eye(len(point)), J.T @ r - point, own.limits - point)
        for share in (1.0, 0.5, 0.25):  # peaks that move are far from linear
            tried = left(point + share * step, trajectory)
            if tried[-1] < chi_square:
                point, (trajectory, readings, r, chi_square) = point + share * step, tried
                break
        if before - chi_square < study.options.fit.hypothesis_ftol:
            break
    return readings, point


def _own_parameters(study: Study, record: Record) -> tuple[NuisanceParameter, ...]:
    """The parameters that are a record's own, of the kinds that the training records have."""
    fitted, session = study.nominal.parameters, study.session
    inputs: list[NuisanceParameter] = []
    if any(isinstance(p.input, EdgeTime | EdgeDuration) for p in fitted):
        inputs += [edge_parameter(record, edge) for edge in edges_fitted(record, options=study.options)]
    for wave in fitted_waves(study.nominal).values():
        if isinstance(one := wave[0].input, Wave):
            inputs += wave_parameters([record], one.column, one.frequency, wave[0].deviation)
    if has_instrument_errors(fitted):
        inputs += errors_of_records(session, study.options, [record])
    return tuple(inputs)


def _change_interval(squares: np.ndarray, seed: int, *, options: DiagnosisOptions) -> tuple[float, float]:
    """The interval of the change of the mean square, from squares (n, 2) before and after.

    Drawn as a ratio to what was there before in the same blocks: no error falls by more than all of it.
    """
    before, after = _block_means(squares[:, 0], seed), _block_means(squares[:, 1], seed)
    ratio = np.divide(after, before, out=np.ones_like(after), where=before > 0.0)
    low, high = np.quantile(ratio - 1.0, options.hold_out.interval) * squares[:, 0].mean()
    return float(low), float(high)


def _block_means(change: np.ndarray, seed: int, draws: int = 1000) -> np.ndarray:
    """(draws,) means as they would have come out, by drawing blocks: neighbours are alike."""
    size = max(int(np.sqrt(len(change))), 1)
    count = max(len(change) // size, 1)
    blocks = change[: count * size].reshape(count, size).mean(axis=1)
    rng = np.random.default_rng(seed)
    return blocks[rng.integers(0, count, (draws, count))].mean(axis=1)


def traces_of(study: Study, record: Record, reads: Sequence[dict[str, np.ndarray]]) -> list[Trace]:
    """A record's readings beside those of the nominal and of the extended model, channel by channel."""
    found = []
    for name in record.outputs:
        noise = study.noise_near(name, record.pace)
        found.append(
            Trace(record=record.name, channel=name, unit=CHANNEL_UNITS[name], role=record.role, time=record.time,
                  measured=np.where(record.usable[name], record.values[name], np.nan),
                  base=reads[0][name], extended=reads[1][name],
                  noise=noise.deviation if noise is not None else 0.0)
        )  # fmt: skip
    return found
