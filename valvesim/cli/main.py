"""The command line: `valvesim run | static | response | bench | datasheet | diagnose | ...`.

Exit codes: 0 done, 1 a solve failed, 2 the input is wrong. Tables go to standard output, all else to standard error.
"""

from __future__ import annotations

import contextlib
import csv
import gc
import io
import json
import multiprocessing
import os
import pickle
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.units import DISPLAY, parse_list, quantities, range_text, symbol, tolerance_text

_settings_option = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Override a figure: valve.null_gap='0.03 mm'."
)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="valvesim")
def cli() -> None:
    """A two-stage electro-hydraulic servo valve over temperature and time."""


@cli.command()
@click.argument("scenario", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder of the results [results/SCENARIO].")
@_settings_option
@click.option("--csv", "with_csv", is_flag=True, help="Write result.csv beside result.nc.")
@click.option("--no-pictures", is_flag=True, help="Leave the pictures out.")
def run(scenario: Path, output: Path | None, settings: tuple[str, ...], with_csv: bool, no_pictures: bool) -> None:
    """Simulate a SCENARIO file: a table, result.nc and pictures."""
    from valvesim.characterisation.thermal_drift import nominal, observed_drift, static_drift, temperature_varies
    from valvesim.io import check_folder
    from valvesim.simulation.result import check_channels
    from valvesim.simulation.run import simulate
    from valvesim.simulation.scenario_toml import load_scenario
    from valvesim.solver.codegen import compile_model

    case = load_scenario(scenario, settings=settings)
    check_channels(case)
    folder = output or Path("results") / scenario.stem
    check_folder(folder)
    with _artist(wanted=not no_pictures) as draw, _progress() as bar:
        stage = bar.add_task("preparing the equations (seconds on the first run)", total=None)
        compile_model(case.model)
        bar.update(stage, description="integrating", total=1.0)
        result = simulate(case, progress=lambda share: bar.update(stage, completed=share))
        bar.update(stage, description="writing result.nc", total=None)
        written = [result.select(case.channels).to_netcdf(folder / "result.nc")]
        varies = temperature_varies(case)
        pictures = [draw("picture_run", result, folder / "run.png")]
        if not varies:
            pictures.append(draw("picture_characteristic", result, folder / "characteristic.png"))
        if with_csv:
            bar.update(stage, description="writing result.csv")
            written.append(result.select(case.channels).to_csv(folder / "result.csv"))
        drift = None
        if varies:
            bar.update(stage, description="drift against 20 °C")
            drift = static_drift(result)
            observed = observed_drift(result, simulate(nominal(case), signals=False))
            pictures.append(draw("picture_drift", drift, observed, case.title, folder / "drift.png"))
        bar.update(stage, description="drawing")
        written += [path for picture in pictures if (path := picture()) is not None]
    _print_run(result, drift, written)


_TABLE = (
    "current", "oil_temperature", "body_temperature", "torque_motor_temperature", "armature_angle", "nozzle_pressure_1",
    "nozzle_pressure_2", "spool_position", "load_flow", "internal_leakage",
)  # fmt: skip


@contextlib.contextmanager
def _artist(*, wanted: bool) -> Iterator[Callable[..., Callable[[], Path | None]]]:
    """Draws in a process of its own, which loads matplotlib (half a second) while this one integrates.

    `draw(name, *arguments)` begins a picture of `report` and returns what waits for its path. Where the arguments
    cannot travel (an effect made of lambdas), the picture is drawn here when it is waited for.
    """
    if not wanted:
        yield lambda name, *arguments: lambda: None
        return
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        pool.submit(_draw)

        def draw(name: str, *arguments: Any) -> Callable[[], Path | None]:
            begun = pool.submit(_draw, name, *arguments)

            def wait() -> Path | None:
                try:
                    return begun.result()
                except (pickle.PicklingError, AttributeError, TypeError):
                    return _draw(name, *arguments)

            return wait

        yield draw


def _draw(name: str | None = None, *arguments: Any) -> Path | None:
    """One picture of `report`, or none: then the module is only loaded."""
    from valvesim.reports import run as report

    return None if name is None else getattr(report, name)(*arguments)


def _print_run(result: Any, drift: Any, written: list[Path]) -> None:
    table = Table(title=escape(result.scenario.title), title_justify="left", title_style="bold")
    for heading in ("channel", "unit", "least", "greatest", "at the end"):
        table.add_column(heading, justify="left" if heading in ("channel", "unit") else "right")
    for name in _TABLE:
        values, unit = result.display(name)
        figures = (f"{v:.5g}" for v in (values.min(), values.max(), values[-1]))
        table.add_row(name.replace("_", " "), symbol(unit), *figures)
    console = _console()
    console.print(table)
    if drift is not None:
        total = ", ".join(f"{n.replace('_', ' ')} {100 * v[-1]:+.2f} %" for n, v in drift.total.items())
        console.print(f"static drift at the end, against 20 °C, at {drift.current * 1e3:.3g} mA: {total}")
    s = result.statistics
    console.print(
        f"{s['accepted_steps']:.0f} steps ({s['rejected_steps']:.0f} rejected) in {s['solver_seconds']:.3f} s of solver"
    )
    _print_written(written)


@cli.command()
@click.option("--current", required=True, help="One or more: '1 mA' or '-1, 0, 1 mA'.")
@click.option("--oil-temperature", required=True, help="One or more: '20,100,270 degC'.")
@click.option("--routes", help="Only these temperature routes vary: 'flow,mmf'; '' for none [all].")
@click.option("--format", "form", type=click.Choice(["table", "json", "csv"]), default="table", show_default=True)
@_settings_option
def static(current: str, oil_temperature: str, routes: str | None, form: str, settings: tuple[str, ...]) -> None:
    """Where the reference valve rests, at every current and temperature (isothermal, the paper's TAD solution)."""
    from valvesim.simulation.scenario_toml import read_tables
    from valvesim.valve.coefficients import ROUTES
    from valvesim.valve.equilibrium import static_solution

    currents = parse_list(current, "A", "--current")
    temperatures = parse_list(oil_temperature, "degC", "--oil-temperature")
    chosen = ROUTES if routes is None else tuple(name.strip() for name in routes.split(",") if name.strip())
    valve, oil = read_tables(settings)
    rest = static_solution(valve, current=currents[:, None], temperature=temperatures, routes=chosen, oil=oil)
    fields = {
        "current_A": rest.current, "oil_temperature_degC": rest.temperature, "armature_angle_rad": rest.armature_angle,
        "spool_position_m": rest.spool_position, "load_differential_pressure_Pa": rest.load_differential_pressure,
    }  # fmt: skip
    columns = (values.flat for values in fields.values())
    rows = [dict(zip(fields, map(float, row), strict=True)) for row in zip(*columns, strict=True)]
    if form == "json":
        click.echo(json.dumps(rows, indent=1))
    elif form == "csv":
        text = io.StringIO()
        writer = csv.DictWriter(text, list(fields), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        click.echo(text.getvalue(), nl=False)
    else:
        table = Table(title="valve at rest", title_justify="left", title_style="bold")
        for heading in ("current [mA]", "oil [°C]", "angle [mrad]", "spool [mm]", "p1 - p2 [bar]"):
            table.add_column(escape(heading), justify="right")
        for row in rows:
            scaled = zip(row.values(), (1e3, 1.0, 1e3, 1e3, 1e-5), strict=True)
            table.add_row(*(f"{value * factor:.7g}" for value, factor in scaled))
        _console().print(table)


_temperatures_option = click.option(
    "--oil-temperature", default="20 degC", show_default=True, help="One or more: '20,100,200 degC'."
)


@cli.command()
@click.argument("scenario", type=click.Path(path_type=Path), required=False)
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("results/response"), show_default=True)
@click.option("--oil-temperature", help="One or more: '20,100,200 degC' [the scenario's own at its start, or 20 degC].")
@_settings_option
def response(scenario: Path | None, output: Path, oil_temperature: str | None, settings: tuple[str, ...]) -> None:
    """Step and frequency response at 25, 40 and 100 % of rated current: figures and pictures.

    Of the reference valve, or of the valve, oil, drive and effects of a SCENARIO.
    """
    from valvesim.characterisation.figure_of_merit import table
    from valvesim.reports.response import response_report
    from valvesim.simulation.scenario import Scenario, Thermal
    from valvesim.simulation.scenario_toml import load_scenario, read_tables

    if scenario is None:
        valve, oil = read_tables(settings)
        source = Scenario(valve=valve, oil=oil, thermal=Thermal(network=None))
    else:
        source = load_scenario(scenario, settings=settings)
    given = oil_temperature
    temperatures = None if given is None else parse_list(given, "degC", "--oil-temperature").tolist()
    with _progress() as bar:
        stage = bar.add_task("stepping and sweeping", total=1.0)
        sets, paths = response_report(
            source, output, oil_temperatures=temperatures, progress=lambda share: bar.update(stage, completed=share)
        )
    for one in sets:
        tests: tuple[Any, ...] = (*one.steps, *one.sweeps)
        for test in tests:
            what = "step" if test in one.steps else "sines"
            title = f"{what} of {100 * test.share:.0f} % of rated, oil at {one.oil_temperature:g} °C"
            _print_table(title, ("figure", "value", "± (1 sigma)", "unit", "meaning"), table(test.figures))
    _print_written(paths)


@cli.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("results/bench"), show_default=True)
@click.option("--measured", multiple=True, type=click.Path(path_type=Path), help="A CSV record, or several.")
@click.option("--test", "kind", help="What was measured: flow, pressure-gain, leakage or flow-load.")
@click.option("--lag", help="Lag of the meter, such as '1 s' [estimated where the record allows it].")
@click.option("--dead-zone", help="Dead zone of the meter, such as '0.2 L/min' [estimated].")
@click.option("--rated-current", help="Rated current of the measured valve [the largest in the record].")
@_temperatures_option
@_settings_option
def bench(
    output: Path, measured: tuple[Path, ...], kind: str | None, lag: str | None, dead_zone: str | None,
    rated_current: str | None, oil_temperature: str, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Static figures of merit (SAE ARP490, ISO 10770-1) of the model, or of measured records.

    Several leakage records of different periods also give the hysteresis that they have in common, and the meter's lag.
    """
    from valvesim.characterisation.acceptance.leakage import common_hysteresis
    from valvesim.characterisation.acceptance.record import read_record
    from valvesim.characterisation.figure_of_merit import table
    from valvesim.io import check_folder
    from valvesim.reports.acceptance import bench_measured, bench_simulated
    from valvesim.simulation.scenario_toml import read_tables
    from valvesim.units import parse

    headings = ("figure", "value", "± (1 sigma)", "unit", "meaning")
    check_folder(output)
    if measured:
        if kind is None:
            raise InputError("--measured needs --test: flow, pressure-gain, leakage or flow-load")
        for file in measured:
            figures, path = bench_measured(
                file, kind, output / f"{file.stem}.png",
                lag=None if lag is None else parse(lag, "s", "--lag"),
                dead_zone=None if dead_zone is None else parse(dead_zone, "m^3/s", "--dead-zone"),
                rated_current=None if rated_current is None else parse(rated_current, "A", "--rated-current"),
            )  # fmt: skip
            _print_table(f"{kind} of {file}", headings, table(figures))
            _print_written([path])
        if kind == "leakage" and len(measured) > 1:
            common = common_hysteresis([read_record(file) for file in measured])
            _print_table("what the records have in common", headings, table(common))
        return
    if given := [n for n, v in (("--test", kind), ("--lag", lag), ("--dead-zone", dead_zone)) if v is not None]:
        raise InputError(f"{given[0]} speaks of a measured record: give --measured FILE too")
    valve, oil = read_tables(settings)
    paths = []
    for temperature in parse_list(oil_temperature, "degC", "--oil-temperature"):
        with _progress() as bar:
            stage = bar.add_task(f"bench at {temperature:g} °C", total=1.0)
            figures, path = bench_simulated(
                valve, output / f"bench_{temperature:g}_degC.png", oil_temperature=float(temperature), oil=oil,
                progress=lambda share: bar.update(stage, completed=share),  # noqa: B023 - called within this turn
            )  # fmt: skip
        _print_table(f"bench, oil at {temperature:g} °C", headings, table(figures))
        paths.append(path)
    _print_written(paths)


@cli.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("results/datasheet"), show_default=True)
@_temperatures_option
@_settings_option
def datasheet(output: Path, oil_temperature: str, settings: tuple[str, ...]) -> None:
    """The datasheet of a valve at any oil temperatures: datasheet.html and datasheet.pdf, pictures inside."""
    from valvesim.reports.datasheet import datasheet_report
    from valvesim.simulation.scenario_toml import read_tables

    valve, oil = read_tables(settings)
    temperatures = parse_list(oil_temperature, "degC", "--oil-temperature").tolist()
    with _progress() as bar:
        stage = bar.add_task("testing the valve", total=1.0)
        written = datasheet_report(
            valve, oil, output, oil_temperatures=temperatures,
            progress=lambda share: bar.update(stage, completed=share),
        )  # fmt: skip
    _print_written(written)


@cli.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("results/reproduce"), show_default=True)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the starts of the identification.")
@click.option("--starts", type=click.IntRange(min=1), help="How many starts [as many as the published page has].")
def reproduce(output: Path, seed: int, starts: int | None) -> None:
    """The paper's figures and tables recomputed, published beside computed: a page with pictures (minutes)."""
    from valvesim.io import check_folder
    from valvesim.paper.reproduction import STARTS
    from valvesim.reports.paper import reproduce as write

    check_folder(output)
    with _progress() as bar:
        stage = bar.add_task("recomputing the paper", total=1.0)
        page = write(
            output, seed=seed, starts=STARTS if starts is None else starts,
            progress=lambda text, share: bar.update(stage, description=text, completed=share),
        )  # fmt: skip
    _print_written([page])


@cli.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("results/diagnosis"), show_default=True)
@click.option("--seed", type=click.IntRange(min=0), help="Of all draws, in place of the session's own [0].")
@click.option(
    "--effects", "own", multiple=True, type=click.Path(path_type=Path), help="A Python file of your own effects."
)
def diagnose(session: Path, output: Path, seed: int | None, own: tuple[Path, ...]) -> None:
    """What the simulation gets wrong in a measured SESSION: cause, extended model, gain on locked records.

    Writes diagnosis.json, report.html with its pictures, extended.toml (a scenario for `valvesim run`) and, where one
    helps, the next test as next_test.csv: all of them, or nothing.
    """
    with _all_or_nothing(output, _ANSWER) as folder, _progress() as bar:
        stage = bar.add_task("reading", total=1.0)
        from valvesim.diagnosis.diagnose import diagnose as find
        from valvesim.identification.session_toml import load_session

        found = find(
            load_session(session, seed=seed, effects=own),
            progress=lambda text, share: bar.update(stage, description=text, completed=share),
        )
        bar.update(stage, description="drawing", total=None)
        names = [path.name for path in _write_diagnosis(found, folder)]
    _print_diagnosis(found)
    _print_written([output / name for name in names])


