"""A chain or a tree reduced to numbers: joints with one coordinate each, about or along the z axes
of their frames.

Frames are placed so that few operations remain (modified Denavit-Hartenberg): from the frame of a
joint to that of a next one goes a translation ``place``, a rotation about z by the lead, a
rotation about x by the twist, a rotation about z by the joint's angle (or by a constant), and a
translation along z by the joint's length.

    R = Rz(lead) Rx(twist) Rz(q + turn),   p = place              (rotation)
    R = Rz(lead) Rx(twist) Rz(turn),       p = place + R e_z q    (translation)

The frame of a joint is placed for its first child, so that only the other children of a tree have
a lead.

Inertia that a joint does not move relative to the body before it is regrouped to that body:
torques and mass matrix are those of the robot, forces inside the joints are not.

Source: W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, 2002, ch. 3 and 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flexgen.model.elements import Body, Dof, Placement, RobotModel

# Rounding of the changes of frame leaves entries of about 1e-16 that should be zero; what is below
# this fraction of its neighbors is set to zero. A chain of tens of joints stays within 1e-12 of
# the torques of the model.
ROUNDING = 1e-14
# sine of the angle between axes below which frames are not moved to where the axes are closest
NEARLY_PARALLEL = 0.1

# rotation, position: p_parent = position + rotation @ p_child
Pose = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Inertia:
    """Moments of mass in a frame: of order zero [kg], one ``int r dm`` (3) and two ``int r r' dm``
    (3, 3).

    Numbers, or values on a tape where a number of the payload may change at run time.
    """

    mass: Any
    first: np.ndarray
    second: np.ndarray

    def __add__(self, other: Inertia) -> Inertia:
        return Inertia(
            self.mass + other.mass, self.first + other.first, self.second + other.second
        )

    def moved(self, pose: Pose) -> Inertia:
        """Inertia expressed in the frame in which this frame has the given pose."""
        rotation, position = pose
        first = rotation @ self.first
        cross = np.outer(position, rotation @ self.first)
        second = (
            rotation @ self.second @ rotation.T
            + cross
            + cross.T
            + self.mass * np.outer(position, position)
        )
        return Inertia(self.mass, first + self.mass * position, second)

    def scaled(self, factor: float) -> Inertia:
        """Inertia multiplied by a factor."""
        return Inertia(factor * self.mass, factor * self.first, factor * self.second)


NOTHING = Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
AT_REST: Pose = (np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class Joint:
    """A joint and what it carries; see the module for its frame.

    Parameters
    ----------
    revolute : bool
        Turns about z; otherwise slides along z.
    place : numpy.ndarray
        Origin in the frame before [m], shape (3,).
    twist : tuple of float
        Cosine and sine of the rotation about x.
    turn : float
        Constant part of the angle about z [rad], less quarter turns.
    quarters : int
        Quarter turns about z, 0 to 3.
    inertia : Inertia
        Of the body that moves with the joint, in the joint's frame.
    before : int
        Number of the joint that carries it; -1 for the base.
    lead : tuple of float
        Cosine and sine of the rotation about z before the twist.
    """

    revolute: bool
    place: np.ndarray
    twist: tuple[float, float]
    turn: float
    quarters: int
    inertia: Inertia
    before: int
    lead: tuple[float, float] = (1.0, 0.0)


@dataclass(frozen=True)
class Chain:
    """Joints, those that carry others before these, gravity [m/s^2] in the frame under the first,
    the constant ends.

    ``base``: pose of that frame in the world. ``tool``: pose of the tool in the frame of the joint
    ``carrier``.
    """

    joints: tuple[Joint, ...]
    gravity: np.ndarray
    base: Pose
    tool: Pose
    carrier: int

    def ancestors(self, i: int) -> list[int]:
        """Joints before joint i, the nearest first."""
        out: list[int] = []
        while (i := self.joints[i].before) >= 0:
            out.append(i)
        return out

    @property
    def to_tool(self) -> list[int]:
        """Joints from the base to the tool."""
        return [*self.ancestors(self.carrier)[::-1], self.carrier]


# --- from the model ------------------------------------------------------------------------------


def compose(a: Pose, b: Pose) -> Pose:
    """The pose reached by ``a`` and then ``b``."""
    return a[0] @ b[0], a[1] + a[0] @ b[1]


def inverse(a: Pose) -> Pose:
    """Inverse of a pose."""
    return a[0].T, -a[0].T @ a[1]


def pose_of(placement: Placement) -> Pose:
    """A placement as arrays."""
    return np.array(placement.rotation, dtype=float), np.array(placement.position, dtype=float)


def inertia_of(body: Body) -> Inertia:
    """Moments of a body about the origin of its frame."""
    tensor = np.array(body.inertia, dtype=float)
    com = np.array(body.com, dtype=float)
    second = np.trace(tensor) / 2 * np.eye(3) - tensor + body.mass * np.outer(com, com)
    return Inertia(body.mass, body.mass * com, second)


def _axis_frame(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to an axis."""
    largest = int(np.argmax(np.abs(axis)))
    if abs(axis[largest]) == 1.0:
        # (except for rounding: other entries below 1e-8 are a tilt nevertheless)
        across = np.eye(3)[(largest + 1) % 3] - axis[(largest + 1) % 3] * axis
    else:
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        across = across / np.linalg.norm(across)
    return np.column_stack([across, np.cross(axis, across), axis])


