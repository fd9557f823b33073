"""`valvesim study`: many valves, from one file, on any number of processes."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import console, print_rows, print_table, print_written, progress_bar
from valvesim.cli.interrupts import hidden_from_children
from valvesim.cli.options import format_option, output_option, settings_option
from valvesim.cli.output_folder import check_free_file, check_place

RECORD = ("figure", "unit", "nominal", "mean", "deviation", "percentile_1", "percentile_50", "percentile_99", "least",
          "least_member", "greatest", "greatest_member")  # fmt: skip


@click.command()
@click.argument("study", type=click.Path(path_type=Path))
@output_option(None, "Folder of the store and page [results/STUDY].")
@click.option("--workers", type=click.IntRange(0), help="Processes on this machine; 0: this one [all cores].")
@click.option("--scheduler", metavar="ADDRESS", help="Run on a Dask scheduler, such as tcp://host:8786.")
@click.option("--dry-run", is_flag=True, help="Tell members, size and time; run and write nothing.")
@click.option("--member", type=click.IntRange(0), help="Print the scenario of one member by its number, to be run.")
@click.option("--yield", "wanted", help="Yield to reach by tightening tolerances, such as '99 %'.")
@click.option(
    "--no-local", is_flag=True, help="Leave out local sensitivities, which run the nominal valve's neighbours."
)
@click.option("--no-pictures", is_flag=True, help="Leave pictures and page out.")
@format_option("table", "json", "csv")
@settings_option
def study(
    study: Path, output: Path | None, workers: int | None, scheduler: str | None, dry_run: bool, member: int | None,
    wanted: str | None, no_local: bool, no_pictures: bool, form: str, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Run a STUDY file: thousands of valves within their tolerances, what becomes of their figures, and why.

    Stopped at any moment and started again it goes on where it was. The folder gets study.zarr (xarray.open_zarr) and
    study.html.
    """
    from valvesim.errors import InputError
    from valvesim.reports.study import study_report
    from valvesim.reports.title_block import valve_name
    from valvesim.studies.engine import run_study
    from valvesim.studies.findings import find
    from valvesim.studies.study_result import open_result
    from valvesim.studies.study_toml import load_study
    from valvesim.studies.summary import figure_rows
    from valvesim.studies.variables import scenario_of
    from valvesim.units import parse

    case = load_study(study, settings=settings)
    folder = output or Path("results") / study.stem
    if member is not None:
        click.echo(_member_text(case, member), nl=False)
        return
    if dry_run:
        _print_forecast(case, workers)
        return
    goal = None if wanted is None else parse(wanted, "1", "--yield")
    if goal is not None and not 0.0 < goal < 1.0:
        raise InputError(f"{wanted!r} must be between 0 and 100 %", key="--yield")
    check_place(folder)
    if not (folder / "study.zarr").exists():  # else it is this command's folder
        check_free_file(folder / "study.html")
    with hidden_from_children(), progress_bar() as bar:  # Dask's workers end with this process
        stage = bar.add_task("preparing the equations (seconds on the first run)", total=None)

        def tell(done: int, members: int) -> None:
            bar.update(stage, description=f"{done} of {members} members", total=members, completed=done)

        run_study(case, folder, workers=workers, scheduler=scheduler, progress=tell)
        result = open_result(case, folder)
        written = [folder / "study.zarr"]
        bar.update(stage, description="sensitivities", total=None)
        findings = find(
            result, wanted=goal or 0.99, local=not no_local, progress=lambda what: bar.update(stage, description=what)
        )
        if not no_pictures:
            bar.update(stage, description="drawing")
            block = valve_name(scenario_of(case.case).valve)
            written += study_report(findings, folder, valve=block, date=date.today())
    if form == "table":
        _print_result(findings)
        print_written(written)
    else:
        print_rows([dict(zip(RECORD, row, strict=True)) for row in figure_rows(result)], form)


def _member_text(case: Any, number: int) -> str:
    """A member as a scenario file; of a loop that of its valve."""
    from valvesim.errors import InputError
    from valvesim.simulation.scenario_toml import scenario_to_toml
    from valvesim.studies.variables import scenario_of

    if number >= case.members:
        raise InputError(f"{number} is no member: they are numbered 0 to {case.members - 1}", key="--member")
    return scenario_to_toml(scenario_of(case.member(case.draws()[number])))


def _print_forecast(case: Any, workers: int | None) -> None:
    from valvesim.simulation.batch import cores
    from valvesim.studies.engine import forecast

    told, processes = forecast(case), workers or cores()
    design = f"{case.design.kind}, seed {case.design.seed}, {len(case.variables)} quantities"
    rows = [
        ("members", f"{told.members}", design),
        ("blocks", f"{told.blocks}", f"of {told.block_size} members"),
        ("store", f"{told.bytes / 1e6:.3g} MB", "before compression"),
        ("a member", f"{1e3 * told.seconds_a_member:.3g} ms", "of one process, timed"),
        ("time", _duration(told.seconds(processes)), f"on {min(processes, told.blocks)} processes"),
    ]
    print_table(case.title, ("", "value", ""), rows)


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    return f"{seconds / 60.0:.3g} min" if seconds < 7200.0 else f"{seconds / 3600.0:.3g} h"


def _print_result(findings: Any) -> None:
    from valvesim.reports import study as page
    from valvesim.studies import summary

    result, screen = findings.result, console()
    print_table(result.study.title, page.FIGURE_COLUMNS, summary.figure_rows(result))
    if result.criteria:
        print_table("limits", page.LIMIT_COLUMNS, summary.limit_rows(result))
    for one in findings.indices:
        kind = "Sobol indices" if one.are_sobol else f"by regression, R² {one.explained:.3f}"
        rows = summary.index_rows(findings, one.figure, 5)
        print_table(f"{one.figure}: share of the variance, {kind}", page.INDEX_COLUMNS, rows)
    if rows := summary.halved_rows(findings, 5):
        print_table("which tolerance to tighten", page.HALVED_COLUMNS, rows)
        screen.print(summary.plan_words(findings), markup=False)
    if result.criteria:
        own = result.yield_
        screen.print(f"yield {summary.percent_text(own.share)} ({summary.yield_interval_text(own)}, 95 %)")
    for name in result.unjudged:
        screen.print(f"not judged: {name}, which no kept figure shows")
    for count, first, reason in summary.failure_rows(result, 3):
        screen.print(f"{count} members lack a figure, such as member {first}: {reason}", markup=False)
