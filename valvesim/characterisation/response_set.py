"""Every response of a valve: steps, stepped sines and chirps at any oil temperatures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.characterisation.dither import NO_DITHER, Dither
from valvesim.characterisation.figure_of_merit import FiguresOfMerit
from valvesim.characterisation.frequency_response import (
    FREQUENCIES,
    FrequencyResponse,
    at_single_frequencies,
    frequency_response,
)
from valvesim.characterisation.held_scenario import Source, held, held_oil_temperature, rated_command
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, ResponseOptions
from valvesim.characterisation.specification import Specification
from valvesim.characterisation.spectral_response import chirp_response
from valvesim.characterisation.step_response import StepResponse, step_response
from valvesim.inputs import evaluate
from valvesim.shown import Shown, notebook
from valvesim.units import reads_units

STEP_AMPLITUDES, SINE_AMPLITUDES = (0.05, 0.25, 1.0), (0.1, 0.25, 0.4, 1.0)  # shares of the rated current
OF_A_STEP = ("time_to_90_percent", "rise_time", "overshoot")


@dataclass(frozen=True, kw_only=True, repr=False)
class ResponseSet(Shown):
    """Every response of a valve at one oil temperature, with a dither or none: one of each kind for every amplitude."""

    oil_temperature: float
    steps: tuple[StepResponse, ...]
    sweeps: tuple[FrequencyResponse, ...]
    chirps: tuple[FrequencyResponse, ...]
    dither: Dither = NO_DITHER

    def in_words(self) -> str:
        """How many responses, and the oil's temperature."""
        return f"{len(self.steps)} steps and {len(self.sweeps)} sweeps, oil at {self.oil_temperature:g} °C"

    def plot(self) -> Any:
        """The matplotlib figures by name: bode, distortion, step, as far as there are such responses."""
        return notebook().plot(self)


@reads_units(oil_temperatures="degC", part_temperature="degC", frequencies="Hz")
def measure_responses(
    source: Source, *, oil_temperatures: Sequence[float] | None = None, part_temperature: float | None = None,
    steps: Sequence[float] = STEP_AMPLITUDES, sweeps: Sequence[float] = SINE_AMPLITUDES,
    frequencies: Sequence[float] = FREQUENCIES, chirp: bool = True, output: str = "spool_position", workers: int = 1,
    dither: Dither = NO_DITHER, progress: Callable[[float], None] | None = None,
    options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
) -> tuple[ResponseSet, ...]:  # fmt: skip
    """Steps, stepped sines and chirps at every oil temperature (°C; by default the source's own at its start).

    `steps` and `sweeps` are shares of the rated command, and all of them have the `dither`. Raises as `step_response`
    and `frequency_response` do.
    """
    first = held(source, part_temperature=part_temperature)
    rated = rated_command(first)
    given = [held_oil_temperature(first)] if oil_temperatures is None else np.atleast_1d(oil_temperatures)
    temperatures = [float(t) for t in given]
    kinds = 2 if chirp else 1
    total, done = max(len(temperatures) * len(sweeps) * kinds, 1), 0

    def tell(part: float) -> None:
        if progress is not None:
            progress(min((done + part) / total, 1.0))

    sets = []
    for temperature in temperatures:
        base = held(source, oil_temperature=temperature, part_temperature=part_temperature)
        stepped = tuple(
            step_response(base, amplitude=share * rated, output=output, dither=dither, options=options)
            for share in steps
        )
        swept, chirped = [], []
        for share in sweeps:
            swept.append(
                frequency_response(
                    base,
                    amplitude=share * rated,
                    frequencies=frequencies,
                    output=output,
                    workers=workers,
                    dither=dither,
                    progress=tell,
                    options=options,
                )  # fmt: skip
            )
            done += 1
            if chirp:
                band = {"low": float(np.min(frequencies)), "high": float(np.max(frequencies))}
                chirped.append(
                    chirp_response(
                        base, amplitude=share * rated, low=band["low"], high=band["high"], output=output,
                        dither=dither, progress=tell, options=options,
                    )  # fmt: skip
                )
                done += 1
        sets.append(ResponseSet(
            oil_temperature=temperature, steps=stepped, sweeps=tuple(swept), chirps=tuple(chirped), dither=dither
        ))  # fmt: skip
    return tuple(sets)


def amplitudes_of(specification: Specification | None) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(steps, sweeps), shares of rated: the usual ones, and those at which a specification has limits."""
    limits = () if specification is None else specification.limits
    asked = {True: set(STEP_AMPLITUDES), False: set(SINE_AMPLITUDES)}
    for limit in limits:
        if "amplitude" in limit.conditions:
            asked[limit.figure in OF_A_STEP].add(limit.conditions["amplitude"])
    return tuple(sorted(asked[True])), tuple(sorted(asked[False]))


def response_tests(
    sets: Sequence[ResponseSet], source: Source, specification: Specification | None = None
) -> list[tuple[str, dict[str, float], FiguresOfMerit]]:
    """Every step and sweep as (title, conditions by the names of a specification's, figures), SI.

    Sweeps also at the single frequencies that a specification has limits at.
    """
    frequencies = () if specification is None else specification.single_frequencies
    supply, back, _ = (float(evaluate(command, 0.0)) for command in held(source).pressures())
    tests = []
    for one in sets:
        at = {"supply_pressure": supply, "return_pressure": back, "oil_temperature": one.oil_temperature}
        at |= one.dither.conditions
        kinds: tuple[tuple[str, Sequence[StepResponse | FrequencyResponse]], ...] = (
            ("step", one.steps), ("sines", one.sweeps)
        )  # fmt: skip
        for what, responses in kinds:
            for test in responses:
                title = f"{what} of {100 * test.share:.0f} % of rated, oil at {one.oil_temperature:g} °C"
                conditions = at | {"amplitude": abs(test.share)}
                tests.append((title, conditions, test.figures))
                if isinstance(test, FrequencyResponse):
                    tests += at_single_frequencies(title, conditions, test, frequencies)
    return tests
