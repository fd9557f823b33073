"""The valve at rest: the figures of model.md section 5, the oracle, and the dynamic model that stands still there."""

import dataclasses
import warnings

import numpy as np
import oracle
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from valvesim.channels import Channel, Inputs
from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.inputs import Constant, Step
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.units import quantities
from valvesim.valve.coefficients import PART_NAMES, ROUTES, PartTemperatures
from valvesim.valve.equations import NOMINAL
from valvesim.valve.equilibrium import (
    _bracketed_root,
    balances_at_rest,
    follow_branch,
    nearest_root,
    nozzle_pressures,
    settle,
    static_solution,
    tad_polynomial,
)
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.parameters import Valve, reference_valve

valve = reference_valve()
sharp = Valve(transition_pressure=1.0)  # the dynamic orifices differ from the ideal ones by 1e-13 at 2 MPa
PRESSURES = (valve.supply_pressure, valve.return_pressure, valve.load_pressure)
CURRENTS = np.array([-10.0, -5.0, -1.0, -0.1, 0.1, 1.0, 5.0, 10.0]) * 1e-3
TEMPERATURES = np.array([-40.0, 0.0, 20.0, 100.0, 270.0])

# model.md section 5: drift of theta and x_v in % at 270 °C and 1 mA, by route
DRIFTS = {
    "flow": (+0.551, -0.047),
    "orifice": (-4.226, +0.376),
    "mmf": (-6.065, -6.065),
    "gap": (-0.855, -0.855),
    "reluctance": (+0.318, +0.318),
    "arm": (+0.284, +0.284),
    "tube": (+1.795, +1.795),
    "rod": (+6.737, +6.936),
}
UNEVEN = {
    "air_gap_difference": 8e-6,
    "null_gap_difference": -3e-6,
    "nozzle_diameter_difference": 6e-6,
    "fixed_orifice_difference": -4e-6,
}


def coefficients(temperature=20.0, of=valve):
    return of.at(PartTemperatures.uniform(temperature))


# ---------------------------------------------------------------- published and independent figures


def test_angle_and_spool_at_1_mA_are_those_of_the_independent_program():
    rest = static_solution(valve, current=1e-3, temperature=20.0)
    # model.md section 5, to half of the last printed digit
    assert rest.armature_angle == pytest.approx(5.0416154e-5, abs=0.5e-12)
    assert rest.spool_position == pytest.approx(3.9378931e-5, abs=0.5e-12)


def drift(routes):
    cold, hot = (static_solution(valve, current=1e-3, temperature=t, routes=routes) for t in (20.0, 270.0))
    return [100 * float(getattr(hot, n) / getattr(cold, n) - 1) for n in ("armature_angle", "spool_position")]


@pytest.mark.parametrize("route", ROUTES)
def test_drift_of_each_route_is_published(route):
    assert drift(route) == pytest.approx(DRIFTS[route], abs=0.0005)  # to half of the last printed digit


def test_drift_of_all_routes_together_is_published():
    assert drift(ROUTES) == pytest.approx((-1.429, +2.296), abs=0.0005)  # model.md section 5


def test_drift_without_routes_is_none():
    assert drift(()) == pytest.approx([0.0, 0.0], abs=1e-10)  # %: the balances are solved to rounding


def test_rated_current_reaches_the_published_spool_position():
    # model.md section 5: rated current reaches 0.40 mm of 0.42
    assert static_solution(valve, current=10e-3).spool_position == pytest.approx(0.40e-3, abs=0.01e-3)


