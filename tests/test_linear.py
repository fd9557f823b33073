"""The linear valve against finite differences, the static solution, a sine, and the nonlinear block against a run."""

import dataclasses
import importlib.util
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import valvesim as vs
from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, Inputs
from valvesim.characterisation import control_block, gain_schedule, reduced_order
from valvesim.characterisation import linearisation as linear
from valvesim.errors import InputError
from valvesim.valve.equations import Model, VoltageDrive
from valvesim.valve.equilibrium import solve_rest

VALVE = vs.reference_valve()
ISOTHERMAL = vs.Thermal(network=None)
TEMPERATURES = (20.0, 270.0)


@cache
def point(current=1e-3, temperature=20.0, load_pressure=0.0):
    return linear.operating_point(VALVE, current=current, temperature=temperature, load_pressure=load_pressure)


@cache
def system(current=1e-3, temperature=20.0, load_pressure=0.0):
    return linear.linearise(point(current, temperature, load_pressure))


# --- rest ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("temperature", TEMPERATURES)
def test_an_operating_point_is_a_rest_of_the_dynamic_model(temperature):
    at = point(2e-3, temperature, 5e6)
    rates = np.array(at.model.rhs(tuple(at.state), at.inputs, tuple(at.coefficients)))
    scale = np.array([channel.scale for channel in at.model.state_channels])
    slowest = 1e3  # 1/s
    assert np.max(np.abs(rates / scale)) < 1e-4 * slowest
    assert at.temperature == temperature and at.inputs.load_pressure == 5e6


def test_an_operating_point_is_the_static_solution_at_its_pressures():
    valve = dataclasses.replace(VALVE, load_pressure=4e6, supply_pressure=15e6)
    rest = vs.static_solution(valve, current=3e-3, temperature=90.0)
    at = linear.operating_point(VALVE, current=3e-3, temperature=90.0, load_pressure=4e6, supply_pressure=15e6)
    assert at.spool_position == pytest.approx(float(rest.spool_position), rel=1e-10)
    assert at.state[0] == pytest.approx(float(rest.armature_angle), rel=1e-10)


def test_parts_at_their_own_temperatures_move_the_rest():
    parts = dataclasses.replace(vs.PartTemperatures.uniform(20.0), torque_motor=200.0, oil=150.0)
    rest = vs.static_solution(VALVE, current=1e-3, parts=parts)
    at = linear.operating_point(VALVE, current=1e-3, parts=parts)
    assert at.spool_position == pytest.approx(float(rest.spool_position), rel=1e-10)
    assert at.temperature == 150.0 and abs(at.spool_position / point().spool_position - 1.0) > 1e-3


@pytest.mark.parametrize(
    "figures, message",
    [
        ({"current": np.array([1e-3, 2e-3])}, "current = .* must be one finite number"),
        ({"current": np.nan}, "current = nan must be one finite number"),
        ({"current": 1e-3, "temperature": np.inf}, "temperature = inf must be one finite number"),
        ({"current": 11e-3}, "at 11 mA the spool would rest at 0.4.* mm.* within .-0.42, 0.42. mm"),
        ({"current": 1e-3, "load_pressure": 3e7}, "load_pressure must be within the supply pressure"),
        ({"current": 1e-3, "supply_pressure": 0.1e6}, "return_pressure must be below"),
        ({"current": 1e-3, "parts": vs.PartTemperatures.uniform(np.array([20.0, 30.0]))}, "hold an array"),
    ],
)
def test_an_operating_point_that_makes_no_sense_is_refused(figures, message):
    with pytest.raises(InputError, match=message):
        linear.operating_point(VALVE, **figures)


def test_a_batch_of_valves_is_refused():
    with pytest.raises(InputError, match="hold an array"):
        linear.operating_point(dataclasses.replace(VALVE, null_gap=np.array([3e-5, 4e-5])), current=1e-3)


# --- exact derivatives -----------------------------------------------------------------------------------------------


