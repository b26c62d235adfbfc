"""Attempts of the default method after an error of the solver: finer meshes, further methods, and
a report of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from inversion_cases import question
from selection import ROOT

import flexgen
from flexgen.base.errors import SolverError
from flexgen.codegen.emission.interface import STATUSES
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion import refinement
from flexgen.inversion import solve as solve_module
from flexgen.inversion.judge.status import Status
from flexgen.inversion.judge.verification import verify_by_simulation
from flexgen.inversion.methods import closed_form
from flexgen.inversion.methods.closed_form import instants
from flexgen.inversion.methods.method_result import MethodResult
from flexgen.inversion.methods.method_table import Method, methods
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.model.elements import Move, Output


@pytest.fixture(scope="module")
def equations() -> Equations:
    return derive("planar5_nmp")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[str, int], bool]], list[str]]:
    """Make the methods fail where a function of name and number of earlier calls says so; the
    names called.
    """

    def install(fails: Callable[[str, int], bool], message: str = "planted") -> list[str]:
        names: list[str] = []
        run = refinement.run_method

        def planted(method: Method, problem: InversionProblem, h: float) -> MethodResult:
            names.append(method.name)
            if fails(method.name, names.count(method.name)):
                raise SolverError(f"{method.name} {message}")
            return run(method, problem, h)

        monkeypatch.setattr(refinement, "run_method", planted)
        return names

    return install


def test_a_finer_mesh_is_tried(equations: Equations, calls) -> None:
    names = calls(lambda name, count: count == 1)
    solution = flexgen.solve(equations)
    assert names == ["lq", "lq"] and solution.status == Status.SOLVED and solution.method == "lq"
    assert solution.details["attempts"] == ["lq, intervals of 0.005 s: lq planted"]


def test_each_attempt_halves_the_intervals(
    equations: Equations, calls, monkeypatch: pytest.MonkeyPatch
) -> None:  # type: ignore[no-untyped-def]
    """Those of the method, and those that an error of the time limit names."""
    steps = list[float]()
    named = list[str]()
    calls(lambda name, count: count < 3)
    planted = refinement.run_method
    monkeypatch.setattr(
        refinement, "run_method", lambda m, p, h: (steps.append(h), planted(m, p, h))[1]
    )
    monkeypatch.setattr(refinement, "check_time", named.append)
    flexgen.solve(equations, verify=False)
    assert len(steps) == 3 and steps == [steps[0] / 2**k for k in range(len(steps))]
    named = [text for text in named if text.startswith("method lq, intervals")]
    assert named[: len(steps)] == [f"method lq, intervals of {h:.3g} s" for h in steps]


@pytest.mark.slow
def test_further_methods_are_tried(equations: Equations, calls) -> None:
    names = calls(lambda name, count: name == "lq")
    solution = flexgen.solve(equations)
    assert (
        names == ["lq"] * 3 + ["bvp"]
        and solution.status == Status.SOLVED
        and solution.method == "bvp"
    )
    assert [text.split(",")[0] for text in solution.details["attempts"]] == ["lq"] * 3


@pytest.mark.slow  # compiles a library
def test_lq_is_tried_after_a_closed_form_that_misses_and_the_reason_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Planted: the closed form ends with the path, although the deflections of damped gears decay
    after it.
    """
    monkeypatch.setattr(
        closed_form, "instants", lambda duration, step, settling: instants(duration, step, 0.0)
    )
    messages: list[str] = []
    solution = flexgen.solve(
        ROOT / "tests" / "support" / "robots" / "gantry.toml", "fast", progress=messages.append
    )
    assert (
        solution.method == "lq"
        and solution.status == Status.SOLVED
        and solution.tool_error_max_m < 5e-8
    )
    (reason,) = solution.details["attempts"]
    assert reason.startswith("closed-form: verified error 9.50e-02 is above 1e-05")
    assert f"trying method lq; before: {reason}" in messages
    assert f"  tried before: {reason}" in str(solution).splitlines()


