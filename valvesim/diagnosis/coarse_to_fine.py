"""Long sessions: their records' beginnings are searched first, and the whole session for what these have shown.

A look at ten minutes of records takes some twenty times as long as one at their first seconds. What does not explain
these does not explain the whole either, so that few hypotheses are left to be fitted to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from valvesim.diagnosis.isolation import Isolation, isolate
from valvesim.diagnosis.model_selection import answer_set_width
from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.errors import InputError, SolveError
from valvesim.identification.aliasing import without_aliased_records
from valvesim.identification.bad_samples import (
    without_beginnings,
    without_bursts,
    without_outliers,
    without_saturation,
)
from valvesim.identification.fit import Fit, is_adequate
from valvesim.identification.input_errors import with_input_errors
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.nominal_fit import NominalFit, fit_nominal, fit_nominal_near, with_choice_of
from valvesim.identification.session import Record
from valvesim.identification.study import PreparedSession, restricted_session


def fit_coarse_to_fine(
    prepared: PreparedSession, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> tuple[NominalFit, Sequence[Fit]]:
    """The nominal fit of a session, and of a long one the hypotheses (fitted to beginnings) that are to be fitted to
    it.

    Without hypotheses the whole session is to be searched for them. `progress(stage, share)` is called with what is
    being done. Raises SolveError where the valve cannot be run.
    """
    stage = "fitting the nominal model"
    progress(stage, 0.0)
    prepared = _without_aliased_records(prepared, lambda share: progress(stage, share), options=options)
    if prepared.is_long:
        with suppress(SolveError, InputError):  # a record's beginning need not hold what makes it a record
            isolation = _isolate_in_segments(
                prepared, lambda what, share: progress(f"{what}, in the first seconds", 0.5 * share), options=options
            )
            progress(stage, 0.5)
            p, segments = len(prepared.nominal.parameters), isolation.nominal
            chosen = with_choice_of(prepared, segments.study)
            point = np.append(segments.fit.point[:p], np.zeros(len(chosen.nominal.parameters) - p))
            chosen = with_input_errors(chosen, point)
            nominal = fit_nominal_near(chosen, point, full_weight=not segments.study.weights)
            known = _taken_along(isolation, options=options)
            fits = [replace(fit, point=fit.point[:p]) for fit in known if fit.fitted]
            return _without_bad_samples(nominal), fits
    nominal = fit_nominal(prepared, lambda share: progress(stage, share))
    if is_adequate(nominal.fit, options=prepared.options):
        return _without_bad_samples(nominal), ()
    cleaned = without_bursts(without_beginnings(prepared, nominal.fit), nominal.fit, nominal.linearised)
    if cleaned is not prepared:
        prepared, nominal = cleaned, fit_nominal(cleaned, lambda share: progress(stage, share))
    if not is_adequate(nominal.fit, options=prepared.options):
        cleaned = without_saturation(prepared, nominal.study, nominal.fit)
        nominal = nominal if cleaned is prepared else fit_nominal(cleaned, lambda share: progress(stage, share))
    return _without_outliers(nominal), ()


def _without_aliased_records(
    prepared: PreparedSession, progress: Callable[[float], None], *, options: DiagnosisOptions
) -> PreparedSession:
    """The prepared session, or where its nominal fit is inadequate the one without the records whose commands alias, if
    that leaves next to nothing of what the first does; by the first seconds of a long one.
    """
    fewer = without_aliased_records(prepared)
    if fewer is prepared:
        return prepared

    def fitted(one: PreparedSession) -> Fit:
        return fit_nominal(_leading_segments_of(one, options=options), progress).fit

    if is_adequate(before := fitted(prepared), options=prepared.options):
        return prepared
    left, most = fitted(fewer), options.coarse_to_fine.aliased_share * (before.chi_square - before.rows)
    return fewer if left.chi_square - left.rows < most else prepared


def _taken_along(isolation: Isolation, *, options: DiagnosisOptions) -> list[Fit]:
    """The answer set of records' beginnings and what is not in it by little, for the rest may tell otherwise; the
    likeliest where nothing is. Where they are another valve's, the cause that comes nearest: the whole is to bear that
    out.
    """
    if isolation.nearest is not None:
        return [isolation.nearest]
    if not isolation.answer_set:
        return [one.fit for one in isolation.found[: options.coarse_to_fine.taken_along]]
    best = isolation.answer_set[0]
    worst = best.evidence + options.coarse_to_fine.taken_width * answer_set_width(isolation.nominal, best)
    known = [one.label for one in isolation.answer_set]
    behind = [one for one in isolation.found if one.evidence < worst and one.label not in known]
    return [one.fit for one in (*isolation.answer_set, *behind)]


def _without_bad_samples(nominal: NominalFit) -> NominalFit:
    """The nominal fit without bursts of noise, beginnings in motion and single readings far off it, from where it is;
    an inadequate fit errs itself, and no single readings are left out.
    """
    own = nominal.study.unweighted()
    cleaned = without_bursts(without_beginnings(own, nominal.fit), nominal.fit, nominal.linearised)
    if is_adequate(nominal.fit, options=nominal.study.options):
        cleaned = without_outliers(cleaned, own, nominal.fit, _of_records(nominal.linearised, cleaned))
    return nominal if cleaned is own else _without_outliers(_fitted_near(cleaned, nominal))


def _without_outliers(nominal: NominalFit) -> NominalFit:
    """The nominal fit without single readings far off it, if there are such; an inadequate fit errs itself."""
    if not is_adequate(nominal.fit, options=nominal.study.options):
        return nominal
    own = nominal.study.unweighted()
    cleaned = without_outliers(own, own, nominal.fit, nominal.linearised)
    return nominal if cleaned is own else _fitted_near(cleaned, nominal)


def _of_records(linearised: Sequence[LinearisedRecord], session: PreparedSession) -> list[LinearisedRecord]:
    """Linearised records with the samples usable that are so in a session of them."""
    pairs = zip(linearised, session.predictors, strict=True)
    return [replace(one, predictor=replace(one.predictor, record=other.record)) for one, other in pairs]


def _fitted_near(session: PreparedSession, nominal: NominalFit) -> NominalFit:
    """The nominal fit to a session of other samples, from where it is."""
    return fit_nominal_near(session, nominal.fit.point, full_weight=not nominal.study.weights)


def _isolate_in_segments(
    prepared: PreparedSession, progress: Callable[[str, float], None], *, options: DiagnosisOptions
) -> Isolation:
    short = _leading_segments_of(prepared, options=options)
    progress("fitting the nominal model", 0.0)
    nominal = fit_nominal(short, lambda share: progress("fitting the nominal model", 0.3 * share))
    return isolate(nominal, lambda stage, share: progress(stage, 0.3 + 0.7 * share), options=options)


def _leading_segments_of(prepared: PreparedSession, *, options: DiagnosisOptions) -> PreparedSession:
    """A session of the first seconds of its records; one that is not long as it is."""
    if not prepared.is_long:
        return prepared
    records = [predictor.record for predictor in prepared.predictors]
    kept = leading_segments(records, len(set(prepared.representatives)), options=options)
    return restricted_session(prepared, kept)


def leading_segments(records: Sequence[Record], tests: int, *, options: DiagnosisOptions) -> list[Record]:
    """The records' first seconds, from just before their inputs move; repeats, of so many tests, keep in step."""
    most, starts = max(options.coarse_to_fine.samples // tests, options.coarse_to_fine.least_samples), dict[str, int]()
    for record in records:
        starts[record.test] = min(_start(record, options=options), starts.get(record.test, len(record.time)))
    return [_part(record, slice(starts[record.test], starts[record.test] + most)) for record in records]


def _start(record: Record, *, options: DiagnosisOptions) -> int:
    """The sample from which a record says something."""
    moved = np.zeros(len(record.time), dtype=bool)
    for name in record.inputs:
        values = record.values[name]
        moved |= np.abs(values - values[0]) > options.coarse_to_fine.motion * np.ptp(values)
    return max(int(np.argmax(moved)) - int(np.ceil(options.coarse_to_fine.lead * record.rate)), 0)


def _part(record: Record, kept: slice) -> Record:
    return replace(
        record,
        time=record.time[kept] - record.time[kept.start],
        values={name: values[kept] for name, values in record.values.items()},
        usable={name: usable[kept] for name, usable in record.usable.items()},
    )
