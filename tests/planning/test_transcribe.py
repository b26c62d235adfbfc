"""The blocks of a plan at a motion of polynomials: rows, costs and connections are those of its
signals.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.planning.optimal.transcribe import Layout, bernstein, blocks_of, links

T = np.array([2.0, 0.6])  # s, of both phases


class Motion:
    """Coordinates that are polynomials of degree four in time, from phase to phase; torques of
    degree two.
    """

    def __init__(self, problem: Any, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.problem = problem
        self.n = problem.mesh.n
        self.n_m = problem.equations.model.n_m
        ratio = np.concatenate([np.ones(problem.equations.model.n_a), 100.0 * np.ones(self.n_m)])
        self.c = 0.1 * rng.standard_normal((5, self.n)) * ratio
        self.u = rng.standard_normal((3, self.n_m))
        self.layout = Layout(tuple(problem.phases), tuple(p.symbol for p in problem.parameters))
        parts = []
        begin = 0.0
        for phase, own in zip(problem.phases, T, strict=False):
            mesh = phase.mesh
            nodes = begin + own * mesh.nodes
            times = begin + own * mesh.times
            states = np.hstack([self.y(nodes), own * self.y(nodes, 1)])
            parts.append(mesh.pack(states, own**2 * self.y(times, 2), self.tau(times)))
            begin += own
        self.x = np.concatenate(
            [*parts, T[: len(problem.phases)], [7.0] * len(problem.parameters)]
        )

    def y(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        return np.stack(
            [
                np.polynomial.Polynomial(c).deriv(order)(t)
                if order
                else np.polynomial.Polynomial(c)(t)
                for c in self.c.T
            ],
            axis=-1,
        )

    def tau(self, t: np.ndarray) -> np.ndarray:
        return np.stack([np.polynomial.Polynomial(c)(t) for c in self.u.T], axis=-1)


def values_of(block: Any, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (m, count), cost and squares of a block at all of its instants."""
    f = ca.Function(
        "block",
        [block.z, block.p],
        [ca.densify(ca.SX(e)) for e in (block.rows, block.cost, block.squares)],
    )
    found = [f(x[where], block.values[:, k]) for k, where in enumerate(block.where)]
    rows, cost, squares = (
        np.stack([np.array(each[k]).ravel() for each in found], axis=-1) for k in range(3)
    )
    return rows, cost, squares


def two_phases() -> Any:
    problem = flexgen.plan_problem("planar5_nmp", mesh=4, limits=False)
    problem.then(float(T[1]), mesh=[0.0, 0.3, 1.0])
    return problem


def reference_of(phase: Any) -> Any:
    return lambda sigma: np.zeros((len(np.atleast_1d(sigma)), phase.signals.reference.numel()))


def test_rows_of_motion_are_the_equations_at_the_collocation_points() -> None:
    problem = two_phases()
    motion = Motion(problem)
    model = problem.equations.model
    begin = 0.0
    for phase, own in zip(problem.phases, T, strict=True):
        block = blocks_of(motion.layout, phase, reference_of(phase), True)[0]
        rows, cost, squares = values_of(block, motion.x)
        t = begin + own * phase.mesh.times
        y, v, a = (motion.y(t, k) for k in range(3))
        n_a = model.n_a
        r_a, r_m = evaluate(
            problem.equations.function("residual"),
            *(
                y[:, :n_a],
                v[:, :n_a],
                a[:, :n_a],
                y[:, n_a:],
                v[:, n_a:],
                a[:, n_a:],
                motion.tau(t),
            ),
        )
        expected = np.hstack([r_a.reshape(len(t), -1), r_m.reshape(len(t), -1)])
        found = rows[: model.dof].T
        factor = np.median(found / expected, axis=0)
        assert_allclose(found, expected * factor, rtol=1e-6, atol=1e-6 * np.abs(found).max())
        assert not block.lower[: model.dof].any() and not block.upper[: model.dof].any()
        assert np.abs(factor).min() > 0 and not cost.any() and squares.size == 0
        begin += own


def test_costs_of_a_plan_are_integrals_and_values_at_the_ends() -> None:
    """Exact for polynomials of degree five; squares count as costs; bounds cost nothing."""
    problem = two_phases()
    later = problem.phases[1]
    later.add_cost(later["q_a[q1]"] * later["tau_m[m1]"][0])
    later.add_squares(later["tau_m[m2]"] - 1.0, weight=3.0)
    later.add_cost(later["q_a[q2]"] * later["time"], at="end")
    later.add_cost(5.0 * later["v_a[q1]"], at="start")
    later.bound("tau_m", -1e3, 1e3)
    motion = Motion(problem)
    names = [c.name for c in problem.equations.model.coordinates]
    q1 = names.index("q1")
    q2 = names.index("q2")
    total = 0.0
    squared = 0.0
    for block in blocks_of(motion.layout, later, reference_of(later), True):
        _, cost, squares = values_of(block, motion.x)
        total += float(cost.sum())
        squared += float((squares**2).sum())
    t, weight = np.polynomial.legendre.leggauss(8)
    t = T[0] + T[1] * (t + 1) / 2
    weight = T[1] * weight / 2
    integral = float(weight @ (motion.y(t)[:, q1] * motion.tau(t)[:, 0]))
    end = np.array([T.sum()])
    start = T[:1]
    ends = float(motion.y(end)[0, q2] * T.sum() + 5.0 * motion.y(start, 1)[0, q1])
    assert total == pytest.approx(integral + ends, rel=1e-9)
    squares_of = 3.0 * float(weight @ (motion.tau(t)[:, 1] - 1.0) ** 2)
    assert squared == pytest.approx(squares_of, rel=1e-9)


