"""The plant in which the tests hide an effect: an independent simulator of the same valve that writes session folders.

It is not the model: classical Runge-Kutta steps, LuGre friction, hysteresis by play operators, a second mode of the
armature, an amplifier, a supply line and sensor electronics of its own; unit-to-unit scatter, noise and resolution.
From `valvesim` it takes figures alone: the valve's dimensions, its coefficients over temperature, the heat capacities.

Symbols
    theta armature angle, x v spool, p1 p2 chamber pressures, i current, N = N_c i, g1 g2 null gaps, r b arms
    h step s, z bristle, F force N, T torque N m or temperature degC, q flow m^3/s. SI; temperatures in degC.

    case = draw(7, "effect", name="spool_coulomb_friction")
    write_session(case, folder)                  # what the diagnosis may see
    truth(case)                                  # what it must find
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from valvesim.valve.coefficients import PART_NAMES, PartTemperatures
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import ThermalNetwork

MU_0 = 4e-7 * math.pi
PLAYS = 10  # play operators of the hysteresis
PLAY_WIDTHS = np.array([0.05, 0.1, 0.2, 0.3, 0.45, 0.65, 0.9, 1.3, 1.9, 2.8])  # in turning currents
PLAY_WEIGHTS = np.array([0.51, 0.07, 0.15, 0.22, 0.4, 0.22, 0.13, 0.16, 0.0, 0.03])
"""Least squares to loops of Dahl's law over chirps, steps, triangles and multisines: alike in size, not in memory."""

# --------------------------------------------------------------------------- the equations, compiled

FIGURES = (
    "upper_air_gap_1", "upper_air_gap_2", "lower_air_gap_1", "lower_air_gap_2", "air_gap_area", "armature_arm",
    "polarization_mmf", "magnet_reluctance", "flux_share", "coil_turns", "coil_resistance", "coil_inductance",
    "spring_tube_stiffness", "feedback_rod_stiffness", "armature_inertia", "armature_damping", "nozzle_arm",
    "feedback_arm", "null_gap_1", "null_gap_2", "nozzle_diameter_1", "nozzle_diameter_2", "fixed_orifice_diameter_1",
    "fixed_orifice_diameter_2", "nozzle_flow_coefficient", "orifice_flow_coefficient", "chamber_volume", "spool_area",
    "spool_mass", "spool_damping", "spool_stroke", "port_width", "port_flow_coefficient", "null_opening",
    "spool_circumference", "radial_clearance", "land_length", "density", "dynamic_viscosity", "bulk_modulus_at_zero",
    "bulk_modulus_slope", "flapper_stop_stiffness", "spool_stop_stiffness", "stop_damping", "transition_pressure",
    "land_overlap", "pinch_force",
)  # fmt: skip
"""Figures of the valve that the equations read over time; the last two are the plant's own."""

KNOBS = (
    "saturation_current", "eddy_share", "eddy_time", "coercive_current", "turning_current", "droop_resistance",
    "droop_time", "return_resistance", "cavitation_loss", "cavitation_ratio", "air_fraction", "air_exponent",
    "coulomb_force", "breakaway_force", "kinetic_share", "stribeck_velocity", "silt_force", "silt_dwell", "silt_break",
    "half_play", "form", "size", "shape", "shape_2", "amplifier_lag", "line_resistance", "line_time", "extra_inertia",
    "extra_frequency", "bristle", "voltage_drive", "load_resistance", "loop_time", "loop_damping",
)  # fmt: skip
"""What an effect turns in the equations; zero is off."""

OFF = {
    **dict.fromkeys(KNOBS, 0.0), "eddy_time": 2e-3, "turning_current": 2e-3, "droop_time": 10e-3,
    "cavitation_ratio": 20.0, "air_exponent": 1.4, "kinetic_share": 0.6, "stribeck_velocity": 2e-3, "silt_dwell": 50e-3,
    "silt_break": 20e-6, "shape": 1.0, "shape_2": 1.0, "amplifier_lag": 20e-6, "line_resistance": 1.5e7,
    "line_time": 5e-4, "extra_inertia": 0.01, "extra_frequency": 3e3, "bristle": 1e-6,
}  # fmt: skip
"""Nothing hidden; the extra states of the plant are at work."""

STATES = 18  # theta, omega, p1, p2, x, v, i, eddy, droop, bristle, dahl, silt, memory, rod, extra, extra', line, i'
RECORDED = (
    "armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "spool_position", "load_flow", "internal_leakage",
    "current",
)  # fmt: skip


@njit(cache=True)
def _orifice(area, drop, density, transition):
    """Turbulent flow, linear below the transition pressure."""
    return area * math.sqrt(2.0 / density) * drop / math.sqrt(max(abs(drop), transition))


@njit(cache=True)
def _land(opening, drop, c):
    """Flow past one spool land: an edge that leaks over its rounding, and the slot behind it."""
    null = c.null_opening
    edge = opening + null if opening >= 0.0 else null * null / (null - opening)
    length = c.land_length + max(-opening, 0.0)
    slot = c.spool_circumference * c.radial_clearance**3 * drop / (12.0 * c.dynamic_viscosity * length)
    return _orifice(c.port_flow_coefficient * c.port_width * edge, drop, c.density, c.transition_pressure) + slot


@njit(cache=True)
def _stop(depth, speed, stiffness, damping):
    """Push back of a compliant stop entered by `depth` at `speed`, never pulling."""
    return stiffness * depth * max(1.0 + damping * speed, 0.0) if depth > 0.0 else 0.0


@njit(cache=True)
def _torque(theta, N, c):
    """Torque of the four gap forces; the flux through both pairs of gaps from the sum of the magnet loops."""
    scale = 1.0 / (MU_0 * c.air_gap_area)
    a = c.armature_arm * theta
    R1, R2 = (c.upper_air_gap_1 - a) * scale, (c.upper_air_gap_2 + a) * scale
    R3, R4 = (c.lower_air_gap_2 - a) * scale, (c.lower_air_gap_1 + a) * scale
    U, L = R1 + R2, R3 + R4
    flux = (2.0 * c.polarization_mmf - N * ((R1 - R2) / U + (R3 - R4) / L)) / (
        2.0 * R1 * R2 / U + 2.0 * R3 * R4 / L + c.magnet_reluctance / c.flux_share
    )
    phi1, phi2 = (N + R2 * flux) / U, (R1 * flux - N) / U
    phi3, phi4 = (N + R4 * flux) / L, (R3 * flux - N) / L
    return c.armature_arm * scale / 2.0 * (phi1 * phi1 + phi3 * phi3 - phi2 * phi2 - phi4 * phi4)


@njit(cache=True)
def _torque_constant(c):
    """dT/di at rest of a symmetric motor."""
    l1, l2 = (c.upper_air_gap_1 + c.upper_air_gap_2) / 2.0, (c.lower_air_gap_1 + c.lower_air_gap_2) / 2.0
    S = l1 + l2
    magnet = c.flux_share * S + MU_0 * c.air_gap_area * c.magnet_reluctance
    drive = c.polarization_mmf * c.coil_turns * c.armature_arm * c.flux_share
    return MU_0 * c.air_gap_area * drive * S / (l1 * l2 * magnet)


@njit(cache=True)
def _cavitation(ratio, k):
    """What is left of a nozzle's discharge coefficient at its pressure ratio."""
    return 1.0 - k.cavitation_loss * 0.5 * (1.0 + math.tanh((ratio / k.cavitation_ratio - 1.0) / 0.25))


