"""What solver, simulation and identification need of a valve: a jet pipe or a direct drive gives the same.

Two objects make a valve. Its **parameters** (`ValveParameters`; here `parameters.Valve`) hold what it is at 20 °C and
give the coefficients at the temperatures of its parts. Its **model** (`ValveModel`; here `equations.Model`) holds the
equations over states, inputs and coefficients. Both are plain data: nothing is remembered between calls.

No second valve follows these protocols in this package; docs/extending.md runs a small one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol, runtime_checkable

from valvesim.channels import Channel
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.fluid import Oil


@runtime_checkable
class ValveParameters(Protocol):
    """The quantities of a valve, each declared with unit and bounds (`units.quantity`)."""

    def at(self, parts: PartTemperatures, *, oil: Oil, routes: Iterable[str]) -> Any:
        """Coefficients (a NamedTuple of floats or arrays, SI) with each part at its own temperature (°C)."""
        ...


@runtime_checkable
class ValveModel(Protocol):
    """The equations of a valve. A state, input, signal or coefficient is a float, an array or a traced symbol, SI."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects with a balance that the equations hold."""
        ...

    @property
    def state_channels(self) -> tuple[Channel, ...]:
        """Name, unit and scale of every state, in the order of all state vectors."""
        ...

    @property
    def memory_states(self) -> slice:
        """Where the memories of the effects stand in a state vector: behind all others."""
        ...

    @property
    def input_channels(self) -> tuple[Channel, ...]:
        """Of every input: the command, its rate, and the pressures."""
        ...

    @property
    def signal_channels(self) -> tuple[Channel, ...]:
        """Of all that `signals` gives."""
        ...

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names in the order of the flat coefficients."""
        ...

    def with_effects(self, effects: Sequence[Effect]) -> ValveModel:
        """The same valve with these effects in the place of its own."""
        ...

    def valve_coefficients(self, flat: Sequence) -> Any:
        """What `ValveParameters.at` gives, from the flat coefficients: it stands first."""
        ...

    def flat_coefficients(self, c: Any, active: Sequence[ActiveEffect], parts: PartTemperatures) -> tuple:
        """What `ValveParameters.at` gave, changed by the effects, then the parameters of the effects, as one tuple."""
        ...

    def rest(self, inputs: Sequence, c: Any) -> tuple:
        """States at rest under constant inputs."""
        ...

    def rhs(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple:
        """Derivatives of all states over time; no branch on a state, so that a symbol passes through."""
        ...

    def signals(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> Any:
        """What the equations give besides the derivatives: a NamedTuple in the order of `signal_channels`."""
        ...

    def evaluate(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple[tuple, Any]:
        """(`rhs`, `signals`) at once."""
        ...
