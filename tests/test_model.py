"""The equations: against the oracle, and by the laws that any valve obeys (symmetry, volume, reciprocity)."""

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, STATE_CHANNELS, Inputs, Signals, State
from valvesim.valve.catalogue import effect
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.equations import NOMINAL, Model, VoltageDrive, main_stage, torque_constant
from valvesim.valve.parameters import Valve, reference_valve

valve = reference_valve()
sharp = Valve(transition_pressure=1.0)  # roots that differ from the ideal ones by 1e-11 at 0.1 MPa
C20 = valve.at(PartTemperatures.uniform(20.0))
SHARP = sharp.at(PartTemperatures.uniform(20.0))
INPUTS = Inputs(2e-3, 0.0, 21e6, 0.5e6, 0.0)
REST = State(1e-4, 0.0, 9e6, 8e6, 8e-5, 0.0)

# usual sizes of what is summed in each balance, to measure differences by: rates, 0.03 N m at rated current (model.md
# section 5), pilot flow of 0.35 L/min (field.md 1), 100 N of pressure on the spool
BULK = C20.bulk_modulus_at_zero
SCALE = np.array([1.0, 0.03 / valve.armature_inertia, *[BULK * 6e-6 / valve.chamber_volume] * 2, 0.1, 100 / 4e-3])

pressure = st.floats(1e6, 20e6)
states = st.builds(
    State, st.floats(-3.7e-3, 3.7e-3), st.floats(-10.0, 10.0), pressure, pressure, st.floats(-4.1e-4, 4.1e-4),
    st.floats(-0.5, 0.5),
)  # fmt: skip
currents = st.floats(-0.02, 0.02)
temperatures = st.floats(-40.0, 270.0)


# ---------------------------------------------------------------- against the oracle


@given(states, currents, temperatures, temperatures, temperatures, temperatures, temperatures)
def test_derivatives_match_the_oracle(state, current, T_m, T_s, T_f, T_n, T_o):
    parts = PartTemperatures(
        oil=T_o,
        pilot_metal=T_n,
        spool=20.0,
        sleeve=20.0,
        body=20.0,
        torque_motor=T_m,
        spring_tube=T_s,
        feedback_rod=T_f,
    )
    c = sharp.at(parts)
    theirs = oracle.derivatives(
        state, current, oracle.coefficients(T_m, T_s, T_f, T_n, T_o), c.density,
        c.bulk_modulus_at_zero + c.bulk_modulus_slope * state.nozzle_pressure_1,
        c.bulk_modulus_at_zero + c.bulk_modulus_slope * state.nozzle_pressure_2,
    )  # fmt: skip
    mine = NOMINAL.rhs(state, INPUTS._replace(command=current), c)
    assert np.abs(np.subtract(mine, theirs) / SCALE).max() < 1e-9


@given(states, st.floats(10e6, 30e6), st.floats(0.0, 0.9e6))
def test_derivatives_match_the_oracle_at_other_supplies(state, supply, back):
    state = state._replace(nozzle_pressure_1=0.6 * supply, nozzle_pressure_2=0.3 * supply)
    beta = SHARP.bulk_modulus_at_zero + SHARP.bulk_modulus_slope * np.array([0.6, 0.3]) * supply
    theirs = oracle.derivatives(
        state,
        2e-3,
        oracle.coefficients(*[20.0] * 5),
        SHARP.density,
        *beta,
        supply_pressure=supply,
        return_pressure=back,
    )
    mine = NOMINAL.rhs(state, INPUTS._replace(supply_pressure=supply, return_pressure=back), SHARP)
    assert np.abs(np.subtract(mine, theirs) / SCALE).max() < 1e-9


# ---------------------------------------------------------------- symmetry, batches, balances


def mirrored(state):
    theta, omega, p1, p2, x, v = state
    return State(-theta, -omega, p2, p1, -x, -v)


