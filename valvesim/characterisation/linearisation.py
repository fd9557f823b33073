"""The valve linear about a rest: operating point, state space, modes.

Symbols
    x' = A x + B u,  y = C x + D u    x states, u inputs, y outputs as deviations from a rest; A..D exact Jacobians
    lambda pole rad/s, f = |lambda|/(2 pi) natural frequency Hz, zeta = -Re(lambda)/|lambda| damping ratio

Everything is the same equations as `simulate` integrates (`Model.rhs` and `Model.signals`, traced by CasADi), so it
holds wherever they do, for small deviations. A rest at null lies on kinks of the laws: |x_v| in the flow force (where
there is a load pressure), the lesser land flow and the overlap in the leakage. There CasADi's derivative is the mean of
the two sides: zero for |x_v|. Without load pressure A, B and the load flow have no kink.

python-control holds the results; it takes over a second to import and is imported where it is needed."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS, Inputs
from valvesim.errors import InputError, check_kind
from valvesim.solver.codegen import derivatives, trace, trace_signals
from valvesim.units import reads_units
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.equations import NOMINAL, Model
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve

LINEARISED_OUTPUTS = (
    "spool_position", "armature_angle", "load_flow", "pilot_differential_pressure", "nozzle_pressure_1",
    "nozzle_pressure_2", "internal_leakage",
)  # fmt: skip
"""Outputs of the linear and the nonlinear system: rad, m, m^3/s and Pa, as `channels` says."""


@dataclass(frozen=True, kw_only=True)
class OperatingPoint:
    """A valve at rest. `state` (n,) SI in the order of `model.state_channels`, `coefficients` flat, of the model.

    `temperature` is the oil's, °C.
    """

    model: Model
    temperature: float
    state: np.ndarray
    inputs: Inputs
    coefficients: np.ndarray

    @property
    def spool_position(self) -> float:
        """m."""
        return float(_spool_position(self.model, self.state))


@reads_units(current="A", temperature="degC", load_pressure="Pa", supply_pressure="Pa")
def operating_point(
    valve: Valve,
    *,
    current: float,
    temperature: float = 20.0,
    load_pressure: float = 0.0,
    oil: Oil = MIL_PRF_5606,
    parts: PartTemperatures | None = None,
    supply_pressure: float | None = None,
) -> OperatingPoint:
    """Where one valve rests at a current (A), with every part at `temperature` (°C) unless `parts` gives them each.

    `load_pressure` (Pa) and `supply_pressure` (Pa, the valve's own by default) hold here instead of the valve's. The
    rest is that of `static_solution` for a valve at these pressures (the oil's density is taken at them too).
    Raises InputError for arrays, nan, pressures that make no sense, a clearance that closes, and a spool on its end
    stop; SolveError where the flapper has no stable rest.
    """
    pressures = {"load_pressure": load_pressure}
    if supply_pressure is not None:
        pressures["supply_pressure"] = supply_pressure
    for name, value in (("current", current), ("temperature", temperature), *pressures.items()):
        if np.ndim(value) or not np.isfinite(value):
            raise InputError(f"operating point: {name} = {value} must be one finite number")
    valve = replace(valve, **pressures)  # type: ignore[arg-type]
    c = valve.at(PartTemperatures.uniform(temperature) if parts is None else parts, oil=oil)
    if any(np.ndim(value) for value in c):
        raise InputError("operating point: valve or parts hold an array; give one valve at one temperature")
    inputs = Inputs(float(current), 0.0, valve.supply_pressure, valve.return_pressure, valve.load_pressure)
    state = rest_of(NOMINAL, inputs, c)
    position = _spool_position(NOMINAL, state)
    if abs(position) >= c.spool_stroke:
        raise InputError(
            f"operating point: at {current * 1e3:.6g} mA the spool would rest at {position * 1e3:.4g} mm, beyond its "
            f"end stop; it must be within ({-c.spool_stroke * 1e3:.4g}, {c.spool_stroke * 1e3:.4g}) mm"
        )
    flat = np.array(NOMINAL.flat_coefficients(c, ()), dtype=float)
    oil_temperature = float(temperature if parts is None else parts.oil)
    return OperatingPoint(model=NOMINAL, temperature=oil_temperature, state=state, inputs=inputs, coefficients=flat)


def _spool_position(model: Model, state: np.ndarray) -> float:
    return state[[channel.name for channel in model.state_channels].index("spool_position")]


def rest_of(model: Model, inputs: Inputs, c: Coefficients) -> np.ndarray:
    """States at rest, (n,); the memory of effects at zero."""
    return np.array([float(value) for value in model.rest(inputs, c)])


@functools.lru_cache(maxsize=16)
def signal_derivatives(model: Model) -> Any:
    """Exact values and derivatives of the signals: a CasADi function (state, inputs, coefficients) -> four matrices.

    The signals (11, 1) in the order of `SIGNAL_CHANNELS`, then their dense Jacobians (11, states | inputs |
    coefficients), all in SI units. At a kink the derivative is the mean of both sides.
    """
    import casadi

    _, at = trace(model)
    signals = trace_signals(model, at)
    matrices = [signals, *(casadi.densify(casadi.jacobian(signals, symbol)) for symbol in at.values())]
    return casadi.Function("signals", list(at.values()), matrices, list(at), ["signals", *("by_" + n for n in at)])


@functools.lru_cache(maxsize=16)
def refuse_command_rate(model: Model, what: str) -> None:
    """InputError where the equations feel the rate of the command: a linear system has no such input."""
    import casadi

    rates, at = trace(model)
    if casadi.depends_on(rates, at["inputs"][Inputs._fields.index("command_rate")]):
        names = ", ".join(effect.name for effect in model.effects if effect.memory)
        raise InputError(f"{what}: an effect ({names}) depends on the rate of the current; leave it out")


def linearise(point: OperatingPoint) -> Any:
    """The valve for small deviations from a rest: a `control.StateSpace`, SI throughout.

    Inputs (4): current (A; "voltage", V, of a voltage drive), supply_pressure, return_pressure, load_pressure (Pa).
    States: those of `Model.state_channels`. Outputs (7): `LINEARISED_OUTPUTS`. All by name, so that
    `system["load_flow", "current"]` is one transfer function. A to D are exact (no differences); the oil's density and
    bulk modulus at zero pressure are held, as in `simulate`. At a kink (null, see the module's head) the mean of both
    sides is taken. Valid while the deviation stays small against the null gap, and away from the stops.
    Raises InputError where the model depends on the rate of the current, which is no input of the system.
    """
    import control

    check_kind(point, OperatingPoint, "linearise", "an OperatingPoint (operating_point(valve, current=...))")
    model = point.model
    refuse_command_rate(model, "linearise")
    at = (point.state, np.array(point.inputs, dtype=float), point.coefficients)
    by_state, by_inputs, _ = (np.array(matrix) for matrix in derivatives(model)(*at))
    _, signals_by_state, signals_by_inputs, _ = (np.array(matrix) for matrix in signal_derivatives(model)(*at))
    keep = [k for k, name in enumerate(Inputs._fields) if name != "command_rate"]
    states = [channel.name for channel in model.state_channels]
    named = [channel.name for channel in SIGNAL_CHANNELS]
    C = np.array([np.eye(len(states))[states.index(y)] if y in states else signals_by_state[named.index(y)]
                  for y in LINEARISED_OUTPUTS])  # fmt: skip
    D = np.array([np.zeros(len(Inputs._fields)) if y in states else signals_by_inputs[named.index(y)]
                  for y in LINEARISED_OUTPUTS])  # fmt: skip
    return control.ss(
        by_state, by_inputs[:, keep], C, D[:, keep],
        inputs=[model.drive.command_name, *Inputs._fields[2:]], states=states, outputs=list(LINEARISED_OUTPUTS),
        name="valve",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One pole: `pole` rad/s, `natural_frequency` Hz, `damping_ratio` 1 (1 for a stable real pole, nan for zero)."""

    pole: complex
    natural_frequency: float
    damping_ratio: float


def modes(point: OperatingPoint) -> tuple[Mode, ...]:
    """The poles of the valve about a rest, lowest natural frequency first; of a pair the negative frequency first."""
    return tuple(
        Mode(
            pole=complex(pole),
            natural_frequency=float(abs(pole) / (2.0 * np.pi)),
            damping_ratio=float(-pole.real / abs(pole)) if pole else float("nan"),
        )
        for pole in scaled_poles(point)
    )


def scaled_poles(point: OperatingPoint) -> np.ndarray:
    """Eigenvalues in scaled states (SI ones differ by 1e11), by size, then imaginary part."""
    scale = np.array([channel.scale for channel in point.model.state_channels])
    at = (point.state, np.array(point.inputs, dtype=float), point.coefficients)
    A = np.array(derivatives(point.model)(*at)[0])
    poles = np.linalg.eigvals(A * scale / scale[:, None])
    return poles[np.lexsort((poles.imag, np.round(np.abs(poles), 6)))]


def poles_over_temperature(
    valve: Valve, temperatures: Sequence[float], *, current: float = 0.0, load_pressure: float = 0.0,
    oil: Oil = MIL_PRF_5606,
) -> np.ndarray:  # fmt: skip
    """Poles at rest with every part at each temperature (°C): complex (n_T, 6), rad/s.

    A column follows one pole: each row is matched to the one before by least total distance, so temperatures should
    lie close enough (10 K) that poles do not pass each other in between. Raises as `operating_point` does.
    """
    from scipy.optimize import linear_sum_assignment

    rows: list[np.ndarray] = []
    for temperature in temperatures:
        point = operating_point(
            valve, current=current, temperature=temperature, load_pressure=load_pressure, oil=oil
        )  # fmt: skip
        poles = scaled_poles(point)
        if rows:
            poles = poles[linear_sum_assignment(np.abs(rows[-1][:, None] - poles[None, :]))[1]]
        rows.append(poles)
    return np.array(rows).reshape(len(rows), -1)
