"""The extended model as a scenario file: a fitted variant under the inputs of the session's first training record."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.errors import InputError
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.prior import ToleratedSensorError
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.session import UNITS, Record, Session
from valvesim.inputs import Command, Constant
from valvesim.io import read_columns
from valvesim.simulation.scenario import Thermal
from valvesim.units import DISPLAY, parse, quantities
from valvesim.valve.additive_term import LAG, NONE, PATH, PORTS, VARIABLES, term_effect
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.oils import OILS, own_columns
from valvesim.valve.parameters import ROUTES, Valve
from valvesim.valve.thermal_network import ThermalNetwork

EFFECT_FILE = "recovered_term.py"  # where the scenario looks for a recovered term, beside itself


def scenario_text(session: Session, variant: ModelVariant, *, options: DiagnosisOptions) -> str:
    """A scenario file that runs a variant (valve and effects) under the session's first training record.

    Figures come back exactly as they are in the variant. The small errors of sensors within their tolerances are left
    out, a lag that the session states of a sensor is in. The record's CSV and a user's own files of effects are named
    by absolute paths; a recovered term is expected in `EFFECT_FILE` beside the scenario, see `effect_files`.

    Raises InputError for what no scenario file can say: a flow law, an oil or an effect that has no name there.
    """
    record = session.training[0]
    effects = (*_faults(variant), *_stated_lags(session, record))
    names = [active.effect.name for active in effects]
    scenario = record_scenario(session, record, valve=variant.valve, effects=effects, options=options.identification)
    commands = [f"[command.{record.command}]", _command(record, record.command, scenario.command)]
    pressures = [
        _command(record, f"{name}_pressure", command, key=name)
        for name in ("supply", "return", "load")
        if (command := getattr(scenario, f"{name}_pressure")) is not None
    ]
    oil_temperature = _command(record, "oil_temperature", scenario.oil_temperature)
    sections = [
        [f"title = {_quoted(scenario.title)}", f"duration = {_text(scenario.duration, 's')}"],
        _effects_files(session, effects),
        _valve(variant.valve),
        _oil(session.oil),
        [*_thermal(session.thermal), "[thermal.oil_temperature]", oil_temperature],
        commands,
        ["[pressures]", *pressures] if pressures else [],
        *(
            _effect(active, several=names.count(active.effect.name) > 1, recovered=_recovered(session, active.effect))
            for active in effects
        ),
        ["[outputs]", f"rate = {_text(scenario.output_rate, 'Hz')}"],
    ]
    return "\n\n".join("\n".join(lines) for lines in sections if lines) + "\n"


def effect_files(session: Session, variant: ModelVariant) -> dict[str, str]:
    """The files that the scenario of a variant needs beside it: name -> text; none where no term was recovered."""
    terms = [active for active in variant.effects if _recovered(session, active.effect)]
    return {EFFECT_FILE: effect_file(*terms)} if terms else {}


def effect_file(*terms: ActiveEffect) -> str:
    """A Python file that declares recovered terms (`additive_term.term_effect`) at their figures.

    Raises InputError for an effect that is none.
    """
    calls = [f"{active.effect.name.upper()} = {_term_call(active)}" for active in terms]
    heading = '"""Recovered from measurements by `valvesim diagnose`; a scenario names this file by `effects_files`."""'
    return "\n".join([heading, "", "from valvesim.valve.additive_term import term_effect", "", *calls, ""])


# ---------------------------------------------------------------- effects


def _faults(variant: ModelVariant) -> list[ActiveEffect]:
    return [active for active in variant.effects if not isinstance(active.effect, ToleratedSensorError)]


def _stated_lags(session: Session, record: Record) -> list[ActiveEffect]:
    """The lags that the session states of the record's sensors, as effects."""
    lags = {name: session.sensors[name].lag for name in record.outputs if name in session.sensors}
    return [CATALOGUE["sensor_lag"].on(name)(time_constant=lag) for name, lag in lags.items() if lag > 0.0]


def _recovered(session: Session, effect: Effect) -> bool:
    """Whether an effect is a term recovered from this session, and none that the session brings in a file."""
    known = {*CATALOGUE, *(own.name for own in session.user_effects)}
    return effect.name not in known and any(p.name == "at_1" for p in effect.parameters)


def _effects_files(session: Session, effects: Sequence[ActiveEffect]) -> list[str]:
    """The line that names the files of all effects that the catalogue lacks, where there are any."""
    users, files = {effect.name for effect in session.user_effects}, []
    others = [active.effect for active in effects if active.effect.name not in CATALOGUE]
    recovered = [effect for effect in others if _recovered(session, effect)]
    for effect in others:
        if effect.name not in users and effect not in recovered:
            raise InputError(f"effects.{effect.name}: comes from no file that a scenario could name (effects_files)")
    if len(others) > len(recovered):
        files += [str(path) for path in session.effects_files]
    if recovered:
        files.append(EFFECT_FILE)
    return [f"effects_files = [{', '.join(map(_quoted, files))}]"] if files else []


def _effect(active: ActiveEffect, *, several: bool, recovered: bool) -> list[str]:
    """The table of an effect. Of a recovered term the file has all figures but its share."""
    effect = active.effect
    lines = [f"[effects.{effect.name}]"]
    if effect.channel or several:
        lines = [f"[{lines[0]}]"]
    if effect.channel:
        lines.append(f"channel = {_quoted(effect.channel)}")
    for parameter, value in zip(effect.parameters, active.numbers, strict=True):
        if parameter is effect.amplitude or not recovered:
            lines.append(f"{parameter.name} = {_text(value, parameter.unit)}")
    return lines


