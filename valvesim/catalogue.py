"""The catalogue of effects that a nominal valve lacks. Simulation, diagnosis, documentation and reports read it.

Symbols
    i coil current, theta armature angle, v spool velocity, z memory in [-1, 1], p the parameters by name
"""

from __future__ import annotations

import numpy as np

from .channels import Channel
from .effects import Effect, Parameter, Ports, Situation
from .errors import unknown_name
from .fluid import aerated_bulk_modulus
from .laws import dahl_rate, play
from .parameters import Coefficients, PartTemperatures


def _coulomb(s: Situation, p, memory):
    (z,) = memory
    return Ports(spool_force=-p.friction_force * z), (dahl_rate(s.state.spool_velocity, z, p.presliding_distance),)


def _stribeck(s: Situation, p, memory):
    (z,) = memory
    v = s.state.spool_velocity
    force = p.breakaway_force * (p.kinetic_share + (1.0 - p.kinetic_share) * np.exp(-((v / p.stribeck_velocity) ** 2)))
    return Ports(spool_force=-force * z), (dahl_rate(v, z, p.presliding_distance),)


def _backlash(s: Situation, p, memory):
    c = s.coefficients
    deflection = (c.nozzle_arm + c.feedback_arm) * s.state.armature_angle + s.state.spool_position
    return Ports(rod_deflection=play(deflection, p.half_play) - deflection), ()


def _hysteresis(s: Situation, p, memory):
    (z,) = memory
    return Ports(coil_current=-p.coercive_current * z), (dahl_rate(s.coil_current_rate, z, p.turning_current),)


def _entrained_air(s: Situation, p, memory):
    c = s.coefficients

    def added(pressure):
        """1/E with air - 1/E without."""
        clean = c.bulk_modulus_at_zero + c.bulk_modulus_slope * pressure
        return 1.0 / aerated_bulk_modulus(clean, pressure, p.air_fraction, p.exponent) - 1.0 / clean

    x = s.state
    return Ports(compliance_1=added(x.nozzle_pressure_1), compliance_2=added(x.nozzle_pressure_2)), ()


def _demagnetization(c: Coefficients, p, parts: PartTemperatures):
    return c._replace(polarization_mmf=c.polarization_mmf * (1.0 - p.loss))


def _clogging(c: Coefficients, p, parts: PartTemperatures):
    """Diameters whose area is smaller by the clogged share, on the one side."""
    first = 1.0 * (p.side < 1.5)
    return c._replace(
        fixed_orifice_diameter_1=c.fixed_orifice_diameter_1 * np.sqrt(1.0 - p.clogged_share * first),
        fixed_orifice_diameter_2=c.fixed_orifice_diameter_2 * np.sqrt(1.0 - p.clogged_share * (1.0 - first)),
    )


_PRESLIDING = Parameter(
    name="presliding_distance", unit="m", doc="path over which friction reverses", default=0.5e-6, bounds=(1e-8, 1e-4)
)

