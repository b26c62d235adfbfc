"""Steps of laws that evaluate the model, against Lagrange's equations at drawn states."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from law_cases import arm, case_of, coupled
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.bound import BoundLaw
from flexgen.feedback.laws.chain import chain_gains
from flexgen.feedback.laws.linearising import ComputedTorque, FeedbackLinearisation
from flexgen.feedback.laws.motor_laws import JointTorqueFeedback, TomeiPD
from flexgen.feedback.loop.interface import Measurement, Reference, Setup
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.timing import Timing

pytestmark = needs_compiler
H = 5e-4
NONE = np.zeros(0)
PLANNED = Reference(NONE, NONE, NONE, NONE, NONE, NONE)
K_OWN = {"k_p": (6.0,) * 3, "k_d": (0.3,) * 3, "k_t": (0.1, 0.2, -0.3), "k_s": (1e-3, 2e-3, 3e-3)}


@cache
def motion_of(
    model: flexgen.RobotModel, delay: float = 0.0, exact: bool = True, h: float = H
) -> LawMotion:
    return case_of(model, h, delay, exact_state=exact).law_motion()


def measured(motion: LawMotion, x: np.ndarray) -> Measurement:
    """The measurement of a state ``q_a, v_a, q_m, v_m`` (4, n), other channels random."""
    n = motion.model.n_m
    sensors = np.random.default_rng(4).normal(
        size=sum(len(s.channels) for s in motion.model.sensors)
    )
    channels = motion.link_channels("test")
    if channels is None:
        return Measurement(x[2], np.r_[sensors, x.ravel()])
    sensors[channels - n] = x[0]
    return Measurement(x[2], sensors)


def states(motion: LawMotion, at: int, count: int = 3) -> list[np.ndarray]:
    """States near the planned one, as they are measured one after the other."""
    rng = np.random.default_rng(at)
    plan = motion.trajectory.at(
        np.clip(motion.reference.time[at : at + count], *motion.trajectory.time[[0, -1]])
    )
    sizes = np.array([1e-3, 1e-2, 0.05, 0.5])[:, None]
    out = []
    for k in range(count):
        x = np.stack([plan[name][k] for name in ("q_a", "v_a", "q_m", "v_m")])
        out.append(x + sizes * rng.normal(size=x.shape))
        if not motion.exact_state:
            last = out[-2] if k else out[-1]
            out[-1][1::2] = (out[-1][::2] - last[::2]) / H
    return out


def steps(law: BoundLaw, motion: LawMotion, at: int) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Sample, state and torque of a law that begins at a sample of the motion."""
    late = replace(law, table=law.table[at:])
    late.reset()
    found = enumerate(states(motion, at))
    return [(at + k, x, late.step(k, measured(motion, x), PLANNED)) for k, x in found]


def middle(motion: LawMotion) -> int:
    return int(np.searchsorted(motion.reference.time, 0.4 * motion.reference.end))


def of(motion: LawMotion, name: str, *given: np.ndarray) -> Any:
    found = motion.equations.function(name)(*given)
    return [np.array(x).ravel() for x in (found if isinstance(found, tuple) else (found,))]