@pytest.mark.parametrize("temperature", TEMPERATURES)
def test_rest_matches_the_oracle(temperature):
    rest = static_solution(sharp, current=CURRENTS, temperature=temperature)  # the oracle's orifices have no width
    c = oracle.coefficients(*[temperature] * 5)
    for k, current in enumerate(CURRENTS):
        theirs = oracle.static(float(current), c)
        assert rest.armature_angle[k] == pytest.approx(theirs["theta"], rel=1e-9)
        assert rest.spool_position[k] == pytest.approx(theirs["x_v"], rel=1e-9)
        assert rest.nozzle_pressure_1[k] == pytest.approx(theirs["p1"], rel=1e-9)
        assert rest.nozzle_pressure_2[k] == pytest.approx(theirs["p2"], rel=1e-9)
        assert rest.pilot_differential_pressure[k] == pytest.approx(theirs["p1"] - theirs["p2"], rel=1e-6)


temperature = st.floats(-40.0, 270.0)


@given(st.floats(-10e-3, 10e-3), temperature, temperature, temperature, temperature, temperature)
def test_rest_of_parts_at_their_own_temperatures_matches_the_oracle(current, T_m, T_s, T_f, T_n, T_o):
    own = dict(torque_motor=T_m, spring_tube=T_s, feedback_rod=T_f, pilot_metal=T_n, oil=T_o)
    parts = PartTemperatures(**{**dict.fromkeys(PART_NAMES, 20.0), **own})
    rest = static_solution(sharp, current=current, parts=parts)
    theirs = oracle.static(current, oracle.coefficients(T_m, T_s, T_f, T_n, T_o))
    assert rest.armature_angle == pytest.approx(theirs["theta"], rel=1e-9, abs=1e-15)
    assert rest.spool_position == pytest.approx(theirs["x_v"], rel=1e-9, abs=1e-15)


# ---------------------------------------------------------------- polynomial and direct solution


def test_polynomial_root_is_the_direct_solution():
    current, T = CURRENTS[:, None], TEMPERATURES
    rest = static_solution(sharp, current=current, temperature=T)
    K = tad_polynomial(coefficients(T), current, supply_pressure=21e6, return_pressure=0.5e6)
    found = nearest_root(K, coefficients(T).null_gap_1 / valve.nozzle_arm, rest.armature_angle)
    assert rest.armature_angle == pytest.approx(found, rel=1e-9)


@pytest.mark.parametrize("off", [0.9, 1.1])
def test_polynomial_finds_its_root_from_a_start_beside_it(off):
    rest = static_solution(sharp, current=CURRENTS)
    K = tad_polynomial(coefficients(), CURRENTS, supply_pressure=21e6, return_pressure=0.5e6)
    found = nearest_root(K, valve.null_gap / valve.nozzle_arm, off * rest.armature_angle)
    assert found == pytest.approx(rest.armature_angle, rel=1e-11)


def test_polynomial_vanishes_on_the_branch():
    rest = static_solution(sharp, current=CURRENTS)
    K = tad_polynomial(coefficients(), CURRENTS, supply_pressure=21e6, return_pressure=0.5e6)
    terms = K * rest.armature_angle[:, None] ** np.arange(10)
    assert np.abs(terms.sum(axis=1)).max() < 1e-12 * np.abs(terms).max()


