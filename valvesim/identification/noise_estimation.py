"""The noise of each channel of a session: from replicates where there are any, else from the residual of a fit.

The difference of replicates holds no model error, whatever the model gets wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.identification.between_samples import undersampled_share
from valvesim.identification.fit import Fit, evaluate_fit, rescored
from valvesim.identification.noise_growth import grown
from valvesim.identification.noise_model import NoiseModel, fit_autoregression
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import Record
from valvesim.identification.study import PreparedSession, Study


def identify_noise(
    prepared: PreparedSession, readings: Sequence[dict[str, np.ndarray]]
) -> dict[tuple[str, float], NoiseModel]:
    """The noise of each channel at each rate: from repeats where there are any, else from what the model leaves."""
    session, found = prepared.session, {}
    records = [predictor.record for predictor in prepared.predictors]
    keys = dict.fromkeys((name, record.pace) for record in records for name in record.outputs)
    for name, rate in keys:
        own = [
            (record, np.where(_tells_noise(prepared, record, name), _left(prepared, record, name, read[name]), np.nan))
            for record, read in zip(records, readings, strict=True)
            if name in record.outputs and record.pace == rate
        ]
        sensor = session.sensors.get(name)
        resolution = sensor.resolution if sensor is not None else 0.0
        stated = sensor.noise if sensor is not None else None
        series = _differences(own, options=prepared.options)
        verified, source = bool(series), "repeats" if series else "residual"
        if not verified:
            series = [left for record, left in own]
        floor = max(resolution / np.sqrt(12.0), 1e-9 * _size(own, name), stated or 0.0 if not verified else 0.0)
        noise = fit_autoregression(series, verified=verified, source=source, floor=floor, options=prepared.options)
        if resolution > 2.0 * noise.deviation:
            noise = NoiseModel(noise.deviation, (), verified, source, rounding_step=resolution)
        found[name, rate] = noise
    return found


def _left(prepared: PreparedSession, record: Record, name: str, read: np.ndarray) -> np.ndarray:
    """What readings (n,) leave of a channel, as large as it would be at no reading where its noise grows with that."""
    return (record.values[name] - read) / grown(prepared.noise_growth.get(name, 0.0), record.values[name])


def _tells_noise(prepared: PreparedSession, record: Record, name: str) -> np.ndarray:
    """(n,) True for the usable samples of a channel that tell its noise: not those at which it hangs on what a command
    did that moves too fast for its samples.
    """
    usable, spread = record.usable[name], prepared.spread.get((record.name, name))
    if spread is None or not undersampled_share(record, options=prepared.options):
        return usable
    tells = usable & (spread < prepared.options.noise.most_spread * np.ptp(record.values[name]))
    return tells if np.mean(tells) > prepared.options.noise.least_common else usable


def _size(own: Sequence[tuple[Record, np.ndarray]], name: str) -> float:
    return max(float(np.max(np.abs(record.values[name]))) for record, _ in own)


def _differences(own: Sequence[tuple[Record, np.ndarray]], *, options: IdentificationOptions) -> list[np.ndarray]:
    """Noise alone, from records that repeat each other: what the model gets wrong is the same in each, and the zero of
    a meter is no noise.

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
        if np.mean(np.isfinite(stack).all(axis=0)) < options.noise.least_common:
            continue
        apart = (stack - stack.mean(axis=0)) * np.sqrt(count / (count - 1.0))
        apart -= np.nanmean(apart, axis=1, keepdims=True)
        series += list(apart[:-1] if count == 2 else apart)
    return series


def initial_noise(prepared: PreparedSession) -> dict[tuple[str, float], NoiseModel]:
    """White noise of the size of what a straight line through three samples leaves: to start the first fit with. It
    tells no noise where the command moves too fast for its samples, and the readings with it.
    """
    options = prepared.options
    found = {}
    for predictor in prepared.predictors:
        record = predictor.record
        most = options.noise.first_guess if undersampled_share(record, options=options) else np.inf
        for name in record.outputs:
            bend = np.diff(record.values[name], 2)
            size = min(float(np.sqrt(np.mean(bend**2) / 6.0)), most * float(np.ptp(record.values[name])))
            sensor = prepared.session.sensors.get(name)
            floor = max(
                (sensor.resolution if sensor else 0.0) / np.sqrt(12.0), 2e-3 * float(np.ptp(record.values[name]))
            )
            found[name, record.pace] = NoiseModel(max(size, floor, 1e-30), (), False, "first guess")
    return found


def evaluated_under_own_noise(prepared: PreparedSession, point: np.ndarray) -> tuple[Study, Fit]:
    """A session under the noise that the model leaves at a point (p,), and the fit there without candidates.

    Raises SolveError, InputError where the valve cannot be run.
    """
    first = evaluate_fit(prepared.with_noise(initial_noise(prepared)), point, ())
    study = prepared.with_noise(identify_noise(prepared, first.readings))
    return study, rescored(study, first)
