"""Reading a plan file: the valve as in `session.toml`, sensors with their noise, the bench, its tests and the aim.

[sensors.spool_position]
noise = "1 um"
[added_sensors.nozzle_pressure_1]
noise = "0.05 bar"
cost = 3
[bench]
rate = "1 kHz"
oil_temperature = ["20 degC", "60 degC"]
setup = "60 s"
thermometers = ["body"]                                      # parts whose temperature is measured
tests = ["slow full triangle", "filtered random steps"]     # of the library; all of it where none is named
[[tests]]                                                    # and own ones
name = "sine"
duration = "1 s"
command.current = { sine = { amplitude = "4 mA", frequency = "20 Hz" } }
[aim]
causes = ["nozzle_erosion[side=1]", "spool_coulomb_friction"]
sizes.spool_coulomb_friction = "0.5 N"
parameters.feedback_rod_stiffness = "1 %"
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.diagnosis.experiments import Experiment, library
from valvesim.errors import InputError, unknown_name
from valvesim.identification.options import DEFAULT_IDENTIFICATION
from valvesim.identification.session import OUTPUTS, Record, Sensor, Session, value_text
from valvesim.identification.session_toml import session_settings, stated_sensors
from valvesim.inputs import evaluate
from valvesim.io import check_known, check_printable, check_tables, located, read_toml
from valvesim.planning.bench import AddedSensor, Aim, BenchPlan
from valvesim.planning.options import DEFAULT_PLANNING, PlanFileOptions, PlanningOptions
from valvesim.simulation.command_toml import read_command
from valvesim.simulation.scenario_toml import read_names
from valvesim.units import parse, quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect import Effect
from valvesim.valve.equations import DRIVES
from valvesim.valve.thermal_network import THERMAL_NODES
from valvesim.valve.valve_toml import read_tolerance

_OWN = ("bench", "tests", "aim", "added_sensors", "sensors")


def load_plan(path: str | Path, *, options: PlanningOptions = DEFAULT_PLANNING) -> BenchPlan:
    """The plan of a file. Raises InputError with file, line and key of what makes no sense."""
    path = Path(path)
    text, table = read_toml(path, "a plan is a TOML file with [sensors], see `valvesim plan --help`")
    with located(path, text, document="plan"):
        return read_plan(path.parent, table, options=options)


def read_plan(folder: Path, table: dict[str, Any], *, options: PlanningOptions = DEFAULT_PLANNING) -> BenchPlan:
    """The plan of a table; files that it names stand in `folder`."""
    for key in ("records", "columns", "csv"):
        if key in table:
            raise InputError("belongs to a session that was measured", key=key)
    session = session_settings(folder, {k: v for k, v in table.items() if k not in ("tests", "aim")}, (),
                               ("bench", "added_sensors"))  # fmt: skip
    bench, aim = table.get("bench", {}), table.get("aim", {})
    check_tables(table, ("sensors", "added_sensors", "bench", "aim"))
    check_known(bench, ("rate", "oil_temperature", "setup", "tests", "command", "thermometers"), "bench")
    thermometers = read_names(bench.get("thermometers", []), "bench.thermometers", "part")
    for part in thermometers:
        if part not in THERMAL_NODES:
            raise unknown_name("part", part, THERMAL_NODES, "bench.thermometers")
    sensors = _with_noise(stated_sensors(table.get("sensors", {})), "sensors")
    command = bench.get("command", "current")
    if not isinstance(command, str) or command not in DRIVES:
        raise unknown_name("command", str(command), DRIVES, "bench.command")
    if not sensors:
        raise InputError(f"a bench needs sensors: [sensors.NAME] with a noise, of {', '.join(OUTPUTS)}", key="sensors")
    rate = parse(bench["rate"], "Hz", "bench.rate") if "rate" in bench else options.diagnosis.design.rate
    if _positive(rate, bench.get("rate"), "bench.rate") > options.file.highest_rate:
        raise InputError(f"{rate:g} Hz is above {options.file.highest_rate:g} Hz", key="bench.rate", joint=" = ")
    diagnosis = replace(options.diagnosis, design=replace(options.diagnosis.design, rate=rate))
    session = _with_oil(session, bench, command)
    own = _own_tests(folder, table.get("tests", []), session, rate, options=options.file)
    every = (*library(session, options=diagnosis), *own)
    return BenchPlan(
        session=session,
        sensors=tuple(sensors.values()),
        added=_added(table.get("added_sensors", {}), sensors),
        experiments=_chosen(every, bench, table.get("tests", [])),
        command=command,
        setup=parse(bench["setup"], "s", "bench.setup") if "setup" in bench else 0.0,
        aim=_aim(aim, session),
        thermometers=thermometers,
    )


def _positive(value: float, given: Any, where: str) -> float:
    if value <= 0.0:
        raise InputError(f"{given!r} must be positive", key=where)
    return value


def _with_noise(sensors: dict[str, Sensor], where: str) -> dict[str, Sensor]:
    for name, sensor in sensors.items():
        if sensor.noise is None:
            raise InputError(
                "its noise is missing, such as noise = '0.1 %' of the span in its unit", key=f"{where}.{name}"
            )
    return sensors


def _added(table: dict[str, Any], sensors: dict[str, Sensor]) -> tuple[AddedSensor, ...]:
    costs = {name: given.pop("cost", 1.0) for name, given in table.items() if isinstance(given, dict)}
    try:
        stated = _with_noise(stated_sensors(table), "added_sensors")
    except InputError as error:
        raise error.moved("sensors", "added_sensors") from None
    for name in stated:
        where = f"added_sensors.{name}"
        if name in sensors:
            raise InputError("the bench has it already", key=where)
        if isinstance(costs[name], bool) or not isinstance(costs[name], int | float) or not costs[name] > 0.0:
            raise InputError(f"expected a positive number, got {costs[name]!r}", key=f"{where}.cost")
    return tuple(AddedSensor(sensor=sensor, cost=float(costs[name])) for name, sensor in stated.items())


def _with_oil(session: Session, bench: dict[str, Any], command: str) -> Session:
    """The session with one record that says which oil temperatures the bench has, and what drives the valve."""
    given = bench.get("oil_temperature", "20 degC")
    where = "bench.oil_temperature"
    oils = [parse(one, "degC", where) for one in (given if isinstance(given, list) else [given])]
    if not 1 <= len(oils) <= 2 or oils != sorted(oils):
        raise InputError(f"expected one temperature, or the lowest and the highest, got {given!r}", key=where)
    span = np.linspace(oils[0], oils[-1], 3)
    values = {"oil_temperature": span, command: np.zeros(3)}
    return replace(session, records=(Record("bench", np.arange(3.0), values, {}),))


def _chosen(every: Sequence[Experiment], bench: dict[str, Any], own: Any) -> tuple[Experiment, ...]:
    names = [one.description for one in every]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two tests are called {twice!r}", key="tests")
    wanted = read_names(bench.get("tests", []), "bench.tests", "test")
    for name in wanted:
        if name not in names:
            raise unknown_name("test", name, names, "bench.tests")
    mine = {one["name"] for one in own}
    return tuple(one for one in every if not wanted or one.description in wanted or one.description in mine)


def _own_tests(
    folder: Path, listed: Any, session: Session, rate: float, *, options: PlanFileOptions
) -> list[Experiment]:
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        raise InputError("expected [[tests]], one for each test", key="tests")
    found = []
    drive = session.drive
    rated = drive.command_for_current(session.valve.rated_current, session.valve.coil_resistance)
    for k, given in enumerate(listed, start=1):
        where = f"tests.{k}"
        check_known(
            given, ("name", "duration", "command", "oil_temperature", "supply_pressure", "load_pressure"), where
        )
        check_printable(given.get("name"), f"{where}.name")
        if "duration" not in given or "command" not in given:
            raise InputError("a test needs a duration and a command", key=where)
        duration = _positive(parse(given["duration"], "s", f"{where}.duration"), given["duration"], f"{where}.duration")
        low, high = options.least_samples, options.most_samples
        if not low <= duration * rate <= high:
            raise InputError(f"{duration * rate:.0f} samples are outside [{low}, {high}]", key=f"{where}.duration")
        command = given["command"]
        if not isinstance(command, dict) or list(command) != [drive.command_name]:
            raise InputError(f"give command.{drive.command_name}, as the bench drives", key=f"{where}.command")
        time = np.linspace(0.0, duration, int(round(duration * rate)) + 1)
        key = f"{where}.command.{drive.command_name}"
        shape = read_command(
            command[drive.command_name], drive.command_unit, key, column=drive.command_name, folder=folder
        )
        share = evaluate(shape, time) / rated
        most, limit = float(np.max(np.abs(share))), DEFAULT_IDENTIFICATION.audit.most_command  # as of records
        if most > limit:
            told, one = (value_text(value, drive.command_unit) for value in (most * rated, rated))
            raise InputError(f"{told} is beyond {limit:g} times the rated {one}", key=key)
        oil = read_command(given.get("oil_temperature", "20 degC"), "degC", f"{where}.oil_temperature",
                           column="oil_temperature", folder=folder)  # fmt: skip
        supply = parse(given["supply_pressure"], "Pa", f"{where}.supply_pressure") if "supply_pressure" in given \
            else float(session.valve.supply_pressure)  # fmt: skip
        load = parse(given["load_pressure"], "Pa", f"{where}.load_pressure") if "load_pressure" in given else 0.0
        if abs(load) > supply:
            raise InputError("is beyond the supply pressure", key=f"{where}.load_pressure")
        found.append(Experiment(given["name"], time, share, evaluate(oil, time), supply, load))
    return found


def _aim(given: dict[str, Any], session: Session) -> Aim:
    check_known(given, ("causes", "sizes", "isolate", "parameters"), "aim")
    known = {effect.name: effect for effect in (*CATALOGUE.values(), *session.user_effects)}
    causes = read_names(given.get("causes", []), "aim.causes", "cause")
    for cause in causes:
        if _effect_name(cause) not in known:
            raise unknown_name("cause", cause, known, "aim.causes")
    sizes = {}
    for name, text in given.get("sizes", {}).items():
        if _effect_name(name) not in known:
            raise unknown_name("cause", name, known, "aim.sizes")
        if causes and _effect_name(name) not in map(_effect_name, causes):
            raise InputError(f"is not among aim.causes ({', '.join(causes)})", key=f"aim.sizes.{name}")
        sizes[name] = _size(known[_effect_name(name)], text, f"aim.sizes.{name}")
    isolate = given.get("isolate", True)
    if not isinstance(isolate, bool):
        raise InputError(f"expected true or false, got {isolate!r}", key="aim.isolate")
    parameters = {}
    for name, text in given.get("parameters", {}).items():
        if name not in quantities(session.valve):
            raise unknown_name("valve parameter", name, quantities(session.valve), "aim.parameters")
        parameters[name] = read_tolerance(session.valve, name, text, f"aim.parameters.{name}")
    return Aim(causes=causes, sizes=sizes, isolate=isolate, parameters=parameters)


def _effect_name(cause: str) -> str:
    return cause.partition("[")[0].partition("@")[0]


def _size(effect: Effect, text: Any, where: str) -> float:
    amplitude = effect.amplitude
    if amplitude.unit.startswith("channel"):
        raise InputError("a sensor's error is looked for at its typical size", key=where)
    size = parse(text, amplitude.unit, where) - float(amplitude.neutral or 0.0)
    if size == 0.0:
        raise InputError(f"{text!r} is where the effect vanishes", key=where)
    return abs(size)
