"""Static kinematics of elastic trees at many poses at once, with exact derivatives in all
geometric parameters.

Each joint, each elastic axis and each error of a placement is a *node*: a rotation about, or a
translation along, a fixed axis of the node before it. One formula then gives the derivatives in
all of them. With the axis ``z_a`` and origin ``o_a`` of node a in the world, mass ``m_a`` and
first moment ``M_a = sum m (c - o_a)`` of all that it carries:

    point p:           dp/dq_a     = z_a x (p - o_a)                  or z_a
    (rotation or translation)
    load of gravity:   tau_a       = g . (z_a x M_a)                  or m_a g . z_a
    its slope:         dtau_a/dq_b = g . (z_a x (z_b x M_b))
    or g . (z_a x m_b z_b), b carried by a; symmetric

This code does not share a line with `flexgen.dynamics.mechanics`; tests compare the two.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 2-4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.sensors import TOOL
from flexgen.model.elements import Body, Dof, LinearSpring, Placement, RobotModel

# errors of a placement: translations, then rotations about the same axes
SHIFTS = ("x", "y", "z", "rx", "ry", "rz")
IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Node:
    """A rotation about, or translation along, ``axis``, at a constant placement from the node
    ``parent`` (-1: base).
    """

    name: str
    parent: int
    position: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray
    slides: bool


@dataclass(frozen=True)
class Mount:
    """A frame at a constant placement from a node."""

    node: int
    position: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True)
class Places:
    """Where nodes are in the frame after the last node before them that moves, ``stem`` (n,); -1:
    the base.

    ``before``, ``at`` (n, 3, 3), (n, 3): the frame in front of the motion of a node; ``R``, ``p``:
    that after it, of a node that does not move; ``axes`` (n, 3); ``moving``: nodes that move;
    ``turns`` (., 9, 3): parts of the columns of ``before`` times the rotations of these, to be
    multiplied by 1, cos and sin of their angles.
    """

    stem: np.ndarray
    before: np.ndarray
    at: np.ndarray
    R: np.ndarray
    p: np.ndarray
    axes: np.ndarray
    moving: np.ndarray
    turns: np.ndarray


@dataclass(frozen=True)
class Posture:
    """The tree at N poses; ``moving``: the frame after the base and each node that moves.

    (3, 3, N): components of the first to the third axis of the frame; (3, N): its origin.
    """

    places: Places
    moving: dict[int, tuple[np.ndarray, np.ndarray]]

    def frame(self, node: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (N, 3, 3) and position (N, 3) [m] of the frame after a node; -1: the base."""
        still = node not in self.moving
        frame, p = self.moving[self.places.stem[node] if still else node]
        R = frame.transpose(2, 1, 0)
        return (R @ self.places.R[node], p.T + R @ self.places.p[node]) if still else (R, p.T)

    def axes(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Axes and origins (n, N, 3) of some nodes."""
        stem = self.places.stem[nodes]
        N = self.moving[-1][1].shape[1]
        z, o = np.empty((2, len(nodes), 3, N))
        for k in np.unique(stem):
            on = stem == k
            (frame, p) = self.moving[k]
            z[on] = _in_world(frame, self.places.axes[nodes[on]])
            o[on] = p + _in_world(frame, self.places.at[nodes[on]])
        return np.swapaxes(z, 1, 2), np.swapaxes(o, 1, 2)

    @cached_property
    def every(self) -> tuple[np.ndarray, np.ndarray]:
        """Those of all nodes."""
        return self.axes(np.arange(len(self.places.stem)))


class Tree:
    """Nodes, bodies and coordinates of a model.

    ``nodes``; ``index``: node of each name, ``ELEMENT.x`` to ``ELEMENT.rz`` for placements, the
    names of degrees of freedom otherwise; ``elastic``: compliance [rad/(N m) or m/N] of each
    elastic coordinate; ``mimics``: factors of each mechanism; ``bodies``: (name, mount, body);
    ``tips``: the frame of each element's body; ``carries`` (n, n): [a, b] whether node a moves
    node b, or is it.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.nodes: list[Node] = []
        self.index: dict[str, int] = {}
        self.elastic: dict[str, float] = {}
        self.mimics: dict[str, dict[str, float]] = {}
        self.tips: dict[str, Mount] = {
            "base": Mount(-1, np.array(model.base.position), np.array(model.base.rotation))
        }
        self.bodies: list[tuple[str, Mount, Body]] = []
        ratios = {
            motor.drives[0]: motor.ratio[0] for motor in model.motors if len(motor.drives) == 1
        }
        for element in model.elements:
            if element.beam is not None:
                raise _refuse(
                    model, element.name, "elastic axes, [[element.dof]] with a spring", "a beam"
                )
            mount = _place(self.tips[model.parents[element.name]], element.origin)
            for k, shift in enumerate(SHIFTS):
                mount = self._add(f"{element.name}.{shift}", mount, IDENTITY[k % 3], k < 3)
            for dof in element.dofs:
                mount = self._add(dof.name, mount, np.array(dof.axis), dof.type == "translation")
                if dof.mimic:
                    self.mimics[dof.name] = dict(dof.mimic)
                elif dof.gear is None or not dof.gear.rigid:
                    self.elastic[dof.name] = _compliance(model, dof, ratios)
            self.tips[element.name] = _place(mount, element.link)
            self.bodies.append((element.name, self.tips[element.name], element.body))
        self.tool = _place(self.tips[model.tip], model.tool)
        if model.payload.mass:
            self.bodies.append(("payload", self.tips[model.tip], model.payload))
        n = len(self.nodes)
        self.carries = np.zeros((n, n), bool)
        for k, node in enumerate(self.nodes):
            self.carries[k, k] = True
            if node.parent >= 0:
                self.carries[:, k] |= self.carries[:, node.parent]

    def tip(self, place: str) -> Mount:
        """The frame of an element's body, or with ``"tool"`` that of the tool."""
        return self.tool if place == TOOL else self.tips[place]

    def _add(self, name: str, mount: Mount, axis: np.ndarray, slides: bool) -> Mount:
        self.index[name] = len(self.nodes)
        self.nodes.append(Node(name, mount.node, mount.position, mount.rotation, axis, slides))
        return Mount(len(self.nodes) - 1, np.zeros(3), IDENTITY)

    def places(self, q: np.ndarray, moving: np.ndarray) -> Places:
        """The constant places, where only the nodes ``moving`` have other values than ``q`` (n,)
        [rad or m].
        """
        n = len(self.nodes)
        stem = np.empty(n, int)
        moves = np.isin(np.arange(n), moving)
        before = np.empty((n, 3, 3))
        R = np.empty((n, 3, 3))
        at = np.empty((n, 3))
        p = np.empty((n, 3))
        slides = np.array([node.slides for node in self.nodes])
        axes = np.array([node.axis for node in self.nodes])
        turned = rotations(axes, np.where(slides, 0.0, q))
        shifted = np.where(slides, q, 0.0)[:, None] * axes
        for k, node in enumerate(self.nodes):
            m = node.parent
            stem[k], R_m, p_m = (m, IDENTITY, 0.0) if m < 0 or moves[m] else (stem[m], R[m], p[m])
            before[k] = R_m @ node.rotation
            at[k] = p_m + R_m @ node.position
            R[k] = before[k] @ turned[k]
            p[k] = at[k] + before[k] @ shifted[k]
        # (., row, column, part)
        parts = np.stack([before @ part for part in _rotation_parts(axes)], axis=-1)[moving]
        turns = np.swapaxes(parts, 1, 2).reshape(len(moving), 9, 3)
        return Places(stem, before, at, R, p, (before @ axes[..., None])[..., 0], moving, turns)

    def posture(self, q: np.ndarray, places: Places | None = None) -> Posture:
        """Axes and frames at the values ``q`` (N, n) of the nodes [rad or m].

        ``places``: those of the nodes that have the same value at all poses, as most errors of
        placements have.
        """
        places = places or self.places(q[0], np.flatnonzero((q != q[0]).any(axis=0)))
        value = q[:, places.moving].T
        # (., 9, N)
        turns = places.turns @ np.stack(
            [np.ones_like(value), np.cos(value), np.sin(value)], axis=1
        )
        moving = {-1: (np.repeat(IDENTITY[..., None], len(q), axis=2), np.zeros((3, len(q))))}
        for k, x, turn in zip(
            places.moving, value, turns.reshape(len(value), 3, 3, -1), strict=True
        ):
            frame, p = moving[places.stem[k]]
            at = p + _in_world(frame, places.at[k])
            if self.nodes[k].slides:
                moving[k] = (
                    _in_world(frame, places.before[k].T),
                    at + x * _in_world(frame, places.axes[k]),
                )
            else:
                x_axis, y_axis, z_axis = frame
                moving[k] = turn[:, :1] * x_axis + turn[:, 1:2] * y_axis + turn[:, 2:] * z_axis, at
        return Posture(places, moving)

    def point(self, at: Posture, mount: Mount, position: np.ndarray) -> np.ndarray:
        """Position (N, 3) [m] in the world of a point of a frame."""
        R, p = at.frame(mount.node)
        return np.asarray(p + R @ (mount.position + mount.rotation @ position))

    def point_slopes(self, at: Posture, mount: Mount, point: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3, n) of a point of a frame in the values of all nodes."""
        slopes = np.zeros((len(point), 3, len(self.nodes)))
        if mount.node >= 0:
            on = np.flatnonzero(self.carries[:, mount.node])
            sliding = np.array([self.nodes[a].slides for a in on])[:, None, None]
            z = at.every[0][on]
            o = at.every[1][on]
            slopes[:, :, on] = np.moveaxis(np.where(sliding, z, np.cross(z, point - o)), 0, 2)
        return slopes


def _in_world(frame: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of a frame (3, 3, N) in the world: (..., 3, N)."""
    return (vectors @ frame.reshape(3, -1)).reshape(vectors.shape[:-1] + frame.shape[1:])


def rotations(axes: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) about unit axes, (N, 3) or one, by the angles ``q`` (N,) [rad]
    (Rodrigues).
    """
    constant, cosine, sine = _rotation_parts(axes)
    return np.asarray(
        constant + np.cos(q)[:, None, None] * cosine + np.sin(q)[:, None, None] * sine
    )


def _rotation_parts(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The parts (..., 3, 3) of rotation matrices that are constant, times the cosine, and times
    the sine.
    """
    along = axes[..., :, None] * axes[..., None, :]
    return along, IDENTITY - along, np.cross(IDENTITY, axes[..., None, :])


def _place(mount: Mount, placement: Placement) -> Mount:
    """A frame at a constant placement from another."""
    rotation = np.array(placement.rotation)
    return Mount(
        mount.node,
        mount.position + mount.rotation @ np.array(placement.position),
        mount.rotation @ rotation,
    )


def _compliance(model: RobotModel, dof: Dof, ratios: dict[str, float]) -> float:
    """Compliance of an elastic coordinate on the arm side [rad/(N m) or m/N]; 0 for a spring of
    stiffness 0.
    """
    spring = dof.gear.spring if dof.gear is not None else dof.spring
    if not isinstance(spring, LinearSpring):
        given = f"a {type(spring).__name__.removesuffix('Spring').lower()} spring"
        raise _refuse(model, dof.name, "a linear spring", given)
    if spring.stiffness == 0.0:
        raise _refuse(model, dof.name, "a stiffness > 0", "stiffness 0")
    scale = ratios[dof.name] ** 2 if dof.gear is not None and dof.gear.side == "motor" else 1.0
    return 1.0 / (scale * spring.stiffness)


def _refuse(model: RobotModel, where: str, expected: str, given: str) -> ModelError:
    return ModelError(
        model.file or model.name, 0, where, given, f"{expected}, in a model that is calibrated"
    )
