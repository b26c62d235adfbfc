"""Strictly convex quadratic programs with many bounded rows of which few are active."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.optimize import nnls

from flexgen.errors import SolverError

EMPTY = 1e-12  # of the longest row: shorter rows do not depend on the unknowns
FEASIBLE = 1e-6  # residual of the dual problem; 1 / sqrt(1 + |u|^2) at a solution u in units of the largest bound
ROUNDS = 10  # iterations of the active set method, for each row
EXACT = 1e-6  # largest violation of a bound, relative to one and to the bound


def solve_program(H: sp.csc_matrix, gradient: np.ndarray, A: sp.csr_matrix, bound: np.ndarray) -> np.ndarray | None:
    """The solution of ``min x' H x / 2 + gradient' x`` with ``A x <= bound``.

    With ``H = L L'`` and ``u = L' x + L^-1 gradient`` this is the point u of a polyhedron that is closest to zero, the
    dual of which is a nonnegative least squares problem. The active set method solves it to rounding.

    Parameters
    ----------
    H : matrix (n, n)
        Symmetric, positive definite.
    gradient : array (n,)
    A : matrix (m, n)
    bound : array (m,)

    Returns
    -------
    array (n,) or None
        None where no point keeps all bounds.

    Raises
    ------
    SolverError
        The method did not converge.

    Source: C. Lawson, R. Hanson, Solving Least Squares Problems, 1974, ch. 23 (least distance programming).
    """
    L = scipy.linalg.cholesky(H.toarray(), lower=True)
    G = scipy.linalg.solve_triangular(L, A.toarray().T, lower=True).T
    shift = scipy.linalg.solve_triangular(L, gradient, lower=True)
    rows, bounds = -G, -(bound + G @ shift)  # rows u >= bounds
    length = np.linalg.norm(rows, axis=1)
    fixed = length <= EMPTY * length.max(initial=0.0)
    if (bounds[fixed] > 0).any():
        return None
    rows, bounds = rows[~fixed] / length[~fixed, None], bounds[~fixed] / length[~fixed]
    u = _closest(rows, bounds)
    if u is None:
        return None
    if (bounds - rows @ u > EXACT * (1.0 + np.abs(bounds))).any():
        raise SolverError("quadratic program: the bounds contradict each other to rounding; loosen them")
    x: np.ndarray = scipy.linalg.solve_triangular(L.T, u - shift, lower=False)
    return x


def _closest(rows: np.ndarray, bounds: np.ndarray) -> np.ndarray | None:
    """The shortest u with ``rows u >= bounds``; None where there is none."""
    if not (bounds > 0).any():
        return np.zeros(rows.shape[1])
    size = float(bounds.max())  # u is in proportion to the bounds: values near one lose no digits
    E = np.vstack([rows.T, bounds / size])
    target = np.zeros(len(E))
    target[-1] = 1.0
    try:
        multipliers, residual = nnls(E, target, maxiter=ROUNDS * E.shape[1])
    except RuntimeError as error:
        raise SolverError(f"quadratic program: {error}; loosen the bounds") from error
    if residual < FEASIBLE:
        return None
    active = multipliers > 0
    u: np.ndarray = np.linalg.lstsq(rows[active], bounds[active], rcond=None)[0]  # the shortest one on these rows
    return u
