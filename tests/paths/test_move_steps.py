"""Steps of moves and programs: what they mean, and what is refused, step by step.

More programs that are refused: `test_program.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.paths.path import Path
from flexgen.paths.reference import Reference

START = (0.3, -1.1, 1.0, 0.4, 0.8, -0.2)
PROFILE = (0.5, 5.0, 200.0)
JOINTS = (1.0, 5.0, 60.0)


@pytest.fixture(scope="module")
def arm() -> Any:
    """Its output is the pose of the tool."""
    return flexgen.derive("manutec_r3")


def polyline(*legs: MoveL, **more: Any) -> Move:
    return Move("m", "tool_polyline", START, 0.5, 5, legs=legs, **more)


def program(*steps: Any, profile: Any = PROFILE, joint_profile: Any = JOINTS) -> Program:
    return Program("m", start=START, steps=steps, profile=profile, joint_profile=joint_profile)


def matrix(R: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, R.tolist()))


def test_steps_from_where_the_tool_is_are_those_to_where_it_goes(arm: Any) -> None:
    """Displacements and rotations, or positions and orientations in the world: lines, arcs, turns
    about an axis.
    """
    p, R = (np.asarray(x) for x in Reference(arm).tool_pose(START))
    turn = np.array([0.0, 0.3, -0.4])
    turned = Rotation.from_rotvec(turn).as_matrix() @ R
    line = np.array([0.05, 0.0, 0.02])
    via = np.array([0.02, 0.03, 0.0])
    end = np.array([0.06, 0.0, 0.01])
    near = program(
        MoveL(tuple(line), zone=0.01),
        MoveC(tuple(end), via=tuple(via)),
        MoveL((0.0, 0.0, 0.01), rotation=tuple(turn)),
    )
    second = p + line
    third = second + end
    end_of_turn = third + np.array([0.0, 0.0, 0.01])
    world = program(
        MoveL(position=tuple(second), zone=0.01),
        MoveC(position=tuple(third), via=tuple(second + via)),
        MoveL(position=tuple(end_of_turn), orientation=matrix(turned)),
    )
    one, other = (Path(arm, given) for given in (near, world))
    t = np.linspace(0.0, 0.999 * one.duration, 201)  # at the end the third derivative jumps
    a = one.sample(t)
    b = other.sample(t)
    assert other.duration == pytest.approx(one.duration)
    assert_allclose(b.y, a.y, atol=1e-6)
    assert a.R is not None and b.R is not None
    assert_allclose(b.R, a.R, atol=1e-9)
    last = one.sample(np.array([one.duration]))
    assert last.R is not None
    assert_allclose(last.R[0], turned, atol=1e-12)
    assert_allclose(last.y[0, :, 0], end_of_turn, atol=1e-12)
    # the arc has one distance from the center of the circle through three points
    center = center_of(second, second + via, third)
    stop = one.segments[0].start + one.segments[0].law.duration
    inside = one.sample(np.linspace(0.8 * stop, stop, 50)).y[:, :, 0]
    assert_allclose(np.linalg.norm(inside - center, axis=1), np.linalg.norm(third - center))


def center_of(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Center of the circle through three points: equidistant, in their plane."""
    rows = np.array([b - a, c - a, np.cross(b - a, c - a)])
    half = [(b @ b - a @ a) / 2, (c @ c - a @ a) / 2, rows[2] @ a]
    return np.asarray(np.linalg.solve(rows, half))


X = (0.1, 0.0, 0.0)
Y = (0.0, 0.1, 0.0)
Z = (0.0, 0.0, 0.1)


