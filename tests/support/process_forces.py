"""Forces of a cutter on the tool, as functions of time."""

from __future__ import annotations

import numpy as np

import flexgen

HZ, SIZE = 40.0, 300.0  # of a cutter with four flutes at 600 1/min, N
PLANE, SPACE = np.array([0.6, 0.8]), np.array([0.6, 0.48, 0.64])


def milling(duration: float, direction: np.ndarray = SPACE, size: float = SIZE, hz: float = HZ):
    """A sinusoidal force that begins and ends smoothly within 50 ms, as a function of time."""

    def force(t: np.ndarray) -> np.ndarray:
        r = np.clip(np.minimum(t, duration - t) / 0.05, 0.0, 1.0)
        window = r**4 * (35 - 84 * r + 70 * r**2 - 20 * r**3)
        return (size * np.sin(2 * np.pi * hz * t) * window)[:, None] * direction

    return force


def duration_of(equations) -> float:
    return flexgen.plan(equations).duration