@given(states, currents, temperatures, st.floats(-20e6, 20e6))
def test_mirrored_valve_moves_mirrored(state, current, temperature, load):
    c = valve.at(PartTemperatures.uniform(temperature))
    here = NOMINAL.rhs(state, INPUTS._replace(command=current, load_pressure=load), c)
    there = NOMINAL.rhs(mirrored(state), INPUTS._replace(command=-current, load_pressure=-load), c)
    assert np.abs(np.subtract(mirrored(here), there) / SCALE).max() < 1e-9


@given(states, currents)
def test_uneven_valve_mirrors_into_the_valve_of_the_opposite_differences(state, current):
    names = ("air_gap_difference", "null_gap_difference", "nozzle_diameter_difference", "fixed_orifice_difference")
    uneven, opposite = (Valve(**{n: s * 5e-6 for n in names}).at(PartTemperatures.uniform(20.0)) for s in (1.0, -1.0))
    here = NOMINAL.rhs(state, INPUTS._replace(command=current), uneven)
    there = NOMINAL.rhs(mirrored(state), INPUTS._replace(command=-current), opposite)
    assert np.abs(np.subtract(mirrored(here), there) / SCALE).max() < 1e-9


@given(states, currents, st.floats(-10e6, 10e6))
def test_signals_mirror_with_the_valve(state, current, load):
    here = NOMINAL.signals(state, INPUTS._replace(command=current, load_pressure=load), C20)
    there = NOMINAL.signals(mirrored(state), INPUTS._replace(command=-current, load_pressure=-load), C20)
    expected = {name: -getattr(here, name) for name in Signals._fields}
    expected |= {name: getattr(here, name) for name in ("pilot_flow", "internal_leakage")}
    expected |= {"nozzle_flow_1": here.nozzle_flow_2, "nozzle_flow_2": here.nozzle_flow_1}
    for channel in SIGNAL_CHANNELS:
        assert getattr(there, channel.name) == pytest.approx(expected[channel.name], rel=1e-9, abs=1e-9 * channel.scale)


def test_batch_equals_one_by_one():
    rng = np.random.default_rng(1)
    active = (effect("spool_stribeck_friction")(breakaway_force=3.0), effect("entrained_air")(air_fraction=0.01))
    model = Model(drive=VoltageDrive(), effects=tuple(a.effect for a in active))
    low, high = State(-5e-3, -5, 1e5, 1e5, -5e-4, -0.3), State(5e-3, 5, 21e6, 21e6, 5e-4, 0.3)
    states = rng.uniform((*low, -0.01, -1), (*high, 0.01, 1), (200, 8)).T
    inputs = INPUTS._replace(command=rng.uniform(-6, 6, 200), load_pressure=rng.uniform(-1e7, 1e7, 200))
    c = valve.at(PartTemperatures.uniform(rng.uniform(-40, 270, 200)))
    together = model.rhs(states, inputs, model.flat_coefficients(c, active))
    named = model.signals(states, inputs, model.flat_coefficients(c, active))
    for k in range(200):
        one_c = Coefficients(*(np.broadcast_to(v, 200)[k] for v in c))
        flat = model.flat_coefficients(one_c, active)
        one_u = inputs._replace(command=inputs.command[k], load_pressure=inputs.load_pressure[k])
        # rounding of terms far larger than their sum: measured by the sizes of those terms
        alone = np.array(model.rhs(states[:, k], one_u, flat))
        size = np.array([*SCALE, 0.01, 1e6])
        assert np.abs((np.array([r[k] for r in together]) - alone) / size).max() < 1e-10
        for channel, value in zip(SIGNAL_CHANNELS, model.signals(states[:, k], one_u, flat), strict=True):
            batch_value = np.broadcast_to(getattr(named, channel.name), 200)[k]
            assert batch_value == pytest.approx(value, rel=1e-11, abs=1e-11 * channel.scale)


