"""Believable valves of a size: what similarity gives for every dimension, and how far a valve may be from it.

The anchor is NASA TN D-5388, the one size with a published set of internals: the reference
valve's. Larger and smaller valves follow from the port area at full stroke, a length scale l = sqrt(area/anchor's):

    spool: lengths ~ l, areas ~ l^2, volumes and mass ~ l^3 (geometric similarity)
    pilot: diameters and gap ~ l, so that its flow keeps its share of the rated one (2 to 4 % in print)
    torque motor: lengths ~ m = l^(1/3), since series 30 to 35 weigh 5 times as much at 14 times the flow; its torques
    at rated current ~ m^2, and its inertia ~ m^2.5
    coils of one series: i^2 R and i^2 L constant; in print i^2 R is 0.1 to 3.6 W, so that a resistance that is told
    sets both

What is fitted is the logarithm of each, or what lies around zero in units of its spread. Full stroke at rated current
takes the place of the coils' turns, and the armature's net stiffness that of its spring tube: a valve of any such
figures has a stable null.

Symbols
    A_N port area at full stroke, l m length scales, x_R full stroke, N = turns times rated current
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from valvesim.characterisation.rest_curve import rest_curve
from valvesim.errors import InputError, ValidityWarning
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, FromFiguresOptions
from valvesim.identification.from_figures.static_figures import static_figures
from valvesim.units import quantities
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.equations import drive_torque, flapper_torques
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve

ANCHOR = "similarity to NASA TN D-5388"
ANCHOR_STIFFNESS = 3.68  # N m/rad, net of tube, magnets and jets: 93 in-lb/in
ANCHOR_STROKE = 0.36e-3  # m, of the reference valve at rated current without load


@dataclass(frozen=True)
class Unknown:
    """A quantity that is fitted: its unit, spread of one standard deviation (of its logarithm, or in `unit` where it
    lies `around_zero`), and the power of the length scales l and m by which it follows the size.
    """  # fmt: skip

    name: str
    unit: str
    spread: float
    powers: tuple[float, float] = (0.0, 0.0)
    around_zero: bool = False


UNKNOWNS = (
    Unknown("port_width", "m", 0.25, (1.0, 0.0)),
    Unknown("full_stroke", "m", 0.25, (1.0, 0.0)),
    Unknown("spool_area", "m^2", 0.25, (2.0, 0.0)),
    Unknown("spool_mass", "kg", 0.3, (3.0, 0.0)),
    Unknown("spool_damping", "N*s/m", 0.5, (2.0, 0.0)),
    Unknown("chamber_volume", "m^3", 0.4, (3.0, 0.0)),
    Unknown("feedback_rod_stiffness", "N/m", 0.3, (-1.0, 2.0)),
    Unknown("net_stiffness", "N*m/rad", 0.3, (0.0, 2.0)),
    Unknown("armature_inertia", "kg*m^2", 0.3, (0.0, 2.5)),
    Unknown("armature_damping", "N*m*s/rad", 0.4, (0.0, 2.25)),
    Unknown("nozzle_diameter", "m", 0.2, (1.0, 0.0)),
    Unknown("null_gap", "m", 0.2, (1.0, 0.0)),
    Unknown("orifice_ratio", "1", 0.1),
    Unknown("land_opening_at_null", "m", 0.7),
    Unknown("radial_clearance", "m", 0.3),
    Unknown("lap", "m", 3e-6, around_zero=True),
    Unknown("air_gap_difference", "m", 1e-6, around_zero=True),
    Unknown("null_gap_difference", "m", 0.5e-6, around_zero=True),
    Unknown("coil_resistance", "ohm", 0.5),
    Unknown("coil_inductance", "H", 0.5),
)
"""What is fitted. `orifice_ratio` is that of the fixed orifice's area to the nozzle's curtain, over the anchor's.

