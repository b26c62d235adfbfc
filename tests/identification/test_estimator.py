"""Laws of the estimator on drawn problems: closed forms, referees of SciPy, known covariances, and
planted errors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares, lsq_linear
from scipy.optimize import minimize as search_of_scipy
from scipy.signal import lfilter
from scipy.stats import norm, t

from flexgen.base.errors import SolverError
from flexgen.identification.estimator.covariance import Blocks, block_covariance, covariance_of
from flexgen.identification.estimator.layout import Layout
from flexgen.identification.estimator.minimize import Minimum, Search, minimize
from flexgen.identification.estimator.problem import (
    Huber,
    Prior,
    Problem,
    Squares,
    as_real,
    normal,
)
from flexgen.identification.estimator.residuals import rms, whiteness
from flexgen.identification.estimator.status import FitStatus, status_of_end
from flexgen.identification.estimator.validation import Errors, fails_elsewhere, parts_of, validate

SEARCHES = [Search(), Search(curvature=True), Search(curvature=True, bends=True)]
IDS = ["numbers", "curvature", "bends"]


def wide(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, -np.inf), np.full(n, np.inf)


@dataclass(frozen=True)
class Line:
    """A drawn linear problem ``J x - y`` with a prior whose numbers depend on each other."""

    J: np.ndarray
    y: np.ndarray
    prior: Prior

    @classmethod
    def drawn(cls, seed: int, n: int = 5, rows: int = 40) -> Line:
        rng = np.random.default_rng(seed)
        root = rng.normal(size=(n, n))
        prior = Prior(rng.normal(size=n), root @ root.T)
        return cls(rng.normal(size=(rows, n)), 3.0 * rng.normal(size=rows), prior)

    def problem(self, bounds: tuple[np.ndarray, np.ndarray] | None = None, **more) -> Problem:
        n = self.J.shape[1]
        return Problem(
            lambda x: self.J @ x - self.y, lambda x: self.J, self.prior, bounds or wide(n), **more
        )

    @property
    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and right side of the same problem without a prior."""
        root = np.linalg.cholesky(self.prior.information).T
        return np.vstack([self.J, root]), np.concatenate([self.y, root @ self.prior.center])


@pytest.mark.parametrize("search", SEARCHES, ids=IDS)
@pytest.mark.parametrize("seed", range(4))
def test_linear_problems_have_their_closed_form(seed: int, search: Search) -> None:
    """Normal equations by a QR decomposition; planted: the center of the prior is zero."""
    line = Line.drawn(seed)
    expected = np.linalg.lstsq(*line.stacked, rcond=None)[0]
    found = minimize(line.problem(), np.zeros(5), search)
    assert_allclose(found.x, expected, atol=1e-9)
    assert found.converged and not found.at_bound.any() and not found.wrong
    assert_allclose(found.A, line.J.T @ line.J, rtol=1e-12)
    assert found.cost == pytest.approx(float(((line.J @ expected - line.y) ** 2).sum()))
    planted = Line(line.J, line.y, Prior(np.zeros(5), line.prior.information))
    assert np.abs(minimize(planted.problem(), np.zeros(5), search).x - expected).max() > 1e-3


@pytest.mark.parametrize("search", SEARCHES, ids=IDS)
@pytest.mark.parametrize("seed", range(6))
def test_bounds_hold_what_would_leave_them_and_the_others_know(seed: int, search: Search) -> None:
    """Against the active sets of `scipy.optimize.lsq_linear`; planted: a step that is clipped."""
    line = Line.drawn(seed)
    rows, right = line.stacked
    free = np.linalg.lstsq(rows, right, rcond=None)[0]
    lower = np.full(5, -np.inf)
    upper = np.full(5, np.inf)
    lower[0] = free[0] + 0.5
    upper[1] = free[1] - 0.5
    lower[2] = free[2] - 9.0
    expected = lsq_linear(rows, right, (lower, upper), tol=1e-14).x
    start = np.clip(np.zeros(5), lower, upper)
    found = minimize(line.problem((lower, upper)), start, search)
    assert_allclose(found.x, expected, atol=2e-4)
    assert found.x[0] >= lower[0] and found.x[1] <= upper[1]
    assert found.at_bound.tolist() == [
        x in (a, b) for x, a, b in zip(found.x, lower, upper, strict=True)
    ]
    assert np.abs(np.clip(free, lower, upper) - expected).max() > 1e-2


