"""Waves upon an input that no record tells: the ripple of a pump upon the supply, a mains hum upon the command.

A wave has one frequency in all records, and in each an amplitude and a phase of its own. Its frequency stands out of
the spectrum of what a fit leaves; amplitude and phase are nuisance parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.identification.between_samples import Wave
from valvesim.identification.down_weighting import robust_weights
from valvesim.identification.fit import Fit, rescored
from valvesim.identification.input_choice import added_columns
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.prior import NominalModel, NuisanceParameter
from valvesim.identification.projection import inverse_of
from valvesim.identification.session import UNITS, Record, value_text
from valvesim.identification.study import Prepared, PreparedSession, Study, residual_of, with_records

Readings = Sequence[dict[str, np.ndarray]]

MODULATED = ("load_flow", "spool_position")
"""Outputs that go with the supply pressure by a share of themselves: as the flow does, and the force of that flow."""


def wave_columns(records: Sequence[Record]) -> tuple[str, ...]:
    """The inputs on which waves are thought of."""
    return "supply_pressure", records[0].command


def wave_size(model: NominalModel, records: Sequence[Record], column: str) -> float:
    """The amplitude that a wave on an input may have, one prior deviation, in its SI unit."""
    if column == "supply_pressure":
        return model.options.wave.ripple * float(model.variant.valve.supply_pressure)
    return model.options.wave.hum * float(np.max([np.ptp(r.values[column]) for r in records]))


def wave_parameters(
    records: Sequence[Record], column: str, frequency: float, size: float
) -> tuple[NuisanceParameter, ...]:
    """The two components (cosine, sine) of a wave of `frequency` Hz on an input, in each record."""
    return tuple(
        NuisanceParameter(
            f"wave@{record.name}:{column}:{frequency:.4g} Hz:{component}", UNITS[column], 0.0, size,
            (-4.0 * size, 4.0 * size), input=Wave(record.name, column, frequency, phase),
        )
        for record in records
        for component, phase in (("cosine", 0.0), ("sine", 0.5 * np.pi))
    )  # fmt: skip


def wave_name(column: str, frequency: float) -> str:
    """What tells a wave from others."""
    return f"{column} at {frequency:.4g} Hz"


def wave_words(parameters: Sequence[NuisanceParameter], values: np.ndarray) -> str:
    """A wave in words, by the values of its `wave_parameters`: the median amplitude of all records."""
    wave = _wave_of(parameters[0])
    does = "the supply pressure ripples" if wave.column == "supply_pressure" else f"the {wave.column} hums"
    amplitude = float(np.median(np.hypot(values[::2], values[1::2])))
    return f"{does} by {value_text(amplitude, UNITS[wave.column])} at {wave.frequency:.4g} Hz"


def fitted_waves(model: NominalModel) -> dict[str, tuple[NuisanceParameter, ...]]:
    """The waves among the nuisance parameters of a model, by their names."""
    found: dict[str, tuple[NuisanceParameter, ...]] = {}
    for p in model.parameters:
        if isinstance(p.input, Wave):
            name = wave_name(p.input.column, p.input.frequency)
            found[name] = (*found.get(name, ()), p)
    return found


def tuned_waves(
    study: Study,
    fit: Fit,
    linearised: Sequence[LinearisedRecord],
    columns: Sequence[dict[str, np.ndarray]],
    fitted_columns: np.ndarray | None = None,
) -> tuple[tuple[NuisanceParameter, ...], np.ndarray, float]:
    """The nuisance parameters of a study with each wave at the frequency by which a fit would leave least; the fit's
    point (p,), its waves turned so that they keep their phase in the middle of each record; and the reduction of the
    chi-square that this promises, all else fitted again. `fitted_columns` (rows, k) are the whitened sensitivities to
    the fit's candidates.

    The spectrum has told the frequency to some hundredths of a turn in a record. Where a ripple stands a thousand times
    above the noise the rest of it would pull figures of the valve along. By the linearised equations a fit leaves a
    parabola about the best frequency; three of them tell where that is.
    """
    model, point, promised = study.nominal, fit.point.copy(), 0.0
    J, parameters = study.stack(columns), list(model.parameters)
    free = J[:, :0] if fitted_columns is None else fitted_columns
    at = {p.name: k for k, p in enumerate(parameters)}
    durations = {record.name: record.duration for record in study.session.training}
    step = study.options.wave.tuning_step / max(durations.values())
    for wave in fitted_waves(model).values():
        own = [at[p.name] for p in wave]
        others = np.delete(np.arange(len(parameters)), own)
        without = replace(fit, point=fit.point[others], residual=fit.residual + J[:, own] @ point[own])
        detuned = [component for by in (-step, 0.0, step) for component in _detuned(wave, by)]
        added = added_columns(study, linearised, model, detuned)
        predicted = linear_reductions(J[:, others], without, np.column_stack([free, added]))
        first, size = free.shape[1], len(wave)
        places = (range(first + k * size, first + (k + 1) * size) for k in range(3))
        below, here, above = (predicted.reduction(each, range(first)) for each in places)
        bend = 2.0 * here - below - above
        if bend <= 0.0:  # no parabola with an end: the wave is none
            continue
        by = float(np.clip(0.5 * step * (above - below) / bend, -step, step))
        promised += float(0.5 * (by / step) * (above - below) - 0.5 * (by / step) ** 2 * bend)
        for k, tuned in zip(own, _detuned(wave, by), strict=True):
            parameters[k] = tuned
        for cosine, sine in zip(own[::2], own[1::2], strict=True):
            turn = np.pi * by * durations[_wave_of(parameters[cosine]).record]
            rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            point[[cosine, sine]] = rotation @ point[[cosine, sine]]
    return tuple(parameters), point, promised


def _detuned(wave: Sequence[NuisanceParameter], by: float) -> tuple[NuisanceParameter, ...]:
    """The components of a wave at a frequency that is higher by some Hz."""
    waves = [_wave_of(component) for component in wave]
    return tuple(
        replace(component, input=replace(own, frequency=own.frequency + by))
        for component, own in zip(wave, waves, strict=True)
    )


def _wave_of(component: NuisanceParameter) -> Wave:
    assert isinstance(component.input, Wave)  # noqa: S101 - the parameter is that of one
    return component.input


def with_parameters(prepared: Prepared, parameters: Sequence[NuisanceParameter]) -> Prepared:
    """A prepared session with more nuisance parameters. Beside waves the ends of each record do not count."""
    prepared = prepared.with_nominal(prepared.nominal.extended(parameters))
    if not fitted_waves(prepared.nominal):
        return prepared
    return with_records(prepared, [settled(r, options=prepared.options) for r in prepared.session.training], ())


def settled(record: Record, *, options: IdentificationOptions) -> Record:
    """A record without its first samples: a run begins at rest, and under a wave no valve has been at rest before. And
    without its last one: a clock that is early reads it when the run has ended.
    """
    kept = record.time - record.time[0] >= options.wave.settling
    kept[-1] = False
    return replace(record, usable={name: good & kept for name, good in record.usable.items()})


def outstanding_frequencies(study: PreparedSession, readings: Readings, peak: float) -> list[float]:
    """The few frequencies (Hz) at which what is left stands furthest above what is left beside them, by a ratio of at
    least `peak`, and that times how far the commands stand out there: what goes with these is the valve's.
    """
    wave = study.options.wave
    longest = max(predictor.record.duration for predictor in study.predictors)
    highest = min(predictor.record.rate for predictor in study.predictors) / 2.0
    grid = np.arange(wave.turns / longest, wave.highest_share * highest, 0.5 / longest)
    if len(grid) < wave.beside_bins:
        return []
    each = _over_beside(_powers(study, readings, grid), wave.beside_bins)
    commanded = _over_beside(_command_powers(study, grid), wave.beside_bins)
    over, where = each.max(axis=0) / np.maximum(commanded[0], 1.0), each.argmax(axis=0)
    found: list[float] = []
    for k in np.argsort(-over, kind="stable"):
        if over[k] < peak or len(found) == wave.frequencies:
            break
        if all(abs(grid[k] - other) > 3.0 / longest for other in found):
            best = float(grid[k])
            for reach in (0.5, 0.025):  # a thousandth of a turn counts where the ripple stands far above the noise
                fine = best + reach * np.linspace(-1.0, 1.0, 41) / longest
                best = float(fine[int(np.argmax(_powers(study, readings, fine)[where[k]]))])
            found.append(best)
    return found


def _over_beside(power: np.ndarray, bins: int) -> np.ndarray:
    """How far powers (k, n) stand above those beside them."""
    from scipy.ndimage import median_filter

    return power / np.maximum(median_filter(power, (1, bins)), 1e-300)


def _command_powers(study: PreparedSession, frequencies: np.ndarray) -> np.ndarray:
    """The power (1, n) of the commands at frequencies (n,) Hz, evenly spaced, over all records."""
    power = np.zeros((1, len(frequencies)))
    for record in (predictor.record for predictor in study.predictors):
        command = record.values[record.command]
        power += _power_of(command - np.mean(command), record.rate, frequencies)
    return power


def _power_of(series: np.ndarray, rate: float, frequencies: np.ndarray) -> np.ndarray:
    """The power (n,) of a series at frequencies (n,) Hz, evenly spaced, as a share of its own."""
    from scipy.signal import ZoomFFT

    transform = ZoomFFT(len(series), [frequencies[0], frequencies[-1]], len(frequencies), fs=rate, endpoint=True)
    return np.abs(transform(series)) ** 2 / max(float(series @ series), 1e-300)


def _powers(study: PreparedSession, readings: Readings, frequencies: np.ndarray) -> np.ndarray:
    """The power (k, n) of what is left at frequencies (n,) Hz, evenly spaced, over all records, each series of power
    one: that of all channels, that of each `MODULATED` one times what it reads, and all of these together.

    What is far off is clipped (Huber): a peak that the model misses has power at all frequencies. In some outputs a
    ripple shows in proportion to what is read, and so by its sidebands; times that it shows at its own frequency. In
    which of them it stands out depends on the commands, and beside others it is lost.
    """
    power = np.zeros((1 + len(MODULATED), len(frequencies)))
    for predictor, read in zip(study.predictors, readings, strict=True):
        record = predictor.record
        residual = residual_of(record, read)
        for name in record.outputs:
            usable = record.usable[name]
            left = residual[name][:, 0] - np.median(residual[name][usable, 0])
            most = study.options.wave.clipped * 1.4826 * float(np.median(np.abs(left[usable])))
            left = np.where(usable, np.clip(left, -most, most), 0.0)
            power[0] += _power_of(left, record.rate, frequencies)
            if name in MODULATED:
                power[1 + MODULATED.index(name)] += _power_of(left * read[name], record.rate, frequencies)
    return np.vstack([power, power.sum(axis=0)])


def dominant_wave(
    study: Study, fit: Fit, linearised: Sequence[LinearisedRecord], columns: Sequence[dict[str, np.ndarray]]
) -> tuple[NuisanceParameter, ...]:
    """The wave that explains most of what a fit without candidates leaves beyond the noise; () where none does.

    `linearised` are the records of the fit and `columns` their sensitivities. Samples that are far off count less.
    """
    study = robust_weights(study, fit.readings)
    fit, J, options = rescored(study, fit), study.stack(columns), study.options
    if fit.chi_square < 2.0 * fit.rows:  # what is less may wait for the search of causes
        return ()
    records, taken = study.session.training, fitted_waves(study.nominal)
    waves = [
        wave_parameters(records, column, frequency, wave_size(study.nominal, records, column))
        for frequency in outstanding_frequencies(study, fit.readings, options.wave.peak)
        for column in wave_columns(records)
        if wave_name(column, frequency) not in taken
    ]
    if not waves:
        return ()
    together = [p for wave in waves for p in wave]
    added = added_columns(study, linearised, study.nominal.extended(together), together)
    predicted, ends = linear_reductions(J, fit, added), np.cumsum([len(wave) for wave in waves])
    before = predicted.reduction()
    gains = [predicted.reduction(range(end - len(wave), end)) - before for wave, end in zip(waves, ends, strict=True)]
    best, left = int(np.argmax(gains)), fit.chi_square - fit.rows - before
    return waves[best] if gains[best] > max(options.wave.minimum_gain, options.wave.dominant_share * left) else ()


@dataclass(frozen=True, eq=False)
class LinearReductions:
    """What the linearised equations of a fit predict with columns more: its normal equations with all of them, made
    once.

    `H` (p + k, p + k) is the product of p own and k more columns, without priors; `gradient` (p + k,) that with what is
    left, with the priors of its own.
    """

    H: np.ndarray
    gradient: np.ndarray
    p: int

    def reduction(self, more: Sequence[int] = (), free: Sequence[int] = ()) -> float:
        """The reduction of the penalised chi-square with some more columns, by their places from zero on; each with a
        prior of one deviation, but those that are `free`.
        """
        at = np.array([*range(self.p), *(self.p + k for k in (*free, *more))])
        prior = np.ones(len(at))
        prior[self.p : self.p + len(free)] = 0.0
        gradient = self.gradient[at]
        return float(gradient @ inverse_of(self.H[np.ix_(at, at)] + np.diag(prior)) @ gradient)

    def gain(self, more: Sequence[int], beside: Sequence[int] = ()) -> float:
        """The reduction of the chi-square by some more columns beyond that by those `beside`, which are free."""
        return self.reduction(more, beside) - self.reduction(free=beside)


def linear_reductions(J: np.ndarray, fit: Fit, more: np.ndarray) -> LinearReductions:
    """Those of a fit with a whitened Jacobian (rows, p), by `more` columns (rows, k)."""
    A, p = np.column_stack([J, more]), J.shape[1]
    gradient = A.T @ fit.residual
    gradient[:p] -= fit.point
    return LinearReductions(A.T @ A, gradient, p)
