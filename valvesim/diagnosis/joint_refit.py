"""How far apart two hypotheses stay in a further experiment once the wrong one is fitted to session and experiment
together, by simulation: linear answers about a fit do not tell how far a bent valley lets it follow.

Symbols
    delta whitened difference of the two in the experiment, D the penalised chi-square of the wrong one where the
    session has been measured and the experiment reads as the true one does; n replicates
    d^2 = n |delta|^2 - (D before - D after the refit)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valvesim.errors import SolveError
from valvesim.identification.fit import Fit, evaluate_fit
from valvesim.identification.hypothesis_fit import continue_from
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import RecordPredictor
from valvesim.identification.study import Study, with_experiment


def joint_distance(
    nominal: NominalFit, predictor: RecordPredictor, true: Fit, wrong: Fit, replicates: int, most: float = np.inf
) -> float:
    """The distance d that a refit of the `wrong` of two fits of a study leaves of the `true` one in an experiment on a
    predictor, replicated; the refit ends where it does not promise to leave less than `most`. Raises SolveError,
    InputError where that cannot be simulated.
    """
    study = _as_measured(nominal.study, predictor, true, replicates)
    before = evaluate_fit(study, wrong.point, wrong.fitted)
    shown = before.residual[len(nominal.fit.residual) :]
    of_session = before.chi_square - float(shown @ shown)
    after = continue_from(replace(nominal, study=study), before, of_session + most**2)
    if after is None:
        raise SolveError(f"{predictor.where}no refit of the hypothesis can be simulated")
    return float(np.sqrt(max(after.chi_square - of_session, 0.0)))


def _as_measured(study: Study, predictor: RecordPredictor, fit: Fit, replicates: int) -> Study:
    """The study with the experiment besides, as a fit would read it: free of noise, and weighted as replicated."""
    variant = fit.variant(study.nominal)
    readings = predictor.readings(predictor.run(variant), variant)
    record = replace(predictor.record, values={**predictor.record.values, **readings})
    return with_experiment(study, replace(predictor, record=record), replicates)
