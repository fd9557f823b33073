"""What the inputs of a record do that their samples do not tell, above all between these.

A record holds its command at samples. In between it may go straight, stay (a generator's staircase), go on smoothly (a
generator far faster than the logger), or jump at any time; and what was logged as constant may have moved. Each is an
`InputDeviation`. Most make of points (time, value) with straight lines between them other points, by so much as their
amount; a `Wave` is added to what comes of these, as the sine that it is.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from valvesim.identification.options import IdentificationOptions
from valvesim.inputs import Command, Constant, Sine, Sum, Table, straight_pieces

EDGE = 1e-6  # s: how long a jump takes
SMOOTH = 8  # points to a sample of a command that goes on smoothly

Points = tuple[np.ndarray, np.ndarray]


class PointDeviation(Protocol):
    """How an input of a record differs from straight lines between its samples."""

    @property
    def record(self) -> str:
        """The record's name."""

    @property
    def column(self) -> str:
        """The input's column."""

    def apply(self, points: Points, samples: Points, amount: float) -> Points:
        """The points with this deviation in them; `samples` are the record's own."""


@dataclass(frozen=True)
class EdgeTime:
    """A jump after sample `after`, by `amount` seconds later than the middle of that interval.

    Up to it the command goes on as in the interval before, from then on as in the one that follows.
    """

    record: str
    column: str
    after: int

    def apply(self, points: Points, samples: Points, amount: float) -> Points:
        (t, u), (time, values), k = points, samples, self.after
        start, end = time[k], time[k + 1]
        edge = float(np.clip(0.5 * (start + end) + amount, start + 2.0 * EDGE, end - 2.0 * EDGE))
        first, last = np.searchsorted(t, start, "right"), np.searchsorted(t, end, "left")
        slope = np.diff(values, prepend=values[0], append=values[-1])[[k, k + 2]] / (end - start)
        sides = values[k : k + 2] + slope * (edge - time[k : k + 2])
        return (
            np.concatenate([t[:first], [edge - 0.5 * EDGE, edge + 0.5 * EDGE], t[last:]]),
            np.concatenate([u[:first], sides, u[last:]]),
        )


@dataclass(frozen=True)
class Held:
    """Each sample is held until the next (zero-order hold)."""

    record: str
    column: str

    def apply(self, points: Points, samples: Points, amount: float) -> Points:
        (time, values), step = samples, samples[0][1] - samples[0][0]
        ends = time[1:] - min(EDGE, 0.1 * step)
        return np.insert(time, np.arange(1, len(time)), ends), np.insert(values, np.arange(1, len(time)), values[:-1])


@dataclass(frozen=True)
class Smooth:
    """The command goes on smoothly through its samples (splines of degree 7), straight in the intervals `straight`.

    At a fifth of the sampling rate a cubic spline is 0.5 % too small, as is an armature of a larger inertia. Straight
    lines join points so far outside the spline that they enclose as much as it does.
    """

    record: str
    column: str
    straight: tuple[int, ...] = ()

    def apply(self, points: Points, samples: Points, amount: float) -> Points:
        return _smooth_between(samples[0].tobytes(), samples[1].tobytes(), self.straight)


@functools.lru_cache(maxsize=64)
def _smooth_between(times: bytes, samples: bytes, straight: tuple[int, ...]) -> Points:
    """The points of a `Smooth` through samples, whose arrays are given as bytes: every run of a record asks for them.
    """
    time, values = np.frombuffer(times), np.frombuffer(samples)
    t, u = [], []
    for first, last in zip((0, *(k + 1 for k in straight)), (*straight, len(time) - 1), strict=True):
        part, fine = slice(first, last + 1), np.linspace(time[first], time[last], (last - first) * SMOOTH + 1)
        t.append(fine)
        u.append(_smooth(time[part], values[part], fine))
    points = np.concatenate(t), np.concatenate(u)
    for column in points:
        column.flags.writeable = False
    return points


