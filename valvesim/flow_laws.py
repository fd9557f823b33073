"""Flow coefficients of nozzle and fixed orifice over Reynolds number, fitted to Table 3 of the paper.

Symbols
    C flow coefficient, C_inf its limit, Re_c where it would vanish, n exponent, h height and Re_h place of a hump
    Re = D_h sqrt(2 dp/rho)/nu with the hydraulic diameter D_h (2 x_f0 of the nozzle's ring slot, d_0 of the orifice)

    C = C_inf [1 - (Re_c/Re)^n] [1 + h sqrt(Re/Re_h) exp((1 - Re/Re_h)/2)]      for Re >= Re_low
    C = C(Re_low) Re/Re_low                                                     below: viscous flow, q ~ dp/nu

With h = 0 and the paper's viscosity (Eq. 18, nu ~ exp(-0.03 T)) this is the paper's Eq. 19 itself, for (Re_c/Re)^n is
then an exponential of T: n = 0.03569/0.03 and 0.1473/0.03. The hump is new: it rises as sqrt(Re), as a boundary layer
thins, and dies off exponentially, so C_inf is reached from above. The nozzle of Table 3 has one, the orifice none.

Source: Table 3 of Yan, Liu, Ma, IEEE Access 2019 (their CFD, inlet 15 MPa, outlet 3 MPa). Assumed here, since the paper
does not say: the oil of Eq. 18 read in °C, 860 kg/m^3, null gap 0.035 mm, fixed orifice 0.20 mm. A wrong assumption
scales Re_c, Re_h and Re_low alike and leaves the fit as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import InputError, warn_once
from .fluid import MIL_PRF_5606, viscosity_yan_2019
from .parameters import flow_coefficients_yan_2019

TABLE_3 = np.array(
    [
        (-40.0, 0.1716, 0.2758), (-30.0, 0.5501, 0.4185), (-20.0, 0.6371, 0.5186), (0.0, 0.6617, 0.6372),
        (20.0, 0.6629, 0.6960), (50.0, 0.6722, 0.7348), (100.0, 0.6635, 0.7467), (120.0, 0.6585, 0.7509),
        (150.0, 0.6581, 0.7517),
    ]
)  # fmt: skip
"""Paper, Table 3: temperature °C, flow coefficient of the nozzle-flapper orifice, of the fixed orifice."""

PRESSURE_DROP = 15e6 - 3e6  # Pa, the paper's CFD case
DENSITY = 860.0  # kg/m^3, assumed
NOZZLE_HYDRAULIC_DIAMETER = 2 * 0.035e-3  # m, twice the reference valve's null gap
ORIFICE_HYDRAULIC_DIAMETER = 0.20e-3  # m, of the reference valve


def reynolds_number(temperature, hydraulic_diameter: float, *, viscosity: Callable = viscosity_yan_2019):
    """Re = D_h sqrt(2 dp/rho)/nu of the paper's CFD case at an oil temperature in °C; `viscosity` gives m^2/s."""
    return hydraulic_diameter * np.sqrt(2.0 * PRESSURE_DROP / DENSITY) / viscosity(temperature)


@dataclass(frozen=True, kw_only=True)
class OrificeLaw:
    """C(Re) of one orifice, as in the module's head. Positive, continuous and without steps for every Re > 0."""

    limit: float
    critical: float
    exponent: float
    hump: float = 0.0
    hump_place: float = 1000.0
    lowest: float
    """The lowest Reynolds number of the fit; viscous below."""

    def __post_init__(self):
        if not (0.0 < self.critical < self.lowest and self.limit > 0.0 and self.hump_place > 0.0):
            raise InputError(
                f"orifice law: 0 < critical ({self.critical:.6g}) < lowest ({self.lowest:.6g}) and a positive limit "
                f"({self.limit:.6g}) and hump_place ({self.hump_place:.6g}) are needed"
            )

    def __call__(self, reynolds):
        """The flow coefficient at a Reynolds number."""
        at = np.maximum(reynolds, self.lowest)
        x = at / self.hump_place
        turbulent = self.limit * (1.0 - (self.critical / at) ** self.exponent)
        return turbulent * (1.0 + self.hump * np.sqrt(x) * np.exp((1.0 - x) / 2.0)) * np.asarray(reynolds) / at


