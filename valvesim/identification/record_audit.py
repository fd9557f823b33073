"""The audit of the records of a session: inputs in range, repeats that repeat, sensors stuck, coarse or saturated."""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from pathlib import Path

import numpy as np

from valvesim.errors import InputError
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import (
    INPUTS,
    OUTPUTS,
    PART_TEMPERATURES,
    UNITS,
    Record,
    Sensor,
    replicates,
    value_text,
)
from valvesim.measurement.quality import grid_step, noise_of
from valvesim.units import DISPLAY, quantities
from valvesim.valve.fluid import COMPUTED_RANGE, KELVIN
from valvesim.valve.parameters import Valve

# Where the output goes when the command goes up, so that a flat top can be told from rest; leakage goes down both ways.
_SIGN = {name: 1.0 for name in OUTPUTS} | {"nozzle_pressure_2": -1.0, "internal_leakage": 0.0}


def input_scale(name: str, valve: Valve) -> float:
    """The size against which an input's motion is judged: rated command, 100 K, supply pressure."""
    if name == "current":
        return valve.rated_current
    if name == "voltage":
        return valve.rated_current * valve.coil_resistance
    return 100.0 if UNITS[name] == "degC" else valve.supply_pressure


def is_at_rest(values: np.ndarray, scale: float, *, options: IdentificationOptions) -> bool:
    """Whether an input is at rest: constant, or no more than white noise of a sensor."""
    if np.ptp(values) <= options.audit.least_motion * scale:
        return True
    white = np.var(np.diff(values)) > 1.4 * np.var(values)  # 2 where neighbours know nothing of each other
    return bool(white and np.std(values) <= options.audit.noise_motion * scale)


def check_command(
    path: Path, record: Record, valve: Valve, notes: list[str], *, options: IdentificationOptions
) -> None:
    command, rated = record.values[record.command], input_scale(record.command, valve)
    unit, factor = DISPLAY.get(UNITS[record.command], (UNITS[record.command], 1.0))
    k = int(np.argmax(np.abs(command)))
    told = f"{record.command} of {command[k] * factor:.4g} {unit}"
    limit = f"the rated {rated * factor:.4g} {unit}"
    if abs(command[k]) > options.audit.most_command * rated:
        raise _at_sample(f"{told} is beyond {options.audit.most_command:g} times {limit}", record, k, path)
    if abs(command[k]) > rated * (1 + 1e-9):
        notes.append(f"{record.name}: {told} is beyond {limit}; spool and flapper may reach their stops")


def _at_sample(problem: str, record: Record, sample: int, path: Path) -> InputError:
    """An error about one sample, with its line, or its time where the file has no lines."""
    line = record.line_of(sample)
    return InputError(problem if line is not None else f"{problem}, {record.place(sample)}", file=path, line=line)


def check_conditions(
    path: Path, record: Record, valve: Valve, notes: list[str], *, options: IdentificationOptions
) -> None:
    """Temperatures and pressures must be ones that the valve can be in."""
    bounds = {name: field.metadata["bounds"] for name, field in quantities(valve).items()}
    bounds |= dict.fromkeys(("oil_temperature", *PART_TEMPERATURES), COMPUTED_RANGE)

    def refuse(wrong: np.ndarray, name: str, why: str) -> None:
        if wrong.any():
            k = int(np.argmax(wrong))
            value = value_text(record.values[name][k], UNITS[name])
            raise _at_sample(f"{name} of {value} {why}", record, k, path)

    for name in record.inputs[1:]:
        (low, high), values = bounds[name], record.values[name]
        span = f"[{value_text(low, UNITS[name])}, {value_text(high, UNITS[name])}]"
        refuse((values < low) | (values > high), name, f"is outside {span}")
    oil = record.values.get("oil_temperature", np.zeros(1))
    if oil.min() > KELVIN + options.audit.coldest_oil:
        least = value_text(oil.min(), UNITS["oil_temperature"])
        notes.append(f"{record.name}: oil_temperature is {least} and more throughout: is it in kelvin?")
    pressure = {f"{n}_pressure": record.values.get(f"{n}_pressure", getattr(valve, f"{n}_pressure")) for n in
                ("supply", "return", "load")}  # fmt: skip
    supply = np.broadcast_to(pressure["supply_pressure"], record.time.shape)
    measured_channels = next((n for n in ("return_pressure", "supply_pressure") if n in record.values), "")
    if measured_channels:
        refuse(pressure["return_pressure"] >= supply, measured_channels, "leaves no pressure between supply and return")
    if "load_pressure" in record.values:
        load = record.values["load_pressure"]
        refuse(
            np.abs(load) > (1.0 + options.audit.overshoot) * supply, "load_pressure", "is beyond the supply pressure"
        )
        if (np.abs(load) > supply).any():
            record.values["load_pressure"] = np.clip(load, -supply, supply)
            notes.append(f"{record.name}: load_pressure is a little beyond the supply pressure and held at it")