def test_bounds_of_polynomials_are_those_of_their_bernstein_coefficients() -> None:
    """Of torques, speeds and coordinates; a polynomial with these coefficients is that of the
    motion.
    """
    problem = two_phases()
    later = problem.phases[1]
    later.bound("tau_m[m1]", -2.0, 3.0)
    later.bound("v_a[q1]", None, 4.0)
    later.bound("q_a[q2]", -5.0, None)
    motion = Motion(problem)
    block = blocks_of(motion.layout, later, reference_of(later), True)[-1]
    rows, cost, _ = values_of(block, motion.x)
    assert block.names == 3 * ["bound of tau_m[m1]"] + 3 * ["bound of v_a[q1]"] + 4 * [
        "bound of q_a[q2]"
    ]
    assert not cost.any() and rows.shape == (10, 2)
    assert block.lower[:, 0].tolist() == [-2.0] * 3 + [-np.inf] * 3 + [-5.0] * 4
    assert block.upper[:, 1].tolist() == [3.0] * 3 + [4.0] * 3 + [np.inf] * 4
    names = [c.name for c in problem.equations.model.coordinates]
    q1 = names.index("q1")
    q2 = names.index("q2")
    nodes = T[0] + T[1] * later.mesh.nodes
    signals = (
        (motion.tau, 0, 2, rows[:3]),
        (lambda t: motion.y(t, 1), q1, 3, rows[3:6]),
        (motion.y, q2, 4, rows[6:]),
    )
    for signal, column, degree, found in signals:
        for k in range(2):
            theta, matrix = bernstein(degree)
            at = nodes[k] + (nodes[k + 1] - nodes[k]) * theta
            coefficients = matrix @ signal(at)[:, column]
            assert_allclose(
                found[:, k], coefficients[len(coefficients) - len(found) :], rtol=1e-9, atol=1e-12
            )
    theta, matrix = bernstein(3)
    assert_allclose(theta, [0.0, 1 / 3, 2 / 3, 1.0])
    assert_allclose(matrix @ theta, theta, atol=1e-12)
    assert_allclose(matrix @ theta**3, [0.0, 0.0, 0.0, 1.0], atol=1e-12)


def test_connections_hold_for_a_smooth_motion_alone() -> None:
    """Nodes of each phase, torques that do not jump, and the ends of phases; speeds by their
    durations.
    """
    problem = two_phases()
    problem.continuous_torque()
    motion = Motion(problem)
    blocks, matrix, names = links(motion.layout, False)
    n = motion.n
    n_m = motion.n_m
    assert names[: 8 * n] == ["continuity of the states"] * (8 * n)
    assert names[8 * n : 8 * n + 3 * n_m] == ["continuity of the torques"] * (3 * n_m)
    assert (
        names[-n:] == ["connection of the phases"] * n
        and len(names) == 8 * n + 3 * n_m + 4 * n + n
    )
    size = abs(matrix) @ np.abs(motion.x)
    assert np.abs(matrix @ motion.x).max() < 1e-12 * size.max()
    (block,) = blocks
    rows, cost, _ = values_of(block, motion.x)
    assert np.abs(rows).max() < 1e-10 * np.abs(motion.c).max() and not cost.any()
    assert block.names == ["connection of the phases (speed)"] * n and block.times.tolist() == [
        [1.0, 0.0]
    ]
    jump = motion.x.copy()
    jump[motion.layout.first[1] :][:n] += 1.0  # the first coordinates of the second phase
    away = matrix @ jump
    assert np.flatnonzero(np.abs(away) > 1e-6).tolist() == [
        *range(8 * n + 3 * n_m, 8 * n + 3 * n_m + n),
        *range(len(names) - n, len(names)),
    ]
    assert_allclose(away[-n:], -1.0, rtol=1e-6)
    faster = motion.x.copy()
    faster[motion.layout.theta[1]] = 0.5
    assert_allclose(
        values_of(block, faster)[0][:, 0],
        motion.y(T[:1], 1)[0] * (1 - 0.6 / 0.5),
        rtol=1e-6,
        atol=1e-9,
    )
    blocks, matrix, names = links(motion.layout, True)
    assert (
        names[-n:] == ["periodicity"] * n
        and len(blocks) == 2
        and blocks[1].names == ["periodicity (speed)"] * n
    )
    away = matrix @ motion.x
    assert_allclose(
        away[-n:], (motion.y(np.array([T.sum()])) - motion.y(np.zeros(1)))[0], rtol=1e-6, atol=1e-9
    )
