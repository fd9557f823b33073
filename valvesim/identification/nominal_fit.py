"""The fit of the nominal model: nuisance parameters and noise, by maximum a posteriori."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import EdgeDuration, EdgeTime
from valvesim.identification.down_weighting import down_weight_peaks, robust_weights
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit, is_adequate, rescored
from valvesim.identification.fit_jacobian import jacobian_of, linearise_fit
from valvesim.identification.input_choice import (
    HELD_NAME,
    READ_BACK_NAME,
    STRAIGHT,
    InputChoice,
    are_delays,
    chi_square_of_way,
    choose_inputs,
    excess_after_jumps,
    input_choices,
    input_notes,
    input_spread,
    searched_edges,
)
from valvesim.identification.input_errors import with_input_errors
from valvesim.identification.input_waves import dominant_wave, fitted_waves, tuned_waves, with_parameters
from valvesim.identification.instrument_errors import instrument_errors
from valvesim.identification.least_squares import bounded_step, levenberg_marquardt, normal_equations, predict_reduction
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.noise_estimation import evaluated_under_own_noise, identify_noise, initial_noise
from valvesim.identification.prior import NominalModel, NuisanceParameter
from valvesim.identification.study import Prepared, PreparedSession, Study, with_records


@dataclass(frozen=True, eq=False)
class NominalFit:
    """The nominal model at its maximum a posteriori, linearised there.

    `columns` are its sensitivities to the nuisance parameters, see `linearise_study`; `J` (rows, p) the same, whitened.
    `is_reviewed` where its own figures have been asked how the commands go between their samples, and ask for no other
    way.
    """

    study: Study
    fit: Fit
    linearised: tuple[LinearisedRecord, ...]
    columns: tuple[dict[str, np.ndarray], ...]
    J: np.ndarray
    is_reviewed: bool = False


def fit_nominal(prepared: PreparedSession, progress: Callable[[float], None] = lambda share: None) -> NominalFit:
    """Fit the nuisance parameters and identify the noise. Raises SolveError where the valve cannot be simulated."""
    reached = 0.0

    def ahead(share: float) -> None:
        nonlocal reached
        reached = max(reached, share)
        progress(reached)

    prepared, choice, nominal = _robust_with_inputs(with_input_errors(prepared), ahead)
    nominal = _with_own_noise(nominal, ahead)
    prepared = replace(prepared, input_errors=with_input_errors(nominal.study, nominal.fit.point).input_errors)
    has_no_edges = not choice.parameters and choice.name not in (HELD_NAME, READ_BACK_NAME)  # seen by now, perhaps
    if has_no_edges and not is_adequate(nominal.fit, options=prepared.options):  # else they are asked for at the end
        choice, nominal = _under_better_choice(prepared, choice, nominal, ahead)
    full = _in_full(with_input_choice(prepared, choice, nominal.study), nominal, ahead)
    better, again = _under_better_choice(prepared, choice, full, ahead)
    if better is choice:
        return replace(full, is_reviewed=True)
    return _in_full(with_input_choice(prepared, better, again.study), again, ahead)


def _under_better_choice(
    prepared: PreparedSession, choice: InputChoice, nominal: NominalFit, ahead: Callable[[float], None]
) -> tuple[InputChoice, NominalFit]:
    """The way of the commands that the figures of a fit ask for, and where it is another one the fit at the samples
    alone under that; else those given.
    """
    _, _, better = _reviewed_choice(nominal)
    if better.name == choice.name:
        return choice, nominal
    again = with_input_choice(prepared, better)
    return better, _with_own_noise(_robustly_fitted(_at_nominal(again, _point_by_name(nominal)), ahead), ahead)


def _robust_with_inputs(
    prepared: PreparedSession, ahead: Callable[[float], None]
) -> tuple[PreparedSession, InputChoice, NominalFit]:
    """A robust start under what the inputs do that no sample tells: the session with the waves upon them among its
    parameters, how its commands go between their samples, and the fit with both. Where there is a wave, the errors of
    the instruments are among the parameters too: the bench is no ideal one.
    """
    choice, start, robust = _plain_choice(prepared)
    near = dict[str, float]()
    wave = dominant_wave(start.study, start.fit, start.linearised, start.columns)
    if wave:
        prepared, near = _with_waves(prepared, choice, wave, start.study, ahead)
        prepared = with_parameters(prepared, instrument_errors(prepared.session, options=prepared.options))
        start = _at_nominal(with_input_choice(prepared, choice, start.study), near)
    if wave or robust is None:
        better = _choice_at_start(start)
        if better.name != choice.name:
            choice, start = better, _at_nominal(with_input_choice(prepared, better), near)
    else:
        start = robust
    nominal = _robustly_fitted(start, ahead)
    for _ in range(prepared.options.wave.most):
        wave = dominant_wave(nominal.study, nominal.fit, nominal.linearised, nominal.columns)
        if not wave:
            break
        prepared = with_parameters(prepared, wave)
        again = with_input_choice(prepared, choice, nominal.study)
        nominal = _robustly_fitted(_at_nominal(again, _point_by_name(nominal)), ahead)
        weighted = replace(nominal, study=down_weight_peaks(nominal.study, nominal.linearised))
        _, _, better = _reviewed_choice(weighted)
        if better.name != choice.name:
            again = with_input_choice(prepared, better)
            choice, nominal = better, _robustly_fitted(_at_nominal(again, _point_by_name(nominal)), ahead)
    return prepared, choice, nominal


def _at_nominal(prepared: PreparedSession, near: Mapping[str, float]) -> NominalFit:
    """The nominal valve linearised at the samples alone, under a first guess of the noise; `near` are parameters (prior
    deviations by name) that are not nominal.
    """
    study = prepared.without_oversampling().with_noise(initial_noise(prepared))
    fit = evaluate_fit(study, _named_point(study.nominal, near), ())
    return assembled(study, fit, *linearise_fit(study, fit))


def _plain_choice(prepared: PreparedSession) -> tuple[InputChoice, NominalFit, NominalFit | None]:
    """How the commands go between their samples, edges left aside, by a robust start from nominal under each way; and
    the nominal valve under it.

    Where straight lines come near the records, linear answers tell as well, of edges too, and more cheaply; where they
    say straight, the robust start is given as well.
    """
    best, least = (STRAIGHT, straight := _at_nominal(prepared, {})), np.inf
    for choice in input_choices(prepared.session, options=prepared.options):
        if choice.parameters:
            continue
        start = straight if choice is STRAIGHT else _at_nominal(with_input_choice(prepared, choice), {})
        fit, linearised, columns = robust_start(start.study, start.fit, known=(start.linearised, start.columns))
        if choice is STRAIGHT and is_adequate(fit, options=prepared.options):
            better = choose_inputs(start.study, fit.point, linearised, columns)
            if better is STRAIGHT:
                return better, start, assembled(start.study, fit, linearised, columns)
            return better, _at_nominal(with_input_choice(prepared, better), {}), None
        chi_square = chi_square_of_way(start.study, fit)
        if chi_square < least - prepared.options.input.minimum_gain:
            best, least = (choice, start), chi_square
    return *best, None


def _with_waves(
    prepared: PreparedSession,
    choice: InputChoice,
    wave: tuple[NuisanceParameter, ...],
    known: Study,
    ahead: Callable[[float], None],
) -> tuple[PreparedSession, dict[str, float]]:
    """The prepared session with a wave upon its inputs that the nominal valve shows already, and those that show beside
    it; and their components in prior deviations, by name.
    """
    near = dict[str, float]()
    for _ in range(prepared.options.wave.most):
        prepared = with_parameters(prepared, wave)
        nominal = _robustly_fitted(_at_nominal(with_input_choice(prepared, choice, known), near), ahead)
        near = _point_by_name(nominal)
        wave = dominant_wave(nominal.study, nominal.fit, nominal.linearised, nominal.columns)
        if not wave:
            break
    waves = {p.name for one in fitted_waves(prepared.nominal).values() for p in one}
    return prepared, {name: t for name, t in near.items() if name in waves}


def _point_by_name(nominal: NominalFit) -> dict[str, float]:
    return {p.name: t for p, t in zip(nominal.study.nominal.parameters, nominal.fit.point, strict=True)}


def _clipped_by_name(nominal: NominalFit) -> dict[str, float]:
    return dict(zip(_point_by_name(nominal), clipped_to_tolerance(nominal), strict=True))


def _named_point(model: NominalModel, near: Mapping[str, float]) -> np.ndarray:
    """The point (p,) of a model where parameters are at `near`, by name; what is left out is nominal."""
    return np.array([near.get(p.name, 0.0) for p in model.parameters])


def _robustly_fitted(start: NominalFit, ahead: Callable[[float], None]) -> NominalFit:
    """A robust start at the samples alone under the noise of repeats or a first guess, from where a fit is, see
    `_at_nominal`.
    """
    study, readings = start.study, start.fit.readings
    labels = [predictor.record.repeats for predictor in study.predictors if predictor.record.repeats]
    noise = identify_noise(study, readings) if len(labels) > len(set(labels)) else {}
    if noise and all(one.verified for one in noise.values()):
        study = study.with_noise(noise)
    known = start.linearised, start.columns
    return assembled(study, *robust_start(study, rescored(study, start.fit), ahead, known))


def _with_own_noise(nominal: NominalFit, ahead: Callable[[float], None]) -> NominalFit:
    """A robust start continued at the samples alone, with the noise that it leaves where repeats have not told it."""
    nominal = _tuned(_converge_down_weighted(nominal, ahead))
    if not all(one.verified for one in nominal.study.noise.values()):
        for _ in range(2):  # the noise is what the best fit leaves: again with its colour
            noise = identify_noise(nominal.study, nominal.fit.readings)
            nominal = _converge_down_weighted(replace(nominal, study=nominal.study.with_noise(noise)), ahead)
    return nominal


def _in_full(prepared: PreparedSession, nominal: NominalFit, ahead: Callable[[float], None]) -> NominalFit:
    """A fit at the samples alone continued in full."""
    study = prepared.with_nominal(nominal.study.nominal).with_noise(nominal.study.noise)
    return _retuned(_at_full_weight(study, nominal, ahead))


def _tuned(nominal: NominalFit, enough: float = -np.inf) -> NominalFit:
    """A nominal fit, not fitted again, with waves on the inputs at the frequencies that it asks for; as it is where a
    fit there promises no more than `enough`. An inadequate one asks for what takes up a little of a cause.
    """
    if not fitted_waves(nominal.study.nominal) or not is_adequate(nominal.fit, options=nominal.study.options):
        return nominal
    parameters, point, promised = tuned_waves(nominal.study, nominal.fit, nominal.linearised, nominal.columns)
    if promised <= enough:
        return nominal
    study = with_nuisance(nominal.study, parameters)
    return linearise_nominal(study, evaluate_fit(study, point, (), nominal.fit.trajectories))


def _retuned(nominal: NominalFit) -> NominalFit:
    """A nominal fit with its waves tuned and fitted again, while that promises enough and brings it.

    A step is no longer than the parabola is known that it goes by, and figures that have gone far under other inputs
    shift what a wave seems to be.
    """
    enough = nominal.study.options.fit.nominal_ftol
    for _ in range(nominal.study.options.wave.tunings):
        tuned = _tuned(nominal, enough)
        if tuned is nominal:
            break
        better = _converge(tuned, enough)
        if better.fit.chi_square > nominal.fit.chi_square - enough:
            break
        nominal = better
    return nominal


def with_nuisance(study: Study, parameters: tuple[NuisanceParameter, ...]) -> Study:
    """A study with other nuisance parameters, of names that it has."""
    return study.with_nominal(replace(study.nominal, parameters=parameters))


def with_edges_searched(study: Study, fit: Fit) -> Fit:
    """A fit without candidates, not fitted again, with edges elsewhere in their intervals where that leaves less."""
    if not any(isinstance(p.input, EdgeTime) for p in study.nominal.parameters):
        return fit
    point = searched_edges(study, fit)
    if np.array_equal(point, fit.point):
        return fit
    moved = evaluate_fit(study, point, (), fit.trajectories)
    return fit if moved.chi_square > fit.chi_square else moved


def _choice_at_start(start: NominalFit) -> InputChoice:
    """How the commands go between their samples, by the nominal valve; samples that are far off count less.

    A fit under commands that went otherwise would move the valve's figures to make up for it.
    """
    readings = start.fit.readings
    study = robust_weights(start.study.with_noise(identify_noise(start.study, readings)), readings)
    return _reviewed_choice(replace(start, study=study))[2]


def with_input_choice(prepared: Prepared, choice: InputChoice, known: Study | None = None) -> Prepared:
    """The prepared session with its commands between their samples as chosen, and notes on it; a study of it, in which
    they go so, may be `known`.
    """
    if choice.name == STRAIGHT.name:
        return prepared
    nominal = prepared.nominal.extended(choice.parameters, choice.deviations)
    notes = input_notes(prepared.session, choice, options=prepared.options)
    found = with_records(prepared, (), notes).with_nominal(nominal)
    return replace(found, spread=known.spread if known is not None else input_spread(found))


def has_chosen_inputs(study: Study) -> bool:
    """Whether the commands go otherwise between their samples than on straight lines, by what the readings say."""
    return _without_choice(study)[1].name != STRAIGHT.name


def _without_choice(study: Study) -> tuple[Study, InputChoice]:
    """A session without what was taken of its commands between their samples, and what that was."""
    model = study.nominal
    edges = {p.name for p in model.parameters if isinstance(p.input, EdgeTime | EdgeDuration)}
    plain = replace(model, parameters=tuple(p for p in model.parameters if p.name not in edges),
                    variant=replace(model.variant, deviations=()))  # fmt: skip
    now = next(
        choice
        for choice in input_choices(study.session, True, options=study.options)
        if choice.deviations == model.variant.deviations and {p.name for p in choice.parameters} == edges
    )
    taken = () if now.name == STRAIGHT.name else input_notes(study.session, now, options=study.options)
    session = replace(study.session, notes=tuple(note for note in study.session.notes if note not in taken))
    return replace(study, nominal=plain, session=session, spread={}), now


def with_choice_of(prepared: PreparedSession, study: Study) -> PreparedSession:
    """A prepared session with its commands between their samples as in the study of parts of its records, where they
    may go so.
    """
    now = _without_choice(study)[1].name
    same = (one for one in input_choices(prepared.session, True, options=prepared.options) if one.name == now)
    return with_input_choice(prepared, next(same, STRAIGHT))


def _reviewed_choice(
    nominal: NominalFit, fitted: tuple[FittedCandidate, ...] = ()
) -> tuple[Study, InputChoice, InputChoice]:
    """The session of a fit without what it took of the commands between their samples; what that was; and the same or
    a better one by the figures of the fit, with candidates that are `fitted` beside it.
    """
    without, now = _without_choice(nominal.study)
    names = {p.name for p in without.nominal.parameters}
    own = [k for k, p in enumerate(nominal.study.nominal.parameters) if p.name in names]
    columns = [{name: each[:, own] for name, each in one.items()} for one in nominal.columns]
    return without, now, choose_inputs(without, nominal.fit.point[own], nominal.linearised, columns, now, fitted)


def with_inputs_reviewed(nominal: NominalFit) -> NominalFit:
    """A nominal fit, or the one near it under another way of its commands between their samples that its figures ask
    for now.

    A command that is held is half a sample late, one that was read back before it changed half a sample early. Where
    sensors seem late by more than they may be, the hold is fitted, where they seem early the other: a linear prediction
    from so far off does not find it.
    """
    without, now = _without_choice(nominal.study)
    if not nominal.is_reviewed and (better := _reviewed_choice(nominal)[2]).name != now.name:
        return _near_under(without, better, nominal, _point_by_name(nominal))
    if not has_implausible_delays(nominal.study, nominal.fit.point):
        return nominal
    late = np.any(_sensor_delays(nominal.study, nominal.fit.point) > _largest_plausible_delay(nominal.study))
    choices = input_choices(without.session, True, options=without.options)
    held = next((choice for choice in choices if choice.name == (HELD_NAME if late else READ_BACK_NAME)), now)
    if held.name == now.name:
        return nominal
    tried = _near_under(without, held, nominal, _point_by_name(nominal) | _delays_at_nominal(nominal.study))
    gain = (nominal.fit.chi_square - nominal.fit.rows) - (tried.fit.chi_square - tried.fit.rows)
    return tried if gain > nominal.study.options.input.minimum_gain else nominal


def with_edges_tried(nominal: NominalFit) -> NominalFit:
    """A nominal fit, or a better one with edges: fitted anew where commands jump, and it takes them as joined without,
    or otherwise between the edges.

    A curve through the samples answers an edge much as a lag of the valve does, a straight line a curve as an inertia
    does. A fit that has moved the valve's figures to make up for the one does not ask for the other any more; but what
    edges would gain, it leaves after the jumps.
    """
    without, now = _without_choice(nominal.study)
    if now.name in (HELD_NAME, READ_BACK_NAME):
        return nominal
    excess = nominal.fit.chi_square - nominal.fit.rows
    options = nominal.study.options.input
    worthwhile = max(options.minimum_gain, options.gain_share * excess)
    if excess_after_jumps(nominal.study, nominal.fit) < worthwhile:
        return nominal
    best, least = nominal, excess - worthwhile
    for choice in input_choices(without.session, options=without.options):
        if not choice.parameters or choice.name == now.name:
            continue
        tried = _near_under(without, choice, nominal, _clipped_by_name(nominal), least)
        if tried.fit.chi_square - tried.fit.rows < least:
            best, least = tried, tried.fit.chi_square - tried.fit.rows
    return best


def with_inputs_tried(nominal: NominalFit) -> NominalFit:
    """A nominal fit whose sensors seem late or early by more than they may be, or a better one under another way of its
    commands: each is fitted from within tolerance. All are judged by the noise of the nominal fit, without what its own
    way may be wrong by.
    """
    if not has_implausible_delays(nominal.study, nominal.fit.point):
        return nominal
    near = _clipped_by_name(nominal) | _delays_at_nominal(nominal.study)
    without, now = _without_choice(nominal.study)

    def left(one: NominalFit) -> float:
        return chi_square_of_way(replace(one.study, noise=nominal.study.noise, weights=nominal.study.weights), one.fit)

    best, least = nominal, left(nominal) - nominal.study.options.input.minimum_gain
    early = np.any(_sensor_delays(nominal.study, nominal.fit.point) < -_largest_plausible_delay(nominal.study))
    for choice in input_choices(without.session, bool(early), options=without.options):
        if choice.name == now.name:
            continue
        with suppress(SolveError, InputError):  # under which the valve cannot be run
            tried = _near_under(without, choice, nominal, near, least - nominal.fit.rows)
            if (chi_square := left(tried)) < least:
                best, least = tried, chi_square
    return best


def has_implausible_delays(study: Study, point: np.ndarray) -> bool:
    """Whether sensors are late or early by more than they may be at a point (p,) of a study, as they seem where a
    command goes otherwise between its samples.
    """
    return bool(np.any(np.abs(_sensor_delays(study, point)) > _largest_plausible_delay(study)))


def _sensor_delays(study: Study, point: np.ndarray) -> np.ndarray:
    """The sensors' delays at a point (p,) of a study, in prior deviations."""
    delays = are_delays(study.nominal)
    return point[: len(delays)][delays]


