"""Hysteresis of gears against closed forms of Dahl's law, an own integrator and energy; planted
errors.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hysteretic import ARCMIN, hysteretic, joint_stiffness
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import flexgen
from flexgen.analysis.printing.equations import symbolic
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.hysteresis import hysteresis as law_of
from flexgen.dynamics.hysteresis import hysteretic_gears as stage
from flexgen.dynamics.hysteresis.hysteresis import gear_hysteresis, gear_layers, without_hysteresis
from flexgen.dynamics.hysteresis.hysteretic_gears import hysteretic_deflections
from flexgen.inversion.problem.sampling import second_time_derivative, time_derivative

KEY = "element.upper.dof.q1.gear"


def elbow(damping: float | None = None, **options: float) -> flexgen.RobotModel:
    changed = (
        {}
        if damping is None
        else {f"{KEY}.damping": damping, "element.fore.dof.q2.gear.damping": damping}
    )
    return hysteretic("elbow", **options, **changed)


def branch(p: np.ndarray, p_r: float, z_r: float, s: float, K_h: float, W: float) -> np.ndarray:
    """Dahl's law in one direction from (p_r, z_r)."""
    return s * W + (z_r - s * W) * np.exp(-s * K_h * (p - p_r) / W)


PERIOD = 0.2  # s, of the torques


def cycles(t: np.ndarray, size: float) -> np.ndarray:
    """Torques size sin(w t)^3 of the first gear, -0.4 of it of the second, and two derivatives (n,
    2, 3).
    """
    w = 2 * np.pi / PERIOD
    s = np.sin(w * t)
    c = np.cos(w * t)
    one = size * np.stack([s**3, 3 * w * s**2 * c, 3 * w**2 * s * (2 * c**2 - s**2)], axis=1)
    return np.stack([one, -0.4 * one], axis=1)


def reversals(
    model: flexgen.RobotModel, size: float, count: int
) -> list[tuple[float, float, float]]:
    """(p_r, z_r, s) of the branches of the first gear, undamped, whose torque turns at +-size in
    turns.
    """
    K = joint_stiffness(model)[0]
    law = gear_hysteresis(model)
    found = [(0.0, 0.0, 1.0)]
    for k in range(count):
        p_r, z_r, s = found[-1]
        numbers = p_r, z_r, s, law.stiffness[0], law.slip[0]
        turn = size * (-1.0) ** k
        p = brentq(
            lambda x, n=numbers, end=turn: K * x + branch(x, *n) - end,
            -size / K * 2,
            size / K * 2,
            xtol=1e-18,
        )
        found.append((p, branch(p, *numbers), -s))
    return found


def test_the_lost_motion_is_the_width_of_the_loop() -> None:
    """Undamped gears under large cycles: at zero torque the two branches are 2 W/K apart."""
    model = elbow(0.0)
    K = joint_stiffness(model)
    law = gear_hysteresis(model)
    assert_allclose(2 * law.slip / K, ARCMIN, rtol=1e-12)
    assert_allclose(law.stiffness, K, rtol=1e-12)
    t = np.linspace(0.0, 0.3, 1201)
    tau = cycles(t, 40.0 * law.slip.max())
    p, z = hysteretic_deflections(flexgen.derive(model), t, tau)
    assert_allclose(K * p + z, tau[:, :, 0], rtol=0, atol=1e-9 * np.abs(tau[:, :, 0]).max())
    # torque zero at 0.1 s downwards, at 0.2 s upwards
    assert_allclose(p[400, 0] - p[800, 0], ARCMIN, rtol=1e-9)


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_undamped_gears_follow_the_closed_form(size: float) -> None:
    model = elbow(0.0)
    law = gear_hysteresis(model)
    t = np.linspace(0.0, 0.5, 701)
    tau = cycles(t, size * law.slip[0])
    p, z = hysteretic_deflections(flexgen.derive(model), t, tau)
    for k, (p_r, z_r, s) in enumerate(reversals(model, size * law.slip[0], 5)):
        inside = (t >= (k / 2 - 0.25) * PERIOD) & (t <= (k / 2 + 0.25) * PERIOD)
        expected = branch(p[inside, 0], p_r, z_r, s, law.stiffness[0], law.slip[0])
        assert_allclose(z[inside, 0], expected, rtol=0, atol=1e-9 * law.slip[0])


