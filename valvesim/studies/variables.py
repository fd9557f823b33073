"""The quantities that may vary in a study, by the key that they have in a scenario file, and how a member gets its own.

    valve.null_gap, oil.density_at_20, thermal.body_capacity, thermal.ambient_temperature, loop.mass,
    effects.spool_coulomb_friction.friction_force, pressures.supply, command.current.step.after,
    thermal.oil_temperature.ramp.rate

and, as a choice between several, `oil`, `effects`, `thermal.oil_temperature`, `command.current` and `pressures.supply`
as a whole. A pressure, the valve's own or a commanded one, is an input of the run, no figure of its equations.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.characterisation.position_loop import PositionLoop
from valvesim.errors import InputError, nearest, unknown_name
from valvesim.inputs import COMMANDS, Command, Constant, Sum, unit_of_figure
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.scenario_toml import PRESSURES
from valvesim.studies.distributions import LEAST_OUTSIDE, Distribution, OptionChoice, tolerance_distribution
from valvesim.units import quantities
from valvesim.valve.effect import ActiveEffect

Case = Scenario | PositionLoop
"""What a member of a study runs."""

VARIED_SECTIONS = ("valve", "oil", "thermal", "effects", "pressures", "command", "loop")


def scenario_of(case: Case) -> Scenario:
    """The scenario of a run, or of the loop around it."""
    return case.scenario if isinstance(case, PositionLoop) else case


def with_scenario(case: Case, scenario: Scenario) -> Case:
    """The case with another scenario."""
    return replace(case, scenario=scenario) if isinstance(case, PositionLoop) else scenario


@dataclass(frozen=True)
class Quantity:
    """A quantity of a case as its key names it: unit, meaning, nominal value, bounds and tolerance (in its unit)."""

    key: str
    unit: str
    doc: str
    nominal: float
    bounds: tuple[float, float]
    tolerance: float = 0.0

    @property
    def in_batch(self) -> bool:
        """Whether members that differ in it run as one batch: it is a figure of the equations."""
        section, _, name = self.key.partition(".")
        return section in ("loop", "effects") or (section == "valve" and not name.endswith("_pressure"))


@dataclass(frozen=True)
class Varied:
    """A quantity that varies, and how; of a choice between objects the quantity is the number of the choice."""

    quantity: Quantity
    distribution: Distribution | OptionChoice

    def __post_init__(self):
        if isinstance(self.distribution, OptionChoice):
            return
        if (outside := self.distribution.outside(self.quantity.bounds)) > LEAST_OUTSIDE:
            low, high = self.quantity.bounds
            raise InputError(
                f"the distribution ({self.distribution.words}) leaves [{low:.6g}, {high:.6g}] {self.quantity.unit} "
                f"({self.quantity.doc}) with probability {outside:.3g}; truncate it by lowest, highest",
                key=f"vary.{self.key}",
            )  # fmt: skip

    @property
    def key(self) -> str:
        """The key of the quantity."""
        return self.quantity.key


def tolerated(case: Case, own: Mapping[str, float] | None = None) -> tuple[Varied, ...]:
    """All quantities of the valve that have a tolerance, each distributed within it.

    `own` tolerances by name, in the quantity's unit, take the place of the declared ones.
    """
    valve, known = scenario_of(case).valve, own or {}
    names = [name for name, field in quantities(valve).items() if field.metadata["tolerance"] or name in known]
    return tuple(variable_of(find_quantity(case, f"valve.{name}"), known.get(name)) for name in names)


def variable_of(quantity: Quantity, tolerance: float | None = None) -> Varied:
    """A quantity within a tolerance (in its unit), by default its own. InputError where it has none."""
    width = quantity.tolerance if tolerance is None else tolerance
    if not width > 0.0:
        raise InputError(
            "has no tolerance of its own: give one, or a distribution", key=f"vary.{quantity.key}", joint=" "
        )
    return Varied(quantity, tolerance_distribution(quantity.nominal, width, quantity.bounds))


# ---------------------------------------------------------------- finding


def find_quantity(case: Case, key: str) -> Quantity:
    """The quantity that a key names. InputError with the nearest name where there is none."""
    section, _, rest = key.partition(".")
    scenario = scenario_of(case)
    if section == "valve":
        return _declared(scenario.valve, rest, key)
    if section == "oil":
        return _declared(scenario.oil, rest, key)
    if section == "loop":
        if not isinstance(case, PositionLoop):
            raise InputError("the study has no [loop]", key=f"vary.{key}")
        return _declared(case, rest, key)
    if section == "effects":
        return _effect_quantity(scenario, rest, key)
    if section == "thermal" and not rest.startswith("oil_temperature"):
        return _declared(_thermal_owner(scenario, rest), rest, key)
    if section in ("thermal", "command", "pressures"):
        command, unit, path = _command_at(case, key)
        _, owner, field = _command_figure(command, path, key)
        own = unit_of_figure(field.metadata["unit"], unit)
        bounds = field.metadata["bounds"]
        return Quantity(key, own, field.metadata["doc"] or key, float(getattr(owner, field.name)), bounds)
    raise unknown_name("section", section, VARIED_SECTIONS, "vary")


def _declared(owner: Any, name: str, key: str) -> Quantity:
    known = quantities(owner)
    if name not in known:
        raise unknown_name("quantity", name, known, f"vary.{key.partition('.')[0]}")
    value, meta = getattr(owner, name), known[name].metadata
    if np.ndim(value):
        raise InputError("is an array; a study starts from one valve", key=key, joint=" ")
    tolerance = meta["tolerance"] * (abs(value) if known[name].default else 1.0)
    return Quantity(key, meta["unit"], meta["doc"], float(value), meta["bounds"], float(tolerance))


def _thermal_owner(scenario: Scenario, name: str) -> Any:
    """What holds a figure of the section `thermal`."""
    if name in quantities(scenario.thermal):
        return scenario.thermal
    if scenario.thermal.network is None:
        problem = "the base scenario is isothermal: no part has a temperature of its own"
        raise InputError(problem, key=f"vary.thermal.{name}")
    return scenario.thermal.network


def _effect_quantity(scenario: Scenario, rest: str, key: str) -> Quantity:
    active, parameter = _active(scenario, rest, key)
    known = {p.name: p for p in active.effect.parameters}
    if parameter not in known:
        raise unknown_name(f"parameter of effect {active.effect.name}", parameter, known, f"vary.{key}")
    declared, value = known[parameter], getattr(active.values, parameter)
    return Quantity(key, declared.unit, declared.doc, float(value), declared.bounds)


def _active(scenario: Scenario, rest: str, key: str) -> tuple[ActiveEffect, str]:
    name, _, parameter = rest.partition(".")
    found = [active for active in scenario.effects if active.effect.name == name]
    if not found:
        acting = [active.effect.name for active in scenario.effects]
        told = nearest(name, acting) if acting else "; the base scenario has no effects"
        raise InputError(f"effect {name!r} does not act in the base scenario{told}", key=f"vary.{key}")
    if len(found) > 1:
        raise InputError(f"effect {name!r} acts {len(found)} times: a key cannot tell which", key=f"vary.{key}")
    return found[0], parameter


def _command_at(case: Case, key: str) -> tuple[Command, str, list[str]]:
    """(command, its unit, the rest of the key) that a key leads to."""
    scenario, parts = scenario_of(case), key.split(".")
    if len(parts) < 2:
        raise InputError("names a section, no quantity", key=f"vary.{key}", joint=" ")
    if parts[0] == "pressures":
        if parts[1] not in PRESSURES:
            raise unknown_name("pressure", parts[1], PRESSURES, "vary.pressures")
        return scenario.pressures()[PRESSURES.index(parts[1])], "Pa", parts[2:]
    if parts[0] == "thermal":
        return scenario.oil_temperature, "degC", parts[2:]
    if isinstance(case, PositionLoop):
        if parts[1] != "reference":
            raise unknown_name("command of a loop", parts[1], ("reference",), "vary.command")
        return case.reference, "m", parts[2:]
    if parts[1] != scenario.drive.command_name:
        raise unknown_name("command", parts[1], (scenario.drive.command_name,), "vary.command")
    return scenario.command, scenario.drive.command_unit, parts[2:]


def _command_figure(command: Command, path: list[str], key: str) -> tuple[int | None, Any, dataclasses.Field]:
    """(place in a sum, command of a kind, its field) that the rest of a key names; of a constant its value."""
    if not path and isinstance(command, Constant):
        return None, command, quantities(command)["value"]
    kinds = {kind: name for name, kind in COMMANDS.items()}
    terms = command.terms if isinstance(command, Sum) else (command,)
    named = [(k, term) for k, term in enumerate(terms) if kinds.get(type(term)) == (path[0] if path else "")]
    if len(named) != 1:
        there = ", ".join(kinds.get(type(term), type(term).__name__.lower()) for term in terms)
        raise InputError(f"names no figure of the command there, which has: {there}", key=f"vary.{key}", joint=" ")
    k, owner = named[0]
    known = quantities(owner)
    name = path[1] if len(path) == 2 else ""
    if name not in known:
        raise unknown_name("figure", name, known, f"vary.{'.'.join(key.split('.')[:-1])}")
    return (k if isinstance(command, Sum) else None), owner, known[name]


# ---------------------------------------------------------------- a member's own


def apply(case: Case, values: Mapping[str, Any]) -> Case:
    """The case with these values by key (SI); of quantities that run in batch they may be arrays (k,).

    Raises InputError for a value outside its bounds, and what does not go together.
    """
    scenario = scenario_of(case)
    figures: dict[str, dict[str, Any]] = {section: {} for section in VARIED_SECTIONS}
    for key, value in values.items():
        section, _, rest = key.partition(".")
        figures[section][rest] = value
    if own := figures["valve"]:
        scenario = replace(scenario, valve=replace(scenario.valve, **own))
    if own := figures["oil"]:
        oil = own.pop("", scenario.oil)
        scenario = replace(scenario, oil=replace(oil, **own))
    scenario = _apply_thermal(scenario, figures["thermal"])
    whole = figures["effects"].pop("", None)
    if whole is not None:
        scenario = replace(scenario, effects=whole)
    for rest, value in figures["effects"].items():
        scenario = _apply_effect(scenario, rest, value)
    for rest, value in figures["pressures"].items():
        name, command = rest.partition(".")[0], _changed_command(scenario, f"pressures.{rest}", value)
        scenario = replace(scenario, **{f"{name}_pressure": command})  # type: ignore[arg-type]
    case = with_scenario(case, scenario)
    for rest, value in figures["command"].items():
        changed = _changed_command(case, f"command.{rest}", value)
        if isinstance(case, PositionLoop):
            case = replace(case, reference=changed)
        else:
            case = replace(case, command=changed)
    return replace(case, **figures["loop"]) if figures["loop"] else case


def _apply_thermal(scenario: Scenario, figures: dict[str, Any]) -> Scenario:
    thermal = scenario.thermal
    network: dict[str, Any] = {}
    for rest, value in figures.items():
        if rest.startswith("oil_temperature"):
            scenario = replace(scenario, oil_temperature=_changed_command(scenario, f"thermal.{rest}", value))
        elif rest in quantities(thermal):
            thermal = replace(thermal, **{rest: value})
        else:
            network[rest] = value
    if network and thermal.network is not None:
        thermal = replace(thermal, network=replace(thermal.network, **network))
    return replace(scenario, thermal=thermal)


def _apply_effect(scenario: Scenario, rest: str, value: Any) -> Scenario:
    active, parameter = _active(scenario, rest, f"effects.{rest}")
    column = np.asarray(value)[:, None] if np.ndim(value) else float(value)
    numbers = dict(zip((p.name for p in active.effect.parameters), active.numbers, strict=True))
    changed = active.effect(**(numbers | {parameter: column}))
    effects = tuple(changed if one is active else one for one in scenario.effects)
    return replace(scenario, effects=effects)


def _changed_command(case: Case, key: str, value: Any) -> Command:
    """The command of a key with one figure of it changed, or another command in its place."""
    if not isinstance(value, (int, float, np.floating)):
        return value
    command, _, path = _command_at(case, key)
    place, owner, field = _command_figure(command, path, key)
    changed = replace(owner, **{field.name: float(value)})
    if place is None:
        return changed
    terms = tuple(changed if k == place else term for k, term in enumerate(command.terms))  # type: ignore[attr-defined]
    return Sum(terms)


def choice_unit(case: Case, key: str) -> tuple[str, str]:
    """(unit, column) of the command that a key names as a whole; InputError for another key."""
    command, unit, path = _command_at(case, key)
    if path:
        raise InputError("choices are of a whole command, or of the oil or the effects", key=f"vary.{key}")
    return unit, key.rpartition(".")[2]
