"""Samples of an interface of positions, and what a robot makes of them between two of them.

    hold:    r(t) = c_j
    linear:  r(t) = (1 - x) c_j + x c_(j+1),    x = (t - t_j)/T
    cubic:   Hermite's polynomials with the slopes (c_(j+1) - c_(j-1))/(2 T)

The samples are those whose interpolation is closest to the reference that is wanted at the samples of the servo,

    min sum_k |r(t_k) - r_k|^2,    |c_j - c_(j-1)| <= v T,    |c_(j+1) - 2 c_j + c_(j-1)| <= a T^2

Bounds are kept by an interior-point method: S. Mehrotra, SIAM J. Optim. 2(4), 1992, from equal samples.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.sparse import csc_matrix, diags_array, vstack
from scipy.sparse.linalg import splu

from flexgen.errors import SolverError

Interpolation = Literal["hold", "linear", "cubic"]
_DIFFERENCES = {1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}
SLACK = 1e-9  # relative: a bound that is reached is kept
GAP = 1e-10  # relative: cost above the least one
STEPS = 100


def basis(time: np.ndarray, edges: np.ndarray, interpolation: str) -> csc_matrix:
    """The matrix (n, k) from samples at ``edges`` (k,) [s] to the reference at the instants ``time`` (n,) [s]."""
    last = len(edges) - 1
    period = (edges[-1] - edges[0]) / last  # of all: rounding of one would add up
    j = np.clip(np.floor((time - edges[0]) / period + 1e-9).astype(int), 0, last)
    x = np.clip((time - edges[j]) / period, 0.0, 1.0)
    x = np.where(x < 1e-9, 0.0, x)
    weights = {
        "hold": ((0, np.ones_like(x)),),
        "linear": ((0, 1 - x), (1, x)),
        "cubic": (
            (-1, -(x**3) / 2 + x**2 - x / 2),
            (0, 1.5 * x**3 - 2.5 * x**2 + 1),
            (1, -1.5 * x**3 + 2 * x**2 + x / 2),
            (2, x**3 / 2 - x**2 / 2),
        ),
    }[interpolation]
    rows = np.tile(np.arange(len(time)), len(weights))
    columns = np.concatenate([np.clip(j + step, 0, last) for step, _ in weights])
    return csc_matrix((np.concatenate([w for _, w in weights]), (rows, columns)), (len(time), len(edges)))


def fit_samples(B: csc_matrix, r: np.ndarray) -> np.ndarray:
    """Samples (k, n_m) whose interpolation is closest to ``r`` (n, n_m)."""
    return np.asarray(splu(csc_matrix(B.T @ B)).solve(np.asarray(B.T @ (r - r[0])))) + r[0]


def fit_within(
    B: csc_matrix, r: np.ndarray, period: float, limits: tuple[np.ndarray | None, np.ndarray | None]
) -> np.ndarray:
    """The same within bounds of speed [rad/s] and acceleration [rad/s^2], (n_m,) each; None: no bound.

    Raises
    ------
    SolverError
        No samples keep the bounds.
    """
    k, kept = B.shape[1], [(n, bound) for n, bound in enumerate(limits, 1) if bound is not None]
    free, H = fit_samples(B, r) - r[0], csc_matrix(B.T @ B)
    out = np.empty_like(free)
    for j, own in enumerate(free.T):
        scale = max(float(np.abs(own).max()), 1e-12)
        rows = [
            diags_array(_DIFFERENCES[n], offsets=range(n + 1), shape=(k - n, k)) / ((1 - SLACK) * bound[j] * period**n)
            for n, bound in kept
        ]
        found = _nearest(H, own / scale, csc_matrix(scale * vstack(rows)))
        if found is None:
            words = " and ".join(f"{bound[j]:.4g} {('rad/s', 'rad/s^2')[n - 1]}" for n, bound in kept)
            raise SolverError(f"limits: no samples of motor {j + 1} keep {words} (motor side); increase them")
        out[:, j] = scale * found
    return out + r[0]


def _nearest(H: csc_matrix, free: np.ndarray, A: csc_matrix) -> np.ndarray | None:
    """The x with the least (x - free)' H (x - free) for which |A x| <= 1, from x = 0; None: not found."""
    x, sides = np.zeros_like(free), np.array([[1.0], [-1.0]])
    s, z = np.ones((2, A.shape[0])), np.ones((2, A.shape[0]))  # slacks and multipliers of both sides
    floor = 1e-15 * free @ (H @ free)
    for _ in range(STEPS):
        gap = float(np.sum(s * z))
        if gap <= GAP * (x - free) @ (H @ (x - free)) + floor:
            return x
        gradient = H @ (x - free) + A.T @ (z[0] - z[1])
        factors = splu(csc_matrix(H + A.T @ A.multiply(np.sum(z / s, axis=0)[:, None])))
        c = np.zeros_like(s)
        for corrected in (False, True):
            aim = c / s - z
            dx = factors.solve(-gradient - A.T @ (aim[0] - aim[1]))
            ds = -sides * (A @ dx)
            dz = aim - z * ds / s
            ratio = max(float(np.max(-ds / s)), float(np.max(-dz / z)))
            step = min(1.0, 0.995 / max(ratio, 1e-9))
            if not corrected:
                c = (np.sum((s + step * ds) * (z + step * dz)) / gap) ** 3 * gap / s.size - ds * dz
        x, s, z = x + step * dx, s + step * ds, z + step * dz
    return None
