"""The referee of claimed errors, in C, against the referee in numpy, Pinocchio and a closed
form.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from referee import Referee, random_model, random_state
from scipy.linalg import expm
from toolchain import needs_compiler
from whole_move import WholeMove

from flexgen.model.reader import read

pytestmark = needs_compiler


@pytest.mark.parametrize("coupling", ["simplified", "complete"])
@pytest.mark.parametrize("seed", range(6))
def test_accelerations_and_tool_are_those_of_the_other_referee(seed: int, coupling: str) -> None:
    model = random_model(seed, coupling)
    slow = Referee(model)
    fast = WholeMove(model)
    motors = list(model.i_m)
    s = random_state(model, np.random.default_rng(seed))
    a_a, a_m = slow.forward_dynamics(*s.x, s.tau_m)
    x = np.concatenate([s.q_a, s.q_m[motors], s.v_a, s.v_m[motors]])
    tool = np.empty(12)
    expected = np.concatenate([a_a, a_m[motors]])
    assert fast.rate(x, s.tau_m)[model.dof :] == pytest.approx(
        expected, abs=1e-10 * np.abs(expected).max()
    )
    fast.place(x, s.tau_m, tool)
    assert tool == pytest.approx(np.concatenate([x.ravel() for x in slow.tool(s.q_a)]), abs=1e-12)


def test_the_integration_of_a_linear_robot_is_the_matrix_exponential() -> None:
    """And that of the implicit method."""
    model = read(Path(__file__).parents[1] / "support" / "robots" / "two_mass.toml")
    robot = WholeMove(model)
    n = model.dof
    zero = np.zeros(model.n_m)
    torque = np.ones(model.n_m)
    A = np.stack([robot.rate(e, zero) for e in np.eye(2 * n)], axis=1)
    t = np.linspace(0.0, 0.4, 41)
    inputs = np.zeros((40, 6, model.n_m))
    inputs[:, 0] = torque
    push = robot.rate(np.zeros(2 * n), torque)
    affine = np.block([[A, push[:, None]], [np.zeros((1, 2 * n + 1))]])
    expected = expm(affine * t[-1])[:-1, -1]
    states, _ = robot.integrate(t, inputs, np.zeros(2 * n))
    assert states[-1] == pytest.approx(expected, rel=1e-8, abs=1e-12)
    states[1:] = 0.0
    robot.integrate_stiff(t, inputs, states, 0)
    assert states[-1] == pytest.approx(expected, rel=1e-5, abs=1e-8)
