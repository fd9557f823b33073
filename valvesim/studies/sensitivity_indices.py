"""Which quantity the spread of a figure comes from: Sobol indices of a Saltelli design, else shares by regression.

Symbols
    V variance of a figure, S_i = V(E(y|x_i))/V first-order index, T_i = E(V(y|x_~i))/V total index (Sobol 2001)
    b_i slope of the least-squares plane over standardised quantities, b_i^2/(sum b^2 + variance about the plane) its
    share (of independent quantities, whatever the draws happen to correlate), R^2 what the plane explains

The indices are SALib's: first order by Saltelli et al. (2010), total by Jansen (1999), intervals by bootstrap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError
from valvesim.studies.designs import saltelli_problem
from valvesim.studies.study_result import CONFIDENCE, StudyResult

RESAMPLES = 100  # of the bootstrap


@dataclass(frozen=True)
class SensitivityIndices:
    """Shares of the variance of one figure by quantity, all (variables,): first order and total with half the width of
    their intervals. By regression `total` is NaN, and `explained` is R^2 (NaN of Sobol indices). `used` members.
    """

    figure: str
    keys: tuple[str, ...]
    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    explained: float
    used: int

    @property
    def are_sobol(self) -> bool:
        """Whether they are Sobol indices; otherwise shares by regression."""
        return bool(np.isnan(self.explained))

    @property
    def order(self) -> np.ndarray:
        """Places of the quantities, that of the greatest share first."""
        return np.argsort(-np.nan_to_num(self.total if self.are_sobol else self.first), kind="stable")


def sensitivity_indices(result: StudyResult, figure: str) -> SensitivityIndices:
    """The indices of a figure: Sobol's where the design is "saltelli", else by linear regression.

    Raises InputError where too few members have the figure, or it does not vary.
    """
    values = np.where(result.ran, result.column(figure), np.nan)
    if result.study.design.kind == "saltelli":
        return _sobol(result, figure, values)
    return _regression(result, figure, values)


def _sobol(result: StudyResult, figure: str, values: np.ndarray) -> SensitivityIndices:
    """Sobol indices from the base samples of which every member has the figure."""
    from SALib.analyze import sobol

    keys = result.study.keys
    groups = values.reshape(-1, len(keys) + 2)
    whole = groups[np.isfinite(groups).all(axis=1)]
    if len(whole) < 2 or np.ptp(whole) == 0.0:
        raise InputError(f"too few members have {figure}, or it does not vary: no indices", key=figure)
    found = sobol.analyze(
        saltelli_problem(keys), whole.ravel(), calc_second_order=False, num_resamples=RESAMPLES,
        conf_level=CONFIDENCE, seed=result.study.design.seed,
    )  # fmt: skip
    first, first_error, total, total_error = (np.asarray(found[name]) for name in ("S1", "S1_conf", "ST", "ST_conf"))
    return SensitivityIndices(figure, keys, first, first_error, total, total_error, np.nan, whole.size)


def _regression(result: StudyResult, figure: str, values: np.ndarray) -> SensitivityIndices:
    """Squared standardised regression coefficients, by least squares."""
    from scipy.stats import t

    keys, here = result.study.keys, np.isfinite(values)
    x, y = result.draws[here], values[here]
    n, d = x.shape
    spread = np.std(x, axis=0) if n else np.zeros(d)
    moving = spread > 0.0
    if n <= d + 2 or np.ptp(y) == 0.0:
        raise InputError(f"too few members have {figure}, or it does not vary: no shares", key=figure)
    z = (x[:, moving] - x[:, moving].mean(axis=0)) / spread[moving]
    centred = (y - y.mean()) / y.std()
    gram = z.T @ z  # of a million members the products are held, not a second copy of them
    slopes, _, rank, _ = np.linalg.lstsq(gram, z.T @ centred, rcond=1e-12)
    left = centred - z @ slopes
    explained = 1.0 - float(left @ left) / n
    freedom = max(n - int(rank) - 1, 1)
    error = np.sqrt(np.diag(np.linalg.pinv(gram)) * float(left @ left) / freedom)
    reach = float(t.ppf(0.5 + CONFIDENCE / 2.0, freedom)) * error
    first, first_error = np.zeros(d), np.zeros(d)
    total = float(slopes @ slopes + left @ left / n)
    first[moving], first_error[moving] = slopes**2 / total, 2.0 * np.abs(slopes) * reach / total
    nothing = np.full(d, np.nan)
    return SensitivityIndices(figure, keys, first, first_error, nothing, nothing, explained, n)
