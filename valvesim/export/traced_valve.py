"""A scenario's valve as expressions over symbols: coefficients, thermal network, rates, outputs, rest, sensitivities.

The formulas are those that a run uses, called with CasADi symbols: nothing of the valve's physics is written here.

Symbols
    p tunable parameters, u inputs (`EXPORTED_INPUTS`), x states that the Jacobian couples, T temperatures as states
    s sources of the network: temperatures T, oil in the pilot stage, ambient; c coefficients, then part temperatures
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvesim.channels import INPUT_CHANNELS, SIGNAL_CHANNELS, Channel, Inputs
from valvesim.errors import InputError
from valvesim.inputs import evaluate
from valvesim.simulation.scenario import Scenario
from valvesim.solver.codegen import PrintedEquations, print_rates
from valvesim.units import POSITIVE, quantities
from valvesim.valve.coefficients import CLEARANCES, PART_NAMES, PartTemperatures, check_routes, coefficient_formulas
from valvesim.valve.effect import READABLE, ActiveEffect, Reading
from valvesim.valve.equilibrium import balances_at_rest, chamber_surplus, nozzle_pressures
from valvesim.valve.fluid import COMPUTED_RANGE
from valvesim.valve.thermal_network import SOURCES, THERMAL_NODES, throttling_rise

OIL_TEMPERATURE = Channel("oil_temperature", "degC", "oil before the pilot stage", 100.0)
EXPORTED_INPUTS = (*INPUT_CHANNELS, OIL_TEMPERATURE)
"""Inputs of the exported valve in order: those of the equations, then the oil's temperature."""
COMMAND_LIMITS = {"A": 1.0, "V": 1e4}  # beyond which a command is no servo valve's
OTHER_AT_ZERO = ("bulk_modulus_slope",)  # quantities with another formula at zero: zero stays, no other becomes it
THROTTLING_DROP = "thermal.throttling_pressure_drop"


@dataclass(frozen=True, kw_only=True)
class ValveVariable:
    """A parameter, input, state or output of the exported valve: SI, temperatures in °C. `start` None is worked out."""

    name: str
    unit: str
    doc: str
    start: float | None = None
    low: float = -np.inf
    high: float = np.inf
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TracedValve:
    """A scenario's valve as CasADi functions; each takes and gives vectors in the order of these variables.

    `states` are first those of the equations with lagged sensors (`coupled` many), then temperatures. `uses_rate` is
    true where the equations feel the command's rate of change. `settles` where effects move the state at rest away
    from the static solution. `equations` are the rates of the coupled states as lines, over scaled states,
    inputs and coefficients. `dependence` is the pattern of all rates, then outputs, over states, then inputs.
    """

    scenario: Scenario
    parameters: tuple[ValveVariable, ...]
    inputs: tuple[ValveVariable, ...]
    states: tuple[ValveVariable, ...]
    outputs: tuple[ValveVariable, ...]
    coupled: int
    network: bool
    lagged_parts: bool
    uses_rate: bool
    settles: bool
    coefficient_names: tuple[str, ...]
    clearances: tuple[int, ...]
    functions: dict[str, Any]
    equations: PrintedEquations
    dependence: Any


def trace_valve(scenario: Scenario) -> TracedValve:
    """The valve of a scenario, traced. InputError for a batch, and for an effect that needs a whole series."""
    import casadi

    casadi.GlobalOptions.setNumpyMode(-1)
    for name in quantities(scenario.valve):
        if np.ndim(getattr(scenario.valve, name)):
            raise InputError("is an array, a batch of valves: one valve is exported", key=f"valve.{name}", joint=" ")
    return _Trace(scenario).result()


