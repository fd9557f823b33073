"""The extended model as a scenario file: what is read back is what was written, and it runs as the record did."""

from dataclasses import replace

import numpy as np
import pytest

import valvesim as vs
from valvesim.diagnosis.extended_model import EFFECT_FILE, INPUT_FILE, effect_file, effect_files, scenario_text
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.prior import nominal_model_of
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.session_toml import load_session
from valvesim.inputs import Constant, evaluate
from valvesim.simulation.run import simulate
from valvesim.units import quantities
from valvesim.valve.additive_term import LAG, NONE, PATH, term_effect
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effect_files import load_effects
from valvesim.valve.fluid import YH12_PAPER

TIME = np.arange(200) / 1e3
OWN = """
import valvesim as vs

own = vs.Effect(
    name="side_load", doc="constant side load", location="spool force balance", signature="null shift",
    parameters=(vs.Parameter(name="force", unit="N", doc="force", default=0.0, bounds=(-50.0, 50.0), neutral=0.0),),
    balance=lambda situation, p, memory: (vs.Ports(spool_force=p.force), ()),
)
"""


def write(folder, *, start=0.0, settings="[thermal]\nisothermal = true\n", drive="current [mA]", **columns):
    """A session of one moving record in `folder`; further columns by name and unit, `__` for their brackets."""
    wave = np.sin(40.0 * TIME)
    table = {"time [s]": TIME + start, drive: 3.0 * wave, "spool_position [mm]": 0.1 * wave}
    table |= {name.replace("__", " [") + "]": values * np.ones(len(TIME)) for name, values in columns.items()}
    if drive.startswith("voltage"):
        table["voltage [V]"] = 0.3 * wave
    rows = [",".join(f"{v:.9g}" for v in row) for row in np.column_stack([*table.values()])]
    (folder / "wave.csv").write_text("\n".join([",".join(table), *rows]), encoding="utf-8")
    (folder / "session.toml").write_text(settings, encoding="utf-8")
    return load_session(folder, trust=True)


def reread(session, variant, folder):
    """The scenario that the text says, with the files that it needs, in a folder of its own."""
    folder = folder / "answer"
    folder.mkdir()
    for name, text in {
        "extended.toml": scenario_text(session, variant, options=DIAGNOSIS),
        **effect_files(session, variant),
    }.items():
        (folder / name).write_text(text, encoding="utf-8")
    return vs.load_scenario(folder / "extended.toml", trust=True, outside=True)


def assert_same_inputs(scenario, meant):
    times = np.linspace(0.0, meant.duration, 997)
    pairs = zip(
        (scenario.command, scenario.oil_temperature, *scenario.pressures()),
        (meant.command, meant.oil_temperature, *meant.pressures()), strict=True,
    )  # fmt: skip
    for read, command in pairs:
        assert np.allclose(evaluate(read, times), evaluate(command, times), rtol=1e-9, atol=1e-12)


def test_a_nominal_variant_comes_back_with_the_inputs_of_the_record(tmp_path):
    session = write(tmp_path)
    variant = ModelVariant(session.valve)
    scenario, meant = reread(session, variant, tmp_path), record_scenario(session, session.records[0])
    assert scenario.valve == meant.valve and scenario.oil == meant.oil and scenario.thermal == meant.thermal
    assert (scenario.effects, scenario.duration, scenario.output_rate) == ((), meant.duration, meant.output_rate)
    assert scenario.title == meant.title and scenario.drive == vs.CurrentDrive()
    assert_same_inputs(scenario, meant)
    text = scenario_text(session, variant, options=DIAGNOSIS)
    assert "[valve]" not in text and "[pressures]" not in text and "[[" not in text and "effects_files" not in text
    assert str((tmp_path / "wave.csv").absolute()) in text and 'start = "0 s"' in text


