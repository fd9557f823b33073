"""The hypotheses to begin with, of one cause and of two, and the nominal fit from where they have gone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from valvesim.diagnosis.detection import beyond_noise
from valvesim.diagnosis.model_selection import FittedHypothesis, answer_set_width
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.refits import fit_starts, largest_shift
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.diagnosis.second_cause import without_corrections_begun
from valvesim.diagnosis.starts import is_of_one_effect, start_points
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit, evaluate_fit, is_adequate, rescored
from valvesim.identification.hypothesis_fit import continue_from, evaluated_beside
from valvesim.identification.nominal_fit import NominalFit, clipped_to_tolerance, distance_by_readings, refit_nominal


def first_hypotheses(
    nominal: NominalFit,
    scores: ScoreTest,
    known: Sequence[Fit],
    beside: Sequence[Fit],
    progress: Callable[[float], None],
) -> tuple[list[FittedHypothesis], str]:
    """Hypotheses of one and of two candidates, refitted, and the likeliest of them before.

    Those `known` are the only ones; those `beside` which the bench was looked at are among them.
    """
    found, likeliest, failed = _known_hypotheses(nominal, known, progress, options=scores.options), "", set[str]()
    if found:
        return found, likeliest
    point = clipped_to_tolerance(nominal) if _is_biased(nominal, options=scores.options) else None
    begun = _known_hypotheses(nominal, beside, lambda share: None, options=scores.options)
    labels, laws = {one.label for one in begun}, set[str]()
    if point is not None and begun and is_adequate(begun[0].fit, options=scores.options.identification):
        point = begun[0].fit.point  # what the bench did, and the valve, are known beside it
        laws = {candidate.plainest for candidate in begun[0].candidates}  # alike ones follow from its figures
    while starts := start_points(scores, failed):
        first, pairs = starts[0][0].candidate, [start for start in starts if not is_of_one_effect(start)]
        likeliest = first.label
        alone = [
            start for start in starts
            if is_of_one_effect(start)
            and start[0].candidate.label not in labels and start[0].candidate.plainest not in laws
        ]  # fmt: skip
        found = [*begun, *fit_starts(nominal, alone, point, progress, others=begun, options=scores.options)]
        if not any(_explains_all(one.fit, nominal, options=scores.options) for one in found):
            pairs = without_corrections_begun(nominal, pairs, found)
            found += fit_starts(nominal, pairs, point, progress, others=found, options=scores.options)
        if first.plainest in laws or any(likeliest == c.label for one in found for c in one.candidates):
            break
        failed.add(likeliest)  # no valve runs with it: what it promised is no measure for the others
    return found, likeliest


def _explains_all(fit: Fit, nominal: NominalFit, *, options: DiagnosisOptions) -> bool:
    """Whether a fit leaves nothing beyond noise that is verified, by figures of the valve that are not stretched: any
    other noise is itself what a fit leaves.
    """
    verified = all(noise.verified for noise in nominal.study.noise.values())
    stretched = largest_shift(fit) > options.isolation.shifted
    return verified and not stretched and beyond_noise(fit, nominal.study, options=options) == 0.0


def _is_biased(nominal: NominalFit, *, options: DiagnosisOptions) -> bool:
    """Whether an inadequate nominal fit has its figures biased by a cause: fits of causes begin within tolerance."""
    adequate = is_adequate(nominal.fit, options=options.identification)
    return not adequate and largest_shift(nominal.fit) > options.isolation.shifted


def _known_hypotheses(
    nominal: NominalFit, known: Sequence[Fit], progress: Callable[[float], None], *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """Hypotheses that were fitted elsewhere, refitted where they do not yet explain nearly as much as the likeliest."""
    begun = list[Fit]()
    for one in known:
        try:
            begun.append(evaluated_beside(nominal, one))
        except (SolveError, InputError):
            continue
    found = list[FittedHypothesis]()
    for k, fit in enumerate(sorted(begun, key=lambda fit: fit.chi_square)):
        progress(k / len(begun))
        near = found and fit.chi_square < found[0].fit.chi_square + options.isolation.as_good * answer_set_width(
            nominal, found[0]
        )
        refitted = fit if near else continue_from(nominal, fit)
        found += [FittedHypothesis(refitted, options=options)] if refitted is not None else []
    return found


def better_nominal(
    nominal: NominalFit, found: Sequence[FittedHypothesis], *, options: DiagnosisOptions
) -> NominalFit | None:
    """The nominal model fitted from where a hypothesis has gone, if that is better without its causes too.

    Then most of what this explains is that the nominal fit had stopped short. Of a hypothesis that explains little
    that is asked however much it would lose at first, unless it is little beside the best; once of those that have gone
    to the same point; and of none that explains nothing.
    """
    begun, most = list[tuple[np.ndarray, NominalFit]](), 0.0
    for one in sorted((one.fit for one in found), key=lambda fit: fit.chi_square):
        gain = nominal.fit.chi_square - one.chi_square
        most = max(most, gain)
        if gain <= 0.0 or gain < min(options.isolation.single_share * most, options.isolation.slight_gain):
            break
        better = next((fit for point, fit in begun if _lie_together(nominal, one.point, point, options=options)), None)
        if better is None and (better := _nominal_from(nominal, one, gain, options=options)) is not None:
            begun.append((one.point, better))
        if better and rescored(better.study, nominal.fit).chi_square - better.fit.chi_square > 0.5 * gain:
            return better
    return None


def _nominal_from(nominal: NominalFit, one: Fit, gain: float, *, options: DiagnosisOptions) -> NominalFit | None:
    """The nominal model fitted from where a hypothesis has gone; None where that need not be asked, or fails."""
    try:
        fit = evaluate_fit(nominal.study, one.point, (), nominal.fit.trajectories)
        if fit.chi_square > one.chi_square + 0.5 * gain and not 0.0 < gain < options.isolation.slight_gain:
            return None
        return refit_nominal(nominal, fit, 0.5 * gain)
    except (SolveError, InputError):
        return None


def _lie_together(nominal: NominalFit, point: np.ndarray, other: np.ndarray, *, options: DiagnosisOptions) -> bool:
    """Whether two points (p,) lie together as seen from a nominal fit, by what the readings and the priors tell."""
    way = distance_by_readings(nominal, other - nominal.fit.point)
    return distance_by_readings(nominal, point - other) < options.isolation.same_start * way
