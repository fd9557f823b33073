"""The exported FMUs measured: validity, agreement with `simulate`, importers, sanitizers, memory, wrong calls, speed.

    python benchmarks/fmu.py [validity agreement effects importers sanitizers memory fuzz speed]

Needs FMPy (its headers and CVode) and gcc. What is printed stands in docs/fmu.md.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import valvesim as vs
from valvesim.export.c_model import model_hash
from valvesim.export.fmi_variables import REFERENCES
from valvesim.export.fmu import export_fmu, fmu_sources
from valvesim.export.reference_results import equivalent_channels, reference_values
from valvesim.export.traced_valve import trace_valve
from valvesim.inputs import evaluate
from valvesim.valve.catalogue import CATALOGUE

HERE = Path(__file__).parent
WORK = Path(tempfile.mkdtemp(prefix="valvesim-fmu-"))
TIGHT = 1e-6  # tolerance of the FMU in comparisons of long flights; the references have 1e-9
warnings.simplefilter("ignore")


def polyline(command, end: float, step: float) -> vs.Table:
    """A command as straight lines between samples, which every importer can give."""
    times = np.arange(round(end / step) + 1) * step
    return vs.Table(times=tuple(times.tolist()), values=tuple(evaluate(command, times).tolist()))


def cases() -> dict[str, vs.Scenario]:
    launch = vs.load_scenario("launch_shock")
    chirp = vs.Chirp(amplitude=18e-3, start_frequency=5.0, end_frequency=150.0, duration=1.0)
    return {
        "launch shock, 90 s": replace(launch, command=polyline(launch.command, 90.0, 2e-3)),
        "chirp 5 to 150 Hz, 18 mA, stops struck": vs.Scenario(
            title="Chirp", duration=1.0, command=polyline(chirp, 1.0, 1e-4), output_rate=1e4,
            thermal=vs.Thermal(network=None),
        ),
        "step of 3 V": vs.Scenario(
            title="Voltage step", duration=0.06, command=vs.Step(after=3.0, time=5e-3), output_rate=1e4,
            drive=vs.VoltageDrive(),
        ),
    }  # fmt: skip


def with_effect(name: str) -> vs.Scenario:
    """A short flight that every effect feels, of either sign, with oil that warms."""
    effect = CATALOGUE[name]
    bound = effect.on("spool_position") if effect.reading is not None else effect
    active = bound(**{bound.amplitude.name: bound.amplitude.typical})
    sine = polyline(vs.Sine(amplitude=6e-3, frequency=40.0), 0.05, 1e-4)
    voltage = name == "coil_resistance_drift"
    return vs.Scenario(
        title=name, duration=0.05, command=vs.Table(times=sine.times, values=tuple(600.0 * v for v in sine.values))
        if voltage else sine, drive=vs.VoltageDrive() if voltage else vs.CurrentDrive(), output_rate=1e4,
        oil_temperature=vs.Table(times=(0.0, 0.05), values=(20.0, 30.0)), effects=(active,),
    )  # fmt: skip


class Flight:
    """A case, its archives and binaries, and its reference."""

    def __init__(self, case: vs.Scenario, name: str, versions: tuple[str, ...] = ("2.0", "3.0")):
        self.case, self.valve, self.folder = case, trace_valve(case), WORK / name
        self.folder.mkdir(exist_ok=True)
        self.names = [one.name for one in (*self.valve.states, *self.valve.outputs)]
        self.references = [REFERENCES["state"] + k for k in range(len(self.valve.states))]
        self.references += [REFERENCES["output"] + k for k in range(len(self.valve.outputs))]
        self.binaries, self.archives = {}, {}
        for version in versions:
            written = export_fmu(case, self.folder / f"fmi{version[0]}.fmu", version=version)
            self.archives[version[0]] = written.path
            with zipfile.ZipFile(written.path) as archive:
                self.binaries[version[0]] = Path(archive.extract(written.binary, self.folder / version[0]))
        self._write_inputs()

    def _write_inputs(self) -> None:
        """Inputs at every sample, and twice where one jumps."""
        case, times = (
            self.case,
            np.arange(round(self.case.duration * self.case.output_rate) + 1) / self.case.output_rate,
        )
        commands = (case.command, None, *case.pressures(), case.oil_temperature)
        used = [(k, one) for k, one in enumerate(commands) if one is not None]
        late = np.array([evaluate(one, times) for _, one in used])
        early = np.array([evaluate(one, np.nextafter(times, -np.inf)) for _, one in used])
        early[:, 0] = late[:, 0]
        jumps = np.any(np.abs(late - early) > 1e-9 * (np.abs(late) + np.abs(early)), axis=0)
        rows = []
        for k, t in enumerate(times):
            rows += [(t, *early[:, k])] if jumps[k] else []
            rows.append((t, *late[:, k]))
        self.inputs, self.times = self.folder / "in.csv", times
        head = ",".join(["0", *(str(REFERENCES["input"] + k) for k, _ in used)])
        np.savetxt(self.inputs, np.array(rows), delimiter=",", header=head, comments="", fmt="%.17g")

    def reference(self, tolerance: float = 1e-9) -> dict[str, np.ndarray]:
        _, values = reference_values(replace(self.case, tolerance=tolerance))
        return {name: values[channel] for name, channel in equivalent_channels(self.valve).items()}

    def c(self, program: Path, number: str, how: str, last: float | int) -> tuple[dict[str, np.ndarray], str]:
        """Flown by the importer in C: (columns, what it printed)."""
        out = self.folder / "out.csv"
        words = [program, self.binaries[number], number, model_hash(self.valve), how, self.inputs, out, repr(last)]
        bare = {"PATH": "/nowhere", "LANG": "C"}  # no Python can be found
        done = subprocess.run(
            [*map(str, words), *map(str, self.references)], env=bare, capture_output=True, text=True, check=False
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(done.stderr)
        return self.columns(np.loadtxt(out, delimiter=",")), done.stdout

    def columns(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """The last of the rows at every time."""
        kept = np.append(rows[1:, 0] > rows[:-1, 0], True)
        return dict(zip(self.names, rows[kept, 1:].T, strict=True))

    def fmpy(self, number: str, tolerance: float, until: int | None = None) -> dict[str, np.ndarray]:
        """Co-simulation by FMPy's bindings, FMI 2.0 with the inputs' derivatives, FMI 3.0 with intermediate updates."""
        sys.path.insert(0, str(HERE.parent / "tests"))
        from fmu_importer import opened

        rows = np.loadtxt(self.inputs, delimiter=",", skiprows=1)
        heads = self.inputs.read_text().partition("\n")[0].split(",")[1:]
        inputs = [self.valve.inputs[int(head) - REFERENCES["input"]].name for head in heads]
        at = [0]

        def update(environment, now, may_set, may_get, done, can_stop, stop, stop_time):
            if may_set:
                a, b = rows[at[0]], rows[at[0] + 1]
                one.set(dict(zip(inputs, a[1:] + (now - a[0]) / (b[0] - a[0]) * (b[1:] - a[1:]), strict=True)))

        more = {} if number == "2" else {
            "intermediateUpdate": update, "requiredIntermediateVariables": [int(head) for head in heads],
        }  # fmt: skip
        out = []
        with opened(self.archives[number], **more) as one:
            one.start(dict(zip(inputs, rows[0, 1:], strict=True)), tolerance=tolerance)
            out.append(one.get(self.names))
            for k in range(min(len(rows) - 1, until or len(rows))):
                size = rows[k + 1, 0] - rows[k, 0]
                if size <= 0.0:
                    continue
                at[0] = k
                one.set(dict(zip(inputs, rows[k, 1:], strict=True)))
                if number == "2":
                    one.slopes(dict(zip(inputs, (rows[k + 1, 1:] - rows[k, 1:]) / size, strict=True)))
                one.step(rows[k, 0], size)
                out.append(one.get(self.names))
        return dict(zip(self.names, np.array(out).T, strict=True))

    def cvode(self, number: str, tolerance: float) -> dict[str, np.ndarray]:
        """Model exchange by FMPy's CVode."""
        from fmpy import simulate_fmu

        rows = np.loadtxt(self.inputs, delimiter=",", skiprows=1)
        heads = self.inputs.read_text().partition("\n")[0].split(",")[1:]
        inputs = [self.valve.inputs[int(head) - REFERENCES["input"]].name for head in heads]
        table = np.zeros(len(rows), dtype=[("time", float), *((name, float) for name in inputs)])
        for k, name in enumerate(("time", *inputs)):
            table[name] = rows[:, k]
        flown = simulate_fmu(
            str(self.archives[number]), fmi_type="ModelExchange", stop_time=self.case.duration, input=table,
            output=self.names, output_interval=1.0 / self.case.output_rate, relative_tolerance=tolerance,
            validate=False, record_events=False,
        )  # fmt: skip
        at = np.searchsorted(flown["time"], self.times + 1e-9) - 1
        return {name: flown[name][at] for name in self.names}


