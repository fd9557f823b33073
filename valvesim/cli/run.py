"""`valvesim run`: a scenario simulated, with its table, netCDF or CSV, and pictures."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import date
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import console, print_rows, print_written, progress_bar, titled_table
from valvesim.cli.interrupts import end_with_parent, hidden_from_children
from valvesim.cli.options import format_option, output_option, settings_option, valve_option
from valvesim.cli.output_folder import all_or_nothing


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
    _load_pint_alone()
    from valvesim.characterisation.rest_characteristic import rest_characteristic
    from valvesim.characterisation.spectral_response import own_response
    from valvesim.characterisation.thermal_drift import (
        frequency_goes,
        nominal,
        observed_drift,
        static_drift,
        temperature_varies,
    )
    from valvesim.reports.run_table import RUN_RECORD, run_records
    from valvesim.simulation.result import check_channels
    from valvesim.simulation.run import simulate
    from valvesim.simulation.scenario_toml import load_scenario

    case = load_scenario(scenario, settings=settings, valve=valve)
    if channels is not None:
        case = replace(case, channels=tuple(name.strip() for name in channels.split(",")))
    check_channels(case)
    place = output or Path("results") / scenario.stem
    with all_or_nothing(place) as folder, _artist(wanted=not no_pictures) as draw, progress_bar() as bar:
        stage = bar.add_task("preparing the equations (seconds on the first run)", total=None)

        def integrated(share: float) -> None:
            bar.update(stage, description="integrating", total=1.0, completed=share)

        result = simulate(case, progress=integrated)
        bar.update(stage, description="writing result.nc", total=None)
        written = [_write_scenario(case, scenario, settings, folder / "scenario.toml")]
        written.append(result.select(case.channels).to_netcdf(folder / "result.nc"))
        varies, sweeps = temperature_varies(case), frequency_goes(case)
        pictures = [draw("picture_run", result, date.today(), folder / "run.png")]
        response = own_response(result) if sweeps else None
        if response is not None:
            pictures.append(draw("picture_sweep", result, response, date.today(), folder / "sweep.png"))
        elif not varies:
            rest = rest_characteristic(case)
            pictures.append(draw("picture_characteristic", result, rest, date.today(), folder / "characteristic.png"))
        chosen = result.select(case.channels)
        writers = {"csv": chosen.to_csv, "parquet": chosen.to_parquet, "mat": chosen.to_mat}
        for form in [form for form, wanted in zip(writers, (with_csv, parquet, mat), strict=True) if wanted]:
            bar.update(stage, description=f"writing result.{form}")
            written.append(writers[form](folder / f"result.{form}"))
        drift = None
        if varies:
            bar.update(stage, description="drift against 20 °C")
            drift = static_drift(result)
        if varies and not sweeps:
            observed = observed_drift(result, simulate(nominal(case), signals=False))
            pictures.append(draw("picture_drift", drift, observed, case, date.today(), folder / "drift.png"))
        bar.update(stage, description="drawing")
        drawn = [path for picture in pictures if (path := picture()) is not None]
        page = draw("page_run", result, drawn, date.today(), folder / "run.html", drift, response)()
        written += [*drawn, *([] if page is None else [page])]
    if form == "table":
        _print_run(result, drift, [place / path.name for path in written])
    else:
        print_rows([dict(zip(RUN_RECORD, row, strict=True)) for row in run_records(result)], form)


def _load_pint_alone() -> None:
    """Load pint without dask, which it loads where it finds it: a fifth of a start, and no unit needs it."""
    if "pint" not in sys.modules and "dask" not in sys.modules:
        modules: dict[str, Any] = sys.modules
        modules["dask"] = None  # as if it were not installed
        try:
            import_module("pint")
        finally:
            del modules["dask"]


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


@contextlib.contextmanager
def _artist(*, wanted: bool) -> Iterator[Callable[..., Callable[[], Path | None]]]:
    """Draws in a process of its own, which loads matplotlib (half a second) while this one integrates.

    `draw(name, *arguments)` begins a picture of `report` and returns what waits for its path. Where the arguments
    cannot travel (an effect made of lambdas), the picture is drawn here when it is waited for. That process ends with
    the pipe between them: however this one ends, none is left.
    """
    if not wanted:
        yield lambda name, *arguments: lambda: None
        return
    spawning = multiprocessing.get_context("spawn")
    here, there = spawning.Pipe()
    process = spawning.Process(target=_draw_for, args=(there,), daemon=True)
    with hidden_from_children():
        process.start()
    there.close()

    def ask(*job: Any) -> Path | None:
        here.send(job)
        path, error = here.recv()
        if error is not None:
            raise error
        return path

    with ThreadPoolExecutor(1) as queue:

        def draw(name: str, *arguments: Any) -> Callable[[], Path | None]:
            begun = queue.submit(ask, name, *arguments)

            def wait() -> Path | None:
                try:
                    return begun.result()
                except (pickle.PicklingError, AttributeError, TypeError, EOFError, ConnectionError):
                    return _draw(name, *arguments)

            return wait

        try:
            yield draw
        finally:
            process.kill()
            process.join()
    here.close()


def _draw_for(pipe: Connection) -> None:
    """Draw what comes through a pipe until it is closed."""
    end_with_parent()
    from valvesim.reports import run as report  # noqa: F401 - loaded while the other side integrates

    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            job, path, failed = pipe.recv(), None, None
            try:
                path = _draw(*job)
            except Exception as error:
                failed = error
            pipe.send((path, failed))


def _draw(name: str, *arguments: Any) -> Path | None:
    """One picture of `report`."""
    from valvesim.reports import run as report

    return getattr(report, name)(*arguments)


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
