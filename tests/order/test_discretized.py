"""The DAE on an even grid: declared order, agreement with collocation, and what the optimisation
is there for.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.inversion.comparison import discretized
from flexgen.inversion.comparison.discretized import Discretized, discretize
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.simulation.simulate import simulate

MICRON = 1e-6  # what a user is promised
RIGHT = 2e-8  # what the method reaches on smooth models with its own grid
# of the largest torque: both methods' own error at their own meshes, a hundred times what the tool
# feels
AGREE = 1e-5
# the same for a spring with bends: ripples of the torque that the tool does not feel are not the
# same
BENT = 3e-2


def _question(equations: Equations) -> InversionProblem:
    return InversionProblem(equations, Path(equations, equations.model.move(None)))


@pytest.mark.parametrize(
    "name", ["planar5_mp", "planar5_nmp", "planar5_soft", "beam_arm", "planar5_nmp@undamped"]
)
def test_the_tool_follows_its_path(name: str) -> None:
    solution = flexgen.solve(name, method="discretized")
    assert solution.status == Status.SOLVED and solution.simulation is not None
    assert (solution.tool_error_max_m or 1) < RIGHT
    # it begins exactly at rest
    assert np.abs(solution.trajectory["v_a"][0]).max() < 1e-7


@pytest.mark.parametrize(("name", "mesh"), [("four_mass", None), ("four_mass@piecewise", 1e-3)])
def test_springs_with_a_bend(name: str, mesh: float | None) -> None:
    """Two seconds of settling after half a second of path: the error counts until 0.5 s after
    both.
    """
    solution = flexgen.solve(name, method="discretized", mesh=mesh)
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < MICRON
    assert solution.trajectory.time[-1] > 2.0


def test_poses_and_rigid_gears_and_complete_coupling() -> None:
    pose = flexgen.solve("kr300", method="discretized")
    assert (pose.tool_error_max_m or 1) < MICRON and (pose.tool_error_max_rad or 1) < MICRON
    assert (flexgen.solve("elbow@rigid", method="discretized").tool_error_max_m or 1) < RIGHT
    changes = {
        "motor_coupling": "complete",
        "motor.m1.axis": [0, 0, 1],
        "motor.m1.carrier": "base",
        "motor.m2.axis": [0, 0, 1],
        "motor.m2.carrier": "arm1",
        "motor.m2.inertia": 0.01,
    }
    coupled = flexgen.solve(read("planar5_nmp", overrides=changes), method="discretized")
    assert coupled.status == Status.SOLVED and (coupled.tool_error_max_m or 1) < RIGHT


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("planar5_mp", AGREE), ("planar5_nmp", AGREE), ("planar5_soft", AGREE), ("four_mass", BENT)],
)
def test_collocation_agrees(name: str, tolerance: float) -> None:
    equations = flexgen.derive(name)
    # where the residual between the samples says little, the simulation has to
    bent = tolerance == BENT
    one = flexgen.solve(equations, method="discretized", mesh=1e-3, verify=bent).trajectory
    other = flexgen.solve(equations, method="collocation", verify=bent).trajectory
    t = np.linspace(-0.01, equations.model.move(None).duration, 201)
    # in the middle of the move the spring passes from one bend to the other within some ten
    # milliseconds
    if bent:
        t = t[np.abs(t - 0.25) > 0.03]
    torques = [make_interp_spline(x.time, x["tau_m"], k=5)(t) for x in (one, other)]
    assert np.abs(torques[0] - torques[1]).max() < tolerance * np.abs(torques[0]).max()
    deflections = [make_interp_spline(x.time, x["q_a"], k=5)(t) for x in (one, other)]
    # rad; the tool's accuracy, divided by no length
    assert np.abs(deflections[0] - deflections[1]).max() < 2 * MICRON


@pytest.mark.parametrize(
    ("order", "steps"), [(2, (5e-3, 2.5e-3)), (4, (5e-3, 2.5e-3)), (6, (10e-3, 5e-3))]
)
def test_the_error_falls_with_the_order_of_the_differences(
    order: int, steps: tuple[float, float]
) -> None:
    smooth = read("planar5_mp", overrides={"move.line.smoothness": 9})
    problem = _question(flexgen.derive(smooth))
    t = np.linspace(0.05, 0.45, 9)

    def torque(h: float, order: int) -> np.ndarray:
        found = discretize(problem, h, order, 0.02, 0.1)
        at = np.searchsorted(found.t, t - 1e-9)
        assert np.abs(found.t[at] - t).max() < 1e-9
        return found.tau_m[at]

    best = torque(1e-3, 6)
    coarse, fine = (np.abs(torque(h, order) - best).max() for h in steps)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.2)


def test_the_torque_begins_before_the_path() -> None:
    """A softer third joint: the unstable zero is slower, and without time before the path the tool
    is thrown off.
    """
    equations = flexgen.derive(
        read("planar5_nmp", overrides={"element.arm3.dof.q3.spring.stiffness": 1.5e4})
    )
    early = flexgen.solve(equations, method="discretized", mesh=1e-3)
    late = flexgen.solve(equations, method="discretized", preview=0.0, mesh=1e-3)
    print(early.tool_error_max_m, late.tool_error_max_m, early.preactuation_s)
    assert (early.tool_error_max_m or 1) < RIGHT
    assert (late.tool_error_max_m or 0) > 10 * (early.tool_error_max_m or 1)


def test_a_torque_one_step_late_is_seen() -> None:
    """Planted bug: the lag of one step that a one-sided difference would have."""
    equations = flexgen.derive("planar5_nmp")
    trajectory = flexgen.solve(equations, method="discretized", verify=False).trajectory
    late = dict(
        trajectory.channels, tau_m=np.vstack([trajectory["tau_m"][:1], trajectory["tau_m"][:-1]])
    )
    assert (
        simulate(equations, dataclasses.replace(trajectory, channels=late)).tool_error_max_m or 0
    ) > 100 * MICRON


def test_a_wrong_difference_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: the second difference one per mille off."""
    first, second = discretized.DIFFERENCES[4]
    monkeypatch.setitem(discretized.DIFFERENCES, 4, (first, tuple(1.001 * x for x in second)))
    wrong = flexgen.solve("planar5_nmp", method="discretized", mesh=2e-3)
    assert wrong.status == Status.TOLERANCE_NOT_MET and (wrong.tool_error_max_m or 0) > 10 * MICRON


