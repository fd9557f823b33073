"""One channel that does not go with the others: without it nothing is left to explain.

What is wrong is then in its measuring chain, or in what no other channel shows. A chain of second order is told by its
natural frequency and damping ratio (Doebelin, Measurement Systems, 1990, ch. 3).

Symbols
    x what the valve does, y what is read, w natural angular frequency, z damping ratio, k gain, b bias
    y''/w^2 + 2 z y'/w + y = k x + b
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from valvesim.diagnosis.detection import detect
from valvesim.diagnosis.options import ChannelApartOptions, DiagnosisOptions
from valvesim.diagnosis.score_test import ScoreTest, score_test
from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import evaluate_fit, is_adequate
from valvesim.identification.least_squares import bounded_step
from valvesim.identification.nominal_fit import (
    NominalFit,
    clipped_to_tolerance,
    fit_nominal_near,
    linearise_nominal,
    with_edges_searched,
    with_inputs_reviewed,
)
from valvesim.identification.prior import measured_channels
from valvesim.identification.study import Study, with_records


@dataclass(frozen=True, eq=False)
class ChannelApart:
    """A channel that does not go with the others, and the response of second order that explains it, in words; ""
    where none does. `nominal` is the nominal fit to the other channels, with what it reads of this one.
    """

    name: str
    response: str
    nominal: NominalFit

    @property
    def words(self) -> str:
        told = self.response or "it, or what no other channel shows, is wrong"
        return f"{self.name} does not go with the other channels, without which nothing is wrong: {told}"


def channel_apart(nominal: NominalFit, scores: ScoreTest, *, options: DiagnosisOptions) -> ChannelApart | None:
    """The one channel without which the nominal valve explains the records; None where there is none or several, or
    what shows is so little, by the score test of the fit, that it may hide without any.
    """
    names, found = measured_channels(nominal.study.session), list[tuple[str, NominalFit]]()
    shows, level = float(np.max(scores.z(), initial=0.0)), scores.level(options.detection.false_alarm)
    if len(names) < 2 or shows <= options.channel_apart.least_score * level:
        return None
    for name in _may_be_apart(nominal, names, options=options):
        without = _without_channel(nominal, name, options=options)
        if without is not None:
            found.append((name, without))
        if len(found) > 1:
            return None
    if not found:
        return None
    name, without = found[0]
    whole = _with_channel(without, name, nominal.study)
    return ChannelApart(name, _response(whole, name, options=options), whole)


def _may_be_apart(nominal: NominalFit, names: Sequence[str], *, options: DiagnosisOptions) -> list[str]:
    """The channels without which the equations linear at the stated valve come near the records, and nearer by far than
    with them; all of them where a fit to all is adequate, or the stated valve cannot be run.
    """
    study, stated = nominal.study, np.zeros(len(nominal.fit.point))
    if is_adequate(nominal.fit, options=options.identification):
        return list(names)
    try:
        linear = linearise_nominal(study, with_edges_searched(study, evaluate_fit(study, stated, ())))
    except (SolveError, InputError):
        return list(names)
    pairs = [(predictor.record, name) for predictor in study.predictors for name in predictor.record.outputs]
    channels = np.concatenate([np.full(len(study.expected_squares(*pair)), pair[1]) for pair in pairs])

    def left(others: np.ndarray) -> float:
        J, residual = linear.J[others], linear.fit.residual[others]
        limits = study.nominal.limits - linear.fit.point
        step = bounded_step(J.T @ J + np.eye(len(stated)), J.T @ residual - linear.fit.point, limits)
        return float(np.mean((residual - J @ step) ** 2))

    several = [name for name in names if np.any(channels != name)]
    beyond_noise = max(left(np.full(len(channels), True)) - 1.0, 0.0)
    most = min(options.channel_apart.largest_mean_square, 1.0 + options.channel_apart.left_share * beyond_noise)
    return [name for name in several if left(channels != name) < most]


def _without_channel(nominal: NominalFit, name: str, *, options: DiagnosisOptions) -> NominalFit | None:
    """The nominal valve fitted to all channels but one; None where it leaves an alarm. From the stated valve where that
    channel may have dragged the fit to all of them along, from where this one is where it is adequate.
    """
    study, records = nominal.study, []
    for record in (predictor.record for predictor in nominal.study.predictors):
        values, usable = ({c: v for c, v in each.items() if c != name} for each in (record.values, record.usable))
        records.append(replace(record, values=values, usable=usable))
    if not all(record.outputs for record in records):
        return None
    others = with_records(study.unweighted(), records, ())
    adequate = is_adequate(nominal.fit, options=options.identification)
    point = clipped_to_tolerance(nominal) if adequate else np.zeros(len(nominal.fit.point))
    try:
        most_left = options.channel_apart.most_left * nominal.fit.rows
        fit = fit_nominal_near(others, point, full_weight=not study.weights, most_left=most_left)
        if not is_adequate(fit.fit, options=options.identification):
            return None
        alarm, _ = detect(score_test(fit, fit.fit, options=options))
        if alarm and (reviewed := with_inputs_reviewed(fit)) is not fit:
            fit, (alarm, _) = reviewed, detect(score_test(reviewed, reviewed.fit, options=options))
    except (SolveError, InputError):
        return None
    return None if alarm else fit


def _with_channel(without: NominalFit, name: str, whole: Study) -> NominalFit:
    """A fit to all channels but one, with that channel as it is in a study of the whole of the same records."""
    records = []
    for other, one in ((p.record, q.record) for p, q in zip(without.study.predictors, whole.predictors, strict=True)):
        records.append(replace(other, values=one.values | other.values, usable=one.usable | other.usable))
    study = with_records(without.study, records, ()).with_noise({**whole.noise, **without.study.noise})
    return linearise_nominal(study, evaluate_fit(study, without.fit.point, ()))


def _response(nominal: NominalFit, name: str, *, options: DiagnosisOptions) -> str:
    """The response of second order by which a channel reads what the valve does by the others, in words; "" where none
    explains it.
    """
    study = nominal.study
    read = [
        ReadAgainst(p.record.time, x[name], p.record.values[name], p.record.usable[name],
                    study.noise[name, p.record.pace].deviation)
        for p, x in zip(study.predictors, nominal.fit.readings, strict=True) if name in p.record.outputs
    ]  # fmt: skip
    found = second_order_response(read, options=options.channel_apart)
    if found is None:
        return ""
    return f"a response of second order ({found[0]:.3g} Hz, damping ratio {found[1]:.2f}) explains it"


@dataclass(frozen=True, eq=False)
class ReadAgainst:
    """A channel's readings `y` (n,) over what the valve does by the others, `x` (n,), at `time` (n,) s; `usable` (n,)
    of them, whose noise has a deviation.
    """

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    usable: np.ndarray
    deviation: float


def second_order_response(read: Sequence[ReadAgainst], *, options: ChannelApartOptions) -> tuple[float, float] | None:
    """Natural frequency, Hz, and damping ratio of the response that explains the readings; None where it leaves more
    than noise, or a lag of first order with a delay no more than noise, or nearly as little: faults of the catalogue.
    """
    rate = min((len(one.time) - 1) / float(one.time[-1]) for one in read)
    y = np.concatenate([(one.y / one.deviation)[one.usable] for one in read])

    def left(respond: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """What is left (n,), in noise deviations, at the gain and bias that leave least."""
        parts = [
            np.column_stack([respond(one.time, one.x), np.ones(len(one.x))])[one.usable] / one.deviation for one in read
        ]
        x = np.concatenate(parts)
        return y - x @ np.linalg.lstsq(x, y)[0]

    def first_order(figures: np.ndarray) -> np.ndarray:
        lag, delay = np.exp(figures[0]), figures[1]
        return left(lambda time, x: np.interp(time - delay, time, _filtered(time, x, [lag, 1.0])))

    def second_order(figures: np.ndarray) -> np.ndarray:
        w, damping = np.exp(figures)
        return left(lambda time, x: _filtered(time, x, [1.0 / w**2, 2.0 * damping / w, 1.0]))

    lags = np.log([1e-3 / rate, 1e3 / rate])  # below and above these nothing changes
    within = ([lags[0], -np.inf], [lags[1], np.inf])
    plain = least_squares(first_order, [np.log(1.0 / rate), 0.0], x_scale=[1.0, 1.0 / rate], bounds=within)
    lowest, highest = options.frequencies[0] / 10.0, 0.4
    limits = np.log([[2.0 * np.pi * lowest * rate, 0.05], [2.0 * np.pi * highest * rate, 2.0]])
    starts = [np.log([2.0 * np.pi * share * rate, 0.7]) for share in options.frequencies]
    best = min((least_squares(second_order, start, bounds=limits) for start in starts), key=lambda one: float(one.cost))
    expected = 0.5 * len(y)  # of noise alone
    near = max(options.noise * expected, options.nearly_all * plain.cost)
    explained = expected + options.explained * (plain.cost - expected)
    if plain.cost <= options.noise * expected or best.cost > min(explained, near):
        return None
    w, damping = np.exp(best.x)
    return float(w / (2.0 * np.pi)), float(damping)


def _filtered(time: np.ndarray, x: np.ndarray, denominator: list[float]) -> np.ndarray:
    """A series (n,) on an even clock behind a filter of unit gain at rest, from rest, by straight lines between."""
    b, a, _ = cont2discrete(([1.0], denominator), time[1] - time[0], "foh")
    return x[0] + lfilter(np.ravel(b), a, x - x[0])
