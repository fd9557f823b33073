"""The valve as an FMU and as C: it flies as `simulate` does, describes itself, and refuses what makes no sense."""

import ctypes
import re
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmu_importer import Refused, fly, opened, output_names

import valvesim as vs
from valvesim.export import fmu
from valvesim.export.c_model import C_FUNCTIONS, OF_C
from valvesim.export.c_source import export_c, flown_scenario
from valvesim.export.fmi_variables import model_identifier
from valvesim.export.fmu import check_replaceable, export_fmu, find_compiler
from valvesim.export.reference_results import equivalent_channels, reference_values
from valvesim.export.source import load_source
from valvesim.export.traced_valve import trace_valve
from valvesim.simulation import driver
from valvesim.solver import rodas5p, straight_line
from valvesim.valve.catalogue import CATALOGUE

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler is on the path")
CASE = vs.Scenario(
    title="Warm step", duration=0.02, oil_temperature=vs.Table(times=(0.0, 0.02), values=(20.0, 25.0)),
    command=vs.Table(times=(0.0, 4e-3, 6e-3, 0.02), values=(0.0, 0.0, 8e-3, -9e-3)), output_rate=2000.0, tolerance=1e-6,
)  # fmt: skip


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The case as both kinds of archive, the second compiled here."""
    folder = tmp_path_factory.mktemp("fmu")
    with pytest.MonkeyPatch.context() as patch:
        quick = ("-O1", *(flag for flag in fmu.COMPILER_FLAGS if flag != "-O2"))  # compiles in half the time
        patch.setattr(fmu, "COMPILER_FLAGS", quick)
        for version in ("2.0", "3.0"):
            export_fmu(CASE, folder / f"fmi{version[0]}.fmu", version=version)
    return folder


@pytest.fixture
def importer(archives):
    with opened(archives / "fmi3.fmu") as one:
        yield one


def spans(values):
    return {name: max(np.ptp(column), 1e-9 * np.max(np.abs(column)), 1e-12) for name, column in values.items()}


def errors(flown, case):
    """Share of its span by which each channel differs from the simulation at a tolerance of 1e-8."""
    _, values = reference_values(replace(case, tolerance=1e-8))
    known = equivalent_channels(trace_valve(case))
    assert len(known) >= 20
    width = spans({name: values[channel] for name, channel in known.items()})
    return {name: np.max(np.abs(flown[name] - values[channel])) / width[name] for name, channel in known.items()}


@needs_compiler
@pytest.mark.parametrize("number", [2, 3])
def test_co_simulation_flies_as_simulate_does(archives, number):
    times = np.arange(41) / CASE.output_rate
    off = errors(fly(archives / f"fmi{number}.fmu", trace_valve(CASE), times), CASE)
    assert max(off.values()) < 1e-5, off


@needs_compiler
@pytest.mark.parametrize("number", [2, 3])
def test_model_exchange_gives_the_rates_of_the_model(archives, number):
    valve, model = trace_valve(CASE), CASE.model
    with opened(archives / f"fmi{number}.fmu", co_simulation=False) as one:
        one.start({"current": 2e-3, "oil_temperature": 60.0})
        if number == 2:
            one.call("EnterContinuousTimeMode")
        else:
            one.call("EnterContinuousTimeMode")
        n = len(valve.states)
        x, rates = (ctypes.c_double * n)(), (ctypes.c_double * n)()
        one.call("GetContinuousStates", x, ctypes.c_size_t(n))
        at_rest = np.array(x)
        x[:] = [value + 0.1 * state.scale for value, state in zip(at_rest, valve.states, strict=True)]
        one.call("SetContinuousStates", x, ctypes.c_size_t(n))
        one.call("GetDerivatives" if number == 2 else "GetContinuousStateDerivatives", rates, ctypes.c_size_t(n))
        told = one.get([f"der({state.name})" for state in valve.states])
    rest = vs.static_solution(CASE.valve, current=2e-3, temperature=60.0)
    np.testing.assert_allclose(at_rest[4], rest.spool_position, rtol=1e-9)
    parts = vs.PartTemperatures(oil=60.0, **{name[:-12]: x[k] for k, name in _temperatures(valve)})
    c = model.flat_coefficients(CASE.valve.at(parts, oil=CASE.oil), ())
    inputs = (2e-3, 0.0, CASE.valve.supply_pressure, CASE.valve.return_pressure, 0.0)
    np.testing.assert_allclose(rates[:6], np.array(model.rhs(tuple(x[:6]), inputs, c), dtype=float), rtol=1e-9)
    network = CASE.thermal.network.rates(
        {name[:-12]: x[k] for k, name in _temperatures(valve)} | {"oil": 60.0, "ambient": 20.0}
    )
    np.testing.assert_allclose(rates[6:], list(network.values()), rtol=1e-9)
    np.testing.assert_array_equal(told, np.array(rates))


def _temperatures(valve):
    return [(k, one.name) for k, one in enumerate(valve.states) if one.name.endswith("_temperature")]


@needs_compiler
def test_derivatives_are_exact_and_their_own_adjoints(importer):
    valve = trace_valve(CASE)
    importer.start({"current": 3e-3, "load_pressure": 4e6})
    importer.step(0.0, 1e-3)
    unknowns = [f"der({one.name})" for one in valve.states] + [one.name for one in valve.outputs]
    knowns = [one.name for one in (*valve.states, *valve.parameters)] + ["current", "load_pressure", "oil_temperature"]
    rng = np.random.default_rng(3)
    forward, back = rng.normal(size=len(knowns)), rng.normal(size=len(unknowns))
    along = importer.sensitivities("GetDirectionalDerivative", unknowns, knowns, list(forward))
    against = importer.sensitivities("GetAdjointDerivative", unknowns, knowns, list(back))
    assert along @ back == pytest.approx(forward @ against, rel=1e-9)
    asked = ["der(torque_motor_temperature)", "drive_torque", "load_flow", "pilot_flow", "internal_leakage"]
    for name in ("thermal.torque_motor_capacity", "valve.null_gap", "oil.density_at_20", "valve.coil_turns"):
        exact = importer.sensitivities("GetDirectionalDerivative", asked, [name], [1.0])
        (value,), sides = importer.get([name]), []
        for side in (1.0, -1.0):
            importer.set({name: value * (1.0 + side * 1e-6)})
            sides.append(importer.get(asked))
        importer.set({name: value})
        np.testing.assert_allclose(exact, (sides[0] - sides[1]) / (2e-6 * value), rtol=1e-6, atol=1e-12)


@needs_compiler
def test_a_saved_state_comes_back_also_as_bytes(importer):
    names = output_names(trace_valve(CASE))
    importer.start({"current": 4e-3})
    importer.step(0.0, 1e-3)
    state, size = ctypes.c_void_p(), ctypes.c_size_t()
    importer.call("GetFMUState", ctypes.byref(state))
    importer.call("SerializedFMUStateSize", state, ctypes.byref(size))
    text = (ctypes.c_uint8 * size.value)()
    importer.call("SerializeFMUState", state, text, size)
    importer.set({"current": -4e-3})
    importer.step(1e-3, 5e-3)
    later = importer.get(names)
    importer.call("SetFMUState", state)
    importer.set({"current": -4e-3})
    importer.step(1e-3, 5e-3)
    np.testing.assert_array_equal(importer.get(names), later)
    again = ctypes.c_void_p()
    importer.call("DeserializeFMUState", text, size, ctypes.byref(again))
    importer.call("SetFMUState", again)
    importer.set({"current": -4e-3})
    importer.step(1e-3, 5e-3)
    np.testing.assert_allclose(importer.get(names), later, rtol=1e-9)
    text[5] ^= 255
    with pytest.raises(Refused, match="no saved state of this model"):
        importer.call("DeserializeFMUState", text, size, ctypes.byref(again))
    for saved in (state, again):
        importer.call("FreeFMUState", ctypes.byref(saved))


@needs_compiler
@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("valve.null_gap", float("nan"), "valve.null_gap: the value is not a finite number"),
        ("valve.null_gap", -1e-6, r"valve.null_gap = -1e-06 m is outside \[4.94"),
        ("current", 2.0, r"current = 2 A is outside \[-1, 1\] A"),
        ("supply_pressure", float("inf"), "supply_pressure: the value is not a finite number"),
        ("spool_position", 0.0, "spool_position: the valve starts at rest"),
        ("load_flow", 0.0, "cannot be set"),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_and_changes_nothing(importer, name, value, told):
    importer.call("EnterInitializationMode", *(ctypes.c_bool(False), ctypes.c_double(0.0)), ctypes.c_double(0.0),
                  ctypes.c_bool(False), ctypes.c_double(0.0))  # fmt: skip
    before = importer.get([name])
    with pytest.raises(Refused, match=told):
        importer.set({name: value})
    np.testing.assert_array_equal(importer.get([name]), before)


@needs_compiler
def test_conditions_that_do_not_go_together_are_refused(importer):
    with pytest.raises(Refused, match=r"return_pressure \(3e\+07 Pa\) must be below supply_pressure"):
        importer.start({"return_pressure": 30e6})
    importer.call("Reset")
    with pytest.raises(Refused, match="null_gap_1 closes"):
        importer.start({"valve.null_gap_difference": -9e-5})
    importer.call("Reset")
    with pytest.raises(Refused, match="no stable null"):
        importer.start({"valve.polarization_mmf": 3e4})


@needs_compiler
def test_calls_in_the_wrong_order_and_wrong_times_are_refused(importer):
    flags = [ctypes.c_bool() for _ in range(3)]
    ended = ctypes.c_double()
    with pytest.raises(Refused, match=r"fmi3DoStep: not allowed in this state \(before initialization\)"):
        importer.step(0.0, 1e-3)
    with pytest.raises(Refused, match="outputs and derivatives have no value before initialization"):
        importer.get(["load_flow"])
    importer.start(stop=2e-3)
    for time, size, told in (
        (-1e-3, 1e-3, "time that goes back needs a saved state"),
        (0.0, -1e-3, "a positive size"),
        (0.0, float("nan"), "a finite time"),
        (0.0, 1.0, "beyond the stop time"),
    ):
        with pytest.raises(Refused, match=told):
            importer.step(time, size)
    for name in ("EnterContinuousTimeMode", "EnterEventMode", "ExitInitializationMode", "EnterStepMode"):
        with pytest.raises(Refused, match=name):
            importer.call(name)
    assert importer.step(0.0, 2e-3) == 2e-3
    importer.call("Terminate")
    with pytest.raises(Refused, match="after termination"):
        importer.set({"current": 0.0})
    assert not any(flag.value for flag in flags) and ended.value == 0.0


@needs_compiler
def test_an_early_return_stops_at_a_step_of_the_solver(archives):
    def update(environment, time, may_set, may_get, done, can_stop, stop, stop_time):
        assert can_stop and done and not may_set
        stop[0], stop_time[0] = time > 2e-3, 0.0

    with opened(archives / "fmi3.fmu", earlyReturnAllowed=True, intermediateUpdate=update) as one:
        one.start({"current": 2e-3})
        one.set({"current": 4e-3})
        ended = one.step(0.0, 0.02)
        assert 2e-3 < ended < 0.02
        assert one.get(["time"])[0] == ended
        ended_next = one.step(ended, 1e-3)
        assert ended < ended_next <= ended + 1e-3


@needs_compiler
def test_the_c_code_passes_its_own_test_and_a_changed_one_does_not(tmp_path):
    names = [path.name for path in export_c(CASE, tmp_path)]
    assert {"valve.h", "valve_model.c", "valve_test.c", "CMakeLists.txt"} <= set(names)
    sources = [name for name in names if name.endswith(".c")]
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([find_compiler(), *flags, *sources, "-lm", "-o", "passes"], cwd=tmp_path, check=True)
    done = subprocess.run(["./passes"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "passed" in done.stdout
    code = (tmp_path / "valve.c").read_text()
    start = "valve_parameter_table[k].start"
    (tmp_path / "valve.c").write_text(code.replace(start, f"1.001 * {start}"))
    subprocess.run([find_compiler(), *flags[:2], *sources, "-lm", "-o", "fails"], cwd=tmp_path, check=True)
    assert subprocess.run(["./fails"], cwd=tmp_path, capture_output=True, check=False).returncode == 1


def all_effects():
    active = []
    for effect in CATALOGUE.values():
        if effect.name == "sensor_delay":
            continue
        bound = effect.on("spool_position") if effect.reading is not None else effect
        active.append(bound(**{bound.amplitude.name: bound.amplitude.typical}))
    return tuple(active)


@pytest.mark.parametrize(("version", "drive"), [("2.0", vs.VoltageDrive()), ("3.0", vs.CurrentDrive())])
def test_fmpy_finds_no_fault_with_the_description(tmp_path, version, drive):
    from fmpy.validation import validate_fmu

    case = replace(CASE, drive=drive, title='"<&> 1 µ', effects=all_effects(), thermal=vs.Thermal(throttling_heat=True))
    export_fmu(case, tmp_path / "all.fmu", version=version, compiler="")
    assert validate_fmu(str(tmp_path / "all.fmu")) == []


def test_an_isothermal_valve_has_no_temperature_as_a_state():
    valve = trace_valve(replace(CASE, thermal=vs.Thermal(network=None)))
    assert [one.name for one in valve.states] == [channel.name for channel in CASE.model.state_channels]
    assert "body_temperature" in [one.name for one in valve.outputs]
    assert not any("thermal." in one.name for one in valve.parameters)


def test_the_description_has_units_bounds_and_every_channel_of_a_run(tmp_path):
    import fmpy

    export_fmu(CASE, tmp_path / "a.fmu", compiler="")
    about = fmpy.read_model_description(str(tmp_path / "a.fmu"))
    named = {one.name: one for one in about.modelVariables}
    gap = named["valve.null_gap"]
    assert (gap.unit, gap.displayUnit, float(gap.start), float(gap.max)) == ("m", "mm", 3.5e-5, 1e-3)
    assert gap.variability == "tunable" and "nozzle to flapper" in gap.description
    channels = {channel for channel in vs.simulate(CASE).values}
    assert channels - set(named) == set()
    assert named["body_temperature"].causality == "output"
    assert about.defaultExperiment.stopTime == "0.02" and about.modelName == "Warm step"


def test_equal_models_make_equal_archives_and_others_another_token(tmp_path):
    one = export_fmu(CASE, tmp_path / "1.fmu", compiler="")
    two = export_fmu(CASE, tmp_path / "2.fmu", compiler="")
    assert (tmp_path / "1.fmu").read_bytes() == (tmp_path / "2.fmu").read_bytes()
    stiffer = replace(CASE, valve=replace(CASE.valve, feedback_rod_stiffness=3000.0))
    assert one.token == two.token != export_fmu(stiffer, tmp_path / "3.fmu", compiler="").token
    assert one.binary is None
    with zipfile.ZipFile(tmp_path / "1.fmu") as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())


def test_what_needs_a_series_or_is_unknown_is_refused(tmp_path):
    delay = CATALOGUE["sensor_delay"].on("spool_position")(delay=1e-3)
    with pytest.raises(vs.InputError, match="effects.sensor_delay cannot be exported: it works on a whole record"):
        export_fmu(replace(CASE, effects=(delay,)), tmp_path / "a.fmu")
    with pytest.raises(vs.InputError, match="thermal.part_temperatures"):
        export_fmu(replace(CASE, part_temperatures={"body": vs.Constant(value=20.0)}), tmp_path / "a.fmu")
    with pytest.raises(vs.InputError, match="FMI '1.0' is not written; valid versions: 3.0, 2.0"):
        export_fmu(CASE, tmp_path / "a.fmu", version="1.0")
    with pytest.raises(vs.InputError, match="no program 'no-such-compiler'"):
        export_fmu(CASE, tmp_path / "a.fmu", compiler="no-such-compiler")
    with pytest.raises(vs.InputError, match="valve.null_gap is an array"):
        export_fmu(replace(CASE, valve=replace(CASE.valve, null_gap=np.array([3e-5, 4e-5]))), tmp_path / "a.fmu")
    with pytest.raises(vs.InputError, match="did you mean 'spool_lap'"):
        load_source("step", effects=("spol_lap",))
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(vs.InputError, match="is no FMU of valvesim"):
        check_replaceable(tmp_path / "notes.txt", overwrite=False)


def test_a_valve_by_name_and_effects_that_are_switched_off():
    case = load_source("reference", effects=("spool_coulomb_friction", "sensor_gain.load_flow"))
    assert [active.effect.name for active in case.effects] == ["spool_coulomb_friction", "sensor_gain"]
    valve = trace_valve(case)
    starts = {one.name: one.start for one in valve.parameters}
    assert starts["effects.spool_coulomb_friction.friction_force"] == 0.0
    assert "measured_load_flow" in [one.name for one in valve.outputs]
    assert case.thermal.network is not None


def test_titles_make_c_identifiers():
    for title in ("Warm step", "1 kHz", "", "µ", "__", "a" * 200, "Ventil / 2"):
        assert re.fullmatch(r"[a-z][a-z0-9_]*", model_identifier(title))


def test_the_c_code_has_the_figures_of_the_integrator(tmp_path):
    export_c(CASE, tmp_path)
    header = (tmp_path / "valve_model.h").read_text()
    defined = dict(re.findall(r"#define VALVE_(\w+) ([-\d.e]+)$", header, re.MULTILINE))
    assert float(defined["GAMMA"]) == rodas5p.GAMMA
    assert float(defined["ABSOLUTE_SHARE"]) == driver.ABSOLUTE_SHARE
    assert float(defined["TOLERANCE"]) == CASE.tolerance
    assert int(defined["STAGES"]) == rodas5p.STAGES
    code = (tmp_path / "valve_model.c").read_text()
    step = re.search(r"void valve_model_step\(.*?^\}", code, re.DOTALL | re.MULTILINE)[0]
    assert repr(float(rodas5p.A[5, 0])) in step and repr(float(rodas5p.C[7, 6])) in step
    assert flown_scenario(CASE).duration == pytest.approx(0.05)
    assert "-O2" in fmu.COMPILER_FLAGS


@needs_compiler
@pytest.mark.parametrize("number", [2, 3])
def test_the_functions_have_the_signatures_of_the_standards_own_headers(tmp_path, number):
    import fmpy

    for name, text in fmu.fmu_sources(trace_valve(CASE), f"{number}.0").items():
        (tmp_path / name).write_bytes(text)
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-Werror", "-Wall", "-fsyntax-only", "-DFMI_OFFICIAL_HEADERS", f"-I{headers}"]
    subprocess.run([find_compiler(), *flags, f"fmi{number}.c"], cwd=tmp_path, check=True)
    declared = (headers / f"fmi{number}Functions.h").read_text()
    listed = re.findall(rf"^\s*FMI{number}_Export \w+ +(fmi{number}\w+);", declared, re.MULTILINE)
    written = re.findall(rf"\bfmi{number}[A-Z]\w+", (tmp_path / f"fmi{number}.c").read_text())
    of_types = "Float32 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64 Boolean String".split()
    made = {f"fmi3{way}{kind}" for way in ("Get", "Set") for kind in of_types}  # by a macro
    assert len(listed) > 40 and set(listed) - set(written) - made == set()


@needs_compiler
@pytest.mark.parametrize("number", [2, 3])
def test_an_fmu_is_flown_where_a_valve_would_be(archives, number):
    own = vs.FmuValve(path=archives / f"fmi{number}.fmu")
    held = replace(CASE, oil_temperature=vs.Constant(value=20.0), command=vs.Step(after=4e-3, time=1e-3), duration=0.01)
    flown, run = vs.simulate(replace(held, valve=own)), vs.simulate(held)
    assert set(run.values) == set(flown.values)
    for name in ("spool_position", "load_flow", "nozzle_pressure_1", "body_temperature"):
        width = max(np.ptp(run.values[name]), 1e-9)
        assert np.max(np.abs(flown.values[name] - run.values[name])) < 1e-3 * width, name


@needs_compiler
def test_an_fmu_with_other_names_and_units_is_told_by_them(archives):
    own = vs.FmuValve(path=archives / "fmi3.fmu", names={"spool_position": "flapper_position"})
    plain = vs.simulate(replace(CASE, valve=vs.FmuValve(path=own.path)))
    renamed = vs.simulate(replace(CASE, valve=own))
    np.testing.assert_array_equal(renamed.values["spool_position"], plain.values["flapper_position"])
    in_mm = vs.simulate(replace(CASE, valve=replace(own, units={"flapper_position": "mm"})))
    np.testing.assert_allclose(in_mm.values["spool_position"], 1e-3 * renamed.values["spool_position"], rtol=1e-12)
    with pytest.raises(vs.InputError, match="armature_angle of the FMU: 'rad' has the wrong dimension"):
        vs.simulate(replace(CASE, valve=replace(own, names={"spool_position": "armature_angle"})))
    assert own.in_words() == "FMU fmi3.fmu"


@needs_compiler
def test_what_an_fmu_cannot_do_is_said(archives, tmp_path):
    own = vs.FmuValve(path=archives / "fmi3.fmu")
    with pytest.raises(vs.InputError, match="is an FMU, whose equations are not known"):
        vs.static_solution(own, current=1e-3)
    with pytest.raises(vs.InputError, match="effects belong to this package's equations"):
        vs.simulate(replace(CASE, valve=own, effects=(CATALOGUE["spool_lap"](overlap=1e-6),)))
    with pytest.raises(vs.InputError, match="has no variable 'spol'"):
        vs.FmuValve(path=archives / "fmi3.fmu", names={"spool_position": "spol"})
    with pytest.raises(vs.InputError, match="has no input 'voltage'"):
        vs.simulate(replace(CASE, valve=own, drive=vs.VoltageDrive()))
    with pytest.raises(vs.SolveError, match=r"the FMU fmi3.fmu fails: .*is outside \[-1, 1\] A"):
        vs.simulate(replace(CASE, valve=own, command=vs.Step(after=3.0, time=1e-3)))
    (tmp_path / "no.fmu").write_text("nothing")
    for path, told in ((tmp_path / "no.fmu", "is no FMU that FMPy reads"), (tmp_path / "none.fmu", "no such file")):
        with pytest.raises(vs.InputError, match=told):
            vs.FmuValve(path=path)


def test_all_that_printed_lines_may_call_is_there_in_c():
    assert set(straight_line.FUNCTIONS) <= set(C_FUNCTIONS) | set(OF_C)


@needs_compiler
@pytest.mark.parametrize("number", [2, 3])
def test_an_fmu_without_co_simulation_is_flown_by_cvode(archives, tmp_path, number):
    alone = tmp_path / "exchange.fmu"
    with zipfile.ZipFile(archives / f"fmi{number}.fmu") as both, zipfile.ZipFile(alone, "w") as one:
        for name in both.namelist():
            data = both.read(name)
            if name == "modelDescription.xml":
                data = re.sub(rb"<CoSimulation.*?</CoSimulation>|<CoSimulation[^>]*/>", b"", data, flags=re.DOTALL)
            one.writestr(name, data)
    held = replace(CASE, oil_temperature=vs.Constant(value=20.0), command=vs.Step(after=4e-3, time=1e-3), duration=5e-3)
    own = vs.FmuValve(path=alone, step=5e-4)
    assert own.description.coSimulation is None
    flown, run = vs.simulate(replace(held, valve=own)), vs.simulate(held)
    for name in ("spool_position", "nozzle_pressure_1", "load_flow"):
        width = np.ptp(run.values[name])
        assert np.max(np.abs(flown.values[name] - run.values[name])) < 1e-3 * width, name


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", [name for name in CATALOGUE if name != "sensor_delay"])
def test_the_c_code_passes_its_own_test_with_each_effect(tmp_path, name):
    effect = CATALOGUE[name]
    bound = effect.on("spool_position") if effect.reading is not None else effect
    drive = vs.VoltageDrive() if name == "coil_resistance_drift" else vs.CurrentDrive()
    case = replace(CASE, effects=(bound(**{bound.amplitude.name: bound.amplitude.typical}),), drive=drive)
    sources = [path.name for path in export_c(case, tmp_path) if path.suffix == ".c"]
    subprocess.run([find_compiler(), "-std=c99", "-O1", *sources, "-lm", "-o", "run"], cwd=tmp_path, check=True)
    done = subprocess.run(["./run"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_commands_write_what_they_say_and_refuse_in_one_line(call, tmp_path):
    fmu_path, folder = tmp_path / "a.fmu", tmp_path / "c"
    code, out, err = call("export", "fmu", "step", "-o", fmu_path, "--compiler", "", "--reference", "--fmi", "2.0")
    assert code == 0, err
    assert "FMI 2.0, model exchange and co-simulation: 5 inputs, 6 states" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.fmu", "a_in.csv", "a_ref.csv", "a_ref.opt"]
    assert "StopTime, 0.06\n" in (tmp_path / "a_ref.opt").read_text()
    assert (tmp_path / "a_ref.csv").read_text().startswith('"time","armature_angle"')
    code, out, _ = call("export", "c", "reference", "-o", folder, "--effect", "spool_lap")
    assert code == 0 and "valve_test.c" in out
    assert "effects.spool_lap.overlap" in (folder / "valve_model.c").read_text()
    for words, told in (
        (("fmu", "step", "-o", tmp_path / "a_in.csv"), "is no FMU of valvesim; name another file, or give --overwrite"),
        (("fmu", "stpe"), "nor a scenario that comes along"),
        (("c", "step", "-o", folder, "--effect", "sensor_delay.load_flow"), "cannot be exported"),
    ):
        code, _, err = call("export", *words)
        assert code == 2 and told in err and err.count("\n") == 1, err


def test_terminals_and_build_description_fit_the_schemas_of_the_standard(tmp_path):
    import fmpy
    from lxml import etree

    export_fmu(CASE, tmp_path / "a.fmu", compiler="")
    schemas = Path(fmpy.__file__).parent / "schema" / "fmi3"
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        for name, schema in (
            ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
            ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
        ):
            etree.XMLSchema(etree.parse(str(schemas / schema))).assertValid(etree.fromstring(archive.read(name)))
        assert {"terminalsAndIcons/icon.png", "terminalsAndIcons/terminal.png"} <= set(archive.namelist())
