"""The force on the tool in a trajectory: its channel, and the curve between its samples."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PPoly

from flexgen.base.motion.torque_curve import spline, then_constant
from flexgen.base.motion.trajectory import Trajectory, channel_values

CHANNEL = "force"
LABELS = ("fx", "fy", "fz", "mx", "my", "mz")
UNITS = ("N", "N", "N", "N m", "N m", "N m")


def read_force(data: Trajectory) -> np.ndarray:
    """Force and torque on the tool in a trajectory, (n, 6) [N, N m], world axes."""
    units = dict(zip(LABELS, UNITS, strict=True))
    return channel_values("trajectory", data, CHANNEL, units)


def interpolate_force(t: np.ndarray, samples: np.ndarray) -> PPoly:
    """The quintic spline through samples at the instants ``t`` (n,) [s], then constant."""
    own = samples[: len(t)]
    return then_constant(spline(t, own), own[-1])
