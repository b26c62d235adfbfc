"""The derivative array of the inverse dynamics by Taylor series: numbers of any order and at many
points, for ranks.

With Taylor coefficients ``x = sum x_[j] t^j`` in place of derivatives, the Jacobian of the
derivative array consists of those of F_x and F_x' along the curve,

    dF_[i] / dx_[j] = (F_x)_[i-j] + j (F_x')_[i-j+1]

so that one series of the Jacobians of F, by automatic differentiation, gives all of it. F: see
`flexgen.dynamics.dae.system`. `flexgen.dynamics.dae.derivative_array` has the same array as CasADi
functions of fixed order; the tests compare both.

Source: P. Kunkel, V. Mehrmann, Differential-Algebraic Equations, EMS 2006, chapter 3 (derivative
arrays).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.linalg import lstsq
from scipy.sparse import block_array, csc_array, eye_array
from scipy.sparse.linalg import splu

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.dae.system import InverseDae
from flexgen.dynamics.dae.taylor_series import SeriesFunction
from flexgen.dynamics.mechanics.linearization import second_order_matrices
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.quasistatic import OutputPath, equilibria_along, targets

STEPS = 15  # of Gauss-Newton towards a consistent point
SWEEPS = 10  # of the scaling of rows and columns to entries near one
LEFT = 1e-9  # of a solution's size: residual above which a factorization is not trusted
NEARBY = 1e-3  # of a path's duration: the distance of the poses from which its motion is guessed
SHORTEST = 1 / 64  # part of a step that is tried
SLOWEST = 1 / 8  # of the path's speed: the shortest step towards it
# scaled residual of the array at which a point counts as consistent; rounding leaves about 1e-13
CONSISTENT = 1e-10
RANK = 1e-11  # of the largest singular value: directions of the array that are not used for a step


@dataclass(frozen=True)
class Scales:
    """Units in which the numbers of the system are near one.

    ``time`` [s]; ``x`` (n,): of the unknowns; ``rows`` (m,): factors of the equations.
    """

    time: float
    x: np.ndarray
    rows: np.ndarray


class TaylorArray:
    """Taylor series of the rows of a DAE and of their Jacobians."""

    def __init__(self, dae: InverseDae) -> None:
        self.dae = dae
        self.equations = dae.equations
        self.model = dae.model

    @cached_property
    def _jacobians(self) -> SeriesFunction:
        return SeriesFunction(self.equations.function("residual_jacobians"))

    @cached_property
    def _residual(self) -> SeriesFunction:
        return SeriesFunction(self.equations.function("residual"))

    @cached_property
    def _rate(self) -> SeriesFunction:
        q = self.equations.lagrangian.chain.q_a
        return SeriesFunction(ca.Function("W", [q], [output_map(self.equations).rate]))

    def _arguments(self, x: np.ndarray) -> list[np.ndarray]:
        """Series (q_a, v_a, a_a, q_m, v_m, a_m, tau_m) from those of x (k, K + 2, n_x), one order
        less.
        """
        model = self.model
        order = x.shape[1] - 1
        rise = x[:, 1:] * np.arange(1, order + 1)[:, None]
        parts = []
        for series in (x[:, :-1, self.dae.y], x[:, :-1, self.dae.rate], rise[..., self.dae.rate]):
            motors = np.zeros((*series.shape[:2], model.n_m))
            motors[..., list(model.i_m)] = series[..., model.n_a :]
            parts.append((series[..., : model.n_a], motors))
        (q, q_m), (v, v_m), (a, a_m) = parts
        return [q, v, a, q_m, v_m, a_m, x[:, :-1, self.dae.torque]]

    def jacobians(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Series of F_x and F_x' (k, K + 1, m, n_x) along ``x`` (k, K + 2, n_x).

        The output's rows are those of its rates, which agree with the derivatives of its error on
        the path.
        """
        M, D, K, B, W = self._linearization(x)
        dae = self.dae
        shape = (*M.shape[:2], dae.m, dae.n_x)
        F_x = np.zeros(shape)
        F_dx = np.zeros(shape)
        dynamic = dae.dynamic[:, None]
        F_dx[:, 0, dae.kinematic, dae.y] = 1.0
        F_x[:, 0, dae.kinematic, dae.rate] = -1.0
        F_dx[:, :, dynamic, dae.rate] = M
        F_x[:, :, dynamic, dae.y] = K
        F_x[:, :, dynamic, dae.rate] = D
        F_x[:, :, dynamic, dae.torque] = -B
        F_x[:, :, dae.output[:, None], np.arange(self.model.n_a)] = W
        return F_x, F_dx

    def _linearization(self, x: np.ndarray) -> list[np.ndarray]:
        """Series of M, D, K, B of the equations of motion and of the output rates W along ``x``
        (k, K + 2, n_x).
        """
        arguments = self._arguments(x)
        if x[:, 1:].any():
            found = [*self._jacobians(*arguments), *self._rate(arguments[0])]
        else:  # nothing moves: the series end with their first coefficient
            still = [argument[:, 0] for argument in arguments]
            found = []
            for value in [
                *evaluate(self._jacobians.function, *still),
                *evaluate(self._rate.function, still[0]),
            ]:
                found.append(np.zeros((len(x), x.shape[1] - 1, *value.shape[1:])))
                found[-1][:, 0] = value
        M, R, W = found
        return [
            *second_order_matrices(M, R),
            W.reshape(*W.shape[:2], self.model.output.size, self.model.n_a),
        ]

    def residual(
        self, x: np.ndarray, reference: OutputPath, times: np.ndarray, speed: float = 1.0
    ) -> np.ndarray:
        """Series of F (k, K + 1, m) along ``x`` (k, K + 2, n_x), whose zeroth coefficients hold at
        ``times`` (k,) [s].

        Derivatives that the reference does not have are zero. ``speed``: factor on the speed along
        the path.
        """
        q, v, a, q_m, v_m, a_m, tau = self._arguments(x)
        r_a, r_m = self._residual(q, v, a, q_m, v_m, a_m, tau)
        dae = self.dae
        (k, order) = q.shape[:2]
        i_m = list(self.model.i_m)
        F = np.zeros((k, order, dae.m))
        rise = x[:, 1:] * np.arange(1, order + 1)[:, None]
        F[..., dae.kinematic] = rise[..., dae.y] - x[:, :-1, dae.rate]
        F[..., dae.dynamic] = np.concatenate(
            [r_a.reshape(k, order, -1), r_m.reshape(k, order, -1)[..., i_m]], axis=2
        )
        W = self._rate(q)[0].reshape(k, order, -1, self.model.n_a)
        sample = reference.sample(times)
        for point, target in enumerate(targets(sample)):
            F[point, 0, dae.output] = np.array(dae.output_error(q[point, 0], target))[:, 0]
        factorial = 1.0
        for i in range(1, order):
            factorial *= i
            moved = sum(W[:, j] @ (rise[:, i - 1 - j, : self.model.n_a, None]) for j in range(i))
            asked = speed**i * sample.derivative(i) if i < sample.y.shape[2] else 0.0
            F[:, i][:, dae.output] = moved[..., 0] / i - asked / factorial
        return F

    def scales(self, x: np.ndarray) -> Scales:
        """Units from the inertias, springs and output rates at the point ``x`` (n_x,)."""
        still = np.zeros((1, 2, self.dae.n_x))
        still[0, 0] = x
        F_x, F_dx = (J[0, 0] for J in self.jacobians(still))
        dynamic = self.dae.dynamic[:, None]
        unit = 1 / np.sqrt(np.diag(F_dx[dynamic, self.dae.rate]))
        # Gershgorin's circles would do as well: the unit of time only has to be of the springs'
        # order
        stiff = np.abs(np.linalg.eigvals(F_x[dynamic, self.dae.y] * unit * unit[:, None]))
        stiff = stiff[stiff > 1e-9 * max(stiff.max(initial=0.0), 1e-300)]
        time = float(np.exp(-np.log(stiff).mean() / 2)) if len(stiff) else 1.0
        columns = np.ones(self.dae.n_x)
        columns[self.dae.y] = unit
        columns[self.dae.rate] = unit / time
        effect = np.abs(F_x[dynamic, self.dae.torque] * unit[:, None]).max(axis=0) * time**2
        columns[self.dae.torque] = 1 / np.where(effect > 0, effect, 1.0)
        return choose_scales(F_x, F_dx, time, columns)