def central(function, at, scale):
    """Central differences (n_out, n_in) of a function of a vector; steps of 1e-5 of the scale."""
    at = np.asarray(at, dtype=float)
    columns = []
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = 1e-5 * scale[k]
        columns.append((np.array(function(at + step)) - np.array(function(at - step))) / (2.0 * step[k]))
    return np.array(columns).T


def close(exact, found, rows, columns, tolerance=1e-6):
    """Equal in units of each row's largest scaled entry."""
    exact, found = exact * columns / rows[:, None], found * columns / rows[:, None]
    size = np.max(np.abs(exact), axis=1, keepdims=True) + 1e-300
    return float(np.max(np.abs(exact - found) / size)) < tolerance


@pytest.mark.parametrize("current, load_pressure", [(1e-3, 0.0), (3e-3, 6e6), (-2e-3, 6e6)])
@pytest.mark.parametrize("kind", ["rates", "signals"])
def test_exact_derivatives_equal_central_differences(kind, current, load_pressure):
    at = point(current, 60.0, load_pressure)
    model, x, u, c = at.model, at.state, np.array(at.inputs), at.coefficients
    if kind == "rates":
        function, exact = model.rhs, vs.derivatives(model)(x, u, c)
        rows = np.array([channel.scale for channel in model.state_channels])
    else:
        function, exact = model.signals, linear.signal_derivatives(model)(x, u, c)[1:]
        rows = np.array([channel.scale for channel in SIGNAL_CHANNELS])
    by_state, by_inputs, by_coefficients = (np.array(matrix) for matrix in exact)
    x_scale = np.array([channel.scale for channel in model.state_channels])
    u_scale = np.array([channel.scale for channel in INPUT_CHANNELS])
    c_scale = np.where(c != 0.0, np.abs(c), 1e-5)  # zero: the overlap of the lands, m
    assert close(by_state, central(lambda v: function(v, u, c), x, x_scale), rows, x_scale)
    assert close(by_inputs, central(lambda v: function(x, v, c), u, u_scale), rows, u_scale)
    assert close(by_coefficients, central(lambda v: function(x, u, v), c, c_scale), rows, c_scale)


def test_the_signals_beside_their_derivatives_are_those_of_the_model():
    at = point(2e-3, 60.0, 5e6)
    given = np.array(linear.signal_derivatives(at.model)(at.state, np.array(at.inputs), at.coefficients)[0])[:, 0]
    expected = np.array(at.model.signals(tuple(at.state), at.inputs, tuple(at.coefficients)))
    np.testing.assert_allclose(given, expected, rtol=1e-12, atol=1e-300)


def test_at_a_kink_the_derivative_is_the_mean_of_both_sides():
    at = point(0.0, 20.0, 5e6)
    assert at.spool_position == 0.0
    names = [channel.name for channel in SIGNAL_CHANNELS]

    def slope(x):
        state = at.state.copy()
        state[4] = x
        matrices = linear.signal_derivatives(at.model)(state, np.array(at.inputs), at.coefficients)
        return np.array(matrices[1])[:, 4][[names.index(name) for name in ("flow_force", "internal_leakage")]]

    before, here, after = (slope(x) for x in (-1e-12, 0.0, 1e-12))
    assert abs(after[0] - before[0]) > 0.1 * abs(here[0])  # |x| under load pressure is a kink
    np.testing.assert_allclose(here[0], (before[0] + after[0]) / 2.0, rtol=1e-6)


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("current", [1e-3, -4e-3])
def test_the_gain_at_rest_is_the_slope_of_the_static_solution(current, temperature):
    step = 1e-6
    above, below = (vs.static_solution(VALVE, current=current + d, temperature=temperature) for d in (step, -step))
    at_rest = np.asarray(system(current, temperature)(0.0)).real[:, 0]
    for name in ("spool_position", "armature_angle", "pilot_differential_pressure", "nozzle_pressure_1"):
        slope = float(getattr(above, name) - getattr(below, name)) / (2.0 * step)
        assert at_rest[linear.LINEARISED_OUTPUTS.index(name)] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("source", ["supply_pressure", "return_pressure", "load_pressure"])
