"""A study file: what varies about a scenario or a position loop, how members are drawn, what is kept, and its limits.

    title = "Drift in a launch"
    scenario = "launch_shock.toml"                # or a table: [scenario] file = "...", and what is different of it
    specification = "acceptance.toml"
    [design]
    kind = "latin_hypercube"                      # random, sobol, saltelli (base_samples), table (table = "draws.csv")
    members = 1000
    seed = 1
    [vary]                                        # by default the tolerances of all quantities of the valve
    tolerances = true
    "valve.null_gap" = { tolerance = "3 %" }
    "thermal.oil_temperature.ramp.rate" = { distribution = "uniform", lowest = "2 degC/s", highest = "4 degC/s" }
    "oil" = { values = ["mil_prf_5606", "mil_prf_83282"], weights = [3, 1] }
    [[correlations]]
    between = ["valve.null_gap", "valve.nozzle_diameter"]
    value = 0.5
    [figures]
    keep = ["run.spool_position.end", "drift.*", "bench.flow.hysteresis"]
    [limits]
    "run.spool_position.end" = { low = "0.1 mm" }
    [percentiles]
    channels = ["spool_position"]

A `[loop]` makes a position loop of the scenario (`position_loop`), `[whole]` keeps the runs of a few members.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.characterisation.position_loop import PositionLoop, scheduled_for
from valvesim.characterisation.specification import load_specification
from valvesim.errors import InputError, unknown_name
from valvesim.io import (
    check_known,
    check_tables,
    located,
    read_columns,
    read_names,
    read_toml,
    split_heading,
)
from valvesim.simulation.command_toml import read_command, read_switch
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.scenario_toml import ScenarioReader, override
from valvesim.studies.criteria import FigureLimit, figures_for
from valvesim.studies.designs import MOST_MEMBERS, Correlation, Design
from valvesim.studies.distributions import Distribution, OptionChoice, tolerance_distribution
from valvesim.studies.figures import OwnFigures
from valvesim.studies.parameter_study import ChannelPercentiles, FigureOptions, ParameterStudy, WholeChannels
from valvesim.studies.variables import (
    Case,
    Quantity,
    Varied,
    choice_unit,
    find_quantity,
    tolerated,
    variable_of,
)
from valvesim.units import change, parse, parse_list
from valvesim.valve.effect_trust import check_trusted, code_of
from valvesim.valve.permission import permitting
from valvesim.valve.valve_file import ValveFile
from valvesim.valve.valve_toml import read_oil_table

_TABLES = ("design", "vary", "figures", "limits", "percentiles", "whole", "loop")
_DISTRIBUTION = (
    "tolerance", "distribution", "mean", "deviation", "location", "scale", "parameters", "lowest", "highest", "values",
    "weights",
)  # fmt: skip
SCHEDULE = np.arange(20.0, 271.0, 25.0)  # °C, of the controller's gain where a loop says no other


def load_study(
    path: str | Path, *, settings: Sequence[str] = (), trust: bool = False, outside: bool = False
) -> ParameterStudy:
    """Read a study file; `settings` such as `design.members=100` override or add keys.

    With `trust` the Python files that it names are run, with `outside` also those outside its folder
    (`valve/effect_trust`).

    Raises InputError (file, line, key) for anything that makes no sense.
    """
    path = Path(path)
    text, table = read_toml(path, "a study is a TOML file with a scenario")
    if isinstance(table.get("scenario"), str):
        table["scenario"] = {"file": table["scenario"]}
    for setting in settings:
        override(table, setting)
    allowed = permitting(trust=trust, outside=outside)
    with located(path, text, document="study", settings=settings), allowed:
        return read_study(table, path.parent)


def read_study(table: dict[str, Any], folder: Path) -> ParameterStudy:
    """The study of a file's table; file names start at `folder`."""
    check_known(table, ("title", "scenario", "specification", "block", "correlations", *_TABLES), "study")
    check_tables(table, _TABLES)
    scenario, valve = _scenario(table.get("scenario"), folder)
    case: Case = scenario if "loop" not in table else _loop(table["loop"], scenario, folder)
    specification = None
    if "specification" in table:
        specification = load_specification(folder / _text(table["specification"], "specification"))
    design_table, figures = table.get("design", {}), table.get("figures", {})
    check_known(figures, ("keep", "start", "bench_temperature", "bench_points", "functions"), "figures")
    keep = read_names(figures.get("keep", []), "figures.keep", "figure")
    options = _options(figures, folder)
    if specification is not None:
        keep = tuple(dict.fromkeys((*keep, *figures_for(specification))))
        if "bench_temperature" not in figures and "oil_temperature" in specification.conditions:
            options = replace(options, bench_temperature=specification.conditions["oil_temperature"])
    if design_table.get("kind") == "table":
        variables, design = _table_design(design_table, case, folder)
    else:
        variables = _variables(table.get("vary", {"tolerances": True}), case, valve, folder)
        correlations = _correlations(table.get("correlations", []), variables, valve)
        design = _design(design_table, correlations)
    return ParameterStudy(
        title=table.get("title", "study"), case=case, variables=variables, design=design, keep=keep, options=options,
        percentiles=_percentiles(table.get("percentiles")), whole=_whole(table.get("whole")),
        block=_whole_number(table["block"], "block", MOST_MEMBERS) if "block" in table else None,
        limits=_limits(table.get("limits", {})), specification=specification,
    )  # fmt: skip


