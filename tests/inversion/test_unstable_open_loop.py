"""Growth of perturbations of open loops, verification of unstable ones, and integration of stiff
ones.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion import refinement
from flexgen.inversion.judge.status import Status
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.simulation.integration import integrators
from flexgen.simulation.open_loop import UNSTABLE
from flexgen.simulation.result import error_text
from flexgen.simulation.simulate import simulate
from flexgen.simulation.verification.growth import Motion, growth_along, linearize_along

ROBOTS = Path(__file__).parents[1] / "support" / "robots"
ACCURATE = 1e-8  # rad: of a verified solution of the small arms here


@pytest.fixture(scope="module")
def upright() -> tuple[Equations, flexgen.Solution]:
    """The small upright arm, solved: its open loop grows by 1e9 over the move."""
    equations = derive(ROBOTS / "upright.toml")
    return equations, flexgen.solve(equations)


def changed(trajectory: Trajectory, **channels: np.ndarray) -> Trajectory:
    """The trajectory with other values of some channels."""
    return dataclasses.replace(trajectory, channels={**trajectory.channels, **channels})


def pendulum(tilt: float) -> tuple[RobotModel, float]:
    """A single link with a rigid gear at an angle from upright, and its inertia about the axis."""
    robot = read(ROBOTS / "one.toml")
    motor = dataclasses.replace(robot.motors[0], inertia=0.0)
    body = robot.elements[0].body
    inertia = body.inertia[2][2] + body.mass * body.com[0] ** 2
    home = (np.pi / 2 - tilt,)
    return dataclasses.replace(robot, motors=(motor,), home=home), float(inertia)


@pytest.mark.parametrize("tilt", [0.0, 0.5, np.pi])
def test_growth_of_a_pendulum_is_known(tilt: float) -> None:
    """At rest at an angle from upright: cosh(w t) with J w^2 = m g l cos(tilt); hanging, it does
    not grow.
    """
    robot, inertia = pendulum(tilt)
    t = np.linspace(0.0, 3.0, 601)
    q = np.full((len(t), 1), robot.home[0])
    still = np.zeros_like(q)
    motion = Motion(t, q, still, still, 50 * q, still, still, still)
    found = growth_along(linearize_along(Equations(robot), motion)).movement
    square = robot.elements[0].body.mass * 9.81 * 0.4 * np.cos(tilt) / inertia
    expected = np.cosh(np.sqrt(square) * 3.0) if square > 0 else 1.0
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_the_growth_is_the_simulated_one(upright: tuple[Equations, flexgen.Solution]) -> None:
    """A small change of the first state grows as estimated."""
    equations, solution = upright
    trajectory = solution.trajectory
    n = 601
    short = Trajectory(
        trajectory.time[:n],
        {name: values[:n] for name, values in trajectory.channels.items()},
        trajectory.ports,
        trajectory.labels,
        trajectory.meta,
    )
    names = ("q_a", "v_a", "a_a", "q_m", "v_m", "a_m", "tau_m")
    estimated = growth_along(
        linearize_along(equations, Motion(short.time, *(short[name] for name in names)))
    ).movement
    rng = np.random.default_rng(1)
    grown = 0.0
    still = simulate(equations, short, feedback="none").trajectory
    for _ in range(4):
        moved = rng.normal(size=5)
        size = 1e-6
        moved *= size / np.linalg.norm(moved)
        q_a = short["q_a"].copy()
        q_m = short["q_m"].copy()
        q_a[0] += moved[:3]
        q_m[0] += 20 * moved[3:]
        other = simulate(equations, changed(short, q_a=q_a, q_m=q_m), feedback="none").trajectory
        far = np.hstack([other["q_a"] - still["q_a"], (other["q_m"] - still["q_m"]) / 20])
        grown = max(grown, float(np.linalg.norm(far, axis=1).max() / size))
    assert 0.2 * estimated < grown < 1.1 * estimated
    assert 10 < estimated < 1e5


@pytest.mark.slow
def test_an_upright_arm_is_verified_with_motor_feedback(
    upright: tuple[Equations, flexgen.Solution],
) -> None:
    _, solution = upright
    simulation = solution.simulation
    assert simulation is not None and simulation.growth is not None
    assert solution.status == Status.SOLVED and solution.method == "lq"
    assert simulation.growth > 1e8 > UNSTABLE and simulation.feedback is not None
    assert solution.tool_error_max_rad is not None and solution.tool_error_max_rad < ACCURATE
    assert simulation.energy_error < 1e-9
    # a simulation of the whole move without feedback shows the growth of rounding errors, not the
    # error of the torque
    assert simulation.open_loop is None and "open loop not determined" in str(solution)
    for text in (str(solution), " ".join(solution.warnings), solution._repr_html_()):
        assert simulation.feedback.title in text
    shown = solution.to_dict()
    assert (
        shown["motor_feedback"] == simulation.feedback.title
        and shown["growth"] == simulation.growth
    )
    assert (
        shown["open_loop_error_max_rad"] is None
        and shown["defect_max_rad"] == simulation.defect_max_rad < ACCURATE
    )
    assert solution.trajectory.meta["errors"] == error_text(simulation, "output")


@pytest.mark.slow
def test_a_wrong_torque_is_refused_under_feedback(
    upright: tuple[Equations, flexgen.Solution], monkeypatch: pytest.MonkeyPatch
) -> None:
    equations, _ = upright
    run = refinement.run_method

    def planted(*arguments):  # type: ignore[no-untyped-def]
        found = run(*arguments)
        motors = dataclasses.replace(found.motors, tau_m=1.002 * found.motors.tau_m)
        return dataclasses.replace(found, motors=motors)

    monkeypatch.setattr(refinement, "run_method", planted)
    solution = flexgen.solve(equations, method="lq", mesh=1e-2)
    assert solution.simulation is not None and solution.simulation.feedback is not None
    assert solution.status == Status.TOLERANCE_NOT_MET


def test_sharp_friction_of_a_light_rotor_is_integrated_implicitly() -> None:
    """The explicit method needs ten million evaluations for each second here."""
    solution = flexgen.solve(ROBOTS / "light_rotor.toml")
    simulation = solution.simulation
    assert simulation is not None and simulation.integrator == "LSODA"
    assert solution.status == Status.SOLVED
    assert np.abs(simulation.trajectory["error"]).max() < ACCURATE
    # the tolerance of the implicit method, over the time that the last torque is held
    assert solution.tool_error_max_rad is not None and solution.tool_error_max_rad < 10 * ACCURATE
    assert simulation.evaluations < 30_000


@pytest.mark.slow
def test_the_implicit_method_sees_a_wrong_torque() -> None:
    equations = derive(ROBOTS / "light_rotor.toml")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    wrong = simulate(equations, changed(trajectory, tau_m=1.001 * trajectory["tau_m"]))
    assert wrong.integrator == "LSODA"
    assert wrong.tool_error_max_rad is not None and wrong.tool_error_max_rad > 1e-4


def test_a_system_that_stays_stiff_is_an_error_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(integrators, "EVALUATIONS_STIFF", 1_000)
    equations = derive(ROBOTS / "light_rotor.toml")
    trajectory = flexgen.solve(equations, verify=False).trajectory
    with pytest.raises(
        SolverError, match="the equations of motion are stiff and their solution has steep layers"
    ):
        simulate(equations, trajectory)


@pytest.mark.parametrize("samples", [347, 501, 901])
def test_the_grid_of_the_growth_does_not_depend_on_the_rounding_of_times(samples: int) -> None:
    """Durations that differ in their last digits have the same grid, and growths as near."""
    equations = derive("planar5_nmp")
    n = equations.model.n_a
    n_m = equations.model.n_m
    zero = np.zeros((samples, n))
    moving = np.ones((samples, n))
    motor = np.zeros((samples, n_m))
    times = np.linspace(0.0, 0.35, samples)
    grids = []
    for factor in 1.0 + np.finfo(float).eps * np.arange(-6, 7):
        motion = Motion(times * factor, zero, moving, zero, motor, motor, motor, motor)
        grids.append(linearize_along(equations, motion).at)
    assert all(np.array_equal(grid, grids[0]) for grid in grids)
