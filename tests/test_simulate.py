"""Runs against the static solution, other integrators, closed forms and themselves."""

import csv
import dataclasses
import re
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import valvesim as vs
from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.solver.codegen import trace
from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.equations import main_stage
from valvesim.valve.fluid import MIL_PRF_5606

MODULE = import_module("valvesim.simulation.run")  # the package's name for it is the function
ISOTHERMAL = vs.Thermal(network=None)
VALVE = vs.reference_valve()
NAMES = [channel.name for channel in vs.Model().state_channels]
SCALE = np.array([channel.scale for channel in vs.Model().state_channels])
STEP = vs.Step(after=5e-3, time=1e-3)


def run(command, duration, temperature=20.0, **more):
    """An isothermal run of the reference valve."""
    oil = vs.Constant(value=temperature)
    scenario = {"thermal": ISOTHERMAL, "oil_temperature": oil, "command": command, "duration": duration}
    return vs.simulate(vs.Scenario(**(scenario | more)))


def states(result):
    """All states of the valve in scaled form, (6, n_t)."""
    return np.array([result.values[name] for name in NAMES]) / SCALE[:, None]


def apart(one, other):
    """Largest difference of any state of two runs, as a share of that state's amplitude."""
    return np.max(np.abs(one - other) / np.ptp(other, axis=1)[:, None])


def spoiled(friction=0.0, coercive=0.0, play=0.0):
    """Three effects at once, so that one compiled model serves all of them."""
    return (
        vs.effect("spool_coulomb_friction")(friction_force=friction),
        vs.effect("magnetic_hysteresis")(coercive_current=coercive),
        vs.effect("feedback_ball_backlash")(half_play=play),
    )


# --- against the static solution -------------------------------------------------------------------------------------


@pytest.mark.parametrize("temperature", [20.0, 40.0, 100.0, 200.0, 270.0])
@pytest.mark.parametrize("milliamperes", [0.1, -0.1, 1.0, -1.0, 5.0, -5.0, 10.0, -10.0])
def test_a_held_valve_settles_on_the_static_solution(temperature, milliamperes):
    current = milliamperes * 1e-3
    result = run(vs.Step(after=current, time=1e-3), 0.5, temperature, output_rate=10.0)
    rest = vs.static_solution(VALVE, current=current, temperature=temperature)
    for name in ("armature_angle", "spool_position"):
        assert result.values[name][-1] == pytest.approx(float(getattr(rest, name)), rel=1e-6)


def test_the_run_settles_where_an_independent_program_says():
    # model.md 5: at 20 °C and 1 mA theta = 5.0416154e-5 rad and x_v = 3.9378931e-5 m
    result = run(vs.Step(after=1e-3, time=1e-3), 0.5)
    assert result.values["armature_angle"][-1] == pytest.approx(5.0416154e-5, rel=1e-7)
    assert result.values["spool_position"][-1] == pytest.approx(3.9378931e-5, rel=1e-7)


@pytest.mark.parametrize("milliamperes", [0.0, 3.0, -10.0])
def test_a_run_starts_from_rest(milliamperes):
    result = run(vs.Constant(value=milliamperes * 1e-3), 0.05, 150.0)
    assert np.max(np.ptp(states(result), axis=1)) < 1e-7


def test_a_run_with_effects_starts_from_rest():
    result = run(vs.Constant(value=3e-3), 0.05, effects=spoiled(2.0, 3e-4, 5e-6))
    assert np.max(np.ptp(states(result), axis=1)) < 1e-7


def test_an_unequal_valve_settles_on_its_own_static_solution():
    valve = dataclasses.replace(VALVE, null_gap_difference=2e-6, air_gap_difference=5e-6)
    result = run(vs.Step(after=1e-3, time=1e-3), 0.5, valve=valve)
    rest = vs.static_solution(valve, current=1e-3)
    assert result.values["spool_position"][-1] == pytest.approx(float(rest.spool_position), rel=1e-6)
    assert abs(float(rest.spool_position) / 3.9378931e-5 - 1.0) > 0.01  # not the equal valve's


def test_a_commanded_pressure_acts_as_the_valves_own():
    rest = vs.static_solution(dataclasses.replace(VALVE, supply_pressure=15e6), current=1e-3)
    step = vs.Step(before=21e6, after=15e6, time=1e-3)
    result = run(vs.Constant(value=1e-3), 0.5, supply_pressure=step)
    assert result.values["spool_position"][-1] == pytest.approx(float(rest.spool_position), rel=1e-6)
    assert result.values["supply_pressure"][[0, -1]] == pytest.approx([21e6, 15e6])


@pytest.mark.parametrize("temperature", [20.0, 100.0, 270.0])
def test_a_voltage_settles_at_the_current_of_its_hot_resistance(temperature):
    drive = vs.VoltageDrive()
    result = run(vs.Step(after=3.0, time=1e-3), 0.5, temperature, drive=drive)
    current = 3.0 / (600.0 * (1.0 + 3.93e-3 * (temperature - 20.0)))  # 600 ohm at 20 °C, copper 3.93e-3/K
    assert result.values["current"][-1] == pytest.approx(current, rel=1e-6)
    rest = vs.static_solution(VALVE, current=current, temperature=temperature)
    assert result.values["spool_position"][-1] == pytest.approx(float(rest.spool_position), rel=1e-6)
    assert np.array_equal(result.values["voltage"] > 0.0, result.time >= 1e-3)


