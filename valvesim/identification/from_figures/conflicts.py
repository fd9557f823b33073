"""Which figures exclude each other: what is out of its limits, and which other figure would have to go for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from valvesim.identification.from_figures.posterior import Posterior, descend
from valvesim.identification.from_figures.prediction import Asked, FigurePredictor
from valvesim.identification.from_figures.similarity import UNKNOWNS

_LAWS = (
    (
        {"pressure_gain", "pressure_gain_share", "null_leakage", "flow_gain", "rated_flow", "flow_at_rated", "lap"},
        "the lands' opening at null sets all of them: pressure gain is flow gain over the slope of the leakage with "
        "the load pressure, so a sharp null leaks little",
    ),
    (
        {"frequency_minus_3_db", "frequency_minus_90_deg", "amplitude_ratio", "phase_lag", "time_to_90_percent",
         "rise_time", "tare_leakage", "null_leakage"},
        "the pilot's flow moves the spool: its speed is at most pilot flow over spool area, and that flow is leakage",
    ),
    (
        {"frequency_minus_3_db", "frequency_minus_90_deg", "amplitude_ratio", "phase_lag", "time_to_90_percent",
         "rise_time", "overshoot"},
        "they are of one response: loop gain, armature frequency and damping set amplitude, phase and step together",
    ),
    (
        {"rated_flow", "flow_at_rated", "flow_gain", "linearity"},
        "flow gain times rated current is the rated flow, times the root of the pressure drops",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Conflict:
    """A figure that is not reached; `against` would let it be, one by one, and `reason` says what ties them."""

    figure: Asked
    reached: float
    against: tuple[Asked, ...]
    reason: str


def conflicts_of(
    posterior: Posterior, predictor: FigurePredictor, *, progress: Callable[[float], None] | None = None
) -> tuple[Conflict, ...]:  # fmt: skip
    """Every figure that the fit leaves out of its limits, with the figures that keep it there.

    Of those that the fit misses most each is left out in turn, and the rest fitted again.
    """
    out = [k for k, (a, v) in enumerate(zip(posterior.asked, posterior.predicted, strict=True)) if not a.reached(v)]
    if not out:
        return ()
    options = predictor.options.conflict
    against: dict[int, list[Asked]] = {k: [] for k in out}
    start = np.zeros(len(posterior.point))  # where the fit ended, figures that exclude each other have bent it
    misfits = [abs(a.misfit(float(v))) for a, v in zip(posterior.asked, posterior.predicted, strict=True)]
    foremost = np.argsort(-np.array(misfits))[: options.most_left_out].tolist()
    for done, j in enumerate(foremost, start=1):
        left_out = posterior.asked[j]
        rest = tuple(asked for asked in posterior.asked if asked is not left_out)
        refit = descend(posterior.similar, replace(predictor, asked=rest), start, evaluations=options.evaluations)
        for k in out:
            asked = posterior.asked[k]
            if k != j and asked.reached(refit.predicted[rest.index(asked)]):
                against[k].append(left_out)
        if progress is not None:
            progress(done / len(foremost))
    return tuple(
        Conflict(posterior.asked[k], float(posterior.predicted[k]), tuple(against[k]),
                 _reason(posterior, posterior.asked[k], against[k], options.far))
        for k in out
    )  # fmt: skip


def _reason(posterior: Posterior, figure: Asked, against: list[Asked], far: float) -> str:
    if against:
        names = {figure.limit.figure, *(asked.limit.figure for asked in against)}
        laws = [(len(names & law), -len(law), text) for law, text in _LAWS if figure.limit.figure in law]
        shared, _, text = max(laws, default=(0, 0, ""))
        return text if shared > 1 else "no valve near similarity has both"
    farthest = np.argsort(-np.abs(posterior.point))[:2]
    told = ", ".join(
        f"{UNKNOWNS[k].name.replace('_', ' ')} {posterior.point[k]:+.1f}"
        for k in farthest
        if abs(posterior.point[k]) > far
    )
    beyond = f" (it would take {told} spreads from similarity)" if told else ""
    return f"no single other figure stands in its way: a valve of this size does not reach it{beyond}"
