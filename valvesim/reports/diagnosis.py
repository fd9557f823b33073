"""The report of a diagnosis: one page that can be mailed, with its pictures inside and beside it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from valvesim.diagnosis.result import (
    AMBIGUOUS,
    CAUSE,
    NO_DISCREPANCY,
    UNKNOWN,
    DetectionLimit,
    Diagnosis,
    Estimate,
    Gain,
    NoiseFound,
    Shift,
    Term,
    Trace,
)
from valvesim.errors import unknown_name
from valvesim.io import check_folder, write_atomically
from valvesim.reports.run import COLOURS, MOST_POINTS, STYLE, Figure, _thin, matplotlib
from valvesim.units import DISPLAY, symbol
from valvesim.valve.additive_term import LAG, NONE, PATH

MEASURED, BASE, EXTENDED = "0.35", COLOURS[1], COLOURS[0]
VERDICTS = {  # words, edge and ground of the banner
    NO_DISCREPANCY: ("No discrepancy found", COLOURS[2], "#e3f2e9"),
    CAUSE: ("Cause found", COLOURS[1], "#fbe6e8"),
    AMBIGUOUS: ("Several answers possible", COLOURS[3], "#fcf0dd"),
    UNKNOWN: ("Unknown mechanism", COLOURS[4], "#eee6f2"),
}
DPI = 140  # of the pictures: sharp on paper too
MEMORIES = {NONE: "none", LAG: "follows with a lag", PATH: "turns with the direction, as hysteresis does"}
MOST_RECORDS, MOST_TRACES, MOST_SCORES, MOST_SHIFTS, MOST_CANDIDATES = 24, 3, 12, 8, 8  # that are shown, largest first
UNDETERMINED = "not determined"
NAME = 44  # signs of a name that a picture has room for
_SHARE_WORDS = ("share", "loss", "error", "fraction", "gain")  # of names whose plain number reads better in %
_UNITS = {**DISPLAY, "m/K": ("µm/K", 1e6), "Pa/(m^3/s)": ("bar/(L/min)", 1e-5 / 6e4)}


def write_report(diagnosis: Diagnosis, folder: Path) -> list[Path]:
    """Write `report.html` (pictures inside) into `folder`, and each picture as a PNG beside it; their paths, page last.

    `errors.png`, `traces.png`, `scores.png`, `gain.png` and `term.png`, each only where the diagnosis has something for
    it. Everything is drawn before the first file is written. Raises InputError for a folder that cannot be written and
    for a verdict that is none.
    """
    folder = Path(folder)
    if diagnosis.verdict not in VERDICTS:
        raise unknown_name("verdict", diagnosis.verdict, VERDICTS, "diagnosis")
    check_folder(folder)
    pictures = draw(diagnosis)
    files = {f"{name}.png": data for name, data in pictures.items()}
    files["report.html"] = _page(diagnosis, pictures).encode("utf-8")
    return [write_atomically(folder / name, partial(_fill, data)) for name, data in files.items()]


def draw(diagnosis: Diagnosis) -> dict[str, bytes]:
    """The pictures of a diagnosis as PNG by name, without those that would be empty."""
    draws: dict[str, Callable[[Diagnosis], Figure | None]] = {
        "errors": draw_errors, "traces": draw_traces, "scores": draw_scores, "gain": draw_gain, "term": draw_term,
    }  # fmt: skip
    pictures = {}
    for name, function in draws.items():
        with matplotlib.rc_context({**STYLE, "figure.dpi": DPI}):
            figure = function(diagnosis)
            if figure is not None:
                pictures[name] = _png(figure)
    return pictures


def _fill(data: bytes, path: Path) -> None:
    path.write_bytes(data)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


# ---------------------------------------------------------------- numbers and names in words


def _unit_of(unit: str, size: float, name: str = "") -> tuple[str, float]:
    """(unit as people read it, factor from SI) of a quantity of that size; a share by name is in %."""
    if unit in ("1", "-", ""):
        return ("%", 100.0) if any(word in name for word in _SHARE_WORDS) else ("", 1.0)
    if unit == "s":
        return ("ms", 1e3) if abs(size) < 1.0 else ("s", 1.0)
    if unit.endswith("/K") and unit not in _UNITS:
        above, factor = DISPLAY.get(unit.removesuffix("/K"), (unit.removesuffix("/K"), 1.0))
        return f"{symbol(above)}/K", factor
    shown, factor = _UNITS.get(unit, (unit, 1.0))
    return symbol(shown), factor


def _number(value: float, step: float) -> str:
    """A number to two digits of `step`, which is what it is known to; to four digits where that is not known."""
    if value == 0.0:
        return "0"
    size = max(abs(value), abs(step))
    if not (np.isfinite(step) and step > 0.0) or not 1e-4 <= size < 1e6:
        return f"{value:.4g}"
    places = int(np.clip(1 - np.floor(np.log10(step)), 0, 9))
    return f"{value:.{places}f}"


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit else text


def _range(low: float, high: float, step: float, unit: str) -> str:
    """An interval in words, open sides included."""
    if np.isfinite(low) and np.isfinite(high):
        return _with_unit(f"{_number(low, step)} to {_number(high, step)}", unit)
    if np.isfinite(low) or np.isfinite(high):
        side, bound = ("above", low) if np.isfinite(low) else ("below", high)
        return f"{side} {_with_unit(_number(bound, step), unit)}"
    return UNDETERMINED


def estimate_words(estimate: Estimate) -> tuple[str, str]:
    """(value, 95 % interval) with units as people read them; what is not finite is not determined.

    A figure whose interval has no width was not fitted but held.
    """
    unit, factor = _unit_of(estimate.unit, estimate.value, estimate.name)
    value, low, high = (figure * factor for figure in (estimate.value, estimate.low, estimate.high))
    step = (high - low) / 2.0
    text = _with_unit(_number(value, step), unit) if np.isfinite(value) else UNDETERMINED
    return text, "held fixed" if step == 0.0 else _range(low, high, step, unit)


def spoken(name: str) -> str:
    """A name as a person says it: `sensor_bias@load_flow` is 'sensor bias, load flow'."""
    words = (("@", ", "), ("[", ", "), ("]", ""), ("=", " "), (":", " "), ("_", " "), (" + ", " with "))
    for sign, word in words:
        name = name.replace(sign, word)
    return name


def _short(name: str) -> str:
    """A name on one line, cut where a picture has no more room for it."""
    name = " ".join(name.split())
    return name if len(name) <= NAME else f"{name[: NAME - 1]}…"


def _answer_labels(diagnosis: Diagnosis) -> set[str]:
    """Labels of the causes that the answer names, alone or together."""
    named = diagnosis.verdict in (CAUSE, AMBIGUOUS)
    return {label for c in diagnosis.candidates if named and c.in_set for label in (c.label, *c.label.split(" + "))}


def _percent(share: float) -> str:
    """A probability or a share; never rounded to certainty."""
    percent = 100.0 * share
    if not np.isfinite(percent):
        return UNDETERMINED
    if 99.5 <= percent < 100.0 or 0.0 < percent < 0.5:
        return "over 99 %" if percent > 50.0 else "under 1 %"
    return f"{percent:.0f} %"


def _deviations(value: float) -> str:
    """An error in noise deviations."""
    return f"{value:.1f}" if value < 99.5 else f"{value:.0f}" if value < 1e5 else f"{value:.1e}"


def gain_words(gain: Gain) -> str:
    """What the figures of one locked record amount to, or why nothing is claimed of it."""
    if gain.claimed:
        above, left = gain.before**2 - gain.floor**2, gain.after**2 - gain.floor**2
        if above > 0.0 and np.isfinite(left):
            return f"better: {_percent(float(np.clip(1.0 - left / above, 0.0, 1.0)))} of the error above the noise gone"
        return "better"
    if not (np.isfinite(gain.low) and np.isfinite(gain.high)):
        return "not claimed: the interval of the change is not determined"
    if gain.low > 0.0:
        return "not claimed: the extended model is worse here"
    if gain.high >= 0.0:
        return "not claimed: the interval of the change includes zero"
    return "not claimed: better, but too little to be worth having"


# ---------------------------------------------------------------- pictures


def draw_errors(diagnosis: Diagnosis) -> Figure | None:
    """Error of the base model, record by channel, in noise deviations: 1 is noise alone."""
    rows = {
        record: {channel: value for channel, value in row.items() if np.isfinite(value)}
        for record, row in diagnosis.errors.items()
    }
    rows = {record: row for record, row in rows.items() if row}
    if not rows:
        return None
    worst = sorted(rows, key=lambda record: -max(rows[record].values()))[:MOST_RECORDS]
    records = [record for record in rows if record in worst]
    channels = list(dict.fromkeys(channel for record in records for channel in rows[record]))
    grid = np.array([[rows[record].get(channel, np.nan) for channel in channels] for record in records])
    figure = Figure(figsize=(min(3.8 + 1.1 * len(channels), 12.0), 1.5 + 0.34 * len(records)), layout="constrained")
    axis = figure.subplots()
    scale = matplotlib.colors.LogNorm(1.0, max(10.0, float(np.nanmax(grid))))
    shades = ("#ffffff", "#f6d5c9", BASE, "#6d1a2a")
    colours = matplotlib.colors.LinearSegmentedColormap.from_list("errors", shades, bad="0.92")
    image = axis.imshow(np.maximum(grid, 1.0), norm=scale, cmap=colours, aspect="auto")
    for (i, k), value in np.ndenumerate(grid):
        known = bool(np.isfinite(value))
        colour = "w" if known and scale(max(value, 1.0)) > 0.6 else "0.15"
        axis.text(k, i, _deviations(value) if known else "–", ha="center", va="center", color=colour)
    axis.set_xticks(range(len(channels)), [fill(_short(spoken(channel)), 12) for channel in channels])
    axis.set_yticks(range(len(records)), [_short(record) for record in records])
    axis.set_xticks(np.arange(1, len(channels)) - 0.5, minor=True)
    axis.set_yticks(np.arange(1, len(records)) - 0.5, minor=True)
    axis.grid(False)
    axis.grid(True, which="minor", color="0.75", alpha=1.0, lw=0.8)
    axis.tick_params(which="both", length=0)
    axis.spines[:].set(visible=True, color="0.75")
    left_out = f" ({len(records)} worst of {len(rows)} records)" if len(records) < len(rows) else ""
    axis.set_title(f"error of the base model in noise deviations{left_out}", loc="left")
    bar = figure.colorbar(image, ax=axis, label="1: noise alone", pad=0.02)
    bar.ax.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    bar.ax.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    bar.outline.set_visible(False)
    return figure


def worst_traces(traces: Iterable[Trace]) -> list[Trace]:
    """The traces that the base gets most wrong for their noise: the worst of each channel first."""

    def wrong(trace: Trace) -> float:
        left = trace.measured - trace.base
        left = left[np.isfinite(left)]
        return float(np.sqrt(np.mean(left**2)) / trace.noise) if left.size and trace.noise > 0.0 else 0.0

    ranked = sorted((trace for trace in traces if len(trace.time) > 1), key=wrong, reverse=True)
    again = [trace.channel in {one.channel for one in ranked[:k]} for k, trace in enumerate(ranked)]
    chosen = sorted(range(len(ranked)), key=again.__getitem__)[:MOST_TRACES]
    return [ranked[k] for k in sorted(chosen)]


def draw_traces(diagnosis: Diagnosis) -> Figure | None:
    """Measured, base and extended readings, of a long record where the base errs most; below it what both leave."""
    traces = worst_traces(diagnosis.traces)
    if not traces:
        return None
    figure = Figure(figsize=(max(7.0, 4.0 * len(traces)), 6.0), layout="constrained")
    axes = figure.subplots(2, len(traces), squeeze=False, gridspec_kw={"height_ratios": [1.5, 1.0]})
    lines: dict[str, Any] = {}
    for trace, (top, below) in zip(traces, axes.T, strict=True):
        unit, factor = _unit_of(trace.unit, float(np.max(np.abs(trace.measured))))
        extended = len(trace.extended) == len(trace.time) and not np.array_equal(trace.extended, trace.base)
        part = _stretch(trace)
        t, measured = trace.time[part], factor * trace.measured[part]
        lines["measured"] = top.plot(t, measured, color=MEASURED, lw=2.6, alpha=0.6)[0]
        for label, values, colour, style in (
            ("base model", trace.base, BASE, "--"), ("extended model", trace.extended, EXTENDED, "-"),
        )[: 2 if extended else 1]:  # fmt: skip
            lines[label] = top.plot(t, factor * values[part], style, color=colour, lw=1.3)[0]
            below.plot(*_thin(trace.time, factor * (trace.measured - values)), color=colour, lw=0.9)
        if trace.noise > 0.0:
            band = 2.0 * factor * trace.noise
            lines["±2 noise deviations"] = below.axhspan(-band, band, color="0.85", lw=0, zorder=0)
            for edge in (-band, band):  # seen through the lines too
                below.axhline(edge, color="0.1", lw=0.7, ls=":", zorder=3)
        if part != slice(0, len(trace.time)):
            lines["stretch shown above"] = below.axvspan(t[0], t[-1], color=COLOURS[3], alpha=0.18, lw=0)
        locked = ", locked away" if trace.role == "test" else ""
        top.set_title(f"{_short(trace.record)}{locked}", loc="left")
        top.set_ylabel(f"{_short(spoken(trace.channel))} [{unit or '-'}]")
        below.set_ylabel(f"residual [{unit or '-'}]")
        for axis in (top, below):
            axis.set_xlabel("time [s]")
            axis.margins(x=0.01)
    figure.legend(list(lines.values()), list(lines), loc="outside lower center", ncols=len(lines))
    return figure


def _stretch(trace: Trace) -> slice:
    """The samples in which the base errs most, no more than a line can show; all of a short record."""
    n = len(trace.time)
    if n <= MOST_POINTS:
        return slice(0, n)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(trace.measured - trace.base) ** 2)])
    start = int(np.argmax(total[MOST_POINTS:] - total[:-MOST_POINTS]))
    return slice(start, start + MOST_POINTS)


def draw_scores(diagnosis: Diagnosis) -> Figure | None:
    """How strongly the foremost candidates show, with the level of the alarm; those of the answer in colour."""
    scores = sorted((s for s in diagnosis.scores if np.isfinite(s.z)), key=lambda s: -abs(s.z))[:MOST_SCORES]
    if not scores:
        return None
    answer = _answer_labels(diagnosis)
    figure = Figure(figsize=(8.5, 1.3 + 0.3 * len(scores)), layout="constrained")
    axis = figure.subplots()
    sizes, places = [abs(s.z) for s in scores], range(len(scores))
    bars = axis.barh(places, sizes, color=[EXTENDED if s.label in answer else "0.75" for s in scores], height=0.68)
    plate = {"facecolor": "w", "edgecolor": "none", "pad": 1.0}  # so that the level does not cross a number
    axis.bar_label(bars, [f"{s.z:.1f}" for s in scores], padding=5, fontsize=8, bbox=plate)
    axis.set_yticks(places, [_short(spoken(s.label)) for s in scores])
    axis.invert_yaxis()
    axis.grid(False, axis="y")
    axis.set_axisbelow(True)
    axis.tick_params(axis="y", length=0)
    level = diagnosis.alarm_level if np.isfinite(diagnosis.alarm_level) else 0.0
    axis.set_xlim(0.0, 1.12 * max(*sizes, level, 1.0))
    if level > 0.0:
        axis.axvline(level, color=BASE, ls="--", label=f"alarm level {level:.2f}")
        figure.legend(loc="outside upper right")
    axis.set_xlabel("|z|, strength against noise [-]")
    blue = " (in blue: in the answer)" if answer & {s.label for s in scores} else ""
    axis.set_title(f"strength of each candidate{blue}", loc="left")
    return figure


def draw_gain(diagnosis: Diagnosis) -> Figure | None:
    """Error before and after on each locked record beside the noise floor, and its change with the interval."""
    gains = [g for g in diagnosis.gain if np.isfinite((g.before, g.after, g.floor)).all()]
    if not gains or not _extended_differs(diagnosis):
        return None
    figure = Figure(figsize=(9.5, 1.8 + 0.42 * len(gains)), layout="constrained")
    errors, changes = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [1.5, 1.0]})
    for k, g in enumerate(gains):
        face = EXTENDED if g.claimed else "w"
        errors.plot([g.before, g.after], [k, k], color="0.8", lw=3, zorder=1)
        errors.plot([g.floor] * 2, [k - 0.3, k + 0.3], color="0.25", lw=2, label="noise floor")
        errors.plot(g.before, k, "s", color=BASE, ms=7, label="base model")
        errors.plot(g.after, k, "o", color=EXTENDED, mfc=face, ms=7, label="extended model")
        change, low, high = _relative(g)
        changes.plot([low, high], [k, k], "|-", color=EXTENDED, lw=1.6, ms=9, label="95 % interval")
        changes.plot(change, k, "o", color=EXTENDED, mfc=face, ms=7)
    names = [_short(g.record) + ("" if g.claimed else "\n(not claimed)") for g in gains]
    errors.set_yticks(range(len(gains)), names)
    errors.set_ylim(len(gains) - 0.4, -0.6)
    errors.set_xlim(left=0.0)
    errors.set_xlabel("error [noise deviations]")
    errors.set_title("error on the locked records", loc="left")
    changes.axvline(0.0, color="0.25", lw=1.0)
    changes.set_xlabel("change of the mean square [%]")
    changes.set_title("change; left of zero is better", loc="left")
    for axis in (errors, changes):
        axis.grid(False, axis="y")
        axis.tick_params(axis="y", length=0)
    shown: dict[str, Any] = {}
    for axis in (errors, changes):
        for line, text in zip(*axis.get_legend_handles_labels(), strict=True):
            shown.setdefault(text, line)
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=4)
    return figure


def _extended_differs(diagnosis: Diagnosis) -> bool:
    """Whether any locked record saw a model that is not the base itself."""
    return any(gain.change != 0.0 for gain in diagnosis.gain)


def _relative(gain: Gain) -> tuple[float, float, float]:
    """(change, low, high) in % of the mean square before; NaN where there was none."""
    share = 100.0 / gain.before**2 if gain.before > 0.0 else np.nan
    return gain.change * share, gain.low * share, gain.high * share


def draw_term(diagnosis: Diagnosis) -> Figure | None:
    """A recovered term over its variable, with a band of two standard deviations, and its formula."""
    term = diagnosis.term
    if term is None or not term.at:
        return None
    order = np.argsort(term.at)
    at, value, deviation = (np.asarray(each, dtype=float)[order] for each in (term.at, term.value, term.deviation))
    (x_unit, x_factor), (y_unit, y_factor) = _term_units(term)
    at, value, deviation = at * x_factor, value * y_factor, np.nan_to_num(deviation) * y_factor
    figure = Figure(figsize=(8.5, 4.4), layout="constrained")
    axis = figure.subplots()
    axis.axhline(0.0, color="0.6", lw=0.8)
    low, high = value - 2.0 * deviation, value + 2.0 * deviation
    axis.fill_between(at, low, high, color=EXTENDED, alpha=0.2, lw=0, label="±2 standard deviations")
    axis.plot(at, value, "o-" if len(at) <= 40 else "-", ms=3, color=EXTENDED, lw=1.6, label="recovered term")
    axis.set_xlabel(f"{_short(spoken(term.variable))} [{x_unit or '-'}]")
    axis.set_ylabel(f"added to {_short(spoken(term.port))} [{y_unit or '-'}]")
    axis.legend(loc="best")
    axis.set_title(fill(f"formula, in SI units: {term.formula}", 100) if term.formula else "recovered term", loc="left")
    return figure


def _term_units(term: Term) -> tuple[tuple[str, float], tuple[str, float]]:
    """Unit and factor of the variable and of what is added."""
    sizes = [max(map(abs, each), default=0.0) for each in (term.at, term.value)]
    return _unit_of(term.variable_unit, sizes[0]), _unit_of(term.port_unit, sizes[1])


# ---------------------------------------------------------------- page


class _Markup(str):
    """Text that is HTML already. Any other is escaped by `_tag`, so that no name can ever be read as markup."""


def _tag(tag: str, *content: str, **attributes: str) -> _Markup:
    """An element with its contents; an attribute `class_` is written `class`."""
    inner = "".join(one if isinstance(one, _Markup) else html.escape(one) for one in content)
    given = "".join(f' {key.rstrip("_")}="{html.escape(value)}"' for key, value in attributes.items())
    return _Markup(f"<{tag}{given}>{inner}</{tag}>")


def _section(heading: str, *parts: str) -> _Markup:
    """A heading with what is not empty under it; nothing where all is."""
    filled = [part for part in parts if part]
    return _tag("section", _tag("h2", heading), *filled) if filled else _Markup()


def _text(text: str) -> _Markup:
    return _tag("p", text) if text else _Markup()


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> _Markup:
    """A table, columns of `numbers` to the right; nothing without rows. Columns that are empty in every row go."""
    if not rows:
        return _Markup()
    keep = [k for k in range(len(headings)) if any(row[k] for row in rows)]

    def line(cell: str, row: Sequence[str]) -> _Markup:
        return _tag("tr", *(_tag(cell, row[k], **({"class_": "number"} if k in numbers else {})) for k in keep))

    head = _tag("thead", line("th", headings))
    return _tag("div", _tag("table", head, _tag("tbody", *(line("td", row) for row in rows))), class_="wide")


def _list(items: Sequence[str]) -> _Markup:
    return _tag("ul", *(_tag("li", item) for item in items)) if items else _Markup()


def _pairs(pairs: Sequence[tuple[str, str]], class_: str) -> _Markup:
    """Terms and what they are, without those that are empty."""
    filled = [_tag("div", _tag("dt", term), _tag("dd", text)) for term, text in pairs if text]
    return _tag("dl", *filled, class_=class_) if filled else _Markup()


def _bar(share: float, text: str) -> _Markup:
    """Text upon a bar of that share."""
    return _tag("span", text, class_="bar", style=f"--share:{100.0 * np.clip(np.nan_to_num(share), 0.0, 1.0):.0f}%")


def _picture(pictures: dict[str, bytes], name: str, caption: str) -> _Markup:
    if name not in pictures:
        return _Markup()
    data = base64.b64encode(pictures[name]).decode("ascii")
    width = round(int.from_bytes(pictures[name][16:20], "big") * 96 / DPI)  # so that all have letters of one size
    image = _Markup(f'<img alt="{html.escape(caption)}" style="width:{width}px" src="data:image/png;base64,{data}">')
    return _tag("figure", image, _tag("figcaption", caption))


_CSS = """
:root{color-scheme:light}
body{font:15px/1.5 system-ui,-apple-system,"Segoe UI",sans-serif;max-width:1050px;margin:1.5em auto;padding:0 1em;
color:#222;background:#fff}
h1{font-size:1.5em;margin:0 0 .6em}h2{font-size:1.15em;margin:2em 0 .5em;border-bottom:1px solid #ccd3dc}
.banner{border-left:.6em solid;padding:.8em 1.2em;border-radius:.3em}
.banner>*{color:#222}.banner strong{display:block;font-size:1.35em}.banner p{margin:.2em 0 0;font-size:1.1em}
.facts{display:flex;flex-wrap:wrap;gap:.8em 2.4em;margin:1em 0}.facts dt,.words dt{font-weight:600}
.facts dt{font-size:.85em;color:#555}.facts dd{margin:0;max-width:30em}
.wide{overflow-x:auto}table{border-collapse:collapse;margin:.6em 0;font-size:14px}
td,th{padding:.25em .9em .25em 0;border-bottom:1px solid #e2e6eb;text-align:left;vertical-align:top}
th{border-bottom:2px solid #ccd3dc}.number{text-align:right;font-variant-numeric:tabular-nums}
td.number{white-space:nowrap}
.bar{display:inline-block;min-width:8em;padding:0 .5em;
background:linear-gradient(90deg,#bcd3ee var(--share),#eef2f6 var(--share))}
figure{margin:1em 0}img{max-width:100%;height:auto;display:block}figcaption,.words{font-size:.88em;color:#444}
code,pre{font-family:ui-monospace,Menlo,Consolas,monospace;font-size:.9em}
pre{background:#f6f7f9;padding:.8em;white-space:pre-wrap;overflow-wrap:anywhere}
.words div{margin:.4em 0}.words dt{display:inline}.words dd{display:inline;margin:0 0 0 .6em}
@media print{body{margin:0;max-width:none;font-size:11pt}.banner,.bar{print-color-adjust:exact;
-webkit-print-color-adjust:exact}figure,tr,.banner{break-inside:avoid}h2{break-after:avoid}.wide{overflow:visible}}
"""


def _page(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> str:
    """The whole page as HTML5."""
    causes = (_causes(diagnosis), _answer_set(diagnosis))
    shown = (
        _banner(diagnosis), _facts(diagnosis), *(causes if diagnosis.causes else reversed(causes)),
        _next_test(diagnosis), _gain(diagnosis, pictures), _term(diagnosis, pictures),
        _section(
            "Simulation beside records" if diagnosis.verdict == NO_DISCREPANCY else "What the simulation gets wrong",
            _picture(pictures, "errors", "Error of the base model, fitted to these records, in noise deviations (root "
                     "mean square): 1 is noise alone; grey is not measured."),
            _picture(pictures, "traces", "The readings that the base model gets most wrong; below them the residual, "
                     "measured less model."),
        ),
        _section(
            "How strongly each candidate shows",
            _picture(pictures, "scores", "What passes the alarm level is no accident: where nothing is hidden, the "
                     "strongest of all candidates hardly ever reaches it." if np.isfinite(diagnosis.alarm_level)
                     else "These records show none of the candidates well enough to set an alarm level."),
        ),
        _shifts(diagnosis.shifts), _noise(diagnosis.noise), _limits(diagnosis.detection_limits),
        _section("Notes", _list(diagnosis.notes)), _extended(diagnosis), _words(diagnosis),
    )  # fmt: skip
    head = _tag(
        "head", _Markup('<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'),
        _tag("title", f"Diagnosis: {diagnosis.title}"), _tag("style", _Markup(_CSS)),
    )  # fmt: skip
    body = _tag("body", _tag("h1", f"Diagnosis: {diagnosis.title}"), *(_Markup(f"\n{part}") for part in shown if part))
    return f"<!DOCTYPE html>\n{_tag('html', head, body, lang='en')}\n"


def _banner(diagnosis: Diagnosis) -> _Markup:
    words, edge, ground = VERDICTS[diagnosis.verdict]
    if diagnosis.verdict == CAUSE and len(diagnosis.causes) > 1:
        words = "Causes found"
    style = f"border-color:{edge};background:{ground}"
    return _tag("div", _tag("strong", words), _text(diagnosis.summary), class_="banner", style=style)


def _facts(diagnosis: Diagnosis) -> _Markup:
    """What a reader in a hurry wants to know besides."""
    first = [c for c in diagnosis.candidates if c.in_set and c.names not in ((), (UNKNOWN,))][:1]
    better, locked = sum(gain.claimed for gain in diagnosis.gain), len(diagnosis.gain)
    claimed = f"better on {better} of {locked} locked records" if diagnosis.gain_claimed else "none claimed"
    channels = {found.channel for found in diagnosis.noise}
    unverified = {found.channel for found in diagnosis.noise if not found.verified}
    noise = f"unverified for {len(unverified)} of {len(channels)} channels" if unverified else "known from repeats"
    return _pairs(
        (
            ("Where", diagnosis.location),
            ("Probability", _percent(first[0].probability) if first and diagnosis.verdict == CAUSE else ""),
            ("Gain", claimed if diagnosis.verdict != NO_DISCREPANCY else ""),
            ("Noise", noise if diagnosis.noise else ""),
        ),
        "facts",
    )


def _causes(diagnosis: Diagnosis) -> _Markup:
    """The causes, each with its figures; a cause without any is named all the same."""
    rows, above = [], ""
    for e in diagnosis.parameters:
        rows.append((spoken(e.cause) if e.cause != above else "", spoken(e.name), *estimate_words(e), e.doc))
        above = e.cause
    told = [e.cause for e in diagnosis.parameters]  # these name the sensor or side too: sensor_bias@load_flow
    silent = [cause for cause in diagnosis.causes if not any(one.startswith(cause) for one in told)]
    rows += [(spoken(cause), "", "", "", "") for cause in silent]
    headings = ("cause", "figure", "estimate", "95 % interval", "meaning")
    names = _text(f"By name in diagnosis.json: {', '.join(diagnosis.causes)}." if diagnosis.causes else "")
    heading = "Causes" if len(diagnosis.causes) > 1 else "Cause" if diagnosis.causes else "If it is the likeliest"
    return _section(heading, _table(headings, rows, (2, 3)), names)


def _answer_set(diagnosis: Diagnosis) -> _Markup:
    """The candidates with their probabilities, where more than one was weighed."""
    candidates, ambiguous = diagnosis.candidates, diagnosis.verdict == AMBIGUOUS
    if len(candidates) < 2 and not ambiguous:
        return _Markup()
    ranked = sorted(candidates, key=lambda c: not c.in_set)  # the likeliest first, within each
    rows = [
        (
            spoken(c.label), _bar(c.probability, _percent(c.probability)), "possible" if c.in_set else "less likely",
            c.location,
            _number(c.deviance_fall, max(1.0, 0.01 * c.deviance_fall)) if np.isfinite(c.deviance_fall) else "",
        )
        for c in ranked[:MOST_CANDIDATES]
    ]  # fmt: skip
    headings = ("candidate", "probability", "answer", "where", "fall of deviance")
    told = "The data cannot tell the possible ones apart." if ambiguous else ""
    heading = "Possible causes" if ambiguous else "What was weighed"
    return _section(heading, _text(told), _table(headings, rows, (4,)))


def _next_test(diagnosis: Diagnosis) -> _Markup:
    test = diagnosis.next_test
    if test is None:
        return _section("Next test", _text(diagnosis.no_test)) if diagnosis.no_test else _Markup()
    first, second = map(spoken, test.separates)
    settings = [(spoken(name), text) for name, text in test.settings.items()]
    duration = f"takes {test.duration:g} s and " if np.isfinite(test.duration) else ""
    distance = f" (distance {test.distance:.1f} noise deviations)" if np.isfinite(test.distance) else ""
    power = f"It {duration}would tell {first} from {second}"
    if np.isfinite(test.power):
        power += f" with a probability of {_percent(test.power)}{distance}"
    others = _text("Instead of it: " + "; ".join(test.alternatives) + ".") if test.alternatives else _Markup()
    return _section("Next test", _tag("p", _tag("strong", test.description)), _table(("setting", "value"), settings),
                    _text(f"{power}."), others)  # fmt: skip


def _gain(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> _Markup:
    """Before, after and noise floor on the locked records, or why no gain is claimed."""
    if diagnosis.verdict == NO_DISCREPANCY:
        return _Markup()
    heading = "Gain of the extended model"
    if not diagnosis.gain:
        return _section(
            heading, _text("No gain is claimed: there is no locked record that the extended model could be tried on.")
        )
    if not _extended_differs(diagnosis):
        return _section(heading, _text("No gain is claimed: nothing was found to extend the model with."))
    told = (
        "On records that the search never saw, opened once. Errors are in noise deviations, over all channels."
        if diagnosis.gain_claimed
        else "No gain is claimed over all locked records; the last column says what each of them shows."
    )
    rows = []
    for g in diagnosis.gain:
        change, low, high = _relative(g)
        figures = [_number(v, 0.1) if np.isfinite(v) else UNDETERMINED for v in (g.before, g.after, g.floor)]
        moved = f"{change:+.0f} % ({_range(low, high, 10.0, '%')})" if np.isfinite(change) else UNDETERMINED
        rows.append((g.record, *figures, moved, gain_words(g)))
    headings = ("record", "before", "after", "noise floor", "change of mean square (95 % interval)", "so")
    caption = "Error on the locked records before and after; a hollow mark is not claimed."
    return _section(heading, _text(told), _table(headings, rows, (1, 2, 3, 4)),
                    _picture(pictures, "gain", caption))  # fmt: skip


def _term(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> _Markup:
    term = diagnosis.term
    if term is None:
        return _Markup()
    (x_unit, x_factor), (y_unit, _) = _term_units(term)
    visited = ""
    if term.at:
        low, high = min(term.at) * x_factor, max(term.at) * x_factor
        visited = _range(low, high, (high - low) / 10.0, x_unit)
    off = _percent(term.formula_error) if term.formula and np.isfinite(term.formula_error) else ""
    facts = (
        ("Added to", _with_unit(spoken(term.port), f"[{y_unit}]" if y_unit else "")),
        ("As a function of", spoken(term.variable)),
        ("Visited", visited),
        ("Memory", MEMORIES.get(term.memory, term.memory)),
        ("Formula, in SI units", term.formula or "none holds up; the curve stands for itself"),
        ("Formula off by", off),
        ("Nearly as well", "; ".join(term.alike)),
    )
    caption = "The missing term as recovered from the records; it is not known beyond the range that they visited."
    return _section("The missing term", _pairs(facts, "facts"), _picture(pictures, "term", caption))


def _shifts(shifts: Sequence[Shift]) -> _Markup:
    """The base parameters that moved most, as share of their tolerance."""
    known = [s for s in shifts if np.isfinite((s.share_of_tolerance, s.nominal, s.value)).all()]
    moved = sorted(known, key=lambda s: -abs(s.share_of_tolerance))
    rows = []
    for s in moved[:MOST_SHIFTS]:
        unit, factor = _unit_of(s.unit, max(abs(s.nominal), abs(s.value)), s.name)
        step = abs(s.value - s.nominal) * factor
        nominal, value = (_with_unit(_number(v * factor, step), unit) for v in (s.nominal, s.value))
        share = _bar(abs(s.share_of_tolerance), f"{100.0 * s.share_of_tolerance:+.0f} %")
        rows.append((spoken(s.name), nominal, value, share))
    left, beyond = len(moved) - len(rows), [spoken(s.name) for s in moved if abs(s.share_of_tolerance) > 1.0]
    told = "Parameters of the base model as refitted to the records, the largest shifts first."
    told += f" The other {left} moved less." if left > 0 else ""
    told += f" Beyond the tolerance: {'; '.join(beyond)}." if beyond else ""
    headings = ("parameter", "nominal", "refitted", "share of its tolerance")
    return _section("Refitted silently", _text(told if rows else ""), _table(headings, rows, (1, 2)))


def _noise(noise: Sequence[NoiseFound]) -> _Markup:
    rows = []
    for n in noise:
        unit, factor = _unit_of(n.unit, n.deviation)
        size = _with_unit(f"{n.deviation * factor:.3g}", unit) if np.isfinite(n.deviation) else UNDETERMINED
        source = n.source.replace("residual", "what the model leaves")
        rows.append(
            (spoken(n.channel), f"{n.rate:.5g} Hz", size, f"coloured, order {n.order}" if n.order else "white",
             source if n.verified else f"{source} (unverified)")
        )  # fmt: skip
    doubt = "Unverified noise may hide errors of the model: only repeats of a test tell them apart."
    told = doubt if any(not n.verified for n in noise) else ""
    headings = ("channel", "rate", "standard deviation", "kind", "found in")
    return _section("Noise", _table(headings, rows, (1, 2)), _text(told))


def _limits(limits: Sequence[DetectionLimit]) -> _Markup:
    """What this session would have shown nine times in ten; what it is blind to."""
    seen, blind = [], []
    for limit in limits:
        if limit.amplitude is None or not np.isfinite(limit.amplitude):
            blind.append(spoken(limit.label))
            continue
        unit, factor = _unit_of(limit.unit, limit.amplitude, limit.parameter)
        seen.append((spoken(limit.label), spoken(limit.parameter), _with_unit(f"{limit.amplitude * factor:.3g}", unit)))
    told = (
        "The smallest amplitude that these records would have shown, nine times in ten, from where the effect vanishes."
        if seen
        else ""
    )
    blindness = _text(f"Blind to: {'; '.join(blind)}.") if blind else _Markup()
    headings = ("effect", "figure", "smallest amplitude")
    return _section("What this session would have shown", _text(told), _table(headings, seen, (2,)), blindness)


def _extended(diagnosis: Diagnosis) -> _Markup:
    if not diagnosis.extended_scenario:
        return _Markup()
    model = "extended model" if diagnosis.extension_offered else "refitted model"
    summary = _tag("summary", "The scenario ", _tag("code", "extended.toml"), f", which runs the {model}")
    return _section(f"The {model}", _tag("details", summary, _tag("pre", diagnosis.extended_scenario)))


def _words(diagnosis: Diagnosis) -> _Markup:
    """A footnote on the words that this page uses."""
    several = len(diagnosis.candidates) > 1
    return _section(
        "Words",
        _pairs(
            (
                ("Noise deviation", "standard deviation of a sensor's noise. An error of 1 is noise alone; below that "
                 "nothing can be seen." if diagnosis.errors or diagnosis.gain else ""),
                ("z", "how many standard deviations a candidate's pattern stands out of what the base model leaves, "
                 "after its parameters have taken what they can; between -2 and 2 most of the time where nothing is "
                 "hidden." if diagnosis.scores else ""),
                ("Deviance", "sum of squared errors in noise deviations, with the squared shifts of the parameters: "
                 "the more it falls, the more a candidate explains. No model is the valve itself, so probabilities are "
                 "more cautious than the deviance alone." if several else ""),
                ("Probability", "among the candidates on this page, given these records; causes that nobody thought of "
                 "are in it only as 'none of the known'." if diagnosis.candidates else ""),
                ("95 % interval", "holds the true figure in 95 of 100 such sessions."
                 if diagnosis.parameters or diagnosis.gain else ""),
                ("Locked record", "put aside before the search and opened once, after it." if diagnosis.gain else ""),
                ("Distance", "how far apart the two candidates' readings would lie, over all samples of the test, in "
                 "noise deviations." if diagnosis.next_test else ""),
            ),
            "words",
        ),
    )  # fmt: skip
