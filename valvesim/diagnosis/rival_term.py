"""Whether plain free terms explain as much as the one cause of an answer: then its law is not what the records show.

All is linear, about the fit of the cause: what the records would leave without it is held against the cause itself, and
against terms of one figure (linear, square, of one direction, lagged, hysteretic) at every port. A term that explains
more is a rival. So are terms at several places that explain as much; at one place alone it may be the cause's own law.

Symbols
    s, H scores and overlap of columns off the nuisance parameters (`projection`); n steps of each own column that take
    the cause away; s0 = s - H n what the columns see of the records without it; w values of a form at a term's knots
    reduction of the chi-square by a form: (w's0)^2 / w'Hw
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from valvesim.diagnosis.options import MissingTermOptions
from valvesim.diagnosis.score_test import ScoreTest, term_score_test, term_spans
from valvesim.diagnosis.symbolic_form import PLAIN_FORMS
from valvesim.identification.fit_jacobian import perturbation
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.projection import ProjectedScores, block_statistic, direction_statistic, project
from valvesim.valve.additive_term import LAG, NONE, PATH, PORTS, VARIABLES, TermHypothesis

FORMS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], ...]] = {
    NONE: tuple(PLAIN_FORMS.values()),
    LAG: (lambda u: u,),
    PATH: (np.ones_like, np.abs),
}
"""Forms of one figure by a term's memory, as functions of its variable."""


def rival_terms(nominal: NominalFit, final: ScoreTest) -> tuple[TermHypothesis, ...]:
    """The term hypotheses that explain as much as the cause of a fit, whose score test is `final`, best first; none
    where its own law does alone.
    """
    options = final.options.missing_term
    remembering = term_score_test(
        nominal, final.fit, _remembering(final, options), 2, known=final, options=final.options
    )
    own, _ = block_statistic(_without_cause(final), final.terms.own)
    best: dict[tuple[str, str], tuple[float, TermHypothesis]] = {}
    for scores in (final, remembering):
        for reduction, term in _reductions(scores):
            place = term.port.name, term.variable.name
            if reduction > best.get(place, (own - options.rival_margin, None))[0]:
                best[place] = reduction, term
    rivals = sorted(best.values(), key=lambda each: -each[0])
    better = [term for reduction, term in rivals if reduction > own + options.rival_margin]
    return tuple(better or ([term for _, term in rivals] if len(rivals) > 1 else ()))


def _remembering(final: ScoreTest, options: MissingTermOptions) -> list[TermHypothesis]:
    """Terms with memory at the ports of the equations, of several paces and of those that the fit has found."""
    found = {value for member in final.fit.fitted for name, value in member.shapes if name == "time_constant"}
    terms = []
    for port in PORTS.values():
        if port.name in ("load_flow", "internal_leakage"):
            continue
        for variable in VARIABLES.values():
            terms += [TermHypothesis(port, variable, LAG, time) for time in sorted({*options.rival_times, *found})]
            widths = options.rival_widths if variable.rate else ()
            terms += [TermHypothesis(port, variable, PATH, width=width * variable.scale) for width in widths]
    return terms


def _without_cause(scores: ScoreTest) -> ProjectedScores:
    """The terms of a score test, held against what the fit would leave without its fitted candidates."""
    gram, own = scores.terms.gram, list(scores.terms.own)
    projected = project(gram, 0, gram.total.shape[0] - 1 - gram.parameters)
    steps = [0.0 if shape else -member.above_neutral / perturbation(member) for member, shape in scores.fit.layout]
    score = projected.score - projected.overlap[:, own] @ np.array(steps)
    return replace(projected, score=score)


def _reductions(scores: ScoreTest) -> list[tuple[float, TermHypothesis]]:
    """What each term hypothesis of a score test explains, without the cause, in the best of its forms."""
    projected, found = _without_cause(scores), []
    spans = term_spans(scores.linearised, scores.hypotheses)
    for term, block, span in zip(scores.hypotheses, scores.terms.blocks, spans, strict=True):
        knots = np.linspace(*span, len(block)) / np.max(np.abs(span))
        falls = [direction_statistic(projected, block, form(knots))[1] for form in FORMS[term.memory]]
        found.append((max(falls), term))
    return found
