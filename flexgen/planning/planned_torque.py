"""The torque of a planned motion: a polynomial on each interval of its mesh, which may jump between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PPoly

from flexgen.simulation.hold import TorqueCommand
from flexgen.simulation.torque_curve import constant


@dataclass(frozen=True, repr=False)
class PlannedTorque(TorqueCommand):
    """Polynomials of the motor torques; ``time`` are the nodes of the mesh, ``values`` the torques that begin there.

    Attributes
    ----------
    coefficients : array (degree + 1, n, n_m)
        Of powers of the time from the start of each interval, the highest first.
    """

    coefficients: np.ndarray

    def title(self) -> str:
        """The torque in words."""
        degree = len(self.coefficients) - 1
        return f"polynomials of degree {degree} on {len(self.time) - 1} intervals"

    @property
    def edges(self) -> np.ndarray:
        """Instants [s] at which the torque may jump."""
        return self.time

    def between(self, begin: float, end: float) -> PPoly:
        """The torque (n_m,) as a polynomial of the instant between two edges; constant before and after all."""
        k = int(np.searchsorted(self.time, (begin + end) / 2)) - 1
        if k < 0 or k >= len(self.time) - 1:
            return constant(self.values[0 if k < 0 else -1], begin, end)
        return PPoly(self.coefficients[:, k : k + 1], self.time[k : k + 2])

    def at(self, instants: np.ndarray) -> np.ndarray:
        """The torque (k, n_m) at instants (k,) [s]; at an edge that of the interval that begins there."""
        t = np.clip(instants, self.time[0], self.time[-1])
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        powers = (t - self.time[k])[:, None] ** np.arange(len(self.coefficients) - 1, -1, -1)
        return np.asarray(np.einsum("kd,dkm->km", powers, self.coefficients[:, k]))

    def ripple(self, instant: float, curve: object) -> np.ndarray:
        """No ripple: the planned motion is that under this torque."""
        return np.zeros(self.values.shape[1])


def planned_torque(
    nodes: np.ndarray, c: np.ndarray, stages: np.ndarray, labels: tuple[str, ...], meta: dict[str, str]
) -> PlannedTorque:
    """The torque through values ``stages`` (N, s, n_m) at the relative places ``c`` (s,) of intervals."""
    s, h = len(c), np.diff(nodes)
    powers = np.arange(s - 1, -1, -1)
    relative = np.einsum("ds,nsm->dnm", np.linalg.inv(c[:, None] ** powers), stages)
    ends = relative.sum(axis=0)[-1]
    return PlannedTorque(
        time=nodes, values=np.vstack([relative[-1], ends]), labels=labels, hold="spline", sample_time=float(h.mean()),
        delay=0.0, meta=meta, coefficients=relative / h[None, :, None] ** powers[:, None, None],
    )  # fmt: skip
