"""`valve_model.h` and `valve_model.c`: the traced valve printed as C, instruction by instruction, with its tables."""

from __future__ import annotations

import functools
import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

from valvesim.errors import InputError
from valvesim.export.traced_valve import EXPORTED_INPUTS, TracedValve, ValveVariable
from valvesim.simulation import driver, run, temperature_knots
from valvesim.solver import rodas5p
from valvesim.solver.elimination import print_elimination
from valvesim.valve.coefficients import PART_NAMES
from valvesim.valve.thermal_network import THERMAL_NODES

ARGUMENTS = {
    "coefficients": ("p", "T", "u"),
    "pilot_oil": ("p", "u"),
    "thermal_rates": ("p", "s"),
    "outputs": ("x", "u", "c", "p"),
    "forward": ("z", "u", "p", "dz", "du", "dp"),
    "adjoint": ("z", "u", "p", "d"),
    "rest_surplus_1": ("q", "u", "c"),
    "rest_surplus_2": ("q", "u", "c"),
    "rest_guess": ("q", "u", "c"),
    "rest_balance": ("q", "u", "c"),
    "rest_current": ("u", "c"),
}
"""The functions of CasADi's that are printed, each `valve_model_NAME(arguments..., out)`, with their arguments."""

_SQUARE = "[VALVE_COUPLED][VALVE_COUPLED]"
SOLVER_FUNCTIONS = {
    "prepare": "const double c[], double out[]",
    "rates": "const double y[], const double u[], const double c[], double out[]",
    "linearise": "const double y[], const double u[], const double u_t[], const double c[], const double c_t[],\n"
    f"    double f[], double J{_SQUARE}, double f_t[]",
    "factor": f"double J{_SQUARE}, double diagonal, double W{_SQUARE}, double pivots[]",
    "step": "const double y[], double u[VALVE_NODES_OF_STEP][VALVE_INPUTS],\n"
    "    double c[VALVE_NODES_OF_STEP][VALVE_PREPARED], double h, const double f[], const double f_t[],\n"
    f"    double W{_SQUARE}, double K[VALVE_STAGES][VALVE_COUPLED], double new_y[], double rate[]",
    "error": "const double y[], const double new_y[], double K[VALVE_STAGES][VALVE_COUPLED], const double rest[],\n"
    "    const double atol[], double rtol, double e[]",
}
"""The functions of the integrator that are printed from the lines of `solver`, with their arguments in C."""


def model_sources(valve: TracedValve) -> dict[str, str]:
    """{file name: text} of header and code of the model."""
    body = _code(valve)
    return {"valve_model.h": _header(valve, model_hash(valve)), "valve_model.c": body}


@functools.lru_cache(maxsize=8)
def model_hash(valve: TracedValve) -> str:
    """What tells this model from every other, by its equations and variables: 32 hexadecimal digits."""
    tables = repr((valve.parameters, valve.inputs, valve.states, valve.outputs, valve.scenario.tolerance))
    return hashlib.sha256("\0".join((_code(valve), tables)).encode()).hexdigest()[:32]


