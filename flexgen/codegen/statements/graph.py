"""The operations of a function as a graph without repetition, read from CasADi's instruction list.

Every value is computed once (``b + a`` counts as ``a + b``, and ``b - a`` as ``-(a - b)``), signs
are moved out of products, constants are folded. None of this changes a result by more than
rounding.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import casadi as ca

from flexgen.base.errors import BuildError

# Cycles of latency, about, for the order of a sum and the longest chain.
LATENCY = {
    "add": 4,
    "sub": 4,
    "mul": 4,
    "div": 14,
    "sqrt": 16,
    "exp": 50,
    "tanh": 60,
    "guarded": 2,
    "sin": 60,
    "cos": 60,
}
OTHER_LATENCY = 20

_UNARY = (
    "sqrt exp log expm1 log1p erf floor ceil fabs sin cos tan asin acos atan sinh cosh tanh "
    "asinh acosh atanh sign"
)
_BINARY = "fmin fmax fmod remainder copysign atan2 hypot pow lt le eq ne and or if_else_zero"
_NAMES: dict[int, str] = {
    **{getattr(ca, f"OP_{name.upper()}"): name for name in (*_UNARY.split(), *_BINARY.split())},
    ca.OP_NOT: "not",
    ca.OP_CONSTPOW: "pow",
}
_ODD = frozenset("sin tan asin atan sinh tanh asinh atanh erf sign".split())
_EVEN = frozenset("cos cosh fabs".split())

Reference = int  # 2 * node, plus 1 where its negative is meant


@dataclass
class Graph:
    """Operations by number, operands before their users.

    Parameters
    ----------
    kind : list of str
        ``"input"``, ``"constant"``, or the operation.
    operands : list of tuple of int
        References; of an input its array and entry.
    value : dict of int to float
        Of the constants, never negative.
    outputs : list of (int, int, int)
        Array, entry and reference of every stored result.
    """

    kind: list[str] = field(default_factory=list)
    operands: list[tuple[int, ...]] = field(default_factory=list)
    value: dict[int, float] = field(default_factory=dict)
    outputs: list[tuple[int, int, Reference]] = field(default_factory=list)
    _known: dict[tuple[object, ...], int] = field(default_factory=dict)
    depth: list[int] = field(default_factory=list)
    _arguments: list[tuple[int, ...]] = field(default_factory=list)

    # --- values ----------------------------------------------------------------------------------
    def _node(self, kind: str, operands: tuple[int, ...]) -> int:
        """Number of the operation ``kind`` on references (of an input: array and entry), with its
        latency; one that is known already gets no second number.
        """
        key = (kind, *operands)
        found = self._known.get(key)
        if found is None:
            found = len(self.kind)
            self._known[key] = found
            self.kind.append(kind)
            self.operands.append(operands)
            self._arguments.append(() if kind == "input" else tuple(r >> 1 for r in operands))
            below = (
                0 if kind == "input" else max((self.depth[r >> 1] for r in operands), default=0)
            )
            self.depth.append(below + (0 if kind == "input" else LATENCY.get(kind, OTHER_LATENCY)))
        return found

    def input(self, array: int, entry: int) -> Reference:
        """An entry of an input array."""
        return 2 * self._node("input", (array, entry))

    def constant(self, x: float) -> Reference:
        """A number; its sign is in the reference."""
        size = abs(x)
        key: tuple[object, ...] = ("constant", "nan" if math.isnan(x) else size)
        found = self._known.get(key)
        if found is None:
            found = len(self.kind)
            self._known[key] = found
            self.kind.append("constant")
            self.operands.append(())
            self._arguments.append(())
            self.depth.append(0)
            self.value[found] = size
        return 2 * found + (1 if x < 0 else 0)

    def number(self, r: Reference) -> float | None:
        """The value of a reference, or None where it is computed at run time."""
        x = self.value.get(r >> 1)
        return None if x is None else (-x if r & 1 else x)

    # --- arithmetic ------------------------------------------------------------------------------
    def add(self, a: Reference, b: Reference) -> Reference:
        """``a + b``; a difference is the sum with a negative."""
        x = self.number(a)
        y = self.number(b)
        if x is not None and y is not None:
            return self.constant(x + y)
        if x == 0.0:
            return b
        if y == 0.0:
            return a
        if a ^ b == 1:
            return self.constant(0.0)
        if a > b:
            a, b = b, a
        sign = a & 1
        if (a ^ b) & 1:
            return 2 * self._node("sub", (a ^ sign, (b ^ sign) ^ 1)) + sign
        return 2 * self._node("add", (a ^ sign, b ^ sign)) + sign

    def multiply(self, a: Reference, b: Reference) -> Reference:
        """``a b``: constants are multiplied now, zeros and ones vanish, signs go to the reference
        of the product.
        """
        x = self.number(a)
        y = self.number(b)
        if x is not None and y is not None:
            return self.constant(x * y)
        if y is not None:
            a, b = b, a
            x = y
        if x is not None:
            if x == 0.0:
                return self.constant(0.0)
            if abs(x) == 1.0:
                return b ^ (a & 1)
            if self.kind[b >> 1] == "mul":  # c (d e) = (c d) e
                first, rest = self.operands[b >> 1]
                z = self.number(first)
                if z is not None:
                    return self.multiply(self.constant(x * z), rest ^ (b & 1))
        sign = (a ^ b) & 1
        a = a & ~1
        b = b & ~1
        if x is None and a > b:
            a, b = b, a
        return 2 * self._node("mul", (a, b)) + sign

    def divide(self, a: Reference, b: Reference) -> Reference:
        """``a / b``."""
        x = self.number(a)
        y = self.number(b)
        if y is not None and y != 0.0 and math.isfinite(1.0 / y):
            return (
                self.constant(x / y) if x is not None else self.multiply(self.constant(1.0 / y), a)
            )
        if x == 0.0:
            return self.constant(0.0)
        return 2 * self._node("div", (a & ~1, b & ~1)) + ((a ^ b) & 1)

    def call(self, kind: str, operands: Sequence[Reference]) -> Reference:
        """The function ``kind`` of one or two values; signs of even and odd functions are taken
        out, and operands that can change places are sorted.
        """
        sign = 0
        if kind in _EVEN:
            operands = [operands[0] & ~1]
        elif kind in _ODD:
            sign = operands[0] & 1
            operands = [operands[0] ^ sign]
        elif kind == "if_else_zero":
            sign = operands[1] & 1
            operands = [operands[0], operands[1] ^ sign]
        elif kind == "pow" and self.number(operands[1]) == 2.0:
            return self.multiply(operands[0], operands[0])
        elif kind in ("fmin", "fmax", "and", "or", "eq", "ne"):
            operands = sorted(operands)
        if kind in ("sin", "cos") and self.number(operands[0]) is not None:
            x = self.value[operands[0] >> 1]
            return self.constant(math.sin(x) if kind == "sin" else math.cos(x)) ^ sign
        return 2 * self._node(kind, tuple(operands)) + sign

    # --- queries----------------------------------------------------------------------------------
    def arguments(self, node: int) -> tuple[int, ...]:
        """Nodes that a node is computed from."""
        return self._arguments[node]

    def alive(self) -> list[bool]:
        """Which nodes the outputs depend on."""
        needed = [False] * len(self.kind)
        for _, _, r in self.outputs:
            needed[r >> 1] = True
        for node in range(len(self.kind) - 1, -1, -1):
            if needed[node]:
                for other in self._arguments[node]:
                    needed[other] = True
        return needed

    def find_carriers(self, arrays: Collection[int]) -> set[int]:
        """Nodes that make an entry of the given output arrays NaN or infinite whenever they are so
        themselves.

        Sums, products, dividends, roots and sines carry it; a comparison, a divisor or an
        exponential may hide it.
        """
        out = {r >> 1 for array, _, r in self.outputs if array in arrays}
        for node in range(len(self.kind) - 1, -1, -1):
            if node in out:
                kind = self.kind[node]
                if kind in ("add", "sub", "mul", "sqrt", "fabs", "sin", "cos"):
                    out.update(self.arguments(node))
                elif kind in ("div", "guarded"):
                    out.add(self.operands[node][0] >> 1)
        return out

    def operations(self) -> int:
        """Arithmetic operations and function calls that the outputs need."""
        return self._count(("input", "constant"))

    def calls(self) -> int:
        """Function calls that the outputs need."""
        return self._count(("input", "constant", "add", "sub", "mul", "div"))

    def _count(self, without: tuple[str, ...]) -> int:
        return sum(
            used and kind not in without
            for kind, used in zip(self.kind, self.alive(), strict=True)
        )


def read_graph(function: ca.Function) -> Graph:  # noqa: C901
    """The graph of an SX function; BuildError names an operation that cannot be written."""
    graph = Graph()
    register: dict[int, Reference] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        target = function.instruction_output(k)
        if operation == ca.OP_CONST:
            register[target[0]] = graph.constant(function.instruction_constant(k))
            continue
        source = function.instruction_input(k)
        if operation == ca.OP_INPUT:
            register[target[0]] = graph.input(source[0], source[1])
            continue
        a = register[source[0]]
        if operation == ca.OP_OUTPUT:
            graph.outputs.append((target[0], target[1], a))
            continue
        b = register[source[1]] if len(source) > 1 else a
        if operation == ca.OP_ADD:
            out = graph.add(a, b)
        elif operation == ca.OP_SUB:
            out = graph.add(a, b ^ 1)
        elif operation == ca.OP_MUL:
            out = graph.multiply(a, b)
        elif operation == ca.OP_DIV:
            out = graph.divide(a, b)
        elif operation == ca.OP_NEG:
            out = a ^ 1
        elif operation == ca.OP_SQ:
            out = graph.multiply(a, a)
        elif operation == ca.OP_TWICE:
            out = graph.multiply(graph.constant(2.0), a)
        elif operation == ca.OP_INV:
            out = graph.divide(graph.constant(1.0), a)
        elif operation in (ca.OP_ASSIGN, ca.OP_LIFT):
            out = a
        elif operation in _NAMES:
            out = graph.call(_NAMES[operation], [register[r] for r in source])
        else:
            raise BuildError(
                f"function {function.name()}: {_operation_name(operation)} cannot be written in C"
            )
        register[target[0]] = out
    return graph


def _operation_name(operation: int) -> str:
    """Name of an operation in CasADi's table, such as ``OP_ERFINV``."""
    names = [name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == operation]
    return f"operation {names[0] if names else operation}"


def copy_node(graph: Graph, new: Graph, node: int, to: dict[int, Reference]) -> Reference:
    """A node copied to a new graph that already has its operands."""
    kind = graph.kind[node]
    if kind == "input":
        return new.input(*graph.operands[node])
    if kind == "constant":
        return new.constant(graph.value[node])
    operands = [to[r >> 1] ^ (r & 1) for r in graph.operands[node]]
    if kind == "add":
        return new.add(operands[0], operands[1])
    if kind == "sub":
        return new.add(operands[0], operands[1] ^ 1)
    if kind == "mul":
        return new.multiply(operands[0], operands[1])
    if kind == "div":
        return new.divide(operands[0], operands[1])
    return new.call(kind, operands)