def test_every_figure_of_a_valve_comes_back_exactly(tmp_path):
    rng = np.random.default_rng(3)
    valve = vs.reference_valve()
    moved = {
        name: float(getattr(valve, name)) * (1.0 + 0.003 * rng.standard_normal())
        for name, declared in quantities(valve).items()
        if declared.default != 0.0
    }
    session = write(tmp_path)
    variant = ModelVariant(replace(valve, **moved))
    assert reread(session, variant, tmp_path).valve == variant.valve
    line = next(
        line
        for line in scenario_text(session, variant, options=DIAGNOSIS).splitlines()
        if line.startswith("null_gap =")
    )
    assert f"# {100.0 * (moved['null_gap'] / valve.null_gap - 1.0):+.3g} %" in line


def test_a_figure_that_people_can_read_is_written_so(tmp_path):
    session = write(tmp_path)
    assert 'null_gap = "0.03 mm"' in scenario_text(
        session, ModelVariant(replace(session.valve, null_gap=3e-5)), options=DIAGNOSIS
    )


def test_oil_law_and_thermal_settings_come_back(tmp_path):
    settings = (
        '[oil]\nname = "yh12_paper"\ndensity_at_20 = "851 kg/m^3"\n[valve]\nflow_law = "reynolds"\n[thermal]\n'
        'routes = ["flow", "mmf"]\nthrottling_heat = true\ninitial_temperature = "25 degC"\n'
        'ambient_temperature = "5 degC"\nbody_capacity = "123 J/K"\n'
    )
    session = write(tmp_path, settings=settings)
    scenario = reread(session, ModelVariant(session.valve), tmp_path)
    assert (scenario.oil, scenario.thermal, scenario.valve) == (session.oil, session.thermal, session.valve)
    assert scenario.oil == replace(YH12_PAPER, density_at_20=851.0) and scenario.thermal.network.body_capacity == 123.0


@pytest.mark.parametrize("start", [0.0, 7.25, -2.0])
def test_a_file_whose_clock_starts_elsewhere_gives_the_same_run(tmp_path, start):
    session = write(tmp_path, start=start)
    scenario = reread(session, ModelVariant(session.valve), tmp_path)
    assert_same_inputs(scenario, record_scenario(session, session.records[0]))
    assert f'start = "{start:g} s"' in scenario_text(session, ModelVariant(session.valve), options=DIAGNOSIS)


def test_temperatures_and_pressures_over_time_come_back(tmp_path):
    ramp = np.linspace(0.0, 1.0, len(TIME))
    session = write(
        tmp_path, settings="", oil_temperature__degC=20.0 + 30.0 * ramp, supply_pressure__bar=200.0 + 5.0 * ramp,
        return_pressure__bar=3.0, load_pressure__bar=60.0 * np.sin(20.0 * TIME), body_temperature__degC=21.0,
    )  # fmt: skip
    scenario, meant = (
        reread(session, ModelVariant(session.valve), tmp_path),
        record_scenario(session, session.records[0]),
    )
    assert_same_inputs(scenario, meant)
    assert scenario.thermal == meant.thermal and evaluate(scenario.return_pressure, 0.0) == pytest.approx(3e5)


def test_what_the_audit_changed_is_written_beside(tmp_path):
    load = 205.0 * np.sin(20.0 * TIME)
    session = write(tmp_path, supply_pressure__bar=203.0, load_pressure__bar=load)
    assert any("held at it" in note for note in session.notes)  # clipped: the file is not what is used
    scenario = reread(session, ModelVariant(session.valve), tmp_path)
    assert_same_inputs(scenario, record_scenario(session, session.records[0]))
    text = scenario_text(session, ModelVariant(session.valve), options=DIAGNOSIS)
    assert 'load = {table = {file = "inputs.csv", column = "load_pressure"}}' in text


def test_a_record_without_a_file_is_written_as_points(tmp_path):
    session = write(tmp_path)
    loose = replace(session, records=(replace(session.records[0], path=None),))
    scenario = reread(loose, ModelVariant(session.valve), tmp_path)
    assert_same_inputs(scenario, record_scenario(session, session.records[0]))


