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
from typing import Any, NamedTuple

import numpy as np

from valvesim.errors import InputError, warn_once
from valvesim.valve.fluid import MIL_PRF_5606, viscosity_yan_2019
from valvesim.valve.laws import is_number

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


def flow_coefficients_yan_2019(oil_temperature):
    """(C_df, C_d0) of nozzle and fixed orifice: the paper's Eq. 19 read in °C, fitted -40..150 °C.

    Below -20 °C it rests on one row of the paper's CFD that no smooth law meets, and below -40 °C the
    formula soon turns negative and is held: one warning, with the law for the cold. Beyond 150 °C it is flat.
    """
    if is_number(oil_temperature):
        _warn_of_cold(float(np.min(oil_temperature)))
    t = np.maximum(oil_temperature, -40.0)
    return 0.663 - 0.00136 * np.exp(-0.1473 * t), 0.752 - 0.1143 * np.exp(-0.03569 * t)


def _warn_of_cold(coldest: float) -> None:
    """Warn once of Eq. 19 below `EQ_19_COLD`."""
    if coldest < EQ_19_COLD:
        held = "; held at -40 °C below that" if coldest < -40.0 else ""
        warn_once(
            f"flow coefficients (Eq. 19): {coldest:.4g} °C is below {EQ_19_COLD:g} °C, where they rest on one laminar "
            f"CFD run and swing the null pressure{held}; for cold oil set valve.flow_law = '{COLD_LAW}'",
            about="flow coefficients, cold",
        )


EQ_19_COLD = -20.0  # °C, below which Eq. 19 follows Table 3's row at -40 °C
COLD_LAW = "reynolds_number"


class PilotFlow(NamedTuple):
    """The pilot's orifices: coefficients of turbulent flow, and the laminar losses k1 of K = k1/Re + 1/C^2.

    The fixed orifice's k1 is `orifice_loss` + `orifice_wall_loss`/d, with the wall's share in metre.
    """

    nozzle: Any
    orifice: Any
    nozzle_loss: Any = 0.0
    orifice_loss: Any = 0.0
    orifice_wall_loss: Any = 0.0


@dataclass(frozen=True, kw_only=True)
class ReynoldsNumberLaw:
    """Flow coefficients over the Reynolds number of the moment: each orifice has K = k1/Re + k2, Re = D_h u/nu.

        lambda = (D_h/nu) sqrt(2 dp/rho)      C = [sqrt((k1/lambda)^2 + 4 k2) - k1/lambda]/(2 k2)

    rises with lambda all the way, from C = lambda/k1 (creeping flow, q ~ dp/mu) to 1/sqrt(k2). The equations work out
    pressure drop, viscosity, density and hydraulic diameter themselves; here stand the figures. Fixed orifice: D_h = d,
    k1 = 12 pi + 64 L/d (Sampson's hole and Poiseuille's wall in a row: no fit), k2 = 1/(0.827 - 0.0085 L/d)^2
    (Lichtarowicz, Duggins and Markland 1965, L/d 2 to 10). Curtain between nozzle and flapper: D_h = 2 x, k1 = 40.7
    (Wuest 1954, slit), k2 = 1/0.656^2, the limit of the paper's Table 3 (0.61 to 0.66 in print). Source:
    docs/oils.md; scatter among published laws ±12 % at lambda 300, ±5 % at 1000, ±3 % above 3000.
    """

    nozzle_limit: float = 0.656
    nozzle_loss: float = 40.7
    hole_loss: float = 12.0 * np.pi
    wall_loss: float = 64.0
    orifice_limit: float | None = None
    """C of the fixed orifice at high Reynolds number [Lichtarowicz's, from L/d]."""

    def __post_init__(self):
        limits = (self.nozzle_limit, 0.8 if self.orifice_limit is None else self.orifice_limit)
        if not all(0.0 < c <= 1.0 for c in limits):
            raise InputError(f"Reynolds number law: the limits {limits} must lie in (0, 1]")
        losses = (self.nozzle_loss, self.hole_loss, self.wall_loss)
        if not all(0.0 <= k < np.inf for k in losses):
            raise InputError(f"Reynolds number law: the laminar losses {losses} must be zero or positive")

    def pilot(self, length, diameter) -> PilotFlow:
        """The figures of a valve whose fixed orifices have this length and diameter, m; floats or arrays."""
        limit = self.orifice_limit
        if limit is None:
            limit = lichtarowicz_limit(np.asarray(length) / np.asarray(diameter))
        wall = self.wall_loss * np.asarray(length)
        return PilotFlow(self.nozzle_limit, limit, self.nozzle_loss, self.hole_loss, wall)


FlowLaw = Callable[[Any], tuple[Any, Any]] | ReynoldsNumberLaw
"""What `Valve.flow_coefficients` holds: (C_df, C_d0) of the oil's temperature alone, or a law of the moment."""


def pilot_flow(law: FlowLaw, temperature, length, diameter) -> PilotFlow:
    """The figures of any law at an oil temperature (°C) for fixed orifices of a length and diameter, m."""
    if isinstance(law, ReynoldsNumberLaw):
        return law.pilot(length, diameter)
    return PilotFlow(*law(temperature))


def lichtarowicz_limit(slenderness):
    """C of a sharp-edged long orifice at high Reynolds number: 0.827 - 0.0085 L/d; L/d of 2 to 10, bounded to 0..20."""
    return 0.827 - 0.0085 * np.minimum(slenderness, 20.0)


def lichtarowicz(flow_number, slenderness):
    """C of a sharp-edged long orifice, Lichtarowicz, Duggins and Markland (1965): flow number 10..2e4, L/d 2..10.

    Their Reynolds number is lambda = (d/nu) sqrt(2 dp/rho), of the ideal velocity: with the true one the law would have
    a flow that does not depend on the pressure drop in the creeping limit (docs/oils.md).
    """
    swing = np.log10(0.00015 * np.asarray(flow_number, dtype=float))
    inverse = 1.0 / lichtarowicz_limit(slenderness) + 20.0 / flow_number * (1.0 + 2.25 * slenderness)
    return 1.0 / (inverse - 0.005 * slenderness / (1.0 + 7.5 * swing * swing))


def smooth_flow_coefficient(flow_number, laminar_loss, limit):
    """C over lambda of K = k1/Re + 1/limit^2: the closed form of `ReynoldsNumberLaw`, without cancellation."""
    b = np.asarray(laminar_loss) * limit / (2.0 * np.asarray(flow_number, dtype=float))
    return limit / (np.sqrt(1.0 + b * b) + b)


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
        if is_number(oil_temperature):
            self._warn_of_range(nozzle)
        return self.nozzle(nozzle), self.fixed_orifice(orifice)

    def _warn_of_range(self, nozzle) -> None:
        """Warn once of Reynolds numbers of the nozzle beyond Table 3."""
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

flow_coefficients_reynolds_number = ReynoldsNumberLaw()
"""The law over the Reynolds number of the moment, of any oil and any valve."""

FLOW_LAWS: dict[str, FlowLaw] = {
    "yan_2019": flow_coefficients_yan_2019,
    "reynolds": flow_coefficients_reynolds,
    "reynolds_yan_oil": flow_coefficients_reynolds_yan,
    COLD_LAW: flow_coefficients_reynolds_number,
}
"""Flow-coefficient laws by name: the paper's Eq. 19; Table 3 over temperature by way of the Reynolds number of the
paper's own case, with MIL-PRF-5606 and with the paper's oil; the law over the Reynolds number of the moment."""
