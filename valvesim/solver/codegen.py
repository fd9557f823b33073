"""The model as machine code: traced once by CasADi, with exact derivatives, printed as Python and compiled by numba.

`Model.rhs` runs on symbols; what comes out is a straight line of arithmetic. CasADi takes its Jacobian, and each
line is printed as Python source, which `cache` keeps with its machine code for the next process. States in the compiled
functions are scaled by the channels' scales.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from valvesim import inputs
from valvesim.channels import INPUT_CHANNELS
from valvesim.solver import cache, rodas5p
from valvesim.solver.elimination import print_elimination
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import CurrentDrive, Model, VoltageDrive


@dataclass(frozen=True)
class CompiledModel:
    """A model ready to integrate: `run` is `rodas5p.integrate` with the model's own functions built in."""

    model: Model
    scale: np.ndarray
    run: Any
    derivative: Any
    jacobian: Any
    jacobians: Any


OPTIONAL = ("nozzle_laminar_loss", "orifice_laminar_loss", "orifice_wall_loss")
"""Coefficients that most valves hold at zero: without their terms the right-hand side takes a sixth less time."""


def absent_coefficients(model: Model, flat: np.ndarray) -> frozenset[str]:
    """Those of `OPTIONAL` that are zero in all coefficients (..., n_c) of a run: its machine code leaves them out."""
    names = model.coefficient_names
    return frozenset(name for name in OPTIONAL if not np.any(flat[..., names.index(name)]))


def trace(model: Model, absent: frozenset[str] = frozenset()) -> tuple[Any, dict[str, Any]]:
    """CasADi symbols and expressions of a model: (rates, {"state": x, "inputs": u, "coefficients": c}).

    The coefficients named `absent` are taken for zero.
    """
    import casadi

    casadi.GlobalOptions.setNumpyMode(-1)
    sizes = (len(model.state_channels), len(INPUT_CHANNELS), len(model.coefficient_names))
    x, u, c = (casadi.SX.sym(name, size) for name, size in zip("xuc", sizes, strict=True))
    present = zip(_split(c), model.coefficient_names, strict=True)
    rates = model.rhs(_split(x), _split(u), tuple(casadi.SX(0) if name in absent else one for one, name in present))
    vector: Any = casadi.vertcat
    return vector(*rates), {"state": x, "inputs": u, "coefficients": c}


def _split(vector: Any) -> tuple:
    return tuple(vector[k] for k in range(vector.shape[0]))


@functools.lru_cache(maxsize=64)
def derivatives(model: Model) -> Any:
    """Exact derivatives of the right-hand side: a CasADi function (state, inputs, coefficients) -> three Jacobians.

    Each Jacobian is a dense matrix (states, states | inputs | coefficients) in SI units. The columns of an effect that
    acts on the coefficients (`Effect.coefficients`) are zero: it has done so before the right-hand side sees them.
    """
    import casadi

    rates, at = trace(model)
    matrices = [casadi.densify(casadi.jacobian(rates, symbol)) for symbol in at.values()]
    names = ["by_" + name for name in at]
    return casadi.Function("derivatives", list(at.values()), matrices, list(at), names)


_ONE_AT_A_TIME = threading.Lock()


def compile_model(model: Model, absent: frozenset[str] = frozenset()) -> CompiledModel:
    """The compiled model; a few seconds the first time on a machine, well under one second after that.

    With the terms of `absent` coefficients left out (see `absent_coefficients`) it is for runs in which they are zero.
    """
    with _ONE_AT_A_TIME:  # CasADi traces in one thread alone, and no thread compiles what another is about to have
        return _compile(model, absent)


@functools.lru_cache(maxsize=64)
def _compile(model: Model, absent: frozenset[str]) -> CompiledModel:
    module = _load(model, absent)
    scale = np.array([channel.scale for channel in model.state_channels])
    return CompiledModel(model, scale, module.run, module.derivative, module.jacobian, module.jacobians)


