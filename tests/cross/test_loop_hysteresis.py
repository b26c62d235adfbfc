"""Gears with hysteresis in the closed loop: MuJoCo with a law of the tests, other models, energy,
planted errors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hysteretic import (
    ARCMIN,
    BENT,
    error_in_mujoco,
    error_with_elements,
    hysteretic,
    with_elements,
)
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.hysteresis.hysteresis import gear_hysteresis, gear_layers, torque_along
from flexgen.dynamics.mechanics.lagrangian import gears
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.feedback.loop import hysteresis as loop
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.channels import ACCELEROMETER, channels_of
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.inversion.problem.sampling import second_time_derivative, time_derivative

pytestmark = needs_compiler
OPEN = {"controller": "none", "sample_time": 1e-4, "torque_limits": False, "progress": False}
AGREES = 1e-6  # of the error
WIDER = {"wide": {"lost_motion": 1.2}, "without": {"lost_motion": 0.0}}


@pytest.fixture(scope="module")
def plain() -> flexgen.Solution:
    """The move of a robot whose model lacks the hysteresis."""
    return flexgen.solve(with_friction(flexgen.read("elbow"), "viscous"), progress=False)


def error_of(run: flexgen.ControlRun, name: str = "nominal") -> float:
    """Largest tool error [m] until 0.1 s after the move, as in MuJoCo."""
    time = run.reference.time
    return float(
        run.distance(run[name])[(time >= 0.0) & (time <= run.reference.end + 0.1 + 1e-9)].max()
    )


def times(factor: float, function: Any) -> Any:
    return lambda *given: factor * function(*given)


@pytest.mark.slow
def test_the_loop_has_the_errors_of_mujoco(plain: flexgen.Solution) -> None:
    """44.5 um of the torques that lack the hysteresis, without feedback: 2e-13 m apart; also where
    it is 20 % wider.
    """
    pytest.importorskip("mujoco")
    run = flexgen.control(hysteretic("elbow"), solution=plain, plants=WIDER, **OPEN)
    assert run.status == "done"
    for name, lost_motion in (("nominal", ARCMIN), ("wide", 1.2 * ARCMIN)):
        expected = error_in_mujoco("elbow", plain.trajectory, lost_motion, feedback=False)
        assert expected > 3e-5
        assert error_of(run, name) == pytest.approx(expected, rel=AGREES)
    assert error_of(run, "without") < 1e-9


@pytest.mark.slow
def test_several_elements_have_the_errors_of_mujoco(plain: flexgen.Solution) -> None:
    """Three elements; a factor of lost_motion is one of all of them."""
    pytest.importorskip("mujoco")
    model = with_elements("elbow", BENT)
    run = flexgen.control(model, solution=plain, plants=WIDER, **OPEN)
    assert run.status == "done"
    expected = error_with_elements("elbow", plain.trajectory, BENT, feedback=False)
    assert expected > 3e-5
    assert error_of(run) == pytest.approx(expected, rel=AGREES)
    wide = [replace(each, lost=1.2 * each.lost) for each in BENT]
    expected = error_with_elements("elbow", plain.trajectory, wide, feedback=False)
    assert error_of(run, "wide") == pytest.approx(expected, rel=AGREES)
    assert error_of(run, "without") < 1e-9


@pytest.mark.parametrize(
    ("planted", "factor"),
    [("generalized_force", -1.0), ("deflection_rates", -1.0), ("deflection_rates", 0.9)],
)
def test_planted_errors_of_the_law_are_found(
    planted: str, factor: float, plain: flexgen.Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sign of the force, the sign of z', and z' that is 10 % too small."""
    pytest.importorskip("mujoco")
    expected = error_in_mujoco("elbow", plain.trajectory, ARCMIN, feedback=False)
    monkeypatch.setattr(loop, planted, times(factor, getattr(loop, planted)))
    run = flexgen.control(hysteretic("elbow"), solution=plain, **OPEN)
    assert run.status != "done" or error_of(run) != pytest.approx(expected, rel=1e4 * AGREES)


