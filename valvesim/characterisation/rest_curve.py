"""Every rest of a valve as a function of the armature's angle, of many valves at once.

At a held angle the chambers' pressures, the spool's position and the current that holds it follow from their balances
without iteration over the current, so that a whole characteristic costs as much as one rest.

Symbols
    theta armature angle, i current, x spool, p_L load pressure; arrays are (k, m): k valves, m nodes

Valid between the nozzles, for a valve with a stable null and without friction or hysteresis.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, RestCurveOptions
from valvesim.errors import ValidityWarning
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.equations import FLOW_FORCE_FACTOR, fixed_orifice_flow, main_stage
from valvesim.valve.equilibrium import balances_at_rest, chamber_pressure, nozzle_pressures
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


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
    options: RestCurveOptions = DEFAULT_CHARACTERISATION.rest_curve

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
        for _ in range(self.options.false_positions):
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


def rest_curve(
    valve: Valve, conditions: Mapping[str, float], oil: Oil, *,
    options: RestCurveOptions = DEFAULT_CHARACTERISATION.rest_curve,
) -> RestCurve:  # fmt: skip
    """The rests of a batch of valves at supply and return pressure and oil temperature, by name in SI."""
    supply, back, temperature = (conditions[n] for n in ("supply_pressure", "return_pressure", "oil_temperature"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)
        own = replace(valve, supply_pressure=supply, return_pressure=back, load_pressure=0.0)
        c = own.at(PartTemperatures.uniform(temperature), oil=oil)
    return rest_curve_of(c, supply, back, options=options)


def rest_curve_of(
    c: Coefficients, supply: float, back: float, *,
    options: RestCurveOptions = DEFAULT_CHARACTERISATION.rest_curve,
) -> RestCurve:  # fmt: skip
    """The rests from coefficients (k,): of a batch of valves, or of one valve at many temperatures of its parts."""
    c, density = columns_of(c), options.density
    nodes = np.sinh(np.linspace(-density, density, options.angles)) / np.sinh(density)
    angle = nodes * 0.98 * np.minimum(c.null_gap_1, c.null_gap_2) / c.nozzle_arm
    return RestCurve(c, supply, back, angle, _chambers(c, supply, back, angle), options)


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


def null_current(curve: RestCurve) -> np.ndarray:
    """Current without flow at no load (k,), A."""
    at = blocked_position(curve.c, curve.supply, np.zeros(1))
    return curve.holding(at, np.zeros(1))[0][:, 0]
