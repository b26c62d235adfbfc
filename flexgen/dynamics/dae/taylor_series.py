"""Taylor series of CasADi functions along curves: automatic differentiation in time, to any order,
at many points.

A function is a list of scalar operations. Each operation has a recurrence for the coefficients of
its result, such as ``(a b)_k = sum a_i b_(k-i)``; operations that do not wait for each other are
done together.

Source: A. Griewank, A. Walther, Evaluating Derivatives, SIAM 2008, chapter 13 (the recurrences).
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError

Rule = Callable[..., np.ndarray]


class SeriesFunction:
    """Taylor series of an SX function of CasADi.

    Series are arrays (n, K + 1, ...): n points, coefficients 0 to K of ``f(t) = sum f_k t^k``,
    then the entries.

    Parameters
    ----------
    function : casadi.Function
        Of the SX kind, with dense vectors as inputs.

    Raises
    ------
    ArgumentError
        The function has an operation without a rule here.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._steps: list[tuple[int, np.ndarray, np.ndarray]] = []
        offsets = np.cumsum([0, *(function.numel_in(i) for i in range(function.n_in()))])
        self._n_in = int(offsets[-1])
        self._constants: list[tuple[int, float]] = []
        self._results: list[list[tuple[int, int]]] = [[] for _ in range(function.n_out())]
        # work slot -> value: first the inputs, then one value an operation
        held: dict[int, int] = {}
        level: list[int] = [0] * self._n_in
        groups: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            if operation == ca.OP_INPUT:
                which, entry = function.instruction_input(k)
                held[function.instruction_output(k)[0]] = int(offsets[which] + entry)
                continue
            if operation == ca.OP_OUTPUT:
                which, entry = function.instruction_output(k)
                self._results[which].append((entry, held[function.instruction_input(k)[0]]))
                continue
            new = len(level)
            if operation == ca.OP_CONST:
                self._constants.append((new, float(function.instruction_constant(k))))
                level.append(0)
            else:
                if operation not in RULES:
                    raise ArgumentError(
                        f"function {function.name()}: operation {operation} has no series rule"
                    )
                operands = [held[slot] for slot in function.instruction_input(k)]
                level.append(1 + max(level[a] for a in operands))
                groups.setdefault((level[-1], operation), []).append(
                    (new, operands[0], operands[-1])
                )
            held[function.instruction_output(k)[0]] = new
        for (_, operation), members in sorted(groups.items()):
            table = np.array(members)
            self._steps.append((operation, table[:, 0], table[:, 1:]))
        self._size = len(level)

    def __call__(self, *inputs: np.ndarray) -> list[np.ndarray]:
        """Series of the results, each (n, K + 1, rows, columns), or without the last axis for a
        single column.

        Parameters
        ----------
        *inputs : arrays (n, K + 1, size)
            Series of the arguments, one an input.
        """
        n, order = inputs[0].shape[:2]
        values = np.zeros((self._size, order, n))
        if self._n_in:
            values[: self._n_in] = np.concatenate(inputs, axis=2).transpose(2, 1, 0)
        for place, constant in self._constants:
            values[place, 0] = constant
        for operation, into, operands in self._steps:
            values[into] = RULES[operation](values[operands[:, 0]], values[operands[:, 1]])
        out = []
        for which, entries in enumerate(self._results):
            rows, columns = self.function.size_out(which)
            row, column = self.function.sparsity_out(which).get_triplet()
            result = np.zeros((n, order, rows, columns))
            for entry, place in entries:
                result[:, :, row[entry], column[entry]] = values[place].T
            out.append(result[..., 0] if columns == 1 else result)
        return out


# --- rules: series (members, K + 1, points) of an operation from those of its operands -----------


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Series of a b; coefficients along the second axis: ``c_k = sum a_i b_(k-i)``."""
    out = a[:, :1] * b
    for i in range(1, a.shape[1]):
        out[:, i:] += a[:, i : i + 1] * b[:, :-i]
    return out


def _quotient(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Series of c = a/b: ``c_k = (a_k - sum_(i<k) c_i b_(k-i))/b_0``."""
    out = np.empty_like(a)
    for k in range(a.shape[1]):
        out[:, k] = (a[:, k] - (out[:, :k] * b[:, k:0:-1]).sum(axis=1)) / b[:, 0]
    return out


def _one(a: np.ndarray) -> np.ndarray:
    out = np.zeros_like(a)
    out[:, 0] = 1.0
    return out


def _integral_coefficient(a: np.ndarray, c: np.ndarray, k: int) -> np.ndarray:
    """``(a' c)_(k-1) / k``: coefficient k of the integral of ``a' c``."""
    j = np.arange(1, k + 1)[None, :, None]
    return (j * a[:, 1 : k + 1] * c[:, k - 1 :: -1][:, :k]).sum(axis=1) / k


