"""Pictures and page of a plan: detection limits, the isolability matrix, how well parameters would be known."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvesim.reports.diagnosis.words import unit_of, with_unit
from valvesim.reports.html_page import Bullets, Picture, Section, Table, Terms, Text, section, write_html
from valvesim.reports.plotting import COLOURS, Figure, label_decades, png, styled, write_bytes
from valvesim.reports.title_block import TitleBlock

if TYPE_CHECKING:
    from valvesim.planning.outlook import CauseOutlook, Outlook, ParameterOutlook
    from valvesim.planning.plan import Plan

PARAMETER_VERDICTS = {
    "known": "known", "partly": "partly", "together": "together with others", "hardly": "by its prior alone",
    "combination": "as a combination alone", "unseen": "not seen",
}  # fmt: skip
"""How well a parameter would be known, in words; the last two are structural."""
MOST_RIVALS = 6  # of a cause that are named
PLAN_CAPTIONS = {
    "isolability": (
        "How surely the cause of a row, at the size of the aim, is told from that of a column. Grey: two names of one "
        "thing. Crossed: the structure of the equations with these sensors does not tell them apart whatever they do "
        "over time; where a crossed field is green, the known laws of the two causes do."
    ),
    "detection": "Amplitude that passes the alarm nine times in ten, as a share of the size of the aim.",
    "parameters": "Standard deviation that the tests would leave of each parameter, as a share of that of its prior.",
}


def plan_report(plan: Plan, folder: Path, *, valve: str, date: datetime.date) -> tuple[Path, ...]:
    """Write the pictures and plan.html into a folder; their paths."""
    block = TitleBlock(title=f"Plan of tests: {plan.bench.session.title}", valve=valve, date=date)
    pictures = {
        "isolability": png(draw_isolability(plan.outlook, plan.structural), block),
        "detection": png(draw_detection(plan.outlook), block),
        "parameters": png(draw_parameters(plan.outlook.parameters), block),
    }
    paths = [write_bytes(data, folder / f"{name}.png") for name, data in pictures.items()]
    return *paths, write_html(folder / "plan.html", block, _sections(plan, pictures))


def _sections(plan: Plan, pictures: dict[str, bytes]) -> list[Section]:
    chosen = plan.selection
    tests = Table(("test", "repeats", "s in all"), test_rows(plan), (1, 2))
    told = [Text(f"{len(chosen.reached)} of {len(chosen.reached) + len(chosen.missed)} goals are reached.")]
    if chosen.added is not None:
        told.append(Text(added_words(plan)))
    missed = missed_words(plan)
    parts = [
        section("Tests to run", tests, *told, Bullets(plan.notes)),
        section("What would be detected", Picture(pictures["detection"], PLAN_CAPTIONS["detection"]),
                Table(CAUSE_HEADINGS, [cause_row(one) for one in plan.outlook.causes], (1, 2, 3, 4))),
        section("What could be told apart", Picture(pictures["isolability"], PLAN_CAPTIONS["isolability"]),
                *((Bullets(missed),) if missed else ())),
        section("How well parameters would be known", Picture(pictures["parameters"], PLAN_CAPTIONS["parameters"]),
                Table(PARAMETER_HEADINGS, [parameter_row(one) for one in plan.outlook.parameters], (1, 2, 3))),
    ]  # fmt: skip
    if chosen.advice:
        rows = [(_names(a.channels), f"{a.cost:g}", str(len(a.reached))) for a in chosen.advice]
        parts.append(section("One more sensor", Table(("sensor", "cost", "goals more"), rows, (1, 2))))
    terms = [(sensor.channel.replace("_", " "), _amount(float(sensor.noise or 0.0), sensor.unit))
             for sensor in plan.bench.sensors]  # fmt: skip
    parts.append(section("Sensors and their noise", Terms(terms)))
    return parts


CAUSE_HEADINGS = ("cause", "size asked", "detected from", "power at that size", "told from the others from", "hardest")
PARAMETER_HEADINGS = ("parameter", "nominal", "± prior (1 sigma)", "± after (1 sigma)", "how")


def test_rows(plan: Plan) -> list[tuple[str, ...]]:
    """(test, repeats, duration) of each test, and of the one to hold out."""
    rows: list[tuple[str, ...]] = [
        (one.experiment.description, str(one.repeats), f"{one.duration:g}") for one in plan.tests
    ]
    if plan.validation is not None:
        time = float(plan.validation.time[-1]) + plan.bench.setup
        rows.append((f"{plan.validation.description} (held out for validation)", "1", f"{time:g}"))
    return rows


def cause_row(one: CauseOutlook) -> tuple[str, ...]:
    """A cause with what is to be expected of it."""
    limit = "not within its limits" if one.limit is None else _amount(one.limit, one.unit)
    isolated = "not within its limits" if one.isolated is None else _amount(one.isolated, one.unit)
    shape = "".join(f" ({name.replace('_', ' ')} {value:g})" for name, value in one.shape)
    return one.label + shape, _amount(one.size, one.unit), limit, f"{one.power:.0%}", isolated, one.rival


def parameter_row(one: ParameterOutlook) -> tuple[str, ...]:
    """A parameter with its deviations before and after."""
    how = PARAMETER_VERDICTS[one.verdict] + (f": {', '.join(one.partners)}" if one.partners else "")
    size = max(abs(one.nominal), one.prior)
    figures = (_amount(value, one.unit, size) for value in (one.nominal, one.prior, one.posterior))
    return one.name, *figures, how


def added_words(plan: Plan) -> str:
    """What the cheapest added sensors bring; "" where none is advised."""
    added = plan.selection.added
    if added is None:
        return ""
    sensors = "sensor" if len(added.channels) == 1 else "sensors"
    return f"{len(added.reached)} goals more with the {sensors} {_names(added.channels)} (cost {added.cost:g})"


def _names(channels: Sequence[str]) -> str:
    return " and ".join(name.replace("_", " ") for name in channels)


def missed_words(plan: Plan) -> list[str]:
    """What is not reached, cause by cause."""
    words, rivals = [], dict[str, list[str]]()
    for goal in plan.selection.missed:
        if goal.kind == "isolate":
            rivals.setdefault(goal.of, []).append(goal.rival)
        else:
            words.append(f"{goal.kind} {goal.of}: not at the size or deviation asked")
    undetected = {goal.of for goal in plan.selection.missed if goal.kind == "detect"}
    for cause, others in rivals.items():
        if cause not in undetected:
            more = " and others" if len(others) > MOST_RIVALS else ""
            words.append(f"{cause} is not told from {', '.join(others[:MOST_RIVALS])}{more}")
    return words


def _amount(value: float, unit: str, size: float | None = None) -> str:
    """A figure to three digits, in the unit that people use for that size [its own]."""
    shown, factor = unit_of(unit, value if size is None else size)
    return with_unit(f"{float(f'{value * factor:.3g}'):g}", shown)


@styled
def draw_isolability(outlook: Outlook, structural: np.ndarray) -> Figure:
    """Power to tell each cause (row) from each other (column); the diagonal is the power to detect it."""
    labels = [cause.label for cause in outlook.causes]
    powers = outlook.powers.copy()
    for k, cause in enumerate(outlook.causes):
        powers[k, k] = cause.power
    size = max(4.5, 2.6 + 0.27 * len(labels))
    figure = Figure(figsize=(size + 1.2, size), layout="constrained")
    axis = figure.subplots()
    shown = np.ma.masked_invalid(powers)
    image = axis.imshow(shown, cmap="RdYlGn", vmin=0.0, vmax=1.0, aspect="auto")
    axis.set_facecolor("0.85")
    crossed = np.argwhere(~structural)
    axis.plot(crossed[:, 1], crossed[:, 0], "x", color="0.25", ms=4, lw=0)
    axis.set_xticks(range(len(labels)), labels, rotation=90, fontsize=7)
    axis.set_yticks(range(len(labels)), labels, fontsize=7)
    axis.set_xlabel("told from (diagonal: detected)")
    axis.grid(visible=False)
    figure.colorbar(image, ax=axis, label="power", fraction=0.04)
    return figure


@styled
def draw_detection(outlook: Outlook) -> Figure:
    """Detection and isolation limits of each cause as shares of the size asked."""
    causes = outlook.causes
    figure = Figure(figsize=(8.0, max(2.2, 1.0 + 0.24 * len(causes))), layout="constrained")
    axis = figure.subplots()
    places = np.arange(len(causes))[::-1]
    for limit, colour, marker, label in (
        ([c.limit for c in causes], COLOURS[0], "o", "detected from"),
        ([c.isolated for c in causes], COLOURS[1], "D", "told from the others from"),
    ):
        shares = np.array([np.nan if value is None else value / c.size for value, c in zip(limit, causes, strict=True)])
        axis.plot(shares, places, marker, color=colour, ms=5 if marker == "o" else 4, label=label, lw=0,
                  mfc=colour if marker == "o" else "none")  # fmt: skip
    axis.axvline(1.0, color="0.3", lw=1.0, ls="--")
    axis.set_xscale("log")
    label_decades(axis.xaxis)
    axis.set_yticks(places, [c.label for c in causes], fontsize=7)
    for place, cause in zip(places, causes, strict=True):
        if cause.limit is None:
            axis.text(0.99, place, "not seen", transform=axis.get_yaxis_transform(), ha="right", va="center",
                      fontsize=7, color="0.4")  # fmt: skip
    axis.set_xlabel("share of the size asked (dashed line)")
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


@styled
def draw_parameters(parameters: Sequence[ParameterOutlook]) -> Figure:
    """The deviation that is left of each parameter, as a share of its prior's, best known first."""
    ranked = sorted(parameters, key=lambda one: one.posterior / one.prior)
    figure = Figure(figsize=(8.0, max(2.2, 1.0 + 0.2 * len(ranked))), layout="constrained")
    axis = figure.subplots()
    shades = (COLOURS[2], "#9acd7a", COLOURS[3], COLOURS[1], COLOURS[4], "0.6")
    colours: dict[str, Any] = dict(zip(PARAMETER_VERDICTS, shades, strict=True))
    places = np.arange(len(ranked))[::-1]
    for verdict, words in PARAMETER_VERDICTS.items():
        own = [k for k, one in enumerate(ranked) if one.verdict == verdict]
        shares = [ranked[k].posterior / ranked[k].prior for k in own]
        axis.barh(places[own], shares, color=colours[verdict], label=words, height=0.7)
    axis.set_yticks(places, [one.name for one in ranked], fontsize=7)
    axis.set_xlim(0.0, 1.0)
    axis.set_xlabel("standard deviation after the tests over that before")
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return figure
