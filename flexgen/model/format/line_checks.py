"""Checks of the lines of a robot at its home position, by the numeric poses of its bodies."""

from __future__ import annotations

import numpy as np

from flexgen.base.spec.lines import Line, RodLine
from flexgen.base.spec.tables import Table
from flexgen.model.elements import Placement, RobotModel
from flexgen.model.format.closure import closed_values

# Length [m] below which the two ends of a line are one point, and the line has no direction.
NO_LENGTH = 1e-6
# Part of its length by which a rod may be stretched at home; metals yield far below.
STRETCH_MAX = 0.05

Pose = tuple[np.ndarray, np.ndarray]  # position (3,) [m] and rotation matrix (3, 3) in the world


def body_poses(model: RobotModel, q_a: np.ndarray) -> dict[str, Pose]:
    """Poses of the bodies by the names of their elements, and that of the base by ``"base"``, at
    the coordinates ``q_a`` (n_a,); beams are straight.
    """
    at = closed_values(model, q_a)
    base = _advance((np.zeros(3), np.eye(3)), model.base)
    bodies = {"base": base}
    tips = {"base": base}
    for element in model.elements:
        p, R = _advance(tips[model.parents[element.name]], element.origin)
        for dof in element.dofs:
            moved = dict(dof.mimic) or {dof.name: 1.0}
            value = sum(factor * at[name] for name, factor in moved.items())
            axis = np.array(dof.axis)
            if dof.type == "rotation":
                hat = np.cross(np.eye(3), axis)
                R = R @ (np.eye(3) + np.sin(value) * hat + (1.0 - np.cos(value)) * hat @ hat)
            else:
                p = p + value * (R @ axis)
        bodies[element.name] = _advance((p, R), element.link)
        reach = 0.0 if element.beam is None else element.beam.length
        tips[element.name] = _advance(bodies[element.name], Placement((reach, 0.0, 0.0)))
    return bodies


def _advance(pose: Pose, placement: Placement) -> Pose:
    """The pose of a frame at a constant placement."""
    p, R = pose
    return p + R @ np.array(placement.position), R @ np.array(placement.rotation)


def line_lengths(model: RobotModel, q_a: np.ndarray) -> list[float]:
    """Distances [m] of the two ends of each line at the coordinates ``q_a`` (n_a,)."""
    poses = body_poses(model, q_a)
    lengths = []
    for line in model.lines:
        first, second = (
            poses[end.element][0] + poses[end.element][1] @ np.array(end.position)
            for end in (line.start, line.end)
        )
        lengths.append(float(np.linalg.norm(second - first)))
    return lengths


def check_lines(root: Table, model: RobotModel) -> None:
    """Raise an error for a line that cannot be as it is at home, with its number.

    Its ends coincide, it is outside its stroke or its limits, or a rod is far from its length.
    """
    home = np.zeros(model.n_a)
    home[list(model.i_g)] = model.home
    tables = root.tables("line")
    for table, line, length in zip(tables, model.lines, line_lengths(model, home), strict=True):
        _check_line(table, line, length)


def _check_line(table: Table, line: Line, length: float) -> None:
    """Raise the error of a line with this length [m] at home."""
    given = f"ends that are {length:.6g} m apart at the home position"
    if length < NO_LENGTH:
        raise table.fail("to", "two points that are apart: the line has no direction", given)
    low, high = line.range
    if not low <= length <= high:
        raise table.fail("to", f"a distance from {low:.6g} to {high:.6g} m", given)
    if isinstance(line, RodLine) and line.stiffness > 0.0:
        stretch = length / line.length - 1.0
        if abs(stretch) > STRETCH_MAX:
            raise table.fail(
                "length",
                f"the length of a rod within {100 * STRETCH_MAX:g} % of this distance",
                f"{line.length:.6g} m, with {given}: a stretch of {100 * stretch:.3g} %",
            )
