"""Samples that are no measurement: not recorded, or corrupt. They are found, left out of the fit, and told.

Corrupt are, before any fit, readings that stand apart from all others of their channel and are gone after a few
samples (a word of the logger such as 32767); after a fit, bursts of noise, and single readings far off the model whose
neighbours are not. What a record begins with tells nothing of a model at rest where the valve moved before it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from valvesim.errors import InputError
from valvesim.identification.between_samples import command_jumps
from valvesim.identification.fit import Fit
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.noise_growth import grown
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.record_audit import runs_of
from valvesim.identification.session import UNITS, Record, place_text, value_text
from valvesim.identification.study import PreparedSession, Study, with_records


def measured_samples(
    path: Path, name: str, values: dict[str, np.ndarray], outputs: Sequence[str], command: tuple[str, float],
    line_of: Callable[[int], int | None], time: np.ndarray, notes: list[str], *, options: IdentificationOptions,
) -> dict[str, np.ndarray]:  # fmt: skip
    """True for the samples (n,) of each output channel of record `name` that are measurements.

    In `values` the others get what a straight line between their neighbours gives, in place; in an input too, for which
    only a few in a row may be missing (InputError). A `command` (column, rated value) may stand apart as long as it is
    within twice its rated value.
    """
    usable = {}
    for column, read in values.items():
        there = np.isfinite(read)
        if not there.any():
            raise InputError(f"column {column!r} has no reading at all", file=path)
        corrupt = np.zeros(len(read), dtype=bool)
        corrupt[there] = _standing_apart(read[there], options=options)
        if column == command[0]:
            corrupt &= np.abs(np.where(there, read, 0.0)) > 2.0 * command[1]
        for k in np.flatnonzero(corrupt)[: options.audit.samples_told]:
            others = read[there & ~corrupt]
            span = f"{value_text(others.min(), UNITS[column])} to {value_text(others.max(), UNITS[column])}"
            where = f"{name}, {place_text(line_of(int(k)), time[k])}"
            reading = f"{column} of {value_text(read[k], UNITS[column])}"
            notes.append(f"{where}: {reading} is corrupt, for all others are {span}; it is left out")
        if (more := int(corrupt.sum()) - options.audit.samples_told) > 0:
            notes.append(f"{name}: {more} more samples of {column} are corrupt and left out")
        good = there & ~corrupt
        told = 0
        for start, end in runs_of(~good):
            missing = np.count_nonzero(~there[start:end])
            if column not in outputs and end - start > options.audit.longest_bridge:
                problem = f"no reading of {column} for {end - start} samples; an input may miss at most "
                raise InputError(
                    f"{problem}{options.audit.longest_bridge} in a row", file=path, line=line_of(int(start))
                )
            told += bool(missing)
            if missing and told <= options.audit.samples_told:
                where = f"{name}, {place_text(line_of(int(start)), time[start])}"
                theirs = f"{'they are' if end - start > 1 else 'it is'} {_treatment(column in outputs)}"
                notes.append(f"{where}: no reading of {column} for {end - start} samples; {theirs}")
        if (more := told - options.audit.samples_told) > 0:
            notes.append(f"{name}: {column} has no reading in {more} more places, {_treatment(column in outputs)}")
        if not good.all():
            at = np.arange(len(read))
            values[column] = np.interp(at, at[good], read[good])
        if column in outputs:
            usable[column] = good
    return usable


def _treatment(is_output: bool) -> str:
    return "left out" if is_output else "taken from a straight line between the neighbours"


def _standing_apart(read: np.ndarray, *, options: IdentificationOptions) -> np.ndarray:
    """True for readings (n,) that are few, in short runs, and further from all others than these are from each other.

    Leakage has sharp peaks, but not so far beyond its own range.
    """
    off = np.abs(read - np.median(read))
    order = np.argsort(off, kind="stable")
    inner = len(read)
    while True:  # each turn the largest gap among the furthest few of those that are left
        first = max(len(read) - max(int(options.audit.corrupt_share * len(read)), 1), 1)
        gaps = np.diff(off[order[first - 1 : inner]])
        if not len(gaps):
            break
        k = first + int(np.argmax(gaps))
        others = read[order[:k]]
        room = max(float(np.ptp(others)), options.audit.least_spread * float(np.max(np.abs(others))))
        if not gaps[k - first] > options.audit.corrupt_reach * room:
            break
        inner = k
    apart = np.zeros(len(read), dtype=bool)
    apart[order[inner:]] = True
    for start, end in runs_of(apart):
        if end - start > options.audit.corrupt_run:
            apart[start:end] = False
    return apart


def without_outliers(
    prepared: PreparedSession, study: Study, fit: Fit, linearised: Sequence[LinearisedRecord]
) -> PreparedSession:
    """The prepared session with single readings far off a fit, whose neighbours are not, left out and told.

    Not next to a jump of the command, nor where the reading itself has a peak: there a model errs for a sample, too.
    But there as well where the channel never reads further and the model does. Where it stands at its furthest several
    times and the model reads further, but for noise each time, it is saturated: all those are left out, in the locked
    records too.
    """
    options, records, notes = study.options, list[Record](), list[str]()
    training = [linear.predictor.record for linear in linearised]
    ends = _furthest_readings(study, training, fit)
    cleaned = _without_saturated(prepared, training, ends)
    for linear, read in zip(linearised, fit.readings, strict=True):
        record = _unsaturated(linear.predictor.record, ends)
        curvature = linear.predictor.curvatures(linear.trajectory, linear.variant)
        usable = dict(record.usable)
        still = _away_from_jumps(record, options=options)
        for name in record.outputs:
            left = np.where(linear.predictor.record.usable[name], record.values[name] - read[name], np.nan)
            cut = np.zeros(len(record.time), dtype=bool)
            for end in (one for one in ends if one.channel == name):
                cut |= end.stands_in(record) & (end.side * left < 0.0)
            noise = study.noise[name, record.pace].innovation * grown(
                study.noise_growth.get(name, 0.0), record.values[name]
            )
            least = np.hypot(noise, options.fit.peak_share * curvature[name])
            outlying = _single_outliers(left, options.noise.outlier * least, options.noise.outlier_ratio)
            outlying &= (still | cut) & usable[name]
            usable[name] = usable[name] & ~outlying
            for k in np.flatnonzero(outlying):
                line = "" if record.path is None else f", {record.place(int(k))}"
                off = float(left[k]) - float(np.median(left[[k - 2, k - 1, k + 1, k + 2]]))
                size = abs(off) / study.noise[name, record.pace].deviation
                notes.append(
                    f"{record.name}{line}: {name} of {value_text(float(record.values[name][k]), UNITS[name])} is "
                    f"{size:.0f} noise deviations off its neighbours, as the model has them; it is left out"
                )
        records.append(replace(record, usable=usable))
    return with_records(cleaned, records, notes) if notes else cleaned


def without_bursts(prepared: PreparedSession, fit: Fit, linearised: Sequence[LinearisedRecord]) -> PreparedSession:
    """The prepared session without bursts of noise in single channels: readings that go to and fro for some samples by
    many times what they do in the rest of the record, as a contactor or a welder next door makes them. They are told.

    What a reading does next to a jump of the command, or at a peak of its own, tells of none, nor does what goes to and
    fro in the fit and not in the readings, or in every repeat of a test alike.
    """
    records = [predictor.record for predictor in prepared.predictors]
    bursts = [
        _bursts_of_record(prepared, record, linear, read)
        for record, linear, read in zip(records, linearised, fit.readings, strict=True)
    ]
    cleaned, notes = list[Record](), list[str]()
    for k, record in enumerate(records):
        usable = dict(record.usable)
        for name, start, end in bursts[k]:
            if any(
                other.test == record.test and channel == name and first < end and start < last
                for j, other in enumerate(records) if j != k for channel, first, last in bursts[j]
            ):  # fmt: skip
                continue
            usable[name] = usable[name].copy()
            usable[name][start:end] = False
            line = "" if record.path is None else f", {record.place(start)}"
            notes.append(
                f"{record.name}{line}: {name} goes to and fro for {end - start} samples by far more than its noise; "
                "they are left out"
            )
        cleaned.append(replace(record, usable=usable))
    return with_records(prepared, cleaned, notes) if notes else prepared


def _bursts_of_record(
    prepared: PreparedSession, record: Record, linear: LinearisedRecord, read: dict[str, np.ndarray]
) -> list[tuple[str, int, int]]:
    """The channel, first and one past the last sample of each burst in a record that a fit reads so."""
    options, found = prepared.options, list[tuple[str, int, int]]()
    curvature = linear.predictor.curvatures(linear.trajectory, linear.variant)
    still = _away_from_jumps(record, options=options)
    for name in record.outputs:
        sensor, usable = prepared.session.sensors.get(name), record.usable[name]
        size = grown(prepared.noise_growth.get(name, 0.0), record.values[name])
        moved = np.where(usable, record.values[name] / size, np.nan)
        floor = np.hypot(sensor.resolution if sensor else 0.0, options.fit.peak_share * curvature[name] / size)
        runs = _bursts(moved - read[name] / size, moved, np.where(still, floor, np.inf), options=options)
        found += [(name, start, end) for start, end in runs]
    return found


def without_beginnings(prepared: PreparedSession, fit: Fit) -> PreparedSession:
    """The prepared session without the beginnings of records that begin in motion: a run begins at rest, so that it
    reads otherwise there and nowhere else. Where a training record does, none of those locked away is trusted to rest.
    """
    options, begun = prepared.options, list[Record]()
    for predictor, read in zip(prepared.predictors, fit.readings, strict=True):
        record = predictor.record
        lefts = [(record.values[name] - read[name])[record.usable[name]] for name in record.outputs]
        if any(_is_off_at_first(left, options=options) for left in lefts):
            begun.append(record)
    if not begun:
        return prepared
    length = f"{1e3 * options.noise.beginning:g} ms"
    notes = [f"{r.name} begins in motion, and the model at rest: its first {length} are left out" for r in begun]
    return with_records(prepared, [_without_beginning(r, options) for r in (*begun, *prepared.session.locked)], notes)


def _is_off_at_first(left: np.ndarray, *, options: IdentificationOptions) -> bool:
    """Whether the first residuals of (n,) are, to one side, far more than what most of them are."""
    first, rest = left[: options.noise.beginning_samples], left[options.noise.beginning_samples :]
    if not len(rest):
        return False
    scale = 1.4826 * float(np.median(np.abs(rest)))
    return bool(abs(np.sign(first).sum()) == len(first) and np.min(np.abs(first)) > options.noise.beginning_off * scale)


def _without_beginning(record: Record, options: IdentificationOptions) -> Record:
    """A record without the time in which a valve forgets where it began."""
    kept = record.time - record.time[0] >= options.noise.beginning
    return replace(record, usable={name: good & kept for name, good in record.usable.items()})


def _away_from_jumps(record: Record, *, options: IdentificationOptions) -> np.ndarray:
    """True for the samples (n,) of a record that are not next to a jump of its command, where a model errs."""
    still = np.ones(len(record.time), dtype=bool)
    for k in command_jumps(record.values[record.command], options=options):
        still[max(k - 1, 0) : k + 4] = False
    return still


def _bursts(
    left: np.ndarray, moved: np.ndarray, floor: np.ndarray, *, options: IdentificationOptions
) -> list[tuple[int, int]]:
    """First and one past the last sample of each burst in residuals (n,) of readings `moved` (n,), NaN where there is
    none, that may err by `floor` (n,) at each sample, and turn by as much there and next to it; none where there are
    too many.
    """
    from scipy.ndimage import maximum_filter1d

    turn, turn_read = _turns(left), _turns(moved)
    floor = maximum_filter1d(floor, 3)
    read = np.isfinite(turn)
    if not read.any():
        return []
    common = 1.4826 * float(np.median(np.abs(turn[read])))
    turn[~read] = turn_read[~read] = 0.0
    large = np.abs(turn) > options.noise.burst * np.hypot(common, floor)
    beside = options.noise.burst_beside
    bridged = np.convolve(large, np.ones(2 * beside + 1), "same") > 0.0
    found = []
    for start, end in runs_of(bridged):
        own, whole = turn[start:end], float(np.sum(turn[start:end] ** 2))
        to_and_fro = float(np.sum(own[1:] * own[:-1])) < -0.33 * whole  # noise: -2/3
        by_readings = float(own @ turn_read[start:end]) > 0.5 * whole  # by the fit: 0
        if np.count_nonzero(large[start:end]) >= options.noise.burst_samples and to_and_fro and by_readings:
            found.append((max(int(start) - beside, 0), min(int(end) + beside, len(left))))
    return found if sum(b - a for a, b in found) <= options.noise.burst_share * len(left) else []


def _turns(column: np.ndarray) -> np.ndarray:
    """Second differences (n,) about each sample of (n,), NaN at the ends."""
    turns = np.full(len(column), np.nan)
    turns[1:-1] = np.diff(column, 2)
    return turns


def without_saturation(prepared: PreparedSession, study: Study, fit: Fit) -> PreparedSession:
    """The prepared session without what is saturated by a fit that does not come near the records, if that is why: it
    carries most of what this leaves beyond noise. A fit that is far off for another reason errs itself.
    """
    records = [predictor.record for predictor in study.predictors]
    ends = []
    for end in _furthest_readings(study, records, fit):
        left = np.concatenate([
            (record.values[end.channel] - read[end.channel])[end.stands_in(record)]
            / study.noise[end.channel, record.pace].deviation
            for record, read in zip(records, fit.readings, strict=True) if end.channel in record.outputs
        ])  # fmt: skip
        if left @ left > study.options.noise.saturated_share * (fit.chi_square - fit.rows):
            ends.append(end)
    return _without_saturated(prepared, prepared.session.training, ends)


def _without_saturated(
    prepared: PreparedSession, training: Sequence[Record], ends: Sequence[_FurthestReading]
) -> PreparedSession:
    """The prepared session, whose training records these are, without the readings at those ends that are saturated,
    and notes on them.
    """
    ends = [end for end in ends if end.is_saturated]
    if not ends:
        return prepared
    notes = [
        f"{end.channel} reads {value_text(end.side * end.furthest, UNITS[end.channel])} and no further, {end.count} "
        "times where the model does: it is saturated there, and left out"
        for end in ends
    ]
    return with_records(
        prepared, [_unsaturated(record, ends) for record in (*training, *prepared.session.locked)], notes
    )


def _unsaturated(record: Record, ends: Sequence[_FurthestReading]) -> Record:
    """A record with the readings at saturated ends not usable."""
    usable = dict(record.usable)
    for end in ends:
        if end.is_saturated and end.channel in usable:
            usable[end.channel] = usable[end.channel] & ~end.stands_in(record)
    return replace(record, usable=usable)


@dataclass(frozen=True)
class _FurthestReading:
    """The furthest reading of a channel in all training records, times the `side` (1 up, -1 down), how many samples
    stand at it, and whether the model reads much further in most of these, and in none much less.
    """

    channel: str
    side: float
    furthest: float
    count: int
    is_saturated: bool

    def stands_in(self, record: Record) -> np.ndarray:
        """True for each usable sample (n,) of a record at which its channel stands at this reading or beyond."""
        return record.usable[self.channel] & (self.side * record.values[self.channel] >= self.furthest)


def _furthest_readings(study: Study, training: Sequence[Record], fit: Fit) -> list[_FurthestReading]:
    """Of each channel on either side, beside what a fit reads of the training records."""
    found, pairs = [], list(zip(training, fit.readings, strict=True))
    for name in sorted({name for record in training for name in record.outputs}):
        own = [(record, read[name], record.usable[name]) for record, read in pairs if name in record.outputs]
        for side in (-1.0, 1.0):
            furthest = max(float(np.max(side * record.values[name][good], initial=-np.inf)) for record, _, good in own)
            beyond = np.concatenate([
                (side * read - furthest)[good & (side * record.values[name] >= furthest)]
                / study.noise[name, record.pace].deviation
                for record, read, good in own
            ])  # fmt: skip
            several = len(beyond) > 1 and np.min(beyond) > -study.options.noise.saturated_noise
            saturated = bool(several and np.median(beyond) > study.options.noise.outlier)
            found.append(_FurthestReading(name, side, furthest, len(beyond), saturated))
    return found


def _single_outliers(left: np.ndarray, least: np.ndarray, ratio: float) -> np.ndarray:
    """True for residuals (n,) `least` (n,) off their four neighbours' median, and `ratio` times as far as these."""
    out = np.zeros(len(left), dtype=bool)
    around = np.stack([left[:-4], left[1:-3], left[3:-1], left[4:]])
    middle = np.median(around, axis=0)
    off, spread = np.abs(left[2:-2] - middle), np.max(np.abs(around - middle), axis=0)
    out[2:-2] = (off > least[2:-2]) & (off > ratio * spread)  # never with NaN among them
    return out
