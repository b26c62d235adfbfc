"""Quadratic programs with bounded differences, against OSQP and optimality conditions."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import numpy as np
import osqp
import pytest
from numpy.testing import assert_allclose
from scipy.sparse import csc_matrix, diags_array, triu, vstack

from flexgen.base.numerics import bounded_differences
from flexgen.base.numerics.bounded_differences import DIFFERENCES, solve_bounded_differences
from flexgen.feedback.positions.samples import basis, fit_samples, fit_within

PERIOD = 4e-3
# Of each bound, of the largest speed and acceleration of the samples without bounds; None: no
# bound.
SHARES = [(0.9, None), (0.5, None), (None, 0.9), (None, 0.02), (0.9, 0.9)]
Reference = tuple[csc_matrix, np.ndarray]


def point_to_point(n: int = 600) -> Reference:
    """Interpolation and reference (8 n + 1, 1) of a move of 48 rad in half of n periods.

    At rest before and after.
    """
    instants = PERIOD / 8 * np.arange(8 * n + 1)
    s = np.clip((instants / (PERIOD * n) - 0.25) * 2.0, 0.0, 1.0)
    r = 48.0 * (s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3))[:, None]
    return basis(instants, PERIOD * np.arange(n + 1), "linear"), r


def bounds_of(
    B: csc_matrix, r: np.ndarray, shares: tuple[float | None, float | None]
) -> dict[int, float]:
    """Bounds of the differences of one joint, by their order."""
    free = fit_samples(B, r)[:, 0]
    return {
        n: share * float(np.abs(np.diff(free, n)).max())
        for n, share in enumerate(shares, 1)
        if share is not None
    }


def differences(k: int, bounds: dict[int, float]) -> csc_matrix:
    return csc_matrix(
        vstack(
            [
                diags_array(DIFFERENCES[n], offsets=range(n + 1), shape=(k - n, k)) / bound
                for n, bound in bounds.items()
            ]
        )
    )


def by_osqp(B: csc_matrix, r: np.ndarray, bounds: dict[int, float]) -> np.ndarray:
    """Samples of OSQP, polished; its own step size is poor for second differences."""
    own = r[:, 0] - r[0, 0]
    scale = float(np.abs(own).max())
    A = differences(B.shape[1], {n: bound / scale for n, bound in bounds.items()})
    one = np.ones(A.shape[0])
    for eps, rho in itertools.product((1e-4, 1e-6, 1e-8), (0.1, 10.0, 1e3)):
        solver = osqp.OSQP()
        solver.setup(
            P=csc_matrix(triu(B.T @ B)), q=-(B.T @ (own / scale)), A=A, l=-one, u=one,
            verbose=False, polishing=True, polish_refine_iter=10, delta=1e-9, max_iter=20_000,
            eps_abs=eps, eps_rel=eps, rho=rho,
        )  # fmt: skip
        found = solver.solve(raise_error=False)
        if found.info.status_polish == 1:
            return scale * np.asarray(found.x) + r[0, 0]
    raise AssertionError("OSQP has no polished solution")


def limits_of(bounds: dict[int, float]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The arguments of `fit_within`; it keeps 1e-9 of each bound as slack."""
    speed, acceleration = (
        np.array([bounds[n] / PERIOD**n / (1 - 1e-9)]) if n in bounds else None for n in (1, 2)
    )
    return speed, acceleration


