"""The sampled closed loop in C: exact for linear robots, of order four, with the delay, noise and
limits it claims.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_loops import T, loop_of, moving
from scipy.linalg import expm
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.closed_loop import ClosedLoop, integration_steps
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.hardware import DriveHardware, SensorChannels
from flexgen.identification.experiments.plan import default_cascade
from flexgen.identification.responses.local_model import LocalModel
from flexgen.model.elements import RobotModel

pytestmark = needs_compiler


@pytest.mark.parametrize("delay", [0, 3])
def test_a_linear_robot_follows_the_exact_discrete_loop(delay):
    """x(k+1) by the matrix exponential, the drive written again; delays are whole steps of the
    integrator.
    """
    model = flexgen.read("four_mass@high")
    steps = 32
    loop, at_rest, local, _ = loop_of(
        model, DriveHardware(T, delay_s=delay * T / steps), steps=steps
    )
    samples = 400
    reference = moving(at_rest, 1, samples)
    found = loop.run(reference, samples)
    M, D, K, B = (x[0] for x in local.matrices(local.values, at_rest[:, :1]))
    n = model.dof
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    inputs = np.vstack([np.zeros((n, 1)), np.linalg.solve(M, B)])

    def step(h: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[A, inputs], [np.zeros((1, 2 * n + 1))]]) * h)
        return whole[:-1, :-1], whole[:-1, -1]

    before = step(delay * T / steps)
    after = step(T - delay * T / steps)
    c = default_cascade(model)
    x = np.zeros(2 * n)
    u = 0.0
    q_old = 0.0
    ref_old = 0.0
    for k in range(samples):
        q = x[model.n_a]
        ref = reference[k, 0, 0]
        new = c.speed_gain[0] * (
            (ref - ref_old) / T + c.position_gain[0] * (ref - q) - (q - q_old) / T
        )
        assert found.q_m[k, 0, 0] == pytest.approx(q, abs=1e-10)
        assert found.tau_m[k, 0, 0] == pytest.approx(new, abs=1e-8)
        x = before[0] @ x + before[1] * u
        x = after[0] @ x + after[1] * new
        u = new
        q_old = q
        ref_old = ref


@pytest.mark.parametrize("late", [0, 2])
def test_a_delay_just_below_a_sample_is_one_of_a_sample(late):
    """Its torques acted never: all integration steps of a sample are the next sample."""
    model = flexgen.read("four_mass@high")
    samples = 200
    found = []
    for delay, whole in ((0.9999 * T, late), (0.0, late + 1)):
        steps = None if delay else 64
        loop, at_rest, _, _ = loop_of(
            model, DriveHardware(T, delay_s=delay), steps=steps, delay_samples=whole
        )
        found.append(loop.run(moving(at_rest, 1, samples), samples).q_m)
    assert np.ptp(found[1]) > 1e-3 and np.abs(found[0] - found[1]).max() < 1e-3 * np.ptp(found[1])


@pytest.mark.parametrize("part", [1e-5, 0.004, 0.01, 0.3, 0.7654, 0.99, 0.998, 0.9995])
def test_every_delay_is_nearly_a_whole_number_of_steps(part):
    steps = integration_steps(DriveHardware(T, delay_s=part * T), 20.0 / T)
    assert 20 <= steps <= 1000 and abs(round(part * steps) / steps - part) < 1e-3


def final_angles(steps: int) -> np.ndarray:
    loop, at_rest, _, _ = loop_of(flexgen.read("planar5_nmp"), DriveHardware(T), steps=steps)
    loop.run(moving(at_rest, 2, 600, 0.2), 600)
    return np.concatenate([x.ravel() for x in loop.state])


def test_the_integrator_is_of_order_four():
    coarse, fine, finest = (final_angles(steps) for steps in (1, 2, 16))
    order = np.log2(np.abs(coarse - finest).max() / np.abs(fine - finest).max())
    assert 3.5 < order < 4.5, order


def test_robots_in_a_batch_do_not_disturb_each_other():
    """A robot simulated alone and in a batch, in any lane: equal bits."""
    model = flexgen.read("planar5_nmp")
    hardware = DriveHardware(T, encoder_resolution_rad=1e-5)
    loop, at_rest, _, _ = loop_of(model, hardware, lanes=5)
    reference = moving(at_rest, 2, 200)
    together = loop.run(reference, 200)
    for lane in (0, 3, 4):
        alone, _, _, _ = loop_of(model, hardware)
        one = alone.run(reference[:, lane : lane + 1], 200)
        assert np.array_equal(one.q_m[:, 0], together.q_m[:, lane])
        assert np.array_equal(one.tau_m[:, 0], together.tau_m[:, lane])


def test_noise_has_its_size_and_its_seed():
    model = flexgen.read("planar5_nmp")
    noisy = DriveHardware(T, encoder_noise_rad=1e-4)
    runs = []
    for seed in (1, 1, 2):
        loop, at_rest, _, _rest = loop_of(
            model, noisy, lanes=4, seed=seed, controller=Cascade(*np.zeros((3, 2)))
        )
        runs.append(loop.run(at_rest[None], 2000).q_m - at_rest[:, :2])
    assert np.array_equal(runs[0], runs[1]) and not np.array_equal(runs[0], runs[2])
    assert runs[0].std() == pytest.approx(1e-4, rel=0.02)  # 16,000 samples: 0.6 %
    lanes = runs[0][:, :, 0]
    assert np.abs(np.corrcoef(lanes.T) - np.eye(4)).max() < 0.1
    kurtosis = np.mean((runs[0] / runs[0].std()) ** 4)
    assert 2.7 < kurtosis < 3.1  # 3 for a Gaussian, 2.9 for the sum of twelve


def test_torque_noise_and_quantisation():
    model = flexgen.read("planar5_nmp")
    loop, at_rest, _, _ = loop_of(
        model, DriveHardware(T, torque_noise_Nm=0.5, encoder_resolution_rad=1e-3)
    )
    found = loop.run(at_rest[None], 500)
    assert np.ptp(found.q_m) > 0
    assert np.allclose(found.q_m / 1e-3, np.round(found.q_m / 1e-3), atol=1e-6)


def test_torques_stay_within_their_limits():
    model = flexgen.read("planar5_nmp")
    free, at_rest, _, _rest = loop_of(model, DriveHardware(T))
    reference = moving(at_rest, 2, 300, 0.3)
    largest = np.abs(free.run(reference, 300).tau_m).max(axis=(0, 1))
    limited, _, _, _ = loop_of(model, DriveHardware(T, torque_max_Nm=tuple(0.7 * largest)))
    found = limited.run(reference, 300)
    assert np.all(np.abs(found.tau_m) <= 0.7 * largest + 1e-12)
    assert limited.saturated[0] > 0 and free.saturated[0] == 0


def test_torques_stay_within_their_torque_speed_curves():
    """At the speed of the sample; the second motor has none."""
    model = flexgen.read("planar5_nmp")
    free, at_rest, _, _rest = loop_of(model, DriveHardware(T))
    reference = moving(at_rest, 2, 300, 0.3)
    run = free.run(reference, 300)
    torque = np.abs(run.tau_m[:, 0, 0]).max()
    speed = np.abs(np.diff(run.q_m[:, 0, 0])).max() / T
    curve = ((0.0, 1.2 * torque), (0.5 * speed, 0.6 * torque), (0.875 * speed, 0.0))
    limited, _, _, _ = loop_of(model, DriveHardware(T, torque_speed=(curve, ())))
    found = limited.run(reference, 300, motion=True)
    assert found.motion is not None
    v = np.abs(found.motion[:, 2 * model.n_a + model.n_m, 0])
    allowed = np.maximum(np.interp(v, *np.array(curve).T), 0.0)
    assert np.all(np.abs(found.tau_m[:, 0, 0]) <= allowed + 1e-9 * torque)
    cut = np.isclose(np.abs(found.tau_m[:, 0, 0]), allowed, rtol=1e-9)
    assert 0 < np.count_nonzero(cut) == limited.saturated[0] < 300
    assert np.abs(run.tau_m[:, 0, 0]).max() > allowed[cut].max()


def test_an_unstable_loop_is_an_error_and_not_a_result():
    model = flexgen.read("planar5_nmp")
    gains = default_cascade(model)
    wild = replace(gains, speed_gain=1e3 * gains.speed_gain)
    loop, at_rest, _, _ = loop_of(model, DriveHardware(T), controller=wild)
    with pytest.raises(
        SolverError, match=r"robot 1 of 1: (not finite|controller failed) .*lower the gains"
    ):
        for _ in range(20):
            loop.run(moving(at_rest, 2, 1000, 0.3), 1000)


def test_wrong_arrays_are_refused():
    model = flexgen.read("planar5_nmp")
    loop, _at_rest, _, _ = loop_of(model, DriveHardware(T))
    with pytest.raises(
        ArgumentError, match=r"reference: given shape \(1, 2, 4\), expected finite numbers"
    ):
        loop.run(np.zeros((1, 2, 4)), 5)
    with pytest.raises(ArgumentError, match="expected finite numbers"):
        loop.run(np.full((1, 1, 4), np.nan), 5)
    with pytest.raises(ArgumentError, match="expected one for each of 2 motors"):
        loop_of(model, DriveHardware(T, torque_max_Nm=(1.0,)))
    for count in (1, 3):
        with pytest.raises(
            ArgumentError,
            match=rf"given sizes {{'torque_speed': {count}}}, expected one for each of 2",
        ):
            loop_of(model, DriveHardware(T, torque_speed=(((0.0, 1.0), (9.0, 0.5)),) * count))
    with pytest.raises(ArgumentError, match="use a smaller sample time"):
        loop_of(model, DriveHardware(0.4), steps=1)


def linear_robot() -> tuple[np.ndarray, np.ndarray, RobotModel, LocalModel]:
    """``A`` and ``B`` of the four masses with linear springs."""
    model = flexgen.read("four_mass@high")
    local = LocalModel(model, ())
    M, D, K, B = (x[0] for x in local.matrices(local.values, np.zeros((1, 1))))
    n = model.dof
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, np.vstack([np.zeros((n, 1)), np.linalg.solve(M, B)]), model, local


def constant(A: np.ndarray, B: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    n, m = B.shape
    whole = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
    return whole[:n, :n], whole[:n, n:]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_delay_of_whole_samples_is_as_many_states_more(delay):
    """A random linear controller: the loop against x+ = F x + G u with the torques under way as
    states.
    """
    A, B, model, _ = linear_robot()
    rng = np.random.default_rng(delay)
    law = Linear(
        0.3 * rng.standard_normal((2, 2)),
        rng.standard_normal((2, 1)),
        *(rng.standard_normal((1, k)) for k in (2, 1)),
    )
    library = library_with(model, ("forward_dynamics",))
    loop = ClosedLoop(
        model,
        library,
        DriveHardware(T),
        law,
        np.zeros((1, 3)),
        np.zeros((1, 1)),
        300.0,
        steps=16,
        delay_samples=delay,
    )
    loop.hold(np.zeros((1, 1)))
    samples = 300
    reference = np.zeros((samples, 1, 2))
    reference[:, 0, 0] = 0.1 * np.sin(30 * T * np.arange(samples))
    found = loop.run(reference, samples)
    phi, gamma = constant(A, B, T)
    x = np.zeros(len(A))
    z = np.zeros(2)
    late = [np.zeros(1)] * delay
    for k in range(samples):
        q = x[model.n_a]
        e = np.array([reference[k, 0, 0] - q])
        u = law.C @ z + law.D @ e
        assert found.q_m[k, 0, 0] == pytest.approx(q, abs=1e-10)
        assert found.tau_m[k, 0, 0] == pytest.approx(u[0], abs=1e-9)
        z = law.A @ z + law.B @ e
        late.append(u)
        x = phi @ x + gamma @ late.pop(0)


@pytest.mark.slow
def test_each_robot_has_its_own_parameters():
    """Stiffness and load by lane give the bits of robots that run alone."""
    model = flexgen.read("planar5_nmp")
    names = ("stiffness", "payload.mass")
    library = library_with(model, ("forward_dynamics",), parameters=names, per_point=True)
    values = np.tile(library.parameters, (3, 1))
    values[1] *= 0.9
    values[2, -1] = 2.0
    q_m = np.tile(model.eta @ np.array(model.home), (3, 1))
    q_a = np.zeros((3, model.n_a))
    q_a[:, list(model.i_g)] = model.home

    def run(lanes: list[int]) -> np.ndarray:
        loop = ClosedLoop(
            model,
            library,
            DriveHardware(T),
            default_cascade(model),
            q_a[lanes],
            q_m[lanes],
            700.0,
            parameters=values[lanes],
        )
        loop.hold(np.ones((len(lanes), 2)))
        reference = np.tile(
            np.concatenate([q_m[:1], np.ones((1, 2))], axis=1), (50, len(lanes), 1)
        )
        return loop.run(reference, 50).q_m

    together = run([0, 1, 2])
    for lane in range(3):
        assert np.array_equal(run([lane])[:, 0], together[:, lane])
    assert (
        np.abs(together[:, 0] - together[:, 1]).max()
        > 1e-6
        < np.abs(together[:, 0] - together[:, 2]).max()
    )


@pytest.mark.slow
def test_gains_of_each_robot_go_with_filters():
    """Robots with gains of their own and two filters are those that run alone."""
    model = flexgen.read("elbow")
    library = library_with(model, ("forward_dynamics",))
    usual = default_cascade(model)
    usual = replace(usual, filters=(flexgen.LowPass(300.0), flexgen.Notch(60.0)))
    factors = np.array([[1.0], [1.1], [0.8]])
    q_a = np.tile(model.home, (3, 1))
    q_m = np.tile(model.eta @ np.array(model.home), (3, 1))

    def run(lanes: list[int]) -> np.ndarray:
        own = {
            f"{word}_gain": factors[lanes] * getattr(usual, f"{word}_gain")
            for word in ("speed", "integral")
        }
        own["position_gain"] = np.tile(usual.position_gain, (len(lanes), 1))
        loop = ClosedLoop(
            model, library, DriveHardware(T), replace(usual, **own), q_a[lanes], q_m[lanes], 700.0
        )
        reference = np.tile(
            np.concatenate([q_m[:1] + 0.1, np.ones((1, 2))], axis=1), (50, len(lanes), 1)
        )
        return loop.run(reference, 50).q_m

    together = run([0, 1, 2])
    for lane in range(3):
        assert np.array_equal(run([lane])[:, 0], together[:, lane])
    loop = ClosedLoop(model, library, DriveHardware(T), usual, q_a[:1], q_m[:1], 700.0)
    reference = np.tile(np.concatenate([q_m[:1] + 0.1, np.ones((1, 2))], axis=1), (50, 1, 1))
    assert np.array_equal(loop.run(reference, 50).q_m[:, 0], together[:, 0])


def test_a_payload_that_moves_nothing_changes_nothing():
    """That of four_mass is on its axis: the function in C has no parameters, and wrote
    accelerations over them.
    """
    model = flexgen.read("four_mass")
    loop, at_rest, _, _ = loop_of(model, DriveHardware(T), lanes=2)
    library = library_with(
        model, ("forward_dynamics",), parameters=("payload.mass",), per_point=True
    )
    start = loop.state[0], loop.state[2], 1.0
    masses = np.array([[0.0], [1.0]])
    hardware = DriveHardware(T)
    loaded = ClosedLoop(
        model,
        library,
        hardware,
        default_cascade(model),
        *start,
        steps=loop.steps,
        parameters=masses,
    )
    loaded.hold(at_rest[:, model.n_m :])
    reference = moving(at_rest, model.n_m, 50)
    assert np.array_equal(loaded.run(reference, 50).q_m, loop.run(reference, 50).q_m)


def test_disturbances_act_where_and_when_they_should():
    """A torque on the motor and a force on the tool of a linear robot against the matrix
    exponential, step by step.
    """
    A, B, model, _ = linear_robot()
    library = library_with(model, ("forward_dynamics", "forward_dynamics_tool_force"))
    law = Linear(*(np.zeros(shape) for shape in ((0, 0), (0, 1), (1, 0), (1, 1))))
    steps = 8
    samples = 100
    loop = ClosedLoop(
        model,
        library,
        DriveHardware(T),
        law,
        np.zeros((1, 3)),
        np.zeros((1, 1)),
        300.0,
        steps=steps,
    )
    rng = np.random.default_rng(1)
    table = np.zeros((samples * steps, 7, 1))
    table[:400, 0] = rng.standard_normal((400, 1))
    table[200:600, 6] = 500 * rng.standard_normal((400, 1))  # about z, as all axes
    found = loop.run(np.zeros((1, 1, 2)), samples, disturbances=table)
    M = derive(model).function("mass_matrix")(np.zeros(3)).full()
    push = np.concatenate([np.zeros(model.dof), np.linalg.solve(M, np.ones(3)), [0.0]])[:, None]
    phi, gamma = constant(A, np.hstack([B, push]), T / steps)
    x = np.zeros(len(A))
    for k in range(samples):
        assert found.q_m[k, 0, 0] == pytest.approx(x[3], abs=1e-11)
        for step in range(steps):
            x = phi @ x + gamma @ table[k * steps + step, [0, 6], 0]
    with pytest.raises(ArgumentError, match="needs a library with forward_dynamics_tool_force"):
        other = ClosedLoop(
            model,
            library_with(model, ("forward_dynamics",)),
            DriveHardware(T),
            law,
            np.zeros((1, 3)),
            np.zeros((1, 1)),
            300.0,
            steps=steps,
        )
        other.run(np.zeros((1, 1, 2)), samples, disturbances=table)


def test_sensors_show_the_motion_with_bias_resolution_and_delay():
    model = flexgen.read(
        "planar5_nmp",
        overrides={
            "sensor": [
                {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"}
            ]
        },
    )
    library = library_with(model, ("forward_dynamics", "sensors"))
    q_m = (model.eta @ np.array(model.home))[None]
    local = LocalModel(model, ())
    rest = local.rest(local.values, q_m)
    c = library.sizes["n_s"]

    def run(channels: SensorChannels) -> tuple[np.ndarray, np.ndarray]:
        loop = ClosedLoop(
            model,
            library,
            DriveHardware(T),
            default_cascade(model),
            rest.y[:, : model.n_a],
            q_m,
            700.0,
            sensors=channels,
        )
        loop.hold(rest.tau_m)
        reference = np.zeros((120, 1, 2 + c + 2))
        reference[:, 0, :2] = q_m + 0.02 * (1 - np.cos(np.arange(120) * T * 60))[:, None]
        reference[:, 0, 2 + c :] = rest.tau_m
        found = loop.run(reference, 120, motion=True)
        assert found.sensors is not None and found.motion is not None
        return found.sensors[:, 0], found.motion[:, :, 0]

    plain, motion = run(SensorChannels.ideal(c))
    q_a, v_a, q, v, tau = np.split(motion, np.cumsum([model.n_a, model.n_a, 2, 2]), axis=1)
    a_a = library.forward_dynamics(*map(np.ascontiguousarray, (q_a, v_a, q, v, tau))).a_a
    exact = library.sensors(*map(np.ascontiguousarray, (q_a, v_a, a_a)))
    assert np.array_equal(plain, exact)
    at_rest = plain[0]
    assert np.linalg.norm(at_rest) == pytest.approx(9.81, rel=1e-6)  # gravity
    assert np.abs(plain - plain[0]).max() > 0.1
    shown, _ = run(SensorChannels(np.zeros(c), np.full(c, 0.25), np.full(c, 0.5), np.full(c, 4)))
    late = np.vstack([np.repeat(plain[:1], 4, axis=0), plain[:-4]])
    assert np.allclose(shown, np.floor((late + 0.25) / 0.5 + 0.5) * 0.5)


def test_the_energy_balance_of_a_run_closes():
    """Work of the torques less losses is the change of the energy; the integral by the trapezoidal
    rule, order two.
    """
    model = flexgen.read("planar5_nmp")
    library = library_with(model, ("forward_dynamics",))
    equations = derive(model)
    misses = []
    for steps in (1, 2):
        h = T / steps
        loop, at_rest, _, _ = loop_of(model, DriveHardware(h), controller=default_cascade(model))
        t = np.arange(600 * steps) * h
        reference = np.tile(at_rest, (len(t), 1, 1))
        reference[:, 0, :2] += 0.2 * (1 - np.cos(2 * np.pi * 4 * t))[:, None]
        found = loop.run(reference, len(t), motion=True)
        assert found.motion is not None
        q_a, v_a, q, v, _ = np.split(
            found.motion[:, :, 0], np.cumsum([model.n_a, model.n_a, 2, 2]), axis=1
        )
        kinetic, potential = (
            x.ravel() for x in evaluate(equations.function("energy"), q_a, v_a, q, v)
        )
        loss = evaluate(equations.function("power"), q_a, v_a, q, v, found.tau_m[:, 0])[1].ravel()
        # the torque is constant between samples
        work = (found.tau_m[:-1, 0] * np.diff(q, axis=0)).sum()
        lost = h * (loss[1:] + loss[:-1]).sum() / 2
        energy = kinetic + potential
        misses.append(abs(work - lost - (energy[-1] - energy[0])) / np.ptp(energy))
    assert misses[0] < 2e-4 and misses[1] < 0.3 * misses[0], misses
    del library
