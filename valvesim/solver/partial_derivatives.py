"""Values and partial derivatives of a model's rates and signals along a course, compiled: many points at a time.

The equations are those of `codegen.trace`, CasADi takes their derivatives, and `machine_code` compiles the printed
lines. The loop around them is numba's. The lanes are points of the course.

Symbols
    x states, u inputs, c flat coefficients (SI units); targets: the rates of the states, then signals
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from valvesim.channels import INPUT_CHANNELS
from valvesim.solver import cache, machine_code
from valvesim.solver.codegen import (
    LANES,
    ONE_AT_A_TIME,
    second_level,
    short_name,
    symbolic_outputs,
    trace,
    trace_signals,
    with_replaced,
)
from valvesim.solver.linear_forms import Expressions
from valvesim.solver.machine_code import MachineCode
from valvesim.solver.rodas5p import call
from valvesim.valve.equations import Model


class CoefficientCourse(NamedTuple):
    """Flat coefficients along a course of n points: at each a `share` (n,) of the way from the row `place` (n,) of the
    `knots` (m, n_c) to the next; of one knot they stay.
    """

    knots: np.ndarray
    place: np.ndarray
    share: np.ndarray

    def at(self, rows: slice) -> CoefficientCourse:
        """The same at some of the points."""
        return CoefficientCourse(self.knots, self.place[rows], self.share[rows])


@dataclass(frozen=True, eq=False)
class CompiledDerivatives:
    """The rates and some signals of a model, and their partial derivatives, ready to be worked out along a course.

    `targets` and `arguments` tell the derivatives that may differ from zero: of which target (rates, then `signals`) by
    which argument (states, inputs, coefficients, counted through).
    """

    model: Model
    signals: tuple[str, ...]
    targets: np.ndarray
    arguments: np.ndarray
    _code: MachineCode
    _fill: Any

    def entries(self, targets: slice, arguments: slice) -> np.ndarray:
        """The places among the derivatives of those of some targets by some arguments."""
        of = (targets.start <= self.targets) & (self.targets < targets.stop)
        by = (arguments.start <= self.arguments) & (self.arguments < arguments.stop)
        return np.flatnonzero(of & by)

    @property
    def states(self) -> slice:
        """Where the states stand among the arguments, and their rates among the targets."""
        return slice(0, len(self.model.state_channels))

    @property
    def inputs(self) -> slice:
        """Where the inputs stand among the arguments."""
        return slice(self.states.stop, self.states.stop + len(INPUT_CHANNELS))

    @property
    def coefficients(self) -> slice:
        """Where the coefficients stand among the arguments."""
        first = self.states.stop + len(INPUT_CHANNELS)
        return slice(first, first + len(self.model.coefficient_names))

    def values(self, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        """Rates and signals (targets, n) at states x (n, n_x) and inputs u (n, n_u)."""
        return self._filled("values", len(self.model.state_channels) + len(self.signals), x, u, course)

    def derivatives(self, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        """The derivatives (entries, n) of `targets` by `arguments` at the same."""
        return self._filled("derivatives", len(self.targets), x, u, course)

    def jacobian(self, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        """Of the derivatives those of the rates by the states alone, which take a fraction of the time."""
        return self._filled("jacobian", len(self.entries(self.states, self.states)), x, u, course)

    def _filled(self, name: str, rows: int, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        out = np.empty((rows, len(x)))
        self._fill(self._code.addresses[name], np.ascontiguousarray(x), np.ascontiguousarray(u), *course, out)
        return out


def compile_derivatives(model: Model, signals: Sequence[str]) -> CompiledDerivatives:
    """The derivatives of a model and of the signals so named; a second or two the first time on a machine."""
    with ONE_AT_A_TIME:
        return _compile(model, tuple(signals))


@functools.lru_cache(maxsize=64)
def _compile(model: Model, signals: tuple[str, ...]) -> CompiledDerivatives:
    code = machine_code.load_machine_code(
        short_name(model, frozenset(), f"derivatives of {' '.join(signals)}"),
        lambda: derivatives_source(model, signals),
    )
    targets, arguments = (np.array(code.layout[name]) for name in ("targets", "arguments"))
    return CompiledDerivatives(model, signals, targets, arguments, code, _load_loop().fill)


@functools.cache
def _load_loop() -> ModuleType:
    """The loop along a course, compiled or found compiled."""
    return cache.load(["course"], _loop_source, (machine_code.caller,), _call_once)


def _call_once(module: ModuleType) -> None:
    """The loop over no points, so that it is compiled here and not in somebody's first run."""
    course = np.zeros((1, 1)), np.zeros(0, dtype=np.int64), np.zeros(0)
    with second_level():
        module.fill(0, np.zeros((0, 1)), np.zeros((0, 1)), *course, np.zeros((1, 0)))


