"""What came of a study, read from its store: members, yield with its interval, percentiles, capability, worst cases."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.studies import channel_histogram
from valvesim.studies.criteria import Criterion, criteria_of
from valvesim.studies.figures import KeptFigure
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.store import (
    COUNTS_ARRAY,
    DONE_ARRAY,
    DRAWS_ARRAY,
    FIGURES_ARRAY,
    HIGHEST_ARRAY,
    LOWEST_ARRAY,
    REASONS_ARRAY,
    STORE_NAME,
    TIME_ARRAY,
    WHOLE_ARRAY,
    check_identity,
)
from valvesim.studies.variables import Case

CONFIDENCE = 0.95
LEVELS = (1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0)  # %, of the figures of merit


@dataclass(frozen=True)
class Yield:
    """Members that pass, of all that have run and are independent, with the interval of the share (Clopper, Pearson).

    It is that of independent draws: a stratified design is the more exact, by how much is not told.
    """

    passed: int
    members: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Share that passes."""
        return self.passed / self.members


def yield_of(passes: np.ndarray) -> Yield:
    """The yield of members (n,) of bool."""
    from scipy.stats import binomtest

    passed, members = int(np.count_nonzero(passes)), len(passes)
    interval = binomtest(passed, members).proportion_ci(CONFIDENCE, method="exact")
    return Yield(passed, members, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Capability:
    """Process capability of a figure within its limits: `index` is Cpk with its interval (Bissell 1990).

    `by_quantiles` is the same from the quantiles 0.135, 50 and 99.865 % (ISO 22514-2), for what is not normal; NaN
    where there are too few members to tell them.
    """

    index: float
    low: float
    high: float
    by_quantiles: float


def capability_of(criterion: Criterion, values: np.ndarray) -> Capability:
    """The capability of values (n,), those that are numbers; NaN for fewer than two or no spread."""
    from scipy.stats import norm

    judged = criterion.judged(values[np.isfinite(values)])
    n = len(judged)
    spread = float(np.std(judged, ddof=1)) if n > 1 else 0.0
    if not spread > 0.0:
        return Capability(np.nan, np.nan, np.nan, np.nan)
    mean = float(np.mean(judged))
    index = min(mean - criterion.low, criterion.high - mean) / (3.0 * spread)
    error = float(norm.ppf(0.5 + CONFIDENCE / 2.0)) * np.sqrt(1.0 / (9.0 * n) + index**2 / (2.0 * (n - 1)))
    by_quantiles = np.nan
    if n >= 1000:
        low, middle, high = np.quantile(judged, [0.00135, 0.5, 0.99865])
        sides = [(middle - criterion.low) / (middle - low) if middle > low else np.inf,
                 (criterion.high - middle) / (high - middle) if high > middle else np.inf]  # fmt: skip
        by_quantiles = float(min(sides))
    return Capability(float(index), float(index - error), float(index + error), by_quantiles)


@dataclass(frozen=True)
class StudyResult:
    """The store of a study, opened: arrays are read when they are asked for. `finished` tells whether all have run."""

    study: ParameterStudy
    folder: Path
    group: Any
    attributes: dict[str, Any]

    def _read(self, name: str, where: Any = slice(None)) -> np.ndarray:
        """An array of the store, or a part of it. InputError where its file is damaged."""
        try:
            return np.asarray(self.group[name][where])
        except Exception as error:  # a codec has errors of many kinds for what it did not write
            problem = f"array {name!r} cannot be read ({error}): the store is damaged; remove it and run again"
            raise InputError(problem, file=self.folder / STORE_NAME) from None

    @property
    def figures(self) -> tuple[KeptFigure, ...]:
        """The figures of merit that were kept."""
        return tuple(KeptFigure(f["name"], f["unit"], f["doc"]) for f in self.attributes["figures"])

    @property
    def nominal(self) -> np.ndarray:
        """Figures of merit of the nominal member, (figures,)."""
        return np.array([np.nan if f["nominal"] is None else f["nominal"] for f in self.attributes["figures"]])

    @functools.cached_property
    def ran(self) -> np.ndarray:
        """Whether each member has run, (members,)."""
        done = self._read(DONE_ARRAY)
        return np.repeat(done, self.attributes["block_size"])[: self.attributes["members"]]

    @property
    def finished(self) -> bool:
        """Whether all members have run."""
        return bool(self.ran.all())

    @functools.cached_property
    def draws(self) -> np.ndarray:
        """What each member has, (members, variables)."""
        return self._read(DRAWS_ARRAY)

    @functools.cached_property
    def values(self) -> np.ndarray:
        """Figures of merit (members, figures), NaN where there are none."""
        return self._read(FIGURES_ARRAY)

    @functools.cached_property
    def reasons(self) -> np.ndarray:
        """Why a figure is missing, (members,) of text; most share one that is empty."""
        told = np.full(len(self.ran), "", dtype=object)
        size = self.attributes["block_size"]
        for first in range(0, len(told), size):
            given = self._read(REASONS_ARRAY, slice(first, first + size))
            for k in np.flatnonzero(given != b""):
                told[first + k] = given[k].decode()
        return told

    @functools.cached_property
    def independent(self) -> np.ndarray:
        """Members that have run and are drawn independently, (members,): of a Saltelli design its two base samples."""
        if self.study.design.kind != "saltelli":
            return self.ran
        place = np.arange(len(self.ran)) % (len(self.study.variables) + 2)
        return self.ran & ((place == 0) | (place == len(self.study.variables) + 1))

    def column(self, figure: str) -> np.ndarray:
        """One figure of merit of all members, (members,)."""
        return self.values[:, [f.name for f in self.figures].index(figure)]

    @functools.cached_property
    def criteria(self) -> tuple[Criterion, ...]:
        """What a member must keep to pass."""
        return self._criteria[0]

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Figures of the specification that no kept figure shows."""
        return self._criteria[1]

    @functools.cached_property
    def _criteria(self) -> tuple[tuple[Criterion, ...], tuple[str, ...]]:
        return criteria_of(self.figures, self.nominal, self.study.limits, self.study.specification)

    @functools.cached_property
    def passes(self) -> np.ndarray:
        """Whether each member that has run keeps every limit, (members,); one that failed does not."""
        passes = self.ran.copy()
        for criterion in self.criteria:
            passes &= criterion.passes(self.column(criterion.figure.name))
        return passes & np.isfinite(self.values).any(axis=1)

    @property
    def yield_(self) -> Yield:
        """The yield against all limits. InputError without limits or members."""
        if not self.criteria:
            raise InputError("no limits: a yield needs [limits] or a specification", key="limits")
        self._check_any()
        return yield_of(self.passes[self.independent])

    def yield_by(self, criterion: Criterion) -> Yield:
        """The yield against one limit alone."""
        self._check_any()
        return yield_of(criterion.passes(self.column(criterion.figure.name)[self.independent]))

    def capability(self, criterion: Criterion) -> Capability:
        """Cpk of one limit."""
        return capability_of(criterion, self.column(criterion.figure.name)[self.independent])

    def _check_any(self) -> None:
        if not self.ran.any():
            raise InputError("no member has run yet", file=self.folder)

    def worst(self, criterion: Criterion, count: int = 10) -> np.ndarray:
        """Numbers of the members (count,) that are nearest to or farthest beyond a limit, the worst first."""
        margin = criterion.margin(self.column(criterion.figure.name))
        order = np.argsort(np.where(self.ran, margin, np.inf), kind="stable")
        return order[: min(count, int(self.ran.sum()))]

    def extremes(self, figure: str) -> tuple[int, int]:
        """Numbers of the members of the least and the greatest value of a figure; InputError where none has one."""
        column = self.column(figure)
        if not np.isfinite(column).any():
            raise InputError("no member has this figure", key=figure)
        return int(np.nanargmin(column)), int(np.nanargmax(column))

    def member(self, number: int) -> Case:
        """The case of a member by its number, to be run again. InputError where there is none."""
        if not 0 <= number < len(self.ran):
            raise InputError(f"{number} is no member: they are numbered 0 to {len(self.ran) - 1}", key="member")
        return self.study.member(self.draws[number])

    @property
    def percentiles(self) -> Any:
        """Percentiles of channels over time: an xarray.DataArray (channel, level, time), or None without."""
        return None if self.study.percentiles is None else self.dataset["percentile"]

    @functools.cached_property
    def dataset(self) -> Any:
        """All of it as one xarray.Dataset: draw, figure, reason, ran, and what was kept over time."""
        import xarray

        told = self.attributes
        keys, names = [p["key"] for p in told["parameters"]], [f["name"] for f in told["figures"]]
        columns: dict[str, Any] = {
            "draw": (("member", "parameter"), self.draws),
            "figure_of_merit": (("member", "figure"), self.values),
            "reason": ("member", self.reasons),
            "ran": ("member", self.ran),
            "nominal": ("figure", self.nominal),
        }
        coordinates: dict[str, Any] = {
            "member": np.arange(told["members"]), "parameter": keys, "figure": names,
            "parameter_unit": ("parameter", [p["unit"] for p in told["parameters"]]),
            "figure_unit": ("figure", [f["unit"] for f in told["figures"]]),
        }  # fmt: skip
        if "percentiles" in told:
            own = told["percentiles"]
            columns["percentile"] = (("channel", "level", "sample_time"), self._percentiles(own))
            columns["nominal_run"] = (("channel", "sample_time"), np.array(own["nominal"]))
            time = self._read(TIME_ARRAY)[own["samples"]]
            coordinates |= {
                "channel": [c["name"] for c in own["channels"]], "level": own["levels"], "sample_time": time,
                "channel_unit": ("channel", [c["unit"] for c in own["channels"]]),
            }  # fmt: skip
        if "whole" in told:
            own = told["whole"]
            columns["run"] = (("kept_member", "kept_channel", "time"), self._read(WHOLE_ARRAY))
            coordinates |= {
                "kept_member": own["members"], "kept_channel": [c["name"] for c in own["channels"]],
                "time": self._read(TIME_ARRAY),
                "kept_channel_unit": ("kept_channel", [c["unit"] for c in own["channels"]]),
            }  # fmt: skip
        attributes = {"title": told["title"], "source": "valvesim", "seed": told["seed"], "design": told["design"]}
        return xarray.Dataset(columns, coordinates, attributes)

    def _percentiles(self, own: dict[str, Any]) -> np.ndarray:
        """(channels, levels, n_t), from the counts of all blocks added up one at a time."""
        counts = np.zeros(self.group[COUNTS_ARRAY].shape[1:], dtype=np.int64)
        for block in range(self.group[COUNTS_ARRAY].shape[0]):
            counts += self._read(COUNTS_ARRAY, block)
        lowest, highest = np.min(self._read(LOWEST_ARRAY), axis=0), np.max(self._read(HIGHEST_ARRAY), axis=0)
        reference = channel_histogram.Reference(np.array(own["nominal"]), np.array(own["spans"]))
        return channel_histogram.percentiles(counts, reference, lowest, highest, np.array(own["levels"]))


def open_result(study: ParameterStudy, folder: Path) -> StudyResult:
    """The result of a study from its folder, whole or as far as it has run. InputError for another study's store."""
    import zarr

    path = Path(folder) / STORE_NAME
    try:
        group = zarr.open_group(path, mode="r", zarr_format=2)
        attributes = dict(group.attrs)
    except Exception as error:  # zarr has errors of many kinds for what is no store
        raise InputError(f"is no store of a study ({error})", file=path) from None
    check_identity(path, attributes, study)
    return StudyResult(study, Path(folder), group, attributes)
