"""Results derived from a solution: positions to send, torques of bristles, angles that encoders
show, and statuses.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass, field
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.positions import reference
from flexgen.identification.estimator.status import FitStatus
from flexgen.inversion.problem import memory
from flexgen.simulation.environment import sense as sense_module


@dataclass(frozen=True)
class Samples:
    """A trajectory of two motors that move evenly."""

    time: np.ndarray
    channels: dict[str, Any] = field(default_factory=dict)
    ports: dict[str, Any] = field(default_factory=lambda: {"a": 1})
    labels: dict[str, Any] = field(default_factory=lambda: {"a": 2})
    units: dict[str, Any] = field(default_factory=lambda: {"a": 3})

    def at(self, t: np.ndarray) -> dict[str, np.ndarray]:
        return {"q_m": np.stack([t, 2 * t], axis=1)}


@dataclass(frozen=True)
class Solved:
    """A solution."""

    model: Any
    trajectory: Samples


def test_positions_to_send_are_what_the_servo_inverts(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the samples of the solution, by a cubic spline; of the joints through the gears; rest on
    both sides.
    """
    seen: dict[str, Any] = {}
    servo = Made(sample_time=0.1, delay=0.03, feedback="gains")

    def hold(trajectory: Any, time: np.ndarray, h: float, delay: float) -> np.ndarray:
        seen.update(time=time, held=(h, delay))
        return np.stack([time, -time], axis=1)

    def invert(servo: Any, gains: Any, held: np.ndarray, q_m: np.ndarray) -> np.ndarray:
        seen["q_m"] = q_m
        return np.stack([seen["time"] ** 3, seen["time"] ** 2], axis=1)

    monkeypatch.setattr(reference, "servo_of", lambda given, model: servo)
    monkeypatch.setattr(reference, "hold_torques", hold)
    monkeypatch.setattr(reference, "invert_servo", invert)
    monkeypatch.setattr(reference, "holding_offset", lambda gains, held: 10.0 * held)
    monkeypatch.setattr(reference, "command_columns", lambda model: ({"c": 4}, {"c": 5}, {"c": 6}))
    eta = np.array([[10.0, 0.0], [5.0, 20.0]])
    model: Any = Made(servo=1, title="arm", eta=eta)
    time = np.linspace(0.0, 1.0, 7)
    solution: Any = Solved(model, Samples(time, {"q": 0}))
    found = reference.with_positions(solution).trajectory
    assert_allclose(seen["time"], np.linspace(-0.4, 1.4, 19), atol=1e-12)
    assert seen["held"] == (0.1, 0.03)
    assert_allclose(seen["q_m"][:, 0], np.clip(seen["time"], 0.0, 1.0), atol=1e-12)
    # the torque at the begin is (-0.4, 0.4)
    command = np.stack([time**3 - 4.0, time**2 + 4.0], axis=1)
    assert_allclose(found.channels["command_m"], command, atol=1e-9)
    assert_allclose(found.channels["command_g"] @ eta.T, command, atol=1e-9)
    assert (found.channels["q"], found.ports, found.labels, found.units) == (
        0,
        {"a": 1, "c": 4},
        {"a": 2, "c": 5},
        {"a": 3, "c": 6},
    )
    model.servo = None
    with pytest.raises(
        ArgumentError,
        match=r'given "position" for the model arm without a servo, expected a table \[se',
    ):
        reference.with_positions(solution)


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


def test_statuses_of_fits_that_can_be_used() -> None:
    """And those whose deviations are those of the parameters; each has a sentence and an
    advice.
    """
    assert {status for status in FitStatus if status.agrees} == {
        FitStatus.FITTED,
        FitStatus.SMALL_ERROR,
    }
    assert {status for status in FitStatus if status.has_deviations} == {
        FitStatus.FITTED,
        FitStatus.NOT_CHECKED,
        FitStatus.NOISE_TOO_LARGE,
    }
    assert all(
        status.sentence.endswith(".") and status.advice.endswith(".") for status in FitStatus
    )
    assert str(FitStatus.AT_BOUND) == "at a bound" and f"{FitStatus.FITTED}" == "fitted"
