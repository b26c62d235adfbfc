"""Sines and cosines of sums with arc tangents: their values without the arc tangents."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from flexgen.codegen.statements import arc_tangents
from flexgen.codegen.statements.arc_tangents import replace_arc_tangents
from flexgen.codegen.statements.graph import Graph, read_graph

CALLS: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "atan2": math.atan2,
}
X = ca.SX.sym("x", 4)
FIRST = ca.atan2(X[0], X[1])
SECOND = ca.atan2(X[1] * X[2], X[3] + 2.0)
ANGLES = {
    "alone": FIRST,
    "negative": -FIRST,
    "with an angle": X[2] - FIRST + 0.3,
    "twice": FIRST + X[2] + FIRST,
    "of two": SECOND - FIRST - X[3],
    "within": ca.atan2(ca.sin(FIRST + X[2]), ca.cos(SECOND)) + X[2],
}


def values(graph: Graph, given: np.ndarray) -> list[float]:
    """Results of a graph."""
    found: list[float] = []
    for node, (kind, operands) in enumerate(zip(graph.kind, graph.operands, strict=True)):
        if kind == "input":
            found.append(float(given[operands[1]]))
        elif kind == "constant":
            found.append(graph.value[node])
        else:
            found.append(
                CALLS[kind](*(-found[r >> 1] if r & 1 else found[r >> 1] for r in operands))
            )
    return [-found[r >> 1] if r & 1 else found[r >> 1] for _, _, r in graph.outputs]


def graphs_of(angle: ca.SX) -> tuple[Graph, Graph]:
    """The graphs of sine and cosine of an angle, as read and without arc tangents."""
    graph = read_graph(ca.Function("turn", [X], [ca.vertcat(ca.sin(angle), ca.cos(angle))]))
    return graph, replace_arc_tangents(graph)


def worst_difference(angle: ca.SX) -> float:
    """Largest difference of the two graphs at drawn values."""
    before, after = graphs_of(angle)
    rng = np.random.default_rng(0)
    worst = 0.0
    for given in rng.uniform(-1.5, 1.5, (20, 4)):
        pairs = zip(values(before, given), values(after, given), strict=True)
        worst = max(worst, *(abs(a - b) for a, b in pairs))
    return worst


@pytest.mark.parametrize("name", ANGLES)
def test_values_stay_and_arc_tangents_go(name: str) -> None:
    """Sums, differences and arc tangents of arc tangents."""
    assert worst_difference(ANGLES[name]) < 1e-14
    _, after = graphs_of(ANGLES[name])
    kept = [kind for kind, used in zip(after.kind, after.alive(), strict=True) if used]
    assert "atan2" not in kept


def test_a_wrong_sign_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each term added, where some are subtracted."""
    right = arc_tangents.sum_terms
    monkeypatch.setattr(
        arc_tangents, "sum_terms", lambda graph, r: {k: abs(n) for k, n in right(graph, r).items()}
    )
    assert worst_difference(ANGLES["with an angle"]) > 0.1


def test_angles_that_cancel_make_no_calls() -> None:
    """The sum of a coordinate and a joint that is an angle less this coordinate."""
    _, after = graphs_of(X[2] + (FIRST - X[2]))
    kept = {kind for kind, used in zip(after.kind, after.alive(), strict=True) if used}
    assert not kept & {"sin", "cos", "atan2"}


def test_graphs_without_arc_tangents_stay() -> None:
    """An unchanged object; also where the angle itself is a result."""
    graph, after = graphs_of(X[0] + X[1])
    assert after is graph
    alone = read_graph(ca.Function("angle", [X], [FIRST]))
    assert replace_arc_tangents(alone) is alone
