"""Batches of points as JAX and PyTorch have them: axes before those of one point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from emitted import loaded
from toolchain import needs_compiler

from flexgen.backends.autodiff import points
from flexgen.backends.autodiff.points import Functions, Points, lead_of
from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.spec.ports import Port

PORTS = [Port("q", (2,), "rad", "angles"), Port("R", (3, 3), "1", "rotation")]


@pytest.mark.parametrize(
    ("shapes", "lead"),
    [
        (((2,), (3, 3)), ()),
        (((5, 2), (3, 3)), (5,)),
        (((2,), (4, 5, 3, 3)), (4, 5)),
        (((4, 5, 2), (4, 5, 3, 3)), (4, 5)),
        (((0, 2), (3, 3)), (0,)),
        (((3,), (3, 3)), r"q: given shape \(3,\), expected \(2,\) or \(\.\.\., 2\)$"),
        (((), (3, 3)), r"q: given shape \(\), expected \(2,\) or"),
        (((5, 2), (4, 3, 3)), r"R: given shape \(4, 3, 3\), expected \(3, 3\) or \(5, 3, 3\)$"),
        (((5, 2), (3,)), r"R: given shape \(3,\), expected"),
    ],
)
def test_axes_of_a_batch_are_before_those_of_a_point(shapes: Any, lead: Any) -> None:
    if isinstance(lead, tuple):
        assert lead_of("f", PORTS, shapes) == lead
        return
    with pytest.raises(ArgumentError, match=f"^f, {lead}"):
        lead_of("f", PORTS, shapes)


@needs_compiler
def test_points_of_a_library() -> None:
    """Equal where the libraries are; several results have names."""
    robot = loaded("elbow")
    made = Points(robot)
    assert made == Points(loaded("elbow")) and hash(made) == hash(Points(loaded("elbow")))
    assert made != Points(loaded("planar5_nmp")) and made != robot
    keys = {made.key(name) for name in robot.functions}
    assert len(keys) == len(robot.functions) and 0 not in keys and min(keys) < 0 < max(keys)
    p = np.zeros(3)
    assert made.results("gravity", [p]) is p
    pose = made.results("forward_kinematics", [p, np.eye(3)])
    assert pose.p is p and pose._fields == ("p", "R")
    entry = made.entries["forward_kinematics"]
    ports = [(x.rank, x.rows, x.columns, x.shared) for x in entry.ports[:3]]
    assert ports == [(1, 2, 1, 0), (1, 3, 1, 0), (2, 3, 3, 0)]
    assert (entry.inputs, entry.outputs, entry.bytes) == (1, 2, 8)
    functions = Functions(made, {"gravity": len})
    assert repr(functions) == "<Functions of elbow: gravity>" and functions.gravity is len
    assert "gravity" in dir(functions)
    with pytest.raises(AttributeError, match="given 'mass', expected one of the library's func"):
        _ = functions.mass


@needs_compiler
def test_functions_of_more_arrays_than_c_takes_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(points, "MOST_PORTS", 2)
    with pytest.raises(BuildError, match="forward_kinematics: given 3 arrays, expected at most 2"):
        Points(loaded("elbow"))
