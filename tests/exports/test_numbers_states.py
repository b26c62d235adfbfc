"""Torques with a memory as states of an exported plant, joints of an exported URDF file, and views
of a robot.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.exports.fmu import plant_memory
from flexgen.exports.urdf import urdf
from flexgen.views.plots.stick_figure import _views


def layer(**more: Any) -> Any:
    fields = {
        "bend": np.array([2.0, 1.5]),
        "stiffness": np.array([30.0, 50.0]),
        "divisor": np.array([5.0, 4.0]),
    }
    fields |= {"present": np.array([True, True]), "slip": np.array([6.0, 7.0])}
    return Made(**(fields | more))


BRISTLES = Made(
    stiffness=np.array([90.0, 0.0]),
    present=np.array([True, False]),
    coulomb=np.array([3.0, 0.0]),
    static=[4.0, 0.0],
)


def test_states_of_a_plant_with_memory_and_their_fastest_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Elements without a largest torque have no state; the bound is that of gears and of
    bristles.
    """
    q_a, v_a, q_m, v_m, whole = (
        ca.SX.sym(name, n) for name, n in (("q", 2), ("v", 2), ("m", 2), ("w", 2), ("z", 4))
    )
    lag = Made(chain=Made(q_a=q_a, v_a=v_a), q_m=q_m)
    equations: Any = Made(
        model="model",
        lagrangian=Made(**vars(lag), v_m=v_m),
        with_memory=lambda forces, z: (forces, z),
    )
    memory = Made(
        z=whole, forces=ca.vertcat(2 * whole[0] - whole[3], 5 * whole[3]), rates=v_a[0] * whole
    )
    for name, value in (
        ("memory_laws", [1]),
        ("memory_of", memory),
        ("slip_torques", np.array([6.0, 0.0, 0.0, 4.0])),
        ("deflection_rates", v_a),
        ("motor_speeds", v_m),
        ("gear_layers", [layer()]),
        ("motor_bristles", BRISTLES),
    ):
        monkeypatch.setattr(plant_memory, name, lambda given, value=value: value)
    made = plant_memory.plant_memory(equations)
    assert made is not None and made.size == 2 and made.function.size1_in(4) == 2
    for speeds, motors in (
        ([0.1, -0.2], [1.0, 5.0]),
        ([0.1, -2.0], [1.0, 5.0]),
        ([2.0, 0.0], [-0.5, 0.0]),
    ):
        rates, fastest, slopes = made.function([0, 0], speeds, [0, 0], motors, [8.0, 9.0])
        assert_allclose(rates.full()[:, 0], speeds[0] * np.array([8.0, 9.0]))
        gears = np.array([2.0 * 30.0 / 5.0, 1.5 * 50.0 / 4.0]) * np.abs(speeds)
        assert float(fastest) == pytest.approx(max(*gears, 30.0 * abs(motors[0])))
        assert_allclose(slopes.full(), [[2.0, -1.0], [0.0, 5.0]])
    monkeypatch.setattr(plant_memory, "memory_laws", lambda model: [])
    assert plant_memory.plant_memory(equations) is None


