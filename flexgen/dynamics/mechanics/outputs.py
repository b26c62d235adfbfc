"""The output as a constraint: its error from a target, and the map from arm velocities to its
rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexgen.dynamics.mechanics import dynamics
from flexgen.dynamics.mechanics.system import System


@dataclass(frozen=True)
class OutputMap:
    """Graphs in the symbol ``system.lagrangian.chain.q_a``.

    ``error`` (n_y): zero where the output is at ``target`` (n_y; for a pose 3 + 9: position,
    rotation matrix by columns, with weighted sums between them); orientation: the axial vector of
    ``(R R_d' - R_d R')/2``, sine of the angle times the axis, world axes. ``rate`` W (n_y, n_a):
    time derivative of the output ``= W v_a``, for a pose the spatial velocity (linear, angular).
    """

    error: ca.SX
    target: ca.SX
    rate: ca.SX


def output_map(system: System) -> OutputMap:
    """The `OutputMap` of a model's declared output: error from a target, the target's symbol, and
    the map W from coordinate speeds to output rates.

    A pose has the target of position, weighted sums and rotation matrix, and W is the Jacobian (6,
    n_a) with the weights below the rows of the position; other outputs have a target of their
    size.
    """
    model = system.model
    q = system.lagrangian.chain.q_a
    if model.output.type != "tool_pose":
        target = ca.SX.sym("target", model.output.size)
        y = ca.densify(dynamics.output(system)[2][0])
        rate = ca.densify(ca.jacobian(y, q))
        if model.output.has_angle:
            from flexgen.dynamics.mechanics.tool_angle import tool_angle

            # that of the value has the two terms of whole turns, which cancel
            rate[model.output.tool_size - 1, :] = tool_angle(system).rate
        return OutputMap(y - target, target, rate)
    target = ca.SX.sym("target", model.output.target_size)
    p, R = (ca.densify(x) for x in dynamics.forward_kinematics(system)[2])
    rate = ca.densify(dynamics.jacobian(system)[2][0])
    if model.output.weights:
        sums = ca.SX(ca.DM(model.output.weights))
        p = ca.vertcat(p, ca.mtimes(sums, q))
        rate = ca.vertcat(rate[:3, :], sums, rate[3:, :])
    return OutputMap(pose_error(p, R, target), target, ca.densify(rate))


def pose_error(p: ca.SX, R: ca.SX, target: ca.SX) -> ca.SX:
    """Error of a pose from a target (12), see `OutputMap`; ``p``: the outputs before the
    rotation, three and the weighted sums.
    """
    n = p.shape[0]
    E = ca.mtimes(R, ca.reshape(target[n:], 3, 3).T)
    turn = ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2
    return ca.vertcat(p - target[:n], turn)
