"""The valve as control engineers want it: linear about a rest, as a table over temperature, or as a block of a loop.

Symbols
    x' = A x + B u,  y = C x + D u    x states, u inputs, y outputs as deviations from a rest; A..D exact Jacobians
    lambda pole rad/s, f = |lambda|/(2 pi) natural frequency Hz, zeta = -Re(lambda)/|lambda| damping ratio
    H(s) spool position over current, K = H(0)
    K/(s^2/w^2 + 2 z s/w + 1)                    reduced form of order 2
    K/((1 + s/a) (s^2/w^2 + 2 z s/w + 1))        reduced form of order 3
    K_q = dQ_L/di flow gain, K_c = -dQ_L/dp_L flow-pressure coefficient, K_p = K_q/K_c pressure gain at closed ports

Everything is the same equations as `simulate` integrates (`Model.rhs` and `Model.signals`, traced by CasADi), so it
holds wherever they do, for small deviations. A rest at null lies on kinks of the laws: |x_v| in the flow force (where
there is a load pressure), the lesser land flow and the overlap in the leakage. There CasADi's derivative is the mean of
the two sides: zero for |x_v|. Without load pressure A, B and the load flow have no kink.

python-control holds the results; it takes over a second to import and is imported where it is needed.
"""

from __future__ import annotations

import functools
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .channels import SIGNAL_CHANNELS, Inputs
from .commands import Command, Constant, evaluate
from .compiled import compile_model, derivatives, trace
from .errors import InputError, SolveError, unknown_name
from .fluid import MIL_PRF_5606, Oil
from .model import NOMINAL, CurrentDrive, Model
from .parameters import Coefficients, PartTemperatures, Valve
from .scenario import Scenario
from .simulate import temperature_knots
from .static import solve_rest

OUTPUTS = (
    "spool_position", "armature_angle", "load_flow", "load_differential_pressure", "nozzle_pressure_1",
    "nozzle_pressure_2", "internal_leakage",
)  # fmt: skip
"""Outputs of the linear and the nonlinear system: rad, m, m^3/s and Pa, as `channels` says."""

LOWEST, HIGHEST = 0.1, 1e4  # Hz, between which bandwidths are looked for
FIT_POINTS = 200  # of a reduced form, even in log frequency
FIT_DECADES = 2.0  # below the upper end of the fit


# ---------------------------------------------------------------- rest and linear system


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
        return float(self.state[4])


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
    state = _rest(NOMINAL, inputs, c)
    if abs(state[4]) >= c.spool_stroke:
        raise InputError(
            f"operating point: at {current * 1e3:.6g} mA the spool would rest at {state[4] * 1e3:.4g} mm, beyond its "
            f"end stop; it must be within ({-c.spool_stroke * 1e3:.4g}, {c.spool_stroke * 1e3:.4g}) mm"
        )
    flat = np.array(NOMINAL.flat_coefficients(c, ()), dtype=float)
    oil_temperature = float(temperature if parts is None else parts.oil)
    return OperatingPoint(model=NOMINAL, temperature=oil_temperature, state=state, inputs=inputs, coefficients=flat)


def _rest(model: Model, inputs: Inputs, c: Coefficients) -> np.ndarray:
    """States at rest, (n,); the memory of effects at zero."""
    drive = model.drive.rest(inputs.command, c)
    current = drive[0] if drive else inputs.command
    rest = solve_rest(c, current, 0.0, inputs.supply_pressure, inputs.return_pressure, inputs.load_pressure)
    pressures = (rest.nozzle_pressure_1, rest.nozzle_pressure_2)
    valve = (rest.armature_angle, 0.0, *pressures, rest.spool_position, 0.0, *drive)
    state = np.zeros(len(model.state_channels))
    state[: len(valve)] = [float(value) for value in valve]
    return state


