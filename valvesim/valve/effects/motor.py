"""Effects of torque motor and coil.

Symbols
    i coil current, z memory in [-1, 1] of a hysteresis (Dahl), p the parameters by name"""

from __future__ import annotations

from valvesim.channels import Channel
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.effect import ActiveEffect, Advice, Effect, Ports, Situation
from valvesim.valve.effects.declare import amplitude_parameter, scaled, shape_parameter
from valvesim.valve.laws import dahl_rate


def _demagnetization(c: Coefficients, p, parts: PartTemperatures):
    return scaled(c, polarization_mmf=1.0 - p.loss)


def _hysteresis(s: Situation, p, memory):
    (z,) = memory
    return Ports(coil_current=-p.coercive_current * z), (dahl_rate(s.coil_current_rate, z, p.turning_current),)


def _saturation(s: Situation, p, memory):
    i = s.coil_current
    return Ports(coil_current=-p.cubic_share * i * (i / p.reference_current) ** 2), ()


def _turns_loss(c: Coefficients, p, parts: PartTemperatures):
    left = 1.0 - p.loss
    return scaled(c, coil_turns=left, coil_resistance=left, coil_inductance=left * left)


def _eddy_current(s: Situation, p, memory):
    (late,) = memory
    behind = late - s.coil_current
    return Ports(coil_current=p.share * behind), (-behind / p.time_constant,)


def _amplifier_lag(s: Situation, p, memory):
    """No lag at all at no time constant: what comes through at once is the share of an amplifier's own lag."""
    (late,) = memory
    behind, whole = late - s.coil_current, p.time_constant + _LEAST_LAG
    return Ports(coil_current=p.time_constant / whole * behind), (-behind / whole,)


def _amplifier_second_order_lag(s: Situation, p, memory):
    """As of first order: no lag at all at no time constant."""
    late, rise = memory
    behind, whole = late - s.coil_current, p.time_constant + _LEAST_LAG
    return (
        Ports(coil_current=p.time_constant / whole * behind),
        (rise / whole, -(behind + 2.0 * p.damping_ratio * rise) / whole),
    )


def _resistance_drift(c: Coefficients, p, parts: PartTemperatures):
    return scaled(c, coil_resistance=1.0 + p.share)


def _flexure_loss(c: Coefficients, p, parts: PartTemperatures):
    return scaled(c, spring_tube_stiffness=1.0 - p.loss)


_LEAST_LAG = 5e-5  # s, of any amplifier: its corner, 3 kHz, is far above a valve's
_TURNING_SHARE = 0.2  # of rated current: over which a loop turns where nothing else is known; the default, of 10 mA

MAGNETIC_HYSTERESIS = Effect(
    name="magnetic_hysteresis",
    doc="the iron holds back part of the current: -i_c z with z' = (i' - |i'| z)/i_t (Dahl, Duhem)",
    location="magnetic circuit",
    signature="rate-independent loop of angle and spool over current that grows with amplitude",
    advice=Advice(
        part="armature and pole pieces",
        inspect="marks of bending or blows on the soft iron, which harden it magnetically; chips in the gaps",
        confirm="quasi-static current loops of several sizes: the width follows the size, not the speed",
        remedy="demagnetise; anneal or exchange the iron parts",
    ),
    parameters=(
        amplitude_parameter("coercive_current", "A", "half width i_c of the full loop", (0.0, 5e-3), 2e-4),
        shape_parameter(
            "turning_current", "A", "change i_t of current over which the loop turns", 2e-3, (1e-5, 0.1), (1e-3, 4e-3)
        ),
    ),
    memory=(Channel("magnetic_hysteresis_state", "1", "share of the coercive current that acts", 1.0),),
    balance=_hysteresis,
    law_error=0.2,  # measured against play operators: 0.07 to 0.18
)


def hysteresis_of_width(width: float, rated_current: float) -> ActiveEffect:
    """The magnetic hysteresis whose full loop is so wide (A), on a valve of a rated current (A)."""
    half, turning = (float(f"{value:.6g}") for value in (width / 2.0, _TURNING_SHARE * rated_current))
    return MAGNETIC_HYSTERESIS(coercive_current=half, turning_current=turning)


