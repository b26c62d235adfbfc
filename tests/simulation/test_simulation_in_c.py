"""The explicit integrator in C: the steps of scipy's DOP853, closed forms, and what it reports
where it fails.
"""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853
from scipy.interpolate import PPoly

import flexgen
from flexgen.base.errors import SolverError
from flexgen.simulation import run
from flexgen.simulation.integration import compiled_rate, integrators
from flexgen.simulation.integration.compiled_rate import CompiledDop853
from flexgen.simulation.integration.integrators import Rates, ScipySteps, integrate
from flexgen.simulation.result import Simulation

RTOL = 1e-11
ATOL = 1e-12
# rad/s; of the ramp: a motion so large that the relative tolerance counts
OMEGA = 30.0
SLOPE = 1e4


def oscillator(t: np.ndarray) -> tuple[ca.Function, PPoly, np.ndarray]:
    """``y'' = -w^2 y + u`` with a ramp that becomes constant at 0.5 s, and its exact motion (n, 2)
    from rest.
    """
    x = ca.SX.sym("x", 2)
    u = ca.SX.sym("u", 1)
    rate = ca.Function("rate", [x, u], [ca.vertcat(x[1], -(OMEGA**2) * x[0] + u)])
    torque = PPoly(SLOPE * np.array([[[1.0], [0.0]], [[0.0], [0.5]]]), [0.0, 0.5, 2.0])

    def ramp(s: np.ndarray) -> np.ndarray:
        s = np.maximum(s, 0.0)
        return (
            np.stack([s - np.sin(OMEGA * s) / OMEGA, 1 - np.cos(OMEGA * s)], axis=1)
            * SLOPE
            / OMEGA**2
        )

    return rate, torque, ramp(t) - ramp(t - 0.5)


def in_c(
    rate: ca.Function, torque: PPoly, t: np.ndarray, start: np.ndarray, rtol: float = RTOL
) -> np.ndarray:
    found = compiled_rate.compiled_rate(rate, None)
    assert found is not None, "the tests need a C compiler"
    loop = Rates(
        lambda s, x: np.zeros(len(x)), lambda s, x: np.zeros((len(x), len(x))), found, torque
    )
    return integrate(loop, start, t, rtol, np.full(len(start), ATOL)).states


def test_a_forced_oscillator_against_its_closed_form() -> None:
    t = np.linspace(0.0, 2.0, 77)
    rate, torque, exact = oscillator(t)
    error = np.abs(in_c(rate, torque, t, np.zeros(2)) - exact).max(axis=0)
    assert (error < 1e-9 * np.abs(exact).max(axis=0)).all()


@pytest.mark.parametrize("name", ["A", "B", "D"])
def test_a_wrong_coefficient_is_seen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = getattr(DOP853, name).copy()
    wrong[(-1, 5)[-wrong.ndim :]] += 1e-3
    monkeypatch.setattr(DOP853, name, wrong)
    t = np.linspace(0.0, 2.0, 77)
    rate, torque, exact = oscillator(t)
    try:
        error = np.abs(in_c(rate, torque, t, np.zeros(2)) - exact).max(axis=0)
    except SolverError:  # its error estimate never becomes small
        return
    assert (error > 1e-7 * np.abs(exact).max(axis=0)).any()


@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_the_error_follows_the_tolerance(rtol: float) -> None:
    t = np.linspace(0.0, 2.0, 77)
    rate, torque, exact = oscillator(t)
    error = np.abs(in_c(rate, torque, t, np.zeros(2), rtol) - exact).max(axis=0) / np.abs(
        exact
    ).max(axis=0)
    assert (error < 100 * rtol).all()


def test_the_same_steps_as_scipy() -> None:
    """Same number of evaluations where each step has an instant; as accurate."""
    t = np.linspace(0.0, 2.0, 1001)
    rate, torque, exact = oscillator(t)
    found = compiled_rate.compiled_rate(rate, None)
    assert found is not None

    def function(s: float, x: np.ndarray) -> np.ndarray:
        return np.asarray(rate(x, torque(s)), float).ravel()

    loops = [
        Rates(function, lambda s, x: np.zeros((2, 2)), where, torque) for where in (found, None)
    ]
    ours, theirs = (integrate(loop, np.zeros(2), t, RTOL, np.full(2, ATOL)) for loop in loops)
    # the first steps have no instant
    assert ours.evaluations == pytest.approx(theirs.evaluations, rel=0.01)
    errors = [np.abs(found.states - exact).max(axis=0) for found in (ours, theirs)]
    assert (errors[0] < 1.5 * errors[1]).all()


