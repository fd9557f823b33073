"""The flow-coefficient law over the Reynolds number of the moment: its limits, its neighbours, and what rests on it."""

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import InputError, ValidityWarning
from valvesim.simulation.scenario_toml import load_scenario
from valvesim.solver import codegen
from valvesim.valve import flow_coefficients as flow
from valvesim.valve.equations import (
    NOMINAL,
    effective_flow_coefficient,
    fixed_orifice_flow,
    flapper_torques,
    nozzle_flow,
    nozzle_laminar_root,
)
from valvesim.valve.equilibrium import static_solution
from valvesim.valve.fluid import MIL_PRF_5606
from valvesim.valve.laws import laminar_root, orifice_flow
from valvesim.valve.parameters import PartTemperatures, Valve

LAW = flow.flow_coefficients_reynolds_number
VALVE = Valve(flow_coefficients=LAW)
WIDTH = 1e3


def at(temperature, valve=VALVE, **options):
    return valve.at(PartTemperatures.uniform(temperature), **options)


# ---------------------------------------------------------------- the law itself


@given(st.floats(1e-6, 1e8), st.floats(1.0001, 10.0), st.floats(1.0, 1e3), st.floats(0.3, 1.0))
def test_coefficient_rises_with_the_flow_number_from_creeping_to_its_limit(number, more, loss, limit):
    low, high = (flow.smooth_flow_coefficient(n, loss, limit) for n in (number, number * more))
    assert 0.0 < low < high * (1 + 1e-15) and high <= limit
    assert np.log(high / low) <= np.log(more) * (1 + 1e-9) + 1e-12  # d ln C/d ln lambda <= 1
    assert low <= number / loss * (1 + 1e-12)


def test_coefficient_is_the_closed_form_of_oils_md():
    for number, loss, limit in ((78.0, 133.7, 0.814), (1180.0, 133.7, 0.814), (413.0, 40.7, 0.656)):
        k2, ratio = 1 / limit**2, loss / number
        closed = (np.sqrt(ratio**2 + 4 * k2) - ratio) / (2 * k2)
        assert flow.smooth_flow_coefficient(number, loss, limit) == pytest.approx(closed, rel=1e-12)
        reynolds = closed * number  # K = k1/Re + k2, K = 1/C^2
        assert 1 / closed**2 == pytest.approx(loss / reynolds + k2, rel=1e-12)


def test_creeping_flow_through_a_hole_is_that_of_sampson_and_poiseuille():
    # Q = a^3 dp/(3 mu) of a thin hole; with a wall the two resistances add: 128 mu L/(pi d^4)
    d, mu, rho, dp = 0.2e-3, 1.0, 850.0, 10.0
    for length in (0.0, 0.3e-3):
        loss = (12 * np.pi + 64 * length / d) / d
        root = laminar_root(0.8, loss, mu, rho)
        q = orifice_flow(np.pi * d**2 / 4 * 0.8, dp, rho, 1e-3, root)
        resistance = 3 * mu / (d / 2) ** 3 + 128 * mu * length / (np.pi * d**4)
        assert q == pytest.approx(dp / resistance, rel=1e-3)