def test_the_current_of_a_voltage_drive_rises_with_the_time_constant_of_the_coils():
    # L/R = 0.57 H/600 ohm = 0.95 ms; the armature's motion is held back by a stiff spring tube
    stiff = dataclasses.replace(VALVE, spring_tube_stiffness=1e4)
    result = run(vs.Step(after=3.0, time=0.0), 0.00095, drive=vs.VoltageDrive(), valve=stiff, output_rate=1e6)
    assert result.values["current"][0] == pytest.approx(5e-3)  # a step at zero is there from the start
    late = run(vs.Step(after=3.0, time=1e-3), 0.00195, drive=vs.VoltageDrive(), valve=stiff, output_rate=1e5)
    assert late.values["current"][-1] == pytest.approx(5e-3 * (1.0 - np.exp(-1.0)), rel=1e-3)


# --- against other integrators ---------------------------------------------------------------------------------------

TIMES = np.linspace(0.0, 0.019, 1901)  # after the step


@cache
def constants(temperature):
    """(initial scaled state, inputs, coefficients) behind the step."""
    c = VALVE.at(vs.PartTemperatures.uniform(temperature))
    rest = vs.static_solution(VALVE, current=0.0, temperature=temperature)
    y = np.array([0.0, 0.0, float(rest.nozzle_pressure_1), float(rest.nozzle_pressure_2), 0.0, 0.0]) / SCALE
    u = (5e-3, 0.0, VALVE.supply_pressure, VALVE.return_pressure, VALVE.load_pressure)
    return y, u, tuple(float(value) for value in c)


@cache
def radau(temperature):
    """The step by scipy's Radau method on `Model.rhs`, with CasADi's Jacobian; (6, n_t) scaled."""
    y, u, c = constants(temperature)
    model, slopes = vs.Model(), vs.derivatives(vs.Model())

    def rate(t, y):
        return np.array(model.rhs(tuple(y * SCALE), u, c)) / SCALE

    def jacobian(t, y):
        return np.array(slopes(y * SCALE, u, c)[0]) * SCALE / SCALE[:, None]

    return solve_ivp(rate, (0.0, 0.019), y, "Radau", TIMES, jac=jacobian, rtol=1e-7, atol=1e-9).y


@cache
def cvodes(temperature):
    """The step by SUNDIALS' CVODES on the traced `Model.rhs`; (6, n_t) scaled."""
    import casadi

    start, u, c = constants(temperature)
    rates, at = trace(vs.Model())
    y = casadi.SX.sym("y", 6)
    values = [(at["state"], y * SCALE), (at["inputs"], casadi.DM(u)), (at["coefficients"], casadi.DM(c))]
    for symbol, value in values:
        rates = casadi.substitute(rates, symbol, value)
    options = {"reltol": 1e-9, "abstol": 1e-11, "max_num_steps": 100000}
    solve = casadi.integrator("solve", "cvodes", {"x": y, "ode": rates / SCALE}, 0.0, list(TIMES[1:]), options)
    return np.column_stack([start, np.array(solve(x0=start)["xf"])])


@pytest.mark.parametrize("temperature", [20.0, 270.0])
@pytest.mark.parametrize("reference", [radau, cvodes])
def test_a_step_agrees_with_another_integrator(reference, temperature):
    result = run(STEP, 0.02, temperature, output_rate=1e5, tolerance=1e-6)
    assert apart(states(result)[:, 100:], reference(temperature)) < 1e-5


@pytest.mark.parametrize("temperature", [20.0, 270.0])
def test_at_the_usual_tolerance_spool_and_angle_are_good_to_a_ten_thousandth(temperature):
    result = run(STEP, 0.02, temperature, output_rate=1e5)
    pick = [NAMES.index("armature_angle"), NAMES.index("spool_position")]
    assert apart(states(result)[pick, 100:], cvodes(temperature)[pick]) < 1e-4


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6, 1e-7])
def test_the_error_follows_the_tolerance(tolerance):
    # measured 0.7 to 3 of the tolerance times the scale of each state
    result = run(STEP, 0.02, 20.0, output_rate=1e5, tolerance=tolerance)
    error = np.max(np.abs(states(result)[:, 100:] - cvodes(20.0)))
    assert error < 5.0 * tolerance


