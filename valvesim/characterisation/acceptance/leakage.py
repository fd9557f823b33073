"""Leakage over current with blocked ports: null leakage, tare, hysteresis and the lag of the meter.

Symbols
    tau lag of the meter s, r = |di/dt| rate of the current A/s, s half the current between the branches A"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.characterisation.acceptance.cycle import Cycle, cycle
from valvesim.characterisation.acceptance.metrics import merit, root_sum_square, saturation
from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.errors import InputError


def leakage_figures(c: Cycle, *, lag: float | None = None) -> FiguresOfMerit:
    """The figures of the total leakage at blocked ports over a full cycle.

    null_leakage: greatest, mean of the branches' peaks. tare: least, mean over the outer 5 % of either end: pilot stage
    and closed lands; absent where the curve still falls there. peak_current: middle between the peaks, A. half_split:
    half the current between the branches, by the shift that lays one upon the other over the null region. hysteresis:
    twice that, less 2 tau r; absent unless the lag is stated, since one record cannot part the two (see
    `common_hysteresis`). Source: ARP490, ISO 10770-1.
    """
    grid, up, down = branch_curves(c)
    shift, null, shift_error = half_split(c)
    tops = [float(_peak(grid, v)[1]) for v in (up, down)]
    step = c.resolution_at(tops[0]) / np.sqrt(12.0)
    noise = float(1.4826 * np.median(np.abs(np.diff((up + down) / 2, 2))) / np.sqrt(6.0))
    outer = [np.abs(grid - end) <= 0.05 * np.ptp(grid) for end in (grid[0], grid[-1])]
    ends = np.array([[np.mean(v[o]) for o in outer] for v in (up, down)])
    inner = [np.abs(grid - end) <= 0.05 * np.ptp(grid) for end in (0.8 * grid[0], 0.8 * grid[-1])]
    falls = float(np.mean([np.mean((up + down)[o]) for o in inner]) / 2.0 - np.mean(ends))
    figures: list[FigureOfMerit | Absent] = []
    if saturated := saturation(c, (np.max,)):
        figures.append(Absent("null_leakage", saturated))
    else:
        error = root_sum_square(step, noise, (tops[0] - tops[1]) / 2)
        doc = "greatest leakage, mean of both branches"
        figures.append(merit("null_leakage", float(np.mean(tops)), error, "m^3/s", doc))
    if falls > 0.02 * (np.mean(tops) - np.mean(ends)):
        figures.append(Absent("tare", "the leakage still falls at the ends of the record: run to rated current"))
    else:
        error = root_sum_square(step, noise, float(np.std(ends)))
        doc = "least leakage: pilot stage and closed lands, outer 5 % of the current"
        figures.append(merit("tare", float(np.mean(ends)), error, "m^3/s", doc))
    reading = c.current_resolution / np.sqrt(12.0)
    figures += [
        merit("peak_current", null, root_sum_square(reading, shift_error), "A", "middle between the branches' peaks"),
        merit("half_split", shift, shift_error, "A", "half the current between the branches, lag of the meter in it"),
        merit("rate", c.rate, 0.0, "A/s", "rate of the current"),
    ]
    if lag is None:
        figures.append(Absent("hysteresis", "one record cannot part it from the meter's lag: state the lag, or use "
                              "common_hysteresis with a record of another period"))  # fmt: skip
    else:
        figures.append(merit("hysteresis", 2.0 * (shift - lag * c.rate), 2.0 * shift_error, "A",
                              "current between the branches, meter lag taken off"))  # fmt: skip
    return tuple(figures)


def branch_curves(c: Cycle, *, points: int = 100) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(current, rising, falling), each (k,): the mean output of both branches over as many samples each."""
    low, high = max(np.min(c.rising[0]), np.min(c.falling[0])), min(np.max(c.rising[0]), np.max(c.falling[0]))
    current = np.concatenate([c.rising[0], c.falling[0]])
    current = current[(current >= low) & (current <= high)]
    quantised = c.resolution_at(float(np.median(c.rising[1]))) > 0.0
    finest = len(c.rising[0]) // (4 if quantised else 2)
    points = max(points, min(int(8 * (high - low) / _peak_width(c)), finest) if quantised else finest)
    edges = np.quantile(current, np.linspace(0.0, 1.0, points + 1))  # finer where the current is slower

    def means(current: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = np.clip(np.digitize(current, edges) - 1, 0, points - 1)
        count = np.bincount(place, minlength=points)
        filled = count > 0
        return (np.bincount(place, current, points)[filled] / count[filled],
                np.bincount(place, y, points)[filled] / count[filled])  # fmt: skip

    grid = (edges[1:] + edges[:-1]) / 2.0
    return grid, np.interp(grid, *means(*c.rising)), np.interp(grid, *means(*c.falling))


def _peak_width(c: Cycle) -> float:
    """Current over which the output is above half of its rise, A."""
    current, y = c.rising
    return float(np.ptp(current[y > (np.percentile(y, 5) + np.max(y)) / 2.0]))


def _peak(grid: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(place, height) of the greatest value, by a parabola over three values, or nine where they are noisy."""
    bend = np.abs(np.diff(y, 2))
    n = 1 if np.median(bend) < 1e-4 * np.ptp(y) else 4
    k = int(np.clip(np.argmax(y), n, len(y) - n - 1))
    a, b, d = np.polyfit(grid[k - n : k + n + 1] - grid[k], y[k - n : k + n + 1], 2)
    if a >= 0.0:
        return float(grid[k]), float(y[k])
    return float(grid[k] - b / 2 / a), float(d - b * b / 4 / a)


def half_split(c: Cycle, *, lag: float = 0.0) -> tuple[float, float, float]:
    """(half split, middle, uncertainty) of the branches of a peaked output, A.

    The shift s that best lays the rising branch at +s upon the falling at -s (each scaled and offset freely, since a
    branch may be higher) over the null region; the uncertainty holds the change of s between regions of one, one and a
    half and two peak widths, the parabolas through the peaks, and resolution. With `lag` (s) the branches are first
    freed of a first-order lag: y + lag dy/dt.
    """
    from scipy.optimize import minimize_scalar

    grid, up, down = branch_curves(c)
    up, down = up + lag * c.rate * np.gradient(up, grid), down - lag * c.rate * np.gradient(down, grid)
    peaks = [_peak(grid, v)[0] for v in (up, down)]
    by_peaks, middle, width = (peaks[0] - peaks[1]) / 2.0, (peaks[0] + peaks[1]) / 2.0, _peak_width(c)

    def misfit(s: float, reach: float) -> float:
        x = middle + np.linspace(-reach, reach, 121)
        a, b = np.interp(x + s, grid, up), np.interp(x - s, grid, down)
        basis = np.column_stack([b, np.ones_like(b)])
        return float(np.sum((a - basis @ np.linalg.lstsq(basis, a, rcond=None)[0]) ** 2) / np.sum((a - a.mean()) ** 2))

    shifts = []
    for share in (1.0, 1.5, 2.0):
        reach = min(share * width, (grid[-1] - abs(middle)) - abs(by_peaks) - 0.1 * width)
        if reach <= 0.2 * width:
            raise InputError(f"{c.source}: the current hardly passes the leakage peak; sweep further")
        bounds = (by_peaks - 0.5 * width, by_peaks + 0.5 * width)
        best = minimize_scalar(misfit, bounds=bounds, args=(reach,), method="bounded", options={"xatol": 1e-9})
        shifts.append(best.x)
    shift = float(np.mean(shifts))
    error = root_sum_square(float(np.std(shifts)), (shift - by_peaks) / 2.0, c.current_resolution / np.sqrt(12.0) / 4.0)
    return shift, middle, error


def common_hysteresis(records: Sequence[AcceptanceRecord], *, resolution: float | None = None) -> FiguresOfMerit:
    """Hysteresis of the valve and lag of the meter from leakage records of one amplitude and two or more rates.

    The half splits obey s = h + tau r (the valve's half loop is the same at every rate, the meter's grows with it);
    least squares. Uncertainties: those of the splits propagated, scaled up where three or more records disagree, and
    half the change when the meter is taken for a first-order lag (branches freed of it, equal splits sought) instead
    of a delay. Returns half_hysteresis (A), hysteresis (A) and lag (s). Raises InputError for fewer than two rates.
    Valid while tau r is small against the width of the peak; faster records bend the line and feign hysteresis.
    """
    cycles = [cycle(record, "internal_leakage", resolution=resolution) for record in records]
    rates = np.array([c.rate for c in cycles])
    if len(cycles) < 2 or np.max(rates) < 1.2 * np.min(rates):
        raise InputError("common hysteresis: needs records of two or more rates of current, 20 % apart or more")

    def solve(lag: float) -> tuple[np.ndarray, np.ndarray]:
        """(h, remaining lag) and their covariance after a first-order lag has been taken off."""
        splits = [half_split(c, lag=lag) for c in cycles]
        s, error = np.array([x[0] for x in splits]), np.array([max(x[2], 1e-12) for x in splits])
        A = np.column_stack([np.ones_like(rates), rates]) / error[:, None]
        covariance = np.linalg.inv(A.T @ A)
        best = covariance @ A.T @ (s / error)
        if len(s) > 2:
            covariance = covariance * max(1.0, float(np.sum((A @ best - s / error) ** 2) / (len(s) - 2)))
        return best, covariance

    (h, lag), covariance = solve(0.0)
    low, high = 0.0, 3.0 * max(lag, 0.0)
    for _ in range(20 if lag > 0.0 else 0):  # the first-order lag that leaves nothing over
        middle = (low + high) / 2.0
        low, high = (middle, high) if solve(middle)[0][1] > 0.0 else (low, middle)
    first_order = (low + high) / 2.0
    other = solve(first_order)[0][0] if lag > 0.0 else h
    h_error = root_sum_square(float(np.sqrt(covariance[0, 0])), (other - h) / 2.0)
    lag_error = root_sum_square(float(np.sqrt(covariance[1, 1])), (first_order - lag) / 2.0 if lag > 0.0 else 0.0)
    return (
        merit("half_hysteresis", float(h), h_error, "A", "half the current between the branches at zero rate"),
        merit("hysteresis", 2.0 * float(h), 2.0 * h_error, "A", "current between the branches at zero rate"),
        merit("lag", float(lag), lag_error, "s", "delay of the meter"),
    )
