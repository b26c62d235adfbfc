"""Linear systems that are sampled, with the hold and the delay of a controller, and the delays of
its sensors.

dx' = A dx + B u,    y = C dx + D u
x_(k+1) = F x_k + G u_k,    x_k = (dx, torques under way, the oldest first)

What the torques do to outputs at once, D, is that of the torque which acts when the sample is
taken: the one before.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm


def hold_effects(
    A: np.ndarray, B: np.ndarray, sample_s: float, rest_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Effect (n, m) on the next sample of an input that acts until ``rest_s`` [s] after a sample,
    and of one that acts from there on: ``int exp(A t) B dt`` over each part.
    """
    n, m = B.shape

    def constant(h: float) -> tuple[np.ndarray, np.ndarray]:
        whole = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
        return whole[:n, :n], whole[:n, n:]

    phi, after = constant(sample_s - rest_s)
    return phi @ constant(rest_s)[1], after


def sample_model(
    A: np.ndarray, B: np.ndarray, sample_s: float, delay_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """``F`` and ``G`` of the sampled model ``x' = A x + B u`` whose torques act ``delay_s`` [s]
    later; the torques on their way are states, the oldest first, see the text of this module.
    """
    n, n_m = B.shape
    whole = int(delay_s / sample_s + 1e-9)
    rest = delay_s - whole * sample_s
    rest = rest if rest > 1e-9 * sample_s else 0.0
    before, after = hold_effects(A, B, sample_s, rest)
    late = whole + (1 if rest > 0 else 0)
    size = n + late * n_m
    F = np.zeros((size, size))
    G = np.zeros((size, n_m))
    F[:n, :n] = expm(A * sample_s)
    if late == 0:
        G[:n] = after
        return F, G
    for k in range(late - 1):
        F[n + k * n_m : n + (k + 1) * n_m, n + (k + 1) * n_m : n + (k + 2) * n_m] = np.eye(n_m)
    G[n + (late - 1) * n_m :] = np.eye(n_m)
    if rest == 0:
        F[:n, n : n + n_m] = after
        return F, G
    F[:n, n : n + n_m] = before  # the oldest acts until `rest`, the next one after it
    if late == 1:
        G[:n] = after
    else:
        F[:n, n + n_m : n + 2 * n_m] = after
    return F, G


def sampled_plant(
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    D: np.ndarray,
    sample_s: float,
    delay_s: float,
    late: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``F, G, Y``: x_(k+1) = F x_k + G u_k, y_k = Y x_k, where output i is shown ``late[i]``
    samples later; A, B, C, D: of the continuous model.

    With a direct term D the torque that acts when the sample is taken is a state too.
    """
    F, G = sample_model(A, B, sample_s, delay_s)
    (n, n_m) = B.shape
    n_y = len(C)
    Y = np.hstack([C, np.zeros((n_y, len(F) - n))])
    if D.any():
        on_time = abs(delay_s / sample_s - round(delay_s / sample_s)) < 1e-9
        if not on_time:
            Y[:, n : n + n_m] = D  # the oldest one acts when the next sample is taken
        else:  # the one before the oldest
            before = np.eye(n_m, len(F) - n, 0) if len(F) > n else np.zeros((n_m, 0))
            F = np.block(
                [[F, np.zeros((len(F), n_m))], [np.zeros((n_m, n)), before, np.zeros((n_m, n_m))]]
            )
            G = np.vstack([G, np.zeros((n_m, n_m)) if before.size else np.eye(n_m)])
            Y = np.hstack([Y, D])
    for i, count in enumerate(np.zeros(n_y, int) if late is None else late):
        for _ in range(count):  # the output as it was a sample before
            F = np.block([[F, np.zeros((len(F), 1))], [Y[i], 0.0]])
            G = np.vstack([G, np.zeros((1, n_m))])
            Y = np.hstack([Y, np.zeros((n_y, 1))])
            Y[i] = np.eye(1, len(F), len(F) - 1)
    return F, G, Y