CATALOGUE: dict[str, Effect] = {
    entry.name: entry
    for entry in (
        Effect(
            name="spool_coulomb_friction",
            doc="dry friction of the spool: -F z with z' = (v - |v| z)/d (Dahl)",
            location="spool force balance",
            signature="threshold and hysteresis in spool position, the same at every amplitude",
            parameters=(
                Parameter(
                    name="friction_force",
                    unit="N",
                    doc="friction force F",
                    default=0.0,
                    bounds=(0.0, 100.0),
                    neutral=0.0,
                ),
                _PRESLIDING,
            ),
            memory=(Channel("coulomb_friction_state", "1", "share of the friction force that acts", 1.0),),
            balance=_coulomb,
        ),
        Effect(
            name="spool_stribeck_friction",
            doc="dry friction that falls with speed: -F [k + (1-k) exp(-(v/v_s)^2)] z (Stribeck on Dahl)",
            location="spool force balance",
            signature="stick and slip: steps at slow reversal, less loss when moving",
            parameters=(
                Parameter(
                    name="breakaway_force",
                    unit="N",
                    doc="force F at rest",
                    default=0.0,
                    bounds=(0.0, 100.0),
                    neutral=0.0,
                ),
                Parameter(name="kinetic_share", unit="1", doc="share k left at speed", default=0.6, bounds=(0.0, 1.0)),
                Parameter(
                    name="stribeck_velocity", unit="m/s", doc="v_s of the fall", default=2e-3, bounds=(1e-5, 1.0)
                ),
                _PRESLIDING,
            ),
            memory=(Channel("stribeck_friction_state", "1", "share of the friction force that acts", 1.0),),
            balance=_stribeck,
        ),
        Effect(
            name="fixed_orifice_clogging",
            doc="a fixed orifice loses a share of its area on one side",
            location="chamber volume balance of that side",
            signature="null shift in proportion, less tare leakage, depends on supply pressure",
            parameters=(
                Parameter(
                    name="clogged_share",
                    unit="1",
                    doc="share of area lost",
                    default=0.0,
                    bounds=(0.0, 0.95),
                    neutral=0.0,
                ),
                Parameter(name="side", unit="1", doc="1 or 2", default=1.0, bounds=(1.0, 2.0)),
            ),
            coefficients=_clogging,
        ),
        Effect(
            name="magnet_demagnetization",
            doc="irreversible loss of the magnets: M0 (1 - IL), paper Eq. 4",
            location="magnetic circuit",
            signature="gain lost for good, with the negative magnetic spring; no return at 20 °C",
            parameters=(
                Parameter(
                    name="loss", unit="1", doc="irreversible loss IL", default=0.0, bounds=(0.0, 0.9), neutral=0.0
                ),
            ),
            coefficients=_demagnetization,
        ),
        Effect(
            name="feedback_ball_backlash",
            doc="play of the ball in its slot: the rod feels the deflection beyond +-half the play",
            location="feedback rod, in the torque and the spool force balance",
            signature="jump through null of constant size, limit cycle",
            parameters=(
                Parameter(
                    name="half_play", unit="m", doc="half the play", default=0.0, bounds=(0.0, 2e-4), neutral=0.0
                ),
            ),
            balance=_backlash,
        ),
        Effect(
            name="magnetic_hysteresis",
            doc="the iron holds back part of the current: -i_c z with z' = (i' - |i'| z)/i_t (Dahl, Duhem)",
            location="magnetic circuit",
            signature="rate-independent loop of angle and spool over current that grows with amplitude",
            parameters=(
                Parameter(
                    name="coercive_current",
                    unit="A",
                    doc="half width i_c of the full loop",
                    default=0.0,
                    bounds=(0.0, 5e-3),
                    neutral=0.0,
                ),
                Parameter(
                    name="turning_current",
                    unit="A",
                    doc="change i_t of current over which the loop turns",
                    default=2e-3,
                    bounds=(1e-5, 0.1),
                ),
            ),
            memory=(Channel("magnetic_hysteresis_state", "1", "share of the coercive current that acts", 1.0),),
            balance=_hysteresis,
        ),
        Effect(
            name="entrained_air",
            doc="air bubbles soften the oil in the chambers, most at low pressure (Simscape form)",
            location="chamber volume balances",
            signature="-90 degree point moves in, lightly damped",
            parameters=(
                Parameter(
                    name="air_fraction", unit="1", doc="by volume, 1 atm", default=0.0, bounds=(0.0, 0.2), neutral=0.0
                ),
                Parameter(name="exponent", unit="1", doc="polytropic exponent", default=1.4, bounds=(1.0, 1.67)),
            ),
            balance=_entrained_air,
        ),
    )
}


def effect(name: str) -> Effect:
    """The catalogue entry of that name; InputError with the nearest name otherwise."""
    if name not in CATALOGUE:
        raise unknown_name("effect", name, CATALOGUE)
    return CATALOGUE[name]
