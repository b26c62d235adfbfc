"""From expressions to C: the graph keeps its meaning while it shrinks, loops solve, no NaN or
infinity goes unseen.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from emission import Small, ports_of, small, spec_of
from emitted import machine
from toolchain import needs_compiler

from flexgen.base.spec.ports import Port
from flexgen.codegen.statements import graph as graphs
from flexgen.codegen.statements import simplify
from flexgen.codegen.statements.function_text import function_text
from flexgen.codegen.statements.graph import Graph, read_graph
from flexgen.codegen.statements.literals import literal
from flexgen.codegen.statements.routine import (
    Block,
    Expressions,
    Products,
    Routine,
    Rows,
    Solve,
    profile,
)
from flexgen.codegen.statements.schedule import order_by_depth, schedule_nodes
from flexgen.codegen.statements.simplify import simplify_graph

ROUNDING = 1e-13  # of some twenty roundings in another order, relative to the largest term
POINTS = 37  # no multiple of any number of lanes
X = ca.SX.sym("u", 4)
A, B, C, D = (X[i] for i in range(4))

CALLS = {
    "sqrt": np.sqrt,
    "exp": np.exp,
    "sin": np.sin,
    "cos": np.cos,
    "tanh": np.tanh,
    "fabs": np.abs,
    "sign": np.sign,
    "lt": lambda a, b: (a < b) * 1.0,
    "if_else_zero": lambda c, a: np.where(c != 0, a, 0.0),
    "not": lambda a: (a == 0) * 1.0,
}


def function_of(*rows) -> ca.Function:
    return ca.Function("f", [X], [ca.densify(ca.vertcat(*rows))], ["u"], ["y"])


def value(graph: Graph, x: np.ndarray) -> np.ndarray:
    """The graph evaluated by numpy, point by point: an independent reading of it."""
    node: list[np.ndarray] = []
    of = lambda r: -node[r >> 1] if r & 1 else node[r >> 1]  # noqa: E731
    for kind, operands in zip(graph.kind, graph.operands, strict=True):
        if kind == "input":
            node.append(x[:, operands[1]])
        elif kind == "constant":
            node.append(np.full(len(x), graph.value[len(node)]))
        elif kind in ("add", "sub", "mul", "div"):
            a = of(operands[0])
            b = of(operands[1])
            node.append(
                {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide}[kind](
                    a, b
                )
            )
        else:
            node.append(CALLS[kind](*(of(r) for r in operands)))
    return np.stack([of(r) for _, _, r in sorted(graph.outputs)], axis=1)


def random_function(rng: np.random.Generator, length: int = 60) -> ca.Function:
    """A function of random sums, differences, products, quotients and calls; denominators stay
    away from zero.
    """
    values = [X[i] for i in range(4)] + [ca.SX(float(c)) for c in (2.0, -0.5, 1.0, 3.0)]
    for _ in range(length):
        a, b = (values[int(k)] for k in rng.integers(len(values), size=2))
        kind = int(rng.integers(9))
        made = [
            a + b,
            a - b,
            -a,
            a * b,
            a * a,
            a / (2 + b * b),
            ca.sin(a),
            2 * ca.tanh(b),
            ca.if_else(a < b, a, -b),
        ][kind]
        values.append(made)
    return function_of(*values[-12:])


def worst(function: ca.Function, rng: np.random.Generator) -> float:
    x = rng.normal(size=(POINTS, 4))
    expected = machine(function, [x])[0][:, :, 0]
    with np.errstate(all="ignore"):
        given = value(simplify_graph(read_graph(function)), x)
    scale = 1.0 + np.abs(expected).max(axis=0)
    return float(np.nanmax(np.abs(given - expected) / scale))


# --- the graph -----------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(40))
def test_the_graph_evaluates_to_the_values_of_the_function(seed):
    rng = np.random.default_rng(seed)
    # products of products amplify what rounding does
    assert worst(random_function(rng), rng) < ROUNDING * 1e3


@pytest.mark.parametrize("lost", ["add", "multiply", "terms"])
def test_a_lost_sign_is_seen(lost, monkeypatch):
    if lost == "terms":
        true = simplify._terms
        monkeypatch.setattr(simplify, "_terms", lambda *given: [r & ~1 for r in true(*given)])
    else:
        true = getattr(Graph, lost)
        monkeypatch.setattr(Graph, lost, lambda self, a, b: true(self, a & ~1, b))
    seen = [
        worst(random_function(np.random.default_rng(seed)), np.random.default_rng(seed))
        for seed in range(10)
    ]
    assert max(seen) > 1e-3


@pytest.mark.parametrize(
    ("rows", "operations"),
    [
        ([A + B, B + A], 1),
        ([A - B, B - A], 1),
        ([(-A) * B, A * (-B), A * B], 1),
        ([A + (-B), A - B], 1),
        ([A / D, B / D, C / D], 4),  # one reciprocal, three products
        ([A / D], 1),
        ([A / 4, 0.25 * A], 1),
        ([2 * (3 * A)], 1),
        ([A * 0 + B * 1], 0),
        ([ca.sin(A), ca.sin(-A), ca.cos(A), ca.cos(-A)], 2),
        ([A * A, A**2, (-A) ** 2], 1),
        ([1 / D, A / D], 2),
        ([ca.sin(A), ca.cos(A), ca.sin(B), ca.cos(B), ca.sin(A - B)], 7),
        ([ca.sin(A), ca.sin(A - B)], 3),  # without those of B the sum is shorter
        ([ca.SX(2) * 3, A], 0),
    ],
)
def test_no_operation_is_made_twice(rows, operations):
    assert simplify_graph(read_graph(function_of(*rows))).operations() == operations


def test_long_sums_are_short_chains():
    x = ca.SX.sym("x", 64)
    total = x[0]
    for k in range(1, 64):
        total = total - x[k] if k % 3 else total + x[k]
    graph = simplify_graph(read_graph(ca.Function("f", [x], [total], ["u"], ["y"])))
    assert graph.operations() == 63 and max(graph.depth) == 6 * graphs.LATENCY["add"]
    values = np.random.default_rng(1).normal(size=(5, 64))
    signs = np.array([1.0] + [-1.0 if k % 3 else 1.0 for k in range(1, 64)])
    assert np.allclose(value(graph, values)[:, 0], values @ signs, rtol=0, atol=1e-13)


def test_summands_that_are_ready_late_are_added_last():
    slow = ca.exp(A)
    graph = simplify_graph(read_graph(function_of(slow + B + C + D)))
    assert max(graph.depth) == graphs.LATENCY["exp"] + graphs.LATENCY["add"]


@pytest.mark.parametrize("order", [order_by_depth, schedule_nodes])
def test_every_operand_is_written_before_its_user(order):
    graph = simplify_graph(read_graph(random_function(np.random.default_rng(7), 200)))
    roots = [r >> 1 for _, _, r in graph.outputs]
    seen: set[int] = set()
    nodes = order(graph, roots, seen)
    at = {node: k for k, node in enumerate(nodes)}
    assert len(at) == len(nodes) == sum(graph.alive()) and set(nodes) == seen
    assert all(at[other] < at[node] for node in nodes for other in graph.arguments(node))
    assert order(graph, roots, seen) == []


def test_the_longest_chain_is_begun_first():
    chain = A
    for _ in range(10):
        chain = ca.sqrt(chain + 1)
    graph = simplify_graph(read_graph(function_of(B * C, B * D, C * D, chain)))
    nodes = schedule_nodes(graph, [r >> 1 for _, _, r in graph.outputs], set())
    kinds = [graph.kind[node] for node in nodes if graph.arguments(node)]
    # while the sum is on its way
    assert kinds[0] == "add" and kinds.index("mul") < kinds.index("sqrt")


# --- the C ---------------------------------------------------------------------------------------
def every_operation() -> ca.SX:
    """One row per operation of CasADi's scalar graphs."""
    rows = [
        A + B,
        A - B,
        A * B,
        A / B,
        -A,
        A * A,
        2 * A,
        1 / A,
        ca.sqrt(ca.fabs(A)),
        ca.fabs(A) ** B,
        ca.fabs(A) ** 2.5,
    ]
    rows += [
        f(A)
        for f in (
            ca.sin,
            ca.cos,
            ca.tan,
            ca.atan,
            ca.sinh,
            ca.cosh,
            ca.tanh,
            ca.asinh,
            ca.exp,
            ca.expm1,
        )
    ]
    rows += [f(A) for f in (ca.erf, ca.floor, ca.ceil, ca.fabs, ca.sign)]
    rows += [f(ca.sin(A)) for f in (ca.asin, ca.acos, ca.atanh)]
    rows += [f(1 + ca.fabs(A)) for f in (ca.log, ca.log1p, ca.acosh)]
    rows += [
        f(A, B) for f in (ca.fmin, ca.fmax, ca.fmod, ca.remainder, ca.copysign, ca.atan2, ca.hypot)
    ]
    rows += [
        A < B,
        A <= B,
        A == B,
        A != B,
        ca.logic_not(A),
        ca.logic_and(A < 0, B < 0),
        ca.logic_or(A < 0, B < 0),
    ]
    rows += [ca.if_else(A < B, A * 3, B / 7), ca.sin(ca.sin(A) + ca.cos(B)), C + D]
    return ca.vertcat(*rows, ca.cumsum(ca.sin(ca.vertcat(*rows[:20]))))