def derivatives_source(model: Model, signals: Sequence[str]) -> str:
    """The printed functions `values`, `derivatives` and `jacobian`, and where the derivatives stand."""
    import casadi

    join: Any = casadi.vertcat
    rates, at = trace(model)
    named = trace_signals(model, at)
    names = [channel.name for channel in model.signal_channels]
    outputs = join(rates, *(named[names.index(name)] for name in signals))
    arguments = dict(zip("xuc", at.values(), strict=True))
    plain = Expressions()
    found = plain.of_symbols(arguments, casadi.densify(outputs), constant=())
    values = plain.lines({f"out[{k}]": value for k, value in enumerate(found)})
    jacobian: Any = casadi.jacobian(join(*symbolic_outputs(values, **arguments)), join(*arguments.values()))
    entries = list(zip(*jacobian.sparsity().get_triplet(), strict=True))
    states = at["state"].shape[0]
    of_states = [k for k, (target, argument) in enumerate(entries) if target < states and argument < states]

    def printed(derivatives: Any) -> list[str]:
        derived = Expressions()
        found = derived.of_symbols(arguments, derivatives, constant=())
        return derived.lines({f"out[{k}]": value for k, value in enumerate(found)})

    every = join(*jacobian.nonzeros())
    return machine_code.with_layout(
        [
            "def values(x, u, c, out):", *values,
            "def derivatives(x, u, c, out):", *printed(every),
            "def jacobian(x, u, c, out):", *printed(every[of_states]),
        ],
        lanes=LANES, columns={}, shared=(), numbers=(),
        targets=[int(i) for i, _ in entries], arguments=[int(j) for _, j in entries],
    )  # fmt: skip


def fill(function, x, u, knots, place, share, out):
    """Fill out (r, n) with what a printed function (x, u, c, out) makes of states x (n, n_x), inputs u (n, n_u) and
    the coefficients of a course: lanes are filled from its points, and emptied into it.
    """
    lanes, n, last = LANES, x.shape[0], knots.shape[0] - 1
    X, U, C = np.empty((x.shape[1], lanes)), np.empty((u.shape[1], lanes)), np.empty((knots.shape[1], lanes))
    found = np.empty((out.shape[0], lanes))
    for first in range(0, n, lanes):
        for lane in range(lanes):
            k = min(first + lane, n - 1)
            for i in range(x.shape[1]):
                X[i, lane] = x[k, i]
            for i in range(u.shape[1]):
                U[i, lane] = u[k, i]
            before, after, part = place[k], min(place[k] + 1, last), share[k]
            for i in range(knots.shape[1]):
                C[i, lane] = knots[before, i] + part * (knots[after, i] - knots[before, i])
        call(function, X, U, C, found)
        for i in range(out.shape[0]):
            for lane in range(min(lanes, n - first)):
                out[i, first + lane] = found[i, lane]


def _loop_source() -> str:
    """The Python source of `fill` as it is compiled, with its lanes in figures."""
    return machine_code.loops_source([with_replaced(fill, ("LANES", str(LANES)))])
