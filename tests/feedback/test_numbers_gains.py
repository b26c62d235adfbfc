"""Gains of controllers on models at a pose: eigenvalues that separate, recursions by hand, and
texts as LaTeX.
"""

from __future__ import annotations

import inspect
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_lyapunov

import flexgen
from flexgen.analysis.printing.printing import Name, escape_latex
from flexgen.base.errors import ArgumentError
from flexgen.exports.c_code.plcopen import text
from flexgen.feedback.laws import linearising, lq, motor_laws, state_lq
from flexgen.feedback.laws.lq import LQG, _Design, regulator
from flexgen.feedback.laws.state_lq import LQ
from flexgen.feedback.sampled_plant import sample_model


def two_masses() -> Any:
    """Two masses of 1 and 2 kg with a spring between them; the second one is driven, its position
    is measured.
    """
    K = 40.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    inverse = np.diag([1.0, 0.5])
    A = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-inverse @ K, -0.3 * inverse @ np.array([[1.0, -1.0], [-1.0, 1.0]])],
        ]
    )
    drive = np.array([[0.0], [0.0], [0.0], [0.5]])
    push = np.zeros((4, 3))
    push[2, 0] = 1.0
    C = np.array([[0.0, 1.0, 0.0, 0.0]])
    D = np.zeros((1, 1))
    return Made(A=A, B=drive, push=push, C=C, D=D, W=np.array([[1.0, 0.0]]))


@pytest.mark.parametrize("delay", [0.0, 0.01, 0.015])
def test_eigenvalues_of_a_loop_are_those_of_its_gain_and_of_its_observer(delay: float) -> None:
    """Of the robot with the torques under way, and of the error with the disturbance
    (separation).
    """
    at = two_masses()
    h = 0.01
    options = LQG(rho=0.5)
    made: Any = object.__new__(_Design)
    made.model = Made(n_m=1)
    made.sample_s = h
    made.delay_s = delay
    made.options = options
    made.poses = Made(at=lambda motion: at)
    made.u_max = np.array([3.0])
    made.noise = np.array([1e-8])
    made.tool_force = 50.0
    A, B, C, D = made.part([])
    F, G = sample_model(at.A, at.B, h, delay)
    size = len(F)
    rows = np.hstack([at.C, np.zeros((1, size - 4))])
    # e = -y, u = C z + D e, z <- A z + B e
    loop = np.block([[F - G @ D @ rows, G @ C], [-B @ rows, A]])
    found = np.linalg.eigvals(loop)
    gain = regulator(at, F, G, 0.5, np.array([3.0]))
    wanted = np.linalg.eigvals(F - G @ gain)
    for value in wanted:
        assert np.abs(found - value).min() < 1e-6
    assert np.abs(found).max() < 1.0 and len(found) == 2 * size + 1
    # the disturbance is estimated: a constant torque on the drive leaves no error of the torque at
    # rest
    constant = np.zeros(2 * size + 1)
    constant[:4] = sample_model(at.A, at.B, h, 0.0)[1][:4, 0]
    rest = np.linalg.solve(np.eye(len(loop)) - loop, constant)
    u = C @ rest[size:] - D @ rows @ rest[:size]
    assert_allclose(u, -1.0, rtol=1e-6)


def test_a_regulator_is_the_minimum_of_its_cost() -> None:
    """Of the sum over a long time from any state: another gain costs more."""
    at = two_masses()
    h = 0.01
    F, G = sample_model(at.A, at.B, h, 0.0)
    gain = regulator(at, F, G, 0.5, np.array([3.0]))
    u_max = np.array([3.0])
    Q = np.zeros((4, 4))
    Q[0, 0] = 1 / lq.OUTPUT_SCALE**2
    Q[2, 2] = lq.SPEED_WEIGHT_S**2 / lq.OUTPUT_SCALE**2
    Q += lq.REGULAR * np.trace(Q) / 4 * np.eye(4)

    def cost(K: np.ndarray) -> float:
        x = np.array([1e-3, 2e-3, -0.01, 0.02])
        closed = F - G @ K
        each = Q + K.T @ (0.5 / u_max**2 * K)
        return float(x @ solve_discrete_lyapunov(closed.T, each) @ x)

    least = cost(gain)
    for k in range(4):
        for factor in (0.99, 1.01):
            assert cost(gain * np.where(np.arange(4) == k, factor, 1.0)) > least


