"""Tables of an overlay of a URDF file: sensors, outputs, and what it has no key for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.spec.sensors import TOOL, Sensor
from flexgen.exports.urdf.overlay_tables import beam_or_drag, output_table, sensor_table
from flexgen.model.elements import Output, RobotModel


@pytest.mark.parametrize(
    ("place", "position"),
    [("upper", (1.1, 2.2, 2.7)), ("fore", (1.0, 2.0, 3.0)), (TOOL, (1.0, 2.0, 3.0))],
)
def test_sensors_lie_in_the_frames_of_links(place: str, position: tuple[float, ...]) -> None:
    """Those of an element are shifted as its body frame is, that of the tool is not."""
    sensor = Sensor(
        name="acc",
        type="accelerometer",
        place=place,
        position=(1.0, 2.0, 3.0),
        axes=((1.0, 0.0, 0.0),),
        labels=("x",),
        noise=0.1,
        sample_s=None,
        delay_s=0.0,
        unit="m/s^2",
    )
    shifts = {"upper": np.array([0.1, 0.2, -0.3]), TOOL: np.array([9.0, 9.0, 9.0])}
    table = sensor_table(sensor, shifts)
    assert_allclose(table["position"], position)
    assert (table["name"], table["type"]) == ("acc", "accelerometer")


def test_outputs_name_their_coordinates() -> None:
    """Weighted sums without the coordinates that have no weight."""
    elbow = flexgen.read("elbow")
    assert output_table(elbow) == {"type": "tool_position", "axes": "xz"}
    weights = ((0.5, 0.0), (1.0, -2.0))
    sums = replace(elbow, output=Output("combination", weights=weights, unit="rad"))
    rows = [{"q1": 0.5}, {"q1": 1.0, "q2": -2.0}]
    assert output_table(sums) == {"type": "combination", "unit": "rad", "rows": rows}


def dragged(part: str) -> RobotModel:
    """The elbow with a drag of a body or of its payload, or a robot with a beam."""
    elbow = flexgen.read("elbow")
    first, second = elbow.elements
    if part == "body":
        body = replace(second.body, rotational_drag=0.1)
        return replace(elbow, elements=(first, replace(second, body=body)))
    if part == "payload":
        return replace(elbow, payload=replace(elbow.payload, rotational_drag=0.1))
    return flexgen.read("beam_arm")


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("body", "element.fore.body.rotational_drag: given a rotational_drag, expected"),
        ("payload", "payload.rotational_drag: given a drag"),
        ("beam", "beam: given a beam, expected for URDF an element without it"),
    ],
)
def test_parts_without_a_key_are_refused(part: str, message: str) -> None:
    beam_or_drag(flexgen.read("elbow"))
    with pytest.raises(ModelError) as refused:
        beam_or_drag(dragged(part))
    assert message in str(refused.value)
