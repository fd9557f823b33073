"""Picture: a recovered term over its variable, with its band and its formula."""

from __future__ import annotations

from textwrap import fill

import numpy as np

from valvesim.diagnosis.result import Diagnosis
from valvesim.reports.diagnosis.words import short, spoken, term_units
from valvesim.reports.plotting import EXTENDED_COLOUR, Figure, styled


@styled
def draw_term(diagnosis: Diagnosis) -> Figure | None:
    """A recovered term over its variable, with a band of two standard deviations, and its formula."""
    term = diagnosis.term
    if term is None or not term.at:
        return None
    order = np.argsort(term.at)
    at, value, deviation = (np.asarray(each, dtype=float)[order] for each in (term.at, term.value, term.deviation))
    (x_unit, x_factor), (y_unit, y_factor) = term_units(term)
    at, value, deviation = at * x_factor, value * y_factor, np.nan_to_num(deviation) * y_factor
    figure = Figure(figsize=(8.5, 4.4), layout="constrained")
    axis = figure.subplots()
    axis.axhline(0.0, color="0.6", lw=0.8)
    low, high = value - 2.0 * deviation, value + 2.0 * deviation
    axis.fill_between(at, low, high, color=EXTENDED_COLOUR, alpha=0.2, lw=0, label="±2 standard deviations")
    axis.plot(at, value, "o-" if len(at) <= 40 else "-", ms=3, color=EXTENDED_COLOUR, lw=1.6, label="recovered term")
    axis.set_xlabel(f"{short(spoken(term.variable))} [{x_unit or '-'}]")
    axis.set_ylabel(f"added to {short(spoken(term.port))} [{y_unit or '-'}]")
    axis.legend(loc="best")
    words = fill(f"formula, in SI units: {term.formula}", 90) if term.formula else "recovered term"
    axis.set_title(words, loc="left", pad=16.0)  # above the power of ten of small ticks
    return figure
