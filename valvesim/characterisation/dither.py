"""Dither: a small, fast sine superposed upon the current of a test, so that friction and hysteresis hold less of it
(SAE ARP490, ISO 10770-1). Figures are told without it: slow curves are means over its periods, of the dynamic tests its
own sine is taken off.

Symbols
    f frequency, T = 1/f period
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError
from valvesim.inputs import Command, Sine, Sum
from valvesim.units import POSITIVE, check_bounds, quantity

DITHER_CONDITIONS = ("dither_amplitude", "dither_frequency")
SAMPLES = 8  # of a period, from which its mean is taken: harmonics below the eighth vanish


@dataclass(frozen=True, kw_only=True)
class Dither:
    """A sine upon the command; an amplitude of zero is none."""

    amplitude: float = quantity(0.0, "1", "share of rated current, peak", (0.0, 0.5), "")
    frequency: float = quantity(400.0, "Hz", "frequency", (POSITIVE, 1e4), "")

    def __post_init__(self):
        check_bounds(self)

    @property
    def conditions(self) -> dict[str, float]:
        """As conditions of a test, by the names of a specification's."""
        values = (self.amplitude, self.frequency) if self.amplitude else (self.amplitude,)
        return dict(zip(DITHER_CONDITIONS, values, strict=False))

    def in_words(self) -> str:
        """Amplitude and frequency, such as `2 % of rated at 400 Hz`."""
        return f"{100.0 * self.amplitude:.3g} % of rated at {self.frequency:.4g} Hz" if self.amplitude else "none"

    def upon(self, command: Command, rated: float) -> Command:
        """A command with the dither upon it, of a valve whose rated command is `rated`."""
        if not self.amplitude:
            return command
        return Sum(terms=(command, Sine(amplitude=self.amplitude * rated, frequency=self.frequency)))

    def means(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Columns (n,) with "time", each as its means over whole periods at their middles; as they are without dither,
        and where they hold fewer than four samples of a period: the meters have averaged it.
        """
        time, period = values["time"], 1.0 / self.frequency
        if not self.amplitude or period < 4.0 * float(np.median(np.diff(time))):
            return dict(values)
        edges = np.arange(time[0], time[-1], period)
        if len(edges) < 3:
            raise InputError(f"a record of {np.ptp(time):.3g} s holds no two periods of a dither of 1/{period:.3g} s")

        def mean(column: np.ndarray) -> np.ndarray:
            area = np.concatenate([[0.0], np.cumsum((column[1:] + column[:-1]) / 2.0 * np.diff(time))])
            return np.diff(np.interp(edges, time, area)) / period

        return {name: mean(column) for name, column in values.items()} | {"time": edges[:-1] + period / 2.0}

    def taken_off(self, time: np.ndarray, column: np.ndarray, steady: slice) -> np.ndarray:
        """A column (n,) less the sine of the dither that its `steady` part shows."""
        if not self.amplitude:
            return column
        angle = 2.0 * np.pi * self.frequency * time
        waves = np.column_stack([np.sin(angle), np.cos(angle)])
        line = np.column_stack([np.ones(len(time)), time - time[0]])[steady]
        weights = np.linalg.lstsq(np.column_stack([waves[steady], line]), column[steady], rcond=None)[0]
        return column - waves @ weights[:2]


NO_DITHER = Dither()


def dither_of(conditions: Mapping[str, float], where: str = "") -> Dither:
    """The dither that the conditions of a test state. Raises InputError for an amplitude without a frequency."""
    amplitude = conditions.get("dither_amplitude", 0.0)
    if amplitude and "dither_frequency" not in conditions:
        raise InputError("needs dither_frequency too, such as '400 Hz'", key=where or "dither_amplitude", joint=" ")
    return Dither(amplitude=amplitude, frequency=conditions.get("dither_frequency", NO_DITHER.frequency))
