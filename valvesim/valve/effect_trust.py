"""Whether Python code that a file names is run: where the user trusts it, by its content.

A scenario, a session, a plan or a valve file may name files of effects (`effects_files`), a study files of figures of
merit (`figures.functions`), and these run with the user's rights. Such a file is run where its very content was trusted
before (SHA-256 in `trusted_effects.txt` of the user's data folder, which `VALVESIM_DATA_DIR` moves), or where the
caller says so: `trust=True`, `--trust`, or a yes to the question of the command line. One outside the folder of the
file that names it needs `outside=True` or `--outside` too, unless it was trusted at that place.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

from valvesim.errors import InputError
from valvesim.io import MOST_TEXT, UnsafeFile, check_file, check_own, is_inside, reason
from valvesim.valve.permission import given, outside_permitted

TRUST_LIST = "trusted_effects.txt"
MOST_LISTED = 10_000_000  # bytes of the list that are read


def check_trusted(file: Path, content: bytes, folder: Path, *, key: str = "effects_files") -> None:
    """InputError unless the code in a `file` that a file in `folder` names at `key` may be run."""
    known = _trusted(content)
    if not is_inside(file, folder) and not outside_permitted() and file.resolve() not in known:
        problem = f"{str(file)!r} stands outside the folder {str(folder)!r}"
        raise InputError(f"{problem}; copy it there, or give --outside (in Python: outside=True)", key=key)
    if not known and not given().ask(file, content):
        problem = f"{str(file)!r} is Python code that would run with your rights, and it was not trusted before"
        raise InputError(f"{problem}; read it, then give --trust (in Python: trust=True)", key=key)


def check_inside(file: str, folder: Path, key: str) -> None:
    """InputError where a record that a file in `folder` names at `key` stands elsewhere and nobody said that it may."""
    if not is_inside(folder / file, folder) and not outside_permitted():
        problem = f"{file!r} stands outside the folder of the file that names it"
        raise InputError(f"{problem}; give --outside (in Python: outside=True) to read it", key=key)


def code_of(file: Path) -> bytes:
    """The content of a file of Python code. InputError where it cannot be read."""
    check_file(file, MOST_TEXT)
    try:
        return file.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({reason(error)})", file=file) from None


def remember(file: Path, content: bytes) -> None:
    """Trust this content from now on, and the file that holds it wherever it is named. OSError where that cannot be."""
    path = file.resolve()
    if path in _trusted(content) or not str(path).isprintable():
        return
    store = _list()
    store.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with open(os.open(store, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "a", encoding="utf-8") as lines:
        lines.write(f"{hash_of(content)} {path}\n")


def hash_of(content: bytes) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def _trusted(content: bytes) -> set[Path]:
    """The places at which this content was trusted; none where another user could have written the list."""
    store = _list()
    with contextlib.suppress(OSError, UnsafeFile, UnicodeDecodeError):
        check_own(store.parent)
        check_own(store)
        if store.stat().st_size <= MOST_LISTED:
            lines = (line.partition(" ") for line in store.read_text(encoding="utf-8").splitlines())
            return {Path(path) for digest, _, path in lines if digest == hash_of(content)}
    return set()


def _list() -> Path:
    """Where the hashes of trusted files stand."""
    import platformdirs

    named = os.environ.get("VALVESIM_DATA_DIR")
    return Path(named or platformdirs.user_data_dir("valvesim", appauthor=False)) / TRUST_LIST
