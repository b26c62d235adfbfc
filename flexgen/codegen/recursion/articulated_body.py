"""Forward dynamics over a `Chain`, written on a `Tape`: articulated bodies, or a mass matrix that
is factored.

Three joints on one point without bodies between them (a joint and two elastic directions of its
bearing) are treated as a group: only the articulated inertia is rotated at each of them, forces
and accelerations once after all three.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7-8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flexgen.codegen.recursion.composite_body import Matrix, add_matrices, dot, rotate_back
from flexgen.codegen.recursion.dh_chain import Chain, Inertia
from flexgen.codegen.recursion.newton_euler import Turn, Vector3, Wrench, X, Y, Z, cross, plus
from flexgen.codegen.recursion.tape import Scalar, Tape, Value


def solve_symmetric(tape: Tape, M: Matrix, right: Sequence[Scalar]) -> list[Scalar]:
    """``x`` with ``M x = right`` for a symmetric positive M (n, n): L' D L from the last row on,
    where the entries of a chain are ready first.
    """
    n = len(M)
    A = [list(row[: i + 1]) for i, row in enumerate(M)]
    L: Matrix = [[0.0] * n for _ in range(n)]
    x = list(right)
    inverses: list[Scalar] = [0.0] * n
    for k in reversed(range(n)):
        inverses[k] = tape.inverse(A[k][k])
        for i in reversed(range(k)):
            L[k][i] = A[k][i] * inverses[k]
            x[i] = x[i] - L[k][i] * x[k]
            for j in range(i + 1):
                A[i][j] = A[i][j] - L[k][i] * A[k][j]
    for k in range(n):
        x[k] = x[k] * inverses[k]
        for i in range(k):
            x[k] = x[k] - L[k][i] * x[i]
    return x


@dataclass(frozen=True)
class Articulated:
    """Articulated inertia of a frame, all later joints free: ``n = J dw + H a``,
    ``f = H' dw + M a``; (3, 3) each.
    """

    J: Matrix
    H: Matrix
    M: Matrix

    def __add__(self, body: Inertia | Articulated) -> Articulated:
        if isinstance(body, Articulated):
            return Articulated(
                *(
                    add_matrices(*pair)
                    for pair in ((self.J, body.J), (self.H, body.H), (self.M, body.M))
                )
            )
        m = body.mass
        (x, y, z) = body.first.tolist()
        S = body.second.tolist()
        tensor = [[-x for x in row] for row in S]
        for i in (X, Y, Z):
            tensor[i][i] = S[i - 1][i - 1] + S[i - 2][i - 2]
        own = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
        return Articulated(
            add_matrices(self.J, tensor),
            add_matrices(self.H, own),
            add_matrices(self.M, [[m, 0.0, 0.0], [0.0, m, 0.0], [0.0, 0.0, m]]),
        )

    def turned(self, turn: Turn) -> Articulated:
        """Articulated inertia in the angular axes of the frame before a joint; its linear axes
        stay.

        Of joints on one point the linear axes are turned once, by `linear_turned`, behind the last
        of them.
        """
        J = rotate_back(turn, self.J)
        return Articulated(
            J, _transpose([turn.back(column) for column in _transpose(self.H)]), self.M
        )

    def linear_turned(self, turn: Turn) -> Articulated:
        """Articulated inertia with the axes of accelerations and forces turned back as well."""
        return Articulated(self.J, [turn.back(row) for row in self.H], rotate_back(turn, self.M))

    def shifted(self, p: Sequence[Scalar]) -> Articulated:
        """Articulated inertia about a point relative to which its origin is at p."""
        if not any(isinstance(x, Value) or x for x in p):
            return self
        pM = _across(p, self.M)
        H = add_matrices(self.H, pM)
        # J + p^ H' + (p^ H')' + p^ M p^' , H' transposed; the middle of old and new H halves the
        # last term
        B = _across(p, _transpose(H))
        C = _across(p, _transpose(self.H))
        inertia: Matrix = [[0.0] * 3 for _ in range(3)]
        for i in (X, Y, Z):
            for j in range(i + 1):
                inertia[i][j] = inertia[j][i] = self.J[i][j] + (B[i][j] + C[j][i])
        return Articulated(inertia, H, self.M)


def _zero() -> Matrix:
    return [[0.0] * 3 for _ in range(3)]


def _transpose(A: Matrix) -> Matrix:
    return [list(column) for column in zip(*A, strict=True)]


def _across(p: Sequence[Scalar], A: Matrix) -> Matrix:
    """``p^ A``."""
    return _transpose([cross(p, column) for column in _transpose(A)])


@dataclass(frozen=True)
class _Yield:
    """A joint that is free to move: wrench per unit of its acceleration, inverse of its inertia,
    remaining torque.

    ``armature``: the part of the inertia that acts on the joint alone. ``revolute``: rotation,
    else translation.
    """

    revolute: bool
    about: Vector3
    linear: Vector3
    ease: Scalar
    rest: Scalar
    armature: float

    def pass_on(self, force: Vector3, moment: Vector3, tau: Scalar) -> Wrench:
        """The wrench on the frame when the joint is free; along the axis the driving torque less
        the rotor's.
        """
        push = self.rest * self.ease
        force = plus(force, [x * push for x in self.linear])
        moment = plus(moment, [x * push for x in self.about])
        (moment if self.revolute else force)[Z] = tau - self.armature * push
        return force, moment

    def reduce(self, body: Articulated) -> Articulated:
        """Inertia of the body as seen through the free joint; along the axis only the rotor
        inertia remains.
        """
        about = [x * self.ease for x in self.about]
        linear = [x * self.ease for x in self.linear]
        J, H, M = ([row[:] for row in A] for A in (body.J, body.H, body.M))
        for k in (X, Y, Z):
            for j in (X, Y, Z):
                H[k][j] = H[k][j] - about[k] * self.linear[j]
                if j <= k:
                    J[k][j] = J[j][k] = J[k][j] - about[k] * self.about[j]
                    M[k][j] = M[j][k] = M[k][j] - linear[k] * self.linear[j]
        for k in (X, Y, Z):
            if self.revolute:
                J[k][Z] = J[Z][k] = about[k] * self.armature
                H[Z][k] = linear[k] * self.armature
            else:
                M[k][Z] = M[Z][k] = linear[k] * self.armature
                H[k][Z] = about[k] * self.armature
        return Articulated(J, H, M)


def forward_dynamics(
    tape: Tape,
    chain: Chain,
    q: Sequence[Scalar],
    loads: Sequence[Wrench],
    turns: Sequence[Turn],
    tau: Sequence[Scalar],
    armature: Sequence[float],
) -> list[Scalar]:
    """Accelerations under generalized forces, from the wrenches that the bodies need at zero
    accelerations.

    Parameters
    ----------
    tape : Tape
        To write on.
    chain : Chain
        The robot.
    q : sequence of Scalar
        Coordinates [rad, m].
    loads : sequence of Wrench
        Wrenches that the bodies need while no joint accelerates, see
        `flexgen.codegen.recursion.newton_euler`.
    turns : sequence of Turn
        Rotations of the joints.
    tau : sequence of Scalar
        Generalized forces [N m, N].
    armature : sequence of float
        Inertia that resists the acceleration of each joint alone [kg m^2, kg].

    Returns
    -------
    list of Scalar
        [rad/s^2, m/s^2].
    """
    joined = find_joints_on_one_point(chain, armature)
    yields = _to_the_base(tape, chain, q, loads, turns, tau, armature, joined)
    return _to_the_tool(chain, q, turns, yields, joined)


def _to_the_base(
    tape: Tape,
    chain: Chain,
    q: Sequence[Scalar],
    loads: Sequence[Wrench],
    turns: Sequence[Turn],
    tau: Sequence[Scalar],
    armature: Sequence[float],
    joined: Sequence[bool],
) -> list[_Yield]:
    """Articulated inertias and forces, body by body from the tool to the base.

    ``loads``: wrenches of velocities and weight on the frames; ``turns``: rotations of the joints;
    ``tau``: their forces [N m, N]; ``armature``: rotor inertias [kg m^2, kg]; ``joined``: as
    `find_joints_on_one_point`. Returned per joint for `_to_the_tool`.
    """
    n = len(chain.joints)
    still: Vector3 = [0.0] * 3
    behind = [(Articulated(_zero(), _zero(), _zero()), still, still)] * n
    yields: list[_Yield] = []
    # joints of a run that were passed: forces are still in the axes of the last one
    run: list[Turn] = []
    for i in reversed(range(n)):
        joint = chain.joints[i]
        turn = turns[i]
        body, force, moment = behind[i]
        body = body + joint.inertia
        force = plus(loads[i][0], force)
        moment = plus(loads[i][1], moment)
        about, linear = (
            (body.J[Z], body.H[Z]) if joint.revolute else ([row[Z] for row in body.H], body.M[Z])
        )
        resists, held = (about[Z], moment[Z]) if joint.revolute else (linear[Z], force[Z])
        ease = tape.inverse(resists + armature[i])
        yields.insert(0, _Yield(joint.revolute, about, linear, ease, tau[i] - held, armature[i]))
        if joint.before < 0:
            continue
        force, moment = yields[0].pass_on(force, moment, tau[i])
        body = yields[0].reduce(body)
        if len(run) == 2:
            # three joints follow on this point
            body = Articulated(_zero(), _zero(), body.M)
        if not joint.revolute:
            body = body.shifted([0.0, 0.0, q[i]])
            moment = plus(moment, cross([0.0, 0.0, q[i]], force))
        moment = turn.back(moment)
        if joined[i]:
            body = body.turned(turn)
            run.append(turn)
        else:
            for passed in run:
                body = body.linear_turned(passed)
                force = passed.back(force)
            run = []
            body = Articulated(*(rotate_back(turn, A) for A in (body.J, body.H, body.M)))
            force = turn.back(force)
            body = body.shifted(joint.place.tolist())
            moment = plus(moment, cross(joint.place.tolist(), force))
        other, on, about = behind[joint.before]
        behind[joint.before] = body + other, plus(force, on), plus(moment, about)
    return yields


def _to_the_tool(
    chain: Chain,
    q: Sequence[Scalar],
    turns: Sequence[Turn],
    yields: Sequence[_Yield],
    joined: Sequence[bool],
) -> list[Scalar]:
    """Accelerations of the joints (n) [rad/s^2, m/s^2], body by body from the base to the tool;
    ``yields``: of `_to_the_base`, other arguments as there.
    """
    dv: list[Scalar] = []
    still: Vector3 = [0.0] * 3
    moved: list[tuple[Vector3, Vector3]] = []
    for i, (joint, turn, gives) in enumerate(zip(chain.joints, turns, yields, strict=True)):
        dw, a = moved[joint.before] if joint.before >= 0 else (still, still)
        if not joined[i]:
            a = turn.into(plus(a, cross(dw, joint.place.tolist())))
            for k in range(i + 1, len(chain.joints)):
                if not joined[k]:
                    break
                a = turns[k].into(a)
        dw = turn.into(dw)
        if not joint.revolute:
            a = plus(a, cross(dw, [0.0, 0.0, q[i]]))
        dv.append((gives.rest - (dot(gives.about, dw) + dot(gives.linear, a))) * gives.ease)
        if joint.revolute:
            dw = [dw[X], dw[Y], dw[Z] + dv[i]]
        else:
            a = [a[X], a[Y], a[Z] + dv[i]]
        moved.append((dw, a))
    return dv


def find_joints_on_one_point(chain: Chain, armature: Sequence[float]) -> list[bool]:
    """For each joint whether it belongs to the one before: three on one point, the first two
    without a body.
    """
    n = len(chain.joints)
    out = [False] * n
    carried = [sum(joint.before == i for joint in chain.joints) for i in range(n)]
    for i in reversed(range(2, n)):
        if [chain.joints[k].before for k in (i - 1, i)] != [i - 2, i - 1] or carried[
            i - 2 : i
        ] != [
            1,
            1,
        ]:
            continue
        three = chain.joints[i - 2 : i + 1]
        bodies = [joint.inertia for joint in three[:2]]
        empty = not any(own.mass or own.first.any() or own.second.any() for own in bodies)
        point = all(joint.revolute for joint in three) and not any(
            joint.place.any() for joint in three[1:]
        )
        if empty and point and not any(armature[i - 2 : i + 1]) and not (i + 1 < n and out[i + 1]):
            out[i] = out[i - 1] = True
    return out
