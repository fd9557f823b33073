"""Errors of a bench's instruments that no record tells, as nuisance parameters: inputs that are off, wander or are read
late, clocks that run apart, meters whose zero or gain moves, or which are not linear.

Their priors are as wide as such errors are on ordinary benches. They join the nominal model where it cannot explain the
records without them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.identification.between_samples import InputDelay, InputShift, Wave
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.prior import NuisanceParameter, largest_reading, measured_channels, range_read, widest_span
from valvesim.identification.sensor_errors import ToleratedSensorError, ToleratedTimeError
from valvesim.identification.session import Record, Session
from valvesim.valve.effect import Parameter, Reading
from valvesim.valve.effects.sensors import SENSOR_BIAS, SENSOR_GAIN


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
    """Those that are others in each training record, or in each of other `records`: of its inputs, and of its meters'
    zeros and gains.
    """
    return (
        *(p for column, growing in shift_ways() for p in input_shifts(session, column, growing, options, records)),
        *(p for column in DELAYED for p in input_delays(session, column, options, records)),
        *(p for channel in measured_channels(session) for p in meter_zeros(session, channel, options, records)),
        *(p for channel in measured_channels(session) for p in meter_gains(session, channel, options, records)),
    )


SHIFTED = {"oil_temperature": "delta_degC", "supply_pressure": "Pa", "load_pressure": "Pa"}
"""Inputs that may be off, with the unit of what they are off by."""

WANDERING = ("oil_temperature", "supply_pressure")
"""Those that may wander in a record: a load's transducers do not so fast."""


def shift_ways() -> list[tuple[str, bool]]:
    """Inputs that may be off, throughout a record, or growing within it."""
    return [*((column, False) for column in SHIFTED), *((column, True) for column in WANDERING)]


def input_shifts(
    session: Session,
    column: str,
    growing: bool,
    options: IdentificationOptions,
    records: Sequence[Record] | None = None,
) -> tuple[NuisanceParameter, ...]:
    """What an input is off by in each training record, or in other `records`: throughout, or where `growing` by so much
    at the end. Of an input that nobody measured all are likely off by the same, which counts once.
    """
    name = f"{column}{':growing' if growing else ''}"
    every = session.training if records is None else records
    sizes = [(record, _shift_size(session, record, column, options)) for record in every]
    assumed = max(sum(column in record.assumed for record in session.training), 1)
    return tuple(
        NuisanceParameter(f"shift@{record.name}:{name}", SHIFTED[column], 0.0,
                          size * (np.sqrt(assumed) if column in record.assumed else 1.0), (-4.0 * size, 4.0 * size),
                          input=InputShift(record.name, column, growing))
        for record, size in sizes
    )  # fmt: skip


def _shift_size(session: Session, record: Record, column: str, options: IdentificationOptions) -> float:
    """What an input of a record may be off by: more where it was not measured."""
    measured, errors = column not in record.assumed, options.instrument
    if column == "oil_temperature":
        return errors.oil_temperature if measured else errors.assumed_oil_temperature
    share = errors.supply_pressure if measured else errors.assumed_supply_pressure
    return share * float(session.valve.supply_pressure)


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
    """By how much the zero of a meter is another in each training record than in all together, or in each of other
    `records`: what all have in common is the sensor's bias.
    """
    size = options.instrument.meter_zero * range_read(session, channel)
    return _of_each_record(session, METER_ZERO, channel, size, options, records)


def meter_gains(
    session: Session, channel: str, options: IdentificationOptions, records: Sequence[Record] | None = None
) -> tuple[NuisanceParameter, ...]:
    """The same of its gain: a range that was switched, an amplifier set anew."""
    return _of_each_record(session, METER_GAIN, channel, options.instrument.meter_gain, options, records)


def _of_each_record(
    session: Session,
    error: ToleratedSensorError,
    channel: str,
    size: float,
    options: IdentificationOptions,
    records: Sequence[Record] | None,
) -> tuple[NuisanceParameter, ...]:
    """An error of a meter that is another in each training record than in all together, or in each of other `records`,
    by so much. Where it was set anew it may be much more, which shows clearly.
    """
    reach = options.instrument.reset_reach * size
    names = [r.name for r in (session.training if records is None else records) if channel in r.outputs]
    ways = np.eye(len(names)) if records is not None else contrasts(len(names))
    own = [
        replace(error, name=f"{error.name}_{k}", records=tuple(zip(names, way, strict=True)))
        for k, way in enumerate(ways.T.tolist())
    ]
    return tuple(_sensor_error(one, channel, size, (-reach, reach)) for one in own if size > 0.0)


def contrasts(count: int) -> np.ndarray:
    """(count, count - 1) with columns that are orthonormal, and to what is the same in all (Helmert)."""
    steps = np.triu(np.ones((count, count - 1)))
    steps[np.arange(1, count), np.arange(count - 1)] = -np.arange(1, count)
    return steps / np.linalg.norm(steps, axis=0)


