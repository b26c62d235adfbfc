"""Pose and Jacobian of the tool over a `Chain`, written on a `Tape`.

Joints whose axes are parallel are taken together: the sum of their angles turns a frame once, and the way from one to
the next is added up in the plane across their axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from flexgen.mechanics.chain import Chain
from flexgen.mechanics.composite import Matrix
from flexgen.mechanics.recursion import Vector3, X, Y, Z, plus, turn_by
from flexgen.mechanics.tape import Scalar, Tape


@dataclass
class _Group:
    """Neighbours with parallel axes: a frame before them that turns with none, and the axes of that frame in the world.

    ``members``: joints by number, with the place of each in the group's frame. ``turn`` (cosine, sine): by all of them.
    ``step``: from the group's origin to the last of them, in the group's frame; ``place``: from there to what comes
    next, in the axes that have turned.
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
        return [combined(self.axes, [c, s, 0.0]), combined(self.axes, [-s, c, 0.0]), self.axes[Z]]

    @property
    def end(self) -> Vector3:
        """Where it ends, in the world."""
        return plus(plus(self.origin, combined(self.axes, self.step)), combined(self.turned, self.place))


def combined(axes: Matrix, v: Sequence[Scalar]) -> Vector3:
    """``sum_k v_k axes_k``."""
    return [axes[0][i] * v[0] + axes[1][i] * v[1] + axes[2][i] * v[2] for i in (X, Y, Z)]


def _rolled(turn: tuple[Scalar, Scalar], v: Sequence[Scalar]) -> Vector3:
    """``Rz v``."""
    c, s = turn
    return [c * v[X] - s * v[Y], s * v[X] + c * v[Y], v[Z]]


def _groups(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> list[_Group]:
    """All groups of a chain, the last with the tool as its end."""
    rotation, position = chain.base
    group = _Group(position.tolist(), rotation.T.tolist())
    groups = [group]
    angle: Scalar = 0.0
    quarters = 0
    for i, (joint, x) in enumerate(zip(chain.joints, q, strict=True)):
        if joint.twist != (1.0, 0.0):
            group.place = joint.place.tolist()
            axes, (cosine, sine) = group.turned, joint.twist
            axes = [axes[X], combined(axes, [0.0, cosine, sine]), combined(axes, [0.0, -sine, cosine])]
            group = _Group(group.end, axes)
            groups.append(group)
            angle, quarters = 0.0, 0
        else:
            group.step = plus(group.step, _rolled(group.turn, joint.place.tolist()))
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
    columns = [combined(last.turned, column) for column in chain.tool[0].T.tolist()]
    return last.end, [list(row) for row in zip(*columns, strict=True)]


def jacobian(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> Matrix:
    """Jacobian of the tool: linear, then angular velocity in the world, by rows; arguments as for `tool_pose`."""
    groups = _groups(tape, chain, q)
    columns: list[list[Scalar]] = []
    to_tool = plus(groups[-1].step, _rolled(groups[-1].turn, groups[-1].place))
    for k, group in reversed(list(enumerate(groups))):
        for i, at in reversed(group.members):
            if chain.joints[i].revolute:
                r = [to_tool[X] - at[X], to_tool[Y] - at[Y]]
                columns.insert(0, [*combined(group.axes, [-r[1], r[0], 0.0]), *group.axes[Z]])
            else:
                columns.insert(0, [*group.axes[Z], 0.0, 0.0, 0.0])
        if k > 0:
            cosine, sine = chain.joints[group.members[0][0]].twist
            x, y, z = to_tool
            twisted_back = [x, cosine * y - sine * z, sine * y + cosine * z]
            last = groups[k - 1]
            to_tool = plus(last.step, _rolled(last.turn, plus(last.place, twisted_back)))
    return [list(row) for row in zip(*columns, strict=True)]