def choose_scales(F_x: np.ndarray, F_dx: np.ndarray, time: float, columns: np.ndarray) -> Scales:
    """Scales that bring the entries of F_x and F_x' (m, n) near one, from a unit of time and units
    of the unknowns.
    """
    whole = np.maximum(np.abs(F_x), np.abs(F_dx) / time)
    rows = np.ones(len(whole))
    for _ in range(SWEEPS):
        size = (whole * columns).max(axis=1)
        rows = 1 / np.where(size > 0, size, 1.0)
        size = np.sqrt((whole * rows[:, None]).max(axis=0) * columns)
        columns = columns / np.where(size > 0, size, 1.0)
    return Scales(time, columns, rows)


def derivative_array(F_x: np.ndarray, F_dx: np.ndarray, mu: int, scales: Scales) -> np.ndarray:
    """Scaled Jacobian ((mu + 1) m, (mu + 2) n) of the array of order mu in the Taylor coefficients
    x_[0] ... x_[mu+1].

    ``F_x``, ``F_dx`` (K + 1, m, n): series along the curve, K >= mu.
    """
    m, n = F_x.shape[1:]
    factors = scales.rows[:, None] * scales.x
    powers = scales.time ** np.arange(mu + 1)
    A = F_x[: mu + 1] * factors * powers[:, None, None]
    E = F_dx[: mu + 1] * factors * powers[:, None, None] / scales.time
    out = np.zeros(((mu + 1) * m, (mu + 2) * n))
    for i in range(mu + 1):
        for j in range(i + 2):
            block = j * E[i - j + 1] if j else np.zeros((m, n))
            out[i * m : (i + 1) * m, j * n : (j + 1) * n] = block + A[i - j] if j <= i else block
    return out


