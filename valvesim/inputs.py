"""Commands over time for current, voltage, temperature and pressure: constant, step, ramp, sine, chirp, pulse, ...

Every command is a row of pieces, so that one formula (`piece_value`) serves numpy and compiled code, and every jump is
known before the integration starts and is never stepped over. In a piece, with tau = t - start,

    value = offset + slope tau + square tau^2 + cube tau^3 + sum over its waves of A sin(2 pi f g(tau) + phase),
    g = tau + (rate/2) tau^2 / f for a linear chirp,  g = (exp(growth tau) - 1)/growth for a logarithmic one.

Times in seconds, values in the unit of what is commanded. Levels are absolute; amplitudes, heights and rates are
differences. What a command reaches within a run is told by its pieces (`extremes`), never by samples.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.units import POSITIVE, check_bounds, has_unit, in_si, quantities, quantity

MOST_PIECES = 1_000_000  # of a command within a run: with all that is made of them some 300 MB
PIECE_WIDTH = 5  # (start, offset, slope, square, cube), then for each wave
WAVE_WIDTH = 5  # (amplitude, frequency, rate, growth, phase)

VALUE = "value"  # the unit of such a figure is that of what is commanded
COMMANDED = ("A", "V", "Pa", "degC")  # what a command may be of: current, voltage, pressure, temperature


def unit_of_figure(declared: str, unit: str) -> str:
    """The unit of a figure of a command, where `unit` is that of what is commanded."""
    difference = "delta_degC" if unit == "degC" else unit
    return {VALUE: unit, f"{VALUE}_difference": difference, f"{VALUE}/s": f"{difference}/s"}.get(declared, declared)


def read_levels(command: Any) -> None:
    """Levels that are text with a unit, or quantities, become numbers in SI; the command keeps the unit as `unit`.

    Raises InputError for what is no current, voltage, pressure or temperature, or for two of them in one command.
    """
    for name, declared in quantities(command).items():
        given, unit = getattr(command, name), declared.metadata["unit"]
        if unit.startswith(VALUE) and has_unit(given):
            key = f"{type(command).__name__.lower()}.{name}"
            object.__setattr__(command, name, _read_level(command, given, unit, key))


def _read_level(command: Any, given: Any, declared: str, key: str, *, several: bool = False) -> Any:
    """A level in SI; `command.unit` is what its other levels were given in, or "" so far."""
    own = getattr(command, "unit", "")
    for unit in (own,) if own else COMMANDED:
        try:
            value = in_si(given, unit_of_figure(declared, unit), key, several=several)
        except InputError:
            if own or unit == COMMANDED[-1]:
                what = f"in {own!r} as its other levels" if own else "a current, voltage, pressure or temperature"
                raise InputError(f"{str(given)!r} is not {what}", key=key, joint=" = ") from None
            continue
        object.__setattr__(command, "unit", unit)
        return value
    return given


def as_command(given: Any, unit: str, where: str) -> Command:
    """A command as it is; a number, text with a unit or a quantity as a constant one, in `unit`.

    Raises InputError for a command whose levels were given in another unit, and for what is no command.
    """
    if isinstance(given, (int, float, str, np.number)) and not isinstance(given, bool) or has_unit(given):
        value = in_si(given, unit, where)
        if np.ndim(value):
            raise InputError("several values; give a command over time, such as Table or Staircase", key=where)
        return Constant(value=float(value))
    if not hasattr(given, "pieces"):
        raise InputError(f"expected a command, a number or text with a unit, got {given!r}", key=where)
    for one in (given, *getattr(given, "terms", ())):
        own = getattr(one, "unit", "")
        if own not in ("", unit):
            raise InputError(f"{type(one).__name__} is given in {own!r}; {unit!r} is expected", key=where)
    return given


def piece_value(row, t):
    """(value, rate) of one piece at time t, or times; `row` is a row of `Command.pieces`."""
    value, rate, _ = piece_motion(row, t)
    return value, rate


def piece_motion(row, t):
    """(value, rate, rate of the rate) of one piece at time t, or times. Compiled as it stands."""
    tau = t - row[0]
    value = row[1] + tau * (row[2] + tau * (row[3] + tau * row[4]))
    rate = row[2] + tau * (2.0 * row[3] + tau * 3.0 * row[4])
    bend = 2.0 * row[3] + tau * 6.0 * row[4]
    for k in range(5, row.shape[0], 5):
        amplitude, frequency, sweep, growth, phase = row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4]
        if amplitude != 0.0:
            swelling = 0.0 if growth == 0.0 else np.expm1(growth * tau)
            turns = frequency * tau if growth == 0.0 else frequency * swelling / growth
            angle = 2.0 * np.pi * (turns + 0.5 * sweep * tau * tau) + phase
            speed = 2.0 * np.pi * (frequency * (1.0 + swelling) + sweep * tau)
            sine, cosine = amplitude * np.sin(angle), amplitude * np.cos(angle)
            value += sine
            rate += cosine * speed
            quickening = 2.0 * np.pi * (frequency * growth * (1.0 + swelling) + sweep)
            bend += cosine * quickening - sine * speed * speed
    return value, rate, bend


def polynomial(rows: np.ndarray, tau: Any) -> Any:
    """Values of pieces (n, width) without their waves, each at a time after its start, (n,)."""
    return rows[:, 1] + tau * (rows[:, 2] + tau * (rows[:, 3] + tau * rows[:, 4]))


def moved_to(rows: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """The polynomials of pieces (n, width), each from another start on, (n, 5): the same functions of time."""
    tau, (_, _, slope, square, cube) = starts - rows[:, 0], rows[:, :PIECE_WIDTH].T
    rate, bend = slope + tau * (2.0 * square + tau * 3.0 * cube), square + tau * 3.0 * cube
    return np.column_stack([starts, polynomial(rows, tau), rate, bend, cube])


def pieces_at(rows: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The index of the piece that rules at each time, any shape; before the first, the first."""
    return np.clip(np.searchsorted(rows[:, 0], times, side="right") - 1, 0, None)


