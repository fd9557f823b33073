"""The equations rewritten so that a step of the integrator computes each part once, and least of it on the states.

A quantity is kept as a linear form, sum of number x coefficient x product, where coefficients are what the states and
inputs have no part in and products are what they have. So what depends on coefficients alone is gathered and can be
computed ahead (`prepare`), divisions by it become products, terms that cancel are gone (the sum of two air gaps has no
angle in it), and equal parts are one part. The value is the same but for rounding.

A node is a part of the equations that is computed once, told by a number: 0 is the number one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

ONE = 0
Form = dict[tuple[int, int], float]
"""Factors by (coefficient, product), both nodes."""


class Expressions:
    """Nodes of the equations, each held once, and the algebra of linear forms of them."""

    def __init__(self) -> None:
        self.nodes: list[tuple] = [("one",)]
        self.varies: list[bool] = [False]
        self._known: dict[tuple, int] = {("one",): ONE}

    def node(self, *key: Any, varies: bool) -> int:
        """The node of a key (kind, operands ...)."""
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(key)
            self.varies.append(varies)
        return self._known[key]

    def variable(self, text: str, *, varies: bool) -> Form:
        """A state or input, which varies, or a coefficient, by how it is written."""
        return self._form(self.node("variable", text, varies=varies))

    def _form(self, node: int) -> Form:
        return {(ONE, node) if self.varies[node] else (node, ONE): 1.0}

    # ------------------------------------------------------------ algebra

    def add(self, a: Form, b: Form, sign: float = 1.0) -> Form:
        """a + sign b."""
        total = dict(a)
        for pair, number in b.items():
            total[pair] = total.get(pair, 0.0) + sign * number
            if total[pair] == 0.0:
                del total[pair]
        return total

    def multiply(self, a: Form, b: Form) -> Form:
        """a b: a coefficient goes to every term of the other; of two sums that vary each becomes one node."""
        if not a or not b:
            return {}
        a, b = self._single_coefficient(a), self._single_coefficient(b)
        if len(a) > 1 and any(product != ONE for _, product in b):
            a = self._form(self.collect(a))
        if len(b) > 1 and any(product != ONE for _, product in a):
            b = self._form(self.collect(b))
        total: Form = {}
        for (k, r), number in a.items():
            for (other_k, other_r), other in b.items():
                pair = self._product(k, other_k), self._product(r, other_r)
                total = self.add(total, {pair: number * other})
        return total

    def divide(self, a: Form, b: Form) -> Form:
        """a / b."""
        return self.multiply(a, self.reciprocal(b))

    def reciprocal(self, a: Form) -> Form:
        """1 / a."""
        ((k, r), number), *more = a.items() if a else [((ONE, ONE), 0.0)]
        if more:
            return self._form(self._inverse(self.collect(a)))
        if number == 0.0:
            return {(ONE, ONE): float("inf")}
        return {(self._inverse(k), self._inverse(r)): 1.0 / number}

    def call(self, name: str, *arguments: Form) -> Form:
        """A function of some quantities."""
        of = tuple(self.collect(a) for a in arguments)
        return self._form(self.node("call", name, *of, varies=any(self.varies[k] for k in of)))

    def collect(self, a: Form) -> int:
        """The node of a linear form, which is computed once."""
        if len(a) == 1:
            (((k, r), number),) = a.items()
            if number == 1.0:
                return self._product(k, r)
        if all(r == ONE for _, r in a):
            return self.node("sum", *sorted((ONE, k, number) for (k, _), number in a.items()), varies=False)
        coefficients: dict[int, Form] = {}
        for (k, r), number in a.items():
            coefficients.setdefault(r, {})[k, ONE] = number
        terms = [(r, *self._factor(of)) for r, of in sorted(coefficients.items())]
        return self.node("sum", *terms, varies=True)

    def _factor(self, a: Form) -> tuple[int, float]:
        """A sum of coefficients as one and a number."""
        if len(a) > 1:
            return self.collect(a), 1.0
        (((k, _), number),) = a.items()
        return k, number

    def _single_coefficient(self, a: Form) -> Form:
        """A sum of coefficients as one."""
        return self._form(self.collect(a)) if len(a) > 1 and all(r == ONE for _, r in a) else a

    def _product(self, a: int, b: int) -> int:
        if ONE in (a, b):
            return a + b
        return self.node("product", *sorted((a, b)), varies=self.varies[a] or self.varies[b])

    def _inverse(self, a: int) -> int:
        if a == ONE:
            return a
        kind, *of = self.nodes[a]
        if kind == "inverse":
            return of[0]
        varies = self.varies[a]
        if (inner := self._under_root(a)) and (innermost := self._under_root(inner)):
            return self.node("call", "inverse_fourth_root", innermost, varies=varies)
        root = self._known.get(("call", "sqrt", a))
        if root is not None:  # which is inverted anyway, or costs as much
            inverse = self._inverse(root)
            return self._product(inverse, inverse)
        return self.node("inverse", a, varies=varies)

    def _under_root(self, a: int) -> int:
        """What a node is the square root of; 0 for others."""
        kind, *of = self.nodes[a]
        return of[1] if kind == "call" and of[0] == "sqrt" else 0

    # ------------------------------------------------------------ from a traced function

    def of_symbols(self, arguments: dict[str, Any], outputs: Any, *, constant: Sequence[str]) -> list[Form]:
        """The forms of a vector of CasADi expressions; `arguments` are its symbols by name, some of them `constant`."""
        import casadi

        function = casadi.Function("traced", list(arguments.values()), [outputs])
        given = [
            [self.variable(f"{name}[{k}]", varies=name not in constant) for k in range(symbol.shape[0])]
            for name, symbol in arguments.items()
        ]
        work: dict[int, Form] = {}
        found: dict[int, Form] = {}
        calls = _calls(casadi)
        algebra: dict[int, Callable[..., Form]] = {
            casadi.OP_ASSIGN: lambda a: a,
            casadi.OP_ADD: self.add,
            casadi.OP_SUB: lambda a, b: self.add(a, b, -1.0),
            casadi.OP_NEG: lambda a: self.add({}, a, -1.0),
            casadi.OP_TWICE: lambda a: self.add(a, a),
            casadi.OP_MUL: self.multiply,
            casadi.OP_SQ: lambda a: self.multiply(a, a),
            casadi.OP_DIV: self.divide,
            casadi.OP_INV: self.reciprocal,
        }
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            into, of = function.instruction_output(k), function.instruction_input(k)
            if code == casadi.OP_CONST:
                number = function.instruction_constant(k)
                work[into[0]] = {(ONE, ONE): number} if number else {}
            elif code == casadi.OP_INPUT:
                work[into[0]] = given[of[0]][of[1]]
            elif code == casadi.OP_OUTPUT:
                found[into[1]] = work[of[0]]
            elif code in algebra:
                work[into[0]] = algebra[code](*(work[k] for k in of))
            else:
                work[into[0]] = self.call(calls[code], *(work[k] for k in of))
        return [found.get(k, {}) for k in range(function.nnz_out(0))]

    # ------------------------------------------------------------ as text

    def lines(self, targets: dict[str, Form], prepared: dict[tuple[int, float], int] | None = None) -> list[str]:
        """The lines that compute some forms, indented; `targets` by what they are assigned to.

        Where `prepared` is given, coefficients are not computed but taken from `c`: it is filled with the places there
        by (node, number), of their product.
        """

        def factor(k: int, number: float) -> tuple[float, str]:
            sign, size = (-1.0, -number) if number < 0.0 else (1.0, number)
            if k == ONE:
                return sign, "" if size == 1.0 else _literal(size)
            if prepared is not None:
                return sign, f"c[{prepared.setdefault((k, size), len(prepared))}]"
            return sign, name(k) if size == 1.0 else f"{_literal(size)} * {name(k)}"

        def name(k: int) -> str:
            kind, *of = self.nodes[k]
            if kind == "sum" and all(c == ONE == r for r, c, _ in of):  # a number
                return _literal(of[0][2]) if of else "0.0"
            if not self.varies[k] and prepared is not None:
                return factor(k, 1.0)[1] or "1.0"
            return {"one": "1.0", "variable": of[0] if of else ""}.get(kind, f"w{k}")

        nodes = {target: self.collect(form) for target, form in targets.items()}
        computed = [k for k in self._needed(nodes.values()) if self.nodes[k][0] not in ("one", "variable")]
        text = [f"w{k} = {self._text(k, name, factor)}" for k in computed if self.varies[k] or prepared is None]
        text += [f"{target} = {name(k)}" for target, k in nodes.items()]
        return [f"    {line}" for line in text or ["pass"]]

    def _needed(self, roots: Iterable[int]) -> list[int]:
        """The nodes that some nodes are computed from, in the order in which they can be."""
        found: set[int] = set()
        left = list(roots)
        while left:
            node = left.pop()
            if node not in found:
                found.add(node)
                left += self._operands(node)
        return sorted(found)  # a node is made after its operands

    def _operands(self, node: int) -> list[int]:
        """The nodes that a node is computed from at once."""
        kind, *of = self.nodes[node]
        if kind == "sum":
            return [k for r, c, _ in of for k in (r, c)]
        return {"one": [], "variable": []}.get(kind, of[1:] if kind == "call" else of)

    def _text(self, node: int, name: Callable[[int], str], factor: Callable[[int, float], tuple[float, str]]) -> str:
        """How a node is computed: `name` of an operand, `factor` (sign, text) of a coefficient and a number."""
        kind, *of = self.nodes[node]
        if kind == "variable":
            return of[0]
        if kind == "product":
            return f"{name(of[0])} * {name(of[1])}"
        if kind == "inverse":
            return f"1.0 / {name(of[0])}"
        if kind == "call":
            return f"{of[0]}({', '.join(name(k) for k in of[1:])})"
        if kind == "one":
            return "1.0"
        return self._sum(of, name, factor)

    def _sum(self, terms: Sequence, name: Callable, factor: Callable) -> str:
        """Products with coefficients, those that are known first in front."""
        text = ""
        for product, k, number in terms:
            sign, scale = factor(k, number)
            one = " * ".join(x for x in (scale, "" if product == ONE else name(product)) if x) or "1.0"
            text += (" - " if sign < 0 else " + ") + one if text else ("-" if sign < 0 else "") + one
        return text or "0.0"


def _literal(number: float) -> str:
    """A number as Python reads it."""
    return repr(number).replace("inf", "1e999").replace("nan", "(1e999 - 1e999)")


def _calls(casadi: Any) -> dict[int, str]:
    """Functions by the operation of CasADi, with the names that `straight_line` knows."""
    return {
        casadi.OP_SQRT: "sqrt", casadi.OP_EXP: "exp", casadi.OP_LOG: "log", casadi.OP_POW: "power",
        casadi.OP_CONSTPOW: "power", casadi.OP_FABS: "fabs", casadi.OP_SIGN: "sign", casadi.OP_FMAX: "maximum",
        casadi.OP_FMIN: "minimum", casadi.OP_TANH: "tanh", casadi.OP_SIN: "sin", casadi.OP_COS: "cos",
        casadi.OP_LT: "less", casadi.OP_LE: "less_equal", casadi.OP_NOT: "logical_not",
        casadi.OP_IF_ELSE_ZERO: "where_true", casadi.OP_AND: "logical_and", casadi.OP_OR: "logical_or",
    }  # fmt: skip
