"""`valvesim static`: the valve at rest over current and oil temperature."""

from __future__ import annotations

import click

from valvesim.cli.display import console, print_rows, titled_table
from valvesim.cli.options import format_option, settings_option, valve_option


@click.command()
@click.option("--current", required=True, help="One or more: '1 mA' or '-1, 0, 1 mA'.")
@click.option("--oil-temperature", required=True, help="One or more: '20,100,270 degC'.")
@click.option("--routes", help="Only these temperature routes vary: 'flow,mmf'; '' for none [all].")
@format_option("table", "json", "csv")
@valve_option
@settings_option
def static(
    current: str, oil_temperature: str, routes: str | None, form: str, valve: str | None, settings: tuple[str, ...]
) -> None:  # fmt: skip
    """Where a valve without effects rests, at every current and temperature (isothermal, the paper's TAD solution)."""
    from valvesim.simulation.scenario_toml import read_tables
    from valvesim.units import parse_list
    from valvesim.valve.coefficients import ROUTES
    from valvesim.valve.equilibrium import static_solution

    currents = parse_list(current, "A", "--current")
    temperatures = parse_list(oil_temperature, "degC", "--oil-temperature")
    chosen = ROUTES if routes is None else tuple(name.strip() for name in routes.split(",") if name.strip())
    own = read_tables(settings, valve=valve)
    rest = static_solution(
        own.valve, current=currents[:, None], temperature=temperatures, routes=chosen, oil=own.oil
    )
    fields = {
        "current_A": rest.current, "oil_temperature_degC": rest.temperature, "armature_angle_rad": rest.armature_angle,
        "spool_position_m": rest.spool_position, "pilot_differential_pressure_Pa": rest.pilot_differential_pressure,
    }  # fmt: skip
    columns = (values.flat for values in fields.values())
    rows = [dict(zip(fields, map(float, row), strict=True)) for row in zip(*columns, strict=True)]
    if form != "table":
        print_rows(rows, form)
        return
    table = titled_table("valve at rest")
    for heading in ("current [mA]", "oil [°C]", "angle [mrad]", "spool [mm]", "p1 - p2 [bar]"):
        table.add_column(heading.replace("[", "\\["), justify="right")
    for row in rows:
        scaled = zip(row.values(), (1e3, 1.0, 1e3, 1e3, 1e-5), strict=True)
        table.add_row(*(f"{value * factor:.7g}" for value, factor in scaled))
    console().print(table)