def test_the_gain_over_a_pressure_is_that_of_the_static_solution(source):
    # at the coefficients of one density, which the linear system holds
    at, names = point(2e-3, 60.0, 3e6), point().model.coefficient_names
    c = type(VALVE.at(vs.PartTemperatures.uniform(60.0)))(*at.coefficients[: len(names)])
    found = []
    for step in (100.0, -100.0):
        u = at.inputs._replace(**{source: getattr(at.inputs, source) + step})
        found.append(solve_rest(c, 2e-3, 60.0, u.supply_pressure, u.return_pressure, u.load_pressure))
    for name in ("spool_position", "nozzle_pressure_1"):
        slope = float(getattr(found[0], name) - getattr(found[1], name)) / 200.0
        gain = complex(system(2e-3, 60.0, 3e6)[name, source](0.0)).real
        assert gain == pytest.approx(slope, rel=1e-4, abs=1e-9 * (abs(gain) + abs(slope)) + 1e-16)


def test_the_system_is_named():
    named = system()
    assert named.input_labels == ["current", "supply_pressure", "return_pressure", "load_pressure"]
    assert named.output_labels == list(linear.LINEARISED_OUTPUTS)
    assert named.state_labels == [channel.name for channel in point().model.state_channels]


def test_the_voltage_drive_adds_its_current_as_a_state():
    model = Model(drive=VoltageDrive())
    at = point()
    u = at.inputs._replace(command=0.6)
    driven = dataclasses.replace(at, model=model, inputs=Inputs(*u), state=np.append(at.state, 1e-3))
    named = linear.linearise(driven)
    assert named.input_labels[0] == "voltage" and named.state_labels[-1] == "drive_current"
    gain = complex(named["spool_position", "voltage"](0.0)).real
    assert gain * 600.0 == pytest.approx(complex(system()["spool_position", "current"](0.0)).real, rel=1e-9)


@pytest.mark.parametrize("use", [linear.linearise, control_block.nonlinear_system])
def test_an_effect_that_feels_the_rate_of_the_current_is_refused(use):
    effect = vs.effect("magnetic_hysteresis")
    active = effect(**{effect.amplitude.name: 1e-4})
    model = Model(effects=(effect,))
    if use is linear.linearise:
        given = dataclasses.replace(point(), model=model)
    else:
        given = vs.Scenario(effects=(active,), thermal=ISOTHERMAL)
    with pytest.raises(InputError, match=r"an effect \(magnetic_hysteresis\) depends on the rate of the current"):
        use(given)


# --- modes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "damping, bulk_modulus, density, expected, tolerance",
    [  # model.md section 5 prints the first row, which belongs to the ratio 0.4 exactly; the second to its printed B_a
        (
            2 * 0.4 * np.sqrt(1.78e-7 * 12.0), 1.80e9, 858.7,
            [-1056, -2806 - 3370j, -2806 + 3370j, -5931, -3041 - 50600j, -3041 + 50600j], 1e-3,
        ),
        (
            1.24e-3, 1.63e9, 859.0,
            [-1085, -2990 - 3124j, -2990 + 3124j, -5375, -2763 - 48184j, -2763 + 48184j], 5e-4,
        ),
    ],
)  # fmt: skip
def test_the_modes_are_those_of_the_reference(damping, bulk_modulus, density, expected, tolerance):
    oil = dataclasses.replace(
        vs.MIL_PRF_5606, bulk_modulus_at_20=bulk_modulus, bulk_modulus_slope=0.0,
        density_at_20=density * np.exp(-10.75e6 / bulk_modulus),
    )  # fmt: skip
    at = linear.operating_point(dataclasses.replace(VALVE, armature_damping=damping), current=2e-3, oil=oil)
    found = np.array([mode.pole for mode in linear.modes(at)])
    for pole in expected:
        assert np.min(np.abs(found - pole)) < tolerance * abs(pole)