@pytest.mark.parametrize("damping", [None, 9e3])
def test_damped_gears_follow_an_own_integrator(damping: float | None) -> None:
    """D p' = tau - K p - z and z' by a library's integrator; p'' keeps the impulses."""
    model = elbow(damping)
    K = joint_stiffness(model)
    law = gear_hysteresis(model)
    D = law_of.gears(model)[0][0].damping
    t = np.linspace(0.0, 0.45, 1801)
    size = 4.0 * law.slip[0]
    p, z = hysteretic_deflections(flexgen.derive(model), t, cycles(t, size))
    dp = time_derivative(p, t[1])
    ddp = second_time_derivative(p, t[1])

    def rate(at: float, x: np.ndarray) -> list[float]:
        r = (size * np.sin(2 * np.pi / PERIOD * at) ** 3 - K[0] * x[0] - x[1]) / D
        return [r, law.stiffness[0] * (r - abs(r) * x[1] / law.slip[0])]

    found = solve_ivp(
        rate, (0.0, t[-1]), [0.0, 0.0], "LSODA", t, rtol=1e-10, atol=[1e-14, 1e-9], max_step=1e-4
    )
    rates = np.array([rate(at, x)[0] for at, x in zip(t, found.y.T, strict=True)])
    largest = np.abs(dp[:, 0]).max()
    assert_allclose(p[:, 0], found.y[0], rtol=0, atol=1e-7 * np.abs(p[:, 0]).max())
    assert_allclose(z[:, 0], found.y[1], rtol=0, atol=1e-6 * law.slip[0])
    assert_allclose(dp[:-3, 0], rates[:-3], rtol=0, atol=2e-3 * largest)  # bends at the reversals
    quiet = np.array([50, 350, 750, 1150, 1550])  # away from them
    impulses = [t[1] * (ddp[50:k, 0].sum() + (ddp[k, 0] - ddp[50, 0]) / 2) for k in quiet]
    # of the trapezoids
    assert_allclose(impulses, rates[quiet] - rates[50], rtol=0, atol=3e-5 * largest)


@pytest.mark.slow
def test_the_law_along_deflections_is_that_of_the_stage() -> None:
    # reversals at samples
    model = elbow(0.0)
    t = np.linspace(0.0, 0.45, 1801)
    law = gear_hysteresis(model)
    p, z = hysteretic_deflections(flexgen.derive(model), t, cycles(t, 3.0 * law.slip[0]))
    assert_allclose(
        law_of.torque_along(gear_layers(model), p), z, rtol=0, atol=1e-6 * law.slip.max()
    )


@pytest.mark.slow
def test_a_cycle_loses_the_area_of_the_loop() -> None:
    """The work int z dp over one cycle, against the integral over both branches of the closed loop
    by quadrature.
    """
    model = elbow(0.0)
    K = joint_stiffness(model)[0]
    law = gear_hysteresis(model)
    t = np.linspace(0.0, 0.65, 5201)
    K_h = law.stiffness[0]
    W = law.slip[0]
    p, z = hysteretic_deflections(flexgen.derive(model), t, cycles(t, 2.5 * W))
    dp = time_derivative(p, t[1])
    last = t >= t[-1] - PERIOD - 1e-9
    work = np.trapezoid(z[last, 0] * dp[last, 0], t[last])
    # the closed loop is symmetric
    a = brentq(lambda x: K * x + W * np.tanh(K_h * x / W) - 2.5 * W, 0.0, 5.0 * W / K)
    top = W * np.tanh(K_h * a / W)
    area = quad(
        lambda x: branch(x, -a, -top, 1.0, K_h, W) - branch(x, a, top, -1.0, K_h, W), -a, a
    )[0]
    assert_allclose(work, area, rtol=1e-4)


@cache
def solved() -> flexgen.Solution:
    """Before errors are planted."""
    return flexgen.solve(elbow(), progress=False)


