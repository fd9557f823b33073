"""The branches of a slow full cycle of the current, and both of them at equal output.

Symbols
    i current A, y output; rising, falling: the two branches; mid-line: mean current of both at equal output"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """The branches of a slow cycle: `rising` and `falling` are (current, output), each (n,), output positive with
    current after `polarity` (+1 or -1); `rate` |di/dt| A/s, `amplitude` A common to both ends.
    """  # fmt: skip

    source: str
    rising: tuple[np.ndarray, np.ndarray]
    falling: tuple[np.ndarray, np.ndarray]
    polarity: float
    rate: float
    amplitude: float
    current_resolution: float
    resolution: float | None

    def resolution_at(self, output: float) -> float:
        """The resolution of the output near a value: as stated, else the distance to the next value that occurs."""
        if self.resolution is not None:
            return self.resolution
        return level_spacing(np.concatenate([self.rising[1], self.falling[1]]), output)


def level_spacing(values: np.ndarray, at: float) -> float:
    """The distance between the values that occur near `at`; 0 where hardly any occurs twice: not quantised."""
    grain = 1e-6 * float(np.ptp(values))
    levels = np.unique(np.round(values / grain)) * grain
    if len(np.unique(values)) > 0.5 * len(values):
        return 0.0
    return float(np.sort(np.abs(levels - levels[np.argmin(np.abs(levels - at))]))[1])


@dataclass(frozen=True, kw_only=True)
class Loop:
    """Both branches at equal output: `output` (k,) rising in order, `rising` and `falling` currents (k,), A."""

    output: np.ndarray
    rising: np.ndarray
    falling: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Current of the mid-line (k,), A."""
        return (self.rising + self.falling) / 2.0

    @property
    def width(self) -> np.ndarray:
        """Current of the rising minus that of the falling branch (k,), A."""
        return self.rising - self.falling


