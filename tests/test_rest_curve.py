"""Every rest of a valve over the armature's angle: equal to the static solution, and null from it over conditions."""

from dataclasses import replace

import numpy as np
import pytest

import valvesim as vs
from valvesim.characterisation.acceptance.null_shift import null_shift_curves
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.rest_curve import blocked_position, blocked_pressure, null_current, rest_curve, spool_at
from valvesim.characterisation.thermal_drift import static_drift
from valvesim.inputs import Ramp
from valvesim.valve.equations import main_stage

CONDITIONS = {"supply_pressure": 21e6, "return_pressure": 0.5e6, "oil_temperature": 40.0}
UNEQUAL = replace(vs.Valve(), air_gap_difference=2e-6, null_gap_difference=0.5e-6)


def batch(members=4):
    dice = np.random.default_rng(2)
    spread = {name: getattr(UNEQUAL, name) * np.exp(0.1 * dice.normal(size=members))
              for name in ("null_gap", "nozzle_diameter", "port_width", "feedback_rod_stiffness")}  # fmt: skip
    return replace(UNEQUAL, **spread)


@pytest.mark.parametrize("load", [0.0, 8e6, -8e6])
def test_spool_over_current_is_that_of_the_static_solution(load):
    valves, current = batch(), np.linspace(-9e-3, 9e-3, 13)
    curve = rest_curve(valves, CONDITIONS, vs.MIL_PRF_5606)
    for k in range(4):
        one = replace(UNEQUAL, load_pressure=load, **{
            name: float(getattr(valves, name)[k])
            for name in ("null_gap", "nozzle_diameter", "port_width", "feedback_rod_stiffness")
        })  # fmt: skip
        exact = vs.static_solution(one, current=current, temperature=40.0).spool_position
        near_null = 1e-7 if load else 1e-10  # m: under load the flow force bends at zero travel
        np.testing.assert_allclose(spool_at(curve, current, load)[k], exact, rtol=2e-5, atol=near_null)


def test_the_current_that_holds_the_spool_is_the_one_that_brings_it_there():
    curve = rest_curve(batch(), CONDITIONS, vs.MIL_PRF_5606)
    x = np.linspace(-0.3e-3, 0.3e-3, 9) * np.ones((4, 1))
    current, _ = curve.holding(x, np.zeros(9))
    np.testing.assert_allclose(spool_at(curve, current), x, rtol=1e-4, atol=1e-9)


def test_blocked_ports_pass_nothing_either_way():
    curve = rest_curve(batch(), CONDITIONS, vs.MIL_PRF_5606)
    load = np.linspace(-0.9, 0.9, 7) * 21e6
    at = blocked_position(curve.c, 21e6, load)
    scale = main_stage(np.full((4, 1), 0.1e-3), 21e6, 0.0, curve.c)[0]
    assert np.all(np.abs(main_stage(at, 21e6, load, curve.c)[0]) < 1e-9 * scale)
    np.testing.assert_allclose(blocked_pressure(curve.c, 21e6, at), np.broadcast_to(load, at.shape), atol=10.0)


def test_null_of_equal_sides_is_zero_and_stays_there():
    rig = Rig(valve=vs.Valve(), oil=vs.MIL_PRF_5606, oil_temperature=40.0, effects=(), period=1e4, points=1000)
    for curve in null_shift_curves(rig):
        assert np.all(np.abs(curve.shift) < 1e-12)


def test_the_curve_over_temperature_is_zero_where_it_is_measured_and_null_moves_beside_it():
    rig = Rig(valve=UNEQUAL, oil=vs.MIL_PRF_5606, oil_temperature=10.0, effects=(), period=1e4, points=1000)
    temperature, supply, back = null_shift_curves(rig)
    assert [curve.condition for curve in (temperature, supply, back)] == list(
        ("oil_temperature", "supply_pressure", "return_pressure")
    )
    assert np.interp(10.0, temperature.at, temperature.shift) == pytest.approx(0.0, abs=1e-5)
    assert np.ptp(temperature.shift) > 1e-4 and np.ptp(supply.shift) > 0.0
    rests = [null_current(rest_curve(UNEQUAL, {**CONDITIONS, "oil_temperature": t}, vs.MIL_PRF_5606))[0]
             for t in (10.0, float(temperature.at[-1]))]  # fmt: skip
    assert temperature.shift[-1] == pytest.approx((rests[1] - rests[0]) / UNEQUAL.rated_current, rel=1e-6)


def test_null_along_a_warming_run_ends_where_it_is_at_its_end():
    warm = Ramp(start_value=20.0, end_value=90.0, rate=700.0)
    run = vs.simulate(vs.Scenario(
        valve=UNEQUAL, thermal=vs.Thermal(network=None), oil_temperature=warm, command=vs.Constant(value=1e-3),
        duration=0.1, output_rate=1e3,
    ))  # fmt: skip
    shift = static_drift(run).null_shift
    ends = [null_current(rest_curve(UNEQUAL, {**CONDITIONS, "oil_temperature": t}, vs.MIL_PRF_5606))[0]
            for t in (20.0, 90.0)]  # fmt: skip
    assert shift[0] == pytest.approx(0.0, abs=1e-9)
    assert shift[-1] == pytest.approx((ends[1] - ends[0]) / UNEQUAL.rated_current, rel=1e-3)
