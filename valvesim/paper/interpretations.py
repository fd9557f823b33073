"""How the paper may be read: its balances as derived or as printed, Eq. 19 in °C or in temperature rise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvesim.valve.parameters import flow_coefficients_yan_2019


def flow_coefficients_as_printed(oil_temperature):
    """Eq. 19 as it is printed, in dT = T - 20 °C. Only for the question whether the paper's curves came from it."""
    return flow_coefficients_yan_2019(np.asarray(oil_temperature, dtype=float) - 20.0)


@dataclass(frozen=True, kw_only=True)
class Interpretation:
    """How the balances, Eq. 19 and the stated directions are taken."""

    key: str
    title: str
    printed_signs: bool
    directions: bool = True
    sense: int = 1
    """+1: the directions of `PUBLISHED_DRIFTS` are those of the angle; -1: all of them the other way round."""
    flow_coefficients: Callable = flow_coefficients_yan_2019


INTERPRETATIONS = (
    Interpretation(key="derived", title="as derived", printed_signs=False),
    Interpretation(key="derived_sizes", title="as derived, sizes only", printed_signs=False, directions=False),
    Interpretation(key="printed", title="signs as printed", printed_signs=True),
    Interpretation(
        key="printed_rise", title="signs and Eq. 19 as printed", printed_signs=True,
        flow_coefficients=flow_coefficients_as_printed,
    ),
)  # fmt: skip