def _largest_plausible_delay(study: Study) -> float:
    """The prior deviations from which a sensor's delay is more than it may be."""
    return 2.0 * study.options.fit.tolerance_deviations


def _delays_at_nominal(study: Study) -> dict[str, float]:
    """The delays of a study's sensors at nominal, in prior deviations by name."""
    parameters = study.nominal.parameters
    return {p.name: 0.0 for p, delay in zip(parameters, are_delays(study.nominal), strict=True) if delay}


def with_inputs_beside(nominal: NominalFit, beside: NominalFit) -> NominalFit:
    """A nominal fit, or the one near it under the way of its commands that a fit `beside` it asks for, with candidates.
    """
    without, now, better = _reviewed_choice(beside, beside.fit.fitted)
    return nominal if better.name == now.name else _near_under(without, better, nominal, _point_by_name(nominal))


def point_under(other: NominalFit, nominal: NominalFit, point: np.ndarray) -> np.ndarray:
    """A point of a fit in the study of a nominal one, as a point (p,) of another study: what that alone has is as it
    was fitted there.
    """
    near = _point_by_name(other) | dict(zip(_point_by_name(nominal), point, strict=True))
    return _named_point(other.study.nominal, near)


def under_other_inputs(nominal: NominalFit, beside: Fit | None = None) -> list[NominalFit]:
    """A nominal fit within tolerance, not fitted again, under each other way of its commands: with edges where they
    jump. Where there is a fit of causes `beside` it, its figures are the ones of that, and no sensor is late.
    """
    without, now = _without_choice(nominal.study)
    near, found = _clipped_by_name(nominal), []
    if beside is not None:
        near = _clipped_by_name(replace(nominal, fit=beside)) | _delays_at_nominal(nominal.study)
    choices = input_choices(without.session, options=without.options)
    jump = any(choice.parameters for choice in choices)
    for choice in choices:
        if choice.name == now.name or (jump and not choice.parameters and choice.name != HELD_NAME):
            continue
        study = with_input_choice(without.unweighted(), choice)
        point = _named_point(study.nominal, near)
        found.append(linearised_at(study, point, full_weight=not nominal.study.weights))
    return found


