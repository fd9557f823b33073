"""A valve in words: by what differs from the reference valve."""

from __future__ import annotations

import numpy as np

from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.parameters import Valve, reference_valve

MOST_CHANGES = 3  # of the reference valve that are named one by one


def valve_name(valve: Valve) -> str:
    """The valve in words: its name, or the reference valve with what differs from it where that is little."""
    if valve.name:
        return valve.name
    reference, changes = reference_valve(), []
    for name, field in quantities(valve).items():
        value = getattr(valve, name)
        if np.ndim(value):
            changes.append(f"{name.replace('_', ' ')} of a batch of {np.size(value)}")
        elif value != getattr(reference, name):
            unit, factor = DISPLAY.get(field.metadata["unit"], (field.metadata["unit"], 1.0))
            shown = "" if unit in ("1", "-") else f" {symbol(unit)}"
            changes.append(f"{name.replace('_', ' ')} {value * factor:.5g}{shown}")
    if valve.flow_coefficients is not reference.flow_coefficients:
        changes.append("another flow law")
    if not changes:
        return "reference valve"
    if len(changes) > MOST_CHANGES:
        return f"reference valve with {len(changes)} parameters changed"
    return f"reference valve with {', '.join(changes)}"
