"""Observers: the C against a twin with whole matrices, the linear Kalman filter, and their own
claims.
"""

from __future__ import annotations

import copy

import numpy as np
import pytest
from measured_numbers import check_numbers
from observer_twins import KalmanTwin
from scipy import stats
from scipy.linalg import expm
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.channels import channels_of
from flexgen.feedback.loop.sampled_model import PoseModels
from flexgen.feedback.observers.constant_gain import stationary
from flexgen.feedback.observers.design import process_noise
from flexgen.planning.learning.smoother import PathSmoother, acting

pytestmark = needs_compiler

CASES = [
    ("planar5_nmp", "motors", 1e-3, True),
    ("planar5_nmp", ("motors", "tool_accelerometer", "tool_gyro"), 1e-3, True),
    # F is squared here
    ("planar5_nmp", ("m2", "tool_accelerometer", "m1", "link_encoders"), 4e-3, False),
    # rigid gears: torques show in the accelerometer
    ("manutec_r3", ("motors", "tool_accelerometer"), 1e-3, True),
    pytest.param("manutec_r3_18", "motors", 1e-3, True, marks=pytest.mark.slow),
    pytest.param(
        "manutec_r3_18", ("motors", "tool_accelerometer"), 1e-3, True, marks=pytest.mark.slow
    ),
]


def noisy_record(name, outputs, sample_time, disturbances, samples=25, **more):
    """A filter, its start, and measurements around it under large random torques."""
    ekf = flexgen.ExtendedKalmanFilter(
        name, outputs, sample_time=sample_time, disturbances=disturbances, **more
    )  # fmt: skip
    twin = KalmanTwin(ekf)
    rng = np.random.default_rng(0)
    y = np.array(twin.g(ekf.state[: twin.n_x], np.zeros(ekf.model.n_m))[0]).ravel()
    u = 0.3 * ekf.noises.largest * rng.normal(size=(samples, ekf.model.n_m))
    return ekf, y + 3 * ekf.channels.noise * rng.normal(size=(samples, len(y))), u


def difference(ekf, found, twin, y, u) -> float:
    """Largest difference from a twin: of states and innovations in their deviations, of
    covariances relative.
    """
    worst = 0.0
    for k in range(len(y)):
        nu, square = twin.step(y[k], u[k])
        worst = max(worst, np.abs((found.innovation[k] - nu) / ekf.channels.noise).max())
        worst = max(worst, abs(found.normalized[k] / square - 1))
    deviations = np.sqrt(np.diag(twin.P))
    worst = max(worst, np.abs((ekf.state - twin.z) / deviations).max())
    return max(worst, np.abs((ekf.covariance - twin.P) / np.outer(deviations, deviations)).max())


@pytest.mark.parametrize(("name", "outputs", "sample_time", "disturbances"), CASES)
def test_the_filter_in_c_is_its_twin(name, outputs, sample_time, disturbances):
    """Measured 1e-9: rounding of the recursion and of Lagrange's equations over 25 samples, in
    units of the noise.
    """
    ekf, y, u = noisy_record(name, outputs, sample_time, disturbances)
    twin = KalmanTwin(ekf)
    assert difference(ekf, ekf.run(y, u), twin, y, u) < 1e-7


@pytest.mark.parametrize(
    ("case", "mistake"),
    [(CASES[1], "first order"), (CASES[3], "first order"), (CASES[3], "no torque in H")],
)
def test_a_planted_mistake_is_seen(case, mistake):
    ekf, y, u = noisy_record(*case)
    twin = KalmanTwin(ekf, mistake)
    assert difference(ekf, ekf.run(y, u), twin, y, u) > 1e-4


@pytest.mark.slow
def test_for_this_processor_it_is_the_same_filter():
    _, y, u = noisy_record(*CASES[1])
    runs = []
    for native in (False, True):
        ekf = flexgen.ExtendedKalmanFilter(
            "planar5_nmp", CASES[1][1], sample_time=1e-3, native=native
        )
        runs.append(ekf.run(y, u))
    assert np.allclose(runs[0].q_a, runs[1].q_a, rtol=0, atol=1e-11)
    assert np.allclose(runs[0].deviation, runs[1].deviation, rtol=1e-9)


