"""Growth of perturbations of the open loop along a motion.

An upright arm under a given torque is an inverted pendulum: rounding errors of 1e-16 and tolerances of 1e-12 grow
exponentially, and a forward simulation shows their growth instead of the error of the torque. The variational equation
along the motion

    d/dt dx = A(t) dx,     A from M(q) dq'' + D dq' + K dq = 0,     Phi(t, s) its transition matrix

gives the factor: the growth from s to t is the norm of the block of ``Phi`` that takes positions to positions (motors
on the arm side). ``A`` is constant on each interval of a grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from flexgen.mechanics.equations import Equations
from flexgen.mechanics.linearization import second_order_matrices
from flexgen.numerics.evaluate import evaluate

STEP, FEWEST, MOST = 1e-2, 50, 1000  # of the grid: its step [s], intervals


@dataclass(frozen=True)
class Motion:
    """Motion and torque at n instants ``t``: arm ``q_a v_a a_a`` (n, n_a), motors ``q_m v_m a_m tau_m`` (n, n_m)."""

    t: np.ndarray
    q_a: np.ndarray
    v_a: np.ndarray
    a_a: np.ndarray
    q_m: np.ndarray
    v_m: np.ndarray
    a_m: np.ndarray
    tau_m: np.ndarray


def growth_along(equations: Equations, motion: Motion) -> float:
    """Largest growth of a perturbation from the start of a motion to an instant of it."""
    steps = transition_matrices(equations, motion)
    return float(np.exp(min(_log_growth(steps, equations.model.dof).max(initial=0.0), 700.0)))


def transition_matrices(equations: Equations, motion: Motion) -> np.ndarray:
    """Transition matrices from each instant of the grid to the next (k, 2n, 2n), arm side."""
    model, t = equations.model, motion.t
    count = int(np.clip((t[-1] - t[0]) / STEP, FEWEST, MOST))
    at = np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], count + 1)).clip(0, len(t) - 1))
    arguments = (motion.q_a, motion.v_a, motion.a_a, motion.q_m, motion.v_m, motion.a_m, motion.tau_m)
    n = model.dof
    M, D, K, _ = second_order_matrices(*evaluate(equations.function("residual_jacobians"), *(x[at] for x in arguments)))
    side = np.ones(n)
    side[model.n_a :] = np.abs(model.eta).max(axis=1)[list(model.i_m)]
    A = np.zeros((len(at), 2 * n, 2 * n))
    A[:, :n, n:] = np.eye(n)
    A[:, n:, :n], A[:, n:, n:] = (np.linalg.solve(M, -x) / side[:, None] * side for x in (K, D))
    lengths = np.diff(t[at])[:, None, None]
    return expm((A[:-1] + A[1:]) / 2 * lengths)


def _log_growth(steps: np.ndarray, n: int) -> np.ndarray:
    """Logarithm of the growth from the start of the first step to the end of each, (k,)."""
    product, size, out = np.eye(2 * n), 0.0, np.empty(len(steps))
    for k, step in enumerate(steps):
        product = step @ product
        scale = float(np.linalg.norm(product))
        product, size = product / scale, size + np.log(scale)  # growth of any size without overflow
        out[k] = size + np.log(max(float(np.linalg.norm(product[:n, :n], 2)), 1e-300))
    return out
