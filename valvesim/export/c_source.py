"""A scenario's valve as plain C for a controller or a test rig, with a test that holds it to `simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.export.c_model import model_sources
from valvesim.export.fmu import C_FOLDER, MODEL_FILES
from valvesim.export.reference_results import reference_values
from valvesim.export.traced_valve import EXPORTED_INPUTS, TracedValve, trace_valve
from valvesim.inputs import Constant, Table, evaluate
from valvesim.simulation.scenario import Scenario
from valvesim.valve.fluid import COMPUTED_RANGE

TEST_STEP, TEST_SAMPLES = 5e-4, 100  # s between samples of the test, and how many of them
TEST_ERROR, TEST_ERROR_FIXED = 1e-4, 1e-3  # of a channel's span, with error control and in fixed steps
TEST_FIXED_STEPS = 50  # to a sample


def export_c(scenario: Scenario, folder: str | Path) -> list[Path]:
    """Write header, code, test and CMake file of a scenario's valve into a folder; returns the paths.

    Raises InputError as `trace_valve` does, and SolveError where the run for the test fails.
    """
    valve = trace_valve(scenario)
    files = {name: (C_FOLDER / name).read_text() for name in ("valve.h", *MODEL_FILES)}
    files |= model_sources(valve)
    files["valve_test.c"] = _test(valve)
    files["CMakeLists.txt"] = (C_FOLDER / "CMakeLists.c.txt").read_text()
    Path(folder).mkdir(parents=True, exist_ok=True)
    paths = []
    for name, text in files.items():
        paths.append(Path(folder) / name)
        paths[-1].write_text(text, encoding="utf-8")
    return paths


def flown_scenario(scenario: Scenario) -> Scenario:
    """What the test flies: half the rated current within a millisecond, oil that warms, all else held."""
    drive, rated = scenario.drive, float(scenario.valve.rated_current)
    first = float(evaluate(scenario.command, 0.0))
    more = drive.command_for_current(0.5 * rated, float(scenario.valve.coil_resistance))
    end = TEST_STEP * TEST_SAMPLES
    oil = float(evaluate(scenario.oil_temperature, 0.0))
    warm = min(oil + 1.0, COMPUTED_RANGE[1])
    changed: dict[str, Any] = {
        f"{name}_pressure": Constant(value=float(evaluate(command, 0.0)))
        for name, command in zip(("supply", "return", "load"), scenario.pressures(), strict=True)
    }
    effects = tuple(active for active in scenario.effects if active.effect.reading is None)
    changed |= {
        "duration": end,
        "command": Table(times=(0.0, 5e-3, 6e-3, end), values=(first, first, first + more, first + more)),
        "oil_temperature": Table(times=(0.0, end), values=(oil, warm)),
        "output_rate": 1.0 / TEST_STEP,
        "tolerance": 1e-8,
        "effects": effects,
        "channels": (),
    }
    return replace(scenario, **changed)


def _test(valve: TracedValve) -> str:
    """The text of the test: inputs and what `simulate` has of states and outputs, at every sample."""
    scenario = flown_scenario(valve.scenario)
    times, values = reference_values(scenario)
    commands = (scenario.command, None, *scenario.pressures(), scenario.oil_temperature)
    inputs = np.array([np.zeros_like(times) if one is None else evaluate(one, times) for one in commands]).T
    checked = [
        (kind, k, values[one.name])
        for kind, variables in (("STATE", valve.states), ("OUTPUT", valve.outputs))
        for k, one in enumerate(variables)
        if one.name in values and np.ptp(values[one.name]) > 1e-6 * one.scale
    ]
    columns = np.array([values for _, _, values in checked]).T
    spans = np.ptp(columns, axis=0)

    def rows(table: np.ndarray) -> str:
        return ",\n".join("    {" + ", ".join(f"{value!r}" for value in row) + "}" for row in table.tolist())

    places = ", ".join(f"{k} + {'VALVE_STATES' if kind == 'OUTPUT' else '0'}" for kind, k, _ in checked)
    figures = {
        "@SAMPLES@": str(len(times)), "@INPUTS@": str(len(EXPORTED_INPUTS)), "@CHANNELS@": str(len(checked)),
        "@STEP@": repr(TEST_STEP), "@FIXED_STEPS@": str(TEST_FIXED_STEPS), "@ERROR@": repr(TEST_ERROR),
        "@ERROR_FIXED@": repr(TEST_ERROR_FIXED), "@INPUT_ROWS@": rows(inputs), "@EXPECTED_ROWS@": rows(columns),
        "@PLACES@": places, "@SPANS@": ", ".join(repr(span) for span in spans.tolist()),
    }  # fmt: skip
    text = (C_FOLDER / "valve_test.c").read_text()
    for mark, value in figures.items():
        text = text.replace(mark, value)
    return text
