"""Each law alone: sign, zero, scale, closed form and smoothness. Source of the equations: model.md sections 2 and 3."""

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.valve.laws import (
    MU_0,
    bridge_flux,
    contact_force,
    dahl_rate,
    lag_of_step,
    lagged,
    land_opening,
    linear_recursion,
    magnetic_torque,
    orifice_flow,
    play,
    signed_root,
    slot_leakage,
)

signs = st.sampled_from([-1.0, 1.0])


def slope(f, x, step):
    return (f(x + step) - f(x - step)) / (2 * step)


# ---------------------------------------------------------------- roots and orifices


@given(st.floats(1e-3, 1e8), st.floats(1e-3, 1e4))
def test_signed_root_is_odd_and_zero_at_zero(x, width):
    assert signed_root(-x, width) == -signed_root(x, width) < 0.0
    assert signed_root(0.0, width) == 0.0


@pytest.mark.parametrize("ratio", [10.0, 30.0, 100.0, 1e3])
def test_signed_root_error_falls_as_quarter_of_the_squared_width_ratio(ratio):
    error = 1.0 - signed_root(ratio, 1.0) / np.sqrt(ratio)
    assert error == pytest.approx(ratio**-2 / 4, rel=2 * ratio**-2, abs=1e-15)  # docstring; next term is -5/32 (w/x)^4


def test_signed_root_is_straight_at_zero_with_slope_of_the_width():
    # x/sqrt(w) near zero, from the series of its formula
    assert slope(lambda x: signed_root(x, 4.0), 0.0, 1e-4) == pytest.approx(0.5, rel=1e-8)


@given(st.floats(1.0, 1e8), st.floats(1e-4, 1e4))
def test_signed_root_never_exceeds_the_root(x, width):
    assert 0.0 < signed_root(x, width) <= np.sqrt(x) * (1 + 1e-15)


def test_orifice_flow_is_area_times_bernoulli_velocity():
    # Bernoulli: 1 MPa at 800 kg/m^3 is a jet of 50 m/s
    assert orifice_flow(1e-6, 1e6, 800.0, 1e-3) == pytest.approx(50e-6, rel=1e-12)


def test_flow_scales_with_sqrt_of_pressure_drop():
    ratio = orifice_flow(1e-6, 4e6, 850.0, 1.0) / orifice_flow(1e-6, 1e6, 850.0, 1.0)
    assert ratio == pytest.approx(2.0, rel=1e-12)


def test_flow_scales_with_area_and_inverse_sqrt_of_density():
    flow = orifice_flow(1e-6, 1e6, 850.0, 1e3)
    assert orifice_flow(3e-6, 1e6, 850.0, 1e3) == pytest.approx(3 * flow, rel=1e-14)
    assert orifice_flow(1e-6, 1e6, 4 * 850.0, 1e3) == pytest.approx(flow / 2, rel=1e-14)


@given(st.floats(1.0, 2e7))
def test_flow_follows_the_sign_of_the_pressure_drop(drop):
    assert orifice_flow(1e-6, -drop, 850.0, 1e3) == -orifice_flow(1e-6, drop, 850.0, 1e3) < 0.0


def test_orifice_is_laminar_below_its_transition_pressure():
    flow = [orifice_flow(1e-6, drop, 850.0, 1e3) for drop in (10.0, 20.0)]
    assert flow[1] / flow[0] == pytest.approx(2.0, rel=1e-3)


def test_slot_leakage_is_the_integral_of_the_parabolic_velocity_profile():
    width, clearance, length, viscosity, drop = 14.5e-3, 3e-6, 1e-3, 0.0117, 21e6
    y = (np.arange(4000) + 0.5) * clearance / 4000
    velocity = drop / (2 * viscosity * length) * y * (clearance - y)  # plane Poiseuille flow
    flow = width * np.sum(velocity) * clearance / 4000
    assert slot_leakage(width, clearance, length, viscosity, drop) == pytest.approx(flow, rel=1e-6)


def test_slot_leakage_scales_with_the_cube_of_the_clearance_and_inverse_viscosity():
    leakage = slot_leakage(14.5e-3, 3e-6, 1e-3, 0.01, 1e7)
    assert slot_leakage(14.5e-3, 6e-6, 1e-3, 0.01, 1e7) == pytest.approx(8 * leakage, rel=1e-14)
    assert slot_leakage(14.5e-3, 3e-6, 2e-3, 0.01, 1e7) == pytest.approx(leakage / 2, rel=1e-14)
    assert slot_leakage(14.5e-3, 3e-6, 1e-3, 0.02, -1e7) == pytest.approx(-leakage / 2, rel=1e-14)


