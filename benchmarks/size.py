"""How large the package is and how it hangs together: `python benchmarks/size.py [COMMIT ...]`, else the checkout.

Lines with anything on them, modules, floors (the longest chain of imports between modules, those inside functions not
counted), imports between modules, and the longest functions.
"""

import ast
import functools
import io
import subprocess
import sys
import tarfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def sources(commit: str) -> dict[str, str]:
    """The text of every module of the package by its dotted name."""
    if commit:
        data = subprocess.run(["git", "archive", commit, "valvesim"], cwd=ROOT, capture_output=True, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(data)) as archive:
            texts = {m.name: archive.extractfile(m).read().decode() for m in archive if m.name.endswith(".py")}
    else:
        texts = {str(p.relative_to(ROOT)): p.read_text(encoding="utf-8") for p in (ROOT / "valvesim").rglob("*.py")}
    return {name[:-3].replace("/", ".").removesuffix(".__init__"): text for name, text in texts.items()}


def imported(name: str, tree: ast.Module, modules: set[str]) -> set[str]:
    """The package's modules that the module of that name imports as it is loaded."""
    found, nodes = set(), [tree]
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.ImportFrom):
            above = name.rsplit(".", node.level)[0] + "." if node.level else ""
            source = (above + (node.module or "")).rstrip(".")
            found |= {f"{source}.{alias.name}" for alias in node.names} | {source}
        typing_alone = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not typing_alone and not isinstance(node, (ast.FunctionDef, ast.Lambda)):
            nodes += ast.iter_child_nodes(node)
    return found & modules - {"valvesim"}


def measure(commit: str) -> list[str]:
    texts = sources(commit)
    trees = {name: ast.parse(text) for name, text in texts.items()}
    imports = {name: imported(name, tree, set(texts)) - {name} for name, tree in trees.items()}

    @functools.cache
    def floor(name: str) -> int:
        return 1 + max((floor(below) for below in imports[name]), default=0)

    functions = sorted(
        ((node.end_lineno - node.lineno + 1, f"{name}.{node.name}") for name, tree in trees.items()
         for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)), reverse=True,
    )  # fmt: skip
    lines = sum(bool(line.strip()) for text in texts.values() for line in text.splitlines())
    modules = {name for name, text in texts.items() if text.strip()}
    longest = max(text.count("\n") for text in texts.values())
    tops = ", ".join(f"{name.removeprefix('valvesim.')} {length}" for length, name in functions[:3])
    count = sum(map(len, imports.values()))
    cells = [commit or "checkout", lines, len(modules), longest, max(map(floor, texts)), count, len(functions), tops]
    return [str(cell) for cell in cells]


if __name__ == "__main__":
    heading = ["commit", "lines", "modules", "longest module", "floors", "imports", "functions", "longest functions"]
    for row in (heading, ["-"] * len(heading), *(measure(commit) for commit in sys.argv[1:] or [""])):
        print("| " + " | ".join(row) + " |")
