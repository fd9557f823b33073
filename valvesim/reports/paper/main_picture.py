"""Picture: the paper's drift by route and in all, published and recomputed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvesim.paper.published import PUBLISHED_DRIFTS, RANGE
from valvesim.reports.paper.words import MARKS, SHADES, TITLES
from valvesim.reports.plotting import Figure, label_decades, styled
from valvesim.valve.coefficients import ROUTES

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


@styled
def draw_main(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 5.2))
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.15, 1]})
    figure.subplots_adjust(left=0.15, right=0.98, top=0.83, bottom=0.12, wspace=0.2)
    order = np.argsort([f.size for f in PUBLISHED_DRIFTS[: len(ROUTES)]], kind="stable")
    places = np.arange(len(ROUTES))
    sizes = [PUBLISHED_DRIFTS[k].size for k in order]
    left.scatter(sizes, places, marker="|", s=420, lw=3, color="k", zorder=3)
    left.scatter([], [], marker="|", s=110, lw=3, color="k", label="published")
    keys = ("derived", "printed", "printed_rise")
    for offset, key in zip((0.22, 0.0, -0.22), keys, strict=True):
        values = r.identified[key].values[order]
        right_way = [
            f.direction in (0, np.sign(v)) for f, v in zip((PUBLISHED_DRIFTS[k] for k in order), values, strict=True)
        ]
        faces = [SHADES[key] if good else "none" for good in right_way]
        left.scatter(np.abs(values), places + offset, marker=MARKS[key], s=36, facecolors=faces, edgecolors=SHADES[key],
                     linewidths=1.3, zorder=4)  # fmt: skip
        left.scatter([], [], marker=MARKS[key], s=36, color=SHADES[key], label=TITLES[key])
    left.scatter([], [], marker="o", s=36, facecolors="none", edgecolors="0.3", label="wrong direction")
    left.set_xscale("log")
    label_decades(left.xaxis)
    left.set_yticks(places, [PUBLISHED_DRIFTS[k].title for k in order])
    left.set_xlabel("largest drift of the armature angle [%]")
    left.set_title("by route, 20 to 270 °C, 1 mA", loc="left")
    left.legend(loc="lower right")
    for key in ("reference", *keys):
        right.plot(RANGE, r.sense(key) * r.curves[key].total[0, 0], color=SHADES[key], lw=1.6, label=TITLES[key])
    total = PUBLISHED_DRIFTS[8]
    right.axhline(total.target, color="k", lw=0.8, ls=":")
    right.plot([40.0], [total.target], "k|", ms=16, mew=3, label=f"published: {total.size:g} % at 40 °C, then back")
    right.set_xlabel("temperature [°C]")
    right.set_ylabel("drift of the armature angle [%]")
    right.set_title("all routes together, 1 mA", loc="left")
    right.set_ylim(min(-17.5, right.get_ylim()[0]), right.get_ylim()[1] + 8.0)
    right.legend(loc="upper right")
    figure.suptitle("The paper's temperature drift, published and recomputed with the closest valve found", fontsize=12)
    return figure