def exchanged(flight: Flight, number: str) -> tuple[float, tuple[float, str]]:
    """(tolerance, error) of FMPy's CVode at the tightest tolerance at which it gets through.

    With inputs that jump each millisecond and hold: FMPy tells CVode's right-hand side of no other change.
    """
    case = flight.case
    held = replace(case, command=Held(case.command, 1e-3), oil_temperature=vs.Constant(value=25.0), output_rate=1e4)
    flight = Flight(held, f"exchanged{number}", (f"{number}.0",))
    reference = flight.reference()
    for tolerance in (1e-8, 1e-7, 1e-6, 1e-5):
        try:
            flown = flight.cvode(number, tolerance)
            between = np.arange(len(flight.times)) % 10 != 0  # at a jump a sample may be on either side of it
            return tolerance, worst(
                {name: column[between] for name, column in flown.items()},
                {name: column[between] for name, column in reference.items()},
            )
        except RuntimeError as error:
            print(f"    CVode fails at {tolerance:g}: {str(error)[-70:]}", flush=True)
    return 0.0, (float("nan"), "")


def worst(flown: dict[str, np.ndarray], reference: dict[str, np.ndarray]) -> tuple[float, str]:
    """(largest error as a share of its channel's span, the channel)."""
    found = (0.0, "")
    for name, expected in ((name, reference[name]) for name in reference if name in flown):
        count = min(len(expected), len(flown[name]))
        span = np.ptp(expected)
        if name.endswith("temperature") and span < 0.01:
            continue  # at rest but for a trickle of heat
        if span > 1e-9 * np.max(np.abs(expected)) + 1e-15:
            found = max(found, (float(np.max(np.abs(flown[name][:count] - expected[:count])) / span), name))
    return found


