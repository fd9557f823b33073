"""Whether the measured valve oscillates by itself, whatever its inputs do, and the stated one rests: no fit can follow
the phase of such an oscillation, but where the equations at rest lose their stability tells what may have caused it.

Symbols
    S(f) spectrum of a reading or an input in a record, T the record's duration
    s the least stable eigenvalue (1/s) of the equations at rest: at the onset its real part passes zero
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.identification.candidates import Candidate, candidates_of
from valvesim.identification.channel_check import FROM_ZERO
from valvesim.identification.fit import Fit, with_shapes
from valvesim.identification.noise_estimation import evaluated_under_own_noise
from valvesim.identification.options import SelfOscillationOptions
from valvesim.identification.self_oscillation import least_stable_mode
from valvesim.identification.session import Record
from valvesim.identification.study import PreparedSession, Study


@dataclass(frozen=True, eq=False)
class Onset:
    """A candidate with whose amplitude above neutral the stated valve begins to oscillate, and its frequency (Hz)."""

    candidate: Candidate
    above_neutral: float
    frequency: float


@dataclass(frozen=True, eq=False)
class MeasuredOscillation:
    """The frequency (Hz) at which readings oscillate in so many `records`, below half their `rate` (Hz), what would
    have the stated valve do so, nearest frequency first, and that valve's fit at nominal in a study.
    """

    frequency: float
    rate: float
    records: int
    onsets: tuple[Onset, ...]
    study: Study
    stated: Fit


@dataclass(frozen=True)
class _Line:
    """A line of a channel in a record: its frequency (Hz), its root mean square and its share of the mean square."""

    record: Record
    channel: str
    frequency: float
    rms: float
    share: float


def measured_oscillation(
    prepared: PreparedSession, progress: Callable[[str, float], None] = lambda stage, share: None
) -> MeasuredOscillation | None:
    """How the measured valve oscillates by itself; None where it does not, where an input goes at the same frequency,
    where the stated valve does so too, or where no channel tells its motion: pressures go with a supply that ripples.

    `progress(stage, share)` is called while causes are looked for. Raises SolveError where the stated valve cannot be
    run.
    """
    options = prepared.options.self_oscillation
    records = [predictor.record for predictor in prepared.predictors]
    is_driven = partial(_is_driven, most=_largest_inputs(records), options=options)
    channels = [(record, name) for record in records for name in record.outputs if name in FROM_ZERO]
    strongest = [_strongest_line(record, name, options=options) for record, name in channels]
    lines = [
        line
        for line in strongest
        if line.frequency > 0.0
        and line.share > options.line_share
        and not is_driven(line.record, line.frequency)
    ]
    if not lines:
        return None
    frequency = float(np.median([line.frequency for line in lines]))
    lines = [line for line in lines if abs(line.frequency / frequency - 1.0) < options.line_width]
    could_tell = sum(not is_driven(record, frequency) for record, _ in channels)
    if len(lines) < options.least_lines * could_tell:
        return None
    study, stated = evaluated_under_own_noise(prepared, np.zeros(len(prepared.nominal.parameters)))
    reads = {record.name: read for record, read in zip(records, stated.readings, strict=True)}
    if np.mean([_is_its_own(line, reads, options=options) for line in lines]) < options.least_lines:
        return None
    if least_stable_mode(prepared.predictors, stated.variant(prepared.nominal))[0] > 0.0:  # it may be no other valve
        return None
    rate, count = min(line.record.pace for line in lines), len({line.record.name for line in lines})
    return MeasuredOscillation(frequency, rate, count, _onsets(prepared, frequency, rate, progress), study, stated)


def _is_its_own(line: _Line, reads: dict[str, dict[str, np.ndarray]], *, options: SelfOscillationOptions) -> bool:
    """Whether a line is large beside how far the stated valve moves in all records, by its readings (n,) by record and
    channel, and beside what it does there.
    """
    motion = float(np.std(np.concatenate([read[line.channel] for read in reads.values() if line.channel in read])))
    there = _line_at(line.frequency, line.record, line.channel, reads[line.record.name][line.channel], options=options)
    return line.rms > options.least_size * motion and options.least_size * line.rms > there.rms


def _strongest_line(record: Record, channel: str, *, options: SelfOscillationOptions) -> _Line:
    good = record.usable[channel]
    values = np.interp(record.time, record.time[good], record.values[channel][good])
    frequency, power = _spectrum(record, values)
    fast = frequency * record.duration > options.least_periods
    return _line_at(float(frequency[np.argmax(np.where(fast, power, 0.0))]), record, channel, values, options=options)


def _line_at(
    frequency: float, record: Record, channel: str, values: np.ndarray, *, options: SelfOscillationOptions
) -> _Line:
    """The line at a frequency (Hz) of what a channel reads, or would read, in a record (n,)."""
    own, power = _spectrum(record, values)
    near = np.abs(own - frequency) < max(options.line_width * frequency, 3.0 / record.duration)
    size = float(power[near].sum())
    return _Line(record, channel, frequency, float(np.sqrt(size)), size / max(float(power.sum()), 1e-300))


def _largest_inputs(records: Sequence[Record]) -> dict[str, float]:
    """The largest absolute value of each input in any record."""
    names = {name for record in records for name in record.inputs}
    return {name: max(float(np.max(np.abs(r.values[name]))) for r in records if name in r.inputs) for name in names}


def _is_driven(
    record: Record, frequency: float, *, most: dict[str, float], options: SelfOscillationOptions
) -> bool:
    """Whether an input of a record goes at a frequency (Hz), by a good part of the `most` that it is in any record."""
    there = [_line_at(frequency, record, name, record.values[name], options=options) for name in record.inputs]
    return any(line.rms > options.input_share * most[line.channel] for line in there)


def _spectrum(record: Record, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and mean squares (m,) of what values (n,) in a record do about a straight line; by Hann's
    window, that a step does not look like a line.
    """
    window = np.hanning(len(values))
    spectrum = np.fft.rfft(window * (values - np.polyval(np.polyfit(record.time, values, 1), record.time)))
    power = 2.0 * np.abs(spectrum) ** 2 / (len(values) * float(window @ window))
    return np.fft.rfftfreq(len(values), 1.0 / record.pace), power