@pytest.mark.parametrize("exact", [False, True])
def test_a_gain_on_the_state_is_a_recursion_in_angles(exact: bool) -> None:
    """Speeds are differences of two samples, or measured; torques under way are the last ones."""
    rng = np.random.default_rng(3)
    n_a = 2
    n_m = 2
    h = 5e-3
    under_way = 2
    K = rng.normal(size=(n_m, 2 * 4 + under_way * n_m))
    links = np.array([3, 2])
    first = 4
    motion: Any = Made(
        model=Made(n_a=n_a, n_m=n_m), sample_s=h, exact_state=exact, state_channel=first
    )
    n_y = 4 + 8 * exact
    A, B, C, D = LQ()._part(K, motion, None if exact else links, n_y)
    z = np.zeros(len(A))
    torques = [np.zeros(n_m)] * under_way
    before = np.zeros(4)
    for e in rng.normal(size=(6, n_y)):
        if exact:
            angles = np.hstack([e[first : first + 2], e[first + 4 : first + 6]])
            speeds = np.hstack([e[first + 2 : first + 4], e[first + 6 : first + 8]])
        else:
            angles = np.hstack([e[links], e[:2]])
            speeds = (angles - before) / h
        u = C @ z + D @ e
        expected = K[:, :4] @ angles + K[:, 4:8] @ speeds - K[:, 8:] @ np.hstack(torques)
        assert_allclose(u, expected, rtol=1e-9)
        z = A @ z + B @ e
        before = angles
        torques = [*torques[1:], u]


def test_laws_on_the_motors_have_gains_of_their_frequency(monkeypatch: pytest.MonkeyPatch) -> None:
    """``w^2`` and ``2 w``; a table of angle, speed and acceleration; the inertias of the first
    instant.
    """
    model = flexgen.read("elbow")
    asked: list[Any] = []
    table = np.arange(5 * 4 * 2.0).reshape(5, 4, 2)
    reference = Made(
        time=np.arange(5),
        held=np.arange(10.0).reshape(5, 2),
        points=lambda k: asked.append(k.tolist()),
    )
    motion: Any = Made(
        model=model,
        reference=reference,
        timing=lambda: "timing",
        difference=lambda x: x,
        steps_per_s=7.0,
    )
    motion.arm = lambda ahead: table
    motion.state_channel = -1
    for name, value in (
        ("obstacle", None),
        ("library_with", "library"),
    ):
        monkeypatch.setattr(linearising, name, lambda *given, value=value: value)
    monkeypatch.setattr(linearising, "BoundLaw", lambda *given: given)
    checked: list[Any] = []
    monkeypatch.setattr(
        linearising.ComputedTorque,
        "_check",
        lambda self, motion, gains: checked.append(gains.tolist()),
    )
    w = 2 * np.pi * 5.0
    bound: Any = inspect.unwrap(linearising.ComputedTorque.bound)
    law = bound(linearising.ComputedTorque(frequency_hz=5.0), motion)
    assert (
        law[3:5] == (("rows", "friction"), "timing") and law[7:9] == (-1, None) and law[10] == 7.0
    )
    assert_allclose(law[5], table[:, :3].reshape(5, 6))
    assert_allclose(law[6], np.repeat([[w * w], [2 * w], [0.0], [0.0]], 2, axis=1))
    assert law[9].tolist() == [0.0, 1.0] and checked == [[w * w, 2 * w, 0.0, 0.0]]
    bound(linearising.ComputedTorque(frequency_hz=5.0, allow_unstable=True), motion)
    assert len(checked) == 1
    monkeypatch.setattr(
        motor_laws, "motor_inertias", lambda model, points: (np.array([2.0, 3.0]), None)
    )
    k_p, k_d = motor_laws.TomeiPD(frequency_hz=5.0, damping=0.7)._gains(motion)
    assert_allclose(k_p, w * w * np.array([2.0, 3.0]))
    assert_allclose(k_d, 2 * 0.7 * w * np.array([2.0, 3.0]))
    assert asked == [[0]]


