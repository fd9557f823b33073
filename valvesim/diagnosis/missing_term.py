"""What no known cause explains, recovered as a function: where it acts, of what, with memory or without.

The term hypotheses are ranked by what they would explain of the nominal fit's residual, each drawn by straight
lines; the best are then estimated inside the simulation, together with the nuisance parameters, a formula is tried on
each, and the one whose chi-square is lowest for its freedom stays.

Symbols
    t nuisance parameters in prior deviations, v values of the term at its knots, s logarithms of its memory's figure
    D = r'r + t't + |B v|^2 + (s - s_0)^2: penalised chi-square; B second differences, offset and slope over their
    priors' widths
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import Term
from valvesim.diagnosis.score_test import ScoreTest, term_score_test
from valvesim.diagnosis.symbolic_form import relative_difference, with_formula
from valvesim.diagnosis.term_estimation import TermEstimate, TermProblem, estimate_term
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, rescored
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.study import Study
from valvesim.valve.additive_term import NONE, TermHypothesis, jump_hypotheses
from valvesim.valve.effect import ActiveEffect


@dataclass(frozen=True, eq=False)
class RecoveredTerm:
    """A term found: `term` for the answer, `active` the effect that has it, and the fit: point (p,) of the nominal
    model parameters, chi-square, how many figures of the term are free, readings of each training record, the
    variant that ran.
    """  # fmt: skip

    term: Term
    active: ActiveEffect
    point: np.ndarray
    chi_square: float
    freedom: int
    readings: tuple[dict[str, np.ndarray], ...]
    variant: ModelVariant

    def as_fit(self, study: Study) -> Fit:
        """The same as a fit of the term's share, its figures fixed."""
        effect = self.active.effect
        figures = zip([p.name for p in effect.parameters], map(float, self.active.numbers), strict=True)
        fixed = tuple((name, value) for name, value in figures if name != effect.amplitude.name)
        member = FittedCandidate(Candidate(effect.name, effect, fixed), 1.0)
        return rescored(study, Fit(self.point, (member,), self.chi_square, self.readings, np.zeros(0), 0.0))


def recover_term(nominal: NominalFit, scores: ScoreTest) -> RecoveredTerm | None:
    """The term that explains most, for its freedom, of what the nominal fit leaves; None where none explains anything.

    `scores` is the nominal fit looked at with its term hypotheses (`score_test`).
    """
    if not scores.hypotheses:
        return None
    options = scores.options.missing_term
    price = float(np.log(len(nominal.fit.residual)))
    least, best = nominal.fit.chi_square - options.minimum_gain, None
    continuous = [f for f in scores.hypotheses if f.memory == NONE]
    tested = partial(term_score_test, nominal, nominal.fit, options=scores.options)
    score_tests = [
        (options.knots, scores),
        (options.knots, tested(jump_hypotheses(), options.knots)),
        (options.fine_knots, tested(continuous, options.fine_test_knots)),
    ]
    ranked, margin = _ranked(score_tests, options=scores.options)
    for hypothesis, count in ranked[: options.estimated]:
        penalty = options.complexity_penalty * hypothesis.complexity
        found = _estimated(nominal, hypothesis, count, least - penalty, price, options=scores.options)
        if found is not None and found.chi_square + price * found.freedom + penalty < least:
            least, best = found.chi_square + price * found.freedom + penalty, (hypothesis, count, found)
    if best is None:
        return None
    hypothesis, count, found = best
    is_fine = count == options.fine_knots  # gains on few and on many knots do not compare
    comparable = [tests for knots, tests in score_tests if (knots == options.fine_knots) == is_fine]
    return replace(found, term=replace(found.term, alike=_alike(comparable, hypothesis, margin)))


