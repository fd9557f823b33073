"""`--trust` and `--outside` of every command that reads files, and the question about code that was not trusted yet."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable
from pathlib import Path

import click

READ = {"plan", "scenario", "session", "source", "study", "valve"}
"""Parameters of a command that name files in which other files may be named."""


def with_permissions(command: click.Command) -> click.Command:
    """A command with the two options, where it reads files that may name code or files elsewhere."""
    if isinstance(command, click.Group):
        for own in command.commands.values():
            with_permissions(own)
    names = {parameter.name for parameter in command.params}
    if READ & names and "trust" not in names:
        command.params += [
            click.Option(
                ["--trust"], is_flag=True, expose_value=False, callback=_permit_code,
                help="Run the Python files of effects that the input names, now and later.",
            ),
            click.Option(
                ["--outside"], is_flag=True, expose_value=False, callback=_permit_outside,
                help="Read records and run effects that stand outside the folder of the input.",
            ),
        ]  # fmt: skip
    return command


def _permit_code(context: click.Context, _: click.Parameter, trust: bool) -> None:
    from valvesim.valve.permission import permitting

    def ask(file: Path, content: bytes) -> bool:
        if trust or _says_yes(file, content):
            remember_files([file])
            return True
        return False

    context.with_resource(permitting(ask=ask))


def _permit_outside(context: click.Context, _: click.Parameter, outside: bool) -> None:
    from valvesim.valve.permission import permitting

    context.with_resource(permitting(outside=outside))


def _says_yes(file: Path, content: bytes) -> bool:
    """Whether the user, asked on a terminal, wants the code to be run; no where there is none."""
    from valvesim.cli.display import bars_hidden
    from valvesim.errors import one_line
    from valvesim.valve.effect_trust import hash_of

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    told = f"{file} ({len(content)} bytes, SHA-256 {hash_of(content)[:16]}...) is Python code"
    with bars_hidden():
        return click.confirm(f"{one_line(told)} that runs with your rights.\nRun it, now and later?", err=True)


def remember_files(files: Iterable[Path]) -> None:
    """Trust what stands in files that the user named as code, or that were written for him just now."""
    from valvesim.valve.effect_trust import remember

    for file in files:
        with contextlib.suppress(OSError):  # then they will be asked about again
            remember(file, file.read_bytes())
