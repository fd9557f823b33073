"""Shift of null with temperature, supply pressure and return pressure (SAE ARP490, ISO 10770-1)."""

from __future__ import annotations

from dataclasses import replace

from valvesim.characterisation.acceptance.metrics import merit
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.errors import InputError, SolveError

TEMPERATURE_DIFFERENCE, PRESSURE_CHANGE = 38.0, 0.2  # K; share of supply pressure


def null_shift_figures(rig: Rig) -> FiguresOfMerit:
    """Shift of null, share of i_R: over 38 K, over supply +-20 %, and over return up to 20 % of supply (ARP490)."""
    valve, at = rig.valve, rig.null()
    rated, p_s = float(valve.rated_current), float(valve.supply_pressure)
    conditions: tuple[tuple[str, str, tuple[tuple[str, float], ...]], ...] = (
        ("temperature", "over +38 K of oil and parts", (("oil_temperature", rig.oil_temperature + TEMPERATURE_DIFFERENCE),)),
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
