"""What an effect is: neutral at its neutral value, refused outside its bounds, at its port, on its channel."""

import dataclasses

import numpy as np
import pytest

from valvesim.channels import SIGNAL_CHANNELS, STATE_CHANNELS, Channel, Inputs, State
from valvesim.errors import InputError
from valvesim.valve.catalogue import CATALOGUE, effect
from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.effect import CHANNEL, READABLE, Effect, Parameter, Ports, Reading
from valvesim.valve.equations import AT_20, CurrentDrive, Model, VoltageDrive
from valvesim.valve.parameters import reference_valve

valve = reference_valve()
C20 = valve.at(PartTemperatures.uniform(20.0))
NAMES = list(CATALOGUE)
STATE = State(1.2e-4, 0.7, 9.1e6, 8.3e6, 0.9e-4, 0.04)  # everything in motion, nothing on a stop
INPUTS = Inputs(3e-3, 0.5, 21e6, 0.5e6, 4e6)
N = len(STATE_CHANNELS)
WARM = PartTemperatures(  # everything at a temperature of its own, the spool ahead of its sleeve
    oil=60.0, pilot_metal=55.0, spool=50.0, sleeve=38.0, body=33.0, torque_motor=25.0, spring_tube=45.0,
    feedback_rod=58.0,
)  # fmt: skip
C_WARM = valve.at(WARM)
_SAMPLES = np.linspace(0.0, 0.1, 101)
READING = Reading(_SAMPLES, 3e-4 * np.sin(200.0 * _SAMPLES), 20.0 + 400.0 * _SAMPLES)


def rates(*active, state=STATE, inputs=INPUTS, memory=0.0, c=C20, drive=None):
    """Derivatives of the six states, then of the memories; every memory at `memory`, or each at its own."""
    model = Model(effects=tuple(a.effect for a in active), **({} if drive is None else {"drive": drive}))
    memories = memory if isinstance(memory, tuple) else (memory,) * (len(model.state_channels) - N)
    return model.rhs((*state, *memories), inputs, model.flat_coefficients(c, active))


def signals(*active, state=STATE, inputs=INPUTS, memory=0.0, c=C20):
    model = Model(effects=tuple(a.effect for a in active))
    memories = memory if isinstance(memory, tuple) else (memory,) * (len(model.state_channels) - N)
    return model.signals((*state, *memories), inputs, model.flat_coefficients(c, active))


def entry(name):
    """The catalogue's entry; one of a sensor on the spool position."""
    found = effect(name)
    return found.on("spool_position") if found.reading is not None else found


def some(name, share=0.3):
    """The effect with its amplitude at a share of its upper bound."""
    return at(name, share * entry(name).amplitude.bounds[1])


def at(name, amplitude, **shape):
    """The effect at an amplitude."""
    return entry(name)(**{entry(name).amplitude.name: amplitude}, **shape)


def typical(name, **shape):
    """The effect at the amplitude that is seen in service."""
    return at(name, entry(name).amplitude.typical, **shape)


def coefficients(active, c=None, parts=AT_20):
    """The coefficients as the effect changes them."""
    return active.effect.coefficients(C20 if c is None else c, active.values, parts)


def named(hook):
    """Names of the entries with that hook."""
    return [name for name in NAMES if getattr(CATALOGUE[name], hook) is not None]


# ---------------------------------------------------------------- every entry


@pytest.mark.parametrize("name", NAMES)
def test_every_entry_says_what_it_is_and_has_one_amplitude(name):
    e = entry(name)
    assert e.name == name and e.doc and e.location and e.signature
    assert sum(p.neutral is not None for p in e.parameters) == 1
    assert sum(hook is not None for hook in (e.temperatures, e.coefficients, e.balance, e.reading)) == 1
    for p in e.parameters:
        assert p.doc and p.unit and p.bounds[0] <= p.default <= p.bounds[1]
    assert e.amplitude.default == e.amplitude.neutral != e.amplitude.typical
    assert e.amplitude.bounds[0] <= e.amplitude.typical <= e.amplitude.bounds[1]
    assert all(p.typical is None for p in e.parameters if p is not e.amplitude)


