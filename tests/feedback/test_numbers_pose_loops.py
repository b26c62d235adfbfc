"""Loops of laws at poses, step by step: stiffness and damping, eigenvalues, and where they are
refused.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.laws import motor_laws, stability
from flexgen.feedback.laws.impedance import Impedance
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.sampled_model import PoseModels

H = 1e-3
DELAY = 1.4e-3


def at_rest(*poses: list[float]) -> tuple[flexgen.RobotModel, list[np.ndarray]]:
    """The robot elbow at rest at some poses, as points of a motion."""
    equations = derive("elbow")
    model = equations.model
    held = [hold_joints(equations, np.array(pose), None) for pose in poses]
    q_a, q_m, tau = (
        np.array([getattr(h, name) for h in held]) for name in ("q_a", "q_m", "tau_m")
    )
    return model, [q_a, 0 * q_a, 0 * q_a, q_m, 0 * q_m, 0 * q_m, tau]


def test_an_impedance_has_the_stiffness_and_damping_of_its_springs() -> None:
    """At the joints through the ratios, by frequency and inertia, at the tool through the Jacobian
    of each pose.
    """
    model, motion = at_rest([0.3, -0.8], [0.6, 0.4])
    inverse = np.linalg.inv(model.eta)
    eta = model.eta
    K, D = Impedance(joint_stiffness=(2e4, 1e4), damping=(300.0, 200.0))._of_motors(model, motion)
    assert_allclose(K, np.tile(inverse.T @ np.diag([2e4, 1e4]) @ inverse, (2, 1, 1)), rtol=1e-9)
    assert_allclose(
        D, np.tile(inverse.T @ np.diag([300.0, 200.0]) @ inverse, (2, 1, 1)), rtol=1e-9
    )
    K, D = Impedance(frequency_hz=3.0, damping_ratio=0.5)._of_motors(model, motion)
    equations = derive(model)
    inertia = []
    for q in motion[0]:
        M = np.array(equations.function("mass_matrix")(q))
        whole = inverse.T @ M @ inverse + np.diag([m.inertia for m in model.motors])
        inertia.append(whole)
    first = (6 * np.pi) ** 2 * np.diag(np.diag(eta.T @ inertia[0] @ eta))
    assert_allclose(K, np.tile(inverse.T @ first @ inverse, (2, 1, 1)), rtol=1e-6)
    for stiffness, damping, M in zip(K, D, inertia, strict=True):
        values, vectors = np.linalg.eigh(M)
        S = vectors @ np.diag(np.sqrt(values)) @ vectors.T
        inner, turn = np.linalg.eigh(np.linalg.inv(S) @ stiffness @ np.linalg.inv(S))
        assert_allclose(damping, S @ turn @ np.diag(np.sqrt(inner)) @ turn.T @ S, rtol=1e-5)
    K, _ = Impedance(tool_stiffness=(3e4, 2e4, 1e4), damping=(1.0, 2.0, 3.0))._of_motors(
        model, motion
    )
    for k, q in enumerate(motion[0]):
        J = np.array(equations.function("jacobian")(q))[:3] @ inverse
        assert_allclose(K[k], J.T @ np.diag([3e4, 2e4, 1e4]) @ J, rtol=1e-9, atol=1e-9)
    with pytest.raises(
        ArgumentError, match=r"^controller, joint_stiffness: given 3 numbers, expected 2$"
    ):
        Impedance(joint_stiffness=(1.0, 1.0, 1.0))._of_motors(model, motion)
    with pytest.raises(
        ArgumentError,
        match=r"^controller, joint_stiffness: given \(1\.0, 0\.0\), which leaves a motion",
    ):
        Impedance(joint_stiffness=(1.0, 0.0))._of_motors(model, motion)


def test_an_impedance_is_refused_where_its_loop_grows() -> None:
    """Its matrices; just below the bound of the stiffness it is stable, just above it grows by
    less than a doubling.
    """
    model, motion = at_rest([0.3, -0.8])
    made = Impedance(frequency_hz=4.0, damping_ratio=0.7)
    found = made.linear(model, H, DELAY, motion)
    K, D = (x[0] for x in made._of_motors(model, motion))
    A, B, C, direct = (x[0] for x in found.matrices)
    assert not A.any() and np.array_equal(B, np.eye(2))
    assert_allclose(C, -D / H)
    assert_allclose(direct, K + D / H)
    low = 4.0
    high = 400.0

    def largest(hz: float) -> float:
        law = Impedance(frequency_hz=hz, damping_ratio=0.7)
        K, D = law._of_motors(model, motion)
        own = Linear(np.zeros((2, 2)), np.eye(2), -D[0] / H, K[0] + D[0] / H)
        return LoopAtPose(PoseModels(model).at(motion), own, H, DELAY).largest_eigenvalue()

    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if largest(middle) < 1.0 else (low, middle)
    Impedance(frequency_hz=0.999 * low, damping_ratio=0.7).linear(model, H, DELAY, motion)
    assert 1.0 < largest(1.01 * high) < 1.5
    with pytest.raises(ArgumentError) as caught:
        Impedance(frequency_hz=1.01 * high, damping_ratio=0.7).linear(model, H, DELAY, motion)
    size = f"{largest(1.01 * high):.6g}"
    words = (
        "with which the sampled loop is unstable at 1 ms and a delay of 1.4 ms (largest "
        f"eigenvalue {size})"
    )
    assert str(caught.value).startswith("controller, frequency_hz: given ") and words in str(
        caught.value
    )


@pytest.mark.parametrize("differences", [False, True])
def test_the_eigenvalue_of_a_pose_is_the_growth_of_its_loop(differences: bool) -> None:
    """Sampled states and torques that arrive 1.4 samples later, step by step."""
    rng = np.random.default_rng(2)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([40.0, 900.0]), -np.diag([0.5, 1.0])]])
    B = np.vstack([np.zeros((2, 1)), [[1.0], [0.4]]])
    pose: Any = SimpleNamespace(A=A, B=B)
    of_angles = np.array([[60.0, -20.0]])
    of_speeds = np.array([[9.0, 2.0]])
    h = 5e-3
    late = 7e-3
    found = stability.pose_eigenvalue(pose, of_angles, of_speeds, h, late, differences)
    whole = np.block([[A, B], [np.zeros((1, 5))]])
    first = expm(whole * 2e-3)[:4]
    second = expm(whole * 3e-3)[:4]
    x = rng.standard_normal(4)
    last = np.zeros(2)
    sent = [0.0, 0.0]
    sizes = []
    for _ in range(3000):
        speed = (x[:2] - last) / h if differences else x[2:]
        u = float((-(of_angles @ x[:2]) - of_speeds @ speed)[0])
        last = x[:2].copy()
        x = first @ [*x, sent[1]]
        x = second @ [*x, sent[0]]
        sent = [u, sent[0]]
        sizes.append(np.abs(x).max())
    early = np.log(sizes)[500:1000]
    late_part = np.log(sizes)[2000:2500]
    steps = 1500 + int(np.argmax(late_part)) - int(np.argmax(early))
    growth = np.exp((late_part.max() - early.max()) / steps)
    assert growth == pytest.approx(found, rel=5e-3)


def test_a_loop_is_checked_at_seven_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst one is named; a little above one is refused."""
    model = flexgen.read("elbow")
    time = 0.5 + 0.1 * np.arange(21)
    reference = SimpleNamespace(
        begin=0.7, end=1.9, time=time, points=lambda at: (np.array([[float(at[0]), 0.0]]), at)
    )
    motion: Any = SimpleNamespace(
        reference=reference, model=model, sample_s=2e-3, delay_s=1e-3, exact_state=False
    )
    monkeypatch.setattr(
        stability, "PoseModels", lambda model: SimpleNamespace(at=lambda points: int(points[1][0]))
    )
    asked: list[Any] = []
    sizes: dict[int, float] = {}

    def eigenvalue(
        pose: int,
        of_angles: Any,
        of_speeds: Any,
        sample_s: float,
        delay_s: float,
        differences: bool,
    ) -> float:
        asked.append((pose, float(of_angles[0, 0]), sample_s, delay_s, differences))
        return sizes.get(pose, 0.9)

    monkeypatch.setattr(stability, "pose_eigenvalue", eigenvalue)

    def feedback(q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gain = np.zeros((2, 4))
        gain[0, 0] = q_a[0]
        return gain, gain

    stability.check_pose_loop(motion, feedback, "k: given 1")
    assert [x[0] for x in asked] == [2, 4, 6, 8, 10, 12, 14] and asked[1] == (
        4,
        4.0,
        2e-3,
        1e-3,
        True,
    )
    sizes[10] = 1.0 + 1e-10
    stability.check_pose_loop(motion, feedback, "k: given 1")
    sizes[10] = 1.25
    sizes[8] = 1.01
    with pytest.raises(ArgumentError) as caught:
        stability.check_pose_loop(motion, feedback, "k: given 1")
    assert str(caught.value).startswith(
        "controller, k: given 1, with which the loop is unstable at the pose 0.8 s after the "
        "begin of the motion, at 2 ms and a delay of 1 ms (largest eigenvalue 1.25); expected "
        "eigenvalues below 1"
    )
    sizes[10] = 1.0001
    with pytest.raises(ArgumentError, match=r"unstable at the pose 0\.6 s"):
        stability.check_pose_loop(motion, feedback, "k: given 1")
    sizes[8] = np.nan
    with pytest.raises(ArgumentError, match="largest eigenvalue inf"):
        stability.check_pose_loop(motion, feedback, "k: given 1")


def test_gains_of_motors_are_rows_of_numbers() -> None:
    for given in ([1.0, 2.0], (1.0, 2.0), np.array([1.0, 2.0])):
        assert motor_laws._vector(given, "k_p", 2).tolist() == [1.0, 2.0]
    assert motor_laws._vector([-1.0, 0.0], "k", 2, signed=True).tolist() == [-1.0, 0.0]
    for wrong in (np.ones((1, 2)), [0.0, 1.0], [1.0, -1.0], "ab", 3.0, [1.0, np.nan]):
        with pytest.raises(
            ArgumentError,
            match=r"^controller, k_p: given .*, expected numbers > 0, one for each motor$",
        ):
            motor_laws._check_vector(wrong, "k_p")
    with pytest.raises(
        ArgumentError,
        match=r"^controller, k_p: given \[1\.0\], expected 2 numbers > 0, one for each mot",
    ):
        motor_laws._vector([1.0], "k_p", 2)
    motor_laws._check_vector(None, "k_p")
