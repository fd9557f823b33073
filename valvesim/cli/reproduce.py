"""`valvesim reproduce`: the TAD paper recomputed."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import print_rows, print_written, progress_bar
from valvesim.cli.options import format_option, output_option
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@output_option("results/reproduce")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the starts of the identification.")
@click.option("--starts", type=click.IntRange(min=1), help="How many starts [as many as the published page has].")
@format_option("table", "json", "csv")
def reproduce(output: Path, seed: int, starts: int | None, form: str) -> None:
    """The paper's figures and tables recomputed, published beside computed: a page with pictures (minutes)."""
    from valvesim.paper.identification import STARTS
    from valvesim.paper.reproduction import compute
    from valvesim.reports.paper.page import write_page

    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("recomputing the paper", total=1.0)
        result = compute(
            seed=seed, starts=STARTS if starts is None else starts,
            progress=lambda text, share: bar.update(stage, description=text, completed=share),
        )  # fmt: skip
        page = write_page(result, folder, date=date.today())
    if form == "table":
        print_written([output / page.name])
    else:
        print_rows([{"file": str(output / page.name)}], form)