def check_drive(records: Sequence[Record]) -> None:
    first = records[0]
    for record in records:
        if record.command != first.command:
            raise InputError(
                f"{first.name} is driven by {first.command}, {record.name} by {record.command}: a session has one drive"
            )


def with_common_lengths(records: Sequence[Record], notes: list[str], *, options: IdentificationOptions) -> list[Record]:
    """The records, of repeats that ended a few samples apart (a trigger, a clock's last step) as much as all have."""
    lengths: dict[str, list[int]] = {}
    for record in records:
        if record.repeats is not None:
            lengths.setdefault(record.repeats, []).append(len(record.time))
    found = []
    for record in records:
        shortest = min(lengths.get(record.repeats or "", [len(record.time)]))
        more = len(record.time) - shortest
        if 0 < more <= options.audit.repeat_ends * len(record.time):
            whole, name = len(record.time), record.repeats
            notes.append(f"{record.name}: cut by {more} of {whole} samples, to the shortest of the repeats {name!r}")
            values, usable = ({name: column[:shortest] for name, column in each.items()}
                              for each in (record.values, record.usable))  # fmt: skip
            record = replace(record, time=record.time[:shortest], values=values, usable=usable)
        found.append(record)
    return found


def check_replicates(records: Sequence[Record], valve: Valve, *, options: IdentificationOptions) -> None:
    """Repeats of one test must have one clock and the same inputs."""
    for other, record in replicates(records):
        pair = f"{other.name} and {record.name} are called repeats {record.repeats!r}, but their"
        if len(record.time) != len(other.time):
            raise InputError(f"{pair} lengths differ: {len(other.time)} and {len(record.time)} samples")
        if abs(record.duration - other.duration) * record.rate > 0.5:
            raise InputError(f"{pair} clocks disagree: they end at {other.duration:.6g} s and {record.duration:.6g} s")
        for name in dict.fromkeys((*other.inputs, *record.inputs)):
            if name not in other.values or name not in record.values:
                raise InputError(f"{pair} columns differ: only one has {name!r}")
            a, b = other.values[name], record.values[name]
            span = max(np.ptp(a), np.ptp(b))
            if name != record.command:  # a temperature or pressure that rests has no span of its own
                span = max(span, input_scale(name, valve))
            off = float(np.sqrt(np.mean((a - b) ** 2)))
            if off > options.audit.replicate_mismatch * max(
                span, options.audit.least_motion * input_scale(name, valve)
            ):
                raise InputError(
                    f"{pair} inputs differ: {name} by {value_text(off, UNITS[name])} rms, more than "
                    f"{options.audit.replicate_mismatch:.0%} of {value_text(span, UNITS[name])}"
                )


def note_disagreement(records: Sequence[Record], notes: list[str], *, options: IdentificationOptions) -> None:
    """Say which readings of repeats differ by more than noise: an instrument that wandered, a spool that stuck once.

    What repeats do not share counts as noise of their channel, so that it would hide whatever is smaller.
    """
    for other, record in replicates(records):
        for name in (name for name in record.outputs if name in other.outputs):
            both = record.usable[name] & other.usable[name]
            apart = record.values[name][both] - other.values[name][both]
            if len(apart) < options.audit.least_samples:
                continue
            off, scatter = float(np.sqrt(np.mean(apart**2))), noise_of(apart)
            if off > options.audit.replicate_disagreement * scatter > 0.0:
                unit = UNITS[name]
                notes.append(
                    f"{other.name} and {record.name} repeat one test, but {name} differs by {value_text(off, unit)} "
                    f"(rms), where neighbouring readings scatter by {value_text(scatter, unit)}: it counts as noise, "
                    "and hides what is smaller"
                )


