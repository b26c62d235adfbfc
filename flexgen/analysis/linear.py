"""Linearization of the robot about a static equilibrium: poles, modes, frequency response.

M y'' + D y' + K y = B tau_m,        y = (q_a, q_me),    x = (y, y'),    x' = A x + B_x tau_m
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import eigvals

from flexgen.analysis.second_order import motor_rows
from flexgen.mechanics.equations import Equations
from flexgen.mechanics.linearization import check_inertia, second_order_matrices
from flexgen.mechanics.outputs import output_map
from flexgen.mechanics.statics import Equilibrium
from flexgen.numerics.evaluate import evaluate

# of the fastest pole over typical ones, from which on slow ones are computed by themselves
SPREAD = 1e7


@dataclass(frozen=True)
class LinearModel:
    """The equations of motion linearized about a static equilibrium.

    ``M D K`` (n, n), ``B`` (n, n_m) in y = (q_a, q_me); ``W`` (n_y, n): output rates; ``C_m`` (n_m, n): motor angles.
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
        """``C (K + j w D - w^2 M)^-1 B`` at the angular frequencies ``w`` [rad/s], shape (len(w), rows of C, n_m)."""
        s = 1j * w[:, None, None]
        return C @ np.linalg.solve(
            s**2 * self.M + s * self.D + self.K, np.broadcast_to(self.B, (len(w), *self.B.shape))
        )


def linearize(equations: Equations, rest: Equilibrium) -> LinearModel:
    """The `LinearModel` of a robot in a static equilibrium."""
    model = equations.model
    zero_a, zero_m = np.zeros(model.n_a), np.zeros(model.n_m)
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
    """Eigenvalues [1/s] of the linearization, by size."""
    A, _ = linear.state_space()
    # one unit of time for all: the slowest and the fastest pole lie far apart
    rate = linear.rate
    n = len(A) // 2
    scaled = A.copy()
    scaled[:n, n:] *= rate
    scaled[n:, :n] /= rate
    values = sort_roots(np.linalg.eigvals(scaled / rate) * rate)
    typical = float(np.median(np.sqrt(np.abs(np.diag(linear.K)) / np.diag(linear.M))))
    if not np.abs(values[-1]) > SPREAD * typical > 0.0:
        return values
    slow = _slow_poles(linear, typical)
    count = int((np.abs(slow) < np.sqrt(SPREAD) * typical).sum())
    return np.concatenate([slow[:count], values[count:]])


def _slow_poles(linear: LinearModel, rate: float) -> np.ndarray:
    """Eigenvalues [1/s], sorted, of which those up to ``rate`` are exact: of the matrices without the inverse of M.

    In the state matrix the fast ones, of a light body on a stiff spring, leave rounding errors as large as the others.
    """
    size = np.sqrt(np.abs(np.diag(linear.K)) + np.diag(linear.M) * rate**2)
    M, D, K = (x / np.outer(size, size) for x in (linear.M * rate**2, linear.D * rate, linear.K))
    n = len(M)
    left = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -D]])
    right = np.block([[np.eye(n), np.zeros((n, n))], [np.zeros((n, n)), M]])
    return sort_roots(rate * eigvals(left, right))


def sort_roots(values: np.ndarray) -> np.ndarray:
    """Roots sorted by distance from the origin, conjugates together."""
    return np.array(sorted(values, key=lambda z: (round(abs(z), 6), z.real, z.imag)), dtype=complex)


def modes(values: np.ndarray) -> list[tuple[float, float]]:
    """(natural frequency [Hz], damping ratio) of each oscillatory pair among the poles, rising.

    A double pole at the origin that rounding has split is not a mode.
    """
    size = np.abs(values)
    typical = min(size.max(initial=0.0), 1e3 * np.median(size)) if len(values) else 0.0
    pairs = [z for z in values if z.imag > 1e-6 * abs(z) and abs(z) > 1e-7 * typical]
    return sorted((abs(z) / (2 * np.pi), -z.real / abs(z)) for z in pairs)
