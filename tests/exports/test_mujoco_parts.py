"""Parts of the export for MuJoCo: inertias that a body can have, axes about which bodies turn, the
time step, frictions that are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.exports.mujoco.mujoco import STEP, STEP_MAX, time_step
from flexgen.exports.mujoco.mujoco_checks import common_axis, drives, with_friction
from flexgen.exports.mujoco.mujoco_inertia import find_least, free_directions, missing, principal

# --- inertias


@pytest.mark.parametrize(
    ("moments", "lacks"),
    [((1.0, 2.0, 3.5), 0.5), ((1.0, 2.0, 2.5), -0.5), ((-0.25, 1.0, 1.0), 0.25)],
)
def test_an_inertia_lacks_what_its_largest_moment_exceeds(
    moments: tuple[float, float, float], lacks: float
) -> None:
    R = Rotation.random(random_state=2).as_matrix()
    assert missing(R @ np.diag(moments) @ R.T) == pytest.approx(lacks)


def test_directions_across_all_axes_are_free() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    across = np.eye(3) - np.outer(axis, axis)
    assert_allclose(free_directions([axis, -axis]), across)
    assert_allclose(free_directions([]), np.eye(3))
    assert free_directions([axis, np.array([1.0, 0.0, 0.0])]) is None


FREE: dict[str, tuple[tuple[float, ...], tuple[float, ...], float | None]] = {
    "all directions": ((0.2, 0.3, 1.1), (1.0, 1.0, 1.0), 0.6),  # 1.1 + c = 0.5 + 2 c
    "across the largest": ((0.2, 0.3, 1.1), (1.0, 1.0, 0.0), 0.3),
    "nothing is missing": ((1.0, 1.0, 2.0), (1.0, 1.0, 0.0), 0.0),
    "a negative moment": ((-0.5, 1.0, 1.0), (1.0, 1.0, 1.0), 0.5),
    "far": ((0.0, 0.0, 1.0), (1e-2, 1e-2, 0.0), 50.0),
    "across another one": ((0.0, 0.0, 1.0), (0.0, 1.0, 1.0), None),
    "none": ((1.0, 2.0, 4.0), (0.0, 0.0, 0.0), None),
}


@pytest.mark.parametrize("name", FREE)
def test_the_least_share_makes_a_tensor_that_a_body_can_have(name: str) -> None:
    """No moment is larger than the sum of the others; a smaller share is not enough."""
    moments, free, least = FREE[name]
    R = Rotation.random(random_state=5).as_matrix()
    inertia, share = (R @ np.diag(x) @ R.T for x in (moments, free))
    found = find_least(inertia, share)
    if least is None:
        assert found is None
        return
    assert found == pytest.approx(least, rel=1e-6, abs=1e-12)
    assert missing(inertia + found * share) <= 0.0
    assert least == 0.0 or missing(inertia + 0.999 * found * share) > 0.0


@pytest.mark.parametrize("turn", [[1e-7, -2e-7, 1e-7], [0.9, -0.3, 0.4], [0.0, 0.0, 0.0]])
def test_principal_axes_are_a_rotation_that_mujoco_does_not_drop(turn: list[float]) -> None:
    """The identity itself, or far from it."""
    R = Rotation.from_rotvec(turn).as_matrix()
    tensor = R @ np.diag([3.0, 2.0, 1.5]) @ R.T
    moments, axes = principal(tensor)
    assert_allclose(axes @ np.diag(moments) @ axes.T, tensor, atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert np.abs(axes - np.eye(3)).max() > 0.1 or not any(turn)


@pytest.mark.parametrize("fastest", [0.0, 1e-9, 100.0, 260.0, 410.0, 999.0, 4e6])
def test_a_time_step_is_the_largest_round_number_below_the_bound(fastest: float) -> None:
    """1, 2 or 5 times a power of ten; slow robots have the largest one."""
    longest = min(STEP / fastest, STEP_MAX) if fastest else STEP_MAX
    rounds = [m * 10.0**k for k in range(-9, 1) for m in (1, 2, 5)]
    expected = max(x for x in rounds if x <= longest * (1 + 1e-9))
    assert time_step(fastest) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("step", [1e-3, 5e-4, 2e-4])
def test_a_bound_that_is_round_is_the_step(step: float) -> None:
    assert time_step(STEP / step) == pytest.approx(step, rel=1e-12)


# --- bodies that turn about one axis


def turn_of(model: flexgen.RobotModel, name: str, q: dict[str, float]) -> np.ndarray:
    """Rotation of an element's body, joint after joint."""
    chain = [name]
    while chain[-1] in model.parents:
        chain.append(model.parents[chain[-1]])
    R = np.array(model.base.rotation)
    for element in (e for e in model.elements if e.name in chain):
        R = R @ np.array(element.origin.rotation)
        for dof in element.dofs:
            if dof.type == "rotation":
                R = R @ Rotation.from_rotvec(q[dof.name] * np.array(dof.axis)).as_matrix()
        R = R @ np.array(element.link.rotation)
    return R


