"""Detection: whether a fit leaves more than noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.fit import Fit, is_adequate
from valvesim.identification.instrument_errors import is_of_bench, is_of_meter
from valvesim.identification.least_squares import bounded_step
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.projection import inverse_of
from valvesim.identification.study import Study, residual_of


def detect(scores: ScoreTest) -> tuple[bool, float]:
    """Whether anything shows, and the level that the candidates' z had to pass."""
    level = scores.level(scores.options.detection.false_alarm)
    shows = scores.z().max(initial=0.0) > level or is_certain(scores, level)
    return bool(shows or _term_p_value(scores) < scores.options.detection.term_false_alarm), level


def is_certain(scores: ScoreTest, level: float) -> bool:
    """Whether an alarm needs no fit to bear it out: more than noise is left, or a figure is beyond all tolerance.

    A score test is linear, and its columns err by some hundredths; what no fit explains is no evidence (likelihood
    ratio).
    """
    return _is_stretched(scores, level) or beyond_noise(scores.fit, scores.study, options=scores.options) > 0.0


def _is_stretched(scores: ScoreTest, level: float) -> bool:
    """Whether a figure is further out than that, such as a clock that is early, which has no name. The error of a meter
    has one: it is told as the bench's.
    """
    told = np.array([is_of_meter(p) for p in scores.study.nominal.parameters], dtype=bool)
    return bool(np.max(np.abs(scores.fit.point[~told]), initial=0.0) > level)


def beyond_noise(fit: Fit, study: Study, *, options: DiagnosisOptions) -> float:
    """The chi-square that a fit leaves beyond the noise where that is verified, and beyond what that may be off."""
    chi_square, rows = verified_chi_square(fit, study)
    return max(chi_square - rows - options.detection.noise_error * rows - 5.0 * float(np.sqrt(2.0 * rows)), 0.0)


def leaves_noise(fit: Fit, study: Study, *, options: DiagnosisOptions) -> bool:
    """Whether a fit comes near the records and leaves no more than noise, as far as that is verified."""
    return is_adequate(fit, options=options.identification) and beyond_noise(fit, study, options=options) == 0.0


def verified_chi_square(fit: Fit, study: Study) -> tuple[float, float]:
    """(chi-square, what noise alone would leave) of the channels whose noise is verified, and of the prior's part their
    share of the rows.

    Any other noise is what a fit leaves, so that nothing shows beyond it.
    """
    if all(noise.verified for noise in study.noise.values()):
        return fit.chi_square, fit.rows
    left, rows = 0.0, 0.0
    for predictor, read in zip(study.predictors, fit.readings, strict=True):
        record = predictor.record
        for name, white in zip(record.outputs, study.whiten(predictor, residual_of(record, read)), strict=True):
            if study.noise[name, record.pace].verified:
                left += float(np.sum(white**2))
                rows += float(np.sum(study.expected_squares(record, name)))
    prior = fit.chi_square - float(fit.residual @ fit.residual)
    return left + prior * rows / fit.rows, rows


def _term_p_value(scores: ScoreTest) -> float:
    """The probability that the most telling free term is chance, for as many as were tried."""
    from scipy.stats import chi2

    tests = [(value, freedom) for value, freedom in scores.term_tests() if freedom]
    if not tests:
        return 1.0
    least = min(float(chi2.sf(value, freedom)) for value, freedom in tests)
    return float(-np.expm1(len(tests) * np.log1p(-min(least, 1.0 - 1e-12))))


def is_inadequate(nominal: NominalFit, fit: Fit, *, options: DiagnosisOptions) -> bool:
    """True where most of the signal stays unexplained in most channels: these records are not of this valve."""
    shares = []
    for predictor, read in zip(nominal.study.predictors, fit.readings, strict=True):
        for name, column in read.items():
            usable = predictor.record.usable[name]
            measured_channels, column = predictor.record.values[name][usable], column[usable]
            noise = nominal.study.noise[name, predictor.record.pace].deviation
            signal = float(np.std(measured_channels))
            if signal > 5.0 * noise:
                shares.append(float(np.sqrt(np.mean((measured_channels - column) ** 2))) / signal)
    return bool(shares) and float(np.median(shares)) > options.selection.inadequate_share


def nuisance_covariance(scores: ScoreTest) -> np.ndarray:
    """The covariance (p, p) of the nuisance parameters of a fit, in prior deviations, its candidates being free."""
    p = scores.gram.parameters
    return inverse_of(_normal_equations_at(scores)[0])[:p, :p]


def nuisance_occam_factor(scores: ScoreTest, without: Sequence[int] = ()) -> float:
    """The Occam factor of the nuisance parameters of a fit without candidates, but for those that it does `without`:
    twice the logarithm of the ratio of their prior to their posterior width (MacKay 1992).
    """
    kept = np.delete(np.arange(scores.gram.parameters), list(without))
    return float(np.linalg.slogdet(_normal_equations_at(scores)[0][np.ix_(kept, kept)])[1])


