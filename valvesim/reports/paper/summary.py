"""The paper in short: what comes out, what does not, published beside computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvesim.paper.published import (
    CURRENTS,
    PUBLISHED_DRIFTS,
    PUBLISHED_FIT_ERRORS,
    PUBLISHED_GAP_DRIFT,
    PUBLISHED_MMF_LOSS,
    PUBLISHED_TRAVEL,
    TOLERANCE,
)
from valvesim.reports.paper.words import SHOWN, TITLES, count_reached, listed, markdown_table, picture, signed
from valvesim.valve.coefficients import ROUTES
from valvesim.valve.fluid import viscosity_yan_2019

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


MAIN_PICTURE = "reproduction.png"
CAPTION = (
    "Left: largest drift of the armature angle by route, 20 to 270 °C at 1 mA; hollow where the direction is not the "
    "published one. Right: all routes together over temperature."
)


def head_text(r: Reproduction) -> str:
    derived, printed, rise = (r.identified[k] for k in ("derived", "printed", "printed_rise"))
    cannot = [f.title for f in PUBLISHED_DRIFTS if not r.reached["derived"][f.key].possible]
    both = r.reached["printed"]["mmf_and_arm"]
    knee = r.reached["printed"]["curve_and_flow"]
    sizes = r.identified["derived_sizes"]
    curve = (
        "Nor does any valve found follow the published total together with the published flow route under either sign"
        if not (knee.possible or r.reached["derived"]["curve_and_flow"].possible)
        else "The published total can be met together with the flow route"
    )
    return f"""Yan, Liu and Ma, *Mechanism of Temperature's Acting on Electro-Hydraulic Servo Valve*, IEEE Access 2019,
recomputed from its text by `valvesim reproduce` (seed {r.seed}, {r.starts} starts). Published stands beside
computed; where they
differ,
the reason stands with it. A drift counts as reached within {100 * TOLERANCE:g} % of itself.

**In short.** The parts that the text defines come out: the magnet, the air gaps (once Eq. 10 is mended), the magnetic
circuit, the oil, and Eq. 19 (once it is read in °C). The eight route drifts and the total hang on Table 4, which is
lost. With the balances as derived (Eqs. 32-34) the closest valve found meets {count_reached(r, "derived")} of the eight
route
drifts with their directions (root mean square miss of all {len(PUBLISHED_DRIFTS)} drifts
{derived.misfit:.0f} %); their
sizes
alone, {count_reached(r, "derived_sizes")} ({sizes.misfit:.0f} %). With the signs as the appendix prints them it meets
{count_reached(r, "printed")} ({printed.misfit:.0f} %), and with Eq. 19 read in temperature rise as well, as it
is printed,
{count_reached(r, "printed_rise")} ({rise.misfit:.0f} %). Out of reach of every valve with the derived
balances, each drift
taken alone: {listed(cannot)}. The published drifts for magnetomotive force and arm
{"agree with each other" if both.possible else "contradict each other under either sign"}. {curve}.
{_verdict(r)}