def test_a_run_in_fast_changing_oil_agrees_with_coefficients_taken_at_every_instant():
    rate, duration = 5000.0, 0.05
    ramp = vs.Ramp(start_value=20.0, end_value=270.0, rate=rate)
    result = run(vs.Constant(value=5e-3), duration, oil_temperature=ramp, output_rate=1e4, tolerance=1e-6)
    model, u, last = vs.Model(), constants(20.0)[1], {}

    def rates(t, y):
        if t not in last:
            last.clear()
            last[t] = tuple(map(float, VALVE.at(vs.PartTemperatures.uniform(20.0 + rate * t))))
        return np.array(model.rhs(tuple(y * SCALE), u, last[t])) / SCALE

    found = states(result)[:, :: len(result.time) // 10]
    times = result.time[:: len(result.time) // 10]
    y = solve_ivp(rates, (0.0, duration), found[:, 0], "BDF", times, rtol=1e-6, atol=1e-8).y
    for name in ("armature_angle", "spool_position"):
        drift, error = np.ptp(y[NAMES.index(name)]), np.abs(found - y)[NAMES.index(name)]
        assert drift > 1e-3 and np.max(error) < 5e-3 * drift  # 25 knots, each 10 K apart


# --- breaks and jumps ------------------------------------------------------------------------------------------------


def test_a_pulse_of_one_millisecond_is_never_missed():
    early, late = (
        run(vs.Pulse(height=5e-3, width=1e-3, time=time), time + 0.05, output_rate=1e4) for time in (0.01, 7.7)
    )
    peaks = [np.max(result.values["spool_position"]) for result in (early, late)]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-4)
    assert peaks[0] > 2e-5  # the valve rests at 2e-4 m under a held 5 mA


def test_a_pulse_between_two_samples_is_not_missed():
    coarse, fine = (run(vs.Pulse(height=5e-3, width=1e-3, time=0.9987), 1.0, output_rate=rate) for rate in (10.0, 1e4))
    assert coarse.values["spool_position"][-1] == pytest.approx(fine.values["spool_position"][-1], rel=1e-9)
    assert abs(fine.values["spool_position"][-1]) > 1e-6


def test_the_samples_do_not_change_the_run():
    coarse, fine = (run(STEP, 0.05, output_rate=rate) for rate in (1e3, 1e5))
    assert coarse.time == pytest.approx(fine.time[::100], rel=1e-12)
    assert np.array_equal(states(coarse), states(fine)[:, ::100])
    assert coarse.statistics["accepted_steps"] == fine.statistics["accepted_steps"]


@pytest.mark.parametrize(
    "duration, rate", [(0.06, 1e5), (0.3, 10.0), (1.1, 3e3), (0.29, 7e3), (7.77 + 0.05, 1e3), (100 * 1e-6, 1e5)]
)
def test_samples_run_from_zero_to_the_end_and_none_is_empty(duration, rate):
    result = run(vs.Constant(value=1e-3), duration, output_rate=rate)
    assert result.time[0] == 0.0 and duration - 1.0 / rate < result.time[-1] <= duration * (1 + 1e-12)
    assert np.diff(result.time) == pytest.approx(1.0 / rate, rel=1e-6)
    assert all(np.all(np.isfinite(values)) for values in result.values.values())


def test_a_jump_of_the_oil_is_a_jump_of_the_coefficients():
    oil = vs.Step(before=20.0, after=270.0, time=0.1)
    result = run(vs.Constant(value=1e-3), 0.6, oil_temperature=oil)
    cold, hot = (vs.static_solution(VALVE, current=1e-3, temperature=each) for each in (20.0, 270.0))
    x, before = result.values["spool_position"], result.time < 0.1
    assert x[before] == pytest.approx(np.full(np.sum(before), float(cold.spool_position)), rel=1e-6)
    assert x[-1] == pytest.approx(float(hot.spool_position), rel=1e-6)
    assert np.array_equal(result.values["oil_temperature"], np.where(result.time < 0.1, 20.0, 270.0))


def test_no_step_crosses_a_jump_of_the_oil():
    # a jump of zero height in the command ends a step there in any case
    oil, height = vs.Step(before=20.0, after=270.0, time=0.01234), vs.Constant(value=5e-3)
    free, ended = (
        run(command, 0.05, oil_temperature=oil, output_rate=1e4)
        for command in (height, vs.Sum((height, vs.Step(time=0.01234))))
    )
    assert apart(states(free), states(ended)) < 1e-9


def test_magnetic_hysteresis_passes_through_a_jump_as_through_a_steep_ramp():
    ramp = vs.Ramp(end_value=5e-3, rate=5e3, time=1e-3)  # done in 1 us
    jump, steep = (
        run(command, 0.03, effects=spoiled(coercive=3e-4), output_rate=1e4, tolerance=1e-6) for command in (STEP, ramp)
    )
    for name in ("spool_position", "magnetic_hysteresis_state"):
        assert jump.values[name][-1] == pytest.approx(steep.values[name][-1], rel=1e-7)
    # Dahl's closed form along a rising current: z = 1 - exp(-i/i_t) with i_t = 2 mA
    assert jump.values["magnetic_hysteresis_state"][-1] == pytest.approx(1.0 - np.exp(-2.5), rel=1e-6)


def test_a_jump_is_over_within_a_microsecond_also_for_what_feels_its_rate():
    result = run(STEP, 1.001e-3, effects=spoiled(coercive=3e-4), output_rate=1e6)
    assert result.values["magnetic_hysteresis_state"][[-2, -1]] == pytest.approx([0.0, 1.0 - np.exp(-2.5)], abs=1e-6)


@pytest.mark.parametrize("rise", [1e-6, 1e-9, 1e-10, 1e-12])
def test_magnetic_hysteresis_passes_through_a_table_of_any_steepness(rise):
    table = vs.Table(times=(0.0, 1e-3, 1e-3 + rise, 1.0), values=(0.0, 0.0, 5e-3, 5e-3))
    result = run(table, 0.01, effects=spoiled(coercive=3e-4))
    assert result.values["magnetic_hysteresis_state"][-1] == pytest.approx(1.0 - np.exp(-2.5), rel=1e-5)


# --- effects ---------------------------------------------------------------------------------------------------------


def test_effects_at_their_neutral_values_change_nothing():
    command = vs.Sine(amplitude=5e-3, frequency=100.0)
    plain, neutral = (
        run(command, 0.05, effects=effects, output_rate=1e4, tolerance=1e-7) for effects in ((), spoiled())
    )
    assert apart(states(neutral), states(plain)) < 1e-6


def cycle(amplitude, period, **sizes):
    """(spool falling, spool rising) through zero current in a slow triangle of current."""
    times, values = np.array([0.0, 0.25, 0.75, 1.25]) * period, np.array([0.0, 1.0, -1.0, 1.0]) * amplitude
    command = vs.Table(times=tuple(times), values=tuple(values))
    result = run(command, period, effects=spoiled(**sizes), tolerance=1e-6)
    return np.interp([period / 2, period], result.time, result.values["spool_position"])


@pytest.mark.parametrize("friction", [1.0, 5.0])
def test_friction_opens_a_loop_as_wide_as_the_static_solution_with_and_against_it(friction):
    falling, rising = cycle(2e-3, 4.0, friction=friction)
    lag = np.subtract(*cycle(2e-3, 4.0))  # of the moving spool without friction
    with_, against = (vs.static_solution(VALVE, current=0.0, friction=sign * friction) for sign in (-1.0, 1.0))
    width = float(with_.spool_position - against.spool_position)
    assert falling - rising - lag == pytest.approx(width, rel=1e-3)


@pytest.mark.parametrize("amplitude", [2e-3, 10e-3])
def test_magnetic_hysteresis_opens_the_loop_of_dahls_closed_form(amplitude):
    coercive, turning = 3e-4, 2e-3
    falling, rising = cycle(amplitude, 4.0, coercive=coercive)
    lag = np.subtract(*cycle(amplitude, 4.0))
    shrink = np.exp(-amplitude / turning)
    z_top = 1.0 - shrink
    z_falling = -1.0 + (1.0 + z_top) * shrink
    z_bottom = -1.0 + (1.0 + z_falling) * shrink
    z_rising = 1.0 - (1.0 - z_bottom) * shrink
    at = [vs.static_solution(VALVE, current=-coercive * z).spool_position for z in (z_falling, z_rising)]
    assert falling - rising - lag == pytest.approx(float(at[0] - at[1]), rel=0.01)


def test_within_the_backlash_the_valve_rests_as_without_a_feedback_rod():
    rodless = dataclasses.replace(VALVE, feedback_rod_stiffness=1e-6)
    rest = vs.static_solution(rodless, current=1e-5)
    result = run(vs.Step(after=1e-5, time=1e-3), 0.5, effects=spoiled(play=20e-6))
    assert result.values["spool_position"][-1] == pytest.approx(float(rest.spool_position), rel=1e-5)
    assert float(rest.spool_position) > 5.0 * 3.9378931e-7  # against model.md 5 with the rod: a jump through null


def every_effect():
    """Every effect with a balance, small: one compiled model, that of test_compiled.py."""
    acting = [e for e in vs.CATALOGUE.values() if e.balance is not None]
    return tuple(e(**{e.amplitude.name: 0.3 * e.amplitude.typical}) for e in acting)


@pytest.mark.slow
def test_a_run_with_every_effect_starts_from_rest_with_its_memories():
    drive, voltage = vs.VoltageDrive(), vs.Constant(value=3e-3 * VALVE.coil_resistance)
    result = run(voltage, 0.02, effects=every_effect(), drive=drive, tolerance=1e-6)
    assert np.max(np.ptp(states(result), axis=1)) < 1e-5
    memory = {name: result.values[name] for name in ("eddy_lagging_current", "supply_droop_flow", "silt")}
    assert memory["eddy_lagging_current"] == pytest.approx(3e-3, rel=1e-6)
    assert memory["silt"] == pytest.approx(1.0, rel=1e-6)
    # the flow that the supply feels is that at its undisturbed pressure
    c = VALVE.at(PartTemperatures.uniform(20.0))
    flow, _ = main_stage(result.values["spool_position"], VALVE.supply_pressure, 0.0, c)
    assert memory["supply_droop_flow"] == pytest.approx(flow, rel=1e-5)
    assert np.all(flow > 1e-5)


def test_a_sensor_effect_changes_its_channel_and_no_other():
    sensors = (
        vs.effect("sensor_gain").on("spool_position")(gain_error=0.1),
        vs.effect("sensor_bias").on("spool_position")(bias=-4e-6),
        vs.effect("sensor_delay").on("load_flow")(delay=5e-3),
        vs.effect("sensor_temperature_drift").on("nozzle_pressure_1")(drift=1e4),
    )
    plain, read = (run(STEP, 0.02, 50.0, effects=effects).values for effects in ((), sensors))
    assert read["spool_position"] == pytest.approx(1.1 * plain["spool_position"] - 4e-6, rel=1e-12, abs=1e-18)
    assert read["load_flow"][5:] == pytest.approx(plain["load_flow"][:-5], rel=1e-9, abs=1e-12)
    assert read["load_flow"][:5] == pytest.approx(np.full(5, plain["load_flow"][0]), abs=1e-12)
    assert read["nozzle_pressure_1"] - plain["nozzle_pressure_1"] == pytest.approx(1e4 * (50.0 - 20.0), rel=1e-6)
    changed = {"spool_position", "load_flow", "nozzle_pressure_1"}
    assert all(np.array_equal(read[name], plain[name]) for name in plain if name not in changed)


def test_sensors_read_in_the_order_in_which_they_are_given():
    gain = vs.effect("sensor_gain").on("armature_angle")(gain_error=0.5)
    bias = vs.effect("sensor_bias").on("armature_angle")(bias=1e-4)
    plain, one, other = (
        run(STEP, 0.005, effects=effects).values["armature_angle"] for effects in ((), (gain, bias), (bias, gain))
    )
    assert one == pytest.approx(1.5 * plain + 1e-4, rel=1e-12)
    assert other == pytest.approx(1.5 * (plain + 1e-4), rel=1e-12)


def test_a_thermal_lag_moves_every_part_but_the_oil():
    ramp = vs.Ramp(start_value=20.0, end_value=60.0, rate=40.0)
    more = {"oil_temperature": ramp, "output_rate": 100.0}
    plain, late, neutral = (
        run(STEP, 1.0, effects=effects, **more).values
        for effects in ((), *((vs.effect("thermal_lag")(time_constant=tau),) for tau in (0.5, 0.0)))
    )
    time = np.linspace(0.0, 1.0, 101)
    assert np.array_equal(late["oil_temperature"], plain["oil_temperature"])
    # a first-order lag of a ramp; the lines between its knots are good to what the coefficients ask for
    expected = 20.0 + 40.0 * (time - 0.5 * (1.0 - np.exp(-time / 0.5)))
    for name in ("body", "feedback_rod", "spool"):
        assert late[f"{name}_temperature"] == pytest.approx(expected, abs=0.05)
    assert np.max(np.abs(late["spool_position"] - plain["spool_position"])) > 1e-7
    assert all(np.array_equal(neutral[name], plain[name]) for name in plain)


@pytest.mark.parametrize("name, figures", [("spool_lap", {"overlap": 1e-5}), ("spool_edge_wear", {"rounding": 1e-5})])
def test_worn_lands_change_the_flow_and_leave_the_spool(name, figures):
    plain, worn = (run(STEP, 0.02, effects=effects).values for effects in ((), (vs.effect(name)(**figures),)))
    assert np.array_equal(worn["spool_position"], plain["spool_position"])
    assert np.max(np.abs(worn["load_flow"] - plain["load_flow"])) > 1e-6


def test_beyond_the_backlash_the_spool_has_jumped_by_a_constant_amount():
    def ahead(current):
        rest = vs.static_solution(VALVE, current=current)
        result = run(vs.Step(after=current, time=1e-3), 0.5, effects=spoiled(play=5e-6))
        return result.values["spool_position"][-1] - float(rest.spool_position)

    jump = ahead(2e-3)
    assert 2e-6 < jump < 5e-6  # at most the play itself
    assert ahead(4e-3) == pytest.approx(jump, rel=0.02) and ahead(-2e-3) == pytest.approx(-jump, rel=1e-5)


# --- invariants ------------------------------------------------------------------------------------------------------


def test_the_mirrored_command_gives_the_mirrored_run():
    command = vs.Table(times=(0.0, 5e-3, 8e-3, 0.02, 0.05), values=(0.0, 8e-3, -3e-3, 4e-3, 0.0))
    mirrored = vs.Table(times=command.times, values=tuple(-value for value in command.values))
    one, other = (states(run(each, 0.05, 60.0, output_rate=1e4)) for each in (command, mirrored))
    sign = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0])[:, None]
    assert apart(sign * other[[0, 1, 3, 2, 4, 5]], one) < 1e-9


