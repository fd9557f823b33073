"""The bench, not the valve: what a test bench does that no record tells.

Instruments err (`identification.instrument_errors`), the supply ripples, the mains hum upon the current. What explains
the readings by much more than chance, and beside the likeliest causes too, joins the nuisance parameters of the nominal
model: no cause is sought for it. A strong cause hides it, so it is sought in what the likeliest cause leaves as well.

What is told of it in the end goes by a Wald statistic, beside the cause that is named (Wald 1943).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from valvesim.diagnosis.advice import CLOCKS, HUM, LINEARITY, METER, OF_INPUT, OF_WAVE, TRANSDUCER, what_to_do
from valvesim.diagnosis.detection import (
    is_other_valve,
    leaves_noise,
    nuisance_covariance,
    nuisance_occam_factor,
    wald_statistic,
)
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.result import WhatToDo
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.diagnosis.starts import likeliest_starts, single_starts
from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import Wave
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit, is_adequate, rescored, with_shapes
from valvesim.identification.fit_jacobian import added_jacobian_of, all_candidate_sensitivities
from valvesim.identification.hypothesis_fit import continue_fit, continue_from, fit_from_prior, fit_hypothesis
from valvesim.identification.input_choice import chi_square_of_way
from valvesim.identification.input_waves import (
    LinearReductions,
    fitted_waves,
    linear_reductions,
    outstanding_frequencies,
    tuned_waves,
    wave_columns,
    wave_name,
    wave_parameters,
    wave_size,
    wave_words,
    with_parameters,
)
from valvesim.identification.instrument_errors import (
    DELAYED,
    SHIFTED,
    clock_rates,
    contrasts,
    fastest_drift,
    has_instrument_errors,
    input_delays,
    input_shifts,
    instrument_errors,
    meter_drifts,
    meter_gains,
    meter_linearity,
    meter_zeros,
    shift_ways,
)
from valvesim.identification.nominal_fit import (
    NominalFit,
    assembled,
    fit_nominal_near,
    has_chosen_inputs,
    has_implausible_delays,
    has_uncertain_inputs,
    linearise_nominal,
    linearised_at,
    point_under,
    under_other_inputs,
    with_inputs_beside,
    with_inputs_reviewed,
    with_nuisance,
)
from valvesim.identification.prior import NuisanceParameter, largest_reading, measured_channels
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import UNITS, Session, value_text
from valvesim.identification.study import Study
from valvesim.valve.effect import Advice

Weights = dict[tuple[str, str], np.ndarray]  # of whitened rows, by record and channel


@dataclass(frozen=True, eq=False)
class BenchFault:
    """Something that the bench did: the parameters that say how much, their size in words, and what to do about it."""

    parameters: tuple[NuisanceParameter, ...]
    words: Callable[[np.ndarray], str]
    advice: Advice


@dataclass(frozen=True, eq=False)
class BenchHypothesis:
    """What the bench may do, as parameters, and the reduction of the chi-square that the linear answers promise."""

    parameters: tuple[NuisanceParameter, ...]
    gain: float


def with_bench_faults(
    nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest]:
    """The nominal fit with what the bench did by the readings, and what that leaves."""
    for _ in range(options.bench.most_faults):
        likeliest = _likeliest(nominal, scores, options=options)
        if likeliest is None:
            break
        better = _extended(nominal, likeliest.parameters)
        if not _keeps_promise(nominal, better, likeliest, options=options):
            break  # the linear answers were wrong: it is something else
        nominal = with_inputs_reviewed(better)  # which the fault may have hidden
        scores = score_test(nominal, nominal.fit, options=options)
    return nominal, scores


def with_assumed_inputs(
    nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest]:
    """The nominal fit with the inputs that nobody measured off by what the readings say, and what that leaves, where
    this explains at least half of what any cause does: it is likelier. It begins from nominal, lower and higher by a
    deviation: the valve's figures may have made up for it.
    """
    session = nominal.study.session
    columns = {column for record in session.training for column in record.assumed}
    for column in sorted(columns):
        shifts = input_shifts(session, column, False, options.identification)
        valve, fits = np.zeros(len(nominal.fit.point)), list[NominalFit]()
        for by in np.array([-1.0, 1.0]) / np.sqrt(len(shifts)):
            with suppress(SolveError, InputError):  # there the valve cannot be run
                fits.append(_extended(nominal, shifts, np.append(valve, np.full(len(shifts), by))))
        better = min(fits, key=lambda one: one.fit.chi_square - one.fit.rows, default=nominal)
        shows = float(np.max(scores.z(), initial=0.0)) ** 2
        if better is not nominal and _gain_by_fault(_at_weight_of(nominal, better), better) >= 0.5 * shows:
            nominal, scores = better, score_test(better, better.fit, options=options)
    return nominal, scores


def likeliest_cause(
    nominal: NominalFit, scores: ScoreTest, known: Sequence[Fit], *, options: DiagnosisOptions
) -> Fit | None:
    """The likeliest cause, fitted a little beside an inadequate nominal fit; the best of those `known` from elsewhere,
    where there are any, continued. None where none can be fitted.

    Its fit begins from within tolerance: the cause may have carried figures of the nominal fit away. Few are tried
    where one of these explains much.
    """
    fit = continue_fit(nominal, known[0]) if known else None
    enough = (1.0 - options.isolation.enough_share) * nominal.fit.chi_square
    for k, start in enumerate(likeliest_starts(nominal, scores) if not known else ()):
        if k > options.isolation.seconds and fit is not None and fit.chi_square < enough:
            break
        if fit is not None and _tells_as_much(fit, start, options=options):
            continue
        most = None if fit is None else fit.rows + _excess_to_beat(start, fit, options=options)
        other = fit_from_prior(nominal, start, options.isolation.near_linearisations, most)
        if other is not None and (most is None or other.chi_square < most):
            fit = other
        if fit is not None and (
            leaves_noise(fit, nominal.study, options=options) or _explains_nearly_all(fit, nominal.fit, options=options)
        ):
            break
    return fit


def with_faults_beside_cause(
    nominal: NominalFit, scores: ScoreTest, cause: Fit | None, is_known: bool, *, options: DiagnosisOptions
) -> tuple[NominalFit, ScoreTest, Fit | None]:
    """`with_bench_faults` by what the likeliest `cause` leaves: what an inadequate nominal fit leaves is all of that.
    Last the fit of the cause beside what the bench did, if there was anything to be fitted. How the commands go is
    asked again where the cause leaves far less than when it was asked, and not where it `is_known` from elsewhere.
    """
    few, at, fit, left_when_asked = options.isolation.near_linearisations, nominal, cause, np.inf
    for _ in range(options.bench.most_faults):
        fit = _continued_if_other_valve(fit, at, nominal, options=options)
        if fit is None or is_other_valve(nominal, fit, options=options):
            break
        left = max(fit.chi_square - fit.rows, 0.0)
        to_ask = not is_known and left < options.bench.asked_share * left_when_asked
        if to_ask and has_implausible_delays(at.study, fit.point):  # far off for linear answers
            (at, fit), left_when_asked = _best_inputs(at, fit, few), left
            continue
        beside = score_test(at, fit, options=options)
        if (tuned := _tuned_beside(at, fit, beside)) is not None:
            at, fit = tuned
            if (better_fit := fit_hypothesis(at, fit.fitted, fit.point, few)) is None:
                break
            fit, beside = better_fit, score_test(at, better_fit, options=options)
        likeliest = _likeliest(at, beside, options=options)
        if likeliest is not None:
            at, more = _widened(at, likeliest.parameters), np.zeros(len(likeliest.parameters))
            fit = fit_hypothesis(at, fit.fitted, np.append(fit.point, more), few)
            continue
        if is_known:  # how the commands go has been asked elsewhere
            break
        better = with_inputs_beside(at, assembled(at.study, fit, beside.linearised, beside.columns))
        if better is not at:
            other = fit_hypothesis(better, fit.fitted, point_under(better, at, fit.point), few)
            if other is None or other.chi_square - other.predicted_reduction > fit.chi_square:
                break
            at, fit = better, other
        elif to_ask and not leaves_noise(fit, at.study, options=options):
            (at, fit), left_when_asked = _best_inputs(at, fit, few), left
        else:
            break
    if at is nominal:
        return nominal, scores, fit
    nominal = _fitted_under(nominal, at)
    fit = _continued_if_other_valve(fit, at, nominal, options=options)
    return nominal, score_test(nominal, nominal.fit, options=options), fit


def _continued_if_other_valve(
    fit: Fit | None, at: NominalFit, nominal: NominalFit, *, options: DiagnosisOptions
) -> Fit | None:
    """A fit of a cause in the study of `at`, continued where by it the records would be of another valve than the
    nominal one: a few steps from far off do not tell where they lead.
    """
    if fit is None or not is_other_valve(nominal, fit, options=options):
        return fit
    return continue_from(at, fit, np.inf) or fit


def _tells_as_much(fit: Fit, start: Sequence[FittedCandidate], *, options: DiagnosisOptions) -> bool:
    """Whether the fit of a cause tells the bench as well as a start would: an adequate one of the same plainest law."""
    alike = fit.fitted[0].candidate.plainest == start[0].candidate.plainest
    return alike and is_adequate(fit, options=options.identification)


def _explains_nearly_all(fit: Fit, nominal: Fit, *, options: DiagnosisOptions) -> bool:
    """Whether a fit explains nearly all of what the nominal one leaves: alike laws would not tell the bench better."""
    return fit.chi_square - fit.rows <= options.bench.left_share * (nominal.chi_square - nominal.rows)


def _excess_to_beat(start: Sequence[FittedCandidate], other: Fit, *, options: DiagnosisOptions) -> float:
    """What a fit from a start may leave beyond the noise to explain more than another one: far less where its law is
    the other's with a feature more, which takes up some of what the bench did and is harder to fit.
    """
    alike = [e.candidate.plainest for e in start] == [e.candidate.name for e in other.fitted]
    share = options.bench.alike_share if alike else 1.0
    return share * (other.chi_square - other.rows)


def with_inputs_of_cause(
    nominal: NominalFit, cause: Fit, *, options: DiagnosisOptions
) -> tuple[NominalFit, Fit] | None:
    """The nominal fit under another way of its commands by which a cause explains far more, and the fit of that; None
    where no sensor is later or earlier beside it than it may be, or no other way does so.

    The ways may have been judged beside another law, which leaves more than they differ by.
    """
    if not has_implausible_delays(nominal.study, cause.point):
        return None
    best = _way_beyond(nominal, cause, under_other_inputs(nominal, cause), [cause.fitted], options=options)
    return None if best is None else (_fitted_under(nominal, best[0]), best[1])


def _fitted_under(nominal: NominalFit, at: NominalFit) -> NominalFit:
    """The nominal model fitted in another study, from where it is there."""
    fully = _is_at_full_weight(nominal.study, at.study)
    return fit_nominal_near(at.study.unweighted(), at.fit.point, full_weight=fully)


def with_inputs_of_one_cause(
    nominal: NominalFit, pair: Fit, alone: Sequence[Fit], *, options: DiagnosisOptions
) -> tuple[NominalFit, Fit] | None:
    """The nominal fit under another way of its commands by which one cause explains far more, and no less than a pair
    under this one, and the fit of that cause; None where there is none of those that are fitted `alone`.

    What straight lines cut off a fast command, a larger inertia of the armature takes off the valve's answer.
    """
    most, best = 0.0, None
    for cause in alone:
        ways = under_other_inputs(nominal, cause)
        found = _way_beyond(nominal, cause, ways, [cause.fitted], options=options)
        if found is None:
            continue
        weights = _least_weights([nominal, *ways])
        gain = _excess(nominal.study, pair, weights) - _excess(found[0].study, found[1], weights)
        if gain >= most:
            best, most = found, gain
    return None if best is None else (_fitted_under(nominal, best[0]), best[1])


def with_inputs_of_any_cause(
    nominal: NominalFit, best: Fit, causes: Sequence[Fit], *, options: DiagnosisOptions
) -> tuple[NominalFit, Fit] | None:
    """The nominal fit under another way of its commands by which one of some single `causes` explains far more than
    the best under this one, and the fit of that cause; None where none does.

    Under the wrong way each may have ended far from its amount: they begin at what is typical of them.
    """
    starts = [(_at_typical(one.fitted[0]),) for one in causes if len(one.fitted) == 1]
    ways = under_other_inputs(nominal) if starts else []
    found = _way_beyond(nominal, best, ways, starts, options=options)
    return None if found is None else (_fitted_under(nominal, found[0]), found[1])


def with_inputs_of_likeliest_cause(
    nominal: NominalFit, best: Fit, *, options: DiagnosisOptions
) -> tuple[NominalFit, Fit] | None:
    """The nominal fit under another way of its commands by which a single cause that shows there explains far more than
    the best under this one, and the fit of that cause; None where none does.

    A command that comes half a sample later acts like an eddy current: under the wrong way neither shows.
    """
    begun, weights = _begun_under_other_inputs(nominal, options=options)
    found = _best_way(begun, _excess(nominal.study, best, weights), weights)
    return None if found is None else (_fitted_under(nominal, found[0]), found[1])


def cause_under_other_inputs(nominal: NominalFit, best: Fit, *, options: DiagnosisOptions) -> Candidate | None:
    """Another cause that explains as much as the best, under another way of the commands than one that was read off the
    records; None where there is none, or the commands go on straight lines.
    """
    if not has_chosen_inputs(nominal.study):
        return None
    begun, weights = _begun_under_other_inputs(nominal, options=options)
    least, other = _excess(nominal.study, best, weights) + options.selection.answer_ratio, None
    for way, fit in begun:
        candidate = fit.fitted[0].candidate
        alike = candidate.name == best.fitted[0].candidate.name
        if alike or _excess(way.study, fit, weights) - fit.predicted_reduction > least:
            continue
        excess = _excess(way.study, continue_from(way, fit) or fit, weights)
        if excess < least:
            least, other = excess, candidate
    return other


def _begun_under_other_inputs(
    nominal: NominalFit, *, options: DiagnosisOptions
) -> tuple[list[tuple[NominalFit, Fit]], Weights]:
    """The single cause that shows most under each other way of the commands, fitted a little there, and the weights by
    which the ways are held against each other.
    """
    ways = under_other_inputs(nominal)
    starts = [(way, start) for way in ways for start in _likeliest_under(way, options=options)]
    return _preliminary_fits(starts, options.isolation.near_linearisations), _least_weights([nominal, *ways])


def _likeliest_under(way: NominalFit, *, options: DiagnosisOptions) -> list[tuple[FittedCandidate, ...]]:
    """The start of the single cause that shows most under a way of the commands, if any does."""
    scores = score_test(way, way.fit, options=options)
    return single_starts(scores, scores.z() ** 2, options.isolation.single_share)[:1]


def _at_typical(member: FittedCandidate) -> FittedCandidate:
    """A fitted candidate at what is typical of it, with its shapes where they are looked for."""
    return with_shapes(member.candidate, float(np.copysign(member.candidate.typical, member.above_neutral)))


def with_fault_left(nominal: NominalFit, left: ScoreTest, *, options: DiagnosisOptions) -> NominalFit | None:
    """The nominal fit with what the bench did by what a cause leaves: a second cause would be sought for it. None where
    the bench explains none of that.
    """
    likeliest = _likeliest(nominal, left, options=options)
    if likeliest is None:
        return None
    better = _extended(nominal, likeliest.parameters)
    without = _at_weight_of(nominal, better)
    at_peaks = without is not nominal and _gain_by_fault(without, better) < 0.5 * likeliest.gain
    return None if at_peaks else better


def _keeps_promise(
    nominal: NominalFit, better: NominalFit, likeliest: BenchHypothesis, *, options: DiagnosisOptions
) -> bool:
    """Whether what the bench did explains half of what it promised, or where samples next to peaks count less by it,
    half of what it promises without them.
    """
    without, promised = _at_weight_of(nominal, better), likeliest.gain
    gain = _gain_by_fault(without, better)
    if without is not nominal and gain < 0.5 * promised:
        left = score_test(without, without.fit, options=options)
        again = _likeliest(without, left, options=options)
        promised = again.gain if again is not None else promised
    return gain >= 0.5 * promised


def _gain_by_fault(without: NominalFit, better: NominalFit) -> float:
    """What the bench explains in a nominal fit that is better by what it did than the one `without`, see
    `_at_weight_of`.
    """
    return rescored(better.study, without.fit).chi_square - better.fit.chi_square


def _at_weight_of(nominal: NominalFit, better: NominalFit) -> NominalFit:
    """The nominal fit, made anew with samples next to peaks counting less where they do so in the better one alone: a
    fault has not explained what shows at peaks alone.
    """
    if nominal.study.weights or not better.study.weights:
        return nominal
    return fit_nominal_near(nominal.study.unweighted(), nominal.fit.point, full_weight=False)


def _tuned_beside(nominal: NominalFit, fit: Fit, beside: ScoreTest) -> tuple[NominalFit, Fit] | None:
    """A nominal fit and a fit of causes beside it with the waves at the frequencies that this asks for, by its score
    test; None where that explains no more.
    """
    study = nominal.study
    if not fitted_waves(study.nominal):
        return None
    own = study.stack(beside.own_columns)
    parameters, point, _ = tuned_waves(study, fit, beside.linearised, beside.columns, own)
    tuned = with_nuisance(study, parameters)
    again = evaluate_fit(tuned, point, fit.fitted, fit.trajectories)
    if again.chi_square > fit.chi_square - beside.options.bench.minimum_gain:
        return None
    return linearise_nominal(tuned, evaluate_fit(tuned, nominal.fit.point, (), nominal.fit.trajectories)), again


def _best_inputs(nominal: NominalFit, fit: Fit, few: int) -> tuple[NominalFit, Fit]:
    """A nominal fit and a fit of causes beside it, or both under another way of the commands by which this explains
    far more from within tolerance: linear answers do not tell where a fit has gone astray under a wrong one.
    """
    others = under_other_inputs(nominal)
    begun = [(nominal, fit), *_preliminary_fits([(way, fit.fitted) for way in others], few)]
    return _best_way(begun, np.inf, _least_weights([nominal, *others])) or (nominal, fit)


def _way_beyond(
    nominal: NominalFit,
    than: Fit,
    ways: Sequence[NominalFit],
    starts: Sequence[tuple[FittedCandidate, ...]],
    *,
    options: DiagnosisOptions,
) -> tuple[NominalFit, Fit] | None:
    """The one of some ways of the commands by which causes explain far more, from one of the `starts`, than a fit under
    the nominal one does, and that fit; None where none does.
    """
    weights = _least_weights([nominal, *ways])
    begun = _preliminary_fits([(way, start) for way in ways for start in starts], options.isolation.near_linearisations)
    return _best_way(begun, _excess(nominal.study, than, weights), weights)


def _preliminary_fits(
    ways: Sequence[tuple[NominalFit, tuple[FittedCandidate, ...]]], few: int
) -> list[tuple[NominalFit, Fit]]:
    """Ways of the commands with causes fitted a little under each from within tolerance, where they can be."""
    return [(way, fit) for way, start in ways if (fit := fit_from_prior(way, start, few)) is not None]


def _best_way(
    begun: Sequence[tuple[NominalFit, Fit]], least: float, weights: Weights
) -> tuple[NominalFit, Fit] | None:
    """The way of the commands by which causes, fitted a little, leave far less beyond the noise at these weights than
    `least` and than by those before it; None where there is none. Fits that promise to be the best are continued: a few
    steps may have stopped far short.
    """
    left = [_excess(way.study, fit, weights) for way, fit in begun]
    reached, best = min([least, *left]), None
    for (way, tried), excess in zip(begun, left, strict=True):
        options, promised = way.study.options.input, tried.predicted_reduction
        if promised > options.minimum_gain and excess - promised < reached:
            tried = continue_from(way, tried) or tried
            excess = _excess(way.study, tried, weights)
        if excess + max(options.minimum_gain, options.gain_share * excess) < least:
            best, least = (way, tried), excess
    return best


def _excess(study: Study, fit: Fit, weights: Weights) -> float:
    """The chi-square that a fit leaves beyond the noise at some weights, as ways of the commands are judged by it."""
    weighted = replace(study, weights=weights)
    return chi_square_of_way(weighted, fit) - rescored(weighted, fit).rows


def _least_weights(ways: Sequence[NominalFit]) -> Weights:
    """The least weight of each sample under some ways of the commands: a way under which readings peak more often
    counts fewer of them, and would be judged by less.
    """
    least = dict[tuple[str, str], np.ndarray]()
    for way in ways:
        for key, own in way.study.weights.items():
            least[key] = np.minimum(least.get(key, own), own)
    return least


def _widened(nominal: NominalFit, parameters: Sequence[NuisanceParameter]) -> NominalFit:
    """The nominal fit with more parameters, at nothing of them."""
    study = with_parameters(nominal.study.unweighted(), parameters)
    point = np.append(nominal.fit.point, np.zeros(len(parameters)))
    return linearised_at(study, point, full_weight=_is_at_full_weight(nominal.study, study))


def _extended(
    nominal: NominalFit, parameters: Sequence[NuisanceParameter], start: np.ndarray | None = None
) -> NominalFit:
    """The nominal fit with more parameters: from where it is, at nothing of them, or from another point."""
    prepared = with_parameters(nominal.study.unweighted(), parameters)
    point = np.append(nominal.fit.point, np.zeros(len(parameters))) if start is None else start
    return fit_nominal_near(prepared, point, full_weight=_is_at_full_weight(nominal.study, prepared))


def _is_at_full_weight(study: Study, extended: Study) -> bool:
    """Whether samples next to peaks count fully in a study with more parameters: as before, unless these are of inputs,
    which are then not known to the microseconds that a peak takes.
    """
    return not study.weights and not has_uncertain_inputs(extended)


def without_instrument_errors(nominal: NominalFit) -> NominalFit:
    """The nominal fit without errors of the instruments among its parameters."""
    study = nominal.study.unweighted()
    errors = _error_names(study)
    kept = [k for k, p in enumerate(study.nominal.parameters) if p.name not in errors]
    plain = with_nuisance(study, tuple(study.nominal.parameters[k] for k in kept))
    return fit_nominal_near(plain, nominal.fit.point[kept], full_weight=not nominal.study.weights)


def told_faults(scores: ScoreTest, *, options: DiagnosisOptions) -> tuple[WhatToDo, ...]:
    """What the bench did by a fit, with what to do about it: what the readings would miss by more than chance."""
    return tuple(
        what_to_do(_fault_words(scores, fault, own, scores.fit.point), fault.advice)
        for fault, own in _faults_told(scores, options=options)
    )


def _fault_words(scores: ScoreTest, fault: BenchFault, own: Sequence[int], point: np.ndarray) -> str:
    """A fault of the bench in words, by its parameters in the model at a point (p,)."""
    return fault.words(np.array([scores.study.nominal.parameters[k].at(point[k]) for k in own]))


def _error_names(study: Study) -> set[str]:
    """The names that errors of the instruments have among the parameters of a study."""
    return {p.name for p in instrument_errors(study.session, options=study.options)}


def _faults_told(scores: ScoreTest, *, options: DiagnosisOptions) -> list[tuple[BenchFault, list[int]]]:
    """What the bench did that the readings would miss by more than chance, each with its parameters in the model."""
    at = {p.name: k for k, p in enumerate(scores.study.nominal.parameters)}
    covariance = nuisance_covariance(scores)
    faults = [(f, [at[p.name] for p in f.parameters if p.name in at]) for f in _known_faults(scores.study)]
    return [(f, own) for f, own in faults if wald_statistic(scores, own, covariance) > options.bench.minimum_gain]


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Errors of the instruments that explain together what none of them does by itself: the chi-square that they
    explain; those that do so with the fewest figures, in words; and minus twice the log evidence of these, up to a
    constant (Laplace's approximation; MacKay 1992).
    """

    explained: float
    fewest: tuple[str, ...]
    evidence: float

    @property
    def words(self) -> str:
        """The fewest in words."""
        return ", ".join(self.fewest) or "a little of each"


