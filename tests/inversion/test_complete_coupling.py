"""Inverse dynamics of robots whose rotors also turn with the elements that carry them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from clib_planted import plant_in_c
from states_in_c import HORIZON, streamed
from turning_rotors import coupling_forces

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics import dynamics
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.dynamics.mechanics.signatures import INVERTING, offered_functions
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem import motor_side
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import differentiate, samples
from flexgen.model import inertia
from flexgen.model.inertia import rotor_stages, turning_coordinates
from flexgen.paths.path import Path
from flexgen.runtime.library import Library

MICRON = 1e-6
PERIOD = 1e-3  # s


def coupling_of(robot: flexgen.RobotModel, n: int = 5) -> list[tuple[np.ndarray, ...]]:
    """Forces on joints and rotors at drawn states: those of the library, and by differences."""
    rng = np.random.default_rng(5)
    function = Equations(robot).function("rotor_coupling")
    out = []
    for _ in range(n):
        state = [*rng.standard_normal((3, robot.n_a)), *rng.standard_normal((2, robot.n_m))]
        on_joints, taken = (x.ravel() for x in evaluate(function, *state))
        expected = coupling_forces(robot, *state)
        out.append((on_joints, expected[0][list(robot.i_g)], taken, expected[1]))
    return out


def worst(cases: list[tuple[np.ndarray, ...]]) -> float:
    scale = max(np.abs(case[1]).max() for case in cases)
    torque = max(np.abs(case[3]).max() for case in cases)
    return max(
        max(np.abs(a - b).max() / scale, np.abs(c - d).max() / torque) for a, b, c, d in cases
    )


@pytest.mark.parametrize("name", ["planar5_nmp@coupled", "manutec_r3@coupled"])
def test_forces_of_the_rotors_are_those_of_their_energy(name: str) -> None:
    assert worst(coupling_of(flexgen.read(name))) < 1e-8


def test_a_lost_gyroscopic_force_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    own = dynamics.rotor_forces

    def careless(system: Any, v_m: Any, a_m: Any) -> Any:
        return own(system, 0 * v_m, a_m)

    monkeypatch.setattr(dynamics, "rotor_forces", careless)
    assert worst(coupling_of(flexgen.read("manutec_r3@coupled"))) > 1e-2


def test_stages_go_from_the_last_joint_to_the_first() -> None:
    arm = flexgen.read("manutec_r3@coupled")
    assert rotor_stages(arm) == (3, 2, 1, 1, 1, 0)  # the gears of the wrist are rigid
    assert rotor_stages(flexgen.read("manutec_r3_18@coupled")) == (5, 4, 3, 2, 1, 0)
    assert [len(turning) for turning in turning_coordinates(arm)] == [0, 1, 2, 3, 4, 5]
    assert rotor_stages(flexgen.read("manutec_r3")) == (0,) * 6
    on_base = {f"motor.m{k}.carrier": "base" for k in range(1, 7)}
    assert rotor_stages(flexgen.read("manutec_r3@coupled", overrides=on_base)) == (0,) * 6
    circle = flexgen.read("planar5_nmp@coupled", overrides={"motor.m2.carrier": "arm2"})
    assert rotor_stages(circle)[1] == -1


def test_a_planar_arm_is_inverted_in_complete_coupling() -> None:
    """In Python alone: the zeros do not see the rotors."""
    robot = flexgen.derive("planar5_nmp@coupled")
    solution = flexgen.solve(robot, method="spline")
    assert solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 1) < MICRON


def test_an_arm_with_six_axes_is_inverted_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = flexgen.derive("manutec_r3@coupled")
    solution = flexgen.solve(robot, "line")
    assert (solution.method, solution.status) == ("closed-form", Status.SOLVED)
    assert (solution.tool_error_max_m or 1) < 1e-3 * MICRON
    # planted: rotors at rest
    monkeypatch.setattr(inertia, "rotor_stages", lambda model: (0,) * 6)
    careless = flexgen.solve(robot, "line", method="closed-form")
    assert careless.status == Status.TOLERANCE_NOT_MET
    assert (careless.tool_error_max_m or 0) > 100 * MICRON


@pytest.mark.slow
def test_leaving_the_coupling_out_costs_a_millimeter() -> None:
    solution = flexgen.solve("planar5_nmp@coupled")
    assert (solution.method, solution.status) == ("lq", Status.SOLVED)
    assert (solution.tool_error_max_m or 1) < 1e-3 * MICRON
    careless = flexgen.solve("planar5_nmp@coupled", method="simplified")
    assert careless.status == Status.BASELINE
    assert (careless.tool_error_max_m or 0) > 1000 * MICRON
    methods = [one.method for one in flexgen.compare(solution).solutions]
    assert methods == ["rigid", "fjm", "quasistatic", "simplified", "lq"]


def test_the_baseline_needs_complete_coupling() -> None:
    with pytest.raises(ArgumentError, match="whose rotors turn with their gears alone, expected"):
        flexgen.solve("planar5_nmp", method="simplified")


@pytest.mark.full
@pytest.mark.parametrize("move", ["line", "joints", "turning_line", "circle"])
def test_springs_may_turn_the_motors(move: str) -> None:
    """18 degrees of freedom, five motors behind elastic bearings."""
    robot = flexgen.derive("manutec_r3_18@coupled")
    solution = flexgen.solve(robot, move)
    assert (solution.method, solution.status) == ("lq", Status.SOLVED)
    assert (solution.tool_error_max_m or 1) < MICRON
    careless = flexgen.solve(robot, move, method="simplified")
    assert (careless.tool_error_max_m or 0) > 50 * MICRON


def library_of(robot: flexgen.RobotModel) -> Library:
    offered = offered_functions(robot)
    names = [name for name in INVERTING if name in offered]
    return library_with(robot, names, ("invert", "stream"))


def samples_of(robot: flexgen.RobotModel) -> tuple[Path, list[np.ndarray]]:
    """The path of the first line, and its samples between others at rest."""
    equations = flexgen.derive(robot)
    path = Path(equations, robot.move("line"))
    n = round(path.duration / PERIOD) + 1
    still = 2 * HORIZON
    found = samples(Reduction(equations), path, PERIOD, n)
    out = [
        np.concatenate([np.repeat(x[:1], still, 0), x, np.repeat(x[-1:], still, 0)]) for x in found
    ]
    for rate in out[1:]:
        rate[:still] = rate[still + n :] = 0.0
    return path, out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar5_nmp@coupled", "manutec_r3@coupled"])
def test_c_has_the_torques_of_python_and_streams_those_of_whole_paths(name: str) -> None:
    robot = flexgen.read(name)
    library = library_of(robot)
    path, given = samples_of(robot)
    whole = library.invert(*given, period=PERIOD, q_start=path.q_start)
    torques = streamed(library, given, path.q_start, PERIOD)
    n = len(torques)
    scale = np.abs(whole.tau_m).max()
    assert np.abs(torques - whole.tau_m[:n]).max() < 1e-6 * scale
    arm = (whole.q_a, whole.v_a, whole.a_a)
    # the motors in Python from the same motion of the arm
    equations = flexgen.derive(robot)
    rows = evaluate(equations.function("inversion_rows"), *arm)[0].reshape(len(whole.t), -1)
    jet = differentiate(rows, PERIOD)
    tau_g = motor_side.couple_torques(equations, whole.t, *arm, jet)
    motors = motor_side.motor_motion(equations, whole.t, *arm, tau_g)
    assert np.abs(motors.tau_m - whole.tau_m)[20:-20].max() < 1e-6 * scale
    assert np.abs(tau_g[:, :, 0] - whole.tau_g)[20:-20].max() < 1e-6 * np.abs(whole.tau_g).max()
    assert np.abs(rows - whole.tau_g).max() > 1e-4 * np.abs(rows).max()


@pytest.mark.slow
def test_a_lost_stage_in_c_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    plant_in_c(
        monkeypatch,
        "whole_path.h",
        "for (int stage = 0; stage < COUPLING_STAGES; ++stage) {",
        "for (int stage = 1; stage < COUPLING_STAGES; ++stage) {",
    )
    robot = flexgen.read("planar5_nmp@coupled", overrides={"motor.m2.inertia": 0.003})
    solution = flexgen.solve(robot, method="lq", mesh=0.01)
    assert solution.status == Status.TOLERANCE_NOT_MET


@pytest.mark.slow
def test_limits_are_kept_in_complete_coupling() -> None:
    free = flexgen.solve("planar5_nmp@coupled", verify=False)
    most = np.abs(free.trajectory["tau_m"]).max(axis=0)
    bound = tuple(0.9 * most)
    found = flexgen.solve("planar5_nmp@coupled", limits=Limits(torque=bound))
    assert (found.method, found.status) == ("lq", Status.LIMITS_ACTIVE)
    assert (np.abs(found.trajectory["tau_m"]).max(axis=0) <= np.array(bound) * 1.002).all()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"motor.m2.carrier": "arm2"}, "joint q2 turns a motor whose torque it needs, expected"),
        (
            {"motor.m1.cogging": {"harmonics": [6], "sin": [0.01]}},
            "has motor_coupling 'complete' with hysteresis or harmonics, expected motors",
        ),
    ],
)
def test_what_has_no_stages_is_refused(changes: dict[str, Any], text: str) -> None:
    robot = flexgen.read("planar5_nmp@coupled", overrides=changes)
    with pytest.raises(ArgumentError, match=text):
        flexgen.solve(robot, method="bvp")
