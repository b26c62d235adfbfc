"""Robots whose motors move the output through the deflection of a line alone.

Inverse dynamics needs the output y to follow the motors at fixed elastic coordinates: dy/dq_g must
be regular. A driving rod that is a line, not a part of a closed loop, leaves the driven joint to
its spring: the motor stretches the rod, and the output stands still.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from flexgen.model.elements import RobotModel
from flexgen.model.format.line_checks import body_poses, line_lengths

# Poses that are tried: at a single one the Jacobian may be singular by chance, as of a wrist.
POSES = 3
# Distance [rad, m] of the other poses from home, at which closed loops can be closed.
NEAR = 0.02
# Step [rad, m] of central differences, which are right to about 1e-9.
STEP = 1e-6
# Ratio of singular values, and part of the largest entry, below which they are zero.
ZERO = 1e-6
# Part of the largest entry of a direction below which a joint does not take part in it.
SMALL = 0.1


def undriven_output(model: RobotModel) -> str:
    """The lines through whose deflection alone motors move the output, as a sentence for an error
    message; empty where the output follows the motors, and for robots without such lines.
    """
    stiff = any(getattr(line, "stiffness", 1.0) > 0.0 for line in model.lines)
    if not stiff or model.output.size != model.n_g:
        return ""
    if any(element.beam is not None for element in model.elements):
        return ""
    return _found(model)


@lru_cache(maxsize=16)
def _found(model: RobotModel) -> str:
    rng = np.random.default_rng(0)
    home = np.zeros(model.n_a)
    home[list(model.i_g)] = model.home
    for k in range(POSES):
        q_a = home + (NEAR * rng.uniform(-1.0, 1.0, model.n_a) if k else 0.0)
        outputs, lengths = _jacobians(model, q_a)
        _, sizes, directions = np.linalg.svd(outputs)
        if sizes[-1] > ZERO * sizes[0]:
            return ""
    still = directions[-1]
    rates = np.abs(lengths @ still)
    lines = [
        line.name
        for line, rate in zip(model.lines, rates, strict=True)
        if rate > ZERO and getattr(line, "stiffness", 1.0) > 0.0
    ]
    if not lines:
        return ""
    joints = [
        model.coordinates[i].name
        for i, x in zip(model.i_g, np.abs(still), strict=True)
        if x > SMALL * np.abs(still).max()
    ]
    return (
        f"model {model.name}: given {', '.join(joints)}, whose motion changes the length of line "
        f"{', '.join(lines)} and leaves the output where it is"
    )


def _jacobians(model: RobotModel, q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives in the coordinates with motors of the output (n_y, n_g), and of the lengths of
    the lines (n_l, n_g).
    """
    outputs = []
    lengths = []
    for i in model.i_g:
        step = STEP * np.eye(model.n_a)[i]
        outputs.append(_output_change(model, q_a - step, q_a + step))
        change = np.array(line_lengths(model, q_a + step)) - line_lengths(model, q_a - step)
        lengths.append(change)
    return np.array(outputs).T / (2.0 * STEP), np.array(lengths).T / (2.0 * STEP)


def _output_change(model: RobotModel, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Change of the output (n_y) from one position to one nearby."""
    output = model.output
    sums = np.array([np.dot(row, after - before) for row in output.weights])
    if output.type == "combination":
        return sums
    tools = []
    for q_a in (before, after):
        p, R = body_poses(model, q_a)[model.tip]
        tools.append((p + R @ np.array(model.tool.position), R))
    (p, R), (p_after, R_after) = tools
    moved = (p_after - p)[["xyz".index(axis) for axis in output.axes]]
    T = R_after @ R.T
    turn = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]) / 2.0
    angle = [np.dot(output.rotation_axis, turn)] if output.has_angle else []
    return np.concatenate([moved, angle, sums, turn if output.is_pose else []])