def test_memories_and_parameters_have_names_of_their_own():
    memories = [m.name for e in CATALOGUE.values() for m in e.memory]
    assert len(set(memories) | set(State._fields)) == len(memories) + N
    for e in CATALOGUE.values():
        assert len({p.name for p in e.parameters}) == len(e.parameters)


@pytest.mark.parametrize("voltage", [False, True], ids=["current", "voltage"])
def test_the_rates_of_memories_alone_are_the_last_of_all(voltage):
    effects = [typical(name) for name in named("balance") if entry(name).memory]
    model = Model(VoltageDrive() if voltage else CurrentDrive(), tuple(a.effect for a in effects))
    count = sum(len(a.effect.memory) for a in effects)
    state = (*STATE, *([2e-3] if voltage else []), *np.linspace(-0.7, 1.0, count))
    flat = model.flat_coefficients(C20, effects)
    assert model.memory_rates(state, INPUTS, flat) == model.rhs(state, INPUTS, flat)[-count:]


@pytest.mark.parametrize("name", named("balance"))
@pytest.mark.parametrize("memory", [0.0, -0.7, 1.0])
@pytest.mark.parametrize("voltage", [False, True], ids=["current", "voltage"])
def test_neutral_amplitude_leaves_exactly_the_nominal_derivatives(name, memory, voltage):
    off = at(name, entry(name).amplitude.neutral)
    drive = VoltageDrive() if voltage else None
    state = (*STATE, 2e-3) if voltage else STATE
    nominal = rates(state=state, drive=drive)
    assert rates(off, state=state, memory=memory, drive=drive)[: len(nominal)] == nominal
    assert signals(off, memory=memory) == signals()


@pytest.mark.parametrize("name", named("coefficients"))
def test_neutral_amplitude_leaves_exactly_the_nominal_coefficients(name):
    assert coefficients(at(name, entry(name).amplitude.neutral), C_WARM, WARM) == C_WARM


@pytest.mark.parametrize("name", named("temperatures"))
def test_neutral_amplitude_leaves_exactly_the_nominal_temperatures(name):
    off = at(name, entry(name).amplitude.neutral)
    times = np.array([0.0, 1.0, 1.0, 3.0])
    parts = PartTemperatures.uniform(np.array([20.0, 30.0, 70.0, 71.0]))
    late = off.effect.temperatures(times, parts, off.values)
    assert all(np.array_equal(getattr(late, part), getattr(parts, part)) for part in PART_NAMES)


@pytest.mark.parametrize("name", named("reading"))
def test_neutral_amplitude_leaves_exactly_the_nominal_reading(name):
    off = at(name, entry(name).amplitude.neutral)
    assert np.array_equal(off.effect.reading(READING, off.values), READING.values)


@pytest.mark.parametrize("name", named("balance"))
def test_amplitude_off_neutral_changes_the_derivatives(name):
    # beyond the play, while it moves, under a memory, in a spool warmer than its sleeve
    state = STATE._replace(spool_position=4.1e-4)
    assert rates(typical(name), state=state, memory=0.5, c=C_WARM)[:N] != rates(state=state, c=C_WARM)


@pytest.mark.parametrize("name", named("coefficients"))
def test_amplitude_off_neutral_changes_a_derivative_or_a_signal(name):
    changed = coefficients(typical(name), C_WARM, WARM)
    new, old = (
        (rates(state=(*STATE, 2e-3), drive=VoltageDrive(), c=c), signals(c=c)) for c in (changed, C_WARM)
    )  # fmt: skip
    assert new != old


