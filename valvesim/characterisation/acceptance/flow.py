"""Flow over current without load: gain, linearity, symmetry, hysteresis, null bias and lap (SAE ARP490, ISO 10770-1).

Symbols
    i_R rated current A, Q_R flow at i_R, tau lag of the meter s, r = |di/dt| rate of the current A/s"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.acceptance.cycle import Cycle, Loop, loop
from valvesim.characterisation.acceptance.metrics import (
    jackknife,
    loop_figures,
    merit,
    root_sum_square,
    saturation,
    slope_of,
    weighted_line,
)
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.errors import InputError

LINE = (0.05, 0.80)  # shares of rated current between which a polarity's straight line is laid


def dead_zone_of(c: Cycle) -> tuple[float, float]:
    """(half width, uncertainty) of a flow meter's dead zone, m^3/s: where it stops following on the way to null.

    On each branch the longest hold within a tenth of the largest output before the sign changes, if the output should
    have moved by ten resolutions meanwhile; the mean of the two. (0, 0) where there is none.
    """
    holds = []
    gain = np.max(c.rising[1]) / c.amplitude
    for sign, (current, y) in ((1.0, c.rising), (-1.0, c.falling)):
        order = np.argsort(sign * current, kind="stable")
        i, z = sign * current[order], sign * y[order]  # both now rise through null
        near = (z < 0.0) & (z > -0.1 * np.max(np.abs(y)))
        i, z = i[near], z[near]
        if len(z) < 2:
            return 0.0, 0.0
        still = 2.5 * c.resolution_at(float(sign * np.median(z)))
        if still == 0.0:
            return 0.0, 0.0
        starts = [0]
        for k in range(1, len(z)):
            if abs(z[k] - z[starts[-1]]) > still:
                starts.append(k)
        ends = np.array([*starts[1:], len(z)]) - 1
        first, last = i[np.array(starts)], i[ends]
        k = int(np.argmax(last - first))
        if gain * (last[k] - first[k]) < 10.0 * still:
            return 0.0, 0.0
        holds.append(abs(float(z[starts[k]])))
    return (holds[0] + holds[1]) / 2.0, abs(holds[0] - holds[1]) / 2.0


@dataclass(frozen=True)
class _FlowCurve:
    """A flow curve through null: both branches at equal flow, `live` (k,) where the meter follows; currents in A."""

    c: Cycle
    bend: Loop
    rated: float
    null: float
    live: np.ndarray
    reading: float


@dataclass(frozen=True)
class _Polarity:
    """One polarity of a flow curve: `gain` and `zero` (A) of its straight line, `normal` gain of the line from null.

    `gain_error` is the standard one of the gain, `deviation` (k,) that of the mid-line from the normal line, m^3/s.
    """

    gain: float
    zero: float
    gain_error: float
    normal: float
    deviation: np.ndarray


def _polarity(curve: _FlowCurve, sign: float) -> _Polarity | None:
    """The lines of one polarity; None where the record reaches too little of the rated current."""
    c, bend, rated, null, live, reading = (
        curve.c, curve.bend, curve.rated, curve.null, curve.live, curve.reading,
    )  # fmt: skip
    y, i = bend.output, bend.middle
    part = live & (sign * (i - null) > LINE[0] * rated) & (sign * i < LINE[1] * rated)
    side = live & (sign * (i - null) > 0.0)
    reaches = np.min(np.abs(i[[0, -1]])) >= 0.9 * rated * LINE[1]
    if not reaches or np.count_nonzero(part) < 10:
        return None
    at = {k: (v[part], y[part]) for k, v in (("mid", i), ("up", bend.rising), ("down", bend.falling))}
    slope, zero = weighted_line(*at["mid"])
    fit = jackknife(slope_of(*at["mid"]), len(at["mid"][0]))
    branches = (weighted_line(*at["up"])[0] - weighted_line(*at["down"])[0]) / 2.0
    flow_error = c.resolution_at(float(at["mid"][1][np.argmax(sign * at["mid"][1])])) / np.sqrt(12.0)
    length = (LINE[1] - LINE[0]) * rated
    error = root_sum_square(fit, branches, slope * reading / length, flow_error / length)
    weight, from_null = np.abs(np.gradient(y[side])), i[side] - null
    normal = float(np.sum(weight * from_null * y[side]) / np.sum(weight * from_null**2))
    return _Polarity(slope, zero, error, normal, y[side] - normal * from_null)


def _normal_line_figures(curve: _FlowCurve, lines: Sequence[_Polarity], null_error: float) -> FiguresOfMerit:
    """flow_at_rated, linearity and symmetry, by the normal lines of both polarities."""
    c, rated = curve.c, curve.rated
    held = saturation(c)
    if len(lines) < 2 or held:
        reason = held or "a polarity has no line"
        return tuple(Absent(name, reason) for name in ("flow_at_rated", "linearity", "symmetry"))
    gains = np.array([line.normal for line in lines])
    top = float(np.mean(gains) * rated)
    flow_error = c.resolution_at(0.9 * curve.bend.output[-1]) / np.sqrt(12.0)
    symmetry_error = root_sum_square(null_error / rated, flow_error / top) * np.sqrt(2.0)
    off = np.concatenate([line.deviation for line in lines])
    return (
        merit("flow_at_rated", top, root_sum_square(flow_error, np.ptp(gains) * rated / 2), "m^3/s",
              "|flow| at rated current by the normal lines, mean of both polarities"),
        merit("linearity", float(np.max(np.abs(off))) / top, flow_error / top, "1",
              "greatest deviation of the mid-line from the normal lines, share of Q_R"),
        merit("symmetry", float(np.ptp(gains) / np.max(gains)), symmetry_error, "1",
              "difference of the polarities' normal gains over the greater"),
    )  # fmt: skip


def _lap(curve: _FlowCurve, lines: Sequence[_Polarity]) -> FigureOfMerit | Absent:
    """Distance of the lines of negative and positive polarity at zero flow, share of i_R."""
    if len(lines) < 2:
        return Absent("lap", "a polarity has no line")
    negative, positive = lines
    lap = (positive.zero - negative.zero) / curve.rated
    errors = [line.gain_error / line.gain for line in lines]
    error = root_sum_square(*(e * LINE[1] / 2 for e in errors), np.sqrt(2.0) * curve.reading / curve.rated)
    return merit("lap", lap, error, "1", "distance of the lines at zero flow, + overlap, % i_R")


def flow_figures(
    c: Cycle, *, rated_current: float | None = None, lag: float | None = None, dead_zone: float | None = None
) -> FiguresOfMerit:
    """The figures of a flow curve over a full cycle.

    flow_at_rated: |flow| at i_R, mean of both polarities, by the normal lines' ends. flow_gain_negative/positive: slope
    of the mid-line between 5 and 80 % of i_R. linearity: greatest deviation of the mid-line from the normal lines (each
    from null, laid through its polarity), share of Q_R. symmetry: difference of the normal gains over the greater.
    hysteresis: greatest current difference at equal output off null (5 % of i_R), share of i_R, less 2 tau r where the
    lag is stated. null_loop: the same within it, with the meter's dead zone. null_bias: mid-line at zero flow. lap:
    distance at zero flow between the two polarities' lines, positive for overlap. All over i_R (`rated_current`, else
    the amplitude of the record). Source: ARP490, ISO 10770-1.
    """
    rated = c.amplitude if rated_current is None else rated_current
    bend = loop(c)
    y, i, width = bend.output, bend.middle, bend.width
    if y[0] > 0.0 or y[-1] < 0.0:
        raise InputError(f"{c.source}: the flow never changes sign: no flow curve through null")
    dead, dead_error = (dead_zone, 0.0) if dead_zone is not None else dead_zone_of(c)
    reading = c.current_resolution / np.sqrt(12.0)
    live = np.abs(y) > dead
    null = float(np.interp(0.0, y[live], i[live]))
    null_error = root_sum_square(reading, float(np.min(np.abs(i[live]))) / 2 if dead else 0.0)
    curve = _FlowCurve(c, bend, rated, null, live, reading)
    polarities = {"negative": _polarity(curve, -1.0), "positive": _polarity(curve, 1.0)}
    lines = [line for line in polarities.values() if line is not None]
    too_little = f"the record reaches too little of the rated current of {rated * 1e3:.4g} mA"
    off_null = (np.abs(i - null) > LINE[0] * rated) & live
    return (
        merit("polarity", c.polarity, 0.0, "-", "sign of flow at positive current"),
        merit("dead_zone", dead, dead_error, "m^3/s", "flow below which the meter does not follow"),
        merit("meter_resolution", c.resolution_at(0.9 * y[-1]), 0.0, "m^3/s", "of the flow near its largest"),
        *(
            Absent(f"flow_gain_{name}", too_little)
            if line is None
            else merit(f"flow_gain_{name}", line.gain, line.gain_error, "m^3/s/A",
                       "slope of the mid-line, 5 to 80 % of i_R")
            for name, line in polarities.items()
        ),
        *_normal_line_figures(curve, lines, null_error),
        *loop_figures(c, y[off_null], width[off_null], rated, lag, "off null"),
        merit("null_loop", float(np.max(width[~off_null], initial=0.0)), np.sqrt(2.0) * reading, "A",
              "greatest loop within 5 % of i_R; in the meter's dead zone it is the meter's"),
        merit("null_bias", null / rated, null_error / rated, "1", "mid-line current at zero flow, share of i_R"),
        _lap(curve, lines),
    )  # fmt: skip