@njit(cache=True)
def _stiffer(clean, p, fraction, exponent):
    """1/bulk modulus of oil with entrained air that follows a polytrope."""
    share = fraction * (101325.0 / max(p, 1e3)) ** (1.0 / exponent)
    return (1.0 / clean + share / (exponent * max(p, 1e3))) / (1.0 + share)


@njit(cache=True)
def _clamp(value, limit):
    return min(max(value, -limit), limit)


@njit(cache=True)
def _rates(t, y, u, supply, back, load, c, k, at_step, stops, dy, flows):
    """Rates of all states into `dy`, (load flow, leakage) into `flows`.

    `stops` are the play operators at the start of the step, `at_step` the current and the angle there.
    """
    theta, omega, p1, p2, x, v, i = y[0], y[1], y[2], y[3], y[4], y[5], y[6]
    form, size, shape, shape_2 = int(k.form), k.size, k.shape, k.shape_2
    r, b = c.nozzle_arm, c.feedback_arm

    # drive
    if k.voltage_drive > 0.0:
        dy[6] = (u - c.coil_resistance * i - _torque_constant(c) * omega) / c.coil_inductance
    elif k.loop_time > 0.0:  # a current loop of second order; the last state is its rate times that time
        dy[6] = y[17] / k.loop_time
        dy[17] = (u - i - 2.0 * k.loop_damping * y[17]) / k.loop_time
    else:
        dy[6] = (u - i) / k.amplifier_lag

    # what magnetises
    m = i
    if form == 13:  # a dead band of the amplifier
        m = i - _clamp(i, size)
    if k.saturation_current > 0.0:
        m = k.saturation_current * math.tanh(m / k.saturation_current)
    if k.coercive_current > 0.0:
        held = 0.0
        for n in range(PLAYS):
            held += PLAY_WEIGHTS[n] * _clamp(stops[n] + (i - at_step[0]) / k.turning_current, PLAY_WIDTHS[n])
        m -= k.coercive_current * held
    dy[7] = (m - y[7]) / k.eddy_time
    m -= k.eddy_share * (m - y[7])

    # pressures at the valve
    opening, closing = x - c.land_overlap, -x - c.land_overlap
    ps = supply - y[8]
    drawn = abs(_land(opening, (ps - load) / 2.0, c) - _land(closing, (ps + load) / 2.0, c))
    dy[8] = (k.droop_resistance * drawn - y[8]) / k.droop_time
    dy[16] = (drawn - y[16]) / k.line_time
    ps -= k.line_resistance * (drawn - y[16])
    if k.load_resistance > 0.0:  # lines between the ports
        recorded = load
        for _ in range(8):
            q = _land(opening, (ps - load) / 2.0, c) - _land(closing, (ps + load) / 2.0, c)
            load = 0.5 * (load + recorded + k.load_resistance * q * abs(q))
    p0 = back + k.return_resistance * drawn
    pa, pb = (ps + load) / 2.0, (ps - load) / 2.0
    q_pa, q_at = _land(opening, ps - pa, c), _land(closing, pa, c)
    q_pb, q_bt = _land(closing, ps - pb, c), _land(opening, pb, c)
    Q = q_pa - q_at

    # pilot stage
    cd0, cdf, g1, g2, x_f = c.orifice_flow_coefficient, c.nozzle_flow_coefficient, c.null_gap_1, c.null_gap_2, r * theta
    a_01 = math.pi / 4.0 * c.fixed_orifice_diameter_1**2 * cd0
    a_02 = math.pi / 4.0 * c.fixed_orifice_diameter_2**2 * cd0
    if form == 14:  # orifices whose coefficient falls with the pressure drop
        a_01 *= 1.0 - size * ((supply - p1) / 1e7 - 1.0)
        a_02 *= 1.0 - size * ((supply - p2) / 1e7 - 1.0)
    q_01 = _orifice(a_01, ps - p1, c.density, c.transition_pressure)
    q_02 = _orifice(a_02, ps - p2, c.density, c.transition_pressure)
    a_n1 = math.pi * c.nozzle_diameter_1 * max(g1 - x_f, 0.0) * cdf * _cavitation(p1 / p0, k)
    a_n2 = math.pi * c.nozzle_diameter_2 * max(g2 + x_f, 0.0) * cdf * _cavitation(p2 / p0, k)
    q_n1 = _orifice(a_n1, p1 - p0, c.density, c.transition_pressure)
    q_n2 = _orifice(a_n2, p2 - p0, c.density, c.transition_pressure)
    soft1 = 1.0 / (c.bulk_modulus_at_zero + c.bulk_modulus_slope * p1)
    soft2 = 1.0 / (c.bulk_modulus_at_zero + c.bulk_modulus_slope * p2)
    if k.air_fraction > 0.0:
        soft1 = _stiffer(1.0 / soft1, p1, k.air_fraction, k.air_exponent)
        soft2 = _stiffer(1.0 / soft2, p2, k.air_fraction, k.air_exponent)
    q_end = size * (p1 - p2) if form == 5 else 0.0  # leakage between the chambers, past the spool ends
    dy[2] = (q_01 - q_n1 - q_end - c.spool_area * v) / (c.chamber_volume * soft1)
    dy[3] = (q_02 - q_n2 + q_end + c.spool_area * v) / (c.chamber_volume * soft2)

    # feedback rod
    deflection = (r + b) * theta + x
    rod = c.feedback_rod_stiffness * (deflection - _clamp(deflection, k.half_play))
    dy[13] = 0.0
    if form == 12:  # Bouc-Wen: size is its yield force, shape its width
        speed = (r + b) * omega + v
        z = y[13]
        dy[13] = (speed - 0.5 * abs(speed) * abs(z) * z - 0.5 * speed * z * z) / shape
        rod += size * z

    # armature, and a second mode upon it
    jets = 2.0 * math.pi * r * cdf * cdf * (g1 + g2) * ps * (2.0 * x_f + g2 - g1)
    nozzles = -r * math.pi / 4.0 * (c.nozzle_diameter_1**2 * (p1 - p0) - c.nozzle_diameter_2**2 * (p2 - p0))
    T = _torque(theta, c.coil_turns * m, c) - c.armature_damping * omega - c.spring_tube_stiffness * theta
    T += nozzles + jets - (r + b) * rod
    T += r * _stop(-g2 - x_f, -r * omega, c.flapper_stop_stiffness, c.stop_damping)
    T -= r * _stop(x_f - g1, r * omega, c.flapper_stop_stiffness, c.stop_damping)
    dy[12] = 0.0
    if form == 4:  # torque quadratic in the angle
        T += size * theta * theta
    elif form == 8:  # torque that remembers the pressure difference
        dy[12] = ((p1 - p2) - y[12]) / shape
        T += size * y[12]
    elif form == 10:  # a torque periodic in time
        T += size * math.sin(2.0 * math.pi * shape * t + shape_2)
    elif form == 11:  # backlash-like memory on the armature: size N m at the width shape
        T -= size * _clamp(stops[PLAYS] + (theta - at_step[1]) / shape, 1.0)
    J2 = k.extra_inertia * c.armature_inertia
    wn = 2.0 * math.pi * k.extra_frequency
    link = J2 * (wn * wn * (theta - y[14]) + 0.04 * wn * (omega - y[15]))
    dy[0] = omega
    dy[1] = (T - link) / (c.armature_inertia - J2)
    dy[14] = y[15]
    dy[15] = link / J2

    # spool
    flow_force = -0.43 * c.port_width * (ps * x - load * abs(x))
    F = c.spool_area * (p1 - p2) - rod + flow_force - c.spool_damping * v
    F += _stop(-c.spool_stroke - x, -v, c.spool_stop_stiffness, c.stop_damping)
    F -= _stop(x - c.spool_stroke, v, c.spool_stop_stiffness, c.stop_damping)
    if form == 1:
        F -= size * x * x * x
    elif form == 2:
        F -= size * math.sin(2.0 * math.pi * x / shape)
    elif form == 3:
        F -= size * v * abs(v)
    elif form == 7:
        F -= size * supply * x * abs(x)
    elif form == 15:
        F -= size * x * x
    dy[9] = 0.0
    strongest = k.coulomb_force + k.breakaway_force
    if strongest > 0.0:  # LuGre
        stick = math.exp(-((v / k.stribeck_velocity) ** 2))
        slip = k.coulomb_force + k.breakaway_force * (k.kinetic_share + (1.0 - k.kinetic_share) * stick)
        stiffness = strongest / k.bristle
        dy[9] = v - stiffness * abs(v) * y[9] / slip
        F -= stiffness * y[9] + 0.2 * math.sqrt(stiffness * c.spool_mass) * dy[9] * math.exp(-((v / 5e-3) ** 2))
    dry = k.silt_force * y[11] + c.pinch_force
    dy[10] = (v - abs(v) * y[10]) / k.bristle
    dy[11] = (1.0 - y[11]) / k.silt_dwell - abs(v) * y[11] / k.silt_break
    F -= dry * y[10]
    dy[4] = v
    dy[5] = F / c.spool_mass

    # what flow meters see
    leakage = q_01 + q_02 + min(q_pa, q_at) + min(q_pb, q_bt)
    if form == 6:  # flow that saturates
        Q = math.tanh(size * Q) / size if size > 0.0 else Q
    elif form == 9:  # flow gain to one side alone
        Q = Q * (1.0 + size) if Q > 0.0 else Q
    flows[0], flows[1] = Q, leakage


