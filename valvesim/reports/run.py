"""Pictures and page of a run."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.errors import InputError
from valvesim.reports.chart import Chart, Charts, Series
from valvesim.reports.html_page import Listing, Picture, Table, Text, section, write_html
from valvesim.reports.plotting import (
    COLOURS,
    Figure,
    cm,
    colors,
    draw_line,
    label_decades,
    styled,
    time_unit,
    write_picture,
)
from valvesim.reports.response import frequency_charts
from valvesim.reports.run_table import RUN_HEADINGS, run_rows
from valvesim.reports.title_block import TitleBlock, valve_name
from valvesim.units import symbol
from valvesim.valve.coefficients import PART_NAMES

if TYPE_CHECKING:
    from valvesim.characterisation.frequency_response import FrequencyResponse
    from valvesim.characterisation.rest_characteristic import RestCharacteristic
    from valvesim.characterisation.thermal_drift import Drift
    from valvesim.simulation.result import Result
    from valvesim.simulation.scenario import Scenario

RUN_CAPTIONS = {
    "run": "The whole run, and its end or last jump enlarged.",
    "characteristic": "Armature angle, spool, flow and leakage over current; dashed: the valve at rest, 20 °C.",
    "drift": "Drift against the same valve at 20 °C, in all and by route of the temperature.",
    "sweep": "Frequency response from the run's own sweep (faint where not coherent); power over time and frequency.",
}
LEAST_SHIFT = 1e-3  # share by which a valve must differ from itself at 20 °C for its start to be told apart
TEMPERATURE_CHANNELS = tuple(f"{name}_temperature" for name in PART_NAMES)


def title_block(scenario: Scenario, date: datetime.date) -> TitleBlock:
    """The marks of a run's page and pictures."""
    facts = (
        ("Oil", scenario.oil.name), ("Duration", f"{scenario.duration:g} s"),
        ("Relative tolerance of the integration", f"{scenario.tolerance:g}"),
        ("Effects", ", ".join(active.in_words() for active in scenario.effects)),
    )  # fmt: skip
    return TitleBlock(title=scenario.title, valve=valve_name(scenario.valve), date=date, facts=facts)


def picture_run(result: Result, date: datetime.date, path: Path) -> Path:
    """Write `draw_run`; its path."""
    return write_picture(draw_run(result), title_block(result.scenario, date), path)


def picture_drift(
    drift: Drift, observed: tuple[np.ndarray, dict[str, np.ndarray]], scenario: Scenario, date: datetime.date,
    path: Path,
) -> Path:  # fmt: skip
    """Write `draw_drift`; its path."""
    return write_picture(draw_drift(drift, observed, scenario.title), title_block(scenario, date), path)


def picture_sweep(result: Result, response: FrequencyResponse, date: datetime.date, path: Path) -> Path:
    """Write `draw_sweep`; its path."""
    return write_picture(draw_sweep(result, response), title_block(result.scenario, date), path)


def picture_characteristic(result: Result, rest: RestCharacteristic, date: datetime.date, path: Path) -> Path:
    """Write `draw_characteristic`; its path."""
    return write_picture(draw_characteristic(result, rest), title_block(result.scenario, date), path)


def page_run(
    result: Result, pictures: Sequence[Path], date: datetime.date, path: Path, drift: Drift | None = None,
    response: FrequencyResponse | None = None,
) -> Path:  # fmt: skip
    """Write the page of a run: its table, its channels as charts, drift and sweep where there are; its path."""
    scenario = result.scenario
    words = Text("Simulated by valvesim; no valve was measured.")
    shown = [
        Picture(one.read_bytes(), RUN_CAPTIONS.get(one.stem, one.stem)) for one in pictures if one.stem not in ("run",)
    ]
    parts = (
        section("Figures", words, Table(RUN_HEADINGS, run_rows(result), (2, 3, 4))),
        section("Over time", Charts(run_charts(result))),
        section("Over frequency", Charts([] if response is None else frequency_charts([("", [response])]))),
        section("Drift with temperature", Charts([] if drift is None else drift_charts(drift))),
        section("Pictures", *shown),
        section("The scenario", Listing("scenario.toml", ", as it ran", _scenario_text(scenario))),
    )
    return write_html(path, title_block(scenario, date), parts)


def _scenario_text(scenario: Scenario) -> str:
    """The scenario as a file, or why none can say it."""
    try:
        return scenario.to_toml()
    except InputError as error:
        return f"# {error}"


