"""Data classes of a robot as tables of a model file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from flexgen.base.errors import ModelError
from flexgen.base.spec.lines import Anchor, Line
from flexgen.base.spec.schema import write
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.model.elements import RobotModel
from flexgen.model.format.format_devices import SENSOR
from flexgen.model.format.format_lines import LINE
from flexgen.model.format.format_tasks import OUTPUT


def beam_or_drag(model: RobotModel) -> None:
    """Refuse what an overlay has no key for."""
    for element in model.elements:
        for key, there in (
            ("beam", element.beam is not None),
            ("body.rotational_drag", element.body.rotational_drag),
        ):
            if there:
                given = f"a {key.rpartition('.')[2]}"
                expected = "for URDF an element without it"
                raise ModelError(model.file, 0, f"element.{element.name}.{key}", given, expected)
    if model.payload.rotational_drag:
        raise ModelError(
            model.file, 0, "payload.rotational_drag", "a drag", "for URDF a payload without it"
        )


def output_table(model: RobotModel) -> dict[str, Any]:
    """The output; weighted sums by name of the coordinate."""
    output = model.output
    names = [coordinate.name for coordinate in model.coordinates]
    if output.type != "combination":
        joints = [names[row.index(1.0)] for row in output.weights]
        return write(OUTPUT, output.of_tool) | ({"joints": joints} if joints else {})
    rows = [{name: x for name, x in zip(names, row, strict=True) if x} for row in output.weights]
    return {"type": "combination", "unit": output.unit, "rows": rows}


def sensor_table(sensor: Sensor, shifts: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A sensor; ``shifts``: position of the body frame of each element in the frame of its
    link.
    """
    position = np.array(sensor.position) + (
        shifts.get(sensor.place, np.zeros(3)) if sensor.place != TOOL else 0.0
    )
    return write(SENSOR, replace(sensor, position=tuple(position.tolist())))


def line_table(line: Line, shifts: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A line; ``shifts``: position of the body frame of each element in the frame of its link."""

    def in_link(anchor: Anchor) -> Anchor:
        """An end in the frame of its link."""
        position = np.array(anchor.position) + shifts.get(anchor.element, np.zeros(3))
        return replace(anchor, position=tuple(position.tolist()))

    return write(LINE, replace(line, start=in_link(line.start), end=in_link(line.end)))