@pytest.mark.parametrize("sample_time", [5e-4, 1e-3, 2e-3, 4e-3])
def test_deviations_of_the_first_samples_are_those_of_the_exact_exponential(sample_time):
    """Transition by `scipy.linalg.expm`; measured 2e-5 to 6.5e-4, and 1.4e-2 to 11 with a second
    order.
    """
    ekf = flexgen.ExtendedKalmanFilter(
        "four_mass@high", ("motors", "link_encoders"), sample_time=sample_time
    )
    n_x = 2 * ekf.model.dof
    n_m = ekf.model.n_m
    at = ekf._poses.at(ekf._at_rest(np.zeros(n_m)))
    whole = np.zeros((n_x + n_m, n_x + n_m))
    whole[:n_x, :n_x] = at.A
    whole[:n_x, n_x:] = at.B
    F = expm(sample_time * whole)
    Q = process_noise(at, F[:n_x, n_x:], ekf.noises, sample_time)
    C = np.hstack([at.C, at.D])[ekf.channels.index]
    R = np.diag(ekf.channels.noise**2)
    P = ekf.covariance
    worst = 0.0
    for k in range(40):
        ekf.step(np.zeros(len(C)), np.zeros(n_m))
        if k:
            P = F @ P @ F.T + Q
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        kept = np.eye(len(P)) - K @ C
        P = kept @ P @ kept.T + K @ R @ K.T
        worst = max(worst, np.abs(np.sqrt(np.diag(ekf.covariance) / np.diag(P)) - 1).max())
    assert worst < 1e-3


def simulated(ekf, samples, rng, factor=1.0):
    """Measurements of a robot whose noises are those of the filter, by the nonlinear equations of
    the twin.
    """
    twin = KalmanTwin(ekf)
    n_x = twin.n_x
    n_m = ekf.model.n_m
    h = ekf.sample_time
    z = ekf.state + np.linalg.cholesky(ekf.covariance) @ rng.normal(size=len(ekf.state))
    hold = ekf._at_rest(ekf.model.eta @ np.array(ekf.model.home))[6][0]
    values, vectors = np.linalg.eigh(twin.process)
    process = vectors * np.sqrt(np.maximum(values, 0.0))
    y = np.empty((samples, len(ekf.outputs)))
    u = np.empty((samples, n_m))
    for k in range(samples):
        u[k] = hold + 0.2 * ekf.noises.largest * np.sin(0.02 * k + np.arange(n_m))
        tau = u[k] + z[n_x:]
        if k:
            acts = tau + ekf.noises.torque * ekf.noises.largest * rng.normal(size=n_m)
            x = z[:n_x]
            step = h / 4
            for _ in range(4):
                k1 = np.array(twin.rate(x, acts)).ravel()
                k2 = np.array(twin.rate(x + step / 2 * k1, acts)).ravel()
                k3 = np.array(twin.rate(x + step / 2 * k2, acts)).ravel()
                k4 = np.array(twin.rate(x + step * k3, acts)).ravel()
                x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            z[:n_x] = x + process @ rng.normal(size=n_x)
        exact = np.array(twin.g(z[:n_x], u[k] + z[n_x:])[0]).ravel()
        y[k] = exact + factor * ekf.channels.noise * rng.normal(size=len(exact))
        z[n_x:] += np.sqrt(np.diag(twin.walk)) * rng.normal(size=n_m)
    return y, u


@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_innovations_are_as_large_as_the_filter_claims(factor):
    """Sum of normalized squares within the bounds of chi-square (1e-4 each side); 30 % more noise
    is seen.
    """
    ekf = flexgen.ExtendedKalmanFilter(
        "planar5_nmp", ("motors", "tool_accelerometer"), sample_time=1e-3, tool_force=5.0
    )
    y, u = simulated(ekf, 800, np.random.default_rng(5), factor)
    found = ekf.run(y, u)
    low, high = stats.chi2.ppf([1e-4, 1 - 1e-4], found.innovation.size)
    assert (low < found.normalized.sum() < high) == (factor == 1.0)
    assert found.normalized.sum() > low


@pytest.mark.slow
def test_estimates_follow_a_disturbance():
    """A torque that was not commanded is found within two of its deviations."""
    ekf = flexgen.ExtendedKalmanFilter(
        "planar5_nmp", ("motors", "link_encoders"), sample_time=1e-3
    )
    twin = KalmanTwin(ekf)
    hold = ekf._at_rest(ekf.model.eta @ np.array(ekf.model.home))[6][0]
    x = ekf.state[: twin.n_x]
    pushed = hold + np.array([0.5, -0.3])
    h = 2.5e-4
    y = np.empty((400, 4))
    for k in range(len(y)):
        y[k] = np.array(twin.g(x, pushed)[0]).ravel()
        for _ in range(4):
            k1 = np.array(twin.rate(x, pushed)).ravel()
            k2 = np.array(twin.rate(x + h / 2 * k1, pushed)).ravel()
            k3 = np.array(twin.rate(x + h / 2 * k2, pushed)).ravel()
            k4 = np.array(twin.rate(x + h * k3, pushed)).ravel()
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    found = ekf.run(y, np.tile(hold, (len(y), 1)))
    assert np.all(np.abs(found.disturbance[-1] - [0.5, -0.3]) < 2 * found.deviation[-1, -2:])
    assert np.all(np.abs(found.disturbance[-1] - [0.5, -0.3]) < 0.1)