@njit(cache=True)
def _integrate(y, command, rate, supply, ripple, back, load, table, now, view, knobs, each, stride, out):
    """Runge-Kutta on `y` in place: `each` steps to a sample of the command (straight in between), `out` every `stride`.

    `ripple` (amplitude Pa, frequency Hz, phase) comes upon the supply, constant over a step. `table` holds the figures
    in one row, or in one for each sample; `now` is room for those of a step, `view` the same room as an array.
    """
    n, h = len(command), 1.0 / rate / each
    c, k, trial, flows = now[0], knobs[0], np.zeros(STATES), np.zeros(2)
    view[:] = table[0]
    k1, k2, k3, k4 = np.zeros(STATES), np.zeros(STATES), np.zeros(STATES), np.zeros(STATES)
    stops, at_step = np.zeros(PLAYS + 1), np.array([y[6], y[0]])
    for step in range((n - 1) * each):
        sample = step // each
        if len(table) > 1:
            share = step / each - sample
            for j in range(len(view)):
                view[j] = table[sample, j] + share * (table[sample + 1, j] - table[sample, j])
        t, slope = step * h, (command[sample + 1] - command[sample]) / each
        u = command[sample] + slope * (step - sample * each)
        now_supply = supply + ripple[0] * math.sin(2.0 * math.pi * ripple[1] * t + ripple[2])
        _rates(t, y, u, now_supply, back, load, c, k, at_step, stops, k1, flows)
        if step % stride == 0:
            row = step // stride
            out[row, 0], out[row, 1], out[row, 2], out[row, 3] = y[0], y[2], y[3], y[4]
            out[row, 4], out[row, 5], out[row, 6] = flows[0], flows[1], y[6]
        for j in range(STATES):
            trial[j] = y[j] + 0.5 * h * k1[j]
        _rates(t + 0.5 * h, trial, u + 0.5 * slope, now_supply, back, load, c, k, at_step, stops, k2, flows)
        for j in range(STATES):
            trial[j] = y[j] + 0.5 * h * k2[j]
        _rates(t + 0.5 * h, trial, u + 0.5 * slope, now_supply, back, load, c, k, at_step, stops, k3, flows)
        for j in range(STATES):
            trial[j] = y[j] + h * k3[j]
        _rates(t + h, trial, u + slope, now_supply, back, load, c, k, at_step, stops, k4, flows)
        for j in range(STATES):
            y[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
        y[9], y[10] = _clamp(y[9], k.bristle), _clamp(y[10], 1.0)
        for j in range(PLAYS):
            stops[j] = _clamp(stops[j] + (y[6] - at_step[0]) / k.turning_current, PLAY_WIDTHS[j])
        stops[PLAYS] = _clamp(stops[PLAYS] + (y[0] - at_step[1]) / k.shape, 1.0)
        at_step[0], at_step[1] = y[6], y[0]


# --------------------------------------------------------------------------- a test run, its sensors, the case


@dataclass(frozen=True, eq=False)
class Run:
    """One record: `command` (n,) in A or V and `oil` temperature (n,) in degC at `rate`; pressures constant, Pa."""

    name: str
    shape: str
    rate: float
    command: np.ndarray
    oil: np.ndarray
    supply: float
    load: float
    role: str = "train"
    repeats: str = ""
    ripple: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the supply: Pa, Hz, phase

    @property
    def time(self) -> np.ndarray:
        """The samples' times, s."""
        return np.arange(len(self.command)) / self.rate


@dataclass(frozen=True)
class Meter:
    """A sensor as it is: noise (standard deviation) and resolution in SI, `colour` rho of AR(1), first-order `lag` s.

    `electronics` Hz is its second-order amplifier, whose delay the logger takes out; `stated` whether the session
    tells the noise.
    """

    channel: str
    noise: float
    resolution: float
    colour: float = 0.0
    lag: float = 0.0
    electronics: float = 5e3
    stated: bool = True


@dataclass(frozen=True, eq=False)
class Case:
    """All that a session hides. `hidden`: (name, parameters) at strength one; `unit`: figures of this valve, SI."""

    seed: int
    kind: str
    hidden: tuple[tuple[str, Mapping[str, Any]], ...]
    runs: tuple[Run, ...]
    meters: tuple[Meter, ...]
    unit: Mapping[str, float]
    drive: str = "current"
    isothermal: bool = True
    network: ThermalNetwork = field(default_factory=ThermalNetwork)
    between: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Parts that stand between others at each instant, by shares, whatever the network says."""

    @property
    def channels(self) -> tuple[str, ...]:
        """The output channels that are measured."""
        return tuple(meter.channel for meter in self.meters)

    @property
    def valve(self) -> Valve:
        """The valve on the bench, before anything is hidden in it."""
        return Valve(**self.unit)


# --------------------------------------------------------------------------- what can be hidden


@dataclass(frozen=True)
class Hidden:
    """One thing to hide: the amplitude's name, its span at strength one, what it does.

    `turn(c, k, T, p)` changes the figures c (name -> value over the run) and knobs k in place; T are the parts'
    temperatures, p the parameters. A `signed` amplitude takes either sign. `shapes` are the values to choose from.
    `shows`: output channels of which one must be measured. `session`: "voltage" drive, "thermal" (oil ramps and parts
    that follow), "low_pressure" in the fast records, or any.
    """

    parameter: str
    span: tuple[float, float]
    turn: Callable[[dict, dict, dict, dict], None]
    signed: bool = False
    neutral: float = 0.0
    shapes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    shows: tuple[str, ...] = ()
    session: str = ""


def _scale(name: str, factor: Callable[[dict], Any]) -> Callable[[dict, dict, dict, dict], None]:
    """Multiply a figure."""

    def turn(c, k, T, p):
        c[name] = c[name] * factor(p)

    return turn


def _knobs(**names: str) -> Callable[[dict, dict, dict, dict], None]:
    """Set knobs from the parameters of these names."""

    def turn(c, k, T, p):
        k.update({knob: p[name] for knob, name in names.items()})

    return turn


def _turns(c, k, T, p):
    c["coil_turns"] *= 1.0 - p["loss"]
    c["coil_resistance"] = c["coil_resistance"] * (1.0 - p["loss"])
    c["coil_inductance"] *= (1.0 - p["loss"]) ** 2


def _amplifier(c, k, T, p):
    k["amplifier_lag"] = OFF["amplifier_lag"] + p["time_constant"]


def _loop(c, k, T, p):
    k["loop_time"], k["loop_damping"] = p["time_constant"], p["damping_ratio"]


def _load_line(c, k, T, p):
    k["load_resistance"] = p["pressure_drop"] / 2.5e-4**2


def _saturation(c, k, T, p):
    if p["cubic_share"] > 0.0:
        k["saturation_current"] = p["reference_current"] / math.sqrt(3.0 * p["cubic_share"])


def _clogging(c, k, T, p):
    name = f"fixed_orifice_diameter_{p['side']:.0f}"
    c[name] = c[name] * math.sqrt(1.0 - p["clogged_share"])


def _erosion(c, k, T, p):
    """The nozzle's area grows with its diameter squared, its curtain with the diameter."""
    name = f"nozzle_diameter_{p['side']:.0f}"
    c[name] = c[name] * math.sqrt(1.0 + p["share"])


def _gaps(c, difference):
    c["null_gap_1"] = c["null_gap_1"] + difference / 2.0
    c["null_gap_2"] = c["null_gap_2"] - difference / 2.0


def _viscosity(c, k, T, p):
    c["dynamic_viscosity"] = c["dynamic_viscosity"] * p["viscosity_factor"]
    c["spool_damping"] *= p["viscosity_factor"]


def _pinch(c, k, T, p):
    c["pinch_force"] = p["friction_per_clearance"] * np.maximum(p["free_clearance"] - c["radial_clearance"], 0.0)


def _add(name: str, parameter: str) -> Callable[[dict, dict, dict, dict], None]:
    """Add a parameter to a figure."""

    def turn(c, k, T, p):
        c[name] = c[name] + p[parameter]

    return turn


FLOWS = ("load_flow", "internal_leakage")

EFFECTS: dict[str, Hidden] = {
    "magnet_demagnetization": Hidden("loss", (0.04, 0.12), _scale("polarization_mmf", lambda p: 1.0 - p["loss"])),
    "magnetic_hysteresis": Hidden(
        "coercive_current",
        (1e-4, 4e-4),
        _knobs(coercive_current="coercive_current", turning_current="turning_current"),
        shapes={"turning_current": (2e-3,)},
    ),
    "magnetic_saturation": Hidden("cubic_share", (0.05, 0.2), _saturation, shapes={"reference_current": (10e-3,)}),
    "coil_turns_loss": Hidden("loss", (0.04, 0.15), _turns),
    "eddy_current_lag": Hidden(
        "share", (0.1, 0.3), _knobs(eddy_share="share", eddy_time="time_constant"), shapes={"time_constant": (2e-3,)}
    ),
    "amplifier_lag": Hidden("time_constant", (2e-4, 1e-3), _amplifier),  # of a current drive
    "amplifier_second_order_lag": Hidden(
        "time_constant", (2e-4, 1e-3), _loop, shapes={"damping_ratio": (0.5, 0.7, 0.9)}),
    "flexure_stiffness_loss": Hidden("loss", (0.05, 0.15), _scale("spring_tube_stiffness", lambda p: 1.0 - p["loss"])),
    "fixed_orifice_clogging": Hidden("clogged_share", (0.015, 0.06), _clogging, shapes={"side": (1.0, 2.0)}),
    "nozzle_erosion": Hidden("share", (0.02, 0.08), _erosion, shapes={"side": (1.0, 2.0)}),
    "null_gap_asymmetry": Hidden("difference", (1e-6, 4e-6), lambda c, k, T, p: _gaps(c, p["difference"]), signed=True),
    "thermal_gradient_null_drift": Hidden(
        "drift",
        (2e-8, 8e-8),
        lambda c, k, T, p: _gaps(c, p["drift"] * (T["oil"] - T["body"])),
        signed=True,
        session="thermal",
    ),
    "thermal_lag": Hidden("time_constant", (2.0, 8.0), lambda c, k, T, p: None, session="thermal"),
    "load_line_resistance": Hidden(
        "pressure_drop", (1e6, 4e6), _load_line, shows=("load_flow",)
    ),
    "supply_pressure_droop": Hidden(
        "resistance",
        (1e9, 5e9),
        _knobs(droop_resistance="resistance", droop_time="time_constant"),
        shapes={"time_constant": (10e-3,)},
    ),
    "return_pressure_rise": Hidden("resistance", (1e9, 5e9), _knobs(return_resistance="resistance")),
    "flapper_cavitation": Hidden(
        "loss",
        (0.03, 0.12),
        _knobs(cavitation_loss="loss", cavitation_ratio="critical_ratio"),
        shapes={"critical_ratio": (20.0,)},
    ),
    "entrained_air": Hidden(
        "air_fraction",
        (0.05, 0.2),
        _knobs(air_fraction="air_fraction", air_exponent="exponent"),
        shapes={"exponent": (1.4,)},
        session="low_pressure",
        shows=("armature_angle", "nozzle_pressure_1", "nozzle_pressure_2"),
    ),
    "oil_viscosity_grade": Hidden("viscosity_factor", (2.5, 5.0), _viscosity, neutral=1.0, shows=("internal_leakage",)),
    "spool_coulomb_friction": Hidden("friction_force", (1.0, 4.0), _knobs(coulomb_force="friction_force")),
    "spool_stribeck_friction": Hidden(
        "breakaway_force",
        (1.5, 5.0),
        _knobs(breakaway_force="breakaway_force", kinetic_share="kinetic_share", stribeck_velocity="stribeck_velocity"),
        shapes={"kinetic_share": (0.6,), "stribeck_velocity": (2e-3,)},
    ),
    "spool_silting": Hidden(
        "friction_force",
        (3.0, 10.0),
        _knobs(silt_force="friction_force", silt_dwell="dwell_time", silt_break="break_distance"),
        shapes={"dwell_time": (50e-3,), "break_distance": (20e-6,)},
    ),
    "spool_thermal_pinch": Hidden(
        "friction_per_clearance", (2e6, 8e6), _pinch, shapes={"free_clearance": (3e-6,)}, session="thermal"
    ),
    "feedback_ball_backlash": Hidden("half_play", (1e-6, 6e-6), _knobs(half_play="half_play")),
    "spool_edge_wear": Hidden("rounding", (2e-6, 8e-6), _add("null_opening", "rounding"), shows=FLOWS),
    "spool_lap": Hidden("overlap", (3e-6, 12e-6), _add("land_overlap", "overlap"), signed=True, shows=FLOWS),
    "coil_resistance_drift": Hidden(
        "share", (0.05, 0.2), _scale("coil_resistance", lambda p: 1.0 + p["share"]), signed=True, session="voltage"
    ),
}
"""The catalogue's effects in the plant's own form; amplitudes at strength one clearly show."""


def _form(number: int, span: tuple[float, float], *, shows: tuple[str, ...] = (), signed: bool = False, **shapes):
    """A term outside the catalogue: its number in `_rates`, the span of its size, its shapes."""
    names = {"form_shape": "shape", "form_shape_2": "shape_2"}

    def turn(c, k, T, p):
        k["form"], k["size"] = float(number), p["size"]
        k.update({names[name]: p[name] for name in shapes})

    return Hidden("size", span, turn, signed=signed, shapes=shapes, shows=shows)


OUTSIDE: dict[str, Hidden] = {
    "cubic_spool_spring": _form(1, (1e11, 5e11)),  # N/m^3
    "spool_detent": _form(2, (1.0, 4.0), form_shape=(60e-6, 100e-6, 150e-6)),  # N over a pitch, m
    "quadratic_spool_damping": _form(3, (100.0, 500.0)),  # N s^2/m^2
    "quadratic_armature_torque": _form(4, (150.0, 500.0), signed=True),  # N m/rad^2
    "spool_end_leakage": _form(5, (1e-13, 4e-13)),  # m^3/(s Pa)
    "load_flow_saturation": _form(6, (1e3, 3e3), shows=("load_flow",)),  # s/m^3
    "hydraulic_lock": _form(7, (2.0, 8.0)),  # 1: N over Pa m^2
    "torque_memory_of_pressure": _form(8, (1e-10, 4e-10), signed=True, form_shape=(5e-3, 15e-3)),  # N m/Pa, lag s
    "one_sided_flow_gain": _form(9, (0.03, 0.1), signed=True, shows=("load_flow",)),
    "periodic_torque": _form(10, (1e-4, 5e-4), form_shape=(17.0, 37.0, 60.0), form_shape_2=(0.0, 1.0)),  # N m, Hz
    "armature_memory": _form(11, (2e-4, 8e-4), form_shape=(2e-5, 5e-5)),  # N m, rad
    "bouc_wen_rod": _form(12, (0.02, 0.08), form_shape=(5e-6, 15e-6)),  # N, m
    "amplifier_dead_band": _form(13, (5e-5, 2e-4)),  # A
    "orifice_exponent": _form(14, (0.02, 0.08), signed=True),  # share of the coefficient to 100 bar
    "one_sided_spool_spring": _form(15, (2e7, 8e7), signed=True),  # N/m^2
}
"""Terms that the catalogue lacks; the last words tell the unit of the size, then of the shape."""

PARAMETERS = (
    "feedback_rod_stiffness", "spool_area", "nozzle_arm", "feedback_arm", "fixed_orifice_diameter", "nozzle_diameter",
    "null_gap", "port_width", "armature_arm",
)  # fmt: skip
"""Figures of the valve that may be off by a multiple of their tolerance."""
TOLERANCE = 0.02

MATERIALS: dict[str, tuple[float, float]] = {
    "spring_tube_expansion": (0.2, 0.6), "feedback_rod_expansion": (0.2, 0.6), "polarization_mmf_slope": (0.2, 0.6),
    "spool_expansion": (0.1, 0.3),
}  # fmt: skip
"""Figures of materials that may be off, with the span of that in shares of their value: warm-ups show it."""
FIGURES_OFF = (*PARAMETERS, *MATERIALS)

SENSOR_FAULTS: dict[str, tuple[str, tuple[float, float]]] = {
    "sensor_bias": ("bias", (0.01, 0.05)),
    "sensor_gain": ("gain_error", (0.04, 0.12)),
    "sensor_lag": ("time_constant", (0.5e-3, 3e-3)),
    "sensor_delay": ("delay", (0.5e-3, 3e-3)),
    "sensor_temperature_drift": ("drift", (5e-4, 3e-3)),
}
"""Fault -> (parameter, span); bias and drift in shares of the channel's `AMPLITUDE`, made SI when drawn."""

KINDS = ("none", "effect", "pair", "outside", "parameter", "sensor", "poor")

UNDRAWN = ("amplifier_lag", "amplifier_second_order_lag", "load_line_resistance")
DRAWN = tuple(name for name in EFFECTS if name not in UNDRAWN)
"""What is drawn where no name is given: as it was when the lists of sessions were written down."""

POOR = (
    "magnetic_saturation", "eddy_current_lag", "magnetic_hysteresis", "magnet_demagnetization", "coil_turns_loss",
    "flexure_stiffness_loss",
)  # fmt: skip
"""Effects that tiny currents do not show."""

# --------------------------------------------------------------------------- drawing a case

OUTPUTS = (
    "spool_position", "load_flow", "armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "internal_leakage"
)  # fmt: skip

AMPLITUDE = {
    "spool_position": 2.4e-4, "load_flow": 2.5e-4, "armature_angle": 1e-3, "nozzle_pressure_1": 1e6,
    "nozzle_pressure_2": 1e6, "internal_leakage": 3e-6, "current": 6e-3,
}  # fmt: skip
"""Size of each channel in an ordinary session, SI; noise is a share of it."""

DRIVE_RESISTANCE = 600.0
"""Volt of a drawn command by voltage to an ampere of one by current: more than any coil has, so that it is driven."""

UNITS = {
    "spool_position": ("um", 1e6), "load_flow": ("L/min", 6e4), "armature_angle": ("mrad", 1e3),
    "nozzle_pressure_1": ("bar", 1e-5), "nozzle_pressure_2": ("bar", 1e-5), "internal_leakage": ("L/min", 6e4),
    "current": ("mA", 1e3),
}  # fmt: skip
"""Channel -> (unit in files, factor from SI)."""

SCATTER = {
    **dict.fromkeys((
        "spring_tube_stiffness", "feedback_rod_stiffness", "polarization_mmf", "nozzle_diameter", "null_gap",
        "fixed_orifice_diameter", "spool_area", "port_width", "air_gap_area", "magnet_reluctance", "flux_share",
        "coil_turns", "armature_inertia", "port_flow_coefficient",
    ), (0.01, 0.02)),
    **dict.fromkeys(("armature_damping", "spool_damping", "chamber_volume", "spool_mass"), (0.03, 0.06)),
    **dict.fromkeys(("coil_resistance", "coil_inductance", "null_opening", "radial_clearance"), (0.01, 0.02)),
}  # fmt: skip
"""Figure -> (standard deviation, most) of the spread from valve to valve, in shares of its value."""

DIFFERENCES = {
    "null_gap_difference": (1.5e-7, 3e-7), "nozzle_diameter_difference": (3e-7, 6e-7),
    "fixed_orifice_difference": (3e-7, 6e-7), "air_gap_difference": (2e-7, 4e-7), "land_overlap": (2e-7, 5e-7),
}  # fmt: skip
"""What is zero on the drawing, side 1 minus side 2 or a lap: (standard deviation, most), m."""


def draw(
    seed: int,
    kind: str,
    *,
    name: str | None = None,
    noise: float | None = None,
    rate: float = 1000.0,
    duration: float = 1.0,
) -> Case:
    """The case of a seed: what is hidden (or `name`; "a+b" for a pair), in which valve, under which tests and sensors.

    `noise` is the sensors' standard deviation as a share of each channel's size, else drawn from 0.2 to 1 %. `rate` Hz
    and `duration` s of a record are others where the oil's temperature moves.
    """
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r} is none of {KINDS}")
    dice = np.random.default_rng([seed, KINDS.index(kind)])
    names = _names(dice, kind, name)
    entries = [_entry(each) for each in names]
    session = next((entry.session for entry in entries if entry is not None and entry.session), "")
    if not session and dice.random() < 0.15:  # no kind of session gives away what is hidden
        session = str(dice.choice(("thermal", "voltage", "low_pressure")))
    voltage = session == "voltage"
    channels = _channels(dice, [entry.shows for entry in entries if entry is not None and entry.shows])
    if kind == "poor":  # leakage about null shows the least shift
        channels = tuple(each for each in channels if each != "internal_leakage")
    isothermal = session != "thermal" and dice.random() < 0.9
    return Case(
        seed=seed,
        kind=kind,
        hidden=tuple((each, _figures(dice, each, channels)) for each in names),
        runs=_runs(dice, session=session, voltage=voltage, poor=kind == "poor", rate=rate, duration=duration),
        meters=_meters(dice, (*channels, "current") if voltage else channels, noise),
        unit=_unit(dice),
        drive="voltage" if voltage else "current",
        isothermal=isothermal,
    )


