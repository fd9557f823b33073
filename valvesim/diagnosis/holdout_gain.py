"""The gain on the hold-out records, opened once: errors of nominal and extended model, with bootstrap intervals.

Blocks of neighbouring samples are drawn, for these are alike (block bootstrap: Kuensch 1989).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.diagnosis.answer_tables import UNITS
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import Gain, Trace
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import ModelVariant, prepare_record
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

    The first flag tells whether a gain is claimed, the second whether the extended model is offered: where it most
    likely does better on what it has not seen, or where nobody can tell. Last what could not be simulated, in words:
    then it is not offered.
    """
    study, session = nominal.study, nominal.study.session
    universe = study.predictors[0].universe
    variants = (before.variant(study.nominal), extended)
    gains, traces, pooled, failed = [], [], [], []
    for predictor, *reads in zip(study.predictors, before.readings, readings, strict=True):
        traces += _traces(study, predictor.record, reads)
    for record in session.locked:
        try:
            predictor = prepare_record(session, record, universe, options=options.identification)
            reads = [predictor.readings(predictor.run(variant), variant) for variant in variants]
        except (InputError, SolveError) as reason:  # what was found in the others stands all the same
            failed.append(f"no gain is measured on a locked record that cannot be simulated: {reason}")
            continue
        traces += _traces(study, record, reads)
        white = []
        for name in record.outputs:
            key = _nearest_noise_key(study, name, record.pace)
            if key is None:
                continue
            columns = np.column_stack([residual_of(record, read)[name][:, 0] for read in reads])
            white.append(study.noise[key].whiten(columns, record.usable[name]))
        if not white:
            continue
        squares = np.concatenate([w**2 for w in white])
        change = squares[:, 1] - squares[:, 0]
        pooled.append(change)
        low, high = np.quantile(_block_means(change, session.seed), options.hold_out.interval)
        error, extended_error = np.sqrt(squares.mean(axis=0))
        gains.append(
            Gain(record=record.name, before=float(error), after=float(extended_error), floor=1.0,
                 change=float(change.mean()), low=float(low), high=float(high), claimed=bool(high < 0.0))
        )  # fmt: skip
    claimed, offered = False, True
    if pooled:
        means = _block_means(np.concatenate(pooled), session.seed)
        claimed, offered = (
            bool(np.quantile(means, options.hold_out.interval[1]) < 0.0),
            bool(np.mean(means < 0.0) >= options.hold_out.likely),
        )
    return tuple(gains), claimed, offered and not failed, tuple(traces), failed


def _nearest_noise_key(study: Study, channel: str, rate: float) -> tuple[str, float] | None:
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
        key = _nearest_noise_key(study, name, record.pace)
        found.append(
            Trace(record=record.name, channel=name, unit=UNITS[name], role=record.role, time=record.time,
                  measured=record.values[name], base=reads[0][name], extended=reads[1][name],
                  noise=study.noise[key].deviation if key is not None else 0.0)
        )  # fmt: skip
    return found
