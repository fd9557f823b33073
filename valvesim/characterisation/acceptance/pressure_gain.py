"""Load pressure over current with blocked ports: pressure gain and null (SAE ARP490, ISO 10770-1)."""

from __future__ import annotations

import warnings

import numpy as np

from valvesim.characterisation.acceptance.cycle import Cycle, loop
from valvesim.characterisation.acceptance.metrics import (
    NULL_SHARE,
    jackknife,
    loop_figures,
    merit,
    root_sum_square,
    slope_of,
    weighted_line,
)
from valvesim.characterisation.acceptance.record import AcceptanceRecord, record_of
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import Absent, FiguresOfMerit
from valvesim.errors import SolveError, ValidityWarning
from valvesim.valve.coefficients import Coefficients
from valvesim.valve.equations import FLOW_FORCE_FACTOR, main_stage
from valvesim.valve.equilibrium import solve_rest


def pressure_gain_figures(c: Cycle, *, rated_current: float | None = None, lag: float | None = None) -> FiguresOfMerit:
    """The figures of the load pressure at blocked ports over a full cycle.

    supply_pressure: the plateau of the load pressure. pressure_gain: slope of the mid-line over +-40 % of it.
    pressure_gain_share: the same as share of supply per share of i_R. null_bias: mid-line at zero load pressure.
    hysteresis: greatest current difference at equal pressure within +-40 %, share of i_R. zero_rising, zero_falling:
    current at zero load pressure. Source: ARP490, ISO 10770-1.
    """
    rated = c.amplitude if rated_current is None else rated_current
    bend = loop(c, bins=1000)
    ends = [float(np.median(np.sort(sign * c.rising[1])[-len(c.rising[1]) // 10 :])) for sign in (1.0, -1.0)]
    supply = (ends[0] + ends[1]) / 2.0
    reading, step = c.current_resolution / np.sqrt(12.0), c.resolution_at(ends[0]) / np.sqrt(12.0)
    inside = np.abs(bend.output) <= NULL_SHARE * supply
    reached = bend.output[0] <= -NULL_SHARE * supply and bend.output[-1] >= NULL_SHARE * supply
    if np.count_nonzero(inside) < 5 or not reached:
        few = f"{np.count_nonzero(inside)} points within +-40 % of supply pressure: sweep more slowly"
        return tuple(
            Absent(name, few if reached else "the load pressure does not pass +-40 % of supply pressure")
            for name in ("pressure_gain", "pressure_gain_share", "null_bias", "hysteresis")
        )
    y = np.linspace(-NULL_SHARE, NULL_SHARE, 41) * supply  # evenly, whatever the sampling
    mid, up, down = (np.interp(y, bend.output, v) for v in (bend.middle, bend.rising, bend.falling))
    slope = weighted_line(mid, y)[0]
    fit = jackknife(slope_of(mid, y), len(y))
    branches = (weighted_line(up, y)[0] - weighted_line(down, y)[0]) / 2.0
    error = root_sum_square(fit, branches, slope * np.sqrt(2.0) * reading / np.ptp(mid))
    zeros = [float(np.interp(0.0, y, v)) for v in (up, down)]
    null = (zeros[0] + zeros[1]) / 2.0
    return (
        merit("supply_pressure", supply, root_sum_square(step, (ends[0] - ends[1]) / 2), "Pa",
              "plateau of the load pressure"),
        merit("pressure_gain", slope, error, "Pa/A", "slope of the mid-line over +-40 % of supply"),
        merit("pressure_gain_share", slope * rated / supply, error * rated / supply, "-",
              "share of supply pressure per share of i_R: % per 1 %"),
        merit("zero_rising", zeros[0], reading, "A", "current at zero load pressure, rising"),
        merit("zero_falling", zeros[1], reading, "A", "the same, falling"),
        merit("null_bias", null / rated, reading / rated, "1", "mid-line at zero load pressure, share of i_R"),
        *loop_figures(c, y, up - down, rated, lag, "within 40 % of supply"),
    )  # fmt: skip


def blocked_load_pressure(spool_position, supply_pressure: float, c: Coefficients) -> np.ndarray:
    """Load pressure (Pa, any shape) at which the main stage passes no load flow at given spool positions (m)."""
    from scipy.optimize.elementwise import find_root

    def flow(p, x):
        return main_stage(x, supply_pressure, p, c)[0]

    x = np.asarray(spool_position, dtype=float)
    ends = (np.full(x.shape, -supply_pressure), np.full(x.shape, supply_pressure))
    return find_root(flow, ends, args=(x,), tolerances={"xatol": 1e-9 * supply_pressure, "xrtol": 0.0}).x


def blocked_cycle(rig: Rig) -> AcceptanceRecord:
    """A full cycle with blocked ports: load pressure and total leakage.

    The run has no load pressure; what the load pressure's flow force then moves the spool by is taken from the static
    solution at the current that holds the same spool position, and the two are brought to agree. Exact without
    friction and hysteresis, where the run is the static solution.
    """
    valve, c = rig.valve, rig.coefficients()
    values = rig.full_cycle(null=rig.null())
    p_s, p_0, x = valve.supply_pressure, valve.return_pressure, values["spool_position"]

    def position(current, force) -> np.ndarray:
        """Where the spool rests at a current (A) and a force (N) on it."""
        with warnings.catch_warnings():  # full load pressure takes the flow force away: the spool goes to its stop
            warnings.simplefilter("ignore", ValidityWarning)
            rest = solve_rest(c, current, rig.oil_temperature, p_s, p_0, 0.0, -force).spool_position
        return np.clip(rest, -c.spool_stroke, c.spool_stroke)

    top = 1.1 * float(np.max(np.abs(values["current"])))
    currents = np.linspace(-top, top, 2001)
    alone = x
    holding = np.interp(x, position(currents, 0.0), currents)  # A, without friction or hysteresis
    start, p_L = position(holding, 0.0), np.zeros(x.shape)
    for _ in range(100):
        before, p_L = (x, p_L), blocked_load_pressure(x, p_s, c)
        x = alone + position(holding, FLOW_FORCE_FACTOR * c.port_width * p_L * np.abs(x)) - start
        x = np.clip(x, -c.spool_stroke, c.spool_stroke)
        if np.max(np.abs(p_L - before[1])) < 1e-7 * p_s and np.max(np.abs(x - before[0])) < 1e-7 * c.spool_stroke:
            break
    else:
        raise SolveError("bench: load pressure and flow force of the blocked ports do not settle; raise null_opening")
    leakage = values["pilot_flow"] + main_stage(x, p_s, p_L, c)[1]
    own = {**values, "load_pressure": p_L, "internal_leakage": leakage, "spool_position": x}
    return record_of("blocked ports", own, "load_pressure", "internal_leakage", "spool_position")