@pytest.mark.parametrize(
    "method", [name for name, m in methods().items() if not m.module.endswith(".baselines")]
)
def test_the_verification_of_every_method_covers_half_a_second_after_its_end(method: str) -> None:
    """Planted: a last torque that is 5 N m too high, whatever the method, moves the tool while it
    is held.
    """
    problem = question("elbow")
    result = refinement.run_method(methods()["closed-form"], problem, 0.0)
    tau_m = result.motors.tau_m.copy()
    tau_m[-1] += 5.0
    errors = []
    for torque in (result.motors.tau_m, tau_m):
        planted = replace(result, motors=replace(result.motors, tau_m=torque))
        errors.append(
            verify_by_simulation(problem, refinement.make_solution(problem, method, planted)).worst
        )
    assert errors[0] < 1e-8 and errors[1] > 0.01


def test_the_error_lists_what_was_tried(equations: Equations, calls) -> None:
    names = calls(lambda name, count: True)
    with pytest.raises(SolverError) as caught:
        flexgen.solve(equations)
    assert set(names) == {"lq", "bvp", "collocation", "full"}
    text = str(caught.value)
    assert text.startswith("lq planted; tried: lq, intervals of 0.005 s: lq planted; ")
    assert all(f"{name}, intervals of" in text for name in set(names))


def test_no_further_method_after_its_time(equations: Equations, calls, monkeypatch) -> None:
    monkeypatch.setattr(solve_module, "FURTHER", 0.0)
    names = calls(lambda name, count: True)
    with pytest.raises(SolverError, match="bvp: not started, 0 s are over"):
        flexgen.solve(equations)
    assert names == ["lq"] * 3


def test_a_method_that_was_asked_for_is_the_only_one(equations: Equations, calls) -> None:
    names = calls(lambda name, count: True)
    with pytest.raises(SolverError, match=r"^lq planted$"):
        flexgen.solve(equations, method="lq")
    assert names == ["lq"]


def test_a_path_out_of_reach_is_refused_at_once(equations: Equations, calls) -> None:
    names = calls(lambda name, count: False)
    move = flexgen.Move(
        "far",
        "tool_line",
        start=equations.model.home,
        displacement=(9.0, 0.0, 0.0),
        duration=1.0,
        smoothness=5,
    )
    with pytest.raises(SolverError):
        flexgen.solve(equations, move)
    assert len(names) <= 1


def test_a_singular_pose_ends_the_attempts(equations: Equations, calls) -> None:
    """The library reports that the tool cannot follow the path: no further method is tried."""
    text = next(status.text for status in STATUSES if status.name == "UNREACHABLE")
    names = calls(lambda name, count: True, f"planted: {text}")
    with pytest.raises(SolverError, match="passes a singular pose; tried: lq, intervals of"):
        flexgen.solve(equations)
    assert names == ["lq"] * 3


@pytest.mark.slow
def test_a_joint_move_through_a_singular_pose_of_the_tool_gets_an_advice(
    equations: Equations,
) -> None:
    """With joints as outputs it is solved."""
    move = Move("through", "joint", (0.3, -0.6), end=(0.6, 0.6), duration=1.0, smoothness=5)
    with pytest.raises(
        SolverError, match=r'singular pose.*give the model an output of type "joint" for this move'
    ):
        flexgen.solve(equations, move, progress=False)
    model = equations.model
    rows = tuple(tuple(float(i == k) for k in range(model.n_a)) for i in model.i_g)
    joints = replace(model, output=Output("combination", "", rows, "rad"))
    assert flexgen.solve(joints, move, progress=False).status == Status.SOLVED


def test_a_torque_that_ripples_between_the_samples_is_a_warning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solved = flexgen.solve("elbow", progress=False)
    assert solved.warnings == ()
    monkeypatch.setattr(refinement, "RIPPLE", solved.residual_relative / 2)
    again = flexgen.solve("elbow", progress=False)
    assert (
        again.status == Status.SOLVED
        and "the samples do not resolve the motor torques" in again.warnings[0]
    )
