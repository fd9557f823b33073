"""Errors of a bench's instruments that no record tells, as nuisance parameters: inputs that are off, wander or are read
late, clocks that run apart, meters whose zero moves, or which are not quite linear.

Their priors are as wide as such errors are on ordinary benches. They join the nominal model where it cannot explain the
records without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvesim.identification.between_samples import InputDelay, InputShift, Wave
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.prior import NuisanceParameter, measured_channels, widest_span
from valvesim.identification.sensor_errors import ToleratedSensorError, ToleratedTimeError
from valvesim.identification.session import Record, Session
from valvesim.valve.effect import Parameter


def instrument_errors(session: Session, *, options: IdentificationOptions) -> tuple[NuisanceParameter, ...]:
    """All of them."""
    return (
        *errors_of_records(session, options),
        *clock_rates(session, options),
        *meter_drifts(session, options),
        *(p for channel in measured_channels(session) for p in meter_linearity(session, channel, options)),
    )


def errors_of_records(
    session: Session, options: IdentificationOptions, records: Sequence[Record] | None = None
) -> tuple[NuisanceParameter, ...]:
    """Those that are others in each training record, or in each of other `records`: of its inputs, and where its meters
    stand at zero.
    """
    ways = [(column, growing) for column in SHIFTED for growing in (False, True)]
    return (
        *(p for column, growing in ways for p in input_shifts(session, column, growing, options, records)),
        *(p for column in DELAYED for p in input_delays(session, column, options, records)),
        *(p for channel in measured_channels(session) for p in meter_zeros(session, channel, options, records)),
    )


SHIFTED = {"oil_temperature": "delta_degC", "supply_pressure": "Pa"}
"""Inputs that may be off, with the unit of what they are off by."""


def input_shifts(
    session: Session,
    column: str,
    growing: bool,
    options: IdentificationOptions,
    records: Sequence[Record] | None = None,
) -> tuple[NuisanceParameter, ...]:
    """What an input is off by in each training record, or in other `records`: throughout, or where `growing` by so much
    at the end.
    """
    size = {
        "oil_temperature": options.instrument.oil_temperature,
        "supply_pressure": options.instrument.supply_pressure * float(session.valve.supply_pressure),
    }[column]
    return tuple(
        NuisanceParameter(f"shift@{record.name}:{column}{':growing' if growing else ''}", SHIFTED[column], 0.0,
                          size, (-4.0 * size, 4.0 * size), input=InputShift(record.name, column, growing))
        for record in (session.training if records is None else records)
    )  # fmt: skip


DELAYED = ("supply_pressure", "return_pressure", "load_pressure")
"""Inputs that may be read late: what their transducers are slow by."""


def input_delays(
    session: Session, column: str, options: IdentificationOptions, records: Sequence[Record] | None = None
) -> tuple[NuisanceParameter, ...]:
    """How late an input is read in each training record, or in other `records`, of those in which it moves."""
    size = options.instrument.pressure_delay
    return tuple(
        NuisanceParameter(f"delay@{record.name}:{column}", "s", 0.0, size, (-4.0 * size, 4.0 * size),
                          input=InputDelay(record.name, column))
        for record in (session.training if records is None else records)
        if column in record.inputs and record.moves(column)
    )  # fmt: skip


def clock_rates(session: Session, options: IdentificationOptions) -> tuple[NuisanceParameter, ...]:
    """By what share each channel's clock runs fast."""
    return tuple(
        _sensor_error(CLOCK_RATE, channel, options.instrument.clock_rate, CLOCK_RATE.amplitude.bounds)
        for channel in measured_channels(session)
    )


def meter_drifts(session: Session, options: IdentificationOptions) -> tuple[NuisanceParameter, ...]:
    """How fast each meter's reading drifts within a record."""
    sizes = {name: options.instrument.meter_drift * fastest_drift(session, name) for name in measured_channels(session)}
    return tuple(
        _sensor_error(METER_DRIFT, name, size, (-4.0 * size, 4.0 * size)) for name, size in sizes.items() if size > 0.0
    )


def fastest_drift(session: Session, channel: str) -> float:
    """The drift (unit of the channel per s) that takes the longest record to its widest span."""
    return widest_span(session, channel) / max(r.duration for r in session.training)


def meter_zeros(
    session: Session, channel: str, options: IdentificationOptions, records: Sequence[Record] | None = None
) -> tuple[NuisanceParameter, ...]:
    """By how much the zero of a meter is another in each training record than in all, or in each of other `records`."""
    size = options.instrument.meter_zero * widest_span(session, channel)
    measured = [r for r in (session.training if records is None else records) if channel in r.outputs]
    return tuple(
        _sensor_error(replace(METER_ZERO, record=record.name), channel, size, (-4.0 * size, 4.0 * size))
        for record in measured
        if size > 0.0
    )


