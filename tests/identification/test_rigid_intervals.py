"""Basis of the intervals of rigid fits: one filter for forces and accelerations, and blocks that
are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moves_with_stiction import poses
from numpy.testing import assert_allclose
from scipy.stats import t as student

import flexgen
from flexgen.base.numerics.polynomial_filter import INNER, derivatives, smooth_forces
from flexgen.identification.estimator.covariance import Blocks, covariance_of
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.rigid.feasible_motors import is_possible
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.identification.rigid.rigid_regressor import Motion


def test_forces_pass_the_filter_of_accelerations() -> None:
    """A step of the acceleration, between two samples; the polynomials of the force itself are 9 %
    off there.
    """
    t = 1e-3 * (np.arange(101) - 50.4)
    found = derivatives(np.abs(t) * t / 2, 1e-3)[2]
    mean = smooth_forces(np.sign(t))
    assert_allclose(found[INNER], mean[INNER], atol=0.03)
    smooth = np.sin(20 * t)
    assert_allclose(
        derivatives(smooth, 1e-3)[2][INNER], -400 * smooth_forces(smooth)[INNER], atol=1e-2
    )
    assert_allclose(smooth_forces(np.ones((40, 2))), 1.0)


def test_scores_are_those_of_fits_without_a_block() -> None:
    """The covariance of blocks, by a fit without each of them; along principal axes with Student's
    quantiles.
    """
    rng = np.random.default_rng(0)
    X = list(rng.normal(size=(2, 60, 5)))
    weight = np.array([1.0, 3.0])
    prior = np.array([0.0, 0.0, 4.0, 4.0, 0.0])
    y = rng.normal(size=(60, 2))
    W = np.repeat(weight, 60) ** 2
    rows = np.vstack(X)
    target = y.T.ravel()

    def fitted(kept: np.ndarray) -> np.ndarray:
        A = (rows[kept] * W[kept, None]).T @ rows[kept] + np.diag(prior)
        return np.linalg.solve(A, (rows[kept] * W[kept, None]).T @ target[kept])

    everything = fitted(np.full(120, True))
    error = (target - rows @ everything).reshape(2, 60).T
    H = np.linalg.inv((rows * W[:, None]).T @ rows + np.diag(prior))
    changes = [fitted(np.tile(np.arange(60) // 12 != b, 2)) - everything for b in range(5)]
    # principal axes of numbers of like size
    size = 1 / np.sqrt((rows**2 * W[:, None]).sum(axis=0) + prior)
    left = (rows * np.sqrt(W)[:, None] * size).reshape(2, 5, 12, 5)
    axes = np.linalg.svd(np.vstack([left.reshape(120, 5), np.diag(np.sqrt(prior) * size)]))[2].T
    shares = ((left @ axes) ** 2).sum(axis=(0, 2))
    freedom = shares.sum(axis=0) ** 2 / (shares**2).sum(axis=0)
    assert 4.0 < freedom.min() < freedom.max() < 5.0  # blocks
    quantiles = np.array([student.ppf(0.975, n) for n in freedom]) / 1.959963984540054
    assert quantiles.min() > 1.3
    # a score in the axes is H^-1 times the change, without the prior
    G = np.array(changes) @ np.linalg.inv(H) * size @ axes * quantiles @ axes.T / size
    expected = H @ (G.T @ G + np.diag(prior)) @ H
    found = covariance_of(Blocks.of_outputs(X, error, weight, 12), np.diag(prior))
    assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("sign, status", [(1.0, FitStatus.FITTED), (-1.0, FitStatus.MODEL_ERROR)])
def test_torques_of_the_wrong_sign_are_a_model_error(sign, status) -> None:
    """Of a horizontal arm, all torques are explained by negative frictions and rotors."""
    model = replace(flexgen.read("elbow@rigid"), gravity=(0.0, 0.0, 0.0))
    t = 4e-3 * np.arange(500)
    w = np.array([3.1, 4.3])
    q, v, a = (
        size * f(np.outer(t, w))
        for f, size in ((np.sin, 0.9 / w), (np.cos, 0.9), (lambda x: -np.sin(x), 0.9 * w))
    )
    e = flexgen.derive(model).function("inverse_dynamics").map(len(t))
    tau = (
        np.array(e(q.T, v.T, a.T)).T @ np.linalg.inv(model.eta)
        + 0.02 * (v @ model.eta.T)
        + 0.5 * np.sign(v)
    )
    tau += np.array([m.inertia for m in model.motors]) * (a @ model.eta.T)
    found = identify_rigid(model, [Motion(t, q, sign * tau)], parts=2)
    assert found.status == status and (found.numbers_sd is None) == (sign < 0)
    assert found.validated([Motion(t, q, sign * tau)], [Motion(t, q, sign * tau)]).status == status


def test_motors_give_no_energy() -> None:
    """Each of friction and rotor; what is within the doubt, or a small part of the torque, can
    be.
    """
    model = flexgen.read("elbow@rigid")
    ratio = np.abs(model.eta).max(axis=1)
    v = np.sin(np.arange(200.0))
    F = np.stack(
        [np.stack([v, np.sign(v), np.ones(200), np.cos(np.arange(200.0))], axis=1)] * 2, axis=1
    )
    fine = np.array([[0.5, 1.0, -9.0, 0.0]] * 2)
    sure = 1e-6 * np.eye(8)
    torque = np.ones(2)
    none = np.zeros(2)
    assert is_possible(model, F, fine, sure, torque, none)
    for column, value in ((0, -3.0), (1, -1.0), (3, -0.1 - model.motors[1].inertia * ratio[1])):
        numbers = fine.copy()
        numbers[1, column] = value
        assert not is_possible(model, F, numbers, sure, torque, none)
        assert is_possible(model, F, numbers, 4 * np.eye(8), torque, none)
        assert is_possible(model, F, numbers, sure, 1e3 * torque, none)


def test_a_friction_that_falls_with_speed_is_larger_at_rest() -> None:
    """Not smaller, and no friction makes up for another: a model file has none below zero."""
    model = flexgen.read("elbow@rigid")
    v = np.sin(np.arange(200.0))
    rows = [
        v,
        np.sign(v),
        np.ones(200),
        np.cos(np.arange(200.0)),
        np.sign(v) / np.cosh(3 * v),
        0 * v,
    ]
    F = np.stack([np.stack(rows, axis=1)] * 2, axis=1)
    torque = np.ones(2)
    sure = 1e-6 * np.eye(12)
    numbers = np.array([[0.5, 1.0, 0.0, 0.0, -0.3, 0.0]] * 2)
    assert not is_possible(model, F, numbers, sure, torque, np.array([0.0, 3.0]))
    # a harmonic of a counterbalance
    assert is_possible(model, F, numbers, sure, torque, np.zeros(2))
    assert is_possible(model, F, numbers, 0.1 * np.eye(12), torque, np.array([0.0, 3.0]))
    numbers[:, 4] = 0.3
    assert is_possible(model, F, numbers, sure, torque, np.full(2, 3.0))
    numbers[:, [0, 1, 4]] = 2.0, -0.4, 2.0
    assert not is_possible(model, F, numbers, sure, torque, np.full(2, 3.0))


@pytest.mark.parametrize("noise", [2e-3, 0.02])
def test_friction_at_standstill_is_any_torque(noise: float) -> None:
    """Moves from pose to pose, with friction that jumps as they begin and end: numbers within
    their deviations.
    """
    model = flexgen.read("elbow@rigid")
    true = np.array([[0.8, 1.0], [1.0, 1.5]])
    away = []
    for seed in range(4):
        found = identify_rigid(
            model, [Motion(*x) for x in poses(model, true, noise, seed, 2)], parts=0
        )
        sd = np.sqrt(np.diag(found.covariance))[len(found.pi) :][: found.friction.size].reshape(
            2, -1
        )
        away.append((found.friction[:, :2] - true.T) / sd[:, :2])
        assert (sd[:, :2] < 0.1 * true.T).all()
    assert np.sqrt(np.mean(np.square(away))) < 1.3 and np.abs(away).max() < 3.5
