"""What a valve, a scenario, a result, a diagnosis and the like show of themselves in a notebook, and how they plot.

Made of the same blocks as the pages (`reports`). It stands beside the command line on top of the layers and is loaded
by its name (`shown`) when an object is first looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from valvesim.characterisation.acceptance.acceptance_tests import AcceptanceTests
from valvesim.characterisation.datasheet import Datasheet
from valvesim.characterisation.figure_of_merit import merit_rows
from valvesim.characterisation.held_scenario import command_of, held_oil_temperature
from valvesim.characterisation.judgement_table import FIGURE_HEADINGS
from valvesim.characterisation.response_set import ResponseSet
from valvesim.characterisation.spectral_response import spectral_response
from valvesim.diagnosis.result import Diagnosis
from valvesim.errors import InputError
from valvesim.reports.acceptance import draw_acceptance
from valvesim.reports.diagnosis.page import banner, causes
from valvesim.reports.html_page import Block, Listing, Table, Terms, Text, fragment, section
from valvesim.reports.plotting import Figure
from valvesim.reports.response import draw_responses
from valvesim.reports.run import draw_channels, draw_run, draw_sweep
from valvesim.reports.run_table import RUN_HEADINGS, run_rows
from valvesim.simulation.result import Result
from valvesim.simulation.scenario import Scenario
from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.parameters import Valve, reference_valve


@singledispatch
def html(thing: Any) -> str:
    """The page of an object within a notebook."""
    return fragment((section("", Text(repr(thing))),))


@html.register
def _(valve: Valve) -> str:
    reference = reference_valve()
    rows: list[tuple[str, ...]] = []
    for name, field in quantities(valve).items():
        value, usual, data = getattr(valve, name), getattr(reference, name), field.metadata
        changed = bool(np.ndim(value) or value != usual)
        unit, factor = DISPLAY.get(data["unit"], (data["unit"], 1.0))
        before = _figure(usual, factor) if changed else ""
        row = (name, _figure(value, factor), symbol(unit), before, data["doc"])
        rows.insert(sum(bool(one[3]) for one in rows) if changed else len(rows), row)
    headings = ("parameter", "value", "unit", "reference", "meaning")
    return fragment((section("", Text(f"Valve: {valve.in_words()}", strong=True), Table(headings, rows, (1, 3))),))


@html.register
def _(scenario: Scenario) -> str:
    try:
        text = scenario.to_toml()
    except InputError as error:
        text = f"# cannot be written as a file: {error}"
    words = Text(f"Scenario: {scenario.in_words()}", strong=True)
    return fragment((section("", words, Listing("scenario.toml", ", as a file", text)),))


@html.register
def _(result: Result) -> str:
    words: list[Block] = [Text(f"Result: {result.in_words()}", strong=True)]
    return fragment((section("", *words, Table(RUN_HEADINGS, run_rows(result, result.names), (2, 3, 4))),))


@html.register
def _(diagnosis: Diagnosis) -> str:
    facts = Terms((("Where", diagnosis.location), ("Verdict", diagnosis.verdict.replace("_", " "))))
    return fragment((section("", facts), causes(diagnosis)), banner=banner(diagnosis))


@html.register
def _(tests: AcceptanceTests) -> str:
    return fragment((section("", Text(repr(tests)), Table(FIGURE_HEADINGS, merit_rows(tests.figures), (1, 2))),))


@html.register
def _(responses: ResponseSet) -> str:
    tests: Sequence[Any] = (*responses.steps, *responses.sweeps)
    parts: list[Block] = [Text(repr(responses))]
    for test in tests:
        kind = "Step" if test in responses.steps else "Sines"
        heading = Text(f"{kind} of {100 * test.share:.3g} % of rated")
        parts += [heading, Table(FIGURE_HEADINGS, merit_rows(test.figures), (1, 2))]
    return fragment((section("", *parts),))


@html.register
def _(sheet: Datasheet) -> str:
    parts = [html(one) for one in (*sheet.benches, *sheet.responses)]
    return "".join(parts)


def plot(thing: Any, names: Sequence[str] = ()) -> Figure | dict[str, Figure]:
    """The figure of a result (of some channels), of acceptance tests; of responses the figures by name."""
    if isinstance(thing, Result):
        return draw_channels(thing, names) if names else draw_run(thing)
    if isinstance(thing, AcceptanceTests):
        return draw_acceptance(thing)
    return draw_responses((thing,))


def bode(result: Result, output: str) -> Figure:
    """The frequency response of a channel to the command of a run. Raises InputError as `spectral_response` does."""
    result.select((output,))
    response = spectral_response(
        result.time, command_of(result), result.values[output], channel=output,
        oil_temperature=held_oil_temperature(result.scenario),
    )  # fmt: skip
    return draw_sweep(result, response)


def _figure(value: Any, factor: float) -> str:
    """A quantity in the unit that people read; of a batch how many there are."""
    return f"{len(value)} values" if np.ndim(value) else f"{float(value) * factor:.6g}"
