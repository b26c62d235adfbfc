"""Joint moves to poses of the tool: the joints that Lagrange's kinematics say, or an error with
file, line and key.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.model.elements import RobotModel
from flexgen.model.moves import Move, MoveJ, MoveL, PoseTarget, Program
from flexgen.paths.inverse_kinematics import targets
from flexgen.paths.inverse_kinematics.search import configuration_at, kinematics
from flexgen.paths.inverse_kinematics.targets import SLACK, choose_turns, joints_of_target
from flexgen.paths.move_files import read_moves
from flexgen.paths.path import plan

pytestmark = needs_compiler
BOUNDS = {"profile": (0.5, 5.0, 100.0, 4000.0), "joint_profile": (1.0, 10.0, 200.0, 9000.0)}
HEAD = """
[[program]]
name = "there"
start_deg = [0.0, 20.0, 70.0, 0.0, 60.0, 0.0]
profile = [0.5, 5.0, 100.0, 4000.0]
joint_profile_deg = [60.0, 500.0, 8000.0, 300000.0]

[[program.step]]
"""


@cache
def robot() -> RobotModel:
    return flexgen.read("manutec_r3")


def pose(q: np.ndarray) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...]]:
    """Position and rotation of the tool by Lagrange's kinematics, which share no code with the
    emitted ones.
    """
    p, R = evaluate(flexgen.derive("manutec_r3").function("forward_kinematics"), q[None])
    return tuple(map(float, p.ravel())), tuple(tuple(map(float, row)) for row in R.reshape(3, 3))


def end_of(program: Move) -> np.ndarray:
    path = plan(robot(), program)
    return np.asarray(path.sample(np.array([path.duration])).q_g[0, :, 0])


def joints(n: int) -> np.ndarray:
    """Random joints off singular poses."""
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (4 * n, 6))
    return np.array([x for x in q if configuration_at(robot(), x).distance > 1e-2][:n])


def refused(key: str, given: object, expected: str) -> Exception:
    return ArgumentError(f"{key}: given {given}, expected {expected}")


def read(tmp_path: Path, step: str) -> Move:
    (tmp_path / "there.toml").write_text(HEAD + step, encoding="utf-8")
    return read_moves(tmp_path / "there.toml", robot())[0]


START = np.radians([0.0, 20.0, 70.0, 0.0, 60.0, 0.0])


def moved(target: PoseTarget, start: np.ndarray = START) -> Program:
    return Program("there", start=tuple(start), steps=(MoveJ(target=target),), **BOUNDS)


@pytest.mark.slow
def test_a_configuration_leads_to_its_joints() -> None:
    """Random joints: the pose of Lagrange's kinematics with their signs and turns gives them
    back.
    """
    checked = 0
    for q in joints(20):
        flags = configuration_at(robot(), q).flags
        target = PoseTarget(*pose(q), flags, (0,) * 6)
        same = [c for c in kinematics(robot(), *map(np.array, pose(q))) if c.flags == flags]
        if len(same) > 1:
            with pytest.raises(
                ArgumentError, match="solutions within the limits have these signs"
            ):
                joints_of_target(robot(), target, START, refused)
            continue
        # the solutions are polished to 1e-12 of the pose, and singular values are above 1e-2
        assert np.abs(joints_of_target(robot(), target, START, refused) - q).max() < 1e-9
        checked += 1
    assert checked >= 15


def test_turns_are_those_that_are_named_or_the_closest_within_the_limits() -> None:
    q = START + np.array([0.1, -0.2, 0.2, 0.3, 0.2, 0.5])
    turn = np.array([0, 0, 0, 0, 0, 2 * np.pi])
    target = PoseTarget(*pose(q), configuration_at(robot(), q).flags)
    assert np.abs(end_of(moved(target)) - q).max() < 1e-9
    assert np.abs(end_of(moved(target, START + turn)) - q - turn).max() < 1e-9
    named = replace(target, turns=(0, 0, 0, 0, 0, -1))
    assert np.abs(joints_of_target(robot(), named, START + turn, refused) - q + turn).max() < 1e-9
    last = robot().i_g[5]
    coordinates = list(robot().coordinates)
    dof = coordinates[last].dof
    assert dof is not None
    element = next(e for e in robot().elements if dof in e.dofs)
    limited_dof = replace(dof, lower=-4.0, upper=4.0)
    limited = replace(
        robot(),
        elements=tuple(
            replace(e, dofs=tuple(limited_dof if d is dof else d for d in e.dofs))
            if e is element
            else e
            for e in robot().elements
        ),
    )
    assert np.abs(joints_of_target(limited, target, START + turn, refused) - q).max() < 1e-9
    with pytest.raises(ArgumentError, match=r"turns: given .*within their limits"):
        joints_of_target(limited, named, START, refused)


@pytest.mark.parametrize(
    ("limits", "before", "turns", "chosen"),
    [
        ((None, None), 0.0, (), 0),
        ((None, None), 4.0, (), 1),
        ((None, None), -6.0, (), -1),
        ((None, None), 0.0, (-2,), -2),
        ((None, None), 9.0, (0,), 0),
        ((1.0, None), 0.0, (), 1),
        ((None, 0.0), 0.0, (), -1),
        ((8.0, None), 0.0, (), 2),
        ((20.0, None), 0.0, (), None),
        ((1.0, 6.0), 0.0, (), None),
        ((None, 3.0), 0.0, (1,), None),
        ((0.5 + 0.5 * SLACK, None), 0.0, (), 0),
        ((0.5 + 2 * SLACK, 1.0), 0.0, (), None),
    ],
)
@pytest.mark.parametrize("given", [-1, 0, 3])
def test_turns_are_the_closest_to_the_start_within_the_limits(
    limits: tuple[float | None, ...],
    before: float,
    turns: tuple[int, ...],
    chosen: int | None,
    given: int,
) -> None:
    """Of an angle of half a radian that is stated with any number of turns."""
    q = np.array([0.5 + given * 2 * np.pi])
    found = choose_turns(one_joint("rotation", limits), q, np.array([before]), turns)
    expected = None if chosen is None else pytest.approx([0.5 + chosen * 2 * np.pi])
    assert (None if found is None else found.tolist()) == expected


@pytest.mark.parametrize(("upper", "chosen"), [(None, [0.5]), (0.4, None)])
def test_a_slide_has_no_turns(upper: float | None, chosen: list[float] | None) -> None:
    slide = one_joint("translation", (None, upper))
    found = choose_turns(slide, np.array([0.5]), np.array([9.0]), ())
    assert (None if found is None else found.tolist()) == chosen


def one_joint(kind: str, limits: tuple[float | None, ...]) -> RobotModel:
    """The first joint of the elbow with these limits."""
    elbow = flexgen.read("elbow")
    first = elbow.elements[0]
    dof = replace(first.dofs[0], type=kind, lower=limits[0], upper=limits[1])
    return replace(
        elbow, elements=(replace(first, dofs=(dof,)),), motors=elbow.motors[:1], home=(0.0,)
    )


def test_a_sign_that_is_ignored_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: the first configuration of the search, whatever was asked for."""
    q = START + np.array([0.1, -0.2, 0.2, 0.3, 0.2, 0.5])
    found = [c for c in kinematics(robot(), *map(np.array, pose(q))) if c.within_limits]
    other = next(c for c in found if c.flags != found[0].flags)
    assert np.abs(end_of(moved(PoseTarget(*pose(q), other.flags))) - other.q).max() < 1e-9
    monkeypatch.setattr(targets, "kinematics", lambda *_: (found[0],))
    with pytest.raises(ArgumentError, match="configuration"):
        end_of(moved(PoseTarget(*pose(q), other.flags)))


