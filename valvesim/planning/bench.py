"""What is planned with: the valve, the sensors that a bench has or may get, the tests that it can do, and the aim."""

from __future__ import annotations

from dataclasses import dataclass, field

from valvesim.diagnosis.experiments import Experiment
from valvesim.identification.session import Sensor, Session


@dataclass(frozen=True, kw_only=True)
class AddedSensor:
    """A sensor that may be added: what is known of it, and its `cost` in any unit of money."""

    sensor: Sensor
    cost: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Aim:
    """What the tests are for: `causes` by label (all of the catalogue where none is named), each to be detected and,
    where `isolate`, told from each other at its size in `sizes` (SI, above neutral; typical where none is stated); and
    `parameters` (of the valve) to be known to a standard deviation, SI.
    """

    causes: tuple[str, ...] = ()
    sizes: dict[str, float] = field(default_factory=dict)
    isolate: bool = True
    parameters: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BenchPlan:
    """A bench and what is asked of it: `session` holds the valve and no records.

    `sensors` are those that the bench has, `added` those that it may get, `experiments` its tests, of which one takes
    `setup` s before it runs; `command` drives the valve, "current" or "voltage". `thermometers` are the parts (names of
    `THERMAL_NODES`) whose temperature is measured.
    """

    session: Session
    sensors: tuple[Sensor, ...]
    added: tuple[AddedSensor, ...]
    experiments: tuple[Experiment, ...]
    command: str
    setup: float
    aim: Aim
    thermometers: tuple[str, ...] = ()
