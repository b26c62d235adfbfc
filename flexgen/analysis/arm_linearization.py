"""The arm linearized about static equilibria: inertia, damping, stiffness and output rates, at
many poses at once.

    M a + D v + K q = tau_a,    y' = W v,    q_g = S_g q_e where the output is fixed

Gears are left out, except for the stiffness of their springs; rotors behind rigid gears are part
of M.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from flexgen.base.errors import SolverError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.outputs import output_map
from flexgen.dynamics.mechanics.statics import gear_deflection
from flexgen.model.elements import RobotModel


@dataclass(frozen=True)
class ArmLinearization:
    """Linearization of the arm at k static equilibria.

    ``M D K`` (k, n_a, n_a); ``W`` (k, n_y, n_a): output rates; ``stiffness`` (k, n_g): of the gear
    springs on the arm side at the deflection that holds the pose, zero for rigid gears [SI units].
    """

    model: RobotModel
    M: np.ndarray
    D: np.ndarray
    K: np.ndarray
    W: np.ndarray
    stiffness: np.ndarray

    @property
    def W_g(self) -> np.ndarray:
        """Output rates of the actuated coordinates (k, n_y, n_g)."""
        return self.W[:, :, list(self.model.i_g)]

    def inner(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``A, D, K`` (k, n_e, n_e): the non-actuated rows with the output fixed, in the
        coordinates q_e.

        SolverError where the output does not determine the actuated coordinates.
        """
        try:
            S = held_motions(self.model, self.W)
        except np.linalg.LinAlgError:
            raise SolverError(
                "the output does not determine the actuated coordinates: a singular pose"
            ) from None
        A, D, K = (X[:, list(self.model.i_e)] @ S for X in (self.M, self.D, self.K))
        return A, D, K

    def relative_inertia(self) -> np.ndarray:
        """A (k, n_e, n_e) over the non-actuated coordinates' own inertia, ``L^-1 A L^-T`` with
        ``M_ee = L L'``.
        """
        i_e = list(self.model.i_e)
        L = np.linalg.cholesky(self.M[:, i_e][:, :, i_e])
        half = np.linalg.solve(L, self.inner()[0])
        return np.linalg.solve(L, half.transpose(0, 2, 1)).transpose(0, 2, 1)


def held_motions(model: RobotModel, W: np.ndarray) -> np.ndarray:
    """Motions (..., n_a, n_e) of the arm with each of q_e that hold the output:
    ``q_e = 1, q_g = -W_g^-1 W_e q_e``.

    ``W`` (..., n_y, n_a): rates of the output. LinAlgError where ``W_g`` is singular.
    """
    i_g = list(model.i_g)
    i_e = list(model.i_e)
    S = np.zeros((*W.shape[:-2], model.n_a, model.n_e))
    S[..., i_e, np.arange(model.n_e)] = 1.0
    S[..., i_g, :] = -np.linalg.solve(W[..., i_g], W[..., i_e])
    return S


def arm_linearization(equations: Equations, q: np.ndarray) -> ArmLinearization:
    """The `ArmLinearization` at the poses ``q`` (k, n_a), whose non-actuated rows are in balance:
    inertia with the rotors of rigid gears, damping and stiffness of the rows at rest, output map,
    and stiffness of the gears under their load.
    """
    model = equations.model
    lag = equations.lagrangian
    symbol = lag.chain.q_a
    v = lag.chain.v_a
    static = ca.gradient(lag.gravity, symbol) - lag.arm_forces
    rows = ca.SX(static)
    for k, i in enumerate(model.i_e):
        rows[i] = rows[i] - lag.tau_e[k]
    still = ca.SX.zeros(model.n_a)
    jacobians = [ca.substitute(ca.densify(ca.jacobian(rows, x)), v, still) for x in (v, symbol)]
    load = ca.substitute(static, v, still)
    M = equations.function("mass_matrix")(symbol)
    function = ca.Function(
        "linearization", [symbol], [ca.densify(M), *jacobians, output_map(equations).rate, load]
    )
    n = len(q)
    M, D, K, W, load = (x.reshape(n, -1, model.n_a) for x in evaluate(function, q))
    M = M.copy()
    geared = [j for j in range(model.n_m) if j not in model.i_m]
    if geared:
        inertia = np.array([model.motors[j].inertia for j in geared])
        i_g = np.array(model.i_g)
        M[:, i_g[:, None], i_g] += model.eta[geared].T @ (inertia[:, None] * model.eta[geared])
    deflection = gear_deflection(equations, load[:, 0][:, list(model.i_g)])
    stiffness = evaluate(equations.function("gear_law"), deflection)[1].reshape(n, -1)
    return ArmLinearization(model, M, D, K, W, stiffness)