def joint_instrument_errors(
    scores: ScoreTest, least_gain: float | None = None, *, options: DiagnosisOptions
) -> JointErrors | None:
    """Errors of the instruments by a fit; None where one of them is told by itself, or where they explain no more than
    chance and `least_gain` (`minimum_gain` where that is not given). A cause may act like several at once.
    """
    least_gain = options.bench.minimum_gain if least_gain is None else least_gain
    study = scores.study
    at = {p.name: k for k, p in enumerate(study.nominal.parameters)}
    errors, together = _errors_together(scores)
    if together <= least_gain + len(errors) or _faults_told(scores, options=options):
        return None
    faults = [fault for fault in _known_faults(study) if errors.issuperset(p.name for p in fault.parameters)]
    kept = {k: [at[p.name] for p in fault.parameters] for k, fault in enumerate(faults)}
    covariance, out, least = nuisance_covariance(scores), list[int](), nuisance_occam_factor(scores)
    while kept:  # the one goes that costs least evidence, while that gains any
        tried = {}
        for k, own in kept.items():
            less = [*out, *own]
            tried[k] = wald_statistic(scores, less, covariance) + nuisance_occam_factor(scores, less)
        worst = min(tried, key=tried.__getitem__)
        if tried[worst] > least:
            break
        out, least = [*out, *kept.pop(worst)], tried[worst]
    point = scores.fit.point - covariance[:, out] @ inverse_of(covariance[np.ix_(out, out)]) @ scores.fit.point[out]
    fewest = tuple(_fault_words(scores, faults[k], own, point) for k, own in kept.items())
    return JointErrors(together, fewest, scores.fit.chi_square + least)


