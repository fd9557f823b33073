"""Temperatures of the parts: a lumped network driven by the prescribed oil temperature.

Symbols
    C heat capacity J/K, G conductance W/K, T temperature °C
    C_k T_k' = G_k,oil (T_oil - T_k) + sum_j G_kj (T_j - T_k) + G_k,amb (T_amb - T_k)

The network is linear and nothing in it hears the valve's motion, so it is solved exactly (in its modes, oil temperature
straight between knots) before the valve is. A part whose temperature is prescribed, as measured say, is a
source to the others as the oil is. Its figures are estimates, good to about +-50 %: no measured
transient of a valve body is public.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.inputs import PIECE_WIDTH, WAVE_WIDTH, Command, evaluate
from valvesim.units import POSITIVE, check_bounds, quantity
from valvesim.valve.fluid import Oil
from valvesim.valve.laws import linear_recursion
from valvesim.valve.parameters import PART_NAMES, PartTemperatures

MOST_PATH_KNOTS = 1_000_000  # of a temperature path: 0.4 GB of coefficients
THERMAL_NODES = tuple(name for name in PART_NAMES if name != "oil")
SOURCES = ("oil", "ambient")


def _estimate(value: float, unit: str, doc: str, *, floor: float = 0.0):
    return quantity(value, unit, doc, (floor, 1e5), "estimate", tolerance=0.5)


def _capacity(value: float, doc: str):
    return _estimate(value, "J/K", "heat capacity of the " + doc, floor=POSITIVE)


@dataclass(frozen=True, kw_only=True)
class ThermalNetwork:
    """Capacities and conductances. Alone against the oil the parts take 1 s (pilot metal), 4 s (spool), 38 s (body)."""

    pilot_metal_capacity: float = _capacity(0.4, "nozzles, orifices and flapper")
    spool_capacity: float = _capacity(2.0, "spool")
    sleeve_capacity: float = _capacity(12.0, "sleeve")
    body_capacity: float = _capacity(150.0, "body")
    torque_motor_capacity: float = _capacity(33.0, "torque motor")
    spring_tube_capacity: float = _capacity(0.3, "spring tube")
    feedback_rod_capacity: float = _capacity(0.25, "feedback rod")
    oil_to_pilot_metal: float = _estimate(0.4, "W/K", "jets on nozzles and flapper")
    oil_to_spool: float = _estimate(0.5, "W/K", "oil to spool")
    oil_to_sleeve: float = _estimate(1.2, "W/K", "oil to sleeve")
    oil_to_body: float = _estimate(4.0, "W/K", "oil to body")
    oil_to_spring_tube: float = _estimate(0.1, "W/K", "wet inside of the spring tube")
    oil_to_feedback_rod: float = _estimate(0.25, "W/K", "oil to feedback rod")
    sleeve_to_body: float = _estimate(8.0, "W/K", "sleeve in its bore")
    body_to_torque_motor: float = _estimate(1.5, "W/K", "screws and face")
    spring_tube_to_torque_motor: float = _estimate(0.02, "W/K", "dry outside and flange of the spring tube")
    torque_motor_to_ambient: float = _estimate(0.03, "W/K", "torque motor to the air")
    body_to_ambient: float = _estimate(0.1, "W/K", "body to the air")

    def __post_init__(self):
        check_bounds(self)

    def matrices(self, prescribed: Sequence[str] = ()) -> tuple[np.ndarray, np.ndarray]:
        """(M, N) of T' = M T + N [prescribed parts, T_oil, T_ambient]; T of the other `THERMAL_NODES`, M in 1/s."""
        free = [name for name in THERMAL_NODES if name not in prescribed]
        every = (*free, *prescribed, *SOURCES)
        gains = np.zeros((len(free), len(every)))
        for here, there, gain in self.exchanges():
            if here in free:
                k = free.index(here)
                gains[k, k] -= gain
                gains[k, every.index(there)] += gain
        return gains[:, : len(free)], gains[:, len(free) :]

    def exchanges(self) -> list[tuple[str, str, Any]]:
        """(part, the other part or source, G/C in 1/s) of every conductance, once from each end that has a capacity."""
        ends = [(name, *name.split("_to_")) for name in self.__dataclass_fields__ if "_to_" in name]
        return [
            (here, there, getattr(self, name) / getattr(self, here + "_capacity"))
            for name, one, other in ends
            for here, there in ((one, other), (other, one))
            if here in THERMAL_NODES
        ]

    def rates(self, temperatures: Mapping[str, Any]) -> dict[str, Any]:
        """T' of every part, K/s, from the temperatures (°C) of `THERMAL_NODES` and `SOURCES`: numbers, arrays or
        symbols.
        """
        rates = dict.fromkeys(THERMAL_NODES, 0.0)
        for here, there, gain in self.exchanges():
            rates[here] = rates[here] + gain * (temperatures[there] - temperatures[here])
        return rates


