"""Times of day and dates as text, in seconds from the first."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError

_ISO = re.compile(r"\d{4}-\d{1,2}-\d{1,2}[T ]\s*\d")
_DOTTED = re.compile(r"\d{1,2}\.\d{1,2}\.\d{4}\s+\d")
_DATED = re.compile(r"\d+[-./]\d+[-./]\d+[T ]?\s+\d")
_DAY = 86_400.0


def clock_seconds(texts: np.ndarray, path: Path, line_of: Callable[[int], int | None]) -> tuple[np.ndarray, float]:
    """(seconds from the first (n,), NaN where there is none; when the first was, in s: of the day or since 1970).

    Read are ISO 8601, day.month.year, and times of day alone, past midnight too. Other dates only tell days apart, so
    that a record may not go on into the next; InputError there, and for what is no time.
    """
    import pandas

    texts = np.array([text.strip().replace(",", ".") for text in texts], dtype=object)
    known = np.array([text != "" for text in texts])
    if not known.any():
        raise InputError("the column of times is empty", file=path)
    first = str(texts[known][0])
    series = pandas.Series(texts)
    if _ISO.match(first):
        stamps = pandas.to_datetime(series, format="ISO8601", errors="coerce", utc=True)
    elif _DOTTED.match(first):
        form = "%d.%m.%Y %H:%M:%S"
        stamps = pandas.to_datetime(
            series, format=form + ".%f" if "." in first[11:] else form, errors="coerce", utc=True
        )
        if known.sum() != stamps.notna().sum():
            plain = pandas.to_datetime(series, format=form, errors="coerce", utc=True)
            stamps = stamps.fillna(plain)
    else:
        return _times_of_day(series, known, path, line_of)
    _check(stamps.isna().to_numpy(), known, texts, path, line_of)
    ticks = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    origin = int(ticks[np.flatnonzero(known)[0]])
    return np.where(known, (ticks - origin) * 1e-9, np.nan), origin * 1e-9


def _times_of_day(
    series: Any, known: np.ndarray, path: Path, line_of: Callable[[int], int | None]
) -> tuple[np.ndarray, float]:
    import pandas

    texts = series.to_numpy()
    if _DATED.match(str(texts[known][0])):
        days = series.str.extract(r"^(\S+)\s", expand=False)
        if days[known].nunique() > 1:
            raise InputError(f"the date changes from {days[known].iloc[0]!r}: write dates as 2026-11-24", file=path)
        series = series.str.replace(r"^\S+\s+", "", regex=True)
    afternoon = series.str.fullmatch(r".*[pP][mM]")
    halves = series.str.fullmatch(r".*[aApP][mM]")
    bare = series.str.replace(r"\s*[aApP][mM]$", "", regex=True)
    bare = bare.where(bare.str.count(":") != 1, "00:" + bare)  # minutes and seconds
    seconds = pandas.to_timedelta(bare.where(known), errors="coerce")
    _check(seconds.isna().to_numpy(), known, texts, path, line_of)
    ticks = seconds.to_numpy(dtype="timedelta64[ns]").astype(np.int64)
    if halves.any():
        half = 43_200_000_000_000
        ticks = ticks % half + np.where(afternoon.to_numpy(dtype=bool), half, 0)
    origin = int(ticks[np.flatnonzero(known)[0]])
    elapsed = (ticks - origin) * 1e-9
    steps = np.diff(elapsed[known], prepend=0.0)
    days_on = np.cumsum(steps < -_DAY / 2.0) * _DAY
    out = np.full(len(texts), np.nan)
    out[known] = elapsed[known] + days_on
    return out, origin * 1e-9


def _check(
    wrong: np.ndarray, known: np.ndarray, texts: np.ndarray, path: Path, line_of: Callable[[int], int | None]
) -> None:
    if (bad := wrong & known).any():
        row = int(np.argmax(bad))
        raise InputError(
            f"{texts[row]!r} is not a time like the first, {texts[known][0]!r}", file=path, line=line_of(row)
        )
