"""From gear torques to motors: gear lag, stiff integration, differences and meshes against closed
forms.
"""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.integrate import solve_ivp

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.gear_lag import gear_lag
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.methods import baselines
from flexgen.inversion.problem import problem as problems
from flexgen.inversion.problem import sampling
from flexgen.inversion.problem.motor_side import (
    _hermite,
    _integrate_deflections,
    deflections,
    gear_torques,
    motor_motion,
)

TORQUE = Polynomial([3.0, -40.0, 500.0, -2e3, 3e3, 7e3])  # over seconds


def rates(polynomial: Polynomial, t: np.ndarray) -> np.ndarray:
    """Value and two derivatives (n, 3)."""
    return np.stack([polynomial.deriv(k)(t) if k else polynomial(t) for k in range(3)], axis=-1)


def lagging(t: np.ndarray, stiffness: float, damping: float, start: float) -> np.ndarray:
    """The deflection under `TORQUE`: the particular polynomial and the decaying exponential."""
    particular = Polynomial([0.0])
    for k in range(6):
        particular = (
            particular
            + (TORQUE.deriv(k) if k else TORQUE) * (-damping / stiffness) ** k / stiffness
        )
    return particular(t) + (start - particular(t[0])) * np.exp(-stiffness / damping * (t - t[0]))


UNEQUAL = np.array([0.0, 0.01, 0.02, 0.05, 0.08, 0.2, 0.2005])


def test_damped_gears_follow_a_quintic_torque_exactly() -> None:
    """Fast, slow and nearly algebraic gears in one call, over unequal steps."""
    stiffness = np.array([900.0, 5.0, 4e4])
    damping = np.array([7.0, 1.5, 0.02])
    tau = rates(TORQUE, UNEQUAL).T[:, :, None] * np.array([1.0, -2.0, 0.5])
    start = np.array([0.01, -0.3, 2e-4])
    found = gear_lag(UNEQUAL, stiffness, damping).deflections(tau, start)
    for j, share in enumerate((1.0, -2.0, 0.5)):
        expected = share * lagging(UNEQUAL, stiffness[j], damping[j], start[j] / share)
        np.testing.assert_allclose(found[:, j], expected, rtol=3e-12, atol=1e-12)


def test_steps_of_gears_apply_to_further_axes() -> None:
    lag = gear_lag(UNEQUAL, np.array([900.0]), np.array([7.0]))
    tau = rates(TORQUE, UNEQUAL).T[:, :, None]
    one = lag.deflections(tau, np.array([0.01]))
    more = lag.deflections(tau[..., None] * np.array([1.0, 3.0]), np.array([[0.01, 0.03]]))
    np.testing.assert_allclose(more[:, 0, :], one * [1.0, 3.0], rtol=1e-14)
    assert lag.decay[:2] == pytest.approx(np.exp(-9.0 / 7.0)) and lag.decay[5, 0] == pytest.approx(
        np.exp(-0.45 / 7)
    )


def test_springs_with_curvature_are_integrated_as_by_scipy() -> None:
    x = ca.SX.sym("x", 2)
    torque = ca.vertcat(300 * x[0] + 4e3 * x[0] ** 3, 90 * x[1] + 50 * x[1] ** 3)
    spring = ca.Function(
        "spring", [x], [torque, ca.vertcat(300 + 12e3 * x[0] ** 2, 90 + 150 * x[1] ** 2)]
    )
    D = np.array([4.0, 11.0])
    t = np.linspace(0.0, 0.2, 81)
    start = np.array([0.02, -0.1])
    tau = np.stack([rates(TORQUE, t), -2 * rates(TORQUE, t)], axis=1)
    found = _integrate_deflections(spring, D, t, tau, start)

    def rate(s: float, p: np.ndarray) -> np.ndarray:
        value = np.array([TORQUE(s), -2 * TORQUE(s)])
        return (value - [300 * p[0] + 4e3 * p[0] ** 3, 90 * p[1] + 50 * p[1] ** 3]) / D

    exact = solve_ivp(
        rate, (0.0, 0.2), start, method="DOP853", t_eval=t, rtol=1e-12, atol=1e-14
    ).y.T
    np.testing.assert_allclose(found, exact, atol=2e-10)