def test_a_voltage_session_writes_a_voltage(tmp_path):
    session = write(tmp_path, drive="voltage [V]", current__mA=0.5 * np.sin(40.0 * TIME))
    scenario = reread(session, ModelVariant(session.valve), tmp_path)
    assert scenario.drive == vs.VoltageDrive() and "[command.voltage]" in scenario_text(
        session, ModelVariant(session.valve), options=DIAGNOSIS
    )
    assert_same_inputs(scenario, record_scenario(session, session.records[0]))


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_of_the_catalogue_comes_back(tmp_path, name):
    effect = CATALOGUE[name].on("spool_position") if CATALOGUE[name].reading else CATALOGUE[name]
    numbers = {p.name: p.default * (1.0 + 1e-7) if p.default * (1.0 + 1e-7) <= p.bounds[1] else p.default
               for p in effect.parameters if p.name != "side"}  # fmt: skip
    numbers[effect.amplitude.name] = effect.amplitude.typical / 3.0
    session = write(tmp_path)
    active = effect(**numbers)
    assert reread(session, ModelVariant(session.valve, (active,)), tmp_path).effects == (active,)


def test_sensor_faults_are_in_small_errors_are_not_and_stated_lags_are(tmp_path):
    session = write(
        tmp_path, settings='[sensors.spool_position]\nlag = "1 ms"\n', nozzle_pressure_1__bar=100.0 + 5.0 * np.sin(TIME)
    )
    faults = tuple(CATALOGUE["sensor_bias"].on(name)(bias=size)
                   for name, size in (("spool_position", 1e-5), ("nozzle_pressure_1", -2e5)))  # fmt: skip
    nominal = nominal_model_of(session, options=OPTIONS)
    variant = nominal.at(np.full(len(nominal.parameters), 0.3))
    assert len(variant.effects) == 6  # bias, gain and delay of each channel, within tolerance
    scenario = reread(session, replace(variant, effects=(*variant.effects, *faults)), tmp_path)
    assert scenario.effects == (*faults, CATALOGUE["sensor_lag"].on("spool_position")(time_constant=1e-3))
    assert scenario.valve == variant.valve


@pytest.mark.parametrize("name", ["thermal_lag", "sensor_lag", "spool_coulomb_friction"])
def test_an_effect_that_was_searched_at_another_typical_amplitude_is_that_of_the_catalogue(tmp_path, name):
    own = CATALOGUE[name].on("spool_position") if CATALOGUE[name].reading else CATALOGUE[name]
    paced = tuple(replace(p, typical=0.5 * p.typical) if p is own.amplitude else p for p in own.parameters)
    active = replace(own, parameters=paced)(**{own.amplitude.name: own.amplitude.typical / 3.0})
    session = write(tmp_path)
    (back,) = reread(session, ModelVariant(session.valve, (active,)), tmp_path).effects
    assert back.effect == own and back.numbers == active.numbers


def test_two_effects_of_one_name_are_both_there(tmp_path):
    session = write(tmp_path)
    clogged = CATALOGUE["fixed_orifice_clogging"]
    both = (clogged(clogged_share=0.1, side=1.0), clogged(clogged_share=0.2, side=2.0))
    assert reread(session, ModelVariant(session.valve, both), tmp_path).effects == both


TERMS = {
    "none": term_effect("spool_force", "spool_position", [-3e-4, 0.0, 3e-4], [2.5, 0.0, -1 / 3]),
    "lag": term_effect("armature_torque", "pilot_differential_pressure", [-1e6, 1e6], [0.01, -0.01], memory=LAG,
                       time_constant=3e-3),
    "path": term_effect("pilot_flow", "armature_angle", [-4e-4, 0.0, 4e-4, 5e-4], [1e-7, 0.0, 1e-7, 3e-7], memory=PATH,
                        width=4e-5),
}  # fmt: skip


