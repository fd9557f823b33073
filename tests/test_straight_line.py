"""Printed lines as machine code, for one lane and for many, against the same lines run by Python."""

import gc

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from valvesim.solver import machine_code
from valvesim.solver.straight_line import FUNCTIONS, as_python

LANES = 8
ONE = ("sqrt", "exp", "log", "tanh", "sin", "cos", "fabs", "sign", "logical_not", "inverse_fourth_root")
TWO = ("maximum", "minimum", "less", "less_equal", "logical_and", "logical_or", "where_true", "power")
LINES = [
    "def functions(a, b, out):",
    *(f"    out[{k}, 0] = {name}(a[0])" for k, name in enumerate(ONE)),
    *(f"    out[{k}, 1] = {name}(a[0], b[0])" for k, name in enumerate(TWO)),
    "def inner(a, u, out):",
    "    out[0] = a[0] * u[1]",
    "    out[1] = out[0] - a[1]",
    "def outer(a, h, u, out, room):",
    "    half = -0.5 * h + 1.0 / u[0]",
    "    room[0, 0] = a[0] / half",
    "    room[0, 1] = room[0, 0] - -2.0",
    "    inner(room[0], u, out)",
    "    out[2] = out[0] + room[0, 1]",
]
COLUMNS = {"out": 2, "room": 2}


def compiled(lines, lanes):
    printed = machine_code.with_layout(lines, lanes=lanes, columns=COLUMNS, shared=("u",), numbers=("h",))
    code = machine_code.load_object_code(printed, machine_code.object_code(printed))
    call = machine_code.caller()

    @njit
    def run(functions, outer, a, b, h, u, table, out, room):
        call(functions, a, b, table)
        call(outer, a, h, u, out, room)

    return code.bound(run, ["functions", "outer"])


def arguments(lanes):
    rng = np.random.default_rng(3)
    a, b = rng.uniform(0.2, 3.0, (2, lanes)), rng.uniform(0.2, 3.0, (1, lanes))
    b[0, -1:], b[0, -2:-1] = a[0, -1], 0.0
    rows = max(len(ONE), len(TWO))
    return a, b, 0.7, np.array([4.0, 3.0]), np.zeros((rows, 2, lanes)), np.zeros((3, lanes)), np.zeros((1, 2, lanes))


@pytest.mark.parametrize("lanes", [1, LANES])
def test_compiled_lines_are_the_lines(lanes):
    assert {*ONE, *TWO} == set(FUNCTIONS)
    run, plain = compiled(LINES, lanes), as_python(LINES)
    a, b, h, u, table, out, room = arguments(lanes)
    run(a, b, h, u, table, out, room)
    expected = np.zeros_like(table)
    plain["functions"](a, b, expected)
    assert table == pytest.approx(expected, rel=1e-14, abs=1e-300)
    first = a[0] / (-0.5 * h + 1.0 / u[0])
    other = first * u[1]
    assert room[0] == pytest.approx(np.array([first, first + 2.0]), rel=1e-14)
    assert out == pytest.approx(np.array([other, other - first - 2.0, other + first + 2.0]), rel=1e-13)


def test_inverse_fourth_root_is_exact_over_all_sizes():
    lines = [
        "def functions(a, b, out):",
        "    out[0, 0] = inverse_fourth_root(a[0])",
        *LINES[LINES.index("def inner(a, u, out):") :],
    ]
    run, (_, b, *rest) = compiled(lines, LANES), arguments(LANES)
    for s in np.exp(np.random.default_rng(1).uniform(np.log(1e-290), np.log(1e290), (200, 1, LANES))):
        run(np.vstack([s, s]), b, *rest)
        assert rest[2][0, 0] == pytest.approx(s[0] ** -0.25, rel=4e-16)


def test_a_number_that_is_none_stays_so():
    run, (a, b, *rest) = compiled(LINES, LANES), arguments(LANES)
    a[0, 3] = np.nan
    run(a, b, *rest)
    roots = rest[2][[ONE.index("sqrt"), ONE.index("inverse_fourth_root")], 0]
    assert np.isnan(roots[:, 3]).all() and np.isfinite(np.delete(roots, 3, axis=1)).all()


def test_arrays_must_be_contiguous():
    run, (_, *rest) = compiled(LINES, 1), arguments(1)
    with pytest.raises(TypingError, match="printed functions take contiguous arrays"):
        run(np.zeros((2, 2))[:, ::2], *rest)


def test_a_loop_that_is_bound_keeps_the_machine_code():
    run = compiled(LINES, 1)
    gc.collect()  # nothing else holds it
    a, b, h, u, table, out, room = arguments(1)
    run(a, b, h, u, table, out, room)
    assert run.machine_code.layout["lanes"] == 1 and room[0, 0] == pytest.approx(a[0] / (-0.5 * h + 1.0 / u[0]))
