"""Digest of a model: equal for equal data, whatever file they came from."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

from flexgen.model.elements import RobotModel


def model_digest(model: RobotModel) -> str:
    """SHA-256 of the data of a model: its canonical text and every field, but not the path of its
    file.

    The fields too, because ``dataclasses.replace`` changes them and keeps the text.
    """
    # digests from before there were sensors stay
    without = ("file",) if model.sensors else ("file", "sensors")
    return hashlib.sha256(_canonical(model, without=without).encode()).hexdigest()


NEWER = (
    "target",
    "configuration",
    "Move.carrier",
    "Program.carrier",
    "JointMotion.carrier",
    "Move.frame",
    "Program.frame",
    "JointMotion.frame",
    "Move.fixed_tool",
    "Program.fixed_tool",
    "JointMotion.fixed_tool",
    "WorkFrame.element",
    "turns",
    "counterbalance",
    "hysteresis",
    "Hysteresis.exponent",
    "Hysteresis.gamma",
    "transmission_error",
    "cogging",
    "torque_ripple",
    "encoder_error",
    "not_measured",
    "Beam.torsion",
    "Beam.stretch",
    "Beam.tip",
    "Beam.axial_load",
    "lugre",
    "Gear.torque_max",
    "torque_rms_max",
    "torque_rate_max",
    "thermal_time",
    "torque_speed",
    "deflection_max",
    "Tool.speed_max",
    "Tool.acceleration_max",
    "Program.laws",
    "RobotModel.servo",
    "RobotModel.temperature",
    "RobotModel.lines",
    "RobotModel.loops",
    "Dof.passive",
    "Sensor.moment_noise",
    "Sensor.gauge",
    "Sensor.offset",
    "Tolerances.lost_motion",
    "Tolerances.delay",
    "posture",
    "Tolerances.misfit",
)  # left out where empty or of the default: digests from before there were these fields stay


def _canonical(value: Any, without: tuple[str, ...] = ()) -> str:
    """Text that determines the data: names and values of fields, exact numbers; independent of
    ``__repr__``.

    ``without``: fields left out at this level. A field in `NEWER` is left out where it has its
    default, so that older digests stay valid.
    """
    if is_dataclass(value):
        kind = type(value).__name__
        newer = {f.name for f in fields(value) if f.name in NEWER or f"{kind}.{f.name}" in NEWER}
        inner = (
            f"{f.name}={_canonical(getattr(value, f.name))}"
            for f in fields(value)
            if f.compare
            and f.name not in without
            and not (f.name in newer and getattr(value, f.name) in (None, (), f.default))
        )
        return f"{kind}({', '.join(inner)})"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_canonical, value))}]"
    if isinstance(value, dict):
        return (
            f"{{{', '.join(f'{_canonical(key)}: {_canonical(x)}' for key, x in value.items())}}}"
        )
    return repr(value)
