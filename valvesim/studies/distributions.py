"""How a quantity is distributed over the members of a study: any continuous distribution of scipy.stats, or choices.

A distribution may be truncated: what `lowest` and `highest` leave of it is scaled to one. A tolerance t is a normal
distribution about the nominal value with t at two standard deviations, truncated there, as parts outside are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name

LEAST_OUTSIDE = 1e-12  # probability beyond the bounds of a quantity that counts as none
SPREADS_IN_TOLERANCE = 2.0  # standard deviations within a tolerance, as in the priors of a diagnosis


@dataclass(frozen=True)
class Distribution:
    """A continuous distribution of scipy.stats by `name`, truncated to `lowest`..`highest`; all in the quantity's unit.

    `shapes` are (name, value) of its shape parameters.
    """

    name: str
    location: float
    scale: float
    shapes: tuple[tuple[str, float], ...] = ()
    lowest: float = -np.inf
    highest: float = np.inf

    def __post_init__(self):
        law = scipy_law(self.name)
        expected = [word.strip() for word in (law.shapes or "").split(",") if word.strip()]
        if (given := [name for name, _ in self.shapes]) != expected:
            told = f"shape parameters {', '.join(expected)}" if expected else "no shape parameters"
            raise InputError(f"{self.name} has {told}; given: {', '.join(given) or 'none'}", key="parameters")
        if not (self.scale > 0.0 and np.isfinite(self.scale) and np.isfinite(self.location)):
            raise InputError(f"{self.scale:g} must be positive and finite", key="scale", joint=" = ")
        with np.errstate(all="ignore"):
            low, high = self._limits()
        if not high > low:
            problem = f"nothing of the distribution lies within {self.lowest:g} to {self.highest:g}"
            raise InputError(problem, key="lowest", related=("highest", "parameters"))

    def _frozen(self) -> Any:
        return scipy_law(self.name)(**dict(self.shapes), loc=self.location, scale=self.scale)

    def _limits(self) -> tuple[float, float]:
        """Probabilities below `lowest` and below `highest`."""
        law = self._frozen()
        return float(law.cdf(self.lowest)), float(law.cdf(self.highest))

    def quantile(self, probability: np.ndarray) -> np.ndarray:
        """Values (any shape) with these probabilities below them."""
        law, (low, high) = self._frozen(), self._limits()
        values = law.ppf(low + np.asarray(probability, dtype=float) * (high - low))
        return np.clip(values, self.lowest, self.highest)

    def log_density(self, values: np.ndarray) -> np.ndarray:
        """Logarithm of the probability density (any shape), -inf outside."""
        low, high = self._limits()
        inside = (values >= self.lowest) & (values <= self.highest)
        return np.where(inside, self._frozen().logpdf(values) - np.log(high - low), -np.inf)

    def probability(self, values: np.ndarray) -> np.ndarray:
        """Probability below values (any shape)."""
        law, (low, high) = self._frozen(), self._limits()
        return np.clip((law.cdf(values) - low) / (high - low), 0.0, 1.0)

    def outside(self, bounds: tuple[float, float]) -> float:
        """Probability of a value outside bounds."""
        law, (low, high) = self._frozen(), self._limits()
        below = max(float(law.cdf(np.nextafter(bounds[0], -np.inf))) - low, 0.0)
        above = max(float(law.sf(bounds[1])) - float(law.sf(self.highest)), 0.0)
        return (below + above) / (high - low)

    @property
    def deviation(self) -> float:
        """Standard deviation of 2000 values at even probabilities, which any distribution has."""
        return float(np.std(self.quantile((np.arange(2000) + 0.5) / 2000)))

    @property
    def words(self) -> str:
        """The distribution in words, in the quantity's unit."""
        shapes = "".join(f", {name} {value:g}" for name, value in self.shapes)
        cut = "" if np.isinf([self.lowest, self.highest]).all() else f" within {self.lowest:.6g} to {self.highest:.6g}"
        return f"{self.name}{shapes}, location {self.location:.6g}, scale {self.scale:.6g}{cut}"


@dataclass(frozen=True)
class OptionChoice:
    """One of several options (objects, or names), by their weights; a member's draw is the number of its option."""

    options: tuple[Any, ...]
    names: tuple[str, ...]
    weights: tuple[float, ...]

    def __post_init__(self):
        weights = np.asarray(self.weights, dtype=float)
        if not len(self.options) or len(weights) != len(self.options) or len(self.names) != len(self.options):
            raise InputError(f"{len(weights)} weights for {len(self.options)} choices", key="weights")
        if not (np.all(weights >= 0.0) and np.isfinite(weights).all() and weights.sum() > 0.0):
            raise InputError(f"{self.weights} must not be negative, nor all of them zero", key="weights")

    def quantile(self, probability: np.ndarray) -> np.ndarray:
        """Numbers of options (any shape) with these probabilities below them."""
        edges = np.cumsum(self.weights) / np.sum(self.weights)
        return np.searchsorted(edges[:-1], np.asarray(probability), side="right").astype(float)

    @property
    def words(self) -> str:
        """The choice in words."""
        shares = np.asarray(self.weights) / np.sum(self.weights)
        return "one of " + ", ".join(f"{n} ({100 * s:.3g} %)" for n, s in zip(self.names, shares, strict=True))


def tolerance_distribution(nominal: float, tolerance: float, bounds: tuple[float, float]) -> Distribution:
    """The distribution of a tolerance (see the module's head), cut at the bounds of the quantity."""
    low, high = max(nominal - tolerance, bounds[0]), min(nominal + tolerance, bounds[1])
    return Distribution("norm", nominal, tolerance / SPREADS_IN_TOLERANCE, lowest=low, highest=high)


def scipy_law(name: str) -> Any:
    """A continuous distribution of scipy.stats by name ("normal" is "norm"); InputError for another name."""
    from scipy import stats

    known = {one for one in dir(stats) if isinstance(getattr(stats, one), stats.rv_continuous)}
    if name not in known:
        raise unknown_name("distribution", name, known, "distribution")
    return getattr(stats, name)
