"""Torques that are held, read from files and cut at edges; momenta of a contact; by quadrature and
by hand.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.simulation import simulate
from flexgen.simulation.integration import hold
from flexgen.simulation.integration.hold import TorqueCommand, command_in, hold_torque

H = 4e-3
TICKS = 0.1 + H * np.arange(6)
VALUES = np.array([[0.0, 1.0], [2.0, 1.0], [3.0, -1.0], [1.0, 0.5], [-1.0, 2.0], [-1.0, 2.0]])


def command(kind: Any, delay: float = 1e-3) -> TorqueCommand:
    return TorqueCommand(TICKS, VALUES, ("a", "b"), kind, H, delay, {"model": "arm"})


def test_a_command_is_read_from_what_a_trajectory_states() -> None:
    """Instants are one sample time apart, up to a millionth of it; a spline and no hold are
    continuous torques.
    """
    meta = {"hold": "zoh", "sample_time": H, "delay": 1e-3}
    found = command_in(TICKS, VALUES, ("a", "b"), meta)
    assert found is not None and (found.hold, found.sample_time, found.delay) == ("zoh", H, 1e-3)
    assert command_in(TICKS, VALUES, ("a", "b"), {}) is None
    assert command_in(TICKS, VALUES, ("a", "b"), {"hold": "spline", "sample_time": H}) is None
    later = command_in(TICKS, VALUES, ("a", "b"), {"hold": "linear", "sample_time": H})
    assert later is not None and later.delay == 0.0
    command_in(TICKS + 4e-10 * np.arange(6) * 5, VALUES, ("a", "b"), meta)
    words = (
        r"^trajectory: given torques held for the sample time .* s at other instants, expected "
        r"rows one sample time "
    )
    for time, more in (
        (TICKS + 1e-8 * np.arange(6), {}),
        (TICKS, {"sample_time": 1.001 * H}),
        (TICKS, {"sample_time": None}),
    ):
        with pytest.raises(ArgumentError, match=words):
            command_in(time, VALUES, ("a", "b"), meta | more)
    for more, name in (
        ({"hold": "none"}, "hold"),
        ({"sample_time": 0.0}, "sample_time"),
        ({"delay": -1e-9}, "delay"),
    ):
        with pytest.raises(ArgumentError, match=f"^{name}: given "):
            command_in(TICKS, VALUES, ("a", "b"), meta | more)


@pytest.mark.parametrize("kind", ["zoh", "linear", "spline"])
def test_pieces_between_edges_are_the_torque_at_all_instants(kind: Any, tmp_path: Path) -> None:
    made = command(kind)
    edges = made.edges
    assert len(edges) == (2 if kind == "spline" else 6) and edges[0] == pytest.approx(0.101)
    ends = np.concatenate([[edges[0] - 1e-3], edges, [edges[-1] + 1e-3]])
    for begin, end in pairwise(ends):
        piece = made.between(begin, end)
        t = np.linspace(begin, end, 7)[1:-1]
        assert_allclose(piece(t), made.at(t), atol=1e-12)
    t = np.array([0.0, 0.1005, 0.103, 0.107, 0.5])
    curve = make_interp_spline(TICKS + 1e-3, VALUES, k=1 if kind == "linear" else 5)
    expected = curve(np.clip(t, 0.101, 0.101 + 5 * H))
    if kind == "zoh":
        expected = VALUES[[0, 0, 0, 1, 5]]
    assert_allclose(made.at(t), expected, atol=1e-12)
    if kind == "zoh":
        # at an edge that of the interval that begins there
        assert_allclose(made.at(edges), VALUES)
    loaded = flexgen.Trajectory.load(made.save(tmp_path / "a.npz"))
    assert (
        loaded.meta["hold"] == kind
        and loaded.meta["sample_time"] == H
        and loaded.meta["kind"] == "torque command"
    )
    assert_allclose(loaded["tau_m"], VALUES)


def test_titles_of_commands() -> None:
    assert command("zoh").title().endswith("at 4 ms, delay 1 ms") and command(
        "zoh", 0.0
    ).title().endswith("at 4 ms")
    assert repr(command("linear")).startswith("<TorqueCommand: ") and repr(
        command("linear")
    ).endswith(", 6 ticks from 0.1 s>")


def smooth(t: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(30 * t) ** 3 * (t > 0), 1.0 + np.cos(20 * t)], axis=-1)


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("delay", [0.0, 2.5e-3])
def test_held_torques_have_the_means_of_the_continuous_one(limited: bool, delay: float) -> None:
    """Where limits may be active they are the means; else means less a twelfth of their second
    differences.
    """
    t = np.linspace(0.0, 0.1, 201)
    tau = smooth(t)
    time, values = hold_torque(t, tau, "zoh", H, delay, limited=limited)
    assert time[0] <= -delay + 1e-12 and time[0] > -delay - H and time[-1] + delay >= 0.1 - 1e-12
    curve = hold.extend_constant(t, tau, limited)
    edges = time + delay
    means = []
    for begin, end in pairwise(edges):
        inner = [x for x in t if begin < x < end]
        means.append(
            [
                quad(
                    lambda x, k=k: float(curve(np.array([x]))[0, k]),
                    begin,
                    end,
                    points=inner,
                    limit=200,
                )[0]
                / (end - begin)
                for k in range(2)
            ]
        )
    means = np.array(means)
    expected = np.vstack([means, tau[-1:]])
    if not limited:
        padded = np.vstack([expected[:1], expected, expected[-1:]])
        expected[:-1] -= (padded[2:] - 2 * padded[1:-1] + padded[:-2])[:-1] / 12
    assert_allclose(values, expected, atol=1e-6)


def test_straight_lines_between_ticks_are_the_nearest() -> None:
    """Their distance from the torque has no part along any tent between two neighbors; ends are
    those of the torque.
    """
    t = np.linspace(0.0, 0.1, 201)
    tau = smooth(t)
    time, values = hold_torque(t, tau, "linear", H)
    curve = hold.extend_constant(t, tau, False)
    assert_allclose(values[[0, -1]], curve(time[[0, -1]]), atol=1e-12)
    fine = np.linspace(time[0], time[-1], 20 * (len(time) - 1) + 1)
    lines = np.stack([np.interp(fine, time, column) for column in values.T], axis=-1)
    away = lines - curve(fine)
    for k in range(1, len(time) - 1):
        tent = np.clip(1 - np.abs(fine - time[k]) / H, 0.0, None)
        part = np.trapezoid(away * tent[:, None], fine, axis=0) / H
        assert np.abs(part).max() < 2e-5
    limited = hold_torque(t, tau, "linear", H, limited=True)[1]
    assert limited.min() >= tau.min() and (limited.max(axis=0) <= tau.max(axis=0)).all()
    time, sampled = hold_torque(t, tau, "spline", H, 1e-3)
    assert_allclose(sampled, curve(time + 1e-3), atol=1e-12)
    with pytest.raises(
        ArgumentError,
        match=r"^sample_time: given 1e-08 s, which makes 10000000 ticks, expected at most",
    ):
        hold_torque(t, tau, "zoh", 1e-8)
    one = hold_torque(t, tau, "zoh", 1.0)
    assert len(one[0]) == 2


# --- contacts ------------------------------------------------------------------------------------
def test_momenta_and_driving_torques_of_a_record() -> None:
    """Of a motion with speeds by differences: their balance without contact is that of the
    equations of motion.
    """
    model = flexgen.read("elbow")
    detector = flexgen.CollisionDetector(model, sample_s=1e-3)
    solution = flexgen.solve("elbow", progress=False)
    t = np.arange(0.0, 1.0, 1e-3)
    found = solution.trajectory.at(t)
    p, driven = detector._terms(found["q_m"], found["tau_m"])
    assert p.shape == driven.shape == (1000, 2)
    rate = np.gradient(p, 1e-3, axis=0)
    size = np.abs(driven).max(axis=0)
    assert (np.abs(rate - driven)[20:-20].mean(axis=0) < 0.05 * size).all() and np.abs(p).max() > 0
    for q, tau in (
        (found["q_m"][:2], found["tau_m"][:2]),
        (found["q_m"], found["tau_m"][:5]),
        (t, t),
    ):
        with pytest.raises(
            ArgumentError, match=r"^record: given shapes .*, expected \(n, 2\) twice$"
        ):
            detector._terms(q, tau)
    free = detector.calibrate([(found["q_m"], found["tau_m"])], margin=2.0)
    again = detector.detect(found["q_m"], found["tau_m"])
    assert again.sample is None
    assert_allclose(free, 2.0 * np.abs(again.residual).max(axis=0))
    pushed = detector.detect(found["q_m"], found["tau_m"] + 50.0 * free * (t > 0.5)[:, None])
    assert pushed.sample is not None and 500 <= pushed.sample < 560
    with pytest.raises(
        ArgumentError, match=r"^records: given none with motion, expected runs without contact$"
    ):
        detector.calibrate([])
    with pytest.raises(
        ArgumentError, match=r"^bandwidth_hz: given 100\.0, expected more than 0, below 100$"
    ):
        flexgen.CollisionDetector(model, sample_s=1e-3, bandwidth_hz=100.0)
    assert "samples of 1 ms, bandwidth " in repr(detector)


# --- inputs of a simulation ----------------------------------------------------------------------
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("feedback", [None, "feedback"])
def test_inputs_of_a_simulation_are_torques_references_and_forces(
    feedback: Any, force: bool
) -> None:
    """Splines through the samples, then constant; without feedback the references are zero where a
    force is given.
    """
    t = np.linspace(0.0, 1.0, 21)
    tau = smooth(t)
    q_m = np.stack([t**3, 1 - t**2], axis=-1)
    pushed = np.stack([np.sin(t), 0 * t, t**2, 0 * t, 0 * t, np.cos(t)], axis=-1)
    after = 3  # rows that are held after the end of the motion

    def extended(x: np.ndarray) -> np.ndarray:
        return np.vstack([x, np.tile(x[-1], (after, 1))])

    given = {"tau_m": extended(tau), "q_m": extended(q_m)} | (
        {"force": extended(pushed)} if force else {}
    )
    task: Any = SimpleNamespace(data=SimpleNamespace(time=t, meta={}), given=given, command=None)
    made = simulate._input(task, feedback)
    for at in (0.1234, 0.5, 0.987, 1.5):
        found = made(at - 1e-3, at + 1e-3)(np.array([at]))[0]
        inside = min(at, 1.0)
        curve = make_interp_spline(t, tau, k=5)
        expected = [*(tau[-1] if at > 1 else curve(inside))]
        if feedback is None and not force:
            assert len(found) == 2
        elif feedback is None:
            expected += [0.0] * 4
        else:
            angles = make_interp_spline(t, q_m, k=5)
            expected += [*angles(inside), *(angles(inside, 1) if at < 1 else np.zeros(2))]
        if force:
            expected += [*make_interp_spline(t, pushed, k=5)(inside)]
        assert_allclose(found, expected, atol=1e-9)
