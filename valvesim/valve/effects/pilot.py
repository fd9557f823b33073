"""Effects of the pilot stage: orifices, nozzles, flapper and chambers.

Symbols
    p_n pressure before a nozzle, p_0 behind it, E bulk modulus, T temperature °C, p the parameters by name"""

from __future__ import annotations

import numpy as np

from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.effect import Advice, Effect, Ports, Situation
from valvesim.valve.effects.declare import amplitude_parameter, scaled, shape_parameter
from valvesim.valve.fluid import aerated_bulk_modulus

_SIDE = shape_parameter("side", "1", "1 or 2", 1.0, (1.0, 2.0), (1.0, 2.0), discrete=True)


def _by_side(side, change) -> tuple:
    """(change of side 1, change of side 2), where it befalls one of them."""
    first = 1.0 * (side < 1.5)
    return change * first, change * (1.0 - first)


def _clogging(c: Coefficients, p, parts: PartTemperatures):
    """Diameters whose area is smaller by the clogged share, on the one side."""
    first, second = _by_side(p.side, p.clogged_share)
    return scaled(c, fixed_orifice_diameter_1=np.sqrt(1.0 - first), fixed_orifice_diameter_2=np.sqrt(1.0 - second))


def _erosion(c: Coefficients, p, parts: PartTemperatures):
    first, second = _by_side(p.side, p.share)
    return scaled(c, nozzle_diameter_1=np.sqrt(1.0 + first), nozzle_diameter_2=np.sqrt(1.0 + second))


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
        advice=Advice(
            part="fixed orifice of that side, and the filter before it",
            inspect="orifice and last-chance filter under a microscope; the oil's cleanliness (ISO 4406)",
            confirm="null bias over supply pressure, and the chamber pressures at null: that side's is low",
            remedy="flush or exchange orifice and filter; bring the oil to its class",
        ),
        parameters=(amplitude_parameter("clogged_share", "1", "share of area lost", (0.0, 0.95), 0.05), _SIDE),
        coefficients=_clogging,
        figure="fixed_orifice_difference",
    ),
    Effect(
        name="nozzle_erosion",
        doc="a nozzle wears wider: its area grows by a share on one side",
        location="chamber volume balance of that side; nozzle pressure on the flapper",
        signature="null shift as of a clogged orifice on that side, but more tare leakage",
        advice=Advice(
            part="nozzle of that side",
            inspect="edge of the nozzle under a microscope; particles in the oil",
            confirm="pilot flow at null against the valve's own record: it has risen",
            remedy="exchange the nozzle and set the null gap; better filtration",
        ),
        parameters=(amplitude_parameter("share", "1", "share by which the area grows", (0.0, 1.0), 0.05), _SIDE),
        coefficients=_erosion,
        figure="nozzle_diameter_difference",
    ),
    Effect(
        name="null_gap_asymmetry",
        doc="the flapper sits off centre: null gap 1 + d/2, null gap 2 - d/2",
        location="chamber volume balances; jets on the flapper",
        signature="null shift that keeps the flow of the pilot stage",
        advice=Advice(
            part="flapper and nozzles",
            inspect="null gaps by the pressures of both chambers at zero current",
            confirm="null bias over supply pressure at one temperature",
            remedy="set the nozzles anew",
        ),
        parameters=(amplitude_parameter("difference", "m", "d, gap 1 less gap 2, signed", (-2e-5, 2e-5), 2e-6),),
        coefficients=_asymmetry,
        figure="null_gap_difference",
    ),
    Effect(
        name="thermal_gradient_null_drift",
        doc="oil warmer than the body bends the pilot: gap 1 less gap 2 grows by k (T_oil - T_body)",
        location="chamber volume balances; jets on the flapper",
        signature="null wanders in a warm-up and comes back when the body has followed; nothing at even temperature",
        advice=Advice(
            part="pilot body",
            inspect="seats and screws of the nozzle block",
            confirm="null in a warm-up: it drifts and comes back once the body has the oil's temperature",
            remedy="warm the valve through before use, or compensate by oil and body temperature",
        ),
        parameters=(amplitude_parameter("drift", "m/K", "k, of the gap difference, signed", (-2e-7, 2e-7), 5e-8),),
        coefficients=_gradient_drift,
    ),
    Effect(
        name="flapper_cavitation",
        doc="vapour behind the nozzles: their flow falls by k r^8/(1 + r^8) of itself, r = p_n/(critical p_0)",
        location="chamber volume balances",
        signature="pilot pressures and null pressure up, more at high supply and low return pressure",
        advice=Advice(
            part="nozzles and return behind them",
            inspect="pitting at nozzle tips and flapper; return pressure",
            confirm="raise the return pressure by a few bar: what is wrong goes",
            remedy="higher return pressure; a nozzle of another edge",
        ),
        parameters=(
            amplitude_parameter("loss", "1", "k, share of the flow lost", (0.0, 0.6), 0.1),
            shape_parameter("critical_ratio", "1", "p_n/p_0 at half the loss", 20.0, (1.0, 1000.0)),
        ),
        balance=_cavitation,
        figure_error=0.05,  # of a hyperbolic tangent or an error function as steep, over 0.85 to 1.2 of r
    ),
    Effect(
        name="entrained_air",
        doc="air bubbles soften the oil in the chambers, most at low pressure (Simscape form)",
        location="chamber volume balances",
        signature="-90 degree point moves in, lightly damped",
        advice=Advice(
            part="oil and pilot chambers",
            inspect="oil level, suction line, bleed points",
            confirm="frequency response at low and at high pressure: air is stiff at high",
            remedy="bleed; mend the suction side; deaerate the oil",
        ),
        parameters=(
            amplitude_parameter("air_fraction", "1", "by volume, 1 atm", (0.0, 0.2), 0.1),
            shape_parameter("exponent", "1", "polytropic exponent", 1.4, (1.0, 1.67)),
        ),
        balance=_entrained_air,
        time_scale=1.4e-4,  # V/E over the slopes of what a chamber lets in and out
    ),
)
