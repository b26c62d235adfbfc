"""The time limit of a solve, Ctrl-C, and the status of a solution beyond the limits of the
model.
"""

from __future__ import annotations

import json
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arms_with_friction import arm, moves_of
from toolchain import needs_compiler

import flexgen
from flexgen.base.calls import deadline
from flexgen.base.calls.deadline import OutOfTime, check_time, pause, running, time_left
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.cli.main import main
from flexgen.inversion import refinement
from flexgen.inversion.solution import INTERRUPTED

LIGHT = {"motor.m1.torque_max": 5.0}  # N m; the move of planar5_nmp needs 24


class Clock:
    """A clock that advances by one second whenever it is read, and can be stopped."""

    def __init__(self) -> None:
        self.now = 0.0
        self.step = 1.0

    def perf_counter(self) -> float:
        self.now += self.step
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(deadline, "time", SimpleNamespace(perf_counter=found.perf_counter))
    return found


def reads(clock: Clock, method: str) -> int:
    """Number of times that a solve of the move reads the clock."""
    before = clock.now
    solution = flexgen.solve(model_of(method), method=method, time_limit=1e9, progress=False)
    assert not solution.stopped
    return int(clock.now - before)


def model_of(method: str) -> str:
    return "planar5_nmp" if method in ("lq", "bvp", "collocation") else "elbow"


@needs_compiler
@pytest.mark.parametrize(
    "method",
    [
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("lq", "bvp", "collocation", "bdf", "kunkel-mehrmann")
        ),
        "closed-form",
        "reduced",
    ],
)
def test_a_solve_ends_at_its_time_limit_whenever_that_is(method: str, clock: Clock) -> None:
    """At some twenty instants of the computation: the best solution, marked, or an error; never a
    success.
    """
    count = reads(clock, method)
    assert count > 4
    found = 0
    for limit in np.unique(np.linspace(1, count - 3, 20).astype(int)):
        try:
            solution = flexgen.solve(
                model_of(method), method=method, time_limit=float(limit), progress=False
            )
        except SolverError as error:
            assert f"the time limit of {limit:g} s ended in: " in str(
                error
            ) and "--time-limit" in str(error)
            continue
        found += 1
        assert solution.status is flexgen.Status.TOLERANCE_NOT_MET and not solution.interrupted
        assert f"the time limit of {limit:g} s ended in: " in solution.stopped
        assert any("best so far" in warning for warning in solution.warnings)
    assert found > 0


@needs_compiler
def test_without_a_time_limit_a_solve_is_not_ended(clock: Clock) -> None:
    clock.step = 1e6
    for unlimited in (None, 0):
        assert (
            flexgen.solve("planar5_nmp", time_limit=unlimited, progress=False).status
            is flexgen.Status.SOLVED
        )


@pytest.mark.parametrize("given", [-1.0, float("nan"), float("inf"), "60", True])
def test_invalid_time_limits_are_refused(given: object) -> None:
    with pytest.raises(
        ArgumentError, match=r"time_limit: given .*, expected a positive time in s"
    ):
        flexgen.solve("elbow", time_limit=given, progress=False)


def test_a_time_limit_within_another_one(clock: Clock) -> None:
    with running(100.0):
        with running(5.0):
            assert time_left() < 5.0
            with pytest.raises(OutOfTime, match="stage"):
                for _ in range(10):
                    check_time("stage")
        check_time("stage")
        with running(1000.0):
            assert time_left() < 100.0
        left = time_left()
        with pause():
            clock.now += 1000.0
        assert time_left() == pytest.approx(left, abs=10.0)
    clock.now += 1e6
    check_time("stage")
    assert time_left() == deadline.UNLIMITED


def interrupt(*args: object, **options: object) -> None:
    signal.raise_signal(signal.SIGINT)
    time.sleep(5)


@needs_compiler
def test_ctrl_c_keeps_the_best_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    handler = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patched:
        patched.setattr(refinement, "verify_by_simulation", interrupt)
        solution = flexgen.solve("planar5_nmp", progress=False)
    assert solution.interrupted and solution.stopped == INTERRUPTED
    assert (
        solution.status is flexgen.Status.TOLERANCE_NOT_MET
        and "not verified" in solution.warnings[-1]
    )
    exact = flexgen.solve("planar5_nmp", verify=False, progress=False)
    assert np.array_equal(solution.trajectory["tau_m"], exact.trajectory["tau_m"])
    assert signal.getsignal(signal.SIGINT) is handler
    monkeypatch.setattr(refinement, "run_method", interrupt)
    with pytest.raises(KeyboardInterrupt):
        flexgen.solve("planar5_nmp", progress=False)


@needs_compiler
def test_the_command_line_writes_what_was_reached(tmp_path, capfd, monkeypatch) -> None:
    out = tmp_path / "line.npz"
    monkeypatch.setattr(refinement, "verify_by_simulation", interrupt)
    assert main(["solve", "planar5_nmp", "--out", str(out), "--json"]) == 130
    data = json.loads(capfd.readouterr().out)
    assert (
        data["error"] == "interrupted; the result is the best so far"
        and data["stopped"] == INTERRUPTED
    )
    assert flexgen.Trajectory.load(out)["tau_m"].shape[1] == 2
    out.unlink()
    monkeypatch.setattr(refinement, "run_method", interrupt)
    assert main(["solve", "planar5_nmp", "--out", str(out)]) == 130 and not out.exists()