def _near_under(
    without: Study, choice: InputChoice, nominal: NominalFit, near: Mapping[str, float], most_left: float = np.inf
) -> NominalFit:
    """The nominal fit under a choice of inputs, from a point (prior deviations by name) near another one; where it
    promises to leave more than `most_left` beyond the noise it is given up.
    """
    again = with_input_choice(without.unweighted(), choice)
    point, fully = _named_point(again.nominal, near), not nominal.study.weights
    return fit_nominal_near(again, point, full_weight=fully, most_left=most_left)


def fit_nominal_from(study: Study, fit: Fit, progress: Callable[[float], None] = lambda share: None) -> NominalFit:
    """The nominal model fitted under a study's noise: robustly, with peaks down-weighted, at last at full weight."""
    return _at_full_weight(study, _preliminary(study, fit, progress), progress)


def fit_nominal_near(
    prepared: PreparedSession, point: np.ndarray, *, full_weight: bool, most_left: float = np.inf
) -> NominalFit:
    """The nominal model fitted from a point (p,) near its best, and the noise with it; samples next to peaks count less
    unless at `full_weight`. A fit that promises to leave more than `most_left` beyond the noise is given up.
    """
    study, fit = evaluated_under_own_noise(prepared, point)
    nominal = _tuned(linearise_nominal(study, with_edges_searched(study, fit)))
    for last in (False, True):
        weighted = nominal.study if full_weight else down_weight_peaks(nominal.study, nominal.linearised)
        ftol = study.options.fit.nominal_ftol
        nominal = _converge(reweighted(weighted, nominal), ftol, most_left=most_left)
        if last or all(noise.verified for noise in nominal.study.noise.values()):
            break
        study = nominal.study.unweighted()
        nominal = reweighted(study.with_noise(identify_noise(study, nominal.fit.readings)), nominal)
    return _retuned(nominal)


