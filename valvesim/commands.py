"""Commands over time for current, voltage, temperature and pressure: constant, step, ramp, sine, chirp, pulse, ...

Every command is a row of pieces, so that one formula (`piece_value`) serves numpy and compiled code, and every jump is
known before the integration starts and is never stepped over. In a piece, with tau = t - start,

    value = offset + slope tau + sum over its waves of A sin(2 pi f g(tau) + phase),
    g = tau + (rate/2) tau^2 / f for a linear chirp,  g = (exp(growth tau) - 1)/growth for a logarithmic one.

Times in seconds, values in the unit of what is commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .errors import InputError
from .units import POSITIVE, check_bounds, quantity

PIECE_WIDTH, WAVE_WIDTH = 3, 5  # (start, offset, slope), then (amplitude, frequency, rate, growth, phase) per wave

VALUE = "value"  # the unit of such a figure is that of what is commanded


def piece_value(row, t):
    """(value, rate) of one piece at time t, or times; `row` is a row of `Command.pieces`. Compiled as it stands."""
    tau = t - row[0]
    value, rate = row[1] + row[2] * tau, row[2]
    for k in range(3, row.shape[0], 5):
        amplitude, frequency, sweep, growth, phase = row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4]
        if amplitude != 0.0:
            swelling = 0.0 if growth == 0.0 else np.expm1(growth * tau)
            turns = frequency * tau if growth == 0.0 else frequency * swelling / growth
            angle = 2.0 * np.pi * (turns + 0.5 * sweep * tau * tau) + phase
            value += amplitude * np.sin(angle)
            rate += amplitude * np.cos(angle) * 2.0 * np.pi * (frequency * (1.0 + swelling) + sweep * tau)
    return value, rate


class Command(Protocol):
    """What a command can do. `pieces(end)`: rows (n, 3 + 5 waves) sorted by start, the first at or before zero."""

    def pieces(self, end: float) -> np.ndarray: ...


def evaluate(command: Command, times) -> np.ndarray:
    """Values at `times` (s, any shape); at a jump, the value after it."""
    t = np.asarray(times, dtype=float)
    rows = command.pieces(float(np.max(t, initial=0.0)))
    which = np.clip(np.searchsorted(rows[:, 0], t, side="right") - 1, 0, None)
    if rows.shape[1] == PIECE_WIDTH:
        return rows[which, 1] + rows[which, 2] * (t - rows[which, 0])
    piece, point, values = which.ravel(), t.ravel(), np.empty(t.size)
    order = np.argsort(piece, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(piece[order], prepend=-1)))[1:]:  # the points of one piece
        values[group] = piece_value(rows[piece[group[0]]], point[group])[0]
    return values.reshape(t.shape)


def largest(command: Command, end: float) -> float:
    """An upper bound of |value| over 0..end."""
    rows = command.pieces(end)
    first, stop = np.maximum(rows[:, 0], 0.0), np.append(rows[1:, 0], np.inf)
    ruling = (first < stop) & (first <= end)
    rows, ends = rows[ruling], np.column_stack([first, np.minimum(stop, end)])[ruling]
    lines = np.abs(rows[:, 1:2] + rows[:, 2:3] * (ends - rows[:, :1])).max(axis=1)
    return float(np.max(lines + np.abs(rows[:, PIECE_WIDTH::WAVE_WIDTH]).sum(axis=1)))


def _wave(amplitude: float, frequency: float, rate: float, growth: float, phase: float) -> list[float]:
    return [amplitude, frequency, rate, growth, phase]


@dataclass(frozen=True, kw_only=True)
class Constant:
    """One value throughout."""

    value: float = quantity(0.0, VALUE, "value", (-np.inf, np.inf), "")

    def __post_init__(self):
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        return np.array([[0.0, self.value, 0.0]])


@dataclass(frozen=True, kw_only=True)
class Step:
    """`before` until `time`, then `after`."""

    before: float = quantity(0.0, VALUE, "value before", (-np.inf, np.inf), "")
    after: float = quantity(0.0, VALUE, "value after", (-np.inf, np.inf), "")
    time: float = quantity(0.0, "s", "time of the jump", (0.0, np.inf), "")

    def __post_init__(self):
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        return np.array([[0.0, self.before, 0.0], [self.time, self.after, 0.0]])


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """From `start_value` at `time` to `end_value` at `rate` (its sign follows from the two), then held."""

    start_value: float = quantity(0.0, VALUE, "value before", (-np.inf, np.inf), "")
    end_value: float = quantity(0.0, VALUE, "value after", (-np.inf, np.inf), "")
    rate: float = quantity(1.0, VALUE + "/s", "size of the slope", (POSITIVE, np.inf), "")
    time: float = quantity(0.0, "s", "time of the start", (0.0, np.inf), "")

    def __post_init__(self):
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        change = self.end_value - self.start_value
        slope, stop = np.sign(change) * self.rate, self.time + abs(change) / self.rate
        rows = [[0.0, self.start_value, 0.0], [self.time, self.start_value, slope], [stop, self.end_value, 0.0]]
        return np.array(rows)


@dataclass(frozen=True, kw_only=True)
class Sine:
    """amplitude sin(2 pi frequency (t - time) + phase) from `time` on, `offset` throughout."""

    amplitude: float = quantity(0.0, VALUE + "_difference", "amplitude", (-np.inf, np.inf), "")
    frequency: float = quantity(1.0, "Hz", "frequency", (POSITIVE, 1e5), "")
    phase: float = quantity(0.0, "rad", "phase", (-np.inf, np.inf), "")
    offset: float = quantity(0.0, VALUE, "mean", (-np.inf, np.inf), "")
    time: float = quantity(0.0, "s", "time of the start", (0.0, np.inf), "")

    def __post_init__(self):
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        still = [0.0, self.offset, 0.0, *_wave(0.0, self.frequency, 0.0, 0.0, 0.0)]
        wave = _wave(self.amplitude, self.frequency, 0.0, 0.0, self.phase)
        return np.array([still, [self.time, self.offset, 0.0, *wave]])


@dataclass(frozen=True, kw_only=True)
class Chirp:
    """A sine whose frequency runs from `start_frequency` to `end_frequency` within `duration`, evenly or by octaves.

    `spacing` is `Chirp.LINEAR` or `Chirp.LOGARITHMIC`; after `duration` the mean is held.
    """

    amplitude: float = quantity(0.0, VALUE + "_difference", "amplitude", (-np.inf, np.inf), "")
    start_frequency: float = quantity(1.0, "Hz", "first frequency", (POSITIVE, 1e5), "")
    end_frequency: float = quantity(500.0, "Hz", "last frequency", (POSITIVE, 1e5), "")
    duration: float = quantity(1.0, "s", "duration", (POSITIVE, np.inf), "")
    offset: float = quantity(0.0, VALUE, "mean", (-np.inf, np.inf), "")
    time: float = quantity(0.0, "s", "time of the start", (0.0, np.inf), "")
    logarithmic: bool = field(default=False, metadata={"doc": "even in octaves instead of in hertz"})

    def __post_init__(self):
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        still = _wave(0.0, 1.0, 0.0, 0.0, 0.0)
        ratio = self.end_frequency / self.start_frequency
        rate, growth = (self.end_frequency - self.start_frequency) / self.duration, 0.0
        if self.logarithmic:
            rate, growth = 0.0, np.log(ratio) / self.duration
        wave = _wave(self.amplitude, self.start_frequency, rate, growth, 0.0)
        return np.array(
            [
                [0.0, self.offset, 0.0, *still],
                [self.time, self.offset, 0.0, *wave],
                [self.time + self.duration, self.offset, 0.0, *still],
            ]
        )


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """`height` for `width` seconds from `time` on, `base` otherwise; repeated every `period` where that is given."""

    base: float = quantity(0.0, VALUE, "value otherwise", (-np.inf, np.inf), "")
    height: float = quantity(0.0, VALUE, "value in the pulse", (-np.inf, np.inf), "")
    width: float = quantity(1e-3, "s", "duration", (POSITIVE, np.inf), "")
    time: float = quantity(0.0, "s", "time of the first", (0.0, np.inf), "")
    period: float = quantity(np.inf, "s", "from pulse to pulse", (POSITIVE, np.inf), "")

    def __post_init__(self):
        check_bounds(self)
        if self.period <= self.width:
            raise InputError(f"pulse.period = {self.period:g} s must be longer than pulse.width = {self.width:g} s")

    def pieces(self, end: float) -> np.ndarray:
        count = 1 if np.isinf(self.period) else max(int(np.ceil((end - self.time) / self.period)) + 1, 1)
        rows = [[0.0, self.base, 0.0]]
        for k in range(count):
            start = self.time + (k * self.period if k else 0.0)
            stop = min(start + self.width, self.time + (k + 1) * self.period)  # rounding never mixes their order
            rows += [[start, self.height, 0.0], [stop, self.base, 0.0]]
        return np.array(rows)


@dataclass(frozen=True, kw_only=True)
class Staircase:
    """From `start_value` to `end_value` in `steps` equal jumps, each level held for `hold` seconds."""

    start_value: float = quantity(0.0, VALUE, "first level", (-np.inf, np.inf), "")
    end_value: float = quantity(0.0, VALUE, "last level", (-np.inf, np.inf), "")
    steps: float = quantity(10.0, "1", "number of jumps", (1.0, 1e6), "")
    hold: float = quantity(0.1, "s", "duration of a level", (POSITIVE, np.inf), "")

    def __post_init__(self):
        check_bounds(self)
        if self.steps != int(self.steps):
            raise InputError(f"staircase.steps = {self.steps:g} must be a whole number in [1, 1e+06]")

    def pieces(self, end: float) -> np.ndarray:
        levels = np.linspace(self.start_value, self.end_value, int(self.steps) + 1)
        return np.column_stack([np.arange(len(levels)) * self.hold, levels, np.zeros(len(levels))])


@dataclass(frozen=True, kw_only=True)
class Table:
    """Straight lines between given points, held at its first and last value; two points at one time make no jump here.

    Raises InputError for fewer than two points, lengths that differ, NaN, or times that do not rise.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    where: str = "table"

    def __post_init__(self):
        t, y = np.asarray(self.times, dtype=float), np.asarray(self.values, dtype=float)
        if t.shape != y.shape or t.ndim != 1 or len(t) < 2:
            raise InputError(f"{self.where}: needs two or more points, with as many times as values")
        bad = ~(np.isfinite(t) & np.isfinite(y))
        if bad.any():
            raise InputError(f"{self.where}: row {int(np.argmax(bad)) + 1} of the data is not a number")
        falls = np.diff(t) <= 0.0
        if falls.any():
            k = int(np.argmax(falls)) + 1
            what = "repeats" if t[k] == t[k - 1] else "is before"
            raise InputError(
                f"{self.where}: times must rise, but row {k + 1} ({t[k]:.6g} s) {what} row {k} ({t[k - 1]:.6g} s)"
            )

    def pieces(self, end: float) -> np.ndarray:
        t, y = np.asarray(self.times, dtype=float), np.asarray(self.values, dtype=float)
        rows = np.column_stack([t, y, np.append(np.diff(y) / np.diff(t), 0.0)])
        return np.vstack([[min(t[0], 0.0), y[0], 0.0], rows])  # what holds before the first point