def consistent(
    series: TaylorArray, reference: OutputPath, times: np.ndarray, order: int
) -> tuple[np.ndarray, list[Scales]]:
    """Points of the derivative array of an order that satisfy it, near the quasi-static motion.

    Gauss-Newton steps of least norm in scaled unknowns, from that motion; where they do not
    converge, from the solution of the same path at a lower speed.

    Parameters
    ----------
    series : TaylorArray
    reference : OutputPath
    times : array (k,) [s]
        Rising instants on the path.
    order : int
        Of the derivative array.

    Returns
    -------
    x : array (k, order + 2, n_x)
        Taylor coefficients of the unknowns.
    scales : list of k Scales

    Raises
    ------
    SolverError
        There is no static equilibrium on the path, or the steps do not converge.
    """
    guess = _quasistatic_motion(series.dae, reference, times, order)
    scales = [series.scales(point) for point in guess[:, 0]]
    powers = np.arange(order + 2)[:, None]
    out = np.zeros_like(guess)
    for k in range(len(times)):
        speed = 0.0
        step = 1.0
        while speed < 1.0:
            faster = min(1.0, speed + step)
            start = out[k] * (faster / speed) ** powers if speed else guess[k] * faster**powers
            found = _gauss_newton(series, reference, times[k], faster, start, scales[k])
            if found is not None:
                out[k] = found
                speed = faster
                continue
            step /= 2
            if step < SLOWEST:
                raise SolverError(
                    f"derivative array of order {order} at t = {times[k]:.4g} s: no consistent "
                    f"point found beyond {speed:.2g} of the path's speed; try other instants or "
                    "a slower move"
                )
    return out, scales


