"""The datasheet as a page (HTML, pictures inside) and as a PDF."""

from __future__ import annotations

import base64
import html
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

from valvesim.characterisation.datasheet import Datasheet, absent_rows, class_rows, dynamic_rows, measure, static_rows
from valvesim.io import check_folder, write_atomically
from valvesim.reports.acceptance import picture_bench
from valvesim.reports.response import draw_responses
from valvesim.units import quantities, range_text, symbol
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True)
class _Section:
    """A heading with a table (first row its headings) and pictures under it."""

    heading: str
    text: str
    rows: tuple[tuple[str, ...], ...] = ()
    pictures: tuple[Path, ...] = ()


def datasheet_report(
    valve: Valve, oil: Oil, folder: Path, *, oil_temperatures: Sequence[float],
    progress: Callable[[float], None] | None = None,
) -> tuple[Path, Path]:  # fmt: skip
    """Measure the valve (`datasheet.measure`) and write datasheet.html and datasheet.pdf into `folder`; their paths."""
    check_folder(folder)
    sheet = measure(valve, oil, oil_temperatures=oil_temperatures, progress=progress)
    with tempfile.TemporaryDirectory() as scratch:
        sections = _sections(sheet, Path(scratch))

        def write_page(path: Path) -> None:
            path.write_text(_html(sections), encoding="utf-8")

        page = write_atomically(folder / "datasheet.html", write_page)
        return page, write_atomically(folder / "datasheet.pdf", lambda path: _pdf(sections, path))


def _sections(sheet: Datasheet, scratch: Path) -> tuple[_Section, ...]:
    at = tuple(f"{t:g} °C" for t in sheet.oil_temperatures)
    low, high = sheet.oil.rated_low, sheet.oil.rated_high
    beyond = [t for t in sheet.oil_temperatures if not low <= t <= high]
    validity = f"Oil {sheet.oil.name}, rated {low:g} to {high:g} °C, all parts at the oil's temperature." + (
        f" Extrapolated beyond the oil's rating: {', '.join(f'{t:g} °C' for t in beyond)}." if beyond else ""
    )
    benches = tuple(
        picture_bench(one, scratch / f"bench_{k}.png") for k, one in enumerate(sheet.benches)
    )  # fmt: skip
    drawn = draw_responses(sheet.responses, scratch)
    absent = absent_rows(sheet)
    figures = [
        (name, f"{getattr(sheet.valve, name):.6g}", symbol(f.metadata["unit"]), range_text(f), f.metadata["doc"])
        for name, f in quantities(sheet.valve).items()
    ]
    return (
        _Section("Static figures", validity, (("figure", "unit", *at), *static_rows(sheet)), benches),
        _Section(
            "Dynamic figures", "Steps and stepped sines of the spool, no load.",
            (("figure", "unit", *at), *dynamic_rows(sheet)), drawn,
        ),
        _Section(
            f"Beside published figures of the class, at {at[0]}", "Typical limits of such valves, to be checked.",
            (("figure", "published", "this valve", "source"), *class_rows(sheet)),
        ),
        *((_Section("Not to be had", "", (("oil", "figure", "reason"), *absent)),) if absent else ()),
        _Section("Parameters", "At 20 °C, SI.", (("parameter", "value", "unit", "range", "meaning"), *figures)),
    )  # fmt: skip


_CSS = """body{font:15px/1.5 system-ui,sans-serif;max-width:1050px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0;font-size:14px}td,th{padding:.25em .8em;border-bottom:1px solid #ddd;
text-align:left}th{background:#f4f6f9}img{max-width:100%;margin:.6em 0}h1{margin-bottom:0}"""


def _html(sections: Sequence[_Section]) -> str:
    parts = [f"<!doctype html><meta charset='utf-8'><title>Servo valve datasheet</title><style>{_CSS}</style>"]
    parts.append("<h1>Servo valve datasheet</h1><p>Computed by valvesim from the model; no valve was measured.</p>")
    for section in sections:
        parts.append(f"<h2>{html.escape(section.heading)}</h2><p>{html.escape(section.text)}</p>")
        for k, row in enumerate(section.rows):
            cell = "th" if k == 0 else "td"
            cells = "".join(f"<{cell}>{html.escape(text)}</{cell}>" for text in row)
            parts.append(f"{'<table>' if k == 0 else ''}<tr>{cells}</tr>")
        parts.append("</table>" if section.rows else "")
        for picture in section.pictures:
            data = base64.b64encode(picture.read_bytes()).decode()
            parts.append(f"<img alt='{picture.stem}' src='data:image/png;base64,{data}'>")
    return "\n".join(parts)


def _pdf(sections: Sequence[_Section], path: Path) -> None:
    from fpdf import FPDF

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"  # DejaVu has every sign that the tables use
    pdf = FPDF(format="A4")
    pdf.add_font("sans", "", fonts / "DejaVuSans.ttf")
    pdf.add_font("sans", "B", fonts / "DejaVuSans-Bold.ttf")
    pdf.set_auto_page_break(True, margin=15)
    pdf.add_page()
    pdf.set_font("sans", "B", 16)
    pdf.cell(text="Servo valve datasheet", new_x="LMARGIN", new_y="NEXT")
    pdf.set_font("sans", "", 9)
    pdf.cell(text="Computed by valvesim from the model; no valve was measured.", new_x="LMARGIN", new_y="NEXT")
    for k, section in enumerate(sections):
        if k:
            pdf.add_page()
        pdf.set_font("sans", "B", 12)
        pdf.cell(text=section.heading, new_x="LMARGIN", new_y="NEXT", h=10)
        pdf.set_font("sans", "", 8)
        pdf.multi_cell(0, text=section.text, new_x="LMARGIN", new_y="NEXT")
        pdf.ln(2)
        widths = [max(8, *(min(len(row[c]), 44) for row in section.rows)) for c in range(len(section.rows[0]))]
        pdf.set_font("sans", "", 7)
        with pdf.table(section.rows, col_widths=tuple(widths), line_height=4, text_align="LEFT"):
            pass
        for picture in section.pictures:
            pdf.ln(3)
            pdf.image(picture, w=pdf.epw)
    pdf.output(str(path))
