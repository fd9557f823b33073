"""A record of a bench test: current, output and time, as simulated or as measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, AcceptanceOptions
from valvesim.errors import InputError
from valvesim.measurement.columns_table import NOTHING_STATED, Statements
from valvesim.measurement.recording import read_recording


@dataclass(frozen=True, kw_only=True)
class AcceptanceRecord:
    """A bench record: `values[name]` (n,) in SI for `time` and any of current, load_flow, load_pressure,
    internal_leakage and pressure_drop; `source` names the file or run. Raises InputError for gaps and false lengths.
    """  # fmt: skip

    source: str
    values: dict[str, np.ndarray]
    options: AcceptanceOptions = DEFAULT_CHARACTERISATION.acceptance

    def __post_init__(self):
        t, options = self.channel("time"), self.options
        for name, v in self.values.items():
            if np.shape(v) != t.shape or t.ndim != 1 or not np.all(np.isfinite(v)):
                raise InputError(f"{self.source}: column {name!r} has gaps, or not as many values as the time")
        if len(t) < (least := 2 * options.least_points):
            raise InputError(f"{self.source}: {len(t)} samples; a bench record needs {least} or more")
        steps = np.diff(t)
        k, usual = int(np.argmax(steps)), float(np.median(steps))
        if np.min(steps) < 0.0 or usual <= 0.0:
            raise InputError(f"{self.source}: time must rise")
        drive = self.values.get("current", self.values.get("pressure_drop", t))
        moved = abs(drive[k + 1] - drive[k]) > options.motion_in_gap * np.ptp(drive)
        if steps[k] > options.longest_interval * usual and moved:
            where = f"{steps[k]:.4g} s at {t[k]:.6g} s (samples come every {usual:.4g} s)"
            raise InputError(f"{self.source}: gap of {where}")

    def channel(self, name: str) -> np.ndarray:
        """The values of a channel; InputError where the record has no such column."""
        if name not in self.values:
            have = ", ".join(self.values)
            raise InputError(f"{self.source}: no column {name!r}, which this test needs; it has {have}")
        return self.values[name]


ACCEPTANCE_CHANNELS = ("current", "load_flow", "load_pressure", "internal_leakage", "pressure_drop")


def read_record(
    *files: str | Path, stated: Statements = NOTHING_STATED,
    options: AcceptanceOptions = DEFAULT_CHARACTERISATION.acceptance,
) -> AcceptanceRecord:  # fmt: skip
    """A record from one file of any format, or from several that were written together, with any unit.

    Known columns: time, current, load_flow, load_pressure, internal_leakage, pressure_drop; others are left out, and so
    are samples at which one of them has no reading. Raises as `read_recording` does, and InputError for gaps.
    """
    paths = [Path(file) for file in files]
    recording = read_recording(paths, ACCEPTANCE_CHANNELS, stated=stated)
    values = {"time": recording.time} | {n: recording.values[n] for n in ACCEPTANCE_CHANNELS if n in recording.values}
    there = np.all([np.isfinite(column) for column in values.values()], axis=0)
    values = {name: column[there] for name, column in values.items()}
    return AcceptanceRecord(source=paths[0].name, values=values, options=options)


def record_of(source: str, values: dict[str, np.ndarray], *names: str) -> AcceptanceRecord:
    return AcceptanceRecord(
        source=source, values={name: np.asarray(values[name]) for name in ("time", "current", *names)}
    )


def part_of(record: AcceptanceRecord, keep: np.ndarray) -> AcceptanceRecord:
    return replace(record, values={name: v[keep] for name, v in record.values.items()})
