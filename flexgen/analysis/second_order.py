"""Figures of a linear robot ``M y'' + D y' + K y = B tau``: its fastest eigenvalue, the inertias of its motors."""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import RobotModel


def largest_rate(M: np.ndarray, D: np.ndarray, K: np.ndarray) -> float:
    """Largest size of an eigenvalue [1/s] of several robots or poses; matrices (k, n, n)."""
    n = M.shape[-1]
    lower = -np.linalg.solve(M, np.concatenate([K, D], axis=2))
    upper = np.broadcast_to(np.hstack([np.zeros((n, n)), np.eye(n)]), (len(M), n, 2 * n))
    return float(np.abs(np.linalg.eigvals(np.concatenate([upper, lower], axis=1))).max())


def motor_inertias(
    model: RobotModel, M: np.ndarray, B: np.ndarray, motor_rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Inertias that the motors move: with all springs stiff, and soft, (n_m,) each [kg m^2].

    ``M`` (n, n), ``B`` (n, n_m); ``motor_rows`` (n_m, n): motor angles from the coordinates
    ``y = (q_a, q_m of the motors behind elastic gears)``.
    """
    stiff = np.zeros((model.dof, model.n_m))
    stiff[list(model.i_g)] = np.linalg.inv(model.eta)
    for k, j in enumerate(model.i_m):
        stiff[model.n_a + k, j] = 1.0
    return np.diag(stiff.T @ M @ stiff), 1.0 / np.diag(motor_rows @ np.linalg.solve(M, B))