def _smooth(time: np.ndarray, values: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Points (m,) at the even times `fine` whose straight lines go as a smooth curve through samples (n,) does."""
    from scipy.interpolate import make_interp_spline

    if len(time) < 4:
        return np.interp(fine, time, values)
    curve = make_interp_spline(time, values, k=min(7, 2 * (len(time) // 2) - 1))
    outside = -((fine[1] - fine[0]) ** 2) / 12.0 * curve.derivative(2)(fine)
    outside[[0, -1]] = 0.0  # a straight interval may follow
    return curve(fine) + outside


@dataclass(frozen=True)
class InputShift:
    """An input that is off by `amount`: throughout, or where `growing` by so much at the end and nothing before."""

    record: str
    column: str
    growing: bool = False

    def apply(self, points: Points, samples: Points, amount: float) -> Points:
        t, u = points
        return t, u + amount * ((t - t[0]) / (t[-1] - t[0]) if self.growing else 1.0)


@dataclass(frozen=True)
class Wave:
    """A wave on an input, `amount` in its SI unit at the crest: cos(2 pi f t - phase)."""

    record: str
    column: str
    frequency: float
    phase: float

    def command(self, amount: float) -> Command:
        """The wave as a command of its own."""
        return Sine(amplitude=amount, frequency=self.frequency, phase=0.5 * np.pi - self.phase)

    def on_grid(self, times: np.ndarray) -> np.ndarray:
        """A wave of amount one at times (n,) of an even grid as `added_on_grid` has it: means over hats, exact."""
        damped = np.sinc(self.frequency * (times[1] - times[0])) ** 2
        return damped * np.cos(2.0 * np.pi * self.frequency * times - self.phase)


InputDeviation = PointDeviation | Wave
Deviations = tuple[tuple[InputDeviation, float], ...]
"""Deviations with their amounts: those of the points in the order in which they act."""


def acting_on(deviations: Deviations, record: str, column: str = "") -> Deviations:
    """Those of a record, or of one of its columns."""
    return tuple(each for each in deviations if each[0].record == record and column in ("", each[0].column))


def points_of(command: Command, end: float) -> Points:
    """A measured input, straight between its samples, as points."""
    if isinstance(command, Constant):
        return np.array([0.0, end]), np.full(2, float(command.value))
    assert isinstance(command, Table | Polyline)  # noqa: S101 - a record's inputs are one of these
    return command.points


def deviating(samples: Points, deviations: Deviations) -> Points:
    """An input's points with deviations of these; waves are none."""
    points = samples
    for deviation, amount in deviations:
        if not isinstance(deviation, Wave):
            points = deviation.apply(points, samples, amount)
    return points


def deviating_command(command: Command, end: float, deviations: Deviations) -> Command:
    """A measured input with deviations of it."""
    waves = [one.command(amount) for one, amount in deviations if isinstance(one, Wave)]
    if len(waves) < len(deviations):
        command = command_through(deviating(points_of(command, end), deviations))
    return Sum((command, *waves)) if waves else command


@dataclass(frozen=True, eq=False)
class Polyline:
    """A command that goes straight between points of rising times, as a `Table` does; they are taken as they are."""

    points: Points

    def pieces(self, end: float) -> np.ndarray:
        return straight_pieces(*self.points)


def command_through(points: Points) -> Command:
    """The command that goes straight between points."""
    values = points[1]
    return Constant(value=float(values[0])) if np.ptp(values) == 0.0 else Polyline(points)


def added_input(
    command: Command, end: float, deviations: Deviations, before: Deviations, times: np.ndarray
) -> np.ndarray:
    """What deviations of a measured input add to it beyond others `before`, at times (n,) of an even grid."""
    added = np.zeros(len(times))
    for sign, those in ((1.0, deviations), (-1.0, before)):
        for one, amount in those:
            if isinstance(one, Wave):
                added += sign * amount * one.on_grid(times)
    new, old = (tuple(each for each in those if not isinstance(each[0], Wave)) for those in (deviations, before))
    if new != old:
        samples = points_of(command, end)
        added += added_on_grid(deviating(samples, new), deviating(samples, old), times)
    return added


def added_on_grid(new: Points, old: Points, times: np.ndarray) -> np.ndarray:
    """What some points add to others at each time (n,) of an even grid where straight lines join them.

    Means over hats of the grid's width, exact: second differences of the double integral. So a jump shows at its true
    time, whatever the grid.
    """
    h = float(times[1] - times[0])
    t = np.union1d(new[0], old[0])
    u = np.interp(t, *new) - np.interp(t, *old)
    t, u = np.concatenate([[t[0] - 2.0 * h], t, [t[-1] + 2.0 * h]]), np.concatenate([u[:1], u, u[-1:]])
    step, slope = np.diff(t), np.diff(u) / np.diff(t)
    once = np.concatenate([[0.0], np.cumsum(step * (u[:-1] + u[1:]) / 2.0)])
    twice = np.concatenate([[0.0], np.cumsum(once[:-1] * step + u[:-1] * step**2 / 2.0 + slope * step**3 / 6.0)])
    at = np.concatenate([[times[0] - h], times, [times[-1] + h]])
    k = np.clip(np.searchsorted(t, at, "right") - 1, 0, len(step) - 1)
    d = at - t[k]
    integral = twice[k] + once[k] * d + u[k] * d**2 / 2.0 + slope[k] * d**3 / 6.0
    return np.diff(integral, 2) / h**2


def command_jumps(values: np.ndarray, *, options: IdentificationOptions) -> np.ndarray:
    """Indices k of the samples of a command (n,) after which it jumps.

    There its change differs by much from the mean of the changes beside, and by half as much the other way each of
    these from theirs; two intervals off there is no such difference. A corner or the first of several changes is none.
    """
    change = np.pad(np.diff(values), 4, mode="edge")
    off = change[1:-1] - (change[:-2] + change[2:]) / 2.0  # of interval k at k + 3
    n = len(values) - 1
    own, before, after = off[3 : 3 + n], off[2 : 2 + n], off[4 : 4 + n]
    beside = np.maximum(np.abs(off[1 : 1 + n]), np.abs(off[5 : 5 + n]))
    size = max(options.input.jump * float(np.ptp(values)), options.input.jump_noise * float(np.median(np.abs(own))))
    halves = np.maximum(np.abs(before + own / 2.0), np.abs(after + own / 2.0))
    alone = (np.abs(own) > options.input.jump_ratio * beside) & (np.abs(own) > options.input.half_ratio * halves)
    return np.flatnonzero((np.abs(own) > max(size, 1e-300)) & alone)


def command_corners(values: np.ndarray, *, options: IdentificationOptions) -> np.ndarray:
    """Indices k of the intervals of a command (n,) in or next to which its slope changes at once, jumps among them."""
    bend = np.abs(np.diff(values, 2, prepend=values[0], append=values[-1]))  # at sample k
    bend[[0, -1]] = 0.0
    beside = np.maximum(np.append(np.zeros(3), bend[:-3]), np.append(bend[3:], np.zeros(3)))
    size = max(options.input.jump * float(np.ptp(values)) / 10.0, options.input.jump_noise * float(np.median(bend)))
    corner = np.flatnonzero((bend > max(size, 1e-300)) & (bend > options.input.jump_ratio * beside))
    return np.unique(np.clip(np.concatenate([corner - 1, corner]), 0, len(values) - 2))


def edges_of(record: str, column: str, values: np.ndarray, *, options: IdentificationOptions) -> Sequence[EdgeTime]:
    """The jumps of a record's command as edges."""
    return [EdgeTime(record, column, int(k)) for k in command_jumps(values, options=options)]
