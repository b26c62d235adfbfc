"""The smoother along a motion: the mean of a normal distribution that is conditioned on all
measurements at once.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag, expm, solve_discrete_are

import flexgen
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.sampled_model import PoseModel
from flexgen.planning.learning import smoother
from flexgen.planning.learning.smoother import PathSmoother

H = 4e-3


def pose() -> PoseModel:
    """Two masses with springs and a motor each; their angles, a channel that is not used, an
    accelerometer.
    """
    K = np.array([[3e3, -2e3], [-2e3, 2.5e3]])
    D = np.array([[4.0, -1.0], [-1.0, 3.0]])
    n = 2
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -D]])
    B = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [0.2, 0.8]])
    arm = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    C = np.vstack([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], np.zeros(4), A[3]])
    D_u = np.vstack([np.zeros((3, 2)), [0.2, 0.8]])
    D_arm = np.vstack([np.zeros((3, 2)), [1.0, -1.0]])
    return PoseModel(A, B, np.zeros((4, 3)), arm, C, D_u, D_arm, np.zeros((1, 4)))


def test_gains_give_the_mean_of_all_states_under_all_measurements() -> None:
    """Forces fade in 0.3 s; noise of the torque 1e-3 of the largest one; disturbances grow by 0.1
    of it in a second.
    """
    at = pose()
    force = np.array([2.0, 0.7])
    noise = np.array([1e-4, 2e-4, 0.05])
    largest = np.array([40.0, 25.0])
    model: Any = Made(motors=[Made(torque_max=x) for x in largest], n_m=2, n_a=2)
    made = object.__new__(PathSmoother)
    channels = Made(index=np.array([0, 1, 3]), noise=noise)
    torque = Noises(model, smoother.TORQUE_NOISE, smoother.DISTURBANCE_RATE)
    vars(made).update(
        channels=channels,
        model=model,
        sample_s=H,
        samples=100,
        _begin=0,
        _torque=torque,
        _force=force,
    )
    gains = made._gains(at)
    made._F, made._G, made._C, made._D, made._M, made._J = (x[None] for x in gains)

    # states: 4 of the masses, disturbances of both motors, two forces
    n = 25
    fade = np.exp(-H / 0.3)
    held = expm(H * np.block([[at.A, at.B * largest, at.arm * force], [np.zeros((4, 8))]]))
    F = np.vstack([held[:4], np.eye(8)[4:] * [1, 1, 1, 1, 1, 1, fade, fade]])
    G = np.vstack([held[:4, 4:6] / largest, np.zeros((4, 2))])
    C = np.hstack([at.C, at.D * largest, at.D_arm * force])[[0, 1, 3]]
    D = at.D[[0, 1, 3]]
    w = np.vstack([held[:4, 4:6] * 1e-3, np.zeros((4, 2))])
    Q = w @ w.T + np.diag([0.0] * 4 + [0.1**2 * H] * 2 + [1 - fade**2] * 2)
    R = np.diag(noise**2)
    first = solve_discrete_are(F.T, C.T, Q, R)
    rng = np.random.default_rng(2)
    dy = rng.normal(size=(n, 3)) * noise * 3
    du = rng.normal(size=(n, 2))
    dy[0] = du[0] = 0.0  # what is taken off
    driven = []
    z = np.zeros(8)
    for k in range(n):
        z = F @ z + G @ du[k]
        driven.append(z)
    powers = [np.eye(8)]
    for _ in range(n):
        powers.append(F @ powers[-1])
    maps = np.block(
        [[powers[j - i] if i <= j else np.zeros((8, 8)) for i in range(n)] for j in range(n)]
    )
    prior = maps @ block_diag(first, *[Q] * (n - 1)) @ maps.T  # of all states
    all_C = block_diag(*[C] * n)
    seen = (dy - np.array(driven) @ C.T - du @ D.T).ravel()
    gain = np.linalg.solve(all_C @ prior @ all_C.T + block_diag(*[R] * n), all_C @ prior).T
    expected = np.array(driven) + (gain @ seen).reshape(n, 8)
    size = np.abs(expected[:, :2]).max()
    assert_allclose(made.deviation(dy, du), expected[:, :2], rtol=0, atol=1e-8 * size)


def test_expected_forces_are_shares_of_their_change_along_the_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fiftieth of the loads of coordinates with elastic gears, a fifth of the others and of the
    springs of gears.
    """
    model = flexgen.read("planar5_nmp")
    geared = [c.dof is not None and c.dof.gear is not None for c in model.coordinates]
    made = object.__new__(PathSmoother)
    made.model = model
    tau = np.zeros((3, model.n_a))
    tau[:, 0] = [7.0, 9.0, -3.0]
    tau[:, 1] = [5.0, 5.0, 5.0]
    tau[1, 2:] = -2.0
    library = Made(inverse_dynamics=lambda *_: tau)
    monkeypatch.setattr(smoother, "library_with", lambda model, names: library)
    motion = {name: np.zeros((3, model.n_a)) for name in ("q_a", "v_a", "a_a")}
    # at least a thousandth of the largest
    change = np.array([10.0, 0.01, *[2.0] * (model.n_a - 2)])
    share = np.where(geared, 0.02, 0.2)
    assert 0 < sum(geared) < model.n_a
    found = made._forces(Made(motion=motion))  # type: ignore[arg-type]
    assert_allclose(found, np.concatenate([share * change, 0.2 * change[geared]]))
    tau[:] = 4.0
    assert_allclose(made._forces(Made(motion=motion))[: model.n_a], share * 1e-6)


def test_a_motion_has_gains_at_forty_places(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(smoother, "PoseModels", lambda model: Made(at=lambda motion: motion[0][0]))
    monkeypatch.setattr(PathSmoother, "_forces", lambda self, reference: np.ones(1))

    def gains(self: PathSmoother, at: float) -> tuple[np.ndarray, ...]:
        asked.append(at)
        return (np.full(1, at),) * 6

    monkeypatch.setattr(PathSmoother, "_gains", gains)
    model: Any = Made(motors=[Made(torque_max=2.0)])
    for count, samples in ((80, 2), (81, 3)):
        parts = -(-count // samples)
        time = 0.1 * np.arange(count) - 1.0
        reference: Any = Made(
            time=time, begin=-0.45, parts=lambda n, k=parts: (np.arange(float(k)),) * 7
        )
        asked.clear()
        made = PathSmoother(Made(model=model), reference, 0.1)  # type: ignore[arg-type]
        assert (
            made.samples == samples and made._begin == 6 and asked == list(np.arange(float(parts)))
        )
        assert (made._torque.torque, made._torque.rate) == (1e-3, 0.1)
        assert_allclose(made._J[:, 0], asked)
