"""The Riccati equation of a sampled regulator or filter."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are

from flexgen.base.errors import SolverError


def riccati(F: np.ndarray, G: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Solution P of the discrete algebraic Riccati equation of ``x+ = F x + G u`` with the weights
    Q and R: ``P = F'P F - F'P G (R + G'P G)^-1 G'P F + Q``; SolverError where there is none.
    """
    try:
        return np.asarray(solve_discrete_are(F, G, Q, R))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise SolverError(
            f"gains of the controller: the Riccati equation has no solution at a pose ({error}); "
            "use other weights, or other sensors"
        ) from error
