"""A position loop around the valve, run by the valve's own solver."""

from dataclasses import replace

import numpy as np
import pytest

import valvesim as vs
from valvesim.channels import Inputs
from valvesim.characterisation.position_loop import (
    LoopCoefficients,
    LoopModel,
    PositionLoop,
    loop_channels,
    prepare_loop,
    scheduled_for,
    simulate_loop,
)
from valvesim.errors import InputError
from valvesim.studies.designs import Design
from valvesim.studies.local_sensitivity import local_sensitivity
from valvesim.studies.members import make_plan, run_block
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.variables import find_quantity, variable_of
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.equations import Model

BASE = vs.Scenario(duration=0.5, thermal=vs.Thermal(network=None), output_rate=2000.0)
GAIN = 0.045  # m^3/s/A, about the reference valve's at 20 °C


def loop_of(**changes):
    return PositionLoop(**(dict(scenario=BASE, schedule=((20.0, GAIN),)) | changes))


def test_the_equations_are_those_of_valve_cylinder_mass_and_controller():
    """By hand at one point, with the current beyond and within its limit."""
    c = vs.reference_valve().at(PartTemperatures.uniform(20.0))
    k = LoopCoefficients(1e-3, 1.2e-4, 60.0, 500.0, 100.0, 2e-3, 1e-11, 1.5, 10e-3)
    state = (1e-4, 0.0, 9e6, 8.5e6, 5e-5, 0.01, 4e-3, 0.03, 2e6)
    for reference, current in ((6e-3, 3e-3), (0.5, 10e-3), (-0.5, -10e-3)):
        rates, signals = LoopModel(Model()).evaluate(state, (reference, 0.0, 21e6, 0.5e6, 0.0), (*c, *k))
        valve, own = Model().evaluate(state[:6], Inputs(current, 0.0, 21e6, 0.5e6, 2e6), c)
        assert rates[:6] == pytest.approx(valve, rel=1e-12) and signals.current == pytest.approx(current)
        assert rates[6] == 0.03 and signals.position_error == reference - 4e-3
        assert rates[7] == pytest.approx((1e-3 * 2e6 - 500.0 * 0.03 - 100.0 * np.tanh(15.0)) / 60.0)
        beta = c.bulk_modulus_at_zero + c.bulk_modulus_slope * 10.5e6
        assert rates[8] == pytest.approx(4.0 * beta / 1.2e-4 * (own.load_flow - 1e-3 * 0.03 - 1e-11 * 2e6))


def test_a_schedule_holds_flow_gains_over_rising_temperatures():
    rows = scheduled_for(vs.reference_valve(), [20.0, 120.0])
    assert [t for t, _ in rows] == [20.0, 120.0] and rows[0][1] == pytest.approx(GAIN, rel=0.02)
    for schedule, message in (
        ((), "one row or more"),
        (((20.0, 1.0), (20.0, 2.0)), "rising"),
        (((20.0, -1.0),), "positive"),
    ):
        with pytest.raises(InputError, match=message):
            loop_of(schedule=schedule)
    with pytest.raises(InputError, match="mass"):
        loop_of(mass=0.0)


def test_an_effect_that_feels_the_rate_of_the_current_is_refused():
    hysteresis = vs.effect("magnetic_hysteresis")
    active = hysteresis(**{hysteresis.amplitude.name: hysteresis.amplitude.typical})
    with pytest.raises(InputError, match="position loop: an effect"):
        prepare_loop(loop_of(scenario=replace(BASE, effects=(active,))))


