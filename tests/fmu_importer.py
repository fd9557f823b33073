"""Small importers over FMPy's bindings, for the tests of `export`: one loop for each of the four kinds of FMU."""

from __future__ import annotations

import contextlib
import ctypes
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.export.fmi_variables import REFERENCES
from valvesim.export.traced_valve import TracedValve
from valvesim.inputs import evaluate


class Refused(Exception):
    """A call that did not return OK, with the messages so far."""


class Importer:
    """An instance of an FMU in a folder: `call` is one function of the standard, `messages` what the FMU has told."""

    def __init__(self, archive: Path, *, co_simulation: bool, **options: Any):
        import fmpy
        from fmpy import fmi2, fmi3

        self.folder = fmpy.extract(str(archive))
        self.description = fmpy.read_model_description(self.folder)
        self.number = int(self.description.fmiVersion[0])
        self.messages: list[str] = []
        kinds = {
            (2, True): fmi2.FMU2Slave, (2, False): fmi2.FMU2Model,
            (3, True): fmi3.FMU3Slave, (3, False): fmi3.FMU3Model,
        }  # fmt: skip
        kind = self.description.coSimulation if co_simulation else self.description.modelExchange
        self.fmu = kinds[self.number, co_simulation](
            guid=self.description.guid if self.number == 2 else self.description.instantiationToken,
            unzipDirectory=self.folder, modelIdentifier=kind.modelIdentifier, instanceName="valve",
        )  # fmt: skip
        self.names = {one.name: one for one in self.description.modelVariables}
        if self.number == 3:
            self.fmu.instantiate(logMessage=lambda _, status, category, text: self._hear(text), **options)
        else:
            self.fmu.instantiate(callbacks=self._fmi2_callbacks(fmi2))

    def _hear(self, text: bytes) -> None:
        self.messages.append(text.decode())

    def _fmi2_callbacks(self, fmi2: Any) -> Any:
        def log(environment: Any, name: bytes, status: int, category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
        return callbacks

    def raw(self, name: str, *arguments: Any) -> int:
        """A function of the standard by its name without the prefix; its status."""
        return int(getattr(self.fmu.dll, f"fmi{self.number}{name}")(self.fmu.component, *arguments))

    def call(self, name: str, *arguments: Any) -> None:
        """The same; Refused unless it is well."""
        if self.raw(name, *arguments):
            raise Refused(self.messages[-1] if self.messages else name)

    def set(self, values: dict[str, float]) -> None:
        references = (ctypes.c_uint32 * len(values))(*(self.reference(name) for name in values))
        numbers = (ctypes.c_double * len(values))(*values.values())
        count = ctypes.c_size_t(len(values))
        if self.number == 2:
            self.call("SetReal", references, count, numbers)
        else:
            self.call("SetFloat64", references, count, numbers, count)

    def get(self, names: list[str]) -> np.ndarray:
        references = (ctypes.c_uint32 * len(names))(*(self.reference(name) for name in names))
        numbers, count = (ctypes.c_double * len(names))(), ctypes.c_size_t(len(names))
        if self.number == 2:
            self.call("GetReal", references, count, numbers)
        else:
            self.call("GetFloat64", references, count, numbers, count)
        return np.array(numbers)

    def reference(self, name: str) -> int:
        return int(self.names[name].valueReference)

    def start(self, values: dict[str, float] | None = None, *, tolerance: float | None = None, stop=0.0) -> None:
        """Through initialization, with values set in it."""
        about = (ctypes.c_bool if self.number == 3 else ctypes.c_int)
        timing = (
            about(tolerance is not None), ctypes.c_double(tolerance or 0.0), ctypes.c_double(0.0),
            about(stop > 0.0), ctypes.c_double(stop),
        )  # fmt: skip
        if self.number == 2:
            self.call("SetupExperiment", *timing)
            self.call("EnterInitializationMode")
        else:
            self.call("EnterInitializationMode", *timing)
        self.set(values or {})
        self.call("ExitInitializationMode")

    def step(self, time: float, size: float) -> float:
        """One communication step; where it ended."""
        if self.number == 2:
            self.call("DoStep", ctypes.c_double(time), ctypes.c_double(size), ctypes.c_int(1))
            return time + size
        flags = [ctypes.c_bool() for _ in range(3)]
        ended = ctypes.c_double()
        self.call(
            "DoStep", ctypes.c_double(time), ctypes.c_double(size), ctypes.c_bool(True),
            *(ctypes.byref(flag) for flag in flags), ctypes.byref(ended),
        )  # fmt: skip
        return ended.value

    def slopes(self, values: dict[str, float]) -> None:
        """First derivatives of inputs, FMI 2.0."""
        references = (ctypes.c_uint32 * len(values))(*(self.reference(name) for name in values))
        orders = (ctypes.c_int * len(values))(*([1] * len(values)))
        numbers = (ctypes.c_double * len(values))(*values.values())
        self.call("SetRealInputDerivatives", references, ctypes.c_size_t(len(values)), orders, numbers)

    def sensitivities(self, function: str, unknowns: list[str], knowns: list[str], seed: list[float]) -> np.ndarray:
        """`GetDirectionalDerivative` or `GetAdjointDerivative`."""
        count = len(unknowns if function == "GetDirectionalDerivative" else knowns)
        out, given = (ctypes.c_double * count)(), (ctypes.c_double * len(seed))(*seed)
        listed = []
        for names in (unknowns, knowns):
            references = (ctypes.c_uint32 * len(names))(*(self.reference(name) for name in names))
            listed += [references, ctypes.c_size_t(len(names))]
        sizes = ([], []) if self.number == 2 else ([ctypes.c_size_t(len(seed))], [ctypes.c_size_t(count)])
        self.call(function, *listed, given, *sizes[0], out, *sizes[1])
        return np.array(out)

    def close(self) -> None:
        with contextlib.suppress(Exception):
            getattr(self.fmu.dll, f"fmi{self.number}FreeInstance")(ctypes.c_void_p(self.fmu.component))
        from fmpy import freeLibrary

        freeLibrary(self.fmu.dll._handle)
        shutil.rmtree(self.folder, ignore_errors=True)


@contextlib.contextmanager
def opened(archive: Path, *, co_simulation: bool = True, **options: Any) -> Iterator[Importer]:
    """An importer, and its folder removed in the end."""
    importer = Importer(archive, co_simulation=co_simulation, **options)
    try:
        yield importer
    finally:
        importer.close()


def input_table(valve: TracedValve, times: np.ndarray) -> dict[str, np.ndarray]:
    """What a scenario commands at times, by the names of the inputs."""
    scenario = valve.scenario
    commands = (scenario.command, None, *scenario.pressures(), scenario.oil_temperature)
    return {
        one.name: evaluate(command, times)
        for one, command in zip(valve.inputs, commands, strict=True)
        if command is not None
    }


def output_names(valve: TracedValve) -> list[str]:
    """States, then outputs."""
    return [one.name for one in (*valve.states, *valve.outputs)]


def fly(
    archive: Path, valve: TracedValve, times: np.ndarray, *, after: Callable[[Importer], None] | None = None
) -> dict[str, np.ndarray]:
    """Co-simulation with inputs straight between `times` (m,): every state and output, (m,) each.

    FMI 2.0 is told the inputs' derivatives, FMI 3.0 is given the inputs in intermediate updates.
    """
    table, names = input_table(valve, times), output_names(valve)
    rows, span = np.empty((len(times), len(names))), [0]

    def values_at(time: float) -> dict[str, float]:
        k = span[0]
        share = (time - times[k]) / (times[k + 1] - times[k])
        return {name: float(column[k] + share * (column[k + 1] - column[k])) for name, column in table.items()}

    def update(environment, time, may_set, may_get, done, can_stop, stop, stop_time):  # type: ignore[no-untyped-def]
        if may_set:
            importer.set(values_at(time))

    number = 2 if "2" in archive.stem else 3
    options: dict[str, Any] = {}
    if number == 3:
        places = [REFERENCES["input"] + k for k, one in enumerate(valve.inputs) if one.name in table]
        options = {"intermediateUpdate": update, "requiredIntermediateVariables": places}
    with opened(archive, **options) as importer:
        importer.start({name: float(column[0]) for name, column in table.items()})
        rows[0] = importer.get(names)
        for k in range(len(times) - 1):
            span[0], size = k, float(times[k + 1] - times[k])
            importer.set({name: float(column[k]) for name, column in table.items()})
            if number == 2:
                importer.slopes({name: float(column[k + 1] - column[k]) / size for name, column in table.items()})
            importer.step(float(times[k]), size)
            if after is not None:
                after(importer)
            rows[k + 1] = importer.get(names)
    return dict(zip(names, rows.T, strict=True))