@given(
    st.floats(-0.1, 0.1),
    st.floats(-10e-3, 10e-3),
    st.floats(-5.0, 5.0),
    st.floats(-14e6, 14e6),
    st.floats(-40.0, 270.0),
)
def test_polynomial_is_the_balance_of_the_torques_over_its_denominators(theta, current, friction, load, temperature):
    # model.md section 4: sum K_k theta^k = (a0 + ..)(c0 + ..) (theta - A1 T_d - A2 p_L - A3), at any angle
    o = oracle.coefficients(*[temperature] * 5)
    p_s, p_0, r, arm, K_f = 21e6, 0.5e6, o["r"], o["r"] + o["b"], o["K_f"]
    K_flow = 0.43 * o["w"] * (p_s - load)
    jets = 8 * np.pi * r**2 * o["C_df"] ** 2 * p_s * o["x_f0"]
    D = (K_f + K_flow) * (o["K_s"] + K_f * arm**2 - jets) - K_f**2 * arm**2
    A1, A3 = (K_f + K_flow) / D, friction * K_f * arm / D
    A2 = -(r * o["A_N"] * (K_f + K_flow) + K_f * arm * o["A_v"]) / D
    A, B = o["d_0"] ** 4 * o["C_d0"] ** 2, 16 * o["C_df"] ** 2 * o["d_n"] ** 2
    one, two = (B * (o["x_f0"] + side * r * theta) ** 2 for side in (-1, 1))
    p_L = (A * p_s + one * p_0) / (A + one) - (A * p_s + two * p_0) / (A + two)  # Eq. 20
    mu_A = oracle.MU_0 * o["A_g"]
    X = o["gamma"] * (o["l_g1"] + o["l_g2"]) + mu_A * o["R_0"]
    magnetic = 2 * (o["l_g1"] * o["l_g2"] * X - o["gamma"] * (o["l_g1"] + o["l_g2"]) * o["a"] ** 2 * theta**2) ** 2
    assume(abs(magnetic) > 1e-6 * 2 * (o["l_g1"] * o["l_g2"] * X) ** 2)  # not on a pole of the torque
    terms = np.array([theta, -A1 * oracle.torque_closed_form(theta, current, o), -A2 * p_L, -A3])
    K = tad_polynomial(
        coefficients(temperature), current, supply_pressure=p_s, return_pressure=p_0, load_pressure=load,
        friction=friction,
    )  # fmt: skip
    size = max(np.abs(terms).max(), abs(A2) * p_s) * magnetic * (A + one) * (A + two)
    rounding = np.abs(K * theta ** np.arange(10)).max()
    assert np.polyval(K[::-1], theta) == pytest.approx(
        terms.sum() * magnetic * (A + one) * (A + two), abs=1e-9 * size + 1e-12 * rounding
    )


def test_real_roots_contain_the_branch_in_ascending_order():
    rest = static_solution(sharp, current=CURRENTS[:, None], temperature=TEMPERATURES)
    assert rest.real_roots.shape == (8, 5, 9)
    distance = np.nanmin(np.abs(rest.real_roots - rest.armature_angle[..., None]), axis=-1)
    assert np.all(distance < 1e-9 * 3.9e-3)  # of the null gap as an angle
    steps = np.diff(rest.real_roots, axis=-1)
    assert np.all(steps[np.isfinite(steps)] > 0.0)


def test_real_roots_solve_the_polynomial():
    K = tad_polynomial(coefficients(), 5e-3, supply_pressure=21e6, return_pressure=0.5e6)
    roots = static_solution(sharp, current=5e-3).real_roots
    roots = roots[np.isfinite(roots)]
    assert len(roots) % 2 == 1  # of a polynomial of odd degree
    terms = K * roots[:, None] ** np.arange(10)
    assert np.all(np.abs(terms.sum(axis=1)) < 1e-9 * np.abs(terms).max(axis=1))


@given(st.floats(1e-6, 10e-3), temperature)
def test_opposite_current_rests_at_the_mirrored_point(current, temperature):
    rest = static_solution(valve, current=np.array([current, -current]), temperature=temperature)
    for name in ("armature_angle", "spool_position", "pilot_differential_pressure"):
        here, there = getattr(rest, name)
        assert there == pytest.approx(-here, rel=1e-9)
    assert rest.nozzle_pressure_1 == pytest.approx(rest.nozzle_pressure_2[::-1], rel=1e-12)


def test_symmetric_valve_rests_at_zero_without_current():
    rest = static_solution(valve, current=0.0, temperature=TEMPERATURES)
    assert np.all(rest.armature_angle == 0.0) and np.all(rest.spool_position == 0.0)


@given(st.floats(-10e-3, 9e-3), st.floats(1e-5, 1e-3), temperature)
def test_more_current_moves_spool_and_angle_further(current, more, temperature):
    rest = static_solution(valve, current=np.array([current, current + more]), temperature=temperature)
    assert rest.armature_angle[1] > rest.armature_angle[0]
    assert rest.spool_position[1] > rest.spool_position[0]


