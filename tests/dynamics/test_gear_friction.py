"""Friction of motors by gear torque and temperature: the law, closed forms, an own integrator,
refusals.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gear_friction import NUMBERS, loaded, torque
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, ModelError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics import force_laws
from flexgen.exports.mujoco.mujoco_checks import with_friction
from flexgen.feedback.loop.plants import plants_of
from flexgen.simulation.integration import hysteretic_rate

SPEEDS = np.linspace(-60.0, 60.0, 41)
LOADS = np.array([-30.0, -0.1, 0.0, 0.2, 7.0])
# one mass behind a motor and a spring, without gravity
ONE = """
name = "drive"
gravity = [0, 0, 0]
home_rad = [0]
[[element]]
name = "load"
body = {{ mass = 1, inertia = [1.0, 1.0, 2.0] }}
dof = [{{ name = "q", type = "rotation", axis = [0, 0, 1], gear = {gear} }}]
[[motor]]
name = "m"
drives = "q"
ratio = 10
inertia = 0.01
friction = {friction}
[output]
type = "combination"
unit = "rad"
rows = [{{ q = 1.0 }}]
[[move]]
name = "turn"
type = "joint"
start_rad = [0]
end_rad = [1.5]
duration = 1.0
smoothness = 5
"""
ELASTIC = (
    '{ type = "elastic", side = "arm", spring = { type = "linear", stiffness = 4000.0 }, '
    "damping = 3.0 }"
)


def drive(tmp_path: Any, gear: str = ELASTIC, **numbers: Any) -> flexgen.RobotModel:
    table = ", ".join(f"{key} = {value}" for key, value in (NUMBERS | numbers).items())
    path = tmp_path / "drive.toml"
    path.write_text(ONE.format(gear=gear, friction=f'{{ type = "gear", {table} }}'))
    return flexgen.read(path)


@pytest.mark.parametrize("temperature", [-40.0, 20.0, 45.0])
@pytest.mark.parametrize(
    "changed", [{}, {"temperature_rise": 12.0, "reference_temperature": 30.0, "offset": 0.1}]
)
def test_the_law_is_that_of_the_documentation(
    temperature: float, changed: dict[str, float]
) -> None:
    """At -40 degrees C Stribeck friction has fallen to zero and the Stribeck speed to its
    least.
    """
    function = flexgen.derive(loaded("elbow", temperature, **changed)).function("loaded_friction")
    v, load = (x.ravel() for x in np.meshgrid(SPEEDS, LOADS))
    found = evaluate(function, np.column_stack([v, v]), np.column_stack([load, -load]))[0].reshape(
        -1, 2
    )
    assert_allclose(
        found,
        np.column_stack([torque(v, load, temperature, **changed)] * 2),
        rtol=1e-13,
        atol=1e-15,
    )


def test_a_planted_error_of_the_law_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The magnitude of the torque taken with its sign."""
    true = force_laws._gear_friction
    monkeypatch.setattr(
        force_laws, "_gear_friction", lambda law, w, load, warm: true(law, w, load + 1.0, warm)
    )
    with pytest.raises(AssertionError):
        test_the_law_is_that_of_the_documentation(20.0, {})


