"""The one-way order of the modules, read from their imports."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import valvesim

PACKAGE = Path(valvesim.__file__).parent
PICTURES = ("report", "report_response", "report_bench", "report_paper", "report_datasheet", "report_diagnosis")
ORDER = (
    "errors", "units", "figures", "channels", "laws", "fluid", "parameters", "flow_laws", "effects", "catalogue",
    "model", "static", "reproduce", "files", "commands", "thermal", "rosenbrock", "compiled", "user_effects",
    "scenario", "simulate", "drift", "response", "bench", "linear", "datasheet", "session", "prediction", "sensitivity",
    "noise", "evidence", "hypotheses", "study", "terms", "extension", "scene", "answer", "recovery", "next_test",
    "weighing", "search", "beginnings", "diagnosis", *PICTURES, "cli",
)  # fmt: skip
HEAVY = {"matplotlib", "control", "xarray", "casadi", "pint", "numba", "netCDF4"}


def imports(module, *, lazy=True):
    """(modules of the package, top names of others) that a module imports; without `lazy` those on loading alone."""
    tree = ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))
    nodes = [tree]
    own, others = set(), set()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.ImportFrom):
            names = [node.module] if node.module else [alias.name for alias in node.names]
            (own if node.level else others).update(name.split(".")[0] for name in names)
        elif isinstance(node, ast.Import):
            others.update(alias.name.split(".")[0] for alias in node.names)
        if lazy or not isinstance(node, (ast.FunctionDef, ast.Lambda)):
            nodes += ast.iter_child_nodes(node)
    return own, others


def test_the_order_names_every_module():
    assert sorted(ORDER) == sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")


@pytest.mark.parametrize("module", ORDER)
def test_a_module_imports_only_modules_before_it(module):
    own, others = imports(module)
    assert own <= set(ORDER[: ORDER.index(module)])
    assert "valvesim" not in others  # always relative, so that the order above sees it


def test_the_package_itself_imports_neither_pictures_nor_command_line():
    own, others = imports("__init__")
    assert own <= set(ORDER) - {*PICTURES, "cli"} and not others


def test_only_the_modules_of_pictures_import_matplotlib():
    found = {module for module in ORDER if "matplotlib" in imports(module)[1]}
    assert "report" in found and found <= set(PICTURES)


@pytest.mark.parametrize("module", [module for module in ORDER if module not in PICTURES])
def test_a_module_loads_no_heavy_library(module):
    assert not imports(module, lazy=False)[1] & HEAVY


@pytest.mark.parametrize("library, module", [("casadi", "compiled"), ("pint", "units"), ("xarray", "simulate")])
def test_a_heavy_library_is_imported_where_it_is_needed(library, module):
    assert library in imports(module)[1]  # so that the tests above see imports inside functions


def test_importing_the_package_loads_no_heavy_library():
    code = "import sys, valvesim, valvesim.cli; print(*sorted(sys.modules))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "valvesim.simulate" in shown.split() and not HEAVY & set(shown.split())


def test_the_table_of_modules_in_the_documents_has_the_same_order():
    text = (PACKAGE.parent / "docs" / "design.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    named = [name for cell in cells for name in re.findall("`(\\w+)`", cell)]
    assert named == [name for name in ORDER if name not in PICTURES[1:]]
