"""Delays, noises and stability of laws, passivity in words, and positions that a servo inverts."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws import chain
from flexgen.feedback.laws.passivity import Passivity
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.timing import Timing
from flexgen.feedback.positions import reference


@pytest.mark.parametrize(
    ("delay", "whole", "rest", "segments"),
    [
        (0.0, 0, 0.0, []),
        (0.3e-3, 0, 0.3e-3, [(1, 0.3e-3)]),
        (1e-3, 1, 0.0, [(1, 1e-3)]),
        (2.4e-3, 2, 0.4e-3, [(3, 0.4e-3), (2, 1e-3), (1, 1e-3)]),
        (3e-3 - 1e-15, 3, 0.0, [(3, 1e-3), (2, 1e-3), (1, 1e-3)]),
    ],
)
def test_torques_under_way_add_up_to_the_delay(
    delay: float, whole: int, rest: float, segments: list[tuple[int, float]]
) -> None:
    timing = Timing(1e-3, delay, predicted=True)
    assert timing.whole == whole and timing.rest_s == pytest.approx(rest, abs=1e-18)
    found = timing.segments()
    assert [k for k, _ in found] == [k for k, _ in segments]
    assert_allclose([x for _, x in found], [x for _, x in segments], rtol=1e-12)
    assert sum(x for _, x in found) == pytest.approx(delay, abs=1e-14)
    assert timing.ahead_s == pytest.approx(delay + 0.5e-3)
    assert Timing(1e-3, delay).segments() == [] and Timing(1e-3, delay).ahead_s == 0.0


def test_noises_are_parts_of_the_largest_torques() -> None:
    """A motor without a limit has the largest of the others, and 1 N m where there is none."""
    for limits, expected in (
        ([3.0, None], [3.0, 3.0]),
        ([None, None], [1.0, 1.0]),
        ([0.2, None], [0.2, 1.0]),
    ):
        model: Any = Made(motors=[Made(torque_max=x) for x in limits])
        assert_allclose(Noises(model).largest, expected)
    robot = flexgen.read("elbow")
    found = Noises(robot)
    assert (found.torque, found.rate, found.tool_force) == (0.05, 1.0, 50.0)
    for name, given in (("torque_noise", {"torque": 0.0}), ("disturbance_rate", {"rate": -1.0})):
        with pytest.raises(ArgumentError, match=f"^{name}: given"):
            Noises(robot, **given)
    with pytest.raises(ArgumentError, match=r"^tool_force: given -1\.0, expected a number >= 0"):
        Noises(robot, tool_force=-1.0)
    assert Noises(robot, tool_force=0.0).tool_force == 0.0


@pytest.mark.parametrize("predicted", [False, True])
def test_a_chain_is_stable_up_to_its_largest_frequency(predicted: bool) -> None:
    """Two integrators with a hold and a delay of 1.4 samples, step by step; also with a state that
    is predicted.
    """
    timing = chain.Timing(1e-3, 1.4e-3, predicted, False)

    def moved(x: np.ndarray, u: float, h: float) -> np.ndarray:
        return np.array([x[0] + h * x[1] + h * h / 2 * u, x[1] + h * u])

    def growth(frequency: float) -> float:
        g = chain.chain_gains(frequency, 2, "continuous", 1e-3)
        x = np.array([1.0, 0.0])
        last = 0.0
        before = 0.0
        sizes = []
        for _ in range(1200):
            ahead = moved(moved(x, before, 0.4e-3), last, 1e-3) if predicted else x
            new = float(-g @ ahead)
            new = float(-g @ moved(ahead, new, 0.5e-3)) if predicted else new
            x = moved(moved(x, before, 0.4e-3), last, 0.6e-3)
            before = last
            last = new
            sizes.append(np.abs(x * [1.0, 1e-3]).max())
        return float(np.max(sizes[-300:]) / np.max(sizes[300:600]))

    for form in ("continuous", "discrete"):
        largest = chain.largest_frequency(2, form, timing)
        assert 1.0 < largest < 550.0  # the search ends above half of the sampling frequency
        if largest > 500.0:
            continue
        below, above = (
            chain.largest_eigenvalue(chain.chain_gains(x * largest, 2, form, 1e-3), timing)
            for x in (0.99, 1.01)
        )
        assert below < 1.0 < above
    largest = chain.largest_frequency(2, "continuous", timing)
    assert growth(0.98 * largest) < 1.0 < growth(1.02 * largest)
    cubic = chain.chain_gains(2.0, 3, "continuous", 1e-3)
    assert_allclose(cubic, [(4 * np.pi) ** 3, 3 * (4 * np.pi) ** 2, 12 * np.pi], rtol=1e-12)


def test_passivity_in_words() -> None:
    margins = np.array([[2.0, 1.0, 3.0], [4.0, -0.5, -0.25]])
    found = Passivity("arm", "ppi", ("begin", "end"), np.array([1.0, 10.0, 100.0]), margins)
    assert (
        not found.passive
        and found.margin == -0.5
        and found.pose == "end"
        and found.fails_hz == 10.0
    )
    assert str(found).splitlines() == [
        "arm, controller ppi: not passive",
        "  not passive from: 10 Hz",
    ]
    rows = [line.split() for line in found.to_text().splitlines()]
    assert ["begin", "1", "10"] in rows and ["end", "-0.5", "10"] in rows
    data = found.to_dict()
    assert (data["passive"], data["margin"], data["fails_hz"]) == (False, -0.5, 10.0)
    calm = Passivity("arm", "ppi", ("begin",), found.hz, np.array([[0.0, 1.0, 2.0]]))
    assert calm.passive and calm.fails_hz is None and str(calm) == "arm, controller ppi: passive"
    assert Passivity("a", "b", ("x",), found.hz, np.array([[1.0, 1.0, -1e-9]])).fails_hz == 100.0


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
