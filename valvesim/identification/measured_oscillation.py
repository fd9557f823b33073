"""Whether the measured valve oscillates by itself, whatever its inputs do, and the stated one rests: no fit can follow
the phase of such an oscillation, but where the equations at rest lose their stability tells what may have caused it.

Symbols
    c the stated valve's coefficients at 20 degC
    s the least stable eigenvalue (1/s) of the equations at rest: at the onset its real part passes zero
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from valvesim.errors import InputError, SolveError, ValidityWarning
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, with_shapes
from valvesim.identification.noise_estimation import evaluated_under_own_noise
from valvesim.identification.options import SelfOscillationOptions
from valvesim.identification.predictor import ModelVariant, RecordPredictor, is_quasi_static
from valvesim.identification.self_oscillation import least_stable_mode
from valvesim.identification.session import Record
from valvesim.identification.study import PreparedSession, Study
from valvesim.valve.equations import AT_20, main_stage
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, eq=False)
class Onset:
    """A candidate with whose amplitude above neutral the stated valve begins to oscillate in one of the records that
    show an oscillation, and its frequency there (Hz).
    """

    candidate: Candidate
    above_neutral: float
    frequency: float


@dataclass(frozen=True, eq=False)
class MeasuredOscillation:
    """The frequency (Hz) at which readings oscillate in so many `records`, as samples at a `rate` (Hz) show it, what
    would have the stated valve do so, nearest frequency first, and that valve's fit at nominal in a study.
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
    """How the measured valve oscillates by itself; None where it does not, where the command or the supply go at the
    same frequency, where the stated valve does so too, or where no channel tells its motion: pressures go with a supply
    that ripples. Of records of several rates those of the highest are asked.

    `progress(stage, share)` is called while causes are looked for. Raises SolveError where the stated valve cannot be
    run.
    """
    options, full = prepared.options.self_oscillation, _full_travel(prepared.nominal.variant.valve)
    moving = [one for one in prepared.predictors if not is_quasi_static(one.record, options=prepared.options)]
    rate = max((one.record.pace for one in moving), default=0.0)
    records = [one.record for one in moving if one.record.pace == rate]
    is_driven = partial(_is_driven, most=_largest_inputs(records), options=options)
    channels = [(record, name) for record in records for name in record.outputs if name in full]
    strongest = [_strongest_line(record, name, options=options) for record, name in channels]
    lines = [
        line
        for line in strongest
        if line.share > options.line_share
        and line.rms > options.least_travel * full[line.channel]
        and not is_driven(line.record, line.frequency)
    ]
    if not lines:
        return None
    frequency = sorted(line.frequency for line in lines)[len(lines) // 2]
    lines = [line for line in lines if abs(line.frequency / frequency - 1.0) < options.line_width]
    could_tell = sum(not is_driven(record, frequency) for record, _ in channels)
    if len(lines) < options.least_lines * could_tell:
        return None
    study, stated = evaluated_under_own_noise(prepared, np.zeros(len(prepared.nominal.parameters)))
    reads = {one.record.name: read for one, read in zip(prepared.predictors, stated.readings, strict=True)}
    if np.mean([_is_its_own(line, reads, options=options) for line in lines]) < options.least_lines:
        return None
    if least_stable_mode(prepared.predictors, stated.variant(prepared.nominal))[0] > 0.0:  # it may be no other valve
        return None
    names = {line.record.name for line in lines}
    oscillating = [one for one in moving if one.record.name in names]
    onsets = _onsets(prepared, oscillating, lambda onset: _octaves(onset, frequency, rate), progress)
    return MeasuredOscillation(frequency, rate, len(names), onsets, study, stated)


def _full_travel(valve: Valve) -> dict[str, float]:
    """How far the channels that tell a valve's motion go at most, by name."""
    c = valve.at(AT_20)
    flow = main_stage(c.spool_stroke, valve.supply_pressure, 0.0, c)[0]
    return {
        "spool_position": float(c.spool_stroke),
        "armature_angle": float(valve.null_gap / valve.nozzle_arm),
        "load_flow": float(flow),
    }


def _is_its_own(line: _Line, reads: dict[str, dict[str, np.ndarray]], *, options: SelfOscillationOptions) -> bool:
    """Whether a line is large beside how far the stated valve moves in all records, by its readings (n,) by record and
    channel, and beside what it does there.
    """
    motion = float(np.std(np.concatenate([read[line.channel] for read in reads.values() if line.channel in read])))
    own = reads[line.record.name][line.channel]
    there = _line_at(line.frequency, line.record, line.channel, _spectrum(line.record, own), options=options)
    return line.rms > options.least_size * motion and options.least_size * line.rms > there.rms


def _strongest_line(record: Record, channel: str, *, options: SelfOscillationOptions) -> _Line:
    """The strongest peak of a channel's spectrum in a record with periods enough; one of no size where none has."""
    good = record.usable[channel]
    values = np.interp(record.time, record.time[good], record.values[channel][good])
    spectrum = frequency, power = _spectrum(record, values)
    padded = np.pad(power, 1)
    peaks = (power >= padded[:-2]) & (power >= padded[2:]) & (frequency * record.duration > options.least_periods)
    if not peaks.any():
        return _Line(record, channel, 0.0, 0.0, 0.0)
    peak = float(frequency[np.argmax(np.where(peaks, power, 0.0))])
    return _line_at(peak, record, channel, spectrum, options=options)


def _line_at(
    frequency: float,
    record: Record,
    channel: str,
    spectrum: tuple[np.ndarray, np.ndarray],
    *,
    options: SelfOscillationOptions,
) -> _Line:
    """The line at a frequency (Hz) in the `_spectrum` of what a channel reads, or would read, in a record."""
    own, power = spectrum
    near = np.abs(own - frequency) < max(options.line_width * frequency, 3.0 / record.duration)
    size = float(power[near].sum())
    return _Line(record, channel, frequency, float(np.sqrt(size)), size / max(float(power.sum()), 1e-300))


def _largest_inputs(records: Sequence[Record]) -> dict[str, float]:
    """The largest excursion of the commands from the middle of a record, and the largest supply pressure, by name. What
    a load does, it may do for the valve oscillates.
    """
    most = dict[str, float]()
    for record in records:
        command = float(np.ptp(record.values[record.command])) / 2.0
        most[record.command] = max(most.get(record.command, 0.0), command)
        if "supply_pressure" in record.inputs:
            supply = float(np.max(np.abs(record.values["supply_pressure"])))
            most["supply_pressure"] = max(most.get("supply_pressure", 0.0), supply)
    return most


def _is_driven(
    record: Record, frequency: float, *, most: dict[str, float], options: SelfOscillationOptions
) -> bool:
    """Whether an input of a record goes at a frequency (Hz), by a good part of the `most` that it does in any."""
    there = [_line_at(frequency, record, name, _spectrum(record, record.values[name]), options=options)
             for name in record.inputs if name in most]  # fmt: skip
    return any(line.rms > options.input_share * most[line.channel] > 0.0 for line in there)


def _spectrum(record: Record, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and mean squares (m,) of what values (n,) in a record do about a straight line; by Hann's
    window, that a step does not look like a line.
    """
    window = np.hanning(len(values))
    spectrum = np.fft.rfft(window * (values - np.polyval(np.polyfit(record.time, values, 1), record.time)))
    power = 2.0 * np.abs(spectrum) ** 2 / (len(values) * float(window @ window))
    return np.fft.rfftfreq(len(values), 1.0 / record.pace), power


def _onsets(
    prepared: PreparedSession,
    oscillating: Sequence[RecordPredictor],
    octaves_off: Callable[[float], float],
    progress: Callable[[str, float], None],
) -> tuple[Onset, ...]:
    """What would have the stated valve begin to oscillate in the records that do, less than half an octave off what
    these show, one of each label, nearest first.
    """
    found = list[Onset]()
    in_valve = [c for c in prepared.candidates if _acts_in_valve(c)]
    for k, candidate in enumerate(in_valve):
        progress("what may have the valve oscillate", k / len(in_valve))
        for sign in (1.0,) if candidate.one_sided else (1.0, -1.0):
            onset = _onset(prepared, oscillating, candidate, sign)
            found += [onset] if onset is not None and octaves_off(onset.frequency) < 0.5 else []
    nearest = dict[str, Onset]()
    for onset in sorted(found, key=lambda one: octaves_off(one.frequency)):
        nearest.setdefault(onset.candidate.label, onset)
    return tuple(nearest.values())


def _acts_in_valve(candidate: Candidate) -> bool:
    if candidate.effect is not None:
        return candidate.effect.reading is None
    return candidate.parameter is not None and candidate.parameter.is_of_valve


def _octaves(onset: float, frequency: float, rate: float) -> float:
    """How far a frequency (Hz) is from where samples at a rate (Hz) show another one."""
    seen = abs(onset - rate * np.round(onset / rate))
    return float(abs(np.log2(max(seen, 1e-9) / frequency)))


def _onset(
    prepared: PreparedSession, oscillating: Sequence[RecordPredictor], candidate: Candidate, sign: float
) -> Onset | None:
    """Where the stated valve begins to oscillate with more and more of a candidate; None where it does not."""
    options = prepared.options.self_oscillation
    stated = prepared.nominal.at(np.zeros(len(prepared.nominal.parameters)))
    mode_with = partial(_mode_with, stated, oscillating, candidate)
    most = prepared.options.fit.interior * abs(candidate.limits[1 if sign > 0.0 else 0])
    amounts = np.unique([min(multiple * candidate.typical, most) for multiple in options.amounts])
    stable = 0.0
    for amount in sign * amounts[np.isfinite(amounts) & (amounts > 0.0)]:
        growth, frequency = mode_with(amount)
        if growth > 0.0:
            break
        stable = amount
    else:
        return None
    for _ in range(options.bisections):
        middle = 0.5 * (stable + amount)
        growth, own = mode_with(middle)
        stable, amount, frequency = (middle, amount, frequency) if growth <= 0.0 else (stable, middle, own)
    return Onset(candidate, float(amount), frequency) if frequency > 0.0 else None


def _mode_with(
    stated: ModelVariant, oscillating: Sequence[RecordPredictor], candidate: Candidate, above_neutral: float
) -> tuple[float, float]:
    """Growth rate (1/s) and frequency (Hz) of the least stable mode of the stated valve with so much of a candidate;
    (-inf, 0) where it has no state at rest.
    """
    try:
        with warnings.catch_warnings():  # far from any valve that was stated
            warnings.simplefilter("ignore", ValidityWarning)
            variant = with_shapes(candidate, above_neutral).apply_to(stated)
            return least_stable_mode(oscillating, variant)
    except (SolveError, InputError):
        return -np.inf, 0.0
