"""Values and derivatives along a course: those of the equations run by numpy, and CasADi's own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_compiled import CASES, valve

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS
from valvesim.characterisation.linearisation import signal_derivatives
from valvesim.identification.predictor import MEASURED_SIGNALS
from valvesim.solver.codegen import derivatives
from valvesim.solver.partial_derivatives import CoefficientCourse, compile_derivatives
from valvesim.valve.coefficients import PartTemperatures

INPUTS_AT = np.array([3e-3, 0.0, 21e6, 0.5e6, 2e6])
NAMES = [channel.name for channel in SIGNAL_CHANNELS]


def random_course(model, active, seed, points=13, knots=3):
    """States, inputs and coefficients along a course that goes nowhere in particular."""
    rng = np.random.default_rng(seed)
    scale = np.array([channel.scale for channel in model.state_channels])
    x = 0.3 * scale * rng.normal(size=(points, len(scale)))
    x[:, 2:4] = 10.5e6 * (1.0 + 0.1 * rng.normal(size=(points, 2)))
    u = INPUTS_AT * (1.0 + 0.1 * rng.normal(size=(points, len(INPUT_CHANNELS))))
    c = valve.at(PartTemperatures.uniform(np.linspace(20.0, 80.0, knots)))
    flat = np.stack(np.broadcast_arrays(*model.flat_coefficients(c, active)), axis=-1).astype(float)
    place = np.sort(rng.integers(0, knots - 1, points)) if knots > 1 else np.zeros(points, dtype=np.int64)
    share = rng.uniform(0.0, 1.0, points) if knots > 1 else np.zeros(points)
    return x, u, CoefficientCourse(flat, place, share)


def along(course):
    """The coefficients (n, n_c) at the points of a course."""
    knots = np.vstack([course.knots, course.knots[-1:]])
    return knots[course.place] + course.share[:, None] * (knots[course.place + 1] - knots[course.place])


@pytest.mark.parametrize("case", CASES)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_values_are_those_of_the_equations(case, seed):
    model, active = CASES[case]
    x, u, course = random_course(model, active, seed)
    found = compile_derivatives(model, MEASURED_SIGNALS).values(x, u, course)
    rates, signals = model.evaluate(tuple(x.T), tuple(u.T), tuple(along(course).T))
    for k, expected in enumerate([*rates, *(getattr(signals, name) for name in MEASURED_SIGNALS)]):
        assert found[k] == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.max(np.abs(expected))), k


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("knots", [1, 3])
def test_derivatives_are_those_of_casadi(case, knots):
    model, active = CASES[case]
    x, u, course = random_course(model, active, 5, knots=knots)
    compiled = compile_derivatives(model, MEASURED_SIGNALS)
    found, c = compiled.derivatives(x, u, course), along(course)
    rows = [NAMES.index(name) for name in MEASURED_SIGNALS]
    for k in range(len(x)):
        of_rates = np.hstack([np.array(block) for block in derivatives(model)(x[k], u[k], c[k])])
        of_signals = np.hstack([np.array(block) for block in signal_derivatives(model)(x[k], u[k], c[k])[1:]])[rows]
        expected, own = np.vstack([of_rates, of_signals]), np.zeros((len(of_rates) + len(rows), of_rates.shape[1]))
        own[compiled.targets, compiled.arguments] = found[:, k]
        size = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(np.abs(own - expected) <= 1e-8 * np.abs(expected) + 1e-10 * size), k
    of_states = found[compiled.entries(compiled.states, compiled.states)]
    assert compiled.jacobian(x, u, course) == pytest.approx(of_states, rel=1e-9, abs=1e-12 * np.abs(of_states).max())


def test_entries_are_found_by_target_and_argument():
    compiled = compile_derivatives(CASES["nominal"][0], MEASURED_SIGNALS)
    own = compiled.entries(compiled.states, compiled.states)
    assert len(own) and (compiled.targets[own] < 6).all() and (compiled.arguments[own] < 6).all()
    pairs = list(zip(compiled.targets[own], compiled.arguments[own], strict=True))
    assert (4, 5) in pairs and len(set(pairs)) == len(pairs)  # the spool's position changes by its velocity
    names = CASES["nominal"][0].coefficient_names
    by = compiled.arguments[compiled.entries(slice(5, 6), compiled.coefficients)] - compiled.coefficients.start
    assert "spool_mass" in [names[k] for k in by] and "armature_inertia" not in [names[k] for k in by]
