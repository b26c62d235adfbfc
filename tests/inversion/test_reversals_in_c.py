"""Reversals of motors with steep friction in the emitted C: torques at the samples, and friction
between them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from emitted import paths_library
from scipy.interpolate import CubicSpline
from stream_machine import AFTER, Machine
from toolchain import needs_compiler

import flexgen
from flexgen.dynamics.mechanics.signatures import INVERTING
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples
from flexgen.model.friction import Friction

# It compiles a library that no other file needs.
pytestmark = [needs_compiler, pytest.mark.slow]

STEEP = Friction(viscous=1e-3, coulomb=0.3, beta=50.0)
# A line past the base, on which both motors of the elbow reverse.
PASSING = flexgen.Move(
    "pass", "tool_line", (0.5, -1.2), 0.8, 5, displacement=(0.8115538, 0.0, -1.3876623)
)
PERIOD = 1e-3  # s
# Of the largest torque: the stream differentiates the gears' motion, samples 1 ms apart, within
# its horizon.
AGREES = 1e-5


@pytest.fixture(scope="module")
def machine() -> Machine:
    model = flexgen.read("elbow")
    motors = tuple(replace(motor, friction=STEEP) for motor in model.motors)
    model = replace(model, name="steep", motors=motors, moves=(PASSING,))
    equations = flexgen.derive(model)
    return Machine(model, "pass", paths_library(equations, "invert", "stream"))


@pytest.fixture(scope="module")
def solution(machine: Machine) -> flexgen.Solution:
    found = flexgen.solve(machine.equations, PASSING, ignore_limits=True)
    assert found.status == "solved" and found.method == "closed-form"
    return found


@pytest.fixture(scope="module")
def whole(machine: Machine) -> dict[str, np.ndarray]:
    """The path by `invert`."""
    found = machine.library.invert(
        *samples(Reduction(machine.equations), machine.path, PERIOD, 801),
        period=PERIOD,
        q_start=machine.path.q_start,
        n_pre=20,
        n_post=round(AFTER / PERIOD),
    )
    assert found.converged
    return {"time": found.t, "tau_m": found.tau_m, "v_m": found.v_m, "q_m": found.q_m}


def friction(v: np.ndarray) -> np.ndarray:
    """The law of the model file, by hand [N m]."""
    return STEEP.viscous * v + STEEP.coulomb * np.tanh(STEEP.beta * v)


def off(
    solution: flexgen.Solution, time: np.ndarray, torque: np.ndarray, most: float = 1e-9
) -> float:
    """Largest difference from the torques of a solution at the instants of both, of the largest
    torque.
    """
    own = solution.trajectory
    at = np.clip(np.searchsorted(own.time, time - most), 0, len(own.time) - 1)
    same = np.abs(own.time[at] - time) < most
    assert np.count_nonzero(same) > 700
    away = np.abs(torque[same] - own["tau_m"][at[same]]).max()
    return float(away / np.abs(own["tau_m"]).max())


def test_torques_at_the_samples_are_those_of_solve(
    machine: Machine, solution: flexgen.Solution, whole: dict[str, np.ndarray]
) -> None:
    speeds = whole["v_m"]
    assert (speeds[:-1] * speeds[1:] < 0).any(axis=0).all()
    # the friction jumps between two samples by more than half of its step
    assert (np.abs(np.diff(friction(speeds), axis=0)).max(axis=0) > STEEP.coulomb).all()
    assert off(solution, whole["time"], whole["tau_m"]) < AGREES
    # planted: the friction of the sample before
    late = whole["tau_m"].copy()
    late[1:] += friction(speeds[:-1]) - friction(speeds[1:])
    assert off(solution, whole["time"], late) > 100 * AGREES


def test_torques_of_a_stream_are_those_of_solve(
    machine: Machine, solution: flexgen.Solution
) -> None:
    time, results = machine.followed()
    assert off(solution, time, results["tau_m"]) < AGREES


def test_friction_between_the_samples_is_evaluated_in_the_loop(
    machine: Machine, solution: flexgen.Solution, whole: dict[str, np.ndarray]
) -> None:
    """As docs/c_library.md says: interpolate what is smooth, and add `motor_friction` at the speed
    of the instant.
    """
    own = solution.trajectory
    inside = (own.time > whole["time"][1]) & (own.time < whole["time"][-2])
    t = own.time[inside]
    torque = own["tau_m"][inside]
    # the solution has samples between those of the library, around the reversals
    assert np.diff(t).min() < PERIOD / 5
    time = whole["time"]
    law = machine.library.motor_friction
    smooth = whole["tau_m"] - np.array([law(v) for v in whole["v_m"]])
    speed = CubicSpline(time, whole["v_m"])(t)
    assert np.abs(np.array([law(v) for v in speed]) - friction(speed)).max() < 1e-12
    split = CubicSpline(time, smooth)(t) + np.array([law(v) for v in speed])
    largest = np.abs(torque).max()
    assert np.abs(split - torque).max() < AGREES * largest
    # the torques themselves miss the step
    curve = CubicSpline(time, whole["tau_m"])(t)
    assert np.abs(curve - torque).max() > 100 * AGREES * largest
    assert "motor_friction" in INVERTING
