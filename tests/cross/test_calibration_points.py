"""Calibration with a tip at fixed points: robots with known errors, placed by CasADi's statics."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.poses.model_file import changes_of
from flexgen.identification.poses.parameters import Priors, Unknown, points_of, unknowns_of
from flexgen.identification.poses.statics import Numbers, Statics
from flexgen.identification.poses.tree import Tree
from flexgen.model.elements import RobotModel

TIP = [{"name": "tip", "type": "tracker", "unit": "m", "position": [0.03, 0.02, 0.15]}]
PRIORS = Priors(zero=0.02, position=0.003, rotation=0.003, compliance=0.5, tracker=0.005)
NOISE = 5e-5
PLACES = np.array([[0.55, 0.75, 0.75], [-0.5, 0.9, 0.35]])


@lru_cache
def arm() -> RobotModel:
    return flexgen.read("manutec_r3_18", overrides={"sensor": TIP})


def touch(robot: RobotModel, targets: np.ndarray, seed: int) -> np.ndarray:
    """Commands (N, 6) at which the tip is at the targets (N, 3); CasADi's statics put it there."""
    rng = np.random.default_rng(seed)
    tree = Tree(robot)
    joints = [u for u in unknowns_of(tree, ("zeros",), (), PRIORS) if u.kind == "node"]
    q = rng.uniform(-1.2, 1.2, (len(targets), 6))
    for _ in range(100):
        statics = Statics(tree, q)
        rest = statics.rest(Numbers.of(tree))
        gap = rest.points[:, 0] - targets
        if np.linalg.norm(gap, axis=1).max() < 1e-10:
            break
        J = statics.slopes(Numbers.of(tree), rest, joints)[0][:, 0]
        step = -np.einsum("nij,nj->ni", np.linalg.pinv(J, rcond=1e-3), gap)
        q = q + step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.3)
        lost = (np.abs(q) > 2.6).any(axis=1)
        q[lost] = rng.uniform(-1.2, 1.2, (int(lost.sum()), 6))
    assert np.abs(flexgen.tracker_positions(robot, q)[:, 0] - targets).max() < 1e-8
    return q


def of_robot(free: tuple[str, ...]) -> list[Unknown]:
    """The free numbers of the robot but the length that gives the scale."""
    found = unknowns_of(Tree(arm()), free, (), PRIORS)
    return [u for u in found if u.kind != "frame" and u.name != "body3.y"]


def robot_of(free: tuple[str, ...], truth: dict[str, float]) -> RobotModel:
    """The robot with these numbers, by the keys of its model file."""
    numbers = Numbers.of(Tree(arm()), of_robot(free), list(truth.values()))
    return flexgen.read(arm().file, overrides={"sensor": TIP} | changes_of(arm(), numbers))


def drawn(free: tuple[str, ...], count: int, seed: int) -> tuple[np.ndarray, np.ndarray, dict]:
    """Commands and point names of a robot with errors of the priors, and its numbers by name."""
    rng = np.random.default_rng(seed)
    unknowns = of_robot(free)
    x = np.array([u.start + 0.5 * u.sd * rng.normal() for u in unknowns])
    truth = dict(zip((u.name for u in unknowns), x.tolist(), strict=True))
    robot = robot_of(free, truth)
    which = np.arange(count) % len(PLACES)
    targets = PLACES[which] + NOISE * rng.normal(size=(count, 3))
    q = touch(robot, targets, seed)
    return q, np.array(["near", "far"])[which][:, None], truth


def poses_of(q: np.ndarray, points: np.ndarray) -> flexgen.StaticPoses:
    return flexgen.StaticPoses(q, np.full((len(q), 1, 3), np.nan), points=points)


@pytest.mark.parametrize("placements", [(), ("placements",)])
def test_intervals_hold_the_numbers_that_fixed_points_determine(
    placements: tuple[str, ...],
) -> None:
    """Zeros, places and compliances; planted: a joint that is turned is many deviations off."""
    free = ("zeros", *placements, "compliances")
    away: list[float] = []
    for seed in range(2):
        q, points, truth = drawn(free, 80, seed)
        found = flexgen.calibrate(arm(), poses_of(q, points), free=free, priors=PRIORS)
        known = [name for name in truth if found.determined[name]]
        away += [(found.values[name] - truth[name]) / found.sd[name] for name in known]
        assert found.problem == "" and len(known) >= 12
        assert {f"q{k}.zero" for k in (2, 3, 4, 5)} <= set(known)
        assert not found.determined["q1.zero"] and not found.determined["q6.zero"]
        # the length of a vector of three normal numbers has a mean of 1.6 deviations of one
        assert np.nanmean(found.errors_held_out) < 1.3 * 1.6 * NOISE
        assert np.nanmean(found.errors_before) > 20 * np.nanmean(found.errors)
        told = [text for text in found.warnings if "no length scale: body3.y is held" in text]
        assert len(told) == bool(placements) and "body3.y" not in found.values
    assert np.sqrt(np.mean(np.square(away))) < 1.3 and np.mean(np.abs(away) < 1.96) > 0.9
    turned = q + 0.03 * (np.arange(6) == 2)
    poses = poses_of(turned, points)
    wrong = flexgen.calibrate(arm(), poses, free=free, priors=PRIORS, folds=0)
    assert abs(wrong.values["q3.zero"] - truth["q3.zero"]) > 3 * wrong.sd["q3.zero"]


