"""Gains over oil temperature, as a controller schedules them.

Symbols
    K_q = dQ_L/di flow gain, K_c = -dQ_L/dp_L flow-pressure coefficient, K_p = K_q/K_c pressure gain at closed ports"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.linearisation import (
    LINEARISED_OUTPUTS,
    OperatingPoint,
    linearise,
    operating_point,
    scaled_poles,
)
from valvesim.characterisation.reduced_order import bandwidth
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, kw_only=True)
class GainRow:
    """What a controller schedules over oil temperature (°C); small deviations from rest at `current` A.

    `spool_gain` m/A, `flow_gain` K_q m^3/s/A, `flow_pressure_coefficient` K_c m^3/s/Pa, `pressure_gain` K_p = K_q/K_c
    Pa/A at closed ports, `pilot_pressure_gain` Pa/A of nozzle pressure 1 minus 2, `gain_frequency` (-3 dB) and
    `phase_frequency` (-90°) Hz of the spool, `dominant_pole` rad/s: the one nearest to zero (of a pair Im > 0).
    """

    temperature: float
    current: float
    spool_position: float
    spool_gain: float
    flow_gain: float
    flow_pressure_coefficient: float
    pressure_gain: float
    pilot_pressure_gain: float
    gain_frequency: float
    phase_frequency: float
    dominant_pole: complex


def gain_schedule(
    valve: Valve, temperatures: Sequence[float], *, current: float = 0.0, load_pressure: float = 0.0,
    oil: Oil = MIL_PRF_5606,
) -> tuple[GainRow, ...]:  # fmt: skip
    """One row a temperature (°C), with every part at it: the gains at rest and how fast the spool follows.

    A table to interpolate over the oil temperature. At null (`current` 0) the flow gain is twice that beyond the null
    opening of a few micrometres, and the pressure gain holds in there alone: schedule a loop on a row off null. In a
    fast launch the parts trail the oil and the isothermal table errs by some per cent. Raises as `operating_point`
    does.
    """
    return tuple(
        _row(operating_point(valve, current=current, temperature=t, load_pressure=load_pressure, oil=oil))
        for t in temperatures
    )


def _row(point: OperatingPoint) -> GainRow:
    system = linearise(point)
    gains = np.asarray(system(0.0)).real
    gain = {y: dict(zip(system.input_labels, gains[k], strict=True)) for k, y in enumerate(LINEARISED_OUTPUTS)}
    flow, leak = gain["load_flow"]["current"], -gain["load_flow"]["load_pressure"]
    band = bandwidth(system)
    nearest = scaled_poles(point)[0]
    return GainRow(
        temperature=point.temperature,
        current=point.inputs.command,
        spool_position=point.spool_position,
        spool_gain=float(gain["spool_position"]["current"]),
        flow_gain=float(flow),
        flow_pressure_coefficient=float(leak),
        pressure_gain=float(flow / leak) if leak else float("nan"),
        pilot_pressure_gain=float(gain["pilot_differential_pressure"]["current"]),
        gain_frequency=band.gain_frequency,
        phase_frequency=band.phase_frequency,
        dominant_pole=complex(nearest.real, abs(nearest.imag)),
    )
