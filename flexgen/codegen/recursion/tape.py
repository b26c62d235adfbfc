"""Scalar arithmetic with constant folding and sharing of equal operations: the cost of a recursion
is known beforehand.

A value is a Python float, or a `Value`: a signed reference to an operation on a `Tape`. Zeros and
ones cost nothing, signs move through products and sums, equal operations are shared. A tape counts
what its results need, and becomes CasADi graphs at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import casadi as ca

_ARITHMETIC = frozenset(("+", "-", "*", "+c", "*c", "/"))


class Value:
    """A value on a tape, or its negative; immutable."""

    __slots__ = ("negative", "node", "tape")

    def __init__(self, tape: Tape, node: int, negative: bool = False) -> None:
        self.tape = tape
        self.node = node
        self.negative = negative

    def __neg__(self) -> Value:
        return Value(self.tape, self.node, not self.negative)

    def __add__(self, other: Scalar) -> Scalar:
        if not isinstance(other, Value):
            return self.tape.add_constant(self, other)
        if self.negative == other.negative:
            return self.tape.sum(self.node, other.node, self.negative)
        return self.tape.difference(self.node, other.node, self.negative)

    def __radd__(self, other: float) -> Scalar:
        return self.tape.add_constant(self, other)

    def __sub__(self, other: Scalar) -> Scalar:
        return self + (-other)

    def __rsub__(self, other: float) -> Scalar:
        return (-self) + other

    def __mul__(self, other: Scalar) -> Scalar:
        if not isinstance(other, Value):
            return self.tape.multiply_constant(self, other)
        return self.tape.product(self.node, other.node, self.negative != other.negative)

    def __rmul__(self, other: float) -> Scalar:
        return self.tape.multiply_constant(self, other)


Scalar = Value | float
# the angle of a rotation, the derivative in it, and the factors of the other two operands
_Rotation = tuple[int, Scalar, tuple[tuple[Value, int], ...]]


class Tape:
    """A list of operations without repetition; operands stand before their users."""

    def __init__(self) -> None:
        self.operations: list[tuple[str, float, float]] = []
        self.symbols: dict[int, ca.SX] = {}
        self._known: dict[tuple[str, float, float], int] = {}

    def _node(self, kind: str, a: float, b: float = 0) -> int:
        """Number of the operation ``kind`` on a and b (numbers of nodes, or b a constant); one
        that is known already gets no second number.
        """
        key = (kind, a, b)
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = len(self.operations)
            self.operations.append(key)
        return found

    # --- what a recursion writes -----------------------------------------------------------------

    def symbol(self, x: ca.SX) -> Value:
        """A value given from outside."""
        node = self._node("symbol", len(self.symbols))
        self.symbols[node] = x
        return Value(self, node)

    def vector(self, x: ca.SX) -> list[Scalar]:
        """The entries of a vector of symbols."""
        return [self.symbol(x[i]) for i in range(x.numel())]

    def sine(self, x: Scalar, cosine: bool = False) -> Scalar:
        """The sine (or cosine) of a value."""
        assert isinstance(x, Value)
        node = self._node("cos" if cosine else "sin", x.node)
        return Value(self, node, x.negative and not cosine)

    def sum(self, a: int, b: int, negative: bool) -> Scalar:
        """``a + b``."""
        alike = self._match_multiples(a, b)
        if alike is not None:
            x, c, d = alike
            return self.multiply_constant(Value(self, x, negative), c + d)
        return Value(self, self._node("+", min(a, b), max(a, b)), negative)

    def difference(self, a: int, b: int, negative: bool) -> Scalar:
        """``a - b``, or its negative."""
        alike = self._match_multiples(a, b)
        if alike is not None:
            x, c, d = alike
            return self.multiply_constant(Value(self, x, negative), c - d)
        # operands are stored in one order, signs are not: both signs are looked up
        if ("-", b, a) in self._known:
            return Value(self, self._node("-", b, a), not negative)
        if negative and ("-", a, b) not in self._known:
            return Value(self, self._node("-", b, a))
        return Value(self, self._node("-", a, b), negative)

    def _match_multiples(self, a: int, b: int) -> tuple[int, float, float] | None:
        """``(x, c, d)`` where ``a = c x`` and ``b = d x`` with numbers c and d."""
        (kind_a, x, c) = self.operations[a]
        (kind_b, y, d) = self.operations[b]
        x, c = (int(x), c) if kind_a == "*c" else (a, 1.0)
        y, d = (int(y), d) if kind_b == "*c" else (b, 1.0)
        return (int(x), c, d) if x == y else None

    def product(self, a: int, b: int, negative: bool) -> Value:
        """``a b``."""
        return Value(self, self._node("*", min(a, b), max(a, b)), negative)

    def add_constant(self, a: Value, c: float) -> Scalar:
        """``a + c`` with a number c."""
        if c == 0.0:
            return a
        return Value(self, self._node("+c", a.node, -c if a.negative else c), a.negative)

    def multiply_constant(self, a: Value, c: float) -> Scalar:
        """``c a`` with a number c."""
        if c == 0.0:
            return 0.0
        negative = a.negative != (c < 0.0)
        c = abs(float(c))
        kind, first, second = self.operations[a.node]
        if kind == "*c":
            first = int(first)
            c = c * second
        else:
            first = a.node
        return (
            Value(self, int(first), negative)
            if c == 1.0
            else Value(self, self._node("*c", first, c), negative)
        )

    def constant(self, x: Scalar) -> Scalar:
        """A value that derivatives take for a constant."""
        return Value(self, self._node("=", x.node), x.negative) if isinstance(x, Value) else x

    def inverse(self, a: Scalar) -> Scalar:
        """``1 / a``; ZeroDivisionError for the number zero."""
        if not isinstance(a, Value):
            return 1.0 / float(a)  # (a number of numpy would give infinity and a warning)
        return Value(self, self._node("/", a.node), a.negative)

    # --- derivatives -----------------------------------------------------------------------------

    def tangents(self, results: Sequence[Scalar], x: Scalar) -> list[Scalar]:
        """Derivatives of results in one symbol, written on the tape as well."""
        return self._forward(results, [(x, 1.0)], {})

    def gradient(self, result: Scalar, symbols: Sequence[Scalar]) -> list[Scalar]:
        """Derivatives of one result in symbols, from the result back; written on the tape as
        well.
        """
        return self._backward([(result, 1.0)], symbols, {})

    def jvp(
        self, results: Sequence[Scalar], tangents: Iterable[tuple[Scalar, Scalar]]
    ) -> list[Scalar]:
        """Rates of results where symbols ``x`` have the rates of the pairs ``(x, dx)``; rotations
        as a whole.
        """
        return self._forward(results, tangents, self.find_rotations(results))

    def vjp(
        self, cotangents: Sequence[tuple[Scalar, Scalar]], symbols: Sequence[Scalar]
    ) -> list[Scalar]:
        """Derivatives in symbols of the sum of ``weight * result`` over pairs of them; rotations
        as a whole.
        """
        return self._backward(
            cotangents, symbols, self.find_rotations([result for result, _ in cotangents])
        )

    def _forward(
        self,
        results: Sequence[Scalar],
        tangents: Iterable[tuple[Scalar, Scalar]],
        rotations: dict[int, _Rotation],
    ) -> list[Scalar]:
        """Rates of results for pairs (symbol, its rate), operation by operation from the symbols
        on.

        ``rotations``: of `find_rotations`, whose derivatives are shorter than those of sine and
        cosine.
        """
        add: Callable[[Scalar, Scalar], Scalar] = (
            self._factored_sum if rotations else lambda x, y: x + y
        )
        rate: dict[int, Scalar] = {}
        for x, dx in tangents:
            assert isinstance(x, Value) and not x.negative
            rate[x.node] = dx
        for node in self.find_needed(results, constants=False):
            kind, a, b = self.operations[node]
            if kind in ("symbol", "="):
                continue
            da = rate.get(int(a), 0.0)
            first = Value(self, int(a))
            if node in rotations:
                angle, slope, terms = rotations[node]
                found = rate.get(angle, 0.0) * slope
                for factor, operand in terms:
                    found = found + factor * rate.get(operand, 0.0)
            elif kind in ("+", "-"):
                db = rate.get(int(b), 0.0)
                found = add(da, db if kind == "+" else -db)
            elif kind == "*":
                found = da * Value(self, int(b)) + rate.get(int(b), 0.0) * first
            elif kind in ("+c", "*c"):
                found = da if kind == "+c" else da * b
            elif kind == "/":
                found = -(da * (Value(self, node) * Value(self, node)))
            else:
                found = (
                    -(da * self.sine(first))
                    if kind == "cos"
                    else da * self.sine(first, cosine=True)
                )
            if isinstance(found, Value) or found != 0.0:
                rate[node] = found
        out: list[Scalar] = []
        for result in results:
            found = rate.get(result.node, 0.0) if isinstance(result, Value) else 0.0
            out.append(-found if isinstance(result, Value) and result.negative else found)
        return out

    def _backward(
        self,
        cotangents: Sequence[tuple[Scalar, Scalar]],
        symbols: Sequence[Scalar],
        rotations: dict[int, _Rotation],
    ) -> list[Scalar]:
        """Derivatives in ``symbols`` of the sum over pairs (result, weight), operation by
        operation from the results back; ``rotations`` as for `_forward`.
        """
        weight: dict[int, Scalar] = {}

        def add(node: float, x: Scalar) -> None:
            weight[int(node)] = weight.get(int(node), 0.0) + x

        for result, w in cotangents:
            if isinstance(result, Value):
                add(result.node, -w if result.negative else w)
        for node in reversed(
            self.find_needed([result for result, _ in cotangents], constants=False)
        ):
            kind, a, b = self.operations[node]
            w = weight.get(node, 0.0)
            if kind in ("symbol", "=") or not (isinstance(w, Value) or w):
                continue
            first = Value(self, int(a))
            if node in rotations:
                angle, slope, terms = rotations[node]
                add(angle, w * slope)
                for factor, x in terms:
                    add(x, w * factor)
            elif kind == "*":
                add(a, w * Value(self, int(b)))
                add(b, w * first)
            elif kind in "+-":
                add(a, w)
                add(b, w if kind == "+" else -w)
            elif kind in ("+c", "*c"):
                add(a, w if kind == "+c" else w * b)
            elif kind == "/":
                add(a, -(w * (Value(self, node) * Value(self, node))))
            else:
                add(
                    a,
                    -(w * self.sine(first))
                    if kind == "cos"
                    else w * self.sine(first, cosine=True),
                )
        return [weight.get(x.node, 0.0) if isinstance(x, Value) else 0.0 for x in symbols]

    def _factored_sum(self, x: Scalar, y: Scalar) -> Scalar:
        """``x + y``, a constant factor of both (2 in the rates of squares) after the sum."""
        if isinstance(x, Value) and isinstance(y, Value):
            (kind_x, a, c) = self.operations[x.node]
            (kind_y, b, d) = self.operations[y.node]
            if kind_x == kind_y == "*c" and c == d:
                return c * (Value(self, int(a), x.negative) + Value(self, int(b), y.negative))
        return x + y

    def find_rotations(self, results: Sequence[Scalar]) -> dict[int, _Rotation]:
        """The operations ``cos(angle) x +- sin(angle) y`` that results need, each with its
        derivatives.

        The derivative in the angle is the other component of the rotated vector, which is on the
        tape as a rule: two operations, where the derivatives of cosine and sine would take seven.
        """
        found: dict[int, _Rotation] = {}
        for node in self.find_needed(results, constants=False):
            kind, *sides = self.operations[node]
            if kind not in ("+", "-"):
                continue
            terms: list[tuple[str, int, Value, int]] = []  # cos or sin, angle, signed factor, x
            for side, negative in zip(sides, (False, kind == "-"), strict=True):
                product, *factors = self.operations[int(side)]
                for first, other in (factors, factors[::-1]) if product == "*" else ():
                    function, angle, _ = self.operations[int(first)]
                    if function in ("cos", "sin"):
                        terms.append(
                            (function, int(angle), Value(self, int(first), negative), int(other))
                        )
                        break
            if (
                len(terms) == 2
                and {terms[0][0], terms[1][0]} == {"cos", "sin"}
                and terms[0][1] == terms[1][1]
            ):
                slope: Scalar = 0.0
                for function, argument, factor, x in terms:
                    turned = self.sine(Value(self, argument), cosine=function == "sin") * Value(
                        self, x
                    )
                    slope = (
                        slope - turned
                        if (function == "cos") != factor.negative
                        else slope + turned
                    )
                found[node] = terms[0][1], slope, tuple((factor, x) for _, _, factor, x in terms)
        return found

    # --- results----------------------------------------------------------------------------------

    def find_needed(self, results: Iterable[Scalar], constants: bool = True) -> list[int]:
        """The operations that results need, operands first; or without those of values taken for a
        `constant`.
        """
        wanted: set[int] = set()
        stack = [x.node for x in results if isinstance(x, Value)]
        while stack:
            node = stack.pop()
            if node not in wanted:
                wanted.add(node)
                if constants or self.operations[node][0] != "=":
                    stack.extend(self.operands(node))
        return sorted(wanted)

    def operands(self, node: int) -> tuple[int, ...]:
        """The operands of an operation that are themselves on the tape."""
        kind, a, b = self.operations[node]
        if kind == "symbol":
            return ()
        return (int(a), int(b)) if kind in "+-*" else (int(a),)

    def absorb_signs(self, results: Sequence[Scalar]) -> list[Scalar]:
        """Results with fewer negatives at the end: ``-(a - b)`` becomes ``b - a``, ``-(c a)``
        ``(-c) a``.
        """
        out: list[Scalar] = []
        for x in results:
            if isinstance(x, Value) and x.negative:
                kind, a, b = self.operations[x.node]
                if kind in ("-", "*c"):
                    x = Value(
                        self, self._node(kind, b, a) if kind == "-" else self._node(kind, a, -b)
                    )
            out.append(x)
        return out

    def count(self, results: Sequence[Scalar]) -> int:
        """Arithmetic operations that results need; a negative that is left at the end is an
        operation as well.

        Sines and cosines are not counted.
        """
        results = self.absorb_signs(results)
        ends = {(x.node, x.negative) for x in results if isinstance(x, Value)}
        wanted = bytearray(len(self.operations))
        for node, _ in ends:
            wanted[node] = 1
        count = sum(negative for _, negative in ends)
        for node in range(len(wanted) - 1, -1, -1):
            if wanted[node]:
                kind, a, b = self.operations[node]
                if kind == "symbol":
                    continue
                wanted[int(a)] = 1
                if kind in "+-*":
                    wanted[int(b)] = 1
                count += kind in _ARITHMETIC
        return count

    def build(self, results: Sequence[Scalar]) -> list[ca.SX]:  # noqa: C901
        """The results as CasADi scalars in the symbols they were made of."""
        results = self.absorb_signs(results)
        built: dict[int, ca.SX] = {}
        for node in self.find_needed(results):
            kind, a, b = self.operations[node]
            if kind == "symbol":
                built[node] = self.symbols[node]
                continue
            x = built[int(a)]
            match kind:
                case "+":
                    built[node] = x + built[int(b)]
                case "-":
                    built[node] = x - built[int(b)]
                case "*":
                    built[node] = x * built[int(b)]
                case "+c":
                    built[node] = x + b
                case "*c":
                    built[node] = b * x
                case "/":
                    built[node] = 1 / x
                case "=":
                    built[node] = x
                case "sin":
                    built[node] = ca.sin(x)
                case _:
                    built[node] = ca.cos(x)
        out = []
        for result in results:
            if isinstance(result, Value):
                out.append(-built[result.node] if result.negative else built[result.node])
            else:
                out.append(ca.SX(result))
        return out
