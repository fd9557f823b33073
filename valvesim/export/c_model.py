"""`valve_model.h` and `valve_model.c`: the traced valve printed as C, instruction by instruction, with its tables."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.export.traced_valve import INPUTS, TracedValve, Variable, node_names
from valvesim.simulation import driver, run, temperature_knots
from valvesim.solver import rodas5p
from valvesim.solver.elimination import print_elimination
from valvesim.valve.coefficients import PART_NAMES

ARGUMENTS = {
    "coefficients": ("p", "T", "u"),
    "pilot_oil": ("p", "u"),
    "thermal_rates": ("p", "s"),
    "derivative": ("y", "u", "c", "p"),
    "jacobian": ("y", "u", "c", "p"),
    "outputs": ("x", "u", "c", "p"),
    "forward": ("z", "u", "p", "dz", "du", "dp"),
    "adjoint": ("z", "u", "p", "d"),
    "rest_surplus_1": ("q", "u", "c"),
    "rest_surplus_2": ("q", "u", "c"),
    "rest_guess": ("q", "u", "c"),
    "rest_balance": ("q", "u", "c"),
    "rest_current": ("u", "c"),
}
"""The printed functions, each `valve_model_NAME(arguments..., out)`, and what their arguments are called."""


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
        "FIRST_TEMPERATURE": len(valve.coefficient_names) - len(PART_NAMES), "CLEARANCES": len(valve.clearances),
        "NODES": len(node_names()), "LAGGED_PARTS": int(valve.lagged_parts), "USES_RATE": int(valve.uses_rate),
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
    for k, (one, channel) in enumerate(zip(valve.inputs, INPUTS, strict=True)):
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
        "int valve_model_factor(double W[VALVE_COUPLED][VALVE_COUPLED]);",
        "void valve_model_substitute(double W[VALVE_COUPLED][VALVE_COUPLED], double x[VALVE_COUPLED]);",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def _integrator() -> list[str]:
    """The figures of the method and of the step control, from the modules that have them."""

    def array(values: Any) -> str:
        inner = (array(value) if np.ndim(value) else repr(float(value)) for value in values)
        return "{" + ", ".join(inner) + "}"

    stages = rodas5p.STAGES
    square = np.zeros((2, stages, stages))
    square[0, :, : rodas5p.A.shape[1]], square[1, :, : rodas5p.C.shape[1]] = rodas5p.A, rodas5p.C
    d = np.append(rodas5p.D, np.zeros(stages - len(rodas5p.D)))
    figures = {
        "TABLEAU_STAGES": stages, "TABLEAU_GAMMA": rodas5p.GAMMA, "TABLEAU_A": square[0], "TABLEAU_C": square[1],
        "TABLEAU_NODES": rodas5p.NODES, "TABLEAU_D": d, "RATE_SPAN": rodas5p.RATE_SPAN,
        "FIRST_BEND": rodas5p.FIRST_BEND, "ABSOLUTE_SHARE": driver.ABSOLUTE_SHARE, "FIRST_STEP": driver.FIRST_STEP,
        "KNOT_ERROR": temperature_knots.KNOT_ERROR, "JUMP_TIME": run.JUMP_TIME,
    }  # fmt: skip
    return [
        f"#define VALVE_{name} {array(value) if np.ndim(value) else repr(value)}" for name, value in figures.items()
    ]


def _define(kind: str, name: str, k: int, about: Variable) -> str:
    return f"#define VALVE_{kind}_{name.upper().replace('.', '_')} {k} /* {about.unit}: {about.doc} */"


def _signature(name: str) -> str:
    if name == "jacobian":
        return "void valve_model_jacobian(const double y[], const double u[], const double c[], const double p[],\n" + (
            "                          double out[VALVE_COUPLED][VALVE_COUPLED])"
        )
    arguments = ", ".join(f"const double {argument}[]" for argument in ARGUMENTS[name])
    return f"void valve_model_{name}({arguments}, double out[])"


@functools.lru_cache(maxsize=8)
def _code(valve: TracedValve) -> str:
    n, pattern = valve.coupled, valve.functions["pattern"]
    lines = [
        "/* Printed by valvesim: one valve's equations with their exact derivatives, and tables of its variables. */",
        '#include "valve_model.h"',
        "",
        "#include <math.h>",
        "",
        "static double sign(double a)",
        "{",
        "    return (a > 0.0) ? 1.0 : ((a < 0.0) ? -1.0 : 0.0);",
        "}",
        "",
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
        count = function.numel_out(0)
        targets, zeros = [f"out[{k}]" for k in range(count)], []
        if name == "jacobian":
            targets = [f"out[{i}][{j}]" for i, j in pattern]
            zeros = [(i, j) for i in range(n) for j in range(n) if (i, j) not in set(pattern)]
        lines += [*_function(name, function, targets), *(f"    out[{i}][{j}] = 0.0;" for i, j in zeros), "}", ""]
    lines += _solver(*print_elimination(n, pattern))
    return "\n".join(lines)


def _rows(variables: Iterable[Variable]) -> list[str]:
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


def _solver(factor: Sequence[str], back_substitute: Sequence[str]) -> list[str]:
    """The two functions of the linear systems, from their Python lines."""

    def c_line(text: str) -> str:
        return "    " + text.replace(", ", "][") + ";"

    first = "int valve_model_factor(double W[VALVE_COUPLED][VALVE_COUPLED])"
    second = "void valve_model_substitute(double W[VALVE_COUPLED][VALVE_COUPLED], double x[VALVE_COUPLED])"
    body = [c_line(line) for line in factor[1:-1]]
    return [
        first, "{", "    double pivots = 0.0, pivot, ratio;", *body, "    return isfinite(pivots) ? 1 : 0;", "}", "",
        second, "{", *(c_line(line) for line in back_substitute), "}", "",
    ]  # fmt: skip


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