def test_the_same_run_twice_is_the_same_to_the_last_bit():
    scenario = vs.Scenario(
        duration=0.3, command=STEP, oil_temperature=vs.Ramp(start_value=20.0, end_value=80.0, rate=90.0)
    )
    one, other = vs.simulate(scenario), vs.simulate(scenario)
    assert all(np.array_equal(one.values[name], other.values[name]) for name in one.names)


@pytest.mark.parametrize("side", [1, 2])
@pytest.mark.parametrize("temperature", [20.0, 200.0])
def test_what_flows_into_a_chamber_moves_the_spool_or_is_compressed(side, temperature):
    # (V/beta) p' = q_0 - q_n -+ A_v v (model.md 3), integrated: V/K1 ln[(K0 + K1 p(end))/(K0 + K1 p(0))] on the left
    result = run(vs.Sine(amplitude=5e-3, frequency=100.0), 0.0123, temperature, output_rate=2e6, tolerance=1e-6)
    oil, c = MIL_PRF_5606, VALVE.at(vs.PartTemperatures.uniform(temperature))
    p, x = result.values[f"nozzle_pressure_{side}"], result.values["spool_position"]
    area = np.pi * float(c.fixed_orifice_diameter_1) ** 2 / 4.0 * float(c.orifice_flow_coefficient)
    q_0 = area * np.sqrt(2.0 * (21e6 - p) / float(c.density))
    inflow = np.trapezoid(q_0 - result.values[f"nozzle_flow_{side}"], result.time)
    swept = VALVE.spool_area * (x[-1] - x[0]) * (1.0 if side == 1 else -1.0)
    K0, K1 = oil.bulk_modulus_at_zero(temperature), oil.bulk_modulus_slope
    squeezed = VALVE.chamber_volume / K1 * np.log((K0 + K1 * p[-1]) / (K0 + K1 * p[0]))
    assert abs(swept) > 1e-9 and abs(squeezed) > 1e-13
    assert inflow == pytest.approx(swept + squeezed, abs=1e-5 * abs(swept))


