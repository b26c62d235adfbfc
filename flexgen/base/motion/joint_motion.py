"""Motion of joints that is given as a spline, such as a filtered record or shaped commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline


@dataclass(frozen=True, eq=False)
class JointMotion:
    """A motion of the joints: ``spline`` of (n_g,) [rad or m] over the time [s].

    ``begin``, ``end`` [s]; ``step`` [s]: of the samples. ``edge`` [s]: the half length of the
    filter of a record; so near to the begin and the end of it the filter reaches beyond it.
    """

    spline: BSpline
    begin: float
    end: float
    step: float
    edge: float

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Positions, speeds and accelerations (n, n_g) at instants (n,) [s]."""
        speed = self.spline.derivative(1)
        acceleration = self.spline.derivative(2)
        return self.spline(time), speed(time), acceleration(time)
