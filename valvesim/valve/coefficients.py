"""What the valve's equations need at given temperatures, and the temperatures of the parts.

Symbols (docs/site/physics.md)
    L1..L7 heights in the torque motor, l_g1 upper and l_g2 lower air gap, A_g gap area, a armature arm
    M0 polarization magnetomotive force, R0 magnet reluctance, K_s spring tube, K_f feedback rod
    a_m a_c a_x a_f a_s a_p expansions, dT_k = T_k - 20 °C"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.valve.flow_coefficients import pilot_flow
from valvesim.valve.fluid import MIL_PRF_5606, Oil

if TYPE_CHECKING:
    from valvesim.valve.parameters import Valve

REFERENCE_TEMPERATURE = 20.0  # °C, where every drawing dimension holds
ROUTES = ("flow", "orifice", "mmf", "gap", "reluctance", "arm", "tube", "rod")
"""The paper's eight temperature routes, each of which can be switched off (its coefficients then stay at 20 °C)."""


@dataclass(frozen=True, kw_only=True)
class PartTemperatures:
    """Temperatures of the oil in the pilot stage and of the parts, °C; floats or arrays that broadcast."""

    oil: Any
    pilot_metal: Any
    spool: Any
    sleeve: Any
    body: Any
    torque_motor: Any
    spring_tube: Any
    feedback_rod: Any

    @classmethod
    def uniform(cls, temperature) -> PartTemperatures:
        """Every part at one temperature: the paper's isothermal assumption."""
        return cls(**dict.fromkeys(PART_NAMES, temperature))


PART_NAMES = tuple(f.name for f in fields(PartTemperatures))


class Coefficients(NamedTuple):
    """What the equations need, at given temperatures: SI floats or arrays of one shape. Order is the compiled order."""

    upper_air_gap_1: Any
    upper_air_gap_2: Any
    lower_air_gap_1: Any
    lower_air_gap_2: Any
    air_gap_area: Any
    armature_arm: Any
    polarization_mmf: Any
    magnet_reluctance: Any
    flux_share: Any
    coil_turns: Any
    coil_resistance: Any
    coil_inductance: Any
    spring_tube_stiffness: Any
    feedback_rod_stiffness: Any
    armature_inertia: Any
    armature_damping: Any
    nozzle_arm: Any
    feedback_arm: Any
    null_gap_1: Any
    null_gap_2: Any
    nozzle_diameter_1: Any
    nozzle_diameter_2: Any
    fixed_orifice_diameter_1: Any
    fixed_orifice_diameter_2: Any
    nozzle_flow_coefficient: Any
    orifice_flow_coefficient: Any
    nozzle_laminar_loss: Any
    orifice_laminar_loss: Any
    orifice_wall_loss: Any
    chamber_volume: Any
    spool_area: Any
    spool_mass: Any
    spool_damping: Any
    spool_stroke: Any
    port_width: Any
    port_flow_coefficient: Any
    null_opening: Any
    land_overlap: Any
    spool_circumference: Any
    radial_clearance: Any
    land_length: Any
    density: Any
    dynamic_viscosity: Any
    bulk_modulus_at_zero: Any
    bulk_modulus_slope: Any
    flapper_stop_stiffness: Any
    spool_stop_stiffness: Any
    stop_damping: Any
    transition_pressure: Any


def coefficients_at(
    valve: Valve, parts: PartTemperatures, *, oil: Oil = MIL_PRF_5606, routes: Iterable[str] = ROUTES
) -> Coefficients:
    """Coefficients with each part at its own temperature; shapes of valve and `parts` broadcast.

    Routes left out stay at 20 °C. The oil's own density, viscosity and bulk modulus always follow it.
    Raises InputError for an unknown route and where a clearance closes, with the part and the temperature.
    """
    routes = check_routes(routes)
    oil.check_rated(parts.oil)
    for name in PART_NAMES:
        if not np.all(np.isfinite(getattr(parts, name))):
            raise InputError(f"temperature of the {name.replace('_', ' ')} is nan or infinite")
    c = coefficient_formulas(valve, parts, oil, routes)
    if any(np.min(getattr(c, name)) <= 0.0 for name in CLEARANCES):
        raise _closed_clearance(valve, parts, oil, c)
    return c