def test_blocks_do_not_change_the_result() -> None:
    t = np.linspace(0.0, 2.0, 41)
    rate, torque, _ = oscillator(t)
    found = compiled_rate.compiled_rate(rate, None)
    assert found is not None
    results = []
    for most in (1, 37, 10**6):
        solver = CompiledDop853(found, torque, t, np.zeros(2), RTOL, np.full(2, ATOL))
        out = np.zeros((len(t), 2))
        k = 1
        while k < len(t):
            k = solver.advance(out, k, most)
        results.append(out)
    assert (results[0] == results[2]).all() and (results[1] == results[2]).all()


def robot_simulation() -> Simulation:
    simulation = flexgen.solve("planar5_nmp").simulation
    assert simulation is not None
    return simulation


@pytest.mark.slow
def test_a_robot_without_a_compiler_for_the_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    ours = robot_simulation()
    monkeypatch.setattr(run, "compiled_rate", lambda function, progress: None)
    theirs = robot_simulation()
    for channel in ("q_a", "v_a", "q_m", "error"):
        scale = max(float(np.abs(theirs.trajectory[channel]).max()), 1e-3)
        assert np.abs(ours.trajectory[channel] - theirs.trajectory[channel]).max() < 1e-9 * scale
    assert ours.energy_error < 1e-12


def no_root(x: ca.SX, u: ca.SX) -> ca.SX:
    return ca.sqrt(0.5 - x) + u


def explosion(x: ca.SX, u: ca.SX) -> ca.SX:
    return x**2 + u


@pytest.mark.parametrize(("law", "start"), [(no_root, 0.0), (explosion, 1.0)])
def test_a_state_beyond_all_bounds_is_an_error_with_its_time(
    law: Callable[[ca.SX, ca.SX], ca.SX], start: float
) -> None:
    x = ca.SX.sym("x", 1)
    u = ca.SX.sym("u", 1)
    rate = ca.Function("rate", [x, u], [law(x, u)])
    torque = PPoly(np.full((1, 1, 1), 0.1), [0.0, 5.0])
    with pytest.raises(
        SolverError, match=r"simulation: (failed|stopped) at t = (0.9|1.0|0.8|0.7)"
    ):
        in_c(rate, torque, np.linspace(0.0, 5.0, 6), np.full(1, start))


def test_the_limit_of_evaluations_is_that_of_the_explicit_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(integrators, "EVALUATIONS", 6_000)
    monkeypatch.setattr(integrators, "LONG", 1_000.0)
    t = np.linspace(0.0, 2.0, 3)
    x = ca.SX.sym("x", 2)
    u = ca.SX.sym("u", 1)
    rate = ca.Function("rate", [x, u], [ca.vertcat(x[1], -4e6 * x[0] + u)])
    with pytest.raises(SolverError, match="evaluations; check the units"):
        in_c(rate, PPoly(np.ones((1, 1, 1)), [0.0, 2.0]), t, np.ones(2))


@pytest.mark.parametrize(
    ("message", "y", "failure"),
    [("too small a step", 0.0, "too small a step"), (None, np.nan, "not finite"), (None, 0.0, "")],
)
def test_a_failed_step_of_scipy_has_a_reason(message, y, failure):
    solver = SimpleNamespace(
        t=0.0, y=np.array([y]), nfev=0, status="failed" if message else "running"
    )
    solver.step = lambda: setattr(solver, "nfev", solver.nfev + 1) or message
    solver.dense_output = lambda: np.sin
    steps = ScipySteps(solver, np.array([1.0]))
    assert steps.advance(np.zeros((1, 1)), 0, 3) == 0 and steps.failure == failure
    assert solver.nfev == (1 if failure else 3)