def refit_nominal(nominal: NominalFit, fit: Fit, within: float = 0.0, remaining_share: float = 0.0) -> NominalFit:
    """The nominal model fitted from where another fit without candidates is, at full weight where it may be; the
    nominal fit itself where its equations promise that this ends at its chi-square, `within` so much, or where the fit
    at the samples alone has gone there but for a `remaining_share` of its way.
    """
    if within > 0.0 and _leads_back(nominal, fit, within):
        return nominal
    study = nominal.study if has_uncertain_inputs(nominal.study) else nominal.study.unweighted()
    start = rescored(study, fit)
    if is_adequate(start, options=study.options):
        return _converge(linearise_nominal(study, start), study.options.fit.nominal_ftol)
    preliminary = _preliminary(study, fit)
    far = remaining_share * distance_by_readings(nominal, fit.point - nominal.fit.point)
    if distance_by_readings(nominal, preliminary.fit.point - nominal.fit.point) < far:
        return nominal
    return _at_full_weight(study, preliminary)


def distance_by_readings(nominal: NominalFit, by: np.ndarray) -> float:
    """How far a point (p,) that lies `by` so much beside a nominal fit is from it, by what the readings and the priors
    tell, in noise deviations.
    """
    return float(np.hypot(np.linalg.norm(nominal.J @ by), np.linalg.norm(by)))