def _quasistatic_motion(
    dae: InverseDae, reference: OutputPath, times: np.ndarray, order: int
) -> np.ndarray:
    """Series (k, order + 2, n_x) at the ``times`` (k,) [s] of the motion through static
    equilibria: value, speed and half the acceleration by central differences over `NEARBY` of the
    duration.
    """
    h = NEARBY * reference.duration
    around = np.repeat(times, 3) + np.tile([-h, 0.0, h], len(times))
    rests = equilibria_along(dae.equations, reference, around)
    before, now, after = (
        np.array([dae.pack(rest) for rest in rests]).reshape(-1, 3, dae.n_x).transpose(1, 0, 2)
    )
    out = np.zeros((len(times), order + 2, dae.n_x))
    out[:, 0] = now
    speed = ((after - before) / (2 * h))[:, dae.y]
    half = ((after - 2 * now + before) / (2 * h**2))[:, dae.y]
    out[:, 1][:, dae.y] = speed
    out[:, 0][:, dae.rate] = speed
    if order:
        out[:, 2][:, dae.y] = half
    out[:, 1][:, dae.rate] = 2 * half
    return out


def _gauss_newton(
    series: TaylorArray,
    reference: OutputPath,
    t: float,
    speed: float,
    start: np.ndarray,
    scales: Scales,
) -> np.ndarray | None:
    """A consistent point (order + 2, n_x) at the instant ``t`` [s] of the path, run through at the
    factor ``speed``, by Gauss-Newton steps of least norm from ``start``; None where it does not
    converge.
    """
    order = len(start) - 2
    unit = scales.x / scales.time ** np.arange(order + 2)[:, None]
    weight = scales.rows * scales.time ** np.arange(order + 1)[:, None]

    def defect(x: np.ndarray) -> tuple[np.ndarray, float]:
        F = series.residual(x[None], reference, np.array([t]), speed)[0] * weight
        return F.ravel(), float(np.abs(F).max() / (1 + np.abs(x / unit).max()))

    x = start
    F, error = defect(x)
    for _ in range(STEPS):
        F_x, F_dx = series.jacobians(x[None])
        array = derivative_array(F_x[0], F_dx[0], order, scales)
        step = unit * _solve_least_norm(array, -F).reshape(order + 2, series.dae.n_x)
        length = 1.0
        while True:
            trial = x + length * step
            F_trial, smaller = defect(trial)
            if smaller < error or error < CONSISTENT or length < SHORTEST:
                break
            length /= 2
        if not smaller < error:
            break
        converged = error < CONSISTENT and smaller > error / 4
        x = trial
        F = F_trial
        error = smaller
        if converged:
            break
    return x if error < CONSISTENT else None


def _solve_least_norm(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The solution of ``A x = b`` of least norm; in the sense of least squares where the rows
    depend on each other.

    A sparse factorization first; where its result is not finite, too large or inexact, a QR
    decomposition with pivoting.
    """
    n = A.shape[1]
    sparse = csc_array(A)
    whole = csc_array(block_array([[eye_array(n), sparse.T], [sparse, None]]))
    try:
        x = np.asarray(splu(whole).solve(np.concatenate([np.zeros(n), b])))[:n]
    except RuntimeError:  # singular
        x = np.full(n, np.nan)
    # (a larger solution goes along directions that are not used)
    used = np.isfinite(x).all() and RANK * np.linalg.norm(A) * np.linalg.norm(x) <= np.linalg.norm(
        b
    )
    if used and np.abs(A @ x - b).max() <= LEFT * (1 + np.abs(x).max()):
        return x
    return np.asarray(lstsq(A, b, cond=RANK, lapack_driver="gelsy")[0])