def meter_linearity(session: Session, channel: str, options: IdentificationOptions) -> tuple[NuisanceParameter, ...]:
    """By how much the gain of a meter changes up to its largest reading, and between its directions where it reads both
    ways.
    """
    most, size = largest_reading(session, channel), options.instrument.meter_linearity
    if most == 0.0:
        return ()
    read = [r.values[channel] for r in session.training if channel in r.outputs]
    both_ways = min(-min(map(np.min, read)), max(map(np.max, read))) > options.instrument.both_ways * most
    linearity = _sensor_error(METER_LINEARITY, channel, size / most, (-4.0 * size / most, 4.0 * size / most))
    return (linearity, _sensor_error(METER_SYMMETRY, channel, size, (-4.0 * size, 4.0 * size)))[: 1 + both_ways]


def largest_reading(session: Session, channel: str) -> float:
    """The largest reading of a channel in the training records, either way."""
    return max(float(np.max(np.abs(r.values[channel]))) for r in session.training if channel in r.outputs)


def _sensor_error(
    effect: ToleratedSensorError, channel: str, size: float, bounds: tuple[float, float]
) -> NuisanceParameter:
    own = effect.on(channel)
    of = f"{effect.record}:{channel}" if effect.record else channel
    return NuisanceParameter(f"{effect.name}@{of}", own.amplitude.unit, 0.0, size, bounds, own)


def is_of_bench(parameter: NuisanceParameter) -> bool:
    """Whether a parameter is of the bench and not of the valve: an instrument's error, or a wave upon an input."""
    sensor = "" if parameter.sensor is None else parameter.sensor.name
    return isinstance(parameter.input, InputShift | InputDelay | Wave) or sensor in (CLOCK_RATE.name, *_METERS)


def is_of_meter(parameter: NuisanceParameter) -> bool:
    """Whether a parameter is an error of a meter that is told as the bench's."""
    return parameter.sensor is not None and parameter.sensor.name in _METERS


def has_instrument_errors(parameters: Sequence[NuisanceParameter]) -> bool:
    """Whether a model has them among its parameters."""
    return any(p.sensor is not None and p.sensor.name == CLOCK_RATE.name for p in parameters)


def _apart(reading, p):
    return np.interp(reading.time * (1.0 - p.rate), reading.time, reading.values)


CLOCK_RATE = ToleratedTimeError(
    name="clock_rate",
    doc="the channel's clock runs fast or slow",
    location="sensor",
    signature="a delay that grows",
    parameters=(
        Parameter(name="rate", unit="1", doc="rate", default=0.0, bounds=(-0.01, 0.01), neutral=0.0, typical=1e-4),
    ),
    reading=_apart,
)

METER_DRIFT = ToleratedSensorError(
    name="meter_drift",
    doc="the reading drifts within a record",
    location="sensor",
    signature="an offset that grows",
    parameters=(
        Parameter(
            name="rate", unit="channel/s", doc="rate", default=0.0, bounds=(-10.0, 10.0), neutral=0.0, typical=0.01
        ),
    ),
    reading=lambda reading, p: reading.values + p.rate * (reading.time - reading.time[0]),
)

METER_ZERO = ToleratedSensorError(
    name="meter_zero",
    doc="the reading is off by a constant in one record",
    location="sensor",
    signature="an offset that is another in each record",
    parameters=(
        Parameter(
            name="offset", unit="channel", doc="offset", default=0.0, bounds=(-1e9, 1e9), neutral=0.0, typical=0.01
        ),
    ),
    reading=lambda reading, p: reading.values + p.offset,
)

METER_LINEARITY = ToleratedSensorError(
    name="meter_linearity",
    doc="the meter's gain changes with what it reads",
    location="sensor",
    signature="a curve over the reading",
    parameters=(
        Parameter(
            name="curvature", unit="1/channel", doc="curvature", default=0.0, bounds=(-1e9, 1e9), neutral=0.0,
            typical=0.01,
        ),
    ),
    reading=lambda reading, p: reading.values * (1.0 + p.curvature * np.abs(reading.values)),
)  # fmt: skip

METER_SYMMETRY = ToleratedSensorError(
    name="meter_symmetry",
    doc="the meter's gain differs between its directions",
    location="sensor",
    signature="another gain above zero than below",
    parameters=(
        Parameter(name="difference", unit="1", doc="half the difference", default=0.0, bounds=(-0.1, 0.1), neutral=0.0,
                  typical=0.005),
    ),
    reading=lambda reading, p: reading.values + p.difference * np.abs(reading.values),
)  # fmt: skip

_METERS = {e.name for e in (METER_DRIFT, METER_ZERO, METER_LINEARITY, METER_SYMMETRY)}
