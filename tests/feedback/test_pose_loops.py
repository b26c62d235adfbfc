"""Eigenvalues of sampled loops at poses: growth of a simulation, the poses that are checked, and
the largest stiffness of an impedance.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from law_cases import arm, at_rest, case_of
from numpy.testing import assert_allclose
from scipy.linalg import expm
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws import stability
from flexgen.feedback.laws.impedance import Impedance
from flexgen.feedback.loop.controllers import Linear
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.sampled_model import PoseModels

pytestmark = needs_compiler
H = 1e-3
DELAY = 1.4e-3


@pytest.mark.parametrize("differences", [False, True])
def test_the_eigenvalue_of_a_pose_is_the_growth_of_its_loop(differences: bool) -> None:
    """Exact pieces of each sample, torques that arrive 1.4 samples later; powers of the map from
    sample to sample that the simulation of unit vectors gives.
    """
    model = flexgen.read("elbow")
    at = PoseModels(model).at(at_rest(model))
    rng = np.random.default_rng(2)
    of_angles = 30.0 * rng.normal(size=(2, 4))
    of_speeds = 0.3 * rng.normal(size=(2, 4))
    whole = np.zeros((10, 10))
    whole[:8] = np.hstack([at.A, at.B])
    first, second = (expm(whole * h)[:8] for h in (DELAY - H, 2 * H - DELAY))

    def sample(z: np.ndarray) -> np.ndarray:
        x, last, sent, older = np.split(z, [8, 12, 14])
        speed = (x[:4] - last) / H if differences else x[4:]
        u = -(of_angles @ x[:4]) - of_speeds @ speed
        moved = second @ np.r_[first @ np.r_[x, older], sent]
        return np.r_[moved, x[:4], u, sent]

    loop = np.array([sample(z) for z in np.eye(16)]).T
    found = stability.pose_eigenvalue(at, of_angles, of_speeds, H, DELAY, differences)
    assert found == pytest.approx(np.abs(np.linalg.eigvals(loop)).max(), rel=1e-9)


@pytest.mark.parametrize("worst", [0, 3, 6])
def test_a_loop_is_checked_at_seven_poses(worst: int) -> None:
    """Evenly from begin to end of the motion; the worst one is named, with its eigenvalue."""
    motion = case_of(arm(damped=False), H).law_motion()
    reference = motion.reference
    instants = np.linspace(reference.begin, reference.end, 7)
    gain = np.hstack([np.zeros((3, 3)), np.eye(3)])
    stiffness = np.full(7, 5.0)
    stiffness[2] = -0.5
    stiffness[worst] = -3.0
    asked: list[np.ndarray] = []

    def feedback(q_a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(q_a)
        return stiffness[len(asked) - 1] * gain, 0.1 * gain

    text = rf"controller, x: given 1, .* at the pose {instants[worst]:.4g} s after .*value (.*)\);"
    with pytest.raises(ArgumentError, match=text) as caught:
        stability.check_pose_loop(motion, feedback, "x: given 1")
    assert_allclose(asked, motion.trajectory.at(instants)["q_a"], atol=1e-3)
    k = int(np.abs(reference.time - instants[worst]).argmin())
    at = PoseModels(motion.model).at(reference.points(np.array([k])))
    size = stability.pose_eigenvalue(at, -3.0 * gain, 0.1 * gain, H, 0.0, False)
    found = re.search(text, str(caught.value))
    assert found is not None and float(found[1]) == pytest.approx(size, rel=1e-3)
    stability.check_pose_loop(motion, lambda q_a: (5.0 * gain, 0.1 * gain), "x")


@pytest.mark.parametrize(
    ("sizes", "worst"),
    [
        ([0.5, 1 - 1e-6, 0.2, 0.3, 0.4, 0.5, 0.6], None),
        ([0.5, 0.9, 1 + 1e-7, 0.3, 0.4, 0.5, 0.6], 2),
        ([2.0, 0.9, 0.3, 0.3, 0.4, 0.5, 1.5], 0),
        ([0.5, 0.9, 0.3, 0.3, 0.4, np.nan, 1.5], 5),
    ],
)
def test_the_largest_eigenvalue_decides_or_one_that_is_not_a_number(
    sizes: list[float], worst: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Speeds are differences of samples unless the exact state is known."""
    motion = case_of(arm(damped=False), H).law_motion()
    left = list(sizes)
    asked: list[tuple[float, float, bool]] = []

    def eigenvalue(pose: object, a: np.ndarray, v: np.ndarray, *given: float | bool) -> float:
        asked.append(given)
        return left.pop(0)

    monkeypatch.setattr(stability, "pose_eigenvalue", eigenvalue)
    gain = np.ones((3, 6))

    def check() -> None:
        stability.check_pose_loop(motion, lambda q_a: (gain, gain), "x: given 1")

    if worst is None:
        check()
    else:
        instant = np.linspace(motion.reference.begin, motion.reference.end, 7)[worst]
        elapsed = instant - motion.reference.begin
        with pytest.raises(ArgumentError, match=rf"at the pose {elapsed:.4g} s after the begin"):
            check()
    assert asked == [(H, motion.delay_s, not motion.exact_state)] * 7


