"""Samples of an interface of positions, and what a robot makes of them between two of them.

    hold:    r(t) = c_j
    linear:  r(t) = (1 - x) c_j + x c_(j+1),    x = (t - t_j)/T
    cubic:   Hermite's polynomials with the slopes (c_(j+1) - c_(j-1))/(2 T)

The samples are those whose interpolation is closest to the reference that is wanted at the samples of the servo,

    min sum_k |r(t_k) - r_k|^2,    |c_j - c_(j-1)| <= v T,    |c_(j+1) - 2 c_j + c_(j-1)| <= a T^2
"""

from __future__ import annotations

from typing import Literal

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix, diags_array, vstack
from scipy.sparse.linalg import splu

from flexgen.errors import SolverError

Interpolation = Literal["hold", "linear", "cubic"]
_DIFFERENCES = {1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}
SLACK = 1e-9  # relative: a bound that is reached is kept
# first-order methods do not end: second differences are 1e-4 of the samples
QP = {
    "nlpsol": "ipopt",
    "error_on_fail": False,
    "nlpsol_options": {
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-11, "bound_relax_factor": 0.0},
    },
}


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
    return csc_matrix(
        (np.concatenate([w for _, w in weights]), (rows, columns)), (len(time), len(edges))
    )


def fit_samples(B: csc_matrix, r: np.ndarray) -> np.ndarray:
    """Samples (k, n_m) whose interpolation is closest to ``r`` (n, n_m)."""
    return np.asarray(splu(csc_matrix(B.T @ B)).solve(np.asarray(B.T @ (r - r[0])))) + r[0]


def fit_within(
    B: csc_matrix, r: np.ndarray, period: float, limits: tuple[np.ndarray | None, np.ndarray | None]
) -> np.ndarray:
    """The same of joints (k, n_g) within bounds of speed and acceleration, (n_g,) each; None: no bound.

    Raises
    ------
    SolverError
        No samples keep the bounds.
    """
    k, kept = B.shape[1], [(n, bound) for n, bound in enumerate(limits, 1) if bound is not None]
    steps = {
        n: diags_array(_DIFFERENCES[n], offsets=range(n + 1), shape=(k - n, k)) for n, _ in kept
    }
    A, H = (ca.DM(csc_matrix(x)) for x in (vstack([steps[n] for n, _ in kept]), B.T @ B))
    solver = ca.conic("samples", "nlpsol", {"h": H.sparsity(), "a": A.sparsity()}, QP)
    out = np.empty((k, r.shape[1]))
    for j, own in enumerate((r - r[0]).T):
        scale = max(float(np.abs(own).max()), 1e-12)
        most = np.concatenate(
            [np.full(k - n, (1 - SLACK) * bound[j] * period**n / scale) for n, bound in kept]
        )
        rows = ca.mtimes(ca.diag(ca.DM(1.0 / most)), A)
        found = solver(h=H, g=-(B.T @ (own / scale)), a=rows, lba=-1.0, uba=1.0)
        if not solver.stats()["success"]:
            words = " and ".join(
                f"{('speed', 'acceleration')[n - 1]} {bound[j]:.4g}" for n, bound in kept
            )
            raise SolverError(
                f"limits: no samples of joint {j + 1} keep {words} (SI units, joint side); increase them"
            )
        out[:, j] = scale * np.asarray(found["x"]).ravel()
    return out + r[0]
