"""Mass matrix and potential energy over a `Chain`, written on a `Tape`: composite bodies.

Composite bodies carry moments of mass m, s, S (order zero, one, two); a rotation moves all bodies
behind it by ``f = e_z x s``, ``n = (-S_xz, -S_yz, S_xx + S_yy)`` per unit of its acceleration.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.codegen.recursion.dh_chain import Chain, Inertia, Joint
from flexgen.codegen.recursion.newton_euler import (
    Turn,
    Vector3,
    Wrench,
    X,
    Y,
    Z,
    cross,
    plus,
    tilt,
    turn_by,
    turn_of,
)
from flexgen.codegen.recursion.tape import Scalar, Tape, Value

Matrix = list[list[Scalar]]


@dataclass(frozen=True)
class Composite:
    """Moments of mass of all bodies behind a joint: order zero, one (3) and two (3, 3;
    symmetric).
    """

    mass: Scalar
    first: Vector3
    second: Matrix

    def __add__(self, other: Inertia | Composite) -> Composite:
        if isinstance(other, Inertia):
            other = Composite(other.mass, other.first.tolist(), other.second.tolist())
        return Composite(
            self.mass + other.mass,
            plus(self.first, other.first),
            add_matrices(self.second, other.second),
        )

    def shifted(self, p: Sequence[Scalar]) -> Composite:
        """Composite body about a point relative to which its origin is at p."""
        m = self.mass
        h = self.first
        S = self.second
        carried = [m * x for x in p]
        first = plus(h, carried)
        second: Matrix = [[0.0] * 3 for _ in range(3)]
        for i in (X, Y, Z):
            second[i][i] = S[i][i] + p[i] * (h[i] + first[i])
            for j in range(i):
                second[i][j] = second[j][i] = S[i][j] + p[i] * h[j] + p[j] * first[i]
        return Composite(m, first, second)


EMPTY = Composite(0.0, [0.0] * 3, [[0.0] * 3 for _ in range(3)])


def rotate_in_plane(A: Matrix, i: int, j: int, c: Scalar, s: Scalar) -> Matrix:
    """The 3 x 3 matrix A turned in the plane of axes i and j by the angle with cosine c and sine
    s: ``R A R'``; quarter turns take no operation.
    """
    k = 3 - i - j
    out = [row[:] for row in A]
    if not isinstance(c, Value) and c * s == 0.0:
        # a multiple of a quarter turn
        if c == 0.0:
            out[i][i] = A[j][j]
            out[j][j] = A[i][i]
            out[i][j] = -A[j][i]
            out[j][i] = -A[i][j]
    else:
        # the trace, and the difference of the two entries off the diagonal, are invariant
        e = s * (A[i][i] - A[j][j]) + c * (A[i][j] + A[j][i])
        out[i][i] = A[i][i] - s * e
        out[j][j] = A[j][j] + s * e
        out[i][j] = c * e - A[j][i]
        out[j][i] = c * e - A[i][j]
    out[i][k] = c * A[i][k] - s * A[j][k]
    out[j][k] = s * A[i][k] + c * A[j][k]
    out[k][i] = c * A[k][i] - s * A[k][j]
    out[k][j] = s * A[k][i] + c * A[k][j]
    return out


def add_matrices(A: Matrix, B: Matrix) -> Matrix:
    """``A + B``."""
    return [plus(a, b) for a, b in zip(A, B, strict=True)]


def dot(a: Sequence[Scalar], b: Sequence[Scalar]) -> Scalar:
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def combine_axes(axes: Matrix, v: Sequence[Scalar]) -> Vector3:
    """``sum_k v_k axes_k``."""
    return [axes[0][i] * v[0] + axes[1][i] * v[1] + axes[2][i] * v[2] for i in (X, Y, Z)]


def rotate_back(turn: Turn, A: Matrix) -> Matrix:
    """A matrix of the frame of a joint in the axes of the frame before."""
    return _tilt_matrix(turn, rotate_in_plane(A, X, Y, turn.cosine, turn.sine))


def _tilt_matrix(by: Joint | Turn, A: Matrix) -> Matrix:
    """``Rz(lead) Rx(twist) A Rx(twist)' Rz(lead)'``."""
    return rotate_in_plane(rotate_in_plane(A, Y, Z, *by.twist), X, Y, *by.lead)


def mass_matrix(tape: Tape, chain: Chain, q: Sequence[Scalar], together: bool = True) -> Matrix:
    """Mass matrix of the bodies, [kg m^2, kg m, kg]; full and symmetric.

    Joint by joint from the tool on, the bodies behind a joint are one composite body. Column j is
    the wrench that moves this body with unit acceleration of joint j, carried to the base, with
    its component along the axis of each joint i that it passes.

    Parameters
    ----------
    tape : Tape
        To write on.
    chain : Chain
        The robot.
    q : sequence of Scalar
        Coordinates [rad, m].
    together : bool
        Neighbors with parallel axes share a frame that does not rotate with them, so that forces
        pass without a rotation.

    Returns
    -------
    list of list of Scalar
        Shape (n, n).
    """
    n = len(chain.joints)
    steps = _steps(tape, chain, q, together)
    M: Matrix = [[0.0] * n for _ in range(n)]
    # bodies of children that share axes, and of others
    together_behind = [EMPTY] * n
    apart_behind = [EMPTY] * n
    for j in reversed(range(n)):
        joint = chain.joints[j]
        own = apart_behind[j] + chain.joints[j].inertia
        # the moment about the axis is invariant under the rotation
        about = (together_behind[j] + own).second
        body = together_behind[j] + steps[j].in_shared_axes(own)
        h = body.first
        S = body.second
        if chain.joints[j].revolute:
            M[j][j] = about[X][X] + about[Y][Y]
            force = [-h[Y], h[X], 0.0]
            moment = [-S[X][Z], -S[Y][Z], M[j][j]]
        else:
            M[j][j] = body.mass
            force = [0.0, 0.0, body.mass]
            moment = [h[Y], -h[X], 0.0]
        last = steps[j]
        for i in chain.ancestors(j):
            force, moment = last.transfer_back(force, moment)
            if last.tilt is not None:
                force = steps[i].turn_back(force)
                moment = steps[i].turn_back(moment)
            M[i][j] = M[j][i] = moment[Z] if chain.joints[i].revolute else force[Z]
            last = steps[i]
        if joint.before >= 0:
            behind = together_behind if steps[j].tilt is None else apart_behind
            behind[joint.before] = steps[j].body_left(body) + behind[joint.before]
    return M


@dataclass(frozen=True)
class _Step:
    """A joint in a frame that rotates neither with it nor with the neighbors before it whose axes
    are parallel.

    ``turn``: from those axes to the joint's own. ``way``: from the joint before, in the shared
    axes, or in that one's own axes where nothing is shared; there the joint's ``tilt`` follows,
    lead and twist. ``slide``: along z.
    """

    turn: tuple[Scalar, Scalar]
    way: Vector3
    slide: Scalar
    tilt: Joint | None

    def in_shared_axes(self, own: Composite) -> Composite:
        """A body in the joint's axes, in shared axes."""
        return Composite(
            own.mass, self.turn_back(own.first), rotate_in_plane(own.second, X, Y, *self.turn)
        )

    def body_left(self, body: Composite) -> Composite:
        """A body in the axes of the joint before: shared ones, or its own."""
        if self.tilt is None:
            return body.shifted(plus(self.way, [0.0, 0.0, self.slide]))
        body = body.shifted([0.0, 0.0, self.slide])
        return Composite(
            body.mass, tilt(self.tilt, body.first), _tilt_matrix(self.tilt, body.second)
        ).shifted(self.way)

    def transfer_back(self, force: Vector3, moment: Vector3) -> Wrench:
        """A wrench in the axes of the joint before, about its origin."""
        if self.tilt is None:
            return force, plus(moment, cross(plus(self.way, [0.0, 0.0, self.slide]), force))
        moment = plus(moment, cross([0.0, 0.0, self.slide], force))
        force = tilt(self.tilt, force)
        return force, plus(tilt(self.tilt, moment), cross(self.way, force))

    def turn_back(self, v: Vector3) -> Vector3:
        """A vector of the joint's axes, in shared axes."""
        c, s = self.turn
        return [c * v[X] - s * v[Y], s * v[X] + c * v[Y], v[Z]]


