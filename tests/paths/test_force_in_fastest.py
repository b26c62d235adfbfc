"""The fastest time law under a force over the place: limits of the found motion by `solve`, the
place of the force.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.interpolate import PPoly
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.statics import hold_motors
from flexgen.paths.force import place_force
from flexgen.paths.force.place_force import force_along, make_place_force, places
from flexgen.paths.force.process_force import ProcessForce
from flexgen.planning.fastest import time_search
from flexgen.planning.fastest.minimum_time import FastestMove
from flexgen.planning.fastest.rigid_time import rigid_time

pytestmark = needs_compiler
MODEL = "planar5_nmp"
LIMITS = flexgen.Limits(torque=(25.0, 12.0))
SIZE = 225.0
PLANE = np.array([0.6, 0.8])


def grinding(place: np.ndarray) -> np.ndarray:
    """A force that grows within a tenth of the path, and waves six times along it [N]."""
    r = np.clip(np.minimum(place, 1 - place) / 0.1, 0.0, 1.0)
    window = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
    return np.outer(SIZE / 1.5 * window * (1 + 0.5 * np.sin(12 * np.pi * place)), PLANE)


def found(**more) -> FastestMove:
    return flexgen.fastest(
        MODEL, limits=LIMITS, coefficients=8, force=grinding, progress=False, **more
    )


@pytest.fixture(scope="module")
def quick() -> FastestMove:
    return found()


def use_of_torque(solution: flexgen.Solution) -> float:
    """Largest torque over its limit."""
    return float((np.abs(solution.trajectory["tau_m"]).max(axis=0) / LIMITS.torque).max())


def solved_with_force(move: flexgen.Move) -> flexgen.Solution:
    """The move with the force where the tool is, from the geometry of the line alone."""
    path = flexgen.plan(MODEL, move)
    ends = path.sample([0.0, path.duration]).y[:, :, 0]
    along = (ends[1] - ends[0]) / ((ends[1] - ends[0]) ** 2).sum()

    def force(t: np.ndarray) -> np.ndarray:
        return grinding(np.clip((path.sample(t).y[:, :, 0] - ends[0]) @ along, 0.0, 1.0))

    return flexgen.solve(MODEL, move, force=force, ignore_limits=True, progress=False)


@pytest.mark.slow
def test_the_limits_are_kept_with_the_force_and_reached(quick):
    checked = solved_with_force(quick.move)
    assert checked.tool_error_max_m < 1e-8 and 0.995 < use_of_torque(checked) < 1.001
    np.testing.assert_allclose(
        quick.solution.trajectory["tau_m"], checked.trajectory["tau_m"], atol=1e-5
    )
    free = flexgen.fastest(MODEL, limits=LIMITS, coefficients=8, progress=False)
    # the law without the force does not keep them
    assert use_of_torque(solved_with_force(free.move)) > 1.05
    assert quick.rigid_s < quick.duration_s < quick.default_s and quick.rigid_s != free.rigid_s


@pytest.mark.parametrize("bug", ["sign", "time"])
def test_planted_errors_exceed_the_limits_or_do_not_reach_them(monkeypatch, bug):
    right = time_search.in_time
    if bug == "sign":

        def wrong(force: ProcessForce, path: flexgen.Path) -> ProcessForce:
            return right(ProcessForce(PPoly(-force.curve.c, force.curve.x), 1.0), path)

        monkeypatch.setattr(time_search, "in_time", wrong)
    else:
        monkeypatch.setattr(
            place_force, "places", lambda path, t: np.clip(t / path.duration, 0.0, 1.0)
        )
    assert abs(use_of_torque(solved_with_force(found().move)) - 1.0) > 0.01


@pytest.mark.slow
def test_the_result_in_the_closed_loop(quick):
    errors = [
        flexgen.control(
            MODEL, quick.move, force=quick.force, assumed_force=x, torque_limits=False
        ).tool_error_max_m
        for x in (1.0, 0.0)
    ]
    assert errors[0] < 1e-6 and errors[1] > 1e-4


@pytest.mark.slow
def test_vibrations_are_those_of_control(quick):
    plants = {"soft": {"stiffness": 0.9}, "stiff": {"stiffness": 1.1}}
    run = flexgen.control(
        MODEL, quick.move, force=quick.force, plants=plants, sample_time=1e-3, torque_limits=False
    )
    after = (run.reference.time >= quick.duration_s) & (
        run.reference.time < quick.duration_s + 0.4
    )
    for name, size in quick.vibration_m.items():
        error = run[name].error - run[name].error[-1]
        assert abs(np.linalg.norm(error[after], axis=1).max() - size) < 0.03 * size


@pytest.mark.slow
def test_a_program_keeps_the_limits_and_its_places():
    steps = (flexgen.MoveL((-0.12, 0.0, 0.0), pause=0.1), flexgen.MoveL((0.0, 0.12, 0.0)))
    tool = (0.4, 2.0, 30.0, 600.0)
    joints = (1.0, 5.0, 60.0, 900.0)
    seam = flexgen.Program(
        "seam", start=(0.3, -1.1), smoothness=5, steps=steps, profile=tool, joint_profile=joints
    )

    def rise(x: np.ndarray) -> np.ndarray:
        return x**3 * (10 - 15 * x + 6 * x**2)

    def force(place: np.ndarray) -> np.ndarray:
        return np.outer(
            100.0 * (rise(np.clip(place - 0.5, 0, 1)) - rise(np.clip(place - 1.2, 0, 0.8) / 0.8)),
            PLANE,
        )

    quick = flexgen.fastest(
        MODEL, seam, limits=LIMITS, coefficients=6, force=force, progress=False
    )
    assert quick.solution.tool_error_max_m < 1e-7 and use_of_torque(quick.solution) < 1.001
    path = flexgen.plan(MODEL, quick.move)
    y = quick.solution.trajectory["y_ref"]
    t = quick.solution.trajectory.time
    corner, start = path.sample([path.segments[1].start, 0.0]).y[:, :, 0]
    way = np.linalg.norm(y - start, axis=1) / 0.12, np.linalg.norm(y - corner, axis=1) / 0.12
    place = np.where(t < path.segments[1].start, way[0], 1.0 + way[1])
    inside = (t >= 0) & (t <= path.duration)
    np.testing.assert_allclose(
        quick.solution.trajectory["force"][inside, :2], force(place)[inside], atol=0.05
    )


def test_the_bound_of_a_rigid_robot_has_the_force():
    """Motors that just hold the robot under a force that carries a part of its weight can move it;
    weaker ones not.
    """
    equations = flexgen.derive("elbow")
    path = flexgen.plan(equations)
    eta = equations.model.eta
    poses = flexgen.solve(equations, progress=False).trajectory["q_a"][::50]

    def held(up: float) -> np.ndarray:
        pushed = equations.pushed_by(np.array([0.0, 0.0, up, 0.0, 0.0, 0.0]))
        return np.max([np.abs(hold_motors(pushed, eta @ q, q).tau_m) for q in poses], axis=0)

    def rigid(torque: np.ndarray, up: float) -> float:
        force = make_place_force(np.tile([0.0, 0.0, up], (3, 1)), equations.model, 1)
        return rigid_time(path, torque, np.full(2, np.inf), force)

    up = 500.0
    assert np.isfinite(rigid(1.05 * held(up), up)) and np.isnan(rigid(0.95 * held(up), up))
    assert (1.05 * held(up) < 0.95 * held(0.0)).all() and np.isnan(rigid(1.05 * held(up), -up))


@pytest.mark.slow
def test_file_command_and_errors(tmp_path, capsys):
    place = np.linspace(0.0, 1.0, 1001)
    table = np.column_stack([place, grinding(place), np.zeros(1001)])
    np.savetxt(tmp_path / "force.csv", table, delimiter=",", header="place,fx,fy,fz", comments="")
    words = ["--torque", "25", "12", "--coefficients", "4", "--json"]
    assert main(["fastest", MODEL, "--force", str(tmp_path / "force.csv"), *words]) == 0
    data = json.loads(capsys.readouterr().out)
    assert abs(data["solution"]["force_max_N"] - SIZE) < 1.0
    model = flexgen.read(MODEL)
    time = Trajectory(
        place,
        {"force": table[:, 1:]},
        {"force": Port("force", (3,), "N", "")},
        {"force": tuple("xyz")},
    )
    short, wrong, text = (tmp_path / name for name in ("short.csv", "wrong.csv", "text.csv"))
    short.write_text("place,fx,fy,fz\n0,1,2,0\n0.5,1,2,0\n")
    wrong.write_text("time,fx,fy,fz\n0,1,2,0\n1,1,2,0\n")
    text.write_text("place,fx,fy,fz\n0,a,2,0\n")
    for given, said in (
        (time, "given in time, expected the force over the place"),
        (str(short), "given the places 0 to 0.5"),
        (str(wrong), "given the columns time, fx, fy, fz"),
        (str(text), "cannot be read"),
        (str(tmp_path / "none.csv"), "cannot be read"),
        (np.zeros((3, 4)), "4 columns, expected the force over the place"),
    ):
        with pytest.raises(ArgumentError, match=said):
            make_place_force(given, model, 1)
    with pytest.raises(ArgumentError, match="given with a force"):
        flexgen.fastest("manutec_r3_24", force=grinding, against="95 %")


def test_the_feedback_of_many_robots_is_not_promised_within_curves():
    """Its torque was compared with the largest one alone, not with what a curve leaves at a
    speed.
    """
    robot = flexgen.read(MODEL, overrides={"uncertainty": {"stiffness": 0.1}})
    limits = flexgen.Limits(torque_speed=(((0.0, 30.0), (900.0, 1.0)), ()))
    with pytest.raises(ArgumentError, match="against: given with torque-speed curves"):
        flexgen.fastest(robot, limits=limits, against="95 %")


def test_places_are_those_of_the_time_law():
    path = flexgen.plan(MODEL)
    t = np.linspace(-0.1, path.duration + 0.1, 50)
    force = make_place_force(grinding, path.equations.model, 1)
    np.testing.assert_allclose(
        force_along(force, path)(t)[:, :2], grinding(places(path, t)), atol=1e-6
    )
    assert places(path, t)[0] == 0.0 and abs(places(path, t)[-1] - 1.0) < 1e-15
