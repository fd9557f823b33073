"""The answer of a diagnosis in words."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.result import AMBIGUOUS, CAUSE, NO_DISCREPANCY, Term
from valvesim.identification.candidates import Candidate
from valvesim.identification.measured_oscillation import MeasuredOscillation, Onset
from valvesim.identification.prior import NETWORK
from valvesim.identification.session import value_text
from valvesim.valve.thermal_network import heat_words

OTHERWISE = "that the parts follow the oil otherwise than assumed"


def summary_text(
    verdict: str,
    in_set: Sequence[FittedHypothesis],
    term: Term | None,
    inadequate: str = "",
    doubt: str = "",
    errors: str = "",
) -> str:
    """The answer in one sentence; `inadequate` says why nothing is named, `doubt` what it may be besides; of a
    healthy valve `inadequate` is what the bench did, and `errors` those of the instruments that none shows by itself.
    """
    if verdict == NO_DISCREPANCY and inadequate:
        return f"The bench, not the valve: {inadequate}; with that the model explains the records within their noise."
    if verdict == NO_DISCREPANCY and errors:
        beyond = f"what errors of the instruments explain together ({errors})"
        return f"No discrepancy beyond {beyond}; a cause may act so too."
    if verdict == NO_DISCREPANCY:
        return "No discrepancy: the model explains the records within their noise and its own tolerances."
    if verdict == CAUSE:
        return f"The cause is {cause_words(in_set[0])}."
    if verdict == AMBIGUOUS:
        causes = [*(cause_words(one) for one in in_set if one.candidates)]
        if doubt:
            other = f"; if none of them, it acts like {_term_words(term)}" if term is not None else ""
            return f"Something is wrong, perhaps {' or '.join(causes)}, or {doubt}{other}."
        if in_set[-1].candidates:
            return f"Something is wrong, and these cannot be told apart: {'; '.join(causes)}."
        return f"Something may be wrong, or noise alone shows it; it would be {' or '.join(causes)}."
    if inadequate:
        return f"Nothing is named: {inadequate}"
    if term is None:
        return "Something is wrong that none of the known causes explains."
    return f"Something is wrong that none of the known causes explains; it acts like {_term_words(term)}."


def _term_words(term: Term) -> str:
    return term.in_words() + (f", and nearly as well like {_first_labels(term.alike)}" if term.alike else "")


def _first_labels(labels: Sequence[str], most: int = 2) -> str:
    """A few labels in words, and how many more there are."""
    more = len(labels) - most
    return " or ".join(labels[:most]) + (f" (and {more} more)" if more > 0 else "")


def cause_words(one: FittedHypothesis) -> str:
    """A hypothesis in words: `sensor_bias@load_flow` as "sensor bias of load flow"."""
    return " together with ".join(map(candidate_words, one.candidates))


def oscillation_words(found: MeasuredOscillation) -> tuple[str, ...]:
    """How a valve oscillates by itself and which effects may have it do so; and in a sentence of its own which figures
    of the valve may.
    """
    records = "one record" if found.records == 1 else f"{found.records} records"
    told = (
        f"the measured valve oscillates by itself, at {found.frequency:.3g} Hz in {records}, whatever the inputs do, "
        "and the stated one does not"
    )
    effects, figures = (
        [_onset_words(one, found.rate) for one in found.onsets if (one.candidate.effect is None) == of_figure]
        for of_figure in (False, True)
    )
    by_effect = f"it would from {' or from '.join(effects)}" if effects else "no known effect would have it do so"
    by_figure = "figures of it that would, far from what is stated, are in the notes" if figures else "nor any figure"
    if figures or not effects:
        by_effect += f"; {by_figure}" if figures else f", {by_figure}"
    listed = (f"the stated valve would oscillate so from {', or from '.join(figures)}",) if figures else ()
    return f"{told}; {by_effect}", *listed


def _onset_words(onset: Onset, rate: float) -> str:
    c, above = onset.candidate, onset.above_neutral
    if c.effect is not None:
        value = (c.effect.amplitude.neutral or 0.0) + above
        size = f"{100.0 * value:.2g} % of" if c.unit == "1" else f"{value_text(value, c.unit)} of"
        on = "on" if above > 0.0 else "down"
    else:
        assert c.parameter is not None  # noqa: S101 - a candidate is either
        nominal = c.parameter.nominal
        change = np.expm1(above) if c.parameter.logarithmic else above / nominal if nominal else None
        by = f"{abs(change):.0%}".replace("%", " %") if change is not None else value_text(abs(above), c.unit)
        size, on = f"{by} {'more' if above > 0.0 else 'less'}", "on"
    seen = f", which samples at {rate:g} Hz show lower" if onset.frequency > rate / 2.0 else ""
    return f"{size} {candidate_words(c).removeprefix('the figure of ')} {on} (at {onset.frequency:.3g} Hz{seen})"


def candidate_words(c: Candidate) -> str:
    """A candidate in words."""
    if c.parameter is not None and c.parameter.of_network:
        return f"{OTHERWISE} ({heat_words(c.parameter.name.removeprefix(NETWORK))})"
    words = (("parameter:", "the figure of "), ("@", " of "), ("_", " "), ("[", ", "), ("]", ""), ("=", " "))
    return reduce(lambda text, word: text.replace(*word), words, c.label)


def location_text(verdict: str, in_set: Sequence[FittedHypothesis]) -> str:
    """Where the causes of an answer act: all of these places where it is sure of them, else one of them or more."""
    if verdict not in (CAUSE, AMBIGUOUS):
        return ""
    places = dict.fromkeys(place for one in in_set for c in one.candidates for place in c.location().split("; "))
    return (" and " if verdict == CAUSE else " or ").join(places)
