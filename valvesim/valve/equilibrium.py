"""The valve at rest: the balances of the equations solved directly, stops included, and the paper's TAD polynomial.

Symbols (docs/site/physics.md)
    theta armature angle, a0 a2 a4 b0 b1 b2 torque, c0 c2 c4 d1 pilot pressure difference, D A1 A2 A3 balances, K0..K9
    z = r theta / x_f0, the angle as a share of the null gap: the polynomial is solved in z, where it is well scaled

Both are for any broadcast shape of currents and temperatures. The polynomial is the paper's, for a valve with equal
sides, flow coefficients of temperature alone and no stop in reach; the direct solution needs none of these.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.errors import InputError, SolveError, warn_once
from valvesim.units import reads_units, symbol
from valvesim.valve.equations import (
    FLOW_FORCE_FACTOR,
    drive_torque,
    fixed_orifice_flow,
    flapper_torques,
    nozzle_flow,
)
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.laws import MU_0, contact_force
from valvesim.valve.parameters import ROUTES, Coefficients, PartTemperatures, Valve


@dataclass(frozen=True, kw_only=True)
class StaticSolution:
    """The valve at rest; every field has the broadcast shape of current and temperature (the oil's, °C)."""

    current: np.ndarray
    temperature: np.ndarray
    armature_angle: np.ndarray
    spool_position: np.ndarray
    nozzle_pressure_1: np.ndarray
    nozzle_pressure_2: np.ndarray
    pilot_differential_pressure: np.ndarray
    real_roots: np.ndarray | None
    """All real angles that solve the TAD polynomial, rad, (..., 9) ascending, padded with NaN; None without one."""
    branch: str = "first rest on the way from zero angle at zero current, stops included"


def tad_polynomial(c: Coefficients, current, *, supply_pressure, return_pressure, load_pressure=0.0, friction=0.0):
    """Coefficients K_0..K_9 of sum K_k theta^k = 0, shape (..., 10), lowest power first.

    Source: paper Eq. 35 and appendix with its misprints corrected (docs/site/physics.md); equal sides are assumed.
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
    """(p1, p2) at rest by Eq. 20: each chamber divides the pressure between its fixed orifice and its nozzle.

    Of ideal turbulent orifices; `chamber_pressure` holds for every law and starts from here.
    """

    def divided(orifice, nozzle, gap):
        A = orifice**4 * c.orifice_flow_coefficient**2
        B = 16 * c.nozzle_flow_coefficient**2 * nozzle**2 * np.maximum(gap, 0.0) ** 2
        return (A * supply_pressure + B * return_pressure) / (A + B)

    x_f = c.nozzle_arm * theta
    return (
        divided(c.fixed_orifice_diameter_1, c.nozzle_diameter_1, c.null_gap_1 - x_f),
        divided(c.fixed_orifice_diameter_2, c.nozzle_diameter_2, c.null_gap_2 + x_f),
    )


def chamber_pressure(orifice, nozzle, gap, c: Coefficients, supply_pressure, return_pressure, guess):
    """Pressure of one chamber at rest, Pa: fixed orifice and nozzle pass the same flow, by the equations' own laws.

    Both flows are monotone in the pressure, so that one root lies between return and supply: Newton's method, halving
    the bracket where a step leaves it, to 2e-15 (rounding lets the last digit swing). The slope is exact (a complex
    step). Raises SolveError where it does not settle.
    """
    low, high = np.minimum(supply_pressure, return_pressure), np.maximum(supply_pressure, return_pressure)
    low, high, p = (np.array(v, dtype=float) for v in np.broadcast_arrays(low, high, guess))
    p = np.clip(p, low, high)
    span = high - low
    for turn in range(80):
        z = p + 1e-30j
        surplus = chamber_surplus(orifice, nozzle, gap, z, c, supply_pressure, return_pressure)
        value, slope = surplus.real, surplus.imag * 1e30
        low, high = np.where(value >= 0.0, p, low), np.where(value <= 0.0, p, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = p - value / slope
        wild = ~((new >= low) & (new <= high)) | ((turn > 8) & (turn % 3 == 0))
        new = np.where(wild, (low + high) / 2.0, new)
        done = (np.abs(new - p) <= 2e-15 * np.abs(p)) | (value == 0.0) | (high - low <= 2e-15 * high)
        p = np.where(value == 0.0, p, new)
        if np.all(done):
            return p
    if np.all(high - low <= 1e-12 * span):
        return p
    worst = int(np.argmax(high - low))
    raise SolveError(
        f"static solution: the chamber pressure does not settle ({p.flat[worst] / 1e5:.6g} bar at a supply of "
        f"{np.broadcast_to(supply_pressure, p.shape).flat[worst] / 1e5:.4g} bar); raise valve.transition_pressure"
    )


def chamber_surplus(orifice, nozzle, gap, pressure, c: Coefficients, supply_pressure, return_pressure):
    """What the fixed orifice lets into a chamber beyond what the nozzle lets out, m^3/s: falls with the pressure."""
    inflow = fixed_orifice_flow(orifice, supply_pressure - pressure, c)
    return inflow - nozzle_flow(nozzle, gap, pressure - return_pressure, c)


def _rest(theta, current, c: Coefficients, supply_pressure, return_pressure, load_pressure, friction):
    """(torque residual, x_v, p1, p2) at held angles, of the shape that all have together: pressures and spool follow
    from their own balances.
    """
    x_f = c.nozzle_arm * theta
    whole, guesses = np.zeros(np.shape(theta)), nozzle_pressures(theta, c, supply_pressure, return_pressure)
    orifice, nozzle, gap = (  # both sides at once
        np.array([first + whole, second + whole])
        for first, second in (
            (c.fixed_orifice_diameter_1, c.fixed_orifice_diameter_2),
            (c.nozzle_diameter_1, c.nozzle_diameter_2),
            (c.null_gap_1 - x_f, c.null_gap_2 + x_f),
        )
    )
    p1, p2 = chamber_pressure(orifice, nozzle, gap, c, supply_pressure, return_pressure, np.array(guesses))
    residual, x_v = balances_at_rest(
        theta, current, p1, p2, c, supply_pressure, return_pressure, load_pressure, friction
    )
    return residual, x_v, p1, p2


def balances_at_rest(
    theta, current, p1, p2, c: Coefficients, supply_pressure, return_pressure, load_pressure, friction=0.0
):  # fmt: skip
    """(torque residual N m, x_v m) at a held angle and the pressures that go with it: floats, arrays or symbols."""
    x_f = c.nozzle_arm * theta
    arm, K_f = c.nozzle_arm + c.feedback_arm, c.feedback_rod_stiffness
    force = c.spool_area * (p1 - p2) - K_f * arm * theta - friction
    # the flow force is 0.43 w (p_s x - p_L |x|): its stiffness depends on the side to which the force pushes
    side = np.sign(force)
    stiffness = K_f + FLOW_FORCE_FACTOR * c.port_width * (supply_pressure - side * load_pressure)
    free, k_stop = force / stiffness, c.spool_stop_stiffness
    beyond = np.maximum(np.abs(free) - c.spool_stroke, 0.0)  # of the stroke, were there no stop
    x_v = free - side * beyond * k_stop / (stiffness + k_stop)
    T_nozzles, T_jets = flapper_torques(theta, p1, p2, supply_pressure, return_pressure, c)
    T_rod = -arm * K_f * (arm * theta + x_v)
    T_drive = drive_torque(theta, c.coil_turns * current, c)
    T_stop = c.nozzle_arm * contact_force(x_f, 0.0, -c.null_gap_2, c.null_gap_1, c.flapper_stop_stiffness, 0.0)
    return T_drive - c.spring_tube_stiffness * theta + T_rod + T_nozzles + T_jets + T_stop, x_v


@reads_units(current="A", temperature="degC", friction="N")
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

    The angle solves the balances of the equations themselves, stops included: it is the first rest that the valve meets
    on its way from zero angle at zero current to the current. Where sides are equal and the flow coefficients are of
    temperature alone, it is a root of the TAD polynomial (to the share (transition_pressure/pressure drop)^2/4), and
    `real_roots` holds them all. A spool or flapper that rests on its stop is warned of once.
    Raises InputError for a clearance that closes, SolveError where the valve has no stable null or an iteration fails.
    """
    current, temperature = np.asarray(current, dtype=float), np.asarray(temperature, dtype=float)
    if not np.all(np.isfinite(current)):
        raise InputError("static solution: current holds NaN or infinity")
    c = valve.at(PartTemperatures.uniform(temperature) if parts is None else parts, oil=oil, routes=routes)
    return solve_rest(
        c, current, temperature if parts is None else parts.oil, valve.supply_pressure, valve.return_pressure,
        valve.load_pressure, friction,
        polynomial=valve.is_symmetric and not has_laminar_loss(c),
    )  # fmt: skip


def has_laminar_loss(c: Coefficients) -> bool:
    """True where an orifice of the pilot has a coefficient of the moment: then there is no TAD polynomial."""
    return any(np.any(loss) for loss in (c.nozzle_laminar_loss, c.orifice_laminar_loss, c.orifice_wall_loss))


def solve_rest(
    c: Coefficients, current, temperature, supply_pressure, return_pressure, load_pressure=0.0, friction=0.0,
    *, polynomial: bool = False,
) -> StaticSolution:  # fmt: skip
    """`static_solution` from coefficients: the branch from zero current, and with `polynomial` all its real roots."""
    pressures = (supply_pressure, return_pressure, load_pressure)
    theta = follow_branch(c, current, pressures, friction)
    _, x_v, p1, p2 = _rest(theta, current, c, *pressures, friction)
    real_roots = None
    if polynomial:
        K = tad_polynomial(
            c, current, supply_pressure=supply_pressure, return_pressure=return_pressure,
            load_pressure=np.sign(x_v) * load_pressure, friction=friction,  # the side to which the spool opens
        )  # fmt: skip
        K = np.broadcast_to(K, (*theta.shape, 10))
        real_roots = _real_roots(K, np.asarray(c.null_gap_1) / c.nozzle_arm)
    _warn_of_stops(theta, x_v, c)
    fields = np.broadcast_arrays(current, temperature, theta, x_v, p1, p2, p1 - p2)
    i, T, angle, position, pressure_1, pressure_2, difference = (np.array(field) for field in fields)
    return StaticSolution(
        current=i,
        temperature=T,
        armature_angle=angle,
        spool_position=position,
        nozzle_pressure_1=pressure_1,
        nozzle_pressure_2=pressure_2,
        pilot_differential_pressure=difference,
        real_roots=real_roots,
    )


def _warn_of_stops(theta, x_v, c: Coefficients) -> None:
    """Warn once where the spool rests on its end stop, and where the flapper rests on a nozzle."""
    if np.any(np.abs(x_v) > c.spool_stroke):
        warn_once(
            f"static solution: the spool rests on its end stop at {np.min(c.spool_stroke) * 1e3:.4g} mm",
            about="static solution, spool stop",
        )
    x_f = c.nozzle_arm * theta
    if np.any((x_f > c.null_gap_1) | (x_f < -np.asarray(c.null_gap_2))):
        warn_once(
            "static solution: the flapper rests on a nozzle; the TAD solution ends before it",
            about="static solution, flapper stop",
        )


def follow_branch(c: Coefficients, current, pressures: tuple[Any, Any, Any], friction=0.0) -> np.ndarray:
    """The angle that the valve reaches when the current rises slowly from zero to `current`.

    At zero current it goes from zero angle, and at `current` from there, the way that the torque left over pushes, to
    the first angle at which that torque is zero; past a fold that is the flapper's stop. (The torque of the motor grows
    with the current, so that no current on the way carries the armature beyond it.)
    Raises SolveError where the null is not stable, and where an iteration does not settle.
    """
    shape = np.broadcast_shapes(*(np.shape(v) for v in (*c, current, friction, *pressures)))

    def torque(theta, at):
        return _rest(theta, at, c, *pressures, friction)[0]

    zero = 0.0 * np.asarray(current, dtype=float)
    gap = np.broadcast_to(np.minimum(c.null_gap_1, c.null_gap_2) / c.nozzle_arm, shape)
    null = _first_root(lambda theta: torque(theta, zero), np.zeros(shape), gap, c)
    step = 1e-5 * gap
    unstable = (np.abs(null) >= gap) | (torque(null + step, zero) >= torque(null - step, zero))
    if np.any(unstable):
        at = int(np.argmax(unstable))
        raise SolveError(
            f"static solution: no stable null inside the null gap (|armature angle| < {gap.flat[at] * 1e3:.4g} mrad): "
            f"{_state(null, zero, at)}, the magnetic spring or the jets carry the flapper onto a nozzle. Lower "
            "polarization_mmf, or raise spring_tube_stiffness"
        )
    if not np.any(current):
        return null
    current = np.broadcast_to(np.asarray(current, dtype=float), shape)
    return _first_root(lambda theta: torque(theta, current), null, gap, c)


GRID = 48  # angles to a null gap on which the first change of sign is looked for
CHUNK = 12  # of them worked out at once
REACH = 3.0  # null gaps within which every rest must lie, the flapper's stop bent


def _first_root(torque, start: np.ndarray, gap: np.ndarray, c: Coefficients) -> np.ndarray:
    """The first zero of `torque` from `start` on the way on which it pushes, of any shape.

    The way is a grid; where two zeros lie within one of its cells, they are passed over (a fold about to open).
    """
    at_start = torque(start)
    way = np.sign(at_start)
    low, f_low, high, f_high = start, at_start, start, at_start
    found = way == 0.0
    last, f_last = start, at_start
    for k in range(1, int(REACH * GRID) + 1, CHUNK):
        shares = np.arange(k, k + CHUNK).reshape(-1, *[1] * start.ndim) / GRID
        theta = start + way * gap * shares  # (CHUNK, ...)
        here = torque(theta)
        before, f_before = np.stack([last, *theta[:-1]]), np.stack([f_last, *here[:-1]])
        crossed = here * way <= 0.0
        first = np.argmax(crossed, axis=0)[None]
        new = ~found & crossed.any(axis=0)
        low, f_low, high, f_high = (
            np.where(new, np.take_along_axis(values, first, axis=0)[0], kept)
            for values, kept in ((before, low), (f_before, f_low), (theta, high), (here, f_high))
        )
        found, last, f_last = found | new, theta[-1], here[-1]
        if np.all(found):
            break
    else:
        at = int(np.argmax(~found))
        raise SolveError(
            f"static solution: the flapper finds no rest ({_state(last, f_last, at, 'torque left over', 'N*m')}); "
            "lower the current or raise valve.flapper_stop_stiffness"
        )
    return _bracketed_root(torque, low, f_low, high, f_high, gap)


def _bracketed_root(torque, a, f_a, b, f_b, gap) -> np.ndarray:
    """The zero between a and b, of any shape: false position with Anderson and Bjorck's weight, halving at times.

    Raises SolveError where the bracket does not close to 1e-12 of the gap.
    """
    best = np.where(np.abs(f_a) <= np.abs(f_b), a, b)
    done = np.zeros(np.shape(best), dtype=bool)  # what has settled stays while others go on
    for turn in range(120):
        with np.errstate(divide="ignore", invalid="ignore"):
            x = (a * f_b - b * f_a) / (f_b - f_a)
        halve = ~np.isfinite(x) | (turn % 4 == 3)
        x = np.where(halve, (a + b) / 2.0, x)
        x = np.clip(x, np.minimum(a, b), np.maximum(a, b))
        f_x = torque(x)
        # b is the newest point; a keeps the other sign, its weight reduced where it stays
        swap = np.sign(f_x) * np.sign(f_b) < 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = 1.0 - f_x / f_b
        weight = np.where(np.isfinite(weight) & (weight > 0.0), weight, 0.5)
        a, f_a = np.where(swap, b, a), np.where(swap, f_b, f_a * weight)
        settled = (np.abs(x - b) <= 1e-15 * gap) & (turn > 0) | (f_x == 0.0) | (np.abs(a - x) <= 1e-15 * gap)
        b, f_b, best = x, f_x, np.where(done, best, x)
        done |= settled
        if np.all(done):
            return best
    apart = np.where(done, 0.0, np.abs(a - b) / gap)
    if np.all(apart <= 1e-12):
        return best
    at = int(np.argmax(apart))
    raise SolveError(
        f"static solution: the angle does not settle ({_state(best, f_b, at, 'torque left over', 'N*m')}); change the "
        "current or valve.transition_pressure a little"
    )


def _state(theta, other, at: int, what: str = "current", unit: str = "A") -> str:
    """The state in words at one member of a batch."""
    angle, number = (float(np.broadcast_to(v, np.shape(theta)).flat[at]) for v in (theta, other))
    return f"armature angle {angle * 1e3:.4g} mrad, {what} {number:.4g} {unit}"


def settle(derivative, jacobian, y, channels, *, where: str = "", held=None) -> np.ndarray:
    """Scaled states (n,) at which `derivative` vanishes, by Newton's method with least squares and shorter steps.

    `derivative(y, f)` and `jacobian(y, J)` fill (n,) and (n, n); `channels` name the states and their scales. States in
    `held` (a mask) keep their values. A memory that any value suits keeps the one next to its start.
    Raises SolveError with the state that moves most where the states do not settle, and what to try.
    """
    n = len(y)
    f, J, y = np.empty(n), np.empty((n, n)), np.array(y, dtype=float)
    fixed = np.zeros(n, dtype=bool) if held is None else held

    def look(at):
        derivative(at, f)
        f[fixed] = 0.0
        return f.copy()

    rates, step = look(y), np.full(n, np.inf)
    for _ in range(60):
        jacobian(y, J)
        J[fixed], J[:, fixed] = 0.0, 0.0
        if not (np.isfinite(J).all() and np.isfinite(rates).all()):
            break
        scale = np.maximum(np.max(np.abs(J), axis=1), 1e-300)  # 1/s, of each balance by itself
        step = np.linalg.lstsq(J / scale[:, None], -rates / scale, rcond=1e-13)[0]
        size, share = np.max(np.abs(rates / scale)), 1.0
        while share > 1e-3:
            ahead = look(y + share * step)
            if np.isfinite(ahead).all() and np.max(np.abs(ahead / scale)) <= (1.0 - 0.1 * share) * size + 1e-14:
                break
            share /= 2.0
        y, rates = y + share * step, ahead
        if np.max(np.abs(share * step)) < 1e-12 or (share == 1.0 and np.max(np.abs(step)) < 1e-10):
            if np.max(np.abs(rates / scale)) < 1e-9:
                return y
            break
    worst = int(np.argmax(np.where(np.isfinite(step), np.abs(step), np.inf)))
    channel = channels[worst]
    raise SolveError(
        f"{where}the valve finds no rest at the start: {channel.name} stays in motion at "
        f"{y[worst] * channel.scale:.4g} {symbol(channel.unit)}. Try a smaller first command or a larger effect width"
    )


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


def nearest_root(K: np.ndarray, scale, theta) -> np.ndarray:
    """The root of the polynomial next to `theta`, by Newton's method in z = theta/scale; SolveError without one."""
    powers = np.arange(10)
    k = K * np.broadcast_to(np.asarray(scale)[..., None], (*K.shape[:-1], 1)) ** powers
    z = np.array(theta / scale, dtype=float)
    step = np.full(z.shape, np.inf)
    for _ in range(50):
        value = np.sum(k * z[..., None] ** powers, axis=-1)
        slope = np.sum(k[..., 1:] * powers[1:] * z[..., None] ** powers[:-1], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = value / slope
            z = z - step
        if np.all(np.abs(step) <= 1e-14):
            break
    if not np.all(np.abs(step) <= 1e-10):
        worst = int(np.argmin(np.abs(step) <= 1e-10))
        raise SolveError(
            f"TAD polynomial: no root next to {np.broadcast_to(theta, z.shape).flat[worst] * 1e3:.4g} mrad; Newton's "
            "method does not settle. Start nearer to a root (real_roots lists them)"
        )
    return z * scale