@functools.lru_cache(maxsize=16)
def signal_derivatives(model: Model) -> Any:
    """Exact values and derivatives of the signals: a CasADi function (state, inputs, coefficients) -> four matrices.

    The signals (11, 1) in the order of `SIGNAL_CHANNELS`, then their dense Jacobians (11, states | inputs |
    coefficients), all in SI units. At a kink the derivative is the mean of both sides.
    """
    import casadi

    _, at = trace(model)
    signals = _trace_signals(model, at)
    matrices = [signals, *(casadi.densify(casadi.jacobian(signals, symbol)) for symbol in at.values())]
    return casadi.Function("signals", list(at.values()), matrices, list(at), ["signals", *("by_" + n for n in at)])


def _trace_signals(model: Model, at: dict[str, Any]) -> Any:
    """The signals as a column of CasADi expressions in the symbols of `trace`."""
    import casadi

    arguments = [tuple(symbol[k] for k in range(symbol.shape[0])) for symbol in at.values()]
    join: Any = casadi.vertcat
    return casadi.densify(join(*model.signals(*arguments)))


@functools.lru_cache(maxsize=16)
def _refuse_rate(model: Model, what: str) -> None:
    """InputError where the equations feel the rate of the command: a linear system has no such input."""
    import casadi

    rates, at = trace(model)
    if casadi.depends_on(rates, at["inputs"][Inputs._fields.index("command_rate")]):
        names = ", ".join(effect.name for effect in model.effects if effect.memory)
        raise InputError(f"{what}: an effect ({names}) depends on the rate of the current; leave it out")


def linearise(point: OperatingPoint) -> Any:
    """The valve for small deviations from a rest: a `control.StateSpace`, SI throughout.

    Inputs (4): current (A; "voltage", V, of a voltage drive), supply_pressure, return_pressure, load_pressure (Pa).
    States: those of `Model.state_channels`. Outputs (7): `OUTPUTS`. All by name, so that `system["load_flow",
    "current"]` is one transfer function. A to D are exact (no differences); the oil's density and bulk modulus at zero
    pressure are held, as in `simulate`. At a kink (null, see the module's head) the mean of both sides is taken.
    Valid while the deviation stays small against the null gap, and away from the stops.
    Raises InputError where the model depends on the rate of the current, which is no input of the system.
    """
    import control

    model = point.model
    _refuse_rate(model, "linearise")
    at = (point.state, np.array(point.inputs, dtype=float), point.coefficients)
    by_state, by_inputs, _ = (np.array(matrix) for matrix in derivatives(model)(*at))
    _, signals_by_state, signals_by_inputs, _ = (np.array(matrix) for matrix in signal_derivatives(model)(*at))
    keep = [k for k, name in enumerate(Inputs._fields) if name != "command_rate"]
    states = [channel.name for channel in model.state_channels]
    named = [channel.name for channel in SIGNAL_CHANNELS]
    C = np.array([np.eye(len(states))[states.index(y)] if y in states else signals_by_state[named.index(y)]
                  for y in OUTPUTS])  # fmt: skip
    D = np.array([np.zeros(len(Inputs._fields)) if y in states else signals_by_inputs[named.index(y)]
                  for y in OUTPUTS])  # fmt: skip
    return control.ss(
        by_state, by_inputs[:, keep], C, D[:, keep],
        inputs=[_command_name(model), *Inputs._fields[2:]], states=states, outputs=list(OUTPUTS), name="valve",
    )  # fmt: skip


def _command_name(model: Model) -> str:
    return "current" if isinstance(model.drive, CurrentDrive) else "voltage"


# ---------------------------------------------------------------- poles


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
        for pole in _poles(point)
    )


def _poles(point: OperatingPoint) -> np.ndarray:
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
        poles = _poles(point)
        if rows:
            poles = poles[linear_sum_assignment(np.abs(rows[-1][:, None] - poles[None, :]))[1]]
        rows.append(poles)
    return np.array(rows).reshape(len(rows), -1)


