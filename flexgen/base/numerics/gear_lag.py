"""Deflection of damped gears with linear springs, ``D p' + K p = tau(t)``, integrated exactly
between samples.

Between two samples the torque is the quintic that has its value and its first two derivatives at
both ends; with it the variation of constants is an integral of a polynomial under an exponential,

    p_1 = exp(-z) p_0 + h/D sum_i w_i(z) x_i,      z = K h / D,
    w_i(z) = int_0^1 exp(-z (1 - u)) b_i(u) du

with ``x = (tau_0, h tau_0', h^2 tau_0'', tau_1, h tau_1', h^2 tau_1'')`` and ``b_i`` its Hermite
basis. There is no stability limit for z > 0, and the only error is that of the interpolation.

Source: cf. M. Hochbruck, A. Ostermann, Acta Numerica 19, 2010, sec. 2 (exponential quadrature).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NODES = 48  # of Gauss and Legendre: exact to the last digit over the range below
DECAYED = 45.0  # exp(-45) = 3e-20: earlier torque has no influence
SAME = 11  # decimals of the logarithm to which steps are equal


@dataclass(frozen=True)
class Lag:
    """Steps of m gears: ``decay`` (n - 1, m), ``weights`` (n - 1, m, 6) [rad s/(N m s)], which
    contain h/D and h^k.
    """

    decay: np.ndarray
    weights: np.ndarray

    def forcing(self, tau: np.ndarray) -> np.ndarray:
        """Increments of the steps, (n - 1, m, ...), from torques and their rates ``tau`` (3, n, m,
        ...).
        """
        shape = (*self.decay.shape, *(1,) * (tau.ndim - 3))
        w = [self.weights[:, :, i].reshape(shape) for i in range(6)]
        out = w[0] * tau[0, :-1]
        for i, values in (
            (1, tau[1, :-1]),
            (2, tau[2, :-1]),
            (3, tau[0, 1:]),
            (4, tau[1, 1:]),
            (5, tau[2, 1:]),
        ):
            out += w[i] * values
        return out

    def deflections(self, tau: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Deflections at all samples.

        Parameters
        ----------
        tau : array (3, n, m, ...) [N m, N m/s, N m/s^2]
            Torques and their first two time derivatives; further axes are gears of the same kind.
        start : array (m, ...) [rad]
            Deflections at the first sample.

        Returns
        -------
        array (n, m, ...) [rad]
        """
        out = np.empty(tau.shape[1:])
        out[0] = start
        add = self.forcing(tau)
        decay = self.decay.reshape(*self.decay.shape, *(1,) * (tau.ndim - 3))
        for k, (kept, more) in enumerate(zip(decay, add, strict=True)):
            np.multiply(out[k], kept, out=out[k + 1])
            out[k + 1] += more
        return out


def gear_lag(t: np.ndarray, stiffness: np.ndarray, damping: np.ndarray) -> Lag:
    """Steps over the instants ``t`` (n,) [s] of gears with ``stiffness`` and ``damping`` (m,) [N
    m/rad, N m s/rad].
    """
    h = np.diff(t)
    # steps that are equal but for rounding share their weights
    sizes, kind = np.unique(np.round(np.log(h), SAME), return_inverse=True)
    mean = np.array([h[kind == k].mean() for k in range(len(sizes))])
    z = mean[:, None] * stiffness / damping
    powers = np.stack([mean**0, mean, mean**2] * 2, axis=-1)
    weights = _weights(z) * (mean[:, None] / damping)[:, :, None] * powers[:, None, :]
    return Lag(np.exp(-z)[kind], weights[kind])


def _weights(z: np.ndarray) -> np.ndarray:
    """``w_i(z)``, shape (..., 6), by Gauss quadrature over the range where the exponential is not
    negligible.
    """
    x, omega = np.polynomial.legendre.leggauss(NODES)
    span = np.minimum(1.0, DECAYED / z)[..., None]
    back = span * (x + 1) / 2  # 1 - u
    kernel = np.exp(-z[..., None] * back) * omega * span / 2
    u = 1 - back
    w = back
    basis = (
        w**3 * (1 + 3 * u + 6 * u**2),
        w**3 * (u + 3 * u**2),
        w**3 * u**2 / 2,
        np.zeros_like(u),  # below
        -(u**3) * (w + 3 * w**2),
        u**3 * w**2 / 2,
    )
    out = np.stack([(kernel * b).sum(axis=-1) for b in basis], axis=-1)
    # b_0 + b_3 = 1: a constant torque gives its static deflection to the last digit
    out[..., 3] = -np.expm1(-z) / z - out[..., 0]
    return out