def _load(model: Model, absent: frozenset[str] = frozenset()) -> ModuleType:
    """The printed module of a model, its functions compiled or found compiled."""
    from numba.extending import register_jitable

    for function in _CALLED:
        register_jitable(function)
    return cache.load(
        _short_name(model, absent), lambda: source(model, absent), _CALLED, lambda module: _call_once(module, model)
    )


def _short_name(model: Model, absent: frozenset[str]) -> list[str] | None:
    """What tells a model of this package alone from every other; None for one with a user's effect or drive."""
    own = type(model.drive) in (CurrentDrive, VoltageDrive) and all(
        CATALOGUE.get(effect.name) is effect for effect in model.effects
    )  # fmt: skip
    return [type(model.drive).__name__, *(e.name for e in model.effects), "", *sorted(absent)] if own else None


def _call_once(module: ModuleType, model: Model) -> None:
    """Each function called to nowhere, so that it is compiled here and not in somebody's first run."""
    n, n_u, n_c = len(model.state_channels), len(INPUT_CHANNELS), len(model.coefficient_names)
    with _short_loops():
        module.run(
            np.zeros(n), np.zeros(3), 0.0, np.zeros(1), np.zeros((1, n_u - 1, 3)), np.zeros(1),
            np.ones((1, n_c)), np.zeros(0), np.zeros((0, n)), 1e-3, np.full(n, 1e-5), np.zeros(n), 1,
            np.zeros(2, dtype=np.int64),
        )  # fmt: skip
        module.jacobians(np.zeros((0, n)), np.zeros((0, n_u)), np.ones((1, n_c)), np.zeros((0, n, n)))


@contextlib.contextmanager
def _short_loops() -> Iterator[None]:
    """No vectoriser while compiling: loops over a few states gain nothing by it, and it takes a fifth of the time."""
    from numba.core import config as numba_config

    config: Any = numba_config
    kept = config.LOOP_VECTORIZE, config.SLP_VECTORIZE
    config.LOOP_VECTORIZE = config.SLP_VECTORIZE = 0
    try:
        yield
    finally:
        config.LOOP_VECTORIZE, config.SLP_VECTORIZE = kept


def source(model: Model, absent: frozenset[str] = frozenset()) -> str:
    """The Python source of `derivative` and `jacobian` of a model in scaled states, and of `run`."""
    import casadi

    rates, at = trace(model, absent)
    scale = casadi.DM([channel.scale for channel in model.state_channels])
    y = casadi.SX.sym("y", at["state"].shape[0])
    scaled = casadi.substitute(rates, at["state"], y * scale) / scale
    arguments = [y, at["inputs"], at["coefficients"]]
    jacobian: Any = casadi.jacobian(scaled, y)
    join: Any = casadi.vertcat
    rows, columns = jacobian.sparsity().get_triplet()
    rate = casadi.Function("rate", arguments, [casadi.cse(scaled)])
    slope = casadi.Function("slope", arguments, [casadi.cse(join(*jacobian.nonzeros()))])
    n = y.shape[0]
    zeros = [(i, j) for i in range(n) for j in range(n) if (i, j) not in set(zip(rows, columns, strict=True))]
    return "\n".join(
        [
            f'"""Printed by valvesim.solver.codegen from {model.state_channels[-1].name} and others."""',
            "import numpy as np",
            "from math import copysign, exp, log, sqrt, tanh, sin, cos, fabs",
            "from numba import njit",
            "from valvesim.solver.rodas5p import *",
            "",
            *_print_function("derivative", rate, [f"out[{k}]" for k in range(n)], []),
            *_print_solver(*print_elimination(n, zip(rows, columns, strict=True))),
            *_print_function("jacobian", slope, [f"out[{i}, {j}]" for i, j in zip(rows, columns, strict=True)], zeros),
            _HEAD,
            _JACOBIANS,
            _HEAD,
            _integrator_source(n, arguments[2].shape[0]),
        ]
    )


_JACOBIANS = """def jacobians(y, u, c, out):
    for k in range(y.shape[0]):
        jacobian(y[k], u[k], c[min(k, c.shape[0] - 1)], out[k])
"""
"""The Jacobian along a course: y (n, states), u (n, inputs), c (n or 1, coefficients) -> out (n, states, states)."""


