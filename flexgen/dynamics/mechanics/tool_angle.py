"""The angle of the tool about one axis, the last row of an output of type ``tool_position_angle``.

    u = R e_ref,   c = x_n . u,   s = y_n . u,   phi = angle of the vector (c, s)
    phi' = (c s' - s c') / (c^2 + s^2)

R is the orientation of the tool in the world, e_ref the axis of the tool frame that ``reference``
names, n the unit vector ``rotation_axis``. The angle counts counterclockwise about n, from x_n:
the world's x axis projected along n (its y axis where n is nearly parallel to x), and y_n = n x
x_n. A tilt of the tool about an axis across n, as by an elastic bearing, leaves the angle that of
the projected direction.

As a function of the coordinates the angle is continuous and counts whole turns:

    phi(q) = l(q) + angle of (c cos l + s sin l, s cos l - c sin l)
    l(q) = phi(q_h) + dphi/dq(q_h) (q - q_h)

with the home pose q_h of the undeflected arm, where phi is within half a turn of zero. The second
term stays within half a turn. Where the axes of all rotations that turn the tool are parallel to
n, or a mechanism keeps the tool level, it is zero: then ``phi = l(q)``, a sum of coordinates, and
the functions use this sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.system import System
from flexgen.model.elements import Output

# The squared length of the projected reference at home below which it gives no angle: 1 deg from
# the axis, where a tilt of 0.1 mrad already turns the angle by 6 mrad.
SHORTEST = 3e-4
# Entries of the gradient that differ less from pose to pose, in rad/rad (rad/m), are equal:
# rounding of a product of some ten rotation matrices is 1e-15.
CONSTANT = 1e-12
# Poses at which the gradient is compared: it is an analytic function, two would do almost surely.
POSES = 6
# Largest deviation of these poses from home in rad or m: every cosine clearly leaves 1.
SPREAD = 0.9
# The world axis x gives the direction of zero unless its sine to the rotation axis is below this.
ALONG_X = 0.1


@dataclass(frozen=True)
class ToolAngle:
    """The angle as graphs in ``chain.q_a``.

    ``value``: phi; ``rate`` (1, n_a): its gradient. ``weights`` (n_a,) and ``offset``: the sum
    ``offset + weights . q_a`` of coordinates that the angle is where ``is_sum``, and from which
    whole turns are counted else.
    """

    value: ca.SX
    rate: ca.SX
    weights: np.ndarray
    offset: float
    is_sum: bool


def plane_axes(output: Output) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors x_n, y_n (3,) across the axis: the angle counts from the first to the
    second.
    """
    n = np.array(output.rotation_axis)
    x = np.array([1.0, 0.0, 0.0])
    if np.linalg.norm(np.cross(n, x)) < ALONG_X:
        x = np.array([0.0, 1.0, 0.0])
    x = x - (n @ x) * n
    x = x / np.linalg.norm(x)
    return x, np.cross(n, x)


def tool_angle(system: System) -> ToolAngle:
    """The `ToolAngle` of a model; ArgumentError where its reference is along the axis at home.

    ``atan2`` of the reference's components has a jump at half a turn. Where the angle is a sum of
    joints (its gradient is constant), the sum is taken; else the angle relative to the sum with
    the weights at home, which counts whole turns.
    """
    chain = system.lagrangian.chain
    output = system.model.output
    x, y = plane_axes(output)
    u = chain.tool.R[:, "xyz".index(output.reference)]
    c = ca.dot(ca.DM(x), u)
    s = ca.dot(ca.DM(y), u)
    raw = ca.atan2(s, c)
    rate = ca.densify(ca.jacobian(raw, chain.q_a))
    at = ca.Function("angle", [chain.q_a], [raw, rate, c * c + s * s])
    home = np.zeros(system.model.n_a)
    home[list(system.model.i_g)] = system.model.home
    start, weights, length = (np.array(part).ravel() for part in at(home))
    if not float(length[0]) > SHORTEST:
        raise ArgumentError(
            f"model {system.model.name}: given output.reference {output.reference!r}, which is "
            "along output.rotation_axis at home, expected an axis of the tool frame across it"
        )
    weights = np.where(np.abs(weights - np.round(weights)) < CONSTANT, np.round(weights), weights)
    is_sum = _is_constant(at, home, weights)
    offset = float(start[0] - weights @ home)
    linear = ca.dot(ca.DM(weights), chain.q_a) + offset
    if is_sum:
        return ToolAngle(linear, ca.SX(ca.DM(weights)).T, weights, offset, True)
    cosine = ca.cos(linear)
    sine = ca.sin(linear)
    value = linear + ca.atan2(s * cosine - c * sine, c * cosine + s * sine)
    return ToolAngle(value, rate, weights, offset, False)


def _is_constant(at: ca.Function, home: np.ndarray, weights: np.ndarray) -> bool:
    """Whether the gradient is the same at poses drawn around home, with deflections."""
    rng = np.random.default_rng(0)
    for _ in range(POSES):
        gradient = np.array(at(home + rng.uniform(-SPREAD, SPREAD, len(home)))[1]).ravel()
        if not np.abs(gradient - weights).max() < CONSTANT * (1.0 + np.abs(weights).max()):
            return False
    return True