# ---------------------------------------------------------------- frequency response


@dataclass(frozen=True, kw_only=True)
class Bandwidth:
    """Frequencies in Hz where the gain first falls 3 dB below that at rest, and where the phase first lags 90°.

    nan where it does not between 0.1 Hz and 10 kHz.
    """

    gain_frequency: float
    phase_frequency: float


def bandwidth(system: Any, *, output: str = "spool_position", source: str = "current") -> Bandwidth:
    """-3 dB and -90° frequencies of one output over one input (-3 dB is 10^(-3/20)); figures of ISO 10770-1.

    `system` is a linear system of python-control; the names are not looked at where it has but one input and output.
    Raises InputError for an unknown name, a system with poles in the right half plane, or no gain at rest.
    """
    from scipy.optimize import brentq

    H = _response(system, output, source)
    log_f = np.linspace(np.log(LOWEST), np.log(HIGHEST), 2001)
    values = H(np.exp(log_f))

    def first(measure: Callable) -> float:
        m = measure(values)
        below = np.flatnonzero(m <= 0.0)
        if not len(below) or below[0] == 0:
            return float("nan")
        k = below[0]
        root = brentq(lambda z: float(measure(H(np.exp([z])))[0]), log_f[k - 1], log_f[k], xtol=1e-12)
        return float(np.exp(root))

    return Bandwidth(
        gain_frequency=first(lambda h: np.abs(h) - 10.0 ** (-3.0 / 20.0)),
        phase_frequency=first(lambda h: h.real),
    )


def _single(system: Any, output: str, source: str) -> Any:
    """The part of a system from one input to one output."""
    if system.ninputs == 1 and system.noutputs == 1:
        return system
    for name, names in ((output, system.output_labels), (source, system.input_labels)):
        if name not in names:
            raise unknown_name("signal", name, names, "linear system")
    return system[output, source]


def _response(system: Any, output: str, source: str) -> Callable[[np.ndarray], np.ndarray]:
    """H(j 2 pi f)/H(0) as a function of frequencies (n,) in Hz."""
    part = _single(system, output, source)
    if np.any(np.asarray(part.poles()).real >= 0.0):
        raise InputError(f"frequency response: the system is not stable (poles {np.asarray(part.poles())} rad/s)")
    gain = complex(part(0.0)).real
    if not np.isfinite(gain) or gain == 0.0:
        raise InputError(f"frequency response: {output} does not follow {source} at rest (gain {gain})")
    return lambda f: np.atleast_1d(part(2j * np.pi * np.asarray(f))) / gain


@dataclass(frozen=True, kw_only=True)
class ReducedModel:
    """A reduced form: K `gain`, w `angular_frequency` rad/s, z `damping_ratio`, a `real_pole` rad/s (None, order 2).

    `system` is the `control.TransferFunction`. Fitted from `lowest_frequency` to `highest_frequency` (Hz), within which
    it is off by at most `gain_error` dB and `phase_error` degrees.
    """

    system: Any
    gain: float
    angular_frequency: float
    damping_ratio: float
    real_pole: float | None
    lowest_frequency: float
    highest_frequency: float
    gain_error: float
    phase_error: float

    @property
    def natural_frequency(self) -> float:
        """w/(2 pi), Hz."""
        return self.angular_frequency / (2.0 * np.pi)


