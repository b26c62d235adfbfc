"""The trust region: linear fits against SciPy, optimal steps within the sphere, and how a search
ends.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import lsq_linear

from flexgen.base.errors import SolverError
from flexgen.identification.estimator import minimize as search
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import Prior, Problem, normal

Residual = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
FREE = 1e6


def fit(residual: Residual, x: list[float], **more: object) -> tuple[Minimum, list[np.ndarray]]:
    """A fit without prior, and the points whose sums it asked for."""
    visited: list[np.ndarray] = []

    def sums(x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        visited.append(x.copy())
        r, J = residual(x)
        return float(r @ r), J.T @ r, J.T @ J

    def cost(x: np.ndarray) -> float:
        r, _ = residual(x)
        return float(r @ r)

    n = len(x)
    bounds = (np.full(n, -99.0), np.full(n, 99.0))
    given = {"center": np.zeros(n), "sd": np.full(n, FREE), "bounds": bounds, **more}
    prior = Prior.of_sd(given.pop("center"), given.pop("sd"))
    problem = Problem.of_sums(sums, given.pop("cost", cost), prior, given.pop("bounds"))
    found = minimize(problem, np.array(x), Search(**given))
    return found, visited


def linear(J: np.ndarray, d: np.ndarray) -> Residual:
    return lambda x: (J @ x - d, J)


def rosenbrock(unexplained: float = 0.0) -> Residual:
    """A curved valley, and a residual that no parameter changes."""
    return lambda x: (
        np.array([10 * (x[1] - x[0] ** 2), 1 - x[0], unexplained]),
        np.array([[-20 * x[0], 10.0], [-1.0, 0.0], [0.0, 0.0]]),
    )


@pytest.mark.parametrize("bound", ["none", "lower", "upper"])
@pytest.mark.parametrize("seed", [3, 4])
def test_a_linear_fit_with_prior_and_bounds_is_that_of_scipy(bound: str, seed: int) -> None:
    chance = np.random.default_rng(seed)
    J = chance.normal(size=(8, 3))
    d = 4 * chance.normal(size=8)
    center = chance.normal(size=3)
    sd = chance.uniform(0.5, 5.0, 3)
    whole = np.vstack([J, np.diag(1 / sd)])
    wanted = np.r_[d, center / sd]
    free = np.linalg.lstsq(whole, wanted, rcond=None)[0]
    lower = np.full(3, -20.0)
    upper = np.full(3, 20.0)
    if bound == "lower":
        lower[0] = free[0] + 0.3
    if bound == "upper":
        upper[1] = free[1] - 0.2
    found, _ = fit(
        linear(J, d),
        [20.0, -20.0, 0.0],
        center=center,
        sd=sd,
        bounds=(lower, upper),
        distance=1e-9,
    )
    expected = lsq_linear(whole, wanted, (lower, upper), method="bvls").x
    assert found.converged
    assert_allclose(found.x, expected, atol=1e-8)
    assert_allclose(found.cost, np.sum((J @ expected - d) ** 2), rtol=1e-8)
    prior = np.sum(((expected - center) / sd) ** 2)
    assert_allclose(found.objective, found.cost + prior, rtol=1e-8)
    assert_array_equal(found.at_bound, (found.x <= lower) | (found.x >= upper))
    assert_allclose(found.A, J.T @ J, rtol=1e-14)


def test_a_fit_at_a_corner_ends_at_once() -> None:
    corner = (np.zeros(2), np.zeros(2))
    found, _ = fit(linear(np.eye(2), np.array([-5.0, 5.0])), [0.0, 0.0], bounds=corner)
    assert found.converged and found.iterations == 1 and found.at_bound.all()
    assert found.cost == 50.0


@pytest.mark.parametrize("seed", range(4))
def test_each_step_is_the_minimum_within_a_sphere(seed: int) -> None:
    """Referee: (A + shift I) s = -g with shift >= 0 is the condition of the optimum.

    The minimum is far away, so that several steps end on spheres; the last one is that of Newton.
    """
    chance = np.random.default_rng(seed)
    J = chance.normal(size=(6, 4))
    d = 10 * chance.normal(size=6)
    wide = (np.full(4, -1e5), np.full(4, 1e5))
    found, visited = fit(linear(J, d), [0.0] * 4, bounds=wide)
    A = J.T @ J
    shifts = []
    for x, after in pairwise(visited):
        step = after - x
        rest = -(A @ step + J.T @ (J @ x - d))
        shift = float(rest @ step / (step @ step))
        assert_allclose(rest, shift * step, atol=1e-6 * np.abs(J.T @ d).max())
        assert shift > -1e-6
        shifts.append(shift)
    assert shifts[0] > 1e-3 > abs(shifts[-1])
    assert_allclose(found.x, np.linalg.lstsq(J, d, rcond=None)[0], atol=1e-6)


def test_directions_without_curvature_do_not_make_a_step_infinite() -> None:
    found, _ = fit(linear(np.diag([2.0, 0.0]), np.array([-1.0, 0.0])), [0.0, 0.0])
    assert_allclose(found.x, [-0.5, 0.0], atol=1e-8)


def test_the_radius_doubles_on_a_long_way_and_stays_below_its_limit() -> None:
    found, visited = fit(linear(np.eye(2), np.array([30.0, 40.0])), [0.0, 0.0])
    lengths = [float(np.linalg.norm(b - a)) for a, b in pairwise(visited)]
    limit = search.LARGEST_RADIUS
    expected = [min(search.RADIUS * 2.0**k, limit) for k in range(len(lengths))]
    # A step ends within 5 % of its sphere.
    assert_allclose(lengths[:-1], expected[:-1], rtol=0.051)
    assert_allclose(found.x, [30.0, 40.0], atol=1e-6)


def test_a_curved_valley_is_followed_and_bad_steps_are_refused() -> None:
    """Rosenbrock's function; where the model has no solution (y > 1.2) a step is made shorter."""
    asked: list[np.ndarray] = []

    def cost(x: np.ndarray) -> float:
        asked.append(x.copy())
        if x[1] > 1.2:
            raise SolverError("none")
        return float(np.sum(rosenbrock()(x)[0] ** 2))

    found, visited = fit(rosenbrock(), [-1.2, 1.0], cost=cost)
    assert found.converged and found.iterations == len(asked) + 1
    assert_allclose(found.x, 1.0, atol=1e-5)
    # Some steps were refused, and each accepted one lowers the cost.
    assert len(visited) - 1 < len(asked)
    assert np.all(np.diff([np.sum(rosenbrock()(x)[0] ** 2) for x in visited]) < 0)


