"""Static figures of many valves at once: every rest of a valve as a function of the armature's angle.

At a held angle the chambers' pressures, the spool's position and the current that holds it follow from their balances
without iteration over the current, so that a valve's whole characteristic costs as much as one rest.

Symbols
    theta armature angle, i current, x spool, p_L load pressure, y a grid of load pressures, i_R rated current
    arrays are (k, m): k valves, m nodes

Figures are defined as on a bench (`characterisation.acceptance`), of a valve without hysteresis.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.acceptance.flow import LINE
from valvesim.characterisation.acceptance.metrics import NULL_SHARE
from valvesim.errors import ValidityWarning
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.equations import FLOW_FORCE_FACTOR, fixed_orifice_flow, main_stage
from valvesim.valve.equilibrium import balances_at_rest, chamber_pressure, nozzle_pressures
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve

NODES, DENSITY = 81, 3.5  # angles of a characteristic, and how dense they are about null
FALSE_POSITIONS = 7  # steps from two angles to the one in between
CURRENTS = np.linspace(*LINE, 16)  # shares of rated current of a flow gain
LOADS = np.linspace(-1.0, 1.0, 31) * 0.93  # shares of supply pressure of the leakage at blocked ports
PRESSURES = np.linspace(-NULL_SHARE, NULL_SHARE, 21)  # shares of supply pressure of a pressure gain
OUTER = np.linspace(0.95, 1.0, 4)  # shares of rated current of the tare


def columns_of(c: Coefficients) -> Coefficients:
    """Coefficients of a batch of k valves, each as a column (k, 1)."""
    members = max(np.size(value) for value in c)
    return Coefficients(*(np.broadcast_to(np.reshape(value, (-1, 1)), (members, 1)) for value in c))


def rows(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Each row's own straight interpolation: (k, n) values of y (k, m) over rising x (k, m) at `at` (k, n)."""
    shape = (len(x), np.shape(at)[-1])
    at, y = np.broadcast_to(at, shape), np.broadcast_to(y, x.shape)
    return np.stack([np.interp(a, b, c) for a, b, c in zip(at, x, y, strict=True)])


