"""A call that the time limit or Ctrl-C ends returns the parts that are done, and says so."""

from __future__ import annotations

import importlib
import os
import signal
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
import flexgen.base.calls.deadline
from flexgen.base.calls.deadline import OutOfTime

pytestmark = needs_compiler

WORDS = {"time": "time limit", "interrupt": "interrupted"}


@pytest.fixture(scope="module")
def robot() -> Any:
    known_up_to = {"uncertainty": {"stiffness": 0.1, "masses": 0.03}}
    return flexgen.read("elbow", overrides=known_up_to)


@pytest.fixture(scope="module")
def plan(robot: Any) -> Any:
    poses = [[0.5, -0.3], [0.1, 0.9], [-0.4, 0.2]]
    return flexgen.excite(robot, poses=poses, period_s=0.5, lines=6, periods=2)


def end_after_first_part(monkeypatch: pytest.MonkeyPatch, module: str, event: str) -> list[int]:
    """The clock is a day later, or Ctrl-C is pressed, when a module states its first part."""
    late = [0.0]
    first = flexgen.base.calls.deadline.part_known
    left: list[int] = []

    def part_known(what: str, took_s: float, rest: int) -> None:
        first(what, took_s, rest)
        if left:
            return
        left.append(rest)
        if event == "time":
            late[0] = 86_400.0
        else:
            os.kill(os.getpid(), signal.SIGINT)

    clock = types.SimpleNamespace(perf_counter=lambda: time.perf_counter() + late[0])
    monkeypatch.setattr(flexgen.base.calls.deadline, "time", clock)
    monkeypatch.setattr(importlib.import_module(module), "part_known", part_known)
    return left