def test_an_impedance_is_refused_where_its_loop_grows() -> None:
    """Just below the largest frequency it is stable, just above it the error names the
    eigenvalue of the loop of its springs and dampers.
    """
    model = flexgen.read("elbow")
    motion = at_rest(model, [0.3, -0.8])
    at = PoseModels(model).at(motion)

    def largest(hz: float) -> float:
        low = Impedance(frequency_hz=4.0).linear(model, H, DELAY, motion)
        A, B, C, D = (x[0] for x in low.matrices)
        stiffness = (hz / 4.0) ** 2 * (D + C)
        damping = hz / 4.0 * -C
        own = Linear(A, B, -damping, stiffness + damping)
        return LoopAtPose(at, own, H, DELAY).largest_eigenvalue()

    low = 4.0
    high = 400.0
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if largest(middle) < 1.0 else (low, middle)
    Impedance(frequency_hz=0.999 * low).linear(model, H, DELAY, motion)
    text = f"unstable at 1 ms and a delay of 1.4 ms .largest eigenvalue {largest(1.01 * high):.6g}"
    with pytest.raises(ArgumentError, match=text):
        Impedance(frequency_hz=1.01 * high).linear(model, H, DELAY, motion)
    assert 1.0 < largest(1.01 * high) < 1.5


def test_torques_of_gears_need_a_sensor_each_without_delay() -> None:
    """Of several sensors of a joint the first one is used."""
    one = {"type": "joint_torque", "unit": "N m"}
    named = [one | {"name": f"t{k}", "coordinate": q} for k, q in enumerate(("q2", "q1", "q1"))]
    model = flexgen.read("elbow", overrides={"sensor": named})
    law = Impedance(torque_gain=0.5)
    D = law.linear(model, H, 0.0, at_rest(model)).matrices[3][0]
    assert_allclose(D[:, [3, 2]], 0.5 * np.linalg.inv(model.eta).T)
    assert not D[:, 4].any()
    late = [replace(s, delay_s=1e-3) if s.place == "q1" else s for s in model.sensors]
    for sensors, missing in ((late, "q1"), ((), "q1, q2")):
        own = replace(model, sensors=tuple(sensors))
        text = f"joint_torque, with delay_s = 0, at {missing}, expected one at each gear"
        with pytest.raises(ArgumentError, match=text):
            law.linear(own, H, 0.0, at_rest(own))
    rigid = replace(flexgen.read("elbow@rigid"), sensors=model.sensors)
    with pytest.raises(ArgumentError, match="with rigid gears, whose torques follow the motors"):
        law.linear(rigid, H, 0.0, at_rest(rigid))
