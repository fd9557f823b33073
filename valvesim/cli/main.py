"""The command line: `valvesim run | static | response | bench | datasheet | diagnose | ...`.

Exit codes: 0 done, 1 a solve failed, 2 the input is wrong. Tables go to standard output, all else to standard error.
Each command stands in the module of its name, which is loaded when it is asked for and imports what it needs when it
runs.
"""

from __future__ import annotations

import gc
import os
import sys
import warnings
from importlib import import_module
from typing import Any

import click

from valvesim.errors import InputError, SolveError, ValidityWarning

COMMANDS = (
    "bench", "datasheet", "diagnose", "effects", "oils", "parameters", "reproduce", "response", "run", "static",
)  # fmt: skip


class _Commands(click.Group):
    """The commands by name, each loaded from its own module."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return getattr(import_module(f"valvesim.cli.{cmd_name}"), cmd_name) if cmd_name in COMMANDS else None


@click.group(
    cls=_Commands,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(package_name="valvesim")
@click.pass_context
def cli(context: click.Context) -> None:
    """A two-stage electro-hydraulic servo valve over temperature and time."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


def _show_warning(message: Any, category: type[Warning], *details: Any, **more: Any) -> None:
    if issubclass(category, ValidityWarning):
        click.echo(f"warning: {message}", err=True)


def main() -> None:
    """Run the command line; every expected failure is one line on standard error and an exit code."""
    warnings.showwarning = _show_warning
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: on a busy machine its threads only wait
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
