"""Numbers of flexgen/feedback/laws: exact solutions of sampled chains, Riccati equations, transfer
functions.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm, solve_discrete_are

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.spec.parts import Friction
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.laws import (
    bound,
    chain,
    linearising,
    loop_shaping,
    motor_laws,
    stability,
    study,
)
from flexgen.feedback.laws.linearising import (
    ComputedTorque,
    FeedbackLinearisation,
    check_frequency,
)
from flexgen.feedback.laws.lq import LQG, regulator, torque_scale
from flexgen.feedback.laws.state_lq import LQ
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.interface import Measurement, Reference
from flexgen.feedback.loop.law_motion import LawMotion
from flexgen.feedback.loop.sampled_model import PoseModel, PoseModels
from flexgen.feedback.loop.timing import Timing
from flexgen.feedback.sampled_plant import sample_model
from flexgen.simulation.environment.disturbances import Disturbance

H = 0.01


def test_gains_of_a_chain_place_its_poles() -> None:
    w = 2 * np.pi * 1.5
    assert_allclose(chain.chain_gains(1.5, 3, "continuous", H), [w**3, 3 * w**2, 3 * w])
    gains = chain.chain_gains(1.5, 3, "discrete", H)
    A = np.eye(3) + np.diag([H, H], 1) + np.diag([H**2 / 2], 2)
    B = np.array([H**3 / 6, H**2 / 2, H])
    poles = np.linalg.eigvals(A - np.outer(B, gains))
    assert_allclose(np.poly(poles), np.poly([math.exp(-w * H)] * 3), atol=1e-9)


@pytest.mark.parametrize("predicted", [False, True])
@pytest.mark.parametrize("differences", [False, True])
@pytest.mark.parametrize("delay", [0.0, 0.004, 0.01, 0.014])
def test_the_matrix_of_a_sampled_chain_is_its_simulation(
    delay: float, predicted: bool, differences: bool
) -> None:
    """Ten samples of a chain of three integrators under late held inputs, by its exact
    solution.
    """
    gains = np.array([200.0, 90.0, 15.0])
    timing = Timing(H, delay, predicted, differences)

    def move(x: np.ndarray, s: float, h: float) -> np.ndarray:
        A = expm(np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0.0]]) * h)
        return A[:3, :3] @ x + A[:3, 3] * s

    loop = chain.chain_loop(gains, timing)
    whole = timing.whole
    assert loop.shape == (6 + whole + 2,) * 2
    x = np.array([1.0, -2.0, 3.0])
    last = np.array([0.9, -1.0, 2.0])
    inputs = [0.5, -0.7, 0.3][: whole + 2]
    z = np.r_[x, last, inputs]
    for _ in range(10):
        seen = x.copy()
        if differences:
            seen[1] = (x[0] - last[0]) / H
        ahead = seen
        for age, duration in timing.segments():
            ahead = move(ahead, inputs[age - 1], duration)
        new = -gains @ ahead
        if predicted:
            new = -gains @ move(ahead, new, H / 2)
        all_inputs = [new, *inputs]
        moved = move(x, all_inputs[whole + 1], timing.rest_s) if timing.rest_s else x
        moved = move(moved, all_inputs[whole], H - timing.rest_s)
        last = x
        x = moved
        inputs = all_inputs[: whole + 2]
        z = loop @ z
        assert_allclose(z, np.r_[x, last, inputs], rtol=1e-9)


def test_the_spectral_radius_of_a_chain_and_its_largest_frequency() -> None:
    timing = Timing(H, 0.004)
    gains = chain.chain_gains(2.0, 2, "continuous", H)
    radius = np.abs(np.linalg.eigvals(chain.chain_loop(gains, timing))).max()
    assert chain.largest_eigenvalue(gains, timing) == pytest.approx(radius, rel=1e-9)
    # stated at the top of the module
    for n, delay, bound_wh in ((4, 0.0, 0.5111), (4, H, 0.1979)):
        found = chain.largest_frequency(n, "continuous", Timing(H, delay))
        assert 2 * np.pi * found * H == pytest.approx(bound_wh, abs=1e-4)
    largest = chain.largest_frequency(2, "continuous", timing)
    assert_array_equal(
        chain.stable_gains(0.99 * largest, 2, "continuous", timing),
        chain.chain_gains(0.99 * largest, 2, "continuous", H),
    )
    text = (
        r"given .* Hz, with which a chain of 2 integrators is unstable at 10 ms and a delay of "
        r"4 ms \(largest"
    )
    with pytest.raises(ArgumentError, match=text):
        chain.stable_gains(1.01 * largest, 2, "continuous", timing)
    with pytest.raises(ArgumentError, match="4 ms, speeds by differences"):
        chain.stable_gains(2 * largest, 2, "continuous", replace(timing, differences=True))
    assert len(chain.stable_gains(2 * largest, 2, "continuous", timing, True)) == 2


def transfer(system: tuple, s: complex) -> np.ndarray:
    A, B, C, D = system
    return D + C @ np.linalg.solve(s * np.eye(len(A)) - A, B) if len(A) else D


def test_parts_of_loop_shaping_are_their_transfer_functions() -> None:
    s = 2.0 + 3.0j
    delay = loop_shaping.pade(0.1, 2)
    assert_allclose(
        transfer(delay, s),
        (12 - 6 * 0.1 * s + (0.1 * s) ** 2) / (12 + 6 * 0.1 * s + (0.1 * s) ** 2) * np.eye(2),
    )
    assert_allclose(transfer(loop_shaping.pade(0.0, 2), s), np.eye(2))
    chance = np.random.default_rng(1)
    first = tuple(chance.normal(size=x) for x in ((2, 2), (2, 3), (1, 2), (1, 3)))
    second = tuple(chance.normal(size=x) for x in ((3, 3), (3, 1), (2, 3), (2, 1)))
    assert_allclose(
        transfer(loop_shaping.series(first, second), s), transfer(second, s) @ transfer(first, s)
    )
    law = loop_shaping.LoopShaping(2.0, 0.3, 50.0)
    w_c, w_i, w_l = 2 * np.pi * np.array([2.0, 0.3, 50.0])
    shape = w_c**2 * (s + w_i) / s * w_l**2 / (s**2 + np.sqrt(2) * w_l * s + w_l**2)
    assert_allclose(
        transfer(law._shape(np.array([0.5, 3.0])), s), shape * np.diag([0.5, 3.0]), rtol=1e-9
    )
    for name, value in (
        ("crossover_hz", 0.0),
        ("low_pass_hz", 1.1e5),
        ("integral_hz", -1.0),
        ("factor", 1.0),
    ):
        with pytest.raises(ArgumentError, match=name):
            loop_shaping.LoopShaping(**{name: value})


def test_a_coprime_controller_of_an_integrator() -> None:
    """1/s: X = Z = 1, gamma_min^2 = 2; the loop is stable and bears the perturbation 1/gamma."""
    one = np.ones((1, 1))
    plant = (np.zeros((1, 1)), one, one, np.zeros((1, 1)))
    (A, B, C, D), gamma = loop_shaping.coprime_controller(plant, 1.1)
    assert gamma == pytest.approx(1.1 * np.sqrt(2))
    loop = np.block([[np.zeros((1, 1)), C], [-B, A]])
    assert np.linalg.eigvals(loop).real.max() < 0 and not D.any()
    L = 1 - gamma**2 + 1
    assert_allclose([A[0, 0], B[0, 0], C[0, 0]], [-1 + gamma**2 / L, gamma**2 / L, -1.0])
    with pytest.raises(
        SolverError,
        match="H-infinity controller: the Riccati equations have no solution at the pose",
    ):
        loop_shaping.coprime_controller((np.eye(1), 0 * one, 0 * one, 0 * one), 1.1)


def test_a_lower_frequency_is_named_where_the_loop_is_unstable() -> None:
    law = loop_shaping.LoopShaping(10.0)
    asked: list[float] = []

    def attempt(of: loop_shaping.LoopShaping) -> tuple[None, float]:
        asked.append(of.crossover_hz)
        if len(asked) == 2:
            raise SolverError("x")
        return None, 0.9 if of.crossover_hz < 4.5 else 1.0

    assert law._find_stable(attempt) == "a lower one, such as 4.1 Hz, or a shorter sample time"
    assert asked == [8.0, 6.4, 5.1, 4.1]
    asked.clear()
    assert (
        law._find_stable(lambda of: (None, 1.0))
        == "a shorter sample time or delay, or another low_pass_hz"
    )


def pose(n: int = 2, n_m: int = 1, n_y: int = 2) -> PoseModel:
    chance = np.random.default_rng(4)
    K = 30 * np.eye(n)
    D = 0.5 * np.eye(n)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -D]])
    B = np.vstack([np.zeros((n, n_m)), chance.normal(size=(n, n_m))])
    push = np.vstack([np.zeros((n, 3)), chance.normal(size=(n, 3))])
    arm = np.zeros((2 * n, 1))
    C = np.hstack([chance.normal(size=(n_y, n)), np.zeros((n_y, n))])
    return PoseModel(
        A, B, push, arm, C, np.zeros((n_y, n_m)), np.zeros((n_y, 1)), chance.normal(size=(1, n))
    )


def test_the_regulator_minimizes_the_cost_of_the_module() -> None:
    at = pose()
    u_max = np.array([4.0])
    F, G = sample_model(at.A, at.B, H, 0.6 * H)
    Q = np.zeros((5, 5))
    Q[:2, :2] = at.W.T @ at.W / 1e-6
    Q[2:4, 2:4] = at.W.T @ at.W / 1e-6 * 1e-4
    Q += 1e-12 * np.trace(Q) / 5 * np.eye(5)
    R = 3.0 / 16 * np.eye(1)
    P = solve_discrete_are(F, G, Q, R)
    assert_allclose(
        regulator(at, F, G, 3.0, u_max), np.linalg.solve(R + G.T @ P @ G, G.T @ P @ F), rtol=1e-9
    )
    motors = [SimpleNamespace(torque_max=x) for x in (3.0, None, 7.0)]
    assert torque_scale(SimpleNamespace(motors=motors)).tolist() == [3, 7, 7]
    assert torque_scale(SimpleNamespace(motors=motors[1:2])).tolist() == [1.0]


def at_rest(model: object) -> list[np.ndarray]:
    q = np.full(model.n_a, 0.3)
    zero_a = np.zeros((1, model.n_a))
    zero_m = np.zeros((1, model.n_m))
    return [q[None], zero_a, zero_a, (model.eta @ q)[None], zero_m, zero_m, zero_m]


@pytest.mark.parametrize("delay", [0.0, 1.4e-3])
def test_lqg_is_a_stationary_filter_and_the_regulator_on_its_estimate(delay: float) -> None:
    """The filter's gain from SciPy's Riccati solver on noises written out; one step of the
    controller by hand.
    """
    model = channels_of(flexgen.read("elbow"), "tool_accelerometer").model
    options = LQG(7.0, 2e-4, True, 0.03, 0.5)
    made = options.linear(model, 1e-3, delay, at_rest(model))
    at = PoseModels(model).at(at_rest(model))
    F, G = sample_model(at.A, at.B, 1e-3, delay)
    n = 8
    size = len(F)
    u_max = torque_scale(model)
    gain = regulator(at, F, G, 7.0, u_max)

    def held(B: np.ndarray) -> np.ndarray:
        whole = expm(np.block([[at.A, B], [np.zeros((B.shape[1], n + B.shape[1]))]]) * 1e-3)
        return whole[:n, n:]

    full = np.block([[F, np.zeros((size, 2))], [np.zeros((2, size)), np.eye(2)]])
    full[:n, size:] = held(at.B)
    Q = 1e-18 * np.eye(size + 2)
    Q[:n, :n] += (
        held(at.B) @ np.diag((0.03 * u_max) ** 2) @ held(at.B).T
        + 2500 * held(at.push) @ held(at.push).T
    )
    Q[size:, size:] += np.diag((0.5 * u_max) ** 2 * 1e-3)
    C = np.hstack([at.C, np.zeros((5, size + 2 - n))])
    R = np.diag(np.r_[[2e-4] * 2, [10 * model.sensors[0].noise] * 3] ** 2)
    P = solve_discrete_are(full.T, C.T, Q, R)
    M = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    z, e = np.random.default_rng(2).normal(size=(2, max(size + 2, 5)))
    z = z[: size + 2]
    y = -e[:5]
    estimate = z + M @ (y - C @ z)
    u = -np.hstack([gain, np.eye(2)]) @ estimate
    A, B, C_, D = (x[0] for x in made.matrices)
    scale = np.abs(u).max()
    assert_allclose(C_ @ z + D @ -y, u, atol=1e-5 * scale)
    after = full @ estimate + np.vstack([G, np.zeros((2, 2))]) @ u
    assert_allclose(A @ z + B @ -y, after, atol=1e-5 * np.abs(after).max())
    unused = replace(options, sensors=False).linear(model, 1e-3, delay, at_rest(model))
    assert np.abs(unused.matrices[3][0][:, 2:]).max() < 1e-6 * np.abs(D[:, 2:]).max()
    assert options.title == "lqg" and LQG().rho == 100.0
    for name in ("rho", "encoder_noise", "torque_noise", "disturbance_rate"):
        with pytest.raises(ArgumentError, match=f"controller, {name}"):
            LQG(**{name: 0.0})


@pytest.mark.parametrize("differences", [False, True])
def test_the_eigenvalue_of_a_feedback_of_angles_and_speeds(differences: bool) -> None:
    at = pose()
    K = np.array([[3.0, 1.0]])
    D = np.array([[0.4, -0.2]])
    F, G = sample_model(at.A, at.B, H, 0.6 * H)
    found = stability.pose_eigenvalue(at, K, D, H, 0.6 * H, differences)
    z = np.random.default_rng(5).normal(size=7)  # state, torque under way, last angles
    sizes = []
    for _ in range(1500):
        speed = (z[:2] - z[5:]) / H if differences else z[2:4]
        u = -(K @ z[:2] + D @ speed)
        z = np.r_[F @ z[:5] + G @ u, z[:2]]
        sizes.append(np.linalg.norm(z))
        z = z / sizes[-1]
    assert np.exp(np.mean(np.log(sizes[500:]))) == pytest.approx(found, rel=5e-3)


def motion_of(model: object, exact: bool = True, **more: object) -> SimpleNamespace:
    """A motion at rest with the functions that laws read."""
    reference = SimpleNamespace(
        time=np.array([0.0, 0.5, 1.0]),
        begin=0.0,
        end=1.0,
        points=lambda k: tuple(np.repeat(x, len(k), 0) for x in at_rest(model)),
        motion={"q_a": np.repeat(at_rest(model)[0], 3, 0)},
        held=np.ones((3, model.n_m)),
    )
    return SimpleNamespace(
        model=model,
        reference=reference,
        sample_s=1e-3,
        delay_s=0.0,
        exact_state=exact,
        equations=derive(model),
        **more,
    )


def test_an_unstable_pose_is_named() -> None:
    model = flexgen.read("elbow")
    motion = motion_of(model)
    none = np.zeros((2, 4))
    k = np.hstack([np.zeros((2, 2)), np.eye(2)])
    J = np.diag(motor_laws.motor_inertias(model, at_rest(model))[0])
    w = 2 * np.pi * 3
    stability.check_pose_loop(motion, lambda q: (w**2 * J @ k, 2 * w * J @ k), "x: given 1")
    text = (
        r"controller, x: given 1, with which the loop is unstable at the pose 1 s after the "
        r"begin of the motion, at 1"
    )
    with pytest.raises(ArgumentError, match=text):
        stability.check_pose_loop(motion, lambda q: (-50 * k, none), "x: given 1")


def test_gains_of_tomei_and_of_joint_torque_feedback() -> None:
    model = flexgen.read("elbow")
    motion = motion_of(model)
    J = motor_laws.motor_inertias(model, at_rest(model))[0]
    w = 2 * np.pi * 3.0
    k_p, k_d = motor_laws.TomeiPD(3.0, 0.7)._gains(motion)
    assert_allclose(k_p, w**2 * J)
    assert_allclose(k_d, 1.4 * w * J)
    own = motor_laws.TomeiPD(k_p=(1.0, 2.0), k_d=(3.0, 4.0))._gains(motion)
    assert_array_equal(own, [[1, 2], [3, 4]])
    motor_laws._check_gravity(motion, np.array([1e3, 1e3]))
    with pytest.raises(
        ArgumentError,
        match=r"controller TomeiPD: given k_p = \[1\.e-09 1\.e-09\], with which the smallest",
    ):
        motor_laws._check_gravity(motion, np.array([1e-9, 1e-9]))
    K = np.array([2e4, 1e4])
    gains = motor_laws.JointTorqueFeedback(2.0)._gains(motion, K)
    ratio = np.diag(model.eta)
    M = np.diag(np.array(motion.equations.function("mass_matrix")(at_rest(model)[0][0])))
    rotor = np.array([m.inertia for m in model.motors]) * ratio**2
    w = 2 * np.pi * 2.0
    for j in range(2):  # the polynomial of the comment, arm side
        p, d, t, s = gains[:, j] * [ratio[j] ** 2, ratio[j] ** 2, 1, 1]
        J_ = rotor[j]
        M_ = M[j]
        K_ = K[j]
        found = [J_ * M_ / K_, d * M_ / K_ + s * M_, J_ + M_ + p * M_ / K_ + t * M_, d, p]
        assert_allclose(found, J_ * M_ / K_ * np.poly([-w] * 4), rtol=1e-9)
    given = motor_laws.JointTorqueFeedback(k_p=(1, 2), k_d=(3, 4), k_t=(-5, 6), k_s=(7, 8))
    assert_array_equal(given._gains(motion, K), [[1, 2], [3, 4], [-5, 6], [7, 8]])
    assert (given.title, motor_laws.JointTorqueFeedback(2.5).title) == (
        "joint torque feedback",
        "joint torque feedback, 2.5 Hz",
    )
    assert (motor_laws.TomeiPD(3.0).title, motor_laws.TomeiPD(k_p=(1,), k_d=(2,)).title) == (
        "Tomei PD, 3 Hz",
        "Tomei PD",
    )
    for law, given, text in (
        (motor_laws.TomeiPD, {"k_p": (1.0, 2.0)}, "given one of them, expected both or none"),
        (
            motor_laws.TomeiPD,
            {"k_p": (1.0, 0.0), "k_d": (1, 1)},
            r"k_p: given .*, expected numbers > 0, one for each",
        ),
        (motor_laws.TomeiPD, {"damping": 0.0}, "controller, damping: given 0.0"),
        (
            motor_laws.JointTorqueFeedback,
            {"k_p": (1.0,), "k_d": (1.0,)},
            "expected all four or none",
        ),
        (
            motor_laws.JointTorqueFeedback,
            {"k_t": (np.inf,)},
            "k_t: given .*, expected finite numbers, one for each motor",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            law(**given)
    with pytest.raises(
        ArgumentError, match=r"k_p: given \(1\.0,\), expected 2 numbers > 0, one for each motor"
    ):
        motor_laws.TomeiPD(k_p=(1.0,), k_d=(1.0,))._gains(motion)
    coupled = replace(
        model,
        motors=tuple(
            replace(m, drives=("q1", "q2"), ratio=(90.0, r))
            for m, r in zip(model.motors, (80.0, -80.0), strict=True)
        ),
    )
    with pytest.raises(
        ArgumentError,
        match="with motors that drive several joints, expected the gains k_p, k_d, k_t, k_s",
    ):
        motor_laws.JointTorqueFeedback(2.0)._gains(replace_model(motion, coupled), K)


def replace_model(motion: SimpleNamespace, model: object) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(motion), "model": model})


@pytest.mark.parametrize(
    ("exact", "delay"), [(True, 0.0), (True, 2e-3), (False, 0.0), (False, 2e-3)]
)
def test_matrices_of_state_feedback_are_the_feedback_of_the_state(
    exact: bool, delay: float
) -> None:
    """Three samples of u = -K (x, torques under way) on random deviations."""
    model = flexgen.read("elbow")
    late = round(delay / 1e-3)
    chance = np.random.default_rng(6)
    K = chance.normal(size=(2, 8 + 2 * late))
    h = 1e-3
    n_y = 2 + 2 + (8 if exact else 0)
    motion = SimpleNamespace(
        model=model, sample_s=h, exact_state=exact, state_channel=4 if exact else -1
    )
    A, B, C, D = LQ(1.0)._part(K, motion, None if exact else np.array([3, 2]), n_y)
    z = np.zeros(len(A))
    under_way = np.zeros((late, 2))
    last = np.zeros(4)
    for _ in range(4):
        y = chance.normal(size=n_y)
        if exact:
            angles = np.r_[y[4:6], y[8:10]]
            speeds = np.r_[y[6:8], y[10:12]]
        else:
            angles = np.r_[y[[3, 2]], y[:2]]
            speeds = (angles - last) / h
            last = angles
        u = -K @ np.r_[angles, speeds, under_way.ravel()]
        e = -y
        assert_allclose(C @ z + D @ e, u, rtol=1e-9)
        z = A @ z + B @ e
        under_way = np.vstack([under_way[1:], u]) if late else under_way
    with pytest.raises(ArgumentError, match="rho: given 0, expected a number > 0"):
        LQ(0)
    assert LQ(2e-3).title == "LQ, rho 0.002"


class Functions(dict):
    """A library of a linear robot: accelerations ``a = M^-1 (...)`` written out."""

    def __init__(self) -> None:
        self.M = np.array([[2.0, 0.3], [0.3, 1.0]])
        self.K = np.diag([50.0, 80.0])
        rows = {
            "forward_dynamics": lambda q, v, p, w, u: (self.rest(q, p) - 0.1 * v, 3.0 * u - p),
            "flexible_joint_motion": lambda q, v, p, w: (self.rest(q, p), self.rest(v, w)),
            "flexible_joint_torque": lambda q, v, a, j, s, p, w: (
                2 * s + a - 0.5 * j + q - v + p - w,
            ),
            "inversion_rows": lambda q, v, a: (a @ self.M + q, v),
            "motor_friction": lambda w: 0.7 * w,
            "gear_law": lambda d: (d @ self.K, np.diag(self.K) + 0 * d),
        }
        super().__init__(rows)

    def rest(self, q: np.ndarray, p: np.ndarray) -> np.ndarray:
        return (p - q) @ self.K


def law(
    name: str, gains: np.ndarray, table: np.ndarray, uses: tuple, timing: Timing, **more: object
) -> bound.BoundLaw:
    made = {"cogging": None, "torque_ripple": None, "lugre": None, "friction": Friction()}
    motors = [SimpleNamespace(inertia=x, **made) for x in (0.1, 0.2)]
    model = SimpleNamespace(
        n_m=2, eta=np.array([[10.0, 2.0], [0.0, -20.0]]), motors=motors, coordinates=()
    )
    fields = {
        "state": -1,
        "channels": np.array([3, 2]),
        "start": np.array([0.5, -0.5]),
        "steps_per_s": 900.0,
    } | more
    return bound.BoundLaw(
        name, model, SimpleNamespace(functions=Functions()), uses, timing, table, gains, **fields
    )


def steps_of(made: bound.BoundLaw, count: int = 3) -> tuple[np.ndarray, list[np.ndarray]]:
    chance = np.random.default_rng(8)
    y = chance.normal(size=(count, 4))
    none = np.zeros(0)
    made.reset()
    planned = Reference(none, none, none, none, none, none)
    return y, [made.step(k, Measurement(y[k, :2], y[k, 2:]), planned) for k in range(count)]


@pytest.mark.parametrize(
    ("delay", "parts"),
    [
        (0.0, []),
        (1e-3, [(1, 1e-3, 10)]),
        (0.45e-3, [(1, 0.45e-3, 5)]),
        (2.4e-3, [(3, 0.4e-3, 4), (2, 1e-3, 10), (1, 1e-3, 10)]),
    ],
    ids=range(4),
)
def test_a_prediction_has_steps_for_each_torque_under_way(
    delay: float, parts: list[tuple[int, float, int]]
) -> None:
    """The oldest torque first; then half a sample, in which the new one acts. At 10,000 steps in a
    second.
    """
    none = np.zeros((2, 2))
    made = law("joint_torque", none, none, (), Timing(1e-3, delay, True), steps_per_s=9999.0)
    found, half = made._segments()
    assert [(age, steps) for age, _, steps in found] == [
        (age, steps) for age, _, steps in parts
    ] and half == 5
    assert_allclose([duration for _, duration, _ in found], [duration for _, duration, _ in parts])
    assert made._delayed == max((age for age, *_ in parts), default=0)
    slow = law("joint_torque", none, none, (), Timing(1e-3, delay, True), steps_per_s=1.0)
    assert [steps for *_, steps in slow._segments()[0]] == [1] * len(parts) and slow._segments()[
        1
    ] == 1
    assert law("joint_torque", none, none, (), Timing(1e-3, delay))._segments() == ([], 0)


def test_steps_of_computed_torque_and_joint_torque_by_hand() -> None:
    chance = np.random.default_rng(9)
    functions = Functions()
    eta = np.array([[10.0, 2.0], [0.0, -20.0]])
    back = np.linalg.inv(eta)
    g = np.array([[4.0, 4.0], [3.0, 2.0], [0.2, 0.3], [0.05, 0.04]])
    table = chance.normal(size=(2, 6))
    made = law("computed_torque", g, table, ("rows", "friction"), Timing(H))
    y, found = steps_of(made)
    for k in range(3):
        d = table[min(k, 1)].reshape(3, 2)
        v_m = (y[k, :2] - y[k - 1, :2]) / H if k else np.zeros(2)
        q = back @ y[k, :2]
        v = back @ v_m
        a = d[2] + g[1] * (d[1] - v) + g[0] * (d[0] - q)
        expected = [0.1, 0.2] * (eta @ a) + 0.7 * v_m + back.T @ (a @ functions.M + q)
        assert_allclose(found[k], expected, rtol=1e-9)
    table = chance.normal(size=(3, 10))
    for uses in (("gear",), ()):
        made = law("joint_torque", g, table, uses, Timing(H))
        y, found = steps_of(made)
        for k in range(3):
            d = table[k].reshape(5, 2)
            q_m = y[k, :2]
            q_a = y[k, [3, 2]]
            v_m, v_a = (
                ((y[k, :2] - y[k - 1, :2]) / H, (q_a - y[k - 1, [3, 2]]) / H)
                if k
                else (np.zeros(2),) * 2
            )
            u = d[0] + g[0] * (d[1] - q_m) + g[1] * (d[2] - v_m)
            if uses:
                T = back.T @ ((back @ q_m - q_a) @ functions.K)
                dT = back.T @ ((back @ v_m - v_a) @ functions.K)
                u = u + g[2] * (d[3] - T) + g[3] * (d[4] - dT)
            assert_allclose(found[k], u, rtol=1e-9)


@pytest.mark.parametrize(("delay", "predicted"), [(0.0, False), (0.0, True), (1.4 * H, True)])
def test_steps_of_linearization_predict_by_runge_kutta(delay: float, predicted: bool) -> None:
    chance = np.random.default_rng(10)
    functions = Functions()
    g = chance.uniform(1, 2, (4, 2))
    table = chance.normal(size=(3, 20))
    timing = Timing(H, delay, predicted)
    made = law("linearisation", g, table, (), timing, state=4, channels=None)
    y = chance.normal(size=(3, 12))
    none = np.zeros(0)
    made.reset()
    planned = Reference(none, none, none, none, none, none)
    past = [np.array([0.5, -0.5])] * 2

    def rate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        q, v, p, w = x
        return np.array([v, functions.rest(q, p) - 0.1 * v, w, 3.0 * u - p])

    def move(x: np.ndarray, u: np.ndarray, duration: float) -> np.ndarray:
        steps = max(1, math.ceil(duration * 900.0))
        h = duration / steps
        for _ in range(steps):
            k1 = rate(x, u)
            k2 = rate(x + h / 2 * k1, u)
            k3 = rate(x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3, u))
        return x

    def torque(x: np.ndarray, d: np.ndarray) -> np.ndarray:
        q, v, p, w = x
        q_d, v_d, a_d, j_d, s_d = d.reshape(5, 2)
        a = functions.rest(q, p)
        j = functions.rest(v, w)
        s = s_d + g[3] * (j_d - j) + g[2] * (a_d - a) + g[1] * (v_d - v) + g[0] * (q_d - q)
        return 2 * s + a - 0.5 * j + q - v + p - w

    for k in range(3):
        x = y[k, 4:].reshape(4, 2)
        for age, duration in timing.segments():
            x = move(x, past[age - 1], duration)
        d = table[k]
        u = torque(x, d[:10])
        if predicted:
            u = torque(move(x, u, H / 2), d[10:])
        found = made.step(k, Measurement(y[k, :2], y[k, 2:]), planned)
        assert_allclose(found, u, rtol=1e-8)
        past = [u, *past[:-1]]
    setup = SimpleNamespace(n_m=2, n_y=11, q_m=np.zeros((1, 2)), sample_s=H)
    with pytest.raises(
        ArgumentError,
        match="given a loop with 2 motors and 11 measured channels, expected 2 and at least 12",
    ):
        made.compiled(setup)
    with pytest.raises(ArgumentError, match="3 measured channels, expected 2 and at least 4"):
        law("joint_torque", g, table, (), timing).compiled(
            SimpleNamespace(n_m=2, n_y=3, q_m=np.zeros((1, 2)), sample_s=H)
        )


def test_titles_and_ranges_of_linearization() -> None:
    assert (
        FeedbackLinearisation(12.0, "discrete", True).title
        == "feedback linearization, discrete, predicted, 12 Hz"
    )
    assert FeedbackLinearisation().title == "feedback linearization, continuous, 16 Hz"
    assert ComputedTorque().title == "computed torque, 4 Hz"
    check_frequency(1e5)
    for value in (0.0, 1.1e5, np.nan):
        with pytest.raises(
            ArgumentError, match=r"frequency_hz: given .*, expected more than 0, up to 100000 Hz"
        ):
            check_frequency(value)
    with pytest.raises(ArgumentError, match="form"):
        FeedbackLinearisation(form="other")


def trial(
    setting: study.Setting,
    family: str,
    tuning: str,
    errors: tuple,
    noise: float = 1.0,
    refused: str = "",
) -> study.Trial:
    return study.Trial(setting, family, tuning, errors, errors, noise, refused)


def test_the_table_of_a_study_by_hand() -> None:
    exact = study.Setting(5e-4, 0.0, True)
    noisy = study.Setting(1e-3, 2e-3, False)
    trials = (
        trial(exact, study.PD, "a", (1e-3, 4e-3), 99.0),
        trial(exact, study.PD, "b", (2e-3, 3e-3)),
        trial(exact, study.PD, "c", (1e-3, np.nan)),
        trial(exact, study.FL, "d", (6e-3, 1e-3)),
        trial(exact, study.PREDICTED, "e", (5e-3,)),
        trial(exact, study.STATE_LQ, "f", (2e-3,)),
        trial(noisy, study.PD, "g", (1e-3,), 4.1),
        trial(noisy, study.PD, "h", (7e-3,), 4.0),
        trial(noisy, study.FL, "i", (), np.nan, "no"),
    )
    made = object.__new__(study.FeedbackStudy)
    fields = {
        "model": flexgen.read("elbow"),
        "solution": SimpleNamespace(move=SimpleNamespace(name="m")),
        "plants": ("nominal", "x"),
        "settings": (exact, noisy),
        "trials": trials,
        "torque_noise_Nm": 4.0,
    }
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    assert made.best(exact, study.PD).tuning == "b" and made.best(noisy, study.PD).tuning == "h"
    assert made.best(noisy, study.FL) is None and made.ratio(exact) == pytest.approx(2.5)
    assert [t.worst_m for t in trials[:3]] == [4e-3, 3e-3, np.inf] and trials[-1].worst_m == np.inf
    assert made.table == (
        "| state exact | motor PD | motor PID | FL | FL, predicted | LQ |\n"
        "|---|---|---|---|---|---|\n"
        "| 0.5 ms, no delay | 3.00 (b) | none | 6.00 (d) | 5.00 (e) | 2.00 (f) |\n"
        "\n"
        "| measured angles | motor PD | motor PID | FL | FL, predicted | LQ |\n"
        "|---|---|---|---|---|---|\n"
        "| 1 ms, 2 samples | 7.00 at 4.0 N m (h) | none | none | none | none |\n"
    )
    assert str(made) == made.table and str(study.Setting(1e-3, 1e-3, True)) == "1 ms, 1 sample"
    data = made.to_dict()
    assert data["settings"][0]["families"][study.PD]["best"] == "b"
    assert data["settings"][0]["families"][study.PD]["tunings"][2]["error_m"] == [1e-3, None]
    assert data["settings"][1]["families"][study.FL]["tunings"][0] == {
        "tuning": "i",
        "worst_m": None,
        "error_m": [],
        "dynamic_error_m": [],
        "torque_noise_Nm": None,
        "refused": "no",
    }
    assert data["torque_noise_limit_Nm"] == 4.0 and data["plants"] == ["nominal", "x"]
    assert repr(made) == "<FeedbackStudy elbow: 2 settings, 9 tunings>"


def test_laws_of_a_study_and_its_disturbances(monkeypatch: pytest.MonkeyPatch) -> None:
    model = flexgen.read("elbow")
    case = SimpleNamespace(model=model, reference=motion_of(model).reference)
    rhos = [x.rho for _, x in study._laws(case, study.STATE_LQ, 3)]
    assert_allclose(rhos, 10.0 ** np.array([1, -1, -3, -5, -7, -9]))
    for family, part in ((study.PD, 0.0), (study.PID, 0.125)):
        made = study._laws(case, family, 2)
        assert [name for name, _ in made] == ["3 Hz", "64 Hz"]
        w = 2 * np.pi * 3
        J = study.motor_inertias(model, at_rest(model))[0]
        assert_allclose(made[0][1].position_gain, w / 2)
        assert_allclose(made[0][1].speed_gain, 2 * w * J)
        assert_allclose(made[0][1].integral_gain, part * w)
    found = study._laws(case, study.PREDICTED, 2)
    assert [(name, x.form, x.predict) for name, x in found] == [
        (f"{form}, {f} Hz", form, True)
        for form in ("continuous", "discrete")
        for f in ("8.0", "60.0")
    ]
    assert not study._laws(case, study.FL, 2)[0][1].predict
    given: dict = {}
    monkeypatch.setattr(study, "control_case", lambda robot, **more: given.update(more))
    study._case(model, study.Setting(1e-3, 2e-3, False), None)
    names = [m.name for m in model.motors]
    pushes = [
        *(Disturbance("step", name, 0.5, 0.1) for name in names),
        Disturbance("pulse", "tool.x", 300.0, 0.25, 0.02),
    ]
    assert given == {
        "sample_time": 1e-3,
        "delay": 2e-3,
        "plants": study.PLANTS,
        "disturbances": {"disturbed": pushes},
        "encoder_noise": 1e-4,
        "exact_state": False,
        "solution": None,
        "torque_limits": False,
    }
    study._case(model, study.Setting(1e-3, 0.0, True), None)
    assert given["encoder_noise"] == 0.0 and given["exact_state"]
    time = np.array([-2.0, -1.0, -0.5, -0.1, 0.0, 1.0])
    tau = np.array([[9.0, 0], [8, 0], [1, 2], [3, 7], [50, 0], [60, 0]])
    robot = SimpleNamespace(tau_m=tau, failure="")
    run = SimpleNamespace(
        runs=(robot,),
        nominal=robot,
        figures=lambda r: {"error_max_m": 0.5, "dynamic_error_max_m": 0.25},
    )
    monkeypatch.setattr(study, "case_controller", lambda case, law: (None, "x"))
    monkeypatch.setattr(study, "run_case", lambda case, *made: run)
    of = SimpleNamespace(reference=SimpleNamespace(time=time, begin=-0.05))
    row = study._trial(of, study.SETTINGS[0], study.FL, "t", None)
    assert (row.error_m, row.dynamic_error_m, row.torque_noise_Nm, row.refused) == (
        (0.5,),
        (0.25,),
        5.0,
        "",
    )
    robot.failure = "x"
    assert np.isnan(study._trial(of, study.SETTINGS[0], study.FL, "t", None).torque_noise_Nm)
    with pytest.raises(ArgumentError, match="2 tunings and a torque > 0"):
        flexgen.feedback_study(tunings=1)
    with pytest.raises(ArgumentError, match=r"torque_noise 0\.0"):
        flexgen.feedback_study(torque_noise=0.0)


def test_gains_of_an_elastic_joint_are_those_of_four_integrators(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the torque to the joint; the frequency and whether an unstable loop is allowed are
    those of the law.
    """

    def gains(*given: object) -> None:
        raise StopIteration(given)

    monkeypatch.setattr(linearising, "stable_gains", gains)
    motion = object.__new__(LawMotion)
    vars(motion).update(model=flexgen.read("elbow"), timing=lambda predict: f"timing {predict}")
    law = FeedbackLinearisation(7.0)
    with pytest.raises(StopIteration) as caught:
        law.bound(motion)
    assert caught.value.value == (7.0, 4, law.form, f"timing {law.predict}", law.allow_unstable)