# ---------------------------------------------------------------- shapes and refusals


@pytest.mark.parametrize(
    "current, temperature, shape",
    [(1e-3, 20.0, ()), (CURRENTS, 20.0, (8,)), (1e-3, TEMPERATURES, (5,)), (CURRENTS[:, None], TEMPERATURES, (8, 5))],
)
@pytest.mark.parametrize("routes", [ROUTES, ()], ids=["routes", "none"])
def test_every_field_has_the_broadcast_shape(current, temperature, shape, routes):
    rest = static_solution(valve, current=current, temperature=temperature, routes=routes)
    for field in dataclasses.fields(rest):
        if field.name not in ("real_roots", "branch"):
            assert getattr(rest, field.name).shape == shape, field.name
    assert rest.real_roots.shape == (*shape, 9)


def test_batch_of_currents_and_temperatures_is_each_alone():
    rest = static_solution(valve, current=CURRENTS[:, None], temperature=TEMPERATURES)
    alone = static_solution(valve, current=CURRENTS[6], temperature=TEMPERATURES[4])
    assert rest.armature_angle[6, 4] == pytest.approx(float(alone.armature_angle), rel=1e-12)
    assert (rest.current[6, 4], rest.temperature[6, 4]) == (5e-3, 270.0)


def test_batch_of_valves_is_each_alone():
    stiffness = np.array([9.5, 10.18, 11.0])
    rest = static_solution(Valve(spring_tube_stiffness=stiffness), current=CURRENTS[:, None])
    alone = static_solution(Valve(spring_tube_stiffness=11.0), current=CURRENTS[1])
    assert rest.spool_position.shape == (8, 3)
    assert rest.spool_position[1, 2] == pytest.approx(float(alone.spool_position), rel=1e-12)


def test_every_valve_of_a_large_batch_is_at_rest():
    """One whose torque vanished to the last bit was moved on while others had not settled: one of some 5000."""
    rng = np.random.default_rng(1)
    drawn = {
        name: getattr(valve, name) * rng.uniform(0.95, 1.05, 30_000) for name in ("spring_tube_stiffness", "nozzle_arm")
    }
    current = rng.uniform(-8e-3, 8e-3, 30_000)
    rest = static_solution(Valve(**drawn), current=current)
    c = Valve(**drawn).at(PartTemperatures.uniform(20.0))
    torque, _ = balances_at_rest(
        rest.armature_angle, current, rest.nozzle_pressure_1, rest.nozzle_pressure_2, c, *PRESSURES
    )
    assert np.max(np.abs(torque)) < 1e-12 * valve.spring_tube_stiffness


def test_a_root_met_to_the_last_bit_stays_while_others_are_sought():
    def torque(angle):
        return np.array([0.5 - angle[0], np.cbrt(0.3 - angle[1])])

    low, high = np.zeros(2), np.ones(2)
    assert _bracketed_root(torque, low, torque(low), high, torque(high), np.ones(2)) == pytest.approx([0.5, 0.3])


def test_batch_over_a_figure_outside_the_polynomial_has_real_roots_for_each():
    rest = static_solution(Valve(spool_mass=np.array([3e-3, 4e-3])), current=1e-3)
    assert rest.armature_angle.shape == (2,)
    assert rest.real_roots.shape == (2, 9)


