"""Arrays of any kind of number as columns: floats, NaN where nothing was measured; times from their first."""

from __future__ import annotations

from datetime import datetime, time, timedelta
from typing import Any

import numpy as np


def as_numbers(values: Any) -> np.ndarray:
    """(n,) float; NaN for what is masked, infinite, missing or no number."""
    array: np.ndarray = np.ravel(np.ma.filled(np.ma.asarray(values, dtype=float), np.nan))
    return np.where(np.isfinite(array), array, np.nan)


def is_real(values: Any) -> bool:
    """Whether an array holds real numbers."""
    return np.issubdtype(values.dtype, np.floating) or np.issubdtype(values.dtype, np.integer)


def from_stamps(stamps: np.ndarray) -> tuple[np.ndarray, float]:
    """(seconds from the first, NaN where there is none; when that was, in s since 1970) of numpy's dates or spans."""
    lost = np.isnat(stamps)
    kind = "datetime64[ns]" if np.issubdtype(stamps.dtype, np.datetime64) else "timedelta64[ns]"
    ticks = stamps.astype(kind).astype(np.int64)
    origin = int(ticks[np.flatnonzero(~lost)[0]]) if not lost.all() else 0
    return np.where(lost, np.nan, (ticks - origin) * 1e-9), origin * 1e-9


def from_cells(cells: list[Any]) -> tuple[np.ndarray, float | None] | None:
    """Cells of a sheet as a column, times of day or dates as seconds from the first; None for a column of text."""
    times = [cell for cell in cells if isinstance(cell, datetime | time | timedelta)]
    if times:
        stamps = [_ticks(cell) for cell in cells]
        origin = next(tick for tick in stamps if tick is not None)
        return np.array([np.nan if tick is None else (tick - origin) * 1e-6 for tick in stamps]), origin * 1e-6
    numbers = [isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells]
    if not any(numbers):
        return None
    return as_numbers([float(cell) if number else np.nan for cell, number in zip(cells, numbers, strict=True)]), None


def _ticks(cell: Any) -> int | None:
    """A time in whole microseconds."""
    if isinstance(cell, datetime):
        return (cell.replace(tzinfo=None) - datetime(1970, 1, 1)) // timedelta(microseconds=1)
    if isinstance(cell, time):
        cell = timedelta(hours=cell.hour, minutes=cell.minute, seconds=cell.second, microseconds=cell.microsecond)
    return cell // timedelta(microseconds=1) if isinstance(cell, timedelta) else None
