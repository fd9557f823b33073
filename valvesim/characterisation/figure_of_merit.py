"""A figure of merit, or why there is none; and how people read either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.units import DISPLAY, symbol


@dataclass(frozen=True)
class FigureOfMerit:
    """A figure of merit in SI: `doc` is its definition in short, `uncertainty` one standard deviation where known.

    Unit "1" is a share, shown in %; "-" is a plain number.
    """

    name: str
    value: float
    unit: str
    doc: str
    uncertainty: float | None = None


@dataclass(frozen=True)
class Absent:
    """A figure that a record does not give, and why."""

    name: str
    reason: str


FiguresOfMerit = tuple[FigureOfMerit | Absent, ...]

_SHOWN = {
    **DISPLAY, "1": ("%", 100.0), "m^3/s/A": ("L/min/mA", 60.0), "Pa/A": ("bar/mA", 1e-8), "A/s": ("mA/s", 1e3),
    "s": ("ms", 1e3), "m/s": ("m/s", 1.0),
}  # fmt: skip


LEAST_SHOWN = {"%": 1e-3, "dB": 1e-4}
"""Below which a simulated figure is told to be zero: no more than what the integration leaves."""


def unit_shown(unit: str) -> tuple[str, float]:
    """(unit, factor from SI) in which people read a figure; a plain number has no unit."""
    told, factor = _SHOWN.get(unit, (unit, 1.0))
    return ("" if told in ("-", "") else symbol(told)), factor


def unit_to_parse(unit: str) -> str:
    """The unit of a figure as `units.parse` takes it."""
    return "1" if unit in ("", "-") else unit


def merit_cells(figure: FigureOfMerit) -> tuple[str, str, str]:
    """(value, uncertainty, unit) as text in the units that people read: both to two digits of the uncertainty."""
    unit, factor = _SHOWN.get(figure.unit, (figure.unit, 1.0))
    if figure.name.endswith("lag") and figure.unit == "s":
        unit, factor = "s", 1.0  # a meter's lag is seconds, not milliseconds
    value, error = figure.value * factor, (figure.uncertainty or 0.0) * factor
    told = "" if figure.uncertainty is None else f"{error:.2g}"
    if error > 0.0:
        digits = min(int(1 - np.floor(np.log10(error))), 6)
        text, near = (f"{round(number, digits) + 0.0:.{max(digits, 0)}f}" for number in (value, error))
        told = near if float(near) else told
    else:
        text = "0" if abs(value) < LEAST_SHOWN.get(unit, 0.0) else f"{value:.5g}"
    return text, told, "" if unit == "-" else symbol(unit)


def merit_rows(figures: Sequence[FigureOfMerit | Absent]) -> list[tuple[str, str, str, str, str]]:
    """Rows (name, value, uncertainty, unit, meaning) as text; an absent figure says why."""
    rows = []
    for figure in figures:
        name = figure.name.replace("_", " ")
        if isinstance(figure, Absent):
            rows.append((name, "absent", "", "", figure.reason))
        else:
            rows.append((name, *merit_cells(figure), figure.doc))
    return rows
