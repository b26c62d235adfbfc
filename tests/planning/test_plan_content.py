"""Inputs of a plan and results read from its unknowns: rows, bounds, nodes, samples, scaled
programs, texts.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.planning.optimal import result
from flexgen.planning.optimal.blocks import Block, check_finite, program
from flexgen.planning.optimal.nodal import general_part
from flexgen.planning.optimal.transcribe import Layout


def planar(**more: Any) -> Any:
    return flexgen.plan_problem("planar5_nmp", mesh=[0.0, 0.25, 0.5, 1.0], limits=False, **more)


def unknowns(
    problem: Any, T: float, seed: int = 2
) -> tuple[Layout, np.ndarray, np.ndarray, np.ndarray]:
    """Polynomials of degree four in time, and of degree two, as unknowns."""
    rng = np.random.default_rng(seed)
    mesh = problem.mesh
    c = rng.standard_normal((mesh.n, 5))
    u = rng.standard_normal((problem.equations.model.n_m, 3))
    layout = Layout(tuple(problem.phases), tuple(p.symbol for p in problem.parameters))
    states = np.hstack([of(c, T * mesh.nodes), T * of(c, T * mesh.nodes, 1)])
    packed = mesh.pack(states, T**2 * of(c, T * mesh.times, 2), of(u, T * mesh.times))
    return layout, np.concatenate([packed, [T], np.full(len(problem.parameters), 2.5)]), c, u


def of(c: np.ndarray, t: np.ndarray, order: int = 0) -> np.ndarray:
    out = [np.polynomial.Polynomial(row) for row in c]
    return np.stack([(p.deriv(order) if order else p)(t) for p in out], axis=-1)


def test_samples_of_a_plan_are_its_polynomials() -> None:
    problem = planar()
    T = 1.7
    layout, x, c, u = unknowns(problem, T)
    places = np.array([0.0, 0.3, 0.9])
    found = result.samples(layout, problem, x, places)
    t = T * (problem.mesh.nodes[:-1, None] + problem.mesh.h[:, None] * places).ravel()
    assert_allclose(found.t, t)
    for name, order in (("y", 0), ("dy", 1), ("ddy", 2)):
        assert_allclose(getattr(found, name), of(c, t, order), rtol=1e-9, atol=1e-9)
    assert_allclose(found.tau, of(u, t), rtol=1e-9, atol=1e-9)
    assert found.theta.tolist() == [T]


def test_signals_at_the_nodes_are_those_of_the_motion() -> None:
    """States and the time at the nodes, accelerations and torques at the collocation points."""
    problem = planar()
    T = 1.7
    _, x, c, u = unknowns(problem, T)
    mesh = problem.mesh
    n_a = problem.equations.model.n_a
    y, dy, ddy, tau = mesh.unpack(x[: mesh.size])
    given = [y.T, dy.T, ddy.reshape(-1, mesh.n).T, tau.reshape(-1, tau.shape[-1]).T, T, 3.0]

    def at(name: str) -> np.ndarray:
        return np.array(ca.Function("f", problem.node_symbols, [problem.nodes(name)])(*given))

    nodes = T * mesh.nodes
    times = T * mesh.times
    assert_allclose(at("q_a"), of(c, nodes).T[:n_a])
    assert_allclose(at("v_a"), of(c, nodes, 1).T[:n_a], rtol=1e-9)
    assert_allclose(at("a_a"), of(c, times, 2).T[:n_a], rtol=1e-9)
    assert_allclose(at("tau_m"), of(u, times).T, rtol=1e-9)
    assert_allclose(at("tau_m[m2]"), of(u, times).T[1:], rtol=1e-9)
    assert_allclose(at("time")[0], 3.0 + nodes)


def test_rows_and_bounds_of_a_phase() -> None:
    """Names are counted over all places; comparisons become rows below zero, or zero."""
    problem = planar()
    v = problem["v_m"]
    tau = problem["tau_m"]
    problem.subject_to(tau, [-1.0, -2.0], 3.0)
    problem.subject_to(v[0] <= 10.0, at="end", slack=0.5)
    problem.subject_to(v[1] == 2.0, name="speed")
    problem.subject_to(problem.nodes("tau_m")[0, 1], None, 4.0)
    problem.subject_to(v[0], lower=0.0)
    rows = problem.content.rows
    assert [row.name for row in rows["path"]] == ["constraint 1", "speed", "constraint 5"]
    assert [row.name for row in rows["end"]] == ["constraint 2"] and rows["start"] == []
    first, speed, last = rows["path"]
    assert (
        first.lower.tolist() == [-1.0, -2.0]
        and first.upper.tolist() == [3.0, 3.0]
        and first.slack is None
    )
    assert speed.lower.tolist() == speed.upper.tolist() == [0.0] and rows["end"][0].slack == 0.5
    assert rows["end"][0].lower.tolist() == [-np.inf] and rows["end"][0].upper.tolist() == [0.0]
    assert last.lower.tolist() == [0.0] and last.upper.tolist() == [np.inf]
    (nodal,) = problem.content.nodal
    assert nodal.name == "constraint 4" and nodal.upper.tolist() == [4.0]
    f = ca.Function("f", [v], [rows["end"][0].value, speed.value])
    assert [float(x) for x in f([12.0, 5.0])] == [2.0, 3.0]
    problem.bound("v_m", 1.0, 2.0)
    problem.bound("v_m", -5.0)
    problem.bound("q_a", [-1, -2, -3], [1, 2, 3])
    assert (
        problem.content.bands["v_m"].upper.tolist() == [np.inf] * 2
        and len(problem.content.bands) == 2
    )
    assert problem.content.bands["q_a"].lower.tolist() == [-1.0, -2.0, -3.0]
    with pytest.raises(
        ArgumentError,
        match=r"^bound of v_m: given a lower bound above the upper one: \[2\.0, 2\.0\], \[1",
    ):
        problem.bound("v_m", 2.0, 1.0)
    problem.bound("v_m", 2.0, 2.0)
    with pytest.raises(
        ArgumentError, match=r"^bound of v_m: given .*, expected a number or 2 numbers$"
    ):
        problem.bound("v_m", [1.0, 2.0, 3.0])
    assert (
        repr(problem)
        == f"<PlanProblem planar5_nmp, number 0: {problem.given_duration:.4g} s, 3 intervals>"
    )


def test_distances_from_the_path_and_from_obstacles_have_their_slack() -> None:
    """In phases that are added afterwards as well; a tenth of the tolerance is left between the
    points.
    """
    problem = planar()
    problem.follow(1e-3)
    wall = flexgen.HalfSpace((0.0, 1.0, 0.0), -9.0)
    ball = flexgen.Sphere((9.0, 9.0, 0.0), 0.02, "ball")
    problem.avoid(ball, wall, margin=0.01)
    later = problem.then(0.5, mesh=2)
    for phase in (problem, later):
        distance, round_ball, along_wall = phase.content.rows["path"]
        assert distance.name == "distance from the path" and distance.slack == pytest.approx(1e-4)
        assert_allclose(distance.upper, 9e-4)
        assert_allclose(distance.lower, -9e-4)
        assert round_ball.name == "ball" and round_ball.slack == pytest.approx(3e-4)
        assert along_wall.name == "half-space 2" and along_wall.slack == 1e-3
        assert not round_ball.lower.any() and np.isinf(round_ball.upper).all()
    free = planar(timing="free")
    with pytest.raises(
        ArgumentError,
        match=r"^reference: there is none where the path parameter is free; use problem\.f",
    ):
        _ = free.reference
    assert free.tracks and problem.tracks and not planar().tracks
    costly = planar()
    costly.add_cost(ca.sumsqr(costly.reference), at="end")
    assert costly.tracks


# --- programs ------------------------------------------------------------------------------------
def small(**more: Any) -> Any:
    """Two instants of ``a x^2 + y`` between bounds with the cost ``(x - 1)^2 a``, a linear row,
    five unknowns.
    """
    z = ca.SX.sym("z", 2)
    p = ca.SX.sym("p")
    where = np.array([[0, 1], [2, 3]])
    low = np.array([[-1.0, -2.0]])
    high = np.array([[4.0, np.inf]])
    times = np.array([[0.0, 0.25], [0.0, 0.75]])
    block = Block(
        z,
        p,
        where,
        np.array([[2.0, 3.0]]),
        p * z[0] ** 2 + z[1],
        low,
        high,
        ["row"],
        p * (z[0] - 1) ** 2,
        ca.SX(0, 1),
        times,
    )
    matrix = np.array([[0.0, 1.0, 0.0, -1.0, 2.0]])
    scale = np.array([1.0, 2.0, 0.5, 4.0, 10.0])
    guess = np.array([2.0, 1.0, -1.0, 3.0, 5.0])
    return (
        program(
            5, [block], (sp.csc_matrix(matrix), ["linear"], np.array([0.1])), scale, guess, **more
        ),
        scale,
        guess,
    )


@pytest.mark.parametrize("outside", [False, True])
def test_a_program_is_its_blocks_in_scaled_unknowns(outside: bool) -> None:
    """With derivatives by CasADi of its formulas; a change of the unknowns by their scales changes
    a row, and the cost, by one at most at the point of the guess. Rows outside of the blocks come
    last, unscaled.
    """
    more: dict[str, Any] = {}
    if outside:
        more["general"] = lambda true: (5 * true[4] ** 2, true[0] * true[4])
        more["general_bounds"] = (np.array([-3.0]), np.array([7.0]), ["more"])
    made, scale, guess = small(**more)
    x = ca.MX.sym("x", 5)
    z = x * ca.DM(scale)
    cost = 2 * (z[0] - 1) ** 2 + 3 * (z[2] - 1) ** 2 + 5 * z[4] ** 2 * outside
    slope = np.array(ca.Function("s", [x], [ca.gradient(cost, x)])(guess / scale))
    steep = np.abs(slope).max()
    factor = 1 / max(4 * guess[0] * scale[0], 6 * abs(guess[2]) * scale[2], scale[1], scale[3])
    rows = [factor * (2 * z[0] ** 2 + z[1]), factor * (3 * z[2] ** 2 + z[3])]
    rows += [0.1 * (z[1] - z[3] + 2 * z[4]), *([z[0] * z[4]] if outside else [])]
    g = ca.vertcat(*rows)
    weights = np.arange(1.0, len(rows) + 1) * [(-1.0) ** k for k in range(len(rows))]
    lagrangian = 0.7 * cost / steep + ca.dot(ca.DM(weights), g)
    expected = [cost / steep, ca.gradient(cost, x) / steep, g, ca.jacobian(g, x)]
    expected.append(ca.triu(ca.hessian(lagrangian, x)[0]))  # the upper half
    hessian = made.hessian(ca.MX(0.7), ca.MX(ca.DM(weights)))
    found = [made.cost, made.gradient, made.g, made.jacobian, hessian]
    at = np.array([1.5, 0.3, -2.0, 0.7, 0.2])
    one = ca.Function("found", [made.x], [ca.densify(y) for y in found])(at)
    other = ca.Function("expected", [x], [ca.densify(y) for y in expected])(at)
    for own, wanted in zip(one, other, strict=True):
        assert_allclose(np.array(own), np.array(wanted), rtol=1e-9, atol=1e-12)
    assert made.cost_scale == pytest.approx(1 / steep)
    last = [1.0] * outside
    assert_allclose(made.scale, [factor, factor, 0.1, *last])
    assert_allclose(made.lower, [-factor, -2 * factor, 0.0, *(-3.0 * x for x in last)])
    assert_allclose(made.upper, [4 * factor, np.inf, 0.0, *(7.0 * x for x in last)])
    assert made.names == ["row", "row", "linear", *["more"] * outside]
    assert_allclose(made.times[:2], [[0.0, 0.25], [0.0, 0.75]])
    assert np.isnan(made.times[2:]).all()


def test_costs_and_rows_of_the_nodes_are_functions_of_the_unknowns() -> None:
    """Of two phases, whose times count on; costs are added, rows keep their order and bounds."""
    problem = planar()
    later = problem.then(0.5, mesh=[0.0, 0.4, 1.0])
    problem.add_cost(problem.nodes("q_a")[0, 1] ** 2)
    later.subject_to(later.nodes("time")[2] - problem.nodes("q_a")[1, 0], -1.0, 2.0, name="late")
    later.add_cost(3.0 * later.nodes("tau_m")[1, 2])
    problem.subject_to(ca.vec(problem.nodes("v_a")[:2, 3]), None, 5.0, name="fast")
    layout = Layout(tuple(problem.phases), ())
    T = np.array([1.7, 0.6])
    rng = np.random.default_rng(5)
    states = [rng.standard_normal((p.mesh.N + 1, 2 * p.mesh.n)) for p in problem.phases]
    inner = [rng.standard_normal((p.mesh.N, p.mesh.s, p.mesh.n)) for p in problem.phases]
    tau = [rng.standard_normal((p.mesh.N, p.mesh.s, 2)) for p in problem.phases]
    packed = [
        p.mesh.pack(a, b, c) for p, a, b, c in zip(problem.phases, states, inner, tau, strict=True)
    ]
    x = np.concatenate([*packed, T])
    nodal = [item for phase in problem.phases for item in phase.content.nodal]
    general, (low, high, names) = general_part(layout, nodal)
    symbol = ca.MX.sym("x", layout.size)
    cost, g = (np.array(v).ravel() for v in ca.Function("f", [symbol], list(general(symbol)))(x))
    n = problem.mesh.n
    assert cost[0] == pytest.approx(states[0][1, 0] ** 2 + 3.0 * tau[1].reshape(-1, 2)[2, 1])
    speeds = states[0][3, n : n + 2] / T[0]
    assert_allclose(g, [*speeds, T.sum() - states[0][0, 1]])
    assert names == ["fast", "fast", "late"] and low.tolist() == [-np.inf, -np.inf, -1.0]
    assert high.tolist() == [5.0, 5.0, 2.0]


def test_what_is_not_finite_is_named() -> None:
    x = ca.MX.sym("x", 2)

    def made(cost: Any, row: Any) -> Any:
        return SimpleNamespace(
            x=x,
            cost=cost,
            gradient=ca.gradient(cost, x),
            g=ca.vertcat(x[0], row),
            names=["a", "b"],
        )

    good = ca.sumsqr(x)
    check_finite(made(good, x[1]), np.array([1.0, 2.0]))
    for cost, row, name in (
        (ca.sqrt(x[0]), x[1], "cost"),
        (good, ca.log(x[0]), "b"),
        (ca.sqrt(x[0] + 1), x[1], "cost"),
    ):
        with pytest.raises(
            ArgumentError,
            match=rf"^plan: '{name}' is NaN or infinite where the search starts, expected",
        ):
            check_finite(made(cost, row), np.array([-1.0, 2.0]))


def test_the_worst_row_is_named_with_its_time() -> None:
    """Of two phases: the time counts from the beginning of the problem; sizes are those before
    they were scaled.
    """
    made: Any = SimpleNamespace(
        lower=np.array([-1.0, 0.0, 0.0]),
        upper=np.array([1.0, 0.0, 2.0]),
        names=["a", "b", "c"],
        times=np.array([[0.0, 0.5], [np.nan, np.nan], [1.0, 0.25]]),
        scale=np.array([0.1, 2.0, 0.5]),
    )
    layout: Any = SimpleNamespace(theta=np.array([3, 4, 5]))
    x = np.array([0.0, 0.0, 0.0, 2.0, 4.0, 9.0])

    def text(*g: float) -> str:
        return result.describe_worst(made, SimpleNamespace(g=np.array(g)), x, layout)

    start = "the largest violated constraint is "
    assert text(-1.5, 0.1, 0.0) == f"{start}'a', by 5 at t = 1 s"
    assert text(0.0, -0.7, 2.5) == f"{start}'b', by 0.35"
    assert text(0.0, 0.0, 3.0) == f"{start}'c', by 2 at t = 3 s"
    assert text(0.0, np.nan, 3.0).startswith(f"{start}'b'")
    words = (
        "all constraints hold, the cost is not at its minimum; raise max_iterations or change "
        "the guess"
    )
    assert text(1.0, 0.0, 0.0) == text(1.0 + 1e-10, 0.0, 0.0) == words
    with pytest.raises(
        SolverError,
        match=r"^plan: IPOPT ended with 'stuck' and numbers that are not finite; the larges",
    ):
        result.make_solution(
            None,
            layout,
            made,
            SimpleNamespace(g=np.array([3.0, 0.0, 0.0]), status="stuck"),
            np.full(6, np.nan),
            1e-5,
            False,
            None,
        )  # type: ignore[arg-type]
