"""The unknowns of the paper's lost Table 4, with their physical bounds, and valves drawn from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.valve.parameters import Valve, flow_coefficients_yan_2019, reference_valve


@dataclass(frozen=True, kw_only=True)
class LostValue:
    """A parameter of the lost Table 4: bounds in SI, and why a valve of this class lies inside."""

    name: str
    low: float
    high: float
    why: str


LOST_VALUES = (
    LostValue(name="air_gap_area", low=4e-6, high=30e-6, why="a pole face of 2 x 2 mm to 5 x 6 mm"),
    LostValue(
        name="magnet_reluctance", low=3.9e7, high=4.7e8,
        why=f"Eq. 1 gives l_m/mu = {2980.0 / 1.27:.0f} A/T; a magnet of 5 to 60 mm² section",
    ),
    LostValue(name="coil_turns", low=500.0, high=10000.0, why="coils of 10 to 100 mA down to a few mA"),
    LostValue(name="armature_arm", low=8e-3, high=25e-3, why="14.5 mm in the textbook motor, halved to enlarged"),
    LostValue(name="nozzle_arm", low=4e-3, high=15e-3, why="8.9 mm in the textbook motor, halved to enlarged"),
    LostValue(name="feedback_arm", low=6e-3, high=25e-3, why="13.3 mm in the textbook motor, halved to doubled"),
    LostValue(name="spring_tube_stiffness", low=1.0, high=40.0, why="3.7 to 10.2 N·m/rad in three published sets, x 4"),
    LostValue(name="feedback_rod_stiffness", low=300.0, high=8000.0, why="2.7 to 3.3 kN/m in three published sets"),
    LostValue(name="nozzle_diameter", low=0.15e-3, high=0.8e-3, why="0.3 to 0.6 mm usual; below 0.15 mm it clogs"),
    LostValue(name="fixed_orifice_diameter", low=0.10e-3, high=0.5e-3, why="0.2 mm usual; below 0.1 mm it clogs"),
    LostValue(name="null_gap", low=15e-6, high=150e-6, why="30 to 40 um usual; at 15 um it closes on dirt"),
    LostValue(name="nozzle_length", low=0.05e-3, high=5e-3, why="wall that narrows the bore, up to a whole insert"),
    LostValue(name="fixed_orifice_length", low=0.05e-3, high=5e-3, why="same"),
    LostValue(name="flapper_length", low=0.1e-3, high=5e-3, why="half a flapper and the free end of a nozzle (Eq. 15)"),
    LostValue(name="spool_area", low=8e-6, high=120e-6, why="spool of 3.2 to 12.4 mm diameter"),
    LostValue(name="port_width", low=1e-3, high=40e-3, why="a slot of 1 mm to the whole circumference of 12.4 mm"),
    LostValue(name="supply_pressure", low=7e6, high=28e6, why="aerospace supplies; the paper's CFD has 15 MPa"),
    LostValue(name="return_pressure", low=0.1e6, high=3e6, why="open return to the 3 MPa of the paper's CFD"),
)  # fmt: skip
"""All else is in the paper (Tables 1, 2, gamma, M0). The pilot metal's expansion is held at 11e-6 1/K: it only ever
appears as a product with one of the three lengths."""

_LOW, _HIGH = (np.log([getattr(u, side) for u in LOST_VALUES]) for side in ("low", "high"))
LOG_SPANS = _HIGH - _LOW  # of the logarithmic ranges


def valves(shares: np.ndarray, *, flow_coefficients: Callable = flow_coefficients_yan_2019) -> Valve:
    """A batch of valves from shares (k, 18) of the logarithmic ranges of `LOST_VALUES`; fields are (k, 1)."""
    values = np.exp(_LOW + LOG_SPANS * np.clip(shares, 0.0, 1.0))
    # at the ends the logarithm must not carry a value past its bound
    values = np.clip(values, [u.low for u in LOST_VALUES], [u.high for u in LOST_VALUES])
    fields: dict[str, Any] = {u.name: values[:, k : k + 1] for k, u in enumerate(LOST_VALUES)}
    return replace(reference_valve(), flow_coefficients=flow_coefficients, **fields)
