"""The table of a run: what each channel reached. It loads no pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from valvesim.units import symbol

if TYPE_CHECKING:
    from valvesim.simulation.result import Result

RUN_HEADINGS = ("channel", "unit", "least", "greatest", "at the end")
CHANNELS = (
    "current", "oil_temperature", "body_temperature", "torque_motor_temperature", "armature_angle", "nozzle_pressure_1",
    "nozzle_pressure_2", "spool_position", "load_flow", "internal_leakage",
)  # fmt: skip


def run_rows(result: Result, names: Sequence[str] = CHANNELS) -> list[tuple[str, ...]]:
    """Rows of `RUN_HEADINGS`, a channel each."""
    rows = []
    for name in names:
        values, unit = result.display(name)
        extremes = (f"{v:.5g}" for v in (values.min(), values.max(), values[-1]))
        rows.append((name.replace("_", " "), symbol(unit), *extremes))
    return rows
