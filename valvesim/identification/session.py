"""A measured test session: its records on even clocks, its sensors, and what is known of its valve."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.measurement.recording import no_line
from valvesim.simulation.scenario import Thermal
from valvesim.units import DISPLAY, symbol
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.equations import DRIVES, Drive
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import THERMAL_NODES

PART_TEMPERATURES = {f"{part}_temperature": part for part in THERMAL_NODES}
"""Columns of measured parts, which these follow."""
INPUTS = (
    "current", "voltage", "oil_temperature", "supply_pressure", "return_pressure", "load_pressure", *PART_TEMPERATURES,
)  # fmt: skip
"""Columns that say what acts on the valve."""
OUTPUTS = (
    "spool_position", "armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "load_flow", "internal_leakage",
    "current",
)  # fmt: skip
"""Columns that the model is held against; `current` only where the drive is a voltage."""
UNITS = {name: MEASURED_UNITS[name] for name in ("time", *INPUTS, *OUTPUTS)}


@dataclass(frozen=True)
class Sensor:
    """What is known of a sensor, in the channel's SI unit: noise (standard deviation, None if unknown), resolution
    (0 if unknown), first-order lag s, and the range outside which it saturates.
    """  # fmt: skip

    channel: str
    unit: str
    noise: float | None = None
    resolution: float = 0.0
    lag: float = 0.0
    range: tuple[float, float] = (-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Record:
    """One measured record on an even clock: `time` (n,) s from 0, `values[column]` (n,) in SI, temperatures in °C.

    `usable[channel]` (n,) is False where the sensor is saturated. An input that carries nothing but noise is held at
    its mean. `role` is "train" or "test"; records with one label `repeats` are repeats of one test. `path` is its
    first file, and `line_of(sample)` a line in it, None where it has none. `shares[channel]` is the share of the
    samples that a sensor slower than the record reads. `input_noise[column]` is the standard deviation of the white
    noise that the instrument of an input has put upon it, where it is known to have any, and `input_resolution[column]`
    the step of the grid on which it was read, where that is coarse enough to matter. `assumed` are inputs whose values
    nobody measured.
    """

    name: str
    time: np.ndarray
    values: dict[str, np.ndarray]
    usable: dict[str, np.ndarray]
    role: str = "train"
    repeats: str | None = None
    path: Path | None = None
    line_of: Callable[[int], int | None] = no_line
    shares: dict[str, float] = field(default_factory=dict)
    input_noise: dict[str, float] = field(default_factory=dict)
    input_resolution: dict[str, float] = field(default_factory=dict)
    assumed: tuple[str, ...] = ()

    def place(self, sample: int) -> str:
        """Where a sample stands, in words: its line, or its time."""
        return place_text(self.line_of(sample), float(self.time[sample]))

    @property
    def duration(self) -> float:
        """From the first to the last sample, s."""
        return float(self.time[-1])

    @property
    def rate(self) -> float:
        """Samples per second, Hz."""
        return (len(self.time) - 1) / self.duration

    @property
    def pace(self) -> float:
        """The rate to four digits: records of one pace share their noise, whatever their clocks' last digits."""
        return float(f"{self.rate:.4g}")

    @property
    def command(self) -> str:
        """The column that drives the valve: `voltage` where there is one, else `current`."""
        return "voltage" if "voltage" in self.values else "current"

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns that act on the valve: the command, temperatures and pressures."""
        return (self.command, *(name for name in INPUTS[2:] if name in self.values))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the output channels that can be used."""
        return tuple(self.usable)

    @property
    def test(self) -> str:
        """The test that this record belongs to: its repeats' label, else its own name."""
        return self.name if self.repeats is None else f"repeats {self.repeats!r}"

    def moves(self, *names: str) -> bool:
        """Whether any of these inputs moves; without names, any at all."""
        return any(np.ptp(self.values[name]) > 0.0 for name in names or self.inputs)


@dataclass(frozen=True, eq=False)
class Session:
    """A session that passed the audit. `effects` are known and in the nominal model, `user_effects` join the search and
    come from `effects_files`.

    `tolerances` are half-widths in SI of valve parameters, where the session overrides them; `sensors` has one entry
    for each output channel that any record has; `notes` say in words what was found, left out and cannot be claimed.
    """

    folder: Path
    title: str
    seed: int
    valve: Valve
    oil: Oil
    thermal: Thermal
    effects: tuple[ActiveEffect, ...]
    user_effects: tuple[Effect, ...]
    tolerances: dict[str, float]
    sensors: dict[str, Sensor]
    records: tuple[Record, ...]
    notes: tuple[str, ...]
    effects_files: tuple[Path, ...] = ()

    @property
    def training(self) -> tuple[Record, ...]:
        """The records that the search may see."""
        return tuple(record for record in self.records if record.role == "train")

    @property
    def locked(self) -> tuple[Record, ...]:
        """The records that are locked away until the gain is called with."""
        return tuple(record for record in self.records if record.role == "test")

    @property
    def drive(self) -> Drive:
        """How the coils are driven, the same in every record."""
        return DRIVES[self.records[0].command]


def replicates(records: Sequence[Record]) -> list[tuple[Record, Record]]:
    """Each replicate with the first of its test."""
    first: dict[str, Record] = {}
    pairs = [(first.setdefault(record.repeats, record), record) for record in records if record.repeats]
    return [(one, other) for one, other in pairs if one is not other]


def place_text(line: int | None, time: float) -> str:
    """Where a sample stands, in words."""
    return f"line {line}" if line is not None else f"{time:.6g} s"


def value_text(value: float, unit: str) -> str:
    """A figure as people read it."""
    unit, factor = DISPLAY.get(unit, (unit, 1.0))
    return f"{value * factor:.4g} {symbol(unit)}"
