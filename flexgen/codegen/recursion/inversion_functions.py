"""The functions of `flexgen.dynamics.mechanics.inversion_functions` by recursion.

The order of derivatives in time and in coordinates may be changed: the derivative of the tool's
velocity in a coordinate is the time derivative of that column of the Jacobian, and so on. Angular
velocities are not derivatives of coordinates, which adds a term:

    d(W v)/dq = W' - (0, w x z),    d(W a + W' v)/dq = W'' - (0, w' x z + w x z'),
    d(W' v)/dv = 2 W' - (0, w x z)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from flexgen.codegen.recursion import kinematics
from flexgen.codegen.recursion.arm import Arm, Columns, matrix_of
from flexgen.codegen.recursion.dh_chain import Chain, make_chain
from flexgen.codegen.recursion.newton_euler import Vector3, cross
from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.dynamics.mechanics import inversion_functions as definition
from flexgen.dynamics.mechanics.inversion_functions import (
    constraint_ports,
    derivative_ports,
    row_ports,
)
from flexgen.dynamics.mechanics.outputs import pose_error
from flexgen.dynamics.mechanics.system import Built
from flexgen.dynamics.mechanics.tool_angle import ToolAngle, plane_axes, tool_angle


def _output_constraint(arm: Arm) -> Built:
    """Distance of the output from its target, ``W`` (n_y, n_a) with ``dy = W v``, and ``W' v``
    (n_y): ports of `constraint_ports`.

    ``W' v`` and W are built from the rates of the kinematics or by `arm.jacobian`, whichever takes
    fewer operations.
    """
    equations = arm.equations
    output = arm.model.output
    if output.type == "combination":
        return definition.output_constraint(equations)
    q_a, v_a = arm.symbols("q_a", "v_a")
    tape = Tape()
    chain = make_chain(arm.tree, to_mass=False)
    q = tape.vector(q_a)
    v = tape.vector(v_a)
    at = arm.joints(tape, q, v)
    p, R = kinematics.tool_pose(tape, chain, at.q)
    moving = kinematics.rates(tape, chain, at.q, at.v, at.a)
    kept = _rate_rows(arm)
    chosen = [
        [arm.jacobian(tape, chain, q)[i] for i in kept],
        [at.gather([J[i] for J, _, _ in moving.columns]) for i in kept],
    ]
    bias = [moving.bias[i] for i in kept]
    W = min(chosen, key=lambda A: tape.count([*bias, *(x for row in A for x in row)]))
    n_y = len(kept)
    n_a = arm.model.n_a
    flat = tape.build([*p, *(x for row in R for x in row), *bias, *(x for row in W for x in row)])
    place = ca.vertcat(*flat[:3])
    turn = matrix_of(flat[3:12], 3)
    flat = flat[12:]
    target = ca.SX.sym("target", output.target_size)
    W = matrix_of(flat[n_y:], n_a)
    bias_rows = ca.vertcat(*flat[:n_y])
    sums = ca.SX(ca.DM(output.weights)) if output.weights else ca.SX(0, n_a)
    still = ca.SX.zeros(len(output.weights))
    if output.is_pose:
        place = ca.vertcat(place, ca.mtimes(sums, q_a))
        W = ca.vertcat(W[:3, :], sums, W[3:, :])
        bias_rows = ca.vertcat(bias_rows[:3], still, bias_rows[3:])
        return constraint_ports(equations, target, pose_error(place, turn, target), W, bias_rows)
    if output.has_angle:
        angle = _angle(arm)
        error = ca.vertcat(place[kept], angle.value) - target[: output.tool_size]
        W = ca.vertcat(W, angle.rate)
        bias_rows = ca.vertcat(bias_rows, angle.bias)
    else:
        error = place[kept] - target[: len(kept)]
    if output.weights:
        error = ca.vertcat(error, ca.mtimes(sums, q_a) - target[output.tool_size :])
        W = ca.vertcat(W, sums)
        bias_rows = ca.vertcat(bias_rows, still)
    return constraint_ports(equations, target, error, W, bias_rows)


@dataclass(frozen=True)
class _Angle:
    """The angle of the tool about one axis: its ``value``, the row ``rate`` (1, n_a) with which it
    moves, and ``bias``, its acceleration at constant speeds.

    ``changes``: derivatives (1, n_a) of the rate in coordinates, and of the acceleration in
    coordinates and speeds.
    """

    value: ca.SX
    rate: ca.SX
    bias: ca.SX
    changes: tuple[ca.SX, ca.SX, ca.SX]


def _angle(arm: Arm) -> _Angle:
    """The angle from the graphs of the Lagrangian; of robots with closed loops from the rotation
    of the tool in the joints.
    """
    q_a, v_a, a_a = arm.symbols("q_a", "v_a", "a_a")
    known = tool_angle(arm.equations)
    if arm.closed is not None and not known.is_sum:
        return _angle_of_joints(arm, known)
    rate = ca.mtimes(known.rate, v_a)
    second = ca.jtimes(rate, ca.vertcat(q_a, v_a), ca.vertcat(v_a, a_a))
    bias = ca.jtimes(rate, q_a, v_a)
    changes = (
        ca.jacobian(rate, q_a),
        ca.jacobian(second, q_a),
        ca.jacobian(second, v_a),
    )
    return _Angle(known.value, known.rate, bias, changes)


def _angle_of_joints(arm: Arm, known: ToolAngle) -> _Angle:
    """The angle as a function of the joints, which are functions of the coordinates."""
    assert arm.closed is not None
    given = arm.symbols("q_a", "v_a", "a_a")
    output = arm.model.output
    n = len(arm.tree_joints)
    q, v, a = (ca.SX.sym(name, n) for name in "qva")
    tape = Tape()
    _, turn = kinematics.tool_pose(tape, make_chain(arm.tree, to_mass=False), tape.vector(q))
    R = matrix_of(tape.build([x for row in turn for x in row]), 3)
    u = R[:, "xyz".index(output.reference)]
    c, s = (ca.dot(ca.DM(axis), u) for axis in plane_axes(output))
    row = ca.jacobian(ca.atan2(s, c), q)
    rate = ca.mtimes(row, v)
    second = ca.jtimes(rate, ca.vertcat(q, v), ca.vertcat(v, a))
    by_q, again, by_v = (ca.jacobian(x, y) for x, y in ((rate, q), (second, q), (second, v)))
    at = ca.Function("angle", [q, v, a], [c, s, row, second, by_q, again, by_v])
    still = ca.SX.zeros(arm.model.n_a)
    *motion, _ = arm.closed.motion.call([given[0], given[1], still])
    bias = at.call(motion)[3]
    *motion, _ = arm.closed.motion.call(given)
    c, s, row, _, by_q, again, by_v = at.call(motion)
    changes = _in_coordinates(arm, row, by_q, again, by_v)
    linear = ca.dot(ca.DM(known.weights), given[0]) + known.offset
    cosine = ca.cos(linear)
    sine = ca.sin(linear)
    value = linear + ca.atan2(s * cosine - c * sine, c * cosine + s * sine)
    return _Angle(value, ca.mtimes(row, arm.closed.changes(*given).N), bias, changes)


def _in_coordinates(
    arm: Arm, J: ca.SX, by_q: ca.SX, again: ca.SX, by_v: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Derivatives of a rate ``J v_j`` in coordinates, and of the acceleration in coordinates and
    speeds, of robots with closed loops.

    ``by_q``, ``again``, ``by_v`` (m, n_j): these derivatives in the joints and their speeds.
    """
    assert arm.closed is not None
    by = arm.closed.changes(*arm.symbols("q_a", "v_a", "a_a"))
    J, by_q, again, by_v = (ca.sparsify(x) for x in (J, by_q, again, by_v))
    return (
        ca.densify(ca.mtimes(by_q, by.N) + ca.mtimes(J, by.S)),
        ca.densify(ca.mtimes(again, by.N) + ca.mtimes(by_v, by.S) + ca.mtimes(J, by.A)),
        ca.densify(ca.mtimes(by_v, by.N) + 2 * ca.mtimes(J, by.S)),
    )