@dataclass
class _Raw:
    """A joint before its frame is placed: pose of its frame in the one before, the body in its
    own.
    """

    revolute: bool
    pose: Pose
    inertia: Inertia
    before: int


def _flatten(model: RobotModel) -> tuple[list[_Raw], Pose, int]:
    """Joints with everything rigid between them merged, the pose of the tool in the last frame,
    and its joint.
    """
    raws: list[_Raw] = []
    last = -1
    pose = pose_of(model.base)

    def carry(body: Body, carrier: str = "") -> None:
        """Add a body to the last joint, and the rotors at rest on its ``carrier``; what the base
        carries has no effect.
        """
        if last < 0:
            return
        raws[last].inertia = raws[last].inertia + inertia_of(body).moved(pose)
        for motor in model.motors if model.motor_coupling == "complete" else ():
            if motor.carrier == carrier:
                # a rotor at rest against its carrier turns with it about its axis
                axis = np.array(motor.axis)
                rotor = Body(
                    inertia=tuple(map(tuple, (motor.inertia * np.outer(axis, axis)).tolist()))
                )
                raws[last].inertia = raws[last].inertia + inertia_of(rotor).moved(pose)

    def step(dof: Dof) -> None:
        """Append a joint after the last one, whose z axis is the axis of ``dof``; what follows is
        relative to its frame.
        """
        nonlocal last, pose
        axis = np.array(dof.axis, dtype=float)
        turn = (_axis_frame(axis / np.linalg.norm(axis)), np.zeros(3))
        raws.append(_Raw(dof.type == "rotation", compose(pose, turn), NOTHING, last))
        last = len(raws) - 1
        pose = inverse(turn)

    tips = {"base": (last, pose)}
    for element in model.elements:
        last, pose = tips[model.parents[element.name]]
        pose = compose(pose, pose_of(element.origin))
        for dof in element.dofs:
            step(dof)
        pose = compose(pose, pose_of(element.link))
        carry(element.body, element.name)
        tips[element.name] = last, pose
    last, pose = tips[model.tip]
    carry(model.payload)
    return raws, compose(pose, pose_of(model.tool)), last


# --- frames --------------------------------------------------------------------------------------


def _about_z(angle: float) -> np.ndarray:
    c = np.cos(angle)
    s = np.sin(angle)
    return snap(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


def _about_x(cosine: float, sine: float) -> np.ndarray:
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])


def rotation_before(joint: Joint) -> np.ndarray:
    """The constant rotation in front of a joint's own, ``Rz(lead) Rx(twist)``."""
    (c, s) = joint.lead
    rotation = _about_x(*joint.twist)
    if joint.lead == (1.0, 0.0):
        return rotation
    out: np.ndarray = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation
    return out