def _term_call(active: ActiveEffect) -> str:
    """The call of `term_effect` that makes this effect."""
    names = [p.name for p in active.effect.parameters]
    figures = {name: float(value) for name, value in zip(names, active.numbers, strict=True)}
    count = sum(name.startswith("at_") for name in names)
    knots = [figures[f"at_{k + 1}"] for k in range(count)]
    values = [figures[f"value_{k + 1}"] for k in range(count)]
    own = {name: figures[name] for name in ("time_constant", "width") if name in figures}
    memory = LAG if "time_constant" in own else PATH if "width" in own else NONE
    for port in PORTS if count else ():
        for variable, declared in VARIABLES.items():
            if memory == PATH and not declared.rate:
                continue
            same = term_effect(port, variable, knots, values, memory=memory, name=active.effect.name, **own)
            if same.balance is active.effect.balance:  # one function for all terms of a kind
                words = [f"{key}={value!r}" for key, value in ({"memory": memory} | own if own else {}).items()]
                lines = [f"    {port!r}, {variable!r},", f"    knots={knots},", f"    values={values},"]
                if words:
                    lines.append(f"    {', '.join(words)},")
                return "\n".join(["term_effect(", *lines, f"    name={active.effect.name!r},", ")"])
    raise InputError(f"effects.{active.effect.name}: is no recovered term, so no file can be written for it")


# ---------------------------------------------------------------- valve, oil, thermal


def _valve(valve: Valve) -> list[str]:
    law = [name for name, law in FLOW_LAWS.items() if law is valve.flow_coefficients]
    if not law:
        raise InputError(f"valve.flow_law: the valve has a law of its own; a scenario knows {', '.join(FLOW_LAWS)}")
    named = [] if FLOW_LAWS[law[0]] is Valve().flow_coefficients else [f"flow_law = {_quoted(law[0])}"]
    lines = [*named, *_differing(valve, Valve())]
    return ["[valve]", *lines] if lines else []


def _oil(oil: Oil) -> list[str]:
    own = OILS.get(oil.name)
    if own is None or own.viscosity_law != oil.viscosity_law:
        columns = [f"{key} = {_quoted(text)}" for key, text in own_columns(oil)]
        return ["[oil]", f"name = {_quoted(oil.name)}", *columns, *_differing(oil, MIL_PRF_5606)]
    return ["[oil]", f"name = {_quoted(oil.name)}", *_differing(oil, own)]


def _thermal(thermal: Thermal) -> list[str]:
    lines = ["[thermal]"]
    if thermal.network is None:
        lines.append("isothermal = true")
    if thermal.routes != ROUTES:
        lines.append(f"routes = {json.dumps(list(thermal.routes))}")
    if thermal.throttling_heat:
        lines.append("throttling_heat = true")
    initial = thermal.initial_temperature
    if isinstance(initial, Mapping):
        parts = ", ".join(f"{name} = {_text(value, 'degC')}" for name, value in initial.items())
        lines.append(f"initial_temperature = {{ {parts} }}")
    elif initial is not None:
        lines.append(f"initial_temperature = {_text(initial, 'degC')}")
    lines += _differing(thermal, Thermal())
    return lines if thermal.network is None else [*lines, *_differing(thermal.network, ThermalNetwork())]


def _differing(instance: Any, reference: Any) -> list[str]:
    """A line for each quantity that differs from the reference; the comment tells by how much."""
    lines = []
    for name, declared in quantities(reference).items():
        value, usual = float(getattr(instance, name)), float(getattr(reference, name))
        if value != usual:
            by = f"  # {100.0 * (value / usual - 1.0):+.3g} %" if usual else ""
            lines.append(f"{name} = {_text(value, declared.metadata['unit'])}{by}")
    return lines


# ---------------------------------------------------------------- inputs


def _command(record: Record, column: str, command: Command, key: str = "") -> str:
    """One line for an input: a constant, the record's own file, or its points where the file says something else.

    With a `key` that is a whole command of its own (`supply = ...`), else an entry of the command's table.
    """
    unit = UNITS[column]
    if isinstance(command, Constant):
        value = _text(command.value, unit)
        return f"{key} = {value}" if key else f"constant = {{ value = {value} }}"
    start = _start_in_file(record, column, command.values)  # type: ignore[attr-defined]
    if start is None:
        times, values = (", ".join(map(repr, numbers)) for numbers in (command.times, command.values))  # type: ignore[attr-defined]
        table = f'{{ times = "{times} s", values = "{values} {unit}" }}'
    else:
        file = _quoted(str(record.path.absolute()))  # type: ignore[union-attr]
        table = f"{{ file = {file}, column = {_quoted(column)}, start = {_text(start, 's')} }}"
    return f"{key} = {{ table = {table} }}" if key else f"table = {table}"


def _start_in_file(record: Record, column: str, values: Sequence[float]) -> float | None:
    """The time of the record's file at which the record starts; None where the file's column is not what is used."""
    if record.path is None or len(values) != len(record.time):
        return None
    read = read_columns(Path(record.path), {"time": "s", column: UNITS[column]})
    return float(read["time"][0]) if np.array_equal(read[column], values) else None


# ---------------------------------------------------------------- text


def _text(value: float, unit: str) -> str:
    """A figure with its unit in quotes that reads back exactly: in the unit that people use where that does."""
    value = float(value)
    if unit == "1":
        return f'"{value!r}"'
    all_candidate_sensitivities, factor = DISPLAY.get(unit, (unit, 1.0))
    text = f"{value * factor:.12g} {all_candidate_sensitivities}"
    return _quoted(text if parse(text, unit) == value else f"{value!r} {unit}")


def _quoted(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