def audited_resolutions(
    recordings: Sequence[dict[str, np.ndarray]], valve: Valve, notes: list[str], *, options: IdentificationOptions
) -> dict[str, float]:
    """The steps of the grids on which inputs (n,), NaN where missing, were read that are coarse enough to matter. One
    record alone may be on a grid of what was commanded; and what is read in whole tens was held there.
    """
    resolutions = {}
    for column in INPUTS:
        driven = [read for read in recordings if column in read and not (column == "current" and "voltage" in read)]
        readings = [read[column][np.isfinite(read[column])] for read in driven]
        if not sum(map(len, readings)):
            continue
        step, scale = grid_step(readings, finest=0.0), input_scale(column, valve)
        is_temperature = column.endswith("_temperature")
        coarsest = options.input_noise.coarsest_temperature if is_temperature else options.input_noise.coarsest * scale
        if options.input_noise.least * scale < step / np.sqrt(12.0) and step < coarsest:
            resolutions[column] = step
            notes.append(
                f"{column}: readings sit on a grid of "
                f"{value_text(step, 'delta_degC' if is_temperature else UNITS[column])}; what that rounds off is the "
                "instrument's and not the valve's"
            )
    return resolutions


def audited_sensors(
    stated: dict[str, Sensor], records: Sequence[Record], notes: list[str], *, options: IdentificationOptions
) -> dict[str, Sensor]:
    """One for each output channel that was measured; a resolution that is not stated is looked for in the data."""
    measured_channels = [name for name in OUTPUTS if any(name in record.outputs for record in records)]
    for name in stated:
        if name not in measured_channels:
            raise InputError(
                f"no record has this output channel; they have {', '.join(measured_channels)}", key=f"sensors.{name}"
            )
    sensors = {}
    for name in measured_channels:
        sensor = stated.get(name, Sensor(name, UNITS[name]))
        if sensor.resolution == 0.0:
            readings = [record.values[name][record.usable[name]] for record in records if name in record.outputs]
            step = grid_step(readings, options.audit.finest_grid)
            if step > 0.0:
                notes.append(
                    f"{name}: readings sit on a grid of {value_text(step, sensor.unit)}, taken as the resolution"
                )
            sensor = replace(sensor, resolution=step)
        sensors[name] = replace(sensor, range=_range_of(sensor, records, options=options))
    return sensors


def _range_of(
    sensor: Sensor, records: Sequence[Record], *, options: IdentificationOptions
) -> tuple[float, float]:
    """The range of a sensor: as stated, or narrower where its readings have a flat top; the same in all records."""
    own = [record for record in records if sensor.channel in record.outputs]
    low, high = sensor.range
    for side in (-1.0, 1.0):
        tops = [float(np.max(side * r.values[sensor.channel][r.usable[sensor.channel]])) for r in own]
        flat = [top for record, top in zip(own, tops, strict=True) if _flat_top(record, sensor, side, options=options)]
        criteria = (_common_top, _crowded_top, _noiseless_top)
        if any(saturated(own, sensor, side, max(tops), options=options) for saturated in criteria):
            flat.append(max(tops))
        if flat:
            low, high = (max(low, -min(flat)), high) if side < 0.0 else (low, min(high, *flat))
    return low, high


def usable_records(
    records: Sequence[Record], sensors: dict[str, Sensor], notes: list[str], *, options: IdentificationOptions
) -> list[Record]:
    """The records in which something moves, with the output channels that can be used."""
    noisy = {n for record in records for n in record.outputs if _has_noise(record.values[n][record.usable[n]])}
    tried = [_usable_record(record, sensors, noisy, notes, options=options) for record in records]
    return [record for record in tried if record is not None]


