"""Every entry of the catalogue: its closed form, its sign, its mirror image and what a test bench would see of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_effects import (
    C20,
    C_WARM,
    INPUTS,
    READING,
    STATE,
    WARM,
    N,
    at,
    coefficients,
    rates,
    signals,
    some,
    typical,
    valve,
)

from valvesim.channels import State
from valvesim.valve.catalogue import CATALOGUE, effect
from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.effect import Reading
from valvesim.valve.equations import (
    AT_20,
    NOMINAL,
    Model,
    VoltageDrive,
    drive_torque,
    main_stage,
    torque_constant,
)
from valvesim.valve.equilibrium import nozzle_pressures, solve_rest
from valvesim.valve.fluid import aerated_bulk_modulus
from valvesim.valve.laws import lagged
from valvesim.valve.parameters import Valve

FIXED_NAMES = (  # what records, scenarios and answers of a diagnosis call them
    "magnet_demagnetization magnetic_hysteresis magnetic_saturation coil_turns_loss eddy_current_lag "
    "amplifier_lag amplifier_second_order_lag load_line_resistance "
    "flexure_stiffness_loss fixed_orifice_clogging nozzle_erosion null_gap_asymmetry thermal_gradient_null_drift "
    "thermal_lag supply_pressure_droop return_pressure_rise flapper_cavitation entrained_air oil_viscosity_grade "
    "spool_coulomb_friction spool_stribeck_friction spool_silting spool_thermal_pinch feedback_ball_backlash "
    "spool_edge_wear spool_lap coil_resistance_drift sensor_bias sensor_gain sensor_lag sensor_delay "
    "sensor_temperature_drift"
).split()


def test_the_catalogue_holds_the_fixed_names():
    assert sorted(CATALOGUE) == sorted(FIXED_NAMES)


def rest(c, current=0.0):
    return solve_rest(c, current, 20.0, valve.supply_pressure, valve.return_pressure)


def differing(c, base=C20):
    """{name: ratio} of the coefficients that an effect has changed."""
    pairs = zip(c._fields, c, base, strict=True)
    return {name: (new / old if old else new) for name, new, old in pairs if new != old}


# ---------------------------------------------------------------- mirror images

ODD = {
    "eddy_lagging_current", "amplifier_current", "amplifier_second_order_current", "amplifier_current_rise",
    "magnetic_hysteresis_state",
}  # fmt: skip
"""Memories that change sign as the valve does."""
SIDED = {"fixed_orifice_clogging": 2.0, "nozzle_erosion": 2.0}  # the mirror image is on the other side
SIGNED = ("null_gap_asymmetry", "thermal_gradient_null_drift")  # the mirror image has the other sign


def mirrored(state):
    theta, omega, p1, p2, x, v, *memory = state
    return (-theta, -omega, p2, p1, -x, -v, *memory)


def image(active):
    """The effect of the mirrored valve."""
    name, amplitude = active.effect.name, active.numbers[0]
    if name in SIDED:
        return at(name, amplitude, side=SIDED[name])
    return at(name, -amplitude) if name in SIGNED else active


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.balance or e.coefficients])
def test_mirrored_valve_with_the_mirrored_effect_moves_mirrored(name):
    active = typical(name)
    other = image(active)
    model = Model(effects=(active.effect,))
    memory = [0.3 * channel.scale for channel in model.state_channels[N:]]
    sign = [-1.0 if m.name in ODD or "friction" in m.name else 1.0 for m in model.state_channels[N:]]
    there = INPUTS._replace(
        command=-INPUTS.command, command_rate=-INPUTS.command_rate, load_pressure=-INPUTS.load_pressure
    )
    here = model.rhs((*STATE, *memory), INPUTS, model.flat_coefficients(C_WARM, (active,), WARM))
    image_state = (*mirrored(STATE), *(s * m for s, m in zip(sign, memory, strict=True)))
    found = model.rhs(image_state, there, model.flat_coefficients(C_WARM, (other,), WARM))
    expected = (*mirrored(here[:N]), *(s * rate for s, rate in zip(sign, here[N:], strict=True)))
    size = np.array([1.0, 1e5, 1e12, 1e12, 1.0, 1e4, *(m.scale * 1e4 for m in model.state_channels[N:])])
    assert np.max(np.abs(np.subtract(found, expected)) / size) < 1e-9


# ---------------------------------------------------------------- friction

speeds = st.floats(1e-3, 1.0)


@pytest.mark.parametrize("name", ["spool_coulomb_friction", "spool_stribeck_friction"])
@given(speed=speeds, direction=st.sampled_from([-1.0, 1.0]))
def test_friction_opposes_the_motion_that_saturates_its_memory(name, speed, direction):
    v = direction * speed
    moving = STATE._replace(spool_velocity=v)
    assert np.sign(rates(some(name), state=moving)[N]) == direction  # the memory follows the velocity
    slowed = rates(some(name), state=moving, memory=direction)[5] - rates(state=moving)[5]
    assert slowed * direction < 0.0
    assert rates(some(name), state=moving, memory=direction)[N] * direction <= 0.0  # and goes no further than there


def test_coulomb_friction_has_its_force_at_every_speed():
    active = effect("spool_coulomb_friction")(friction_force=2.0)
    for v in (1e-4, 0.5):
        state = STATE._replace(spool_velocity=v)
        change = rates(active, state=state, memory=1.0)[5] - rates(state=state)[5]
        assert change * valve.spool_mass == pytest.approx(-2.0, rel=1e-9)


def test_coulomb_friction_reverses_within_three_presliding_distances():
    active = effect("spool_coulomb_friction")(friction_force=2.0, presliding_distance=1e-6)
    assert rates(active, memory=0.0)[N] == pytest.approx(STATE.spool_velocity / 1e-6, rel=1e-12)
    assert rates(active, memory=-1.0)[N] == pytest.approx(2 * STATE.spool_velocity / 1e-6, rel=1e-12)


@pytest.mark.parametrize("speed, force", [(0.0, 5.0), (1e-3, 5 * (0.4 + 0.6 / np.e)), (0.1, 2.0)])
def test_stribeck_friction_falls_from_breakaway_to_its_kinetic_share(speed, force):
    active = effect("spool_stribeck_friction")(breakaway_force=5.0, kinetic_share=0.4, stribeck_velocity=1e-3)
    state, settled = STATE._replace(spool_velocity=speed), force / 5.0
    assert rates(active, state=state, memory=settled)[N] == pytest.approx(0.0, abs=1e-9)
    change = rates(active, state=state, memory=settled)[5] - rates(state=state)[5]
    assert -change * valve.spool_mass == pytest.approx(force, rel=1e-9)  # F [k + (1-k) exp(-(v/v_s)^2)]


def test_friction_acts_on_the_spool_alone():
    change = np.subtract(rates(some("spool_coulomb_friction"), memory=1.0)[:N], rates())
    assert np.flatnonzero(change).tolist() == [5]


# ---------------------------------------------------------------- clogging and demagnetization


def clogged(share, side=1.0):
    return coefficients(at("fixed_orifice_clogging", share, side=side))


def null(c):
    return rest(c)


def test_clogging_takes_its_share_of_the_orifice_area_on_its_side_only():
    c = clogged(0.19)
    assert (c.fixed_orifice_diameter_1 / C20.fixed_orifice_diameter_1) ** 2 == pytest.approx(0.81, rel=1e-12)
    assert c._replace(fixed_orifice_diameter_1=C20.fixed_orifice_diameter_1) == C20
    other = clogged(0.19, side=2.0)
    assert (other.fixed_orifice_diameter_2 / C20.fixed_orifice_diameter_2) ** 2 == pytest.approx(0.81, rel=1e-12)
    assert other.fixed_orifice_diameter_1 == C20.fixed_orifice_diameter_1


def test_clogged_side_1_starves_nozzle_1_and_shifts_the_null_to_negative_spool():
    rest = [null(clogged(share)) for share in (0.0, 0.05, 0.1, 0.2)]
    shift = [float(r.spool_position) for r in rest]
    assert shift[0] == pytest.approx(0.0, abs=1e-15)
    assert shift[0] > shift[1] > shift[2] > shift[3]
    assert all(r.nozzle_pressure_1 < r.nozzle_pressure_2 for r in rest[1:])


def test_null_shift_of_clogging_is_near_proportional_and_mirrored_by_the_other_side():
    small, double, mirrored = (float(null(clogged(*a)).spool_position) for a in ((0.02,), (0.04,), (0.04, 2.0)))
    assert double / small == pytest.approx(2.0, rel=0.05)
    assert mirrored == pytest.approx(-double, rel=1e-9)


def test_clogged_orifice_divides_the_pressure_by_its_reduced_area():
    p1, p2 = nozzle_pressures(0.0, clogged(0.2), 21e6, 0.5e6)
    A = (0.8 * C20.fixed_orifice_diameter_1**2 * C20.orifice_flow_coefficient) ** 2  # model.md section 4
    B = (4 * C20.nozzle_diameter_1 * C20.null_gap_1 * C20.nozzle_flow_coefficient) ** 2
    assert p1 == pytest.approx((A * 21e6 + B * 0.5e6) / (A + B), rel=1e-12)
    assert p2 == pytest.approx(nozzle_pressures(0.0, C20, 21e6, 0.5e6)[1], rel=1e-12)


def test_clogging_lowers_the_tare_flow():
    active = effect("fixed_orifice_clogging")(clogged_share=0.2)
    assert signals(active).pilot_flow < signals().pilot_flow


def test_clogging_takes_an_array_of_sides():
    entry = effect("fixed_orifice_clogging")
    c = entry.coefficients(C20, entry.values((0.19, np.array([1.0, 2.0]))), AT_20)
    assert c.fixed_orifice_diameter_1 / 0.2e-3 == pytest.approx([0.9, 1.0], rel=1e-12)
    assert c.fixed_orifice_diameter_2 / 0.2e-3 == pytest.approx([1.0, 0.9], rel=1e-12)


def test_demagnetization_scales_the_polarization_and_the_torque_constant():
    entry = effect("magnet_demagnetization")
    c = entry.coefficients(C20, entry.values((0.1,)), AT_20)
    assert c.polarization_mmf == pytest.approx(0.9 * 2980.0, rel=1e-12)  # M0 (1 - IL), paper Eq. 4
    assert c._replace(polarization_mmf=C20.polarization_mmf) == C20
    assert torque_constant(c) == pytest.approx(0.9 * torque_constant(C20), rel=1e-12)


def test_demagnetized_valve_loses_more_angle_than_polarization():
    # model.md 6.6: theta ~ M0/(K - k M0^2), so a stable valve loses at least 5 % of theta to 5 % of M0
    entry = effect("magnet_demagnetization")
    new, old = (
        solve_rest(entry.coefficients(C20, entry.values((loss,)), AT_20), 1e-3, 20.0, 21e6, 0.5e6).armature_angle
        for loss in (0.05, 0.0)
    )
    assert -0.10 < new / old - 1 < -0.05


# ---------------------------------------------------------------- backlash, hysteresis, air


@given(st.floats(-0.999, 0.999))
def test_backlash_passes_nothing_within_the_play(share):
    active = effect("feedback_ball_backlash")(half_play=1e-5)
    theta = 1e-3
    position = share * 1e-5 - (valve.nozzle_arm + valve.feedback_arm) * theta
    state = STATE._replace(armature_angle=theta, spool_position=position)
    assert signals(active, state=state).feedback_force == pytest.approx(0.0, abs=1e-12)  # K_f of a rounded deflection


@given(st.floats(1e-7, 3e-4), st.sampled_from([-1.0, 1.0]))
def test_backlash_takes_half_its_play_off_the_deflection_beyond(beyond, side):
    active = effect("feedback_ball_backlash")(half_play=1e-5)
    state = STATE._replace(armature_angle=0.0, spool_position=side * (1e-5 + beyond))
    assert signals(active, state=state).feedback_force == pytest.approx(side * 2780.0 * beyond, rel=1e-9)


def test_hysteresis_opposes_the_change_of_current():
    active = some("magnetic_hysteresis")
    for direction in (-1.0, 1.0):
        inputs = INPUTS._replace(command_rate=direction * 0.5)
        assert np.sign(rates(active, inputs=inputs)[N]) == direction
        lagging = signals(active, inputs=inputs, memory=direction).drive_torque - signals(inputs=inputs).drive_torque
        assert lagging * direction < 0.0


def test_hysteresis_magnetises_as_a_current_less_by_its_coercive_current():
    active = effect("magnetic_hysteresis")(coercive_current=1e-4)
    assert signals(active, memory=0.8).drive_torque == pytest.approx(
        signals(inputs=INPUTS._replace(command=3e-3 - 0.8e-4)).drive_torque, rel=1e-12
    )
    assert signals(active, memory=0.8).current == 3e-3


def test_hysteresis_turns_over_its_turning_current():
    active = effect("magnetic_hysteresis")(coercive_current=1e-4, turning_current=1e-3)
    assert rates(active, memory=-1.0)[N] == pytest.approx(2 * 0.5 / 1e-3, rel=1e-12)  # 2 i'/i_t


def test_hysteresis_follows_the_coil_current_of_a_voltage_drive():
    active = some("magnetic_hysteresis")
    state = (*STATE, 2e-3)
    all_rates = rates(active, state=state, inputs=INPUTS._replace(command=30.0), drive=VoltageDrive())
    di = all_rates[N]
    assert di > 0.0
    assert all_rates[N + 1] == pytest.approx(di / 2e-3, rel=1e-12)  # memory at zero, default turning current 2 mA


@given(st.floats(1e4, 2e7), st.floats(1e-4, 0.2), st.floats(1.0, 1.67))
def test_entrained_air_slows_the_chambers_by_the_aerated_modulus(pressure, air, exponent):
    active = effect("entrained_air")(air_fraction=air, exponent=exponent)
    state = STATE._replace(nozzle_pressure_1=pressure, nozzle_pressure_2=5e6)
    for k, p in ((2, pressure), (3, 5e6)):
        clean = C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * p
        ratio = rates(active, state=state)[k] / rates(state=state)[k]
        assert ratio == pytest.approx(aerated_bulk_modulus(clean, p, air, exponent) / clean, rel=1e-9)
        assert ratio < 1.0


# ---------------------------------------------------------------- coil and iron


@given(st.floats(-0.02, 0.02), st.floats(0.0, 0.5), st.floats(5e-3, 2e-2))
def test_saturation_magnetises_by_its_cubic(current, share, reference):
    active = at("magnetic_saturation", share, reference_current=reference)
    inputs = INPUTS._replace(command=current)
    equal = INPUTS._replace(command=current - share * current**3 / reference**2)
    assert signals(active, inputs=inputs).drive_torque == pytest.approx(
        signals(inputs=equal).drive_torque, rel=1e-9, abs=1e-15
    )
    assert signals(active, inputs=inputs).current == current


def test_saturation_takes_its_share_at_the_reference_current_and_little_below():
    active = at("magnetic_saturation", 0.1)
    state = STATE._replace(armature_angle=0.0)  # where the torque is in proportion to the current

    def lost(current):
        inputs = INPUTS._replace(command=current)
        return (
            1.0
            - signals(active, state=state, inputs=inputs).drive_torque
            / signals(state=state, inputs=inputs).drive_torque
        )

    assert lost(10e-3) == pytest.approx(0.1, rel=1e-9)
    assert lost(1e-3) == pytest.approx(0.001, rel=1e-9)
    assert lost(-10e-3) == pytest.approx(0.1, rel=1e-9)


def test_shorted_turns_scale_turns_resistance_and_inductance():
    found = differing(coefficients(at("coil_turns_loss", 0.1)))
    assert found == pytest.approx({"coil_turns": 0.9, "coil_resistance": 0.9, "coil_inductance": 0.81}, rel=1e-12)


def test_shorted_turns_at_held_voltage_draw_current_and_keep_the_torque():
    # i = U/R grows by 1/0.9 as the turns fall by 0.9: at rest only the speed tells
    c = coefficients(at("coil_turns_loss", 0.1))
    old, new = (VoltageDrive().rest(3.0, each)[0] for each in (C20, c))
    assert new / old == pytest.approx(1 / 0.9, rel=1e-12)
    assert new * torque_constant(c) == pytest.approx(old * torque_constant(C20), rel=1e-12)


def test_what_is_indistinguishable_from_an_effect_is_in_the_catalogue_and_is_several():
    named = {name: entry.indistinguishable_from for name, entry in CATALOGUE.items() if entry.indistinguishable_from}
    assert named == {"coil_turns_loss": ("magnet_demagnetization", "flexure_stiffness_loss")}
    assert all(other in CATALOGUE for others in named.values() for other in others)


@pytest.mark.parametrize("loss", [0.05, 0.2, 0.35])
def test_a_magnet_with_a_flexure_as_weak_turns_the_armature_as_lost_turns_do(loss):
    """The torques of motor and tube at each angle and current: what the magnetic spring has lost, of which (1 - s)^2 is
    left, the flexure has lost too.
    """

    def torque(c, angle, current):
        return drive_torque(angle, c.coil_turns * current, c) - c.spring_tube_stiffness * angle

    def with_loss(name, share, c=C20):
        return effect(name).coefficients(c, effect(name).values((share,)), AT_20)

    step = 1e-6
    magnetic_spring = (drive_torque(step, 0.0, C20) - drive_torque(-step, 0.0, C20)) / (2.0 * step)
    softer = magnetic_spring * (1.0 - (1.0 - loss) ** 2) / C20.spring_tube_stiffness
    both = with_loss("flexure_stiffness_loss", softer, with_loss("magnet_demagnetization", loss))
    turns = with_loss("coil_turns_loss", loss)
    at = [(angle, current) for angle in np.linspace(-2e-3, 2e-3, 9) for current in np.linspace(-10e-3, 10e-3, 9)]
    one, other, healthy = (np.array([torque(c, *each) for each in at]) for c in (both, turns, C20))
    assert np.max(np.abs(one - other)) < 0.1 * np.max(np.abs(other - healthy))


def test_eddy_currents_hold_back_their_share_until_the_lag_has_passed():
    active = at("eddy_current_lag", 0.2, time_constant=1e-3)

    def torque(late):
        return signals(active, memory=late).drive_torque

    assert torque(3e-3) == pytest.approx(signals().drive_torque, rel=1e-12)  # it has followed: nothing at rest
    held = signals(inputs=INPUTS._replace(command=0.8 * 3e-3)).drive_torque
    assert torque(0.0) == pytest.approx(held, rel=1e-12)
    assert rates(active, memory=1e-3)[N] == pytest.approx((3e-3 - 1e-3) / 1e-3, rel=1e-12)


def test_the_current_of_an_amplifier_comes_up_with_its_lag_and_is_there_at_rest():
    active, own = at("amplifier_lag", 4e-4), 5e-5

    def torque(late):
        return signals(active, memory=late).drive_torque

    assert torque(3e-3) == pytest.approx(signals().drive_torque, rel=1e-12)
    at_once = signals(inputs=INPUTS._replace(command=own / (4e-4 + own) * 3e-3)).drive_torque
    assert torque(0.0) == pytest.approx(at_once, rel=1e-12)
    assert rates(active, memory=1e-3)[N] == pytest.approx((3e-3 - 1e-3) / (4e-4 + own), rel=1e-12)
    assert signals(at("amplifier_lag", 0.0), memory=1e-3).drive_torque == pytest.approx(signals().drive_torque)


def test_the_current_of_an_amplifier_of_second_order_is_there_at_rest_and_rises_by_its_rate():
    active, own, tau, zeta = at("amplifier_second_order_lag", 4e-4, damping_ratio=0.6), 5e-5, 4e-4, 0.6

    def torque(late, rise):
        return signals(active, memory=(late, rise)).drive_torque

    assert torque(3e-3, 0.0) == torque(3e-3, 1.0) == pytest.approx(signals().drive_torque, rel=1e-12)
    at_once = signals(inputs=INPUTS._replace(command=own / (tau + own) * 3e-3)).drive_torque
    assert torque(0.0, 0.0) == pytest.approx(at_once, rel=1e-12)
    found = rates(active, memory=(1e-3, 4e-4))
    assert found[N] == pytest.approx(4e-4 / (tau + own), rel=1e-12)
    assert found[N + 1] == pytest.approx((3e-3 - 1e-3 - 2.0 * zeta * 4e-4) / (tau + own), rel=1e-12)
    assert signals(at("amplifier_second_order_lag", 0.0), memory=(1e-3, 1.0)).drive_torque == pytest.approx(
        signals().drive_torque
    )


def test_coil_resistance_drift_changes_the_resistance_alone():
    for share in (-0.2, 0.1):
        found = differing(coefficients(at("coil_resistance_drift", share)))
        assert found == pytest.approx({"coil_resistance": 1.0 + share}, rel=1e-12)


def test_coil_resistance_drift_is_seen_by_a_voltage_drive_only():
    c = coefficients(at("coil_resistance_drift", 0.1))
    assert rates(c=c) == rates()
    assert VoltageDrive().rest(6.6, c)[0] == pytest.approx(6.6 / 660.0, rel=1e-12)


def test_a_softened_flexure_carries_less_and_lets_the_angle_grow():
    c = coefficients(at("flexure_stiffness_loss", 0.1))
    assert differing(c) == pytest.approx({"spring_tube_stiffness": 0.9}, rel=1e-12)
    angles = [
        float(rest(coefficients(at("flexure_stiffness_loss", s)), 1e-3).armature_angle) for s in (0, 0.1, 0.2)
    ]  # fmt: skip
    assert angles[0] < angles[1] < angles[2]


# ---------------------------------------------------------------- nozzles and gaps


@pytest.mark.parametrize("side", [1, 2])
def test_erosion_adds_its_share_to_the_nozzle_area_of_its_side(side):
    found = differing(coefficients(at("nozzle_erosion", 0.21, side=float(side))))
    assert found == pytest.approx({f"nozzle_diameter_{side}": 1.1}, rel=1e-12)


def test_erosion_shifts_the_null_as_clogging_does_but_raises_the_tare_flow():
    def tare(c):
        r = rest(c)
        state = State(r.armature_angle, 0.0, r.nozzle_pressure_1, r.nozzle_pressure_2, r.spool_position, 0.0)
        return signals(state=state, inputs=INPUTS._replace(command=0.0, load_pressure=0.0), c=c).pilot_flow

    eroded, plugged = coefficients(at("nozzle_erosion", 0.1)), clogged(0.1)
    assert rest(eroded).spool_position < 0.0 and rest(plugged).spool_position < 0.0
    assert tare(plugged) < tare(C20) < tare(eroded)


def test_gap_asymmetry_opens_one_gap_by_half_and_closes_the_other():
    c = coefficients(at("null_gap_asymmetry", 4e-6))
    assert c.null_gap_1 - C20.null_gap_1 == pytest.approx(2e-6, rel=1e-9)
    assert c.null_gap_2 - C20.null_gap_2 == pytest.approx(-2e-6, rel=1e-9)
    assert set(differing(c)) == {"null_gap_1", "null_gap_2"}


def test_gap_asymmetry_is_the_valves_own_difference():
    own = Valve(null_gap_difference=4e-6).at(PartTemperatures.uniform(20.0))
    assert coefficients(at("null_gap_asymmetry", 4e-6)) == pytest.approx(own, rel=1e-12)


def test_gap_asymmetry_moves_the_null_in_proportion_and_either_way():
    shift = [float(rest(coefficients(at("null_gap_asymmetry", d))).spool_position) for d in (-4e-6, 2e-6, 4e-6)]
    assert shift[2] / shift[1] == pytest.approx(2.0, rel=0.02)
    assert shift[0] == pytest.approx(-shift[2], rel=1e-9)
    assert shift[2] < 0.0  # nozzle 1 opens, its pressure falls


def test_gradient_drift_follows_oil_above_body():
    c = coefficients(at("thermal_gradient_null_drift", 1e-7), C_WARM, WARM)
    difference = 1e-7 * (60.0 - 33.0)
    expected = coefficients(at("null_gap_asymmetry", difference), C_WARM, WARM)
    assert c == pytest.approx(expected, rel=1e-12)


def test_gradient_drift_is_nothing_where_oil_and_body_are_even():
    even = PartTemperatures.uniform(80.0)
    c = valve.at(even)
    assert coefficients(at("thermal_gradient_null_drift", 2e-7), c, even) == c


@pytest.mark.parametrize("ratio, share", [(1.0, 0.0), (20.0, 0.5), (200.0, 1.0)])
def test_cavitation_takes_its_share_of_the_nozzle_flow_beyond_the_critical_ratio(ratio, share):
    active = at("flapper_cavitation", 0.3)
    state = STATE._replace(nozzle_pressure_1=10e6, nozzle_pressure_2=10e6)
    inputs = INPUTS._replace(return_pressure=10e6 / ratio)
    gained = np.subtract(rates(active, state=state, inputs=inputs), rates(state=state, inputs=inputs))[2:4]
    nominal = signals(state=state, inputs=inputs)
    compliance = 1.0 / (C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * 10e6)
    flows = np.array([nominal.nozzle_flow_1, nominal.nozzle_flow_2])
    expected = 0.3 * share * flows / (valve.chamber_volume * compliance)
    assert gained == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.max(np.abs(rates()[2:4])))


def test_cavitation_grows_smoothly_with_the_pressure_ratio_and_takes_a_return_at_zero_pressure():
    active = at("flapper_cavitation", 0.3)
    share = []
    for back in (5e6, 2e6, 0.8e6, 0.5e6, 0.4e6, 0.2e6, 0.0):
        inputs = INPUTS._replace(return_pressure=back)
        gained = rates(active, inputs=inputs)[2] - rates(inputs=inputs)[2]
        share.append(gained / signals(inputs=inputs).nozzle_flow_1)
    assert np.all(np.diff(share) > 0.0) and share[0] > 0.0


# ---------------------------------------------------------------- supply, return, oil


def test_droop_lowers_the_supply_by_resistance_times_the_flow_it_has_felt():
    active = at("supply_pressure_droop", 2e9, time_constant=5e-3)
    lower = INPUTS._replace(supply_pressure=21e6 - 2e9 * 1e-4)
    assert rates(active, memory=1e-4)[:N] == rates(inputs=lower)
    assert signals(active, memory=1e-4) == signals(inputs=lower)
    flow = signals().load_flow
    assert rates(active, memory=1e-4)[N] == pytest.approx((abs(flow) - 1e-4) / 5e-3, rel=1e-12)


@pytest.mark.parametrize("position", [-1e-4, 1e-4])
def test_return_rises_with_the_load_flow_whichever_way_it_goes(position):
    state = STATE._replace(spool_position=position)
    flow = abs(signals(state=state).load_flow)
    higher = INPUTS._replace(return_pressure=0.5e6 + 3e9 * flow)
    assert rates(at("return_pressure_rise", 3e9), state=state) == pytest.approx(rates(state=state, inputs=higher))
    assert higher.return_pressure > 0.6e6


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_lines_between_the_ports_take_what_the_flow_that_passes_them_makes(side):
    open_wide = list(STATE)
    open_wide[4] = side * 1e-4
    active = at("load_line_resistance", 8e5)
    flow = signals(active, state=open_wide).load_flow
    taken = 8e5 * (flow / 2.5e-4) * abs(flow / 2.5e-4)
    loaded = INPUTS._replace(load_pressure=INPUTS.load_pressure + taken)
    assert abs(taken) > 1e4 and flow == pytest.approx(signals(state=open_wide, inputs=loaded).load_flow, rel=2e-3)


@given(st.floats(5e5, 3.5e7), st.floats(-0.999, 0.999), st.floats(-4e-4, 4e-4), st.sampled_from([0.0, 1e4, 1e6, 2e7]))
def test_lines_between_the_ports_never_make_more_flow_nor_turn_it(supply, share, position, drop):
    inputs = INPUTS._replace(supply_pressure=supply, load_pressure=share * supply)
    state = STATE._replace(spool_position=position)
    without = signals(state=state, inputs=inputs).load_flow
    flow = signals(at("load_line_resistance", drop), state=state, inputs=inputs).load_flow
    assert abs(flow) <= abs(without) * (1.0 + 1e-9)


def test_another_viscosity_grade_scales_viscosity_and_spool_damping():
    for factor in (0.5, 2.0):
        found = differing(coefficients(at("oil_viscosity_grade", factor)))
        assert found == pytest.approx({"dynamic_viscosity": factor, "spool_damping": factor}, rel=1e-12)


def test_a_thicker_grade_leaks_less_past_a_closed_land():
    leakage = [
        main_stage(2e-4, 21e6, 0.0, coefficients(at("oil_viscosity_grade", f)))[1] for f in (0.5, 1.0, 2.0)
    ]  # fmt: skip
    assert leakage[0] > leakage[1] > leakage[2]


# ---------------------------------------------------------------- silt, pinch, lands


def silting(silt, z, v=0.04, **shape):
    active = at("spool_silting", 4.0, **shape)
    model = Model(effects=(active.effect,))
    flat = model.flat_coefficients(C20, (active,))
    return model.rhs((*STATE._replace(spool_velocity=v), silt, z), INPUTS, flat)


def test_silt_settles_at_rest_and_is_wiped_off_by_the_path():
    assert silting(0.25, 0.0, v=0.0, dwell_time=0.1)[N] == pytest.approx(0.75 / 0.1, rel=1e-12)
    for v in (-0.04, 0.04):
        wiped = silting(1.0, 0.0, v=v, break_distance=1e-5)[N]
        assert wiped == pytest.approx(-0.04 / 1e-5, rel=1e-12)


def test_silt_holds_the_spool_by_what_has_settled():
    for silt in (0.0, 0.3, 1.0):
        force = (silting(silt, 1.0)[5] - rates()[5]) * valve.spool_mass
        assert force == pytest.approx(-4.0 * silt, abs=1e-9)


def test_silt_friction_reverses_over_the_presliding_distance():
    assert silting(1.0, -1.0, presliding_distance=2e-6)[N + 1] == pytest.approx(2 * 0.04 / 2e-6, rel=1e-12)
    assert silting(1.0, 1.0)[N + 1] == 0.0


def test_pinch_rubs_by_the_clearance_that_is_lost():
    active = at("spool_thermal_pinch", 4e6)
    lost = 3e-6 - C_WARM.radial_clearance
    assert lost == pytest.approx(12e-6 * np.sqrt(16.8e-6 / np.pi) * (50.0 - 38.0), rel=1e-9)
    force = (rates(active, memory=1.0, c=C_WARM)[5] - rates(c=C_WARM)[5]) * valve.spool_mass
    assert force == pytest.approx(-4e6 * lost, rel=1e-9)
    assert rates(active, memory=-1.0)[N] == pytest.approx(2 * STATE.spool_velocity / 0.5e-6, rel=1e-12)


def test_pinch_is_nothing_while_the_clearance_is_free():
    free = valve.at(PartTemperatures(**{name: 20.0 for name in PART_NAMES if name != "sleeve"}, sleeve=25.0))
    assert rates(at("spool_thermal_pinch", 1e8), memory=1.0, c=free)[:N] == rates(c=free)


def test_worn_edges_widen_the_null_opening_and_leak_at_null():
    c = coefficients(at("spool_edge_wear", 5e-6))
    assert set(differing(c)) == {"null_opening"} and c.null_opening == pytest.approx(8e-6, rel=1e-12)
    leakage = [main_stage(0.0, 21e6, 0.0, coefficients(at("spool_edge_wear", d)))[1] for d in (0.0, 5e-6, 1e-5)]
    assert leakage[0] < leakage[1] < leakage[2]
    assert NOMINAL.rhs(STATE, INPUTS, c) == NOMINAL.rhs(STATE, INPUTS, C20)


@pytest.mark.parametrize("overlap", [-2e-5, 2e-5])
def test_lap_moves_the_opening_of_every_land(overlap):
    c = coefficients(at("spool_lap", overlap))
    assert differing(c) == {"land_overlap": overlap}
    tight = c._replace(null_opening=1e-9, radial_clearance=1e-9)
    for x in (-3e-4, 3e-4):  # far from null only the inlet land and the outlet land of each port are open
        opening = np.sign(x) * (abs(x) - overlap)
        flow, _ = main_stage(x, 21e6, 0.0, tight)
        # one land of each port: C_d w (|x| - u) sqrt(p_s/rho), model.md section 3
        assert flow == pytest.approx(0.61 * 12.1e-3 * opening * np.sqrt(21e6 / c.density), rel=1e-4)
    assert NOMINAL.rhs(STATE, INPUTS, c) == NOMINAL.rhs(STATE, INPUTS, C20)


def test_overlap_is_a_dead_band_and_underlap_doubles_the_gain():
    def gain(overlap):
        c = coefficients(at("spool_lap", overlap))
        return (main_stage(1e-6, 21e6, 0.0, c)[0] - main_stage(-1e-6, 21e6, 0.0, c)[0]) / 2e-6

    wide = (main_stage(2.01e-4, 21e6, 0.0, C20)[0] - main_stage(1.99e-4, 21e6, 0.0, C20)[0]) / 2e-6
    assert gain(3e-5) < 0.05 * wide
    assert gain(-3e-5) == pytest.approx(2.0 * wide, rel=0.02)


# ---------------------------------------------------------------- temperatures

TIMES = np.array([0.0, 1.0, 1.0, 2.0, 4.0])  # a jump at 1 s


def thermal_lag(tau, path, **others):
    active = at("thermal_lag", tau)
    parts = PartTemperatures.uniform(path)
    return active.effect.temperatures(TIMES, parts, active.values)


def test_thermal_lag_is_exact_through_holds_jumps_and_ramps():
    late = thermal_lag(2.0, np.array([20.0, 20.0, 50.0, 50.0, 90.0])).body
    held = 50.0 - 30.0 * np.exp(-0.5)  # T = 50 - 30 exp(-(t - 1)/2)
    # then a ramp of 20 K/s: T = u - 40 + (T(2) - 50 + 40) exp(-(t - 2)/2)
    assert late == pytest.approx([20.0, 20.0, 20.0, held, 50.0 + (held - 10.0) * np.exp(-1.0)], rel=1e-12)


def test_thermal_lag_leaves_the_oil_and_moves_every_part():
    path = np.array([20.0, 30.0, 50.0, 50.0, 90.0])
    late = thermal_lag(2.0, path)
    assert np.array_equal(late.oil, path)
    assert all(np.max(np.abs(getattr(late, name) - path)) > 10.0 for name in PART_NAMES if name != "oil")


def test_thermal_lag_takes_parts_that_hold():
    active = at("thermal_lag", 2.0)
    parts = active.effect.temperatures(TIMES, PartTemperatures.uniform(20.0), active.values)
    assert np.array_equal(parts.body, np.full(5, 20.0))


# ---------------------------------------------------------------- sensors


def read(name, amplitude, reading=READING):
    active = at(name, amplitude)
    return active.effect.reading(reading, active.values)


def test_sensor_bias_and_gain_are_a_shift_and_a_factor():
    assert read("sensor_bias", -2e-6) == pytest.approx(READING.values - 2e-6, rel=1e-12)
    assert read("sensor_gain", -0.05) == pytest.approx(0.95 * READING.values, rel=1e-12)


def test_sensor_drift_follows_the_oil_from_20_degrees():
    assert read("sensor_temperature_drift", 1e-7) - READING.values == pytest.approx(
        1e-7 * 400.0 * READING.time, abs=1e-18
    )


def test_sensor_lag_follows_a_ramp_by_its_time_constant():
    tau, slope = 2e-3, 0.1
    ramp = Reading(READING.time, slope * READING.time, READING.oil_temperature)
    expected = slope * (READING.time - tau * (1.0 - np.exp(-READING.time / tau)))
    assert read("sensor_lag", tau, ramp) == pytest.approx(expected, rel=1e-9, abs=1e-18)


def test_sensor_delay_shifts_a_line_and_holds_the_first_value_before_it():
    line = Reading(READING.time, 1e-4 + 1e-3 * READING.time, READING.oil_temperature)
    delayed = read("sensor_delay", 2.5e-3, line)
    assert delayed[3:] == pytest.approx(1e-4 + 1e-3 * (READING.time[3:] - 2.5e-3), rel=1e-12)
    assert delayed[:3] == pytest.approx([1e-4] * 3, rel=1e-12)


@pytest.mark.parametrize("name", ["sensor_lag", "sensor_delay"])
def test_a_late_sensor_reads_rest_as_rest(name):
    still = Reading(READING.time, np.full(101, 2e-4), READING.oil_temperature)
    assert read(name, 5e-3, still) == pytest.approx(still.values, rel=1e-14)


def test_sensor_lag_takes_uneven_samples():
    uneven = np.sort(np.append(READING.time, [0.0103, 0.0607, 0.0608]))
    line = Reading(uneven, np.interp(uneven, READING.time, READING.values), np.full(104, 20.0))
    everywhere = read("sensor_lag", 5e-3, line)
    assert np.interp(READING.time, uneven, everywhere) == pytest.approx(
        read("sensor_lag", 5e-3, READING._replace(oil_temperature=20.0)), rel=1e-9, abs=1e-15
    )
    assert np.array_equal(everywhere, lagged(uneven, line.values, 5e-3))


def test_what_hangs_on_a_coefficient_that_stands_still_has_a_plainer_effect():
    for one in CATALOGUE.values():
        if one.reading is not None:
            assert one.feature in ("", *Reading._fields), one.name
        elif one.feature:
            assert hasattr(Valve().at(AT_20), one.feature) and one.plainer in CATALOGUE, one.name
    pinch, coulomb = (CATALOGUE[name] for name in ("spool_thermal_pinch", "spool_coulomb_friction"))
    assert pinch.feature == "radial_clearance" and not coulomb.feature
