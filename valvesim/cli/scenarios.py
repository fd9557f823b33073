"""`valvesim scenarios`: the scenarios that come along."""

from __future__ import annotations

from pathlib import Path

import click

from valvesim.cli.display import print_rows, print_table, print_written
from valvesim.cli.options import format_option, output_file_option
from valvesim.cli.output_folder import check_free_file


@click.command()
@click.argument("name", required=False)
@output_file_option(None, "Copy the scenario to this file, to change it.")
@format_option("table", "json", "csv")
def scenarios(name: str | None, output: Path | None, form: str) -> None:
    """The scenarios that come along; with a NAME the text of one, or with -o a copy of it.

    Each runs by its name from anywhere: valvesim run launch_shock.
    """
    from valvesim.errors import InputError, unknown_name
    from valvesim.io import read_toml, write_atomically, write_text
    from valvesim.simulation.scenario_files import bundled_scenarios

    known = bundled_scenarios()
    if name is None:
        if output is not None:
            raise InputError("-o needs the NAME of a scenario")
        rows = []
        for own, path in known.items():
            _, table = read_toml(path)
            rows.append((own, str(table.get("title", "")), str(table.get("duration", ""))))
        headings = ("name", "title", "duration")
        if form == "table":
            print_table("scenarios that come along", headings, rows)
        else:
            print_rows([dict(zip(headings, row, strict=True)) for row in rows], form)
        return
    if name not in known:
        raise unknown_name("scenario", name, known)
    text = known[name].read_text(encoding="utf-8")
    if output is None:
        click.echo(text, nl=False)
        return
    files = [path for path in known[name].parent.glob("*.csv") if path.name in text]
    copies = [(output, text), *((output.parent / file.name, file.read_text("utf-8")) for file in files)]
    check_free_file(*(file for file, _ in copies))
    for file, content in copies:
        print_written([write_atomically(file, lambda path, content=content: write_text(path, content))])  # type: ignore[misc]
