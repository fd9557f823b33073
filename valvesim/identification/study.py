"""A session with everything that its fits share: prepared, and as a study once there is an estimate of its noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Self, TypeVar

import numpy as np

from valvesim.identification.candidates import Candidate, candidates_of
from valvesim.identification.noise_growth import grown, growth_notes, noise_growth
from valvesim.identification.noise_model import NoiseModel
from valvesim.identification.options import DEFAULT_IDENTIFICATION, IdentificationOptions
from valvesim.identification.predictor import RecordPredictor, prepare_record
from valvesim.identification.prior import NominalModel, nominal_model_of
from valvesim.identification.session import Record, Session
from valvesim.simulation.batch import cores
from valvesim.valve.catalogue import CATALOGUE


@dataclass(frozen=True, eq=False)
class PreparedSession:
    """A session with everything that its fits share but the noise: its variants can be run, not weighed."""

    session: Session
    nominal: NominalModel
    candidates: tuple[Candidate, ...]
    predictors: tuple[RecordPredictor, ...]
    representatives: tuple[int, ...]  # of each predictor, the first that runs as it does
    options: IdentificationOptions
    is_long: bool  # a look takes long, and what hardly helps is left
    spread: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, kw_only=True)
    """(record, channel): deviation (n,) of what readings hang on inputs between their samples, beside the noise."""
    discrepancy: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, kw_only=True)
    """The same of what the law of a cause may err by (model discrepancy; Kennedy and O'Hagan 2001)."""
    input_errors: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, kw_only=True)
    """(record, channel): realisations (n, k) of what readings hang on the noise of measured inputs."""
    noise_growth: dict[str, float] = field(default_factory=dict, kw_only=True)
    """Of channels whose noise grows with the reading (`noise_growth`)."""

    def with_noise(self, noise: dict[tuple[str, float], NoiseModel]) -> Study:
        """The study under a noise, by channel and pace."""
        return Study(**{f.name: getattr(self, f.name) for f in fields(PreparedSession)}, noise=noise)

    def negligible_reduction(self, chi_square: float, rows: float) -> float:
        """Reduction of the chi-square not worth a linearisation: a share of what a fit leaves beyond the noise, a
        larger one of what it leaves beyond adequate.
        """
        least = self.options.fit.relative_ftol * max(chi_square - rows, 0.0)
        return max(least, self.negligible_far_off(chi_square, rows))

    def negligible_far_off(self, chi_square: float, rows: float) -> float:
        """The share of what a fit leaves beyond adequate that is not worth a linearisation; below 0 where it is near
        the records.
        """
        fit = self.options.fit
        return fit.negligible_share * (chi_square - fit.inadequate_ratio * rows)

    def with_nominal(self, nominal: NominalModel) -> Self:
        """The same with other nuisance parameters, or inputs that are told otherwise between their samples."""
        return replace(self, nominal=nominal, representatives=_representatives(self.predictors, nominal))

    def with_discrepancy(self, discrepancy: dict[tuple[str, str], np.ndarray]) -> Self:
        """The same with a model discrepancy, (n,) by record and channel."""
        return replace(self, discrepancy=discrepancy)

    def without_oversampling(self) -> Self:
        """The study with its trajectories at the samples alone: the same readings, and preliminary sensitivities."""
        return replace(self, predictors=tuple(predictor.without_oversampling() for predictor in self.predictors))

    def each(self, function: Callable, *over: Sequence) -> list:
        """The function over the predictors or what belongs to them, on threads; what runs alike is worked out once."""
        own = sorted(set(self.representatives))
        found = dict(zip(own, each(function, *([one[k] for k in own] for one in over)), strict=True))
        return [found[k] for k in self.representatives]


