"""What readings hang on the errors of measured inputs: the valve feels the input, the record has it rounded and with
the noise of an instrument. As an error in variables that acts on the readings through the model, so that it is neither
white nor even: where lands pass null little of it in the current is much in the leakage.

Symbols
    u input as recorded, e another error that its instrument may have made; y readings; y(u + e) - y(u) what they hang
    on it
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import predict_readings
from valvesim.identification.input_noise import rounding_error
from valvesim.identification.predictor import prepare_record
from valvesim.identification.session import Record
from valvesim.identification.study import Prepared


def with_input_errors(prepared: Prepared, point: np.ndarray | None = None) -> Prepared:
    """The prepared session with realisations of what its readings hang on the errors of its inputs, by the nominal
    model at a point (p,), that of its prior where none is given. As it is where no input has any, or the model cannot
    be run there.
    """
    records = [predictor.record for predictor in prepared.predictors]
    if not any(record.input_noise or record.input_resolution for record in records):
        return prepared
    dice, options = np.random.default_rng(prepared.session.seed), prepared.options.input_noise
    variant = prepared.nominal.at(np.zeros(len(prepared.nominal.parameters)) if point is None else point)
    with suppress(SolveError, InputError):
        as_recorded = predict_readings(prepared.without_oversampling(), variant)
        others = [
            predict_readings(_disturbed(prepared, dice), variant)
            for _ in range(options.long_realisations if prepared.is_long else options.realisations)
        ]
        errors = {
            (record.name, name): np.column_stack([other[k][name] - as_recorded[k][name] for other in others])
            for k, record in enumerate(records)
            for name in record.outputs
        }
        return replace(prepared, input_errors=errors)
    return prepared


def _disturbed(prepared: Prepared, dice: np.random.Generator) -> Prepared:
    """The prepared session with more of the errors that its inputs have; none of its records runs as another does."""
    session, options = prepared.session, prepared.options
    predictors = tuple(
        prepare_record(session, _with_errors(one.record, dice), one.universe, options=options)
        for one in prepared.predictors
    )
    alone = tuple(range(len(predictors)))
    return replace(prepared, predictors=predictors, representatives=alone).without_oversampling()


def _with_errors(record: Record, dice: np.random.Generator) -> Record:
    """The record with more of the noise and the rounding that its inputs have; of the noise the rounding is a part."""
    read = {}
    for column in record.inputs:
        values, step = record.values[column], record.input_resolution.get(column, 0.0)
        noise = record.input_noise.get(column, 0.0)
        if rest := max(noise**2 - step**2 / 12.0, 0.0):
            read[column] = values + dice.normal(0.0, np.sqrt(rest), len(values))
        if step:
            read[column] = read.get(column, values) + rounding_error(values, step, dice)
    return replace(record, values=record.values | read)
