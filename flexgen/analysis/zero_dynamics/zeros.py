"""Transmission zeros: what the robot does inside while its output stands still, and what that
means for inversion.

Two independent methods:

* `transmission_zeros`: from any linear system, by removing the infinite zeros step by step with
  orthogonal transformations (A. Emami-Naeini, P. Van Dooren, Automatica 18(4), 1982);
* `inner_zeros`: from the structure of the reduction. With the output held, the non-actuated rows
  give a quadratic
pencil
  ``A s^2 + D s + K`` in the non-actuated coordinates; each damped gear adds ``-K_g/D_g``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexgen.analysis.arm_linearization import held_motions
from flexgen.analysis.linear import LinearModel, sort_roots
from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.motor_harmonics import gear_angles_along
from flexgen.dynamics.mechanics.statics import Equilibrium, gear_damping
from flexgen.model.abilities import obstacle

# part of a motion that may lie outside of a preview: the tolerance of lq and of streams
PREVIEW_SHARE = 1e-6
ON_AXIS = 1e-9  # of its size: a real part that is smaller is rounding
RANK = 1e-9  # relative size below which a singular value counts as zero


@dataclass(frozen=True)
class ZeroReport:
    """Zeros of the declared output [1/s] and the verdict.

    ``phase``: ``"flat"`` (no zeros: the torque follows from the reference and its derivatives
    alone), ``"minimum phase"``, ``"non-minimum phase"`` (a torque that tracks the path exactly
    begins before it), or ``"none"`` (not as many outputs as motors, or a degenerate system: no
    verdict). Zeros on the imaginary axis, of undamped elements, do not make an output non-minimum
    phase. ``unstable_time_constant_s``: of the slowest unstable zero, 0 where there is none;
    ``preview_s``: see `preview`.
    """

    zeros: np.ndarray
    phase: str
    unstable_time_constant_s: float
    preview_s: float


def transmission_zeros(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, rate: float = 1.0
) -> np.ndarray | None:
    """Finite transmission zeros [1/s] of a square system without feed-through; None where it is
    degenerate.

    ``rate`` [1/s]: a typical rate of the system, for scaling.
    """
    n = len(A) // 2
    T = np.concatenate([np.ones(n), np.full(len(A) - n, rate)])
    A = (A * T) / T[:, None] / rate
    B = B / T[:, None] / rate
    C = C * T
    B = B / np.linalg.norm(B, axis=0)
    C = C / np.linalg.norm(C, axis=1)[:, None]
    zeros = _invariant_zeros(A, B, C, np.zeros((C.shape[0], B.shape[1])))
    return None if zeros is None else sort_roots(zeros * rate)


def _invariant_zeros(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray
) -> np.ndarray | None:
    """Finite zeros of a scaled square system with feed-through D; None where it is degenerate.

    As long as D is singular, outputs without feed-through are kept at zero: the states that this
    fixes are removed, and their rates become outputs (Silverman's structure algorithm). At the end
    ``A - B D^-1 C`` has the zeros as eigenvalues.
    """
    while True:
        size = max(float(np.linalg.norm(X)) for X in (A, B, C, np.eye(1)))
        U, values, _ = np.linalg.svd(D)
        rank = int(np.sum(values > RANK * size))
        if rank == D.shape[0]:
            break
        C = U.T @ C
        D = U.T @ D
        upper_C = C[:rank]
        upper_D = D[:rank]
        lower = C[rank:]
        norms = np.linalg.norm(lower, axis=1)
        lower = lower / np.where(norms > 0, norms, 1.0)[:, None]
        _, values, Vh = np.linalg.svd(lower)
        depth = int(np.sum(values > RANK)) if len(A) else 0
        if depth == 0:
            return None  # outputs that depend on each other
        Z = np.vstack([Vh[depth:], Vh[:depth]]).T
        keep = len(A) - depth
        A = Z.T @ A @ Z
        B = Z.T @ B
        upper_C = upper_C @ Z
        C = np.vstack([upper_C[:, :keep], A[keep:, :keep]])
        D = np.vstack([upper_D, B[keep:]])
        A = A[:keep, :keep]
        B = B[:keep]
        # rows may differ by many orders of magnitude; constraints may be scaled freely
        norms = np.linalg.norm(np.hstack([C, D]), axis=1)
        C = C / np.where(norms > 0, norms, 1.0)[:, None]
        D = D / np.where(norms > 0, norms, 1.0)[:, None]
        if not len(A) and np.linalg.matrix_rank(D, tol=RANK) < D.shape[1]:
            return None
    if D.shape[0] != D.shape[1]:
        return None
    return np.linalg.eigvals(A - B @ np.linalg.solve(D, C))


def inner_pencil(
    equations: Equations, linear: LinearModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``A, D, K`` (n_e, n_e) of the non-actuated rows with the output fixed: the zero dynamics at
    a pose.
    """
    model = equations.model
    S = held_motions(model, linear.W)
    A, D, K = (X[list(model.i_e)][:, : model.n_a] @ S for X in (linear.M, linear.D, linear.K))
    return A, D, K


def inner_zeros(equations: Equations, linear: LinearModel, rest: Equilibrium) -> np.ndarray:
    """Zeros [1/s] by the structure at the equilibrium ``rest``: -K/D of each damped gear, and
    those of the non-actuated coordinates with the output held.

    For simplified motor coupling and as many outputs of the arm as motors; SolverError where the
    output leaves a motion undetermined.
    """
    model = equations.model
    deflection = gear_angles_along(model, rest.q_m[None])[0] - rest.q_a[list(model.i_g)]
    stiffness = evaluate(equations.function("gear_law"), deflection)[1][0]
    damping = gear_damping(equations)
    values = [-stiffness[damping > 0] / damping[damping > 0]]
    if model.n_e:
        inner = pencil_zeros(*inner_pencil(equations, linear))
        if inner is None:
            raise SolverError(
                "zeros: the output leaves a motion of the elastic elements undetermined"
            )
        values.append(inner)
    return sort_roots(np.concatenate(values).astype(complex))


def pencil_zeros(A: np.ndarray, D: np.ndarray, K: np.ndarray) -> np.ndarray | None:
    """Finite roots [1/s] of ``det(A s^2 + D s + K)``, A singular or not; None where that is zero
    for all s.
    """
    n = len(A)
    size = float(np.linalg.norm(K)) or float(np.linalg.norm(D)) or float(np.linalg.norm(A))
    if size == 0.0:
        return None
    rate = min(
        float(np.sqrt(size / np.linalg.norm(A))) if A.any() else np.inf,
        size / float(np.linalg.norm(D)) if D.any() else np.inf,
    )
    rate = rate if np.isfinite(rate) and rate > 0 else 1.0
    # A s^2 + D s + K is the transfer function from a = w'' to A a + D w' + K w, up to a factor
    A = A * rate**2 / size
    D = D * rate / size
    K = K / size
    upper = np.hstack([np.zeros((n, n)), np.eye(n)])
    chain = np.vstack([upper, np.zeros((n, 2 * n))])
    rows = np.linalg.norm(np.hstack([K, D, A]), axis=1)[:, None]
    inner = _invariant_zeros(
        chain, np.vstack([np.zeros((n, n)), np.eye(n)]), np.hstack([K, D]) / rows, A / rows
    )
    return None if inner is None else inner * rate


def is_structured(equations: Equations) -> bool:
    """Whether the reduction has the zeros: as many outputs as motors, and no coordinate without
    motor that turns a rotor.
    """
    parts = ("reduced problem", "inner zeros")
    return all(obstacle(equations.model, part) is None for part in parts)


def zero_report(equations: Equations, linear: LinearModel, rest: Equilibrium) -> ZeroReport:
    """Zeros [1/s] of the declared output in the static equilibrium ``rest``, and the verdict:
    "flat", "minimum phase", "non-minimum phase" with time constant and preview [s], or "none"
    where zeros are not defined or not determined.
    """
    model = equations.model
    zeros: np.ndarray | None = None
    if obstacle(model, "full problem") is None:
        if is_structured(equations):
            blocks = np.linalg.svd(linear.W[:, list(model.i_g)], compute_uv=False)
            if blocks[-1] > RANK * max(blocks[0], 1e-300):
                zeros = inner_zeros(equations, linear, rest)
        else:
            A, B = linear.state_space()
            zeros = transmission_zeros(
                A, B, np.hstack([linear.W, np.zeros_like(linear.W)]), linear.rate
            )
    if zeros is None:
        return ZeroReport(np.zeros(0, dtype=complex), "none", 0.0, 0.0)
    slowest, _ = time_constants(zeros)
    if slowest > 0:
        return ZeroReport(zeros, "non-minimum phase", slowest, preview(slowest))
    return ZeroReport(zeros, "minimum phase" if len(zeros) else "flat", 0.0, 0.0)


def time_constants(zeros: np.ndarray) -> tuple[float, float]:
    """Slowest unstable and slowest stable time constant [s]; 0 where there is none.

    Zeros on the imaginary axis, up to rounding, are neither.
    """
    unstable = zeros.real[zeros.real > ON_AXIS * np.abs(zeros)]
    stable = -zeros.real[zeros.real < -ON_AXIS * np.abs(zeros)]
    slowest = [float(1 / x.min()) if len(x) else 0.0 for x in (unstable, stable)]
    return slowest[0], slowest[1]


def preview(time_constant: float, share: float = PREVIEW_SHARE) -> float:
    """Preview of the path that is needed [s], which is also how early a motion must begin before
    it.

    Backwards in time the response to a change of the path decays like the slowest unstable zero,

        exp(-T / tau) = share,    T = tau ln(1 / share),

    so that the effect of inputs beyond T is reduced by the factor ``share``: 14 time constants for
    1e-6.

    Parameters
    ----------
    time_constant : float [s]
        Of the slowest unstable zero; 0 where there is none.
    share : float
    """
    return float(time_constant * np.log(1.0 / share))


def motor_zeros(linear: LinearModel) -> np.ndarray | None:
    """Zeros [1/s] from the motor torques to the motor angles: the robot with locked motors."""
    A, B = linear.state_space()
    return transmission_zeros(
        A, B, np.hstack([linear.C_m, np.zeros_like(linear.C_m)]), linear.rate
    )
