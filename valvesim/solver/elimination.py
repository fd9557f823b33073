"""Linear systems of a fixed sparsity pattern, solved by code printed for that pattern: LU without exchange of rows.

A valve couples each state to few others. Written out along the Jacobian's pattern, factors and solutions of the six
states take a fifth of the time that loops over a full matrix take. Rows need no exchange, for the matrix of a
Rosenbrock step, 1/(gamma h) - J, has large positive diagonal entries; where an entry vanishes nevertheless, the
solution is not finite and the integrator refuses the step.

Symbols
    W matrix, in place its factors with the pivots inverted; x right-hand side, in place the solution

The state that fills in least is eliminated first: H. M. Markowitz, Management Science 3 (1957) 255.
"""

from __future__ import annotations

from collections.abc import Iterable


def print_elimination(n: int, entries: Iterable[tuple[int, int]]) -> tuple[list[str], list[str]]:
    """(lines of `factor(W)`, lines of `back_substitute(W, x)`) as Python, one operation each, unindented.

    `factor` returns False where a pivot is not finite.
    `entries` are the (row, column) of an n x n matrix that may differ from zero; the diagonal always may.
    """
    pattern = {(i, j) for i, j in entries if i != j}
    left = list(range(n))
    factor = ["pivots = 0.0"]
    forward: list[str] = []
    backward: list[str] = []
    while left:
        below = {k: [i for i in left if (i, k) in pattern] for k in left}
        right = {k: [j for j in left if (k, j) in pattern] for k in left}
        k = min(left, key=lambda k: len(below[k]) * len(right[k]))
        left.remove(k)
        factor += [f"pivots += W[{k}, {k}]", f"pivot = W[{k}, {k}] = 1.0 / W[{k}, {k}]"]
        for i in below[k]:
            factor.append(f"ratio = W[{i}, {k}] = W[{i}, {k}] * pivot")
            factor += [f"W[{i}, {j}] -= ratio * W[{k}, {j}]" for j in right[k]]
            pattern |= {(i, j) for j in right[k] if i != j}
            forward.append(f"x[{i}] -= W[{i}, {k}] * x[{k}]")
        known = "".join(f" - W[{k}, {j}] * x[{j}]" for j in right[k])
        backward.insert(0, f"x[{k}] = (x[{k}]{known}) * W[{k}, {k}]")
    return [*factor, "return np.isfinite(pivots)"], forward + backward
