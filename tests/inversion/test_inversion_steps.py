"""Steps of `flexgen.solve` alone: choice and refinement, limits, the end of a motion, the
verification's figures.
"""

from __future__ import annotations

import dataclasses
import inspect
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion import choice, refinement, solve, unverified_solution
from flexgen.inversion.comparison import comparison
from flexgen.inversion.judge import attempt, verification
from flexgen.inversion.judge.reached import BestSolution
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods.method_table import find_method
from flexgen.inversion.problem.problem import SolveOptions
from flexgen.inversion.problem.problem_text import problem_of
from flexgen.inversion.problem.solve_arguments import check_arguments, without_effect
from flexgen.inversion.solution import Solution, limit_warnings, relative_residual, residual_rows
from flexgen.simulation.motor_feedback import MotorFeedback
from flexgen.simulation.result import Simulation

T = np.linspace(-0.1, 0.4, 6)
COUPLED = {
    "motor_coupling": "complete",
    "motor.m1.axis": [0, 0, 1],
    "motor.m1.carrier": "base",
    "motor.m2.axis": [0, 0, 1],
    "motor.m2.carrier": "arm1",
}


def channels(model: Any, **values: np.ndarray) -> Trajectory:
    """A trajectory of zeros but for some channels."""
    widths = dict.fromkeys(("q_a", "v_a", "a_a"), model.n_a)
    widths |= dict.fromkeys(("q_m", "v_m", "a_m", "tau_m", "tau_g"), model.n_m)
    found = {name: np.zeros((len(T), n)) for name, n in widths.items()} | values
    ports = {name: Port(name, (x.shape[1],), "rad", "made up") for name, x in found.items()}
    return Trajectory(
        T,
        found,
        ports,
        {n: tuple(f"{k}" for k in range(x.shape[1])) for n, x in found.items()},
        {},
    )


HERTZ = ("position_hz", "speed_hz", "integral_hz")


def made(model: Any, trajectory: Trajectory | None = None, **values: Any) -> Solution:
    """A solution with made-up figures."""
    fixed: dict[str, Any] = {
        "method": "lq",
        "status": Status.SOLVED,
        "verdict": "",
        "residual_max_Nm": 0.125,
        "residual_relative": 1e-9,
        "iterations": 3,
        "wall_s": 0.0,
        "cpu_s": 0.0,
        "preactuation_s": 0.1,
        "simulation": None,
    }
    return Solution(
        model, model.moves[0], trajectory=trajectory or channels(model), **{**fixed, **values}
    )


def simulated(model: Any, error: np.ndarray | None = None, **values: Any) -> Simulation:
    """A simulation with made-up figures."""
    more = {} if error is None else {"error": error}
    fixed: dict[str, Any] = {
        "tool_error_max_m": 1e-7,
        "tool_error_max_rad": None,
        "energy_error": 1e-9,
    }
    return Simulation(
        channels(model, **more),
        torque_max_Nm=1.0,
        speed_max_rad_s=1.0,
        evaluations=9,
        wall_s=0.0,
        **{**fixed, **values},
    )


class Problem(Made):
    """A problem that keeps what is logged."""

    def __init__(self, name: str = "planar5_nmp", **values: Any) -> None:
        fixed: dict[str, Any] = {
            "equations": derive(name),
            "mesh": None,
            "limits": None,
            "force": None,
            "verify": True,
            "accuracy": 1e-5,
        }
        fixed |= {
            "path": Made(duration=2.0, segments=()),
            "gear_settling": 0.0,
            "windows": (0.1, 0.2),
            "options": {},
            "undamped": None,
        }
        super().__init__(**{**fixed, **values})
        self.texts: list[str] = []

    def log(self, text: str) -> None:
        self.texts.append(text)


