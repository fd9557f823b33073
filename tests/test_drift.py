"""Drift along a run against the isothermal figures of model.md section 5, and against the run itself."""

import dataclasses

import numpy as np
import pytest

import valvesim as vs
from valvesim.characterisation.thermal_drift import (
    nominal,
    observed_drift,
    reference_current,
    static_drift,
    temperature_varies,
)
from valvesim.valve.coefficients import PART_NAMES

ISOTHERMAL = vs.Thermal(network=None)
LAUNCH = vs.Ramp(start_value=20.0, end_value=270.0, rate=100.0)  # in 2.5 s, so that a run takes milliseconds
SLOW = vs.Sine(amplitude=1e-3, frequency=10.0)
QUANTITIES = ("armature_angle", "spool_position")

# model.md 5: at 270 °C, isothermal, in percent of (angle, spool)
AT_270 = {
    "flow": (0.551, -0.047), "orifice": (-4.226, 0.376), "mmf": (-6.065, -6.065), "gap": (-0.855, -0.855),
    "reluctance": (0.318, 0.318), "arm": (0.284, 0.284), "tube": (1.795, 1.795), "rod": (6.737, 6.936),
}  # fmt: skip
TOTAL_AT_270 = (-1.429, 2.296)


def scenario(**changes):
    standard = {"duration": 2.5, "thermal": ISOTHERMAL, "oil_temperature": LAUNCH, "command": SLOW}
    return vs.Scenario(**(standard | changes))


@pytest.fixture(scope="module")
def launch():
    return vs.simulate(scenario())


@pytest.mark.parametrize("quantity, percent", list(zip(QUANTITIES, TOTAL_AT_270, strict=True)))
def test_the_drift_at_the_end_of_a_uniform_ramp_is_the_published_one(launch, quantity, percent):
    drift = static_drift(launch)
    assert drift.current == pytest.approx(1e-3) and drift.oil_temperature[[0, -1]] == pytest.approx([20.0, 270.0])
    assert 100.0 * drift.total[quantity][-1] == pytest.approx(percent, abs=6e-4)


@pytest.mark.parametrize("route", vs.ROUTES)
def test_the_drift_by_each_route_is_the_published_one(launch, route):
    drift = static_drift(launch).by_route[route]
    found = tuple(100.0 * drift[quantity][-1] for quantity in QUANTITIES)
    assert found == pytest.approx(AT_270[route], abs=6e-4)


def test_the_drift_is_the_static_solutions_at_every_instant(launch):
    drift = static_drift(launch, points=11)
    rest = vs.static_solution(vs.Valve(), current=1e-3, temperature=20.0 + 100.0 * drift.times)
    for quantity in QUANTITIES:
        values = getattr(rest, quantity)
        assert drift.total[quantity] == pytest.approx(values / values[0] - 1.0, rel=1e-9, abs=1e-12)
    assert drift.times == pytest.approx(np.linspace(0.0, 2.5, 11))


def test_drift_starts_at_zero_in_oil_of_20_degrees(launch):
    drift = static_drift(launch)
    for values in (drift.total, *drift.by_route.values()):
        assert [values[quantity][0] for quantity in QUANTITIES] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_only_the_active_routes_drift():
    thermal = vs.Thermal(network=None, routes=("mmf", "rod"))
    drift = static_drift(vs.simulate(scenario(thermal=thermal)))
    assert list(drift.by_route) == ["mmf", "rod"]
    both = [AT_270["mmf"][0], AT_270["rod"][0]]
    # the two multiply to first order: (1 - 0.06065)(1 + 0.06737) - 1 = 0.26 %, and the second order is below 0.1 %
    assert 100.0 * drift.total["armature_angle"][-1] == pytest.approx(
        np.prod(1 + np.array(both) / 100) * 100 - 100, abs=0.1
    )


def test_without_a_route_nothing_drifts():
    drift = static_drift(vs.simulate(scenario(thermal=vs.Thermal(network=None, routes=()))))
    assert not drift.by_route and np.max(np.abs(drift.total["spool_position"])) < 1e-12


def test_drift_is_told_at_the_commanded_pressure():
    result = vs.simulate(scenario(supply_pressure=vs.Constant(value=7e6)))
    rest = [vs.static_solution(vs.Valve(supply_pressure=7e6), current=1e-3, temperature=each) for each in (20.0, 270.0)]
    drift = static_drift(result).total["spool_position"][-1]
    assert drift == pytest.approx(float(rest[1].spool_position / rest[0].spool_position) - 1.0, rel=1e-9)
    assert abs(100.0 * drift - TOTAL_AT_270[1]) > 0.1  # another one than at the valve's own 21 MPa


