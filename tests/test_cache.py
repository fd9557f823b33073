"""The cache of compiled code heals whatever is done to it, and runs nothing that another user could have put there."""

import json
import os
import shutil
import sys
import warnings

import pytest

from valvesim.errors import ValidityWarning, forget_warnings
from valvesim.solver import cache

SOURCE = """
from numba import njit

@njit
def run(x):
    return x + 1.0
"""
PLANTED = SOURCE.replace("1.0", "99.0")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of compiled code, not made yet."""
    monkeypatch.setenv("VALVESIM_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "compiled"


@pytest.fixture
def load():
    """Loads the source as a new process would; (what it computes of 1, how often it was printed)."""

    def load(short_name=("a",)):
        for name in [name for name in sys.modules if name.startswith("valvesim_cache")]:
            del sys.modules[name]
        printed = []

        def source():
            printed.append(SOURCE)
            return SOURCE

        module = cache.load(short_name, source, [cache.load], lambda module: module.run(1.0))
        return module.run(1.0), len(printed)

    return load


def entry_of(folder):
    (entry,) = (path for path in folder.iterdir() if path.is_dir())
    return entry


def files_of(folder):
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def whole(folder):
    entry = entry_of(folder)
    listed = json.loads((entry / cache.HASH_LIST).read_text())
    return all(cache._hash((entry / name).read_bytes()) == digest for name, digest in listed.items())


def test_what_is_kept_is_found_again_without_being_printed(folder, load):
    assert load() == (2.0, 1) and load() == (2.0, 0) and whole(folder)
    assert all(path.stat().st_mode & 0o077 == 0 for path in files_of(folder).values())
    assert entry_of(folder).stat().st_mode & 0o777 == 0o700


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "flipped": lambda data: data[:-9] + bytes([data[-9] ^ 4]) + data[-8:],
    "another's": lambda data: b"\x80\x04K\x01.",
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_every_damaged_file_is_made_anew(folder, load, damage):
    load()
    kinds = ("model.py", ".nbi", ".nbc", cache.HASH_LIST, ".txt")
    assert {next(kind for kind in kinds if name.endswith(kind)) for name in files_of(folder)} == set(kinds)
    for kind in kinds:
        (path,) = (path for name, path in files_of(folder).items() if name.endswith(kind))
        path.write_bytes(damage(path.read_bytes()))
        assert load()[0] == 2.0
        assert load() == (2.0, 0) and whole(folder), kind


def test_a_missing_a_further_and_an_exchanged_file_are_made_good(folder, load):
    load()
    (machine_code,) = (path for name, path in files_of(folder).items() if name.endswith(".nbc"))
    machine_code.unlink()
    assert load()[0] == 2.0 and whole(folder)
    (entry_of(folder) / "more.py").write_text(PLANTED)
    assert load()[0] == 2.0 and whole(folder) and "more.py" not in {p.name for p in entry_of(folder).iterdir()}
    source = entry_of(folder) / cache.SOURCE
    source.unlink()
    source.mkdir()
    assert load()[0] == 2.0 and whole(folder)
    entry = entry_of(folder)
    shutil.rmtree(entry)
    entry.write_text("a file")
    assert load()[0] == 2.0


@pytest.mark.parametrize("what", ["folder", "entry", "machine code", "a file", "pointer"])
def test_what_others_can_write_is_not_run(folder, load, what):
    load()
    files = files_of(folder)
    path = {
        "folder": folder,
        "entry": entry_of(folder),
        "machine code": entry_of(folder) / cache.MACHINE_CODE,
        "a file": entry_of(folder) / cache.SOURCE,
        "pointer": next(path for name, path in files.items() if name.endswith(".txt")),
    }[what]
    path.chmod(path.stat().st_mode | 0o022)
    before = {name: path.read_bytes() for name, path in files.items()}
    forget_warnings()
    with pytest.warns(ValidityWarning, match=r"compiled equations are not kept.*can be written by other users"):
        assert load() == (2.0, 1)
    assert {name: path.read_bytes() for name, path in files_of(folder).items()} == before


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can give files away")
def test_what_belongs_to_another_user_is_not_run(folder, load):
    load()
    os.chown(entry_of(folder) / cache.SOURCE, 12345, -1)
    with pytest.warns(ValidityWarning, match="belongs to another user"):
        assert load() == (2.0, 1)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full and /proc")
@pytest.mark.parametrize("place", ["/dev/null", "/dev/full", "/proc/nowhere"])
def test_where_nothing_can_be_kept_it_is_compiled_in_memory_and_told_once(load, monkeypatch, place):
    monkeypatch.setenv("VALVESIM_CACHE_DIR", place)
    with pytest.warns(ValidityWarning, match="compiled equations are not kept") as told:
        assert load() == (2.0, 1)
    assert len(told) == 1 and "Errno" not in str(told[0].message) and "VALVESIM_CACHE_DIR" in str(told[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ValidityWarning)
        assert load() == (2.0, 1)


def test_what_a_killed_process_left_half_filled_goes_after_an_hour(folder, load):
    load()
    old, new = folder / f"{cache.NEW}old", folder / f"{cache.NEW}new"
    for path in (old, new):
        path.mkdir()
        (path / cache.SOURCE).write_text("half")
    os.utime(old, (1.0, 1.0))
    (entry_of_model,) = (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(cache.NEW))
    shutil.rmtree(entry_of_model)
    assert load()[0] == 2.0 and not old.exists() and new.exists()


# ---------------------------------------------------------------- object files


@pytest.fixture
def load_object():
    """Loads an object file as a new process would; (what is in it, how often it was printed, how often compiled)."""

    def load_object(short_name=("b",)):
        printed, compiled = [], []

        def source():
            printed.append(SOURCE)
            return SOURCE

        def compile_it(text):
            compiled.append(text)
            return text.upper().encode()

        text, code = cache.load_object(short_name, source, [cache.load], compile_it)
        assert text == SOURCE and code == SOURCE.upper().encode()
        return len(printed), len(compiled)

    return load_object


def test_an_object_file_is_found_again_without_being_printed_or_compiled(folder, load_object):
    assert load_object() == (1, 1) and load_object() == (0, 0) and whole(folder)
    assert load_object(None) == (1, 0)  # a source that no name tells is printed every time, and compiled once
    assert {path.name for path in entry_of(folder).iterdir()} == {cache.SOURCE, cache.OBJECT, cache.HASH_LIST}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize("kind", [cache.SOURCE, cache.OBJECT, cache.HASH_LIST, ".txt"])
def test_a_damaged_object_file_is_made_anew(folder, load_object, damage, kind):
    load_object()
    (path,) = (path for name, path in files_of(folder).items() if name.endswith(kind))
    path.write_bytes(damage(path.read_bytes()))
    load_object()
    assert load_object() == (0, 0) and whole(folder)


def test_an_object_file_that_others_can_write_is_not_loaded(folder, load_object):
    load_object()
    path = entry_of(folder) / cache.OBJECT
    path.chmod(path.stat().st_mode | 0o022)
    forget_warnings()
    with pytest.warns(ValidityWarning, match=r"compiled equations are not kept.*can be written by other users"):
        assert load_object() == (1, 1)
