"""The options of planning: every threshold with its unit, meaning and where its value comes from.

`plan_tests(bench, options=PlanningOptions(...))` passes them on. See `valvesim.options`.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.options import JUDGEMENT, option


@dataclass(frozen=True, kw_only=True)
class OutlookOptions:
    """What is told of causes and parameters."""

    combination_share: float = option(
        1e-4,
        "1",
        "share of a column's size that others leave of it, up to which it is taken to be their combination",
        JUDGEMENT,
    )
    unseen_distance: float = option(
        1e-3, "1", "noise deviations in all by which a prior deviation moves the readings: less is none", JUDGEMENT
    )
    hardly: float = option(
        0.9, "1", "share of its prior deviation that a parameter keeps of which next to nothing is told", JUDGEMENT
    )
    known: float = option(0.5, "1", "share of it from which a parameter is known", JUDGEMENT)
    partner: float = option(0.8, "1", "correlation from which two parameters are told together alone", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class ChoiceOptions:
    """The choice of tests."""

    power: float = option(0.9, "1", "power with which a goal counts as reached", JUDGEMENT)
    exhaustive: int = option(
        12, "1", "tests whose subsets are all tried; of more, those that are not needed are left out in turn", "2^12"
    )


@dataclass(frozen=True, kw_only=True)
class PlanFileOptions:
    """What a plan file may ask for."""

    least_samples: int = option(100, "1", "samples that a test has at least", JUDGEMENT)
    most_samples: int = option(2_000_000, "1", "samples that it has at most", "memory")
    highest_rate: float = option(100e3, "Hz", "highest sampling rate", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class StructureOptions:
    """The structure of the equations."""

    probes: int = option(5, "1", "random states at which a variable may show in an equation", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class PlanningOptions:
    """All options of planning, a stage each; `diagnosis` are those of the diagnosis that is planned for."""

    diagnosis: DiagnosisOptions = DiagnosisOptions()
    outlook: OutlookOptions = OutlookOptions()
    choice: ChoiceOptions = ChoiceOptions()
    file: PlanFileOptions = PlanFileOptions()
    structure: StructureOptions = StructureOptions()


DEFAULT_PLANNING = PlanningOptions()
