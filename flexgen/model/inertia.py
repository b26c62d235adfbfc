"""The inertia matrix of an arm in plain numbers, to find coordinates that move nothing."""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import Body, Placement, RobotModel

_SINGULAR = 1e-13  # smallest eigenvalue of the inertia matrix with unit diagonal: rounding of some tens of bodies
_POSES = 3  # at a single one axes may be in line by chance


def idle_coordinates(model: RobotModel) -> tuple[str, ...]:
    """The coordinates that can be moved without moving any inertia; empty where the inertia matrix is regular.

    Looked for at random poses; rotors behind rigid gears count. A model with a beam is taken for regular.
    """
    if any(element.beam is not None for element in model.elements):
        return ()
    rng = np.random.default_rng(1)
    found: tuple[str, ...] = ()
    for _ in range(_POSES):
        found = _idle(model, mass_matrix(model, rng.uniform(-1.0, 1.0, model.n_a)))
        if not found:
            return ()
    return found


def _idle(model: RobotModel, M: np.ndarray) -> tuple[str, ...]:
    names = [coordinate.name for coordinate in model.coordinates]
    size = np.sqrt(np.abs(np.diag(M)))
    if not size.all():
        return tuple(name for name, x in zip(names, size, strict=True) if x == 0.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    if values[0] > _SINGULAR:
        return ()
    weights = np.abs(vectors[:, 0])
    return tuple(name for name, x in zip(names, weights, strict=True) if x > 0.1 * weights.max())


def mass_matrix(model: RobotModel, q_a: np.ndarray) -> np.ndarray:
    """``M = sum(m J_v' J_v + J_w' I J_w)`` over the bodies, and ``eta' J_m eta`` of rotors behind rigid gears.

    Parameters
    ----------
    model : RobotModel
        Without beams.
    q_a : array (n_a,) [rad or m]
        Arm coordinates.

    Returns
    -------
    array (n_a, n_a)
    """
    R, p = np.array(model.base.rotation), np.array(model.base.position)
    columns: list[tuple[bool, np.ndarray, np.ndarray]] = []  # of the Jacobian: turns, axis, point
    M = np.zeros((model.n_a, model.n_a))

    def carry(body: Body) -> None:
        if body.mass == 0.0:
            return
        com, inertia = p + R @ np.array(body.com), R @ np.array(body.inertia) @ R.T
        speed, spin = np.zeros((2, 3, model.n_a))
        for i, (turns, axis, point) in enumerate(columns):
            speed[:, i] = np.cross(axis, com - point) if turns else axis
            spin[:, i] = axis if turns else 0.0
        M[:] += body.mass * speed.T @ speed + spin.T @ inertia @ spin

    def move(placement: Placement) -> None:
        nonlocal R, p
        p, R = p + R @ np.array(placement.position), R @ np.array(placement.rotation)

    for element in model.elements:
        move(element.origin)
        for dof in element.dofs:
            axis, value = np.array(dof.axis), q_a[len(columns)]
            columns.append((dof.type == "rotation", R @ axis, p))
            if dof.type == "rotation":
                x, y, z = axis
                cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
                R = R @ (np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * cross @ cross)
            else:
                p = p + value * (R @ axis)
        move(element.link)
        carry(element.body)
    carry(model.payload)
    eta = np.zeros((model.n_m, model.n_a))
    eta[:, list(model.i_g)] = model.eta
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    rotors = np.array([model.motors[j].inertia for j in rigid])
    return M + (eta[rigid].T * rotors) @ eta[rigid]
