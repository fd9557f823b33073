"""The nominal model and its nuisance parameters with Gaussian priors.

Nuisance parameters are all quantities of the valve that have a tolerance, normal about their nominal value with the
tolerance at two standard deviations, and each sensor's small offset, gain and delay error. Every fit estimates them too
(maximum a posteriori): what they can explain is no evidence for a fault.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.session import Session
from valvesim.units import quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import Effect
from valvesim.valve.parameters import Valve


@dataclass(frozen=True)
class NuisanceParameter:
    """A quantity that is uncertain within a tolerance: of the valve, or the offset or gain of a sensor.

    `of_material` and `time_scale` as `units.quantity` declares them.
    """

    name: str
    unit: str
    nominal: float
    deviation: float
    bounds: tuple[float, float]
    sensor: Effect | None = None
    of_material: bool = False
    time_scale: float = float("inf")


@dataclass(frozen=True)
class NominalModel:
    """The model of session.toml with its nuisance parameters; a point is given in prior standard deviations (p,)."""

    variant: ModelVariant
    parameters: tuple[NuisanceParameter, ...]
    options: IdentificationOptions

    def at(self, point: np.ndarray) -> ModelVariant:
        """The variant at a point, held within the bounds of each quantity, and off zero where it is positive."""
        values: dict[str, Any] = {}
        sensors = []
        for parameter, where in zip(self.parameters, point, strict=True):
            low, high = parameter.bounds
            low = max(low, self.options.prior.least_share * parameter.nominal) if low >= 0.0 else low
            value = float(np.clip(parameter.nominal + where * parameter.deviation, low, high))
            if parameter.sensor is None:
                values[parameter.name] = value
            elif where != 0.0:
                sensors.append(parameter.sensor(**{parameter.sensor.amplitude.name: value}))
        return ModelVariant(replace(self.variant.valve, **values), (*self.variant.effects, *sensors))


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
                    (low, high),
                    of_material=declared.metadata["of_material"],
                    time_scale=declared.metadata["time_scale"],
                )  # fmt: skip
            )
    for channel in measured_channels(session):
        span = _span(session, channel)
        for name, tolerance in (
            ("sensor_bias", options.prior.sensor_bias * span),
            ("sensor_gain", options.prior.sensor_gain),
            ("sensor_delay", options.prior.sensor_delay),
        ):
            effect = _either_way(CATALOGUE[name].on(channel))
            amplitude = effect.amplitude
            parameters.append(
                NuisanceParameter(f"{name}@{channel}", amplitude.unit, 0.0, tolerance / 2.0, amplitude.bounds, effect)
            )
    return NominalModel(ModelVariant(session.valve, session.effects), tuple(parameters), options=options)


class ToleratedSensorError(Effect):
    """A sensor's error within its tolerance: a nuisance parameter, not a fault."""


def _either_way(effect: Effect) -> Effect:
    """The effect with an amplitude that may go below neutral as far as above: a clock may also be early."""
    amplitude = effect.amplitude
    wide = replace(amplitude, bounds=(-amplitude.bounds[1], amplitude.bounds[1]))
    parameters = tuple(wide if p is amplitude else p for p in effect.parameters)
    return ToleratedSensorError(
        **{**{f.name: getattr(effect, f.name) for f in fields(effect)}, "parameters": parameters}
    )


def measured_channels(session: Session) -> tuple[str, ...]:
    """The output channels of the training records, in order of appearance; nothing is asked of a hold-out record."""
    return tuple(dict.fromkeys(name for record in session.training for name in record.outputs))


def _span(session: Session, channel: str) -> float:
    values = [record.values[channel] for record in session.training if channel in record.outputs]
    return float(max(np.ptp(v) for v in values))
