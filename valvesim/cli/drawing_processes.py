"""Pictures drawn beside what computes, each in a process of its own: nobody waits for half a second of matplotlib."""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from valvesim.cli.interrupts import end_with_parent, hidden_from_children

Draw = Callable[..., Callable[[], Path | None]]

AT_ONCE = 2  # pictures that are drawn at the same time
LOADED = (
    "valvesim.reports.run", "valvesim.simulation.result", "valvesim.simulation.scenario_toml", "valvesim.cli.main",
    "valvesim.cli.drawing_processes",
)  # fmt: skip
"""What the processes need: a server loads it while this process goes on, and they are forked from the server."""


def load_for_drawing() -> None:
    """Begin to load what the processes need, while this one goes on."""
    _context()


@contextlib.contextmanager
def drawing_processes() -> Iterator[Draw]:
    """`draw(name, *arguments)` begins a picture of `valvesim.reports.run` and returns what waits for its path.

    Where the arguments cannot travel (an effect made of lambdas), the picture is drawn here when it is waited for. At
    the end, or however this process ends, none of the others is left.
    """
    context, starting, ended = _context(), threading.Lock(), threading.Event()
    begun: list[Any] = []

    def draw_beside(*job: Any) -> Path | None:
        here, there = context.Pipe(duplex=False)
        process = context.Process(target=_draw_into, args=(there, *job), daemon=True)
        with starting, hidden_from_children():
            if ended.is_set():
                return None
            process.start()
            begun.append(process)
        there.close()
        try:
            with here:
                path, error = here.recv()
        finally:
            process.join()
        if error is not None:
            raise error
        return path

    with ThreadPoolExecutor(AT_ONCE) as threads:

        def draw(*job: Any) -> Callable[[], Path | None]:
            drawn = threads.submit(draw_beside, *job)

            def wait() -> Path | None:
                try:
                    return drawn.result()
                except (pickle.PicklingError, AttributeError, TypeError, EOFError, ConnectionError):
                    return _draw(*job)

            return wait

        try:
            yield draw
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            with starting:
                ended.set()
                for process in begun:
                    process.kill()


@contextlib.contextmanager
def no_drawing() -> Iterator[Draw]:
    """`drawing_processes` where no pictures are wanted."""
    yield lambda *job: lambda: None


def _context() -> Any:
    """How processes are made: forked from a server that has loaded what they need, or each anew where none can be."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver

    forkserver.set_forkserver_preload(list(LOADED))
    with hidden_from_children():
        forkserver.ensure_running()
    return multiprocessing.get_context("forkserver")


def _draw_into(pipe: Connection, *job: Any) -> None:
    """Draw a picture and tell its path, or what failed."""
    end_with_parent()
    path, failed = None, None
    try:
        path = _draw(*job)
    except Exception as error:
        failed = error
    pipe.send((path, failed))


def _draw(name: str, *arguments: Any) -> Path | None:
    """One picture of `valvesim.reports.run`."""
    return getattr(import_module("valvesim.reports.run"), name)(*arguments)
