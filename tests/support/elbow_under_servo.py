"""The elbow arm under a position servo, from Lagrange's equations written by hand; shares no code
with flexgen.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from servo_in_mujoco import OwnServo

# of servo, interface and record
H = 5e-4
PERIOD = 4e-3
SECONDS = 3.0
TIME = PERIOD * np.arange(round(SECONDS / PERIOD) + 1)
START = np.radians([30.0, -20.0])
RATIO = np.array([1872 / 7, 757 / 3])
ROTOR = 0.0118  # kg m^2
STIFFNESS = np.array([7.5189e6, 4.0999e6])
DAMPING = np.array([1400.0, 600.0])
M = (339.12, 190.25)
COM = (0.441, 0.465)
INERTIA = (88.67, 48.64)
UPPER = 1.150


def _gravity(q: np.ndarray) -> np.ndarray:
    """Torques of both joints that hold the arm."""
    fore = -9.81 * M[1] * COM[1] * np.cos(q[0] + q[1])
    return np.array([fore - 9.81 * (M[0] * COM[0] + M[1] * UPPER) * np.sin(q[0]), fore])


def _rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Of joints, motors and their speeds. The angle of the forearm is q1 + q2; T = A v1^2/2 + B
    w^2/2 + C v1 w.
    """
    q = x[:2]
    motors = x[2:4]
    v = x[4:6]
    speed = x[6:]
    spring = STIFFNESS * (motors / RATIO - q) + DAMPING * (speed / RATIO - v)
    A = M[0] * COM[0] ** 2 + INERTIA[0] + M[1] * UPPER**2
    B = M[1] * COM[1] ** 2 + INERTIA[1]
    C = -M[1] * UPPER * COM[1] * np.sin(q[1])
    slope = -M[1] * UPPER * COM[1] * np.cos(q[1])
    w = v[0] + v[1]
    held = _gravity(q)
    first = spring[0] - spring[1] - (held[0] - held[1]) - slope * w * w
    second = spring[1] - held[1] + slope * v[0] ** 2
    a, turn = np.array([B * first - C * second, A * second - C * first]) / (A * B - C * C)
    return np.concatenate([v, speed, [a, turn - a], (u - spring / RATIO) / ROTOR])


def commands() -> np.ndarray:
    """Two sines of each joint, from rest."""
    r = np.clip((TIME - 0.1) / 0.4, 0.0, 1.0)
    own = [
        0.12 * np.sin(4.4 * TIME) + 0.03 * np.sin(14.5 * TIME),
        0.03 * np.sin(18.2 * TIME) - 0.15 * np.sin(5.7 * TIME),
    ]
    return START + np.column_stack(own) * (r**3 * (10 - 15 * r + 6 * r**2))[:, None]


def follow(
    servo: Callable[..., OwnServo], command: Callable[[float], np.ndarray], late: int = 0
) -> np.ndarray:
    """Motor angles over the ratios, each `PERIOD`; ``command`` of a time [s] gives joints;
    ``late``: samples.
    """
    held = _gravity(START)
    at = (START + held / STIFFNESS) * RATIO
    own = servo(hold=held / RATIO, start=START * RATIO)
    x = np.concatenate([START, at, np.zeros(4)])
    sent = [held / RATIO] * (late + 1)
    out = []
    for k in range(round(SECONDS / H) + 1):
        out.append(x[2:4])
        sent.append(own.torque(command(k * H) * RATIO, x[2:4] - at + START * RATIO))
        u = sent[-1 - late]
        k1 = _rates(x, u)
        k2 = _rates(x + H / 2 * k1, u)
        k3 = _rates(x + H / 2 * k2, u)
        x = x + H / 6 * (k1 + 2 * k2 + 2 * k3 + _rates(x + H * k3, u))
    return np.array(out)[:: round(PERIOD / H)] / RATIO
