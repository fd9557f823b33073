"""What the inputs of a record do that their samples do not tell, above all between these.

A record holds its command at samples. In between it may go straight, bend where a ramp begins or ends, stay (a
generator's staircase), go on smoothly (a generator far faster than the logger), or jump at any time; and what was
logged as constant may have moved. Each is an `InputDeviation`. Most make of the pieces that an input goes by
(`inputs.Command`) other pieces, by so much as their amount; a `Wave` is added to what comes of these, as the sine that
it is.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Protocol

import numpy as np

from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import Record
from valvesim.inputs import (
    Command,
    Constant,
    Piecewise,
    Sine,
    Sum,
    Table,
    lines,
    moved_to,
    piece_value,
    pieces_at,
    straight_pieces,
)

EDGE = 1e-6  # s: how long a jump takes
CUBICS = 2  # cubics to a sample of a command that goes on smoothly

Points = tuple[np.ndarray, np.ndarray]


class PointDeviation(Protocol):
    """How an input of a record differs from straight lines between its samples."""

    @property
    def record(self) -> str:
        """The record's name."""

    @property
    def column(self) -> str:
        """The input's column."""

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        """The pieces (n, 5) with this deviation in them; `samples` are the record's own."""


@dataclass(frozen=True)
class EdgeTime:
    """A jump after sample `after`, by `amount` seconds later than the middle of that interval.

    Up to it the command goes on as in the interval before, from then on as in the one that follows.
    """

    record: str
    column: str
    after: int

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        return _with_edges(pieces, samples, np.array([self.after]), np.array([amount]))


def _with_edges(pieces: np.ndarray, samples: Points, after: np.ndarray, amounts: np.ndarray) -> np.ndarray:
    """The pieces with jumps after several samples (m,), see `EdgeTime`: what an interval had gives way to them."""
    (time, values), t = samples, pieces[:, 0]
    start, end = time[after], time[after + 1]
    edge = np.clip(0.5 * (start + end) + amounts, start + 2.0 * EDGE, end - 2.0 * EDGE)
    slopes = np.diff(values, prepend=values[0], append=values[-1])
    first, last = np.searchsorted(t, start, "right") - 1, np.searchsorted(t, end, "left")
    before = values[after] + slopes[after] * (edge - start) / (end - start)
    beyond = values[after + 1] + slopes[after + 2] * (edge - end) / (end - start)
    at = np.column_stack([t[first], edge - 0.5 * EDGE, edge + 0.5 * EDGE, t[last]])
    u = np.column_stack([pieces[first, 1], before, beyond, pieces[last, 1]])
    jumps = lines(at[:, :-1].ravel(), u[:, :-1].ravel(), (np.diff(u) / np.diff(at)).ravel())
    joined = np.vstack([pieces[~_covered(len(t), first, last)], jumps])
    return joined[np.argsort(joined[:, 0], kind="stable")]


@dataclass(frozen=True)
class EdgeDuration:
    """Edges within which the samples `at` (ascending) were taken: ramps through these, `amount` seconds longer than
    half a step, between the lines that the command goes by before and after.

    A logger that runs by the clock of the command's generator reads every edge at the same share of it.
    """

    record: str
    column: str
    at: tuple[int, ...]

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        (time, values), k, t = samples, np.array(self.at), pieces[:, 0]
        step, slope = time[1] - time[0], np.diff(values) / np.diff(time)
        early, before, after = _edge_shares(values, k)[0], slope[k - 2], slope[k + 1]
        lasting = float(np.clip(0.5 * step + amount, EDGE, step - 2.0 * EDGE))
        start, end = time[k] - early * lasting, time[k] + (1.0 - early) * lasting
        low, high = values[k - 1] + before * (start - time[k - 1]), values[k + 1] + after * (end - time[k + 1])
        ramps = lines(
            np.column_stack([time[k - 1], start, end]).ravel(),
            np.column_stack([values[k - 1], low, high]).ravel(),
            np.column_stack([before, (high - low) / lasting, after]).ravel(),
        )
        first, last = np.searchsorted(t, time[k - 1], "left"), np.searchsorted(t, time[k + 1], "left")
        joined = np.vstack([pieces[~_covered(len(t), first, last)], ramps])
        return joined[np.argsort(joined[:, 0], kind="stable")]