_ANSWER = (
    "diagnosis.json", "report.html", "extended.toml", "recovered_term.py", "next_test.csv", "errors.png", "traces.png",
    "scores.png", "gain.png", "term.png",
)  # fmt: skip
"""All that a diagnosis may write; what an earlier one left in the folder goes with the answer that it belonged to."""


def _write_diagnosis(found: Any, folder: Path) -> list[Path]:
    from valvesim.reports.diagnosis import write_report

    texts = {"extended.toml": found.extended_scenario, **found.extended_effects}
    if found.next_test is not None and found.next_test.inputs:
        texts["next_test.csv"] = _columns_text(found.next_test.inputs)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    written = [found.to_json(folder / "diagnosis.json"), *(folder / name for name in texts)]
    return [*written, *write_report(found, folder)]


def _columns_text(columns: dict[str, Any]) -> str:
    """A CSV of inputs over time, as a session reads it: `name [unit]` over figures as people read them."""
    from valvesim.identification.session import UNITS

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    shown = {name: DISPLAY.get(UNITS[name], (UNITS[name], 1.0)) for name in columns}
    writer.writerow(f"{name} [{unit}]" for name, (unit, _) in shown.items())
    scaled = [[f"{value * shown[name][1]:.9g}" for value in values] for name, values in columns.items()]
    writer.writerows(zip(*scaled, strict=True))
    return text.getvalue()


