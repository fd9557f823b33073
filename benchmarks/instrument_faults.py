"""Sessions of the tests' plant as ordinary instruments and loggers spoil them, one fault at a time.

    .venv/bin/python benchmarks/instrument_faults.py 1300000 2                    # each fault on two healthy valves
    .venv/bin/python benchmarks/instrument_faults.py 1300000 1 --kinds shunt play # these alone
    .venv/bin/python benchmarks/instrument_faults.py 1310000 1 --effect           # beside an effect of its drawn size

A line for each session: the fault, what is hidden in the valve, the answer, the seconds of the processor, and `WRONG`
where one thing is named that is neither hidden nor an error of the instruments. No name of a fault is told to the
diagnosis, and most of them are in no catalogue: what counts is that a healthy valve is not blamed for them.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: a worker is one core
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(ROOT / "tests"))

import numpy as np  # noqa: E402
from hidden_plant import Case, draw, noisy, responses, write_files  # noqa: E402
from scipy import signal  # noqa: E402

import valvesim as vs  # noqa: E402

Record = dict[str, np.ndarray]
NOISE = 0.003  # of each channel's size


@dataclass(frozen=True)
class Fault:
    """What an instrument does to the noise-free records of a case, `meter`, and the logger to what it logs, `logger`;
    `valve` is the case as the valve feels it, where that is another. Names of causes that begin with one of `right`
    tell it rightly.
    """

    words: str
    meter: Callable[[Case, list[Record]], list[Record]] = lambda case, records: records
    logger: Callable[[Case, list[Record]], list[Record]] = lambda case, records: records
    valve: Callable[[Case], Case] = lambda case: case
    right: tuple[str, ...] = ()


def of_column(name: str, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[..., list[Record]]:
    """A change (values, time) of a column, "each" of every channel, "first" of a case's first alone."""

    def changed(case: Case, records: list[Record]) -> list[Record]:
        names = {"each": case.channels, "first": case.channels[:1], "command": (case.drive,)}.get(name, (name,))
        return [
            record | {one: change(record[one], record["time"]) for one in names if one in record} for record in records
        ]

    return changed


def of_some_records(chosen: slice, change: Callable[..., list[Record]]) -> Callable[..., list[Record]]:
    """A change of some of the records."""

    def changed(case: Case, records: list[Record]) -> list[Record]:
        records = list(records)
        records[chosen] = change(case, records[chosen])
        return records

    return changed


def filtered(kind: str, frequency: float, order: int = 2, damping: float = 0.7) -> Callable[..., np.ndarray]:
    """A change by an analogue filter, at rest with the first reading (a "highpass": from zero)."""
    if kind == "resonance":
        w = 2.0 * np.pi * frequency
        system = signal.TransferFunction([w * w], [1.0, 2.0 * damping * w, w * w])
    else:
        system = signal.TransferFunction(*signal.bessel(order, 2.0 * np.pi * frequency, kind, analog=True, norm="mag"))

    def change(values: np.ndarray, times: np.ndarray) -> np.ndarray:
        read = signal.lsim(system, values - values[0], times)[1]
        return read if kind == "highpass" else values[0] + read

    return change


def span(values: np.ndarray) -> float:
    return float(np.ptp(values))


def play(values: np.ndarray, share: float) -> np.ndarray:
    """A play operator of that share of the span."""
    half, read = 0.5 * share * span(values), np.array(values)
    for k in range(1, len(values)):
        read[k] = min(max(read[k - 1], values[k] - half), values[k] + half)
    return read


def moving_mean(values: np.ndarray, samples: int) -> np.ndarray:
    return np.convolve(np.pad(values, (samples - 1, 0), mode="edge"), np.ones(samples) / samples, "valid")


def resampled(values: np.ndarray, times: np.ndarray, rate: float) -> np.ndarray:
    """Sampled at another rate, and written at the times by straight lines."""
    own = np.arange(int(times[-1] * rate) + 2) / rate
    return np.interp(times, own, np.interp(own, times, values))


def dice_of(values: np.ndarray) -> np.random.Generator:
    """The same for the same readings."""
    return np.random.default_rng(list(values[:8].tobytes()))


def jittered(values: np.ndarray, times: np.ndarray, deviation: float) -> np.ndarray:
    return np.interp(times + dice_of(values).normal(0.0, deviation, len(times)), times, values)


def spiked(values: np.ndarray, share: float) -> np.ndarray:
    dice, read = dice_of(values), np.array(values)
    at = dice.random(len(values)) < share
    read[at] += dice.normal(0.0, 0.1 * span(values), at.sum())
    return read