def _usable_record(
    record: Record, sensors: dict[str, Sensor], noisy: Set[str], notes: list[str], *, options: IdentificationOptions
) -> Record | None:
    """The record with the output channels that can be used, or None where nothing moves or none can."""
    if not record.moves():
        notes.append(f"{record.name}: never moves (no input changes) and is left out")
        return None
    usable = {}
    for name in record.outputs:
        values = record.values[name]
        if record.moves(record.command) and np.ptp(values) == 0.0:
            notes.append(f"{record.name}: {name} is stuck at {value_text(values[0], UNITS[name])} while the "
                         f"{record.command} moves, and is left out")  # fmt: skip
            continue
        saturated = _saturated(record, sensors[name])
        within = record.usable[name] & ~saturated
        frozen = _frozen(record, name, within, name in noisy, options=options)
        good = within & ~frozen
        left_out = " and is left out" if np.mean(good) < 0.5 * record.shares.get(name, 1.0) else ""
        if frozen.any():
            begin = int(np.argmax(frozen))
            notes.append(
                f"{record.name}, {record.place(begin)}: {name} stands at one reading for {np.count_nonzero(frozen)} "
                f"samples while the {record.command} moves; they are left out"
            )
        if saturated.any():
            notes.append(f"{record.name}: {name} is saturated in {np.mean(saturated):.2%} of the samples{left_out}")
        elif left_out:
            notes.append(f"{record.name}: {name} has readings in {np.mean(good):.2%} of the samples{left_out}")
        if not left_out:
            usable[name] = good
    if not usable:
        notes.append(f"{record.name}: has no output channel left and is left out")
        return None
    return replace(record, usable=usable)


def _frozen(
    record: Record, channel: str, read: np.ndarray, noisy: bool, *, options: IdentificationOptions
) -> np.ndarray:
    """Where a channel with noise, read within its range in samples (n,), stands at one reading while the command goes
    on: a cable that came off, a logger that holds its last reading. A spool that sticks keeps the noise of its sensor.
    Where the channel is not known to be `noisy`, for all records are fast, the reading must go on with a jump.
    """
    values, command, audit = record.values[channel], record.values[record.command], options.audit
    both = read[1:] & read[:-1]
    equal = (np.diff(values) == 0.0) & both
    runs = runs_of(equal)
    length = np.diff(runs, axis=1)[:, 0]
    frozen = np.zeros(len(values), dtype=bool)
    for a, b in runs[length >= _longest_by_chance(audit.frozen_rest / len(values), len(values), options=options)]:
        frozen[a : b + 1] = np.ptp(command[a : b + 1]) > audit.flat_reach * np.ptp(command)
    beside = both & ~(frozen[1:] & frozen[:-1])
    chance = float(np.mean(equal[beside])) if beside.any() else 1.0
    longest = _longest_by_chance(audit.frozen_rest * chance, len(values), options=options)
    for a, b in runs[length < longest]:
        frozen[a : b + 1] = False
    if chance > audit.frozen_chance:
        return np.zeros(len(values), dtype=bool)
    second, first = np.sort(np.append(length, [0, 0]))[-2:]
    for a, b in () if noisy else runs[frozen[runs[:, 0]]]:
        other = int(second if b - a == first else first)
        frozen[a : b + 1] = _ends_in_jump(values, a, b, options=options) or _stands_once(
            values, command, read, (a, b), other, options=options
        )
    return frozen


def _longest_by_chance(chance: float, samples: int, *, options: IdentificationOptions) -> float:
    """How often in a row neighbours are equal by chance at most, where two are with this one."""
    most = options.audit.frozen_false_alarm / samples
    return float(np.log(most) / np.log(np.clip(chance, 1.0 / samples, 0.99)))


def _ends_in_jump(values: np.ndarray, start: int, end: int, *, options: IdentificationOptions) -> bool:
    """Whether readings that stand from `start` to `end` are beside what they go on with: what sticks starts slowly."""
    if start == 0 or end + 2 >= len(values):
        return False
    before, jump, after = np.abs(np.diff(values[[start - 1, start, end, end + 1, end + 2]]))[[0, 2, 3]]
    return bool(after > 0.0 and jump > options.audit.frozen_jump * max(before, after))


