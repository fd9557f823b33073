"""Figs. 3 and 7: air gaps over temperature, and their flux over current."""

from __future__ import annotations

from typing import TYPE_CHECKING

from valvesim.paper.published import PUBLISHED_GAP_DRIFT
from valvesim.reports.paper.words import one_panel, picture, signed
from valvesim.reports.plotting import COLOURS, Figure, styled

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


def gaps_text(r: Reproduction) -> str:
    g = r.gaps
    return f"""## Fig. 3: air gaps

From Tables 1 and 2 alone. At 270 °C the upper gap drifts by {signed(g.upper[-1], 2)} % and the lower by
{signed(g.lower[-1], 2)} %; the paper says {PUBLISHED_GAP_DRIFT:g} % each, opposite ways. Eq. 10 as printed
adds L7 where
it must be subtracted and takes l_g2 where L2 must stand: it gives {signed(g.upper_printed[-1], 2)} % and
{signed(g.lower_printed[-1], 2)} %, the same sizes the wrong way round.

{picture("gaps.png", "Air gaps over temperature: dashed as printed in Eqs. 9 and 10.")}"""


def flux_text(r: Reproduction) -> str:
    low, high = r.flux.fluxes[:, 0] * 1e6, r.flux.fluxes[:, -1] * 1e6
    ways = "; ".join(f"gap {k + 1}: {a:.2f} to {b:.2f} µWb" for k, (a, b) in enumerate(zip(low, high, strict=True)))
    return f"""## Fig. 7: air gap flux against current

The nine equations of the magnetic circuit (Eq. 11 restored) solved for the reference valve, 20 °C, armature held, 1
to
10 mA: {ways}. The two gaps of one diagonal gain what the others lose, linearly to {r.flux.nonlinearity:.0e} %; the
paper
says approximately linear, of a simulation with saturation. Its values cannot be compared: the gap area is lost.

{picture("flux.png", "Flux in the four air gaps of the reference valve.")}"""


@styled
def draw_gaps(r: Reproduction) -> Figure:
    figure, axis = one_panel()
    g = r.gaps
    axis.plot(g.temperatures, g.upper, color=COLOURS[0], label="upper gap, Table 2 expanded")
    axis.plot(g.temperatures, g.lower, color=COLOURS[1], label="lower gap, Table 2 expanded")
    axis.plot(g.temperatures, g.upper_printed, "--", color=COLOURS[0], label="upper gap, Eq. 10 as printed")
    axis.plot(g.temperatures, g.lower_printed, "--", color=COLOURS[1], label="lower gap, Eq. 10 as printed")
    for sign in (-1.0, 1.0):
        axis.plot([270.0], [sign * PUBLISHED_GAP_DRIFT], "k_", ms=14, mew=2.5,
                  label="published: 6 %, opposite ways" if sign > 0 else None)  # fmt: skip
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("drift of the air gap [%]")
    axis.legend(loc="upper left")
    return figure


@styled
def draw_flux(r: Reproduction) -> Figure:
    figure, axis = one_panel()
    where = ("gap 1 (upper, closing)", "gap 2 (upper)", "gap 3 (lower, closing)", "gap 4 (lower)")
    for k, flux in enumerate(r.flux.fluxes):
        style = "o-" if k < 2 else "s--"
        axis.plot(1e3 * r.flux.currents, 1e6 * flux, style, ms=3, color=COLOURS[k % 2], label=where[k])
    axis.set_xlabel("current [mA]")
    axis.set_ylabel("flux [µWb]")
    axis.legend()
    return figure
