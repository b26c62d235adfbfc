"""The DAE on an even grid: its equations, evaluated again, and the optimum that it selects."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from causal_cases import problem
from inversion_cases import question
from numpy.testing import assert_allclose
from scipy.linalg import null_space

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.comparison import discretized
from flexgen.inversion.problem.problem import ACCELERATION, InversionProblem

ELBOW = "elbow"


@pytest.mark.parametrize("order", [2, 4, 6])
def test_a_discretized_motion_satisfies_the_equations_with_central_differences(order: int) -> None:
    case = problem(ELBOW)
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


def test_windows_and_options_reach_the_method() -> None:
    case = problem(ELBOW)
    equations = case.problem.equations
    path = case.path
    given = InversionProblem(equations, path, mesh=0.1, options={"order": 2}, preview=0.2)
    made = discretized.solve(given, 0.1)
    assert made.preactuation == pytest.approx(0.2) and made.details["spacing_s"] == pytest.approx(
        0.1
    )
    assert made.details["order"] == 2 and made.intervals == len(made.t) - 1
    default = discretized.solve(InversionProblem(equations, path), 0.25)
    assert default.details["spacing_s"] == pytest.approx(0.1) and default.details["order"] == 4


def test_too_many_nodes_are_refused() -> None:
    with pytest.raises(
        ArgumentError, match=r"mesh: given 1e-07 s, which makes 10000001 nodes, expected at most"
    ):
        discretized.discretize(question(ELBOW), 1e-7, 2, 0.0, 0.0)


def missed_optimum(h: float) -> float:
    """Largest step of the scaled torques from a solution to the optimum of its quadratic model,
    with dense matrices.

    All unknowns and equations are written out; slopes are differences of the residual.
    """
    found_problem = question("planar5_nmp")
    equations = found_problem.equations
    model = equations.model
    found = discretized.discretize(found_problem, h, 2, 0.05, 0.1)
    N = len(found.t)
    rest = found_problem.equilibrium
    ratio = np.abs(model.eta).max(axis=1)
    scale = np.r_[np.ones(model.n_a), ratio[list(model.i_m)]]
    inertia = ratio * np.array([motor.inertia for motor in model.motors])
    least = np.maximum(0.1 * ACCELERATION * inertia, 1e-3)
    tau_0 = np.maximum(np.abs(rest.tau_m), least)
    h = found.t[1] - found.t[0]

    # the nodes before and after those of the equations follow from the differences
    q = np.hstack([found.arm[0], found.motor[0][:, list(model.i_m)]])
    v = np.hstack([found.arm[1], found.motor[1][:, list(model.i_m)]])
    y = np.vstack([q[1] - 2 * h * v[0], q, q[-2] + 2 * h * v[-1]])
    t = np.r_[found.t[0] - h, found.t, found.t[-1] + h]
    target = found_problem.path.sample(t).y[:, :, 0]

    def rows(x: np.ndarray) -> np.ndarray:
        y_at = x[: y.size].reshape(y.shape) * scale
        tau = x[y.size :].reshape(N, -1) * tau_0
        levels = (y_at[1:-1], (y_at[2:] - y_at[:-2]) / (2 * h), np.diff(y_at, 2, axis=0) / h**2)
        arm = [z[:, : model.n_a] for z in levels]
        motors = [z[:, list(model.i_g)] @ model.eta.T for z in arm]
        for motor, z in zip(motors, levels, strict=True):
            motor[:, list(model.i_m)] = z[:, model.n_a :]
        r_a, r_m = evaluate(equations.function("residual"), *arm, *motors, tau)
        output = evaluate(equations.function("output"), y_at[:, : model.n_a])[0]
        away = output.reshape(target.shape) - target
        balance = np.hstack([r_a.reshape(N, -1), r_m.reshape(N, -1)[:, list(model.i_m)]])
        return np.r_[balance.ravel() * h**2, away.ravel()]

    x = np.r_[(y / scale).ravel(), (found.tau_m / tau_0).ravel()]
    e = 1e-6
    J = np.column_stack([(rows(x + e * d) - rows(x - e * d)) / (2 * e) for d in np.eye(len(x))])
    free = null_space(J / np.abs(J).max(axis=1, keepdims=True), rcond=1e-11)
    weights = np.zeros_like(y)
    weights[:2] = 1e14
    weights[-2:] = 1e4
    change = np.kron(np.diff(np.eye(N), axis=0), np.eye(model.n_m))
    # square roots of the cost: the weights differ by ten powers
    root = np.zeros((y.size + len(change), len(x)))
    root[: y.size, : y.size] = np.diag(np.sqrt(weights.ravel()))
    root[y.size :, y.size :] = change
    aim = np.zeros_like(y)
    aim[:2] = np.r_[rest.q_a, rest.q_m[list(model.i_m)]] / scale
    end = flexgen.solve(equations, method="quasistatic", verify=False).trajectory
    aim[-2:] = np.r_[end["q_a"][-1], end["q_m"][-1, list(model.i_m)]] / scale
    offset = np.r_[(y / scale - aim).ravel(), x[y.size :]]
    step = free @ np.linalg.lstsq(root @ free, -root @ offset, rcond=None)[0]
    return float(np.abs(step[y.size :]).max())


def test_a_discretized_motion_is_the_smoothest_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: other weights of the ends."""
    assert missed_optimum(0.1) < discretized.CLOSE_TORQUE
    for name, factor in (("START", 1e-10), ("END", 1e-4)):
        with monkeypatch.context() as planted:
            planted.setattr(discretized, name, factor * getattr(discretized, name))
            assert missed_optimum(0.1) > 10 * discretized.CLOSE_TORQUE


STEP = re.compile(r"coordinates +(\S+), torques +(\S+), residual +(\S+)")


def logged_steps() -> tuple[list[tuple[float, ...]], int]:
    """Coordinates, torques and residual of each step, as they are told, and the count of steps."""
    fast = flexgen.read("four_mass", overrides={"move.step.duration": 0.1})
    lines: list[str] = []
    found = discretized.discretize(question(fast, progress=lines.append), 2e-3, 2, 0.02, 0.1)
    steps = [tuple(map(float, match.groups())) for x in lines if (match := STEP.search(x))]
    return steps, found.iterations


def test_steps_end_where_they_are_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """In coordinates and torques; none leaves a residual that is worse. Planted: other ends."""

    def ends_right() -> bool:
        steps, count = logged_steps()
        assert count == len(steps) > 2
        left = [residual for _, _, residual in steps]
        assert all(b <= 1.01 * max(2 * a, 1e-4) for a, b in itertools.pairwise(left))
        small = [moved <= 1e-9 and pushed <= 1e-5 for moved, pushed, _ in steps]
        return small == [False] * (len(steps) - 1) + [True]

    assert ends_right()
    for name in ("CLOSE", "CLOSE_TORQUE"):
        with monkeypatch.context() as planted:
            planted.setattr(discretized, "CLOSE_TORQUE", np.inf)
            planted.setattr(discretized, "CLOSE", np.inf)
            planted.setattr(discretized, name, 1e-2)
            assert not ends_right()
