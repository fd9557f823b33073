"""`valvesim open`: results and measured files as a page in the browser."""

from __future__ import annotations

import os
from datetime import date
from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import print_written
from valvesim.cli.options import columns_option, output_file_option
from valvesim.cli.output_folder import check_free_file

PAGES = (
    "run.html", "report.html", "datasheet.html", "response.html", "study.html", "acceptance.html", "plan.html",
)  # of a folder, the first of these; else the first page by name


@click.command()
@click.argument("places", nargs=-1, required=True, metavar="DIR|FILE...", type=click.Path(path_type=Path))
@output_file_option(None, "Write the page of measured files here [aside].")
@columns_option
@click.option("--browser/--no-browser", default=True, help="Show the page in the browser, or name it only.")
def open(places: tuple[Path, ...], output: Path | None, columns: Path | None, browser: bool) -> None:
    """Show the page of a results folder, or result.nc and measured files (CSV, MAT, TDMS and others) as one.

    Pages need no network and no server: any browser shows them, also from a mail.
    """
    import webbrowser

    from valvesim.errors import InputError, one_line

    pages = [page for place in places if (page := _page_of(place)) is not None]
    if pages and len(pages) < len(places):
        raise InputError("give folders and pages, or measured files, not both")
    if not pages:
        if output is not None:
            check_free_file(output)
        pages = [_page_of_files(places, output, columns)]
        print_written(pages)
    elif output is not None:
        raise InputError("-o is for the page of measured files; a page of results stands where it is")
    for page in pages:
        if not browser or not webbrowser.open(page.absolute().as_uri()):
            click.echo(one_line(str(page)))


def _page_of(place: Path) -> Path | None:
    """The page of a folder, or a page itself; None for another file. InputError where there is neither."""
    from valvesim.errors import InputError

    if os.path.isdir(place):
        named = [place / name for name in PAGES if (place / name).is_file()]
        found = [*named, *sorted(place.glob("*.html")), *sorted(place.glob("*.nc"))]
        if not found:
            raise InputError("holds no page and no result.nc", file=place)
        return found[0] if found[0].suffix == ".html" else None
    if not os.path.isfile(place):
        raise InputError("no such file or folder", file=place)
    return place if place.suffix.lower() in (".html", ".htm", ".pdf", ".png") else None


def _page_of_files(places: tuple[Path, ...], output: Path | None, columns: Path | None) -> Path:
    """Write the page of measured files: to `output`, else to the user's cache."""
    from platformdirs import user_cache_path

    from valvesim.measurement.survey import all_channels, survey_stated
    from valvesim.reports.records import page_recordings

    files = [sorted(place.glob("*.nc"))[0] if place.is_dir() else place for place in places]
    stated = survey_stated(columns, None)
    recordings: list[Any] = []
    for file in files:
        found = all_channels([file], stated)
        if found.recording is None:
            raise found.problem  # type: ignore[misc]  # one of the two is there
        recordings.append(found.recording)
    aside = user_cache_path("valvesim") / "pages" / f"{'_'.join(file.stem for file in files)[:80]}.html"
    return page_recordings(recordings, date.today(), output or aside)
