"""The formulas over temperature serve traced symbols: what `export` prints as C is what the package computes."""

import warnings

import casadi
import numpy as np
import pytest

import valvesim as vs
from valvesim.valve.coefficients import PART_NAMES, coefficient_formulas
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.laws import straight_segments
from valvesim.valve.thermal_network import THERMAL_NODES


def traced(formula, size):
    casadi.GlobalOptions.setNumpyMode(-1)
    symbol = casadi.SX.sym("s", size)
    return casadi.Function("f", [symbol], [casadi.vertcat(*formula([symbol[k] for k in range(size)]))])


@pytest.mark.parametrize("law", FLOW_LAWS)
def test_coefficients_are_the_same_of_symbols_and_numbers(law):
    valve = vs.Valve(flow_coefficients=FLOW_LAWS[law], null_gap_difference=1e-6)
    temperatures = np.random.default_rng(1).uniform(-30.0, 200.0, len(PART_NAMES))
    for oil in vs.OILS.values():
        for routes in (frozenset(vs.ROUTES), frozenset(("mmf", "rod"))):
            f = traced(
                lambda T, routes=routes, oil=oil: coefficient_formulas(
                    valve, vs.PartTemperatures(**dict(zip(PART_NAMES, T, strict=True))), oil, routes
                ),
                len(PART_NAMES),
            )
            parts = vs.PartTemperatures(**dict(zip(PART_NAMES, temperatures, strict=True)))
            with warnings.catch_warnings(action="ignore", category=vs.ValidityWarning):
                numbers = coefficient_formulas(valve, parts, oil, routes)
            np.testing.assert_allclose(np.array(f(temperatures)).ravel(), np.array(numbers, dtype=float), rtol=1e-12)


def test_the_thermal_network_has_the_same_rates_as_its_matrices():
    network = vs.ThermalNetwork()
    M, N = network.matrices()
    T = np.random.default_rng(2).uniform(0.0, 100.0, len(THERMAL_NODES) + 2)
    rates = network.rates(dict(zip((*THERMAL_NODES, "oil", "ambient"), T, strict=True)))
    np.testing.assert_allclose(list(rates.values()), M @ T[:-2] + N @ T[-2:], rtol=1e-12)


def test_straight_segments_are_interpolation_and_go_on_beyond_both_ends():
    at, values = np.array([-1.0, 0.5, 2.0, 5.0]), np.array([3.0, -1.0, 4.0, 4.5])
    inside = np.linspace(-1.0, 5.0, 41)
    np.testing.assert_allclose(straight_segments(inside, at, values), np.interp(inside, at, values), atol=1e-14)
    assert straight_segments(-2.0, at, values) == pytest.approx(3.0 + 4.0 / 1.5)
    assert straight_segments(8.0, at, values) == pytest.approx(5.0)
