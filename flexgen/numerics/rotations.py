"""Differences of rotations."""

from __future__ import annotations

import numpy as np


def turn_angle(R: np.ndarray, R_ref: np.ndarray) -> np.ndarray:
    """Angle (n,) [rad] between two orientations (n, 3, 3), accurate for small angles too."""
    E = R @ R_ref.transpose(0, 2, 1)
    axial = np.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1)
    return np.arctan2(np.linalg.norm(axial, axis=1) / 2, (np.trace(E, axis1=1, axis2=2) - 1) / 2)
