"""Time laws and paths: derivatives against finite differences and closed forms, ends at rest."""

from __future__ import annotations

import pickle
from pathlib import Path as FilePath

import numpy as np
import pytest
from path_derivatives import DIFFERENCE, derivatives_agree

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.paths.geometry.blended_curve import BlendedCurve
from flexgen.paths.geometry.segments import Line
from flexgen.paths.path import Path, chain_rule
from flexgen.paths.timing.move_planner import plan_move
from flexgen.paths.timing.time_laws import TimeLaw


@pytest.mark.parametrize("smoothness", [3, 5, 7, 9])
def test_time_law_is_smooth_and_at_rest_at_both_ends(smoothness: int) -> None:
    law = TimeLaw(0.5, smoothness)
    ends = law(np.array([-1.0, 0.0, 0.5, 2.0]))
    assert np.array_equal(ends[:, 0], [0, 0, 1, 1])
    assert not ends[:, 1:].any()
    # continuous derivatives: the value just inside is as small as the distance allows
    near = np.abs(law(np.array([1e-4, 0.5 - 1e-4]))[:, 1 : min(smoothness, 5) + 1])
    assert (
        near < 1e-2 * np.abs(law(np.linspace(0, 0.5, 99))).max(axis=0)[1 : min(smoothness, 5) + 1]
    ).all()
    middle = law(np.array([0.25]))[0]
    assert abs(middle[0] - 0.5) < 1e-15 and abs(middle[2]) < 1e-9


def test_time_law_matches_the_quintic_of_the_textbooks() -> None:
    u = np.linspace(0, 1, 11)
    # the textbook's sum itself loses as many units as its coefficients add up to: 31 eps
    assert (
        np.abs(TimeLaw(1.0, 2)(u)[:, 0] - (10 * u**3 - 15 * u**4 + 6 * u**5)).max() < 31 * 2.3e-16
    )


def test_time_law_derivatives() -> None:
    t = np.linspace(0.001, 0.499, 4001)
    assert derivatives_agree(t, TimeLaw(0.5, 7)(t)) < DIFFERENCE


def test_a_time_law_refuses_invalid_arguments() -> None:
    with pytest.raises(ArgumentError, match="duration: given 0"):
        TimeLaw(0.0, 5)
    with pytest.raises(ArgumentError, match="smoothness: given 12"):
        TimeLaw(1.0, 12)


def test_chain_rule_on_a_known_function() -> None:
    # f(s) = exp(2 s), s = t^3: compare with the derivatives of exp(2 t^3), by hand
    t = np.array([0.3, 0.7])
    s = np.stack([t**3, 3 * t**2, 6 * t, 6 + 0 * t, 0 * t, 0 * t], axis=1)
    f = [(2**k * np.exp(2 * t**3))[:, None] for k in range(4)]
    e = np.exp(2 * t**3)
    expected = [e, 6 * t**2 * e, (12 * t + 36 * t**4) * e, (12 + 216 * t**3 + 216 * t**6) * e]
    for found, right in zip(chain_rule(f, s), expected, strict=True):
        assert np.abs(found[:, 0] / right - 1).max() < 1e-14


