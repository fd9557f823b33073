"""Percentiles of channels over time from counts: what is kept does not grow with the members, and any order will do.

Each value y is counted by its deviation from the nominal run in bins even in asinh: narrow next to the nominal run, and
in proportion to the deviation beyond. Counts are whole numbers, so that blocks add up to the same in any order.

Symbols
    S span of the nominal channel (its scale where it rests), d = y - y_nominal, s = 1e-5 S
    bin = (asinh(d/s) + R)/(2 R) bins, R = asinh(1e9): a bin is 2 R/bins = 4.2 % of the deviation wide
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BINS = 1024
SMALLEST_SHARE = 1e-5  # of the span, within which bins are even
HALF_RANGE = float(np.arcsinh(1e9))  # ten thousand spans


@dataclass(frozen=True)
class Reference:
    """The nominal run at the times of the percentiles: values (channels, n_t) and spans (channels,)."""

    values: np.ndarray
    spans: np.ndarray


def reference_of(values: np.ndarray, scales: np.ndarray) -> Reference:
    """From the nominal run (channels, n_t) and the scales (channels,) of its channels."""
    spans = np.ptp(values, axis=1)
    return Reference(values, np.where(spans > 1e-9 * scales, spans, scales))


def count(counts: np.ndarray, reference: Reference, values: np.ndarray) -> None:
    """Add one member's values (channels, n_t) to `counts` (channels, n_t, BINS); what is no number counts nowhere."""
    scaled = (values - reference.values) / (SMALLEST_SHARE * reference.spans[:, None])
    finite = np.isfinite(scaled)
    places = (np.arcsinh(np.where(finite, scaled, 0.0)) + HALF_RANGE) / (2.0 * HALF_RANGE) * BINS
    bins = np.clip(places.astype(int), 0, BINS - 1)
    channel, time = np.nonzero(finite)
    counts[channel, time, bins[channel, time]] += 1


def percentiles(
    counts: np.ndarray, reference: Reference, lowest: np.ndarray, highest: np.ndarray, levels: np.ndarray
) -> np.ndarray:
    """Percentiles (channels, levels, n_t) at `levels` (%, of 0 to 100) from all counts, straight within a bin.

    `lowest` and `highest` (channels, n_t) are those of all members, which none leaves. NaN where nothing was counted.
    """
    edges = np.sinh((np.arange(BINS + 1) / BINS * 2.0 - 1.0) * HALF_RANGE) * SMALLEST_SHARE
    out = np.full((counts.shape[0], len(levels), counts.shape[1]), np.nan)
    below = np.concatenate([np.zeros((*counts.shape[:2], 1)), np.cumsum(counts, axis=2)], axis=2)
    for c in range(counts.shape[0]):
        for t in range(counts.shape[1]):
            total = below[c, t, -1]
            if total == 0:
                continue
            wanted = np.asarray(levels) / 100.0 * total
            k = np.clip(np.searchsorted(below[c, t], wanted, side="left") - 1, 0, BINS - 1)
            inside = np.maximum(below[c, t, k + 1] - below[c, t, k], 1.0)
            share = np.clip((wanted - below[c, t, k]) / inside, 0.0, 1.0)
            value = reference.values[c, t] + reference.spans[c] * (edges[k] + share * (edges[k + 1] - edges[k]))
            out[c, :, t] = np.clip(value, lowest[c, t], highest[c, t])
    return out
