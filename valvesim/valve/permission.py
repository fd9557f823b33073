"""What the user permits: that code which a file names is run, and that files outside its folder are read."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Permission:
    """What may be run and read. `ask(file, content)` is asked about code that was not trusted before."""

    ask: Callable[[Path, bytes], bool]
    outside: bool = False


def _never(file: Path, content: bytes) -> bool:
    return False


def _always(file: Path, content: bytes) -> bool:
    return True


NOTHING = Permission(ask=_never)
_GIVEN: ContextVar[Permission] = ContextVar("permission", default=NOTHING)


def given() -> Permission:
    """What is permitted here."""
    return _GIVEN.get()


@contextlib.contextmanager
def permitting(
    *, trust: bool = False, outside: bool = False, ask: Callable[[Path, bytes], bool] | None = None
) -> Iterator[None]:
    """Inside, files of effects are run (`trust`, or where `ask` says yes) and files outside a folder are read.

    What is permitted around it stays permitted.
    """
    around = given()
    asked = _always if trust else ask if ask is not None else around.ask
    token = _GIVEN.set(Permission(ask=asked, outside=around.outside or outside))
    try:
        yield
    finally:
        _GIVEN.reset(token)


def outside_permitted() -> bool:
    """Whether files outside the folder of the file that names them may be read."""
    return given().outside