@pytest.mark.parametrize(
    ("name", "move"),
    [
        ("planar5_nmp", "line"),
        ("planar5_nmp", "joints"),
        ("four_mass", "step"),
        ("manutec_r3", "line"),
        ("manutec_r3", "joints"),
        ("beam_arm", "line"),
    ],
)
def test_path_derivatives(name: str, move: str) -> None:
    equations = flexgen.derive(name)
    path = Path(equations, equations.model.move(move))
    # two stretches apart from the ends, so that the highest derivative is continuous in between
    t = np.linspace(0.05, 0.95, 6001) * path.duration
    sample = path.sample(t)
    assert derivatives_agree(t, sample.y) < DIFFERENCE
    if sample.q_g is not None:
        assert derivatives_agree(t, sample.q_g) < DIFFERENCE
    if sample.R is not None and sample.w is not None:
        assert derivatives_agree(t, sample.w) < DIFFERENCE
        h = t[1] - t[0]
        rate = (sample.R[2:] - sample.R[:-2]) / (2 * h)
        omega = rate @ sample.R[1:-1].transpose(0, 2, 1)
        axial = np.stack([omega[:, 2, 1], omega[:, 0, 2], omega[:, 1, 0]], axis=1)
        assert np.abs(axial - sample.w[1:-1, :, 0]).max() < 1e-5 * np.abs(sample.w).max() + 1e-9
        assert np.abs(sample.R @ sample.R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-14


def test_tool_line_with_rotation_turns_about_its_axis() -> None:
    equations = flexgen.derive("manutec_r3")
    start = equations.model.move("line").start
    turn = (0.0, 0.0, 0.7)
    path = Path(
        equations,
        Move("turn", "tool_line", start, 1.0, 5, displacement=(0.1, 0, 0), rotation=turn),
    )
    sample = path.sample(np.array([0.0, 1.0]))
    assert sample.R is not None
    c = np.cos(0.7)
    s = np.sin(0.7)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert np.abs(sample.R[1] @ sample.R[0].T - about_z).max() < 1e-14
    assert np.allclose(sample.y[1, :, 0] - sample.y[0, :, 0], [0.1, 0, 0], atol=1e-15)


def test_a_joint_move_ends_at_its_joint_angles() -> None:
    equations = flexgen.derive("manutec_r3")
    move = equations.model.move("joints")
    sample = Path(equations, move).sample(np.array([0.0, move.duration]))
    for k, q in enumerate((move.start, move.end)):
        p, R = evaluate(equations.function("forward_kinematics"), np.array(q))
        assert np.abs(sample.y[k, :, 0] - p[0]).max() < 1e-14
        assert sample.R is not None and np.abs(sample.R[k] - R[0]).max() < 1e-14


def test_paths_and_planned_moves_are_pickled(tmp_path: FilePath) -> None:
    """Every type of curve and law; the copy gives the same samples, to the bit."""
    arm = flexgen.derive("planar5_nmp")
    legs = (MoveL((-0.1, 0.0, 0.0), zone=0.03), MoveC((0.0, 0.1, 0.0), via=(0.03, 0.05, 0.0)))
    swing = MoveJ((0.6, -1.4), zone=0.05), MoveJ((0.5, -1.0))
    file = tmp_path / "joints.csv"
    file.write_text(
        "q1,q2\n" + "".join(f"{0.3 + 0.02 * k},{-1.1 + 0.01 * k**2}\n" for k in range(9))
    )
    moves = [
        *arm.model.moves,
        Move("track", "sampled", (), 1.0, 5, file=str(file)),
        Move("corner", "tool_polyline", (0.3, -1.1), 0.5, 6, legs=legs),
        Program(
            "swing",
            start=(0.3, -1.1),
            steps=(*swing, *legs),
            profile=(0.5, 5.0, 90.0),
            joint_profile=(2.0, 9.0),
        ),
        Program(
            "smooth",
            start=(0.3, -1.1),
            steps=swing,
            joint_profile=(2.0, 10.0, 200.0),
            smoothness=4,
        ),
    ]
    for move in moves:
        path = Path(arm, move)
        t = np.linspace(-0.01, path.duration + 0.01, 50)
        sample = path.sample(t)
        planned = plan_move(path.reference, move)
        copy, segments = pickle.loads(pickle.dumps((path, planned)))
        again = copy.sample(t)
        for name in ("y", "R", "w", "q_g"):
            expected = getattr(sample, name)
            assert (expected is None) == (getattr(again, name) is None)
            assert expected is None or np.array_equal(getattr(again, name), expected)
        assert np.array_equal(copy.breaks, path.breaks) and copy.move == path.move
        assert np.array_equal(segments.q_g, planned.q_g)
        for one, other in zip(segments.segments, planned.segments, strict=True):
            assert np.array_equal(one.at(t)[0], other.at(t)[0])


LINE = {"start": (0.3, -1.1), "type": "tool_line", "displacement": (0.1, 0.05, 0.0)}
AGAIN = {
    "trapezoids": Move(
        "trapezoids", duration=0.0, smoothness=0, profile=(0.5, 5.0, 100.0), **LINE
    ),
    "smooth steps": Move("steps", duration=0.0, smoothness=5, profile=(0.5, 5.0, 100.0), **LINE),
    "duration": Move("duration", duration=0.5, smoothness=5, **LINE),
    "program": Program(
        name="program",
        start=(0.3, -1.1),
        steps=(MoveJ((0.5, -1.2)), MoveL((0.05, 0, 0))),
        profile=(0.5, 5.0, 100.0),
        joint_profile=(2.0, 20.0, 300.0),
    ),
}


@pytest.mark.parametrize("kind", AGAIN)
def test_a_planned_move_plans_the_same_path_again(kind: str) -> None:
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, AGAIN[kind])
    again = Path(equations, path.move)
    assert (
        again.duration == path.duration == path.move.duration
        and again.smoothness == path.smoothness
    )
    t = np.linspace(0.0, path.duration, 50)
    assert np.array_equal(again.sample(t).y, path.sample(t).y)


