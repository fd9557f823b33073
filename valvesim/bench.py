"""The static bench tests of a servo valve, reduced by the same functions from a simulated or a measured record.

Symbols
    i current A, i_R rated current, y output (load flow m^3/s, load pressure Pa, leakage m^3/s), Q_R flow at i_R
    rising, falling: the two branches of a slow full cycle; mid-line: mean current of both at equal output
    tau meter lag s, r = |di/dt| rate of the current A/s, p_s supply, p_L load pressure, p_v valve pressure drop
Definitions follow SAE ARP490 and ISO 10770-1 as collected in field.md section 4; each `*_figures` states them.

A figure that a record cannot give is `Absent` with its reason. Uncertainties are standard ones, the root of the sum of
squares of: resolution/sqrt(12) of each reading used, not averaged down; half the difference between the branches (of
their null-free part); and the fit, by a jackknife over ten blocks, which also feels curvature and jumps of a meter.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .commands import Command, Constant, Table
from .effects import ActiveEffect
from .errors import InputError, SolveError, ValidityWarning, unknown_name
from .figures import Absent, Figure, Figures
from .files import read_columns
from .fluid import MIL_PRF_5606, Oil
from .model import FLOW_FORCE_FACTOR, main_stage
from .parameters import Coefficients, PartTemperatures, Valve
from .scenario import Scenario, Thermal
from .simulate import simulate
from .static import solve_rest

TESTS = ("flow", "pressure-gain", "leakage", "flow-load")
RATED_DROP = 7e6  # Pa, valve pressure drop at which flow is rated (1000 psi)
LEAST_POINTS = 50  # of a branch
LINE = (0.05, 0.80)  # shares of rated current between which a polarity's straight line is laid
NULL_SHARE = 0.40  # of supply pressure, either way, over which pressure gain is told
GAP = 5.0  # times the usual sampling interval: longer is a gap
BLOCKS = 10  # of the jackknife


@dataclass(frozen=True, kw_only=True)
class Record:
    """A bench record: `values[name]` (n,) in SI for `time` and any of current, load_flow, load_pressure,
    internal_leakage and pressure_drop; `source` names the file or run. Raises InputError for gaps and false lengths.
    """  # fmt: skip

    source: str
    values: dict[str, np.ndarray]

    def __post_init__(self):
        t = self.channel("time")
        for name, v in self.values.items():
            if np.shape(v) != t.shape or t.ndim != 1 or not np.all(np.isfinite(v)):
                raise InputError(f"{self.source}: column {name!r} has gaps, or not as many values as the time")
        if len(t) < 2 * LEAST_POINTS:
            raise InputError(f"{self.source}: {len(t)} samples; a bench record needs {2 * LEAST_POINTS} or more")
        steps = np.diff(t)
        k, usual = int(np.argmax(steps)), float(np.median(steps))
        if np.min(steps) < 0.0 or usual <= 0.0:
            raise InputError(f"{self.source}: time must rise")
        if steps[k] > GAP * usual:
            where = f"{steps[k]:.4g} s at {t[k]:.6g} s (samples come every {usual:.4g} s)"
            raise InputError(f"{self.source}: gap of {where}")

    def channel(self, name: str) -> np.ndarray:
        """The values of a channel; InputError where the record has no such column."""
        if name not in self.values:
            have = ", ".join(self.values)
            raise InputError(f"{self.source}: no column {name!r}, which this test needs; it has {have}")
        return self.values[name]


_UNITS = {
    "time": "s", "current": "A", "load_flow": "m^3/s", "load_pressure": "Pa", "internal_leakage": "m^3/s",
    "pressure_drop": "Pa",
}  # fmt: skip
_PLAIN = dict(zip(
    ("t_s", "current_A", "flow_m3s", "load_pressure_Pa", "leak_flow_m3s", "pressure_drop_Pa"), _UNITS, strict=True
))  # fmt: skip


def read_record(path: str | Path) -> Record:
    """A record from CSV: header `time [s],current [mA],load_flow [L/min],...` with any unit, or SI by plain names.

    Known columns: time, current, load_flow, load_pressure, internal_leakage, pressure_drop; plain ones are t_s,
    current_A, flow_m3s, load_pressure_Pa, leak_flow_m3s, pressure_drop_Pa. Others are left out.
    Raises InputError for a missing file, time column or unit, cells that are no numbers, and gaps.
    """
    path = Path(path)
    try:
        with open(path, encoding="utf-8-sig") as file:
            names = [name.strip().strip('"') for name in next((line for line in file if line.strip()), "").split(",")]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not any(name in _PLAIN for name in names):
        bare = [name.partition("[")[0].strip() for name in names]
        found = {name: unit for name, unit in _UNITS.items() if name in bare or name == "time"}
        return Record(source=path.name, values=read_columns(path, found))
    if "t_s" not in names:
        raise InputError(f"{path}: no column 't_s' (or 'time [s]')")
    try:
        data = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return Record(source=path.name, values={_PLAIN[n]: data[:, k] for k, n in enumerate(names) if n in _PLAIN})


# ---------------------------------------------------------------- cycles, branches and loops


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
        return _spacing(np.concatenate([self.rising[1], self.falling[1]]), output)


def _spacing(values: np.ndarray, at: float) -> float:
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


def cycle(record: Record, channel: str, *, resolution: float | None = None) -> Cycle:
    """The branches of a record whose current runs slowly from end to end; all of one direction are put together.

    A quantised current is smoothed over two of its steps; the ends that this bends are left out. A branch counts where
    it spans 80 % of the whole range. InputError without a branch each way, with fewer than 50 points in one, or with a
    current that is clipped or held.
    """
    t, i, y = record.channel("time"), record.channel("current"), record.channel(channel)
    span = float(np.ptp(i))
    if span <= 0.0 or np.ptp(y) <= 0.0:
        raise InputError(f"{record.source}: {'current' if span <= 0.0 else channel} never changes: no cycle")
    turns = _turns(i)
    legs = [(a, b) for a, b in zip(turns[:-1], turns[1:], strict=True) if abs(i[b - 1] - i[a]) >= 0.8 * span]
    up = [leg for leg in legs if i[leg[1] - 1] > i[leg[0]]]
    down = [leg for leg in legs if i[leg[1] - 1] < i[leg[0]]]
    if not up or not down:
        raise InputError(f"{record.source}: no complete cycle: the current never runs from end to end and back")
    shortest = min(b - a for a, b in legs)
    if shortest < LEAST_POINTS:
        raise InputError(
            f"{record.source}: {2 * shortest} points in a period are too few; {2 * LEAST_POINTS} or more are needed"
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


# ---------------------------------------------------------------- figures


def _line(i: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(slope, current at zero) of the straight line through points, each weighted with its share of the output."""
    slope, offset = np.polyfit(i, y, 1, w=np.sqrt(np.abs(np.gradient(y))))
    return float(slope), float(-offset / slope)


