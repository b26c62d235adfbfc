"""Modes, zeros, index: published numbers, closed forms, and two routes that share nothing."""

from __future__ import annotations

import numpy as np
import pytest

import flexgen
from flexgen.analysis.linear import linearize
from flexgen.analysis.zero_dynamics.zeros import inner_zeros, is_structured, transmission_zeros
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.dae.signature import structural_index
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.reader import model_names, read

POSE = (0.3, -1.1, 0.0)
PUBLISHED = 1e-3  # relative; the numbers are printed with four digits
HERTZ = 5e-3  # relative; the numbers are printed with three to four digits


def closest(found: np.ndarray, expected: complex) -> float:
    return float(np.abs(found - expected).min() / abs(expected))


@pytest.mark.parametrize(
    ("name", "zeros", "phase"),
    [
        ("planar5_mp", [-141.7 + 513.1j, -141.7 - 513.1j, -1000, -1000], "minimum phase"),
        ("planar5_nmp", [891.8, -471.4, -1000, -1000], "non-minimum phase"),
    ],
)
def test_zeros_and_verdict_of_the_planar_arm(name: str, zeros: list[complex], phase: str) -> None:
    analysis = flexgen.analyze(name, POSE)
    assert len(analysis.zeros.zeros) == len(zeros)
    for zero in zeros:
        assert closest(analysis.zeros.zeros, zero) < PUBLISHED
    assert analysis.zeros.phase == phase
    assert (analysis.zeros.preview_s > 0) == (phase == "non-minimum phase")
    if phase == "non-minimum phase":
        assert analysis.zeros.preview_s == pytest.approx(np.log(1e6) / 891.8, rel=PUBLISHED)


@pytest.mark.parametrize("name", ["planar5_mp", "planar5_nmp"])
def test_structural_index_of_the_planar_arm(name: str) -> None:
    assert flexgen.analyze(name, POSE).structural_index == 4
    assert flexgen.analyze(name + "@undamped", POSE).structural_index == 5


@pytest.mark.parametrize(
    ("variant", "poles_hz", "damping", "zeros_hz"),
    [
        ("high", [12.40, 19.12, 54.66], [0.039, 0.047, 0.118], [5.255, 15.38, 52.32]),
        ("low", [8.82, 14.44, 41.61], None, [2.912, 14.25, 41.63]),
    ],
)
def test_four_masses_as_published(
    variant: str, poles_hz: list[float], damping: list[float] | None, zeros_hz: list[float]
) -> None:
    analysis = flexgen.analyze(f"four_mass@{variant}")
    found = np.array(analysis.modes)
    assert np.abs(found[:, 0] / poles_hz - 1).max() < HERTZ
    if damping is not None:
        assert np.abs(found[:, 1] - damping).max() < 6e-4  # printed with three decimals
    assert analysis.zeros_motor is not None
    motor = np.abs(analysis.zeros_motor[analysis.zeros_motor.imag > 0]) / (2 * np.pi)
    assert np.abs(np.sort(motor) / zeros_hz - 1).max() < HERTZ
    assert analysis.zeros.phase == "minimum phase"
    real = [abs(z) / (2 * np.pi) for z in analysis.poles if abs(z.imag) < 1e-9 and abs(z) > 1e-3]
    assert min(real) == pytest.approx(0.03, rel=0.02)


def test_planar_zeros_in_closed_form() -> None:
    """I_eff s^2 + kappa D s + kappa K = 0 for a straight continuation of the passive link; no
    gravity.
    """
    for name, xi, j in (("planar5_mp", 0.12, 2.2), ("planar5_nmp", 0.225, 0.45)):
        model = read(name, overrides={"gravity": [0.0, 0.0, 0.0]})
        i_eff = j + 25 * xi**2 - 25 * xi * 0.45
        kappa = (0.35 + 0.45) / 0.35
        expected = np.roots([i_eff, kappa * 150.0, kappa * 1.5e5])
        zeros = flexgen.analyze(model, POSE).zeros.zeros
        for zero in expected:
            assert closest(zeros, zero) < 1e-10  # both are exact but for rounding


def state_space_difference(equations: Equations, planted: float = 1.0) -> float:
    """Variation of the equations at rest against the linearized, and the differenced, state-space
    right-hand side.
    """
    model = equations.model
    rest = hold_joints(equations, np.array(model.home))
    A, B = linearize(equations, rest).state_space()
    A = A * np.where(np.arange(len(A)) == len(A) - 1, planted, 1.0)[:, None]
    zero_a = np.zeros(model.n_a)
    zero_m = np.zeros(model.n_m)
    exact = evaluate(
        equations.function("linearize"), rest.q_a, zero_a, rest.q_m, zero_m, rest.tau_m
    )
    x = np.concatenate([rest.q_a, rest.q_m[list(model.i_m)], np.zeros(model.dof)])
    rate = equations.function("state_rate")
    step = 1e-6
    ends = [evaluate(rate, x + sign * step * np.eye(len(x)), rest.tau_m)[0] for sign in (1, -1)]
    differenced = (ends[0] - ends[1]).T / (2 * step)
    size = np.abs(exact[0][0]).max(axis=1, keepdims=True)
    B_size = np.abs(exact[1][0]).max() + 1e-300
    closed = max(
        np.abs((A - exact[0][0]) / size).max(),
        np.abs(B - exact[1][0].reshape(B.shape)).max() / B_size,
    )
    # differences over 1e-6 rad see the curvature of a spring that stiffens within 3e-4 rad: 1e-4
    # must do
    return float(max(closed, 1e-7 * np.abs((differenced - exact[0][0]) / size).max()))


