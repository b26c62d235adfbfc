"""The verb kinematics: numbers of two public functions, as JSON and as a table."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.cli.main import main

pytestmark = needs_compiler

POSITION = [0.5, 0.6, 1.2]


def answer(capsys: Any, *words: object, status: int = 0) -> Any:
    assert main(["kinematics", *map(str, words), "-q", "--json"]) == status
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("more", [(), ("--rotation", 0, 0, 0.5), ("--sag",)])
def test_configurations_are_those_of_the_function(more: Any, capsys: Any) -> None:
    """A rotation vector turns the tool from the axes of the world."""
    data = answer(capsys, "manutec_r3", "--position", *POSITION, *more)
    R = Rotation.from_rotvec([0.0, 0.0, 0.5 * ("--rotation" in more)]).as_matrix()
    found = flexgen.kinematics("manutec_r3", np.array(POSITION), R, sag="--sag" in more)
    assert data["model"] == "manutec_r3" and len(data["configurations"]) == len(found) > 1
    for told, one in zip(data["configurations"], found, strict=True):
        assert_allclose(told["q"], one.q)
        assert told["within_limits"] == one.within_limits


def test_the_table_has_a_row_for_each_configuration(capsys: Any) -> None:
    key = "element.body6.dof.q6"
    limits: dict[str, Any] = {f"{key}.lower_deg": -30.0, f"{key}.upper_deg": 90.0}
    words = [x for name, limit in limits.items() for x in ("--set", f"{name}={limit}")]
    given = ["manutec_r3", "--position", *map(str, POSITION), *words]
    assert main(["kinematics", *given, "-q"]) == 0
    lines = capsys.readouterr().out.splitlines()
    model = flexgen.read("manutec_r3", overrides=limits)
    found = flexgen.kinematics(model, np.array(POSITION), np.eye(3))
    assert lines[0].startswith(f"manutec_r3: {len(found)} configurations at ")
    for line, one in zip(lines[-len(found) :], found, strict=True):
        cells = line.split()
        assert_allclose([float(x) for x in cells[:6]], one.q, rtol=1e-3, atol=1e-3)
        assert cells[6] == ("yes" if one.within_limits else "no")
        assert cells[7:10] == [f"{flag:+d}" for flag in one.flags]
        assert float(cells[10]) == pytest.approx(one.distance, rel=1e-2)
        assert cells[11] == one.nearest_singularity


def test_a_command_gives_the_tool_and_its_sag(capsys: Any) -> None:
    """Positions in meters, the difference from a stiff robot in millimeters in the table."""
    q = np.array([[0.5, 0.25]])
    sagging, stiff = (flexgen.tracker_positions("elbow", q, sag=x)[0] for x in (True, False))
    data = answer(capsys, "elbow", "--command", 0.5, 0.25)
    assert data["command"] == [0.5, 0.25] and data["names"] == ["tool"]
    assert_allclose(data["position_m"], sagging, rtol=1e-12)
    assert_allclose(data["sag_m"], sagging - stiff, atol=1e-12)
    assert main(["kinematics", "elbow", "--command", "0.5", "0.25", "-q"]) == 0
    name, *cells = capsys.readouterr().out.splitlines()[-1].split()
    assert name == "tool"
    expected = [*sagging[0], *(1e3 * (sagging - stiff)[0])]
    assert_allclose([float(x) for x in cells], expected, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "kinematics: expected either --joints or --position (and --rotation)"),
        (
            ("--joints", *[0.1] * 6, "--position", *POSITION),
            "kinematics: expected either --joints or --position (and --rotation)",
        ),
        (
            ("--joints", *[0.1] * 6, "--rotation", 0, 0, 1),
            "--joints: given with --rotation, expected without",
        ),
        (("--command", *[0.1] * 6, "--sag"), "--command: given with --sag, expected without"),
        (("--position", 9, 9, 9), "the pose cannot be reached: "),
    ],
)
def test_poses_that_are_refused(words: Any, text: str, capsys: Any) -> None:
    assert main(["kinematics", "manutec_r3", *map(str, words), "-q"]) == 1
    assert text in capsys.readouterr().err