@pytest.mark.parametrize("exact", [True, False])
def test_computed_torque_is_that_of_the_rigid_robot(exact: bool) -> None:
    """``J eta a + f(v_m) + eta^-T ID(q, v, a)``; speeds of the first sample are zero where they
    are differences. Motors drive several joints.
    """
    motion = motion_of(coupled(), exact=exact)
    law = ComputedTorque(5.0, allow_unstable=True).bound(motion)
    eta = motion.model.eta
    inertia = np.array([m.inertia for m in motion.model.motors])
    w = 10 * np.pi
    plan = motion.difference(motion.arm(0.0)[:, :3])
    for k, (_, _, q_m, v_m), u in steps(law, motion, middle(motion)):
        q = np.linalg.solve(eta, q_m)
        v = np.linalg.solve(eta, v_m)
        q_d, v_d, a_d = plan[k]
        a = a_d + 2 * w * (v_d - v) + w * w * (q_d - q)
        (tau,) = of(motion, "inverse_dynamics", q, v, a)
        (f,) = of(motion, "motor_friction", v_m)
        expected = inertia * (eta @ a) + f + np.linalg.solve(eta.T, tau)
        assert_allclose(u, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize(
    "law", [JointTorqueFeedback(**K_OWN), TomeiPD(6.0), TomeiPD(6.0, 0.7, feedforward=True)]
)
def test_laws_of_the_motors_are_linear_about_their_torque(law: Any, exact: bool) -> None:
    """Tomei: about the gravity of the delayed arm, or the feedforward; joint torques by the law of
    the gears.
    """
    delay = 0.4 * H
    motion = motion_of(
        coupled() if isinstance(law, JointTorqueFeedback) else arm(damped=False), delay, exact
    )
    made = law.bound(motion)
    eta = motion.model.eta
    if isinstance(law, TomeiPD):
        J = inertias(motion)
        w = 12 * np.pi
        assert_allclose(made.gains[:2], [w * w * J, 2 * law.damping * w * J], rtol=1e-6)
    gains = np.array(list(K_OWN.values())) if isinstance(law, JointTorqueFeedback) else made.gains
    turned = motion.difference(motion.motors())
    arms = motion.difference(motion.arm(0.0)[:, :2])

    def torques(q: np.ndarray, v: np.ndarray, q_m: np.ndarray, v_m: np.ndarray) -> np.ndarray:
        p, dp = of(motion, "gear_law", np.linalg.solve(eta, q_m) - q)
        rate = (np.linalg.solve(eta, v_m) - v) * dp
        return np.stack([np.linalg.solve(eta.T, p), np.linalg.solve(eta.T, rate)])

    for k, x, u in steps(made, motion, middle(motion)):
        base = motion.reference.held[k]
        if isinstance(law, TomeiPD) and not law.feedforward:
            (gravity,) = of(motion, "gravity", motion.arm(delay)[k, 0])
            base = np.linalg.solve(eta.T, gravity)
        expected = base + gains[0] * (turned[k, 0] - x[2]) + gains[1] * (turned[k, 1] - x[3])
        wanted = torques(arms[k, 0], arms[k, 1], *turned[k])
        expected = expected + (gains[2:] * (wanted - torques(*x))).sum(axis=0)
        assert_allclose(u, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


def inertias(motion: LawMotion) -> np.ndarray:
    """Of the motors with stiff springs where the motion begins."""
    model = motion.model
    (M,) = of(motion, "mass_matrix", motion.reference.motion["q_a"][0])
    back = np.linalg.inv(model.eta)
    own = np.diag(back.T @ M.reshape(model.n_a, -1) @ back)
    return own + [m.inertia for m in model.motors]


def test_joint_torque_feedback_places_the_poles_of_each_joint() -> None:
    """J M/K p^4 + (k_d M/K + k_s M) p^3 + (J + M + k_p M/K + k_t M) p^2 + k_d p + k_p on the side
    of the arm, all poles at -w.
    """
    motion = motion_of(arm(damped=False))
    model = motion.model
    w = 16 * np.pi
    gains = JointTorqueFeedback(8.0).bound(motion).gains
    ratio = np.diag(model.eta)
    (mass,) = of(motion, "mass_matrix", motion.reference.motion["q_a"][0])
    K = of(motion, "gear_law", np.zeros(3))[1]
    for j, motor in enumerate(model.motors):
        k_p, k_d, k_t, k_s = gains[:, j] * [ratio[j] ** 2, ratio[j] ** 2, 1, 1]
        J = motor.inertia * ratio[j] ** 2
        M = mass.reshape(3, 3)[j, j]
        own = [J * M / K[j], k_d * M / K[j] + k_s * M, J + M + k_p * M / K[j] + k_t * M, k_d, k_p]
        assert_allclose(own, J * M / K[j] * np.poly([-w] * 4), rtol=1e-8)


def derivatives(motion: LawMotion) -> ca.Function:
    """Acceleration, jerk and fourth derivative of the arm at a state under a constant torque."""
    n = motion.model.n_m
    q, v, p, w, u = (ca.SX.sym(name, n) for name in "qvpwu")
    a, a_m = motion.equations.function("forward_dynamics").expand()(q, v, p, w, u)
    x = ca.vertcat(q, v, p, w)
    rate = ca.vertcat(v, a, w, a_m)
    j = ca.jtimes(a, x, rate)
    return ca.Function("derivatives", [q, v, p, w, u], [a, j, ca.jtimes(j, x, rate), rate])


@pytest.mark.parametrize("form", ["continuous", "discrete"])
@pytest.mark.parametrize("exact", [True, False])
def test_linearizing_feedback_prescribes_the_fourth_derivative(exact: bool, form: Any) -> None:
    """By automatic differentiation of the equations of motion, without damping of the gears."""
    motion = motion_of(arm(damped=False), exact=exact)
    law = FeedbackLinearisation(9.0, form).bound(motion)
    function = derivatives(motion)
    g = chain_gains(9.0, 4, form, H)
    plan = motion.difference(motion.arm(0.0))
    for k, x, u in steps(law, motion, middle(motion)):
        a, j, s, _ = (np.array(y).ravel() for y in function(*x, u))
        q_d, v_d, a_d, j_d, s_d = plan[k]
        wanted = s_d + g[3] * (j_d - j) + g[2] * (a_d - a) + g[1] * (v_d - x[1])
        wanted = wanted + g[0] * (q_d - x[0])
        assert_allclose(s, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("late", [0.0, 2.4])
def test_a_prediction_is_the_motion_under_the_torques_under_way(late: float) -> None:
    """Over the delay, the oldest torque first, then half a sample under the new one; then the law
    without prediction of that state and of the later reference. Before the first sample the robot
    is held.
    """
    h = 5e-3
    delay = late * h
    motion = motion_of(arm(damped=False), delay, h=h)
    law = FeedbackLinearisation(9.0, predict=True, allow_unstable=True).bound(motion)
    law = replace(law, steps_per_s=4e3)
    plain = replace(law, timing=Timing(h, 0.0))
    rate = derivatives(motion)

    def move(x: np.ndarray, u: np.ndarray, duration: float) -> np.ndarray:
        if not duration:
            return x
        found = solve_ivp(
            lambda t, y: np.array(rate(*y.reshape(4, -1), u)[3]).ravel(),
            (0.0, duration),
            x.ravel(),
            rtol=1e-9,
            atol=1e-10,
        )
        return found.y[:, -1].reshape(4, -1)

    def torque(x: np.ndarray, row: np.ndarray) -> np.ndarray:
        plain.reset()
        return replace(plain, table=row[None]).step(0, measured(motion, x), PLANNED)

    whole, rest = divmod(delay + 1e-12, h)
    sent = [law.start] * 3
    ends = law.table.shape[1] // 2
    for k, x, u in steps(law, motion, middle(motion)):
        x = move(x, sent[int(whole)], rest if rest > 1e-9 else 0.0)
        for age in range(int(whole), 0, -1):
            x = move(x, sent[age - 1], h)
        first = torque(x, law.table[k, :ends])
        expected = torque(move(x, first, h / 2), law.table[k, ends:])
        assert_allclose(u, expected, rtol=2e-4, atol=2e-4 * np.abs(expected).max())
        sent = [u, *sent[:-1]]
    later = [motion.difference(motion.arm(d)) for d in (delay, delay + h / 2)]
    assert_allclose(law.table, np.hstack([x.reshape(len(x), -1) for x in later]))


@pytest.mark.parametrize(
    ("law", "exact", "n_y", "expected"),
    [
        (FeedbackLinearisation(9.0), True, 14, "3 and at least 18"),
        (FeedbackLinearisation(9.0), False, 5, "3 and at least 6"),
        (ComputedTorque(2.0), False, 2, "3 and at least 3"),
    ],
)
def test_a_loop_without_the_channels_of_a_law_is_refused(
    law: Any, exact: bool, n_y: int, expected: str
) -> None:
    made = law.bound(motion_of(arm(damped=False), exact=exact))
    text = f"given a loop with 3 motors and {n_y} measured channels, expected {expected}"
    with pytest.raises(ArgumentError, match=text):
        made.compiled(Setup(np.zeros((1, 3)), H, 3, n_y, 9))


def test_gains_below_the_change_of_gravity_are_refused() -> None:
    """The message states the largest norm of its slope, here by differences, at 40 poses."""
    motion = motion_of(arm(damped=False))
    n = motion.model.n_a
    count = len(motion.reference.time)
    largest = 0.0
    for k in np.unique(np.linspace(0, count - 1, 40).astype(int)):
        q = motion.reference.motion["q_a"][k]
        columns = [
            (of(motion, "gravity", q + e)[0] - of(motion, "gravity", q - e)[0]) / 2e-5
            for e in 1e-5 * np.eye(n)
        ]
        largest = max(largest, np.linalg.norm(np.array(columns), 2))
    text = f"smallest eigenvalue of springs and gains is .* gravity changes by {largest:.3g}"
    with pytest.raises(ArgumentError, match=text):
        TomeiPD(k_p=(1e-3,) * 3, k_d=(1e-3,) * 3).bound(motion)


def test_titles_of_laws() -> None:
    gains = dict.fromkeys(("k_p", "k_d"), (1.0,))
    titles = {
        FeedbackLinearisation(12.0, "discrete", True): (
            "feedback linearization, discrete, predicted, 12 Hz"
        ),
        FeedbackLinearisation(): "feedback linearization, continuous, 16 Hz",
        ComputedTorque(): "computed torque, 4 Hz",
        TomeiPD(3.0): "Tomei PD, 3 Hz",
        TomeiPD(**gains): "Tomei PD",
        JointTorqueFeedback(2.5): "joint torque feedback, 2.5 Hz",
        JointTorqueFeedback(**gains, k_t=(0.0,), k_s=(0.0,)): "joint torque feedback",
    }
    assert {law: law.title for law in titles} == titles
