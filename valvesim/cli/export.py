"""`valvesim export`: the valve for other programs, as an FMU or as C."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from valvesim.cli.display import print_written
from valvesim.cli.options import output_option, settings_option, valve_option

_effects_option = click.option(
    "--effect", "effects", multiple=True, metavar="NAME",
    help="Add an effect, switched off: its amplitude becomes a parameter. On a sensor: sensor_bias.spool_position.",
)  # fmt: skip


@click.group()
def export() -> None:
    """Write a valve as an FMU or as C source code, for programs without Python."""


@export.command()
@click.argument("source", metavar="SCENARIO|VALVE")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("valve.fmu"), show_default=True)
@click.option("--fmi", type=click.Choice(("3.0", "2.0")), default="3.0", show_default=True, help="Version of FMI.")
@click.option("--compiler", help="C compiler for the binary inside [CC, cc, gcc or clang]; '' for sources alone.")
@click.option("--reference", is_flag=True, help="Simulate too: NAME_in.csv, NAME_ref.csv and NAME_ref.opt beside it.")
@click.option("--overwrite", is_flag=True, help="Write over a file that is no FMU of valvesim.")
@_effects_option
@valve_option
@settings_option
def fmu(
    source: str, output: Path, fmi: str, compiler: str | None, reference: bool, overwrite: bool,
    effects: tuple[str, ...], valve: str | None, settings: tuple[str, ...],
) -> None:  # fmt: skip
    """Model exchange and co-simulation in one archive (FMI 3.0 or 2.0), with its own solver and C sources.

    SCENARIO|VALVE is a scenario file, a valve file, or one that comes along by its name.
    """
    from valvesim.export.fmu import check_replaceable, export_fmu
    from valvesim.export.reference_results import write_reference
    from valvesim.export.source import load_source

    case = load_source(source, settings=settings, valve=valve, effects=effects)
    check_replaceable(output, overwrite=overwrite)
    written = export_fmu(case, output, version=fmi, compiler=compiler)
    told = f"binary for {written.binary.split('/')[1]}" if written.binary else "C sources alone, no binary"
    click.echo(
        f"FMI {fmi}, model exchange and co-simulation: {written.inputs} inputs, {written.states} states, "
        f"{written.outputs} further outputs, {written.parameters} parameters; {told}; model {written.token}"
    )
    if written.binary is None and compiler != "":
        click.echo("warning: no C compiler was found; an importer compiles the sources inside", err=True)
    beside = write_reference(case, output) if reference else []
    print_written([written.path, *beside])


@export.command()
@click.argument("source", metavar="SCENARIO|VALVE")
@output_option("results/c")
@_effects_option
@valve_option
@settings_option
def c(
    source: str, output: Path, effects: tuple[str, ...], valve: str | None, settings: tuple[str, ...]
) -> None:  # fmt: skip
    """C99 source code alone: a header to read, code without allocation, a fixed-step option, a test, a CMake file."""
    from valvesim.cli.output_folder import all_or_nothing
    from valvesim.export.c_source import export_c
    from valvesim.export.source import load_source

    case: Any = load_source(source, settings=settings, valve=valve, effects=effects)
    with all_or_nothing(output) as folder:
        written = export_c(case, folder)
    print_written([output / path.name for path in written])
