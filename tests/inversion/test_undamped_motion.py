"""Hanging loads: torques of undamped internal motion against a pendulum of the test's own."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import FlexgenError

MASS = 5.0
LENGTH = 1.0
TROLLEY = 20.0
RATIO = 50.0
ROTOR = 1e-4
GRAVITY = 9.81
CRANE = """
name = "crane"
gravity = [0, 0, -9.81]
home_rad = [0.0]
[[element]]
name = "trolley"
body = {{ mass = 20.0, com = [0, 0, 0], inertia = [0.1, 0.1, 0.1] }}
[[element.dof]]
name = "x"
type = "translation"
axis = [1, 0, 0]
gear = {{ type = "elastic", side = "arm", \
spring = {{ type = "linear", stiffness = 9e5 }}, damping = 600.0 }}
[[element]]
name = "load"
body = {{ mass = 5.0, com = [0, 0, -1.0], inertia = [{inertia}, {inertia}, {inertia}] }}
[[element.dof]]
name = "swing"
type = "rotation"
axis = [0, 1, 0]
spring = {{ type = "linear", stiffness = 0.0 }}
damping = 0.0
[[motor]]
name = "m1"
drives = "x"
ratio = 50.0
inertia = 1e-4
[tool]
position = [0, 0, -1.0]
[output]
{output}
[[move]]
name = "go"
{move}
duration = {duration}
"""
TROLLEY_OUTPUT = 'type = "joint"\njoints = ["x"]'
TROLLEY_MOVE = 'type = "joint"\nstart_rad = [0.0]\nend_rad = [1.0]\nsmoothness = 5'
LOAD_OUTPUT = 'type = "tool_position"\naxes = "x"'
LOAD_MOVE = 'type = "tool_line"\nstart_rad = [0.0]\ndisplacement = [1.0, 0, 0]\nsmoothness = 9'


@pytest.fixture
def crane(tmp_path):
    def made(on_trolley: bool, duration: float, inertia: float = 0.01):
        text = CRANE.format(
            inertia=inertia,
            duration=duration,
            output=TROLLEY_OUTPUT if on_trolley else LOAD_OUTPUT,
            move=TROLLEY_MOVE if on_trolley else LOAD_MOVE,
        )
        path = tmp_path / "crane.toml"
        path.write_text(text, encoding="utf-8")
        return flexgen.read(path)

    return made


def swing_of(acceleration, t: np.ndarray, inertia: float) -> np.ndarray:
    """Angle of the pendulum below a trolley of given acceleration, from rest, and its rate (n, 2).

    The load hangs along -z and turns about y: it is at x - l sin(angle), l (1 - cos(angle)).
    """

    def rate(now, state):
        push = -acceleration(now) * np.cos(state[0]) + GRAVITY * np.sin(state[0])
        return state[1], -MASS * LENGTH * push / (MASS * LENGTH**2 + inertia)

    run = solve_ivp(rate, (0, t[-1]), (0.0, 0.0), "DOP853", t, rtol=1e-11, atol=1e-13)
    return run.y.T


def test_torque_below_a_trolley_is_causal_and_continues_with_the_load(crane):
    solution = flexgen.solve(crane(True, 2.0), "go")
    t = solution.trajectory.time
    path = flexgen.plan(crane(True, 2.0), "go")
    inside = t >= 0
    sample = path.sample(np.clip(t[inside], 0.0, 2.0)).y[:, 0]
    acceleration = np.where(t[inside] > 2.0, 0.0, sample[:, 2])
    own = swing_of(lambda now: np.interp(now, t[inside], acceleration), t[inside], 0.01)
    found = solution.trajectory["q_a"][inside, 1]
    assert solution.status == "solved" and solution.tool_error_max_m < 1e-9
    assert np.abs(found - own[:, 0]).max() < 1e-5
    # it swings on after the path: a solution that is faded to rest is another one
    assert np.abs(found[t[inside] > 2.0]).max() > 0.2
    assert any("must not be held" in text for text in solution.warnings)


@pytest.mark.parametrize("inertia", [0.0, 0.01])
def test_a_load_on_its_path_is_solved_where_the_path_is_slow_against_it(crane, inertia):
    """The equation of the load alone: horizontal force and weight have no moment about it."""
    solution = flexgen.solve(crane(False, 4.0, inertia), "go")
    assert solution.status == "solved" and solution.tool_error_max_m < 1e-6
    t = solution.trajectory.time
    angle = solution.trajectory["q_a"][:, 1]
    rate = solution.trajectory["v_a"][:, 1]
    second = solution.trajectory["a_a"][:, 1]
    push = flexgen.plan(crane(False, 4.0, inertia), "go").sample(np.clip(t, 0, 4.0)).y[:, 0, 2]
    rise = LENGTH * (np.sin(angle) * second + np.cos(angle) * rate**2)
    moment = MASS * LENGTH * (-np.cos(angle) * push + np.sin(angle) * (GRAVITY + rise))
    moment += inertia * second
    largest = MASS * LENGTH * np.abs(push).max()
    assert np.abs(moment).max() < 1e-4 * largest
    # planted: without the rise of the load the moment is not zero
    planted = moment - MASS * LENGTH * np.sin(angle) * rise
    assert np.abs(planted).max() > 1e-3 * largest


@pytest.mark.parametrize("inertia", [0.0, 0.01])
def test_a_load_that_is_moved_too_fast_is_refused_in_seconds_with_its_zeros(crane, inertia):
    began = time.process_time()
    try:
        solution = flexgen.solve(crane(False, 2.0, inertia), "go")
    except FlexgenError as error:
        text = str(error)
    else:
        assert solution.status == "tolerance not met"
        text = " ".join(solution.warnings)
    assert time.process_time() - began < 20.0  # s; 112 s of IPOPT before
    assert re.search("imaginary axis" if inertia else "flat in swing", text)
    assert "no bounded motion was found" in text and "IPOPT" not in text


def test_damped_loads_are_not_called_undamped(crane):
    from flexgen.inversion.problem.problem import InversionProblem

    def undamped(model):
        equations = flexgen.derive(model)
        return InversionProblem(equations, flexgen.plan(equations, "go")).undamped

    loose = undamped(crane(True, 2.0))
    assert loose is not None and not loose.flat
    exact = np.sqrt(GRAVITY * MASS * LENGTH / (MASS * LENGTH**2 + 0.01)) / (2 * np.pi)
    assert loose.frequencies_hz == pytest.approx((exact, exact), rel=1e-6)
    assert undamped(crane(False, 2.0, 0.0)).flat
    file = crane(True, 2.0).file
    damped = flexgen.read(file, overrides={"element.load.dof.swing.damping": 0.5})
    assert undamped(damped) is None
