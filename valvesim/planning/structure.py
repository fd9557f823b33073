"""Structural detectability and isolability: what the equations' structure allows at all, whatever the figures.

Symbols
    M the equations, each a set of unknown variables; M+ its overdetermined part (Dulmage and Mendelsohn 1958): what
    can be reached from the equations that no maximum matching covers, along alternating paths; e_f the equation of
    fault f. f is detectable where e_f is in M+, and isolable from g where e_f is in (M without e_g)+
Source: Blanke, Kinnaert, Lunze, Staroswiecki, Diagnosis and Fault-Tolerant Control; Krysander and Frisk 2008.

The structure is found at random states: a variable stands in an equation where a small change of it changes what the
equation gives. Equations are the rates of the states, the derivatives that join both, and one for each sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS
from valvesim.planning.options import DEFAULT_PLANNING, StructureOptions
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.effect import Effect
from valvesim.valve.equations import AT_20, Model
from valvesim.valve.parameters import Valve


@dataclass(frozen=True)
class StructuralModel:
    """Equations by name, each the set of its unknown variables, and the equation of each fault."""

    equations: Mapping[str, frozenset[str]]
    faults: Mapping[str, str]


def structural_model(
    valve: Valve, channels: Sequence[str], effects: Mapping[str, Effect], *,
    options: StructureOptions = DEFAULT_PLANNING.structure,
) -> StructuralModel:
    """The structure of a valve with sensors on these channels; `effects` are the faults by name.

    A fault that enters several equations is an unknown of all of them, with an equation of its own.
    """
    rng = np.random.default_rng(0)
    model = Model()
    states = [channel.name for channel in model.state_channels]
    scales = np.array([channel.scale for channel in model.state_channels])
    level = np.array([valve.supply_pressure / 2.0 if channel.unit == "Pa" else 0.0 for channel in model.state_channels])
    inputs = (0.3 * valve.rated_current, 0.0, valve.supply_pressure, valve.return_pressure, 0.1 * valve.supply_pressure)
    points = [tuple(level + 0.3 * scales * rng.uniform(-1.0, 1.0, len(scales))) for _ in range(options.probes)]
    flat = model.flat_coefficients(valve.at(AT_20), ())
    signals = [channel.name for channel in SIGNAL_CHANNELS if channel.name in channels]

    def outputs(state: tuple, own: Model = model, coefficients: Sequence = flat) -> dict[str, float]:
        memory = (0.1,) * (len(own.state_channels) - len(states))
        rates, found = own.evaluate((*state, *memory), inputs, tuple(coefficients))
        return {**{f"rate of {name}": float(rates[k]) for k, name in enumerate(states)},
                **{name: float(getattr(found, name)) for name in signals}}  # fmt: skip

    def changed(one: dict[str, float], other: dict[str, float]) -> set[str]:
        return {
            name for name in one if abs(one[name] - other[name]) > 1e-9 * max(abs(one[name]), abs(other[name]), 1e-12)
        }

    inside: dict[str, set[str]] = {name: set() for name in outputs(points[0])}
    for point in points:
        here = outputs(point)
        for k, state in enumerate(states):
            moved = list(point)
            moved[k] += 1e-3 * scales[k]
            for name in changed(here, outputs(tuple(moved))):
                inside[name].add(state)
    acts = {label: set().union(*(changed(outputs(p), _with(effect, p, valve, outputs)) for p in points))
            for label, effect in effects.items() if effect.reading is None}  # fmt: skip
    equations = {name: set(variables) | ({f"d {name[8:]}"} if name.startswith("rate of ") else set())
                 for name, variables in inside.items()}  # fmt: skip
    equations |= {f"derivative of {name}": {name, f"d {name}"} for name in states}
    equations |= {name: {name} for name in states if name in channels}
    faults = {}
    for label, effect in effects.items():
        places = {effect.channel} if effect.reading is not None and effect.channel else acts.get(label, set())
        if not places:
            continue
        for place in places:
            equations[place] |= {f"fault {label}"}
        equations[f"no {label}"] = {f"fault {label}"}
        faults[label] = f"no {label}"
    return StructuralModel({name: frozenset(own) for name, own in equations.items()}, faults)


def _with(effect: Effect, point: tuple, valve: Valve, outputs: object) -> dict[str, float]:
    """What the equations give with an effect at its typical amplitude, hot where it acts by temperature."""
    amplitude = effect.amplitude
    size = amplitude.typical if amplitude.typical is not None else 0.5 * sum(amplitude.bounds)
    active = effect(**{amplitude.name: size})
    parts = AT_20
    if effect.temperatures is not None:
        parts = PartTemperatures(**{name: 25.0 for name in AT_20.__dataclass_fields__})
    elif "K" in amplitude.unit.split("/"):
        parts = PartTemperatures(**{name: 20.0 + 5.0 * k for k, name in enumerate(AT_20.__dataclass_fields__)})
    model = Model().with_effects((effect,) if effect.balance is not None else ())
    flat = model.flat_coefficients(valve.at(parts), (active,), parts)
    return outputs(point, model, flat)  # type: ignore[operator]


def isolability(model: StructuralModel) -> tuple[tuple[str, ...], np.ndarray]:
    """(faults, (k, k) True where the row's fault is structurally isolable from the column's; on the diagonal where it
    is detectable)."""
    names = tuple(model.faults)
    found = np.zeros((len(names), len(names)), dtype=bool)
    whole = overdetermined(model.equations)
    for j, rival in enumerate(names):
        less = {name: own for name, own in model.equations.items() if name != model.faults[rival]}
        part = overdetermined(less)
        for k, fault in enumerate(names):
            found[k, j] = model.faults[fault] in (whole if k == j else part)
    return names, found


def overdetermined(equations: Mapping[str, frozenset[str]]) -> frozenset[str]:
    """The equations of the overdetermined part."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import maximum_bipartite_matching

    names = list(equations)
    variables = sorted(frozenset().union(*equations.values()))
    place = {variable: k for k, variable in enumerate(variables)}
    rows = [k for k, name in enumerate(names) for _ in equations[name]]
    columns = [place[variable] for name in names for variable in equations[name]]
    graph = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(names), len(variables)))
    variable_of = maximum_bipartite_matching(graph, perm_type="column")  # of each equation, -1 where uncovered
    equation_of = {int(variable): k for k, variable in enumerate(variable_of) if variable >= 0}
    reached = [k for k, variable in enumerate(variable_of) if variable < 0]
    seen = set(reached)
    while reached:
        k = reached.pop()
        for variable in equations[names[k]]:
            other = equation_of.get(place[variable])
            if other is not None and other not in seen:
                seen.add(other)
                reached.append(other)
    return frozenset(names[k] for k in seen)
