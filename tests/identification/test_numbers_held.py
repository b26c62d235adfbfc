"""Robots at rest against written forms: springs under gravity, tilts that trackers share,
vibration at the end.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import OptimizeResult
from scipy.stats import multivariate_normal

import flexgen
from flexgen.dynamics.mechanics import statics
from flexgen.dynamics.mechanics.equations import derive
from flexgen.identification.poses import components
from flexgen.identification.poses.components import Tilt
from flexgen.planning.fastest import residual_vibration
from flexgen.planning.fastest.time_search import TimeSearch


def test_motors_hold_an_arm_by_the_deflections_of_its_springs() -> None:
    """``q_m = N (q + tau / k)``, ``tau_m = tau / N``: the gravity of two links by hand, in the
    plane of the elbow.
    """
    model = flexgen.read("elbow")
    q = np.array([0.4, -0.7])
    g = 9.81
    upper, fore = (element.body for element in model.elements)
    length = 1.150
    first = -upper.mass * g * upper.com[2] * np.sin(q[0]) - fore.mass * g * length * np.sin(q[0])
    behind = -fore.mass * g * fore.com[0] * np.cos(q.sum())
    torque = np.array([first + behind, behind])
    found = statics.equilibrium_at(derive(model), q)
    assert_allclose(found.tau_g, torque, rtol=1e-12)
    stiffness = np.array([7.5189e6, 4.0999e6])
    ratio = np.array([1872 / 7, 757 / 3])
    assert_allclose(found.q_m - ratio * q, ratio * torque / stiffness, rtol=1e-9)
    assert_allclose(found.tau_m, torque / ratio, rtol=1e-9)
    assert found.q_a.tolist() == q.tolist()


def test_errors_that_others_tell_are_means_under_their_measurements() -> None:
    """Of normal tilts and noise: the conditional mean from the joint covariance of six
    coordinates.
    """
    rng = np.random.default_rng(1)
    B = rng.normal(size=(3, 6, 3))
    gap = rng.normal(size=(3, 2, 3))
    tilt = Tilt("arm", 0.2, np.array([0.5, 1.0, 2.0]), 1.0)
    found = components.predict_others(tilt, B, gap)
    for pose in range(3):
        shared = B[pose] @ np.diag([0.25, 1.0, 4.0]) @ B[pose].T
        for one, other in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
            seen = shared[other, other] + 0.04 * np.eye(3)
            mean = shared[one, other] @ np.linalg.inv(seen) @ gap[pose].ravel()[other]
            assert_allclose(found[pose].ravel()[one], gap[pose].ravel()[one] - mean, rtol=1e-9)


def test_the_likelihood_of_tilts_is_that_of_normal_errors() -> None:
    """Its value, without the constant, is that of SciPy; at the minimum no number can be changed
    to a lower one.
    """
    rng = np.random.default_rng(6)
    B = rng.normal(size=(16, 6, 3))
    r = 0.02 * rng.normal(size=(16, 6)) + np.einsum(
        "nij,nj->ni", B, [0.05, 0.1, 0.02] * rng.normal(size=(16, 3))
    )

    def value(x: np.ndarray) -> float:
        total = 0.0
        for one, slopes in zip(r, B, strict=True):
            sigma = np.exp(x[0]) * np.eye(6) + slopes @ np.diag(np.exp(x[1:])) @ slopes.T
            total -= multivariate_normal(np.zeros(6), sigma).logpdf(one) + 3 * np.log(2 * np.pi)
        return total

    least, x = components.likelihood(r, B)
    assert least == pytest.approx(value(x), rel=1e-9)
    for k in range(4):
        for change in (-0.02, 0.02):
            assert value(x + change * (np.arange(4) == k)) > least
    assert_allclose(np.exp(x / 2), [0.02, 0.05, 0.1, 0.02], rtol=0.6)


def test_a_search_that_runs_away_is_held_within_narrow_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the logarithms: from 12 below the start to 4 above it, instead of 25 and 10; the slopes
    are exact.
    """
    rng = np.random.default_rng(6)
    B = rng.normal(size=(5, 3, 3))
    r = rng.normal(size=(5, 3))
    asked: list[np.ndarray] = []

    def minimize(
        value: Any, start: np.ndarray, *, jac: bool, method: str, bounds: Any, options: Any
    ) -> OptimizeResult:
        asked.append(np.array(bounds) - start[:, None])
        assert jac and start[0] == pytest.approx(np.log((r**2).mean()))
        assert_allclose(start[1:], 2 * np.log(components.START_TILT))
        if len(asked) == 1:
            raise np.linalg.LinAlgError
        at = start + np.array([0.1, 5.0, 6.0, 7.0])
        _, slope = value(at)
        for k in range(4):
            step = 1e-5 * (np.arange(4) == k)
            assert slope[k] == pytest.approx(
                (value(at + step)[0] - value(at - step)[0]) / 2e-5, rel=1e-6, abs=1e-7
            )
        return OptimizeResult(fun=7.0, x=[1.0, 2.0, 3.0, 4.0])

    monkeypatch.setattr(components, "minimize", minimize)
    least, x = components.likelihood(r, B)
    assert least == 7.0 and x.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert_allclose(asked, [[[-25.0, 10.0]] * 4, [[-12.0, 4.0]] * 4])


