"""Linearization of the robot about a static equilibrium: poles, modes, frequency response.

M y'' + D y' + K y = B tau_m,        y = (q_a, q_me),    x = (y, y'),    x' = A x + B_x tau_m
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import eigvals

from flexgen.analysis.second_order import motor_rows
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.linearization import check_inertia, second_order_matrices
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.statics import Equilibrium

# of the fastest pole over typical ones, from which on slow ones are computed by themselves
SPREAD = 1e7
# Poles whose estimated relative error is larger than this are refined: a model is known to less.
DIGITS = 1e-9
# Part of a typical rate below which a pole is one at the origin that rounding has moved: as it is.
ORIGIN = 1e-7
# Damping ratio below which a mode has none: in a model with stiff gears, zero damping is computed
# as up to 1e-9.
UNDAMPED = 1e-7
# Newton's steps for one root: each doubles the right digits, and the first guess has four or more.
NEWTON_STEPS = 4
# A refined root stays nearer to its first guess than this part of the distance to the next root.
NEIGHBOR = 0.1


@dataclass(frozen=True)
class LinearModel:
    """The equations of motion linearized about a static equilibrium.

    ``M D K`` (n, n), ``B`` (n, n_m) in y = (q_a, q_me); ``W`` (n_y, n): output rates; ``C_m``
    (n_m, n): motor angles.
    """

    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    B: np.ndarray
    W: np.ndarray
    C_m: np.ndarray

    def state_space(self) -> tuple[np.ndarray, np.ndarray]:
        """``A`` (2n, 2n) and ``B`` (2n, n_m) of the state x = (y, y')."""
        n = len(self.M)
        lower = np.linalg.solve(self.M, np.hstack([-self.K, -self.D, self.B]))
        A = np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), lower[:, : 2 * n]])
        return A, np.vstack([np.zeros((n, self.B.shape[1])), lower[:, 2 * n :]])

    @property
    def rate(self) -> float:
        """A typical rate [1/s], to choose the unit of time by; 1 without any stiffness."""
        size = float(np.linalg.norm(np.linalg.solve(self.M, self.K)))
        return float(np.sqrt(size)) if size > 0 else 1.0

    def response(self, w: np.ndarray, C: np.ndarray) -> np.ndarray:
        """``C (K + j w D - w^2 M)^-1 B`` at the angular frequencies ``w`` [rad/s], shape (len(w),
        rows of C, n_m).
        """
        s = 1j * w[:, None, None]
        return C @ np.linalg.solve(
            s**2 * self.M + s * self.D + self.K, np.broadcast_to(self.B, (len(w), *self.B.shape))
        )


def linearize(equations: Equations, rest: Equilibrium) -> LinearModel:
    """The `LinearModel` of a robot in a static equilibrium."""
    model = equations.model
    zero_a = np.zeros(model.n_a)
    zero_m = np.zeros(model.n_m)
    arguments = (rest.q_a, zero_a, zero_a, rest.q_m, zero_m, zero_m, rest.tau_m)
    M, R = evaluate(equations.function("residual_jacobians"), *arguments)
    M, D, K, B = second_order_matrices(M[0], R[0])
    check_inertia(model, M)
    W = np.zeros((model.output.size, model.dof))
    symbol = equations.lagrangian.chain.q_a
    rate = evaluate(ca.Function("W", [symbol], [output_map(equations).rate]), rest.q_a)[0][0]
    W[:, : model.n_a] = rate.reshape(W.shape[0], model.n_a)  # a column comes back as a vector
    return LinearModel(M, D, K, B, W, motor_rows(model))


def poles(linear: LinearModel) -> np.ndarray:
    """Eigenvalues [1/s] of the linearization, by size.

    Slow poles of a robot whose fast ones are far away are computed without the inverse of M, and
    those near the rounding error of the largest one are refined by Newton's method.
    """
    A, _ = linear.state_space()
    # one unit of time for all: the slowest and the fastest pole lie far apart
    rate = linear.rate
    n = len(A) // 2
    scaled = A.copy()
    scaled[:n, n:] *= rate
    scaled[n:, :n] /= rate
    values = sort_roots(np.linalg.eigvals(scaled / rate) * rate)
    typical = float(np.median(np.sqrt(np.abs(np.diag(linear.K)) / np.diag(linear.M))))
    # the error of every eigenvalue is in proportion to the largest one
    rounding = float(np.finfo(float).eps * np.abs(values[-1]))
    if np.abs(values[-1]) > SPREAD * typical > 0.0:
        slow = _slow_poles(linear, typical)
        count = int((np.abs(slow) < np.sqrt(SPREAD) * typical).sum())
        values = np.concatenate([slow[:count], values[count:]])
    coarse = (np.abs(values) > ORIGIN * typical) & (np.abs(values) < rounding / DIGITS)
    if not coarse.any():
        return values
    return sort_roots(refine_roots(linear.M, linear.D, linear.K, values, coarse))