# ---------------------------------------------------------------- base case


def _scenario(given: Any, folder: Path) -> tuple[Scenario, ValveFile]:
    """The base scenario, and its valve with the tolerances of its own file."""
    entry = {"file": given} if isinstance(given, str) else given
    if not isinstance(entry, dict):
        raise InputError("is missing: the name of a scenario file, or a table that is one", key="scenario", joint=" ")
    table = {key: value for key, value in entry.items() if key != "file"}
    if "file" in entry:
        path = folder / _text(entry["file"], "scenario.file")
        text, own = read_toml(path, "the study's scenario")
        table = _merged(own, table)
        folder = path.parent
        with located(path, text, document="scenario"):
            return ScenarioReader(folder).scenario(table), ScenarioReader(folder).valve(table)
    try:
        return ScenarioReader(folder).scenario(table), ScenarioReader(folder).valve(table)
    except InputError as error:
        raise error.moved("", "scenario") from None


def _merged(base: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Tables of which the second overrides single keys of the first."""
    out = dict(base)
    for key, value in other.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = _merged(out[key], value) if both else value
    return out


def _loop(table: Mapping[str, Any], scenario: Scenario, folder: Path) -> PositionLoop:
    """The position loop of a table, its controller scheduled for the nominal valve."""
    figures = {key: value for key, value in table.items() if key not in ("reference", "schedule", "schedule_current")}
    options: dict[str, Any] = {}
    if "reference" in table:
        where = "loop.reference"
        options["reference"] = read_command(table["reference"], "m", where, column="reference", folder=folder)
    at = SCHEDULE
    if "schedule" in table:
        at = parse_list(_text(table["schedule"], "loop.schedule"), "degC", "loop.schedule")
    current = parse(table.get("schedule_current", "2 mA"), "A", "loop.schedule_current")
    rows = scheduled_for(scenario.valve, at.tolist(), current=current, oil=scenario.oil)
    try:
        loop = PositionLoop(scenario=scenario, schedule=rows, **options)
        return change(loop, figures, "loop")
    except InputError as error:
        raise error.moved("positionloop", "loop") from None


# ---------------------------------------------------------------- what varies


def _variables(table: Mapping[str, Any], case: Case, valve: ValveFile, folder: Path) -> tuple[Varied, ...]:
    """All that varies; a quantity of its own takes the place of its tolerance."""
    entries = dict(table)
    variables: dict[str, Varied] = {}
    if read_switch(entries.pop("tolerances", not entries), "vary.tolerances"):
        variables = {variable.key: variable for variable in tolerated(case, valve.tolerances)}
    for key, entry in _flat(entries):
        variables[key] = _variable(key, entry, case, valve, folder)
    return tuple(variables.values())


def _flat(table: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """(key, entry) of a table by dotted keys, written in quotes or as tables within tables."""
    out = []
    for name, value in table.items():
        key = f"{prefix}.{name}" if prefix else name
        inner = isinstance(value, dict) and value and not set(value) & set(_DISTRIBUTION)
        out += _flat(value, key) if inner else [(key, value)]
    return out


def _variable(key: str, entry: Any, case: Case, valve: ValveFile, folder: Path) -> Varied:
    where = f"vary.{key}"
    if not isinstance(entry, dict):
        raise InputError(f"expected a table such as {{ tolerance = '2 %' }}, got {entry!r}", key=where)
    check_known(entry, _DISTRIBUTION, where)
    if "values" in entry:
        return _choice(key, entry, case, folder)
    quantity = find_quantity(case, key)
    own = valve.tolerances.get(key.partition(".")[2]) if key.startswith("valve.") else None
    if not entry:
        return variable_of(quantity, own)
    if "tolerance" in entry:
        check_known(entry, ("tolerance",), where)
        width = _width(entry["tolerance"], quantity, f"{where}.tolerance")
        return Varied(quantity, tolerance_distribution(quantity.nominal, width, quantity.bounds))
    try:
        return Varied(quantity, _distribution(entry, quantity, where))
    except InputError as error:
        raise (error if error.key.startswith("vary.") else error.moved("", where)) from None


def _width(text: Any, quantity: Quantity, where: str) -> float:
    """A tolerance in the quantity's unit: a share of the nominal value in %, or a difference."""
    if isinstance(text, str) and text.rstrip().endswith("%") and quantity.unit not in ("1", "%"):
        width = parse(text, "1", where) * abs(quantity.nominal)
    else:
        width = parse(text, _difference(quantity.unit), where)
    if not width > 0.0:
        raise InputError(f"{text!r} must be positive", key=where)
    return width


def _difference(unit: str) -> str:
    return "delta_degC" if unit == "degC" else unit


def _distribution(entry: Mapping[str, Any], quantity: Quantity, where: str) -> Distribution:
    """A distribution of scipy.stats: "normal" by mean and deviation, "uniform" by its ends, others by all."""
    name = _text(entry.get("distribution", "normal"), f"{where}.distribution")
    unit = quantity.unit

    def read(key: str, unit: str, default: float) -> float:
        return parse(entry[key], unit, f"{where}.{key}") if key in entry else default

    low, high = read("lowest", unit, -np.inf), read("highest", unit, np.inf)
    if name == "uniform":
        check_known(entry, ("distribution", "lowest", "highest"), where)
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError("a uniform distribution has a lowest and a highest value", key=where)
        return Distribution("uniform", low, high - low, lowest=low, highest=high)
    shapes = entry.get("parameters", {})
    if not isinstance(shapes, dict):
        raise InputError(f"expected a table of shape parameters, got {shapes!r}", key=f"{where}.parameters")
    figures = tuple((key, parse(value, "1", f"{where}.parameters.{key}")) for key, value in shapes.items())
    if name in ("normal", "norm"):
        check_known(entry, ("distribution", "mean", "deviation", "lowest", "highest"), where)
        if "deviation" not in entry:
            raise InputError("a normal distribution has a deviation", key=where)
        scale = read("deviation", _difference(unit), 0.0)
        return Distribution("norm", read("mean", unit, quantity.nominal), scale, lowest=low, highest=high)
    check_known(entry, ("distribution", "location", "scale", "parameters", "lowest", "highest"), where)
    if "scale" not in entry:
        raise InputError(f"{name} needs a scale", key=where)
    location, scale = read("location", unit, 0.0), read("scale", _difference(unit), 1.0)
    return Distribution(name, location, scale, figures, low, high)


def _choice(key: str, entry: Mapping[str, Any], case: Case, folder: Path) -> Varied:
    """One of several oils, commands, or values of a quantity."""
    where = f"vary.{key}"
    check_known(entry, ("values", "weights"), where)
    given, weights = entry["values"], entry.get("weights")
    if not isinstance(given, list) or not given:
        raise InputError(f"expected a list, got {given!r}", key=f"{where}.values")
    options = tuple(_option(key, one, case, f"{where}.values.{k}", folder) for k, one in enumerate(given, start=1))
    names = tuple(one if isinstance(one, str) else f"number {k}" for k, one in enumerate(given, start=1))
    shares = [1.0] * len(given) if weights is None else weights
    if not isinstance(shares, list) or not all(isinstance(w, (int, float)) for w in shares):
        raise InputError(f"expected a list of numbers, got {weights!r}", key=f"{where}.weights")
    try:
        choice = OptionChoice(options, names, tuple(map(float, shares)))
    except InputError as error:
        raise error.moved("", where) from None
    return Varied(Quantity(key, "1", f"choice of {key}", np.nan, (0.0, len(given) - 1.0)), choice)


def _option(key: str, given: Any, case: Case, where: str, folder: Path) -> Any:
    if key == "oil":
        if not isinstance(given, (str, dict)):
            raise InputError(f"expected the name of an oil, or its table, got {given!r}", key=where)
        try:
            return read_oil_table({"name": given} if isinstance(given, str) else given, folder)
        except InputError as error:
            raise error.moved("oil", where) from None
    section = key.partition(".")[0]
    whole = section in ("pressures", "command") or key.startswith("thermal.oil_temperature")
    if whole and key.count(".") == 1:
        unit, column = choice_unit(case, key)
        return read_command(given, unit, where, column=column, folder=folder)
    return parse(given, find_quantity(case, key).unit, where)


def _correlations(given: Any, variables: Sequence[Varied], valve: ValveFile) -> tuple[Correlation, ...]:
    """Those of the valve's file between quantities that vary, and the study's own."""
    keys = [variable.key for variable in variables]
    found = {}
    for (one, other), value in valve.correlations.items():
        if f"valve.{one}" in keys and f"valve.{other}" in keys:
            found[frozenset((one, other))] = Correlation(f"valve.{one}", f"valve.{other}", value)
    if not isinstance(given, list):
        raise InputError(f"expected a list of tables, got {given!r}", key="correlations")
    for k, entry in enumerate(given, start=1):
        where = f"correlations.{k}"
        if not isinstance(entry, dict):
            raise InputError(f"expected a table, got {entry!r}", key=where)
        check_known(entry, ("between", "value"), where)
        pair = read_names(entry.get("between", []), f"{where}.between", "quantity")
        if len(pair) != 2:
            raise InputError(f"{len(pair)} names; a correlation is between two", key=f"{where}.between")
        for name in pair:
            if name not in keys:
                raise unknown_name("quantity that varies", name, keys, f"{where}.between")
        value = parse(entry.get("value"), "1", f"{where}.value")
        found[frozenset(name.partition(".")[2] for name in pair)] = Correlation(*pair, value)
    return tuple(found.values())


# ---------------------------------------------------------------- design, figures and the rest


def _design(table: Mapping[str, Any], correlations: tuple[Correlation, ...]) -> Design:
    check_known(table, ("kind", "members", "base_samples", "seed"), "design")
    kind = _text(table.get("kind", "latin_hypercube"), "design.kind")
    size = "base_samples" if kind == "saltelli" else "members"
    other = "members" if kind == "saltelli" else "base_samples"
    if other in table:
        raise InputError(f"a design {kind!r} has {size}", key=f"design.{other}")
    members = _whole_number(table.get(size, 1024 if kind == "saltelli" else 1000), f"design.{size}", MOST_MEMBERS)
    seed = _whole_number(table.get("seed", 1), "design.seed", 2**62, least=0)
    return Design(kind=kind, members=members, seed=seed, correlations=correlations)


def _table_design(table: Mapping[str, Any], case: Case, folder: Path) -> tuple[tuple[Varied, ...], Design]:
    """A table of one's own: a CSV file with a column `key [unit]` for each quantity, a row a member."""
    check_known(table, ("kind", "table"), "design")
    path = folder / _text(table.get("table"), "design.table")
    try:
        with open(path, encoding="utf-8-sig") as file:
            headings = [split_heading(text) for text in file.readline().split(",")]
        quantities = [find_quantity(case, heading[0]) for heading in headings if heading is not None]
        columns = read_columns(path, {quantity.key: quantity.unit for quantity in quantities})
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})", key="design.table") from None
    except InputError as error:
        raise InputError(str(error), key="design.table") from None
    if not quantities:
        raise InputError(f"{path}: no column 'key [unit]', such as 'valve.null_gap [mm]'", key="design.table")
    rows = np.column_stack([columns[quantity.key] for quantity in quantities])
    variables = []
    for k, quantity in enumerate(quantities):
        low, high = float(np.min(rows[:, k])), float(np.max(rows[:, k]))
        try:
            width = max(high - low, 1e-12 * abs(low) + 1e-300)
            variables.append(Varied(quantity, Distribution("uniform", low, width, highest=high)))
        except InputError as error:
            raise InputError(f"{path}: {error}", key="design.table") from None
    return tuple(variables), Design(kind="table", members=len(rows), rows=rows)