def meter_linearity(session: Session, channel: str, options: IdentificationOptions) -> tuple[NuisanceParameter, ...]:
    """By how much a meter departs from the straight line through what it reads in the session: one way by a bow, both
    ways by a gain that changes with the reading, and by one that is another in either direction.
    """
    read = np.concatenate([r.values[channel][r.usable[channel]] for r in session.training if channel in r.outputs])
    largest, span = largest_reading(session, channel), float(np.ptp(read))
    if span <= options.audit.least_spread * largest:
        return ()
    both_ways = min(float(np.max(read)), -float(np.min(read))) > options.instrument.both_ways * largest
    size = options.instrument.meter_linearity * largest
    errors = (_fitted_bend(bend, channel, read / largest, largest) for bend in (BOTH_WAYS if both_ways else ONE_WAY))
    return tuple(_sensor_error(one, channel, size, (-4.0 * size, 4.0 * size)) for one in errors if one is not None)


def _fitted_bend(bend: Bend, channel: str, shares: np.ndarray, largest: float) -> ToleratedSensorError | None:
    """The error of a channel's meter that reads by a bend, less the straight line through it over readings (n,), which
    are shares of the largest: offset and gain of a sensor are other errors. None where that line is all: two readings
    tell of no bend.
    """
    slope, mean = np.polyfit(shares, bend.of(shares), 1)
    left = float(np.max(np.abs(bend.of(shares) - mean - slope * shares)))
    if left < 1e-9:  # rounding
        return None
    at = {"mean": float(mean), "slope": float(slope), "most": left, "largest": largest}
    parameters = bend.error.on(channel).parameters
    return replace(bend.error, parameters=tuple(replace(p, default=at.get(p.name, p.default)) for p in parameters))


def _sensor_error(
    effect: ToleratedSensorError, channel: str, size: float, bounds: tuple[float, float]
) -> NuisanceParameter:
    own = effect.on(channel)
    return NuisanceParameter(f"{effect.name}@{channel}", own.amplitude.unit, 0.0, size, bounds, own)


def is_of_bench(parameter: NuisanceParameter) -> bool:
    """Whether a parameter is of the bench and not of the valve: an instrument's error, or a wave upon an input."""
    sensor = "" if parameter.sensor is None else parameter.sensor.name
    return isinstance(parameter.input, InputShift | InputDelay | Wave) or sensor.startswith((CLOCK_RATE.name, *_METERS))


def is_of_meter(parameter: NuisanceParameter) -> bool:
    """Whether a parameter is an error of a meter that is told as the bench's."""
    return parameter.sensor is not None and parameter.sensor.name.startswith(_METERS)


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
            name="bias", unit="channel", doc="offset", default=0.0, bounds=(-1e9, 1e9), neutral=0.0, typical=0.01
        ),
    ),
    reading=SENSOR_BIAS.reading,
)

METER_GAIN = ToleratedSensorError(
    name="meter_gain",
    doc="the gain is another in one record",
    location="sensor",
    signature="in proportion, and another in each record",
    parameters=(
        Parameter(name="gain_error", unit="1", doc="gain error", default=0.0, bounds=(-0.9, 10.0), neutral=0.0,
                  typical=0.005),
    ),
    reading=SENSOR_GAIN.reading,
)  # fmt: skip


@dataclass(frozen=True)
class Bend:
    """A departure of a meter from a straight line: its shape over readings as shares of the largest, and the error."""

    of: Callable[[Any], Any]
    error: ToleratedSensorError


def _bend(name: str, doc: str, signature: str, shape: Callable[[Any], Any]) -> Bend:
    def reading(seen: Reading, p: Any) -> Any:
        x = seen.values / p.largest
        return seen.values + p.departure * (shape(x) - p.mean - p.slope * x) / p.most

    of_line = (("mean", 0.0, "line at no reading"), ("slope", 0.0, "its rise to the largest"),
               ("most", 1.0, "what the line leaves of the shape, at most"))  # fmt: skip
    parameters = (
        Parameter(name="departure", unit="channel", doc="departure at most", default=0.0, bounds=(-1e9, 1e9),
                  neutral=0.0, typical=0.01),
        *(Parameter(name=n, unit="1", doc=d, default=v, bounds=(-1e9, 1e9)) for n, v, d in of_line),
        Parameter(name="largest", unit="channel", doc="largest reading", default=1.0, bounds=(1e-30, 1e9)),
    )  # fmt: skip
    return Bend(shape, ToleratedSensorError(
        name=name, doc=doc, location="sensor", signature=signature, parameters=parameters, reading=reading
    ))  # fmt: skip


# Of meters that read one way, and of those that read both.
ONE_WAY = (_bend("meter_bow", "the meter is off a straight line", "a bow over the reading", np.square),)
BOTH_WAYS = (
    _bend("meter_linearity", "the meter's gain changes with what it reads", "a curve over the reading, alike both ways",
          lambda x: x * np.abs(x)),
    _bend("meter_cubic", "the meter's gain changes towards its ends", "a curve over the reading, alike both ways",
          lambda x: x * np.square(x)),
    _bend("meter_symmetry", "the meter's gain differs by direction", "another gain above zero than below", np.abs),
)  # fmt: skip

_METERS = tuple(e.name for e in (METER_DRIFT, METER_ZERO, METER_GAIN, *(bend.error for bend in (*ONE_WAY, *BOTH_WAYS))))