def _slow_poles(linear: LinearModel, rate: float) -> np.ndarray:
    """Eigenvalues [1/s], sorted, of which those up to ``rate`` are exact: of the matrices without
    the inverse of M.

    In the state matrix the fast ones, of a light body on a stiff spring, leave rounding errors as
    large as the others.
    """
    size = np.sqrt(np.abs(np.diag(linear.K)) + np.diag(linear.M) * rate**2)
    M, D, K = (x / np.outer(size, size) for x in (linear.M * rate**2, linear.D * rate, linear.K))
    n = len(M)
    left = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -D]])
    right = np.block([[np.eye(n), np.zeros((n, n))], [np.zeros((n, n)), M]])
    return sort_roots(rate * eigvals(left, right))


def refine_roots(
    M: np.ndarray, D: np.ndarray, K: np.ndarray, roots: np.ndarray, chosen: np.ndarray
) -> np.ndarray:
    """Roots s [1/s] of ``det(P(s)) = 0``, ``P(s) = M s^2 + D s + K``, each improved by itself.

    The singular vectors u, v of the smallest singular value of P(s), with rows and columns scaled
    by the size of ``|s|^2 M + |K|`` at the root, give Newton's step

        s - (u^H P(s) v) / (u^H P'(s) v).

    Its error is that of the numbers in M, D and K (relative to s, half the rounding of the
    stiffest spring over the stiffness that the mode feels), however far the other roots are: an
    eigenvalue solver for all of them has the error of the largest one. A root keeps its value
    where the step is not small relative to the distance to its neighbor (a multiple root, to be
    had up to the root of rounding only). Conjugates stay conjugates, real roots stay real.

    Parameters
    ----------
    M, D, K : ndarray (n, n)
    roots : ndarray (m,) [1/s]
        Approximate roots.
    chosen : ndarray of bool (m,)
        Those to improve, with their conjugates.
    """
    found = roots.astype(complex)
    for index in np.flatnonzero(chosen):
        root = roots[index]
        others = np.delete(roots, index)
        gap = float(np.abs(others - root).min(initial=np.inf))
        if root.imag < 0 or not np.isfinite(root) or not abs(root) > 0.0:
            continue
        better = _refine_root(M, D, K, root, NEIGHBOR * min(gap, abs(root)))
        if root.imag > 0.0:
            twin = int(np.abs(roots - np.conj(root)).argmin())
            found[twin] = np.conj(better)
        found[index] = better
    return found


def _refine_root(
    M: np.ndarray, D: np.ndarray, K: np.ndarray, root: complex, reach: float
) -> complex:
    """A root [1/s] of ``det P(s)``, ``P = M s^2 + D s + K``, after Newton's steps along its null
    vectors; as given where they lead further away than ``reach`` [1/s].

    With the singular vectors u, v of the smallest singular value the step is ``u P v / (u P' v)``.
    The matrices are scaled first, as their rows may have different units.
    """
    size = np.sqrt(np.abs(np.diag(K)) + np.abs(np.diag(M)) * abs(root) ** 2)
    if not np.all(size > 0.0):
        return root
    M, D, K = (x / np.outer(size, size) for x in (M, D, K))
    best = root
    step_before = np.inf
    for _ in range(NEWTON_STEPS):
        P = M * best**2 + D * best + K
        left, _, right = np.linalg.svd(P)
        u = left[:, -1].conj()
        v = right[-1].conj()
        slope = u @ (2.0 * best * M + D) @ v
        if slope == 0.0:
            return root
        step = (u @ P @ v) / slope
        # the steps no longer shrink: what remains is rounding
        if not abs(step) < 0.5 * step_before:
            break
        best = best - step
        step_before = abs(step)
        if abs(best - root) > reach:
            return root
    return complex(best.real, best.imag if root.imag else 0.0)


def sort_roots(values: np.ndarray) -> np.ndarray:
    """Roots sorted by distance from the origin, conjugates together."""
    return np.array(
        sorted(values, key=lambda z: (round(abs(z), 6), z.real, z.imag)), dtype=complex
    )


def modes(values: np.ndarray) -> list[tuple[float, float]]:
    """(natural frequency [Hz], damping ratio) of each oscillatory pair among the poles, rising.

    A double pole at the origin that rounding has split is not a mode.
    """
    size = np.abs(values)
    typical = min(size.max(initial=0.0), 1e3 * np.median(size)) if len(values) else 0.0
    pairs = [z for z in values if z.imag > 1e-6 * abs(z) and abs(z) > 1e-7 * typical]
    return sorted((abs(z) / (2 * np.pi), -z.real / abs(z)) for z in pairs)
