"""What the readings of a channel tell of its sensor: noise, resolution, saturation and gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.measurement.recording import Recording

FINEST_GRID = 1e-4  # share of a channel's span: a finer grid is the writing of the file, not the sensor
FLAT = 10  # equal readings in a row at an extreme that make a flat top
CROWD = 5.0  # times as many readings at an extreme as at the level beside it; the crest of a rounded sine has 2.4
RAMP = 0.9  # share of moves by one level of the grid that are a ramp's
ARITHMETIC = 1e-12  # share of a channel's largest reading: less scatter is that of arithmetic


@dataclass(frozen=True, kw_only=True)
class ChannelQuality:
    """What was understood of a channel, in its unit of `headings.MEASURED_UNITS`.

    `rate` Hz as it was measured, `readings` how many there are, `missing` how many the rate lets one expect beside
    them, `longest_gap` s, `low` and `high` the extremes, `noise` the standard deviation of what neighbours do not share
    (an upper bound where the channel itself moves from sample to sample), `resolution` 0 where none shows, and
    `saturated` the share of readings in flat tops.
    """

    channel: str
    unit: str
    column: str
    rate: float
    readings: int
    missing: int
    longest_gap: float
    low: float
    high: float
    noise: float
    resolution: float
    saturated: float


def channel_qualities(recording: Recording) -> tuple[ChannelQuality, ...]:
    """What is seen of each channel of a recording."""
    return tuple(_quality(recording, name) for name in recording.values)


def _quality(recording: Recording, name: str) -> ChannelQuality:
    source = recording.sources[name]
    every = max(round((len(recording.time) - 1) / float(recording.time[-1]) / source.rate), 1)
    there = np.flatnonzero(np.isfinite(recording.values[name]))
    own = recording.values[name][there]
    gaps = np.diff(there) if len(there) > 1 else np.array([every])
    expected = int(np.ceil(len(recording.time) / every))
    step, noise = grid_step([own]) if len(own) else 0.0, noise_of(own)
    return ChannelQuality(
        channel=name,
        unit=MEASURED_UNITS[name],
        column=str(source.statement.column),
        rate=source.rate,
        readings=len(own),
        missing=max(expected - len(own), 0),
        longest_gap=float(max(np.max(gaps) - every, 0) * (recording.time[1] - recording.time[0])),
        low=float(np.min(own)) if len(own) else np.nan,
        high=float(np.max(own)) if len(own) else np.nan,
        noise=0.0 if noise <= ARITHMETIC * np.max(np.abs(own), initial=0.0) else noise,
        resolution=step,
        saturated=saturated_share(own),
    )


def noise_of(values: np.ndarray) -> float:
    """The standard deviation of white noise on a smooth channel (n,): of second differences, by their median."""
    if len(values) < 5:
        return np.nan
    bend = np.diff(values, 2)
    return float(1.4826 * np.median(np.abs(bend - np.median(bend))) / np.sqrt(6.0))


def grid_step(readings: Sequence[np.ndarray], finest: float = FINEST_GRID) -> float:
    """The step of the grid on which all readings sit, or 0 where they sit on none that is coarse enough to matter.

    Nor where readings go from each level to the next: a ramp does so, and of a sensor's resolution it tells nothing.
    """
    levels = np.unique(np.concatenate(readings))
    span = levels[-1] - levels[0]
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(levels))]  # equal readings that the conversion of units has parted
    if len(gaps) < 2 or np.min(gaps) < finest * span:
        return 0.0
    step = float(span / np.round(span / np.min(gaps)))  # the smallest gap alone is rounded; the whole span is not
    turns = (levels - levels[0]) / step
    moves = np.concatenate([np.abs(np.diff(one)) for one in readings]) / step
    ramp = np.mean(np.abs(moves - 1.0) < 0.02) > RAMP
    return step if np.max(np.abs(turns - np.round(turns))) < 0.02 and not ramp else 0.0


def saturated_share(values: np.ndarray) -> float:
    """The share of readings (n,) that stand still at an extreme of the channel, `FLAT` in a row or more, and many times
    as many as at the level beside it: the crest of a wave that was rounded is not cut off.
    """
    if len(values) < FLAT or np.ptp(values) == 0.0:
        return 0.0
    flat, levels = np.zeros(len(values), dtype=bool), np.unique(values, return_counts=True)
    for extreme, beside in ((np.min(values), levels[1][1]), (np.max(values), levels[1][-2])):
        if np.count_nonzero(values == extreme) < CROWD * beside:
            continue
        runs = np.flatnonzero(np.diff((values == extreme).astype(int), prepend=0, append=0)).reshape(-1, 2)
        for a, b in runs[np.diff(runs)[:, 0] >= FLAT]:
            flat[a:b] = True
    return float(np.mean(flat))
