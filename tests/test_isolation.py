"""The steps of an isolation among each other: whose score tests, whose noise, what is fitted and how often."""

from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import diagnose as diagnosing
from valvesim.diagnosis import isolation
from valvesim.diagnosis.detection import beyond_noise, verified_chi_square
from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.noise_model import NoiseModel
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
    no_starts = frozenset()
    monkeypatch.setattr(
        isolation, "effects_for_parameters", lambda nominal, scores, found, final: (found, final, no_starts)
    )
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (full, found, final))
    before = score_test(weighted, weighted.fit, options=DIAGNOSIS)
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is full and scores.nominal is full and scores.fit is full.fit and found == [best]
    monkeypatch.setattr(isolation, "at_full_weight", lambda nominal, found, final: (nominal, found, final))
    ended, scores, found, _ = isolation._verified(weighted, before, 4.0, [best])
    assert ended is weighted and scores is before


ROWS, CHANNELS = 400, ("spool_position", "load_flow")


def white_study(verified, excess, seed=0):
    """A study of one record of white noise of unit size, and a fit that leaves (1 + excess) times it."""
    rng = np.random.default_rng(seed)
    values = {name: rng.normal(size=ROWS) * np.sqrt(1.0 + by) for name, by in zip(CHANNELS, excess, strict=True)}
    record = SimpleNamespace(name="one", outputs=CHANNELS, pace=1e3, values=values)
    noise = {
        (name, 1e3): NoiseModel(1.0, (), known, "repeats" if known else "residual")
        for name, known in zip(CHANNELS, verified, strict=True)
    }
    study = SimpleNamespace(
        predictors=[SimpleNamespace(record=record)],
        noise=noise,
        weights={},
        whiten=lambda predictor, left: [left[name] for name in CHANNELS],
    )
    residual, zero = np.concatenate(list(values.values())), {name: np.zeros(ROWS) for name in CHANNELS}
    return study, Fit(np.ones(2), (), float(residual @ residual) + 2.0, (zero,), residual, 2.0 * ROWS)


@pytest.mark.parametrize(
    "verified, excess, exceeds",
    [
        ((True, True), (0.0, 0.0), False),
        ((True, True), (1.0, 0.0), True),
        ((True, False), (1.0, 0.0), True),  # the other channel's noise says nothing of this one
        ((False, True), (1.0, 0.0), False),  # what it leaves is its noise
        ((False, True), (0.0, 1.0), True),
        ((False, False), (5.0, 5.0), False),
    ],
)
def test_more_than_the_noise_is_looked_for_in_every_channel_whose_noise_is_verified(verified, excess, exceeds):
    study, fit = white_study(verified, excess)
    assert (beyond_noise(fit, study, options=DIAGNOSIS) > 0.0) is exceeds


def test_the_parts_of_channels_add_up_to_the_chi_square():
    whole, first, second, none = (
        np.array(verified_chi_square(*reversed(white_study(verified, (0.3, 0.0)))))
        for verified in ((True, True), (True, False), (False, True), (False, False))
    )
    assert first + second == pytest.approx(whole) and not none.any()
    assert whole[1] == 2 * ROWS


@pytest.mark.parametrize("inadequate", [True, False])
def test_of_an_answer_set_that_was_emptied_no_candidate_is_told_to_be_in_it(inadequate, monkeypatch):
    best, base, told = hypothesis(4900.0, "spool_lap"), nominal(9000.0), {}
    scores = SimpleNamespace(options=DIAGNOSIS)
    ended = isolation.Isolation(base, scores, scores, [best], [best], "", True, 4.0)

    class Told(Exception):
        pass

    def verdict_of(*given):
        raise Told

    def answers(*given, options):
        told["candidates"] = own(*given, options=options)
        return told["candidates"]

    own = diagnosing.candidate_answers
    base.study.session = SimpleNamespace(notes=())
    monkeypatch.setattr(diagnosing, "is_inadequate", lambda nominal, fit, options: inadequate)
    monkeypatch.setattr(diagnosing, "_far_off", lambda study, point: "")
    monkeypatch.setattr(diagnosing, "candidate_answers", answers)
    monkeypatch.setattr(diagnosing, "verdict_of", verdict_of)
    with pytest.raises(Told):
        diagnosing._answer(ended)
    in_set = {answer.label for answer in told["candidates"] if answer.in_set}
    assert in_set == ({"none of the known causes"} if inadequate else {"spool_lap"})
