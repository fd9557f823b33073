"""What all pictures share: style, colours, labels of logarithmic axes, thinning of long lines, PNG with title block."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np

from valvesim.io import write_atomically
from valvesim.reports.title_block import TitleBlock

matplotlib.use("Agg")
from matplotlib import cm, colors, image, ticker  # noqa: E402 - the backend comes first
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure as _Figure  # noqa: E402

__all__ = ["Figure", "cm", "colors", "ticker"]

P = ParamSpec("P")
F = TypeVar("F")

STYLE: Any = {
    "font.size": 9, "text.parse_math": False, "axes.grid": True, "grid.alpha": 0.25, "axes.spines.top": False,
    "axes.spines.right": False, "lines.linewidth": 1.1, "legend.frameon": False, "legend.fontsize": 8,
    "figure.dpi": 100, "axes.titley": 1.0,
}  # fmt: skip
"""Names are shown as they stand: a title may hold any sign, so no text is read as a formula."""
COLOURS = ("#1f5fa8", "#d1495b", "#2e8b57", "#e09f3e", "#7a5195", "#5c677d", "#17a2b8", "#8d5524")
MEASURED_COLOUR, NOMINAL_COLOUR, EXTENDED_COLOUR = "0.35", COLOURS[1], COLOURS[0]  # of records and models everywhere
DPI = 100
MOST_POINTS = 1200  # of a line: beyond it the extremes of each stretch are drawn, which looks the same
BLOCK_HEIGHT = 0.24  # inch, of the title block under a picture
SIGN_WIDTH = 0.062  # inch, of a sign of the title block, on average
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Figure(_Figure):
    """A figure that a notebook shows as it is."""

    def _repr_png_(self) -> bytes:
        data = io.BytesIO()
        with matplotlib.rc_context(STYLE):
            FigureCanvasAgg(self)
            self.savefig(data, format="png", dpi=DPI)
        return data.getvalue()


def styled(draw: Callable[P, F]) -> Callable[P, F]:
    """The function drawing in the style of all pictures."""

    @functools.wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> F:
        with matplotlib.rc_context(STYLE):
            return draw(*args, **kwargs)

    return drawn


class DecadeFormatter(ticker.Formatter):
    """Plain labels of a logarithmic axis: 0.1, 20, 1000, beyond those 10⁻⁶; matplotlib's own are formulas.

    Between the decades 2 and 5 are labelled where the axis shows less than two and a half of them, and 3 where less
    than one; each tick where it shows less than half of one.
    """

    def __call__(self, x: float, pos: int | None = None) -> str:
        if self.axis is None or not np.isfinite(x) or x <= 0.0:
            return ""
        low, high = sorted(self.axis.get_view_interval())
        if low <= 0.0:
            return ""
        exponent = int(np.floor(np.log10(x) + 1e-9))
        digit, span = x / 10.0**exponent, np.log10(high / low)
        labelled = (1,) if span >= 2.5 else (1, 2, 5) if span >= 1.0 else (1, 2, 3, 5)
        if span >= 0.5 and not np.isclose(digit, labelled, rtol=1e-6).any():
            return ""
        if -4 <= exponent < 5:
            return f"{x:.6g}"
        power = f"10{str(exponent).translate(_SUPERSCRIPT)}"
        return power if np.isclose(digit, 1.0) else f"{digit:.6g}·{power}"


def label_decades(*axes: Any) -> None:
    """Give logarithmic axes (an `Axes.xaxis` or `.yaxis` each) plain labels."""
    for axis in axes:
        axis.set_major_formatter(DecadeFormatter())
        axis.set_minor_formatter(DecadeFormatter())


def thin(t: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and highest value of each stretch of a long line, drawn at its start; a short line as it is."""
    if len(t) <= MOST_POINTS:
        return t, y
    starts = np.linspace(0, len(t), MOST_POINTS // 2, endpoint=False).astype(int)
    extremes = np.column_stack([np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)])
    return np.append(np.repeat(t[starts], 2), t[-1]), np.append(extremes.ravel(), y[-1])


MOST_CYCLES = 60  # of a line that can be told apart in a picture; beyond it what swings is drawn as its envelope
STRETCHES, NEIGHBOURS = 400, 5  # of an envelope, and those that hold a cycle together where it is one


SLIGHT = 1e-3  # of a line's range: how far it has to pass its mean to cross it


