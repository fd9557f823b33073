"""Where a valve rests at 20 °C over the currents of a run: the line that a run's characteristic is held against."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.thermal_drift import reference_current
from valvesim.simulation.scenario import Scenario
from valvesim.valve.coefficients import REFERENCE_TEMPERATURE, PartTemperatures
from valvesim.valve.equilibrium import static_solution

POINTS = 41


@dataclass(frozen=True, kw_only=True)
class RestCharacteristic:
    """Armature angle (rad) and spool position (m) at rest over current (A), (n,) each, every part at 20 °C."""

    current: np.ndarray
    armature_angle: np.ndarray
    spool_position: np.ndarray


def rest_characteristic(scenario: Scenario) -> RestCharacteristic:
    """At `POINTS` currents up to `reference_current` either way, without effects, at the pressures of the start.

    Raises as `static_solution` does.
    """
    top = reference_current(scenario)
    current = np.linspace(-top, top, POINTS)
    rest = static_solution(
        scenario.valve_at_start, current=current, parts=PartTemperatures.uniform(REFERENCE_TEMPERATURE), routes=(),
        oil=scenario.oil,
    )  # fmt: skip
    return RestCharacteristic(current=current, armature_angle=rest.armature_angle, spool_position=rest.spool_position)