def _options(table: Mapping[str, Any], folder: Path) -> FigureOptions:
    options: dict[str, Any] = {}
    files = read_names(table.get("functions", []), "figures.functions", "file")
    options["functions"] = tuple(_own_function(folder / name, folder) for name in files)
    for key, unit in (("start", "s"), ("bench_temperature", "degC")):
        if key in table:
            options[key] = parse(table[key], unit, f"figures.{key}")
    if "bench_points" in table:
        options["bench_points"] = _whole_number(table["bench_points"], "figures.bench_points", 100_000, least=100)
    return FigureOptions(**options)


def _own_function(path: Path, folder: Path) -> OwnFigures:
    """The function `figures` of a user's Python file, run where it is trusted, as files of effects are."""
    try:
        content = code_of(path)
    except InputError as error:
        raise InputError(str(error), key="figures.functions") from None
    check_trusted(path, content, folder, key="figures.functions")
    names: dict[str, Any] = {"__name__": path.stem, "__file__": str(path)}
    try:
        exec(compile(content.decode("utf-8-sig"), str(path), "exec"), names)
    except (Exception, SystemExit) as error:
        raise InputError(f"{path}: {type(error).__name__}: {error}", key="figures.functions") from None
    function = names.get("figures")
    if not callable(function):
        raise InputError(f"{path}: has no function `figures`", key="figures.functions")
    return function


