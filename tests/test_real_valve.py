"""The example of a measured valve: its base valve, its session and the effects of one's own. No diagnosis: minutes."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import valvesim as vs
from valvesim.channels import Inputs, State
from valvesim.characterisation.acceptance.pressure_gain import blocked_load_pressure
from valvesim.identification.session_toml import load_session
from valvesim.units import quantities
from valvesim.valve.effect import Reading
from valvesim.valve.equations import Model, main_stage
from valvesim.valve.parameters import PartTemperatures

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data" / "servovalve-5329"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured records are not here: {DATA}")


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("real_valve", ROOT / "examples" / "real_valve.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["real_valve"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def own():
    from valvesim.valve.effect_files import load_effects

    return {effect.name: effect for effect in load_effects(ROOT / "examples" / "blocked_ports.py")}


@pytest.fixture(scope="module")
def identified(example):
    return example.identify(DATA)


def leakage(effects, x, late=0.0):
    """(n,) of a valve whose spool is at x (n,) m, the memory of any effect at `late` Pa."""
    valve = vs.reference_valve()
    model = Model(effects=tuple(active.effect for active in effects))
    parts = PartTemperatures.uniform(20.0)
    c = model.flat_coefficients(valve.at(parts), effects, parts)
    x = np.asarray(x, dtype=float)
    state = State(0.0 * x, 0.0 * x, 1e7 + 0.0 * x, 1e7 + 0.0 * x, x, 0.0 * x)
    memory = tuple(late + 0.0 * x for active in effects for _ in active.effect.memory)
    inputs = Inputs(0.0, 0.0, valve.supply_pressure, valve.return_pressure, 0.0)
    return model.signals((*state, *memory), inputs, c).internal_leakage


def test_blocked_ports_leak_as_at_the_load_pressure_that_settles(own):
    valve = vs.reference_valve()
    c = valve.at(PartTemperatures.uniform(20.0))
    x = np.linspace(-5e-5, 5e-5, 21)
    distinct = main_stage(x, valve.supply_pressure, blocked_load_pressure(x, valve.supply_pressure, c), c)[1]
    joined = main_stage(x, valve.supply_pressure, 0.0, c)[1]
    added = leakage((own["blocked_ports"](share=1.0),), x) - leakage((), x)
    assert added == pytest.approx(distinct - joined, abs=0.02 * np.max(distinct))  # the clearances are left out
    assert np.max(distinct - joined) > 0.05 * np.max(distinct)


@pytest.mark.parametrize("name", ["blocked_ports", "blocked_port_oil"])
def test_neutral_effects_add_nothing(own, name):
    effect = own[name]
    x = np.linspace(-5e-5, 5e-5, 5)
    off = effect(**{effect.amplitude.name: effect.amplitude.neutral})
    assert np.array_equal(leakage((off,), x), leakage((), x))


def test_port_oil_takes_from_the_meter_while_the_load_pressure_rises(own):
    oil = own["blocked_port_oil"](volume=1e-4)
    x = np.array([1e-5])  # the load pressure is high here
    rising, falling = leakage((oil,), x, late=0.0), leakage((oil,), x, late=4e7)
    assert rising < leakage((), x) < falling


def test_a_slow_meter_trails_a_ramp_by_its_time_constant(own):
    active = own["slow_meter"].on("internal_leakage")(time_constant=2.0)
    time = np.linspace(0.0, 40.0, 401)
    read = active.effect.reading(Reading(time, 3.0 * time, None), active.values)
    assert read[-1] == pytest.approx(3.0 * (time[-1] - 2.0), rel=1e-6)


def test_ramps_finds_the_triangle_behind_a_coarse_reading(example):
    time = np.linspace(0.0, 100.0, 10001)
    true = np.interp(time, [0.0, 50.0, 100.0], [-5e-3, 5e-3, -5e-3])
    found = example.ramps(time, np.round(true * 1e4) / 1e4)
    assert np.max(np.abs(found - true)) < 2e-5  # of readings in steps of 1e-4 A


@needs_data
def test_the_base_valve_has_what_was_measured_within_two_deviations(identified):
    asked = {figure.asked.limit.figure: figure.asked.value for figure in identified.figures}
    assert asked["flow_gain"] * 60 == pytest.approx(0.392, abs=0.005)  # L/min/mA
    assert asked["null_leakage"] * 6e4 == pytest.approx(1.296, abs=0.01)
    assert all(figure.reached for figure in identified.figures) and identified.conflicts == ()


@needs_data
def test_the_preset_is_what_the_command_gives(identified):
    preset, found = vs.load_valve("servovalve_5329"), identified.valve
    assert preset.serial_number == found.serial_number == "5329" and preset.sources == found.sources
    for name in quantities(vs.Valve):
        assert getattr(preset.valve, name) == pytest.approx(getattr(found.valve, name), rel=1e-3, abs=1e-9), name
    assert preset.tolerances == pytest.approx(found.tolerances, rel=0.02)


@needs_data
def test_session_learns_from_the_slow_sweep_and_locks_the_fast_one(example, identified, tmp_path):
    folder = example.write_session(DATA, tmp_path / "session", identified.valve, [example.SLOW])
    session = load_session(folder, trust=True)
    assert [record.name for record in session.training] == ["leakage_sweep_500s"]
    assert [record.name for record in session.locked] == ["leakage_sweep_100s"]
    assert [active.effect.name for active in session.effects] == ["blocked_ports"]
    assert session.valve.port_width == pytest.approx(identified.valve.valve.port_width, rel=1e-5)
    assert "land_overlap" in session.tolerances
    (slow,) = session.training
    assert np.ptp(slow.values["current"]) == pytest.approx(10e-3, rel=0.01)
    assert np.max(slow.values["internal_leakage"]) * 6e4 == pytest.approx(1.33, abs=0.05)