`land_opening_at_null` is what leaks there, by rounded edges and underlap together: it alone sets null leakage and
pressure gain, while they hardly tell the `lap`: overlap, and below zero underlap, which never exceeds that opening."""


@dataclass(frozen=True)
class SimilarValves:
    """The valves of a size: `medians` (n,) of `UNKNOWNS`, and what of a valve is not fitted, `base`.

    `conditions` are those at which full stroke and stiffness are told; `scale` and `motor_scale` are l and m.
    """

    base: Valve
    oil: Oil
    conditions: Mapping[str, float]
    medians: np.ndarray
    scale: float
    motor_scale: float
    options: FromFiguresOptions = DEFAULT_FROM_FIGURES

    def quantities(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The unknowns in SI, each (k,), at points (k, n) in prior standard deviations."""
        moved = points * np.array([unknown.spread for unknown in UNKNOWNS])
        around_zero = np.array([unknown.around_zero for unknown in UNKNOWNS])
        values = np.where(around_zero, moved, self.medians * np.exp(np.where(around_zero, 0.0, moved)))
        return {unknown.name: values[:, k] for k, unknown in enumerate(UNKNOWNS)}

    def valves(self, points: np.ndarray) -> Valve:
        """The valves (k,) at points (k, n), each inside its physical bounds."""
        return self.valves_of(self.quantities(points))

    def valves_of(self, given: Mapping[str, np.ndarray]) -> Valve:
        """The valves (k,) of `quantities`."""
        base, anchor, own = self.base, Valve(), dict(given)
        stroke, net, ratio = own.pop("full_stroke"), own.pop("net_stiffness"), own.pop("orifice_ratio")
        own |= _lands(own.pop("land_opening_at_null"), own.pop("lap"))
        area = own["nozzle_diameter"] * own["null_gap"] / (anchor.nozzle_diameter * anchor.null_gap)
        own["fixed_orifice_diameter"] = anchor.fixed_orifice_diameter * np.sqrt(area * ratio)
        valve = replace(base, **_within_bounds(own | {"spool_stroke": self.options.similarity.stop * stroke}))
        spring = net - _spring_beside_the_tube(valve, self.conditions, self.oil)
        valve = replace(valve, **_within_bounds({"spring_tube_stiffness": spring}))
        turns = _turns(valve, stroke, self.conditions, self.oil)
        return replace(valve, **_within_bounds({"coil_turns": turns}))

    def ampere_turns(self, valve: Valve) -> np.ndarray:
        """ln of turns times rated current (k,) over what similarity gives, in prior standard deviations."""
        usual = Valve().coil_turns * Valve().rated_current * self.motor_scale**2
        return np.log(valve.coil_turns * valve.rated_current / usual) / self.options.similarity.ampere_turns_spread


