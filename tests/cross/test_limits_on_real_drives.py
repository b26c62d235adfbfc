"""Limits where gears and motors have a memory or depend on load and angle: MuJoCo with laws of the
tests follows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import bristled
import gear_friction
import harmonic
import hysteretic
import numpy as np
import pytest
from process_forces import PLANE, duration_of, milling
from process_forces import error_in_mujoco as error_under_force
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.inversion.problem import limits
from flexgen.planning.fastest import minimum_time, time_search

pytest.importorskip("mujoco")
pytestmark = [needs_compiler, pytest.mark.slow]
KNOWN = 3e-7  # m
SHARE = 0.9  # of the torques without limits
KEPT = 1e-3  # of a limit
ARCMIN = hysteretic.ARCMIN  # rad
SIZE = 0.5  # of the sums


@dataclass(frozen=True)
class Drive:
    """A robot and the error of its tool in MuJoCo under a trajectory."""

    robot: flexgen.RobotModel
    error: Callable[[Trajectory], float]


def drive(kind: str, name: str) -> Drive:
    if kind == "hysteresis":
        return Drive(
            hysteretic.hysteretic(name),
            lambda path: hysteretic.error_in_mujoco(name, path, ARCMIN),
        )
    if kind == "lugre":
        tables = bristled.tables(name)
        return Drive(
            bristled.bristled(name, tables),
            lambda path: bristled.error_in_mujoco(name, path, tables),
        )
    if kind == "load":
        return Drive(
            gear_friction.loaded(name), lambda path: gear_friction.error_in_mujoco(name, path)
        )
    return Drive(
        harmonic.harmonic(name, SIZE), lambda path: harmonic.error_in_mujoco(name, path, SIZE)
    )


def planned(robot: flexgen.RobotModel, path: Trajectory) -> Trajectory:
    """The trajectory with the output of its own motion in place of the reference."""
    y = evaluate(flexgen.derive(robot).function("output"), path["q_a"])[0].reshape(
        len(path.time), -1
    )
    return replace(path, channels={**path.channels, "y_ref": y})


def lowered(robot: flexgen.RobotModel, **more: object) -> flexgen.Limits:
    free = flexgen.solve(robot, verify=False, progress=False, **more).trajectory
    return flexgen.Limits(torque=tuple(SHARE * np.abs(free["tau_m"]).max(axis=0)))


def use(solution: flexgen.Solution, bounds: flexgen.Limits) -> float:
    return float((np.abs(solution.trajectory["tau_m"]).max(axis=0) / bounds.torque).max())


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("hysteresis", "elbow"),
        ("lugre", "elbow"),
        ("load", "elbow"),
        ("harmonics", "planar5_nmp"),
        *(
            pytest.param(kind, "planar5_nmp", marks=pytest.mark.full)
            for kind in ("hysteresis", "lugre", "load")
        ),
    ],
)
def test_limits_are_kept_and_mujoco_follows_the_modified_path(kind: str, name: str) -> None:
    """The torques with their memory are within the limits and reach them; the tool is on the
    modified path.
    """
    one = drive(kind, name)
    bounds = lowered(one.robot)
    found = flexgen.solve(one.robot, limits=bounds, progress=False)
    assert found.status == "limits active" and found.path_distance_max_m > 1e-5
    assert 0.99 < use(found, bounds) < 1 + KEPT
    assert one.error(planned(one.robot, found.trajectory)) < KNOWN


@pytest.mark.parametrize(("kind", "name"), [("hysteresis", "planar5_nmp"), ("lugre", "elbow")])
def test_limits_of_torques_without_memory_are_exceeded(
    kind: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the modified path is that of a robot without the memory."""
    one = drive(kind, name)
    made = limits.inversion_library
    bounds = lowered(one.robot)
    monkeypatch.setattr(limits, "inversion_library", lambda *x, memory, **more: made(*x, **more))
    monkeypatch.setattr(limits, "bristled_motors", lambda robot: [])
    found = flexgen.solve(one.robot, limits=bounds, verify=False, progress=False)
    assert use(found, bounds) > 1 + 2 * KEPT


def test_limits_that_are_not_active_leave_the_path() -> None:
    found = flexgen.solve(
        hysteretic.hysteretic("elbow"), limits=flexgen.Limits(torque=(1e4, 1e4)), progress=False
    )
    assert found.status == "solved" and found.path_distance_max_m is None
    assert "deviation_max_m" not in found.details and found.trajectory.channels["tau_h"].any()


def test_limits_under_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo with the force follows the modified path; planted: limits of the motion without the
    force.
    """
    robot = with_friction(flexgen.read("planar5_nmp"), "viscous")
    force = milling(duration_of(robot), PLANE, 60.0, 8.0)
    bounds = lowered(robot, force=force)
    found = flexgen.solve(robot, force=force, limits=bounds, progress=False)
    assert found.status == "limits active" and found.path_distance_max_m > 1e-5
    assert 0.99 < use(found, bounds) < 1 + KEPT
    assert error_under_force(flexgen.derive(robot), planned(robot, found.trajectory)) < KNOWN
    monkeypatch.setattr(limits, "sample_force", lambda problem, t: None)
    with pytest.raises(SolverError, match="does not satisfy the equations of motion"):
        flexgen.solve(robot, force=force, limits=bounds, verify=False, progress=False)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("hysteresis", "planar5_nmp"),
        *(
            pytest.param(kind, "planar5_nmp", marks=pytest.mark.full)
            for kind in ("lugre", "load", "harmonics")
        ),
    ],
)
def test_the_fastest_motion_keeps_the_limits_and_mujoco_follows_it(
    kind: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the search with torques without memory, and no last check, exceeds them."""
    one = drive(kind, name)
    made = time_search.inversion_library
    quick = flexgen.fastest(one.robot, coefficients=4, progress=False)
    assert quick.solution.status == "solved" and quick.duration_s < 0.9 * quick.default_s
    assert 1 - 5e-3 < use(quick.solution, quick.limits) < 1 + 5e-4
    assert one.error(quick.solution.trajectory) < KNOWN
    if kind in ("hysteresis", "lugre"):
        monkeypatch.setattr(
            time_search, "inversion_library", lambda *x, memory, **more: made(*x, **more)
        )
        monkeypatch.setattr(minimum_time, "_excesses", lambda *_: np.array([-1.0]))
        wrong = flexgen.fastest(one.robot, coefficients=4, progress=False)
        assert use(wrong.solution, wrong.limits) > 1 + 1e-2


def test_a_program_of_gears_with_hysteresis_keeps_the_limits() -> None:
    """The memory lasts from one motion of the program to the next."""
    robot = hysteretic.hysteretic("planar5_nmp")
    steps = (flexgen.MoveL((-0.12, 0.0, 0.0), pause=0.1), flexgen.MoveL((0.0, 0.12, 0.0)))
    tool = (0.4, 2.0, 30.0, 600.0)
    joints = (1.0, 5.0, 60.0, 900.0)
    program = flexgen.Program(
        "two", start=(0.3, -1.1), smoothness=5, steps=steps, profile=tool, joint_profile=joints
    )
    quick = flexgen.fastest(robot, program, coefficients=4, progress=False)
    assert quick.solution.status == "solved" and quick.duration_s < quick.default_s
    assert use(quick.solution, quick.limits) < 1 + 5e-4