def run_charts(result: Result) -> list[Chart]:
    """The channels of a run over time, panel by panel, one zoom for all."""
    charts = []
    for label, names in run_panels(result.scenario):
        series, unit = [], ""
        for name in names:
            values, unit = _display(result, name)
            known = np.ptp(values) * result.scenario.tolerance
            text = name.removesuffix("_temperature").replace("_", " ")
            series.append(Series(text, unit, values, uncertainty=float(known)))
        charts.append(
            Chart(label[:1].upper() + label[1:], result.time, series, y_label=f"{label} [{unit}]", group="run")
        )
    return charts


def drift_charts(drift: Drift) -> list[Chart]:
    """Drift at rest from 20 °C over time: all routes together, and each quantity by route."""
    everything = [Series(name.replace("_", " "), "%", 100 * shares, 1e-3) for name, shares in drift.total.items()]
    charts = [Chart("All routes together", drift.times, everything, y_label="drift [%]", group="drift", height=240)]
    for name, total in drift.total.items():
        series = [Series(route, "%", 100 * values[name], 1e-3) for route, values in drift.by_route.items()]
        series.append(Series("all together", "%", 100 * total, 1e-3, dashed=True))
        title = f"{name.replace('_', ' ').capitalize()} by route"
        charts.append(Chart(title, drift.times, series, y_label="drift [%]", group="drift", height=240))
    return charts


def run_panels(scenario: Scenario) -> list[tuple[str, tuple[str, ...]]]:
    """(label, channels) of each panel of a run."""
    return [
        ("command", (scenario.drive.command_name,)),
        ("temperature", TEMPERATURE_CHANNELS),
        ("armature angle", ("armature_angle",)),
        ("nozzle pressures", ("nozzle_pressure_1", "nozzle_pressure_2")),
        ("spool position", ("spool_position",)),
        ("flow", ("load_flow", "internal_leakage")),
    ]


