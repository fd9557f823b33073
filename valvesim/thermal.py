"""Temperatures of the parts: a lumped network driven by the prescribed oil temperature.

Symbols
    C heat capacity J/K, G conductance W/K, T temperature °C
    C_k T_k' = G_k,oil (T_oil - T_k) + sum_j G_kj (T_j - T_k) + G_k,amb (T_amb - T_k)

The network is linear and nothing in it hears the valve's motion, so it is solved exactly (matrix exponential, oil
temperature straight between knots) before the valve is. Its figures are estimates, good to about +-50 % (model.md 5,
field.md 2): no measured valve-body transient is public.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .commands import PIECE_WIDTH, WAVE_WIDTH, Command, evaluate
from .fluid import Oil
from .parameters import PART_NAMES, PartTemperatures
from .units import POSITIVE, check_bounds, quantity

NODES = tuple(name for name in PART_NAMES if name != "oil")


def _estimate(value: float, unit: str, doc: str, *, floor: float = 0.0):
    return quantity(value, unit, doc, (floor, 1e5), "estimate, field.md 2", tolerance=0.5)


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

    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """(M, N) of T' = M T + N [T_oil, T_ambient]; T in the order of `NODES`, M in 1/s."""
        sources = ("oil", "ambient")
        M, N = np.zeros((len(NODES), len(NODES))), np.zeros((len(NODES), len(sources)))
        for name in self.__dataclass_fields__:
            one, _, other = name.partition("_to_")
            if not other:
                continue
            conductance = getattr(self, name)
            for here, there in ((one, other), (other, one)):
                if here not in NODES:
                    continue
                k = NODES.index(here)
                gain = conductance / getattr(self, here + "_capacity")
                M[k, k] -= gain
                if there in NODES:
                    M[k, NODES.index(there)] += gain
                else:
                    N[k, sources.index(there)] += gain
        return M, N


@dataclass(frozen=True, kw_only=True)
class TemperaturePath:
    """Temperatures at knots, °C, straight in between; a pair of equal times is a jump."""

    times: np.ndarray
    parts: PartTemperatures


def temperature_path(
    oil_temperature: Command,
    end: float,
    *,
    network: ThermalNetwork | None,
    initial: float | None = None,
    ambient: float = 20.0,
    throttling: Callable | None = None,
    spacing: float = 0.1,
) -> TemperaturePath:
    """Oil and part temperatures from 0 to `end` s.

    `network` None holds every part at the oil's temperature (the paper's assumption). `initial` (°C) is where all parts
    start, by default with the oil. `throttling(T)` is added to the oil temperature, K. Knots are at most `spacing` s
    apart, at every break of the oil temperature and between any two, and 20 or more to each of its periods.
    """
    times, oil = _knots(oil_temperature, end, spacing)
    if throttling is not None:
        oil = oil + throttling(oil)
    if network is None:
        return TemperaturePath(times=times, parts=PartTemperatures.uniform(oil))
    M, N = network.matrices()
    T = np.empty((len(times), len(NODES)))
    T[0] = oil[0] if initial is None else initial
    propagators: dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    for k, step in enumerate(np.diff(times)):
        key = float(f"{step:.9g}")
        if key not in propagators:
            propagators[key] = _propagator(M, N, step)
        E, F, G = propagators[key]
        now = np.array([oil[k], ambient])
        change = np.array([oil[k + 1] - oil[k], 0.0])
        T[k + 1] = E @ T[k] + F @ now + G @ change
    parts = PartTemperatures(oil=oil, **{name: T[:, k] for k, name in enumerate(NODES)})
    return TemperaturePath(times=times, parts=parts)


def _propagator(M: np.ndarray, N: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T(step) = E T(0) + F u(0) + G (u(step) - u(0)) for u straight in between: exact, by one matrix exponential."""
    from scipy.linalg import expm  # 0.2 s to import, which an isothermal run need not wait for

    n, m = N.shape
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n], block[:n, n : n + m] = M * step, N * step
    block[n : n + m, n + m :] = np.eye(m)
    big = expm(block)
    return big[:n, :n], big[:n, n : n + m], big[:n, n + m :]


def _knots(command: Command, end: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """(times, values) of a command within `spacing`, with both values at each of its breaks."""
    rows = command.pieces(end)
    starts = rows[:, 0]
    edges = np.unique(np.concatenate([[0.0, end], starts[(starts > 0.0) & (starts < end)]]))
    times, late = [], []  # late: times at which the value is taken
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        fine = spacing
        if rows.shape[1] > PIECE_WIDTH:
            row = rows[max(int(np.searchsorted(starts, a, side="right")) - 1, 0)]
            fine = min(spacing, 0.05 / max(_fastest(row, a), _fastest(row, b), 1e-9))
        t = np.linspace(a, b, max(int(np.ceil((b - a) / fine)), 2) + 1)
        times.append(t)
        late.append(np.append(t[:-1], np.nextafter(b, a) if b < end else b))  # the value just before a jump at b
    return np.concatenate(times), evaluate(command, np.concatenate(late))


def _fastest(row: np.ndarray, t: float) -> float:
    """Highest frequency of the waves of a piece at time t, Hz."""
    amplitude, frequency, sweep, growth, _ = row[PIECE_WIDTH:].reshape(-1, WAVE_WIDTH).T
    now = np.abs(frequency * np.exp(growth * (t - row[0])) + sweep * (t - row[0]))
    return float(np.max(now, initial=0.0, where=amplitude != 0.0))


def throttling_rise(oil: Oil, pressure_drop: float) -> Callable:
    """Mean rise of the oil in the pilot stage, K: half of what the whole drop gives, as a function of °C."""
    return lambda temperature: 0.5 * oil.throttling_rise(temperature, pressure_drop)