{picture(MAIN_PICTURE, CAPTION)}"""


def _verdict(r: Reproduction) -> str:
    misfits = {key: found.misfit for key, found in r.identified.items()}
    if min(misfits["printed"], misfits["printed_rise"]) < min(misfits["derived"], misfits["derived_sizes"]):
        return (
            "**So the paper's curves were most likely computed with the signs as its appendix prints them, which "
            "contradict its own Eqs. 32-34;** no stable valve under those can have the published magnetomotive force "
            "or arm."
        )
    return "Neither choice of signs comes clearly closer."


def overview_text(r: Reproduction) -> str:
    g, fits, experiment = r.gaps, r.fits, r.experiment
    worst = [float(np.max(np.abs(fit.errors))) for fit in fits.printed]
    rise = float(np.max(np.abs(fits.as_rise[0].errors)))
    at_most, at_40 = r.identified["printed"].values[8:10]
    rise_most, rise_40 = r.identified["printed_rise"].values[8:10]
    travel = 100.0 * float(r.curves["reference"].travel[0, 0])
    totals = r.curves["printed"].total[:, 0]
    spread = [float(np.max(np.abs(t))) for t in totals]
    tendency = [f"{TITLES[k]} {signed(r.sense(k) * float(experiment[k].total[0, 0, -1]), 2)} %" for k in SHOWN]
    knee = PUBLISHED_DRIFTS[[f.key for f in PUBLISHED_DRIFTS].index("knee")]
    total = PUBLISHED_DRIFTS[[f.key for f in PUBLISHED_DRIFTS].index("total")]
    rows = [
        ("Eq. 5", f"M0 falls by about {PUBLISHED_MMF_LOSS:g} % to 270 °C", f"{r.magnet.mmf_loss:.2f} %", "holds", ""),
        (
            "Fig. 3", f"each gap drifts by {PUBLISHED_GAP_DRIFT:g} %, opposite ways",
            f"upper {signed(g.upper[-1], 2)} %, lower {signed(g.lower[-1], 2)} %", "holds, mended",
            f"Eq. 10 as printed gives {signed(g.upper_printed[-1], 2)} and {signed(g.lower_printed[-1], 2)} %: "
            "the other way round",
        ),
        (
            "Fig. 7", "flux rises about linearly, 1 to 10 mA",
            f"linear to {r.flux.nonlinearity:.0e} % with the armature held", "holds",
            "no numbers are printed; the gap area is lost with Table 4",
        ),
        (
            "Fig. 11", "Eq. 18", f"{1e6 * viscosity_yan_2019(20.0):.1f} mm²/s at 20 °C", "holds in °C",
            f"in temperature rise, as printed, it gives {1e6 * viscosity_yan_2019(0.0):.1f} at 20 °C",
        ),
        (
            "Fig. 13, Table 3", f"Eq. 19 fits to {PUBLISHED_FIT_ERRORS[0]:g} and {PUBLISHED_FIT_ERRORS[1]:g} %",
            f"{worst[0]:.2f} and {worst[1]:.2f} %", "holds in °C",
            f"the paper cuts its figures off; in temperature rise, as printed, Eq. 19 misses by up to {rise:.0f} %",
        ),
        (
            "below Eq. 19", f"flapper travel below {PUBLISHED_TRAVEL:g} % of the gap at 1 mA",
            f"reference valve {travel:.2f} %", "holds", "",
        ),
        (
            "Figs. 14-16", "eight route maxima",
            f"{count_reached(r, 'derived')} of {len(ROUTES)} as derived, "
            f"{count_reached(r, 'printed')} of {len(ROUTES)} as printed",
            "in part", "Table 4 is lost, the appendix's signs contradict Eqs. 33-34, and two drifts contradict each "
            "other",
        ),
        (
            "Fig. 17", f"{total.size:g} % at most, steep to 40 °C and then slowly back",
            f"as printed {signed(at_most, 2)} %, {signed(at_40, 2)} % at 40 °C; with Eq. 19 as printed too "
            f"{signed(rise_most, 2)} and {signed(rise_40, 2)} %", "not reached",
            f"by Eq. 19 the flow coefficients need more than the 20 K up to 40 °C: a total of {knee.size:g} % there "
            "does not go with the other drifts",
        ),
        (
            "Fig. 18", f"{total.size:g} % at every current",
            "signs as printed: " + ", ".join(f"{s:.2f}" for s in spread) + " % at "
            + ", ".join(f"{1e3 * i:g}" for i in CURRENTS) + " mA",
            "holds but for the size", "the drift hardly depends on the current",
        ),
        (
            "Figs. 23-24", "measured 20 to 95 °C: same tendency", "at 95 °C: " + "; ".join(tendency),
            "cannot be judged", "no numbers are printed and Table 5 is lost",
        ),
        ("Tables 1-2", "given", "used as printed", "-", "L7 = L5 + L6 - L4"),
        ("Table 4", "lost", "identified, below", "-", ""),
        ("Figs. 1, 2, 4-6, 8-10, 12, 14, 19-22", "drawings, photographs, CFD", "-", "-", "nothing to compute"),
    ]  # fmt: skip
    return "## Published beside computed\n\n" + markdown_table(
        ("in the paper", "it says", "computed", "verdict", "why"), rows, left=5
    )


def not_validated_text(r: Reproduction) -> str:
    return f"""## What has not been validated

- **No measured valve-body temperature transient is public.** The thermal network, and every drift over time that
follows
  from it, rests on estimates.
- No measured drift is public in numbers: the experiment is only compared in tendency.
- Table 3 is a CFD result, not a measurement; the law over Reynolds number is no better than that.
- The identified valves meet published *calculations*. They show what the equations allow, not how the valve was
built.
- The reference valve is not the paper's valve; its parameters come from other sources, each with its own.
- The full solution and the model of this package agree to {r.polynomial_error:.0e} (relative, reference valve, 1 mA).
"""
