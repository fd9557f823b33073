"""The page on the paper: published beside computed, with the reasons. Markdown, and HTML with the pictures inside.

Every figure on it is computed when it is made; what the paper states comes from `reproduce.FIGURES` and
`PUBLISHED_...`.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from valvesim.io import check_folder, write_atomically
from valvesim.paper.reproduction import (
    ARM_GROWTH,
    CURRENTS,
    EXPERIMENT_RANGE,
    FIGURES,
    PROFILE_SHARES,
    PUBLISHED_FIT_ERRORS,
    PUBLISHED_GAP_DRIFT,
    PUBLISHED_MMF_LOSS,
    PUBLISHED_TRAVEL,
    RANGE,
    SCREENED,
    STARTS,
    TOLERANCE,
    UNKNOWNS,
    VARIANTS,
    FlowFit,
    Progress,
    Reproduction,
    compute,
    mmf_drift_implied_by_arm,
)
from valvesim.paper.reproduction import (
    Figure as PaperFigure,
)
from valvesim.reports.run import COLOURS, STYLE
from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.coefficients import ROUTES
from valvesim.valve.flow_coefficients import (
    DENSITY,
    FIXED_ORIFICE,
    NOZZLE,
    NOZZLE_HYDRAULIC_DIAMETER,
    ORIFICE_HYDRAULIC_DIAMETER,
    PRESSURE_DROP,
    TABLE_3,
    flow_coefficients_reynolds,
    flow_coefficients_reynolds_yan,
    table_3_reynolds,
)
from valvesim.valve.fluid import MIL_PRF_5606, viscosity_yan_2019
from valvesim.valve.parameters import flow_coefficients_yan_2019

matplotlib.use("Agg")
from matplotlib.figure import Figure  # noqa: E402 - the backend comes first

MAIN_PICTURE = "reproduction.png"
TITLES = {"reference": "reference valve"} | {variant.key: variant.title for variant in VARIANTS}
MARKS = {"reference": "s", "derived": "o", "derived_sizes": "v", "printed": "^", "printed_rise": "D"}
SHADES = dict(zip(TITLES, ("0.55", COLOURS[0], COLOURS[4], COLOURS[1], COLOURS[3]), strict=True))
SHOWN = ("reference", "derived", "printed")


def reproduce(folder: Path, *, seed: int = 0, starts: int = STARTS, progress: Progress | None = None) -> Path:
    """Recompute the paper and write `paper.html`, `paper.md` and its pictures into `folder`; the path of the HTML.

    The same seed and number of starts write the same figures. Raises InputError for a folder that cannot be written.
    """
    folder = Path(folder)
    check_folder(folder)
    return write_page(compute(seed=seed, starts=starts, progress=progress), folder)


def write_page(r: Reproduction, folder: Path) -> Path:
    """The page of a finished reproduction; the path of its HTML."""
    from markdown_it import MarkdownIt

    pictures = {name: _png(draw(r)) for name, draw in PICTURES.items()}
    for name, data in pictures.items():
        _write(folder / name, data)
    text = page(r)
    _write(folder / "paper.md", text.encode())
    body = MarkdownIt("commonmark").enable("table").render(text)
    for name, data in pictures.items():
        inside = f"data:image/png;base64,{base64.b64encode(data).decode()}"
        body = body.replace(f'src="{name}"', f'src="{inside}"')
    return _write(folder / "paper.html", _HTML.replace("{body}", body).encode())


def _write(path: Path, data: bytes) -> Path:
    def write(temporary: Path) -> None:
        temporary.write_bytes(data)

    return write_atomically(path, write)


_HTML = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>The paper, reproduced</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ddd; padding-bottom: .2rem; }
table { border-collapse: collapse; font-size: 14px; margin: 1rem 0; display: block; overflow-x: auto; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid #e4e4e4; vertical-align: top; }
th { text-align: left; border-bottom: 2px solid #bbb; } td strong { color: #1f6f43; }
img { max-width: 100%; } code { background: #f3f3f3; padding: 0 .2em; }
</style></head><body>
{body}</body></html>
"""


# ---------------------------------------------------------------- text


def page(r: Reproduction) -> str:
    """The page as Markdown."""
    sections = (
        _head, _overview, _routes_section, _reach_section, _identified_section, _gaps_section, _flux_section,
        _oil_section, _flow_section, _currents_section, _experiment_section, _not_validated,
    )  # fmt: skip
    return "\n".join(_reflow(section(r)) for section in sections)