def instrument_errors_are_insignificant(scores: ScoreTest, least_gain: float, *, options: DiagnosisOptions) -> bool:
    """Whether errors of the instruments are among the parameters of a fit and show nothing: together no more than
    chance and `least_gain`, and none of what the bench did by itself.
    """
    errors, together = _errors_together(scores)
    by_chance = bool(errors) and together <= least_gain + len(errors)
    return by_chance and not _faults_told(scores, options=options)


def _errors_together(scores: ScoreTest) -> tuple[set[str], float]:
    """The errors of the instruments among the parameters of a fit, by name, and the chi-square that they explain
    together.
    """
    parameters, errors = scores.study.nominal.parameters, _error_names(scores.study)
    own = [k for k, p in enumerate(parameters) if p.name in errors]
    return {parameters[k].name for k in own}, wald_statistic(scores, own)


def _likeliest(nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions) -> BenchHypothesis | None:
    """What the bench may do that explains most of what a fit leaves, beside the likeliest causes too; where none does,
    that instruments err, if one of their errors explains an alarm as well as any cause: all of them together, for
    which one it is need not be known. The fit is the nominal one, or one with candidates.
    """
    taken = {p.name for p in nominal.study.nominal.parameters}
    hypotheses = [h for h in _hypotheses(nominal.study, scores) if not {p.name for p in h} & taken]
    if not hypotheses or not options.bench.most_faults:
        return None
    fit, study = scores.fit, nominal.study
    J = study.stack(scores.columns)
    added = [p for each in hypotheses for p in each]
    causes = np.column_stack([study.stack(scores.own_columns), _likeliest_causes(study, scores, options=options)])
    fitted, most = len(scores.own), causes.shape[1]
    place = {p.name: most + k for k, p in enumerate(added)}
    predicted = linear_reductions(J, fit, np.column_stack([causes, added_jacobian_of(study, scores.linearised, added)]))

    def beside(parameters: tuple[NuisanceParameter, ...], most_causes: int) -> BenchHypothesis:
        own = [place[p.name] for p in parameters]
        by = (predicted.gain(own, range(k)) for k in range(fitted, most_causes + 1))
        return BenchHypothesis(parameters, min(by) - len(parameters))

    shows = float(np.max(scores.z(), initial=0.0)) ** 2
    best = max((beside(each, most) for each in hypotheses), key=lambda one: one.gain)
    if best.gain > max(options.bench.minimum_gain, options.bench.gain_share * max(shows, fit.chi_square - fit.rows)):
        return best
    if shows <= scores.level(options.detection.false_alarm) ** 2:
        return None
    known = [f.parameters for f in _known_faults(study) if all(p.name in place for p in f.parameters)]
    beyond, drifting = _meter_beyond_tolerance(scores), _drifting_meter(scores)

    def explains_alarm(fault: tuple[NuisanceParameter, ...]) -> bool:
        meters = {p.sensor.channel if p.sensor is not None else "" for p in fault}
        more = options.selection.answer_ratio if meters == {drifting} else -options.selection.answer_ratio
        if meters == {beyond} or beside(fault, fitted).gain <= shows + more:
            return False
        own = [place[p.name] for p in fault]
        return not _two_causes_explain_more(predicted, fitted, range(fitted, most), own, options=options)

    if not any(map(explains_alarm, known)):
        return None
    return next(beside(each, fitted) for each in hypotheses if known[0][0].name in [p.name for p in each])


