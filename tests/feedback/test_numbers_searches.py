"""Searches and filters by other routes: programs, smoothers, loops that are shaped, experiments
that are simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import minimize

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.laws.loop_shaping import (
    LoopShaping,
    coprime_controller,
    linear_plant,
    pade,
    series,
)
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.time_domain import Simulated
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.planning.fastest import program_time
from flexgen.planning.fastest.program_time import ProgramSearch
from flexgen.planning.learning import smoother
from flexgen.planning.learning.smoother import PathSmoother


class Leg:
    """A motion whose two limits are reached by a short duration T and by a coefficient c off its
    best one.
    """

    def __init__(self, work: float, best: float) -> None:
        self.work = work
        self.best = best
        self.found = SimpleNamespace()
        self.lost = 0.0

    def try_constraints(self, x: np.ndarray) -> np.ndarray | None:
        if x[0] <= self.lost:
            return None
        self.found = SimpleNamespace(x=x.copy())
        return np.array([self.work * (1 + 2 * (x[1] - self.best) ** 2) / x[0] ** 2, -0.5 / x[0]])

    def differences(self, x: np.ndarray) -> Iterator[tuple[np.ndarray, float, np.ndarray | None]]:
        for k in range(2):
            h = 1e-6
            other = x + h * (np.arange(2) == k)
            yield other, h, self.try_constraints(other)


def search(
    monkeypatch: pytest.MonkeyPatch, heat: float, *legs: Leg
) -> tuple[ProgramSearch, list[str]]:
    """A search whose effective torques fall with the durations, as ``sqrt(mean of work / T^2)``
    over ``heat``.
    """
    made = object.__new__(ProgramSearch)
    lines = []
    vars(made).update(
        legs=list(legs), pauses=[0.25] * (len(legs) - 1), programs=0, tell=lines.append
    )

    def effective(x: list[np.ndarray], found: list[Any]) -> np.ndarray:
        assert all(np.array_equal(one.x, part) for one, part in zip(found, x, strict=True))
        whole = sum(
            leg.work * (1 + (part[1] - leg.best) ** 2) / part[0]
            for leg, part in zip(legs, x, strict=True)
        )
        return np.array([whole / made.duration(x) / heat, 0.2])

    monkeypatch.setattr(made, "_effective", effective)
    return made, lines


def test_effective_torques_connect_the_motions_of_a_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The durations are those of a nonlinear program by another solver; without the limit each
    motion is alone.
    """
    legs = Leg(1.0, 0.4), Leg(0.5, 0.7)
    made, lines = search(monkeypatch, 0.55, *legs)
    first = [np.array([1.0, 0.4]), np.array([np.sqrt(0.5), 0.7])]
    assert made.duration(first) == pytest.approx(1.25 + np.sqrt(0.5))
    state = made._state(first)
    assert state is not None and state.duration == pytest.approx(1.0 + np.sqrt(0.5))
    assert state.excess() == pytest.approx(state.c[0] - 1.0) and state.c[0] > 1.0
    calm = program_time._State(
        first, [np.array([0.3, -1.7]), np.array([0.1])], [], np.array([1.2])
    )
    assert calm.excess() == pytest.approx(0.7)
    x = made._connect(first)
    found = made._state(x)
    assert found is not None and found.excess() < 2e-3

    def all_of(z: np.ndarray) -> np.ndarray:
        state = made._state([z[:2], z[2:]])
        assert state is not None
        return np.concatenate([1 - state.c, *[1 - np.abs(g) for g in state.g]])

    best = minimize(
        lambda z: z[0] + z[2],
        np.array([1.5, 0.4, 1.2, 0.7]),
        constraints={"type": "ineq", "fun": all_of},
        tol=1e-9,
    )
    assert found.duration == pytest.approx(best.fun, rel=5e-3) and best.success
    assert_allclose([x[0][0], x[1][0]], best.x[[0, 2]], rtol=0.05)
    assert made.programs >= len(lines) > 1
    assert (
        lines[-1] == f"{made.duration(x):.4f} s, limits exceeded by {max(found.excess(), 0):.1e}"
    )
    easy, lines = search(monkeypatch, 100.0, *legs)
    assert easy._connect(first) is first and lines == [] and easy.programs == 0


