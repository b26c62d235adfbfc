"""Kinematics of a chain or a tree as CasADi graphs: frames, velocities, and the energies of the
bodies.

Velocities are carried along in the moving frames, which keeps the graphs small:

    constant placement (r, C):    w <- C' w,             v <- C' (v + w x r)
    rotation about a by q:        w <- E' w + a q',      v <- E' v,             E = exp(a q)
    translation along a by q:     w <- w,                v <- v + w x (a q) + a q'

Source: R. Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 2-4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from flexgen.model.elements import Body, Element, LoopFrame, Matrix, Placement, RobotModel

if TYPE_CHECKING:
    from flexgen.dynamics.mechanics.beam import ModalBeam
    from flexgen.dynamics.mechanics.lines import LineMotion


@dataclass(frozen=True)
class Frame:
    """A frame F: ``p`` (3) and ``R`` (3x3) in the world; ``w``, ``v`` (3) of F in its own axes."""

    p: ca.SX
    R: ca.SX
    w: ca.SX
    v: ca.SX


@dataclass(frozen=True)
class Kinematics:
    """Kinematics of all elements and the energies that follow from it.

    ``q_a``, ``v_a`` (n_a): the symbols. ``tool``: the tool frame. ``kinetic``: kinetic energy of
    the bodies and beams [J], without the rotors. ``gravity``: their potential energy [J].
    ``drag``: half the power that body drags dissipate [W]. ``spin``: angular velocity (3) of each
    element's body in its own axes, for the rotors that it carries. ``modal``: the integrals of
    each beam with the index of its first coordinate in q_a. ``points``: positions in the world of
    the `corners`, for drawing. ``frames``: the frame of each element's body. ``lines``: motions of
    the lines between two points, whose masses are part of ``kinetic`` and ``gravity``.
    """

    q_a: ca.SX
    v_a: ca.SX
    tool: Frame
    kinetic: ca.SX
    gravity: ca.SX
    drag: ca.SX
    spin: dict[str, ca.SX]
    modal: tuple[tuple[int, ModalBeam], ...]
    points: tuple[ca.SX, ...]
    frames: dict[str, Frame]
    lines: tuple[LineMotion, ...]


def cross_matrix(a: ca.SX) -> ca.SX:
    """The matrix ``A`` with ``A b = a x b``."""
    return ca.vertcat(
        ca.horzcat(0, -a[2], a[1]), ca.horzcat(a[2], 0, -a[0]), ca.horzcat(-a[1], a[0], 0)
    )


def rotation(axis: np.ndarray, q: ca.SX) -> ca.SX:
    """``exp(axis q)``: rotation about a constant unit axis (Rodrigues); exact zeros for coordinate
    axes.
    """
    outer, other, hat = _parts(axis.astype(float).tobytes())
    return outer + other * ca.cos(q) + hat * ca.sin(q)


@lru_cache(maxsize=64)
def _parts(axis: bytes) -> tuple[ca.SX, ca.SX, ca.SX]:
    """``a a'``, ``1 - a a'``, ``a x`` of an axis, given by its bytes: -0.0 is not 0.0."""
    a = ca.SX(ca.DM(np.frombuffer(axis)))
    outer = ca.mtimes(a, a.T)
    return outer, ca.SX.eye(3) - outer, cross_matrix(a)


def place(frame: Frame, placement: Placement) -> Frame:
    """The frame fixed to ``frame`` at a constant placement."""
    r, C, back = _constants(
        *(np.array(x, float).tobytes() for x in (placement.position, placement.rotation))
    )
    return Frame(
        p=frame.p + ca.mtimes(frame.R, r),
        R=ca.mtimes(frame.R, C),
        w=ca.mtimes(back, frame.w),
        v=ca.mtimes(back, frame.v + ca.cross(frame.w, r)),
    )


@lru_cache(maxsize=64)
def _constants(position: bytes, rotation: bytes) -> tuple[ca.SX, ca.SX, ca.SX]:
    """A position, a rotation matrix and its inverse, from their bytes; CasADi converts arrays
    slowly.
    """
    C = ca.SX(ca.DM(np.frombuffer(rotation).reshape(3, 3)))
    return ca.SX(ca.DM(np.frombuffer(position))), C, C.T


def _matrix(rows: Matrix) -> ca.SX:
    """A matrix of numbers, some of which may be symbols."""
    if any(isinstance(x, ca.SX) for row in rows for x in row):
        return ca.vertcat(*[ca.horzcat(*map(ca.SX, row)) for row in rows])
    return ca.SX(ca.DM(np.array(rows)))


def body_energies(frame: Frame, body: Body, gravity: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Kinetic and potential energy [J] of a body in its frame, and half the power of its drag
    [W].
    """
    com = ca.vertcat(*map(ca.SX, body.com))
    inertia = _matrix(body.inertia)
    v_com = frame.v + ca.cross(frame.w, com)
    turning = ca.dot(frame.w, ca.mtimes(inertia, frame.w)) / 2
    kinetic = body.mass * ca.dot(v_com, v_com) / 2 + turning
    potential = -body.mass * ca.dot(gravity, frame.p + ca.mtimes(frame.R, com))
    return kinetic, potential, body.rotational_drag * ca.dot(frame.w, frame.w) / 2


