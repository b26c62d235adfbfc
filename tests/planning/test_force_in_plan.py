"""A force on the tool in planned motions: the simulation of the full model, `fastest`, equilibria,
planted errors.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.statics import hold_motors
from flexgen.inversion.judge.status import Status
from flexgen.planning.optimal import transcribe
from flexgen.planning.optimal.force import PlanForce, make_plan_force

pytestmark = needs_compiler
MODEL = "planar5_nmp"
PLANE = np.array([0.6, 0.8])
CONSTANT = np.array([100.0, -150.0])


def pressing(place: np.ndarray) -> np.ndarray:
    """A force that grows within a fifth of the path and waves three times along it [N]."""
    r = np.clip(np.minimum(place, 1 - place) / 0.2, 0.0, 1.0)
    window = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
    return np.outer(150.0 * window * (1 + 0.3 * np.sin(6 * np.pi * place)), PLANE)


@pytest.fixture(scope="module")
def equations() -> flexgen.Equations:
    return flexgen.derive(MODEL)


def least_torque(equations: flexgen.Equations) -> flexgen.Solution:
    problem = flexgen.plan_problem(equations, mesh=40, force=CONSTANT)
    problem.add_cost(ca.sumsqr(problem["tau_m"]))
    return problem.solve(progress=False)


def test_a_plan_under_a_constant_force_is_a_motion_of_the_robot(equations, monkeypatch):
    """The simulation with the force agrees; both ends are the equilibria under it."""
    found = least_torque(equations)
    assert found.status == Status.SOLVED and found.plan_error_max < 1e-5
    path = found.trajectory
    np.testing.assert_allclose(
        path["force"], np.tile([*CONSTANT, 0, 0, 0, 0], (len(path.time), 1))
    )
    pushed = equations.pushed_by(np.array([*CONSTANT, 0.0, 0.0, 0.0, 0.0]))
    for k in (0, -1):
        rest = hold_motors(pushed, path["q_m"][k], path["q_a"][k])
        np.testing.assert_allclose(path["q_a"][k], rest.q_a, atol=1e-9)
    np.testing.assert_allclose(
        path["y_ref"][[0, -1]], flexgen.plan(equations).sample([0.0, 9.0]).y[:, :, 0], atol=1e-9
    )
    right = PlanForce.of
    monkeypatch.setattr(PlanForce, "of", lambda self, s: -right(self, s))
    assert least_torque(equations).status == Status.TOLERANCE_NOT_MET  # planted: the other sign


def shortest(equations: flexgen.Equations, force) -> flexgen.Solution:
    limits = flexgen.Limits(torque=(25.0, 12.0))
    problem = flexgen.plan_problem(equations, mesh=60, timing="free", limits=limits, force=force)
    problem.free_time(0.2, 1.0)
    problem.add_cost(problem.duration, at="end")
    problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
    problem.follow(tolerance=1e-6)
    return problem.solve(progress=False, compiled=False)


@pytest.mark.slow
def test_the_shortest_time_under_a_force_over_the_place(equations, monkeypatch):
    """Torques may jump, so it is shorter than the smooth law of `fastest`, by as much as without
    the force.
    """
    found = shortest(equations, pressing)
    assert found.status == Status.SOLVED and found.plan_error_max < 1e-6
    limits = flexgen.Limits(torque=(25.0, 12.0))
    quick = flexgen.fastest(equations, limits=limits, force=pressing, progress=False)
    free = flexgen.fastest(equations, limits=limits, progress=False)
    ratio = shortest(equations, None).move.duration / free.duration_s
    assert (
        abs(found.move.duration / quick.duration_s - ratio)
        < 0.01
        < abs(quick.duration_s / free.duration_s - 1)
    )
    y = found.trajectory["y_ref"]
    place = np.linalg.norm(y - y[0], axis=1) / np.linalg.norm(y[-1] - y[0])
    np.testing.assert_allclose(found.trajectory["force"][:, :2], pressing(place), atol=0.2)
    right = PlanForce.of
    monkeypatch.setattr(PlanForce, "of", lambda self, s: right(self, 1 - s))
    assert shortest(equations, pressing).status != Status.SOLVED  # planted: from the other end


def test_the_spline_in_casadi_is_the_force(equations):
    made = make_plan_force(pressing, equations, free=True)
    s = ca.SX.sym("s")
    places = np.linspace(0.0, 1.0, 333)
    found = np.array(ca.Function("f", [s], [made.of(s)]).map(len(places))(places[None])).T
    np.testing.assert_allclose(found[:, :2], pressing(places), atol=0.2)
    np.testing.assert_allclose(found, made.at(places), atol=1e-10)


def test_planted_equations_without_the_force_are_seen(equations, monkeypatch):
    right = transcribe.residual_of
    monkeypatch.setattr(transcribe, "residual_of", lambda *given: right(*given[:5]))
    assert least_torque(equations).status == Status.TOLERANCE_NOT_MET


def test_errors_name_what_was_given(equations):
    for given, free, words in (
        (pressing, False, "given over the place"),
        (np.zeros((5, 2)), False, "given over the place"),
        ((1.0, 2.0, 3.0, 4.0), False, "4 columns"),
        ([np.nan, 0.0], False, "NaN or infinity"),
        (lambda x: np.outer(np.sin(900 * x), PLANE), True, "changes too quickly"),
        ("none.csv", True, "cannot be read"),
    ):
        with pytest.raises(ArgumentError, match=words):
            make_plan_force(given, equations, free)
    problem = flexgen.plan_problem(equations, mesh=10, timing="free", force=pressing)
    second = problem.then(0.2, mesh=5)
    with pytest.raises(ArgumentError, match="end_at: given within a problem"):
        problem.end_at(problem.path.q_start)
    second.end_at(problem.path.q_start)
    problem.start_at(problem.path.q_start)
    with pytest.raises(ArgumentError, match="start_at: given within a problem"):
        second.start_at(problem.path.q_start)
