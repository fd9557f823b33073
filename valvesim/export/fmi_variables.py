"""The exported valve's variables as FMI tells them: references, causality, units, dependencies, for both versions.

The order of the list is the order of `modelDescription.xml`; FMI 2.0 counts from one in it, FMI 3.0 goes by reference.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from valvesim.export.traced_valve import TracedValve, ValveVariable
from valvesim.units import DISPLAY, fmi_base_unit

REFERENCES = {"parameter": 1000, "input": 2000, "state": 3000, "derivative": 4000, "output": 5000}
"""First value reference of each kind; the C code has the same figures."""
LEAST = 1e-300  # shown in place of an open lower bound at zero, which XML readers would round to zero


@dataclass(frozen=True, kw_only=True)
class FmiVariable:
    """A variable of the description. `derivative_of` and `dependencies` are value references."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None
    unit: str
    display_unit: str | None
    doc: str
    start: float | None
    low: float | None
    high: float | None
    nominal: float | None
    derivative_of: int | None = None
    dependencies: tuple[int, ...] | None = None


def fmi_variables(valve: TracedValve) -> tuple[FmiVariable, ...]:
    """Time, parameters, inputs, states, derivatives, outputs. The command's rate only where the equations feel it."""
    depends = _dependencies(valve)
    time = FmiVariable(
        name="time", reference=0, causality="independent", variability="continuous", initial=None, unit="s",
        display_unit=None, doc="time", start=None, low=None, high=None, nominal=None,
    )  # fmt: skip
    variables = [time]
    variables += [
        _variable(one, "parameter", k, "parameter", "tunable", "exact") for k, one in enumerate(valve.parameters)
    ]
    variables += [
        _variable(one, "input", k, "input", "continuous", None)
        for k, one in enumerate(valve.inputs)
        if k != RATE or valve.uses_rate
    ]
    for k, one in enumerate(valve.states):
        initial = "calculated" if one.start is None else "exact"
        reference = REFERENCES["state"] + k
        variables.append(_variable(one, "state", k, "output", "continuous", initial, dependencies=(reference,)))
    for k, one in enumerate(valve.states):
        of = REFERENCES["state"] + k
        rate = ValveVariable(name=f"der({one.name})", unit=_rate_unit(one.unit), doc=f"rate of change of {one.name}")
        about = _variable(rate, "derivative", k, "local", "continuous", "calculated", of, depends[k])
        variables.append(about)
    for k, one in enumerate(valve.outputs):
        found = depends[len(valve.states) + k]
        variables.append(_variable(one, "output", k, "output", "continuous", "calculated", None, found))
    return tuple(variables)


RATE = 1  # the place of the command's rate among the inputs


def _variable(
    one: ValveVariable, kind: str, k: int, causality: str, variability: str, initial: str | None,
    derivative_of: int | None = None, dependencies: tuple[int, ...] | None = None,
) -> FmiVariable:  # fmt: skip
    display = DISPLAY.get(one.unit)
    low = None if math.isinf(one.low) else max(one.low, LEAST) if 0.0 < one.low < LEAST else one.low
    return FmiVariable(
        name=one.name, reference=REFERENCES[kind] + k, causality=causality, variability=variability, initial=initial,
        unit=one.unit, display_unit=display[0] if display and display[0] != one.unit else None, doc=one.doc,
        start=one.start if causality in ("parameter", "input") or initial == "exact" else None, low=low,
        high=None if math.isinf(one.high) else one.high, nominal=one.scale if kind in ("state", "input") else None,
        derivative_of=derivative_of, dependencies=dependencies,
    )  # fmt: skip


def _dependencies(valve: TracedValve) -> list[tuple[int, ...]]:
    """References of the states and inputs on which each derivative, then each output depends."""
    n = len(valve.states)
    found: list[list[int]] = [[] for _ in range(n + len(valve.outputs))]
    for row, column in zip(*valve.dependence.get_triplet(), strict=True):
        if column != n + RATE or valve.uses_rate:
            found[row].append(
                REFERENCES["state"] + column if column < n else REFERENCES["input"] + column - n
            )  # fmt: skip
    return [tuple(sorted(row)) for row in found]


def _rate_unit(unit: str) -> str:
    if unit == "degC":
        return "K/s"
    if unit == "1":
        return "1/s"
    return unit[:-2] + "/s^2" if unit.endswith("/s") else f"{unit}/s"


def unit_definitions(variables: Sequence[FmiVariable]) -> list[dict[str, Any]]:
    """Every unit: its name, exponents of SI base units with `factor` and `offset`, and its display units."""
    displays: dict[str, tuple[str, float]] = {}
    for one in variables:
        if one.display_unit is not None:
            displays[one.unit] = DISPLAY[one.unit]
    units = []
    for name in sorted({one.unit for one in variables}):
        display = [{"name": displays[name][0], "factor": displays[name][1]}] if name in displays else []
        units.append({"name": name, "base": fmi_base_unit(name), "displays": display})
    return units


def model_identifier(title: str) -> str:
    """A title as the C identifier by which FMI calls a model and its files."""
    words = re.sub(r"[^0-9A-Za-z]+", "_", title.encode("ascii", "ignore").decode()).strip("_").lower()[:60]
    return words if words and words[0].isalpha() else f"valve_{words}".rstrip("_")
