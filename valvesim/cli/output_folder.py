"""A folder of results: all that a command writes appears in it together, or nothing; what else stands there is kept.

`manifest.json` in the folder tells what each command wrote, with hashes, and by which version, when and by which words
it did. By it a command knows its own earlier results, which the new ones replace. A folder without it that holds
anything, a file of ours that was changed since, and a file of somebody else where a result is to stand are left as they
are, unless the command line says `--overwrite`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any

import click

from valvesim.cli.options import may_overwrite
from valvesim.errors import InputError, one_line
from valvesim.temporary_files import MOVING, made_folder, temporary_folder
from valvesim.version import package_version

MANIFEST = "manifest.json"
PREFIX = ".valvesim-"  # of the folder in which results are written until they are complete


@contextlib.contextmanager
def all_or_nothing(folder: Path) -> Iterator[Path]:
    """A folder to write in; at the end its files move to `folder`, in place of those of the same command's last time.

    Whatever happens before, `folder` is as it was, or is not there. Raises InputError where it cannot be written, and,
    before anything is computed, where it holds what is not to be overwritten.
    """
    with contextlib.ExitStack() as stack:
        with _written(folder):
            place = Path(os.path.abspath(folder))
            if place.exists() and not place.is_dir():
                raise FileExistsError("it is a file")
            _check_free(folder, place)
            above = next(each for each in (place, *place.parents) if each.is_dir())
            new = stack.enter_context(temporary_folder(above, PREFIX)) / "results"
            new.mkdir()
        try:
            yield new
        except InputError as error:  # where it would have stood
            raise (
                error.at(file=folder / Path(error.file).relative_to(new)) if _is_in(error.file, new) else error
            ) from None
        with _written(folder), MOVING, made_folder(place.parent), _alone(place.parent):
            _publish(folder, place, new)


def check_place(folder: Path) -> None:
    """InputError where a folder cannot be made and written to; it is not made yet."""
    with _written(folder):
        place = Path(os.path.abspath(folder))
        above = next(each for each in (place, *place.parents) if each.exists())
        if not above.is_dir():
            raise FileExistsError(f"{above} is a file")
        with temporary_folder(above, PREFIX):
            pass


def check_free_file(*files: Path) -> None:
    """InputError where a file stands that a command would write, unless the command line says `--overwrite`."""
    for file in files:
        if os.path.lexists(file) and not may_overwrite():
            raise InputError("stands there already; name another file, or give --overwrite", file=file)


def _is_in(file: str, folder: Path) -> bool:
    return bool(file) and Path(file).is_relative_to(folder)


@contextlib.contextmanager
def _written(folder: Path) -> Iterator[None]:
    """InputError for what the system refuses."""
    from valvesim.io import reason

    try:
        yield
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be written ({reason(error)})", file=folder) from None


def _check_free(folder: Path, place: Path) -> None:
    """InputError where results would be written over what is not the command's own."""
    if may_overwrite() or not place.is_dir() or all(path.name.startswith(".") for path in place.iterdir()):
        return
    commands = _manifest(place)
    if commands is None:
        problem = f"holds files that no command of valvesim wrote ({MANIFEST} is not there or not whole)"
        raise InputError(f"{problem}; name another folder, or give --overwrite", file=folder)
    for name, written in commands.get(_command(), {}).items():
        if (place / name).exists() and _hash(place / name) != written:
            problem = f"{name} was changed since valvesim {_command()} wrote it; move it away, or give --overwrite"
            raise InputError(problem, file=folder)


def _publish(folder: Path, place: Path, new: Path) -> None:
    """Move what was written into place, and remove what the command wrote there last time and not now."""
    from valvesim.io import to_disc

    files = {path.relative_to(new).as_posix(): path for path in sorted(new.rglob("*")) if path.is_file()}
    _check_free(folder, place)  # another process may have been here meanwhile
    commands = (_manifest(place) or {}) if place.exists() else {}
    last = commands.pop(_command(), {})
    for name in files:
        if (place / name).exists() and name not in last and not may_overwrite():
            problem = f"holds {name}, which valvesim {_command()} did not write"
            raise InputError(f"{problem}; name another folder, or give --overwrite", file=folder)
    commands = {other: {k: v for k, v in own.items() if k not in files} for other, own in commands.items()}
    commands[_command()] = {name: _hash(path) for name, path in files.items()}
    made = {name: one for name, one in _made(place).items() if name in commands}
    made[_command()] = {
        "version": package_version(), "date": date.today().isoformat(), "words": [*map(one_line, sys.argv[1:])]
    }  # fmt: skip
    told = json.dumps({"written_by": "valvesim", "made": made, "commands": commands}, indent=1)
    (new / MANIFEST).write_text(told + "\n", encoding="utf-8")
    for path in (*files.values(), new / MANIFEST):
        to_disc(path)
    if not place.exists():
        os.rename(new, place)
        return
    for name in (*files, MANIFEST):  # the manifest last: it is right only of them all
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(new / name, place / name)
    for name in last.keys() - files.keys():
        (place / name).unlink(missing_ok=True)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time moves results into the same folder, where the system can lock one."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError):
            import fcntl

            handle = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, handle)
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _command() -> str:
    """The name of the command that runs."""
    return click.get_current_context().info_name or ""


def _manifest(place: Path) -> dict[str, dict[str, str]] | None:
    """Hashes of the files that each command wrote, by name; None where there is no manifest that says so."""
    try:
        commands: Any = json.loads((place / MANIFEST).read_bytes())["commands"]
        for files in commands.values():
            for name, written in files.items():
                inside = PurePosixPath(name)
                if not isinstance(written, str) or inside.is_absolute() or ".." in inside.parts:
                    return None
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return dict(commands)


def _made(place: Path) -> dict[str, Any]:
    """By which version, when and by which words each command wrote; nothing where no manifest says so."""
    try:
        made = json.loads((place / MANIFEST).read_bytes())["made"]
        return dict(made)
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return {}


def _hash(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