@pytest.mark.slow
def test_robots_with_other_numbers_are_models_with_these_numbers(plain: flexgen.Solution) -> None:
    """Slip torques follow the springs; a force on the tool and a load act on all."""
    push = [
        flexgen.Disturbance("pulse", "tool.x", 300.0, 0.25, 0.02),
        flexgen.Disturbance("step", "m1", 0.1, 0.1),
    ]
    changes = {
        "soft": {"q1.stiffness": 0.8, "q2.lost_motion": 1.5},
        "without": {"lost_motion": 0.0, "payload": 1.0},
    }
    model = hysteretic("elbow")
    options = {"solution": plain, "disturbances": push, "progress": False}
    run = flexgen.control(model, plants=changes, **options)
    options["controller"] = run.law
    key = "element.upper.dof.q1.gear.spring.stiffness"
    stiffness = [gear.spring.stiffness for gear, _ in gears(model)]
    tables = {"element.upper.dof.q1.gear": (1.0, 0), "element.fore.dof.q2.gear": (1.5, 1)}
    soft = flexgen.read(
        "elbow",
        overrides={key: 0.8 * stiffness[0]}
        | {
            f"{gear}.hysteresis": {"lost_motion": factor * ARCMIN, "stiffness": stiffness[k]}
            for gear, (factor, k) in tables.items()
        },
    )
    assert gear_hysteresis(soft).slip == pytest.approx(
        gear_hysteresis(model).slip * np.array([0.8, 1.5])
    )
    alone = flexgen.control(with_friction(soft, "viscous"), **options)
    assert_allclose(run["soft"].q_a, alone.nominal.q_a, rtol=0, atol=1e-12)
    other = flexgen.control(plain.model, plants={"without": {"payload": 1.0}}, **options)
    # recursion, not Lagrange's equations
    assert_allclose(run["without"].q_a, other["without"].q_a, rtol=0, atol=1e-9)


def test_the_loop_balances_the_energy(plain: flexgen.Solution) -> None:
    """Work of the held torques = energy + losses + int z dd, with z along the recorded deflections
    in closed form.
    """
    model = hysteretic("elbow")
    run = flexgen.control(model, solution=plain, **OPEN)
    moving = run.reference.time >= 0.0
    step = OPEN["sample_time"]
    (q_a, q_m, tau) = (x[moving] for x in (run.nominal.q_a, run.nominal.q_m, run.nominal.tau_m))
    v_a = time_derivative(q_a, step)
    v_m = time_derivative(q_m, step)
    d = q_m @ np.linalg.inv(model.eta).T - q_a[:, list(model.i_g)]
    z = torque_along(gear_layers(model), d - d[0])
    lost = float(np.sum((z[1:] + z[:-1]) / 2 * np.diff(d, axis=0)))
    equations = flexgen.derive(model)
    kinetic, potential = evaluate(equations.function("energy"), q_a, v_a, q_m, v_m)
    _, dissipated = evaluate(equations.function("power"), q_a, v_a, q_m, v_m, tau)
    gained = float((kinetic + potential)[-1, 0] - (kinetic + potential)[0, 0]) + np.trapezoid(
        dissipated[:, 0], dx=step
    )
    work = float(np.sum(tau[:-1] * np.diff(q_m, axis=0)))
    assert lost > 1e-3
    assert work - gained == pytest.approx(lost, rel=1e-3)


def test_accelerometers_feel_the_torques_of_the_gears(plain: flexgen.Solution) -> None:
    """Their signals are those of the second differences of the recorded motion, not those of the
    springs alone.
    """
    model = channels_of(hysteretic("elbow"), ("motors", ACCELEROMETER)).model
    model = replace(model, sensors=tuple(replace(sensor, noise=0.0) for sensor in model.sensors))
    run = flexgen.control(model, solution=plain, **OPEN)
    q_a = run.nominal.q_a
    q_m = run.nominal.q_m
    step = OPEN["sample_time"]
    v_a = time_derivative(q_a, step)
    a_a = second_time_derivative(q_a, step)
    v_m = time_derivative(q_m, step)
    equations = flexgen.derive(model)
    springs = evaluate(
        equations.function("forward_dynamics"), q_a, v_a, q_m, v_m, run.nominal.tau_m
    )[0]
    signals = equations.function("sensors")
    inside = slice(50, -50)
    felt, forgotten = (evaluate(signals, q_a, v_a, a)[0][inside] for a in (a_a, springs))
    shown = run.nominal.sensors[inside]
    assert_allclose(shown, felt, rtol=0, atol=1e-6 * np.ptp(felt))
    assert np.abs(shown - forgotten).max() > 0.01 * np.ptp(felt)