@pytest.mark.parametrize("pushed", [None, False, True])
def test_the_vibration_at_the_end_needs_the_force_on_the_tool_where_there_is_one(
    pushed: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And tables of forces have its mean over each integration step, behind the torques of the
    motors.
    """
    asked: list[Any] = []
    monkeypatch.setattr(
        residual_vibration, "library_with", lambda *given, **more: asked.append((given[1], more))
    )
    given = {} if pushed is None else {"pushed": pushed}
    made = residual_vibration.ResidualVibration(derive(flexgen.read("elbow")), print, **given)
    ((functions, more),) = asked
    assert functions == (
        ("forward_dynamics", "forward_dynamics_tool_force") if pushed else ("forward_dynamics",)
    )
    assert more["per_point"] is True and more["progress"] is print and made._rate == 0.0
    force: Any = Made(held=lambda t, h: np.outer(t, np.arange(6.0)) + h)
    h = residual_vibration.SAMPLE_S / 4
    table = made._pushing(force, np.array([1.0, 1.0 + 4 * h]), 4)
    assert table.shape == (8, 8, 1) and not table[:, :2].any()
    assert_allclose(
        table[:, 2:, 0], np.outer(1.0 + h * (np.arange(8) + 0.5), np.arange(6.0)) + h, rtol=1e-12
    )
    assert made._memory(0, np.zeros(0), np.zeros(2)) == 0.0


@pytest.mark.parametrize(
    ("lowest", "sample", "window"),
    [(0.0, 1e-3, 0.4), (5.0, 1e-3, 0.4), (0.2, 1e-3, 5.0), (200.0, 1e-4, 0.04)],
)
def test_the_vibration_at_the_end_is_sampled_and_followed_as_the_robot_needs(
    lowest: float, sample: float, window: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drives of 1 ms made a robot of 300 Hz unstable, and 0.4 s were a small part of the period of
    one of 0.2 Hz.
    """
    monkeypatch.setattr(residual_vibration, "library_with", lambda *given, **more: None)
    monkeypatch.setattr(residual_vibration, "lowest_locked_hz", lambda *given: lowest)
    made = residual_vibration.ResidualVibration(derive(flexgen.read("elbow")), print)
    rest = statics.equilibrium_at(made.equations, np.array([0.4, -0.7]))
    trajectory: Any = {"q_a": rest.q_a[None], "q_m": rest.q_m[None], "tau_m": rest.tau_m[None]}
    assert len(made._choose_law(trajectory).speed_gain) == 2
    assert (made._sample, made._window) == pytest.approx((sample, window), rel=1e-12)
    assert made._rate > 0


def test_a_fast_motion_is_inverted_on_as_many_intervals_as_a_slow_one() -> None:
    """Intervals of 5 ms are a sixth of a motion of 30 ms: its fastest time law was 2.3 times as
    long as needed.
    """
    search: Any = Made(_resolving=np.inf)
    meshes = [TimeSearch.mesh(search, duration) for duration in (0.02, 0.1, 0.2, 1.0, 60.0)]
    assert_allclose(meshes, [5e-4, 2.5e-3, 5e-3, 5e-3, 5e-3])