def _leads_back(nominal: NominalFit, fit: Fit, within: float) -> bool:
    """Whether the equations as they are linearised at a nominal fit promise that another fit without candidates ends
    at the same chi-square, `within` so much: it is in the same valley.
    """
    here = rescored(nominal.study, fit)
    H, gradient = normal_equations(here, nominal.J, options=nominal.study.options)
    promised = here.chi_square - predict_reduction(H, gradient, nominal.study.nominal.limits - fit.point)
    return abs(promised - nominal.fit.chi_square) < within


def _preliminary(study: Study, fit: Fit, progress: Callable[[float], None] = lambda share: None) -> NominalFit:
    """A fit at the samples alone, from a robust start, with peaks down-weighted."""
    without_oversampling = study.without_oversampling()
    return _converge_down_weighted(
        assembled(without_oversampling, *robust_start(without_oversampling, fit, progress)), progress
    )


def _at_full_weight(
    study: Study, nominal: NominalFit, progress: Callable[[float], None] = lambda share: None
) -> NominalFit:
    """A preliminary fit continued, first with peaks down-weighted, then at full weight; not where the model cannot
    follow the peaks for what it leaves between them already, or where what the inputs do is not known to the
    microseconds that a peak takes. What is left at the peaks alone is told by nothing else.
    """
    study = study.with_noise(nominal.study.noise)
    near = linearise_nominal(study, with_edges_searched(study, rescored(study, nominal.fit)))
    weighted = reweighted(down_weight_peaks(study, near.linearised), near)
    if has_uncertain_inputs(study):
        return _converge(weighted, study.options.fit.nominal_ftol, progress)
    near = unweighted(_converge(weighted, study.options.fit.preliminary_ftol, progress))
    full = _converge(near, study.options.fit.nominal_ftol, progress)
    left, left_between = full.fit.chi_square - full.fit.rows, nominal.fit.chi_square - nominal.fit.rows
    little = 0.1 * full.fit.rows
    follows = left <= study.options.fit.peak_ratio * max(left_between, 0.0) + little
    if (follows or left_between <= little) and is_adequate(full.fit, options=study.options):
        return full
    return _converge(
        reweighted(replace(study, weights=nominal.study.weights), near), study.options.fit.nominal_ftol, progress
    )