def test_feedforward_that_knows_the_hysteresis_leaves_no_error(plain: flexgen.Solution) -> None:
    """Of 74 um under the proposed feedback; a loop 20 % wider than the model's has a small part of
    that.
    """
    model = hysteretic("elbow")
    unknown = flexgen.control(model, solution=plain, progress=False)
    known = flexgen.control(model, plants=WIDER, progress=False)
    errors = [known.distance(robot).max() for robot in known.runs]
    assert errors[0] < 1e-9 < 5e-5 < error_of(unknown)
    assert 1e-7 < errors[1] < 0.1 * error_of(unknown) < errors[2]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar5_nmp", "manutec_r3_18"])
def test_the_loop_of_larger_robots(name: str) -> None:
    """Under the proposed feedback 462 and 324 um are left as 0.012 and 0.002 um; a loop 20 %
    wider: 84 and 49 um.
    """
    model = hysteretic(name)
    base = with_friction(flexgen.read(name), "viscous")
    given = flexgen.solve(base, progress=False)
    unknown = error_of(flexgen.control(model, solution=given, progress=False))
    known = flexgen.control(model, plants={"wide": {"lost_motion": 1.2}}, progress=False)
    assert error_of(known) < 5e-8 < 3e-4 < unknown
    assert 1e-5 < error_of(known, "wide") < 0.25 * unknown
    simulated = flexgen.simulate(model, given.trajectory, feedback="ppi").tool_error_max_m
    assert unknown == pytest.approx(simulated, rel=0.02)  # whose feedback is not sampled


def test_steps_that_are_too_long_for_the_law_are_an_error(plain: flexgen.Solution) -> None:
    """A loop of 3e-8 rad needs many steps a sample; with one the robot is said to have stopped."""
    narrow = {"narrow": {"lost_motion": 1e-4}}
    case = control_case(hysteretic("elbow"), solution=plain, plants=narrow)
    law, name = case_controller(case, "ppi")
    right = run_case(case, law, name)
    assert right.status == "done" and right.steps > 3
    wrong = run_case(replace(case, rate=1.0), law, name, steps=1)
    assert wrong["narrow"].failure == "gears or frictions slip too fast for the integration steps"
    assert not wrong.nominal.failure


@pytest.mark.slow
def test_positions_that_are_held_slip_faster_than_the_planned_motion() -> None:
    """Every 12 ms: the steps for the planned speeds are too long; with 16 or 199 of them the error
    is 1.1187 mm.
    """
    found = flexgen.command_positions(
        hysteretic("elbow"), period=0.012, interpolation="hold", progress=False
    )
    assert found.status == "solved" and found.today.status == "done" and found.run.steps > 1
    assert found.tool_error_max_m == pytest.approx(1.1187e-3, rel=1e-3)


def test_robots_in_a_batch_have_the_bits_of_one_alone(plain: flexgen.Solution) -> None:
    both = flexgen.control(
        hysteretic("elbow"), solution=plain, plants={"same": {}}, progress=False
    )
    alone = flexgen.control(hysteretic("elbow"), solution=plain, progress=False)
    assert np.array_equal(both["same"].q_a, alone.nominal.q_a)


def test_laws_and_linear_controllers_use_springs_and_dampers(plain: flexgen.Solution) -> None:
    model = hysteretic("elbow")
    for controller in ("lqg", "ppi_notch", flexgen.ComputedTorque()):
        run = flexgen.control(
            model, solution=plain, controller=controller, exact_state=True, progress=False
        )
        assert run.status == "done", controller


def test_a_model_without_hysteresis_has_no_lost_motion() -> None:
    with pytest.raises(
        ArgumentError, match="plant wide, lost_motion: the model elbow has no number of this kind"
    ):
        flexgen.control("elbow", plants={"wide": {"lost_motion": 1.2}}, progress=False)
