"""The paper's figures and tables recomputed, and the valve of its lost Table 4 identified: all of it together.

Source: Yan, Liu, Ma, IEEE Access 2019, sections II to V; docs/site/physics.md for its misprints.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from valvesim.paper.determination import Determination, determine
from valvesim.paper.flow_fits import FlowFits, flow_fits
from valvesim.paper.identification import SCREENED, STARTS, PaperIdentification, identify_lost_values
from valvesim.paper.interpretations import INTERPRETATIONS
from valvesim.paper.magnet import ARM_GROWTH, MagnetCheck, check_magnet, mmf_drift_implied_by_arm
from valvesim.paper.published import CURRENTS, EXPERIMENT_RANGE, OIL, PUBLISHED_DRIFTS, RANGE, Progress
from valvesim.paper.reach import Reach, reach
from valvesim.paper.route_drift import FIT_CURRENTS, FIT_TEMPERATURES, Drifts, drift_values, drifts
from valvesim.paper.torque_motor import AirGaps, GapFlux, air_gaps, gap_flux
from valvesim.valve.coefficients import ROUTES
from valvesim.valve.equilibrium import static_solution
from valvesim.valve.flow_coefficients import flow_coefficients_reynolds
from valvesim.valve.parameters import flow_coefficients_yan_2019, reference_valve


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Everything on the page."""

    seed: int
    starts: int
    screened: int  # random valves, of which the best are refined
    gaps: AirGaps
    flux: GapFlux
    fits: FlowFits
    magnet: MagnetCheck
    identified: dict[str, PaperIdentification]
    determined: dict[str, Determination]
    reached: dict[str, dict[str, Reach]]
    curves: dict[str, Drifts]  # of the reference valve ("reference") and of each identified one, over RANGE
    experiment: dict[str, Drifts]  # the same over EXPERIMENT_RANGE
    reference_values: np.ndarray  # (11,) %, the reference valve's drifts, turned
    reference_sense: int
    reference_flow_drifts: tuple[float, float]  # %, its flow route at 270 °C: Eq. 19, Re law with the real oil
    arm_growth: float  # relative, of the armature's arm from 20 to 270 °C
    mmf_implied: float  # %, drift by magnetomotive force that the published drift by the arm implies
    polynomial_error: float  # largest relative difference from `static_solution` over RANGE

    def sense(self, key: str) -> int:
        """-1 where a valve's drifts must be turned for its flow coefficients to count as the published ones."""
        return self.identified[key].interpretation.sense if key in self.identified else self.reference_sense


def compute(*, seed: int = 0, starts: int = STARTS, progress: Progress | None = None) -> Reproduction:
    """Recompute all of the paper that its text lets one compute. `progress` gets (what, share from 0 to 1)."""
    tell = progress or (lambda text, share: None)
    tell("torque motor, oil and flow coefficients", 0.0)
    reference = reference_valve()
    gaps, flux, fits = air_gaps(), gap_flux(reference, np.linspace(1e-3, 10e-3, 10)), flow_fits()
    tell("the magnet's inequality over random valves", 0.05)
    magnet = check_magnet(seed=seed)

    def within(low: float, high: float) -> Progress:
        return lambda text, share: tell(text, low + (high - low) * share)

    identified = {
        interpretation.key: identify_lost_values(
            interpretation, seed=seed, starts=starts, progress=within(0.1 + 0.14 * k, 0.24 + 0.14 * k)
        )
        for k, interpretation in enumerate(INTERPRETATIONS)
    }
    determined, reached = {}, {}
    for k, key in enumerate(("derived", "printed")):
        determined[key] = determine(identified[key], progress=within(0.66 + 0.16 * k, 0.74 + 0.16 * k))
        reached[key] = reach(identified[key], seed=seed, progress=within(0.74 + 0.16 * k, 0.82 + 0.16 * k))
    cases = {"reference": (reference, False)} | {
        key: (found.valve, found.interpretation.printed_signs) for key, found in identified.items()
    }

    def curves(temperatures: np.ndarray) -> dict[str, Drifts]:
        return {
            key: drifts(valve, printed_signs=signs, temperatures=temperatures, currents=CURRENTS, steps=10)
            for key, (valve, signs) in cases.items()
        }

    whole = curves(RANGE)
    direct = static_solution(reference, current=CURRENTS[0], temperature=RANGE, oil=OIL).armature_angle
    at_fit = drifts(reference, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS, steps=10)
    laws = (flow_coefficients_yan_2019, flow_coefficients_reynolds)
    row = ROUTES.index("flow")
    sense = -1 if drift_values(at_fit, FIT_TEMPERATURES)[0, row] > 0.0 else 1
    return Reproduction(
        seed=seed,
        starts=starts,
        screened=SCREENED,
        gaps=gaps,
        flux=flux,
        fits=fits,
        magnet=magnet,
        identified=identified,
        determined=determined,
        reached=reached,
        curves=whole,
        experiment=curves(EXPERIMENT_RANGE),
        reference_values=sense * drift_values(at_fit, FIT_TEMPERATURES)[0],
        reference_sense=sense,
        reference_flow_drifts=tuple(  # type: ignore[arg-type]
            float(drifts(replace(reference, flow_coefficients=law)).by_route[row, 0, -1]) for law in laws
        ),
        arm_growth=ARM_GROWTH,
        mmf_implied=mmf_drift_implied_by_arm(-PUBLISHED_DRIFTS[5].size),
        polynomial_error=float(np.max(np.abs(whole["reference"].angle[0, 0] / direct - 1.0))),
    )  # fmt: skip
