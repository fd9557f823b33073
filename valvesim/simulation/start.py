"""The state at rest from which a run starts: the static solution, and Newton's method where effects act."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from valvesim.solver.codegen import CompiledModel
from valvesim.valve.equilibrium import settle


def state_at_rest(
    compiled: CompiledModel, inputs: np.ndarray, flat: np.ndarray, *, held: np.ndarray | None = None, where: str = "",
    first_member: int = 0,
) -> np.ndarray:  # fmt: skip
    """The scaled states at rest (members, n) under constant inputs (n_u,), or (members, n_u) those of each, for flat
    coefficients (members, n_c).

    States in `held` (n,) keep what the static solution has. Raises SolveError, beginning with `where`, where no state
    is at rest; it counts members from `first_member` on.
    """
    model = compiled.model
    columns = model.rest(tuple(inputs.T), model.valve_coefficients(tuple(flat.T)))
    y = np.column_stack([np.broadcast_to(column, len(flat)) for column in columns])
    y = np.ascontiguousarray(y / compiled.scale)
    if not any(effect.balance for effect in model.effects):
        return y
    own = np.broadcast_to(inputs, (len(flat), inputs.shape[-1]))
    for k in range(len(y)):
        member = f"member {first_member + k}: " if first_member or len(y) > 1 else ""
        y[k] = settled_from(compiled, y[k], own[k], flat[k], held=held, where=where + member)
    return y


def settled_from(
    compiled: CompiledModel, y: np.ndarray, inputs: np.ndarray, flat: np.ndarray, *, held: np.ndarray | None = None,
    where: str = "",
) -> np.ndarray:  # fmt: skip
    """The scaled states at rest (n,) near others `y` of one valve, by Newton's method; otherwise as `state_at_rest`."""
    own = np.array(inputs, order="C")
    return settle(
        functools.partial(_into, compiled.derivative, own, flat),
        functools.partial(_into, compiled.jacobian, own, flat),
        y, compiled.model.state_channels, where=where, held=held,
    )  # fmt: skip


def _into(compiled: Any, u: np.ndarray, flat: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
    """A compiled function of the scaled states alone."""
    compiled(y, u, flat, out)
