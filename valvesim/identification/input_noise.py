"""White noise of the instrument upon a measured input, which the valve never got, taken away before anything is fitted.

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
