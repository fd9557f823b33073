"""Values and partial derivatives of a model's rates and signals along a course, compiled: many points at a time.

The equations are those of `codegen.trace`, CasADi takes their derivatives, and `straight_line` makes instructions of
the printed lines. The lanes are points of the course.

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
from valvesim.solver import cache, straight_line
from valvesim.solver.codegen import (
    LANES,
    ONE_AT_A_TIME,
    second_level,
    short_name,
    symbolic_outputs,
    trace,
    trace_signals,
)
from valvesim.solver.linear_forms import Expressions
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
    _module: ModuleType

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
        out = np.empty((len(self.model.state_channels) + len(self.signals), len(x)))
        self._module.fill_values(np.ascontiguousarray(x), np.ascontiguousarray(u), *course, out)
        return out

    def derivatives(self, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        """The derivatives (entries, n) of `targets` by `arguments` at the same."""
        out = np.empty((len(self.targets), len(x)))
        self._module.fill_derivatives(np.ascontiguousarray(x), np.ascontiguousarray(u), *course, out)
        return out

    def jacobian(self, x: np.ndarray, u: np.ndarray, course: CoefficientCourse) -> np.ndarray:
        """Of the derivatives those of the rates by the states alone, which take a fraction of the time."""
        out = np.empty((len(self.entries(self.states, self.states)), len(x)))
        self._module.fill_jacobian(np.ascontiguousarray(x), np.ascontiguousarray(u), *course, out)
        return out


def compile_derivatives(model: Model, signals: Sequence[str]) -> CompiledDerivatives:
    """The derivatives of a model and of the signals so named; a second or two the first time on a machine."""
    with ONE_AT_A_TIME:
        return _compile(model, tuple(signals))


@functools.lru_cache(maxsize=64)
def _compile(model: Model, signals: tuple[str, ...]) -> CompiledDerivatives:
    module = cache.load(
        short_name(model, frozenset(), f"derivatives of {' '.join(signals)}"),
        lambda: derivatives_source(model, signals),
        (straight_line.intrinsics,),
        lambda module: _call_once(module, model),
    )
    return CompiledDerivatives(model, signals, np.array(module.TARGETS), np.array(module.ARGUMENTS), module)


def _call_once(module: ModuleType, model: Model) -> None:
    """Each function called to nowhere, so that it is compiled here and not in somebody's first run."""
    x, u = np.zeros((0, len(model.state_channels))), np.zeros((0, len(INPUT_CHANNELS)))
    course = np.zeros((1, len(model.coefficient_names))), np.zeros(0, dtype=np.int64), np.zeros(0)
    with second_level():
        module.fill_values(x, u, *course, np.zeros((1, 0)))
        module.fill_derivatives(x, u, *course, np.zeros((1, 0)))
        module.fill_jacobian(x, u, *course, np.zeros((1, 0)))


def derivatives_source(model: Model, signals: Sequence[str]) -> str:
    """The Python source: `fill_values`, `fill_derivatives`, `fill_jacobian`, and where the derivatives stand."""
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
    sizes = {"n_x": states, "n_u": at["inputs"].shape[0], "n_c": at["coefficients"].shape[0]}
    return "\n".join(
        [
            f'"""Printed by valvesim.solver.partial_derivatives from {model.state_channels[-1].name} and others."""',
            "import numpy as np",
            "from numba import njit",
            "from valvesim.solver.straight_line import intrinsics",
            f"TARGETS = {[int(i) for i, _ in entries]}",
            f"ARGUMENTS = {[int(j) for _, j in entries]}",
            'LINES = """',
            "def values(x, u, c, out):", *values,
            "def derivatives(x, u, c, out):", *printed(every),
            "def jacobian(x, u, c, out):", *printed(every[of_states]),
            '"""',
            f"globals().update(intrinsics(LINES, lanes={LANES}, columns={{}}, shared=()))",
            _FILL.format(name="values", count=outputs.shape[0], lanes=LANES, **sizes),
            _FILL.format(name="derivatives", count=len(entries), lanes=LANES, **sizes),
            _FILL.format(name="jacobian", count=len(of_states), lanes=LANES, **sizes),
        ]
    )  # fmt: skip


_FILL = """@njit(nogil=True, error_model='numpy')
def fill_{name}(x, u, knots, place, share, out):
    X, U, C = np.empty(({n_x}, {lanes})), np.empty(({n_u}, {lanes})), np.empty(({n_c}, {lanes}))
    found = np.empty(({count}, {lanes}))
    n, last = x.shape[0], knots.shape[0] - 1
    for first in range(0, n, {lanes}):
        for lane in range({lanes}):
            k = min(first + lane, n - 1)
            for i in range({n_x}):
                X[i, lane] = x[k, i]
            for i in range({n_u}):
                U[i, lane] = u[k, i]
            before, after, part = place[k], min(place[k] + 1, last), share[k]
            for i in range({n_c}):
                C[i, lane] = knots[before, i] + part * (knots[after, i] - knots[before, i])
        {name}(X, U, C, found)
        for i in range({count}):
            for lane in range(min({lanes}, n - first)):
                out[i, first + lane] = found[i, lane]
"""
"""Lanes are filled from a course of points, and emptied into it."""