def importer(flags: tuple[str, ...] = ("-O2",)) -> Path:
    """The program of `fmu_importer.c`, compiled with the standard's headers."""
    import fmpy

    program = WORK / ("importer" + "".join(flags).replace("=", "").replace(",", ""))
    headers = Path(fmpy.__file__).parent / "c-code"
    command = [
        "gcc",
        "-std=gnu11",
        *flags,
        f"-I{headers}",
        str(HERE / "fmu_importer.c"),
        "-o",
        str(program),
        "-ldl",
        "-lm",
    ]
    subprocess.run(command, check=True)
    return program


def validity() -> None:
    from fmpy.validation import validate_fmu

    for name, case in {**cases(), "isothermal": vs.Scenario(thermal=vs.Thermal(network=None))}.items():
        for version in ("2.0", "3.0"):
            export_fmu(case, WORK / "a.fmu", version=version, compiler="")
            print(f"validate_fmu, FMI {version}, {name}: {validate_fmu(str(WORK / 'a.fmu'))}")


def agreement() -> None:
    program = importer()
    chosen = os.environ.get("CASE", "")
    for k, (name, case) in enumerate(cases().items()):
        if chosen not in name:
            continue
        flight = Flight(case, f"case{k}")
        reference = flight.reference()
        own = worst(flight.reference(case.tolerance), reference)
        print(f"\n{name}: simulate at its own tolerance {case.tolerance:g}: {own[0]:.1e} ({own[1]})", flush=True)
        long = case.duration > 10.0
        for number in ("2", "3"):
            for tolerance in (case.tolerance, TIGHT, *(() if long else (1e-8,))):
                flown, said = flight.c(program, number, "fly", tolerance)
                off = worst(flown, reference)
                print(f"  C importer, FMI {number}.0 co-simulation, tolerance {tolerance:g}: {off[0]:.1e} ({off[1]}); "
                      f"{said.splitlines()[-1]}", flush=True)  # fmt: skip
            part, tolerance = (", first 1 s", TIGHT) if long else ("", 1e-8)
            off = worst(flight.fmpy(number, tolerance, 500 if long else None), reference)
            print(
                f"  FMPy, FMI {number}.0 co-simulation{part}, tolerance {tolerance:g}: {off[0]:.1e} ({off[1]})",
                flush=True,
            )
            if not long:
                tolerance, off = exchanged(flight, number)
                print(
                    f"  FMPy, FMI {number}.0 model exchange (CVode, {tolerance:g}): {off[0]:.1e} ({off[1]})", flush=True
                )
                flown, _ = flight.c(program, number, "exchange", 100)
                off = worst(flown, reference)
                print(
                    f"  C importer, FMI {number}.0 model exchange (Runge-Kutta, 1 us): {off[0]:.1e} ({off[1]})",
                    flush=True,
                )


