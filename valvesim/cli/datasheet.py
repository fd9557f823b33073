"""`valvesim datasheet`: the datasheet of a valve as a page and a PDF."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import print_written, progress_bar
from valvesim.cli.options import output_option, settings_option, temperatures_option, valve_option
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@output_option("results/datasheet")
@temperatures_option
@valve_option
@settings_option
def datasheet(output: Path, oil_temperature: str, valve: str | None, settings: tuple[str, ...]) -> None:
    """The datasheet of a valve at any oil temperatures: datasheet.html and datasheet.pdf, pictures inside."""
    from valvesim.characterisation.datasheet import measure
    from valvesim.reports.datasheet import datasheet_report
    from valvesim.simulation.scenario_toml import read_tables
    from valvesim.units import parse_list

    own = read_tables(settings, valve=valve)
    temperatures = parse_list(oil_temperature, "degC", "--oil-temperature").tolist()
    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("testing the valve", total=1.0)
        sheet = measure(
            own.valve, own.oil, effects=own.effects, oil_temperatures=temperatures,
            progress=lambda share: bar.update(stage, completed=share),
        )  # fmt: skip
        written = datasheet_report(sheet, folder, date=date.today())
    print_written([output / path.name for path in written])
