"""Reference results beside an FMU in the layout of the FMI cross-check: `_in.csv`, `_ref.csv`, `_ref.opt`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS
from valvesim.export.traced_valve import EXPORTED_INPUTS, TracedValve, trace_valve
from valvesim.inputs import evaluate
from valvesim.io import write_atomically
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario
from valvesim.valve.coefficients import PART_NAMES

RUN_CHANNELS = {channel.name for channel in SIGNAL_CHANNELS} | {f"{name}_temperature" for name in PART_NAMES}


def reference_values(scenario: Scenario) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(times (n_t,), channels by name) of a run, with part temperatures that are exact at every sample.

    A run's own are straight between knots that are set for the coefficients: 1e-3 of their span off in a short run.
    """
    result = simulate(scenario)
    values = dict(result.values)
    for name in PART_NAMES:
        exact = getattr(scenario.temperatures(knots=result.time).parts, name)
        if f"{name}_temperature" not in sensed_channels(scenario):
            values[f"{name}_temperature"] = np.broadcast_to(exact, result.time.shape)
    return result.time, values


def sensed_channels(scenario: Scenario) -> set[str]:
    """The channels that a sensor effect acts on: a run has their reading, an FMU both."""
    return {active.effect.channel for active in scenario.effects if active.effect.reading is not None}


def write_reference(scenario: Scenario, fmu: str | Path) -> list[Path]:
    """Simulate a scenario; write its inputs, outputs (SI, °C) and options beside an FMU. Returns the paths."""
    valve, (times, values) = trace_valve(scenario), reference_values(scenario)
    stem = Path(fmu).with_suffix("")
    commands = (scenario.command, None, *scenario.pressures(), scenario.oil_temperature)
    inputs = {
        one.name: evaluate(command, times)
        for one, command, _ in zip(valve.inputs, commands, EXPORTED_INPUTS, strict=True)
        if command is not None
    }
    outputs = {name: values[channel] for name, channel in equivalent_channels(valve).items()}
    options = {
        "StartTime": 0.0, "StopTime": scenario.duration, "StepSize": 1.0 / scenario.output_rate,
        "RelTol": scenario.tolerance,
    }  # fmt: skip
    told = "".join(f"{name}, {float(value)!r}\n" for name, value in options.items())
    return [
        _columns(Path(f"{stem}_in.csv"), {"time": times, **inputs}),
        _columns(Path(f"{stem}_ref.csv"), {"time": times, **outputs}),
        write_atomically(Path(f"{stem}_ref.opt"), lambda path: _write_text(Path(path), told)),
    ]


def equivalent_channels(valve: TracedValve) -> dict[str, str]:
    """{state or output of the exported valve: the channel of a run that is the same}."""
    measured = sensed_channels(valve.scenario)
    found = {}
    for one in (*valve.states, *valve.outputs):
        plain = one.name.removeprefix("measured_")
        channel = "oil_temperature" if one.name == "pilot_oil_temperature" else plain
        if channel in RUN_CHANNELS | {c.name for c in valve.scenario.model.state_channels}:
            if (plain != one.name) == (channel in measured):
                found[one.name] = channel
    return found


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _columns(path: Path, columns: dict[str, np.ndarray]) -> Path:
    table, head = np.column_stack(list(columns.values())), ",".join(f'"{name}"' for name in columns)
    return write_atomically(
        path, lambda temporary: np.savetxt(temporary, table, delimiter=",", header=head, comments="", fmt="%.12g")
    )