@dataclass(frozen=True, eq=False)
class Study(PreparedSession):
    """A prepared session under a noise: what its fits leave is whitened by it, and rows may count less."""

    noise: dict[tuple[str, float], NoiseModel]
    weights: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)  # (record, channel): of its whitened rows

    @cached_property
    def stride(self) -> int:
        """Every how many of the whitened rows is kept: they are independent, so none is missed but for its weight."""
        rows = sum(len(b.record.time) * len(b.record.outputs) for b in self.predictors)
        return int(np.ceil(rows / self.options.fit.most_rows))

    def with_noise(self, noise: dict[tuple[str, float], NoiseModel]) -> Study:
        """The same at the same weights under another noise."""
        return replace(self, noise=noise)

    def unweighted(self) -> Study:
        """The study with all rows at full weight."""
        return replace(self, weights={})

    def whiten(self, predictor: RecordPredictor, columns: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Whitened columns (n, k) of a record, channel by channel."""
        return [rows * scale for rows, scale in self._filtered(predictor, columns)]

    def _filtered(
        self, predictor: RecordPredictor, columns: dict[str, np.ndarray]
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """The same not yet scaled, and what their rows are to be multiplied by, (n, 1) or (1, 1)."""
        record, found = predictor.record, []
        for name in record.outputs:
            noise, usable = self.noise[name, record.pace], record.usable[name]
            scale = self.weights.get((record.name, name), 1.0) / noise.innovation
            if wider := self._variances(record, name):
                scale = scale / np.sqrt(1.0 + np.sum(wider, axis=0)[noise.kept(usable)][:: self.stride])
            found.append((noise.filtered(columns[name], usable)[:: self.stride], np.reshape(scale, (-1, 1))))
        return found

    @cached_property
    def expected_rows(self) -> float:
        """The chi-square that noise alone leaves of the training records."""
        pairs = [(predictor.record, name) for predictor in self.predictors for name in predictor.record.outputs]
        return sum(float(np.sum(self.expected_squares(record, name))) for record, name in pairs)

    def expected_squares(self, record: Record, name: str) -> np.ndarray:
        """(rows,) mean square that noise alone leaves of each whitened row of a channel of a training record."""
        key, weights = (record.name, name), self.weights.get((record.name, name))
        count = len(record.time[self.noise[name, record.pace].kept(record.usable[name])][:: self.stride])
        squares = np.full(count, 1.0 / (1.0 + self._rounding_variances.get(key, 0.0)))
        return squares if weights is None else squares * weights**2

    def noise_near(self, channel: str, rate: float) -> NoiseModel | None:
        """The noise of a channel at the nearest rate that it was seen at; None where it was not."""
        seen = {pace: noise for (name, pace), noise in self.noise.items() if name == channel}
        return seen[min(seen, key=lambda pace: abs(np.log(pace / rate)))] if seen else None

    def whiten_other(self, record: Record, columns: dict[str, np.ndarray]) -> np.ndarray:
        """Whitened columns (rows, k) of a record that is none of the training records, of channels whose noise is known
        (`noise_near`); no rows where none is.
        """
        near = ((name, self.noise_near(name, record.pace)) for name in record.outputs)
        white = [noise.whiten(columns[name], record.usable[name]) for name, noise in near if noise is not None]
        return np.concatenate(white) if white else np.empty((0, 0))

    def log_determinant(self) -> float:
        """The log determinant of the noise covariance where readings may be off by the `spread`, less that without."""
        total = 0.0
        for predictor in self.predictors:
            record = predictor.record
            for name in record.outputs:
                if (spread := self.spread.get((record.name, name))) is not None:
                    noise = self.noise[name, record.pace]
                    whole = 1.0 + np.sum(self._variances(record, name), axis=0)
                    gained = np.log(whole / (whole - (spread / noise.innovation) ** 2))
                    total += float(np.sum(gained[noise.kept(record.usable[name])][:: self.stride]))
        return total

    def _variances(self, record: Record, name: str) -> list[np.ndarray]:
        """What a channel may be off by beside the noise, in variances (n,) of its innovation."""
        key, noise = (record.name, name), self.noise[name, record.pace]
        known = [one[key] for one in (self.spread, self.discrepancy) if key in one]
        of_inputs = [self._input_variances[key]] if key in self._input_variances else []
        of_level = [grown(self.noise_growth[name], record.values[name]) ** 2 - 1.0] if name in self.noise_growth else []
        rounding = self._rounding_variances.get(key)
        of_rounding = [np.full(len(record.time), rounding)] if rounding is not None else []
        return [(deviation / noise.innovation) ** 2 for deviation in known] + of_inputs + of_level + of_rounding

    @cached_property
    def _input_variances(self) -> dict[tuple[str, str], np.ndarray]:
        """(record, channel): variances (n,) of the innovation that count for the noise of inputs. The channels of a
        record feel one and the same noise: so many independent errors as they are come to no less.
        """
        records = {predictor.record.name: predictor.record for predictor in self.predictors}
        return {
            (record, name): len(records[record].outputs)
            * self.noise[name, records[record].pace].largest_variance(
                errors, self.options.input_noise.width, self.options.input_noise.lags
            )
            for (record, name), errors in self.input_errors.items()
            if record in records and name in records[record].outputs
        }

    @cached_property
    def _rounding_variances(self) -> dict[tuple[str, str], float]:
        """(record, channel): what the rounding of coarse channels comes to beside, in variances of the innovation."""
        found, realisations = {}, self.options.input_noise.realisations
        for record in (predictor.record for predictor in self.predictors):
            for name in record.outputs:
                noise = self.noise[name, record.pace]
                if noise.rounding_step:
                    whole = noise.rounding_variance(record.values[name], self.session.seed, realisations)
                    found[record.name, name] = max(whole - 1.0, 0.0)
        return found

    def with_weights(self, weights: Sequence[np.ndarray]) -> Study:
        """The study with weights (rows,) of each channel of each training record, in their order."""
        keys = [(predictor.record.name, name) for predictor in self.predictors for name in predictor.record.outputs]
        return replace(self, weights=dict(zip(keys, weights, strict=True)))

    def stack(self, columns: Sequence[dict[str, np.ndarray]]) -> np.ndarray:
        """Whitened columns of all training records, (rows, k)."""
        pairs = zip(self.predictors, columns, strict=True)
        parts = [part for predictor, each in pairs for part in self._filtered(predictor, each)]
        at = np.cumsum([0, *(len(rows) for rows, _ in parts)])
        white = np.empty((at[-1], parts[0][0].shape[1]))
        for k, (rows, scale) in enumerate(parts):
            np.multiply(rows, scale, out=white[at[k] : at[k + 1]])
        return white


Prepared = TypeVar("Prepared", bound=PreparedSession)


def each(function: Callable, *over: Sequence) -> list:
    """The function over sequences, on threads where there are cores for them: the integration lets others work."""
    threads = min(cores(), len(over[0]))
    if threads < 2:
        return list(map(function, *over))
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, *over))


def prepare_session(
    session: Session, more: Sequence = (), *, options: IdentificationOptions = DEFAULT_IDENTIFICATION
) -> PreparedSession:
    """A session prepared for its fits; `more` are effects that these may use beside the catalogue's."""
    growth = noise_growth(session, options=options)
    session = replace(session, notes=(*session.notes, *growth_notes(session, growth)))
    nominal = nominal_model_of(session, options=options)
    universe = (*CATALOGUE.values(), *session.user_effects, *more)
    predictors = tuple(prepare_record(session, record, universe, options=options) for record in session.training)
    return PreparedSession(
        session,
        nominal,
        candidates_of(session, nominal),
        predictors,
        _representatives(predictors, nominal),
        options,
        is_long=_is_long(predictors, options=options),
        noise_growth=growth,
    )


def _is_long(predictors: Sequence[RecordPredictor], *, options: IdentificationOptions) -> bool:
    return sum(len(predictor.times) for predictor in predictors) > options.fit.long_session


def _representatives(predictors: Sequence[RecordPredictor], nominal: NominalModel) -> tuple[int, ...]:
    """Of each predictor the first that runs as it does: none but itself where its inputs are fitted on their own."""
    own = {p.input.record for p in nominal.parameters if p.input is not None}
    as_run = [one.under(nominal.variant.deviations) for one in predictors]

    def alike(k: int, first: int) -> bool:
        both = {as_run[k].record.name, as_run[first].record.name}
        return first == k or (not both & own and as_run[first].runs_as(as_run[k]))

    return tuple(next(first for first in range(len(as_run)) if alike(k, first)) for k in range(len(as_run)))


def restricted_session(whole: PreparedSession, records: Sequence[Record]) -> PreparedSession:
    """The same of parts of the training records, in their order: the same nuisance parameters, the same candidates."""
    session = replace(whole.session, records=(*records, *whole.session.locked))
    predictors = tuple(
        prepare_record(session, r, b.universe, options=whole.options)
        for r, b in zip(records, whole.predictors, strict=True)
    )
    return PreparedSession(
        session,
        whole.nominal,
        whole.candidates,
        predictors,
        _representatives(predictors, whole.nominal),
        whole.options,
        is_long=_is_long(predictors, options=whole.options),
        noise_growth=whole.noise_growth,
    )


def with_records(prepared: Prepared, records: Sequence[Record], notes: Sequence[str]) -> Prepared:
    """The same with other samples usable in the training records, in their order, and more notes."""
    session = prepared.session
    found = {record.name: record for record in records}
    session = replace(
        session,
        records=tuple(found.get(record.name, record) for record in session.records),
        notes=(*session.notes, *notes),
    )
    predictors = tuple(replace(one, record=found.get(one.record.name, one.record)) for one in prepared.predictors)
    return replace(prepared, session=session, predictors=predictors)


def with_experiment(study: Study, predictor: RecordPredictor, replicates: int) -> Study:
    """The study with a further record, whose rows count as so many replicates of it; of channels whose noise is known.
    """
    record = predictor.record
    near = {name: study.noise_near(name, record.pace) for name in record.outputs}
    noise = {(name, record.pace): one for name, one in near.items() if one is not None}
    usable = {name: record.usable[name] for name, _ in noise}
    predictor = replace(predictor, record=replace(record, usable=usable))
    predictors = (*study.predictors, predictor)
    counting = {
        (record.name, name): np.full(int(one.kept(usable[name]).sum()), np.sqrt(replicates))
        for (name, _), one in noise.items()
    }
    return replace(
        study,
        predictors=predictors,
        representatives=_representatives(predictors, study.nominal),
        noise=study.noise | noise,
        weights=study.weights | counting,
    )


def without_test(prepared: PreparedSession, test: str) -> PreparedSession:
    """The same without the training records of one test, and without what was fitted of these alone."""
    session = prepared.session
    records = tuple(r for r in session.records if r.role != "train" or r.test != test)
    names = {record.name for record in records}
    nominal = prepared.nominal
    kept = tuple(p for p in nominal.parameters if p.input is None or p.input.record in names)
    nominal = replace(nominal, parameters=kept)
    predictors = tuple(one for one in prepared.predictors if one.record.name in names)
    return replace(
        prepared,
        session=replace(session, records=records),
        nominal=nominal,
        predictors=predictors,
        representatives=_representatives(predictors, nominal),
    )


def residual_of(record: Record, readings: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Measured minus read, by channel, as columns (n, 1)."""
    return {name: (record.values[name] - readings[name])[:, None] for name in record.outputs}