def cross_talk(case: Case, records: list[Record]) -> list[Record]:
    """A thousandth of the command's size into every channel, as shares of their spans."""
    spoilt = []
    for record in records:
        talk = 1e-3 * record[case.drive] / np.max(np.abs(record[case.drive]))
        spoilt.append(record | {name: record[name] + span(record[name]) * talk for name in case.channels})
    return spoilt


def lost_samples(case: Case, records: list[Record]) -> list[Record]:
    """Seven samples are lost in the middle of the first record, and the time goes on as if they were not."""
    record = records[0]
    n = len(record["time"])
    kept = np.r_[0 : n // 2, n // 2 + 7 : n]
    return [{name: c[: len(kept)] if name == "time" else c[kept] for name, c in record.items()}, *records[1:]]


def other_command(case: Case, records: list[Record]) -> list[Record]:
    """The commands of the first two records are exchanged, as by a wrong file name."""
    first, second, *rest = records
    return [first | {case.drive: second[case.drive]}, second | {case.drive: first[case.drive]}, *rest]


def stuck(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """A reading that stays where it is from the middle on."""
    return np.where(np.arange(len(values)) < len(values) // 2, values, values[len(values) // 2])


def behind_filter(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[Case], Case]:
    """A valve that feels a command changed."""

    def changed(case: Case) -> Case:
        runs = tuple(replace(run, command=change(run.command, run.time)) for run in case.runs)
        return replace(case, runs=runs)

    return changed


def in_turn(*changes: Callable[..., list[Record]]) -> Callable[..., list[Record]]:
    """Several changes, one after the other."""

    def changed(case: Case, records: list[Record]) -> list[Record]:
        for change in changes:
            records = change(case, records)
        return records

    return changed


def off_by(share: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A zero that is off by a share of the span."""
    return lambda x, t: x + share * span(x)


def teeth(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """A flow that ripples by 1 % with each microlitre."""
    turned = np.cumsum(np.abs(x)) * (t[1] - t[0])
    return x * (1.0 + 0.01 * np.sin(2e6 * np.pi * turned))


def coarse(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    """In 200 steps of the span."""
    step = span(x) / 200.0
    return np.round(x / step) * step


def smoothed(x: np.ndarray, t: np.ndarray) -> np.ndarray:
    return signal.filtfilt(*signal.butter(2, 150.0, fs=1.0 / t[1]), x)


EACH_AND_COMMAND = ("each", "command")
ANTIALIAS = filtered("lowpass", 200.0, 4)
LOOP = behind_filter(filtered("resonance", 150.0))
FAULTS = {
    "shunt": Fault("the current is read 3 % high", of_column("current", lambda x, t: 1.03 * x)),
    "current_zero": Fault("the current is read 0.5 % of its span off", of_column("current", off_by(0.005))),
    "thermometer": Fault("the oil is 10 K warmer than read", of_column("oil_temperature", lambda x, t: x - 10.0)),
    "supply_gauge": Fault("the supply is read 2 % high", of_column("supply_pressure", lambda x, t: 1.02 * x)),
    "load_gauge": Fault("the load pressure is read 3 bar off", of_column("load_pressure", lambda x, t: x + 3e5)),
    "second_order": Fault(
        "the first channel follows by 60 Hz, damping ratio 0.5",
        of_column("first", filtered("resonance", 60.0, damping=0.5)),
    ),
    "tube": Fault(
        "a pressure is read through a tube of 300 Hz, damping ratio 0.2",
        of_column("nozzle_pressure_1", filtered("resonance", 300.0, damping=0.2)),
    ),
    "antialias": Fault("each channel behind a Bessel filter of 200 Hz", of_column("each", ANTIALIAS)),
    "antialias_one": Fault(
        "one channel behind a Bessel filter of 150 Hz", of_column("first", filtered("lowpass", 150.0, 4))
    ),
    "antialias_all": Fault(
        "each channel and the command behind a Bessel filter of 200 Hz",
        in_turn(*(of_column(name, ANTIALIAS) for name in EACH_AND_COMMAND)),
    ),
    "ac_coupled": Fault(
        "a pressure without its mean, from 0.5 Hz on", of_column("nozzle_pressure_1", filtered("highpass", 0.5, 1))
    ),
    "play": Fault("the first channel has a play of 0.3 %", of_column("first", lambda x, t: play(x, 0.003))),
    "dead_zone": Fault(
        "the flow is read as 0 below 3 % of its largest",
        of_column("load_flow", lambda x, t: np.where(np.abs(x) < 0.03 * np.max(np.abs(x)), 0.0, x)),
    ),
    "teeth": Fault("the flow ripples by 1 % with the meter's teeth", of_column("load_flow", teeth)),
    "cross_talk": Fault("0.1 % of the command in every channel", cross_talk),
    "mains": Fault(
        "50 Hz of 0.5 % on the first channel",
        of_column("first", lambda x, t: x + 0.005 * span(x) * np.sin(100.0 * np.pi * t)),
    ),
    "stuck": Fault(
        "the first channel is stuck from the middle of the first record on",
        of_some_records(slice(0, 1), of_column("first", stuck)),
    ),
    "set_anew": Fault(
        "the first channel's zero is 1 % off in the last two training records",
        of_some_records(slice(2, 4), of_column("first", off_by(0.01))),
    ),
    "other_rate": Fault("the clock of the logger is 1 % fast", of_column("time", lambda x, t: 1.01 * x)),
    "other_command": Fault("the commands of two records are exchanged", other_command),
    "amplifier": Fault("a current loop of 150 Hz, 0.7, is not in its column", valve=LOOP, right=("amplifier",)),
    "smooth": Fault("a filter of 150 Hz, both ways, after the logger", logger=of_column("each", smoothed)),
    "moving_mean": Fault(
        "a moving mean of five samples", logger=of_column("each", lambda x, t: moving_mean(x, 5))
    ),
    "moving_mean_command": Fault(
        "a moving mean of five samples of all columns",
        logger=in_turn(*(of_column(name, lambda x, t: moving_mean(x, 5)) for name in EACH_AND_COMMAND)),
    ),
    "resampled": Fault(
        "from 800 Hz to the file's rate by straight lines",
        logger=in_turn(*(of_column(name, lambda x, t: resampled(x, t, 800.0)) for name in EACH_AND_COMMAND)),
    ),
    "jitter": Fault("the samples' times jitter by 0.2 ms", logger=of_column("each", lambda x, t: jittered(x, t, 2e-4))),
    "coarse": Fault("each channel in 200 steps of its span", logger=of_column("each", coarse)),
    "spikes": Fault(
        "one reading of a hundred is off by 10 % of the span", logger=of_column("first", lambda x, t: spiked(x, 0.01))
    ),
    "lost_samples": Fault("seven samples lost in one record, and the time closed up", logger=lost_samples),
    "twice": Fault("the first record is there twice", logger=lambda case, r: [r[0], r[0], *r[2:]]),
}
"""By name. Columns of a voltage drive's current are a channel's."""


def spoilt(case: Case, fault: Fault) -> list[Record]:
    """What is logged of a case: the commands as they were given, unless the fault is of them."""
    felt = responses(fault.valve(case))
    given = [record | {case.drive: run.command} for record, run in zip(felt, case.runs, strict=True)]
    return fault.logger(case, noisy(case, clean=fault.meter(case, given)))


def is_wrong(found: vs.Diagnosis, case: Case, fault: Fault) -> bool:
    """Whether one thing is named that is neither hidden nor an error of the instruments."""
    right = (*(name for name, _ in case.hidden), *fault.right, "sensor_")
    named = [name.split("@")[0] for name in found.causes] if found.verdict == "cause" else []
    return any(not name.startswith(right) for name in named)


def diagnosed(name: str, seed: int, kind: str) -> tuple[Any, ...]:
    """The fault, what is hidden, the answer with its seconds of the processor, and whether it is wrong."""
    case = draw(seed, kind, noise=NOISE)
    hidden, fault = ", ".join(one for one, _ in case.hidden) or "-", f"{name}, {FAULTS[name].words}"
    with tempfile.TemporaryDirectory() as folder:
        write_files(case, spoilt(case, FAULTS[name]), folder)
        worked = time.process_time()
        try:
            found = vs.diagnose(folder)
        except (vs.InputError, vs.SolveError) as error:
            return fault, seed, hidden, f"{type(error).__name__}: {error}", f"{time.process_time() - worked:.1f} s", ""
    in_set = ", ".join(one.label for one in found.candidates if one.in_set) or "-"
    bench = "; ".join(note for note in found.notes if note.startswith("the bench"))
    answer = f"{found.verdict} {found.reason}: {in_set} ({found.summary}) [{bench}]"
    wrong = "WRONG" if is_wrong(found, case, FAULTS[name]) else ""
    return fault, seed, hidden, answer, f"{time.process_time() - worked:.1f} s", wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=int, help="the first seed")
    parser.add_argument("count", type=int, help="sessions of each fault")
    parser.add_argument("--kinds", nargs="+", choices=FAULTS, default=list(FAULTS), metavar="FAULT", help="these alone")
    parser.add_argument("--effect", action="store_true", help="with an effect hidden in each")
    given = parser.parse_args()
    for k, name in enumerate(given.kinds):
        for seed in range(given.first + given.count * k, given.first + given.count * (k + 1)):
            print(*diagnosed(name, seed, "effect" if given.effect else "none"), sep=" | ", flush=True)


if __name__ == "__main__":
    main()
