"""Derivatives of inverse dynamics by a recursion over a `Chain`, written on a `Tape`.

A change of one coordinate changes the acceleration of each point behind its joint by
``da + 2 l x u + m x r``: r is the position of the point relative to the joint, u its velocity
relative to the joint's origin. For a rotation, in its frame,

    change of q:  l = w x e_z,  m = U e_z,        da = a x e_z,  and all forces turn with the joint
    change of v:  l = e_z,      m = 2 w x e_z,    da = 0

and for a translation ``l = m = 0`` with ``da = U e_z`` and ``da = 2 w x e_z``. Forces then follow
from moments of mass and of momentum of all bodies behind the joint, ``S = int r r' dm`` and
``P = int u r' dm``:

    df = 2 l x int u dm + m x int r dm + mass da,
    dn = 2 (tr P 1 - P) l + (tr S 1 - S) m + int r dm x da

They are passed to the base as wrenches (columns of the derivatives above the diagonal); the effect
on a joint of any change before it is passed as covectors of l, m and da (rows below the diagonal).

Source: own derivation; the same count of operations as S. Singh, R. Russell, P. Wensing, IEEE RA-L
7(2), 2022.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.codegen.recursion.composite_body import (
    EMPTY,
    Composite,
    Matrix,
    add_matrices,
    dot,
    rotate_back,
)
from flexgen.codegen.recursion.dh_chain import Chain
from flexgen.codegen.recursion.newton_euler import (
    Motion,
    Turn,
    Vector3,
    X,
    Y,
    Z,
    cross,
    loads,
    motions,
    move_wrench_before,
    plus,
    project_wrenches,
    turn_of,
)
from flexgen.codegen.recursion.tape import Scalar, Tape

AXIS: Vector3 = [0.0, 0.0, 1.0]


@dataclass(frozen=True)
class _Change:
    """Change of acceleration ``2 l x u + m x r + da`` of the points behind a joint.

    It follows from a unit change of one coordinate or velocity; the module derives it. The
    components are expressions of the tape, in the frame of a joint:

    - ``sweep``: l (3,), multiplies the velocity u of a point relative to the joint's origin,
    - ``turn``: m (3,), multiplies the position r of a point relative to it,
    - ``shift``: da (3,), acceleration that all points share.

    The class also holds the dual quantities, the covectors of l, m and da: derivatives of the
    generalized force of one joint in the components of the three vectors. See `_feeling`.
    """

    sweep: Vector3
    turn: Vector3
    shift: Vector3

    def pair_with(self, change: _Change) -> Scalar:
        """Change of a joint's generalized force by a ``change`` of acceleration.

        ``self`` holds the covectors of this force, so the result is the sum of the three dot
        products: one entry of the derivatives of inverse dynamics.
        """
        return (
            dot(self.sweep, change.sweep)
            + dot(self.turn, change.turn)
            + dot(self.shift, change.shift)
        )


@dataclass(frozen=True)
class _Beyond:
    """Moments of mass and of momentum of the bodies behind a joint: ``int u dm`` (3),
    ``int u r' dm`` (3, 3).
    """

    body: Composite
    momentum: Vector3
    moment: Matrix

    def __add__(self, other: _Beyond) -> _Beyond:
        return _Beyond(
            self.body + other.body,
            plus(self.momentum, other.momentum),
            add_matrices(self.moment, other.moment),
        )

    def wrench(self, change: _Change) -> tuple[Vector3, Vector3]:
        """Force (3,) and moment (3,) about the joint's origin that a change of acceleration needs.

        The module has the equations, with the integrals over the bodies behind the joint.
        """
        twice = [2.0 * x for x in change.sweep]
        s = self.body.first
        S = self.body.second
        P = self.moment
        force = plus(cross(twice, self.momentum), cross(change.turn, s))
        force = plus(force, [self.body.mass * x for x in change.shift])
        moment = plus(plus(_less(P, twice), _less(S, change.turn)), cross(s, change.shift))
        return force, moment


def _less(A: Matrix, x: Vector3) -> Vector3:
    """``(tr A 1 - A) x``."""
    out: Vector3 = []
    for i in (X, Y, Z):
        j = (i + 1) % 3
        k = (i + 2) % 3
        out.append((A[j][j] + A[k][k]) * x[i] - A[i][j] * x[j] - A[i][k] * x[k])
    return out


def derivatives(
    tape: Tape,
    chain: Chain,
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    dv: Sequence[Scalar],
    columns: Sequence[bool],
) -> tuple[Matrix, Matrix, Matrix]:
    """Derivatives of inverse dynamics in coordinates, velocities and accelerations (the mass
    matrix).

    Parameters
    ----------
    tape, chain, q, v, dv, columns
        As for `recursion.inverse_dynamics`.

    Returns
    -------
    tuple of list of list of Scalar
        Three matrices of shape (n, n): row i belongs to the generalized force i.
    """
    n = len(chain.joints)
    turns = [turn_of(tape, joint, x) for joint, x in zip(chain.joints, q, strict=True)]
    moving = motions(tape, chain, turns, q, v, dv, columns)
    sums = project_wrenches(chain, q, turns, loads(chain, moving))[1]
    changes = [
        _changes(motion, joint.revolute)
        for motion, joint in zip(moving, chain.joints, strict=True)
    ]
    by_q, by_v, by_dv = (_zeros(n) for _ in range(3))
    behind = [_Beyond(EMPTY, [0.0] * 3, [[0.0] * 3 for _ in range(3)])] * n
    for j in reversed(range(n)):
        joint = chain.joints[j]
        w = moving[j].w
        (force, moment) = sums[j]
        beyond = _add_momentum(
            behind[j], w, joint.inertia.first.tolist(), joint.inertia.second.tolist()
        )
        beyond = _Beyond(beyond.body + joint.inertia, beyond.momentum, beyond.moment)
        feels = _feeling(beyond, joint.revolute)
        of_q, of_v = (beyond.wrench(change) for change in changes[j])
        felt = 1 if joint.revolute else 0  # the moment, or the force
        by_q[j][j] = of_q[felt][Z]
        by_v[j][j] = of_v[felt][Z]
        by_dv[j][j] = feels.turn[Z] if joint.revolute else feels.shift[Z]
        if joint.revolute:
            of_q = plus(of_q[0], cross(AXIS, force)), plus(of_q[1], cross(AXIS, moment))
        else:
            of_q = of_q[0], plus(of_q[1], cross(AXIS, force))
        k = j
        for i in chain.ancestors(j):
            here = chain.joints[k]
            turn = turns[k]
            x = q[k]
            speed = v[k]
            of_q = move_wrench_before(here, turn, x, *of_q)
            of_v = move_wrench_before(here, turn, x, *of_v)
            sweep = feels.sweep
            if not here.revolute:
                sweep = plus(sweep, cross(_slide(moving[k], x, speed), feels.shift))
            shift, turn_felt = move_wrench_before(here, turn, x, feels.shift, feels.turn)
            sweep = plus(
                turn.back(sweep),
                cross([2.0 * y for y in cross(moving[i].w, here.place.tolist())], shift),
            )
            feels = _Change(sweep, turn_felt, shift)
            felt = 1 if chain.joints[i].revolute else 0
            by_q[i][j] = of_q[felt][Z]
            by_v[i][j] = of_v[felt][Z]
            by_dv[i][j] = by_dv[j][i] = turn_felt[Z] if felt else shift[Z]
            by_q[j][i], by_v[j][i] = (feels.pair_with(change) for change in changes[i])
            k = i
        if joint.before >= 0:
            behind[joint.before] = (
                _transfer_back(beyond, chain, turns[j], moving, q, v, j) + behind[joint.before]
            )
    return by_q, by_v, by_dv


def _changes(motion: Motion, revolute: bool) -> tuple[_Change, _Change]:
    """Changes of acceleration by the joint's coordinate q and by its velocity v, in its frame.

    ``motion``: of the joint's frame; the module lists l, m and da for both kinds of joints.
    """
    still: Vector3 = [0.0] * 3
    sweep = cross(motion.w, AXIS)
    column = motion.along(AXIS)
    twice = [2.0 * x for x in sweep]
    if revolute:
        return _Change(sweep, column, cross(motion.a, AXIS)), _Change(AXIS, twice, still)
    return _Change(still, still, column), _Change(still, still, twice)


def _feeling(beyond: _Beyond, revolute: bool) -> _Change:
    """Covectors of l, m and da: their effect on the joint's own generalized force.

    The force is the z component of the moment (``revolute``) or of the force that the bodies
    ``beyond`` the joint need for the change of acceleration; all vectors are in its frame.
    """
    body = beyond.body
    P = beyond.moment
    s = body.first
    S = body.second
    if not revolute:
        return _Change(
            [2.0 * x for x in cross(beyond.momentum, AXIS)], cross(s, AXIS), [0.0, 0.0, body.mass]
        )
    sweep = [-2.0 * P[Z][X], -2.0 * P[Z][Y], 2.0 * (P[X][X] + P[Y][Y])]
    return _Change(sweep, [-S[Z][X], -S[Z][Y], S[X][X] + S[Y][Y]], [-s[Y], s[X], 0.0])


def _add_momentum(beyond: _Beyond, w: Vector3, s: list[float], S: list[list[float]]) -> _Beyond:
    """The moments with the momentum of the joint's body: velocities are ``w x r``."""
    momentum = plus(beyond.momentum, cross(w, s))
    own = [cross(w, [S[0][k], S[1][k], S[2][k]]) for k in (X, Y, Z)]
    moment = [[beyond.moment[i][k] + own[k][i] for k in (X, Y, Z)] for i in (X, Y, Z)]
    return _Beyond(beyond.body, momentum, moment)


