"""The catalogue of effects that a nominal valve lacks. Simulation, diagnosis, documentation and reports read it.

Symbols
    i coil current, theta armature angle, v spool velocity, z memory in [-1, 1] of a friction or hysteresis (Dahl),
    Q load flow, p_n pressure before a nozzle, p_0 behind it, T temperature °C, p the parameters by name
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .channels import Channel
from .effects import CHANNEL, Effect, Parameter, Ports, Reading, Situation
from .errors import unknown_name
from .fluid import aerated_bulk_modulus
from .laws import dahl_rate, lagged, play
from .parameters import PART_NAMES, REFERENCE_TEMPERATURE, Coefficients, PartTemperatures


def _amplitude(
    name: str, unit: str, doc: str, bounds: tuple[float, float], typical: float, neutral: float = 0.0
) -> Parameter:
    """What switches an effect: its default is the neutral value."""
    return Parameter(
        name=name, unit=unit, doc=doc, default=neutral, bounds=bounds, neutral=neutral, typical=typical
    )  # fmt: skip


def _shape(name: str, unit: str, doc: str, default: float, bounds: tuple[float, float]) -> Parameter:
    """What an effect looks like once it is there."""
    return Parameter(name=name, unit=unit, doc=doc, default=default, bounds=bounds)


_SIDE = _shape("side", "1", "1 or 2", 1.0, (1.0, 2.0))
_PRESLIDING = _shape("presliding_distance", "m", "path over which friction reverses", 0.5e-6, (1e-8, 1e-4))
_FRICTION_PLACE = "spool force balance"


def _friction_memory(kind: str) -> Channel:
    return Channel(f"{kind}_friction_state", "1", "share of the friction force that acts", 1.0)


def _times(c: Coefficients, **factors) -> Coefficients:
    """The coefficients with some of them multiplied."""
    return c._replace(**{name: getattr(c, name) * factor for name, factor in factors.items()})


def _by_side(side, change) -> tuple:
    """(change of side 1, change of side 2), where it befalls one of them."""
    first = 1.0 * (side < 1.5)
    return change * first, change * (1.0 - first)


# ---------------------------------------------------------------- torque motor and coil


def _demagnetization(c: Coefficients, p, parts: PartTemperatures):
    return _times(c, polarization_mmf=1.0 - p.loss)


def _hysteresis(s: Situation, p, memory):
    (z,) = memory
    return Ports(coil_current=-p.coercive_current * z), (dahl_rate(s.coil_current_rate, z, p.turning_current),)


def _saturation(s: Situation, p, memory):
    i = s.coil_current
    return Ports(coil_current=-p.cubic_share * i * (i / p.reference_current) ** 2), ()


def _turns_loss(c: Coefficients, p, parts: PartTemperatures):
    left = 1.0 - p.loss
    return _times(c, coil_turns=left, coil_resistance=left, coil_inductance=left * left)


def _eddy_current(s: Situation, p, memory):
    (late,) = memory
    behind = late - s.coil_current
    return Ports(coil_current=p.share * behind), (-behind / p.time_constant,)


def _resistance_drift(c: Coefficients, p, parts: PartTemperatures):
    return _times(c, coil_resistance=1.0 + p.share)


def _flexure_loss(c: Coefficients, p, parts: PartTemperatures):
    return _times(c, spring_tube_stiffness=1.0 - p.loss)


MOTOR = (
    Effect(
        name="magnet_demagnetization",
        doc="irreversible loss of the magnets: M0 (1 - IL), paper Eq. 4",
        location="magnetic circuit",
        signature="gain lost for good, with the negative magnetic spring; no return at 20 °C",
        parameters=(_amplitude("loss", "1", "irreversible loss IL", (0.0, 0.9), 0.05),),
        coefficients=_demagnetization,
        figure="polarization_mmf",
    ),
    Effect(
        name="magnetic_hysteresis",
        doc="the iron holds back part of the current: -i_c z with z' = (i' - |i'| z)/i_t (Dahl, Duhem)",
        location="magnetic circuit",
        signature="rate-independent loop of angle and spool over current that grows with amplitude",
        parameters=(
            _amplitude("coercive_current", "A", "half width i_c of the full loop", (0.0, 5e-3), 2e-4),
            _shape("turning_current", "A", "change i_t of current over which the loop turns", 2e-3, (1e-5, 0.1)),
        ),
        memory=(Channel("magnetic_hysteresis_state", "1", "share of the coercive current that acts", 1.0),),
        balance=_hysteresis,
        law_error=0.2,  # measured against play operators: 0.07 to 0.18
    ),
    Effect(
        name="magnetic_saturation",
        doc="the iron saturates: i - k i^3/i_r^2 magnetises",
        location="magnetic circuit",
        signature="gain falls towards rated current, alike on both sides and at every frequency; nothing near null",
        parameters=(
            _amplitude("cubic_share", "1", "share k of the current lost at the reference current", (0.0, 0.5), 0.2),
            _shape("reference_current", "A", "i_r, at which the share is lost", 10e-3, (1e-3, 1.0)),
        ),
        balance=_saturation,
    ),
    Effect(
        name="coil_turns_loss",
        doc="shorted turns: N_c (1 - s), resistance (1 - s), inductance (1 - s)^2",
        location="magnetic circuit; coil circuit of a voltage drive",
        signature="torque constant lost without the magnetic spring; at held voltage more current, faster",
        parameters=(_amplitude("loss", "1", "share s of the turns that is shorted", (0.0, 0.5), 0.05),),
        coefficients=_turns_loss,
        figure="coil_turns",
    ),
    Effect(
        name="eddy_current_lag",
        doc="a share s of the magnetising current lags: i + s (j - i) with j' = (i - j)/tau",
        location="magnetic circuit",
        signature="gain and phase step down about 1/(2 pi tau); nothing at rest, no loop in a slow sweep",
        parameters=(
            _amplitude("share", "1", "share s of the current that lags", (0.0, 0.9), 0.2),
            _shape("time_constant", "s", "tau of the eddy currents", 2e-3, (5e-5, 1.0)),
        ),
        memory=(Channel("eddy_lagging_current", "A", "current j that the eddy currents have let through", 1e-2),),
        balance=_eddy_current,
    ),
    Effect(
        name="coil_resistance_drift",
        doc="resistance of coil, leads and amplifier off: R (1 + s)",
        location="coil circuit of a voltage drive",
        signature="current at held voltage off in proportion, corner of the coil moved; nothing over current",
        parameters=(_amplitude("share", "1", "share s of the resistance, signed", (-0.5, 1.0), 0.1),),
        coefficients=_resistance_drift,
        figure="coil_resistance",
    ),
    Effect(
        name="flexure_stiffness_loss",
        doc="the spring tube has softened (fatigue, crack): K_s (1 - s)",
        location="armature torque balance",
        signature="armature natural frequency down, gain up a little; no loop, null unchanged",
        parameters=(_amplitude("loss", "1", "share s of the stiffness", (0.0, 0.5), 0.05),),
        coefficients=_flexure_loss,
        figure="spring_tube_stiffness",
    ),
)

# ---------------------------------------------------------------- pilot stage


def _clogging(c: Coefficients, p, parts: PartTemperatures):
    """Diameters whose area is smaller by the clogged share, on the one side."""
    first, second = _by_side(p.side, p.clogged_share)
    return _times(c, fixed_orifice_diameter_1=np.sqrt(1.0 - first), fixed_orifice_diameter_2=np.sqrt(1.0 - second))


def _erosion(c: Coefficients, p, parts: PartTemperatures):
    first, second = _by_side(p.side, p.share)
    return _times(c, nozzle_diameter_1=np.sqrt(1.0 + first), nozzle_diameter_2=np.sqrt(1.0 + second))


def _gap_difference(c: Coefficients, difference):
    return c._replace(null_gap_1=c.null_gap_1 + difference / 2.0, null_gap_2=c.null_gap_2 - difference / 2.0)


def _asymmetry(c: Coefficients, p, parts: PartTemperatures):
    return _gap_difference(c, p.difference)


def _gradient_drift(c: Coefficients, p, parts: PartTemperatures):
    return _gap_difference(c, p.drift * (np.asarray(parts.oil) - parts.body))


def _cavitation(s: Situation, p, memory):
    """The smooth step r^8/(1 + r^8) of r = p_n/(critical p_0), multiplied out: p_0 may be zero."""
    c, x = s.coefficients, s.state
    critical = (p.critical_ratio * s.inputs.return_pressure) ** 2 + c.transition_pressure**2

    def held_back(pressure, flow):
        square = pressure * pressure
        return p.loss * flow * square**4 / (square**4 + critical**4)

    return Ports(
        chamber_flow_1=held_back(x.nozzle_pressure_1, s.nozzle_flow_1),
        chamber_flow_2=held_back(x.nozzle_pressure_2, s.nozzle_flow_2),
    ), ()


def _entrained_air(s: Situation, p, memory):
    c = s.coefficients

    def added(pressure):
        """1/E with air - 1/E without."""
        clean = c.bulk_modulus_at_zero + c.bulk_modulus_slope * pressure
        return 1.0 / aerated_bulk_modulus(clean, pressure, p.air_fraction, p.exponent) - 1.0 / clean

    x = s.state
    return Ports(compliance_1=added(x.nozzle_pressure_1), compliance_2=added(x.nozzle_pressure_2)), ()


PILOT = (
    Effect(
        name="fixed_orifice_clogging",
        doc="a fixed orifice loses a share of its area on one side",
        location="chamber volume balance of that side",
        signature="null shift in proportion, less tare leakage, depends on supply pressure",
        parameters=(_amplitude("clogged_share", "1", "share of area lost", (0.0, 0.95), 0.05), _SIDE),
        coefficients=_clogging,
        figure="fixed_orifice_difference",
    ),
    Effect(
        name="nozzle_erosion",
        doc="a nozzle wears wider: its area grows by a share on one side",
        location="chamber volume balance of that side; nozzle pressure on the flapper",
        signature="null shift as of a clogged orifice on that side, but more tare leakage",
        parameters=(_amplitude("share", "1", "share by which the area grows", (0.0, 1.0), 0.05), _SIDE),
        coefficients=_erosion,
        figure="nozzle_diameter_difference",
    ),
    Effect(
        name="null_gap_asymmetry",
        doc="the flapper sits off centre: null gap 1 + d/2, null gap 2 - d/2",
        location="chamber volume balances; jets on the flapper",
        signature="null shift that keeps the flow of the pilot stage",
        parameters=(_amplitude("difference", "m", "d, gap 1 less gap 2, signed", (-2e-5, 2e-5), 2e-6),),
        coefficients=_asymmetry,
        figure="null_gap_difference",
    ),
    Effect(
        name="thermal_gradient_null_drift",
        doc="oil warmer than the body bends the pilot: gap 1 less gap 2 grows by k (T_oil - T_body)",
        location="chamber volume balances; jets on the flapper",
        signature="null wanders in a warm-up and comes back when the body has followed; nothing at even temperature",
        parameters=(_amplitude("drift", "m/K", "k, of the gap difference, signed", (-2e-7, 2e-7), 5e-8),),
        coefficients=_gradient_drift,
    ),
    Effect(
        name="flapper_cavitation",
        doc="vapour behind the nozzles: their flow falls by k r^8/(1 + r^8) of itself, r = p_n/(critical p_0)",
        location="chamber volume balances",
        signature="pilot pressures and null pressure up, more at high supply and low return pressure",
        parameters=(
            _amplitude("loss", "1", "k, share of the flow lost", (0.0, 0.6), 0.1),
            _shape("critical_ratio", "1", "p_n/p_0 at half the loss", 20.0, (1.0, 1000.0)),
        ),
        balance=_cavitation,
    ),
    Effect(
        name="entrained_air",
        doc="air bubbles soften the oil in the chambers, most at low pressure (Simscape form)",
        location="chamber volume balances",
        signature="-90 degree point moves in, lightly damped",
        parameters=(
            _amplitude("air_fraction", "1", "by volume, 1 atm", (0.0, 0.2), 0.1),
            _shape("exponent", "1", "polytropic exponent", 1.4, (1.0, 1.67)),
        ),
        balance=_entrained_air,
    ),
)

# ---------------------------------------------------------------- supply, return and oil


def _droop(s: Situation, p, memory):
    """The memory is the lagged flow rather than the droop, so that no resistance is no droop whatever it holds."""
    (late,) = memory
    return Ports(supply_pressure=-p.resistance * late), ((np.abs(s.load_flow) - late) / p.time_constant,)


def _return_rise(s: Situation, p, memory):
    return Ports(return_pressure=p.resistance * np.abs(s.load_flow)), ()


def _viscosity_grade(c: Coefficients, p, parts: PartTemperatures):
    return _times(c, dynamic_viscosity=p.viscosity_factor, spool_damping=p.viscosity_factor)


SUPPLY = (
    Effect(
        name="supply_pressure_droop",
        doc="the supply gives way to the load flow: p_s - R q with q' = (|Q| - q)/tau",
        location="supply pressure, in every balance",
        signature="less flow at large opening than the square root, later by tau; pilot pressures dip with the flow",
        parameters=(
            _amplitude("resistance", "Pa/(m^3/s)", "R of pump and supply line", (0.0, 2e10), 3e9),
            _shape("time_constant", "s", "tau of accumulator and line", 10e-3, (1e-4, 10.0)),
        ),
        memory=(Channel("supply_droop_flow", "m^3/s", "load flow q that the supply has felt", 3e-4),),
        balance=_droop,
    ),
    Effect(
        name="return_pressure_rise",
        doc="the return backs up with the load flow: p_0 + R |Q|",
        location="pressure behind the nozzles",
        signature="both nozzle pressures up with the load flow, whichever way it goes",
        parameters=(_amplitude("resistance", "Pa/(m^3/s)", "R of the return line", (0.0, 2e10), 3e9),),
        balance=_return_rise,
    ),
    Effect(
        name="oil_viscosity_grade",
        doc="another oil than stated: viscosity and the spool's viscous damping times f",
        location="leakage past the lands; spool force balance",
        signature="spool damped by f more, clearances of closed lands leak less by f; nothing through orifices",
        parameters=(_amplitude("viscosity_factor", "1", "f, of the stated oil's", (0.2, 5.0), 2.5, neutral=1.0),),
        coefficients=_viscosity_grade,
    ),
)

# ---------------------------------------------------------------- spool, feedback and lands


def _coulomb(s: Situation, p, memory):
    (z,) = memory
    return Ports(spool_force=-p.friction_force * z), (dahl_rate(s.state.spool_velocity, z, p.presliding_distance),)


def _stribeck(s: Situation, p, memory):
    """The curve bounds the bristle, not the force: a force that fell at once with speed would drive the 8 kHz mode."""
    (z,) = memory
    v = s.state.spool_velocity
    curve = p.kinetic_share + (1.0 - p.kinetic_share) * np.exp(-((v / p.stribeck_velocity) ** 2))
    return Ports(spool_force=-p.breakaway_force * z), ((v - np.abs(v) * z / curve) / p.presliding_distance,)


def _silting(s: Situation, p, memory):
    silt, z = memory
    v = s.state.spool_velocity
    silt_rate = (1.0 - silt) / p.dwell_time - np.abs(v) * silt / p.break_distance
    return Ports(spool_force=-p.friction_force * silt * z), (silt_rate, dahl_rate(v, z, p.presliding_distance))


def _thermal_pinch(s: Situation, p, memory):
    (z,) = memory
    force = p.friction_per_clearance * np.maximum(p.free_clearance - s.coefficients.radial_clearance, 0.0)
    return Ports(spool_force=-force * z), (dahl_rate(s.state.spool_velocity, z, p.presliding_distance),)


def _backlash(s: Situation, p, memory):
    c = s.coefficients
    deflection = (c.nozzle_arm + c.feedback_arm) * s.state.armature_angle + s.state.spool_position
    return Ports(rod_deflection=play(deflection, p.half_play) - deflection), ()


def _edge_wear(c: Coefficients, p, parts: PartTemperatures):
    return c._replace(null_opening=c.null_opening + p.rounding)


def _lap(c: Coefficients, p, parts: PartTemperatures):
    return c._replace(land_overlap=c.land_overlap + p.overlap)


SPOOL = (
    Effect(
        name="spool_coulomb_friction",
        doc="dry friction of the spool: -F z with z' = (v - |v| z)/d (Dahl)",
        location=_FRICTION_PLACE,
        signature="threshold and hysteresis in spool position, the same at every amplitude",
        parameters=(_amplitude("friction_force", "N", "friction force F", (0.0, 100.0), 1.0), _PRESLIDING),
        memory=(_friction_memory("coulomb"),),
        balance=_coulomb,
    ),
    Effect(
        name="spool_stribeck_friction",
        doc="dry friction that falls with speed: -F z with z' = (v - |v| z/g)/d, g = k + (1-k) exp(-(v/v_s)^2)",
        location=_FRICTION_PLACE,
        plainer="spool_coulomb_friction",
        signature="stick and slip: steps at slow reversal, less loss when moving",
        parameters=(
            _amplitude("breakaway_force", "N", "force F at rest", (0.0, 100.0), 1.5),
            _shape("kinetic_share", "1", "share k left at speed", 0.6, (0.05, 1.0)),
            _shape("stribeck_velocity", "m/s", "v_s of the fall", 2e-3, (1e-5, 1.0)),
            _PRESLIDING,
        ),
        memory=(_friction_memory("stribeck"),),
        balance=_stribeck,
    ),
    Effect(
        name="spool_silting",
        doc="particles settle at rest and are wiped off: -F s z with s' = (1 - s)/t_d - |v| s/d_b, z of Dahl",
        location=_FRICTION_PLACE,
        plainer="spool_coulomb_friction",
        signature="breakaway after a hold that grows with its length; gone while the spool keeps moving",
        parameters=(
            _amplitude("friction_force", "N", "force F of a spool long at rest", (0.0, 100.0), 3.0),
            _shape("dwell_time", "s", "t_d, in which silt settles", 50e-3, (1e-3, 1e3)),
            _shape("break_distance", "m", "d_b, path that wipes it off", 20e-6, (1e-7, 1e-3)),
            _PRESLIDING,
        ),
        memory=(Channel("silt", "1", "settled share s", 1.0), _friction_memory("silting")),
        balance=_silting,
    ),
    Effect(
        name="spool_thermal_pinch",
        doc="a spool warmer than its sleeve rubs: -k max(0, h_0 - radial clearance) z, z of Dahl",
        location=_FRICTION_PLACE,
        plainer="spool_coulomb_friction",
        signature="friction that comes in a warm-up and goes when the sleeve has followed; none at even temperature",
        parameters=(
            _amplitude("friction_per_clearance", "N/m", "k, force per clearance lost", (0.0, 1e8), 1.5e7),
            _shape("free_clearance", "m", "h_0, above which nothing rubs", 3e-6, (0.0, 1e-4)),
            _PRESLIDING,
        ),
        memory=(_friction_memory("pinch"),),
        balance=_thermal_pinch,
    ),
    Effect(
        name="feedback_ball_backlash",
        doc="play of the ball in its slot: the rod feels the deflection beyond +-half the play",
        location="feedback rod, in the torque and the spool force balance",
        signature="jump through null of constant size, limit cycle",
        parameters=(_amplitude("half_play", "m", "half the play", (0.0, 2e-4), 5e-6),),
        balance=_backlash,
    ),
    Effect(
        name="spool_edge_wear",
        doc="rounded edges of spool and sleeve: the null opening grows by d",
        location="main stage",
        signature="more leakage at null, flow gain and pressure gain softer there; spool and pilot unchanged",
        parameters=(_amplitude("rounding", "m", "d, added to the null opening", (0.0, 5e-5), 5e-6),),
        coefficients=_edge_wear,
        figure="null_opening",
    ),
    Effect(
        name="spool_lap",
        doc="lands longer (overlap) or shorter (underlap) than their ports: each opens by x - u instead of x",
        location="main stage",
        signature="dead band (u > 0) or double gain and leakage (u < 0) of the load flow about null; spool unchanged",
        parameters=(_amplitude("overlap", "m", "u at each land, signed", (-5e-5, 5e-5), 5e-6),),
        coefficients=_lap,
        figure="land_overlap",
    ),
)

# ---------------------------------------------------------------- temperatures


def _thermal_lag(times, parts: PartTemperatures, p) -> PartTemperatures:
    late = {
        name: lagged(times, np.broadcast_to(getattr(parts, name), np.shape(times)), p.time_constant)
        for name in PART_NAMES
        if name != "oil"
    }
    return replace(parts, **late)


THERMAL = (
    Effect(
        name="thermal_lag",
        doc="every part follows its temperature path with a further first-order lag tau; the oil does not",
        location="temperatures of the parts",
        signature="drift comes late in a temperature transient; nothing once temperatures hold",
        parameters=(_amplitude("time_constant", "s", "tau", (0.0, 1e4), 5.0),),
        temperatures=_thermal_lag,
    ),
)

# ---------------------------------------------------------------- sensors


def _bias(r: Reading, p):
    return r.values + p.bias


def _gain(r: Reading, p):
    return r.values * (1.0 + p.gain_error)


def _lag(r: Reading, p):
    return lagged(r.time, r.values, p.time_constant)


def _delay(r: Reading, p):
    """Straight lines between samples; before the first there is the first."""
    return np.interp(r.time - p.delay, r.time, r.values)


def _temperature_drift(r: Reading, p):
    return r.values + p.drift * (r.oil_temperature - REFERENCE_TEMPERATURE)


def _sensor(name: str, doc: str, signature: str, amplitude: Parameter, reading) -> Effect:
    return Effect(
        name=name, doc=doc, location="sensor", signature=signature, parameters=(amplitude,), reading=reading
    )  # fmt: skip


SENSORS = (
    _sensor(
        "sensor_bias",
        "the sensor reads b too much",
        "one channel off by a constant; every other one fits",
        _amplitude("bias", CHANNEL, "b, signed", (-1.0, 1.0), 0.02),
        _bias,
    ),
    _sensor(
        "sensor_gain",
        "the sensor reads (1 + g) of the value",
        "one channel off in proportion; every other one fits",
        _amplitude("gain_error", "1", "g, signed", (-0.9, 10.0), 0.03),
        _gain,
    ),
    _sensor(
        "sensor_lag",
        "the sensor follows with a first-order lag tau",
        "one channel late and smaller at high frequency, right at rest",
        _amplitude("time_constant", "s", "tau", (0.0, 10.0), 1e-3),
        _lag,
    ),
    _sensor(
        "sensor_delay",
        "the sensor reads the value of a time T ago",
        "one channel late by the same time at every frequency, of full size",
        _amplitude("delay", "s", "T", (0.0, 0.1), 1e-3),
        _delay,
    ),
    _sensor(
        "sensor_temperature_drift",
        "the sensor reads k (T_oil - 20 °C) too much",
        "one channel off by an offset that follows the oil temperature; every other one fits",
        _amplitude("drift", f"{CHANNEL}/K", "k, signed", (-0.02, 0.02), 1e-3),
        _temperature_drift,
    ),
)

CATALOGUE: dict[str, Effect] = {entry.name: entry for entry in (*MOTOR, *PILOT, *SUPPLY, *SPOOL, *THERMAL, *SENSORS)}


def effect(name: str) -> Effect:
    """The catalogue entry of that name; InputError with the nearest name otherwise."""
    if name not in CATALOGUE:
        raise unknown_name("effect", name, CATALOGUE)
    return CATALOGUE[name]
