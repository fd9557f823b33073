"""What the data say of a candidate, from products of whitened columns alone.

Symbols
    r residual, J sensitivities to the nuisance parameters (one prior standard deviation each), s answer to a candidate
    t nuisance parameters now, in prior standard deviations;  H = J'J + I
    s~ = s off the space of J, softened by the prior:  s~'s~ = s's - s'J H^-1 J's,  s~'r~ = s'r - s'J H^-1 (J'r - t)
    z = s~'r~/|s~| is standard normal where nothing is hidden;  z^2 is the reduction of the chi-square;  |s~| is d'

A `Gram` keeps the products G = [r J S]'[r J S] of each segment of the data, so that ten minutes of ten channels weigh
no more than a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class GramMatrix:
    """Products of columns over segments: `products` (segments, m, m), columns [r, J (p), S (q)], `prior_now` t (p,).

    `rows` (segments,) are how many rows went into each.
    """

    products: np.ndarray
    prior_now: np.ndarray
    rows: tuple[int, ...]

    @property
    def parameters(self) -> int:
        """Number p of nuisance parameters."""
        return len(self.prior_now)

    @property
    def total(self) -> np.ndarray:
        """(m, m) over all segments."""
        return self.products.sum(axis=0)

    @property
    def chi_square(self) -> float:
        """Whitened squares of the residual and of the prior."""
        return float(self.total[0, 0] + self.prior_now @ self.prior_now)

    def without(self, which: Sequence[int]) -> GramMatrix:
        """The products with some nuisance parameters, by their places, at zero and not free: r + J t there."""
        places = list(which)
        to_zero = np.eye(self.products.shape[1])
        to_zero[1:, 0][places] = self.prior_now[places]
        to_zero = np.delete(to_zero, [1 + k for k in places], axis=1)
        return GramMatrix(to_zero.T @ self.products @ to_zero, np.delete(self.prior_now, places), self.rows)


def inverse_of(H: np.ndarray) -> np.ndarray:
    """The inverse of a normal matrix of quantities of very different size; zero along what nothing is known of."""
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    return np.linalg.pinv(H / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)


def _H(G: np.ndarray, p: int) -> np.ndarray:
    return G[1 : 1 + p, 1 : 1 + p] + np.eye(p)


@dataclass(frozen=True)
class ProjectedScores:
    """Candidates off the nuisance parameters: `score` (q,) s~'r~, `overlap` (q, q) s~'s~; chi-square after the
    nominal model step.
    """

    score: np.ndarray
    overlap: np.ndarray
    chi_square: float

    @property
    def distance(self) -> np.ndarray:
        """d' (q,) of each candidate at the amplitude of its column."""
        return np.sqrt(np.maximum(np.diag(self.overlap), 0.0))

    @property
    def z(self) -> np.ndarray:
        """Standard normal where nothing is hidden (q,); zero where the data do not see the candidate."""
        d = self.distance
        return np.divide(self.score, d, out=np.zeros_like(d), where=d > 1e-9)

    def correlation(self) -> np.ndarray:
        """Correlations (q, q) of what candidates show."""
        d = np.where(self.distance > 1e-9, self.distance, 1.0)
        C = self.overlap / np.outer(d, d)
        np.fill_diagonal(C, 1.0)
        return np.clip(C, -1.0, 1.0)

    def without(self, taken: Sequence[int]) -> ProjectedScores:
        """Candidates off those taken too, which are free."""
        k = list(taken)
        if not k:
            return self
        inverse = np.linalg.pinv(self.overlap[np.ix_(k, k)], rcond=1e-9, hermitian=True)
        gain = self.overlap[:, k] @ inverse
        fall = float(self.score[k] @ inverse @ self.score[k])
        overlap = self.overlap - gain @ self.overlap[k]
        small = np.diag(overlap) < 1e-6 * np.diag(self.overlap)
        overlap[small], overlap[:, small] = 0.0, 0.0
        return ProjectedScores(self.score - gain @ self.score[k], overlap, self.chi_square - fall)


def project(gram: GramMatrix, first: int, last: int) -> ProjectedScores:
    """Columns first..last (counted after r and J) off the nuisance parameters."""
    G, p = gram.total, gram.parameters
    J, s = slice(1, 1 + p), slice(1 + p + first, 1 + p + last)
    gradient = G[J, 0] - gram.prior_now
    solved = np.linalg.solve(_H(G, p), np.column_stack([G[J, s], gradient]))
    score = G[s, 0] - G[s, J] @ solved[:, -1]
    overlap = G[s, s] - G[s, J] @ solved[:, :-1]
    size = np.diag(G[s, s])
    blind = np.diag(overlap) < 1e-9 * size + 1e-12
    overlap = (overlap + overlap.T) / 2.0
    overlap[blind], overlap[:, blind], score = 0.0, 0.0, np.where(blind, 0.0, score)
    return ProjectedScores(score, overlap, gram.chi_square - float(gradient @ solved[:, -1]))


def largest_by_chance(projected: ProjectedScores, one_sided: np.ndarray, seed: int, draws: int) -> np.ndarray:
    """The z of the best of all candidates where nothing is hidden, by drawing (draws,); empty where none is seen."""
    seen = projected.distance > 1e-9
    if not seen.any():
        return np.zeros(0)
    values, vectors = np.linalg.eigh(projected.correlation()[np.ix_(seen, seen)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    keep = values > 1e-6 * values[-1]
    z = np.random.default_rng(seed).standard_normal((draws, int(keep.sum()))) @ root[:, keep].T
    return np.max(np.where(one_sided[seen], z, np.abs(z)), axis=1)


def alarm_level(largest: np.ndarray, probability: float) -> float:
    """The z that what is `largest_by_chance` passes with that probability; infinite where no candidate is seen."""
    return float(np.quantile(largest, 1.0 - probability)) if len(largest) else np.inf


def direction_statistic(projected: ProjectedScores, members: Sequence[int], along: np.ndarray) -> tuple[float, float]:
    """(amplitude, reduction of the chi-square) of several columns in fixed proportions `along` (k,); zeros where the
    data see next to nothing of them so.
    """
    H, s = projected.overlap[np.ix_(members, members)], projected.score[list(members)]
    size = float(along @ H @ along)
    if size <= 1e-6 * float(np.max(np.diag(H), initial=0.0)):
        return 0.0, 0.0
    return float(along @ s) / size, float((along @ s) ** 2 / size)


def block_statistic(projected: ProjectedScores, members: Sequence[int]) -> tuple[float, int]:
    """(chi-square, degrees of freedom) of several columns at once, those that the data see."""
    k = list(members)
    size = projected.distance[k]
    seen = [i for i, d in zip(k, size, strict=True) if d > 1e-6 * max(float(size.max()), 1e-300)]
    if not seen:
        return 0.0, 0
    d = projected.distance[seen]
    C = projected.overlap[np.ix_(seen, seen)] / np.outer(d, d)
    values, vectors = np.linalg.eigh(C)
    keep = values > 1e-4
    along = vectors[:, keep].T @ (projected.score[seen] / d)
    return float(np.sum(along**2 / values[keep])), int(keep.sum())
