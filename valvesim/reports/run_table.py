"""The table of a run: what each channel reached. It loads no pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from valvesim.units import DISPLAY, symbol

if TYPE_CHECKING:
    from valvesim.simulation.result import Result

RUN_HEADINGS = ("channel", "unit", "least", "greatest", "at the end")
RUN_RECORD = ("channel", "unit", "least", "greatest", "end")
TABLE_CHANNELS = (
    "current", "oil_temperature", "body_temperature", "torque_motor_temperature", "armature_angle", "nozzle_pressure_1",
    "nozzle_pressure_2", "spool_position", "load_flow", "internal_leakage",
)  # fmt: skip
ROUNDING = 1e-9  # share of a channel's usual size below which a value is nothing
STILL = 1e-3  # share of its size by which a channel must move for the tolerance to tell its digits


def run_rows(result: Result, names: Sequence[str] = TABLE_CHANNELS) -> list[tuple[str, ...]]:
    """Rows of `RUN_HEADINGS`, a channel each, to the digits that the tolerance of the integration leaves."""
    rows = []
    for name in names:
        values, unit = result.display(name)
        (channel,) = result.select((name,)).channels
        nothing = ROUNDING * channel.scale * DISPLAY.get(channel.unit, (unit, 1.0))[1]
        values = np.where(np.abs(values) > nothing, values, 0.0)
        span, size = float(np.ptp(values)), float(np.max(np.abs(values)))
        known = result.scenario.tolerance * span if span > STILL * size else 0.0
        shown = (figure_text(float(v), known) for v in (values.min(), values.max(), values[-1]))
        rows.append((name.replace("_", " "), symbol(unit), *shown))
    return rows


def figure_text(value: float, uncertainty: float) -> str:
    """A number to the digit that its uncertainty reaches, five digits where there is none."""
    if not uncertainty > 0.0:
        return f"{value:.5g}"
    digits = int(np.clip(np.ceil(-np.log10(uncertainty)), 0, 12))
    return f"{round(value, digits) + 0.0:.{digits}f}"


def run_records(result: Result) -> list[tuple[str, str, float, float, float]]:
    """Rows of `RUN_RECORD` in SI, every channel of the run, for machines."""
    return [
        (c.name, c.unit, float(values.min()), float(values.max()), float(values[-1]))
        for c in result.channels
        for values in (result.values[c.name],)
    ]