def test_a_program_is_slowed_down_as_much_as_its_torques_need(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By bisection: the factor of all durations at which the effective torques are those that are
    allowed.
    """
    legs = Leg(1.0, 0.4), Leg(0.5, 0.7)
    made, _ = search(monkeypatch, 0.4, *legs)
    first = [np.array([1.0, 0.4]), np.array([np.sqrt(0.5), 0.7])]
    state = made._slow_enough(first)

    def torque(factor: float) -> float:
        other = made._state([program_time._slower(x, factor) for x in first])
        assert other is not None
        return float(other.c.max())

    factor = state.x[0][0] / first[0][0]
    assert (
        factor > 1.0
        and state.x[1][0] / first[1][0] == pytest.approx(factor)
        and state.x[1][1] == 0.7
    )
    assert state.c.max() <= 1.0 < torque(factor * (1 - 0.3 * factor / 2**program_time.BISECTIONS))
    for leg in legs:
        leg.lost = 1.2  # faster ones cannot be inverted
    lost = made._slow_enough(first)
    assert lost.x[1][0] > 1.2 and lost.c.max() <= 1.0
    hard, _ = search(monkeypatch, 1e-3, *(Leg(1.0, 0.4), Leg(0.5, 0.7)))
    with pytest.raises(
        SolverError,
        match=r"^fastest: the effective torques cannot be kept in this program at the speeds that",
    ):
        hard._slow_enough(first)
    for leg in legs:
        leg.lost = 1e9
    with pytest.raises(SolverError, match=r"2\d\.?\d* times slower it needs inf of one$"):
        made._slow_enough(first)
    assert made._state(first) is None


def test_slopes_of_a_program_are_derivatives(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a motion that cannot be inverted a little changed: none in its own limits."""
    legs = Leg(1.0, 0.4), Leg(0.5, 0.7)
    made, _ = search(monkeypatch, 0.5, *legs)
    x = [np.array([1.3, 0.5]), np.array([0.9, 0.6])]
    state = made._state(x)
    assert state is not None
    own, connecting = made._slopes(state)
    T, c = x[0]
    row = [-2 * (1 + 2 * (c - 0.4) ** 2) / T**3, 4 * (c - 0.4) / T**2]
    assert_allclose(own[0], [row, [0.5 / T**2, 0.0]], rtol=1e-4, atol=1e-6)
    whole = (1 + 0.01) / 1.3 + 0.5 * (1 + 0.01) / 0.9
    total = 1.3 + 0.9 + 0.25
    slope = (-(1 + 0.01) / 1.3**2 / total - whole / total**2) / 0.5, 2 * 0.1 / 1.3 / total / 0.5
    assert_allclose(connecting[0], [slope, [0.0, 0.0]], rtol=1e-4, atol=1e-6)
    assert connecting[1].shape == (2, 2) and own[1].shape == (2, 2)


# --- smoothers -----------------------------------------------------------------------------------
def test_gains_of_a_smoother_are_those_of_a_long_recursion() -> None:
    """Filter and smoother of the textbook, repeated until their gains change no more."""
    rng = np.random.default_rng(3)
    h = 0.01
    n = 4
    m = 2
    forces = 2
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([900.0, 400.0]), -np.diag([3.0, 2.0])]])
    B = np.vstack([np.zeros((2, 2)), [[5.0, 1.0], [0.5, 4.0]]])
    arm = np.vstack([np.zeros((2, 2)), np.eye(2)])
    C = rng.standard_normal((3, n))
    D = np.zeros((3, m))
    D_arm = np.zeros((3, forces))
    D[2] = [0.3, 0.1]
    D_arm[2] = [0.2, 0.4]
    at: Any = SimpleNamespace(A=A, B=B, arm=arm, C=C, D=D, D_arm=D_arm)
    motors = tuple(SimpleNamespace(torque_max=x) for x in (20.0, None))
    model: Any = SimpleNamespace(motors=motors, n_m=m)
    made = object.__new__(PathSmoother)
    force = np.array([2.0, 0.7])
    index = np.array([0, 2])
    vars(made).update(
        model=model,
        sample_s=h,
        _force=force,
        _torque=Noises(model, smoother.TORQUE_NOISE, smoother.DISTURBANCE_RATE),
        channels=SimpleNamespace(index=index, noise=np.array([1e-3, 2e-3])),
    )
    F, G, C_all, D_own, M, J = made._gains(at)
    largest = np.array([20.0, 20.0])
    size = n + m + forces
    whole = expm(h * np.block([[A, B, arm * force], [np.zeros((m + forces, size))]]))
    fade = np.exp(-h / 0.3)
    state = np.eye(size)
    state[:n] = whole[:n]
    state[:n, n : n + m] *= largest
    state[n + m :, n + m :] *= fade
    assert_allclose(F, state, rtol=1e-9, atol=1e-12)
    assert_allclose(G[:n], whole[:n, n : n + m], rtol=1e-9)
    assert not G[n:].any() and G.shape == (size, m)
    assert_allclose(C_all, np.hstack([C, D * largest, D_arm * force])[index])
    assert_allclose(D_own, D[index])
    Q = np.zeros((size, size))
    noisy = whole[:n, n : n + m] * largest * 1e-3
    Q[:n, :n] = noisy @ noisy.T
    Q[n:, n:] = np.diag([0.1**2 * h] * m + [1 - fade**2] * forces)
    R = np.diag([1e-6, 4e-6])
    P = np.eye(size)
    for _ in range(20000):
        gain = P @ C_all.T @ np.linalg.inv(C_all @ P @ C_all.T + R)
        after = (np.eye(size) - gain @ C_all) @ P
        P = F @ after @ F.T + Q
        P = (P + P.T) / 2
    assert_allclose(M, gain, rtol=1e-5, atol=1e-8 * np.abs(gain).max())
    back = after @ F.T @ np.linalg.inv(P)
    assert_allclose(J, back, rtol=1e-4, atol=1e-6 * np.abs(back).max())


