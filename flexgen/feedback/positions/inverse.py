"""The inverse of a position servo: the reference with which it sends given torques along given
motor angles.

    w = F(z)^-1 u / k_v - k_i h sum w
    f D r_f + k_p r_f = w + k_p q + D q,    r_f -> r by the inverse of the filter of the reference

All recursions are stable. Zeros of torque filters beyond the unit circle, and those of low-pass
filters at z = -1, are inverted by a least squares over the whole motion: what they lose is begun
before it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter
from scipy.sparse import csc_matrix, diags_array
from scipy.sparse.linalg import splu

from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.positions.servo import Servo
from flexgen.model.position_servo.filters import Filter

ROUGH = 1e-9  # weight of the second differences of an inverted filter, relative
AT_ONE = 1e-9  # of the sum of a filter's numerator: no zero at z = 1


def invert_servo(servo: Servo, gains: Cascade, torque: np.ndarray, q_m: np.ndarray) -> np.ndarray:
    """The reference (n, n_m) [rad] at the samples of a servo.

    Parameters
    ----------
    servo : Servo
    gains : Cascade
        Of its motors.
    torque : array (n, n_m) [N m]
        To send at the samples; constant at both ends.
    q_m : array (n, n_m) [rad]
        Motor angles that are measured there; at rest at both ends.

    Returns
    -------
    array (n, n_m) [rad]
        Without the constant that a servo without integral part needs to hold the first torque.

    Raises
    ------
    ArgumentError
        A gain is not positive, a filter does not pass a constant, or the inverse is unstable.
    """
    h = servo.sample_time
    f = servo.speed_feedforward
    a = servo.part_per_sample
    given = {
        name: np.asarray(getattr(gains, name), float) for name in ("position_gain", "speed_gain")
    }
    for name, values in given.items():
        if not (values > 0.0).all():
            raise ArgumentError(
                f"servo, {name}: given {values}, expected numbers > 0: else it follows no "
                "reference"
            )
    k_i = np.asarray(gains.integral_gain, float)
    if not (k_i >= 0.0).all():
        zeros = ", ".join(f"{1.0 / (1.0 + k * h):.6g}" for k in k_i if not k >= 0.0)
        raise ArgumentError(
            f"servo, integral_gain: given {k_i}, expected numbers >= 0: the zero of the servo "
            f"at z = 1/(1 + k_i h) = {zeros} is not within the unit circle, so its inverse is "
            "unstable"
        )
    w = _invert_filters(gains.filters, h, torque - torque[0]) / given["speed_gain"]
    q = q_m - q_m[0]
    r = np.empty_like(q_m)
    Dq = np.diff(q, axis=0, prepend=q[:1]) / h
    for j, k_p in enumerate(given["position_gain"]):
        own = lfilter([1.0, -1.0], [1.0 + k_i[j] * h, -1.0], w[:, j])
        r[:, j] = lfilter([1.0], [k_p + f / h, -f / h], own + k_p * q[:, j] + Dq[:, j])
    if a < 1.0:
        r = lfilter([1.0 / a, 1.0 - 1.0 / a], [1.0], r, axis=0)
    return np.asarray(r + q_m[0])


def holding_offset(gains: Cascade, torque: np.ndarray) -> np.ndarray:
    """Reference minus angle (n_m,) [rad] at rest under a torque: zero for a motor with an integral
    part.
    """
    k_p, k_v, k_i = (
        np.asarray(x, float) for x in (gains.position_gain, gains.speed_gain, gains.integral_gain)
    )
    return np.asarray(np.where(k_i > 0.0, 0.0, torque / (k_p * k_v)))


def _invert_filters(filters: Sequence[Filter], h: float, u: np.ndarray) -> np.ndarray:
    """Input of filters whose output is ``u`` (n, n_m), zero before it."""
    for each in reversed(filters):
        b0, b1, b2, a1, a2 = each.section(h)
        b = np.array([b0, b1, b2])
        total = b0 + b1 + b2
        if abs(total) < AT_ONE * np.abs(b).sum():
            raise ArgumentError(
                f"servo: given the filter {each}, with a zero at z = 1, expected one that "
                "passes a constant"
            )
        n = len(u)
        N = csc_matrix(diags_array(list(b / total), offsets=[0, -1, -2], shape=(n, n)))
        R = csc_matrix(diags_array([1.0, -2.0, 1.0], offsets=[0, -1, -2], shape=(n, n)))
        wanted = N.T @ lfilter(np.array([1.0, a1, a2]) / total, [1.0], u, axis=0)
        u = splu(csc_matrix(N.T @ N + ROUGH * (R.T @ R))).solve(wanted)
    return u
