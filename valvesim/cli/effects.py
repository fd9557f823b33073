"""`valvesim effects`: the catalogue of effects."""

from __future__ import annotations

import click

from valvesim.cli.display import console, print_rows
from valvesim.cli.options import format_option


@click.command()
@click.argument("name", required=False)
@format_option("table", "json", "csv")
def effects(name: str | None, form: str) -> None:
    """The catalogue of effects, or one of them in full."""
    from rich.markup import escape

    from valvesim.units import DISPLAY, symbol
    from valvesim.valve.catalogue import CATALOGUE, effect

    chosen = [effect(name)] if name else list(CATALOGUE.values())
    if form != "table":
        print_rows([
            {"effect": entry.name, "parameter": p.name, "unit": p.unit, "default": p.default, "low": p.bounds[0],
             "high": p.bounds[1], "neutral": p.neutral, "typical": p.typical, "meaning": p.doc}
            for entry in chosen for p in entry.parameters
        ], form)  # fmt: skip
        return
    screen = console()
    for entry in chosen:
        screen.print(f"[bold]{entry.name}[/bold]  {escape(entry.doc)}")
        screen.print(escape(f"  acts in: {entry.location}\n  shows as: {entry.signature}"))
        for p in entry.parameters:
            unit, factor = DISPLAY.get(p.unit, (p.unit, 1.0))
            low, high = (f"{bound * factor:g}" for bound in p.bounds)
            value = "neutral at" if p.neutral is not None else "default"
            seen = "" if p.typical is None else f", in service {p.typical * factor:g}"
            line = f"  {p.name} [{symbol(unit)}], {low} to {high}, {value} {p.default * factor:g}{seen}: {p.doc}"
            screen.print(escape(line))
        screen.print()
