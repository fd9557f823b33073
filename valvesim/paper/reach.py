"""Which published drifts, alone or together, any valve inside the bounds can have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.paper.identification import (
    ALL_FREE,
    SCREENED,
    PaperIdentification,
    least_squares,
    residuals,
    turned_values,
)
from valvesim.paper.published import PUBLISHED_DRIFTS, TOLERANCE, Progress
from valvesim.paper.unknowns import LOST_VALUES
from valvesim.valve.coefficients import ROUTES

GROUPS: dict[str, tuple[str, ...]] = {drift.key: (drift.key,) for drift in PUBLISHED_DRIFTS} | {
    "curve": ("total", "knee", "total_5mA"),
    "curve_and_flow": ("flow", "total", "knee", "total_5mA"),
    "mmf_and_arm": ("mmf", "arm"),
    "routes": ROUTES,
}
"""Drifts aimed at alone or together, to see what no valve inside the bounds can do."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """The closest that any valve found comes to a group of drifts, all others ignored, in either sense."""

    keys: tuple[str, ...]
    values: np.ndarray  # (n,) %, turned
    worst: float  # largest relative miss of the group

    @property
    def possible(self) -> bool:
        """Whether the group can be met within `TOLERANCE`."""
        return self.worst <= TOLERANCE


def reach(found: PaperIdentification, *, seed: int = 0, progress: Progress | None = None) -> dict[str, Reach]:
    """For each of `GROUPS`, least squares on that group alone, from the identified valve and from random ones."""
    order = [drift.key for drift in PUBLISHED_DRIFTS]
    rng = np.random.default_rng(seed)
    pool = rng.random((SCREENED // 4, len(LOST_VALUES)))
    screened = residuals(pool, found.interpretation)
    result = {}
    for number, (name, keys) in enumerate(GROUPS.items()):
        rows = np.array([order.index(key) for key in keys])
        with_limits = np.append(rows, np.arange(len(PUBLISHED_DRIFTS), len(PUBLISHED_DRIFTS) + 3))
        starts = np.argsort(np.sum(screened[:, with_limits] ** 2, axis=1), kind="stable")[:3]
        best: Any = None
        for sense in (1, -1):
            aim = replace(found.interpretation, sense=sense, directions=True)
            for start in (found.shares, *pool[starts]):
                fit = least_squares(start, aim, ALL_FREE, with_limits, 60)
                if best is None or fit.cost < best[0].cost:
                    best = fit, aim
                if best[0].cost < 1e-6:
                    break
        fit, aim = best
        worst = float(np.max(np.abs(residuals(fit.x[None], aim)[0, rows])))
        result[name] = Reach(keys=tuple(keys), values=turned_values(fit.x, aim)[rows], worst=worst)
        if progress is not None:
            progress(f"what is out of reach, {found.interpretation.title}", (number + 1) / len(GROUPS))
    return result
