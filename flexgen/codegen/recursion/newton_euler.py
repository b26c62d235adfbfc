"""Newton-Euler and composite-body recursions over a `Chain`, written on a `Tape`.

Motion of a frame: angular velocity ``w``, acceleration of the origin ``a`` (gravity included), and
the matrix ``U = dw^ + w^ w^`` that gives the acceleration ``a + U r`` of a point r. A body with
moments m, s, S (order zero, one, two) then needs

    f = m a + U s,            n = s x a + axial(U S),
    axial(A) = (A_zy - A_yz, A_xz - A_zx, A_yx - A_xy)

The column ``U e_z`` is invariant under the rotation of a joint about its own z axis, which saves
the gyroscopic terms of the angular acceleration where U of the body before is known anyway.

Source: after W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, sec. 9.6;
R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from flexgen.codegen.recursion.dh_chain import Chain, Inertia, Joint
from flexgen.codegen.recursion.tape import Scalar, Tape, Value

X = 0
Y = 1
Z = 2
Vector3 = list[Scalar]
Wrench = tuple[Vector3, Vector3]  # force, moment about the origin of the frame


# --- rotations, cross products--------------------------------------------------------------------


@dataclass(frozen=True)
class Turn:
    """The rotation of a joint: lead and twist (numbers), then an angle about z by its cosine and
    sine.
    """

    lead: tuple[float, float]
    twist: tuple[float, float]
    cosine: Scalar
    sine: Scalar
    angle: Scalar
    quarters: int

    def into(self, v: Vector3) -> Vector3:
        """A vector of the frame before, in the joint's frame."""
        x, y, z = untilt(self, v)
        return [self.cosine * x + self.sine * y, self.cosine * y - self.sine * x, z]

    def back(self, v: Vector3) -> Vector3:
        """A vector of the joint's frame, in the frame before."""
        x = self.cosine * v[0] - self.sine * v[1]
        y = self.sine * v[0] + self.cosine * v[1]
        return tilt(self, [x, y, v[2]])


def untilt(by: Joint | Turn, v: Vector3) -> Vector3:
    """``Rx(twist)' Rz(lead)' v``."""
    (c, s) = by.lead
    (cosine, sine) = by.twist
    x = c * v[0] + s * v[1]
    y = c * v[1] - s * v[0]
    return [x, cosine * y + sine * v[2], cosine * v[2] - sine * y]


def tilt(by: Joint | Turn, v: Vector3) -> Vector3:
    """``Rz(lead) Rx(twist) v``."""
    (c, s) = by.lead
    (cosine, sine) = by.twist
    y = cosine * v[1] - sine * v[2]
    z = cosine * v[2] + sine * v[1]
    return [c * v[0] - s * y, c * y + s * v[0], z]


def turn_of(tape: Tape, joint: Joint, q: Scalar) -> Turn:
    """The rotation of a joint at its coordinate."""
    angle = q + joint.turn if joint.revolute else joint.turn
    return Turn(
        joint.lead, joint.twist, *turn_by(tape, angle, joint.quarters), angle, joint.quarters
    )


def turn_by(tape: Tape, angle: Scalar, quarters: int) -> tuple[Scalar, Scalar]:
    """Cosine and sine of an angle [rad] plus a number of quarter turns, which cost nothing."""
    c: Scalar
    s: Scalar
    if isinstance(angle, Value):
        c = tape.sine(angle, cosine=True)
        s = tape.sine(angle)
    else:
        c = math.cos(angle)
        s = math.sin(angle)
    for _ in range(quarters % 4):
        c, s = -s, c
    return c, s


