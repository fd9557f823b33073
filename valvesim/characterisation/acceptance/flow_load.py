"""Flow over valve pressure drop at a held current: exponent and rated flow (SAE ARP490, ISO 10770-1).

Symbols
    p_v valve pressure drop, p_s supply pressure, p_L load pressure Pa"""

from __future__ import annotations

import numpy as np

from valvesim.characterisation.acceptance.cycle import level_spacing
from valvesim.characterisation.acceptance.metrics import jackknife, merit, root_sum_square
from valvesim.characterisation.acceptance.record import AcceptanceRecord, record_of
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.inputs import Constant, Table

RATED_DROP = 7e6  # Pa, valve pressure drop at which flow is rated (1000 psi)


def flow_load_figures(record: AcceptanceRecord, *, resolution: float | None = None) -> FiguresOfMerit:
    """The figures of flow over valve pressure drop at full current.

    flow_exponent: n of Q ~ p_v^n over the record (0.5 for turbulent orifices). rated_flow: flow at 70 bar valve drop by
    that law; absent where the record does not span it. Each level of a quantised flow counts with the mean of its
    pressures. Source: ARP490, ISO 10770-1.
    """
    p, q = record.channel("pressure_drop"), np.abs(record.channel("load_flow"))
    good = p > 0.0
    edges = np.linspace(np.min(q), np.max(q) * (1 + 1e-9), 201)
    place = np.digitize(q[good], edges)
    count = np.bincount(place)
    kept = count > 0
    pressure, flow = (np.bincount(place, v[good])[kept] / count[kept] for v in (p, q))
    if len(flow) > 12:  # the first and last level are cut short
        pressure, flow = pressure[1:-1], flow[1:-1]
    if len(flow) < 5 or np.max(pressure) < 2.0 * np.min(pressure):
        reason = "the pressure drop spans less than a factor of two"
        return (Absent("flow_exponent", reason), Absent("rated_flow", reason))
    x, z = np.log(pressure / RATED_DROP), np.log(flow)
    n, at = np.polyfit(x, z, 1)
    step = level_spacing(q, float(np.median(q))) if resolution is None else resolution
    error = jackknife(lambda keep: float(np.polyfit(x[keep], z[keep], 1)[0]), len(x))
    rated: FigureOfMerit | Absent = Absent("rated_flow", "70 bar valve drop is outside the record")
    if np.min(p) <= RATED_DROP <= np.max(p):
        near = np.abs(x) < 0.25 if np.count_nonzero(np.abs(x) < 0.25) >= 4 else np.full(x.shape, True)
        x, z = x[near], z[near]
        at = np.polyfit(x, z, 2 if len(x) >= 20 else 1)[-1]
        level = jackknife(lambda keep: float(np.exp(np.polyfit(x[keep], z[keep], 1)[1])), len(x))
        error_at = root_sum_square(level, step / np.sqrt(12.0))
        rated = merit("rated_flow", float(np.exp(at)), error_at, "m^3/s", "flow at full current, 70 bar valve drop")
    return (merit("flow_exponent", float(n), error, "-", "n of Q ~ p^n"), rated)


def flow_load_record(rig: Rig, current: float) -> AcceptanceRecord:
    """Load flow at a held current while the load pressure runs slowly from one supply pressure to the other."""
    p_s = float(rig.valve.supply_pressure)
    against = -np.sign(current) * p_s  # the first; the flow force is then greatest and the spool inside its stops
    load = Table(times=(0.0, rig.period), values=(against, -against))
    values = rig.run(Constant(value=current), rig.period, load_pressure=load)
    values["pressure_drop"] = p_s - np.sign(current) * values["load_pressure"]
    return record_of(f"{current * 1e3:.4g} mA", values, "load_pressure", "load_flow", "pressure_drop")
