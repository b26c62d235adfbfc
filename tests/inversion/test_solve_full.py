"""The full model: limits on torque and speed, complete coupling, kinks and backlash."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.judge.status import Status
from flexgen.model.reader import read
from flexgen.simulation.simulate import simulate

COMPLETE = {
    "motor_coupling": "complete",
    "motor.m1.axis": [0, 0, 1],
    "motor.m1.carrier": "base",
    "motor.m2.axis": [0, 0, 1],
    "motor.m2.carrier": "arm1",
    "motor.m2.inertia": 0.01,
}
MICRON = 1e-6  # what a user is promised


def test_torque_limits_are_kept_at_their_lower_end_too() -> None:
    """With gravity upwards the largest torque of the first motor is a negative one."""
    robot = read("planar5_nmp", overrides={"gravity": [0.0, 9.81, 0.0]})
    limits = Limits(torque=(20.0, 30.0))
    found = flexgen.solve(robot, method="full", limits=limits, verify=False)
    lowest = found.trajectory["tau_m"][:, 0].min()
    assert found.status == Status.LIMITS_ACTIVE and lowest == pytest.approx(-20.0, rel=1e-6)


@pytest.mark.slow
def test_full_and_reduced_agree() -> None:
    equations = flexgen.derive("planar5_nmp")
    reduced = flexgen.solve(equations, verify=False)
    full = flexgen.solve(equations, method="full")
    assert full.tool_error_max_m is not None and full.tool_error_max_m < MICRON
    t = np.linspace(0, 0.5, 100)
    torques = [
        make_interp_spline(s.trajectory.time, s.trajectory["tau_m"], k=5)(t)
        for s in (reduced, full)
    ]
    # what the tool does not feel is free: a torque ripple at the frequency of the mesh, a
    # hundredth at most
    assert np.abs(torques[0] - torques[1]).max() < 1e-2 * np.abs(torques[0]).max()


def test_torque_limits_are_kept_and_the_deviation_is_reported() -> None:
    equations = flexgen.derive("planar5_nmp")
    free = flexgen.solve(equations, verify=False)
    bound = tuple(0.9 * np.abs(free.trajectory["tau_m"]).max(axis=0))
    solution = flexgen.solve(equations, method="full", limits=Limits(torque=bound))
    assert solution.method == "full" and solution.status == Status.LIMITS_ACTIVE
    assert (
        np.abs(solution.trajectory["tau_m"]).max(axis=0) <= np.array(bound) * (1 + 1e-12)
    ).all()
    assert solution.tool_error_max_m is not None and 1e-4 < solution.tool_error_max_m < 1e-2
    # the plan itself is verified as closely as an exact path would be
    assert solution.plan_error_max is not None and solution.plan_error_max < 1e-5


@pytest.mark.slow
def test_speed_limits_are_kept() -> None:
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(equations, method="full", limits=Limits(speed=(1000.0, 250.0)))
    assert solution.status == Status.LIMITS_ACTIVE
    # bounded at the Gauss points; between them it may be passed by a trifle
    assert np.abs(solution.trajectory["v_m"][:, 1]).max() < 250.0 * 1.001


def test_limits_that_do_not_bind_change_nothing() -> None:
    solution = flexgen.solve("planar5_nmp", method="full", limits=Limits(torque=(30.0, 10.0)))
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < 2 * MICRON


def test_limits_of_the_model_file() -> None:
    assert Limits.from_model(read("four_mass")).torque == (20.0,)
    with pytest.raises(ArgumentError, match="states none"):
        Limits.from_model(read("planar5_mp"))
    with pytest.raises(ArgumentError, match="expected 2 positive numbers"):
        flexgen.solve("planar5_mp", method="full", limits=Limits(torque=(1.0, -2.0)))


def test_limits_below_gravity_are_refused() -> None:
    with pytest.raises(SolverError, match=r"motor m1 needs 8\.57 N m to hold the arm"):
        flexgen.solve("planar5_nmp", method="full", limits=Limits(torque=(5.0, 6.0)))


@pytest.mark.slow
def test_gear_torque_channel_is_that_of_the_gears() -> None:
    for name, changes in (("planar5_nmp", COMPLETE), ("elbow@rigid", {}), ("elbow", {})):
        equations = flexgen.derive(read(name, overrides=changes))
        trajectory = flexgen.solve(equations, method="full", verify=False).trajectory
        if not equations.model.i_m:
            arm = [trajectory[x] for x in ("q_a", "v_a", "a_a")]
            right = evaluate(equations.function("inverse_dynamics"), *arm)[0]
            right = right - evaluate(equations.function("arm_forces"), *arm[:2])[0]
            # the torque's polynomial between the Gauss points, where the equations need not hold
            close = 1e-2
        else:
            state = [trajectory[x] for x in ("q_a", "v_a", "q_m", "v_m")]
            right = evaluate(equations.function("gear_torque"), *state)[0]
            close = 1e-9
        assert np.abs(right - trajectory["tau_g"]).max() < close * np.abs(right).max()


@pytest.mark.slow
def test_a_gear_with_a_kink_is_solved_by_the_full_method() -> None:
    solution = flexgen.solve("four_mass@piecewise")
    assert (solution.method, solution.status) == ("full", Status.SOLVED)
    assert (solution.tool_error_max_m or 1) < 2 * MICRON
    exact = flexgen.solve("four_mass@piecewise", method="collocation", mesh=0.005)
    assert exact.status == Status.TOLERANCE_NOT_MET  # its torque would have to jump


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "full"])
def test_backlash_is_solved_when_the_closed_form_fails(method: str) -> None:
    said: list[str] = []
    solution = flexgen.solve("kr300@backlash", method=method, progress=said.append)
    assert any(
        "trying method lq; before: closed-form: verified error" in line for line in said
    ) == (method == "auto")
    assert (solution.method, solution.status) == (
        "lq" if method == "auto" else "full",
        Status.SOLVED,
    )
    assert (solution.tool_error_max_m or 1) < 2 * MICRON and (
        solution.tool_error_max_rad or 1
    ) < 2 * MICRON


@pytest.mark.slow
def test_complete_motor_coupling() -> None:
    """Rotors that turn with their carriers: solved by the full method; leaving the coupling out
    shows in the tool.
    """
    complete = flexgen.derive(read("planar5_nmp", overrides=COMPLETE))
    solution = flexgen.solve(complete, method="full")
    assert solution.method == "full" and solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 1) < 2 * MICRON
    simple = read("planar5_nmp", overrides={"motor.m2.inertia": 0.01})
    careless = flexgen.solve(simple, verify=False)
    assert (simulate(complete, careless.trajectory).tool_error_max_m or 0) > 100 * MICRON


def test_wrong_limits_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"expected flexgen\.Limits"):
        flexgen.solve("planar5_mp", limits=(1.0, 2.0))  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_fallback_that_fails_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    from flexgen.inversion.methods import spline

    def broken(*arguments: object, **options: object) -> object:
        raise SolverError("no")

    # the output of this arm is flat at some poses
    monkeypatch.setattr(spline, "solve", broken)
    said: list[str] = []
    # an accuracy that no method reaches: the first one's answer is kept
    solution = flexgen.solve("abb_arm", mesh=0.005, accuracy=1e-15, progress=said.append)
    assert (solution.method, solution.status) in (
        ("lq", Status.TOLERANCE_NOT_MET),
        ("collocation", Status.TOLERANCE_NOT_MET),
    )
    assert said[-1] == "method spline failed: no"
    assert all("no bounded motion" not in text for text in solution.warnings)


def test_exceeded_limits_are_warned_of() -> None:
    changes = {
        "motor.m1.torque_max": 20.0,
        "element.arm2.dof.q2.speed_max": 1.0,
        "element.arm1.dof.q1.acceleration_max": 2.0,
    }
    warnings = flexgen.solve(read("planar5_nmp", overrides=changes), verify=False).warnings
    assert len(warnings) == 3
    assert "motor m1: torque 24.48 N m exceeds its limit 20 N m" in warnings
