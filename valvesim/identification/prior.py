"""The nominal model and its nuisance parameters with Gaussian priors.

Nuisance parameters are all quantities of the valve that have a tolerance, normal about their nominal value with the
tolerance at two standard deviations, and each sensor's small offset, gain and delay error. Every fit estimates them too
(maximum a posteriori): what they can explain is no evidence for a fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from valvesim.identification.between_samples import Deviations, InputDeviation
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.sensor_errors import ToleratedSensorError, ToleratedTimeError
from valvesim.identification.session import PART_TEMPERATURES, Record, Session
from valvesim.units import quantities
from valvesim.valve.effect import Effect
from valvesim.valve.effects.sensors import SENSOR_BIAS, SENSOR_DELAY, SENSOR_GAIN
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import ThermalNetwork


@dataclass(frozen=True)
class NuisanceParameter:
    """A quantity that is uncertain within a tolerance: of the valve, of its thermal network, the offset or gain of a
    `sensor`, or the amount of the `deviation` of an input.

    `deviation` is the prior standard deviation, of the logarithm where `logarithmic`; `of_material` and `time_scale` as
    `units.quantity` declares them.
    """

    name: str
    unit: str
    nominal: float
    deviation: float
    bounds: tuple[float, float]
    sensor: Effect | None = None
    of_material: bool = False
    time_scale: float = float("inf")
    logarithmic: bool = False
    input: InputDeviation | None = None

    @property
    def is_of_valve(self) -> bool:
        """Whether it is a quantity of the valve itself."""
        return self.sensor is None and self.input is None and not self.of_network

    @property
    def of_network(self) -> bool:
        """Whether it is a figure of the thermal network."""
        return self.name.startswith(NETWORK)

    @property
    def of_reading(self) -> bool:
        """Whether it scales or shifts a reading and moves nothing else, so that a linearisation knows it for good."""
        return self.sensor is not None and not isinstance(self.sensor, ToleratedTimeError)

    def at(self, where: float, more: float = 0.0) -> float:
        """Its value at so many prior deviations, and `more` in its unit (in its logarithm), within its bounds."""
        moved = where * self.deviation + more
        return float(np.clip(self.nominal * np.exp(moved) if self.logarithmic else self.nominal + moved, *self.bounds))

    def apart(self, variant: ModelVariant, other: ModelVariant) -> float:
        """By how many prior deviations two variants differ in it."""
        one, two = self.value_in(variant), self.value_in(other)
        return float(np.log(one / two) if self.logarithmic else one - two) / self.deviation

    def value_in(self, variant: ModelVariant) -> float:
        """Its value in a variant; of a sensor's error 0, for it is not told from a fault."""
        if self.sensor is not None:
            return 0.0
        if self.input is not None:
            return next((amount for one, amount in reversed(variant.deviations) if one == self.input), 0.0)
        if self.of_network:
            assert variant.network is not None  # noqa: S101 - it is where its figures are fitted
            return float(getattr(variant.network, self.name.removeprefix(NETWORK)))
        return float(getattr(variant.valve, self.name))

    def with_value(self, variant: ModelVariant, value: float) -> ModelVariant:
        """A variant with another value of it; not of a sensor's error."""
        if self.input is not None:
            own = [(one, value if one == self.input else amount) for one, amount in variant.deviations]
            known = any(one == self.input for one, _ in own)
            return replace(variant, deviations=tuple(own) if known else (*own, (self.input, value)))
        figure: dict[str, Any] = {self.name.removeprefix(NETWORK): value}
        if self.of_network:
            assert variant.network is not None  # noqa: S101 - as above
            return replace(variant, network=replace(variant.network, **figure))
        return replace(variant, valve=replace(variant.valve, **figure))

    def more_of(self, variant: ModelVariant, more: float) -> float:
        """Its value in a variant with `more` of it, in its unit (in its logarithm); bounds are not asked."""
        value = self.value_in(variant)
        return float(value * np.exp(min(more, 700.0))) if self.logarithmic else value + more

    def moved(self, variant: ModelVariant, by: float) -> ModelVariant:
        """A variant with it moved by so many prior deviations."""
        return self.with_value(variant, self.more_of(variant, by * self.deviation))


NETWORK = "thermal."
"""How the names of the figures of the thermal network begin among the nuisance parameters."""


@dataclass(frozen=True)
class NominalModel:
    """The model of session.toml with its nuisance parameters; a point is given in prior standard deviations (p,)."""

    variant: ModelVariant
    parameters: tuple[NuisanceParameter, ...]
    options: IdentificationOptions

    def at(self, point: np.ndarray) -> ModelVariant:
        """The variant at a point, held within the bounds of each quantity, and off zero where it is positive."""
        valve: dict[str, Any] = {}
        network: dict[str, Any] = {}
        sensors, deviations = [], list(self.variant.deviations)
        for parameter, where in zip(self.parameters, point, strict=True):
            value = parameter.at(where)
            if parameter.input is not None:
                deviations.append((parameter.input, value))
            elif parameter.of_network:
                network[parameter.name.removeprefix(NETWORK)] = value
            elif parameter.sensor is None:
                valve[parameter.name] = value
            elif where != 0.0:
                sensors.append(parameter.sensor(**{parameter.sensor.amplitude.name: value}))
        return replace(
            self.variant,
            valve=replace(self.variant.valve, **valve),
            effects=(*self.variant.effects, *sensors),
            network=None if self.variant.network is None else replace(self.variant.network, **network),
            deviations=tuple(deviations),
        )

    @cached_property
    def limits(self) -> np.ndarray:
        """(2, p): how far down and up each parameter may go, in prior deviations; a part further off is another."""
        ends = [
            (np.log(np.maximum(p.bounds, 1e-300) / p.nominal) if p.logarithmic else np.subtract(p.bounds, p.nominal))
            / p.deviation
            for p in self.parameters
        ]
        reach = [self.options.prior.reach if p.is_of_valve else np.inf for p in self.parameters]
        return np.clip(np.transpose(ends), -np.array(reach), reach)

    @property
    def longest_step(self) -> np.ndarray:
        """(p,): how far each parameter may go in one step of a fit, in prior deviations."""
        fit = self.options.fit
        longest = [np.inf if p.of_reading else fit.longest_delay_step if p.sensor is not None else fit.longest_step
                   for p in self.parameters]  # fmt: skip
        return np.array(longest)

    def extended(self, parameters: Sequence[NuisanceParameter], deviations: Deviations = ()) -> NominalModel:
        """The same with more nuisance parameters, after its own, and with what inputs do beside their samples."""
        variant = replace(self.variant, deviations=(*self.variant.deviations, *deviations))
        return replace(self, variant=variant, parameters=(*self.parameters, *parameters))


