"""`valvesim response`: step and frequency response."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import click

from valvesim.cli.display import print_figures, progress_bar
from valvesim.cli.judging import end_on_failure, judged_by, oil_temperatures, read_specification
from valvesim.cli.options import (
    dither_options,
    format_option,
    output_option,
    read_dither,
    settings_option,
    specification_option,
    valve_option,
)
from valvesim.cli.output_folder import all_or_nothing


@click.command()
@click.argument("scenario", type=click.Path(path_type=Path), required=False)
@output_option("results/response")
@click.option("--oil-temperature", help="One or more: '20,100,200 degC' [the scenario's, that of --spec, or 20 degC].")
@dither_options
@valve_option
@specification_option
@format_option("table", "json", "csv")
@settings_option
def response(
    scenario: Path | None, output: Path, oil_temperature: str | None, dither_amplitude: str | None,
    dither_frequency: str | None, valve: str | None, spec: Path | None, form: str, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Step and frequency response at 10, 25, 40 and 100 % of rated current: figures and pictures.

    Also at the amplitudes and frequencies of --spec. Of the reference valve, of --valve, or of the valve, oil, drive
    and effects of a SCENARIO.
    """
    from valvesim.characterisation.response_set import amplitudes_of, measure_responses, response_tests
    from valvesim.reports.response import response_report
    from valvesim.reports.title_block import valve_name
    from valvesim.simulation.scenario import Scenario, Thermal
    from valvesim.simulation.scenario_toml import load_scenario, read_tables

    limits, dither = read_specification(spec), read_dither(dither_amplitude, dither_frequency)
    if scenario is None:
        own = read_tables(settings, valve=valve)
        source = Scenario(valve=own.valve, oil=own.oil, effects=own.effects, thermal=Thermal(network=None))
    else:
        source = load_scenario(scenario, settings=settings, valve=valve)
    own_temperature = scenario is not None and oil_temperature is None
    temperatures = None if own_temperature else oil_temperatures(oil_temperature, limits)
    steps, sweeps = amplitudes_of(limits)
    with all_or_nothing(output) as folder, progress_bar() as bar:
        stage = bar.add_task("stepping and sweeping", total=1.0)
        sets = measure_responses(
            source, oil_temperatures=temperatures, dither=dither, steps=steps, sweeps=sweeps,
            progress=lambda share: bar.update(stage, completed=share),
        )
        paths = response_report(sets, folder, valve=valve_name(source.valve), date=date.today())
    tests = response_tests(sets, source, limits)
    judged = judged_by(limits, tests)
    print_figures(tests, form, judged, [output / path.name for path in paths])
    end_on_failure(judged)