def _within_bounds(given: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Quantities of a valve held inside their declared bounds."""
    bounds = {name: field.metadata["bounds"] for name, field in quantities(Valve).items()}
    return {name: np.clip(values, *bounds[name]) for name, values in given.items()}


def _lands(opening, lap) -> dict[str, np.ndarray]:
    """Null opening and overlap of lands (m) with an `opening` at null (m): `laws.land_opening` solved for the first."""
    overlap = np.where(lap > 0.0, lap, opening * np.expm1(np.minimum(lap, 0.0) / opening))
    closed = (opening + np.sqrt(opening * (opening + 4.0 * np.maximum(overlap, 0.0)))) / 2.0
    return {"null_opening": np.where(overlap > 0.0, closed, opening + overlap), "land_overlap": overlap}


def _spring_beside_the_tube(valve: Valve, conditions: Mapping[str, float], oil: Oil) -> np.ndarray:
    """What magnets and jets add to the armature's stiffness at null (k,), N m/rad: negative."""
    supply, back = conditions["supply_pressure"], conditions["return_pressure"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        c = valve.at(PartTemperatures.uniform(conditions["oil_temperature"]), oil=oil)
    turn = 1e-6

    def torque(theta):
        jets = flapper_torques(theta, 0.0, 0.0, supply, back, c)[1]
        return drive_torque(theta, 0.0, c) + jets

    return -(torque(turn) - torque(-turn)) / (2.0 * turn)


def _turns(valve: Valve, stroke, conditions: Mapping[str, float], oil: Oil) -> np.ndarray:
    """Turns (k,) of coils that hold the spool at full stroke (k,) at rated current, without load."""
    unit = 1000.0  # turns: the curve is of turns times current alone
    rated = np.asarray(valve.rated_current)
    curve = rest_curve(replace(valve, coil_turns=unit), conditions, oil)
    up, _ = curve.holding(np.reshape(stroke, (-1, 1)), np.zeros(1))
    down, _ = curve.holding(-np.reshape(stroke, (-1, 1)), np.zeros(1))
    return unit * (up - down)[:, 0] / 2.0 / rated


def similar_valves(
    *, rated_flow: float, pressure_drop: float, rated_current: float, conditions: Mapping[str, float], oil: Oil,
    coil_resistance: float | None = None, options: FromFiguresOptions = DEFAULT_FROM_FIGURES,
) -> SimilarValves:  # fmt: skip
    """The valves of a rated flow (m^3/s) at a pressure drop (Pa, both lands) and rated current (A), with a coil
    resistance (ohm) where it is told.

    Raises InputError for a flow or current that no two-stage nozzle-flapper valve has.
    """
    common = options.similarity
    at_70_bar = rated_flow * np.sqrt(7e6 / pressure_drop)
    for value, (low, high), factor, unit, key in (
        (at_70_bar, common.flows, 6e4, "L/min at 70 bar", "figures.rated_flow"),
        (rated_current, common.currents, 1e3, "mA", "figures.rated_current"),
    ):
        if not low <= value <= high:
            raise InputError(
                f"{value * factor:.4g} {unit}: two-stage nozzle-flapper servo valves have {low * factor:g} to "
                f"{high * factor:g}; a valve of another type cannot be identified here", key=key,
            )  # fmt: skip
    anchor = Valve()
    density = float(oil.density(conditions["oil_temperature"]))
    area = rated_flow / (anchor.port_flow_coefficient * np.sqrt(pressure_drop / density))
    scale = float(np.sqrt(area / (anchor.port_width * ANCHOR_STROKE)))
    motor = scale ** (1.0 / 3.0)
    resistance = common.coil_power / rated_current**2 if coil_resistance is None else coil_resistance
    own = {field.name: getattr(anchor, field.name) for field in fields(anchor)}
    own |= {
        "full_stroke": ANCHOR_STROKE, "net_stiffness": ANCHOR_STIFFNESS, "orifice_ratio": 1.0,
        "land_opening_at_null": common.null_opening, "lap": 0.0,
        "coil_resistance": resistance,
        "coil_inductance": resistance * anchor.coil_inductance / anchor.coil_resistance,
    }  # fmt: skip
    medians = np.array([own[u.name] * scale ** u.powers[0] * motor ** u.powers[1] for u in UNKNOWNS])
    base = replace(
        anchor, rated_current=rated_current, supply_pressure=conditions["supply_pressure"],
        return_pressure=conditions["return_pressure"],
        air_gap_area=anchor.air_gap_area * motor**2, magnet_reluctance=anchor.magnet_reluctance / motor**2,
    )  # fmt: skip
    similar = SimilarValves(base, oil, conditions, medians, scale, motor, options)
    return _passing(similar, rated_flow, {**conditions, "pressure_drop": pressure_drop})


def _passing(similar: SimilarValves, rated_flow: float, conditions: Mapping[str, float]) -> SimilarValves:
    """The same with stroke and port width such that the median valve passes the rated flow: the flow force differs
    between the rated flow's load and none, more so the larger the valve.
    """
    names = [unknown.name for unknown in UNKNOWNS]
    width_and_stroke = [names.index("port_width"), names.index("full_stroke")]
    for _ in range(4):
        median = similar.valves(np.zeros((1, len(UNKNOWNS))))
        found = static_figures(median, {"rated_flow"}, conditions, similar.oil, options=similar.options.static)
        flow = float(found["rated_flow"][0])
        medians = similar.medians.copy()
        medians[width_and_stroke] *= np.sqrt(rated_flow / flow)
        similar = replace(similar, medians=medians)
    return similar
