"""A command in a scenario file: a table of one or more of the named commands, read strictly and written back.

`current = "1 mA"` is a constant, `sine = { ... }` a command with its figures, several in one table are their sum, and
`sum = [{ ... }, { ... }]` is one in which a kind may stand twice. Points stand in a CSV file or in two lists.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.inputs import COMMANDS, VALUE, Command, Constant, Sum, Table, read_table, unit_of_figure
from valvesim.io import check_known
from valvesim.units import exact_text, out_of_range, parse, parse_list, quantities

TABLE, SUM = "table", "sum"
MOST_TERMS = 500  # of a sum
NAMES = (*COMMANDS, TABLE, SUM)


# ---------------------------------------------------------------- reading


def read_command(given: Any, unit: str, where: str, *, column: str, folder: Path) -> Command:
    """The command of a table at the key `where`; text alone is a constant.

    `column` is what a CSV file calls the values where the table does not say, `folder` where its name starts. Raises
    InputError with the key.
    """
    if not isinstance(given, dict):
        return Constant(value=parse(given, unit, where))
    if not given:
        raise InputError(f"needs a command, one of {', '.join(NAMES)}", key=where)
    terms: list[Command] = []
    for name, figures in given.items():
        here = f"{where}.{name}"
        if name == TABLE:
            terms.append(_read_table(figures, unit, here, column, folder))
        elif name == SUM:
            terms.append(_read_sum(figures, unit, here, column, folder))
        elif name in COMMANDS:
            terms.append(_read_one(name, figures, unit, here))
        else:
            raise unknown_name("command", name, NAMES, where)
    if len(terms) > 1:
        check_levels(given, unit, where)
    return terms[0] if len(terms) == 1 else Sum(tuple(terms))


def read_switch(value: Any, where: str) -> bool:
    """InputError unless `value` is true or false."""
    if not isinstance(value, bool):
        raise InputError(f"expected true or false, got {value!r}", key=where)
    return value


def check_levels(table: Mapping[str, Any], unit: str, where: str) -> None:
    """In a sum 80 K may be a temperature or a difference: InputError unless levels of temperature are given in °C."""
    if unit != "degC":
        return
    for kind, figures in table.items():
        declared = quantities(COMMANDS[kind]) if kind in COMMANDS else {}
        levels = {name for name, field in declared.items() if field.metadata["unit"] == VALUE} or {"values"}
        for name, text in (figures if isinstance(figures, dict) else {"value": figures}).items():
            if name in levels and not str(text).rstrip().endswith(("degC", "°C")):
                problem = f"{text!r} in a sum of commands may be a temperature or a difference; write it in degC"
                raise InputError(problem, key=f"{where}.{kind}.{name}")


def _read_one(name: str, figures: Any, unit: str, where: str) -> Command:
    """A command of `COMMANDS` with its figures."""
    if name == "constant" and not isinstance(figures, dict):
        figures = {"value": figures}
    if not isinstance(figures, dict):
        raise InputError(f"expected a table such as {{ ... }}, got {figures!r}", key=where)
    kind = COMMANDS[name]
    fields = {field.name: field for field in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key, given in figures.items():
        here = f"{where}.{key}"
        if key not in fields:
            raise unknown_name("key", key, fields, where)
        if "unit" not in fields[key].metadata:
            values[key] = read_switch(given, here)
            continue
        own = unit_of_figure(fields[key].metadata["unit"], unit)
        values[key], (low, high) = parse(given, own, here), fields[key].metadata["bounds"]
        if not low <= values[key] <= high:
            raise out_of_range(values[key], fields[key], key=here, unit=own)
    try:
        return kind(**values)
    except InputError as error:
        raise error.moved(name, where) from None


def _read_sum(entries: Any, unit: str, where: str, column: str, folder: Path) -> Sum:
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"expected a list of commands, [{{ ... }}, {{ ... }}], got {entries!r}", key=where)
    if len(entries) > MOST_TERMS:
        raise InputError(f"{len(entries)} commands are more than {MOST_TERMS}", key=where)
    terms = []
    for k, entry in enumerate(entries, start=1):
        terms.append(read_command(entry, unit, f"{where}.{k}", column=column, folder=folder))
        if len(entries) > 1:
            check_levels(entry, unit, f"{where}.{k}")
    return Sum(tuple(terms))


def _read_table(figures: Any, unit: str, where: str, column: str, folder: Path) -> Table:
    """Points of a CSV file (`start`: the file's time that is the run's zero), or of two lists in the text."""
    if isinstance(figures, dict) and figures.keys() >= {"times", "values"}:
        check_known(figures, ("times", "values"), where)
        times = parse_list(figures["times"], "s", f"{where}.times")
        values = parse_list(figures["values"], unit, f"{where}.values")
        return Table(times=tuple(times.tolist()), values=tuple(values.tolist()), where=where)
    if not isinstance(figures, dict) or not isinstance(figures.get("file"), str):
        raise InputError(
            f"expected {{ file = 'name.csv' }}, got {figures!r} (or lists: times, values)", key=where
        )  # fmt: skip
    check_known(figures, ("file", "column", "start"), where)
    start = parse(figures.get("start", "0 s"), "s", f"{where}.start")
    try:
        read = read_table(folder / figures["file"], str(figures.get("column", column)), unit)
    except InputError as error:
        raise InputError(str(error), key=where) from None
    return dataclasses.replace(read, times=tuple((np.asarray(read.times) - start).tolist())) if start else read


# ---------------------------------------------------------------- writing


def command_entries(command: Command, unit: str, where: str) -> dict[str, Any]:
    """The table of a command, of text and tables alone, which reads back as an equal one.

    Raises InputError for what no scenario file can say: a scaled command, or one of one's own.
    """
    if not isinstance(command, Sum):
        return dict([_entry(command, unit, where)])
    if len(command.terms) > 1 and not any(isinstance(term, Sum) for term in command.terms):
        entries = [_entry(term, unit, where) for term in command.terms]
        if len({name for name, _ in entries}) == len(entries):
            return dict(entries)
    return {SUM: [command_entries(term, unit, where) for term in command.terms]}


def _entry(command: Command, unit: str, where: str) -> tuple[str, dict[str, Any]]:
    """(name, figures) of a command that is no sum; figures at their defaults are left out."""
    if isinstance(command, Table):
        lists = (("times", command.times, "s"), ("values", command.values, unit))
        return TABLE, {key: f"{', '.join(repr(float(v)) for v in values)} {own}" for key, values, own in lists}
    for name, kind in COMMANDS.items():
        if type(command) is kind:
            figures: dict[str, Any] = {}
            for field in dataclasses.fields(command):  # type: ignore[arg-type]  # those of COMMANDS are dataclasses
                value = getattr(command, field.name)
                if "unit" not in field.metadata:
                    figures |= {field.name: bool(value)} if value != field.default else {}
                elif value != field.default or field.metadata["unit"] == VALUE:
                    figures[field.name] = exact_text(value, unit_of_figure(field.metadata["unit"], unit))
            return name, figures
    problem = f"{type(command).__name__} is no command of a scenario file, which knows {', '.join(NAMES)}"
    raise InputError(problem, key=where)