@settings(max_examples=25)
@given(st.lists(st.floats(-10e-3, 10e-3), min_size=2, max_size=8), st.floats(-40.0, 270.0))
def test_within_rated_current_every_run_stays_finite_and_inside_its_stops(values, temperature):
    times = tuple(5e-3 * k for k in range(len(values)))
    result = run(vs.Table(times=times, values=tuple(values)), 0.05, temperature, output_rate=1e4)
    assert np.all(np.isfinite(states(result)))
    assert np.max(np.abs(result.values["spool_position"])) < 1.1 * VALVE.spool_stroke
    assert np.all(result.values["nozzle_pressure_1"] > 0.0) and np.all(result.values["nozzle_pressure_1"] < 22e6)


# --- batches ---------------------------------------------------------------------------------------------------------


def test_a_batch_gives_what_its_valves_give_one_by_one():
    gaps, masses = np.array([30e-6, 35e-6, 41e-6]), np.array([3e-3, 4e-3, 6e-3])
    scenario = vs.Scenario(
        duration=0.1,
        command=STEP,
        oil_temperature=vs.Ramp(start_value=20.0, end_value=120.0, rate=1000.0),
        valve=dataclasses.replace(VALVE, null_gap=gaps, spool_mass=masses),
    )
    batch = vs.simulate_batch(scenario)
    assert set(batch) == {"time", *NAMES} and batch["spool_position"].shape == (3, len(batch["time"]))
    for k in range(3):
        valve = dataclasses.replace(VALVE, null_gap=gaps[k], spool_mass=masses[k])
        alone = vs.simulate(dataclasses.replace(scenario, valve=valve))
        member = np.array([batch[name][k] for name in NAMES]) / SCALE[:, None]
        assert apart(member, states(alone)) < 1e-9
    assert np.ptp(batch["spool_position"][:, -1]) > 1e-7


