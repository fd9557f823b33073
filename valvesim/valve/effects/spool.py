"""Effects of spool, feedback and lands.

Symbols
    x spool position, v spool velocity, z memory in [-1, 1] of a friction (Dahl), p the parameters by name"""

from __future__ import annotations

import numpy as np

from valvesim.channels import Channel
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.effect import Advice, Effect, Ports, Situation
from valvesim.valve.effects.declare import amplitude_parameter, shape_parameter
from valvesim.valve.laws import dahl_rate, play

_PRESLIDING = shape_parameter("presliding_distance", "m", "path over which friction reverses", 0.5e-6, (1e-8, 1e-4))
_FRICTION_PLACE = "spool force balance"


def _friction_memory(kind: str) -> Channel:
    return Channel(f"{kind}_friction_state", "1", "share of the friction force that acts", 1.0)


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


COULOMB_FRICTION = Effect(
    name="spool_coulomb_friction",
    doc="dry friction of the spool: -F z with z' = (v - |v| z)/d (Dahl)",
    location=_FRICTION_PLACE,
    signature="threshold and hysteresis in spool position, the same at every amplitude",
    advice=Advice(
        part="spool and sleeve",
        inspect="spool and bore for scores, burrs and varnish; cleanliness of the oil",
        confirm="threshold and hysteresis at very slow current, with and without dither",
        remedy="clean or lap spool and sleeve; dither; flush the oil",
    ),
    parameters=(amplitude_parameter("friction_force", "N", "friction force F", (0.0, 100.0), 1.0), _PRESLIDING),
    memory=(_friction_memory("coulomb"),),
    balance=_coulomb,
)

SPOOL = (
    COULOMB_FRICTION,
    Effect(
        name="spool_stribeck_friction",
        doc="dry friction that falls with speed: -F z with z' = (v - |v| z/g)/d, g = k + (1-k) exp(-(v/v_s)^2)",
        location=_FRICTION_PLACE,
        plainer="spool_coulomb_friction",
        as_common=True,  # oiled metal breaks loose harder than it slides (Armstrong-Helouvry et al. 1994)
        signature="stick and slip: steps at slow reversal, less loss when moving",
        advice=Advice(
            part="spool and sleeve",
            inspect="spool and bore for varnish and scores",
            confirm="small steps from rest against slow motion: it breaks loose with a jerk",
            remedy="clean or lap spool and sleeve; dither",
        ),
        parameters=(
            amplitude_parameter("breakaway_force", "N", "force F at rest", (0.0, 100.0), 1.5),
            shape_parameter("kinetic_share", "1", "share k left at speed", 0.6, (0.05, 1.0)),
            shape_parameter("stribeck_velocity", "m/s", "v_s of the fall", 2e-3, (1e-5, 1.0)),
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
        advice=Advice(
            part="spool, sleeve and oil",
            inspect="fine particles in the oil (below 5 um); varnish",
            confirm="let it rest under pressure for seconds and for minutes: the force to break loose grows",
            remedy="finer filtration, flushing, dither",
        ),
        parameters=(
            amplitude_parameter("friction_force", "N", "force F of a spool long at rest", (0.0, 100.0), 3.0),
            shape_parameter("dwell_time", "s", "t_d, in which silt settles", 50e-3, (1e-3, 1e3)),
            shape_parameter("break_distance", "m", "d_b, path that wipes it off", 20e-6, (1e-7, 1e-3)),
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
        feature="radial_clearance",
        signature="friction that comes in a warm-up and goes when the sleeve has followed; none at even temperature",
        advice=Advice(
            part="spool and sleeve",
            inspect="radial clearance against the drawing; pairing of alloys",
            confirm="a step of the oil's temperature: it sticks until the sleeve has followed",
            remedy="more clearance or alloys that expand alike; slower warm-up",
        ),
        parameters=(
            amplitude_parameter("friction_per_clearance", "N/m", "k, force per clearance lost", (0.0, 1e8), 1.5e7),
            shape_parameter("free_clearance", "m", "h_0, above which nothing rubs", 3e-6, (0.0, 1e-4), (3e-6, 5e-6)),
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
        advice=Advice(
            part="ball of the feedback rod and its slot",
            inspect="ball and slot under a microscope",
            confirm="limit cycle or dead band of the spool's position about null, the same at every speed",
            remedy="exchange rod or spool; a harder ball",
        ),
        parameters=(amplitude_parameter("half_play", "m", "half the play", (0.0, 2e-4), 5e-6),),
        balance=_backlash,
    ),
    Effect(
        name="spool_edge_wear",
        doc="rounded edges of spool and sleeve: the null opening grows by d",
        location="main stage",
        signature="more leakage at null, flow gain and pressure gain softer there; spool and pilot unchanged",
        advice=Advice(
            part="metering edges of spool and sleeve",
            inspect="edges under a microscope; particles in the oil",
            confirm="null leakage and pressure gain: leakage up, gain down",
            remedy="exchange spool and sleeve; better filtration",
        ),
        parameters=(amplitude_parameter("rounding", "m", "d, added to the null opening", (0.0, 5e-5), 5e-6),),
        coefficients=_edge_wear,
        figure="null_opening",
    ),
    Effect(
        name="spool_lap",
        doc="lands longer (overlap) or shorter (underlap) than their ports: each opens by x - u instead of x",
        location="main stage",
        signature="dead band (u > 0) or double gain and leakage (u < 0) of the load flow about null; spool unchanged",
        advice=Advice(
            part="lands of spool and sleeve",
            inspect="flow about null at constant pressure drop",
            confirm="flow gain about null against that beyond: less is overlap, more is underlap",
            remedy="grind the edges again, or pair another spool",
        ),
        parameters=(amplitude_parameter("overlap", "m", "u at each land, signed", (-5e-5, 5e-5), 5e-6),),
        coefficients=_lap,
        figure="land_overlap",
    ),
)
