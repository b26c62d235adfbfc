"""Bounds on torque, speed and deflection: kept at all instants, and the plan holds what it says in
simulation.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import BPoly

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.tableaus import Tableau, gauss
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods import full_model
from flexgen.inversion.methods.full_model import bernstein_rows, collocate_full
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.reader import read
from flexgen.paths.path import Path
from flexgen.simulation.simulate import simulate

KEPT = 1e-6  # relative: IPOPT's tolerance on bounds
# relative: of deflections, whose second coefficient an interval is bounded by that of the one
# before
BENT = 2e-4
PLAN = 1e-7  # m: what the simulation of the polynomials differs from the plan by


@pytest.mark.slow
def test_torque_and_speed_together_are_planned_exactly() -> None:
    """Both bounds act here; read through samples by anything but the polynomials, the torque
    misses by 0.1 mm.
    """
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(
        equations,
        method="full",
        limits=Limits.from_model(equations.model, torque=20.0, speed=100.0),
    )
    assert solution.status == Status.LIMITS_ACTIVE
    assert solution.plan_error_max is not None and solution.plan_error_max < PLAN
    trajectory = solution.trajectory
    assert np.abs(trajectory["tau_m"]).max() <= 20.0
    # also between the samples, by the speeds' own derivatives
    between = BPoly.from_derivatives(
        trajectory.time, np.stack([trajectory["v_m"], trajectory["a_m"]], axis=1)
    )
    fine = between(np.linspace(trajectory.time[0], trajectory.time[-1], 20_001))
    assert 100.0 * (1 - 1e-3) < np.abs(fine).max() < 100.0 * (1 + 10 * KEPT)
    # planted bug: a torque that is not made of those polynomials is read as a monotone cubic, and
    # that is seen
    meta = {**trajectory.meta, "torque": "limited"}
    cut = slice(0, len(trajectory.time) - 1)
    channels = {name: values[cut] for name, values in trajectory.channels.items()}
    shorter = dataclasses.replace(
        trajectory, time=trajectory.time[cut], channels=channels, meta=meta
    )
    moved = (
        simulate(equations, shorter).trajectory["q_a"]
        - simulate(equations, trajectory).trajectory["q_a"][cut]
    )
    assert np.abs(moved).max() > 100 * PLAN


@pytest.mark.slow
def test_deflections_are_bounded() -> None:
    equations = flexgen.derive("planar5_nmp")
    free = flexgen.solve(equations, verify=False, method="collocation").trajectory
    largest = float(np.abs(free["q_a"][:, 2]).max())
    rest = float(np.abs(free["q_a"][0, 2]))
    bound = rest + 0.5 * (largest - rest)
    solution = flexgen.solve(equations, method="full", limits=Limits(deflection=(bound,)))
    assert solution.status == Status.LIMITS_ACTIVE
    assert np.abs(solution.trajectory["q_a"][:, 2]).max() < bound * (1 + BENT)
    assert solution.plan_error_max is not None and solution.plan_error_max < PLAN
    # the tool leaves its path for that, and no more than it has to
    assert 1e-6 < (solution.tool_error_max_m or 0) < 1e-2


@pytest.mark.slow
def test_collocation_keeps_bounds_too() -> None:
    equations = flexgen.derive("planar5_nmp")
    limits = Limits.from_model(equations.model, torque=22.0)
    one, other = (
        flexgen.solve(equations, method=m, limits=limits, verify=False)
        for m in ("collocation", "full")
    )
    assert one.status == other.status == Status.LIMITS_ACTIVE
    assert np.array_equal(one.trajectory["tau_m"], other.trajectory["tau_m"])


@pytest.mark.slow
def test_bounds_that_do_not_act_change_nothing() -> None:
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(
        equations,
        method="full",
        limits=Limits.from_model(equations.model, torque=30.0, speed=400.0, deflection=1e-2),
    )
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 1) < 2e-6


@pytest.mark.slow
def test_bounds_behind_rigid_gears() -> None:
    equations = flexgen.derive("elbow@rigid")
    free = flexgen.solve(equations, verify=False).trajectory
    speed = 0.9 * float(np.abs(free["v_m"]).max())
    solution = flexgen.solve(
        equations, method="full", limits=Limits.from_model(equations.model, speed=speed)
    )
    assert solution.status == Status.LIMITS_ACTIVE
    assert np.abs(solution.trajectory["v_m"]).max() < speed * (1 + 1e-5)


@pytest.mark.parametrize("stages", [2, 3, 5])
def test_bernstein_coefficients_enclose_their_polynomials(stages: int) -> None:
    table = gauss(stages)
    rows = bernstein_rows(table)
    rng = np.random.default_rng(7)
    theta = np.linspace(0, 1, 101)
    once, twice = table.weights(theta)
    for _ in range(20):
        speed = rng.standard_normal()
        acceleration = rng.standard_normal(stages)
        rates = np.r_[speed, speed + rows[:, :stages] @ acceleration]
        curve = speed + once @ acceleration
        assert rates.min() - 1e-12 <= curve.min() and curve.max() <= rates.max() + 1e-12
        assert rates[-1] == pytest.approx(curve[-1], abs=1e-12)
        places = np.r_[
            0.0,
            speed / (stages + 1),
            rows[:, -1] * speed + rows[:, stages : 2 * stages] @ acceleration,
        ]
        curve = theta * speed + twice @ acceleration
        assert places.min() - 1e-12 <= curve.min() and curve.max() <= places.max() + 1e-12
        assert places[-1] == pytest.approx(curve[-1], abs=1e-12)


@pytest.mark.slow
def test_bounds_at_the_gauss_points_alone_are_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted bug: what is bounded at some points of an interval is passed between them, here by a
    thousandth.
    """

    def points(table: Tableau) -> np.ndarray:
        return np.hstack([table.A, table.AA, table.c[:, None]])

    equations = flexgen.derive("planar5_nmp")
    limits = Limits.from_model(equations.model, torque=20.0, speed=100.0)
    problem = InversionProblem(
        equations, Path(equations, equations.model.move(None)), limits=limits
    )

    def fastest() -> float:
        found = collocate_full(equations, problem.path, problem.nodes(0.01)[1], limits)
        return float(np.abs(found.motors.v_m).max())

    assert fastest() < 100.0 * (1 + KEPT)
    monkeypatch.setattr(full_model, "bernstein_rows", points)
    assert fastest() > 100.0 * (1 + 100 * KEPT)


def test_limits_of_a_model() -> None:
    model = read("planar5_nmp")
    assert Limits.from_model(model, torque=20.0, speed=[100.0, 200.0]) == Limits(
        (20.0, 20.0), (100.0, 200.0)
    )
    assert Limits.from_model(model, deflection=1e-3).deflection == (1e-3,)
    for wrong in (
        {"torque": [1.0]},
        {"speed": -1.0},
        {"deflection": float("nan")},
        {"torque": "much"},
    ):
        with pytest.raises(ArgumentError, match=r"expected (\d positive numbers|a finite number)"):
            Limits.from_model(model, **wrong)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_deflection_limit_below_that_of_gravity_is_refused() -> None:
    with pytest.raises(SolverError, match=r"coordinate q3 is deflected by .* at rest"):
        flexgen.solve("planar5_nmp", limits=Limits(deflection=(1e-4,)))