def _exponential(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Series of c = exp(a), from ``c' = c a'``; the second argument is not used."""
    out = np.zeros_like(a)
    out[:, 0] = np.exp(a[:, 0])
    for k in range(1, a.shape[1]):
        out[:, k] = _integral_coefficient(a, out, k)
    return out


def _logarithm(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _integral(np.log, a, _quotient(_one(a), a))


def _integral(function: Rule, a: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """``f(a)`` from ``f'(a)``."""
    out = np.zeros_like(a)
    out[:, 0] = function(a[:, 0])
    for k in range(1, a.shape[1]):
        out[:, k] = _integral_coefficient(a, slope, k)
    return out


def _pair(a: np.ndarray, even: Rule, odd: Rule, sign: float) -> tuple[np.ndarray, np.ndarray]:
    """Series of cosine and sine of a (sign -1), or of the hyperbolic ones (+1), from ``c' = sign s
    a'``, ``s' = c a'``; ``even``, ``odd``: these functions of numbers.
    """
    c = np.zeros_like(a)
    s = np.zeros_like(a)
    c[:, 0] = even(a[:, 0])
    s[:, 0] = odd(a[:, 0])
    for k in range(1, a.shape[1]):
        c[:, k], s[:, k] = sign * _integral_coefficient(a, s, k), _integral_coefficient(a, c, k)
    return c, s


def _tangent(a: np.ndarray, function: Rule, sign: float) -> np.ndarray:
    """Series of ``c`` with ``c' = (1 + sign c^2) a'``: tangent (+1) or hyperbolic tangent (-1);
    ``function``: of numbers.
    """
    out = np.zeros_like(a)
    slope = np.zeros_like(a)
    out[:, 0] = function(a[:, 0])
    slope[:, 0] = 1 + sign * out[:, 0] ** 2
    for k in range(1, a.shape[1]):
        out[:, k] = _integral_coefficient(a, slope, k)
        slope[:, k] = sign * (out[:, : k + 1] * out[:, k::-1][:, : k + 1]).sum(axis=1)
    return out


def _root(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Series of c = sqrt(a), from ``c c = a``; the second argument is not used."""
    out = np.zeros_like(a)
    out[:, 0] = np.sqrt(a[:, 0])
    for k in range(1, a.shape[1]):
        inner = (out[:, 1:k] * out[:, k - 1 : 0 : -1]).sum(axis=1) if k > 1 else 0.0
        out[:, k] = (a[:, k] - inner) / (2 * out[:, 0])
    return out


def _power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``a^b``: by products where b is a small whole number, else through the logarithm."""
    whole = b[0, 0, 0]
    if (
        (b[:, 1:] == 0).all()
        and (b[:, 0] == whole).all()
        and whole == round(whole)
        and 0 <= whole <= 8
    ):
        out = _one(a)
        for _ in range(int(whole)):
            out = _product(out, a)
        return out
    return _exponential(_product(b, _logarithm(a, a)), b)


def _steady(function: Rule) -> Rule:
    """A rule for a result that is constant in pieces."""

    def rule(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        out = np.zeros_like(a)
        out[:, 0] = function(a[:, 0], b[:, 0])
        return out

    return rule


def _inverse_hyperbolic_sine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _integral(np.arcsinh, a, _quotient(_one(a), _root(_one(a) + _product(a, a), a)))


def _arc_tangent(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return _integral(np.arctan, a, _quotient(_one(a), _one(a) + _product(a, a)))


def _arc_tangent_of_two(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Series of the angle c of the vector (b, a), ``c' = (b a' - a b') / (a^2 + b^2)``."""
    out = np.zeros_like(a)
    out[:, 0] = np.arctan2(a[:, 0], b[:, 0])
    square = _product(a, a) + _product(b, b)
    by_a = _quotient(b, square)
    by_b = _quotient(a, square)
    for k in range(1, a.shape[1]):
        out[:, k] = _integral_coefficient(a, by_a, k) - _integral_coefficient(b, by_b, k)
    return out


def _smaller(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first: np.ndarray = a[:, :1] <= b[:, :1]
    return np.where(first, a, b)


RULES: dict[int, Rule] = {
    ca.OP_ASSIGN: lambda a, b: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_NEG: lambda a, b: -a,
    ca.OP_TWICE: lambda a, b: 2 * a,
    ca.OP_MUL: _product,
    ca.OP_SQ: lambda a, b: _product(a, a),
    ca.OP_DIV: _quotient,
    ca.OP_INV: lambda a, b: _quotient(_one(a), a),
    ca.OP_SQRT: _root,
    ca.OP_EXP: _exponential,
    ca.OP_LOG: _logarithm,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SIN: lambda a, b: _pair(a, np.cos, np.sin, -1.0)[1],
    ca.OP_COS: lambda a, b: _pair(a, np.cos, np.sin, -1.0)[0],
    ca.OP_TAN: lambda a, b: _tangent(a, np.tan, 1.0),
    ca.OP_SINH: lambda a, b: _pair(a, np.cosh, np.sinh, 1.0)[1],
    ca.OP_COSH: lambda a, b: _pair(a, np.cosh, np.sinh, 1.0)[0],
    ca.OP_TANH: lambda a, b: _tangent(a, np.tanh, -1.0),
    ca.OP_ATAN: _arc_tangent,
    ca.OP_ATAN2: _arc_tangent_of_two,
    ca.OP_ASINH: _inverse_hyperbolic_sine,
    ca.OP_FABS: lambda a, b: np.where(a[:, :1] < 0, -1.0, 1.0) * a,
    ca.OP_SIGN: _steady(lambda a, b: np.sign(a)),
    ca.OP_FLOOR: _steady(lambda a, b: np.floor(a)),
    ca.OP_LT: _steady(lambda a, b: a < b),
    ca.OP_LE: _steady(lambda a, b: a <= b),
    ca.OP_EQ: _steady(lambda a, b: a == b),
    ca.OP_NE: _steady(lambda a, b: a != b),
    ca.OP_NOT: _steady(lambda a, b: a == 0),
    ca.OP_AND: _steady(np.logical_and),
    ca.OP_OR: _steady(np.logical_or),
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a[:, :1] != 0, b, 0.0),
    ca.OP_FMIN: _smaller,
    ca.OP_FMAX: lambda a, b: -_smaller(-a, -b),
}