def speed_of(
    model: flexgen.RobotModel, name: str, q: dict[str, float], v: dict[str, float]
) -> np.ndarray:
    """Its angular velocity in its own axes, by central differences."""
    h = 1e-6
    before, R, after = (
        turn_of(model, name, {k: q[k] + s * h * v[k] for k in q}) for s in (-1.0, 0.0, 1.0)
    )
    hat = R.T @ (after - before) / (2 * h)
    return np.array([hat[2, 1], hat[0, 2], hat[1, 0]])


@pytest.mark.parametrize(
    ("name", "turning"),
    [("elbow", 2), ("planar5_nmp", 3), ("manutec_r3", 1), ("four_mass@high", 3)],
)
def test_bodies_with_one_direction_turn_about_it(name: str, turning: int) -> None:
    """The sum over joints of sign times speed; the others turn about several directions."""
    model = flexgen.read(name)
    rng = np.random.default_rng(3)
    joints = [c.name for c in model.coordinates if c.dof is not None]
    q, v, w = (dict(zip(joints, rng.uniform(-1, 1, len(joints)), strict=True)) for _ in range(3))
    found = {e.name: common_axis(model, e.name) for e in model.elements}
    assert sum(x is not None for x in found.values()) == turning
    for body, one in found.items():
        speed = speed_of(model, body, q, v)
        if one is None:
            assert np.linalg.norm(np.cross(speed, speed_of(model, body, q, w))) > 1e-4
            continue
        axis, signs = one
        expected = axis * sum(sign * v[k] for k, sign in signs.items())
        assert_allclose(speed, expected, atol=1e-8)


def test_drives_have_the_ratios_of_their_joints() -> None:
    model = flexgen.read("manutec_r3")
    names = [model.coordinates[i].name for i in model.i_g]
    found = drives(model)
    for drive, motor, row in zip(found, model.motors, model.eta, strict=True):
        assert drive.motor is motor
        assert drive.ratios == {n: x for n, x in zip(names, row.tolist(), strict=True) if x}
    elastic = [j in model.i_m for j in range(model.n_m)]
    assert [drive.elastic for drive in found] == elastic and {*elastic} == {True, False}


# --- frictions

KEY = "motor.m1.friction"
DRY = {"viscous": 0.3, "coulomb": 2.0, "beta": 9.0}
differ = "accelerations in MuJoCo differ from those of the model"
LEFT_OUT = f"all friction but viscous is left out: {differ}"
STICK = f"Coulomb friction is a constraint with stick: {differ}"
NOTES: list[tuple[dict[str, Any], str, tuple[str, ...]]] = [
    ({}, "exact", ()),
    ({}, "viscous", ()),
    ({KEY: {"viscous": 0.3}}, "dry", ()),
    ({KEY: DRY}, "viscous", (LEFT_OUT,)),
    ({KEY: DRY}, "dry", (STICK,)),
]


@pytest.mark.parametrize(("changes", "kind", "notes"), NOTES)
def test_an_export_says_which_friction_it_changes(
    changes: dict[str, Any], kind: str, notes: tuple[str, ...], tmp_path: Path
) -> None:
    """Nothing where the file has all friction of the model, whatever was asked for."""
    model = flexgen.read("elbow", overrides=changes)
    found = flexgen.export_mujoco(model, tmp_path / "arm.xml", friction=kind)
    assert found.notes == notes and found.details["friction"] == kind


def test_frictions_that_are_asked_for_are_those_of_the_model_or_less() -> None:
    change = {KEY: DRY, "element.fore.dof.q2.friction": {"viscous": 4.0, "offset": 1.5}}
    model = flexgen.read("elbow", overrides=change)
    assert with_friction(model, "exact") is model
    for kind, law in (("viscous", {"viscous": 0.3}), ("dry", DRY)):
        left = {KEY: law, "element.fore.dof.q2.friction": {"viscous": 4.0}}
        expected = flexgen.read("elbow", overrides=left)
        found = with_friction(model, kind)
        assert found.motors == expected.motors and found.elements == expected.elements
    with pytest.raises(ArgumentError) as caught:
        with_friction(model, "none")
    assert str(caught.value) == "friction: given 'none', expected one of exact, viscous, dry"


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "Coulomb friction": (
        {KEY: DRY},
        "motor.m1.friction.coulomb: given 2, which is a function tanh of the speed, expected for "
        'MuJoCo viscous friction, or friction = "viscous"',
    ),
    "an offset": (
        {"element.fore.dof.q2.friction": {"offset": 1.5}},
        "element.fore.dof.q2.friction.offset: given 1.5, a constant torque, expected",
    ),
    "a counterbalance": (
        {"element.upper.dof.q1.counterbalance": {"sin": [5.0]}},
        "element.upper.dof.q1.counterbalance: given a counterbalance, expected for MuJoCo none",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_laws_that_mujoco_does_not_have_are_refused(name: str, tmp_path: Path) -> None:
    changes, text = REFUSED[name]
    with pytest.raises(flexgen.ModelError) as caught:
        flexgen.export_mujoco(flexgen.read("elbow", overrides=changes), tmp_path / "arm.xml")
    assert text in str(caught.value)