@pytest.mark.parametrize("name", named("reading"))
@pytest.mark.parametrize("channel", ["spool_position", "nozzle_pressure_1", "body_temperature"])
def test_amplitude_off_neutral_changes_the_reading_by_a_visible_share(name, channel):
    e = effect(name).on(channel)
    active = e(**{e.amplitude.name: e.amplitude.typical})
    values = READABLE[channel].scale * np.sin(300.0 * READING.time)
    off = np.abs(active.effect.reading(READING._replace(values=values), active.values) - values)
    assert 1e-3 < np.max(off) / READABLE[channel].scale < 0.5


@pytest.mark.parametrize("name", named("balance") + named("coefficients"))
def test_an_array_of_amplitudes_is_as_one_by_one(name):
    e, shape = entry(name), entry(name).amplitude
    amplitudes = np.array([shape.neutral, (shape.neutral + shape.typical) / 2, shape.typical])
    together = at(name, amplitudes)
    for k, amplitude in enumerate(amplitudes):
        if e.balance is not None:
            both = [rates(a, memory=0.5, c=C_WARM) for a in (together, at(name, amplitude))]
        else:
            both = [coefficients(a, C_WARM, WARM) for a in (together, at(name, amplitude))]
        for many, one in zip(*both, strict=True):
            assert np.broadcast_to(many, 3)[k] == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("name, parameter", [(n, p.name) for n in NAMES for p in effect(n).parameters])
@pytest.mark.parametrize("end", [0, 1])
def test_parameter_outside_its_bounds_is_refused_with_name_and_range(name, parameter, end):
    e = entry(name)
    bounds = next(p.bounds for p in e.parameters if p.name == parameter)
    numbers = {e.amplitude.name: e.amplitude.bounds[1] / 2, parameter: bounds[end] + (end - 0.5) * bounds[1]}
    with pytest.raises(InputError) as error:
        e(**numbers)
    assert f"effects.{name}.{parameter} = {numbers[parameter]}" in str(error.value)
    assert f"[{bounds[0]:g}, {bounds[1]:g}]" in str(error.value)
    assert e(**{**numbers, parameter: bounds[end]}).effect is e  # the bound itself is allowed


@pytest.mark.parametrize("value", [np.nan, np.array([1.0, np.nan])])
def test_parameter_that_is_not_a_number_is_refused(value):
    with pytest.raises(InputError, match="friction_force"):
        effect("spool_coulomb_friction")(friction_force=value)


@pytest.mark.parametrize("name", NAMES)
def test_missing_amplitude_is_refused_by_name(name):
    with pytest.raises(InputError, match=f"effects.{name} needs {effect(name).amplitude.name} "):
        entry(name)()


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


# ---------------------------------------------------------------- on a channel


SCALED = [channel.name for channel in READABLE.values()]


@pytest.mark.parametrize("channel", SCALED)
def test_a_sensor_effect_takes_the_unit_and_the_scale_of_its_channel(channel):
    target, free, bound = READABLE[channel], effect("sensor_bias"), effect("sensor_bias").on(channel)
    assert bound.channel == channel and bound.amplitude.neutral == 0.0
    assert bound.amplitude.unit == ("delta_degC" if target.unit == "degC" else target.unit)
    assert bound.amplitude.bounds == tuple(end * target.scale for end in free.amplitude.bounds)
    assert bound.amplitude.typical == free.amplitude.typical * target.scale
    assert CHANNEL not in effect("sensor_temperature_drift").on(channel).amplitude.unit


def test_a_sensor_figure_without_the_channels_unit_stays_as_it_is():
    assert effect("sensor_lag").on("load_flow").parameters == effect("sensor_lag").parameters