def _two_causes_explain_more(
    predicted: LinearReductions,
    fitted: int,
    causes: Sequence[int],
    own: Sequence[int],
    *,
    options: DiagnosisOptions,
) -> bool:
    """Whether two of some `causes` are likelier than one of them beside an error of the bench, the parameters of which
    are `own` (both by their columns), by the linear answers. So many are `fitted`: beside one, a second is weighed
    against the error as it is.
    """
    pairs = list(combinations(causes, options.isolation.most_causes))
    if fitted or not pairs:
        return False
    with_error = max(predicted.reduction(own, [cause]) for cause in causes) - len(own)
    rarity = options.selection.answer_ratio  # of a second cause
    return max(predicted.reduction(free=pair) for pair in pairs) > with_error + rarity + options.selection.answer_ratio


def _meter_beyond_tolerance(scores: ScoreTest) -> str | None:
    """The channel whose meter explains an alarm best by more of an error than its tolerance has: it is that meter then,
    by whichever of its errors; None where something else does.
    """
    likeliest = _likeliest_candidate(scores)
    if likeliest is None or likeliest.effect is None or likeliest.equivalent is None:
        return None
    return likeliest.effect.channel or None


def _drifting_meter(scores: ScoreTest) -> str | None:
    """The channel whose drift with the oil's temperature explains an alarm best, by one figure where zeros of its meter
    take one for each record; None where something else does.
    """
    likeliest = _likeliest_candidate(scores)
    effect = likeliest.effect if likeliest is not None else None
    return effect.channel if effect is not None and effect.feature == "oil_temperature" else None