def test_quintic_hermite_interpolation_reproduces_a_quintic() -> None:
    c = np.array([0.0, 0.3, 0.55, 1.0])
    left, right = (
        np.stack([rates(TORQUE, np.array([t]))[0], -rates(TORQUE, np.array([t]))[0]])
        for t in (0.2, 0.45)
    )
    found = _hermite(c, 0.25, left, right)
    np.testing.assert_allclose(found, np.outer(TORQUE(0.2 + 0.25 * c), [1, -1]), rtol=1e-13)


def test_differences_of_order_six_are_exact_for_polynomials() -> None:
    h = 0.1
    u = np.arange(9) * 0.1
    x = np.stack([1 + u**6, 2 * u**5 - u], axis=1)
    inside = slice(3, 6)
    first = np.stack([6 * u**5, 10 * u**4 - 1], axis=1)
    second = np.stack([30 * u**4, 40 * u**3], axis=1)
    np.testing.assert_allclose(sampling.time_derivative(x, h)[inside], first[inside], rtol=1e-10)
    np.testing.assert_allclose(
        sampling.second_time_derivative(x, h)[inside], second[inside], rtol=1e-9
    )
    padded = np.concatenate([x[:1]] * 3 + [x] + [x[-1:]] * 3)  # rest before and after
    np.testing.assert_allclose(
        sampling.time_derivative(padded, h)[3:12], sampling.time_derivative(x, h), atol=1e-11
    )
    np.testing.assert_allclose(
        sampling.second_time_derivative(padded, h)[3:12], sampling.second_time_derivative(x, h)
    )


@pytest.mark.parametrize("lag", [0.0, 2e-6, 0.03])
def test_motors_behind_damped_gears_satisfy_the_equation_of_the_gear(lag: float) -> None:
    """``D p' + K p = tau_g`` with p from the motor, ``p''`` its derivative, and the torque balance
    of the rotors.
    """
    robot = flexgen.read("planar5_nmp")
    elements = tuple(
        dataclasses.replace(
            e,
            dofs=tuple(
                dataclasses.replace(
                    d,
                    gear=d.gear
                    and dataclasses.replace(d.gear, damping=lag * d.gear.spring.stiffness),
                )
                for d in e.dofs
            ),
        )
        for e in robot.elements
    )
    equations = Equations(dataclasses.replace(robot, elements=elements))
    t = np.linspace(0.0, 0.3, 301)
    wave = 1 - np.cos(10 * t)
    tau_g = np.stack(
        [np.stack([wave, 10 * np.sin(10 * t), 100 * np.cos(10 * t)], axis=-1)] * 2, axis=1
    ) * [
        [2.0],
        [-0.7],
    ]
    zero = np.zeros((301, 3))
    found = motor_motion(equations, t, zero, zero, zero, tau_g)
    p, dp, ddp = deflections(equations, t, tau_g)
    K = np.array(
        [c.dof.gear.spring.stiffness for c in equations.model.coordinates if c.dof and c.dof.gear]
    )
    np.testing.assert_allclose(
        K * (lag * dp + p), tau_g[:, :, 0], atol=2e-9 if lag < 1e-3 else 1e-11
    )
    np.testing.assert_allclose(
        np.gradient(p, t, axis=0)[5:-5], dp[5:-5], atol=2e-4 * np.abs(dp).max()
    )
    np.testing.assert_allclose(
        np.gradient(dp, t, axis=0)[9:-9], ddp[9:-9], atol=2e-3 * np.abs(ddp).max()
    )
    eta = equations.model.eta
    J = np.array([m.inertia for m in equations.model.motors])
    np.testing.assert_allclose(found.q_m, p @ eta.T, rtol=1e-14)
    np.testing.assert_allclose(found.v_m, dp @ eta.T, rtol=1e-14)
    friction = np.array(
        equations.function("motor_friction").map(301)(found.v_m.T)[0]
        if equations.function("motor_friction").n_out() > 1
        else equations.function("motor_friction").map(301)(found.v_m.T)
    ).T
    np.testing.assert_allclose(
        found.tau_m, J * (ddp @ eta.T) + friction + tau_g[:, :, 0] @ np.linalg.inv(eta), atol=1e-9
    )
    np.testing.assert_allclose(
        gear_torques(equations, zero, zero, zero, found), tau_g[:, :, 0], atol=1e-8
    )