# ---------------------------------------------------------------- spool land


def test_land_opens_one_to_one_beyond_its_null_opening():
    assert land_opening(0.0, 3e-6) == pytest.approx(3e-6, rel=1e-14)
    assert land_opening(4e-4, 3e-6) == pytest.approx(4.03e-4, rel=1e-14)


def test_closed_land_leaks_as_the_inverse_of_its_overlap():
    assert land_opening(-3e-6, 3e-6) == pytest.approx(1.5e-6, rel=1e-14)
    assert land_opening(-3e-3, 3e-6) / land_opening(-6e-3, 3e-6) == pytest.approx(2.0, rel=2e-3)


def test_land_opening_has_equal_value_and_slope_on_both_sides_of_zero():
    null, step = 3e-6, 1e-11
    left = (land_opening(0.0, null) - land_opening(-step, null)) / step
    right = (land_opening(step, null) - land_opening(0.0, null)) / step
    assert left == pytest.approx(1.0, abs=2 * step / null)
    assert right == pytest.approx(1.0, abs=1e-6)


@given(st.floats(-5e-4, 5e-4), st.floats(1e-7, 2e-4))
def test_land_opening_is_positive_and_rises(opening, rise):
    low, high = land_opening(opening, 3e-6), land_opening(opening + rise, 3e-6)
    assert 0.0 < low < high


# ---------------------------------------------------------------- magnetic circuit


def nine_equations(R, M0, N, R0, gamma):
    """phi1..phi4 from the nine linear equations of model.md section 2, with numpy's solver."""
    R1, R2, R3, R4 = R
    g = gamma
    matrix = np.array(
        [  # phi1 phi2 phi3 phi4 phi5 phi6 phi7 phi8 phi_a
            [1, 0, 0, 0, 1, 0, -g, 0, 0],
            [0, 1, 0, 0, -1, 0, 0, -g, 0],
            [0, 0, 1, 0, 0, -1, 0, -g, 0],
            [1, 0, 0, -1, 0, 0, 0, 0, -1],
            [0, -1, 1, 0, 0, 0, 0, 0, -1],
            [R1, 0, 0, R4, 0, 0, R0, 0, 0],
            [0, R2, R3, 0, 0, 0, 0, R0, 0],
            [R1, -R2, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, R3, -R4, 0, 0, 0, 0, 0],
        ],
        dtype=float,
    )
    return np.linalg.solve(matrix, np.array([0, 0, 0, 0, 0, M0, M0, N, N], dtype=float))[:4]


gap = st.floats(5e-5, 5e-4)


@given(gap, gap, gap, gap, st.floats(500, 5000), st.floats(-100, 100), st.floats(1e7, 1e9), st.floats(0.05, 1.0))
def test_bridge_flux_and_torque_solve_the_nine_equations_for_any_four_gaps(g1, g2, g3, g4, M0, N, R0, gamma):
    area, arm = 1e-5, 14.5e-3
    R = np.array([g1, g2, g3, g4]) / (MU_0 * area)
    phi1, phi2, phi3, phi4 = nine_equations(R, M0, N, R0, gamma)
    flux = bridge_flux(M0, N, *R, R0, gamma)
    assert flux == pytest.approx(phi1 + phi2, rel=1e-9)
    assert flux == pytest.approx(phi3 + phi4, rel=1e-9)
    # each of the four gap forces, so that the differences between them may cancel
    forces = arm / (2 * MU_0 * area) * np.array([phi1, phi2, phi3, phi4]) ** 2
    torque = magnetic_torque(flux, N, *R, arm, area)
    assert torque == pytest.approx(forces @ [1, -1, 1, -1], abs=1e-9 * forces.sum())


@pytest.mark.parametrize("temperature", [-40.0, 20.0, 270.0])
@given(theta=st.floats(-3.9e-3, 3.9e-3), current=st.floats(-0.02, 0.02))
def test_torque_of_equal_ends_matches_the_oracle(temperature, theta, current):
    c = oracle.coefficients(*[temperature] * 5)
    mu_A, N = MU_0 * c["A_g"], c["N_c"] * current
    upper, lower, move = c["l_g1"], c["l_g2"], c["a"] * theta
    R = [gap / mu_A for gap in (upper - move, upper + move, lower - move, lower + move)]
    flux = bridge_flux(c["M_0"], N, *R, c["R_0"], c["gamma"])
    torque = magnetic_torque(flux, N, *R, c["a"], c["A_g"])
    # 0.03 N m: the torque of rated current (2.82 N m/A, model.md section 5)
    assert torque == pytest.approx(oracle.torque(theta, current, c), rel=1e-9, abs=1e-9 * 0.03)
    assert torque == pytest.approx(oracle.torque_closed_form(theta, current, c), rel=1e-9, abs=1e-9 * 0.03)