def has_uncertain_inputs(study: Study) -> bool:
    """Whether inputs go otherwise than their samples say: in a way that was chosen, or by what is fitted of them."""
    return bool(study.nominal.variant.deviations) or any(p.input is not None for p in study.nominal.parameters)


def unweighted(nominal: NominalFit) -> NominalFit:
    """The same fit with all samples at full weight."""
    return reweighted(nominal.study.unweighted(), nominal)


def reweighted(study: Study, nominal: NominalFit) -> NominalFit:
    """The same fit under a study's noise and weights."""
    return assembled(study, rescored(study, nominal.fit), nominal.linearised, nominal.columns)


def linearise_nominal(study: Study, fit: Fit) -> NominalFit:
    """A fit without candidates, linearised where it is."""
    return assembled(study, fit, *linearise_fit(study, fit))


def linearised_at(study: Study, point: np.ndarray, *, full_weight: bool) -> NominalFit:
    """The nominal model at a point (p,), not fitted; samples next to peaks count less unless at `full_weight`."""
    nominal = linearise_nominal(study, evaluate_fit(study, point, ()))
    return nominal if full_weight else reweighted(down_weight_peaks(study, nominal.linearised), nominal)


def assembled(
    study: Study, fit: Fit, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]]
) -> NominalFit:
    """The parts of a nominal fit put together, its Jacobian whitened."""
    return NominalFit(study, fit, tuple(linearised), tuple(columns), study.stack(columns))


