"""Data for the C code of `flexgen.feedback.loop.closed_loop`: the structure of the robots, and the
start of their noise.
"""

from __future__ import annotations

import ctypes

import numpy as np

ARRAYS = (
    "parameters memory resolution noise bias late gain delay torque_noise torque_max state "
    "torque pending shown scratch random status saturated"
).split()


class Robots(ctypes.Structure):
    """``loop_robots`` of closed_loop.c."""

    _fields_ = [
        *[
            (name, ctypes.c_int32)
            for name in (
                (
                    "lanes n_a n_m n_g n_y n_ref states steps delay_steps slots history disturbed"
                ).split()
            )
        ],
        ("sample_s", ctypes.c_double),
        *[
            (name, ctypes.c_void_p)
            for name in (
                "plant one pushed sensors parameters one_work plant_work controller memory"
            ).split()
        ],
        ("memory_size", ctypes.c_int64),
        *[
            (name, ctypes.c_void_p)
            for name in (
                "resolution noise bias delay late gain torque_noise torque_max disturbances "
                "pushing state torque pending shown scratch random status saturated record".split()
            )
        ],
        ("now", ctypes.c_int64),
        ("stop", ctypes.c_int32),
        ("together", ctypes.c_void_p),
        ("hysteresis", ctypes.c_void_p),
        ("n_z", ctypes.c_int32),
        ("encoder_terms", ctypes.c_int32),
        *[(name, ctypes.c_void_p) for name in "encoder_error signals wall torque_edges".split()],
        ("n_edges", ctypes.c_int32),
    ]


def seeds_of(seed: int, lanes: int) -> np.ndarray:
    """Start of the random numbers of each robot, (lanes, 4): SplitMix64 of the seed and the
    robot.
    """
    out = np.empty((lanes, 4), np.uint64)
    mask = 2**64 - 1
    x = (seed * 0x9E3779B97F4A7C15 + 0x2545F4914F6CDD1D) & (2**64 - 1)
    for lane in range(lanes):
        for k in range(4):
            x = (x + 0x9E3779B97F4A7C15) & mask
            z = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & mask
            z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
            out[lane, k] = z ^ (z >> 31)
    return out