def test_modes_carry_frequency_and_damping_and_are_sorted():
    found = linear.modes(point())
    frequencies = [mode.natural_frequency for mode in found]
    assert len(found) == 6 and frequencies == sorted(frequencies)
    for mode in found:
        w = 2.0 * np.pi * mode.natural_frequency
        assert mode.pole.real == pytest.approx(-mode.damping_ratio * w, rel=1e-12)
    pair = [mode for mode in found if mode.pole.imag]
    assert len(pair) == 4 and pair[0].pole == pair[1].pole.conjugate() and pair[0].pole.imag < 0.0
    poles = np.sort_complex(np.asarray(system().poles()))
    np.testing.assert_allclose(poles, np.sort_complex([mode.pole for mode in found]), rtol=1e-6)


def test_poles_over_temperature_follow_each_pole_without_jumps():
    temperatures = np.arange(20.0, 271.0, 10.0)
    poles = linear.poles_over_temperature(VALVE, temperatures, current=1e-3)
    assert poles.shape == (26, 6) and np.all(poles.real < 0.0)
    assert np.max(np.abs(np.diff(poles, axis=0)) / np.abs(poles[:-1])) < 0.1
    last = linear.modes(point(1e-3, 270.0))
    np.testing.assert_allclose(np.sort_complex(poles[-1]), np.sort_complex([m.pole for m in last]), rtol=1e-9)
    assert abs(poles[-1, 3]) < 0.5 * abs(poles[0, 3])  # the chamber's real pole slows with the falling bulk modulus


# --- frequency response ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("frequency", [20.0, 100.0, 300.0])
def test_the_linear_response_is_that_of_a_small_sine(frequency, temperature):
    cycles, samples = max(2, int(0.02 * frequency)), 100
    scenario = vs.Scenario(
        duration=0.05 + cycles / frequency, thermal=ISOTHERMAL, oil_temperature=vs.Constant(value=temperature),
        command=vs.Sine(amplitude=5e-5, frequency=frequency, offset=1e-3), output_rate=frequency * samples,
        tolerance=1e-6,
    )  # fmt: skip
    result = vs.simulate(scenario)
    late = slice(-cycles * samples, None)
    turn = np.exp(-2j * np.pi * frequency * result.time[late])
    for name in ("spool_position", "armature_angle", "load_flow", "pilot_differential_pressure", "internal_leakage"):
        y = result.values[name][late]
        ratio = 2j * np.mean((y - y.mean()) * turn) / 5e-5
        ratio /= complex(system(1e-3, temperature)[name, "current"](2j * np.pi * frequency))
        assert abs(20.0 * np.log10(abs(ratio))) < 0.05 and abs(np.degrees(np.angle(ratio))) < 0.1


def test_bandwidth_of_known_systems():
    import control

    first = reduced_order.bandwidth(control.tf([3.0], [1.0 / 100.0, 1.0]))
    assert first.gain_frequency == pytest.approx(100.0 * np.sqrt(10.0**0.3 - 1.0) / (2.0 * np.pi), rel=1e-9)
    assert np.isnan(first.phase_frequency)
    second = reduced_order.bandwidth(control.tf([-2.0], [1.0 / 500.0**2, 2.0 * 0.7 / 500.0, 1.0]))
    assert second.phase_frequency == pytest.approx(500.0 / (2.0 * np.pi), rel=1e-9)


def test_the_hot_valve_is_faster():
    # golden: what this model gives, not a measurement
    for temperature, gain_frequency, phase_frequency in ((20.0, 170.8, 267.7), (270.0, 215.2, 273.0)):
        found = reduced_order.bandwidth(system(1e-3, temperature))
        assert found.gain_frequency == pytest.approx(gain_frequency, abs=0.5)
        assert found.phase_frequency == pytest.approx(phase_frequency, abs=0.5)


