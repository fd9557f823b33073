"""The printed linear solver against numpy, on random patterns and on the matrices of the valve itself."""

import numpy as np
import pytest
from elimination import full, solver
from hypothesis import given
from hypothesis import strategies as st

from valvesim import VoltageDrive, reference_valve
from valvesim.solver.codegen import derivatives
from valvesim.solver.elimination import print_elimination
from valvesim.solver.rodas5p import GAMMA
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.equations import Model

EFFECTS = ["magnetic_hysteresis", "eddy_current_lag", "spool_coulomb_friction", "spool_silting"]


@given(st.integers(1, 10), st.integers(0, 10**6), st.floats(0.0, 1.0))
def test_solves_as_numpy_does_along_any_pattern(n, seed, share):
    rng = np.random.default_rng(seed)
    pattern = rng.random((n, n)) < share
    J = np.where(pattern, rng.normal(size=(n, n)), 0.0)
    diagonal = rng.uniform(1.0, 2.0) + 2.0 * np.abs(J).sum(axis=1).max()
    factor, solve = solver(n, list(zip(*np.nonzero(pattern), strict=True)))
    b = rng.normal(size=(n, 2))
    expected = np.linalg.solve(diagonal * np.eye(n) - J, b)
    W, pivots = np.full((n, n), np.nan), np.empty(1)
    factor(J, diagonal, W, pivots)
    assert np.isfinite(pivots).all()
    for column, solution in zip(b.T, expected.T, strict=True):  # factors serve many right-hand sides
        x = column.copy()
        solve(W, x)
        assert x == pytest.approx(solution, rel=1e-10, abs=1e-12)


@given(st.integers(2, 10), st.integers(0, 10**6))
def test_nothing_outside_the_fill_is_touched(n, seed):
    pattern = np.random.default_rng(seed).random((n, n)) < 0.3
    factor, _ = solver(n, list(zip(*np.nonzero(pattern), strict=True)))
    W = np.full((n, n), np.nan)
    factor(pattern * 1.0, 5.0 * n, W, np.empty(1))
    reach = np.linalg.matrix_power(np.eye(n) + pattern, n) > 0  # fill needs a path
    assert np.isnan(W[~reach]).all()


def test_a_state_that_fills_nothing_goes_first():
    arrow = [(0, j) for j in range(6)] + [(j, 0) for j in range(6)]  # eliminated first, row 0 would fill all
    factor, solve = print_elimination(6, arrow)
    assert len([line for line in factor if " / " in line]) == 6 and len(solve) == 5 + 6
    assert len([line for line in factor if "ratio * " in line]) == 5
    assert next(line for line in factor if " / " in line) == "pivot = 1.0 / w1_1"


@pytest.mark.parametrize("J", [np.eye(2), np.eye(3) - np.ones((3, 3)), np.diag([1.0, np.nan]), np.diag([np.inf, 1.0])])
def test_a_singular_or_infinite_matrix_is_told(J):
    factor, solve = solver(len(J), full(len(J)))
    W, x, pivots = np.empty(J.shape), np.ones(len(J)), np.empty(1)
    with np.errstate(all="ignore"):
        factor(J, np.float64(1.0), W, pivots)
        solve(W, x)
    assert not (np.isfinite(pivots).all() and np.isfinite(x).all())


@pytest.mark.parametrize("h", [1e-8, 1e-5, 1e-3, 1.0])
@pytest.mark.parametrize("effects", [(), *((CATALOGUE[name],) for name in EFFECTS)])
@pytest.mark.parametrize("drive", [Model().drive, VoltageDrive()])
def test_the_valve_needs_no_exchange_of_rows(h, effects, drive):
    model = Model(drive, effects)
    scale = np.array([channel.scale for channel in model.state_channels])
    flat = model.flat_coefficients(
        reference_valve().at(PartTemperatures.uniform(20.0)),
        [effect(**{effect.amplitude.name: effect.amplitude.typical}) for effect in effects],
    )
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = scale * rng.uniform(-1.5, 1.5, len(scale))  # beyond the stops of spool and flapper too
        state[2:4] = rng.uniform(0.0, 21e6, 2)
        J = np.array(derivatives(model)(state, [5e-3, 0.0, 21e6, 5e5, 1e6], flat)[0]) / scale[:, None] * scale
        W = np.eye(len(scale)) / (GAMMA * h) - J
        factor, solve = solver(len(scale), list(zip(*np.nonzero(J), strict=True)))
        b = rng.normal(size=len(scale)) * np.abs(W).max(axis=1)
        factors, x = np.empty(W.shape), b.copy()
        factor(J, 1.0 / (GAMMA * h), factors, np.empty(1))
        solve(factors, x)
        residual = np.abs(W @ x - b) / (np.abs(W) @ np.abs(x) + np.abs(b))
        assert residual.max() < 1e-11  # backward error of rows, W. Oettli, W. Prager, Numer. Math. 6 (1964) 405