def _print_diagnosis(found: Any) -> None:
    """Verdict, causes with their figures, next test and gain, a line each."""
    console = _console()
    console.print(f"[bold]{found.verdict.replace('_', ' ')}[/bold]: {escape(found.summary)}")
    if found.location:
        console.print(escape(f"where: {found.location}"))
    for e in found.parameters:
        unit, factor = DISPLAY.get(e.unit, (e.unit, 1.0))
        value, low, high = (f"{figure * factor:.4g}" for figure in (e.value, e.low, e.high))
        console.print(escape(f"  {e.cause}: {e.name} = {value} {symbol(unit)} (95 %: {low} to {high})"))
    if found.term is not None:
        term = f"{found.term.port} as a function of {found.term.variable}".replace("_", " ")
        formula = f": {found.term.formula}" if found.term.formula else ""
        console.print(escape(f"missing term: {term}{formula}"))
    if len(found.candidates) > 1 and found.verdict in ("ambiguous", "unknown"):
        ranked = ", ".join(f"{c.label} {c.probability:.0%}" for c in found.candidates[:4])
        console.print(escape(f"candidates: {ranked}"))
    if (test := found.next_test) is not None:
        power = f"tells {' from '.join(test.separates)} apart with {test.power:.0%}"
        console.print(escape(f"next test, {test.duration:g} s: {test.description}; {power}"))
    elif found.no_test:
        console.print(found.no_test)
    for g in found.gain:
        told = "" if g.claimed else ", not claimed"
        console.print(escape(f"gain on {g.record}: error {g.before:.3g} -> {g.after:.3g} (noise {g.floor:.3g}){told}"))


