"""Feedforward without the elastic model: rigid, flexible-joint and quasi-static baselines."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods import baselines
from flexgen.inversion.methods.baselines import quasistatic_motion, stiff_motion
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.solution import Solution
from flexgen.model.elements import Move
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.simulation.simulate import simulate

RIGHT = 1e-8  # what exact methods reach
SAME = 1e-12  # relative: the same formula
BASELINES = ("rigid", "fjm", "quasistatic")


def _error(solution: Solution) -> float:
    assert solution.status == Status.BASELINE
    return max(solution.tool_error_max_m or 0.0, solution.tool_error_max_rad or 0.0)


@pytest.mark.parametrize("name", ["planar5_mp", "urdf_arm", "abb_arm"])
def test_each_richer_baseline_has_a_smaller_tool_error(name: str) -> None:
    equations = flexgen.derive(name)
    rigid, fjm, slow = (_error(flexgen.solve(equations, method=method)) for method in BASELINES)
    better = _error(flexgen.solve(equations, method="quasistatic", options={"rounds": 1}))
    assert rigid > fjm > 10 * slow > 20 * better > 0


@pytest.mark.slow
def test_errors_of_a_move_of_one_second() -> None:
    """The order of magnitude that makes elastic models worth while: 1 mm, 0.1 mm, 0.1 um."""
    model = read("planar5_nmp", overrides={"move.line.duration": 1.0})
    equations = flexgen.derive(model)
    rigid, fjm, slow = (_error(flexgen.solve(equations, method=method)) for method in BASELINES)
    assert 1e-4 < rigid < 1e-2 and 1e-5 < fjm < 1e-3 and 1e-8 < slow < 1e-6


@pytest.mark.slow
def test_without_elasticity_all_are_exact() -> None:
    for method in BASELINES:
        assert _error(flexgen.solve("elbow@rigid", method=method)) < RIGHT
    for method in BASELINES[1:]:
        for move in ("line", "joints"):
            assert _error(flexgen.solve("kr300", move, method=method)) < RIGHT
    assert _error(flexgen.solve("kr300", method="rigid")) > 1e-4


@pytest.mark.slow
def test_the_flexible_joint_baseline_is_the_closed_form() -> None:
    equations = flexgen.derive("elbow")
    closed = flexgen.solve(equations, "joints", verify=False).trajectory
    for method in BASELINES[1:]:
        other = flexgen.solve(equations, "joints", method=method, verify=False).trajectory
        at = np.searchsorted(other.time, closed.time - 1e-9)
        assert np.abs(other.time[at] - closed.time).max() < 1e-4
        torque = np.stack(
            [np.interp(closed.time, other.time, column) for column in other["tau_m"].T], axis=1
        )
        assert np.abs(torque - closed["tau_m"]).max() < 1e-4 * np.abs(closed["tau_m"]).max()


def test_rigid_torque_by_the_textbook() -> None:
    """tau_m = J eta a_g + f(eta v_g) + eta^-T (M a + c + g)_g with all elements undeflected."""
    equations = flexgen.derive(
        read(
            "planar5_nmp",
            overrides={"motor.m2.drives": ["q1", "q2"], "motor.m2.ratio": [30.0, 100.0]},
        )
    )
    model = equations.model
    trajectory = flexgen.solve(equations, method="rigid", verify=False).trajectory
    q, v, a = (trajectory[x] for x in ("q_a", "v_a", "a_a"))
    assert not np.abs(q[:, 2]).any() and not np.abs(a[:, 2]).any()
    load = evaluate(equations.function("inverse_dynamics"), q, v, a)[0][:, :2]
    eta = np.array([[100.0, 0.0], [30.0, 100.0]])
    assert (model.eta == eta).all()
    by_hand = (
        np.array([40e-4, 25e-4]) * (a[:, :2] @ eta.T)
        + 20e-4 * (v[:, :2] @ eta.T)
        + load @ np.linalg.inv(eta)
    )
    assert np.abs(trajectory["tau_m"] - by_hand).max() < SAME * np.abs(by_hand).max()
    # the tool of the undeflected arm is on the path
    tool = evaluate(equations.function("output"), q)[0]
    assert np.abs(tool - trajectory["y_ref"]).max() < RIGHT


def test_quasistatic_deflections_balance_their_loads() -> None:
    equations = flexgen.derive("planar5_soft")
    reduction = Reduction(equations)
    path = Path(equations, equations.model.move(None))
    t = np.linspace(0.0, 0.5, 501)
    motion = quasistatic_motion(reduction, path, t)
    # by hand: the accelerations of the actuated joints that follow the path with the deflection
    # standing still
    W = evaluate(equations.function("jacobian"), motion.q)[0][:, :2]
    sample = path.sample(t)
    v = np.zeros_like(motion.q)
    a = np.zeros_like(motion.q)
    v[:, :2] = np.linalg.solve(W[:, :, :2], sample.derivative(1)[:, :, None])[:, :, 0]
    dW = evaluate(equations.function("jacobian_dot"), motion.q, v)[0][:, :2]
    a[:, :2] = np.linalg.solve(
        W[:, :, :2], (sample.derivative(2) - np.einsum("nij,nj->ni", dW, v))[:, :, None]
    )[:, :, 0]
    load = evaluate(equations.function("inverse_dynamics"), motion.q, v, a)[0][:, 2]
    spring = evaluate(equations.function("elastic_torque"), motion.q, 0 * v)[0][:, 0]
    assert np.abs(load - spring).max() < 1e-9 * np.abs(spring).max()
    tool = evaluate(equations.function("output"), motion.q)[0]
    assert np.abs(tool - sample.y[:, :, 0]).max() < RIGHT


@pytest.mark.parametrize("method", BASELINES)
def test_rotors_that_turn_with_their_carriers(method: str) -> None:
    changes = {
        "motor_coupling": "complete",
        "motor.m1.axis": [0, 0, 1],
        "motor.m1.carrier": "base",
        "motor.m2.axis": [0, 0, 1],
        "motor.m2.carrier": "arm1",
    }
    assert _error(flexgen.solve(read("planar5_nmp", overrides=changes), method=method)) < 1e-2


@pytest.mark.slow
def test_a_wrong_sign_of_the_deflection_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: elements bent the other way."""
    right = baselines.solve_deflections

    def mirrored(reduction, sample, q, v_e, a_e):  # type: ignore[no-untyped-def]
        found = right(reduction, sample, q, v_e, a_e)
        found[:, reduction.i_e] *= -1
        return reduction.close(found, reduction.targets(sample))

    good = _error(flexgen.solve("planar5_nmp", method="quasistatic"))
    monkeypatch.setattr(baselines, "solve_deflections", mirrored)
    assert _error(flexgen.solve("planar5_nmp", method="quasistatic")) > 30 * good


