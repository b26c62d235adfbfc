"""The sampled closed loop in C: exact for linear robots, of order four, with the delay, noise and limits it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from toolchain import needs_compiler

import flexgen
from flexgen.errors import ArgumentError, SolverError
from flexgen.identification.experiments.experiment import largest_rate
from flexgen.identification.experiments.plan import default_cascade
from flexgen.identification.local_model import LocalModel
from flexgen.inversion.model_library import library_with
from flexgen.loop.closed_loop import Cascade, ClosedLoop, DriveHardware
from flexgen.model.elements import RobotModel

pytestmark = needs_compiler

T = 5e-4


def loop_of(model: RobotModel, hardware: DriveHardware, lanes: int = 1, controller: Cascade | None = None, **more):
    """A loop at home, its feedforward included in the reference that comes with it."""
    local = LocalModel(model, ())
    q_m = np.tile(model.eta @ np.array(model.home), (lanes, 1))
    rest = local.rest(local.values, q_m)
    library = library_with(model, ("forward_dynamics",))
    cascade = controller or default_cascade(model)
    rate = largest_rate(local, q_m)
    loop = ClosedLoop(model, library, hardware, cascade, rest.y[:, : model.n_a], q_m, rate, **more)
    loop.hold(rest.tau_m)
    return loop, np.concatenate([q_m, rest.tau_m], axis=1), local, rest


def moving(at_rest: np.ndarray, n_m: int, samples: int, size: float = 0.05) -> np.ndarray:
    """References that start at rest and swing, one lane like the other but for the size."""
    t = np.arange(samples) * T
    swing = size * (1 - np.cos(2 * np.pi * 4.0 * t))
    reference = np.tile(at_rest, (samples, 1, 1))
    reference[:, :, :n_m] += swing[:, None, None] * (1 + 0.1 * np.arange(len(at_rest)))[:, None]
    return reference


@pytest.mark.parametrize("delay", [0, 3])
def test_a_linear_robot_follows_the_exact_discrete_loop(delay):
    """x(k+1) by the matrix exponential, the drive written again; delays are whole steps of the integrator."""
    model = flexgen.read("four_mass@high")
    steps = 32
    loop, at_rest, local, _ = loop_of(model, DriveHardware(T, delay_s=delay * T / steps), steps=steps)
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

    before, after = step(delay * T / steps), step(T - delay * T / steps)
    c = default_cascade(model)
    x, u, q_old, ref_old = np.zeros(2 * n), 0.0, 0.0, 0.0
    for k in range(samples):
        q, ref = x[model.n_a], reference[k, 0, 0]
        new = c.speed_gain[0] * ((ref - ref_old) / T + c.position_gain[0] * (ref - q) - (q - q_old) / T)
        assert found.q_m[k, 0, 0] == pytest.approx(q, abs=1e-10)
        assert found.tau_m[k, 0, 0] == pytest.approx(new, abs=1e-8)
        x = before[0] @ x + before[1] * u
        x = after[0] @ x + after[1] * new
        u, q_old, ref_old = new, q, ref


def final_angles(steps: int) -> np.ndarray:
    loop, at_rest, _, _ = loop_of(flexgen.read("planar5_nmp"), DriveHardware(T), steps=steps)
    loop.run(moving(at_rest, 2, 600, 0.2), 600)
    return np.concatenate([x.ravel() for x in loop.state])


def test_the_integrator_is_of_order_four():
    coarse, fine, finest = (final_angles(steps) for steps in (1, 2, 16))
    order = np.log2(np.abs(coarse - finest).max() / np.abs(fine - finest).max())
    assert 3.5 < order < 4.5, order


def test_robots_in_a_batch_do_not_disturb_each_other():
    """The same bits alone and among others, in whatever lane."""
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
        loop, at_rest, _, _rest = loop_of(model, noisy, lanes=4, seed=seed, controller=Cascade(*np.zeros((3, 2))))
        runs.append(loop.run(at_rest[None], 2000).q_m - at_rest[:, :2])
    assert np.array_equal(runs[0], runs[1]) and not np.array_equal(runs[0], runs[2])
    assert runs[0].std() == pytest.approx(1e-4, rel=0.02)  # 16,000 samples: 0.6 %
    lanes = runs[0][:, :, 0]
    assert np.abs(np.corrcoef(lanes.T) - np.eye(4)).max() < 0.1
    kurtosis = np.mean((runs[0] / runs[0].std()) ** 4)
    assert 2.7 < kurtosis < 3.1  # 3 for a Gaussian, 2.9 for the sum of twelve


def test_torque_noise_and_quantisation():
    model = flexgen.read("planar5_nmp")
    loop, at_rest, _, _ = loop_of(model, DriveHardware(T, torque_noise_Nm=0.5, encoder_resolution_rad=1e-3))
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


def test_an_unstable_loop_is_an_error_and_not_a_result():
    model = flexgen.read("planar5_nmp")
    gains = default_cascade(model)
    wild = replace(gains, speed_gain=1e3 * gains.speed_gain)
    loop, at_rest, _, _ = loop_of(model, DriveHardware(T), controller=wild)
    with pytest.raises(SolverError, match=r"robot 1 of 1: (not finite|controller failed) .*lower the gains"):
        for _ in range(20):
            loop.run(moving(at_rest, 2, 1000, 0.3), 1000)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"sample_s": 0.0}, "sample_s: given 0.0"),
        ({"sample_s": float("nan")}, "sample_s: given nan"),
        ({"delay_s": 1e-3}, "delay_s: given 0.001, expected >= 0, below sample_s"),
        ({"torque_noise_Nm": -1.0}, "torque_noise_Nm: given -1.0"),
        ({"encoder_noise_rad": float("inf")}, "encoder_noise_rad: given inf"),
    ],
)
def test_wrong_hardware_is_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        DriveHardware(**arguments)


def test_wrong_arrays_are_refused():
    model = flexgen.read("planar5_nmp")
    loop, _at_rest, _, _ = loop_of(model, DriveHardware(T))
    with pytest.raises(ArgumentError, match=r"reference: given shape \(1, 2, 4\), expected finite numbers"):
        loop.run(np.zeros((1, 2, 4)), 5)
    with pytest.raises(ArgumentError, match="expected finite numbers"):
        loop.run(np.full((1, 1, 4), np.nan), 5)
    with pytest.raises(ArgumentError, match="expected one for each of 2 motors"):
        loop_of(model, DriveHardware(T, torque_max_Nm=(1.0,)))
    with pytest.raises(ArgumentError, match="use a smaller sample time"):
        loop_of(model, DriveHardware(0.4), steps=1)
