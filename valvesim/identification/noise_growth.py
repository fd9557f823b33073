"""Noise that grows with what is read, as a flow meter's does: found from replicates, before any fit.

Symbols
    d difference of two replicates, v their mean; a, r noise at no reading and its growth
    var d / 2 = a^2 (1 + r^2 v^2), by least squares of d^2 over v^2, each weighted by its own variance
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from valvesim.identification.options import IdentificationOptions
from valvesim.identification.prior import largest_reading
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import Record, Session, replicates


def noise_growth(session: Session, *, options: IdentificationOptions) -> dict[str, float]:
    """The growth r (1/unit) of the noise of each channel whose replicates show that it grows."""
    found = {}
    for name in dict.fromkeys(n for record in session.training for n in record.outputs):
        pairs = replicates([record for record in session.training if name in record.outputs])
        series = [_difference(one, other, name) for one, other in pairs]
        if not series:
            continue
        growth = _growth(*map(np.concatenate, zip(*series, strict=True)), options=options)
        if growth > 0.0:
            found[name] = growth
    return found


def grown(growth: float, values: np.ndarray) -> np.ndarray:
    """The deviation (n,) of such noise at readings, as a multiple of that at none."""
    return np.sqrt(1.0 + (growth * values) ** 2)


def growth_notes(session: Session, growth: Mapping[str, float]) -> list[str]:
    """What to say of the growth (1/unit) of channels."""
    notes = []
    for name, r in growth.items():
        times = float(grown(r, np.array(largest_reading(session, name))))
        notes.append(
            f"{name}: its noise grows with the reading, to {times:.2g} times at the largest; "
            "its deviation is given for a reading of zero"
        )
    return notes


def _difference(one: Record, other: Record, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Squares of what neighbouring differences of two replicates turn by, and the squares of their mean reading: drift
    and zeros are no noise.
    """
    n = min(len(one.time), len(other.time))
    both = one.usable[name][:n] & other.usable[name][:n]
    apart = np.where(both, one.values[name][:n] - other.values[name][:n], np.nan)
    mean = 0.5 * (one.values[name][:n] + other.values[name][:n])
    turn = np.diff(apart, 2)[::3]  # independent where the noise is white
    good = np.isfinite(turn)
    return turn[good] ** 2, mean[1:-1][::3][good] ** 2


def _growth(square: np.ndarray, level: np.ndarray, *, options: IdentificationOptions) -> float:
    """The growth r by squares (n,) over squared readings (n,); 0 where it is not significant, or little, or where the
    reading hardly changes.
    """
    if len(square) < options.audit.least_samples or not np.any(square):
        return 0.0
    most = float(np.max(level))
    if np.ptp(level) <= options.audit.least_spread * most:
        return 0.0
    A, weight = np.column_stack([np.ones_like(level), level / most]), np.ones_like(level)
    for _ in range(options.noise.growth_steps):
        base, slope = inverse_of(A.T @ (weight[:, None] * A)) @ (A.T @ (weight * square))
        base = max(float(base), options.noise.growth_floor * float(np.mean(square)))
        variance = base + max(float(slope), 0.0) * level / most
        weight = 1.0 / (2.0 * variance**2)  # of the square of a normal variable
    deviation = float(np.sqrt(inverse_of(A.T @ (weight[:, None] * A))[1, 1]))
    if slope < options.noise.growth_significance * deviation or slope < options.noise.least_growth * base:
        return 0.0
    return float(np.sqrt(slope / (base * most)))
