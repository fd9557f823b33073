"""The datasheet as a page (HTML, pictures inside) and as a PDF."""

from __future__ import annotations

import datetime
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, merit_cells
from valvesim.characterisation.judgement_table import VERDICT_HEADINGS, judgement_rows
from valvesim.io import check_folder, write_atomically
from valvesim.reports.acceptance import acceptance_charts, draw_acceptance
from valvesim.reports.chart import Chart, Charts
from valvesim.reports.html_page import Picture, Section, Table, Text, section, write_html
from valvesim.reports.plotting import png
from valvesim.reports.response import RESPONSE_CAPTIONS, draw_responses, response_charts
from valvesim.reports.title_block import TitleBlock, valve_name
from valvesim.units import quantities, range_text, symbol

if TYPE_CHECKING:
    from valvesim.characterisation.datasheet import Datasheet
    from valvesim.characterisation.specification import Judgement

DATASHEET_TITLE, ORIGIN = "Servo valve datasheet", "Computed by valvesim from the model; no valve was measured."


@dataclass(frozen=True)
class _Part:
    """A heading with a table (first row its headings) and pictures under it."""

    heading: str
    text: str
    rows: tuple[tuple[str, ...], ...]
    pictures: tuple[Picture, ...] = ()
    charts: tuple[Chart, ...] = ()

    @property
    def section(self) -> Section:
        """The part on the page, where its charts stand in place of pictures."""
        shown = (Charts(self.charts, beside=True),) if self.charts else self.pictures
        return section(self.heading, Text(self.text), Table(self.rows[0], self.rows[1:]), *shown)


def datasheet_report(
    sheet: Datasheet, folder: Path, *, date: datetime.date, judged: Sequence[Judgement] = ()
) -> tuple[Path, Path]:  # fmt: skip
    """Write datasheet.html and datasheet.pdf into `folder`, with the verdicts on its figures; their paths.

    Raises InputError for a folder that cannot be written.
    """
    check_folder(folder)
    facts = (("Oil", sheet.oil.name),)
    block = TitleBlock(title=DATASHEET_TITLE, valve=valve_name(sheet.valve), date=date, facts=facts)
    parts = _parts(sheet, block)
    if judged:
        verdicts = (VERDICT_HEADINGS, *judgement_rows(judged))
        told = "Each figure against its specification, told with its uncertainty."
        parts = (_Part("Verdicts", told, verdicts), *parts)
    page = write_html(
        folder / "datasheet.html", block, (section("", Text(ORIGIN)), *(part.section for part in parts))
    )  # fmt: skip
    return page, write_atomically(folder / "datasheet.pdf", lambda path: _pdf(parts, block, path))


def _parts(sheet: Datasheet, block: TitleBlock) -> tuple[_Part, ...]:
    at = tuple(f"{t:g} °C" for t in sheet.oil_temperatures)
    low, high = sheet.oil.rated_low, sheet.oil.rated_high
    beyond = [t for t in sheet.oil_temperatures if not low <= t <= high]
    validity = f"Oil {sheet.oil.name}, rated {low:g} to {high:g} °C, all parts at the oil's temperature." + (
        f" Extrapolated beyond the oil's rating: {', '.join(f'{t:g} °C' for t in beyond)}." if beyond else ""
    )
    static = tuple(
        Picture(png(draw_acceptance(one), block), f"Static acceptance tests, oil at {one.oil_temperature:g} °C.")
        for one in sheet.benches
    )
    dynamic = tuple(
        Picture(png(figure, block), RESPONSE_CAPTIONS[name]) for name, figure in draw_responses(sheet.responses).items()
    )  # fmt: skip
    curves = []
    for one in sheet.benches:
        at_once = f", oil at {one.oil_temperature:g} °C"
        curves += [replace(chart, title=f"{chart.title}{at_once}") for chart in acceptance_charts(one)]
    absent = _absent_rows(sheet)
    parameters = [
        (name, f"{getattr(sheet.valve, name):.6g}", symbol(f.metadata["unit"]), range_text(f), f.metadata["doc"])
        for name, f in quantities(sheet.valve).items()
    ]
    return (
        _Part("Static figures of merit", validity, (("figure of merit", "unit", *at), *_static_rows(sheet)), static,
              tuple(curves)),
        _Part(
            "Dynamic figures of merit", "Steps and stepped sines of the spool, no load.",
            (("figure of merit", "unit", *at), *_dynamic_rows(sheet)), dynamic,
            tuple(response_charts(sheet.responses)),
        ),
        _Part(
            f"Beside published figures of merit of the class, at {at[0]}",
            "Typical limits of such valves, to be checked.",
            (("figure of merit", "published", "this valve", "source"), *_class_rows(sheet)),
        ),
        *((_Part("Not to be had", "", (("oil", "figure of merit", "reason"), *absent)),) if absent else ()),
        _Part("Parameters", "At 20 °C, SI.", (("parameter", "value", "unit", "range", "meaning"), *parameters)),
    )  # fmt: skip