def reduced(
    system: Any, order: int, *, highest_frequency: float | None = None, output: str = "spool_position",
    source: str = "current",
) -> ReducedModel:  # fmt: skip
    """The usual second- or third-order form of a transfer function, fitted to its frequency response.

    K is the exact gain at rest; w, z (and a) minimise the relative complex error |H_r/H - 1| over 200 frequencies even
    in log frequency, over two decades up to `highest_frequency` (Hz; by default twice the -90° frequency). z > 1 is two
    real poles. Valid within the band alone: the phase of the full model goes on falling beyond it.
    Raises InputError for another order, a band that is not positive, and as `bandwidth` does; SolveError where no start
    of the fit ends well.
    """
    import control
    from scipy.optimize import least_squares

    if order not in (2, 3):
        raise InputError(f"reduced: order = {order} must be 2 or 3")
    lag = bandwidth(system, output=output, source=source).phase_frequency
    top = 2.0 * lag if highest_frequency is None else float(highest_frequency)
    if not (np.isfinite(top) and top > 0.0):
        raise InputError(f"reduced: highest_frequency = {top} Hz must be positive (the -90° frequency is {lag} Hz)")
    frequencies = np.geomspace(top / 10.0**FIT_DECADES, top, FIT_POINTS)
    H = _response(system, output, source)(frequencies)
    s = 2j * np.pi * frequencies

    def form(logs: np.ndarray) -> np.ndarray:
        w, z, *a = np.exp(logs)
        return 1.0 / ((s**2 / w**2 + 2.0 * z * s / w + 1.0) * (1.0 + s / a[0] if a else 1.0))

    def error(logs: np.ndarray) -> np.ndarray:
        e = form(logs) / H - 1.0
        return np.concatenate([e.real, e.imag])

    w_lag = 2.0 * np.pi * (lag if np.isfinite(lag) else top)
    tails: list[list[float]] = [[]] if order == 2 else [[w_lag * r] for r in (0.3, 1.0, 3.0)]
    starts = [np.log([w_lag * r, z, *a]) for r in (1.0, 3.0) for z in (0.3, 1.0) for a in tails]
    fits = [least_squares(error, start, x_scale="jac", xtol=1e-12, ftol=1e-12) for start in starts]
    best = min(fits, key=lambda fit: fit.cost)
    if not (best.success and np.all(np.isfinite(best.x))):
        raise SolveError(f"reduced: no fit of order {order} up to {top:.6g} Hz ({best.message}); lower the band")
    w, z, *a = (float(value) for value in np.exp(best.x))
    part = _single(system, output, source)
    gain = float(complex(part(0.0)).real)
    off = form(best.x) / H
    denominator = np.array([1.0 / w**2, 2.0 * z / w, 1.0])
    return ReducedModel(
        system=control.tf(
            [gain], np.polymul(denominator, [1.0 / a[0], 1.0]) if a else denominator,
            inputs=part.input_labels, outputs=part.output_labels,
        ),
        gain=gain,
        angular_frequency=w,
        damping_ratio=z,
        real_pole=a[0] if a else None,
        lowest_frequency=float(frequencies[0]),
        highest_frequency=top,
        gain_error=float(np.max(np.abs(20.0 * np.log10(np.abs(off))))),
        phase_error=float(np.max(np.abs(np.degrees(np.angle(off))))),
    )  # fmt: skip


# ---------------------------------------------------------------- schedule


@dataclass(frozen=True, kw_only=True)
class GainRow:
    """What a controller schedules over oil temperature (°C); small deviations from rest at `current` A.

    `spool_gain` m/A, `flow_gain` K_q m^3/s/A, `flow_pressure_coefficient` K_c m^3/s/Pa, `pressure_gain` K_p = K_q/K_c
    Pa/A at closed ports, `pilot_pressure_gain` Pa/A of nozzle pressure 1 minus 2, `gain_frequency` (-3 dB) and
    `phase_frequency` (-90°) Hz of the spool, `dominant_pole` rad/s: the one nearest to zero (of a pair Im > 0).
    """

    temperature: float
    current: float
    spool_position: float
    spool_gain: float
    flow_gain: float
    flow_pressure_coefficient: float
    pressure_gain: float
    pilot_pressure_gain: float
    gain_frequency: float
    phase_frequency: float
    dominant_pole: complex


