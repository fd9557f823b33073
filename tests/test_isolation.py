"""The steps of an isolation among each other: whose score tests, whose noise, what is fitted and how often."""

from types import SimpleNamespace

import numpy as np

from valvesim.diagnosis import isolation
from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.valve.catalogue import CATALOGUE


def fitted(*names):
    """Catalogue effects at their typical strength."""
    candidates = [Candidate(name, CATALOGUE[name]) for name in names]
    return tuple(FittedCandidate(candidate, candidate.typical) for candidate in candidates)


def hypothesis(chi_square, *names):
    """A hypothesis of catalogue effects, fitted."""
    fit = Fit(np.zeros(1), fitted(*names), chi_square, (), np.zeros(1), 5000.0)
    return FittedHypothesis(fit, options=DIAGNOSIS)


def nominal(chi_square, weights=()):
    """A nominal fit that leaves so much, under a study with those weights."""
    study = SimpleNamespace(weights=dict.fromkeys(weights), options=DIAGNOSIS.identification, noise={})
    return SimpleNamespace(study=study, fit=Fit(np.zeros(1), (), chi_square, (), np.zeros(1), 5000.0))


def test_where_the_nominal_fit_is_exchanged_its_own_score_test_takes_the_place_of_the_old(monkeypatch):
    weighted, full = nominal(90_000.0, ["leakage"]), nominal(95_000.0)
    best = hypothesis(5000.0, "spool_lap")

    def score_test(nominal, fit, *, options):
        return SimpleNamespace(nominal=nominal, fit=fit, options=options)

    monkeypatch.setattr(isolation, "score_test", score_test)
    monkeypatch.setattr(isolation, "with_second_cause", lambda nominal, final, found: (found, final))
    monkeypatch.setattr(isolation, "with_other_pairs", lambda nominal, found, final: (found, final))
    monkeypatch.setattr(isolation, "effects_for_parameters", lambda nominal, scores, found, final: (found, final))
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (full, found, final))
    before = score_test(weighted, weighted.fit, options=DIAGNOSIS)
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is full and scores.nominal is full and scores.fit is full.fit and found == [best]
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (nominal, found, final))
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is weighted and scores is before
