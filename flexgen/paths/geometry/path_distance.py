"""Distance of points from a path, whatever the time at which the path passes there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree


def distance_from_path(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Distance (n,) of points from the polyline through the samples of a path, in the unit of
    both.

    Parameters
    ----------
    points : array (n, k)
    path : array (m, k)
        Samples so close together that the nearest segment ends at the nearest sample.
    """
    points = np.asarray(points, dtype=float)
    path = np.asarray(path, dtype=float)
    least, nearest = cKDTree(path).query(points)
    for step in (-1, 1):
        other = np.clip(nearest + step, 0, len(path) - 1)
        edge = path[other] - path[nearest]
        size = (edge**2).sum(axis=1)
        away = points - path[nearest]
        share = np.clip((away * edge).sum(axis=1) / np.where(size > 0, size, 1.0), 0.0, 1.0)
        least = np.minimum(least, np.linalg.norm(away - share[:, None] * edge, axis=1))
    distances: np.ndarray = least
    return distances
