"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

settings_option = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Override a figure: valve.null_gap='0.03 mm'."
)
valve_option = click.option(
    "--valve", metavar="FILE", help="A valve file, or a valve of the package by name [the reference valve]."
)
temperatures_option = click.option(
    "--oil-temperature", help="One or more: '20,100,200 degC' [that of --spec, or 20 degC]."
)
columns_option = click.option(
    "--columns", type=click.Path(path_type=Path), help="A file with the table [columns], as `records` writes it."
)

_OVERWRITE = "valvesim.overwrite"


def output_option(default: str | None, help: str | None = None) -> Callable[[Any], Any]:
    """The folder that a command writes to, and whether it may write over what stands there (`may_overwrite`)."""
    folder = click.option(
        "-o", "--output", type=click.Path(path_type=Path), default=default and Path(default), show_default=True,
        help=help,
    )  # fmt: skip
    return lambda command: folder(overwrite_option("Write over files in it that this command did not write.")(command))


def overwrite_option(help: str) -> Callable[[Any], Any]:
    """Whether the command may write over what stands there (`may_overwrite`)."""

    def keep(context: click.Context, _: click.Parameter, given: bool) -> None:
        context.meta[_OVERWRITE] = given

    return click.option("--overwrite", is_flag=True, expose_value=False, callback=keep, help=help)


def output_file_option(default: str | None, help: str | None = None) -> Callable[[Any], Any]:
    """The one file that a command writes, which `output_folder.check_free_file` looks at."""
    file = click.option(
        "-o", "--output", type=click.Path(path_type=Path), default=default and Path(default), show_default=True,
        help=help,
    )  # fmt: skip
    return lambda command: file(overwrite_option("Write over a file that stands there.")(command))


def may_overwrite() -> bool:
    """Whether the command line that runs says `--overwrite`."""
    return bool(click.get_current_context().meta.get(_OVERWRITE))


specification_option = click.option(
    "--spec", type=click.Path(path_type=Path), help="Judge the figures by this specification; exit code 3 on a fail."
)


def dither_options(command: Any) -> Any:
    """The dither upon the command of a test; `read_dither` reads both."""
    frequency = click.option("--dither-frequency", help="Its frequency, such as '400 Hz'.")
    return click.option("--dither-amplitude", help="A dither upon the command: '2 %' of rated, peak [none].")(
        frequency(command)
    )


def read_dither(amplitude: str | None, frequency: str | None) -> Any:
    """The dither of both options. Raises InputError for one without the other, and for what is out of bounds."""
    from valvesim.characterisation.dither import dither_of
    from valvesim.characterisation.specification import read_condition
    from valvesim.errors import InputError

    if (amplitude is None) != (frequency is None):
        raise InputError("--dither-amplitude and --dither-frequency go together, such as '2 %' and '400 Hz'")
    given = {"dither_amplitude": amplitude, "dither_frequency": frequency}
    return dither_of({n: read_condition(n, t, f"--{n.replace('_', '-')}") for n, t in given.items() if t is not None})


def format_option(*forms: str) -> Callable[[Any], Any]:
    """The form of a table on standard output, the first unless another is asked for."""
    return click.option("--format", "form", type=click.Choice(forms), default=forms[0], show_default=True)