def test_the_mesh_is_halved_until_the_verification_is_passed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = flexgen.read("planar5_nmp")
    steps: list[float] = []
    worst = iter([3e-5, 9e-5, 1e-5])

    def method(_: Any, problem: Any, h: float) -> Any:
        steps.append(h)
        return h

    def verified(problem: Any, solution: Any) -> Any:
        run = simulated(model, warnings=("rough",), energy_error=1e-9)
        return verification.Verification(run, (2e-6, None), 5e-7, next(worst))

    monkeypatch.setattr(refinement, "run_method", method)
    monkeypatch.setattr(
        refinement, "make_solution", lambda problem, name, h: made(model, warnings=(f"{h:g}",))
    )
    monkeypatch.setattr(refinement, "verify_by_simulation", verified)
    problem = Problem()
    reached = BestSolution()
    found = refinement.refine(problem, find_method("lq"), reached)  # type: ignore[arg-type]
    h = max(min(0.02, refinement.LONGEST), 2.0 / 5000)
    assert steps == [h, h / 2, h / 4]
    assert (found.plan_error_max_m, found.plan_error_max_rad, found.path_distance_max_m) == (
        2e-6,
        None,
        5e-7,
    )
    assert found.warnings == (f"{h / 4:g}", "rough") and found.status == Status.SOLVED
    assert problem.texts == [
        (
            f"verified error {w:.2e} is above 1e-05 [rad, and m for each meter of reach]: "
            "halving the mesh"
        )
        for w in (3e-5, 9e-5)
    ]
    # the best of all meshes, with the reason, where none passes; a given mesh is taken as it is
    for name, errors in (
        ("lq", [4e-2, 3e-2, 9e-2]),
        ("bvp", [4e-5, 3e-5, 9e-5]),
        ("lq", [4e-5, 3e-5, 9e-4, 5e-5]),
    ):
        steps.clear()
        worst = iter(errors)
        found = refinement.refine(problem, find_method(name), reached)  # type: ignore[arg-type]
        assert found.status == Status.TOLERANCE_NOT_MET and found.warnings[0] == f"{h / 2:g}"
        missed = (
            f"verified error {errors[1]:.2e} is above 1e-05 [rad, and m for each meter of reach]"
        )
        assert found.details == {"missed": missed}
        assert len(steps) == len(errors)  # one more mesh where lq has nearly converged
    steps.clear()
    worst = iter([4e-5])
    refinement.refine(Problem(mesh=0.125), find_method("lq"), reached)  # type: ignore[arg-type]
    assert steps == [0.125]
    monkeypatch.setattr(
        refinement, "make_solution", lambda *_: made(model, status=Status.BASELINE)
    )
    worst = iter([1.0])
    assert refinement.refine(Problem(), find_method("fjm"), reached).status == Status.BASELINE


@pytest.mark.parametrize(
    ("estimates", "errors", "kept"),
    [
        ([0.1, 0.0], [1e-6, 1e-6], 1),
        ([0.1, 0.05, 0.026], [1e-6, 1e-6, 1e-6], 1),  # the third is hardly better
        ([0.1, 0.04, 0.02], [1e-6, 1e-6, 1e-6], 2),
        ([0.1, 0.05, 0.0], [1e-6, 1e-3, 1e-6], 2),
        ([0.1, 0.05, 0.02], [1e-6, 1e-3, 1e-3], 0),
        ([0.1, None], [1e-6], 0),  # the method fails on the second
    ],
)
def test_a_mesh_that_does_not_resolve_the_torques_is_halved(
    estimates, errors, kept, monkeypatch
) -> None:
    """An accepted solution is never lost. Planted: torques that are resolved, which are taken at
    once.
    """
    model = flexgen.read("planar5_nmp")
    finest = refinement.INTERVALS
    rest = iter(estimates)
    worst = iter(errors)

    def made_next(*_: Any, intervals: int = 100) -> Any:
        error = next(rest)
        if error is None:
            raise SolverError("singular pose")
        return made(
            model, intervals=intervals, details={"converged": error == 0.0, "torque_error": error}
        )

    monkeypatch.setattr(refinement, "run_method", lambda *_: None)
    monkeypatch.setattr(refinement, "make_solution", made_next)
    monkeypatch.setattr(
        refinement,
        "verify_by_simulation",
        lambda *_: verification.Verification(simulated(model), None, None, next(worst)),
    )
    reached = BestSolution()
    found = refinement.refine(Problem(), find_method("lq"), reached)  # type: ignore[arg-type]
    assert (
        found is not None
        and found.status == Status.SOLVED
        and found.details["torque_error"] == estimates[kept]
    )
    assert bool(found.warnings) == (estimates[kept] != 0.0)
    for planted, first in (([0.0, 0.1], 100), (estimates, finest + 1)):
        rest = iter(planted)
        worst = iter([1e-6])
        reached = BestSolution()
        monkeypatch.setattr(
            refinement, "make_solution", lambda *x, n=first: made_next(*x, intervals=n)
        )
        found = refinement.refine(Problem(), find_method("lq"), reached)  # type: ignore[arg-type]
        assert found is not None and found.details["torque_error"] == planted[0]


