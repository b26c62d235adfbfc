"""Zero dynamics of a moving robot: the non-actuated rows linearized about a motion with the output
on its path.

With ``W v = Z'`` and ``W a + W' v = Z''`` linearized, a deflection ``e(t)`` of the non-actuated
coordinates brings

    q: S e,    v: S e' + V e,    a: S e'' + C1 e' + C0 e

with it, and the rows become ``A e'' + D e' + K e = 0``, whose coefficients are frozen at each
instant. At rest they are those of `flexgen.analysis.arm_linearization`; speed adds Coriolis and
centrifugal terms to D and K. A does not depend on it.
"""

from __future__ import annotations

import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.quasistatic import OutputPath, poses_along

# of a path's duration: the distance of the poses from which speeds and accelerations are taken
NEARBY = 1e-3


def moving_pencil(
    equations: Equations, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``A, D, K`` (k, n_e, n_e) at k points of a motion ``q v a`` (k, n_a).

    Raises
    ------
    ArgumentError
        The model has another number of outputs than of motors, or complete motor coupling.
    LinAlgError
        The output does not determine the actuated coordinates.
    """
    model = equations.model
    k = len(q)
    n_a = model.n_a
    n_e = model.n_e
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    function = equations.function("inversion_jacobians")
    found = dict(zip(function.name_out(), evaluate(function, q, v, a), strict=True))
    y1_q, y2_q, y2_v = (found[name].reshape(k, -1, n_a) for name in ("dy1_dq", "dy2_dq", "dy2_dv"))
    row_q, row_v, row_a = (
        found[name].reshape(k, n_e, n_a) for name in ("row_q", "row_v", "row_a")
    )
    target = np.zeros(equations.function("output_constraint").numel_in("target"))
    W = evaluate(equations.function("output_constraint"), q, v, target)[1].reshape(k, -1, n_a)

    def cancel(forced: np.ndarray) -> np.ndarray:
        """Actuated motion that cancels ``forced`` (k, n_y, n_e) in the output, the other
        coordinates at rest.
        """
        out = np.zeros((k, n_a, n_e))
        out[:, i_g] = -np.linalg.solve(W[:, :, i_g], forced)
        return out

    S = cancel(W[:, :, i_e])
    S[:, i_e, np.arange(n_e)] = 1.0
    V = cancel(y1_q @ S)
    C1 = cancel(y2_v @ S)
    C0 = cancel(y2_q @ S + y2_v @ V)
    return row_a @ S, row_a @ C1 + row_v @ S, row_a @ C0 + row_v @ V + row_q @ S


def quasistatic_motion(
    equations: Equations, path: OutputPath, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates, velocities, accelerations (k, n_a) of the motion through static equilibria at
    rising ``t`` [s].
    """
    h = NEARBY * path.duration
    around = np.repeat(t, 3) + np.tile([-h, 0.0, h], len(t))
    before, now, after = (
        poses_along(equations, path, around).reshape(len(t), 3, -1).transpose(1, 0, 2)
    )
    return now, (after - before) / (2 * h), (after - 2 * now + before) / h**2
