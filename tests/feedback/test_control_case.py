"""Cases of closed loops: parts of a delay, the hardware, the samples around a motion, and the
robots at rest.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.case import AFTER_S, HOLD_S, Case, control_case

pytestmark = needs_compiler
H = 1e-3


@cache
def solution(pushed: bool = False) -> flexgen.Solution:
    force = np.tile([200.0, -50.0], (5, 1)) if pushed else None
    model = flexgen.read("elbow", overrides={"motor.m1.torque_max": 500.0})
    return flexgen.solve(model, "line", force=force, verify=False)


def case(**options: object) -> Case:
    given = solution()
    return control_case(given.model, solution=given, sample_time=H, **options)  # type: ignore


@pytest.mark.parametrize(
    ("delay", "whole", "rest"), [(0.0, 0, 0.0), (2.5e-3, 2, 5e-4), (3e-3, 3, 0.0)]
)
def test_a_delay_is_samples_and_the_rest_of_one(delay: float, whole: int, rest: float) -> None:
    """Of a rest that is rounding nothing is left."""
    made = case(delay=delay, encoder_noise=1e-6)
    assert made.delay == pytest.approx(delay) and made.delay_samples == whole
    assert made.hardware.delay_s == pytest.approx(rest, abs=1e-15)
    assert (made.hardware.delay_s == 0.0) == (rest == 0.0)
    assert (made.hardware.sample_s, made.hardware.encoder_noise_rad) == (H, 1e-6)
    assert (made.hardware.encoder_resolution_rad, made.hardware.torque_noise_Nm) == (0.0, 0.0)


def test_torques_are_limited_unless_they_are_not_to_be() -> None:
    made = case()
    assert made.hardware.torque_max_Nm == (500.0, 0.0)  # 0: the second motor has no limit
    assert case(torque_limits=False).hardware.torque_max_Nm == ()
    assert made.hardware.encoder_noise_rad == 0.0


def test_samples_begin_before_the_motion_with_robots_at_rest() -> None:
    """Its rate is that of the fastest pole of the linear robot."""
    made = case()
    trajectory = solution().trajectory
    time = made.reference.time
    assert time[0] == pytest.approx(trajectory.time[0] - HOLD_S, abs=H)
    assert time[-1] == pytest.approx(trajectory.time[-1] + AFTER_S, abs=H)
    assert_allclose(np.diff(time), H, rtol=1e-9)
    ((q_a, _),) = made.rests
    assert_allclose(q_a, trajectory["q_a"][0], atol=1e-9)
    poles = flexgen.analyze(made.equations, solution().move.start).poles
    assert made.rate > 0.99 * np.abs(poles).max()
    assert made.force is None and made.gears is None and made.laws == ()
    assert set(made.library.functions) == {"forward_dynamics"}


def test_the_force_of_a_solution_pushes_the_robots_before_the_motion() -> None:
    """The motors hold the arm against the force at the tool: J^T F is in their torques."""
    pushed = solution(True)
    made = control_case(pushed.model, solution=pushed, sample_time=H)
    free = case()
    assert made.force is not None
    assert set(made.library.functions) == {"forward_dynamics", "forward_dynamics_tool_force"}
    equations = derive(pushed.model)
    q_a = made.reference.motion["q_a"][0]
    J = np.array(equations.function("jacobian")(q_a))[[0, 2]]
    moment = np.linalg.solve(pushed.model.eta.T, J.T @ [200.0, -50.0])
    still = made.reference.time < made.reference.begin
    rest = np.array(equations.function("gravity")(q_a)).ravel()
    expected = np.linalg.solve(pushed.model.eta.T, rest) - moment
    assert_allclose(made.reference.held[still][0], expected, rtol=1e-6)
    assert np.abs(made.reference.held[0] - free.reference.held[0]).max() > 0.1
