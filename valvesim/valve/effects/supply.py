"""Effects of supply, return and oil.

Symbols
    Q load flow, p_s supply, p_0 return and p_L load pressure, p the parameters by name"""

from __future__ import annotations

import numpy as np

from valvesim.channels import Channel
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.effect import Advice, Effect, Ports, Situation
from valvesim.valve.effects.declare import amplitude_parameter, scaled, shape_parameter


def _droop(s: Situation, p, memory):
    """The memory is the lagged flow rather than the droop, so that no resistance is no droop whatever it holds."""
    (late,) = memory
    return Ports(supply_pressure=-p.resistance * late), ((np.abs(s.load_flow) - late) / p.time_constant,)


def _return_rise(s: Situation, p, memory):
    return Ports(return_pressure=p.resistance * np.abs(s.load_flow)), ()


_REFERENCE_FLOW = 2.5e-4  # m^3/s, 15 L/min: at which the drop of a load line is given


def _load_line(s: Situation, p, memory):
    """At the flow that is left beside it: of an orifice in series with the lands, which a part of the head drives."""
    share, u = s.load_flow / _REFERENCE_FLOW, s.inputs
    alone = p.pressure_drop * share * np.abs(share)
    way = share / (np.abs(share) + 1e-6)
    head = np.abs(u.supply_pressure - way * u.load_pressure) + s.coefficients.transition_pressure
    return Ports(load_pressure=alone / (1.0 + np.abs(alone) / head)), ()


def _viscosity_grade(c: Coefficients, p, parts: PartTemperatures):
    return scaled(c, dynamic_viscosity=p.viscosity_factor, spool_damping=p.viscosity_factor)


SUPPLY = (
    Effect(
        name="supply_pressure_droop",
        doc="the supply gives way to the load flow: p_s - R q with q' = (|Q| - q)/tau",
        location="supply pressure, in every balance",
        signature="less flow at large opening than the square root, later by tau; pilot pressures dip with the flow",
        advice=Advice(
            part="pump, accumulator and supply line",
            inspect="accumulator's charge, pump's compensator, bore and length of the line",
            confirm="supply pressure at the valve's port, fast, during steps of flow",
            remedy="accumulator at the valve; wider line",
        ),
        parameters=(
            amplitude_parameter("resistance", "Pa/(m^3/s)", "R of pump and supply line", (0.0, 2e10), 3e9),
            shape_parameter("time_constant", "s", "tau of accumulator and line", 10e-3, (1e-4, 10.0)),
        ),
        memory=(Channel("supply_droop_flow", "m^3/s", "load flow q that the supply has felt", 3e-4),),
        balance=_droop,
    ),
    Effect(
        name="return_pressure_rise",
        doc="the return backs up with the load flow: p_0 + R |Q|",
        location="pressure behind the nozzles",
        signature="both nozzle pressures up with the load flow, whichever way it goes",
        advice=Advice(
            part="return line and filter",
            inspect="return filter's pressure drop, bore of the line",
            confirm="return pressure at the valve's port during steps of flow",
            remedy="exchange the filter element; wider line",
        ),
        parameters=(amplitude_parameter("resistance", "Pa/(m^3/s)", "R of the return line", (0.0, 2e10), 3e9),),
        balance=_return_rise,
    ),
    Effect(
        name="load_line_resistance",
        doc="lines and meter between the ports take a pressure not recorded: p_L + dp (Q/Q_r) |Q/Q_r|, Q_r of 15 L/min",
        location="load pressure, in every balance",
        signature="less flow at large opening than the square root, at once; little else",
        advice=Advice(
            part="lines and flow meter between the ports",
            inspect="bore and length of the lines, the meter's pressure drop",
            confirm="load pressure at the valve's ports, the loop open, over flow",
            remedy="record the load pressure; wider lines",
        ),
        parameters=(amplitude_parameter("pressure_drop", "Pa", "dp of lines and meter at 15 L/min", (0.0, 2e7), 5e5),),
        balance=_load_line,
    ),
    Effect(
        name="oil_viscosity_grade",
        doc="another oil than stated: viscosity and the spool's viscous damping times f",
        location="leakage past the lands; spool force balance",
        signature="spool damped by f more, clearances of closed lands leak less by f; nothing through orifices",
        advice=Advice(
            part="oil",
            inspect="label and sample: viscosity at 40 and at 100 degC",
            confirm="leakage of the lands at two temperatures",
            remedy="fill the stated oil, or state the one that is in",
        ),
        parameters=(
            amplitude_parameter("viscosity_factor", "1", "f, of the stated oil's", (0.2, 5.0), 2.5, neutral=1.0),
        ),
        coefficients=_viscosity_grade,
    ),
)