def _names(dice, kind: str, name: str | None) -> tuple[str, ...]:
    """What is hidden, drawn where no name is given."""
    pools = {
        "none": (), "effect": tuple(EFFECTS), "pair": tuple(EFFECTS), "outside": tuple(OUTSIDE), "poor": POOR,
        "parameter": PARAMETERS, "sensor": tuple(SENSOR_FAULTS),
    }  # fmt: skip
    pool = pools[kind]
    if name is None:
        pool = DRAWN if kind in ("effect", "pair") else pool
    else:
        names = tuple(name.split("+"))
        if unknown := [each for each in names if each not in pool]:
            raise ValueError(f"{unknown[0]!r} is none of {pool}")
        return names
    if kind != "pair":
        return (str(dice.choice(pool)),) if pool else ()
    while True:  # two that one kind of session can show
        names = tuple(str(each) for each in dice.choice(pool, 2, replace=False))
        if len({EFFECTS[each].session for each in names} - {""}) < 2:
            return names


def _entry(name: str) -> Hidden | None:
    return EFFECTS.get(name) or OUTSIDE.get(name)


def _channels(dice, needs: list[tuple[str, ...]]) -> tuple[str, ...]:
    """A drawn subset of the outputs, with a spool position or a load flow and whatever the hidden thing needs."""
    if dice.random() < 0.25:
        return OUTPUTS
    chosen = {str(dice.choice(OUTPUTS[:2]))}
    chosen |= {name for name in OUTPUTS if dice.random() < 0.35}
    for names in needs:
        if not chosen & set(names):
            chosen.add(str(dice.choice(names)))
    return tuple(name for name in OUTPUTS if name in chosen)


