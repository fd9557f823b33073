"""`valvesim records`: what is understood of measurement files, and the table `[columns]` to keep."""

from __future__ import annotations

from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import console, print_rows, print_table, print_written, titled_table
from valvesim.cli.options import columns_option, format_option, output_option
from valvesim.cli.output_folder import all_or_nothing

CHANNEL_HEADINGS = (
    "channel", "column", "least", "greatest", "unit", "Hz", "readings", "missing", "longest gap [s]", "noise",
    "resolution", "saturated",
)  # fmt: skip


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@columns_option
@click.option("--together", is_flag=True, help="The files were written together: they are one record.")
@click.option("--rate", help="Sampling rate, such as '2 kHz', of files without a column of times.")
@output_option("results/records")
@format_option("table", "json", "csv")
def records(
    files: tuple[Path, ...], columns: Path | None, together: bool, rate: str | None, output: Path, form: str
) -> None:  # fmt: skip
    """What is understood of measurement FILES: channels, units, rates, gaps, noise, resolution, saturation.

    Writes a picture of each record and columns.toml, the table [columns] that says the same of the next file: keep it,
    correct it, and give it to `bench --columns` or copy it into session.toml.
    """
    from valvesim.io import write_text
    from valvesim.measurement.quality import channel_qualities
    from valvesim.measurement.survey import all_channels, columns_text, survey_stated

    stated = survey_stated(columns, rate)
    names, surveys = ["columns.toml"], []
    rows: list[dict[str, Any]] = []  # for machines, SI
    with all_or_nothing(output) as folder:
        for group in [files] if together else [(file,) for file in files]:
            found = all_channels(group, stated)
            surveys.append(found)
            qualities = () if found.recording is None else channel_qualities(found.recording)
            rows += [{"file": found.paths[0].name} | asdict(one) for one in qualities]
            if form == "table":
                _print_survey(found, qualities)
            if found.recording is not None:
                names.append(_draw(found.recording, qualities, folder, names).name)
        write_text(folder / "columns.toml", columns_text(surveys))
    if form == "table":
        print_written([output / name for name in names])
    elif rows:
        print_rows(rows, form)
    for found in surveys:
        if found.problem is not None:
            raise found.problem


def _draw(recording: Any, qualities: Any, folder: Path, taken: list[str]) -> Path:
    """The picture of a recording, by the name of its first file and, where that is taken, its extension."""
    from valvesim.reports.records import picture_recording

    path = recording.paths[0]
    name = f"{path.stem}.png" if f"{path.stem}.png" not in taken else f"{path.name}.png"
    return picture_recording(recording, qualities, date.today(), folder / name)


def _print_survey(found: Any, qualities: Any) -> None:
    """Each channel of a survey with its figures, or the columns as they stand, where they make no record."""
    from rich.markup import escape

    name = found.paths[0].name if len(found.paths) == 1 else f"{found.paths[0].name} and {len(found.paths) - 1} more"
    if found.recording is None:
        print_table(f"{name}: columns as they stand in the file", ("column", "unit"), found.columns)
        return
    table = titled_table(f"{name}: {_clock_text(found.recording)}")
    for heading in CHANNEL_HEADINGS:
        table.add_column(escape(heading), justify="left" if heading in ("channel", "column", "unit") else "right")
    for one in qualities:
        table.add_row(*map(escape, _row(one)))
    console().print(table)
    for note in (*found.recording.forms, *found.recording.notes):
        console().print(note, markup=False)
    if found.recording.left_out:
        console().print(f"no channel: {', '.join(found.recording.left_out)}", markup=False)


def _clock_text(recording: Any) -> str:
    rate = (len(recording.time) - 1) / float(recording.time[-1])
    return f"{len(recording.time)} samples at {rate:.6g} Hz, {float(recording.time[-1]):.6g} s"


def _row(one: Any) -> tuple[str, ...]:
    from valvesim.units import DISPLAY, symbol

    unit, factor = DISPLAY.get(one.unit, (one.unit, 1.0))

    def text(value: float) -> str:
        return f"{value * factor:.4g}"

    return (
        one.channel.replace("_", " "), one.column, text(one.low), text(one.high), symbol(unit), f"{one.rate:.6g}",
        str(one.readings), str(one.missing or "-"), f"{one.longest_gap:.3g}" if one.longest_gap else "-",
        text(one.noise), text(one.resolution) if one.resolution else "-",
        f"{one.saturated:.1%}" if one.saturated else "-",
    )  # fmt: skip