@pytest.mark.parametrize("search", SEARCHES, ids=IDS)
@pytest.mark.parametrize("seed", range(4))
def test_curved_problems_agree_with_another_search(seed: int, search: Search) -> None:
    """Against `scipy.optimize.least_squares`, from a start that is far."""
    rng = np.random.default_rng(seed)
    A = 0.4 * rng.normal(size=(30, 3))
    b = rng.normal(size=30)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.exp(A @ x) - b

    def jacobian(x: np.ndarray) -> np.ndarray:
        return A * np.exp(A @ x)[:, None]

    start = rng.uniform(-2, 2, 3)
    expected = least_squares(residual, start, jacobian, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = minimize(Problem(residual, jacobian, Prior.nothing(3), wide(3)), start, search)
    assert found.converged
    # the search ends nearer than 1e-3 standard deviations
    away = found.x - expected.x
    assert away @ found.A @ away < 4e-6 and found.cost <= 2 * expected.cost + 2e-6


def valley(x: np.ndarray) -> np.ndarray:
    """Rosenbrock's."""
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def along_valley(x: np.ndarray) -> np.ndarray:
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


def in_valley(units: np.ndarray, search: Search) -> Minimum:
    """The minimum of Rosenbrock's valley, with numbers in other units."""
    problem = Problem(
        lambda x: valley(x * units),
        lambda x: along_valley(x * units) * units,
        Prior.nothing(2),
        wide(2),
    )
    return minimize(problem, np.array([-1.2, 1.0]) / units, search)


def test_the_sphere_of_the_curvature_does_not_depend_on_units() -> None:
    """Planted: the sphere of the numbers, which does."""
    units = np.array([1e4, 1e-3])
    own, other = (in_valley(each, SEARCHES[1]) for each in (np.ones(2), units))
    assert own.iterations == other.iterations and own.converged
    assert_allclose(own.x, other.x * units, rtol=1e-9)
    other = in_valley(units, Search())
    assert np.abs(other.x * units - own.x).max() > 0.1


def test_accelerations_shorten_the_way_through_a_bent_valley() -> None:
    """Narrower than Rosenbrock's: the bend costs a residual and saves half of the Jacobians."""
    narrow = 10.0
    jacobians = []
    for search in (Search(curvature=True, bends=bends, steps=1000) for bends in (False, True)):
        count = [0]

        def jacobian(x: np.ndarray, count: list[int] = count) -> np.ndarray:
            count[0] += 1
            return along_valley(x) * np.array([[narrow], [1.0]])

        problem = Problem(lambda x: valley(x) * [narrow, 1.0], jacobian, Prior.nothing(2), wide(2))
        found = minimize(problem, np.array([-1.2, 1.0]), search)
        assert_allclose(found.x, 1.0, atol=1e-2)
        jacobians.append(count[0])
    assert jacobians[1] < 0.7 * jacobians[0]


@pytest.mark.parametrize("search", SEARCHES, ids=IDS)
@pytest.mark.parametrize("rows", [1, 2])
def test_gross_errors_weigh_as_the_loss_of_huber_says(rows: int, search: Search) -> None:
    """Against a search of the stated loss; planted: squares."""
    line = Line.drawn(3, n=3)
    y = line.y.copy()
    y[:4] += 200.0
    line = Line(line.J, y, line.prior)
    k = 1.5
    s = 2.0

    def loss(x: np.ndarray) -> float:
        u = np.linalg.norm((line.J @ x - y).reshape(-1, rows), axis=1) / s
        away = x - line.prior.center
        each = np.where(u > k, 2 * k * u - k**2, u**2)
        return float(each.sum() + away @ line.prior.information @ away)

    huber = Huber(k, rows, lambda r: s)
    found = minimize(line.problem(loss=huber), np.zeros(3), search)
    expected = search_of_scipy(loss, np.zeros(3), options={"gtol": 1e-9}).x
    assert found.converged and loss(found.x) == pytest.approx(loss(expected), rel=1e-6)
    assert found.objective == pytest.approx(loss(found.x), rel=1e-9)
    squares = minimize(line.problem(loss=Squares(lambda r: s)), np.zeros(3), search)
    assert loss(squares.x) > 1.02 * loss(found.x)


def test_a_group_of_points_weighs_as_its_points() -> None:
    """Without gross errors all losses are squares; with a gross group it counts less."""
    r = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.1])
    one = Huber(2.0, 3)
    two = Huber(2.0, 6, points=2)
    assert one.value(r, 1.0) == pytest.approx(r @ r) == pytest.approx(two.value(r, 1.0))
    assert two.value(100 * r, 1.0) < 0.1 * 100**2 * (r @ r)
    assert two.value(100 * r, 50.0) == pytest.approx(4 * (r @ r))
    for loss in (one, two):
        roots = loss.roots(100 * r, 1.0)
        step = 1e-6 * np.array([1.0, 2.0, -1.0, 0.5, 0.3, -0.7])
        slope = (loss.value(100 * r + step, 1.0) - loss.value(100 * r - step, 1.0)) / 2
        assert slope == pytest.approx(2 * float((roots**2 * 100 * r) @ step), rel=1e-5)


