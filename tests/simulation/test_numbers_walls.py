"""Walls that push a tool, by hand; what a URDF file means where it leaves something out; bodies
that are one.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.urdf.urdf import Inertial, Urdf
from flexgen.model.urdf.urdf_chain import lump_bodies
from flexgen.simulation.environment.wall import (
    add_contact,
    check_start,
    contact_force,
    contact_function,
    in_world,
    numbers_of,
)


# --- walls ---------------------------------------------------------------------------------------
def test_a_wall_pushes_with_spring_and_damper_and_never_pulls() -> None:
    """``f = max(0, k d - c n' v) n`` where the depth d is above zero; none along the wall, no
    torque.
    """
    equations = derive("elbow")
    wall = flexgen.Wall((1.0, 0.2, 0.0), (-3.0, 4.0, 0.0), 2e3, 150.0, 0.05)
    n = np.array([-0.6, 0.8, 0.0])
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (40, 2))
    v = rng.normal(size=(40, 2))
    found = contact_force(wall, equations, q, v)
    seen = set()
    for k in range(40):
        p = np.array(equations.function("forward_kinematics")(q[k])[0]).ravel()
        h = 1e-6
        ahead, behind = (
            np.array(equations.function("forward_kinematics")(q[k] + s * h * v[k])[0]).ravel()
            for s in (1, -1)
        )
        depth = n @ (wall.point - 0.05 * n - p)
        rate = n @ (ahead - behind) / (2 * h)
        push = 2e3 * depth - 150.0 * rate if depth > 0 else 0.0
        seen.add((bool(depth > 0), bool(push > 0)))
        assert_allclose(found[k], max(push, 0.0) * n, rtol=1e-6, atol=1e-6)
        whole = np.array(contact_function(wall, equations)(q[k], v[k])).ravel()
        assert_allclose(whole, [*found[k], 0.0, 0.0, 0.0])
    assert seen == {(True, True), (True, False), (False, False)}
    ports = {name: Port(name, (2,), "rad", "of the arm") for name in ("q_a", "v_a")}
    motion = Trajectory(
        np.arange(40.0), {"q_a": q, "v_a": v}, ports, dict.fromkeys(ports, ("q1", "q2"))
    )
    more = add_contact(wall, equations, motion)
    assert_allclose(more["contact"], found)
    assert more.labels["contact"] == ("fx", "fy", "fz") and more.ports["contact"].unit == "N"


def test_a_wall_is_in_the_frame_of_the_base() -> None:
    model = flexgen.read("elbow")
    R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    base = replace(model.base, rotation=tuple(map(tuple, R.tolist())), position=(1.0, 2.0, 3.0))
    moved = replace(model, base=base)
    wall = flexgen.Wall((0.4, 0.0, -0.1), (0.0, 0.0, 2.0), 5.0, gap=0.25)
    point, normal = in_world(wall, moved)
    assert_allclose(normal, R @ [0, 0, 1])
    assert_allclose(point, [1, 2, 3] + R @ [0.4, 0.0, -0.1 - 0.25])
    assert_allclose(numbers_of(wall, moved), [*point, *normal, 5.0, 0.0])
    equations = derive("elbow")
    q = np.array([0.2, 0.4])
    p = np.array(equations.function("forward_kinematics")(q)[0]).ravel()
    check_start(flexgen.Wall(tuple(p - 1e-9 * np.eye(3)[0]), (1.0, 0.0, 0.0), 5.0), equations, q)
    text = (
        r"^wall: given a wall in which the tool begins, 0\.25 m deep, expected the tool before "
        r"it; turn the normal"
    )
    with pytest.raises(ArgumentError, match=text):
        check_start(
            flexgen.Wall(tuple(p + 0.25 * np.eye(3)[0]), (1.0, 0.0, 0.0), 5.0), equations, q
        )


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"point": (1.0, 2.0)},
            r"wall, point: given \(1\.0, 2\.0\), expected three finite numbers",
        ),
        ({"point": (1.0, 2.0, 1e9)}, "wall, point: given .*, expected three finite numbers"),
        (
            {"normal": (0.0, 0.0, 1e-10)},
            r"wall, normal: given .*, expected a vector that is not zero",
        ),
        ({"normal": (0.0, np.nan, 1.0)}, "wall, normal: given .*, expected three finite numbers"),
        ({"stiffness": 0.0}, r"wall, stiffness: given 0\.0, expected a number > 0 in N/m"),
        ({"damping": -1.0}, r"wall, damping: given -1\.0"),
        ({"gap": np.inf}, "wall, gap: given inf, expected a finite number in m"),
    ],
)
def test_numbers_of_a_wall_are_checked(given: dict[str, object], text: str) -> None:
    good = {"point": (1.0, 2.0, 0.999e9), "normal": (0.0, 0.0, 1e-8), "stiffness": 1e-9}
    flexgen.Wall(**good)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=text):
        flexgen.Wall(**(good | given))  # type: ignore[arg-type]


# --- URDF ----------------------------------------------------------------------------------------
def urdf_of(folder: Path, inside: str, kind: str = "continuous") -> Urdf:
    text = (
        '<robot name="r">\n'
        '<link name="a"/>\n'
        '<link name="b"/>\n'
        f'<joint name="j" type="{kind}">\n'
        '<parent link="a"/>'
    )
    (folder / "r.urdf").write_text(f'{text}<child link="b"/>{inside}</joint>\n</robot>\n')
    return Urdf(folder / "r.urdf", "r.urdf")


def test_what_a_joint_leaves_out_has_the_defaults_of_the_format(tmp_path: Path) -> None:
    found = urdf_of(tmp_path, "")
    joint = found.joints["j"]
    assert (
        found.axis(joint) == [1.0, 0.0, 0.0]
        and found.mimic(joint) is None
        and found.limit(joint) is None
    )
    assert found.dynamics(joint) == (joint.node.line, 0.0, 0.0)
    assert_allclose(found.origin(joint).rotation, np.eye(3))
    assert_allclose(found.origin(joint).position, 0.0)
    more = (
        '<origin xyz="1 2 3"/><mimic joint="k"/><dynamics friction="0.4"/><axis xyz="0 0.6 0.8"/>'
    )
    found = urdf_of(tmp_path, more)
    joint = found.joints["j"]
    assert_allclose(found.origin(joint).rotation, np.eye(3))
    assert_allclose(found.origin(joint).position, [1, 2, 3])
    mimic = found.mimic(joint)
    assert mimic is not None
    assert (mimic.leader, mimic.factor, mimic.offset) == ("k", 1.0, 0.0)
    assert found.dynamics(joint)[1:] == (0.0, 0.4)
    assert_allclose(found.axis(joint), [0.0, 0.6, 0.8])
    more = (
        '<origin rpy="0.1 0.2 0.3"/><mimic joint="k" multiplier="-2" offset="0.5"/><dynamics '
        'damping="0.3"/>'
    )
    found = urdf_of(tmp_path, more)
    joint = found.joints["j"]
    assert_allclose(
        found.origin(joint).rotation,
        Rotation.from_euler("xyz", [0.1, 0.2, 0.3]).as_matrix(),
        atol=1e-15,
    )
    assert_allclose(found.origin(joint).position, 0.0)
    mimic = found.mimic(joint)
    assert mimic is not None
    assert (mimic.leader, mimic.factor, mimic.offset) == ("k", -2.0, 0.5)
    assert found.dynamics(joint)[1:] == (0.3, 0.0)


@pytest.mark.parametrize(
    ("kind", "limit", "text"),
    [
        ("continuous", 'effort="0" velocity="1"', 'effort: given "0", expected a number > 0'),
        ("continuous", 'effort="1" velocity="-1"', 'velocity: given "-1", expected a number > 0'),
        (
            "revolute",
            'effort="1" velocity="1" lower="1" upper="1"',
            "given lower 1, upper 1, expected a lower limit",
        ),
        (
            "revolute",
            'effort="1" velocity="1" lower="1"',
            "upper: given nothing, expected a number",
        ),
    ],
)
def test_limits_of_a_joint_are_checked(kind: str, limit: str, text: str, tmp_path: Path) -> None:
    found = urdf_of(tmp_path, f"<limit {limit}/>", kind)
    with pytest.raises(ModelError, match=text):
        found.limit(found.joints["j"])
    found = urdf_of(tmp_path, '<limit effort="2" velocity="3" lower="-1" upper="1.5"/>', kind)
    made = found.limit(found.joints["j"])
    assert made is not None and (made.effort, made.velocity) == (2.0, 3.0)
    assert (made.lower, made.upper) == ((-1.0, 1.5) if kind == "revolute" else (None, None))


def test_the_axis_of_a_joint_is_normalized(tmp_path: Path) -> None:
    for text in ("0 0.57735 0.816497", "0 0 1.1", "1e-9 0 1e-9"):
        found = urdf_of(tmp_path, f'<axis xyz="{text}"/>')
        assert np.linalg.norm(found.axis(found.joints["j"])) == pytest.approx(1.0, abs=1e-15)
    found = urdf_of(tmp_path, '<axis xyz="0 0 0"/>')
    with pytest.raises(ModelError, match="expected a direction that is not zero"):
        found.axis(found.joints["j"])


def test_bodies_that_are_fixed_to_each_other_are_one() -> None:
    """Point masses of three bodies: mass, center and inertia are those of all points."""
    rng = np.random.default_rng(2)
    m = rng.uniform(0.5, 2.0, (3, 6))
    r = rng.normal(size=(3, 6, 3))

    def body(m: np.ndarray, r: np.ndarray, reduced: bool = False) -> Inertial:
        com = (m[:, None] * r).sum(axis=0) / m.sum()
        tensor = sum(
            x * (d @ d * np.eye(3) - np.outer(d, d)) for x, d in zip(m, r - com, strict=True)
        )
        return Inertial(float(m.sum()), com, np.asarray(tensor), reduced)

    found = lump_bodies([body(m[k], r[k], k == 1) for k in range(3)])
    whole = body(m.ravel(), r.reshape(-1, 3))
    assert found is not None and found.mass == pytest.approx(whole.mass) and found.reduced
    assert_allclose(found.com, whole.com)
    assert_allclose(found.inertia, whole.inertia, atol=1e-12)
    assert lump_bodies([]) is None and lump_bodies([found]) is found
    assert not lump_bodies([whole, whole]).reduced  # type: ignore[union-attr]
