"""A term of one parameter: where a term on knots would cost more than it explains, a plain form may explain it.

Each form is held against what a fit leaves, at every port and of every variable, by the linearised equations; the few
that explain most are fitted inside the simulation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.missing_term import RecoveredTerm
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import Term
from valvesim.diagnosis.score_test import ScoreTest, term_spans
from valvesim.diagnosis.symbolic_form import PLAIN_FORMS, SYMBOLS, formula_words
from valvesim.diagnosis.term_estimation import RECOVERED_TERM
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, largest_adequate
from valvesim.identification.hypothesis_fit import fit_hypothesis
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.projection import direction_statistic
from valvesim.valve.additive_term import NONE, TermHypothesis, term_effect


@dataclass(frozen=True, eq=False)
class TriedForm:
    """A form of a term hypothesis over the `span` of its variable: how it is written and worked out, its amplitude by
    the linearised equations, and the reduction of the chi-square that they promise beyond the penalty of an oddity.
    """

    hypothesis: TermHypothesis
    text: str
    of: Callable[[np.ndarray], np.ndarray]
    span: tuple[float, float]
    amplitude: float
    reduction: float

    def values(self, u: np.ndarray) -> np.ndarray:
        """(k,) at values u (k,) of the variable."""
        return self.amplitude * self.of(u / np.max(np.abs(self.span)))


def one_parameter_term(nominal: NominalFit, scores: ScoreTest) -> RecoveredTerm | None:
    """The term of one parameter that explains most of what the nominal fit leaves; None where none explains more than
    it costs. `scores` is the nominal fit looked at with its term hypotheses (`score_test`). A form that does not come
    near the records is given up early.
    """
    options = scores.options.missing_term
    tried = sorted(_tried_forms(scores, options=scores.options), key=lambda one: -one.reduction)
    least = nominal.fit.chi_square - options.minimum_gain - float(np.log(len(nominal.fit.residual)))
    near = largest_adequate(nominal.fit, options=scores.options.identification)
    best = None
    for one in tried[: options.estimated]:
        knots = np.linspace(*one.span, options.knots)
        port, variable = one.hypothesis.port.name, one.hypothesis.variable.name
        effect = term_effect(port, variable, tuple(knots), tuple(one.values(knots)), name=RECOVERED_TERM)
        fixed = tuple((p.name, p.default) for p in effect.parameters if p is not effect.amplitude)
        start = (FittedCandidate(Candidate(effect.name, effect, fixed), 1.0),)
        fit = fit_hypothesis(nominal, start, worthwhile=near)
        penalty = options.complexity_penalty * one.hypothesis.complexity
        if fit is not None and fit.chi_square + penalty < least:
            least, best = fit.chi_square + penalty, (one, knots, fit)
    if best is None:
        return None
    one, knots, fit = best
    close = (o.hypothesis.label for o in tried if o.reduction > one.reduction - options.complexity_penalty)
    alike = tuple(label for label in dict.fromkeys(close) if label != one.hypothesis.label)
    variant = fit.variant(nominal.study.nominal)
    term = _term(one, knots, fit, nominal.fit.chi_square - fit.chi_square, alike)
    return RecoveredTerm(term, variant.effects[-1], fit.point, fit.chi_square, 1, fit.readings, variant)


def _tried_forms(scores: ScoreTest, *, options: DiagnosisOptions) -> list[TriedForm]:
    """Each form of each term hypothesis without memory, as far as the records see it."""
    found, spans = [], term_spans(scores.linearised, scores.hypotheses)
    for hypothesis, block, span in zip(scores.hypotheses, scores.terms.blocks, spans, strict=True):
        if hypothesis.memory != NONE:
            continue
        penalty = options.missing_term.complexity_penalty * hypothesis.complexity
        knots = np.linspace(*span, len(block)) / np.max(np.abs(span))
        for text, of in PLAIN_FORMS.items():
            amplitude, reduction = direction_statistic(scores.terms.projected, block, of(knots))
            if reduction > 0.0:
                found.append(TriedForm(hypothesis, text, of, span, amplitude, reduction - penalty))
    return found


def _term(one: TriedForm, knots: np.ndarray, fit: Fit, gained: float, alike: tuple[str, ...]) -> Term:
    """For the answer; its deviations are those by which so much would be explained (Wald 1943)."""
    port, variable, share = one.hypothesis.port, one.hypothesis.variable, fit.fitted[0].above_neutral
    values = share * one.values(knots)
    (of_unit,) = share * one.values(np.ones(1))  # in SI
    written = f"{of_unit:.3g} {one.text.format(x=SYMBOLS[variable.name])}"
    return Term(
        port=port.name, port_unit=port.unit, variable=variable.name, variable_unit=variable.unit, memory=NONE,
        at=tuple(map(float, knots)), value=tuple(map(float, values)),
        deviation=tuple(map(float, np.abs(values) / np.sqrt(gained))),
        formula=formula_words(one.hypothesis, written), formula_error=float("nan"), alike=alike,
    )  # fmt: skip