@contextlib.contextmanager
def _all_or_nothing(folder: Path, names: Sequence[str]) -> Iterator[Path]:
    """A folder beside `folder` to write in; at the end its files move there, and no others of `names` stay there.

    Whatever happens before, `folder` is as it was, and no folder is left that was made for it. Raises InputError where
    that cannot be.
    """
    folder = folder.absolute()
    missing = [parent for parent in folder.parents if not parent.exists()]
    try:
        if folder.exists() and not folder.is_dir():
            raise FileExistsError("it is a file")
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be written ({error})") from None
    try:
        yield temporary
        try:
            folder.mkdir(exist_ok=True)
            written = {path.name for path in temporary.iterdir()}
            for name in sorted(written):
                os.replace(temporary / name, folder / name)
            for name in set(names) - written:
                (folder / name).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error})") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for parent in missing:  # innermost first; only empty ones go
            with contextlib.suppress(OSError):
                parent.rmdir()


def _print_table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    table = Table(title=escape(title), title_justify="left", title_style="bold")
    for heading in headings:
        table.add_column(escape(heading), justify="right" if heading.startswith(("value", "±")) else "left")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    _console().print(table)


def _print_written(paths: Sequence[Path]) -> None:
    for path in paths:
        _console().print(f"wrote {path}", markup=False)


