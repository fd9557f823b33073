"""Picture of a measured record: every channel over time, with its gaps and flat tops marked."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.reports.chart import Chart, Charts, Series
from valvesim.reports.html_page import Bullets, section, write_html
from valvesim.reports.plotting import COLOURS, MEASURED_COLOUR, Figure, draw_line, styled, time_unit, write_picture
from valvesim.reports.title_block import TitleBlock
from valvesim.units import DISPLAY, symbol

if TYPE_CHECKING:
    from valvesim.measurement.quality import ChannelQuality
    from valvesim.measurement.recording import Recording

ROW_HEIGHT = 1.25  # inch
LARGEST_READING = 1e30  # of a reading that an axis can show
MOST_GAPS = 200  # that are shaded one by one


def picture_recording(
    recording: Recording, qualities: Sequence[ChannelQuality], date: datetime.date, path: Path
) -> Path:
    """Write the picture of a recording; its path."""
    block = TitleBlock(title=", ".join(one.name for one in recording.paths), valve="measured", date=date)
    return write_picture(draw_recording(recording, qualities), block, path)


def page_recordings(recordings: Sequence[Recording], date: datetime.date, path: Path) -> Path:
    """Write the page of records, each channel of all of them beside each other with one zoom; its path."""
    names = [", ".join(one.name for one in recording.paths) for recording in recordings]
    block = TitleBlock(title=" and ".join(names), valve="as recorded", date=date)
    sections = []
    for channel in dict.fromkeys(name for recording in recordings for name in recording.values):
        charts = []
        for name, recording in zip(names, recordings, strict=True):
            if channel in recording.values:
                unit, factor = DISPLAY.get(MEASURED_UNITS[channel], (MEASURED_UNITS[channel], 1.0))
                text, values = channel.replace("_", " "), recording.values[channel] * factor
                apart = np.diff(np.flatnonzero(np.isfinite(values)))  # more than one: a slower channel, not a gap
                line = Series(text, symbol(unit), values, joined=len(apart) > 0 and float(np.median(apart)) > 1.0)
                label = f"{text} [{symbol(unit)}]"
                charts.append(Chart(f"{text}, {name}", recording.time, [line], y_label=label, group="records"))
        heading = channel.replace("_", " ").capitalize()
        sections.append(section(heading, Charts(charts, beside=len(recordings) > 1)))
    named = list(zip(names, recordings, strict=True))
    notes = [note if note.startswith(name) else f"{name}: {note}"
             for name, one in named for note in (*one.forms, *one.notes)]  # fmt: skip
    left_out = [f"{name}: no channel {', '.join(one.left_out)}" for name, one in named if one.left_out]
    return write_html(path, block, (*sections, section("Notes", Bullets([*notes, *left_out]))))


@styled
def draw_recording(recording: Recording, qualities: Sequence[ChannelQuality]) -> Figure:
    """One row a channel, over time; what is missing is shaded."""
    figure = Figure(figsize=(9.0, 0.7 + ROW_HEIGHT * len(qualities)), layout="constrained")
    axes = figure.subplots(len(qualities), 1, sharex=True, squeeze=False)[:, 0]
    unit, factor = time_unit(float(recording.time[-1]))
    for k, (axis, one) in enumerate(zip(axes, qualities, strict=True)):
        _draw_channel(axis, recording, one, factor, COLOURS[k % len(COLOURS)])
    axes[-1].set_xlabel(f"time [{unit}]")
    return figure


def _draw_channel(axis: Any, recording: Recording, one: ChannelQuality, factor: float, colour: str) -> None:
    unit, by = DISPLAY.get(one.unit, (one.unit, 1.0))
    values = recording.values[one.channel] * by
    there = np.flatnonzero(np.isfinite(values))
    time = recording.time * factor
    step = max(round((len(time) - 1) / float(recording.time[-1]) / one.rate), 1)
    apart = np.flatnonzero(np.diff(there) > 1.5 * step)[:MOST_GAPS]
    drawable = len(there) and float(np.max(np.abs(values[there]))) < LARGEST_READING
    if not drawable:
        axis.text(0.5, 0.5, "no reading that can be drawn", transform=axis.transAxes, ha="center", va="center")
    for piece in np.split(there, apart + 1) if drawable else ():
        if len(piece):
            draw_line(axis, time[piece], values[piece], colour=colour, label=one.channel)
    for k in apart:
        axis.axvspan(time[there[k]], time[there[k + 1]], color=MEASURED_COLOUR, alpha=0.25, lw=0)
    told = [f"{one.rate:.4g} Hz", f"noise {one.noise * by:.2g}"]
    told += [f"resolution {one.resolution * by:.2g}"] if one.resolution else []
    told += [f"{one.missing} missing (shaded)"] if one.missing else []
    told += [f"{one.saturated:.1%} saturated"] if one.saturated else []
    axis.set_title(f"{one.channel.replace('_', ' ')} [{symbol(unit)}]: {', '.join(told)}", loc="left", fontsize=8)
