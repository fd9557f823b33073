"""Every effect of the catalogue: neutral at its neutral value, refused outside its bounds, its own sign and size."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.catalogue import CATALOGUE, effect
from valvesim.channels import STATE_CHANNELS, Channel, Inputs, State
from valvesim.effects import Effect, Parameter, Ports
from valvesim.errors import InputError
from valvesim.fluid import aerated_bulk_modulus
from valvesim.model import AT_20, Model, VoltageDrive, torque_constant
from valvesim.parameters import PartTemperatures, reference_valve
from valvesim.static import nozzle_pressures, solve_rest

valve = reference_valve()
C20 = valve.at(PartTemperatures.uniform(20.0))
NAMES = list(CATALOGUE)
STATE = State(1.2e-4, 0.7, 9.1e6, 8.3e6, 0.9e-4, 0.04)  # everything in motion, nothing on a stop
INPUTS = Inputs(3e-3, 0.5, 21e6, 0.5e6, 4e6)
N = len(STATE_CHANNELS)


def rates(*active, state=STATE, inputs=INPUTS, memory=0.0, c=C20, drive=None):
    """Derivatives of the six states, then of the memories; every memory at `memory`."""
    model = Model(effects=tuple(a.effect for a in active), **({} if drive is None else {"drive": drive}))
    memories = (memory,) * (len(model.state_channels) - N)
    return model.rhs((*state, *memories), inputs, model.flat_coefficients(c, active))


def signals(*active, state=STATE, inputs=INPUTS, memory=0.0, c=C20):
    model = Model(effects=tuple(a.effect for a in active))
    memories = (memory,) * (len(model.state_channels) - N)
    return model.signals((*state, *memories), inputs, model.flat_coefficients(c, active))


def some(name, share=0.3):
    """The effect with its amplitude at a share of its upper bound."""
    entry = effect(name)
    return entry(**{entry.amplitude.name: share * entry.amplitude.bounds[1]})


# ---------------------------------------------------------------- every entry


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("memory", [0.0, -0.7, 1.0])
@pytest.mark.parametrize("voltage", [False, True], ids=["current", "voltage"])
def test_neutral_amplitude_leaves_exactly_the_nominal_derivatives(name, memory, voltage):
    entry = effect(name)
    off = entry(**{entry.amplitude.name: entry.amplitude.neutral})
    drive = VoltageDrive() if voltage else None
    state = (*STATE, 2e-3) if voltage else STATE
    nominal = rates(state=state, drive=drive)
    assert rates(off, state=state, memory=memory, drive=drive)[: len(nominal)] == nominal


@pytest.mark.parametrize("name", NAMES)
def test_amplitude_above_neutral_changes_the_derivatives(name):
    # beyond the play, while it moves, under a memory
    state = STATE._replace(spool_position=4.1e-4)
    assert rates(some(name), state=state, memory=0.5)[:N] != rates(state=state)


@pytest.mark.parametrize("name", NAMES)
def test_every_entry_says_what_it_is_and_has_one_amplitude(name):
    entry = effect(name)
    assert entry.name == name and entry.doc and entry.location and entry.signature
    assert sum(p.neutral is not None for p in entry.parameters) == 1
    assert (entry.balance is None) != (entry.coefficients is None)
    for p in entry.parameters:
        assert p.doc and p.unit and p.bounds[0] <= p.default <= p.bounds[1]


@pytest.mark.parametrize("name, parameter", [(n, p.name) for n in NAMES for p in effect(n).parameters])
@pytest.mark.parametrize("end", [0, 1])
def test_parameter_outside_its_bounds_is_refused_with_name_and_range(name, parameter, end):
    entry = effect(name)
    bounds = next(p.bounds for p in entry.parameters if p.name == parameter)
    numbers = {entry.amplitude.name: entry.amplitude.bounds[1] / 2, parameter: bounds[end] + (end - 0.5) * bounds[1]}
    with pytest.raises(InputError) as error:
        entry(**numbers)
    assert f"effects.{name}.{parameter} = {numbers[parameter]}" in str(error.value)
    assert f"[{bounds[0]:g}, {bounds[1]:g}]" in str(error.value)
    assert entry(**{**numbers, parameter: bounds[end]}).effect is entry  # the bound itself is allowed


@pytest.mark.parametrize("value", [np.nan, np.array([1.0, np.nan])])
def test_parameter_that_is_not_a_number_is_refused(value):
    with pytest.raises(InputError, match="friction_force"):
        effect("spool_coulomb_friction")(friction_force=value)


@pytest.mark.parametrize("name", NAMES)
def test_missing_amplitude_is_refused_by_name(name):
    with pytest.raises(InputError, match=f"effects.{name} needs {effect(name).amplitude.name}"):
        effect(name)()


def test_unknown_parameter_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="unknown parameter of effect .* 'friction_forse'; did you mean 'friction_fo"):
        effect("spool_coulomb_friction")(friction_forse=1.0)


def test_unknown_effect_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="unknown effect 'magnet_demagnetisation'; did you mean 'magnet_demagnetiz"):
        effect("magnet_demagnetisation")


def test_effect_reads_parameters_with_units_in_the_order_of_its_declaration():
    active = effect("feedback_ball_backlash").read({"half_play": "5 um"}, "effects.feedback_ball_backlash")
    assert active.numbers == pytest.approx((5e-6,))
    friction = effect("spool_coulomb_friction").read({"presliding_distance": "1 um", "friction_force": "2 N"})
    assert friction.numbers == pytest.approx((2.0, 1e-6))


@pytest.mark.parametrize("table, text", [({"loss": "5 m"}, "loss.*dimension"), ({"los": "0.1"}, "did you mean 'loss'")])
def test_effect_refuses_wrong_text_with_its_place(table, text):
    with pytest.raises(InputError, match=f"here.*{text}"):
        effect("magnet_demagnetization").read(table, "here")


def test_effects_of_another_order_are_refused_by_the_model():
    a, b = some("magnet_demagnetization"), some("entrained_air")
    with pytest.raises(InputError, match="not those of the model"):
        Model(effects=(a.effect, b.effect)).flat_coefficients(C20, (b, a))


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
    assert rates(some(name), state=moving, memory=direction)[N] == 0.0  # and saturates there


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
    state = STATE._replace(spool_velocity=speed)
    change = rates(active, state=state, memory=1.0)[5] - rates(state=state)[5]
    assert -change * valve.spool_mass == pytest.approx(force, rel=1e-9)  # F [k + (1-k) exp(-(v/v_s)^2)]


def test_friction_acts_on_the_spool_alone():
    change = np.subtract(rates(some("spool_coulomb_friction"), memory=1.0)[:N], rates())
    assert np.flatnonzero(change).tolist() == [5]


# ---------------------------------------------------------------- clogging and demagnetization


def clogged(share, side=1.0):
    active = effect("fixed_orifice_clogging")(clogged_share=share, side=side)
    return active.effect.coefficients(C20, active.values, AT_20)


def null(c):
    return solve_rest(c, 0.0, 20.0, valve.supply_pressure, valve.return_pressure)


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


# ---------------------------------------------------------------- a user's own effect


def own(**terms):
    return Effect(
        name="own", doc="constant", location="anywhere", signature="none",
        parameters=(Parameter(name="size", unit="1", doc="size", default=0.0, bounds=(0.0, 1.0), neutral=0.0),),
        balance=lambda s, p, memory: (Ports(**{name: p.size * value for name, value in terms.items()}), ()),
    )  # fmt: skip


def change(**terms):
    return np.subtract(rates(own(**terms)(size=0.5)), rates())


def test_ports_add_to_the_balance_that_they_name():
    J, m, K_f, arm = valve.armature_inertia, valve.spool_mass, valve.feedback_rod_stiffness, 8.9e-3 + 13.3e-3
    assert change(armature_torque=2e-3) == pytest.approx([0, 1e-3 / J, 0, 0, 0, 0], rel=1e-9)
    assert change(spool_force=4.0) == pytest.approx([0, 0, 0, 0, 0, 2.0 / m], rel=1e-9)
    deflected = change(rod_deflection=2e-5)
    assert deflected == pytest.approx([0, -arm * K_f * 1e-5 / J, 0, 0, 0, -K_f * 1e-5 / m], rel=1e-9)


def test_current_port_adds_to_the_magnetising_current():
    more = np.subtract(rates(inputs=INPUTS._replace(command=INPUTS.command + 1e-4)), rates())
    assert change(coil_current=2e-4) == pytest.approx(more, rel=1e-9)


@pytest.mark.parametrize("side", [1, 2])
def test_compliance_port_adds_to_the_compliance_of_its_chamber(side):
    p = STATE[1 + side]
    clean = 1.0 / (C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * p)
    new = np.array(rates(own(**{f"compliance_{side}": 2 * clean})(size=0.5)))
    expected = np.array(rates())
    expected[1 + side] /= 2.0
    assert new == pytest.approx(expected, rel=1e-12)


def test_effects_add_up_and_keep_their_own_memories_and_parameters():
    friction, hysteresis = effect("spool_coulomb_friction")(friction_force=1.0), some("magnetic_hysteresis")
    air = some("entrained_air")
    model = Model(effects=(friction.effect, air.effect, hysteresis.effect))
    flat = model.flat_coefficients(C20, (friction, air, hysteresis))
    names = [channel.name for channel in model.state_channels[N:]]
    assert names == ["coulomb_friction_state", "magnetic_hysteresis_state"]
    assert dict(zip(model.coefficient_names, flat, strict=True))["entrained_air.air_fraction"] == air.numbers[0]
    both = model.rhs((*STATE, 0.5, -0.25), INPUTS, flat)
    assert both[1] == rates(hysteresis, memory=-0.25)[1]
    assert both[2:4] == rates(air)[2:4]
    assert both[5] == pytest.approx(rates(friction, memory=0.5)[5], rel=1e-12)
    assert both[6] == rates(friction, memory=0.5)[N]
    assert both[7] == rates(hysteresis, memory=-0.25)[N]


def test_memory_of_a_users_effect_is_a_state_of_the_model():
    lag = dataclasses.replace(
        own(),
        memory=(Channel("lag", "N", "", 1.0),),
        balance=lambda s, p, z: (Ports(spool_force=z[0]), (p.size - z[0],)),
    )
    with_lag = rates(lag(size=0.5), memory=0.2)
    assert with_lag[N] == pytest.approx(0.3, rel=1e-12)
    assert (with_lag[5] - rates()[5]) * valve.spool_mass == pytest.approx(0.2, rel=1e-9)
