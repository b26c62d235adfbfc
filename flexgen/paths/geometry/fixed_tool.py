"""Curves of a workpiece in the hand of a robot, along a tool that stands in the room.

The path is that of the tool, seen from the workpiece: its point at p(s), its axes turned by R(s).
With the tool at p_F, R_F in the world the workpiece is at

    R_W = R_F R',  y = p_F - R_W p,  w_W = -R_W w

w: angular velocity of R, in the axes of the workpiece.
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING

import numpy as np

from flexgen.model.moves import WorkFrame
from flexgen.paths.geometry.carried_curve import MovedCurve, multiply
from flexgen.paths.geometry.jets import Attitude

if TYPE_CHECKING:
    from flexgen.paths.timing.timed_segments import Curve


class FixedToolCurve(MovedCurve):
    """The curve of a workpiece, whose frame is that of the robot's tool, in the world.

    Parameters
    ----------
    curve : Curve
        Of the tool in the room, position and orientation in the frame of the workpiece.
    tool : WorkFrame
        Where it stands.
    """

    def __init__(self, curve: Curve, tool: WorkFrame) -> None:
        self.curve = curve
        self.tool = tool

    def __call__(self, s: np.ndarray) -> tuple[np.ndarray, Attitude | None]:
        """Jet (n, 3, k), and the orientation, from the jet (n, k) of the parameter."""
        x, attitude = self.curve(s)
        assert attitude is not None  # the output is a pose
        R, w = attitude
        Q = _turning(np.array(self.tool.rotation) @ R.transpose(0, 2, 1), w)
        y = -multiply(Q, x)
        y[:, :, 0] += self.tool.position
        return y, (Q[..., 0], -multiply(Q, w))


def seen_from(p: np.ndarray, R: np.ndarray, tool: WorkFrame) -> tuple[np.ndarray, np.ndarray]:
    """Position and orientation of a tool in the room, seen from a workpiece at p, R."""
    return R.T @ (np.array(tool.position) - p), R.T @ np.array(tool.rotation)


def _turning(Q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Jet (n, 3, 3, k + 1) of a rotation matrix Q (n, 3, 3) with Q' = -Q [w], from the jet of w
    (n, 3, k).
    """
    n, _, k = w.shape
    hat = np.zeros((n, 3, 3, k))
    for i, j, m in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        hat[:, i, j] = -w[:, m]
        hat[:, j, i] = w[:, m]
    jet = [Q]
    for order in range(k):
        terms = [comb(order, i) * jet[i] @ hat[..., order - i] for i in range(order + 1)]
        jet.append(-np.sum(terms, axis=0))
    return np.stack(jet, axis=-1)
