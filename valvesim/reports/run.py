"""Pictures of a run. Only this module and its kin `report_*` import matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from valvesim.characterisation.thermal_drift import Drift, reference_current
from valvesim.io import write_atomically
from valvesim.simulation.result import Result
from valvesim.units import symbol
from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.equilibrium import static_solution

matplotlib.use("Agg")
from matplotlib.figure import Figure  # noqa: E402 - the backend comes first

STYLE: Any = {
    "font.size": 9, "text.parse_math": False, "axes.grid": True, "grid.alpha": 0.25, "axes.spines.top": False,
    "axes.spines.right": False, "lines.linewidth": 1.1, "legend.frameon": False, "legend.fontsize": 8,
    "figure.dpi": 100,
}  # fmt: skip
COLOURS = ("#1f5fa8", "#d1495b", "#2e8b57", "#e09f3e", "#7a5195", "#5c677d", "#17a2b8", "#8d5524")
MOST_POINTS = 1200  # of a line: beyond it the extremes of each stretch are drawn, which looks the same


def picture_run(result: Result, path: Path) -> Path:
    """The whole run left, its last cycles right: command, temperatures, angle, pressures, spool and flow."""
    scenario, t = result.scenario, result.time
    command = scenario.drive.command_name
    temperatures = [f"{name}_temperature" for name in PART_NAMES]
    rows: list[tuple[str, list[str]]] = [
        ("command", [command]),
        ("temperature", temperatures),
        ("armature angle", ["armature_angle"]),
        ("nozzle pressures", ["nozzle_pressure_1", "nozzle_pressure_2"]),
        ("spool position", ["spool_position"]),
        ("flow", ["load_flow", "internal_leakage"]),
    ]
    zoom = t >= t[-1] - (_cycles(result) or t[-1] / 20.0)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 11))
        axes = figure.subplots(len(rows), 2, sharex="col", gridspec_kw={"width_ratios": [2.2, 1]})
        figure.subplots_adjust(left=0.08, right=0.86, top=0.93, bottom=0.05, wspace=0.18, hspace=0.14)
        for (label, names), (whole, part) in zip(rows, axes, strict=True):
            for axis, mask in ((whole, np.ones(t.shape, bool)), (part, zoom)):
                for k, name in enumerate(names):
                    values, unit = _display(result, name)
                    text = name.removesuffix("_temperature").replace("_", " ")
                    style = {"color": COLOURS[k % len(COLOURS)], "label": text, "alpha": 0.8}
                    axis.plot(*_thin(t[mask], values[mask]), **style)
            whole.set_ylabel(f"{label} [{unit}]")
            if len(names) > 1:
                part.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[0, 0].set_title("whole run", loc="left")
        axes[0, 1].set_title("its end", loc="left")
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        figure.suptitle(scenario.title, fontsize=12)
        return _save(figure, path)


def picture_drift(
    drift: Drift, observed: tuple[np.ndarray, dict[str, np.ndarray]], title: str, path: Path
) -> Path:  # fmt: skip
    """Drift over time in percent: the static solution with the run's own gain beside it, and the statics by route."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(13, 5.4))
        axes = figure.subplots(1, 3, sharey=True)
        figure.subplots_adjust(left=0.06, right=0.9, top=0.84, bottom=0.1, wspace=0.08)
        total = axes[0]
        for k, (name, shares) in enumerate(drift.total.items()):
            text = name.replace("_", " ")
            total.plot(drift.times, 100 * shares, color=COLOURS[k], label=f"{text} at rest")
            total.plot(observed[0], 100 * observed[1][name], ".", color=COLOURS[k], label=f"{text} in the run")
        total.set_title("all routes together", loc="left")
        total.set_ylabel("drift from 20 °C [%]")
        total.legend()
        for axis, name in zip(axes[1:], drift.total, strict=True):
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
        return _save(figure, path)


def picture_characteristic(result: Result, path: Path) -> Path:
    """Angle, spool, load flow and leakage over current; colour is oil temperature, dashes are the rest at 20 °C."""
    scenario = result.scenario
    top = reference_current(scenario)
    currents = np.linspace(-top, top, 41)
    cold = static_solution(
        scenario.valve_at_start, current=currents, parts=PartTemperatures.uniform(20.0), routes=(), oil=scenario.oil
    )  # fmt: skip
    span, end = _cycles(result), float(result.time[-1])
    few = span is not None and span < 0.1 * end  # of many alike: six of them show the drift
    starts = np.linspace(0.0, end - (span or 0.0), 6) if few else np.array([0.0])
    windows = [(result.time >= start) & (result.time <= start + (span if few else end)) for start in starts]
    temperature = result.values["oil_temperature"]
    scale = matplotlib.colors.Normalize(temperature.min(), max(temperature.max(), temperature.min() + 1.0))
    colours = matplotlib.cm.ScalarMappable(scale, "coolwarm")
    current, _ = _display(result, "current")
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 7))
        axes = figure.subplots(2, 2, sharex=True)
        figure.subplots_adjust(left=0.08, right=0.86, top=0.92, bottom=0.08, wspace=0.22, hspace=0.1)
        names = ("armature_angle", "spool_position", "load_flow", "internal_leakage")
        for axis, name in zip(axes.flat, names, strict=True):
            values, unit = _display(result, name)
            for window in windows:
                axis.plot(current[window], values[window], color=colours.to_rgba(temperature[window].mean()))
            if name in ("armature_angle", "spool_position"):
                axis.plot(currents * 1e3, getattr(cold, name) * 1e3, "k--", lw=1, label="at rest, 20 °C")
                axis.legend()
            axis.set_ylabel(f"{name.replace('_', ' ')} [{unit}]")
        for axis in axes[-1]:
            axis.set_xlabel("current [mA]")
        if np.ptp(temperature) > 0.0:
            figure.colorbar(colours, cax=figure.add_axes((0.89, 0.15, 0.015, 0.7)), label="oil temperature [°C]")
        figure.suptitle(f"{scenario.title}: over current", fontsize=12)
        return _save(figure, path)


def _display(result: Result, name: str) -> tuple[np.ndarray, str]:
    """(values, unit) as an axis shows them."""
    values, unit = result.display(name)
    return values, symbol(unit)


def _cycles(result: Result) -> float | None:
    """A span at the end of the run, s, of about three cycles of the current; None where it has no such cycles."""
    values = result.values["current"]
    crossings = result.time[1:][np.diff(np.sign(values - values.mean())) != 0]
    return min(7.0 * float(crossings[-1] - crossings[-2]), float(result.time[-1])) if len(crossings) >= 8 else None


def _thin(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and highest value of each stretch of a long line, drawn at its start; a short line as it is."""
    if len(t) <= MOST_POINTS:
        return t, y
    starts = np.linspace(0, len(t), MOST_POINTS // 2, endpoint=False).astype(int)
    extremes = np.column_stack([np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)])
    return np.append(np.repeat(t[starts], 2), t[-1]), np.append(extremes.ravel(), y[-1])


def _save(figure: Figure, path: Path) -> Path:
    return write_atomically(path, lambda temporary: figure.savefig(temporary, pil_kwargs={"compress_level": 1}))