def test_a_scale_that_follows_the_residuals_settles() -> None:
    """The weight of the prior is that of the errors which are left; planted: that of the first
    ones.
    """
    line = Line.drawn(5)
    follows = Squares(lambda r: float(np.sqrt(r @ r / len(r))))
    found = minimize(line.problem(loss=follows), np.full(5, 30.0))
    r = line.J @ found.x - line.y
    variance = float(r @ r / len(r))
    P = line.prior.information
    right = line.J.T @ line.y / variance + P @ line.prior.center
    expected = np.linalg.solve(line.J.T @ line.J / variance + P, right)
    assert_allclose(found.x, expected, atol=1e-3)
    first = line.J @ np.full(5, 30.0) - line.y
    stays = minimize(
        line.problem(loss=Squares(lambda r: float(np.sqrt(first @ first / 40)))), r[:5]
    )
    assert np.abs(stays.x - expected).max() > 1e-1


@pytest.mark.parametrize("stiff", [0.05, 2.0, 1e3])
def test_a_step_is_the_minimum_within_the_sphere(stiff: float) -> None:
    """Optimal: (A + shift) s = -g with shift >= 0, and on the sphere of 0.5 (within 5 %) where
    shift > 0.
    """
    line = Line.drawn(4, n=4)
    line = Line(line.J * stiff, line.y, Prior.nothing(4))
    step = minimize(line.problem(), np.zeros(4), Search(steps=1)).x
    A = line.J.T @ line.J
    g = -line.J.T @ line.y
    rest = -(A @ step + g)
    shift = float(rest @ step / (step @ step))
    assert_allclose(rest, shift * step, atol=1e-9 * max(1, np.abs(g).max()))
    full = np.linalg.solve(A, -g)
    if np.linalg.norm(full) <= 0.5:
        assert_allclose(step, full, rtol=1e-9)
    else:
        assert shift > 0 and abs(np.linalg.norm(step) / 0.5 - 1) <= 0.05


def test_steps_to_where_there_is_no_solution_are_refused() -> None:
    """Of a root; at the start the error is the caller's."""

    def residual(x: np.ndarray) -> np.ndarray:
        if x[0] <= 0.0:
            raise SolverError("none")
        return np.array([np.log(x[0]) + 3.0])

    problem = Problem(residual, lambda x: 1.0 / x[None], Prior.nothing(1), wide(1))
    for search in SEARCHES:
        found = minimize(problem, np.array([2.0]), search)
        assert found.converged and found.x[0] == pytest.approx(np.exp(-3.0), rel=2e-3)
    with pytest.raises(SolverError, match="none"):
        minimize(problem, np.array([-1.0]))


