"""Ctrl-C and the signals that end a process: one line and the right code within a second, wherever it stands.

A signal does not unwind the command: compiled code, numba's compiler and a worker process would answer late, or with
tracebacks of their own. A thread that waits for signals ends the process instead: moves of finished results are let
through, worker processes are killed, temporary files are removed. The cursor comes back where a bar had hidden it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from valvesim.temporary_files import MOVING, remove_all

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
MESSAGE = "interrupted; nothing half-written is left"
CLEANUP_TIME = 0.5  # s, that moving results and ending worker processes are waited for

_ending = threading.Event()


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Inside, a signal ends the process with 128 + its number; ignored ones (nohup) stay ignored.

    Does nothing outside the main thread, which alone hears of signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard, told = socket.socketpair()
    told.setblocking(False)
    kept = {number: signal.getsignal(number) for number in SIGNALS}
    woken = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    for number, handler in kept.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, lambda *_: None)
    waiter = threading.Thread(target=_wait, args=(heard,), daemon=True)
    waiter.start()
    try:
        yield
    finally:
        if _ending.is_set():  # what failed here did so because its files went: the waiter has the last word
            waiter.join()
        for number, handler in kept.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        signal.set_wakeup_fd(woken)
        told.close()
        waiter.join()
        heard.close()


@contextlib.contextmanager
def hidden_from_children() -> Iterator[None]:
    """A process that is started inside hears of none of the signals: its parent ends it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would let the signals through again as it starts
    kept = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, kept)


def let_end() -> None:
    """Where a signal has begun to end the process, wait for that: what fails from then on may fail of it alone."""
    if _ending.is_set():
        threading.Event().wait()


def _kill_programs() -> None:
    """Kill the programs that this process has started, such as a compiler with its own, where the system lists them."""
    from multiprocessing import resource_tracker

    tracker = getattr(resource_tracker._resource_tracker, "_pid", None)  # ends with this process, and cleans up
    parents = _parents()
    waiting = [os.getpid()]
    while waiting:
        above = waiting.pop()
        for pid in [pid for pid, parent in parents.items() if parent == above and pid != tracker]:
            waiting.append(pid)
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)


def _parents() -> dict[int, int]:
    """The parent of every process, where the system tells."""
    found = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):  # it is gone by now
            found[int(status.parent.name)] = int(status.read_text().rpartition(")")[2].split()[1])
    return found


def end_with_parent() -> None:
    """In a worker process: end it as soon as the process that started it is gone, killed as that may be."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def wait() -> None:
            multiprocessing.connection.wait([parent.sentinel])
            os._exit(1)

        threading.Thread(target=wait, daemon=True).start()


def _wait(heard: socket.socket) -> None:
    """End the process at the first of the signals; return where the other end is closed."""
    while numbers := heard.recv(1):
        if numbers[0] in SIGNALS:
            _ending.set()
            _end(numbers[0])


def _end(number: int) -> None:
    try:
        MOVING.acquire(timeout=CLEANUP_TIME)  # and never given back
        workers = multiprocessing.active_children()
        for worker in workers:
            worker.kill()
        _kill_programs()
        for worker in workers:
            worker.join(CLEANUP_TIME)
        remove_all()
        bar = "\r\x1b[2K\x1b[?25h" if sys.stderr is not None and sys.stderr.isatty() else ""
        os.write(2, f"{bar}error: {MESSAGE}\n".encode())
    finally:
        os._exit(128 + number)