def _header(valve: TracedValve, digest: str) -> str:
    sizes = {
        "PARAMETERS": len(valve.parameters), "INPUTS": len(valve.inputs), "COUPLED": valve.coupled,
        "STATES": len(valve.states), "OUTPUTS": len(valve.outputs), "COEFFICIENTS": len(valve.coefficient_names),
        "PREPARED": valve.equations.coefficients,
        "FIRST_TEMPERATURE": valve.coefficient_names.index(f"{PART_NAMES[0]}_temperature"),
        "CLEARANCES": len(valve.clearances), "NODES": len(THERMAL_NODES), "LAGGED_PARTS": int(valve.lagged_parts),
        "USES_RATE": int(valve.uses_rate),
        "SETTLES": int(valve.settles),
    }  # fmt: skip
    lines = [
        "/* Printed by valvesim: sizes, names and functions of one valve's equations. */",
        "#ifndef VALVE_MODEL_H",
        "#define VALVE_MODEL_H",
        "",
        f'#define VALVE_HASH "{digest}"',
        f"#define VALVE_TOLERANCE {valve.scenario.tolerance!r}",
        *(f"#define VALVE_{name} {size}" for name, size in sizes.items()),
        "",
        "/* How valvesim's own integrator works: Rodas5P's figures and the options of its step control. */",
        *_integrator(),
        "",
        "/* Where each stands; inputs also by their place in the equations. */",
    ]
    for k, (one, channel) in enumerate(zip(valve.inputs, EXPORTED_INPUTS, strict=True)):
        lines.append(_define("INPUT", channel.name, k, one))
        if one.name != channel.name:
            lines.append(_define("INPUT", one.name, k, one))
    for kind, variables in (("STATE", valve.states), ("OUTPUT", valve.outputs), ("PARAMETER", valve.parameters)):
        lines += [_define(kind, one.name, k, one) for k, one in enumerate(variables)]
    ambient = next((k for k, one in enumerate(valve.parameters) if one.name == "thermal.ambient_temperature"), None)
    if ambient is not None:
        lines.append(f"#define VALVE_PARAMETER_AMBIENT {ambient}")
    lines += [
        "",
        "typedef struct {",
        "    const char *name, *unit;",
        "    double start; /* zero where the start works it out: not known */",
        "    int known;",
        "    double low, high, scale;",
        "} ValveVariable;",
        "",
        "extern const ValveVariable valve_parameter_table[VALVE_PARAMETERS];",
        "extern const ValveVariable valve_input_table[VALVE_INPUTS];",
        "extern const ValveVariable valve_state_table[VALVE_STATES];",
        "extern const ValveVariable valve_output_table[VALVE_OUTPUTS];",
        "extern const char *const valve_coefficient_names[VALVE_COEFFICIENTS];",
        "extern const int valve_clearances[VALVE_CLEARANCES];",
        "",
        *(f"{_signature(name)};" for name in ARGUMENTS),
        *(f"void valve_model_{name}({arguments});" for name, arguments in SOLVER_FUNCTIONS.items()),
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _integrator() -> list[str]:
    """The figures of the method and of the step control, from the modules that have them."""
    nodes = sorted({(k, float(rodas5p.NODES[stage])) for stage, k in enumerate(rodas5p.NODE_OF_STAGE) if stage})
    figures = {
        "STAGES": rodas5p.STAGES, "GAMMA": rodas5p.GAMMA, "NODES_OF_STEP": len(nodes), "FIRST_BEND": rodas5p.FIRST_BEND,
        "ABSOLUTE_SHARE": driver.ABSOLUTE_SHARE, "FIRST_STEP": driver.FIRST_STEP,
        "KNOT_ERROR": temperature_knots.KNOT_ERROR, "JUMP_TIME": run.JUMP_TIME,
    }  # fmt: skip
    shares = ", ".join(repr(node) for _, node in nodes)
    defined = [f"#define VALVE_{name} {value!r}" for name, value in figures.items()]
    return [*defined, f"#define VALVE_NODE_SHARES {{{shares}}}"]


def _define(kind: str, name: str, k: int, about: ValveVariable) -> str:
    return f"#define VALVE_{kind}_{name.upper().replace('.', '_')} {k} /* {about.unit}: {about.doc} */"


def _signature(name: str) -> str:
    arguments = ", ".join(f"const double {argument}[]" for argument in ARGUMENTS[name])
    return f"void valve_model_{name}({arguments}, double out[])"


@functools.lru_cache(maxsize=8)
def _code(valve: TracedValve) -> str:
    lines = [
        "/* Printed by valvesim: one valve's equations with their exact derivatives, and tables of its variables. */",
        '#include "valve_model.h"',
        "",
        "#include <math.h>",
        "",
        *(
            line
            for name, (arguments, value) in C_FUNCTIONS.items()
            for line in (f"static inline double {name}({arguments})", "{", f"    return {value};", "}", "")
        ),
    ]
    tables = {
        "parameter": valve.parameters, "input": valve.inputs, "state": valve.states, "output": valve.outputs,
    }  # fmt: skip
    for kind, variables in tables.items():
        size = f"VALVE_{kind.upper()}S"
        lines += [f"const ValveVariable valve_{kind}_table[{size}] = {{", *_rows(variables), "};", ""]
    names = ",\n    ".join(f'"{name}"' for name in valve.coefficient_names)
    lines += [f"const char *const valve_coefficient_names[VALVE_COEFFICIENTS] = {{\n    {names}}};", ""]
    clearances = ", ".join(str(k) for k in valve.clearances)
    lines += [f"const int valve_clearances[VALVE_CLEARANCES] = {{{clearances}}};", ""]
    for name in ARGUMENTS:
        function = valve.functions[name]
        lines += [*_function(name, function, [f"out[{k}]" for k in range(function.numel_out(0))]), "}", ""]
    factor, solve = print_elimination(valve.coupled, valve.equations.entries)
    factor = ["def factor(J, diagonal, W, pivots):", *(f"    {line}" for line in factor)]
    printed = [*valve.equations.lines, *factor, *rodas5p.print_step(valve.coupled, solve)]
    for name, body in _by_function(printed).items():
        if name in SOLVER_FUNCTIONS:
            lines += [f"void valve_model_{name}({SOLVER_FUNCTIONS[name]})", "{", *_c_lines(body), "}", ""]
    return "\n".join(lines)


def _by_function(lines: Iterable[str]) -> dict[str, list[str]]:
    """The bodies of printed Python functions by name, unindented."""
    found: dict[str, list[str]] = {}
    for line in lines:
        head = re.match(r"def (\w+)\(", line)
        if head:
            body = found.setdefault(head[1], [])
        else:
            body.append(line.strip())
    return found


def _c_lines(lines: Iterable[str]) -> list[str]:
    """Lines of arithmetic as C: the first assignment to a name declares it; what nothing uses is left out."""
    known, written = set(), []
    for line in _used(list(lines)):
        text = re.sub(r"(\w)\[(\d+), (\d+)\]", r"\1[\2][\3]", line)
        text = re.sub(r"\bnew\b", "new_y", re.sub(r"^rates\(", "valve_model_rates(", text))
        name = re.match(r"([A-Za-z]\w*) = ", text)
        declared = "" if name is None or name[1] in known else "double "
        if name is not None:
            known.add(name[1])
        written.append(f"    {declared}{text};")
    return written


def _used(lines: list[str]) -> list[str]:
    """The lines but for assignments to a name that no later line needs."""
    needed: set[str] = set()
    kept = []
    for line in reversed(lines):
        target, is_assigned, value = line.partition(" = ")
        if is_assigned and target.isidentifier() and target not in needed:
            continue
        needed |= set(re.findall(r"[A-Za-z_]\w*", value if is_assigned else line))
        kept.append(line)
    return kept[::-1]


def _rows(variables: Iterable[ValveVariable]) -> list[str]:
    rows = []
    for one in variables:
        known, start = int(one.start is not None), one.start or 0.0
        figures = ", ".join((_number(start), str(known), *map(_number, (one.low, one.high, one.scale))))
        rows.append(f'    {{"{one.name}", "{one.unit}", {figures}}},')
    return rows


def _number(value: float) -> str:
    if math.isinf(value):
        return "HUGE_VAL" if value > 0.0 else "-HUGE_VAL"
    return repr(float(value))


def _function(name: str, function: Any, targets: Sequence[str]) -> list[str]:
    """A CasADi function as C, without its last brace: each instruction one line, each work variable a local one."""
    import casadi

    operations, arguments = _operations(), ARGUMENTS[name]
    lines, used, touched = [], set(), set()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        into, of = function.instruction_output(k), function.instruction_input(k)
        if code == casadi.OP_CONST:
            text = f"w{into[0]} = {_number(function.instruction_constant(k))}"
        elif code == casadi.OP_INPUT:
            text = f"w{into[0]} = {arguments[of[0]]}[{of[1]}]"
            touched.add(arguments[of[0]])
        elif code == casadi.OP_OUTPUT:
            lines.append(f"    {targets[into[1]]} = w{of[0]};")
            continue
        elif code in operations:
            text = f"w{into[0]} = " + operations[code].format(*(f"w{k}" for k in of))
        else:
            raise InputError(f"the equations use an operation (CasADi's number {code}) that is not written as C")
        used.add(into[0])
        lines.append(f"    {text};")
    words = [f"w{k}" for k in sorted(used)]
    declared = [f"    double {', '.join(words[k : k + 14])};" for k in range(0, len(words), 14)]
    untouched = [f"    (void){argument};" for argument in arguments if argument not in touched]
    if not targets:
        untouched.append("    (void)out;")
    return [_signature(name), "{", *declared, *untouched, *lines]


C_FUNCTIONS = {
    name: (arguments, value)
    for name, arguments, value in (
        ("sign", "double a", "(a > 0.0) ? 1.0 : ((a < 0.0) ? -1.0 : 0.0)"),
        ("inverse_fourth_root", "double a", "1.0 / sqrt(sqrt(a))"),
        ("maximum", "double a, double b", "(a < b) ? b : a"),
        ("minimum", "double a, double b", "(b < a) ? b : a"),
        ("power", "double a, double b", "pow(a, b)"),
        ("where_true", "double condition, double value", "(condition != 0.0) ? value : 0.0"),
        ("less", "double a, double b", "(a < b) ? 1.0 : 0.0"),
        ("less_equal", "double a, double b", "(a <= b) ? 1.0 : 0.0"),
        ("logical_not", "double a", "(a == 0.0) ? 1.0 : 0.0"),
        ("logical_and", "double a, double b", "((a != 0.0) && (b != 0.0)) ? 1.0 : 0.0"),
        ("logical_or", "double a, double b", "((a != 0.0) || (b != 0.0)) ? 1.0 : 0.0"),
    )
}
"""What printed lines call (`solver.straight_line`) beside the functions of C: arguments and value in C."""
OF_C = ("sqrt", "exp", "log", "tanh", "sin", "cos", "fabs", "pow")


@functools.cache
def _operations() -> dict[int, str]:
    """How each CasADi operation is written in C."""
    import casadi

    return {
        casadi.OP_ASSIGN: "{0}", casadi.OP_ADD: "{0} + {1}", casadi.OP_SUB: "{0} - {1}", casadi.OP_MUL: "{0} * {1}",
        casadi.OP_DIV: "{0} / {1}", casadi.OP_NEG: "-{0}", casadi.OP_INV: "1.0 / {0}", casadi.OP_SQ: "{0} * {0}",
        casadi.OP_TWICE: "{0} + {0}", casadi.OP_SQRT: "sqrt({0})", casadi.OP_EXP: "exp({0})", casadi.OP_LOG: "log({0})",
        casadi.OP_LOG1P: "log1p({0})", casadi.OP_EXPM1: "expm1({0})", casadi.OP_POW: "pow({0}, {1})",
        casadi.OP_CONSTPOW: "pow({0}, {1})", casadi.OP_FABS: "fabs({0})", casadi.OP_SIGN: "sign({0})",
        casadi.OP_FMAX: "({0} > {1}) ? {0} : {1}", casadi.OP_FMIN: "({0} < {1}) ? {0} : {1}",
        casadi.OP_SIN: "sin({0})", casadi.OP_COS: "cos({0})", casadi.OP_TAN: "tan({0})", casadi.OP_TANH: "tanh({0})",
        casadi.OP_SINH: "sinh({0})", casadi.OP_COSH: "cosh({0})", casadi.OP_ATAN: "atan({0})",
        casadi.OP_ATAN2: "atan2({0}, {1})", casadi.OP_ASIN: "asin({0})", casadi.OP_ACOS: "acos({0})",
        casadi.OP_FLOOR: "floor({0})", casadi.OP_CEIL: "ceil({0})",
        casadi.OP_LT: "({0} < {1}) ? 1.0 : 0.0", casadi.OP_LE: "({0} <= {1}) ? 1.0 : 0.0",
        casadi.OP_EQ: "({0} == {1}) ? 1.0 : 0.0", casadi.OP_NE: "({0} != {1}) ? 1.0 : 0.0",
        casadi.OP_NOT: "({0} == 0.0) ? 1.0 : 0.0", casadi.OP_IF_ELSE_ZERO: "({0} != 0.0) ? {1} : 0.0",
        casadi.OP_AND: "(({0} != 0.0) && ({1} != 0.0)) ? 1.0 : 0.0",
        casadi.OP_OR: "(({0} != 0.0) || ({1} != 0.0)) ? 1.0 : 0.0",
    }  # fmt: skip
