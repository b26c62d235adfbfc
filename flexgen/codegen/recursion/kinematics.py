"""Pose and Jacobian of the tool over a `Chain`, written on a `Tape`.

Joints with parallel axes form a group: one rotation by the sum of their angles, and the offsets
from one joint to the next are added up in the plane normal to the axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from flexgen.codegen.recursion.composite_body import Matrix, combine_axes
from flexgen.codegen.recursion.dh_chain import Chain, Joint
from flexgen.codegen.recursion.newton_euler import Vector3, X, Y, Z, cross, plus, tilt, turn_by
from flexgen.codegen.recursion.tape import Scalar, Tape


@dataclass
class _Group:
    """Neighbors with parallel axes: a frame before them that rotates with none of them, and its
    axes in the world.

    ``members``: joints by number, with the place of each in the group's frame. ``turn`` (cosine,
    sine): by all of them. ``step``: from the group's origin to the last of them, in the group's
    frame; ``place``: from there to the next group, in the rotated axes.
    """

    origin: Vector3
    axes: Matrix  # columns
    members: list[tuple[int, Vector3]] = field(default_factory=list)
    turn: tuple[Scalar, Scalar] = (1.0, 0.0)
    step: Vector3 = field(default_factory=lambda: [0.0] * 3)
    place: Vector3 = field(default_factory=lambda: [0.0] * 3)

    @property
    def turned(self) -> Matrix:
        """The axes after all of its members."""
        c, s = self.turn
        return [
            combine_axes(self.axes, [c, s, 0.0]),
            combine_axes(self.axes, [-s, c, 0.0]),
            self.axes[Z],
        ]

    @property
    def end(self) -> Vector3:
        """Its end, in the world."""
        return plus(
            plus(self.origin, combine_axes(self.axes, self.step)),
            combine_axes(self.turned, self.place),
        )


def _rotate_about_z(turn: tuple[Scalar, Scalar], v: Sequence[Scalar]) -> Vector3:
    """``Rz v``."""
    c, s = turn
    return [c * v[X] - s * v[Y], s * v[X] + c * v[Y], v[Z]]


def _tilt_axes(joint: Joint, axes: Matrix) -> Matrix:
    """Axes after the lead and the twist of a joint."""
    columns: list[Vector3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    return [combine_axes(axes, tilt(joint, column)) for column in columns]


def _groups(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> list[_Group]:
    """All groups of joints with parallel axes between the base and the tool at q, the last with
    the tool as its end.
    """
    rotation, position = chain.base
    group = _Group(position.tolist(), rotation.T.tolist())
    groups = [group]
    angle: Scalar = 0.0
    quarters = 0
    for i in chain.to_tool:
        joint = chain.joints[i]
        x = q[i]
        if joint.twist != (1.0, 0.0):
            group.place = joint.place.tolist()
            group = _Group(group.end, _tilt_axes(joint, group.turned))
            groups.append(group)
            angle = 0.0
            quarters = 0
        else:
            group.step = plus(group.step, _rotate_about_z(group.turn, joint.place.tolist()))
        if joint.revolute:
            angle = angle + (x + joint.turn)
        else:
            angle = angle + joint.turn
            group.step = plus(group.step, [0.0, 0.0, x])
        quarters += joint.quarters
        group.members.append((i, group.step))
        group.turn = turn_by(tape, angle, quarters)
    group.place = chain.tool[1].tolist()
    return groups


def tool_pose(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> tuple[Vector3, Matrix]:
    """Position of the tool [m] and its rotation (by rows), in the world.

    Parameters
    ----------
    tape : Tape
        To write on.
    chain : Chain
        The robot.
    q : sequence of Scalar
        Coordinates [rad, m].

    Returns
    -------
    tuple
        Shapes (3,) and (3, 3).
    """
    last = _groups(tape, chain, q)[-1]
    columns = [combine_axes(last.turned, column) for column in chain.tool[0].T.tolist()]
    return last.end, [list(row) for row in zip(*columns, strict=True)]


def jacobian(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> Matrix:
    """Jacobian of the tool: linear, then angular velocity in the world, by rows; arguments as for
    `tool_pose`.
    """
    groups = _groups(tape, chain, q)
    columns: list[list[Scalar]] = [[0.0] * 6 for _ in q]
    to_tool = plus(groups[-1].step, _rotate_about_z(groups[-1].turn, groups[-1].place))
    for k, group in reversed(list(enumerate(groups))):
        for i, at in reversed(group.members):
            if chain.joints[i].revolute:
                r = [to_tool[X] - at[X], to_tool[Y] - at[Y]]
                columns[i] = [*combine_axes(group.axes, [-r[1], r[0], 0.0]), *group.axes[Z]]
            else:
                columns[i] = [*group.axes[Z], 0.0, 0.0, 0.0]
        if k > 0:
            behind = tilt(chain.joints[group.members[0][0]], to_tool)
            last = groups[k - 1]
            to_tool = plus(last.step, _rotate_about_z(last.turn, plus(last.place, behind)))
    return [list(row) for row in zip(*columns, strict=True)]


@dataclass(frozen=True)
class Rates:
    """Jacobian of the tool with its first two time derivatives, and the tool's angular motion, in
    the world.

    ``columns``: for each joint ``(J, J', J'')``, each the linear, then the angular part (6).
    ``w``, ``dw``: angular velocity and acceleration (3); ``bias``: linear and angular acceleration
    (6), all at the accelerations given.
    """

    columns: list[tuple[Vector3, Vector3, Vector3]]
    w: Vector3
    dw: Vector3
    bias: Vector3


def rates(
    tape: Tape, chain: Chain, q: Sequence[Scalar], v: Sequence[Scalar], a: Sequence[Scalar]
) -> Rates:
    """The `Rates` at speeds v and accelerations a; arguments otherwise as for `tool_pose`.

    An axis z of a body with angular velocity w moves with ``z' = w x z``,
    ``z'' = w' x z + w x z'``, and so does the offset s from one joint to the next; r is the sum of
    the offsets from a joint to the tool:

        J = (z x r, z),    J' = (z' x r + z x r', z'),
        J'' = (z'' x r + 2 z' x r' + z x r'', z'')
    """
    axes: Matrix = chain.base[0].T.tolist()
    w: Vector3 = [0.0] * 3
    dw: Vector3 = [0.0] * 3
    turned = axes
    angle: Scalar = 0.0
    quarters = 0
    ways: list[tuple[Vector3, Vector3, Vector3]] = []
    lines: list[tuple[Vector3, Vector3, Vector3]] = []
    for i in chain.to_tool:
        joint = chain.joints[i]
        x = q[i]
        speed = v[i]
        acceleration = a[i]
        ways.append(_differentiate_rotating(combine_axes(turned, joint.place.tolist()), w, dw))
        if joint.twist != (1.0, 0.0) or not lines:
            axes = _tilt_axes(joint, turned)
            angle = 0.0
            quarters = 0
        line = _differentiate_rotating(axes[Z], w, dw)
        z, z1, z2 = line
        lines.append(line)
        angle = angle + (x + joint.turn if joint.revolute else joint.turn)
        quarters += joint.quarters
        c, s = turn_by(tape, angle, quarters)
        turned = [combine_axes(axes, [c, s, 0.0]), combine_axes(axes, [-s, c, 0.0]), axes[Z]]
        if joint.revolute:
            dw = [dw[k] + z[k] * acceleration + z1[k] * speed for k in (X, Y, Z)]
            w = [w[k] + z[k] * speed for k in (X, Y, Z)]
        else:
            way, first, second = ways.pop()
            twice = 2.0 * speed
            second = [
                second[k] + z[k] * acceleration + z1[k] * twice + z2[k] * x for k in (X, Y, Z)
            ]
            first = [first[k] + z[k] * speed + z1[k] * x for k in (X, Y, Z)]
            ways.append(([way[k] + z[k] * x for k in (X, Y, Z)], first, second))
    ways.append(_differentiate_rotating(combine_axes(turned, chain.tool[1].tolist()), w, dw))
    columns: list[tuple[Vector3, Vector3, Vector3]] = [
        ([0.0] * 6, [0.0] * 6, [0.0] * 6) for _ in q
    ]
    r, r1, r2 = ways[-1]
    for i, (z, z1, z2), step in zip(
        reversed(chain.to_tool), reversed(lines), reversed(ways[:-1]), strict=True
    ):
        if chain.joints[i].revolute:
            double = [2.0 * x for x in z1]
            first = plus(cross(z1, r), cross(z, r1))
            second = plus(plus(cross(z2, r), cross(double, r1)), cross(z, r2))
            columns[i] = [*cross(z, r), *z], [*first, *z1], [*second, *z2]
        else:
            columns[i] = [*z, 0.0, 0.0, 0.0], [*z1, 0.0, 0.0, 0.0], [*z2, 0.0, 0.0, 0.0]
        r = plus(r, step[0])
        r1 = plus(r1, step[1])
        r2 = plus(r2, step[2])
    return Rates(columns, w, dw, [*r2, *dw])


def _differentiate_rotating(
    s: Vector3, w: Vector3, dw: Vector3
) -> tuple[Vector3, Vector3, Vector3]:
    """A vector that rotates with the angular velocity w, and its first two time derivatives."""
    first = cross(w, s)
    return s, first, plus(cross(dw, s), cross(w, first))
