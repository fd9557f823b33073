"""Linear systems of a fixed sparsity pattern, solved by code printed for that pattern: LU without exchange of rows.

A valve couples each state to few others. Written out along the Jacobian's pattern, factors and solutions of the six
states take a fifth of the time that loops over a full matrix take. Rows need no exchange, for the matrix of a
Rosenbrock step, 1/(gamma h) - J, has large positive diagonal entries; where an entry vanishes nevertheless, the
solution is not finite and the integrator refuses the step.

Symbols
    J Jacobian; W the matrix, as its factors with the pivots inverted; x right-hand side and solution

The state that fills in least is eliminated first: H. M. Markowitz, Management Science 3 (1957) 255.
"""

from __future__ import annotations

from collections.abc import Iterable


def print_elimination(n: int, entries: Iterable[tuple[int, int]]) -> tuple[list[str], list[str]]:
    """(lines of `factor(J, diagonal, W, pivots)`, lines that solve for x0, x1 ... in place), for `straight_line`.

    The factors are those of diagonal - J; `pivots[0]` is not finite where one of them is not. `entries` are the
    (row, column) of an n x n Jacobian that may differ from zero.
    """
    given = set(entries)
    pattern = {(i, j) for i, j in given if i != j}
    left = list(range(n))
    factor = [f"w{i}_{j} = -J[{i}, {j}]" for i, j in sorted(pattern)]
    factor += [f"w{k}_{k} = diagonal - J[{k}, {k}]" if (k, k) in given else f"w{k}_{k} = diagonal" for k in left]
    forward: list[str] = []
    backward: list[str] = []
    order = []
    while left:
        below = {k: [i for i in left if i != k and (i, k) in pattern] for k in left}
        right = {k: [j for j in left if j != k and (k, j) in pattern] for k in left}
        k = min(left, key=lambda k: len(below[k]) * len(right[k]))
        left.remove(k)
        order.append(k)
        factor.append(f"pivot = 1.0 / w{k}_{k}")
        factor.append(f"W[{k}, {k}] = pivot")
        for i in below[k]:
            factor.append(f"ratio = w{i}_{k} * pivot")
            factor.append(f"W[{i}, {k}] = ratio")
            for j in right[k]:
                held = f"w{i}_{j} - " if (i, j) in pattern or i == j else "-"
                factor.append(f"w{i}_{j} = {held}ratio * w{k}_{j}")
            pattern |= {(i, j) for j in right[k] if i != j}
            forward.append(f"x{i} = x{i} - W[{i}, {k}] * x{k}")
        factor += [f"W[{k}, {j}] = w{k}_{j}" for j in right[k]]
        known = "".join(f" - W[{k}, {j}] * x{j}" for j in right[k])
        backward.insert(0, f"x{k} = (x{k}{known}) * W[{k}, {k}]")
    factor.append("pivots[0] = " + " + ".join(f"w{k}_{k}" for k in order))
    return factor, forward + backward
