"""The model as machine code: traced once by CasADi, with exact derivatives, printed line by line and compiled.

`Model.rhs` runs on symbols; what comes out is a straight line of arithmetic. It is rewritten so that a step computes
as little as it can (`linear_forms`), CasADi takes its derivatives, and `machine_code` compiles the lines. The
integrator around them is the same for every model: numba compiles it once, and it calls the lines by their addresses.
`cache` keeps all of it for the next process. States in the compiled functions are scaled by the channels' scales.
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
from valvesim.solver import cache, machine_code, rodas5p
from valvesim.solver.elimination import print_elimination
from valvesim.solver.linear_forms import ONE, Expressions
from valvesim.solver.machine_code import MachineCode
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import CurrentDrive, Model, VoltageDrive


@dataclass(frozen=True)
class CompiledModel:
    """A model ready to integrate: `run` is `rodas5p.integrate` with the model's own functions.

    `rates` and `jacobians` fill what they say along a course: of scaled states y (n, states), inputs u (n, inputs) and
    flat coefficients c (n or 1, coefficients) -> (n, states) and (n, states, states).
    """

    model: Model
    absent: frozenset[str]
    scale: np.ndarray
    run: Any
    rates: Any
    jacobians: Any

    def derivative(self, y: np.ndarray, u: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
        """The rates (n,) at scaled states y (n,), inputs u and flat coefficients c, into `out`."""
        self.rates(y[None], u[None], c[None], out[None])

    def jacobian(self, y: np.ndarray, u: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
        """The Jacobian (n, n) at the same, into `out`."""
        self.jacobians(y[None], u[None], c[None], out[None])


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


def trace_signals(model: Model, at: dict[str, Any]) -> Any:
    """The signals of a model as a column of CasADi expressions in the symbols of `trace`."""
    import casadi

    join: Any = casadi.vertcat
    return casadi.densify(join(*model.signals(*map(_split, at.values()))))


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


ONE_AT_A_TIME = threading.Lock()
"""CasADi traces in one thread alone, and no thread compiles what another is about to have."""


def compile_model(model: Model, absent: frozenset[str] = frozenset()) -> CompiledModel:
    """The compiled model; some tenths of a second the first time on a machine, and a hundredth after that.

    With the terms of `absent` coefficients left out (see `absent_coefficients`) it is for runs in which they are zero.
    """
    with ONE_AT_A_TIME:
        return _compile(model, absent)


@functools.lru_cache(maxsize=64)
def _compile(model: Model, absent: frozenset[str]) -> CompiledModel:
    code, loops = _load(model, absent), _load_loops(1)
    n_c = code.layout["coefficients"]
    return CompiledModel(
        model, absent, np.array([channel.scale for channel in model.state_channels]), _integrator(code, loops),
        code.bound(loops.fill_rates, ("prepare", "rates"), n_c),
        code.bound(loops.fill_jacobians, ("prepare", "linearise"), n_c),
    )  # fmt: skip


LANES = 8  # valves that take their steps together: two or one of a processor's vectors, which also hides waiting


def compile_lanes(compiled: CompiledModel) -> Any:
    """`run` of a compiled model for `LANES` valves together; as long to compile as the model itself."""
    with ONE_AT_A_TIME:
        return _compile_lanes(compiled.model, compiled.absent)


@functools.lru_cache(maxsize=64)
def _compile_lanes(model: Model, absent: frozenset[str]) -> Any:
    return _integrator(_load(model, absent, LANES), _load_loops(LANES))


CALLED_IN_A_STEP = ("prepare", "linearise", "factor", "step", "error", "bend", "within")
"""The printed functions that `rodas5p.integrate` calls, as it takes them."""


def _integrator(code: MachineCode, loops: ModuleType) -> Any:
    return code.bound(loops.run, CALLED_IN_A_STEP, code.layout["coefficients"], code.layout["rated"])


def _load(model: Model, absent: frozenset[str] = frozenset(), lanes: int = 1) -> MachineCode:
    """The printed functions of a model, compiled or found compiled."""
    return machine_code.load_machine_code(short_name(model, absent, str(lanes)), lambda: source(model, absent, lanes))


@functools.cache
def _load_loops(lanes: int) -> ModuleType:
    """The integrator's loops for so many lanes, compiled or found compiled: seconds the first time on a machine."""
    from numba.extending import register_jitable

    for function in _CALLED:
        register_jitable(forceinline=True)(function)  # an array that is handed on is some ten numbers
    return cache.load(
        ["integrator", str(lanes)], lambda: _loops_source(lanes), (*_CALLED, machine_code.caller),
        lambda module: _call_once(module, lanes),
    )  # fmt: skip


