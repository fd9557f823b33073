"""`valvesim identify`: a valve from the figures of its catalogue page or acceptance test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from valvesim.cli.display import console, print_rows, print_table, print_written, progress_bar
from valvesim.cli.options import format_option, output_file_option
from valvesim.cli.output_folder import check_free_file

if TYPE_CHECKING:
    from valvesim.characterisation.specification import Limit
    from valvesim.identification.from_figures.identify import Identification


@click.command()
@click.argument("specification", type=click.Path(path_type=Path))
@output_file_option("valve.toml")
@click.option(
    "--records", type=click.Path(path_type=Path), help="A folder with acceptance.toml: records of the valve itself."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the starts that are drawn.")
@format_option("table", "json", "csv")
def identify(specification: Path, output: Path, records: Path | None, seed: int, form: str) -> None:
    """A valve from the figures of a SPECIFICATION: catalogue page, acceptance test, or both.

    Writes a valve file for --valve: what the figures determine, with intervals and correlations, and the rest as
    similarity to a published valve has it, said to be assumed.
    """
    from valvesim.characterisation.measured_valve import load_measured_valve
    from valvesim.characterisation.specification import load_specification
    from valvesim.identification.from_figures.identify import identify as find
    from valvesim.io import located
    from valvesim.simulation.batch import cores
    from valvesim.valve.valve_file import save_valve

    check_free_file(output)
    read = load_specification(specification)
    measured = None if records is None else load_measured_valve(records)
    place = located(specification, specification.read_text(encoding="utf-8"), document="specification")
    with place, progress_bar() as bar:
        stage = bar.add_task("identifying", total=1.0)
        found = find(
            read, measured=measured, seed=seed, workers=cores(),
            progress=lambda share: bar.update(stage, completed=share),
        )  # fmt: skip
    written = save_valve(found.valve, output)
    if form == "table":
        _print(found)
        print_written([written])
    else:
        print_rows(_records(found), form)


def _print(found: Identification) -> None:
    from rich.markup import escape

    from valvesim.characterisation.judgement_table import (
        asked_text,
        condition_text,
        interval_text,
        limit_text,
        value_cells,
    )
    from valvesim.characterisation.specification import COMMON

    def named(limit: Limit) -> str:
        at = condition_text(limit.conditions, COMMON)
        return limit.figure.replace("_", " ") + (f" ({at})" if at else "")

    common, rows = found.specification.conditions.items(), []
    for one in found.figures:
        limit = one.asked.limit
        value, error, unit = value_cells(one.value, limit.unit, one.deviation)
        at = condition_text(dict(limit.conditions.items() - common))
        told = (limit.figure.replace("_", " "), at, asked_text(limit))
        rows.append((*told, value, error, unit, "yes" if one.reached else "NO"))
    print_table("asked and reached", ("figure", "condition", "asked", "value", "±", "unit", "within"), rows)
    parameters = []
    for p in found.parameters:
        value, interval, unit = interval_text(p.value, p.low, p.high, p.unit)
        ratio = f"{p.value / p.similar:.2f}" if p.similar else ""
        by = "identified" if p.identified else "assumed"
        parameters.append((p.name.replace("_", " "), value, interval, unit, ratio, by))
    print_table("parameters", ("name", "value", "value, 95 %", "unit", "of similarity's", "by"), parameters)
    screen = console()
    for conflict in found.conflicts:
        limit = conflict.figure.limit
        value, _, unit = value_cells(conflict.reached, limit.unit)
        others = " or ".join(named(a.limit) for a in conflict.against)
        against = f"; it goes once {others} is given up" if others else ""
        missed = f"{named(limit)} of {limit_text(limit)} is not reached ({value} {unit}){against}"
        screen.print(escape(f"conflict: {missed}: {conflict.reason}"))
    further = []
    for following in found.next_figures:
        value, interval, unit = interval_text(following.expected, *following.interval, following.limit.unit)
        at = condition_text(following.limit.conditions, COMMON)
        further.append((following.limit.figure.replace("_", " "), at, value, interval, unit))
    if further:
        print_table("expected of what was not told", ("figure", "condition", "value", "value, 95 %", "unit"), further)
    for following in found.next_figures[:1]:
        value, error, unit = value_cells(following.expected, following.limit.unit, following.deviation)
        screen.print(escape(
            f"measure next: {named(following.limit)}, expected {value} ± {error} {unit}; it narrows "
            f"{following.narrows.replace('_', ' ')} to {following.after / following.before:.0%} of what is open"
        ))  # fmt: skip
    for note in found.notes:
        screen.print(escape(f"note: {note}"))


def _records(found: Identification) -> list[dict[str, Any]]:
    """Figures, parameters, conflicts and further figures as rows of one form, SI."""
    blank = {"kind": "", "name": "", "conditions": "", "value": None, "unit": "", "low": None, "high": None,
             "asked": None, "asked_low": None, "asked_high": None, "note": ""}  # fmt: skip
    rows = []
    for f in found.figures:
        low, high = (f.value + sign * 1.96 * f.deviation for sign in (-1.0, 1.0))
        at = ", ".join(f"{name}={value:g}" for name, value in f.asked.limit.conditions.items())
        note = "reached" if f.reached else "not reached"
        limit = f.asked.limit
        asked = {"asked": limit.value, "asked_low": limit.low, "asked_high": limit.high}
        rows.append(blank | {"kind": "figure", "name": limit.figure, "conditions": at, "value": f.value,
                             "unit": limit.unit, "low": low, "high": high, "note": note} | {
            name: value if math.isfinite(value) else None for name, value in asked.items()
        })  # fmt: skip
    for p in found.parameters:
        note = "identified" if p.identified else "assumed"
        rows.append(blank | {"kind": "parameter", "name": p.name, "value": p.value, "unit": p.unit, "low": p.low,
                             "high": p.high, "note": note})  # fmt: skip
    for c in found.conflicts:
        against = ", ".join(a.limit.figure for a in c.against)
        rows.append(blank | {"kind": "conflict", "name": c.figure.limit.figure, "conditions": against,
                             "value": c.reached, "unit": c.figure.limit.unit, "note": c.reason})  # fmt: skip
    for n in found.next_figures:
        at = ", ".join(f"{name}={value:g}" for name, value in n.limit.conditions.items())
        low, high = n.interval
        rows.append(blank | {"kind": "next figure", "name": n.limit.figure, "conditions": at, "value": n.expected,
                             "unit": n.limit.unit, "low": low, "high": high, "note": f"gain {n.gain:.3g}"})
    return rows