def _static_rows(sheet: Datasheet) -> list[tuple[str, ...]]:
    """Rows (figure of merit, unit, value at each oil temperature); a dash where it cannot be had."""
    return _rows([{f.name: f for f in one.figures} for one in sheet.benches])


def _dynamic_rows(sheet: Datasheet) -> list[tuple[str, ...]]:
    """Rows (figure of merit and amplitude, unit, value at each oil temperature)."""
    columns = []
    for one in sheet.responses:
        found: dict[str, FigureOfMerit | Absent] = {}
        tests: tuple[Any, ...] = (*one.steps, *one.sweeps)
        for test in tests:
            found.update({f"{f.name} at {100 * test.share:.0f} % of rated": f for f in test.figures})
        columns.append(found)
    return _rows(columns)


def _class_rows(sheet: Datasheet) -> list[tuple[str, str, str, str]]:
    """Rows (figure of merit, published for the class, this valve, source) at the first oil temperature."""
    rows = []
    for published, own in sheet.beside_class:
        limits = [FigureOfMerit(published.name, value, published.unit, "") for value in (published.low, published.high)]
        low, high = (merit_cells(limit)[0] for limit in limits)
        text = f"{low} {merit_cells(limits[0])[2]}" if low == high else f"{low} to {high} {merit_cells(limits[0])[2]}"
        mine = own.reason if isinstance(own, Absent) else " ".join((merit_cells(own)[0], merit_cells(own)[2]))
        rows.append((published.name.replace("_", " "), text, mine, published.source))
    return rows


def _absent_rows(sheet: Datasheet) -> list[tuple[str, str, str]]:
    """Rows (oil temperature, figure of merit, reason) of what could not be had."""
    rows = []
    for temperature, one, response in zip(sheet.oil_temperatures, sheet.benches, sheet.responses, strict=True):
        tests: tuple[Any, ...] = (*response.steps, *response.sweeps)
        figures = [*one.figures, *(f for test in tests for f in test.figures)]
        rows += [
            (f"{temperature:g} °C", f.name.replace("_", " "), f.reason) for f in figures if isinstance(f, Absent)
        ]  # fmt: skip
    return rows


def _rows(columns: Sequence[dict[str, FigureOfMerit | Absent]]) -> list[tuple[str, ...]]:
    rows = []
    for name in dict.fromkeys(name for column in columns for name in column):
        found = [column.get(name) for column in columns]
        unit = next((merit_cells(f)[2] for f in found if isinstance(f, FigureOfMerit)), "")
        cells = [merit_cells(f)[0] if isinstance(f, FigureOfMerit) else "-" for f in found]
        rows.append((name.replace("_", " "), unit, *cells))
    return rows


def _pdf(parts: Sequence[_Part], block: TitleBlock, path: Path) -> None:
    from fpdf import FPDF

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"  # DejaVu has every sign that the tables use
    pdf = FPDF(format="A4")
    pdf.add_font("sans", "", fonts / "DejaVuSans.ttf")
    pdf.add_font("sans", "B", fonts / "DejaVuSans-Bold.ttf")
    pdf.set_auto_page_break(True, margin=15)
    pdf.set_creation_date(datetime.datetime.combine(block.date, datetime.time(), datetime.UTC))
    pdf.set_title(block.title)
    pdf.add_page()
    pdf.set_font("sans", "B", 16)
    pdf.cell(text=block.title, new_x="LMARGIN", new_y="NEXT")
    pdf.set_font("sans", "", 9)
    for line in (block.origin, ORIGIN):
        pdf.multi_cell(0, text=line, new_x="LMARGIN", new_y="NEXT")
    for k, part in enumerate(parts):
        if k:
            pdf.add_page()
        pdf.set_font("sans", "B", 12)
        pdf.cell(text=part.heading, new_x="LMARGIN", new_y="NEXT", h=10)
        pdf.set_font("sans", "", 8)
        pdf.multi_cell(0, text=part.text, new_x="LMARGIN", new_y="NEXT")
        pdf.ln(2)
        widths = [max(8, *(min(len(row[c]), 44) for row in part.rows)) for c in range(len(part.rows[0]))]
        pdf.set_font("sans", "", 7)
        with pdf.table(part.rows, col_widths=tuple(widths), line_height=4, text_align="LEFT"):
            pass
        for picture in part.pictures:
            pdf.ln(3)
            pdf.image(io.BytesIO(picture.data), w=pdf.epw)
    pdf.output(str(path))
