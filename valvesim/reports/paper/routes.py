"""Figs. 14 to 16: drift by route, and which of the published drifts can be reached at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvesim.paper.interpretations import INTERPRETATIONS
from valvesim.paper.published import PUBLISHED_DRIFTS, RANGE, TOLERANCE
from valvesim.reports.paper.words import SHOWN, TITLES, listed, markdown_table, picture, published_words, signed
from valvesim.reports.plotting import COLOURS, Figure, styled
from valvesim.valve.coefficients import ROUTES

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


def routes_text(r: Reproduction) -> str:
    rows = []
    for k, drift in enumerate(PUBLISHED_DRIFTS):
        row = [drift.title, published_words(drift), signed(r.reference_values[k])]
        for interpretation in INTERPRETATIONS:
            found = r.identified[interpretation.key]
            text = signed(found.values[k])
            row.append(f"**{text}**" if found.reached[k] else text)
        rows.append(row)
    rows.append(["*root mean square miss*", "", "", *(f"{r.identified[v.key].misfit:.1f} %" for v in INTERPRETATIONS)])
    implied = r.mmf_implied
    mmf = PUBLISHED_DRIFTS[2]
    m, growth = r.magnet, 100.0 * r.arm_growth
    return f"""## Figs. 14 to 16: drift by route

Largest drift of the armature angle in percent, 20 to 270 °C at 1 mA, each route alone and all together. Bold: within
{100 * TOLERANCE:g} % of the published figure. The paper tells which routes go together, not which way they go: the
sign
of a whole column is free, and each is turned so that the flow coefficients come out as negative or closest to it.
Turned
here, and in every picture: {listed([TITLES[k] for k in TITLES if r.sense(k) < 0])}.

{markdown_table(("drift [%]", "published", "reference valve", *(v.title for v in INTERPRETATIONS)), rows)}
{picture("routes.png", "Drift by route over temperature at 1 mA.")}
**Why the derived balances cannot follow Fig. 16.** At small angles theta ~ M0/(K - k M0²): the magnet drives the
armature
and softens it. A stable valve has K > k M0², so losing {m.mmf_loss:.2f} % of M0 costs at least {m.mmf_loss:.2f} % of
theta; the paper prints {mmf.size:g} %. Checked numerically: of {m.drawn} random valves inside the bounds below,
{m.stable} are stable and within their null gap at 1 mA; the least of their losses is {np.min(m.losses):.4f} %, and
{m.exceptions} lose less than M0 does.

{picture("magnet.png", "Every stable random valve loses more angle than its magnet loses magnetomotive force.")}
**Two published drifts contradict each other.** The arm a and M0 enter torque and magnetic spring only as the product
a M0. The published {PUBLISHED_DRIFTS[5].size:g} % by the arm, whose growth is {growth:.2f} %, therefore fixes
what the loss
of M0
must do:
{implied:.2f} % under the printed signs, against {mmf.size:g} % published. No choice of parameters mends that.
As derived, the arm can by the same relation do no less than its own {growth:.2f} %, whatever the valve.
"""


def reach_text(r: Reproduction) -> str:
    names = {f.key: f.title for f in PUBLISHED_DRIFTS} | {
        "curve": "the three total drifts together", "curve_and_flow": "the three and the flow coefficients",
        "mmf_and_arm": "magnetomotive force and arm together", "routes": "the eight routes together",
    }  # fmt: skip
    targets = {f.key: f for f in PUBLISHED_DRIFTS}
    rows = []
    for name, title in names.items():
        row = [title]
        keys = r.reached["derived"][name].keys
        row.append(", ".join(published_words(targets[key]) for key in keys) if len(keys) < 5 else "as above")
        for key in ("derived", "printed"):
            reach = r.reached[key][name]
            values = ", ".join(signed(v) for v in reach.values)
            if len(keys) > 4:
                values = f"worst miss {100 * reach.worst:.0f} %"
            row.append(f"**{values}**" if reach.possible else f"{values}: no")
        rows.append(row)
    return f"""## Which drifts can be reached at all

Each drift, and some together, aimed at with all others ignored: the closest of any valve found inside the bounds.
Bold:
within {100 * TOLERANCE:g} %. A "no" is the outcome of
a search; for the magnetomotive force and the arm as derived it is proved above.

{markdown_table(("drift", "published [%]", "as derived", "signs as printed"), rows, left=4)}"""


@styled
def draw_routes(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 4.4))
    axes = figure.subplots(1, len(SHOWN))
    figure.subplots_adjust(left=0.07, right=0.84, top=0.88, bottom=0.13, wspace=0.25)
    for axis, key in zip(axes, SHOWN, strict=True):
        curves = r.curves[key]
        for k in range(len(ROUTES)):
            title = PUBLISHED_DRIFTS[k].title
            axis.plot(RANGE, r.sense(key) * curves.by_route[k, 0], color=COLOURS[k % len(COLOURS)], label=title)
        axis.plot(RANGE, r.sense(key) * curves.total[0, 0], "k", lw=2, label="all together")
        axis.set_title(TITLES[key], loc="left")
        axis.set_xlabel("temperature [°C]")
    axes[0].set_ylabel("drift of the armature angle [%]")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