def test_the_flow_has_a_finite_slope_at_zero_pressure_drop_and_is_odd():
    root = laminar_root(0.8, 6e5, 0.3, 850.0)
    q = [orifice_flow(1e-8, dp, 850.0, 1.0, root) for dp in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    assert q[2] == 0.0 and q[3] == -q[1] and q[4] == pytest.approx(2 * q[3], rel=1e-2)


@given(st.floats(1e-12, 1e-6), st.floats(-3e7, 3e7), st.floats(600.0, 1200.0))
def test_without_laminar_loss_the_flow_is_the_turbulent_one_to_the_bit(area, drop, density):
    old = area * np.sqrt(2.0 / density) * (drop / np.sqrt(np.sqrt(drop * drop + WIDTH * WIDTH)))
    assert orifice_flow(area, drop, density, WIDTH) == orifice_flow(area, drop, density, WIDTH, 0.0) == old
    assert effective_flow_coefficient(0.66, drop, WIDTH, 0.0) == 0.66


def test_it_is_near_lichtarowicz_over_his_range():
    # oils.md 2.2: +1/+4/+2/0 % at L/d 2, -4/+5/+3/0 at 4, -14/+1/+5/+1 at 10
    numbers = np.array([100.0, 300.0, 1000.0, 3000.0])
    expected = {2.0: (1, 4, 2, 0), 4.0: (-4, 5, 3, 0), 10.0: (-14, 1, 5, 1)}
    for slenderness, errors in expected.items():
        pilot = LAW.pilot(slenderness, 1.0)
        own = flow.smooth_flow_coefficient(numbers, pilot.orifice_loss + pilot.orifice_wall_loss, pilot.orifice)
        assert 100 * (own / flow.lichtarowicz(numbers, slenderness) - 1) == pytest.approx(errors, abs=0.55)


def test_the_law_of_lichtarowicz_reads_the_flow_number():
    # oils.md 2.1: at a true Reynolds number of 100 and L/d 2 it gives 0.545; the number put wrongly reads 0.428
    assert flow.lichtarowicz(100.0, 2.0) == pytest.approx(0.428, abs=0.001)
    assert flow.lichtarowicz(100.0 / 0.545, 2.0) == pytest.approx(0.545, abs=0.001)


def test_it_meets_the_nozzle_of_table_3_but_for_the_row_without_weight():
    numbers = flow.table_3_reynolds()[0]
    error = flow.smooth_flow_coefficient(numbers, LAW.nozzle_loss, LAW.nozzle_limit) / flow.TABLE_3[:, 1] - 1.0
    assert np.all(np.abs(error[1:]) < 0.07) and error[0] > 2.0
    slope = np.log(flow.TABLE_3[1, 1] / flow.TABLE_3[0, 1]) / np.log(numbers[1] / numbers[0])
    assert slope == pytest.approx(3.9, abs=0.05)  # oils.md 2.3: no smooth law has more than 1


@pytest.mark.parametrize("wrong", [{"nozzle_limit": 0.0}, {"orifice_limit": 1.2}, {"nozzle_loss": -1.0}])
def test_figures_that_make_no_law_are_refused(wrong):
    with pytest.raises(InputError, match="Reynolds number law"):
        flow.ReynoldsNumberLaw(**wrong)


# ---------------------------------------------------------------- in the equations


@pytest.mark.parametrize("temperature", [-54.0, -40.0, 20.0, 200.0])
def test_the_equations_have_the_flow_number_of_the_moment(temperature):
    c = at(temperature)
    nu, d, gap, drop = c.dynamic_viscosity / c.density, c.fixed_orifice_diameter_1, 20e-6, 4e6
    speed = np.sqrt(2 * drop / c.density)
    loss = 12 * np.pi + 64 * VALVE.fixed_orifice_length / d
    C = flow.smooth_flow_coefficient(d * speed / nu, loss, flow.lichtarowicz_limit(1.5))
    assert fixed_orifice_flow(d, drop, c) == pytest.approx(C * np.pi * d**2 / 4 * speed, rel=1e-6)
    C = flow.smooth_flow_coefficient(2 * gap * speed / nu, 40.7, 0.656)
    q = nozzle_flow(c.nozzle_diameter_1, gap, drop, c)
    assert q == pytest.approx(C * np.pi * c.nozzle_diameter_1 * gap * speed, rel=1e-6)


@given(st.floats(0.0, 80e-6), st.floats(1e-9, 5e-6), st.floats(-54.0, 270.0), st.floats(1e2, 3e7))
def test_nozzle_flow_rises_with_the_gap_from_none(gap, more, temperature, drop):
    c = at(temperature)
    assert nozzle_flow(c.nozzle_diameter_1, 0.0, drop, c) == 0.0
    assert 0.0 <= nozzle_flow(c.nozzle_diameter_1, gap, drop, c) < nozzle_flow(c.nozzle_diameter_1, gap + more, drop, c)


def test_jets_push_with_the_coefficients_of_their_own_gaps():
    c, theta, supply = at(-40.0), 1e-3, 21e6
    _, torque = flapper_torques(theta, 1e7, 1e7, supply, 0.5e6, c)
    forces = []
    for gap in (c.null_gap_1 - c.nozzle_arm * theta, c.null_gap_2 + c.nozzle_arm * theta):
        C = effective_flow_coefficient(
            c.nozzle_flow_coefficient, supply / 2, c.transition_pressure, nozzle_laminar_root(gap, c)
        )
        assert C < 0.9 * c.nozzle_flow_coefficient
        forces.append(4 * np.pi * C**2 * gap**2 * supply / 2)
    assert torque == pytest.approx(c.nozzle_arm * (forces[1] - forces[0]), rel=1e-9)


def test_jets_of_one_coefficient_are_the_term_of_the_paper():
    c, theta = at(20.0, Valve(null_gap_difference=2e-6)), 1.3e-3
    _, torque = flapper_torques(theta, 1e7, 9e6, 21e6, 0.5e6, c)
    both = c.null_gap_1 + c.null_gap_2
    expected = 2 * np.pi * c.nozzle_arm * c.nozzle_flow_coefficient**2 * both * 21e6
    expected *= 2 * c.nozzle_arm * theta + c.null_gap_2 - c.null_gap_1
    assert torque == pytest.approx(expected, rel=1e-12)


def test_without_the_route_the_pilot_stays_at_20_degrees():
    held, cold = at(-40.0, routes=()), at(20.0)
    for gap in (10e-6, 35e-6):
        assert nozzle_laminar_root(gap, held) == pytest.approx(nozzle_laminar_root(gap, cold), rel=1e-12)
    assert held.dynamic_viscosity > 5 * cold.dynamic_viscosity  # the leakage's follows its oil


def test_code_without_the_laminar_terms_is_the_code_of_a_law_of_temperature():
    flat = np.array([[float(v) for v in NOMINAL.flat_coefficients(at(20.0, Valve()), ())]])
    absent = codegen.absent_coefficients(NOMINAL, flat)
    assert absent == frozenset(codegen.OPTIONAL)
    short, long = codegen.source(NOMINAL, absent), codegen.source(NOMINAL)
    assert len(short.splitlines()) < 0.92 * len(long.splitlines())
    cold = np.array([[float(v) for v in NOMINAL.flat_coefficients(at(20.0), ())]])
    assert codegen.absent_coefficients(NOMINAL, np.concatenate([flat, cold])) == frozenset()
    y, u, out = np.array([0.1, 0.2, 0.5, 0.6, 0.1, 0.0]), np.array([1e-3, 0.0, 21e6, 0.5e6, 0.0]), np.empty((2, 6))
    for k, machine in enumerate((codegen.compile_model(NOMINAL), codegen.compile_model(NOMINAL, absent))):
        machine.derivative(y, u, flat[0], out[k])
    assert out[0] == pytest.approx(out[1], rel=1e-13)


# ---------------------------------------------------------------- the valve in the cold


def test_null_pressure_falls_smoothly_with_the_cold_where_eq_19_swings():
    T = np.linspace(-54.0, 40.0, 48)
    steps = {}
    for name in ("yan_2019", "reynolds_number"):
        valve = Valve(flow_coefficients=flow.FLOW_LAWS[name])
        steps[name] = np.diff(static_solution(valve, current=0.0, temperature=T).nozzle_pressure_1) / np.diff(T)
    assert np.max(np.abs(steps["yan_2019"])) > 5e5  # Pa/K
    assert np.all(steps["reynolds_number"] > 0.0) and np.max(steps["reynolds_number"]) < 0.8e5


def test_eq_19_in_the_cold_names_the_other_law_once():
    with pytest.warns(ValidityWarning, match=r"-30 °C is below -20 °C.*valve\.flow_law = 'reynolds_number'") as caught:
        at(-30.0, Valve())
        at(-45.0, Valve())
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        at(-20.0, Valve())
        at(-54.0)


def test_the_law_has_no_polynomial_and_is_what_cold_start_runs(pytestconfig):
    assert static_solution(VALVE, current=1e-3).real_roots is None
    scenario = load_scenario(pytestconfig.rootpath / "scenarios" / "cold_start.toml")
    assert scenario.valve == VALVE and scenario.oil == MIL_PRF_5606


def test_the_law_takes_a_batch_of_orifices():
    lengths = np.array([0.2e-3, 0.4e-3])
    batch = at(-40.0, dataclasses.replace(VALVE, fixed_orifice_length=lengths))
    q = fixed_orifice_flow(batch.fixed_orifice_diameter_1, 1e7, batch)
    assert q.shape == (2,) and q[0] > q[1] > 0.0