def gain_schedule(
    valve: Valve, temperatures: Sequence[float], *, current: float = 0.0, load_pressure: float = 0.0,
    oil: Oil = MIL_PRF_5606,
) -> tuple[GainRow, ...]:  # fmt: skip
    """One row a temperature (°C), with every part at it: the gains at rest and how fast the spool follows.

    A table to interpolate over the oil temperature. At null (`current` 0) the flow gain is twice that beyond the null
    opening of a few micrometres, and the pressure gain holds in there alone: schedule a loop on a row off null. In a
    fast launch the parts trail the oil and the isothermal table errs by some per cent. Raises as `operating_point`
    does.
    """
    return tuple(
        _row(operating_point(valve, current=current, temperature=t, load_pressure=load_pressure, oil=oil))
        for t in temperatures
    )


def _row(point: OperatingPoint) -> GainRow:
    system = linearise(point)
    gains = np.asarray(system(0.0)).real
    gain = {y: dict(zip(system.input_labels, gains[k], strict=True)) for k, y in enumerate(OUTPUTS)}
    flow, leak = gain["load_flow"]["current"], -gain["load_flow"]["load_pressure"]
    band = bandwidth(system)
    nearest = _poles(point)[0]
    return GainRow(
        temperature=point.temperature,
        current=point.inputs.command,
        spool_position=point.spool_position,
        spool_gain=float(gain["spool_position"]["current"]),
        flow_gain=float(flow),
        flow_pressure_coefficient=float(leak),
        pressure_gain=float(flow / leak) if leak else float("nan"),
        pilot_pressure_gain=float(gain["load_differential_pressure"]["current"]),
        gain_frequency=band.gain_frequency,
        phase_frequency=band.phase_frequency,
        dominant_pole=complex(nearest.real, abs(nearest.imag)),
    )


# ---------------------------------------------------------------- block of a loop


def nonlinear_system(scenario: Scenario) -> Any:
    """The whole valve as a `control.NonlinearIOSystem` named "valve", to close a loop around.

    Inputs: current (A; "voltage", V, of a voltage drive) and load_pressure (Pa), which take the place of the scenario's
    own commands. Supply, return and temperatures of oil and parts follow the scenario over its time 0..duration, and
    are held beyond. Outputs: `OUTPUTS` in SI, then oil_temperature (°C), for a schedule.
    States are in units of their channels' scale, so that one absolute tolerance serves all ("scaled_spool_position");
    `rest_state` gives the initial ones. The derivative is compiled machine code.

    The valve is stiff, with a lightly damped pair at 5e4 rad/s: ask `control.input_output_response` for
    solve_ivp_method="Radau" (rtol 1e-3, atol 1e-4 or finer); LSODA and BDF follow that pair and are many times slower.
    examples/position_loop.py takes 0.6 s for one second of flight with it. python-control draws straight lines between
    the given times and does not know of jumps: begin a simulation at a jump of an input, or make it a steep ramp.
    Raises InputError for a batch of valves and an effect that depends on the rate of the current.
    """
    import control

    model = scenario.model
    _refuse_rate(model, "nonlinear system")
    at = _over_time(scenario)
    supply, back = (_value(command) for command in scenario.pressures()[:2])
    derivative, scale = compile_model(model).derivative, np.array([ch.scale for ch in model.state_channels])
    states = [channel.name for channel in model.state_channels]
    named = [channel.name for channel in SIGNAL_CHANNELS]
    picks = [(True, states.index(y)) if y in states else (False, named.index(y)) for y in OUTPUTS]
    signals = _fast_signals(model)

    def rates(t, x, u, params):
        out = np.empty(len(x))
        derivative(np.ascontiguousarray(x), np.array([u[0], 0.0, supply(t), back(t), u[1]]), at(t)[:-1], out)
        return out

    def outputs(t, x, u, params):
        y, row = x * scale, at(t)
        given = signals(y, np.array([u[0], 0.0, supply(t), back(t), u[1]]), row[:-1])
        return np.array([*(y[k] if own else given[k] for own, k in picks), row[-1]])

    return control.nlsys(
        rates, outputs, name="valve", inputs=[_command_name(model), "load_pressure"],
        outputs=[*OUTPUTS, "oil_temperature"], states=[f"scaled_{name}" for name in states],
    )  # fmt: skip