def test_searches_that_have_no_end_say_so() -> None:
    """By steps, and by residuals that stay large."""
    few = in_valley(np.ones(2), Search(steps=2))
    assert not few.converged and few.iterations == 2
    told: list[int] = []
    in_valley(np.ones(2), Search(steps=3, tell=lambda n, here: told.append(n)))
    assert told == [1, 2, 3]

    def stays(x: np.ndarray) -> np.ndarray:
        return np.array([100.0, 1e-3 * np.exp(-x[0])])

    slow = Problem(
        stays, lambda x: np.array([[0.0], [-1e-3 * np.exp(-x[0])]]), Prior.nothing(1), wide(1)
    )
    begin = np.array([-60.0])
    found = minimize(slow, begin, Search(count=2))
    assert not found.wrong or found.iterations > 10
    flat = Problem.of_sums(
        lambda x: (1e4 - 1e-3 * x[0], np.array([-5e-4]), np.zeros((1, 1)) + 1e-9),
        lambda x: 1e4 - 1e-3 * x[0],
        Prior.nothing(1),
        wide(1),
    )
    assert minimize(flat, np.zeros(1), Search(count=2)).wrong
    assert not minimize(flat, np.zeros(1), Search(count=2000)).wrong


def test_a_relative_gain_ends_a_search_early() -> None:
    """Its objective is within the promised part of the least one."""
    A, b = np.random.default_rng(1).normal(size=(2, 20, 2))
    problem = Problem(
        lambda x: np.exp(A @ x) - b[:, 0] - 3.0,
        lambda x: A * np.exp(A @ x)[:, None],
        Prior.nothing(2),
        wide(2),
    )
    early, late = (minimize(problem, np.zeros(2), Search(gain=gain)) for gain in (0.01, 0.0))
    assert early.converged and early.iterations < late.iterations
    assert late.objective < early.objective < 1.02 * late.objective


def test_sums_and_residuals_state_the_same_problem() -> None:
    """Complex residuals count by their real and imaginary parts."""
    rng = np.random.default_rng(2)
    J = rng.normal(size=(20, 3, 2)) @ [1, 1j]
    y = rng.normal(size=(20, 2)) @ [1, 1j]
    r = J @ np.zeros(3) - y
    value, slope, matrix = normal(r, J)
    assert value == pytest.approx(float(np.vdot(r, r).real))
    assert_allclose(slope, (J.conj().T @ r).real)
    assert_allclose(matrix, (J.conj().T @ J).real)
    real, rows = as_real(r, J)
    prior = Prior.of_sd(np.zeros(3), np.full(3, 2.0))
    by_sums = Problem.of_sums(
        lambda x: normal(J @ x - y, J),
        lambda x: float((np.abs(J @ x - y) ** 2).sum()),
        prior,
        wide(3),
    )
    by_rows = Problem(lambda x: rows @ x + real, lambda x: rows, prior, wide(3))
    assert_allclose(minimize(by_sums, np.ones(3)).x, minimize(by_rows, np.ones(3)).x, rtol=1e-9)


def test_a_prior_by_deviations_is_one_by_information() -> None:
    prior = Prior.of_sd(np.array([1.0, 2.0]), np.array([0.5, np.inf]))
    x = np.array([2.0, 7.0])
    assert prior.value(x) == 4.0 and prior.slope(x).tolist() == [4.0, 0.0]
    assert Prior.nothing(2).value(x) == 0.0


def correlated(rng: np.random.Generator, n: int, fade: float) -> np.ndarray:
    """Noise whose neighbors are alike."""
    return np.asarray(lfilter([1.0], [1.0, -fade], rng.normal(size=n)))


def test_deviations_are_those_of_repeated_fits() -> None:
    """With noise of 10 samples of memory; planted: blocks of one sample are too sure."""
    rng = np.random.default_rng(4)
    n = 1000
    block = 50
    J = np.column_stack([np.ones(n), np.sin(np.arange(n) / 40.0), np.linspace(-1, 1, n)])
    errors = []
    long = []
    short = []
    for _ in range(100):
        y = correlated(rng, n, 0.9)
        x = np.linalg.lstsq(J, y, rcond=None)[0]
        r = y - J @ x
        errors.append(x)
        for size, kept in ((block, long), (1, short)):
            found = block_covariance(J, r, range(0, n, size), np.zeros((3, 3)))
            kept.append(np.sqrt(np.diag(found)))
    scatter = np.std(errors, axis=0)
    assert_allclose(np.mean(long, axis=0) / scatter, 1.0, atol=0.2)
    assert (np.mean(short, axis=0) < 0.4 * scatter).all()
    inside = np.mean(np.abs(errors) < 1.96 * np.array(long))
    assert 0.92 < inside < 0.985


