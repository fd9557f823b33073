"""The valve: every dimension and property with unit, bounds and source, and its coefficients at given temperatures.

Symbols (model.md sections 2, 3 and 5)
    L1..L7 heights in the torque motor, l_g1 upper and l_g2 lower air gap, A_g gap area, a armature arm
    gamma share of the magnet flux in the gaps, M0 polarization magnetomotive force, R0 magnet reluctance, N_c turns
    d_n nozzle, d_0 fixed orifice, x_f0 null gap, r nozzle arm, b arm from nozzle to ball
    K_s spring tube, K_f feedback rod, a_m a_c a_x a_f a_s a_p expansions, dT_k = T_k - 20 °C

Side 1 is the nozzle that positive current closes. A difference between sides is (side 1) - (side 2), half on each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError, unknown_name, warn_once
from .fluid import MIL_PRF_5606, Oil
from .units import POSITIVE, check_bounds, quantity

REFERENCE_TEMPERATURE = 20.0  # °C, where every drawing dimension holds

ROUTES = ("flow", "orifice", "mmf", "gap", "reluctance", "arm", "tube", "rod")
"""The paper's eight temperature routes, each of which can be switched off (its coefficients then stay at 20 °C)."""


def flow_coefficients_yan_2019(oil_temperature):
    """(C_df, C_d0) of nozzle and fixed orifice: the paper's Eq. 19 read in °C (model.md 6.3), fitted -40..150 °C.

    Below -40 °C the formula soon turns negative: it is held there, with a warning. Beyond 150 °C it is flat.
    """
    coldest = float(np.min(oil_temperature))
    if coldest < -40.0:
        message = f"flow coefficients (Eq. 19): {coldest:.4g} °C is below their fitted -40 °C; held at -40 °C"
        warn_once(message, about="flow coefficients, cold")
    t = np.maximum(oil_temperature, -40.0)
    return 0.663 - 0.00136 * np.exp(-0.1473 * t), 0.752 - 0.1143 * np.exp(-0.03569 * t)


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


_PAPER, _TEXTBOOK, _ESTIMATE = "paper", "textbook torque motor of this class", "estimate"
_NASA, _FITTED = "NASA TN D-5388", "identified: 2.82 N*m/A, magnetic spring 6.5 N*m/rad"


