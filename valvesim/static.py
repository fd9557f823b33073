"""The valve at rest: the paper's ninth-degree TAD polynomial, and the three balances solved directly.

Symbols (model.md section 4)
    theta armature angle, a0 a2 a4 b0 b1 b2 torque, c0 c2 c4 d1 pilot pressure difference, D A1 A2 A3 balances, K0..K9
    z = r theta / x_f0, the angle as a share of the null gap: the polynomial is solved in z, where it is well scaled

Both solutions are for any broadcast shape of currents and temperatures. The polynomial is the paper's, for a valve with
equal sides; the direct solution holds for unequal sides too.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import InputError, SolveError, warn_once
from .fluid import MIL_PRF_5606, Oil
from .laws import MU_0
from .model import FLOW_FORCE_FACTOR, drive_torque, flapper_torques
from .parameters import ROUTES, Coefficients, PartTemperatures, Valve


@dataclass(frozen=True, kw_only=True)
class StaticSolution:
    """The valve at rest; every field has the broadcast shape of current and temperature (the oil's, °C)."""

    current: np.ndarray
    temperature: np.ndarray
    armature_angle: np.ndarray
    spool_position: np.ndarray
    nozzle_pressure_1: np.ndarray
    nozzle_pressure_2: np.ndarray
    load_differential_pressure: np.ndarray
    real_roots: np.ndarray | None
    """All real angles that solve the polynomial, rad, (..., 9) ascending and padded with NaN; None if sides differ."""
    branch: str = "connected to zero angle at zero current, inside the null gap"


def tad_polynomial(c: Coefficients, current, *, supply_pressure, return_pressure, load_pressure=0.0, friction=0.0):
    """Coefficients K_0..K_9 of sum K_k theta^k = 0, shape (..., 10), lowest power first.

    Source: paper Eq. 35 and appendix with the misprints of model.md 6.4 and 6.5 corrected; equal sides are assumed.
    """
    A1, A2, A3 = _balance_factors(c, supply_pressure, load_pressure, friction)
    l1, l2, a, gamma, M0 = c.upper_air_gap_1, c.lower_air_gap_1, c.armature_arm, c.flux_share, c.polarization_mmf
    A_g, r, x_f0 = c.air_gap_area, c.nozzle_arm, c.null_gap_1
    S, N = l1 + l2, c.coil_turns * current
    X = gamma * S + MU_0 * A_g * c.magnet_reluctance
    b0 = 2 * MU_0 * A_g * M0 * N * a * gamma * l1 * l2 * S * X
    b1 = MU_0 * A_g * a**2 * gamma * S * (N**2 * S * X + 4 * M0**2 * gamma * l1 * l2)
    b2 = 2 * MU_0 * A_g * M0 * N * a**3 * gamma**2 * S**2
    a0 = 2 * l1**2 * l2**2 * X**2
    a2 = -4 * a**2 * gamma * l1 * l2 * S * X
    a4 = 2 * a**4 * gamma**2 * S**2
    A = c.fixed_orifice_diameter_1**4 * c.orifice_flow_coefficient**2
    B = 16 * c.nozzle_flow_coefficient**2 * c.nozzle_diameter_1**2
    d1 = 4 * A * B * x_f0 * r * (supply_pressure - return_pressure)
    c0 = (A + B * x_f0**2) ** 2
    c2 = 2 * B * (A - B * x_f0**2) * r**2
    c4 = B**2 * r**4
    K = (
        -A1 * b0 * c0 - A3 * a0 * c0,
        a0 * c0 - A1 * b1 * c0 - A2 * a0 * d1,
        -A1 * (b2 * c0 + b0 * c2) - A3 * (a2 * c0 + a0 * c2),
        a2 * c0 + a0 * c2 - A1 * b1 * c2 - A2 * a2 * d1,
        -A1 * (b2 * c2 + b0 * c4) - A3 * (a4 * c0 + a2 * c2 + a0 * c4),
        a4 * c0 + a2 * c2 + a0 * c4 - A1 * b1 * c4 - A2 * a4 * d1,
        -A1 * b2 * c4 - A3 * (a4 * c2 + a2 * c4),
        a4 * c2 + a2 * c4,
        -A3 * a4 * c4,
        a4 * c4,
    )
    return np.stack(np.broadcast_arrays(*K), axis=-1)


def _balance_factors(c: Coefficients, supply_pressure, load_pressure, friction):
    """A1, A2, A3 of theta = A1 T_d + A2 p_L + A3: the spool position eliminated from Eqs. 33 and 34."""
    arm = c.nozzle_arm + c.feedback_arm
    K_flow = FLOW_FORCE_FACTOR * c.port_width * (supply_pressure - load_pressure)
    A_N, K_f = np.pi * c.nozzle_diameter_1**2 / 4, c.feedback_rod_stiffness
    jets = 4 * np.pi * c.nozzle_arm**2 * c.nozzle_flow_coefficient**2 * supply_pressure * (c.null_gap_1 + c.null_gap_2)
    D = (K_f + K_flow) * (c.spring_tube_stiffness + K_f * arm**2 - jets) - K_f**2 * arm**2
    A2 = -(c.nozzle_arm * A_N * (K_f + K_flow) + K_f * arm * c.spool_area) / D
    return (K_f + K_flow) / D, A2, friction * K_f * arm / D


def nozzle_pressures(theta, c: Coefficients, supply_pressure, return_pressure):
    """(p1, p2) at rest: each chamber divides the pressure between its fixed orifice and its nozzle (Eq. 20)."""

    def divided(orifice, nozzle, gap):
        A = orifice**4 * c.orifice_flow_coefficient**2
        B = 16 * c.nozzle_flow_coefficient**2 * nozzle**2 * np.maximum(gap, 0.0) ** 2
        return (A * supply_pressure + B * return_pressure) / (A + B)

    x_f = c.nozzle_arm * theta
    return (
        divided(c.fixed_orifice_diameter_1, c.nozzle_diameter_1, c.null_gap_1 - x_f),
        divided(c.fixed_orifice_diameter_2, c.nozzle_diameter_2, c.null_gap_2 + x_f),
    )


def _rest(theta, current, c: Coefficients, supply_pressure, return_pressure, load_pressure, friction):
    """(torque residual, x_v, p1, p2) at a held angle: pressures and spool follow from their own balances."""
    p1, p2 = nozzle_pressures(theta, c, supply_pressure, return_pressure)
    arm, K_f = c.nozzle_arm + c.feedback_arm, c.feedback_rod_stiffness
    force = c.spool_area * (p1 - p2) - K_f * arm * theta - friction
    # the flow force is 0.43 w (p_s x - p_L |x|): its stiffness depends on the side to which the force pushes
    K_flow = FLOW_FORCE_FACTOR * c.port_width * (supply_pressure - np.sign(force) * load_pressure)
    x_v = force / (K_f + K_flow)
    T_nozzles, T_jets = flapper_torques(theta, p1, p2, supply_pressure, return_pressure, c)
    T_rod = -arm * K_f * (arm * theta + x_v)
    T_drive = drive_torque(theta, c.coil_turns * current, c)
    residual = T_drive - c.spring_tube_stiffness * theta + T_rod + T_nozzles + T_jets
    return residual, x_v, p1, p2


def static_solution(
    valve: Valve,
    *,
    current,
    temperature=20.0,
    parts: PartTemperatures | None = None,
    routes: Iterable[str] = ROUTES,
    oil: Oil = MIL_PRF_5606,
    friction=0.0,
) -> StaticSolution:
    """Where the valve rests at given current (A) and temperature (°C); the two broadcast.

    Isothermal, unless `parts` gives a temperature each. `routes` are the temperature routes that act. `friction` is
    F_f of Eq. 34 in newton. The pressures are the valve's own.

    With equal sides the angle is the root of the TAD polynomial that is connected to zero angle at zero current; with
    unequal sides, or under load pressure with friction, the three balances are solved directly along the same branch.
    Raises InputError for a clearance that closes, SolveError where that branch has left the null gap.
    """
    current, temperature = np.asarray(current, dtype=float), np.asarray(temperature, dtype=float)
    if not np.all(np.isfinite(current)):
        raise InputError("static solution: current holds NaN or infinity")
    c = valve.at(PartTemperatures.uniform(temperature) if parts is None else parts, oil=oil, routes=routes)
    return solve_rest(
        c, current, temperature if parts is None else parts.oil, valve.supply_pressure, valve.return_pressure,
        valve.load_pressure, friction,
        polynomial=valve.is_symmetric,
    )  # fmt: skip


def solve_rest(
    c: Coefficients, current, temperature, supply_pressure, return_pressure, load_pressure=0.0, friction=0.0,
    *, polynomial: bool = False,
) -> StaticSolution:  # fmt: skip
    """`static_solution` from coefficients: the branch from zero current, then every real root of the polynomial."""
    pressures = (supply_pressure, return_pressure, load_pressure)
    theta = follow_branch(c, current, pressures, friction)
    real_roots = None
    if polynomial:
        facing = np.sign(_rest(theta, current, c, *pressures, friction)[1]) * load_pressure  # the side it opens to
        K = tad_polynomial(
            c, current, supply_pressure=supply_pressure, return_pressure=return_pressure, load_pressure=facing,
            friction=friction,
        )  # fmt: skip
        K = np.broadcast_to(K, (*theta.shape, 10))
        real_roots = _real_roots(K, np.asarray(c.null_gap_1) / c.nozzle_arm)
        theta = _nearest_root(K, np.asarray(c.null_gap_1) / c.nozzle_arm, theta)
    _, x_v, p1, p2 = _rest(theta, current, c, *pressures, friction)
    if np.any(np.abs(x_v) > c.spool_stroke):
        warn_once(
            f"static solution: the spool would rest at {np.max(np.abs(x_v)) * 1e3:.4g} mm, beyond its end stop at "
            f"{np.min(c.spool_stroke) * 1e3:.4g} mm; the balances of rest know no stop",
            about="static solution, spool stop",
        )
    fields = np.broadcast_arrays(current, temperature, theta, x_v, p1, p2, p1 - p2)
    i, T, angle, position, pressure_1, pressure_2, difference = (np.array(field) for field in fields)
    return StaticSolution(
        current=i,
        temperature=T,
        armature_angle=angle,
        spool_position=position,
        nozzle_pressure_1=pressure_1,
        nozzle_pressure_2=pressure_2,
        load_differential_pressure=difference,
        real_roots=real_roots,
    )


def follow_branch(
    c: Coefficients, current, pressures: tuple[Any, Any, Any], friction=0.0, *, steps: int = 10
) -> np.ndarray:
    """The angle that the valve reaches when the current rises from zero to `current`, by continuation on the balances.

    Raises SolveError where the branch leaves the null gap or the torque balance loses its stable slope (a fold).
    """
    current = np.asarray(current, dtype=float)
    shape = np.broadcast_shapes(*(np.shape(v) for v in (*c, current, friction, *pressures)))
    gap = np.minimum(c.null_gap_1, c.null_gap_2) / c.nozzle_arm
    step = 1e-6 * gap  # for the slope of the residual
    theta, good = np.zeros(shape), np.ones(shape, dtype=bool)
    for k in range(steps + 1):
        i = current * (k / steps)
        for _ in range(60):
            above = _rest(theta + step, i, c, *pressures, friction)[0]
            below = _rest(theta - step, i, c, *pressures, friction)[0]
            slope = (above - below) / (2 * step)
            residual = _rest(theta, i, c, *pressures, friction)[0]
            move = np.clip(-residual / np.where(slope < 0.0, slope, -np.inf), -0.2 * gap, 0.2 * gap)
            theta = theta + move
            if np.all((np.abs(move) <= 1e-13 * gap) | ~good):
                break
        good &= (np.abs(theta) < gap) & (slope < 0.0) & (np.abs(move) <= 1e-9 * gap)
        theta = np.where(np.abs(theta) < gap, theta, 0.0)
    if not np.all(good):
        worst = np.broadcast_to(current, shape)[~good].flat[0]
        raise SolveError(
            f"static solution: at {worst * 1e3:.4g} mA no stable root lies on the branch from zero current inside the "
            f"null gap (|armature angle| < {np.min(gap) * 1e3:.4g} mrad). The magnetic spring, the jets or the current "
            "carry the flapper onto a nozzle: lower the current or polarization_mmf, or raise spring_tube_stiffness"
        )
    return theta


def _real_roots(K: np.ndarray, scale) -> np.ndarray:
    """All real roots, ascending, (..., 9) padded with NaN: eigenvalues of the companion matrix in z = theta/scale."""
    scale = np.broadcast_to(np.asarray(scale)[..., None], (*K.shape[:-1], 1))
    k = K * scale ** np.arange(10)
    monic = k[..., :-1] / k[..., -1:]
    companion = np.zeros((*K.shape[:-1], 9, 9))
    companion[..., np.arange(1, 9), np.arange(8)] = 1.0
    companion[..., :, -1] = -monic
    z = np.linalg.eigvals(companion)
    real = np.abs(z.imag) <= 1e-7 * np.maximum(np.abs(z), 1e-3)
    return np.sort(np.where(real, z.real, np.nan) * scale, axis=-1)


def _nearest_root(K: np.ndarray, scale, theta) -> np.ndarray:
    """The root of the polynomial next to `theta`, by Newton's method in z = theta/scale."""
    powers = np.arange(10)
    k = K * np.broadcast_to(np.asarray(scale)[..., None], (*K.shape[:-1], 1)) ** powers
    z = np.asarray(theta / scale, dtype=float)
    for _ in range(8):
        value = np.sum(k * z[..., None] ** powers, axis=-1)
        slope = np.sum(k[..., 1:] * powers[1:] * z[..., None] ** powers[:-1], axis=-1)
        z = z - value / slope
    return z * scale
