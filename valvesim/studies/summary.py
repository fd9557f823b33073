"""The result of a study as tables of text."""

from __future__ import annotations

import numpy as np

from valvesim.studies.figures import scale_of
from valvesim.studies.study_result import StudyResult, Yield


def percent(share: float) -> str:
    """A share as people read it."""
    return f"{100.0 * share:.4g} %"


def interval_text(one: Yield) -> str:
    """The interval of a yield."""
    return f"{percent(one.low)} to {percent(one.high)}"


def figure_rows(result: StudyResult) -> list[tuple[str, ...]]:
    """Rows (name, unit, nominal, mean, deviation, percentiles, least, member, greatest, member)."""
    rows = []
    for k, figure in enumerate(result.figures):
        unit, factor = scale_of(figure.unit)
        values = result.values[:, k] * factor
        own = values[np.isfinite(values)]
        nominal = f"{result.nominal[k] * factor:.5g}" if np.isfinite(result.nominal[k]) else "absent"
        if not len(own):
            rows.append((figure.name, unit, nominal, *["absent"] * 9))
            continue
        deviation = f"{np.std(own, ddof=1):.3g}" if len(own) > 1 else ""
        least, greatest = result.extremes(figure.name)
        rows.append(
            (figure.name, unit, nominal, f"{np.mean(own):.5g}", deviation,
             *(f"{value:.5g}" for value in np.percentile(own, (1.0, 50.0, 99.0))),
             f"{values[least]:.5g}", str(least), f"{values[greatest]:.5g}", str(greatest))
        )  # fmt: skip
    return rows


def limit_rows(result: StudyResult, worst: int = 3) -> list[tuple[str, ...]]:
    """Rows (figure, limits, yield, its interval, Cpk, its interval, worst members) of the limits."""
    rows: list[tuple[str, ...]] = []
    for criterion in result.criteria:
        own, capability = result.yield_by(criterion), result.capability(criterion)
        told = f"{capability.low:.3g} to {capability.high:.3g}" if np.isfinite(capability.index) else ""
        index = f"{capability.index:.3g}" if np.isfinite(capability.index) else "absent"
        members = ", ".join(str(number) for number in result.worst(criterion, worst))
        name, words, share = criterion.figure.name, criterion.words, percent(own.share)
        rows.append((name, words, share, interval_text(own), index, told, members))
    return rows
