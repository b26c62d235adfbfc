"""Numbers of flexgen/inversion/comparison on a few steps: the stated equations are evaluated
again, and texts of errors are complete.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from causal_cases import problem as case_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import null_space

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison import bdf, discretized, initial_value, kunkel_mehrmann, reduced
from flexgen.inversion.comparison.dummy_derivatives import DummyDerivatives
from flexgen.inversion.comparison.strangeness_free import StrangenessFree, _null
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.paths.path import Path


def arm():
    """Two coordinates, two damped gears."""
    return case_of("elbow")


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_states_of_bdf_satisfy_the_equations_with_its_differences(order: int) -> None:
    """The first steps see equal states before the start; F is measured by the torque that would
    remove it.
    """
    case = arm()
    c = bdf.COEFFICIENTS[order]
    t = np.linspace(0.0, case.path.duration, 21)
    found = bdf.march(case.dae, case.path, t, case.x_eq, order)
    h = t[1]
    u = case.dae.targets(case.path.sample(t), 0)[:, :, 0]
    assert_array_equal(found.x[0], case.x_eq)
    assert not found.dx[0].any() and 2 * 20 <= found.iterations <= 8 * 20
    x = np.vstack([np.tile(case.x_eq, (4, 1)), found.x])
    for k in (1, 2, 3, 9, 20):
        rate = sum(c[j] * x[4 + k - j] for j in range(order + 1)) / h
        assert_allclose(found.dx[k], rate, atol=1e-9 * np.abs(rate).max())
        F, A, E = (np.array(z) for z in case.dae.rows(found.x[k], rate, u[k]))
        size = np.abs((A + c[0] / h * E) * found.x[k]).max(axis=1) + 1e-3
        assert np.all(np.abs(F[:, 0]) <= 1e-11 * size)
    other = bdf.march(case.dae, case.path, t, case.x_eq, 1, {1: (1.0, -1.01)})
    # given coefficients are used
    assert np.abs(other.x - bdf.march(case.dae, case.path, t, case.x_eq).x).max() > 1e-3


def test_iterations_of_bdf_are_the_equations_that_newtons_method_solves() -> None:
    case = arm()
    seen = []

    def rows(*x: np.ndarray) -> list[ca.DM]:
        seen.append(x)
        return case.dae.rows(*x)

    names = ("n", "n_x", "targets", "scales")
    counted: Any = SimpleNamespace(**{name: getattr(case.dae, name) for name in names}, rows=rows)
    assert (
        bdf.march(counted, case.path, np.linspace(0.0, 0.4, 6), case.x_eq, 2).iterations
        == len(seen)
        > 10
    )


def test_extrapolation_removes_the_leading_error() -> None:
    case = arm()
    t = np.linspace(0.0, 0.4, 6)
    coarse = bdf.march(case.dae, case.path, t, case.x_eq, 2)
    fine = bdf.march(case.dae, case.path, np.linspace(0.0, 0.4, 11), case.x_eq, 2)
    found = bdf.extrapolate(case.dae, case.path, t, case.x_eq, 2)
    assert_allclose(found.x, (4 * fine.x[::2] - coarse.x) / 3, rtol=1e-12, atol=1e-12)
    assert_allclose(found.dx, (4 * fine.dx[::2] - coarse.dx) / 3, rtol=1e-12, atol=1e-9)
    assert found.iterations == coarse.iterations + fine.iterations
    assert_array_equal(found.t, t)
    first = bdf.extrapolate(case.dae, case.path, t, case.x_eq)
    plain, finer = (
        bdf.march(case.dae, case.path, s, case.x_eq, 1) for s in (t, np.linspace(0.0, 0.4, 11))
    )
    assert_allclose(first.x, 2 * finer.x[::2] - plain.x, atol=1e-12)


def test_bdf_names_the_instant_where_newton_fails_and_where_the_equations_are_singular() -> None:
    case = arm()
    t = np.linspace(0.0, 0.5, 6)

    def altered(rows: Callable) -> SimpleNamespace:
        names = ("n", "n_x", "targets", "scales")
        return SimpleNamespace(**{name: getattr(case.dae, name) for name in names}, rows=rows)

    def singular(*x: np.ndarray) -> list[ca.DM]:
        F, A, E = case.dae.rows(*x)
        return [F, 0 * A, 0 * E]

    with pytest.raises(
        SolverError, match=r"singular at t = 0\.1 s, a singular pose; choose another path"
    ):
        bdf.march(altered(singular), case.path, t, case.x_eq)
    noise = iter(np.random.default_rng(0).uniform(1, 2, 999))
    with pytest.raises(
        SolverError,
        match=r"does not converge at t = 0\.1 s, last correction .* rad or m; try a finer",
    ):
        bdf.march(
            altered(
                lambda *x: [
                    case.dae.rows(*x)[0] * next(noise) + next(noise),
                    *case.dae.rows(*x)[1:],
                ]
            ),
            case.path,
            t,
            case.x_eq,
        )


def test_the_order_of_bdf_falls_at_a_lightly_damped_zero() -> None:
    assert bdf.stable_order(np.array([-5.0]), 1e-3) == 3
    assert bdf.stable_order(np.array([-5.0, -30 + 800j, -30 - 800j]), 1e-3) == 2
    assert bdf.stable_order(np.array([-30 + 800j]), 1e-5) == 3
    assert bdf.stable_order(np.zeros(0), 1e-3) == 3


def timed(
    duration: float, settling: float, preview: float | None, **more: object
) -> SimpleNamespace:
    """Fields of a problem that a method reads for its times."""
    return SimpleNamespace(
        path=SimpleNamespace(duration=duration), windows=(9.0, settling), preview=preview, **more
    )


def test_instants_have_the_ends_of_the_path_and_at_most_the_given_step() -> None:
    t = initial_value.instants(timed(1.0, 0.35, 0.3), 0.3)
    assert_allclose(t, 0.25 * np.arange(-2, 7))
    assert_allclose(initial_value.instants(timed(1.0, 0.0, None), 0.25), 0.25 * np.arange(5))
    assert_allclose(
        initial_value.instants(timed(1.0, 0.0, None), 0.25 - 1e-12), 0.25 * np.arange(5)
    )
    assert_allclose(initial_value.instants(timed(0.5, 0.0, 0.0), 9.0), [0.0, 0.5])
    assert len(initial_value.instants(timed(1.0, 0.0, None), 1 / initial_value.STEPS)) == 200_001
    with pytest.raises(
        ArgumentError,
        match=r"steps of 5e-06 s, which makes 200001, expected at most 200000; take a",
    ):
        initial_value.instants(timed(1.0, 5e-6, None), 1 / initial_value.STEPS)


def test_zeros_along_a_problem_are_those_of_all_poses() -> None:
    found = initial_value.zeros_along(
        SimpleNamespace(zeros=[(0.0, np.array([-1.0])), (1.0, np.array([-2.0, 3j]))])
    )
    assert_array_equal(found, [-1, -2, 3j])
    assert initial_value.zeros_along(SimpleNamespace(zeros=[])).shape == (0,)


def test_where_initial_value_methods_do_not_apply_the_reason_and_another_method_are_named() -> (
    None
):
    equations = flexgen.derive("planar5_nmp")
    path = Path(equations, equations.model.moves[0])
    name = equations.model.moves[0].name
    text = (
        rf"the zero dynamics of model planar5_nmp along move {name} is unstable, with a zero at "
        rf"\+[\d.]+ 1/s at t = "
    )
    with pytest.raises(ArgumentError, match=text):
        initial_value.check_causal(InversionProblem(equations, path), "bdf")
    initial_value.check_causal(arm().problem, "bdf")
    fake = SimpleNamespace(
        equations=arm().problem.equations,
        path=path,
        unstable_zero=SimpleNamespace(value=3.0 - 4j, t=0.25),
    )
    with pytest.raises(ArgumentError, match=r"zero at \+3 \+- 4i 1/s at t = 0\.25 s"):
        initial_value.check_causal(fake, "bdf")


def test_the_result_of_states_has_accelerations_and_gear_torques() -> None:
    """Gear torques balance the motors: eta' (tau_m - J a_m - friction) = tau_g."""
    case = arm()
    t = np.linspace(-0.1, 1.0, 34)
    found = bdf.march(case.dae, case.path, t, case.x_eq, 2)
    made = initial_value.result_of_states(
        case.problem,
        case.dae,
        initial_value.States(t, found.x, found.dx),
        iterations=7,
        verdict="v",
        details={"a": 1},
    )
    model = case.dae.model
    n = case.dae.n
    assert (made.preactuation, made.verdict, made.iterations, made.intervals) == (0.1, "v", 7, 33)
    assert made.details == {"a": 1}
    assert_array_equal(made.q, found.x[:, :2])
    assert_array_equal(made.v, found.x[:, n : n + 2])
    assert_array_equal(made.a, found.dx[:, n : n + 2])
    assert_array_equal(made.motors.a_m[:, list(model.i_m)], found.dx[:, n + 2 : 2 * n])
    free = case.problem.equations.function("motor_friction")
    for k in (5, 20):
        friction = np.array(free(made.motors.v_m[k])).ravel()
        inertia = np.array([m.inertia for m in model.motors])
        needed = model.eta.T @ (made.motors.tau_m[k] - inertia * made.motors.a_m[k] - friction)
        assert_allclose(made.tau_g[k], needed, rtol=1e-6, atol=1e-6)
    more = initial_value.result_of_states(
        case.problem,
        case.dae,
        initial_value.States(t - t[0], found.x, found.dx),
        iterations=1,
        verdict="v",
        details={},
        intervals=4,
    )
    assert more.intervals == 4 and more.preactuation == 0.0
    with pytest.raises(SolverError, match="v: the motion is not finite; take a finer"):
        initial_value.result_of_states(
            case.problem,
            case.dae,
            initial_value.States(t, found.x, found.dx * np.nan),
            iterations=1,
            verdict="v",
            details={},
        )


