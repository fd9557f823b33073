"""What no valve can do: lose less angle than its magnet loses, nor more by its arm than that allows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.paper.route_drift import drifts
from valvesim.paper.unknowns import LOST_VALUES, valves
from valvesim.valve.coefficients import ROUTES
from valvesim.valve.parameters import reference_valve


@dataclass(frozen=True, kw_only=True)
class MagnetCheck:
    """The inequality theta ~ M0/(K - k M0^2) over random valves, 20 to 270 °C at 1 mA, balances as derived."""

    drawn: int
    stable: int
    mmf_loss: float  # %, loss of M0 itself
    losses: np.ndarray  # (stable,) %, loss of angle by the magnetomotive force alone
    stiffness: np.ndarray  # (stable,) net stiffness over the springs' own

    @property
    def exceptions(self) -> int:
        """Stable valves that lose less of their angle than M0 loses of itself."""
        return int(np.sum(self.losses < self.mmf_loss))


DRAWN = 20000  # random valves for the inequality


def check_magnet(*, seed: int = 0, drawn: int | None = None) -> MagnetCheck:
    """theta ~ M0/(K - k M0^2): a stable valve loses at least the share of angle that M0 loses. Checked, not assumed.

    Random valves inside the bounds of `LOST_VALUES`; those that are unstable, or leave their null gap, are left out.
    """
    drawn = DRAWN if drawn is None else drawn
    shares = np.random.default_rng(seed).random((drawn, len(LOST_VALUES)))
    row = ROUTES.index("mmf")
    losses, stiffness = [], []
    for part in np.array_split(shares, max(1, drawn // 2000)):
        d = drifts(valves(part), temperatures=(20.0, 270.0), steps=10)
        keep = (d.stiffness > 0.0) & (d.mechanical > 0.0) & (d.travel[0] < 1.0)
        losses.append(-d.by_route[row, keep, -1])
        stiffness.append(d.stiffness[keep])
    valve = reference_valve()
    loss = -100.0 * valve.polarization_mmf_slope * 250.0 / valve.polarization_mmf
    lost = np.concatenate(losses)
    return MagnetCheck(
        drawn=drawn, stable=len(lost), mmf_loss=loss, losses=lost, stiffness=np.concatenate(stiffness)
    )  # fmt: skip


ARM_GROWTH = reference_valve().pole_expansion * 250.0
"""Relative growth of the armature's arm from 20 to 270 °C, of Table 1 alone."""


def mmf_drift_implied_by_arm(arm_drift: float) -> float:
    """The drift by magnetomotive force, %, that a published drift by the armature's arm implies (opposite in sign).

    At small angle torque and magnetic spring hold a and M0 only as the product a M0: theta ~ m/(1 + x (m^2 - 1)) with
    m the product over its value at 20 °C and 1 - 2 x = S its sensitivity there. The arm grows by a_c dT.
    """
    valve = reference_valve()
    sensitivity = arm_drift / 100.0 / ARM_GROWTH
    m = 1.0 + valve.polarization_mmf_slope * 250.0 / valve.polarization_mmf
    x = (1.0 - sensitivity) / 2.0
    return 100.0 * (m / (1.0 + x * (m * m - 1.0)) - 1.0)