def control_call(robot: Any, plan: Any, **options: Any) -> Any:
    plants = {"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.2}}
    noise = {"encoder_noise": 1e-5, "sample_time": 1e-3, "seed": 4}
    return flexgen.control(robot, "joints", plants=plants, **noise, **options)


def control_parts(run: Any) -> list[Any]:
    return [(one.name, one.tau_m, one.error) for one in run.runs]


def measure_call(robot: Any, plan: Any, **options: Any) -> Any:
    return flexgen.measure(plan, robot, **options)


def measure_parts(found: Any) -> list[Any]:
    return [
        (pose, *data) for pose, *data in zip(found.plan.poses, found.tau_m, found.q_m, strict=True)
    ]


def frf_call(robot: Any, plan: Any, **options: Any) -> Any:
    return flexgen.frf(flexgen.measure(plan, robot), **options)


def frf_parts(found: Any) -> list[Any]:
    rows = (found.poses, found.G, found.C, found.variance, found.speed_sd)
    return list(zip(*rows, strict=True))


def predict_call(robot: Any, plan: Any, **options: Any) -> Any:
    return flexgen.predict(robot, "joints", robots=40, **options)


def predict_parts(found: Any) -> list[Any]:
    return [(x,) for x in found.errors_m]


def sweep_call(robot: Any, plan: Any, **options: Any) -> Any:
    moves = flexgen.random_moves(3, seed=1)
    grid = flexgen.Grid(["elbow"], moves=moves, methods=["closed-form"])
    return flexgen.sweep(grid, workers=0, shard_size=1, **options)


def sweep_parts(found: Any) -> list[Any]:
    names = ("case", "torque_max", "tool_error_max")
    return list(zip(*(found.results[name] for name in names), strict=True))


def score_call(robot: Any, plan: Any, **options: Any) -> Any:
    return flexgen.score("two_link", **options)


def score_parts(found: Any) -> list[Any]:
    return list(zip(found.values, found.reference, strict=True))


CALLS: dict[str, tuple[Callable[..., Any], Callable[[Any], list[Any]], str]] = {
    "control": (control_call, control_parts, "flexgen.feedback.loop.control"),
    "measure": (measure_call, measure_parts, "flexgen.identification.experiments.experiment"),
    "frf": (frf_call, frf_parts, "flexgen.identification.responses.frequency_response"),
    "predict": (predict_call, predict_parts, "flexgen.studies.tolerances.prediction"),
    "sweep": (sweep_call, sweep_parts, "flexgen.studies.sweeps.sweep"),
    "score": (score_call, score_parts, "flexgen.studies.scenarios.bench"),
}
WHOLE: dict[str, list[Any]] = {}
EACH = [pytest.param(name, marks=[pytest.mark.slow] if name == "score" else []) for name in CALLS]


def close(a: Any, b: Any) -> bool:
    """Equal texts; numbers that differ by rounding of the same sums in another order."""
    if isinstance(a, str):
        return bool(a == b)
    x = np.asarray(a)
    y = np.asarray(b)
    return bool(np.abs(x - y).max() <= 1e-9 * max(float(np.abs(y).max()), 1e-300))


@pytest.mark.parametrize("event", WORDS)
@pytest.mark.parametrize("name", EACH)
def test_the_parts_that_are_done_are_those_of_the_whole_result(
    name: str, event: str, robot: Any, plan: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    call, parts_of, module = CALLS[name]
    if name not in WHOLE:
        found = call(robot, plan)
        assert found.ended == ""
        WHOLE[name] = parts_of(found)
    with monkeypatch.context() as patch:
        left = end_after_first_part(patch, module, event)
        found = call(robot, plan, time_limit=3600.0)
    parts = parts_of(found)
    assert found.ended == WORDS[event] and left[0] > 0
    assert len(parts) == len(WHOLE[name]) - left[0]
    for part, whole in zip(parts, WHOLE[name], strict=False):
        assert all(map(close, part, whole))


@pytest.mark.parametrize("name", EACH)
def test_a_limit_that_is_not_reached_changes_nothing(name: str, robot: Any, plan: Any) -> None:
    call, parts_of, _ = CALLS[name]
    found = call(robot, plan, time_limit=3600.0)
    if name not in WHOLE:
        WHOLE[name] = parts_of(call(robot, plan))
    assert found.ended == "" and len(parts_of(found)) == len(WHOLE[name])
    for part, whole in zip(parts_of(found), WHOLE[name], strict=True):
        assert all(map(close, part, whole))


@pytest.mark.parametrize("name", EACH)
def test_a_limit_before_the_first_part_is_an_error_that_says_so(
    name: str, robot: Any, plan: Any
) -> None:
    call, _, _ = CALLS[name]
    with pytest.raises(OutOfTime, match=f"^{name}: the time limit of 1e-09 s was over before"):
        call(robot, plan, time_limit=1e-9)


def test_results_that_are_not_whole_say_so(
    robot: Any, plan: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In their status, and in their files."""
    with monkeypatch.context() as patch:
        end_after_first_part(patch, CALLS["measure"][2], "time")
        experiment = flexgen.measure(plan, robot, time_limit=3600.0)
    again = flexgen.Experiment.load(experiment.save(tmp_path / "data.npz"))
    assert again.ended == "time limit" and len(again.plan.poses) == 1
    assert again.plan.predicted == {}
    # the responses say it too: their experiment has not all poses
    responses = flexgen.frf(again)
    assert flexgen.Frf.load(responses.save(tmp_path / "frf.npz")).ended == "time limit"
    with monkeypatch.context() as patch:
        end_after_first_part(patch, CALLS["control"][2], "time")
        run = control_call(robot, plan, time_limit=3600.0)
    assert run.status == "time limit: not simulated: soft, stiff"
    assert run.to_dict()["status"] == run.status
    with monkeypatch.context() as patch:
        end_after_first_part(patch, CALLS["sweep"][2], "time")
        swept = sweep_call(robot, plan, time_limit=3600.0)
    assert swept.to_dict()["status"] == "time limit: 1 of 3 cases are done"


@pytest.mark.parametrize("event", WORDS)
def test_a_plan_has_the_best_of_the_candidates_that_were_computed(
    event: str, robot: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = "flexgen.identification.experiments.operating_points"
    lines: list[str] = []
    with monkeypatch.context() as patch:
        left = end_after_first_part(patch, module, event)
        found = flexgen.excite(
            robot, poses=3, period_s=0.5, lines=6, time_limit=3600.0, progress=lines.append
        )
    assert found.ended == WORDS[event] and found.poses.shape == (3, 2) and left[0] > 100
    # as many candidates as poses were computed: all of them are chosen
    few = flexgen.excite(
        robot, poses=found.poses @ np.linalg.inv(robot.eta).T, period_s=0.5, lines=6
    )
    assert close(found.poses, few.poses)
    assert found.predicted == pytest.approx(few.predicted)


def test_the_time_of_the_other_parts_is_told(robot: Any, plan: Any) -> None:
    lines: list[str] = []
    with flexgen.base.calls.deadline.limit_fit("call", 60.0, lines.append):
        flexgen.base.calls.deadline.part_known("draws", 2.0, 7)
        flexgen.base.calls.deadline.part_known("draws", 2.0, 6)
    assert lines == ["7 more draws, about 14 s; limit 60 s"]
