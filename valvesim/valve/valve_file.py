"""A valve file: one valve's parameters, effects in service and oil, each figure with its source; read and written.

    title = "Servo valve 5329"
    serial_number = "5329"
    [valve]
    rated_current = { value = "25 mA", source = "name plate" }
    null_gap = { value = "38 um", tolerance = "4 um", source = "identified" }

A figure is text with its unit, or a table of `value`, `source` and (of the valve's own) `tolerance`: two standard
deviations, as a session's. Valves that come with the package are files too, known by name (`PRESETS`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, nearest, unknown_name
from valvesim.io import (
    MOST_TEXT,
    check_known,
    check_printable,
    check_tables,
    located,
    read_names,
    read_toml,
    write_atomically,
)
from valvesim.units import exact_text, parse, quantities
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.effect_files import load_effects_files
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve
from valvesim.valve.permission import permitting
from valvesim.valve.valve_toml import (
    add_effects,
    add_section,
    oil_lines,
    read_effects,
    read_oil_table,
    read_tolerance,
    read_valve,
    valve_lines,
)

PRESETS = {path.stem: path for path in sorted((Path(__file__).parent / "presets").glob("*.toml"))}
"""The valves that come with the package: name -> file."""
_TABLES = ("valve", "oil", "effects", "correlations")
_FIGURE = ("value", "source", "tolerance")


@dataclass(frozen=True, kw_only=True)
class ValveFile:
    """A valve as its file has it: `valve` (its name is title and serial number), `oil` and `effects` in service.

    `sources` says of a figure, by its dotted key such as `valve.null_gap`, where it comes from; `tolerances` are two
    standard deviations of valve parameters in SI, `correlations` those of pairs of them. `own` are the effects that
    the Python files `effects_files` declare.
    """

    title: str = ""
    serial_number: str = ""
    valve: Valve = field(default_factory=Valve)
    oil: Oil = MIL_PRF_5606
    effects: tuple[ActiveEffect, ...] = ()
    sources: Mapping[str, str] = field(default_factory=dict)
    tolerances: Mapping[str, float] = field(default_factory=dict)
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    effects_files: tuple[Path, ...] = ()
    own: tuple[Effect, ...] = ()

    def covariance(self) -> tuple[tuple[str, ...], np.ndarray]:
        """(names (n,), covariance (n, n) in SI) of the parameters that have a tolerance, never indefinite."""
        names = tuple(self.tolerances)
        correlation = np.eye(len(names))
        for (one, other), value in self.correlations.items():
            j, k = names.index(one), names.index(other)
            correlation[j, k] = correlation[k, j] = value
        values, vectors = np.linalg.eigh(correlation)
        correlation = (vectors * np.maximum(values, 0.0)) @ vectors.T  # what rounding made indefinite
        deviation = np.array([self.tolerances[name] for name in names]) / 2.0
        return names, correlation * np.outer(deviation, deviation)


# ---------------------------------------------------------------- reading


def load_valve(
    valve: str | Path, *, folder: str | Path = ".", trust: bool = False, outside: bool = False
) -> ValveFile:
    """The valve of a file, its name relative to `folder`, or one of `PRESETS` by name.

    With `trust` the Python files of effects that it names are run, with `outside` also those outside its folder.
    Raises InputError (file, line, key) for a missing file, unknown keys, and figures that make no sense.
    """
    path = PRESETS.get(str(valve), Path(folder) / valve)
    expected = f"a valve is a TOML file or one of {', '.join(PRESETS)}{_meant(str(valve))}"
    text, table = read_toml(path, expected)
    with located(path, text, document="valve file"), permitting(trust=trust, outside=outside):
        return _read(table, path.parent)


def read_valve_entry(given: Any, folder: Path) -> ValveFile:
    """The valve of a key `valve`: the name of a file or preset, or a table of figures with that name as `file`, if any.

    Raises InputError for figures that make no sense, and as `load_valve` does, with the key.
    """
    table = {"file": given} if isinstance(given, str) else given
    if not isinstance(table, dict):
        raise InputError(f"expected a table, got {given!r}; text is the name of a valve file", key="valve")
    figures = dict(table)
    named = ValveFile()
    if "file" in figures:
        name, key = figures.pop("file"), "valve" if isinstance(given, str) else "valve.file"
        if not isinstance(name, str) or not name:
            raise InputError(f"expected the name of a valve file, got {name!r}", key=key)
        try:
            named = load_valve(name, folder=folder)
        except InputError as error:
            raise InputError(str(error), key=key) from None
    return replace(named, valve=read_valve(figures, named.valve))


def _meant(name: str) -> str:
    """The preset that a name is nearest to, in words."""
    told = nearest(name, PRESETS)
    return told if "did you mean" in told else ""


def _read(table: dict[str, Any], folder: Path) -> ValveFile:
    check_known(table, ("title", "serial_number", "effects_files", *_TABLES), "valve file")
    check_tables(table, _TABLES)
    words = {key: table.get(key, "") for key in ("title", "serial_number")}
    for key, text in words.items():
        check_printable(text, key)
    figures, sources, tolerances = _without_sources(table.get("valve", {}), "valve")
    valve = read_valve(figures)
    if not valve.name:
        number = words["serial_number"]
        valve = replace(valve, name=words["title"] + (f", serial number {number}" if number else ""))
    oil, oil_sources, _ = _without_sources(table.get("oil", {}), "oil")
    files = read_names(table.get("effects_files", []), "effects_files", "file")
    own = load_effects_files(folder, files)
    widths = {n: read_tolerance(valve, n, text, f"valve.{n}.tolerance") for n, text in tolerances.items()}
    return ValveFile(
        **words,
        valve=valve,
        oil=read_oil_table(oil, folder),
        effects=read_effects(table.get("effects", {}), own),
        sources=sources | oil_sources,
        tolerances=widths,
        correlations=_read_correlations(table.get("correlations", {}), tuple(widths)),
        effects_files=tuple((folder / file).absolute() for file in files),
        own=own,
    )


def _without_sources(table: Mapping[str, Any], where: str) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """(figures as plain text, sources by dotted key, tolerances as text by name) of a table."""
    figures, sources, tolerances = dict(table), {}, {}
    for name, given in table.items():
        if not isinstance(given, dict):
            continue
        key = f"{where}.{name}"
        check_known(given, _FIGURE if where == "valve" else _FIGURE[:2], key)
        if "value" not in given:
            raise InputError("needs a value, such as { value = '1 mm', source = 'drawing' }", key=key, joint=" ")
        figures[name] = given["value"]
        if "source" in given:
            check_printable(given["source"], f"{key}.source")
            sources[key] = given["source"]
        if "tolerance" in given:
            tolerances[name] = given["tolerance"]
    return figures, sources, tolerances


def _read_correlations(table: Mapping[str, Any], names: tuple[str, ...]) -> dict[tuple[str, str], float]:
    read = {}
    for one, row in table.items():
        if one not in names:
            raise unknown_name("parameter with a tolerance", one, names, "correlations")
        if not isinstance(row, dict):
            raise InputError(f"expected a table of numbers, got {row!r}", key=f"correlations.{one}")
        for other, given in row.items():
            where = f"correlations.{one}.{other}"
            if other not in names or other == one:
                raise unknown_name("other parameter with a tolerance", other, set(names) - {one}, f"correlations.{one}")
            value = parse(given, "1", where)
            if not -1.0 <= value <= 1.0:
                raise InputError(f"{value:g} is outside [-1, 1]", key=where, joint=" = ")
            read[one, other] = value
    return read


# ---------------------------------------------------------------- writing

LEAST_CORRELATION = 5e-4  # below it a pair is not written


def valve_to_toml(described: ValveFile) -> str:
    """The text of a valve file that reads back as an equal `ValveFile` (correlations to three digits).

    Every figure that differs from the reference valve's, or has a source or tolerance, stands there.
    Raises InputError for what no file can say: a batch of valves, a law, oil or effect without a name there.
    """
    import tomlkit

    valve, document = described.valve, tomlkit.document()
    for key in ("title", "serial_number"):
        if text := getattr(described, key):
            document.add(key, text)
    if described.effects_files:
        document.add("effects_files", [str(file) for file in described.effects_files])
    lines = {key: value[0] if isinstance(value, tuple) else value for key, value in valve_lines(valve).items()}
    lines.pop("name", None)
    for name, declared in quantities(valve).items():
        source, tolerance = described.sources.get(f"valve.{name}"), described.tolerances.get(name)
        if source is None and tolerance is None:
            continue
        unit = declared.metadata["unit"]
        figure = tomlkit.inline_table()
        figure.append("value", exact_text(getattr(valve, name), unit))
        if tolerance is not None:
            figure.append("tolerance", exact_text(tolerance, unit))
        if source is not None:
            figure.append("source", source)
        lines[name] = figure
    order = {name: k for k, name in enumerate(("flow_law", *quantities(valve)))}
    add_section(document, "valve", dict(sorted(lines.items(), key=lambda line: order[line[0]])))
    _add_oil(document, described)
    add_effects(document, described.effects, described.own)
    rows: dict[str, dict[str, float]] = {}
    for (one, other), value in described.correlations.items():
        if abs(value) >= LEAST_CORRELATION:
            rows.setdefault(one, {})[other] = round(value, 3)
    table = tomlkit.inline_table
    add_section(document, "correlations", {one: _filled(table(), row) for one, row in rows.items()})
    text = tomlkit.dumps(document)
    if len(text.encode()) > MOST_TEXT:
        raise InputError(f"valve file: more than the {MOST_TEXT} bytes of text that are read")
    return text


def _add_oil(document: Any, described: ValveFile) -> None:
    import tomlkit

    lines = {key: value[0] if isinstance(value, tuple) else value for key, value in oil_lines(described.oil).items()}
    for name, text in list(lines.items()):
        if source := described.sources.get(f"oil.{name}"):
            lines[name] = _filled(tomlkit.inline_table(), {"value": text, "source": source})
    add_section(document, "oil", lines)


def _filled(table: Any, entries: Mapping[str, Any]) -> Any:
    for key, value in entries.items():
        table.append(key, value)
    return table


def save_valve(described: ValveFile, path: str | Path) -> Path:
    """Write a valve file, so that it is never half-written. Returns the path; raises as `valve_to_toml` does."""
    text = valve_to_toml(described)

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    return write_atomically(Path(path), write)
