"""Drift of the armature angle by temperature route, with the balances as derived and as the appendix prints them.

Symbols (docs/site/physics.md)
    theta armature angle, drift theta(T)/theta(20 °C) - 1, M0 polarization magnetomotive force, a armature arm
    A1 A2 A3 factors of the balances, K_k coefficients of the TAD polynomial
Signs
    As derived: theta = A1 T_d + A2 p_L + A3 (Eqs. 33, 34). As the appendix prints it: theta = -A1 T_d - A2 p_L - A3, so
    that the magnetic spring stiffens the armature and the hydraulic feedback softens it. That
    reading lives here alone.
    A drift counts as positive where the angle grows. The paper tells which routes go together, not which way they go: a
    valve is compared in both senses, and "turned" so that the published flow coefficients count as negative.

Source: Yan, Liu, Ma, IEEE Access 2019, section IV; docs/site/physics.md for its misprints.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.paper.published import CURRENTS, OIL, RANGE
from valvesim.valve.equations import FLOW_FORCE_FACTOR
from valvesim.valve.equilibrium import tad_polynomial
from valvesim.valve.parameters import (
    ROUTES,
    Coefficients,
    PartTemperatures,
    Valve,
    reference_valve,
)


def printed_polynomial(c: Coefficients, current, *, supply_pressure, return_pressure):
    """K_0..K_9 with the appendix's signs. Not the model: for this reproduction alone.

    The polynomial is affine in A1, A2, A3; a rigid spring tube makes all three vanish, so the one with their signs
    turned is twice the rigid one less the derived one.
    """
    pressures = {"supply_pressure": supply_pressure, "return_pressure": return_pressure}
    rigid = tad_polynomial(c._replace(spring_tube_stiffness=1e40), current, **pressures)
    return 2.0 * rigid - tad_polynomial(c, current, **pressures)


@dataclass(frozen=True, kw_only=True)
class Drifts:
    """Drift of the angle in percent. k valves, n temperatures, m currents."""

    by_route: np.ndarray  # (8, k, n), at the first current
    total: np.ndarray  # (m, k, n)
    angle: np.ndarray  # (m, k, n), rad
    stiffness: np.ndarray  # (k,), least net stiffness over that without magnet and oil; at or below 0: no stable rest
    mechanical: np.ndarray  # (k,), least stiffness of springs and jets over springs alone
    travel: np.ndarray  # (m, k), greatest flapper travel over null gap


def drifts(
    valve: Valve, *, printed_signs: bool = False, temperatures=RANGE, currents=CURRENTS[:1], steps: int = 1
) -> Drifts:
    """Drift by route and of all together, isothermal, of a batch of valves (fields (k, 1), or floats for one).

    `steps` of the current follow the root that is connected to zero angle at zero current, from the linear one on.
    """
    t = np.asarray(temperatures, dtype=float)
    c = _by_route(valve, t, len(currents))
    i = np.array([currents[0]] * len(ROUTES) + list(currents))[:, None, None]
    pressures = {"supply_pressure": valve.supply_pressure, "return_pressure": valve.return_pressure}
    polynomial = printed_polynomial if printed_signs else tad_polynomial
    gap = np.asarray(c.null_gap_1 / c.nozzle_arm)
    z: Any = 0.0
    for step in range(1, steps + 1):
        K = polynomial(c, i * step / steps, **pressures)
        k = K * np.broadcast_to(gap[..., None], (*K.shape[:-1], 1)) ** np.arange(10)
        with np.errstate(all="ignore"):  # unstable valves may run off; their stiffness tells
            z, slope, settled = _newton(k, -k[..., 0] / k[..., 1] if step == 1 else z)
    springs = tad_polynomial(c._replace(spring_tube_stiffness=1e40), i, **pressures)[..., 1] * gap
    with np.errstate(all="ignore"):
        share = np.where(settled, np.minimum(k[..., 1], slope) / springs, -np.inf)
    stiffness = np.min(share, axis=(0, 2))
    angle, m = z * gap, len(ROUTES)
    with np.errstate(all="ignore"):
        percent = 100.0 * (angle / _at_20(valve, angle, t) - 1.0)
    return Drifts(
        by_route=percent[:m],
        total=percent[m:],
        angle=angle[m:],
        stiffness=stiffness,
        mechanical=_mechanical_share(valve, t, z.shape[1]),
        travel=np.max(np.abs(z[m:]), axis=2),
    )


def _at_20(valve: Valve, angle: np.ndarray, t: np.ndarray) -> np.ndarray:
    if t[0] != 20.0:
        raise InputError(f"drifts: the temperatures must start at 20 °C, where drift is zero; got {t[0]:.4g} °C")
    return angle[..., :1]


def _newton(k: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(root, slope of the polynomial there, whether it has converged) by six steps from `z`."""
    slope = move = z
    for _ in range(6):
        value, slope = k[..., 9], np.zeros(k.shape[:-1])
        for power in range(8, -1, -1):
            slope = slope * z + value
            value = value * z + k[..., power]
        move = value / slope
        z = z - move
    return z, slope, np.abs(move) <= 1e-9 * np.abs(z)


