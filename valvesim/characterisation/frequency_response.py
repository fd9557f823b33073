"""Frequency response and its figures of merit (SAE ARP490, ISO 10770-1); stepped sines of the model.

Symbols
    f frequency Hz, H(f) complex gain output/input: |H| relative to its lowest frequency in dB, phase lag = -arg H
    gamma^2 coherence: share of the output's power that the input explains linearly

Amplitudes are peak, from the mean. Time s, temperatures °C, all else SI; angles of the phase in degrees by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.dither import NO_DITHER, SAMPLES, Dither
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.held_scenario import (
    Source,
    command_of,
    held,
    held_oil_temperature,
    output_of,
    output_unit,
    rated_command,
)
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, ResponseOptions
from valvesim.characterisation.record_checks import check_amplitude, check_frequencies
from valvesim.characterisation.sine_point import SinePoint, fit_sine
from valvesim.errors import InputError
from valvesim.inputs import Sine
from valvesim.simulation.run import simulate
from valvesim.units import in_si, reads_units

SETTLE_TIME = 0.05  # s of a sine before it is read: the slowest mode of the reference valve is 1/1070 s
FREQUENCIES = tuple(np.geomspace(5.0, 500.0, 41))  # Hz, six to the octave


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
    options: ResponseOptions = DEFAULT_CHARACTERISATION.response

    @property
    def credible(self) -> np.ndarray:
        """Points whose coherence, where there is one, is at least `least_coherence`; (n_f,) of bool."""
        return ~(self.coherence < self.options.least_coherence)

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
    def figures(self) -> tuple[FigureOfMerit | Absent, ...]:
        """Figures of merit (SAE ARP490, ISO 10770-1), on a monotone cubic over log f between the points.

        - frequency_minus_3_db, Hz: where the amplitude ratio first falls to -3 dB of that at the lowest frequency
        - frequency_minus_90_deg, Hz: where the phase lag first reaches 90 degrees
        - resonant_peak, dB: greatest amplitude ratio, 0 where it only falls
        - largest_distortion, %: greatest THD of the output over the frequencies
        """
        return (
            self._minus_3_db(),
            self._cross("frequency_minus_90_deg", self.phase_lag, 90.0, "degrees", "phase lag at 90 degrees"),
            self._peak(),
            self._distortion(),
        )

    def figures_at(self, frequency: float) -> tuple[FigureOfMerit | Absent, ...]:
        """amplitude_ratio (dB) and phase_lag (degrees) at a frequency (Hz), between credible points as `figures`."""
        from scipy.interpolate import PchipInterpolator

        f = self.frequency[self.credible]
        told: list[FigureOfMerit | Absent] = []
        curves = (("amplitude_ratio", "dB", self.amplitude_ratio), ("phase_lag", "deg", self.phase_lag))
        for name, unit, values in curves:
            if len(f) < 2 or not f[0] <= frequency <= f[-1]:
                told.append(Absent(name, f"{frequency:.4g} Hz is outside the response"))
                continue
            gap = self._gap_before(max(int(np.searchsorted(f, frequency)), 1))
            if reason := gap or (self._near_reference() if name == "amplitude_ratio" else ""):
                told.append(Absent(name, reason))
                continue
            value = float(PchipInterpolator(np.log(f), values[self.credible])(np.log(frequency)))
            told.append(FigureOfMerit(name, value, unit, f"at {frequency:.4g} Hz"))
        return tuple(told)

    def _minus_3_db(self) -> FigureOfMerit | Absent:
        """The -3 dB frequency, absent where the lowest frequency, its reference, is too near to it."""
        near, found = self._near_reference(), self._fall_to_minus_3_db()
        return Absent(found.name, near) if near else found

    def _fall_to_minus_3_db(self) -> FigureOfMerit | Absent:
        return self._cross("frequency_minus_3_db", -self.amplitude_ratio, 3.0, "dB", "amplitude ratio at -3 dB")

    def _near_reference(self) -> str:
        """Why the lowest frequency is no reference of amplitude ratios; empty where it is one."""
        found = self._fall_to_minus_3_db()
        if isinstance(found, Absent):
            return ""
        lowest, highest = float(self.frequency[self.credible][0]), self.options.highest_reference * found.value
        if lowest <= highest:
            return ""
        told = f"{lowest:.3g} Hz, to which it refers, is too near: a longer record, or {highest:.2g} Hz and lower"
        return f"the lowest frequency of {told}"

    def _gap_before(self, k: int) -> str:
        """Why nothing is told between the credible points k - 1 and k; empty where they are neighbours."""
        f, count = self.frequency[self.credible], np.flatnonzero(self.credible)
        if count[k] - count[k - 1] == 1 or f[k] <= 1.1 * f[k - 1]:
            return ""
        return self._incoherent(f"between {f[k - 1]:.4g} and {f[k]:.4g} Hz")

    def _cross(self, name: str, fall: np.ndarray, level: float, unit: str, doc: str) -> FigureOfMerit | Absent:
        """Where `fall` first rises through `level`, on the credible points."""
        if not np.any(self.credible):
            return Absent(name, self._incoherent("at every frequency"))
        f, fall = self.frequency[self.credible], fall[self.credible]
        beyond = np.flatnonzero(fall >= level)
        if not len(beyond):
            return Absent(name, f"not reached up to {f[-1]:.4g} Hz (there {fall[-1]:.3g} of {level:g} {unit})")
        k = int(beyond[0])
        if k == 0:
            return Absent(
                name, f"already {fall[0]:.4g} {unit} at the lowest frequency of {f[0]:.4g} Hz: start lower, and see "
                "that the output has the sign of the input"
            )  # fmt: skip
        if gap := self._gap_before(k):
            return Absent(name, gap)
        return FigureOfMerit(name, _first_root(np.log(f), fall, level, k), "Hz", doc)

    def _incoherent(self, where: str) -> str:
        return f"the coherence is below {self.options.least_coherence:g} {where}"

    def _peak(self) -> FigureOfMerit | Absent:
        if not np.any(self.credible):
            return Absent("resonant_peak", self._incoherent("at every frequency"))
        top = float(np.max(self.amplitude_ratio[self.credible]))
        return FigureOfMerit("resonant_peak", max(top, 0.0), "dB", "greatest amplitude ratio")

    def _distortion(self) -> FigureOfMerit | Absent:
        if not np.any(np.isfinite(self.distortion)):
            chirp = bool(np.any(np.isfinite(self.coherence)))
            why = "a chirp does not tell harmonics apart" if chirp else "it needs more than 10 samples a cycle"
            return Absent("largest_distortion", f"{why}: take steady sines")
        doc = "greatest harmonic distortion (harmonics 2 to 5)"
        return FigureOfMerit("largest_distortion", 100.0 * float(np.nanmax(self.distortion)), "%", doc)


def at_single_frequencies(
    title: str, conditions: Mapping[str, float], response: FrequencyResponse, frequencies: Sequence[float]
) -> list[tuple[str, dict[str, float], FiguresOfMerit]]:  # fmt: skip
    """A test at each of several frequencies (Hz): title, conditions, `figures_at` it."""
    return [
        (f"{title}, at {f:g} Hz", {**conditions, "frequency": f}, response.figures_at(f)) for f in frequencies
    ]  # fmt: skip


def _first_root(x: np.ndarray, y: np.ndarray, level: float, k: int) -> float:
    """exp of where a monotone cubic through (x, y) passes `level` between the points k - 1 and k."""
    from scipy.interpolate import PchipInterpolator

    near = slice(max(k - 3, 0), k + 3)
    roots = PchipInterpolator(x[near], y[near]).solve(level, extrapolate=False)
    return float(np.exp(next(root for root in roots if x[k - 1] <= root <= x[k])))


def join_points(
    points: Sequence[SinePoint], *, channel: str = "output", share: float = float("nan"),
    oil_temperature: float = float("nan"), options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
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
        options=options,
    )


@reads_units(frequencies="Hz", oil_temperature="degC", part_temperature="degC", settle="s")
def frequency_response(
    source: Source, *, amplitude: float, frequencies: Sequence[float] = FREQUENCIES,
    oil_temperature: float | None = None, part_temperature: float | None = None, output: str = "spool_position",
    bias: float = 0.0, cycles: int = 2, settle: float = SETTLE_TIME, workers: int = 1, dither: Dither = NO_DITHER,
    progress: Callable[[float], None] | None = None, options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
) -> FrequencyResponse:  # fmt: skip
    """Stepped sines: at each frequency (Hz) the valve is driven from rest until it is steady, then read.

    The command is bias + amplitude sin(2 pi f t) in A (or V); `settle` s (and at least a cycle) pass before at least
    `cycles` whole cycles and 20 ms are read at 64 samples a cycle. `source`, temperatures and `output` as in
    `step_response`. Frequencies run on `workers` threads: one, since a run of milliseconds holds the interpreter's lock
    for most of its time (two were slower, measured). A `dither` comes upon the command and is fitted beside.
    `progress` is told the share that is done.
    Amplitudes beyond the rated command are allowed, with a ValidityWarning.
    Raises InputError for an amplitude or frequency that is not positive, fewer than two frequencies, or one given
    twice, and as `simulate` does.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    f = check_frequencies(np.asarray(frequencies, dtype=float))
    if len(f) < 2:
        raise InputError("frequency response: needs two or more frequencies, the lowest as the reference")
    amplitude, bias = (in_si(each, base.drive.command_unit, "frequency response") for each in (amplitude, bias))
    check_amplitude(amplitude)
    output_unit(base, output)
    for name, number in (("cycles", cycles), ("workers", workers)):
        if number < 1 or number != int(number):
            raise InputError(f"frequency response: {name} = {number:g} must be a whole number of 1 or more")
    base = replace(base, tolerance=min(base.tolerance, options.sine_tolerance))
    upon, least = dither.frequency if dither.amplitude else 0.0, options.cycle_samples

    def point(frequency: float) -> SinePoint:
        wait = max(int(np.ceil(settle * frequency)), 1)
        read = max(int(cycles), int(np.ceil(options.read_time * frequency)))
        command = dither.upon(Sine(amplitude=amplitude, frequency=frequency, offset=bias), rated_command(base))
        samples = least * int(np.ceil(max(SAMPLES * upon / (least * frequency), 1.0)))
        rate = samples * frequency
        result = simulate(replace(base, command=command, duration=(wait + read) / frequency, output_rate=rate))
        part = slice(-samples * read, None)
        return fit_sine(
            result.time[part], command_of(result)[part], output_of(result, output)[part], frequency, dither=upon
        )  # fmt: skip

    points = []
    with ThreadPoolExecutor(workers) as pool:
        for done in pool.map(point, f):
            points.append(done)
            if progress is not None:
                progress(len(points) / len(f))
    share = amplitude / rated_command(base)
    joined = join_points(
        points, channel=output, share=share, oil_temperature=held_oil_temperature(base), options=options
    )
    return replace(joined, amplitude=amplitude)
