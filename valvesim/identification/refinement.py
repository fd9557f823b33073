"""The last steps of a fit: linearised anew and continued until that gains nothing.

A fit ends where its own Jacobian, which may be some steps old, predicts little more.
"""

from __future__ import annotations

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit
from valvesim.identification.fit_jacobian import jacobian_of, linearise_fit
from valvesim.identification.least_squares import levenberg_marquardt, normal_equations, with_posterior
from valvesim.identification.study import Study


def refined(study: Study, fit: Fit, known: np.ndarray | None = None, enough: float | None = None) -> Fit:
    """A fit near its best continued by Jacobians of its own, with the Occam factor in the end; that of the fit as it
    is, (rows, n) whitened, may be `known`. `enough` is the reduction of the chi-square that ends it (if it is not
    given, `hypothesis_ftol`).

    In a long session, where that takes too long, it is left as it is; and so where it cannot be simulated.
    """
    if study.is_long:
        return fit
    enough = study.options.fit.hypothesis_ftol if enough is None else enough
    for _ in range(study.options.fit.refinements):
        try:
            jacobian = known if known is not None else jacobian_of(study, fit, *linearise_fit(study, fit))
        except (SolveError, InputError):
            return fit
        before, known = fit.chi_square, None
        fit, updated = levenberg_marquardt(study, fit, jacobian, enough)
        H, _ = normal_equations(fit, updated, options=study.options)
        fit = with_posterior(H, fit, options=study.options)
        if before - fit.chi_square < study.options.fit.refined_gain:
            break
    return fit