@pytest.mark.slow
def test_the_loop_is_that_of_python_control():
    """The same loop by control.interconnect and Radau (examples/position_loop.py), a second at 20 °C."""
    import control

    from valvesim.characterisation.control_block import nonlinear_system, rest_state

    loop = loop_of(scenario=replace(BASE, tolerance=1e-6), reference=vs.Sine(amplitude=10e-3, frequency=4.0))
    ours = simulate_loop(loop)
    oil, beta = loop.scenario.oil, loop.scenario.oil.bulk_modulus(20.0, 10.5e6)
    assert oil is vs.MIL_PRF_5606

    def rates(t, x, u, params):
        v, p = x[1], x[2] * 1e7
        friction = 500.0 * v + 100.0 * np.tanh(v / 2e-3)
        return np.array(
            [v * 100.0, (1e-3 * p - friction) / 60.0, 4.0 * beta / 1.2e-4 * (u[0] - 1e-3 * v - 1e-11 * p) / 1e7]
        )

    actuator = control.nlsys(
        rates, lambda t, x, u, params: np.array([x[0] / 100.0, x[2] * 1e7]), name="actuator", states=3,
        inputs=["load_flow"], outputs=["position", "load_pressure"],
    )  # fmt: skip
    gain = 40.0 * 1e-3 / GAIN
    law = control.nlsys(
        None, lambda t, x, u, params: np.clip(gain * (u[0] - u[1]), -10e-3, 10e-3), name="law",
        inputs=["reference", "position"], outputs=["current"],
    )  # fmt: skip
    whole = control.interconnect(
        [nonlinear_system(loop.scenario), actuator, law], inputs=["reference"], outputs=["position"], check_unused=False
    )  # fmt: skip
    t = np.linspace(0.0, 0.5, 1001)
    theirs = control.input_output_response(
        whole, t, 10e-3 * np.sin(8.0 * np.pi * t), [*rest_state(loop.scenario), 0.0, 0.0, 0.0],
        solve_ivp_method="Radau", solve_ivp_kwargs={"rtol": 1e-6, "atol": 1e-8},
    )  # fmt: skip
    chord = 10e-3 * (8.0 * np.pi) ** 2 * t[1] ** 2 / 8.0  # python-control draws straight lines between the samples
    assert np.abs(theirs.outputs.ravel() - ours["position"].values).max() < chord < 3e-5 * 10e-3


@pytest.mark.slow
def test_a_study_of_the_loop_varies_valve_and_actuator_and_runs_each_as_it_runs_alone():
    keys = ("loop.mass", "valve.null_gap", "valve.null_gap_difference", "loop.coulomb_friction")
    loop = loop_of(reference=vs.Step(after=5e-3, time=0.05))
    own = ParameterStudy(
        case=loop, variables=tuple(variable_of(find_quantity(loop, key)) for key in keys),
        design=Design(members=6, seed=2),
        keep=("run.position.mean", "run.position.rms", "run.velocity.highest", "run.load_flow.rms"),
    )  # fmt: skip
    plan, draws = make_plan(own), own.draws()
    got = run_block(own, plan, 0, draws)
    assert got.reasons == ("",) * 6 and np.all(np.ptp(got.figures, axis=0) > 0.0)
    for draw, row in zip(draws, got.figures, strict=True):
        alone = simulate_loop(own.member(draw))
        assert row[0] == pytest.approx(alone["position"].values.mean(), rel=1e-9)
        assert row[2] == pytest.approx(alone["velocity"].values.max(), rel=1e-9)
    local = local_sensitivity(own, plan)
    nominal = np.array([v.quantity.nominal for v in own.variables])
    for j in range(4):
        step = 0.02 * local.deviation[j]
        rows = np.vstack([nominal + step * (np.arange(4) == j), nominal - step * (np.arange(4) == j)])
        tight = replace(own, case=replace(loop, scenario=replace(BASE, tolerance=1e-9)))
        high, low = run_block(tight, plan, 0, rows).figures
        size = np.abs(local.slopes * local.deviation).max(axis=1) / local.deviation[j]
        assert np.all(np.abs(local.slopes[:, j] - (high - low) / (2.0 * step)) < 0.01 * size)
    assert {channel.name for channel in loop_channels(loop)} >= {"reference", "position", "position_error", "current"}
