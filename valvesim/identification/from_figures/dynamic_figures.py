"""Dynamic figures of many valves at once: steady sines and steps of the current, simulated as a batch.

A frequency at which the response passes a level is told from sines about where it is expected: exact near there, and
pointing to it from afar. Figures are defined as in `characterisation`; the output is the spool.

Symbols
    f frequency, a amplitude (share of rated current), L level passed: amplitude ratio dB or phase lag degrees
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from valvesim.errors import ValidityWarning
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, DynamicOptions
from valvesim.inputs import Command, Constant, Sine, Step
from valvesim.simulation.batch import simulate_batch
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.units import quantities
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True)
class Bench:
    """Valves of one rated current on a bench: what the dynamic tests do not change. `workers` threads run them."""

    valve: Valve
    conditions: Mapping[str, float]
    oil: Oil
    workers: int = 1
    options: DynamicOptions = DEFAULT_FROM_FIGURES.dynamic

    def run(self, command: Command, duration: float, rate: float) -> dict[str, np.ndarray]:
        """States by name (k, n) and "time" (n,)."""
        held = replace(
            self.valve, supply_pressure=self.conditions["supply_pressure"],
            return_pressure=self.conditions["return_pressure"], load_pressure=0.0,
        )  # fmt: skip
        scenario = Scenario(
            valve=held, oil=self.oil, thermal=Thermal(network=None), command=command, duration=duration,
            oil_temperature=Constant(value=self.conditions["oil_temperature"]), output_rate=rate,
            tolerance=self.options.tolerance,
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ValidityWarning)
            return simulate_batch(scenario, workers=self.workers)

    @property
    def rated(self) -> float:
        """Rated current, A."""
        return float(np.max(self.valve.rated_current))

    @property
    def members(self) -> int:
        """How many valves there are."""
        return max(np.size(getattr(self.valve, name)) for name in quantities(self.valve))


def sine_gain(bench: Bench, amplitude: float, frequency: float) -> np.ndarray:
    """Complex gain (k,), spool over current, of a steady sine of `amplitude` (share of rated current)."""
    options, top = bench.options, amplitude * bench.rated
    wait, n = int(np.ceil(options.settle_time * frequency)) + options.settle_cycles, options.samples
    run = bench.run(Sine(amplitude=top, frequency=frequency), (wait + 1) / frequency, n * frequency)
    angle = 2.0 * np.pi * frequency * (t := run["time"][-n:])
    basis = np.column_stack([np.cos(angle), -np.sin(angle), np.ones(n), t - t[0]])  # a slow valve still drifts
    weights = run["spool_position"][:, -n:] @ np.linalg.pinv(basis).T
    return (weights[:, 0] + 1j * weights[:, 1]) * 1j / top


class Sines:
    """Steady sines of a bench, each run once: gains by amplitude and frequency."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self._gains: dict[tuple[float, float], np.ndarray] = {}

    def gain(self, amplitude: float, frequency: float) -> np.ndarray:
        """Complex gain (k,)."""
        key = (round(amplitude, 6), float(f"{frequency:.6g}"))
        if key not in self._gains:
            self._gains[key] = sine_gain(self.bench, *key)
        return self._gains[key]

    def ratio(self, amplitude: float, frequency: float, expected: float) -> np.ndarray:
        """Amplitude ratio (k,), dB from that at the low frequency to which those about the `expected` one refer."""
        low = max(self.bench.options.reference * expected, self.bench.options.least_frequency)
        return 20.0 * np.log10(np.abs(self.gain(amplitude, frequency)) / np.abs(self.gain(amplitude, low)))

    def lag(self, amplitude: float, frequency: float) -> np.ndarray:
        """Phase lag (k,), degrees within -90 to 270."""
        lag = -np.rad2deg(np.angle(self.gain(amplitude, frequency)))
        return np.where(lag < -90.0, lag + 360.0, lag)

    def crossing(self, name: str, amplitude: float, expected: float) -> np.ndarray:
        """Frequency (k,) of -3 dB or 90 degrees, straight over ln f between sines about the expected one."""
        options = self.bench.options
        at = expected * np.array(options.beside)
        if name == "frequency_minus_3_db":
            level, slopes = 3.0, options.decibel_slopes
            fall = np.stack([-self.ratio(amplitude, f, expected) for f in at])
        else:
            level, slopes = 90.0, options.degree_slopes
            fall = np.stack([self.lag(amplitude, f) for f in at])
        below = (fall[1] >= level).astype(int)  # in the lower of the two intervals, or beyond it
        k = 1 - below
        low_fall, high_fall = (np.take_along_axis(fall, (k + n)[None], axis=0)[0] for n in (0, 1))
        width = np.log(at[k + 1] / at[k])
        steepness = np.clip((high_fall - low_fall) / width, *slopes)
        offset = np.clip((level - (low_fall + high_fall) / 2.0) / steepness, -2.0, 2.0)
        return np.sqrt(at[k] * at[k + 1]) * np.exp(offset)


def batch_step_figures(bench: Bench, amplitude: float, expected: float) -> dict[str, np.ndarray]:
    """time_to_90_percent, rise_time (s) and overshoot (%), each (k,), of a step from zero; `expected` time to 90 %."""
    before, last = 2e-4, 8.0 * expected
    run = bench.run(Step(after=amplitude * bench.rated, time=before), before + last, 2000.0 / last)
    time, x = run["time"] - before, run["spool_position"]
    end = x[:, -len(time) // 10 :].mean(axis=1, keepdims=True)
    share = (x - x[:, :1]) / (end - x[:, :1])

    def reach(level: float) -> np.ndarray:
        k = np.clip(np.argmax(share >= level, axis=1), 1, None)
        a, b = (np.take_along_axis(share, (k + step)[:, None], axis=1)[:, 0] for step in (-1, 0))
        return time[k - 1] + (level - a) / np.maximum(b - a, 1e-12) * (time[k] - time[k - 1])

    first, ninety = reach(0.1), reach(0.9)
    over = 100.0 * np.maximum(share.max(axis=1) - 1.0, 0.0)
    return {"time_to_90_percent": ninety, "rise_time": ninety - first, "overshoot": over}