def _rate_rows(arm: Arm) -> list[int]:
    """Rows of the tool's twist that are rates of the output; without the angle about one axis."""
    output = arm.model.output
    return list(range(6)) if output.type == "tool_pose" else list(output.tool_rows)


def _inversion_rows(arm: Arm) -> Built:
    """Torques of the gears ``tau_g`` and rows without motor ``row`` at ``q_a, v_a, a_a``: ports of
    `row_ports`.
    """
    inputs = arm.symbols("q_a", "v_a", "a_a")

    def route(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, a = (tape.vector(x) for x in inputs)
        return arm.torques(tape, chain, q, v, a, columns)

    return row_ports(arm.equations, ca.vertcat(*arm.shortest([route], several=False)))


def _inversion_jacobians(arm: Arm) -> Built:
    return derivative_ports(arm.equations, _output_jacobians(arm), _row_jacobians(arm))


def _output_jacobians(arm: Arm) -> list[ca.SX]:
    """Derivatives of ``W v`` in q, and of ``W a + W' v`` in q and v, (n_y, n_a) each."""
    if arm.model.output.type == "combination":
        return [ca.SX.zeros(arm.model.output.size, arm.model.n_a) for _ in range(3)]
    tape = Tape()
    at = arm.joints(tape, *(tape.vector(x) for x in arm.symbols("q_a", "v_a", "a_a")))
    moving = kinematics.rates(tape, make_chain(arm.tree, to_mass=False), at.q, at.v, at.a)
    still: Vector3 = [0.0] * 3
    found: list[list[list[Scalar]]] = [[], [], []]  # columns
    for J, first, second in moving.columns:
        turned = [*still, *cross(moving.w, J[3:])]
        again = [
            *still,
            *(
                x + y
                for x, y in zip(cross(moving.dw, J[3:]), cross(moving.w, first[3:]), strict=True)
            ),
        ]
        found[0].append([x - y for x, y in zip(first, turned, strict=True)])
        found[1].append([x - y for x, y in zip(second, again, strict=True)])
        found[2].append([2.0 * x - y for x, y in zip(first, turned, strict=True)])
    kept = _rate_rows(arm)
    n = arm.model.n_a
    if arm.closed is not None:
        found.append([J for J, _, _ in moving.columns])
        flat = tape.build([column[i] for columns in found for i in kept for column in columns])
        size = len(kept) * len(at.q)
        parts = [matrix_of(flat[k * size : (k + 1) * size], len(at.q)) for k in range(4)]
        rows = list(_in_coordinates(arm, parts[3], *parts[:3]))
    else:
        flat = tape.build(
            [column[i] for columns in found for i in kept for column in at.gather(columns)]
        )
        size = len(kept) * n
        rows = [matrix_of(flat[k * size : (k + 1) * size], n) for k in range(3)]
    output = arm.model.output
    if output.has_angle:
        rows = [ca.vertcat(*pair) for pair in zip(rows, _angle(arm).changes, strict=True)]
    before = output.tool_size
    none = ca.SX.zeros(len(output.weights), n)
    return [ca.vertcat(x[:before, :], none, x[before:, :]) for x in rows]


def _row_jacobians(arm: Arm) -> list[ca.SX]:
    """The rows without motor of ``M a + c + g`` (n_e), and their derivatives in q, v and a (n_e,
    n_a).
    """
    inputs = arm.symbols("q_a", "v_a", "a_a")
    e = arm.model.i_e
    n = arm.model.n_a
    if not e:
        return []
    if arm.closed is not None:
        return arm.closed_changes(e)

    def by_recursion(tape: Tape, chain: Chain, columns: Columns) -> list[Scalar]:
        q, v, a = (tape.vector(x) for x in inputs)
        tau = arm.torques(tape, chain, q, v, a, columns)
        found = arm.torque_changes(tape, chain, q, v, a, columns)
        return [*(tau[i] for i in e), *(x for A in found for i in e for x in A[i])]

    flat = arm.shortest([by_recursion])
    size = len(e) * n
    parts = [flat[len(e) + k * size : len(e) + (k + 1) * size] for k in range(3)]
    return [ca.vertcat(*flat[: len(e)]), *(matrix_of(part, n) for part in parts)]


BUILDERS: dict[str, Callable[[Arm], Built]] = {
    "output_constraint": _output_constraint,
    "inversion_jacobians": _inversion_jacobians,
    "inversion_rows": _inversion_rows,
}