def test_a_joint_move_of_a_robot_without_free_coordinates_prescribes_the_coordinates() -> None:
    equations = flexgen.derive("elbow")
    joint = replace(
        equations.model.moves[0], type="joint", end=(0.4, 0.9), start=(0.2, 0.7), displacement=()
    )
    assert initial_value.dae_of(InversionProblem(equations, Path(equations, joint))).joints
    assert not arm().dae.joints


def torques(case: object, t: np.ndarray) -> np.ndarray:
    """Motor torques by the closed form of a fine BDF: another method."""
    fine = np.linspace(t[0], t[-1], 8 * (len(t) - 1) + 1)
    return bdf.march(case.dae, case.path, fine, case.x_eq, 3).x[::8, 2 * case.dae.n :]


def test_steps_of_radau_keep_the_path_and_its_rate_and_have_the_torques_of_bdf() -> None:
    """Every hidden constraint holds at each instant: output, its rate and its second rate."""
    case = arm()
    dae = case.dae
    system = kunkel_mehrmann.regularize(case.dae, case.x_eq)
    assert (system.mu, system.a, system.d) == (3, 8, 2) and system.gap > 1e6
    t = np.linspace(0.0, 1.0, 13)
    found = kunkel_mehrmann.integrate(system, case.path, t, case.x_eq)
    sample = case.path.sample(t)
    for k in (1, 6, 12):
        q = found.x[k, :2]
        v = found.x[k, 4:6]
        a = found.dx[k, 4:6]
        y, dy, ddy = outputs(case, q, v, a)
        assert_allclose(y, sample.y[k, :, 0], atol=1e-11)
        assert_allclose(dy, sample.y[k, :, 1], atol=1e-9)
        assert_allclose(ddy, sample.y[k, :, 2], atol=1e-7)
        F = dae.rows(found.x[k], found.dx[k], dae.targets(sample, 0)[k, :, 0])[0]
        assert np.abs(np.array(F)).max() < 1e-6 * np.abs(found.x[k, 8:]).max() + 1e-6
    tau = torques(case, t)
    assert np.abs(found.x[:, 8:] - tau).max() < 1e-2 * np.abs(tau).max()
    assert found.gap > 1e2 and 24 <= found.iterations < 200