def _steps(tape: Tape, chain: Chain, q: Sequence[Scalar], together: bool) -> list[_Step]:
    """The joints of a chain at q: in axes that neighbors with parallel axes share (``together``),
    or each in its own axes, where `tilt` is not None.
    """
    parallel = [
        joint.twist == (1.0, 0.0) and joint.before == i - 1 for i, joint in enumerate(chain.joints)
    ]
    shared = [together and i > 0 and along for i, along in enumerate(parallel)]
    out: list[_Step] = []
    angle: Scalar = 0.0
    quarters = 0
    for i, (joint, x) in enumerate(zip(chain.joints, q, strict=True)):
        way = joint.place.tolist()
        if shared[i]:
            c, s = out[-1].turn
            way = [c * way[X] - s * way[Y], s * way[X] + c * way[Y], way[Z]]
        else:
            angle = 0.0
            quarters = 0
        angle = angle + (x + joint.turn if joint.revolute else joint.turn)
        quarters += joint.quarters
        turn = turn_by(tape, angle, quarters)
        out.append(_Step(turn, way, 0.0 if joint.revolute else x, None if shared[i] else joint))
    return out


def height(tape: Tape, chain: Chain, q: Sequence[Scalar]) -> Scalar:
    """Potential energy of the bodies up to a constant [J]; arguments as for `mass_matrix`."""
    masses: list[Scalar] = [0.0] * (len(q) + 1)  # behind each joint, and on the base
    firsts: list[Vector3] = [[0.0] * 3] * (len(q) + 1)
    for i in reversed(range(len(q))):
        joint = chain.joints[i]
        x = q[i]
        mass = masses[i] + joint.inertia.mass
        first = plus(firsts[i], joint.inertia.first.tolist())
        if not joint.revolute:
            first = [first[X], first[Y], first[Z] + mass * x]
        first = plus(turn_of(tape, joint, x).back(first), [mass * y for y in joint.place.tolist()])
        masses[joint.before] = masses[joint.before] + mass
        firsts[joint.before] = plus(firsts[joint.before], first)
    return -dot(chain.gravity.tolist(), firsts[-1])