def _likeliest_candidate(scores: ScoreTest) -> Candidate | None:
    """The candidate that explains most of what is left; None where there is none."""
    z = scores.z()
    return scores.candidates[int(np.argmax(z))] if len(z) else None


def _likeliest_causes(study: Study, scores: ScoreTest, *, options: DiagnosisOptions) -> np.ndarray:
    """Whitened columns (rows, k) of the few candidates that explain most of what is left on their own."""
    z = scores.z()
    few = [int(k) for k in np.argsort(-z, kind="stable")[: options.bench.causes_beside] if z[k] > 0.0]
    if not few:
        return np.empty((len(scores.fit.residual), 0))
    candidates = [scores.candidates[k] for k in few]
    variant = scores.fit.variant(study.nominal)
    changed = [c.apply_to(variant, scores.sizes[k]) for c, k in zip(candidates, few, strict=True)]
    return study.stack(all_candidate_sensitivities(study, scores.linearised, scores.columns, candidates, changed))


# ---------------------------------------------------------------- what a bench may do


def _hypotheses(study: Study, scores: ScoreTest) -> list[tuple[NuisanceParameter, ...]]:
    """What the bench may do, by what a fit leaves: a wave upon an input, or that instruments err."""
    records = study.session.training
    waves = [
        wave_parameters(records, column, frequency, wave_size(study.nominal, records, column))
        for frequency in outstanding_frequencies(study, scores.fit.readings, scores.options.bench.wave_peak)
        for column in wave_columns(records)
        if wave_name(column, frequency) not in fitted_waves(study.nominal)
    ]
    if has_instrument_errors(study.nominal.parameters):
        return waves
    return [*waves, instrument_errors(study.session, options=study.options)]