def coefficient_formulas(valve: Any, parts: PartTemperatures, oil: Oil, routes: frozenset[str]) -> Coefficients:
    """What `coefficients_at` gives, without its checks: quantities and temperatures may be traced symbols."""

    def rise(route: str, temperature):
        """dT = T - 20 °C along an active route, else zero."""
        return (np.asarray(temperature) - REFERENCE_TEMPERATURE) * (route in routes)

    flow_temperature = parts.oil if "flow" in routes else REFERENCE_TEMPERATURE + 0.0 * np.asarray(parts.oil)
    pilot = pilot_flow(
        valve.flow_coefficients, flow_temperature, valve.fixed_orifice_length, valve.fixed_orifice_diameter
    )
    mean_pressure = (np.asarray(valve.supply_pressure) + valve.return_pressure) / 2.0
    density = oil.density(parts.oil, mean_pressure)
    viscosity = density * oil.viscosity(parts.oil, mean_pressure)
    # without the route "flow" the pilot's Reynolds numbers stay at 20 °C, where the leakage's viscosity does not
    cold_density = oil.density(flow_temperature, mean_pressure)
    cold_viscosity = cold_density * oil.viscosity(flow_temperature, mean_pressure)
    held = cold_viscosity / viscosity * np.sqrt(density / cold_density)
    return Coefficients(
        **{name: getattr(valve, name) for name in _INDEPENDENT},
        **_torque_motor(valve, parts, rise),
        **_pilot_stage(valve, rise("orifice", parts.pilot_metal)),
        **_spool(valve, parts),
        nozzle_flow_coefficient=pilot.nozzle,
        orifice_flow_coefficient=pilot.orifice,
        nozzle_laminar_loss=pilot.nozzle_loss * held,
        orifice_laminar_loss=pilot.orifice_loss * held,
        orifice_wall_loss=pilot.orifice_wall_loss * held,
        density=density,
        dynamic_viscosity=viscosity,
        bulk_modulus_at_zero=oil.bulk_modulus_at_zero(parts.oil),
        bulk_modulus_slope=oil.bulk_modulus_slope,
    )


_INDEPENDENT = (
    "flux_share", "coil_turns", "coil_inductance", "armature_inertia", "armature_damping", "nozzle_arm", "feedback_arm",
    "chamber_volume", "spool_area", "spool_mass", "spool_damping", "spool_stroke", "port_width",
    "port_flow_coefficient", "null_opening", "land_overlap", "land_length", "flapper_stop_stiffness",
    "spool_stop_stiffness", "stop_damping", "transition_pressure",
)  # fmt: skip
"""Coefficients that are the valve's quantities of the same name at every temperature."""


def _torque_motor(valve: Any, parts: PartTemperatures, rise: Callable[[str, Any], Any]) -> dict[str, Any]:
    """Air gaps, magnetic circuit, coil and springs; `rise(route, temperature)` is dT along a route."""
    gap_motor, gap_tube = rise("gap", parts.torque_motor), rise("gap", parts.spring_tube)
    length_7 = valve.length_5 + valve.length_6 - valve.length_4
    armature_top = valve.length_2 * (1.0 + valve.spring_tube_expansion * gap_tube) + (
        valve.length_3 - valve.length_2
    ) * (1.0 + valve.armature_expansion * gap_motor)
    upper_gap = (
        (valve.length_5 - length_7) * (1.0 + valve.pole_expansion * gap_motor)
        + valve.length_6 * (1.0 + valve.magnet_expansion * gap_motor)
        - armature_top
    )
    lower_gap = valve.length_2 * (1.0 + valve.spring_tube_expansion * gap_tube) - valve.length_1 * (
        1.0 + valve.pole_expansion * gap_motor
    )
    magnet = rise("reluctance", parts.torque_motor)
    coil_rise = np.asarray(parts.torque_motor) - REFERENCE_TEMPERATURE
    return {
        "upper_air_gap_1": upper_gap + valve.air_gap_difference / 2,
        "upper_air_gap_2": upper_gap - valve.air_gap_difference / 2,
        "lower_air_gap_1": lower_gap + valve.air_gap_difference / 2,
        "lower_air_gap_2": lower_gap - valve.air_gap_difference / 2,
        "air_gap_area": valve.air_gap_area * (1.0 + 2.0 * valve.pole_expansion * gap_motor),
        "armature_arm": valve.armature_arm * (1.0 + valve.pole_expansion * rise("arm", parts.torque_motor)),
        "polarization_mmf": valve.polarization_mmf + valve.polarization_mmf_slope * rise("mmf", parts.torque_motor),
        "magnet_reluctance": valve.magnet_reluctance
        * (1.0 + valve.magnet_expansion * magnet)
        / (1.0 + 2.0 * valve.magnet_expansion * magnet),
        "coil_resistance": valve.coil_resistance * (1.0 + valve.copper_resistance_slope * coil_rise),
        "spring_tube_stiffness": valve.spring_tube_stiffness
        * (1.0 - 22.0 * valve.spring_tube_expansion * rise("tube", parts.spring_tube)),
        "feedback_rod_stiffness": valve.feedback_rod_stiffness
        * (1.0 - 24.0 * valve.feedback_rod_expansion * rise("rod", parts.feedback_rod)),
    }


