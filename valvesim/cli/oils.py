"""`valvesim oils`: the oils by name, and one in full."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import console, print_rows, print_table, titled_table
from valvesim.cli.options import format_option


@click.command()
@click.argument("name", required=False)
@click.option("--file", type=click.Path(path_type=Path), help="An oil of one's own, in place of a NAME.")
@format_option("table", "json", "csv")
def oils(name: str | None, file: Path | None, form: str) -> None:
    """The oils by name; with a NAME its figures and sources, and its properties over temperature."""
    from rich.markup import escape

    from valvesim.errors import InputError
    from valvesim.valve.oils import OILS, property_table, read_oil
    from valvesim.valve.valve_toml import read_oil_table

    if name is not None and file is not None:
        raise InputError("oils: give a NAME or --file, not both")
    if name is None and file is None:
        chosen = [(each, property_table(each, (-40.0, 40.0, 100.0))) for each in OILS.values()]
    else:
        own = read_oil({"name": name}, "oils") if file is None else read_oil_table({"file": file.name}, file.parent)
        chosen = [(own, property_table(own))]
    if form != "table":
        rows = [
            {"oil": oil.name} | {key: float(value[k]) for key, value in columns.items()}
            for oil, columns in chosen
            for k in range(len(columns["rated"]))
        ]
        print_rows(rows, form)
    elif name is None and file is None:
        table = titled_table("oils")
        for heading in ("name", "oil", "rated [°C]", "mm²/s at -40, 40, 100 °C", "doubt"):
            table.add_column(heading, no_wrap=heading == "name")
        for oil, columns in chosen:
            nu = ", ".join(f"{v * 1e6:.4g}" for v in columns["viscosity_m2_s"])
            rated = f"{oil.rated_low:g} to {oil.rated_high:g}"
            table.add_row(oil.name, escape(oil.title), rated, nu, escape(oil.scatter))
        console().print(table)
    else:
        _print_oil(*chosen[0])


def _print_oil(oil: Any, columns: dict[str, Any]) -> None:
    """Figures with sources, and the properties over temperature; outside the rated range with a star."""
    from rich.markup import escape

    from valvesim.units import quantities, symbol

    figures = [("viscosity_law", "", "", "viscosity over temperature", oil.source("viscosity_law"))]
    for key, field in quantities(oil).items():
        data = field.metadata
        figures.append((key, f"{getattr(oil, key):.6g}", symbol(data["unit"]), data["doc"], oil.source(key)))
    print_table(f"{oil.name}: {oil.title}", ("name", "value", "unit", "meaning", "source"), figures)
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
    print_table("over temperature (* outside the rated range)", headings, rows)
    if oil.scatter:
        console().print(f"doubt: {escape(oil.scatter)}")
