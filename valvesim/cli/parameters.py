"""`valvesim parameters`: every parameter with its range and source."""

from __future__ import annotations

import click

from valvesim.cli.display import console, print_rows, titled_table
from valvesim.cli.options import format_option


@click.command()
@format_option("table", "json", "csv")
def parameters(form: str) -> None:
    """Every parameter: name, value, unit, range, tolerance and source."""
    from rich.markup import escape

    from valvesim.units import quantities, range_text, symbol, tolerance_text
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
    if form != "table":
        print_rows([dict(zip(headings, row, strict=True)) for row in rows], form)
        return
    table = titled_table("parameters (SI)")
    for heading in headings:
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=heading == "name")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    console().print(table)
