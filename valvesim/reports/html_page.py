"""A page as HTML: sections of text, tables and pictures, put into one template with one style sheet.

The templates escape every text, so that no name is ever read as markup; pictures stand inside the page, which can so be
mailed and needs no network.
"""

from __future__ import annotations

import base64
import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from valvesim.reports.chart import Charts
from valvesim.reports.plotting import DPI, write_bytes
from valvesim.reports.title_block import TitleBlock


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    strong: bool = False
    macro: ClassVar[str] = "text"

    def __bool__(self) -> bool:
        return bool(self.text)


@dataclass(frozen=True)
class Bar:
    """A cell of a table: text upon a bar of that share (0 to 1)."""

    share: float
    text: str

    @property
    def percent(self) -> str:
        """Length of the bar."""
        return f"{100.0 * np.clip(np.nan_to_num(self.share), 0.0, 1.0):.0f}%"

    def __bool__(self) -> bool:
        return bool(self.text)


@dataclass(frozen=True)
class Table:
    """A table, columns of `numbers` to the right; columns that are empty in every row are left out."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str | Bar]]
    numbers: Sequence[int] = ()
    macro: ClassVar[str] = "table"

    @property
    def name(self) -> str:
        """What is read out before the table, which may have to be moved sideways."""
        return f"Table of {', '.join(self.headings)}"

    @property
    def columns(self) -> list[int]:
        """The columns that hold anything."""
        return [k for k in range(len(self.headings)) if any(row[k] for row in self.rows)]

    def __bool__(self) -> bool:
        return bool(self.rows)


@dataclass(frozen=True)
class Terms:
    """Terms and what they are, without those that are empty; in a row, or one below the other."""

    pairs: Sequence[tuple[str, str]]
    in_a_row: bool = True
    macro: ClassVar[str] = "terms"

    def __bool__(self) -> bool:
        return any(text for _, text in self.pairs)


@dataclass(frozen=True)
class Bullets:
    """A list."""

    items: Sequence[str]
    macro: ClassVar[str] = "bullets"

    def __bool__(self) -> bool:
        return bool(self.items)


@dataclass(frozen=True)
class Listing:
    """The text of a file, folded away under its name and what it is."""

    name: str
    words: str
    text: str
    macro: ClassVar[str] = "listing"

    def __bool__(self) -> bool:
        return bool(self.text)


@dataclass(frozen=True)
class Picture:
    """A PNG with its caption, which is also read out where it cannot be seen; none where there is no data."""

    data: bytes
    caption: str
    dpi: float = DPI
    macro: ClassVar[str] = "picture"

    @property
    def source(self) -> str:
        """The picture as an address that holds it."""
        return png_address(self.data)

    @property
    def width(self) -> int:
        """In pixels of a page, so that the letters of all pictures have one size."""
        return round(int.from_bytes(self.data[16:20], "big") * 96 / self.dpi)

    def __bool__(self) -> bool:
        return bool(self.data)


@dataclass(frozen=True)
class Prose:
    """HTML that is made from our own Markdown."""

    html: Markup
    macro: ClassVar[str] = "prose"


Block = Text | Table | Terms | Bullets | Listing | Picture | Charts | Prose


@dataclass(frozen=True)
class Section:
    """A heading ("": none) with its blocks; without any that is filled it is left out."""

    heading: str
    blocks: Sequence[Block]

    @property
    def id(self) -> str:
        """What an address within the page calls it."""
        return re.sub(r"\W+", "-", self.heading.lower()).strip("-")

    def __bool__(self) -> bool:
        return any(self.blocks)


@dataclass(frozen=True)
class Banner:
    """The outcome on top of a page, with the colours of its edge and ground."""

    words: str
    text: str
    edge: str
    ground: str


def section(heading: str, *blocks: Block) -> Section:
    """A section of these blocks."""
    return Section(heading, blocks)


def png_address(data: bytes) -> str:
    """A PNG as a `data:` address."""
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"


@functools.cache
def _environment() -> Any:
    return Environment(
        loader=PackageLoader("valvesim.reports"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip


STATIC_FILES = ("style.css", "uplot/uPlot.min.css", "uplot/LICENSE", "uplot/uPlot.iife.min.js", "charts.js")


@functools.cache
def _static() -> dict[str, Markup]:
    """What pages hold as it stands: the style sheet; of charts uPlot with its licence, and the script that draws."""
    folder = files("valvesim.reports") / "templates"
    return {name: Markup((folder / name).read_text(encoding="utf-8")) for name in STATIC_FILES}


def page(block: TitleBlock, sections: Sequence[Section], *, banner: Banner | None = None) -> str:
    """The whole page as HTML."""
    filled = [section for section in sections if section]
    has_charts = any(isinstance(each, Charts) and each for section in filled for each in section.blocks)
    return (
        _environment()
        .get_template("page.html")
        .render(
            block=block, sections=filled, banner=banner, has_charts=has_charts,
            static=_static(), headings=[section for section in filled if section.heading],
        )
    )  # fmt: skip


def fragment(sections: Sequence[Section], *, banner: Banner | None = None) -> str:
    """The same within a page of others, such as a notebook: its style holds for itself alone."""
    return _environment().get_template("fragment.html").render(sections=sections, banner=banner)


def write_html(path: Path, block: TitleBlock, sections: Sequence[Section], *, banner: Banner | None = None) -> Path:
    """Write the page; its path. Raises InputError where that cannot be."""
    return write_bytes(page(block, sections, banner=banner).encode("utf-8"), path)