def test_texts_as_latex_and_as_comments_of_structured_text() -> None:
    """Letters up to U+017F are kept; comments are not broken at hyphens, and end nowhere else."""
    assert escape_latex("\u017f\u0180\u00e9\u03b1 \u2013 a\n\tb") == "\u017f?\u00e9? -- a b"
    assert Name("m", ("link1", "2", "a_b")).latex() == r"m_{\mathrm{link1},2,\text{a\_b}}"
    words = "word-with-hyphens " * 12
    lines = text._comment(words + "(* x *) $ \u00e9", "  ").splitlines()
    assert (
        len(lines) == 3 and lines[0].startswith("  (* word") and lines[-1] == "     * x * ) S *)"
    )
    assert lines[1].startswith("     word") and lines[1].endswith("hyphens (")
    assert {part for line in lines[:-1] for part in line.split()} == {
        "(*",
        "word-with-hyphens",
        "(",
    }
    assert text._comment("short", "") == "(* short *)\n" and all(
        len(line) <= 115 for line in lines
    )


def test_the_force_that_the_filter_expects_is_small_for_small_robots() -> None:
    """50 N were 160 times the weight of a robot of 32 g, and its controller failed."""
    sizes = {"planar5_nmp": 50.0, "beam_arm": 8.0 + 0.8}
    for name, force in sizes.items():
        assert _Design(flexgen.read(name), 5e-4, 0.0, LQG()).tool_force == pytest.approx(
            force, rel=1e-12
        )


def test_state_feedback_has_gains_of_its_own_for_each_part_of_a_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """81 samples: 27 parts of 3, since at most 40; the poses of the parts have other masses, and
    so other gains.
    """

    class Poses:
        def __init__(self, model: Any) -> None:
            assert model.name == "drive"

        def at(self, points: list[np.ndarray]) -> Any:
            position = float(points[0][0, 0])
            factor = float(points[1][0])
            assert position == factor - 1.0 and [len(x) for x in points] == [1, 1]
            made = two_masses()
            made.B = made.B * factor
            return made

    model: Any = Made(
        name="drive", n_a=1, n_m=1, dof=2, sensors=(), motors=(Made(torque_max=3.0),)
    )
    asked: list[int] = []

    def parts(samples: int) -> list[np.ndarray]:
        asked.append(samples)
        return [np.arange(27.0)[:, None], 1.0 + np.arange(27.0)]

    reference = Made(time=np.arange(81.0), parts=parts)
    motion: Any = Made(
        model=model,
        reference=reference,
        sample_s=0.01,
        delay_s=0.004,
        exact_state=True,
        state_channel=1,
    )
    motion.link_channels = lambda law: None
    monkeypatch.setattr(state_lq, "PoseModels", Poses)
    bound = inspect.unwrap(LQ.bound)
    found = bound(LQ(rho=0.5), motion)
    assert asked == [3] and found.samples == 3
    assert len(found.matrices[0]) == 27
    for k in (0, 11, 26):
        at = two_masses()
        F, G = sample_model(at.A, (1.0 + k) * at.B, 0.01, 0.004)
        K = regulator(at, F, G, 0.5, np.array([3.0]))
        expected = LQ()._part(K, motion, None, 5)
        for x, y in zip(found.matrices, expected, strict=True):
            assert_allclose(x[k], y, rtol=1e-12)
    rigid: Any = Made(model=Made(name="drive", n_a=1, n_m=1, dof=1))
    with pytest.raises(ArgumentError) as caught:
        bound(LQ(), rigid)
    assert (
        str(caught.value)
        == "controller LQ: given the model drive with rigid gears, expected elastic ones"
    )