def snap(x: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """An array with entries below ``ROUNDING * scale`` set to zero, and entries that near to
    ``scale`` set to it.
    """
    out = np.where(np.abs(x) <= ROUNDING * scale, 0.0, x)
    return np.where(np.abs(np.abs(out) - scale) <= ROUNDING * scale, np.sign(out) * scale, out)


def _split_rotation(rotation: np.ndarray) -> tuple[float, tuple[float, float], float]:
    """``(g, (cos t, sin t), h)`` with ``rotation = Rz(g) Rx(t) Rz(h)``; g is zero where the z axes
    are parallel.
    """
    rotation = snap(rotation)
    sine = float(np.hypot(rotation[0, 2], rotation[1, 2]))
    if sine <= ROUNDING:
        cosine = float(np.sign(rotation[2, 2]))
        return 0.0, (cosine, 0.0), float(np.arctan2(rotation[1, 0] * cosine, rotation[0, 0]))
    g = float(np.arctan2(rotation[0, 2], -rotation[1, 2]))
    length = float(np.hypot(sine, rotation[2, 2]))
    twist = float(snap(np.array(rotation[2, 2] / length))), float(snap(np.array(sine / length)))
    # from the remaining rotation, not from the entries of the size of the sine: they have few
    # digits where it is small
    left = _about_z(g).T @ rotation
    return g, twist, float(np.arctan2(-left[0, 1], left[0, 0]))


def _quarter(angle: float) -> tuple[int, float]:
    """Quarter turns (0 to 3) and the rest of an angle, zero where it is below `ROUNDING`."""
    quarters = round(angle / (np.pi / 2))
    rest = angle - quarters * (np.pi / 2)
    return quarters % 4, 0.0 if abs(rest) <= ROUNDING * max(1.0, abs(angle)) else rest


def _tidy(inertia: Inertia, *parts: Inertia) -> Inertia:
    """Inertia with entries below `ROUNDING` of its parts set to zero; diagonal entries that close
    become equal.
    """
    largest = max(float(np.abs(x.second).max()) for x in (inertia, *parts))
    heavy = max(abs(x.mass) for x in (inertia, *parts))
    reach = max(
        *(float(np.abs(x.first).max()) for x in (inertia, *parts)), float(np.sqrt(heavy * largest))
    )
    second = np.where(
        np.abs(inertia.second) <= ROUNDING * largest, 0.0, (inertia.second + inertia.second.T) / 2
    )
    for i, k in ((0, 1), (0, 2), (1, 2)):
        if abs(second[i, i] - second[k, k]) <= ROUNDING * largest:
            second[k, k] = second[i, i]
    first = np.where(np.abs(inertia.first) <= ROUNDING * reach, 0.0, inertia.first)
    return Inertia(0.0 if abs(inertia.mass) <= ROUNDING * heavy else inertia.mass, first, second)


def _share(pose: Pose, before_turns: bool) -> tuple[Pose, np.ndarray, tuple[float, float], float]:
    """``(gauge, place, twist, h)`` with ``pose = gauge T(place) Rx(twist) Rz(h)``.

    The gauge commutes with the joint before: a turn and a shift along z, or any shift where that
    joint slides.
    """
    rotation, position = pose
    size = max(float(np.abs(position).max()), 1e-9)
    position = snap(position, size)
    g, twist, h = _split_rotation(rotation)
    if not before_turns:
        return (_about_z(g), position), np.zeros(3), twist, h
    if twist[1] == 0.0 and position[0] and position[1]:
        # frames on parallel axes can be rotated freely: the next axis is reached along x
        g = float(np.arctan2(position[1], position[0]))
        h = h - g * twist[0]
    turn = _about_z(g)
    local = snap(turn.T @ position, size)
    # axes that are nearly parallel meet far away: there the frames stay where they are
    meeting = abs(twist[1]) > NEARLY_PARALLEL
    along = float(local[2] + (local[1] * twist[0] / twist[1] if meeting else 0.0))
    return (
        (turn, np.array([0.0, 0.0, along])),
        snap(local - np.array([0.0, 0.0, along]), size),
        twist,
        h,
    )


def lay_frames(
    raws: list[_Raw], gravity: np.ndarray, tool: Pose, carrier: int, to_mass: bool
) -> Chain:
    """Place the frames of all joints, from the last to the first: `Chain` without regrouping.

    Each pose is split in a part that can be moved into the frame of the joint before, if no other
    child was there first, and the rest. Frames without a joint behind them can be rotated freely.
    """
    n = len(raws)
    gauges: list[Pose] = [AT_REST] * n  # the frame that is used, in the raw one
    joints: dict[int, Joint] = {}
    # children that their frames are placed for
    first = {raws[i].before: i for i in reversed(range(n))}
    free = {i for i in range(n) if i not in first}
    for i in free if to_mass else ():
        heavy = _tidy(raws[i].inertia).first
        if raws[i].revolute and heavy[0] and heavy[1]:
            gauges[i] = _about_z(float(np.arctan2(heavy[1], heavy[0]))), np.zeros(3)
    turned = {i for i in free if gauges[i] is not AT_REST}

    def add(
        i: int, place: np.ndarray, twist: tuple[float, float], h: float, lead: float = 0.0
    ) -> None:
        """Joint i in its frame: position and twist (cosine, sine) from the frame before, then the
        angle ``h`` [rad] about z at zero; ``lead``: an angle about the z axis before.
        """
        quarters, rest = _quarter(h)
        if i in free - turned and rest != 0.0:
            gauges[i] = (_about_z(-rest), np.zeros(3))
            rest = 0.0
        inertia = _tidy(raws[i].inertia.moved(inverse(gauges[i])))
        about = _about_z(lead)
        ahead = (float(about[0, 0]), float(about[1, 0]))
        joints[i] = Joint(
            raws[i].revolute, place, twist, rest, quarters, inertia, raws[i].before, ahead
        )

    for i in reversed([i for i in range(n) if first[raws[i].before] == i]):
        pose = compose(raws[i].pose, gauges[i])
        before = raws[i].before
        if before >= 0:
            gauges[before], place, twist, h = _share(pose, raws[before].revolute)
        else:
            base, down, h = _ground(pose, gravity, raws[i].revolute)
            place = np.zeros(3)
            twist = (1.0, 0.0)
        add(i, place, twist, h)
    for i in [i for i in range(n) if i not in joints]:
        before = raws[i].before
        under = gauges[before] if before >= 0 else base
        rotation, place = compose(inverse(under), compose(raws[i].pose, gauges[i]))
        lead, twist, h = _split_rotation(rotation)
        add(i, snap(place, max(float(np.abs(place).max()), 1e-9)), twist, h, lead)
    laid = tuple(joints[i] for i in range(n))
    return Chain(laid, down, base, compose(inverse(gauges[carrier]), tool), carrier)


def _ground(pose: Pose, gravity: np.ndarray, turns: bool) -> tuple[Pose, np.ndarray, float]:
    """The frame under the first joint, gravity in it [m/s^2], and the angle left to that joint
    [rad].

    Where the joint ``turns``, the frame is turned about its axis so that gravity has two
    components at most.
    """
    size = float(np.linalg.norm(gravity)) or 1.0
    down = snap(pose[0].T @ gravity, size)
    if not (turns and down[0] and down[1]):
        return pose, down, 0.0
    angle = float(np.arctan2(down[1], down[0]))
    return (
        compose(pose, (_about_z(angle), np.zeros(3))),
        np.array([np.hypot(down[0], down[1]), 0.0, down[2]]),
        -angle,
    )


@dataclass(frozen=True)
class KeptInertia:
    """The part of a joint's inertia that is not regrouped to the body before, although it could
    be.

    ``mass``: "none", "all", or "balance": so much that the body before is balanced along the line
    to this joint. ``first``, ``second``: the moments of order one and two along the axis (all of
    order two for a joint that slides).
    """

    mass: str = "none"
    first: bool = False
    second: bool = False


def regroup(chain: Chain, kept: Sequence[KeptInertia]) -> Chain:
    """Move the inertia that a joint does not move relative to the body before to that body.

    Of a rotation: the mass on its axis (order zero, and one and two along z); of a translation:
    the second moments, which matter only for rotations. Inertia that reaches the base has no
    effect.
    """
    joints = list(chain.joints)
    axis = np.array([0.0, 0.0, 1.0])
    total = sum(joint.inertia.mass for joint in joints)
    for i in reversed(range(len(joints))):
        joint = joints[i]
        own = joints[i].inertia
        keep = kept[i]
        ahead = joints[joint.before].inertia if joint.before >= 0 else NOTHING
        rotation = rotation_before(joint)
        if joint.revolute:
            line = 0.0 if keep.first else own.first[2]
            spread = 0.0 if keep.second else own.second[2, 2]
            gone = Inertia(
                0.0 if keep.mass == "all" else own.mass, line * axis, spread * np.outer(axis, axis)
            )
            if keep.mass == "balance":
                stays = _balance(ahead + gone.moved((rotation, joint.place)), joint.place)
                # (a short distance would need a large mass, and large masses that cancel would
                # cost digits)
                gone = replace(gone, mass=gone.mass - (stays if abs(stays) <= total else 0.0))
        else:
            rotation = rotation @ _about_z(joint.turn + joint.quarters * np.pi / 2)
            gone = NOTHING if keep.second else replace(NOTHING, second=own.second)
        joints[i] = replace(joint, inertia=_tidy(own + gone.scaled(-1.0), own))
        if joint.before >= 0:
            moved = gone.moved((rotation, joint.place))
            joints[joint.before] = replace(
                joints[joint.before], inertia=_tidy(ahead + moved, ahead, moved)
            )
    return replace(chain, joints=tuple(joints))


def _balance(together: Inertia, place: np.ndarray) -> float:
    """The mass [kg] that would cancel the first moment of ``together`` along the largest entry of
    ``place`` [m], if it were moved there; 0 at the origin.
    """
    k = int(np.argmax(np.abs(place)))
    return float(together.first[k] / place[k]) if place[k] else 0.0


def make_chain(model: RobotModel, to_mass: bool = True) -> Chain:
    """The `Chain` of a model without beams, each body with its own mass: see `regroup`.

    ``to_mass``: the x axis of the last frame points to its center of mass, which costs an addition
    to the angle and saves more wherever forces are computed.
    """
    raws, tool, carrier = _flatten(model)
    return lay_frames(raws, np.array(model.gravity, dtype=float), tool, carrier, to_mass)
