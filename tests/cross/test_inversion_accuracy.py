"""The default method, without any tuning: verified tool errors on planar and six-axis robots.

The judge is a forward simulation of the full model from rest, with another integrator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.judge.status import Status
from flexgen.simulation.simulate import simulate

PLANAR = 1e-7  # m
SIX_AXES = 1e-6  # m and rad

planar = [
    "planar5_mp",
    "planar5_nmp",
    "planar5_soft",
    "planar5_family",
    "planar5_family@l_510",
    "planar5_family@l_490",
]


@pytest.mark.parametrize("name", planar)
def test_planar_arms(name: str) -> None:
    """Minimum phase, non-minimum phase, exactly flat and next to it, soft."""
    equations = derive(name)
    for move in equations.model.moves:
        solution = flexgen.solve(equations, move)
        assert (solution.method, solution.status) == ("lq", Status.SOLVED)
        assert (solution.tool_error_max_m or 0.0) <= PLANAR


def six_axes(name: str) -> None:
    equations = derive(name)
    assert {"tool_line", "joint", "tool_circle"} <= {move.type for move in equations.model.moves}
    for move in equations.model.moves:
        solution = flexgen.solve(equations, move)
        assert (solution.method, solution.status) == ("lq", Status.SOLVED), move.name
        assert (solution.tool_error_max_m or 0.0) <= SIX_AXES, move.name
        assert (solution.tool_error_max_rad or 0.0) <= SIX_AXES, move.name


@pytest.mark.slow
def test_six_axes_with_18_degrees_of_freedom() -> None:
    six_axes("manutec_r3_18")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["manutec_r3_24", "manutec_r3_30", "kr300_efjm"])
def test_larger_six_axis_robots(name: str) -> None:
    six_axes(name)


def test_a_torque_with_a_small_error_is_seen() -> None:
    """The control: a thousandth of the torque of one motor more, and the tool is off by a hundred
    times the bound.
    """
    solution = flexgen.solve("planar5_nmp", verify=False)
    trajectory = solution.trajectory
    wrong = trajectory["tau_m"] * np.array([1.001, 1.0])
    bent: Trajectory = replace(trajectory, channels={**trajectory.channels, "tau_m": wrong})
    assert (simulate("planar5_nmp", bent).tool_error_max_m or 0.0) > 100 * PLANAR


@pytest.mark.slow
def test_order_of_the_mesh() -> None:
    """Halving the intervals: the residual between the samples falls like the fourth power or
    faster, until rounding.
    """
    equations = derive("planar5_soft")
    residuals = [
        flexgen.solve(equations, "line", "lq", mesh=h, verify=False).details["residual_at_samples"]
        for h in (0.02, 0.01, 0.005)
    ]
    assert residuals[0] / residuals[1] > 2**4
    assert residuals[1] / residuals[2] > 2**4
