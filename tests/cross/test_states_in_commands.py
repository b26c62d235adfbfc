"""Learning, and positions, for robots with hysteresis or bristles, in MuJoCo with laws of the
tests.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from bristled import Bristles, bristled, tables
from hysteretic import (
    ARCMIN,
    BENT,
    SLIPS,
    Element,
    Elements,
    Plant,
    hysteretic,
    joint_stiffness,
    law_of_gears,
    with_elements,
    with_lost_motion,
)
from servo_in_mujoco import InMujoco, OwnServo
from toolchain import needs_compiler

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.exports.mujoco.mujoco_checks import with_friction

pytestmark = needs_compiler
NUMBERS = tables("elbow")
Law = tuple[Callable[..., Any], Callable[..., Any]]


def bristles(factor: float, q_m: np.ndarray) -> Law:
    """``law`` and ``kept`` of `Plant`, Coulomb and static torques times a factor."""
    numbers = {
        m: row | {k: factor * row[k] for k in ("coulomb", "static")} for m, row in NUMBERS.items()
    }
    law = Bristles(numbers, q_m.copy())
    return lambda q_g, v_g, q, v, tau: (0.0, -law.torque(q, v), tau), lambda q_g, q: law.keep(q)


def gears(factor: float, q_a: np.ndarray, q_m: np.ndarray) -> Law:
    """``law`` and ``kept`` of `Plant` for gears whose lost motion is a factor of 1 arcmin."""
    return with_lost_motion(
        "elbow", factor * ARCMIN, np.linalg.inv(flexgen.read("elbow").eta) @ q_m - q_a
    )


def replayed(run: flexgen.ControlRun, law: Law, step: float) -> float:
    """Largest difference [rad] of the joints of a robot in MuJoCo under the torques of a run to
    those of the run.
    """
    r = run["robot"]
    now = [0]
    arm = []
    each = round(run.hardware.sample_s / step)
    plant = Plant("elbow", *law, lambda t, q, v: r.tau_m[now[0]], step)

    def look(k: int) -> None:
        now[0] = (k + 1) // each
        if (k + 1) % each == 0:
            arm.append(plant.d.qpos[plant.at[: plant.model.n_a]].copy())

    start = np.concatenate([r.q_a[0], r.q_m[0]])
    plant.run(float(run.reference.time[0]), start, each * (len(r.tau_m) - 1), look)
    return float(np.abs(np.array(arm) - r.q_a[1:]).max())


@pytest.mark.slow
def test_learning_finds_a_lost_motion_that_is_larger() -> None:
    """2.6 um become 0.012 um; the robot in MuJoCo moves as in the loop; one with the nominal lost
    motion does not.
    """
    learned = flexgen.learn(
        hysteretic("elbow"), plant={"lost_motion": 1.3}, iterations=3, progress=False
    )
    assert learned.errors[-1] < 0.01 * learned.errors[0] and not learned.stopped
    run = learned.runs[learned.best]
    start = run["robot"].q_a[0], run["robot"].q_m[0]
    assert replayed(run, gears(1.3, *start), 1e-4) < 1e-9
    assert replayed(run, gears(1.0, *start), 1e-4) > 1e-5  # planted


@pytest.mark.full
@pytest.mark.parametrize("slips", [SLIPS, BENT])
def test_learning_finds_lost_motions_of_elements_that_are_larger(
    slips: tuple[Element, ...],
) -> None:
    learned = flexgen.learn(
        with_elements("elbow", slips), plant={"lost_motion": 1.3}, iterations=3, progress=False
    )
    assert learned.errors[-1] < 0.01 * learned.errors[0] and not learned.stopped
    run = learned.runs[learned.best]
    model = flexgen.read("elbow")
    start = np.linalg.inv(model.eta) @ run["robot"].q_m[0] - run["robot"].q_a[0]
    for factor, expected in ((1.3, True), (1.0, False)):  # and planted
        elements = Elements(
            [replace(x, lost=factor * x.lost) for x in slips], joint_stiffness(model), start
        )
        error = replayed(run, law_of_gears("elbow", elements), 1e-4)
        assert error < 1e-9 if expected else error > 1e-5


@pytest.mark.full
def test_learning_finds_a_friction_that_is_larger() -> None:
    learned = flexgen.learn(
        bristled("elbow", NUMBERS),
        plant={"lugre_coulomb": 1.3, "lugre_static": 1.3},
        iterations=3,
        progress=False,
    )
    assert learned.errors[-1] < 0.2 * learned.errors[0] and not learned.stopped
    run = learned.runs[learned.best]
    assert replayed(run, bristles(1.3, run["robot"].q_m[0]), 5e-5) < 2e-6
    assert replayed(run, bristles(1.0, run["robot"].q_m[0]), 5e-5) > 1e-3  # planted


@pytest.mark.slow
def test_the_first_iteration_knows_what_the_model_has() -> None:
    """Without a difference there is nothing to learn: the inverse of corrected paths has the
    states too.
    """
    for model in (hysteretic("elbow"), bristled("elbow", NUMBERS)):
        learned = flexgen.learn(model, iterations=1, progress=False)
        assert learned.errors[0] < 5e-8


def error_of_positions(
    found: flexgen.PositionCommands, make: Callable[[np.ndarray, np.ndarray], Law]
) -> float:
    """Largest distance [m] of the tool in MuJoCo from the path, under positions between which
    lines are drawn.
    """
    path = found.run.solution.trajectory
    run = found.run
    gains = found.run.law
    k = [
        np.asarray(x, float) for x in (gains.position_gain, gains.speed_gain, gains.integral_gain)
    ]
    servo = OwnServo(*k, run.reference.held[0], path["q_m"][0], found.servo.speed_feedforward)
    robot = InMujoco(
        with_friction(flexgen.read("elbow"), "viscous"), path["q_a"][0], path["q_m"][0]
    )
    law, kept = make(path["q_a"][0], path["q_m"][0])
    arm_at = robot.at[: robot.model.n_a]
    rotors = robot.at[robot.model.n_a :]

    def states(m: Any, d: Any) -> None:
        joints, motors, _ = law(
            d.qpos[arm_at], d.qvel[arm_at], d.qpos[rotors], d.qvel[rotors], 0.0
        )
        d.qfrc_applied[arm_at] = joints
        d.qfrc_applied[rotors] = motors

    robot.m.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    first = run.reference.time[
        np.searchsorted(run.reference.time, min(path.time[0], found.time[0]) - 0.02)
    ]
    times = []
    angles = []
    mujoco.set_mjcb_control(states)
    try:
        for sample in range(round((path.time[-1] + 0.3 - first) / servo.h)):
            t = first + sample * servo.h
            times.append(t)
            angles.append(robot.d.qpos[arm_at].copy())
            sent = np.array([np.interp(t, found.time, row) for row in found.motor.T])
            robot.d.ctrl[robot.motors] = servo.torque(sent, robot.angles)
            for _ in range(round(servo.h / robot.m.opt.timestep)):
                mujoco.mj_step(robot.m, robot.d)
                kept(robot.d.qpos[arm_at], robot.d.qpos[rotors])
    finally:
        mujoco.set_mjcb_control(None)
    y = evaluate(flexgen.derive(robot.model).function("output"), np.array(angles))[0].reshape(
        len(times), -1
    )
    wanted = path.at(np.clip(times, path.time[0], path.time[-1]))["y_ref"]
    return float(np.linalg.norm((y - wanted)[:, :2], axis=1).max())


@pytest.mark.parametrize("kind", ["hysteresis", "lugre"])
def test_positions_for_a_servo_make_mujoco_follow_the_path(kind: str) -> None:
    """18 um of 71 um are left, and 0.1 um of 15 um: lines of 4 ms do not follow the torque at a
    reversal of a gear.

    Planted: positions of a model without the states.
    """
    plain = with_friction(flexgen.read("elbow"), "viscous")
    model = hysteretic("elbow") if kind == "hysteresis" else bristled("elbow", NUMBERS)

    def make(q_a: np.ndarray, q_m: np.ndarray) -> Law:
        return gears(1.0, q_a, q_m) if kind == "hysteresis" else bristles(1.0, q_m)

    known = flexgen.command_positions(model, progress=False)
    unknown = flexgen.command_positions(plain, progress=False)
    assert known.status == "solved"
    errors = [error_of_positions(found, make) for found in (known, unknown)]
    assert errors[0] == pytest.approx(known.tool_error_max_m, rel=0.01)
    assert errors[0] < 0.3 * errors[1]
