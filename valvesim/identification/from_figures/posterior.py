"""The valve that fits figures best within its prior, and what the figures leave open: maximum a posteriori with
Laplace's approximation.

Symbols
    u point (n,) in prior standard deviations, r whitened misfit (q,), J its Jacobian (q, n) by differences of a batch
    H = J'J + 1 posterior precision, C = H^-1 covariance of u
MacKay 1992 (Laplace's approximation). scipy's trust-region least squares: a batch of valves is one call, so that a
Jacobian costs little more than a prediction (`identification.least_squares` is made for records, where it does not).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.from_figures.prediction import Asked, FigurePredictor
from valvesim.identification.from_figures.similarity import UNKNOWNS, SimilarValves

_LAP = [unknown.name for unknown in UNKNOWNS].index("lap")


@dataclass(frozen=True)
class Posterior:
    """A fit: `point` (n,), `predicted` figures (q,) in SI with their `slopes` (q, n) per prior deviation.

    `turns_slopes` (n,) are those of the ampere-turns' deviation, `chi_square` is the penalised one.
    """

    similar: SimilarValves
    asked: tuple[Asked, ...]
    point: np.ndarray
    predicted: np.ndarray
    slopes: np.ndarray
    turns_slopes: np.ndarray
    chi_square: float

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (n, n) of the point in prior standard deviations; a kept limit says nothing of the valve.

        The lap keeps its prior unless it was asked for: figures are nearly even in it, so that their slope is that of
        one of two valves.
        """
        whitened = _whitened(self.asked, self.predicted, self.slopes, self.turns_slopes)
        if all(asked.limit.figure != "lap" for asked in self.asked):
            whitened[:, _LAP] = 0.0
        return _covariance(whitened)

    @property
    def log_evidence(self) -> float:
        """ln of the posterior's mass about the point: how well it fits, and how many valves about it do."""
        return -0.5 * self.chi_square + 0.5 * float(np.linalg.slogdet(self.covariance)[1])

    @property
    def deviations(self) -> np.ndarray:
        """One standard deviation (q,) of each figure by what all figures together say, SI."""
        C = _covariance(_whitened(self.asked, self.predicted, self.slopes, self.turns_slopes))
        return np.sqrt(np.einsum("qn,nm,qm->q", self.slopes, C, self.slopes))


def _covariance(whitened: np.ndarray) -> np.ndarray:
    return np.linalg.inv(np.eye(whitened.shape[1]) + whitened.T @ whitened)


def fit(
    similar: SimilarValves, predictor: FigurePredictor, *, seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Posterior:  # fmt: skip
    """Of the maxima a posteriori that lie downhill of similarity and of drawn points, that of greatest evidence.

    Raises SolveError where no point near similarity is a valve that runs.
    """
    n = len(UNKNOWNS)
    found: list[Posterior] = []
    drawn = np.random.default_rng(seed).normal(size=(predictor.options.posterior.drawn_starts, n))
    starts = np.vstack([np.zeros(n), drawn])
    for k, start in enumerate(starts):
        tell = None if progress is None else lambda share, k=k: progress((k + share) / len(starts))
        with contextlib.suppress(*((SolveError, InputError) if found else ())):
            found.append(descend(similar, predictor, start, tell))
    return max(found, key=lambda one: one.log_evidence)


def descend(
    similar: SimilarValves, predictor: FigurePredictor, start: np.ndarray,
    progress: Callable[[float], None] | None = None, *, evaluations: int | None = None,
) -> Posterior:  # fmt: skip
    """The maximum a posteriori that lies downhill of a point, in `evaluations` (those of the options by default).

    Raises SolveError where the point is no valve that runs.
    """
    from scipy.optimize import least_squares

    n, asked, options = len(start), predictor.asked, predictor.options.posterior
    done: dict[bytes, _Local] = {}

    def at(point: np.ndarray) -> _Local:
        key = point.tobytes()
        if key not in done:
            done[key] = _local(similar, predictor, point, options.forward_step * np.eye(n))
            if progress is not None:
                progress(min(len(done) / options.evaluations, 1.0))
        return done[key]

    def misfit(point: np.ndarray) -> np.ndarray:
        try:
            local = at(point)
        except (SolveError, InputError):
            if not done:
                raise
            return np.full(len(asked) + n + 1, options.no_valve)
        misfits = [a.misfit(float(v)) for a, v in zip(asked, local.figures, strict=True)]
        return np.concatenate([misfits, [local.turns], point])

    def jacobian(point: np.ndarray) -> np.ndarray:
        local = at(point)
        return np.vstack([_whitened(asked, local.figures, local.slopes, local.turns_slopes), np.eye(n)])

    found = least_squares(
        misfit, start, jac=jacobian, bounds=(-options.farthest, options.farthest), method="trf", x_scale=1.0,
        ftol=options.ftol, xtol=1e-4, gtol=1e-6, max_nfev=evaluations or options.evaluations,
    )  # fmt: skip
    end = _local(similar, predictor, found.x, options.step * np.vstack([np.eye(n), -np.eye(n)]))
    return Posterior(
        similar, asked, found.x, end.figures, end.slopes, end.turns_slopes, float(2.0 * found.cost)
    )  # fmt: skip


@dataclass(frozen=True)
class _Local:
    """Figures (q,) at a point with their slopes (q, n); the ampere-turns' deviation with its own (n,)."""

    figures: np.ndarray
    slopes: np.ndarray
    turns: float
    turns_slopes: np.ndarray


def _local(similar: SimilarValves, predictor: FigurePredictor, point: np.ndarray, moves: np.ndarray) -> _Local:
    """The figures about a point, from a batch of valves moved from it: to one side (n, n), or to both (2 n, n)."""
    n = len(point)
    points = point + np.vstack([np.zeros(n), moves])
    valves = similar.valves(points)
    figures, turns = predictor.predict(valves, len(points)), similar.ampere_turns(valves)
    if not np.all(np.isfinite(figures)):
        raise SolveError("identification: a figure cannot be told of the valve at this point")
    table = np.column_stack([figures, turns])
    back = table[n + 1 :] if len(moves) > n else table[0]
    slopes = (table[1 : n + 1] - back).T / (np.max(moves) * (len(moves) // n))
    return _Local(figures[0], slopes[:-1], float(turns[0]), slopes[-1])


def _whitened(asked: Sequence[Asked], figures: np.ndarray, slopes: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """The Jacobian (q + 1, n) of the misfits, that of the ampere-turns last."""
    shares = [a.weight(float(v)) for a, v in zip(asked, figures, strict=True)]
    return np.vstack([slopes * np.reshape(shares, (-1, 1)), turns])