def _figures(dice, name: str, channels: tuple[str, ...]) -> dict[str, Any]:
    """Amplitude and shapes of what is hidden, SI."""

    def within(low: float, high: float) -> float:
        return float(f"{math.exp(dice.uniform(math.log(low), math.log(high))):.4g}")

    sign = float(dice.choice((-1.0, 1.0)))
    if name in SENSOR_FAULTS:
        parameter, span = SENSOR_FAULTS[name]
        smooth = [each for each in channels if each != "internal_leakage"]  # whose spikes no filter of samples can meet
        channel = str(dice.choice(smooth if name in ("sensor_lag", "sensor_delay") else channels))
        size = within(*span) * (AMPLITUDE[channel] if parameter in ("bias", "drift") else 1.0)
        return {"channel": channel, parameter: size if name in ("sensor_lag", "sensor_delay") else sign * size}
    if name in PARAMETERS:
        return {"offset": sign * within(3.0, 8.0) * TOLERANCE}
    if name in MATERIALS:
        return {"offset": sign * within(*MATERIALS[name])}
    entry = EFFECTS.get(name) or OUTSIDE[name]
    size = within(*entry.span) * (sign if entry.signed else 1.0)
    return {entry.parameter: size, **{shape: float(dice.choice(v)) for shape, v in entry.shapes.items()}}


