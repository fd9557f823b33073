"""Static figures of many valves at once, from every rest of each (`characterisation.rest_curve`).

Symbols
    i current, x spool, p_L load pressure, i_R rated current; arrays are (k, m): k valves, m nodes

Figures are defined as on a bench (`characterisation.acceptance`), of a valve without hysteresis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from valvesim.characterisation.acceptance.flow import LINE
from valvesim.characterisation.acceptance.metrics import NULL_SHARE
from valvesim.characterisation.rest_curve import (
    RestCurve,
    blocked_position,
    blocked_pressure,
    null_current,
    rest_curve,
    spool_at,
)
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, StaticOptions
from valvesim.valve.equations import main_stage
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


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


def _flow_lines(valve: Valve, curve: RestCurve, options: StaticOptions) -> dict[str, np.ndarray]:
    rated, null = _rated(valve), null_current(curve)[:, None]
    lines, normals, deviations = [], [], []
    currents = np.linspace(*LINE, options.line_points) * rated
    for sign in (-1.0, 1.0):
        i = sign * currents
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


def _pressure_gain(valve: Valve, curve: RestCurve, options: StaticOptions) -> dict[str, np.ndarray]:
    load = np.linspace(-NULL_SHARE, NULL_SHARE, options.pressure_points) * curve.supply
    current, _ = curve.holding(blocked_position(curve.c, curve.supply, load), load)
    gain, _ = _line(current, np.broadcast_to(load, current.shape))
    return {"pressure_gain": gain, "pressure_gain_share": gain * _rated(valve)[:, 0] / curve.supply}


def _leakage(valve: Valve, curve: RestCurve, options: StaticOptions) -> dict[str, np.ndarray]:
    load = np.linspace(-1.0, 1.0, options.leakage_points) * options.leakage_reach * curve.supply
    at = blocked_position(curve.c, curve.supply, load)
    total = curve.holding(at, load)[1] + main_stage(at, curve.supply, load, curve.c)[1]
    peak = _peak(total)
    outer = np.linspace(options.tare_from, 1.0, options.tare_points)
    ends = []
    for sign in (-1.0, 1.0):
        x, pilot = curve.at_current(sign * outer * _rated(valve), sign * 0.995 * curve.supply)
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
    at = null_current(rest_curve(valve, conditions, oil))
    shifts = np.stack([null_current(rest_curve(valve, {**conditions, **one}, oil)) - at for one in changed])
    greatest = np.argmax(np.abs(shifts), axis=0)
    return np.take_along_axis(shifts, greatest[None], axis=0)[0] / _rated(valve)[:, 0]


def static_figures(
    valve: Valve, wanted: set[str], conditions: Mapping[str, float], oil: Oil, *,
    options: StaticOptions = DEFAULT_FROM_FIGURES.static,
) -> dict[str, np.ndarray]:  # fmt: skip
    """The wanted static figures of a batch of valves, each (k,) in SI; `conditions` have all that they need.

    Raises as `Valve.at` does.
    """
    found: dict[str, np.ndarray] = {}
    families: tuple[tuple[set[str], Callable[[Valve, RestCurve, StaticOptions], dict[str, np.ndarray]]], ...] = (
        ({"flow_gain", "flow_at_rated", "linearity", "symmetry", "lap", "null_bias"}, _flow_lines),
        ({"pressure_gain", "pressure_gain_share"}, _pressure_gain),
        ({"null_leakage", "tare_leakage"}, _leakage),
    )
    if any(wanted & names for names, _ in families):
        curve = rest_curve(valve, conditions, oil)
        for names, family in families:
            if wanted & names:
                found |= family(valve, curve, options)
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