def _percentiles(table: Mapping[str, Any] | None) -> ChannelPercentiles | None:
    if table is None:
        return None
    check_known(table, ("channels", "levels", "points", "start", "end"), "percentiles")
    options: dict[str, Any] = {"channels": read_names(table.get("channels"), "percentiles.channels", "channel")}
    for key in ("start", "end"):
        if key in table:
            options[key] = parse(table[key], "s", f"percentiles.{key}")
    if "levels" in table:
        levels = table["levels"]
        if not isinstance(levels, list) or not all(isinstance(one, (int, float)) for one in levels):
            raise InputError(f"expected a list of numbers in %, got {levels!r}", key="percentiles.levels")
        options["levels"] = tuple(map(float, levels))
    if "points" in table:
        options["points"] = _whole_number(table["points"], "percentiles.points", 2000, least=2)
    return ChannelPercentiles(**options)


def _whole(table: Mapping[str, Any] | None) -> WholeChannels | None:
    if table is None:
        return None
    check_known(table, ("members", "channels"), "whole")
    members = table.get("members")
    if not isinstance(members, list) or not members:
        raise InputError(f"expected a list of numbers of members, got {members!r}", key="whole.members")
    numbers = tuple(_whole_number(one, "whole.members", MOST_MEMBERS, least=0) for one in members)
    channels = read_names(table.get("channels"), "whole.channels", "channel")
    return WholeChannels(members=tuple(dict.fromkeys(numbers)), channels=channels)


