"""A position loop around the valve: cylinder, mass, friction and a proportional controller, run by the valve's solver.

Symbols
    y position m, v velocity m/s, p_L load pressure Pa, Q_L load flow m^3/s, A piston area, V_t volume of both chambers
    m v' = A p_L - B v - F_c tanh(v/v_c),   (V_t/(4 beta)) p_L' = Q_L - A v - C p_L        Merritt (1967), ch. 6
    i = K_p (r - y), within the rated current;  K_p = K_v A/K_q gives the loop the velocity gain K_v

The loop is a model of equations as the valve is one (`valve.valve_model`): the same compiled integrator runs both, so a
launch of 90 s takes a fraction of a second.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from valvesim.channels import INPUT_CHANNELS, Channel, Inputs
from valvesim.characterisation.gain_schedule import gain_schedule
from valvesim.characterisation.linearisation import refuse_command_rate
from valvesim.errors import InputError, SolveError
from valvesim.inputs import Command, Sine, evaluate, merge
from valvesim.simulation import driver
from valvesim.simulation.run import ADVICE, MAX_STEPS, output_times
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.temperature_knots import between, temperature_knots
from valvesim.solver.codegen import CompiledModel, absent_coefficients, compile_model
from valvesim.units import POSITIVE, check_bounds, quantities, quantity
from valvesim.valve.coefficients import PART_NAMES
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.equations import Model
from valvesim.valve.equilibrium import settle
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import TemperaturePath

ACTUATOR_CHANNELS = (
    Channel("position", "m", "piston and mass", 1e-2),
    Channel("velocity", "m/s", "its velocity", 0.1),
    Channel("actuator_pressure", "Pa", "port A minus port B of the cylinder", 1e7),
)
_EXAMPLE = "examples/position_loop.py"


@dataclass(frozen=True, kw_only=True)
class PositionLoop:
    """A loop around the valve of `scenario`, whose own command and load pressure do not act; SI.

    The controller's gain is K_v A over the flow gain of `schedule`, rows of (oil temperature °C, K_q m^3/s/A), straight
    in between; `scheduled_for` makes them. `reference` (m) is the position asked for.
    Raises InputError for a schedule that is none.
    """

    scenario: Scenario
    schedule: tuple[tuple[float, float], ...]
    reference: Command = field(default_factory=lambda: Sine(amplitude=10e-3, frequency=2.0))
    piston_area: float = quantity(1e-3, "m^2", "A, piston", (POSITIVE, 1.0), _EXAMPLE, tolerance=0.005)
    cylinder_volume: float = quantity(1.2e-4, "m^3", "V_t, both chambers", (POSITIVE, 1.0), _EXAMPLE, tolerance=0.05)
    mass: float = quantity(60.0, "kg", "m, piston and load", (POSITIVE, 1e5), _EXAMPLE, tolerance=0.05)
    viscous_friction: float = quantity(500.0, "N*s/m", "B, of the actuator", (0.0, 1e6), _EXAMPLE, tolerance=0.3)
    coulomb_friction: float = quantity(100.0, "N", "F_c, of the actuator", (0.0, 1e6), _EXAMPLE, tolerance=0.3)
    coulomb_speed: float = quantity(2e-3, "m/s", "v_c, speed at which friction is full", (POSITIVE, 1.0), _EXAMPLE)
    bypass: float = quantity(1e-11, "m^3/s/Pa", "C, leak between the chambers", (0.0, 1e-6), _EXAMPLE, tolerance=0.3)
    velocity_gain: float = quantity(40.0, "1/s", "K_v, velocity gain of the loop", (POSITIVE, 1e4), _EXAMPLE)

    def __post_init__(self):
        check_bounds(self)
        at = [temperature for temperature, _ in self.schedule]
        if not at or any(b <= a for a, b in zip(at[:-1], at[1:], strict=True)):
            raise InputError("needs one row or more of rising oil temperature", key="loop.schedule")
        if not all(0.0 < gain < np.inf for _, gain in self.schedule):
            raise InputError("every flow gain must be positive", key="loop.schedule")

    @property
    def model(self) -> LoopModel:
        """The equations of the whole loop."""
        return LoopModel(self.scenario.model)


def scheduled_for(
    valve: Valve, temperatures: Sequence[float], *, current: float = 2e-3, **more: Any
) -> tuple[tuple[float, float], ...]:
    """Rows (°C, flow gain m^3/s/A) for `PositionLoop.schedule`, see `gain_schedule`, off null by `current`."""
    rows = gain_schedule(valve, temperatures, current=current, **more)
    return tuple((row.temperature, row.flow_gain) for row in rows)


class LoopCoefficients(NamedTuple):
    """What the loop needs besides the valve's coefficients; the last two belong to the controller."""

    piston_area: Any
    cylinder_volume: Any
    mass: Any
    viscous_friction: Any
    coulomb_friction: Any
    coulomb_speed: Any
    bypass: Any
    proportional_gain: Any
    rated_current: Any