def test_torque_vanishes_at_centre_without_current():
    R = (1e7,) * 4
    assert magnetic_torque(bridge_flux(2980.0, 0.0, *R, 1.76e8, 0.3), 0.0, *R, 14.5e-3, 1e-5) == 0.0


def test_flux_scales_with_the_polarization_at_zero_current():
    R = (0.9e7, 1.1e7, 0.9e7, 1.1e7)
    single, double = (bridge_flux(mmf, 0.0, *R, 1.76e8, 0.3) for mmf in (2980.0, 5960.0))
    assert double == pytest.approx(2 * single, rel=1e-14)
    assert single > 0.0


# ---------------------------------------------------------------- contact, play, friction


@given(st.floats(-1e-4, 1e-4), st.floats(-1.0, 1.0))
def test_contact_force_is_zero_between_the_stops(position, velocity):
    assert contact_force(position, velocity, -1e-4, 1e-4, 1e7, 1.0) == 0.0


@given(st.floats(1e-9, 1e-5), signs)
def test_stop_pushes_back_with_its_stiffness(depth, side):
    force = contact_force(side * (1e-4 + depth), 0.0, -1e-4, 1e-4, 1e7, 1.0)
    assert force == pytest.approx(-side * 1e7 * depth, rel=1e-6)


@given(st.floats(0.0, 0.9), signs, signs)
def test_stop_damping_opposes_the_velocity_by_its_share_of_the_spring_force(speed, side, direction):
    at = side * 1.1e-4
    still, moving = (contact_force(at, v, -1e-4, 1e-4, 1e7, 0.5) for v in (0.0, direction * speed))
    assert moving - still == pytest.approx(-direction * 0.5 * speed * abs(still), abs=1e-9 * abs(still))


@given(st.floats(-1.0, 1.0), signs)
def test_contact_force_is_continuous_where_a_stop_begins(velocity, side):
    inside, outside = (contact_force(side * (1e-4 + d), velocity, -1e-4, 1e-4, 1e7, 1.0) for d in (-1e-12, 1e-12))
    assert inside == 0.0
    assert abs(outside) < 2.1e-5  # 2 k d: no step of force, whatever the velocity


def test_unequal_stops_begin_where_they_are():
    assert contact_force(0.5e-4, 0.0, -2e-4, 0.4e-4, 1e7, 0.0) == pytest.approx(-100.0, rel=1e-9)
    assert contact_force(-2.1e-4, 0.0, -2e-4, 0.4e-4, 1e7, 0.0) == pytest.approx(100.0, rel=1e-9)


@given(st.floats(-1.0, 1.0))
def test_play_passes_nothing_within_its_half_width(share):
    assert play(share * 2e-5, 2e-5) == 0.0


@given(st.floats(1e-8, 1e-3), signs)
def test_play_passes_the_rest_beyond_its_half_width(beyond, side):
    assert play(side * (2e-5 + beyond), 2e-5) == pytest.approx(side * beyond, rel=1e-9)


def test_play_of_no_width_passes_everything():
    assert play(np.array([-1.0, 0.0, 2.0]), 0.0).tolist() == [-1.0, 0.0, 2.0]


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(1e-3, 1e3))
def test_dahl_loop_is_rate_independent(rate, memory, faster):
    loop, faster_loop = dahl_rate(rate, memory, 1e-6), dahl_rate(faster * rate, memory, 1e-6)
    assert faster_loop == pytest.approx(faster * loop, abs=1e-12 * faster * abs(rate) / 1e-6 + 1e-300)


def walk(memory, path, width, steps=4000):
    """Memory after a straight path, by the classical Runge-Kutta method."""
    rate, h = path, 1.0 / steps
    for _ in range(steps):
        k1 = dahl_rate(rate, memory, width)
        k2 = dahl_rate(rate, memory + h / 2 * k1, width)
        k3 = dahl_rate(rate, memory + h / 2 * k2, width)
        k4 = dahl_rate(rate, memory + h * k3, width)
        memory += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return memory


@pytest.mark.parametrize("start", [-1.0, 0.0, 0.5])
@pytest.mark.parametrize("widths", [0.5, 3.0, 20.0])
def test_dahl_memory_follows_its_closed_form_and_saturates_at_one(start, widths):
    end = walk(start, widths * 2e-6, 2e-6)
    assert end == pytest.approx(1 - (1 - start) * np.exp(-widths), abs=1e-9)  # z' = 1 - z per width of path
    assert walk(-start, -widths * 2e-6, 2e-6) == pytest.approx(-end, abs=1e-12)


