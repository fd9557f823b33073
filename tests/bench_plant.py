"""What an ordinary bench does to the sessions of `hidden_plant`: imperfections, each at a size that benches have.

    case, bench = draw_bench(7, "effect", name="spool_coulomb_friction", imperfections=("edges",))
    write_bench_session(case, bench, folder)

The plant runs under the command as it is between the samples; the file holds what a logger writes at 1 kHz.

Imperfections
    edges       ideal steps at any time between two samples; every command goes on smoothly between its samples
    hold        the generator's staircase: each sample of the command is held until the next
    ripple      the supply pressure ripples by 1 to 4 bar at 25 to 200 Hz, and no column tells
    warming     the oil warms by 2 to 8 K within a record and the parts follow by another network than the nominal one
    gap         one channel of one record has no readings for 30 to 150 ms
    corrupt     one reading of one channel is 32767
    skew        each channel has a clock of its own: up to 0.1 ms off, and up to 100 ppm fast or slow
    drift       one meter drifts by 0.5 to 2 % of its channel's size within each record
    saturation  one channel cannot show the outer 10 to 20 % of what it should
    meters      zero and gain of each meter are others in each record, by 0.1 % (standard deviation) of its channel's
                size, and it is off a straight line by up to 0.2 % of what it ranges over
    held        one channel of one record stands at one reading for 10 to 30 samples
    burst       one channel of one record has twenty times its noise for 10 to 30 samples
    begun       the logger starts when the test has begun: the first tenth of each record is missing
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import hidden_plant
import numpy as np
from hidden_plant import AMPLITUDE, UNITS, Case, Run

from valvesim.valve.thermal_network import ThermalNetwork

IMPERFECTIONS = ("edges", "hold", "ripple", "warming", "gap", "corrupt", "skew", "drift", "saturation")
READINGS = ("meters", "held", "burst", "begun")  # what else happens to what is read
CALIBRATION = "calibration"  # oil and supply are off in each record, and every meter drifts: all of it little
FINE = 20  # samples of the command that the plant runs under to one that is logged


@dataclass(frozen=True)
class Bench:
    """The imperfections of a bench, and the dice of their sizes."""

    seed: int
    imperfections: tuple[str, ...]

    def dice(self, name: str, record: str = "") -> np.random.Generator:
        """Of one imperfection, in one record or in all."""
        return np.random.default_rng([self.seed, *name.encode(), *record.encode()])

    def has(self, name: str) -> bool:
        """Whether the bench has this imperfection."""
        return name in self.imperfections


def draw_bench(
    seed: int,
    kind: str,
    *,
    name: str | None = None,
    imperfections: Sequence[str] = (),
    duration: float = 1.0,
    network_scatter: float = 0.0,
) -> tuple[Case, Bench]:
    """A case of `hidden_plant.draw` on a bench; commands and oil as the bench makes them, records of `duration` s.

    `network_scatter` is the spread (logarithm) of each figure of the valve's thermal network.
    """
    if unknown := set(imperfections) - {*IMPERFECTIONS, *READINGS, CALIBRATION}:
        raise ValueError(f"{sorted(unknown)} are none of {(*IMPERFECTIONS, *READINGS, CALIBRATION)}")
    bench, case = Bench(seed, tuple(imperfections)), hidden_plant.draw(seed, kind, name=name)
    runs = tuple(_run(bench, run, duration, case.drive == "voltage") for run in case.runs)
    scatter = max(network_scatter, 0.3 if bench.has("warming") else 0.0)
    if scatter > 0.0:
        case = replace(case, isothermal=False, network=_network(bench, scatter))
    return replace(case, runs=runs), bench


def _network(bench: Bench, scatter: float) -> ThermalNetwork:
    """A network whose figures are those of the nominal one times what is drawn, within a factor of two."""
    dice, nominal = bench.dice("network"), ThermalNetwork()
    factor = {each.name: np.exp(np.clip(dice.normal(0.0, scatter), -0.7, 0.7)) for each in fields(nominal)}
    return ThermalNetwork(**{name: getattr(nominal, name) * by for name, by in factor.items()})


def _run(bench: Bench, run: Run, duration: float, voltage: bool) -> Run:
    """A run as the bench makes it, its command and oil on the fine grid; repeats of one test are alike."""
    label = run.repeats or run.name
    dice, t = bench.dice("command", label), np.arange(int(duration * run.rate) * FINE + 1) / (run.rate * FINE)
    if run.shape == "steps":
        edges = np.cumsum(dice.uniform(0.05, 0.12, 60))
        current = dice.uniform(-5.5e-3, 5.5e-3, 61)[np.searchsorted(edges, t, side="right")]
    else:
        slow = run.rate < 1000.0  # six samples to a turn and more, as who plans a test would have
        current = hidden_plant._current(dice, run.shape, t, 3.0 if slow else 1.0)
    if run.shape == "steps" and not (bench.has("edges") or bench.has("hold")):
        current = hidden_plant._first_order(current, t[1], 2e-3)
    current = current * (hidden_plant.DRIVE_RESISTANCE if voltage else 1.0)
    logged = np.round(current[::FINE] / 1e-9) * 1e-9
    if bench.has("hold"):
        current = np.repeat(logged, FINE)[: len(t)]
    elif not bench.has("edges"):
        current = np.interp(t, t[::FINE], logged)
    oil, rise = np.full(len(t), run.oil[0]), dice.uniform(2.0, 8.0)
    if bench.has("warming"):
        oil = oil + rise * (1.0 - np.exp(-t / (0.5 * duration)))
    ripple = (0.0, 0.0, 0.0)
    if bench.has("ripple"):  # of one pump: alike in all records but for its phase
        pump = bench.dice("ripple")
        ripple = (pump.uniform(1e5, 4e5), pump.uniform(25.0, 200.0), dice.uniform(0.0, 2.0 * np.pi))
    return replace(run, rate=run.rate * FINE, command=current, oil=oil, ripple=ripple)


def bench_records(case: Case, bench: Bench, strength: float = 1.0) -> list[dict[str, np.ndarray]]:
    """Per record what the logger writes, SI: columns (n,) at 1 kHz; NaN where a channel has no reading."""
    dice = np.random.default_rng([case.seed, hidden_plant.KINDS.index(case.kind), 2])
    hidden, done, records = hidden_plant._scaled(case, strength), dict[str, Any](), []
    for run in case.runs:
        key = run.repeats or run.name
        if key not in done:
            ends = [1] * (len(run.command) - 1) + [FINE]  # the run goes on for a sample
            longer = {name: np.repeat(getattr(run, name), ends) for name in ("command", "oil")}
            supply = run.supply
            if bench.has(CALIBRATION):
                off = bench.dice(CALIBRATION, key)
                longer["oil"] = longer["oil"] + off.normal(0.0, 0.4)
                supply = supply * (1.0 + off.normal(0.0, 0.004))
            done[key] = hidden_plant._simulate(case, replace(run, supply=supply, **longer), hidden)
        t, out = done[key]
        logged = replace(run, rate=run.rate / FINE, command=run.command[::FINE], oil=run.oil[::FINE])
        oil = logged.oil
        if bench.has("warming"):
            oil = np.round((oil + bench.dice("thermometer").normal(0.0, 0.3) + dice.normal(0.0, 0.05, len(oil))), 2)
        record = {"time": logged.time, case.drive: logged.command, "oil_temperature": oil}
        record |= {"supply_pressure": np.full(len(oil), run.supply), "load_pressure": np.full(len(oil), run.load)}
        for meter in case.meters:
            values = out[:, hidden_plant.RECORDED.index(meter.channel)]
            seen = logged
            if bench.has("skew"):
                clock = bench.dice("skew", meter.channel)
                late, rate = clock.uniform(-1e-4, 1e-4), 1.0 + clock.uniform(-1e-4, 1e-4)
                values = np.interp(t * rate + late, t, values)
            read = hidden_plant._read(case, seen, meter, t, values, hidden)
            record[meter.channel] = read + meter.noise * _coloured(dice, len(read), meter.colour)
        records.append(record)
    _worn(case, bench, records)
    for record in records:
        for meter in case.meters:
            if meter.resolution > 0.0:
                record[meter.channel] = np.round(record[meter.channel] / meter.resolution) * meter.resolution
    _broken(case, bench, records)
    if bench.has("begun"):
        records = [{name: values[len(values) // 10 :] for name, values in record.items()} for record in records]
    return records


def _coloured(dice: np.random.Generator, count: int, colour: float) -> np.ndarray:
    from scipy.signal import lfilter

    white = dice.normal(0.0, 1.0, count)
    white[1:] *= np.sqrt(1.0 - colour * colour)
    return lfilter([1.0], [1.0, -colour], white)


def _worn(case: Case, bench: Bench, records: list[dict[str, np.ndarray]]) -> None:
    """Drift and saturation, in place."""
    channels = [channel for channel in case.channels if channel != "internal_leakage"] or list(case.channels)
    if bench.has(CALIBRATION):
        for channel in channels:
            by = bench.dice(CALIBRATION, channel).uniform(-0.004, 0.004)
            for record in records:
                share = record["time"] / record["time"][-1]
                record[channel] = record[channel] + by * AMPLITUDE[channel] * share
    if bench.has("meters"):
        for channel in case.channels:
            dice, size = bench.dice("meters", channel), AMPLITUDE[channel]
            high = max(float(np.max(record[channel])) for record in records)
            low = min(float(np.min(record[channel])) for record in records)
            middle, bend, ends = 0.5 * (high + low), dice.uniform(-2e-3, 2e-3), np.array([low, high])
            for record in records:
                x, gain, zero = (record[channel] - middle) / np.ptp(ends) * 2.0, *dice.normal(0.0, 1e-3, 2)
                off = size * zero + np.ptp(ends) * bend * 4.0 * x * (np.abs(x) - 0.75)
                record[channel] = middle + (record[channel] - middle) * (1.0 + gain) + off
    if bench.has("drift"):
        dice = bench.dice("drift")
        channel, by = str(dice.choice(channels)), dice.uniform(0.005, 0.02) * dice.choice((-1.0, 1.0))
        for record in records:
            share = record["time"] / record["time"][-1]
            record[channel] = record[channel] + by * AMPLITUDE[channel] * share
    if bench.has("saturation"):
        dice = bench.dice("saturation")
        channel, share = str(dice.choice(channels)), dice.uniform(0.1, 0.2)
        top = max(float(np.max(record[channel])) for record in records)
        low = min(float(np.min(record[channel])) for record in records)
        for record in records:
            record[channel] = np.minimum(record[channel], top - share * (top - low))


def _broken(case: Case, bench: Bench, records: list[dict[str, np.ndarray]]) -> None:
    """A gap, a held and a corrupt reading, and a burst of noise, in place."""
    training = [k for k, run in enumerate(case.runs) if run.role == "train"]
    if bench.has("gap"):
        dice = bench.dice("gap")
        record, channel = records[int(dice.choice(training))], str(dice.choice(case.channels))
        start, count = int(dice.uniform(0.2, 0.7) * len(record["time"])), int(dice.uniform(30, 150))
        record[channel][start : start + count] = np.nan
    if bench.has("held"):
        record, channel, samples = _stretch(case, bench, records, "held")
        record[channel][samples] = record[channel][samples.start]
    if bench.has("burst"):
        record, channel, samples = _stretch(case, bench, records, "burst")
        (meter,) = (one for one in case.meters if one.channel == channel)
        count = samples.stop - samples.start
        record[channel][samples] += 20.0 * meter.noise * bench.dice("burst", "noise").normal(0.0, 1.0, count)
    if bench.has("corrupt"):
        dice = bench.dice("corrupt")
        record, channel = records[int(dice.choice(training))], str(dice.choice(case.channels))
        record[channel][int(dice.uniform(0.1, 0.9) * len(record["time"]))] = 32767.0 / UNITS[channel][1]


def _stretch(case: Case, bench: Bench, records: list[dict[str, np.ndarray]], name: str) -> tuple[Any, str, slice]:
    """The record, the channel and the samples of an imperfection that takes some."""
    dice = bench.dice(name)
    training = [k for k, run in enumerate(case.runs) if run.role == "train"]
    record, channel = records[int(dice.choice(training))], str(dice.choice(case.channels))
    start, count = int(dice.uniform(0.2, 0.8) * len(record["time"])), int(dice.uniform(10, 30))
    return record, channel, slice(start, start + count)


def write_bench_session(case: Case, bench: Bench, folder: str | Path, strength: float = 1.0) -> None:
    """Write session.toml and the records as `hidden_plant.write_session` does; an empty cell where there is no reading.

    `isothermal` is told as the case has it, the network never.
    """
    hidden_plant.write_files(case, bench_records(case, bench, strength), folder)


def keep_every_second_sample(folder: str | Path) -> None:
    """The records of a session as a logger of half the rate has them."""
    for file in Path(folder).glob("*.csv"):
        heading, *rows = file.read_text().splitlines()
        file.write_text("\n".join((heading, *rows[::2], "")))


COMMANDS = ("current", "voltage")


def add_command_noise(folder: str | Path, share: float, seed: int) -> None:
    """The commands of a session as an instrument with white noise measures them, of a share of the largest command."""
    dice = np.random.default_rng(seed)
    _measure_anew(folder, COMMANDS, lambda read, largest: read + dice.normal(0.0, share * largest, len(read)))


def round_commands(folder: str | Path, share: float) -> None:
    """The commands of a session as a logger with a grid of a share of the largest command writes them."""
    _measure_anew(folder, COMMANDS, lambda read, largest: np.round(read / share / largest) * share * largest)


def round_temperatures(folder: str | Path, step: float) -> None:
    """The oil temperatures of a session as a logger with a grid of that many kelvin writes them."""
    _measure_anew(folder, ("oil_temperature",), lambda read, largest: np.round(read / step) * step)


def _measure_anew(
    folder: str | Path, columns: tuple[str, ...], measured: Callable[[np.ndarray, float], np.ndarray]
) -> None:
    """The first of these columns in all records of a session, by what was `measured` of it and its largest reading."""
    files = sorted(Path(folder).glob("*.csv"))
    tables = [[line.split(",") for line in file.read_text().splitlines()] for file in files]
    column = next(k for k, name in enumerate(tables[0][0]) if name.startswith(columns))
    largest = max(abs(float(row[column])) for _, *rows in tables for row in rows)
    for file, (heading, *rows) in zip(files, tables, strict=True):
        for row, read in zip(rows, measured(np.array([float(row[column]) for row in rows]), largest), strict=True):
            row[column] = f"{read:.7g}"
        file.write_text("\n".join(map(",".join, [heading, *rows])) + "\n")
