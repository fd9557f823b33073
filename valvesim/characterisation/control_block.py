"""The whole nonlinear valve as a block of a control loop (`control.NonlinearIOSystem`).

python-control takes over a second to import and is imported where it is needed."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np

from valvesim.channels import SIGNAL_CHANNELS, Inputs
from valvesim.characterisation.linearisation import LINEARISED_OUTPUTS, refuse_command_rate, rest_of
from valvesim.errors import InputError
from valvesim.inputs import Command, Constant, evaluate
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.temperature_knots import temperature_knots
from valvesim.solver.codegen import compile_model, derivatives, trace, trace_signals
from valvesim.valve.coefficients import Coefficients
from valvesim.valve.equations import Model


def nonlinear_system(scenario: Scenario) -> Any:
    """The whole valve as a `control.NonlinearIOSystem` named "valve", to close a loop around.

    Inputs: current (A; "voltage", V, of a voltage drive) and load_pressure (Pa), which take the place of the scenario's
    own commands. Supply, return and temperatures of oil and parts follow the scenario over its time 0..duration, and
    are held beyond. Outputs: `LINEARISED_OUTPUTS` in SI, then oil_temperature (°C), for a schedule.
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
    refuse_command_rate(model, "nonlinear system")
    at = _over_time(scenario)
    supply, back = (_value(command) for command in scenario.pressures()[:2])
    derivative, scale = compile_model(model).derivative, np.array([ch.scale for ch in model.state_channels])
    states = [channel.name for channel in model.state_channels]
    named = [channel.name for channel in SIGNAL_CHANNELS]
    picks = [(True, states.index(y)) if y in states else (False, named.index(y)) for y in LINEARISED_OUTPUTS]
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
        rates, outputs, name="valve", inputs=[model.drive.command_name, "load_pressure"],
        outputs=[*LINEARISED_OUTPUTS, "oil_temperature"], states=[f"scaled_{name}" for name in states],
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
    state = rest_of(model, inputs, Coefficients(*flat[: len(Coefficients._fields)]))
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
    function: Any = casadi.Function("signals", list(at.values()), [trace_signals(model, at)])
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
