"""Errors of the instruments that explain together what none of them does by itself, and models without any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.detection import nuisance_covariance, nuisance_occam_factor, wald_statistic
from valvesim.diagnosis.known_faults import all_known_faults, fault_words, significant_faults
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.instrument_errors import instrument_errors
from valvesim.identification.nominal_fit import NominalFit, fit_nominal_near, with_nuisance
from valvesim.identification.projection import inverse_of
from valvesim.identification.study import Study


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


def joint_instrument_errors(scores: ScoreTest, *, options: DiagnosisOptions) -> JointErrors | None:
    """Errors of the instruments by a fit, none of which is told by itself: a cause may act like several at once. None
    where one is, or where they explain no more than chance and `minimum_gain`.
    """
    told = significant_faults(scores, options=options)
    return None if told else all_instrument_errors(scores, options.bench.minimum_gain)


def all_instrument_errors(scores: ScoreTest, least_gain: float) -> JointErrors | None:
    """Errors of the instruments by a fit, told by themselves or not; None where they explain no more than chance and
    `least_gain`.
    """
    study = scores.study
    at = {p.name: k for k, p in enumerate(study.nominal.parameters)}
    errors, together = _errors_together(scores)
    if together <= least_gain + len(errors):
        return None
    faults = [fault for fault in all_known_faults(study) if errors.issuperset(p.name for p in fault.parameters)]
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
    fewest = tuple(fault_words(scores, faults[k], own, point) for k, own in kept.items())
    return JointErrors(together, fewest, scores.fit.chi_square + least)


def instrument_errors_are_insignificant(scores: ScoreTest, least_gain: float, *, options: DiagnosisOptions) -> bool:
    """Whether errors of the instruments are among the parameters of a fit and show nothing: together no more than
    chance and `least_gain`, and none of what the bench did by itself.
    """
    errors, together = _errors_together(scores)
    by_chance = bool(errors) and together <= least_gain + len(errors)
    return by_chance and not significant_faults(scores, options=options)


def _errors_together(scores: ScoreTest) -> tuple[set[str], float]:
    """The errors of the instruments among the parameters of a fit, by name, and the chi-square that they explain
    together.
    """
    own = error_places(scores.study)
    return {scores.study.nominal.parameters[k].name for k in own}, wald_statistic(scores, own)


def without_instrument_errors(nominal: NominalFit) -> NominalFit:
    """The nominal fit without errors of the instruments among its parameters."""
    study = nominal.study.unweighted()
    kept = np.delete(np.arange(len(study.nominal.parameters)), error_places(study))
    plain = with_nuisance(study, tuple(study.nominal.parameters[k] for k in kept))
    return fit_nominal_near(plain, nominal.fit.point[kept], full_weight=not nominal.study.weights)


def error_places(study: Study) -> list[int]:
    """The places of errors of the instruments among the parameters of a study."""
    errors = {p.name for p in instrument_errors(study.session, options=study.options)}
    return [k for k, p in enumerate(study.nominal.parameters) if p.name in errors]
