"""Samples of a position interface, and the interpolation of a robot between them.

    hold:    r(t) = c_j
    linear:  r(t) = (1 - x) c_j + x c_(j+1),    x = (t - t_j)/T
    cubic:   Hermite's polynomials with the slopes (c_(j+1) - c_(j-1))/(2 T)

The samples are those whose interpolation is closest to the reference that is wanted at the samples
of the servo,

    min sum_k |r(t_k) - r_k|^2,    |c_j - c_(j-1)| <= v T,    |c_(j+1) - 2 c_j + c_(j-1)| <= a T^2
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from flexgen.base.errors import SolverError
from flexgen.base.numerics.bounded_differences import solve_bounded_differences

Interpolation = Literal["linear", "cubic", "hold"]
SLACK = 1e-9  # relative: a bound that is reached is kept


def basis(time: np.ndarray, edges: np.ndarray, interpolation: str) -> csc_matrix:
    """The matrix (n, k) from samples at ``edges`` (k,) [s] to the reference at the instants
    ``time`` (n,) [s].
    """
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
    return csc_matrix(
        (np.concatenate([w for _, w in weights]), (rows, columns)), (len(time), len(edges))
    )


def fit_samples(B: csc_matrix, r: np.ndarray) -> np.ndarray:
    """Samples (k, n_m) whose interpolation is closest to ``r`` (n, n_m)."""
    return np.asarray(splu(csc_matrix(B.T @ B)).solve(np.asarray(B.T @ (r - r[0])))) + r[0]


def fit_within(
    B: csc_matrix,
    r: np.ndarray,
    period: float,
    limits: tuple[np.ndarray | None, np.ndarray | None],
) -> np.ndarray:
    """Samples of joints (k, n_g) within bounds of speed and acceleration (n_g,); None: no bound.

    Raises
    ------
    SolverError
        No samples were found that keep the bounds.
    """
    k = B.shape[1]
    kept = [(n, bound) for n, bound in enumerate(limits, 1) if bound is not None]
    H = csc_matrix(B.T @ B)
    out = np.empty((k, r.shape[1]))
    for j, own in enumerate((r - r[0]).T):
        scale = max(float(np.abs(own).max()), 1e-12)
        most = {n: np.full(k - n, (1 - SLACK) * bound[j] * period**n / scale) for n, bound in kept}
        found = solve_bounded_differences(H, -(B.T @ (own / scale)), most)
        if found is None:
            words = " and ".join(
                f"{('speed', 'acceleration')[n - 1]} {bound[j]:.4g}" for n, bound in kept
            )
            raise SolverError(
                f"limits: no samples of joint {j + 1} keep {words} (SI units, joint side); "
                "increase them"
            )
        out[:, j] = scale * found
    return out + r[0]
