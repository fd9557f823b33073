"""Pictures of a run. The only module that imports matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from .drift import Drift, reference_current
from .files import write_atomically
from .model import VoltageDrive
from .parameters import PART_NAMES, PartTemperatures
from .simulate import Result
from .static import static_solution
from .units import DISPLAY, symbol

matplotlib.use("Agg")
from matplotlib.figure import Figure  # noqa: E402 - the backend comes first

STYLE = {
    "font.size": 9, "axes.grid": True, "grid.alpha": 0.25, "axes.spines.top": False, "axes.spines.right": False,
    "lines.linewidth": 1.1, "legend.frameon": False, "legend.fontsize": 8, "figure.dpi": 110,
}  # fmt: skip
COLOURS = ("#1f5fa8", "#d1495b", "#2e8b57", "#e09f3e", "#7a5195", "#5c677d", "#17a2b8", "#8d5524")
MOST_POINTS = 4000  # of a line: beyond it the extremes of each stretch are drawn, which looks the same


def picture_run(result: Result, path: Path) -> Path:
    """The whole run on the left and its last cycles on the right: command, temperatures, angle, pressures, spool, flow."""
    scenario, t = result.scenario, result.time
    command = "voltage" if isinstance(scenario.drive, VoltageDrive) else "current"
    temperatures = [f"{name}_temperature" for name in PART_NAMES]
    rows: list[tuple[str, list[str]]] = [
        ("command", [command]),
        ("temperature", temperatures),
        ("armature angle", ["armature_angle"]),
        ("nozzle pressures", ["nozzle_pressure_1", "nozzle_pressure_2"]),
        ("spool position", ["spool_position"]),
        ("flow", ["load_flow", "internal_leakage"]),
    ]
    zoom = t >= t[-1] - _last_cycles(result, command)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 11.5), layout="constrained")
        axes = figure.subplots(len(rows), 2, sharex="col", gridspec_kw={"width_ratios": [2.2, 1]})
        for (label, names), (whole, part) in zip(rows, axes, strict=True):
            for axis, mask in ((whole, np.ones(t.shape, bool)), (part, zoom)):
                for k, name in enumerate(names):
                    values, unit = _display(result, name)
                    text = name.removesuffix("_temperature").replace("_", " ")
                    axis.plot(*_thin(t[mask], values[mask]), color=COLOURS[k % len(COLOURS)], label=text)
            whole.set_ylabel(f"{label} [{unit}]")
            if len(names) > 1:
                whole.legend(ncols=4 if len(names) > 4 else 2, loc="best")
        axes[0, 0].set_title("whole run", loc="left")
        axes[0, 1].set_title("its end", loc="left")
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
        figure.suptitle(scenario.title, fontsize=12)
        return _save(figure, path)


def picture_drift(
    drift: Drift, observed: tuple[np.ndarray, dict[str, np.ndarray]] | None, title: str, path: Path
) -> Path:  # fmt: skip
    """Drift of angle and spool position over time, from the static solution and as the run shows it."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 6), layout="constrained")
        axis, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.5, 1))
        for k, (name, values) in enumerate(drift.total.items()):
            text = name.replace("_", " ")
            axis.plot(drift.times, 100 * values, color=COLOURS[k], label=f"{text}, static at the parts' temperatures")
            if observed is not None:
                axis.plot(observed[0], 100 * observed[1][name], ".", color=COLOURS[k], label=f"{text}, gain of the run")
        axis.axhline(0.0, color="0.6", lw=0.8)
        axis.set_ylabel("drift from 20 °C [%]")
        axis.legend()
        below.plot(drift.times, drift.oil_temperature, color="0.3")
        below.set_ylabel("oil [°C]")
        below.set_xlabel("time [s]")
        figure.suptitle(f"{title}: drift from the nominal at {drift.current * 1e3:.3g} mA", fontsize=12)
        return _save(figure, path)


def picture_routes(drift: Drift, title: str, path: Path) -> Path:
    """The same drift split by temperature route."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 5), layout="constrained")
        for axis, name in zip(figure.subplots(1, 2, sharey=True), drift.total, strict=True):
            for k, (route, values) in enumerate(drift.by_route.items()):
                axis.plot(drift.times, 100 * values[name], color=COLOURS[k % len(COLOURS)], label=route)
            axis.plot(drift.times, 100 * drift.total[name], color="k", lw=2, label="all together")
            axis.set_title(name.replace("_", " "), loc="left")
            axis.set_xlabel("time [s]")
            axis.set_ylabel("drift from 20 °C [%]")
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.suptitle(f"{title}: drift by route at {drift.current * 1e3:.3g} mA", fontsize=12)
        return _save(figure, path)


def picture_characteristic(result: Result, path: Path) -> Path:
    """Angle, spool position, load flow and leakage over current; colour is oil temperature, dashes the statics at 20 °C."""
    scenario = result.scenario
    top = reference_current(scenario)
    currents = np.linspace(-top, top, 41)
    cold = static_solution(
        scenario.valve, current=currents, parts=PartTemperatures.uniform(20.0), routes=(), oil=scenario.oil
    )  # fmt: skip
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 7), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        step = max(1, len(result.time) // 20_000)
        temperature = result["oil_temperature"].values[::step]
        current, _ = _display(result, "current")
        for axis, name in zip(
            axes.flat, ("armature_angle", "spool_position", "load_flow", "internal_leakage"), strict=True
        ):
            values, unit = _display(result, name)
            dots = axis.scatter(current[::step], values[::step], c=temperature, s=2, cmap="coolwarm", rasterized=True)
            if name in ("armature_angle", "spool_position"):
                axis.plot(currents * 1e3, getattr(cold, name) * 1e3, "k--", lw=1, label="static, 20 °C")
                axis.legend()
            axis.set_ylabel(f"{name.replace('_', ' ')} [{unit}]")
        for axis in axes[-1]:
            axis.set_xlabel("current [mA]")
        if np.ptp(temperature) > 0.0:
            figure.colorbar(dots, ax=axes, label="oil temperature [°C]")
        figure.suptitle(f"{scenario.title}: over current", fontsize=12)
        return _save(figure, path)


def _display(result: Result, name: str) -> tuple[np.ndarray, str]:
    """(values, unit) as people read them."""
    channel: Any = result[name]
    unit, factor = DISPLAY.get(channel.attrs["units"], (channel.attrs["units"], 1.0))
    return channel.values * factor, symbol(unit)


def _last_cycles(result: Result, command: str) -> float:
    """A span at the end of the run, s, with about three cycles of the command, or a twentieth of the run."""
    values = result[command].values
    crossings = result.time[1:][np.diff(np.sign(values - values.mean())) != 0]
    if len(crossings) >= 8:
        return min(7.0 * float(crossings[-1] - crossings[-2]), float(result.time[-1]))
    return float(result.time[-1]) / 20.0


def _thin(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and highest value of each stretch of a long line."""
    if len(t) <= MOST_POINTS:
        return t, y
    stretches = MOST_POINTS // 2
    length = len(t) // stretches
    cut = y[: stretches * length].reshape(stretches, length)
    first = np.arange(stretches) * length
    low, high = first + cut.argmin(axis=1), first + cut.argmax(axis=1)
    pick = np.unique(np.concatenate([[0], low, high, [len(t) - 1]]))
    return t[pick], y[pick]


def _save(figure: Figure, path: Path) -> Path:
    return write_atomically(path, lambda temporary: figure.savefig(temporary))