@pytest.mark.parametrize("kind", TERMS)
def test_a_recovered_term_comes_back_by_a_file_of_its_own(tmp_path, kind):
    """Its fitted figures are those of the effect, not the defaults that it was made with."""
    session, effect = write(tmp_path), TERMS[kind]
    numbers = {p.name: p.default * 1.1 for p in effect.parameters} | {"share": 0.9}
    active = effect(**numbers)
    (read,) = reread(session, ModelVariant(session.valve, (active,)), tmp_path).effects
    assert read.numbers == active.numbers and read.effect.balance is effect.balance
    assert read.effect.memory == effect.memory and read.effect.name == "recovered_term"
    assert f'effects_files = ["{EFFECT_FILE}"]' in scenario_text(
        session, ModelVariant(session.valve, (active,)), options=DIAGNOSIS
    )


def test_the_file_of_a_term_is_python_that_declares_it(tmp_path):
    (tmp_path / "term.py").write_text(effect_file(TERMS["none"](share=1.0)), encoding="utf-8")
    (effect,) = load_effects(tmp_path / "term.py")
    assert effect == TERMS["none"] and NONE not in (tmp_path / "term.py").read_text(encoding="utf-8")


def test_only_a_term_gets_a_file(tmp_path):
    friction = CATALOGUE["spool_coulomb_friction"](friction_force=1.0)
    assert effect_files(write(tmp_path), ModelVariant(vs.reference_valve(), (friction,))) == {}
    with pytest.raises(vs.InputError, match=r"effects\.spool_coulomb_friction: is no recovered term"):
        effect_file(friction)


def test_a_users_effect_is_named_by_its_own_file(tmp_path):
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    session = write(tmp_path, settings='effects_files = ["own.py"]\n')
    (effect,) = session.user_effects
    scenario = reread(session, ModelVariant(session.valve, (effect(force=4.0),)), tmp_path)
    assert [(a.effect.name, a.numbers) for a in scenario.effects] == [("side_load", (4.0,))]
    assert "effects_files" not in scenario_text(
        session, ModelVariant(session.valve), options=DIAGNOSIS
    )  # where it does not act


def test_a_term_of_another_session_is_a_users_effect_with_all_its_figures(tmp_path):
    (tmp_path / "own.py").write_text(effect_file(TERMS["path"](share=1.0)), encoding="utf-8")
    session = write(tmp_path, settings='effects_files = ["own.py"]\n')
    (effect,) = session.user_effects
    variant = ModelVariant(session.valve, (effect(share=0.5, width=5e-5),))
    assert effect_files(session, variant) == {}
    (read,) = reread(session, variant, tmp_path).effects
    assert read.numbers == variant.effects[0].numbers


def test_what_no_file_declares_is_refused(tmp_path):
    session = write(tmp_path)
    stranger = replace(CATALOGUE["spool_coulomb_friction"], name="stranger")(friction_force=1.0)
    with pytest.raises(vs.InputError, match=r"effects\.stranger: comes from no file"):
        scenario_text(session, ModelVariant(session.valve, (stranger,)), options=DIAGNOSIS)


def test_a_law_and_an_oil_without_a_name_are_refused(tmp_path):
    session = write(tmp_path)
    own = replace(session.valve, flow_coefficients=lambda *a: (0.6, 0.7))
    with pytest.raises(vs.InputError, match=r"valve\.flow_law: .* knows yan_2019, reynolds"):
        scenario_text(session, ModelVariant(own), options=DIAGNOSIS)
    with pytest.raises(vs.InputError, match=r"oil\.name: 'mine' .* knows .*yh12_paper"):
        lawless = replace(session.oil, name="mine", viscosity_law=lambda t: 1e-5 + 0.0 * t)
        scenario_text(replace(session, oil=lawless), ModelVariant(session.valve), options=DIAGNOSIS)


def test_an_oil_of_ones_own_comes_back_as_its_table(tmp_path):
    settings = (
        '[oil]\nname = "mine"\ntemperature = "-40, 40, 100 degC"\nviscosity = "400, 12.5, 4.75 mm^2/s"\n'
        'density = "905, 850, 810 kg/m^3"\nbulk_modulus = "2, 1.5, 1.1 GPa"\nrated_high = "120 degC"\n'
    )
    session = write(tmp_path, settings=settings)
    oil = reread(session, ModelVariant(session.valve), tmp_path).oil
    assert replace(oil, sources=()) == replace(session.oil, sources=())


