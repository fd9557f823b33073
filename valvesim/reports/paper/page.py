"""The page on the paper: published beside computed, with the reasons. Markdown, and HTML with the pictures inside.

Every number on it is computed when the paper is recomputed; what the paper states comes from `paper.published`.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from markupsafe import Markup

from valvesim.io import check_folder
from valvesim.reports.html_page import Prose, png_address, section, write_html
from valvesim.reports.paper.currents import currents_text, draw_currents, draw_experiment, experiment_text
from valvesim.reports.paper.flow import draw_flow, flow_text
from valvesim.reports.paper.identified import draw_profile, identified_text
from valvesim.reports.paper.magnet import draw_magnet
from valvesim.reports.paper.main_picture import draw_main
from valvesim.reports.paper.oil import draw_viscosity, oil_text
from valvesim.reports.paper.routes import draw_routes, reach_text, routes_text
from valvesim.reports.paper.summary import MAIN_PICTURE, head_text, not_validated_text, overview_text
from valvesim.reports.paper.torque_motor import draw_flux, draw_gaps, flux_text, gaps_text
from valvesim.reports.paper.words import reflow
from valvesim.reports.plotting import Figure, png, write_bytes
from valvesim.reports.title_block import TitleBlock

if TYPE_CHECKING:
    from valvesim.paper.reproduction import Reproduction

PAPER_DPI = 110
VALVE = "reference valve, and those identified for the lost Table 4"
PAPER_PICTURES: dict[str, Callable[[Reproduction], Figure]] = {
    MAIN_PICTURE: draw_main, "routes.png": draw_routes, "magnet.png": draw_magnet, "profile.png": draw_profile,
    "gaps.png": draw_gaps, "flux.png": draw_flux, "viscosity.png": draw_viscosity, "flow.png": draw_flow,
    "currents.png": draw_currents, "experiment.png": draw_experiment,
}  # fmt: skip
PAGE_SECTIONS: tuple[Callable[[Reproduction], str], ...] = (
    head_text, overview_text, routes_text, reach_text, identified_text, gaps_text, flux_text, oil_text, flow_text,
    currents_text, experiment_text, not_validated_text,
)  # fmt: skip


def page_text(r: Reproduction) -> str:
    """The page as Markdown, without its title."""
    return "\n".join(reflow(text(r)) for text in PAGE_SECTIONS)


def write_page(r: Reproduction, folder: Path, *, date: datetime.date) -> Path:
    """Write `paper.html`, `paper.md` and the pictures of a finished reproduction into `folder`; the path of the HTML.

    The same reproduction and date write the same files. Raises InputError for a folder that cannot be written.
    """
    from markdown_it import MarkdownIt

    folder = Path(folder)
    check_folder(folder)
    block = TitleBlock(title="The paper, reproduced", valve=VALVE, date=date)
    pictures = {name: png(draw(r), block, dpi=PAPER_DPI) for name, draw in PAPER_PICTURES.items()}
    for name, data in pictures.items():
        write_bytes(data, folder / name)
    text = page_text(r)
    write_bytes(f"# {block.title}\n\n*{block.origin}*\n\n{text}".encode(), folder / "paper.md")
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    for name, data in pictures.items():
        body = body.replace(f'src="{name}"', f'src="{png_address(data)}"')
    return write_html(folder / "paper.html", block, (section("", Prose(Markup(body))),))