class _Trace:
    """The steps of a trace in order, each with what those before it have made."""

    def __init__(self, scenario: Scenario):
        import casadi

        if scenario.part_temperatures:
            raise InputError("an exported valve has no input for a part's temperature", key="thermal.part_temperatures")
        self.casadi: Any = casadi
        self.scenario, self.model = scenario, scenario.model
        self.candidates: list[ValveVariable] = []
        self.symbols: list[Any] = []
        self._declare_parameters()
        self._declare_states()
        self._trace_temperatures()
        self._trace_equations()

    # ---------------------------------------------------------------- parameters and states

    def _parameter(self, name: str, unit: str, doc: str, start: float, bounds: tuple[float, float]) -> Any:
        symbol = self.casadi.SX.sym(name)
        low, high = bounds
        self.candidates.append(
            ValveVariable(
                name=name, unit=unit, doc=doc, start=float(start), low=low, high=high, scale=abs(start) or 1.0
            )
        )
        self.symbols.append(symbol)
        return symbol

    def _with_symbols(self, instance: Any, prefix: str) -> Any:
        """A dataclass of quantities with a symbol in the place of each; its checks are those of the C code."""
        traced = copy.copy(instance)
        for name, field in quantities(instance).items():
            about, value, bounds = field.metadata, getattr(instance, name), field.metadata["bounds"]
            if name in OTHER_AT_ZERO:
                if value == 0.0:
                    continue
                bounds = (POSITIVE, bounds[1])
            symbol = self._parameter(f"{prefix}.{name}", about["unit"], about["doc"], value, bounds)
            object.__setattr__(traced, name, symbol)
        return traced

    def _declare_parameters(self) -> None:
        scenario, thermal = self.scenario, self.scenario.thermal
        self.valve = self._with_symbols(scenario.valve, "valve")
        self.oil = self._with_symbols(scenario.oil, "oil")
        self.ambient = self._parameter(
            "thermal.ambient_temperature", "degC", "air around the valve", thermal.ambient_temperature, COMPUTED_RANGE
        )
        self.network = None if thermal.network is None else self._with_symbols(thermal.network, "thermal")
        self.drop = None
        if thermal.throttling_heat:
            start = scenario.valve_at_start
            drop = start.supply_pressure - start.return_pressure
            self.drop = self._parameter(THROTTLING_DROP, "Pa", "drop that heats the oil", drop, (0.0, 1e8))
        self.effects: list[ActiveEffect] = []
        seen: dict[str, int] = {}
        for active in scenario.effects:
            effect = active.effect
            key = ".".join(filter(None, (f"effects.{effect.name}", effect.channel)))
            seen[key] = seen.get(key, 0) + 1
            key += f"_{seen[key]}" if seen[key] > 1 else ""
            numbers = tuple(
                self._parameter(f"{key}.{p.name}", p.unit, p.doc, number, p.bounds)
                for p, number in zip(effect.parameters, active.numbers, strict=True)
            )
            self.effects.append(ActiveEffect(effect, numbers))

    def _declare_states(self) -> None:
        states = [
            ValveVariable(name=c.name, unit=c.unit, doc=c.doc, scale=c.scale) for c in self.model.state_channels
        ]  # fmt: skip
        self.sensor_lags = [a for a in self.effects if a.effect.reading is not None and a.effect.lag is not None]
        for k, active in enumerate(self.sensor_lags):
            channel, before = active.effect.channel, [a.effect.channel for a in self.sensor_lags[:k]]
            name = f"lagged_{channel}" + (f"_{before.count(channel) + 1}" if channel in before else "")
            of = READABLE[channel]
            doc = f"what the sensor of {channel} has felt"
            states.append(ValveVariable(name=name, unit=of.unit, doc=doc, scale=of.scale))
        self.coupled = len(states)
        self.part_lag = None
        for active in self.effects:
            if active.effect.temperatures is not None:
                if active.effect.lag is None or self.part_lag is not None:
                    raise _needs_a_series(active)
                self.part_lag = active
        low, high = COMPUTED_RANGE
        initial = self.scenario.thermal.initial_temperature
        if self.network is not None:
            middle = "path_" if self.part_lag else ""
            for node in THERMAL_NODES:
                start: Any = initial.get(node) if isinstance(initial, Mapping) else initial
                doc = f"temperature of the {node.replace('_', ' ')}" + (" before its lag" if middle else "")
                start = None if start is None else float(start)
                name = f"{node}_{middle}temperature"
                states.append(
                    ValveVariable(name=name, unit="degC", doc=doc, start=start, low=low, high=high, scale=100.0)
                )  # fmt: skip
        if self.part_lag:
            for node in THERMAL_NODES:
                doc = f"temperature of the {node.replace('_', ' ')} behind its lag"
                states.append(ValveVariable(name=f"{node}_lagged_temperature", unit="degC", doc=doc, scale=100.0))
        self.states = tuple(states)

    # ---------------------------------------------------------------- temperatures and coefficients

    def _trace_temperatures(self) -> None:
        """Oil in the pilot stage, rates of the network, part temperatures, coefficients."""
        SX, n_slow = self.casadi.SX, len(self.states) - self.coupled
        self.u = SX.sym("u", len(EXPORTED_INPUTS))
        self.T = SX.sym("T", n_slow)
        oil = self.u[len(EXPORTED_INPUTS) - 1]
        self.pilot_oil = oil if self.drop is None else oil + throttling_rise(self.oil, self.drop)(oil)
        path, rates = dict.fromkeys(THERMAL_NODES, self.pilot_oil), []
        self.sources = SX.sym("s", n_slow + 2)
        held = dict.fromkeys(THERMAL_NODES, self.sources[n_slow])
        if self.network is not None:
            path = {node: self.T[k] for k, node in enumerate(THERMAL_NODES)}
            held = {node: self.sources[k] for k, node in enumerate(THERMAL_NODES)}
            outside = dict(zip(SOURCES, (self.sources[n_slow], self.sources[n_slow + 1]), strict=True))
            rates = list(self.network.rates(held | outside).values())
        parts = path
        if self.part_lag:
            tau = self.part_lag.effect.lag(self.part_lag.values)  # type: ignore[misc]  # looked at where it was found
            first = n_slow - len(THERMAL_NODES)
            rates += [_lag_rate(held[node], self.sources[first + k], tau) for k, node in enumerate(THERMAL_NODES)]
            parts = {
                node: _if_lagging(self.T[first + k], path[node], tau) for k, node in enumerate(THERMAL_NODES)
            }  # fmt: skip
        self.thermal_rates = self.casadi.vertcat(*rates) if rates else SX(0, 1)
        self.parts = PartTemperatures(oil=self.pilot_oil, **parts)
        c = coefficient_formulas(self.valve, self.parts, self.oil, check_routes(self.scenario.thermal.routes))
        flat = self.model.flat_coefficients(c, self.effects, self.parts)
        temperatures = [getattr(self.parts, name) for name in PART_NAMES]
        self.c_expressions = [SX(one) for one in (*flat, *temperatures)]
        self.c_names = (*self.model.coefficient_names, *(f"{name}_temperature" for name in PART_NAMES))

    # ---------------------------------------------------------------- equations

    def _trace_equations(self) -> None:
        """Rates of the coupled states and all outputs over (x, u, c); coefficients that never change are numbers."""
        SX, model = self.casadi.SX, self.model
        self.x = SX.sym("x", self.coupled)
        self.c = SX.sym("c", len(self.c_expressions))
        seen = self._seen()
        n, n_c = len(model.state_channels), len(model.coefficient_names)
        state = tuple(self.x[k] for k in range(n))
        inputs = Inputs(*(self.u[k] for k in range(len(INPUT_CHANNELS))))
        known_rates, signals = model.evaluate(state, inputs, tuple(seen[:n_c]))
        rates: list[Any] = list(known_rates)
        channels = dict(zip((c.name for c in model.state_channels), state, strict=True))
        channels |= {c.name: value for c, value in zip(SIGNAL_CHANNELS, signals, strict=True)}
        channels |= dict(zip((f"{name}_temperature" for name in PART_NAMES), seen[n_c:], strict=True))
        self.outputs = self._plain_outputs(channels)
        measured: dict[str, Any] = {}
        lags, pilot_oil = iter(range(n, self.coupled)), channels["oil_temperature"]
        for active in self.effects:
            effect = active.effect
            if effect.reading is None:
                continue
            value = measured.get(effect.channel, channels[effect.channel])
            if effect.lag is not None:
                lagged, tau = self.x[next(lags)], effect.lag(active.values)
                rates.append(_lag_rate(value, lagged, tau))
                measured[effect.channel] = _if_lagging(lagged, value, tau)
                continue
            try:
                measured[effect.channel] = SX(effect.reading(Reading(0.0, value, pilot_oil), active.values))
            except (TypeError, ValueError, NotImplementedError, RuntimeError):
                raise _needs_a_series(active) from None
            if not measured[effect.channel].is_scalar():
                raise _needs_a_series(active)
        for name, value in measured.items():
            of = READABLE[name]
            doc = f"what the sensor of {name} reads"
            told = ValveVariable(name=f"measured_{name}", unit=of.unit, doc=doc, scale=of.scale)
            self.outputs.append((told, value))
        self.rates = self._with_more_coefficients(self.casadi.vertcat(*rates))

    def _seen(self) -> list[Any]:
        """The coefficients as the equations see them: a symbol, or a number that nothing changes."""
        return [one if one.is_constant() else self.c[k] for k, one in enumerate(self.c_expressions)]

    def _with_more_coefficients(self, rates: Any) -> Any:
        """Rates in which the parameters of sensors, which no coefficient holds, are coefficients too."""
        casadi = self.casadi
        found = [k for k, symbol in enumerate(self.symbols) if casadi.depends_on(rates, symbol)]
        if not found:
            return rates
        more = casadi.SX.sym("more", len(found))
        chosen = casadi.vertcat(*(self.symbols[k] for k in found))
        self.c_expressions += [self.symbols[k] for k in found]
        self.c_names = (*self.c_names, *(self.candidates[k].name for k in found))
        self.c = casadi.vertcat(self.c, more)
        return casadi.substitute(rates, chosen, more)

    def _plain_outputs(self, channels: dict[str, Any]) -> list[tuple[ValveVariable, Any]]:
        """All channels of a run that are neither input nor state."""
        taken = {v.name for v in self.states} | {self.scenario.drive.command_name}
        outputs = []
        for channel in SIGNAL_CHANNELS:
            if channel.name not in taken:
                told = ValveVariable(name=channel.name, unit=channel.unit, doc=channel.doc, scale=channel.scale)
                outputs.append((told, channels[channel.name]))
        names = ("pilot_oil" if self.drop is not None else "", *THERMAL_NODES)
        for name in filter(None, names):
            shown = f"{name}_temperature"
            if shown not in taken:
                doc = f"temperature of the {name.replace('_', ' ')}"
                key = "oil_temperature" if name == "pilot_oil" else shown
                outputs.append((ValveVariable(name=shown, unit="degC", doc=doc, scale=100.0), channels[key]))
        return outputs

    # ---------------------------------------------------------------- the whole

    def result(self) -> TracedValve:
        """The functions, over the parameters that any of them needs."""
        casadi, model = self.casadi, self.model
        c_of_p = casadi.vertcat(*self.c_expressions)
        outputs = casadi.vertcat(*(value for _, value in self.outputs))
        join = casadi.vertcat
        everything = join(c_of_p, self.rates, outputs, self.thermal_rates, self.pilot_oil)
        if self.network is not None:
            everything = join(everything, self.ambient)
        needed = [k for k, symbol in enumerate(self.symbols) if casadi.depends_on(everything, symbol)]
        p = casadi.SX.sym("p", len(needed))
        chosen = join(*(self.symbols[k] for k in needed))

        def over_p(expression: Any) -> Any:
            return casadi.substitute(expression, chosen, p)

        c_of_p, rates, outputs = over_p(c_of_p), over_p(self.rates), over_p(outputs)
        thermal, pilot_oil = over_p(self.thermal_rates), over_p(self.pilot_oil)
        x, u, c, T, s = self.x, self.u, self.c, self.T, self.sources
        equations = print_rates(rates, x, u, c, [state.scale for state in self.states[: self.coupled]])
        whole = join(
            casadi.substitute(rates, c, c_of_p),
            casadi.substitute(thermal, s, join(T, pilot_oil, over_p(self.ambient))),
        )
        whole_outputs = casadi.substitute(outputs, c, c_of_p)
        z, known = join(x, T), (x, T, u, p)
        seeds = [casadi.SX.sym(f"seed_{k}", one.shape[0]) for k, one in enumerate((z, u, p))]
        inner = join(*known)
        forward = casadi.jtimes(join(whole, whole_outputs), inner, join(*seeds))
        back = casadi.SX.sym("back", z.shape[0] + outputs.shape[0])
        adjoint = casadi.jtimes(join(whole, whole_outputs), inner, back, True)

        def function(name: str, arguments: Sequence[Any], out: Any) -> Any:
            return casadi.Function(name, list(arguments), [casadi.cse(casadi.densify(out))])

        functions = {
            "coefficients": function("coefficients", [p, T, u], c_of_p),
            "pilot_oil": function("pilot_oil", [p, u], pilot_oil),
            "thermal_rates": function("thermal_rates", [p, s], thermal),
            "outputs": function("outputs", [x, u, c, p], outputs),
            "forward": function("forward", [z, u, p, *seeds], casadi.substitute(forward, join(x, T), z)),
            "adjoint": function("adjoint", [z, u, p, back], casadi.substitute(adjoint, join(x, T), z)),
            **self._rest_functions(function),
        }
        uses_rate = bool(casadi.depends_on(join(rates, outputs), u[1]))
        names = self.c_names
        return TracedValve(
            scenario=self.scenario,
            parameters=tuple(self.candidates[k] for k in needed),
            inputs=self._input_variables(),
            states=self.states,
            outputs=tuple(told for told, _ in self.outputs),
            coupled=self.coupled,
            network=self.network is not None,
            lagged_parts=self.part_lag is not None,
            uses_rate=uses_rate,
            settles=bool(model.effects) or bool(self.sensor_lags),
            coefficient_names=names,
            clearances=tuple(names.index(name) for name in CLEARANCES),
            functions=functions,
            equations=equations,
            dependence=casadi.jacobian_sparsity(
                casadi.substitute(join(whole, whole_outputs), join(x, T), z), join(z, u)
            ),
        )

    def _rest_functions(self, function: Any) -> dict[str, Any]:
        """What the static solution solves: q are armature angle, nozzle pressures 1 and 2, current."""
        casadi, model = self.casadi, self.model
        q = casadi.SX.sym("q", 4)
        theta, p1, p2, current = (q[k] for k in range(4))
        c = model.valve_coefficients(tuple(self._seen()))
        supply, back, load = self.u[2], self.u[3], self.u[4]
        x_f = c.nozzle_arm * theta
        sides = (
            (c.fixed_orifice_diameter_1, c.nozzle_diameter_1, c.null_gap_1 - x_f, p1),
            (c.fixed_orifice_diameter_2, c.nozzle_diameter_2, c.null_gap_2 + x_f, p2),
        )
        surplus = [chamber_surplus(*side, c, supply, back) for side in sides]
        memory = model.drive.rest(self.u[0], c)
        join, arguments = casadi.vertcat, [q, self.u, self.c]
        reach = casadi.fmin(c.null_gap_1, c.null_gap_2) / c.nozzle_arm
        return {
            "rest_surplus_1": function("rest_surplus_1", arguments, join(surplus[0], casadi.jacobian(surplus[0], p1))),
            "rest_surplus_2": function("rest_surplus_2", arguments, join(surplus[1], casadi.jacobian(surplus[1], p2))),
            "rest_guess": function("rest_guess", arguments, join(*nozzle_pressures(theta, c, supply, back))),
            "rest_balance": function(
                "rest_balance", arguments, join(*balances_at_rest(theta, current, p1, p2, c, supply, back, load))
            ),
            "rest_current": function("rest_current", [self.u, self.c], join(memory[0] if memory else self.u[0], reach)),
        }

    def _input_variables(self) -> tuple[ValveVariable, ...]:
        scenario, drive = self.scenario, self.scenario.drive
        commands = (scenario.command, None, *scenario.pressures(), scenario.oil_temperature)
        limit = COMMAND_LIMITS[drive.command_unit]
        positive, bar = quantities(scenario.valve), {}
        bar = {name: positive[name].metadata["bounds"] for name in ("supply_pressure", "return_pressure")}
        bar["load_pressure"] = positive["load_pressure"].metadata["bounds"]
        variables = []
        for channel, command in zip(EXPORTED_INPUTS, commands, strict=True):
            name, unit, doc = channel.name, channel.unit, channel.doc
            low, high = -np.inf, np.inf
            if name == "command":
                name, unit, low, high = drive.command_name, drive.command_unit, -limit, limit
                doc = "current in the coils" if drive.command_unit == "A" else "voltage over coils and amplifier"
            elif name == "command_rate":
                name, unit = f"{drive.command_name}_rate", f"{drive.command_unit}/s"
                doc = f"rate of change of the {drive.command_name}, which the iron's hysteresis follows"
            elif name in bar:
                low, high = bar[name]
            else:
                low, high = COMPUTED_RANGE
            start = 0.0 if command is None else float(evaluate(command, 0.0))
            scale = drive.command_for_current(1e-2, 600.0) if channel.name == "command" else channel.scale
            variables.append(
                ValveVariable(name=name, unit=unit, doc=doc, start=start, low=low, high=high, scale=scale)
            )  # fmt: skip
        return tuple(variables)


def _lag_rate(value: Any, lagged: Any, tau: Any) -> Any:
    """Rate of a first-order lag; none where its time constant is zero."""
    import casadi

    return casadi.if_else(tau > 0.0, (value - lagged) / tau, 0.0)


def _if_lagging(lagged: Any, value: Any, tau: Any) -> Any:
    """What comes out of a lag: the value itself where the time constant is zero."""
    import casadi

    return casadi.if_else(tau > 0.0, lagged, value)


def _needs_a_series(active: ActiveEffect) -> InputError:
    return InputError(
        "cannot be exported: it works on a whole record, and a model in another program has the present alone",
        key=f"effects.{active.effect.name}", joint=" ",
    )  # fmt: skip