def test_names_of_states_with_a_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Elements of a gear are numbered where it has several; nominal values are the largest
    torques.
    """
    other = layer(present=np.array([False, True]), slip=np.array([0.0, 8.0]))
    monkeypatch.setattr(plant_memory, "gear_layers", lambda model: [layer(), other])
    monkeypatch.setattr(plant_memory, "motor_bristles", lambda model: BRISTLES)
    coordinates = [Made(name="q1", unit="rad"), Made(name="q2", unit="m")]
    model: Any = Made(
        coordinates=coordinates, i_g=(0, 1), motors=[Made(name="m1"), Made(name="m2")]
    )
    found = plant_memory.memory_variables(model, 40)
    assert [(one.name, one.unit, one.nominal) for one in found] == [
        ("gear.q1.hysteresis", "N.m", 6.0),
        ("gear.q2.hysteresis[1]", "N", 7.0),
        ("gear.q2.hysteresis[2]", "N", 8.0),
        ("motor.m1.bristles", "N.m", 4.0),
    ]
    assert [one.index for one in found] == [40, 41, 42, 43]


def frames(*extent: float) -> np.ndarray:
    """Points of a chain at two instants, (instants, 3, points)."""
    return np.array([np.outer(extent, [0.0, 0.5, 1.0]), np.outer(extent, [0.0, 0.4, 0.9])])


@pytest.mark.parametrize(
    ("extent", "gravity", "expected"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, -9.81), ()),
        ((1.0, 0.8, 0.6), (0.0, 0.0, -9.81), ((0, 2), (1, 2), (0, 1))),
        ((1.0, 0.8, 0.6), (0.0, 9.81, 0.0), ((0, 1), (2, 1), (0, 2))),
        ((1.0, 0.8, 0.6), (0.0, 0.0, 0.0), ((0, 2), (1, 2), (0, 1))),
        ((1.0, 0.0, 0.6), (0.0, 0.0, -9.81), ((0, 2),)),
        ((1.0, 0.8, 0.0), (0.0, 0.0, -9.81), ((0, 1),)),  # the plane across gravity
        ((1.0, 0.0, 0.0), (0.0, 0.0, -9.81), ((0, 2),)),  # a line: with gravity
        ((0.0, 0.0, 1.0), (-9.81, 0.0, 0.0), ((2, 0),)),
        ((0.0, 0.8, 0.6), (0.0, 0.0, 0.0), ((1, 2),)),
    ],
)
def test_views_of_a_robot_have_gravity_upright(extent: Any, gravity: Any, expected: Any) -> None:
    """From one side where it is flat, from three where it is not."""
    model: Any = Made(gravity=np.array(gravity))
    assert (
        tuple(tuple(int(k) for k in view) for view in _views(model, frames(*extent))) == expected
    )


def joint_of(**more: Any) -> ET.Element:
    """A joint as it is written, of q1 in a robot with q0."""
    friction = Made(viscous=0.0, coulomb=0.0)
    dof: dict[str, Any] = {
        "type": "rotation",
        "lower": None,
        "upper": None,
        "name": "q1",
        "axis": (0.0, 1.0, 0.0),
    }
    dof |= {"speed_max": None, "friction": friction}
    mimic = more.pop("mimic", None)
    given = Made(**(dof | more)) if more.pop("moves", True) else None
    place = {"position": (0.1, 0.2, 0.3), "rotation": np.eye(3)}
    step: Any = Made(dof=given, joint="joint_1", link="arm", mimic=mimic, **place)
    root = ET.Element("robot")
    urdf._joint(root, step, "base", {"q2": 7.0})
    return root[0]


def attributes(joint: ET.Element) -> dict[str, dict[str, str]]:
    return {child.tag: dict(child.attrib) for child in joint}


def test_joints_of_a_urdf_file_by_hand() -> None:
    """Kinds, limits, what they follow, and frictions."""
    free = joint_of()
    assert dict(free.attrib) == {"name": "joint_1", "type": "continuous"}
    found = attributes(free)
    none = str(urdf.UNLIMITED)
    assert list(found) == ["parent", "child", "origin", "axis", "limit"]
    assert found["parent"] == {"link": "base"} and found["child"] == {"link": "arm"}
    assert [float(x) for x in found["origin"]["xyz"].split()] == [0.1, 0.2, 0.3]
    assert {key: float(x) for key, x in found["limit"].items()} == {
        "effort": float(none),
        "velocity": float(none),
    }
    assert (
        joint_of(moves=False).get("type") == "fixed"
        and list(attributes(joint_of(moves=False)))[-1] == "origin"
    )
    half = joint_of(lower=-1.5, speed_max=3.0, name="q2")
    limit = {key: float(x) for key, x in attributes(half)["limit"].items()}
    assert half.get("type") == "revolute" and limit["effort"] == 7.0 and limit["velocity"] == 3.0
    assert limit["lower"] == -1.5 and limit["upper"] == float(none)
    slides = joint_of(type="translation")
    assert slides.get("type") == "prismatic" and float(
        attributes(slides)["limit"]["lower"]
    ) == -float(none)
    mimic = urdf.UrdfMimic("q0", -0.5, 0.0, None, None, None, None)
    follows = attributes(joint_of(mimic=mimic))["mimic"]
    assert follows["joint"] == "q0" and float(follows["multiplier"]) == -0.5
    assert "mimic" not in attributes(joint_of())
    for viscous, coulomb in ((2.0, 0.0), (0.0, 3.0)):
        rubs = attributes(joint_of(friction=Made(viscous=viscous, coulomb=coulomb)))["dynamics"]
        assert (float(rubs["damping"]), float(rubs["friction"])) == (viscous, coulomb)
