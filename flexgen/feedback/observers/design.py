"""Designs of observers: names of states, noises of the model, and whether the outputs determine
the state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.channels import Channels
from flexgen.feedback.loop.noises import Noises
from flexgen.feedback.loop.sampled_model import PoseModel
from flexgen.feedback.sampled_plant import hold_effects
from flexgen.model.elements import RobotModel

NOT_SEEN = 1e-9  # smallest singular value of the test, relative: below it a state does not show
DECAYS = 1e-3  # 1/s: modes that decay faster need not show
LINE = 64  # bytes of a cache line
SHARE = 0.1  # entries of a vector of states that are named, relative to its largest


def state_names(model: RobotModel, disturbances: bool) -> tuple[str, ...]:
    """Names of the states: arm, motors behind elastic gears, their speeds, disturbances of the
    motors.
    """
    motors = [motor.name for motor in model.motors]
    y = [*(c.name for c in model.coordinates), *(motors[j] for j in model.i_m)]
    own = [f"disturbance of {name}" for name in motors] if disturbances else []
    return (*y, *(f"speed of {name}" for name in y), *own)


def tool_force_noise(at: PoseModel, sample_s: float, force: float) -> np.ndarray:
    """Covariance (n_x, n_x) that a force on the tool, white noise held in each sample, adds to the
    state.
    """
    pushed = hold_effects(at.A, at.push, sample_s, 0.0)[1] * force
    return np.asarray(pushed @ pushed.T)


def process_noise(at: PoseModel, G: np.ndarray, noises: Noises, sample_s: float) -> np.ndarray:
    """Covariance (n_x + n_m, n_x + n_m) that a sample adds to the state and the disturbances: by
    noise of the torques, whose effect on the state is G, by the force on the tool, and by the
    random walk of the disturbances.
    """
    n_x, n_m = G.shape
    torque = G * (noises.torque * noises.largest)
    Q = np.zeros((n_x + n_m, n_x + n_m))
    Q[:n_x, :n_x] = torque @ torque.T + tool_force_noise(at, sample_s, noises.tool_force)
    Q[n_x:, n_x:] = np.diag((noises.rate * noises.largest) ** 2 * sample_s)
    return Q


def check_observable(
    at: PoseModel, channels: Channels, states: tuple[str, ...], noises: Noises, n_d: int
) -> None:
    """ArgumentError with the states that the outputs do not determine, unless these decay by
    themselves.

    The matrix ``(A - lambda; C)`` has full rank at every eigenvalue lambda that does not decay
    (Popov, Belevitch, Hautus); states are scaled: motors to the arm side, speeds by 10 1/s,
    disturbances by the largest torques.
    """
    n_x = len(at.A)
    n_z = len(at.A) + n_d
    A = np.zeros((n_z, n_z))
    A[:n_x, :n_x] = at.A
    A[:n_x, n_x:] = at.B[:, :n_d]
    C = np.zeros((len(channels.index), n_z))
    C[:, :n_x] = at.C[channels.index]
    model = channels.model
    n = n_x // 2
    scale = np.ones(n_z)
    scale[model.n_a : n] = np.abs(model.eta).max(axis=1)[list(model.i_m)]  # motors on the arm side
    scale[n:n_x] = 10.0 * scale[:n]  # 1/s
    scale[n_x:] = noises.largest[:n_d]
    A = A * scale / scale[:, None]
    C = C * scale
    sizes = np.linalg.norm(C, axis=1)
    C = C / np.where(sizes > 0, sizes, 1.0)[:, None]
    values = np.linalg.eigvals(A)
    slow = [value for value in values if value.real > -DECAYS]
    hidden: list[str] = []
    for value in [0.0, *slow]:
        rows = A - value * np.eye(n_z)
        lengths = np.maximum(np.linalg.norm(rows, axis=1), 1e-12)
        _, size, right = np.linalg.svd(np.vstack([rows / lengths[:, None], C]))
        for vector in right[size < NOT_SEEN * size[0]]:
            parts = np.abs(vector)
            hidden += [states[i] for i in np.flatnonzero(parts > SHARE * parts.max())]
    if hidden:
        # which null vector comes first depends on rounding
        names = [name for name in states if name in hidden]
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        raise ArgumentError(
            f"outputs: given {', '.join(channels.names)}, which do not determine "
            f"{', '.join(names[:8])}{more}; measure more, such as all motor angles ('motors')"
        )


def allocate_aligned(size: int) -> np.ndarray:
    """Zeros (size,) that begin at a cache line."""
    memory = np.zeros(size + LINE // 8)
    begin = -memory.ctypes.data % LINE // 8
    return memory[begin : begin + size]


def vector(name: str, given: Any, n: int) -> np.ndarray:
    """An argument (n,) of finite numbers."""
    x = np.asarray(given, dtype=float)
    if x.shape != (n,) or not np.isfinite(x).all():
        raise ArgumentError(f"{name}: given shape {x.shape}, expected ({n},), finite numbers")
    return x


def record(name: str, given: Any, count: int, n: int) -> np.ndarray:
    """An argument (count, n)."""
    x = np.ascontiguousarray(given, dtype=float)
    if x.shape != (count, n):
        raise ArgumentError(f"{name}: given shape {x.shape}, expected ({count}, {n})")
    return x