def _estimated(
    nominal: NominalFit, hypothesis: TermHypothesis, count: int, below: float, price: float, *,
    options: DiagnosisOptions,
) -> RecoveredTerm | None:  # fmt: skip
    """A hypothesis's term on so many knots, held to a formula where there is one; None where its chi-square will not
    come `below`, each free figure counted at a `price`.
    """
    remembers = hypothesis.memory != NONE
    estimated = estimate_term(nominal, hypothesis, count, below - price * (1 + remembers), options=options)
    if estimated is None:
        return None
    (problem, solution), formula, error, freedom = estimated, "", float("nan"), count + remembers
    held = with_formula(problem, solution, nominal.fit.chi_square - solution.state.chi_square, price)
    if held is not None:
        (new, formula, figures), old = held, solution.state.values
        solution, freedom = new, figures + remembers
        error = relative_difference(problem, new.state.values, old)
    state = solution.state
    return RecoveredTerm(
        _term_answer(problem, solution, formula, error), problem.active(state.values, state.memory_log),
        state.point, state.chi_square, freedom, state.readings,
        problem.variant(state.point, state.values, state.memory_log),
    )  # fmt: skip


def _ranked(
    score_tests: Sequence[tuple[int, ScoreTest]], *, options: DiagnosisOptions
) -> tuple[list[tuple[TermHypothesis, int]], float]:
    """Families worth estimating, best first, each with its knots; and the penalty of an oddity.

    `score_tests` come with the knots that a term gets which shows there; what counts is what a term hypothesis
    explains less what its freedom costs.
    """
    gains, found = [], []
    for count, scores in score_tests:
        price = np.log(max(sum(scores.gram.rows), 2))
        for hypothesis, (value, freedom) in zip(scores.hypotheses, scores.term_tests(), strict=True):
            gains.append(value - price * freedom)
            slight = (
                count == options.missing_term.knots
                and value < options.missing_term.little * price * options.missing_term.knots
            )
            found.append((hypothesis, options.missing_term.few_knots if slight else count))
    margin = max(
        options.missing_term.complexity_penalty, options.missing_term.complexity_share * max(gains, default=0.0)
    )
    score = np.array(gains) - margin * np.array([hypothesis.complexity for hypothesis, _ in found])
    order = [int(k) for k in np.argsort(-score, kind="stable") if score[k] > 0.0]
    ranked: list[tuple[TermHypothesis, int]] = []
    for k in order:
        if score[k] < options.missing_term.score_share * score[order[0]]:
            break
        hypothesis, count = found[k]
        if all(_kind(f) != _kind(hypothesis) for f, _ in ranked):
            ranked.append((hypothesis, count))
    return ranked, margin


def _alike(score_tests: Sequence[ScoreTest], hypothesis: TermHypothesis, margin: float) -> tuple[str, ...]:
    """Labels of the other term hypotheses that explain nearly as much, best first: of each port and variable the
    best.
    """
    gains = [(gain, f) for tests in score_tests
             for (gain, _), f in zip(tests.term_tests(), tests.hypotheses, strict=True)]  # fmt: skip
    least = max(gain for gain, f in gains if _place(f) == _place(hypothesis)) - margin
    near = [f for gain, f in sorted(gains, key=lambda one: -one[0]) if gain > least]
    places = dict.fromkeys(map(_place, near))
    return tuple(next(f.label for f in near if _place(f) == place) for place in places if place != _place(hypothesis))


def _place(hypothesis: TermHypothesis) -> tuple[str, str]:
    return hypothesis.port.name, hypothesis.variable.name


def _kind(hypothesis: TermHypothesis) -> tuple[tuple[str, str], str, bool]:
    return _place(hypothesis), hypothesis.memory, hypothesis.jumps


def _term_answer(problem: TermProblem, solution: TermEstimate, formula: str, error: float) -> Term:
    p, k = len(solution.state.point), len(problem.knots)
    variance = np.diag(solution.covariance)[p : p + k]
    hypothesis = problem.hypothesis
    return Term(
        port=hypothesis.port.name, port_unit=hypothesis.port.unit, variable=hypothesis.variable.name,
        variable_unit=hypothesis.variable.unit, memory=hypothesis.memory, at=tuple(map(float, problem.knots)),
        value=tuple(map(float, solution.state.values)), deviation=tuple(map(float, np.sqrt(np.maximum(variance, 0.0)))),
        formula=formula, formula_error=error, alike=(),
    )  # fmt: skip
