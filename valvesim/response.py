"""What a valve does to a step, a sine and a chirp: figures of merit from a simulated or a measured record.

The figures are those of SAE ARP490 and ISO 10770-1 (field.md section 4). Each is computed from plain arrays time,
input and output, so that the model and a bench record go through the same lines; what cannot be had is `Absent`.

Symbols
    u input (current A, or voltage V), y output, s = (y - y_before)/(y_end - y_before) share of a step
    f frequency Hz, H(f) complex gain output/input: |H| relative to its lowest frequency in dB, phase lag = -arg H
    THD harmonic distortion: root of the summed squares of harmonics 2 to 5 over the fundamental
    gamma^2 coherence: share of the output's power that the input explains linearly

Amplitudes are peak, from the mean. Time s, temperatures °C, all else SI; angles of the phase in degrees by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .commands import Chirp, Command, Constant, Sine, Step, evaluate
from .errors import InputError, unknown_name
from .figures import Absent, Figure
from .model import VoltageDrive, drive_torque
from .parameters import PartTemperatures, Valve
from .scenario import Scenario, Thermal
from .simulate import Result, output_channels, simulate
from .static import solve_rest
from .thermal import ThermalNetwork
from .units import quantities

SAMPLES_A_CYCLE = 64  # of a simulated sine
SETTLE_TIME = 0.05  # s of a sine before it is read: the slowest mode of the reference valve is 1/1070 s
READ_TIME = 0.02  # s of a sine that are read at least, in whole cycles
HARMONICS = 5  # the highest in the distortion
FEWEST_A_CYCLE = 6  # samples, for the fundamental; the harmonics need more than twice their number
SINE_TOLERANCE = 1e-5  # of the integration: its error shows as a distortion of about 1e-7
CHIRP_REST = 0.5  # s before and after a simulated chirp: the length of a window, which tapers its ends
LEAST_COHERENCE = 0.8  # below it a point serves no figure
EXCITED = 1e-3  # share of the input's greatest power density above which a frequency counts as excited
FREQUENCIES = tuple(np.geomspace(5.0, 500.0, 41))  # Hz, six to the octave
STEPS, SWEEPS = (0.05, 0.25, 1.0), (0.25, 0.4, 1.0)  # shares of the rated current

Source = Valve | Scenario


# ---------------------------------------------------------------- step


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
    def figures(self) -> tuple[Figure | Absent, ...]:
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
) -> tuple[Figure | Absent, ...]:  # fmt: skip
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
    t, u, y = _record(time, command, output)
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


def _measured(name: str, unit: str, measure: Callable[[], float]) -> Figure | Absent:
    try:
        return Figure(name, float(measure()), unit, _STEP_DOCS[name])
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
    if top > 1.01 and _flat_share(peak, top) > 0.4:
        raise _Missing("the output is clipped at its peak: it rests there at one value")
    return max(100.0 * (top - 1.0), 0.0)


def _dead(t: np.ndarray, s: np.ndarray, noise: float, t_step: float) -> float:
    if 4.0 * noise > 0.02:
        raise _Missing(f"the noise ({100 * noise:.2g} % of the change) hides where the output starts")
    return _reach(t, s, 0.02, t_step, fewest=1)


def step_response(
    source: Source, *, amplitude: float, oil_temperature: float | None = None, part_temperature: float | None = None,
    output: str = "spool_position", bias: float = 0.0, duration: float = 0.06, output_rate: float = 100e3,
) -> StepResponse:  # fmt: skip
    """Simulate a step of the command from `bias` by `amplitude` (A, or V of a scenario that is driven by voltage).

    `source` is a valve or a scenario whose oil, pressures, drive, thermal state and effects act (see `held`); the step
    is 2 ms after the start and `duration` s of it are recorded. `output` is any channel of a result.
    Raises InputError for an amplitude of zero or NaN, an unknown channel, and as `simulate` does.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    if not np.isfinite(amplitude) or amplitude == 0.0:
        raise InputError(f"step response: amplitude = {amplitude:g} must be a number other than zero")
    unit = _unit_of(base, output)
    command = Step(before=bias, after=bias + amplitude, time=0.002)
    result = simulate(replace(base, command=command, duration=0.002 + duration, output_rate=output_rate))
    return StepResponse(
        amplitude=amplitude,
        share=amplitude / rated_command(base),
        oil_temperature=_oil_temperature(base),
        channel=output,
        unit=unit,
        time=result.time,
        command=_command_of(result),
        output=result.values[output],
    )


# ---------------------------------------------------------------- frequency response