@cli.command()
@click.argument("name", required=False)
def effects(name: str | None) -> None:
    """The catalogue of effects, or one of them in full."""
    from valvesim.valve.catalogue import CATALOGUE, effect

    console = _console()
    for entry in [effect(name)] if name else CATALOGUE.values():
        console.print(f"[bold]{entry.name}[/bold]  {escape(entry.doc)}")
        console.print(escape(f"  acts in: {entry.location}\n  shows as: {entry.signature}"))
        for p in entry.parameters:
            unit, factor = DISPLAY.get(p.unit, (p.unit, 1.0))
            low, high = (f"{bound * factor:g}" for bound in p.bounds)
            value = "neutral at" if p.neutral is not None else "default"
            seen = "" if p.typical is None else f", in service {p.typical * factor:g}"
            line = f"  {p.name} [{symbol(unit)}], {low} to {high}, {value} {p.default * factor:g}{seen}: {p.doc}"
            console.print(escape(line))
        console.print()


@cli.command()
@click.option("--format", "form", type=click.Choice(["table", "csv"]), default="table", show_default=True)
def parameters(form: str) -> None:
    """Every parameter: name, value, unit, range, tolerance and source."""
    from valvesim.valve.flow_coefficients import FLOW_LAWS
    from valvesim.valve.fluid import MIL_PRF_5606
    from valvesim.valve.parameters import Valve
    from valvesim.valve.thermal_network import ThermalNetwork

    headings = ("name", "value", "unit", "range", "tolerance", "meaning", "source")
    law = next(name for name, law in FLOW_LAWS.items() if law is Valve().flow_coefficients)
    known = ", ".join(FLOW_LAWS)
    rows = [("valve.flow_law", law, "-", known, "", "flow coefficients of the pilot stage", "docs/oils.md")]
    for where, instance in (("valve", Valve()), ("oil", MIL_PRF_5606), ("thermal", ThermalNetwork())):
        for name, field in quantities(instance).items():
            data = field.metadata
            rows.append(
                (f"{where}.{name}", f"{getattr(instance, name):.6g}", symbol(data["unit"]), range_text(field),
                 tolerance_text(field), data["doc"], data["source"])
            )  # fmt: skip
    if form == "csv":
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([headings, *rows])
        click.echo(text.getvalue(), nl=False)
        return
    table = Table(title="parameters (SI)", title_justify="left", title_style="bold")
    for heading in headings:
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=heading == "name")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    _console().print(table)


