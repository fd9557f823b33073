"""Charts of a page that a reader zooms into: columns of numbers, packed into the page, which draws them itself.

The library that draws is uPlot (MIT), which stands in the page, so that no network is needed.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

MOST_CHART_POINTS = 100_000  # of a line: beyond it the extremes of each stretch are kept, as they follow each other
LARGEST = 1e38  # that a page shows: single precision ends there
RESOLVED = 1e-6  # of its size, what is told of a value at most: it travels in single precision
EVEN = 1e-6  # of its step, by which a clock may be off and still is told by start and step


@dataclass(frozen=True)
class Series:
    """A line of a chart: name, unit and values (n,), NaN where there are none.

    `uncertainty`, in the unit, tells how many digits the cursor shows; by default 1e-4 of the line's span. `colour` is
    the number of one; `points` are dots without a line, `joined` a line over the gaps.
    """

    name: str
    unit: str
    values: np.ndarray
    uncertainty: float = 0.0
    colour: int | None = None
    dashed: bool = False
    points: bool = False
    joined: bool = False


@dataclass(frozen=True)
class Chart:
    """Lines over one axis `x` (n,) that rises; those of one `group` zoom and point together."""

    title: str
    x: np.ndarray
    series: Sequence[Series]
    x_label: str = "time"
    x_unit: str = "s"
    y_label: str = ""
    log_x: bool = False
    group: str = ""
    height: int = 220

    @property
    def in_words(self) -> str:
        """What the chart shows, for who cannot see it."""
        told = []
        for one in self.series:
            values = _shown(one.values)
            known = values[np.isfinite(values)]
            if len(known):
                digits = _digits(one.uncertainty or 1e-4 * float(np.ptp(known)), known)
                reach = f"{known.min():.{digits}f} to {known.max():.{digits}f} {one.unit}".rstrip()
                told.append(f"{one.name} {reach}")
        span = f"{self.x_label} {self.x[0]:.4g} to {self.x[-1]:.4g} {self.x_unit}".rstrip()
        return f"{self.title}, over {span}: {', '.join(told)}"

    @property
    def spec(self) -> dict[str, Any]:
        """The chart as the page's script reads it."""
        x, columns = thinned(np.asarray(self.x, dtype=float), [_shown(one.values) for one in self.series])
        steps = np.diff(x)
        axis: dict[str, Any] = {"label": self.x_label, "unit": self.x_unit, "log": self.log_x}
        axis["digits"] = _digits(float(np.median(steps)) if len(steps) else 1.0, x)
        if len(x) > 1 and not self.log_x and np.ptp(steps) <= EVEN * steps[0]:
            axis |= {"start": float(x[0]), "step": float((x[-1] - x[0]) / (len(x) - 1))}
        else:
            axis["data"] = packed(x)
        series = []
        for one, values in zip(self.series, columns, strict=True):
            known = values[np.isfinite(values)]
            span = float(np.ptp(known)) if len(known) else 0.0
            told: dict[str, Any] = {"name": one.name, "unit": one.unit, "data": packed(values)}
            told["digits"] = _digits(one.uncertainty or 1e-4 * span, known)
            told |= {} if one.colour is None else {"colour": one.colour}
            told |= {name: True for name in ("dashed", "points", "joined") if getattr(one, name)}
            series.append(told)
        return {"title": self.title, "n": len(x), "x": axis, "y": self.y_label, "series": series,
                "group": self.group, "height": self.height}  # fmt: skip


@dataclass(frozen=True)
class Charts:
    """Charts below each other, or `beside` where the page is wide enough; without any it is left out."""

    charts: Sequence[Chart]
    beside: bool = False
    macro: ClassVar[str] = "charts"

    def __bool__(self) -> bool:
        return bool(self.charts)


def on_one_axis(lines: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, list[np.ndarray]]:
    """(x, columns) of lines that have an axis each: x rises, and each line has a number where it has a point."""
    x = np.unique(np.concatenate([at for at, _ in lines]))
    columns = []
    for at, values in lines:
        column = np.full(len(x), np.nan)
        column[np.searchsorted(x, at)] = values
        columns.append(column)
    return x, columns


def packed(values: np.ndarray) -> str:
    """Numbers as text: base64 of deflate of single precision, its bytes apart; the page's script unpacks it."""
    singles = np.ascontiguousarray(values, dtype="<f4").view(np.uint8).reshape(-1, 4)
    return base64.b64encode(zlib.compress(singles.T.tobytes(), 6)).decode("ascii")


def thinned(x: np.ndarray, columns: Sequence[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """A long chart with two points a stretch: the extremes of each line, in their order; a short one as it is."""
    if len(x) <= MOST_CHART_POINTS:
        return x, list(columns)
    stretch = int(np.ceil(2 * len(x) / MOST_CHART_POINTS))
    whole = len(x) // stretch * stretch
    kept = []
    for y in columns:
        rows = y[:whole].reshape(-1, stretch)
        low, high = rows.argmin(axis=1), rows.argmax(axis=1)
        pick = np.sort(np.column_stack([low, high]), axis=1)
        kept.append(np.append(np.take_along_axis(rows, pick, axis=1).ravel(), y[-1]))
    starts = x[:whole].reshape(-1, stretch)[:, [0, stretch // 2]]
    return np.append(starts.ravel(), x[-1]), kept


def _shown(values: np.ndarray) -> np.ndarray:
    """The values as a page can show them: NaN for what single precision does not hold."""
    own = np.asarray(values, dtype=float)
    return np.where(np.abs(own) < LARGEST, own, np.nan)


def _digits(uncertainty: float, values: np.ndarray) -> int:
    """Digits after the point that show what is known of values."""
    size = float(np.max(np.abs(values), initial=0.0))
    least = max(uncertainty, RESOLVED * size) if uncertainty > 0.0 and np.isfinite(uncertainty) else 1e-4 * size
    return int(np.clip(np.ceil(-np.log10(least)), 0, 9)) if least > 0.0 else 0
