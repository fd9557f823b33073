"""The bench, not the valve: what a test bench does that no record tells.

Instruments err (`identification.instrument_errors`), the supply ripples, the mains hum upon the current. What explains
the readings by much more than chance, and beside the likeliest causes too, joins the nuisance parameters of the nominal
model: no cause is sought for it. A strong cause hides it, so it is sought in what the likeliest cause leaves as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from valvesim.diagnosis.detection import is_other_valve, leaves_noise
from valvesim.diagnosis.input_alternatives import best_inputs, fitted_under, is_at_full_weight
from valvesim.diagnosis.known_faults import all_known_faults
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.score_test import ScoreTest, score_test, term_score_test
from valvesim.diagnosis.starts import likeliest_starts
from valvesim.errors import InputError, SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit, is_adequate, rescored
from valvesim.identification.fit_jacobian import added_jacobian_of, all_candidate_sensitivities
from valvesim.identification.hypothesis_fit import continue_fit, continue_from, fit_from_prior, fit_hypothesis
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
    with_parameters,
)
from valvesim.identification.instrument_errors import has_instrument_errors, input_shifts, instrument_errors
from valvesim.identification.nominal_fit import (
    NominalFit,
    assembled,
    fit_nominal_near,
    has_implausible_delays,
    linearise_nominal,
    linearised_at,
    point_under,
    with_inputs_beside,
    with_inputs_reviewed,
    with_nuisance,
)
from valvesim.identification.prior import NuisanceParameter
from valvesim.identification.study import Study


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
        if not _keeps_promise(nominal, scores, better, likeliest, options=options):
            break  # it is something else
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
        shows = _shows(scores) ** 2
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
            leaves_noise(fit, nominal.study, options=options) or explains_nearly_all(fit, nominal.fit, options=options)
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
            (at, fit), left_when_asked = best_inputs(at, fit, few), left
            continue
        known = term_score_test(at, fit, options=options)
        if (tuned := _tuned_beside(at, fit, known)) is not None:
            at, fit = tuned
            if (better_fit := fit_hypothesis(at, fit.fitted, fit.point, few)) is None:
                break
            fit = better_fit
        beside = score_test(at, fit, known=known, options=options)
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
            (at, fit), left_when_asked = best_inputs(at, fit, few), left
        else:
            break
    if at is nominal:
        return nominal, scores, fit
    nominal = fitted_under(nominal, at)
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


def explains_nearly_all(fit: Fit, nominal: Fit, *, options: DiagnosisOptions) -> bool:
    """Whether a fit explains nearly all of what the nominal one leaves: alike laws would not tell the bench better."""
    return fit.chi_square - fit.rows <= options.bench.left_share * (nominal.chi_square - nominal.rows)


def _excess_to_beat(start: Sequence[FittedCandidate], other: Fit, *, options: DiagnosisOptions) -> float:
    """What a fit from a start may leave beyond the noise to explain more than another one: far less where its law is
    the other's with a feature more, which takes up some of what the bench did and is harder to fit.
    """
    alike = [e.candidate.plainest for e in start] == [e.candidate.name for e in other.fitted]
    share = options.bench.alike_share if alike else 1.0
    return share * (other.chi_square - other.rows)


def with_fault_left(nominal: NominalFit, left: ScoreTest, *, options: DiagnosisOptions) -> NominalFit | None:
    """The nominal fit with what the bench did by what a cause leaves: a second cause would be sought for it. None where
    the bench explains none of that, or by it samples next to peaks count less and the cause does not show without them.
    """
    likeliest = _likeliest(nominal, left, options=options)
    if likeliest is None:
        return None
    better = _extended(nominal, likeliest.parameters)
    without = _at_weight_of(nominal, better)
    if without is nominal:
        return better
    if _gain_by_fault(without, better) < 0.5 * likeliest.gain:
        return None
    causes = {member.candidate.label for member in left.fit.fitted}
    scores = score_test(without, without.fit, options=options)
    shows = max(z for z, candidate in zip(scores.z(), scores.candidates, strict=True) if candidate.label in causes)
    return better if shows > scores.level(options.detection.false_alarm) else None


def _keeps_promise(
    nominal: NominalFit,
    scores: ScoreTest,
    better: NominalFit,
    likeliest: BenchHypothesis,
    *,
    options: DiagnosisOptions,
) -> bool:
    """Whether what the bench did explains half of what it promised. Where samples next to peaks count less by it, half
    of what it promises without them; and where nothing shows at all without them, half of what a cause did with them.
    """
    without, promised = _at_weight_of(nominal, better), likeliest.gain
    gain, shown = _gain_by_fault(without, better), _shows(scores) ** 2
    if without is nominal or gain >= 0.5 * max(promised, shown):
        return gain >= 0.5 * promised
    left = score_test(without, without.fit, options=options)
    if gain < 0.5 * promised:
        again = _likeliest(without, left, options=options)
        promised = again.gain if again is not None else promised
    is_hidden = gain < 0.5 * shown and _shows(left) <= left.level(options.detection.false_alarm)
    return gain >= 0.5 * promised and not is_hidden


def _shows(scores: ScoreTest) -> float:
    """The z of the candidate that explains most of what is left."""
    return float(np.max(scores.z(), initial=0.0))


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


def _widened(nominal: NominalFit, parameters: Sequence[NuisanceParameter]) -> NominalFit:
    """The nominal fit with more parameters, at nothing of them."""
    study = with_parameters(nominal.study.unweighted(), parameters)
    point = np.append(nominal.fit.point, np.zeros(len(parameters)))
    return linearised_at(study, point, full_weight=is_at_full_weight(nominal.study, study))


def _extended(
    nominal: NominalFit, parameters: Sequence[NuisanceParameter], start: np.ndarray | None = None
) -> NominalFit:
    """The nominal fit with more parameters: from where it is, at nothing of them, or from another point."""
    prepared = with_parameters(nominal.study.unweighted(), parameters)
    point = np.append(nominal.fit.point, np.zeros(len(parameters))) if start is None else start
    return fit_nominal_near(prepared, point, full_weight=is_at_full_weight(nominal.study, prepared))


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

    shows = _shows(scores) ** 2
    best = max((beside(each, most) for each in hypotheses), key=lambda one: one.gain)
    if best.gain > max(options.bench.minimum_gain, options.bench.gain_share * max(shows, fit.chi_square - fit.rows)):
        return best
    if shows <= scores.level(options.detection.false_alarm) ** 2:
        return None
    known = [f.parameters for f in all_known_faults(study) if all(p.name in place for p in f.parameters)]
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
