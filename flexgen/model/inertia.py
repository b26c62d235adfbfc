"""Numeric inertia matrix of an arm, used to find coordinates without inertia; coordinates that
turn the rotors of complete motor coupling.
"""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import Body, Placement, RobotModel
from flexgen.model.format.closure import closed_values, dependence, shares

_SINGULAR = (
    # smallest eigenvalue of the inertia matrix scaled to unit diagonal: rounding errors of some
    # tens of bodies
    1e-13
)
_NEAR = 0.02  # distance from home [rad, m] at which closed loops can be closed
_POSES = 3  # at a single pose axes may be aligned by chance


def massless_coordinates(model: RobotModel) -> tuple[str, ...]:
    """Find the coordinates that can move without moving any inertia; empty if the inertia matrix
    is regular.

    The inertia matrix is computed at random poses, with the rotors behind rigid gears. A model
    with a beam is assumed to be regular.
    """
    if any(element.beam is not None for element in model.elements):
        return ()
    rng = np.random.default_rng(1)
    home = np.zeros(model.n_a)
    home[list(model.i_g)] = model.home
    found: tuple[str, ...] = ()
    for _ in range(_POSES):
        q_a = rng.uniform(-1.0, 1.0, model.n_a)
        if model.loops:
            q_a = home + _NEAR * q_a
        found = _massless(model, mass_matrix(model, q_a))
        if not found:
            return ()
    return found


def _massless(model: RobotModel, M: np.ndarray) -> tuple[str, ...]:
    """Names of the coordinates that move in the motion without inertia of a mass matrix (n_a,
    n_a); empty where it is regular.
    """
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
    """Inertia matrix of the arm, with the rotors behind rigid gears.

    ``M = sum(m J_v' J_v + J_w' I J_w) + eta' J_m eta``, summed over the bodies.

    Parameters
    ----------
    model : RobotModel
        Without beams.
    q_a : array (n_a,) [rad or m]
        Arm coordinates.

    Returns
    -------
    array (n_a, n_a) [kg m^2, kg m or kg]
    """
    R = np.array(model.base.rotation)
    p = np.array(model.base.position)
    # of the Jacobian: for each joint its share of each coordinate, rotary, axis, point
    columns: tuple[tuple[np.ndarray, bool, np.ndarray, np.ndarray], ...] = ()
    names = [coordinate.name for coordinate in model.coordinates]
    M = np.zeros((model.n_a, model.n_a))

    def add_body(body: Body) -> None:
        """Add a body at the pose p, R: ``m J_v' J_v + J_w' I J_w`` with the Jacobians of its
        center of mass.
        """
        if body.mass == 0.0:
            return
        com = p + R @ np.array(body.com)
        inertia = R @ np.array(body.inertia) @ R.T
        speed, spin = np.zeros((2, 3, model.n_a))
        for share, rotary, axis, point in columns:
            speed += np.outer(np.cross(axis, com - point) if rotary else axis, share)
            spin += np.outer(axis if rotary else 0.0 * axis, share)
        M[:] += body.mass * speed.T @ speed + spin.T @ inertia @ spin

    def advance(placement: Placement) -> None:
        nonlocal R, p
        p = p + R @ np.array(placement.position)
        R = R @ np.array(placement.rotation)

    at = closed_values(model, q_a)
    slopes = dependence(model, at)
    sums = shares(model)
    tips = {"base": (R, p, columns)}
    for element in model.elements:
        R, p, columns = tips[model.parents[element.name]]
        advance(element.origin)
        for dof in element.dofs:
            axis = np.array(dof.axis)
            share = np.array([slopes[dof.name].get(name, 0.0) for name in names])
            value = sum(x * at[name] for name, x in sums[dof.name].items())
            columns = (*columns, (share, dof.type == "rotation", R @ axis, p))
            if dof.type == "rotation":
                x, y, z = axis
                cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
                R = R @ (np.eye(3) + np.sin(value) * cross + (1.0 - np.cos(value)) * cross @ cross)
            else:
                p = p + value * (R @ axis)
        advance(element.link)
        add_body(element.body)
        tips[element.name] = R, p, columns
    R, p, columns = tips[model.tip]
    add_body(model.payload)
    eta = np.zeros((model.n_m, model.n_a))
    eta[:, list(model.i_g)] = model.eta
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    rotors = np.array([model.motors[j].inertia for j in rigid])
    return M + (eta[rigid].T * rotors) @ eta[rigid]


def turning_coordinates(model: RobotModel) -> tuple[frozenset[int], ...]:
    """Indices in q_a of the coordinates that may turn the carrier of each motor; none in
    simplified motor coupling, and where the base carries the motor.

    Found from the structure alone: a coordinate whose axis is across that of the rotor is among
    them. Modes of a beam turn the element that it ends; a joint that closed loops move may follow
    each coordinate.
    """
    if model.motor_coupling == "simplified":
        return (frozenset(),) * model.n_m
    index = {coordinate.name: k for k, coordinate in enumerate(model.coordinates)}
    turning: dict[str, frozenset[int]] = {"base": frozenset()}
    for element in model.elements:
        own = {
            index[coordinate.name]
            for coordinate in model.coordinates
            if coordinate.dof is None and coordinate.element == element.name
        }
        for dof in element.dofs:
            if dof.passive is not None:
                own |= set(range(model.n_a))
            elif dof.type == "rotation":
                own |= {index[name] for name, _ in dof.mimic} if dof.mimic else {index[dof.name]}
        turning[element.name] = turning[model.parents[element.name]] | own
    return tuple(turning[motor.carrier or "base"] for motor in model.motors)


def rotor_stages(model: RobotModel) -> tuple[int, ...]:
    """Stages (n_g) in which the torques of the gears follow from each other in complete motor
    coupling: 0 where the joint turns no rotor, 1 where the deflections of the gears of the rotors
    that it turns are known from stage 0, and so on; -1 in a circle. Motors behind rigid gears move
    with their joints, whatever the torques are.
    """
    turning = turning_coordinates(model)
    elastic = set(model.i_m)
    driven = [
        frozenset(np.flatnonzero(row).tolist()) if j in elastic else frozenset()
        for j, row in enumerate(model.eta)
    ]
    before = [
        frozenset().union(*(driven[j] for j in range(model.n_m) if i in turning[j]))
        for i in model.i_g
    ]
    carries = [any(i in turns for turns in turning) for i in model.i_g]
    stages = [0] * model.n_g
    for _ in range(model.n_g + 1):
        stages = [
            max((1 + stages[k] for k in gears), default=1) if carries[i] else 0
            for i, gears in enumerate(before)
        ]
    # without a circle no gear has more gears before it than there are others
    return tuple(stage if stage < model.n_g else -1 for stage in stages)