def effects(names: list[str] | None = None) -> None:
    program = importer()
    for name in names or CATALOGUE:
        if name == "sensor_delay":
            print(f"{name}: not exported, it needs what has been")
            continue
        flight = Flight(with_effect(name), name)
        reference = flight.reference()
        told = [f"simulate {worst(flight.reference(flight.case.tolerance), reference)[0]:.1e}"]
        for number in ("2", "3"):
            for tolerance in (flight.case.tolerance, 1e-8):
                off = worst(flight.c(program, number, "fly", tolerance)[0], reference)
                told.append(f"FMI {number}.0 at {tolerance:g} {off[0]:.1e} ({off[1]})")
        tolerance, off = exchanged(flight, "3")
        print(f"{name}: {', '.join(told)}, CVode at {tolerance:g} {off[0]:.1e} ({off[1]})", flush=True)


class Held:
    """A command that holds in each communication step what it is at its begin."""

    def __init__(self, command: vs.Table, step: float):
        self.command, self.step = command, step

    def pieces(self, end: float) -> np.ndarray:
        starts = np.arange(max(round(end / self.step), 1)) / round(1.0 / self.step)  # the samples, to the last digit
        return np.column_stack([starts, evaluate(self.command, starts), np.zeros(len(starts))])


def importers() -> None:
    """Our FMUs inside two other programs' containers, C libraries that import them, flown by our C importer."""
    program, step = importer(), 1e-4
    chirp = vs.Chirp(amplitude=18e-3, start_frequency=5.0, end_frequency=150.0, duration=0.5)
    case = vs.Scenario(
        title="Valve", duration=0.5, command=polyline(chirp, 0.5, step), output_rate=1.0 / step, tolerance=1e-8,
        thermal=vs.Thermal(network=None),
    )  # fmt: skip
    flight = Flight(case, "contained")
    reference = Flight(replace(case, command=Held(case.command, step)), "held", ()).reference()
    del reference["drive_torque"]  # follows the current at once: a sample at a jump has the value on its other side
    for number in ("2", "3"):
        flown, _ = flight.c(program, number, "hold", 1e-8)
        print(f"FMI {number}.0 by our C importer, inputs held: {worst(flown, reference)[0]:.1e}", flush=True)
        for make in (_toolbox, _fmpy_container):
            name, outer = make(flight, number, step)
            flown, said = _fly_container(flight, outer, program)
            print(
                f"FMI {number}.0 inside {name}: {worst(flown, reference)[0]:.1e}; {said.splitlines()[-1]}", flush=True
            )


def _toolbox(flight: Flight, number: str, step: float) -> tuple[str, Path]:
    folder = flight.folder / f"toolbox{number}"
    folder.mkdir(exist_ok=True)
    inner = folder / "valve.fmu"
    inner.write_bytes(flight.archives[number].read_bytes())
    (folder / "outer.csv").write_text("rule;from_fmu;from_port;to_fmu;to_port\nFMU;valve.fmu;;;\n")
    tool = Path(sys.executable).parent / "fmucontainer"
    subprocess.run(
        [tool, "-container", f"outer.csv:{step}", "-fmu-directory", "."], cwd=folder, check=True, capture_output=True
    )
    return "the FMU Manipulation Toolbox's container", folder / "outer.fmu"


