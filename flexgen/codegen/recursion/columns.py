"""Mass matrix and derivatives of inverse dynamics with the same few expressions for each joint,
all in the base's axes.

All positions are relative to the last joint. Let r be the position of a point and u its velocity.
The axis of joint j is the spatial vector ``(z, b)``: ``(e, p x e)`` for a rotation about the unit
vector e through p, ``(0, e)`` for a translation. ``(w, v)`` and ``(c, a)`` are the spatial
velocity and acceleration of its body; a includes gravity. A change of the coordinate or of the
speed of a joint changes the acceleration of each point behind it, relative to the moved bodies, by
``2 s x u + m x r + d`` with

    change of q:   (s, y) = (w, v) x (z, b),        (m, d) = (c, a) x (z, b) + (w, v) x (s, y)
    change of v:   s = z,                           (m, d) = 2 (w, v) x (z, b)

where ``(w, v) x (z, b) = (w x z, w x b + v x z)``. The wrenches (n, f) for this follow from the
moments of the bodies behind the joint,
``h = int r dm, H = int r r' dm, k = int u dm, K = int u r' dm``:

    f = 2 s x k + m x h + mass d,                   n = 2 (tr K 1 - K) s + (tr H 1 - H) m + h x d

A change of q turns the forces as well. The generalized force of a joint i before is
``(z, b)_i . (n, f)_j`` (above the diagonal); that of joint j for a change at i, before it or the
same, is linear in (s, m, d) of i (on it and below).

Source: own derivation of the relations of S. Singh, R. Russell, P. Wensing, IEEE RA-L 7(2), 2022,
in moments of mass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from flexgen.codegen.recursion.composite_body import combine_axes
from flexgen.codegen.recursion.dh_chain import ROUNDING, Chain
from flexgen.codegen.recursion.newton_euler import turn_of
from flexgen.codegen.recursion.tape import Scalar, Tape
from flexgen.codegen.statements.routine import (
    Columns,
    Expressions,
    Products,
    Rows,
    Selected,
    Step,
    Sums,
)

# a port or an intermediate array, and the column at which a matrix begins
Target = tuple[str, int]
AXIS = Rows("axis", 0, 6)
MOMENTUM = Rows("momentum", 0, 6)
FELT = Rows("felt", 0, 9)  # effect of (s, m, d) of a change before a joint on its force


def mass_matrix(chain: Chain, target: str) -> list[Step]:
    """Steps from the input ``q_a`` to the mass matrix of the bodies in a port or an intermediate
    array.
    """
    return [*_kinematics(chain, ["q_a"]), *_masses(chain, target)]


def derivatives(chain: Chain, by_q: Target, by_v: Target, by_a: str) -> list[Step]:
    """Steps from ``q_a, v_a, a_a`` to the derivatives of inverse dynamics; ``by_a``: where the
    mass matrix goes.
    """
    known = [*_kinematics(chain, ["q_a", "v_a", "a_a"]), *_masses(chain, by_a), *_motion(chain)]
    return [*known, *_forces(chain, at_rest=False), *_changes(chain, by_q, by_v)]


def bias(chain: Chain, M: str) -> list[Step]:
    """Steps from ``q_a, v_a`` to the mass matrix of the bodies, in an array named ``M``, and to
    the ``bias`` (1, n), forces without acceleration.

    `derivatives_after` continues with their arrays.
    """
    known = [
        *_kinematics(chain, ["q_a", "v_a"]),
        *_masses(chain, M),
        *_motion(chain),
        *_forces(chain, at_rest=True),
    ]
    axis = ca.SX.sym("axis", 6)
    force = ca.SX.sym("force", 6)
    felt = _function("bias", {"axis": axis, "force": force}, {"bias": ca.dot(axis, force)})
    return [*known, Columns(felt, len(chain.joints))]


def derivatives_after(chain: Chain, by_q: Target, by_v: Target) -> list[Step]:
    """Steps from those of `bias` and accelerations ``row_a_a`` (1, n) to the derivatives of
    inverse dynamics.
    """
    return [*_forces(chain, at_rest=False), *_changes(chain, by_q, by_v)]


def bodies_of(chain: Chain) -> tuple[int, ...]:
    """Joints whose body has mass."""
    inertias = [joint.inertia for joint in chain.joints]
    return tuple(
        k for k, own in enumerate(inertias) if own.mass or own.first.any() or own.second.any()
    )


def _kinematics(chain: Chain, names: Sequence[str]) -> list[Step]:
    """Frames of bodies, and of all joints the spatial axes; with ``v_a`` velocities as well, other
    inputs as rows.
    """
    tape = Tape()
    n = len(chain.joints)
    inputs = {name: ca.SX.sym(name, n) for name in names}
    axes: list[list[Scalar]] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]  # columns
    turned: list[list[list[Scalar]]] = []
    ways: list[list[Scalar]] = []
    for joint, q in zip(chain.joints, tape.vector(inputs["q_a"]), strict=True):
        cosine, sine = joint.twist
        axes = [
            axes[0],
            combine_axes(axes, [0.0, cosine, sine]),
            combine_axes(axes, [0.0, -sine, cosine]),
        ]
        place = _about_x(joint.twist).T @ joint.place
        way: list[Scalar] = [
            x if abs(x) > ROUNDING * np.abs(place).max() else 0.0 for x in place.tolist()
        ]
        ways.append(combine_axes(axes, way if joint.revolute else [way[0], way[1], way[2] + q]))
        turn = turn_of(tape, joint, q)
        c = turn.cosine
        s = turn.sine
        axes = [combine_axes(axes, [c, s, 0.0]), combine_axes(axes, [-s, c, 0.0]), axes[2]]
        turned.append(axes)
    # positions relative to the last joint: small inertias are near the end of an arm, and would
    # lose digits elsewhere
    places: list[list[Scalar]] = [[0.0] * 3]
    for way in reversed(ways[1:]):
        places.insert(0, [x - y for x, y in zip(places[0], way, strict=True)])
    frames = [[*axes[0], *axes[1], *axes[2], *at] for axes, at in zip(turned, places, strict=True)]
    bodies = bodies_of(chain)
    flat = tape.build(
        [x for k in bodies for x in frames[k]] + [x for frame in frames for x in frame[6:]]
    )
    results = {"frame": ca.reshape(ca.vertcat(*flat[: 12 * len(bodies)]), 12, len(bodies))}
    if len(bodies) < n:
        results["joint"] = ca.reshape(ca.vertcat(*flat[12 * len(bodies) :]), 6, n)
    results |= {f"row_{name}": x.T for name, x in inputs.items() if name != "q_a"}
    return [Expressions(_function("placed", inputs, results)), *_axes(chain, "v_a" in names)]


def _about_x(twist: tuple[float, float]) -> np.ndarray:
    """The rotation about x by an angle of this cosine and sine."""
    c, s = twist
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _axes(chain: Chain, moving: bool) -> list[Step]:
    """Steps to the spatial axes ``(z, p x z)`` of the joints (a slide: ``(0, z)``), and where the
    arm is ``moving``, to the spatial velocity of each body.
    """
    n = len(chain.joints)
    frame = ca.SX.sym("frame", 12) if len(bodies_of(chain)) == n else ca.SX.sym("joint", 6)
    direction = frame[-6:-3]
    place = frame[-3:]
    turning, symbols, tables = _number_rows(
        "turning", np.array([[float(joint.revolute) for joint in chain.joints]])
    )
    axis = ca.vertcat(
        turning * direction, turning * ca.cross(place, direction) + (1 - turning) * direction
    )
    inputs = {"frame" if frame.numel() == 12 else "joint": frame} | symbols
    results = {"axis": axis}
    if not moving:
        return [Columns(_function("axes", inputs, results), n, tables)]
    v = ca.SX.sym("v")
    axes = _function("axes", inputs | {"row_v_a": v}, results | {"speed_gained": axis * v})
    return [Columns(axes, n, tables), Sums("speed_gained", "speed", 6, n, tuple(range(n)))]


def _masses(chain: Chain, target: str) -> list[Step]:
    """Steps to mass, first and second moments of all bodies behind each joint, and to the mass
    matrix in the array ``target``.
    """
    n = len(chain.joints)
    at = bodies_of(chain)
    own = [chain.joints[k].inertia for k in at]
    numbers = np.array(
        [[x.mass, *x.first, *(x.second[i, j] for i, j in _HALF)] for x in own], dtype=float
    ).T
    inertia, symbols, tables = _number_rows("inertia", numbers)
    frame = ca.SX.sym("frame", 12)
    R = ca.reshape(frame[:9], 3, 3)
    p = frame[9:]
    first = ca.mtimes(R, inertia[1:4])
    turned = ca.mtimes(R, _symmetric(inertia[4:]))
    h = first + inertia[0] * p
    H = [ca.dot(turned[i, :].T, R[j, :].T) + p[i] * h[j] + first[i] * p[j] for i, j in _HALF]
    moments = _function("moments", {"frame": frame} | symbols, {"own_mass": ca.vertcat(h, *H)})

    mass, symbols, masses = _mass(chain, beyond=True)
    axis = ca.SX.sym("axis", 6)
    beyond = ca.SX.sym("mass", 9)
    (z, b) = _halves(axis)
    (h, H) = _halves(beyond)
    momentum = ca.vertcat(_less(_symmetric(H), z) + ca.cross(h, b), ca.cross(z, h) + mass * b)
    momenta = _function(
        "momenta", {"axis": axis, "mass": beyond} | symbols, {"momentum": momentum}
    )
    return [
        Columns(moments, len(at), tables),
        Sums("own_mass", "mass", 9, n, at, backward=True),
        Columns(momenta, n, masses),
        Products((AXIS, MOMENTUM), (MOMENTUM, AXIS), n, target),
    ]


def _motion(chain: Chain) -> list[Step]:
    """Steps to the moments of momentum (k, K) of all bodies behind each joint, and to the rates of
    the axes; the velocities are known.
    """
    n = len(chain.joints)
    at = bodies_of(chain)
    mass, symbols, masses = _mass(chain, beyond=False)
    name = _of_bodies(chain, "speed")
    own = ca.SX.sym("own", 9)
    speed = ca.SX.sym("speed", 6)
    axis = ca.SX.sym("axis", 6)
    (w, v) = _halves(speed)
    h = own[:3]
    H = _symmetric(own[3:])
    K = ca.mtimes(v, h.T) + ca.horzcat(*(ca.cross(w, H[:, j]) for j in range(3)))
    moments = {"own_motion": ca.vertcat(mass * v + ca.cross(w, h), ca.reshape(K, 9, 1))}
    rates = _function(
        "rates", {"axis": axis, "speed": speed}, {"rate": _rate_of_axis(speed, axis)}
    )
    return [
        Columns(rates, n),
        *_array_step(chain, "speed"),
        Columns(
            _function("motion", {"own_mass": own, name: speed} | symbols, moments), len(at), masses
        ),
        Sums("own_motion", "motion", 12, n, at, backward=True),
    ]


def _forces(chain: Chain, at_rest: bool) -> list[Step]:
    """Steps to accelerations, gravity in them, and to the wrenches of all bodies behind each
    joint; ``at_rest``: all joint accelerations are zero.
    """
    n = len(chain.joints)
    at = bodies_of(chain)
    axis, rate, v, a = (
        ca.SX.sym(name, rows) for name, rows in (("axis", 6), ("rate", 6), ("v", 1), ("a", 1))
    )
    inputs = {"rate": rate, "row_v_a": v} | ({} if at_rest else {"axis": axis, "row_a_a": a})
    gained = {"gained": rate * v + (0 if at_rest else axis * a)}
    start = (0.0, 0.0, 0.0, *(-chain.gravity).tolist())

    mass, symbols, masses = _mass(chain, beyond=False)
    names = "own_mass", "own_motion", _of_bodies(chain, "speed"), _of_bodies(chain, "acceleration")
    own, motion, speed, acceleration = (
        ca.SX.sym(x, k) for x, k in zip(names, (9, 12, 6, 6), strict=True)
    )
    (h, H) = _halves(own)
    (k, K) = _halves(motion)
    (w, _) = _halves(speed)
    (dw, da) = _halves(acceleration)
    f = mass * da + ca.cross(dw, h) + ca.cross(w, k)
    n_own = ca.cross(h, da) + _less(_symmetric(H), dw) + _less(ca.reshape(K, 3, 3), w)
    forces = dict(zip(names, (own, motion, speed, acceleration), strict=True)) | symbols
    return [
        Columns(_function("gains", inputs, gained), n),
        Sums("gained", "acceleration", 6, n, tuple(range(n)), start=start),
        *_array_step(chain, "acceleration"),
        Columns(_function("forces", forces, {"own_force": ca.vertcat(n_own, f)}), len(at), masses),
        Sums("own_force", "force", 6, n, at, backward=True),
    ]


def _changes(chain: Chain, by_q: Target, by_v: Target) -> list[Step]:
    """Steps to the derivatives in coordinates and in speeds; each target is an array and the
    column at which its n columns begin.
    """
    n = len(chain.joints)
    mass, symbols, masses = _mass(chain, beyond=True)
    sizes = {
        "axis": 6,
        "rate": 6,
        "speed": 6,
        "acceleration": 6,
        "mass": 9,
        "motion": 12,
        "force": 6,
        "momentum": 6,
    }
    inputs = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    axis, rate, speed, acceleration, moments, motion, force, momentum = inputs.values()
    z, b = _halves(axis)
    k, K = _halves(motion)
    n_all, f = _halves(force)
    h = moments[:3]
    H = _symmetric(moments[3:])
    K = ca.reshape(K, 3, 3)

    def wrench(s: ca.SX, m: ca.SX, d: ca.SX) -> ca.SX:
        moment = _less(K, 2 * s) + _less(H, m) + ca.cross(h, d)
        return ca.vertcat(moment, ca.cross(2 * s, k) + ca.cross(m, h) + mass * d)

    twice = _rate_of_axis(acceleration, axis) + _rate_of_axis(speed, rate)
    change_q = (rate[:3], *_halves(twice))
    change_v = (z, *_halves(2 * rate))
    turned = ca.vertcat(ca.cross(z, n_all) + ca.cross(b, f), ca.cross(z, f))
    results = {
        "felt": ca.vertcat(2 * (_less(K.T, z) + ca.cross(k, b)), momentum),
        "change_q": ca.vertcat(*change_q),
        "wrench_q": wrench(*change_q) + turned,
        "change_v": ca.vertcat(*change_v),
        "wrench_v": wrench(*change_v),
    }
    return [
        Columns(_function("changes", inputs | symbols, results), n, masses),
        *(
            Products(
                (AXIS, Rows(f"wrench_{x}", 0, 6)),
                (FELT, Rows(f"change_{x}", 0, 9)),
                n,
                target,
                first,
            )
            for x, (target, first) in (("q", by_q), ("v", by_v))
        ),
    ]


# --- parts ---------------------------------------------------------------------------------------

_HALF = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # entries of a symmetric matrix


def _of_bodies(chain: Chain, name: str) -> str:
    """The array with the columns of the bodies."""
    return name if len(bodies_of(chain)) == len(chain.joints) else f"{name}_of_bodies"


def _array_step(chain: Chain, name: str) -> list[Step]:
    """The step that fills this array."""
    target = _of_bodies(chain, name)
    return [] if target == name else [Selected(name, target, 6, bodies_of(chain))]


def _mass(chain: Chain, beyond: bool) -> tuple[ca.SX, dict[str, ca.SX], dict[str, np.ndarray]]:
    """Masses of bodies, or of all bodies behind each joint, see `_number_rows`."""
    own = [joint.inertia.mass for joint in chain.joints]
    masses = (
        [sum(own[k:]) for k in range(len(own))] if beyond else [own[k] for k in bodies_of(chain)]
    )
    return _number_rows("masses", np.array([masses], dtype=float))


def _halves(x: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The first three entries, and the others."""
    return x[:3], x[3:]


