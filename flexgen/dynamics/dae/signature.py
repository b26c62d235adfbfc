"""Structural index of the inverse dynamics by Pryce's signature method.

Equations: the equations of motion of y = (q_a, q_me) and the prescribed output; unknowns: y and
the motor torques. The signature ``sigma_ij`` is the order of the highest derivative of unknown j
in equation i. A transversal of largest sum and the smallest offsets with ``d_j - c_i >= sigma_ij``
(equality on it) give the structural index ``max c + (1 if min d = 0)``.

Source: J. D. Pryce, BIT Numerical Mathematics 41(2), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import linear_sum_assignment

from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.outputs import output_map

ABSENT = -1_000_000


@dataclass(frozen=True)
class IndexReport:
    """``index``: structural index, None where the problem is structurally singular; ``c``, ``d``:
    the offsets.
    """

    index: int | None
    c: tuple[int, ...]
    d: tuple[int, ...]


def signature(equations: Equations) -> np.ndarray:
    """Signature matrix (n + n_y, n + n_m); ABSENT where an unknown does not appear."""
    lag = equations.lagrangian
    model = equations.model
    names = {name: k for k, name in enumerate(equations.function("residual").name_in())}
    a_m = lag.a_m
    arguments = [lag.chain.q_a, lag.chain.v_a, lag.a_a, lag.q_m, lag.v_m, a_m, lag.tau_m]
    r_a, r_m = equations.function("residual")(*arguments)
    # (an empty index into a single motor has the wrong shape)
    n = model.dof
    i_m = list(model.i_m)
    rows = ca.vertcat(r_a, *[r_m[j] for j in i_m])
    levels = []
    for arm, motor in (("q_a", "q_m"), ("v_a", "v_m"), ("a_a", "a_m")):
        unknown = ca.vertcat(arguments[names[arm]], *[arguments[names[motor]][j] for j in i_m])
        levels.append(np.array(ca.DM(ca.jacobian(rows, unknown).sparsity(), 1)) > 0)
    sigma = np.full((n + model.output.size, n + model.n_m), ABSENT)
    for order, pattern in enumerate(levels):
        sigma[:n, :n][pattern] = order
    torque = np.array(ca.DM(ca.jacobian(rows, lag.tau_m).sparsity(), 1)) > 0
    sigma[:n, n:][torque] = 0
    place = ca.jacobian(output_map(equations).error, lag.chain.q_a).sparsity()
    sigma[n:, : model.n_a][np.array(ca.DM(place, 1)) > 0] = 0
    return sigma


def structural_index(equations: Equations) -> IndexReport:
    """The structural index of the inverse dynamics of a model with as many outputs as motors."""
    sigma = signature(equations)
    if sigma.shape[0] != sigma.shape[1]:
        return IndexReport(None, (), ())
    rows, columns = linear_sum_assignment(sigma, maximize=True)
    best = sigma[rows, columns]
    if best.min() == ABSENT:
        return IndexReport(None, (), ())
    c = np.zeros(len(sigma), dtype=int)
    while True:
        d = (sigma + c[:, None]).max(axis=0)
        new = d[columns] - best
        if (new == c).all():
            break
        c = new
    index = int(c.max()) + (1 if d.min() == 0 else 0)
    return IndexReport(index, tuple(int(x) for x in c), tuple(int(x) for x in d))
