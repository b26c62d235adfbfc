"""The closed loop of a robot near a motion: what differences of torques and angles do, for scripts
of the gallery.
"""

from typing import Any

import numpy as np

import flexgen


def linearize_loop(
    robot: Any, m: Any, gains: flexgen.Cascade, step: float
) -> tuple[np.ndarray, ...]:
    """Matrices F, G, start of x(k + 1) = F x(k) + G d(k), x(0) = start d(0), at the samples of a
    motion m.

    x: deviations of the positions and speeds of arm and motors, and integrals of the P-PI
    feedback; d: deviations of motor torques, of motor angles and of motor speeds of the reference.
    A step is one of the trapezoidal rule, d(k) the mean of two samples. At the start the robot
    rests, its motors where the reference has them.
    """
    c = m.q_m.shape[1]
    a = m.q_a.shape[1]
    n = m.q_a.shape[1] + m.q_m.shape[1]

    def rate(A: np.ndarray, B: np.ndarray, x: np.ndarray, d: np.ndarray) -> np.ndarray:
        w = gains.position_gain[:, None] * (d[c : 2 * c] - x[a:n]) + d[2 * c :] - x[n + a : 2 * n]
        w = gains.speed_gain[:, None] * w
        return np.vstack(
            [A @ x[: 2 * n] + B @ (d[:c] + w + x[2 * n :]), gains.integral_gain[:, None] * w]
        )

    A, B = robot.linearize(m.q_a, m.v_a, m.q_m, m.v_m, m.tau_m)
    x = np.eye(2 * n + c, 2 * n + 4 * c)
    d = np.eye(3 * c, 2 * n + 4 * c, 2 * n + c)
    CD = np.array([rate(*pair, x, d) for pair in zip(A, B, strict=True)])
    C, D = np.split(step / 2 * (CD[1:] + CD[:-1]), [2 * n + c], axis=2)
    inverse = np.linalg.inv(np.eye(2 * n + c) - C / 2)
    # arm and torque, motors at q_m
    rest = np.linalg.solve(np.hstack([A[0, n:, :a], B[0, n:]]), -A[0, n:, a:n])
    start = np.zeros((2 * n + c, 3 * c))
    start[:n, c : 2 * c] = [*rest[:a], *np.eye(c)]
    start[2 * n :, c : 2 * c] = rest[a:]
    start[2 * n :, :c] = -np.eye(c)
    return inverse @ (np.eye(2 * n + c) + C / 2), inverse @ D, start


def largest_outputs(loop: tuple[np.ndarray, ...], W: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Largest sizes (robots,) of the outputs W(k) x(k), for deviations d (samples, inputs,
    robots).
    """
    F, G, start = loop
    x = start @ d[0]
    forced = G @ (d[1:] + d[:-1]) / 2
    largest = np.zeros(d.shape[2])
    for k in range(len(W)):
        largest = np.maximum(largest, np.linalg.norm(W[k] @ x[: W.shape[2]], axis=0))
        x = F[k] @ x + forced[k] if k < len(F) else x
    return largest