@pytest.mark.parametrize("current", [0.08, -0.08, np.array([1e-3, 0.08])])
def test_current_that_carries_the_flapper_onto_a_nozzle_rests_there(current):
    with pytest.warns(ValidityWarning) as given_warnings:
        rest = static_solution(valve, current=current)
    assert len(given_warnings) == 2  # the spool's stop and the flapper's, once each
    angle, position = np.ravel(rest.armature_angle)[-1], np.ravel(rest.spool_position)[-1]
    side = np.sign(angle)
    assert side == np.sign(np.ravel(current)[-1])
    assert 0.035 / 8.9 < side * angle < 1.2 * 0.035 / 8.9 and valve.spool_stroke < side * position < 0.44e-3
    closed = rest.nozzle_pressure_1 if side > 0.0 else rest.nozzle_pressure_2
    assert np.ravel(closed)[-1] == pytest.approx(21e6, rel=1e-12)  # no flow through the closed nozzle
    state = (angle, 0.0, np.ravel(rest.nozzle_pressure_1)[-1], np.ravel(rest.nozzle_pressure_2)[-1], position, 0.0)
    rates = np.array(NOMINAL.rhs(state, Inputs(float(np.ravel(current)[-1]), 0.0, 21e6, 0.5e6, 0.0), coefficients()))
    assert np.abs(rates / SIZE).max() < 1e-9


@pytest.mark.parametrize("current", [1e-3, 0.0])
def test_magnets_stronger_than_the_spring_tube_have_no_solution(current):
    with pytest.raises(SolveError, match=r"no stable null .*3\.933 mrad.*raise spring_tube_stiffness"):
        static_solution(Valve(spring_tube_stiffness=2.0, feedback_rod_stiffness=100.0), current=current)


@pytest.mark.parametrize("current", [np.nan, np.array([1e-3, np.inf])])
def test_current_that_is_not_finite_is_refused(current):
    with pytest.raises(InputError, match="current holds NaN or infinity"):
        static_solution(valve, current=current)


def test_temperature_that_is_not_a_number_is_refused_as_input():
    with pytest.raises(InputError, match="nan °C is outside"):
        static_solution(valve, current=1e-3, temperature=np.nan)


def test_closed_clearance_is_refused():
    with pytest.raises(InputError, match="null gap 1 closes"):
        static_solution(Valve(flapper_length=0.03), current=1e-3, temperature=200.0)


# ---------------------------------------------------------------- the dynamic model stands still

# 1e-9 of usual sizes: 0.03 N m, 6e-6 m^3/s and 100 N (as in test_model.py)
BULK = coefficients().bulk_modulus_at_zero
SIZE = np.array([1.0, 0.03 / valve.armature_inertia, *[BULK * 6e-6 / valve.chamber_volume] * 2, 1.0, 100 / 4e-3])


def rates_at(rest, c, current, load=0.0):
    state = (rest.armature_angle, 0.0, rest.nozzle_pressure_1, rest.nozzle_pressure_2, rest.spool_position, 0.0)
    return np.array(NOMINAL.rhs(state, Inputs(current, 0.0, 21e6, 0.5e6, load), c)) / SIZE


@given(st.floats(-10e-3, 10e-3), temperature, st.booleans(), st.floats(-14e6, 14e6))
def test_dynamic_model_stands_still_at_rest(current, temperature, even, load):
    one = dataclasses.replace(sharp, load_pressure=load, **({} if even else UNEVEN))
    rest = static_solution(one, current=current, temperature=temperature)
    assume(abs(rest.spool_position) < valve.spool_stroke)
    assert np.abs(rates_at(rest, coefficients(temperature, one), current, load)).max() < 1e-9


def test_rest_beyond_the_spool_stop_is_warned_of():
    with pytest.warns(ValidityWarning, match=r"spool rests on its end stop at 0\.42 mm"):
        static_solution(valve, current=np.array([1e-3, 20e-3]))


def test_rest_within_the_spool_stop_is_silent():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        static_solution(valve, current=np.array([-10e-3, 10e-3]))  # rated, model.md section 5


# ---------------------------------------------------------------- unequal sides, load, friction


def test_uneven_valve_is_solved_directly_and_has_no_polynomial_roots():
    rest = static_solution(Valve(**UNEVEN), current=CURRENTS)
    assert rest.real_roots is None
    direct = follow_branch(coefficients(of=Valve(**UNEVEN)), CURRENTS, PRESSURES)
    assert np.array_equal(rest.armature_angle, direct)


