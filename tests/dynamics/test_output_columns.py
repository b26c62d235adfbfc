"""Columns of the output: angles between rotations, units and labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.dynamics.mechanics.output_columns import (
    columns_in,
    output_labels,
    output_units,
    turn_angle,
    unit_of,
)
from flexgen.model.elements import (
    Beam,
    Bending,
    Body,
    Dof,
    Element,
    Output,
    Placement,
    coordinates_of,
)

SCARA = Path(__file__).parents[1] / "support" / "robots" / "tilted_scara.toml"


def test_angles_between_rotations_from_tiny_to_half_a_turn() -> None:
    angles = np.array([1e-9, 0.4, 2.0, np.pi - 1e-7])
    axis = np.array([[1, 2, 3], [3, -1, 2], [0, 0, 1], [1, 1, 0]]) / np.sqrt(
        [[14], [14], [1], [2]]
    )
    start = Rotation.from_rotvec([[0.3, 1.1, -0.4]] * 4).as_matrix()
    R = Rotation.from_rotvec(axis * angles[:, None]).as_matrix() @ start
    assert_allclose(turn_angle(R, start), angles, rtol=1e-6)


def with_output(**changes: Any) -> Any:
    """A SCARA, with turns and a slide."""
    model = flexgen.read(SCARA)
    weights = changes.pop("rows", ())
    output = Output(**changes, weights=tuple(map(tuple, weights)))
    return replace(model, output=output)


def sums(*chosen: tuple[int, float], size: int) -> list[list[float]]:
    """Rows of weights: one large weight each, and a small one of coordinate 0."""
    rows = np.zeros((len(chosen), size))
    rows[:, 0] = 0.1
    for row, (k, weight) in zip(rows, chosen, strict=True):
        row[k] = weight
    return rows.tolist()


def test_sums_have_the_units_of_their_largest_coordinates() -> None:
    model = flexgen.read(SCARA)
    units = [c.unit for c in model.coordinates]
    slide = units.index("m")
    turn = units.index("rad")
    rows = sums((turn, -3.0), (slide, 2.0), size=len(units))
    mixed = with_output(type="combination", axes="", unit="mixed", rows=rows)
    assert output_units(mixed) == ("rad", "m") and unit_of(mixed) == "m"
    assert columns_in(mixed, "rad") == [0] and columns_in(mixed, "m") == [1]
    assert output_labels(mixed) == {"y_ref": ("y1", "y2")}
    angles = with_output(type="combination", axes="", unit="rad", rows=rows)
    assert output_units(angles) == ("rad", "rad") and columns_in(angles, "m") == []


@pytest.mark.parametrize(
    ("kind", "axes", "more", "units", "labels"),
    [
        ("tool_pose", "xyz", {}, ("m",) * 3, ("x", "y", "z")),
        ("tool_position", "xz", {}, ("m",) * 2, ("x", "z")),
        (
            "tool_position_angle",
            "xz",
            {"rotation_axis": (0.0, 1.0, 0.0)},
            ("m", "m", "rad"),
            ("x", "z", "angle"),
        ),
    ],
)
def test_outputs_of_a_tool_have_lengths_and_an_angle(
    kind: str, axes: str, more: Any, units: Any, labels: Any
) -> None:
    model = with_output(type=kind, axes=axes, **more)
    assert output_units(model) == units and output_labels(model)["y_ref"] == labels
    if kind == "tool_pose":
        pose = output_labels(model)["R_ref"]
        assert pose[:4] == ("xx", "xy", "xz", "yx") and len(pose) == 9


def test_coordinates_of_a_chain_have_names_units_and_modes() -> None:
    """Joints first, then the shapes of a beam about each axis; none of these has a motor."""
    beam = Beam(1.0, 2.0, (Bending("y", 3.0, 2, 0.0), Bending("z", 3.0, 1, 0.0)))
    dofs = (Dof("q", "rotation", (0.0, 0.0, 1.0)), Dof("s", "translation", (0.0, 0.0, 1.0)))
    found = coordinates_of([Element("arm", dofs, Placement(), Placement(), Body(), beam=beam)])
    units = {"q": "rad", "s": "m", "arm_y1": "m", "arm_y2": "m", "arm_z1": "m"}
    assert {c.name: c.unit for c in found} == units and not any(c.actuated for c in found)
