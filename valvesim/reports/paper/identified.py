"""Table 4 identified: the parameters found, and how well the published drifts determine them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.paper.published import PUBLISHED_DRIFTS, TOLERANCE
from valvesim.paper.unknowns import LOST_VALUES
from valvesim.reports.paper.words import TITLES, markdown_table, parameter_text, picture
from valvesim.reports.plotting import Figure, styled

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


_PARAMETER_HEADINGS = (
    "parameter", "bounds", "why these", "as derived", "as printed", "determined, derived", "determined, printed"
)  # fmt: skip


def identified_text(r: Reproduction) -> str:
    rows, at_bound = [], {}
    for key, found in r.identified.items():
        at_bound[key] = [
            u.name for u, s in zip(LOST_VALUES, found.shares, strict=True) if min(s, 1.0 - s) < 1e-3
        ]  # fmt: skip
    for k, u in enumerate(LOST_VALUES):
        row = [u.name.replace("_", " "), f"{parameter_text(u.name, u.low)} to {parameter_text(u.name, u.high)}", u.why]
        for key in ("derived", "printed"):
            value = parameter_text(u.name, getattr(r.identified[key].valve, u.name))
            row.append(f"{value} (bound)" if u.name in at_bound[key] else value)
        for key in ("derived", "printed"):
            row.append(_judged(r, key, k))
        rows.append(row)
    d, p = r.determined["derived"], r.determined["printed"]
    starts = {key: (len(found.within_1), len(found.misfits)) for key, found in r.identified.items()}
    singular = {key: ", ".join(f"{s:.2g}" for s in r.determined[key].singular_values) for key in r.determined}
    counts = {
        key: sum(_judged(r, key, k).startswith("open") for k in range(len(LOST_VALUES)))
        for key in ("derived", "printed")
    }
    return f"""## Table 4, identified

{len(LOST_VALUES)} unknowns against {len(PUBLISHED_DRIFTS)} drifts: eight route maxima, the total, the total at
40 °C (steep to
40 °C
and then back) and the total at 5 mA (the same at every current). Relative misses count alike. A valve must be stable
with
2 % to spare and keep the published travel. {r.screened} random valves are screened, the best {r.starts} refined by
bounded
least
squares; {starts["derived"][0]} of {starts["derived"][1]} (as derived) and {starts["printed"][0]} of
{starts["printed"][1]} (as printed) end within one percentage point of the best.

{markdown_table(_PARAMETER_HEADINGS, rows, left=3)}
The last columns say how far the parameter may move, all others refitted, while the misfit rises by less than one
percentage point (tested at {len(d.shares)} places of its range
by local refits, so that it may be free to move further): "open" over the whole range; otherwise the
range
that is left. Many parameters lie at a bound: the drifts pull the valve towards the edge of what can be built, which
again says that they do not belong to one valve of these equations.

**What the drifts determine.** Taken as good to {100 * TOLERANCE:g} %, they fix {d.combinations} combinations of
parameters
(as derived) or {p.combinations} (as printed) better than a factor e, out of {len(LOST_VALUES)}; {counts["derived"]} and
{counts["printed"]} single parameters stay open over their whole range. Singular values (relative change of the
drifts per
factor e): {singular["derived"]} as derived; {singular["printed"]} as printed. The identified valves are therefore
examples
of what comes closest, not the paper's valve.

{picture("profile.png", "Rise of the misfit, percentage points, with one parameter held, all others refitted.")}"""


def _judged(r: Reproduction, key: str, k: int) -> str:
    """In words, where parameter k may lie."""
    rise = r.determined[key].profile[k] - r.identified[key].misfit
    fine = rise < 1.0
    if fine.all():
        return "open"
    u = LOST_VALUES[k]
    here = r.identified[key].shares[k]
    places = np.append(r.determined[key].shares[fine], here)
    low, high = u.low * (u.high / u.low) ** places.min(), u.low * (u.high / u.low) ** places.max()
    if high / low < 1.01:
        return f"near {parameter_text(u.name, low)}"
    return f"{parameter_text(u.name, low)} to {parameter_text(u.name, high)}"


@styled
def draw_profile(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 6))
    axes = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(left=0.19, right=0.9, top=0.9, bottom=0.11, wspace=0.08)
    image: Any = None
    for axis, key in zip(axes, r.determined, strict=True):
        rise = r.determined[key].profile - r.identified[key].misfit
        image = axis.imshow(np.clip(rise, 0.0, 10.0), aspect="auto", cmap="YlOrRd", vmin=0.0, vmax=10.0)
        for (row, column), value in np.ndenumerate(rise):
            text = f"{value:.1f}" if value < 99.5 else ">99"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color="k" if value < 7.0 else "w")
        shares = r.determined[key].shares
        axis.set_xticks(range(len(shares)), [f"{s:g}" for s in shares])
        axis.set_yticks(range(len(LOST_VALUES)), [u.name.replace("_", " ") for u in LOST_VALUES])
        axis.set_xlabel("place in the range between the bounds, logarithmic")
        axis.set_title(f"{TITLES[key]}: misfit {r.identified[key].misfit:.1f} % at best", loc="left")
        axis.grid(False)
    figure.colorbar(image, cax=figure.add_axes((0.92, 0.2, 0.015, 0.6)), label="rise of the misfit [percentage points]")
    return figure
