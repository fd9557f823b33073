"""Three effects of one's own: what a leakage test bench does, blocked control ports and a slow flow meter.

The main stage is simulated with its ports joined, or with a load pressure that was measured. A leakage test blocks the
ports instead: each settles where the lands let in what they let out. A session names this file in `effects_files`.

Symbols
    x spool, a_in opening of the land from supply to port A, a_out from A to return, m; p_s supply, p_L = p_A - p_B Pa
    blocked and at rest, orifices alone: p_A/p_s = a_in^2/(a_in^2 + a_out^2), and B the other way about
    y = p_L a while (tau) ago, so that (p_L - y)/tau is the rate of p_L without a difference of noisy states
"""

import numpy as np

from valvesim import Effect, Parameter, Ports
from valvesim.channels import Channel
from valvesim.valve.equations import main_stage
from valvesim.valve.laws import lagged, land_opening

RATE_TIME = 0.2  # s, tau: short beside a sweep of minutes, long beside the time in which the valve settles


def blocked_pressure(s):
    """p_L (Pa) at which no oil leaves the ports."""
    c, x = s.coefficients, s.state.spool_position
    a_in, a_out = (land_opening(travel - c.land_overlap, c.null_opening) ** 2 for travel in (x, -x))
    return s.inputs.supply_pressure * (a_in - a_out) / (a_in + a_out)


def _blocked(s, p, memory):
    x, supply = s.state.spool_position, s.inputs.supply_pressure
    _, as_simulated = main_stage(x, supply, s.inputs.load_pressure, s.coefficients)
    off, leakage = main_stage(x, supply, blocked_pressure(s), s.coefficients)
    through_closing = leakage + 2.0 * np.abs(off)  # of the two lands of a port the closing one feels p_L's error less
    return Ports(internal_leakage=p.share * (through_closing - as_simulated)), ()


def _port_oil(s, p, memory):
    """Port A takes V_A/beta dp_A/dt from what the meter in the return reads, B gives; p_A = (p_s + p_L)/2."""
    (late,) = memory
    rate, c = (blocked_pressure(s) - late) / RATE_TIME, s.coefficients
    bulk_modulus = c.bulk_modulus_at_zero + c.bulk_modulus_slope * s.inputs.supply_pressure / 2.0
    return Ports(internal_leakage=-p.volume / bulk_modulus * rate / 2.0), (rate,)


BLOCKED_PORTS = Effect(
    name="blocked_ports",
    doc="the control ports are blocked: the lands leak at the load pressure that then settles",
    location="internal leakage",
    signature="up to sqrt(2) of the land leakage away from null; the same at null",
    parameters=(
        Parameter(name="share", unit="1", doc="1: blocked", default=0.0, bounds=(0.0, 1.0), neutral=0.0, typical=1.0),
    ),
    balance=_blocked,
)
PORT_OIL = Effect(
    name="blocked_port_oil",
    doc="oil compressed behind the blocked ports: A holds V more than B, hoses and gauge included",
    location="internal leakage",
    signature="leakage peak lower when the load pressure rises and higher when it falls, in proportion to the rate",
    parameters=(
        Parameter(
            name="volume", unit="m^3", doc="V, of port A less port B, signed", default=0.0, bounds=(-5e-3, 5e-3),
            neutral=0.0, typical=1e-4,
        ),
    ),
    memory=(Channel("late_blocked_pressure", "Pa", "load pressure of blocked ports a while ago", 1e7),),
    balance=_port_oil,
)  # fmt: skip
METER_LAG = Effect(
    name="slow_meter",
    doc="a flow meter that follows in seconds: a first-order lag, as sensor_lag, but of the size of sweeps of minutes",
    location="sensor",
    signature="branches of a sweep apart by twice lag times rate",
    parameters=(
        Parameter(name="time_constant", unit="s", doc="tau", default=0.0, bounds=(0.0, 20.0), neutral=0.0, typical=1.0),
    ),
    reading=lambda r, p: lagged(r.time, r.values, p.time_constant),
)
