"""Moves of a rigid arm from pose to pose, with friction that jumps as they begin and end, and is
any torque at rest.
"""

from __future__ import annotations

import numpy as np

import flexgen
from flexgen.model.elements import RobotModel

STEP = 2e-3  # s


def poses(
    model: RobotModel, friction: np.ndarray, noise: float, seed: int, records: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Times, angles of the joints and torques of the motors of records with seven moves, about 9
    s.

    Parameters
    ----------
    friction : array (2, n_m)
        Viscous [N m s/rad, of the joint] and Coulomb [N m], motor side.
    noise : float [N m]
        Of the torques.
    """
    rng = np.random.default_rng(seed)
    n = model.n_m
    inverse_dynamics = flexgen.derive(model).function("inverse_dynamics")
    out = []
    for _ in range(records):
        rows: list[np.ndarray] = []
        stiction = []
        at = rng.uniform(-0.8, 0.8, n)
        for _ in range(7):
            move = rng.uniform(0.8, 1.3)
            to = rng.uniform(-0.8, 0.8, n)
            x = np.arange(round(move / STEP))[:, None] * STEP / move
            s = x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)
            rates = 140 * (x - x**2) ** 3 / move, 420 * (x - x**2) ** 2 * (1 - 2 * x) / move**2
            rows.append(np.hstack([at + s * (to - at), *(rate * (to - at) for rate in rates)]))
            rows.append(np.tile(np.concatenate([to, np.zeros(2 * n)]), (100, 1)))
            stiction += [0 * x * to, np.tile(rng.uniform(-1, 1, n), (100, 1))]
            at = to
        q, v, a = np.hsplit(np.vstack(rows), 3)
        tau = np.array(inverse_dynamics.map(len(q))(q.T, v.T, a.T)).T @ np.linalg.inv(model.eta)
        tau += np.array([m.inertia for m in model.motors]) * (a @ model.eta.T) + friction[0] * v
        tau += friction[1] * (np.sign(v @ model.eta.T) + np.vstack(stiction))
        noisy = q + 1e-6 * rng.normal(size=q.shape), tau + noise * rng.normal(size=tau.shape)
        out.append((STEP * np.arange(len(q)), *noisy))
    return out
