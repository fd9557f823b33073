"""What a fit leaves, from all sides at once: candidates, free terms at every port, each part of each record."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.term_sensitivities import term_sensitivities, visited_values
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit
from valvesim.identification.fit_jacobian import (
    all_candidate_sensitivities,
    fitted_sensitivities,
    gram_matrix,
    linearise_fit,
)
from valvesim.identification.jacobian import is_simulated
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.projection import (
    GramMatrix,
    ProjectedScores,
    alarm_level,
    block_statistic,
    largest_by_chance,
    project,
)
from valvesim.identification.study import Study
from valvesim.valve.additive_term import TermHypothesis, term_hypotheses


@dataclass(frozen=True, eq=False)
class TermScores:
    """The score tests of free terms: of the columns of `gram` after the nuisance parameters, `blocks` are the basis
    functions of each term hypothesis, and `own` those of the fitted candidates. `projected` are all of them, orthogonal
    to both.
    """

    gram: GramMatrix
    blocks: tuple[tuple[int, ...], ...]
    own: tuple[int, ...]
    projected: ProjectedScores


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """The score tests of everything that a fit may lack (Rao 1948; Lagrange multiplier tests).

    `projected` are the candidates, orthogonal to the nuisance parameters and to the fitted candidates. `sizes` (q,) are
    the amplitudes at which the candidates' columns stand; `own` the columns of the fitted candidates. `columns` are the
    sensitivities of each record to the nuisance parameters, `own_columns` those to the fitted candidates, by channel.
    The term `hypotheses`, on so many `knots` each, are tested where they are asked for: it takes as long again.
    """

    study: Study
    fit: Fit
    linearised: tuple[LinearisedRecord, ...]
    columns: tuple[dict[str, np.ndarray], ...]
    own_columns: tuple[dict[str, np.ndarray], ...]
    gram: GramMatrix
    candidates: tuple[Candidate, ...]
    sizes: np.ndarray
    hypotheses: tuple[TermHypothesis, ...]
    knots: int
    own: tuple[int, ...]
    projected: ProjectedScores
    options: DiagnosisOptions

    @property
    def dispersion(self) -> float:
        """By how much the noise may be larger than its repeats have said: what the fit leaves, within reason."""
        return float(np.clip(self.fit.chi_square / self.fit.rows, 1.0, 1.0 + self.options.detection.noise_error))

    def visible(self) -> np.ndarray:
        """(q,) True for candidates that the session would show if they were there."""
        reach = np.array(
            [min(self.options.detection.reach * c.typical, max(map(abs, c.limits))) for c in self.candidates]
        )
        return self.projected.distance[: len(self.candidates)] * reach / self.sizes > 4.0

    def z(self) -> np.ndarray:
        """(q,) of the candidates: one-sided where physics fixes the sign; zero where the session is blind.

        An effect and the parameter that it changes are equivalent: the effect counts, where it explains as much.
        """
        q = len(self.candidates)
        z = self.projected.z[:q] / np.sqrt(self.dispersion)
        one_sided = np.array([c.one_sided for c in self.candidates])
        z = np.where(self.visible(), np.where(one_sided, np.maximum(z, 0.0), np.abs(z)), 0.0)
        effects = [(c, size) for c, size in zip(self.candidates, z, strict=True) if c.effect is not None]
        twice = [
            c.parameter is not None
            and any(c.is_equivalent_to(e) and z_e > self.options.detection.equivalent_share * own for e, z_e in effects)
            for c, own in zip(self.candidates, z, strict=True)
        ]
        return np.where(twice, 0.0, z)

    def without_parameters(self, which: Sequence[int]) -> tuple[float, np.ndarray]:
        """The chi-square, and the z (q,) of the candidates, with some nuisance parameters, by their places, at zero and
        not free, and the others and the fitted candidates fitted again: by the linearised equations.
        """
        gram = self.gram.without(which)
        projected = project(gram, 0, len(self.candidates) + len(self.own)).without(self.own)
        return projected.chi_square, replace(self, gram=gram, projected=projected).z()

    def level(self, probability: float) -> float:
        """The z that none of the candidates passes but with that probability, where nothing is hidden."""
        return alarm_level(self._largest_by_chance, probability)

    @functools.cached_property
    def _largest_by_chance(self) -> np.ndarray:
        q = np.flatnonzero(self.visible())
        some = ProjectedScores(self.projected.score[q], self.projected.overlap[np.ix_(q, q)], 0.0)
        one_sided = np.array([self.candidates[k].one_sided for k in q], dtype=bool)
        return largest_by_chance(some, one_sided, self.study.session.seed, self.options.detection.draws)

    def term_tests(self) -> list[tuple[float, int]]:
        """(chi-square, degrees of freedom) of each term hypothesis."""
        tests = [block_statistic(self.terms.projected, block) for block in self.terms.blocks]
        return [(value / self.dispersion, freedom) for value, freedom in tests]

    @functools.cached_property
    def terms(self) -> TermScores:
        """The score tests of the term hypotheses, beside the fitted candidates."""
        spans, knots = term_spans(self.linearised, self.hypotheses), self.knots
        T = self.study.each(lambda one: term_sensitivities(one, self.hypotheses, spans, knots), self.linearised)
        parts = [list(three) for three in zip(self.columns, T, self.own_columns, strict=True)]
        gram = gram_matrix(self.study, self.linearised, parts, self.fit.point)
        f = len(self.hypotheses) * knots
        blocks = tuple(tuple(range(first, first + knots)) for first in range(0, f, knots))
        own = tuple(range(f, f + len(self.own)))
        return TermScores(gram, blocks, own, project(gram, 0, f + len(own)).without(own))

    def constancy(self) -> tuple[float, int]:
        """(chi-square, degrees of freedom) of the first candidate's amplitude being the same in every segment."""
        if not self.own:
            return 0.0, 0
        G, k = self.gram, 1 + self.gram.parameters + self.own[0]
        at = [0, *range(1, 1 + G.parameters), *(1 + G.parameters + j for j in self.own)]
        m, total = len(G.products), G.total
        size = len(at)
        big = np.zeros((size + m, size + m))
        big[:size, :size] = total[np.ix_(at, at)]
        for j in range(m):
            big[:size, size + j] = big[size + j, :size] = G.products[j][at, k]
            big[size + j, size + j] = G.products[j][k, k]
        parts = GramMatrix(big[None], G.prior_now, ())
        own = len(self.own)
        split = project(parts, 0, own + m).without(range(own))
        return block_statistic(split, range(own, own + m))


