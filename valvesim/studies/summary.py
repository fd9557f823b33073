"""The result of a study as tables of text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from valvesim.characterisation.figure_of_merit import unit_shown

if TYPE_CHECKING:
    from valvesim.studies.findings import Findings
    from valvesim.studies.study_result import StudyResult, Yield
    from valvesim.studies.tolerance_tightening import Tightening

LEAST_EFFECTIVE = 50.0  # members: below, the weights rest on a few


def percent_text(share: float) -> str:
    """A share as people read it."""
    return f"{100.0 * share:.4g} %"


def yield_interval_text(one: Yield) -> str:
    """The interval of a yield."""
    return f"{percent_text(one.low)} to {percent_text(one.high)}"


def figure_rows(result: StudyResult) -> list[tuple[str, ...]]:
    """Rows (name, unit, nominal, mean, deviation, percentiles, least, member, greatest, member)."""
    rows = []
    for k, figure in enumerate(result.figures):
        unit, factor = unit_shown(figure.unit)
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
        name, words, share = criterion.figure.name, criterion.words, percent_text(own.share)
        rows.append((name, words, share, yield_interval_text(own), index, told, members))
    return rows


def share_text(value: float, error: float) -> str:
    """A share of the variance with half the width of its interval."""
    return "" if np.isnan(value) else f"{100.0 * value:.3g} ± {100.0 * error:.2g} %"


def index_rows(findings: Findings, figure: str, most: int = 12) -> list[tuple[str, ...]]:
    """Rows (quantity, first order, total, local share) of a figure, the greatest first."""
    indices = next(one for one in findings.indices if one.figure == figure)
    local = findings.local_shares(figure)
    own = ["" if np.isnan(share) else f"{100.0 * share:.3g} %" for share in local]
    return [
        (indices.keys[k], share_text(indices.first[k], indices.first_error[k]),
         share_text(indices.total[k], indices.total_error[k]), own[k])
        for k in indices.order[:most]
    ]  # fmt: skip


def halved_rows(findings: Findings, most: int = 10) -> list[tuple[str, ...]]:
    """Rows (quantity, yield with its tolerance halved, gain, the same by weights ± error), greatest gain first."""
    plan = findings.tightening
    if plan is None:
        return []
    return [
        (next(iter(one.factors)), percent_text(one.share), f"{100.0 * (one.share - plan.now.share):+.3g} %",
         _weighted_text(one))
        for one in plan.halved[:most]
    ]  # fmt: skip


def _weighted_text(one: Tightening) -> str:
    """The yield by weighted members, where it rests on enough of them."""
    enough = one.effective >= LEAST_EFFECTIVE
    return f"{percent_text(one.weighted)} ± {100.0 * one.error:.2g} %" if enough else "too few"


def step_rows(findings: Findings) -> list[tuple[str, ...]]:
    """Rows (step, tolerances times, yield, the same by weights ± error) towards the wanted yield."""
    plan = findings.tightening
    if plan is None:
        return []
    return [
        (str(k), ", ".join(f"{key} x {factor:.3g}" for key, factor in one.factors.items()), percent_text(one.share),
         _weighted_text(one))
        for k, one in enumerate(plan.steps, start=1)
    ]  # fmt: skip


def plan_words(findings: Findings) -> str:
    """What tightening comes to, in a sentence; empty where nothing is to be told."""
    plan = findings.tightening
    if plan is None:
        return findings.note
    if plan.now.share >= plan.wanted:
        return f"The wanted yield of {percent_text(plan.wanted)} is reached without tightening."
    if plan.reached:
        last = plan.steps[-1]
        told = ", ".join(f"{key} to {100.0 * factor:.3g} %" for key, factor in last.factors.items())
        return f"{percent_text(plan.wanted)} is reached by tightening {told} of its tolerance."
    most = plan.steps[-1].share if plan.steps else plan.now.share
    return (
        f"{percent_text(plan.wanted)} is not reached by tightening (only {percent_text(most)}): a limit is too near "
        "the nominal valve, or what spreads is no tolerance."
    )


def failure_rows(result: StudyResult, most: int = 12) -> list[tuple[str, ...]]:
    """Rows (members, first member, reason) of what is missing, by the reason without its numbers."""
    kinds: dict[str, list[int]] = {}
    for k in np.flatnonzero(result.ran & (result.reasons != "")):
        kinds.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", str(result.reasons[k])), []).append(int(k))
    ordered = sorted(kinds.values(), key=len, reverse=True)
    return [(str(len(found)), str(found[0]), str(result.reasons[found[0]])) for found in ordered[:most]]


def variable_rows(result: StudyResult) -> list[tuple[str, ...]]:
    """Rows (quantity, unit, nominal, distribution, meaning) of what varies."""
    return [
        (v.key, v.quantity.unit, "" if np.isnan(v.quantity.nominal) else f"{v.quantity.nominal:.6g}",
         v.distribution.words, v.quantity.doc)
        for v in result.study.variables
    ]  # fmt: skip
