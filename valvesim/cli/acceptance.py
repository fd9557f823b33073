"""`valvesim acceptance`: the acceptance tests of a measured valve, judged and reported."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import print_figures, progress_bar
from valvesim.cli.judging import end_on_failure, judged_by, read_specification
from valvesim.cli.options import format_option, output_option, specification_option
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@click.argument("records", type=click.Path(path_type=Path))
@specification_option
@click.option("--valve", metavar="FILE", help="A valve file, or a valve by name, whose model stands beside it [none].")
@output_option("results/acceptance")
@format_option("table", "json", "csv")
def acceptance(records: Path, spec: Path | None, valve: str | None, output: Path, form: str) -> None:
    """The acceptance tests of a measured valve: RECORDS is a folder with acceptance.toml and the records of its tests.

    Writes acceptance.html in the order of ISO 10770-1: identification, conditions, instruments, verdicts, results,
    pictures. Exit code 3 where a figure fails.
    """
    from valvesim.characterisation.measured_valve import load_measured_valve, measured_tests
    from valvesim.identification.from_figures.measured_figures import model_figures
    from valvesim.reports.measured_valve import measured_valve_report
    from valvesim.valve.valve_file import load_valve
    from valvesim.valve.valve_name import valve_name

    limits = read_specification(spec)
    described = None if valve is None else load_valve(valve)
    with all_or_nothing(output) as folder, progress_bar() as bar:
        bar.add_task("reducing the records", total=None)
        measured = load_measured_valve(records)
        tests = measured_tests(measured, limits)
        judged = judged_by(limits, tests)
        page = measured_valve_report(
            measured, folder, judged=judged, date=date.today(),
            model={} if described is None else model_figures(described, measured),
            model_name="" if described is None else valve_name(described.valve),
            specification="" if limits is None else limits.title or str(spec),
        )  # fmt: skip
    print_figures(tests, form, judged, [output / page.name])
    end_on_failure(judged)
