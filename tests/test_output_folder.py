"""Results appear together or not at all, and nothing that a command did not write is lost."""

import json
import os
from pathlib import Path

import click
import pytest

from valvesim.cli import main as cli
from valvesim.cli.options import output_option
from valvesim.cli.output_folder import MANIFEST, all_or_nothing
from valvesim.errors import InputError


@click.command()
@output_option("results/own")
@click.option("--file", "files", multiple=True)
@click.option("--fails", is_flag=True)
def own(output: Path, files: tuple[str, ...], fails: bool) -> None:
    """Writes files that hold their own names."""
    with all_or_nothing(output) as folder:
        for name in files:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(name)
        if fails:
            raise InputError("fails")


@pytest.fixture
def write(tmp_path):
    """`own` with files into out/: what it says where it is refused."""

    def write(*files, options=(), folder="out", name="own"):
        words = ["-o", str(tmp_path / folder), *(f"--file={file}" for file in files), *options]
        try:
            own.main(words, prog_name=name, standalone_mode=False)
        except InputError as error:
            return str(error).replace(f"{tmp_path}/", "")

    return write


def texts(folder):
    """Every file below a folder but the manifest, with its text."""
    paths = (path for path in Path(folder).rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(folder).as_posix(): path.read_text() for path in paths}


def test_results_appear_with_a_manifest_and_nothing_else(write, tmp_path):
    assert write("a", "deep/b") is None
    assert texts(tmp_path / "out") == {"a": "a", "deep/b": "deep/b"}
    assert list(json.loads((tmp_path / "out" / MANIFEST).read_text())["commands"]["own"]) == ["a", "deep/b"]
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o777 & ~_umask()


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize("folder", ["out", "new/deep/out"])
def test_nothing_is_left_where_a_command_fails(write, tmp_path, folder):
    assert write("a", options=["--fails"], folder=folder) == "fails"
    assert os.listdir(tmp_path) == []


def test_earlier_results_stay_whole_where_a_command_fails(write, tmp_path):
    write("a", "b")
    before = texts(tmp_path / "out")
    assert write("b", "c", options=["--fails"]) == "fails"
    assert texts(tmp_path / "out") == before and len(os.listdir(tmp_path / "out")) == 3


def test_the_same_command_replaces_its_results_and_no_others(write, tmp_path):
    write("a", "b")
    write("x", name="other")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    assert write("b", "c") is None
    assert texts(tmp_path / "out") == {"b": "b", "c": "c", "x": "x", "notes.txt": "mine"}


def test_a_folder_of_somebody_elses_files_is_refused_unless_said(write, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a").write_text("mine")
    (tmp_path / "out" / "b").write_text("mine")
    assert write("a").startswith("out: holds files that no command of valvesim wrote (manifest.json is not there")
    assert write("a", options=["--overwrite"]) is None
    assert texts(tmp_path / "out") == {"a": "a", "b": "mine"}


def test_a_result_that_was_edited_is_kept_unless_said(write, tmp_path):
    write("a", "b")
    (tmp_path / "out" / "a").write_text("edited")
    assert write("a") == "out: a was changed since valvesim own wrote it; move it away, or give --overwrite"
    assert texts(tmp_path / "out") == {"a": "edited", "b": "b"}
    assert write("a", options=["--overwrite"]) is None and texts(tmp_path / "out") == {"a": "a"}


def test_a_file_of_somebody_else_where_a_result_is_to_stand_is_kept(write, tmp_path):
    write("a")
    (tmp_path / "out" / "b").write_text("mine")
    assert write("a", "b").startswith("out: holds b, which valvesim own did not write; name another folder")
    assert texts(tmp_path / "out") == {"a": "a", "b": "mine"}


@pytest.mark.parametrize(
    "manifest",
    ["", "{", "[]", '{"commands": 1}', '{"commands": {"own": {"../kept": "0"}}}', '{"commands": {"own": {"/k": "0"}}}',
     '{"commands": {"own": {"a": 1}}}', '{"commands": {"own": ["a"]}}', "[" * 100_000],
)  # fmt: skip
def test_a_manifest_that_is_none_protects_and_removes_nothing(write, tmp_path, manifest):
    (tmp_path / "kept").write_text("kept")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / MANIFEST).write_text(manifest)
    assert "is not there or not whole" in write("a")
    assert write("a", options=["--overwrite"]) is None and (tmp_path / "kept").read_text() == "kept"


def test_hidden_files_and_an_empty_folder_are_no_obstacle(write, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".gitkeep").write_text("")
    assert write("a") is None and texts(tmp_path / "out") == {"a": "a", ".gitkeep": ""}


def test_every_command_that_writes_a_folder_writes_over_nothing(tmp_path, monkeypatch):
    (tmp_path / "mine").write_text("mine")
    words = {"run": ["case.toml"], "diagnose": ["session"]}
    folder_commands = []
    for name in cli.COMMAND_NAMES:
        command = cli.cli.get_command(None, name)
        if any("--overwrite" in option.opts for option in command.params):
            folder_commands.append(name)
    assert set(folder_commands) >= {"bench", "datasheet", "diagnose", "reproduce", "response", "run"}
    (tmp_path / "case.toml").write_text('duration = "1 ms"\n[command]\ncurrent = "1 mA"\n')
    monkeypatch.chdir(tmp_path)
    for name in ("bench", "datasheet", "diagnose", "reproduce", "response", "run"):
        with pytest.raises(InputError, match="holds files that no command of valvesim wrote"):
            cli.cli.main([name, *words.get(name, []), "-o", "."], standalone_mode=False)
    assert sorted(os.listdir(tmp_path)) == ["case.toml", "mine"]