def score_test(
    nominal: NominalFit,
    fit: Fit,
    *,
    terms: Sequence[TermHypothesis] = term_hypotheses(),
    knots: int | None = None,
    known: ScoreTest | None = None,
    options: DiagnosisOptions,
) -> ScoreTest:
    """Test what a fit leaves for every candidate and every term hypothesis, each term on so many knots.

    Another score test of the same fit may be `known`: the records are linearised there as well.
    """
    study, knots = nominal.study, options.detection.knots if knots is None else knots
    variant = fit.variant(study.nominal)
    about = next((one for one in (nominal, known) if one is not None and one.fit is fit), None)
    linearised, J = (about.linearised, about.columns) if about is not None else linearise_fit(study, fit)
    taken = [member.candidate for member in fit.fitted]
    labels_taken = {candidate.label for candidate in taken}
    candidates = tuple(c for c in study.candidates if c.label not in labels_taken and not any(map(c.excludes, taken)))
    sizes = np.array([search_size(c, options=options.identification) for c in candidates])
    changed = [c.apply_to(variant, size) for c, size in zip(candidates, sizes, strict=True)]
    S = all_candidate_sensitivities(study, linearised, J, candidates, changed)
    own = fitted_sensitivities(study, fit, linearised, J)
    gram = gram_matrix(study, linearised, [list(three) for three in zip(J, S, own, strict=True)], fit.point)
    q, count = len(candidates), len(fit.layout)
    freed = tuple(range(q, q + count))
    return ScoreTest(
        study, fit, tuple(linearised), tuple(J), tuple(own), gram, candidates, sizes, tuple(terms), knots, freed,
        project(gram, 0, q + count).without(freed), options=options,
    )  # fmt: skip


def term_score_test(
    nominal: NominalFit,
    fit: Fit,
    terms: Sequence[TermHypothesis] = (),
    knots: int | None = None,
    *,
    known: ScoreTest | None = None,
    options: DiagnosisOptions,
) -> ScoreTest:
    """The same for terms alone, which is quicker: no candidate is tested."""
    bare = replace(nominal, study=replace(nominal.study, candidates=()))
    return score_test(bare, fit, terms=terms, knots=knots, known=known, options=options)


def search_size(candidate: Candidate, *, options: IdentificationOptions) -> float:
    """The amplitude at which a candidate is tested: small, so that the response is linear, smaller where it is
    simulated, and inside its limits.
    """
    low, high = candidate.limits
    share = 0.05 if candidate.effect is not None and is_simulated(candidate.effect, options=options) else 0.2
    size = share * candidate.typical
    return size if size <= high else max(0.5 * low, -size)


def term_spans(linearised: Sequence[LinearisedRecord], terms: Sequence[TermHypothesis]) -> list[tuple[float, float]]:
    """The range of each hypothesis's variable that the records visit, but for its extreme hundredths."""
    found: dict[str, tuple[float, float]] = {}
    for hypothesis in terms:
        name = hypothesis.variable.name
        if name not in found:
            low, high = (float(v) for v in np.quantile(visited_values(linearised, hypothesis), [0.005, 0.995]))
            found[name] = (low, high) if high > low else (low - 1e-9, low + 1e-9)
    return [found[hypothesis.variable.name] for hypothesis in terms]
