"""Picture: the error of the nominal model, record by channel, in noise deviations."""

from __future__ import annotations

from textwrap import fill

import numpy as np

from valvesim.diagnosis.result import Diagnosis
from valvesim.reports.diagnosis.words import deviations, short, spoken
from valvesim.reports.plotting import NOMINAL_COLOUR, Figure, colors, label_decades, styled

MOST_RECORDS = 24  # that are shown, the worst


@styled
def draw_errors(diagnosis: Diagnosis) -> Figure | None:
    """Error of the nominal model, record by channel, in noise deviations: 1 is noise alone."""
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
    scale = colors.LogNorm(1.0, max(10.0, float(np.nanmax(grid))))
    shades = ("#ffffff", "#f6d5c9", NOMINAL_COLOUR, "#6d1a2a")
    colours = colors.LinearSegmentedColormap.from_list("errors", shades, bad="0.92")
    image = axis.imshow(np.maximum(grid, 1.0), norm=scale, cmap=colours, aspect="auto")
    for (i, k), value in np.ndenumerate(grid):
        known = bool(np.isfinite(value))
        colour = "w" if known and scale(max(value, 1.0)) > 0.6 else "0.15"
        axis.text(k, i, deviations(value) if known else "–", ha="center", va="center", color=colour)
    axis.set_xticks(range(len(channels)), [fill(short(spoken(channel)), 12) for channel in channels])
    axis.set_yticks(range(len(records)), [short(record) for record in records])
    axis.set_xticks(np.arange(1, len(channels)) - 0.5, minor=True)
    axis.set_yticks(np.arange(1, len(records)) - 0.5, minor=True)
    axis.grid(False)
    axis.grid(True, which="minor", color="0.75", alpha=1.0, lw=0.8)
    axis.tick_params(which="both", length=0)
    axis.spines[:].set(visible=True, color="0.75")
    left_out = f" ({len(records)} worst of {len(rows)} records)" if len(records) < len(rows) else ""
    axis.set_title(f"error of the nominal model in noise deviations{left_out}", loc="left")
    bar = figure.colorbar(image, ax=axis, label="1: noise alone", pad=0.02)
    label_decades(bar.ax.yaxis)
    bar.outline.set_visible(False)
    return figure