def test_an_omitted_rotor_is_seen() -> None:
    """Planted bug: rigid torque without the inertia of the rotors, on a machine that is rigid."""
    equations = flexgen.derive("elbow@rigid")
    trajectory = flexgen.solve(equations, method="rigid", verify=False).trajectory
    inertia = np.array([motor.inertia for motor in equations.model.motors])
    wrong = dict(trajectory.channels, tau_m=trajectory["tau_m"] - inertia * trajectory["a_m"])
    assert (
        simulate(equations, dataclasses.replace(trajectory, channels=wrong)).tool_error_max_m or 0
    ) > 1e-4


@pytest.mark.parametrize("method", BASELINES)
def test_gear_torques_balance_the_motors(method: str) -> None:
    """Of each gear: what a motor gives beyond its own inertia and friction."""
    equations = flexgen.derive("planar5_mp")
    model = equations.model
    found = flexgen.solve(equations, method=method, verify=False).trajectory
    friction = evaluate(equations.function("motor_friction"), found["v_m"])[0]
    inertia = np.array([motor.inertia for motor in model.motors])
    carried = found["tau_m"] - inertia * found["a_m"] - friction.reshape(-1, model.n_m)
    expected = carried @ model.eta
    assert np.abs(found["tau_g"] - expected).max() < RIGHT * np.abs(expected).max()


def test_joint_moves_need_no_inverse_kinematics() -> None:
    """Also through a pose where the tool cannot be placed freely: the stretched arm."""
    equations = flexgen.derive("planar5_nmp")
    through = Move("through", "joint", (0.3, -0.4), 0.6, 5, end=(0.3, 0.4))
    motion = stiff_motion(
        Reduction(equations), Path(equations, through), np.linspace(0.0, 0.6, 101)
    )
    assert np.isfinite(motion.tau_g).all() and np.abs(motion.q[:, 1]).min() < 1e-12


def test_models_without_the_baseline_are_refused() -> None:
    with pytest.raises(ArgumentError, match="given rounds 2, expected 0 to 1"):
        flexgen.solve("planar5_mp", method="quasistatic", options={"rounds": 2})
    with pytest.raises(ArgumentError, match="was given 'rounds', expected none"):
        flexgen.solve("planar5_mp", method="rigid", options={"rounds": 1})
    away = Move("away", "tool_line", (0.3, -1.1), 0.5, 5, displacement=(0.5, 0.0, 0.0))
    with pytest.raises(SolverError, match="leaves the workspace or passes a singular pose"):
        flexgen.solve("planar5_mp", away, method="rigid")