def test_the_time_limit_of_the_command_line(capfd, clock: Clock) -> None:
    assert main(["solve", "elbow", "--time-limit", "1"]) == 1
    assert "the time limit of 1 s ended in: " in capfd.readouterr().err


def test_a_solution_beyond_the_limits_of_the_model_is_not_solved() -> None:
    model = flexgen.read("planar5_nmp", overrides=LIGHT)
    solution = flexgen.solve(model, progress=False)
    assert solution.status is flexgen.Status.LIMITS_EXCEEDED
    assert "exceeds its limit 5 N m" in solution.warnings[0] and solution.tool_error_max_m < 1e-9
    studied = flexgen.solve(model, ignore_limits=True, progress=False)
    assert studied.status is flexgen.Status.SOLVED and studied.warnings == solution.warnings
    assert flexgen.solve(model, method="rigid", progress=False).status is flexgen.Status.BASELINE


def test_exit_status_of_exceeded_limits(tmp_path, capfd) -> None:
    words = [
        "solve",
        "planar5_nmp",
        "--set",
        "motor.m1.torque_max=5",
        "--out",
        str(tmp_path / "line.npz"),
    ]
    assert main(words) == 3
    captured = capfd.readouterr()
    assert "limits exceeded: motor m1: torque 24.48 N m exceeds its limit 5 N m" in captured.err
    assert "--ignore-limits" in captured.err and (tmp_path / "line.npz").exists()
    assert main([*words, "--ignore-limits"]) == 0


# --- stages --------------------------------------------------------------------------------------

# Method -> beginnings of the stages in which its time can end.
STAGES = {
    "closed-form": (
        "deriving the equations of motion",
        "the path of the move",
        "method closed-form",
        "quasi-static motion along the path",
        "equations along the path",
        "residuals of method closed-form",
        "growth of perturbations",
        "growth of perturbations, interval",
        "effect of the residuals",
        "simulation at t",
        "simulation of the time after the end",
    ),
    "lq": ("zeros along the path", "inversion until", "residuals of method lq"),
    "collocation": ("IPOPT, building the nonlinear program", "residuals of method collocation"),
    "full": ("IPOPT, building the nonlinear program", "simulation at t"),
}


def end_in(
    monkeypatch: pytest.MonkeyPatch, clock: Clock, stage: str, skipped: int = 0
) -> list[str]:
    """The clock stands still until a stage has begun, and is far beyond the limit then; the stages
    of all looks.
    """
    clock.step = 0.0
    seen: list[str] = []
    look = deadline.Deadline.check

    def check(self: deadline.Deadline, text: str) -> None:
        seen.append(text)
        if sum(each.startswith(stage) for each in seen) > skipped:
            clock.now = 1e9
        look(self, text)

    monkeypatch.setattr(deadline.Deadline, "check", check)
    return seen


@needs_compiler
@pytest.mark.parametrize(
    ("method", "stage"), [(method, stage) for method, stages in STAGES.items() for stage in stages]
)
def test_a_solve_ends_in_the_stage_in_which_its_time_ends(
    method: str, stage: str, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = end_in(monkeypatch, clock, stage)
    try:
        found = flexgen.solve(model_of(method), method=method, time_limit=5.0, progress=False)
    except SolverError as error:
        reason = str(error)
    else:
        assert found.status is flexgen.Status.TOLERANCE_NOT_MET
        # what a method has found is there, from its simulation on
        assert np.isfinite(found.trajectory["tau_m"]).all()
        reason = found.stopped
    assert f"the time limit of 5 s ended in: {seen[-1]}" in reason
    assert seen[-1].startswith(stage)
    # nothing was begun after it
    assert sum(text.startswith(stage) for text in seen) == 1


@pytest.mark.parametrize("method", ["collocation", "full"])
def test_ipopt_ends_at_the_iteration_at_which_the_time_ends(
    method: str, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also without messages: its callback looks at the clock, and names no stage."""
    seen = end_in(monkeypatch, clock, "iteration of IPOPT", skipped=1)
    with pytest.raises(SolverError, match="the time limit of 5 s ended in: IPOPT, iteration 1, "):
        flexgen.solve("planar5_nmp", method=method, time_limit=5.0, progress=False)
    assert sum(text == "iteration of IPOPT" for text in seen) == 2


def test_the_clock_of_ipopt_ends_a_solve_too(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It counts from the first iteration on, and may end before the other one."""
    clock.step = 0.0
    monkeypatch.setattr("flexgen.base.numerics.nlp.time_left", lambda: 1e-9)
    with pytest.raises(SolverError, match="the time limit of 5 s ended in: IPOPT, iteration"):
        flexgen.solve("planar5_nmp", method="collocation", time_limit=5.0, progress=False)


@needs_compiler
@pytest.mark.slow
def test_a_solve_looks_at_the_clock_all_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By processor time: between two looks of the second solve of an arm, less than a quarter of
    it.
    """
    model = arm(0, str(tmp_path))
    equations = flexgen.derive(model)
    move = moves_of(equations, 0)[0]
    flexgen.solve(equations, move, ignore_limits=True)
    looks: list[float] = []

    def perf_counter() -> float:
        looks.append(time.process_time())
        return looks[-1]

    monkeypatch.setattr(deadline, "time", SimpleNamespace(perf_counter=perf_counter))
    began = time.process_time()
    found = flexgen.solve(equations, move, ignore_limits=True)
    all_looks = [began, *looks, time.process_time()]
    assert found.status is flexgen.Status.SOLVED
    assert np.diff(all_looks).max() < (all_looks[-1] - began) / 4
