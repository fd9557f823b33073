"""Frequency response by cross- and power spectra of one chirp, of a record or of the model.

Symbols
    P_uu, P_yy, P_uy power and cross-spectral densities of command and output, gamma^2 coherence

Source: Welch's method; Bendat and Piersol, Random Data, ch. 6."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from valvesim.characterisation.dither import NO_DITHER, Dither
from valvesim.characterisation.frequency_response import FrequencyResponse
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
from valvesim.characterisation.record_checks import (
    check_amplitude,
    check_frequencies,
    checked_record,
    flat_share,
    flat_share_of_a_sine,
)
from valvesim.characterisation.sine_point import FEWEST_A_CYCLE
from valvesim.errors import InputError
from valvesim.inputs import Chirp
from valvesim.simulation.result import Result
from valvesim.simulation.run import simulate
from valvesim.units import in_si, reads_units


def _checked_chirp(
    time, command, output, *, low: float | None, high: float | None, resolution: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The record as arrays; InputError where it is no chirp that a spectrum could be taken of."""
    t, u, y = checked_record(time, command, output)
    rate = (len(t) - 1) / (t[-1] - t[0])
    if np.ptp(u) <= 1e-9 * float(np.max(np.abs(u))):
        raise InputError("chirp record: the command does not move")
    if (flat := flat_share(y, float(np.max(y)), float(np.min(y)))) > flat_share_of_a_sine(y):
        raise InputError(f"chirp record: the output rests at its extreme for {100 * flat:.3g} %: clipped or saturated")
    for name, value in (("low", low), ("high", high), ("resolution", resolution)):
        if value is not None and not 0.0 < value < np.inf:
            raise InputError(f"chirp record: {name} = {value:g} Hz must be positive")
    if high is not None and rate < FEWEST_A_CYCLE * high:
        raise InputError(
            f"chirp record: {rate / high:.3g} samples a cycle at {high:.4g} Hz are too few: {FEWEST_A_CYCLE} are needed"
        )
    return t, u, y


def spectral_response(
    time, command, output, *, low: float | None = None, high: float | None = None, resolution: float | None = None,
    channel: str = "output", share: float = float("nan"), oil_temperature: float = float("nan"),
    options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
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

    t, u, y = _checked_chirp(time, command, output, low=low, high=high, resolution=resolution)
    span = t[-1] - t[0]
    rate = (len(t) - 1) / span
    even = np.linspace(t[0], t[-1], len(t))
    u, y = np.interp(even, t, u), np.interp(even, t, y)
    width = max(24.0 / span, min(2.0, 100.0 / span)) if resolution is None else resolution
    window = int(round(rate / width))
    if window > len(t) // 2 or window < 16:
        raise InputError(
            f"chirp record: a resolution of {width:.3g} Hz makes windows of {window} of its {len(t)} samples; between "
            "16 and half of the record are needed"
        )
    welch: Any = {"fs": rate, "window": "hann", "nperseg": window, "noverlap": 3 * window // 4}
    f, P_uu = signal.welch(u, **welch)
    _, P_yy = signal.welch(y, **welch)
    _, P_uy = signal.csd(u, y, **welch)
    inside = (f >= max(2.0 * width, low or 0.0)) & (f <= min(rate / FEWEST_A_CYCLE, high or np.inf))
    inside &= P_uu > options.excited * np.max(P_uu)
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
        options=options,
    )


def own_response(result: Result, output: str = "spool_position") -> FrequencyResponse | None:
    """The frequency response of a run to its own command, or None where that excites too little of any band.

    Raises InputError for a channel that the run does not have.
    """
    result.select((output,))
    with contextlib.suppress(InputError):
        return spectral_response(
            result.time, command_of(result), output_of(result, output), channel=output,
            oil_temperature=held_oil_temperature(result.scenario),
        )  # fmt: skip
    return None


@reads_units(low="Hz", high="Hz", duration="s", oil_temperature="degC", part_temperature="degC")
def chirp_response(
    source: Source, *, amplitude: float, low: float = 5.0, high: float = 500.0, duration: float = 6.0,
    oil_temperature: float | None = None, part_temperature: float | None = None, output: str = "spool_position",
    bias: float = 0.0, dither: Dither = NO_DITHER, progress: Callable[[float], None] | None = None,
    options: ResponseOptions = DEFAULT_CHARACTERISATION.response,
) -> FrequencyResponse:  # fmt: skip
    """Simulate one chirp, even in hertz from `low`/5 to 1.1 `high` Hz, and take its `spectral_response`.

    A rest of `chirp_rest` s stands before and after it. Sampled at 20 samples a cycle of the highest frequency. A
    `dither` comes upon it all. Other arguments as in `frequency_response`.
    Raises InputError for a band that does not rise, an amplitude that is not positive, and as `spectral_response`.
    """
    base = held(source, oil_temperature=oil_temperature, part_temperature=part_temperature)
    amplitude, bias = (in_si(each, base.drive.command_unit, "chirp response") for each in (amplitude, bias))
    check_amplitude(amplitude)
    check_frequencies(np.array([low, high]))
    output_unit(base, output)
    if low >= high:
        raise InputError(f"chirp response: low = {low:g} Hz must be below high = {high:g} Hz")
    start, end = low / 5.0, 1.1 * high
    command = Chirp(
        amplitude=amplitude, start_frequency=start, end_frequency=end, duration=duration, offset=bias,
        time=options.chirp_rest,
    )
    case = replace(
        base, command=dither.upon(command, rated_command(base)), duration=duration + 2.0 * options.chirp_rest,
        output_rate=20.0 * max(end, dither.frequency if dither.amplitude else 0.0),
    )  # fmt: skip
    result = simulate(case, progress=progress)
    taken = spectral_response(
        result.time, command_of(result), output_of(result, output), low=low, high=high, channel=output,
        share=amplitude / rated_command(base), oil_temperature=held_oil_temperature(base), options=options,
    )  # fmt: skip
    return replace(taken, amplitude=amplitude)