def test_bandwidth_refuses_what_has_none():
    import control

    with pytest.raises(InputError, match="unknown signal 'spool_positon'; did you mean 'spool_position'"):
        reduced_order.bandwidth(system(), output="spool_positon")
    with pytest.raises(InputError, match="unknown signal 'curent'"):
        reduced_order.bandwidth(system(), source="curent")
    with pytest.raises(InputError, match="not stable"):
        reduced_order.bandwidth(control.tf([1.0], [1.0, 0.0]))
    with pytest.raises(InputError, match="does not follow current at rest"):
        reduced_order.bandwidth(control.tf([1.0, 0.0], [1.0, 1.0]))


@pytest.mark.parametrize("order, true_pole", [(2, None), (3, 400.0)])
def test_a_reduced_form_finds_its_own_parameters(order, true_pole):
    import control

    denominator = [1.0 / 900.0**2, 2.0 * 0.45 / 900.0, 1.0]
    if true_pole is not None:
        denominator = np.polymul(denominator, [1.0 / true_pole, 1.0])
    found = reduced_order.reduced(control.tf([0.04], denominator), order)
    assert found.gain == pytest.approx(0.04, rel=1e-12)
    assert found.angular_frequency == pytest.approx(900.0, rel=1e-6)
    assert found.damping_ratio == pytest.approx(0.45, rel=1e-6)
    assert found.real_pole is None if true_pole is None else found.real_pole == pytest.approx(true_pole, rel=1e-6)
    assert found.gain_error < 1e-5 and found.phase_error < 1e-4
    assert found.natural_frequency == pytest.approx(900.0 / (2.0 * np.pi), rel=1e-6)


@pytest.mark.parametrize("temperature", TEMPERATURES)
@pytest.mark.parametrize("order, decibels, degrees", [(2, 2.5, 17.0), (3, 0.1, 0.6)])
def test_a_reduced_valve_is_within_its_stated_error(order, decibels, degrees, temperature):
    full = system(1e-3, temperature)
    found = reduced_order.reduced(full, order)
    assert found.gain_error < decibels and found.phase_error < degrees
    assert found.highest_frequency == pytest.approx(2.0 * reduced_order.bandwidth(full).phase_frequency, rel=1e-9)
    s = 2j * np.pi * np.geomspace(found.lowest_frequency, found.highest_frequency, 57)
    ratio = found.system(s) / full["spool_position", "current"](s)
    assert np.max(np.abs(20.0 * np.log10(np.abs(ratio)))) <= found.gain_error * 1.001
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) <= found.phase_error * 1.001


def test_a_lower_band_makes_a_better_second_order_form():
    assert reduced_order.reduced(system(), 2, highest_frequency=100.0).phase_error < 2.0
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="highest_frequency"):
            reduced_order.reduced(system(), 2, highest_frequency=wrong)
    with pytest.raises(InputError, match="order = 4 must be 2 or 3"):
        reduced_order.reduced(system(), 4)


# --- schedule --------------------------------------------------------------------------------------------------------


def test_the_gain_schedule_is_that_of_the_static_solution():
    rows = gain_schedule.gain_schedule(VALVE, TEMPERATURES, current=2e-3)
    assert [row.temperature for row in rows] == list(TEMPERATURES)
    for row in rows:
        step = 1e-6
        above, below = (vs.static_solution(VALVE, current=2e-3 + d, temperature=row.temperature) for d in (step, -step))
        slope = float(above.spool_position - below.spool_position) / (2.0 * step)
        assert row.spool_gain == pytest.approx(slope, rel=1e-6)
        density = point(2e-3, row.temperature).coefficients[point().model.coefficient_names.index("density")]
        port = 0.61 * 12.1e-3 * np.sqrt(21e6 / density)  # model.md 3: Q_L = C_d w x sqrt(p_s/rho)
        assert row.flow_gain == pytest.approx(port * slope, rel=5e-3)
        assert row.pressure_gain == pytest.approx(row.flow_gain / row.flow_pressure_coefficient, rel=1e-12)
        assert row.flow_pressure_coefficient > 0.0 and row.pilot_pressure_gain > 0.0
        assert row.gain_frequency == reduced_order.bandwidth(system(2e-3, row.temperature)).gain_frequency
        assert abs(row.dominant_pole) == min(abs(mode.pole) for mode in linear.modes(point(2e-3, row.temperature)))