def _slope_of(i: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], float]:
    """The slope of the line through some of the points, as a function of which."""
    return lambda keep: _line(i[keep], y[keep])[0]


def _jackknife(function: Callable[[np.ndarray], float], points: int) -> float:
    """Standard error of a figure of `points` points, by leaving out one block of neighbours after another."""
    blocks = np.array_split(np.arange(points), min(BLOCKS, points // 2))
    values = [function(np.setdiff1d(np.arange(points), block)) for block in blocks]
    return float(np.sqrt((len(values) - 1) * np.var(values)))


def _figure(name: str, value: float, uncertainty: float, unit: str, doc: str) -> Figure:
    return Figure(name, float(value), unit, doc, float(uncertainty))


def _total(*parts: float) -> float:
    return float(np.sqrt(np.sum(np.square(parts))))


def flow_figures(
    c: Cycle, *, rated_current: float | None = None, lag: float | None = None, dead_zone: float | None = None
) -> Figures:
    """The figures of a flow curve over a full cycle.

    flow_at_rated: |flow| at i_R, mean of both polarities, by the normal lines' ends. flow_gain_negative/positive: slope
    of the mid-line between 5 and 80 % of i_R. linearity: greatest deviation of the mid-line from the normal lines (each
    from null, laid through its polarity), share of Q_R. symmetry: difference of the normal gains over the greater.
    hysteresis: greatest current difference at equal output off null (5 % of i_R), share of i_R, less 2 tau r where the
    lag is stated. null_loop: the same within it, with the meter's dead zone. null_bias: mid-line at zero flow. lap:
    distance at zero flow between the two polarities' lines, positive for overlap. All over i_R (`rated_current`, else
    the amplitude of the record). Source: ARP490, ISO 10770-1 (field.md 4).
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
    null_error = _total(reading, float(np.min(np.abs(i[live]))) / 2 if dead else 0.0)
    figures: list[Figure | Absent] = [
        _figure("polarity", c.polarity, 0.0, "-", "sign of flow at positive current"),
        _figure("dead_zone", dead, dead_error, "m^3/s", "flow below which the meter does not follow"),
        _figure("meter_resolution", c.resolution_at(0.9 * y[-1]), 0.0, "m^3/s", "of the flow near its largest"),
    ]
    reaches = np.min(np.abs(i[[0, -1]])) >= 0.9 * rated * LINE[1]
    lines, normal, deviation = {}, {}, {}
    for name, sign in (("negative", -1.0), ("positive", 1.0)):
        part = live & (sign * (i - null) > LINE[0] * rated) & (sign * i < LINE[1] * rated)
        side = live & (sign * (i - null) > 0.0)
        if not reaches or np.count_nonzero(part) < 10:
            reason = f"the record reaches too little of the rated current of {rated * 1e3:.4g} mA"
            figures.append(Absent(f"flow_gain_{name}", reason))
            continue
        at = {k: (v[part], y[part]) for k, v in (("mid", i), ("up", bend.rising), ("down", bend.falling))}
        lines[name] = _line(*at["mid"])
        slope = lines[name][0]
        fit = _jackknife(_slope_of(*at["mid"]), len(at["mid"][0]))
        branches = (_line(*at["up"])[0] - _line(*at["down"])[0]) / 2.0
        flow_error = c.resolution_at(float(at["mid"][1][np.argmax(sign * at["mid"][1])])) / np.sqrt(12.0)
        length = (LINE[1] - LINE[0]) * rated
        error = _total(fit, branches, slope * reading / length, flow_error / length)
        figures.append(_figure(f"flow_gain_{name}", slope, error, "m^3/s/A", "slope of the mid-line, 5 to 80 % of i_R"))
        weight, from_null = np.abs(np.gradient(y[side])), i[side] - null
        normal[name] = float(np.sum(weight * from_null * y[side]) / np.sum(weight * from_null**2))
        deviation[name] = y[side] - normal[name] * from_null
    held = _saturation(c)
    if len(lines) < 2 or held:
        reason = held or "a polarity has no line"
        figures += [Absent(name, reason) for name in ("flow_at_rated", "linearity", "symmetry")]
    else:
        gains = np.array(list(normal.values()))
        top = float(np.mean(gains) * rated)
        flow_error = c.resolution_at(0.9 * y[-1]) / np.sqrt(12.0)
        symmetry_error = _total(null_error / rated, flow_error / top) * np.sqrt(2.0)
        off = np.concatenate(list(deviation.values()))
        figures += [
            _figure("flow_at_rated", top, _total(flow_error, np.ptp(gains) * rated / 2), "m^3/s",
                    "|flow| at rated current by the normal lines, mean of both polarities"),
            _figure("linearity", float(np.max(np.abs(off))) / top, flow_error / top, "1",
                    "greatest deviation of the mid-line from the normal lines, share of Q_R"),
            _figure("symmetry", float(np.ptp(gains) / np.max(gains)), symmetry_error, "1",
                    "difference of the polarities' normal gains over the greater"),
        ]  # fmt: skip
    off_null = (np.abs(i - null) > LINE[0] * rated) & live
    figures += _loop_figures(c, y[off_null], width[off_null], rated, lag, "off null")
    figures += [
        _figure("null_loop", float(np.max(width[~off_null], initial=0.0)), np.sqrt(2.0) * reading, "A",
                "greatest loop within 5 % of i_R; in the meter's dead zone it is the meter's"),
        _figure("null_bias", null / rated, null_error / rated, "1", "mid-line current at zero flow, share of i_R"),
    ]  # fmt: skip
    if len(lines) == 2:
        lap = (lines["positive"][1] - lines["negative"][1]) / rated
        errors = [(f.uncertainty or 0.0) / f.value for f in figures if isinstance(f, Figure) and "gain" in f.name]
        lap_error = _total(*(e * LINE[1] / 2 for e in errors), np.sqrt(2.0) * reading / rated)
        figures.append(_figure("lap", lap, lap_error, "1", "distance of the lines at zero flow, + overlap, % i_R"))
    else:
        figures.append(Absent("lap", "a polarity has no line"))
    return tuple(figures)


def _saturation(c: Cycle, extremes: tuple[Callable, ...] = (np.max, np.min)) -> str:
    """Why an extreme of the output cannot be trusted: it is held there; empty where it is not."""
    for current, y in (c.rising, c.falling):
        for extreme in (end(y) for end in extremes):
            inside = np.abs(y - extreme) <= 1e-6 * np.ptp(y)
            gain = np.ptp(y) / np.ptp(current)
            if np.ptp(current[inside]) * gain > max(3.0 * c.resolution_at(float(extreme)), 0.02 * np.ptp(y)):
                return f"the output is clipped or saturated at {extreme:.4g} (SI)"
    return ""


def _loop_figures(c: Cycle, y, width, rated: float, lag: float | None, where: str) -> list[Figure | Absent]:
    """hysteresis (share of i_R) and loop_width (A, median): the lag's 2 tau r taken off where it is stated."""
    if len(width) < 5:
        return [Absent("hysteresis", f"no outputs {where} on both branches")]
    calm = np.median(np.lib.stride_tricks.sliding_window_view(width, 5), axis=-1)  # one false level is no loop
    meter = 0.0 if lag is None else 2.0 * lag * c.rate
    reading = np.sqrt(2.0) * c.current_resolution / np.sqrt(12.0)
    scatter = float(1.4826 * np.median(np.abs(width - np.median(width))))
    note = "the meter's lag is in it" if lag is None else "meter lag taken off"
    return [
        _figure("hysteresis", (float(np.max(calm)) - meter) / rated, _total(reading, scatter) / rated, "1",
                f"greatest current difference at equal output {where}, share of i_R; {note}"),
        _figure("loop_width", float(np.median(width)) - meter, _total(reading, scatter), "A",
                f"median current difference at equal output {where}; {note}"),
    ]  # fmt: skip


def pressure_gain_figures(c: Cycle, *, rated_current: float | None = None, lag: float | None = None) -> Figures:
    """The figures of the load pressure at blocked ports over a full cycle.

    supply_pressure: the plateau of the load pressure. pressure_gain: slope of the mid-line over +-40 % of it.
    pressure_gain_share: the same as share of supply per share of i_R. null_bias: mid-line at zero load pressure.
    hysteresis: greatest current difference at equal pressure within +-40 %, share of i_R. zero_rising, zero_falling:
    current at zero load pressure. Source: ARP490, ISO 10770-1 (field.md 4).
    """
    rated = c.amplitude if rated_current is None else rated_current
    bend = loop(c, bins=1000)
    ends = [float(np.median(np.sort(sign * c.rising[1])[-len(c.rising[1]) // 10 :])) for sign in (1.0, -1.0)]
    supply = (ends[0] + ends[1]) / 2.0
    reading, step = c.current_resolution / np.sqrt(12.0), c.resolution_at(ends[0]) / np.sqrt(12.0)
    inside = np.abs(bend.output) <= NULL_SHARE * supply
    reached = bend.output[0] <= -NULL_SHARE * supply and bend.output[-1] >= NULL_SHARE * supply
    if np.count_nonzero(inside) < 5 or not reached:
        few = f"{np.count_nonzero(inside)} points within +-40 % of supply pressure: sweep more slowly"
        return tuple(
            Absent(name, few if reached else "the load pressure does not pass +-40 % of supply pressure")
            for name in ("pressure_gain", "pressure_gain_share", "null_bias", "hysteresis")
        )
    y = np.linspace(-NULL_SHARE, NULL_SHARE, 41) * supply  # evenly, whatever the sampling
    mid, up, down = (np.interp(y, bend.output, v) for v in (bend.middle, bend.rising, bend.falling))
    slope = _line(mid, y)[0]
    fit = _jackknife(_slope_of(mid, y), len(y))
    branches = (_line(up, y)[0] - _line(down, y)[0]) / 2.0
    error = _total(fit, branches, slope * np.sqrt(2.0) * reading / np.ptp(mid))
    zeros = [float(np.interp(0.0, y, v)) for v in (up, down)]
    null = (zeros[0] + zeros[1]) / 2.0
    return (
        _figure("supply_pressure", supply, _total(step, (ends[0] - ends[1]) / 2), "Pa", "plateau of the load pressure"),
        _figure("pressure_gain", slope, error, "Pa/A", "slope of the mid-line over +-40 % of supply"),
        _figure("pressure_gain_share", slope * rated / supply, error * rated / supply, "-",
                "share of supply pressure per share of i_R: % per 1 %"),
        _figure("zero_rising", zeros[0], reading, "A", "current at zero load pressure, rising"),
        _figure("zero_falling", zeros[1], reading, "A", "the same, falling"),
        _figure("null_bias", null / rated, reading / rated, "1", "mid-line at zero load pressure, share of i_R"),
        *_loop_figures(c, y, up - down, rated, lag, "within 40 % of supply"),
    )  # fmt: skip


def leakage_figures(c: Cycle, *, lag: float | None = None) -> Figures:
    """The figures of the total leakage at blocked ports over a full cycle.

    null_leakage: greatest, mean of the branches' peaks. tare: least, mean over the outer 5 % of either end: pilot stage
    and closed lands; absent where the curve still falls there. peak_current: middle between the peaks, A. half_split:
    half the current between the branches, by the shift that lays one upon the other over the null region. hysteresis:
    twice that, less 2 tau r; absent unless the lag is stated, since one record cannot part the two (see
    `common_hysteresis`). Source: ARP490, ISO 10770-1 (field.md 4).
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
    figures: list[Figure | Absent] = []
    if saturated := _saturation(c, (np.max,)):
        figures.append(Absent("null_leakage", saturated))
    else:
        error = _total(step, noise, (tops[0] - tops[1]) / 2)
        doc = "greatest leakage, mean of both branches"
        figures.append(_figure("null_leakage", float(np.mean(tops)), error, "m^3/s", doc))
    if falls > 0.02 * (np.mean(tops) - np.mean(ends)):
        figures.append(Absent("tare", "the leakage still falls at the ends of the record: run to rated current"))
    else:
        error = _total(step, noise, float(np.std(ends)))
        doc = "least leakage: pilot stage and closed lands, outer 5 % of the current"
        figures.append(_figure("tare", float(np.mean(ends)), error, "m^3/s", doc))
    reading = c.current_resolution / np.sqrt(12.0)
    figures += [
        _figure("peak_current", null, _total(reading, shift_error), "A", "middle between the branches' peaks"),
        _figure("half_split", shift, shift_error, "A", "half the current between the branches, lag of the meter in it"),
        _figure("rate", c.rate, 0.0, "A/s", "rate of the current"),
    ]
    if lag is None:
        figures.append(Absent("hysteresis", "one record cannot part it from the meter's lag: state the lag, or use "
                              "common_hysteresis with a record of another period"))  # fmt: skip
    else:
        figures.append(_figure("hysteresis", 2.0 * (shift - lag * c.rate), 2.0 * shift_error, "A",
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
    error = _total(float(np.std(shifts)), (shift - by_peaks) / 2.0, c.current_resolution / np.sqrt(12.0) / 4.0)
    return shift, middle, error


def common_hysteresis(records: Sequence[Record], *, resolution: float | None = None) -> Figures:
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
    h_error = _total(float(np.sqrt(covariance[0, 0])), (other - h) / 2.0)
    lag_error = _total(float(np.sqrt(covariance[1, 1])), (first_order - lag) / 2.0 if lag > 0.0 else 0.0)
    return (
        _figure("half_hysteresis", float(h), h_error, "A", "half the current between the branches at zero rate"),
        _figure("hysteresis", 2.0 * float(h), 2.0 * h_error, "A", "current between the branches at zero rate"),
        _figure("lag", float(lag), lag_error, "s", "delay of the meter"),
    )


def flow_load_figures(record: Record, *, resolution: float | None = None) -> Figures:
    """The figures of flow over valve pressure drop at full current.

    flow_exponent: n of Q ~ p_v^n over the record (0.5 for turbulent orifices). rated_flow: flow at 70 bar valve drop by
    that law; absent where the record does not span it. Each level of a quantised flow counts with the mean of its
    pressures. Source: ARP490, ISO 10770-1 (field.md 4).
    """
    p, q = record.channel("pressure_drop"), np.abs(record.channel("load_flow"))
    good = p > 0.0
    edges = np.linspace(np.min(q), np.max(q) * (1 + 1e-9), 201)
    place = np.digitize(q[good], edges)
    count = np.bincount(place)
    kept = count > 0
    pressure, flow = (np.bincount(place, v[good])[kept] / count[kept] for v in (p, q))
    if len(flow) > 12:  # the first and last level are cut short
        pressure, flow = pressure[1:-1], flow[1:-1]
    if len(flow) < 5 or np.max(pressure) < 2.0 * np.min(pressure):
        reason = "the pressure drop spans less than a factor of two"
        return (Absent("flow_exponent", reason), Absent("rated_flow", reason))
    x, z = np.log(pressure / RATED_DROP), np.log(flow)
    n, at = np.polyfit(x, z, 1)
    step = _spacing(q, float(np.median(q))) if resolution is None else resolution
    error = _jackknife(lambda keep: float(np.polyfit(x[keep], z[keep], 1)[0]), len(x))
    rated: Figure | Absent = Absent("rated_flow", "70 bar valve drop is outside the record")
    if np.min(p) <= RATED_DROP <= np.max(p):
        near = np.abs(x) < 0.25 if np.count_nonzero(np.abs(x) < 0.25) >= 4 else np.full(x.shape, True)
        x, z = x[near], z[near]
        at = np.polyfit(x, z, 2 if len(x) >= 20 else 1)[-1]
        level = _jackknife(lambda keep: float(np.exp(np.polyfit(x[keep], z[keep], 1)[1])), len(x))
        error_at = _total(level, step / np.sqrt(12.0))
        rated = _figure("rated_flow", float(np.exp(at)), error_at, "m^3/s", "flow at full current, 70 bar valve drop")
    return (_figure("flow_exponent", float(n), error, "-", "n of Q ~ p^n"), rated)


def measured(
    record: Record, test: str, *, resolution: float | None = None, lag: float | None = None,
    dead_zone: float | None = None, rated_current: float | None = None,
) -> Figures:  # fmt: skip
    """The figures of a measured record by test: "flow", "pressure-gain", "leakage" or "flow-load".

    `resolution` of the output, `lag` (s) and `dead_zone` (m^3/s) of the meter are as stated; what is not is estimated
    from the record or said to be missing. `rated_current` (A) is the record's amplitude by default.
    Raises InputError for an unknown test, missing columns, no complete cycle, too few points, or a clipped current.
    """
    if test == "flow":
        c = cycle(record, "load_flow", resolution=resolution)
        return (
            *flow_figures(c, rated_current=rated_current, lag=lag, dead_zone=dead_zone),
            Absent("threshold", "needs a stop and a reversal of the current, which this record does not hold"),
        )
    if test == "pressure-gain":
        c = cycle(record, "load_pressure", resolution=resolution)
        return pressure_gain_figures(c, rated_current=rated_current, lag=lag)
    if test == "leakage":
        return leakage_figures(cycle(record, "internal_leakage", resolution=resolution), lag=lag)
    if test == "flow-load":
        return flow_load_figures(record, resolution=resolution)
    raise unknown_name("test", test, TESTS)


# ---------------------------------------------------------------- the simulated bench


@dataclass(frozen=True, kw_only=True)
class Bench:
    """A simulated bench: `figures` named `test.figure`, and the records they come from.

    `flow` (no load) and `blocked` hold one full cycle each, `flow_load` one record per held current with `current`,
    load_pressure, load_flow and pressure_drop.
    """

    valve: Valve
    oil_temperature: float
    figures: Figures
    flow: Record
    blocked: Record
    flow_load: tuple[Record, ...]


@dataclass(frozen=True, kw_only=True)
class _Rig:
    """A valve on the bench: everything that a test does not change."""

    valve: Valve
    oil: Oil
    oil_temperature: float
    effects: tuple[ActiveEffect, ...]
    period: float
    points: int

    def run(self, command: Command, duration: float, *, load_pressure: Command | None = None) -> dict[str, np.ndarray]:
        """All channels and "time" of an isothermal run."""
        result = simulate(
            Scenario(
                title="bench",
                duration=duration,
                valve=self.valve,
                oil=self.oil,
                thermal=Thermal(network=None),
                oil_temperature=Constant(value=self.oil_temperature),
                command=command,
                load_pressure=load_pressure,
                effects=self.effects,
                output_rate=1.25 * self.points / duration,
                tolerance=1e-6,
            )
        )
        return {"time": result.time, **result.values}

    def full_cycle(self, *, null: float | None = None) -> dict[str, np.ndarray]:
        """A triangle from i_R to -i_R and back; with `null` (A) half of the time is spent within 5 % of i_R of it."""
        top, quarter = float(self.valve.rated_current), self.period / 4.0
        times, currents = [0.0, quarter, 3 * quarter, 5 * quarter], [0.0, top, -top, top]
        if null is not None:
            slow = np.clip([null + 0.05 * top, null - 0.05 * top], -0.9 * top, 0.9 * top)
            times[2:] = [1.5 * quarter, 2.5 * quarter, 3 * quarter, 3.5 * quarter, 4.5 * quarter, 5 * quarter]
            currents[2:] = [*slow, -top, *slow[::-1], top]
        values = self.run(Table(times=tuple(times), values=tuple(currents)), 5 * quarter)
        whole = values["time"] >= quarter * (1 - 1e-9)
        return {name: v[whole] for name, v in values.items()}

    def coefficients(self) -> Coefficients:
        """The coefficients at the oil's temperature, changed by the effects."""
        parts = PartTemperatures.uniform(self.oil_temperature)
        c = self.valve.at(parts, oil=self.oil)
        for active in self.effects:
            if active.effect.coefficients is not None:
                c = active.effect.coefficients(c, active.values, parts)
        return c

    def null(self) -> float:
        """Mid-line current at zero flow, A."""
        values = self.full_cycle()
        bend = loop(cycle(_record("null", values, "load_flow"), "load_flow"))
        return float(np.interp(0.0, bend.output, bend.middle))


def bench(
    valve: Valve,
    *,
    oil_temperature: float = 20.0,
    oil: Oil = MIL_PRF_5606,
    effects: Sequence[ActiveEffect] = (),
    period: float = 1e4,
    points: int = 8000,
    progress: Callable[[float], None] | None = None,
) -> Bench:
    """Run every static test on the model, all parts at `oil_temperature` (°C), and reduce it as a measured one.

    The current runs a triangle of `period` s over +-i_R, `points` samples each; the valve trails it by about 1/800 s.
    Blocked ports are quasi-static: see `blocked_load_pressure`. `progress` is told the share that is done.
    Raises as `simulate` does, and SolveError where the blocked ports find no load pressure.
    """
    rig = _Rig(
        valve=valve, oil=oil, oil_temperature=oil_temperature, effects=tuple(effects), period=period, points=points
    )
    rated = float(valve.rated_current)
    tell = progress if progress is not None else lambda share: None
    flow = _record("flow", rig.full_cycle(), "load_flow")
    figures = _named("flow", flow_figures(cycle(flow, "load_flow"), rated_current=rated, lag=0.0, dead_zone=0.0))
    figures += _named("flow", (_threshold(rig),))
    tell(0.3)
    blocked = _blocked(rig)
    c = cycle(blocked, "load_pressure")
    figures += _named("pressure-gain", pressure_gain_figures(c, rated_current=rated, lag=0.0))
    figures += _named("leakage", leakage_figures(cycle(blocked, "internal_leakage"), lag=0.0))
    tell(0.6)
    shares = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0)
    flow_load = tuple(_flow_load(rig, share * rated) for share in shares)
    for record, name in ((flow_load[-1], "positive"), (flow_load[0], "negative")):
        own = flow_load_figures(_part(record, record.values["pressure_drop"] <= valve.supply_pressure))
        figures += _named("flow-load", tuple(replace(f, name=f"{f.name}_{name}") for f in own))
    tell(0.8)
    figures += _named("null-shift", _null_shifts(rig))
    tell(1.0)
    return Bench(
        valve=valve, oil_temperature=oil_temperature, figures=figures, flow=flow, blocked=blocked, flow_load=flow_load
    )


def blocked_load_pressure(spool_position, supply_pressure: float, c: Coefficients) -> np.ndarray:
    """Load pressure (Pa, any shape) at which the main stage passes no load flow at given spool positions (m)."""
    from scipy.optimize.elementwise import find_root

    def flow(p, x):
        return main_stage(x, supply_pressure, p, c)[0]

    x = np.asarray(spool_position, dtype=float)
    ends = (np.full(x.shape, -supply_pressure), np.full(x.shape, supply_pressure))
    return find_root(flow, ends, args=(x,), tolerances={"xatol": 1e-9 * supply_pressure, "xrtol": 0.0}).x


def _record(source: str, values: dict[str, np.ndarray], *names: str) -> Record:
    return Record(source=source, values={name: np.asarray(values[name]) for name in ("time", "current", *names)})


def _part(record: Record, keep: np.ndarray) -> Record:
    return Record(source=record.source, values={name: v[keep] for name, v in record.values.items()})


def _blocked(rig: _Rig) -> Record:
    """A full cycle with blocked ports: load pressure and total leakage.

    The run has no load pressure; what the load pressure's flow force then moves the spool by is taken from the static
    solution at the current that holds the same spool position, and the two are brought to agree. Exact without
    friction and hysteresis, where the run is the static solution.
    """
    valve, c = rig.valve, rig.coefficients()
    values = rig.full_cycle(null=rig.null())
    p_s, p_0, x = valve.supply_pressure, valve.return_pressure, values["spool_position"]

    def position(current, force) -> np.ndarray:
        """Where the spool rests at a current (A) and a force (N) on it."""
        with warnings.catch_warnings():  # full load pressure takes the flow force away: the spool goes to its stop
            warnings.simplefilter("ignore", ValidityWarning)
            rest = solve_rest(c, current, rig.oil_temperature, p_s, p_0, 0.0, -force).spool_position
        return np.clip(rest, -c.spool_stroke, c.spool_stroke)

    top = 1.1 * float(np.max(np.abs(values["current"])))
    currents = np.linspace(-top, top, 2001)
    alone = x
    holding = np.interp(x, position(currents, 0.0), currents)  # A, without friction or hysteresis
    start, p_L = position(holding, 0.0), np.zeros(x.shape)
    for _ in range(100):
        before, p_L = (x, p_L), blocked_load_pressure(x, p_s, c)
        x = alone + position(holding, FLOW_FORCE_FACTOR * c.port_width * p_L * np.abs(x)) - start
        x = np.clip(x, -c.spool_stroke, c.spool_stroke)
        if np.max(np.abs(p_L - before[1])) < 1e-7 * p_s and np.max(np.abs(x - before[0])) < 1e-7 * c.spool_stroke:
            break
    else:
        raise SolveError("bench: load pressure and flow force of the blocked ports do not settle; raise null_opening")
    leakage = values["pilot_flow"] + main_stage(x, p_s, p_L, c)[1]
    own = {**values, "load_pressure": p_L, "internal_leakage": leakage, "spool_position": x}
    return _record("blocked ports", own, "load_pressure", "internal_leakage", "spool_position")


def _flow_load(rig: _Rig, current: float) -> Record:
    """Load flow at a held current while the load pressure runs slowly from one supply pressure to the other."""
    p_s = float(rig.valve.supply_pressure)
    against = -np.sign(current) * p_s  # the first; the flow force is then greatest and the spool inside its stops
    load = Table(times=(0.0, rig.period), values=(against, -against))
    values = rig.run(Constant(value=current), rig.period, load_pressure=load)
    values["pressure_drop"] = p_s - np.sign(current) * values["load_pressure"]
    return _record(f"{current * 1e3:.4g} mA", values, "load_pressure", "load_flow", "pressure_drop")


def _threshold(rig: _Rig) -> Figure:
    """Current change that moves the output back after a stop at 10 % of i_R, share of i_R (ARP490).

    Told from a thousandth of rated output, whose own current at the gain of the way back is taken off.
    """
    top = float(rig.valve.rated_current)
    stop, unit = 0.1 * top, rig.period / 8.0
    command = Table(times=(0.0, unit, 1.5 * unit, 4 * unit), values=(0.0, stop, stop, 0.0))
    values = rig.run(command, 4 * unit)
    back = values["time"] >= 1.5 * unit
    i, x = values["current"][back], values["spool_position"][back]
    mark = 1e-3 * abs(x[0]) / stop * top
    fallen = np.abs(x - x[0])
    first, second = (float(np.interp(level, fallen, stop - i)) for level in (mark, 2 * mark))
    value = max(first - (second - first), 0.0) / top
    spacing = float(np.median(np.abs(np.diff(i)))) / top
    return _figure("threshold", value, spacing, "1", "current change that reverses the output after a stop, % i_R")


def _null_shifts(rig: _Rig) -> Figures:
    """Shift of null, share of i_R: over 38 K, over supply +-20 %, and over return up to 20 % of supply (field.md 4)."""
    valve, at = rig.valve, rig.null()
    rated, p_s = float(valve.rated_current), float(valve.supply_pressure)
    conditions: tuple[tuple[str, str, tuple[tuple[str, float], ...]], ...] = (
        ("temperature", "over +38 K of oil and parts", (("oil_temperature", rig.oil_temperature + 38.0),)),
        (
            "supply",
            "over +-20 % of supply, the greater",
            (("supply_pressure", 0.8 * p_s), ("supply_pressure", 1.2 * p_s)),
        ),
        ("return", "over return pressure up to 20 % of supply", (("return_pressure", 0.2 * p_s),)),
    )
    figures: list[Figure | Absent] = []
    for name, doc, changes in conditions:
        try:
            shift = max(((_changed(rig, *one).null() - at) / rated for one in changes), key=abs)
        except (InputError, SolveError) as error:
            figures.append(Absent(name, str(error)))
            continue
        figures.append(_figure(name, shift, 2e-6, "1", f"shift of null {doc}, share of i_R"))
    return tuple(figures)


def _changed(rig: _Rig, name: str, value: float) -> _Rig:
    """The rig with one condition of the bench or figure of the valve changed."""
    if name == "oil_temperature":
        return replace(rig, oil_temperature=value)
    figures: dict[str, float] = {name: value}
    return replace(rig, valve=replace(rig.valve, **figures))  # type: ignore[arg-type]


def _named(test: str, figures: Figures) -> Figures:
    return tuple(replace(f, name=f"{test}.{f.name}") for f in figures)
