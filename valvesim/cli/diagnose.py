"""`valvesim diagnose`: what the simulation gets wrong in a measured session."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import console, print_rows, print_written, progress_bar
from valvesim.cli.options import format_option, output_option, valve_option
from valvesim.cli.output_folder import all_or_nothing
from valvesim.cli.permissions import remember_files


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@output_option("results/diagnosis")
@click.option("--seed", type=click.IntRange(min=0), help="Of all draws, in place of the session's own [0].")
@click.option(
    "--effects", "own", multiple=True, type=click.Path(path_type=Path), help="A Python file of your own effects."
)
@valve_option
@format_option("table", "json", "csv")
def diagnose(
    session: Path, output: Path, seed: int | None, own: tuple[Path, ...], valve: str | None, form: str
) -> None:  # fmt: skip
    """What the simulation gets wrong in a measured SESSION: cause, extended model, gain on hold-out records.

    Writes diagnosis.json, report.html with its pictures, extended.toml (a scenario for `valvesim run`) and, where one
    helps, the next test as next_test.csv: all of them, or nothing.
    """
    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("reading", total=1.0)
        from valvesim.diagnosis.diagnose import diagnose as find
        from valvesim.identification.session_toml import load_session

        read = load_session(session, seed=seed, effects=own, valve=valve)
        remember_files(own)  # the extended model names them
        found = find(
            read,
            progress=lambda text, share: bar.update(stage, description=text, completed=share),
        )
        bar.update(stage, description="drawing", total=None)
        names = [path.name for path in _write_diagnosis(found, read, folder)]
    remember_files(output / name for name in found.extended_effects)
    if form != "table":
        _print_rows(found, form)
        return
    _print_diagnosis(found)
    print_written([output / name for name in names])


def _write_diagnosis(found: Any, session: Any, folder: Path) -> list[Path]:
    from valvesim.reports.diagnosis.page import write_report
    from valvesim.reports.title_block import valve_name

    texts = {"extended.toml": found.extended_scenario, **found.extended_effects}
    if found.next_test is not None and found.next_test.inputs:
        texts["next_test.csv"] = _columns_text(found.next_test.inputs)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    written = [found.to_json(folder / "diagnosis.json"), *(folder / name for name in texts)]
    facts = (("Session", session.title), ("Oil", session.oil.name), ("Seed", str(session.seed)))
    named = valve_name(session.valve)
    return [*written, *write_report(found, folder, valve=named, date=date.today(), facts=facts)]


def _columns_text(columns: dict[str, Any]) -> str:
    """A CSV of inputs over time, as a session reads it: `name [unit]` over figures as people read them."""
    import numpy as np

    from valvesim.identification.session import UNITS
    from valvesim.io import columns_rows, csv_text
    from valvesim.units import DISPLAY

    shown = {name: DISPLAY.get(UNITS[name], (UNITS[name], 1.0)) for name in columns}
    scaled = [np.asarray(values) * shown[name][1] for name, values in columns.items()]
    return csv_text((f"{name} [{unit}]" for name, (unit, _) in shown.items()), columns_rows(scaled))


def _print_rows(found: Any, form: str) -> None:
    """The whole answer as JSON; as CSV its figures with their intervals, a verdict without any in a row of its own."""
    if form == "json":
        click.echo(json.dumps(found.to_dict(), indent=1))
        return
    rows = [
        {"verdict": found.verdict, "cause": e.cause, "figure": e.name, "value": e.value, "low": e.low, "high": e.high,
         "unit": e.unit}
        for e in found.parameters
    ]  # fmt: skip
    blank = {"cause": "", "figure": "", "value": None, "low": None, "high": None, "unit": ""}
    print_rows(rows or [{"verdict": found.verdict} | blank], form)


def _print_diagnosis(found: Any) -> None:
    """Verdict, causes with their figures, next test and gain, a line each."""
    from rich.markup import escape

    from valvesim.reports.diagnosis.words import unit_of, with_unit

    screen = console()
    screen.print(f"[bold]{found.verdict.replace('_', ' ')}[/bold]: {escape(found.summary)}")
    if found.location:
        screen.print(escape(f"where: {found.location}"))
    for e in found.parameters:
        unit, factor = unit_of(e.unit, e.value, e.name)
        value, low, high = (f"{figure * factor:.4g}" for figure in (e.value, e.low, e.high))
        known = "held fixed" if e.low == e.high else f"95 %: {low} to {high}"
        screen.print(escape(f"  {e.cause}: {e.name} = {with_unit(value, unit)} ({known})"))
    if found.term is not None:
        term = f"{found.term.port} as a function of {found.term.variable}".replace("_", " ")
        formula = f": {found.term.formula}" if found.term.formula else ""
        beside = "missing term" if found.verdict == "unknown" else "or a term, if it is none of these"
        screen.print(escape(f"{beside}: {term}{formula}"))
    if len(found.candidates) > 1 and found.verdict in ("ambiguous", "unknown"):
        ranked = ", ".join(f"{c.label} {c.probability:.0%}" for c in found.candidates[:4])
        screen.print(escape(f"candidates: {ranked}"))
    if (test := found.next_test) is not None:
        power = f"tells {' from '.join(test.separates)} with a probability of {test.power:.0%}"
        power += ", and no other test does better" if test.uninformative else ""
        screen.print(escape(f"next test, {test.duration:g} s: {test.description}; {power}"))
    elif found.no_test:
        screen.print(found.no_test)
    for todo in found.what_to_do:
        screen.print(escape(f"{todo.label}: {todo.part}"))
        screen.print(escape(f"  inspect: {todo.inspect}"))
        screen.print(escape(f"  confirm: {todo.confirm}"))
        screen.print(escape(f"  remedy: {todo.remedy}"))
    for g in found.gain:
        told = "" if g.claimed else ", not claimed"
        screen.print(escape(f"gain on {g.record}: error {g.before:.3g} -> {g.after:.3g} (noise {g.floor:.3g}){told}"))
    for note in found.notes:
        screen.print(escape(f"note: {note}"))