def robust_start(
    study: Study,
    fit: Fit,
    progress: Callable[[float], None] = lambda share: None,
    known: tuple[Sequence[LinearisedRecord], Sequence[dict[str, np.ndarray]]] | None = None,
) -> tuple[Fit, Sequence[LinearisedRecord], Sequence[dict[str, np.ndarray]]]:
    """A robust start: samples that are far off are down-weighted (Huber), while that lowers the chi-square by a good
    part.

    A leakage peak in the wrong place does not tell which way it should move; the rest of the record does. Given back
    are the fit and its linearisation, see `linearise_study`; that of the start may be `known`. It ends before figures
    a little beyond which no valve can be run.
    """
    linearised, columns = known or linearise_fit(study, fit)
    for iteration in range(study.options.fit.robust_linearisations):
        progress(0.5 * iteration / study.options.fit.robust_linearisations)
        robust = robust_weights(study, fit.readings)
        start = rescored(robust, fit)
        near, _ = levenberg_marquardt(
            robust,
            start,
            jacobian_of(robust, fit, linearised, columns),
            study.options.fit.robust_ftol * start.chi_square,
        )
        if near.chi_square > (1.0 - study.options.fit.robust_ftol) * start.chi_square:
            break
        further = rescored(study, near)
        try:
            linearised, columns = linearise_fit(study, further)
        except (SolveError, InputError):
            break
        fit = further
    return fit, linearised, columns