@pytest.mark.parametrize("name", model_names())
def test_three_routes_to_the_linearization(name: str) -> None:
    equations = flexgen.derive(name)
    assert state_space_difference(equations) < 1e-11
    # planted bug in the last row
    assert state_space_difference(equations, planted=1.0 + 1e-6) > 1e-11


@pytest.mark.parametrize("name", model_names())
def test_two_routes_to_the_zeros(name: str) -> None:
    equations = flexgen.derive(name)
    model = equations.model
    assert is_structured(equations)
    rest = hold_joints(equations, np.array(model.home))
    linear = linearize(equations, rest)
    by_structure = inner_zeros(equations, linear, rest)
    A, B = linear.state_space()
    rate = np.sqrt(np.linalg.norm(np.linalg.solve(linear.M, linear.K)))
    by_reduction = transmission_zeros(A, B, np.hstack([linear.W, np.zeros_like(linear.W)]), rate)
    assert by_reduction is not None
    # zeros at infinity, of flat directions, are in neither
    assert len(by_structure) == len(by_reduction)
    for zero in by_structure:
        # the eigenvalues of a badly scaled pencil of 40 states
        assert closest(by_reduction, zero) < 1e-5, name


def test_planted_bug_in_the_pencil_is_caught() -> None:
    equations = flexgen.derive("planar5_nmp")
    rest = hold_joints(equations, np.array(POSE[:2]))
    linear = linearize(equations, rest)
    W = linear.W.copy()
    W[:, 2] *= -1  # the passive joint moves the tool the other way
    A, B = linear.state_space()
    wrong = transmission_zeros(A, B, np.hstack([W, np.zeros_like(W)]), 1e3)
    assert wrong is None or closest(wrong, 891.8) > PUBLISHED


@pytest.mark.parametrize(
    ("name", "phase", "index"),
    [
        ("elbow@rigid", "flat", 3),
        ("elbow", "minimum phase", 4),
        ("manutec_r3", "minimum phase", 4),
        ("manutec_r3_efjm", "non-minimum phase", 4),
        ("beam_arm", "non-minimum phase", 4),
    ],
)
def test_verdicts(name: str, phase: str, index: int) -> None:
    analysis = flexgen.analyze(name)
    assert (analysis.zeros.phase, analysis.structural_index) == (phase, index)


def test_no_verdict_without_as_many_outputs_as_motors() -> None:
    model = read("planar5_mp", overrides={"output.axes": "x"})
    analysis = flexgen.analyze(model)
    assert (analysis.zeros.phase, analysis.structural_index) == ("none", None)
    assert structural_index(flexgen.derive(model)).index is None


def test_an_undamped_flexible_joint_robot_is_flat() -> None:
    changes = {
        f"element.{e}.dof.{q}.gear.damping": 0.0 for e, q in (("upper", "q1"), ("fore", "q2"))
    }
    analysis = flexgen.analyze(read("elbow", overrides=changes))
    assert (analysis.zeros.phase, analysis.structural_index) == ("flat", 5)


def test_equilibrium_balances_gravity() -> None:
    analysis = flexgen.analyze("planar5_nmp", POSE)
    # by hand: 25 kg at 0.225 m, horizontal distance from joint 3 at the angle 0.3 - 1.1 + q3
    q3 = analysis.equilibrium.q_a[2]
    assert 1.5e5 * q3 == pytest.approx(-25 * 9.81 * 0.225 * np.cos(0.3 - 1.1 + q3), rel=1e-12)
    lever1 = 0.80 * np.cos(0.3)
    lever2 = 0.35 * np.cos(-0.8)
    moment2 = 40 * 0.17 * np.cos(-0.8) + 25 * (lever2 + 0.225 * np.cos(-0.8 + q3))
    moment1 = (
        60 * 0.40 * np.cos(0.3)
        + 40 * (lever1 + 0.17 * np.cos(-0.8))
        + 25 * (lever1 + lever2 + 0.225 * np.cos(-0.8 + q3))
    )
    assert np.allclose(
        analysis.equilibrium.tau_m * 100, np.array([moment1, moment2]) * 9.81, rtol=1e-12
    )


@pytest.mark.parametrize("pose", [(0.1,), (0.1, 0.2, 0.3, 0.4), (0.1, float("nan"), 0.0)])
def test_a_wrong_pose_is_refused(pose: tuple[float, ...]) -> None:
    with pytest.raises(ArgumentError, match="expected 3 finite numbers"):
        flexgen.analyze("planar5_mp", pose)
