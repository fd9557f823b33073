"""Effects of sensors: what a channel reads instead of the value.

Symbols
    r the reading over time, T_oil oil temperature °C, p the parameters by name"""

from __future__ import annotations

import numpy as np

from valvesim.valve.coefficients import REFERENCE_TEMPERATURE
from valvesim.valve.effect import CHANNEL, ActiveEffect, Advice, Effect, Parameter, Reading
from valvesim.valve.effects.declare import amplitude_parameter
from valvesim.valve.laws import lagged

AMPLIFIER_LAG = 5e-5  # s, of an amplifier of 3 kHz: a sensor that is late by less has no fault


def _bias(r: Reading, p):
    return r.values + p.bias


def _gain(r: Reading, p):
    return r.values * (1.0 + p.gain_error)


def _lag(r: Reading, p):
    return lagged(r.time, r.values, p.time_constant)


def _delay(r: Reading, p):
    """Straight lines between samples; before the first there is the first."""
    return np.interp(r.time - p.delay, r.time, r.values)


def _temperature_drift(r: Reading, p):
    return r.values + p.drift * (r.oil_temperature - REFERENCE_TEMPERATURE)


_ADVICE = {
    "sensor_bias": Advice(
        part="sensor of that channel",
        inspect="its reading with nothing applied: valve at rest, no pressure",
        confirm="zero before and after the test",
        remedy="set the zero, or calibrate",
    ),
    "sensor_gain": Advice(
        part="sensor of that channel",
        inspect="calibration certificate, excitation voltage, load resistor",
        confirm="two known inputs of different size",
        remedy="calibrate",
    ),
    "sensor_lag": Advice(
        part="sensor, line or filter of that channel",
        inspect="bore of the pressure tap, air in it, corner of the filter",
        confirm="a fast step beside a sensor that is known to be fast",
        remedy="shorter tap, bleed it, open the filter; or state the lag",
    ),
    "sensor_delay": Advice(
        part="logger's channel",
        inspect="clock and filters of the logger",
        confirm="one signal into all channels",
        remedy="one clock for all; or state the delay",
    ),
    "sensor_temperature_drift": Advice(
        part="sensor of that channel",
        inspect="its temperature, its compensation",
        confirm="zero in cold and in hot surroundings",
        remedy="compensate, or keep its temperature",
    ),
}


def _sensor(name: str, doc: str, signature: str, amplitude: Parameter, reading, **more) -> Effect:
    return Effect(
        name=name, doc=doc, location="sensor", signature=signature, parameters=(amplitude,), reading=reading,
        advice=_ADVICE[name], **more,
    )  # fmt: skip


SENSOR_BIAS = _sensor(
    "sensor_bias",
    "the sensor reads b too much",
    "one channel off by a constant; every other one fits",
    amplitude_parameter("bias", CHANNEL, "b, signed", (-1.0, 1.0), 0.02),
    _bias,
)
SENSOR_GAIN = _sensor(
    "sensor_gain",
    "the sensor reads (1 + g) of the value",
    "one channel off in proportion; every other one fits",
    amplitude_parameter("gain_error", "1", "g, signed", (-0.9, 10.0), 0.03),
    _gain,
)
SENSOR_LAG = _sensor(
    "sensor_lag",
    "the sensor follows with a first-order lag tau",
    "one channel late and smaller at high frequency, right at rest",
    amplitude_parameter("time_constant", "s", "tau", (0.0, 10.0), 1e-3, ordinary=AMPLIFIER_LAG),
    _lag,
    lag=lambda p: p.time_constant,
    reads_columns=True,
)
SENSOR_DELAY = _sensor(
    "sensor_delay",
    "the sensor reads the value of a time T ago",
    "one channel late by the same time at every frequency, of full size",
    amplitude_parameter("delay", "s", "T", (0.0, 0.1), 1e-3, ordinary=AMPLIFIER_LAG),
    _delay,
)
SENSOR_TEMPERATURE_DRIFT = _sensor(
    "sensor_temperature_drift",
    "the sensor reads k (T_oil - 20 °C) too much",
    "one channel off by an offset that follows the oil temperature; every other one fits",
    amplitude_parameter("drift", f"{CHANNEL}/K", "k, signed", (-0.02, 0.02), 1e-3),
    _temperature_drift,
    feature="oil_temperature",
)
SENSORS = (SENSOR_BIAS, SENSOR_GAIN, SENSOR_LAG, SENSOR_DELAY, SENSOR_TEMPERATURE_DRIFT)


def sensor_lag(channel: str, time_constant: float) -> ActiveEffect:
    """The first-order lag (s) of the sensor of a channel."""
    return SENSOR_LAG.on(channel)(time_constant=time_constant)
