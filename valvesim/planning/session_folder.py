"""The session folder of a plan, ready to be filled: `session.toml`, the commands as CSV, and what to do with both."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.diagnosis.experiments import Experiment, experiment_values
from valvesim.identification.session import UNITS
from valvesim.io import columns_rows, csv_text
from valvesim.planning.plan import Plan
from valvesim.units import DISPLAY, exact_text

SKIPPED = ("bench", "tests", "aim", "added_sensors", "sensors")


def write_session_folder(plan: Plan, given: dict[str, Any], folder: Path) -> tuple[Path, ...]:
    """Write `session/` and `commands/` into a folder; `given` is the table of the plan file. The paths."""
    session, commands = folder / "session", folder / "commands"
    session.mkdir(parents=True)
    commands.mkdir(parents=True)
    runs = [(test.experiment, test.repeats, "train") for test in plan.tests]
    if plan.validation is not None:
        runs.append((plan.validation, 1, "test"))
    paths = [session / "session.toml"]
    paths[0].write_text(session_text(plan, given, runs), encoding="utf-8")
    for experiment, _, _ in runs:
        path = commands / f"{file_name(experiment)}.csv"
        path.write_text(command_text(plan, experiment), encoding="utf-8")
        paths.append(path)
    return tuple(paths)


def session_text(plan: Plan, given: dict[str, Any], runs: list[tuple[Experiment, int, str]]) -> str:
    """The text of `session.toml`: the valve as in the plan, its sensors, and a record for each run to be measured."""
    import tomlkit

    document = tomlkit.document()
    document.add(tomlkit.comment("Planned by `valvesim plan`. Put each record beside this file, under the name below"))
    document.add(tomlkit.comment("(any format that `valvesim records` reads), then `valvesim diagnose` this folder."))
    for key, value in given.items():
        if key == "effects_files":  # named from where the plan file stands
            document[key] = [str(path) for path in plan.bench.session.effects_files]
        elif key not in SKIPPED:
            document[key] = value
    sensors = tomlkit.table()
    for sensor in plan.bench.sensors:
        own: dict[str, Any] = {"noise": exact_text(float(sensor.noise or 0.0), sensor.unit)}
        if sensor.resolution:
            own["resolution"] = exact_text(sensor.resolution, sensor.unit)
        if sensor.lag:
            own["lag"] = exact_text(sensor.lag, "s")
        if np.isfinite(sensor.range).all():
            own["range"] = [exact_text(value, sensor.unit) for value in sensor.range]
        sensors[sensor.channel] = own
    document["sensors"] = sensors
    records = tomlkit.aot()
    for experiment, repeats, role in runs:
        for k in range(repeats):
            record = tomlkit.table()
            name = file_name(experiment)
            record["file"] = f"{name}_{k + 1}.csv" if repeats > 1 else f"{name}.csv"
            if repeats > 1:
                record["repeats"] = experiment.description
            record["role"] = role
            record.add(tomlkit.comment(f"command: commands/{name}.csv"))
            records.append(record)
    document["records"] = records
    return tomlkit.dumps(document)


def command_text(plan: Plan, experiment: Experiment) -> str:
    """The command, oil temperature and pressures of a test over time, as a CSV."""
    columns = {"time": experiment.time, **experiment_values(plan.bench.session, experiment)}
    shown = {name: DISPLAY.get(UNITS[name], (UNITS[name], 1.0)) for name in columns}
    scaled = [np.asarray(values) * shown[name][1] for name, values in columns.items()]
    return csv_text((f"{name} [{unit}]" for name, (unit, _) in shown.items()), columns_rows(scaled))


def file_name(experiment: Experiment) -> str:
    """A file name after a test."""
    return re.sub(r"\W+", "_", experiment.description.casefold()).strip("_")[:60]