def test_the_extended_scenario_runs_to_the_readings_of_the_record(tmp_path):
    """The spool of a valve with friction and a biased sensor, as the variant itself is run."""
    session = write(tmp_path, start=3.0)
    bias = CATALOGUE["sensor_bias"].on("spool_position")(bias=2e-5)
    variant = ModelVariant(replace(session.valve, null_gap=3.1e-5), (CATALOGUE["spool_lap"](overlap=3e-6), bias))
    scenario = reread(session, variant, tmp_path)
    meant = record_scenario(session, session.records[0], valve=variant.valve, effects=variant.effects)
    did_run, own = simulate(replace(scenario, tolerance=1e-6)), simulate(replace(meant, tolerance=1e-6))
    assert len(did_run.time) == len(TIME)
    for name in ("spool_position", "load_flow"):
        assert np.allclose(did_run[name].values, own[name].values, atol=1e-6 * np.ptp(own[name].values))
    assert did_run["spool_position"].values[0] == pytest.approx(2e-5, abs=2e-6)


def test_a_constant_input_is_a_constant(tmp_path):
    scenario = reread(session := write(tmp_path, supply_pressure__bar=190.0), ModelVariant(session.valve), tmp_path)
    assert isinstance(scenario.supply_pressure, Constant) and scenario.supply_pressure.value == pytest.approx(1.9e7)
    assert scenario.oil_temperature == Constant(value=20.0)


# ---------------------------------------------------------------- points in a scenario's text


POINTS = 'duration = "1 s"\n[thermal]\nisothermal = true\n[command.current]\n'


def test_points_may_stand_in_the_text_of_a_scenario(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(POINTS + 'table = { times = "0, 0.5, 1 s", values = "0, 2, -2 mA" }', encoding="utf-8")
    assert evaluate(vs.load_scenario(path).command, [0.25, 0.5, 0.75]) == pytest.approx([1e-3, 2e-3, 0.0])


@pytest.mark.parametrize(
    "table, message",
    [
        ('times = "0, 1 s", values = "0 mA"', "line 5: command.current.table: needs two or more points"),
        ('times = "1, 0 s", values = "0, 1 mA"', "line 5: command.current.table: times must rise"),
        ('times = "0, 1 s", values = "0, 1 bar"', "line 5: command.current.table.values: 'bar' has the wrong"),
        ('times = "0, 1 s", values = "0, 1 mA", start = "1 s"', "line 5: command.current.table: unknown key 'start'"),
        ('times = "0, 1 s"', "line 5: command.current.table: expected { file = 'name.csv' }"),
        ('file = "a.csv", start = "1 mA"', "line 5: command.current.table.start: 'mA' has the wrong dimension"),
    ],
)
def test_points_that_make_no_sense_are_refused(tmp_path, table, message):
    path = tmp_path / "case.toml"
    path.write_text(f"{POINTS}table = {{ {table} }}", encoding="utf-8")
    with pytest.raises(vs.InputError) as told:
        vs.load_scenario(path)
    assert message in str(told.value)


def test_inputs_of_another_dialect_or_format_stand_in_a_file_beside_the_scenario(tmp_path):
    session = write(tmp_path, supply_pressure__bar=200.0 + 5.0 * np.cos(20.0 * TIME))
    text = (tmp_path / "wave.csv").read_text(encoding="utf-8").replace(",", ";").replace(".", ",")
    (tmp_path / "wave.csv").write_text(text, encoding="utf-8")
    session = load_session(tmp_path, trust=True)
    (record,) = session.records
    scenario = reread(session, ModelVariant(session.valve), tmp_path)
    inputs = (tmp_path / "answer" / INPUT_FILE).read_text(encoding="utf-8")
    assert inputs.startswith("time [s],current [A],supply_pressure [Pa]\n") and inputs.count("\n") == len(TIME) + 1
    assert np.array_equal(evaluate(scenario.command, record.time), record.values["current"])
    assert np.array_equal(evaluate(scenario.supply_pressure, record.time), record.values["supply_pressure"])