def nominal_model_of(session: Session, *, options: IdentificationOptions) -> NominalModel:
    """The nominal model of a session: quantities of its valve with a tolerance, and the sensors' small errors."""
    parameters = []
    for name, declared in quantities(Valve).items():
        nominal, tolerance = float(getattr(session.valve, name)), float(declared.metadata["tolerance"])
        width = session.tolerances.get(name, tolerance * abs(nominal) if declared.default != 0.0 else tolerance)
        if width > 0.0:
            low, high = declared.metadata["bounds"]
            parameters.append(
                NuisanceParameter(
                    name,
                    declared.metadata["unit"],
                    nominal,
                    width / 2.0,
                    (max(low, options.prior.least_share * nominal) if low >= 0.0 else low, high),
                    of_material=declared.metadata["of_material"],
                    time_scale=declared.metadata["time_scale"],
                )  # fmt: skip
            )
    for channel in measured_channels(session):
        for error, tolerance in (
            (SENSOR_BIAS, options.prior.sensor_bias * range_read(session, channel)),
            (SENSOR_GAIN, options.prior.sensor_gain),
            (SENSOR_DELAY, options.prior.sensor_delay),
        ):
            effect = _either_way(error.on(channel))
            amplitude = effect.amplitude
            parameters.append(
                NuisanceParameter(
                    f"{error.name}@{channel}", amplitude.unit, 0.0, tolerance / 2.0, amplitude.bounds, effect
                )
            )
    network = session.thermal.network if _warms(session) else None
    if network is not None:
        parameters += _network_parameters(network, options=options)
    variant = ModelVariant(session.valve, session.effects, network)
    return NominalModel(variant, tuple(parameters), options=options)


def _warms(session: Session) -> bool:
    """Whether the parts of a training record are not all at the oil's temperature throughout."""
    return session.thermal.initial_temperature is not None or any(map(_has_parts_apart, session.training))


def _has_parts_apart(record: Record) -> bool:
    """Whether the oil or a measured part moves or is warmer than another."""
    measured = [record.values[n] for n in ("oil_temperature", *PART_TEMPERATURES) if n in record.values]
    return any(np.ptp(values) > 0.0 or values[0] != measured[0][0] for values in measured)


def _network_parameters(network: ThermalNetwork, *, options: IdentificationOptions) -> list[NuisanceParameter]:
    """The figures of a thermal network, each known to a factor alone: heat capacities by their declared tolerance,
    heat transfer less well.
    """
    found = []
    for name, declared in quantities(ThermalNetwork).items():
        nominal = float(getattr(network, name))
        if nominal > 0.0:
            factor = options.prior.heat_transfer if "_to_" in name else 1.0 + declared.metadata["tolerance"]
            low, high = (nominal * options.prior.network_reach**sign for sign in (-1.0, 1.0))
            found.append(
                NuisanceParameter(
                    NETWORK + name,
                    declared.metadata["unit"],
                    nominal,
                    float(np.log(factor)) / 2.0,
                    (max(low, declared.metadata["bounds"][0]), min(high, declared.metadata["bounds"][1])),
                    logarithmic=True,
                )  # fmt: skip
            )
    return found


def _either_way(effect: Effect) -> Effect:
    """The effect with an amplitude that may go below neutral as far as above: a clock may also be early."""
    amplitude = effect.amplitude
    wide = replace(amplitude, bounds=(-amplitude.bounds[1], amplitude.bounds[1]))
    parameters = tuple(wide if p is amplitude else p for p in effect.parameters)
    kind = ToleratedTimeError if effect.name == SENSOR_DELAY.name else ToleratedSensorError
    return kind(**{**{f.name: getattr(effect, f.name) for f in fields(effect)}, "parameters": parameters})


def measured_channels(session: Session) -> tuple[str, ...]:
    """The output channels of the training records, in order of appearance; nothing is asked of a hold-out record."""
    return tuple(dict.fromkeys(name for record in session.training for name in record.outputs))


def widest_span(session: Session, channel: str) -> float:
    """The widest span of a channel's readings in a training record."""
    values = [record.values[channel] for record in session.training if channel in record.outputs]
    return float(max(np.ptp(v) for v in values))


def range_read(session: Session, channel: str) -> float:
    """The range in which a channel was read: its widest span, or its largest reading where that is more, as of a
    pressure that is far from zero throughout.
    """
    return max(widest_span(session, channel), largest_reading(session, channel))


def largest_reading(session: Session, channel: str) -> float:
    """The largest reading of a channel in the training records, either way."""
    return max(float(np.max(np.abs(r.values[channel]))) for r in session.training if channel in r.outputs)
