"""Pictures and pages of static acceptance tests as the standards (ARP490, ISO 10770-1) plot them, output over current.

Simulated and measured records are drawn by the same functions: both branches, the mid-line and the lines that the
figures of merit are told from.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.characterisation.acceptance.cycle import Cycle, cycle, loop
from valvesim.characterisation.acceptance.flow import LINE
from valvesim.characterisation.acceptance.leakage import branch_curves
from valvesim.characterisation.acceptance.metrics import NULL_SHARE
from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.characterisation.figure_of_merit import Absent, FiguresOfMerit, merit_rows
from valvesim.characterisation.judgement_table import FIGURE_HEADINGS
from valvesim.reports.chart import Chart, Charts, Series, on_one_axis
from valvesim.reports.html_page import Picture, Table, section, write_html
from valvesim.reports.plotting import COLOURS, Figure, png, styled, write_bytes
from valvesim.reports.title_block import TitleBlock, valve_name

if TYPE_CHECKING:
    from valvesim.characterisation.acceptance.acceptance_tests import AcceptanceTests, MeasuredTest
    from valvesim.characterisation.acceptance.null_shift import NullShiftCurve

RISING_COLOUR, FALLING_COLOUR, MIDDLE_COLOUR, LINE_COLOUR = COLOURS[0], COLOURS[1], "0.25", COLOURS[3]


def acceptance_report(result: AcceptanceTests, path: Path, *, date: datetime.date) -> tuple[Path, Path]:
    """Write the picture of the simulated tests to `path` (PNG) and their page beside it; both paths."""
    title = f"Static acceptance tests, oil at {result.oil_temperature:.4g} °C"
    facts = (("Dither", result.dither.in_words()),) if result.dither.amplitude else ()
    block = TitleBlock(title=title, valve=valve_name(result.valve), date=date, facts=facts)
    caption = "Flow curve, pressure gain, internal leakage and flow over load pressure."
    return _write(draw_acceptance(result), block, caption, result.figures, path, acceptance_charts(result))


def measured_report(measured: MeasuredTest, path: Path, *, date: datetime.date) -> tuple[Path, Path]:
    """Write the picture of a measured test to `path` (PNG) and its page beside it; both paths."""
    title = f"Measured acceptance test: {measured.test}"
    block = TitleBlock(title=title, valve=f"measured valve, {measured.record.source}", date=date)
    caption, charts = "The record, with what is told from it.", measured_charts(measured)
    return _write(draw_measured(measured), block, caption, measured.figures, path, charts)


def _write(
    figure: Figure, block: TitleBlock, caption: str, merits: FiguresOfMerit, path: Path, charts: Sequence[Chart]
) -> tuple[Path, Path]:  # fmt: skip
    data = png(figure, block)
    picture = write_bytes(data, path)
    sections = (
        section("Curves", Charts(charts, beside=True)),
        section("Figures of merit", Table(FIGURE_HEADINGS, merit_rows(merits), (1, 2))),
        section("Picture", Picture(data, caption)),
    )
    return picture, write_html(path.with_suffix(".html"), block, sections)


CURVES = {  # of a test over current: (channel, title, unit, factor from SI)
    "flow": ("load_flow", "Flow curve", "L/min", 6e4),
    "pressure-gain": ("load_pressure", "Pressure gain, ports blocked", "bar", 1e-5),
    "leakage": ("internal_leakage", "Internal leakage, ports blocked", "L/min", 6e4),
}


def curve_chart(test: str, record: AcceptanceRecord) -> Chart:
    """Both branches of a test over current."""
    channel, title, unit, factor = CURVES[test]
    c = cycle(record, channel)
    branches = [(current, c.polarity * y * factor) for current, y in (c.rising, c.falling)]
    x, (rising, falling) = on_one_axis(branches)
    known = 1e-4 * float(np.nanmax(np.abs([np.nanmax(np.abs(rising)), np.nanmax(np.abs(falling))])))
    lines = [Series(name, unit, y, known, joined=True) for name, y in (("rising", rising), ("falling", falling))]
    label = f"{channel.replace('_', ' ')} [{unit}]"
    return Chart(title, x * 1e3, lines, "current", "mA", label, group="over current", height=280)


def load_chart(records: Sequence[AcceptanceRecord], x_channel: str) -> Chart:
    """Flow over a pressure, a line each held current."""
    lines, names = [], []
    for record in records:
        lines.append((record.values[x_channel] / 1e5, record.values["load_flow"] * 6e4))
        current = record.values.get("current")
        names.append("flow" if current is None else f"{float(np.mean(current)) * 1e3:.3g} mA")
    x, columns = on_one_axis(lines)
    series = [Series(name, "L/min", y, 1e-3, joined=True) for name, y in zip(names, columns, strict=True)]
    label = x_channel.replace("_", " ")
    return Chart(f"Flow over {label}", x, series, label, "bar", "load flow [L/min]", height=280)


def acceptance_charts(result: AcceptanceTests) -> list[Chart]:
    """Flow curve, pressure gain, leakage, flow over load pressure, and the shift of null over each condition."""
    curves = (("flow", result.flow), ("pressure-gain", result.blocked), ("leakage", result.blocked))
    charts = [curve_chart(test, record) for test, record in curves if record is not None]
    charts += [load_chart(result.flow_load, "load_pressure")] if result.flow_load else []
    return [*charts, *(null_shift_chart(curve) for curve in result.null_shift)]


def null_shift_chart(curve: NullShiftCurve) -> Chart:
    """Shift of null over oil temperature, supply or return pressure."""
    factor, unit = (1.0, "°C") if curve.condition == "oil_temperature" else (1e-5, "bar")
    name = curve.condition.replace("_", " ")
    known = max(1e-4 * float(np.max(np.abs(100.0 * curve.shift))), 1e-6)
    series = [Series("shift", "%", 100.0 * curve.shift, known, joined=True)]
    label = "null [% of rated current]"
    return Chart(f"Shift of null over {name}", curve.at * factor, series, name, unit, label, height=240)


def measured_charts(measured: MeasuredTest) -> list[Chart]:
    """The curve of a measured test."""
    if measured.test in CURVES:
        return [curve_chart(measured.test, measured.record)]
    return [load_chart([measured.record], "pressure_drop")]


@styled
def draw_acceptance(result: AcceptanceTests) -> Figure:
    """All simulated tests on one sheet: flow curve, pressure gain, leakage, flow over load pressure."""
    merits = {merit.name: merit for merit in result.figures}
    figure = Figure(figsize=(12, 9))
    axes = figure.subplots(2, 2)
    figure.subplots_adjust(left=0.07, right=0.98, top=0.91, bottom=0.07, wspace=0.2, hspace=0.28)
    _flow(axes[0, 0], cycle(result.flow, "load_flow"), _of(merits, "flow."))
    if result.blocked is None:
        for axis, test in ((axes[0, 1], "pressure gain"), (axes[1, 0], "internal leakage")):
            axis.text(0.5, 0.5, f"no {test}: an FMU cannot be flown with ports blocked", ha="center", va="center")
            axis.set_axis_off()
    else:
        _pressure_gain(axes[0, 1], cycle(result.blocked, "load_pressure"), _of(merits, "pressure-gain."))
        _leakage(axes[1, 0], cycle(result.blocked, "internal_leakage"), _of(merits, "leakage."))
    axis = axes[1, 1]
    top = result.valve.rated_current
    for record in result.flow_load:
        current = float(record.values["current"][0])
        colour = COLOURS[round(4 * abs(current) / top) % len(COLOURS)]
        label = f"±{abs(current) * 1e3:.3g} mA" if current > 0.0 else None
        axis.plot(record.values["load_pressure"] / 1e5, record.values["load_flow"] * 6e4, color=colour, label=label)
    axis.legend(loc="upper right")
    _labels(axis, "flow over load pressure", "load pressure [bar]", "load flow [L/min]")
    supply = result.valve.supply_pressure / 1e5
    figure.suptitle(
        f"Static acceptance tests, oil at {result.oil_temperature:.4g} °C, supply {supply:.4g} bar", fontsize=12
    )
    return figure


@styled
def draw_measured(measured: MeasuredTest) -> Figure:
    """One measured test on a sheet, with its table of figures of merit."""
    record, test = measured.record, measured.test
    merits = {merit.name: merit for merit in measured.figures}
    figure = Figure(figsize=(12, 5.6))
    axis, sheet = figure.subplots(1, 2, gridspec_kw={"width_ratios": [1.5, 1.0]})
    figure.subplots_adjust(left=0.06, right=0.99, top=0.88, bottom=0.1, wspace=0.05)
    draw_test(axis, record, test, merits)
    sheet.axis("off")
    lines = []
    for name, value, error, unit, meaning in merit_rows(measured.figures):
        words = [f"{value} ± {error} {unit}"] if error else wrap(f"absent: {meaning}", 36)
        lines += [f"{name if k == 0 else '':21s} {text}" for k, text in enumerate(words)]
    sheet.text(0.02, 1.0, "\n".join(lines), va="top", family="monospace", fontsize=8, linespacing=1.7)
    figure.suptitle(f"{record.source}: {test}", fontsize=12)
    return figure


def draw_test(axis: Any, record: AcceptanceRecord, test: str, merits: dict[str, Any]) -> None:
    """A measured test over its abscissa, with the lines of its figures of merit, by name without the test's."""
    if test == "flow":
        _flow(axis, cycle(record, "load_flow"), merits)
    elif test == "pressure-gain":
        _pressure_gain(axis, cycle(record, "load_pressure"), merits)
    elif test == "leakage":
        _leakage(axis, cycle(record, "internal_leakage"), merits)
    else:
        _flow_load(axis, record, merits)