def _known_faults(study: Study) -> list[BenchFault]:
    """What a bench may do, as it is told; the waves are those of the study."""
    session, options = study.session, study.options
    waves = [BenchFault(wave, _wave_words(wave), _wave_advice(wave)) for wave in _waves_apart(study)]
    shifts = [
        BenchFault(input_shifts(session, column, growing, options), _shift_words(column, growing), OF_INPUT[column])
        for column, growing in shift_ways()
    ]
    late = [
        BenchFault(delays, _delay_words(column), TRANSDUCER)
        for column in DELAYED
        if (delays := input_delays(session, column, options))
    ]
    drifts = [BenchFault((p,), _drift_words(p, session), METER) for p in meter_drifts(session, options)]
    of_meters = (
        (meter_zeros, _zero_words, METER),
        (meter_gains, _gain_words, LINEARITY),
        (meter_linearity, lambda channel: _linearity_words(channel, session), LINEARITY),
    )
    meters = [
        BenchFault(own, words(channel), advice)
        for errors, words, advice in of_meters
        for channel in measured_channels(session)
        if (own := errors(session, channel, options))
    ]
    clocks = BenchFault(clock_rates(session, options), _clock_words, CLOCKS)
    return [*waves, *shifts, *late, clocks, *drifts, *meters]


