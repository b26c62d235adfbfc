"""Describing functions: the linear elements that replace nonlinear ones in a Gaussian motion.

    spring       N = E[tau(m + s e) e] / s,   E[tau(m + s e)] = T
                 m, s: mean and deviation of the deflection, T: mean torque, e: standard Gaussian
    Coulomb      N = j w F sqrt(2/pi) / v
                 torque F sgn, v: standard deviation of the speed
    hysteresis   N = k E[A^2 H(A/x)] / E[A^2]       A of Rayleigh's distribution with the scale s
                 H(a) = (t - sin(2 t)/2 + j sin(t)^2) / pi,  cos(t) = 1 - 2/a;  H = 1 for a < 1

Those of springs and friction have the least mean square error of the torque. Hysteresis is a
spring k in series with a friction that slips at the deflection x; the mean over the amplitudes A
holds for a narrow band of frequencies.

Source: A. Gelb and W. Vander Velde, Multiple-Input Describing Functions, 1968, ch. 5; W. Iwan, J.
Appl. Mech. 33, 1966.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

NODES = 48  # of means over amplitudes
HALVINGS = 32
_E = np.linspace(-6.0, 6.0, 151)  # a standard Gaussian and its weights
_WEIGHTS = np.exp(-(_E**2) / 2) / np.exp(-(_E**2) / 2).sum()


def average_spring(
    torque: Callable[[np.ndarray], np.ndarray], mean_torque: np.ndarray, sd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness N of a spring, and the standard deviation of what it leaves over that of
    ``N s e``.

    Parameters
    ----------
    torque : callable
        Of deflections (..., any), the first axes those of ``sd``; odd, rising without limit.
    mean_torque, sd : arrays
        Mean torque, and standard deviation of the deflection.
    """
    s = sd[..., None]
    largest = np.abs(mean_torque) + sd
    while np.any(small := torque(largest[..., None])[..., 0] < np.abs(mean_torque)):
        largest = np.where(small, 2 * largest, largest)
    low = -largest - _E[-1] * sd
    high = largest + _E[-1] * sd
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        below = torque(middle[..., None] + s * _E) @ _WEIGHTS < mean_torque
        low = np.where(below, middle, low)
        high = np.where(below, high, middle)
    values = torque(low[..., None] + s * _E)
    stiffness = values @ (_WEIGHTS * _E) / sd
    left = values - (values @ _WEIGHTS)[..., None] - stiffness[..., None] * s * _E
    return stiffness, np.sqrt((left**2) @ _WEIGHTS) / np.maximum(stiffness * sd, 1e-300)


def average_coulomb(speed_sd: np.ndarray) -> np.ndarray:
    """Viscous friction in place of a Coulomb friction of 1."""
    return np.asarray(np.sqrt(2 / np.pi) / speed_sd)


def average_hysteresis(slip: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Complex stiffness of a spring of 1 in series with a friction that slips at the deflection
    ``slip``.
    """
    x, weight = np.polynomial.laguerre.laggauss(NODES)  # x = A^2 / (2 s^2) has the density exp(-x)
    weight = weight * x
    ratio = np.sqrt(2 * x) * (sd / slip)[..., None]
    t = np.arccos(1 - 2 / np.maximum(ratio, 1.0))
    H = (t - np.sin(2 * t) / 2 + 1j * np.sin(t) ** 2) / np.pi
    return np.asarray(H @ weight / weight.sum())
