"""Motion of the tool, forces on it, and sensors: against differences of the pose, MuJoCo, and each
other.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from emitted import random_states
from mujoco_referee import MujocoReferee

import flexgen
from flexgen.codegen.build.model_library import library_with
from flexgen.codegen.recursion.functions import fast_function, recursive_function
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.parameters import with_values

MODELS = ("elbow", "planar5_nmp", "manutec_r3_18", "kr300", "manutec_r3_24")


def both(equations: Equations, name: str):
    """The function by Lagrange and, where there is one, by recursion."""
    return [f for f in (equations.function(name), fast_function(equations, name)) if f is not None]


@pytest.mark.parametrize("name", MODELS)
def test_tool_motion_is_the_derivative_of_the_pose(name):
    """Central differences of order four of position and rotation along a curve with the given
    rates.
    """
    equations = derive(name)
    x = {key: value[0] for key, value in random_states(equations.model, 1).items()}
    pose = equations.function("forward_kinematics")
    h = 1e-3

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        p, R = pose(x["q_a"] + t * x["v_a"] + t**2 / 2 * x["a_a"])
        return p.full().ravel(), R.full()

    grid = {k: at(k * h) for k in (-2, -1, 0, 1, 2)}

    def first(values) -> np.ndarray:
        return (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * h)

    def second(values) -> np.ndarray:
        return (16 * (values[1] + values[-1]) - (values[2] + values[-2]) - 30 * values[0]) / (
            12 * h**2
        )

    p, R = ({k: value[i] for k, value in grid.items()} for i in (0, 1))
    dR = first(R)
    ddR = second(R)
    spin = dR @ R[0].T
    turned = ddR @ R[0].T + dR @ dR.T

    def axial(A: np.ndarray) -> np.ndarray:
        return np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]]) / 2

    for function in both(equations, "tool_motion"):
        v, a = (y.full().ravel() for y in function(x["q_a"], x["v_a"], x["a_a"]))
        assert np.allclose(v[:3], first(p), rtol=0, atol=1e-7 * max(1, np.abs(v).max()))
        assert np.allclose(v[3:], axial(spin), rtol=0, atol=1e-7 * max(1, np.abs(v).max()))
        assert np.allclose(a[:3], second(p), rtol=0, atol=1e-5 * max(1, np.abs(a).max()))
        assert np.allclose(a[3:], axial(turned), rtol=0, atol=1e-5 * max(1, np.abs(a).max()))


@pytest.mark.parametrize("name", MODELS)
def test_forces_on_the_tool_act_as_in_mujoco(name):
    """The change of the accelerations, times MuJoCo's mass matrix, is MuJoCo's generalized
    force.
    """
    equations = derive(name)
    model = equations.model
    referee = MujocoReferee(model, rotors=False)
    x = {key: value[0] for key, value in random_states(model, 1).items()}
    state = [x[key] for key in ("q_a", "v_a", "q_m", "v_m", "tau_m")]
    M = referee.mass_matrix(x["q_a"])  # (also puts the referee there)
    expected = np.zeros(referee.m.nv)
    site = referee.m.site("tool").id
    mujoco.mj_applyFT(
        referee.m,
        referee.d,
        x["f_tool"][:3],
        x["f_tool"][3:],
        referee.d.site_xpos[site],
        referee.m.body("payload").id,
        expected,
    )
    expected = expected[referee.at_v[: model.n_a]]
    plain = equations.function("forward_dynamics")(*state)[0].full().ravel()
    rigid = [j for j in range(model.n_m) if j not in model.i_m]
    for j in rigid:  # rotors behind rigid gears move with the arm
        for k, i in enumerate(model.i_g):
            for n, m in enumerate(model.i_g):
                M[i, m] += model.eta[j, k] * model.eta[j, n] * model.motors[j].inertia
    for function in both(equations, "forward_dynamics_tool_force"):
        a_a, a_m, tau_g = (y.full().ravel() for y in function(*state, x["f_tool"]))
        assert np.allclose(M @ (a_a - plain), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
        assert np.array_equal(tau_g, equations.function("gear_torque")(*state[:4]).full().ravel())
        still = function(*state, np.zeros(6))
        assert np.allclose(
            still[0].full().ravel(), plain, rtol=1e-9, atol=1e-9 * np.abs(plain).max()
        )
        motors = equations.function("forward_dynamics")(*state)[1].full().ravel()
        elastic = list(model.i_m)
        assert np.allclose(a_m[elastic], motors[elastic], rtol=1e-12)  # springs are between


def test_bodies_and_rotors_at_run_time_are_as_good_as_changed_models():
    model = flexgen.read("planar5_nmp")
    bodies = [element.name for element in model.elements]
    names = (f"{bodies[0]}.mass", f"{bodies[0]}.com_x", f"{bodies[-1]}.inertia_zz", "m1.inertia")
    equations = derive(model, names)
    values = np.array([1.3 * p.value + 0.01 for p in equations.parameters])
    other = derive(
        with_values(
            model, dict(zip([p.name for p in equations.parameters], values.tolist(), strict=True))
        )
    )
    x = {key: value[0] for key, value in random_states(model, 1).items()}
    state = [x[key] for key in ("q_a", "v_a", "q_m", "v_m", "tau_m")]
    assert recursive_function(equations, "forward_dynamics") is None
    found = equations.function("forward_dynamics")(*state, values)
    expected = other.function("forward_dynamics")(*state)
    for a, b in zip(found, expected, strict=True):
        assert np.allclose(a.full(), b.full(), rtol=1e-11)


def test_sensors_of_the_library_are_the_graphs():
    sensors = [
        {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"},
        {"name": "rate", "type": "gyro", "element": "tool", "axes": ["z"], "unit": "rad/s"},
        {"name": "place", "type": "tracker", "unit": "m"},
    ]
    equations = derive(flexgen.read("planar5_nmp", overrides={"sensor": sensors}))
    model = equations.model
    x = {key: value[0] for key, value in random_states(model, 1).items()}
    signals = equations.function("sensors")(x["q_a"], x["v_a"], x["a_a"]).full().ravel()
    v, a = (
        y.full().ravel() for y in equations.function("tool_motion")(x["q_a"], x["v_a"], x["a_a"])
    )
    p, R = (y.full() for y in equations.function("forward_kinematics")(x["q_a"]))
    assert np.allclose(signals[:3], R.T @ (a[:3] - np.array(model.gravity)), atol=1e-10)
    assert np.isclose(signals[3], (R.T @ v[3:])[2], atol=1e-12)
    assert np.allclose(signals[4:], p.ravel(), atol=1e-12)


def test_derivatives_of_the_sensors_are_those_of_central_differences():
    """Steps of 1e-5: rounding 1e-10 and the error of second order 1e-9 stay below 1e-6 of the
    largest entries.
    """
    sensors = [
        {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"},
        {"name": "rate", "type": "gyro", "element": "tool", "axes": ["z"], "unit": "rad/s"},
        {"name": "place", "type": "tracker", "unit": "m"},
    ]
    model = flexgen.read("planar5_nmp", overrides={"sensor": sensors})
    library = library_with(model, ["sensors", "sensor_derivatives"])
    x = [random_states(model, 1)[key][0] for key in ("q_a", "v_a", "a_a")]
    found = library.sensor_derivatives(*x)
    for k, exact in enumerate(found):
        for i in range(model.n_a):
            up, down = (
                [y + s * 1e-5 * (np.arange(model.n_a) == i) * (j == k) for j, y in enumerate(x)]
                for s in (1, -1)
            )
            numeric = (library.sensors(*up) - library.sensors(*down)) / 2e-5
            assert np.abs(numeric - exact[:, i]).max() < 1e-6 * max(1.0, np.abs(exact).max())
