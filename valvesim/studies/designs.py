"""The design of a study: which points of the unit cube its members stand at, and correlations between quantities.

Symbols
    u (members, d) probabilities, z = Phi^-1(u) normal scores, R correlations of the scores, R = L L'

A Gaussian copula turns independent scores into correlated ones, z L', and leaves every distribution as it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError, unknown_name

DESIGNS = ("random", "latin_hypercube", "sobol", "saltelli", "table")
LEAST_PROBABILITY = 2.0**-53  # and the most is one less that much: a normal distribution has no value at 0 and 1
MOST_MEMBERS = 100_000_000


@dataclass(frozen=True)
class Correlation:
    """Correlation `value` of the normal scores of two quantities (keys)."""

    first: str
    second: str
    value: float


@dataclass(frozen=True, kw_only=True)
class Design:
    """How members are drawn: `kind` is one of `DESIGNS`, the same `seed` gives the same members.

    random            independent draws
    latin_hypercube   each quantity stratified into as many parts as there are members (scipy.stats.qmc)
    sobol             a scrambled Sobol sequence (scipy.stats.qmc); powers of two are balanced best
    saltelli          base_samples (d + 2) members for first-order and total Sobol indices (Saltelli 2010, by SALib)
    table             `rows`, values (members, d) of the quantities themselves
    """

    kind: str = "latin_hypercube"
    members: int = 1000
    seed: int = 1
    correlations: tuple[Correlation, ...] = ()
    rows: np.ndarray | None = None

    def __post_init__(self):
        if self.kind not in DESIGNS:
            raise unknown_name("design", self.kind, DESIGNS, "design.kind")
        if not 1 <= self.members <= MOST_MEMBERS:
            raise InputError(f"{self.members} must be within 1 and {MOST_MEMBERS}", key="design.members", joint=" = ")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"{self.seed} must not be negative", key="design.seed", joint=" = ")
        if self.kind == "saltelli":
            if self.members & (self.members - 1):
                problem = f"{self.members} must be a power of two, such as {2 ** (self.members.bit_length() - 1)}"
                raise InputError(problem, key="design.base_samples", joint=" = ")
            if self.correlations:
                raise InputError("Sobol indices are of independent quantities; leave them out", key="correlations")
        if (self.kind == "table") != (self.rows is not None):
            raise InputError("a table has rows, and no other design has", key="design.table")

    def size(self, dimensions: int) -> int:
        """How many members the study has; for "saltelli" `members` are the base samples."""
        return self.members * (dimensions + 2) if self.kind == "saltelli" else self.members

    def probabilities(self, keys: Sequence[str]) -> np.ndarray:
        """Points u (members, d) of the unit cube, correlated; of every design but a table."""
        from scipy.stats import qmc

        d = len(keys)
        if self.kind == "random":
            u = np.random.default_rng(self.seed).random((self.members, d))
        elif self.kind == "latin_hypercube":
            u = qmc.LatinHypercube(d, rng=np.random.default_rng(self.seed)).random(self.members)
        elif self.kind == "sobol":
            sequence, power = qmc.Sobol(d, rng=np.random.default_rng(self.seed)), (self.members - 1).bit_length()
            u = sequence.random_base2(power)[: self.members]
        else:
            u = _saltelli(self.members, keys, self.seed)
        u = np.clip(u, LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY)
        return correlate(u, correlation_matrix(self.correlations, keys)) if self.correlations else u


def _saltelli(base_samples: int, keys: Sequence[str], seed: int) -> np.ndarray:
    """Members (base_samples (d + 2), d) in the order that SALib analyses: A, each column of A from B, B."""
    from SALib.sample import sobol

    problem = saltelli_problem(keys)
    return np.asarray(sobol.sample(problem, base_samples, calc_second_order=False, scramble=True, seed=seed))


def saltelli_problem(keys: Sequence[str]) -> dict:
    """What SALib calls a problem: names, and the unit cube as their bounds."""
    return {"num_vars": len(keys), "names": list(keys), "bounds": [[0.0, 1.0]] * len(keys)}


def correlation_matrix(correlations: Sequence[Correlation], keys: Sequence[str]) -> np.ndarray:
    """R (d, d) of the normal scores. InputError for an unknown key and for correlations that no quantities can have."""
    R, names = np.eye(len(keys)), list(keys)
    for one in correlations:
        for key in (one.first, one.second):
            if key not in names:
                raise unknown_name("quantity that varies", key, names, "correlations")
        if one.first == one.second or not -1.0 < one.value < 1.0:
            problem = f"{one.value:g} between {one.first} and {one.second}: between two, and within -1 and 1"
            raise InputError(problem, key="correlations")
        i, j = names.index(one.first), names.index(one.second)
        R[i, j] = R[j, i] = one.value
    if np.min(np.linalg.eigvalsh(R)) < 1e-10:
        raise InputError("no quantities can have all of these at once (not positive definite)", key="correlations")
    return R


def correlate(u: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Probabilities (members, d) whose normal scores have the correlations R (d, d), from independent ones."""
    from scipy.special import ndtr, ndtri

    # a plain sum: the order in which a library's product adds up may differ from machine to machine
    L, z = np.linalg.cholesky(R), ndtri(u)
    scores = np.zeros_like(z)
    for k in range(len(L)):
        scores += z[:, k : k + 1] * L[:, k]
    return np.clip(ndtr(scores), LEAST_PROBABILITY, 1.0 - LEAST_PROBABILITY)