@pytest.mark.parametrize(
    "channel, table, amplitude",
    [
        ("spool_position", {"bias": "5 um"}, 5e-6),
        ("body_temperature", {"bias": "2 K"}, 2.0),
        ("body_temperature", {"bias": "2 degC"}, 2.0),
        ("load_flow", {"bias": "-0.6 L/min"}, -1e-5),
    ],
)
def test_a_sensor_effect_is_read_in_any_unit_of_its_channel(channel, table, amplitude):
    active = effect("sensor_bias").read({"channel": channel, **table}, "here")
    assert active.effect.channel == channel and active.numbers == pytest.approx((amplitude,))


def test_a_drift_with_temperature_is_read_per_kelvin():
    active = effect("sensor_temperature_drift").read({"channel": "nozzle_pressure_1", "drift": "0.1 bar/K"})
    assert active.numbers == pytest.approx((1e4,))


@pytest.mark.parametrize("call", [lambda e: e(bias=1e-5), lambda e: e.read({"bias": "5 um"})])
def test_a_sensor_effect_without_a_channel_is_refused(call):
    with pytest.raises(InputError, match=r"effects\.sensor_bias needs a channel, such as spool_position"):
        call(effect("sensor_bias"))


def test_an_unknown_channel_is_refused_with_the_nearest():
    with pytest.raises(InputError, match=r"effects\.sensor_lag\.channel: unknown channel 'spol_pos.*'spool_position'"):
        effect("sensor_lag").on("spol_position")


def test_an_effect_that_is_no_sensors_takes_no_channel():
    with pytest.raises(InputError, match="effect entrained_air does not act on a sensor, so it takes no channel"):
        effect("entrained_air").on("spool_position")
    with pytest.raises(InputError, match="unknown parameter of effect entrained_air 'channel'"):
        effect("entrained_air").read({"air_fraction": "0.01", "channel": "spool_position"})


def test_a_sensor_bias_beyond_the_scale_of_its_channel_is_refused():
    with pytest.raises(InputError, match=r"effects\.sensor_bias\.bias = 0\.001 m is outside \[-0\.0004, 0\.0004\] m"):
        effect("sensor_bias").on("spool_position")(bias=1e-3)


def test_every_state_and_signal_can_be_read_by_a_sensor():
    assert {c.name for c in (*STATE_CHANNELS, *SIGNAL_CHANNELS)} < set(READABLE)


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


@pytest.mark.parametrize("pressure", ["supply_pressure", "return_pressure"])
def test_pressure_ports_add_to_the_pressure_in_every_equation(pressure):
    size = getattr(INPUTS, pressure)
    more = INPUTS._replace(**{pressure: 1.5 * size})
    assert rates(own(**{pressure: size})(size=0.5)) == rates(inputs=more)
    assert signals(own(**{pressure: size})(size=0.5)) == signals(inputs=more)


@pytest.mark.parametrize("side", [1, 2])
def test_chamber_flow_port_fills_its_chamber(side):
    compliance = 1.0 / (C20.bulk_modulus_at_zero + C20.bulk_modulus_slope * STATE[1 + side])
    expected = np.zeros(N)
    expected[1 + side] = 1e-6 / (valve.chamber_volume * compliance)
    assert change(**{f"chamber_flow_{side}": 2e-6}) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("flow", ["load_flow", "internal_leakage"])
def test_flow_ports_are_added_to_the_signal_and_move_nothing(flow):
    active = own(**{flow: 2e-6})(size=0.5)
    assert rates(active) == rates()
    assert signals(active) == signals()._replace(**{flow: getattr(signals(), flow) + 1e-6})


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


def test_an_effect_sees_the_flows_at_the_pressures_of_the_inputs():
    seen = []

    def look(situation, p, memory):
        seen.append(situation)
        return Ports(supply_pressure=-1e6, return_pressure=1e5), ()

    spy = dataclasses.replace(own(), balance=look)
    signals(spy(size=0.5))
    undisturbed = signals()
    assert seen[0].load_flow == undisturbed.load_flow
    assert (seen[0].nozzle_flow_1, seen[0].nozzle_flow_2) == (undisturbed.nozzle_flow_1, undisturbed.nozzle_flow_2)
