"""Expressions rewritten as linear forms have the values that they had."""

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvesim.solver.linear_forms import ONE, Expressions
from valvesim.solver.straight_line import as_python

UNARY = {
    "square": lambda a: a * a, "twice": lambda a: a + a, "negative": lambda a: -a, "shift": lambda a: a - 3.0,
    "third": lambda a: a / 3.0, "inverse": lambda a: 1.0 / (2.0 + casadi.sin(a)), "size": casadi.fabs,
    "sign": casadi.sign, "root": lambda a: casadi.sqrt(1.0 + a * a),
    "fourth": lambda a: 1.0 / casadi.sqrt(casadi.sqrt(1.0 + a * a)),
}  # fmt: skip
BINARY = {
    "sum": lambda a, b: a + b, "difference": lambda a, b: a - b, "product": lambda a, b: a * b,
    "ratio": lambda a, b: a / (1.5 + b * b), "greater": casadi.fmax, "lesser": casadi.fmin,
    "choice": lambda a, b: casadi.if_else(a < b, a, b * 2.0),
}  # fmt: skip
STEPS = st.lists(
    st.tuples(st.sampled_from([*UNARY, *BINARY]), st.integers(0, 30), st.integers(0, 30)), min_size=1, max_size=25
)


def printed(symbols, outputs, constant=("c",)):
    """Two printed functions: what is computed ahead of c, and the rest."""
    forms, ahead = Expressions(), {}
    values = forms.of_symbols(symbols, outputs, constant=constant)
    lines = forms.lines({f"out[{k}]": value for k, value in enumerate(values)}, ahead)
    before = forms.lines({f"out[{k}]": {(node, ONE): number} for (node, number), k in ahead.items()})
    functions = as_python(["def ahead(c, out):", *before, "def rest(y, c, out):", *lines])
    return functions, len(ahead), lines


@settings(max_examples=200)
@given(STEPS, st.integers(0, 10**6))
def test_any_expression_keeps_its_value(steps, seed):
    y, c = casadi.SX.sym("y", 2), casadi.SX.sym("c", 2)
    known = [y[0], y[1], c[0], c[1], casadi.SX(0.7)]
    for name, i, j in steps:
        a, b = known[i % len(known)], known[j % len(known)]
        known.append(UNARY[name](a) if name in UNARY else BINARY[name](a, b))
    outputs = casadi.vertcat(*known[-3:])
    rng = np.random.default_rng(seed)
    at_y, at_c = rng.uniform(-2.0, 2.0, 2), rng.uniform(-2.0, 2.0, 2)
    expected = np.array(casadi.Function("f", [y, c], [casadi.densify(outputs)])(at_y, at_c)).ravel()
    functions, size, _ = printed({"y": y, "c": c}, casadi.densify(outputs))
    prepared, out = np.empty(size), np.empty(3)
    functions["ahead"](at_c, prepared)
    functions["rest"](at_y, prepared, out)
    assert out == pytest.approx(expected, rel=1e-9, abs=1e-9 * max(1.0, np.abs(expected).max()))


def test_what_hangs_on_coefficients_alone_is_computed_ahead():
    y, c = casadi.SX.sym("y", 2), casadi.SX.sym("c", 2)
    gap, other = (c[0] - c[1] * y[0]) / c[1], (c[0] + c[1] * y[0]) / c[1]
    functions, size, lines = printed({"y": y, "c": c}, casadi.vertcat(y[1] / (gap + other), casadi.sqrt(c[0]) * y[1]))
    assert size == 2 and not any("/" in line or "sqrt" in line or "y[0]" in line for line in lines)  # the angle is gone
    prepared, out = np.empty(2), np.empty(2)
    functions["ahead"](np.array([4.0, 3.0]), prepared)
    functions["rest"](np.array([0.5, 2.0]), prepared, out)
    assert out == pytest.approx([2.0 / (8.0 / 3.0), 4.0])


def test_equal_parts_are_one_part_and_roots_are_inverted_once():
    y = casadi.SX.sym("y", 2)
    size = y[0] * y[0] + 1.0
    outputs = casadi.vertcat(y[1] / casadi.sqrt(size), 1.0 / size, casadi.sqrt(y[1] * y[0]) + casadi.sqrt(y[0] * y[1]))
    _, _, lines = printed({"y": y, "c": casadi.SX.sym("c", 1)}, outputs)
    assert sum("/" in line for line in lines) == 1 and sum("sqrt" in line for line in lines) == 2


def test_a_division_by_nothing_is_infinite():
    y = casadi.SX.sym("y", 1)
    zero = casadi.SX(0.0)
    functions, _, _ = printed(
        {"y": y, "c": casadi.SX.sym("c", 1)}, casadi.densify(casadi.vertcat(y / (zero + y - y + 0.0 * y)))
    )
    out = np.empty(1)
    with np.errstate(all="ignore"):
        functions["rest"](np.array([2.0]), np.empty(1), out)
    assert not np.isfinite(out[0])
