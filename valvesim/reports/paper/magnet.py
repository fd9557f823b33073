"""Picture: no stable valve loses less angle than its magnet loses magnetomotive force."""

from __future__ import annotations

from typing import TYPE_CHECKING

from valvesim.paper.published import PUBLISHED_DRIFTS
from valvesim.reports.paper.words import one_panel
from valvesim.reports.plotting import COLOURS, Figure, label_decades, styled

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


@styled
def draw_magnet(r: Reproduction) -> Figure:
    figure, axis = one_panel()
    m = r.magnet
    axis.loglog(m.stiffness, m.losses, ".", ms=1.5, color=COLOURS[0], alpha=0.4, rasterized=True)
    axis.axhline(m.mmf_loss, color="k", lw=1, label=f"loss of M0: {m.mmf_loss:.2f} %")
    axis.axhline(
        PUBLISHED_DRIFTS[2].size, color=COLOURS[1], lw=1.4, ls="--", label=f"published: {PUBLISHED_DRIFTS[2].size:g} %"
    )
    axis.set_ylim(2.0, None)
    label_decades(axis.xaxis, axis.yaxis)
    axis.set_xlabel("net stiffness over that of the springs")
    axis.set_ylabel("loss of angle by the magnet [%]")
    axis.set_title(f"{m.stable} stable random valves, balances as derived", loc="left")
    axis.legend()
    return figure
