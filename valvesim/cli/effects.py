"""`valvesim effects`: the catalogue of effects."""

from __future__ import annotations

import click

from valvesim.cli.display import console


@click.command()
@click.argument("name", required=False)
def effects(name: str | None) -> None:
    """The catalogue of effects, or one of them in full."""
    from rich.markup import escape

    from valvesim.units import DISPLAY, symbol
    from valvesim.valve.catalogue import CATALOGUE, effect

    screen = console()
    for entry in [effect(name)] if name else CATALOGUE.values():
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