@dataclass(frozen=True, kw_only=True)
class ReynoldsFlowLaw:
    """(C_df, C_d0) at an oil temperature, for the field `flow_coefficients` of a valve.

    `viscosity` (°C -> m^2/s) is the oil's. In Reynolds number the paper's CFD reaches further than in temperature: by
    Eq. 18 its 150 °C row has a higher Re than a real oil reaches at 270 °C, so that nothing is extrapolated there.
    """

    nozzle: OrificeLaw
    fixed_orifice: OrificeLaw
    viscosity: Callable

    def __call__(self, oil_temperature):
        """(C_df, C_d0); beyond the Reynolds numbers of Table 3 with a warning."""
        nozzle = reynolds_number(oil_temperature, NOZZLE_HYDRAULIC_DIAMETER, viscosity=self.viscosity)
        orifice = reynolds_number(oil_temperature, ORIFICE_HYDRAULIC_DIAMETER, viscosity=self.viscosity)
        highest = float(reynolds_number(TABLE_3[-1, 0], NOZZLE_HYDRAULIC_DIAMETER))
        if np.min(nozzle) < self.nozzle.lowest * (1.0 - 1e-4):
            warn_once(
                f"flow coefficients (Reynolds law): nozzle Reynolds number down to {np.min(nozzle):.3g} is below the "
                f"{self.nozzle.lowest:.3g} of Table 3; viscous flow assumed",
                about="flow coefficients (Reynolds law), cold",
            )
        if np.max(nozzle) > highest * (1.0 + 1e-4):
            warn_once(
                f"flow coefficients (Reynolds law): nozzle Reynolds number up to {np.max(nozzle):.3g} is above the "
                f"{highest:.3g} of Table 3; held near its limit",
                about="flow coefficients (Reynolds law), hot",
            )
        return self.nozzle(nozzle), self.fixed_orifice(orifice)


def fit_orifice_law(reynolds: np.ndarray, coefficients: np.ndarray, *, hump: bool, lowest: float | None = None):
    """Least squares of the relative error over all points given, from four starts: an `OrificeLaw`.

    `lowest` is where the law turns viscous [the lowest Reynolds number given].
    """
    from scipy.optimize import least_squares

    lowest = float(np.min(reynolds)) if lowest is None else lowest

    def law(p) -> OrificeLaw:
        limit, share, exponent, *rest = p
        return OrificeLaw(
            limit=float(limit), critical=float(share * lowest), exponent=float(exponent), lowest=float(lowest),
            hump=float(rest[0]) if rest else 0.0, hump_place=float(rest[1] * lowest) if rest else 1000.0,
        )  # fmt: skip

    best: Any = None
    for share in (0.7, 0.95):
        for exponent in (1.2, 4.0):
            start = [float(coefficients[-1]), share, exponent, *([0.02, 17.0] if hump else [])]
            low = [0.1, 0.05, 0.2, *([-0.2, 3.0] if hump else [])]
            high = [1.0, 0.999, 12.0, *([0.2, 200.0] if hump else [])]
            found = least_squares(
                lambda p: law(p)(reynolds) / coefficients - 1.0, start, bounds=(low, high), x_scale=np.abs(start),
                xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=400,
            )  # fmt: skip
            if best is None or found.cost < best.cost * (1.0 - 1e-9):
                best = found
    return law(best.x)


def left_one_out(reynolds: np.ndarray, coefficients: np.ndarray, *, hump: bool) -> np.ndarray:
    """Relative error at each point of the law fitted to the other points, (n,)."""
    lowest = float(np.min(reynolds))
    errors = []
    for k in range(len(reynolds)):
        others = np.arange(len(reynolds)) != k
        law = fit_orifice_law(reynolds[others], coefficients[others], hump=hump, lowest=lowest)
        errors.append(float(law(reynolds[k]) / coefficients[k] - 1.0))
    return np.array(errors)


def table_3_reynolds() -> tuple[np.ndarray, np.ndarray]:
    """(Re of the nozzle, Re of the fixed orifice) of the rows of Table 3, by Eq. 18."""
    t = TABLE_3[:, 0]
    return reynolds_number(t, NOZZLE_HYDRAULIC_DIAMETER), reynolds_number(t, ORIFICE_HYDRAULIC_DIAMETER)


NOZZLE = OrificeLaw(
    limit=0.656401, critical=68.3857, exponent=4.93619, hump=0.0192107, hump_place=1522.73, lowest=72.6805
)  # fmt: skip
FIXED_ORIFICE = OrificeLaw(limit=0.752087, critical=141.371, exponent=1.18796, lowest=207.658)

flow_coefficients_reynolds = ReynoldsFlowLaw(
    nozzle=NOZZLE, fixed_orifice=FIXED_ORIFICE, viscosity=MIL_PRF_5606.viscosity
)
"""The law with the viscosity of MIL-PRF-5606 (Walther), for a valve that runs on it."""

flow_coefficients_reynolds_yan = ReynoldsFlowLaw(
    nozzle=NOZZLE, fixed_orifice=FIXED_ORIFICE, viscosity=viscosity_yan_2019
)
"""The law with the paper's viscosity (Eq. 18): Table 3 over temperature, as fitted."""

FLOW_LAWS: dict[str, Callable] = {
    "yan_2019": flow_coefficients_yan_2019,
    "reynolds": flow_coefficients_reynolds,
    "reynolds_yan_oil": flow_coefficients_reynolds_yan,
}
"""Flow-coefficient laws by name: the paper's Eq. 19, the law over Reynolds number, and that with the paper's oil."""
