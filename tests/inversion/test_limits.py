"""Limits by bending the path: kept by the true torques, at a small price, or refused in words."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from inversion_cases import question
from path_deviation import DEGREE, DeviationBasis, deviated_path
from scipy.spatial.transform import Rotation
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem import limits
from flexgen.inversion.problem.limits import check_limits_at_rest
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.solution import Solution
from flexgen.paths.path import Path
from flexgen.runtime.inversion.limited_inversion import LimitsInfeasibleError

KEPT = 1e-3  # of a bound: what its corrections may leave
NEAR = 0.1  # relative: the two ways weigh the deviation alike and smooth it differently
DIFFERENCE = 1e-6  # a central difference of a step of 1e-3 s of a motion of 1 Hz or so, relative


def bounded(method: str, **limits: float | tuple[float, ...]) -> Solution:
    equations = flexgen.derive("planar5_nmp")
    return flexgen.solve(
        equations, method=method, limits=Limits.from_model(equations.model, **limits), verify=False
    )


def deviation(solution: Solution) -> float:
    """Largest distance of the planned output from the path [m]."""
    place = evaluate(flexgen.derive("planar5_nmp").function("output"), solution.trajectory["q_a"])[
        0
    ]
    reference = solution.trajectory["y_ref"]
    return float(np.linalg.norm(place.reshape(reference.shape) - reference, axis=1).max())


@needs_compiler
@pytest.mark.parametrize(("torque", "price"), [(22.0, 1.02e-3), (20.0, 3.12e-3)])
def test_torque_limits_cost_what_they_cost_the_full_method(torque: float, price: float) -> None:
    solution = bounded("lq", torque=torque)
    assert solution.status == Status.LIMITS_ACTIVE
    assert np.abs(solution.trajectory["tau_m"]).max() <= torque * (1 + KEPT)
    assert abs(deviation(solution) - price) < NEAR * price  # of method full with the same limits
    assert solution.details["deviation_max_m"] == pytest.approx(deviation(solution), rel=1e-3)


@needs_compiler
def test_speed_limits_are_kept() -> None:
    solution = bounded("lq", speed=(1000.0, 250.0))
    assert solution.status == Status.LIMITS_ACTIVE and 1e-5 < deviation(solution) < 1e-3
    assert np.abs(solution.trajectory["v_m"][:, 1]).max() <= 250.0 * (1 + KEPT)


@needs_compiler
def test_limits_of_gears_rates_curves_and_the_tool_are_kept() -> None:
    """All at once, with a reserve of torque; that of the heating is stated where it is
    exceeded.
    """
    free = flexgen.solve("planar5_nmp", method="lq", verify=False)
    tau, gear = (np.abs(free.trajectory[x]).max(axis=0) for x in ("tau_m", "tau_g"))
    curve = tuple(((0.0, 1.3 * t), (200.0, 1.25 * t), (2000.0, 0.3 * t)) for t in tau)
    speed = np.linalg.norm(
        np.gradient(free.trajectory["y_ref"], free.trajectory.time, axis=0), axis=1
    ).max()
    given = {
        "torque_speed": curve,
        "gear_torque": tuple(1.08 * gear),
        "tool_speed": 0.98 * speed,
        "reserve": 0.1,
    }
    rate = np.abs(
        np.diff(free.trajectory["tau_m"], axis=0) / np.diff(free.trajectory.time)[:, None]
    ).max(axis=0)
    kept = flexgen.Limits(**given, torque_rate=tuple(0.95 * rate))
    solution = flexgen.solve("planar5_nmp", method="lq", limits=kept, verify=False)
    assert solution.status == Status.LIMITS_ACTIVE and not solution.warnings
    found = solution.trajectory
    new = np.abs(np.diff(found["tau_m"], axis=0) / np.diff(found.time)[:, None]).max(axis=0)
    assert (new <= 0.95 * rate * (1 + KEPT)).all() and (0.95 * rate * 0.99 <= new).any()
    assert (np.abs(found["tau_g"]).max(axis=0) <= 0.9 * 1.08 * gear * (1 + KEPT)).all()
    for j, points in enumerate(curve):
        most = 0.9 * np.interp(np.abs(found["v_m"][:, j]), *np.transpose(points))
        assert (np.abs(found["tau_m"][:, j]) <= most * (1 + KEPT)).all()
    hot = flexgen.Limits(**given, torque_rms=tuple(0.3 * tau))
    assert (
        flexgen.solve("planar5_nmp", method="lq", limits=hot, verify=False).status
        == Status.LIMITS_EXCEEDED
    )


@pytest.mark.slow
@needs_compiler
def test_the_modified_path_is_verified() -> None:
    equations = flexgen.derive("planar5_nmp")
    solution = flexgen.solve(
        equations, method="lq", limits=Limits.from_model(equations.model, torque=22.0)
    )
    assert solution.status == Status.LIMITS_ACTIVE and not solution.warnings
    assert solution.plan_error_max is not None and solution.plan_error_max < 1e-6
    assert solution.tool_error_max_m == pytest.approx(
        solution.details["deviation_max_m"], rel=1e-2
    )


@pytest.mark.full
@needs_compiler
def test_all_limits_of_a_six_axis_robot_are_kept_and_verified() -> None:
    """A tenth of each motor torque and 3 % of each motor speed and deflection less than the path
    needs.
    """
    free = flexgen.solve("manutec_r3_24", "line", verify=False, ignore_limits=True)
    tau, v, q = (free.trajectory[name] for name in ("tau_m", "v_m", "q_a"))
    elastic = np.abs(q[:, list(free.model.i_e)])
    sag = 1.01 * np.maximum(elastic[0], elastic[-1])  # the arm has to rest at both ends
    bounds = (
        0.9 * np.abs(tau).max(0),
        0.97 * np.abs(v).max(0),
        np.maximum(0.97 * elastic.max(0), sag),
    )
    torque, speed, deflection = (tuple(map(float, x)) for x in bounds)
    solution = flexgen.solve(
        "manutec_r3_24", "line", limits=flexgen.Limits(torque, speed, deflection), time_limit=600
    )
    assert solution.status == Status.LIMITS_ACTIVE and not solution.warnings
    tau, v, q = (solution.trajectory[name] for name in ("tau_m", "v_m", "q_a"))
    for values, bound in ((tau, torque), (v, speed), (q[:, list(free.model.i_e)], deflection)):
        assert (np.abs(values).max(0) <= np.array(bound) * (1 + KEPT)).all()
    assert solution.plan_error_max is not None and solution.plan_error_max < 1e-6
    assert 1e-3 < solution.path_distance_max_m < solution.tool_error_max_m < 2e-2


@needs_compiler
def test_wide_limits_change_nothing() -> None:
    # the mesh of the method with limits
    free = flexgen.solve("planar5_nmp", method="lq", mesh=0.01, verify=False)
    wide = bounded("lq", torque=30.0, speed=1000.0, deflection=0.1)
    assert wide.status == Status.SOLVED
    assert np.array_equal(free.trajectory["tau_m"], wide.trajectory["tau_m"])


@pytest.mark.slow
@needs_compiler
def test_limits_that_cannot_be_kept_are_refused() -> None:
    with pytest.raises(SolverError, match=r"motor m1 needs 8\.57 N m to hold the arm"):
        bounded("lq", torque=5.0)
    with pytest.raises(SolverError, match="no path deviation keeps them"):
        bounded("lq", speed=(1000.0, 20.0))
    with pytest.raises(
        SolverError, match=r"^limits: motor m1 needs 8\.57 N m.*choose another path$"
    ):
        # no finer mesh is tried
        flexgen.solve("planar5_nmp", limits=flexgen.Limits(torque=(5.0, 30.0)))


def test_bends_are_smooth_and_end() -> None:
    t = np.linspace(-0.1, 1.1, 1201)
    bends = DeviationBasis(t, 0.0, 0.05, 12)
    c = np.random.default_rng(3).normal(size=(12, 2))
    for k in range(4):
        slope = np.gradient(bends.along(c, k), t, axis=0)[2:-2]
        exact = bends.along(c, k + 1)[2:-2]
        assert np.abs(slope - exact).max() < 1e-2 * np.abs(exact).max()
    outside = (t < 0.0) | (t > 0.05 * (12 + DEGREE))
    assert not any(bends.along(c, k)[outside].any() for k in range(DEGREE))


def test_a_pose_deviates_with_its_derivatives() -> None:
    step = 1e-3
    t = step * np.arange(-2, 3)
    turn = np.array([[0.2, -0.1, 0.3], [0.5, 0.4, -0.2], [-0.3, 0.6, 0.1]])
    f = turn[0] + np.outer(t, turn[1]) + np.outer(t**2, turn[2]) / 2
    df = turn[1] + np.outer(t, turn[2])
    ddf = np.tile(turn[2], (5, 1))
    w = np.array([0.3, -0.7, 0.4])
    start = Rotation.from_rotvec([0.4, 0.2, -0.5])
    R = (Rotation.from_rotvec(np.outer(t, w)) * start).as_matrix()
    zero = np.zeros((5, 3))
    place = np.hstack([zero, R.transpose(0, 2, 1).reshape(5, 9)])
    rate = np.hstack([zero, np.tile(w, (5, 1))])
    rate2 = np.zeros((5, 6))
    d = tuple(np.hstack([zero, x]) for x in (f, df, ddf))
    out, turning, rising = deviated_path(place, rate, rate2, d)  # type: ignore[arg-type]
    found = Rotation.from_matrix(out[:, 3:].reshape(5, 3, 3).transpose(0, 2, 1))
    expected = Rotation.from_rotvec(f) * Rotation.from_matrix(R)
    assert (found * expected.inv()).magnitude().max() < 1e-12
    spin = [(found[k + 1] * found[k - 1].inv()).as_rotvec() / (2 * step) for k in (1, 2, 3)]
    assert np.abs(spin[1] - turning[2, 3:]).max() < DIFFERENCE
    assert (
        np.abs((turning[3, 3:] - turning[1, 3:]) / (2 * step) - rising[2, 3:]).max() < DIFFERENCE
    )


def test_infeasible_limits_name_the_end_of_the_motion_and_the_excess(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The samples reach half of the path and the support of a spline, 8 of 30 intervals of the
    path, beyond its end.
    """
    asked = {}

    def refuse(y: np.ndarray, *rest: np.ndarray, **given: object) -> None:
        asked.update(given, samples=len(y))
        raise LimitsInfeasibleError("", excess=0.0625)

    problem = question("planar5_nmp")
    duration = problem.path.duration
    period = 1e-3
    monkeypatch.setattr(
        limits, "inversion_library", lambda *_, **__: SimpleNamespace(invert_limited=refuse)
    )
    bounds = limits._Bounds(problem.equations, Limits((50.0, 50.0), (400.0, 400.0)))
    unlimited = SimpleNamespace(period=period, n_pre=3, n_post=5)
    after = 0.5 * duration + 8 * round(duration / 30 / period) * period
    with pytest.raises(
        SolverError, match=f"ends {after:.3g} s after the path: a bound is exceeded by 0.062 of"
    ):
        limits._modify_path(problem, bounds, unlimited, 2, 1e-6)  # type: ignore[arg-type]
    assert (
        asked["knot_samples"] == round(duration / 30 / period)
        and asked["n_pre"] == 3
        and asked["n_post"] == 5
    )
    before = problem.windows[0] + 8 * asked["knot_samples"] * period
    assert asked["samples"] == pytest.approx((before + duration + after) / period + 1, abs=8.0)
    with pytest.raises(SolverError):
        limits._modify_path(problem, bounds, unlimited, 40, 1e-6)  # type: ignore[arg-type]
    assert asked["knot_samples"] == 80  # two intervals of the mesh