@needs_compiler
@pytest.mark.parametrize("chunk", [1000, 7])
@pytest.mark.parametrize("flags", [(), ("-O0", "-DSMALL_NO_VECTORS")])
def test_every_operation_and_every_cut(chunk, flags, tmp_path, monkeypatch):
    monkeypatch.setattr("flexgen.codegen.statements.function_text.CHUNK", chunk)
    monkeypatch.setattr("flexgen.codegen.statements.function_text.MARGIN", 0)
    function = function_of(every_operation())
    written = function_text(
        Routine((Expressions(function),)), {"u": 4}, {"y": function.numel_out(0)}
    )
    assert ("evaluate_1_2" in written.text) == (chunk == 7) == (written.work > 0)
    library = small(function, tmp_path, flags=("-std=c99", "-O2", "-ffp-contract=off", *flags))
    x = np.random.default_rng(5).normal(size=(POINTS, 4))
    x[0, :2] = (1.0, 1.0)
    x[1, :2] = (2.0, -0.5)
    expected = machine(function, [x])[0][:, :, 0]
    status, (many,) = library.batch(x)
    assert status == 0
    for k in range(POINTS):
        status, (one,) = library.point(x[k])
        assert status == 0 and np.array_equal(one, many[k])
    assert np.allclose(many, expected, rtol=1e-14, atol=1e-15)