def lines(start: Any, offset: Any, slope: Any = 0.0) -> np.ndarray:
    """Rows of `Command.pieces` (n, 5) that go straight: of starts, offsets and slopes, (n,) or one for all."""
    rows = np.zeros((np.broadcast(start, offset, slope).size, PIECE_WIDTH))
    rows[:, 0], rows[:, 1], rows[:, 2] = start, offset, slope
    return rows


def straight_pieces(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Rows of `Command.pieces` of straight lines between points (n,), held at the first and the last value."""
    before = lines(min(t[0], 0.0), y[0])  # what holds before the first point
    return np.vstack([before, lines(t, y, np.append(np.diff(y) / np.diff(t), 0.0))])


class Command(Protocol):
    """What a command can do. `pieces(end)`: rows (n, 5 + 5 waves) sorted by start, the first at or before zero."""

    def pieces(self, end: float) -> np.ndarray: ...


def pieces_of(command: Command, end: float) -> np.ndarray:
    """The rows of a command's pieces. Raises InputError for rows of another width, as a command of one's own may give.
    """
    rows = command.pieces(end)
    if rows.ndim != 2 or rows.shape[1] < PIECE_WIDTH or (rows.shape[1] - PIECE_WIDTH) % WAVE_WIDTH:
        raise InputError(
            f"pieces of shape {rows.shape}; each is a row of {PIECE_WIDTH} numbers (start, offset, slope, square, "
            f"cube) and {WAVE_WIDTH} for each wave, see `inputs.lines`",
            key=type(command).__name__.lower(),
        )
    return rows


def evaluate(command: Command, times) -> np.ndarray:
    """Values at `times` (s, any shape); at a jump, the value after it."""
    t = np.asarray(times, dtype=float)
    if isinstance(command, Sum):
        return np.sum([evaluate(term, t) for term in command.terms], axis=0)
    rows = pieces_of(command, float(np.max(t, initial=0.0)))
    which = pieces_at(rows, t)
    piece, point, values = which.ravel(), t.ravel(), np.empty(t.size)
    if rows.shape[1] == PIECE_WIDTH:
        if not rows[:, 3:].any():
            return rows[which, 1] + rows[which, 2] * (t - rows[which, 0])
        ruling = rows[piece]
        return polynomial(ruling, point - ruling[:, 0]).reshape(t.shape)
    order = np.argsort(piece, kind="stable")
    for group in np.split(order, np.flatnonzero(np.diff(piece[order], prepend=-1)))[1:]:  # the points of one piece
        values[group] = piece_value(rows[piece[group[0]]], point[group])[0]
    return values.reshape(t.shape)


@dataclass(frozen=True)
class Extremes:
    """The least and the greatest value of a command, and when (s) each is reached."""

    lowest: float
    lowest_at: float
    highest: float
    highest_at: float


def extremes(command: Command, end: float) -> Extremes:
    """What a command reaches over 0..end, values just before a jump included: bounds that nothing exceeds.

    Exact for pieces without waves. Waves are bounded by bisection of time: to 1e-10 of their size where each piece has
    one (or several of one frequency), and nearly always where they differ; after `MOST_BOUNDED` intervals the bound
    that stands is given, which is safe but may be wide.
    """
    rows = pieces_of(command, end)
    first, stop = np.maximum(rows[:, 0], 0.0), np.append(rows[1:, 0], np.inf)
    ruling = (first < stop) & (first <= end)
    rows, begin, until = rows[ruling], first[ruling], np.minimum(stop, end)[ruling]
    if not rows[:, PIECE_WIDTH::WAVE_WIDTH].any():  # at the ends of a piece, or where a cubic turns
        times = np.array([begin, until, *_turning_points(rows, begin, until)])
        values = np.array([polynomial(rows, at - rows[:, 0]) for at in times])
        times, values = times.ravel(), values.ravel()
        least, most = int(np.argmin(values)), int(np.argmax(values))
        return Extremes(float(values[least]), float(times[least]), float(values[most]), float(times[most]))
    high, high_at = _highest(rows, begin, until)
    low, low_at = _highest(_scaled(rows, -1.0), begin, until)
    return Extremes(-low, low_at, high, high_at)


def _turning_points(rows: np.ndarray, begin: np.ndarray, until: np.ndarray) -> np.ndarray:
    """Where the cubics of pieces (n, width) turn between `begin` and `until`, (2, n) in s; elsewhere `begin`. None of
    straight ones, (0, n).
    """
    if not rows[:, 3:PIECE_WIDTH].any():
        return np.zeros((0, len(rows)))
    slope, square, cube = rows[:, 2], rows[:, 3], rows[:, 4]
    with np.errstate(all="ignore"):
        q = -(square + np.copysign(np.sqrt(square**2 - 3.0 * cube * slope), square))  # of no cancellation
        tau = np.array([q / (3.0 * cube), slope / q])
        at = rows[:, 0] + tau
        return np.where((at > begin) & (at < until), at, begin)


def _scaled(rows: np.ndarray, factor: float) -> np.ndarray:
    """Pieces times a factor."""
    rows = np.array(rows, dtype=float)
    rows[:, 1:PIECE_WIDTH] *= factor
    rows[:, PIECE_WIDTH::WAVE_WIDTH] *= factor
    return rows


def largest(command: Command, end: float) -> float:
    """The greatest |value| over 0..end, as `extremes` has it."""
    reach = extremes(command, end)
    return max(abs(reach.lowest), abs(reach.highest))


def turns(rows: np.ndarray, end: float) -> float:
    """How many periods the waves of some pieces pass through until `end`."""
    stop = np.minimum(np.append(rows[1:, 0], np.inf), end)
    waves, length = rows[:, PIECE_WIDTH:].reshape(len(rows), -1, WAVE_WIDTH), np.maximum(stop - rows[:, 0], 0.0)
    amplitude, frequency, sweep, growth, _ = (waves[:, :, k] for k in range(WAVE_WIDTH))
    tau = length[:, None]
    with np.errstate(all="ignore"):
        swept = np.where(growth == 0.0, frequency * tau, frequency * np.expm1(growth * tau) / growth)
        return float(np.sum(np.abs(swept + 0.5 * sweep * tau**2), where=amplitude != 0.0))


def _highest(rows: np.ndarray, begin: np.ndarray, until: np.ndarray) -> tuple[float, float]:
    """(upper bound, when) of pieces that rule from `begin` to `until`."""
    cubics, waves = rows[:, :PIECE_WIDTH], _joined(rows[:, PIECE_WIDTH:].reshape(len(rows), -1, WAVE_WIDTH))
    with np.errstate(all="ignore"):
        best, at, upper = _bounds(cubics, waves, begin, until)
        size = float(np.max(np.abs(upper))) if len(upper) else 0.0
        close, told, spent = 1e-10 * size, best, 0
        piece = np.arange(len(rows))
        while True:
            told = max(told, float(np.max(upper, initial=-np.inf, where=upper <= best + close)))
            left = ~(upper <= best + close)  # NaN is left
            piece, begin, until, upper = piece[left], begin[left], until[left], upper[left]
            if not len(piece) or spent > MOST_BOUNDED:
                break
            pick = np.argsort(-upper)[:256]  # the most promising are halved
            rest = np.ones(len(piece), dtype=bool)
            rest[pick] = False
            middle = 0.5 * (begin[pick] + until[pick])
            which, low, high = np.tile(piece[pick], 2), np.append(begin[pick], middle), np.append(middle, until[pick])
            reached, when, bound = _bounds(cubics[which], waves[which], low, high)
            if reached > best:
                best, at = reached, when
            spent += len(which)
            piece, upper = np.append(piece[rest], which), np.append(upper[rest], bound)
            begin, until = np.append(begin[rest], low), np.append(until[rest], high)
        told = max(told, best, float(np.max(upper, initial=-np.inf)))
    return told, at


MOST_BOUNDED = 40_000  # intervals, before `extremes` takes the bound that it has


def _joined(waves: np.ndarray) -> np.ndarray:
    """Waves (n, k, 5) with those of one frequency added up in the first of them, and columns of none left out."""
    waves = waves.copy()
    for j in range(waves.shape[1] - 1, 0, -1):
        for i in range(j):
            one, other = waves[:, i], waves[:, j]
            same = (one[:, 1:4] == other[:, 1:4]).all(axis=1) & (other[:, 0] != 0.0) & (one[:, 0] != 0.0)
            both = one[same, 0] * np.exp(1j * one[same, 4]) + other[same, 0] * np.exp(1j * other[same, 4])
            waves[same, i, 0], waves[same, i, 4], waves[same, j, 0] = np.abs(both), np.angle(both), 0.0
    return waves[:, (waves[:, :, 0] != 0.0).any(axis=0)]


def _bounds(cubics: np.ndarray, waves: np.ndarray, begin: np.ndarray, until: np.ndarray) -> tuple[float, float, Any]:
    """(greatest value seen, when, upper bound (n,) of each) of pieces (n, 5) with waves (n, k, 5) in begin..until.

    The bound is the lesser of two: every term at its own greatest, and a parabola about the middle that bends as much
    as the cubic and every wave can.
    """
    start, _, slope, square, cube = cubics.T
    amplitude, frequency, sweep, growth, phase = (waves[:, :, k] for k in range(WAVE_WIDTH))

    def angle(t):
        tau = (t - start)[:, None]
        turns = np.where(growth == 0.0, frequency * tau, frequency * np.expm1(growth * tau) / growth)
        return 2.0 * np.pi * (turns + 0.5 * sweep * tau**2) + phase

    def speed(t):
        tau = (t - start)[:, None]
        return 2.0 * np.pi * (frequency * np.exp(growth * tau) + sweep * tau)

    def cubic(t):
        return polynomial(cubics, t - start)

    def value(t):
        return cubic(t) + (amplitude * np.sin(angle(t))).sum(axis=1)

    middle, half = 0.5 * (begin + until), 0.5 * (until - begin)
    first, last, slow, fast = angle(begin), angle(until), speed(begin), speed(until)
    crest = np.where(amplitude < 0.0, -0.5 * np.pi, 0.5 * np.pi)
    after = crest + 2.0 * np.pi * np.ceil((first - crest) / (2.0 * np.pi))
    before = crest + 2.0 * np.pi * np.floor((last - crest) / (2.0 * np.pi))
    rising = (slow > 0.0) & (fast > 0.0)
    ends = np.maximum(amplitude * np.sin(first), amplitude * np.sin(last))
    tops = np.where(rising & (after > last), ends, np.abs(amplitude))
    curvature = np.maximum(*(np.abs(2.0 * square + 6.0 * cube * (t - start)) for t in (begin, until)))
    arch = 0.5 * curvature * half**2  # a cubic is above the line between its ends by no more
    apart = np.maximum(cubic(begin), cubic(until)) + arch + tops.sum(axis=1)
    here, tau = value(middle), middle - start
    swing = amplitude * np.cos(angle(middle)) * speed(middle)
    rate = slope + tau * (2.0 * square + 3.0 * cube * tau) + swing.sum(axis=1)
    bend = np.maximum(slow**2, fast**2) + np.maximum(
        *(np.abs(2.0 * np.pi * (sweep + growth * frequency * np.exp(growth * (t - start)[:, None])))
          for t in (begin, until))
    )  # fmt: skip
    together = here + np.abs(rate) * half + arch + 0.5 * (np.abs(amplitude) * bend).sum(axis=1) * half**2
    upper = np.where(np.isfinite(together), np.minimum(apart, together), apart)
    seen = [(begin, value(begin)), (until, value(until)), (middle, here)]
    for k in range(min(waves.shape[1], 4)):
        for target in (after[:, k], before[:, k]):  # the first and the last crest of a wave
            turns = (target - phase[:, k]) / (2.0 * np.pi)
            f, s, g = frequency[:, k], sweep[:, k], growth[:, k]
            tau = np.where(g == 0.0, 2.0 * turns / (f + np.sqrt(f**2 + 2.0 * s * turns)), np.log1p(g * turns / f) / g)
            t = np.where(np.isfinite(tau), np.clip(start + tau, begin, until), begin)
            seen.append((t, value(t)))
    times, values = np.array([t for t, _ in seen]), np.array([v for _, v in seen])
    values = np.where(np.isnan(values), -np.inf, values)
    where = np.unravel_index(int(np.argmax(values)), values.shape)
    return float(values[where]), float(times[where]), np.maximum(upper, values.max(axis=0))


def _wave(amplitude: float, frequency: float, rate: float, growth: float, phase: float) -> list[float]:
    return [amplitude, frequency, rate, growth, phase]


@dataclass(frozen=True, kw_only=True)
class Constant:
    """One value throughout."""

    value: float = quantity(0.0, VALUE, "value", (-np.inf, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        return lines(0.0, self.value)


@dataclass(frozen=True, kw_only=True)
class Step:
    """`before` until `time`, then `after`."""

    before: float = quantity(0.0, VALUE, "value before", (-np.inf, np.inf), "")
    after: float = quantity(0.0, VALUE, "value after", (-np.inf, np.inf), "")
    time: float = quantity(0.0, "s", "time of the jump", (0.0, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        return lines([0.0, self.time], [self.before, self.after])


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """From `start_value` at `time` to `end_value` at `rate` (its sign follows from the two), then held."""

    start_value: float = quantity(0.0, VALUE, "value before", (-np.inf, np.inf), "")
    end_value: float = quantity(0.0, VALUE, "value after", (-np.inf, np.inf), "")
    rate: float = quantity(1.0, VALUE + "/s", "size of the slope", (POSITIVE, np.inf), "")
    time: float = quantity(0.0, "s", "time of the start", (0.0, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        change = self.end_value - self.start_value
        slope, stop = np.sign(change) * self.rate, self.time + abs(change) / self.rate
        return lines([0.0, self.time, stop], [self.start_value, self.start_value, self.end_value], [0.0, slope, 0.0])


@dataclass(frozen=True, kw_only=True)
class Sine:
    """amplitude sin(2 pi frequency (t - time) + phase) from `time` on, `offset` throughout."""

    amplitude: float = quantity(0.0, VALUE + "_difference", "amplitude", (-np.inf, np.inf), "")
    frequency: float = quantity(1.0, "Hz", "frequency", (POSITIVE, 1e5), "")
    phase: float = quantity(0.0, "rad", "phase", (-np.inf, np.inf), "")
    offset: float = quantity(0.0, VALUE, "mean", (-np.inf, np.inf), "")
    time: float = quantity(0.0, "s", "time of the start", (0.0, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        still = _wave(0.0, self.frequency, 0.0, 0.0, 0.0)
        wave = _wave(self.amplitude, self.frequency, 0.0, 0.0, self.phase)
        return np.column_stack([lines([0.0, self.time], self.offset), [still, wave]])


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
        read_levels(self)
        check_bounds(self)

    def pieces(self, end: float) -> np.ndarray:
        still = _wave(0.0, 1.0, 0.0, 0.0, 0.0)
        ratio = self.end_frequency / self.start_frequency
        rate, growth = (self.end_frequency - self.start_frequency) / self.duration, 0.0
        if self.logarithmic:
            rate, growth = 0.0, np.log(ratio) / self.duration
        wave = _wave(self.amplitude, self.start_frequency, rate, growth, 0.0)
        starts = [0.0, self.time, self.time + self.duration]
        return np.column_stack([lines(starts, self.offset), [still, wave, still]])


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """`base` throughout, and `height` more for `width` seconds from `time` on; repeated every `period` where given."""

    base: float = quantity(0.0, VALUE, "value otherwise", (-np.inf, np.inf), "")
    height: float = quantity(0.0, VALUE + "_difference", "rise above the base", (-np.inf, np.inf), "")
    width: float = quantity(1e-3, "s", "duration", (POSITIVE, np.inf), "")
    time: float = quantity(0.0, "s", "time of the first", (0.0, np.inf), "")
    period: float = quantity(np.inf, "s", "from pulse to pulse", (POSITIVE, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)
        if self.period <= self.width:
            raise InputError(
                f"{self.period:g} s must be longer than pulse.width = {self.width:g} s",
                key="pulse.period", joint=" = ", related=("pulse.width",),
            )  # fmt: skip

    def pieces(self, end: float) -> np.ndarray:
        within = max(np.ceil((end - self.time) / self.period), 0.0) + 1.0
        if within > MOST_PIECES / 2:
            raise InputError(
                f"{self.period:g} s makes {within:.7g} pulses within {end:g} s, more than {MOST_PIECES / 2:g}",
                key="pulse.period", joint=" = ",
            )  # fmt: skip
        k = np.arange(int(within))
        starts = self.time + k * (self.period if np.isfinite(self.period) else 0.0)
        stops = np.minimum(starts + self.width, self.time + (k + 1) * self.period)  # rounding never mixes their order
        rows = lines(np.zeros(1 + 2 * len(k)), self.base)
        rows[1::2, 0], rows[2::2, 0], rows[1::2, 1] = starts, stops, self.base + self.height
        return rows


@dataclass(frozen=True, kw_only=True)
class Staircase:
    """From `start_value` to `end_value` in `steps` equal jumps, each level held for `hold` seconds."""

    start_value: float = quantity(0.0, VALUE, "first level", (-np.inf, np.inf), "")
    end_value: float = quantity(0.0, VALUE, "last level", (-np.inf, np.inf), "")
    steps: float = quantity(10.0, "1", "number of jumps", (1.0, 1e6), "")
    hold: float = quantity(0.1, "s", "duration of a level", (POSITIVE, np.inf), "")

    def __post_init__(self):
        read_levels(self)
        check_bounds(self)
        if self.steps != int(self.steps):
            raise InputError(f"{self.steps:g} must be a whole number in [1, 1e+06]", key="staircase.steps", joint=" = ")

    def pieces(self, end: float) -> np.ndarray:
        if min(self.steps, end / self.hold) > MOST_PIECES:
            raise InputError(
                f"{self.steps:g} of {self.hold:g} s make more than {MOST_PIECES:g} levels within {end:g} s",
                key="staircase.steps", joint=" = ", related=("staircase.hold",),
            )  # fmt: skip
        levels = np.linspace(self.start_value, self.end_value, int(self.steps) + 1)
        return lines(np.arange(len(levels)) * self.hold, levels)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Straight lines between given points, held at its first and last value; two points at one time make no jump here.

    Raises InputError for fewer than two points or too many, lengths that differ, NaN, or times that do not rise.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    where: str = field(default="table", compare=False)  # what messages call it

    def __post_init__(self):
        if has_unit(self.times):
            times = in_si(self.times, "s", self.where, several=True)
            object.__setattr__(self, "times", tuple(np.ravel(times).tolist()))
        if has_unit(self.values):
            values = _read_level(self, self.values, VALUE, self.where, several=True)
            object.__setattr__(self, "values", tuple(np.ravel(values).tolist()))
        t, y = np.asarray(self.times, dtype=float), np.asarray(self.values, dtype=float)
        if t.shape != y.shape or t.ndim != 1 or len(t) < 2:
            raise InputError("needs two or more points, with as many times as values", key=self.where)
        if len(t) >= MOST_PIECES:
            raise InputError(f"{len(t)} points are more than {MOST_PIECES - 1}", key=self.where)
        bad = ~(np.isfinite(t) & np.isfinite(y))
        if bad.any():
            raise InputError(f"row {int(np.argmax(bad)) + 1} of the data is not a number", key=self.where)
        falls = np.diff(t) <= 0.0
        if falls.any():
            k = int(np.argmax(falls)) + 1
            what = "repeats" if t[k] == t[k - 1] else "is before"
            raise InputError(
                f"times must rise, but row {k + 1} ({t[k]:.6g} s) {what} row {k} ({t[k - 1]:.6g} s)", key=self.where
            )
        with np.errstate(over="ignore"):
            steep = ~np.isfinite(np.diff(y) / np.diff(t))
        if steep.any():
            k = int(np.argmax(steep)) + 1
            problem = f"row {k + 1} comes {t[k] - t[k - 1]:.3g} s after row {k}, too soon to tell"
            raise InputError(problem, key=self.where)

    @functools.cached_property
    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and values (n,), not to be written to."""
        columns = np.asarray(self.times, dtype=float), np.asarray(self.values, dtype=float)
        for column in columns:
            column.flags.writeable = False
        return columns

    def pieces(self, end: float) -> np.ndarray:
        return straight_pieces(*self.points)


@dataclass(frozen=True, eq=False)
class Piecewise:
    """A command by its own pieces (n, 5 + 5 waves), sorted by start, the first at or before zero; taken as they are."""

    rows: np.ndarray

    def pieces(self, end: float) -> np.ndarray:
        return self.rows


@dataclass(frozen=True)
class Sum:
    """The sum of commands, such as a bias with a sine."""

    terms: tuple[Command, ...]

    def pieces(self, end: float) -> np.ndarray:
        return merge(self.terms, float(np.nextafter(end, np.inf)))[1].sum_of_inputs()  # a jump at `end` is in


@dataclass(frozen=True)
class Scaled:
    """A command times a factor."""

    command: Command
    factor: float

    def pieces(self, end: float) -> np.ndarray:
        return _scaled(self.command.pieces(end), self.factor)


@dataclass(frozen=True)
class Intervals:
    """Rows (interval, input, width) of several commands between the joint break times; see `merge`."""

    starts: np.ndarray
    rows: np.ndarray

    def sum_of_inputs(self) -> np.ndarray:
        """One row an interval: polynomials added (moved to the interval's start), waves side by side."""
        n, inputs, _ = self.rows.shape
        cubics = [moved_to(self.rows[:, k], self.starts) for k in range(inputs)]
        waves = self.rows[:, :, PIECE_WIDTH:].reshape(n, inputs, -1, WAVE_WIDTH).copy()
        late = (self.starts[:, None] - self.rows[:, :, 0])[:, :, None]  # a wave goes on from where it is
        frequency, sweep, growth, phase = (waves[..., k] for k in (1, 2, 3, 4))
        with np.errstate(divide="ignore", invalid="ignore"):
            turns = np.where(growth == 0.0, frequency * late, frequency * np.expm1(growth * late) / growth)
        waves[..., 4] = phase + 2 * np.pi * (turns + 0.5 * sweep * late**2)
        waves[..., 1] = frequency * np.exp(growth * late) + sweep * late
        return np.column_stack([self.starts, np.sum(cubics, axis=0)[:, 1:], waves.reshape(n, -1)])


def merge(commands: Sequence[Command], end: float) -> tuple[np.ndarray, Intervals]:
    """All commands on the union of their breaks before `end`: starts, and rows (interval, input, width).

    Raises InputError for commands of too many pieces together (see `MOST_PIECES`).
    """
    pieces: list[np.ndarray] = []
    for command in commands:
        pieces.append(pieces_of(command, end))
        if sum(map(len, pieces)) > 2 * MOST_PIECES:
            raise InputError(f"the commands have more than {2 * MOST_PIECES} pieces together", key="sum")
    starts = np.unique(np.concatenate([p[:, 0] for p in pieces]))
    starts = np.unique(np.concatenate([[0.0], starts[(starts > 0.0) & (starts < end)]]))
    width = max(p.shape[1] for p in pieces)
    if len(starts) * len(pieces) * width > 40 * MOST_PIECES:  # eight numbers for each of five commands
        raise InputError(f"{len(starts)} pieces of {len(pieces)} commands with waves are too many to hold", key="sum")
    rows = np.zeros((len(starts), len(pieces), width))
    for k, p in enumerate(pieces):
        rows[:, k, : p.shape[1]] = p[pieces_at(p, starts)]
    return starts, Intervals(starts, rows)


def read_table(path: Path, column: str, unit: str) -> Table:
    """A table from a CSV file with a header of names and units, `time [s], <column> [unit]`, or from a record of
    another format, of which `column` is a channel.

    Raises InputError (with file and line) for a missing file, a missing or unitless column, gaps, bad numbers and too
    many rows.
    """
    from valvesim.io import read_columns
    from valvesim.measurement.formats import FORMATS

    if path.suffix.casefold() in FORMATS:
        return _read_recorded(path, column)
    columns = read_columns(path, {"time": "s", column: unit}, most_rows=MOST_PIECES - 1)
    return Table(times=tuple(columns["time"]), values=tuple(columns[column]), where=str(path))


def _read_recorded(path: Path, channel: str) -> Table:
    """A channel of a record as a table. Raises InputError as `read_recording` does, and where readings are missing."""
    from valvesim.measurement.headings import MEASURED_UNITS
    from valvesim.measurement.recording import read_recording

    if channel not in MEASURED_UNITS:
        raise unknown_name("channel", channel, MEASURED_UNITS).at(file=path)
    recording = read_recording([path], (channel,))
    values = recording.values[channel]
    if len(values) >= MOST_PIECES:
        raise InputError(f"{len(values)} samples are more than {MOST_PIECES - 1}", file=path)
    if (lost := np.flatnonzero(~np.isfinite(values))).size:
        raise InputError(f"no reading of {channel} at {recording.time[lost[0]]:.6g} s", file=path)
    return Table(times=tuple(recording.time.tolist()), values=tuple(values.tolist()), where=str(path))


COMMANDS: dict[str, Any] = {
    "constant": Constant, "step": Step, "ramp": Ramp, "sine": Sine, "chirp": Chirp, "pulse": Pulse,
    "staircase": Staircase,
}  # fmt: skip
"""Commands by the name that a scenario file uses; `table` is read with `read_table`."""
