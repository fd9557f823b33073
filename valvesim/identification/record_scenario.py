"""The scenario of a measured record: its measured inputs drive the valve, its sample times are the result's.

Straight lines replace a measured oil temperature: least squares on even knots, then its corners (Ramer 1972;
Douglas and Peucker 1973).
"""

from __future__ import annotations

import numpy as np

from valvesim.identification.options import DEFAULT_IDENTIFICATION, IdentificationOptions
from valvesim.identification.session import PART_TEMPERATURES, Record, Session
from valvesim.inputs import Command, Constant, Table
from valvesim.simulation.scenario import Scenario
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.parameters import Valve


def record_scenario(
    session: Session,
    record: Record,
    *,
    valve: Valve | None = None,
    effects: tuple[ActiveEffect, ...] | None = None,
    tolerance: float = 1e-5,
    options: IdentificationOptions = DEFAULT_IDENTIFICATION,
) -> Scenario:
    """The nominal scenario of a record: its measured inputs drive the valve, its sample times are the result's.

    `valve` and `effects` take the place of the session's. Temperatures are smoothed and followed to 0.1 K.
    """
    commands = {name: _input(record, name, options=options) for name in record.inputs}
    parts = {part: commands.pop(column) for column, part in PART_TEMPERATURES.items() if column in commands}
    return Scenario(
        title=f"{session.title}: {record.name}",
        duration=record.duration,
        valve=session.valve if valve is None else valve,
        oil=session.oil,
        thermal=session.thermal,
        drive=session.drive,
        command=commands.pop(record.command),
        effects=session.effects if effects is None else effects,
        output_rate=record.rate,
        tolerance=tolerance,
        part_temperatures=parts,
        **commands,  # type: ignore[arg-type]  # oil temperature and pressures, by the scenario's own names
    )


def _input(record: Record, name: str, *, options: IdentificationOptions) -> Command:
    """A measured input as a command."""
    time, values = record.time, record.values[name]
    if np.ptp(values) == 0.0:
        return Constant(value=float(values[0]))
    if name.endswith("_temperature"):  # each of its points costs a matrix product, and a sensor's noise is no heat
        time, values = _smoothed(time, values, options=options)
        keep = _corners(time, values, options.predictor.oil_resolution)
        time, values = time[keep], values[keep]
    return Table(times=tuple(time.tolist()), values=tuple(values.tolist()), where=f"{record.name}, {name}")


def _smoothed(time: np.ndarray, values: np.ndarray, *, options: IdentificationOptions) -> tuple[np.ndarray, np.ndarray]:
    """(time, values) of as few joined straight lines, by least squares, as leave no more than the noise.

    The noise is that of the second differences: a ramp, however steep, has none. Values whose noise is below the
    resolution come back as they are.
    """
    from scipy.interpolate import make_lsq_spline

    noise = 1.4826 * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)
    if 2.0 * noise < options.predictor.oil_resolution:
        return time, values
    most = max(min(options.predictor.oil_intervals, len(time) // 4), 1)
    for count in (2**k for k in range(most.bit_length())):
        edges = np.linspace(time[0], time[-1], count + 1)
        lines = make_lsq_spline(time, values, np.concatenate([edges[:1], edges, edges[-1:]]), k=1)
        left = float(np.mean((values - lines(time)) ** 2)) - noise**2 * (1.0 - (count + 1) / len(time))
        if left < max((0.5 * options.predictor.oil_resolution) ** 2, 3.0 * noise**2 * np.sqrt(2.0 / len(time))):
            break
    return edges, lines(edges)


def _corners(time: np.ndarray, values: np.ndarray, tolerance: float) -> np.ndarray:
    """Indices of points whose straight lines stay within a tolerance of all (Ramer, Douglas and Peucker)."""
    keep, open_parts = {0, len(time) - 1}, [(0, len(time) - 1)]
    while open_parts:
        a, b = open_parts.pop()
        line = np.interp(time[a : b + 1], time[[a, b]], values[[a, b]])
        off = np.abs(values[a : b + 1] - line)
        k = a + int(np.argmax(off))
        if off[k - a] > tolerance:
            keep.add(k)
            open_parts += [(a, k), (k, b)]
    return np.array(sorted(keep))