def test_changes_are_those_of_fits_without_each_block() -> None:
    """Refits by hand; Student's factors are those of 8 blocks that know as much, at least."""
    line = Line.drawn(9, rows=80)
    rows, right = line.stacked
    x = np.linalg.lstsq(rows, right, rcond=None)[0]
    starts = np.arange(0, 80, 10)
    changes = []
    for first in starts:
        kept = np.r_[0:first, first + 10 : len(rows)]
        changes.append(np.linalg.lstsq(rows[kept], right[kept], rcond=None)[0] - x)
    P = line.prior.information
    found = block_covariance(line.J, line.J @ x - line.y, starts, P)
    H = np.linalg.inv(line.J.T @ line.J + P)
    plain = np.transpose(changes) @ changes + H @ P @ H
    # eight blocks have eight degrees of freedom
    wider = (t.ppf(0.975, 8) / norm.ppf(0.975)) ** 2
    alone = block_covariance(line.J, line.J @ x - line.y, starts, P, by_axis=False)
    assert_allclose(alone, wider * (plain - H @ P @ H) + H @ P @ H, rtol=1e-6)
    sizes = np.linalg.eigvals(np.linalg.solve(plain, found)).real
    assert sizes.min() > 1.0 and sizes.max() < 2.0
    many = np.tile(np.eye(2), (400, 1, 1))
    scores = np.random.default_rng(0).normal(size=(400, 2))
    found = covariance_of(Blocks(many, scores), np.zeros((2, 2)))
    assert_allclose(found, scores.T @ scores / 399**2, rtol=0.01)


def test_a_block_that_determines_a_number_alone_has_the_errors_of_its_weights() -> None:
    """Its residuals vanish in every fit; planted: they count, and the number seems to be exact."""
    rng = np.random.default_rng(6)
    J = rng.normal(size=(60, 3))
    y = rng.normal(size=60)
    J[:, 2] = 0.0
    J[7] = [0.0, 0.0, 2.0]
    x = np.linalg.lstsq(J, y, rcond=None)[0]
    r = J @ x - y
    assert abs(r[7]) < 1e-9
    found = block_covariance(J, r, range(0, 60, 1), np.zeros((3, 3)))
    exact = np.linalg.inv(J.T @ J)
    assert 0.5 < np.sqrt(found[2, 2] / exact[2, 2]) < 8.0
    others = block_covariance(
        np.delete(J, 7, 0)[:, :2], np.delete(r, 7), range(59), np.zeros((2, 2))
    )
    assert_allclose(np.diag(found)[:2], np.diag(others), rtol=0.1)


def test_covariances_do_not_depend_on_units_and_numbers_without_information_have_none() -> None:
    """Of outputs that are summed one by one, too."""
    rng = np.random.default_rng(1)
    J = rng.normal(size=(60, 2, 3))
    r = rng.normal(size=(60, 2))
    units = np.array([1e6, 1.0, 1e-6])
    starts = range(0, 60, 6)
    own = block_covariance(J, r, starts, np.eye(3))
    other = block_covariance(J * units, r, starts, np.diag(units**2))
    assert_allclose(other * np.outer(units, units), own, rtol=1e-6)
    both = Blocks.of_outputs([2 * J[:, 0], J[:, 1]], r / [0.5, 1.0], np.array([0.5, 1.0]), 6)
    assert_allclose(covariance_of(both, np.eye(3)), own, rtol=1e-9)
    assert_allclose(covariance_of(both.over(units), np.diag(units**2)), other, rtol=1e-6)
    none = np.concatenate([J, np.zeros((60, 2, 1))], axis=2)
    found = block_covariance(none, r, starts, np.zeros((4, 4)))
    assert np.isfinite(found).all() and not found[3].any()
    assert_allclose(found[:3, :3], block_covariance(J, r, starts, np.zeros((3, 3))), rtol=1e-6)


