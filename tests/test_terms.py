"""Free terms: hats that add up to one, and effects that add w(u) at one port, with and without memory."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from valvesim.channels import Inputs, State
from valvesim.errors import InputError
from valvesim.solver.codegen import source
from valvesim.valve.additive_term import (
    JUMP_SHARE,
    LAG,
    LAG_TIMES,
    NONE,
    PATH,
    PORTS,
    VARIABLES,
    TermHypothesis,
    jump_hypotheses,
    linear_b_splines,
    term_effect,
    term_hypotheses,
)
from valvesim.valve.effect import Effect, Ports, Situation
from valvesim.valve.equations import AT_20, Model
from valvesim.valve.laws import dahl_rate
from valvesim.valve.parameters import Valve

KNOTS = (-2.0, -0.5, 1.0, 3.0)
VALUES = (4.0, -1.0, 2.0, 0.5)
REST = dict.fromkeys(State._fields, 0.0)


def situation(current=0.0, **states):
    return Situation(State(**REST | states), Inputs(*5 * [0.0]), current, 0.0, 0.0, 0.0, 0.0, SimpleNamespace())


def scaled(variable, share=1.0):
    """Knots of a variable in its own size."""
    return tuple(share * VARIABLES[variable].scale * k for k in KNOTS)


def at_full(effect):
    return effect(**{effect.amplitude.name: 1.0})


def added(effect, where, memory=(), share=1.0):
    """(ports, memory rates) of a term at a share of itself."""
    return effect.balance(where, effect(**{effect.amplitude.name: share}).values, memory)


def where_it_is(variable, u):
    """A situation in which a variable has this value."""
    if variable == "current":
        return situation(current=u)
    if variable == "pilot_differential_pressure":
        return situation(nozzle_pressure_1=7e6 + u, nozzle_pressure_2=np.full(np.shape(u), 7e6))
    return situation(**{variable: u})


# ---------------------------------------------------------------- hats


def test_hats_add_up_to_one_and_draw_straight_lines():
    u = np.linspace(-4.0, 5.0, 301)
    basis = linear_b_splines(u, np.array(KNOTS))
    assert basis.shape == (301, 4)
    assert basis.sum(axis=1) == pytest.approx(1.0)
    assert basis @ VALUES == pytest.approx(np.interp(u, KNOTS, VALUES))
    assert linear_b_splines(np.array(KNOTS), np.array(KNOTS)) == pytest.approx(np.eye(4))


# ---------------------------------------------------------------- what a term adds


@pytest.mark.parametrize("variable", VARIABLES)
def test_a_term_is_straight_between_its_knots_and_constant_beyond(variable):
    knots = scaled(variable)
    effect = term_effect("spool_force", variable, knots, VALUES)
    u = np.linspace(1.5 * knots[0], 1.5 * knots[-1], 200)
    ports, rates = added(effect, where_it_is(variable, u))
    assert ports.spool_force == pytest.approx(np.interp(u, knots, VALUES), abs=1e-9)
    assert ports == Ports(spool_force=ports.spool_force) and rates == ()


def test_a_term_agrees_with_its_hats():
    knots = np.array(scaled("spool_position"))
    u = np.linspace(1.5 * knots[0], 1.5 * knots[-1], 50)
    ports, _ = added(term_effect("spool_force", "spool_position", knots, VALUES), situation(spool_position=u))
    assert ports.spool_force == pytest.approx(linear_b_splines(u, knots) @ VALUES)


@pytest.mark.parametrize("port", PORTS)
def test_a_term_acts_at_its_port_alone(port):
    ports, _ = added(term_effect(port, "current", scaled("current"), (7.0,) * 4), situation(current=1e-3))
    moved = {name: value for name, value in ports._asdict().items() if np.any(value)}
    two = {"chamber_flow_1": 7.0, "chamber_flow_2": -7.0}  # from one chamber into the other
    assert moved == pytest.approx(two if port == "pilot_flow" else {port: 7.0})


def test_a_term_scales_with_its_amplitude_and_vanishes_at_neutral():
    effect = term_effect("armature_torque", "armature_angle", scaled("armature_angle"), VALUES)
    here = situation(armature_angle=2.0 * VARIABLES["armature_angle"].scale)
    full = added(effect, here)[0].armature_torque
    assert full == pytest.approx(np.interp(2.0, KNOTS, VALUES))
    assert added(effect, here, share=0.25)[0].armature_torque == pytest.approx(0.25 * full)
    assert effect.amplitude.neutral == 0.0
    assert added(effect, here, share=0.0)[0].armature_torque == 0.0


def test_a_lagged_term_follows_its_variable_with_its_time_constant():
    tau, knots = 0.02, scaled("current")
    effect = term_effect("spool_force", "current", knots, VALUES, memory=LAG, time_constant=tau)
    (channel,) = effect.memory
    assert channel.unit == "A"
    u = 0.9 * knots[-1]

    def rate(t, z):
        return added(effect, situation(current=u), (z[0],))[1]

    time = np.linspace(0.0, 0.1, 20)
    lagged = solve_ivp(rate, (0.0, 0.1), [0.0], t_eval=time, rtol=1e-9, atol=1e-14).y[0]
    assert lagged == pytest.approx(u * (1.0 - np.exp(-time / tau)), rel=1e-6)
    ports, _ = added(effect, situation(current=u), (lagged,))
    assert ports.spool_force == pytest.approx(np.interp(lagged, knots, VALUES))


@pytest.mark.parametrize("variable, rate", [("spool_position", "spool_velocity"), ("armature_angle", "armature_rate")])
def test_a_term_of_a_path_turns_with_its_direction(variable, rate):
    width, knots = 0.1 * VARIABLES[variable].scale, scaled(variable)
    effect = term_effect("spool_force", variable, knots, VALUES, memory=PATH, width=width)
    assert len(effect.memory) == 1
    for direction, speed in ((1.0, 2.0), (-0.5, 2.0), (0.3, -2.0)):
        here = situation(**{variable: knots[0], rate: speed})
        ports, (turning,) = added(effect, here, (direction,))
        assert ports.spool_force == pytest.approx(direction * VALUES[0])
        assert turning == pytest.approx(dahl_rate(speed, direction, width))
    steady = added(effect, situation(**{variable: knots[0], rate: 2.0}), (1.0,))[1][0]
    assert steady == pytest.approx(0.0)


def test_a_term_runs_in_the_model_as_a_constant_force_would():
    force = 5.0
    term = term_effect("spool_force", "spool_position", scaled("spool_position"), (force,) * 4, name="my_term")
    model = Model(effects=(term,))
    assert isinstance(term, Effect) and term.name == "my_term"
    state, inputs = (1e-4, 0.1, 7.2e6, 7.0e6, 1e-4, 0.01), (1e-3, 0.0, 21e6, 0.5e6, 0.0)
    c = Valve().at(AT_20)
    with_term = model.rhs(state, inputs, model.flat_coefficients(c, [at_full(term)]))
    without = Model().rhs(state, inputs, Model().flat_coefficients(c, []))
    differs = [k for k in range(6) if with_term[k] != without[k]]
    assert differs == [5]
    assert with_term[5] - without[5] == pytest.approx(force / c.spool_mass)


def test_unknown_places_and_variables_are_refused_with_the_nearest():
    with pytest.raises(InputError, match="port.*spool_forc.*spool_force"):
        term_effect("spool_forc", "current", KNOTS, VALUES)
    with pytest.raises(InputError, match="variable.*spool_speed.*spool_"):
        term_effect("spool_force", "spool_speed", KNOTS, VALUES)


@pytest.mark.parametrize(
    "changed, says",
    [
        ({"memory": "lga"}, "memory.*lga.*lag"),
        ({"knots": (-2.0, 1.0, -0.5, 3.0)}, "rising"),
        ({"knots": (-2.0, 1.0, 1.0, 3.0)}, "rising"),
        ({"knots": KNOTS[:3]}, "3 knots.*4 values"),
        ({"knots": KNOTS[:1], "values": VALUES[:1]}, "at least two knots"),
        ({"values": (1.0, np.nan, 0.0, 0.0)}, "knots"),
        ({"memory": LAG}, "time_constant = 0.*lag"),
        ({"memory": LAG, "time_constant": -1e-3}, "time_constant = -0.001"),
        ({"memory": PATH, "variable": "spool_position"}, "width = 0.*path"),
        ({"time_constant": 1e-3}, "time_constant = 0.001.*none"),
        ({"width": 1e-3}, "width = 0.001.*none"),
        ({"memory": PATH, "width": 1e-3}, "current has no memory.*armature_angle, spool_position"),
    ],
)
def test_a_term_that_makes_no_sense_is_refused_with_the_reason(changed, says):
    given = {"port": "spool_force", "variable": "current", "knots": KNOTS, "values": VALUES} | changed
    with pytest.raises(InputError, match=f"(?s){says}"):
        term_effect(**given)


@pytest.mark.parametrize("memory", [{}, {"memory": LAG, "time_constant": 1e-3}, {"memory": PATH, "width": 1e-5}])
def test_terms_that_differ_in_figures_alone_are_one_compiled_model(memory):
    other = {name: figure if name == "memory" else 3.0 * figure for name, figure in memory.items()}
    one, same = (
        term_effect("spool_force", "spool_position", scaled("spool_position", share), VALUES[::way], **figures)
        for share, way, figures in ((1.0, 1, memory), (0.5, -1, other))
    )
    assert source(Model(effects=(one,))) == source(Model(effects=(same,)))
    elsewhere = term_effect("armature_torque", "spool_position", scaled("spool_position"), VALUES, **memory)
    assert source(Model(effects=(elsewhere,))) != source(Model(effects=(one,)))


# ---------------------------------------------------------------- families


def test_every_port_is_tried_with_every_variable():
    found = term_hypotheses()
    plain = [(f.port.name, f.variable.name) for f in found if f.memory == NONE]
    assert sorted(plain) == sorted((port, variable) for port in PORTS for variable in VARIABLES)
    assert {f.time_constant for f in found if f.memory == LAG} == set(LAG_TIMES)
    assert all(f.width > 0.0 for f in found if f.memory == PATH)
    assert {f.variable.name for f in found if f.memory == PATH} == {"spool_position", "armature_angle"}
    jumping = [(f.port.name, f.variable.name) for f in jump_hypotheses()]
    assert sorted(jumping) == sorted((port.name, name) for port in PORTS.values() for name in port.own)
    assert all(f.jumps for f in jump_hypotheses()) and not any(f.jumps for f in found)


@given(
    low=st.floats(-1e7, 1e7), span=st.floats(1e-9, 1e7), count=st.integers(2, 60),
    hypothesis=st.sampled_from((*term_hypotheses()[:1], *jump_hypotheses())),
)  # fmt: skip
def test_knots_rise_over_the_range_and_lie_close_beside_a_jump(low, span, count, hypothesis):
    high = low + max(span, 1e-6 * abs(low))
    knots = hypothesis.knots(low, high, count)
    assert len(knots) == count and knots[0] == low and knots[-1] == high and np.all(np.diff(knots) > 0.0)
    if hypothesis.jumps and low < 0.0 < high and count >= 4:
        below, above = knots[knots < 0.0][-1], knots[knots > 0.0][0]
        assert above - below == pytest.approx(JUMP_SHARE * (high - low))
    else:
        np.testing.assert_allclose(np.diff(knots), (high - low) / (count - 1), rtol=1e-6)


def test_labels_tell_families_apart_in_words():
    found = (*term_hypotheses(), *jump_hypotheses())
    labels = [hypothesis.label for hypothesis in found]
    assert len(set(labels)) == len(labels) == len(set(found))
    lagged = TermHypothesis(PORTS["spool_force"], VARIABLES["current"], LAG, time_constant=3e-3)
    assert lagged.label == "spool force as a function of current lagged by 3 ms"
    turned = TermHypothesis(PORTS["armature_torque"], VARIABLES["armature_angle"], PATH, width=1e-5)
    assert turned.label == "armature torque as a function of direction of armature angle"
    assert jump_hypotheses()[0].label == "armature torque as a function of current with a jump at zero"


def test_a_function_of_a_ports_own_variable_is_no_oddity_and_memory_is_one_more():
    force = PORTS["spool_force"]
    assert TermHypothesis(force, VARIABLES["spool_velocity"]).complexity == 0  # a damper
    assert TermHypothesis(force, VARIABLES["current"]).complexity == 1
    assert TermHypothesis(force, VARIABLES["spool_position"], jumps=True).complexity == 1  # a preload
    assert TermHypothesis(PORTS["armature_torque"], VARIABLES["pilot_differential_pressure"]).complexity == 0
    assert TermHypothesis(force, VARIABLES["current"], LAG, LAG_TIMES[0]).complexity == 2
    assert all(set(port.own) <= set(VARIABLES) and port.own for port in PORTS.values())
