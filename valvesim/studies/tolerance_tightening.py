"""Which tolerance to tighten first for a wanted yield, from the members that have run: none is run again.

Tightening a quantity draws it towards its median m by a factor f: its values lie at m + f (x - m). Each member is
moved there along the regression plane of each limited figure, its own deviation from the plane kept, and judged again.
Beside it stands what needs no plane, the members weighted with the ratio of the densities (importance sampling): where
the two differ by more than the standard error, the figures bend.

Symbols
    b slope of a figure over a quantity,  y' = y - sum b (1 - f) (x - m)
    p(x) density of the draws, x' = m + (x - m)/f,  w = p(x')/(p(x) prod f)
    yield = sum w pass / sum w,  effective members n = (sum w)^2 / sum w^2
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError
from valvesim.studies.criteria import Criterion
from valvesim.studies.designs import correlation_matrix
from valvesim.studies.distributions import Distribution
from valvesim.studies.study_result import StudyResult

STEP = 0.75  # factor of one step of tightening
LEAST_FACTOR = 0.2  # a tolerance of a fifth is another process
SMOOTHING = 0.2  # of the deviation of a figure, over which a member is spread where gains are compared
ENOUGH_MEMBERS = 100_000  # members: more tell no two tolerances apart any better
MEMBERS_PER_QUANTITY = 4  # times as many members as quantities, for a plane
MOST_STEPS = 60


@dataclass(frozen=True)
class Tightening:
    """The yield with tolerances times `factors` (by key, those below 1 alone).

    `share` is that of the moved members; `weighted` with its standard error `error` that of the weighted ones, which
    rests on `effective` members.
    """

    factors: dict[str, float]
    share: float
    weighted: float
    error: float
    effective: float


@dataclass(frozen=True)
class TighteningPlan:
    """The yield as it is, with each tolerance halved alone (greatest gain first), and step by step to the `wanted` one.

    `steps` end where the yield is reached (`reached`), or no tolerance helps any more.
    """

    now: Tightening
    halved: tuple[Tightening, ...]
    steps: tuple[Tightening, ...]
    wanted: float
    reached: bool


def tightening_plan(result: StudyResult, wanted: float) -> TighteningPlan:
    """How to reach a wanted yield (share), one step of one tolerance at a time, each the one that gains most.

    Gains are compared by smoothed yields, for a few members more or less tell no two tolerances apart.

    Raises InputError without limits, for a table of one's own, where nothing that varies is continuous, and where too
    few members have the figures.
    """
    yields = TightenedYields(result)
    now = yields.at({})
    order = sorted(yields.keys, key=lambda key: -yields.smoothed({key: 0.5}))
    halved = [yields.at({key: 0.5}) for key in order]
    steps: list[Tightening] = []
    at = now
    while at.share < wanted and len(steps) < MOST_STEPS:
        tried = {
            key: yields.smoothed(at.factors | {key: at.factors.get(key, 1.0) * STEP})
            for key in yields.keys
            if at.factors.get(key, 1.0) * STEP >= LEAST_FACTOR
        }
        best = max(tried, key=lambda key: tried[key], default=None)
        if best is None or tried[best] <= yields.smoothed(at.factors):
            break
        at = yields.at(at.factors | {best: at.factors.get(best, 1.0) * STEP})
        steps.append(at)
    return TighteningPlan(now, tuple(halved), tuple(steps), wanted, at.share >= wanted)


class TightenedYields:
    """Yields of other tolerances by the members of a study; `keys` are the quantities that can be tightened."""

    def __init__(self, result: StudyResult):
        study = result.study
        if study.design.rows is not None:
            raise InputError("a table of one's own has no tolerances to tighten", key="design.table")
        if not result.criteria:
            raise InputError("no limits: a yield needs [limits] or a specification", key="limits")
        here = np.flatnonzero(result.independent)[:ENOUGH_MEMBERS]
        self._draws, self._passes = result.draws[here], result.passes[here]
        own = [(k, v.key, v.distribution) for k, v in enumerate(study.variables)
               if isinstance(v.distribution, Distribution)]  # fmt: skip
        if not own:
            raise InputError("nothing that varies has a tolerance", key="vary")
        self._places = {key: k for k, key, _ in own}
        self._laws = {key: law for _, key, law in own}
        self._medians = {key: float(law.quantile(np.array(0.5))) for key, law in self._laws.items()}
        self._judged = [(c, result.column(c.figure.name)[here]) for c in result.criteria]
        self._slopes = [self._plane(values) for _, values in self._judged]
        self._widths = [SMOOTHING * max(float(np.nanstd(values)), 1e-300) for _, values in self._judged]
        self._precision = None
        if study.design.correlations:
            R = correlation_matrix(study.design.correlations, study.keys)
            self._precision = np.linalg.inv(R) - np.eye(len(R))
            self._scores = self._normal_scores(self._draws)

    def _plane(self, values: np.ndarray) -> np.ndarray:
        """Slopes (variables,) of the least-squares plane of a figure over what varies."""
        have = np.isfinite(values)
        x = self._draws[have]
        if len(x) < MEMBERS_PER_QUANTITY * x.shape[1]:
            raise InputError(f"{len(x)} members have the limited figures: too few to tell what tightening does")
        spread = np.std(x, axis=0)
        safe = np.where(spread > 0.0, spread, 1.0)
        z = (x - x.mean(axis=0)) / safe
        return np.linalg.lstsq(z, values[have] - values[have].mean(), rcond=None)[0] / safe

    def moved(self, factors: dict[str, float]) -> float:
        """Share of the members that pass where their tolerances bring them."""
        passes = np.ones(len(self._draws), dtype=bool)
        for criterion, moved in self._moved(factors):
            passes &= criterion.passes(moved)
        return float(np.mean(passes))

    def smoothed(self, factors: dict[str, float]) -> float:
        """The same, each member spread over a share of its figure's deviation: it tells small gains apart."""
        from scipy.special import ndtr

        passes = np.ones(len(self._draws))
        for (criterion, moved), width in zip(self._moved(factors), self._widths, strict=True):
            judged = criterion.judged(moved)
            within = ndtr((criterion.high - judged) / width) - ndtr((criterion.low - judged) / width)
            passes *= np.nan_to_num(within)
        return float(np.mean(passes))

    def _moved(self, factors: dict[str, float]) -> Iterator[tuple[Criterion, np.ndarray]]:
        """Each criterion with the figures of the moved members, NaN where there are none."""
        for (criterion, values), slopes in zip(self._judged, self._slopes, strict=True):
            moved = values.copy()
            for key, factor in factors.items():
                k = self._places[key]
                moved -= slopes[k] * (1.0 - factor) * (self._draws[:, k] - self._medians[key])
            yield criterion, moved

    @property
    def keys(self) -> tuple[str, ...]:
        """Quantities that can be tightened."""
        return tuple(self._places)

    def at(self, factors: dict[str, float]) -> Tightening:
        """The yield with tolerances times these factors, both ways."""
        moved = self.moved(factors)
        w = self._weights({key: factor for key, factor in factors.items() if factor != 1.0})
        total = float(w.sum())
        if total <= 0.0:
            return Tightening(factors, moved, np.nan, np.inf, 0.0)
        share = float(w @ self._passes) / total
        error = float(np.sqrt(np.sum((w * (self._passes - share)) ** 2))) / total
        return Tightening(factors, moved, share, error, total**2 / float(w @ w))

    def _weights(self, factors: dict[str, float]) -> np.ndarray:
        moved, log_ratio = self._draws, np.zeros(len(self._draws))
        if self._precision is not None:
            moved = moved.copy()
        for key, factor in factors.items():
            k, law = self._places[key], self._laws[key]
            column = self._medians[key] + (self._draws[:, k] - self._medians[key]) / factor
            log_ratio += law.log_density(column) - law.log_density(self._draws[:, k]) - np.log(factor)
            if self._precision is not None:
                moved[:, k] = column
        if self._precision is not None and factors:
            log_ratio += _copula(self._normal_scores(moved), self._precision)
            log_ratio -= _copula(self._scores, self._precision)
        return np.exp(np.where(np.isfinite(log_ratio), log_ratio, -np.inf))

    def _normal_scores(self, draws: np.ndarray) -> np.ndarray:
        from scipy.special import ndtri

        z = np.zeros_like(draws)
        for key, k in self._places.items():
            z[:, k] = ndtri(np.clip(self._laws[key].probability(draws[:, k]), 1e-15, 1.0 - 1e-15))
        return z


def _copula(z: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Logarithm of the density of a Gaussian copula (members,), but for a constant."""
    return -0.5 * np.einsum("ni,ij,nj->n", z, precision, z)
