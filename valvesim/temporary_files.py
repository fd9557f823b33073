"""Temporary files and folders: they go when their block ends, and an interrupt that ends the process removes them too.

Only a kill that no process hears of (SIGKILL, a power cut) leaves them; those of an age are then removed by whoever
next makes one of the same prefix in the same place.
"""

from __future__ import annotations

import contextlib
import secrets
import shutil
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

ABANDONED = 86_400.0  # s; no block lasts for longer

MOVING = threading.RLock()
"""Held while finished files are moved to their places: an interrupt waits for it, so that all of them are there."""

_present: set[Path] = set()
_made: set[Path] = set()


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """A folder, made with those above it where they are missing; what was made and is empty in the end goes again."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    _made.update(missing)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        _remove_empty(missing)
        _made.difference_update(missing)


@contextlib.contextmanager
def temporary_folder(parent: Path, prefix: str, *, abandoned: float = ABANDONED) -> Iterator[Path]:
    """A new folder in `parent` for this user alone, whose name begins with `prefix`. OSError where it cannot be made.

    What stands there under the same prefix and was not changed for `abandoned` seconds is removed.
    """
    _remove_abandoned(parent, prefix, abandoned)
    with temporary_path(parent, prefix) as path:
        path.mkdir(mode=0o700)
        yield path


@contextlib.contextmanager
def temporary_path(parent: Path, prefix: str, suffix: str = "") -> Iterator[Path]:
    """A path in `parent` at which nothing stands yet; whatever stands there in the end is removed."""
    path = parent / f"{prefix}{secrets.token_hex(8)}{suffix}"
    _present.add(path)  # before it is made, so that no interrupt comes between
    try:
        yield path
    finally:
        _remove(path)
        _present.discard(path)


def remove_all() -> None:
    """Remove what is there now of all temporary files and folders of this process, before it ends."""
    for _ in range(10):  # another thread may still be filling one
        for path in tuple(_present):
            _remove(path)
        if not any(path.exists() for path in tuple(_present)):
            _remove_empty(tuple(_made))
            return
        time.sleep(0.01)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in sorted(folders, key=lambda each: len(each.parts), reverse=True):  # what lies deepest first
        with contextlib.suppress(OSError):
            folder.rmdir()


def _remove_abandoned(parent: Path, prefix: str, age: float) -> None:
    with contextlib.suppress(OSError):
        for path in parent.iterdir():
            if path.name.startswith(prefix) and time.time() - path.stat().st_mtime > age:
                _remove(path)
