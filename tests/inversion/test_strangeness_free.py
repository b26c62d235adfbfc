"""The regularized DAE on a small robot, and rank decisions on an example by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from causal_cases import problem
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.inversion.comparison import bdf, kunkel_mehrmann
from flexgen.inversion.comparison.strangeness_free import StrangenessFree

ELBOW = "elbow"


def torques(case: object, t: np.ndarray) -> np.ndarray:
    """Motor torques by the closed form of a fine BDF: another method."""
    fine = np.linspace(t[0], t[-1], 8 * (len(t) - 1) + 1)
    return bdf.march(case.dae, case.path, fine, case.x_eq, 3).x[::8, 2 * case.dae.n :]


def test_steps_of_radau_keep_the_path_and_its_rate_and_have_the_torques_of_bdf() -> None:
    """Every hidden constraint holds at each instant: output, its rate and its second rate."""
    case = problem(ELBOW)
    dae = case.dae
    system = kunkel_mehrmann.regularize(case.dae, case.x_eq)
    assert (system.mu, system.a, system.d) == (3, 8, 2) and system.gap > 1e6
    t = np.linspace(0.0, 1.0, 13)
    found = kunkel_mehrmann.integrate(system, case.path, t, case.x_eq)
    sample = case.path.sample(t)
    for k in (1, 6, 12):
        q = found.x[k, :2]
        v = found.x[k, 4:6]
        a = found.dx[k, 4:6]
        y, dy, ddy = outputs(case, q, v, a)
        assert_allclose(y, sample.y[k, :, 0], atol=1e-11)
        assert_allclose(dy, sample.y[k, :, 1], atol=1e-9)
        assert_allclose(ddy, sample.y[k, :, 2], atol=1e-7)
        F = dae.rows(found.x[k], found.dx[k], dae.targets(sample, 0)[k, :, 0])[0]
        assert np.abs(np.array(F)).max() < 1e-6 * np.abs(found.x[k, 8:]).max() + 1e-6
    tau = torques(case, t)
    assert np.abs(found.x[:, 8:] - tau).max() < 1e-2 * np.abs(tau).max()
    assert found.gap > 1e2 and 24 <= found.iterations < 200


def outputs(case: object, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[np.ndarray]:
    """Output and its first two rates, by differentiation in time of the emitted function."""
    s = ca.SX.sym("s")
    function = case.problem.equations.function("output")
    motion = ca.DM(q) + s * ca.DM(v) + s**2 / 2 * ca.DM(a)
    y = function(motion)
    dy = ca.jacobian(y, s)
    at = ca.Function("at", [s], [y, dy, ca.jacobian(dy, s)])
    return [np.array(z).ravel() for z in at(0)]


def jacobians(
    system: StrangenessFree, X: np.ndarray, U: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the scaled array in the scaled unknowns and derivatives, by differences."""
    columns = []
    for k in range(X.shape[1]):
        for i in range(system.n):
            step = np.zeros_like(X)
            step[i, k] = 1e-5 * system.units[i, k]
            columns.append((system.rows(X + step, U) - system.rows(X - step, U)) / 2e-5)
    found = np.column_stack(columns)
    return found[:, : system.n], found[:, system.n :]


def test_the_split_of_the_array_satisfies_its_definitions() -> None:
    case = problem(ELBOW)
    system = StrangenessFree(case.dae, 3, case.x_eq)
    X = np.zeros((system.n, 5))
    X[:, 0] = case.x_eq
    U = case.dae.targets(case.path.sample(np.array([0.0])), 3)[0]
    X = system.consistent(X, U)
    assert np.abs(system.rows(X, U)).max() < 1e-10
    assert_allclose(X[:, 0], case.x_eq, atol=1e-9)
    F = np.array(case.dae.rows(X[:, 0], X[:, 1], U[:, 0])[0]).ravel()
    assert_allclose(
        system.motion(X[:, 0], X[:, 1], U[:, 0]), F / system.row[: system.n], atol=1e-14
    )
    split = system.split(X, U)
    n = system.n
    N, M = jacobians(system, X, U)
    size = max(np.abs(N).max(), np.abs(M).max())
    assert_allclose(split.N, N, atol=1e-7 * size)
    assert_allclose(split.A, N[:n], atol=1e-7 * size)
    assert_allclose(split.E, M[:n, :n], atol=1e-7 * size)
    assert split.Z2.shape == (4 * n, 8) and split.T2.shape == (n, 2) and split.Z1.shape == (n, 2)
    assert_allclose(split.Z2.T @ M, 0.0, atol=1e-6 * size)
    assert_allclose(split.Z2.T @ split.N @ split.T2, 0.0, atol=1e-9)
    assert_allclose(split.T2.T @ split.T2, np.eye(2), atol=1e-12)
    assert_allclose(split.Z1 @ split.Z1.T @ split.E @ split.T2, split.E @ split.T2, atol=1e-12)
    rows = np.random.default_rng(1).normal(size=4 * n)
    w = split.solve(rows)
    Q1 = split.factors[0]
    assert_allclose(Q1.T @ (rows + M @ w), 0.0, atol=1e-6 * size * np.abs(w).max())