def _stands_once(
    values: np.ndarray, command: np.ndarray, read: np.ndarray, run: tuple[int, int], other: int,
    *, options: IdentificationOptions,
) -> bool:  # fmt: skip
    """Whether readings stand within their range from `run` begin to end, while the command goes far, and never again
    for nearly as long (the longest `other` stay): what sticks, or is at a stop, is so in each turn.
    """
    (start, end), audit = run, options.audit
    far = np.ptp(command[start : end + 1]) > audit.held_reach * np.ptp(command)
    alone = end - start > audit.stay_ratio * other
    within = np.min(values[read]) < values[start] < np.max(values[read])
    return bool(far and alone and within and start > 0 and end + 1 < len(values))


def _has_noise(values: np.ndarray) -> bool:
    """Whether neighbouring readings scatter: second differences of noise go to and fro, those of a motion do not."""
    bend = np.diff(values, 2)
    return len(bend) > 1 and float(np.sum(bend[1:] * bend[:-1])) < -0.33 * float(np.sum(bend**2))  # noise: -2/3


def _returns(values: np.ndarray) -> bool:
    """Whether readings go up nearly as often as down: those that creep from level to level of a grid do not."""
    steps = np.diff(values)
    return bool(min(np.sum(steps > 0.0), np.sum(steps < 0.0)) > 0.25 * np.count_nonzero(steps))


def _saturated(record: Record, sensor: Sensor) -> np.ndarray:
    """Where a channel stands at an end of its sensor's range."""
    values, (low, high), half = record.values[sensor.channel], sensor.range, 0.5 * sensor.resolution
    return (values <= low + half) | (values >= high - half)


def _flat_top(record: Record, sensor: Sensor, side: float, *, options: IdentificationOptions) -> bool:
    """Whether a channel stands at its highest reading (`side` 1) or lowest (-1) while the command goes on."""
    usable, command = record.usable[sensor.channel], record.values[record.command]
    values = record.values[sensor.channel]
    span, asked = np.ptp(values[usable]), np.ptp(command)
    if asked == 0.0:
        return False
    outward = side * _SIGN[sensor.channel] * command * span / asked  # what the command asks for, as an output
    least = max(3.0 * sensor.resolution, options.audit.flat_reach * span)
    # Rest and friction are flat too, but there the command goes no further out than where the reading stopped.
    return any(
        np.max(outward[a:b]) - max(outward[a], outward[b - 1]) > least
        for a, b in _runs_at(side * values, np.max(side * values[usable]), usable)
        if b - a >= options.audit.flat_samples
    )


def _common_top(
    records: Sequence[Record], sensor: Sensor, side: float, top: float, *, options: IdentificationOptions
) -> bool:
    """Whether a channel stops at the very same reading under commands that ask for different ones, as steps do."""
    if _SIGN[sensor.channel] == 0.0:
        return False
    asked = _asked(records)
    begins, count = [], 0
    for record in records:
        values, usable = side * record.values[sensor.channel], record.usable[sensor.channel]
        for a, b in _runs_at(values, top, usable):
            if b - a >= options.audit.top_samples:
                begins.append(float(record.values[record.command][a]))
                count += b - a
    if count < options.audit.flat_samples or asked == 0.0:
        return False
    span = _span(records, sensor.channel)
    apart = float(np.ptp(begins)) * span / asked  # what the command asks for, as an output
    return apart > max(3.0 * sensor.resolution, options.audit.flat_reach * span)


def _crowded_top(
    records: Sequence[Record], sensor: Sensor, side: float, top: float, *, options: IdentificationOptions
) -> bool:
    """Whether far more readings stand at the very top for a few samples than at any value next to it.

    The crests of a sine come to two and a half times as many. Longer stays at the top are `_flat_top`'s. A few do where
    nothing stands next to them and the commands there differ, or the channel's noise had them differ: without, peaks of
    one command end alike.
    """
    span = _span(records, sensor.channel)
    if _SIGN[sensor.channel] == 0.0 or span == 0.0:
        return False
    width, count, below = max(sensor.resolution, options.audit.crowd_width * span), 0, np.empty(0)
    commands = np.empty(0)
    for record in records:
        values, usable = side * record.values[sensor.channel], record.usable[sensor.channel]
        commands = np.append(commands, record.values[record.command][usable & (values == top)])
        stays = np.diff(_runs_at(values, top, usable))
        count += int(stays[stays < options.audit.flat_samples].sum())
        below = np.append(below, np.round((top - values[usable]) / width, 6))
    beside, _ = np.histogram(below[below > 0.0], np.arange(6) + 1e-3)
    asked = _asked(records)
    few = count >= options.audit.few_tops and not beside.any()
    alone = few and (
        bool(np.ptp(commands) > options.audit.flat_reach * asked)
        or _chance_of_equal(_rests(records, sensor, side, top, options=options), options=options) ** (count - 1)
        < options.audit.alike_chance
    )
    return alone or bool(count >= options.audit.flat_samples and count > options.audit.crowd_ratio * beside.max())