@dataclass(frozen=True)
class RestCurve:
    """Valves (k,) at rest at given pressures, over angles (k, m): the chambers' pressures there.

    What is asked between the angles is solved for there, so that it is smooth in every figure of a valve.
    """

    c: Coefficients
    supply: float
    back: float
    angle: np.ndarray
    pressures: tuple[np.ndarray, np.ndarray]

    def pressures_at(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pressures of the chambers at angles (k, n), exactly."""
        return _chambers(self.c, self.supply, self.back, angle)

    def pilot_flow(self, pressures: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """What both fixed orifices pass (k, n), m^3/s."""
        orifices = (self.c.fixed_orifice_diameter_1, self.c.fixed_orifice_diameter_2)
        first, second = (
            fixed_orifice_flow(d, self.supply - p, self.c) for d, p in zip(orifices, pressures, strict=True)
        )
        return first + second

    def at_current(self, current, load) -> tuple[np.ndarray, np.ndarray]:
        """(spool position, pilot flow), each (k, n), at currents (k, n) against a load pressure (Pa)."""

        def currents(angle, pressures):
            return self._balanced(angle, *pressures, load)[0]

        angle, pressures = self._angle(current, currents)
        return self._balanced(angle, *pressures, load)[1], self.pilot_flow(pressures)

    def holding(self, x, load) -> tuple[np.ndarray, np.ndarray]:
        """(current, pilot flow), each (k, n), that hold the spool at x (k, n) against load pressures (n,).

        The spool's force decides on the angle, since it is smooth where the flow force bends.
        """
        c = self.c

        def force(angle, pressures):
            rod = c.feedback_rod_stiffness * (c.nozzle_arm + c.feedback_arm) * angle
            return c.spool_area * (pressures[0] - pressures[1]) - rod

        flow_force = FLOW_FORCE_FACTOR * c.port_width * (self.supply * x - load * np.abs(x))
        angle, pressures = self._angle(c.feedback_rod_stiffness * x + flow_force, force)
        return self._balanced(angle, *pressures, load)[0], self.pilot_flow(pressures)

    def _angle(self, wanted, function: Callable) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """(angle, chambers' pressures), each (k, n), at which a function of them, which rises with it, is as wanted.

        From the angles on either side, by false position (Illinois): the function bends where the spool meets its stop.
        """
        values = np.maximum.accumulate(function(self.angle, self.pressures), axis=-1)
        wanted = np.broadcast_to(wanted, (len(values), np.shape(wanted)[-1]))
        upper = np.stack([np.searchsorted(v, w) for v, w in zip(values, wanted, strict=True)])
        upper = np.clip(upper, 1, values.shape[1] - 1)
        low, high = (np.take_along_axis(self.angle, upper - step, axis=-1) for step in (1, 0))
        below, above = (np.take_along_axis(values, upper - step, axis=-1) - wanted for step in (1, 0))
        angle, pressures = low, self.pressures
        for _ in range(FALSE_POSITIONS):
            share = np.where(above > below, -below / np.where(above > below, above - below, 1.0), 0.5)
            angle = low + np.clip(share, 0.0, 1.0) * (high - low)
            pressures = self.pressures_at(angle)
            miss = function(angle, pressures) - wanted
            under = miss < 0.0
            below, above = np.where(under, miss, below / 2.0), np.where(under, above / 2.0, miss)
            low, high = np.where(under, angle, low), np.where(under, high, angle)
        return angle, pressures

    def _balanced(self, angle, p1, p2, load) -> tuple[np.ndarray, np.ndarray]:
        """(current, spool position) at angles and chambers' pressures; the torque is quadratic in the current."""

        def torque(current):
            return balances_at_rest(angle, current, p1, p2, self.c, self.supply, self.back, load, 0.0)

        unit = 50.0 / self.c.coil_turns  # A, of the order of a rated current
        (above, x), (null, _), (below, _) = torque(unit), torque(0.0 * unit), torque(-unit)
        linear, square = (above - below) / 2.0, (above + below) / 2.0 - null
        share = -2.0 * null / (linear + np.sqrt(np.maximum(linear**2 - 4.0 * square * null, 0.0)))
        return share * unit, x


def rest_curve(valve: Valve, conditions: Mapping[str, float], oil: Oil) -> RestCurve:
    """The rests of a batch of valves at supply and return pressure and oil temperature."""
    supply, back, temperature = (conditions[n] for n in ("supply_pressure", "return_pressure", "oil_temperature"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        own = replace(valve, supply_pressure=supply, return_pressure=back, load_pressure=0.0)
        c = columns_of(own.at(PartTemperatures.uniform(temperature), oil=oil))
    nodes = np.sinh(np.linspace(-DENSITY, DENSITY, NODES)) / np.sinh(DENSITY)
    angle = nodes * 0.98 * np.minimum(c.null_gap_1, c.null_gap_2) / c.nozzle_arm
    return RestCurve(c, supply, back, angle, _chambers(c, supply, back, angle))


def _chambers(c: Coefficients, supply: float, back: float, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x_f, (guess_1, guess_2) = c.nozzle_arm * angle, nozzle_pressures(angle, c, supply, back)
    return (
        chamber_pressure(
            c.fixed_orifice_diameter_1, c.nozzle_diameter_1, c.null_gap_1 - x_f, c, supply, back, guess_1
        ),
        chamber_pressure(
            c.fixed_orifice_diameter_2, c.nozzle_diameter_2, c.null_gap_2 + x_f, c, supply, back, guess_2
        ),
    )  # fmt: skip


def spool_at(curve: RestCurve, current, load=0.0) -> np.ndarray:
    """Spool position (k, n) at currents (k, n), A."""
    return curve.at_current(current, load)[0]


def blocked_position(c: Coefficients, supply: float, load) -> np.ndarray:
    """Spool position (k, n) at which the main stage passes no load flow at load pressures (n,), by bisection."""
    high = np.zeros_like(load * c.spool_stroke) + c.spool_stroke
    low = -high
    for _ in range(45):
        middle = (low + high) / 2.0
        more = main_stage(middle, supply, load, c)[0] > 0.0
        low, high = np.where(more, low, middle), np.where(more, middle, high)
    return (low + high) / 2.0


def blocked_pressure(c: Coefficients, supply: float, x) -> np.ndarray:
    """Load pressure (k, n) at which the main stage passes no load flow at spool positions (k, n), by bisection."""
    high = np.zeros_like(x * c.spool_stroke) + supply
    low = -high
    for _ in range(45):
        middle = (low + high) / 2.0
        more = main_stage(x, supply, middle, c)[0] > 0.0  # falls with the load pressure
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return (low + high) / 2.0


# ---------------------------------------------------------------- figures, each (k,)


def _rated(valve: Valve) -> np.ndarray:
    """Rated currents as a column (k, 1) or (1, 1)."""
    return np.reshape(valve.rated_current, (-1, 1))


def _line(i: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(slope, current at zero) of the straight line through points (k, n), weighted by their share of the output."""
    w = np.abs(np.gradient(y, axis=-1))
    w = w / w.sum(axis=-1, keepdims=True)
    mi, my = (w * i).sum(axis=-1, keepdims=True), (w * y).sum(axis=-1, keepdims=True)
    slope = (w * (i - mi) * (y - my)).sum(axis=-1) / (w * (i - mi) ** 2).sum(axis=-1)
    return slope, mi[:, 0] - my[:, 0] / slope


def _null(curve: RestCurve) -> np.ndarray:
    """Current without flow at no load (k,), A."""
    at = blocked_position(curve.c, curve.supply, np.zeros(1))
    return curve.holding(at, np.zeros(1))[0][:, 0]


def _flow_lines(valve: Valve, curve: RestCurve) -> dict[str, np.ndarray]:
    rated, null = _rated(valve), _null(curve)[:, None]
    lines, normals, deviations = [], [], []
    for sign in (-1.0, 1.0):
        i = sign * CURRENTS * rated
        lines.append(_line(i, main_stage(spool_at(curve, i), curve.supply, 0.0, curve.c)[0]))
        i = null + sign * np.linspace(0.005, 1.0, 40) * rated
        off = i - null
        y = main_stage(spool_at(curve, i), curve.supply, 0.0, curve.c)[0]
        w = np.abs(np.gradient(y, axis=-1))
        normal = (w * off * y).sum(axis=-1) / (w * off**2).sum(axis=-1)
        normals.append(normal)
        deviations.append(np.abs(y - normal[:, None] * off).max(axis=-1))
    (slope_n, zero_n), (slope_p, zero_p) = lines
    top = (normals[0] + normals[1]) / 2.0 * rated[:, 0]
    return {
        "flow_gain": (slope_n + slope_p) / 2.0,
        "flow_at_rated": top,
        "linearity": np.maximum(*deviations) / top,
        "symmetry": np.abs(normals[0] - normals[1]) / np.maximum(*normals),
        "lap": (zero_p - zero_n) / rated[:, 0],
        "null_bias": null[:, 0] / rated[:, 0],
    }


def _rated_flow(valve: Valve, conditions: Mapping[str, float], oil: Oil) -> np.ndarray:
    drop, supply = conditions["pressure_drop"], conditions["supply_pressure"]
    curve = rest_curve(valve, {**conditions, "supply_pressure": max(supply, drop)}, oil)
    flows = []
    for sign in (-1.0, 1.0):
        load = sign * (curve.supply - drop)
        x = spool_at(curve, sign * _rated(valve), load)
        flows.append(sign * main_stage(x, curve.supply, load, curve.c)[0][:, 0])
    return (flows[0] + flows[1]) / 2.0


def _pressure_gain(valve: Valve, curve: RestCurve) -> dict[str, np.ndarray]:
    load = PRESSURES * curve.supply
    current, _ = curve.holding(blocked_position(curve.c, curve.supply, load), load)
    gain, _ = _line(current, np.broadcast_to(load, current.shape))
    return {"pressure_gain": gain, "pressure_gain_share": gain * _rated(valve)[:, 0] / curve.supply}


def _leakage(valve: Valve, curve: RestCurve) -> dict[str, np.ndarray]:
    load = LOADS * curve.supply
    at = blocked_position(curve.c, curve.supply, load)
    total = curve.holding(at, load)[1] + main_stage(at, curve.supply, load, curve.c)[1]
    peak = _peak(total)
    ends = []
    for sign in (-1.0, 1.0):
        x, pilot = curve.at_current(sign * OUTER * _rated(valve), sign * 0.995 * curve.supply)
        load_pressure = blocked_pressure(curve.c, curve.supply, x)
        ends.append((pilot + main_stage(x, curve.supply, load_pressure, curve.c)[1]).mean(axis=-1))
    return {"null_leakage": peak, "tare_leakage": (ends[0] + ends[1]) / 2.0}


def _peak(y: np.ndarray) -> np.ndarray:
    """Greatest value of each row, by a parabola through three."""
    k = np.clip(np.argmax(y, axis=-1), 1, y.shape[-1] - 2)
    a, b, c = (np.take_along_axis(y, (k + step)[:, None], axis=-1)[:, 0] for step in (-1, 0, 1))
    bend = a - 2.0 * b + c
    return b - np.where(bend < 0.0, (c - a) ** 2 / (8.0 * np.where(bend < 0.0, bend, -1.0)), 0.0)


def _null_shift(valve: Valve, conditions: Mapping[str, float], oil: Oil, *changed: Mapping[str, float]) -> np.ndarray:
    """Shift of null (k,), share of i_R: the greatest of several changes of the conditions."""
    at = _null(rest_curve(valve, conditions, oil))
    shifts = np.stack([_null(rest_curve(valve, {**conditions, **one}, oil)) - at for one in changed])
    greatest = np.argmax(np.abs(shifts), axis=0)
    return np.take_along_axis(shifts, greatest[None], axis=0)[0] / _rated(valve)[:, 0]


def static_figures(valve: Valve, wanted: set[str], conditions: Mapping[str, float], oil: Oil) -> dict[str, np.ndarray]:
    """The wanted static figures of a batch of valves, each (k,) in SI; `conditions` have all that they need.

    Raises as `Valve.at` does.
    """
    found: dict[str, np.ndarray] = {}
    families: tuple[tuple[set[str], Callable[[Valve, RestCurve], dict[str, np.ndarray]]], ...] = (
        ({"flow_gain", "flow_at_rated", "linearity", "symmetry", "lap", "null_bias"}, _flow_lines),
        ({"pressure_gain", "pressure_gain_share"}, _pressure_gain),
        ({"null_leakage", "tare_leakage"}, _leakage),
    )
    if any(wanted & names for names, _ in families):
        curve = rest_curve(valve, conditions, oil)
        for names, family in families:
            if wanted & names:
                found |= family(valve, curve)
    if "rated_flow" in wanted:
        found["rated_flow"] = _rated_flow(valve, conditions, oil)
    supply, warm = conditions["supply_pressure"], conditions["oil_temperature"]
    if "null_shift_temperature" in wanted:
        change = {"oil_temperature": warm + conditions["temperature_difference"]}
        found["null_shift_temperature"] = _null_shift(valve, conditions, oil, change)
    if "null_shift_supply" in wanted:
        share = conditions["pressure_change"]
        changes = ({"supply_pressure": (1.0 - share) * supply}, {"supply_pressure": (1.0 + share) * supply})
        found["null_shift_supply"] = _null_shift(valve, conditions, oil, *changes)
    if "null_shift_return" in wanted:
        change = {"return_pressure": conditions["pressure_change"] * supply}
        found["null_shift_return"] = _null_shift(valve, conditions, oil, change)
    return found
