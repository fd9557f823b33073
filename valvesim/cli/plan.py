"""`valvesim plan`: which tests to run on a bench, and what they will show, before anything is measured."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import console, print_rows, print_table, print_written, progress_bar
from valvesim.cli.options import format_option, output_option
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@click.argument("plan", type=click.Path(path_type=Path))
@output_option("results/plan")
@format_option("table", "json", "csv")
def plan(plan: Path, output: Path, form: str) -> None:
    """Which tests of the bench in a PLAN file to run, and what they will show, before anything is measured.

    PLAN is TOML: the valve as in session.toml, [sensors] with their noise, [added_sensors] with noise and cost that
    might be bought, [bench] with rate and oil temperatures, own [[tests]], and the [aim]. Writes plan.html with its
    pictures, plan.json, the commands as CSV, and the folder session/ to be filled with records for `diagnose`.
    """
    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("reading", total=1.0)
        from valvesim.io import read_toml
        from valvesim.planning.plan import plan_tests
        from valvesim.planning.session_folder import write_session_folder
        from valvesim.reports.plan import CAUSE_HEADINGS, cause_row, plan_report
        from valvesim.reports.title_block import valve_name

        found = plan_tests(plan, progress=lambda text, share: bar.update(stage, description=text, completed=share))
        bar.update(stage, description="drawing", total=None)
        given = read_toml(plan)[1]
        written = [found.to_json(folder / "plan.json"), *write_session_folder(found, given, folder)]
        valve = valve_name(found.bench.session.valve)
        written += plan_report(found, folder, valve=valve, date=date.today())
        names = [path.relative_to(folder) for path in written]
    if form != "table":
        print_rows([dict(zip(CAUSE_HEADINGS, cause_row(one), strict=True)) for one in found.outlook.causes], form)
        return
    _print_plan(found)
    print_written([output / name for name in names])


def _print_plan(found: object) -> None:
    """The tests, what they would detect, and what is missed."""
    from valvesim.planning.plan import Plan
    from valvesim.reports.plan import CAUSE_HEADINGS, added_words, cause_row, missed_words, test_rows

    assert isinstance(found, Plan)  # noqa: S101 - the caller's own
    chosen = found.selection
    print_table(f"tests to run, {chosen.duration:g} s in all", ("test", "repeats", "s in all"), test_rows(found))
    print_table("what they would detect", CAUSE_HEADINGS, [cause_row(one) for one in found.outlook.causes])
    goals = len(chosen.reached) + len(chosen.missed)
    screen = console()
    screen.print(f"{len(chosen.reached)} of {goals} goals are reached", markup=False)
    for words in missed_words(found):
        screen.print(f"missed: {words}", markup=False)
    if added := added_words(found):
        screen.print(added, markup=False)
    for note in found.notes:
        screen.print(note, markup=False)
