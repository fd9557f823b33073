"""The command line: `valvesim run | static | response | bench | datasheet | diagnose | ...`.

Exit codes: 0 done; 1 a solve failed, or the system refused memory or standard output; 2 the input is wrong, or its
results cannot be written; 3 a measured valve fails its specification; 128 + its number where a signal ended it (130
Ctrl-C, 143 SIGTERM, 141 a closed pipe). Tables go to standard output, all else to standard error.
Each command stands in the module of its name, which is loaded when it is asked for and imports what it needs when it
runs.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import warnings
from importlib import import_module
from typing import Any

import click

from valvesim.cli.interrupts import MESSAGE, ended_by_signals, let_end
from valvesim.cli.permissions import with_permissions
from valvesim.cli.streams import CLOSED_PIPE, drop_output, prepare_streams
from valvesim.errors import InputError, SolveError, ValidityWarning, nearest, one_line

COMMAND_SECTIONS = {  # of the help, each with its commands
    "Simulate": ("run", "scenarios", "static", "study", "open"),
    "Characterise": ("bench", "response", "datasheet", "identify", "reproduce"),
    "Measured records": ("records", "acceptance", "plan", "diagnose"),
    "Look up": ("parameters", "effects", "oils"),
    "Hand on": ("export",),
}
COMMAND_NAMES = tuple(sorted(name for names in COMMAND_SECTIONS.values() for name in names))


class ClosedPipe(Exception):
    """Whoever read standard output has closed it: nobody's failure."""


class _Commands(click.Group):
    """The commands by name, each loaded from its own module."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise ClosedPipe from None  # or click would make a failure of it

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMAND_NAMES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMAND_NAMES:
            return None
        return with_permissions(getattr(import_module(f"valvesim.cli.{cmd_name}"), cmd_name))

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and not args[0].startswith("-") and args[0] not in COMMAND_NAMES:
            raise click.UsageError(f"no command {args[0]!r}{nearest(args[0], COMMAND_NAMES)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Each with the first sentence of its help, in full."""
        for heading, names in COMMAND_SECTIONS.items():
            rows = []
            for name in names:
                command = self.get_command(ctx, name)
                text = " ".join(((command.help if command else None) or "").split("\n\n")[0].split())
                rows.append((name, text.partition(". ")[0].rstrip(".")))
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=14)


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
        click.echo(f"warning: {one_line(str(message))}", err=True)


def main() -> None:
    """Run the command line; every expected failure is one line on standard error and an exit code."""
    with ended_by_signals():
        prepare_streams()
        warnings.showwarning = _show_warning
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: its threads only wait
        gc.freeze()
        gc.set_threshold(100_000, 50, 50)  # imports make many objects and no garbage: 0.1 s less
        message, code = _run()
        try:
            sys.stdout.flush()
        except OSError as error:
            message, code = (message, code) if code else _refused_by_the_system(error)
            drop_output()
        let_end()
        if message:
            with contextlib.suppress(OSError):  # nobody reads it, or the disc is full
                click.echo(f"error: {message}", err=True)
        if code:
            sys.exit(code)


def _run() -> tuple[str, int]:
    """Run the command of the command line: (what has failed, exit code)."""
    try:
        given = cli.main(standalone_mode=False)
        return "", given if isinstance(given, int) else 0
    except SystemExit as end:
        return "", end.code if isinstance(end.code, int) else 0
    except InputError as error:
        return str(error), 2
    except SolveError as error:
        return str(error), 1
    except click.ClickException as error:
        return one_line(_usage(error)), 2
    except (click.Abort, KeyboardInterrupt):
        return MESSAGE, 130
    except MemoryError:
        return "there is not enough memory for this; nothing half-written is left", 1
    except ClosedPipe:
        return "", CLOSED_PIPE
    except OSError as error:
        return _refused_by_the_system(error)


def _usage(error: click.ClickException) -> str:
    """What is wrong with the words of a command line, and which help tells more."""
    message = error.format_message().replace("\n", " ").rstrip(".")
    context = error.ctx if isinstance(error, click.UsageError) else None
    mark = "" if message.endswith("?") else ";"
    return f"{message}{mark} {context.command_path} --help tells more" if context else message


def _refused_by_the_system(error: OSError) -> tuple[str, int]:
    """(what the system refuses, exit code)."""
    if isinstance(error, BrokenPipeError):
        return "", CLOSED_PIPE
    from valvesim.io import reason

    what = "" if error.filename else "standard output or a temporary file: "
    return one_line(f"{what}cannot be read or written ({reason(error)})"), 1


if __name__ == "__main__":
    main()