def short_name(model: Model, absent: frozenset[str], what: str) -> list[str] | None:
    """What tells the code of a model of this package, and `what` code it is, from every other; None for a model with a
    user's effect or drive.
    """
    own = type(model.drive) in (CurrentDrive, VoltageDrive) and all(
        CATALOGUE.get(effect.name) is effect for effect in model.effects
    )  # fmt: skip
    if not own:
        return None
    return [type(model.drive).__name__, *(e.name for e in model.effects), "", *sorted(absent), what]


@contextlib.contextmanager
def second_level() -> Iterator[None]:
    """LLVM's second level of optimisation: the third takes a tenth longer and makes nothing faster."""
    from numba.core import config as numba_config

    config: Any = numba_config
    kept, config.OPT = config.OPT, type(config.OPT)(min(config.OPT, 2))
    try:
        yield
    finally:
        config.OPT = kept


def _call_once(module: ModuleType, lanes: int) -> None:
    """Each function called for no time or no points, so that it is compiled here and not in somebody's first run."""
    n, n_u, n_c = 6, len(INPUT_CHANNELS), 1
    with second_level():
        module.run(
            *(0 for _ in CALLED_IN_A_STEP), n_c, True, np.zeros((n, lanes)), np.zeros(3), 0.0, np.zeros(1),
            np.zeros((1, n_u - 1, 3)), np.zeros(1), np.ones((1, n_c, lanes)), np.zeros(0), np.zeros((0, n, lanes)),
            1e-3, np.full(n, 1e-5), np.zeros((n, lanes)), 1, np.zeros(2, dtype=np.int64),
        )  # fmt: skip
        if lanes > 1:
            return
        y, u, c = np.zeros((0, n)), np.zeros((0, n_u)), np.ones((1, n_c))
        module.fill_rates(0, 0, n_c, y, u, c, np.zeros((0, n)))
        module.fill_jacobians(0, 0, n_c, y, u, c, np.zeros((0, n, n)))


SHARED = ("u", "u_t", "atol")
"""What all lanes have in common, in the printed functions."""

NUMBERS = ("h", "diagonal", "share", "rtol")
"""Their arguments that are no arrays."""


def source(model: Model, absent: frozenset[str] = frozenset(), lanes: int = 1) -> str:
    """The printed functions of a model in scaled states: what `rodas5p.integrate` calls, and `rates`."""
    equations = print_equations(model, absent)
    n, n_u, n_c = len(model.state_channels), len(INPUT_CHANNELS), equations.coefficients
    factor, solve = print_elimination(n, equations.entries)
    factor = ["def factor(J, diagonal, W, pivots):", *(f"    {line}" for line in factor)]
    lines = [*equations.lines, *factor, *rodas5p.print_step(n, solve)]
    columns = dict.fromkeys(("J", "W", "K", "bent"), n) | {"u": n_u, "c": n_c}
    rated = any("u[1]" in line for line in equations.lines)
    return machine_code.with_layout(
        lines, lanes=lanes, columns=columns, shared=SHARED, numbers=NUMBERS, coefficients=n_c, rated=rated
    )


def _loops_source(lanes: int) -> str:
    """The Python source of the loops for so many lanes: `run`, and for one lane `fill_rates` and `fill_jacobians`."""
    functions = [_integrator_source(lanes), *([_RATES, _JACOBIANS] if lanes == 1 else [])]
    return machine_code.loops_source(functions, "from valvesim.solver.rodas5p import *")


@dataclass(frozen=True)
class PrintedEquations:
    """The functions `prepare`, `rates` and `linearise` as lines for `straight_line`.

    `coefficients` is how many `prepare` makes of the flat ones, `entries` the (row, column) of the Jacobian that may
    differ from zero.
    """

    lines: list[str]
    coefficients: int
    entries: list[tuple[int, int]]


def print_equations(model: Model, absent: frozenset[str] = frozenset()) -> PrintedEquations:
    """The equations of a model in scaled states, see `print_rates`."""
    rates, at = trace(model, absent)
    scale = [channel.scale for channel in model.state_channels]
    return print_rates(rates, at["state"], at["inputs"], at["coefficients"], scale)


