"""What a valve does to a step: figures of merit from a simulated or a measured record (SAE ARP490, ISO 10770-1).

Each figure is computed from plain arrays time, input and output, so that the model and a measured record go through the
same lines; what cannot be had is `Absent`.

Symbols
    u command (current A, or voltage V), y output, s = (y - y_before)/(y_end - y_before) share of a step

Time s, temperatures °C, all else SI."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.dither import NO_DITHER, Dither
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit
from valvesim.characterisation.held_scenario import (
    Source,
    held,
    held_oil_temperature,
    output_of,
    output_unit,
    rated_command,
)
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, ResponseOptions
from valvesim.characterisation.record_checks import checked_record, flat_share
from valvesim.errors import InputError
from valvesim.inputs import Step, evaluate
from valvesim.simulation.run import simulate
from valvesim.units import in_si, reads_units


@dataclass(frozen=True, kw_only=True)
class StepResponse:
    """A step and what came of it: `time`, `command` and `output` are (n_t,) in s, A (or V) and the unit of `channel`.

    `amplitude` is the size of the step, `share` that of the rated command; `oil_temperature` °C.
    """

    amplitude: float
    share: float
    oil_temperature: float
    channel: str
    unit: str
    time: np.ndarray
    command: np.ndarray
    output: np.ndarray

    @property
    def figures(self) -> tuple[FigureOfMerit | Absent, ...]:
        """As `step_figures` gives them."""
        return step_figures(self.time, self.command, self.output, unit=self.unit)


_STEP_DOCS = {
    "time_to_90_percent": "from the step of the command until the output first reaches 90 % of its change",
    "rise_time": "between first reaching 10 % and 90 % of the change",
    "settling_time": "from the step until the output stays within 5 % of its change around its end value",
    "overshoot": "greatest excursion beyond the end value, in percent of the change",
    "dead_time": "from the step until the output first reaches 2 % of its change",
    "mean_rate": "80 % of the change over the rise time: at full steps what the flapper's flow limit allows",
    "change": "output at the end minus output before the step",
}


def step_figures(
    time, command, output, *, unit: str = "1", steady: float | None = None
) -> tuple[FigureOfMerit | Absent, ...]:  # fmt: skip
    """Figures of one step of the command, from arrays (n_t,): time s, command in any unit, output in `unit`.

    With s the share of the output's change (SAE ARP490, ISO 10770-1; the change is from the mean before the step to the
    mean of the last tenth of the record, or to `steady` where that is known):

    - time_to_90_percent, s: from the step until s first reaches 0.9 (the "0-90 % time")
    - rise_time, s: from s = 0.1 to s = 0.9, first crossings
    - settling_time, s: from the step until |s - 1| <= 0.05 for good
    - overshoot, %: 100 (max s - 1), zero where s stays below 1
    - dead_time, s: from the step until s first reaches 0.02
    - mean_rate, unit/s: 0.8 |change|/rise_time
    - change, unit

    The step is where the command passes half of its change: at the later sample where it jumps between two (which is
    exact for `valvesim.Step`; of a measured record it is known to one sample). Crossings of the output are straight
    between samples. Whatever the record cannot give is `Absent` with its reason: no step, fewer than 3 samples before
    it, an output that has not come to rest, never reaches 90 %, is hidden by noise, is clipped, or is sampled at
    fewer than 5 samples on the way to 90 %.
    Raises InputError for lengths that differ, NaN, gaps, and times that do not rise.
    """
    t, u, y = checked_record(time, command, output)
    try:
        start, t_step = _step_instant(t, u)
        before, end = y[:start], y[t >= t[-1] - 0.1 * (t[-1] - t[start])]
        first = float(np.mean(before))
        last = _end_value(before, end) if steady is None else float(steady)
        change, noise = last - first, float(np.std(before))
        if abs(change) <= max(5.0 * noise, 1e-12 * float(np.max(np.abs(y)))):
            raise _Missing("the output does not move beyond its noise")
    except _Missing as missing:
        return tuple(Absent(name, str(missing)) for name in _STEP_DOCS)
    after, s = t[start - 1 :], (y[start - 1 :] - first) / change
    measures: dict[str, tuple[str, Callable[[], float]]] = {
        "time_to_90_percent": ("s", lambda: _reach(after, s, 0.9, t_step) - t_step),
        "rise_time": ("s", lambda: _reach(after, s, 0.9, t_step) - _reach(after, s, 0.1, t_step, fewest=0)),
        "settling_time": ("s", lambda: _settled(after, s) - t_step),
        "overshoot": ("%", lambda: _overshoot(s)),
        "dead_time": ("s", lambda: _dead(after, s, noise / abs(change), t_step) - t_step),
        "mean_rate": (
            f"{unit}/s",
            lambda: 0.8 * abs(change) / (_reach(after, s, 0.9, t_step) - _reach(after, s, 0.1, t_step, fewest=0)),
        ),
        "change": (unit, lambda: change),
    }
    return tuple(_measured(name, unit_, measure) for name, (unit_, measure) in measures.items())


def _measured(name: str, unit: str, measure: Callable[[], float]) -> FigureOfMerit | Absent:
    try:
        return FigureOfMerit(name, float(measure()), unit, _STEP_DOCS[name])
    except _Missing as missing:
        return Absent(name, str(missing))


class _Missing(Exception):
    """Why a figure cannot be had."""


def _step_instant(t: np.ndarray, u: np.ndarray) -> tuple[int, float]:
    """(first sample at which the command has passed half of its one step, time of the step)."""
    if len(u) < 14:
        raise _Missing(f"only {len(u)} samples: 3 before the step and 10 after it are needed")
    head, tail = np.median(u[:3]), np.median(u[-3:])
    size = tail - head
    if abs(size) <= 1e-9 * float(np.max(np.abs(u))):
        raise _Missing("there is no step in the command after its third sample: it ends where it began")
    share = (u - head) / size
    start = int(np.argmax(share >= 0.5))
    if start < 3:
        raise _Missing("fewer than 3 samples before the step: where the output started is not known")
    held = share[min(start + max(3, len(u) // 100), len(u) - 1) :]
    if np.any(np.abs(held - 1.0) > 0.1):
        raise _Missing("the command does not hold after its step: give a record of one step")
    if len(u) - start < 10:
        raise _Missing(f"only {len(u) - start} samples after the step")
    jump = share[start - 1] <= 0.1
    return start, float(t[start]) if jump else _crossing(t, share, 0.5, start)


def _end_value(before: np.ndarray, end: np.ndarray) -> float:
    """The mean of the last tenth, where that rests."""
    if np.ptp(end) == 0.0 and np.ptp(before) > 0.0:
        raise _Missing("the output is clipped: it carries noise before the step and none at its end")
    value, change = float(np.mean(end)), float(np.mean(end) - np.mean(before))
    half = len(end) // 2
    drift = abs(float(np.mean(end[half:]) - np.mean(end[:half]))) if half else 0.0
    swing = float(np.ptp(end)) / 2.0 - 4.0 * float(np.std(before))
    if drift > 0.01 * abs(change) + 2.0 * np.std(before) / np.sqrt(max(half, 1)) or swing > 0.05 * abs(change):
        raise _Missing("the output has not come to rest in the last tenth of the record: its change is not known")
    return value


def _crossing(t: np.ndarray, s: np.ndarray, level: float, k: int) -> float:
    """Where s passes `level` between the samples k - 1 and k, on a straight line."""
    return float(t[k - 1] + (level - s[k - 1]) / (s[k] - s[k - 1]) * (t[k] - t[k - 1]))


def _reach(t: np.ndarray, s: np.ndarray, level: float, t_step: float, *, fewest: int = 5) -> float:
    """The first time at which s reaches `level`."""
    reached = np.flatnonzero((s >= level) & (t >= t_step))
    if not len(reached):
        raise _Missing(f"the output never reaches {100 * level:g} % of its change (greatest {100 * np.max(s):.3g} %)")
    k = int(reached[0])
    samples = int(np.sum((t > t_step) & (t <= t[k])))
    if samples < fewest:
        raise _Missing(f"only {samples} samples between the step and {100 * level:g} %: {fewest} are needed")
    return _crossing(t, s, level, k) if k and s[k - 1] < level else float(t[k])


def _settled(t: np.ndarray, s: np.ndarray) -> float:
    outside = np.flatnonzero(np.abs(s - 1.0) > 0.05)
    if outside[-1] == len(s) - 1:
        raise _Missing("the output is outside 5 % of its end value when the record ends")
    k = int(outside[-1]) + 1
    return _crossing(t, np.abs(s - 1.0), 0.05, k)


def _overshoot(s: np.ndarray) -> float:
    top = float(np.max(s))
    below, k = s < 1.0 + 0.5 * (top - 1.0), int(np.argmax(s))
    peak = s[k - int(np.argmax(below[k::-1])) : k + int(np.argmax(below[k:]))]  # the upper half of the highest peak
    if top > 1.01 and flat_share(peak, top) > 0.4:
        raise _Missing("the output is clipped at its peak: it rests there at one value")
    return max(100.0 * (top - 1.0), 0.0)


def _dead(t: np.ndarray, s: np.ndarray, noise: float, t_step: float) -> float:
    if 4.0 * noise > 0.02:
        raise _Missing(f"the noise ({100 * noise:.2g} % of the change) hides where the output starts")
    return _reach(t, s, 0.02, t_step, fewest=1)


@reads_units(oil_temperature="degC", part_temperature="degC", duration="s", output_rate="Hz")
def step_response(
    source: Source, *, amplitude: float, oil_temperature: float | None = None, part_temperature: float | None = None,
    output: str = "spool_position", bias: float = 0.0, duration: float = 0.06, output_rate: float = 100e3,
    dither: Dither = NO_DITHER, options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
) -> StepResponse:  # fmt: skip
    """Simulate a step of the command from `bias` by `amplitude` (A, or V of a scenario that is driven by voltage).

    `source` is a valve or a scenario whose oil, pressures, drive, thermal state and effects act (see `held`); the step
    is 2 ms after the start and `duration` s of it are recorded. `output` is any channel of a result. A `dither` has
    acted for `dither_time` s before; command and output are told without its sine.
    Raises InputError for an amplitude of zero or NaN, an unknown channel, and as `simulate` does.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    amplitude, bias = (in_si(each, base.drive.command_unit, "step response") for each in (amplitude, bias))
    if not np.isfinite(amplitude) or amplitude == 0.0:
        raise InputError(f"step response: amplitude = {amplitude:g} must be a number other than zero")
    unit = output_unit(base, output)
    wait = options.dither_time if dither.amplitude else 0.0
    step = Step(before=bias, after=bias + amplitude, time=wait + 0.002)
    command = dither.upon(step, rated_command(base))
    result = simulate(replace(base, command=command, duration=wait + 0.002 + duration, output_rate=output_rate))
    part = slice(round(wait * output_rate), None)
    last = slice(-int(duration / 2.0 * output_rate), None)
    told = dither.taken_off(result.time, output_of(result, output), last)
    return StepResponse(
        amplitude=amplitude,
        share=amplitude / rated_command(base),
        oil_temperature=held_oil_temperature(base),
        channel=output,
        unit=unit,
        time=result.time[part] - result.time[part][0],
        command=evaluate(step, result.time + 0.5 / output_rate)[part],  # at the step itself its value after it
        output=told[part],
    )