@pytest.mark.parametrize("shares", SHARES)
def test_samples_are_those_of_osqp(shares: tuple[float | None, float | None]) -> None:
    B, r = point_to_point(150)
    bounds = bounds_of(B, r, shares)
    found = fit_within(B, r, PERIOD, limits_of(bounds))[:, 0]
    assert_allclose(found, by_osqp(B, r, bounds), rtol=0.0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("shares", SHARES)
def test_long_tables_are_those_of_osqp_and_fast(shares: tuple[float | None, float | None]) -> None:
    """600 samples of a joint: IPOPT took 54 to 111 ms of processor time."""
    B, r = point_to_point()
    bounds = bounds_of(B, r, shares)
    limits = limits_of(bounds)
    found = np.empty(0)
    spent = np.inf
    for _ in range(5):
        begin = time.process_time()
        found = fit_within(B, r, PERIOD, limits)[:, 0]
        spent = min(spent, time.process_time() - begin)
    assert_allclose(found, by_osqp(B, r, bounds), rtol=0.0, atol=1e-8)
    # 2 to 5 ms measured; four times as much on a slow machine
    assert spent < 0.02


@pytest.mark.parametrize("heavy", [0.0, 1e6])
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_rows_that_stay_unknowns_and_rows_that_are_removed_agree(
    interpolation: str, heavy: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All rows stay unknowns with a weight of 0, some of them with the others."""
    instants = PERIOD / 4 * np.arange(4 * 80 + 1)
    B = basis(instants, PERIOD * np.arange(81), interpolation)
    r = np.sin(40.0 * instants) + 0.2 * np.sin(190.0 * instants)
    H = csc_matrix(B.T @ B)
    g = -(B.T @ r)
    free = fit_samples(B, r[:, None])[:, 0]
    bounds = {n: np.full(81 - n, 0.4 * np.abs(np.diff(free, n)).max()) for n in (1, 2)}
    found = solve_bounded_differences(H, g, bounds)
    monkeypatch.setattr(bounded_differences, "HEAVY", heavy)
    other = solve_bounded_differences(H, g, bounds)
    assert found is not None
    assert other is not None
    assert_allclose(other, found, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("orders", [(1,), (1, 2), (2, 1)])
def test_two_and_three_samples_with_a_bound_at_each_difference(orders: tuple[int, ...]) -> None:
    """Bounds of 1e-6 leave the mean of the samples free, which is that of the reference."""
    for k in (2, 3):
        H = csc_matrix(np.eye(k))
        g = -(np.arange(k, dtype=float) ** 2)
        bounds = {n: np.full(k - n, 1e-6) for n in orders}
        found = solve_bounded_differences(H, g, bounds)
        assert found is not None
        assert_allclose(found, -g.mean(), atol=1e-5)


@pytest.mark.parametrize("interpolation", ["hold", "linear", "cubic"])
def test_bounds_of_six_orders_of_magnitude_are_kept(interpolation: str) -> None:
    rng = np.random.default_rng(7)
    instants = PERIOD / 4 * np.arange(4 * 60 + 1)
    B = basis(instants, PERIOD * np.arange(61), interpolation)
    r = np.cumsum(rng.standard_normal((241, 3)) * [[1e-3, 1.0, 1e3]], axis=0)
    free = fit_samples(B, r)
    for share in (1e-4, 1e-2, 0.5, 2.0, 100.0):
        speed = share * np.abs(np.diff(free, axis=0)).max(axis=0) / PERIOD
        acceleration = share * np.abs(np.diff(free, 2, axis=0)).max(axis=0) / PERIOD**2
        found = fit_within(B, r, PERIOD, (speed, acceleration))
        assert (np.abs(np.diff(found, axis=0)) <= speed * PERIOD).all()
        assert (np.abs(np.diff(found, 2, axis=0)) <= acceleration * PERIOD**2).all()
        if share > 1.0:
            assert_allclose(found, free, atol=1e-8 * np.abs(r).max())


Change = Callable[[pytest.MonkeyPatch], None]


def stop_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_differences, "STEPS", 5)


def end_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_differences, "ENDED", 1e-3)


@pytest.mark.parametrize("change", [stop_early, end_early])
def test_a_point_that_is_not_optimal_is_refused(
    change: Change, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: searches that end too early."""
    B, r = point_to_point(150)
    H = csc_matrix(B.T @ B)
    g = -(B.T @ (r[:, 0] - r[0, 0]))
    bounds = {n: np.full(151 - n, b) for n, b in bounds_of(B, r, (0.9, 0.8)).items()}
    assert solve_bounded_differences(H, g, bounds) is not None
    change(monkeypatch)
    assert solve_bounded_differences(H, g, bounds) is None


@pytest.mark.parametrize("bad", [np.nan, 0.0, -1.0, np.inf])
def test_bounds_that_are_not_positive_numbers_have_no_result(bad: float) -> None:
    B, r = point_to_point(20)
    bound = np.full(20, 1.0)
    bound[3] = bad
    assert solve_bounded_differences(csc_matrix(B.T @ B), -(B.T @ r[:, 0]), {1: bound}) is None