def test_the_end_of_the_time_limit_leaves_an_accepted_solution() -> None:
    model = flexgen.read("planar5_nmp")
    reached = BestSolution(made(model), 1e-6, accepted=made(model, warnings=("estimated error",)))
    assert reached.finish("simulation", 1.0).status == Status.SOLVED
    assert reached.finish(None, 1.0).interrupted
    reached.accepted = None
    assert reached.finish("simulation", 1.0).status == Status.TOLERANCE_NOT_MET


def test_a_time_limit_that_ends_after_the_verification_accepts_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The torques of a controller may be checked after it."""
    model = flexgen.read("planar5_nmp")
    reached = BestSolution(accepted=made(model))
    monkeypatch.setattr(solve, "refine", lambda *_: made(model))
    solve._find_solution(Problem(), "lq", reached)  # type: ignore[arg-type]
    assert reached.finish("simulation", 1.0).status == Status.TOLERANCE_NOT_MET


def test_without_verification_the_residual_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    model = flexgen.read("planar5_nmp")
    residuals = iter([1e-2, unverified_solution.RESIDUAL])
    monkeypatch.setattr(refinement, "run_method", lambda *_: None)
    monkeypatch.setattr(
        refinement, "make_solution", lambda *_: made(model, residual_relative=next(residuals))
    )
    problem = Problem(verify=False)
    reached = BestSolution()
    found = refinement.refine(problem, find_method("lq"), reached)  # type: ignore[arg-type]
    assert found.residual_relative == unverified_solution.RESIDUAL and problem.texts == [
        "relative residual 1.0e-02: halving the mesh"
    ]
    residuals = iter([1e-2] * attempt.ATTEMPTS)
    with pytest.raises(
        SolverError, match=r"method lq: .* residual 0\.125 N m, relative residual 1\.0e-02; switch"
    ):
        refinement.refine(problem, find_method("lq"), reached)  # type: ignore[arg-type]


def test_the_residual_that_is_small_depends_on_the_method() -> None:
    model = flexgen.read("planar5_nmp")
    for method, bound in (
        ("lq", unverified_solution.RESIDUAL),
        ("full", unverified_solution.RIPPLE),
    ):
        assert unverified_solution.residual_is_small(
            made(model, method=method, residual_relative=bound)
        )
        assert not unverified_solution.residual_is_small(
            made(model, method=method, residual_relative=bound * 1.0001)
        )
    assert unverified_solution.residual_is_small(
        made(model, status=Status.BASELINE, residual_relative=1.0)
    )
    assert unverified_solution.RIPPLE != unverified_solution.RESIDUAL
    assert (
        refinement.with_ripple(made(model, residual_relative=unverified_solution.RIPPLE)).warnings
        == ()
    )
    warnings = refinement.with_ripple(
        made(model, residual_relative=2 * unverified_solution.RIPPLE, warnings=("a",))
    ).warnings
    assert (
        warnings[0] == "a"
        and f"relative residual {2 * unverified_solution.RIPPLE:.1e} between them" in warnings[1]
    )


@pytest.mark.parametrize(
    ("residual", "defect", "guided", "status"),
    [
        (1.0, 1.01e-5, True, Status.TOLERANCE_NOT_MET),
        (1.0, 1e-5, True, Status.SOLVED),
        (unverified_solution.RESIDUAL, 1.0, True, Status.SOLVED),
        (1.0, 1.0, False, Status.SOLVED),
    ],
)
def test_under_a_feedback_the_residual_or_the_defect_is_small(
    residual: float, defect: float, guided: bool, status: Status, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = flexgen.read("planar5_nmp")
    run = simulated(
        model,
        feedback=MotorFeedback(*4 * (np.ones(2),), dict.fromkeys(HERTZ, 1.0)) if guided else None,
    )
    checked = verification.Verification(run, None, None, 1e-6, defect)
    monkeypatch.setattr(refinement, "run_method", lambda *_: None)
    monkeypatch.setattr(
        refinement, "make_solution", lambda *_: made(model, residual_relative=residual)
    )
    monkeypatch.setattr(refinement, "verify_by_simulation", lambda *_: checked)
    reached = BestSolution()
    assert refinement.refine(Problem(), find_method("lq"), reached).status == status


def test_methods_that_follow_the_default_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "_inverts", lambda robot: robot.name != "four_mass")
    names = {
        n: choice.default_method(flexgen.read(n), None)
        for n in ("elbow", "planar5_nmp", "four_mass")
    }
    assert names == {"elbow": "closed-form", "planar5_nmp": "lq", "four_mass": "collocation"}
    limits = Limits(torque=(1.0,))
    assert choice.default_method(flexgen.read("elbow"), limits) == "lq"
    assert choice.default_method(flexgen.read("four_mass"), limits) == "full"
    circle = flexgen.read("planar5_nmp", overrides=COUPLED | {"motor.m2.carrier": "arm2"})
    assert choice.default_method(circle, None) == "full"
    complete = flexgen.read("planar5_nmp", overrides=COUPLED)
    assert choice.default_method(complete, None) == "lq"

    def further(name: str, method: str, limits: Limits | None = None) -> list[str]:
        problem = Problem(name, limits=limits)
        return [m.name for m in choice.further_methods(problem, find_method(method))]

    assert further("elbow", "closed-form") == ["lq", "full"]
    assert further("elbow", "lq") == ["full"]
    assert further("planar5_nmp", "lq") == ["bvp", "collocation", "full"]
    assert further("four_mass", "collocation") == ["full"] and further("planar5_nmp", "full") == []
    assert further("kr300_efjm", "lq") == ["bvp", "collocation"]
    able = [m for m in ("bvp", "collocation", "full") if find_method(m).keeps_limits]
    assert further("planar5_nmp", "lq", limits) == able != ["bvp", "collocation", "full"]
    with pytest.raises(
        ArgumentError,
        match=r"limits: method 'fjm' tracks the path exactly and cannot keep limits, expected",
    ):
        choice.check_applies(find_method("fjm"), complete, limits)
    with pytest.raises(
        ArgumentError,
        match="method lq: model planar5_nmp: joint q2 turns a motor whose torque it needs, expec",
    ):
        choice.check_applies(find_method("lq"), circle, None)
    choice.check_applies(find_method("lq"), complete, None)
    choice.check_applies(find_method("full"), circle, limits)


def test_arguments_of_solve_at_their_bounds() -> None:
    check_arguments("lq", 0, SolveOptions(preview=0, mesh=0.1))
    check_arguments("auto", None, SolveOptions(limits=Limits(torque=(1.0,))))
    for name, value in (
        ("preview", False),
        ("preview", -1.0),
        ("preview", np.nan),
        ("mesh", 0),
        ("mesh", True),
        ("accuracy", 0.0),
        ("accuracy", np.inf),
        ("time_limit", -1),
        ("time_limit", "1"),
    ):
        given: dict[str, Any] = {"preview": 0.1, "mesh": 0.1, "time_limit": 1.0, name: value}
        with pytest.raises(ArgumentError, match=f"^{name}: given {value!r}, expected "):
            check_arguments("lq", given.pop("time_limit"), SolveOptions(**given))
    with pytest.raises(ArgumentError, match=r"limits: given 3, expected flexgen\.Limits"):
        check_arguments("lq", None, SolveOptions(limits=3))  # type: ignore[arg-type]
    assert without_effect("lq", SolveOptions(preview=0.1, mesh=0.2)) == ()
    unused = without_effect("closed-form", SolveOptions(preview=0.1))
    assert [w[:22] for w in unused] == ["preview: given 0.1 s, "]
    both = without_effect("rigid", SolveOptions(preview=0.1, mesh=0.25))
    assert len(both) == 2 * find_method("rigid").algebraic


def test_limits_of_a_model_and_of_arguments() -> None:
    robot = flexgen.read("urdf_arm")
    limits = Limits.from_model(robot)
    assert limits.torque is not None and limits.speed is not None and limits.deflection is None
    assert (
        limits.torque == tuple(m.torque_max or np.inf for m in robot.motors)
        and limits.torque[0] == 3.75
    )
    assert limits.speed == tuple(m.speed_max or np.inf for m in robot.motors)
    given = Limits.from_model(robot, torque=2, deflection=[0.5])
    assert given == Limits((2.0, 2.0, 2.0), None, (0.5,))
    torque, speed = given.arrays(3)
    assert torque.tolist() == [2.0] * 3 and speed.tolist() == [np.inf] * 3
    assert (
        given.deflections(1).tolist() == [0.5] and limits.deflections(2).tolist() == [np.inf] * 2
    )
    with pytest.raises(
        ArgumentError,
        match="limits: given deflection 3, expected a sequence of numbers, one for each non-",
    ):
        Limits(deflection=3)  # type: ignore[arg-type]
    with pytest.raises(
        ArgumentError, match=r"limits: given torque \(True,\), expected .*, one for each motor$"
    ):
        Limits(torque=(True,))
    with pytest.raises(
        ArgumentError, match="limits: model elbow states none, expected torque_max or speed_max"
    ):
        Limits.from_model("elbow")
    for values, size in (((1.0, 0.0), 2), ((1.0,), 2), ((1.0, -2.0), 2)):
        with pytest.raises(ArgumentError, match=rf"expected {size} positive numbers"):
            Limits(torque=values).arrays(size)
    with pytest.raises(
        ArgumentError, match="limits, number of torque bounds: given 10001, expected 0 to 10000"
    ):
        Limits().arrays(10_001)
    assert Limits().arrays(10_000)[0].shape == (10_000,) and Limits().deflections(0).shape == (0,)


def test_warnings_of_exceeded_limits_name_value_and_limit() -> None:
    robot = flexgen.read("urdf_arm")
    dof = dataclasses.replace(
        robot.coordinates[1].dof, lower=-0.5, upper=0.25, speed_max=2.0, acceleration_max=30.0
    )
    coordinates = (
        robot.coordinates[0],
        dataclasses.replace(robot.coordinates[1], dof=dof),
        *robot.coordinates[2:],
    )
    robot = Made(
        motors=robot.motors,
        coordinates=coordinates,
        n_m=3,
        n_a=4,
        i_e=(),
        tool=robot.tool,
        lines=(),
    )
    x = np.zeros((len(T), 4))

    def warned(limited: bool = False, **values: float) -> tuple[str, ...]:
        found = {name: x.copy()[:, : 3 if name.endswith("m") else 4] for name in values}
        for name, value in values.items():
            found[name][2, 0 if name.endswith("m") else 1] = value
        trajectory = channels(robot, **found)
        trajectory.meta.update({"torque": "limited"} if limited else {})
        return limit_warnings(robot, trajectory)

    motor = robot.motors[0]
    assert warned(tau_m=3.75, v_m=-300.0, q_a=0.25, v_a=-2.0, a_a=30.0) == () == warned(q_a=-0.5)
    assert warned(True, tau_m=-3.753) == () != warned(tau_m=-3.753)
    assert warned(tau_m=-4.0, v_m=301) == (
        f"motor {motor.name}: torque 4 N m exceeds its limit 3.75 N m",
        f"motor {motor.name}: speed 301 rad/s exceeds its limit 300 rad/s",
    )
    assert warned(q_a=0.26, v_a=-2.1, a_a=31.0) == (
        f"coordinate {dof.name}: 0.26 rad is above its limit 0.25 rad",
        f"coordinate {dof.name}: 2.1 rad/s exceeds its limit 2 rad/s",
        f"coordinate {dof.name}: 31 rad/s^2 exceeds its limit 30 rad/s^2",
    )
    assert warned(q_a=-0.6) == (f"coordinate {dof.name}: -0.6 rad is below its limit -0.5 rad",)


def test_residuals_of_the_samples_at_rest() -> None:
    """With zero motion the residual is the torque of gravity and of the motors; relative to each
    row's torque.
    """
    equations = derive("planar5_nmp")
    model = equations.model
    torque = np.tile([3.0, -2.0], (len(T), 1))
    trajectory = channels(model, tau_m=torque, tau_g=np.tile([10.0, -5.0], (len(T), 1)))
    rows = residual_rows(equations, trajectory)
    zeros = np.zeros
    arm, motor = (
        np.array(x).ravel()
        for x in equations.function("residual")(
            *(zeros(3) for _ in range(3)), *(zeros(2) for _ in range(3)), torque[0]
        )
    )
    expected = np.abs(np.r_[arm, motor[list(model.i_m)]])
    np.testing.assert_allclose(rows, expected, rtol=1e-12, atol=1e-12)
    elastic = np.array(equations.function("elastic_torque")(zeros(3), zeros(3))).ravel()
    scale = zeros(3)
    scale[list(model.i_g)] = [10.0, 5.0]
    scale[list(model.i_e)] = np.abs(elastic)
    motors = np.array([3.0, 2.0])[list(model.i_m)]
    scales = np.r_[np.maximum(scale, 1e-3 * scale.max()), motors]
    assert relative_residual(equations, trajectory, rows) == pytest.approx(
        (expected / scales).max(), rel=1e-12
    )


def test_simpler_models_are_compared_with_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    equations = derive("planar5_nmp")
    model = equations.model
    said = []

    def solved(given: Any, move: Any, name: str, progress: bool) -> Any:
        assert given is equations and move is model.moves[0] and progress is False
        if name == "fjm":
            raise SolverError("broken")
        return made(model, method=name)

    monkeypatch.setattr(comparison, "solve", solved)
    own = made(model)
    found = comparison.compare_methods(equations, own, said.append)
    assert [s.method for s in found] == ["rigid", "quasistatic", "lq"]
    steps = ["rigid", "fjm", "fjm has no solution: broken", "quasistatic"]
    assert said == [f"comparison: method {step}" for step in steps]
    assert len(comparison.compare_methods(equations, own)) == 3
    assert [
        s.method for s in comparison.compare_methods(equations, made(model, method="rigid"))
    ] == [
        "quasistatic",
        "rigid",
    ]
    monkeypatch.setattr(
        comparison,
        "solve",
        lambda *_, **__: made(model, method="rigid", stopped="interrupted by Ctrl-C"),
    )
    with pytest.raises(KeyboardInterrupt):
        comparison.compare_methods(equations, own)
    monkeypatch.setattr(comparison, "solve", lambda *_, **__: made(model, method="rigid"))
    assert len(comparison.compare_methods(derive("elbow"), own)) == 2


def test_rows_of_errors_are_lengths_and_angles() -> None:
    model = flexgen.read("planar5_nmp")
    error = np.outer(np.array([9.0, 3.0, 1.0, 5.0, 2.0, 0.0]), [0.6, -0.8])
    one = made(model, simulation=simulated(model, error))
    row = comparison.error_rows((one, made(model, method="fjm")))
    assert row[0] == {
        "method": "lq",
        "status": "solved",
        "start_m": pytest.approx(3.0),
        "largest_m": pytest.approx(9.0),
    }
    assert row[1] == {"method": "fjm", "status": "solved"}


@dataclasses.dataclass(frozen=True)
class Timed:
    """A solution with its times."""

    method: str = "lq"
    warnings: tuple[str, ...] = ("jerky",)
    wall_s: float = 0.0
    cpu_s: float = 0.0


@pytest.mark.parametrize("fails", [False, True])
def test_a_solution_has_the_times_of_all_steps_and_all_warnings(
    fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So has one that was found before the time was over; options without effect are named
    last.
    """
    wall = iter((10.0, 13.5))  # type: ignore[var-annotated]
    cpu = iter((2.0, 4.25))
    told = []

    def find(problem: Any, method: str, reached: BestSolution) -> Timed:
        told.append((problem, method))
        if fails:
            raise KeyboardInterrupt
        return Timed()

    clocks = Made(perf_counter=lambda: next(wall), process_time=lambda: next(cpu))
    monkeypatch.setattr(solve, "time", clocks)
    monkeypatch.setattr(
        solve, "_problem", lambda model, *given: Made(model=model, limits="limits")
    )
    monkeypatch.setattr(solve, "_find_solution", find)
    monkeypatch.setattr(solve, "with_hold", lambda problem, solution, controller: solution)
    monkeypatch.setattr(solve, "within_limits", lambda solution, limits, ignored: solution)
    monkeypatch.setattr(
        solve,
        "without_effect",
        lambda method, asked: (f"{method}: {asked.preview}, {asked.mesh}",),
    )
    monkeypatch.setattr(BestSolution, "finish", lambda self, stage, time_limit: Timed("full", ()))
    found = inspect.unwrap(solve.solve)("elbow", "line", mesh=0.01)
    assert (found.wall_s, found.cpu_s) == (3.5, 2.25) and [method for _, method in told] == [
        "auto"
    ]
    assert found.warnings == (("full: None, 0.01",) if fails else ("jerky", "lq: None, 0.01"))


def test_a_ripple_that_is_a_large_part_of_the_torque_is_not_solved() -> None:
    model = flexgen.read("planar5_nmp")
    for error, converged, status in (
        (0.71, False, Status.TOLERANCE_NOT_MET),
        (0.71, True, Status.SOLVED),
        (refinement.RIPPLE_MOST, False, Status.SOLVED),
    ):
        details = {"converged": converged, "torque_error": error}
        found = refinement.with_ripple(made(model, details=details))
        assert found.status == status
    text = problem_of(
        refinement.with_ripple(made(model, details={"converged": False, "torque_error": 0.71})),
        1e-5,
    )
    assert text.startswith("tolerance not met: the motor torques ripple: about 71%")
