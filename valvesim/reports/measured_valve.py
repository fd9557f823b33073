"""The report of a measured valve in the order of ISO 10770-1: identification, conditions, instruments, results."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, merit_cells
from valvesim.characterisation.judgement_table import VERDICT_HEADINGS, condition_text, judgement_rows, value_cells
from valvesim.characterisation.specification import COMMON, Judgement, Verdict
from valvesim.reports.acceptance import draw_test
from valvesim.reports.html_page import Banner, Picture, Section, Table, Terms, Text, section, write_html
from valvesim.reports.plotting import COLOURS, Figure, label_decades, png, styled
from valvesim.reports.title_block import TitleBlock

if TYPE_CHECKING:
    from valvesim.characterisation.measured_valve import MeasuredResult, MeasuredValve

ACCEPTANCE_TITLE = "Acceptance test"
_COLUMNS = ("figure", "value", "±", "unit", "model", "meaning")
_OUTCOMES = {
    Verdict.FAIL: ("Fails", "#d1495b", "#fbe9ec"), Verdict.UNDECIDED: ("Undecided", "#e09f3e", "#fdf4e5"),
    Verdict.PASS: ("Passes", "#2e8b57", "#e9f5ee"),
}  # fmt: skip
_LABELS = {
    "spool_position": ("spool [mm]", 1e3), "load_flow": ("flow [L/min]", 6e4),
    "load_pressure": ("load pressure [bar]", 1e-5), "current": ("current [mA]", 1e3), "voltage": ("voltage [V]", 1.0),
}  # fmt: skip


def measured_valve_report(
    measured: MeasuredValve, folder: Path, *, judged: Sequence[Judgement], model: Mapping[tuple[str, str], float],
    model_name: str, specification: str, date: datetime.date,
) -> Path:  # fmt: skip
    """Write acceptance.html into `folder`; its path.

    `model` has what a model, called `model_name`, has of each figure, by title of the test and figure.
    """
    number = f", serial number {measured.serial_number}" if measured.serial_number else ""
    block = TitleBlock(title=ACCEPTANCE_TITLE, valve=f"{measured.title or 'measured valve'}{number}", date=date)
    sections = [
        section("Identification", Terms([
            ("valve", measured.title), ("serial number", measured.serial_number),
            ("rated current", " ".join(filter(None, value_cells(measured.rated_current, "A")))),
            ("specification", specification), ("model beside it", model_name),
        ])),
        section("Conditions", Text(_sentence(condition_text(measured.conditions)) or "None stated.")),
        section("Instruments", Table(("instrument", "within, of the reading"), [
            (name, f"±{100.0 * share:g} %") for name, share in measured.instruments.items()
        ], (1,))),
        section("Verdicts", Table(VERDICT_HEADINGS, judgement_rows(judged, COMMON), (4,))),
        *(_test_section(test, model, block) for test in measured.tests),
    ]  # fmt: skip
    return write_html(folder / "acceptance.html", block, sections, banner=_banner(judged))


def _banner(judged: Sequence[Judgement]) -> Banner | None:
    """The outcome: the worst verdict of all figures that were measured."""
    for outcome, (words, edge, ground) in _OUTCOMES.items():
        named = [one.limit.figure.replace("_", " ") for one in judged if one.verdict == outcome]
        if named:
            missing = sum(one.verdict == Verdict.NOT_MEASURED for one in judged)
            text = ", ".join(dict.fromkeys(named)) if outcome != Verdict.PASS else "every figure that was measured"
            return Banner(words, f"{text}{f'; {missing} not measured' if missing else ''}", edge, ground)
    return None


def _test_section(test: MeasuredResult, model: Mapping[tuple[str, str], float], block: TitleBlock) -> Section:
    """A test: conditions, figures beside the model's, picture."""
    rows = []
    for figure in test.figures:
        name = figure.name.rpartition(".")[2].replace("_", " ")
        if isinstance(figure, Absent):
            rows.append((name, "absent", "", "", "", figure.reason))
            continue
        own = model.get((test.title, figure.name))
        beside = "" if own is None else merit_cells(FigureOfMerit(figure.name, own, figure.unit, ""))[0]
        value, error, unit = merit_cells(figure)
        rows.append((name, value, error, unit, beside, figure.doc))
    words = condition_text(test.conditions)
    notes = [Text(note) for note in test.notes]
    picture = Picture(png(draw_result(test), block), f"{_sentence(test.title)}.")
    return section(_sentence(test.title), Text(words), *notes, Table(_COLUMNS, rows, (1, 2, 4)), picture)


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


@styled
def draw_result(test: MeasuredResult) -> Figure:
    """The record of a test: output over current of slow cycles, Bode of a response, else columns over time."""
    figure = Figure(figsize=(9, 4.6))
    figure.subplots_adjust(left=0.09, right=0.97, top=0.92, bottom=0.12, hspace=0.25)
    values = test.values
    if test.test in ("flow", "pressure-gain", "leakage", "flow-load"):
        merits = {one.name.removeprefix(f"{test.test}.").removesuffix("_positive"): one for one in test.figures}
        if test.test == "flow":
            merits |= {one.name.removeprefix("flow."): one for one in test.figures}
        draw_test(figure.subplots(), AcceptanceRecord(source=test.source, values=dict(values)), test.test, merits)
    elif test.test == "null-shift":
        axis = figure.subplots()
        name = next(iter(values))
        scale, unit = (1.0, "°C") if name == "oil_temperature" else (1e-5, "bar")
        axis.plot(values[name] * scale, values["null_bias"] * 100.0, "o-", color=COLOURS[0])
        axis.set(xlabel=f"{name.replace('_', ' ')} [{unit}]", ylabel="null [% of rated current]")
    elif test.response is not None:
        above, below = figure.subplots(2, 1, sharex=True)
        keep = test.response.credible
        curves = ((above, test.response.amplitude_ratio, -3.0), (below, test.response.phase_lag, 90.0))
        for axis, curve, level in curves:
            axis.semilogx(test.response.frequency[keep], curve[keep], "o-", color=COLOURS[0], ms=3)
            axis.axhline(level, color="0.5", lw=0.8, ls="--")
        label_decades(below.xaxis)
        above.set(ylabel="amplitude ratio [dB]")
        below.set(xlabel="frequency [Hz]", ylabel="phase lag [degrees]")
    else:
        names = [name for name in values if name in _LABELS]
        for axis, name in zip(np.atleast_1d(figure.subplots(len(names), 1, sharex=True)), names, strict=True):
            label, factor = _LABELS[name]
            axis.plot(values["time"], values[name] * factor, color=COLOURS[0], lw=0.9)
            axis.set(ylabel=label)
        figure.axes[-1].set(xlabel="time [s]")
    return figure
