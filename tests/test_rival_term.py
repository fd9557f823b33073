"""A cause whose law the records do not support: plain terms that explain as much are its rivals."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from valvesim.diagnosis import rival_term
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.diagnosis.rival_term import rival_terms
from valvesim.identification.projection import GramMatrix
from valvesim.valve.additive_term import PORTS, VARIABLES, TermHypothesis

ROWS = 2000
DICE = np.random.default_rng(3)
LAW, OTHER, NOISE = (DICE.normal(size=ROWS) / np.sqrt(ROWS) for _ in range(3))


@dataclass(frozen=True)
class Study:
    candidates: tuple = ()


@dataclass(frozen=True)
class Nominal:
    study: Study


TERMS = (
    TermHypothesis(PORTS["spool_force"], VARIABLES["spool_position"]),
    TermHypothesis(PORTS["pilot_flow"], VARIABLES["current"]),
)


def fitted(*, truth, shown, amount=2.0):
    """The score test of a cause of the law LAW, fitted to records of `truth`; of each term `shown` is what it shows."""
    rest = truth + np.sqrt(ROWS) * NOISE
    known = np.column_stack([np.ones(ROWS), np.linspace(-1.0, 1.0, ROWS)])
    size = amount * float(LAW @ truth) / float(LAW @ LAW)
    columns = [rest - size * LAW / amount, *known.T]
    for one in shown:
        columns += [-0.5 * one, 0.5 * one]  # of two knots, at -1 and 1
    columns.append(-0.05 * size * LAW / amount)
    C = np.column_stack(columns)
    member = SimpleNamespace(candidate=SimpleNamespace(typical=size), above_neutral=size, shapes=())
    fit = SimpleNamespace(layout=[(member, "")], fitted=(member,))
    count = 2 * len(shown)
    gram = GramMatrix((C.T @ C)[None], np.zeros(2), (ROWS,))

    def tested(hypotheses):
        blocks = tuple((k, k + 1) for k in range(0, 2 * len(hypotheses), 2))
        terms = SimpleNamespace(gram=gram, own=(count,), blocks=blocks)
        return SimpleNamespace(fit=fit, options=DIAGNOSIS, hypotheses=hypotheses, terms=terms, linearised=())

    return tested(TERMS[: len(shown)]), tested(())


@pytest.mark.parametrize(
    "truth, shown, rivals",
    [
        (40.0 * LAW, (LAW,), ()),  # at one place alone a term may be the cause's own law
        (40.0 * LAW, (LAW, LAW), TERMS),
        (40.0 * LAW, (OTHER, OTHER), ()),
        (40.0 * (LAW + 0.3 * OTHER), (LAW + 0.3 * OTHER,), TERMS[:1]),  # better than the law of the cause
    ],
)
def test_terms_that_explain_more_or_as_much_at_several_places_are_rivals(monkeypatch, truth, shown, rivals):
    scores, none = fitted(truth=truth, shown=shown)
    monkeypatch.setattr(rival_term, "term_score_test", lambda *_, **__: none)
    monkeypatch.setattr(rival_term, "term_spans", lambda linearised, terms: [(-1.0, 1.0)] * len(terms))
    assert set(rival_terms(Nominal(Study()), scores)) == set(rivals)