def outputs(case: object, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> list[np.ndarray]:
    """Output and its first two rates, by differentiation in time of the emitted function."""
    s = ca.SX.sym("s")
    function = case.problem.equations.function("output")
    motion = ca.DM(q) + s * ca.DM(v) + s**2 / 2 * ca.DM(a)
    y = function(motion)
    dy = ca.jacobian(y, s)
    at = ca.Function("at", [s], [y, dy, ca.jacobian(dy, s)])
    return [np.array(z).ravel() for z in at(0)]


def test_a_taylor_expansion_of_a_polynomial_is_exact() -> None:
    """x = (t^3, 2 - t) at t = 0.5, moved by 0.4."""
    t = 0.5
    to = 0.9
    rows = [[s**3, 3 * s**2, 6 * s, 6.0] for s in (t, to)]
    lines = [[2 - s, -1.0, 0.0, 0.0] for s in (t, to)]
    found = kunkel_mehrmann._taylor(np.array([rows[0], lines[0]]), to - t)
    assert_allclose(found, [rows[1], lines[1]], rtol=1e-13)


def test_the_split_of_the_array_satisfies_its_definitions() -> None:
    case = arm()
    system = StrangenessFree(case.dae, 3, case.x_eq)
    X = np.zeros((system.n, 5))
    X[:, 0] = case.x_eq
    U = case.dae.targets(case.path.sample(np.array([0.0])), 3)[0]
    X = system.consistent(X, U)
    assert np.abs(system.rows(X, U)).max() < 1e-10
    assert_allclose(X[:, 0], case.x_eq, atol=1e-9)
    F = np.array(case.dae.rows(X[:, 0], X[:, 1], U[:, 0])[0]).ravel()
    assert_allclose(
        system.motion(X[:, 0], X[:, 1], U[:, 0]), F / system.row[: system.n], atol=1e-14
    )
    split = system.split(X, U)
    N, M = system._jacobians(X, U)
    n = system.n
    a = 8
    d = 2
    assert split.Z2.shape == (4 * n, a) and split.T2.shape == (n, d) and split.Z1.shape == (n, d)
    assert np.abs(split.Z2.T @ M).max() < 1e-9 and np.abs(split.Z2.T @ N @ split.T2).max() < 1e-9
    assert_allclose(split.T2.T @ split.T2, np.eye(d), atol=1e-12)
    assert_allclose(split.Z1 @ split.Z1.T @ split.E @ split.T2, split.E @ split.T2, atol=1e-12)
    assert_array_equal(split.A, N[:n])
    rows = np.random.default_rng(1).normal(size=4 * n)
    w = split.solve(rows)
    Q1 = split.factors[0]
    assert_allclose(Q1.T @ (rows + M @ w), 0.0, atol=1e-9)
    # the units: entries of the array in the scaled unknowns, by differences
    step = np.zeros_like(X)
    step[1, 0] = step[0, 1] = 1e-6
    moved = system.rows(X + system.units * step, U) - system.rows(X - system.units * step, U)
    assert_allclose(
        moved / 2e-6, N[:, 1] + M[:, 0], atol=1e-5 * max(np.abs(N).max(), np.abs(M).max())
    )


def test_an_array_that_is_too_short_or_of_negative_order_is_refused() -> None:
    case = arm()
    with pytest.raises(ArgumentError, match="mu: given -1, expected 0 or more"):
        StrangenessFree(case.dae, -1, case.x_eq)
    with pytest.raises(
        SolverError, match=r"array of order 1 does not make the DAE regular: corank .* 10 unknowns"
    ):
        StrangenessFree(case.dae, 1, case.x_eq).a  # noqa: B018
    system = StrangenessFree(case.dae, 3, case.x_eq)
    far = np.full((case.dae.n_u, 4), 50.0)
    X = np.zeros((system.n, 5))
    X[:, 0] = case.x_eq
    with pytest.raises(
        SolverError, match="no consistent values found: the path leaves the workspace"
    ):
        system.consistent(X, far)


def test_a_null_space_is_that_of_scipy() -> None:
    A = np.random.default_rng(2).normal(size=(3, 5))
    found = _null(A, 2)
    expected = null_space(A)
    assert_allclose(found @ found.T, expected @ expected.T, atol=1e-12)


def test_the_reduced_system_has_consistent_values_and_a_good_choice_of_states() -> None:
    case = arm()
    dummies = DummyDerivatives(case.dae, *reduced.offsets(case.dae))
    assert dummies.freedom == 2 == sum(dummies.d) - sum(dummies.c) and dummies.orders == max(
        dummies.c
    )
    Y = dummies.at_rest(case.x_eq)
    x, dx = dummies.states_of(Y[None])
    assert_array_equal(x[0], case.x_eq)
    assert not dx.any() and dx.shape == (1, 10)
    t = 0.3
    U = case.dae.targets(case.path.sample(np.array([t])), dummies.orders)[0]
    choice = dummies.choose(Y, U)
    assert len(choice.states) == 2 and sorted(choice.states + choice.algebraic) == list(
        range(dummies.size)
    )
    assert_array_equal(np.array(choice.rates), np.array(choice.states) + 1)
    scale = dummies.scales(case.x_eq)
    size, torque, rate = case.dae.scales(case.x_eq)
    expected = [
        z * rate**r for z, k in zip([*size, *torque], dummies.d, strict=True) for r in range(k + 1)
    ]
    assert_allclose(scale, expected)
    found, count = dummies.consistent(choice, Y, U, scale)
    G, slope = (np.array(z) for z in dummies.system(found, U))
    assert np.abs(G[:, 0] / (np.abs(slope * scale).max(axis=1))).max() < 1e-12 and 2 <= count < 12
    assert_array_equal(found[list(choice.states)], Y[list(choice.states)])
    s = found[list(choice.states)]
    z = found[list(choice.algebraic)]
    ds, again = (np.array(v).ravel() for v in dummies.index_one(choice)(s, z, U))
    assert_array_equal(ds, found[list(choice.rates)])
    assert_array_equal(again, G[:, 0])
    quality = dummies.quality(choice, found, U)
    J = np.array(dummies.jacobian(found, U))
    J = J / np.abs(J).max(axis=0)
    J = J / np.abs(J).max(axis=1)[:, None]
    worst = 1.0
    for k in range(1, dummies.orders + 1):
        rows = np.array(dummies.c) >= k
        columns = np.array(choice.depth) >= k
        least = [np.linalg.svd(A, compute_uv=False)[-1] for A in (J[rows][:, columns], J[rows])]
        worst = min(worst, least[0] / least[1])
    assert_allclose(quality, worst, rtol=1e-10)
    with pytest.raises(
        SolverError, match="no consistent values found: the path leaves the workspace"
    ):
        dummies.consistent(choice, Y, U + 50.0, scale)
    with pytest.raises(
        ArgumentError,
        match=r"offsets: given 3 of rows and 6 of unknowns, expected 6 and 6; a struct",
    ):
        DummyDerivatives(case.dae, (1, 2, 3), dummies.d)


def test_a_few_steps_of_idas_have_the_torques_of_bdf() -> None:
    case = arm()
    dummies = DummyDerivatives(case.dae, *reduced.offsets(case.dae))
    t = np.linspace(0.0, 0.12, 4)
    found = reduced.integrate(dummies, case.path, t, case.x_eq)
    x, _ = dummies.states_of(found.Y)
    tau = bdf.march(case.dae, case.path, np.linspace(0.0, 0.12, 37), case.x_eq, 3).x[::12, 8:]
    assert_allclose(x[:, 8:], tau, atol=5e-3 * np.abs(tau).max())
    assert (
        (found.choices, found.freedom, found.rtol) == (1, 2, 1e-11)
        and found.steps > 10
        and found.iterations > 10
    )


@pytest.mark.parametrize("order", [2, 4, 6])
def test_a_discretized_motion_satisfies_the_equations_with_central_differences(order: int) -> None:
    case = arm()
    found = discretized.discretize(case.problem, 0.055, order, 0.1, 0.06)
    h = 1.0 / 19
    assert_allclose(found.t, h * np.arange(-2, 22))
    assert found.path_error < 1e-8 and found.iterations < 12
    arm_side = found.arm
    motor_side = found.motor
    r_a = []
    r_m = []
    for k in range(len(found.t)):
        parts = [*(x[k] for x in arm_side), *(x[k] for x in motor_side), found.tau_m[k]]
        a, m = case.problem.equations.function("residual")(*parts)
        r_a.append(np.array(a).ravel())
        r_m.append(np.array(m).ravel())
    scale = np.abs(found.tau_m).max()
    assert np.abs(r_m).max() < 1e-4 * scale and np.abs(r_a).max() < 1e-4 * scale * 100
    m = order // 2
    first = {2: (0.5,), 4: (2 / 3, -1 / 12), 6: (3 / 4, -3 / 20, 1 / 60)}[order]
    second = {2: (1,), 4: (4 / 3, -1 / 12), 6: (3 / 2, -3 / 20, 1 / 90)}[order]
    for q, v, a in (arm_side, motor_side):
        for k in (m, 10, len(q) - 1 - m):
            rate = sum(w * (q[k + j] - q[k - j]) for j, w in enumerate(first, 1)) / h
            bend = (
                sum(w * (q[k + j] - 2 * q[k] + q[k - j]) for j, w in enumerate(second, 1)) / h**2
            )
            assert_allclose(v[k], rate, atol=1e-8 * np.abs(v).max())
            assert_allclose(a[k], bend, atol=1e-7 * np.abs(a).max())


def test_a_step_of_the_discretized_problem_is_the_minimum_of_its_quadratic_model() -> None:
    """A step equals the solution of the system with dense matrices, the cost and the output's
    softness as stated at the top of the module.
    """
    case = arm()
    system = discretized._System(case.problem, 0.25, 2, 0.0, 0.3)
    assert (system.N, system.m, system.h) == (7, 1, 0.25) and system.delta == pytest.approx(
        1.6e-18 * 16
    )
    assert_allclose(system.t, 0.25 * np.arange(-1, 8))
    model = case.dae.model
    ratio = np.abs(model.eta).max(axis=1)
    assert_allclose(system.scale_y, [1.0, 1.0, *ratio])
    inertia = ratio * [m.inertia for m in model.motors]
    least = np.maximum(0.1 * discretized.ACCELERATION * inertia, 1e-3)
    assert_allclose(system.tau_0, np.maximum(np.abs(case.problem.equilibrium.tau_m), least))
    y, tau = system.start()
    assert y.shape == (9, 4) and tau.shape == (7, 2)
    rest = case.problem.equilibrium
    assert_allclose(system.aim[:2], [np.r_[rest.q_a, rest.q_m]] * 2)
    assert_allclose(system.aim[-2:], [y[-1]] * 2)
    assert not system.aim[2:-2].any()
    # the Jacobian by differences in the scaled unknowns
    _, output = system.errors(y)
    A = system.jacobian(y, tau, output).toarray()
    chance = np.random.default_rng(3)
    e = 1e-5
    dy = chance.normal(size=y.shape)
    dtau = chance.normal(size=tau.shape)

    def rows(s: float) -> np.ndarray:
        moved = y + s * dy * system.scale_y, tau + s * dtau * system.tau_0
        return np.r_[
            (system.residual(*moved) * system.row_scale).ravel(),
            system.errors(moved[0])[0].ravel(),
        ]

    slope = (rows(e) - rows(-e)) / (2 * e)
    assert_allclose(A @ np.r_[dy.ravel(), dtau.ravel()], slope, atol=1e-5 * np.abs(slope).max())
    H = system.hessian.toarray()
    x = np.r_[dy.ravel(), dtau.ravel()]
    weights = np.r_[np.full(8, 1e14), np.zeros(20), np.full(8, 1e4)]
    change = np.diff(dtau, axis=0)
    assert x @ H @ x == pytest.approx(weights @ dy.ravel() ** 2 + np.sum(change**2), rel=1e-9)
    assert system.violation(y, tau) == pytest.approx(np.abs(rows(0.0)[: 7 * 4]).max())
    still = [rest.q_a, np.zeros(2), np.zeros(2), rest.q_m, np.zeros(2), np.zeros(2), rest.tau_m]
    M = np.array(case.problem.equations.function("residual_jacobians")(*still)[0])
    assert_allclose(system.row_scale, 0.25**2 / np.abs(M * system.scale_y).max(axis=1))
    for _ in range(4):
        step = system.step(y, tau)
        y = y + step[0]
        tau = tau + step[1]
    assert system.violation(y, tau) < 1e-7 and np.abs(system.errors(y)[0]).max() < 1e-7
    assert_allclose(y[:2] / system.scale_y, system.aim[:2] / system.scale_y, atol=1e-4)


def test_too_many_nodes_and_missing_convergence_name_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = arm()
    with pytest.raises(
        ArgumentError, match=r"mesh: given 1e-07 s, which makes 10000001 nodes, expected at most"
    ):
        discretized._System(case.problem, 1e-7, 2, 0.0, 0.0)
    monkeypatch.setattr(discretized, "STEPS", 1)
    with pytest.raises(
        SolverError,
        match=r"no convergence in 1 steps, the last one .* rad or m and .* of the torque",
    ):
        discretized.discretize(case.problem, 0.2, 2, 0.0, 0.0)


def test_solutions_of_the_methods_say_how_they_were_made() -> None:
    """Windows, mesh and options reach the method: counts of nodes, steps and details."""
    case = arm()
    equations = case.problem.equations
    path = case.path
    problem = InversionProblem(equations, path, mesh=0.1, options={"order": 2}, preview=0.2)
    made = discretized.solve(problem, 0.1)
    assert made.preactuation == pytest.approx(0.2) and made.details["spacing_s"] == pytest.approx(
        0.1
    )
    assert made.details["order"] == 2 and made.intervals == len(made.t) - 1
    default = discretized.solve(InversionProblem(equations, path), 0.25)
    assert default.details["spacing_s"] == pytest.approx(0.1) and default.details["order"] == 4
    for method, options, text in (
        (bdf, {"order": 5}, "given order 5, expected 1, 2, 3 or 4"),
        (bdf, {"order": True}, "given order True"),
        (bdf, {"richardson": 1}, "given richardson 1, expected True or False"),
        (discretized, {"order": 3}, "given order 3, expected 2, 4 or 6"),
        (discretized, {"order": True}, "given order True"),
        (reduced, {"rtol": 1}, "given rtol 1, expected a float from 1e-13 to 1e-4"),
        (reduced, {"rtol": 9e-14}, "given rtol 9e-14"),
        (reduced, {"rtol": 1.1e-4}, "given rtol 0.00011"),
    ):
        with pytest.raises(ArgumentError, match=text):
            method.solve(InversionProblem(equations, path, options=options), 0.1)


def test_the_dae_of_a_joint_move_has_the_coordinates_as_output() -> None:
    dae = InverseDae(flexgen.derive("planar5_nmp"), joints=True)
    x = np.arange(1.0, dae.n_x + 1)
    rows = np.array(dae.rows(x, np.zeros(dae.n_x), np.zeros(2))[0]).ravel()
    assert_allclose(rows[dae.output], x[list(dae.model.i_g)])
    assert_allclose(dae.target_at(x), x[list(dae.model.i_g)])


def test_a_step_with_a_soft_output_weighs_its_error_by_the_softness(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Dense: ``min x' H x / 2 + |e|^2 / (2 delta)`` on the linear equations of motion, about the
    point of the step.
    """
    monkeypatch.setattr(discretized, "DELTA", 1e-2)
    system = discretized._System(arm().problem, 0.25, 2, 0.0, 0.3)
    chance = np.random.default_rng(5)
    y, tau = system.start()
    y = y + 1e-2 * chance.normal(size=y.shape) * system.scale_y
    tau = tau + chance.normal(size=tau.shape)
    error, output = system.errors(y)
    A = system.jacobian(y, tau, output).toarray()
    H = system.hessian.toarray()
    cut = system.N * system.n
    c = np.r_[(system.residual(y, tau) * system.row_scale).ravel(), error.ravel()]
    offset = np.r_[((y - system.aim) / system.scale_y).ravel(), (tau / system.tau_0).ravel()]
    scale = np.diag(1 / np.sqrt(1.0 + np.diag(H)))
    dynamic = A[:cut] @ scale
    soft = A[cut:] @ scale
    curvature = scale @ H @ scale + soft.T @ soft / system.delta
    slope = scale @ H @ offset + soft.T @ c[cut:] / system.delta
    whole = np.block([[curvature, dynamic.T], [dynamic, np.zeros((cut, cut))]])
    x = scale @ np.linalg.solve(whole, -np.r_[slope, c[:cut]])[: A.shape[1]]
    found = system.step(y, tau)
    assert_allclose(
        found[0].ravel(),
        (x[: y.size].reshape(y.shape) * system.scale_y).ravel(),
        rtol=1e-5,
        atol=1e-7,
    )
    assert_allclose(
        found[1].ravel(),
        (x[y.size :].reshape(tau.shape) * system.tau_0).ravel(),
        rtol=1e-5,
        atol=1e-6,
    )


def test_an_integration_that_fails_is_tried_again_and_named_by_its_last_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last line of the error of IDAS, the instant, and the tolerance of the last attempt."""
    tolerances: list[float] = []

    def fail(
        name: str,
        solver: str,
        system: Any,
        begin: float,
        times: list[float],
        options: dict[str, Any],
    ) -> Any:
        tolerances.append(options["reltol"])
        raise RuntimeError(f"in {name}\nIDA_CONV_FAIL at {len(tolerances)}\n")

    monkeypatch.setattr(reduced.ca, "integrator", fail)
    choice: Any = SimpleNamespace(states=(0,), algebraic=(1,), rates=(0,))
    dummies: Any = SimpleNamespace(
        system=lambda Y, given: (None, ca.DM.eye(2)),
        index_one=lambda choice: lambda s, z, given: (s, z),
    )
    given: Any = (
        dummies,
        choice,
        lambda time: 0,
        np.ones(2),
        np.ones(2),
        np.linspace(0.25, 1.0, 7),
        1e-6,
    )
    with pytest.raises(SolverError) as caught:
        reduced._states(*given)
    factors = [factor for _, factor in reduced.RETRIES]
    assert tolerances == [1e-6 * factor for factor in factors]
    assert str(caught.value) == (
        "method reduced: IDAS failed after t = 0.25 s with a tolerance of "
        f"{1e-6 * factors[-1]:.0e}: IDA_CONV_FAIL at {len(factors)}; try lq or bdf"
    )
