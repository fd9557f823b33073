"""Model discrepancy: what a cause's law may err by counts as noise where it acts (Kennedy and O'Hagan 2001).

Iron is no operator of Dahl's: a hysteresis is followed to some hundredths of what it does. Where lands pass null that
much of the spool's position is hundreds of noise deviations of the leakage: no fit comes near, figures go to their
limits after those few samples, and the cause is not seen for what its law errs by.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import evaluate_fit, is_adequate
from valvesim.identification.nominal_fit import NominalFit, clipped_to_tolerance, fit_nominal_from
from valvesim.identification.study import Study


def with_model_discrepancy(
    nominal: NominalFit, found: list[FittedHypothesis], *, options: DiagnosisOptions
) -> NominalFit | None:
    """The nominal model fitted again under the discrepancy of the likeliest of those found whose law may err; None
    where one of the found comes near the records, none of their laws may err, or there is a discrepancy already.
    """
    erring = [one for one in found if one.law_error > 0.0]
    near = any(is_adequate(one.fit, options=options.identification) for one in found)
    if near or not erring or nominal.study.discrepancy:
        return None
    likeliest = min(erring, key=lambda one: one.fit.chi_square)
    try:
        study = with_discrepancy_of(nominal.study, likeliest, options=options)
        return fit_nominal_from(study, evaluate_fit(study, clipped_to_tolerance(nominal), ()))
    except (SolveError, InputError):
        return None


def with_discrepancy_of(study: Study, one: FittedHypothesis, *, options: DiagnosisOptions) -> Study:
    """A study in which readings may be off by a share of what the causes do to them whose law may err, by the most of
    that within a few samples.
    """
    exact = tuple(e for e in one.fit.fitted if e.candidate.effect is None or not e.candidate.effect.law_error)
    without = evaluate_fit(study, one.fit.point, exact)
    share, width = options.selection.discrepancy_share, 1 + 2 * options.selection.discrepancy_samples
    discrepancy = {
        (predictor.record.name, name): share * maximum_filter1d(np.abs(read[name] - bare[name]), width)
        for predictor, read, bare in zip(study.predictors, one.fit.readings, without.readings, strict=True)
        for name in read
    }
    return study.with_discrepancy(discrepancy)
