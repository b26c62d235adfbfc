"""A wall that the tool touches: a half space with spring and damper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from flexgen.base.checks.type_checks import checked_class
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.arguments import check_not_negative, check_positive, is_number
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import RobotModel

TOOL = 6  # entries of a force and a torque on the tool


@checked_class
@dataclass(frozen=True)
class Wall:
    """A plane with spring and damper that pushes the tool's origin back, and never pulls it.

        F = max(0, k d + c d') n  where d > 0, else 0,    d = n . (point - p) - gap

    p: origin of the tool; there is no friction along the wall.

    Parameters
    ----------
    point : sequence (3,) [m]
        Of the plane, in the frame of the robot's base.
    normal : sequence (3,)
        From the wall towards the tool, in the same frame; its length does not matter.
    stiffness : float [N/m]
        k, above 0.
    damping : float [N s/m]
        c.
    gap : float [m]
        Depth at which spring and damper begin to push; negative: before the plane.

    Raises
    ------
    ArgumentError
        A number is out of range.

    Examples
    --------
    >>> wall = flexgen.Wall(point=(1.2, 0.0, 0.0), normal=(-1.0, 0.0, 0.0), stiffness=1e5)
    >>> wall.normal
    (-1.0, 0.0, 0.0)
    """

    point: Sequence[float]
    normal: Sequence[float]
    stiffness: float
    damping: float = 0.0
    gap: float = 0.0

    def __post_init__(self) -> None:
        for name in ("point", "normal"):
            given = getattr(self, name)
            if (
                isinstance(given, str)
                or len(given) != 3
                or not all(is_number(x) and abs(x) < 1e9 for x in given)
            ):
                raise ArgumentError(
                    f"wall, {name}: given {given!r}, expected three finite numbers"
                )
            object.__setattr__(self, name, tuple(float(x) for x in given))
        if not math.hypot(*self.normal) > 1e-9:
            raise ArgumentError(
                f"wall, normal: given {self.normal}, expected a vector that is not zero"
            )
        check_positive("wall, stiffness", self.stiffness, "a number > 0 in N/m")
        check_not_negative("wall, damping", self.damping)
        if not (is_number(self.gap) and math.isfinite(self.gap)):
            raise ArgumentError(f"wall, gap: given {self.gap!r}, expected a finite number in m")


def in_world(wall: Wall, model: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """A point where the force begins, and the unit normal, (3,) each, in the world."""
    R = np.array(model.base.rotation)
    n = R @ np.array(wall.normal) / math.hypot(*wall.normal)
    return np.array(model.base.position) + R @ np.array(wall.point) - wall.gap * n, n


def numbers_of(wall: Wall, model: RobotModel) -> np.ndarray:
    """Inputs (8,) of `wall_force`: the point, the normal, stiffness and damping."""
    return np.array([*np.concatenate(in_world(wall, model)), wall.stiffness, wall.damping])


def contact_force(
    wall: Wall, equations: Equations, q_a: np.ndarray, v_a: np.ndarray
) -> np.ndarray:
    """Forces (n, 3) [N] on the tool along a motion ``q_a``, ``v_a`` (n, n_a), world axes."""
    numbers = np.tile(numbers_of(wall, equations.model), (len(q_a), 1))
    return evaluate(wall_force(equations), q_a, v_a, numbers)[0].reshape(-1, TOOL)[:, :3]


def contact_function(wall: Wall, equations: Equations) -> ca.Function:
    """Force and torque (6,) on the tool from ``q_a`` and ``v_a``."""
    q, v = (ca.SX.sym(name, equations.model.n_a) for name in ("q_a", "v_a"))
    return ca.Function(
        "wall", [q, v], [wall_force(equations)(q, v, numbers_of(wall, equations.model))]
    )


def add_contact(wall: Wall, equations: Equations, motion: Trajectory) -> Trajectory:
    """The motion with the channel ``contact`` (n, 3) [N], the force on the tool, world axes."""
    force = contact_force(wall, equations, motion["q_a"], motion["v_a"])
    port = Port("contact", (3,), "N", "force of the wall on the tool, world axes")
    return replace(
        motion,
        channels={**motion.channels, "contact": force},
        ports={**motion.ports, "contact": port},
        labels={**motion.labels, "contact": ("fx", "fy", "fz")},
    )


def check_start(wall: Wall, equations: Equations, q_a: np.ndarray) -> None:
    """Refuse a wall in which the tool is at the begin of a motion, at ``q_a`` (n_a,):
    ArgumentError with the depth [m].
    """
    point, n = in_world(wall, equations.model)
    p = np.array(equations.function("forward_kinematics")(q_a)[0]).ravel()
    if (depth := float(n @ (point - p))) > 0.0:
        raise ArgumentError(
            f"wall: given a wall in which the tool begins, {depth:.4g} m deep, expected the "
            "tool before it; turn the normal round, or move the point"
        )


def wall_force(equations: Equations) -> ca.Function:
    """Force and torque (6,) on the tool from ``q_a``, ``v_a`` and the numbers of a `Wall`."""
    chain = equations.lagrangian.chain
    numbers = ca.SX.sym("wall", 8)
    point, n, stiffness, damping = ca.vertsplit(numbers, [0, 3, 6, 7, 8])
    depth = ca.dot(n, point - chain.tool.p)
    push = ca.fmax(
        0, stiffness * depth - damping * ca.dot(n, ca.mtimes(chain.tool.R, chain.tool.v))
    )
    force = ca.vertcat(ca.if_else(depth > 0, push, 0) * n, ca.SX.zeros(3))
    return ca.Function("wall_force", [chain.q_a, chain.v_a, numbers], [ca.densify(force)])
