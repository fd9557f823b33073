"""Packages import one way, and nothing heavy is loaded before it is needed."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import valvesim
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION
from valvesim.cli.main import COMMAND_NAMES
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES
from valvesim.options import option_table
from valvesim.planning.options import DEFAULT_PLANNING
from valvesim.units import parse
from valvesim.valve.catalogue import CATALOGUE

PACKAGE = Path(valvesim.__file__).parent
MODULES = sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))
HEAVY = {"matplotlib", "control", "xarray", "casadi", "pint", "numba", "netCDF4"}


def imported(module, *, lazy=True):
    """Top names of what a module imports; without `lazy` of what it imports on loading."""
    nodes = [ast.parse((PACKAGE / module).read_text(encoding="utf-8"))]
    names = set()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.ImportFrom):
            names.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        if lazy or not isinstance(node, (ast.FunctionDef, ast.Lambda)):
            nodes += ast.iter_child_nodes(node)
    return names


def test_packages_import_one_way():
    """The contract stands in pyproject.toml, under [tool.importlinter]."""
    pytest.importorskip("importlinter", reason="import-linter is not installed")
    found = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()", "--no-cache"],
        capture_output=True, text=True, cwd=PACKAGE.parent,
    )  # fmt: skip
    assert found.returncode == 0, found.stdout
    assert "2 kept, 0 broken" in found.stdout


def test_the_contract_names_every_package_and_module_of_the_top():
    contract = (PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8").partition("[tool.importlinter]")[2]
    for path in PACKAGE.iterdir():
        if path.suffix == ".py" and path.stem != "__init__" or (path / "__init__.py").exists():
            assert f"valvesim.{path.stem}" in contract, path.stem


def test_only_the_valve_knows_how_many_states_it_has_and_what_drives_it():
    counted = re.compile(r"states?\[:?\d|\[:6\]|\[6:|isinstance\([^)]*[dD]rive|type\([a-z.]*model\.drive\)")
    found = {
        module
        for module in MODULES
        if not module.startswith("valve/") and counted.search((PACKAGE / module).read_text(encoding="utf-8"))
    }
    assert found <= {"solver/codegen.py"}


def test_only_reports_import_matplotlib():
    found = {module for module in MODULES if "matplotlib" in imported(module)}
    assert found and all(module.startswith("reports/") for module in found)


@pytest.mark.parametrize("module", [module for module in MODULES if not module.startswith("reports/")])
def test_a_module_loads_no_heavy_library(module):
    assert not imported(module, lazy=False) & HEAVY


@pytest.mark.parametrize(
    "library, module", [("casadi", "solver/codegen.py"), ("pint", "units.py"), ("xarray", "simulation/result.py")]
)
def test_a_heavy_library_is_imported_where_it_is_needed(library, module):
    assert library in imported(module)  # so that the tests above see imports inside functions


def loaded(code):
    """The modules that a new process has loaded after some code."""
    words = [sys.executable, "-c", f"{code}; import sys; print('loaded:', *sorted(sys.modules))"]
    shown = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    return set(shown.rpartition("loaded:")[2].split())


def test_importing_all_names_of_the_package_loads_no_heavy_library():
    names = loaded("from valvesim import *")
    assert "valvesim.simulation.run" in names and not names & HEAVY


def test_help_loads_every_command_and_no_library_of_numbers():
    code = "from valvesim.cli.main import cli; cli.main(['--help'], standalone_mode=False)"
    names = loaded(code)
    assert {f"valvesim.cli.{name}" for name in COMMAND_NAMES} <= names
    assert not names & {*HEAVY, "numpy", "scipy", "rich"}


def test_a_command_is_loaded_without_the_others():
    names = loaded("from valvesim.cli.main import cli; cli.main(['effects'], standalone_mode=False)")
    assert {name for name in COMMAND_NAMES if f"valvesim.cli.{name}" in names} == {"effects"}


def test_every_name_of_the_package_is_there_and_no_other():
    assert all(getattr(valvesim, name) is not None for name in valvesim.__all__)
    assert set(valvesim.__all__) <= set(dir(valvesim))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = valvesim.nonsense


def test_the_table_of_modules_in_the_documents_names_each_of_them():
    text = (PACKAGE.parent / "docs" / "design.md").read_text(encoding="utf-8")
    named = [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")]
    assert sorted(named) == [module[:-3] for module in MODULES if not module.endswith("__init__.py")]


NAMES_OF_SEVERAL = {
    "P": "a type variable",
    "F": "a type variable",
    "Table": "a command, by its public name, and what a page shows",
    "integrate": "the method of `rodas5p`, and its driver, which calls what `codegen` prints of it",
}


def test_a_name_of_a_module_stands_for_one_thing():
    """Private names aside, and the functions of `valvesim.cli` that carry the name of their command."""
    places = {}
    for module in MODULES:
        for node in ast.parse((PACKAGE / module).read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            found = {one.id for target in targets if target for one in ast.walk(target) if isinstance(one, ast.Name)}
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                found = {node.name}
            for name in found:
                if not name.startswith("_") and module != f"cli/{name}.py":
                    places.setdefault(name, set()).add(module)
    assert {name for name, where in places.items() if len(where) > 1} == set(NAMES_OF_SEVERAL)


BARE = {  # numbers that no judgement sets
    ("diagnosis/power.py", "NINE_IN_TEN"): "a quantile of the normal distribution",
    ("diagnosis/power.py", "NINETEEN_IN_TWENTY"): "a quantile of the normal distribution",
    ("identification/between_samples.py", "EDGE"): "how a jump is written as points, in every stored deviation alike",
    ("identification/between_samples.py", "CUBICS"): "how a smooth command is written as pieces, likewise",
    ("identification/tangent_linear.py", "DIVERGED"): "where squares overflow",
    ("identification/from_figures/similarity.py", "ANCHOR_STIFFNESS"): "a dimension of the anchor, as published",
    ("identification/from_figures/similarity.py", "ANCHOR_STROKE"): "a dimension of the anchor",
    ("characterisation/acceptance/flow.py", "LINE"): "what the flow gain is",
    ("characterisation/acceptance/flow_load.py", "RATED_DROP"): "what rated flow is",
    ("characterisation/acceptance/metrics.py", "BLOCKS"): "what the uncertainty of every figure is",
    ("characterisation/acceptance/metrics.py", "NULL_SHARE"): "what the pressure gain is",
    ("characterisation/acceptance/null_shift.py", "TEMPERATURE_DIFFERENCE"): "a condition, unless another is given",
    ("characterisation/acceptance/null_shift.py", "PRESSURE_CHANGE"): "what the null shift is",
    ("characterisation/dither.py", "SAMPLES"): "below which harmonics count",
    ("characterisation/frequency_response.py", "SETTLE_TIME"): "an argument, unless another is given",
    ("characterisation/response_set.py", "STEP_AMPLITUDES"): "an argument, unless others are given",
    ("characterisation/response_set.py", "SINE_AMPLITUDES"): "an argument, unless others are given",
    ("characterisation/rest_characteristic.py", "POINTS"): "points of a picture",
    ("characterisation/sine_point.py", "HARMONICS"): "what the distortion is",
    ("characterisation/sine_point.py", "FEWEST_A_CYCLE"): "samples that tell a sine from its offset and drift",
    ("characterisation/specification.py", "COVERAGE"): "of ISO 14253-1",
    ("identification/least_squares.py", "SINGULAR"): "what rounding leaves of a matrix that is singular",
    ("characterisation/thermal_drift.py", "LEAST_MOTION"): "a share of a channel's scale, against a division by zero",
}


def test_thresholds_of_what_judges_are_options():
    found = set()
    for module in MODULES:
        if module.startswith(("planning/", "diagnosis/", "identification/", "characterisation/")):
            for node in ast.parse((PACKAGE / module).read_text(encoding="utf-8")).body:
                parts = list(ast.walk(node.value)) if isinstance(node, ast.Assign) else []
                if any(isinstance(getattr(one, "value", None), int | float) for one in parts) and not any(
                    isinstance(one, ast.Call | ast.Dict) for one in parts
                ):
                    names = (one for target in node.targets for one in ast.walk(target))
                    found |= {(module, one.id) for one in names if isinstance(one, ast.Name)}
    assert found == set(BARE)


def test_every_option_has_a_unit_a_meaning_and_a_source():
    every = (DEFAULT_PLANNING, DEFAULT_FROM_FIGURES, DEFAULT_CHARACTERISATION)
    rows = [row for options in every for row in option_table(options)]
    assert len(rows) > 200 and len({name for name, *_ in rows}) == len(rows)
    assert {"diagnosis.identification.fit.steps", "choice.power", "posterior.step"} <= {name for name, *_ in rows}
    for name, value, unit, doc, source in rows:
        assert doc and source and (unit == "byte" or parse(f"{1.0} {unit}", unit, name) == 1.0), name
        assert all(isinstance(one, int | float) for one in (value if isinstance(value, tuple) else (value,))), name


NAMED_EFFECTS = {"cli/export.py": "the help gives an example of a name"}


def test_only_the_catalogue_names_its_effects():
    """Docstrings may: they show what a file may say. Elsewhere an effect is an object, or what its entry declares."""
    named = re.compile(rf"\b({'|'.join(CATALOGUE)})\b")
    found = set()
    for module in MODULES:
        if module.startswith("valve/effects/"):
            continue
        tree = ast.parse((PACKAGE / module).read_text(encoding="utf-8"))
        shown = [node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)]
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in shown:
                if named.search(node.value):
                    found.add(module)
    assert found == set(NAMED_EFFECTS)
