"""Valve, oil and effects as tables of a TOML file, read strictly and written back: what scenarios, sessions and valve
files share. Every figure is text with its unit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.io import check_printable, located, read_toml
from valvesim.units import change, exact_text, parse, quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import ActiveEffect, Effect, check_listed_once
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.fluid import Oil
from valvesim.valve.oils import OILS, own_columns, read_oil
from valvesim.valve.parameters import Valve

LONGEST_NAME = 160  # characters of a valve's name

# ---------------------------------------------------------------- reading


def read_valve(table: Mapping[str, Any], base: Valve | None = None) -> Valve:
    """The reference valve, or `base`, with figures from a table; `flow_law` names the law of the pilot's coefficients.

    A `base` with a name and figures changed says so in its name.
    """
    valve, figures = Valve() if base is None else base, dict(table)
    name = figures.pop("name", valve.name)
    check_printable(name, "valve.name")
    law = figures.pop("flow_law", None)
    if law is not None and not (isinstance(law, str) and law in FLOW_LAWS):
        raise unknown_name("flow law", str(law), FLOW_LAWS, "valve.flow_law")
    flow_law = valve.flow_coefficients if law is None else FLOW_LAWS[law]
    if valve.name and name == valve.name and table:
        name = f"{name}, changed: {', '.join(key.replace('_', ' ') for key in table)}"
    name = name if len(name) <= LONGEST_NAME else f"{valve.name}, {len(table)} figures changed"
    return dataclasses.replace(change(valve, figures, "valve"), flow_coefficients=flow_law, name=name)


def read_tolerance(valve: Valve, name: str, text: Any, where: str) -> float:
    """The half-width of a valve parameter in SI, from a share of its value or a quantity."""
    declared = quantities(valve)
    if name not in declared:
        raise unknown_name("valve parameter", name, declared, where.rpartition(".")[0])
    if isinstance(text, str) and text.rstrip().endswith("%"):
        size = abs(getattr(valve, name))
        if size == 0.0:
            unit = declared[name].metadata["unit"]
            raise InputError(f"{name} is zero, so a share of it is nothing; give an absolute one in {unit}", key=where)
        half_width = parse(text, "1", where) * size
    else:
        half_width = parse(text, declared[name].metadata["unit"], where)
    if half_width <= 0.0:
        raise InputError(f"{text!r} must be positive", key=where)
    return half_width


def read_oil_table(table: dict[str, Any], folder: Path) -> Oil:
    """The oil of a table, or of the file in `folder` that it names; keys beside `file` take the place of the file's."""
    if "file" not in table:
        return read_oil(table)
    name = table["file"]
    if not isinstance(name, str) or not name:
        raise InputError(f"expected the name of a TOML file, got {name!r}", key="oil.file")
    path = folder / name
    try:
        text, own = read_toml(path, "oil.file names it")
        whole = set(own) == {"oil"} and isinstance(own["oil"], dict)
        with located(path, text):
            read_oil(own["oil"] if whole else own, "oil" if whole else "")
    except InputError as error:
        raise InputError(str(error), key="oil.file") from None
    return read_oil((own["oil"] if whole else own) | {key: table[key] for key in table if key != "file"})


def read_effects(given: Any, own: Sequence[Effect] = ()) -> tuple[ActiveEffect, ...]:
    """The active effects, of the catalogue or the user's own: a table by name, or a list of tables with `name`.

    A table by name holds one of them or, as [[effects.sensor_bias]], several; a list keeps any order.
    """
    active, known = [], CATALOGUE | {effect.name: effect for effect in own}
    for name, figures, where, key in _listed_effects(given):
        if name not in known:
            raise unknown_name("effect", name, known, key)
        if not isinstance(figures, dict):
            raise InputError(f"expected a table of its parameters, got {figures!r}", key=where)
        active.append(known[name].read(figures, where))
    check_listed_once(active)
    return tuple(active)


def _listed_effects(given: Any) -> list[tuple[str, Any, str, str]]:
    """(name, figures, key, key of the name) of each effect of the section."""
    if isinstance(given, dict):
        return [
            (name, one, f"effects.{name}.{k}" if isinstance(figures, list) and len(figures) > 1 else f"effects.{name}",
             "effects")
            for name, figures in given.items()
            for k, one in enumerate(figures if isinstance(figures, list) else [figures], start=1)
        ]  # fmt: skip
    listed = []
    for k, one in enumerate(given, start=1):
        where = f"effects.{k}"
        if not isinstance(one, dict) or not isinstance(one.get("name"), str):
            raise InputError(f"expected a table with the name of an effect, got {one!r}", key=where)
        listed.append((one["name"], {key: one[key] for key in one if key != "name"}, where, f"{where}.name"))
    return listed


# ---------------------------------------------------------------- writing