def many_gaps(members, **changes):
    valve = dataclasses.replace(VALVE, null_gap=np.linspace(30e-6, 40e-6, members))
    return vs.Scenario(**{"duration": 0.02, "command": STEP, "thermal": ISOTHERMAL, "valve": valve} | changes)


@pytest.mark.parametrize("members", [8, 11, 17])
def test_valves_that_take_their_steps_together_give_what_each_gives_alone(members):
    scenario = many_gaps(members)
    batch = vs.simulate_batch(scenario)
    for k in range(members):
        valve = dataclasses.replace(VALVE, null_gap=scenario.valve.null_gap[k])
        alone = states(vs.simulate(dataclasses.replace(scenario, valve=valve)))
        member = np.array([batch[name][k] for name in NAMES]) / SCALE[:, None]
        assert apart(member, alone) < scenario.tolerance


def test_a_batch_in_parts_is_the_batch(monkeypatch):
    oil = vs.Ramp(start_value=20.0, end_value=60.0, rate=1000.0)
    scenario = many_gaps(26, oil_temperature=oil, thermal=vs.Thermal())
    whole = vs.simulate_batch(scenario)
    module = import_module("valvesim.simulation.batch")
    sizes = []
    monkeypatch.setattr(module, "prepare", lambda *a, **k: sizes.append(MODULE.prepare(*a, **k)) or sizes[-1])
    monkeypatch.setattr(module, "KNOT_BYTES", 1.0)
    parts = vs.simulate_batch(scenario)
    assert [len(problem.knots) for problem in sizes] == [8, 8, 8, 2]
    assert all(np.array_equal(whole[name], parts[name]) for name in whole)


