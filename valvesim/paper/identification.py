"""The valve of the paper's lost Table 4 identified: the one that comes closest to the published drifts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.paper.interpretations import Interpretation
from valvesim.paper.published import PUBLISHED_DRIFTS, PUBLISHED_TRAVEL, TOLERANCE, Progress
from valvesim.paper.route_drift import (
    FIT_CURRENTS,
    FIT_TEMPERATURES,
    drift_values,
    drifts,
)
from valvesim.paper.unknowns import LOST_VALUES, valves
from valvesim.valve.parameters import Valve


def residuals(shares: np.ndarray, interpretation: Interpretation) -> np.ndarray:
    """(k, 11 + 3): computed/published - 1 of each drift, then what keeps a valve stable and within its travel.

    Directions count where the interpretation says so and the paper tells them. The last three are zero for a valve
    that is stable with 2 % to spare, with and without magnet, and whose flapper travels less than 2.5 % of its gap at
    1 mA.
    """
    valve = valves(shares, flow_coefficients=interpretation.flow_coefficients)
    d = drifts(valve, printed_signs=interpretation.printed_signs, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS)
    values = drift_values(d, FIT_TEMPERATURES)
    misses = []
    for value, drift in zip(values.T, PUBLISHED_DRIFTS, strict=True):
        direction = interpretation.directions * interpretation.sense * drift.direction
        misses.append((value * direction if direction else np.abs(value)) / drift.size - 1.0)
    limits = (
        300.0 * np.maximum(0.0, 0.02 - d.stiffness),
        300.0 * np.maximum(0.0, 0.02 - d.mechanical),
        3.0 * np.maximum(0.0, d.travel[0] / (PUBLISHED_TRAVEL / 100.0) - 1.0),
    )
    return np.clip(np.nan_to_num(np.stack([*misses, *limits], axis=-1), nan=1e3), -1e3, 1e3)


def misfit(residual: np.ndarray) -> float:
    """Root mean square of the relative misses of the drifts, in percent."""
    return 100.0 * float(np.sqrt(np.mean(residual[: len(PUBLISHED_DRIFTS)] ** 2)))


def least_squares(
    start: np.ndarray, interpretation: Interpretation, free: np.ndarray, rows: np.ndarray, evaluations: int
) -> Any:
    """Bounded least squares over the free parameters; one batch of valves gives residual and Jacobian."""
    from scipy import optimize

    width = 1e-6
    base = np.clip(start, 0.0, 1.0)

    def full(u: np.ndarray) -> np.ndarray:
        shares = np.tile(base, (len(u), 1))
        shares[:, free] = u
        return residuals(shares, interpretation)[:, rows]

    def jacobian(u: np.ndarray) -> np.ndarray:
        step = np.where(u + width > 1.0, -width, width)
        r = full(np.vstack([u, u + np.diag(step)]))
        return ((r[1:] - r[0]) / step[:, None]).T

    return optimize.least_squares(
        lambda u: full(u[None])[0], np.clip(base[free], 1e-5, 1.0 - 1e-5), jacobian, bounds=(0.0, 1.0),
        max_nfev=evaluations, xtol=1e-6, ftol=1e-7,
    )  # fmt: skip


ALL_ROWS = np.arange(len(PUBLISHED_DRIFTS) + 3)
ALL_FREE = np.arange(len(LOST_VALUES))
STARTS = 24
SCREENED = 4000  # random valves, of which the best are refined


@dataclass(frozen=True, kw_only=True)
class PaperIdentification:
    """The valve that comes closest, under one interpretation."""

    interpretation: Interpretation  # with the sense that comes closer
    shares: np.ndarray  # (18,) of the logarithmic ranges
    values: np.ndarray  # (11,) %, turned
    misfit: float  # %
    misfits: np.ndarray  # (starts,) %, ascending
    within_1: np.ndarray  # (starts that come within one percentage point, 18)
    valve: Valve  # every field a float
    misses: np.ndarray  # (11,) relative; its size alone where the direction is not told or not asked for

    @property
    def reached(self) -> np.ndarray:
        """Which drifts are met within `TOLERANCE`."""
        return np.abs(self.misses) <= TOLERANCE


def identify_lost_values(
    interpretation: Interpretation, *, seed: int = 0, starts: int = STARTS, progress: Progress | None = None
) -> PaperIdentification:
    """Screen random valves, refine the best `starts` of them by bounded least squares, keep the best.

    Half of the starts aim at the directions in either sense.
    The same seed and number of starts give the same answer. Raises InputError for starts < 1.
    """
    if starts < 1:
        raise InputError(f"identification: {starts} starts; at least 1 is needed")
    shares = np.random.default_rng(seed).random((SCREENED, len(LOST_VALUES)))
    senses = [replace(interpretation, sense=sense) for sense in ((1, -1) if interpretation.directions else (1,))]
    begin = []
    for each in senses:
        cost = np.concatenate([np.sum(residuals(s, each) ** 2, axis=1) for s in np.array_split(shares, 16)])
        begin += [(each, shares[k]) for k in np.argsort(cost, kind="stable")[: -(-starts // len(senses))]]
    found = []
    for number, (each, start) in enumerate(begin):
        found.append((least_squares(start, each, ALL_FREE, ALL_ROWS, 120), each))
        if progress is not None:
            progress(f"identifying {interpretation.title}", (number + 1) / len(begin))
    found.sort(key=lambda pair: pair[0].cost)
    best, aim = found[0]
    closest = aim
    if not interpretation.directions:
        closest = replace(interpretation, sense=-1 if turned_values(best.x, interpretation)[0] > 0.0 else 1)
    alike = [fit for fit, each in found if each == aim and misfit(fit.fun) <= misfit(best.fun) + 1.0]
    return PaperIdentification(
        interpretation=closest,
        shares=best.x,
        values=turned_values(best.x, closest, steps=10),
        misfit=misfit(best.fun),
        misfits=np.array([misfit(fit.fun) for fit, _ in found]),
        within_1=np.array([fit.x for fit in alike]),
        valve=_one_valve(best.x, closest),
        misses=residuals(best.x[None], closest)[0, : len(PUBLISHED_DRIFTS)],
    )


def _one_valve(shares: np.ndarray, interpretation: Interpretation) -> Valve:
    """The valve of shares (18,), every field a float."""
    batch = valves(shares[None], flow_coefficients=interpretation.flow_coefficients)
    values: dict[str, Any] = {u.name: float(getattr(batch, u.name)[0, 0]) for u in LOST_VALUES}
    return replace(batch, **values)


def turned_values(shares: np.ndarray, interpretation: Interpretation, *, steps: int = 1) -> np.ndarray:
    """(11,) drifts of one valve, turned so that the published flow coefficients count as negative."""
    valve = valves(shares[None], flow_coefficients=interpretation.flow_coefficients)
    signs = interpretation.printed_signs
    d = drifts(valve, printed_signs=signs, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS, steps=steps)
    return interpretation.sense * drift_values(d, FIT_TEMPERATURES)[0]