@dataclass(frozen=True, kw_only=True)
class SinePoint:
    """One steady sine: `gain` is the complex ratio of the fundamentals of output and input.

    `distortion` is THD of the output as a share (NaN with too few samples a cycle), `residual` what neither the
    fundamental nor harmonics 2 to 5 explain (noise, drift, an unsteady state), rms over that of the fundamental.
    """

    frequency: float
    gain: complex
    distortion: float
    residual: float
    input_amplitude: float
    output_amplitude: float


@dataclass(frozen=True, kw_only=True)
class FrequencyResponse:
    """Complex gain over frequency: all arrays (n_f,); `gain` in output unit per input unit.

    `amplitude` is that of the input (`share` of rated), `method` how it was taken, `oil_temperature` °C; NaN where a
    measured record does not tell them. `distortion` and `residual` (see `SinePoint`) are NaN for a chirp, `coherence`
    for sines.
    """

    method: str
    amplitude: float
    share: float
    oil_temperature: float
    channel: str
    frequency: np.ndarray
    gain: np.ndarray
    distortion: np.ndarray
    residual: np.ndarray
    coherence: np.ndarray

    @property
    def credible(self) -> np.ndarray:
        """Points whose coherence, where there is one, is at least `LEAST_COHERENCE`; (n_f,) of bool."""
        return ~(self.coherence < LEAST_COHERENCE)

    @property
    def amplitude_ratio(self) -> np.ndarray:
        """Amplitude ratio relative to the lowest credible frequency, dB (ISO 10770-1); (n_f,)."""
        return 20.0 * np.log10(np.abs(self.gain) / np.abs(self.gain[int(np.argmax(self.credible))]))

    @property
    def phase_lag(self) -> np.ndarray:
        """Phase of the output behind the input, degrees, unwrapped from -90 to 270 at the lowest frequency; (n_f,)."""
        lag = np.rad2deg(-np.unwrap(np.angle(self.gain)))
        return lag + 360.0 * (lag[0] < -90.0)

    @property
    def figures(self) -> tuple[Figure | Absent, ...]:
        """Figures of merit (SAE ARP490, ISO 10770-1), on a monotone cubic over log f between the points.

        - frequency_minus_3_db, Hz: where the amplitude ratio first falls to -3 dB of that at the lowest frequency
        - frequency_minus_90_deg, Hz: where the phase lag first reaches 90 degrees
        - resonant_peak, dB: greatest amplitude ratio, 0 where it only falls
        - largest_distortion, %: greatest THD of the output over the frequencies
        """
        return (
            self._cross("frequency_minus_3_db", -self.amplitude_ratio, 3.0, "dB", "amplitude ratio at -3 dB"),
            self._cross("frequency_minus_90_deg", self.phase_lag, 90.0, "degrees", "phase lag at 90 degrees"),
            self._peak(),
            self._distortion(),
        )

    def _cross(self, name: str, fall: np.ndarray, level: float, unit: str, doc: str) -> Figure | Absent:
        """Where `fall` first rises through `level`, on the credible points."""
        if not np.any(self.credible):
            return Absent(name, f"the coherence is below {LEAST_COHERENCE:g} at every frequency")
        f, fall, count = self.frequency[self.credible], fall[self.credible], np.flatnonzero(self.credible)
        beyond = np.flatnonzero(fall >= level)
        if not len(beyond):
            return Absent(name, f"not reached up to {f[-1]:.4g} Hz (there {fall[-1]:.3g} of {level:g} {unit})")
        k = int(beyond[0])
        if k == 0:
            return Absent(
                name, f"already {fall[0]:.4g} {unit} at the lowest frequency of {f[0]:.4g} Hz: start lower, and see "
                "that the output has the sign of the input"
            )  # fmt: skip
        if count[k] - count[k - 1] > 1 and f[k] > 1.1 * f[k - 1]:
            return Absent(name, f"the coherence is below {LEAST_COHERENCE:g} between {f[k - 1]:.4g} and {f[k]:.4g} Hz")
        return Figure(name, _first_root(np.log(f), fall, level, k), "Hz", doc)

    def _peak(self) -> Figure | Absent:
        if not np.any(self.credible):
            return Absent("resonant_peak", f"the coherence is below {LEAST_COHERENCE:g} at every frequency")
        top = float(np.max(self.amplitude_ratio[self.credible]))
        return Figure("resonant_peak", max(top, 0.0), "dB", "greatest amplitude ratio")

    def _distortion(self) -> Figure | Absent:
        if not np.any(np.isfinite(self.distortion)):
            chirp = bool(np.any(np.isfinite(self.coherence)))
            why = "a chirp does not tell harmonics apart" if chirp else "it needs more than 10 samples a cycle"
            return Absent("largest_distortion", f"{why}: take steady sines")
        doc = "greatest harmonic distortion (harmonics 2 to 5)"
        return Figure("largest_distortion", 100.0 * float(np.nanmax(self.distortion)), "%", doc)


