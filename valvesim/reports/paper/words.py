"""Tables, pictures, numbers and names as the page on the paper writes them, in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from valvesim.paper.interpretations import INTERPRETATIONS
from valvesim.paper.published import PublishedDrift
from valvesim.reports.plotting import COLOURS, Figure
from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.coefficients import ROUTES
from valvesim.valve.parameters import Valve

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction


TITLES = {"reference": "reference valve"} | {
    interpretation.key: interpretation.title for interpretation in INTERPRETATIONS
}
MARKS = {"reference": "s", "derived": "o", "derived_sizes": "v", "printed": "^", "printed_rise": "D"}
SHADES = dict(zip(TITLES, ("0.55", COLOURS[0], COLOURS[4], COLOURS[1], COLOURS[3]), strict=True))
SHOWN = ("reference", "derived", "printed")


def reflow(text: str) -> str:
    """Each paragraph and list item on one line; tables, headings and pictures as they are."""
    blocks = []
    for block in text.split("\n\n"):
        plain = not block.lstrip().startswith(("|", "#", "!"))
        blocks.append(re.sub(r"\n(?!- )\s*", " ", block.strip()) if plain else block)
    return "\n\n".join(blocks) + "\n"


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> str:
    marks = ["---" if k < left else "---:" for k in range(len(headings))]
    lines = [headings, marks, *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def picture(name: str, caption: str) -> str:
    return f"![{caption}]({name})\n\n*{caption}*\n"


def signed(value: float, digits: int = 3) -> str:
    """A signed number with enough places to be compared, the minus a real one."""
    places = 2 if abs(value) >= 10.0 else digits
    return f"{value:+.{places}f}".replace("-", "−")


def listed(items: Sequence[str]) -> str:
    items = list(items)
    if not items:
        return "none"
    return items[0] if len(items) == 1 else ", ".join(items[:-1]) + " and " + items[-1]


def published_words(drift: PublishedDrift) -> str:
    return f"{drift.target:+g}".replace("-", "−") if drift.direction else f"{drift.size:g} (way not told)"


def count_reached(r: Reproduction, key: str) -> int:
    return int(np.sum(r.identified[key].reached[: len(ROUTES)]))


def parameter_text(name: str, value: float) -> str:

    unit = quantities(Valve)[name].metadata["unit"]
    shown, factor = DISPLAY.get(unit, (unit, 1.0))
    return f"{value * factor:.4g} {symbol(shown) if shown != '1' else ''}".strip()


def one_panel():
    figure = Figure(figsize=(7.5, 4.2))
    axis = figure.subplots()
    figure.subplots_adjust(left=0.1, right=0.97, top=0.92, bottom=0.13)
    return figure, axis