@needs_compiler
def test_single_precision_is_single_throughout(tmp_path):
    function = function_of(
        ca.sin(A) * B + 0.1 * C / D, ca.exp(-A * A) * ca.tanh(B), ca.cos(A + 0.3)
    )
    library = small(function, tmp_path, "single", flags=("-std=c99", "-O2", "-Wdouble-promotion"))
    x = np.random.default_rng(6).normal(size=(POINTS, 4)).astype(np.float32)
    status, (many,) = library.batch(x)
    expected = machine(function, [x.astype(float)])[0][:, :, 0]
    assert status == 0 and many.dtype == np.float32
    assert np.allclose(many, expected, rtol=3e-6, atol=3e-6)  # some ten roundings of 6e-8


def test_literals_read_back_to_the_same_bits():
    assert (literal(0.3), literal(-9.81), literal(2.0), literal(1e16)) == (
        "0.3",
        "(-9.81)",
        "2.0",
        "1e+16",
    )
    assert (literal(0.3, "single"), literal(-2.0, "single"), literal(1e16, "single")) == (
        "0.3f",
        "(-2.0f)",
        "1e+16f",
    )
    for x in (0.0, -0.0, 1.0, -3.0, 0.1, 1e300, -5e-324, 2.0**53, 1e22):
        assert float(literal(x).strip("()")).hex() == x.hex()
        with np.errstate(all="ignore"):
            short = np.float32(x)
        text = literal(x, "single").strip("()")
        assert ("INFINITY" in text) if np.isinf(short) else np.float32(text.rstrip("f")) == short
    assert (literal(np.inf), literal(-np.inf), literal(np.nan)) == (
        "INFINITY",
        "(-INFINITY)",
        "NAN",
    )


@needs_compiler
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("chunk", [1000, 3])
def test_results_that_are_not_finite_have_an_error_status(bad, chunk, tmp_path, monkeypatch):
    """An input that no result depends on, one behind a comparison, and a result that overflows."""
    monkeypatch.setattr("flexgen.codegen.statements.function_text.CHUNK", chunk)
    monkeypatch.setattr("flexgen.codegen.statements.function_text.MARGIN", 0)
    # C and D are not used
    library = small(function_of(ca.if_else(A < 1, 2, 3 * B), B * B, B - 1), tmp_path)
    good = np.array([0.1, 0.2, 0.3, 0.4])
    assert library.point(good)[0] == 0
    for entry in range(4):
        x = np.tile(good, (POINTS, 1))
        x[[5, POINTS - 1], entry] = bad
        status, (one,) = library.point(x[5])
        assert status == -2 and np.isnan(one).all()
        status, (many,) = library.batch(x)
        assert status == -2
        assert np.array_equal(np.isnan(many).all(axis=1), np.isnan(many).any(axis=1))
        assert list(np.flatnonzero(np.isnan(many[:, 0]))) == [5, POINTS - 1]
    huge = np.array([0.1, 1e200, 0.3, 0.4])
    status, (one,) = library.point(huge)
    assert status == -3 and np.isnan(one).all()


