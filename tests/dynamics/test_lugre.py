"""Friction of motors with a state against closed forms of the LuGre law, own integrators and
energy; planted errors.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from bristled import bristled
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis import lugre as stage
from flexgen.dynamics.hysteresis.lugre import (
    MotorBristles,
    bristle_torques,
    motor_bristles,
    without_lugre,
)

NUMBERS = {
    "coulomb": 0.5,
    "static": 0.8,
    "stribeck_speed": 4.0,
    "stiffness": 800.0,
    "damping": 1.5,
}
TABLES = {"m1": NUMBERS, "m2": NUMBERS | {"coulomb": 1.0, "static": 1.4}}


def law(**changed: float) -> MotorBristles:
    return MotorBristles(*(np.array([x]) for x in (NUMBERS | changed).values()))


def level(v: Any, numbers: dict[str, float] = NUMBERS) -> Any:
    more = numbers["static"] - numbers["coulomb"]
    return numbers["coulomb"] + more * np.exp(-((v / numbers["stribeck_speed"]) ** 2))


@pytest.mark.parametrize("speed", [0.3, -2.0, 90.0])
def test_sliding_at_constant_speed_takes_the_torque_of_the_law(speed: float) -> None:
    """z' = 0: sign(v) g(v), whatever the damping of the bristles."""
    t = np.linspace(0.0, 0.2, 401)
    v = np.full((401, 1), speed)
    torque = bristle_torques(law(), t, v, 0.0 * v)[:, 0]
    assert_allclose(torque[-10:], np.sign(speed) * level(speed), rtol=1e-9)


def test_before_they_slip_bristles_are_a_spring_and_a_damper() -> None:
    """Turned by 1e-5 of the angle at which they slip: s0 q + s1 v, to that part."""
    t = np.linspace(0.0, 0.25, 501)
    w = 2 * np.pi * 4.0
    size = 1e-5 * NUMBERS["static"] / NUMBERS["stiffness"]
    q, v, a = (
        size * x
        for x in ((1 - np.cos(w * t)) / 2, w * np.sin(w * t) / 2, w**2 * np.cos(w * t) / 2)
    )
    torque = bristle_torques(law(), t, v[:, None], a[:, None])[3:-3, 0]
    expected = (NUMBERS["stiffness"] * q + NUMBERS["damping"] * v)[3:-3]
    assert_allclose(torque, expected, rtol=0, atol=3e-5 * np.abs(expected).max())


@pytest.mark.parametrize("peak", [0.02, 1.0, 60.0])
def test_torques_are_those_of_an_own_integrator(peak: float) -> None:
    """Their impulse from rest to each sample, through three reversals, against that of a library's
    stiff integrator.
    """
    w = 2 * np.pi / 0.4
    t = np.linspace(0.0, 0.7, 1401)
    v = peak * np.sin(w * t) ** 3
    a = 3 * w * peak * np.sin(w * t) ** 2 * np.cos(w * t)

    def rate(at: float, x: np.ndarray) -> list[float]:
        speed = peak * np.sin(w * at) ** 3
        dz = speed - NUMBERS["stiffness"] * abs(speed) * x[0] / level(speed)
        return [dz, NUMBERS["stiffness"] * x[0] + NUMBERS["damping"] * dz]

    def jacobian(at: float, x: np.ndarray) -> list[list[float]]:
        speed = abs(peak * np.sin(w * at) ** 3)
        decay = NUMBERS["stiffness"] * speed / level(speed)
        return [[-decay, 0.0], [NUMBERS["stiffness"] - NUMBERS["damping"] * decay, 0.0]]

    options = {"rtol": 1e-9, "atol": [1e-14, 1e-12], "max_step": 5e-4, "jac": jacobian}
    found = solve_ivp(rate, (0.0, 0.7), [0.0, 0.0], "Radau", t, **options)
    z, integral = stage.bristles_along(law(), 0, t[1], v, a)
    impulse = NUMBERS["stiffness"] * integral + NUMBERS["damping"] * z
    assert_allclose(z, found.y[0], rtol=0, atol=1e-6 * np.abs(found.y[0]).max())
    assert_allclose(impulse, found.y[1], rtol=0, atol=1e-7 * np.abs(found.y[1]).max())
    torque = bristle_torques(law(), t, v[:, None], a[:, None])[:, 0]
    assert_allclose(
        t[1] * np.cumsum(torque)[:-4], impulse[1:-3], rtol=0, atol=0.02 * np.abs(impulse).max()
    )