def rpy_text(q: np.ndarray) -> str:
    """Position and roll, pitch, yaw of joints as keys of a file."""
    p, R = pose(q)
    rpy = map(
        float, (np.arctan2(R[2][1], R[2][2]), -np.arcsin(R[2][0]), np.arctan2(R[1][0], R[0][0]))
    )
    return f"position = {list(p)}\nrpy_rad = {list(rpy)}\n"


def test_a_file_names_a_pose_and_a_line_ends_in_its_configuration(tmp_path: Path) -> None:
    q = START + np.array([0.1, -0.2, 0.2, 0.3, 0.2, 0.5])
    flags = list(configuration_at(robot(), q).flags)
    text = f'type = "MoveJ"\n{rpy_text(q)}configuration = {flags}\n'
    assert np.abs(end_of(read(tmp_path, text)) - q).max() < 1e-7  # roll, pitch, yaw lose digits
    line = '[[program.step]]\ntype = "MoveL"\ndisplacement = [0.02, 0.03, 0.0]\nconfiguration = '
    program = read(tmp_path, f"{text}{line}{flags}\n")
    assert plan(robot(), program).duration > 0
    with pytest.raises(ModelError, match="a move of the tool cannot change it") as caught:
        plan(robot(), read(tmp_path, f"{text}{line}{[-flags[0], *flags[1:]]}\n"))
    assert "there.toml:16:program.there.step[1].configuration" in str(caught.value)