@styled
def draw_run(result: Result) -> Figure:
    """The whole run left, its last cycles right: command, temperatures, angle, pressures, spool and flow."""
    scenario, t = result.scenario, result.time
    rows = run_panels(scenario)
    begin, stop, what = enlarged(result)
    zoom = (t >= begin) & (t <= stop)
    parts = [(np.ones(t.shape, bool), 0.0, *time_unit(t[-1])), (zoom, begin, *time_unit(stop - begin))]
    figure = Figure(figsize=(11, 11))
    axes = figure.subplots(len(rows), 2, sharex="col", gridspec_kw={"width_ratios": [2.2, 1]})
    figure.subplots_adjust(left=0.08, right=0.84, top=0.93, bottom=0.05, wspace=0.18, hspace=0.14)
    for (label, names), pair in zip(rows, axes, strict=True):
        unit = ""
        for axis, (mask, start, _, factor) in zip(pair, parts, strict=True):
            for k, name in enumerate(names):
                values, unit = _display(result, name)
                text = name.removesuffix("_temperature").replace("_", " ")
                times = (t[mask] - start) * factor if start else t[mask] * factor
                draw_line(axis, times, values[mask], colour=COLOURS[k % len(COLOURS)], label=text)
                axis.ticklabel_format(useOffset=False)
            _open_up(axis, 1e-3 * max(float(np.ptp(_display(result, name)[0])) for name in names))
        pair[0].set_ylabel(f"{label} [{unit}]")
        if len(names) > 1:
            pair[1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axis in axes[:, 0]:
        axis.yaxis.set_label_coords(-0.085, 0.5)
    axes[0, 0].set_title("whole run", loc="left")
    axes[0, 1].set_title(what, loc="left")
    axes[-1, 0].set_xlabel(f"time [{parts[0][2]}]")
    axes[-1, 1].set_xlabel(f"time after {parts[1][1]:.6g} s [{parts[1][2]}]")
    figure.suptitle(scenario.title, fontsize=12)
    return figure


@styled
def draw_channels(result: Result, names: Sequence[str]) -> Figure:
    """These channels over time, a panel each. Raises InputError for a channel that the result does not have."""
    result.select(names)
    figure = Figure(figsize=(9, 1.0 + 1.9 * len(names)))
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    figure.subplots_adjust(
        left=0.11, right=0.97, top=1.0 - 0.5 / figure.get_figheight(), bottom=0.5 / figure.get_figheight()
    )
    unit, factor = time_unit(result.time[-1])
    for axis, name in zip(axes, names, strict=True):
        values, own = _display(result, name)
        text = name.replace("_", " ")
        draw_line(axis, result.time * factor, values, colour=COLOURS[0], label=text)
        axis.set_ylabel(f"{text}\n[{own}]")
    axes[-1].set_xlabel(f"time [{unit}]")
    figure.align_ylabels(axes)
    figure.suptitle(result.scenario.title, fontsize=12)
    return figure


@styled
def draw_drift(drift: Drift, observed: tuple[np.ndarray, dict[str, np.ndarray]], title: str) -> Figure:
    """Drift over time in percent: the static solution with the run's own gain beside it, and the statics by route.

    Where the valve is not at 20 °C at the start, the drift since the start is shown too.
    """
    since = drift.since_start()
    later = any(abs(shares[0]) > LEAST_SHIFT for shares in drift.total.values())
    figure = Figure(figsize=(17 if later else 13, 5.4))
    axes = figure.subplots(1, 4 if later else 3, sharey=True)
    figure.subplots_adjust(
        left=0.045 if later else 0.06, right=0.92 if later else 0.9, top=0.84, bottom=0.1, wspace=0.08
    )
    total = axes[0]
    for k, (name, shares) in enumerate(drift.total.items()):
        text = name.replace("_", " ")
        total.plot(drift.times, 100 * shares, color=COLOURS[k], label=f"{text} at rest")
        total.plot(observed[0], 100 * observed[1][name], ".", color=COLOURS[k], label=f"{text} in the run")
        if later:
            axes[1].plot(drift.times, 100 * since[name], color=COLOURS[k], label=f"{text} at rest")
    total.set_title("all routes together", loc="left")
    total.set_ylabel("drift from 20 °C [%]")
    total.legend()
    if later:
        axes[1].set_title(f"since the start, oil at {drift.oil_temperature[0]:.4g} °C", loc="left")
        axes[1].legend()
    for axis, name in zip(axes[-2:], drift.total, strict=True):
        for k, (route, values) in enumerate(drift.by_route.items()):
            axis.plot(drift.times, 100 * values[name], color=COLOURS[k % len(COLOURS)], label=route)
        axis.plot(drift.times, 100 * drift.total[name], color="k", lw=2, label="all together")
        axis.set_title(f"{name.replace('_', ' ')} at rest, by route", loc="left")
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for axis in axes:
        axis.axhline(0.0, color="0.6", lw=0.8)
        axis.set_xlabel("time [s]")
    low, high = drift.oil_temperature.min(), drift.oil_temperature.max()
    heading = f"{title}: drift at {drift.current * 1e3:.3g} mA, oil from {low:.4g} to {high:.4g} °C"
    figure.suptitle(heading, fontsize=12)
    return figure


@styled
def draw_sweep(result: Result, response: FrequencyResponse) -> Figure:
    """Of a run whose frequency goes: Bode of the response, amplitude over its lowest, and spectrogram."""
    figure = Figure(figsize=(12, 7))
    axes = figure.subplots(2, 2, sharex="col", gridspec_kw={"height_ratios": [1.4, 1]})
    figure.subplots_adjust(left=0.07, right=0.93, top=0.9, bottom=0.08, wspace=0.2, hspace=0.12)
    (ratio, spectrum), (lag, course) = axes
    keep = response.credible
    for axis, values, label in (
        (ratio, response.amplitude_ratio, "amplitude ratio to lowest frequency [dB]"),
        (lag, -response.phase_lag, "phase [°]"),
    ):
        axis.semilogx(response.frequency, values, color=COLOURS[0], lw=0.6, alpha=0.4)
        axis.semilogx(response.frequency, np.where(keep, values, np.nan), color=COLOURS[0], label="coherent")
        axis.set_ylabel(label)
    ratio.axhline(-3.0, color="0.5", lw=0.8, ls="--")
    lag.axhline(-90.0, color="0.5", lw=0.8, ls="--")
    lag.set_xlabel("frequency [Hz]")
    label_decades(lag.xaxis)
    channel = response.channel.replace("_", " ")
    ratio.set_title(f"{channel} over {result.scenario.drive.command_name}", loc="left")
    values, unit = _display(result, response.channel)
    _spectrogram(spectrum, result.time, values, float(response.frequency[-1]))
    spectrum.set_title(f"spectrogram of the {channel}", loc="left")
    draw_line(course, result.time, values, colour=COLOURS[0], label=channel)
    course.set_ylabel(f"{channel} [{unit}]")
    course.set_xlabel("time [s]")
    figure.suptitle(f"{result.scenario.title}: over frequency", fontsize=12)
    return figure


def _spectrogram(axis: Any, t: np.ndarray, y: np.ndarray, highest: float) -> None:
    """Power of a line over time and frequency, dB below its greatest."""
    from scipy.signal import spectrogram

    rate = (len(t) - 1) / (t[-1] - t[0])
    window = int(np.clip(len(t) // 100, 64, 8192))
    f, at, power = spectrogram(y - np.mean(y), rate, nperseg=window, noverlap=window // 2)
    level = 10.0 * np.log10(np.maximum(power / max(float(np.max(power)), 1e-300), 1e-8))
    shown = f <= 1.5 * highest
    mesh = axis.pcolormesh(t[0] + at, f[shown], level[shown], cmap="viridis", vmin=-60.0, vmax=0.0, shading="nearest")
    axis.set_ylabel("frequency [Hz]")
    axis.grid(False)
    axis.figure.colorbar(mesh, cax=axis.inset_axes((1.02, 0.0, 0.025, 1.0)), label="power below greatest [dB]")


@styled
def draw_characteristic(result: Result, rest: RestCharacteristic) -> Figure:
    """Angle, spool, load flow and leakage over current; colour is oil temperature, dashes are the rest at 20 °C."""
    span, end = cycles(result), float(result.time[-1])
    few = span is not None and span < 0.1 * end  # of many alike: six of them show the drift
    starts = np.linspace(0.0, end - (span or 0.0), 6) if few else np.array([0.0])
    windows = [(result.time >= start) & (result.time <= start + (span if few else end)) for start in starts]
    temperature = result.values["oil_temperature"]
    scale = colors.Normalize(temperature.min(), max(temperature.max(), temperature.min() + 1.0))
    colours = cm.ScalarMappable(scale, "coolwarm")
    current, _ = _display(result, "current")
    figure = Figure(figsize=(10, 7))
    axes = figure.subplots(2, 2, sharex=True)
    warms = np.ptp(temperature) > 0.0
    figure.subplots_adjust(left=0.08, right=0.86 if warms else 0.97, top=0.92, bottom=0.08, wspace=0.22, hspace=0.1)
    names = ("armature_angle", "spool_position", "load_flow", "internal_leakage")
    dashed = {"armature_angle": rest.armature_angle, "spool_position": rest.spool_position}
    for axis, name in zip(axes.flat, names, strict=True):
        values, unit = _display(result, name)
        for window in windows:
            shade = colours.to_rgba(temperature[window].mean())
            axis.plot(current[window], values[window], color=shade, lw=2.2 if name in dashed else 1.1)
        if name in dashed:
            axis.plot(rest.current * 1e3, dashed[name] * 1e3, "k--", lw=1, label="at rest, 20 °C")
            axis.legend()
        axis.set_ylabel(f"{name.replace('_', ' ')} [{unit}]")
    for axis in axes[-1]:
        axis.set_xlabel("current [mA]")
    if warms:
        figure.colorbar(colours, cax=figure.add_axes((0.89, 0.15, 0.015, 0.7)), label="oil temperature [°C]")
    figure.suptitle(f"{result.scenario.title}: over current", fontsize=12)
    return figure


def _display(result: Result, name: str) -> tuple[Any, str]:
    """(values, unit) as an axis shows them."""
    values, unit = result.display(name)
    return values, symbol(unit)


def enlarged(result: Result) -> tuple[float, float, str]:
    """(from s, to s, what it is) of the part of a run that is shown enlarged: its last jump, or its end."""
    t, values = result.time, result.values[result.scenario.drive.command_name]
    moved = np.flatnonzero(np.diff(values))
    end, span = float(t[-1]), cycles(result)
    if span is None and 0 < len(moved) < 0.05 * len(t):
        jump = float(t[moved[-1]])
        return max(jump - 0.02 * end, 0.0), min(jump + 0.2 * end, end), "its last jump"
    return end - (span or end / 20.0), end, "its end"


def _open_up(axis: Any, least: float) -> None:
    """A span of at least `least` for y, so that rounding is not shown as if it were something."""
    low, high = axis.get_ylim()
    if high - low < least:
        axis.set_ylim((low + high - least) / 2.0, (low + high + least) / 2.0)


def cycles(result: Result) -> float | None:
    """A span at the end of the run, s, of about three cycles of the current; None where it has no such cycles."""
    values = result.values["current"]
    crossings = result.time[1:][np.diff(np.sign(values - values.mean())) != 0]
    return min(7.0 * float(crossings[-1] - crossings[-2]), float(result.time[-1])) if len(crossings) >= 8 else None