def test_a_valve_that_fails_in_a_later_part_is_named_by_its_number_in_the_batch(monkeypatch):
    monkeypatch.setattr(import_module("valvesim.simulation.batch"), "KNOT_BYTES", 1.0)
    problems = import_module("valvesim.simulation.batch")._problems(many_gaps(17))
    next(problems)
    problem = next(problems)
    problem.initial[3] = np.nan
    with pytest.raises(SolveError, match="the integration of member 11 failed"):
        import_module("valvesim.simulation.batch")._states(problem, np.arange(8))


def test_a_valve_that_fails_leaves_its_neighbours_alone(monkeypatch):
    problem = MODULE.prepare(many_gaps(9))
    problem.initial[4] = np.nan
    answers = list(MODULE.integrate_batch(problem, range(9)))
    assert isinstance(answers[4], SolveError) and "member 4" in str(answers[4])
    for k in (0, 3, 5, 8):
        assert np.array_equal(answers[k], MODULE.integrate_member(problem, k, None)[0])


def test_a_batch_is_refused_where_one_valve_is_meant():
    valve = dataclasses.replace(VALVE, null_gap=np.array([30e-6, 35e-6]))
    with pytest.raises(InputError, match=r"valve\.null_gap is an array, a batch of valves: use simulate_batch"):
        run(STEP, 0.01, valve=valve)


def test_a_batch_is_the_same_on_any_number_of_threads():
    one, four = (vs.simulate_batch(many_gaps(21), workers=workers) for workers in (1, 4))
    assert all(np.array_equal(one[name], four[name]) for name in one)


# --- results ---------------------------------------------------------------------------------------------------------

UNITS = {
    **{f"{part}_temperature": "degC" for part in PART_NAMES},
    "supply_pressure": "Pa", "return_pressure": "Pa", "load_pressure": "Pa",
    "armature_angle": "rad", "armature_rate": "rad/s", "nozzle_pressure_1": "Pa", "nozzle_pressure_2": "Pa",
    "spool_position": "m", "spool_velocity": "m/s",
    "current": "A", "drive_torque": "N*m", "flapper_position": "m", "feedback_force": "N", "flow_force": "N",
    "pilot_differential_pressure": "Pa", "pilot_flow": "m^3/s", "nozzle_flow_1": "m^3/s", "nozzle_flow_2": "m^3/s",
    "load_flow": "m^3/s", "internal_leakage": "m^3/s",
}  # fmt: skip


@pytest.fixture(scope="module")
def result():
    return run(STEP, 0.02, 100.0, title="A step", output_rate=1e4)


def test_a_result_holds_every_channel_with_its_unit(result):
    assert result.names == tuple(UNITS)
    assert {name: result[name].attrs["units"] for name in result.names} == UNITS
    assert all(result[name].dims == ("time",) and result[name].attrs["long_name"] for name in result.names)


def test_the_memory_of_effects_and_the_voltage_are_channels_too():
    names = run(vs.Constant(value=0.0), 0.001, effects=spoiled()).names
    assert {"coulomb_friction_state", "magnetic_hysteresis_state"} == set(names) - set(UNITS)
    driven = run(vs.Constant(value=0.6), 0.001, drive=vs.VoltageDrive())
    assert {"voltage", "drive_current"} == set(driven.names) - set(UNITS)
    assert driven.values["voltage"] == pytest.approx(0.6) and driven.values["drive_current"] == pytest.approx(1e-3)


def test_the_signals_obey_the_equations_at_every_sample(result):
    v = result.values
    assert v["pilot_differential_pressure"] == pytest.approx(v["nozzle_pressure_1"] - v["nozzle_pressure_2"], abs=1.0)
    assert v["flapper_position"] == pytest.approx(8.9e-3 * v["armature_angle"], rel=1e-9)  # r, model.md 5
    assert v["flow_force"] == pytest.approx(-0.43 * 12.1e-3 * 21e6 * v["spool_position"], rel=1e-9)  # Eq. 34
    assert np.array_equal(v["current"], np.where(result.time < 1e-3, 0.0, 5e-3))
    assert np.array_equal(v["oil_temperature"], np.full(len(result.time), 100.0))


def test_an_unknown_channel_is_refused_with_the_nearest(result):
    for ask in (lambda: result["spol_position"], lambda: result.select(["current", "spol_position"])):
        with pytest.raises(InputError, match="unknown channel 'spol_position'; did you mean 'spool_position'"):
            ask()


def test_a_selection_keeps_the_named_channels_alone(result):
    assert set(result.select(["spool_position", "current"]).names) == {"spool_position", "current"}
    assert result.select([]).names == result.names