def test_zones_of_two_corners_may_fill_a_step(arm: Any) -> None:
    path = Path(arm, polyline(MoveL(X, zone=0.04), MoveL(Y, zone=0.06), MoveL(Z)))
    (segment,) = path.segments
    sections: Any = segment.curve
    assert [s.corner for s in sections.sections] == [False, True, True, False]
    assert_allclose(sections.end[0], np.asarray(Reference(arm).tool_pose(START)[0]) + [0.1] * 3)
    planned = Path(arm, program(MoveL(X, speed=0.4), MoveJ((*START[:5], 0.3))))
    t = np.linspace(0.0, planned.segments[0].law.duration, 2001)
    speed = np.linalg.norm(planned.sample(t).y[:, :, 1], axis=1)
    assert speed.max() == pytest.approx(0.4, rel=1e-6)


TURN = matrix(Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix())
MIRROR = matrix(-np.array(TURN))
SHORT = MoveL((0.0, 0.04, 0.0))
CASES: list[tuple[Any, str]] = [
    (
        polyline(MoveL(X, zone=0.04), MoveL(Y, zone=0.061), MoveL(Z)),
        r"step 2: .*given zone 0\.04 and 0\.061, expected zones that fit into the length 0\.1 of "
        "step 2",
    ),
    (
        polyline(MoveL(X, zone=0.04), MoveL(Y, zone=0.04), MoveL(Z, zone=0.101), MoveL(X)),
        r"step 3: .*given zone 0\.04 and 0\.101, .* the length 0\.1 of step 3",
    ),
    (
        polyline(MoveL(X, zone=0.101), MoveL(Y)),
        r"step 1: .*given zone 0 and 0\.101, .* of step 1",
    ),
    (
        polyline(MoveL(X, zone=0.05), SHORT),
        r"step 1: .*given zone 0\.05 and 0, .* into the length 0\.04 of step 2",
    ),
    (
        polyline(MoveL(X, zone=0.03), MoveL(Y, zone=0.03)),
        r"step 2: .*given zone 0\.03, expected 0 at the end",
    ),
    (
        polyline(MoveL(X), MoveL(Y)),
        r"step 1: .*given zone 0\.0, expected a radius > 0 \[m\], because the tool does not stop",
    ),
    (polyline(), "given legs none, expected one or more"),
    (
        polyline(MoveL(X, zone=0.02), MoveL((-0.1, 0.0, 0.0))),
        "step 1: .*expected 0, because the path reverses here",
    ),
    (
        polyline(MoveL(X, speed=0.4)),
        r"step 1: .*given speed 0\.4, expected no speed, or a move with a profile",
    ),
    (program(MoveL(X), MoveL()), "step 2: .*expected either displacement or position"),
    (
        program(MoveL(X, rotation=(0.0, 0.0, 1.0), orientation=TURN)),
        "step 1: .*expected either rotation or orientation",
    ),
    (program(MoveL(X, orientation=MIRROR)), "step 1: .*expected a rotation matrix"),
    (polyline(MoveL(X, zone=-0.1)), r"step 1: .*expected a radius >= 0 \[m\]"),
    (program(MoveL(X, zone=-1e-9)), "step 1: .*expected a zone >= 0"),
    (program(MoveL(X, pause=-1e-9)), r"step 1: .*expected a time >= 0 \[s\]"),
    (
        program(MoveL(X, zone=0.01), MoveJ(START)),
        "step 1: .*expected 0 between a MoveJ and a move of the tool",
    ),
]


@pytest.mark.parametrize(("given", "text"), CASES)
def test_steps_that_are_refused(given: Any, text: str, arm: Any) -> None:
    with pytest.raises(ArgumentError, match=f"^move m.*{text}|^program m.*{text}"):
        Path(arm, given)


@pytest.mark.parametrize(("across", "good"), [(0.0, True), (0.3, False)])
def test_a_path_across_the_axes_of_the_output_is_refused(across: float, good: bool) -> None:
    """The elbow moves in the plane of x and z."""
    equations = flexgen.derive("elbow")
    given = Move("m", "tool_line", (0.3, 0.8), 1.0, 5, (-0.1, across, 0.05))
    if good:
        Path(equations, given)
        return
    text = r"0\.3 m along y.*a path along x, z only, because the output has"
    with pytest.raises(ArgumentError, match=text):
        Path(equations, given)
