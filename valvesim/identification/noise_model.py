"""Autoregressive noise of a sensor, and whitening by it.

Symbols
    e_k = sum a_j e_k-j + w_k: autoregressive noise, w white with standard deviation `innovation`
The order is that of least BIC (Schwarz 1978; Ljung, System Identification, ch. 16). Coloured noise that is treated as
white raises false alarms in nearly every session.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.identification.input_noise import rounding_error, without_rounding
from valvesim.identification.options import IdentificationOptions


@dataclass(frozen=True)
class NoiseModel:
    """Autoregressive noise of one channel at one rate; `verified` where repeats have shown it. `rounding_step` is the
    step of the grid on which it was read, where the noise is too small to dither it: rounding repeats itself.
    """

    innovation: float
    lags: tuple[float, ...]
    verified: bool
    source: str
    rounding_step: float = 0.0

    @property
    def deviation(self) -> float:
        """Its stationary standard deviation, in the channel's unit."""
        if not self.lags:
            return self.innovation
        impulse = np.zeros(4096)
        impulse[0] = 1.0
        return float(self.innovation * np.sqrt(np.sum(_filter_back(impulse, self.lags) ** 2)))

    def whiten(self, columns: np.ndarray, usable: np.ndarray) -> np.ndarray:
        """Columns (n, k) with the noise made white and of unit size, (rows, k); rows that touch unusable samples go."""
        return self.filtered(columns, usable) / self.innovation

    def filtered(self, columns: np.ndarray, usable: np.ndarray) -> np.ndarray:
        """The same of the innovation's size; columns that need nothing of it are given back as they are."""
        white, kept = columns.astype(float) if self.lags else columns, self.kept(usable)
        for k, lag in enumerate(self.lags, start=1):  # many columns at once: a filter of the library takes one by one
            white[k:] -= lag * columns[:-k]
        return white if kept.all() else white[kept]

    def largest_variance(self, errors: np.ndarray, width: int, lags: int) -> np.ndarray:
        """(n,) variance of independent errors, in units of the innovation's, to which correlated ones come at most once
        whitened, by realisations of them (n, k): their own over `width` samples, times the sum of their correlations up
        to so many `lags`. No correlation matrix has an eigenvalue beyond the largest sum of a row.
        """
        from scipy.ndimage import uniform_filter1d

        white = self.whiten(errors, np.ones(len(errors), dtype=bool))
        together = [float(np.sum(white[lag:] * white[: len(white) - lag])) for lag in range(min(lags + 1, len(white)))]
        alike = np.abs(together) / (together[0] or 1.0)
        own = uniform_filter1d(np.mean(white**2, axis=1), width, mode="nearest")
        return np.pad(own, (len(errors) - len(own), 0), mode="edge") * (2.0 * np.sum(alike) - alike[0])

    def rounding_variance(self, values: np.ndarray, seed: int, realisations: int) -> float:
        """The variance of independent errors, in units of the innovation's, to which the rounding of a coarse channel's
        values (n,) comes at most, by so many realisations: the largest power of its spectrum, for no combination of
        samples has more.
        """
        from scipy.signal import welch

        dice, known = np.random.default_rng(seed), without_rounding(values, self.rounding_step)
        true = [known + rounding_error(values, self.rounding_step, dice) for _ in range(realisations)]
        white = self.whiten(values[:, None] - np.transpose(true), np.ones(len(values), dtype=bool))
        _, power = welch(white, axis=0, nperseg=max(len(white) // 4, 2), detrend=False, return_onesided=False)
        return float(np.max(np.mean(power, axis=1)))

    def kept(self, usable: np.ndarray) -> np.ndarray:
        """True for the samples (n,) whose rows `whiten` gives back."""
        touched = np.convolve(~usable, np.ones(len(self.lags) + 1))[: len(usable)] > 0.0
        touched[: len(self.lags)] = True
        return ~touched


def _filter_back(white: np.ndarray, lags: Sequence[float]) -> np.ndarray:
    from scipy.signal import lfilter

    return lfilter([1.0], np.concatenate([[1.0], -np.asarray(lags)]), white)


def fit_autoregression(
    series: Sequence[np.ndarray], *, verified: bool, source: str, floor: float, options: IdentificationOptions
) -> NoiseModel:
    """The autoregressive model of least BIC for series of one kind of noise; never below the deviation `floor`.

    NaN are samples that the sensor lost: what touches them tells nothing of the noise.
    """
    series = [np.asarray(one, dtype=float) - np.mean(one[np.isfinite(one)]) for one in series]
    counts = [np.count_nonzero(np.isfinite(one)) for one in series]
    most = max(int(min(options.noise.most_lags, sum(counts) // options.noise.samples_per_lag, min(counts) - 2)), 0)
    while most and sum(map(np.count_nonzero, _unbroken(series, most))) < options.noise.samples_per_lag * most / 2:
        most -= 1
    whole = np.concatenate(_unbroken(series, most))
    target = np.concatenate([one[most:] for one in series])[whole]
    best: tuple[float, float, tuple[float, ...]] | None = None
    for p in range(most + 1):
        if p:
            past = np.concatenate(
                [np.column_stack([one[most - j : len(one) - j] for j in range(1, p + 1)]) for one in series]
            )[whole]
            a = np.linalg.lstsq(past, target, rcond=None)[0]
            left = target - past @ a
        else:
            a, left = np.zeros(0), target
        variance = float(np.mean(left**2)) * len(target) / max(len(target) - p, 1)
        score = len(target) * np.log(max(variance, 1e-300)) + p * np.log(len(target))
        if best is None or score < best[0]:
            best = score, variance, tuple(float(v) for v in a)
    assert best is not None  # noqa: S101 - order 0 is always tried
    noise = NoiseModel(float(np.sqrt(best[1])), _stable(best[2]), verified, source)
    if noise.deviation >= floor:
        return noise
    if noise.innovation > 0.0:
        return NoiseModel(floor * noise.innovation / noise.deviation, noise.lags, verified, source)
    return NoiseModel(floor, (), verified, source)


def _unbroken(series: Sequence[np.ndarray], most: int) -> list[np.ndarray]:
    """For each series (n,), (n - most,): True for the samples that are there, with `most` before them."""
    return [np.all([np.isfinite(one[most - j : len(one) - j]) for j in range(most + 1)], axis=0) for one in series]


def _stable(lags: tuple[float, ...]) -> tuple[float, ...]:
    """Lags whose noise does not grow: roots are pulled inside the unit circle."""
    if not lags:
        return lags
    roots = np.roots(np.concatenate([[1.0], -np.asarray(lags)]))
    size = np.abs(roots)
    if np.all(size < 0.995):
        return lags
    roots = roots * np.minimum(1.0, 0.995 / size)
    return tuple(float(v) for v in -np.real(np.poly(roots))[1:])