def _unit(dice) -> dict[str, float]:
    """The figures of one valve off the line."""
    nominal = Valve()
    spread = {
        name: getattr(nominal, name) * (1.0 + float(np.clip(dice.normal(0.0, sd), -most, most)))
        for name, (sd, most) in SCATTER.items()
    }
    sides = {name: float(np.clip(dice.normal(0.0, sd), -most, most)) for name, (sd, most) in DIFFERENCES.items()}
    return {**spread, **sides}


def _meters(dice, channels: tuple[str, ...], noise: float | None) -> tuple[Meter, ...]:
    """Sensors: noise and its colour, resolution, lag; whether the session states the noise."""
    coloured, stated, slow = dice.random() < 0.5, dice.random() < 0.75, dice.random() < 0.3
    meters = []
    for channel in channels:
        spiky = channel == "internal_leakage"  # crosses its peak at null within 50 us: no filter may stand before it
        share = float(np.exp(dice.uniform(math.log(0.002), math.log(0.01))))
        sigma = float(f"{(share if noise is None else noise) * AMPLITUDE[channel]:.3g}")
        meters.append(
            Meter(
                channel=channel,
                noise=sigma,
                resolution=float(f"{sigma * dice.uniform(0.2, 1.0):.2g}"),
                colour=float(dice.uniform(0.5, 0.95)) if coloured else 0.0,
                lag=float(f"{dice.uniform(3e-4, 1.5e-3):.2g}") if slow and dice.random() < 0.5 and not spiky else 0.0,
                electronics=0.0 if spiky else float(dice.uniform(4e3, 8e3)),
                stated=stated,
            )
        )
    return tuple(meters)


def _runs(dice, *, session: str, voltage: bool, poor: bool, rate: float, duration: float) -> tuple[Run, ...]:
    """Four training runs, two of them the same, and two tests."""
    rate, duration = (500.0, 3.0) if session == "thermal" else (rate, duration)
    n = int(rate * duration) + 1
    shapes = ["chirp", "slow", str(dice.choice(("steps", "multisine")))]
    dice.shuffle(shapes)
    tests = ["chirp" if "multisine" in shapes else "multisine", str(dice.choice(("slow", "steps")))]
    odd_supply, odd_load, ramped = int(dice.integers(3)), dice.permutation(5)[:2], dice.permutation(5)[:2]
    still, runs = dice.uniform(-3e-4, 3e-4), []
    for k, shape in enumerate((*shapes, *tests)):
        current = _current(dice, shape, np.arange(n) / rate, duration)
        if poor:
            current = still + 0.01 * current
        start = dice.uniform(20.0, 60.0)
        oil = np.full(n, start)
        if session == "thermal":  # a launch in small: the oil goes up, or in one record down, and the parts follow
            begin, end = (15.0, dice.uniform(60.0, 90.0)) if k != 1 else (70.0, dice.uniform(10.0, 30.0))
            share = np.clip((np.arange(n) / rate - dice.uniform(0.1, 0.5)) / dice.uniform(0.1, 1.0), 0.0, 1.0)
            oil = begin + dice.uniform(0.0, 10.0) + (end - begin) * share
        elif k in ramped and not poor:
            oil = start + dice.uniform(-10.0, 20.0) * np.arange(n) / (n - 1)
        low = session == "low_pressure" and shape != "slow"
        runs.append(
            Run(
                name=f"record_{k + 1}",
                shape=shape,
                rate=rate,
                command=_rounded(current * DRIVE_RESISTANCE if voltage else current, 1e-9),
                oil=_rounded(oil, 0.01),
                supply=30e5 if low else 180e5 if k == odd_supply else 210e5,
                load=float(dice.choice((-60e5, -30e5, 30e5, 60e5))) * (not low) if k in odd_load else 0.0,
                role="train" if k < 3 else "test",
                repeats="a" if k == 0 else "",
            )
        )
    first = runs[0]
    again = replace(first, name="record_6")
    return (first, *runs[1:3], again, *runs[3:])


def _rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step