def _fmpy_container(flight: Flight, number: str, step: float) -> tuple[str, Path]:
    from copy import deepcopy

    from fmpy import read_model_description
    from fmpy.container_fmu.cli import create_container_fmu
    from fmpy.container_fmu.config import Component, Configuration

    inner = flight.archives[number]
    about = read_model_description(str(inner))
    part = Component(name="valve", filename=inner, modelDescription=about)
    outer = deepcopy(about)
    outer.modelExchange, outer.outputs, outer.derivatives, outer.initialUnknowns = None, [], [], []
    outer.coSimulation.fixedInternalStepSize = step
    kept, mapping = [], {}
    inside = {one.name: one for one in about.modelVariables}
    for one in outer.modelVariables:
        if one.causality in ("input", "output", "independent"):
            one.derivative, one.initial = None, None
            kept.append(one)
            if one.causality != "independent":
                mapping[one] = [(part, inside[one.name])]
    outer.modelVariables = kept
    folder = flight.folder / f"fmpy{number}"
    folder.mkdir(exist_ok=True)
    config = Configuration(
        parallelDoStep=False, modelDescription=outer, components=[part], connections=[], variableMappings=mapping
    )
    create_container_fmu(config, folder, flight.folder / f"fmpy{number}.fmu")
    return "FMPy's container (C)", flight.folder / f"fmpy{number}.fmu"