def test_the_flow_gain_is_doubled_within_the_null_opening():
    null, off = (gain_schedule.gain_schedule(VALVE, [20.0], current=i)[0].flow_gain for i in (0.0, 2e-3))
    assert null == pytest.approx(2.0 * off, rel=5e-3)


# --- block of a loop -------------------------------------------------------------------------------------------------


def respond(block, times, inputs, start):
    import control

    kwargs = {"rtol": 1e-5, "atol": 1e-7}
    return control.input_output_response(
        block, times, inputs, start, solve_ivp_method="Radau", solve_ivp_kwargs=kwargs
    ).outputs  # fmt: skip


@pytest.mark.parametrize("temperature, load_pressure", [(20.0, 0.0), (200.0, 5e6)])
def test_the_nonlinear_system_steps_as_the_simulation(temperature, load_pressure):
    scenario = vs.Scenario(
        duration=0.02, thermal=ISOTHERMAL, oil_temperature=vs.Constant(value=temperature), output_rate=20e3,
        command=vs.Step(before=1e-3, after=3e-3), load_pressure=vs.Constant(value=load_pressure), tolerance=1e-7,
    )  # fmt: skip
    before = dataclasses.replace(scenario, command=vs.Constant(value=1e-3))
    start = control_block.rest_state(before, command=1e-3, load_pressure=load_pressure)
    # a run starts at the rest of its command at time zero: let it step a little later, and cut the wait off
    later = dataclasses.replace(scenario, command=vs.Step(before=1e-3, after=3e-3, time=1e-3))
    result = vs.simulate(later)
    wait = int(round(1e-3 * 20e3))
    times = result.time[wait:] - result.time[wait]
    inputs = np.vstack([np.full(times.shape, 3e-3), np.full(times.shape, load_pressure)])
    found = respond(control_block.nonlinear_system(scenario), times, inputs, start)
    for k, name in enumerate(linear.LINEARISED_OUTPUTS):
        expected = result.values[name][wait:]
        assert np.max(np.abs(found[k] - expected)) < 1e-4 * np.ptp(expected)
    np.testing.assert_allclose(found[-1], temperature)


def test_the_nonlinear_system_follows_the_scenarios_temperature_and_pressure():
    scenario = vs.Scenario(
        duration=1.0, oil_temperature=vs.Ramp(start_value=20.0, end_value=120.0, rate=200.0),
        supply_pressure=vs.Ramp(start_value=21e6, end_value=15e6, rate=6e6), command=vs.Constant(value=2e-3),
        output_rate=100.0, tolerance=1e-6,
    )  # fmt: skip
    result = vs.simulate(scenario)
    times = np.linspace(0.0, 0.1, 11)
    inputs = np.vstack([np.full(times.shape, 2e-3), np.zeros(times.shape)])
    found = respond(
        control_block.nonlinear_system(scenario), times, inputs, control_block.rest_state(scenario, command=2e-3)
    )
    for k, name in enumerate((*linear.LINEARISED_OUTPUTS, "oil_temperature")):
        expected = result.values[name][: len(times)]
        assert np.max(np.abs(found[k] - expected)) < 1e-3 * np.ptp(expected) + 1e-9 * np.max(np.abs(expected))
    beyond = control_block.nonlinear_system(scenario).outfcn(2.0, control_block.rest_state(scenario), np.zeros(2), {})
    assert beyond[-1] == pytest.approx(120.0)  # held after the end
    later = control_block.rest_state(scenario, time=0.5, command=2e-3) * [
        ch.scale for ch in scenario.model.state_channels
    ]
    assert later[4] == pytest.approx(result.values["spool_position"][50], rel=1e-3)


