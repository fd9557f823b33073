"""A valve that is somebody else's FMU (FMI 2.0 or 3.0), flown through FMPy where a run would integrate the equations.

It stands where a `Valve` does: in a scenario, in responses and on the bench. What reads a valve's equations (its state
at rest, linear models, fits) has none to read and says so.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.channels import Channel
from valvesim.errors import InputError, SolveError, nearest
from valvesim.inputs import Command, evaluate
from valvesim.simulation.result import Result, output_channels
from valvesim.units import convert
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, kw_only=True)
class FmuValve(Valve):
    """A valve as an FMU.

    `names` tells what the FMU calls a channel (`{"spool_position": "x_spool"}`) [the same name]; `units` the unit of a
    variable that declares none, or another [SI]; `start_values` are parameters by their names in the FMU, in its units.
    `step` is the communication step (co-simulation), `tolerance` the relative one of CVode (model exchange, where the
    FMU has no co-simulation). Of the quantities of a valve, rated current and pressures are those of the tests; all
    others mean nothing here. Raises InputError for a file that is no FMU, and for an FMU that lacks a named variable.
    """

    path: str | Path = ""
    names: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    start_values: Mapping[str, float] = field(default_factory=dict)
    step: float = 1e-4
    tolerance: float = 1e-6

    def __post_init__(self):
        super().__post_init__()
        if not self.name:
            object.__setattr__(self, "name", f"FMU {Path(self.path).name}")
        for name, value, least in (("step", self.step, 1e-9), ("tolerance", self.tolerance, 1e-12)):
            if not least <= value <= 1.0:
                raise InputError(f"{value:g} is outside [{least:g}, 1]", key=f"FmuValve.{name}", joint=" = ")
        known = {one.name for one in self.description.modelVariables}
        for name in (*self.names.values(), *self.start_values):
            if name not in known:
                raise InputError(f"has no variable {name!r}{nearest(name, known)}", file=self.path)

    @property
    def description(self) -> Any:
        """The FMU's model description, FMPy's. InputError where there is none."""
        from fmpy import read_model_description

        if not Path(self.path).is_file():
            raise InputError("no such file", file=self.path)
        try:
            about = read_model_description(str(self.path), validate=False)
        except Exception as error:  # FMPy raises what its XML reader does
            raise InputError(f"is no FMU that FMPy reads ({type(error).__name__})", file=self.path) from None
        if about.fmiVersion.split(".")[0] not in ("2", "3"):
            raise InputError(f"is of FMI {about.fmiVersion}; 2.0 and 3.0 are flown", file=self.path)
        return about

    def at(self, *_: Any, **__: Any) -> Any:
        """No coefficients: InputError."""
        raise InputError("is an FMU, whose equations are not known: it can be flown, and nothing else", file=self.path)

    def simulate(self, scenario: Any, progress: Callable[[float], None] | None = None) -> Result:
        """Fly a scenario: its command, pressures and oil temperature go in, the channels that the FMU has come out.

        Raises InputError for effects (they are of this package's equations), for a command that the FMU does not take,
        for an input that varies and has no variable, and for wrong units; SolveError where the FMU fails.
        """
        if scenario.effects:
            raise InputError("effects belong to this package's equations, not to an FMU", key="effects")
        about = self.description
        inputs = self._inputs(scenario, about)
        times = np.arange(int(np.floor(scenario.duration * scenario.output_rate * (1 + 1e-12))) + 1)
        times = np.minimum(times / scenario.output_rate, scenario.duration)
        wanted = self._outputs(scenario, about)
        variables = list(dict.fromkeys(name for _, name, _ in wanted))
        with ExitStack() as stack:
            if about.coSimulation is not None:
                columns = _co_simulate(self, about, inputs, variables, times, stack, progress)
            else:
                columns = _exchange(self, inputs, variables, times)
        values = {
            channel.name: np.asarray(convert(columns[name], unit, channel.unit, f"{name} of the FMU"), dtype=float)
            for channel, name, unit in wanted
        }
        commands = dict(zip(("supply_pressure", "return_pressure", "load_pressure"), scenario.pressures(), strict=True))
        commands |= {scenario.drive.command_name: scenario.command, "oil_temperature": scenario.oil_temperature}
        for name, command in commands.items():
            values.setdefault(name, evaluate(command, times))
        channels = tuple(channel for channel in output_channels(scenario) if channel.name in values)
        return Result(scenario, times, channels, values, {})

    def _inputs(self, scenario: Any, about: Any) -> dict[str, tuple[Command, str, str]]:
        """{variable: (command, its unit here, the variable's unit)}."""
        known = {one.name: one for one in about.modelVariables if one.causality == "input"}
        if scenario.part_temperatures:
            raise InputError("an FMU has no input for a part's temperature", key="thermal.part_temperatures")
        drive = scenario.drive
        supply, back, load = scenario.pressures()
        given: dict[str, tuple[Command, str]] = {
            drive.command_name: (scenario.command, drive.command_unit), "supply_pressure": (supply, "Pa"),
            "return_pressure": (back, "Pa"), "load_pressure": (load, "Pa"),
            "oil_temperature": (scenario.oil_temperature, "degC"),
        }  # fmt: skip
        found = {}
        for channel, (command, unit) in given.items():
            name = self.names.get(channel, channel)
            if name in known:
                found[name] = (command, unit, self._unit(known[name], unit))
            elif channel == drive.command_name:
                told = f"has no input {name!r}{nearest(name, known)}; FmuValve(names={{'{channel}': ...}}) says which"
                raise InputError(told, file=self.path)
            elif np.ptp(evaluate(command, np.linspace(0.0, scenario.duration, 101))) > 0.0:
                raise InputError(f"the FMU has no input {name!r}, and the scenario varies it", key=channel)
        return found

    def _outputs(self, scenario: Any, about: Any) -> list[tuple[Channel, str, str]]:
        """(channel, variable, unit of the variable) of every channel that the FMU has."""
        known = {one.name: one for one in about.modelVariables if one.causality in ("output", "local")}
        pairs = ((self.names.get(channel.name, channel.name), channel) for channel in output_channels(scenario))
        found = [(channel, name, self._unit(known[name], channel.unit)) for name, channel in pairs if name in known]
        if not found:
            raise InputError(f"has no output by a channel's name; it has {', '.join(known)}", file=self.path)
        return found

    def _unit(self, variable: Any, default: str) -> str:
        return self.units.get(variable.name) or variable.unit or default


EVEN_STEPS = 20  # communication steps between two samples up to which they are even


def _communication_points(scenario_times: np.ndarray, breaks: np.ndarray, step: float) -> np.ndarray:
    """Times at which the FMU is spoken to: samples and breaks; `step` before each of them, and before that ever longer.

    So a sample of a slow run hears of an input that is late by half a step, not by half the time between samples.
    """
    edges = np.unique(np.concatenate([scenario_times, breaks[(breaks > 0.0) & (breaks < scenario_times[-1])]]))
    points = [edges[:1]]
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if b - a <= EVEN_STEPS * step:
            points.append(np.linspace(a, b, max(int(np.ceil((b - a) / step - 1e-9)), 1) + 1)[1:])
        else:
            before = b - step * (2.0 ** np.arange(np.ceil(np.log2((b - a) / step)) + 1) - 1.0)
            points.append(before[before > a + 0.5 * step][::-1])
    return np.concatenate(points)


def _input_tables(
    valve: FmuValve, inputs: dict[str, Any], times: np.ndarray
) -> tuple[np.ndarray, list[np.ndarray], list[float]]:  # fmt: skip
    """(communication points (n,), of each input what it is in the middle of the step from each (n,), and at zero)."""
    end = float(times[-1])
    breaks = np.concatenate([command.pieces(end)[:, 0] for command, _, _ in inputs.values()])
    points = _communication_points(times, breaks, valve.step)
    middles = np.append((points[:-1] + points[1:]) / 2.0, points[-1])
    tables, first = [], []
    for name, (command, own, unit) in inputs.items():
        about = f"{name} of the FMU"
        tables.append(np.asarray(convert(evaluate(command, middles), own, unit, about), dtype=float))
        first.append(float(convert(float(evaluate(command, 0.0)), own, unit, about)))
    return points, tables, first


def _co_simulate(
    valve: FmuValve, about: Any, inputs: dict[str, Any], outputs: list[str], times: np.ndarray, stack: ExitStack,
    progress: Callable[[float], None] | None,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Co-simulation; an input holds within a communication step what it is in its middle."""
    from fmpy import extract, instantiate_fmu

    points, tables, first = _input_tables(valve, inputs, times)
    references = {one.name: one.valueReference for one in about.modelVariables}
    read, put = [references[name] for name in outputs], [references[name] for name in inputs]
    folder = extract(str(valve.path))
    stack.callback(shutil.rmtree, folder, ignore_errors=True)
    told: list[str] = []
    try:
        fmu = instantiate_fmu(folder, about, "CoSimulation", logger=lambda *words: told.append(_told(words)))
        stack.callback(_free, fmu)
        number = about.fmiVersion[0]
        put_values, get_values = (fmu.setReal, fmu.getReal) if number == "2" else (fmu.setFloat64, fmu.getFloat64)
        if number == "2":
            fmu.setupExperiment(startTime=0.0)
        if valve.start_values:
            put_values([references[name] for name in valve.start_values], list(valve.start_values.values()))
        fmu.enterInitializationMode()
        put_values(put, first)
        fmu.exitInitializationMode()
        rows = np.empty((len(times), len(outputs)))
        rows[0], sample = get_values(read), 1
        for k in range(len(points) - 1):
            put_values(put, [float(table[k]) for table in tables])
            fmu.doStep(currentCommunicationPoint=points[k], communicationStepSize=points[k + 1] - points[k])
            if points[k + 1] >= times[sample]:
                rows[sample], sample = get_values(read), sample + 1
                if progress is not None and sample % 100 == 0:
                    progress(sample / len(times))
    except InputError:
        raise
    except Exception as error:  # FMPy raises plain exceptions
        raise SolveError(f"the FMU {Path(valve.path).name} fails: {'; '.join(told[-2:]) or error}") from None
    return dict(zip(outputs, rows.T, strict=True))


def _told(words: tuple[Any, ...]) -> str:
    """What an FMU says of a failure: the last text of its message."""
    texts = [word.decode(errors="replace") if isinstance(word, bytes) else word for word in words]
    return next((text for text in reversed(texts) if isinstance(text, str)), "")


def _free(fmu: Any) -> None:
    fmu.freeInstance()


def _exchange(
    valve: FmuValve, inputs: dict[str, Any], outputs: list[str], times: np.ndarray
) -> dict[str, np.ndarray]:  # fmt: skip
    """Model exchange by FMPy's CVode. Inputs hold between events as in co-simulation: CVode's right-hand side is not
    told of inputs that change while it steps.
    """
    from fmpy import simulate_fmu

    points, tables, _ = _input_tables(valve, inputs, times)
    table = np.zeros(2 * len(points) - 2, dtype=[("time", float), *((name, float) for name in inputs)])
    table["time"] = np.repeat(points, 2)[1:-1]
    for name, column in zip(inputs, tables, strict=True):
        table[name] = np.repeat(column[:-1], 2)
    try:
        flown = simulate_fmu(
            str(valve.path), fmi_type="ModelExchange", stop_time=float(times[-1]), input=table, output=outputs,
            output_interval=float(times[1] - times[0]) if len(times) > 1 else float(times[-1]),
            relative_tolerance=valve.tolerance, start_values=dict(valve.start_values), validate=False,
            record_events=False,
        )  # fmt: skip
    except Exception as error:  # FMPy raises plain exceptions
        raise SolveError(f"the FMU {Path(valve.path).name} fails: {error}") from None
    return {name: np.interp(times, flown["time"], flown[name]) for name in outputs}
