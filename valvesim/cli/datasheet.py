"""`valvesim datasheet`: the datasheet of a valve as a page and a PDF."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import print_rows, print_table, print_written, progress_bar
from valvesim.cli.judging import end_on_failure, judged_by, oil_temperatures, read_specification
from valvesim.cli.options import (
    format_option,
    output_option,
    settings_option,
    specification_option,
    temperatures_option,
    valve_option,
)
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@output_option("results/datasheet")
@temperatures_option
@valve_option
@specification_option
@format_option("table", "json", "csv")
@settings_option
def datasheet(
    output: Path, oil_temperature: str | None, valve: str | None, spec: Path | None, form: str,
    settings: tuple[str, ...],
) -> None:  # fmt: skip
    """The datasheet of a valve at any oil temperatures: datasheet.html and datasheet.pdf, pictures inside."""
    from valvesim.characterisation.datasheet import datasheet_tests, measure
    from valvesim.characterisation.judgement_table import VERDICT_HEADINGS, judgement_rows, rows_of
    from valvesim.characterisation.specification import COMMON
    from valvesim.reports.datasheet import datasheet_report
    from valvesim.simulation.scenario_toml import read_tables

    limits = read_specification(spec)
    own = read_tables(settings, valve=valve)
    temperatures = oil_temperatures(oil_temperature, limits)
    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("testing the valve", total=1.0)
        sheet = measure(
            own.valve, own.oil, effects=own.effects, oil_temperatures=temperatures,
            progress=lambda share: bar.update(stage, completed=share),
        )  # fmt: skip
        tests = datasheet_tests(sheet, limits)
        judged = judged_by(limits, tests, valve=own.valve)
        written = datasheet_report(sheet, folder, judged=judged, date=date.today())
    if form != "table":
        print_rows(rows_of(tests, judged), form)
    else:
        if judged:
            print_table("verdicts", VERDICT_HEADINGS, judgement_rows(judged, COMMON))
        print_written([output / path.name for path in written])
    end_on_failure(judged)
