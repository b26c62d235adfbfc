"""Walls: the force of a spring and a damper that never pulls, in the frame of the base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.simulation.environment.wall import (
    add_contact,
    check_start,
    contact_force,
    contact_function,
    in_world,
    numbers_of,
)


def tool_of(equations: Equations, q: np.ndarray) -> np.ndarray:
    return np.array(equations.function("forward_kinematics")(q)[0]).ravel()


def test_a_wall_pushes_with_spring_and_damper_and_never_pulls() -> None:
    """``f = max(0, k d - c n' v) n`` where the depth d is above zero, the speed by differences."""
    equations = derive("elbow")
    wall = flexgen.Wall((1.0, 0.2, 0.0), (-3.0, 4.0, 0.0), 2e3, 150.0, 0.05)
    n = np.array([-0.6, 0.8, 0.0])
    rng = np.random.default_rng(0)
    q = rng.uniform(-1, 1, (40, 2))
    v = rng.normal(size=(40, 2))
    found = contact_force(wall, equations, q, v)
    seen = set()
    for k in range(40):
        h = 1e-6
        ahead, behind = (tool_of(equations, q[k] + s * h * v[k]) for s in (1, -1))
        depth = n @ (wall.point - 0.05 * n - tool_of(equations, q[k]))
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


@pytest.mark.parametrize(("depth", "good"), [(-1e-9, True), (0.25, False)])
def test_a_motion_begins_before_the_wall(depth: float, good: bool) -> None:
    equations = derive("elbow")
    q = np.array([0.2, 0.4])
    point = tool_of(equations, q) + np.array([depth, 0.0, 0.0])
    wall = flexgen.Wall(tuple(point), (1.0, 0.0, 0.0), 5.0)
    if good:
        check_start(wall, equations, q)
        return
    text = r"given a wall in which the tool begins, 0\.25 m deep, expected the tool before it"
    with pytest.raises(ArgumentError, match=rf"^wall: {text}"):
        check_start(wall, equations, q)


GOOD = {"point": (1.0, 2.0, 0.999e9), "normal": (0.0, 0.0, 1e-8), "stiffness": 1e-9}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, ""),
        ({"point": (1.0, 2.0)}, r"point: given \(1\.0, 2\.0\), expected three finite numbers"),
        ({"point": (1.0, 2.0, 1e9)}, "point: given .*, expected three finite numbers"),
        ({"normal": (0.0, 0.0, 1e-10)}, "normal: given .*, expected a vector that is not zero"),
        ({"normal": (0.0, np.nan, 1.0)}, "normal: given .*, expected three finite numbers"),
        ({"stiffness": 0.0}, r"stiffness: given 0\.0, expected a number > 0 in N/m"),
        ({"damping": -1.0}, r"damping: given -1\.0"),
        ({"gap": np.inf}, "gap: given inf, expected a finite number in m"),
    ],
)
def test_numbers_of_a_wall_are_checked(changes: dict[str, object], text: str) -> None:
    if not text:
        flexgen.Wall(**GOOD)  # type: ignore[arg-type]
        return
    with pytest.raises(ArgumentError, match=f"^wall, {text}"):
        flexgen.Wall(**(GOOD | changes))  # type: ignore[arg-type]
