"""Binary formats are read by libraries of machine code, in a process of their own: what a damaged file does to it
(crash, endless loop, all the memory) is an error of one line here.

A process that has read well is kept for the next file. After a file that it could not read it is ended, so that
nothing that was damaged in its memory is used again.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.io import reason
from valvesim.measurement.table import MOST_MEASURED_SAMPLES, Choice, Column, Heading, MeasuredTable

MOST_SECONDS, MOST_SECONDS_A_MB = 2.0, 20.0  # of processor time; the slowest, xlsx, takes some 1.7 a MB
LONGEST_WAIT, PATIENCE = 60.0, 10.0  # s by the clock, and for each s of processor time: slow discs, busy machines

_PROGRAM = "import sys; sys.path[:] = sys.argv[1:]; from valvesim.measurement.reader_main import serve; serve()"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_idle: list[Reader] = []


def read_apart(path: Path, name: str, choice: Choice) -> tuple[MeasuredTable, ...]:
    """The tables of a file in a binary format, `name` for messages, by its extension.

    Raises InputError for a file that is broken, that no library or too much time or memory is there for.
    """
    reader = _taken()
    seconds = MOST_SECONDS + MOST_SECONDS_A_MB * os.path.getsize(path) / 1e6
    late = threading.Timer(_by_the_clock(seconds), reader.process.kill)
    late.daemon = True
    late.start()
    try:
        tables = reader.read(path, seconds, choice)
    except InputError as error:
        reader.end()
        raise error if error.file else error.at(file=path) from None
    except EOFError:
        told = _ending(reader.end(patience=1.0), seconds)
        advice = "is it whole? Write it anew, or as CSV"
        raise InputError(f"is no {name} file that can be read ({told}); {advice}", file=path) from None
    except BaseException:
        reader.end()
        raise
    finally:
        late.cancel()
    _idle.append(reader)
    return tables


def _taken() -> Reader:
    """A process that nobody else uses."""
    while True:
        try:
            reader = _idle.pop()
        except IndexError:
            return Reader()
        if reader.process.poll() is None:
            return reader
        reader.end()


def _by_the_clock(seconds: float) -> float:
    return LONGEST_WAIT + PATIENCE * seconds


def _ending(code: int, seconds: float) -> str:
    """Why a process has ended, by its exit code."""
    if code == -getattr(signal, "SIGPROF", 0):
        return f"its library was not done in {seconds:.3g} s of processor time"
    if code == -getattr(signal, "SIGKILL", 0):
        return f"reading it took more than {_by_the_clock(seconds):.3g} s, or more memory than there is"
    named = signal.Signals(-code).name if -code in set(signal.Signals) else f"exit code {code}"
    return f"its library crashed, {named}"


class Reader:
    """A process that reads files by request; `reader_main` is what runs in it. No Ctrl-C on a terminal reaches it."""

    def __init__(self) -> None:
        from multiprocessing.spawn import get_executable  # Python, also where it stands inside another program

        try:
            self.process: Any = subprocess.Popen(
                [get_executable(), "-c", _PROGRAM, *map(str, sys.path)], env={**os.environ, **_ONE_THREAD},
                process_group=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"the process that reads binary files cannot be started ({reason(error)})") from None

    def read(self, path: Path, seconds: float, choice: Choice) -> tuple[MeasuredTable, ...]:
        """The tables of a file. InputError for a broken one, EOFError where the process ends or makes no sense."""
        self._ask([os.path.abspath(path), path.suffix.casefold(), seconds])
        while "headings" in (told := self._told()):
            self._ask([int(k) for k in choice([Heading(*heading) for heading in told["headings"]])])
        if "problem" in told:
            raise InputError(told["problem"])
        try:
            return tuple(map(self._table, told["tables"]))
        except (LookupError, TypeError, ValueError):
            raise EOFError from None

    def end(self, patience: float = 0.0) -> int:
        """End the process; its exit code, also where it has ended before or does so within `patience` seconds."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(patience)
        self.process.kill()
        code = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()
        return code

    def _ask(self, told: Any) -> None:
        try:
            self.process.stdin.write(json.dumps(told).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            raise EOFError from None

    def _told(self) -> dict[str, Any]:
        try:
            return json.loads(self.process.stdout.readline())
        except (OSError, ValueError):  # no line too
            raise EOFError from None

    def _table(self, told: dict[str, Any]) -> MeasuredTable:
        top = told["header_line"]
        columns = (Column(k, Heading(name, unit), self._values(count)) for k, name, unit, count in told["columns"])
        return MeasuredTable(
            told["name"], tuple(Heading(*heading) for heading in told["headings"]), tuple(columns), start=told["start"],
            header_line=top, notes=tuple(told["notes"]), line_of=lambda row: None if top is None else top + 1 + row,
        )  # fmt: skip

    def _values(self, count: int) -> np.ndarray:
        if count > MOST_MEASURED_SAMPLES:
            raise ValueError(count)
        values = np.empty(count)
        if self.process.stdout.readinto(values.view(np.uint8).data) < values.nbytes:
            raise EOFError
        return values


def _end_all() -> None:
    while _idle:
        _idle.pop().end()


atexit.register(_end_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # they answer the process that started them