def made_problem(**values: Any) -> Any:
    """A problem of an elbow with the values that a mesh or a grid needs."""
    fixed: dict[str, Any] = {
        "equations": derive("elbow"),
        "path": Made(duration=1.0, segments=(1,)),
        "windows": (0.1, 0.25),
        "mesh": None,
        "limits": None,
        "force": None,
        "preview": None,
        "resolving": np.inf,
        "step": 1e-3,
    }
    return Made(**{**fixed, **values})


FORCED = {"force": Made(resolving=2e-3), "sampling": 1e-3}


@pytest.mark.parametrize(
    ("values", "h", "expected"),
    [
        ({}, 0.01, (1001, 1e-3, 10, 100, 250)),
        ({}, 0.004, (2001, 5e-4, 8, 200, 500)),
        ({"step": 0.25}, 2.0, (5, 0.25, 8, 1, 1)),
        ({"path": Made(duration=1.0, segments=(1, 2))}, 0.00125, (3201, 0.0003125, 4, 320, 800)),
        ({"resolving": 0.004}, 0.01, (1001, 1e-3, 4, 100, 250)),
        ({"resolving": 0.0005}, 0.01, (1001, 1e-3, 1, 100, 250)),
        ({"resolving": 0.004, "mesh": 0.01}, 0.01, (1001, 1e-3, 10, 100, 250)),
        ({"resolving": 0.004, "limits": ()}, 0.01, (1001, 1e-3, 10, 100, 250)),
        ({"preview": 0}, 0.01, (1001, 1e-3, 10, 0, 250)),
        ({"preview": 0.0333}, 0.01, (1001, 1e-3, 10, 34, 250)),
        ({"path": Made(duration=0.0105, segments=(1,))}, 0.01, (12, 0.0105 / 11, 10, 105, 262)),
        ({"step": 1.0, "mesh": 0.3}, 0.3, (5, 0.25, 1, 1, 1)),
        # under a force: its own length, on a coarse mesh half of it; a mesh that is given is kept
        (FORCED, 0.02, (4001, 2.5e-4, 8, 400, 1000)),
        (FORCED, 0.005, (8001, 1.25e-4, 8, 800, 2000)),
        ({**FORCED, "mesh": 0.02}, 0.02, (1001, 1e-3, 20, 100, 250)),
        ({"step": 1e-6}, 0.01, (int(9e5 / 1.35) + 1, 1 / int(9e5 / 1.35), 6667, 66667, 166667)),
    ],
)
def test_the_sampling_grid_of_a_problem(
    values: dict[str, Any], h: float, expected: tuple[Any, ...]
) -> None:
    found = sampling.grid(made_problem(**values), h)
    assert found[:1] + found[2:] == expected[:1] + expected[2:] and found[1] == pytest.approx(
        expected[1], rel=1e-14
    )


def test_a_mesh_with_too_many_samples_is_refused() -> None:
    message = (
        r"mesh: given 1e-06 s, which makes 1\.35e\+06 intervals over 1\.35 s, expected at most "
        r"900000"
    )
    with pytest.raises(ArgumentError, match=message):
        sampling.grid(made_problem(mesh=1e-6), 1e-6)
    kinked = made_problem(equations=derive("kr300_efjm"))
    curved = any(
        not c.dof.gear.rigid and type(c.dof.gear.spring).__name__ != "LinearSpring"
        for c in kinked.equations.model.coordinates
        if c.dof is not None and c.dof.gear is not None
    )
    assert sampling.grid(kinked, 0.01)[0] == (2001 if curved else 1001)


