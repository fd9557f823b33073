"""Shift of null with temperature, supply pressure and return pressure (SAE ARP490, ISO 10770-1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.acceptance.metrics import merit
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.rest_curve import null_current, rest_curve
from valvesim.errors import InputError, SolveError

TEMPERATURE_DIFFERENCE, PRESSURE_CHANGE = 38.0, 0.2  # K; share of supply pressure
TEMPERATURES = np.linspace(-40.0, 135.0, 15)  # °C, of the curve over temperature
SUPPLIES, RETURNS = np.linspace(0.2, 1.2, 11), np.linspace(0.0, 0.4, 9)  # shares of supply pressure, of the curves


@dataclass(frozen=True)
class NullShiftCurve:
    """Shift of null over a condition by name: `at` (n,) in SI or °C, `shift` (n,) share of i_R from the test's own."""

    condition: str
    at: np.ndarray
    shift: np.ndarray


def null_shift_curves(rig: Rig) -> tuple[NullShiftCurve, ...]:
    """Shift of null over oil temperature, supply and return pressure, of the valve without its effects in service.

    Raises as `Valve.at` does.
    """
    valve, supply = rig.valve, float(rig.valve.supply_pressure)
    base = {"supply_pressure": supply, "return_pressure": float(valve.return_pressure),
            "oil_temperature": rig.oil_temperature}  # fmt: skip
    ranges = {"oil_temperature": TEMPERATURES, "supply_pressure": SUPPLIES * supply,
              "return_pressure": RETURNS * supply}  # fmt: skip

    def null(conditions: dict[str, float]) -> float:
        return float(null_current(rest_curve(valve, conditions, rig.oil))[0]) / float(valve.rated_current)

    here = null(base)
    return tuple(
        NullShiftCurve(name, at, np.array([null({**base, name: float(value)}) - here for value in at]))
        for name, at in ranges.items()
    )


def null_shift_figures(rig: Rig, *, temperature_difference: float = TEMPERATURE_DIFFERENCE) -> FiguresOfMerit:
    """Shift of null, share of i_R: over 38 K, over supply +-20 %, and over return up to 20 % of supply (ARP490)."""
    warm = rig.oil_temperature + temperature_difference
    valve, at = rig.valve, rig.null()
    rated, p_s = float(valve.rated_current), float(valve.supply_pressure)
    conditions: tuple[tuple[str, str, tuple[tuple[str, float], ...]], ...] = (
        ("temperature", f"over +{temperature_difference:g} K of oil and parts", (("oil_temperature", warm),)),
        (
            "supply",
            "over +-20 % of supply, the greater",
            tuple(("supply_pressure", (1.0 + change) * p_s) for change in (-PRESSURE_CHANGE, PRESSURE_CHANGE)),
        ),
        ("return", "over return pressure up to 20 % of supply", (("return_pressure", PRESSURE_CHANGE * p_s),)),
    )
    figures: list[FigureOfMerit | Absent] = []
    for name, doc, changes in conditions:
        try:
            shift = max(((_changed(rig, *one).null() - at) / rated for one in changes), key=abs)
        except (InputError, SolveError) as error:
            figures.append(Absent(name, str(error)))
            continue
        figures.append(merit(name, shift, 2e-6, "1", f"shift of null {doc}, share of i_R"))
    return tuple(figures)


def _changed(rig: Rig, name: str, value: float) -> Rig:
    """The rig with one condition of the bench or figure of the valve changed."""
    if name == "oil_temperature":
        return replace(rig, oil_temperature=value)
    figures: dict[str, float] = {name: value}
    return replace(rig, valve=replace(rig.valve, **figures))  # type: ignore[arg-type]