def ends_of(name: str) -> tuple[str, ...]:
    """What a figure of the network is about, in words: its part, or both ends of its heat path."""
    return tuple(end.replace("_", " ") for end in name.removesuffix("_capacity").split("_to_"))


def heat_words(name: str) -> str:
    """A figure of the network in words of heat transfer: `oil_to_spool` as "heat transfer from oil to spool"."""
    ends = ends_of(name)
    return f"heat transfer from {' to '.join(ends)}" if len(ends) > 1 else f"heat capacity of the {ends[0]}"


@dataclass(frozen=True, kw_only=True)
class TemperaturePath:
    """Temperatures at knots, °C, straight in between; a pair of equal times is a jump."""

    times: np.ndarray
    parts: PartTemperatures


def temperature_path(
    oil_temperature: Command,
    end: float,
    *,
    network: ThermalNetwork | Sequence[ThermalNetwork] | None,
    initial: float | Mapping[str, float] | None = None,
    ambient: float = 20.0,
    throttling: Callable | None = None,
    spacing: float = 0.1,
    knots: np.ndarray | None = None,
    prescribed: Mapping[str, Command] = MappingProxyType({}),
) -> TemperaturePath:
    """Oil and part temperatures from 0 to `end` s.

    `network` None holds every part at the oil's temperature (the paper's assumption); the parts of several networks are
    (networks, m). `initial` (°C) is where the parts start, see `starting_temperatures`. `throttling(T)` is added to the
    oil temperature, K. Parts that are `prescribed` have these temperatures, °C, and the others follow them. The times
    (m,) are `knots`, or those of `first_knots` at this `spacing`.
    """
    times = first_knots((oil_temperature, *prescribed.values()), end, spacing) if knots is None else knots
    oil = _before_jumps(oil_temperature, times)
    if throttling is not None:
        oil = oil + throttling(oil)
    held = {name: _before_jumps(command, times) for name, command in prescribed.items()}
    if network is None:
        return TemperaturePath(times=times, parts=replace(PartTemperatures.uniform(oil), **held))
    networks = [network] if isinstance(network, ThermalNetwork) else network
    start = starting_temperatures(initial, float(oil[0]))
    free = [name for name in THERMAL_NODES if name not in held]
    sources = np.column_stack([*held.values(), oil, np.full(len(times), ambient)])
    first = np.array([getattr(start, name) for name in free])
    M, N = (np.array(each) for each in zip(*(one.matrices(tuple(held)) for one in networks), strict=True))
    capacities = np.array([[getattr(one, f"{name}_capacity") for name in free] for one in networks])
    T = _followed(M, N, capacities, times, sources, first)
    if isinstance(network, ThermalNetwork):
        T = T[0]
    parts = PartTemperatures(oil=oil, **{name: T[..., k] for k, name in enumerate(free)}, **held)
    return TemperaturePath(times=times, parts=parts)


