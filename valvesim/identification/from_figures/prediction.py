"""What the figures of a specification would be of many valves at once, and how well each is known.

Symbols
    f a figure, s its standard deviation among valves of the specification, k valves, q figures
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.specification import COMMON, FIGURES, Limit
from valvesim.identification.from_figures.dynamic_figures import Bench, Sines, batch_step_figures
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, FromFiguresOptions
from valvesim.identification.from_figures.static_figures import static_figures
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve

SINE_FIGURES = ("frequency_minus_3_db", "frequency_minus_90_deg", "amplitude_ratio", "phase_lag")
STEP_FIGURES = ("time_to_90_percent", "rise_time", "overshoot")
POSITIVE_UNITS = ("ohm", "H", "m^3/s", "m^3/s/A", "Pa/A", "-", "Hz", "s")
COIL_FIGURES = ("coil_resistance", "coil_inductance")
STATIC_FIGURES = (
    "rated_flow", "flow_at_rated", "flow_gain", "linearity", "symmetry", "null_bias", "lap", "pressure_gain",
    "pressure_gain_share", "null_leakage", "tare_leakage", "null_shift_temperature", "null_shift_supply",
    "null_shift_return",
)  # fmt: skip
FITTED = (*COIL_FIGURES, *STATIC_FIGURES, *SINE_FIGURES, *STEP_FIGURES)
"""The figures that are predicted; hysteresis and threshold are those of effects in service."""
CENTRED = ("null_bias", "lap", "null_shift_temperature", "null_shift_supply", "null_shift_return")
"""Figures that are as often negative as positive, so that a limit on their size tells how they scatter."""


@dataclass(frozen=True)
class Asked:
    """A figure that is asked for: its limit, the value aimed at (nan: within the limit alone) and one deviation."""

    limit: Limit
    value: float
    deviation: float

    @property
    def expected(self) -> float:
        """What is expected of the figure before anything is simulated: its value, else its limit."""
        known = (self.value, self.limit.high, self.limit.low)
        return next(value for value in known if math.isfinite(value))

    def misfit(self, predicted: float) -> float:
        """Deviations from the value; of a limit alone, by how much it is not kept with one to spare.

        Of figures that are positive their logarithm counts: those of valves differ by factors.
        """
        if math.isfinite(self.value):
            return self._off(predicted, self.value)
        above, below = self._off(predicted, self.limit.high) + 1.0, 1.0 - self._off(predicted, self.limit.low)
        return max(above, 0.0) - max(below, 0.0)

    def weight(self, predicted: float) -> float:
        """The slope of the misfit over the figure, 1/SI; zero of a limit that is kept."""
        if math.isnan(self.value) and self.misfit(predicted) == 0.0:
            return 0.0
        return self.expected / (predicted * self.deviation) if self._by_factors else 1.0 / self.deviation

    def _off(self, predicted: float, wanted: float) -> float:
        if not self._by_factors or math.isinf(wanted):
            return (predicted - wanted) / self.deviation
        return math.log(predicted / wanted) * wanted / self.deviation

    @property
    def _by_factors(self) -> bool:
        return FIGURES[self.limit.figure].unit in POSITIVE_UNITS and self.limit.figure not in CENTRED

    def reached(self, predicted: float) -> bool:
        """Whether a prediction keeps the limits, or without any is within two deviations of the value."""
        low, high = self.limit.low, self.limit.high
        if math.isinf(low) and math.isinf(high):
            low, high = self.value - 2.0 * self.deviation, self.value + 2.0 * self.deviation
        size = abs(predicted) if self.limit.figure in CENTRED and math.isinf(low) else predicted
        rounding = 1e-3 * self.deviation
        return low - rounding <= size <= high + rounding


MODEL_ERROR = {
    "frequency_minus_90_deg": 0.02, "phase_lag": 0.02, "frequency_minus_3_db": 0.01, "amplitude_ratio": 0.01,
    "time_to_90_percent": 0.01, "rise_time": 0.01, "pressure_gain": 0.01, "pressure_gain_share": 0.01,
    "null_leakage": 0.005, "tare_leakage": 0.005, "rated_flow": 0.002, "flow_at_rated": 0.002, "flow_gain": 0.002,
}  # fmt: skip
"""One standard deviation, as a share, by which a figure of the model may be off that of a valve with the same
dimensions. Measured against the plant of the tests (`docs/measurements.md`), whose second mode of the armature tells
where the flapper meets its nozzles; rounded up, since a valve has more that the model lacks."""


def asked_of(limit: Limit) -> Asked:
    """What a limit asks for: its nominal value with its spread, or with a single limit that it be kept."""
    if not math.isnan(limit.nominal):
        size = abs(limit.nominal)
        spread = limit.deviation if limit.deviation > 0.0 else 1e-3 * size
        return Asked(limit, limit.nominal, math.hypot(spread, MODEL_ERROR.get(limit.figure, 0.0) * size))
    if limit.figure in CENTRED and math.isinf(limit.low):
        return Asked(limit, 0.0, limit.high / 2.0)
    end = limit.high if math.isfinite(limit.high) else limit.low
    return Asked(limit, math.nan, abs(end) * max(FIGURES[limit.figure].spread, 0.02) / 2.0)


@dataclass(frozen=True)
class FigurePredictor:
    """Predicts figures of batches of valves; `conditions` and `oil` where a figure has none of its own."""

    asked: tuple[Asked, ...]
    conditions: Mapping[str, float]
    oil: Oil
    workers: int = 1
    options: FromFiguresOptions = DEFAULT_FROM_FIGURES

    def predict(self, valves: Valve, members: int) -> np.ndarray:
        """The asked figures (members, q) of a batch of valves, in SI. Raises as `simulate_batch` and `Valve.at` do."""
        columns = np.empty((members, len(self.asked)))
        for group, figures in self._static_groups().items():
            names = {self.asked[k].limit.figure for k in figures}
            found = static_figures(valves, names, dict(group), self.oil, options=self.options.static)
            for k in figures:
                columns[:, k] = found[self.asked[k].limit.figure]
        benches: dict[tuple[float, ...], Sines] = {}
        for k, asked in enumerate(self.asked):
            figure = asked.limit.figure
            if figure in COIL_FIGURES:
                columns[:, k] = getattr(valves, figure)
            elif figure in (*SINE_FIGURES, *STEP_FIGURES):
                conditions = self.conditions_of(asked)
                key = tuple(conditions[name] for name in COMMON)
                if key not in benches:
                    benches[key] = Sines(Bench(valves, conditions, self.oil, self.workers, self.options.dynamic))
                columns[:, k] = _dynamic(asked, benches[key], conditions)
        return columns

    def conditions_of(self, asked: Asked) -> dict[str, float]:
        """All conditions of a figure."""
        return {**self.conditions, **asked.limit.conditions}

    def _static_groups(self) -> dict[tuple[tuple[str, float], ...], list[int]]:
        """The static figures by their conditions."""
        groups: dict[tuple[tuple[str, float], ...], list[int]] = {}
        for k, asked in enumerate(self.asked):
            if asked.limit.figure in STATIC_FIGURES:
                groups.setdefault(tuple(sorted(self.conditions_of(asked).items())), []).append(k)
        return groups


def _dynamic(asked: Asked, sines: Sines, conditions: Mapping[str, float]) -> np.ndarray:
    """A dynamic figure (k,)."""
    figure, amplitude = asked.limit.figure, conditions["amplitude"]
    if figure in ("frequency_minus_3_db", "frequency_minus_90_deg"):
        return sines.crossing(figure, amplitude, asked.expected)
    if figure == "phase_lag":
        return sines.lag(amplitude, conditions["frequency"])
    if figure == "amplitude_ratio":
        frequency = conditions["frequency"]
        return sines.ratio(amplitude, frequency, frequency)
    expected = asked.expected if figure != "overshoot" else sines.bench.options.step_time
    return batch_step_figures(sines.bench, amplitude, expected)[figure]
