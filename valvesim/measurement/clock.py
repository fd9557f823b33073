"""The even clock of measured times: doubled and jittered times, gaps, and times that are coarser than the samples.

Times that keep to an even clock within `ClockOptions.jitter` are the clock. Where they are off by more, the readings
are laid on the clock by straight lines, unless the times were only rounded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvesim.errors import InputError
from valvesim.measurement.table import MOST_MEASURED_SAMPLES

JITTER = 0.02  # share of the step by which times may be off the clock and still be it
GAP = 1.5  # times the step from which a longer step is a gap: a lost sample makes one of 2
UNEVEN = 0.1  # share of the steps that may be neither a step nor whole steps of the clock
COARSE = 0.2  # share of the steps that are zero from which times are taken to be written with too few digits
_PART = 1 << 20  # times at once
FARTHEST = 1e12  # s; a date in seconds is below 1e10
SHORTEST = 1e-12  # s between samples
FILLED = 20.0  # times the samples: a record with more gap than that is not one


@dataclass(frozen=True, eq=False)
class EvenClock:
    """An even clock (`start` s, `step` s, `count` samples) and how rows lie on it.

    `rows` are the rows of the table that are used, at `places` (len(rows),) in steps from the start; whole numbers
    unless `interpolated`. Both are None where every row is a sample. `notes` say in words what was done.
    """

    start: float
    step: float
    count: int
    rows: np.ndarray | None = None
    places: np.ndarray | None = None
    interpolated: bool = False
    notes: tuple[str, ...] = ()

    def row_of(self, sample: int) -> int:
        """The row of the table that is at a sample, or the one before where there is none."""
        if self.rows is None or self.places is None:
            return sample
        k = int(np.searchsorted(self.places, sample + 0.5)) - 1
        return int(self.rows[max(k, 0)])

    @property
    def times(self) -> np.ndarray:
        """(count,) s."""
        return self.start + self.step * np.arange(self.count)

    def lay(self, values: np.ndarray) -> np.ndarray:
        """A column (rows of the table,) on the clock (count,), NaN where nothing was measured."""
        if self.rows is None or self.places is None:
            return values
        values = values[self.rows]
        out = np.full(self.count, np.nan)
        if not self.interpolated:
            out[np.round(self.places).astype(np.int64)] = values
            return out
        known = np.isfinite(values)
        if known.sum() < 2:
            return out
        places, values = self.places[known], values[known]
        grid = np.arange(self.count)
        after = np.clip(np.searchsorted(places, grid), 1, len(places) - 1)
        near = (grid >= places[0] - 0.5) & (grid <= places[-1] + 0.5)
        inside = (places[after] - places[after - 1] < GAP) | (np.abs(grid - places[after]) < 0.5) | (
            np.abs(grid - places[after - 1]) < 0.5)  # fmt: skip
        at = near & inside
        out[at] = np.interp(grid[at], places, values)
        return out


def even_clock(
    time: np.ndarray, path: Path, line_of: Callable[[int], int | None], same: Callable[[int, int], bool]
) -> EvenClock:
    """The even clock of times (n,) in s; `same(row, other)` tells whether two rows hold the same readings.

    Raises InputError, with the line, for times that fall, for two readings at one time, and for a clock that is uneven.
    """
    if (step := _even_step(time)) is not None:
        return EvenClock(float(time[0]), step, len(time))
    notes: list[str] = []
    rows = np.flatnonzero(np.isfinite(time))
    if len(rows) < len(time):
        notes.append(f"{len(time) - len(rows)} rows have no time and are left out")
    if len(rows) < 3:
        raise InputError(f"{len(rows)} rows with a time are too few", file=path)
    if (far := np.abs(time[rows]) > FARTHEST).any():
        k = int(rows[np.argmax(far)])
        raise InputError(f"a time of {time[k]:g} s is beyond ±{FARTHEST:g} s", file=path, line=line_of(k))
    steps = np.diff(time[rows])
    if (steps < 0.0).any():
        k = int(np.argmax(steps < 0.0))
        told = f"times must rise, but {time[rows[k + 1]]:.9g} s follows {time[rows[k]]:.9g} s"
        raise InputError(told, file=path, line=line_of(int(rows[k + 1])))
    if not (steps > 0.0).any():
        raise InputError("all times are the same", file=path, line=line_of(0))
    doubled = np.flatnonzero(steps == 0.0)
    if len(doubled):
        twice = [int(k) for k in doubled if same(int(rows[k]), int(rows[k + 1]))] if len(doubled) <= 10_000 else []
        if len(twice) == len(doubled):
            rows = np.delete(rows, np.array(twice) + 1)
            notes.append(f"{len(twice)} rows stand there twice: each is used once")
        elif len(doubled) > COARSE * len(steps) and (coarse := _coarse(time, rows)) is not None:
            return EvenClock(
                *coarse, rows, np.arange(len(rows), dtype=float), False, (*notes, _coarse_note(steps, coarse[1]))
            )
        else:
            beside = _beside_a_gap(steps, doubled)
            if beside is not None:
                told = f"two readings at one time, {time[rows[beside]]:.9g} s, and none a sample away"
                raise InputError(f"times must rise: {told}", file=path, line=line_of(int(rows[beside + 1])))
            notes.append(f"{len(doubled)} times stand there twice: the later reading is used")
            rows = np.delete(rows, doubled)
    return _laid(time, rows, path, line_of, notes)


def _even_step(time: np.ndarray) -> float | None:
    """The step of an even clock that all times (n,) keep to, None where there is none. Of many it holds a part."""
    n = len(time)
    step = float(time[-1] - time[0]) / (n - 1) if n > 2 else 0.0
    if not step > 0.0:
        return None
    for k in range(0, n, _PART):
        part = time[k : k + _PART]
        if not (np.abs(part - (time[0] + step * np.arange(k, k + len(part)))) <= 0.5 * JITTER * step).all():
            return None
    return step


def _beside_a_gap(steps: np.ndarray, doubled: np.ndarray) -> int | None:
    """The first doubled time beside a step that lacks a sample, which is where one of the two belongs."""
    usual = float(np.median(steps[steps > 0.0]))
    for k in doubled:
        beside = [steps[j] for j in (k - 1, k + 1) if 0 <= j < len(steps)]
        if max(beside, default=0.0) > GAP * usual:
            return int(k)
    return None


def _coarse(time: np.ndarray, rows: np.ndarray) -> tuple[float, float, int] | None:
    """(start, step, count) of an even clock whose times were written with too few digits; None where it is not that."""
    t, n = time[rows], len(rows)
    start, step = _line(np.arange(n), t)
    rising = np.diff(np.unique(t))
    if np.max(np.abs(t - start - step * np.arange(n))) > 0.75 * np.max(rising) + step:
        return None
    return float(start), float(step), n


def _coarse_note(steps: np.ndarray, step: float) -> str:
    grain = float(np.max(steps))
    return f"times are written to {grain:.3g} s only: the samples are taken as even, {step:.4g} s apart"


def _laid(
    time: np.ndarray, rows: np.ndarray, path: Path, line_of: Callable[[int], int | None], notes: list[str]
) -> EvenClock:
    """The clock of rising times."""
    t = time[rows]
    steps = np.diff(t)
    usual = float(np.median(steps))
    whole = np.maximum(np.round(steps / usual), 1.0)
    regular = np.abs(steps - usual) < 0.5 * usual
    odd = ~regular & (steps < GAP * usual)
    if np.mean(odd) > UNEVEN:
        k = int(np.argmax(odd))
        raise InputError(
            f"uneven clock: a step of {steps[k]:.4g} s at {t[k]:.6g} s, where samples come every {usual:.4g} s, and "
            f"{np.mean(odd):.0%} of the steps are like that", file=path, line=line_of(int(rows[k + 1])),
        )  # fmt: skip
    places = np.concatenate([[0.0], np.cumsum(whole)])
    for _ in range(3):  # a step that is off by little is off by whole samples over a long gap
        start, step = _line(places, t)
        exact = (t - start) / step
        places = np.round(exact)
    off = exact - places
    count = int(places[-1] - places[0]) + 1
    if count > min(FILLED * len(t) + 1000, MOST_MEASURED_SAMPLES):
        k = int(np.argmax(steps))
        told = f"a gap of {steps[k]:.4g} s, where samples come every {usual:.4g} s: make it two records"
        raise InputError(told, file=path, line=line_of(int(rows[k + 1])))
    if np.max(np.abs(off)) <= JITTER and (np.diff(places) >= 1.0).all():
        places = places - places[0]
        step = (t[-1] - t[0]) / places[-1]
        return EvenClock(float(t[0]), float(step), count, rows, places, False, (*notes, *_gap_note(places)))
    grain = _grain(t)
    if grain > JITTER * step and np.max(np.abs(off)) * step <= 0.75 * grain and (np.diff(places) >= 1.0).all():
        notes.append(f"times are written to {grain:.3g} s only: the samples are taken as even, {step:.4g} s apart")
        places = places - places[0]
        return EvenClock(float(start), float(step), count, rows, places, False, (*notes, *_gap_note(places)))
    rms = float(np.std(off))
    notes.append(f"times are off an even clock of {step:.4g} s by {rms:.0%} of a step (rms): readings are laid on it "
                 "by straight lines")  # fmt: skip
    exact = (t - t[0]) / step
    count = int(np.floor(exact[-1] + 1e-6)) + 1
    return EvenClock(float(t[0]), float(step), count, rows, exact, True, (*notes, *_gap_note(exact)))


def _line(places: np.ndarray, t: np.ndarray) -> tuple[float, float]:
    """(start, step) of the straight line of times over their places, by least squares."""
    middle, mean = np.mean(places), np.mean(t)
    step = float(np.dot(places - middle, t - mean) / np.dot(places - middle, places - middle))
    return float(mean - step * middle), step


def _grain(t: np.ndarray) -> float:
    """The last decimal place that times are written to, s, or the spacing of single precision; 0 where it is finer."""
    part = t[:: max(len(t) // 2000, 1)]
    single = float(np.spacing(np.float32(np.max(np.abs(part))))) if (part == part.astype(np.float32)).all() else 0.0
    for digits in range(-3, 10):
        if np.allclose(part, np.round(part, digits), rtol=1e-12, atol=1e-12):
            return max(10.0**-digits, single)
    return single


def _gap_note(places: np.ndarray) -> tuple[str, ...]:
    steps = np.diff(places)
    gaps = steps[steps >= GAP]
    if not len(gaps):
        return ()
    return (
        f"{len(gaps)} gaps, {int(np.sum(np.round(gaps) - 1))} samples in all, the longest of {np.max(gaps) - 1:.0f}",
    )