@pytest.mark.parametrize("difference", UNEVEN)
def test_uneven_valve_has_a_null_shift_that_mirrors_with_its_difference(difference):
    shift = static_solution(Valve(**{difference: np.array([-2e-6, 0.0, 2e-6])}), current=0.0).spool_position
    assert shift[1] == pytest.approx(0.0, abs=1e-15)
    assert shift[2] == pytest.approx(-shift[0], rel=1e-6)
    assert abs(shift[2]) > 1e-8


@pytest.mark.parametrize("difference, sign", [("null_gap_difference", -1), ("fixed_orifice_difference", 1)])
def test_side_with_the_wider_orifice_or_narrower_gap_has_the_higher_pressure(difference, sign):
    p1, p2 = nozzle_pressures(0.0, coefficients(of=Valve(**{difference: 2e-6})), 21e6, 0.5e6)
    assert (p1 - p2) * sign > 0.0


def test_nearly_even_valve_rests_next_to_the_even_one():
    even, nearly = (static_solution(Valve(null_gap_difference=d), current=CURRENTS) for d in (0.0, 1e-14))
    assert nearly.armature_angle == pytest.approx(even.armature_angle, abs=1e-12)


def test_nozzle_pressures_divide_the_flow_equally():
    c = coefficients()
    theta = np.array([-2e-3, 0.0, 1e-3])
    p1, _ = nozzle_pressures(theta, c, 21e6, 0.5e6)
    # q_01 = q_n1, model.md section 3
    q_0 = np.pi * c.fixed_orifice_diameter_1**2 / 4 * c.orifice_flow_coefficient * np.sqrt(21e6 - p1)
    q_n = np.pi * c.nozzle_diameter_1 * (c.null_gap_1 - c.nozzle_arm * theta) * c.nozzle_flow_coefficient
    assert q_0 == pytest.approx(q_n * np.sqrt(p1 - 0.5e6), rel=1e-12)


@given(st.floats(1e-3, 10e-3), st.floats(-14e6, 14e6))
def test_load_pressure_weakens_the_flow_force_on_the_open_side(current, load):
    rest = static_solution(dataclasses.replace(sharp, load_pressure=load), current=current)
    # Eq. 34 with K_f' = 0.43 w (p_s - p_L), model.md section 3
    force = 16.8e-6 * rest.pilot_differential_pressure - 2780.0 * 22.2e-3 * rest.armature_angle
    assume(abs(rest.spool_position) < 0.999 * valve.spool_stroke)  # on its stop the stop carries a share
    assert rest.spool_position == pytest.approx(force / (2780.0 + 0.43 * 12.1e-3 * (21e6 - load)), rel=1e-9)


@given(st.floats(-10e-3, 10e-3), st.floats(-5.0, 5.0), st.booleans())
def test_static_friction_is_the_force_that_the_balances_leave_over(current, friction, even):
    one = dataclasses.replace(sharp, **({} if even else UNEVEN))
    rest = static_solution(one, current=current, friction=friction)
    left = rates_at(rest, coefficients(of=one), current)
    assert left[5] * SIZE[5] * 4e-3 == pytest.approx(friction, abs=1e-7)
    assert np.abs(np.delete(left, 5)).max() < 1e-9


def test_friction_holds_the_spool_back():
    still, held = (static_solution(valve, current=1e-3, friction=f) for f in (0.0, 1.0))
    assert held.spool_position < still.spool_position
    assert held.armature_angle > still.armature_angle  # Eq. 33: A3 > 0


@pytest.mark.parametrize("current, friction", [(0.0, 5.0), (1e-5, 1.0), (1e-4, 5.0)])
def test_friction_under_load_leaves_the_torques_in_balance(current, friction):
    one = dataclasses.replace(sharp, load_pressure=14e6)
    rest = static_solution(one, current=current, friction=friction)
    assert rates_at(rest, coefficients(of=one), current, 14e6)[1] == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- any valve settles where it is said to rest