def _limits(table: Mapping[str, Any]) -> tuple[FigureLimit, ...]:
    """Limits by the name of a figure, in quotes or as tables within tables."""
    limits = []
    for name, entry in _entries(table):
        check_known(entry, ("low", "high"), f"limits.{name}")
        ends = {key: entry[key] if isinstance(entry[key], str) else str(entry[key]) for key in entry}
        limits.append(FigureLimit(name, **ends))
    return tuple(limits)


def _entries(table: Mapping[str, Any], prefix: str = "") -> list[tuple[str, dict[str, Any]]]:
    out: list[tuple[str, dict[str, Any]]] = []
    for name, value in table.items():
        key = f"{prefix}.{name}" if prefix else name
        if not isinstance(value, dict):
            raise InputError(f"expected a table such as {{ high = '1 mm' }}, got {value!r}", key=f"limits.{key}")
        inner = value and all(isinstance(one, dict) for one in value.values())
        out += _entries(value, key) if inner else [(key, value)]
    return out


def _text(given: Any, where: str) -> str:
    if not isinstance(given, str) or not given:
        raise InputError(f"expected text, got {given!r}", key=where)
    return given


def _whole_number(given: Any, where: str, most: int, *, least: int = 1) -> int:
    if isinstance(given, str) and given.strip().isdecimal():
        given = int(given)
    if isinstance(given, bool) or not isinstance(given, int) or not least <= given <= most:
        raise InputError(f"{given!r} must be a whole number of {least} to {most}", key=where)
    return given
