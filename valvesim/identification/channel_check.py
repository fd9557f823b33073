"""Whether channels read as the stated valve does: a sign, a unit or a plug that is wrong is told before any fit, for
figures of the valve would go to their limits to make up for it.

Symbols
    y readings, m what the stated valve reads, each less what goes with time or the oil's temperature in a record
    b = sum(y m)/sum(m m) slope, r = sum(y m)/sqrt(sum(y y) sum(m m)) correlation
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from valvesim.identification.fit import Fit, predict_readings
from valvesim.identification.noise_estimation import evaluated_under_own_noise
from valvesim.identification.options import ChannelOptions
from valvesim.identification.session import UNITS, Record, replicates, value_text
from valvesim.identification.study import PreparedSession, Study

NOZZLES = ("nozzle_pressure_1", "nozzle_pressure_2")  # of which one rises as the other falls
WITH_COMMAND = ("spool_position", "armature_angle", "load_flow", "current", *NOZZLES)
"""Channels that go with the command, as far as it goes; an internal leakage may well be eight times what it was."""
FROM_ZERO = ("spool_position", "armature_angle", "load_flow")
"""Those that go both ways from a zero of their own."""


@dataclass(frozen=True, eq=False)
class MisreadChannels:
    """What channels read otherwise than the stated valve, in words, and its fit at nominal in a study."""

    words: tuple[str, ...]
    study: Study
    stated: Fit


def misread_channels(prepared: PreparedSession) -> MisreadChannels | None:
    """The channels whose sign, unit or plug seems wrong; None where there are none.

    Raises SolveError where the stated valve cannot be run.
    """
    prepared = prepared.without_oversampling()
    options, nominal = prepared.options.channel, np.zeros(len(prepared.nominal.parameters))
    records = [predictor.record for predictor in prepared.predictors]
    readings = predict_readings(prepared, prepared.nominal.at(nominal))
    words = _by_slopes(_slopes(records, readings, options=options), options=options)
    words += _by_readings(records, readings, options=options)
    words += _smoothed([predictor.record for predictor in prepared.predictors], options=options)
    return MisreadChannels(tuple(words), *evaluated_under_own_noise(prepared, nominal)) if words else None


def _slopes(
    records: Sequence[Record], readings: Sequence[dict[str, np.ndarray]], *, options: ChannelOptions
) -> dict[str, dict[str, tuple[float, float]]]:
    """By channel and record, (b, r) of what was read against what the stated valve reads, of channels that are
    `WITH_COMMAND`, where that is what moves the valve: a drift may well go the other way.
    """
    found = dict[str, dict[str, tuple[float, float]]]()
    for record, read in zip(records, readings, strict=True):
        oil = record.values.get("oil_temperature", np.zeros(len(record.time)))
        drifts = np.column_stack([np.ones(len(oil)), record.time, record.time**2, oil])
        for name in (each for each in record.outputs if each in WITH_COMMAND):
            good = record.usable[name] & np.isfinite(read[name])
            both = np.column_stack([record.values[name], read[name]])[good]
            y, m = (both - drifts[good] @ np.linalg.lstsq(drifts[good], both)[0]).T
            yy, ym, mm = float(y @ y), float(y @ m), float(m @ m)
            if yy > 0.0 and mm > options.by_command * len(m) * float(np.var(both[:, 1])):
                found.setdefault(name, {})[record.name] = (ym / mm, ym / np.sqrt(yy * mm))
    return found


def _by_slopes(slopes: dict[str, dict[str, tuple[float, float]]], *, options: ChannelOptions) -> list[str]:
    """What slopes and correlations of channels say is wrong, in words."""
    words, turned = list[str](), list[str]()
    for name, own in slopes.items():
        against = [record for record, (_, r) in own.items() if r < -options.correlation]
        along = {record: b for record, (b, r) in own.items() if r > options.correlation}
        if against and not along:
            turned.append(name)
        elif against:
            words.append(f"{name} goes the other way in {', '.join(against)} than in {', '.join(along)}: its sign?")
        elif len(along) == len(own):
            b = float(np.median(list(along.values())))
            if not 1.0 / options.factor < b < options.factor:
                words.append(f"{name} reads {float(f'{b:.3g}'):g} times what the stated valve does: its unit?")
    if len(turned) == len(slopes) > 1:
        swapped = "are they swapped, or is it " if set(turned) == set(NOZZLES) else ""
        return [f"{_listed(turned)} go the other way than the stated valve: {swapped}the sign of the command?"]
    if set(NOZZLES) <= set(turned):
        words.append("nozzle_pressure_1 reads what nozzle_pressure_2 should, and the other way about: swapped?")
        turned = [name for name in turned if name not in NOZZLES]
    for name in turned:
        asked = "is it that of the other nozzle?" if name in NOZZLES else "its sign?"
        asked = asked if len(slopes) > 1 else f"{asked.removesuffix('?')}, or that of the command?"
        words.append(f"{name} goes the other way than the stated valve: {asked}")
    return words


def _by_readings(
    records: Sequence[Record], readings: Sequence[dict[str, np.ndarray]], *, options: ChannelOptions
) -> list[str]:
    """What readings of channels that go both ways say by themselves beside those of the stated valve, in words: that a
    meter does not tell the direction, that its zero is far off (where all are off, it is the valve's null), or that
    each record was given a zero of its own.
    """
    undirected, off, apart, measured = list[str](), list[str](), list[str](), 0
    for name in dict.fromkeys(n for record in records for n in record.outputs if n in FROM_ZERO):
        own = [(r.values[name], read[name], r.usable[name] & np.isfinite(read[name]))
               for r, read in zip(records, readings, strict=True) if name in r.outputs]  # fmt: skip
        pairs = [np.stack([values[good], stated[good]]) for values, stated, good in own if good.any()]
        if not pairs:
            continue
        y, m = np.hstack(pairs)
        span, measured = float(np.ptp(m)), measured + 1
        goes_back = min(float(np.max(m)), -float(np.min(m))) > options.goes_back * span > 0.0
        if goes_back and -np.min(y) < options.no_way_back * np.max(y) and _agree(y, np.abs(m), options=options):
            undirected.append(f"{name} reads nothing below zero, where the stated valve does: is its direction lost?")
        zeros = np.array([np.median(one - stated) for one, stated in pairs])
        if not all(_agree(one, stated, options=options) for one, stated in pairs):
            continue
        if abs(np.sign(zeros).sum()) == len(zeros) and np.min(np.abs(zeros)) > options.zero_off * span:
            by, way = value_text(float(np.median(np.abs(zeros))), UNITS[name]), "more" if zeros[0] > 0.0 else "less"
            off.append(f"{name} reads {by} {way} than the stated valve does, in all records: its zero?")
        for what, count in (("first reading", 1), ("first ten readings", 10), ("mean", None)):
            read, stated = np.array([np.mean(pair[:, :count], axis=1) for pair in pairs]).T
            if np.max(np.abs(read)) < options.set_to_zero * span and np.ptp(stated) > options.zeros_apart * span:
                by = value_text(float(np.ptp(stated)), UNITS[name])
                apart.append(
                    f"{name} is zero by its {what} in all records, where those of the stated valve are {by} apart: "
                    "was each record given a zero of its own?"
                )
                break
    return [*undirected, *(off if len(off) < measured else []), *apart]


def _smoothed(records: Sequence[Record], *, options: ChannelOptions) -> list[str]:
    """The channels whose noise ends within the band of its samples, or vanishes at the frequencies of a moving mean, in
    words. That is told by repeats, less what goes with the readings, bent either way, and with their derivatives: no
    sensor's noise, nor an analogue filter's, falls so steeply.
    """
    ends, means = dict[str, list[float]](), dict[str, list[int]]()
    rates = dict[str, float]()
    for other, record in replicates(records):
        for name in (each for each in record.outputs if each in other.outputs):
            good = record.usable[name] & other.usable[name]
            y, apart = other.values[name], record.values[name] - other.values[name]
            speed = np.gradient(y)
            terms = [np.ones(len(y)), record.time, y, y * y, y * np.abs(y), speed, np.abs(speed), np.gradient(speed)]
            columns = np.column_stack(terms) / [max(float(np.max(np.abs(term))), 1e-300) for term in terms]
            left = np.where(good, apart - columns @ np.linalg.lstsq(columns[good], apart[good])[0], 0.0)
            if len(left) < 4 * options.spectrum:
                continue
            rates[name] = 1.0 / float(record.time[1] - record.time[0])
            frequency, power = welch(left, rates[name], nperseg=options.spectrum)
            share = frequency / frequency[-1]
            below, above = np.median(power[(share > 0.05) & (share < 0.25)]), np.median(power[share > 0.7])
            end = frequency[np.argmax((power < 0.1 * below) & (share > 0.05))]
            ends.setdefault(name, []).append(float(end) if above < options.noise_ends * below else np.inf)
            means.setdefault(name, []).append(_samples_averaged(left, options=options))
    told = [
        f"{name} has hardly any noise above {max(own):.0f} Hz: was it smoothed before it was written? Such filters may "
        "look ahead; give it as it was sampled"
        for name, own in ends.items() if max(own) < np.inf
    ]  # fmt: skip
    return told + [
        f"{name} has no noise at {rates[name] / own[0]:.0f} Hz and its multiples: is it a mean over {own[0]} samples "
        "each? Give it as it was sampled"
        for name, own in means.items() if min(own) == max(own) > 1 and max(ends[name]) == np.inf
    ]  # fmt: skip


def _samples_averaged(noise: np.ndarray, *, options: ChannelOptions) -> int:
    """Over how many samples a moving mean was taken of noise (n,), whose power vanishes at the multiples of the sample
    rate over so many; 1 where there was none.
    """
    frequency, power = welch(noise, 1.0, nperseg=min(len(noise) // 4, options.mean_spectrum))
    for count in range(options.longest_mean, 1, -1):
        depths = []
        for zero in np.arange(1, (count + 1) // 2) / count:
            at = np.abs(frequency - zero) * (len(frequency) - 1) * 2.0 < 0.75
            sides = [power[np.abs((frequency - zero) * count - side) < 0.2] for side in (-0.5, 0.5)]
            found = at.any() and all(map(len, sides))
            depths.append(np.max(power[at]) / min(map(np.median, sides)) if found else np.inf)
        if depths and max(depths) < options.mean_depth:
            return count
    return 1


def _agree(y: np.ndarray, m: np.ndarray, *, options: ChannelOptions) -> bool:
    """Whether two series (n,) go together."""
    y, m = y - np.mean(y), m - np.mean(m)
    return float(y @ m) > options.correlation * float(np.sqrt((y @ y) * (m @ m)))


def _listed(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
