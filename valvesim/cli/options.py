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
    "--oil-temperature", default="20 degC", show_default=True, help="One or more: '20,100,200 degC'."
)


def output_option(default: str) -> Callable[[Any], Any]:
    """The folder that a command writes to."""
    return click.option(
        "-o", "--output", type=click.Path(path_type=Path), default=Path(default), show_default=True
    )  # fmt: skip


def format_option(*forms: str) -> Callable[[Any], Any]:
    """The form of a table on standard output, the first unless another is asked for."""
    return click.option("--format", "form", type=click.Choice(forms), default=forms[0], show_default=True)
