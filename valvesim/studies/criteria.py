"""What a member must keep to pass: limits of figures of merit, of the study's file or of a specification.

A figure that a member lacks (it failed, or its record does not give it) does not pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.figure_of_merit import FigureOfMerit, unit_shown, unit_to_parse
from valvesim.characterisation.specification import FIGURES, UNSIGNED, Limit, Specification, judge
from valvesim.errors import InputError, unknown_name
from valvesim.studies.figures import RESPONSE_FIGURES, RIG_TESTS, KeptFigure
from valvesim.units import parse


@dataclass(frozen=True)
class FigureLimit:
    """Limits of a figure by name: numbers in SI, text with a unit, or none."""

    figure: str
    low: float | str | None = None
    high: float | str | None = None


@dataclass(frozen=True)
class Criterion:
    """A figure within `low`..`high`; `either_way` is judged by its size. `source` says who asks for it."""

    figure: KeptFigure
    low: float
    high: float
    either_way: bool = False
    source: str = ""

    def judged(self, values: np.ndarray) -> np.ndarray:
        """What the limits are held against, (k,)."""
        return np.abs(values) if self.either_way else values

    def passes(self, values: np.ndarray) -> np.ndarray:
        """Whether each of the values (k,) is within; NaN is not."""
        judged = self.judged(values)
        return (judged >= self.low) & (judged <= self.high)

    def margin(self, values: np.ndarray) -> np.ndarray:
        """Distance (k,) to the nearer limit, in the figure's unit: negative outside, -inf for NaN."""
        judged = self.judged(values)
        return np.where(np.isnan(judged), -np.inf, np.minimum(judged - self.low, self.high - judged))

    @property
    def words(self) -> str:
        """The limits in words, with the unit that people read."""
        unit, factor = unit_shown(self.figure.unit)
        ends = (("at least", self.low), ("at most", self.high))
        told = ", ".join(f"{word} {value * factor:.6g} {unit}".strip() for word, value in ends if np.isfinite(value))
        return f"size {told}" if self.either_way else told


def criteria_of(
    figures: Sequence[KeptFigure], nominal: np.ndarray, limits: Sequence[FigureLimit],
    specification: Specification | None,
) -> tuple[tuple[Criterion, ...], tuple[str, ...]]:  # fmt: skip
    """(criteria, names of limits of the specification that no kept figure shows).

    Raises InputError for a limit of a figure that is not kept, or the wrong way round.
    """
    known = {figure.name: figure for figure in figures}
    criteria = []
    for limit in limits:
        if limit.figure not in known:
            raise unknown_name("figure of merit that is kept", limit.figure, known, "limits")
        low, high = (_number(end, known[limit.figure], f"limits.{limit.figure}") for end in (limit.low, limit.high))
        low, high = (-np.inf if low is None else low), (np.inf if high is None else high)
        if not low < high or np.isinf([low, high]).all():
            raise InputError("needs low below high, or one of them", key=f"limits.{limit.figure}", joint=" ")
        criteria.append(Criterion(known[limit.figure], low, high, source="limits"))
    unjudged: list[str] = []
    if specification is not None:
        shown, unjudged = _shown(figures, nominal, specification)
        criteria += shown
    return tuple(criteria), tuple(unjudged)


def _number(end: float | str | None, figure: KeptFigure, where: str) -> float | None:
    if isinstance(end, str):
        return parse(end, unit_to_parse(figure.unit), where)
    return None if end is None else float(end)


def _shown(
    figures: Sequence[KeptFigure], nominal: np.ndarray, specification: Specification
) -> tuple[list[Criterion], list[str]]:
    """Criteria of a specification's limits, by `judge`, which knows what shows what at which conditions."""
    measured, own = [], {}
    for figure, value in zip(figures, nominal, strict=True):
        family, _, rest = figure.name.partition(".")
        test, _, name = rest.partition(".")
        at = {"amplitude": float(test.partition("_")[2]) / 100.0} if family == "response" else {}
        told = FigureOfMerit(rest if family == "bench" else name, float(value), figure.unit, figure.doc)
        if family in ("bench", "response"):
            measured.append((told, at))
            own[id(told)] = figure
    criteria, unjudged = [], []
    for judgement in judge(specification, measured):
        limit, shown = judgement.limit, own.get(id(judgement.measured))
        if shown is None:
            unjudged.append(limit.figure)
        elif np.isfinite([limit.low, limit.high]).any():
            source = specification.title or "specification"
            criteria.append(Criterion(shown, limit.low, limit.high, _either_way(limit), source))
    return criteria, unjudged


def _either_way(limit: Limit) -> bool:
    return limit.figure in UNSIGNED and (limit.low >= 0.0 or np.isinf(limit.low))


def figures_for(specification: Specification) -> tuple[str, ...]:
    """Names of the figures that show what a specification limits; where several tests show one, of the first test."""
    names = []
    for limit in specification.limits:
        shown = FIGURES[limit.figure].shown_by
        first = next((test for name in shown if (test := name.partition(".")[0]) in RIG_TESTS), None)
        for name in shown:
            if first is not None and name.partition(".")[0] == first:
                names.append(f"bench.{name}")
            elif name in RESPONSE_FIGURES:
                names.append(f"response.{RESPONSE_FIGURES[name]}_{100.0 * limit.conditions['amplitude']:g}.{name}")
    return tuple(dict.fromkeys(names))
