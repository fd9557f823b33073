"""`valvesim run`: a scenario simulated, with its table, netCDF or CSV, and pictures."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from valvesim.cli.display import console, print_rows, print_written, progress_bar, titled_table
from valvesim.cli.drawing_processes import Draw, drawing_processes, load_for_drawing, no_drawing
from valvesim.cli.options import format_option, output_option, settings_option, valve_option
from valvesim.cli.output_folder import all_or_nothing

if TYPE_CHECKING:
    from valvesim.characterisation.thermal_drift import Drift
    from valvesim.simulation.result import Result
    from valvesim.simulation.scenario import Scenario


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@output_option(None, "Folder of the results [results/SCENARIO].")
@valve_option
@settings_option
@click.option("--csv", "with_csv", is_flag=True, help="Write result.csv beside result.nc.")
@click.option("--parquet", is_flag=True, help="Write result.parquet beside result.nc.")
@click.option("--mat", is_flag=True, help="Write result.mat (MATLAB) beside result.nc.")
@click.option("--channels", help="Only these channels: 'current,spool_position' [all, or outputs.channels].")
@click.option("--no-pictures", is_flag=True, help="Leave the pictures out.")
@format_option("table", "json", "csv")
def run(
    scenario: Path, output: Path | None, valve: str | None, settings: tuple[str, ...], with_csv: bool, parquet: bool,
    mat: bool, channels: str | None, no_pictures: bool, form: str,
) -> None:  # fmt: skip
    """Simulate a SCENARIO: a table, result.nc, pictures and a page; scenario.toml is what ran, settings and all.

    SCENARIO is a file, or the name of one that comes along (`valvesim scenarios`).
    """
    if not no_pictures:
        load_for_drawing()
    _load_numba_alone()
    from valvesim.reports.run_table import RUN_RECORD, run_records
    from valvesim.simulation.result import check_channels
    from valvesim.simulation.scenario_toml import load_scenario

    case = load_scenario(scenario, settings=settings, valve=valve)
    if channels is not None:
        case = replace(case, channels=tuple(name.strip() for name in channels.split(",")))
    check_channels(case)
    place = output or Path("results") / scenario.stem
    forms = [name for name, wanted in (("csv", with_csv), ("parquet", parquet), ("mat", mat)) if wanted]
    drawing = no_drawing() if no_pictures else drawing_processes()
    with all_or_nothing(place) as folder, drawing as draw, progress_bar() as bar:
        stage = bar.add_task("preparing the equations (seconds on the first run)", total=None)
        told = functools.partial(bar.update, stage)
        result, drift, drawn = _simulate_and_draw(case, folder, draw, forms, told)
        written = [_write_scenario(case, scenario, settings, folder / "scenario.toml"), *drawn]
    if form == "table":
        _print_run(result, drift, [place / path.name for path in written])
    else:
        print_rows([dict(zip(RUN_RECORD, row, strict=True)) for row in run_records(result)], form)


def _simulate_and_draw(
    case: Scenario, folder: Path, draw: Draw, forms: Sequence[str], told: Callable[..., None]
) -> tuple[Result, Drift | None, list[Path]]:
    """(result, drift where temperatures vary, files written) of a run; what can be drawn is drawn meanwhile."""
    from valvesim.simulation.run import simulate

    result = simulate(case, progress=lambda share: told(description="integrating", total=1.0, completed=share))
    pictures = [draw("picture_run", result, date.today(), folder / "run.png")]
    from valvesim.characterisation.rest_characteristic import rest_characteristic  # needed from here on alone
    from valvesim.characterisation.spectral_response import own_response
    from valvesim.characterisation.thermal_drift import (
        frequency_goes,
        nominal,
        observed_drift,
        static_drift,
        temperature_varies,
    )

    varies, sweeps = temperature_varies(case), frequency_goes(case)
    response = own_response(result) if sweeps else None
    if response is not None:
        pictures.append(draw("picture_sweep", result, response, date.today(), folder / "sweep.png"))
    elif not varies:
        rest = rest_characteristic(case)
        pictures.append(draw("picture_characteristic", result, rest, date.today(), folder / "characteristic.png"))
    drift = None
    if varies:
        told(description="drift against 20 °C", total=None)
        drift = static_drift(result)
    if drift is not None and not sweeps:
        observed = observed_drift(result, simulate(nominal(case), signals=False))
        pictures.append(draw("picture_drift", drift, observed, case, date.today(), folder / "drift.png"))
    written = _write_result(result.select(case.channels), folder, forms, told)
    told(description="drawing", total=None)
    drawn = [path for picture in pictures if (path := picture()) is not None]
    page = draw("page_run", result, drawn, date.today(), folder / "run.html", drift, response)()
    return result, drift, [*written, *drawn, *([] if page is None else [page])]


def _write_result(result: Result, folder: Path, forms: Sequence[str], told: Callable[..., None]) -> list[Path]:
    """The files of a result: netCDF, and what else is asked for of csv, parquet and mat."""
    writers = {"nc": result.to_netcdf, "csv": result.to_csv, "parquet": result.to_parquet, "mat": result.to_mat}
    written = []
    for form in ("nc", *forms):
        told(description=f"writing result.{form}", total=None)
        written.append(writers[form](folder / f"result.{form}"))
    return written


def _load_numba_alone() -> None:
    """Load numba without coverage, which it loads where it finds it and nobody measures: 0.05 s."""
    if "numba" not in sys.modules and "coverage" not in sys.modules:
        modules: dict[str, Any] = sys.modules
        modules["coverage"] = None  # as if it were not installed
        try:
            import_module("numba")
        finally:
            del modules["coverage"]


def _write_scenario(case: Any, given: Path, settings: tuple[str, ...], path: Path) -> Path:
    """What ran, as a scenario file that runs again, settings and all; its comment says who ran it from what."""
    from valvesim.errors import InputError
    from valvesim.io import write_atomically, write_text
    from valvesim.simulation.scenario_files import scenario_file
    from valvesim.version import package_version

    told = [f"Run by valvesim {package_version()} on {date.today().isoformat()}, from {given}"]
    told += [f"with --set {setting}" for setting in settings]
    try:
        text = case.to_toml()
    except InputError as error:  # effects of one's own: the file as it was given, beside which their files stand
        text = scenario_file(given).read_text(encoding="utf-8")
        told.append(f"as it was given, without the settings: {error}")
    return write_atomically(path, lambda own: write_text(own, "".join(f"# {line}\n" for line in told) + text))


def _print_run(result: Any, drift: Any, written: list[Path]) -> None:
    from valvesim.reports.run_table import RUN_HEADINGS, run_rows

    table = titled_table(result.scenario.title)
    for heading in RUN_HEADINGS:
        table.add_column(heading, justify="left" if heading in ("channel", "unit") else "right")
    for row in run_rows(result):
        table.add_row(*row)
    screen = console()
    screen.print(table)
    if drift is not None:
        for against, shares in (("20 °C", drift.total), ("the start", drift.since_start())):
            total = ", ".join(f"{n.replace('_', ' ')} {100 * v[-1]:+.2f} %" for n, v in shares.items())
            screen.print(f"static drift at the end, against {against}, at {drift.current * 1e3:.3g} mA: {total}")
        low, high = (100.0 * float(v) for v in (drift.null_shift.min(), drift.null_shift.max()))
        screen.print(f"null, from where it is at 20 °C: {low:+.3g} to {high:+.3g} % of rated current")
    s = result.statistics
    screen.print(
        f"{s['accepted_steps']:.0f} steps ({s['rejected_steps']:.0f} rejected) in {s['solver_seconds']:.3f} s of solver"
    )
    print_written(written)
