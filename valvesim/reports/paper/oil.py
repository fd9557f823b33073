"""Fig. 11: viscosity of the oil."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvesim.reports.paper.words import markdown_table, one_panel, picture
from valvesim.reports.plotting import COLOURS, Figure, label_decades, styled
from valvesim.valve.fluid import MIL_PRF_5606, viscosity_yan_2019

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


def oil_text(r: Reproduction) -> str:
    temperatures = (-40.0, 20.0, 50.0, 100.0, 150.0, 270.0)
    rows = [
        [f"{t:g}", *(f"{1e6 * float(v):.4g}" for v in (viscosity_yan_2019(t), viscosity_yan_2019(t - 20.0),
                                                     MIL_PRF_5606.viscosity(t)))]
        for t in temperatures
    ]  # fmt: skip
    return f"""## Fig. 11: viscosity

Eq. 18 in mm²/s, read in °C and in temperature rise as printed, beside a real oil of that class (MIL-PRF-5606, Walther
law). Read in °C it agrees with the real oil from 0 to 50 °C; beyond about 150 °C it falls to values that no liquid
has.

{markdown_table(("temperature [°C]", "Eq. 18 in °C", "Eq. 18 in rise", "MIL-PRF-5606, Walther"), rows)}
{picture("viscosity.png", "Viscosity over temperature.")}"""


@styled
def draw_viscosity(r: Reproduction) -> Figure:
    figure, axis = one_panel()
    t = np.linspace(-40.0, 270.0, 200)
    axis.semilogy(t, 1e6 * viscosity_yan_2019(t), color=COLOURS[0], label="Eq. 18 in °C")
    axis.semilogy(t, 1e6 * viscosity_yan_2019(t - 20.0), "--", color=COLOURS[0], label="Eq. 18 in temperature rise")
    axis.semilogy(t, 1e6 * MIL_PRF_5606.viscosity(t), color=COLOURS[1], label="MIL-PRF-5606, Walther law")
    label_decades(axis.yaxis)
    axis.axvline(150.0, color="0.6", lw=0.8, ls=":")
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("kinematic viscosity [mm²/s]")
    axis.legend()
    return figure