def test_states_and_coefficients_broadcast_against_each_other():
    states = State(*(np.full((3, 1), value) for value in REST))
    c = valve.at(PartTemperatures.uniform(np.array([20.0, 100.0])))
    assert [np.shape(r) for r in NOMINAL.rhs(states, INPUTS, c)][1:4] == [(3, 2)] * 3


def test_channels_are_in_the_order_of_states_and_coefficients():
    model = Model(drive=VoltageDrive(), effects=(effect("magnetic_hysteresis"),))
    names = [channel.name for channel in model.state_channels]
    assert names == [*State._fields, "drive_current", "magnetic_hysteresis_state"]
    assert model.coefficient_names[: len(Coefficients._fields)] == Coefficients._fields
    assert model.coefficient_names[-2:] == (
        "magnetic_hysteresis.coercive_current",
        "magnetic_hysteresis.turning_current",
    )
    assert len(STATE_CHANNELS) == len(NOMINAL.rhs(REST, INPUTS, C20))
    assert Inputs._fields == tuple(channel.name for channel in INPUT_CHANNELS)


@given(states, currents)
def test_volume_that_flows_in_is_compressed_or_flows_out(state, current):
    inputs = INPUTS._replace(command=current)
    rates, q = NOMINAL.rhs(state, inputs, C20), NOMINAL.signals(state, inputs, C20)
    stored = sum(
        C20.chamber_volume * rate / (C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * p)
        for rate, p in ((rates[2], state.nozzle_pressure_1), (rates[3], state.nozzle_pressure_2))
    )
    assert stored == pytest.approx(q.pilot_flow - q.nozzle_flow_1 - q.nozzle_flow_2, abs=1e-9 * 6e-6)


@given(states, currents, st.floats(-0.3, 0.3))
def test_spool_displaces_from_one_chamber_what_it_takes_from_the_other(state, current, more):
    slow, fast = (
        NOMINAL.rhs(state._replace(spool_velocity=v), INPUTS._replace(command=current), C20) for v in (0.0, more)
    )
    for k, sign in ((2, -1), (3, 1)):
        beta = C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * state[k]
        assert (fast[k] - slow[k]) * C20.chamber_volume / beta == pytest.approx(
            sign * C20.spool_area * more, abs=1e-9 * 6e-6
        )


# ---------------------------------------------------------------- torque motor and drives


def test_torque_constant_is_that_of_the_reference_motor():
    # model.md section 5: identified on a torque constant of 2.82 N m/A
    assert torque_constant(C20) == pytest.approx(2.82, abs=0.005)


@given(temperatures)
def test_torque_constant_is_the_slope_of_the_torque_at_centre(temperature):
    c = valve.at(PartTemperatures.uniform(temperature))
    up, down = (NOMINAL.signals(State(0, 0, 1e7, 1e7, 0, 0), INPUTS._replace(command=i), c) for i in (1e-4, -1e-4))
    assert (up.drive_torque - down.drive_torque) / 2e-4 == pytest.approx(torque_constant(c), rel=1e-9)


def test_magnetic_spring_is_that_of_the_reference_motor():
    up, down = (
        NOMINAL.signals(REST._replace(armature_angle=a), INPUTS._replace(command=0.0), C20) for a in (1e-6, -1e-6)
    )
    # model.md section 5: identified on a magnetic spring of 6.5 N m/rad
    assert (up.drive_torque - down.drive_torque) / 2e-6 == pytest.approx(6.5, abs=0.05)


def voltage_rates(i=1e-3, omega=0.0, voltage=3.0, state=REST):
    model = Model(drive=VoltageDrive())
    return model.rhs((*state._replace(armature_rate=omega), i), INPUTS._replace(command=voltage), C20)


def test_voltage_drive_is_resistance_and_inductance():
    assert voltage_rates()[6] == pytest.approx((3.0 - 600 * 1e-3) / 0.57, rel=1e-12)  # field.md 1: 600 ohm, 0.57 H
    assert voltage_rates(voltage=0.6)[6] == pytest.approx(0.0, abs=1e-12)


