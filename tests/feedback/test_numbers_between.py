"""Motions between samples whose accelerations are polynomials, and the law that holds the arm by
gravity alone.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.base.motion import interpolation
from flexgen.base.motion.torque_curve import POLYNOMIALS
from flexgen.feedback.laws import motor_laws


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_a_motion_whose_acceleration_jumps_is_its_integral(degree: int) -> None:
    """Two intervals of ten steps with other polynomials; angle and speed continue, integrated by
    hand.
    """
    parts = [
        np.array([2.0, -1.0, 0.5, 3.0])[: degree + 1],
        np.array([-4.0, 2.5, 1.0, -2.0])[: degree + 1],
    ]
    start: list[Any] = [(0.3, -0.2)]
    powers = np.arange(degree + 1)

    def motion(c: np.ndarray, begin: Any, s: np.ndarray) -> np.ndarray:
        a = (c * s[:, None] ** powers).sum(axis=1)
        dv = (c * s[:, None] ** (powers + 1) / (powers + 1)).sum(axis=1)
        dq = (c * s[:, None] ** (powers + 2) / ((powers + 1) * (powers + 2))).sum(axis=1)
        return np.stack([begin[0] + begin[1] * s + dq, begin[1] + dv, a])

    start.append(tuple(motion(parts[0], start[0], np.array([0.5]))[:2, 0]))

    def whole(at: np.ndarray) -> np.ndarray:
        """The sample where the intervals meet is that of the later one."""
        late = at >= 0.5
        return np.where(late, motion(parts[1], start[1], at - 0.5), motion(parts[0], start[0], at))

    t = np.concatenate([np.linspace(0.0, 0.5, 11), np.linspace(0.5, 1.0, 11)[1:]])
    x = [row[:, None] * [1.0, -2.0] for row in whole(t)]
    at = np.array([0.0, 0.0123, 0.37, 0.499, 0.5, 0.61, 0.987, 1.0])
    channels = dict(zip(("q_a", "v_a", "a_a"), x, strict=True)) | {"tau_m": x[2], "other": x[0]}
    found = interpolation.interpolate(t, channels, {POLYNOMIALS: degree}, at)
    for name, expected in zip(("q_a", "v_a", "a_a"), whole(at), strict=True):
        assert_allclose(
            found[name], expected[:, None] * [1.0, -2.0], rtol=1e-9, atol=1e-12, err_msg=name
        )
    assert_allclose(found["tau_m"], found["a_a"], rtol=1e-12)
    assert list(found) == list(channels)


def test_instants_outside_of_a_trajectory_are_refused() -> None:
    t = np.array([0.25, 0.5, 1.0])
    channels = {"x": np.array([[1.0], [2.0], [5.0]])}
    expected = "expected one or more instants from 0.25 to 1 s"
    for at, given in (
        (0.2, "0.2"),
        (1.1, "1.1"),
        (float("nan"), "nan"),
        ("x", "'x'"),
        ([0.5, 1.5], "an instant that is outside"),
        ([[0.5]], "shape (1, 1)"),
    ):
        with pytest.raises(ArgumentError) as refused:
            interpolation.interpolate(t, channels, {}, at)
        assert str(refused.value) == f"t: given {given}, {expected}"
    assert_allclose(interpolation.interpolate(t, channels, {}, 0.25)["x"], [1.0])
    # through three samples
    parabola = interpolation.interpolate(t, channels, {}, [0.375, 1.0])["x"]
    assert_allclose(parabola[:, 0], [1.0 + 4.0 * 0.125 + 8 / 3 * 0.125 * -0.125, 5.0])


@pytest.mark.parametrize("feedforward", [False, True])
def test_a_law_of_gravity_holds_the_arm_where_it_will_be(
    feedforward: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``u = eta^-T g(q)`` at the delayed arm, then motor angles and speeds, and zeros for what the
    law does not use.
    """
    q = ca.SX.sym("q", 2)
    gravity = ca.Function("gravity", [q], [ca.vertcat(3 * q[0], q[0] * q[1])])
    eta = np.array([[2.0, 0.5], [0.0, 4.0]])
    arm = np.arange(12.0).reshape(3, 2, 2)  # samples; position, speed
    motors = np.arange(20.0, 32.0).reshape(3, 2, 2)
    held = np.full((3, 2), -7.0)
    asked: list[float] = []

    def at(delay: float) -> np.ndarray:
        asked.append(delay)
        return arm

    motion: Any = Made(
        model=Made(n_m=2, n_a=2, eta=eta),
        equations=Made(function=lambda name: {"gravity": gravity}[name]),
        reference=Made(held=held),
        delay_s=3e-4,
        arm=at,
        motors=lambda: motors,
        difference=lambda x: -x,
        timing=lambda: "timing",
        state_channel="channel",
        steps_per_s=8000.0,
    )
    loops: list[Any] = []
    monkeypatch.setattr(motor_laws, "obstacle", lambda model, part: None)
    monkeypatch.setattr(motor_laws, "_check_gravity", lambda motion, k_p: loops.append(k_p))
    monkeypatch.setattr(
        motor_laws, "check_pose_loop", lambda motion, gains, text: loops.append((gains(0), text))
    )
    monkeypatch.setattr(motor_laws, "library_with", lambda model, names: names)
    monkeypatch.setattr(motor_laws, "BoundLaw", lambda *given: given)
    bound: Any = motor_laws.TomeiPD.bound
    law = bound.__wrapped__(
        motor_laws.TomeiPD(k_p=(5.0, 6.0), k_d=(0.25, 0.5), feedforward=feedforward), motion
    )
    g = np.stack([3 * arm[:, 0, 0], arm[:, 0, 0] * arm[:, 0, 1]], axis=1)
    u = held if feedforward else np.array([np.linalg.solve(eta.T, row) for row in g])
    table = law[5]
    gains = law[6]
    base = law[9]
    assert asked == ([] if feedforward else [3e-4]) and law[2] == ["forward_dynamics"]
    assert_allclose(table, np.hstack([u, -motors.reshape(3, 4), np.zeros((3, 4))]), rtol=1e-14)
    assert_allclose(gains, [[5.0, 6.0], [0.25, 0.5], [0.0, 0.0], [0.0, 0.0]])
    assert_allclose(base, u[0], rtol=1e-14)
    (position, speed), text = loops[1]
    assert_allclose(loops[0], [5.0, 6.0])
    assert_allclose(position, [[0, 0, 5.0, 0], [0, 0, 0, 6.0]])
    assert_allclose(speed, [[0, 0, 0.25, 0], [0, 0, 0, 0.5]])
    assert (
        text == "k_p, k_d: given [5. 6.], [0.25 0.5 ]" and law[4] == "timing" and law[10] == 8000.0
    )