def _converge(
    nominal: NominalFit,
    enough: float,
    progress: Callable[[float], None] = lambda share: None,
    most_left: float = np.inf,
) -> NominalFit:
    """The nominal model fitted under its study's noise until a fresh linearisation predicts no more than `enough`, or
    than is worth it of the excess chi-square.

    What steps have gained is kept and linearised again, unless it is next to nothing: a first step that brings less
    than `enough` may stand before as much again. It ends as well where an adequate fit is no longer in sight, or one
    that leaves no more than `most_left` beyond the noise, and before figures a little beyond which no valve can be run.
    """
    options = nominal.study.options.fit
    for iteration in range(options.nominal_linearisations):
        progress(0.5 + 0.5 * iteration / options.nominal_linearisations)
        least = nominal.study.negligible_reduction(nominal.fit.chi_square, nominal.fit.rows)
        fit, _ = levenberg_marquardt(nominal.study, nominal.fit, nominal.J, max(enough, least))
        gained = nominal.fit.chi_square - fit.chi_square
        beyond = fit.chi_square - options.inadequate_ratio * fit.rows
        hoped = options.nominal_reductions * fit.predicted_reduction if iteration else np.inf
        hopeless = fit.chi_square - fit.rows - hoped > most_left
        if gained < max(0.1 * enough, least, options.adequate_pace * beyond) or hopeless:
            break
        try:
            nominal = linearise_nominal(nominal.study, fit)
        except (SolveError, InputError):
            break
    return nominal


def _converge_down_weighted(nominal: NominalFit, progress: Callable[[float], None]) -> NominalFit:
    """The nominal model fitted with samples next to a sharp peak of a reading down-weighted: roughly where the noise
    is known, for a noise that is what a fit leaves as well as that needs.
    """
    options, verified = nominal.study.options.fit, all(one.verified for one in nominal.study.noise.values())
    enough = max(options.preliminary_ftol, options.preliminary_share * nominal.fit.rows * verified)
    weighted = reweighted(down_weight_peaks(nominal.study, nominal.linearised), nominal)
    return _converge(weighted, enough, progress)


def within_tolerance(nominal: NominalFit) -> Fit:
    """The nominal fit with no parameter beyond its tolerance: what the model can do without an extension."""
    if not np.any(np.abs(nominal.fit.point) > nominal.study.options.fit.tolerance_deviations):
        return nominal.fit
    limits = (
        np.outer(
            (-nominal.study.options.fit.tolerance_deviations, nominal.study.options.fit.tolerance_deviations),
            np.ones_like(nominal.fit.point),
        )
        - nominal.fit.point
    )
    return evaluate_fit(
        nominal.study,
        nominal.fit.point
        + bounded_step(*normal_equations(nominal.fit, nominal.J, options=nominal.study.options), limits),
        (),
        nominal.fit.trajectories,
    )


def clipped_to_tolerance(nominal: NominalFit) -> np.ndarray:
    """The nominal fit's point (p,) with each parameter that is beyond its tolerance back at the end of it."""
    return np.clip(
        nominal.fit.point,
        -nominal.study.options.fit.tolerance_deviations,
        nominal.study.options.fit.tolerance_deviations,
    )