def _first_root(x: np.ndarray, y: np.ndarray, level: float, k: int) -> float:
    """exp of where a monotone cubic through (x, y) passes `level` between the points k - 1 and k."""
    from scipy.interpolate import PchipInterpolator

    near = slice(max(k - 3, 0), k + 3)
    roots = PchipInterpolator(x[near], y[near]).solve(level, extrapolate=False)
    return float(np.exp(next(root for root in roots if x[k - 1] <= root <= x[k])))


def sine_point(
    time, command, output, *, frequency: float | None = None, allow_flat: bool = False
) -> SinePoint:  # fmt: skip
    """Gain and distortion from the record of one steady sine, arrays (n_t,): time s, command and output.

    Least squares of offset, sine and cosine of the fundamental and of harmonics 2 to 5 on the last whole cycles, of
    command and output alike. `frequency` (Hz) is found from the command where it is not given. Sampling need not be
    even. Cut off the part in which the sine settles.
    Raises InputError for lengths that differ, NaN, gaps, no complete cycle, fewer than 6 samples a cycle, a command
    that is no sine of that frequency, and an output that rests at its extremes (clipped, saturated or stuck; let it
    pass with `allow_flat`).
    """
    t, u, y = _record(time, command, output)
    if frequency is None:
        frequency = _find_frequency(t, u)
    _check_frequencies(np.array([frequency]))
    if not allow_flat and (share := _flat_share(y, float(np.max(y)), float(np.min(y)))) > _flat_of_a_sine(y):
        raise InputError(
            f"sine record: the output rests at its extreme for {100 * share:.3g} % of the record: clipped by the "
            "measuring channel, saturated or stuck; lower the amplitude or widen the range"
        )
    return _sine_point(t, u, y, frequency)


def _sine_point(t: np.ndarray, u: np.ndarray, y: np.ndarray, frequency: float) -> SinePoint:
    interval = float(np.median(np.diff(t)))
    span = t[-1] - t[0] + interval
    cycles, per_cycle = int(np.floor(span * frequency * (1.0 + 1e-6))), 1.0 / (frequency * interval)
    if cycles < 1:
        raise InputError(
            f"sine record: no complete cycle: {span:.4g} s hold {span * frequency:.2g} of a cycle at {frequency:.4g} Hz"
        )
    if per_cycle < FEWEST_A_CYCLE * (1.0 - 1e-6):
        raise InputError(
            f"sine record: {per_cycle:.3g} samples a cycle at {frequency:.4g} Hz are too few: {FEWEST_A_CYCLE} for the "
            f"fundamental, more than {2 * HARMONICS} for the distortion; sample faster than "
            f"{FEWEST_A_CYCLE * frequency:.4g} Hz"
        )
    count = HARMONICS if per_cycle > 2 * HARMONICS else 1
    keep = t > t[-1] + interval / 2.0 - cycles / frequency
    angle = 2.0 * np.pi * frequency * np.outer(t[keep], np.arange(1, count + 1))
    basis = np.column_stack([np.ones(int(keep.sum())), np.cos(angle), np.sin(angle)])
    weights, *_ = np.linalg.lstsq(basis, np.column_stack([u[keep], y[keep]]), rcond=None)
    phasors = weights[1 : count + 1] - 1j * weights[count + 1 :]  # (harmonics, 2): y = Re sum Y_k exp(j k w t)
    left = np.std(np.column_stack([u[keep], y[keep]]) - basis @ weights, axis=0) * np.sqrt(2.0)
    first = np.abs(phasors[0])
    if first[0] <= 1e-12 * max(float(np.max(np.abs(u))), 1e-300) or _harmonic_share(phasors[:, 0]) > 0.1:
        raise InputError(f"sine record: the command is no sine at {frequency:.4g} Hz (constant, clipped or another)")
    if left[0] > 0.3 * first[0]:
        raise InputError(f"sine record: the command is no steady sine at {frequency:.4g} Hz alone")
    moves = first[1] > 0.0
    return SinePoint(
        frequency=float(frequency),
        gain=complex(phasors[0, 1] / phasors[0, 0]),
        distortion=_harmonic_share(phasors[:, 1]) if count > 1 and moves else float("nan"),
        residual=float(left[1] / first[1]) if moves else float("nan"),
        input_amplitude=float(first[0]),
        output_amplitude=float(first[1]),
    )