def print_rates(
    rates_of: Any, x: Any, inputs_of: Any, coefficients_of: Any, scales: Sequence[float]
) -> PrintedEquations:  # fmt: skip
    """Rates of states x over inputs and coefficients, CasADi's, in scaled states as a step computes them.

    They are told as linear forms (`linear_forms`).
    `prepare(c, out)` turns flat coefficients into those that the others take; `rates(y, u, c, out)` are the
    derivatives, and `linearise(y, u, u_t, c, c_t, f, J, f_t)` the same with their exact derivatives by the states and
    over time, where u_t and c_t are how fast inputs and coefficients change.
    """
    import casadi

    join: Any = casadi.vertcat
    n, n_u, scale = x.shape[0], inputs_of.shape[0], casadi.DM(scales)
    y = casadi.SX.sym("y", n)
    scaled = casadi.substitute(rates_of, x, y * scale) / scale
    expressions = Expressions()
    prepared: dict[tuple[int, float], int] = {}
    values = expressions.of_symbols({"y": y, "u": inputs_of, "c": coefficients_of}, scaled, constant=("c",))
    rates = expressions.lines({f"out[{k}]": value for k, value in enumerate(values)}, prepared)
    ahead = {f"out[{k}]": {(node, ONE): number} for (node, number), k in prepared.items()}

    u, u_t = casadi.SX.sym("u", n_u), casadi.SX.sym("u_t", n_u)
    c, c_t = casadi.SX.sym("c", len(prepared)), casadi.SX.sym("c_t", len(prepared))
    f = join(*symbolic_outputs(rates, y=y, u=u, c=c))
    jacobian: Any = casadi.jacobian(f, y)
    f_t: Any = casadi.jtimes(f, join(u, c), join(u_t, c_t))
    entries = list(zip(*jacobian.sparsity().get_triplet(), strict=True))
    targets = [*(f"f[{k}]" for k in range(n)), *(f"J[{i}, {j}]" for i, j in entries), *(f"f_t[{k}]" for k in range(n))]
    derived = Expressions()
    values = derived.of_symbols(
        {"y": y, "u": u, "u_t": u_t, "c": c, "c_t": c_t}, casadi.densify(join(f, *jacobian.nonzeros(), f_t)),
        constant=("c",),
    )  # fmt: skip
    lines = [
        "def prepare(c, out):", *expressions.lines(ahead),
        "def rates(y, u, c, out):", *rates,
        "def linearise(y, u, u_t, c, c_t, f, J, f_t):", *derived.lines(dict(zip(targets, values, strict=True))),
    ]  # fmt: skip
    return PrintedEquations(lines, len(prepared), entries)


def symbolic_outputs(lines: Sequence[str], **arguments: Any) -> list[Any]:
    """The outputs `out` of printed lines that run on CasADi's symbols."""
    import casadi

    functions: dict[str, Any] = {
        **{name: getattr(casadi, name) for name in ("sqrt", "exp", "log", "tanh", "sin", "cos", "fabs", "sign")},
        # a choice, for the derivative of CasADi's own maximum divides by a sum of two truths
        "maximum": lambda a, b: casadi.if_else(a < b, b, a), "minimum": lambda a, b: casadi.if_else(b < a, b, a),
        "inverse_fourth_root": lambda a: 1.0 / casadi.sqrt(casadi.sqrt(a)),
        "where_true": lambda a, b: casadi.if_else(a, b, 0.0), "power": lambda a, b: a**b,
        "less": lambda a, b: a < b, "less_equal": lambda a, b: a <= b, "logical_not": casadi.logic_not,
        "logical_and": casadi.logic_and, "logical_or": casadi.logic_or,
    }  # fmt: skip
    out: dict[int, Any] = {}
    exec("\n".join(line.strip() for line in lines), functions | arguments | {"out": out})
    return [out[k] for k in range(len(out))]


_RATES = """def fill_rates(prepare, rates, n_c, y, u, c, out):
    prepared = np.empty(n_c)
    for at in range(y.shape[0]):
        if at < c.shape[0]:
            call(prepare, c[at], prepared)
        call(rates, y[at], u[at], prepared, out[at])
"""

_JACOBIANS = """def fill_jacobians(prepare, linearise, n_c, y, u, c, out):
    prepared, still, f, f_t = np.empty(n_c), np.zeros(n_c + u.shape[1]), np.empty(y.shape[1]), np.empty(y.shape[1])
    for at in range(y.shape[0]):
        if at < c.shape[0]:
            call(prepare, c[at], prepared)
        for i in range(out.shape[1]):
            for j in range(out.shape[2]):
                out[at, i, j] = 0.0
        call(linearise, y[at], u[at], still, prepared, still, f, out[at], f_t)
"""


_CALLED = (
    inputs.piece_motion, rodas5p.set_inputs, rodas5p.set_inputs_of_step, rodas5p.set_coefficients_of_step,
    rodas5p.copy_rows,
)  # fmt: skip
"""The plain functions that `integrate` calls."""


def _integrator_source(lanes: int) -> str:
    """`rodas5p.integrate` as `run`, with its lanes in figures, so that loops over them are unrolled.

    Printed rather than compiled where it stands, where `call` is Python's.
    """
    return with_replaced(
        rodas5p.integrate, ("def integrate(", "def run("), ("n, lanes = y.shape", f"n, lanes = y.shape[0], {lanes}")
    )


def with_replaced(function: Any, *replaced: tuple[str, str]) -> str:
    """The source of a function with some of its text in other words, each once."""
    text = inspect.getsource(function)
    for plain, printed in replaced:
        if plain not in text:
            raise RuntimeError(f"{function.__module__}.{function.__name__} has no {plain!r}")
        text = text.replace(plain, printed, 1)
    return text
