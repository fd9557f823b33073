"""A footnote on the words that the page of a diagnosis uses."""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.result import Diagnosis
from valvesim.reports.html_page import Section, Terms, section


def glossary(diagnosis: Diagnosis) -> Section:
    """The words that this page uses, and no others."""
    are_fitted = all(np.isfinite(one.deviance_fall) for one in diagnosis.candidates)
    several = len(diagnosis.candidates) > 1 and are_fitted
    given = "given these records" if are_fitted else "before any record, for none of them could be fitted"
    words = {
        "Noise deviation": (
            "standard deviation of a sensor's noise. An error of 1 is noise alone; below that nothing can be seen.",
            diagnosis.errors or diagnosis.gain,
        ),
        "z": (
            "how many standard deviations a candidate's pattern stands out of what the nominal model leaves, after its "
            "parameters have taken what they can; between -2 and 2 most of the time where nothing is hidden.",
            diagnosis.scores,
        ),
        "Nuisance parameters": (
            "what the nominal model is refitted in before any cause is looked for, each held by its tolerance.",
            diagnosis.shifts,
        ),
        "Deviance": (
            "sum of squared errors in noise deviations, with the squared shifts of the parameters: the more it falls, "
            "the more a candidate explains. No model is the valve itself, so probabilities are more cautious than the "
            "deviance alone.",
            several,
        ),
        "Probability": (
            f"among the candidates on this page, {given}; causes that nobody thought of are in it only as "
            "'none of the known'.",
            diagnosis.candidates,
        ),
        "95 % interval": ("holds the true value in 95 of 100 such sessions.", diagnosis.parameters or diagnosis.gain),
        "Hold-out record": ("locked away before the search and opened once, after it.", diagnosis.gain),
        "Distance": (
            "how far apart the two candidates' readings would lie, over all samples of the test, in noise deviations.",
            diagnosis.next_test,
        ),
    }
    return section("Words", Terms([(word, text) for word, (text, used) in words.items() if used], in_a_row=False))
