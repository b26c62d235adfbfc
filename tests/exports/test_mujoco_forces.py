"""Tendons of exported robots in MuJoCo: torques of springs and drives against closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen

SPRING = "element.upper.dof.q1.gear.spring"
LOW = 2e6
HIGH = 6e6
BREAK = 2e-3
CUBIC = 3e11


def closed_form(kind: str, d: float) -> float:
    """Torque of a spring at a deflection [N m]."""
    size = abs(d)
    beyond = max(size - BREAK, 0.0)
    near = min(size, BREAK)
    torque = {
        "linear": LOW * size,
        "cubic": LOW * size + CUBIC * size**3,
        "piecewise": LOW * size + (HIGH - LOW) * beyond,
        "smooth": LOW * size + (HIGH - LOW) * (near**3 / (3 * BREAK**2) + beyond),
    }
    return float(np.sign(d)) * torque[kind]


def exported(overrides: dict[str, Any], folder: Path, name: str = "elbow") -> tuple[Any, Any]:
    """A robot in MuJoCo, and its state."""
    made = flexgen.export_mujoco(flexgen.read(name, overrides=overrides), folder / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(made.path))
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("kind", ["linear", "cubic", "piecewise", "smooth"])
def test_springs_have_the_torques_of_their_laws(kind: str, tmp_path: Path) -> None:
    """On the rotor the torque is the opposite one, divided by the ratio."""
    ends = {"low": LOW, "high": HIGH, "break_at": BREAK}
    values = {"linear": {"stiffness": LOW}, "cubic": {"stiffness": LOW, "cubic": CUBIC}}
    model, data = exported({SPRING: {"type": kind, **values.get(kind, ends)}}, tmp_path)
    joint = model.joint("q1").qposadr[0]
    rotor = model.joint("rotor.m1").qposadr[0]
    ratio = flexgen.read("elbow").motors[0].ratio
    ratio = float(np.atleast_1d(ratio)[0])
    for d in (0.0, 0.7e-3, -1.3e-3, 2e-3, 2.9e-3, -5e-3):
        data.qpos[joint] = 0.3
        data.qpos[rotor] = ratio * (0.3 + d)
        mujoco.mj_forward(model, data)
        torque = closed_form(kind, d)
        assert_allclose(data.qfrc_spring[joint], torque, rtol=1e-6, atol=1e-3)
        assert_allclose(data.qfrc_spring[rotor], -torque / ratio, rtol=1e-6, atol=1e-3)


def test_dampers_act_on_the_rate_of_the_deflection(tmp_path: Path) -> None:
    model, data = exported({}, tmp_path)
    joint = model.joint("q1").dofadr[0]
    rotor = model.joint("rotor.m1").dofadr[0]
    other = model.joint("rotor.m2").dofadr[0]
    ratio = 1872 / 7
    mujoco.mj_forward(model, data)
    rest = data.qfrc_damper.copy()
    data.qvel[rotor] = ratio * 1e-3
    mujoco.mj_forward(model, data)
    change = data.qfrc_damper - rest
    assert_allclose(change[joint], 1400.0 * 1e-3, rtol=1e-6)
    assert change[rotor] <= -1400.0 * 1e-3 / ratio * (1 - 1e-6)
    assert_allclose(change[other], 0.0, atol=1e-9)
