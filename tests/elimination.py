"""The printed linear solver, run as plain Python."""

import numpy as np

from valvesim.solver.elimination import print_elimination


def elimination(n, entries):
    """(factor, back_substitute) for a pattern of n x n."""
    factor, back_substitute = print_elimination(n, entries)
    text = (
        "\n    ".join(["def factor(W):", *factor])
        + "\n"
        + "\n    ".join(["def back_substitute(W, x):", *back_substitute])
    )
    names = {"np": np}
    exec(text, names)
    return names["factor"], names["back_substitute"]


def full_elimination(n):
    """The same where every state couples to every other."""
    return elimination(n, [(i, j) for i in range(n) for j in range(n)])
