"""Picture: how strongly the foremost candidates show, beside the level of the alarm."""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.result import Diagnosis
from valvesim.reports.diagnosis.words import answer_labels, short, spoken
from valvesim.reports.plotting import EXTENDED_COLOUR, NOMINAL_COLOUR, Figure, styled

MOST_SCORES = 12  # that are shown, the strongest


@styled
def draw_scores(diagnosis: Diagnosis) -> Figure | None:
    """How strongly the foremost candidates show, with the level of the alarm; those of the answer in colour."""
    scores = sorted((s for s in diagnosis.scores if np.isfinite(s.z)), key=lambda s: -abs(s.z))[:MOST_SCORES]
    if not scores:
        return None
    answer = answer_labels(diagnosis)
    figure = Figure(figsize=(8.5, 1.3 + 0.3 * len(scores)), layout="constrained")
    axis = figure.subplots()
    sizes, places = [abs(s.z) for s in scores], range(len(scores))
    colours = [EXTENDED_COLOUR if s.label in answer else "0.75" for s in scores]
    bars = axis.barh(places, sizes, color=colours, height=0.68)
    plate = {"facecolor": "w", "edgecolor": "none", "pad": 1.0}  # so that the level does not cross a number
    axis.bar_label(bars, [f"{s.z:.1f}" for s in scores], padding=5, fontsize=8, bbox=plate)
    axis.set_yticks(places, [short(spoken(s.label)) for s in scores])
    axis.invert_yaxis()
    axis.grid(False, axis="y")
    axis.set_axisbelow(True)
    axis.tick_params(axis="y", length=0)
    level = diagnosis.alarm_level if np.isfinite(diagnosis.alarm_level) else 0.0
    axis.set_xlim(0.0, 1.12 * max(*sizes, level, 1.0))
    if level > 0.0:
        axis.axvline(level, color=NOMINAL_COLOUR, ls="--", label=f"alarm level {level:.2f}")
        figure.legend(loc="outside upper right")
    axis.set_xlabel("|z|, strength against noise [-]")
    blue = " (in blue: in the answer)" if answer & {s.label for s in scores} else ""
    axis.set_title(f"strength of each candidate{blue}", loc="left")
    return figure