def test_copies_of_a_filter_are_independent():
    ekf, y, u = noisy_record(*CASES[1])
    ekf.run(y[:5], u[:5])
    other = copy.deepcopy(ekf)
    alone = copy.deepcopy(ekf).run(y[5:], u[5:])
    assert np.array_equal(ekf.run(y[5:], u[5:]).q_a, alone.q_a)
    ekf.reset(np.array([31.0, -109.0]))
    assert np.array_equal(other.run(y[5:], u[5:]).deviation, alone.deviation)


class Observed:
    """Feedback of estimated motor motion and, or not, of the disturbance that the filter finds."""

    def __init__(self, ekf, use):
        self.ekf = ekf
        self.use = use

    def reset(self):
        self.u = None

    def step(self, k, y, ref):
        if self.u is None:
            self.ekf.reset(y.q_m)
            self.u = ref.tau_m
        found = self.ekf.step(y.q_m, self.u)
        self.u = (
            ref.tau_m
            + 0.5 * (ref.q_m - found.q_m)
            + 0.02 * (ref.v_m - found.v_m)
            - self.use * found.disturbance
        )
        return self.u


@pytest.mark.slow
def test_the_filter_works_inside_the_closed_loop(solution):
    """A disturbance of 0.5 N m on both motors stays with a proportional law, and goes where it is
    estimated.
    """
    errors = []
    for use in (0.0, 1.0):
        ekf = flexgen.ExtendedKalmanFilter("planar5_nmp", sample_time=1e-3)
        run = flexgen.control(
            "planar5_nmp",
            controller=Observed(ekf, use),
            sample_time=1e-3,
            encoder_noise=1e-5,
            solution=solution,
            disturbances=[flexgen.Disturbance("step", name, 0.5, 0.0) for name in ("m1", "m2")],
            progress=False,
        )
        assert run.status == "done"
        errors.append(np.abs(run.nominal.q_m - run.reference.motion["q_m"])[-1].max())
    assert errors[0] > 0.5 and errors[1] < 0.05 * errors[0]


# --- constant gains ------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def solution():
    return flexgen.solve("planar5_nmp", progress=False)