def _fly_container(flight: Flight, outer: Path, program: Path) -> tuple[dict[str, np.ndarray], str]:
    """A container flown by the C importer, with the variables that have our names."""
    from fmpy import extract, read_model_description

    folder = Path(extract(str(outer)))
    about = read_model_description(str(folder), validate=False)
    known = {one.name: one.valueReference for one in about.modelVariables}
    binary = next(path for path in folder.glob("binaries/*/*.so") if "linux" in path.parent.name)
    lines = flight.inputs.read_text().splitlines()
    ours = [flight.valve.inputs[int(head) - REFERENCES["input"]].name for head in lines[0].split(",")[1:]]
    lines[0] = ",".join(["0", *(str(known[name]) for name in ours)])
    inputs, out = flight.folder / "outer_in.csv", flight.folder / "outer_out.csv"
    inputs.write_text("\n".join(lines) + "\n")
    names = [name for name in flight.names if name in known]
    number = about.fmiVersion[0]
    token = about.guid if number == "2" else about.instantiationToken
    resources = (folder / "resources").as_uri() if number == "2" else f"{folder / 'resources'}/"
    words = [program, binary, number, token, "hold", inputs, out, repr(1e-8), *(known[name] for name in names)]
    done = subprocess.run(
        [str(word) for word in words], env={"FMU_RESOURCES": resources, "PATH": "/nowhere"}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(done.stderr + done.stdout)
    return dict(zip(names, np.loadtxt(out, delimiter=",")[:, 1:].T, strict=True)), done.stdout


def sanitizers() -> None:
    flags = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = importer(flags)
    cases_ = [with_effect("magnetic_hysteresis"), *list(cases().values())[1:]]
    for k, case in enumerate(cases_):
        flight = Flight(case, f"sanitized{k}")
        for number in ("2", "3"):
            folder = flight.folder / f"sources{number}"
            folder.mkdir(exist_ok=True)
            for name, text in fmu_sources(flight.valve, f"{number}.0").items():
                (folder / name).write_bytes(text)
            sources = [path.name for path in folder.glob("*.c")]
            binary = folder / "model.so"
            subprocess.run(
                ["gcc", "-std=c99", *flags, "-fPIC", "-shared", *sources, "-o", str(binary), "-lm"],
                cwd=folder,
                check=True,
            )
            flight.binaries[number] = binary
            for how, last in (("fly", 1e-4), ("hold", 1e-4), ("exchange", 20)):
                flight.c(program, number, how, last)
            for seed in range(10):
                words = [program, binary, number, model_hash(flight.valve), "fuzz", seed, 3000]
                done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
                if done.returncode:
                    print(done.stderr[-3000:])
                    raise SystemExit(f"fuzz {seed} of FMI {number}.0 ends with {done.returncode}")
            print(
                f"{case.title}, FMI {number}.0: flown, held, exchanged and 10 x 3,000 random calls, nothing found",
                flush=True,
            )


def memory() -> None:
    program, flight = importer(), Flight(list(cases().values())[2], "memory")
    for number in ("2", "3"):
        words = [program, flight.binaries[number], number, model_hash(flight.valve), "many", 1000]
        print(f"FMI {number}.0:", subprocess.check_output([str(word) for word in words], text=True).splitlines()[0])


def fuzz(seeds: int = 200) -> None:
    program, flight = importer(), Flight(with_effect("spool_coulomb_friction"), "fuzz")
    for number in ("2", "3"):
        crashed, last = 0, ""
        for seed in range(seeds):
            words = [program, flight.binaries[number], number, model_hash(flight.valve), "fuzz", seed, 5000]
            done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
            crashed += done.returncode != 0
            last = done.stdout.splitlines()[0] if done.stdout else done.stderr
        print(
            f"FMI {number}.0: {seeds} runs of 5,000 random calls, {crashed} ended otherwise than well; the last: {last}"
        )


def speed(rounds: int = 5) -> None:
    """Ratios in one run: processor seconds of steps of the FMU over those of `simulate`'s integration."""
    program = importer()
    for k, (name, case) in enumerate(cases().items()):
        flight, ratios, seconds = Flight(case, f"speed{k}"), [], []
        vs.simulate(case, signals=False)
        for _ in range(rounds):
            begin = time.process_time()
            vs.simulate(case, signals=False)
            whole = time.process_time() - begin
            run = vs.simulate(case, signals=False).statistics
            told = flight.c(program, "2", "fly", case.tolerance)[1]
            spent = float(told.splitlines()[0].rpartition(" ")[2])
            ratios.append((spent / run["solver_seconds"], spent / whole))
            seconds.append(spent)
        low = np.min(np.array(ratios), axis=0)
        print(
            f"{name}: FMU {min(seconds):.3f} s of processor in {len(flight.times) - 1} communication steps; over the "
            f"integration of simulate ({run['accepted_steps']:.0f} steps) {low[0]:.2f}, over all of it {low[1]:.2f}",
            flush=True,
        )
        if k == 1:
            _beside_casadi(flight, program)


def _beside_casadi(flight: Flight, program: Path) -> None:
    """The derivative of the same equations: printed here and as CasADi's own code generator writes it."""
    import casadi

    from valvesim.solver.codegen import trace

    rates, at = trace(flight.case.model)
    whole = casadi.Function("rates", list(at.values()), [casadi.cse(rates)])
    folder = flight.folder / "casadi"
    folder.mkdir(exist_ok=True)
    here = os.getcwd()
    os.chdir(folder)
    try:
        whole.generate("rates.c", {"with_header": True})
    finally:
        os.chdir(here)
    for name, text in fmu_sources(flight.valve, "2.0").items():
        (folder / name).write_bytes(text)
    (folder / "bench.c").write_text(_BENCH.replace("@N_C@", str(at["coefficients"].shape[0])))
    files = [
        "bench.c",
        "rates.c",
        "valve.c",
        "valve_model.c",
        "valve_rest.c",
        "valve_solver.c",
        "valve_text.c",
        "valve_thermal.c",
    ]
    subprocess.run(["gcc", "-O2", "-w", *files, "-o", "bench", "-lm"], cwd=folder, check=True)
    print("  " + subprocess.check_output(["./bench"], cwd=folder, text=True).strip())


_BENCH = """
#include <stdio.h>
#include <time.h>
#include "valve.h"
#include "rates.h"
int main(void) {
    static Valve v; double y[VALVE_COUPLED], x[VALVE_COUPLED], out[VALVE_STATES + 1], c[@N_C@], sum = 0.0, a, b;
    const double *arg[3]; double *res[1], w[1000]; casadi_int iw[1000]; int k, i; clock_t t;
    valve_defaults(&v); valve_start(&v);
    for (k = 0; k < @N_C@; k++) c[k] = v.coefficients[k];
    for (k = 0; k < VALVE_COUPLED; k++) { x[k] = v.states[k]; y[k] = x[k] / valve_state_table[k].scale; }
    arg[0] = x; arg[1] = v.inputs; arg[2] = c; res[0] = out;
    t = clock();
    for (i = 0; i < 3000000; i++) { y[0] += 1e-12; valve_model_rates(y, v.inputs, v.prepared, out); sum += out[1]; }
    a = (double)(clock() - t) / CLOCKS_PER_SEC / 3.0;
    t = clock(); for (i = 0; i < 3000000; i++) { x[0] += 1e-16; rates(arg, res, iw, w, 0); sum += out[1]; }
    b = (double)(clock() - t) / CLOCKS_PER_SEC / 3.0;
    printf("one evaluation of the rates: %.3f us here, %.3f us as CasADi's generator writes them (ratio %.2f)%s\\n",
        a, b, b / a, sum == 0.5 ? "!" : "");
    return 0;
}
"""


def main(words: list[str]) -> None:
    for word in words or ["validity", "agreement", "effects", "importers", "sanitizers", "memory", "fuzz", "speed"]:
        print(f"\n== {word}", flush=True)
        globals()[word]()


if __name__ == "__main__":
    main(sys.argv[1:])