@dataclass(frozen=True, kw_only=True)
class Valve:
    """A two-stage nozzle-flapper valve at 20 °C. Defaults are the reference valve of model.md section 5.

    Any quantity may also be an array: a batch of valves. Raises InputError for a value outside its bounds.
    """

    # torque motor; its lengths have no tolerance: the gaps are their differences, a thirtieth of them, and are set in
    # assembly. What is left of a unit's spread in the gaps shows in polarization and air_gap_difference
    length_1: float = quantity(7.05e-3, "m", "L1, top of the lower pole", (POSITIVE, 0.1), _PAPER + ", Table 2")
    length_2: float = quantity(7.29e-3, "m", "L2, bottom of the armature", (POSITIVE, 0.1), _PAPER + ", Table 2")
    length_3: float = quantity(8.62e-3, "m", "L3, top of the armature", (POSITIVE, 0.1), _PAPER + ", Table 2")
    length_4: float = quantity(8.85e-3, "m", "L4, bottom of the upper pole", (POSITIVE, 0.1), _PAPER + ", Table 2")
    length_5: float = quantity(2.83e-3, "m", "L5, foot of the magnet", (POSITIVE, 0.1), _PAPER + ", Table 2")
    length_6: float = quantity(10.24e-3, "m", "L6, magnet", (POSITIVE, 0.1), _PAPER + ", Table 2")
    magnet_expansion: float = quantity(11e-6, "1/K", "a_m, AlNiCo", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05)
    pole_expansion: float = quantity(9.2e-6, "1/K", "a_c, 1J50", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05)
    armature_expansion: float = quantity(9.2e-6, "1/K", "a_x, 1J50", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05)
    feedback_rod_expansion: float = quantity(
        12.14e-6, "1/K", "a_f, 3J1", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05
    )
    spring_tube_expansion: float = quantity(
        17.6e-6, "1/K", "a_s, QBe1.9", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05
    )
    air_gap_area: float = quantity(10e-6, "m^2", "A_g, one air gap", (POSITIVE, 1e-3), _FITTED, tolerance=0.02)
    air_gap_difference: float = quantity(
        0.0, "m", "air gaps of end 1 minus end 2", (-2e-4, 2e-4), "symmetric", tolerance=1e-6
    )
    flux_share: float = quantity(
        0.30, "1", "gamma, magnet flux that reaches the gaps", (POSITIVE, 1.0), _PAPER, tolerance=0.02
    )
    polarization_mmf: float = quantity(
        2980.0, "A", "M0 of one magnet", (POSITIVE, 1e5), _PAPER + ", Eq. 5", tolerance=0.02
    )
    polarization_mmf_slope: float = quantity(
        -0.596, "A/K", "dM0/dT, reversible", (-10.0, 10.0), _PAPER + ", Eq. 5", tolerance=0.05
    )
    magnet_reluctance: float = quantity(1.76e8, "A/Wb", "R0 of one magnet", (POSITIVE, 1e11), _FITTED, tolerance=0.02)
    coil_turns: float = quantity(4780.0, "1", "N_c, both coils", (POSITIVE, 1e5), _FITTED, tolerance=0.02)
    coil_resistance: float = quantity(
        600.0, "ohm", "coils and amplifier at 20 °C", (POSITIVE, 1e5), _NASA, tolerance=0.02
    )
    coil_inductance: float = quantity(0.57, "H", "coils", (POSITIVE, 100.0), _NASA, tolerance=0.1)
    copper_resistance_slope: float = quantity(3.93e-3, "1/K", "of copper at 20 °C", (0.0, 0.02), "handbook")
    rated_current: float = quantity(10e-3, "A", "rated current", (POSITIVE, 1.0), "model.md 5")
    armature_arm: float = quantity(14.5e-3, "m", "a, arm of the gap forces", (POSITIVE, 0.2), _TEXTBOOK, tolerance=0.02)
    armature_inertia: float = quantity(
        1.78e-7, "kg*m^2", "J, armature and flapper", (POSITIVE, 1e-3), _TEXTBOOK, tolerance=0.1
    )
    armature_damping: float = quantity(
        1.24e-3, "N*m*s/rad", "B_a, armature", (0.0, 1.0), _ESTIMATE + ": ratio 0.4", tolerance=0.2
    )
    spring_tube_stiffness: float = quantity(
        10.18, "N*m/rad", "K_s, spring tube", (POSITIVE, 1e4), _TEXTBOOK, tolerance=0.02
    )
    feedback_rod_stiffness: float = quantity(
        2780.0, "N/m", "K_f, feedback rod at the ball", (POSITIVE, 1e6), _TEXTBOOK, tolerance=0.02
    )
    # pilot stage
    nozzle_arm: float = quantity(8.9e-3, "m", "r, pivot to nozzle", (POSITIVE, 0.2), _TEXTBOOK, tolerance=0.02)
    feedback_arm: float = quantity(13.3e-3, "m", "b, nozzle to ball", (POSITIVE, 0.2), _TEXTBOOK, tolerance=0.02)
    nozzle_diameter: float = quantity(
        0.30e-3, "m", "d_n, nozzle", (POSITIVE, 5e-3), _NASA + ", implied", tolerance=0.02
    )
    fixed_orifice_diameter: float = quantity(
        0.20e-3, "m", "d_0, fixed orifice", (POSITIVE, 5e-3), _NASA + ", implied", tolerance=0.02
    )
    null_gap: float = quantity(
        0.035e-3, "m", "x_f0, nozzle to flapper", (POSITIVE, 1e-3), _NASA + ", implied", tolerance=0.02
    )
    null_gap_difference: float = quantity(
        0.0, "m", "null gap of side 1 minus side 2", (-1e-4, 1e-4), "symmetric", tolerance=0.3e-6
    )
    nozzle_diameter_difference: float = quantity(
        0.0, "m", "nozzle 1 minus nozzle 2", (-5e-4, 5e-4), "symmetric", tolerance=1e-6
    )
    fixed_orifice_difference: float = quantity(
        0.0, "m", "fixed orifice 1 minus 2", (-5e-4, 5e-4), "symmetric", tolerance=1e-6
    )
    nozzle_length: float = quantity(
        0.3e-3, "m", "l_n, wall that narrows the nozzle", (0.0, 0.05), _ESTIMATE, tolerance=0.2
    )
    fixed_orifice_length: float = quantity(
        0.3e-3, "m", "l_0, wall that narrows the orifice", (0.0, 0.05), _ESTIMATE, tolerance=0.2
    )
    flapper_length: float = quantity(
        0.6e-3, "m", "l_x, metal that closes the null gap", (0.0, 0.05), _ESTIMATE, tolerance=0.2
    )
    pilot_expansion: float = quantity(11e-6, "1/K", "a_p, pilot metal", (0.0, 1e-4), _ESTIMATE, tolerance=0.05)
    chamber_volume: float = quantity(
        0.1e-6, "m^3", "V_1 = V_2, spool end chamber", (POSITIVE, 1e-3), _ESTIMATE, tolerance=0.2
    )
    transition_pressure: float = quantity(
        1e3, "Pa", "pressure drop below which an orifice is laminar", (POSITIVE, 1e6), _ESTIMATE
    )
    flapper_stop_stiffness: float = quantity(5e6, "N/m", "flapper on nozzle", (POSITIVE, 1e10), _ESTIMATE)
    # spool and main stage
    spool_area: float = quantity(16.8e-6, "m^2", "A_v, spool end", (POSITIVE, 1e-2), _NASA, tolerance=0.02)
    spool_mass: float = quantity(4e-3, "kg", "m, spool", (POSITIVE, 10.0), _ESTIMATE, tolerance=0.1)
    spool_damping: float = quantity(
        1.0, "N*s/m", "B_v, viscous damping of the spool", (0.0, 1e4), _ESTIMATE, tolerance=0.3
    )
    spool_stroke: float = quantity(0.42e-3, "m", "half stroke to the end stop", (POSITIVE, 0.05), "model.md 5")
    spool_stop_stiffness: float = quantity(2e7, "N/m", "spool on end stop", (POSITIVE, 1e12), _ESTIMATE)
    stop_damping: float = quantity(1.0, "s/m", "damping of every stop per depth", (0.0, 100.0), _ESTIMATE)
    port_width: float = quantity(
        12.1e-3, "m", "w, area gradient of a port", (POSITIVE, 1.0), _NASA + ", implied", tolerance=0.02
    )
    port_flow_coefficient: float = quantity(
        0.61, "1", "C_d of a port", (POSITIVE, 1.0), "Merritt (1967)", tolerance=0.02
    )
    null_opening: float = quantity(
        3e-6, "m", "opening with the leakage of a closed land", (POSITIVE, 1e-4), _ESTIMATE, tolerance=0.3
    )
    land_overlap: float = quantity(
        0.0, "m", "closed travel before a land opens", (-5e-5, 5e-5), "critical centre", tolerance=1e-6
    )
    radial_clearance: float = quantity(
        3e-6, "m", "spool in sleeve", (POSITIVE, 1e-4), "field.md 4: 0.6-8 um", tolerance=0.2
    )
    land_length: float = quantity(1e-3, "m", "leakage length of a land", (POSITIVE, 0.1), _ESTIMATE, tolerance=0.2)
    spool_expansion: float = quantity(12e-6, "1/K", "spool steel", (0.0, 1e-4), _ESTIMATE, tolerance=0.05)
    sleeve_expansion: float = quantity(12e-6, "1/K", "sleeve steel", (0.0, 1e-4), _ESTIMATE, tolerance=0.05)
    # pressures
    supply_pressure: float = quantity(21e6, "Pa", "p_s", (POSITIVE, 1e8), "model.md 5")
    return_pressure: float = quantity(0.5e6, "Pa", "p_0 behind the nozzles", (0.0, 1e8), "model.md 5")
    load_pressure: float = quantity(0.0, "Pa", "p_L across the load", (-1e8, 1e8), "model.md 5")
    flow_coefficients: Callable = flow_coefficients_yan_2019

    def __post_init__(self):
        check_bounds(self)
        self._check_order()

    def _check_order(self) -> None:
        """Dimensions that only make sense together."""
        for low, high in (("length_1", "length_2"), ("length_2", "length_3"), ("length_3", "length_4")):
            if np.any(np.asarray(getattr(self, low)) >= np.asarray(getattr(self, high))):
                raise InputError(f"valve.{high} must be larger than valve.{low}: the torque motor has no air gap")
        for difference, size, name in (
            ("null_gap_difference", self.null_gap, "null_gap"),
            ("nozzle_diameter_difference", self.nozzle_diameter, "nozzle_diameter"),
            ("fixed_orifice_difference", self.fixed_orifice_diameter, "fixed_orifice_diameter"),
            ("air_gap_difference", np.subtract(self.length_2, self.length_1), "length_2 - length_1"),
            ("air_gap_difference", np.subtract(self.length_4, self.length_3), "length_4 - length_3"),
        ):
            if np.any(np.abs(getattr(self, difference)) >= 2.0 * np.asarray(size)):
                raise InputError(f"valve.{difference} must be smaller than twice {name}: one side would be closed")
        if np.any(np.asarray(self.return_pressure) >= np.asarray(self.supply_pressure)):
            raise InputError("valve.return_pressure must be below valve.supply_pressure")
        if np.any(np.abs(self.load_pressure) > np.asarray(self.supply_pressure)):
            raise InputError(
                "valve.load_pressure must be within the supply pressure: |load_pressure| <= supply_pressure"
            )

    @property
    def is_symmetric(self) -> bool:
        """True where no side differs from the other: the TAD polynomial then holds."""
        sides = (
            self.air_gap_difference, self.null_gap_difference, self.nozzle_diameter_difference,
            self.fixed_orifice_difference,
        )  # fmt: skip
        return not any(np.any(np.asarray(side) != 0.0) for side in sides)

    def at(self, parts: PartTemperatures, *, oil: Oil = MIL_PRF_5606, routes: Iterable[str] = ROUTES) -> Coefficients:
        """Coefficients with each part at its own temperature; shapes of valve and `parts` broadcast.

        Routes left out stay at 20 °C. The oil's own density, viscosity and bulk modulus always follow it.
        Raises InputError for an unknown route and where a clearance closes, with the part and the temperature.
        """
        routes = check_routes(routes)
        oil.check_rated(parts.oil)
        for name in PART_NAMES:
            if not np.all(np.isfinite(getattr(parts, name))):
                raise InputError(f"temperature of the {name.replace('_', ' ')} is nan or infinite")

        def rise(route: str, temperature):
            """dT = T - 20 °C along an active route, else zero."""
            return (np.asarray(temperature, dtype=float) - REFERENCE_TEMPERATURE) * (route in routes)

        gap_motor, gap_tube = rise("gap", parts.torque_motor), rise("gap", parts.spring_tube)
        metal = rise("orifice", parts.pilot_metal)
        length_7 = self.length_5 + self.length_6 - self.length_4
        armature_top = self.length_2 * (1.0 + self.spring_tube_expansion * gap_tube) + (
            self.length_3 - self.length_2
        ) * (1.0 + self.armature_expansion * gap_motor)
        upper_gap = (
            (self.length_5 - length_7) * (1.0 + self.pole_expansion * gap_motor)
            + self.length_6 * (1.0 + self.magnet_expansion * gap_motor)
            - armature_top
        )
        lower_gap = self.length_2 * (1.0 + self.spring_tube_expansion * gap_tube) - self.length_1 * (
            1.0 + self.pole_expansion * gap_motor
        )
        magnet = rise("reluctance", parts.torque_motor)
        nozzle_narrowing = 2.0 * self.nozzle_length * self.pilot_expansion * metal
        orifice_narrowing = 2.0 * self.fixed_orifice_length * self.pilot_expansion * metal
        gap_narrowing = self.flapper_length * self.pilot_expansion * metal
        flow_temperature = np.where("flow" in routes, parts.oil, REFERENCE_TEMPERATURE)
        nozzle_coefficient, orifice_coefficient = self.flow_coefficients(flow_temperature)
        spool_diameter = np.sqrt(4.0 * self.spool_area / np.pi)
        spool_rise = np.asarray(parts.spool, dtype=float) - REFERENCE_TEMPERATURE
        sleeve_rise = np.asarray(parts.sleeve, dtype=float) - REFERENCE_TEMPERATURE
        growth = self.sleeve_expansion * sleeve_rise - self.spool_expansion * spool_rise
        density = oil.density(parts.oil, (np.asarray(self.supply_pressure) + self.return_pressure) / 2.0)
        coil_rise = np.asarray(parts.torque_motor, dtype=float) - REFERENCE_TEMPERATURE
        c = Coefficients(
            upper_air_gap_1=upper_gap + self.air_gap_difference / 2,
            upper_air_gap_2=upper_gap - self.air_gap_difference / 2,
            lower_air_gap_1=lower_gap + self.air_gap_difference / 2,
            lower_air_gap_2=lower_gap - self.air_gap_difference / 2,
            air_gap_area=self.air_gap_area * (1.0 + 2.0 * self.pole_expansion * gap_motor),
            armature_arm=self.armature_arm * (1.0 + self.pole_expansion * rise("arm", parts.torque_motor)),
            polarization_mmf=self.polarization_mmf + self.polarization_mmf_slope * rise("mmf", parts.torque_motor),
            magnet_reluctance=self.magnet_reluctance
            * (1.0 + self.magnet_expansion * magnet)
            / (1.0 + 2.0 * self.magnet_expansion * magnet),
            flux_share=self.flux_share,
            coil_turns=self.coil_turns,
            coil_resistance=self.coil_resistance * (1.0 + self.copper_resistance_slope * coil_rise),
            coil_inductance=self.coil_inductance,
            spring_tube_stiffness=self.spring_tube_stiffness
            * (1.0 - 22.0 * self.spring_tube_expansion * rise("tube", parts.spring_tube)),
            feedback_rod_stiffness=self.feedback_rod_stiffness
            * (1.0 - 24.0 * self.feedback_rod_expansion * rise("rod", parts.feedback_rod)),
            armature_inertia=self.armature_inertia,
            armature_damping=self.armature_damping,
            nozzle_arm=self.nozzle_arm,
            feedback_arm=self.feedback_arm,
            null_gap_1=self.null_gap + self.null_gap_difference / 2 - gap_narrowing,
            null_gap_2=self.null_gap - self.null_gap_difference / 2 - gap_narrowing,
            nozzle_diameter_1=self.nozzle_diameter + self.nozzle_diameter_difference / 2 - nozzle_narrowing,
            nozzle_diameter_2=self.nozzle_diameter - self.nozzle_diameter_difference / 2 - nozzle_narrowing,
            fixed_orifice_diameter_1=self.fixed_orifice_diameter
            + self.fixed_orifice_difference / 2
            - orifice_narrowing,
            fixed_orifice_diameter_2=self.fixed_orifice_diameter
            - self.fixed_orifice_difference / 2
            - orifice_narrowing,
            nozzle_flow_coefficient=nozzle_coefficient,
            orifice_flow_coefficient=orifice_coefficient,
            chamber_volume=self.chamber_volume,
            spool_area=self.spool_area,
            spool_mass=self.spool_mass,
            spool_damping=self.spool_damping,
            spool_stroke=self.spool_stroke,
            port_width=self.port_width,
            port_flow_coefficient=self.port_flow_coefficient,
            null_opening=self.null_opening,
            land_overlap=self.land_overlap,
            spool_circumference=np.pi * spool_diameter,
            radial_clearance=self.radial_clearance + spool_diameter / 2.0 * growth,
            land_length=self.land_length,
            density=density,
            dynamic_viscosity=density * oil.viscosity(parts.oil),
            bulk_modulus_at_zero=oil.bulk_modulus_at_zero(parts.oil),
            bulk_modulus_slope=oil.bulk_modulus_slope,
            flapper_stop_stiffness=self.flapper_stop_stiffness,
            spool_stop_stiffness=self.spool_stop_stiffness,
            stop_damping=self.stop_damping,
            transition_pressure=self.transition_pressure,
        )
        if any(np.min(getattr(c, name)) <= 0.0 for name in _CLEARANCES):
            raise self._closed_clearance(parts, oil, c)
        return c

    def _closed_clearance(self, parts: PartTemperatures, oil: Oil, c: Coefficients) -> InputError:
        """Which clearance closes, and at which temperature of which part: each is linear in its temperatures."""
        cold = self.at(PartTemperatures.uniform(REFERENCE_TEMPERATURE), oil=oil, routes=())
        for name, driving in _CLEARANCES.items():
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
_CLEARANCES: dict[str, tuple[str, ...]] = {  # what can close, and the parts whose temperatures do it
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


def check_routes(routes: Iterable[str]) -> frozenset[str]:
    """The set of route names; InputError for an unknown one."""
    chosen = (routes,) if isinstance(routes, str) else tuple(routes)
    for name in chosen:
        if name not in ROUTES:
            raise unknown_name("temperature route", name, ROUTES)
    return frozenset(chosen)


def reference_valve() -> Valve:
    """The reference valve of model.md section 5."""
    return Valve()