def test_dahl_memory_holds_at_saturation_and_at_rest():
    assert dahl_rate(0.3, 1.0, 1e-6) == 0.0
    assert dahl_rate(-0.3, -1.0, 1e-6) == 0.0
    assert dahl_rate(0.0, 0.4, 1e-6) == 0.0


def test_dahl_loop_closes_over_a_cycle_and_encloses_an_area():
    up = walk(-1.0, 20e-6, 2e-6)
    down = walk(up, -20e-6, 2e-6)
    assert (up, down) == (pytest.approx(1.0, abs=1e-4), pytest.approx(-1.0, abs=1e-4))  # 2 e^-10
    middle = [walk(-1.0, 10e-6, 2e-6), walk(1.0, -10e-6, 2e-6)]
    assert middle[0] > 0.9 and middle[1] < -0.9


# ---------------------------------------------------------------- lag over time


def test_lag_of_a_jump_is_an_exponential_from_the_value_before_it():
    times, values = np.array([0.0, 1.0, 1.0, 1.5, 4.0]), np.array([2.0, 2.0, 5.0, 5.0, 5.0])
    expected = [2.0, 2.0, 2.0, 5.0 - 3.0 * np.exp(-0.5 / 0.7), 5.0 - 3.0 * np.exp(-3.0 / 0.7)]
    assert lagged(times, values, 0.7) == pytest.approx(expected, rel=1e-14)


@given(st.floats(1e-6, 1e6))
def test_lag_of_a_ramp_trails_it_by_the_time_constant(tau):
    times = np.array([0.0, 0.1, 1.0, 3.0, 10.0])
    trail = 3.0 * times - lagged(times, 3.0 * times, tau)
    assert trail == pytest.approx(-3.0 * tau * np.expm1(-times / tau), rel=1e-6, abs=1e-12)


@given(st.floats(1e-4, 1e2), st.integers(0, 1000))
def test_lag_is_the_same_over_one_line_and_over_its_pieces(tau, seed):
    rng = np.random.default_rng(seed)
    times, values = np.cumsum(rng.uniform(0.01, 1.0, 8)), rng.normal(size=8)
    fine = np.sort(np.append(times, rng.uniform(times[0], times[-1], 20)))
    whole = lagged(fine, np.interp(fine, times, values), tau)
    assert np.interp(times, fine, whole) == pytest.approx(lagged(times, values, tau), abs=1e-12)


@pytest.mark.parametrize("share", [1e-6, 0.1, 1.0, 50.0])
def test_lag_of_a_step_of_time_leaves_its_distance_by_the_exponential(share):
    """Of an input that rises straight from 0 to 1 within the step, from rest: 1 - tau/h (1 - e^(-h/tau))."""
    left, ramp = lag_of_step(2.0, 2.0 * share)
    assert left == pytest.approx(np.exp(-share)) and ramp == pytest.approx((1.0 - np.exp(-share)) / share, rel=1e-6)
    risen = lagged(np.array([0.0, 2.0 * share]), np.array([0.0, 1.0]), 2.0)[1]
    assert 1.0 - ramp == pytest.approx(risen, abs=1e-9)
    assert lag_of_step(0.0, 1.0) == (0.0, 0.0)


@given(st.integers(0, 40), st.integers(1, 3), st.integers(0, 1000))
def test_a_recursion_joined_by_two_is_the_plain_loop(steps, columns, seed):
    rng = np.random.default_rng(seed)
    factors, added = rng.uniform(-1.2, 1.2, (steps, columns)), rng.normal(size=(steps, columns))
    y, expected = rng.normal(size=columns), []
    found = linear_recursion(factors, added, y)
    for factor, more in zip(factors, added, strict=True):
        y = factor * y + more
        expected.append(y)
    assert found == pytest.approx(np.reshape(expected, (steps, columns)), rel=1e-9, abs=1e-9)


def test_lag_of_columns_is_that_of_each():
    rng = np.random.default_rng(5)
    times, values = np.cumsum(rng.uniform(0.0, 1.0, 30)), rng.normal(size=(30, 3))
    assert lagged(times, values, 0.7) == pytest.approx(np.column_stack([lagged(times, v, 0.7) for v in values.T]))


def test_lag_without_a_time_constant_is_the_values_themselves():
    values = np.array([1.0, 4.0, 9.0])
    assert lagged(np.array([0.0, 0.0, 1.0]), values, 0.0) is values


def test_lag_of_a_single_value_is_that_value():
    assert lagged(np.array([0.0]), np.array([3.0]), 2.0).tolist() == [3.0]