def cycle(record: AcceptanceRecord, channel: str, *, resolution: float | None = None) -> Cycle:
    """The branches of a record whose current runs slowly from end to end; all of one direction are put together.

    A quantised current is smoothed over two of its steps; the ends that this bends are left out. A branch counts where
    it spans 80 % of the whole range, alone or together with the others of its direction. InputError without a branch
    each way, with fewer than 50 points in one, or with a current that is clipped or held.
    """
    t, i, y = record.channel("time"), record.channel("current"), record.channel(channel)
    span = float(np.ptp(i))
    if span <= 0.0 or np.ptp(y) <= 0.0:
        raise InputError(f"{record.source}: {'current' if span <= 0.0 else channel} never changes: no cycle")
    turns = _turns(i)
    every = [(a, b) for a, b in zip(turns[:-1], turns[1:], strict=True) if b - a > 1]
    up, down = (_whole([leg for leg in every if side * (i[leg[1] - 1] - i[leg[0]]) > 0.0], i) for side in (1.0, -1.0))
    legs = sorted([*up, *down])
    if not up or not down:
        raise InputError(f"{record.source}: no complete cycle: the current never runs from end to end and back")
    shortest = int(span * min((b - a) / abs(i[b - 1] - i[a]) for a, b in legs))
    if shortest < (least := record.options.least_points):
        raise InputError(
            f"{record.source}: {2 * shortest} points in a period are too few; {2 * least} or more are needed"
        )
    step = _current_resolution(i)
    if step > span / 20.0:
        raise InputError(f"{record.source}: the current is resolved to {step * 1e3:.4g} mA only: too coarse")
    window = 2 * int(step / (span / shortest)) + 1  # samples
    for end in (np.max(i), np.min(i)):
        share = np.mean(np.abs(i - end) <= 1e-9 * span)
        if share > 0.02 + 4.0 * window / shortest:
            raise InputError(
                f"{record.source}: the current is clipped or held at {end * 1e3:.4g} mA for {100 * share:.3g} % "
                "of the time"
            )
    smooth = np.convolve(np.pad(i, window // 2, "edge"), np.full(window, 1.0 / window), "valid")
    trim = window // 2

    def branch(which: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
        inside = np.concatenate([np.arange(a + trim, b - trim) for a, b in which])
        return smooth[inside], y[inside]

    amplitude = float(min(np.max(smooth), -np.min(smooth)))
    if amplitude < 0.1 * span:
        raise InputError(f"{record.source}: no complete cycle: the current is of one polarity")
    rising, falling = branch(up), branch(down)
    polarity = 1.0 if np.dot(rising[0] - rising[0].mean(), rising[1]) >= 0.0 or channel == "internal_leakage" else -1.0
    a, b = legs[0]
    return Cycle(
        source=record.source,
        rising=(rising[0], polarity * rising[1]),
        falling=(falling[0], polarity * falling[1]),
        polarity=polarity,
        rate=float(np.median([abs(i[b - 1] - i[a]) / (t[b - 1] - t[a]) for a, b in legs])),
        amplitude=amplitude,
        current_resolution=step,
        resolution=resolution,
    )


def _whole(legs: list[tuple[int, int]], i: np.ndarray) -> list[tuple[int, int]]:
    """The legs of one direction that run from end to end; where none does, all that do so together.

    A period that begins and ends at null has one of its branches in two parts.
    """
    span, parts = np.ptp(i), [abs(i[b - 1] - i[a]) for a, b in legs]
    if whole := [leg for leg, part in zip(legs, parts, strict=True) if part >= 0.8 * span]:
        return whole
    ends = [(min(i[a], i[b - 1]), max(i[a], i[b - 1])) for a, b in legs]
    low, high = min((e[0] for e in ends), default=0.0), max((e[1] for e in ends), default=0.0)
    return legs if high - low >= 0.8 * span and sum(parts) >= 0.8 * span else []


def _turns(i: np.ndarray) -> list[int]:
    """Where the current turns: the middle of the extreme of each stay in its upper or lower quarter; with both ends."""
    span, middle = np.ptp(i), (np.max(i) + np.min(i)) / 2.0
    side = np.where(i > middle + 0.25 * span, 1, np.where(i < middle - 0.25 * span, -1, 0))
    away = np.flatnonzero(side)
    stays = np.split(away, np.flatnonzero(np.diff(side[away])) + 1)
    turns = []
    for stay in stays:
        inside = slice(stay[0], stay[-1] + 1)
        value = side[stay[0]] * i[inside]
        turns.append(int(stay[0] + np.median(np.flatnonzero(value >= np.max(value) - 1e-9 * span))))
    return sorted({0, *turns, len(i)})


def _current_resolution(i: np.ndarray) -> float:
    """The usual jump of a quantised current, A; 0 for one that changes with every sample."""
    jumps = np.abs(np.diff(i))
    return float(np.median(jumps[jumps > 0.0])) if np.mean(jumps == 0.0) > 0.2 else 0.0


def loop(c: Cycle, *, bins: int = 400) -> Loop:
    """Mean current of each branch at equal output. Where the output is coarser than a bin, a bin holds one level.

    The first and last level of a branch are left out: the turn of the current cuts them short.
    """
    low = max(float(np.min(c.rising[1])), float(np.min(c.falling[1])))
    high = min(float(np.max(c.rising[1])), float(np.max(c.falling[1])))
    width = (high - low) / bins

    def centres(current: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = np.floor(np.round((y - low) / width + 0.5, 2)).astype(int)
        place -= place.min()
        count = np.bincount(place)
        with np.errstate(invalid="ignore"):
            means = np.bincount(place, y) / count, np.bincount(place, current) / count
        return means[0][count > 0][1:-1], means[1][count > 0][1:-1]

    up, down = centres(*c.rising), centres(*c.falling)
    low, high = max(up[0][0], down[0][0]), min(up[0][-1], down[0][-1])
    output = np.sort(np.concatenate([up[0], down[0]]))
    output = output[np.concatenate([[True], np.diff(output) > 1e-3 * width])]
    output = output[(output >= low) & (output <= high)]
    if len(output) < 10:
        raise InputError(f"{c.source}: the output takes {len(output)} values; too coarse for a figure")
    return Loop(output=output, rising=np.interp(output, *up), falling=np.interp(output, *down))