def rest_state(
    scenario: Scenario, *, time: float = 0.0, command: float = 0.0, load_pressure: float = 0.0
) -> np.ndarray:  # fmt: skip
    """Scaled states (n,) of `nonlinear_system(scenario)` at rest with what holds at `time` s.

    `command` is in A (V of a voltage drive), `load_pressure` in Pa. With effects the rest nearest to that of the valve
    without them, from memories at zero. Raises InputError for a batch, SolveError where the flapper has no stable rest.
    """
    model, flat = scenario.model, _over_time(scenario)(time)[:-1]
    supply, back = (float(evaluate(pressure, time)) for pressure in scenario.pressures()[:2])
    inputs = Inputs(command, 0.0, supply, back, load_pressure)
    state = _rest(model, inputs, Coefficients(*flat[: len(Coefficients._fields)]))
    scale = np.array([channel.scale for channel in model.state_channels])
    if not any(effect.balance for effect in model.effects):
        return state / scale
    for _ in range(30):  # Newton's method; the memories that hold at rest leave the matrix singular
        rates = np.array(model.rhs(tuple(state), inputs, tuple(flat)), dtype=float) / scale
        matrix = np.array(derivatives(model)(state, np.array(inputs), flat)[0]) * scale / scale[:, None]
        step = np.linalg.lstsq(matrix, -rates, rcond=1e-13)[0]
        state = state + step * scale
        if np.max(np.abs(step)) < 1e-12:
            break
    return state / scale


def _over_time(scenario: Scenario) -> Callable[[float], np.ndarray]:
    """Flat coefficients, then the oil temperature (°C), (n_c + 1,) over time (s), straight between knots."""
    path, c = temperature_knots(scenario)
    coefficients = scenario.model.flat_coefficients(c, scenario.effects, path.parts)
    flat = np.stack(np.broadcast_arrays(*coefficients), axis=-1).astype(float)
    if flat.ndim > 2:
        raise InputError("nonlinear system: the valve holds arrays; give one valve, not a batch")
    table = np.column_stack([flat.reshape(-1, flat.shape[-1]), np.broadcast_to(path.parts.oil, path.times.shape)])
    knots = path.times.tolist()

    def at(t: float) -> np.ndarray:
        k = bisect_right(knots, t) - 1
        if k < 0 or k >= len(knots) - 1:
            return table[max(k, 0)]
        return table[k] + (t - knots[k]) / (knots[k + 1] - knots[k]) * (table[k + 1] - table[k])

    return at


def _value(command: Command) -> Callable[[float], float]:
    """A command as a function of time (s)."""
    if isinstance(command, Constant):
        held = float(command.value)
        return lambda t: held
    return lambda t: float(evaluate(command, max(t, 0.0)))


def _fast_signals(model: Model) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """The signals (11,) of SI states, inputs and coefficients, through CasADi's buffers: a few microseconds a call."""
    import casadi

    _, at = trace(model)
    function: Any = casadi.Function("signals", list(at.values()), [_trace_signals(model, at)])
    sizes = [symbol.shape[0] for symbol in at.values()]
    given, out = [np.zeros(n) for n in sizes], np.zeros(len(SIGNAL_CHANNELS))
    pointer: Any = memoryview
    buffer, evaluate_buffer = function.buffer()
    for k, array in enumerate(given):
        buffer.set_arg(k, pointer(array))
    buffer.set_res(0, pointer(out))

    def signals(state, inputs, coefficients, _alive=buffer):  # the buffer must live as long as its trigger
        for array, values in zip(given, (state, inputs, coefficients), strict=True):
            array[:] = values
        evaluate_buffer()
        return out

    return signals
