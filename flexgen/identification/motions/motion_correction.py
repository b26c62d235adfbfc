"""Frequency responses corrected for the size of the motions, with a model that was fitted to them
before.

    G - (G_n - G_l)
    G_n, G_l: responses of the model to the recorded torques, nonlinear and linear

The robot is not linear: at a mean speed of 0.05 rad/s its responses differ from those at rest by
about 1e-4.
"""

from __future__ import annotations

import copy
from contextlib import suppress
from dataclasses import replace

import casadi as ca
import numpy as np

from flexgen.base.errors import BuildError
from flexgen.codegen.build.casadi_module import in_c
from flexgen.identification.estimator.problem import normal
from flexgen.identification.experiments.plan import default_cascade
from flexgen.identification.responses.frequency_response import Frf, gains_of
from flexgen.identification.responses.large_motions import OVERSAMPLING, LargeMotions
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_outputs import channels

# in the motions of an experiment: to compile for, and more than minutes allow
MANY = 300_000
MOST_NUMBERS = 30_000_000
# standard deviation of a correction, as a part of it: with the gains of the drives, without
UNSURE = 0.1, 1.0


def obstacle(data: Frf) -> str:
    """Why responses cannot be corrected; empty where they can."""
    if data.torques is None:
        return "they have no spectra of the torques of a periodic motion"
    return "the periods are too long" if _count(data) > MOST_NUMBERS else ""


def _count(data: Frf) -> int:
    """Numbers in the motions of the motors."""
    assert data.torques is not None and data.numbers is not None
    return int(data.torques[:, :, 0].size * OVERSAMPLING * data.numbers[-1])


def _compile(function: ca.Function) -> ca.Function:
    """The function in C, where there is a compiler."""
    with suppress(BuildError):
        function = in_c(function)
    return function


def correct_responses(residuals: Residuals, x: np.ndarray) -> tuple[Frf, float]:
    """The responses of a fit corrected to small motions, and the relative uncertainty of the
    correction.
    """
    data = residuals.data
    known = data.gains is not None and bool(data.gains[1].any())
    gains = data.gains if known else gains_of(default_cascade(residuals.vector.model))
    change = _change(residuals, x, np.asarray(gains))
    noise = None if data.noise_YU is None else data.noise_YU - change @ data.noise_UU
    return replace(data, G=data.G - change, noise_YU=noise), UNSURE[0 if known else 1]


def find_shift(residuals: Residuals, x: np.ndarray, A: np.ndarray, G: np.ndarray) -> np.ndarray:
    """Difference (n,) of the minimum x and that of other responses G; ``A = Re J^H J`` at x."""
    r, J = residuals.weight(x, True)
    away = r - residuals.against(G).weight(x, False)[0]
    return np.linalg.solve(A + np.diag(residuals.vector.prior_sd**-2.0), normal(away, J)[1])


def _change(residuals: Residuals, x: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Change of the responses by the size of the motions, ``G_n - G_l`` (k, lines, outputs, n_m).

    G_n: the periodic motion of the nonlinear robot under the measured torques U, times the
    pseudoinverse of U, mean over the runs; G_l: the linear robot, both without images of sampling.
    At other lines than those of U the drives with ``gains`` (3, n_m), as in `Frf`, close the loop.
    """
    data = residuals.data
    local = residuals.local
    model = residuals.vector.model
    assert data.torques is not None and data.numbers is not None
    values, rest = residuals.rest(x)
    M, D, K, B = local.matrices(values, data.poses, data.speed_sd, residuals.deflection_sd)
    drive = residuals.vector.drive_at(x, residuals.drive)
    # Multiples of the lowest frequency; motions of second order reach twice the largest one.
    lines = data.numbers
    speed = data.w[0] / data.numbers[0]
    w = speed * np.arange(2 * lines[-1] + 1)
    s = 1j * np.where(w > 0, w, 1e-3 * speed)[:, None, None]  # an integral has no gain at zero
    position, gain, integral = gains
    inward = drive.transfer(w, model.n_m)[:, None, :]
    h = data.sample_s
    rate = (1 - np.exp(-s * h)) / h if h else s  # the speed of a drive is a difference of samples
    answer = inward * gain * (rate + position) * (1 + integral / s)
    outward = local.outputs.transfer(data.w, drive.sensor_delays)[..., None]
    compiled = _compile if _count(data) > MANY else lambda function: function
    motions = LargeMotions(
        local.equations, values, [channels(model).index(name) for name in data.sensors], compiled
    )
    continuous = copy.copy(residuals)
    continuous.drive = replace(residuals.drive, has_images=False)
    change = -continuous.response(x).G
    for k, runs in enumerate(data.torques):
        Z = s**2 * M[k] + s * D[k] + K[k]
        for U in runs:
            linear = np.linalg.solve(Z[lines], (B[k] * inward[lines]) @ U)
            found = motions.outputs(
                rest.y[k], lines, speed, Z, (B[k] * answer) @ local.motor_rows, linear
            )
            change[k] += outward * found @ np.linalg.pinv(U) / len(runs)
    return change
