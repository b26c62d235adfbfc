"""Springs and rods between two points are MuJoCo's spatial tendons; other lines are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.numerics.evaluate import evaluate

SPRINGS: list[dict[str, Any]] = [
    {
        "name": "balancer",
        "type": "spring",
        "from": {"element": "base", "position": [-0.4, 0.1, 0.2]},
        "to": {"element": "upper", "position": [0.05, -0.1, 0.5]},
        "stiffness": 9e3,
        "length": 0.4,
        "preload": 700.0,
        "damping": 350.0,
    },
    {
        "name": "rod",
        "type": "rod",
        "from": {"element": "base", "position": [0.3, 0.0, 0.1]},
        "to": {"element": "fore", "position": [0.2, 0.05, -0.1]},
        "stiffness": 4e5,
        "length": 0.88,
        "damping": 90.0,
    },
]


def test_springs_are_tendons_of_mujoco(tmp_path: Path) -> None:
    """Accelerations of 100 random states, in a program that shares nothing with flexgen."""
    mujoco = pytest.importorskip("mujoco")
    base = {"rpy_deg": [10, 0, 5], "position": [0.1, 0.2, 0.3]}
    robot = flexgen.read("elbow", overrides={"line": SPRINGS, "base": base})
    path = flexgen.export_mujoco(robot, tmp_path / "elbow.xml").path
    there = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(there)
    names = [there.joint(k).name for k in range(there.njnt)]
    order = [*(c.name for c in robot.coordinates), *(f"rotor.{m.name}" for m in robot.motors)]
    at = [names.index(name) for name in order]
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-0.4, 0.4, (2, 100, robot.dof))
    q[:, 2:] = q[:, :2] @ robot.eta.T + rng.uniform(-0.01, 0.01, (100, 2))
    torque = rng.uniform(-30, 30, (100, 2))
    function = flexgen.derive(robot).function("forward_dynamics")
    ours = np.hstack(evaluate(function, q[:, :2], v[:, :2], q[:, 2:], v[:, 2:], torque))
    for k in range(len(q)):
        data.qpos[at] = q[k]
        data.qvel[at] = v[k]
        data.ctrl[:] = torque[k]
        mujoco.mj_forward(there, data)
        error = np.abs(data.qacc[at] - ours[k]).max()
        assert error <= 1e-10 * np.abs(ours[k]).max()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 3.0}, "line.balancer.mass: given 3 kg, expected for MuJoCo a line without mass"),
        ({"preload": 4e3}, "line.balancer.preload: given a spring without force at .* -0.04"),
        ({"type": "cable", "smoothing": 1e-3}, "given a cable, expected for MuJoCo a spring"),
    ],
)
def test_other_lines_are_refused(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    robot = flexgen.read("elbow", overrides={"line": [SPRINGS[0] | change]})
    with pytest.raises(ModelError, match=message):
        flexgen.export_mujoco(robot, tmp_path / "elbow.xml")
