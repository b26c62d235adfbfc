"""A tracker that is the tool: calibration moves the tool frame to where it was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.identification.poses import result

NEST: dict[str, Any] = {"name": "nest", "type": "tracker", "unit": "m", "is_tool": True}
SENSORS = [
    NEST,
    {"name": "side", "type": "tracker", "unit": "m", "position": [0.1, 0.0, 0.0]},
    {"name": "felt", "type": "accelerometer", "unit": "m/s^2", "element": "tool"},
]
TOOL = np.array([0.04, -0.03, 0.02])  # m, of the simulated robot, in the frame of the tool


def written(folder: Path, payload: dict[str, Any]) -> tuple[flexgen.RobotModel, np.ndarray, Any]:
    """The calibrated file, commands, and the simulated robot with its tool elsewhere."""
    over = {"sensor": SENSORS, **payload}
    robot = flexgen.read("manutec_r3_18", overrides=over)
    seen_at = [
        {"name": "nest", "type": "tracker", "unit": "m", "position": TOOL.tolist()},
        SENSORS[1],
    ]
    softer = {"element.body3.dof.t3z.spring.stiffness": 6e4}
    there = flexgen.read(robot.file, overrides={**over, "sensor": seen_at, **softer})
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (60, 6))
    seen = flexgen.tracker_positions(there, q)
    found = flexgen.calibrate(robot, flexgen.StaticPoses(q, seen), free=["compliances"], folds=0)
    return flexgen.read(f"{found.write(folder / 'new.toml')}@calibrated"), q, there


def test_the_tool_of_the_new_file_is_where_the_tracker_was_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kinematics puts the tool there, and other sensors and the load stay. Planted: the tracker
    moves, not the tool.
    """
    payload = {"payload": {"mass": 4.0, "com": [0.0, 0.02, 0.1]}}
    new, q, there = written(tmp_path, payload)
    nest, side = np.moveaxis(flexgen.tracker_positions(there, q), 1, 0)
    bare = flexgen.read(
        new.file, "calibrated", overrides={"sensor": [SENSORS[2]]}
    )  # without trackers: the tool itself
    assert np.abs(flexgen.tracker_positions(bare, q)[:, 0] - nest).max() < 1e-7
    assert np.abs(flexgen.tracker_positions(new, q)[:, 1] - side).max() < 1e-7
    assert new.payload == there.payload and new.sensors[0].is_tool
    felt = np.array(new.sensors[2].position)
    assert np.abs(felt + TOOL).max() < 1e-7
    right = result.changes_of
    monkeypatch.setattr(
        result,
        "changes_of",
        lambda *given: {k: v for k, v in right(*given).items() if k != "tool.position"},
    )
    wrong, _, _ = written(tmp_path, payload)
    bare = flexgen.read(wrong.file, "calibrated", overrides={"sensor": [SENSORS[2]]})
    assert np.abs(flexgen.tracker_positions(bare, q)[:, 0] - nest).max() > 0.03


@pytest.mark.parametrize("more", [{"position": [0.1, 0.0, 0.0]}, {"element": "body4"}])
def test_a_tool_point_elsewhere_is_refused(more: dict[str, Any]) -> None:
    with pytest.raises(ModelError, match="is_tool"):
        flexgen.read("manutec_r3_18", overrides={"sensor": [NEST | more]})
    with pytest.raises(ModelError, match="one tracker only"):
        flexgen.read("manutec_r3_18", overrides={"sensor": [NEST, NEST | {"name": "other"}]})