def _slide(motion: Motion, x: Scalar, speed: Scalar) -> Vector3:
    """Twice the velocity of the origin of a frame that is translated by its joint."""
    return [2.0 * y for y in plus(cross(motion.w, [0.0, 0.0, x]), [0.0, 0.0, speed])]


def _transfer_back(
    beyond: _Beyond,
    chain: Chain,
    turn: Turn,
    moving: Sequence[Motion],
    q: Sequence[Scalar],
    v: Sequence[Scalar],
    j: int,
) -> _Beyond:
    """Body, momentum and moment of the later bodies (``beyond``, in the frame of joint j), in the
    frame before joint j; ``turn``: its rotation, ``moving``: motions of the frames.
    """
    joint = chain.joints[j]
    body = beyond.body
    momentum = beyond.momentum
    moment = beyond.moment
    if not joint.revolute:
        out: Vector3 = [0.0, 0.0, q[j]]
        velocity = plus(cross(moving[j].w, out), [0.0, 0.0, v[j]])
        body, momentum, moment = _move_moments(body, momentum, moment, out, velocity)
    body = Composite(body.mass, turn.back(body.first), rotate_back(turn, body.second))
    place = joint.place.tolist()
    moved = _move_moments(
        body,
        turn.back(momentum),
        rotate_back(turn, moment),
        place,
        cross(moving[joint.before].w, place),
    )
    return _Beyond(*moved)


def _move_moments(
    body: Composite, momentum: Vector3, moment: Matrix, p: Vector3, u: Vector3
) -> tuple[Composite, Vector3, Matrix]:
    """Body, momentum and moment matrix about another point, relative to which the former origin is
    at p [m] and moves with the velocity u [m/s].
    """
    after = body.shifted(p)
    out = [
        [moment[i][k] + u[i] * after.first[k] + momentum[i] * p[k] for k in (X, Y, Z)]
        for i in (X, Y, Z)
    ]
    return after, plus(momentum, [body.mass * x for x in u]), out


def _zeros(n: int) -> Matrix:
    return [[0.0] * n for _ in range(n)]