def test_constant_gains_are_those_of_the_middle_of_each_part(solution):
    """The stationary gains of `test_observer_design`, of the channels in their order."""
    observer = flexgen.ConstantGainObserver(solution, ("tool_gyro", "m2", "m1"), parts=3)
    case = control_case(solution.model, solution=solution, sample_time=1e-3)
    count = len(case.reference.time)
    assert observer.samples == -(-count // 3)
    for part in range(3):
        middle = min(part * observer.samples + observer.samples // 2, count - 1)
        at = PoseModels(observer.model).at(case.reference.points(np.array([middle])))
        channels = observer.channels
        expected = stationary(at, channels.index, channels.noise, observer.noises, 1e-3)
        for one, other in zip(observer.matrices, expected, strict=True):
            assert np.allclose(one[part], other, rtol=1e-9)


@pytest.mark.parametrize("outputs", ["motors", ("tool_accelerometer", "m2", "tool_gyro", "m1")])
@pytest.mark.parametrize("native", [False, True])
def test_constant_gains_in_c_are_the_equations(solution, outputs, native):
    observer = flexgen.ConstantGainObserver(solution, outputs, native=native)
    rng = np.random.default_rng(2)
    count = 700
    n_x = 2 * observer.model.dof
    order = observer._order
    y_ref, u_ref, x_ref = (observer._tables[name] for name in ("y_ref", "u_ref", "x_ref"))
    y = np.empty((count, len(order)))
    y[:, order] = y_ref[:count]
    y += 1e-3 * rng.normal(size=y.shape)
    u = u_ref[:count] + rng.normal(size=(count, observer.model.n_m))
    found = observer.run(y, u)
    x = np.zeros(n_x)
    d = np.zeros(observer.model.n_m)
    for k in range(count):
        F, G, C, D, M = (
            part[min(k // observer.samples, len(part) - 1)] for part in observer.matrices
        )
        acts = d + u[k] - u_ref[k]
        before = F @ x + G @ acts
        e = y[k] - C @ before - D @ acts
        e[order] -= y_ref[k]
        x = before + M[:n_x] @ e
        d = d + M[n_x:] @ e
        assert np.allclose(found[k], np.concatenate([x_ref[k] + x, d]), rtol=1e-9, atol=1e-9)


def test_observers_agree_along_a_motion(solution):
    """A soft robot under control: the filter and the constant gains find the same tool, within 50
    um of 1.8 mm.
    """
    run = flexgen.control(
        "planar5_nmp",
        sample_time=1e-3,
        plants={"soft": {"stiffness": 0.8}},
        encoder_noise=1e-4,
        solution=solution,
        progress=False,
    )
    soft = run["soft"]
    u = acting(soft.tau_m, 0, 0.0)
    ekf = flexgen.ExtendedKalmanFilter("planar5_nmp", sample_time=1e-3)
    ekf.reset(soft.measured[0])
    n_a = run.model.n_a
    constant = flexgen.ConstantGainObserver(solution).run(soft.measured, u)[:, :n_a]
    extended = ekf.run(soft.measured, u).q_a
    assert np.abs(constant - extended)[1000:].max() < 5e-5
    check_numbers("observers", constant=constant, extended=extended)
    # the deflection of soft springs is not seen
    assert np.abs(extended - soft.q_a)[1000:].max() > 2e-4


# --- smoother ------------------------------------------------------------------------------------
@pytest.mark.slow
def test_a_smoother_reconstructs_a_deviation_without_delay(solution):
    """A deviation of the arm that follows from a force, seen without noise: found forwards as
    backwards.
    """
    channels = channels_of(solution.model, ("motors", "tool_accelerometer"))
    case = control_case(channels.model, solution=solution, sample_time=1e-3)
    smoother = PathSmoother(channels, case.reference, 1e-3)
    count = len(case.reference.time)
    size = smoother._F.shape[1]
    z = np.zeros(size)
    dy = np.zeros((count, len(channels.names)))
    true = np.zeros((count, solution.model.n_a))
    n_x = 2 * solution.model.dof
    for k in range(count):
        p = min(k // smoother.samples, len(smoother._F) - 1)
        if k:
            z = smoother._F[p] @ z
        z[n_x:] = 0.0
        z[n_x + 2 : n_x + 5] = 0.5 * np.exp(-(((k - 2250) / 60) ** 2)) * np.array([1.0, -0.5, 0.3])
        dy[k] = smoother._C[p] @ z
        true[k] = z[: solution.model.n_a]
    found = smoother.deviation(dy, np.zeros((count, solution.model.n_m)))
    assert np.abs(found - true).max() < 0.15 * np.abs(true).max()
    assert not smoother.deviation(0 * dy, np.zeros((count, solution.model.n_m))).any()


def test_torques_between_samples():
    u = np.arange(5.0)[:, None]
    assert acting(u, 0, 0.0).ravel().tolist() == [0, 0, 1, 2, 3]
    assert acting(u, 1, 0.5).ravel().tolist() == [0, 0, 0, 0.5, 1.5]


@pytest.mark.slow
def test_learning_from_accelerometers_removes_what_moves(solution):
    """The dynamic error of the soft robot falls below 60 %; the error at rest stays, and that is
    said.
    """
    found = flexgen.learn(
        "planar5_nmp",
        plant={"stiffness": 0.8},
        solution=solution,
        iterations=3,
        sample_time=1e-3,
        encoder_noise=1e-4,
        measured_by="accelerometer",
        progress=False,
    )
    assert found.dynamic_errors_m[-1] < 0.6 * found.dynamic_errors_m[0]
    assert min(found.errors_m) > 0.5e-3
    assert "dynamic" in str(found) and found.to_dict()["measured_by"] == "accelerometer"
    assert found.best == int(np.argmin(found.measured_m))


# --- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"outputs": "nose"}, "outputs: given 'nose', expected one of motors, m1, m2"),
        ({"outputs": ()}, "outputs: given \\(\\), expected names"),
        ({"outputs": ("motors", "m1")}, "given 'm1' twice"),
        ({"outputs": "m2"}, "which do not determine q1"),
        ({"outputs": "tool_gyro"}, "which do not determine q1"),
        ({"noise": 0.0}, "noise of m1: given 0.0, expected a number > 0"),
        ({"noise": {"m1": float("nan")}}, "noise of m1: given nan"),
        ({"noise": {"m3": 1.0}}, "noise: given 'm3', expected one of the outputs m1, m2"),
        ({"sample_time": 0.0}, "sample_time: given 0.0"),
        ({"torque_noise": 0.0}, "torque_noise: given 0.0"),
        ({"disturbance_rate": -1.0}, "disturbance_rate: given -1.0"),
        ({"tool_force": float("inf")}, "tool_force: given inf"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.ExtendedKalmanFilter("planar5_nmp", **arguments)


def test_a_sensor_without_noise_is_refused():
    sensor = {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"}
    model = flexgen.read("planar5_nmp", overrides={"sensor": [sensor]})
    with pytest.raises(ArgumentError, match=r"noise of acc\.x: given 0\.0"):
        flexgen.ExtendedKalmanFilter(model, ("motors", "acc"))


def test_the_filter_refuses_gears_with_hysteresis():
    table = {"element.upper.dof.q1.gear.hysteresis": {"lost_motion": 3e-4, "stiffness": 1e6}}
    with pytest.raises(
        ArgumentError, match="ExtendedKalmanFilter: given elbow, whose gear of q1 has hysteresis"
    ):
        flexgen.ExtendedKalmanFilter(flexgen.read("elbow", overrides=table))


def test_wrong_arrays_are_refused():
    ekf = flexgen.ExtendedKalmanFilter("planar5_nmp")
    with pytest.raises(ArgumentError, match=r"y: given shape \(1, 3\), expected \(1, 2\)"):
        ekf.step(np.zeros(3), np.zeros(2))
    with pytest.raises(ArgumentError, match=r"u: given shape \(4, 1\), expected \(4, 2\)"):
        ekf.run(np.zeros((4, 2)), np.zeros((4, 1)))
    with pytest.raises(ArgumentError, match=r"state: given shape \(3,\), expected \(12,\)"):
        ekf.reset(state=np.zeros(3))
    with pytest.raises(ArgumentError, match="covariance: given a matrix with a variance <= 0"):
        ekf.reset(covariance=-np.eye(12))
    with pytest.raises(ArgumentError, match="covariance: given shape"):
        ekf.reset(covariance=np.eye(3))


def test_a_failed_filter_raises_errors_until_it_is_reset():
    ekf = flexgen.ExtendedKalmanFilter("planar5_nmp")
    good = ekf.model.eta @ np.array(ekf.model.home)
    ekf.step(good, np.zeros(2))
    for y in (np.array([np.nan, 0.0]), good):
        with pytest.raises(SolverError, match="sample 0 of 1: a number is not finite"):
            ekf.step(y, np.zeros(2))
    assert ekf.status.startswith("a number is not finite")
    ekf.reset()
    assert np.isfinite(ekf.step(good, np.zeros(2)).q_a).all() and ekf.status == "done"
    ekf._P[0, 0] = -1.0  # as rounding could make it
    with pytest.raises(SolverError, match="the covariance is not positive any more"):
        ekf.run(np.tile(good, (3, 1)), np.zeros((3, 2)))


def test_a_constant_gain_observer_refuses_what_is_not_finite(solution):
    observer = flexgen.ConstantGainObserver(solution)
    with pytest.raises(SolverError, match="sample 0 of 1: a number is not finite"):
        observer.step(np.array([np.nan, 0.0]), np.zeros(2))
    with pytest.raises(ArgumentError, match="parts: given 0"):
        flexgen.ConstantGainObserver(solution, parts=0)
    with pytest.raises(ArgumentError, match="which do not determine q1"):
        flexgen.ConstantGainObserver(solution, "m2")


def test_sensors_with_delay_and_wrong_samples_are_refused():
    """A filter that ignored the delay would be off by hundreds of standard deviations."""
    sensor = {
        "name": "acc",
        "type": "accelerometer",
        "element": "tool",
        "unit": "m/s^2",
        "noise": 0.05,
    }
    late = flexgen.read("planar5_nmp", overrides={"sensor": [sensor | {"delay_s": 0.02}]})
    with pytest.raises(
        ArgumentError, match=r"sensor acc with delay_s = 0.02, expected one without delay"
    ):
        flexgen.ExtendedKalmanFilter(late, ("motors", "acc"), sample_time=1e-3)
    solution = flexgen.solve("planar5_nmp", verify=False)
    observer = flexgen.ConstantGainObserver(solution, parts=1)
    for wrong in (-1, 0.5, True, "a"):
        with pytest.raises(ArgumentError, match="expected a whole number from 0 on"):
            observer.reset(wrong)
    other = copy.deepcopy(observer)
    y = np.zeros(2)
    u = np.zeros(2)
    first = observer.step(y, u)
    assert np.array_equal(other.step(y, u), first) and not np.array_equal(
        observer.step(y, u), first
    )
