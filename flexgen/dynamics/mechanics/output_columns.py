"""Columns of the output of a robot in trajectories: labels, units, the angle between two
orientations.
"""

from __future__ import annotations

import numpy as np

from flexgen.model.elements import RobotModel


def output_labels(model: RobotModel) -> dict[str, tuple[str, ...]]:
    """Labels of the columns of the reference: ``y_ref`` and, for a pose, ``R_ref`` (rows of the
    matrix).
    """
    output = model.output
    if output.type == "combination":
        return {"y_ref": tuple(f"y{k + 1}" for k in range(output.size))}
    sums = (f"y{output.tool_size + k + 1}" for k in range(len(output.weights)))
    labels = {"y_ref": (*output.axes, *["angle"] * output.has_angle, *sums)}
    if output.is_pose:
        labels["R_ref"] = tuple(f"{r}{c}" for r in "xyz" for c in "xyz")
    return labels


def output_units(model: RobotModel) -> tuple[str, ...]:
    """Unit of each row of the output y, without the orientation of a pose: "m" or "rad"."""
    output = model.output
    if output.type != "combination":
        tool = ("m",) * len(output.axes) + ("rad",) * output.has_angle
        return (*tool, *_units_of_sums(model))
    if output.unit != "mixed":
        return (output.unit,) * output.size
    return _units_of_sums(model)


def _units_of_sums(model: RobotModel) -> tuple[str, ...]:
    """Unit of each weighted sum: that of its largest coordinate; of different units are joints."""
    return tuple(
        model.coordinates[int(np.argmax(np.abs(row)))].unit for row in model.output.weights
    )


def unit_of(model: RobotModel) -> str:
    """The unit of the errors of an output: ``"m"``, or ``"rad"`` where it has no lengths."""
    return "m" if "m" in output_units(model) else "rad"


def columns_in(model: RobotModel, unit: str) -> list[int]:
    """Columns of the output with this unit."""
    return [k for k, own in enumerate(output_units(model)) if own == unit]


def turn_angle(R: np.ndarray, R_ref: np.ndarray) -> np.ndarray:
    """Angle (n,) [rad] between two orientations (n, 3, 3), accurate for small angles too."""
    E = R @ R_ref.transpose(0, 2, 1)
    axial = np.stack(
        [E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1
    )
    return np.arctan2(np.linalg.norm(axial, axis=1) / 2, (np.trace(E, axis1=1, axis2=2) - 1) / 2)


def channel_units(model: RobotModel) -> dict[str, dict[str, str]]:
    """SI units of the columns of the channels of a trajectory: name -> label -> unit."""
    joints = {c.name: c.unit for c in model.coordinates}
    motors = [motor.name for motor in model.motors]
    out = {"tau_m": dict.fromkeys(motors, "N m")}
    for letter, rate in (("q", ""), ("v", "/s"), ("a", "/s^2")):
        out[f"{letter}_a"] = {name: f"{unit}{rate}" for name, unit in joints.items()}
        out[f"{letter}_m"] = dict.fromkeys(motors, f"rad{rate}")
    out["y_ref"] = dict(zip(output_labels(model)["y_ref"], output_units(model), strict=True))
    return out
