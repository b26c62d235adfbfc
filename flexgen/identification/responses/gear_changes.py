"""Changes of gears and motors by which a linear model meets measured responses, pose by pose.

A complex stiffness D_r at each row r of displacements ``rho y`` (a deflection, or the angle of a
motor) changes the responses from torques to accelerations of the motors by

    dG = -L D (1 + S D)^-1 P,   L = C Z^-1 rho^T,   S = rho Z^-1 rho^T,   P = rho Z^-1 B

with C the rows of the accelerations and Z, B those of the linear model. Each gear gets a change of
stiffness k, of loss h and of damping d, each motor one of viscous friction v:

    D = k + j h + j w d  at the deflection of the gear,    D = j w v  at the angle of the motor
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

# standard deviations of the prior of k, h, d, v, in the units of `Linearization`
LARGEST = (2.0, 0.5, 0.5, 5.0)
FLOOR = 0.03  # error of responses, as a part of their size, where the search begins
LEAST = 1e-3  # the same, where it ends
SMOOTHED = 9  # lines over which the error that is left is averaged


@dataclass(frozen=True)
class Linearization:
    """The linear model at k poses, for one level of the excitation; g elastic gears, n_m motors,
    r = g + n_m.

    Parameters
    ----------
    w : array (lines,) [rad/s]
    G : complex array (k, lines, n_m, n_m)
        Its responses from torques to accelerations of the motors.
    L : complex array (k, lines, n_m, r)
        As above; rows: deflections of the gears, then the angles of the motors.
    S : complex array (k, lines, r, r)
    P : complex array (k, lines, r, n_m)
    stiffness : array (g,)
        Of the gears: the unit of their changes of stiffness and loss, and over the mean frequency
        of that of damping.
    inertia : array (n_m,)
        Of the motors: times the mean frequency the unit of their friction.
    """

    w: np.ndarray
    G: np.ndarray
    L: np.ndarray
    S: np.ndarray
    P: np.ndarray
    stiffness: np.ndarray
    inertia: np.ndarray

    @property
    def frequency(self) -> float:
        """Mean frequency [rad/s]."""
        return float(np.exp(np.log(self.w).mean()))

    @property
    def units(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of the changes k, h, d (g,) and v (n_m,)."""
        return (
            self.stiffness,
            self.stiffness,
            self.stiffness / self.frequency,
            self.inertia * self.frequency,
        )

    @property
    def prior(self) -> np.ndarray:
        """Standard deviations of all changes (3 g + n_m,)."""
        return np.repeat(LARGEST, [len(unit) for unit in self.units])

    def response(self, pose: int, x: np.ndarray) -> np.ndarray:
        """Responses (lines, n_m, n_m) at a pose with changes x (3 g + n_m,), in their units."""
        S = self.S[pose]
        D = self._stiffness_of(x)
        moved = np.linalg.solve(np.eye(S.shape[-1]) + S * D[:, None, :], self.P[pose])
        return np.asarray(self.G[pose] - self.L[pose] @ (D[..., None] * moved))

    def derivative(self, pose: int, x: np.ndarray) -> np.ndarray:
        """Derivatives of the responses in the changes (lines, n_m, n_m, 3 g + n_m).

        ``dG/dD_r = -(L (1 + D S)^-1)_r ((1 + S D)^-1 P)_r``: a column and a row.
        """
        S = self.S[pose]
        D = self._stiffness_of(x)
        g = len(self.stiffness)
        one = np.eye(S.shape[-1])
        s = 1j * self.w[:, None]
        left = self.L[pose] @ np.linalg.inv(one + D[..., None] * S)
        right = np.linalg.solve(one + S * D[:, None, :], self.P[pose])
        by = -left[:, :, None, :] * right.swapaxes(1, 2)[:, None]
        k, h, d, v = self.units
        gear = by[..., :g]
        s = s[..., None, None]
        return np.concatenate(
            [k * gear, 1j * h * gear, s * d * gear, s * v * by[..., g:]], axis=-1
        )

    def _stiffness_of(self, x: np.ndarray) -> np.ndarray:
        """The complex stiffnesses D (lines, r)."""
        g = len(self.stiffness)
        k, h, d, v = np.split(x * np.concatenate(self.units), [g, 2 * g, 3 * g])
        s = 1j * self.w[:, None]
        return np.concatenate([k + 1j * h + s * d, s * v], axis=1)


@dataclass(frozen=True)
class Changes:
    """Changes of gears and motors at one pose.

    ``x`` (3 g + n_m,): k, h, d, v in their units; ``covariance`` of x; ``distortion``: error of
    the responses that is left above the noise, as a part of their size.
    """

    x: np.ndarray
    covariance: np.ndarray
    distortion: float


def fit_changes(
    model: Linearization, pose: int, G: np.ndarray, variance: np.ndarray, start: np.ndarray
) -> Changes:
    """The changes for which the model has the measured responses at a pose.

    Parameters
    ----------
    model : Linearization
    pose : int
    G : complex array (lines, n_m, n_m)
    variance : array (lines, n_m, n_m)
        Of the elements of G by noise. What the fit leaves is added to it.
    start : array (3 g + n_m,)
    """
    prior = model.prior
    x = start
    size = np.abs(G) ** 2
    extra = FLOOR**2 * size
    information = np.eye(len(start))
    for _ in range(3):
        weight = 1 / np.sqrt(variance + extra)

        def residual(x: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            away = (model.response(pose, x) - G) * weight
            return np.concatenate([away.real.ravel(), away.imag.ravel(), x / prior])

        def derivative(x: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            J = (model.derivative(pose, x) * weight[..., None]).reshape(-1, len(x))
            return np.vstack([J.real, J.imag, np.diag(1 / prior)])

        found = least_squares(residual, x, derivative, x_scale=prior)
        # the parts of a complex residual have the variance 1/2
        x = found.x
        information = 2 * found.jac.T @ found.jac
        left = np.abs(model.response(pose, x) - G) ** 2 - variance
        extra = np.maximum(_smooth(left), LEAST**2 * size)
    distortion = float(np.sqrt(max(np.median(_smooth(left) / size), 0.0)))
    return Changes(x, np.linalg.inv(information), distortion)


def _smooth(x: np.ndarray) -> np.ndarray:
    """Means over neighboring lines, axis 0; fewer at the ends."""
    half = SMOOTHED // 2
    return np.array(
        [x[max(0, line - half) : line + half + 1].mean(axis=0) for line in range(len(x))]
    )
