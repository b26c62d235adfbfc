"""Do 95 % of the true values lie inside the stated intervals, where noise moves the motors as much
as the excitation?

Spectra of a closed loop are made here: exact responses of the robot, drives, noise of encoders and
torques. Nothing of that is told to the fit. The whole chain, with simulated experiments, is in
benchmarks/uncertainty/intervals.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, without_coulomb

import flexgen
from flexgen.dynamics.mechanics.parameters import with_values
from flexgen.identification.estimator.minimize import minimize
from flexgen.identification.responses import residuals
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_estimates import estimate
from flexgen.identification.responses.response_inputs import Drive

pytestmark = pytest.mark.slow
DRAWS = 20  # of 160 intervals
LEAST = 0.9  # 2.9 standard deviations below 95 %
# amplitude of the speed of a motor at a line, rad/s
PERIODS = 4
LINES = 300
SPEED = 0.5
ENCODER = 6e-5  # amplitudes of the noise at a line
TORQUE = 6e-3  # rad and N m
GAIN = 50.0  # speed gain over inertia, 1/s
LIGHT = {"m2.inertia": 2e-4, "m2.viscous": 1e-3}


class Loop:
    """A robot under P-PI control at two poses, and the fit of its parameters."""

    def __init__(self, torque: float = TORQUE) -> None:
        self.torque = torque
        model = with_values(without_coulomb("planar5_nmp"), LIGHT)
        w = 2 * np.pi * np.geomspace(2.0, 80.0, LINES)
        self.exact = exact_responses(model, poses_of(model, 2), w, Drive(5e-4))
        inertia = np.array([motor.inertia for motor in model.motors])
        self.gain = np.eye(2) * inertia * GAIN * (8.0 + 1j * w[:, None, None])
        self.vector = ParameterVector(model, ["stiffness", "damping", "m1.viscous", "m2.viscous"])
        self.residuals = Residuals(self.vector, self.exact)

    def responses(self, rng: np.random.Generator) -> flexgen.Frf:
        """Estimated from periods with noise: ``u = K (r - q - n_y)``,
        ``q = -G (u + n_u) / w^2``.
        """
        w = self.exact.w[:, None, None]
        G = self.exact.G[:, None, None] / -(w**2)

        def noise(size: float) -> np.ndarray:
            x = rng.normal(size=(2, 2, 1, PERIODS, LINES, 2, 2)) * size / np.sqrt(2)
            return x[0] + 1j * x[1]

        reference = SPEED / w * np.exp(2j * np.pi * rng.uniform(size=(2, 1, 1, LINES, 2, 2)))
        encoder = noise(ENCODER)
        torque = noise(self.torque)
        away = self.gain @ (reference - encoder - G @ torque)
        U = np.linalg.solve(np.eye(2) + self.gain @ G, away)
        Y = -(w**2) * (G @ (U + torque) + encoder)
        found = estimate(U, Y)
        return replace(
            self.exact,
            G=found.G,
            UU=found.UU,
            C=found.C,
            variance=found.variance,
            periods=PERIODS,
            noise_UU=found.noise_UU,
            noise_YU=found.noise_YU,
        )

    def errors(
        self, change: Callable[[flexgen.Frf], flexgen.Frf] = lambda data: data, draws: int = DRAWS
    ) -> np.ndarray:
        """Errors over stated deviations (draws, n), from the same draws for each change of the
        responses.
        """
        out = []
        start = self.vector.start
        for seed in range(draws):
            fit = self.residuals.on(change(self.responses(np.random.default_rng(seed))))
            fit.use_structure(start)
            found = minimize(fit.problem, start)
            assert found.converged
            out.append((found.x - start) / np.sqrt(np.diag(fit.covariance(found.x, found.A))))
        return np.array(out)


@pytest.fixture(scope="module")
def loop() -> Loop:
    return Loop()


def inside(errors: np.ndarray) -> float:
    return float(np.mean(np.abs(errors) < 1.96))


def test_95_percent_intervals_contain_95_percent_of_the_true_values(loop: Loop) -> None:
    """Planted: deviations half as large."""
    errors = loop.errors()
    assert LEAST <= inside(errors) <= 0.99
    assert inside(2 * errors) < LEAST
    assert np.abs(errors.mean(axis=0)).max() < 3.3 / np.sqrt(DRAWS)


def test_planted_weights_with_the_noise_of_the_loop_are_seen(loop: Loop) -> None:
    """The cost is not compensated for the noise of the torques."""
    assert inside(loop.errors(lambda data: replace(data, noise_UU=None, noise_YU=None))) < LEAST


def test_what_noise_of_the_torques_hides_has_a_large_deviation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ten times the noise; planted: its part of the information counts as all other."""
    loud = Loop(10 * TORQUE)
    assert np.abs(loud.errors(draws=3)).max() < 4.0
    monkeypatch.setattr(residuals, "MOST_BY_NOISE", 1.0)
    assert np.abs(loud.errors(draws=3)).max() > 8.0
