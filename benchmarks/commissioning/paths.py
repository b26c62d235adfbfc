"""Test paths of the tool: lines, a circle and a corner. No record has them.

The time law is s(t) = I(t / T; k + 1, k + 1), the regularized incomplete beta function, whose
first k derivatives vanish at both ends: `smoothness = k` of a move in a model file. The corner
is the sum of two lines whose times overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betainc

from benchmarks.commissioning.chains import Chain, inverse, rigid_pose, rotation

SMOOTHNESS = 5
OVERLAP = 0.6  # share of the time of each leg of a corner


@dataclass(frozen=True)
class Path:
    """A motion of the tool from the rigid pose at the start; the orientation stays."""

    name: str
    start_deg: tuple[float, ...]
    duration: float  # s
    legs: tuple[tuple[float, float, float], ...] = ()  # m: one of a line, two of a corner
    center: tuple[float, float, float] | None = None  # m, from the start, of a circle
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)  # of a circle
    turn_deg: float = 360.0  # of a circle

    def start(self) -> np.ndarray:
        """Joints (n,) [rad]."""
        return np.radians(self.start_deg)

    def share(self, time: np.ndarray) -> np.ndarray:
        """Time law of a leg (N,), between 0 and 1, over time / duration."""
        return np.asarray(betainc(SMOOTHNESS + 1, SMOOTHNESS + 1, np.clip(time, 0.0, 1.0)))

    def displacement(self, time: np.ndarray) -> np.ndarray:
        """Of the tool from the start (N, 3) [m] at times [s]; constant before and after."""
        relative = np.asarray(time) / self.duration
        if self.center is not None:
            center = np.array(self.center)
            angles = np.radians(self.turn_deg) * self.share(relative)
            unit = np.array(self.axis) / np.linalg.norm(self.axis)
            return np.array([center - rotation(unit, angle) @ center for angle in angles])
        if len(self.legs) == 1:
            return self.share(relative)[:, None] * np.array(self.legs[0])
        own = 1.0 / (2.0 - OVERLAP)  # share of a leg in the duration
        first = self.share(relative / own)[:, None] * np.array(self.legs[0])
        second = self.share((relative - 1.0 + own) / own)[:, None] * np.array(self.legs[1])
        return first + second

    def joints(self, chain: Chain, time: np.ndarray) -> np.ndarray:
        """Of the arm without deflections (N, n) [rad], by inverse kinematics."""
        q = self.start()
        place, turn = rigid_pose(chain, q)
        found = np.empty((len(time), len(q)))
        for k, moved in enumerate(self.displacement(time)):
            q = inverse(chain, place + moved, turn, q)
            found[k] = q
        return found


ARM = (
    Path("line", (20, -60, 95), 0.5, legs=((0.1, 0.28, -0.12),)),
    Path("circle", (-15, -40, 80), 1.0, center=(0.0, 0.1, 0.0), axis=(0.3, 0.0, 1.0)),
    Path("corner", (-35, -55, 100), 0.8, legs=((0.0, 0.25, 0.05), (0.15, 0.0, -0.2))),
    Path("line_far", (60, -30, 50), 0.5, legs=((-0.15, -0.15, 0.2),)),
    Path("line_near", (-70, -85, 130), 0.5, legs=((0.15, 0.1, -0.2),)),
)


def wrist(path: Path) -> Path:
    """Path of an arm with six axes, as that of three."""
    return Path(
        path.name,
        (*path.start_deg, 15.0, -40.0, 20.0),
        path.duration,
        path.legs,
        path.center,
        path.axis,
        path.turn_deg,
    )


def test_paths(chain: Chain) -> tuple[Path, ...]:
    """Those of this arm."""
    return ARM if len(chain.gears) == 3 else tuple(wrist(path) for path in ARM)
