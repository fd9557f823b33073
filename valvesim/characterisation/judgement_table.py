"""Limits, conditions and judgements as people and as machines read them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit, merit_cells, unit_shown
from valvesim.characterisation.specification import CONDITIONS, FIGURES, Judgement, Limit, Verdict

Tests = Sequence[tuple[str, Mapping[str, float], FiguresOfMerit]]
"""Tests: title, conditions in SI, figures."""
FIGURE_HEADINGS = ("figure of merit", "value", "± (1 sigma)", "unit", "meaning")
VERDICT_HEADINGS = ("figure", "condition", "limits", "measured", "±", "unit", "verdict")


def value_cells(value: float, unit: str, uncertainty: float | None = None) -> tuple[str, str, str]:
    """(value, uncertainty, unit) as text in the unit that people read; empty where there is none."""
    if math.isnan(value):
        return "", "", ""
    return merit_cells(FigureOfMerit("", value, unit, "", uncertainty))


def interval_text(value: float, low: float, high: float, unit: str) -> tuple[str, str, str]:
    """(value, its 95 % interval, unit) of a parameter or figure as text: three digits of half of it, small lengths in
    um.
    """  # fmt: skip
    shown_unit, factor = ("", 1.0) if unit == "1" else unit_shown(unit)
    if unit == "m" and max(abs(low), abs(high)) < 1e-4:
        shown_unit, factor = "um", 1e6
    digits = int(2 - math.floor(math.log10((high - low) / 2.0 * factor))) if high > low else 6
    texts = [f"{round(v * factor, digits) + 0.0:.{max(digits, 0)}f}" for v in (value, low, high)]
    if digits > 6:
        texts = [f"{v * factor:.3g}" for v in (value, low, high)]
    return texts[0], f"{texts[1]} to {texts[2]}", shown_unit


def limit_text(limit: Limit) -> str:
    """The limits of a figure, such as `34.2 to 41.8 L/min` or `at most 3 %`; its value where it has no limits."""
    (low, _, unit), (high, _, _) = (value_cells(end, limit.unit) for end in (limit.low, limit.high))
    _, _, unit = value_cells(0.0, limit.unit)
    if math.isinf(limit.low) and math.isinf(limit.high):
        return f"{value_cells(limit.value, limit.unit)[0]} {unit}".strip()
    if math.isinf(limit.low):
        return f"at most {high} {unit}".strip()
    if math.isinf(limit.high):
        return f"at least {low} {unit}".strip()
    return f"{low} to {high} {unit}".strip()


def asked_text(limit: Limit) -> str:
    """What is aimed at: a value with its tolerance, such as `38.0 ± 3.8 L/min`, else as `limit_text` has it."""
    width = (limit.high - limit.low) / 2.0
    if not math.isfinite(width) or not math.isclose(limit.value, limit.low + width, rel_tol=1e-6, abs_tol=1e-6 * width):
        return limit_text(limit)
    value, tolerance, unit = value_cells(limit.value, limit.unit, width)
    return f"{value} ± {tolerance} {unit}".strip()


def condition_text(conditions: Mapping[str, float], common: Iterable[str] = ()) -> str:
    """Conditions in words, such as `amplitude 40 %, pressure drop 70 bar`; those of `common` are left out."""
    told = []
    for name, value in conditions.items():
        if name not in common:
            text, _, unit = value_cells(value, CONDITIONS[name].unit)
            told.append(f"{name.replace('_', ' ')} {text} {'K' if unit == 'K' else unit}".strip())
    return ", ".join(told)


def judgement_rows(judged: Sequence[Judgement], common: Iterable[str] = ()) -> list[tuple[str, ...]]:
    """Rows under `VERDICT_HEADINGS`; a figure that was not measured says why."""
    rows: list[tuple[str, ...]] = []
    for one in judged:
        limit = one.limit
        told = (_judged_name(one), condition_text(limit.conditions, common), limit_text(limit))
        if isinstance(one.measured, Absent):
            rows.append((*told, one.measured.reason, "", "", one.verdict.value))
        else:
            rows.append((*told, *merit_cells(one.measured), one.verdict.value))
    return rows


def _judged_name(judged: Judgement) -> str:
    """The figure in words; of one that several tests or polarities show, which of them, such as `flow gain (flow
    positive)`.
    """  # fmt: skip
    figure = judged.limit.figure
    shown_as = judged.measured.name.replace(figure, "").replace(".", " ").replace("_", " ").split()
    several = len(FIGURES[figure].shown_by) > 1 and shown_as
    return figure.replace("_", " ") + (f" ({' '.join(shown_as)})" if several else "")


def rows_of(tests: Tests, judged: Sequence[Judgement] = ()) -> list[dict[str, Any]]:
    """A row in SI for each figure, then one for each verdict, for machines; None for what there is not.

    `uncertainty` is one standard deviation, `note` the meaning of a figure, or why there is none.
    """
    rows = [
        {"test": title, "figure": figure.name, "conditions": _plain(at), **_record(figure), "low": None, "high": None,
         "verdict": None}
        for title, at, figures in tests for figure in figures
    ]  # fmt: skip
    return rows + [
        {"test": "verdict", "figure": one.limit.figure, "conditions": _plain(one.limit.conditions),
         **_record(one.measured), "low": _finite(one.limit.low), "high": _finite(one.limit.high),
         "verdict": one.verdict.value}
        for one in judged
    ]  # fmt: skip


def _plain(conditions: Mapping[str, float]) -> str:
    """Conditions in SI as one text."""
    return ", ".join(f"{name}={value:.6g}" for name, value in conditions.items())


def _record(figure: FigureOfMerit | Absent) -> dict[str, Any]:
    if isinstance(figure, Absent):
        return {"value": None, "unit": None, "uncertainty": None, "note": figure.reason}
    return {"value": figure.value, "unit": figure.unit, "uncertainty": figure.uncertainty, "note": figure.doc}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def failed(judged: Sequence[Judgement]) -> bool:
    """Whether any figure fails."""
    return any(one.verdict == Verdict.FAIL for one in judged)