def add_section(parent: Any, name: str, lines: Mapping[str, Any], *, always: bool = False) -> Any:
    """A section with its lines, of which a pair is a value with its comment; none where there is nothing to say."""
    import tomlkit

    section = tomlkit.table()
    for key, value in lines.items():
        value, comment = value if isinstance(value, tuple) else (value, "")
        section.add(key, value)
        if comment:
            section[key].comment(comment)
    if lines or always:
        if len(parent):
            parent.add(tomlkit.nl())
        parent.add(name, section)
    return section


def on_lines(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Tables within a section, each on a line of its own."""
    return {key: on_one_line(value) for key, value in entries.items()}


def on_one_line(value: Any) -> Any:
    import tomlkit

    if isinstance(value, dict):
        line = tomlkit.inline_table()
        for key, inner in value.items():
            line.append(key, on_one_line(inner))
        return line
    if isinstance(value, list):
        several = tomlkit.array()
        for inner in value:
            several.append(on_one_line(inner))
        return several
    return value


def differing(instance: Any, reference: Any, where: str) -> dict[str, Any]:
    """Each quantity that differs from the reference, with how far it does."""
    lines: dict[str, Any] = {}
    for name, declared in quantities(reference).items():
        if np.ndim(getattr(instance, name)):
            raise InputError(
                "is an array, a batch of valves: a scenario file holds one", key=f"{where}.{name}", joint=" "
            )
        value, usual = float(getattr(instance, name)), float(getattr(reference, name))
        if value != usual:
            unit = declared.metadata["unit"]
            by = f"{100.0 * (value / usual - 1.0):+.3g} %" if usual and unit != "degC" else ""
            lines[name] = (exact_text(value, unit), by)
    return lines


def valve_lines(valve: Valve) -> dict[str, Any]:
    law = next((name for name, law in FLOW_LAWS.items() if law is valve.flow_coefficients), None)
    if law is None:
        problem = f"the valve has a law of its own; a scenario knows {', '.join(FLOW_LAWS)}"
        raise InputError(problem, key="valve.flow_law")
    named: dict[str, Any] = {"name": valve.name} if valve.name else {}
    named |= {} if FLOW_LAWS[law] is Valve().flow_coefficients else {"flow_law": law}
    return named | differing(valve, Valve(), "valve")


def oil_lines(oil: Oil) -> dict[str, Any]:
    own = OILS.get(oil.name)
    columns: dict[str, Any] = {"name": oil.name}
    if own is None or own.viscosity_law != oil.viscosity_law:
        columns |= dict(own_columns(oil))
    read = read_oil(columns)
    lines = columns | differing(oil, read, "oil")
    figures = {name: getattr(oil, name) for name in quantities(oil)}
    if dataclasses.replace(read, **figures) != oil:
        raise InputError(
            f"{oil.name!r} has laws that no table holds; a scenario knows {', '.join(OILS)}", key="oil.name"
        )
    return lines


def add_effects(document: Any, effects: Sequence[ActiveEffect], own: Sequence[Effect]) -> None:
    """The effects: by name where that keeps their order, else as a list."""
    import tomlkit

    known = CATALOGUE | {effect.name: effect for effect in own}
    for active in effects:
        effect, channel = known.get(active.effect.name), active.effect.channel
        if effect is None or (effect.on(channel) if channel and effect.reading else effect) != active.effect:
            problem = "comes from no file that a scenario could name (effects_files)"
            raise InputError(problem, key=f"effects.{active.effect.name}")
    names = [active.effect.name for active in effects]
    if sorted(names, key=names.index) != names:
        listed = tomlkit.aot()
        for active in effects:
            listed.append(_table({"name": active.effect.name} | _effect_lines(active)))
        document.add(tomlkit.nl())
        document.add("effects", listed)
        return
    section = tomlkit.table(is_super_table=True)
    for name in dict.fromkeys(names):
        several = [active for active in effects if active.effect.name == name]
        if len(several) == 1 and not several[0].effect.channel:
            add_section(section, name, _effect_lines(several[0]))
            continue
        listed = tomlkit.aot()
        for active in several:
            listed.append(_table(_effect_lines(active)))
        if len(section):
            section.add(tomlkit.nl())
        section.add(name, listed)
    if effects:
        document.add(tomlkit.nl())
        document.add("effects", section)


def _table(lines: Mapping[str, Any]) -> Any:
    import tomlkit

    table = tomlkit.table()
    for key, value in lines.items():
        table.add(key, value)
    return table


def _effect_lines(active: ActiveEffect) -> dict[str, Any]:
    effect = active.effect
    figures = zip(effect.parameters, active.numbers, strict=True)
    lines = {parameter.name: exact_text(value, parameter.unit) for parameter, value in figures}
    return ({"channel": effect.channel} if effect.channel else {}) | lines
