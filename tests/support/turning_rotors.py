"""Rotors that turn with their carriers, from the data of a model alone: kinetic energy of their
speeds against the carriers, and Lagrange's equations by differences.

Shares no code with the package.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from multipliers import about

STEP = 1e-4  # of the differences, in s and rad


def turning(robot: Any, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Speeds of the carriers about the axes of their rotors (n_m) [rad/s]."""
    at = {c.name: k for k, c in enumerate(robot.coordinates)}
    poses: dict[str, tuple[np.ndarray, np.ndarray]] = {
        "base": (np.array(robot.base.rotation), np.zeros(3))
    }
    before = "base"
    for element in robot.elements:
        R, w = poses[element.parent or before]
        R = R @ np.array(element.origin.rotation)
        for dof in element.dofs:
            if dof.type == "rotation":
                w = w + R @ np.array(dof.axis) * v[at[dof.name]]
                R = R @ about(np.array(dof.axis), q[at[dof.name]])
        poses[element.name] = (R @ np.array(element.link.rotation), w)
        before = element.name
    return np.array(
        [np.dot(poses[m.carrier][0] @ np.array(m.axis), poses[m.carrier][1]) for m in robot.motors]
    )


def coupling_forces(
    robot: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_m: np.ndarray, a_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the coordinates (n_a) and torques on the rotors (n_m) of the energy
    ``sum J v_m (a . omega)``, by central differences of the order four.
    """
    J = np.array([m.inertia for m in robot.motors])

    def energy(q: np.ndarray, v: np.ndarray, v_m: np.ndarray) -> float:
        return float(np.sum(J * v_m * turning(robot, q, v)))

    def slope(f: Any) -> Any:
        h = STEP
        return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)

    def momentum(t: float) -> np.ndarray:
        moved = q + v * t + a * t * t / 2
        # the energy is linear in the speeds
        each = [energy(moved, unit, v_m + a_m * t) for unit in np.eye(len(q))]
        return np.array(each)

    by_q = [slope(lambda d, u=unit: energy(q + d * u, v, v_m)) for unit in np.eye(len(q))]
    taken = slope(lambda t: J * turning(robot, q + v * t + a * t * t / 2, v + a * t))
    return slope(momentum) - np.array(by_q), taken