def _edge_shares(values: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The share of an edge that samples k (m,) within it have seen, by the lines beside it, and its size (m,)."""
    start = 2.0 * values[k - 1] - values[k - 2]
    size = 2.0 * values[k + 1] - values[k + 2] - start
    return np.divide(values[k] - start, size, out=np.zeros(len(k)), where=size != 0.0), size


def _covered(count: int, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """True for those of so many pieces that lie in one of several ranges from a first to before a last one."""
    taken = np.zeros(count + 1, dtype=int)
    np.add.at(taken, first, 1)
    np.add.at(taken, last, -1)
    return np.cumsum(taken[:-1]) > 0


@dataclass(frozen=True)
class Held:
    """Each sample is held until the next (zero-order hold); one `read_back` before it changed, from the one before."""

    record: str
    column: str
    read_back: bool = False

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        (time, values), step = samples, samples[0][1] - samples[0][0]
        edge, at = min(EDGE, 0.1 * step), np.arange(1, len(time))
        corners = (time[:-1] + edge, values[1:]) if self.read_back else (time[1:] - edge, values[:-1])
        return straight_pieces(np.insert(time, at, corners[0]), np.insert(values, at, corners[1]))


@dataclass(frozen=True)
class Corners:
    """Straight lines that go on beyond their samples until they meet, in the intervals `within` (ascending): a ramp
    begins and ends where it does, and not at a sample.
    """

    record: str
    column: str
    within: tuple[int, ...]

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        (time, values), k, t = samples, np.array(self.within), pieces[:, 0]
        _, slope, beyond = _corners(time, values, k)
        first, last = np.searchsorted(t, time[k], "left"), np.searchsorted(t, time[k + 1], "left")
        joined = np.vstack([pieces[~_covered(len(t), first, last)], lines(time[k], values[k], slope), beyond])
        return joined[np.argsort(joined[:, 0], kind="stable")]


def _corners(time: np.ndarray, values: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where in the intervals k (m,) the lines of those before and after meet, as shares of them (m,); the slopes (m,)
    up to there, and the pieces (m, 5) from there on.
    """
    slope = np.diff(values) / np.diff(time)
    before, after, step = slope[k - 1], slope[k + 1], time[k + 1] - time[k]
    bend = before - after
    reached = np.divide(values[k + 1] - values[k] - after * step, bend, out=np.full(len(k), np.nan), where=bend != 0.0)
    return reached / step, before, lines(time[k] + reached, values[k] + before * reached, after)


@dataclass(frozen=True)
class Smooth:
    """The command goes on smoothly through its samples (splines of a degree), straight in the intervals `straight`.

    At a fifth of the sampling rate a cubic spline is 0.5 % too small, as is an armature of a larger inertia. Cubics
    half a sample long have its slopes at both their ends, and values by so much outside it that they enclose as much
    as it does.
    """

    record: str
    column: str
    straight: tuple[int, ...] = ()
    degree: int = 7

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        return _smooth_pieces(samples[0].tobytes(), samples[1].tobytes(), self.straight, self.degree)

    @property
    def of_lower_degree(self) -> Smooth:
        """The same by splines of a degree that differ from it where the samples do not tell how the command goes."""
        return replace(self, degree=self.degree - 2)


@functools.lru_cache(maxsize=64)
def _smooth_pieces(times: bytes, samples: bytes, straight: tuple[int, ...], degree: int) -> np.ndarray:
    """The pieces of a `Smooth` through samples, whose arrays are given as bytes: every run of a record asks for them.
    """
    time, values = np.frombuffer(times), np.frombuffer(samples)
    pieces = straight_pieces(time, values)
    parts, done = [pieces[:1]], 0  # what holds before the first sample
    for last in (*straight, len(time) - 1):
        parts.append(_smooth_part(time[done : last + 1], values[done : last + 1], degree))
        parts.append(pieces[last + 1 : last + 2])  # straight to the next, or held after the last
        done = last + 1
    joined = np.vstack(parts)
    joined.flags.writeable = False
    return joined


def _smooth_part(time: np.ndarray, values: np.ndarray, degree: int) -> np.ndarray:
    """Pieces (m, 5) that go smoothly through samples (n,), from the first to the last."""
    from scipy.interpolate import make_interp_spline

    if len(time) < 4:
        return straight_pieces(time, values)[1:-1]
    curve = make_interp_spline(time, values, k=min(degree, 2 * (len(time) // 2) - 1))
    at = np.linspace(time[0], time[-1], (len(time) - 1) * CUBICS + 1)
    u, rate = curve(at), curve.derivative()(at)
    if curve.k > 3:
        u[1:-1] += (at[1] - at[0]) ** 4 / 720.0 * curve.derivative(4)(at[1:-1])
    step, slope = np.diff(at), np.diff(u) / np.diff(at)
    square = (3.0 * slope - 2.0 * rate[:-1] - rate[1:]) / step
    cube = (rate[:-1] + rate[1:] - 2.0 * slope) / step**2
    return np.column_stack([at[:-1], u[:-1], rate[:-1], square, cube])


@dataclass(frozen=True)
class InputShift:
    """An input that is off by `amount`: throughout, or where `growing` by so much at the end and nothing before."""

    record: str
    column: str
    growing: bool = False

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        shifted, (first, last) = pieces.copy(), samples[0][[0, -1]]
        if not self.growing:
            shifted[:, 1] += amount
            return shifted
        shifted[:, 1] += amount * np.clip((pieces[:, 0] - first) / (last - first), 0.0, 1.0)
        shifted[(pieces[:, 0] >= first) & (pieces[:, 0] < last), 2] += amount / (last - first)
        return shifted


@dataclass(frozen=True)
class InputDelay:
    """An input that was read `amount` seconds late: its meter is slow, or has a clock of its own."""

    record: str
    column: str

    def apply(self, pieces: np.ndarray, samples: Points, amount: float) -> np.ndarray:
        moved = pieces.copy()
        moved[1:, 0] -= amount
        moved[0, 0] = min(moved[0, 0], moved[1, 0])
        return moved


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


def samples_of(command: Command, end: float) -> Points:
    """The samples of a measured input, which goes straight between them."""
    if isinstance(command, Constant):
        return np.array([0.0, end]), np.full(2, float(command.value))
    assert isinstance(command, Table)  # noqa: S101 - a record's inputs are one of these
    return command.points


def deviating(samples: Points, deviations: Deviations) -> np.ndarray:
    """The pieces (n, 5) of a measured input with deviations of its; waves are none."""
    pieces = straight_pieces(*samples)
    for together, some in groupby(deviations, key=lambda each: isinstance(each[0], EdgeTime)):
        if together:
            after, amounts = np.transpose([(one.after, amount) for one, amount in some if isinstance(one, EdgeTime)])
            pieces = _with_edges(pieces, samples, after.astype(int), amounts)
            continue
        for deviation, amount in some:
            if not isinstance(deviation, Wave):
                pieces = deviation.apply(pieces, samples, amount)
    return pieces


def deviating_command(command: Command, end: float, deviations: Deviations) -> Command:
    """A measured input with deviations of it."""
    waves = [one.command(amount) for one, amount in deviations if isinstance(one, Wave)]
    if len(waves) < len(deviations):
        command = piecewise_command(deviating(samples_of(command, end), deviations))
    return Sum((command, *waves)) if waves else command


def piecewise_command(pieces: np.ndarray) -> Command:
    """The command that goes by some pieces."""
    still = np.ptp(pieces[:, 1]) == 0.0 and not pieces[:, 2:].any()
    return Constant(value=float(pieces[0, 1])) if still else Piecewise(pieces)


def added_input(
    command: Command, end: float, deviations: Deviations, before: Deviations, times: np.ndarray
) -> np.ndarray:
    """What deviations of a measured input add to it beyond others `before`, at times (n,) of an even grid."""
    waves = dict[Wave, float]()
    for sign, those in ((1.0, deviations), (-1.0, before)):
        for one, amount in those:
            if isinstance(one, Wave):
                waves[one] = waves.get(one, 0.0) + sign * amount
    added = np.zeros(len(times))
    for one, amount in waves.items():
        if amount:
            added += amount * one.on_grid(times)
    new, old = (tuple(each for each in those if not isinstance(each[0], Wave)) for those in (deviations, before))
    if new != old:
        samples = samples_of(command, end)
        added += added_on_grid(deviating(samples, new), deviating(samples, old), times)
    return added


def added_on_grid(new: np.ndarray, old: np.ndarray, times: np.ndarray) -> np.ndarray:
    """What some pieces (n, 5) add to others at each time (n,) of an even grid where straight lines join them.

    Means over hats of the grid's width, exact: second differences of the double integral. So a jump shows at its true
    time, whatever the grid.
    """
    h, means = float(times[1] - times[0]), np.zeros(len(times))
    lead = _common(new, old)
    tail = min(_common(new[::-1], old[::-1]), len(new) - lead, len(old) - lead)
    if lead == len(new) == len(old):
        return means
    new, old = (rows[max(lead - 1, 0) : len(rows) - max(tail - 1, 0)] for rows in (new, old))
    t = np.union1d(new[:, 0], old[:, 0])
    first = np.searchsorted(times, t[0] - h) if lead else 0
    last = np.searchsorted(times, t[-1] + h) if tail else len(times)
    if first == last:
        return means
    added, before = (moved_to(new[pieces_at(new, t)], t) - moved_to(old[pieces_at(old, t)], t))[:, 1:], np.zeros(4)
    before[0] = added[0, 0]
    t, added = np.append(min(t[0], times[first]) - 2.0 * h, t), np.vstack([before, added])

    def integrals(k: Any, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The integral and the double one over the first `d` of pieces k."""
        offset, slope, square, cube = added[k].T
        once = d * (offset + d * (slope / 2.0 + d * (square / 3.0 + d * cube / 4.0)))
        return once, d**2 * (offset / 2.0 + d * (slope / 6.0 + d * (square / 12.0 + d * cube / 20.0)))

    step = np.diff(t)
    over, twice_over = integrals(slice(0, -1), step)
    once = np.concatenate([[0.0], np.cumsum(over)])
    twice = np.concatenate([[0.0], np.cumsum(once[:-1] * step + twice_over)])
    at = np.concatenate([[times[first] - h], times[first:last], [times[last - 1] + h]])
    k = np.clip(np.searchsorted(t, at, "right") - 1, 0, len(t) - 1)
    d = at - t[k]
    means[first:last] = np.diff(twice[k] + once[k] * d + integrals(k, d)[1], 2) / h**2
    return means


def _common(one: np.ndarray, other: np.ndarray) -> int:
    """How many of the first pieces two inputs have in common."""
    both = min(len(one), len(other))
    differ = np.flatnonzero((one[:both] != other[:both]).any(axis=1))
    return int(differ[0]) if len(differ) else both


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


def sampled_edges(record: Record, *, options: IdentificationOptions) -> EdgeDuration | None:
    """The edges of a record's command within which a sample was taken; None where there are none.

    There the command changes in two intervals, the same way, and hardly in those beside them.
    """
    values, ask = record.values[record.command], options.input
    if len(values) < 5:
        return None
    k = np.arange(2, len(values) - 2)
    (share, edge), change = _edge_shares(values, k), np.diff(values)
    beside = np.maximum(np.abs(change[k - 2]), np.abs(change[k + 1]))
    size = max(ask.jump * float(np.ptp(values)), ask.jump_noise * float(np.median(np.abs(change))))
    within = (share > ask.edge_share) & (share < 1.0 - ask.edge_share)
    found = k[within & (np.abs(edge) > np.maximum(size, ask.corner_ratio * beside))]
    alone = found[~np.isin(found - 1, found) & ~np.isin(found + 1, found)]
    return EdgeDuration(record.name, record.command, tuple(alone.tolist())) if len(alone) else None


def corners_of(record: Record, *, options: IdentificationOptions) -> Corners | None:
    """The corners of a record's command that lie between samples; None where there are none, or where much of what it
    bends is neither at corners nor at jumps: a fast sine has samples in line by chance.

    The lines that meet there go on straight for two intervals on either side, or on one side for one, up to a corner
    that does so on its other side. The slope of a ramp that is over sooner is in no sample.
    """
    values, ask = record.values[record.command], options.input
    if len(values) < 6:
        return None
    k, change = np.arange(2, len(values) - 3), np.diff(values)
    share, bend = _corners(record.time, values, k)[0], np.abs(change[k - 1] - change[k + 1])
    bends = np.abs(np.diff(change))  # at the samples from the second on
    size = max(ask.jump * float(np.ptp(values)) / 10.0, ask.jump_noise * float(np.median(bends)))
    meet = (share > -ask.at_sample) & (share < 1.0 + ask.at_sample) & (bend > size)
    before = meet & (ask.corner_ratio * np.abs(change[k - 1] - change[k - 2]) < bend)
    after = meet & (ask.corner_ratio * np.abs(change[k + 1] - change[k + 2]) < bend)
    begins, ends = before[:-2] & after[2:], np.zeros(2, dtype=bool)
    corner = (before & after) | np.append(begins, ends) | np.append(ends, begins)
    within = k[corner & (share > ask.at_sample) & (share < 1.0 - ask.at_sample)]
    edges = sampled_edges(record, options=options)
    known = np.concatenate([
        *(k[corner] + by for by in (0, 1)),
        *(command_jumps(values, options=options) + by for by in (0, 1)),
        *(np.array(edges.at if edges else (), dtype=int) + by for by in (-1, 0, 1)),
    ])  # fmt: skip
    at_known = np.isin(np.arange(1, len(values) - 1), known)
    if not len(within) or np.sum(bends[at_known] ** 2) < ask.known_bends * np.sum(bends**2):
        return None
    return Corners(record.name, record.command, tuple(within.tolist()))


def edges_of(record: str, column: str, values: np.ndarray, *, options: IdentificationOptions) -> Sequence[EdgeTime]:
    """The jumps of a record's command as edges."""
    return [EdgeTime(record, column, int(k)) for k in command_jumps(values, options=options)]


def smooth_command(record: Record, *, options: IdentificationOptions) -> Smooth:
    """The command of a record that goes on smoothly but for its corners."""
    between = corners_of(record, options=options)
    corners = command_corners(record.values[record.command], options=options)
    straight = np.union1d(corners, between.within if between is not None else ()).astype(int)
    return Smooth(record.name, record.command, tuple(straight.tolist()))


def undersampled_share(record: Record, *, options: IdentificationOptions) -> float:
    """The share of a record in which its samples do not tell how its command goes on smoothly between them, for splines
    of two degrees differ; zero where that is next to none, as at ends, and where it stays.
    """
    if not record.moves(record.command):
        return 0.0
    values = record.values[record.command]
    share = _undersampled_share(record.time.tobytes(), values.tobytes(), smooth_command(record, options=options),
                          options.input.undersampled)  # fmt: skip
    return share if share > options.input.least_undersampled else 0.0


@functools.lru_cache(maxsize=64)
def _undersampled_share(times: bytes, samples: bytes, smooth: Smooth, undersampled: float) -> float:
    """The share of the intervals between samples, see `_smooth_pieces`, in which the splines differ by more than such
    a share of the span.
    """
    time, values = np.frombuffer(times), np.frombuffer(samples)
    middle = 0.5 * (time[1:] + time[:-1])
    both = (each.apply(straight_pieces(time, values), (time, values), 1.0) for each in (smooth, smooth.of_lower_degree))
    one, other = (piece_value(pieces[pieces_at(pieces, middle)].T, middle)[0] for pieces in both)
    return float(np.mean(np.abs(one - other) > undersampled * np.ptp(values)))