WRONG = {
    "unreachable": ("position = [9.0, 0.0, 0.0]\nrpy_deg = [0, 0, 0]\n", "can reach", "position"),
    "no rotation": ("position = [0.5, 0.6, 1.2]\n", "rpy_rad", "rpy_rad"),
    "both": (
        "position = [0.5, 0.6, 1.2]\nrpy_deg = [0, 0, 0]\nend_rad = [0, 0, 0, 0, 0, 0]\n",
        "both",
        "position",
    ),
    "signs": (
        "position = [0.5, 0.6, 1.2]\nrpy_deg = [0, 0, 0]\nconfiguration = [1, 2, 1]\n",
        "1 or -1",
        "configuration",
    ),
    "turns": (
        "position = [0.5, 0.6, 1.2]\nrpy_deg = [0, 0, 0]\nturns = [0, 0, 0, 0, 0, 0.5]\n",
        "whole",
        "turns",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_target_names_file_line_and_key(case: str, tmp_path: Path) -> None:
    step, expected, key = WRONG[case]
    with pytest.raises(ModelError, match=expected) as caught:
        plan(robot(), read(tmp_path, f'type = "MoveJ"\n{step}'))
    message = str(caught.value)
    assert "there.toml" in message and key in message


def test_ambiguous_and_singular_targets_are_refused(tmp_path: Path) -> None:
    q = START + np.array([0.1, -0.2, 0.2, 0.3, 0.2, 0.5])
    with pytest.raises(ModelError, match="one of the configurations") as caught:
        plan(robot(), read(tmp_path, f'type = "MoveJ"\n{rpy_text(q)}'))
    assert "there.toml:8:program.there.step[0].configuration: given none" in str(caught.value)
    flags = {c.flags for c in kinematics(robot(), *map(np.array, pose(q)))}
    assert all(str(list(signs)) in str(caught.value) for signs in flags)
    missing = next(s for s in product((1, -1), repeat=3) if s not in flags)
    with pytest.raises(ModelError, match="one of the configurations") as caught:
        plan(
            robot(),
            read(tmp_path, f'type = "MoveJ"\n{rpy_text(q)}configuration = {list(missing)}\n'),
        )
    assert f"there.toml:12:program.there.step[0].configuration: given {list(missing)}" in str(
        caught.value
    )
    straight = np.array([0.1, 0.3, 1.2, 0.4, 0.0, 0.2])  # the axes of joints 4 and 6 are one line
    with pytest.raises(ModelError, match="singular") as caught:
        plan(robot(), read(tmp_path, f'type = "MoveJ"\n{rpy_text(straight)}'))
    assert "there.toml:10:program.there.step[0].position" in str(caught.value)


def test_arms_without_six_joints_and_bad_values_are_refused() -> None:
    target = PoseTarget((0.5, 0.0, 0.0), ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    planar = Program("there", start=(0.3, -1.1), steps=(MoveJ(target=target),), **BOUNDS)
    with pytest.raises(ArgumentError, match="six actuated"):
        plan("planar5_nmp", planar)
    wrong_steps = [
        MoveJ(end=tuple(START), target=target),
        MoveJ(target=PoseTarget((0.5, np.inf, 0.0), target.orientation)),
        MoveJ(target=PoseTarget(target.position, ((2, 0, 0), (0, 1, 0), (0, 0, 1)))),
        MoveJ(target=PoseTarget(target.position, target.orientation, (1, 1))),
        MoveJ(target=PoseTarget(target.position, target.orientation, (), (1, 2))),
        MoveL((0.02, 0.0, 0.0), configuration=(1, 0, 1)),
    ]
    with pytest.raises(
        ArgumentError,
        match=r"PoseTarget, position: given \(0\.5, nan, 0\.0\), expected a sequence",
    ):
        PoseTarget((0.5, np.nan, 0.0), target.orientation)
    for step in wrong_steps:
        with pytest.raises(ArgumentError, match="there, step 1"):
            plan(robot(), Program("there", start=tuple(START), steps=(step,), **BOUNDS))


def test_a_joint_move_of_the_model_ends_at_a_pose() -> None:
    q = START + np.array([0.1, -0.2, 0.2, 0.3, 0.2, 0.5])
    target = PoseTarget(*pose(q), configuration_at(robot(), q).flags)
    found = end_of(Move("there", "joint", tuple(START), 1.0, 5, target=target))
    assert np.abs(found - q).max() < 1e-9


def test_signs_and_turns_may_be_lists_and_arrays():
    matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    given = flexgen.PoseTarget(
        (0.5, 0.0, 0.5), matrix, configuration=[1, -1, -1], turns=np.zeros(6)
    )
    assert given == flexgen.PoseTarget((0.5, 0.0, 0.5), matrix, (1, -1, -1), (0,) * 6)
