"""Pure laws: orifices, magnetic circuit, contact, play and friction. Floats, numpy arrays and traced symbols alike.

Symbols
    q flow m^3/s, dp pressure drop Pa, rho density kg/m^3, mu dynamic viscosity Pa s
    phi magnetic flux Wb, R reluctance A/Wb, M0 polarization magnetomotive force A, N coil magnetomotive force A
    theta armature angle rad, x displacement m, v velocity m/s, F force N

Only `sqrt`, `abs`, `exp`, `maximum`, `minimum` and arithmetic are used and nothing branches on a state, so that the
tracer (`solver.codegen`) sees every term. Every square root has a named width at zero. `lagged` and
`linear_recursion` alone are for series over time.
"""

from __future__ import annotations

import numpy as np

MU_0 = 4e-7 * np.pi  # permeability of vacuum, V s/(A m)


def signed_root(x, width, laminar=0.0):
    """x/(sqrt(|x| + b^2) + b) with b = `laminar`, the square root's unit; sign(x) sqrt|x| at b = 0.

    |x| is made smooth within about `width` (same unit as x); at b = 0 the error is ~ (width/x)^2/4 beyond it.
    """
    return x / (np.sqrt(np.sqrt(x * x + width * width) + laminar * laminar) + laminar)


def orifice_flow(area, pressure_drop, density, transition_pressure, laminar_root=0.0):
    """Orifice: q = area sqrt(2 dp/rho), signed; linear in dp below `transition_pressure`.

    `area` m^2 includes the flow coefficient of turbulent flow. Source: Merritt (1967), ch. 3.
    A `laminar_root` b > 0 (sqrt(Pa), see `laminar_root`) carries it over to laminar flow: with loss K = k1/Re + k2 the
    flow is q = area sqrt(2/rho) dp/(sqrt(dp + b^2) + b), linear in dp where dp is far below b^2. Source: docs/oils.md.
    """
    return area * np.sqrt(2.0 / density) * signed_root(pressure_drop, transition_pressure, laminar_root)


def laminar_root(flow_coefficient, loss_per_diameter, viscosity, density):
    """b of `orifice_flow`, sqrt(Pa): C (k1/D_h) mu/sqrt(8 rho), so that K = k1/Re + 1/C^2 with Re = D_h u/nu.

    `loss_per_diameter` k1/D_h in 1/m, `viscosity` mu in Pa s. Zero for k1 = 0: a flow coefficient of temperature alone.
    """
    return flow_coefficient * loss_per_diameter * viscosity * np.sqrt(2.0 / density) / 4.0


def effective_flow_coefficient(flow_coefficient, pressure_drop, transition_pressure, root):
    """C of the moment, q/(A sqrt(2 dp/rho)), of an orifice with turbulent coefficient C and laminar root b."""
    size = np.sqrt(pressure_drop * pressure_drop + transition_pressure * transition_pressure)
    return flow_coefficient * (np.sqrt(size) / (np.sqrt(size + root * root) + root))


def slot_leakage(width, clearance, length, viscosity, pressure_drop):
    """Laminar flow through a concentric clearance: q = width h^3 dp/(12 mu L). Source: Merritt (1967), eq. 2-36."""
    return width * (clearance * clearance * clearance) * pressure_drop / (12.0 * viscosity * length)


def land_opening(opening, null_opening):
    """Effective opening of a spool land, m: `opening` once open, falling as 1/overlap when closed.

    Smooth through zero: opening + null for opening >= 0, null^2/(null - opening) below.
    Source: after Eryilmaz and Wilson, Combining leakage and orifice flows in a
    hydraulic servovalve model, ASME J. Dyn. Syst. Meas. Control 122 (2000).
    """
    overlap = np.maximum(-opening, 0.0)
    return np.maximum(opening, 0.0) + null_opening * null_opening / (null_opening + overlap)


def bridge_flux(mmf, coil_mmf, r1, r2, r3, r4, magnet_reluctance, flux_share):
    """Flux through the upper (and lower) pair of air gaps, Wb: phi1 + phi2 = phi3 + phi4.

    The nine equations of the circuit (Yan, Liu, Ma 2019, Eq. 11 restored) leave one unknown, for any four reluctances:
    Phi [2 R1 R2/(R1+R2) + 2 R3 R4/(R3+R4) + R0/gamma] = 2 M0 - N [(R1-R2)/(R1+R2) + (R3-R4)/(R3+R4)].
    """
    upper, lower = r1 + r2, r3 + r4
    path = 2.0 * r1 * r2 / upper + 2.0 * r3 * r4 / lower + magnet_reluctance / flux_share
    return (2.0 * mmf - coil_mmf * ((r1 - r2) / upper + (r3 - r4) / lower)) / path