def _of(merits: dict[str, Any], test: str) -> dict[str, Any]:
    return {name.removeprefix(test): merit for name, merit in merits.items() if name.startswith(test)}


def _value(merits: dict[str, Any], name: str) -> float:
    """The value of a figure of merit, NaN where it is absent: then its line is not drawn."""
    merit = merits.get(name)
    return np.nan if merit is None or isinstance(merit, Absent) else merit.value


def _labels(axis: Any, title: str, x: str, y: str) -> None:
    axis.set_title(title, loc="left")
    axis.set_xlabel(x)
    axis.set_ylabel(y)


def _branches(axis: Any, c: Cycle, factor: float) -> None:
    """Both branches over current in mA, the output in its own sign."""
    for (current, y), colour, label in ((c.rising, RISING_COLOUR, "rising"), (c.falling, FALLING_COLOUR, "falling")):
        order = np.argsort(current, kind="stable")  # of several cycles the branches lie upon each other
        axis.plot(current[order] * 1e3, c.polarity * y[order] * factor, color=colour, lw=0.8, alpha=0.8, label=label)


def _flow(axis: Any, c: Cycle, merits: dict[str, Any]) -> None:
    """Flow curve with mid-line, the polarities' straight lines, and the null enlarged."""
    bend = loop(c)
    null, window = axis, axis.inset_axes((0.57, 0.1, 0.41, 0.36) if c.polarity > 0 else (0.57, 0.58, 0.41, 0.36))
    rated = c.amplitude
    for each in (null, window):
        _branches(each, c, 6e4)
        each.plot(bend.middle * 1e3, c.polarity * bend.output * 6e4, color=MIDDLE_COLOUR, lw=0.9, label="mid-line")
    for sign, name in ((-1.0, "flow_gain_negative"), (1.0, "flow_gain_positive")):
        part = (sign * bend.middle > LINE[0] * rated) & (sign * bend.middle < LINE[1] * rated)
        slope = _value(merits, name)
        if not np.any(part) or np.isnan(slope):
            continue
        at = np.array([0.0, sign * rated])
        weights = np.gradient(bend.output)[part]
        y = np.average(bend.output[part] - slope * bend.middle[part], weights=weights) + slope * at
        axis.plot(at * 1e3, c.polarity * y * 6e4, "--", color=LINE_COLOUR, lw=1.2, label="gain" if sign > 0 else None)
    reach = max(0.08 * rated, 2.0 * float(np.max(np.abs(bend.width))))
    height = 1.2 * abs(np.nanmean([_value(merits, f"flow_gain_{k}") for k in ("negative", "positive")])) * reach
    if np.isfinite(height):
        window.set(xlim=(-reach * 1e3, reach * 1e3), ylim=(-height * 6e4, height * 6e4))
    window.tick_params(labelsize=7)
    axis.legend(loc="upper left" if c.polarity > 0 else "lower left")
    _labels(axis, "flow curve (null enlarged)", "current [mA]", "flow [L/min]")