def beam_energies(
    frame: Frame, beam: ModalBeam, q: ca.SX, v: ca.SX, gravity: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Kinetic and potential energy [J] of a beam rooted in ``frame`` with modal coordinates ``q``
    and velocities ``v``.

    With r = x e_x + u, u = sum phi_k q_k d_k:
    T = m |v0|^2/2 + v0.(w x S + S') + w.I w/2 + w.H + (modal), S = int r dm, I = int (r.r 1 - r
    r') dm, H = int r x r' dm. Torsion t = sum phi_k q_k adds int i (w_x + t')^2 dx / 2, i the
    polar moment of inertia per length.
    """
    d = beam.direction.T  # (3, n)
    ex = np.array([1.0, 0.0, 0.0])
    first = ca.SX(ca.DM(beam.s0 * ex)) + ca.mtimes(ca.SX(ca.DM(d * beam.s1)), q)
    rate = ca.mtimes(ca.SX(ca.DM(d * beam.s1)), v)
    # second moments P = int r r' dm
    j1 = ca.mtimes(ca.SX(ca.DM(d * beam.j1)), q)  # int x u dm
    e = ca.SX(ca.DM(ex))
    P = beam.j0 * ca.mtimes(e, e.T) + ca.mtimes(e, j1.T) + ca.mtimes(j1, e.T)
    spin = ca.cross(e, ca.mtimes(ca.SX(ca.DM(d * beam.j1)), v))
    for i in range(len(beam.slope)):
        for k in range(len(beam.slope)):
            if beam.m2[i, k] != 0.0:
                di = ca.SX(ca.DM(d[:, i]))
                dk = ca.SX(ca.DM(d[:, k]))
                P += beam.m2[i, k] * q[i] * q[k] * ca.mtimes(di, dk.T)
                spin += beam.m2[i, k] * q[i] * v[k] * ca.cross(di, dk)
    inertia = ca.trace(P) * ca.SX.eye(3) - P
    w = frame.w
    v0 = frame.v
    kinetic = (
        beam.mass * ca.dot(v0, v0) / 2
        + ca.dot(v0, ca.cross(w, first) + rate)
        + ca.dot(w, ca.mtimes(inertia, w)) / 2
        + ca.dot(w, spin)
        + ca.dot(v, ca.mtimes(ca.SX(ca.DM(beam.m2 * (d.T @ d))), v)) / 2
    )
    if beam.twist.any():
        kinetic = (
            kinetic
            + beam.polar * w[0] ** 2 / 2
            + w[0] * ca.dot(ca.SX(ca.DM(beam.polar1)), v)
            + ca.dot(v, ca.mtimes(ca.SX(ca.DM(beam.polar2)), v)) / 2
        )
    potential = -ca.dot(gravity, beam.mass * frame.p + ca.mtimes(frame.R, first))
    return kinetic, potential


def beam_tip(frame: Frame, element: Element, beam: ModalBeam, q: ca.SX, v: ca.SX) -> Frame:
    """Frame at the beam's tip: deflected by the modes with coordinates ``q`` and rates ``v``,
    turned by their slopes (first about z, then about y) and twisted about its axis.
    """
    assert element.beam is not None
    d = ca.SX(ca.DM(beam.direction.T))
    r = ca.SX(ca.DM([element.beam.length, 0.0, 0.0])) + ca.mtimes(d, q)
    moved = Frame(
        frame.p + ca.mtimes(frame.R, r),
        frame.R,
        frame.w,
        frame.v + ca.cross(frame.w, r) + ca.mtimes(d, v),
    )
    for axis, row, sign in (
        (np.array([0.0, 0.0, 1.0]), 1, 1.0),
        (np.array([0.0, 1.0, 0.0]), 2, -1.0),
    ):
        slope = ca.SX(ca.DM(sign * beam.slope * beam.direction[:, row]))
        moved = _turn(moved, axis, ca.dot(slope, q), ca.dot(slope, v))
    if beam.twist.any():
        twist = ca.SX(ca.DM(beam.twist))
        moved = _turn(moved, np.array([1.0, 0.0, 0.0]), ca.dot(twist, q), ca.dot(twist, v))
    return moved


def _turn(frame: Frame, axis: np.ndarray, q: ca.SX, v: ca.SX) -> Frame:
    E = rotation(axis, q)
    w = ca.mtimes(E.T, frame.w) + ca.SX(ca.DM(axis)) * v
    return Frame(frame.p, ca.mtimes(frame.R, E), w, ca.mtimes(E.T, frame.v))


def _slide(frame: Frame, axis: np.ndarray, q: ca.SX, v: ca.SX) -> Frame:
    """The frame moved along ``axis`` (3,), in its own axes, by ``q`` [m] with the speed ``v``
    [m/s].
    """
    a = ca.SX(ca.DM(axis))
    return Frame(
        frame.p + ca.mtimes(frame.R, a) * q,
        frame.R,
        frame.w,
        frame.v + ca.cross(frame.w, a * q) + a * v,
    )


def corners(model: RobotModel) -> list[tuple[str, int]]:
    """The corner points of a robot as one line: pairs of element and point, a line that ends at
    the tool.

    Points of an element: 0 its origin, 1 its joints, 2 its body frame, 3 the tip of its beam, 4
    the center of mass of a body at the end of a branch, 5 and on the ends of kinematic loops;
    ``("base", 0)``, and ``("", 0)`` the tool. From the end of a branch the line goes back to where
    the next one begins.
    """
    trails = {"base": [("base", 0)]}
    line = [("base", 0)]
    here = trails["base"]

    def walk(parent: str, own: list[tuple[str, int]]) -> list[tuple[str, int]]:
        there = trails[parent]
        shared = sum(a == b for a, b in zip(here, there, strict=False))
        line.extend([*here[max(shared - 1, 0) : -1][::-1], *there[shared:], *own])
        return [*there, *own]

    for element in model.elements:
        own = [(element.name, k) for k in range(3 if element.beam is None else 4)]
        closing = [k for k, at in _closing_points(model, element.name) if any(at.position)]
        for k in closing:
            own += [(element.name, k), (element.name, 2)]
        ends = element.name not in model.parents.values() and element.name != model.tip
        if ends and not closing:
            own.append((element.name, 4))
        here = trails[element.name] = walk(model.parents[element.name], own)
    walk(model.tip, [("", 0)])
    return line


def _closing_points(model: RobotModel, element: str) -> list[tuple[int, LoopFrame]]:
    """Ends of kinematic loops at an element, with the numbers of their corner points."""
    ends = [end for loop in model.loops for end in (loop.start, loop.end)]
    return [(5 + k, end) for k, end in enumerate(ends) if end.element == element]


def joint_motions(model: RobotModel, q_a: ca.SX, v_a: ca.SX) -> dict[str, tuple[ca.SX, ca.SX]]:
    """Position and speed of each coordinate and each passive joint of closed loops, by name."""
    out = {c.name: (q_a[k], v_a[k]) for k, c in enumerate(model.coordinates)}
    if model.loops:
        from flexgen.dynamics.mechanics.closed_loops import closed_joints

        passive = {name: q for name, q in closed_joints(model, q_a).items() if name not in out}
        # together, since they share the iteration
        speeds = ca.jtimes(ca.vertcat(*passive.values()), q_a, v_a)
        for k, (name, q) in enumerate(passive.items()):
            out[name] = q, speeds[k]
    return out


def kinematics(model: RobotModel) -> Kinematics:
    """Build the `Kinematics` of a model from its data: frames from the base to the tool, element
    by element, each from the tip of its parent, and the energies of all bodies and beams.

    A joint that follows others, ``mimic``, moves by their weighted sum and has no coordinate of
    its own. A passive joint of closed loops has none either: `closed_joints`.
    """
    from flexgen.dynamics.mechanics.beam import modal_beam

    q_a = ca.SX.sym("q_a", model.n_a)
    v_a = ca.SX.sym("v_a", model.n_a)
    gravity = ca.SX(ca.DM(model.gravity))
    frame = place(Frame(ca.SX.zeros(3), ca.SX.eye(3), ca.SX.zeros(3), ca.SX.zeros(3)), model.base)
    tips = {"base": frame}
    kinetic = potential = drag = ca.SX(0)
    spin = {"base": ca.SX.zeros(3)}
    frames = {}
    modal: list[tuple[int, ModalBeam]] = []
    points = {("base", 0): frame.p}
    i = 0
    at = joint_motions(model, q_a, v_a)
    for element in model.elements:
        frame = place(tips[model.parents[element.name]], element.origin)
        points[element.name, 0] = frame.p
        for dof in element.dofs:
            step = _turn if dof.type == "rotation" else _slide
            moved = dict(dof.mimic) or {dof.name: 1.0}
            i = i + (not dof.dependent)
            q, v = (sum(factor * at[name][k] for name, factor in moved.items()) for k in (0, 1))
            frame = step(frame, np.array(dof.axis), q, v)
        points[element.name, 1] = frame.p
        frame = place(frame, element.link)
        points[element.name, 2] = frame.p
        spin[element.name] = frame.w
        frames[element.name] = frame
        points[element.name, 4] = frame.p + ca.mtimes(
            frame.R, ca.vertcat(*map(ca.SX, element.body.com))
        )
        for k, end in _closing_points(model, element.name):
            points[element.name, k] = place(frame, end).p
        terms = body_energies(frame, element.body, gravity)
        kinetic = kinetic + terms[0]
        potential = potential + terms[1]
        drag = drag + terms[2]
        if element.beam is not None:
            beam = modal_beam(element.beam)
            n = len(beam.slope)
            q = q_a[i : i + n]
            v = v_a[i : i + n]
            energies = beam_energies(frame, beam, q, v, gravity)
            kinetic = kinetic + energies[0]
            potential = potential + energies[1]
            modal.append((i, beam))
            frame = beam_tip(frame, element, beam, q, v)
            points[element.name, 3] = frame.p
            i += n
        tips[element.name] = frame
    terms = body_energies(tips[model.tip], model.payload, gravity)
    tool = place(tips[model.tip], model.tool)
    points["", 0] = tool.p
    kinetic = kinetic + terms[0]
    potential = potential + terms[1]
    lines = _lines(model, {"base": tips["base"], **frames}, gravity)
    for line in lines:
        kinetic = kinetic + line.kinetic
        potential = potential + line.gravity
    return Kinematics(
        q_a=q_a,
        v_a=v_a,
        tool=tool,
        kinetic=kinetic,
        gravity=potential,
        drag=drag + terms[2],
        spin=spin,
        modal=tuple(modal),
        points=tuple(points[corner] for corner in corners(model)),
        frames=frames,
        lines=lines,
    )


def _lines(
    model: RobotModel, frames: Mapping[str, Frame], gravity: ca.SX
) -> tuple[LineMotion, ...]:
    """Motions of the lines of a model between bodies with these ``frames``, by the name of the
    element; that of the base by ``"base"``.
    """
    if not model.lines:
        return ()
    from flexgen.dynamics.mechanics.lines import line_motion

    motions = []
    for line in model.lines:
        ends = [
            place(frames[anchor.element], Placement(anchor.position))
            for anchor in (line.start, line.end)
        ]
        points = ca.horzcat(*[end.p for end in ends])
        velocities = ca.horzcat(*[ca.mtimes(end.R, end.v) for end in ends])
        motions.append(line_motion(line, points, velocities, gravity))
    return tuple(motions)