class LoopSignals(NamedTuple):
    """What the equations give besides the derivatives."""

    position_error: Any
    current: Any
    load_flow: Any


LOOP_SIGNALS = (
    Channel("position_error", "m", "reference minus position", 1e-3),
    Channel("current", "A", "current in the coils", 1e-2),
    Channel("load_flow", "m^3/s", "out of port A", 3e-4),
)
REFERENCE = Channel("reference", "m", "position asked for", 1e-2)


@dataclass(frozen=True)
class LoopModel:
    """Valve, actuator and controller (see the module's head); the command among the inputs is the reference, m."""

    valve: Model
    drive = None  # the compiler asks for one

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Those of the valve."""
        return self.valve.effects

    @property
    def state_channels(self) -> tuple[Channel, ...]:
        """The states of the valve, then of the actuator."""
        return self.valve.state_channels + ACTUATOR_CHANNELS

    @property
    def memory_states(self) -> slice:
        """Memories of effects."""
        return self.valve.memory_states

    @property
    def input_channels(self) -> tuple[Channel, ...]:
        """Reference, its rate, and the pressures."""
        return (REFERENCE, *INPUT_CHANNELS[1:])

    @property
    def signal_channels(self) -> tuple[Channel, ...]:
        """`LoopSignals`."""
        return LOOP_SIGNALS

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """The loop's stand behind the valve's."""
        return self.valve.coefficient_names + LoopCoefficients._fields

    def with_effects(self, effects: Sequence[Effect]) -> LoopModel:
        """The same loop around the valve with these effects."""
        return LoopModel(self.valve.with_effects(effects))

    def valve_coefficients(self, flat: Sequence) -> Any:
        """The valve's own."""
        return self.valve.valve_coefficients(flat)

    def flat_coefficients(self, c: Any, active: Sequence[ActiveEffect], parts: Any = None) -> tuple:
        """Those of the valve and its effects, then the loop's: `c` is a pair of both."""
        own, loop = c
        return (*self.valve.flat_coefficients(own, active, parts), *loop)

    def rest(self, inputs: Sequence, c: Any) -> tuple:
        """The valve at rest without current, the mass at the reference: near the rest of the loop."""
        u = Inputs(*inputs)
        valve = self.valve.rest(u._replace(command=0.0, load_pressure=0.0), c)
        return (*valve, u.command, 0.0, 0.0)

    def rhs(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple:
        """Derivatives of all states."""
        return self.evaluate(state, inputs, coefficients)[0]

    def signals(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> LoopSignals:
        """What `LOOP_SIGNALS` names."""
        return self.evaluate(state, inputs, coefficients)[1]

    def evaluate(self, state: Sequence, inputs: Sequence, coefficients: Sequence) -> tuple[tuple, LoopSignals]:
        """Derivatives and signals at once; see the module's head."""
        valve_states, valve_names = len(self.valve.state_channels), len(self.valve.coefficient_names)
        own, (y, v, p_L) = tuple(state[:valve_states]), tuple(state[valve_states:])
        c, k = coefficients[:valve_names], LoopCoefficients(*coefficients[valve_names:])
        u = Inputs(*inputs)

        error = u.command - y
        wanted = k.proportional_gain * error
        i = np.maximum(np.minimum(wanted, k.rated_current), -k.rated_current)
        rates, signals = self.valve.evaluate(own, u._replace(command=i, command_rate=0.0, load_pressure=p_L), c)

        oil = self.valve.valve_coefficients(c)
        beta = oil.bulk_modulus_at_zero + oil.bulk_modulus_slope * u.supply_pressure / 2.0
        friction = k.viscous_friction * v + k.coulomb_friction * np.tanh(v / k.coulomb_speed)
        v_rate = (k.piston_area * p_L - friction) / k.mass
        p_rate = 4.0 * beta / k.cylinder_volume * (signals.load_flow - k.piston_area * v - k.bypass * p_L)
        return (*rates, v, v_rate, p_rate), LoopSignals(error, i, signals.load_flow)


@dataclass(frozen=True)
class LoopProblem:
    """A loop, or a batch of loops, ready to run: the first axis of `knots` and `initial` is the member."""

    loop: PositionLoop
    compiled: CompiledModel
    path: TemperaturePath
    knots: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    times: np.ndarray
    initial: np.ndarray


def prepare_loop(loop: PositionLoop, *, knot_times: np.ndarray | None = None) -> LoopProblem:
    """Temperatures, coefficients, compiled equations and the loop at rest at the reference's first value.

    Figures of loop and valve that are arrays (k,) are a batch. Raises InputError for an effect that feels the rate of
    the current, and as `simulate` does.
    """
    scenario = loop.scenario
    model: Any = loop.model
    refuse_command_rate(model.valve, "position loop")
    path, c = temperature_knots(scenario, knot_times=knot_times)
    gains = np.interp(path.parts.oil, *np.array(loop.schedule).T)
    figures = {name: _column(getattr(loop, name)) for name in quantities(loop)}
    gain = figures.pop("velocity_gain") * figures["piston_area"] / gains
    own = LoopCoefficients(**figures, proportional_gain=gain, rated_current=_column(scenario.valve.rated_current))
    flat = model.flat_coefficients((c, own), scenario.effects, path.parts)
    knots = np.stack(np.broadcast_arrays(*flat), axis=-1).astype(float)
    knots = np.array(np.broadcast_to(knots, (*knots.shape[:-2], len(path.times), knots.shape[-1])))
    knots = knots.reshape(-1, *knots.shape[-2:])
    commands = (loop.reference, *scenario.pressures())
    starts, intervals = merge(commands, scenario.duration)
    compiled = compile_model(model, absent_coefficients(model, knots))
    first, *pressures = (float(evaluate(command, 0.0)) for command in commands)
    inputs = np.array([first, 0.0, *pressures])
    initial = np.array([_rest(compiled, inputs, flat, k) for k, flat in enumerate(knots[:, 0])])
    return LoopProblem(loop, compiled, path, knots, starts, intervals.rows, output_times(scenario), initial)


def _column(value: Any) -> Any:
    return np.asarray(value)[:, None] if np.ndim(value) else float(value)


def _rest(compiled: CompiledModel, inputs: np.ndarray, flat: np.ndarray, member: int) -> np.ndarray:
    """Scaled states (n,) of the loop at rest."""
    model = compiled.model
    start = np.array([float(x) for x in model.rest(tuple(inputs), model.valve_coefficients(tuple(flat)))])
    return settle(
        lambda y, out: compiled.derivative(y, inputs, flat, out),
        lambda y, out: compiled.jacobian(y, inputs, flat, out),
        start / compiled.scale, model.state_channels, where=f"member {member}: the position loop: ",
    )  # fmt: skip


def integrate_loop(problem: LoopProblem, member: int = 0) -> np.ndarray:
    """States (n_t, n) in SI of one member. Raises SolveError."""
    return driver.integrate(_of_member(problem, member), what="the position loop", advice=ADVICE)[0]


def integrate_loops(problem: LoopProblem, members: Sequence[int]) -> Iterator[np.ndarray | SolveError]:
    """States (n_t, n) in SI of some members, in order, or why one fails; see `driver.integrate_members`."""
    return driver.integrate_members(
        lambda member: _of_member(problem, member), lambda member: integrate_loop(problem, member),
        problem.initial, problem.knots, members,
    )  # fmt: skip


def _of_member(problem: LoopProblem, member: int) -> driver.InitialValueProblem:
    scenario = problem.loop.scenario
    return driver.InitialValueProblem(
        compiled=problem.compiled, initial=problem.initial[member], starts=problem.starts, rows=problem.rows,
        knot_times=problem.path.times, knots=problem.knots[member], times=problem.times, end=scenario.duration,
        tolerance=scenario.tolerance, most_steps=MAX_STEPS,
    )  # fmt: skip


def loop_channels(loop: PositionLoop) -> tuple[Channel, ...]:
    """The channels of a loop, in the order of `loop_values`."""
    temperatures = tuple(Channel(f"{name}_temperature", "degC", name.replace("_", " ")) for name in PART_NAMES)
    return (REFERENCE, *temperatures, *loop.model.state_channels, *LOOP_SIGNALS)


def loop_values(problem: LoopProblem, states: np.ndarray, member: int = 0) -> dict[str, np.ndarray]:
    """All channels (n_t,) by name."""
    loop, times, at = problem.loop, problem.times, problem.path.times
    reference, *pressures = (evaluate(one, times) for one in (loop.reference, *loop.scenario.pressures()))
    c = tuple(between(times, at, problem.knots[member]))
    signals = loop.model.signals(tuple(states.T), Inputs(reference, np.zeros_like(times), *pressures), c)
    parts = np.column_stack([np.broadcast_to(getattr(problem.path.parts, name), at.shape) for name in PART_NAMES])
    columns = (reference, *between(times, at, parts), *states.T, *signals)
    pairs = zip(loop_channels(loop), columns, strict=True)
    return {channel.name: np.broadcast_to(column, times.shape) for channel, column in pairs}


def simulate_loop(loop: PositionLoop) -> Any:
    """Run one loop from rest: an xarray.Dataset of all channels over time with units. Raises as `prepare_loop`."""
    import xarray

    problem = prepare_loop(loop)
    states = integrate_loop(problem)
    values = loop_values(problem, states)
    return xarray.Dataset(
        {c.name: ("time", values[c.name], {"units": c.unit, "long_name": c.doc}) for c in loop_channels(loop)},
        coords={"time": ("time", problem.times, {"units": "s", "long_name": "time"})},
        attrs={"title": loop.scenario.title, "source": "valvesim"},
    )
