"""Down-weighting of samples: those far off the model, and those next to peaks that the model cannot place.

Weights 1/sqrt(1 + (r/c)^2) are those of a robust loss (Huber, Robust Statistics; iteratively reweighted least squares).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.study import Study, residual_of


def robust_weights(study: Study, readings: Sequence[dict[str, np.ndarray]]) -> Study:
    """The study with samples that are far off the readings counting less."""
    study = study.unweighted()
    pairs = zip(study.predictors, readings, strict=True)
    white = [r[:, 0] for predictor, read in pairs for r in study.whiten(predictor, residual_of(predictor.record, read))]
    return study.with_weights(
        [
            1.0 / np.hypot(1.0, r / (study.options.fit.robust_scale * max(float(np.median(np.abs(r))), 1.0)))
            for r in white
        ]
    )


def down_weight_peaks(study: Study, linearised: Sequence[LinearisedRecord]) -> Study:
    """The study with samples next to a sharp peak of a reading counting less.

    Where a closing land passes null, leakage rises and falls within a tenth of a millisecond: there a sample tells more
    of sensor and solver than of the valve, and it says nothing of where the peak should be.
    """
    weights = []
    for linear in linearised:
        record = linear.predictor.record
        curvatures = linear.predictor.curvatures(linear.trajectory, linear.variant)
        for name in record.outputs:
            noise = study.noise[name, record.pace]
            row = 1.0 / np.hypot(1.0, study.options.fit.peak_share * curvatures[name] / noise.innovation)
            for _ in noise.lags:  # a row holds samples before its own
                row[1:] = np.minimum(row[1:], row[:-1])
            weights.append(row[noise.kept(record.usable[name])][:: study.stride])
    return study.with_weights(weights)