def _rate_of_axis(speed: ca.SX, axis: ca.SX) -> ca.SX:
    """Rate of a spatial axis that moves with a spatial velocity: ``(w x z, w x b + v x z)``."""
    return ca.vertcat(
        ca.cross(speed[:3], axis[:3]),
        ca.cross(speed[:3], axis[3:]) + ca.cross(speed[3:], axis[:3]),
    )


def _less(A: ca.SX, x: ca.SX) -> ca.SX:
    """``(tr A 1 - A) x``."""
    rows = []
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        rows.append((A[j, j] + A[k, k]) * x[i] - A[i, j] * x[j] - A[i, k] * x[k])
    return ca.vertcat(*rows)


def _symmetric(entries: ca.SX | Sequence[ca.SX]) -> ca.SX:
    """A symmetric matrix from the entries of `_HALF`."""
    A = ca.SX.zeros(3, 3)
    for k, (i, j) in enumerate(_HALF):
        A[i, j] = A[j, i] = entries[k]
    return A


def _number_rows(
    name: str, numbers: np.ndarray
) -> tuple[ca.SX, dict[str, ca.SX], dict[str, np.ndarray]]:
    """Rows of numbers for all columns: entries for one, the symbols of those that differ, and
    their table.
    """
    differ = [i for i, row in enumerate(numbers) if row.min() != row.max()]
    symbol = ca.SX.sym(name, len(differ))
    entries = [
        symbol[differ.index(i)] if i in differ else ca.SX(row[0]) for i, row in enumerate(numbers)
    ]
    return (
        ca.vertcat(*entries),
        {name: symbol} if differ else {},
        {name: numbers[differ]} if differ else {},
    )


def _function(name: str, inputs: Mapping[str, ca.SX], results: Mapping[str, ca.SX]) -> ca.Function:
    dense = [ca.densify(x) for x in results.values()]
    return ca.Function(name, [*inputs.values()], dense, [*inputs], [*results])