def test_a_search_with_a_wrong_model_stops_where_it_gains_little() -> None:
    """A residual that no parameter explains, far above the noise: the search ends early; one as
    large as the noise: it converges.
    """
    wrong, _ = fit(rosenbrock(100.0), [-1.2, 1.0], count=3)
    right, _ = fit(rosenbrock(1.0), [-1.2, 1.0], count=3)
    assert wrong.wrong and not wrong.converged and wrong.iterations < right.iterations
    assert right.converged and not right.wrong
    assert_allclose(right.x, 1.0, atol=1e-5)


def test_a_cost_that_never_falls_ends_the_fit() -> None:
    """The gradient is wrong: the radius becomes a quarter each time until the fit ends."""
    asked: list[float] = []

    def cost(x: np.ndarray) -> float:
        asked.append(float(x[0]))
        return 2.0 + abs(float(x[0]))

    wrong = linear(np.array([[1.0]]), np.array([-1.0]))
    found, _ = fit(wrong, [0.0], cost=cost)
    assert found.x == 0.0 and found.cost == 1.0
    ratios = np.array(asked[1:6]) / asked[:5]
    assert_allclose(ratios, 0.25, rtol=0.11)


@pytest.mark.parametrize(
    ("kind", "factor"), [("refused", 0.25), ("no solution", 0.25), ("poor", 0.5)]
)
def test_the_radius_shrinks_by_the_quality_of_a_step(kind: str, factor: float) -> None:
    """A cost that rises, one that has no value, and one that falls by a tenth of what is
    expected.
    """
    residual = linear(np.eye(1), np.array([40.0]))
    asked: list[float] = []

    def cost(x: np.ndarray) -> float:
        before = asked[-1] if asked and kind == "poor" else 0.0
        asked.append(float(x[0]))
        if len(asked) > 5:
            return float((x[0] - 40.0) ** 2)
        if kind == "no solution":
            raise SolverError("none")
        if kind == "refused":
            return 1e9
        return 0.9 * (before - 40.0) ** 2 + 0.1 * (x[0] - 40.0) ** 2

    found, _ = fit(residual, [0.0], cost=cost)
    lengths = np.diff([0.0, *asked[:5]]) if kind == "poor" else np.array(asked[:5])
    assert_allclose(lengths, 0.5 * factor ** np.arange(5.0), rtol=0.25)
    assert_allclose(found.x, 40.0, atol=1e-6)


def test_sums_of_complex_residuals_are_those_of_their_parts() -> None:
    """Referee: the square of the size, and the real parts of J^H r and J^H J."""
    chance = np.random.default_rng(5)
    r = chance.normal(size=(2, 4)) + 1j * chance.normal(size=(2, 4))
    J = chance.normal(size=(2, 4, 3)) + 1j * chance.normal(size=(2, 4, 3))
    value, g, A = normal(r, J)
    assert_allclose(value, np.sum(np.abs(r) ** 2))
    assert_allclose(g, np.einsum("abn,ab->n", J.conj(), r).real)
    assert_allclose(A, np.einsum("abm,abn->mn", J.conj(), J).real)


def test_residuals_that_do_not_move_end_a_search_of_a_wrong_model() -> None:
    """After three steps that gain next to nothing, where their mean square is far above noise; a
    search without a count of the residuals continues.
    """

    def residual(x: np.ndarray) -> np.ndarray:
        return np.append(np.full(10, 10.0), np.exp(-0.05 * x))

    def slopes(x: np.ndarray) -> np.ndarray:
        return np.append(np.zeros((10, 1)), [-0.05 * np.exp(-0.05 * x)], axis=0)

    free = np.full(1, np.inf)
    problem = Problem(residual, slopes, Prior.nothing(1), (-free, free))
    short = minimize(problem, np.zeros(1), Search(count=10))
    assert short.wrong and not short.converged and short.iterations == 3
    long = minimize(problem, np.zeros(1), Search())
    assert not long.wrong and long.iterations > 10
