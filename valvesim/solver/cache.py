"""Compiled code kept between processes: found again in half a second, made anew where it does not fit.

An entry is a folder of the user's cache directory: the printed source, the machine code of it, numba's or an object
file, and a list of all of them with their hashes. It is filled beside its place and moved there whole, so that
processes that start at once each see all of it or nothing. Before a byte of it is run, every file must have its hash,
belong to the user and be writable by nobody else. Where no such folder can be kept, the code is compiled in memory.

An entry is named by the hash of its source and of what the source calls. So that a warm start need not trace a model
again, a short name, such as the names of its effects, leads to that hash for as long as the package's text is the same:
an edit costs one trace a model, and a compilation only where what is printed has changed.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from valvesim.errors import warn_once
from valvesim.io import UnsafeFile, check_own, reason
from valvesim.temporary_files import temporary_folder, temporary_path

SOURCE = "model.py"
OBJECT = "model.o"
MACHINE_CODE = "__pycache__"  # where numba keeps what it compiles of a file
HASH_LIST = "hashes.json"
NEW = ".new-"  # begins the name of an entry that is being filled
LONGEST_FILL = 3600.0  # s; a process that fills an entry for longer was killed


def load(
    short_name: Sequence[str] | None,
    printed: Callable[[], str],
    called: Iterable[Callable],
    call_once: Callable[[ModuleType], None],
) -> ModuleType:
    """The module of a printed source, with the machine code of its functions, kept or new.

    `printed` gives the source, `called` names the package's functions that it calls, and `call_once` calls each of its
    compiled functions with arguments of the types to come. `short_name` tells apart all sources that this package can
    print (None: nothing does, as with a user's functions, so it is printed every time).
    """

    def compiled_in(entry: Path, name: str) -> ModuleType:
        return _import(entry, name, call_once)

    return _found(short_name, printed, called, compiled_in, lambda text: _in_memory(text, call_once))


def load_object(
    short_name: Sequence[str] | None,
    printed: Callable[[], str],
    called: Iterable[Callable],
    compiled: Callable[[str], bytes],
) -> tuple[str, bytes]:
    """(a printed source, the object file that `compiled` makes of it), kept or new; the others as in `load`."""

    def compiled_in(entry: Path, name: str) -> tuple[str, bytes]:
        text = _read(entry / SOURCE).decode()
        if not (entry / OBJECT).exists():
            _write(entry / OBJECT, compiled(text))
        return text, _read(entry / OBJECT)

    return _found(short_name, printed, called, compiled_in, lambda text: (text, compiled(text)))


T = TypeVar("T")


def _found(
    short_name: Sequence[str] | None,
    printed: Callable[[], str],
    called: Iterable[Callable],
    compiled_in: Callable[[Path, str], T],
    in_memory: Callable[[str], T],
) -> T:
    """What is compiled of a source: `compiled_in(entry, name)`, which adds to an entry what it lacks, or where none can
    be kept `in_memory(source)`.
    """
    try:
        folder = _own_folder()
        return _kept(folder, short_name, printed, _surroundings(called), compiled_in)
    except (OSError, UnsafeFile) as error:
        warn_once(
            f"compiled equations are not kept, so that each start takes seconds longer: {reason(error)}; "
            "VALVESIM_CACHE_DIR names another folder",
            about="compiled equations are not kept",
        )
        return in_memory(printed())


def _kept(
    folder: Path,
    short_name: Sequence[str] | None,
    printed: Callable[[], str],
    surroundings: bytes,
    compiled_in: Callable[[Path, str], T],
) -> T:
    """What the entry in `folder` holds, filled first where there is none that fits."""
    pointer = None
    if short_name is not None:
        short = _hash("\n".join(short_name).encode(), _package_text(), surroundings)
        pointer = folder / f"{short}.txt"
        with contextlib.suppress(FileNotFoundError, UnicodeDecodeError):
            name = _read(pointer).decode()
            if re.fullmatch("[0-9a-f]{64}", name) and _fits(folder / name):
                return compiled_in(folder / name, name)
    text = printed()
    name = _hash(text.encode(), surroundings)
    fits = _fits(folder / name)
    found = compiled_in(folder / name, name) if fits else _fill(folder, name, text, compiled_in)
    if pointer is not None:
        _write(pointer, name.encode())
    return found


def _fits(entry: Path) -> bool:
    """Whether an entry is whole. UnsafeFile where somebody else can write to it."""
    try:
        listed = json.loads(_read(entry / HASH_LIST))
        for place in (entry, *(path for path in entry.rglob("*") if path.is_dir())):
            check_own(place)
        present = {str(path.relative_to(entry)) for path in entry.rglob("*") if path.is_file()} - {HASH_LIST}
        return present == set(listed) and all(_hash(_read(entry / name)) == listed[name] for name in present)
    except (FileNotFoundError, NotADirectoryError, ValueError, TypeError):
        return False


def _fill(folder: Path, name: str, text: str, compiled_in: Callable[[Path, str], T]) -> T:
    """Compile a source into a new entry, in place of one that does not fit."""
    with temporary_folder(folder, NEW, abandoned=LONGEST_FILL) as new:
        _write(new / SOURCE, text.encode())
        found = compiled_in(new, name)
        hashes = {}
        for path in sorted(path for path in new.rglob("*") if path.is_file()):
            path.chmod(0o600)
            hashes[str(path.relative_to(new))] = _hash(path.read_bytes())
        _write(new / HASH_LIST, json.dumps(hashes, indent=1).encode())
        if not _fits(folder / name):
            _remove(folder / name)
        with contextlib.suppress(OSError):  # another process was first: the same code
            os.rename(new, folder / name)
        return found


def _remove(entry: Path) -> None:
    """Remove an entry, which others see whole or not at all."""
    with temporary_folder(entry.parent, NEW, abandoned=LONGEST_FILL) as away, contextlib.suppress(FileNotFoundError):
        os.rename(entry, away / entry.name)


def _import(entry: Path, name: str, call_once) -> ModuleType:
    """The module of an entry: its machine code is loaded where there is some, else compiled and kept there."""
    path = entry / SOURCE
    module = _module(name, _read(path).decode(), str(path))
    functions = [f for f in vars(module).values() if hasattr(f, "enable_caching")]
    (entry / MACHINE_CODE).mkdir(mode=0o700, exist_ok=True)
    with _numba_keeps_beside_the_source():
        for function in functions:
            function.enable_caching()
            _load_without_registries(function._cache)
    call_once(module)
    for function in functions:  # what another type of argument needs later stays in memory: the entry is closed
        function._cache.disable()
    return module


def _load_without_registries(kept: Any) -> None:
    """Let numba load machine code without all that it would compile with, which it imports first: half a start.

    What is compiled loads it then. `kept` is numba's cache of a function.
    """
    from numba.core.runtime import rtsys

    def load_overload(signature: Any, context: Any) -> Any:
        rtsys.initialize(context)
        return kept._load_overload(signature, context)

    if hasattr(kept, "_load_overload"):
        kept.load_overload = load_overload


def _in_memory(text: str, call_once) -> ModuleType:
    module = _module(_hash(text.encode()), text, "<printed by valvesim>")
    call_once(module)
    return module


def _module(name: str, text: str, path: str) -> ModuleType:
    """A module executed from text: no bytecode is kept of it, which would be one more file to check."""
    module = ModuleType(f"valvesim_cache.model_{name}")
    module.__file__ = path
    sys.modules[module.__name__] = module
    exec(compile(text, path, "exec"), vars(module))
    return module


@contextlib.contextmanager
def _numba_keeps_beside_the_source() -> Iterator[None]:
    """Whatever NUMBA_CACHE_DIR says: only what stands in the entry is checked."""
    from numba.core import config as numba_config

    config: Any = numba_config
    kept, config.CACHE_DIR = config.CACHE_DIR, ""
    try:
        yield
    finally:
        config.CACHE_DIR = kept


# ---------------------------------------------------------------- what an entry depends on


def _hash(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


def _surroundings(called: Iterable[Callable]) -> bytes:
    """What turns a printed source into machine code: the modules that it calls, versions, and the processor."""
    import llvmlite.binding as llvm

    modules = sorted({str(sys.modules[function.__module__].__file__) for function in called})
    return b"\n".join(
        [*(Path(module).read_bytes() for module in modules), _versions(), llvm.get_host_cpu_name().encode()]
    )


@functools.cache
def _versions() -> bytes:
    from importlib.metadata import version

    names = ("numba", "llvmlite", "casadi", "numpy")
    return "\n".join([sys.version, *(version(name) for name in names)]).encode()


@functools.cache
def _package_text() -> bytes:
    """The text of all modules that take part in printing a model, and of more: a change costs a trace."""
    package = Path(__file__).parents[1]
    modules = [package / "channels.py", package / "inputs.py"]
    modules += sorted([*(package / "solver").glob("*.py"), *(package / "valve").rglob("*.py")])
    return b"\n".join(path.read_bytes() for path in modules)


# ---------------------------------------------------------------- files that nobody else can write


def _own_folder() -> Path:
    """The folder of compiled code, made where it is missing, for the user alone."""
    import platformdirs

    named = os.environ.get("VALVESIM_CACHE_DIR")
    folder = (Path(named) if named else Path(platformdirs.user_cache_dir("valvesim", appauthor=False))) / "compiled"
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    check_own(folder)
    return folder


def _read(path: Path) -> bytes:
    """A file's bytes. UnsafeFile where somebody else can write to it."""
    check_own(path)
    return path.read_bytes()


def _write(path: Path, data: bytes) -> None:
    """A file that appears whole, for the user alone."""
    with temporary_path(path.parent, NEW) as temporary:
        temporary.touch(mode=0o600, exist_ok=False)
        temporary.write_bytes(data)
        os.replace(temporary, path)
