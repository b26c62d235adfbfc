"""Operations of a graph: the values of CasADi for every kind of call, each computed once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special

from flexgen.codegen.statements.graph import LATENCY, OTHER_LATENCY, Graph, read_graph

X, Y = ca.vertsplit(ca.SX.sym("x", 2))
NAMED = {"fabs": np.abs, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan}
NAMED |= {"asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh, "erf": special.erf}
NAMED |= {"atan2": np.arctan2, "pow": np.power, "lt": np.less, "le": np.less_equal}
NAMED |= {"eq": np.equal, "ne": np.not_equal, "and": np.logical_and, "or": np.logical_or}
NAMED |= {"not": np.logical_not, "add": np.add, "sub": np.subtract, "mul": np.multiply}
NAMED |= {"div": np.divide, "if_else_zero": lambda c, a: np.where(c, a, 0.0)}
UNARY = "sqrt exp log expm1 log1p erf floor ceil fabs sin cos tan asin acos atan sinh cosh tanh"
UNARY += " asinh atanh sign logic_not"
BINARY = "fmin fmax fmod copysign atan2 hypot lt le eq ne logic_and logic_or if_else power"
BINARY += " plus minus times rdivide"


def value(graph: Graph, r: int, given: np.ndarray) -> Any:
    """A reference by its operations, with NumPy."""
    node = r >> 1
    kind = graph.kind[node]
    operands = graph.operands[node]
    sign = -1.0 if r & 1 else 1.0
    if kind == "constant":
        return sign * graph.value[node]
    if kind == "input":
        return sign * given[operands[1]]
    of = NAMED.get(kind) or getattr(np, kind)
    return sign * of(*(value(graph, operand, given) for operand in operands))


@pytest.mark.parametrize("kind", [*UNARY.split(), *BINARY.split()])
def test_calls_have_the_values_of_casadi(kind: str) -> None:
    """Of both signs of their arguments, in both orders, and with a constant."""
    f: Callable[..., ca.SX] = getattr(ca, kind)
    if kind == "if_else":
        f = lambda a, b: ca.if_else(a < b, a, -b)  # noqa: E731
    pairs = [(X, Y), (Y, X), (-X, Y), (X, -Y), (-X, -Y), (X, X)]
    pairs += [(ca.SX(0.5), X), (X, ca.SX(2.0))]
    if kind in UNARY.split():
        rows = [f(a) for a, _ in pairs]
    else:
        rows = [f(a, b) for a, b in pairs]
    total = [*rows, 2.0 * rows[0] - rows[1], -rows[0] * rows[3]]
    function = ca.Function("f", [ca.vertcat(X, Y)], [ca.densify(ca.vertcat(*total))])
    graph = read_graph(function)
    with np.errstate(all="ignore"):
        for given in np.random.default_rng(3).uniform(0.1, 0.9, (5, 2)):
            found = [value(graph, r, given) for _, _, r in sorted(graph.outputs)]
            expected = np.array(function(given)).ravel()
            assert_allclose(np.array(found, dtype=float), expected, rtol=1e-12, atol=1e-14)


def identities(graph: Graph) -> dict[str, tuple[int, int]]:
    """References that are the same, or one and the negative of the other (``r ^ 1``); sums and
    products in other orders are in tests/codegen/test_emission.py.
    """
    a = graph.input(0, 0)
    b = graph.input(0, 1)
    two = graph.constant(2.0)
    zero = graph.constant(0.0)
    call = graph.call
    return {
        "a - a": (graph.add(a, a ^ 1), zero),
        "a + 0": (graph.add(a, zero), a),
        "0 + b": (graph.add(zero, b), b),
        "2 + 1/2": (graph.add(two, graph.constant(0.5)), graph.constant(2.5)),
        "-3 (2 a)": (
            graph.multiply(graph.constant(-3.0), graph.multiply(a, two)),
            graph.multiply(graph.constant(-6.0), a),
        ),
        "-1 a": (graph.multiply(a, graph.constant(-1.0)), a ^ 1),
        "0 a": (graph.multiply(a, zero), zero),
        "2/(1/2)": (graph.divide(two, graph.constant(0.5)), graph.constant(4.0)),
        "0/a": (graph.divide(zero, a), zero),
        "-a/b": (graph.divide(a ^ 1, b), graph.divide(a, b) ^ 1),
        "fmax": (call("fmax", [b, a]), call("fmax", [a, b])),
        "if": (call("if_else_zero", [a, b ^ 1]), call("if_else_zero", [a, b]) ^ 1),
        "sin 2": (call("sin", [two]), graph.constant(np.sin(2.0))),
        "sin -2": (call("sin", [two ^ 1]), graph.constant(-np.sin(2.0))),
        "cos -2": (call("cos", [two ^ 1]), graph.constant(np.cos(2.0))),
    }


@pytest.mark.parametrize("name", identities(Graph()))
def test_a_graph_has_each_value_once(name: str) -> None:
    first, second = identities(Graph())[name]
    assert first == second


def test_values_that_differ_are_not_shared() -> None:
    graph = Graph()
    a = graph.input(0, 0)
    b = graph.input(0, 1)
    assert graph.call("fmax", [a, b]) != graph.call("fmin", [a, b])
    assert graph.call("atan2", [b, a]) != graph.call("atan2", [a, b])
    # quotients by zero, and by a number whose inverse is infinite
    for divisor in (a, graph.constant(0.0), graph.constant(5e-324)):
        assert graph.kind[graph.divide(graph.constant(2.0), divisor) >> 1] == "div"
    assert graph.number(graph.constant(2.0) ^ 1) == -2.0 and graph.number(a) is None
    assert np.isnan(graph.number(graph.constant(float("nan"))) or 0.0)


def test_depths_are_sums_of_latencies_along_the_longest_chain() -> None:
    """And only the operands of outputs are needed."""
    graph = Graph()
    a = graph.input(0, 0)
    b = graph.input(0, 1)
    deep = graph.call("exp", [graph.add(graph.divide(a, b), graph.constant(2.0))])
    assert graph.depth[deep >> 1] == LATENCY["div"] + LATENCY["add"] + LATENCY["exp"]
    assert (graph.depth[graph.call("tan", [a]) >> 1], graph.depth[a >> 1]) == (OTHER_LATENCY, 0)
    product = graph.multiply(a, b)
    graph.outputs.append((0, 0, product))
    alive = {node for node, needed in enumerate(graph.alive()) if needed}
    assert alive == {r >> 1 for r in (a, b, product)}