def _harmonic_share(phasors: np.ndarray) -> float:
    return float(np.linalg.norm(phasors[1:]) / np.abs(phasors[0])) if len(phasors) > 1 else 0.0


def _find_frequency(t: np.ndarray, u: np.ndarray) -> float:
    """The frequency of a sine, Hz: the strongest line of its spectrum, then least squares around that."""
    from scipy.optimize import minimize_scalar

    even = np.linspace(t[0], t[-1], len(t))
    x = np.interp(even, t, u - u.mean())
    if np.ptp(x) <= 1e-9 * float(np.max(np.abs(u))):
        raise InputError("sine record: the command does not move")
    spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x)), 4 * len(x)))
    line, width = 1.0 / (t[-1] - t[0]), 0.75
    guess = (1 + int(np.argmax(spectrum[1:]))) * line * (len(t) - 1) / (4 * len(t))

    def misfit(f: float) -> float:
        angle = 2.0 * np.pi * f * (t - t[0])
        basis = np.column_stack([np.ones_like(t), np.cos(angle), np.sin(angle)])
        return float(np.sum((u - basis @ np.linalg.lstsq(basis, u, rcond=None)[0]) ** 2))

    low, high = max(guess - width * line, 0.05 * line), guess + width * line
    return float(minimize_scalar(misfit, bounds=(low, high), method="bounded", options={"xatol": 1e-7 * high}).x)


def join_points(
    points: Sequence[SinePoint], *, channel: str = "output", share: float = float("nan"),
    oil_temperature: float = float("nan"),
) -> FrequencyResponse:  # fmt: skip
    """A frequency response from steady sines, simulated or measured, in any order; InputError for fewer than two."""
    ordered = sorted(points, key=lambda point: point.frequency)
    frequency = np.array([point.frequency for point in ordered])
    if len(frequency) < 2 or np.any(np.diff(frequency) <= 0.0):
        raise InputError("frequency response: needs two or more sines, each of a frequency of its own")
    return FrequencyResponse(
        method="stepped sines",
        amplitude=float(np.mean([point.input_amplitude for point in ordered])),
        share=share,
        oil_temperature=oil_temperature,
        channel=channel,
        frequency=frequency,
        gain=np.array([point.gain for point in ordered]),
        distortion=np.array([point.distortion for point in ordered]),
        residual=np.array([point.residual for point in ordered]),
        coherence=np.full(len(ordered), np.nan),
    )


