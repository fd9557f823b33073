"""What temperature does to the valve: static drift along a run, in all and by route, and the drift that the run shows.

Drift is relative to the same valve with every part at 20 °C: 0.02 means 2 % more angle (or spool position).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from valvesim.channels import STATE_CHANNELS
from valvesim.characterisation.rest_curve import null_current, rest_curve_of
from valvesim.inputs import PIECE_WIDTH, WAVE_WIDTH, Constant, largest
from valvesim.simulation.result import Result
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.valve.coefficients import PART_NAMES, REFERENCE_TEMPERATURE, ROUTES, PartTemperatures
from valvesim.valve.equilibrium import static_solution

QUANTITIES = ("armature_angle", "spool_position")
SCALES = {channel.name: channel.scale for channel in STATE_CHANNELS}
LEAST_MOTION = 1e-3  # share of its scale below which a quantity counts as not moving


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Drift over time at one held current: `total[quantity]` and `by_route[route][quantity]`, each (n_t,).

    `null_shift` (n_t,) is where null is, from where it is at 20 °C, share of rated current.
    """

    times: np.ndarray
    oil_temperature: np.ndarray
    current: float
    total: dict[str, np.ndarray]
    by_route: dict[str, dict[str, np.ndarray]]
    null_shift: np.ndarray

    def since_start(self) -> dict[str, np.ndarray]:
        """Drift from the run's own start, by quantity, (n_t,)."""
        return {name: (1.0 + shares) / (1.0 + shares[0]) - 1.0 for name, shares in self.total.items()}


def reference_current(scenario: Scenario) -> float:
    """The current at which drift is told, A: the largest of the command within the rated, a tenth of that if zero."""
    top, rated = largest(scenario.command, scenario.duration), scenario.valve.rated_current
    top = scenario.drive.current_for_command(top, scenario.valve.coil_resistance)
    return min(top, rated) or 0.1 * rated


def static_drift(result: Result, *, points: int = 101) -> Drift:
    """Drift of the static solution along the part temperatures of a run, at `reference_current`.

    It is that of the valve without effects, at the pressures of the start. Raises as `static_solution` does.
    """
    scenario = result.scenario
    pick = np.unique(np.linspace(0, len(result.time) - 1, points).astype(int))
    parts = PartTemperatures(**{name: result.values[f"{name}_temperature"][pick] for name in PART_NAMES})
    current = reference_current(scenario)
    valve = scenario.valve_at_start

    def solve(temperatures: PartTemperatures, routes: tuple[str, ...]):
        return static_solution(valve, current=current, parts=temperatures, routes=routes, oil=scenario.oil)

    cold = solve(PartTemperatures.uniform(REFERENCE_TEMPERATURE), ())

    def drift(routes: tuple[str, ...]) -> dict[str, np.ndarray]:
        warm = solve(parts, routes)
        return {
            name: np.broadcast_to(getattr(warm, name) / getattr(cold, name) - 1.0, pick.shape) for name in QUANTITIES
        }

    return Drift(
        times=result.time[pick],
        oil_temperature=np.asarray(parts.oil),
        current=current,
        total=drift(tuple(scenario.thermal.routes)),
        by_route={route: drift((route,)) for route in ROUTES if route in scenario.thermal.routes},
        null_shift=_null_shift(scenario, parts),
    )


def _null_shift(scenario: Scenario, parts: PartTemperatures) -> np.ndarray:
    """Null along temperatures of the parts (n_t,), from null at 20 °C, share of rated current."""
    valve = scenario.valve_at_start
    supply, back = float(valve.supply_pressure), float(valve.return_pressure)

    def null(temperatures: PartTemperatures) -> np.ndarray:
        c = valve.at(temperatures, oil=scenario.oil, routes=scenario.thermal.routes)
        return null_current(rest_curve_of(c, supply, back)) / float(valve.rated_current)

    shift = null(parts) - null(PartTemperatures.uniform(REFERENCE_TEMPERATURE))
    return np.broadcast_to(shift, np.shape(parts.oil))


def nominal(scenario: Scenario) -> Scenario:
    """The same run with oil and every part held at 20 °C."""
    thermal = Thermal(network=None, routes=scenario.thermal.routes)
    return replace(scenario, thermal=thermal, oil_temperature=Constant(value=REFERENCE_TEMPERATURE))


def observed_drift(result: Result, cold: Result, *, windows: int = 60) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(window centres s, drift by quantity): gain of a run over the same run at 20 °C, least squares per window.

    NaN where the cold run hardly moves in a window, or not at all.
    """
    edges = np.linspace(0, len(result.time), windows + 1).astype(int)
    centres = np.array([result.time[a:b].mean() for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a])
    drifts = {}
    for name in QUANTITIES:
        warm_values, cold_values = result.values[name], cold.values[name]
        floor = 1e-3 * max(np.max(np.abs(cold_values)), LEAST_MOTION * SCALES[name]) ** 2
        gains = []
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            if b > a:
                power = np.mean(cold_values[a:b] ** 2)
                gains.append(np.mean(warm_values[a:b] * cold_values[a:b]) / power - 1.0 if power > floor else np.nan)
        drifts[name] = np.array(gains)
    return centres, drifts


def frequency_goes(scenario: Scenario) -> bool:
    """True of a command whose frequency changes: then the amplitude goes with it, and tells nothing of drift."""
    rows = scenario.command.pieces(scenario.duration)
    waves = rows[:, PIECE_WIDTH:].reshape(len(rows), -1, WAVE_WIDTH)
    return bool(np.any((waves[:, :, 0] != 0.0) & ((waves[:, :, 2] != 0.0) | (waves[:, :, 3] != 0.0))))


def temperature_varies(scenario: Scenario) -> bool:
    """True where the oil or a part is ever away from 20 °C, so that there is a drift to show."""
    path = scenario.temperatures(spacing=0.5)
    return any(np.any(np.abs(getattr(path.parts, name) - REFERENCE_TEMPERATURE) > 1e-9) for name in PART_NAMES)
