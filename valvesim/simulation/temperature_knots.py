"""The knots of a run in time: where its temperatures are told so that straight lines between them hold all else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.simulation.scenario import Scenario
from valvesim.units import quantities
from valvesim.valve.coefficients import PART_NAMES, Coefficients, PartTemperatures
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import TemperaturePath, first_knots

KNOT_ERROR = 1e-6  # relative error of the coefficients between the knots of the temperature path
MOST_KNOTS = 500_000  # of a run: some 2 kB each
MOST_HALVINGS = 16  # of the time between two knots


def temperature_knots(
    scenario: Scenario, *, knot_times: np.ndarray | None = None, first: np.ndarray | None = None
) -> tuple[TemperaturePath, Coefficients]:
    """The temperature path on knots close enough that straight lines between them hold the coefficients.

    `knot_times` (m,) are taken as they are, where it is known that they will do. The search begins at the knots `first`
    (m,), those of much the same scenario with the same jumps, say.
    """
    valve = scenario.valve
    batch: Any = {name: np.asarray(getattr(valve, name))[:, None] for name in array_quantities(scenario.valve)}
    valve = replace(valve, **batch)
    if knot_times is not None:
        path = scenario.temperatures(knots=knot_times)
        return _at_knots(path, np.arange(len(knot_times)), scenario, valve)
    commands = (scenario.oil_temperature, *scenario.part_temperatures.values())
    knots = first_knots(commands, scenario.duration, min(0.5, scenario.duration / 16.0)) if first is None else first
    halved, largest = np.ones(len(knots) - 1, dtype=bool), None  # which steps are halves of one that bends
    for _ in range(MOST_HALVINGS):
        apart = np.flatnonzero((np.diff(knots) > 0.0) & halved)
        middles = (knots[apart] + knots[apart + 1]) / 2.0
        tried = np.insert(knots, apart + 1, middles)
        path = scenario.temperatures(knots=tried)
        if all(np.ptp(getattr(path.parts, name)) <= 1e-12 for name in PART_NAMES):
            return _at_knots(path, [0], scenario, valve)
        at = apart + 1 + np.arange(len(apart))  # where `tried` holds the middles
        about = np.unique(np.concatenate([at - 1, at, at + 1]))
        c = valve.at(_parts_at(path, about), oil=scenario.oil, routes=scenario.thermal.routes)
        largest = [np.max(np.abs(values)) for values in c] if largest is None else largest
        bend = _bend(c, np.searchsorted(about, at), largest)
        bent = bend > KNOT_ERROR
        if not bent.any():
            break
        _check_number(len(knots), bend)
        knots = np.insert(knots, apart[bent] + 1, middles[bent])
        halved = np.insert(np.isin(np.arange(len(halved)), apart[bent]), apart[bent], True)
    return _at_knots(path, np.delete(np.arange(len(tried)), at[~bent]), scenario, valve)


def _check_number(count: int, bend: np.ndarray) -> None:
    """InputError where more than `MOST_KNOTS` will be needed: each halving takes a bend to a quarter."""
    halvings = np.ceil(np.log(np.maximum(bend / KNOT_ERROR, 1.0)) / np.log(4.0))
    needed = count + float(np.sum(2.0 ** np.minimum(halvings, MOST_HALVINGS) - 1.0))
    if needed > MOST_KNOTS:
        problem = f"changes so often or so far that {needed:.2g} knots would be needed, more than {MOST_KNOTS}"
        raise InputError(f"{problem}; shorten the run or smooth the course", key="thermal.oil_temperature")


def _at_knots(
    path: TemperaturePath, keep: np.ndarray | list[int], scenario: Scenario, valve: Valve
) -> tuple[TemperaturePath, Coefficients]:
    """The path at some of its knots, and the coefficients there."""
    parts = _parts_at(path, keep)
    c = valve.at(parts, oil=scenario.oil, routes=scenario.thermal.routes)
    return TemperaturePath(times=path.times[keep], parts=parts), c


def _parts_at(path: TemperaturePath, keep: np.ndarray | list[int]) -> PartTemperatures:
    """The temperatures at some of the knots of a path."""
    return PartTemperatures(**{name: np.asarray(getattr(path.parts, name))[keep] for name in PART_NAMES})


def _bend(c: Coefficients, at: np.ndarray, largest: Sequence[float]) -> np.ndarray:
    """Error of the coefficients at the knots `at` on a line between their neighbours, of the `largest` value of each:
    the worst of all.
    """
    worst = np.zeros(len(at))
    for values, most in zip(c, largest, strict=True):
        v = np.asarray(values, dtype=float)
        if v.ndim and v.shape[-1] > 1:
            bend = np.abs(v[..., at] - (v[..., at - 1] + v[..., at + 1]) / 2.0) / max(float(most), 1e-300)
            worst = np.maximum(worst, bend.reshape(-1, len(at)).max(axis=0))
    return worst


def array_quantities(valve: Valve) -> list[str]:
    """The quantities of a valve that are arrays, one value for each valve of a batch."""
    return [name for name in quantities(valve) if np.ndim(getattr(valve, name))]


def between(times: np.ndarray, at: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Straight lines between knots for columns (m, n_columns), as (n_columns, n_t); after a jump the later value."""
    if len(at) == 1:
        return np.repeat(columns.T, len(times), axis=1)
    k, share = brackets(times, at)
    return np.array([linear_interpolation(column, k, share) for column in columns.T])


def linear_interpolation(column: np.ndarray, k: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Values (n_t, ...) of a column (m, ...) at a share of the way from knot k to the next, see `brackets`."""
    return column.take(k, 0) + share * np.diff(column, axis=0).take(k, 0)


def brackets(times: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each time the knot (n_t,) that it follows, of two or more, and the share (n_t,) of the way to the next."""
    k = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    width = at[k + 1] - at[k]
    share = np.clip(np.divide(times - at[k], width, out=np.ones_like(times), where=width > 0.0), 0.0, 1.0)
    return k, share
