"""Results of closed loops: figures of drawn errors by hand, channels, accuracy, ends of runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.interface import PythonController
from flexgen.feedback.loop.plants import Plants
from flexgen.feedback.loop.reference import MotionReference
from flexgen.feedback.loop.result import ControlRun, output_errors
from flexgen.paths.accuracy.corners import corner_figures, find_corners
from flexgen.paths.accuracy.figures import path_accuracy

pytestmark = needs_compiler
H = 2e-3


@pytest.fixture(scope="module")
def run() -> ControlRun:
    return flexgen.control(
        "elbow",
        controller="none",
        sample_time=H,
        delay=1.25 * H,
        plants={"soft": {"stiffness": 0.8}},
        progress=False,
    )


@pytest.fixture
def made(run: ControlRun) -> ControlRun:
    """The run with drawn errors and torques of its two robots."""
    rng = np.random.default_rng(1)
    runs = [
        replace(
            robot,
            error=1e-3 * rng.normal(size=robot.error.shape),
            tau_m=rng.normal(size=robot.tau_m.shape),
            saturated=3 * k,
            load=k * "+1 kg",
        )
        for k, robot in enumerate(run.runs)
    ]
    return replace(run, runs=tuple(runs))


def with_robot(run: ControlRun, k: int = 0, **changes: Any) -> ControlRun:
    runs = list(run.runs)
    runs[k] = replace(runs[k], **changes)
    return replace(run, runs=tuple(runs))


def test_figures_are_those_of_the_definitions(made: ControlRun) -> None:
    """Dynamic errors are without the line between the static ones, from the last sample before
    the motion to the last one of the run.
    """
    time = made.reference.time
    begin = made.reference.begin
    for robot in made.runs:
        found = made.figures(robot)
        size = np.linalg.norm(robot.error, axis=1)
        first = np.flatnonzero(time < begin)[-1]
        share = np.interp(time, [0.0, made.reference.path_end], [0.0, 1.0])[:, None]
        static = robot.error[first] * (1 - share) + robot.error[-1] * share
        dynamic = np.linalg.norm(robot.error - static, axis=1)[time >= begin]
        assert found["error_max_m"] == pytest.approx(size[time >= begin].max())
        assert found["error_end_m"] == pytest.approx(size[-1])
        assert found["static_error_start_m"] == pytest.approx(size[first])
        assert found["dynamic_error_max_m"] == pytest.approx(dynamic.max())
        assert_allclose(made.dynamic(robot)[time >= begin], dynamic)
        assert not made.dynamic(robot)[time < begin].any()
        assert found["torque_max_Nm"] == np.abs(robot.tau_m).max()
        assert found["error_max_rad"] is found["turn_max_rad"] is None
    assert made.tool_error_max_m == made.figures(made.nominal)["error_max_m"]
    assert (made.tool_error_max_rad, made.unit) == (None, "m")
    sizes = [made.figures(robot)["dynamic_error_max_m"] for robot in made.runs]
    assert made.worst is made.runs[int(np.argmax(sizes))]


def test_turns_and_contacts_have_their_largest_sizes(made: ControlRun) -> None:
    rng = np.random.default_rng(2)
    turn = rng.uniform(size=len(made.reference.time))
    turn[0] = 9.0
    contact = rng.normal(size=(len(turn), 3))
    found = with_robot(made, turn=turn, contact=contact)
    figures = found.figures(found.nominal)
    largest = turn[made.reference.time >= made.reference.begin].max()
    assert figures["turn_max_rad"] == figures["error_max_rad"] == largest < 1.0
    assert figures["contact_max_N"] == pytest.approx(np.linalg.norm(contact, axis=1).max())


def test_a_result_in_words(made: ControlRun) -> None:
    lines = str(made).splitlines()
    assert lines[0] == "elbow, move line: controller feedforward only at 2 ms, delay 2.5 ms: done"
    assert made.delay_s == pytest.approx(2.5e-3) and len(lines) == 3
    words = f"error up to {1e3 * made.tool_error_max_m:.3g}"[:16]
    assert lines[1].startswith(f"  nominal: {words}") and "at the torque limit" not in lines[1]
    assert lines[2].endswith(", 3 samples at the torque limit, load +1 kg")
    many = replace(made, runs=tuple(replace(made.nominal, name=f"r{k}") for k in range(22)))
    assert str(many).splitlines()[-1] == "  and 2 more robots in .runs"
    assert len(str(many).splitlines()) == 22 and many["r3"].name == "r3"
    count = len(made.reference.time)
    assert repr(made["soft"]).startswith(f"<PlantRun soft: {count} samples, error up to 0.00")
    data = made.to_dict()
    assert data["simulated_s"] == pytest.approx((count - 1) * H, abs=H)
    assert (data["sample_time_s"], data["integration_steps"]) == (H, made.steps)
    assert data["accuracy"]["pose_accuracy_m"] > 0.0


def test_a_robot_that_failed_has_no_numbers(made: ControlRun) -> None:
    failed = with_robot(made, failure="not finite")
    assert failed.status.startswith("unstable: nominal: not finite; lower the gains, or take")
    figures = failed.figures(failed.nominal)
    assert np.isnan(figures["error_max_m"]) and figures["error_max_rad"] is None
    assert failed.worst is failed.nominal and "  nominal: not finite" in str(failed)
    data = failed.to_dict()
    assert data["plants"][0]["error_max_m"] is None
    assert [row["robot"] for row in data["accuracy"]["robots"]] == ["soft"]
    late = with_robot(made, 1, failure="controller failed")
    assert late.status == "failed: soft: controller failed" and not late.unstable
    both = with_robot(failed, 1, failure="not finite")
    assert both.to_dict()["accuracy"] is None
    plants = Plants(("nominal", "soft", "far"), (), np.zeros((3, 0)), ("", "", ""))
    early = replace(made, ended="time limit", plants=plants)
    assert early.status == "time limit: not simulated: far"


class Silent:
    """A controller of a user without torques."""

    def reset(self) -> None:
        """Nothing is kept."""

    def step(self, k: int, y: Any, ref: Any) -> np.ndarray:
        """The planned torques."""
        return ref.tau_m


def test_unstable_loops_are_named(made: ControlRun) -> None:
    """By the eigenvalue of linear loops; others where motors at rest are off and still go away."""
    gain = -1e3 * np.eye(2)
    none = np.zeros((0, 2))
    wild = replace(made, law=Linear(np.zeros((0, 0)), none, none.T, gain))
    loops = wild.loops("soft")
    worst = max(loop.largest_eigenvalue() for loop in loops.values())
    text = f"the linear loop at begin, middle, end of the motion has an eigenvalue of {worst:.5f}"
    assert wild.unstable["soft"] == text
    assert wild.status.startswith("unstable: nominal: the linear loop at begin")
    # motors that nothing holds, before the motion
    free = replace(made.model, gravity=(0.0, 0.0, 0.0))
    still = replace(made.reference, begin=-1.5, path_end=-1.0, end=-1.0)
    zero = Linear(np.zeros((0, 0)), none, none.T, 0 * gain)
    loose = replace(made, model=free, law=zero, reference=still)
    sizes = [loop.largest_eigenvalue() for loop in loose.loops("nominal").values()]
    assert not loose.unstable and max(sizes) == pytest.approx(1.0, abs=1e-6)
    own = replace(made, law=PythonController(Silent()))
    wanted = made.reference.motion["q_m"]
    time = made.reference.time - made.reference.end
    sizes = np.ptp(wanted, axis=0) + 1.0
    for factor, growth, unstable in ((0.2, 3.0, True), (0.2, 1.0, False), (0.02, 3.0, False)):
        away = np.outer(np.where(time > 0, np.exp(np.log(growth) / 0.4 * time), 0.0), sizes)
        q_m = wanted + factor * away / growth
        found = with_robot(own, 1, q_m=q_m)
        assert found.unstable == ({"soft": "its motors go away at rest"} if unstable else {})


def test_channels_of_a_robot_have_names_and_units(made: ControlRun) -> None:
    soft = made["soft"]
    expected = {
        "q_a": (soft.q_a, "rad", ("q1", "q2")),
        "q_m": (soft.q_m, "rad", ("m1", "m2")),
        "tau_m": (soft.tau_m, "N m", ("m1", "m2")),
        "tau_ff": (made.reference.held, "N m", ("m1", "m2")),
        "error": (soft.error, "m", ("x", "z")),
    }
    found = made.trajectory("soft")
    assert list(found.channels) == list(expected)
    for name, (values, unit, labels) in expected.items():
        assert_array_equal(found[name], values)
        assert found.ports[name].unit == unit and found.ports[name].shape == (values.shape[1],)
        assert found.labels[name] == labels
    kept = {"model": "elbow", "kind": "closed loop", "plant": "soft"}
    assert {key: found.meta[key] for key in kept} == kept
    assert_array_equal(made.trajectory()["q_a"], made.nominal.q_a)
    force = np.arange(6.0 * len(soft.q_a)).reshape(-1, 6)
    pushed = replace(made, force=force).trajectory()
    assert_array_equal(pushed["force"], force)
    assert pushed.units["force"] == ("N",) * 3 + ("N m",) * 3


@pytest.mark.parametrize("moments", [False, True])
def test_figures_of_a_force_are_largest_sizes_of_its_parts(
    made: ControlRun, moments: bool
) -> None:
    rng = np.random.default_rng(3)
    force, assumed = rng.normal(size=(2, len(made.reference.time), 6))
    if not moments:
        force[:, 3:] = assumed[:, 3:] = 0.0
    reference = replace(made.reference, motion={**made.reference.motion, "force": assumed})
    found = replace(made, force=force, reference=reference)
    expected: dict[str, float] = {}
    for unit, part in [("N", slice(3))] + [("Nm", slice(3, 6))] * moments:
        for name, x in (("", force), ("assumed_", assumed), ("error", force - assumed)):
            key = f"force_error_max_{unit}" if name == "error" else f"{name}force_max_{unit}"
            expected[key] = np.linalg.norm(x[:, part], axis=1).max()
    assert found.force_figures() == pytest.approx(expected)
    lines = found.force_lines()
    assert len(lines) == 1 + moments and lines[0] == (
        f"force of the process up to {expected['force_max_N']:.4g} N, in the feedforward up to "
        f"{expected['assumed_force_max_N']:.4g} N, difference up to "
        f"{expected['force_error_max_N']:.4g} N"
    )
    assert f"  {lines[-1]}" in str(found)
    assert made.force_figures() == {} and made.force_lines() == ()
    assert not made.assumed_force.any() and made.assumed_force.shape == force.shape


def test_poses_of_a_run_are_its_begin_middle_and_end(made: ControlRun) -> None:
    """The first samples at or after them; an end behind the last sample is the last one."""
    time = made.reference.time
    for path_end, end in ((0.5, 0.6), (0.9, 1e3)):
        reference = replace(made.reference, path_end=path_end, end=end)
        found = replace(made, reference=reference).pose_samples
        wanted = {"begin": reference.begin, "middle": path_end / 2, "end": end}
        for name, instant in wanted.items():
            assert found[name] == min(np.searchsorted(time, instant - 1e-9), len(time) - 1)


@pytest.mark.parametrize("turned", [False, True])
def test_accuracy_is_that_of_robots_which_reached_the_end(made: ControlRun, turned: bool) -> None:
    """Of the planned output plus the errors, and the orientations of the arms."""
    reference = made.reference
    count = len(reference.time)
    more: dict[str, Any] = {"robots": ("nominal", "soft"), "unit": "m", "band": 2e-4}
    if turned:
        R = Rotation.random(count, rng=np.random.default_rng(4)).as_matrix()
        reference = replace(reference, R_ref=R.reshape(count, 9))
        forward = flexgen.derive("elbow").function("forward_kinematics").map(count)
        arms = [np.array(forward(r.q_a.T)[1]).reshape(3, count, 3) for r in made.runs]
        more["orientations"] = (R, np.array([x.transpose(1, 0, 2) for x in arms]))
    found = replace(made, reference=reference).accuracy(band=2e-4)
    y = reference.y_ref
    motion = (reference.time, y, np.array([y + r.error for r in made.runs]))
    expected = path_accuracy(*motion, reference.path_end, **more)
    corners = corner_figures(find_corners(made.model, made.solution.move), *motion)
    assert found.to_dict() == replace(expected, **corners).to_dict()


@pytest.mark.parametrize(
    ("failed", "which", "given"),
    [
        ((0,), ["nominal", "soft"], "robots: given 'nominal', which failed, expected names of"),
        ((0,), [], "robots: given no robots that reached the end, expected names of robots that"),
        ((0, 1), None, "robots: given no robots that reached the end"),
        ((), ["hard"], "plant: given 'hard', expected one of nominal, soft"),
    ],
)
def test_robots_without_accuracy_are_refused(
    made: ControlRun, failed: tuple[int, ...], which: list[str] | None, given: str
) -> None:
    for k in failed:
        made = with_robot(made, k, failure="fell")
    with pytest.raises(ArgumentError, match=given):
        made.accuracy(which)


@pytest.mark.parametrize("turned", [True, False])
def test_errors_of_a_pose_are_lengths_and_an_angle(turned: bool) -> None:
    """Tools that are turned by 0.1 and 0.2 rad, about axes that are drawn, from references that
    are displaced by drawn lengths.
    """
    equations = flexgen.derive("kr300_efjm")
    rng = np.random.default_rng(5)
    q_a = 0.3 * rng.normal(size=(2, equations.model.n_a))
    y = np.array([np.array(equations.function("output")(q)).ravel() for q in q_a])
    apart = 1e-3 * rng.normal(size=y.shape)
    axes = rng.normal(size=(2, 3))
    axes *= np.array([[0.1], [0.2]]) / np.linalg.norm(axes, axis=1, keepdims=True)
    R = [np.array(equations.function("forward_kinematics")(q)[1]) for q in q_a]
    turns = Rotation.from_rotvec(axes).as_matrix()
    none = np.zeros((2, 2))
    reference = MotionReference(
        time=np.array([0.0, 1.0]),
        motion={},
        held=none,
        y_s=none,
        y_ref=y - apart,
        R_ref=(R @ turns).reshape(2, 9) if turned else None,
        begin=0.0,
        end=1.0,
        path_end=1.0,
    )
    far, angle = output_errors(equations, reference, q_a)
    assert_allclose(far, apart, atol=1e-14)
    assert (angle is not None) == turned
    if angle is not None:
        assert_allclose(angle, [0.1, 0.2], rtol=1e-7)
