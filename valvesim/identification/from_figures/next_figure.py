"""Which further figure, measured, would pin a valve down most.

Symbols
    s deviation of a figure by what is known so far, e of its measurement; gain ln(1 + s^2/e^2)/2, in nats
Lindley 1956 (information of an experiment).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.specification import FIGURES, Limit
from valvesim.identification.from_figures.posterior import Posterior
from valvesim.identification.from_figures.prediction import Asked, FigurePredictor
from valvesim.identification.from_figures.similarity import UNKNOWNS

ACCURACY = {
    "rated_flow": 0.0125, "flow_gain": 0.0125, "pressure_gain": 0.05,
    "null_leakage": 0.0125, "tare_leakage": 0.0125, "frequency_minus_3_db": 0.02, "frequency_minus_90_deg": 0.02,
    "time_to_90_percent": 0.02,
}  # fmt: skip
"""Figures that a bench can measure, with their standard deviation as a share: half the classes of ISO 10770-1.

Not those of the coils, which tell of nothing but themselves."""
AMPLITUDES = {"frequency_minus_3_db": (0.25, 1.0), "frequency_minus_90_deg": (0.25, 1.0), "time_to_90_percent": (1.0,)}


@dataclass(frozen=True)
class NextFigure:
    """A figure to measure: what is expected of it, SI, its gain in nats, and the unknown that it narrows most with its
    deviation before and after, in prior standard deviations.
    """  # fmt: skip

    limit: Limit
    expected: float
    deviation: float
    gain: float
    narrows: str
    before: float
    after: float

    @property
    def interval(self) -> tuple[float, float]:
        """Where it is expected, 95 %, by factors: all of `ACCURACY` are positive."""
        factor = math.exp(1.96 * self.deviation / self.expected)
        return self.expected / factor, self.expected * factor


def next_figures(posterior: Posterior, predictor: FigurePredictor) -> tuple[NextFigure, ...]:
    """Every figure that was not asked for, by falling gain."""
    known = [(a.limit.figure, round(a.limit.conditions.get("amplitude", 0.0), 2)) for a in posterior.asked]
    candidates = []
    for name in ACCURACY:
        defaults = {key: value for key, value in FIGURES[name].conditions.items() if value > 0.0}
        for amplitude in AMPLITUDES.get(name, (None,)):
            if (name, amplitude or 0.0) in known:
                continue
            own = {**defaults, **({} if amplitude is None else {"amplitude": amplitude})}
            candidates.append(Limit(figure=name, conditions=own))
    n, similar, step = len(posterior.point), posterior.similar, predictor.options.posterior.step
    options = predictor.options.next_figure
    points = posterior.point + step * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])
    guess = {"frequency_minus_3_db": 100.0, "frequency_minus_90_deg": 150.0, "time_to_90_percent": 5e-3}
    expected = np.array([_expected(posterior, limit.figure, guess.get(limit.figure, 1.0)) for limit in candidates])

    def predicted(at: np.ndarray) -> np.ndarray:
        asked = tuple(Asked(limit, value, 1.0) for limit, value in zip(candidates, expected, strict=True))
        return replace(predictor, asked=asked).predict(similar.valves(at), len(at))

    for _ in range(options.rounds):
        before, expected = expected, predicted(points[:1])[0]
        if np.allclose(expected, before, rtol=options.settled, atol=0.0):
            break
    figures = predicted(points)
    expected = figures[0]
    slopes = (figures[1 : n + 1] - figures[n + 1 :]).T / (2.0 * step)
    C = posterior.covariance
    found = []
    for limit, value, slope in zip(candidates, expected, slopes, strict=True):
        error, shared = ACCURACY[limit.figure] * abs(value), C @ slope
        variance = float(slope @ shared)
        left = np.diag(C) - shared**2 / (variance + error**2)
        k = int(np.argmax(np.diag(C) - left))
        found.append(NextFigure(
            limit, float(value), float(np.sqrt(variance)), 0.5 * float(np.log1p(variance / error**2)),
            UNKNOWNS[k].name, float(np.sqrt(C[k, k])), float(np.sqrt(left[k])),
        ))  # fmt: skip
    return tuple(sorted(found, key=lambda one: -one.gain))


def _expected(posterior: Posterior, figure: str, otherwise: float) -> float:
    """What the same figure was found to be at another condition."""
    found = [v for a, v in zip(posterior.asked, posterior.predicted, strict=True) if a.limit.figure == figure]
    return float(found[0]) if found else otherwise
