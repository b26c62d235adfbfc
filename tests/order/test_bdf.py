"""BDF on the original DAE: its order, its lag, its agreement with exact methods and where it is
refused.
"""

from __future__ import annotations

import numpy as np
import pytest
from causal_cases import observed_order, problem, reference, relative

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison.bdf import COEFFICIENTS, extrapolate, march, solve, stable_order
from flexgen.inversion.judge.status import Status
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.reader import read

SMOOTH = 9  # continuous derivatives of a path on which an order can be seen
NEAR = 0.35  # by how much an observed order may miss the declared one
# before rounding sets in
STEPS = {1: (100, 200, 400), 2: (100, 200, 400), 3: (80, 160, 320), 4: (60, 120)}
TOLD = 2e-6  # m and rad: what order 3 reaches at a millisecond
EXACT = 1e-3  # relative: torques of order 3 against the exact methods


def errors(order: int, counts: tuple[int, ...], **other: object) -> list[float]:
    here = problem("planar5_mp", SMOOTH)
    exact = reference("planar5_mp", SMOOTH)
    out = []
    for n in counts:
        t = np.linspace(0.0, here.path.duration, n + 1)
        found = march(here.dae, here.path, t, here.x_eq, order, **other)  # type: ignore[arg-type]
        out.append(relative(here.torques(found.x), exact(t)))  # type: ignore[operator]
    return out


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_torque_has_the_declared_order(order: int) -> None:
    assert observed_order(errors(order, STEPS[order])) == pytest.approx(order, abs=NEAR)


def test_a_wrong_coefficient_is_seen() -> None:
    """Planted bug: a formula that still is a derivative, but of order 1."""
    wrong = {2: (1.4, -1.8, 0.4)}
    assert sum(wrong[2]) == pytest.approx(0.0) and np.dot(wrong[2], [0, -1, -2]) == pytest.approx(
        1.0
    )
    assert observed_order(errors(2, STEPS[2], coefficients=wrong)) < 2 - 2 * NEAR


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_coefficients_differentiate_polynomials(order: int) -> None:
    past = -np.arange(order + 1.0)
    for k in range(order + 1):
        slope = 1.0 if k == 1 else 0.0
        assert np.dot(COEFFICIENTS[order], past**k) == pytest.approx(slope, abs=1e-12)


def test_order_one_lags_and_extrapolation_removes_the_lag() -> None:
    here = problem("planar5_mp", SMOOTH)
    exact = reference("planar5_mp", SMOOTH)
    t = np.linspace(0.0, here.path.duration, 201)
    h = t[1]
    plain = here.torques(march(here.dae, here.path, t, here.x_eq, 1).x) - exact(t)
    rate = exact.derivative()(t)  # type: ignore[attr-defined]
    lag = -np.sum(plain * rate) / np.sum(rate * rate) / h
    assert 0.5 < lag < 3.0  # steps
    both = []
    for n in (100, 200):
        s = np.linspace(0.0, here.path.duration, n + 1)
        found = extrapolate(here.dae, here.path, s, here.x_eq, 1)
        both.append(relative(here.torques(found.x), exact(s)))  # type: ignore[operator]
    assert observed_order(both) == pytest.approx(2.0, abs=NEAR)
    assert both[-1] < relative(plain + exact(t), exact(t)) / 50  # type: ignore[operator]


@pytest.mark.parametrize(
    "name", ["planar5_mp", "planar5_mp@undamped", "four_mass@high", "elbow", "elbow@rigid"]
)
def test_the_answer_agrees_and_is_verified(name: str) -> None:
    solution = flexgen.solve(name, method="bdf")
    assert solution.status == Status.SOLVED and (solution.tool_error_max_m or 0.0) < TOLD
    t = solution.trajectory.time
    on_path = (t >= 0) & (t <= problem(name).path.duration)
    assert relative(solution.trajectory["tau_m"][on_path], reference(name)(t[on_path])) < EXACT


def test_richardson_on_request() -> None:
    """Order 1 is off by millimetres, its extrapolation by micrometres."""
    plain = flexgen.solve("planar5_mp", method="bdf", mesh=5e-3, options={"order": 1})
    better = flexgen.solve(
        "planar5_mp", method="bdf", mesh=5e-3, options={"order": 1, "richardson": True}
    )
    assert plain.status == Status.TOLERANCE_NOT_MET and (plain.tool_error_max_m or 0) > 1e-3
    assert better.status == Status.SOLVED and (better.tool_error_max_m or 1) < 5e-6
    assert better.details == {"order": 1, "richardson": True, "step_s": pytest.approx(1e-3)}


@pytest.mark.slow
@pytest.mark.parametrize("move", ["line", "joints"])
def test_six_axes(move: str) -> None:
    """The joint move passes a singular pose of the wrist: no obstacle where all coordinates are
    actuated.
    """
    solution = flexgen.solve("manutec_r3", move, method="bdf")
    assert solution.status == Status.SOLVED
    assert (solution.tool_error_max_m or 1) < TOLD and (
        solution.tool_error_max_rad or 1
    ) < 2 * TOLD


def test_a_path_through_a_singular_pose_is_an_error() -> None:
    here = problem("manutec_r3", None, "joints")
    dae = InverseDae(here.problem.equations)  # the tool instead of the joints
    t = np.linspace(0.0, here.path.duration, 101)
    with pytest.raises(SolverError, match="singular pose"):
        march(dae, here.path, t, here.x_eq, 1)


def test_an_unstable_zero_is_refused_with_the_reason() -> None:
    for method in ("bdf", "reduced", "kunkel-mehrmann"):
        with pytest.raises(
            ArgumentError,
            match=rf"{method}.*zero at \+891\.\d 1/s at t = 0 s.*use lq, bvp or colloc",
        ):
            flexgen.solve("planar5_nmp", method=method)


def test_a_spring_with_a_kink_is_not_differentiated() -> None:
    for method in ("reduced", "kunkel-mehrmann"):
        with pytest.raises(
            ArgumentError, match=f"{method}.*springs of gears with a kink.*use bdf or full"
        ):
            flexgen.solve("four_mass@piecewise", method=method)
    # The torque for exact tracking jumps at the kink, far above the limit of the motor.
    solution = flexgen.solve("four_mass@piecewise", method="bdf")
    assert solution.status == Status.LIMITS_EXCEEDED
    assert (solution.tool_error_max_m or 1) < TOLD
    assert (
        flexgen.solve("four_mass@piecewise", method="bdf", ignore_limits=True).status
        == Status.SOLVED
    )


def test_without_damping_inside_the_stable_order_is_taken() -> None:
    """Order 3 lets the undamped oscillation of the last joint grow: 532 rad/s, half a radian a
    step.
    """
    assert stable_order(np.array([532j, -532j, -1000.0]), 1e-3) == 2
    assert stable_order(np.array([-142 + 513j, -142 - 513j]), 1e-3) == 3
    assert stable_order(np.zeros(0), 1e-3) == 3
    model = read("planar5_mp", overrides={"element.arm3.dof.q3.damping": 0.0})
    solution = flexgen.solve(model, method="bdf")
    assert solution.details["order"] == 2 and solution.status == Status.SOLVED


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"order": 5}, "order 5"),
        ({"order": True}, "order True"),
        ({"richardson": 1}, "richardson 1"),
        ({"stages": 3}, "'stages'"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, object], text: str) -> None:
    given = problem("planar5_mp").problem
    with pytest.raises(ArgumentError, match=text):
        solve(InversionProblem(given.equations, given.path, options=options), 5e-3)
