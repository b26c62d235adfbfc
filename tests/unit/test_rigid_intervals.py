"""What the intervals of rigid fits stand on: one filter for forces and accelerations, and blocks that are left out."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from flexgen.numerics.polynomial_filter import INNER, derivatives, smooth_forces
from flexgen.numerics.residual_statistics import covariance


def test_forces_pass_the_filter_of_accelerations() -> None:
    """A step of the acceleration, between two samples; the polynomials of the force itself are 9 % off there."""
    t = 1e-3 * (np.arange(101) - 50.4)
    found, mean = derivatives(np.abs(t) * t / 2, 1e-3)[2], smooth_forces(np.sign(t))
    assert_allclose(found[INNER], mean[INNER], atol=0.03)
    smooth = np.sin(20 * t)
    assert_allclose(derivatives(smooth, 1e-3)[2][INNER], -400 * smooth_forces(smooth)[INNER], atol=1e-2)
    assert_allclose(smooth_forces(np.ones((40, 2))), 1.0)


def test_scores_are_those_of_fits_without_a_block() -> None:
    """The covariance of blocks, by a fit without each of them."""
    rng = np.random.default_rng(0)
    X, weight, prior = list(rng.normal(size=(2, 60, 5))), np.array([1.0, 3.0]), np.array([0.0, 0.0, 4.0, 4.0, 0.0])
    y = rng.normal(size=(60, 2))
    W = np.repeat(weight, 60) ** 2
    rows, target = np.vstack(X), y.T.ravel()

    def fitted(kept: np.ndarray) -> np.ndarray:
        A = (rows[kept] * W[kept, None]).T @ rows[kept] + np.diag(prior)
        return np.linalg.solve(A, (rows[kept] * W[kept, None]).T @ target[kept])

    everything = fitted(np.full(120, True))
    error = (target - rows @ everything).reshape(2, 60).T
    H = np.linalg.inv((rows * W[:, None]).T @ rows + np.diag(prior))
    changes = [fitted(np.tile(np.arange(60) // 12 != b, 2)) - everything for b in range(5)]
    expected = np.einsum("bi,bj->ij", changes, changes) + H @ np.diag(prior) @ H
    assert_allclose(covariance(X, error, weight, prior, 12), expected, rtol=1e-6, atol=1e-12)
