"""Figures of a linear robot ``M y'' + D y' + K y = B tau``: fastest eigenvalue, inertias of the
motors, locked motors.

Coordinates ``y = (q_a, q_m of the motors behind elastic gears)``.
"""

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


def motor_rows(model: RobotModel) -> np.ndarray:
    """``C_m`` (n_m, n): motor angles from the coordinates
    ``y = (q_a, q_m of the motors behind elastic gears)``.
    """
    C = np.zeros((model.n_m, model.dof))
    C[:, list(model.i_g)] = model.eta
    for k, j in enumerate(model.i_m):
        C[j] = 0.0
        C[j, model.n_a + k] = 1.0
    return C


def with_motors_locked(model: RobotModel) -> list[int]:
    """The coordinates of ``y`` that move while the motors stand still."""
    locked = [model.n_a + k for k in range(len(model.i_m))]
    rigid = [k for k, _ in enumerate(model.i_g) if not np.any(model.eta[list(model.i_m), k])]
    locked += [model.i_g[k] for k in rigid]
    return [i for i in range(model.dof) if i not in locked]


def lowest_locked_hz(model: RobotModel, M: np.ndarray, K: np.ndarray) -> float:
    """Lowest natural frequency with the motors locked [Hz]; 0 where nothing is elastic then.
    ``M, K`` (n, n).
    """
    free = with_motors_locked(model)
    if not free:
        return 0.0
    squares = np.linalg.eigvals(np.linalg.solve(M[np.ix_(free, free)], K[np.ix_(free, free)]))
    return float(np.sqrt(np.abs(squares).min()) / (2 * np.pi))
