"""Picture: the error on each hold-out record before and after the extension, beside the noise floor."""

from __future__ import annotations

from typing import Any

import numpy as np

from valvesim.diagnosis.result import Diagnosis
from valvesim.reports.diagnosis.words import extended_differs, relative_change, short
from valvesim.reports.plotting import EXTENDED_COLOUR, NOMINAL_COLOUR, Figure, styled


@styled
def draw_gain(diagnosis: Diagnosis) -> Figure | None:
    """Error before and after on each hold-out record beside the noise floor, and its change with the interval."""
    gains = [g for g in diagnosis.gain if np.isfinite((g.before, g.after, g.floor)).all()]
    if not gains or not extended_differs(diagnosis):
        return None
    figure = Figure(figsize=(9.5, 1.8 + 0.42 * len(gains)), layout="constrained")
    errors, changes = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [1.5, 1.0]})
    for k, g in enumerate(gains):
        face = EXTENDED_COLOUR if g.claimed else "w"
        errors.plot([g.before, g.after], [k, k], color="0.8", lw=3, zorder=1)
        errors.plot([g.floor] * 2, [k - 0.3, k + 0.3], color="0.25", lw=2, label="noise floor")
        errors.plot(g.before, k, "s", color=NOMINAL_COLOUR, ms=7, label="nominal model")
        errors.plot(g.after, k, "o", color=EXTENDED_COLOUR, mfc=face, ms=7, label="extended model")
        change, low, high = relative_change(g)
        changes.plot([low, high], [k, k], "|-", color=EXTENDED_COLOUR, lw=1.6, ms=9, label="95 % interval")
        changes.plot(change, k, "o", color=EXTENDED_COLOUR, mfc=face, ms=7)
    names = [short(g.record) + ("" if g.claimed else "\n(not claimed)") for g in gains]
    errors.set_yticks(range(len(gains)), names)
    errors.set_ylim(len(gains) - 0.4, -0.6)
    errors.set_xlim(left=0.0)
    errors.set_xlabel("error [noise deviations]")
    errors.set_title("error on the hold-out records", loc="left")
    changes.axvline(0.0, color="0.25", lw=1.0)
    changes.set_xlabel("change of the mean square [%]")
    changes.set_title("change; left of zero is better", loc="left")
    for axis in (errors, changes):
        axis.grid(False, axis="y")
        axis.tick_params(axis="y", length=0)
    shown: dict[str, Any] = {}
    for axis in (errors, changes):
        for line, text in zip(*axis.get_legend_handles_labels(), strict=True):
            shown.setdefault(text, line)
    figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=4)
    return figure