MOTOR = (
    Effect(
        name="magnet_demagnetization",
        doc="irreversible loss of the magnets: M0 (1 - IL), paper Eq. 4",
        location="magnetic circuit",
        signature="gain lost for good, with the negative magnetic spring; no return at 20 °C",
        advice=Advice(
            part="permanent magnets",
            inspect="flux in the air gaps with a gaussmeter, against the valve's own record",
            confirm="torque or flow gain at the same current in cold and in hot oil: a loss stays when cold",
            remedy="remagnetise or exchange the magnets; keep the motor below the limit of their alloy",
        ),
        parameters=(amplitude_parameter("loss", "1", "irreversible loss IL", (0.0, 0.9), 0.05),),
        coefficients=_demagnetization,
        figure="polarization_mmf",
    ),
    MAGNETIC_HYSTERESIS,
    Effect(
        name="magnetic_saturation",
        doc="the iron saturates: i - k i^3/i_r^2 magnetises",
        location="magnetic circuit",
        signature="gain falls towards rated current, alike on both sides and at every frequency; nothing near null",
        advice=Advice(
            part="armature and pole pieces",
            inspect="cross sections and alloy against the drawing",
            confirm="flow gain at rated current against that about null",
            remedy="limit the current, or exchange the iron parts",
        ),
        parameters=(
            amplitude_parameter(
                "cubic_share", "1", "share k of the current lost at the reference current", (0.0, 0.5), 0.2
            ),
            shape_parameter("reference_current", "A", "i_r, at which the share is lost", 10e-3, (1e-3, 1.0)),
        ),
        balance=_saturation,
    ),
    Effect(
        name="coil_turns_loss",
        doc="shorted turns: N_c (1 - s), resistance (1 - s), inductance (1 - s)^2",
        location="magnetic circuit; coil circuit of a voltage drive",
        signature="torque constant lost without the magnetic spring; at held voltage more current, faster",
        advice=Advice(
            part="coils",
            inspect="resistance and inductance of each coil against the data sheet; insulation",
            confirm="resistance of both coils at one temperature: a short lowers that of one",
            remedy="exchange the coil",
        ),
        parameters=(amplitude_parameter("loss", "1", "share s of the turns that is shorted", (0.0, 0.5), 0.05),),
        coefficients=_turns_loss,
        figure="coil_turns",
        # a magnet and a flexure as weak lose torque per current as these do, and as much of one spring as of the other
        indistinguishable_from=("magnet_demagnetization", "flexure_stiffness_loss"),
    ),
    Effect(
        name="eddy_current_lag",
        doc="a share s of the magnetising current lags: i + s (j - i) with j' = (i - j)/tau",
        location="magnetic circuit",
        signature="gain and phase step down about 1/(2 pi tau); nothing at rest, no loop in a slow sweep",
        advice=Advice(
            part="pole pieces and coil formers",
            inspect="lamination, and conducting rings about the core",
            confirm="phase of the chamber pressure difference behind the current, 50 to 400 Hz, the spool blocked",
            remedy="laminated or slotted parts; else account for it in the control loop",
        ),
        parameters=(
            amplitude_parameter("share", "1", "share s of the current that lags", (0.0, 0.9), 0.2),
            shape_parameter("time_constant", "s", "tau of the eddy currents", 2e-3, (5e-5, 1.0), (5e-4, 2e-3, 2e-2)),
        ),
        memory=(Channel("eddy_lagging_current", "A", "current j that the eddy currents have let through", 1e-2),),
        balance=_eddy_current,
    ),
    Effect(
        name="amplifier_lag",
        doc="the coil's current lags the one that was recorded: (1 + tau_0 s)/(1 + (tau + tau_0) s), tau_0 of 0.05 ms",
        location="servo amplifier, whose command was recorded",
        signature="every output late by tau, and less beyond 1/(2 pi tau); nothing at rest, no loop in a slow sweep",
        advice=Advice(
            part="servo amplifier",
            inspect="bandwidth of its current loop; whether its command was recorded or the coil's current",
            confirm="the coil's current by a shunt beside its record, steps and 50 to 400 Hz",
            remedy="record the current of the coil",
        ),
        parameters=(amplitude_parameter("time_constant", "s", "tau of the current loop", (0.0, 0.02), 5e-4),),
        memory=(Channel("amplifier_current", "A", "current that the amplifier has brought up", 1e-2),),
        balance=_amplifier_lag,
    ),
    Effect(
        name="amplifier_second_order_lag",
        doc="the coil's current lags the recorded one i: y of T^2 y'' + 2 zeta T y' + y = i, T = tau + 0.05 ms, but a "
        "share 0.05 ms/T of i",
        location="servo amplifier, whose command was recorded",
        signature="every output late by 2 zeta tau, larger or smaller about 1/(2 pi tau); nothing at rest",
        advice=Advice(
            part="servo amplifier",
            inspect="bandwidth and damping of its current loop; whether its command was recorded or the coil's current",
            confirm="the coil's current by a shunt beside its record, steps and 50 to 400 Hz",
            remedy="record the current of the coil",
        ),
        parameters=(
            amplitude_parameter("time_constant", "s", "tau, 1/(natural angular frequency)", (0.0, 0.02), 5e-4),
            shape_parameter("damping_ratio", "1", "zeta of the current loop", 0.7, (0.1, 3.0), (0.5, 0.9)),
        ),
        plainer="amplifier_lag",
        memory=(
            Channel("amplifier_second_order_current", "A", "current that the amplifier has brought up", 1e-2),
            Channel("amplifier_current_rise", "A", "its rate times the time constant", 1e-2),
        ),
        balance=_amplifier_second_order_lag,
    ),
    Effect(
        name="coil_resistance_drift",
        doc="resistance of coil, leads and amplifier off: R (1 + s)",
        location="coil circuit of a voltage drive",
        signature="current at held voltage off in proportion, corner of the coil moved; nothing over current",
        advice=Advice(
            part="coils, leads and amplifier",
            inspect="plugs, crimps and leads, four-wire resistance at the valve",
            confirm="resistance at two temperatures: copper alone gives 0.39 % to a kelvin",
            remedy="mend the contact; drive by current",
        ),
        parameters=(amplitude_parameter("share", "1", "share s of the resistance, signed", (-0.5, 1.0), 0.1),),
        coefficients=_resistance_drift,
        figure="coil_resistance",
    ),
    Effect(
        name="flexure_stiffness_loss",
        doc="the spring tube has softened (fatigue, crack): K_s (1 - s)",
        location="armature torque balance",
        signature="armature natural frequency down, gain up a little; no loop, null unchanged",
        advice=Advice(
            part="spring tube",
            inspect="cracks by dye penetrant at its thin wall; oil in the motor cavity",
            confirm="frequency of the armature without pressure, against the valve's own record",
            remedy="take the valve out of service; exchange the spring tube",
        ),
        parameters=(amplitude_parameter("loss", "1", "share s of the stiffness", (0.0, 0.5), 0.05),),
        coefficients=_flexure_loss,
        figure="spring_tube_stiffness",
    ),
)
