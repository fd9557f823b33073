"""What the figures of merit of all static tests share: straight lines, uncertainties, loops, saturation.

Uncertainties are standard ones, the root of the sum of squares of: resolution/sqrt(12) of each reading used, not
averaged down; half the difference between the branches (of their null-free part); and the fit, by a jackknife over ten
blocks, which also feels curvature and jumps of a meter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from valvesim.characterisation.acceptance.cycle import Cycle
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit

BLOCKS = 10  # of the jackknife
NULL_SHARE = 0.40  # of supply pressure, either way, over which pressure gain is told


def weighted_line(i: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(slope, current at zero) of the straight line through points, each weighted with its share of the output."""
    slope, offset = np.polyfit(i, y, 1, w=np.sqrt(np.abs(np.gradient(y))))
    return float(slope), float(-offset / slope)


def slope_of(i: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], float]:
    """The slope of the line through some of the points, as a function of which."""
    return lambda keep: weighted_line(i[keep], y[keep])[0]


def jackknife(function: Callable[[np.ndarray], float], points: int) -> float:
    """Standard error of a figure of `points` points, by leaving out one block of neighbours after another."""
    blocks = np.array_split(np.arange(points), min(BLOCKS, points // 2))
    values = [function(np.setdiff1d(np.arange(points), block)) for block in blocks]
    return float(np.sqrt((len(values) - 1) * np.var(values)))


def merit(name: str, value: float, uncertainty: float, unit: str, doc: str) -> FigureOfMerit:
    return FigureOfMerit(name, float(value), unit, doc, float(uncertainty))


def root_sum_square(*parts: float) -> float:
    return float(np.sqrt(np.sum(np.square(parts))))


def saturation(c: Cycle, extremes: tuple[Callable, ...] = (np.max, np.min)) -> str:
    """Why an extreme of the output cannot be trusted: it is held there; empty where it is not."""
    for current, y in (c.rising, c.falling):
        for extreme in (end(y) for end in extremes):
            inside = np.abs(y - extreme) <= 1e-6 * np.ptp(y)
            gain = np.ptp(y) / np.ptp(current)
            if np.ptp(current[inside]) * gain > max(3.0 * c.resolution_at(float(extreme)), 0.02 * np.ptp(y)):
                return f"the output is clipped or saturated at {extreme:.4g} (SI)"
    return ""


def loop_figures(c: Cycle, y, width, rated: float, lag: float | None, where: str) -> list[FigureOfMerit | Absent]:
    """hysteresis (share of i_R) and loop_width (A, median): the lag's 2 tau r taken off where it is stated."""
    if len(width) < 5:
        return [Absent("hysteresis", f"no outputs {where} on both branches")]
    calm = np.median(np.lib.stride_tricks.sliding_window_view(width, 5), axis=-1)  # one false level is no loop
    meter = 0.0 if lag is None else 2.0 * lag * c.rate
    reading = np.sqrt(2.0) * c.current_resolution / np.sqrt(12.0)
    scatter = float(1.4826 * np.median(np.abs(width - np.median(width))))
    note = "the meter's lag is in it" if lag is None else "meter lag taken off"
    return [
        merit("hysteresis", (float(np.max(calm)) - meter) / rated, root_sum_square(reading, scatter) / rated, "1",
                f"greatest current difference at equal output {where}, share of i_R; {note}"),
        merit("loop_width", float(np.median(width)) - meter, root_sum_square(reading, scatter), "A",
                f"median current difference at equal output {where}; {note}"),
    ]  # fmt: skip