@pytest.mark.parametrize(
    ("move", "words"),
    [
        (
            Move("up", "tool_line", (0.3, -1.1), 0.5, 5, displacement=(0.1, 0.0, 0.05)),
            "with 0.05 m along z",
        ),
        (
            Move(
                "arc",
                "tool_circle",
                (0.3, -1.1),
                0.5,
                5,
                center=(0.1, 0, 0),
                axis=(0, 1, 1),
                angle=0.3,
            ),
            r"axis with 0\.0\d+ m along z",
        ),
        (
            Program(
                name="seam",
                start=(0.3, -1.1),
                steps=(MoveL((0.0, 0.05, 0.1)),),
                profile=(1.0, 10.0, 100.0),
            ),
            "with 0.1 m along z",
        ),
        (
            Move(
                "turn",
                "tool_line",
                (0.3, -1.1),
                0.5,
                5,
                displacement=(0.1, 0, 0),
                rotation=(0, 0, 0.3),
            ),
            "expected no rotation, because the output is the position of the tool",
        ),
    ],
)
def test_motion_that_is_not_an_output_is_refused(move: Move, words: str) -> None:
    """It was planned before, and not carried out."""
    with pytest.raises(ArgumentError, match=words):
        flexgen.plan("planar5_nmp", move)


def test_a_file_with_motion_that_is_not_an_output_is_refused(tmp_path: FilePath) -> None:
    file = tmp_path / "path.csv"
    t = np.linspace(0.0, 0.5, 41)
    s = 10 * (t / 0.5) ** 3 - 15 * (t / 0.5) ** 4 + 6 * (t / 0.5) ** 5
    x, y, _ = (
        flexgen.derive("planar5_nmp")
        .function("forward_kinematics")([0.3, -1.1, 0.0])[0]
        .full()
        .ravel()
        .tolist()
    )
    for height, fine in ((0.0, True), (0.05, False)):
        rows = [
            f"{a!r},{x - 0.1 * b!r},{y!r},{height * b!r}"
            for a, b in zip(t.tolist(), s.tolist(), strict=True)
        ]
        file.write_text("t,x,y,z\n" + "\n".join(rows) + "\n")
        move = Move("file", "sampled", (0.3, -1.1), 0.0, 0, file=str(file))
        if fine:
            assert flexgen.plan("planar5_nmp", move).duration == pytest.approx(0.5)
            continue
        with pytest.raises(ArgumentError, match=r"with 0\.05 m along z"):
            flexgen.plan("planar5_nmp", move)


def test_sections_of_a_blended_curve_follow_each_other() -> None:
    """Lines and corners of three zones: one begins where the other ends, from 0 to the sum of the
    lengths.
    """
    lines = [
        Line(np.array(x), np.zeros(3), largest=True)
        for x in ([1.0, 0.0], [0.5, 2.0], [-3.0, 0.0], [0.0, 1.0])
    ]
    zones = [0.3, 0.1, 0.2]
    found = BlendedCurve(np.zeros(2), None, lines, zones).sections
    sizes = [2 * zones[x.segment] if x.corner else x.length for x in found]
    assert [x.start for x in found] == pytest.approx([0.0, *np.cumsum(sizes)[:-1]]) and sum(
        sizes
    ) == pytest.approx(7.0)


def test_a_joint_move_has_the_bounds_of_the_joint_that_moves_furthest() -> None:
    arm = flexgen.derive("planar5_nmp")
    ends = {"one": (0.5, -1.1), "both": (0.5, -0.9)}
    moves = [
        Move(name, "joint", (0.3, -1.1), 0.0, 0, end=end, profile=(0.5, 5.0, 100.0))
        for name, end in ends.items()
    ]
    one, both = (Path(arm, move).duration for move in moves)
    assert both == pytest.approx(one, rel=1e-9)