def _reflow(text: str) -> str:
    """Each paragraph and list item on one line; tables, headings and pictures as they are."""
    blocks = []
    for block in text.split("\n\n"):
        plain = not block.lstrip().startswith(("|", "#", "!"))
        blocks.append(re.sub(r"\n(?!- )\s*", " ", block.strip()) if plain else block)
    return "\n\n".join(blocks) + "\n"


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    marks = ["---" if k < left else "---:" for k in range(len(headings))]
    lines = [headings, marks, *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _picture(name: str, caption: str) -> str:
    return f"![{caption}]({name})\n\n*{caption}*\n"


def _num(value: float, digits: int = 3) -> str:
    """A signed figure with enough places to be compared, the minus a real one."""
    places = 2 if abs(value) >= 10.0 else digits
    return f"{value:+.{places}f}".replace("-", "−")


def _list(items: Sequence[str]) -> str:
    items = list(items)
    if not items:
        return "none"
    return items[0] if len(items) == 1 else ", ".join(items[:-1]) + " and " + items[-1]


def _published(figure: PaperFigure) -> str:
    return f"{figure.target:+g}".replace("-", "−") if figure.direction else f"{figure.size:g} (way not told)"


def _count(r: Reproduction, key: str) -> int:
    return int(np.sum(r.identified[key].reached[: len(ROUTES)]))


_MAIN_CAPTION = (
    "Left: largest drift of the armature angle by route, 20 to 270 °C at 1 mA; hollow where the direction is not the "
    "published one. Right: all routes together over temperature."
)


def _head(r: Reproduction) -> str:
    derived, printed, rise = (r.identified[k] for k in ("derived", "printed", "printed_rise"))
    cannot = [f.title for f in FIGURES if not r.reached["derived"][f.key].possible]
    both = r.reached["printed"]["mmf_and_arm"]
    knee = r.reached["printed"]["curve_and_flow"]
    sizes = r.identified["derived_sizes"]
    curve = (
        "Nor does any valve found follow the published total together with the published flow route under either sign"
        if not (knee.possible or r.reached["derived"]["curve_and_flow"].possible)
        else "The published total can be met together with the flow route"
    )
    return f"""# The paper, reproduced

Yan, Liu and Ma, *Mechanism of Temperature's Acting on Electro-Hydraulic Servo Valve*, IEEE Access 2019, recomputed
from
its text by `valvesim reproduce` (seed {r.seed}, {r.starts} starts). Published stands beside computed; where they
differ,
the reason stands with it. A figure counts as reached within {100 * TOLERANCE:g} % of itself.

**In short.** The parts that the text defines come out: the magnet, the air gaps (once Eq. 10 is mended), the magnetic
circuit, the oil, and Eq. 19 (once it is read in °C). The eight route figures and the total hang on Table 4, which is
lost. With the balances as derived (Eqs. 32-34) the closest valve found meets {_count(r, "derived")} of the eight
route
figures with their directions (root mean square miss of all {len(FIGURES)} figures {derived.misfit:.0f} %); their
sizes
alone, {_count(r, "derived_sizes")} ({sizes.misfit:.0f} %). With the signs as the appendix prints them it meets
{_count(r, "printed")} ({printed.misfit:.0f} %), and with Eq. 19 read in temperature rise as well, as it is printed,
{_count(r, "printed_rise")} ({rise.misfit:.0f} %). Out of reach of every valve with the derived balances, each figure
taken alone: {_list(cannot)}. The published figures for magnetomotive force and arm
{"agree with each other" if both.possible else "contradict each other under either sign"}. {curve}.
{_verdict(r)}

{_picture(MAIN_PICTURE, _MAIN_CAPTION)}"""


def _verdict(r: Reproduction) -> str:
    misfits = {key: found.misfit for key, found in r.identified.items()}
    if min(misfits["printed"], misfits["printed_rise"]) < min(misfits["derived"], misfits["derived_sizes"]):
        return (
            "**So the paper's curves were most likely computed with the signs as its appendix prints them, which "
            "contradict its own Eqs. 32-34;** no stable valve under those can have the published magnetomotive force "
            "or arm."
        )
    return "Neither choice of signs comes clearly closer."


def _overview(r: Reproduction) -> str:
    g, fits, experiment = r.gaps, r.fits, r.experiment
    worst = [float(np.max(np.abs(fit.errors))) for fit in fits.printed]
    rise = float(np.max(np.abs(fits.as_rise[0].errors)))
    at_most, at_40 = r.identified["printed"].values[8:10]
    rise_most, rise_40 = r.identified["printed_rise"].values[8:10]
    travel = 100.0 * float(r.curves["reference"].travel[0, 0])
    totals = r.curves["printed"].total[:, 0]
    spread = [float(np.max(np.abs(t))) for t in totals]
    tendency = [f"{TITLES[k]} {_num(r.sense(k) * float(experiment[k].total[0, 0, -1]), 2)} %" for k in SHOWN]
    knee = FIGURES[[f.key for f in FIGURES].index("knee")]
    total = FIGURES[[f.key for f in FIGURES].index("total")]
    rows = [
        ("Eq. 5", f"M0 falls by about {PUBLISHED_MMF_LOSS:g} % to 270 °C", f"{r.magnet.mmf_loss:.2f} %", "holds", ""),
        (
            "Fig. 3", f"each gap drifts by {PUBLISHED_GAP_DRIFT:g} %, opposite ways",
            f"upper {_num(g.upper[-1], 2)} %, lower {_num(g.lower[-1], 2)} %", "holds, mended",
            f"Eq. 10 as printed gives {_num(g.upper_printed[-1], 2)} and {_num(g.lower_printed[-1], 2)} %: the other "
            "way round",
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
            f"{_count(r, 'derived')} of {len(ROUTES)} as derived, {_count(r, 'printed')} of {len(ROUTES)} as printed",
            "in part", "Table 4 is lost, the appendix's signs contradict Eqs. 33-34, and two figures contradict each "
            "other",
        ),
        (
            "Fig. 17", f"{total.size:g} % at most, steep to 40 °C and then slowly back",
            f"as printed {_num(at_most, 2)} %, {_num(at_40, 2)} % at 40 °C; with Eq. 19 as printed too "
            f"{_num(rise_most, 2)} and {_num(rise_40, 2)} %", "not reached",
            f"by Eq. 19 the flow coefficients need more than the 20 K up to 40 °C: a total of {knee.size:g} % there "
            "does not go with the other figures",
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
    return "## Published beside computed\n\n" + _table(
        ("in the paper", "it says", "computed", "verdict", "why"), rows, left=5
    )


def _routes_section(r: Reproduction) -> str:
    rows = []
    for k, figure in enumerate(FIGURES):
        row = [figure.title, _published(figure), _num(r.reference_values[k])]
        for variant in VARIANTS:
            found = r.identified[variant.key]
            text = _num(found.values[k])
            row.append(f"**{text}**" if found.reached[k] else text)
        rows.append(row)
    rows.append(["*root mean square miss*", "", "", *(f"{r.identified[v.key].misfit:.1f} %" for v in VARIANTS)])
    implied = mmf_drift_implied_by_arm(-FIGURES[5].size)
    mmf = FIGURES[2]
    m, growth = r.magnet, 100.0 * ARM_GROWTH
    return f"""## Figs. 14 to 16: drift by route

Largest drift of the armature angle in percent, 20 to 270 °C at 1 mA, each route alone and all together. Bold: within
{100 * TOLERANCE:g} % of the published figure. The paper tells which routes go together, not which way they go: the
sign
of a whole column is free, and each is turned so that the flow coefficients come out as negative or closest to it.
Turned
here, and in every picture: {_list([TITLES[k] for k in TITLES if r.sense(k) < 0])}.

{_table(("drift [%]", "published", "reference valve", *(v.title for v in VARIANTS)), rows)}
{_picture("routes.png", "Drift by route over temperature at 1 mA.")}
**Why the derived balances cannot follow Fig. 16.** At small angles theta ~ M0/(K - k M0²): the magnet drives the
armature
and softens it. A stable valve has K > k M0², so losing {m.mmf_loss:.2f} % of M0 costs at least {m.mmf_loss:.2f} % of
theta; the paper prints {mmf.size:g} %. Checked numerically: of {m.drawn} random valves inside the bounds below,
{m.stable} are stable and within their null gap at 1 mA; the least of their losses is {np.min(m.losses):.4f} %, and
{m.exceptions} lose less than M0 does.

{_picture("magnet.png", "Every stable random valve loses more angle than its magnet loses magnetomotive force.")}
**Two published figures contradict each other.** The arm a and M0 enter torque and magnetic spring only as the product
a M0. The published {FIGURES[5].size:g} % by the arm, whose growth is {growth:.2f} %, therefore fixes what the loss
of M0
must do:
{implied:.2f} % under the printed signs, against {mmf.size:g} % published. No choice of parameters mends that.
As derived, the arm can by the same relation do no less than its own {growth:.2f} %, whatever the valve.
"""


def _reach_section(r: Reproduction) -> str:
    names = {f.key: f.title for f in FIGURES} | {
        "curve": "the three total figures together", "curve_and_flow": "the three and the flow coefficients",
        "mmf_and_arm": "magnetomotive force and arm together", "routes": "the eight routes together",
    }  # fmt: skip
    targets = {f.key: f for f in FIGURES}
    rows = []
    for name, title in names.items():
        row = [title]
        keys = r.reached["derived"][name].keys
        row.append(", ".join(_published(targets[key]) for key in keys) if len(keys) < 5 else "as above")
        for key in ("derived", "printed"):
            reach = r.reached[key][name]
            values = ", ".join(_num(v) for v in reach.values)
            if len(keys) > 4:
                values = f"worst miss {100 * reach.worst:.0f} %"
            row.append(f"**{values}**" if reach.possible else f"{values}: no")
        rows.append(row)
    return f"""## Which figures can be reached at all

Each figure, and some together, aimed at with all others ignored: the closest of any valve found inside the bounds.
Bold:
within {100 * TOLERANCE:g} %. A "no" is the outcome of
a search; for the magnetomotive force and the arm as derived it is proved above.

{_table(("figure", "published [%]", "as derived", "signs as printed"), rows, left=4)}"""


def _display(name: str, value: float) -> str:
    from valvesim.valve.parameters import Valve

    unit = quantities(Valve)[name].metadata["unit"]
    shown, factor = DISPLAY.get(unit, (unit, 1.0))
    return f"{value * factor:.4g} {symbol(shown) if shown != '1' else ''}".strip()


_PARAMETER_HEADINGS = (
    "parameter", "bounds", "why these", "as derived", "as printed", "determined, derived", "determined, printed"
)  # fmt: skip


def _identified_section(r: Reproduction) -> str:
    rows, at_bound = [], {}
    for key, found in r.identified.items():
        at_bound[key] = [
            u.name for u, s in zip(UNKNOWNS, found.shares, strict=True) if min(s, 1.0 - s) < 1e-3
        ]  # fmt: skip
    for k, u in enumerate(UNKNOWNS):
        row = [u.name.replace("_", " "), f"{_display(u.name, u.low)} to {_display(u.name, u.high)}", u.why]
        for key in ("derived", "printed"):
            value = _display(u.name, getattr(r.identified[key].valve, u.name))
            row.append(f"{value} (bound)" if u.name in at_bound[key] else value)
        for key in ("derived", "printed"):
            row.append(_judged(r, key, k))
        rows.append(row)
    d, p = r.determined["derived"], r.determined["printed"]
    starts = {key: (len(found.within_1), len(found.misfits)) for key, found in r.identified.items()}
    singular = {key: ", ".join(f"{s:.2g}" for s in r.determined[key].singular_values) for key in r.determined}
    counts = {
        key: sum(_judged(r, key, k).startswith("open") for k in range(len(UNKNOWNS))) for key in ("derived", "printed")
    }
    return f"""## Table 4, identified

{len(UNKNOWNS)} unknowns against {len(FIGURES)} figures: eight route maxima, the total, the total at 40 °C (steep to
40 °C
and then back) and the total at 5 mA (the same at every current). Relative misses count alike. A valve must be stable
with
2 % to spare and keep the published travel. {SCREENED} random valves are screened, the best {r.starts} refined by
bounded
least
squares; {starts["derived"][0]} of {starts["derived"][1]} (as derived) and {starts["printed"][0]} of
{starts["printed"][1]} (as printed) end within one percentage point of the best.

{_table(_PARAMETER_HEADINGS, rows, left=3)}
The last columns say how far the parameter may move, all others refitted, while the misfit rises by less than one
percentage point (tested at {len(PROFILE_SHARES)} places of its range
by local refits, so that it may be free to move further): "open" over the whole range; otherwise the
range
that is left. Many parameters lie at a bound: the figures pull the valve towards the edge of what can be built, which
again says that they do not belong to one valve of these equations.

**What the figures determine.** Taken as good to {100 * TOLERANCE:g} %, they fix {d.combinations} combinations of
parameters
(as derived) or {p.combinations} (as printed) better than a factor e, out of {len(UNKNOWNS)}; {counts["derived"]} and
{counts["printed"]} single parameters stay open over their whole range. Singular values (relative change of the
figures per
factor e): {singular["derived"]} as derived; {singular["printed"]} as printed. The identified valves are therefore
examples
of what comes closest, not the paper's valve.

{_picture("profile.png", "Rise of the misfit, percentage points, with one parameter held, all others refitted.")}"""


def _judged(r: Reproduction, key: str, k: int) -> str:
    """In words, where parameter k may lie."""
    rise = r.determined[key].profile[k] - r.identified[key].misfit
    fine = rise < 1.0
    if fine.all():
        return "open"
    u = UNKNOWNS[k]
    here = r.identified[key].shares[k]
    places = np.append(PROFILE_SHARES[fine], here)
    low, high = u.low * (u.high / u.low) ** places.min(), u.low * (u.high / u.low) ** places.max()
    if high / low < 1.01:
        return f"near {_display(u.name, low)}"
    return f"{_display(u.name, low)} to {_display(u.name, high)}"


def _gaps_section(r: Reproduction) -> str:
    g = r.gaps
    return f"""## Fig. 3: air gaps

From Tables 1 and 2 alone. At 270 °C the upper gap drifts by {_num(g.upper[-1], 2)} % and the lower by
{_num(g.lower[-1], 2)} %; the paper says {PUBLISHED_GAP_DRIFT:g} % each, opposite ways. Eq. 10 as printed adds L7 where
it must be subtracted and takes l_g2 where L2 must stand: it gives {_num(g.upper_printed[-1], 2)} % and
{_num(g.lower_printed[-1], 2)} %, the same sizes the wrong way round.

{_picture("gaps.png", "Air gaps over temperature: dashed as printed in Eqs. 9 and 10.")}"""


def _flux_section(r: Reproduction) -> str:
    low, high = r.flux.fluxes[:, 0] * 1e6, r.flux.fluxes[:, -1] * 1e6
    ways = "; ".join(f"gap {k + 1}: {a:.2f} to {b:.2f} µWb" for k, (a, b) in enumerate(zip(low, high, strict=True)))
    return f"""## Fig. 7: air gap flux against current

The nine equations of the magnetic circuit (Eq. 11 restored) solved for the reference valve, 20 °C, armature held, 1
to
10 mA: {ways}. The two gaps of one diagonal gain what the others lose, linearly to {r.flux.nonlinearity:.0e} %; the
paper
says approximately linear, of a simulation with saturation. Its values cannot be compared: the gap area is lost.

{_picture("flux.png", "Flux in the four air gaps of the reference valve.")}"""


def _oil_section(r: Reproduction) -> str:
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

{_table(("temperature [°C]", "Eq. 18 in °C", "Eq. 18 in rise", "MIL-PRF-5606, Walther"), rows)}
{_picture("viscosity.png", "Viscosity over temperature.")}"""


def _fit_row(fit: FlowFit) -> list[str]:
    out = fit.left_out
    return [
        fit.title, fit.orifice, f"{np.max(np.abs(fit.errors)):.2f}", f"{np.sqrt(np.mean(fit.errors**2)):.2f}",
        "-" if out is None else f"{np.max(np.abs(out)):.2f}",
        "-" if out is None else f"{np.sqrt(np.mean(out**2)):.2f}",
    ]  # fmt: skip


def _left_out(fit: FlowFit) -> np.ndarray:
    return np.full(len(TABLE_3), np.nan) if fit.left_out is None else fit.left_out


def _flow_section(r: Reproduction) -> str:
    f = r.fits
    rows = [_fit_row(fit) for pair in (f.printed, f.as_rise, f.power, f.hump) for fit in pair]
    errors = [
        [f"{t:g}", f"{c:.4f}", _num(a, 2), _num(b, 2), f"{c0:.4f}", _num(d, 2), _num(e, 2)]
        for t, c, a, b, c0, d, e in zip(
            TABLE_3[:, 0], TABLE_3[:, 1], f.printed[0].errors, _left_out(f.hump[0]), TABLE_3[:, 2],
            f.printed[1].errors, _left_out(f.power[1]), strict=True,
        )
    ]  # fmt: skip
    eq, law = r.reference_flow_drifts
    n, o = NOZZLE, FIXED_ORIFICE
    return f"""## Fig. 13 and Table 3: flow coefficients

Table 3 is the paper's CFD: the only data here that nobody of this project made. Errors in percent of the coefficient;
"left out" is the error at each of the nine temperatures of the law fitted to the other eight.

{_table(("law", "orifice", "largest", "rms", "largest left out", "rms left out"), rows, left=2)}
**What Eq. 19 misses.** In Table 3 the nozzle's coefficient rises by {f.nozzle_rise:.2f} % from 20 to 50 °C and falls
by
{-f.nozzle_fall:.2f} % from there to 150 °C. Eq. 19 has {_num(f.nozzle_rise_printed, 2)} % and
{_num(f.nozzle_fall_printed, 2)} %: a constant. Both its terms only ever rise.

**A better law.** With the paper's viscosity, an exponential of temperature, Eq. 19 is a power law in Reynolds number
(exponents {o.exponent:.2f} and {n.exponent:.2f}). What is missing is a hump:

C = C_inf [1 − (Re_c/Re)^n] [1 + h √(Re/Re_h) exp((1 − Re/Re_h)/2)] for Re ≥ Re_low, and C ~ Re (viscous flow) below.

{
        _table(
            ("orifice", "C_inf", "Re_c", "n", "h", "Re_h", "Re_low"),
            [
                [
                    "nozzle",
                    f"{n.limit:.4f}",
                    f"{n.critical:.1f}",
                    f"{n.exponent:.3f}",
                    f"{n.hump:.4f}",
                    f"{n.hump_place:.0f}",
                    f"{n.lowest:.1f}",
                ],
                [
                    "fixed orifice",
                    f"{o.limit:.4f}",
                    f"{o.critical:.1f}",
                    f"{o.exponent:.3f}",
                    f"{o.hump:g}",
                    "-",
                    f"{o.lowest:.1f}",
                ],
            ],
        )
    }
The nozzle has the hump; the fixed orifice has none (left out, it does worse with one). The shape of the hump was
chosen
among about ten by its error left one out, which therefore flatters it a little. Re = D √(2 Δp/ρ)/ν with
D = {1e3 * NOZZLE_HYDRAULIC_DIAMETER:.2f} mm (twice the null gap) and {1e3 * ORIFICE_HYDRAULIC_DIAMETER:.2f} mm,
Δp = {1e-6 * PRESSURE_DROP:g} MPa (inlet 15, outlet 3 MPa), ρ = {DENSITY:g} kg/m³ and Eq. 18 in °C; gap, bore and
density are
assumed, since the paper does not tell them, and only scale Re.

**Beyond 150 °C.** By Eq. 18 the CFD at 150 °C ran at a nozzle Reynolds number of {f.highest_reynolds:.0f}. A real oil
(Walther law) has {f.reynolds_at_270:.0f} at 270 °C: in Reynolds number the paper's own data cover 270 °C, and
nothing is
extrapolated. In the cold it is the other way round, and viscous flow is assumed below Re_low. One doubt remains:
between
−40 and −30 °C the fixed orifice's coefficient rises as Re^{f.cold_slope_yan:.2f} with Eq. 18, where viscous flow
allows
Re^1 at most; with the real oil's viscosity it is Re^{f.cold_slope_walther:.2f}. The coldest rows (the paper switched
its
CFD to laminar flow there) may not belong to Eq. 18.

In the model by name: `flow_laws.FLOW_LAWS["reynolds"]` with the viscosity of MIL-PRF-5606, `["reynolds_yan_oil"]`
with
Eq. 18, `["yan_2019"]` is Eq. 19. The reference
valve's flow route at 270 °C is {_num(eq)} % by Eq. 19 and {_num(law)} % by the Reynolds law with the real oil.

{
        _table(
            (
                "T [°C]",
                "nozzle, Table 3",
                "Eq. 19 [%]",
                "Re law left out [%]",
                "orifice, Table 3",
                "Eq. 19 [%]",
                "Re law left out [%]",
            ),
            errors,
        )
    }
{_picture("flow.png", "Flow coefficients over temperature and over Reynolds number, and the errors.")}"""


def _currents_section(r: Reproduction) -> str:
    rows = []
    for key in TITLES:
        c = r.curves[key]
        cells = []
        for k in range(len(CURRENTS)):
            at = int(np.argmax(np.abs(c.total[k, 0])))
            top, end = r.sense(key) * c.total[k, 0, [at, -1]]
            cells.append(f"{_num(top, 2)} at {RANGE[at]:g} °C; {_num(end, 2)}")
        rows.append([TITLES[key], *cells])
    headings = ("largest drift [%]; at 270 °C", *(f"{1e3 * i:g} mA" for i in CURRENTS))
    return f"""## Figs. 17 and 18: all routes together, at several currents

{_table(headings, rows, left=5)}
That the drift is the same at every current follows from the equations: at small angles the valve is linear. The
paper's
"the recovery is more remarkable with the larger signal" is hardly seen here.
{_steep(r)}

{_picture("currents.png", "Drift of the angle with all routes acting, at four currents.")}"""


def _steep(r: Reproduction) -> str:
    parts = []
    for key in ("derived", "printed", "printed_rise"):
        total = r.curves[key].total[0, 0]
        at_40 = float(np.interp(40.0, RANGE, total))
        parts.append(f"{100 * at_40 / total[np.argmax(np.abs(total))]:.0f} % ({TITLES[key]})")
    return (
        f"Of the largest drift, {_list(parts)} is there at 40 °C, where the paper has all of it. In Eq. 19 "
        f"the fixed orifice's coefficient at 40 °C has done "
        f"{100 * _done(flow_coefficients_yan_2019):.0f} % of its rise from 20 to 270 °C: the knee at 40 °C does not "
        "come from the flow coefficients as the paper gives them."
    )


def _done(law: Callable) -> float:
    c = law(np.array([20.0, 40.0, 270.0]))[1]
    return float((c[1] - c[0]) / (c[2] - c[0]))


def _experiment_section(r: Reproduction) -> str:
    rows = []
    for key in TITLES:
        e = r.experiment[key]
        rows.append([TITLES[key], *(_num(r.sense(key) * float(e.total[k, 0, -1]), 2) for k in range(len(CURRENTS)))])
    return f"""## Figs. 23 and 24: the experiment of section V

The paper heats the oil slowly from {EXPERIMENT_RANGE[0]:g} to {EXPERIMENT_RANGE[-1]:g} °C at 1 mA, then at larger
currents,
and measures the armature's angle by laser. It prints no numbers, and Table 5 is lost; it says that the tendency is
that of
the theory. Here the drift at {EXPERIMENT_RANGE[-1]:g} °C in percent, at rest and with all parts at one temperature:

{_table(("valve", *(f"{1e3 * i:g} mA" for i in CURRENTS)), rows)}
Over time the same is a scenario: `valvesim run scenarios/experiment_section_v.toml`, other currents with
`--set command.current.constant="'5 mA'"`.

{_picture("experiment.png", "The range of the experiment: drift of the angle at four currents.")}"""


def _not_validated(r: Reproduction) -> str:
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


# ---------------------------------------------------------------- pictures


def _png(figure: Figure) -> bytes:
    data = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(data, format="png", dpi=110, metadata={"Software": None})
    return data.getvalue()


def _draw_main(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 5.2))
    left, right = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.15, 1]})
    figure.subplots_adjust(left=0.15, right=0.98, top=0.83, bottom=0.12, wspace=0.2)
    order = np.argsort([f.size for f in FIGURES[: len(ROUTES)]], kind="stable")
    places = np.arange(len(ROUTES))
    sizes = [FIGURES[k].size for k in order]
    left.scatter(sizes, places, marker="|", s=420, lw=3, color="k", zorder=3)
    left.scatter([], [], marker="|", s=110, lw=3, color="k", label="published")
    keys = ("derived", "printed", "printed_rise")
    for offset, key in zip((0.22, 0.0, -0.22), keys, strict=True):
        values = r.identified[key].values[order]
        right_way = [f.direction in (0, np.sign(v)) for f, v in zip((FIGURES[k] for k in order), values, strict=True)]
        faces = [SHADES[key] if good else "none" for good in right_way]
        left.scatter(np.abs(values), places + offset, marker=MARKS[key], s=36, facecolors=faces, edgecolors=SHADES[key],
                     linewidths=1.3, zorder=4)  # fmt: skip
        left.scatter([], [], marker=MARKS[key], s=36, color=SHADES[key], label=TITLES[key])
    left.scatter([], [], marker="o", s=36, facecolors="none", edgecolors="0.3", label="wrong direction")
    left.set_xscale("log")
    left.set_yticks(places, [FIGURES[k].title for k in order])
    left.set_xlabel("largest drift of the armature angle [%]")
    left.set_title("by route, 20 to 270 °C, 1 mA", loc="left")
    left.legend(loc="lower right")
    for key in ("reference", *keys):
        right.plot(RANGE, r.sense(key) * r.curves[key].total[0, 0], color=SHADES[key], lw=1.6, label=TITLES[key])
    total = FIGURES[8]
    right.axhline(total.target, color="k", lw=0.8, ls=":")
    right.plot([40.0], [total.target], "k|", ms=16, mew=3, label=f"published: {total.size:g} % at 40 °C, then back")
    right.set_xlabel("temperature [°C]")
    right.set_ylabel("drift of the armature angle [%]")
    right.set_title("all routes together, 1 mA", loc="left")
    right.set_ylim(min(-17.5, right.get_ylim()[0]), right.get_ylim()[1] + 8.0)
    right.legend(loc="upper right")
    figure.suptitle("The paper's temperature drift, published and recomputed with the closest valve found", fontsize=12)
    return figure


def _draw_gaps(r: Reproduction) -> Figure:
    figure, axis = _one()
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


def _draw_flux(r: Reproduction) -> Figure:
    figure, axis = _one()
    where = ("gap 1 (upper, closing)", "gap 2 (upper)", "gap 3 (lower, closing)", "gap 4 (lower)")
    for k, flux in enumerate(r.flux.fluxes):
        style = "o-" if k < 2 else "s--"
        axis.plot(1e3 * r.flux.currents, 1e6 * flux, style, ms=3, color=COLOURS[k % 2], label=where[k])
    axis.set_xlabel("current [mA]")
    axis.set_ylabel("flux [µWb]")
    axis.legend()
    return figure


def _draw_viscosity(r: Reproduction) -> Figure:
    figure, axis = _one()
    t = np.linspace(-40.0, 270.0, 200)
    axis.semilogy(t, 1e6 * viscosity_yan_2019(t), color=COLOURS[0], label="Eq. 18 in °C")
    axis.semilogy(t, 1e6 * viscosity_yan_2019(t - 20.0), "--", color=COLOURS[0], label="Eq. 18 in temperature rise")
    axis.semilogy(t, 1e6 * MIL_PRF_5606.viscosity(t), color=COLOURS[1], label="MIL-PRF-5606, Walther law")
    axis.axvline(150.0, color="0.6", lw=0.8, ls=":")
    axis.set_xlabel("temperature [°C]")
    axis.set_ylabel("kinematic viscosity [mm²/s]")
    axis.legend()
    return figure


def _draw_flow(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 7))
    (nozzle, orifice), (over_re, errors) = figure.subplots(2, 2)
    figure.subplots_adjust(left=0.08, right=0.98, top=0.94, bottom=0.08, wspace=0.2, hspace=0.34)
    laws = (  # each where its Reynolds number is one of Table 3
        ("Eq. 19", flow_coefficients_yan_2019, COLOURS[0], "-", -40.0, 270.0),
        ("Re law, Eq. 18", flow_coefficients_reynolds_yan, COLOURS[1], "-", -40.0, 150.0),
        ("Re law, MIL-PRF-5606", flow_coefficients_reynolds, COLOURS[2], "--", -20.0, 270.0),
    )
    for k, (axis, name) in enumerate(((nozzle, "nozzle-flapper orifice"), (orifice, "fixed orifice"))):
        for title, law, colour, style, low, high in laws:
            t = np.linspace(low, high, 300)
            axis.plot(t, law(t)[k], style, color=colour, label=title)
        axis.plot(TABLE_3[:, 0], TABLE_3[:, 1 + k], "ko", ms=4, label="Table 3")
        axis.set_title(name, loc="left")
        axis.set_xlabel("oil temperature [°C]")
        axis.set_ylabel("flow coefficient")
        axis.legend(loc="lower right")
    nozzle.set_ylim(0.625, 0.68)
    orifice.set_ylim(0.25, 0.78)
    for k, (law, name) in enumerate(((NOZZLE, "nozzle"), (FIXED_ORIFICE, "fixed orifice"))):
        span = np.geomspace(law.lowest / 4.0, table_3_reynolds()[k][-1], 400)
        over_re.semilogx(span, law(span), color=COLOURS[k], label=f"{name}, Re law")
        given = table_3_reynolds()[k], TABLE_3[:, 1 + k]
        over_re.semilogx(*given, "o", ms=4, color=COLOURS[k], label=f"{name}, Table 3")
        over_re.axvline(law.lowest, color=COLOURS[k], lw=0.8, ls=":")
    over_re.set_title("over Reynolds number (left of the dots: viscous)", loc="left")
    over_re.set_xlabel("Reynolds number")
    over_re.set_ylabel("flow coefficient")
    over_re.legend()
    at = np.arange(len(TABLE_3))
    bars = (
        ("nozzle, Eq. 19", r.fits.printed[0].errors, COLOURS[0]),
        ("nozzle, Re law left one out", _left_out(r.fits.hump[0]), COLOURS[1]),
        ("orifice, Re law left one out", _left_out(r.fits.power[1]), COLOURS[2]),
    )
    for k, (title, values, colour) in enumerate(bars):
        errors.bar(at + 0.27 * (k - 1), values, 0.25, color=colour, label=title)
    errors.set_xticks(at, [f"{v:g}" for v in TABLE_3[:, 0]])
    errors.set_title("error against Table 3", loc="left")
    errors.set_xlabel("oil temperature [°C]")
    errors.set_ylabel("error [%]")
    errors.legend(loc="lower left")
    return figure


def _draw_routes(r: Reproduction) -> Figure:
    figure = Figure(figsize=(11, 4.4))
    axes = figure.subplots(1, len(SHOWN))
    figure.subplots_adjust(left=0.07, right=0.84, top=0.88, bottom=0.13, wspace=0.25)
    for axis, key in zip(axes, SHOWN, strict=True):
        curves = r.curves[key]
        for k in range(len(ROUTES)):
            title = FIGURES[k].title
            axis.plot(RANGE, r.sense(key) * curves.by_route[k, 0], color=COLOURS[k % len(COLOURS)], label=title)
        axis.plot(RANGE, r.sense(key) * curves.total[0, 0], "k", lw=2, label="all together")
        axis.set_title(TITLES[key], loc="left")
        axis.set_xlabel("temperature [°C]")
    axes[0].set_ylabel("drift of the armature angle [%]")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _draw_totals(r: Reproduction, curves: dict, temperatures: np.ndarray, published: bool) -> Figure:
    figure = Figure(figsize=(11, 4.2))
    shown = ("reference", "derived", "printed", "printed_rise")
    axes = figure.subplots(1, len(shown), sharey=True)
    figure.subplots_adjust(left=0.07, right=0.98, top=0.88, bottom=0.13, wspace=0.12)
    for axis, key in zip(axes, shown, strict=True):
        for k, current in enumerate(CURRENTS):
            style = {"color": COLOURS[k], "ls": ("-", "--", "-.", ":")[k], "label": f"{1e3 * current:g} mA"}
            axis.plot(temperatures, r.sense(key) * curves[key].total[k, 0], lw=1.6, **style)
        if published:
            axis.plot([40.0], [FIGURES[8].target], "k|", ms=12, mew=2.5, label="published")
        axis.set_title(TITLES[key], loc="left", fontsize=9)
        axis.set_xlabel("temperature [°C]")
    axes[0].set_ylabel("drift of the armature angle [%]")
    axes[0].legend(loc="center right")
    return figure


def _draw_currents(r: Reproduction) -> Figure:
    return _draw_totals(r, r.curves, RANGE, True)


def _draw_experiment(r: Reproduction) -> Figure:
    return _draw_totals(r, r.experiment, EXPERIMENT_RANGE, False)


def _draw_profile(r: Reproduction) -> Figure:
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
        axis.set_xticks(range(len(PROFILE_SHARES)), [f"{s:g}" for s in PROFILE_SHARES])
        axis.set_yticks(range(len(UNKNOWNS)), [u.name.replace("_", " ") for u in UNKNOWNS])
        axis.set_xlabel("place in the range between the bounds, logarithmic")
        axis.set_title(f"{TITLES[key]}: misfit {r.identified[key].misfit:.1f} % at best", loc="left")
        axis.grid(False)
    figure.colorbar(image, cax=figure.add_axes((0.92, 0.2, 0.015, 0.6)), label="rise of the misfit [percentage points]")
    return figure


def _draw_magnet(r: Reproduction) -> Figure:
    figure, axis = _one()
    m = r.magnet
    axis.loglog(m.stiffness, m.losses, ".", ms=1.5, color=COLOURS[0], alpha=0.4, rasterized=True)
    axis.axhline(m.mmf_loss, color="k", lw=1, label=f"loss of M0: {m.mmf_loss:.2f} %")
    axis.axhline(FIGURES[2].size, color=COLOURS[1], lw=1.4, ls="--", label=f"published: {FIGURES[2].size:g} %")
    axis.set_ylim(2.0, None)
    axis.set_yticks([2, 3, 5, 10, 20, 50], ["2", "3", "5", "10", "20", "50"], minor=False)
    axis.set_yticks([], minor=True)
    axis.set_xlabel("net stiffness over that of the springs")
    axis.set_ylabel("loss of angle by the magnet [%]")
    axis.set_title(f"{m.stable} stable random valves, balances as derived", loc="left")
    axis.legend()
    return figure


def _one():
    figure = Figure(figsize=(7.5, 4.2))
    axis = figure.subplots()
    figure.subplots_adjust(left=0.1, right=0.97, top=0.92, bottom=0.13)
    return figure, axis


def _styled(draw: Callable[[Reproduction], Figure]) -> Callable[[Reproduction], Figure]:
    def drawn(r: Reproduction) -> Figure:
        with matplotlib.rc_context(STYLE):
            return draw(r)

    return drawn


PICTURES: dict[str, Callable[[Reproduction], Figure]] = {
    MAIN_PICTURE: _styled(_draw_main),
    "routes.png": _styled(_draw_routes),
    "magnet.png": _styled(_draw_magnet),
    "profile.png": _styled(_draw_profile),
    "gaps.png": _styled(_draw_gaps),
    "flux.png": _styled(_draw_flux),
    "viscosity.png": _styled(_draw_viscosity),
    "flow.png": _styled(_draw_flow),
    "currents.png": _styled(_draw_currents),
    "experiment.png": _styled(_draw_experiment),
}
