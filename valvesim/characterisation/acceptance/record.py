"""A record of a bench test: current, output and time, as simulated or as measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvesim.errors import InputError
from valvesim.io import read_columns

LEAST_POINTS = 50  # of a branch
GAP = 5.0  # times the usual sampling interval: longer is a gap


@dataclass(frozen=True, kw_only=True)
class AcceptanceRecord:
    """A bench record: `values[name]` (n,) in SI for `time` and any of current, load_flow, load_pressure,
    internal_leakage and pressure_drop; `source` names the file or run. Raises InputError for gaps and false lengths.
    """  # fmt: skip

    source: str
    values: dict[str, np.ndarray]

    def __post_init__(self):
        t = self.channel("time")
        for name, v in self.values.items():
            if np.shape(v) != t.shape or t.ndim != 1 or not np.all(np.isfinite(v)):
                raise InputError(f"{self.source}: column {name!r} has gaps, or not as many values as the time")
        if len(t) < 2 * LEAST_POINTS:
            raise InputError(f"{self.source}: {len(t)} samples; a bench record needs {2 * LEAST_POINTS} or more")
        steps = np.diff(t)
        k, usual = int(np.argmax(steps)), float(np.median(steps))
        if np.min(steps) < 0.0 or usual <= 0.0:
            raise InputError(f"{self.source}: time must rise")
        if steps[k] > GAP * usual:
            where = f"{steps[k]:.4g} s at {t[k]:.6g} s (samples come every {usual:.4g} s)"
            raise InputError(f"{self.source}: gap of {where}")

    def channel(self, name: str) -> np.ndarray:
        """The values of a channel; InputError where the record has no such column."""
        if name not in self.values:
            have = ", ".join(self.values)
            raise InputError(f"{self.source}: no column {name!r}, which this test needs; it has {have}")
        return self.values[name]


_UNITS = {
    "time": "s", "current": "A", "load_flow": "m^3/s", "load_pressure": "Pa", "internal_leakage": "m^3/s",
    "pressure_drop": "Pa",
}  # fmt: skip
_PLAIN = dict(zip(
    ("t_s", "current_A", "flow_m3s", "load_pressure_Pa", "leak_flow_m3s", "pressure_drop_Pa"), _UNITS, strict=True
))  # fmt: skip


def read_record(path: str | Path) -> AcceptanceRecord:
    """A record from CSV: header `time [s],current [mA],load_flow [L/min],...` with any unit, or SI by plain names.

    Known columns: time, current, load_flow, load_pressure, internal_leakage, pressure_drop; plain ones are t_s,
    current_A, flow_m3s, load_pressure_Pa, leak_flow_m3s, pressure_drop_Pa. Others are left out.
    Raises InputError for a missing file, time column or unit, cells that are no numbers, and gaps.
    """
    path = Path(path)
    try:
        with open(path, encoding="utf-8-sig") as file:
            names = [name.strip().strip('"') for name in next((line for line in file if line.strip()), "").split(",")]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not any(name in _PLAIN for name in names):
        bare = [name.partition("[")[0].strip() for name in names]
        found = {name: unit for name, unit in _UNITS.items() if name in bare or name == "time"}
        return AcceptanceRecord(source=path.name, values=read_columns(path, found))
    if "t_s" not in names:
        raise InputError(f"{path}: no column 't_s' (or 'time [s]')")
    try:
        data = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return AcceptanceRecord(
        source=path.name, values={_PLAIN[n]: data[:, k] for k, n in enumerate(names) if n in _PLAIN}
    )


def record_of(source: str, values: dict[str, np.ndarray], *names: str) -> AcceptanceRecord:
    return AcceptanceRecord(
        source=source, values={name: np.asarray(values[name]) for name in ("time", "current", *names)}
    )


def part_of(record: AcceptanceRecord, keep: np.ndarray) -> AcceptanceRecord:
    return AcceptanceRecord(source=record.source, values={name: v[keep] for name, v in record.values.items()})