def cross(a: Sequence[Scalar], b: Sequence[Scalar]) -> Vector3:
    """``a x b``."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def plus(a: Sequence[Scalar], b: Sequence[Scalar]) -> Vector3:
    """``a + b``."""
    return [x + y for x, y in zip(a, b, strict=True)]


# --- motion --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Root:
    """Quantities that neighbors with parallel axes share, in the frame before the first of them.

    Of the angular velocity, of ``U e_z`` and of the acceleration (the same for all in a chain of
    translations) only the components normal to the axes. ``angle``, ``quarters``: rotation since
    that frame.
    """

    w: Vector3
    column: Vector3
    a: Vector3
    angle: Scalar
    quarters: int


@dataclass(frozen=True)
class Motion:
    """Angular velocity of a frame, acceleration of its origin, and either its angular acceleration
    or the column.

    ``spin``: angular acceleration (3), its first two entries None where ``column`` (2), the upper
    part of ``U e_z``, is known instead. All in the frame's axes; products are shared by the tape.
    ``root``: start of the neighbors with parallel axes.
    """

    w: Vector3
    a: Vector3
    spin: tuple[Scalar | None, Scalar | None, Scalar]
    column: tuple[Scalar, Scalar] | None = None
    root: _Root | None = None

    @property
    def dw(self) -> Vector3:
        """The angular acceleration."""
        w = self.w
        (x, y, z) = self.spin
        if self.column is not None:
            x = w[Y] * w[Z] - self.column[Y]
            y = self.column[X] - w[X] * w[Z]
        assert x is not None and y is not None
        return [x, y, z]

    def U(self, i: int, k: int) -> Scalar:
        """Entry (i, k) of the matrix ``dw^ + w^ w^``, which gives the acceleration of a point of
        the body relative to the origin.
        """
        w = self.w
        if i == k:
            j = (i + 1) % 3
            k = (i + 2) % 3
            return -(w[j] * w[j] + w[k] * w[k])
        if k == Z and self.column is not None:
            return self.column[i]
        other = 3 - i - k
        turned = self.dw[other]
        return w[i] * w[k] + (turned if (k + 1) % 3 == i else -turned)

    def along(self, r: Sequence[Scalar]) -> Vector3:
        """``U r``."""
        out: Vector3 = [0.0, 0.0, 0.0]
        for k in (X, Y, Z):
            if _any(r[k : k + 1]):
                out = [out[i] + self.U(i, k) * r[k] for i in (X, Y, Z)]
        return out


def _any(x: Sequence[Scalar]) -> bool:
    """True where a value is not the number zero."""
    return any(isinstance(y, Value) or y != 0.0 for y in x)


def _sparse(x: Sequence[Scalar]) -> bool:
    """True where x is known and has a zero across the axis."""
    return bool(x) and not (_any(x[:1]) and _any(x[1:2]))


def move_to_next_frame(
    tape: Tape,
    motion: Motion,
    joint: Joint,
    turn: Turn,
    x: Scalar,
    v: Scalar,
    dv: Scalar,
    by_column: bool,
) -> Motion:
    """The motion of the next frame, whose joint has the coordinate x, the speed v and the
    acceleration dv; ``turn``: the rotation of the joint.

    ``by_column``: angular acceleration as the z column of U instead of a vector. The ``root`` of a
    motion holds the vectors at the first of joints with parallel axes, from which they can be
    turned by the sum of the angles.
    """
    carried = motion.along(joint.place.tolist())
    # U e_z of the frame before, with the axis of this joint in it
    axis = motion.along(tilt(joint, [0.0, 0.0, 1.0]) if by_column else [0.0] * 3)
    root = motion.root
    total = replace(turn, lead=(1.0, 0.0), twist=(1.0, 0.0))
    if root is not None and joint.twist == (1.0, 0.0):
        root = replace(root, angle=root.angle + turn.angle, quarters=root.quarters + turn.quarters)
        total = Turn(
            joint.lead,
            joint.twist,
            *turn_by(tape, root.angle, root.quarters),
            root.angle,
            root.quarters,
        )
    else:
        w, column, a = (untilt(joint, x) for x in (motion.w, axis, motion.a))
        root = _Root(w, column, a, turn.angle, turn.quarters)

    def rotate(x: Vector3, first: Vector3) -> Vector3:
        """The vector in the joint's frame. ``x``: the vector in the frame before; ``first``: the
        same vector at the root.

        Where components of ``first`` are zero, turning it by the sum of the angles takes fewer
        operations; z is the same either way.
        """
        return [*total.into(first)[:2], turn.into(x)[Z]] if _sparse(first) else turn.into(x)

    w = rotate(motion.w, root.w)
    a = rotate(motion.a, root.a) if not _any(carried) else turn.into(plus(motion.a, carried))
    if _any(carried):
        root = replace(root, a=[])
    if by_column:
        column = rotate(axis, root.column)
        spin = untilt(joint, motion.dw)[Z]
        if joint.revolute:
            return Motion(
                [w[X], w[Y], w[Z] + v], a, (None, None, spin + dv), (column[X], column[Y]), root
            )
        known = Motion(w, a, (None, None, spin), (column[X], column[Y]), root)
    else:
        dw = turn.into(motion.dw)
        root = replace(root, column=[])
        if joint.revolute:
            return Motion(
                [w[X], w[Y], w[Z] + v],
                a,
                (dw[X] + w[Y] * v, dw[Y] - w[X] * v, dw[Z] + dv),
                None,
                root,
            )
        known = Motion(w, a, (dw[X], dw[Y], dw[Z]), None, root)
    slid = known.along([0.0, 0.0, x])
    twice = 2.0 * v
    root = replace(root, a=[])
    return replace(
        known,
        root=root,
        a=[a[X] + slid[X] + w[Y] * twice, a[Y] + slid[Y] - w[X] * twice, a[Z] + slid[Z] + dv],
    )


def wrench(motion: Motion, body: Inertia) -> Wrench:
    """Force and moment (about the origin of its frame) that a body needs for its motion: ``m a + U
    s`` and ``s x a`` plus the vector of the skew matrix ``U S - (U S)'``.

    s, S: first and second moments of its mass, ``U = dw^ + w^ w^``. Zeros and equal diagonal
    entries of S are used to leave terms out.
    """
    s = body.first.tolist()
    S = body.second.tolist()
    force = motion.along(s)
    if body.mass:
        force = [body.mass * motion.a[i] + force[i] for i in (X, Y, Z)]
    moment = cross(s, motion.a)
    w = motion.w
    for i in (X, Y, Z):
        j = (i + 1) % 3
        k = (i + 2) % 3
        if S[j][j] == S[k][k]:
            moment[i] = moment[i] + (2.0 * S[j][j]) * motion.dw[i] if S[j][j] else moment[i]
        else:
            moment[i] = moment[i] + (S[j][j] * motion.U(k, j) if S[j][j] else 0.0)
            moment[i] = moment[i] - (S[k][k] * motion.U(j, k) if S[k][k] else 0.0)
        if S[i][j]:
            moment[i] = moment[i] + S[i][j] * motion.U(k, i)
        if S[i][k]:
            moment[i] = moment[i] - S[i][k] * motion.U(j, i)
        if S[j][k]:
            moment[i] = moment[i] + S[j][k] * (w[k] * w[k] - w[j] * w[j])
    # (U_kk - U_jj) = (w_i^2 + w_k^2) - (w_i^2 + w_j^2)
    return force, moment


# --- inverse dynamics ----------------------------------------------------------------------------


def inverse_dynamics(
    tape: Tape,
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    dv: Sequence[Scalar],
    columns: Sequence[bool],
) -> list[Scalar]:
    """Generalized forces of the bodies, ``M dv + c + g``.

    Parameters
    ----------
    tape : Tape
        To write on.
    chain : Chain
        The robot.
    q, v, dv : sequence of Scalar
        Coordinates, speeds and accelerations [rad, m].
    columns : sequence of bool
        For each joint: carry ``U e_z`` instead of the angular acceleration.

    Returns
    -------
    list of Scalar
        [N m, N].
    """
    turns = [turn_of(tape, joint, x) for joint, x in zip(chain.joints, q, strict=True)]
    carried = loads(chain, motions(tape, chain, turns, q, v, dv, columns))
    return project_wrenches(chain, q, turns, carried)[0]


def motions(
    tape: Tape,
    chain: Chain,
    turns: Sequence[Turn],
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    dv: Sequence[Scalar],
    columns: Sequence[bool],
) -> list[Motion]:
    """Motion of the frames of all joints at q, v, dv; ``turns``: rotations of the joints, other
    arguments as in `inverse_dynamics`. The base accelerates against gravity, which adds all
    weights.
    """
    out: list[Motion] = []
    # The base rests; its acceleration against gravity adds the weight of all bodies.
    ground = Motion([0.0] * 3, (-chain.gravity).tolist(), (0.0, 0.0, 0.0))
    for joint, turn, x, speed, acceleration, by_column in zip(
        chain.joints, turns, q, v, dv, columns, strict=True
    ):
        motion = out[joint.before] if joint.before >= 0 else ground
        out.append(
            move_to_next_frame(tape, motion, joint, turn, x, speed, acceleration, by_column)
        )
    return out


def loads(chain: Chain, moving: Sequence[Motion]) -> list[Wrench]:
    """Force and moment that each body needs, in the frame of its joint."""
    return [
        wrench(motion, joint.inertia) for motion, joint in zip(moving, chain.joints, strict=True)
    ]


def project_wrenches(
    chain: Chain, q: Sequence[Scalar], turns: Sequence[Turn], carried: Sequence[Wrench]
) -> tuple[list[Scalar], list[Wrench]]:
    """Generalized forces (n) that hold the wrenches ``carried`` on the frames of all joints, and
    the sum of wrenches beyond each joint in its frame.
    """
    tau: list[Scalar] = []
    still: Wrench = ([0.0] * 3, [0.0] * 3)
    sums = [still] * len(chain.joints)
    beyond = [still] * len(chain.joints)
    for i in reversed(range(len(chain.joints))):
        joint = chain.joints[i]
        load = carried[i]
        force = plus(load[0], beyond[i][0])
        moment = plus(load[1], beyond[i][1])
        sums[i] = force, moment
        tau.insert(0, moment[Z] if joint.revolute else force[Z])
        if joint.before >= 0:
            on, about = beyond[joint.before]
            force, moment = move_wrench_before(joint, turns[i], q[i], force, moment)
            beyond[joint.before] = plus(force, on), plus(moment, about)
    return tau, sums


def move_wrench_before(
    joint: Joint, turn: Turn, x: Scalar, force: Vector3, moment: Vector3
) -> Wrench:
    """A wrench on the frame of a joint with coordinate x, as a wrench about the origin of the
    frame before.
    """
    if not joint.revolute:
        moment = [moment[X] - x * force[Y], moment[Y] + x * force[X], moment[Z]]
    force = turn.back(force)
    moment = turn.back(moment)
    return force, plus(moment, cross(joint.place.tolist(), force))