def _waves_apart(study: Study) -> list[tuple[NuisanceParameter, ...]]:
    """The waves of a study, of those too close to be told apart in its longest record the one that was found first."""
    longest = max(record.duration for record in study.session.training)
    found: list[tuple[Wave, tuple[NuisanceParameter, ...]]] = []
    for parameters in fitted_waves(study.nominal).values():
        wave = parameters[0].input
        if isinstance(wave, Wave) and not any(
            wave.column == other.column and abs(wave.frequency - other.frequency) * longest < 1.0 for other, _ in found
        ):
            found.append((wave, parameters))
    return [parameters for _, parameters in found]


def _wave_words(wave: Sequence[NuisanceParameter]) -> Callable[[np.ndarray], str]:
    return lambda values: wave_words(wave, values)


def _wave_advice(wave: Sequence[NuisanceParameter]) -> Advice:
    deviation = wave[0].input
    return OF_WAVE.get(deviation.column, HUM) if deviation is not None else HUM


def _shift_words(column: str, growing: bool) -> Callable[[np.ndarray], str]:
    what, within = column.replace("_", " "), " within a record" if growing else ""
    unit = SHIFTED[column]
    return lambda values: f"the {what} is off by up to {value_text(float(np.abs(values).max()), unit)}{within}"


def _delay_words(column: str) -> Callable[[np.ndarray], str]:
    what = column.replace("_", " ")
    return lambda values: f"the {what} is read up to {float(np.abs(values).max()) * 1e3:.2g} ms late or early"


