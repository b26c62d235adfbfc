"""The force on the tool in a trajectory: its channel, and the curve between its samples."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PPoly

from flexgen.errors import ArgumentError
from flexgen.torque_curve import spline, then_constant
from flexgen.trajectory import Trajectory

CHANNEL = "force"
LABELS = ("fx", "fy", "fz", "mx", "my", "mz")
UNITS = ("N", "N", "N", "N m", "N m", "N m")


def read_force(data: Trajectory) -> np.ndarray:
    """Force and torque on the tool in a trajectory, (n, 6) [N, N m], world axes."""
    values = np.asarray(data[CHANNEL], float)
    labels, units = data.labels[CHANNEL], data.units[CHANNEL]
    if tuple(labels) != LABELS or tuple(units) != UNITS or not np.isfinite(values).all():
        raise ArgumentError(
            f"trajectory channel {CHANNEL}: given columns {', '.join(labels)} in {', '.join(units)}, expected "
            f"{', '.join(LABELS)} of finite numbers in {', '.join(UNITS)}"
        )
    return values


def interpolate_force(t: np.ndarray, samples: np.ndarray) -> PPoly:
    """The quintic spline through samples at the instants ``t`` (n,) [s], then constant."""
    own = samples[: len(t)]
    return then_constant(spline(t, own), own[-1])
