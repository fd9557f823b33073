"""How small changes of a valve show in its sensors: the linearised equations along a trajectory, solved for many at
once.

A change of a parameter, an effect or an unknown term is a forcing: what it adds to the rates along the trajectory,
and to what the sensors read directly. The valve answers linearly with its Jacobian along the trajectory. So one run
of the valve gives the answer to some hundred changes, each exact as its size goes to zero.

Symbols
    x scaled states, A(t) Jacobian, g(t) forcing, h step:  d' = A d + g
    d_k+1 = E d_k + h [(phi1 - phi2) g_k + phi2 g_k+1],  E = exp(hA), phi1 = (E - I)/hA, phi2 = (phi1 - I)/hA
    (exact for A constant and g straight over a step, however stiff)
    by doubling: phi2(2A) = (phi1^2 + 2 phi2)/4, phi1(2A) = (E + I) phi1/2, E(2A) = E^2
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.channels import Inputs
from valvesim.identification.predictor import RecordPredictor, Trajectory
from valvesim.solver.codegen import absent_coefficients, compile_model
from valvesim.valve.valve_model import ValveModel

ENDLESS = 1e100  # scaled: squares of what is larger overflow
FACTORIALS = np.array([1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0])


TOGETHER = 8  # steps whose matrices are worked out at once: one of a processor's vectors, or two


def propagators(A, h, E, early, late):
    """Fill E, early and late (n-1, s, s) of the steps between the matrices A (n, s, s); compiled as it stands.

    Some steps at a time, side by side in the last place: what the one of largest norm needs, all of them get.
    """
    n, s = A.shape[0], A.shape[1]
    shape = (s, s, TOGETHER)
    S, P, phi, late_phi, T = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape)
    for first in range(0, n - 1, TOGETHER):
        norm = 0.0
        for side in range(TOGETHER):
            k = min(first + side, n - 2)
            for i in range(s):
                row = 0.0
                for j in range(s):
                    S[i, j, side] = 0.5 * h * (A[k, i, j] + A[k + 1, i, j])
                    row += abs(S[i, j, side])
                norm = max(norm, row)
        halvings = 0
        while norm > 0.25:
            norm *= 0.5
            halvings += 1
        shrink = 0.5**halvings
        for i in range(s):
            for j in range(s):
                for side in range(TOGETHER):
                    S[i, j, side] *= shrink
                    late_phi[i, j, side] = 1.0 / 5040.0 if i == j else 0.0
        for power in range(6, 1, -1):  # Horner's scheme of phi2 = sum S^k/(k+2)!
            product(S, late_phi, T, 1.0 / FACTORIALS[power])
            late_phi, T = T, late_phi
        product(S, late_phi, phi, 1.0)
        product(S, phi, P, 1.0)
        for _ in range(halvings):  # doubling: no inverse is taken, so that a memory which rests does no harm
            product(phi, phi, T, 0.0)
            for i in range(s):
                for j in range(s):
                    for side in range(TOGETHER):
                        late_phi[i, j, side] = 0.25 * (T[i, j, side] + 2.0 * late_phi[i, j, side])
            product(P, phi, T, 0.0)
            for i in range(s):
                for j in range(s):
                    for side in range(TOGETHER):
                        phi[i, j, side] = 0.5 * (T[i, j, side] + phi[i, j, side])
            product(P, P, T, 0.0)
            P, T = T, P
        for side in range(min(TOGETHER, n - 1 - first)):
            k = first + side
            for i in range(s):
                for j in range(s):
                    E[k, i, j] = P[i, j, side]
                    early[k, i, j] = h * (phi[i, j, side] - late_phi[i, j, side])
                    late[k, i, j] = h * late_phi[i, j, side]


def product(X, Y, out, diagonal):
    """Fill out = X Y + diagonal I, `TOGETHER` times: for so few states loops are faster than a library's calls."""
    s = X.shape[0]
    for i in range(s):
        for j in range(s):
            for side in range(TOGETHER):
                out[i, j, side] = diagonal if i == j else 0.0
            for k in range(s):
                for side in range(TOGETHER):
                    out[i, j, side] += X[i, k, side] * Y[k, j, side]


def propagate_steps(E, early, late, g, d):
    """Fill d (n, s, k) from forcings g (n, s, k), starting at rest: d_0 = -A^-1 g_0 is given in d[0]."""
    for k in range(E.shape[0]):
        d[k + 1] = E[k] @ d[k] + early[k] @ g[k] + late[k] @ g[k + 1]


def relaxation_recursion(a, decay, share, z):
    """Fill z (n,): z_k+1 = decay_k z_k + share_k a_k."""
    for k in range(a.shape[0]):
        z[k + 1] = decay[k] * z[k] + share[k] * a[k]


