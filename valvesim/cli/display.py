"""What commands show: tables and rows on standard output, progress on standard error."""

from __future__ import annotations

import contextlib
import sys
import weakref
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from valvesim.errors import one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from valvesim.characterisation.judgement_table import Tests
    from valvesim.characterisation.specification import Judgement


def console() -> Console:
    """Standard output; as wide as the terminal, or wide enough for the tables where there is none.

    Control characters in what is printed are shown as escapes, and a closed pipe raises BrokenPipeError.
    """
    from rich.console import Console
    from rich.segment import Segment

    class SafeConsole(Console):
        def render(self, *arguments: Any, **options: Any) -> Iterator[Segment]:
            for segment in super().render(*arguments, **options):
                plain = segment.control or segment.text == "\n" or segment.text.isprintable()
                yield segment if plain else Segment(printable(segment.text), segment.style)

        def on_broken_pipe(self) -> None:
            raise  # it is called where the error is handled

    return SafeConsole(highlight=False, width=None if sys.stdout.isatty() else 160)


def printable(text: str) -> str:
    """A text with its control characters, all but the ends of lines, as escapes."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def progress_bar() -> Progress:
    """A bar on standard error, which goes when it is done; nothing where nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())
    _bars.add(bar)
    return bar


_bars: weakref.WeakSet[Any] = weakref.WeakSet()


@contextlib.contextmanager
def bars_hidden() -> Iterator[None]:
    """No bar is shown inside, where the user is asked something."""
    shown_now = [bar for bar in _bars if bar.live.is_started]
    for bar in shown_now:
        bar.stop()
    try:
        yield
    finally:
        for bar in shown_now:
            bar.start()


def titled_table(title: str) -> Table:
    """A table without columns yet."""
    from rich.markup import escape
    from rich.table import Table

    return Table(title=escape(title), title_justify="left", title_style="bold")


def print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table of text, figures to the right."""
    from rich.markup import escape

    table = titled_table(title)
    for heading in headings:
        table.add_column(escape(heading), justify="right" if heading.startswith(("value", "±")) else "left")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console().print(table)


def print_rows(rows: Sequence[Mapping[str, Any]], form: str) -> None:
    """Rows of the same keys as "json" or "csv"."""
    import json

    from valvesim.io import csv_text

    rows = [{key: one_line(v) if isinstance(v, str) else v for key, v in row.items()} for row in rows]
    if form == "json":
        click.echo(json.dumps(rows, indent=1))
    else:
        click.echo(csv_text(rows[0], (row.values() for row in rows)), nl=False)


def print_figures(tests: Tests, form: str, judged: Sequence[Judgement] = (), written: Sequence[Path] = ()) -> None:
    """Tests with their figures as tables, "json" or "csv", the verdicts on them, and the files that were written."""
    from valvesim.characterisation.figure_of_merit import merit_rows
    from valvesim.characterisation.judgement_table import FIGURE_HEADINGS, VERDICT_HEADINGS, judgement_rows, rows_of
    from valvesim.characterisation.specification import COMMON

    if form != "table":
        print_rows(rows_of(tests, judged), form)
        return
    for title, _, figures in tests:
        print_table(title, FIGURE_HEADINGS, merit_rows(figures))
    if judged:
        print_table("verdicts", VERDICT_HEADINGS, judgement_rows(judged, COMMON))
    print_written(written)


def print_written(paths: Sequence[Path]) -> None:
    """A line for each file that was written."""
    for path in paths:
        console().print(f"wrote {one_line(str(path))}", markup=False)