def test_stiff_bristles_are_coulomb_friction() -> None:
    """A hundred thousand times as stiff, they change sign at once: F_c sign(v) t, to the time of a
    reversal.
    """
    t = np.linspace(0.0, 0.7, 1401)
    w = 2 * np.pi / 0.4
    v = 60.0 * np.sin(w * t)
    a = 60.0 * w * np.cos(w * t)
    given = law(static=0.5, stiffness=8e7, damping=0.0)
    z, integral = stage.bristles_along(given, 0, t[1], v, a)
    assert_allclose(8e7 * z[1:], 0.5 * np.sign(v[1:]), rtol=0, atol=1.0)
    expected = 0.5 * np.interp(t, [0.0, 0.2, 0.4, 0.6, 0.7], [0.0, 0.2, 0.0, 0.2, 0.1])
    assert_allclose(8e7 * integral, expected, rtol=0, atol=1e-4 * 0.1)


@pytest.mark.parametrize("shift", [0.0, 0.3])
def test_reversals_at_samples_and_between_them_are_seen(shift: float) -> None:
    """Fast sliding in both directions, through a standstill at an instant that is a sample, or is
    not.
    """
    t = np.linspace(0.0, 0.4, 401) + 1e-3 * shift
    w = 2 * np.pi / 0.4
    v = 300.0 * np.sin(w * t)
    a = 300.0 * w * np.cos(w * t)
    z, _ = stage.bristles_along(law(), 0, t[1] - t[0], v, a)
    fine = np.linspace(t[0], t[-1], 16001)
    v = 300.0 * np.sin(w * fine)
    a = 300.0 * w * np.cos(w * fine)
    expected, _ = stage.bristles_along(law(), 0, fine[1] - fine[0], v, a)
    assert_allclose(z, expected[::40], rtol=0, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("static", [0.5, 0.8])
def test_at_rest_bristles_stay_as_they_are(static: float) -> None:
    """The torque that was reached is held, however long."""
    t = np.linspace(0.0, 1.0, 1001)
    v, a = (
        np.where(t < 0.3, x, 0.0)
        for x in (1.0 - np.cos(2 * np.pi * t / 0.3), np.sin(2 * np.pi * t / 0.3))
    )
    torque = bristle_torques(law(static=static), t, 9.0 * v[:, None], 60.0 * np.pi * a[:, None])[
        :, 0
    ]
    assert 0.45 < torque[310] < 0.9
    assert_allclose(torque[310:], torque[310], rtol=1e-12)


@pytest.mark.parametrize("static", [0.5, 0.8])
def test_at_rest_rounding_does_not_turn_bristles(static: float) -> None:
    """Speeds of 1e-14 rad/s of either sign, after the motor has slid: the torque stays, less than
    1e-9 of it.
    """
    t = np.linspace(0.0, 1.0, 1001)
    noise = 1e-14 * np.random.default_rng(3).normal(size=1001)
    v, a = (
        np.where(t < 0.3, x, 0.0)
        for x in (1.0 - np.cos(2 * np.pi * t / 0.3), np.sin(2 * np.pi * t / 0.3))
    )
    v = np.where(t < 0.3, 9.0 * v, noise)[:, None]
    torque = bristle_torques(law(static=static), t, v, 60.0 * np.pi * a[:, None])[:, 0]
    assert 0.45 < torque[310] < 0.9
    assert_allclose(torque[310:], torque[310], rtol=1e-9)


def test_half_the_sampling_interval_leaves_a_small_part_of_the_error() -> None:
    """Order four in the interval, that of the speed between the samples."""
    errors = []
    w = 2 * np.pi / 0.4
    for count in (175, 350, 5600):
        t = np.linspace(0.0, 0.35, count + 1)
        v = 20.0 * np.sin(w * t) ** 3
        a = 60.0 * w * np.sin(w * t) ** 2 * np.cos(w * t)
        errors.append(stage.bristles_along(law(), 0, t[1], v, a)[1][-1])
    coarse, fine = (abs(x - errors[-1]) for x in errors[:2])
    assert fine < coarse / 8


@pytest.mark.slow
def test_the_simulation_balances_the_energy_and_is_without_bristles_as_before() -> None:
    plain = flexgen.solve("elbow", progress=False)
    assert plain.simulation is not None
    lossy = flexgen.simulate(bristled("elbow", TABLES), plain.trajectory)
    assert lossy.energy_error < 1e-8 and lossy.tool_error_max_m > 1e-4
    least = {
        name: numbers | {"coulomb": 1e-9, "static": 1e-9, "damping": 0.0}
        for name, numbers in TABLES.items()
    }
    model = flexgen.read(
        "elbow", overrides={f"motor.{name}.lugre": numbers for name, numbers in least.items()}
    )
    assert flexgen.simulate(model, plain.trajectory).tool_error_max_m == pytest.approx(
        plain.simulation.tool_error_max_m, abs=1e-8
    )


def test_motors_behind_rigid_gears_feel_it_too() -> None:
    rigid = {f"element.{name}.gear": {"type": "rigid"} for name in ("upper.dof.q1", "fore.dof.q2")}
    model = bristled("elbow", TABLES, **rigid)
    assert model.n_a == 2 and not model.i_m
    solution = flexgen.solve(model, progress=False)
    assert solution.status == "solved" and solution.tool_error_max_m < 1e-7


@cache
def solved() -> flexgen.Solution:
    """Before errors are planted."""
    return flexgen.solve(bristled("elbow", TABLES), progress=False)


@pytest.mark.parametrize("planted", ["sign", "forgotten", "static", "no reversal", "damping"])
def test_planted_errors_of_the_stage_are_found(
    planted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The simulation integrates z itself: a wrong stage leaves more than a hundred times the
    error.
    """
    model = bristled("elbow", TABLES)
    right = solved()
    assert right.status == "solved" and right.tool_error_max_m < 1e-8
    own = stage.motor_bristles

    def changed(model: flexgen.RobotModel) -> MotorBristles:
        numbers = own(model)
        factor = {"static": ("static", 1.05), "damping": ("damping", 0.0)}[planted]
        return stage.replace(numbers, **{factor[0]: factor[1] * getattr(numbers, factor[0])})

    from flexgen.inversion.problem import memory

    if planted == "sign":
        monkeypatch.setattr(memory, "bristle_torques", lambda *given: -bristle_torques(*given))
    elif planted == "forgotten":
        monkeypatch.setattr(memory, "motor_bristles", lambda m: motor_bristles(without_lugre(m)))
    elif planted == "no reversal":
        value = stage.cubic_at
        monkeypatch.setattr(stage, "cubic_at", lambda cubic, at: np.abs(value(cubic, at)))
    else:
        monkeypatch.setattr(memory, "motor_bristles", changed)
    try:
        wrong = flexgen.solve(model, verify=False, progress=False)
    except SolverError as error:
        assert "does not satisfy the equations of motion" in str(error)
    else:
        assert flexgen.simulate(model, wrong.trajectory).tool_error_max_m > 1e-6


def test_motions_that_are_not_finite_are_an_error() -> None:
    v = np.array([[0.0], [np.nan], [0.0]])
    with pytest.raises(
        SolverError, match="lugre: given speeds or accelerations of the motors that are not finite"
    ):
        bristle_torques(law(), np.array([0.0, 1e-3, 2e-3]), v, 0.0 * v)


def test_what_does_not_take_the_friction_refuses_it(tmp_path) -> None:
    model = bristled("elbow", TABLES)
    calls = {
        "mujoco": lambda: flexgen.export_mujoco(model, tmp_path / "a.xml"),
        "full": lambda: flexgen.solve(model, method="full", progress=False),
        "study": lambda: flexgen.feedback_study(model),
        "gears": lambda: flexgen.identify_gears(model, tmp_path / "a.csv"),
    }
    for name, call in calls.items():
        with pytest.raises(
            ArgumentError, match="whose motor m1 has lugre, expected motors without it"
        ):
            call()
            pytest.fail(name)
    with pytest.raises(
        ArgumentError, match="motor m1 has lugre, a friction that depends on the motion before"
    ):
        library_with(model, ["forward_dynamics"])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"coulomb": 0.5}, "stiffness"),
        ({"coulomb": 0.0, "stiffness": 1.0}, "coulomb"),
        ({"coulomb": 0.5, "stiffness": 0.0}, "stiffness"),
        (
            {"coulomb": 0.5, "static": 0.4, "stribeck_speed": 1.0, "stiffness": 1.0},
            "a number >= coulomb",
        ),
        (
            {"coulomb": 0.5, "static": 0.8, "stiffness": 1.0},
            "stribeck_speed in addition to static",
        ),
        ({"coulomb": 0.5, "stiffness": 1.0, "damping": -1.0}, "damping"),
        ({"coulomb": 0.5, "stiffness": 1.0, "viscous": 1.0}, "viscous"),
    ],
)
def test_wrong_numbers_are_refused(given: dict[str, float], told: str) -> None:
    with pytest.raises(ModelError, match=told):
        flexgen.read("elbow", overrides={"motor.m1.lugre": given})


def test_a_motor_with_ripple_sends_more_for_the_same_torque() -> None:
    """The simulation has ripple and bristles from the equations of motion; planted: bristles
    without the ripple.
    """
    model = bristled(
        "elbow", TABLES, **{"motor.m1.torque_ripple": {"harmonics": [6], "cos": [0.05]}}
    )
    solution = flexgen.solve(model, progress=False)
    assert solution.status == "solved" and solution.tool_error_max_m < 1e-7
    path = solution.trajectory
    ripple = 0.05 * np.cos(6 * path["q_m"]) * [1.0, 0.0]
    planted = path["tau_m"] + path["tau_b"] - path["tau_b"] / (1 + ripple)
    wrong = flexgen.Trajectory(
        path.time, dict(path.channels) | {"tau_m": planted}, path.ports, path.labels, path.meta
    )
    assert flexgen.simulate(model, wrong).tool_error_max_m > 1e-6