def test_parts_that_lag_make_another_drift_than_the_oil_alone(launch):
    lagging = static_drift(vs.simulate(scenario(thermal=vs.Thermal())))
    # the torque motor is still cold, so that the flow coefficients and orifices act without its magnets
    assert abs(lagging.by_route["mmf"]["spool_position"][-1]) < 0.1 * abs(AT_270["mmf"][1]) / 100
    assert lagging.by_route["flow"]["armature_angle"][-1] == pytest.approx(AT_270["flow"][0] / 100, abs=6e-6)


def test_the_drift_that_a_slow_sine_shows_is_the_static_one():
    # 2 Hz over 30 s: each of the 60 windows is one cycle. The angle has a share that makes the spool move, so that it
    # follows its rest less closely than the spool does
    oil = vs.Ramp(start_value=20.0, end_value=270.0, rate=250.0 / 30.0)
    sine = vs.Sine(amplitude=1e-3, frequency=2.0)
    result = vs.simulate(scenario(duration=30.0, oil_temperature=oil, command=sine))
    times, observed = observed_drift(result, vs.simulate(nominal(result.scenario)))
    static = static_drift(result)
    assert len(times) == 60
    for quantity, near in (("armature_angle", 4e-3), ("spool_position", 2e-4)):
        expected = np.interp(times, static.times, static.total[quantity])
        assert observed[quantity] == pytest.approx(expected, abs=near)
        assert np.max(np.abs(expected)) > 0.014


def test_a_run_does_not_drift_from_itself(launch):
    observed = observed_drift(launch, launch)[1]
    assert all(np.max(np.abs(values)) < 1e-12 for values in observed.values())


def test_no_drift_is_observed_where_the_valve_stands_still():
    pulse = vs.simulate(scenario(command=vs.Pulse(height=5e-3, width=0.5, time=1.0)))
    times, observed = observed_drift(pulse, vs.simulate(nominal(pulse.scenario)))
    moves = (times > 1.05) & (times < 1.45)
    assert np.all(np.isfinite(observed["spool_position"][moves]))
    assert np.all(np.isnan(observed["spool_position"][(times < 0.95) | (times > 1.6)]))


def test_no_drift_is_observed_without_a_command():
    still = vs.simulate(scenario(command=vs.Constant(value=0.0)))
    observed = observed_drift(still, vs.simulate(nominal(still.scenario)))[1]
    assert all(np.all(np.isnan(values)) for values in observed.values())


def test_the_nominal_run_is_the_same_run_with_every_part_at_20_degrees():
    thermal = vs.Thermal(initial_temperature=-40.0, ambient_temperature=-40.0, throttling_heat=True, routes=("mmf",))
    case = scenario(thermal=thermal, duration=0.1)
    cold = vs.simulate(nominal(case))
    for part in PART_NAMES:
        assert np.array_equal(cold.values[f"{part}_temperature"], np.full(len(cold.time), 20.0))
    assert dataclasses.replace(cold.scenario, thermal=thermal, oil_temperature=LAUNCH) == case
    assert cold.scenario.thermal.routes == ("mmf",)


@pytest.mark.parametrize(
    "changes, current",
    [
        ({"command": vs.Sine(amplitude=2e-3, frequency=1.0, offset=1e-3)}, 3e-3),
        ({"command": vs.Constant(value=-4e-3)}, 4e-3),
        ({"command": vs.Constant(value=50e-3)}, 10e-3),  # the rated current
        ({"command": vs.Constant(value=0.0)}, 1e-3),  # a tenth of it
        ({"command": vs.Constant(value=3.0), "drive": vs.VoltageDrive()}, 5e-3),  # over 600 ohm
    ],
)
def test_drift_is_told_at_the_largest_current_of_the_command(changes, current):
    assert reference_current(scenario(**changes)) == pytest.approx(current, rel=1e-12)


HELD = {"oil_temperature": vs.Constant(value=20.0)}


@pytest.mark.parametrize(
    "changes, varies",
    [
        ({}, True),
        (HELD, False),
        (HELD | {"thermal": vs.Thermal()}, False),
        (HELD | {"thermal": vs.Thermal(initial_temperature=-40.0)}, True),
        (HELD | {"thermal": vs.Thermal(ambient_temperature=-40.0)}, True),
        (HELD | {"thermal": vs.Thermal(throttling_heat=True)}, True),
        (HELD | {"thermal": vs.Thermal(network=None, initial_temperature=-40.0)}, False),  # no part has a start
        ({"oil_temperature": vs.Constant(value=21.0)}, True),
        ({"oil_temperature": vs.Pulse(base=20.0, height=70.0, width=1e-3, time=1.2345)}, True),
        ({"oil_temperature": vs.Sine(amplitude=5.0, offset=20.0, frequency=40.0)}, True),  # zero at 101 even instants
    ],
)
def test_temperature_varies_where_oil_or_any_part_leaves_20_degrees(changes, varies):
    assert temperature_varies(scenario(**changes)) is varies