def test_meshes_before_on_and_after_the_path() -> None:
    equal = problems._mesh(0.1, 0.04, 0.5, 0.3, 0.05, np.inf)
    np.testing.assert_allclose(
        equal, np.r_[np.linspace(-0.1, 0, 4), np.linspace(0, 0.5, 11)[1:], [0.6, 0.7, 0.8]]
    )
    np.testing.assert_allclose(problems._mesh(0.0, 0.04, 0.5, 0.0, 0.25, 0.01), [0, 0.25, 0.5])
    np.testing.assert_allclose(
        problems._mesh(0.3, 0.5, 0.5, 0.0, 0.1, np.inf)[:3], [-0.3, -0.15, 0.0]
    )
    short = [-0.03, 0.0, 0.02, 0.06]  # of one interval each
    np.testing.assert_allclose(problems._mesh(0.03, 0.5, 0.02, 0.04, 0.1, np.inf), short)
    graded = problems._graded_nodes(0.4, 0.15, 0.04)
    assert graded is not None
    lengths = np.array([0.04, 0.06, 0.09, 0.135, 0.15])
    np.testing.assert_allclose(graded, -np.r_[0, np.cumsum(lengths)][::-1] * 0.4 / lengths.sum())
    assert (
        problems._graded_nodes(0.4, 0.15, 0.15) is None
        and problems._graded_nodes(0.0, 0.15, 0.04) is None
    )
    np.testing.assert_allclose(problems._mesh(0.4, 9.0, 0.5, 0.0, 0.075, 0.04)[:6], graded)
    assert len(problems._mesh(0.0, 1.0, 1.0, 0.0, 5e-5, np.inf)) == 20_001
    with pytest.raises(
        ArgumentError,
        match=r"mesh: given 4.99e-05 s, which makes 20041 intervals over 1 s, expected at most "
        r"20000",
    ):
        problems._mesh(0.0, 1.0, 1.0, 0.0, 4.99e-5, np.inf)


def test_windows_and_intervals_follow_from_the_zeros(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time constants: of an unstable zero at 20/s, of a stable one at -50/s; limits at 0.04 and
    0.1 of 0.5 s.
    """

    def of(zeros: list[complex], duration: float = 2.0, **values: Any) -> Any:
        made = problems.InversionProblem(derive("planar5_nmp"), Made(duration=duration), **values)
        made.__dict__.update(zeros=[(0.0, np.array(zeros, dtype=complex))], gear_settling=0.07)
        return made

    from flexgen.analysis.zero_dynamics.zeros import preview

    made = of([20, -50])
    assert made.windows == pytest.approx((preview(1.0) / 20, 15 / 50))
    assert made.resolving == pytest.approx(3 / 20) and made.step == 1e-3
    assert of([20, 60]).resolving == pytest.approx(0.05)
    assert of([-50]).resolving == np.inf
    assert of([-1e4]).windows == pytest.approx((0.02, 0.07)) and of(
        [1e6]
    ).windows == pytest.approx((0.02, 0.07))
    assert of([-1e4], 0.2).windows == pytest.approx((0.008, 0.07)) and of(
        [-1e4], 0.2
    ).step == pytest.approx(5e-4)
    assert of([2, -0.1]).windows == pytest.approx((preview(0.5), 5.0))
    assert of([0.1, -0.1]).windows == pytest.approx((problems.LONGEST_PREVIEW, 5.0))
    flat = problems.InversionProblem(derive("elbow"), Made(duration=2.0))  # type: ignore[arg-type]
    flat.__dict__.update(gear_settling=0.01)
    assert (
        flat.windows == pytest.approx((0.05, 0.05))
        and flat.zeros == []
        and flat.resolving == np.inf
    )
    before, nodes = made.nodes(0.04)
    assert (
        before == made.windows[0]
        and nodes[0] == pytest.approx(-before)
        and nodes[-1] == pytest.approx(2.3)
    )
    early = min(0.08, max(2 / 20, 0.04 / 5))
    on = np.flatnonzero(np.isclose(nodes, 0.0))[0]
    assert on == int(np.ceil(before / early)) and np.diff(nodes)[on + 3] == pytest.approx(0.04)
    assert of([20, -50], preview=0.5).nodes(0.04)[0] == 0.5


def test_baselines_are_sampled_until_the_motion_has_settled() -> None:
    t = baselines._instants(
        made_problem(path=Made(duration=0.5, segments=(1,)), step=2e-3, windows=(0.3, 0.1001))
    )
    assert t[0] == 0 and t[-1] == pytest.approx(0.6001) and len(t) == 302
    with pytest.raises(
        SolverError, match="the torque is not finite: a gear spring has no stiffness"
    ):
        baselines._result(t, Made(), Made(tau_m=np.array([1.0, np.inf])))  # type: ignore[arg-type]
