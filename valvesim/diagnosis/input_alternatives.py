"""Causes under other ways of the commands between their samples: what a fast command does there acts like a cause.

Each way is judged by what a cause leaves beyond the noise under it, with the samples that count under all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.score_test import score_test
from valvesim.diagnosis.starts import single_starts
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate, rescored, with_shapes
from valvesim.identification.hypothesis_fit import continue_from, fit_from_prior
from valvesim.identification.input_choice import chi_square_of_way
from valvesim.identification.nominal_fit import (
    NominalFit,
    fit_nominal_near,
    has_chosen_inputs,
    has_implausible_delays,
    has_uncertain_inputs,
    under_other_inputs,
)
from valvesim.identification.study import Study

Weights = dict[tuple[str, str], np.ndarray]  # of whitened rows, by record and channel


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
    return _with_nominal_under(nominal, best)


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
    return _with_nominal_under(nominal, best)


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
    return _with_nominal_under(nominal, found)


def with_inputs_of_likeliest_cause(
    nominal: NominalFit, best: Fit, *, options: DiagnosisOptions
) -> tuple[NominalFit, Fit] | None:
    """The nominal fit under another way of its commands by which a single cause that shows there explains far more than
    the best under this one, and the fit of that cause; None where none does.

    A command that comes half a sample later acts like an eddy current: under the wrong way neither shows.
    """
    begun, weights = _begun_under_other_inputs(nominal, options=options)
    found = _best_way(begun, _excess(nominal.study, best, weights), weights)
    return _with_nominal_under(nominal, found)


def cause_under_other_inputs(nominal: NominalFit, best: Fit, *, options: DiagnosisOptions) -> Candidate | None:
    """Another cause that explains as much as the best, under another way of the commands than one that was read off the
    records; None where there is none, or the commands go on straight lines.
    """
    if not has_chosen_inputs(nominal.study):
        return None
    begun, weights = _begun_under_other_inputs(nominal, best.fitted[0].candidate, options=options)
    least, other = _excess(nominal.study, best, weights) + options.selection.answer_ratio, None
    for way, fit in begun:
        excess = _excess(way.study, fit, weights)
        if excess - fit.predicted_reduction > least:
            continue
        excess = _excess(way.study, _continued(way, fit, excess - least), weights)
        if excess < least:
            least, other = excess, fit.fitted[0].candidate
    return other


def _begun_under_other_inputs(
    nominal: NominalFit, named: Candidate | None = None, *, options: DiagnosisOptions
) -> tuple[list[tuple[NominalFit, Fit]], Weights]:
    """The single cause that shows most under each other way of the commands, fitted a little there unless it is the
    one that is `named` already, and the weights by which the ways are held against each other.
    """
    ways = under_other_inputs(nominal)
    likeliest = [(way, start) for way in ways for start in _likeliest_under(way, options=options)]
    starts = [(way, start) for way, start in likeliest if named is None or start[0].candidate.name != named.name]
    return _preliminary_fits(starts, options.isolation.near_linearisations), _least_weights([nominal, *ways])


def _likeliest_under(way: NominalFit, *, options: DiagnosisOptions) -> list[tuple[FittedCandidate, ...]]:
    """The start of the single cause that shows most under a way of the commands, if any does."""
    scores = score_test(way, way.fit, options=options)
    return single_starts(scores, scores.z() ** 2, options.isolation.single_share)[:1]


def _at_typical(member: FittedCandidate) -> FittedCandidate:
    """A fitted candidate at what is typical of it, with its shapes where they are looked for."""
    return with_shapes(member.candidate, float(np.copysign(member.candidate.typical, member.above_neutral)))


def best_inputs(nominal: NominalFit, fit: Fit, few: int) -> tuple[NominalFit, Fit]:
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
            tried = _continued(way, tried, excess - reached)
            excess = _excess(way.study, tried, weights)
        if excess + max(options.minimum_gain, options.gain_share * excess) < least:
            best, least = (way, tried), excess
    return best


def _continued(way: NominalFit, fit: Fit, too_much: float) -> Fit:
    """A fit under a way of the commands continued, while it may leave so much less."""
    return continue_from(way, fit, fit.chi_square - too_much) or fit


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


def _with_nominal_under(nominal: NominalFit, found: tuple[NominalFit, Fit] | None) -> tuple[NominalFit, Fit] | None:
    """The way of the commands that was found and the fit of a cause there, with the nominal model fitted under it."""
    return None if found is None else (fitted_under(nominal, found[0]), found[1])


def fitted_under(nominal: NominalFit, at: NominalFit) -> NominalFit:
    """The nominal model fitted in another study, from where it is there."""
    fully = is_at_full_weight(nominal.study, at.study)
    return fit_nominal_near(at.study.unweighted(), at.fit.point, full_weight=fully)


def is_at_full_weight(study: Study, extended: Study) -> bool:
    """Whether samples next to peaks count fully in a study with more parameters: as before, unless these are of inputs,
    which are then not known to the microseconds that a peak takes.
    """
    return not study.weights and not has_uncertain_inputs(extended)