def magnetic_torque(flux, coil_mmf, r1, r2, r3, r4, arm, gap_area):
    """Torque of the four gap forces, N m: a/(2 mu0 Ag) (phi1^2 - phi2^2 + phi3^2 - phi4^2), paper Eq. 32.

    With phi1 + phi2 = phi3 + phi4 = Phi it is a Phi/(2 mu0 Ag) [(phi1 - phi2) + (phi3 - phi4)].
    """
    upper = (2.0 * coil_mmf + (r2 - r1) * flux) / (r1 + r2)
    lower = (2.0 * coil_mmf + (r4 - r3) * flux) / (r3 + r4)
    return arm * flux * (upper + lower) / (2.0 * MU_0 * gap_area)


def contact_force(position, velocity, low, high, stiffness, damping):
    """Compliant stops at `low` and `high`: k d (1 + c d'), never pulling, with the depth d beyond a stop.

    Zero between the stops; continuous, since the damping (`damping` c in s/m) grows with the depth.
    Source: Hunt and Crossley (1975).
    """
    beyond, below = np.maximum(position - high, 0.0), np.maximum(low - position, 0.0)
    push_back = beyond * np.maximum(1.0 + damping * velocity, 0.0)
    push_on = below * np.maximum(1.0 - damping * velocity, 0.0)
    return stiffness * (push_on - push_back)


def play(displacement, half_width):
    """What a joint with play +-half_width passes on of a displacement: zero inside the play."""
    return displacement - np.minimum(np.maximum(displacement, -half_width), half_width)


def is_number(x) -> bool:
    """False of a traced symbol, which has no value yet: what is checked or warned of by value is left to numbers."""
    return not type(x).__module__.startswith("casadi")


def straight_segments(x, at, values):
    """Straight lines between the points (at, values), (m,) each with m > 1 and `at` rising, and on beyond both ends.

    A line with a bend at each inner point, without a search for the segment, so that a symbol passes through.
    """
    slopes = np.diff(values) / np.diff(at)
    y = values[0] + slopes[0] * (x - at[0])
    for k in range(1, len(slopes)):
        y = y + (slopes[k] - slopes[k - 1]) * np.maximum(x - at[k], 0.0)
    return y


def lagged(times, values, time_constant):
    """A first-order lag of values (n,) at times (n,), from rest: exact for straight lines between them.

    Times ascend; a pair of equal times is a jump. `time_constant` (s) is one number; zero gives the values themselves.
    Values may be columns (n, k) too.
    """
    if time_constant == 0.0:
        return values
    step, change = np.diff(times) / time_constant, np.diff(values, axis=0)
    if len(step) > 1 and np.ptp(step) < 1e-9 * step[0]:
        from scipy.signal import lfilter

        left, ramp = lag_of_step(time_constant, float(times[1] - times[0]))
        return values + np.concatenate([0.0 * values[:1], lfilter([-ramp], [1.0, -left], change, axis=0)])
    left = np.exp(-step)[:, None]
    ramp = np.divide(-np.expm1(-step), step, out=np.ones_like(step), where=step > 0.0)[:, None]
    # the distance d of the lag from its input: d' = -d/tau - u'
    added = -ramp * (change if change.ndim == 2 else change[:, None])
    distance = linear_recursion(np.broadcast_to(left, added.shape), added, np.zeros(added.shape[1]))
    return values + np.concatenate([0.0 * values[:1], distance.reshape(change.shape)])


def linear_recursion(factors, added, first):
    """y_1 to y_m (..., m, k) of y_j = factors_j y_j-1 + added_j from y_0 = `first` (..., k); factors and what is added
    are (..., m, k), no factor much above one. Steps are joined by two, then by four and so on.
    """
    reach = 1
    while reach < np.shape(factors)[-2]:
        later = factors[..., reach:, :]
        joined = later * added[..., :-reach, :] + added[..., reach:, :], later * factors[..., :-reach, :]
        added = np.concatenate([added[..., :reach, :], joined[0]], axis=-2)
        factors = np.concatenate([factors[..., :reach, :], joined[1]], axis=-2)
        reach *= 2
    return factors * first[..., None, :] + added


def lag_of_step(time_constant, step):
    """(what is left of the distance of a first-order lag from its input after a step, what of a change that is straight
    over the step is added to it), of one or of several steps (n,); zeros without a lag. Times in s.
    """
    if time_constant <= 0.0:
        return 0.0 * step, 0.0 * step
    share = step / time_constant
    return np.exp(-share), -np.expm1(-share) / share


def dahl_rate(rate, memory, width):
    """Rate of Dahl's memory z in [-1, 1]: z' = (u' - |u'| z)/width, a rate-independent loop over the path u.

    z runs from -1 to 1 within a path of about 3 `width`, and holds where the path rests. Source: Dahl (1968).
    """
    return (rate - np.abs(rate) * memory) / width
