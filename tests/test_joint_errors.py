"""Errors of the instruments that explain together what none does by itself."""

from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import joint_errors, known_faults
from valvesim.diagnosis.known_faults import BenchFault
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION


@pytest.mark.parametrize(
    "shift, clock, explained",
    [
        (1.0, 0.05, 441.6),
        (3.0, 0.0, None),  # one of them is told
        (0.15, 0.15, None),  # together by chance, of so many
    ],
)
def test_errors_of_instruments_that_explain_much_together_and_nothing_by_themselves_are_told(
    monkeypatch, shift, clock, explained
):
    """The readings tell a shift and a clock apart a little, and see next to nothing of a drift."""
    parameters = [SimpleNamespace(name=name, at=lambda t: t) for name in ("spool_mass", "shift", "clock", "drift")]
    errors = parameters[1:]
    study = SimpleNamespace(session=None, options=IDENTIFICATION, nominal=SimpleNamespace(parameters=parameters))
    monkeypatch.setattr(joint_errors, "instrument_errors", lambda session, *, options: errors)
    known = [
        BenchFault((p,), lambda values, own=p: f"{own.name} by {values[0]:.3f}", None)
        for p in (*errors, SimpleNamespace(name="wave"))
    ]
    for module in (joint_errors, known_faults):
        monkeypatch.setattr(module, "all_known_faults", lambda study: known)
    overlap = np.eye(4)
    overlap[1:3, 1:3] = [[400.0, 396.0], [396.0, 400.0]]
    total = np.zeros((5, 5))
    total[1:, 1:] = overlap
    point = np.array([0.0, shift, clock, 0.1])
    scores = SimpleNamespace(
        study=study, own=(), fit=SimpleNamespace(point=point, chi_square=1000.0),
        gram=SimpleNamespace(total=total, parameters=4, prior_now=point),
    )  # fmt: skip
    found = joint_errors.joint_instrument_errors(scores, options=DIAGNOSIS)
    least_gain = DIAGNOSIS.bench.minimum_gain
    by_chance = joint_errors.instrument_errors_are_insignificant(scores, least_gain, options=DIAGNOSIS)
    assert by_chance == (found is None and shift < 1.0)
    if explained is None:
        assert found is None
        return
    assert found.explained == pytest.approx(explained, abs=0.1)
    assert found.fewest == (f"shift by {shift + clock * 396.0 / 401.0:.3f}",)
    lost = clock**2 * (401.0 - 396.0**2 / 401.0) + 2.0 * 0.1**2
    assert found.evidence == pytest.approx(1000.0 + lost + np.log(2.0 * 401.0))