def test_the_nonlinear_system_is_named_and_linearises_to_the_linear_one():
    scenario = vs.Scenario(thermal=ISOTHERMAL)
    block = control_block.nonlinear_system(scenario)
    assert block.name == "valve" and block.input_labels == ["current", "load_pressure"]
    assert block.output_labels == [*linear.LINEARISED_OUTPUTS, "oil_temperature"]
    poles = np.sort_complex(
        np.asarray(block.linearize(control_block.rest_state(scenario, command=1e-3), [1e-3, 0.0]).poles())
    )
    np.testing.assert_allclose(poles, np.sort_complex(np.asarray(system().poles())), rtol=1e-3)


def test_the_nonlinear_system_takes_a_voltage_drive_and_effects():
    # the model that test_compiled compiles too; with a voltage drive the rate of the current is no input
    acting = [e for e in vs.CATALOGUE.values() if e.balance is not None]
    active = tuple(e(**{e.amplitude.name: 0.02 * e.amplitude.bounds[1]}) for e in acting)
    scenario = vs.Scenario(thermal=ISOTHERMAL, drive=VoltageDrive(), effects=active)
    model, block = scenario.model, control_block.nonlinear_system(scenario)
    assert block.input_labels[0] == "voltage"
    scale = np.array([channel.scale for channel in model.state_channels])
    rest = control_block.rest_state(scenario, command=1.0, load_pressure=2e6)
    assert np.max(np.abs(block.updfcn(0.0, rest, np.array([1.0, 2e6]), {}))) < 1e-4  # 1/s
    x = rest * 1.01 + 0.01
    u = Inputs(1.2, 0.0, VALVE.supply_pressure, VALVE.return_pressure, 2e6)
    flat = model.flat_coefficients(VALVE.at(vs.PartTemperatures.uniform(20.0)), active)
    rates = np.array(model.rhs(tuple(x * scale), u, flat)) / scale
    np.testing.assert_allclose(block.updfcn(0.0, x, np.array([1.2, 2e6]), {}), rates, rtol=1e-9, atol=1e-12)
    named = {**model.signals(tuple(x * scale), u, flat)._asdict(), "oil_temperature": 20.0}
    named |= {channel.name: value for channel, value in zip(model.state_channels, x * scale, strict=True)}
    expected = [named[name] for name in block.output_labels]
    np.testing.assert_allclose(block.outfcn(0.0, x, np.array([1.2, 2e6]), {}), expected, rtol=1e-9)


def test_a_nonlinear_system_of_a_batch_is_refused():
    batch = dataclasses.replace(VALVE, null_gap=np.array([3e-5, 4e-5]))
    with pytest.raises(InputError, match="not a batch"):
        control_block.nonlinear_system(vs.Scenario(valve=batch, thermal=ISOTHERMAL))


def test_the_example_closes_a_loop_that_follows():
    import control

    path = Path(__file__).parent.parent / "examples" / "position_loop.py"
    spec = importlib.util.spec_from_file_location("position_loop", path)
    example = importlib.util.module_from_spec(spec)
    sys.modules["position_loop"] = example
    spec.loader.exec_module(example)
    example.WINDOW = 0.2
    controller = example.controller([20.0, 270.0], [0.045, 0.045])
    parts = [control_block.nonlinear_system(example.launch), example.actuator(), controller]
    loop = control.interconnect(parts, inputs=["reference"], outputs=["position", "current"], check_unused=False)
    _, reference, position, current = example.run(loop, 0.0)
    lag = 2.0 * np.pi * example.FREQUENCY * example.AMPLITUDE / example.VELOCITY_GAIN  # of a loop with an integrator
    assert 0.5 * lag < np.max(np.abs(reference - position)) < 1.1 * lag
    assert np.max(np.abs(current)) < example.RATED