TOLERANCES = {n: f.metadata["tolerance"] * (f.default or 3.0) for n, f in quantities(Valve).items()}


@st.composite
def any_case(draw):
    """A valve within its tolerances (three of them where a side differs), its pressures, current and temperature."""
    off = {n: getattr(valve, n) + draw(st.floats(-1.0, 1.0)) * t for n, t in TOLERANCES.items() if t}
    supply = draw(st.floats(1e6, 35e6))
    load = supply * draw(st.sampled_from([0.0, 1.0, -1.0, 0.999, -0.5, 1e-9]))
    law = FLOW_LAWS[draw(st.sampled_from(["yan_2019", "reynolds_number"]))]
    own = Valve(
        **off, supply_pressure=supply, return_pressure=min(0.5e6, 0.3 * supply), load_pressure=load,
        flow_coefficients=law,
    )  # fmt: skip
    return own, draw(st.floats(-30e-3, 30e-3)), draw(st.floats(-54.0, 270.0))


@settings(max_examples=25)
@given(any_case(), st.sampled_from([1.0, 0.1, 1e-4]))
def test_any_held_valve_settles_on_its_static_solution(case, share):
    one, current, temperature = case
    rest = static_solution(one, current=share * current, temperature=temperature)
    result = simulate(
        Scenario(
            valve=one, duration=2.0, command=Step(before=0.0, after=share * current, time=1e-3), output_rate=20.0,
            oil_temperature=Constant(value=temperature), thermal=Thermal(network=None),
        )
    )  # fmt: skip
    spans = (one.null_gap / one.nozzle_arm, one.spool_stroke, one.supply_pressure, one.supply_pressure)
    names = ("armature_angle", "spool_position", "nozzle_pressure_1", "nozzle_pressure_2")
    for name, span in zip(names, spans, strict=True):
        assert np.ptp(result.values[name][-10:]) < 1e-7 * span  # settled
        assert abs(result.values[name][-1] - float(getattr(rest, name))) < 1e-6 * span


@given(st.floats(-1.0, 1.0), st.floats(-1e-4, 1e-4), st.floats(-3.0, 3.0))
def test_branch_survives_load_pressure_near_null(load, current, friction):
    # the flow force has a kink at zero opening, where the side that opens changes
    one = dataclasses.replace(sharp, load_pressure=load * 21e6, null_gap_difference=1e-7)
    rest = static_solution(one, current=current, friction=friction)
    left = rates_at(rest, coefficients(of=one), current, load * 21e6)
    assert left[1] == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- iterations that must not end early


def test_polynomial_without_a_root_near_says_so():
    K = np.zeros(10)
    K[0], K[2] = 1.0, 1.0  # z^2 + 1
    with pytest.raises(SolveError, match=r"no root next to 500 mrad.*Start nearer"):
        nearest_root(K, np.array(1.0), np.array(0.5))


def test_states_that_find_no_rest_say_which_and_what_to_try():
    channel = Channel("spool_position", "m", "x", 1e-3)

    def never(y, f):
        f[:] = 1.0 + y * y

    def slope(y, J):
        J[:] = 2.0 * y

    with pytest.raises(SolveError, match=r"run: the valve finds no rest at the start: spool_position stays in motion"):
        settle(never, slope, np.array([0.3]), (channel,), where="run: ")


def test_states_settle_on_a_root_past_a_kink_and_hold_what_is_held():
    channels = [Channel(name, "m", name, 1.0) for name in "ab"]

    def rates(y, f):
        f[:] = [1.0 - y[0] - 1e3 * max(y[0] - 0.5, 0.0), 7.0 - y[1]]

    def slopes(y, J):
        J[:] = [[-1.0 - 1e3 * (y[0] > 0.5), 0.0], [0.0, -1.0]]

    found = settle(rates, slopes, np.array([0.0, 3.0]), channels, held=np.array([False, True]))
    assert found == pytest.approx([501.0 / 1001.0, 3.0], rel=1e-12)
