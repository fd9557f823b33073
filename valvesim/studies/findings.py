"""All that a page of a study shows: the result, indices of its figures, local sensitivities, and what to tighten."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvesim.errors import InputError
from valvesim.studies.local_sensitivity import LocalSensitivity, local_sensitivity
from valvesim.studies.members import make_plan, validity_warnings
from valvesim.studies.sensitivity_indices import SensitivityIndices, sensitivity_indices
from valvesim.studies.study_result import StudyResult
from valvesim.studies.tolerance_tightening import TighteningPlan, tightening_plan

MOST_FIGURES = 6  # whose indices are told: those with limits first


@dataclass(frozen=True)
class Findings:
    """A result with its sensitivities. `local` is None where they were left out, `tightening` without limits."""

    result: StudyResult
    indices: tuple[SensitivityIndices, ...]
    local: LocalSensitivity | None
    tightening: TighteningPlan | None
    note: str = ""  # why there is nothing to tell of tightening

    def local_shares(self, figure: str) -> np.ndarray:
        """Shares (variables,) of the linearised variance of a figure; NaN where there are none."""
        if self.local is None:
            return np.full(len(self.result.study.variables), np.nan)
        return self.local.shares[self.local.figures.index(figure)]


def find(
    result: StudyResult, *, wanted: float = 0.99, local: bool = True, progress: Callable[[str], None] | None = None
) -> Findings:  # fmt: skip
    """The findings of a study. `wanted` is the yield that tightening aims at; `progress` is told what is computed.

    Local sensitivities take two more runs of each quantity for figures that are not of a run.
    """
    tell = progress or (lambda what: None)
    limited = [criterion.figure.name for criterion in result.criteria]
    named = list(dict.fromkeys([*limited, *(figure.name for figure in result.figures)]))
    indices = []
    tell("sensitivity indices")
    for name in named[:MOST_FIGURES]:
        try:
            indices.append(sensitivity_indices(result, name))
        except InputError:
            continue  # it does not vary, or too few members have it
    own = None
    if local:
        tell("local sensitivities")
        with validity_warnings():
            plan = make_plan(result.study)
        own = local_sensitivity(result.study, plan)
    tightening, note = None, ""
    if result.criteria and result.study.design.rows is None:
        tell("tolerances to tighten")
        try:
            tightening = tightening_plan(result, wanted)
        except InputError as error:
            note = f"Nothing is told of tightening: {error}."
    return Findings(result, tuple(indices), own, tightening, note)
