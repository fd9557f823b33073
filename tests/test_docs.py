"""Every block of the documentation runs as it stands, in its order: files written, commands run, Python executed."""

import re
import shlex
from pathlib import Path

import pytest

SITE = Path(__file__).resolve().parent.parent / "docs" / "site"
BLOCK = re.compile(r"(?:^<!-- file: (?P<file>\S+) -->\n)?^```(?P<kind>\w+)\n(?P<text>.*?)^```$", flags=re.M | re.S)
QUICK = ("tutorials/own_valve.md",)
FOREIGN = re.compile(r"\b(field|model|catalogue|performance|exchange)\.md|from memory|, memory[\"']")
PAGES = sorted(path.relative_to(SITE).as_posix() for path in SITE.rglob("*.md"))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in PAGES]
)
def test_every_block_of_a_page_runs_in_its_order(name, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (SITE / name).read_text(encoding="utf-8")
    names = {"__name__": name}
    for block in BLOCK.finditer(text):
        if block["kind"] == "toml":
            assert block["file"], "a file of a page says its name"
            (tmp_path / block["file"]).write_text(block["text"], encoding="utf-8")
        elif block["kind"] == "bash":
            for line in filter(None, block["text"].splitlines()):
                program, *words = shlex.split(line, comments=True)
                assert program == "valvesim"
                code, _, err = call(*words)
                assert code == 0, f"{line}: {err}"
        elif block["kind"] == "python":
            line = text.count("\n", 0, block.start("text"))
            exec(compile("\n" * line + block["text"], str(SITE / name), "exec"), names)  # noqa: S102 - its own line
        else:
            assert block["kind"] == "text"


def test_every_command_of_the_tables_is_one_and_its_options_are(call):
    """The commands in running text are not run, but each word of them is known."""
    from valvesim.cli.main import COMMAND_NAMES

    shown = re.findall(r"`valvesim ([^`]+)`", (SITE / "howto.md").read_text(encoding="utf-8"))
    assert len(shown) > 15
    for words in map(shlex.split, shown):
        assert words[0] in COMMAND_NAMES, words
        sub = words[:2] if words[0] == "export" else words[:1]
        _, told, _ = call(*sub, "--help")
        assert all(word in told for word in words if word.startswith("-") and not word[1:2].isdigit()), words


def test_the_pages_name_no_source_that_a_reader_cannot_have():
    """Sources are publications: no file of another folder, and nobody's memory."""
    package = SITE.parents[1] / "valvesim"
    for path in (*package.rglob("*.py"), *package.rglob("*.toml"), *SITE.rglob("*.md")):
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not re.search(FOREIGN, line), (
                f"{path.relative_to(package.parent)}:{number}: {line.strip()}"
            )
