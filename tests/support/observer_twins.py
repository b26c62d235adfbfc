"""Observers once more in Python: the same equations, with whole matrices, written without the C.

The model comes from Lagrange's equations as CasADi graphs; derivatives of the measurements by
automatic differentiation of the whole measurement, accelerations included; all channels of a
sample are used at once, in Joseph's form.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from flexgen.dynamics.mechanics.equations import derive


class KalmanTwin:
    """The extended Kalman filter for the settings of a compiled one."""

    def __init__(self, compiled, mistake: str = "") -> None:
        self.mistake = mistake
        model = compiled.model
        equations = derive(model)
        n = model.dof
        self.n_x = 2 * model.dof
        self.n_d = compiled.n_d
        self.h = compiled.sample_time
        self.steps = compiled._head.steps
        self.doublings = compiled._head.doublings
        x = ca.SX.sym("x", self.n_x)
        tau = ca.SX.sym("tau", model.n_m)
        rate = equations.function("state_rate").expand()(x, tau)
        self.rate = ca.Function("rate", [x, tau], [rate])
        self.A = ca.Function("A", [x, tau], [ca.jacobian(rate, x), ca.jacobian(rate, tau)])
        q_a = x[: model.n_a]
        v_a = x[n : n + model.n_a]
        a_a = rate[n : n + model.n_a]
        elastic = list(model.i_m)
        geared = ca.mtimes(ca.DM(model.eta), q_a[list(model.i_g)])
        angles = [
            x[model.n_a + elastic.index(j)] if j in elastic else geared[j]
            for j in range(model.n_m)
        ]
        signals = ca.vertcat(*angles)
        if model.sensors:
            signals = ca.vertcat(signals, equations.function("sensors").expand()(q_a, v_a, a_a))
        g = signals[compiled.channels.index.tolist()]
        self.g = ca.Function("g", [x, tau], [g, ca.jacobian(g, x), ca.jacobian(g, tau)])
        noises = compiled.noises
        self.R = np.diag(compiled.channels.noise**2)
        self.torque = np.diag((noises.torque * noises.largest) ** 2)
        self.walk = np.diag((noises.rate * noises.largest) ** 2 * self.h)[: self.n_d, : self.n_d]
        self.process = compiled._process[: self.n_x, : self.n_x].copy()
        self.z = compiled.state
        self.P = compiled.covariance
        self.last = None

    def step(self, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, float]:
        """One sample: innovation of each channel given those before it, and the normalized
        square.
        """
        n_x = self.n_x
        n_d = self.n_d
        tau = u + (self.z[n_x:] if n_d else 0.0)
        if self.last is not None:
            self.predict(tau)
        A, B = (np.array(x) for x in self.A(self.z[:n_x], tau))
        self.last = A, B
        value, by_x, by_tau = (np.array(x) for x in self.g(self.z[:n_x], tau))
        if self.mistake == "no torque in H":
            by_tau = 0 * by_tau
        H = np.hstack([by_x, by_tau[:, :n_d]])
        S = H @ self.P @ H.T + self.R
        K = np.linalg.solve(S, H @ self.P).T
        nu = y - value.ravel()
        self.z = self.z + K @ nu
        kept = np.eye(n_x + n_d) - K @ H
        self.P = kept @ self.P @ kept.T + K @ self.R @ K.T
        # One after the other: the innovations are those of the triangular factor of S, before they
        # are scaled.
        L = np.linalg.cholesky(S)
        return np.diag(L) * np.linalg.solve(L, nu), float(nu @ np.linalg.solve(S, nu))

    def predict(self, tau: np.ndarray) -> None:
        """State and covariance of the next sample."""
        n_x = self.n_x
        n_d = self.n_d
        A, B = self.last
        s = self.h / 2**self.doublings
        order = 1 if self.mistake == "first order" else 4
        whole = np.zeros((n_x + B.shape[1],) * 2)
        whole[:n_x, :n_x] = A
        whole[:n_x, n_x:] = B
        F = sum(np.linalg.matrix_power(s * whole, k) / math.factorial(k) for k in range(order + 1))
        F = np.linalg.matrix_power(F, 2**self.doublings)
        G = F[:n_x, n_x:]
        F = F[: n_x + n_d, : n_x + n_d]
        Q = np.zeros_like(F)
        Q[:n_x, :n_x] = G @ self.torque @ G.T + self.process
        Q[n_x:, n_x:] = self.walk
        self.P = F @ self.P @ F.T + Q
        x = self.z[:n_x]
        h = self.h / self.steps
        for _ in range(self.steps):
            k1 = np.array(self.rate(x, tau)).ravel()
            k2 = np.array(self.rate(x + h / 2 * k1, tau)).ravel()
            k3 = np.array(self.rate(x + h / 2 * k2, tau)).ravel()
            k4 = np.array(self.rate(x + h * k3, tau)).ravel()
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.z = np.concatenate([x, self.z[n_x:]])
