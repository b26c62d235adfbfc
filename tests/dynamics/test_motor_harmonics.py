"""Fourier sums of motor angles against an own drive of one joint, and by power balance; planted
errors.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from harmonic import COGGING, ERROR, RIPPLE, harmonic, value
from hysteretic import hysteretic
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.fourier import FourierSum
from flexgen.codegen.recursion.functions import recursive_function
from flexgen.dynamics.mechanics import lagrangian as lagrangian_module
from flexgen.dynamics.mechanics import motor_harmonics as law_of
from flexgen.dynamics.mechanics.signatures import offered_functions
from flexgen.identification.rigid.rigid_regressor import Regressor

J_A = 2.0
J_M = 1e-3
N = 80.0
K = 5e4
D = 40.0
VISCOUS = 2e-3
DRIVE = f"""
name = "drive"
gravity = [0, 0, -9.81]
home_rad = [0.0]
[[element]]
name = "link"
body = {{ mass = 1.0, com = [0, 0, 0], inertia = [1.0, 1.0, {J_A}] }}
[[element.dof]]
name = "q1"
type = "rotation"
axis = [0, 0, 1]
gear = {{ type = "elastic", side = "arm", spring = {{ type = "linear", stiffness = {K} }}, \
damping = {D} }}
[[motor]]
name = "m1"
drives = "q1"
ratio = {N}
inertia = {J_M}
friction = {{ viscous = {VISCOUS} }}
[output]
type = "combination"
unit = "rad"
rows = [{{ q1 = 1.0 }}]
[[move]]
name = "turn"
type = "joint"
start_rad = [0.0]
end_rad = [1.0]
duration = 0.5
smoothness = 5
"""
SUMS: dict[str, Any] = {
    "element.link.dof.q1.gear.transmission_error": ERROR,
    "motor.m1.cogging": COGGING,
    "motor.m1.torque_ripple": RIPPLE,
}


@pytest.fixture
def drive(tmp_path: Path) -> flexgen.RobotModel:
    (tmp_path / "drive.toml").write_text(DRIVE)
    return flexgen.read(tmp_path / "drive.toml", overrides=SUMS)


def own_accelerations(
    q: float, v: float, q_m: np.ndarray, v_m: np.ndarray, tau: np.ndarray
) -> tuple[Any, Any]:
    """By hand: virtual work of the spring torque in d = q_m/n - e(q_m) - q, with delta q and delta
    q_m.
    """
    e = value(ERROR, q_m)
    slope = value(ERROR, q_m, 1)
    torque = K * (q_m / N - e - q) + D * (v_m / N - slope * v_m - v)
    motor = (
        tau * (1 + value(RIPPLE, q_m))
        + value(COGGING, q_m)
        - VISCOUS * v_m
        - torque * (1 / N - slope)
    )
    return torque / J_A, motor / J_M


def states(n: int) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    q, v = rng.normal(size=(2, n))
    return [
        q,
        v,
        N * q + 0.3 * rng.normal(size=n),
        N * v + 5.0 * rng.normal(size=n),
        rng.normal(size=n),
    ]


def dynamics_error(model: flexgen.RobotModel) -> float:
    """Largest relative difference of the accelerations to those by hand."""
    forward = flexgen.derive(model).function("forward_dynamics")
    worst = 0.0
    for state in np.array(states(20)).T:
        expected = own_accelerations(*(np.array(x) for x in state))
        found = [float(x) for x in forward(*state)]
        worst = max(
            worst, *(abs(a - b) / (1 + abs(b)) for a, b in zip(found, expected, strict=True))
        )
    return worst


def test_a_drive_moves_as_its_equations_by_hand(drive: flexgen.RobotModel) -> None:
    assert dynamics_error(drive) < 1e-10


@pytest.mark.parametrize("planted", ["sign of e'", "factor n", "no e' on the motor"])
def test_planted_errors_of_the_gear_are_found(
    drive: flexgen.RobotModel, monkeypatch: pytest.MonkeyPatch, planted: str
) -> None:
    wrong = {"sign of e'": -1.0, "factor n": N, "no e' on the motor": 0.0}[planted]
    right = law_of.gear_rates

    def rates(model: flexgen.RobotModel, q_m: ca.SX) -> ca.SX:
        plain = ca.SX(ca.DM(np.linalg.inv(model.eta)))
        return plain + wrong * (right(model, q_m) - plain)

    monkeypatch.setattr(lagrangian_module, "gear_rates", rates)
    assert dynamics_error(drive) > 1e-3


def test_the_energy_is_that_of_masses_spring_and_cogging(drive: flexgen.RobotModel) -> None:
    """The cogging torque is minus the slope of its energy, in which only differences count."""
    energy = flexgen.derive(drive).function("energy")
    rows = []
    for q, v, q_m, v_m, _ in np.array(states(10)).T:
        angles = np.linspace(0.0, q_m, 20001)
        middle = (angles[1:] + angles[:-1]) / 2
        work = float(value(COGGING, middle).sum() * (angles[1] - angles[0]))
        spring = K * (q_m / N - value(ERROR, np.array(q_m)) - q) ** 2 / 2
        kinetic, potential = (float(x) for x in energy(q, v, q_m, v_m))
        assert kinetic == pytest.approx(J_A * v**2 / 2 + J_M * v_m**2 / 2, rel=1e-12)
        rows.append(potential - spring + work)
    assert_allclose(rows, rows[0], rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["elbow", "manutec_r3_18"])
def test_power_balance(name: str) -> None:
    """The change of the energy is the power of the motors less that of the frictions, at random
    states.
    """
    model = harmonic(name)
    equations = flexgen.derive(model)
    rng = np.random.default_rng(3)
    n = model.n_a
    n_m = model.n_m
    i_g = list(model.i_g)
    x = ca.SX.sym("x", 2 * (n + n_m))
    rates = ca.SX.sym("rates", 2 * (n + n_m))
    stored = sum(
        equations.function("energy")(*ca.vertsplit(x, [0, n, 2 * n, 2 * n + n_m, 2 * (n + n_m)]))
    )
    slope = ca.Function("slope", [x, rates], [ca.jtimes(stored, x, rates)])
    for _ in range(5):
        q, v = rng.uniform(-1.0, 1.0, (2, n))
        motors = [model.eta @ x[i_g] + rng.uniform(-0.1, 0.1, n_m) for x in (q, v)]
        tau = rng.uniform(-5.0, 5.0, n_m)
        a, a_m = (
            np.array(x).ravel() for x in equations.function("forward_dynamics")(q, v, *motors, tau)
        )
        given, lost = (float(each) for each in equations.function("power")(q, v, *motors, tau))
        found = float(slope(np.r_[q, v, motors[0], motors[1]], np.r_[v, a, motors[1], a_m]))
        assert found == pytest.approx(given - lost, rel=1e-9, abs=1e-9 * (abs(given) + abs(lost)))


@pytest.mark.slow
def test_the_recursion_is_the_lagrangian() -> None:
    model = harmonic("manutec_r3_18")
    equations = flexgen.derive(model)
    rng = np.random.default_rng(1)
    for name in ("forward_dynamics", "residual_jacobians", "forward_dynamics_tool_force"):
        fast = recursive_function(equations, name)
        assert fast is not None
        given = [rng.uniform(-1.0, 1.0, fast.size1_in(k)) for k in range(fast.n_in())]
        for one, other in zip(fast(*given), equations.function(name)(*given), strict=True):
            one = np.array(one)
            other = np.array(other)
            assert_allclose(one, other, rtol=0, atol=1e-9 * np.abs(other).max())


# --- the stage behind the inverse ----------------------------------------------------------------


@pytest.mark.parametrize("steep", [1e-6, 0.05, 0.49])
@pytest.mark.parametrize("harmonics", [(1,), (1, 2, 7)])
def test_motor_angles_solve_their_equation(
    drive: flexgen.RobotModel, tmp_path: Path, steep: float, harmonics: tuple[int, ...]
) -> None:
    """Of errors up to almost the steepest that a model may have, to rounding; speed and
    acceleration by differences.
    """
    table = {
        "harmonics": list(harmonics),
        "cos": [1.0] * len(harmonics),
        "sin": [0.5] * len(harmonics),
    }
    size = steep / N / FourierSum(harmonics, tuple(table["cos"]), tuple(table["sin"])).bound(1)
    table |= {key: [size * x for x in table[key]] for key in ("cos", "sin")}
    key = "element.link.dof.q1.gear.transmission_error"
    model = flexgen.read(tmp_path / "drive.toml", overrides={**SUMS, key: table})
    stage = flexgen.derive(model).function("motor_harmonics")
    t = np.linspace(0.0, 1.0, 101)
    h = 2e-5

    def at(t: np.ndarray) -> list[np.ndarray]:
        w = [30 * np.sin(3 * t), 90 * np.cos(3 * t), -270 * np.sin(3 * t)]
        return [np.array(x).ravel() for x in stage.map(len(t))(*(x[None] for x in w))]

    q, v, a, share, _, _ = at(t)
    assert_allclose(q - N * value(table, q), 30 * np.sin(3 * t), rtol=0, atol=1e-13)
    assert_allclose(share, 1 - N * value(table, q, 1), rtol=0, atol=1e-13)
    near = [at(t + k * h) for k in (-2, -1, 1, 2)]
    for order, exact in ((0, v), (1, a)):
        x = [each[order] for each in near]
        slope = (x[0] - 8 * x[1] + 8 * x[2] - x[3]) / (12 * h)
        assert_allclose(slope, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def inverse_error(model: flexgen.RobotModel) -> float:
    """Largest distance of the simulated tool from its path under the torques of the inverse
    [rad].
    """
    solution = flexgen.solve(model, method="closed-form", verify=False, progress=False)
    return float(flexgen.simulate(model, solution.trajectory, feedback="ppi").tool_error_max_m)


@pytest.mark.slow
def test_elastic_and_rigid_gears_follow_their_path() -> None:
    """Of rigid gears cogging and ripple alone; the planted error are torques without them."""
    assert inverse_error(harmonic("elbow")) < 5e-9
    rigid = {f"element.{key}.gear": {"type": "rigid"} for key in ("upper.dof.q1", "fore.dof.q2")}
    sums = {f"motor.{m}.cogging": COGGING for m in ("m1", "m2")}
    sums |= {f"motor.{m}.torque_ripple": RIPPLE for m in ("m1", "m2")}
    model, plain = (flexgen.read("elbow", overrides=rigid | more) for more in (sums, {}))
    assert inverse_error(model) < 5e-9
    path = flexgen.solve(plain, progress=False).trajectory
    assert flexgen.simulate(model, path, feedback="ppi").tool_error_max_m > 1e-5
    solution = flexgen.solve(model, progress=False)
    assert_allclose(
        solution.trajectory["tau_g"],
        flexgen.solve(plain).trajectory.at(solution.trajectory.time)["tau_g"],
        rtol=0,
        atol=1e-3,
    )


@pytest.mark.slow
def test_hysteresis_and_sums_together() -> None:
    table = {"element.upper.dof.q1.gear.transmission_error": ERROR, "motor.m1.cogging": COGGING}
    model = hysteretic("elbow", **table)
    solution = flexgen.solve(model, progress=False)
    assert solution.status == "solved"
    assert flexgen.simulate(model, solution.trajectory, feedback="ppi").tool_error_max_m < 5e-8
    plain = flexgen.solve(hysteretic("elbow"), progress=False)
    assert flexgen.simulate(model, plain.trajectory, feedback="ppi").tool_error_max_m > 1e-5


# --- model files, and what there is not ----------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "table", "message"),
    [
        ("motor.m1.cogging", {"harmonics": [1, 1], "cos": [1, 1]}, "different whole numbers"),
        ("motor.m1.cogging", {"harmonics": [0], "cos": [1]}, "different whole numbers"),
        ("motor.m1.cogging", {"harmonics": [2.5], "cos": [1]}, "different whole numbers"),
        ("motor.m1.cogging", {"harmonics": [1]}, "a list cos or sin"),
        ("motor.m1.cogging", {"harmonics": [1, 2], "sin": [1]}, "given 1 numbers, expected 2"),
        ("motor.m1.torque_ripple", {"harmonics": [1], "sin": [1]}, "sum is below 1"),
        (
            "motor.m1.encoder_error",
            {"harmonics": [2], "sin": [0.5]},
            "the reading rises with the angle",
        ),
        (
            "element.link.dof.q1.gear.transmission_error",
            {"harmonics": [9], "sin": [1e-3]},
            "below 0.5",
        ),
    ],
)
def test_wrong_tables_are_refused(
    drive: flexgen.RobotModel, tmp_path: Path, key: str, table: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        flexgen.read(tmp_path / "drive.toml", overrides={key: table})


def test_a_description_has_the_tables_of_the_file(drive: flexgen.RobotModel) -> None:
    found = flexgen.describe(drive)
    (motor,) = found["motors"]
    (joint,) = found["coordinates"]
    for given, table in (
        (joint["gear"]["transmission_error"], ERROR),
        (motor["cogging"], COGGING),
        (motor["torque_ripple"], RIPPLE),
    ):
        assert {key: list(numbers) for key, numbers in given.items()} == table


def test_coupled_gears_have_no_transmission_error() -> None:
    both = {"motor.m2.drives": ["q1", "q2"], "motor.m2.ratio": [30.0, 250.0]}
    flexgen.read("elbow", overrides=both | {"motor.m2.cogging": COGGING})
    with pytest.raises(ModelError, match="one motor of its own"):
        flexgen.read(
            "elbow", overrides=both | {"element.fore.dof.q2.gear.transmission_error": ERROR}
        )


@pytest.mark.slow
def test_what_does_not_know_the_sums_refuses_them() -> None:
    model = harmonic("elbow")
    for call in (
        lambda: flexgen.solve(model, method="full"),
        lambda: flexgen.plan_problem(model),
        lambda: flexgen.export_mujoco(model, "elbow.xml"),
        lambda: flexgen.CollisionDetector(model, 1e-3),
        lambda: Regressor(model),
        lambda: flexgen.control(model, controller=flexgen.ComputedTorque(10.0)),
    ):
        with pytest.raises(ArgumentError, match=r"transmission_error|torque_ripple|cogging"):
            call()
    assert "motor_harmonics" in offered_functions(model)
    assert "motor_harmonics" not in offered_functions(flexgen.read("elbow"))
    assert "flexible_joint_torque" not in offered_functions(model)


def test_gears_with_a_transmission_error_along_a_motion() -> None:
    """``q_g = q_m/n - e(q_m)``, and motors carry ``(1/n - e') tau_g``."""
    error = {"harmonics": [1, 2], "cos": [1e-4, 0.0], "sin": [0.0, 2e-4]}
    key = "element.upper.dof.q1.gear.transmission_error"
    model = flexgen.read("elbow", overrides={key: error})
    n = np.diag(model.eta)
    q = np.array([[0.3, 5.0], [40.0, -7.0], [2.0, 0.1]])
    tau = np.array([[2.0, 3.0], [-100.0, 5.0], [7.0, 0.0]])
    e = 1e-4 * np.cos(q[:, 0]) + 2e-4 * np.sin(2 * q[:, 0])
    rate = -1e-4 * np.sin(q[:, 0]) + 4e-4 * np.cos(2 * q[:, 0])
    none = 0 * e
    turned = law_of.gear_angles_along(model, q)
    assert_allclose(turned, q / n - np.stack([e, none], axis=1), rtol=1e-12)
    carried = (1 / n - np.stack([rate, none], axis=1)) * tau
    assert_allclose(law_of.carried_along(model, q, tau), carried, rtol=1e-12)
    assert law_of.highest_harmonics(model).tolist() == [2.0, 0.0]
    assert law_of.transmission_errors(model).keys() == {0}
    plain = flexgen.read("elbow")
    assert_allclose(law_of.gear_angles_along(plain, q), q / n, rtol=1e-14)
    assert_allclose(law_of.carried_along(plain, q, tau), tau / n, rtol=1e-14)
    assert law_of.transmission_errors(plain) == {}