@pytest.mark.parametrize(
    "planted",
    ["forgotten", *(pytest.param(x, marks=pytest.mark.slow) for x in ("sign", "no reversal"))],
)
def test_planted_errors_of_the_law_are_found(
    planted: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The simulation integrates z itself: a wrong stage leaves more than a hundred times the
    error.
    """
    model = elbow()
    right = solved()
    assert right.status == "solved" and right.tool_error_max_m < 2e-8
    if planted == "sign":
        own = stage.Branch.torque

        def turned(self: Any, p: np.ndarray) -> tuple[np.ndarray, ...]:
            value, slope, z = own(self, p)
            return value - 2 * z, slope, z

        monkeypatch.setattr(stage.Branch, "torque", turned)
    elif planted == "forgotten":
        monkeypatch.setattr(stage, "gear_layers", lambda m: gear_layers(without_hysteresis(m)))
    else:
        monkeypatch.setattr(stage.Branch, "turn", lambda *_: None)
    try:
        wrong = flexgen.solve(model, verify=False, progress=False)
    except SolverError as error:  # refused: the torques are wrong, or the deflections do not exist
        found = (
            "does not satisfy the equations of motion",
            "no deflection of the gears carries their torques",
        )
        assert any(words in str(error) for words in found)
    else:
        assert flexgen.simulate(model, wrong.trajectory).tool_error_max_m > 1e-6


def test_the_simulation_balances_the_energy_and_is_without_hysteresis_as_before() -> None:
    plain = flexgen.solve("elbow", progress=False)
    assert plain.simulation is not None
    lossy = flexgen.simulate(elbow(), plain.trajectory)
    assert lossy.energy_error < 1e-9 and lossy.tool_error_max_m > 1e-5
    # the torques lack the hysteresis
    assert 0.5 < lossy.defect_max_m / lossy.tool_error_max_m < 5.0
    least = flexgen.simulate(elbow(lost_motion=1e-9), plain.trajectory)
    # the lost motion times the reach
    assert least.tool_error_max_m == pytest.approx(0.0, abs=1e-8)


def test_the_torque_that_is_held_after_the_move_is_that_of_the_equilibrium() -> None:
    """Its differences over the small jump to the equilibrium moved the tool by 2.9 um while it was
    held.
    """
    model = hysteretic("planar5_soft")
    solution = flexgen.solve(model, mesh=5e-4, progress=False)
    path = solution.trajectory
    assert solution.status == "solved" and solution.tool_error_max_m < 5e-8
    carried = np.linalg.solve(model.eta.T, path["tau_g"][-1])
    assert_allclose(path["tau_m"][-1], carried, rtol=1e-12)
    assert not path["v_m"][-1].any() and not path["a_m"][-1].any()
    moved = np.abs(path["a_m"])
    assert (moved[-10:].max(axis=0) <= moved[-30:-10].max(axis=0)).all()


def test_torques_that_no_deflection_carries_are_an_error() -> None:
    tau = np.zeros((3, 2, 3))
    tau[1, 0, 0] = np.nan
    with pytest.raises(
        SolverError, match="hysteresis: no deflection of the gears carries their torques"
    ):
        hysteretic_deflections(flexgen.derive(elbow()), np.array([0.0, 1e-3, 2e-3]), tau)


def test_what_does_not_take_hysteresis_refuses_it(tmp_path) -> None:
    model = elbow()
    told = "whose gear of q1 has hysteresis, expected gears without it"
    calls = {
        "mujoco": lambda: flexgen.export_mujoco(model, tmp_path / "a.xml"),
        "full": lambda: flexgen.solve(model, method="full", progress=False),
        "study": lambda: flexgen.feedback_study(model),
        "plan": lambda: flexgen.plan_problem(model),
        "text": lambda: symbolic(model),
    }
    for name, call in calls.items():
        with pytest.raises(ArgumentError, match=told):
            call()
            pytest.fail(name)
    with pytest.raises(
        ArgumentError,
        match="the gear of q1 has hysteresis, whose torque depends on the motion before",
    ):
        library_with(model, ["forward_dynamics"])
    # of the arm alone
    assert library_with(model, ["inverse_dynamics"]).functions.keys() == {"inverse_dynamics"}
    again = flexgen.read(flexgen.export_urdf(model, tmp_path / "elbow.urdf").details["overlay"])
    assert gear_hysteresis(again).slip == pytest.approx(gear_hysteresis(model).slip)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"lost_motion": 1e-4}, "stiffness"),
        ({"lost_motion": 0.0, "stiffness": 1.0}, "lost_motion"),
        ({"lost_motion": 1e-4, "stiffness": -1.0}, "stiffness"),
        ({"lost_motion": 1e-4, "stiffness": 1.0, "width": 1.0}, "width"),
    ],
)
def test_wrong_numbers_of_a_hysteresis_are_refused(given: dict[str, float], told: str) -> None:
    with pytest.raises(ModelError, match=told):
        flexgen.read("elbow", overrides={f"{KEY}.hysteresis": given})