def frequency_response(
    source: Source, *, amplitude: float, frequencies: Sequence[float] = FREQUENCIES,
    oil_temperature: float | None = None, part_temperature: float | None = None, output: str = "spool_position",
    bias: float = 0.0, cycles: int = 2, settle: float = SETTLE_TIME, workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> FrequencyResponse:  # fmt: skip
    """Stepped sines: at each frequency (Hz) the valve is driven from rest until it is steady, then read.

    The command is bias + amplitude sin(2 pi f t) in A (or V); `settle` s (and at least a cycle) pass before at least
    `cycles` whole cycles and 20 ms are read at 64 samples a cycle. `source`, temperatures and `output` as in
    `step_response`. Frequencies run on `workers` threads: one, since a run of milliseconds holds the interpreter's lock
    for most of its time (two were slower, measured). `progress` is told the share that is done.
    Amplitudes beyond the rated command are allowed, with a ValidityWarning.
    Raises InputError for an amplitude or frequency that is not positive, fewer than two frequencies, or one given
    twice, and as `simulate` does.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    f = _check_frequencies(np.asarray(frequencies, dtype=float))
    if len(f) < 2:
        raise InputError("frequency response: needs two or more frequencies, the lowest as the reference")
    _check_amplitude(amplitude)
    _unit_of(base, output)
    for name, number in (("cycles", cycles), ("workers", workers)):
        if number < 1 or number != int(number):
            raise InputError(f"frequency response: {name} = {number:g} must be a whole number of 1 or more")
    base = replace(base, tolerance=min(base.tolerance, SINE_TOLERANCE))

    def point(frequency: float) -> SinePoint:
        wait = max(int(np.ceil(settle * frequency)), 1)
        read = max(int(cycles), int(np.ceil(READ_TIME * frequency)))
        command = Sine(amplitude=amplitude, frequency=frequency, offset=bias)
        rate = SAMPLES_A_CYCLE * frequency
        result = simulate(replace(base, command=command, duration=(wait + read) / frequency, output_rate=rate))
        part = slice(-SAMPLES_A_CYCLE * read, None)
        return _sine_point(result.time[part], _command_of(result)[part], result.values[output][part], frequency)

    points = []
    with ThreadPoolExecutor(workers) as pool:
        for done in pool.map(point, f):
            points.append(done)
            if progress is not None:
                progress(len(points) / len(f))
    share = amplitude / rated_command(base)
    joined = join_points(points, channel=output, share=share, oil_temperature=_oil_temperature(base))
    return replace(joined, amplitude=amplitude)


def spectral_response(
    time, command, output, *, low: float | None = None, high: float | None = None, resolution: float | None = None,
    channel: str = "output", share: float = float("nan"), oil_temperature: float = float("nan"),
) -> FrequencyResponse:  # fmt: skip
    """Frequency response from the record of one chirp (or noise), arrays (n_t,): time s, command and output.

    H = P_uy/P_uu from averaged cross- and power spectra (Welch: Hann windows of 1/`resolution` s, three quarters
    overlapping; by default 24 windows' worth, at most 2 Hz), with the coherence |P_uy|^2/(P_uu P_yy). Given are the
    frequencies that the command excites (power density above 1e-3 of its greatest), within `low` to `high` Hz.
    A point of low coherence (noise, or a nonlinear valve) serves no figure. Gain and phase are good for delays well
    below the window's length, and at the ends of the band where the record rests for a window's length before and after
    the chirp. Source: Bendat and Piersol, Random Data, ch. 6.
    Raises InputError for lengths that differ, NaN, gaps, a command that does not move, a clipped output, a band that
    holds fewer than three points, and fewer than 6 samples a cycle at `high`.
    """
    from scipy import signal

    t, u, y = _record(time, command, output)
    span = t[-1] - t[0]
    rate = (len(t) - 1) / span
    if np.ptp(u) <= 1e-9 * float(np.max(np.abs(u))):
        raise InputError("chirp record: the command does not move")
    if (flat := _flat_share(y, float(np.max(y)), float(np.min(y)))) > _flat_of_a_sine(y):
        raise InputError(f"chirp record: the output rests at its extreme for {100 * flat:.3g} %: clipped or saturated")
    for name, value in (("low", low), ("high", high), ("resolution", resolution)):
        if value is not None and not 0.0 < value < np.inf:
            raise InputError(f"chirp record: {name} = {value:g} Hz must be positive")
    if high is not None and rate < FEWEST_A_CYCLE * high:
        raise InputError(
            f"chirp record: {rate / high:.3g} samples a cycle at {high:.4g} Hz are too few: {FEWEST_A_CYCLE} are needed"
        )
    even = np.linspace(t[0], t[-1], len(t))
    u, y = np.interp(even, t, u), np.interp(even, t, y)
    width = max(24.0 / span, min(2.0, 100.0 / span)) if resolution is None else resolution
    window = int(round(rate / width))
    if window > len(t) // 2 or window < 16:
        raise InputError(
            f"chirp record: a resolution of {width:.3g} Hz makes windows of {window} of its {len(t)} samples; between "
            "16 and half of the record are needed"
        )
    options: Any = {"fs": rate, "window": "hann", "nperseg": window, "noverlap": 3 * window // 4}
    f, P_uu = signal.welch(u, **options)
    _, P_yy = signal.welch(y, **options)
    _, P_uy = signal.csd(u, y, **options)
    inside = (f >= max(2.0 * width, low or 0.0)) & (f <= min(rate / FEWEST_A_CYCLE, high or np.inf))
    inside &= P_uu > EXCITED * np.max(P_uu)
    if int(inside.sum()) < 3:
        raise InputError(
            f"chirp record: the command excites fewer than three points between {low or f[1]:.4g} and "
            f"{high or f[-1]:.4g} Hz at {width:.3g} Hz of resolution: record longer, or name another band"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.where(P_yy > 0.0, np.abs(P_uy) ** 2 / (P_uu * P_yy), 0.0)
    return FrequencyResponse(
        method="chirp",
        amplitude=float(np.ptp(u)) / 2.0,
        share=share,
        oil_temperature=oil_temperature,
        channel=channel,
        frequency=f[inside],
        gain=(P_uy / P_uu)[inside],
        distortion=np.full(int(inside.sum()), np.nan),
        residual=np.full(int(inside.sum()), np.nan),
        coherence=coherence[inside],
    )


def chirp_response(
    source: Source, *, amplitude: float, low: float = 5.0, high: float = 500.0, duration: float = 6.0,
    oil_temperature: float | None = None, part_temperature: float | None = None, output: str = "spool_position",
    bias: float = 0.0, progress: Callable[[float], None] | None = None,
) -> FrequencyResponse:  # fmt: skip
    """Simulate one chirp, even in hertz from `low`/5 to 1.1 `high` Hz, and take its `spectral_response`.

    A rest of `CHIRP_REST` s stands before and after it. Sampled at 20 samples a cycle of the highest frequency. Other
    arguments as in `frequency_response`.
    Raises InputError for a band that does not rise, an amplitude that is not positive, and as `spectral_response`.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    _check_amplitude(amplitude)
    _check_frequencies(np.array([low, high]))
    _unit_of(base, output)
    if low >= high:
        raise InputError(f"chirp response: low = {low:g} Hz must be below high = {high:g} Hz")
    start, end = low / 5.0, 1.1 * high
    command = Chirp(
        amplitude=amplitude, start_frequency=start, end_frequency=end, duration=duration, offset=bias, time=CHIRP_REST
    )
    case = replace(base, command=command, duration=duration + 2.0 * CHIRP_REST, output_rate=20.0 * end)
    result = simulate(case, progress=progress)
    taken = spectral_response(
        result.time, _command_of(result), result.values[output], low=low, high=high, channel=output,
        share=amplitude / rated_command(base), oil_temperature=_oil_temperature(base),
    )  # fmt: skip
    return replace(taken, amplitude=amplitude)


# ---------------------------------------------------------------- what is tested, and at which temperatures


def held(
    source: Source, *, oil_temperature: float | None = None, part_temperature: float | None = None
) -> Scenario:  # fmt: skip
    """The scenario that a response test starts from: temperatures and pressures held as they are at its time zero.

    A valve alone is isothermal. A scenario keeps its oil, drive, routes and effects; its parts stay where its
    `thermal` has them at the start (its `initial_temperature`, or the oil's), since a test is over before they follow.
    `oil_temperature` and `part_temperature` (all parts, °C) replace what the source has.
    Raises InputError for a batch of valves.
    """
    base = source if isinstance(source, Scenario) else Scenario(valve=source, thermal=Thermal(network=None))
    if any(np.ndim(getattr(base.valve, name)) for name in quantities(base.valve)):
        raise InputError("response: the valve holds arrays (a batch); give one valve at a time")
    oil = float(evaluate(base.oil_temperature, 0.0)) if oil_temperature is None else float(oil_temperature)
    thermal = base.thermal
    if part_temperature is not None:
        thermal = replace(thermal, network=_STILL, initial_temperature=part_temperature)
    elif thermal.network is not None:
        thermal = replace(thermal, network=_STILL)
    supply, back, load = (_first(command) for command in base.pressures())
    return replace(
        base, thermal=thermal, oil_temperature=Constant(value=oil), supply_pressure=supply, return_pressure=back,
        load_pressure=load, channels=(),
    )  # fmt: skip


_STILL = ThermalNetwork(**{name: 0.0 for name in quantities(ThermalNetwork) if "_to_" in name})
"""No conductance: every part stays at the temperature it starts with."""


def _first(command: Command) -> Constant:
    return Constant(value=float(evaluate(command, 0.0)))


def rated_command(base: Scenario) -> float:
    """The rated current, A; of a drive by voltage the voltage that holds it at 20 °C, V."""
    rated = float(base.valve.rated_current)
    return rated * float(base.valve.coil_resistance) if isinstance(base.drive, VoltageDrive) else rated


def _oil_temperature(base: Scenario) -> float:
    return float(evaluate(base.oil_temperature, 0.0))


def _command_of(result: Result) -> np.ndarray:
    return result.values["voltage" if isinstance(result.scenario.drive, VoltageDrive) else "current"]


def _unit_of(base: Scenario, output: str) -> str:
    units = {channel.name: channel.unit for channel in output_channels(base)}
    if output not in units:
        raise unknown_name("channel", output, units, "output")
    return units[output]


@dataclass(frozen=True, kw_only=True)
class ResponseSet:
    """Every response of a valve at one oil temperature: one of each kind for every amplitude."""

    oil_temperature: float
    steps: tuple[StepResponse, ...]
    sweeps: tuple[FrequencyResponse, ...]
    chirps: tuple[FrequencyResponse, ...]


def measure_responses(
    source: Source, *, oil_temperatures: Sequence[float] | None = None, part_temperature: float | None = None,
    steps: Sequence[float] = STEPS, sweeps: Sequence[float] = SWEEPS, frequencies: Sequence[float] = FREQUENCIES,
    chirp: bool = True, output: str = "spool_position", workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> tuple[ResponseSet, ...]:  # fmt: skip
    """Steps, stepped sines and chirps at every oil temperature (°C; by default the source's own at its start).

    `steps` and `sweeps` are shares of the rated command. Raises as `step_response` and `frequency_response` do.
    """
    first = held(source, part_temperature=part_temperature)
    rated = rated_command(first)
    temperatures = [_oil_temperature(first)] if oil_temperatures is None else [float(t) for t in oil_temperatures]
    kinds = 2 if chirp else 1
    total, done = max(len(temperatures) * len(sweeps) * kinds, 1), 0

    def tell(part: float) -> None:
        if progress is not None:
            progress(min((done + part) / total, 1.0))

    sets = []
    for temperature in temperatures:
        base = held(source, oil_temperature=temperature, part_temperature=part_temperature)
        stepped = tuple(step_response(base, amplitude=share * rated, output=output) for share in steps)
        swept, chirped = [], []
        for share in sweeps:
            swept.append(
                frequency_response(
                    base,
                    amplitude=share * rated,
                    frequencies=frequencies,
                    output=output,
                    workers=workers,
                    progress=tell,
                )  # fmt: skip
            )
            done += 1
            if chirp:
                band = {"low": float(np.min(frequencies)), "high": float(np.max(frequencies))}
                chirped.append(
                    chirp_response(
                        base, amplitude=share * rated, low=band["low"], high=band["high"], output=output, progress=tell
                    )
                )
                done += 1
        sets.append(ResponseSet(oil_temperature=temperature, steps=stepped, sweeps=tuple(swept), chirps=tuple(chirped)))
    return tuple(sets)


# ---------------------------------------------------------------- published figures of the class


@dataclass(frozen=True)
class ClassFigure:
    """A published figure of a valve of this class: `low` to `high` (equal for one value), and where it stands."""

    name: str
    low: float
    high: float
    unit: str
    source: str


_TYPICAL = "typical limit of the class, field.md section 4; not checked against a vendor's sheet"
_NASA = "NASA TN D-5388 (1969), Table I"


def class_figures() -> tuple[ClassFigure, ...]:
    """Published dynamic figures of valves of this class (field.md sections 1 and 4), by the names of the computed."""
    return (
        ClassFigure("armature_frequency", 730.0, 730.0, "Hz", _NASA),
        ClassFigure("loop_gain", 837.0, 837.0, "1/s", "computed from " + _NASA),
        ClassFigure("speed_limit", 0.18, 0.18, "m/s", "computed from " + _NASA + ": stroke of the flapper"),
        ClassFigure("frequency_minus_3_db", 60.0, 250.0, "Hz", _TYPICAL + "; at 25 % of rated"),
        ClassFigure("frequency_minus_90_deg", 60.0, 250.0, "Hz", _TYPICAL + "; at 25 % of rated"),
        ClassFigure("time_to_90_percent", 2e-3, 10e-3, "s", _TYPICAL),
        ClassFigure("overshoot", 0.0, 25.0, "%", _TYPICAL),
    )


def beside_class(source: Source, one: ResponseSet) -> tuple[tuple[ClassFigure, Figure | Absent], ...]:
    """Each published figure of the class with the valve's own: its lumps, its largest step, its sweep next to 25 %.

    Figures that the set has no test for are `Absent`. Raises as `lumped_figures` does.
    """
    own: dict[str, Figure | Absent] = {f.name: f for f in lumped_figures(source, oil_temperature=one.oil_temperature)}
    if one.sweeps:
        own.update({f.name: f for f in min(one.sweeps, key=lambda sweep: abs(sweep.share - 0.25)).figures})
    if one.steps:
        own.update({f.name: f for f in max(one.steps, key=lambda step: abs(step.share)).figures})
    return tuple((f, own.get(f.name, Absent(f.name, "no test of the set gives it"))) for f in class_figures())


def lumped_figures(source: Source, *, oil_temperature: float | None = None) -> tuple[Figure, ...]:
    """The valve's own lumps at null, as NASA TN D-5388 defines them, to set beside `class_figures`.

    With K = K_s - dT_d/dtheta the net stiffness of tube and magnets and Q = pi d_n C_df sqrt(2 (p_1 - p_0)/rho) the
    flow of a nozzle per flapper displacement:

    - armature_frequency, Hz: sqrt(K/J)/(2 pi)
    - loop_gain, 1/s: Q K_f (r + b) r/(A_v K), of flapper, spool and feedback rod
    - speed_limit, m/s: Q x_f0/A_v, of the spool with the flapper on a nozzle, at the chambers' pressures of null

    Valid for a valve with (nearly) equal sides. Raises as `static_solution` does.
    """
    base = held(source, oil_temperature=oil_temperature)
    T = _oil_temperature(base)
    parts = base.thermal.initial_temperature if base.thermal.network is not None else None
    temperatures = replace(PartTemperatures.uniform(T if parts is None else parts), oil=T)
    c = base.valve.at(temperatures, oil=base.oil, routes=base.thermal.routes)
    pressures = [float(evaluate(command, 0.0)) for command in base.pressures()]
    rest = solve_rest(c, np.asarray(0.0), T, *pressures)
    theta, turn = float(rest.armature_angle), 1e-6
    magnetic = (drive_torque(theta + turn, 0.0, c) - drive_torque(theta - turn, 0.0, c)) / (2.0 * turn)
    stiffness = float(c.spring_tube_stiffness - magnetic)
    drop = (rest.nozzle_pressure_1 + rest.nozzle_pressure_2) / 2.0 - pressures[1]
    flow = float(np.pi * c.nozzle_diameter_1 * c.nozzle_flow_coefficient * np.sqrt(2.0 * drop / c.density))
    arms = c.feedback_rod_stiffness * (c.nozzle_arm + c.feedback_arm) * c.nozzle_arm
    frequency = float(np.sqrt(stiffness / c.armature_inertia)) / (2.0 * np.pi)
    return (
        Figure("armature_frequency", frequency, "Hz", "armature on spring tube and magnets"),
        Figure("loop_gain", float(flow * arms / (c.spool_area * stiffness)), "1/s", "flapper, spool and feedback rod"),
        Figure("speed_limit", float(flow * c.null_gap_1 / c.spool_area), "m/s", "spool with the flapper on a nozzle"),
    )


# ---------------------------------------------------------------- checks of records


def _record(time, command, output) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three arrays (n_t,) of a record that has no gap."""
    t, u, y = (np.asarray(values, dtype=float) for values in (time, command, output))
    if t.ndim != 1 or t.shape != u.shape or t.shape != y.shape:
        raise InputError(f"record: time {t.shape}, command {u.shape} and output {y.shape} must be rows of one length")
    if len(t) < 3:
        raise InputError(f"record: {len(t)} samples are too few")
    for name, values in (("time", t), ("command", u), ("output", y)):
        if (bad := ~np.isfinite(values)).any():
            raise InputError(f"record: gap in the {name}: sample {int(np.argmax(bad)) + 1} is not a finite number")
    intervals = np.diff(t)
    if (falls := intervals <= 0.0).any():
        k = int(np.argmax(falls)) + 1
        raise InputError(f"record: times must rise, but sample {k + 1} ({t[k]:.6g} s) does not follow {t[k - 1]:.6g} s")
    usual = float(np.median(intervals))
    if (wide := intervals > 1.5 * usual).any():
        k = int(np.argmax(wide))
        raise InputError(
            f"record: gap of {intervals[k]:.4g} s after {t[k]:.6g} s, where samples are {usual:.4g} s apart"
        )
    return t, u, y


def _check_frequencies(f: np.ndarray) -> np.ndarray:
    if f.ndim != 1 or not len(f):
        raise InputError("frequencies: a row of numbers in hertz is needed")
    bad = ~((f > 0.0) & (f <= 1e5))
    if bad.any():
        raise InputError(f"frequencies: {f[bad][0]:g} Hz is outside (0, 1e+05] Hz")
    return f


def _check_amplitude(amplitude: float) -> None:
    if not 0.0 < amplitude < np.inf:
        raise InputError(f"amplitude = {amplitude:g} must be positive: the peak of the sine, from its mean")


def _flat_share(y: np.ndarray, *extremes: float) -> float:
    """The largest share of samples that follow another one at exactly the same extreme value."""
    if len(y) < 2:
        return 0.0
    return max(float(np.mean((y[1:] == extreme) & (y[:-1] == extreme))) for extreme in extremes)


def _flat_of_a_sine(y: np.ndarray) -> float:
    """The flat share that a clean sine of this range and resolution may have, with a margin."""
    levels = np.unique(y)
    if len(levels) < 3:
        return 0.02
    steps = float(np.median(np.diff(levels))), float(np.ptp(y)) / 2.0
    return 0.02 + 3.0 * float(np.arccos(max(1.0 - 1.5 * steps[0] / steps[1], -1.0))) / np.pi
