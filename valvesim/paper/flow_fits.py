"""The paper's flow coefficients (Fig. 13, Table 3): Eq. 19 and laws over Reynolds number, and what they miss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvesim.valve.flow_coefficients import (
    NOZZLE_HYDRAULIC_DIAMETER,
    TABLE_3,
    fit_orifice_law,
    left_one_out,
    reynolds_number,
    table_3_reynolds,
)
from valvesim.valve.fluid import MIL_PRF_5606, viscosity_yan_2019
from valvesim.valve.parameters import flow_coefficients_yan_2019


@dataclass(frozen=True, kw_only=True)
class FlowFit:
    """One law for one orifice of Table 3: relative errors in percent at the nine temperatures."""

    title: str
    orifice: str
    errors: np.ndarray
    left_out: np.ndarray | None
    """Error of each point by the law fitted to the other eight; None for a law that is taken as printed."""


@dataclass(frozen=True, kw_only=True)
class FlowFits:
    """Fig. 13 and Table 3, with what Eq. 19 misses."""

    printed: tuple[FlowFit, FlowFit]  # Eq. 19 read in °C
    as_rise: tuple[FlowFit, FlowFit]  # Eq. 19 as printed, in dT
    power: tuple[FlowFit, FlowFit]  # Eq. 19 refitted: a power of Re
    hump: tuple[FlowFit, FlowFit]  # power of Re with hump
    nozzle_rise: float  # %, Table 3, 20 to 50 °C
    nozzle_fall: float  # %, Table 3, 50 to 150 °C
    nozzle_rise_printed: float  # %, the same by Eq. 19
    nozzle_fall_printed: float
    cold_slope_yan: float  # d ln C_d0/d ln Re between -40 and -30 °C with Eq. 18; viscous flow allows 1 at most
    cold_slope_walther: float
    highest_reynolds: float  # of the nozzle in Table 3
    reynolds_at_270: float  # of the nozzle with the Walther law at 270 °C


def flow_fits() -> FlowFits:
    """Eq. 19 and the law over Reynolds number against Table 3, in the fit and left one out."""
    t = TABLE_3[:, 0]
    names = ("nozzle", "fixed orifice")

    def taken(title: str, law: Callable) -> tuple[FlowFit, FlowFit]:
        fits = [
            FlowFit(title=title, orifice=name, errors=100.0 * (c / table - 1.0), left_out=None)
            for name, c, table in zip(names, law(t), TABLE_3[:, 1:].T, strict=True)
        ]
        return fits[0], fits[1]

    def fitted(title: str, hump: bool) -> tuple[FlowFit, FlowFit]:
        fits = []
        for name, re, c in zip(names, table_3_reynolds(), TABLE_3[:, 1:].T, strict=True):
            errors = 100.0 * (fit_orifice_law(re, c, hump=hump)(re) / c - 1.0)
            out = 100.0 * left_one_out(re, c, hump=hump)
            fits.append(FlowFit(title=title, orifice=name, errors=errors, left_out=out))
        return fits[0], fits[1]

    def change(values: np.ndarray, low: float, high: float) -> float:
        return 100.0 * float(values[t == high][0] / values[t == low][0] - 1.0)

    def cold_slope(viscosity: Callable) -> float:
        return float(np.log(TABLE_3[1, 2] / TABLE_3[0, 2]) / np.log(viscosity(t[0]) / viscosity(t[1])))

    eq_19 = flow_coefficients_yan_2019(t)[0]
    return FlowFits(
        printed=taken("Eq. 19, in °C", flow_coefficients_yan_2019),
        as_rise=taken("Eq. 19 as printed, in temperature rise", _eq_19_in_rise),
        power=fitted("power of Re (Eq. 19 refitted)", False),
        hump=fitted("power of Re with hump", True),
        nozzle_rise=change(TABLE_3[:, 1], 20.0, 50.0),
        nozzle_fall=change(TABLE_3[:, 1], 50.0, 150.0),
        nozzle_rise_printed=change(eq_19, 20.0, 50.0),
        nozzle_fall_printed=change(eq_19, 50.0, 150.0),
        cold_slope_yan=cold_slope(viscosity_yan_2019),
        cold_slope_walther=cold_slope(MIL_PRF_5606.viscosity),
        highest_reynolds=float(reynolds_number(150.0, NOZZLE_HYDRAULIC_DIAMETER)),
        reynolds_at_270=float(
            reynolds_number(270.0, NOZZLE_HYDRAULIC_DIAMETER, viscosity=MIL_PRF_5606.viscosity)
        ),
    )  # fmt: skip


def _eq_19_in_rise(t):
    """Eq. 19 in dT without the hold below -40 °C: this is what shows that dT cannot be meant."""
    rise = np.asarray(t) - 20.0
    return 0.663 - 0.00136 * np.exp(-0.1473 * rise), 0.752 - 0.1143 * np.exp(-0.03569 * rise)
