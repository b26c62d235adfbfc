"""The calibrated numbers as keys of a model file.

The zero of an axis is part of ``origin`` where the axis is the first one of its element; else it
turns the axes behind it, and ``link``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.base.spec.schema import write
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.identification.poses.parameters import trackers_of
from flexgen.identification.poses.statics import Numbers, frame_rotation
from flexgen.identification.poses.tree import SHIFTS, Tree, rotations
from flexgen.model.elements import Dof, Element, Placement, RobotModel
from flexgen.model.format.format_devices import SENSOR
from flexgen.model.reader import read

VARIANT = "calibrated"
_WITH_POSITION = ("accelerometer", "tracker", "wrench")  # kinds of sensors at a point


def changes_of(
    model: RobotModel, numbers: Numbers, frame: np.ndarray | None = None
) -> dict[str, Any]:
    """Dotted keys of the model file and their values; only those that differ from the model.

    ``frame``: pose (6,) of the world in the frame of the measurement, which then becomes the
    world.

    Raises
    ------
    ArgumentError
        The zero of a translation behind other axes of one element changed: no key of a model file
        has it.
    """
    tree = Tree(model)
    out: dict[str, Any] = {}
    for element in model.elements:
        origin, link, axes = _placements(tree, element, numbers)
        out |= {
            f"element.{element.name}.dof.{name}.axis": _numbers(axis)
            for name, axis in axes.items()
        }
        for key, new, old in (("origin", origin, element.origin), ("link", link, element.link)):
            if new is not old:
                out[f"element.{element.name}.{key}"] = _pose(new)
        for dof in element.dofs:
            out |= _springs(tree, element, dof, numbers)
    for k, (name, _, body) in enumerate(tree.bodies):
        table = "payload" if name == "payload" else f"element.{name}.body"
        if numbers.masses[k] != body.mass:
            out[f"{table}.mass"] = _number(numbers.masses[k])
        if (numbers.centers[k] != body.com).any():
            out[f"{table}.com"] = _numbers(numbers.centers[k])
    out |= _trackers(model, numbers)
    if frame is not None:
        R = frame_rotation(frame)
        base = _placement(frame[:3] + R @ model.base.position, R @ np.array(model.base.rotation))
        out["base"] = _pose(base)
        out["gravity"] = _numbers(R @ model.gravity)
    return out


def _trackers(model: RobotModel, numbers: Numbers) -> dict[str, Any]:
    """Positions of the trackers that moved, or of the tool where a tracker is its origin; all
    sensors where those of the model file are others.

    Trackers may be given as overrides of `flexgen.read`: the file has no table whose position
    could be set. Where the tool moves, other sensors on it stay where they are, and so does the
    payload, whose center is at the tool by default.
    """
    positions = {s.name: np.array(s.position) for s in model.sensors if s.type in _WITH_POSITION}
    of_tool = np.zeros(3)
    for sensor, position in zip(trackers_of(model), numbers.trackers, strict=True):
        if sensor.is_tool:
            of_tool = position
        else:
            positions[sensor.name] = position
    out: dict[str, Any] = {}
    if of_tool.any():
        tool = _compose(model.tool, _placement(of_tool, np.eye(3)))
        out["tool.position"] = _numbers(tool.position)
        if model.payload.mass:
            names = [name for name, _, _ in Tree(model).bodies]
            out["payload.com"] = _numbers(numbers.centers[names.index("payload")])
        for sensor in model.sensors:
            if sensor.place == TOOL and sensor.name in positions and not sensor.is_tool:
                positions[sensor.name] = positions[sensor.name] - of_tool
    moved = {
        sensor.name: _numbers(positions[sensor.name])
        for sensor in model.sensors
        if sensor.name in positions and (positions[sensor.name] != sensor.position).any()
    }
    if _sensors_of_file(model) == model.sensors:
        return out | {f"sensor.{name}.position": position for name, position in moved.items()}
    tables = []
    for sensor in model.sensors:
        table = write(SENSOR, sensor)
        if sensor.name in moved:
            table["position"] = moved[sensor.name]
        tables.append(table)
    return out | {"sensor": tables}


def _sensors_of_file(model: RobotModel) -> tuple[Sensor, ...]:
    """The sensors that the model file states; those of the model where no file can be read."""
    try:
        return read(model.file, model.variant or None).sensors
    except FlexgenError:
        return model.sensors


def _placements(
    tree: Tree, element: Element, numbers: Numbers
) -> tuple[Placement, Placement, dict[str, np.ndarray]]:
    """``origin`` and ``link`` with the shifts of the element's place and the zeros of its axes;
    axes that they turn.

    A mechanism turns with the zeros of the coordinates that it names.
    ``exp(z a) exp(d b) = exp(d b') exp(z a)`` with ``b' = exp(z a) b``: a zero between two axes
    turns the later ones, and ``link``.
    """
    origin = element.origin
    shifts = numbers.shifts
    moved = shifts[[tree.index[f"{element.name}.{s}"] for s in SHIFTS]]
    if moved.any():
        origin = _compose(origin, _placement(moved[:3], frame_rotation(moved)))
    turned = np.eye(3)
    axes = {}
    for k, dof in enumerate(element.dofs):
        index = tree.index[dof.name]
        axis = np.array(dof.axis)
        zero = shifts[index] + sum(
            numbers.factors[index, tree.index[on]] * shifts[tree.index[on]] for on, _ in dof.mimic
        )
        if (turned != np.eye(3)).any():
            axes[dof.name] = turned @ axis
        if zero == 0.0:
            continue
        turn = rotations(axis, np.array([zero]))[0]
        if k == 0:
            along = dof.type == "translation"
            origin = _compose(
                origin,
                _placement(zero * axis, np.eye(3)) if along else _placement(np.zeros(3), turn),
            )
        elif dof.type == "rotation":
            turned = turned @ turn
        else:
            raise ArgumentError(
                f"element {element.name}: given the zero of the translation {dof.name} behind "
                "other axes, expected the first axis of its element"
            )
    link = (
        element.link
        if (turned == np.eye(3)).all()
        else _compose(_placement(np.zeros(3), turned), element.link)
    )
    return origin, link, axes


def _placement(position: np.ndarray, rotation: np.ndarray) -> Placement:
    """Placement from the arrays ``position`` (3,) [m] and ``rotation`` (3, 3)."""
    return Placement(tuple(position), tuple(map(tuple, rotation)))


def _springs(tree: Tree, element: Element, dof: Dof, numbers: Numbers) -> dict[str, Any]:
    """Stiffness of an elastic coordinate, or the factors of a mechanism, where they changed."""
    place = f"element.{element.name}.dof.{dof.name}"
    if dof.mimic:
        new = {
            on: _number(numbers.factors[tree.index[dof.name], tree.index[on]])
            for on, _ in dof.mimic
        }
        return {} if new == dict(dof.mimic) else {f"{place}.mimic": new}
    if dof.name not in tree.elastic:
        return {}
    old = tree.elastic[dof.name]
    new_value = numbers.compliances[list(tree.elastic).index(dof.name)]
    if new_value == old:
        return {}
    spring = dof.gear.spring if dof.gear is not None else dof.spring
    # on the side of the gear to which the key refers
    stiffness = vars(spring)["stiffness"] * old / new_value
    return {
        f"{place}.{'gear.' if dof.gear is not None else ''}spring.stiffness": _number(stiffness)
    }


def _pose(placement: Placement) -> dict[str, Any]:
    rotation = [x for row in placement.rotation for x in row]
    return {"position": _numbers(placement.position), "rotation": _numbers(rotation)}


def _compose(first: Placement, second: Placement) -> Placement:
    """Composition ``T_1 T_2`` of two placements: position ``p_1 + R_1 p_2`` [m], rotation
    ``R_1 R_2``.

    ``first`` is the pose of a frame B in a frame A, ``second`` that of a frame C in B; the result
    is the pose of C in A.
    """
    R = np.array(first.rotation)
    position = np.array(first.position) + R @ second.position
    return _placement(position, R @ np.array(second.rotation))


def _number(x: float) -> float:
    """A number as the file has it: without rounding errors of 1e-18, which no file may have."""
    return 0.0 if abs(x) < 1e-15 else float(x)


def _numbers(values: Iterable[float]) -> list[float]:
    return [_number(x) for x in values]
