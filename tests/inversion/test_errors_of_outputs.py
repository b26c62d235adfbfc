"""Errors of an output and of a plan by distances and angles; torques of bristles; encoders."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass, replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.judge.verification import plan_error
from flexgen.inversion.problem import memory
from flexgen.model.elements import Output
from flexgen.simulation.environment import sense as sense_module
from flexgen.simulation.result import output_error


@pytest.mark.parametrize("pose", ["tool_pose", "tool_position", "combination"])
def test_an_angle_is_that_of_poses_only(pose: str) -> None:
    equations = derive("elbow") if pose != "combination" else derive("four_mass")
    model = equations.model
    if pose == "tool_pose":
        equations = derive(replace(model, output=Output("tool_pose")))
    q = (
        np.array([[0.2, 0.3], [0.4, 0.5]])
        if pose != "combination"
        else np.full((2, model.n_a), 0.3)
    )
    forward, output = (equations.function(name) for name in ("forward_kinematics", "output"))
    y = np.array([np.array(output(x)).ravel() for x in q])
    R = np.array([np.array(forward(x)[1]) for x in q])
    turn = np.array(
        [
            [math.cos(0.1), -math.sin(0.1), 0.0],
            [math.sin(0.1), math.cos(0.1), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    reference = {"y_ref": y - 0.25, "R_ref": np.array([R[0], turn @ R[1]]).reshape(2, 9)}
    error, distance, angle = output_error(equations, reference, q)
    assert_allclose(error, 0.25)
    assert distance == pytest.approx(0.25 * math.sqrt(y.shape[1]))
    assert angle == (pytest.approx(0.1) if pose == "tool_pose" else None)
    without = output_error(equations, {"y_ref": y}, q)
    assert without[1:] == (pytest.approx(0.0, abs=1e-15), None)


@pytest.mark.parametrize("kind", ["tool_pose", "tool_position", "combination"])
def test_the_error_of_a_plan_is_the_distance_of_the_simulated_output(kind: str) -> None:
    """The largest of all instants, and the angle of a pose; nothing for a unit that the output
    does not have.
    """
    equations = derive("elbow") if kind != "combination" else derive("four_mass")
    if kind == "tool_pose":
        equations = derive(replace(equations.model, output=Output("tool_pose")))
    rng = np.random.default_rng(3)
    both = rng.uniform(0.1, 0.4, (2, 4, equations.model.n_a))
    forward, output = (equations.function(name) for name in ("forward_kinematics", "output"))
    y = np.array([[np.array(output(x)).ravel() for x in part] for part in both])
    planned, found = (Made(trajectory=Motion(part)) for part in both)
    metres, radians = plan_error(equations, planned, found)  # type: ignore[arg-type]
    length = y[..., :3] if kind == "tool_pose" else y
    assert metres == pytest.approx(np.linalg.norm(length[1] - length[0], axis=1).max())
    if kind != "tool_pose":
        assert radians is None
        return
    R = np.array([[np.array(forward(x)[1]) for x in part] for part in both])
    cosine = [(np.trace(a.T @ b) - 1) / 2 for a, b in zip(*R, strict=True)]
    assert radians == pytest.approx(np.arccos(np.clip(cosine, -1, 1)).max(), rel=1e-6)


class Motion:
    """Arm coordinates at some instants."""

    def __init__(self, q_a: np.ndarray) -> None:
        self.time = np.arange(float(len(q_a)))
        self.q_a = q_a

    def __getitem__(self, name: str) -> np.ndarray:
        assert name == "q_a"
        return self.q_a


@dataclass(frozen=True)
class Motors:
    """Motors of a result."""

    q_m: Any
    v_m: Any
    a_m: Any
    tau_m: np.ndarray


@dataclass(frozen=True)
class Result:
    """A result of a method."""

    t: np.ndarray
    motors: Motors
    tau_b: Any = None


def test_torques_of_bristles_are_added_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a motor has them; hysteresis comes before."""
    monkeypatch.setattr(memory, "motor_bristles", lambda model: model)
    monkeypatch.setattr(memory, "bristle_torques", lambda law, t, v, a: v + 2 * a)
    monkeypatch.setattr(memory, "torques_to_send", lambda equations, q_m, torques: 3 * torques)
    equations: Any = Made(model="arm")
    result: Any = Result(np.arange(2.0), Motors(0.0, np.ones(2), np.ones(2), np.array([1.0, 2.0])))
    found: Any = memory.with_lugre(equations, result)
    assert found.tau_b.tolist() == [3.0, 3.0] and found.motors.tau_m.tolist() == [10.0, 11.0]
    assert memory.with_lugre(equations, found) is found
    steps: list[str] = []
    monkeypatch.setitem(
        memory.AFTER_THE_ARM,
        "hysteresis",
        lambda equations, result: steps.append("hysteresis") or result,
    )  # type: ignore[func-returns-value]
    monkeypatch.setitem(
        memory.AFTER_THE_ARM,
        "lugre",
        lambda equations, result: steps.append("bristles") or result,
    )  # type: ignore[func-returns-value]
    for gears, motors, expected in (
        ([], [], []),
        ([1], [], ["hysteresis"]),
        ([], [1], ["bristles"]),
        ([1], [1], ["hysteresis", "bristles"]),
    ):
        laws = [Made(key="hysteresis")] * len(gears) + [Made(key="lugre")] * len(motors)
        monkeypatch.setattr(memory, "memory_laws", lambda model, laws=laws: laws)
        steps.clear()
        assert memory.with_memory(equations, result) is result and steps == expected


def test_encoders_show_the_angle_with_their_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the motors that have one; what was given stays as it was."""
    monkeypatch.setattr(sense_module, "encoder_error", lambda error, q: error * np.sin(q))
    model: Any = Made(motors=[Made(encoder_error=None), Made(encoder_error=0.5)])
    q_m = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = sense_module.shown_angles(model, q_m)
    assert_allclose(found, [[1.0, 2.0 + 0.5 * np.sin(2.0)], [3.0, 4.0 + 0.5 * np.sin(4.0)]])
    assert q_m.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    with pytest.raises(
        ArgumentError, match=r"model: given elbow without a \[\[sensor\]\], expected one or more"
    ):
        inspect.unwrap(sense_module.sense)(derive("elbow"), Made())
