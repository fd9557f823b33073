"""What the paper states in numbers: the drifts of its section IV, and the ranges and tolerances they are held to.

Source: Yan, Liu, Ma, IEEE Access 2019, sections II to V.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from valvesim.valve.fluid import YH12_PAPER

Progress = Callable[[str, float], None]

OIL = replace(YH12_PAPER, rated_high=270.0)  # the paper uses its oil up to 270 °C; no warning for repeating it
RANGE = np.linspace(20.0, 270.0, 51)  # °C, of Figs. 3 and 14 to 18
EXPERIMENT_RANGE = np.linspace(20.0, 95.0, 31)  # °C, of section V
CURRENTS = (1e-3, 2e-3, 5e-3, 10e-3)  # A; the paper's "different currents" are not told
TOLERANCE = 0.05  # a published drift counts as reached within 5 % of itself


@dataclass(frozen=True, kw_only=True)
class PublishedDrift:
    """A drift that section IV states: size in percent, direction (0: not told) and where it stands."""

    key: str
    title: str
    size: float
    direction: int
    source: str

    @property
    def target(self) -> float:
        """Signed where the direction is told."""
        return self.size * (self.direction or 1)


_SECTION_4 = "section IV, Figs. 15-16"
PUBLISHED_DRIFTS = (
    PublishedDrift(key="flow", title="flow coefficients", size=16.01, direction=-1, source=_SECTION_4),
    PublishedDrift(key="orifice", title="orifice size", size=2.88, direction=+1, source=_SECTION_4),
    PublishedDrift(key="mmf", title="magnetomotive force", size=3.168, direction=+1, source=_SECTION_4),
    PublishedDrift(key="gap", title="air gaps", size=0.9648, direction=0, source=_SECTION_4),
    PublishedDrift(key="reluctance", title="magnet reluctance", size=0.163, direction=-1, source=_SECTION_4),
    PublishedDrift(key="arm", title="armature arm", size=0.163, direction=-1, source=_SECTION_4),
    PublishedDrift(key="tube", title="spring tube", size=0.700, direction=+1, source=_SECTION_4),
    PublishedDrift(key="rod", title="feedback rod", size=0.065, direction=+1, source=_SECTION_4),
    PublishedDrift(key="total", title="all routes, largest", size=15.6, direction=-1, source="section IV, Fig. 17"),
    PublishedDrift(key="knee", title="all routes, at 40 °C", size=15.6, direction=-1, source="section IV, Fig. 17"),
    PublishedDrift(
        key="total_5mA", title="all routes, largest at 5 mA", size=15.6, direction=-1, source="section IV, Fig. 18"
    ),
)
"""What the identification aims at, in the order of its residuals."""

PUBLISHED_GAP_DRIFT = 6.0  # %, "the thickness of each gap drifts by 6%", opposite ways, Fig. 3
PUBLISHED_FIT_ERRORS = (1.3, 0.27)  # %, largest errors of C_df and C_d0, below Eq. 19
PUBLISHED_TRAVEL = 2.5  # %, "below 2.5% for a current of 1mA", of the nozzle gap, below Eq. 19
PUBLISHED_MMF_LOSS = 5.0  # %, "will drop by about 5%", below Eq. 5