def test_measured_positions_with_fixed_points_give_the_scale() -> None:
    """Ten further poses are measured in a frame that is turned: no length is held any more."""
    free = ("zeros", "placements", "compliances")
    q, points, truth = drawn(free, 80, 5)
    more = np.random.default_rng(0).uniform(-1.5, 1.5, (10, 6))
    shift = np.array([0.3, -0.2, 0.1])
    there = flexgen.tracker_positions(robot_of(free, truth), more)
    there = there + NOISE * np.random.default_rng(1).normal(size=there.shape)
    turned = there @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + shift
    commands = np.concatenate([q, more])
    positions = np.concatenate([np.full((80, 1, 3), np.nan), turned])
    names = np.concatenate([points, np.full((10, 1), "")])
    poses = flexgen.StaticPoses(commands, positions, points=names)
    found = flexgen.calibrate(arm(), poses, free=free, priors=PRIORS)
    assert not any("scale" in text for text in found.warnings)
    assert found.determined["body3.y"]
    # of the file, which is that of the drawn robot
    assert abs(found.values["body3.y"]) < 3 * found.sd["body3.y"]
    assert np.nanmean(found.errors) < 1.6 * NOISE
    # the place of the first element does what the frame does, and is known to 3 mm and 3 mrad
    assert np.abs(found.frame[:3] - shift).max() < 0.01
    assert abs(found.frame[5] - np.pi / 2) < 0.01


def test_derivatives_of_distances_from_fixed_points_are_differences() -> None:
    tree = Tree(arm())
    rng = np.random.default_rng(2)
    groups = np.array([[0], [1], [-1], [1]])
    statics = Statics(tree, rng.uniform(-1.0, 1.0, (4, 6)), groups)
    unknowns = [*unknowns_of(tree, ("zeros",), (), PRIORS), *points_of(["a", "b"])]
    x = np.array([u.start + 0.1 * rng.normal() for u in unknowns])

    def measured(values: np.ndarray) -> np.ndarray:
        return statics.rest(Numbers.of(tree, unknowns, values)).measured

    numbers = Numbers.of(tree, unknowns, x)
    J, _ = statics.slopes(numbers, statics.rest(numbers), unknowns)
    for k in range(len(unknowns)):
        step = 1e-6 * (np.arange(len(unknowns)) == k)
        difference = (measured(x + step) - measured(x - step)) / 2e-6
        assert np.abs(J[..., k] - difference).max() < 1e-7


def test_fixed_points_of_a_file_are_those_of_arrays(tmp_path: Path) -> None:
    q, points, _ = drawn(("zeros",), 12, 0)
    lines = [",".join([*(f"q{k + 1}_rad" for k in range(6)), "tip_point"])]
    lines += [
        ",".join([*map(repr, row), name])
        for row, (name,) in zip(q.tolist(), points.tolist(), strict=True)
    ]
    file = tmp_path / "poses.csv"
    file.write_text("\n".join(lines))
    poses = flexgen.StaticPoses.read(file, arm())
    assert np.array_equal(poses.commands, q) and np.array_equal(poses.points, points)
    assert poses.point_names == ("far", "near") and not poses.is_measured
    found = flexgen.calibrate(arm(), poses, free=["zeros"], priors=PRIORS)
    assert "fixed points only: no frame of the measurement" in found.to_text()
    assert np.array_equal(found.frame, np.zeros(6)) and found.to_dict()["values"]["point.far.x"]
    assert found.predict(q).shape == (12, 1, 3)
    with pytest.raises(ArgumentError, match="new poses are chosen for positions"):
        found.propose_poses(3)


def test_poses_at_fixed_points_that_tell_nothing_are_refused() -> None:
    """Degrees for radians, one pose at a point, both a point and a position, an unknown place."""
    q, points, _ = drawn(("zeros",), 12, 0)
    cases = [
        (
            lambda: flexgen.calibrate(arm(), poses_of(np.rad2deg(q), points)),
            "probably joints in degrees",
        ),
        (
            lambda: poses_of(q, np.where(np.arange(12)[:, None] == 3, "one", points)),
            "given 1 pose at",
        ),
        (
            lambda: flexgen.StaticPoses(q, np.ones((12, 1, 3)), points=points),
            "of one tracker in row 1",
        ),
        (lambda: poses_of(q, points[:3]), "given points of shape"),
        (
            lambda: flexgen.calibrate(arm(), poses_of(q, points), place=["body3"]),
            "expected measured positions for elements",
        ),
    ]
    some = np.full((12, 1, 3), np.nan)
    some[:3] = 0.5
    beside = flexgen.StaticPoses(q, some, points=np.where(np.arange(12)[:, None] < 3, "", points))
    cases.append(
        (lambda: flexgen.calibrate(arm(), beside), "given 3 measured positions of tip beside")
    )
    for call, said in cases:
        with pytest.raises(ArgumentError, match=said):
            call()


def test_poses_without_any_motion_are_refused_and_not_divided_by() -> None:
    """One pose many times, and equal positions at different commands: ZeroDivisionError."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (8, 6))
    still = np.full((8, 1, 3), 0.5)
    for commands, said in ((np.tile(q[:1], (8, 1)), "1 different commands"), (q, "all equal")):
        with pytest.raises(ArgumentError, match=said):
            flexgen.calibrate(
                arm(), flexgen.StaticPoses(commands, still), progress=lambda text: None
            )