@dataclass(frozen=True)
class Sum:
    """The sum of commands, such as a bias with a sine."""

    terms: tuple[Command, ...]

    def pieces(self, end: float) -> np.ndarray:
        return merge(self.terms, float(np.nextafter(end, np.inf)))[1].sum_of_inputs()  # a jump at `end` is in


@dataclass(frozen=True)
class Intervals:
    """Rows (interval, input, width) of several commands between the joint break times; see `merge`."""

    starts: np.ndarray
    rows: np.ndarray

    def sum_of_inputs(self) -> np.ndarray:
        """One row an interval: straight parts added (moved to the interval's start), waves side by side."""
        n, inputs, _ = self.rows.shape
        lines = self.rows[:, :, 1] + self.rows[:, :, 2] * (self.starts[:, None] - self.rows[:, :, 0])
        waves = self.rows[:, :, PIECE_WIDTH:].reshape(n, inputs, -1, WAVE_WIDTH).copy()
        late = (self.starts[:, None] - self.rows[:, :, 0])[:, :, None]  # a wave goes on from where it is
        frequency, sweep, growth, phase = (waves[..., k] for k in (1, 2, 3, 4))
        with np.errstate(divide="ignore", invalid="ignore"):
            turns = np.where(growth == 0.0, frequency * late, frequency * np.expm1(growth * late) / growth)
        waves[..., 4] = phase + 2 * np.pi * (turns + 0.5 * sweep * late**2)
        waves[..., 1] = frequency * np.exp(growth * late) + sweep * late
        return np.column_stack([self.starts, lines.sum(1), self.rows[:, :, 2].sum(1), waves.reshape(n, -1)])