@cli.command()
@click.argument("name", required=False)
@click.option("--file", type=click.Path(path_type=Path), help="An oil of one's own, in place of a NAME.")
@click.option("--format", "form", type=click.Choice(["table", "json", "csv"]), default="table", show_default=True)
def oils(name: str | None, file: Path | None, form: str) -> None:
    """The oils by name; with a NAME its figures and sources, and its properties over temperature."""
    from valvesim.simulation.scenario_toml import Reader
    from valvesim.valve.oils import OILS, property_table, read_oil

    if name is not None and file is not None:
        raise InputError("oils: give a NAME or --file, not both")
    if name is None and file is None:
        chosen = [(each, property_table(each, (-40.0, 40.0, 100.0))) for each in OILS.values()]
    else:
        own = read_oil({"name": name}, "oils") if file is None else Reader(file.parent).oil({"file": file.name})
        chosen = [(own, property_table(own))]
    if form != "table":
        rows = [
            {"oil": oil.name} | {key: float(value[k]) for key, value in columns.items()}
            for oil, columns in chosen
            for k in range(len(columns["rated"]))
        ]
        if form == "json":
            click.echo(json.dumps(rows, indent=1))
        else:
            text = io.StringIO()
            writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
            click.echo(text.getvalue(), nl=False)
    elif name is None and file is None:
        table = Table(title="oils", title_justify="left", title_style="bold")
        for heading in ("name", "oil", "rated [°C]", "mm²/s at -40, 40, 100 °C", "doubt"):
            table.add_column(heading, no_wrap=heading == "name")
        for oil, columns in chosen:
            nu = ", ".join(f"{v * 1e6:.4g}" for v in columns["viscosity_m2_s"])
            rated = f"{oil.rated_low:g} to {oil.rated_high:g}"
            table.add_row(oil.name, escape(oil.title), rated, nu, escape(oil.scatter))
        _console().print(table)
    else:
        _print_oil(*chosen[0])


def _print_oil(oil: Any, columns: dict[str, Any]) -> None:
    """Figures with sources, and the properties over temperature; outside the rated range with a star."""
    figures = [("viscosity_law", "", "", "viscosity over temperature", oil.source("viscosity_law"))]
    for key, field in quantities(oil).items():
        data = field.metadata
        figures.append((key, f"{getattr(oil, key):.6g}", symbol(data["unit"]), data["doc"], oil.source(key)))
    _print_table(f"{oil.name}: {oil.title}", ("name", "value", "unit", "meaning", "source"), figures)
    factors = {"viscosity": 1e6, "bulk": 1e-9, "vapour": 1e-3}
    rows = []
    for k, rated in enumerate(columns["rated"]):
        cells = [f"{columns['temperature_degC'][k]:g}{'' if rated else ' *'}"]
        for key, values in list(columns.items())[2:]:
            cells.append(f"{values[k] * factors.get(key.split('_')[0], 1.0):.4g}")
        rows.append(tuple(cells))
    headings = (
        "T [°C]", "viscosity [mm²/s]", "at 21 MPa", "density [kg/m³]", "at 21 MPa", "bulk modulus [GPa]", "at 21 MPa",
        "specific heat [J/kgK]", "vapour pressure [kPa]",
    )  # fmt: skip
    _print_table("over temperature (* outside the rated range)", headings, rows)
    if oil.scatter:
        _console().print(f"doubt: {escape(oil.scatter)}")


def _console() -> Console:
    """Standard output; as wide as the terminal, or wide enough for the tables where there is none."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else 160)


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())


def _show_warning(message: Any, category: type[Warning], *details: Any, **more: Any) -> None:
    if issubclass(category, ValidityWarning):
        click.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; every expected failure is one line on standard error and an exit code."""
    warnings.showwarning = _show_warning
    gc.freeze()
    gc.set_threshold(100_000, 50, 50)  # imports make many objects and no garbage: a tenth of a second of searching less
    try:
        cli.main(standalone_mode=False)
    except InputError as error:
        _fail(str(error), 2)
    except SolveError as error:
        _fail(str(error), 1)
    except click.ClickException as error:
        _fail(error.format_message().replace("\n", " "), 2)
    except (click.Abort, KeyboardInterrupt):
        _fail("interrupted; nothing half-written is left", 130)


def _fail(message: str, code: int) -> None:
    click.echo(f"error: {message}", err=True)
    sys.exit(code)


if __name__ == "__main__":
    main()