def _current(dice, shape: str, t: np.ndarray, duration: float) -> np.ndarray:
    """A current over time within about +-6 mA."""
    if shape == "chirp":
        top = 200.0 if duration <= 1.0 else 80.0
        phase = 2.0 * np.pi * (t + (top - 1.0) * t * t / (2.0 * duration))
        return dice.uniform(-2e-3, 2e-3) + dice.uniform(1.5e-3, 3.5e-3) * np.sin(phase)
    if shape == "slow":
        turns = dice.integers(1, 3) * t / duration * 2.0 + dice.uniform(0.0, 0.2)
        wave = np.sin(2.0 * np.pi * turns)
        if dice.random() < 0.5:
            wave = 2.0 / np.pi * np.arcsin(wave)  # a triangle
        large, small = dice.uniform(4e-3, 6e-3), dice.uniform(1e-3, 2.5e-3)
        return np.where(turns - turns[0] < (turns[-1] - turns[0]) / 2.0, large, small) * wave
    if shape == "steps":
        levels = dice.uniform(-5.5e-3, 5.5e-3, 60)
        edges = np.cumsum(dice.uniform(0.03, 0.1, 60)) * duration
        steps = levels[np.searchsorted(edges, t)]
        share, out = 1.0 - math.exp(-(t[1] - t[0]) / 2e-3), np.empty_like(t)
        out[0] = steps[0]
        for k in range(1, len(t)):
            out[k] = out[k - 1] + share * (steps[k] - out[k - 1])
        return out
    tones = np.geomspace(1.0 / duration, 150.0 if duration <= 1.0 else 60.0, 25)
    phases = dice.uniform(0.0, 2.0 * np.pi, 25)
    wave = np.sum(np.sin(2.0 * np.pi * tones[:, None] * t + phases[:, None]) / tones[:, None] ** 0.3, axis=0)
    return dice.uniform(4e-3, 6e-3) * wave / np.max(np.abs(wave))


# --------------------------------------------------------------------------- running it


def _parts(case: Case, run: Run, lag: float) -> dict[str, np.ndarray]:
    """Temperatures of oil and parts (n,), degC: the network by the trapezoidal rule, a further `lag` upon each part."""
    oil = run.oil
    if case.isothermal or np.ptp(oil) == 0.0 and abs(oil[0] - 20.0) < 1e-9:
        return dict.fromkeys(PART_NAMES, oil)
    network, nodes, h = case.network, [name for name in PART_NAMES if name != "oil"], 1.0 / run.rate
    A, b_oil, b_air = np.zeros((len(nodes), len(nodes))), np.zeros(len(nodes)), np.zeros(len(nodes))
    for name in (each.name for each in fields(network)):
        here, _, there = name.partition("_to_")
        for one, other in ((here, there), (there, here)) if there else ():
            if one in nodes:
                gain = getattr(network, name) / getattr(network, f"{one}_capacity")
                A[nodes.index(one), nodes.index(one)] -= gain
                if other in nodes:
                    A[nodes.index(one), nodes.index(other)] += gain
                elif other == "oil":
                    b_oil[nodes.index(one)] += gain
                else:
                    b_air[nodes.index(one)] += gain
    unit = np.eye(len(nodes))
    back, ahead = np.linalg.inv(unit - 0.5 * h * A), unit + 0.5 * h * A
    T = np.empty((len(oil), len(nodes)))
    T[0] = oil[0]
    for k in range(1, len(oil)):
        T[k] = back @ (ahead @ T[k - 1] + h * (b_oil * 0.5 * (oil[k - 1] + oil[k]) + b_air * 20.0))
    if lag > 0.0:
        late = T.copy()
        for k in range(1, len(oil)):
            late[k] = ((lag - 0.5 * h) * late[k - 1] + 0.5 * h * (T[k - 1] + T[k])) / (lag + 0.5 * h)
        T = late
    parts = {"oil": oil, **{name: T[:, k] for k, name in enumerate(nodes)}}
    mixed = {name: sum(by * parts[other] for other, by in shares.items()) for name, shares in case.between.items()}
    return parts | mixed


def _scaled(case: Case, strength: float) -> list[tuple[str, dict[str, Any]]]:
    """What is hidden, its amplitudes at `strength`."""
    scaled = []
    for name, figures in case.hidden:
        parameter, neutral = _amplitude(name)
        scaled.append((name, {**figures, parameter: neutral + strength * (figures[parameter] - neutral)}))
    return scaled


def _amplitude(name: str) -> tuple[str, float]:
    """(amplitude parameter, its neutral value) of a hidden thing."""
    if name in FIGURES_OFF:
        return "offset", 0.0
    if name in SENSOR_FAULTS:
        return SENSOR_FAULTS[name][0], 0.0
    entry = EFFECTS.get(name) or OUTSIDE[name]
    return entry.parameter, entry.neutral