def test_an_array_that_is_too_short_or_of_negative_order_is_refused() -> None:
    case = problem(ELBOW)
    with pytest.raises(ArgumentError, match="mu: given -1, expected 0 or more"):
        StrangenessFree(case.dae, -1, case.x_eq)
    with pytest.raises(
        SolverError, match=r"array of order 1 does not make the DAE regular: corank .* 10 unknowns"
    ):
        StrangenessFree(case.dae, 1, case.x_eq).a  # noqa: B018
    system = StrangenessFree(case.dae, 3, case.x_eq)
    far = np.full((case.dae.n_u, 4), 50.0)
    X = np.zeros((system.n, 5))
    X[:, 0] = case.x_eq
    with pytest.raises(
        SolverError, match="no consistent values found: the path leaves the workspace"
    ):
        system.consistent(X, far)


class ByHand:
    """``x1' + x1 = 0``, ``m x2' + x2 = u2``, ``(e + x1) x3' + k x3 = u3``, in units of one."""

    n_x = n_u = m = 3

    def __init__(self, m: float, e: float, k: float = 1.0) -> None:
        x = ca.SX.sym("x", 3)
        dx = ca.SX.sym("dx", 3)
        u = ca.SX.sym("u", 3)
        rows = ca.vertcat(
            dx[0] + x[0], m * dx[1] + x[1] - u[1], (e + x[0]) * dx[2] + k * (x[2] - u[2])
        )
        self.graph = x, dx, u, rows

    def scales(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return np.zeros(0), np.ones(3), 1.0

    def target_at(self, x: np.ndarray) -> np.ndarray:
        return x


@pytest.mark.parametrize(
    ("m", "e", "k", "expected"),
    [
        (1.0, 0.0, 1.0, (1, 2)),
        (1.0, 0.9e-9, 1.0, (1, 2)),
        (1.0, 1.1e-9, 1.0, (0, 3)),  # above 1e-9 of the largest: no zero
        (0.8e-7, 0.9e-9, 1.0, None),  # a gap of 89
        (1e-7, 0.9e-9, 1.0, (1, 2)),  # of 111
        (1.0, 0.0, 0.0, None),  # a constraint of nothing
    ],
)
def test_equations_are_counted_at_rest(
    m: float, e: float, k: float, expected: tuple[int, int] | None
) -> None:
    """A row without derivatives is an algebraic equation."""
    system = StrangenessFree(ByHand(m, e, k), 0, np.zeros(3))  # type: ignore[arg-type]
    if expected is None:
        with pytest.raises(SolverError, match="of order 0 does not make the DAE regular: corank"):
            system.a  # noqa: B018, a property
        return
    assert (system.a, system.d) == expected
    assert system.gap == pytest.approx(m / max(e, 1e-300) if expected[0] else np.inf)


@pytest.mark.parametrize(("x", "clear"), [(0.0, True), (0.99e-2, True), (1.01e-2, False)])
def test_ranks_on_the_path_are_clear_from_a_gap_of_a_hundred_on(x: float, clear: bool) -> None:
    """A row that becomes differential on the path is seen."""
    system = StrangenessFree(ByHand(1.0, 0.0), 0, np.zeros(3))  # type: ignore[arg-type]
    X = np.zeros((3, 2))
    X[0, 0] = x
    if clear:
        assert system.split(X, np.zeros((3, 1))).gap == pytest.approx(1 / max(x, 1e-300))
        return
    with pytest.raises(SolverError, match="the rank of the derivative array changes on the path"):
        system.split(X, np.zeros((3, 1)))
