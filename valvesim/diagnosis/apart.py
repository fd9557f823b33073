"""Records that do not belong together: one test carries what is left, and without it nothing is."""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.detection import detect
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.score_test import score_test
from valvesim.errors import InputError, SolveError
from valvesim.identification.nominal_fit import NominalFit, fit_nominal_near
from valvesim.identification.study import residual_of, without_test


def odd_test(nominal: NominalFit, *, options: DiagnosisOptions) -> str:
    """The test without which the nominal valve explains the records; "" where there is none, or too few are left."""
    study = nominal.study
    excess: dict[str, float] = {}
    for predictor, read in zip(study.predictors, nominal.fit.readings, strict=True):
        white = study.whiten(predictor, residual_of(predictor.record, read))
        own = sum(float(np.sum(w**2)) - len(w) for w in white)
        excess[predictor.record.test] = excess.get(predictor.record.test, 0.0) + max(own, 0.0)
    worst = max(excess, key=lambda test: excess[test])
    if len(excess) < 3 or excess[worst] < options.selection.record_share * sum(excess.values()):
        return ""
    others = without_test(study.unweighted(), worst)
    names = [p.name for p in study.nominal.parameters]
    point = np.array([nominal.fit.point[names.index(p.name)] for p in others.nominal.parameters])
    limit = options.identification.fit.tolerance_deviations
    try:
        fit = fit_nominal_near(others, np.clip(point, -limit, limit), full_weight=not study.weights)
        alarm, _ = detect(score_test(fit, fit.fit, options=options))
    except (SolveError, InputError):
        return ""
    return "" if alarm else worst
