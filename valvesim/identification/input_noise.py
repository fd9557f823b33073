"""White noise and rounding of the instrument upon a measured input, which the valve never got, taken away before
anything is fitted.

A model that is driven by it answers with a noise of its own. Whatever makes the model slower (a lag of a sensor, an
inertia, a damping) lessens that, so that a healthy valve seems to be slow: the bias of errors in the variables.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import dct, idct
from scipy.signal import welch

from valvesim.identification.options import InputNoiseOptions
from valvesim.measurement.quality import noise_of


def input_noise(values: np.ndarray, *, options: InputNoiseOptions) -> float:
    """The standard deviation of white noise upon a measured input (n,).

    It is the lesser of two: that of second differences by their median, which jumps do not reach, and that of the
    upper quarter of the spectrum by its median, which neither sines, chirps nor dither reach, nor the few stretches
    in which something jumps.
    """
    length = min(options.spectrum, len(values))
    _, power = welch(values, window="blackmanharris", nperseg=length, average="median")
    floor = np.median(power[3 * len(power) // 4 :]) / 2.0  # one-sided, per sample
    return min(noise_of(values), float(np.sqrt(floor)))


def without_rounding(values: np.ndarray, step: float) -> np.ndarray:
    """An input (n,) that was read on a grid of this step, by straight lines between what is known of it."""
    at, height, _ = _between_levels(values, step)
    return np.interp(np.arange(len(values)), at, height)


def rounding_error(values: np.ndarray, step: float, dice: np.random.Generator) -> np.ndarray:
    """A realisation of what an input (n,) that was read on such a grid may still be off by."""
    at, _, uncertainty = _between_levels(values, step)
    return np.interp(np.arange(len(values)), at, dice.uniform(-1.0, 1.0, len(at)) * uncertainty)


def _between_levels(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(samples, values, half-widths) at which an input (n,) that was read on a grid of this step is known.

    Where it goes to the next level it passes half-way between two samples, so that it is known there the better, the
    longer it stands at both levels. Where it turns, where it jumps by more, and before and after all this it may be
    half a step from its level.
    """
    level = np.round((values - values[0]) / step)
    move = np.diff(level)
    changes = np.flatnonzero(move)
    passed = changes[np.abs(move[changes]) == 1.0]
    jumps = changes[np.abs(move[changes]) > 1.0]
    turns = np.flatnonzero(np.diff(np.sign(move[changes])))
    stands = np.diff(np.concatenate([[-1], changes, [len(values) - 1]]))  # samples at each level, one after the other
    shorter = np.minimum(stands[:-1], stands[1:])[np.abs(move[changes]) == 1.0]
    ends = np.array([0, len(values) - 1])
    middle = np.concatenate(
        [(changes[turns] + 1 + changes[turns + 1]) / 2.0, changes[:1] / 2.0, (changes[-1:] + len(values)) / 2.0]
    )
    at_level = np.concatenate([ends, jumps, jumps + 1, middle.astype(int)])
    at = np.concatenate([ends, jumps, jumps + 1, middle, passed + 0.5])
    height = np.concatenate([level[at_level], level[passed] + move[passed] / 2.0])
    uncertainty = np.concatenate([np.ones(len(at_level)), 1.0 / shorter])
    at, first = np.unique(at, return_index=True)
    return at, values[0] + step * height[first], step / 2.0 * uncertainty[first]


def without_noise(values: np.ndarray, noise: float, *, options: InputNoiseOptions) -> np.ndarray:
    """An input (n,) without white noise of this deviation, jumps and all, by the sliding cosine transform.

    Each stretch of `stretch` samples is a cubic and those cosine coefficients beside it that noise can hardly make. A
    sample is the mean of all stretches that hold it, those of fewer figures counting more: beside a jump, those that
    do not reach it.
    """
    width = options.stretch
    cubics = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, width), 4))[0]
    padded = np.pad(values, width, mode="reflect", reflect_type="odd")
    total, weights = np.zeros_like(padded), np.zeros_like(padded)
    for first in range(width):
        last = first + (len(padded) - first) // width * width
        stretches = padded[first:last].reshape(-1, width)
        slow = stretches @ cubics @ cubics.T
        c = dct(stretches - slow, norm="ortho")
        c[np.abs(c) < options.threshold * noise] = 0.0
        weight = 1.0 / (cubics.shape[1] + np.count_nonzero(c, axis=1))
        total[first:last] += ((slow + idct(c, norm="ortho")) * weight[:, None]).ravel()
        weights[first:last] += np.repeat(weight, width)
    return (total / weights)[width:-width]