def test_without_the_weight_of_the_start_the_tolerance_is_not_met(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planted bug: a start that is as good as any other, so that motions of the machine itself are
    let in.
    """
    monkeypatch.setattr(discretized, "START", 0.0)
    wrong = flexgen.solve("four_mass", method="discretized", mesh=2e-3)
    assert wrong.status == Status.TOLERANCE_NOT_MET


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"options": {"order": 3}}, "given order 3, expected 2, 4 or 6"),
        ({"options": {"stages": 3}}, "given 'stages', expected one of order"),
        ({"mesh": 1e-8}, "expected at most 20000"),
    ],
)
def test_wrong_options_are_refused(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        flexgen.solve("planar5_mp", method="discretized", **arguments)  # type: ignore[arg-type]


def test_missing_convergence_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discretized, "STEPS", 1)
    with pytest.raises(SolverError, match="no convergence in 1 steps"):
        flexgen.solve("four_mass", method="discretized")


def test_figures_of_a_solution() -> None:
    found = discretize(_question(flexgen.derive("planar5_mp")), 2e-3, 4, 0.02, 0.1)
    assert isinstance(found, Discretized)
    # the output at the nodes is left by next to nothing: less than the tool's error between them
    assert found.path_error < 1e-8
    assert found.iterations <= 4
