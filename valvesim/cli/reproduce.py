"""`valvesim reproduce`: the TAD paper recomputed."""

from __future__ import annotations

from pathlib import Path

import click

from valvesim.cli.display import print_written, progress_bar
from valvesim.cli.options import output_option


@click.command()
@output_option("results/reproduce")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the starts of the identification.")
@click.option("--starts", type=click.IntRange(min=1), help="How many starts [as many as the published page has].")
def reproduce(output: Path, seed: int, starts: int | None) -> None:
    """The paper's figures and tables recomputed, published beside computed: a page with pictures (minutes)."""
    from valvesim.io import check_folder
    from valvesim.paper.reproduction import STARTS
    from valvesim.reports.paper import reproduce as write

    check_folder(output)
    with progress_bar() as bar:
        stage = bar.add_task("recomputing the paper", total=1.0)
        page = write(
            output, seed=seed, starts=STARTS if starts is None else starts,
            progress=lambda text, share: bar.update(stage, description=text, completed=share),
        )  # fmt: skip
    print_written([page])