def merge(commands: Sequence[Command], end: float) -> tuple[np.ndarray, Intervals]:
    """All commands on the union of their breaks before `end`: starts, and rows (interval, input, width)."""
    pieces = [c.pieces(end) for c in commands]
    starts = np.unique(np.concatenate([p[:, 0] for p in pieces]))
    starts = np.unique(np.concatenate([[0.0], starts[(starts > 0.0) & (starts < end)]]))
    width = max(p.shape[1] for p in pieces)
    rows = np.zeros((len(starts), len(pieces), width))
    for k, p in enumerate(pieces):
        which = np.clip(np.searchsorted(p[:, 0], starts, side="right") - 1, 0, None)
        rows[:, k, : p.shape[1]] = p[which]
    return starts, Intervals(starts, rows)


def read_table(path: Path, column: str, unit: str) -> Table:
    """A table from a CSV file with a header of names and units, `time [s], <column> [unit]`.

    Raises InputError (with file and line) for a missing file, a missing or unitless column, gaps and bad numbers.
    """
    from .files import read_columns

    columns = read_columns(path, {"time": "s", column: unit})
    return Table(times=tuple(columns["time"]), values=tuple(columns[column]), where=str(path))


COMMANDS: dict[str, Any] = {
    "constant": Constant, "step": Step, "ramp": Ramp, "sine": Sine, "chirp": Chirp, "pulse": Pulse,
    "staircase": Staircase,
}  # fmt: skip
"""Commands by the name that a scenario file uses; `table` is read with `read_table`."""
