"""Whether a recovered term is an entry of the catalogue: one that acts where it does, fitted from where it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valvesim.diagnosis.detection import at_limit
from valvesim.diagnosis.isolation import Isolation, judged
from valvesim.diagnosis.missing_term import RecoveredTerm
from valvesim.diagnosis.model_selection import FittedHypothesis, distinct
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.diagnosis.starts import at_typical
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import FittedCandidate, largest_adequate
from valvesim.identification.hypothesis_fit import fit_hypothesis
from valvesim.valve.additive_term import term_effect


def as_catalogue_entry(isolation: Isolation, recovered: RecoveredTerm) -> Isolation:
    """The isolation with the entries that explain what a recovered term does, for less freedom; else as it was. What
    the law of a likeliest cause may err by is no other entry's doing.
    """
    nominal, options = isolation.nominal, isolation.scores.options
    gained = nominal.fit.chi_square - recovered.chi_square
    most = recovered.chi_square + max(options.selection.answer_ratio, options.selection.answer_share * gained)
    if isolation.answer_set:
        likeliest = isolation.answer_set[0]
        may_err = likeliest.law_may_leave(nominal.fit)
        most = min(most, likeliest.fit.chi_square - may_err) if may_err > 0.0 else most
    if most < recovered.chi_square:  # the term itself explains less
        return isolation
    near = max(most, largest_adequate(nominal.fit, options=options.identification))
    fits = [
        fit_hypothesis(nominal, start, np.clip(recovered.point, *nominal.study.nominal.limits), worthwhile=near)
        for start in _entries_at(isolation.scores, recovered.term.port)
    ]
    entries = [
        FittedHypothesis(fit, options=options)
        for fit in fits
        if fit is not None
        and fit.chi_square - fit.predicted_reduction < most
        and not at_limit(fit, nominal.study).any()
    ]
    if not entries:
        return isolation
    found = distinct([*isolation.found, *entries], options=options)
    return judged(replace(isolation, found=found, final=score_test(nominal, found[0].fit, options=options)))


def _entries_at(scores: ScoreTest, port: str) -> list[tuple[FittedCandidate, ...]]:
    """The catalogue's effects that act in the balance of a port, each at its typical amplitude, as starts of refits."""
    linear = scores.linearised[0]
    unit = term_effect(port, "current", (0.0, 1.0), (1.0, 1.0), name="unit_term")
    own = _balance(linear.forcing(linear.variant.with_effect(unit(share=1.0))).rates)
    starts: dict[str, tuple[FittedCandidate, ...]] = {}
    for k, candidate in enumerate(scores.candidates):
        if candidate.effect is None or candidate.effect.balance is None or candidate.label in starts:
            continue
        try:
            member = at_typical(scores, k)
            forcing = linear.forcing(member.apply_to(linear.variant)).rates
        except (SolveError, InputError):
            continue
        if np.any(forcing) and _balance(forcing) == own:
            starts[candidate.label] = (member,)
    return list(starts.values())


def _balance(forcing: np.ndarray) -> int:
    """The state whose balance a forcing (n, s) acts in."""
    return int(np.argmax(np.sum(forcing**2, axis=0)))