_CALLED = (inputs.piece_value, rodas5p.set_inputs, rodas5p.set_coefficients)
"""The plain functions that `integrate` calls."""


def _integrator_source(n: int, n_c: int) -> str:
    """`rodas5p.integrate` as `run`, which finds the model's functions in its own module, and has its sizes in figures.

    Printed rather than called with them as arguments: numba keeps no compiled code of a function that takes functions,
    and loops of a known length are unrolled.
    """
    text = inspect.getsource(rodas5p.integrate)
    for plain, printed in (
        ("def integrate(", "def run("),
        ("derivative, jacobian, factor, back_substitute, ", ""),
        ("n, n_c = y.shape[0], knots.shape[1]", f"n, n_c = {n}, {n_c}"),
    ):
        text = text.replace(plain, printed, 1)
    return text


_HEAD = "@njit(nogil=True, error_model='numpy')"


def _print_solver(factor: Sequence[str], back_substitute: Sequence[str]) -> list[str]:
    """`factor(W)` and `back_substitute(W, x)` from their lines."""
    bodies = {"factor(W)": factor, "back_substitute(W, x)": back_substitute}
    return [line for name, body in bodies.items() for line in (_HEAD, f"def {name}:", *(f"    {x}" for x in body), "")]


def _print_function(name: str, function: Any, targets: Sequence[str], zeros: Sequence[tuple[int, int]]) -> list[str]:
    """A CasADi function as Python source: one line an operation."""
    import casadi

    lines = [_HEAD, f"def {name}(y, u, c, out):"]
    operations = _operations(casadi)
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        into, of = function.instruction_output(k), function.instruction_input(k)
        if code == casadi.OP_CONST:
            text = f"w{into[0]} = {function.instruction_constant(k)!r}"
        elif code == casadi.OP_INPUT:
            text = f"w{into[0]} = {'yuc'[of[0]]}[{of[1]}]"
        elif code == casadi.OP_OUTPUT:
            text = f"{targets[into[1]]} = w{of[0]}"
        else:
            text = f"w{into[0]} = " + operations[code].format(*(f"w{k}" for k in of))
        lines.append("    " + text)
    return [*lines, *(f"    out[{i}, {j}] = 0.0" for i, j in zeros), ""]


def _operations(casadi: ModuleType) -> dict[int, str]:
    """How each CasADi operation is written in Python."""
    return {
        casadi.OP_ASSIGN: "{0}", casadi.OP_ADD: "{0} + {1}", casadi.OP_SUB: "{0} - {1}", casadi.OP_MUL: "{0} * {1}",
        casadi.OP_DIV: "{0} / {1}", casadi.OP_NEG: "-{0}", casadi.OP_INV: "1.0 / {0}", casadi.OP_SQ: "{0} * {0}",
        casadi.OP_TWICE: "{0} + {0}", casadi.OP_SQRT: "sqrt({0})", casadi.OP_EXP: "exp({0})", casadi.OP_LOG: "log({0})",
        casadi.OP_POW: "{0} ** {1}", casadi.OP_CONSTPOW: "{0} ** {1}", casadi.OP_FABS: "fabs({0})",
        casadi.OP_SIGN: "np.sign({0})", casadi.OP_FMAX: "max({0}, {1})", casadi.OP_FMIN: "min({0}, {1})",
        casadi.OP_TANH: "tanh({0})", casadi.OP_SIN: "sin({0})", casadi.OP_COS: "cos({0})",
        casadi.OP_LT: "(1.0 if {0} < {1} else 0.0)", casadi.OP_LE: "(1.0 if {0} <= {1} else 0.0)",
        casadi.OP_NOT: "(1.0 if {0} == 0.0 else 0.0)", casadi.OP_IF_ELSE_ZERO: "({1} if {0} != 0.0 else 0.0)",
        casadi.OP_AND: "(1.0 if {0} != 0.0 and {1} != 0.0 else 0.0)",
        casadi.OP_OR: "(1.0 if {0} != 0.0 or {1} != 0.0 else 0.0)",
    }  # fmt: skip