def _noiseless_top(
    records: Sequence[Record], sensor: Sensor, side: float, top: float, *, options: IdentificationOptions
) -> bool:
    """Whether a channel stands at the very top for long without its noise, which it shows wherever else the command
    rests: the plateau of a step, cut off. Noise of the size of its resolution shows in that no other rest that is long
    enough has equal readings for nearly as long.
    """
    audit, channel, stays = options.audit, sensor.channel, [0]
    for record in records:
        values, usable = side * record.values[channel], record.usable[channel]
        stays += np.diff(_runs_at(values, top, usable)).ravel().tolist()
    rests, longest = _rests(records, sensor, side, top, options=options), max(stays)
    bends = np.concatenate([np.abs(np.diff(values, 2)) for values in rests] or [np.empty(0)])
    if min(longest, len(bends)) < audit.flat_samples:
        return False
    if np.median(bends) > max(3.0 * sensor.resolution, audit.finest_grid * _span(records, channel)):
        return True
    long_enough = min(longest, int(2.0 * audit.stay_ratio * audit.flat_samples))  # to show noise if there is any
    alike = [values[len(values) // 2 :] for values in rests if len(values) + 1 >= long_enough]  # it begins with a step
    equal = [int(np.max(np.diff(runs_of(np.diff(values) == 0.0)), initial=0)) + 1 for values in alike]
    noisy = sum(_has_noise(values) and _returns(values) for values in alike) >= audit.top_rests
    return noisy and sensor.resolution > 0.0 and longest > audit.stay_ratio * max(equal)


def _rests(
    records: Sequence[Record], sensor: Sensor, side: float, top: float, *, options: IdentificationOptions
) -> list[np.ndarray]:
    """What a channel reads, times the side, below its top wherever the command rests."""
    rests, channel, asked = list[np.ndarray](), sensor.channel, _asked(records)
    for record in records:
        values, usable = side * record.values[channel], record.usable[channel]
        moved = np.abs(np.diff(record.values[record.command], prepend=np.nan)) > options.audit.least_motion * asked
        rests += [values[a:b] for a, b in runs_of(usable & (values < top) & ~moved)]
    return rests


def _chance_of_equal(rests: Sequence[np.ndarray], *, options: IdentificationOptions) -> float:
    """The share of equal neighbours where a channel rests and shows its noise; 1 where it shows none."""
    settled = [values[len(values) // 2 :] for values in rests if len(values) >= 2 * options.audit.flat_samples]
    steps = [np.diff(values) for values in settled if _has_noise(values) and _returns(values)]
    return float(np.mean(np.concatenate(steps) == 0.0)) if len(steps) >= options.audit.top_rests else 1.0


def _span(records: Sequence[Record], channel: str) -> float:
    """The largest span of a channel's usable readings in a record."""
    return max(float(np.ptp(record.values[channel][record.usable[channel]])) for record in records)


def _asked(records: Sequence[Record]) -> float:
    """The largest span of a record's command."""
    return max(float(np.ptp(record.values[record.command])) for record in records)


def _runs_at(values: np.ndarray, top: float, usable: np.ndarray) -> np.ndarray:
    """[first, end) of each run of readings (n,) at `top`, (runs, 2)."""
    return runs_of(usable & (values == top))


def runs_of(marked: np.ndarray) -> np.ndarray:
    """[first, end) of each run of True in (n,), (runs, 2)."""
    return np.flatnonzero(np.diff(marked.astype(int), prepend=0, append=0)).reshape(-1, 2)