def test_forces_that_a_smoother_expects_are_shares_of_their_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fifth of the change of springs, a fiftieth of other coordinates; no coordinate feels
    none.
    """
    tau = np.array([[1.0, 5.0, 0.0], [3.0, 5.0, 0.0], [-2.0, 5.5, 0.0]])
    monkeypatch.setattr(
        smoother,
        "library_with",
        lambda model, names: SimpleNamespace(inverse_dynamics=lambda *motion: tau),
    )
    monkeypatch.setattr(smoother, "elastic_gears", lambda model: [0, 2])
    made: Any = object.__new__(PathSmoother)
    made.model = SimpleNamespace(n_a=3)
    found = made._forces(SimpleNamespace(motion={"q_a": 0, "v_a": 0, "a_a": 0}))
    assert_allclose(found, [0.02 * 3.0, 0.2 * 0.5, 0.02 * 3e-3, 0.2 * 3.0, 0.2 * 3e-3])
    tau = 0 * tau
    assert_allclose(
        made._forces(SimpleNamespace(motion={"q_a": 0, "v_a": 0, "a_a": 0}))[1], 0.2 * 1e-6
    )


# --- loops that are shaped -----------------------------------------------------------------------
def at_rest() -> tuple[flexgen.RobotModel, list[np.ndarray]]:
    """The robot elbow at its home pose, under the torques that hold it there."""
    equations = derive("elbow")
    model = equations.model
    held = hold_joints(equations, np.array(model.home), None)
    zero = np.zeros((1, model.n_a))
    none = np.zeros((1, model.n_m))
    return model, [held.q_a[None], zero, zero, held.q_m[None], none, none, held.tau_m[None]]


def test_a_shaped_loop_is_the_continuous_one_by_the_bilinear_rule() -> None:
    """Frequency responses at ``s = 2/T (z - 1)/(z + 1)``; the margin is that of the perturbation
    of the plant.
    """
    model, motion = at_rest()
    law = LoopShaping(2.0, integral_hz=0.2)
    h = 1e-3
    made, margin = law.design(model, h, 2e-3, motion)
    A, B, C, D = (x[0] for x in made.matrices)
    assert 0.2 < margin < 1.0
    shape = law._shape(motor_inertias(model, motion)[0])
    plant = series(series(shape, pade(2e-3 + h / 2, model.n_m)), linear_plant(model, motion))
    central, gamma = coprime_controller(plant, law.factor)
    assert margin == pytest.approx(1 / gamma)
    whole = series(central, shape)
    for hz in (0.3, 2.0, 20.0):
        z = np.exp(2j * np.pi * hz * h)
        s = 2 / h * (z - 1) / (z + 1)
        sampled = C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D
        exact = (
            whole[2] @ np.linalg.solve(s * np.eye(len(whole[0])) - whole[0], whole[1]) + whole[3]
        )
        assert_allclose(sampled, exact, rtol=1e-6, atol=1e-9 * np.abs(exact).max())
    two = [np.vstack([x, x + 1.0]) for x in motion]
    of_path = law.linear(model, h, 2e-3, two)
    for one, other in zip(of_path.matrices, made.matrices, strict=True):
        assert_allclose(one, other)
    assert LoopAtPose(PoseModels(model).at(motion), of_path, h, 2e-3).largest_eigenvalue() < 1.0
    slow = LoopShaping(2.0, integral_hz=0.2, model=model).linear(model, h, 2e-3, motion)
    assert_allclose(slow.matrices[0][0], A)


def test_a_shaped_loop_that_is_unstable_names_a_frequency_that_is_stable() -> None:
    model, motion = at_rest()
    with pytest.raises(ArgumentError) as caught:
        LoopShaping(12.0).linear(model, 5e-3, 2e-2, motion)
    text = str(caught.value)
    assert text.startswith(
        "controller LoopShaping, crossover_hz: given 12 Hz, with which the sampled loop is "
        "unstable"
    )
    assert "at 5 ms and a delay of 20 ms (largest eigenvalue " in text
    named = float(
        text.partition("a lower one, such as ")[2].partition(" Hz, or a shorter sample time")[0]
    )
    assert named < 12.0
    LoopShaping(named).linear(model, 5e-3, 2e-2, motion)


# --- experiments that are simulated --------------------------------------------------------------
def experiment_of(hardware: DriveHardware) -> tuple[Simulated, np.ndarray]:
    """An experiment with a robot whose first spring differs, and its parameters."""
    given = {"poses": [[0.5, -0.3]], "period_s": 0.5, "lines": 6, "periods": 2, "transients": 3}
    plan = flexgen.excite("elbow", **given, hardware=hardware, progress=False)
    model = flexgen.read("elbow")
    stiffness = model.coordinates[model.i_g[0]].dof.gear.spring.stiffness
    robot = flexgen.read(
        "elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 0.8 * stiffness}
    )
    experiment = flexgen.measure(plan, robot, progress=False)
    vector = ParameterVector(model, ["q1.stiffness", "q2.damping"], controller=plan.controller)
    return Simulated(vector, experiment, [(0, 0, 0)]), vector.start + np.array([np.log(0.8), 0.0])


@pytest.fixture(scope="module")
def quiet() -> tuple[Simulated, np.ndarray]:
    return experiment_of(DriveHardware(1e-3))


def test_the_simulated_experiment_is_the_one_that_was_measured(
    quiet: tuple[Simulated, np.ndarray],
) -> None:
    made, x = quiet
    found = made.spectra(x)
    assert found.shape == made.measured.shape == (1, 6, 2) and made.count == 12
    size = np.linalg.norm(found)
    assert np.linalg.norm(found - made.measured) < 1e-3 * size < 0.02 * size
    assert np.linalg.norm(made.spectra(x + np.array([0.1, 0.0])) - found) > 0.02 * size
    assert_allclose(made.residual(x) * made.sd, found - made.measured, rtol=1e-6, atol=1e-9 * size)
    assert made.cost(x) == pytest.approx(float((np.abs(made.residual(x)) ** 2).sum()))
    simulations = made.simulations
    made.use_noise(x)  # there is none
    assert made.simulations == simulations and not made.shift.any()


def test_derivatives_of_an_experiment_are_those_of_whole_simulations(
    quiet: tuple[Simulated, np.ndarray],
) -> None:
    """Also where their simulations begin late; they are used again where x and the cost are
    near.
    """
    made, x = quiet
    x = x + np.array([0.05, 0.1])
    cost, gradient, A = made.sums(x)
    r = made.residual(x).ravel()
    assert cost == pytest.approx(float((np.abs(r) ** 2).sum()))
    h = 1e-3
    columns = [
        (made.residual(x + z) - made.residual(x - z)).ravel() / (2 * h) for z in h * np.eye(2)
    ]
    J = np.stack(columns, axis=1)
    assert_allclose(A, np.real(J.conj().T @ J), rtol=2e-2)
    assert_allclose(gradient, np.real(J.conj().T @ r), rtol=2e-2)
    before = made.simulations
    near = made.sums(x + np.array([0.005, 0.0]))
    assert made.simulations == before + 1
    assert_allclose(near[2], A)
    made.use_whole()
    whole = made.sums(x)
    assert made.simulations == before + 4 and made.whole
    assert_allclose(whole[2], np.real(J.conj().T @ J), rtol=1e-2)
    far = made.sums(x + np.array([0.2, 0.0]))
    assert made.simulations == before + 7 and np.abs(far[2] / A - 1).max() > 1e-3


def test_noise_changes_the_mean_of_the_spectra_and_their_deviation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time_domain, "SEEDS", 3)
    made, x = experiment_of(DriveHardware(1e-3, encoder_noise_rad=2e-4))
    told: list[str] = []
    made.progress = told.append
    sd = made.sd.copy()
    made.use_noise(x)
    assert told == ["change of the motion by noise: 3 simulations"]
    assert_allclose(made.sd, sd * np.sqrt(1 + 2 / 3))
    noisy = [made.spectra(x, noise=time_domain.SEED + k) for k in range(3)]
    assert_allclose(made.shift, np.mean(noisy, axis=0) - made.spectra(x), rtol=1e-6, atol=1e-12)
    assert np.abs(noisy[0] - noisy[1]).max() > 0
    made.sums(x)
    assert (
        told[-1].startswith("simulation ")
        and told[-1].endswith(" s of robot in the plan")
        and len(told) == 3
    )