def test_voltage_induced_by_motion_is_reciprocal_to_the_torque():
    # what the coil takes (back voltage times current) is what the armature gets (torque times rate)
    i, omega, centre = 1e-3, 2.0, REST._replace(armature_angle=0.0)
    back_voltage = 0.57 * (voltage_rates(i, 0.0, state=centre)[6] - voltage_rates(i, omega, state=centre)[6])
    torque = NOMINAL.signals(centre, INPUTS._replace(command=i), C20).drive_torque
    assert back_voltage * i == pytest.approx(torque * omega, rel=1e-9)


def test_voltage_drive_moves_the_valve_by_its_own_current():
    assert voltage_rates(i=2e-3)[:6] == NOMINAL.rhs(REST, INPUTS._replace(command=2e-3), C20)
    signals = Model(drive=VoltageDrive()).signals((*REST, 2e-3), INPUTS._replace(command=9.0), C20)
    assert signals.current == 2e-3


def test_voltage_drive_rests_at_the_current_of_its_resistance():
    (i,) = VoltageDrive().rest(3.0, C20)
    assert i == pytest.approx(5e-3, rel=1e-12)
    assert voltage_rates(i=i)[6] == pytest.approx(0.0, abs=1e-12)


# ---------------------------------------------------------------- main stage

tight = Valve(null_opening=1e-10, radial_clearance=1e-9, transition_pressure=1e-2).at(PartTemperatures.uniform(20.0))


@given(st.floats(5e-5, 4e-4), st.sampled_from([-1.0, 1.0]), st.floats(-20e6, 20e6))
def test_load_flow_wide_open_is_the_published_formula(opening, side, load):
    x = side * opening
    flow, _ = main_stage(x, 21e6, load, tight)
    # model.md section 3; 1e-5: two null openings of 1e-10 m on 5e-5 m
    expected = 0.61 * 12.1e-3 * x * np.sqrt((21e6 - side * load) / tight.density)
    assert flow == pytest.approx(expected, rel=1e-5)


def test_rated_flow_of_the_reference_valve_is_near_that_of_its_source():
    # field.md 1 A: 15.4 in^3/s = 2.52e-4 m^3/s at its 0.381 mm and a third of the supply over the valve
    flow, _ = main_stage(0.381e-3, 20.7e6, 20.7e6 * 2 / 3, C20)
    assert flow == pytest.approx(2.52e-4, rel=0.05)


@given(st.floats(-4.2e-4, 4.2e-4), st.floats(-20.9e6, 20.9e6), temperatures)
def test_leakage_is_positive(x, load, temperature):
    c = valve.at(PartTemperatures.uniform(temperature))
    flow, leakage = main_stage(x, 21e6, load, c)
    assert leakage > 0.0
    assert NOMINAL.signals(REST._replace(spool_position=x), INPUTS._replace(load_pressure=load), c).internal_leakage > (
        leakage
    )


def test_leakage_peaks_at_null_and_falls_to_both_sides():
    x = np.array([-1e-4, -1e-5, -1e-6, 0.0, 1e-6, 1e-5, 1e-4])
    _, leakage = main_stage(x, 21e6, 0.0, C20)
    assert np.argmax(leakage) == 3
    assert leakage == pytest.approx(leakage[::-1], rel=1e-12)
    assert np.all(np.diff(leakage[:4]) > 0.0)


def test_centred_spool_without_load_gives_no_flow():
    assert main_stage(0.0, 21e6, 0.0, C20)[0] == pytest.approx(0.0, abs=1e-9 * 2.5e-4)


@given(st.floats(-4e-4, 4e-4), st.floats(1e-6, 2e-4), st.floats(-15e6, 15e6))
def test_load_flow_rises_with_the_spool(x, more, load):
    assert main_stage(x + more, 21e6, load, C20)[0] > main_stage(x, 21e6, load, C20)[0]


