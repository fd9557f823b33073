"""The torque motor of the paper: air gaps over temperature (Fig. 3) and their flux over current (Fig. 7).

Symbols (docs/site/physics.md)
    L1 to L7 lengths of Table 2, a_c a_x a_m a_s thermal expansions of pole, armature, magnet, spring tube
    R0 to R4 reluctances of magnet and gaps, N magnetomotive force of the coils, M0 of the magnet, phi fluxes
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.paper.published import OIL, RANGE
from valvesim.valve.laws import MU_0
from valvesim.valve.parameters import PartTemperatures, Valve, reference_valve


@dataclass(frozen=True, kw_only=True)
class AirGaps:
    """Fig. 3: drift of the two air gaps in percent over temperature, corrected and by the printed Eqs. 9 and 10."""

    temperatures: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    upper_printed: np.ndarray
    lower_printed: np.ndarray


def air_gaps(temperatures=RANGE) -> AirGaps:
    """The gaps of Table 2 over temperature. Printed Eq. 10 has L5 + L7 for L5 - L7, and l_g2 a_s for L2 a_s."""
    valve, rise = reference_valve(), np.asarray(temperatures) - 20.0
    c = valve.at(PartTemperatures.uniform(temperatures), oil=OIL)
    L1, L2, L3, L4 = valve.length_1, valve.length_2, valve.length_3, valve.length_4
    L5, L6 = valve.length_5, valve.length_6
    L7, upper, lower = L5 + L6 - L4, L4 - L3, L2 - L1
    a_c, a_x, a_m, a_s = (
        valve.pole_expansion, valve.armature_expansion, valve.magnet_expansion, valve.spring_tube_expansion
    )  # fmt: skip
    printed_1 = ((L5 + L7) * a_c + (L2 - L3) * a_x + L6 * a_m - L2 * a_s) / upper
    printed_2 = (lower * a_s - L1 * a_c) / lower
    return AirGaps(
        temperatures=np.asarray(temperatures),
        upper=100.0 * (c.upper_air_gap_1 / upper - 1.0),
        lower=100.0 * (c.lower_air_gap_1 / lower - 1.0),
        upper_printed=100.0 * printed_1 * rise,
        lower_printed=100.0 * printed_2 * rise,
    )


@dataclass(frozen=True, kw_only=True)
class GapFlux:
    """Fig. 7: fluxes phi1..phi4 in Wb, (4, n), over current in A, at 20 °C and the armature held in the middle."""

    currents: np.ndarray
    fluxes: np.ndarray

    @property
    def nonlinearity(self) -> float:
        """Largest distance of a flux from its straight line, % of that flux's rise."""
        worst = 0.0
        for flux in self.fluxes:
            line = np.polyval(np.polyfit(self.currents, flux, 1), self.currents)
            worst = max(worst, float(np.max(np.abs(flux - line)) / np.ptp(flux)))
        return 100.0 * worst


def gap_flux(valve: Valve, currents) -> GapFlux:
    """The nine equations of the magnetic circuit (Eq. 11 restored), solved as they stand."""
    c = valve.at(PartTemperatures.uniform(20.0), oil=OIL)
    share, R0 = c.flux_share, c.magnet_reluctance
    R1 = R2 = c.upper_air_gap_1 / (MU_0 * c.air_gap_area)
    R3 = R4 = c.lower_air_gap_1 / (MU_0 * c.air_gap_area)
    # unknowns: phi1..phi8, phi_a
    rows = np.array(
        [
            [1, 0, 0, 0, 1, 0, -share, 0, 0],
            [0, 1, 0, 0, -1, 0, 0, -share, 0],
            [0, 0, 1, 0, 0, -1, 0, -share, 0],
            [1, 0, 0, -1, 0, 0, 0, 0, -1],
            [0, -1, 1, 0, 0, 0, 0, 0, -1],
            [R1, 0, 0, R4, 0, 0, R0, 0, 0],
            [0, R2, R3, 0, 0, 0, 0, R0, 0],
            [R1, -R2, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, R3, -R4, 0, 0, 0, 0, 0],
        ],
        dtype=float,
    )
    i = np.asarray(currents, dtype=float)
    N, M0 = c.coil_turns * i, np.full(i.shape, float(c.polarization_mmf))
    right = np.stack([*np.zeros((5, len(i))), M0, M0, N, N])
    scale = np.array([1.0] * 5 + [1e-8] * 4)[:, None]
    return GapFlux(currents=i, fluxes=np.linalg.solve(rows * scale, right * scale)[:4])
