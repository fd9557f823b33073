"""A term of one figure: where a term on knots would cost more figures than it explains, a plain shape may explain it.

Each shape is held against what a fit leaves, at every port and of every variable, by the linearised equations; the few
that explain most are fitted inside the simulation.

Symbols
    s, H scores and overlap of a term's columns off the nuisance parameters (`projection`); w values of a shape at the
    knots, a its amplitude; reduction of the chi-square by a shape: (w's)^2 / w'Hw, at a = w's / w'Hw
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.missing_term import RecoveredTerm
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import Term
from valvesim.diagnosis.score_test import ScoreTest, term_spans
from valvesim.diagnosis.symbolic_form import SHAPES, formula_words
from valvesim.diagnosis.term_estimation import RECOVERED_TERM
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.hypothesis_fit import fit_hypothesis
from valvesim.identification.nominal_fit import NominalFit
from valvesim.valve.additive_term import NONE, TermHypothesis, term_effect

ONE_FIGURE = SHAPES | {"sign({x})": np.sign}


@dataclass(frozen=True, eq=False)
class TriedShape:
    """A shape of a term hypothesis over the `span` of its variable: how it is written and worked out, its amplitude by
    the linearised equations, and the reduction of the chi-square that they promise beyond the penalty of an oddity.
    """

    hypothesis: TermHypothesis
    text: str
    of: Callable[[np.ndarray], np.ndarray]
    span: tuple[float, float]
    amplitude: float
    reduction: float

    def values(self, knots: np.ndarray) -> np.ndarray:
        """(k,) at knots (k,)."""
        return self.amplitude * self.of(knots / np.max(np.abs(self.span)))

    @property
    def place(self) -> str:
        """Port and variable in words."""
        return f"{self.hypothesis.port.name} as a function of {self.hypothesis.variable.name}".replace("_", " ")


def one_figure_term(nominal: NominalFit, scores: ScoreTest) -> RecoveredTerm | None:
    """The term of one figure that explains most of what the nominal fit leaves; None where none explains more than it
    costs. `scores` is the nominal fit looked at with its term hypotheses (`score_test`).
    """
    options = scores.options.missing_term
    tried = sorted(_shapes(scores, options=scores.options), key=lambda one: -one.reduction)
    least = nominal.fit.chi_square - options.minimum_gain - float(np.log(len(nominal.fit.residual)))
    best = None
    for one in tried[: options.estimated]:
        knots = np.linspace(*one.span, options.knots)
        place, variable = one.hypothesis.port.name, one.hypothesis.variable.name
        effect = term_effect(place, variable, tuple(knots), tuple(one.values(knots)), name=RECOVERED_TERM)
        fixed = tuple((p.name, p.default) for p in effect.parameters if p is not effect.amplitude)
        fit = fit_hypothesis(nominal, (FittedCandidate(Candidate(effect.name, effect, fixed), 1.0),))
        penalty = options.complexity_penalty * one.hypothesis.complexity
        if fit is not None and fit.chi_square + penalty < least:
            least, best = fit.chi_square + penalty, (one, knots, fit)
    if best is None:
        return None
    one, knots, fit = best
    alike = dict.fromkeys(o.place for o in tried if o.reduction > one.reduction - options.complexity_penalty)
    variant = fit.variant(nominal.study.nominal)
    term = _term(one, knots, fit, nominal.fit.chi_square - fit.chi_square, [p for p in alike if p != one.place])
    return RecoveredTerm(term, variant.effects[-1], fit.point, fit.chi_square, 1, fit.readings, variant)


def _shapes(scores: ScoreTest, *, options: DiagnosisOptions) -> list[TriedShape]:
    """Each shape of each term hypothesis without memory, as far as the records see it."""
    projected, found = scores.terms.projected, []
    spans = term_spans(scores.linearised, scores.hypotheses)
    for hypothesis, block, span in zip(scores.hypotheses, scores.terms.blocks, spans, strict=True):
        if hypothesis.memory != NONE:
            continue
        s, H = projected.score[list(block)], projected.overlap[np.ix_(block, block)]
        penalty = options.missing_term.complexity_penalty * hypothesis.complexity
        for text, of in ONE_FIGURE.items():
            w = of(np.linspace(*span, len(block)) / np.max(np.abs(span)))
            size = float(w @ H @ w)
            if size > 1e-6 * float(np.max(np.diag(H), initial=0.0)):  # of less the records see nothing
                a = float(w @ s) / size
                found.append(TriedShape(hypothesis, text, of, span, a, a * a * size - penalty))
    return found


def _term(one: TriedShape, knots: np.ndarray, fit: Fit, gained: float, alike: list[str]) -> Term:
    """For the answer; its deviations are those by which so much would be explained (Wald 1943)."""
    port, variable, share = one.hypothesis.port, one.hypothesis.variable, fit.fitted[0].above_neutral
    values = share * one.values(knots)
    written = one.amplitude * share * float(one.of(np.ones(1) / np.max(np.abs(one.span)))[0])  # of 1 in SI
    return Term(
        port=port.name, port_unit=port.unit, variable=variable.name, variable_unit=variable.unit, memory=NONE,
        at=tuple(map(float, knots)), value=tuple(map(float, values)),
        deviation=tuple(map(float, np.abs(values) / np.sqrt(gained))),
        formula=formula_words(one.hypothesis, one.text, written), formula_error=float("nan"), alike=tuple(alike),
    )  # fmt: skip