@given(st.floats(-4e-4, 4e-4), st.floats(-20e6, 19e6), st.floats(1e4, 1e6))
def test_load_flow_falls_with_the_load_pressure(x, load, more):
    assert main_stage(x, 21e6, load + more, C20)[0] < main_stage(x, 21e6, load, C20)[0]


@given(st.floats(-4e-4, 4e-4), st.floats(-20e6, 20e6))
def test_flow_force_closes_the_spool_by_its_published_stiffness(x, load):
    force = NOMINAL.signals(REST._replace(spool_position=x), INPUTS._replace(load_pressure=load), C20).flow_force
    # K_f' = 0.43 w (p_s - p_L), model.md section 3, with the load on the side that is open
    assert force == pytest.approx(-0.43 * 12.1e-3 * (21e6 - np.sign(x) * load) * x, rel=1e-9, abs=1e-12)


# ---------------------------------------------------------------- stops


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_spool_stop_carries_beyond_the_stroke_only(side):
    stiff = C20._replace(spool_stop_stiffness=2 * C20.spool_stop_stiffness)
    for depth, force in ((-1e-9, 0.0), (5e-6, 2e7 * 5e-6)):
        state = REST._replace(spool_position=side * (0.42e-3 + depth))
        change = np.subtract(NOMINAL.rhs(state, INPUTS, stiff), NOMINAL.rhs(state, INPUTS, C20))
        assert change[5] * valve.spool_mass == pytest.approx(-side * force, rel=1e-6, abs=1e-9)
        assert np.all(np.delete(change, 5) == 0.0)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_flapper_stop_carries_where_the_flapper_meets_a_nozzle_of_its_own_gap(side):
    c = Valve(null_gap_difference=4e-6).at(PartTemperatures.uniform(20.0))
    gap = c.null_gap_1 if side > 0 else c.null_gap_2
    stiff = c._replace(flapper_stop_stiffness=2 * c.flapper_stop_stiffness)
    for depth, force in ((-1e-10, 0.0), (1e-6, 5e6 * 1e-6)):
        state = REST._replace(armature_angle=side * (gap + depth) / c.nozzle_arm)
        change = np.subtract(NOMINAL.rhs(state, INPUTS, stiff), NOMINAL.rhs(state, INPUTS, c))
        assert change[1] * c.armature_inertia == pytest.approx(-side * force * c.nozzle_arm, rel=1e-6, abs=1e-12)


@given(st.floats(0.0, 1e-3))
def test_flapper_on_a_nozzle_closes_it(beyond):
    on_1 = NOMINAL.signals(REST._replace(armature_angle=0.035e-3 / 8.9e-3 + beyond + 1e-9), INPUTS, C20)
    on_2 = NOMINAL.signals(REST._replace(armature_angle=-0.035e-3 / 8.9e-3 - beyond - 1e-9), INPUTS, C20)
    assert on_1.nozzle_flow_1 == on_2.nozzle_flow_2 == 0.0
    assert on_1.nozzle_flow_2 > 0.0 and on_2.nozzle_flow_1 > 0.0


def test_damping_of_the_armature_opposes_its_rate():
    still, moving = (NOMINAL.rhs(REST._replace(armature_rate=w), INPUTS, C20)[1] for w in (0.0, 3.0))
    assert (moving - still) * valve.armature_inertia == pytest.approx(-1.24e-3 * 3.0, rel=1e-9)  # B_a, model.md 5


def test_positive_current_turns_the_armature_towards_nozzle_1_which_drives_the_spool_to_positive():
    # model.md section 1: i > 0 -> theta > 0 -> p1 > p2 -> x > 0
    null = State(0.0, 0.0, 9e6, 9e6, 0.0, 0.0)
    assert NOMINAL.rhs(null, INPUTS._replace(command=1e-3), C20)[1] > 0.0
    turned = NOMINAL.rhs(null._replace(armature_angle=1e-3), INPUTS, C20)
    assert turned[2] > turned[3]
    assert NOMINAL.rhs(null._replace(nozzle_pressure_1=10e6), INPUTS, C20)[5] > 0.0
