"""How well the published drifts determine each parameter of an identified valve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.paper.identification import ALL_FREE, ALL_ROWS, PaperIdentification, least_squares, residuals
from valvesim.paper.published import PUBLISHED_DRIFTS, TOLERANCE, Progress
from valvesim.paper.unknowns import LOG_SPANS, LOST_VALUES

PROFILE_SHARES = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True, kw_only=True)
class Determination:
    """How well the eleven drifts determine each of the parameters, at an identified valve."""

    singular_values: np.ndarray  # (11,) relative change of the drifts per factor e of a combination
    remaining: np.ndarray  # (18,) share of the prior spread (uniform in the bounds) that the drifts leave
    shares: np.ndarray  # (9,) of a logarithmic range, at which a parameter was held
    profile: np.ndarray  # (18, 9) misfit in % with the parameter held at `shares` and all others refitted

    @property
    def combinations(self) -> int:
        """Combinations of parameters that the drifts, taken as good to 5 %, fix better than a factor e."""
        return int(np.sum(self.singular_values > TOLERANCE))


def determine(found: PaperIdentification, *, progress: Progress | None = None) -> Determination:
    """Singular values, spread left by a linear estimate, and the misfit along each parameter.

    The linear estimate takes the drifts as good to `TOLERANCE` and the bounds as a prior of the same spread.
    """
    n, width = len(LOST_VALUES), 1e-5
    step = np.where(found.shares + width > 1.0, -width, width)
    r = residuals(np.vstack([found.shares, found.shares + np.diag(step)]), found.interpretation)[
        :, : len(PUBLISHED_DRIFTS)
    ]
    jacobian = ((r[1:] - r[0]) / (step * LOG_SPANS)[:, None]).T
    prior = LOG_SPANS / np.sqrt(12.0)
    information = jacobian.T @ jacobian / TOLERANCE**2 + np.diag(1.0 / prior**2)
    profile = np.empty((n, len(PROFILE_SHARES)))
    for k in range(n):
        free = np.delete(ALL_FREE, k)
        below = [j for j in range(len(PROFILE_SHARES)) if PROFILE_SHARES[j] <= found.shares[k]]
        above = [j for j in range(len(PROFILE_SHARES)) if PROFILE_SHARES[j] > found.shares[k]]
        for places in (below[::-1], above):  # from the optimum outward, each from the one before: along the valley
            start = found.shares
            for j in places:
                fit = _held(start, found, k, free, PROFILE_SHARES[j])
                start = np.insert(fit.x, k, PROFILE_SHARES[j])
                profile[k, j] = max(100.0 * float(np.sqrt(2.0 * fit.cost / len(PUBLISHED_DRIFTS))), found.misfit)
        if progress is not None:
            progress(f"how well the drifts determine the valve, {found.interpretation.title}", (k + 1) / n)
    return Determination(
        singular_values=np.linalg.svd(jacobian, compute_uv=False),
        remaining=np.sqrt(np.diag(np.linalg.inv(information))) / prior,
        shares=PROFILE_SHARES,
        profile=profile,
    )


def _held(start: np.ndarray, found: PaperIdentification, k: int, free: np.ndarray, share: float) -> Any:
    """Refit with parameter k held at a share of its range: from `start`, else from the optimum, whichever is closer."""
    fits = []
    for base in (start, found.shares):
        held = base.copy()
        held[k] = share
        fits.append(least_squares(held, found.interpretation, free, ALL_ROWS, 30))
        if fits[-1].cost < 1.1 * np.sum(found.misses**2) / 2.0:
            break
    return min(fits, key=lambda fit: fit.cost)
