"""The state at rest from which a run starts: the static solution, and Newton's method where effects act."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from valvesim.inputs import evaluate
from valvesim.simulation.scenario import Scenario
from valvesim.solver.codegen import CompiledModel
from valvesim.valve.coefficients import Coefficients
from valvesim.valve.equilibrium import settle, solve_rest


def state_at_rest(scenario: Scenario, compiled: CompiledModel, c: Coefficients, flat: np.ndarray) -> np.ndarray:
    """The scaled state at rest at time zero, (members, states): the static solution, and Newton where effects act."""
    model = scenario.model
    value = [evaluate(command, 0.0) for command in (scenario.command, *scenario.pressures())]
    memory = model.drive.rest(value[0], c)
    current = memory[0] if memory else value[0]
    rest = solve_rest(c, current, 0.0, *value[1:])
    pressures = (rest.nozzle_pressure_1, rest.nozzle_pressure_2)
    columns: list[Any] = [rest.armature_angle, 0.0, *pressures, rest.spool_position, 0.0, *memory]
    columns += [0.0 for effect in model.effects for _ in effect.memory]
    y = np.column_stack([np.broadcast_to(column, rest.armature_angle.shape or (1,)) for column in columns])
    y = np.ascontiguousarray(y / compiled.scale)
    if not any(effect.balance for effect in model.effects):
        return y
    u = np.array([value[0], 0.0, *value[1:]], dtype=float)
    for k in range(len(y)):
        member = f"member {k}: " if len(y) > 1 else ""
        y[k] = settle(
            functools.partial(_into, compiled.derivative, u, flat[k]),
            functools.partial(_into, compiled.jacobian, u, flat[k]),
            y[k], model.state_channels, where=member,
        )  # fmt: skip
    return y


def _into(compiled: Any, u: np.ndarray, flat: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """A compiled function of the scaled states alone."""
    compiled(y, u, flat, out)