def test_torques_of_one_mass_on_a_spring_are_the_closed_form(tmp_path: Any) -> None:
    """Joint q(t): gear torque J q'', deflection p by K p + D p' = J q'', motor by hand."""
    solution = flexgen.solve(drive(tmp_path), verify=False, progress=False)
    path = solution.trajectory
    t = path.time
    x = np.clip(path.time / 1.0, 0.0, 1.0)
    coefficients = np.polynomial.Polynomial.fromroots(
        [0.0] * 5 + [1.0] * 5
    ).integ()  # of smoothness 5: b' ~ (x (1-x))^5
    shape = np.polynomial.Polynomial(coefficients.coef / coefficients(1.0))
    assert_allclose(path["q_a"][:, 0], 1.5 * shape(x), atol=1e-9)
    inside = t <= 1.0

    def rate(at: float, p: np.ndarray) -> np.ndarray:
        return np.asarray((2.0 * 1.5 * shape.deriv(2)(at) - 4000.0 * p) / 3.0)

    p = solve_ivp(rate, (0.0, 1.0), [0.0], "Radau", t[inside], rtol=1e-10, atol=1e-14).y[0]
    force = 2.0 * 1.5 * shape.deriv(2)(t[inside])
    dp = (force - 4000.0 * p) / 3.0
    ddp = (2.0 * 1.5 * shape.deriv(3)(t[inside]) - 4000.0 * dp) / 3.0
    v = 10 * (1.5 * shape.deriv(1)(t[inside]) + dp)
    a = 10 * (1.5 * shape.deriv(2)(t[inside]) + ddp)
    expected = 0.01 * a + torque(v, force / 10) + force / 10
    assert_allclose(path["tau_m"][inside, 0], expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    without = expected - torque(v, force / 10) + torque(v, 0.0 * force)
    assert np.abs(without - expected).max() > 1e-2 * np.abs(expected).max()


@pytest.mark.slow
def test_an_own_integrator_under_the_torques_follows_the_path(tmp_path: Any) -> None:
    """The two equations of motion, with the law in NumPy; with the load of the law left out it
    does not.
    """
    path = flexgen.solve(drive(tmp_path), verify=False, progress=False).trajectory
    times = np.linspace(0.0, 0.5, 50_001)
    torques = path.at(times)["tau_m"][:, 0]

    def last(share: float) -> float:
        def rate(t: float, y: np.ndarray) -> list[float]:
            q, q_m, v, v_m = y
            gear = 4000.0 * (q_m / 10 - q) + 3.0 * (v_m / 10 - v)
            given = np.interp(t, times, torques)
            return [
                v,
                v_m,
                gear / 2.0,
                (given - gear / 10 - torque(v_m, share * gear / 10)) / 0.01,
            ]

        found = solve_ivp(
            rate, (0.0, 0.5), [0.0] * 4, "Radau", rtol=1e-8, atol=1e-11, max_step=2e-3
        )
        return abs(found.y[0, -1] - path.at([0.5])["q_a"][0, 0])

    assert last(1.0) < 1e-7 < 1e-3 < last(0.0)


@pytest.mark.slow
def test_simulation_and_loop_have_the_friction() -> None:
    """Under the torques of solve; those of a robot without load miss its path."""
    robot = loaded("elbow")
    other = loaded("elbow", load_coulomb=0.0, load_stribeck=0.0)
    known, unknown = (flexgen.solve(each, verify=False, progress=False) for each in (robot, other))
    right, wrong = (
        flexgen.simulate(robot, x.trajectory, feedback="ppi").tool_error_max_m
        for x in (known, unknown)
    )
    assert right < 1e-9 < 1e-5 < wrong
    loop = [flexgen.control(robot, solution=each, progress=False) for each in (known, unknown)]
    errors = [run.distance(run.runs[0]).max() for run in loop]
    assert errors[0] < 1e-6 < 1e-5 < errors[1]


@pytest.mark.slow
def test_hysteresis_is_in_the_load(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulation, residual of the status and loop; a planted error: the load of the springs alone
    in the simulation.
    """
    robot = loaded("elbow", lost_motion=3e-4)
    solution = flexgen.solve(robot, progress=False)
    assert solution.status == "solved" and solution.simulation.tool_error_max_m < 1e-9
    run = flexgen.control(robot, solution=solution, progress=False)
    assert run.distance(run.runs[0]).max() < 1e-9
    monkeypatch.setattr(hysteretic_rate, "friction_changes", lambda e, z: 0.0 * e.lagrangian.v_m)
    # of another robot, whose rate is not known yet
    again = loaded("elbow", lost_motion=3.0000001e-4)
    assert flexgen.simulate(again, solution.trajectory, feedback="ppi").tool_error_max_m > 1e-7


def test_energy_that_is_lost_is_that_of_the_friction() -> None:
    """d(energy)/dt = P_motor - P_dissipated at random states."""
    e = flexgen.derive(loaded("elbow", 35.0))
    rng = np.random.default_rng(1)
    q = rng.uniform(-1, 1, 2)
    v = rng.uniform(-1, 1, 2)
    tau = rng.uniform(-5, 5, 2)
    q_m = e.model.eta @ q + 1e-3
    v_m = e.model.eta @ v
    a, a_m = (np.asarray(x).ravel() for x in e.function("forward_dynamics")(q, v, q_m, v_m, tau))
    motor, lost = (float(x) for x in e.function("power")(q, v, q_m, v_m, tau))
    h = 1e-6
    energy = e.function("energy")

    def at(s: float) -> float:
        states = q + s * v + s**2 / 2 * a, v + s * a, q_m + s * v_m + s**2 / 2 * a_m, v_m + s * a_m
        return sum(float(x) for x in energy(*states))

    assert (at(h) - at(-h)) / (2 * h) == pytest.approx(motor - lost, rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"motor.m1.friction": {"type": "gear", "load_coulomb": 0.1}}, "load_coulomb"),
        (
            {"motor.m1.friction": {"type": "gear", "load_coulomb": 0.1, "beta": 1.0}},
            "load_smoothing",
        ),
        (
            {"motor.m1.friction": {"type": "gear", "viscous_share": 1.1, "viscous_decay": 9.0}},
            "at most 1|<= 1|1.1",
        ),
        ({"motor.m1.friction": {"type": "gear", "viscous_share": 0.5}}, "viscous_decay"),
        ({"motor.m1.friction": {"type": "gear", "stribeck_slope": -1e-3, "beta": 1.0}}, "alpha"),
        ({"motor.m1.friction": {"load_coulomb": 0.1, "beta": 1.0}}, "load_coulomb"),
        ({"element.upper.dof.q1.friction": {"type": "gear", "viscous": 1.0}}, "of motors"),
        ({"temperature": 301.0}, "temperature"),
        ({"temperature": "warm"}, "temperature"),
    ],
)
def test_wrong_tables_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ModelError, match=text):
        flexgen.read("elbow", overrides=changes)


def test_rigid_gears_whose_torque_depends_on_the_friction_are_refused(tmp_path: Any) -> None:
    with pytest.raises(ModelError, match="its gear is rigid"):
        drive(tmp_path, '{ type = "rigid" }')


def test_temperature_alone_is_allowed_behind_rigid_gears(tmp_path: Any) -> None:
    numbers = {"load_coulomb": 0.0, "load_stribeck": 0.0, "load_smoothing": 0.0}
    robot = drive(tmp_path, '{ type = "rigid" }', **numbers)
    robots = robot, flexgen.read(tmp_path / "drive.toml", overrides={"temperature": 60.0})
    solved = [flexgen.solve(each, verify=False, progress=False).trajectory for each in robots]
    v = solved[0]["v_m"]
    change = torque(v, 0.0, 60.0, load_coulomb=0.0) - torque(v, 0.0, load_coulomb=0.0)
    assert_allclose(solved[1]["tau_m"] - solved[0]["tau_m"], change, rtol=0, atol=1e-12)
    assert np.abs(change).max() > 1e-2


def test_viscous_friction_alone_is_that_of_the_temperature() -> None:
    """As in an MJCF file; the slope of the law at high speed."""
    found = with_friction(loaded("elbow", 50.0), "viscous").motors[0].friction
    assert found.viscous == pytest.approx(
        (torque(3e3, 0.0, 50.0) - torque(2e3, 0.0, 50.0)) / 1e3, rel=1e-12
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda robot: flexgen.solve(
            robot, limits=flexgen.Limits(torque=(90.0, 90.0)), method="full"
        ),
        lambda robot: flexgen.derive(robot).function("motor_friction"),
        lambda robot: flexgen.generate(robot, functions=["motor_friction"]),
        lambda robot: flexgen.export_mujoco(robot, "never.xml", friction="viscous"),
        lambda robot: flexgen.feedback_study(robot),
        lambda robot: flexgen.CollisionDetector(robot, 1e-3),
    ],
)
def test_what_does_not_know_it_refuses_it(
    call: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ArgumentError, BuildError), match=r"friction|load"):
        call(loaded("elbow"))


def test_the_ros_2_plugin_refuses_the_friction_of_velocities_alone(tmp_path: Any) -> None:
    flexgen.export_ros2(loaded("elbow"), tmp_path, controller=False)
    text = (tmp_path / "src" / "inverse_dynamics.cpp").read_text(encoding="ascii")
    assert (
        "motor m1 has a friction that depends on the torque of its gear" in text
        and "motor_friction" not in text
    )


def test_a_description_has_table_and_temperature() -> None:
    """The table can be read again."""
    found = flexgen.describe(loaded("elbow", 31.0))
    assert found["temperature"] == 31.0 and "temperature" not in flexgen.describe("elbow")
    again = flexgen.read("elbow", overrides={"motor.m1.friction": found["motors"][0]["friction"]})
    assert again.motors[0].friction == loaded("elbow").motors[0].friction


def test_a_plant_with_twice_the_friction_has_twice_its_torque() -> None:
    """The numbers of the plant that `plants_of` finds, in the law."""
    found = plants_of(loaded("elbow", 35.0), {"more": {"friction": 2.0}})
    values = {p.name: x for p, x in zip(found.parameters, found.values[0], strict=True)}
    twice = {name: values.get(f"m1.{name}", value) for name, value in NUMBERS.items()}
    assert_allclose(torque(SPEEDS, 3.0, 35.0, **twice), 2 * torque(SPEEDS, 3.0, 35.0), rtol=1e-14)