def test_a_csv_file_gives_the_result_back_in_the_units_of_its_header(result, tmp_path):
    with open(result.to_csv(tmp_path / "result.csv"), newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    table = np.array(rows, dtype=float)
    assert header[0] == "time [s]" and table.shape == (len(result.time), 1 + len(UNITS))
    assert table[:, 0] == pytest.approx(result.time, rel=1e-8)
    factors = {"mm": 1e-3, "bar": 1e5, "mA": 1e-3, "L/min": 1.0 / 6e4, "mrad": 1e-3, "mm/s": 1e-3}
    for column, heading in enumerate(header[1:], start=1):
        name, unit = heading.removesuffix("]").split(" [")
        assert table[:, column] * factors.get(unit, 1.0) == pytest.approx(result.values[name], rel=1e-8, abs=1e-300)
    assert "spool_position [mm]" in header and "nozzle_pressure_1 [bar]" in header


def test_a_csv_file_can_be_a_command(result, tmp_path):
    result.to_csv(tmp_path / "result.csv")
    text = 'duration = "20 ms"\n[command.current]\ntable = { file = "result.csv" }\n'
    (tmp_path / "again.toml").write_text(text)
    table = vs.load_scenario(tmp_path / "again.toml").command
    assert np.array(table.values) == pytest.approx(result.values["current"], rel=1e-9)


def test_a_netcdf_file_gives_the_result_back(result, tmp_path):
    import xarray

    with xarray.open_dataset(result.to_netcdf(tmp_path / "result.nc")) as back:
        assert set(back.data_vars) == set(UNITS) and back.attrs["title"] == "A step"
        assert np.array_equal(back["time"], result.time) and back["time"].attrs["units"] == "s"
        for name, unit in UNITS.items():
            assert np.array_equal(back[name], result.values[name]) and back[name].attrs["units"] == unit
        assert back.identical(result.dataset)


def test_a_netcdf_file_is_netcdf_4(result, tmp_path):
    from netCDF4 import Dataset

    with Dataset(result.select(["spool_position"]).to_netcdf(tmp_path / "result.nc")) as file:
        assert file.data_model == "NETCDF4" and set(file.variables) == {"time", "spool_position"}
        assert np.array_equal(file["spool_position"][:], result.values["spool_position"])


@pytest.mark.parametrize("write", ["to_csv", "to_netcdf"])
def test_a_result_that_cannot_be_written_is_refused_and_leaves_nothing(result, tmp_path, write):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match="cannot be written"):
        getattr(result, write)(tmp_path / "file" / "below")
    assert [path.name for path in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "kept"


def test_progress_is_told_from_first_to_all():
    told = []
    vs.simulate(vs.Scenario(duration=20.0, output_rate=10.0, thermal=ISOTHERMAL), progress=told.append)
    assert told == sorted(told) and told[-1] == 1.0 and len(told) > 10


# --- what goes wrong -------------------------------------------------------------------------------------------------


def test_a_run_that_fails_says_when_in_which_state_and_what_to_try(monkeypatch):
    monkeypatch.setattr(MODULE, "MAX_STEPS", 3)
    with pytest.raises(SolveError) as caught:
        run(vs.Sine(amplitude=5e-3, frequency=200.0), 0.5)
    told = re.fullmatch(
        r"the integration failed at t = (.*?) s in (\w+) \(.*?\): more than .* steps were needed\. (.*)",
        str(caught.value),
    )
    assert 0.0 <= float(told[1]) < 0.5 and told[2] in NAMES
    assert told[3].startswith("Try a larger valve.transition_pressure or effect width, a smaller command")


def test_a_batch_that_fails_names_the_member(monkeypatch):
    monkeypatch.setattr(MODULE, "MAX_STEPS", 3)
    valve = dataclasses.replace(VALVE, null_gap=np.array([30e-6, 40e-6]))
    command = vs.Sine(amplitude=5e-3, frequency=200.0)
    with pytest.raises(SolveError, match=r"the integration of member 0 failed at t = \S+ s in"):
        vs.simulate_batch(vs.Scenario(duration=0.5, valve=valve, command=command, thermal=ISOTHERMAL), workers=1)


def test_beyond_the_rated_current_a_run_warns_and_the_spool_meets_its_stop():
    with pytest.warns(ValidityWarning, match=r"up to 12 mA \(t = 0.001 s\) is beyond the rated current of 10 mA"):
        result = run(vs.Step(after=12e-3, time=1e-3), 0.3)
    assert VALVE.spool_stroke < result.values["spool_position"][-1] < 1.01 * VALVE.spool_stroke


@pytest.mark.filterwarnings("error")
def test_at_the_rated_current_and_within_the_oils_range_nothing_is_warned():
    result = run(vs.Step(after=10e-3, time=1e-3), 0.3, 120.0)
    assert result.values["spool_position"][-1] < VALVE.spool_stroke


def test_beyond_the_oils_rated_range_a_run_warns():
    with pytest.warns(ValidityWarning, match="oil mil_prf_5606: up to 270 °C is above its rated 135 °C"):
        run(STEP, 0.01, 270.0)