def _followed(
    M: np.ndarray, N: np.ndarray, capacities: np.ndarray, times: np.ndarray, sources: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """T (..., m, n) of T' = M T + N u from its `first` (n,), for `sources` u (m, s) straight between the times (m,); of
    one network or of several (..., n, n) with the heat capacities (..., n).

    In the modes of M, which are real, for G is symmetric: with R = sqrt(C), R M R^-1 is symmetric.
    """
    root = np.sqrt(capacities)
    rates, Q = np.linalg.eigh(M * (root[..., :, None] / root[..., None, :]))
    inverse = np.swapaxes(Q, -1, -2) * root[..., None, :]
    h, driven = np.diff(times)[:, None], inverse @ N
    z = rates[..., None, :] * h
    y = linear_recursion(
        np.exp(z),
        h * _mean_of_exponential(z) * np.einsum("...ij,kj->...ki", driven, sources[:-1])
        + h * _mean_of_ramp(z) * np.einsum("...ij,kj->...ki", driven, np.diff(sources, axis=0)),
        inverse @ first,
    )
    T = np.empty((*M.shape[:-2], len(times), len(first)))
    T[..., 0, :] = first
    T[..., 1:, :] = np.einsum("...ij,...kj->...ki", Q / root[..., :, None], y)
    return T


def _mean_of_exponential(z: np.ndarray) -> np.ndarray:
    """(e^z - 1)/z, the mean of e^(z s) over s from 0 to 1."""
    return np.divide(np.expm1(z), z, out=np.ones_like(z), where=z != 0.0)


def _mean_of_ramp(z: np.ndarray) -> np.ndarray:
    """(e^z - 1 - z)/z^2, the mean of s e^(z (1 - s)) over s from 0 to 1: by its series where that cancels."""
    far, near, series = np.abs(z) > 0.5, np.clip(z, -0.5, 0.5), np.zeros_like(z)
    for k in range(17, 1, -1):  # 0.5^16/18! is below rounding
        series = (series * near + 1.0) / k
    return np.divide(np.expm1(z) - z, z**2, out=series, where=far)


def starting_temperatures(initial: float | Mapping[str, float] | None, oil: float) -> PartTemperatures:
    """The parts at the start, °C: all at `initial`, or by part; those left out (all of them with None) with the oil."""
    same = oil if initial is None else initial
    given = same if isinstance(same, Mapping) else dict.fromkeys(THERMAL_NODES, same)
    return PartTemperatures(oil=oil, **{name: float(given.get(name, oil)) for name in THERMAL_NODES})


def first_knots(commands: Sequence[Command], end: float, spacing: float) -> np.ndarray:
    """Times at most `spacing` s apart, two at every break of the commands, one or more between any two, 20 or more to
    each of their periods. InputError where that makes more than `MOST_PATH_KNOTS`.
    """
    every = [command.pieces(end) for command in commands]
    starts = np.concatenate([rows[:, 0] for rows in every])
    edges = np.unique(np.concatenate([[0.0, end], starts[(starts > 0.0) & (starts < end)]]))
    spacings = np.full(len(edges) - 1, spacing)
    for rows in every:
        if rows.shape[1] > PIECE_WIDTH:
            ruling = np.maximum(np.searchsorted(rows[:, 0], edges[:-1], side="right") - 1, 0)
            fastest = [
                max(_fastest(rows[k], a), _fastest(rows[k], b))
                for k, a, b in zip(ruling, edges[:-1], edges[1:], strict=True)
            ]
            spacings = np.minimum(spacings, 0.05 / np.maximum(fastest, 1e-9))
    counts = np.maximum(np.ceil(np.diff(edges) / spacings), 2.0)
    if counts.sum() > MOST_PATH_KNOTS:
        raise InputError(
            f"oil_temperature: {counts.sum():.3g} knots over {end:g} s are more than {MOST_PATH_KNOTS:g}; fewer "
            "breaks, a lower frequency or a shorter duration will do"
        )
    return np.concatenate(
        [np.linspace(a, b, int(n) + 1) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)]
    )


def _before_jumps(command: Command, times: np.ndarray) -> np.ndarray:
    """Values at knots; at the first of a pair of equal times the value just before it."""
    first = np.append(times[:-1] == times[1:], False)
    return evaluate(command, np.where(first, np.nextafter(times, -np.inf), times))


def _fastest(row: np.ndarray, t: float) -> float:
    """Highest frequency of the waves of a piece at time t, Hz."""
    amplitude, frequency, sweep, growth, _ = row[PIECE_WIDTH:].reshape(-1, WAVE_WIDTH).T
    now = np.abs(frequency * np.exp(growth * (t - row[0])) + sweep * (t - row[0]))
    return float(np.max(now, initial=0.0, where=amplitude != 0.0))


def throttling_rise(oil: Oil, pressure_drop: float) -> Callable:
    """Mean rise of the oil in the pilot stage, K: half of what the whole drop gives, as a function of °C."""
    return lambda temperature: 0.5 * oil.throttling_rise(temperature, pressure_drop)
