"""Laws, referees and refused input of `flexgen.simulation.integration.hold`."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.interpolate import PPoly, make_interp_spline

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.torque_curve import SAMPLES
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


def test_polynomial_torques_jump_at_the_ends_of_their_intervals(tmp_path: Any) -> None:
    curve = PPoly(np.array([[[2.0, 0.0], [1.0, -1.0]], [[1.0, 3.0], [5.0, 0.0]]]), [0.0, 0.5, 1.0])
    torque = hold.PolynomialTorque(
        np.array([0.0, 0.5, 1.0]),
        curve([0.0, 0.5, 1.0]),
        ("a", "b"),
        "spline",
        0.5,
        0.0,
        {},
        curve,
    )
    assert (
        torque.title() == "polynomials of degree 1 on 2 intervals"
        and torque.edges.tolist()
        == [
            0.0,
            0.5,
            1.0,
        ]
    )
    assert_allclose(
        torque.at(np.array([-1.0, 0.25, 0.5, 0.75, 2.0])),
        [[1, 3], [1.5, 3], [5, 0], [5.25, -0.25], [5.5, -0.5]],
    )
    for begin, end, at, expected in (
        (0.0, 0.5, 0.25, [1.5, 3.0]),
        (0.5, 1.0, 0.75, [5.25, -0.25]),
        (-0.5, 0.0, -0.2, [1.0, 3.0]),
        (1.0, 2.0, 1.5, [5.5, -0.5]),
    ):
        assert_allclose(torque.between(begin, end)(at), expected)
    made = torque.trajectory()
    assert (
        len(made.time) == 2 * SAMPLES + 1
        and made.meta["torque_degree"] == 1
        and made.meta["torque"] == "limited"
    )
    again = hold.command_in(
        made.time, made["tau_m"], ("a", "b"), {**made.meta, "move": "line", "other": 1}
    )
    assert isinstance(again, hold.PolynomialTorque) and again.meta == {"move": "line"}
    assert (again.sample_time, again.delay, again.hold) == (0.5, 0.0, "spline")
    assert_allclose(again.curve.c, curve.c, atol=1e-12)


def test_ticks_cover_the_motion_and_are_at_most_a_million(monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.array([1.0, 1.5, 2.0])
    tau = np.zeros((3, 1))
    for delay, first, last in (
        (0.0, 1.0, 2.0),
        (0.3, 0.5, 1.75),
        (0.25, 0.75, 1.75),
        (5.0, -4.0, -3.0),
    ):
        time, _ = hold.hold_torque(t, tau, "zoh", 0.25, delay)
        assert_allclose(time[[0, -1]], [first, last], atol=1e-12)
        assert time[0] + delay <= t[0] + 1e-9 and time[-1] + delay >= t[-1] - 1e-9
        assert_allclose(np.diff(time), 0.25)
    monkeypatch.setattr(hold, "MOST", 8)
    assert len(hold.hold_torque(t, tau, "zoh", 0.125)[0]) == 9
    words = (
        r"sample_time: given 0\.1 s, which makes 10 ticks, expected at most 8; take a longer "
        r"sample time"
    )
    with pytest.raises(ArgumentError, match=words):
        hold.hold_torque(t + 4.0, tau, "zoh", 0.1, 0.4)