def _onsets(
    prepared: PreparedSession, frequency: float, rate: float, progress: Callable[[str, float], None]
) -> tuple[Onset, ...]:
    """What would have the stated valve begin to oscillate within half an octave of a frequency (Hz) as records at a
    rate (Hz) show it, one of each label, nearest first.
    """
    found = dict[str, Onset]()
    candidates = candidates_of(prepared.session, prepared.nominal)
    in_valve = [c for c in candidates if c.effect is None or c.effect.reading is None]
    for k, candidate in enumerate(in_valve):
        progress("what may have the valve oscillate", k / len(in_valve))
        for sign in (1.0,) if candidate.one_sided else (1.0, -1.0):
            onset = _onset(prepared, candidate, sign)
            if onset is not None and _octaves(onset.frequency, frequency, rate) < 0.5:
                found.setdefault(candidate.label, onset)
    return tuple(sorted(found.values(), key=lambda one: _octaves(one.frequency, frequency, rate)))


def _octaves(onset: float, frequency: float, rate: float) -> float:
    """How far a frequency (Hz) is from where samples at a rate (Hz) show another one."""
    seen = abs(onset - rate * np.round(onset / rate))
    return float(abs(np.log2(max(seen, 1e-9) / frequency)))


def _onset(prepared: PreparedSession, candidate: Candidate, sign: float) -> Onset | None:
    """Where the stated valve begins to oscillate with more and more of a candidate; None where it does not."""
    options = prepared.options.self_oscillation
    limit = candidate.limits[1 if sign > 0.0 else 0]
    stable = 0.0
    for multiple in options.amounts:
        amount = sign * min(multiple * candidate.typical, abs(limit))
        growth, frequency = _mode_with(prepared, candidate, amount)
        if growth > 0.0:
            break
        stable = amount
    else:
        return None
    for _ in range(options.bisections):
        middle = 0.5 * (stable + amount)
        growth, own = _mode_with(prepared, candidate, middle)
        stable, amount, frequency = (middle, amount, frequency) if growth <= 0.0 else (stable, middle, own)
    return Onset(candidate, amount, frequency) if frequency > 0.0 else None


def _mode_with(prepared: PreparedSession, candidate: Candidate, above_neutral: float) -> tuple[float, float]:
    """Growth rate (1/s) and frequency (Hz) of the least stable mode of the stated valve with so much of a candidate;
    (-inf, 0) where it has no state at rest.
    """
    stated = prepared.nominal.at(np.zeros(len(prepared.nominal.parameters)))
    try:
        with warnings.catch_warnings():  # far from any valve that was stated
            warnings.simplefilter("ignore", ValidityWarning)
            variant = with_shapes(candidate, above_neutral).apply_to(stated)
            return least_stable_mode(prepared.predictors[:1], variant)
    except (SolveError, InputError):
        return -np.inf, 0.0
