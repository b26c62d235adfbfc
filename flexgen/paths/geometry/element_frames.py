"""Frames that a body of the robot carries, such as the table of a positioner: pose, and motion
with the joints.

With joints at q + u d, u from 0 to 1, the pose of the frame is

    T(u) = exp(X_1 d_1 u) ... exp(X_k d_k u) T(0)

X_j: the axis of joint j in the world at q. Each factor is the motion of a `Carrier`, one within
the other.

Source: R. M. Murray, Z. Li, S. S. Sastry, A Mathematical Introduction to Robotic Manipulation,
1994, ch. 3 (product of exponentials).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.model.elements import Dof, Element, Placement, RobotModel
from flexgen.model.moves import Carrier, Posture, WorkFrame
from flexgen.paths.geometry.jets import rotation_matrices


def stand(
    model: RobotModel, frame: WorkFrame, q_g: np.ndarray, posture: Posture | None, move: str
) -> tuple[WorkFrame, tuple[Carrier, ...]]:
    """A frame in the world at the start of a move, and the motions that carry it, the first one
    next to the base.

    Parameters
    ----------
    model : RobotModel
    frame : WorkFrame
        Of an element of the model, or in the world.
    q_g : array (n_g,) [rad or m]
        Actuated coordinates at the start.
    posture : Posture or None
        With the changes of joints during the move.
    move : str
        Its name, for errors.

    Raises
    ------
    ArgumentError
        The model has no such element, closed loops move it, or the motion of a joint that moves
        it as well as the tool is not given.
    """
    if not frame.element:
        return frame, ()
    chain = _chain(model, frame, move)
    given = {} if posture is None else dict(zip(posture.joints, posture.change, strict=True))
    _check_joints(model, chain, frame, given, move)
    at = {model.coordinates[i].name: float(q) for i, q in zip(model.i_g, q_g, strict=True)}
    p = np.zeros(3)
    R = np.eye(3)
    carriers = []
    p, R = _place(p, R, model.base)
    for element in chain:
        p, R = _place(p, R, element.origin)
        for dof in element.dofs:
            axis = R @ np.array(dof.axis, dtype=float)
            change = _value(dof, given)
            if change:
                carriers.append(_carrier(dof, p, axis * change))
            p, R = _move(dof, p, R, _value(dof, at))
        p, R = _place(p, R, element.link)
        if element.beam is not None:
            p = p + R[:, 0] * element.beam.length
    p, R = _place(p, R, Placement(tuple(frame.position), frame.rotation))
    return WorkFrame(frame.name, tuple(p.tolist()), _rows(R)), tuple(carriers)


def _chain(model: RobotModel, frame: WorkFrame, move: str) -> list[Element]:
    """The elements from the base to that of the frame."""
    elements = {element.name: element for element in model.elements}
    if frame.element not in elements:
        raise ArgumentError(
            f"move {move}: given frame {frame.name} of element {frame.element!r}, expected one of "
            f"{', '.join(elements)}"
        )
    chain = []
    name = frame.element
    while name != "base":
        chain.append(elements[name])
        name = model.parents[name]
    return chain[::-1]


def _check_joints(
    model: RobotModel,
    chain: Sequence[Element],
    frame: WorkFrame,
    given: Mapping[str, float],
    move: str,
) -> None:
    """Refuse a frame whose motion during the move is not known."""
    own = [dof for element in chain for dof in element.dofs]
    if any(dof.passive is not None for dof in own):
        raise ArgumentError(
            f"move {move}: given frame {frame.name} of element {frame.element}, which closed "
            "loops move, expected an element that joints in series carry"
        )
    of_tool = {
        element.name for element in _chain(model, WorkFrame("tool", element=model.tip), move)
    }
    for element in chain:
        for dof in element.dofs:
            if dof.actuated and element.name in of_tool and dof.name not in given:
                if model.output.size == model.n_g:
                    raise ArgumentError(
                        f"move {move}: given frame {frame.name} of element {frame.element}, which "
                        f"{dof.name} moves together with the tool, whose outputs determine all "
                        "joints, expected the base, or an element that other joints carry"
                    )
                raise ArgumentError(
                    f"move {move}: given frame {frame.name} of element {frame.element}, which "
                    f"{dof.name} moves together with the tool, expected the motion of this joint: "
                    f"posture = {{ joints = {{ {dof.name} = ... }} }}, 0 for none"
                )


def _value(dof: Dof, values: Mapping[str, float]) -> float:
    """Position, or change, of a degree of freedom from those of the actuated coordinates; 0
    without deflection.
    """
    moved = dof.mimic or ((dof.name, 1.0),)
    return sum(factor * values.get(name, 0.0) for name, factor in moved)


def _carrier(dof: Dof, origin: np.ndarray, change: np.ndarray) -> Carrier:
    """The motion of all that a joint carries; ``change`` (3,): its change along its axis."""
    if dof.type == "rotation":
        return Carrier(tuple(origin.tolist()), rotation=tuple(change.tolist()))
    return Carrier(tuple(origin.tolist()), displacement=tuple(change.tolist()))


def _place(p: np.ndarray, R: np.ndarray, placement: Placement) -> tuple[np.ndarray, np.ndarray]:
    """The frame fixed at a constant placement to the frame with position p and orientation R."""
    return p + R @ np.array(placement.position), R @ np.array(placement.rotation)


def _move(dof: Dof, p: np.ndarray, R: np.ndarray, q: float) -> tuple[np.ndarray, np.ndarray]:
    """The frame after a degree of freedom at q."""
    axis = np.array(dof.axis, dtype=float)
    if dof.type == "translation":
        return p + R @ axis * q, R
    return p, R @ rotation_matrices(axis, np.array([q]))[0]


def _rows(R: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, R.tolist()))
