"""Inclinations of elements in a calibration: a level on a link shows a spring that no position of
the poses shows. Readings are differences of heights of two points by CasADi's statics.
"""

from __future__ import annotations

import os
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses import statics
from flexgen.identification.poses.touches import Touches

LEVEL = {"name": "felt", "type": "tracker", "unit": "m", "element": "body2"}
FOOT = {"name": "foot", "type": "tracker", "unit": "m", "element": "body2"}


def springs(robot: flexgen.RobotModel) -> list[str]:
    """Elastic axes of the second body, about which the level turns."""
    return [dof.name for dof in robot.elements[1].dofs if dof.spring is not None]


def readings(robot: flexgen.RobotModel, q: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Heights (N, 2) of the ends of the axes x and z of the body over its origin, 1 m long."""
    points = [
        {"name": f"p{k}", "type": "tracker", "unit": "m", "element": "body2", "position": end}
        for k, end in enumerate(([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    ]
    there = flexgen.read(robot.file, overrides={**robot.overrides, "sensor": points})
    p = flexgen.tracker_positions(there, q)
    return np.asarray((p[:, 1:] - p[:, :1]) @ up)


def poses_with_levels(seed: int) -> tuple[flexgen.RobotModel, flexgen.StaticPoses, str, float]:
    """Levels x and z of the second body with unknown zeros, of a robot with a softer axis."""
    base = flexgen.read("manutec_r3_18", overrides={"sensor": [LEVEL, FOOT]})
    name = springs(base)[-1]
    spring = next(dof.spring for dof in base.elements[1].dofs if dof.name == name)
    stiffness = getattr(spring, "stiffness", 0.0)
    softer = {f"element.body2.dof.{name}.spring.stiffness": 0.6 * stiffness}
    there = flexgen.read(base.file, overrides={"sensor": [LEVEL, FOOT], **softer})
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.5, 1.5, (40, 6))
    up = -np.array(base.gravity) / np.linalg.norm(base.gravity)
    read = readings(there, q, up) + [0.01, -0.02] + 1e-6 * rng.normal(size=(40, 2))
    touches = np.tile(["level felt x", "level felt z"], (40, 1))
    empty = np.full((40, 2, 3), np.nan)
    data = flexgen.StaticPoses(q, empty, touches=touches, readings=read)
    return base, data, name, 1.0 / (0.6 * stiffness)


def test_a_level_shows_a_spring(monkeypatch: pytest.MonkeyPatch) -> None:
    """The compliance and the zeros come back. Planted: up is not against gravity."""
    base, data, name, compliance = poses_with_levels(0)
    given: dict[str, Any] = {"free": ["compliances"], "folds": 0}
    found = flexgen.calibrate(base, data, **given)
    key = f"{name}.compliance"
    assert found.determined[key] and abs(found.values[key] / compliance - 1) < 0.01
    assert abs(found.values["level.felt.x.zero"] + 0.01) < 1e-4
    assert abs(found.values["level.felt.z.zero"] - 0.02) < 1e-4
    monkeypatch.setattr(statics, "replace", lambda touches, **up: touches)
    with pytest.raises(ArgumentError, match="scatter by"):
        flexgen.calibrate(base, data, **given)


def test_a_level_along_an_axis_of_a_tool_is_refused() -> None:
    with pytest.raises(ArgumentError, match="expected an axis of x, -x"):
        Touches.of(np.array([["level felt tool.x"]]), np.zeros((1, 1)))


ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", "")) / "hilti_column"


@pytest.mark.slow
@pytest.mark.skipif(
    not (DATA / "flat.yaml").is_file(), reason="FLEXGEN_DATA names no folder with hilti_column"
)
def test_a_real_column_with_inclinometers(tmp_path: Path) -> None:
    """Fitted to one file, judged on two others: inclinations take away half of the error."""
    pytest.importorskip("yaml")
    script = runpy.run_path(str(ROOT / "examples" / "hilti_column" / "calibrate_column.py"))
    error = script["main"](DATA, tmp_path)
    assert error["with tilts, flat"] < 0.8e-3
    for name, most in (("pallet", 1.9e-3), ("seesaw", 2.8e-3)):
        assert error[f"with tilts, {name}"] < min(most, 0.55 * error[f"without tilts, {name}"])
        assert error[f"after stationing, {name}"] < 1.3e-3  # the total station alone: 1.2 mm
