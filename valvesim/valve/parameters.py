"""The valve: every dimension and property with unit, bounds and source.

Symbols (docs/site/physics.md)
    L1..L7 heights in the torque motor, l_g1 upper and l_g2 lower air gap, A_g gap area, a armature arm
    gamma share of the magnet flux in the gaps, M0 polarization magnetomotive force, R0 magnet reluctance, N_c turns
    d_n nozzle, d_0 fixed orifice, x_f0 null gap, r nozzle arm, b arm from nozzle to ball
    K_s spring tube, K_f feedback rod, a_m a_c a_x a_f a_s a_p expansions, dT_k = T_k - 20 °C

Side 1 is the nozzle that positive current closes. A difference between sides is (side 1) - (side 2), half on each.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from valvesim.errors import InputError
from valvesim.shown import Shown
from valvesim.units import POSITIVE, check_bounds, quantity
from valvesim.valve.coefficients import PART_NAMES as PART_NAMES
from valvesim.valve.coefficients import REFERENCE_TEMPERATURE as REFERENCE_TEMPERATURE
from valvesim.valve.coefficients import ROUTES, Coefficients, PartTemperatures, coefficients_at
from valvesim.valve.coefficients import check_routes as check_routes
from valvesim.valve.flow_coefficients import FlowLaw, flow_coefficients_yan_2019
from valvesim.valve.fluid import MIL_PRF_5606, Oil

_PAPER, _TEXTBOOK, _ESTIMATE = "paper", "textbook torque motor of this class", "estimate"
_THAYER = "Thayer, Moog Technical Bulletin 103 (1958)"
_NASA, _FITTED = "NASA TN D-5388", "identified: 2.82 N*m/A, magnetic spring 6.5 N*m/rad"


@dataclass(frozen=True, kw_only=True, repr=False)
class Valve(Shown):
    """A two-stage nozzle-flapper valve at 20 °C. Defaults are the reference valve; each has its source.

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
    magnet_expansion: float = quantity(
        11e-6, "1/K", "a_m, AlNiCo", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05, of_material=True
    )
    pole_expansion: float = quantity(
        9.2e-6, "1/K", "a_c, 1J50", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05, of_material=True
    )
    armature_expansion: float = quantity(
        9.2e-6, "1/K", "a_x, 1J50", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05, of_material=True
    )
    feedback_rod_expansion: float = quantity(
        12.14e-6, "1/K", "a_f, 3J1", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05, of_material=True
    )
    spring_tube_expansion: float = quantity(
        17.6e-6, "1/K", "a_s, QBe1.9", (0.0, 1e-4), _PAPER + ", Table 1", tolerance=0.05, of_material=True
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
        -0.596, "A/K", "dM0/dT, reversible", (-10.0, 10.0), _PAPER + ", Eq. 5", tolerance=0.05, of_material=True
    )
    magnet_reluctance: float = quantity(1.76e8, "A/Wb", "R0 of one magnet", (POSITIVE, 1e11), _FITTED, tolerance=0.02)
    coil_turns: float = quantity(4780.0, "1", "N_c, both coils", (POSITIVE, 1e5), _FITTED, tolerance=0.02)
    coil_resistance: float = quantity(
        600.0, "ohm", "coils and amplifier at 20 °C", (POSITIVE, 1e5), _NASA, tolerance=0.02
    )
    coil_inductance: float = quantity(0.57, "H", "coils", (POSITIVE, 100.0), _NASA, tolerance=0.1)
    copper_resistance_slope: float = quantity(
        3.93e-3, "1/K", "of copper at 20 °C", (0.0, 0.02), "handbook", of_material=True
    )
    rated_current: float = quantity(10e-3, "A", "rated current", (POSITIVE, 1.0), _THAYER)
    armature_arm: float = quantity(14.5e-3, "m", "a, arm of the gap forces", (POSITIVE, 0.2), _TEXTBOOK, tolerance=0.02)
    armature_inertia: float = quantity(
        1.78e-7, "kg*m^2", "J, armature and flapper", (POSITIVE, 1e-3), _TEXTBOOK, tolerance=0.1,
        time_scale=1.3e-4,  # sqrt(J/K_s)
    )  # fmt: skip
    armature_damping: float = quantity(
        1.24e-3, "N*m*s/rad", "B_a, armature", (0.0, 1.0), _ESTIMATE + ": ratio 0.4", tolerance=0.2,
        time_scale=2.9e-4,  # 2 J/B_a
    )  # fmt: skip
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
    pilot_expansion: float = quantity(
        11e-6, "1/K", "a_p, pilot metal", (0.0, 1e-4), _ESTIMATE, tolerance=0.05, of_material=True
    )
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
    spool_stroke: float = quantity(0.42e-3, "m", "half stroke to the end stop", (POSITIVE, 0.05), _NASA + ", widened")
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
        3e-6, "m", "spool in sleeve", (POSITIVE, 1e-4), _ESTIMATE + ": in print 0.6 to 8 um", tolerance=0.2
    )
    land_length: float = quantity(1e-3, "m", "leakage length of a land", (POSITIVE, 0.1), _ESTIMATE, tolerance=0.2)
    spool_expansion: float = quantity(
        12e-6, "1/K", "spool steel", (0.0, 1e-4), _ESTIMATE, tolerance=0.05, of_material=True
    )
    sleeve_expansion: float = quantity(
        12e-6, "1/K", "sleeve steel", (0.0, 1e-4), _ESTIMATE, tolerance=0.05, of_material=True
    )
    # pressures
    supply_pressure: float = quantity(21e6, "Pa", "p_s", (POSITIVE, 1e8), "class of 3000 psi")
    return_pressure: float = quantity(0.5e6, "Pa", "p_0 behind the nozzles", (0.0, 1e8), _ESTIMATE)
    load_pressure: float = quantity(0.0, "Pa", "p_L across the load", (-1e8, 1e8), "no load")
    flow_coefficients: FlowLaw = flow_coefficients_yan_2019
    name: str = field(default="", compare=False)  # of a valve that has one: pages and pictures are marked with it

    def __post_init__(self):
        check_bounds(self)
        self._check_order()

    def _check_order(self) -> None:
        """Dimensions that only make sense together."""
        for low, high in (("length_1", "length_2"), ("length_2", "length_3"), ("length_3", "length_4")):
            if np.any(np.asarray(getattr(self, low)) >= np.asarray(getattr(self, high))):
                raise _refused(high, f"must be larger than valve.{low}: the torque motor has no air gap", low)
        for difference, size, names in (
            ("null_gap_difference", self.null_gap, ("null_gap",)),
            ("nozzle_diameter_difference", self.nozzle_diameter, ("nozzle_diameter",)),
            ("fixed_orifice_difference", self.fixed_orifice_diameter, ("fixed_orifice_diameter",)),
            ("air_gap_difference", np.subtract(self.length_2, self.length_1), ("length_2", "length_1")),
            ("air_gap_difference", np.subtract(self.length_4, self.length_3), ("length_4", "length_3")),
        ):
            if np.any(np.abs(getattr(self, difference)) >= 2.0 * np.asarray(size)):
                why = f"must be smaller than twice {' - '.join(names)}: one side would be closed"
                raise _refused(difference, why, *names)
        if np.any(np.asarray(self.return_pressure) >= np.asarray(self.supply_pressure)):
            raise _refused("return_pressure", "must be below valve.supply_pressure", "supply_pressure")
        if np.any(np.abs(self.load_pressure) > np.asarray(self.supply_pressure)):
            why = "must be within the supply pressure: |load_pressure| <= supply_pressure"
            raise _refused("load_pressure", why, "supply_pressure")

    @property
    def is_symmetric(self) -> bool:
        """True where no side differs from the other: the TAD polynomial then holds."""
        sides = (
            self.air_gap_difference, self.null_gap_difference, self.nozzle_diameter_difference,
            self.fixed_orifice_difference,
        )  # fmt: skip
        return not any(np.any(np.asarray(side) != 0.0) for side in sides)

    def in_words(self) -> str:
        """What differs from the reference valve."""
        from valvesim.valve.valve_name import valve_name

        return valve_name(self)

    def at(self, parts: PartTemperatures, *, oil: Oil = MIL_PRF_5606, routes: Iterable[str] = ROUTES) -> Coefficients:
        """`coefficients.coefficients_at` of this valve."""
        return coefficients_at(self, parts, oil=oil, routes=routes)


def _refused(name: str, problem: str, *related: str) -> InputError:
    """The error for a quantity that does not go with the `related` ones."""
    return InputError(problem, key=f"valve.{name}", joint=" ", related=tuple(f"valve.{other}" for other in related))


def reference_valve() -> Valve:
    """The reference valve: parameters of print for one size of valve, the rest estimates (`valvesim parameters`)."""
    return Valve()
