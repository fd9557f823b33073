"""The printed linear solver and the printed step of the integrator, run as plain Python."""

import numpy as np

from valvesim.solver import rodas5p
from valvesim.solver.elimination import print_elimination
from valvesim.solver.straight_line import as_python

SPAN = 1e-6  # s, of a difference over time


def solver(n, entries):
    """(factor(J, diagonal, W, pivots), solve(W, x)) for a pattern of n x n; x is solved in place."""
    factor, solve = print_elimination(n, entries)
    lines = ["def factor(J, diagonal, W, pivots):", *factor, "def solve(W, x):"]
    lines += [f"x{k} = x[{k}]" for k in range(n)] + solve + [f"x[{k}] = x{k}" for k in range(n)]
    functions = as_python([line if line.startswith("def ") else f"    {line}" for line in lines])
    return functions["factor"], functions["solve"]


def full(n):
    """Every state couples to every other."""
    return [(i, j) for i in range(n) for j in range(n)]


def step_functions(n, rates, linearise, prepare=np.copyto):
    """What `rodas5p.integrate` calls, for lanes of a problem given by its rates(y, u, c, out)."""
    factor, solve = print_elimination(n, full(n))
    lines = ["def factor(J, diagonal, W, pivots):", *(f"    {line}" for line in factor), *rodas5p.print_step(n, solve)]
    functions = as_python(lines, rates=rates)
    if prepare is np.copyto:

        def prepare(c, out):
            np.copyto(out, c)

    return prepare, linearise, *(functions[name] for name in ("factor", "step", "error", "bend", "within"))


def plain_problem(n, derivative, jacobian, uncounted=None):
    """The same for one lane, from functions of vectors: derivative(y, u, c, out) and jacobian(y, u, c, out)."""
    apart = uncounted or derivative

    def rates(y, u, c, out):
        derivative(y[:, 0], u, c[:, 0], out[:, 0])

    def linearise(y, u, u_t, c, c_t, f, J, f_t):
        derivative(y[:, 0], u, c[:, 0], f[:, 0])
        jacobian(y[:, 0], u, c[:, 0], J[:, :, 0])
        late, early = np.empty(n), np.empty(n)
        apart(y[:, 0], u + SPAN * u_t, c[:, 0] + SPAN * c_t[:, 0], late)
        apart(y[:, 0], u - SPAN * u_t, c[:, 0] - SPAN * c_t[:, 0], early)
        f_t[:, 0] = (late - early) / (2 * SPAN)

    return step_functions(n, rates, linearise)