def _pilot_stage(valve: Any, metal) -> dict[str, Any]:
    """Gaps, nozzles and orifices, whose metal is warmer by `metal` K along its route."""
    nozzle_narrowing = 2.0 * valve.nozzle_length * valve.pilot_expansion * metal
    orifice_narrowing = 2.0 * valve.fixed_orifice_length * valve.pilot_expansion * metal
    gap_narrowing = valve.flapper_length * valve.pilot_expansion * metal
    orifice, difference = valve.fixed_orifice_diameter, valve.fixed_orifice_difference
    return {
        "null_gap_1": valve.null_gap + valve.null_gap_difference / 2 - gap_narrowing,
        "null_gap_2": valve.null_gap - valve.null_gap_difference / 2 - gap_narrowing,
        "nozzle_diameter_1": valve.nozzle_diameter + valve.nozzle_diameter_difference / 2 - nozzle_narrowing,
        "nozzle_diameter_2": valve.nozzle_diameter - valve.nozzle_diameter_difference / 2 - nozzle_narrowing,
        "fixed_orifice_diameter_1": orifice + difference / 2 - orifice_narrowing,
        "fixed_orifice_diameter_2": orifice - difference / 2 - orifice_narrowing,
    }


def _spool(valve: Any, parts: PartTemperatures) -> dict[str, Any]:
    """Circumference and clearance of the spool in its sleeve."""
    spool_diameter = np.sqrt(4.0 * valve.spool_area / np.pi)
    spool_rise = np.asarray(parts.spool) - REFERENCE_TEMPERATURE
    sleeve_rise = np.asarray(parts.sleeve) - REFERENCE_TEMPERATURE
    growth = valve.sleeve_expansion * sleeve_rise - valve.spool_expansion * spool_rise
    return {
        "spool_circumference": np.pi * spool_diameter,
        "radial_clearance": valve.radial_clearance + spool_diameter / 2.0 * growth,
    }


def _closed_clearance(valve: Valve, parts: PartTemperatures, oil: Oil, c: Coefficients) -> InputError:
    """Which clearance closes, and at which temperature of which part: each is linear in its temperatures."""
    cold = coefficients_at(valve, PartTemperatures.uniform(REFERENCE_TEMPERATURE), oil=oil, routes=())
    for name, driving in CLEARANCES.items():
        if np.min(getattr(c, name)) > 0.0:
            continue
        values = np.broadcast_arrays(
            getattr(cold, name), getattr(c, name), *(getattr(parts, part) for part in driving)
        )  # fmt: skip
        worst = np.argmin(values[1])
        cold_value, hot_value, *temperatures = (float(value.flat[worst]) for value in values)
        part, temperature = max(
            zip(driving, temperatures, strict=True), key=lambda pair: abs(pair[1] - REFERENCE_TEMPERATURE)
        )
        share = cold_value / (cold_value - hot_value)
        closes = REFERENCE_TEMPERATURE + share * (temperature - REFERENCE_TEMPERATURE)
        return InputError(
            f"valve: {name.replace('_', ' ')} closes when the {part.replace('_', ' ')} reaches {closes:.4g} °C "
            f"(asked for {temperature:.4g} °C; {cold_value * 1e3:.4g} mm at 20 °C)"
        )
    raise AssertionError("no clearance is closed")  # pragma: no cover - the caller has seen one


_PILOT, _MOTOR = ("pilot_metal",), ("torque_motor", "spring_tube")
CLEARANCES: dict[str, tuple[str, ...]] = {  # what can close, and the parts whose temperatures do it
    "null_gap_1": _PILOT,
    "null_gap_2": _PILOT,
    "nozzle_diameter_1": _PILOT,
    "nozzle_diameter_2": _PILOT,
    "fixed_orifice_diameter_1": _PILOT,
    "fixed_orifice_diameter_2": _PILOT,
    "upper_air_gap_1": _MOTOR,
    "upper_air_gap_2": _MOTOR,
    "lower_air_gap_1": _MOTOR,
    "lower_air_gap_2": _MOTOR,
    "radial_clearance": ("spool", "sleeve"),
}


def check_routes(routes: Iterable[str], where: str = "") -> frozenset[str]:
    """The set of route names; InputError for an unknown one, with the key `where`."""
    chosen = (routes,) if isinstance(routes, str) else tuple(routes)
    for name in chosen:
        if name not in ROUTES:
            raise unknown_name("temperature route", name, ROUTES, where)
    return frozenset(chosen)