# --- loops ---------------------------------------------------------------------------------------
def solve_program(
    n: int, columns: int, unit: bool, banded: bool
) -> tuple[Routine, tuple[Port, ...], tuple[Port, ...]]:
    """``X = -A^-1 R`` of a positive definite matrix given by its entries."""
    q = ca.SX.sym("q", n, n)
    r = ca.SX.sym("r", n, columns)
    mask = (
        np.ones((n, n))
        if not banded
        else (np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 1) * 1.0
    )
    half = ca.tril(q) * mask
    matrix = ca.mtimes(half, half.T) + n * ca.SX.eye(n)
    f = ca.Function("g", [q, r], [ca.densify(matrix), r], ["q", "r"], ["M", "R"])
    blocks = [Block("X", 1, 0, columns)]
    outputs = [Port("X", (n + 1, columns), "1", "below a row of zeros, with a one in it")]
    if unit:
        blocks.append(Block("inverse_of", 0, columns, n))
        outputs.append(Port("inverse_of", (n, n), "1", ""))
    solve = Solve("M", "R", n, columns, unit, profile(f, "M"), tuple(blocks), (("X", 0, 1),))
    return Routine((Expressions(f), solve)), ports_of(f)[0], tuple(outputs)


@needs_compiler
@pytest.mark.parametrize(
    ("n", "columns", "unit", "banded"),
    [(2, 3, False, False), (5, 4, True, True), (9, 20, True, False)],
)
@pytest.mark.parametrize(
    "flags",
    [(), pytest.param(("-march=native",), marks=pytest.mark.slow), ("-DSMALL_NO_VECTORS",)],
)
def test_loops_solve(n, columns, unit, banded, flags, tmp_path):
    program, inputs, outputs = solve_program(n, columns, unit, banded)
    assert not banded or program.steps[1].profile == tuple(max(0, i - 2 + 1) for i in range(n))
    options = ("-std=c99", "-O2", "-ffp-contract=off", *flags)
    library = Small(spec_of(program, inputs, outputs), tmp_path, flags=options)
    rng = np.random.default_rng(3)
    q = rng.normal(size=(POINTS, n, n))
    r = rng.normal(size=(POINTS, n, columns))
    stored = [x.transpose(0, 2, 1).reshape(POINTS, -1) for x in (q, r)]
    status, many = library.batch(*stored)
    assert status == 0
    for k in range(POINTS):
        status, one = library.point(q[k], r[k])
        assert status == 0 and all(np.array_equal(a, b[k]) for a, b in zip(one, many, strict=True))
        matrix = np.array(program.steps[0].function(q[k], r[k])[0])
        expected = -np.linalg.solve(matrix, r[k])
        given = one[0].reshape(n + 1, columns, order="F")
        assert np.allclose(given[1:], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
        assert given[0].tolist() == [0.0, 1.0] + [0.0] * (columns - 2)
        if unit:
            inverse = one[1].reshape(n, n, order="F")
            assert np.allclose(inverse @ matrix, np.eye(n), rtol=0, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("n", [8, 9, 19])
@pytest.mark.parametrize("flags", [(), ("-march=native",), ("-DSMALL_NO_VECTORS",)])
def test_products_fill_a_symmetric_matrix(n, flags, tmp_path):
    """Bits for many points as for one; what is behind the last entry stays."""
    left = ca.SX.sym("left", 3, n)
    right = ca.SX.sym("right", 3, n)
    f = ca.Function("g", [left, right], [2 * left, 1 * right], ["left", "right"], ["S", "F"])
    S = Rows("S", 0, 3)
    F = Rows("F", 0, 3)
    program = Routine((Expressions(f), Products((S, F), (F, S), n, "M")))
    options = ("-std=c99", "-O2", "-ffp-contract=off", *flags)
    library = Small(
        spec_of(program, ports_of(f)[0], (Port("M", (n, n), "1", ""),)), tmp_path, flags=options
    )
    rng = np.random.default_rng(4)
    S, F = rng.normal(size=(2, POINTS, 3, n))
    status, (many,) = library.batch(*(x.transpose(0, 2, 1).reshape(POINTS, -1) for x in (S, F)))
    assert status == 0
    for k in range(POINTS):
        status, (one,) = library.point(S[k], F[k])
        assert status == 0 and np.array_equal(one, many[k])
        upper = np.triu(2 * S[k].T @ F[k])
        expected = upper + np.triu(upper, 1).T
        assert np.allclose(
            one.reshape(n, n), expected, rtol=0, atol=1e-14 * np.abs(expected).max()
        )
    F[0, 0, n - 1] = np.inf
    assert library.point(S[0], F[0])[0] != 0


@needs_compiler
def test_a_singular_matrix_has_an_error_status(tmp_path):
    program, inputs, outputs = solve_program(2, 3, False, False)
    f = program.steps[0].function
    q = ca.SX.sym("q", 2, 2)
    r = ca.SX.sym("r", 2, 3)
    singular = ca.Function(
        "g", [q, r], [ca.densify(ca.mtimes(q, q.T)), r], ["q", "r"], f.name_out()
    )
    library = Small(
        spec_of(Routine((Expressions(singular), program.steps[1])), inputs, outputs), tmp_path
    )
    assert library.point(np.eye(2), np.ones((2, 3)))[0] == 0
    status, (X_of, *_) = library.point(np.ones((2, 2)), np.ones((2, 3)))
    assert status == -3 and np.isnan(X_of).all()


@needs_compiler
@pytest.mark.parametrize("rows", [((0.1, 0.7), (0.3, 2.1)), ((0.7, 0.1), (0.7, 0.1 + 1e-17))])
def test_a_pivot_of_the_size_of_rounding_has_an_error_status(rows, tmp_path):
    """In exact arithmetic the second pivot is zero; its rounding error must not be a divisor."""
    program, inputs, outputs = solve_program(2, 3, False, False)
    q = ca.SX.sym("q", 2, 2)
    r = ca.SX.sym("r", 2, 3)
    square = ca.Function("g", [q, r], [ca.densify(ca.mtimes(q, q.T)), r], ["q", "r"], ["M", "R"])
    library = Small(
        spec_of(Routine((Expressions(square), program.steps[1])), inputs, outputs), tmp_path
    )
    right = np.ones((2, 3))
    assert library.point(np.array(rows), right)[0] == -3
    assert library.point(np.array([[0.1, 0.7], [0.3, 2.2]]), right)[0] == 0
    stored = np.stack([np.array(rows).T.ravel(), np.eye(2).ravel()] * 10), np.ones((20, 6))
    status, (X_of, *_) = library.batch(*stored)
    assert status == -3 and np.array_equal(np.isnan(X_of).all(axis=1), [True, False] * 10)


@needs_compiler
@pytest.mark.parametrize("sign", [1, -1])
def test_a_divisor_of_the_size_of_rounding_has_an_error_status(sign, tmp_path):
    pivot = sign * (B * B + C * C - 2 * D * B * C)  # positive, or always negative, for |D| < 1
    function = function_of(A / pivot, A + 1)
    inputs, outputs = ports_of(function)
    library = Small(
        spec_of(Routine((Expressions(function, pivots=True),)), inputs, outputs), tmp_path
    )
    assert library.point([1.0, 0.3, 0.5, 0.2])[0] == 0
    for x in (
        [1.0, 0.3, 0.3, 1.0],
        [1.0, 0.1, 0.1 * (1 + 3e-16), 1.0],
        [1.0, 0.3, 0.3, 1.0 + 1e-15],
    ):
        assert library.point(x)[0] == -3


@needs_compiler
def test_a_result_that_is_never_finite_has_an_error_status(tmp_path):
    library = small(function_of(ca.SX.inf(), A), tmp_path)
    status, (y,) = library.point([1.0, 2.0, 3.0, 4.0])
    assert status == -3 and np.isnan(y).all()


def test_operations_of_products_are_those_of_their_dot_products():
    """A symmetric matrix: one triangle; else each has its own number of rows."""
    S, W, G, U = (Rows(name, 0, count) for name, count in (("S", 3), ("W", 3), ("G", 5), ("U", 5)))
    below = sum(2 * 5 - 1 for i in range(9) for _ in range(i + 1))
    assert Products((S, W), (G, U), 9, "M").operations == below + sum(
        2 * 3 - 1 for i in range(9) for _ in range(i)
    )
    assert Products((U, G), (G, U), 9, "M").operations == below
