"""Up to which frequency a robot that differs from its model learns.

A change d of the commanded path sends the torques ``P_y^-1 d`` and the references
``P_m P_y^-1 d`` of the model, with P_y, P_m from torques to output and motor angles. A robot P'
with the feedback C of its motors answers

    y = L d,     L = P'_y (I + C P'_m)^-1 (I + C P_m) P_y^-1,

and the error of the next run is ``(I - Q L) e``. Without a difference L is I, whatever C. Of
robots with softer and stiffer springs the spectral radius of ``I - Q L`` decides: the largest
frequency of the low pass Q is taken at which no error grows by more than `GROWTH` in a run, at any
frequency, at the begin, in the middle and at the end of the path.

Source: D. Bristow et al., IEEE Control Systems Magazine 26(3), 2006, eq. 12.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexgen.analysis.second_order import motor_rows
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.feedback.loop.gains import lowest_locked_hz
from flexgen.feedback.loop.margins import as_linear
from flexgen.feedback.loop.named_controllers import controller_of
from flexgen.feedback.loop.plants import LocalDynamics, plants_of
from flexgen.feedback.loop.sampled_model import output_jacobian

ROBOTS = {"soft": {"stiffness": 0.8}, "stiff": {"stiffness": 1.25}}
GROWTH = 1.05  # largest spectral radius of the error from run to run
SHARE = 0.7  # of the lowest locked frequency, where there is no linear feedback or no L
# Bands that are tried and frequencies that are looked at, over the lowest locked frequency.
LEAST = 0.3
MOST = 3.0
BANDS = 40
FREQUENCIES = 120


def learning_band(
    equations: Equations,
    motion: Sequence[np.ndarray],
    controller: Any,
    sample_s: float,
    delay_s: float,
) -> float:
    """Frequency of the low pass [Hz]; see the head of this module.

    Parameters
    ----------
    equations : Equations
        Without states of hysteresis.
    motion : sequence of arrays (k, ...)
        ``q_a v_a a_a q_m v_m a_m tau_m`` at some poses of the path.
    controller, sample_s, delay_s
        Of the robot, as for `flexgen.control`.
    """
    model = equations.model
    first = [x[:1] for x in motion]
    locked = lowest_locked_hz(model, first) or 10.0
    law, _ = controller_of(controller, model, sample_s, delay_s, first)
    linear = as_linear(law, sample_s, model.n_m)
    if linear is None or model.output.size != model.n_m:
        return SHARE * locked
    try:
        plants = plants_of(model, ROBOTS)
    except ArgumentError:
        return SHARE * locked
    names = tuple(p.name for p in plants.parameters)
    hz = locked * np.geomspace(0.1, 4.0 * MOST, FREQUENCIES)
    z = np.exp(2j * np.pi * hz * sample_s)
    A, B, C, D = (x[0] for x in linear.matrices)
    states = z[:, None, None] * np.eye(len(A)) - A
    feedback = D + C @ np.linalg.solve(states, np.broadcast_to(B, (len(hz), *B.shape)))
    late = np.exp(-2j * np.pi * hz * (delay_s + 0.5 * sample_s))
    feedback = late[:, None, None] * feedback
    W = evaluate(output_jacobian(equations), motion[0])[0]
    W = W.reshape(len(motion[0]), model.output.size, model.n_a)
    try:
        own = _responses(LocalDynamics(equations), motion, np.zeros(0), hz, W)
        local = LocalDynamics(derive(model, names))
        others = [_responses(local, motion, values, hz, W) for values in _mix(plants.values)]
        found = [_answers(own, other, feedback) for other in others]
    except (np.linalg.LinAlgError, SolverError):
        return SHARE * locked
    eigenvalues = np.concatenate([np.linalg.eigvals(L) for L in found])
    for band in locked * np.geomspace(MOST, LEAST, BANDS):
        Q = 1.0 / (1.0 + (hz / band) ** 4)
        if np.abs(1.0 - Q[None, :, None] * eigenvalues).max() <= GROWTH:
            return float(band)
    return LEAST * locked


def _mix(values: np.ndarray) -> np.ndarray:
    """Numbers (4, n_p) of soft and stiff robots (2, n_p), and of two with both by turns."""
    odd = np.arange(values.shape[1]) % 2 == 1
    turns = [np.where(odd, *pair) for pair in (values, values[::-1])]
    return np.concatenate([values, np.array(turns)])


def _responses(
    local: LocalDynamics,
    motion: Sequence[np.ndarray],
    values: np.ndarray,
    hz: np.ndarray,
    W: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """``P_y`` (k, f, n_y, n_m) [m or rad per N m] and ``P_m`` (k, f, n_m, n_m) [rad/(N m)]."""
    model = local.model
    M, D, K, B = local.matrices(motion, values)
    s = 2j * np.pi * hz[:, None, None]
    stiff = K[:, None] + s * D[:, None] + s**2 * M[:, None]
    right = np.broadcast_to(B[:, None], (len(B), len(hz), *B.shape[1:]))
    x = np.linalg.solve(stiff, right)
    return W[:, None] @ x[:, :, : model.n_a], motor_rows(model) @ x


def _answers(
    own: tuple[np.ndarray, np.ndarray],
    other: tuple[np.ndarray, np.ndarray],
    feedback: np.ndarray,
) -> np.ndarray:
    """``L`` (k, f, n_y, n_y): answer of a robot to changes of the commanded path."""
    unit = np.eye(feedback.shape[-1])
    torque = (unit + feedback @ own[1]) @ np.linalg.inv(own[0])
    return np.asarray(other[0] @ np.linalg.solve(unit + feedback @ other[1], torque))
