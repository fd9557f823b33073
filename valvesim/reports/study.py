"""Pictures and page of a study: figures of merit and limits, percentiles over time, sensitivities, what to tighten."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.characterisation.figure_of_merit import unit_shown
from valvesim.reports.chart import Chart, Charts, Series
from valvesim.reports.html_page import Banner, Picture, Table, Terms, Text, section, write_html
from valvesim.reports.plotting import COLOURS, Figure, png, styled, write_bytes
from valvesim.reports.title_block import TitleBlock
from valvesim.studies import summary

if TYPE_CHECKING:
    from valvesim.studies.findings import Findings
    from valvesim.studies.sensitivity_indices import SensitivityIndices

MOST_HISTOGRAMS = 9
MOST_BARS = 10  # quantities of a picture of sensitivities
LIMIT_COLOUR, UNVARIED_COLOUR = COLOURS[1], "0.2"
FIGURE_COLUMNS = ("figure of merit", "unit", "nominal", "mean", "deviation", "1 %", "50 %", "99 %", "least", "member",
           "greatest", "member")  # fmt: skip
LIMIT_COLUMNS = ("limit", "asked for", "yield", "interval (95 %)", "Cpk", "interval (95 %)", "worst members")
INDEX_COLUMNS = ("quantity", "first order", "total", "local")
HALVED_COLUMNS = ("quantity", "yield with half the tolerance", "gain", "by weights ± 1 sigma")
STEP_COLUMNS = ("step", "tolerances", "yield", "by weights ± 1 sigma")
FAILURE_COLUMNS = ("members", "first", "reason")
VARIABLE_COLUMNS = ("quantity", "unit", "nominal", "distribution", "meaning")

HOW_TIGHTENED = (
    "Told from the members that have run, each moved towards the median of the tolerance along the regression plane of "
    "the figure; beside it, without a plane, from members weighted by how likely they are under the tighter tolerance."
)


def study_report(findings: Findings, folder: Path, *, valve: str, date: datetime.date) -> list[Path]:
    """Write the pictures and study.html of a study into a folder; their paths."""
    result, study = findings.result, findings.result.study
    block = TitleBlock(title=study.title, valve=valve, date=date, facts=(("Seed", str(study.design.seed)),))
    pictures: list[tuple[str, str, Figure]] = [
        (
            "figures",
            "Figures of merit of all members, the nominal one (line) and limits (dashed).",
            draw_figures(findings),
        )
    ]
    if study.percentiles is not None:
        told = "Percentiles of the members over time, and the nominal run (line)."
        pictures.append(("percentiles", told, draw_percentiles(findings)))
    if findings.indices:
        told = "Where the spread of each figure comes from."
        pictures.append(("sensitivity", told, draw_indices(findings)))
    if findings.tightening is not None:
        told = "Yield with each tolerance halved alone; the line is the yield as it is."
        pictures.append(("tightening", told, draw_tightening(findings)))
    drawn = {name: Picture(png(figure, block), caption) for name, caption, figure in pictures}
    written = [write_bytes(picture.data, folder / f"study_{name}.png") for name, picture in drawn.items()]
    nothing = Picture(b"", "")
    failures = summary.failure_rows(result)
    sections = (
        section("", Terms([("members", f"{int(result.ran.sum())} of {len(result.ran)}"),
                           ("design", f"{study.design.kind.replace('_', ' ')}, seed {study.design.seed}"),
                           ("quantities that vary", str(len(study.variables)))])),
        section("Limits", Table(LIMIT_COLUMNS, summary.limit_rows(result), (2, 4)),
                Text(_unjudged(result.unjudged))),
        section("Figures of merit", drawn["figures"],
                Table(FIGURE_COLUMNS, summary.figure_rows(result), tuple(range(2, 12))),
                Text("valvesim study STUDY --member NUMBER prints a member's scenario, which runs as any other.")),
        section("Over time", Charts(percentile_charts(findings)), drawn.get("percentiles", nothing)),
        section("Sensitivity", drawn.get("sensitivity", nothing), *_index_blocks(findings)),
        section("Which tolerance to tighten", drawn.get("tightening", nothing),
                Text(summary.plan_words(findings), strong=True),
                Table(HALVED_COLUMNS, summary.halved_rows(findings), (1, 2, 3)),
                Table(STEP_COLUMNS, summary.step_rows(findings), (2, 3)),
                Text(HOW_TIGHTENED if findings.tightening else "")),
        section("Members that lack a figure", Table(FAILURE_COLUMNS, failures, (0, 1))),
        section("What varies", Table(VARIABLE_COLUMNS, summary.variable_rows(result), (2,))),
    )  # fmt: skip
    return [*written, write_html(folder / "study.html", block, sections, banner=_banner(findings))]


def _banner(findings: Findings) -> Banner | None:
    result = findings.result
    if not result.criteria:
        return None
    own = result.yield_
    told = f"{own.passed} of {own.members} members keep every limit; 95 % interval {summary.yield_interval_text(own)}"
    good = own.share >= 0.9
    return Banner(
        f"Yield {summary.percent_text(own.share)}",
        told,
        COLOURS[2] if good else COLOURS[1],
        "#eef6f0" if good else "#fbf0f1",
    )


def _unjudged(names: Sequence[str]) -> str:
    return f"Not judged, for no kept figure shows them: {', '.join(names)}." if names else ""


def _index_blocks(findings: Findings) -> list[Any]:
    blocks: list[Any] = []
    for one in findings.indices:
        kind = (
            "Sobol indices"
            if one.are_sobol
            else f"shares by linear regression, which explains {100 * one.explained:.3g} %"
        )
        blocks.append(Text(f"{one.figure}: {kind}, of {one.used} members"))
        blocks.append(Table(INDEX_COLUMNS, summary.index_rows(findings, one.figure), (1, 2, 3)))
    return blocks


@styled
def draw_figures(findings: Findings) -> Figure:
    """Histograms of the figures of merit, those with limits first."""
    result = findings.result
    limits = {criterion.figure.name: criterion for criterion in result.criteria}
    order = sorted(range(len(result.figures)), key=lambda k: result.figures[k].name not in limits)
    shown = [k for k in order if np.isfinite(result.values[:, k]).any()][:MOST_HISTOGRAMS]
    columns = min(max(len(shown), 1), 3)
    rows = -(-max(len(shown), 1) // columns)
    figure = Figure(figsize=(4.0 * columns, 2.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, k in zip(axes, shown, strict=False):
        one = result.figures[k]
        unit, factor = unit_shown(one.unit)
        criterion = limits.get(one.name)
        values, nominal = result.values[:, k], result.nominal[k]
        if criterion is not None:
            values, nominal = criterion.judged(values), float(criterion.judged(np.array(nominal)))
        own = values[np.isfinite(values)] * factor
        low, high = np.percentile(own, (0.1, 99.9))
        reach = 0.1 * (high - low) or 0.05 * abs(high) or 1.0
        ends = [low - reach, high + reach]
        axis.hist(np.clip(own, *ends), bins=min(60, max(8, int(np.sqrt(len(own))))), color=COLOURS[0], alpha=0.75)
        if np.isfinite(nominal):
            axis.axvline(nominal * factor, color=UNVARIED_COLOUR, lw=1.2)
        for end in (criterion.low, criterion.high) if criterion is not None else ():
            if np.isfinite(end) and ends[0] - 4 * (high - low) < end * factor < ends[1] + 4 * (high - low):
                axis.axvline(end * factor, color=LIMIT_COLOUR, ls="--", lw=1.2)
        axis.set_title(one.name, loc="left", fontsize=8)
        axis.set_xlabel(f"[{unit}]" if unit else "")
        axis.set_yticks([])
        axis.set_axisbelow(True)
    for axis in axes[len(shown) :]:
        axis.set_axis_off()
    return figure


def percentile_charts(findings: Findings) -> list[Chart]:
    """A line each percentile, and the nominal run, of each channel over time."""
    data = findings.result.dataset
    charts: list[Chart] = []
    if findings.result.study.percentiles is None:
        return charts
    for name in map(str, data["channel"].values):
        unit, factor = unit_shown(str(data["channel_unit"].sel(channel=name).values))
        lines = data["percentile"].sel(channel=name).values * factor
        known = 1e-4 * float(np.ptp(lines))
        series = [Series(f"{level:g} %", unit, line, known, colour=k % 7)
                  for k, (level, line) in enumerate(zip(data["level"].values, lines, strict=True))]  # fmt: skip
        nominal = np.asarray(data["nominal_run"].sel(channel=name).values) * factor
        series.append(Series("nominal", unit, nominal, known, colour=7, dashed=True))
        text = name.replace("_", " ")
        charts.append(
            Chart(text.capitalize(), data["sample_time"].values, series, y_label=f"{text} [{unit}]", group="study")
        )
    return charts


@styled
def draw_percentiles(findings: Findings) -> Figure:
    """Bands between pairs of percentiles of each channel over time."""
    data = findings.result.dataset
    channels, levels, time = list(data["channel"].values), data["level"].values, data["sample_time"].values
    figure = Figure(figsize=(9.0, 2.6 * len(channels)), layout="constrained")
    axes = figure.subplots(len(channels), 1, sharex=True, squeeze=False).ravel()
    order = np.argsort(levels)
    for axis, name in zip(axes, channels, strict=True):
        unit, factor = unit_shown(str(data["channel_unit"].sel(channel=name).values))
        values = data["percentile"].sel(channel=name).values[order] * factor
        pairs = len(order) // 2
        for k in range(pairs):
            low, high = levels[order[k]], levels[order[-1 - k]]
            shade = 0.18 + 0.5 * (k + 1) / (pairs + 1)
            axis.fill_between(time, values[k], values[-1 - k], color=COLOURS[0], alpha=shade, lw=0,
                              label=f"{low:g} to {high:g} %")  # fmt: skip
        nominal = data["nominal_run"].sel(channel=name).values * factor
        axis.plot(time, nominal, color=UNVARIED_COLOUR, lw=0.9, label="nominal")
        axis.set_ylabel(f"{name.replace('_', ' ')}\n[{unit}]" if unit else name)
    axes[0].legend(ncols=pairs + 1, loc="upper center", bbox_to_anchor=(0.5, 1.22))
    axes[-1].set_xlabel("time [s]")
    return figure


@styled
def draw_indices(findings: Findings) -> Figure:
    """Bars of the indices of each figure, the local shares as points beside them."""
    columns = min(len(findings.indices), 3)
    rows = -(-len(findings.indices) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, one in zip(axes, findings.indices, strict=False):
        _index_bars(axis, one, findings.local_shares(one.figure))
    axes[0].legend(loc="lower right")
    for axis in axes[len(findings.indices) :]:
        axis.set_axis_off()
    return figure


def _index_bars(axis: Any, one: SensitivityIndices, local: np.ndarray) -> None:
    shown = one.order[:MOST_BARS][::-1]
    at = np.arange(len(shown))
    bars = [(one.first, one.first_error, "first order" if one.are_sobol else "by regression", COLOURS[0])]
    if one.are_sobol:
        bars.append((one.total, one.total_error, "total", COLOURS[3]))
    height = 0.8 / len(bars)
    for k, (values, errors, label, colour) in enumerate(bars):
        place = at + (k - (len(bars) - 1) / 2.0) * height
        low = np.minimum(errors[shown], np.maximum(values[shown], 0.0))
        axis.barh(place, 100 * np.maximum(values[shown], 0.0), height, color=colour, label=label,
                  xerr=100 * np.array([low, errors[shown]]), error_kw={"lw": 0.8, "ecolor": "0.4"})  # fmt: skip
    if np.isfinite(local[shown]).any():
        axis.plot(100 * local[shown], at, "D", ms=3.5, color=UNVARIED_COLOUR, label="local", ls="")
    axis.set_yticks(at, [one.keys[k].removeprefix("valve.").replace("_", " ") for k in shown], fontsize=7)
    axis.set_title(one.figure, loc="left", fontsize=8)
    axis.set_axisbelow(True)
    axis.set_xlabel("share of the variance [%]")


@styled
def draw_tightening(findings: Findings) -> Figure:
    """Bars of the yield with each tolerance halved alone."""
    plan = findings.tightening
    assert plan is not None  # noqa: S101 - the caller has looked
    shown = plan.halved[:MOST_BARS][::-1]
    figure = Figure(figsize=(8.0, 0.28 * len(shown) + 1.1), layout="constrained")
    axis = figure.subplots()
    at = np.arange(len(shown))
    axis.barh(at, [100 * one.share for one in shown], 0.7, color=COLOURS[0])
    axis.axvline(100 * plan.now.share, color=UNVARIED_COLOUR, lw=1.2)
    axis.axvline(100 * plan.wanted, color=LIMIT_COLOUR, lw=1.2, ls="--")
    names = [next(iter(one.factors)).removeprefix("valve.").replace("_", " ") for one in shown]
    axis.set_yticks(at, names, fontsize=8)
    axis.set_xlabel("yield [%]; dashed: wanted")
    axis.set_axisbelow(True)
    ends = [one.share for one in shown] + [plan.now.share, plan.wanted]
    room = 0.08 * (max(ends) - min(ends)) + 1e-3
    axis.set_xlim(100 * max(min(ends) - room, 0.0), 100 * min(max(ends) + room, 1.02))
    return figure
