"""Printed functions without loops or branches as machine code: each line acts on all lanes of a processor's vector.

A printed function is Python on arrays whose last axis are the lanes, a valve each: `w3 = w1 * y[2] + c[4]`. Run by
Python it is numpy. In compiled code each operation becomes one instruction of LLVM on a vector, past numba's own
passes, which take seconds over hundreds of lines.

A line is `name = expression`, `array[row] = expression`, `array[row, column] = expression`, or a call of another
printed function with arrays and rows of arrays. Expressions are arithmetic and the functions of `FUNCTIONS`; a truth is
the number one.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_OF_LLVM = ("sqrt", "exp", "log", "tanh", "sin", "cos", "fabs")
_TRUTHS = ("less", "less_equal", "logical_not", "logical_and", "logical_or")
FUNCTIONS: dict[str, Any] = {
    **{name: getattr(np, name) for name in (*_OF_LLVM, *_TRUTHS, "maximum", "minimum", "sign", "power")},
    "inverse_fourth_root": lambda value: 1.0 / np.sqrt(np.sqrt(value)),
    "where_true": lambda condition, value: np.where(np.not_equal(condition, 0.0), value, 0.0),
}
"""What a printed function may call, as numpy has it."""

FLAGS = ("contract", "nsz", "arcp")  # a product may be added without rounding, -0 is 0, a division may be a product
SYMBOL = "valvesim_"  # before the name of a printed function in machine code
ALIGNMENT = 8  # bytes, of numpy's arrays
FOURTH_ROOT = 0x4FEB028F5C28F800  # less a quarter of a double's bits: those of its inverse fourth root to 3 %


def as_python(lines: Sequence[str], **more: Callable) -> dict[str, Callable]:
    """The functions of some printed lines, run by Python; `more` are functions that they call."""
    names: dict[str, Any] = FUNCTIONS | more
    text = "\n".join(lines)
    exec(text, names)
    return {name: names[name] for name in function_names(text)}


def write_functions(
    text: str, module: Any, *, lanes: int, columns: dict[str, int], shared: Sequence[str], numbers: Sequence[str]
) -> None:
    """Write the functions of a printed text into a module of LLVM, to be called from outside by `SYMBOL` and name.

    `columns` has those of each array that is written with two indices or of which a row is handed on; `shared` names
    the arrays without lanes, and `numbers` the arguments that are no arrays.
    """
    from llvmlite import ir

    program = _Program(_trees(text), lanes, columns, frozenset(shared))
    number = ir.DoubleType()
    for name, tree in program.trees.items():
        kinds = [number if argument.arg in numbers else number.as_pointer() for argument in tree.args.args]
        program.function(name, module, kinds)


def _trees(text: str) -> dict[str, ast.FunctionDef]:
    """The functions of a printed text by name."""
    return {tree.name: tree for tree in ast.parse(text).body if isinstance(tree, ast.FunctionDef)}


def function_names(text: str) -> list[str]:
    """The names of the functions of a printed text."""
    return [line[4:].partition("(")[0] for line in text.splitlines() if line.startswith("def ")]


@dataclass(frozen=True)
class _Program:
    """The functions of a printed text on their way to LLVM."""

    trees: dict[str, ast.FunctionDef]
    lanes: int
    columns: dict[str, int]
    shared: frozenset[str]

    def function(self, name: str, module: Any, kinds: Sequence[Any]) -> Any:
        """A function in a module of LLVM, made there once, of pointers and numbers."""
        from llvmlite import ir
        from numba.core import cgutils

        kind = ir.FunctionType(ir.VoidType(), kinds)
        function = cgutils.get_or_insert_function(module, kind, SYMBOL + name)
        if function.is_declaration:
            tree = self.trees[name]
            builder = ir.IRBuilder(function.append_basic_block())
            for value in function.args:
                if isinstance(value.type, ir.PointerType):
                    value.add_attribute("noalias")
            arguments = dict(zip((argument.arg for argument in tree.args.args), function.args, strict=True))
            _Lines(self, builder, arguments).write(tree.body)
            builder.ret_void()
        return function


class _Lines:
    """The lines of one function as instructions; `known` are names and elements of arrays that have a value."""

    def __init__(self, program: _Program, builder: Any, arguments: dict[str, Any]):
        from llvmlite import ir

        self.program, self.builder, self.arguments, self.ir = program, builder, arguments, ir
        self.number = ir.DoubleType()
        self.vector = ir.VectorType(self.number, program.lanes) if program.lanes > 1 else self.number
        self.known: dict[Any, Any] = {}
        self.operators = {ast.Add: builder.fadd, ast.Sub: builder.fsub, ast.Mult: builder.fmul, ast.Div: builder.fdiv}

    def write(self, body: Sequence[ast.stmt]) -> None:
        """All lines. Arrays are written last, or before another function reads them, so that no load waits."""
        unwritten: dict[tuple[str, int], Any] = {}
        for line in body:
            if isinstance(line, ast.Assign):
                (target,) = line.targets
                place: Any = target.id if isinstance(target, ast.Name) else self._place(target)
                self.known[place] = self._value(line.value)
                if isinstance(place, tuple):
                    unwritten[place] = self.known[place]
            elif isinstance(line, ast.Expr):
                self._store(unwritten)
                self._call_printed(line.value)
        self._store(unwritten)

    def _store(self, unwritten: dict[tuple[str, int], Any]) -> None:
        for place, value in unwritten.items():
            self.builder.store(value, self._vectors(self._pointer(*place)), align=ALIGNMENT)
        unwritten.clear()

    def _call_printed(self, node: Any) -> None:
        """Another printed function, which may write to its arguments."""
        pointers = []
        for argument in node.args:
            name, row = self._place(argument) if isinstance(argument, ast.Subscript) else (ast.unparse(argument), 0)
            pointers.append(self._pointer(name, row * self.program.columns.get(name, 0)))
            self.known = {place: value for place, value in self.known.items() if place[0] != name}
        kinds = [pointer.type for pointer in pointers]
        function = self.program.function(ast.unparse(node.func), self.builder.module, kinds)
        self.builder.call(function, pointers)

    def _value(self, node: Any) -> Any:
        """The value of an expression."""
        if isinstance(node, ast.Constant):
            return self._constant(float(ast.unparse(node)))
        if isinstance(node, ast.Name):
            return self.known[node.id] if node.id in self.known else self._in_all_lanes(self.arguments[node.id])
        if isinstance(node, ast.Subscript):
            place = self._place(node)
            if place not in self.known:
                self.known[place] = self._load(*place)
            return self.known[place]
        if isinstance(node, ast.UnaryOp):
            return self.builder.fneg(self._value(node.operand), flags=FLAGS)
        if isinstance(node, ast.BinOp):
            return self.operators[type(node.op)](self._value(node.left), self._value(node.right), flags=FLAGS)
        return self._call(ast.unparse(node.func), [self._value(argument) for argument in node.args])

    def _place(self, node: Any) -> tuple[str, int]:
        """(array, row) of an element; the rows of three axes are counted through."""
        name, index = ast.unparse(node.value), ast.literal_eval(node.slice)
        return name, index[0] * self.program.columns[name] + index[1] if isinstance(index, tuple) else index

    def _pointer(self, name: str, row: int) -> Any:
        index = row if name in self.program.shared else row * self.program.lanes
        return self.builder.gep(self.arguments[name], [self.ir.IntType(64)(index)])

    def _load(self, name: str, row: int) -> Any:
        pointer = self._pointer(name, row)
        if name in self.program.shared:
            return self._in_all_lanes(self.builder.load(pointer))
        return self.builder.load(self._vectors(pointer), align=ALIGNMENT)

    def _vectors(self, pointer: Any) -> Any:
        """A pointer to numbers as one to vectors."""
        return self.builder.bitcast(pointer, self.vector.as_pointer())

    def _constant(self, value: float) -> Any:
        one = self.ir.Constant(self.number, value)
        return one if self.vector == self.number else self.ir.Constant(self.vector, [one] * self.program.lanes)

    def _in_all_lanes(self, value: Any) -> Any:
        if self.vector == self.number:
            return value
        vector = self.ir.Constant(self.vector, self.ir.Undefined)
        for lane in range(self.program.lanes):
            vector = self.builder.insert_element(vector, value, self.ir.IntType(32)(lane))
        return vector

    def _inverse_fourth_root(self, value: Any) -> Any:
        """s^(-1/4) of positive s, to rounding. For vectors without roots and divisions, of which they have few a time.

        Two steps of fourth order from an approximation by the bits: y + y d (1/4 + d (5/32 + d 15/128)), d = 1 - s y^4.
        """
        b, one = self.builder, self._constant(1.0)
        if self.vector == self.number:
            return b.fdiv(one, self._call("sqrt", [self._call("sqrt", [value])]), flags=FLAGS)
        bits = self.ir.VectorType(self.ir.IntType(64), self.program.lanes)
        whole, two = (self.ir.Constant(bits, [number] * self.program.lanes) for number in (FOURTH_ROOT, 2))
        y = b.bitcast(b.sub(whole, b.lshr(b.bitcast(value, bits), two)), self.vector)
        for _ in range(2):
            square = b.fmul(y, y, flags=FLAGS)
            d = b.fsub(one, b.fmul(value, b.fmul(square, square, flags=FLAGS), flags=FLAGS), flags=FLAGS)
            series = self._constant(15 / 128)
            for factor in (5 / 32, 1 / 4):
                series = b.fadd(b.fmul(series, d, flags=FLAGS), self._constant(factor), flags=FLAGS)
            y = b.fadd(b.fmul(b.fmul(y, d, flags=FLAGS), series, flags=FLAGS), y, flags=FLAGS)
        return y

    def _of_llvm(self, name: str, arguments: int) -> Any:
        """A function that LLVM has for vectors."""
        from numba.core import cgutils

        suffix = "f64" if self.vector == self.number else f"v{self.program.lanes}f64"
        kind = self.ir.FunctionType(self.vector, [self.vector] * arguments)
        return cgutils.get_or_insert_function(self.builder.module, kind, f"llvm.{name}.{suffix}")

    def _call(self, name: str, values: list[Any]) -> Any:
        """A function of `FUNCTIONS`."""
        b, zero, one = self.builder, self._constant(0.0), self._constant(1.0)
        if name in _OF_LLVM or name == "power":
            return b.call(self._of_llvm("pow" if name == "power" else name, len(values)), values, fastmath=FLAGS)
        if name == "inverse_fourth_root":
            return self._inverse_fourth_root(values[0])
        if name in ("maximum", "minimum"):
            return b.select(b.fcmp_ordered(">" if name == "maximum" else "<", *values), *values)
        if name == "where_true":
            return b.select(b.fcmp_unordered("!=", values[0], zero), values[1], zero)
        if name == "sign":
            above, below = (b.fcmp_ordered(relation, values[0], zero) for relation in "><")
            return b.select(above, one, b.select(below, self._constant(-1.0), zero))
        if name in ("less", "less_equal"):
            return b.select(b.fcmp_ordered("<" if name == "less" else "<=", *values), one, zero)
        truths = [b.fcmp_unordered("!=", value, zero) for value in values]
        return b.select({"logical_not": b.not_, "logical_and": b.and_, "logical_or": b.or_}[name](*truths), one, zero)