def test_parts_are_judged_by_the_fit_to_the_others() -> None:
    """Planted: the fit to all parts, whose errors are smaller."""
    data = [np.array([1.0, 2.0]), np.array([3.0]), np.array([5.0])]

    def errors(kept: Callable[[list[np.ndarray]], list[np.ndarray]]) -> list[np.ndarray]:
        found = validate(
            data, lambda parts: float(np.concatenate(kept(parts)).mean()), lambda mean, x: x - mean
        )
        assert found is not None
        return found

    right = errors(lambda parts: parts)
    planted = errors(lambda parts: data)
    assert [x.tolist() for x in right] == [[-3.0, -2.0], [3.0 - 8 / 3], [3.0]]
    assert sum(float(x @ x) for x in planted) < sum(float(x @ x) for x in right)
    assert parts_of([10, 7], 3) == [
        (0, slice(0, 3)), (0, slice(3, 6)), (0, slice(6, 10)),
        (1, slice(0, 2)), (1, slice(2, 4)), (1, slice(4, 7)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rms_there", "relative_there", "small", "fails"),
    [(2.1, 0.21, 0.1, True), (1.9, 0.21, 0.1, False), (2.1, 0.19, 0.1, False),
     (2.1, 0.21, 0.3, False)],
)  # fmt: skip
def test_a_model_fails_elsewhere_where_all_three_signs_agree(
    rms_there: float, relative_there: float, small: float, fails: bool
) -> None:
    fitted = Errors(np.array([1.0]), np.array([0.1]))
    there = Errors(np.array([rms_there]), np.array([relative_there]))
    assert fails_elsewhere(fitted, there, small).tolist() == [fails]


@dataclass(frozen=True)
class Spring(Layout):
    stiffness: slice
    none: slice
    damping: slice


def test_a_layout_names_every_entry_once() -> None:
    layout = Spring.of(stiffness=3, none=0, damping=2)
    assert layout.size == 5
    entries = np.concatenate([layout.entries(part) for part in layout.parts.values()])
    assert entries.tolist() == list(range(5))
    x = layout.join(damping=np.array([1.0, 2.0]), stiffness=7.0)
    assert x[layout.damping].tolist() == [1.0, 2.0] and x[layout.stiffness].tolist() == [7.0] * 3
    with pytest.raises(TypeError, match="expected"):
        Spring.of(stiffness=1, damping=1)


def test_statuses_are_texts_that_explain_themselves() -> None:
    own = {FitStatus.MODEL_ERROR: ("Wrong mass.", "Weigh it.")}
    for status in FitStatus:
        assert str(status) == f"{status}" == status.value
        assert status.sentence.endswith(".") and status.advice.endswith(".")
        wanted = own.get(status, (status.sentence, status.advice))
        assert status.texts(own) == wanted
        assert status_of_end(status, "") is status
        assert status_of_end(status, "time limit") is FitStatus.TIME_LIMIT
    assert {s for s in FitStatus if s.ended_early} == {FitStatus.TIME_LIMIT, FitStatus.INTERRUPTED}
    assert {s for s in FitStatus if s.agrees} == {FitStatus.FITTED, FitStatus.SMALL_ERROR}


def test_sizes_of_residuals_are_those_of_samples_that_move() -> None:
    error = np.array([[3.0, 1.0], [4.0, 1.0], [100.0, 1.0]])
    moving = np.array([[True, False], [True, False], [False, False]])
    found = rms(error, moving)
    assert found[0] == pytest.approx(np.sqrt(12.5)) and np.isnan(found[1])


def test_white_noise_is_white_and_other_noise_is_not() -> None:
    """Residuals of white noise are white although they are orthogonal to the columns fitted in
    each segment; those of correlated noise are not.
    """
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(40, 50, 4)))[0]
    noise = rng.normal(size=(40, 50))
    left = noise - np.einsum("snk,sk->sn", Q, np.einsum("snk,sn->sk", Q, noise))
    assert whiteness(left[..., None], Q)[0] > 0.85
    colored = np.stack([correlated(rng, 50, 0.5) for _ in range(40)])
    assert whiteness(colored[..., None], np.zeros((40, 50, 0)))[0] < 0.9
