"""The last steps of a fit, by differences of runs: there the linearised equations are too coarse.

Their columns err by some hundredths where a command jumps or a land passes null. That is little for a step towards the
best fit. At the best fit it is not: the errors meet the noise, and their product moves what the records hardly see.
"""

from __future__ import annotations

from dataclasses import replace

from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit
from valvesim.identification.fit_jacobian import linearise_fit, simulated_jacobian
from valvesim.identification.least_squares import levenberg_marquardt, normal_equations, occam_factor
from valvesim.identification.study import Study


def refined(study: Study, fit: Fit) -> Fit:
    """A fit near its best continued by a Jacobian of differences, with the Occam factor in the end.

    In a long session, where that takes too long, it is left as it is; and so where it cannot be simulated.
    """
    if study.is_long:
        return fit
    enough = study.options.fit.hypothesis_ftol
    for _ in range(study.options.fit.refinements):
        try:
            jacobian = simulated_jacobian(study, fit, *linearise_fit(study, fit))
        except (SolveError, InputError):
            return fit
        before = fit.chi_square
        fit, jacobian = levenberg_marquardt(study, fit, jacobian, enough)
        H, _ = normal_equations(fit, jacobian, options=study.options)
        fit = replace(fit, occam_factor=occam_factor(H, fit, options=study.options))
        if before - fit.chi_square < study.options.fit.refined_gain:
            break
    return fit
