"""What the process that reads binary formats does: files by request, within bounds of memory and processor time.

Requests and answers are lines of JSON on standard input and output, columns follow as bytes (`reader_process`). The
system itself ends the process where a library is not done in time, crashes, or where whoever asked is gone: none of
this needs the interpreter, which the library may hold.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from valvesim.errors import InputError
from valvesim.measurement.formats import FORMATS, Format
from valvesim.measurement.table import MOST_COLUMNS, MOST_MEASURED_SAMPLES, MOST_MEMORY, Choice, Heading, MeasuredTable


def serve() -> None:
    """Answer requests until there is nobody to ask."""
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    warnings.simplefilter("ignore")
    _bound_memory()
    for name in {"SIGPROF", "SIGIO"} & set(dir(signal)):  # as whoever asks has them, else
        signal.signal(getattr(signal, name), signal.SIG_DFL)

    def tell(told: Any) -> None:
        answers.write(json.dumps(told).encode() + b"\n")
        answers.flush()

    for request in requests:
        path, suffix, seconds = json.loads(request)

        def choice(headings: Sequence[Heading]) -> Collection[int]:
            if len(headings) > MOST_COLUMNS:
                raise InputError(f"{len(headings)} columns are more than {MOST_COLUMNS}")
            with _input_expected():
                tell({"headings": [[heading.name, heading.unit] for heading in headings]})
                return json.loads(requests.readline())

        try:
            told, columns = _parts(_tables(Path(path), FORMATS[suffix], choice, seconds))
        except InputError as error:
            tell({"problem": error.problem})
        else:
            tell({"tables": told})
            _send(columns, answers)


def _tables(path: Path, form: Format, choice: Choice, seconds: float) -> tuple[MeasuredTable, ...]:
    """The tables of a file. InputError says why it has none."""
    for library in form.libraries:
        try:
            import_module(library)
        except ImportError:
            advice = f"{form.name} files need {library}: pip install 'valvesim[{form.extra}]'"
            raise InputError(advice) from None
    try:
        with _ended_after(seconds):
            return form.read(path, choice)
    except InputError:
        raise
    except MemoryError:  # what is broken may claim any size
        told = "it asks for more memory than there is"
    except Exception as error:  # libraries raise errors of many kinds on a broken file
        told = " ".join(str(error).split())[:200] or type(error).__name__
    raise InputError(f"is no {form.name} file that can be read ({told})")


def _parts(tables: tuple[MeasuredTable, ...]) -> tuple[list[dict[str, Any]], list[np.ndarray]]:
    """(what JSON can tell of tables, their columns (n,) of float)."""
    told = [
        {
            "name": table.name, "headings": [[h.name, h.unit] for h in table.headings], "start": table.start,
            "columns": [[c.place, c.heading.name, c.heading.unit, len(c.values)] for c in table.columns],
            "header_line": table.header_line, "notes": table.notes,
        }
        for table in tables
    ]  # fmt: skip
    columns = [np.ascontiguousarray(column.values, dtype=float) for table in tables for column in table.columns]
    for column in columns:
        if len(column) > MOST_MEASURED_SAMPLES:
            raise InputError(f"{len(column)} samples are more than {MOST_MEASURED_SAMPLES}")
    return told, columns


def _send(columns: list[np.ndarray], answers: BinaryIO) -> None:
    """Send columns, and hold each no longer than that."""
    columns.reverse()
    while columns:
        answers.write(columns.pop().view(np.uint8).data)
    answers.flush()


# ---------------------------------------------------------------- what the system sees to, where it can


def _bound_memory() -> None:
    """Bound what the process may hold, and let it end without a picture of its memory."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        bounds = [bound for bound in (soft, hard) if bound != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min(MOST_MEMORY, there, *bounds), hard))


@contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """Inside, the process ends after so much processor time, and when nobody waits for it any more."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)
    _end_with_input(True)
    try:
        yield
    finally:
        _end_with_input(False)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, 0.0)


@contextmanager
def _input_expected() -> Iterator[None]:
    """Inside `_ended_after`, a request may come."""
    _end_with_input(False)
    try:
        yield
    finally:
        _end_with_input(True)


def _end_with_input(end: bool) -> None:
    """Have the system end the process at once where standard input, from which nothing is expected, closes."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        flags = fcntl.fcntl(0, fcntl.F_GETFL)
        fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(0, fcntl.F_SETFL, flags | os.O_ASYNC if end else flags & ~os.O_ASYNC)  # SIGIO ends
