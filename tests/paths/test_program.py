"""Programs: continuous, at rest at stops, within zones and bounds, with the correct joint
configuration.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.judge.status import Status
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.paths.path import Path
from flexgen.paths.timing.joint_limits import InverseKinematics

HERE = FilePath(__file__).parents[1] / "support"
EXAMPLE = HERE.parents[1] / "examples" / "program.toml"
PROFILE = (0.5, 5.0, 100.0, 4000.0)
JOINTS = (2.0, 10.0, 200.0, 8000.0)
WITHIN = 1e-6  # relative, excess of a bound before a segment is slowed down


@pytest.fixture(scope="module")
def arm():
    return flexgen.derive("planar5_nmp")


@pytest.fixture(scope="module")
def robot():
    return flexgen.derive("manutec_r3")


@pytest.fixture(scope="module")
def seam(arm):
    return Path(arm, flexgen.read_moves(EXAMPLE, arm.model)[-1])


@pytest.fixture(scope="module")
def tour(robot):
    return Path(robot, flexgen.read_moves(HERE / "programs" / "manutec.toml", robot.model)[0])


def roughness(path: Path) -> float:
    """Largest jump of a derivative up to the path's smoothness, at all breaks, relative to its
    size.
    """
    d = 1e-9 * path.duration
    every = path.sample(np.linspace(0, path.duration, 2001))
    left = path.sample(path.breaks - d)
    right = path.sample(path.breaks + d)
    worst = 0.0
    for k in range(1, path.smoothness + 1):
        scale = np.abs(every.derivative(k)).max()
        worst = max(worst, float(np.abs(right.derivative(k) - left.derivative(k)).max() / scale))
    place = np.abs(right.y[:, :, 0] - left.y[:, :, 0]).max()
    turn = 0.0 if left.R is None else np.abs(right.R - left.R).max()
    return max(worst, float(place), float(turn))


@pytest.mark.parametrize("name", ["seam", "tour"])
def test_programs_are_as_smooth_as_they_say(name: str, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(name)
    assert path.smoothness == {"seam": 4, "tour": 3}[name]
    # the slope of the next derivative over the distance of the two sides
    assert roughness(path) < 1e-5
    ends = path.sample(np.array([-1.0, 0.0, path.duration, path.duration + 1.0]))
    assert (
        not ends.y[:, :, 1:].any()
        and np.array_equal(ends.y[0], ends.y[1])
        and np.array_equal(ends.y[2], ends.y[3])
    )
    assert path.move.duration == path.duration and path.move.name == name


def test_a_rough_program_would_be_seen(seam, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seam, "smoothness", 5)
    assert roughness(seam) > 1e-3


def test_programs_pass_where_they_should(seam, arm) -> None:
    p, _ = seam.reference.tool_pose((0.6, -1.4))
    corner = p + np.array([-0.12, 0, 0])
    second = corner + np.array([0, 0.12, 0])
    end = second + np.array([0.08, 0.06, 0])
    stops = [leg.start + leg.law.duration for leg in seam.segments]
    at = seam.sample(np.array(stops)).y[:, :, 0]
    assert np.abs(at - [p[:2], end[:2], seam.reference.outputs((0.3, -1.1))]).max() < 1e-11
    fine = seam.sample(np.linspace(stops[0], stops[1], 8001)).y[:, :, 0]
    gaps = [np.linalg.norm(fine - q[:2], axis=1).min() for q in (corner, second)]
    assert 0.001 < gaps[0] < 0.03 and 1e-4 < gaps[1] < 0.02
    # the arc: all its points have the same distance from its centre
    via = second + np.array([0.03, 0.05, 0])
    centre = np.linalg.solve(
        2 * np.array([via - second, end - second])[:, :2],
        [v @ v - second[:2] @ second[:2] for v in (via[:2], end[:2])],
    )
    last = fine[-1200:]
    spread = np.ptp(np.linalg.norm(last - centre, axis=1))
    assert spread < 1e-12
    assert seam.segments[2].start - stops[1] == pytest.approx(0.1, abs=1e-12)


@pytest.mark.slow
def test_bounds_and_speeds_are_kept(seam, tour) -> None:
    for path in (seam, tour):
        program = path.move
        for leg in path.segments:
            t = leg.start + np.linspace(0, leg.law.duration, 20001)
            x, turn = leg.at(t)
            if leg.space == "joint":
                peaks = np.abs(x[:, :, 1:]).max(axis=(0, 1))
                bounds = program.joint_profile
            else:
                peaks = np.linalg.norm(x[:, :, 1:], axis=1).max(axis=0)
                bounds = program.profile
                if turn is not None:
                    peaks = np.maximum(
                        peaks, program.radius * np.linalg.norm(turn[1], axis=1).max(axis=0)
                    )
            for peak, bound in zip(peaks, bounds, strict=False):
                assert peak <= bound * (1 + WITHIN)
    # the first step along the seam has a speed of its own
    leg = seam.segments[1]
    first = leg.curve.sections[0].length
    t = leg.start + np.linspace(0, leg.law.duration, 4001)
    on = leg.law(t - leg.start)[:, 0] < first
    speed = np.linalg.norm(seam.sample(t).y[:, :, 1], axis=1)
    assert 0.18 < speed[on].max() <= 0.2 * (1 + WITHIN)
    assert speed[~on].max() > 0.22


@pytest.mark.slow
def test_joint_limits_of_the_model_are_kept(robot, tour) -> None:
    model = robot.model
    kinematics = InverseKinematics(robot)
    for leg in tour.segments:
        t = leg.start + np.linspace(0, leg.law.duration, 1501)
        sample = tour.sample(t)
        if leg.space == "joint":
            q, v, a = np.moveaxis(leg.at(t)[0][:, :, :3], 2, 0)
        else:
            q = kinematics.follow(
                sample, tour.segments[0].at(np.array([tour.segments[1].start]))[0][0, :, 0]
            )
            v, a = kinematics.velocities(sample, q)
        assert kinematics.slowdown(v, a) < 1 + 1e-4  # looked at 401 instants when it was planned
        for k, i in enumerate(model.i_g):
            assert np.abs(v[:, k]).max() <= model.coordinates[i].dof.speed_max * (1 + 1e-4)
        # the rates are those of the postures
        h = t[1] - t[0]
        assert (
            np.abs(np.gradient(q, h, axis=0)[5:-5] - v[5:-5]).max() < 1e-4 * np.abs(v).max() + 1e-6
        )
    assert max(leg.law.time_scale for leg in tour.segments) > 1.01  # a limit did slow one


def test_motor_speeds_slow_a_path(arm) -> None:
    step = (MoveJ((0.8, -1.5)),)
    program = Program("p", start=(0.3, -1.1), steps=step, joint_profile=JOINTS)
    free = Path(arm, program)
    motors = tuple(replace(m, speed_max=100.0) for m in arm.model.motors)
    slow = Path(Equations(replace(arm.model, motors=motors)), program)
    turns = slow.sample(np.linspace(0, slow.duration, 4001)).q_g[:, :, 1] @ arm.model.eta.T
    assert slow.duration > free.duration
    assert np.abs(turns).max() == pytest.approx(100.0, rel=1e-4) and np.abs(turns).max() <= 100 * (
        1 + WITHIN
    )


def test_joint_limits_slow_a_line(robot) -> None:
    """A line that is asked for in no time takes as long as the joints need."""
    start = robot.model.move("line").start
    fast = Move(
        "fast", "tool_line", start, 0.0, 0, (0.2, 0.2, -0.1), profile=(50.0, 500.0, 50000.0, 5e6)
    )
    path = Path(robot, fast)
    t = np.linspace(0, path.duration, 2001)
    sample = path.sample(t)
    kinematics = InverseKinematics(robot)
    q = kinematics.follow(sample, np.array(start))
    assert kinematics.slowdown(*kinematics.velocities(sample, q)) == pytest.approx(1.0, abs=2e-3)


def test_steps_in_joints_flow_into_each_other(arm) -> None:
    steps = (MoveJ((0.6, -1.1), zone=0.1), MoveJ((0.6, -1.5), zone=0.1), MoveJ((0.9, -1.5)))
    path = Path(
        arm, Program("p", start=(0.3, -1.1), steps=steps, joint_profile=JOINTS, smoothness=5)
    )
    sample = path.sample(np.linspace(0, path.duration, 8001))
    assert len(path.segments) == 1 and sample.q_g is not None and path.smoothness == 5
    assert np.abs(sample.q_g[-1, :, 0] - (0.9, -1.5)).max() < 1e-15
    moving = np.abs(sample.q_g[1:-1, :, 1]).max(axis=1)
    assert moving[800:-800].min() > 0.4  # it does not stop on its way
    for corner in ((0.6, -1.1), (0.6, -1.5)):
        assert 1e-3 < np.abs(sample.q_g[:, :, 0] - corner).max(axis=1).min() < 0.1
    places = np.array([path.reference.outputs(q) for q in sample.q_g[::800, :, 0]])
    assert np.abs(places - sample.y[::800, :, 0]).max() < 1e-14


def test_absolute_and_relative_ends_agree(robot) -> None:
    start = robot.model.move("line").start
    probe = Path(robot, robot.model.move("line"))
    p, R = probe.reference.tool_pose(start)
    by = Program(
        "p",
        start=start,
        profile=PROFILE,
        steps=(
            MoveL((0.1, 0, 0), rotation=(0, 0, 0.3), zone=0.03),
            MoveC((0, 0.1, 0), via=(0.05, 0.05, 0.02)),
        ),
    )
    c = np.cos(0.3)
    s = np.sin(0.3)
    turned = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ R
    corner = p + np.array([0.1, 0, 0])
    far = corner + np.array([0, 0.1, 0])
    via = corner + np.array([0.05, 0.05, 0.02])
    to = replace(
        by,
        steps=(
            MoveL(position=tuple(corner), orientation=tuple(map(tuple, turned)), zone=0.03),
            MoveC(position=tuple(far), via=tuple(via)),
        ),
    )
    a = Path(robot, by)
    b = Path(robot, to)
    t = np.linspace(0, a.duration, 301)
    assert abs(a.duration - b.duration) < 1e-12
    assert np.abs(a.sample(t).y[:, :, :3] - b.sample(t).y[:, :, :3]).max() < 1e-9
    assert np.abs(a.sample(t).R - b.sample(t).R).max() < 1e-10


def test_a_resolved_program_gives_the_same_path(arm, seam) -> None:
    again = Path(arm, seam.move)
    t = np.linspace(-0.1, seam.duration + 0.1, 501)
    assert np.array_equal(again.sample(t).y, seam.sample(t).y)


def test_programs_of_a_model_file_are_found(tmp_path: FilePath) -> None:
    text = (HERE.parents[1] / "models" / "planar5_nmp.toml").read_text()
    body = EXAMPLE.read_text()
    file = tmp_path / "arm.toml"
    head, variants = text.split("[variant.", 1)
    file.write_text(head + body[body.index("[[program]]") :] + "\n[variant." + variants)
    model = flexgen.read(file)
    assert [p.name for p in model.programs] == ["seam"] and model.move("seam").type == "program"
    assert model.move().name == "line"
    assert model.programs[0].where.line > 80
    assert flexgen.read(file, "undamped").programs == model.programs


def test_a_program_is_solved_like_a_move() -> None:
    elbow = flexgen.derive("elbow")
    start = elbow.model.moves[0].start
    program = Program(
        "there_and_back",
        start=start,
        joint_profile=(3.0, 30.0, 900.0, 40000.0, 3e6),
        steps=(
            MoveJ(tuple(q + 0.2 for q in start), zone=0.05),
            MoveJ((start[0], start[1] + 0.4)),
            MoveJ(start),
        ),
        smoothness=5,
    )
    solution = flexgen.solve(elbow, program)
    assert solution.status == Status.SOLVED and solution.move.name == "there_and_back"


GOOD = Program(
    "p",
    start=(0.3, -1.1),
    steps=(MoveJ((0.6, -1.4)), MoveL((-0.1, 0.0, 0.0))),
    profile=PROFILE,
    joint_profile=JOINTS,
)
L = MoveL((-0.1, 0.0, 0.0))
J = MoveJ((0.6, -1.4))
BAD = {
    "no steps": ({"steps": ()}, "given step none, expected one or more steps"),
    "no profile": ({"profile": ()}, "given profile none, expected bounds"),
    "no joint profile": ({"joint_profile": ()}, "given joint_profile none"),
    "one bound": ({"profile": (1.0,)}, r"given profile \[1\.0\], expected two or more positive"),
    "negative bound": ({"joint_profile": (1.0, -1.0)}, "expected two or more positive"),
    "smoothness": ({"smoothness": 1}, "given smoothness 1, expected 0 for trapezoids, or 2 to 9"),
    "start": ({"start": (0.3,)}, "expected 2 finite numbers"),
    "type": ({"type": "programme"}, "given type 'programme'"),
    "zone between spaces": (
        {"steps": (replace(J, zone=0.1), L)},
        "step 1: given zone 0.1, expected 0 between a MoveJ and",
    ),
    "zone at the end": (
        {"steps": (J, replace(L, zone=0.1))},
        "step 2: given zone 0.1, expected 0 at the end",
    ),
    "negative zone": (
        {"steps": (replace(J, zone=-0.1), L)},
        "given zone -0.1, expected a zone >= 0",
    ),
    "zone too large": (
        {"steps": (replace(L, zone=0.2), L)},
        "step 1: given zone 0 and 0.2, expected zones that fit",
    ),
    "there and back": (
        {"steps": (replace(L, zone=0.05), MoveL((0.1, 0, 0)))},
        "because the path reverses here",
    ),
    "pause": ({"steps": (replace(J, pause=-1.0), L)}, "given pause -1.0, expected a time >= 0"),
    "pause in a zone": (
        {"steps": (replace(L, zone=0.01, pause=1.0), MoveL((0, 0.1, 0)))},
        "given pause 1.0, expected 0 because",
    ),
    "speed": (
        {"steps": (J, replace(L, speed=0.0))},
        "step 2: given speed 0.0, expected a speed > 0",
    ),
    "joints": ({"steps": (MoveJ((1.0,)), L)}, "step 1: given end"),
    "stays": (
        {"steps": (MoveJ((0.3, -1.1)), L)},
        "step 1: given end .* expected an end different from the start of the step",
    ),
    "stays with the tool": (
        {"steps": (MoveL((0.0, 0.0, 0.0)),)},
        "expected a step with a displacement or rotation",
    ),
    "displacement": ({"steps": (MoveL((0.1, 0.0)),)}, "given displacement"),
    "neither": ({"steps": (MoveL(),)}, "expected either displacement or position"),
    "both": (
        {"steps": (MoveL((0.1, 0, 0), (1, 1, 0)),)},
        "expected either displacement or position",
    ),
    "turn without a pose": (
        {"steps": (MoveL((0.1, 0, 0), rotation=(0, 0, 1)),)},
        "given rotation",
    ),
    "via on the line": ({"steps": (MoveC((0.1, 0, 0), via=(0.05, 0, 0)),)}, "given via"),
    "no via": ({"steps": (MoveC((0.1, 0, 0)),)}, "given via"),
    "no rotation matrix": (
        {"steps": (MoveL((0.1, 0, 0), orientation=((1, 0, 0), (0, 1, 0), (0, 0, 2))),)},
        "a rotation matrix",
    ),
}


NONSENSE = {
    "nan bound": (lambda: replace(GOOD, profile=(1.0, np.nan)), "Program, profile: given"),
    "no step": (lambda: replace(GOOD, steps=("MoveJ",)), "Program, steps: given .*'MoveJ'"),
    "nan zone": (
        lambda: replace(L, zone=np.nan),
        "MoveL, zone: given nan, expected a finite number",
    ),
    "nan joints": (lambda: MoveJ((1.0, np.nan)), "MoveJ, end: given"),
    "nan end": (
        lambda: Move("x", "joint", (0.3,), 0.5, 5, end=(np.nan,)),
        r"Move, end: given \(nan,\)",
    ),
    "text": (lambda: MoveC(via="x"), "MoveC, via: given 'x', expected a sequence"),
}


@pytest.mark.parametrize("what", NONSENSE)
def test_invalid_steps_of_a_program_are_refused_by_their_constructors(what: str) -> None:
    call, message = NONSENSE[what]
    with pytest.raises(ArgumentError, match=message):
        call()


@pytest.mark.parametrize("what", BAD)
def test_bad_programs_are_refused(arm, what: str) -> None:
    changes, message = BAD[what]
    with pytest.raises(ArgumentError, match=f"move p.*{message}"):
        Path(arm, replace(GOOD, **changes))


def test_out_of_reach_is_an_error(robot, arm) -> None:
    start = robot.model.move("line").start
    far = Program(
        "far", start=start, profile=PROFILE, steps=(MoveL((0.01, 0, 0)), MoveL((3.0, 0.0, 0.0)))
    )
    with pytest.raises(
        SolverError, match=r"move far, step 2: inverse kinematics: .* after .* % of the time"
    ):
        Path(robot, far)
    drive = flexgen.derive("four_mass")
    with pytest.raises(
        ArgumentError, match="step 1: given a MoveL, expected an output_line or joint move"
    ):
        Path(drive, Program("p", start=(0.0,), profile=PROFILE, steps=(L,)))


def test_bad_programs_from_files_name_their_line(arm, tmp_path: FilePath) -> None:
    text = EXAMPLE.read_text().replace("zone = 0.03\n", "zone = 0.3\n")
    file = tmp_path / "program.toml"
    file.write_text(text)
    line = text.split("\n").index("zone = 0.3") + 1
    with pytest.raises(ModelError) as caught:
        Path(arm, flexgen.read_moves(file, arm.model)[-1])
    assert (caught.value.line, caught.value.key) == (line, "program.seam.step[2].zone")
    assert "zones that fit into the length 0.12 of step 3" in str(caught.value)
