"""The defect of a motion: its residuals in the equations of motion, propagated to the output.

    d/dt e = A(t) e + (0, M^-1 r),     defect = max |W e|

with the linearization along the motion and the residual r between the samples. It measures how
well motion and torque belong together, not where the robot goes: in directions that grow, which no
torque keeps without feedback, ``e`` is set to zero at instants along the motion.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.linalg import expm, schur

from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.output_columns import output_units
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.simulation.verification.growth import Linearized, Motion

PROJECTIONS = 100  # at most
# logarithm of the growth over the movement from which on a direction counts as one that grows
TENFOLD = 2.3


@np.errstate(over="ignore", invalid="ignore")  # where directions grow, the defect may be infinite
def propagate_residual(
    equations: Equations, motion: Motion, along: Linearized, residual: np.ndarray, unstable: bool
) -> tuple[float | None, float | None]:
    """The defect [m], [rad]; None where the output has no such part.

    Parameters
    ----------
    equations : Equations
    motion : Motion
    along : Linearized
        Along this motion.
    residual : array (n - 1, dof) [N m or N]
        Between its samples.
    unstable : bool
        Leave out the directions that grow.
    """
    model = equations.model
    n = along.A.shape[-1] // 2
    at = along.at
    count = np.diff(at)
    h = along.lengths / count
    half = expm(along.means * (h / 2)[:, None, None])
    W = output_rows(equations, motion.q_a[at])
    error = np.zeros(2 * n)
    out = []
    every = max(1, -(-len(h) // PROJECTIONS))
    slowest = TENFOLD / max(float(along.lengths.sum()), 1e-9)
    for k, step in enumerate(half):
        pushes = h[k] * step[:, n:] @ along.force[k] @ residual[at[k] : at[k + 1]].T
        step = step @ step
        for push in pushes.T:
            error = step @ error + push
            out.append(W[k] @ error[: model.n_a])
        if unstable and k % every == 0:
            error = error - growing_part(along.A[k], slowest) @ error
    found = np.array(out)
    units = np.array(units_of_output(equations))
    in_m, in_rad = (
        float(np.linalg.norm(found[:, units == u], axis=1).max()) if (units == u).any() else None
        for u in ("m", "rad")
    )
    return in_m, in_rad


def output_rows(equations: Equations, q_a: np.ndarray) -> np.ndarray:
    """``W`` at several poses, (k, n_y, n_a)."""
    rate = ca.Function("W", [equations.lagrangian.chain.q_a], [output_map(equations).rate])
    return evaluate(rate, q_a)[0].reshape(len(q_a), -1, equations.model.n_a)


def units_of_output(equations: Equations) -> list[str]:
    """Units of the rows of ``W``."""
    turn = ["rad"] * 3 if equations.model.output.type == "tool_pose" else []
    return [*output_units(equations.model), *turn]


def growing_part(A: np.ndarray, slowest: float) -> np.ndarray:
    """Projector to the directions of ``A`` that grow faster than ``slowest`` [1/s], along all
    others.
    """
    _, right, count = schur(A, sort=lambda re, im=0.0: re > slowest)
    _, left, _ = schur(A.T, sort=lambda re, im=0.0: re > slowest)
    U = right[:, :count]
    L = left[:, :count]
    return U @ np.linalg.solve(L.T @ U, L.T) if count else np.zeros_like(A)
