"""The extended model as a scenario file: a fitted variant under the inputs of the session's first training record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.errors import InputError
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.sensor_errors import ToleratedSensorError
from valvesim.identification.session import UNITS, Record, Session
from valvesim.inputs import Table
from valvesim.io import csv_text, read_columns
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.scenario_toml import PRESSURES, scenario_document
from valvesim.units import exact_text
from valvesim.valve.additive_term import LAG, NONE, PATH, PORTS, VARIABLES, term_effect
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.effects.sensors import sensor_lag

INPUT_FILE = "inputs.csv"  # where the scenario looks for inputs that its record's file does not give as they are
EFFECT_FILE = "recovered_term.py"  # where the scenario looks for a recovered term, beside itself


def scenario_text(session: Session, variant: ModelVariant, *, options: DiagnosisOptions) -> str:
    """A scenario file that runs a variant (valve, network and effects) under the session's first training record.

    Figures come back exactly as they are in the variant. The small errors of sensors within their tolerances are left
    out, a lag that the session states of a sensor is in. The record's CSV and a user's own files of effects are named
    by absolute paths; a recovered term and inputs of another format are expected beside it, see `effect_files`.

    Raises InputError for what no scenario file can say: a flow law, an oil or an effect that has no name there.
    """
    import tomlkit

    record = session.training[0]
    effects = (*(_as_declared(session, one) for one in _faults(variant)), *_stated_lags(session, record))
    recovered = [active.effect for active in effects if _recovered(session, active.effect)]
    users = {effect.name for effect in session.user_effects}
    files = [str(path) for path in session.effects_files] if users & {a.effect.name for a in effects} else []
    scenario = record_scenario(session, record, valve=variant.valve, effects=effects, options=options.identification)
    thermal = scenario.thermal if variant.network is None else replace(scenario.thermal, network=variant.network)
    document = scenario_document(
        replace(scenario, tolerance=Scenario().tolerance, thermal=thermal),
        effects_files=[*files, *([EFFECT_FILE] if recovered else [])],
        own=(*session.user_effects, *recovered),
        files=_files_of_inputs(record, scenario),
    )
    for effect in recovered:  # its file has all figures but its share
        table = document["effects"][effect.name]
        for name in [p.name for p in effect.parameters if p is not effect.amplitude]:
            table.remove(name)
    return tomlkit.dumps(document)


def effect_files(session: Session, variant: ModelVariant) -> dict[str, str]:
    """The files that the scenario of a variant needs beside it: name -> text.

    `EFFECT_FILE` where a term was recovered, and `INPUT_FILE` where the inputs do not stand in a plain CSV of the
    record as they were used.
    """
    terms = [active for active in variant.effects if _recovered(session, active.effect)]
    texts = {EFFECT_FILE: effect_file(*terms)} if terms else {}
    record = session.training[0]
    if columns := _inputs_beside(record):
        values = [record.time, *(record.values[name] for name in columns)]
        headings = (f"{name} [{UNITS[name]}]" for name in ("time", *columns))
        texts[INPUT_FILE] = csv_text(headings, zip(*(map(repr, one.tolist()) for one in values), strict=True))
    return texts


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


def _as_declared(session: Session, active: ActiveEffect) -> ActiveEffect:
    """An effect as catalogue or user declare it: a search may have gone by another typical amplitude."""
    known = CATALOGUE | {effect.name: effect for effect in session.user_effects}
    declared = known.get(active.effect.name, active.effect)
    if declared.reading is not None and active.effect.channel:
        declared = declared.on(active.effect.channel)
    same = replace(active.effect, parameters=declared.parameters) == declared
    return ActiveEffect(declared, active.numbers) if same else active


def _stated_lags(session: Session, record: Record) -> list[ActiveEffect]:
    """The lags that the session states of the record's sensors, as effects."""
    lags = {name: session.sensors[name].lag for name in record.outputs if name in session.sensors}
    return [sensor_lag(name, lag) for name, lag in lags.items() if lag > 0.0]


def _recovered(session: Session, effect: Effect) -> bool:
    """Whether an effect is a term recovered from this session, and none that the session brings in a file."""
    known = {*CATALOGUE, *(own.name for own in session.user_effects)}
    return effect.name not in known and any(p.name == "at_1" for p in effect.parameters)


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
    problem = "is no recovered term, so no file can be written for it"
    raise InputError(problem, key=f"effects.{active.effect.name}")


# ---------------------------------------------------------------- inputs


def _files_of_inputs(record: Record, scenario: Scenario) -> dict[str, dict[str, str]]:
    """For each input that stands in a file, by its key in a scenario: the record's own, or `INPUT_FILE`."""
    inputs = {
        f"command.{record.command}": (record.command, scenario.command),
        "thermal.oil_temperature": ("oil_temperature", scenario.oil_temperature),
        **{f"pressures.{name}": (f"{name}_pressure", getattr(scenario, f"{name}_pressure")) for name in PRESSURES},
    }
    files = {}
    for key, (column, command) in inputs.items():
        if not isinstance(command, Table):
            continue
        if (start := _start_in_file(record, column, command.values)) is not None:
            file = str(record.path.absolute())  # type: ignore[union-attr]
            files[key] = {"file": file, "column": column, "start": exact_text(start, "s")}
        elif column in _inputs_beside(record):
            files[key] = {"file": INPUT_FILE, "column": column}
    return files


def _inputs_beside(record: Record) -> list[str]:
    """The inputs of a record that move from sample to sample and do not stand as they were used in its own file.

    That is no plain CSV that a scenario reads, or they were cleaned. Temperatures are followed by few straight lines.
    """
    moving = [name for name in record.inputs if not name.endswith("_temperature") and np.ptp(record.values[name]) > 0.0]
    if record.path is None:
        return []
    return [name for name in moving if _start_in_file(record, name, record.values[name]) is None]


def _start_in_file(record: Record, column: str, values: Sequence[float] | np.ndarray) -> float | None:
    """The time of the record's file at which the record starts; None where the file's column is not what is used."""
    if record.path is None or len(values) != len(record.time):
        return None
    try:
        read = read_columns(Path(record.path), {"time": "s", column: UNITS[column]})
    except InputError:  # another dialect or format
        return None
    if len(read["time"]) != len(values) or not np.allclose(read["time"] - read["time"][0], record.time, atol=1e-9):
        return None
    return float(read["time"][0]) if np.array_equal(read[column], values) else None