def swings(y: np.ndarray) -> np.ndarray:
    """Where a line crosses its running mean over `NEIGHBOURS` stretches, which drift carries along: (n,) of bool."""
    width = len(y) * NEIGHBOURS // STRETCHES
    sums = np.cumsum(np.pad(y - y[0], (width // 2 + 1, width - width // 2), mode="edge"))
    mean = y[0] + (sums[width:] - sums[:-width])[: len(y)] / width if width else np.mean(y)
    above = np.signbit(y - mean - SLIGHT * np.ptp(y))
    return np.append(above[1:] != above[:-1], False)


def draw_line(axis: Any, t: np.ndarray, y: np.ndarray, *, colour: Any, label: str) -> None:
    """A line over time; where it swings more often than can be told apart, the band that it fills."""
    crossings = swings(y)
    if np.count_nonzero(crossings) <= 2 * MOST_CYCLES or len(t) <= 2 * STRETCHES:
        axis.plot(*thin(t, y), color=colour, label=label, alpha=0.8)
        return
    starts = np.linspace(0, len(t), STRETCHES, endpoint=False).astype(int)
    count = np.convolve(np.add.reduceat(crossings.astype(float), starts), np.ones(NEIGHBOURS), "same")
    fast, middle = count >= 4.0, t[starts]
    reach = NEIGHBOURS // 2 * 2
    low, high = (_neighbours(f, f.reduceat(y, starts), reach) for f in (np.minimum, np.maximum))
    low, high = (np.where(fast, edge, np.nan) for edge in (low, high))
    axis.fill_between(middle, low, high, color=colour, alpha=0.25, lw=0)
    axis.plot(middle, low, color=colour, lw=0.9, alpha=0.9, label=f"{label}, least and greatest")
    axis.plot(middle, high, color=colour, lw=0.9, alpha=0.9)
    slow = np.repeat(~fast, np.diff(np.append(starts, len(t))))
    if np.any(slow):
        axis.plot(*thin(t, np.where(slow, y, np.nan)), color=colour, alpha=0.8)


def _neighbours(extreme: Any, values: np.ndarray, reach: int) -> np.ndarray:
    """The extreme of each value and its neighbours, `reach` of them in all."""
    padded = np.pad(values, (reach // 2, reach // 2), mode="edge")
    return extreme.reduce(np.lib.stride_tricks.sliding_window_view(padded, reach + 1), axis=1)


def time_unit(span: float) -> tuple[str, float]:
    """(unit, factor from s) of a time axis of that length, s."""
    return ("s", 1.0) if span >= 0.2 else ("ms", 1e3) if span >= 2e-4 else ("µs", 1e6)


def png(figure: Figure, block: TitleBlock, *, dpi: float = DPI) -> bytes:
    """The picture as PNG with its title block in a strip below, and in the file's own text fields."""
    with matplotlib.rc_context(STYLE):
        strip = Figure(figsize=(figure.get_figwidth(), BLOCK_HEIGHT))
        room = int(figure.get_figwidth() / SIGN_WIDTH) - 4
        origin = _cut(block.origin, room)
        strip.text(0.008, 0.55, _cut(block.title, room - len(origin)), size=7, color="0.35", va="center")
        strip.text(0.992, 0.55, origin, size=7, color="0.35", va="center", ha="right")
        pixels = np.vstack([_pixels(figure, dpi), _pixels(strip, dpi)])
    data = io.BytesIO()
    fields = {"Title": block.title, "Description": block.origin, "Software": f"valvesim {block.version}"}
    image.imsave(data, pixels, format="png", dpi=dpi, metadata=fields, pil_kwargs={"compress_level": 1})
    return data.getvalue()


def _cut(text: str, most: int) -> str:
    """Text on one line, shortened to `most` signs; nothing where not even a word has room."""
    text = " ".join(text.split())
    return text if len(text) <= most else f"{text[: most - 1]}…" if most > 8 else ""


def _pixels(figure: Figure, dpi: float) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def write_picture(figure: Figure, block: TitleBlock, path: Path) -> Path:
    """Write the picture as PNG; its path. Raises InputError where that cannot be."""
    return write_bytes(png(figure, block), path)


def write_bytes(data: bytes, path: Path) -> Path:
    """Write a finished file, whole or not at all; its path."""

    def write(temporary: Path) -> None:
        temporary.write_bytes(data)

    return write_atomically(path, write)