def _pressure_gain(axis: Any, c: Cycle, merits: dict[str, Any]) -> None:
    """Blocked load pressure about null, with the slope over +-40 % of supply."""
    _branches(axis, c, 1e-5)
    supply, gain = _value(merits, "supply_pressure"), _value(merits, "pressure_gain")
    null = (_value(merits, "zero_rising") + _value(merits, "zero_falling")) / 2.0
    if np.isfinite(gain):
        y = np.array([-NULL_SHARE, NULL_SHARE]) * supply
        axis.plot((null + y / gain) * 1e3, c.polarity * y / 1e5, "--", color=LINE_COLOUR, lw=1.8, label="pressure gain")
        for level in y:
            axis.axhline(level / 1e5, color="0.7", lw=0.7)
        reach = 5.0 * supply / gain + abs(_value(merits, "zero_rising") - null)
        axis.set_xlim((null - reach) * 1e3, (null + reach) * 1e3)
    axis.legend(loc="upper left" if c.polarity > 0 else "upper right")
    _labels(axis, "pressure gain, ports blocked", "current [mA]", "load pressure [bar]")


def _leakage(axis: Any, c: Cycle, merits: dict[str, Any]) -> None:
    """Leakage at blocked ports over current, raw and averaged, with tare."""
    grid, up, down = branch_curves(c)
    _branches(axis, c, 6e4)
    for y, label in ((up, "averaged"), (down, None)):
        axis.plot(grid * 1e3, y * 6e4, color=MIDDLE_COLOUR, lw=0.9, label=label)
    tare, split, middle = (_value(merits, name) for name in ("tare", "half_split", "peak_current"))
    if np.isfinite(tare):
        axis.axhline(tare * 6e4, color=LINE_COLOUR, ls="--", lw=1.2, label="tare")
    if split > 0.01 * np.ptp(grid):
        for side in (middle - split, middle + split):
            axis.axvline(side * 1e3, color="0.6", lw=0.8, ls=":")
    axis.legend(loc="upper right")
    _labels(axis, "internal leakage, ports blocked", "current [mA]", "leakage [L/min]")


def _flow_load(axis: Any, record: AcceptanceRecord, merits: dict[str, Any]) -> None:
    """Flow over valve pressure drop at full current, with the power law."""
    p, q = record.values["pressure_drop"], record.values["load_flow"]
    axis.plot(p / 1e5, q * 6e4, ".", ms=1.5, color=RISING_COLOUR, label="record")
    n, rated = _value(merits, "flow_exponent"), _value(merits, "rated_flow")
    if np.isfinite(n) and np.isfinite(rated):
        x = np.linspace(max(np.min(p), 1e4), np.max(p), 200)
        axis.plot(x / 1e5, rated * (x / 7e6) ** n * 6e4, color=FALLING_COLOUR, label=f"power law, exponent {n:.3f}")
        axis.plot(70.0, rated * 6e4, "o", color=LINE_COLOUR, label="rated flow, 70 bar")
    axis.legend(loc="lower right")
    _labels(axis, "flow over valve pressure drop", "valve pressure drop [bar]", "flow [L/min]")
