"""Passive joints of closed loops as functions of the coordinates.

    c(q_i, q_d) = 0   ->   q_d = phi(q_i),    v_d = N v_i,    N = dphi/dq_i = -c_d^-1 c_i

Substituted into the energies of the tree they give the equations of the closed robot in the
independent coordinates: constraint embedding. A pair of passive hinges in a planar loop has a
closed form, the triangle of two levers:

    A cos w + B sin w = C,    cos w = (A C -+ B r) / H,    sin w = (B C +- A r) / H,
    H = A^2 + B^2,            r = sqrt(H - C^2)

with the sign of the home position. All others are solved together, by a Newton iteration of fixed
length that starts at the home position and follows the straight line from there.

Where the loops cannot be closed the joints are NaN: the root r of a negative number, or an
iteration that has not come to its end.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 8; the triangle: K. Waldron,
G. Kinzel, Kinematics, Dynamics, and Design of Machinery, 1999, ch. 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import casadi as ca
import numpy as np

from flexgen.dynamics.mechanics.square_systems import solve_square
from flexgen.model.elements import Dof, Loop, Placement, RobotModel
from flexgen.model.format.closure import (
    Step,
    Values,
    branches,
    closure,
    home_closure,
    passive_joints,
    shares,
)

# Components of unit vectors below which two directions are one, or orthogonal.
ALIGNED = 1e-12
# Positions on the line from home at which the Newton iteration makes one step each, and steps at
# the end: it doubles its digits from the 2 or 3 that the last of these positions leaves.
STAGES = 12
LAST_STEPS = 4
# Before the last three steps the joints are rounded to multiples of this, in rad or m: a constant
# for derivatives, which these steps alone then carry. Each step doubles the order of derivatives
# that it has right, so those up to the seventh are.
GRAIN = 2.0**-30
# Largest change of the joints in the last step, in rad or m: what is left is its square. Joints
# that change more are not closed, and become NaN.
LAST_CHANGE = 1e-6

Joints = dict[str, ca.SX]
Plane = tuple[ca.SX, ca.SX]  # a vector in a plane


def closed_joints(model: RobotModel, q_a: ca.SX) -> Joints:
    """Positions of all coordinates and passive joints, by name, as functions of ``q_a`` (n_a)."""
    known = {c.name: q_a[i] for i, c in enumerate(model.coordinates)}
    if not model.loops:
        return known
    home = home_closure(model)
    rest = list(model.loops)
    while rest:
        for loop in rest:
            pair = _planar_pair(model, loop, known, home, q_a)
            if pair is not None:
                known |= pair
                break
        else:
            break
        rest.remove(loop)
    passive = [dof.name for dof in passive_joints(model)]
    open_joints = [name for name in passive if name not in known]
    if open_joints:
        known |= _by_newton(model, rest, known, open_joints, home, q_a)
    return known


# --- planar loops --------------------------------------------------------------------------------


@dataclass
class _Levers:
    """A planar branch: ``p = s_0 + R(u)(s_1 + R(w) s_2 + ...)`` with passive hinges u, w.

    ``sums``: the vectors s_k; ``hinges``: each passive joint with its sign about the normal and
    the known angle before it, ``u = sign q + angle``.
    """

    sums: list[Plane]
    hinges: list[tuple[str, float, ca.SX]]


def _planar_pair(
    model: RobotModel, loop: Loop, known: Joints, home: Values, q_a: ca.SX
) -> Joints | None:
    """The two passive hinges of a planar loop; None where it is no such loop."""
    found = branches(model, loop)
    sums = shares(model)
    unknown = [d for d in found.joints if any(k not in known for k in sums[d.name])]
    normal = _normal(found.joints, found.start, found.end)
    if (
        loop.type != "point"
        or len(unknown) != 2
        or normal is None
        or any(d.type != "rotation" or d.mimic for d in unknown)
    ):
        return None
    first, second = (_levers(steps, known, sums, normal) for steps in (found.start, found.end))
    if first is None or second is None:
        return None
    if len(first.hinges) == 1:
        S0, S1 = first.sums
        T0, T1 = second.sums
        G = _minus(T0, S0)
        hinge = second.hinges[0]
        other = first.hinges[0]
        levers = (G, T1, S1)
    else:
        two, none = (first, second) if first.hinges else (second, first)
        S0, S1, S2 = two.sums
        G = S1
        other, hinge = two.hinges
        levers = (S1, S2, _minus(none.sums[0], S0))
    return _triangle(levers, hinge, other, len(first.hinges) == 1, _AtHome(model, home, q_a))


@dataclass(frozen=True)
class _AtHome:
    """Values of expressions in ``q_a`` at home, and of the joints there."""

    model: RobotModel
    home: Values
    q_a: ca.SX

    def value(self, x: ca.SX) -> float:
        """Value of an expression at home."""
        q = [self.home[c.name] for c in self.model.coordinates]
        return float(ca.Function("at_home", [self.q_a], [x])(q))

    def angle(self, hinge: tuple[str, float, ca.SX]) -> float:
        """Angle of a hinge about the normal."""
        name, sign, before = hinge
        return sign * self.home[name] + self.value(before)


def _triangle(
    levers: tuple[Plane, Plane, Plane],
    hinge: tuple[str, float, ca.SX],
    other: tuple[str, float, ca.SX],
    across: bool,
    at: _AtHome,
) -> Joints:
    """The hinges between ``levers``: G, the lever T behind ``hinge``, and D with
    ``|G + R(w) T| = |D|``.

    ``across``: the hinges are on the two branches, and the other one turns D to ``G + R(w) T``;
    else it turns this sum to D.
    """
    G, T, D = levers
    A = G[0] * T[0] + G[1] * T[1]
    B = G[1] * T[0] - G[0] * T[1]
    C = (_square(D) - _square(G) - _square(T)) / 2
    H = A * A + B * B
    angle = at.angle(hinge)
    sign = np.sign(at.value(A) * np.sin(angle) - at.value(B) * np.cos(angle)) or 1.0
    r = sign * ca.sqrt(H - C * C)
    cosine = (A * C - B * r) / H
    sine = (B * C + A * r) / H
    reached = (G[0] + cosine * T[0] - sine * T[1], G[1] + sine * T[0] + cosine * T[1])
    E, to = (D, reached) if across else (reached, D)
    length = _square(E)
    turned = (
        (E[0] * to[0] + E[1] * to[1]) / length,
        (E[0] * to[1] - E[1] * to[0]) / length,
    )
    found = {}
    for one, (c, s) in ((hinge, (cosine, sine)), (other, turned)):
        name, direction, before = one
        start = at.angle(one)
        c0 = float(np.cos(start))
        s0 = float(np.sin(start))
        # the change from home has no jump within half a turn
        value = start + ca.atan2(s * c0 - c * s0, c * c0 + s * s0)
        found[name] = direction * (value - before)
    return found


def _square(x: Plane) -> ca.SX:
    return x[0] * x[0] + x[1] * x[1]


def _minus(x: Plane, y: Plane) -> Plane:
    return x[0] - y[0], x[1] - y[1]


def _normal(joints: Sequence[Dof], *ways: Sequence[Step]) -> np.ndarray | None:
    """The common direction (3,) of the hinges of a planar loop; None where it is not planar."""
    hinges: list[np.ndarray] = []
    slides: list[np.ndarray] = []
    for steps in ways:
        R = np.eye(3)
        for step in steps:
            if isinstance(step, Placement):
                R = R @ np.array(step.rotation)
            else:
                (hinges if step.type == "rotation" else slides).append(R @ np.array(step.axis))
    if not hinges:
        return None
    normal: np.ndarray = hinges[0]
    turned = any(np.abs(np.cross(normal, axis)).max() > ALIGNED for axis in hinges)
    leaves = any(abs(normal @ axis) > ALIGNED for axis in slides)
    return None if turned or leaves else normal


def _levers(
    steps: Sequence[Step],
    known: Joints,
    sums: Mapping[str, Mapping[str, float]],
    normal: np.ndarray,
) -> _Levers | None:
    """The planar branch of some steps; None where it has more than two passive hinges."""
    x = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = x - (x @ normal) * normal
    first /= np.linalg.norm(first)
    plane = np.array([first, np.cross(normal, first)])
    out = _Levers([(ca.SX(0), ca.SX(0))], [])
    R = np.eye(3)
    angle = ca.SX(0)
    for step in steps:
        if isinstance(step, Placement):
            out.sums[-1] = _add(out.sums[-1], angle, plane @ R @ np.array(step.position), 1.0)
            R = R @ np.array(step.rotation)
            continue
        axis = R @ np.array(step.axis)
        own = sums[step.name]
        if any(k not in known for k in own):
            out.hinges.append((step.name, float(np.sign(axis @ normal)), angle))
            out.sums.append((ca.SX(0), ca.SX(0)))
            angle = ca.SX(0)
            continue
        value = reduce(lambda a, b: a + b, [x * known[k] for k, x in own.items()])
        if step.type == "rotation":
            angle = angle + float(np.sign(axis @ normal)) * value
        else:
            out.sums[-1] = _add(out.sums[-1], angle, plane @ axis, value)
    return out if len(out.hinges) <= 2 else None


def _add(total: Plane, angle: ca.SX, vector: np.ndarray, factor: ca.SX | float) -> Plane:
    """``total + factor R(angle) vector``."""
    a, b = (0.0 if abs(x) < ALIGNED * np.abs(vector).max() else float(x) for x in vector)
    if a == 0.0 and b == 0.0:
        return total
    c = ca.cos(angle)
    s = ca.sin(angle)
    return total[0] + factor * (c * a - s * b), total[1] + factor * (s * a + c * b)


# --- all other loops -----------------------------------------------------------------------------


def _by_newton(
    model: RobotModel,
    loops: Sequence[Loop],
    known: Joints,
    unknown: Sequence[str],
    home: Values,
    q_a: ca.SX,
) -> Joints:
    """The ``unknown`` joints of some loops by the Newton iteration."""
    order = [name for name in known if any(name == k for k in _inside(model, loops))]
    x = ca.SX.sym("x", len(unknown))
    given = ca.SX.sym("given", len(order))
    values = dict(zip(order, ca.vertsplit(given), strict=True))
    values |= dict(zip(unknown, ca.vertsplit(x), strict=True))
    error = independent_errors(model, loops, unknown, values)
    step = ca.Function("step", [given, x], [error, ca.jacobian(error, x)])
    start = np.array([home[name] for name in order])
    now = ca.SX(ca.DM([home[name] for name in unknown]))
    target = ca.vertcat(*[known[name] for name in order])
    way = target - start
    for k in range(1, STAGES + LAST_STEPS):
        part = min(1.0, k / STAGES)
        here = target if part == 1.0 else start + part * way
        e, A = step(here, now)
        change = solve_square(A, e)
        now = now - change
        if k == STAGES:
            now = ca.floor(now / GRAIN + 0.5) * GRAIN
    closed = ca.dot(change, change) < LAST_CHANGE**2
    return {
        name: ca.if_else(closed, x, np.nan)
        for name, x in zip(unknown, ca.vertsplit(now), strict=True)
    }


def independent_errors(
    model: RobotModel, loops: Sequence[Loop], unknown: Sequence[str], values: Joints
) -> ca.SX:
    """As many errors (n,) of some loops as they have ``unknown`` joints, zero where they are
    closed; ``values``: of all coordinates and passive joints.
    """
    error = ca.vertcat(*[_error(model, loop, values) for loop in loops])
    rows = ca.sparsify(ca.DM(_independent(model, loops, unknown, home_closure(model))))
    return ca.densify(ca.mtimes(ca.SX(rows), error))


def _inside(model: RobotModel, loops: Sequence[Loop]) -> list[str]:
    """Coordinates and passive joints that move some loops."""
    sums = shares(model)
    joints = [dof.name for loop in loops for dof in branches(model, loop).joints]
    return list(dict.fromkeys(k for name in joints for k in sums[name]))


def _error(model: RobotModel, loop: Loop, values: Joints) -> ca.SX:
    """Errors of a loop as in `flexgen.model.format.closure`."""
    sums = shares(model)
    found = branches(model, loop)
    ends = []
    for steps in (found.start, found.end):
        p = ca.SX.zeros(3)
        R = ca.SX.eye(3)
        for step in steps:
            if isinstance(step, Placement):
                p = p + ca.mtimes(R, ca.DM(step.position))
                R = ca.mtimes(R, ca.sparsify(ca.DM(np.array(step.rotation))))
                continue
            q = reduce(lambda a, b: a + b, [x * values[k] for k, x in sums[step.name].items()])
            if step.type == "rotation":
                R = ca.mtimes(R, _turn(step.axis, q))
            else:
                p = p + ca.mtimes(R, ca.DM(step.axis)) * q
        ends.append((p, R))
    (p1, R1), (p2, R2) = ends
    if loop.type == "point":
        return ca.densify(p2 - p1)
    E = ca.mtimes(R1.T, R2)
    if loop.type == "axis":
        return ca.densify(ca.vertcat(p2 - p1, E[0, 2], E[1, 2]))
    tilt = ca.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]) / 2
    return ca.densify(ca.vertcat(p2 - p1, tilt))


def _turn(axis: Sequence[float], q: ca.SX) -> ca.SX:
    """Rotation matrix about a constant unit axis (Rodrigues), with the zeros of its structure."""
    x, y, z = axis
    hat = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    odd, even = (ca.sparsify(ca.DM(A)) for A in (hat, hat @ hat))
    return ca.SX.eye(3) + ca.sin(q) * odd + (1 - ca.cos(q)) * even


def _independent(
    model: RobotModel, loops: Sequence[Loop], unknown: Sequence[str], home: Values
) -> np.ndarray:
    """Combinations (n, m) of the errors of some loops that determine n ``unknown`` joints: rows
    that some joint changes, or where these are too many their principal directions.
    """
    at = closure(model, home)
    sizes = {"point": 3, "axis": 5, "pose": 6}
    kept = np.concatenate([np.full(sizes[loop.type], loop in loops) for loop in model.loops])
    A = at.of(unknown)[kept]
    rows = np.eye(len(A))[np.abs(A).max(axis=1) > ALIGNED]
    if len(rows) == len(unknown):
        return rows
    left: np.ndarray = np.linalg.svd(A)[0][:, : len(unknown)].T
    return left
