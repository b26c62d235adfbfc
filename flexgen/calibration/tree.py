"""Static kinematics of elastic trees at many poses at once, with exact derivatives in all geometric parameters.

Each joint, each elastic axis and each error of a placement is a *node*: a rotation about, or a translation along, a
fixed axis of the node before it. One formula then gives the derivatives in all of them. With the axis ``z_a`` and
origin ``o_a`` of node a in the world, mass ``m_a`` and first moment ``M_a = sum m (c - o_a)`` of all that it carries:

    point p:           dp/dq_a     = z_a x (p - o_a)                  or z_a          (rotation or translation)
    load of gravity:   tau_a       = g . (z_a x M_a)                  or m_a g . z_a
    its slope:         dtau_a/dq_b = g . (z_a x (z_b x M_b))          or g . (z_a x m_b z_b), b carried by a; symmetric

This code does not share a line with `flexgen.mechanics`; tests compare the two.

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 2-4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.errors import ModelError
from flexgen.model.elements import Body, Dof, LinearSpring, Placement, RobotModel
from flexgen.sensors import TOOL

SHIFTS = ("x", "y", "z", "rx", "ry", "rz")  # errors of a placement: translations, then rotations about the same axes
IDENTITY = np.eye(3)


@dataclass(frozen=True)
class Node:
    """A rotation about, or translation along, ``axis``, at a constant placement from the node ``parent`` (-1: base)."""

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
class Posture:
    """The tree at N poses: ``z``, ``o`` (n, N, 3) axes and origins of the nodes; ``p``, ``R``: frames after them."""

    z: np.ndarray
    o: np.ndarray
    p: np.ndarray
    R: np.ndarray


class Tree:
    """Nodes, bodies and coordinates of a model.

    ``nodes``; ``index``: node of each name, ``ELEMENT.x`` to ``ELEMENT.rz`` for placements, the names of degrees of
    freedom otherwise; ``elastic``: compliance [rad/(N m) or m/N] of each elastic coordinate; ``mimics``: factors
    of each mechanism; ``bodies``: (name, mount, body); ``tips``: the frame of each element's body; ``carries`` (n, n):
    [a, b] whether node a moves node b, or is it.
    """

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.nodes: list[Node] = []
        self.index: dict[str, int] = {}
        self.elastic: dict[str, float] = {}
        self.mimics: dict[str, dict[str, float]] = {}
        self.tips: dict[str, Mount] = {"base": Mount(-1, np.array(model.base.position), np.array(model.base.rotation))}
        self.bodies: list[tuple[str, Mount, Body]] = []
        ratios = {motor.drives[0]: motor.ratio[0] for motor in model.motors if len(motor.drives) == 1}
        for element in model.elements:
            if element.beam is not None:
                raise _refuse(model, element.name, "elastic axes, [[element.dof]] with a spring", "a beam")
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

    def posture(self, q: np.ndarray) -> Posture:
        """Axes and frames at the values ``q`` (N, n) of the nodes [rad or m]."""
        n, N = len(self.nodes), len(q)
        z, o, p = np.zeros((n, N, 3)), np.zeros((n, N, 3)), np.zeros((n, N, 3))
        R = np.zeros((n, N, 3, 3))
        for k, node in enumerate(self.nodes):
            before = R[node.parent] if node.parent >= 0 else IDENTITY[None]
            at = _times(before, node.position) + (p[node.parent] if node.parent >= 0 else 0.0)
            turned = before if node.rotation is IDENTITY else _times(before, node.rotation)
            z[k], o[k] = _times(turned, node.axis), at
            if node.slides:
                R[k], p[k] = turned, at + q[:, k, None] * z[k]
            elif (q[:, k] == q[0, k]).all():  # the unknown shifts: most of the nodes
                R[k], p[k] = _times(turned, rotations(node.axis, q[:1, k])[0]), at
            else:
                R[k], p[k] = turned @ rotations(node.axis, q[:, k]), at
        return Posture(z, o, p, R)

    def point(self, at: Posture, mount: Mount, position: np.ndarray) -> np.ndarray:
        """Position (N, 3) [m] in the world of a point of a frame."""
        if mount.node < 0:
            return np.broadcast_to(mount.position + mount.rotation @ position, at.p.shape[1:])
        return at.p[mount.node] + at.R[mount.node] @ (mount.position + mount.rotation @ position)

    def point_slopes(self, at: Posture, mount: Mount, point: np.ndarray) -> np.ndarray:
        """Derivatives (N, 3, n) of a point of a frame in the values of all nodes."""
        slopes = np.zeros((len(point), 3, len(self.nodes)))
        if mount.node >= 0:
            on = np.flatnonzero(self.carries[:, mount.node])
            sliding = np.array([self.nodes[a].slides for a in on])[:, None, None]
            each = np.where(sliding, at.z[on], np.cross(at.z[on], point - at.o[on]))
            slopes[:, :, on] = np.moveaxis(each, 0, 2)
        return slopes


def _times(R: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """``R @ constant`` of matrices (N, 3, 3) and a constant matrix or vector, as one product."""
    return (R.reshape(-1, 3) @ constant).reshape(R.shape[:2] + constant.shape[1:])


def rotations(axis: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) about a unit axis by the angles ``q`` (N,) [rad] (Rodrigues)."""
    x, y, z = axis
    hat, outer = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]), np.outer(axis, axis)
    return outer + np.cos(q)[:, None, None] * (IDENTITY - outer) + np.sin(q)[:, None, None] * hat


def _place(mount: Mount, placement: Placement) -> Mount:
    """A frame at a constant placement from another."""
    rotation = np.array(placement.rotation)
    return Mount(mount.node, mount.position + mount.rotation @ np.array(placement.position), mount.rotation @ rotation)


def _compliance(model: RobotModel, dof: Dof, ratios: dict[str, float]) -> float:
    """Compliance of an elastic coordinate on the arm side [rad/(N m) or m/N]; 0 for a spring of stiffness 0."""
    spring = dof.gear.spring if dof.gear is not None else dof.spring
    if not isinstance(spring, LinearSpring):
        given = f"a {type(spring).__name__.removesuffix('Spring').lower()} spring"
        raise _refuse(model, dof.name, "a linear spring", given)
    if spring.stiffness == 0.0:
        raise _refuse(model, dof.name, "a stiffness > 0", "stiffness 0")
    scale = ratios[dof.name] ** 2 if dof.gear is not None and dof.gear.side == "motor" else 1.0
    return 1.0 / (scale * spring.stiffness)


def _refuse(model: RobotModel, where: str, expected: str, given: str) -> ModelError:
    return ModelError(model.file or model.name, 0, where, given, f"{expected}, in a model that is calibrated")
