"""`valvesim bench`: static figures of merit of the model, or of measured records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from valvesim.cli.display import print_figures, progress_bar
from valvesim.cli.judging import (
    end_on_failure,
    judged_by,
    oil_temperatures,
    read_specification,
    temperature_difference,
)
from valvesim.cli.options import (
    columns_option,
    dither_options,
    format_option,
    output_option,
    read_dither,
    settings_option,
    specification_option,
    temperatures_option,
    valve_option,
)
from valvesim.cli.output_folder import all_or_nothing

if TYPE_CHECKING:
    from valvesim.characterisation.dither import Dither
    from valvesim.characterisation.figure_of_merit import FiguresOfMerit
    from valvesim.characterisation.judgement_table import Tests


@click.command()
@output_option("results/bench")
@click.option("--measured", multiple=True, type=click.Path(path_type=Path), help="A record of any format, or several.")
@columns_option
@click.option("--test", "kind", help="What was measured: flow, pressure-gain, leakage or flow-load.")
@click.option("--lag", help="Lag of the meter, such as '1 s' [estimated where the record allows it].")
@click.option("--dead-zone", help="Dead zone of the meter, such as '0.2 L/min' [estimated].")
@click.option("--rated-current", help="Rated current of the measured valve [the largest in the record].")
@temperatures_option
@dither_options
@valve_option
@specification_option
@format_option("table", "json", "csv")
@settings_option
def bench(
    output: Path, measured: tuple[Path, ...], columns: Path | None, kind: str | None, lag: str | None,
    dead_zone: str | None, rated_current: str | None, oil_temperature: str | None, dither_amplitude: str | None,
    dither_frequency: str | None, valve: str | None, spec: Path | None, form: str, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Static figures of merit (SAE ARP490, ISO 10770-1) of the model, or of measured records.

    Several leakage records of different periods also give the hysteresis that they have in common, and the meter's lag.
    """
    from valvesim.errors import InputError
    from valvesim.measurement.columns_table import NOTHING_STATED, read_statements
    from valvesim.simulation.scenario_toml import read_tables
    from valvesim.units import parse

    limits, dither = read_specification(spec), read_dither(dither_amplitude, dither_frequency)
    if not measured:
        stated = (("--columns", columns), ("--test", kind), ("--lag", lag), ("--dead-zone", dead_zone))
        if given := [name for name, value in stated if value is not None]:
            raise InputError(f"{given[0]} speaks of a measured record: give --measured FILE too")
        own = read_tables(settings, valve=valve)
        temperatures = oil_temperatures(oil_temperature, limits)
        tests, written = _test_model(own, temperatures, output, temperature_difference(limits), dither)
        judged = judged_by(limits, tests, valve=own.valve)
        print_figures(tests, form, judged, written)
        end_on_failure(judged)
        return
    if dither.amplitude:
        raise InputError("--dither-amplitude: of measured records state it in acceptance.toml (`valvesim acceptance`)")
    if kind is None:
        raise InputError("--measured needs --test: flow, pressure-gain, leakage or flow-load")
    options: dict[str, Any] = {
        "lag": None if lag is None else parse(lag, "s", "--lag"),
        "dead_zone": None if dead_zone is None else parse(dead_zone, "m^3/s", "--dead-zone"),
        "rated_current": None if rated_current is None else parse(rated_current, "A", "--rated-current"),
    }
    options["stated"] = NOTHING_STATED if columns is None else read_statements(columns)
    tests, written = _test_records(measured, kind, options, output)
    judged = judged_by(limits, tests)
    print_figures(tests, form, judged, written)
    end_on_failure(judged)


def _test_model(
    own: Any, temperatures: list[float], output: Path, difference: float, dither: Dither
) -> tuple[Tests, list[Path]]:  # fmt: skip
    """All static tests on the model at each temperature, with a picture and a page each; what was written."""
    from valvesim.characterisation.acceptance.acceptance_tests import acceptance_tests
    from valvesim.reports.acceptance import acceptance_report

    results, names = [], []
    with all_or_nothing(output) as folder:
        for temperature in temperatures:
            with progress_bar() as bar:
                stage = bar.add_task(f"bench at {temperature:g} °C", total=1.0)
                result = acceptance_tests(
                    own.valve, oil_temperature=temperature, oil=own.oil, effects=own.effects,
                    temperature_difference=difference, dither=dither,
                    progress=lambda share: bar.update(stage, completed=share),  # noqa: B023 - called within this turn
                )  # fmt: skip
            written = acceptance_report(result, folder / f"bench_{temperature:g}_degC.png", date=date.today())
            names += [path.name for path in written]
            results.append(result)
    tests = [(f"bench, oil at {one.oil_temperature:g} °C", one.conditions, one.figures) for one in results]
    return tests, [output / name for name in names]


def _test_records(
    files: Sequence[Path], kind: str, options: dict[str, Any], output: Path
) -> tuple[Tests, list[Path]]:  # fmt: skip
    """Measured records, with a picture and a page each; what was written."""
    from valvesim.characterisation.acceptance.acceptance_tests import measured_test
    from valvesim.characterisation.acceptance.leakage import common_hysteresis
    from valvesim.characterisation.acceptance.record import read_record
    from valvesim.errors import InputError
    from valvesim.reports.acceptance import measured_report

    if twice := [file for k, file in enumerate(files) if file.stem in (other.stem for other in files[:k])]:
        raise InputError(f"--measured: {twice[0]}: another record has the same name, after which its results are named")
    tests: list[tuple[str, Mapping[str, float], FiguresOfMerit]] = []
    names = []
    with all_or_nothing(output) as folder:
        for file in files:
            one = measured_test(file, kind, **options)
            written = measured_report(one, folder / f"{file.stem}.png", date=date.today())
            names += [path.name for path in written]
            named = tuple(replace(figure, name=f"{kind}.{figure.name}") for figure in one.figures)
            tests.append((f"{kind} of {file}", {}, named))
        if kind == "leakage" and len(files) > 1:
            common = common_hysteresis([read_record(file, stated=options["stated"]) for file in files])
            tests.append(("what the records have in common", {}, common))
    return tests, [output / name for name in names]