def _by_route(valve: Valve, t: np.ndarray, totals: int) -> Coefficients:
    """Coefficients with a leading axis: each route alone, then all of them `totals` times."""
    hot = valve.at(PartTemperatures.uniform(t), oil=OIL)
    cold = valve.at(PartTemperatures.uniform(t), oil=OIL, routes=())
    fields = _route_fields()
    changed = {}
    for name in sorted({name for names in fields.values() for name in names}):
        on = np.array([name in fields[route] for route in ROUTES] + [True] * totals)[:, None, None]
        changed[name] = np.where(on, getattr(hot, name), getattr(cold, name))
    return cold._replace(**changed)


@functools.cache
def _route_fields() -> dict[str, frozenset[str]]:
    """Which coefficients each route changes, found on the reference valve."""
    valve, hot = reference_valve(), PartTemperatures.uniform(120.0)
    cold = valve.at(hot, oil=OIL, routes=())
    found = {}
    for route in ROUTES:
        warm = valve.at(hot, oil=OIL, routes=(route,))
        found[route] = frozenset(n for n in Coefficients._fields if np.any(getattr(warm, n) != getattr(cold, n)))
    return found


def _mechanical_share(valve: Valve, t: np.ndarray, k: int) -> np.ndarray:
    """D over its part from the springs: the springs must outweigh the jets without any magnet."""
    c = valve.at(PartTemperatures.uniform(t), oil=OIL)
    arm, K_f = c.nozzle_arm + c.feedback_arm, c.feedback_rod_stiffness
    K_flow = FLOW_FORCE_FACTOR * c.port_width * valve.supply_pressure
    jets = 8 * np.pi * c.nozzle_arm**2 * c.nozzle_flow_coefficient**2 * valve.supply_pressure * c.null_gap_1
    springs = c.spring_tube_stiffness + K_f * arm**2 - K_f**2 * arm**2 / (K_f + K_flow)
    return np.min(np.atleast_2d(1.0 - jets / springs), axis=1) * np.ones(k)


def largest_drift(percent: np.ndarray) -> np.ndarray:
    """The value of largest size along the last axis, with its sign."""
    at = np.argmax(np.abs(percent), axis=-1)[..., None]
    return np.take_along_axis(percent, at, axis=-1)[..., 0]


FIT_TEMPERATURES = np.array([20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0, 200.0, 270.0])
FIT_CURRENTS = (1e-3, 5e-3)


def drift_values(d: Drifts, temperatures) -> np.ndarray:
    """The drifts of `PUBLISHED_DRIFTS` in percent, signed, (k, 11), from drifts at the currents of `FIT_CURRENTS`."""
    knee = int(np.flatnonzero(np.asarray(temperatures) == 40.0)[0])
    rows = [*largest_drift(d.by_route), largest_drift(d.total[0]), d.total[0][:, knee], largest_drift(d.total[1])]
    return np.stack(rows, axis=-1)
