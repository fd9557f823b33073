"""The experiments that may be proposed: commands within the rated current, oil and pressures near the session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.identification.session import Session


@dataclass(frozen=True, eq=False)
class Experiment:
    """A test: `shape` (n,) of the command in shares of the rated one, `oil` (n,) °C, pressures Pa, `time` (n,) s."""

    description: str
    time: np.ndarray
    shape: np.ndarray
    oil: np.ndarray
    supply: float
    load: float

    def scaled(self, share: float) -> Experiment:
        """The same with a share of the command."""
        return replace(self, shape=share * self.shape)


def library(session: Session, *, options: DiagnosisOptions) -> tuple[Experiment, ...]:
    """The tests that are thought of for a session: commands within the rated current, supply at most nominal."""
    lowest, usual, highest = _oil_range(session, options=options)
    supply = float(session.valve.supply_pressure)
    rng = np.random.default_rng(session.seed)
    found = []

    def add(description: str, duration: float, shape: Callable[[np.ndarray], np.ndarray], *, supply: float = supply,
            load: float = 0.0, oil: tuple[float, float] = (usual, usual)) -> None:  # fmt: skip
        time = np.linspace(0.0, duration, int(round(duration * options.design.rate)) + 1)
        warm = np.interp(time, [0.0, 0.8 * duration], oil)
        found.append(Experiment(description, time, shape(time), warm, supply, load))

    def full(t: np.ndarray) -> np.ndarray:
        return options.design.full * _triangle(t, 0.5)

    chirp, large = _chirp(options.design.chirp), _chirp(options.design.full)
    steps = _random_steps(rng, options=options)
    add("fast chirp of medium size, 2 to 150 Hz", 1.0, chirp)
    add("slow full triangle", 2.0, full)
    add("slow small triangle about null", 2.0, lambda t: options.design.small * _triangle(t, 1.0))
    add("filtered random steps", 1.0, steps)
    add("fast chirp at low supply pressure", 1.0, chirp, supply=options.design.low_supply * supply)
    add("fast chirp of large size, 2 to 150 Hz", 1.0, large)
    add("fast chirp of large size at low supply pressure", 1.0, large, supply=options.design.low_supply * supply)
    add("slow full triangle at low supply pressure", 2.0, full, supply=options.design.low_supply * supply)
    add("slow full triangle under load pressure", 2.0, full, load=options.design.load * supply)
    add("holds with small releases", 2.0, _holds)
    add("filtered random steps in cold oil", 1.0, steps, oil=(lowest, lowest))
    add("filtered random steps in hot oil", 1.0, steps, oil=(highest, highest))
    if session.thermal.network is not None:
        add(
            "sine while the oil warms up",
            4.0,
            lambda t: options.design.chirp * np.sin(2.0 * np.pi * 5.0 * t),
            oil=(lowest, highest),
        )
    return tuple(found)


def _oil_range(session: Session, *, options: DiagnosisOptions) -> tuple[float, float, float]:
    """The coldest, the usual and the hottest oil that a test may ask for, °C."""
    oils = [r.values["oil_temperature"] for r in session.records if "oil_temperature" in r.values]
    seen = np.concatenate(oils) if oils else np.array([20.0])
    low, high = float(seen.min()), float(seen.max())
    return (
        min(max(low - options.design.oil_margin, options.design.coldest_oil), low),
        float(np.median(seen)),
        max(min(high + options.design.oil_margin, options.design.hottest_oil), high),
    )


def _triangle(t: np.ndarray, frequency: float) -> np.ndarray:
    return 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * frequency * t))


def _chirp(size: float, low: float = 2.0, high: float = 150.0) -> Callable[[np.ndarray], np.ndarray]:
    def shape(t: np.ndarray) -> np.ndarray:
        end = t[-1]
        phase = 2.0 * np.pi * low * end / np.log(high / low) * ((high / low) ** (t / end) - 1.0)
        return size * np.sin(phase) * np.minimum(1.0, (end - t) / (0.02 * end))

    return shape


def _random_steps(rng: np.random.Generator, *, options: DiagnosisOptions) -> Callable[[np.ndarray], np.ndarray]:
    levels = rng.uniform(-0.7, 0.7, 25)
    levels[[0, -1]] = 0.0

    def shape(t: np.ndarray) -> np.ndarray:
        from scipy.ndimage import gaussian_filter1d

        own = levels[np.minimum((t / t[-1] * len(levels)).astype(int), len(levels) - 1)]
        return gaussian_filter1d(own, 0.003 * options.design.rate, mode="nearest")

    return shape


def _holds(t: np.ndarray) -> np.ndarray:
    """Level for a while, then a small step and back: what sticks shows as it lets go."""
    edges = [0.0, 0.5, 0.55, 1.0, 1.05, 1.5, 1.55, 1.95, 2.0]
    levels = np.interp(t, edges, [0.0, 0.0, 0.3, 0.3, -0.3, -0.3, 0.1, 0.1, 0.0])
    released = np.where(np.mod(t, 0.25) > 0.2, 0.02, 0.0)
    return levels + released * (t < t[-1] - 0.03)


def experiment_values(session: Session, trial: Experiment) -> dict[str, np.ndarray]:
    drive = session.drive
    rated = drive.command_for_current(session.valve.rated_current, session.valve.coil_resistance)
    ones = np.ones(len(trial.time))
    return {
        drive.command_name: rated * trial.shape, "oil_temperature": trial.oil,
        "supply_pressure": trial.supply * ones, "load_pressure": trial.load * ones,
    }  # fmt: skip
