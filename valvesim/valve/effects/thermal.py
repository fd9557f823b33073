"""Effects on the temperatures of the parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.effect import Advice, Effect
from valvesim.valve.effects.declare import amplitude_parameter
from valvesim.valve.laws import lagged


def _thermal_lag(times, parts: PartTemperatures, p) -> PartTemperatures:
    late = {
        name: lagged(times, np.broadcast_to(getattr(parts, name), np.shape(times)), p.time_constant)
        for name in PART_NAMES
        if name != "oil"
    }
    return replace(parts, **late)


THERMAL = (
    Effect(
        name="thermal_lag",
        doc="every part follows its temperature path with a further first-order lag tau; the oil does not",
        location="temperatures of the parts",
        signature="drift comes late in a temperature transient; nothing once temperatures hold",
        advice=Advice(
            part="parts and their heat paths",
            inspect="thermometers at body and torque motor during a warm-up",
            confirm="drift over a step of the oil's temperature: it comes late and ends the same",
            remedy="state the thermal network as measured; warm through before use",
        ),
        parameters=(amplitude_parameter("time_constant", "s", "tau", (0.0, 1e4), 5.0),),
        temperatures=_thermal_lag,
        lag=lambda p: p.time_constant,
    ),
)
