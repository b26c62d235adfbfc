"""Common parts of the initial-value methods: where they apply, instants, results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from causal_cases import problem
from inversion_cases import question
from numpy.testing import assert_allclose, assert_array_equal

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.dae.system import InverseDae
from flexgen.inversion.comparison import bdf, initial_value
from flexgen.inversion.problem.problem import InversionProblem, UnstableZero
from flexgen.paths.path import Path

ELBOW = "elbow"


def timed(duration: float, settling: float, preview: float | None) -> InversionProblem:
    """A problem of a path and a settling time."""
    model = flexgen.read(ELBOW, overrides={"move.line.duration": duration})
    found = question(model, preview=preview)
    vars(found)["windows"] = (9.0, settling)
    return found


@pytest.mark.parametrize(
    ("duration", "settling", "preview", "step", "expected"),
    [
        (1.0, 0.35, 0.3, 0.3, 0.25 * np.arange(-2, 7)),
        (1.0, 0.0, None, 0.25, 0.25 * np.arange(5)),
        (1.0, 0.0, None, 0.25 - 1e-12, 0.25 * np.arange(5)),
        (0.5, 0.0, 0.0, 9.0, [0.0, 0.5]),
    ],
)
def test_instants_have_the_ends_of_the_path_and_at_most_the_given_step(
    duration: float, settling: float, preview: float | None, step: float, expected: np.ndarray
) -> None:
    found = initial_value.instants(timed(duration, settling, preview), step)
    assert_allclose(found, expected, atol=1e-15)


def test_instants_have_a_largest_number() -> None:
    most = initial_value.STEPS
    assert len(initial_value.instants(timed(1.0, 0.0, None), 1 / most)) == most + 1
    text = f"steps of {1 / most:.3g} s, which makes {most + 1}, expected at most {most}; take a"
    with pytest.raises(ArgumentError, match=text):
        initial_value.instants(timed(1.0, 0.9 / most, None), 1 / most)


def test_zeros_along_a_problem_are_those_of_all_poses() -> None:
    found = question(ELBOW)
    for zeros, expected in (
        ([(0.0, np.array([-1.0])), (1.0, np.array([-2.0, 3j]))], [-1, -2, 3j]),
        ([], []),
    ):
        vars(found)["zeros"] = zeros
        assert_array_equal(initial_value.zeros_along(found), expected)


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
    initial_value.check_causal(problem(ELBOW).problem, "bdf")
    turning = InversionProblem(equations, path)
    vars(turning)["unstable_zero"] = UnstableZero(3.0 - 4j, 0.25)
    with pytest.raises(ArgumentError, match=r"zero at \+3 \+- 4i 1/s at t = 0\.25 s"):
        initial_value.check_causal(turning, "bdf")


def test_the_result_of_states_has_accelerations_and_gear_torques() -> None:
    """Gear torques balance the motors: eta' (tau_m - J a_m - friction) = tau_g."""
    case = problem(ELBOW)
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
    assert not problem(ELBOW).dae.joints


def test_the_dae_of_a_joint_move_has_the_coordinates_as_output() -> None:
    dae = InverseDae(flexgen.derive("planar5_nmp"), joints=True)
    x = np.arange(1.0, dae.n_x + 1)
    rows = np.array(dae.rows(x, np.zeros(dae.n_x), np.zeros(2))[0]).ravel()
    assert_allclose(rows[dae.output], x[list(dae.model.i_g)])
    assert_allclose(dae.target_at(x), x[list(dae.model.i_g)])