@needs_compiler
@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("part", [1 + 1e-6, 1 - 1e-6])
def test_limits_have_to_hold_the_arm_at_both_ends(late: bool, part: float) -> None:
    """The torques and deflections at rest are those of a solution; each bound is tried alone."""
    model = flexgen.read("planar5_nmp")
    there = model.move("line")
    if late:
        there = replace(there, displacement=tuple(-0.3 * x for x in there.displacement))
    free = flexgen.solve(model, there, method="lq", verify=False).trajectory
    problem = InversionProblem(derive(model), Path(derive(model), there))
    (elastic,) = model.i_e
    ends = np.abs(np.column_stack([free["tau_m"], free["q_a"][:, elastic]])[[0, -1]])
    rest = ends.max(axis=0)
    assert ((ends[1] > ends[0]) == late).all()
    names = [f"motor {motor.name} needs" for motor in model.motors]
    names.append(f"coordinate {model.coordinates[elastic].name} is deflected by")
    for k, name in enumerate(names):
        bounds = np.where(np.arange(3) == k, part * rest, 10.0 * rest)
        limits = Limits(tuple(bounds[:2]), None, tuple(bounds[2:]))
        tried = replace(problem, limits=limits)
        if part > 1:
            check_limits_at_rest(tried)
            continue
        with pytest.raises(SolverError, match=f"^limits: {name} {rest[k]:.4g} .*at the ends of"):
            check_limits_at_rest(tried)
    check_limits_at_rest(problem)