def first_order_response(a: np.ndarray, b: np.ndarray, step: float) -> np.ndarray:
    """z (n,) of z' = a - b z: a and b (n,) at rest, then constant over each of n - 1 steps; starts at rest."""
    z = np.empty(len(a))
    z[0] = a[0] / b[0] if b[0] * step > 1e-12 else 0.0
    a, b = np.array(a[1:]), np.array(b[1:])
    decay = np.exp(-b * step)
    share = np.where(np.abs(b * step) > 1e-9, -np.expm1(-b * step) / np.where(b == 0.0, 1.0, b), step)
    _machine()[2](a, decay, share, z)
    return z


def fill_propagators(A: np.ndarray, h: float, E: np.ndarray, early: np.ndarray, late: np.ndarray) -> None:
    """`propagators`, compiled."""
    _machine()[0](A, h, E, early, late)


@functools.cache
def _machine() -> tuple[Any, Any, Any]:
    from numba import njit
    from numba.extending import register_jitable

    register_jitable(product)
    options: Any = {"cache": True, "nogil": True, "error_model": "numpy"}
    return njit(**options)(propagators), njit(**options)(propagate_steps), njit(**options)(relaxation_recursion)


@dataclass(frozen=True)
class TangentLinear:
    """The equations linear along a trajectory: `response` solves them, `slopes` are the channels' over the states."""

    active: np.ndarray  # indices of the states that take part
    scale: np.ndarray
    A: np.ndarray
    E: np.ndarray
    early: np.ndarray
    late: np.ndarray
    slopes: dict[str, np.ndarray]  # channel -> (n, s), d(channel)/d(scaled state)

    def response(self, forcing: np.ndarray) -> np.ndarray:
        """Sensitivities (n, s, k) of the scaled states to forcings (n, s, k) of the scaled rates, at rest with the
        first.

        Zero where one grows without end: along a trajectory that limit cycles the linearised equations tell nothing.
        """
        g = np.ascontiguousarray(forcing)
        d = np.empty_like(g)
        d[0] = -np.linalg.lstsq(self.A[0], g[0], rcond=1e-12)[0]  # a memory at rest stays where it is
        _machine()[1](self.E, self.early, self.late, g, d)
        bounded = (d.min(axis=(0, 1)) > -ENDLESS) & (d.max(axis=(0, 1)) < ENDLESS)
        d[:, :, ~bounded] = 0.0
        return d

    def channel(self, name: str, response: np.ndarray, direct: np.ndarray | None = None, every: int = 1) -> np.ndarray:
        """Sensitivities (n, k) of a channel at the valve: through the states, and what reads on it directly.

        At `every` so many points alone, (n / every, k).
        """
        through = np.einsum("ns,nsk->nk", self.slopes[name][::every], response[::every])
        return through if direct is None else through + direct[::every]


def linearise_along(
    predictor: RecordPredictor, trajectory: Trajectory, active: np.ndarray, model: ValveModel, along: tuple
) -> TangentLinear:
    """The equations along a trajectory, in its `active` states: memories of absent effects take no part.

    `model` has those states, and `along` are its flat coefficients on the grid.
    """
    compiled = compile_model(trajectory.model, absent_coefficients(trajectory.model, trajectory.coefficients))
    scale = compiled.scale
    n, s = trajectory.states.shape
    A = np.empty((n, s, s))
    compiled.jacobians(
        np.ascontiguousarray(trajectory.states / scale),
        predictor.inputs,
        np.ascontiguousarray(trajectory.coefficients),
        A,
    )
    A = np.ascontiguousarray(A[:, active][:, :, active])
    h = float(predictor.times[1] - predictor.times[0])
    E, early, late = (np.empty((n - 1, len(active), len(active))) for _ in range(3))
    fill_propagators(A, h, E, early, late)
    slopes = _slopes(predictor, trajectory, active, scale, model, along)
    return TangentLinear(active, scale[active], A, E, early, late, slopes)


def _slopes(
    predictor: RecordPredictor,
    trajectory: Trajectory,
    active: np.ndarray,
    scale: np.ndarray,
    model: ValveModel,
    along: tuple,
) -> dict[str, np.ndarray]:
    """d(channel)/d(scaled state), (n, s): exact for states, differences for signals."""
    n, names = len(predictor.times), predictor.record.outputs
    slopes = {name: np.zeros((n, len(active))) for name in names}
    own = [channel.name for channel in trajectory.model.state_channels]
    for name in names:
        if name in own:
            at = own.index(name)
            if at in active:
                slopes[name][:, np.flatnonzero(active == at)[0]] = scale[at]
    signals = [name for name in names if name not in own and name != "body_temperature"]
    if signals:
        u, own_states = Inputs(*predictor.inputs.T), [trajectory.states[:, at] for at in active]
        for k, at in enumerate(active):
            step = 1e-4 * scale[at]
            high, low = (
                model.signals((*own_states[:k], own_states[k] + by, *own_states[k + 1 :]), u, along)
                for by in (step, -step)
            )
            for name in signals:
                slopes[name][:, k] = (getattr(high, name) - getattr(low, name)) / (2 * step) * scale[at]
    return slopes