def _clock_words(values: np.ndarray) -> str:
    return f"clocks of the channels run apart by up to {float(f'{np.abs(values).max() * 1e6:.3g}'):g} ppm"


def _drift_words(parameter: NuisanceParameter, session: Session) -> Callable[[np.ndarray], str]:
    channel = parameter.sensor.channel if parameter.sensor is not None else ""
    whole = fastest_drift(session, channel)
    return lambda values: f"{channel} as read drifts by {100.0 * abs(values[0]) / whole:.2g} % of its span in a record"


def _zero_words(channel: str) -> Callable[[np.ndarray], str]:
    def words(values: np.ndarray) -> str:
        zeros = contrasts(len(values) + 1) @ values
        by = value_text(float(np.ptp(zeros)), UNITS[channel])
        return f"the zero of {channel} moves by up to {by} between records"

    return words


def _gain_words(channel: str) -> Callable[[np.ndarray], str]:
    def words(values: np.ndarray) -> str:
        gains = contrasts(len(values) + 1) @ values
        return f"the gain of {channel} moves by up to {100.0 * float(np.ptp(gains)):.2g} % between records"

    return words


def _linearity_words(channel: str, session: Session) -> Callable[[np.ndarray], str]:
    largest = largest_reading(session, channel)

    def words(values: np.ndarray) -> str:
        by = 100.0 * float(np.abs(values).max()) / largest
        return f"{channel} as read is off a straight line by up to {by:.2g} % of its largest reading"

    return words
