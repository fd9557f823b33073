"""Picture: measured, nominal and extended readings where the nominal model errs most, and what both leave."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from valvesim.diagnosis.result import Diagnosis, Trace
from valvesim.reports.chart import Chart, Series
from valvesim.reports.diagnosis.words import short, spoken, unit_of
from valvesim.reports.plotting import (
    COLOURS,
    EXTENDED_COLOUR,
    MEASURED_COLOUR,
    MOST_POINTS,
    NOMINAL_COLOUR,
    Figure,
    styled,
    thin,
)

MOST_TRACES = 3  # that are shown, the worst


def worst_traces(traces: Iterable[Trace]) -> list[Trace]:
    """The traces that the nominal model gets most wrong for their noise: the worst of each channel first."""

    def wrong(trace: Trace) -> float:
        left = trace.measured - trace.base
        left = left[np.isfinite(left)]
        return float(np.sqrt(np.mean(left**2)) / trace.noise) if left.size and trace.noise > 0.0 else 0.0

    ranked = sorted((trace for trace in traces if len(trace.time) > 1), key=wrong, reverse=True)
    again = [trace.channel in {one.channel for one in ranked[:k]} for k, trace in enumerate(ranked)]
    chosen = sorted(range(len(ranked)), key=again.__getitem__)[:MOST_TRACES]
    return [ranked[k] for k in sorted(chosen)]


def trace_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Each of the worst traces whole: measured, nominal and extended readings, and below them what both leave."""
    charts = []
    for trace in worst_traces(diagnosis.traces):
        unit, factor = unit_of(trace.unit, float(np.nanmax(np.abs(trace.measured))))
        models = [("nominal model", trace.base, 1), ("extended model", trace.extended, 0)]
        models = [one for one in models if len(one[1]) == len(trace.time)]
        known = factor * trace.noise
        title, channel = f"{spoken(trace.channel)} in {trace.record}", spoken(trace.channel)
        readings = [Series("measured", unit, factor * trace.measured, known, colour=5)]
        readings += [Series(name, unit, factor * values, known, colour=k) for name, values, k in models]
        left = [Series(name, unit, factor * (trace.measured - values), known, colour=k) for name, values, k in models]
        for text, series in (("", readings), (", residual", left)):
            label = f"{channel if not text else 'residual'} [{unit or '-'}]"
            charts.append(Chart(f"{title}{text}", trace.time, series, y_label=label, group=trace.record))
    return charts


@styled
def draw_traces(diagnosis: Diagnosis) -> Figure | None:
    """Measured, nominal and extended readings, of a long record where the nominal errs most; below it the residuals."""
    traces = worst_traces(diagnosis.traces)
    if not traces:
        return None
    figure = Figure(figsize=(max(7.0, 4.0 * len(traces)), 6.0), layout="constrained")
    axes = figure.subplots(2, len(traces), squeeze=False, gridspec_kw={"height_ratios": [1.5, 1.0]})
    lines: dict[str, Any] = {}
    for trace, (top, below) in zip(traces, axes.T, strict=True):
        unit, factor = unit_of(trace.unit, float(np.nanmax(np.abs(trace.measured))))
        extended = len(trace.extended) == len(trace.time) and not np.array_equal(trace.extended, trace.base)
        part = _stretch(trace)
        t, measured = trace.time[part], factor * trace.measured[part]
        lines["measured"] = top.plot(t, measured, color=MEASURED_COLOUR, lw=2.6, alpha=0.6)[0]
        for label, values, colour, style in (
            ("nominal model", trace.base, NOMINAL_COLOUR, "--"),
            ("extended model", trace.extended, EXTENDED_COLOUR, "-"),
        )[: 2 if extended else 1]:  # fmt: skip
            lines[label] = top.plot(t, factor * values[part], style, color=colour, lw=1.3)[0]
            below.plot(*thin(trace.time, factor * (trace.measured - values)), color=colour, lw=0.9)
        if trace.noise > 0.0:
            band = 2.0 * factor * trace.noise
            lines["±2 noise deviations"] = below.axhspan(-band, band, color="0.85", lw=0, zorder=0)
            for edge in (-band, band):  # seen through the lines too
                below.axhline(edge, color="0.1", lw=0.7, ls=":", zorder=3)
        if part != slice(0, len(trace.time)):
            lines["stretch shown above"] = below.axvspan(t[0], t[-1], color=COLOURS[3], alpha=0.18, lw=0)
        locked = ", hold-out" if trace.role == "test" else ""
        top.set_title(f"{short(trace.record)}{locked}", loc="left")
        top.set_ylabel(f"{short(spoken(trace.channel))} [{unit or '-'}]")
        below.set_ylabel(f"residual [{unit or '-'}]")
        for axis in (top, below):
            axis.set_xlabel("time [s]")
            axis.margins(x=0.01)
    ncols = min(len(lines), 3 * len(traces))  # a single trace is too narrow for all of them side by side
    figure.legend(list(lines.values()), list(lines), loc="outside lower center", ncols=ncols)
    return figure


def _stretch(trace: Trace) -> slice:
    """The samples in which the nominal model errs most, no more than a line can show; all of a short record."""
    n = len(trace.time)
    if n <= MOST_POINTS:
        return slice(0, n)
    total = np.concatenate([[0.0], np.cumsum(np.nan_to_num(trace.measured - trace.base) ** 2)])
    start = int(np.argmax(total[MOST_POINTS:] - total[:-MOST_POINTS]))
    return slice(start, start + MOST_POINTS)