def _normal_equations_at(scores: ScoreTest) -> tuple[np.ndarray, np.ndarray]:
    """(H, gradient) of a fit with respect to its nuisance parameters, with their priors, and then its candidates."""
    G, p, own = scores.gram.total, scores.gram.parameters, len(scores.own)
    free = [*range(1, 1 + p), *(1 + p + j for j in scores.own)]
    H = G[np.ix_(free, free)] + np.diag([1.0] * p + [0.0] * own)
    return H, G[free, 0] - np.append(scores.gram.prior_now, np.zeros(own))


def wald_statistic(scores: ScoreTest, which: Sequence[int], covariance: np.ndarray | None = None) -> float:
    """By how much the chi-square would be larger without some nuisance parameters (Wald 1943), by the linearised
    equations; `covariance` is `nuisance_covariance`, where it is known.
    """
    if not len(which):
        return 0.0
    covariance = nuisance_covariance(scores) if covariance is None else covariance
    moved = scores.fit.point[list(which)]
    return float(moved @ inverse_of(covariance[np.ix_(which, which)]) @ moved)


def explained_by_bench(scores: ScoreTest) -> float:
    """The chi-square that a fit explains by what the bench did."""
    parameters = scores.study.nominal.parameters
    return wald_statistic(scores, [k for k, p in enumerate(parameters) if is_of_bench(p)])


def bearable_beside_bench(scores: ScoreTest) -> float:
    """The chi-square that a cause may explain beside what the bench explains, and yet be the bench: no model is the
    plant.
    """
    return scores.options.bench.unexplained_share * explained_by_bench(scores)


def at_limit(fit: Fit, study: Study) -> np.ndarray:
    """(p,) True for the figures that a fit has as far off as it may: the part would be another one."""
    return beyond_reach(study, fit.point)


def beyond_reach(study: Study, point: np.ndarray) -> np.ndarray:
    """(p,) True for the figures of a point (p,) that would be those of another part; a meter may well be set anew."""
    set_anew = np.array([is_of_meter(p) for p in study.nominal.parameters], dtype=bool)
    return (np.abs(point) > (1.0 - 1e-6) * study.options.prior.reach) & ~set_anew


def is_other_valve(nominal: NominalFit, likeliest: Fit, *, options: DiagnosisOptions) -> bool:
    """Whether these records are of another valve than the stated one: neither the nominal fit nor the `likeliest` cause
    from within the tolerances comes near them, or figures of several parts of the valve are at their limits and explain
    far more than this does, or this is far from the records, too.
    """
    fit, study = nominal.fit, nominal.study
    if all(is_inadequate(nominal, one, options=options) for one in (fit, likeliest)):
        return True
    of_valve = np.array([p.is_of_valve for p in study.nominal.parameters])
    left = max(fit.chi_square - fit.rows, fit.rows)
    many = np.count_nonzero(at_limit(fit, study) & of_valve) >= options.detection.other_valve_figures
    most = min(options.detection.other_valve_ratio * left, options.detection.other_valve_left * likeliest.rows)
    return bool(many and likeliest.chi_square - likeliest.rows > most)


def rests_on_limits(final: ScoreTest) -> float:
    """The part of the chi-square that a fit explains by figures at their limits: by the linearised equations it would
    be lost if they were halfway back.
    """
    if not at_limit(final.fit, final.study).any():
        return 0.0
    p, own = final.gram.parameters, len(final.own)
    H, gradient = _normal_equations_at(final)
    falls = []
    for share in (1.0, 0.5):
        ends = np.append(np.full(p, share * final.study.options.prior.reach), np.full(own, np.inf))
        now = np.append(final.fit.point, np.zeros(own))
        step = bounded_step(H, gradient, np.array([-ends - now, ends - now]))
        falls.append(float((2.0 * gradient - H @ step) @ step))
    return falls[0] - falls[1]


def unexplained_share(nominal: NominalFit, final: ScoreTest) -> float:
    """The share of what the best explains that it leaves, beyond chance, for others to explain: a free term, an
    amplitude that wanders or, beside two causes, a third one; more than the noise; or what it explains by figures that
    no such part has. What the bench explains may leave a little itself.
    """
    from scipy.stats import chi2

    tests = [(value, freedom) for value, freedom in final.term_tests() if freedom]
    over = [
        value - float(chi2.isf(final.options.detection.term_significance / len(tests), freedom))
        for value, freedom in tests
    ]
    over += [rests_on_limits(final), beyond_noise(final.fit, nominal.study, options=final.options)]
    wander, freedom = final.constancy()
    if freedom:
        over.append(wander - float(chi2.isf(1e-3, freedom)))
    if len(final.fit.fitted) == final.options.isolation.most_causes and (
        third := final.z().max(initial=0.0)
    ) > final.level(final.options.detection.false_alarm):
        over.append(third**2)
    most = final.options.detection.most_explained * final.fit.rows
    gained = min(max(nominal.fit.chi_square - final.fit.chi_square, 1.0), most)
    return max(max(over) - bearable_beside_bench(final), 0.0) / gained