def _simulate(case: Case, run: Run, hidden: list[tuple[str, dict[str, Any]]]) -> tuple[np.ndarray, np.ndarray]:
    """(times, signals in the order of `RECORDED`) of one run on a fine grid, a sample longer than the run."""
    figures = dict(case.unit)
    for name, p in hidden:
        if name in FIGURES_OFF:
            figures[name] = figures.get(name, getattr(Valve(), name)) * (1.0 + p["offset"])
    T = _parts(case, run, dict(hidden).get("thermal_lag", {}).get("time_constant", 0.0))
    if all(np.ptp(values) == 0.0 for values in T.values()):
        T = {name: values[:1] for name, values in T.items()}
    else:  # the run is a sample longer
        T = {name: np.append(values, values[-1]) for name, values in T.items()}
    c = Valve(**figures).at(PartTemperatures(**T))._asdict()
    c["pinch_force"] = 0.0
    k = {**OFF, "voltage_drive": float(case.drive == "voltage")}
    for name, p in hidden:
        if entry := _entry(name):
            entry.turn(c, k, T, p)
    table = np.column_stack([np.broadcast_to(c[name], T["oil"].shape) for name in FIGURES])
    now, knobs = (np.zeros(1, dtype=[(name, float) for name in names]) for names in (FIGURES, KNOBS))
    for name in KNOBS:
        knobs[name] = k[name]
    step = 5e-6 if any(k[name] for name in ("coulomb_force", "breakaway_force", "silt_force")) else 1e-5
    step = 5e-6 if np.any(c["pinch_force"]) else step
    each, stride = round(1.0 / run.rate / step), round(2e-5 / step)

    y, command = np.zeros(STATES), np.append(run.command, run.command[-1])
    y[2] = y[3] = run.supply / 2.0
    y[6] = y[7] = command[0] / table[0, FIGURES.index("coil_resistance")] if case.drive == "voltage" else command[0]
    back = Valve().return_pressure
    quiet, free = knobs.copy(), table[:1].copy()
    free[:, FIGURES.index("pinch_force")] = 0.0
    for name in ("coulomb_force", "breakaway_force", "silt_force", "coercive_current"):
        quiet[name] = 0.0
    if quiet["form"] in (10, 11):
        quiet["form"] = 0.0
    settle = np.full(int(0.06 * run.rate) + 1, command[0])
    scratch = np.empty((len(settle) * each // stride + 1, len(RECORDED)))
    room = (now, now.view(float))
    still = (0.0, 0.0, 0.0)
    _integrate(y, settle, run.rate, run.supply, still, back, run.load, free, *room, quiet, each, stride, scratch)
    y[9], y[10], y[11] = 0.0, 0.0, 1.0
    out = np.empty(((len(command) - 1) * each // stride, len(RECORDED)))
    _integrate(y, command, run.rate, run.supply, run.ripple, back, run.load, table, *room, knobs, each, stride, out)
    return np.arange(len(out)) * stride * step, out


def _first_order(values: np.ndarray, h: float, lag: float) -> np.ndarray:
    """First-order lag from rest."""
    from scipy.signal import lfilter

    b, a = np.array([h, h]), np.array([h + 2.0 * lag, h - 2.0 * lag])
    return values[0] + lfilter(b, a, values - values[0])


def _second_order(values: np.ndarray, h: float, frequency: float) -> np.ndarray:
    """Second-order low-pass (Butterworth) from rest."""
    from scipy.signal import butter, lfilter

    b, a = butter(2, 2.0 * frequency * h)
    return values[0] + lfilter(b, a, values - values[0])


def _read(case: Case, run: Run, meter: Meter, t: np.ndarray, values: np.ndarray, hidden) -> np.ndarray:
    """What a sensor reports (n,) of values on a fine grid `t`, before noise and resolution."""
    h = t[1] - t[0]
    known = OFF["amplifier_lag"] if case.drive == "current" else 0.0  # the logger's clock is that of the coils' current
    if meter.electronics > 0.0:
        values = _second_order(values, h, meter.electronics)
        known += h / math.sqrt(2.0) / math.tan(math.pi * meter.electronics * h)  # its delay: the logger takes it out
    faults = {name: p for name, p in hidden if p.get("channel") == meter.channel}
    for lag in (meter.lag, faults.get("sensor_lag", {}).get("time_constant", 0.0)):
        values = _first_order(values, h, lag) if lag > 0.0 else values
    late = faults.get("sensor_delay", {}).get("delay", 0.0)
    seen = np.interp(run.time + known - late, t, values)
    seen = seen * (1.0 + faults.get("sensor_gain", {}).get("gain_error", 0.0))
    seen = seen + faults.get("sensor_bias", {}).get("bias", 0.0)
    return seen + faults.get("sensor_temperature_drift", {}).get("drift", 0.0) * (run.oil - 20.0)


def responses(case: Case, strength: float = 1.0) -> list[dict[str, np.ndarray]]:
    """Per record of `case.runs`: time, inputs and the noise-free sensors' outputs, each (n,), SI.

    `strength` scales the amplitude of all that is hidden; at 0 nothing is.
    """
    hidden = _scaled(case, strength)
    done: dict[str, dict[str, np.ndarray]] = {}
    records = []
    for run in case.runs:
        key = run.repeats or run.name
        if key not in done:
            t, out = _simulate(case, run, hidden)
            if not np.all(np.isfinite(out)):
                raise FloatingPointError(f"the plant of {case.kind} {case.seed} {case.hidden} diverges in {run.name}")
            record = {"time": run.time, "current" if case.drive == "current" else "voltage": run.command}
            record |= {"oil_temperature": run.oil, "supply_pressure": np.full(len(run.oil), run.supply)}
            record |= {"load_pressure": np.full(len(run.oil), run.load)}
            for meter in case.meters:
                values = out[:, RECORDED.index(meter.channel)]
                record[meter.channel] = _read(case, run, meter, t, values, hidden)
            done[key] = record
        records.append(done[key])
    return records


def distance(case: Case, strength: float = 1.0) -> float:
    """Size of what is hidden in the training records, in standard deviations: sqrt(sum (y - y_0)^2/sigma^2).

    Nothing is fitted away and the noise counts as white: an upper bound of d'.
    """
    pairs = zip(case.runs, responses(case, strength), responses(case, 0.0), strict=True)
    total = 0.0
    for run, with_it, without in pairs:
        if run.role == "train":
            for meter in case.meters:
                total += float(np.sum(((with_it[meter.channel] - without[meter.channel]) / meter.noise) ** 2))
    return math.sqrt(total)


def noisy(
    case: Case, strength: float = 1.0, clean: list[dict[str, np.ndarray]] | None = None
) -> list[dict[str, np.ndarray]]:
    """`responses`, where they are known the `clean` ones, with each sensor's noise and resolution: what is logged."""
    dice = np.random.default_rng([case.seed, KINDS.index(case.kind), 1])
    records = []
    for each in responses(case, strength) if clean is None else clean:
        record = dict(each)
        for meter in case.meters:
            white = dice.normal(0.0, 1.0, len(each["time"]))
            rho, noise = meter.colour, np.empty(len(white))
            noise[0] = white[0]
            for k in range(1, len(white)):
                noise[k] = rho * noise[k - 1] + math.sqrt(1.0 - rho * rho) * white[k]
            values = each[meter.channel] + meter.noise * noise
            record[meter.channel] = _rounded(values, meter.resolution) if meter.resolution > 0.0 else values
        records.append(record)
    return records


# --------------------------------------------------------------------------- what the diagnosis sees, and the truth

_INPUT_UNITS = {
    "time": ("s", 1.0), "current": ("mA", 1e3), "voltage": ("V", 1.0), "oil_temperature": ("degC", 1.0),
    "supply_pressure": ("bar", 1e-5), "load_pressure": ("bar", 1e-5),
    **{f"{part}_temperature": ("degC", 1.0) for part in PART_NAMES},
}  # fmt: skip


def write_session(case: Case, folder: str | Path, strength: float = 1.0) -> None:
    """Write session.toml and one CSV for each record; nothing in them tells what is hidden."""
    write_files(case, noisy(case, strength), folder)


def write_files(case: Case, written: list[dict[str, np.ndarray]], folder: str | Path) -> None:
    """A session.toml and one CSV for each record, of columns in SI; NaN is an empty cell."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    lines = ['title = "Bench session"', "", "[thermal]", f"isothermal = {str(case.isothermal).lower()}"]
    for meter in case.meters:
        unit, factor = UNITS[meter.channel]
        lines += ["", f"[sensors.{meter.channel}]", f'resolution = "{meter.resolution * factor:.6g} {unit}"']
        if meter.stated:
            lines.append(f'noise = "{meter.noise * factor:.6g} {unit}"')
        if meter.lag > 0.0:
            lines.append(f'lag = "{meter.lag * 1e3:.6g} ms"')
    for run, record in zip(case.runs, written, strict=True):
        lines += ["", "[[records]]", f'file = "{run.name}.csv"', f'role = "{run.role}"']
        if run.repeats:
            lines.append(f'repeats = "{run.repeats}"')
        units = {name: UNITS.get(name) or _INPUT_UNITS[name] for name in record}
        header = ",".join(f"{name} [{unit}]" for name, (unit, _) in units.items())
        columns = np.column_stack([record[name] * factor for name, (_, factor) in units.items()])
        rows = [",".join("" if np.isnan(value) else f"{value:.10g}" for value in row) for row in columns]
        (folder / f"{run.name}.csv").write_text("\n".join([header, *rows, ""]), encoding="utf-8")
    (folder / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def shortened(case: Case, samples: int) -> Case:
    """The case with so many samples of each run."""
    return replace(
        case, runs=tuple(replace(run, command=run.command[:samples], oil=run.oil[:samples]) for run in case.runs)
    )


def truth(case: Case, strength: float = 1.0) -> dict[str, Any]:
    """What is hidden: kind, `causes` (catalogue names, `parameter:NAME`, or `outside:NAME`), `parameters` by cause, SI.

    Of an offset parameter both its relative `offset` (to this valve) and its `value` are given.
    """
    causes: dict[str, dict[str, Any]] = {}
    for name, figures in _scaled(case, strength):
        if name in FIGURES_OFF:
            value = case.unit.get(name, getattr(Valve(), name)) * (1.0 + figures["offset"])
            causes[f"parameter:{name}"] = {**figures, "value": value}
        else:
            causes[f"outside:{name}" if name in OUTSIDE else name] = figures
    return {"kind": case.kind, "causes": list(causes), "parameters": causes}
