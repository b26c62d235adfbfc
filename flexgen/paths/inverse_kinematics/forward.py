"""Where the trackers of a robot are at rest, with the motors at commanded angles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from flexgen.base.checks.counts import show_value
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError
from flexgen.base.spec.sensors import TOOL
from flexgen.dynamics.mechanics.equations import Equations, derive, robot_of
from flexgen.dynamics.mechanics.kinematics import place
from flexgen.dynamics.mechanics.statics import hold_motors, motor_balance
from flexgen.model.elements import Placement, RobotModel


@checked_types
def tracker_positions(
    model: str | Path | RobotModel | Equations,
    commands: np.ndarray | Sequence[Sequence[float]],
    *,
    sag: bool = True,
) -> np.ndarray:
    """Positions of the trackers, or of the tool, at rest under gravity with the motors at
    commanded angles.

    Solves ``g(q_a) = tau_springs(q_a, q_m)``, ``q_m = eta commands``, by Newton's method for each
    pose.

    Parameters
    ----------
    model : name, path, RobotModel or Equations
    commands : array (N, n_g) [rad or m]
        Actuated coordinates that the motors reach: motor angles over the gear ratios.
    sag : bool
        False: without deflections.

    Returns
    -------
    array (N, k, 3) [m]
        In the world, in the order of the ``[[sensor]]`` tables of type ``tracker``; the tool where
        there is none.

    Raises
    ------
    ArgumentError
        The commands have another shape.
    SolverError
        The springs do not carry the arm at a pose.

    Examples
    --------
    >>> import numpy as np
    >>> home = np.array([[0.5236, -0.3491]])  # rad
    >>> sag = flexgen.tracker_positions("elbow", home) - flexgen.tracker_positions(
    ...     "elbow", home, sag=False
    ... )
    >>> f"{1e3 * sag[0, 0, 2]:.2f} mm"
    '-0.89 mm'
    """
    robot = robot_of(model)
    try:
        q_g = np.array(commands, dtype=float)
    except ValueError:
        expected = f"rows of the same length, (N, {robot.n_g})"
        raise ArgumentError(
            f"commands: given {show_value(commands)}, expected {expected}"
        ) from None
    if q_g.ndim != 2 or q_g.shape[1] != robot.n_g or not np.isfinite(q_g).all():
        raise ArgumentError(
            f"commands: given shape {q_g.shape}, expected finite numbers of shape (N, {robot.n_g})"
        )
    equations = model if isinstance(model, Equations) else derive(robot)
    chain = equations.lagrangian.chain
    points = [
        place(
            chain.tool if sensor.place == TOOL else chain.frames[sensor.place],
            Placement(tuple(sensor.position)),
        ).p
        for sensor in robot.sensors
        if sensor.type == "tracker"
    ] or [chain.tool.p]
    positions = ca.Function("positions", [chain.q_a], [ca.densify(ca.horzcat(*points))])
    newton = motor_balance(equations) if sag else None
    out = np.zeros((len(q_g), len(points), 3))
    for k, command in enumerate(q_g):
        q = np.zeros(robot.n_a)
        q[list(robot.i_g)] = command
        if newton is not None:
            q = hold_motors(equations, robot.eta @ command, q, newton).q_a
        out[k] = np.array(positions(q)).T
    return out
