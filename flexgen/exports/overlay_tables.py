"""Data classes of a robot as tables of a model file, and their text in TOML."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from flexgen.errors import ModelError
from flexgen.exports.xml_text import numbers
from flexgen.model.elements import (
    IDENTITY,
    ZERO,
    BacklashSpring,
    CubicSpring,
    Dof,
    Friction,
    LinearSpring,
    Motor,
    PiecewiseSpring,
    Placement,
    RobotModel,
    SmoothSpring,
    Spring,
)
from flexgen.model.friction_laws import law_name
from flexgen.model.sensors import TOOL, UNITS, Sensor

_SPRINGS: dict[type, str] = {
    LinearSpring: "linear",
    CubicSpring: "cubic",
    SmoothSpring: "smooth",
    PiecewiseSpring: "piecewise",
    BacklashSpring: "backlash",
}


def toml(value: Any) -> str:
    """A value in TOML, tables and lists in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return numbers(value)


def beam_or_drag(model: RobotModel) -> None:
    """Refuse what an overlay has no key for."""
    for element in model.elements:
        for key, there in (("beam", element.beam is not None), ("body.rotational_drag", element.body.rotational_drag)):
            if there:
                given, expected = f"a {key.rpartition('.')[2]}", "for URDF an element without it"
                raise ModelError(model.file, 0, f"element.{element.name}.{key}", given, expected)
    if model.payload.rotational_drag:
        raise ModelError(model.file, 0, "payload.rotational_drag", "a drag", "for URDF a payload without it")


def pose_table(place: Placement) -> dict[str, Any]:
    """A placement; empty for the identity."""
    out: dict[str, Any] = {}
    if place.position != ZERO:
        out["position"] = place.position
    if place.rotation != IDENTITY:
        out["rotation"] = [x for row in place.rotation for x in row]
    return out


def spring_table(spring: Spring) -> dict[str, Any]:
    """A spring."""
    return {"type": _SPRINGS[type(spring)], **dataclasses.asdict(spring)}


def friction_table(friction: Friction) -> dict[str, Any]:
    """A friction; empty for none."""
    kind = law_name(friction)
    values = {key: value for key, value in dataclasses.asdict(friction).items() if value}
    return {"type": kind, **values} if values else {}


def dof_table(dof: Dof) -> dict[str, Any]:
    """A degree of freedom."""
    out: dict[str, Any] = {"name": dof.name, "type": dof.type, "axis": dof.axis}
    if dof.gear is not None and dof.gear.spring is not None:
        spring = spring_table(dof.gear.spring)
        out["gear"] = {"type": "elastic", "side": dof.gear.side, "spring": spring, "damping": dof.gear.damping}
    elif dof.gear is not None:
        out["gear"] = {"type": "rigid"}
    if dof.spring is not None:
        out["spring"] = spring_table(dof.spring)
        out["damping"] = dof.damping
    if friction := friction_table(dof.friction):
        out["friction"] = friction
    if dof.counterbalance:
        out["counterbalance"] = {key: [pair[k] for pair in dof.counterbalance] for k, key in enumerate(("sin", "cos"))}
    unit = "_rad" if dof.type == "rotation" else ""
    ends = {f"lower{unit}": dof.lower, f"upper{unit}": dof.upper}
    ends |= {"speed_max": dof.speed_max, "acceleration_max": dof.acceleration_max}
    return out | {key: value for key, value in ends.items() if value is not None}


def motor_table(motor: Motor) -> dict[str, Any]:
    """A motor."""
    out: dict[str, Any] = {"name": motor.name, "drives": motor.drives, "ratio": motor.ratio, "inertia": motor.inertia}
    if friction := friction_table(motor.friction):
        out["friction"] = friction
    for key in ("axis", "carrier", "torque_max", "speed_max"):
        if getattr(motor, key) is not None:
            out[key] = getattr(motor, key)
    return out


def output_table(model: RobotModel) -> dict[str, Any]:
    """The output; weighted sums by name of the coordinate."""
    output = model.output
    if output.type != "combination":
        return {"type": output.type, **({"axes": output.axes} if output.type == "tool_position" else {})}
    names = [coordinate.name for coordinate in model.coordinates]
    rows = [{name: x for name, x in zip(names, row, strict=True) if x} for row in output.weights]
    return {"type": "combination", "unit": output.unit, "rows": rows}


def sensor_table(sensor: Sensor, shifts: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A sensor; ``shifts``: position of the body frame of each element in the frame of its link."""
    out: dict[str, Any] = {"name": sensor.name, "type": sensor.type}
    if sensor.type == "link_encoder":
        out["coordinate"] = sensor.place
    else:
        out["axes"] = [
            label if label in "xyz" else axis for label, axis in zip(sensor.labels, sensor.axes, strict=True)
        ]
        if sensor.type != "tracker":
            out["element"] = sensor.place
        if sensor.type != "gyro":
            shift = shifts.get(sensor.place, np.zeros(3)) if sensor.place != TOOL else np.zeros(3)
            out["position"] = np.array(sensor.position) + shift
    unit = next(si for si, one in UNITS[sensor.type].items() if one == 1.0 and si == sensor.unit)
    out |= {"unit": unit, "noise": sensor.noise, "delay_s": sensor.delay_s}
    return out | ({} if sensor.sample_s is None else {"sample_s": sensor.sample_s})
